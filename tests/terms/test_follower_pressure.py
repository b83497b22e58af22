"""Pressure on the deformed surface: areas, tangent, a ring inflated to twice its radius, ranks, units, refusals."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest

import pdpetsc as pd
from pdpetsc.command_line.cli import load_case
from tests.commands import ROOT, results

E = 100.0


def scene(dim, nodes=True, unit=1.0, modulus=E, p=20.0, **changes):
    """Return a block on a clamped base, with a pressure on its top that follows the deformation."""
    low, high = (0.0,) * dim, (unit,) * (dim - 1) + (0.75 * unit,)
    up = "yz"[dim - 2]
    kind = pd.LatticeNodes if nodes else pd.Lattice
    given = {
        "particles": kind(low, high, 0.25 * unit),
        "horizon": 0.25 * 2.015 * unit,
        "weights": pd.Conforming(),
        "material": pd.NeoHookean(E=modulus, nu=0.3),
        "conditions": [pd.Clamp(f"-{up}"), pd.FollowerPressure(f"+{up}", p * modulus / E)],
        "history": {"top": pd.Mean(pd.displacement, up, f"+{up}"), "support": pd.Reaction(up, f"-{up}")},
        "steps": pd.Steps(2),
    }
    if not nodes:
        base = pd.region.Slab(up, high=0.25 * unit)
        given["conditions"][0] = pd.Displacement(base, x=0.0, y=0.0, z=0.0 if dim == 3 else None)
    return pd.Case(**{**given, **changes})


def follower(problem):
    (term,) = (one for one in problem.terms if type(one).__name__ == "PressureOnDeformed")
    return term


def force_of(term, state):
    f = np.zeros((term.body.cloud.n_local, term.body.dim))
    term.add_force(state, f)
    return f


@pytest.mark.parametrize("nodes", [True, False])
@pytest.mark.parametrize("dim", [2, 3])
def test_forces_have_their_tangent(dim, nodes, rng):
    problem = pd.prepare(scene(dim, nodes)).problem
    term, n = follower(problem), problem.body.cloud.n_owned
    u, du = 0.1 * rng.uniform(-1.0, 1.0, (n, dim)), rng.uniform(-1.0, 1.0, (n, dim))
    (product,) = term.linearise(problem.state(u, 0.7))
    exact = np.zeros_like(force_of(term, problem.state(u, 0.7)))
    product.add_product(du, exact, np.arange(n, dtype=np.int32))
    h = 1e-6
    ahead, behind = (force_of(term, problem.state(u + sign * h * du, 0.7)) for sign in (1.0, -1.0))
    difference = (ahead - behind) / (2.0 * h)
    assert np.abs(exact).max() > 0.1
    assert np.abs(difference - exact).max() < 1e-7 * np.abs(exact).max()


@pytest.mark.parametrize("nodes", [True, False])
@pytest.mark.parametrize("dim", [2, 3])
def test_areas_follow_a_uniform_deformation(dim, nodes, rng):
    """The force on a flat side is ``-p cof(F) A`` for every linear motion."""
    problem = pd.prepare(scene(dim, nodes)).problem
    cloud = problem.body.cloud
    F = np.eye(dim) + 0.5 * rng.uniform(-1.0, 1.0, (dim, dim))
    u = cloud.x[: cloud.n_owned] @ (F - np.eye(dim)).T
    found = -force_of(follower(problem), problem.state(u, 1.0)).sum(axis=0)
    A = np.zeros(dim)
    A[-1] = 1.0
    np.testing.assert_allclose(found, -20.0 * np.linalg.det(F) * np.linalg.solve(F.T, A), rtol=1e-10)


@pytest.mark.long
def test_a_ring_is_inflated_to_twice_its_radius(tmp_path):
    """Against the radial equilibrium of the same law: second order in the spacing."""
    command = ["runs/convergence/inflation.py", "follower=yes", "pressure=0.21", "steps=4", "mesh=quads"]
    coarse, fine = (results(*command, f"n={n}", output=tmp_path / str(n))["results"] for n in (6, 12))
    assert fine["error_u"] < 0.015
    assert fine["error_u"] < 0.3 * coarse["error_u"]


@pytest.mark.long
def test_units_and_ranks_change_nothing(tmp_path):
    one = pd.run(scene(2), tmp_path / "one").history
    other = pd.run(scene(2, unit=1e20, modulus=1e-20), tmp_path / "other").history
    assert one["top"][-1] < -0.03
    assert other["top"][-1] / 1e20 == pytest.approx(one["top"][-1], rel=1e-9)
    assert one["support"][-1] > 0.0
    path = tmp_path / "pressed.py"
    path.write_text(
        "import pdpetsc as pd\n\n\ndef case():\n"
        "    return pd.Case(\n"
        "        particles=pd.LatticeNodes((0.0, 0.0, 0.0), (1.0, 1.0, 0.75), 0.25),\n"
        "        material=pd.NeoHookean(E=100.0, nu=0.3),\n"
        '        conditions=[pd.Clamp("-z"), pd.FollowerPressure("+z", 20.0), pd.FollowerPressure("+x", 10.0)],\n'
        '        history={"top": pd.Mean(pd.displacement, "x", "+z")},\n'
        '        results=lambda h: {"top": h["top"][-1]},\n'
        "    )\n"
    )
    found = [results(path, ranks=ranks, output=tmp_path / str(ranks))["results"]["top"] for ranks in (1, 2, 3)]
    assert found[0] < -0.01
    np.testing.assert_allclose(found[1:], found[0], rtol=1e-9)


BALLOON = "runs/stability/balloon.py"


def balloon(**values):
    """Return a ring that is inflated beyond its largest pressure."""
    case = load_case(ROOT / BALLOON)(**values)
    return dataclasses.replace(case, expect={}, results=None, picture=None)


def test_a_path_has_the_derivatives_of_its_residual(rng):
    """By the displacements and by the load factor, at a deformed ring that is not in equilibrium."""
    prepared = pd.prepare(balloon(n=1))
    solver = prepared.make_solver()
    *_, last = itertools.islice(prepared.march(solver), 12)
    assert last.t > 0.3
    solver._aim(last.u, 0.05)
    x, step = solver._x.duplicate(), solver._x.duplicate()
    u = last.u + 0.01 * rng.uniform(-1.0, 1.0, last.u.shape)
    solver._bordered.put(x, u / solver._scales.length, np.array([1.1 * last.t]))
    solver._jacobian(solver.snes, x, solver._bordered.mat, solver._bordered.mat)
    for du, load in ((0.0, 1.0), (1.0, 0.0), (1.0, 1.0)):
        change = du * rng.uniform(-1.0, 1.0, u.shape)
        solver._bordered.put(step, change / solver._scales.length, np.array([load]))
        found = []
        for h in (1e-6, -1e-6):
            at, residual = x.duplicate(), x.duplicate()
            at.waxpy(h, step, x)
            solver._residual(solver.snes, at, residual)
            found.append(residual.array.copy())
        exact = x.duplicate()
        solver._bordered.mat.mult(step, exact)
        difference = (found[0] - found[1]) / 2e-6
        assert np.abs(difference - exact.array).max() < 1e-6 * np.abs(difference).max()
    solver.destroy()


def test_an_inflated_ring_passes_its_largest_pressure(tmp_path):
    """Against the radial equilibrium; up to the limit the equilibria are those of load steps."""
    case = load_case(ROOT / BALLOON)(step=0.1)
    path = pd.run(dataclasses.replace(case, picture=None), tmp_path / "path")
    found = path.summary["results"]
    assert found["limit"] == pytest.approx(1.0, abs=0.005)
    assert found["furthest"] < 0.005
    assert found["last"] < 0.85
    # Its unsymmetric tangent has no count of unstable directions.
    assert {step["negative_pivots"] for step in path.summary["steps"]} == {None}
    assert any("Nothing tells whether the equilibria of this path" in one for one in path.summary["warnings"])
    # The first step starts without a load; its tolerance is relative to the load of its end.
    assert {step["newton_iterations"] for step in path.summary["steps"]} <= {2, 3, 4}
    t, grown = (np.array(path.history[name]) for name in ("t", "grown"))
    below = int(np.argmax(t))
    times = [float(one) for one in t[1:below]]
    assert times[-1] > 0.9
    steps = balloon(solver="steps", pressure=times[-1])
    steps = dataclasses.replace(steps, steps=pd.Steps(times=[one / times[-1] for one in times]))
    loaded = pd.run(steps, tmp_path / "steps").history["grown"]
    np.testing.assert_allclose(loaded, grown[:below], rtol=1e-8, atol=1e-12)


@pytest.mark.long
def test_a_sphere_is_inflated_beyond_twice_its_radius(tmp_path):
    """An eighth of a neo-Hookean sphere, against the radial equilibrium: 0.021 with 6 cells, 0.010 with 9 of them."""
    words = [("n=2", "around=6"), ("n=3", "around=9")]
    coarse, fine = (results(BALLOON, "dim=3", *both, output=tmp_path / both[0])["results"] for both in words)
    assert fine["limit"] == pytest.approx(1.0, abs=0.004)
    assert fine["furthest"] < 0.6 * coarse["furthest"] < 0.015
    assert fine["last"] < 0.8


@pytest.mark.long
def test_a_path_of_a_balloon_depends_on_neither_ranks_nor_matrix(tmp_path):
    words = ["n=2", "step=0.1"]
    one = results(BALLOON, *words, output=tmp_path / "one")["results"]
    for name, more, ranks in (("two", [], 2), ("free", ["-pd_jacobian", "matfree"], 1)):
        other = results(BALLOON, *words, *more, ranks=ranks, output=tmp_path / name)["results"]
        assert other == pytest.approx(one, rel=1e-6), name


@pytest.mark.long
def test_a_path_with_a_following_load_restarts(tmp_path):
    """By an opening, which a checkpoint determines."""
    whole = opened(0.6)
    one = pd.run(whole, tmp_path / "whole").history
    pd.run(opened(0.4), tmp_path / "half")
    other = pd.run(whole, tmp_path / "rest", restart=tmp_path / "half").history
    assert other["t"][-1] == pytest.approx(one["t"][-1], rel=1e-8)


def opened(end):
    """Return the ring, whose path prescribes the growth of its inner radius."""
    right = pd.region.Nearest((1.0, 0.0))
    by_opening = pd.PathFollowing(pd.Opening("x", right, step=0.1, end=end), first=0.05, until=0.0)
    return dataclasses.replace(balloon(n=1), solver=by_opening)


@pytest.mark.parametrize(
    ("load", "message"),
    [
        (pd.FollowerPressure("+y", 20.0, schedule=pd.Hold()), "proportional to the step time"),
        (pd.Centrifugal(pd.region.All(), speed=1.0, about=(0.0, 0.0)), "proportional to the step time"),
    ],
)
def test_a_path_refuses_loads_that_are_not_proportional(load, message, tmp_path):
    case = scene(2, solver=pd.PathFollowing(pd.Opening("y", pd.region.Face("+y"), step=0.01, end=0.1)))
    case = dataclasses.replace(
        case, conditions=[case.conditions[0], load], material=pd.NeoHookean(E=E, nu=0.3, density=1.0)
    )
    with pytest.raises(pd.CaseError, match=message):
        pd.run(case, tmp_path)


def test_a_path_refuses_a_pressure_in_cracks(tmp_path):
    law = pd.PointDamage(pd.softening.Linear(), Gc=1.0, onset=0.02, split=pd.split.Whole())
    case = scene(2, solver=pd.PathFollowing(pd.Dissipation(step=0.01)), damage=law)
    case = dataclasses.replace(case, conditions=[case.conditions[0], pd.CrackPressure(pd.region.All(), 1.0)])
    with pytest.raises(pd.CaseError, match="do not depend on the displacement"):
        pd.run(case, tmp_path)
