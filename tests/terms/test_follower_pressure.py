"""Pressure on the deformed surface: areas, tangent, a ring inflated to twice its radius, ranks, units, refusals."""

from __future__ import annotations

import numpy as np
import pytest

import pdpetsc as pd
from tests.commands import results

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


def test_a_path_needs_dead_loads(tmp_path):
    with pytest.raises(pd.CaseError, match="do not depend on the displacement"):
        pd.run(scene(2, solver=pd.PathFollowing(pd.Opening("y", pd.region.Face("+y"), step=0.01, end=0.1))), tmp_path)
