"""Repulsion of particles without a bond: tangent, momentum, collisions, crack faces that close, ranks."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import pdpetsc as pd
from tests.commands import results


def bars(gap=0.1, v=0.01, **changes):
    """Return two bars of bonds, of which one hits the other at its end; 4 cells are across."""
    one = pd.Lattice((0.0, 0.0), (10.0, 1.0), 0.25)
    two = pd.Lattice((10.0 + gap, 0.0), (20.0 + gap, 1.0), 0.25)
    case = pd.Case(
        particles=pd.Bodies({"one": one, "two": two}),
        material=pd.BondBased(E=1.0, density=1.0),
        horizon=0.25 * 3.015,
        conditions=[pd.InitialVelocity("one", x=v), pd.ParticleContact(distance=0.25)],
        solver=pd.Explicit(end=50.0, records=100),
        fields=[pd.displacement],
        history={
            "one": pd.Mean(pd.velocity, "x", "one"),
            "two": pd.Mean(pd.velocity, "x", "two"),
            "error": pd.EnergyError(),
        },
    )
    return dataclasses.replace(case, **changes)


def test_bars_that_collide_keep_momentum_and_energy(tmp_path):
    """A pair that closes within a step has an error of energy, which falls with the step."""
    run = pd.run(bars(), tmp_path / "coarse")
    one, two = np.array(run.history["one"]) / 0.01, np.array(run.history["two"]) / 0.01
    np.testing.assert_allclose(one + two, 1.0, atol=1e-9)
    assert two[-1] == pytest.approx(1.0, abs=0.05)
    assert max(run.history["fragments_pairs"]) > 0.0
    assert np.abs(run.history["error"]).max() < 0.02
    fine = pd.run(bars(solver=pd.Explicit(end=50.0, records=100, safety=0.2)), tmp_path / "fine")
    assert np.abs(fine.history["error"]).max() < 1e-3


def test_the_stiffness_follows_the_moduli_of_a_graded_material(tmp_path):
    """Bodies whose modulus is written as the factor of a graded material repel each other as others."""
    law = pd.Graded(pd.BondBased(E=1e-4, density=1.0), factor=lambda x: np.full(len(x), 1e4))
    both = [(pd.region.Named("one"), pd.BondBased(E=1.0, density=1.0)), (pd.region.Named("two"), law)]
    short = pd.Explicit(end=25.0, records=5)
    plain = pd.run(bars(solver=short), tmp_path / "plain").history["two"]
    assert plain[-1] > 1e-3
    for name, material in {"graded": law, "one of two": both}.items():
        found = pd.run(bars(solver=short, material=material), tmp_path / name).history["two"]
        np.testing.assert_allclose(found, plain, rtol=1e-6, atol=1e-12)


TEXT = """
import pdpetsc as pd

def case(v=0.02):
    parts = {name: pd.Lattice((low, 0.0), (low + 2.0, 1.0), 0.25) for name, low in (("one", 0.0), ("two", 3.1))}
    return pd.Case(
        particles=pd.Bodies(parts),
        material=pd.BondBased(E=1.0, density=1.0),
        horizon=0.25 * 3.015,
        conditions=[pd.InitialVelocity("one", x=v, y=0.1 * v), pd.ParticleContact(distance=0.25)],
        solver=pd.Explicit(end=80.0, records=40),
        history={"one": pd.Mean(pd.velocity, "x", "one"), "two": pd.Mean(pd.velocity, "x", "two")},
        results=lambda h: {"one": h["one"][-1], "two": h["two"][-1], "pairs": max(h["fragments_pairs"])},
    )
"""


def test_bodies_of_other_ranks_are_met(tmp_path):
    """The bodies are 1.1 apart at first, further than any bond: no rank knows the other's particles."""
    path = tmp_path / "met.py"
    path.write_text(TEXT)
    one = results(path, ranks=1, output=tmp_path / "one")["results"]
    assert one["pairs"] > 0.0 and one["two"] > 0.01
    for ranks in (2, 3):
        other = results(path, ranks=ranks, output=tmp_path / f"{ranks}")["results"]
        assert other == pytest.approx(one, rel=1e-9), ranks


def cut(push=-0.02, **changes):
    """Return a column that a crack cuts across, whose upper part is pressed on the lower one."""
    case = pd.Case(
        particles=pd.Lattice((0.0, 0.0), (1.0, 2.0), 0.125),
        material=pd.BondBased(E=1000.0, plane="stress"),
        horizon=0.125 * 3.015,
        cracks=[pd.Segment((-1.0, 1.0), (2.0, 1.0))],
        conditions=[
            pd.Displacement(pd.region.Slab("y", high=0.3), x=0.0, y=0.0),
            pd.Displacement(pd.region.Slab("y", low=1.7), x=0.0, y=push),
            pd.ParticleContact(),
        ],
        history={"force": pd.Reaction("y", pd.region.Slab("y", high=0.3))},
        steps=pd.Steps(2),
    )
    return dataclasses.replace(case, **changes)


def test_faces_of_a_crack_carry_pressure_and_no_tension(tmp_path):
    pressed = pd.run(cut(), tmp_path / "pressed").history["force"][-1]
    whole = pd.run(cut(cracks=()), tmp_path / "whole").history["force"][-1]
    open_ = pd.run(cut(push=0.02), tmp_path / "open").history["force"][-1]
    assert 0.5 * whole < pressed < whole
    assert abs(open_) < 1e-9 * whole


def test_fragments_are_pushed_together(tmp_path):
    """A column is torn in the middle, where its bonds are weak, and pressed again."""
    weak = pd.region.Slab("y", 0.9, 1.1)
    there_and_back = pd.Table([0.0, 0.5, 1.0], [0.0, 1.0, -1.0])
    case = cut(
        cracks=(),
        damage=pd.Brittle(pd.ConstantCritical(0.005)),
        conditions=[
            pd.Displacement(pd.region.Slab("y", high=0.3), x=0.0, y=0.0),
            pd.Displacement(pd.region.Slab("y", low=1.7), x=0.0, y=0.02, schedule=there_and_back),
            pd.ParticleContact(),
        ],
        steps=pd.Steps(8),
        material=[(weak, pd.BondBased(E=500.0, plane="stress")), (~weak, pd.BondBased(E=1000.0, plane="stress"))],
    )
    history = pd.run(case, tmp_path).history
    assert abs(history["force"][4]) < 1e-6 * abs(history["force"][-1])
    assert history["fragments_pairs"][4] == 0.0 and history["fragments_pairs"][-1] > 7.0
    assert history["force"][-1] > 3.0


def test_forces_have_their_tangent_and_balance(rng):
    problem = pd.prepare(cut()).problem
    (term,) = (one for one in problem.terms if type(one).__name__ == "ParticleContactForces")
    n, dim = problem.body.cloud.n_owned, 2
    x = problem.body.cloud.x[:n]
    u = 2e-3 * rng.uniform(-1.0, 1.0, (n, dim)) + np.where(x[:, 1:] > 1.0, -0.03, 0.0) * (0.3, 1.0)

    def force(u):
        f = np.zeros((n, dim))
        term.add_force(problem.state(u, 0.5), f)
        return f

    f = force(u)
    assert np.abs(f).max() > 0.1
    np.testing.assert_allclose(f.sum(axis=0), 0.0, atol=1e-12 * np.abs(f).sum())
    y = x + u
    moment = (y[:, 0] * f[:, 1] - y[:, 1] * f[:, 0]).sum()
    assert abs(moment) < 1e-12 * np.abs(f).sum()
    du, h = rng.uniform(-1.0, 1.0, (n, dim)), 1e-7
    exact = np.zeros((n, dim))
    for product in term.linearise(problem.state(u, 0.5)):
        product.add_product(du, exact, np.arange(n, dtype=np.int32))
    difference = (force(u + h * du) - force(u - h * du)) / (2.0 * h)
    assert np.abs(difference - exact).max() < 1e-7 * np.abs(exact).max()
    energies = [term.energy(problem.state(u + sign * h * du, 0.5)) for sign in (1.0, -1.0)]
    assert (energies[0] - energies[1]) / (2.0 * h) == pytest.approx((f * du).sum(), rel=1e-6)


@pytest.mark.parametrize("solver", [pd.Newton(), pd.DynamicRelaxation()])
def test_a_step_in_which_blocks_pass_each_other_is_halved(solver, tmp_path):
    """The upper block would be below the lower one after one step; nothing touches at its start and at its end."""
    lower, upper = pd.Lattice((0.0, 0.0), (1.0, 0.5), 0.125), pd.Lattice((0.0, 1.0), (1.0, 1.25), 0.125)
    case = cut(
        particles=pd.Bodies({"lower": lower, "upper": upper}),
        cracks=(),
        conditions=[
            pd.Displacement("lower -y", x=0.0, y=0.0),
            pd.Displacement("upper +y", x=0.0, y=-1.6),
            pd.ParticleContact(),
        ],
        history={},
        steps=pd.Steps(1),
        solver=solver,
    )
    with pytest.raises(pd.SolveError, match="No convergence"):
        pd.run(case, tmp_path)


def test_images_are_refused():
    with pytest.raises(pd.CaseError, match="does not act on images"):
        pd.prepare(cut(symmetry=[pd.Symmetry("x", 0.0)], cracks=()))


def test_fragments_are_listed_with_mass_and_velocity(tmp_path):
    """A bar is torn by velocities that differ between its halves, which keep their momentum together."""
    case = bars(
        particles=pd.Lattice((0.0, 0.0), (4.0, 1.0), 0.25),
        conditions=[pd.InitialVelocity(pd.region.Slab("x", low=2.0), x=1.0)],
        damage=pd.Brittle(pd.ConstantCritical(0.01)),
        solver=pd.Explicit(end=0.5, records=10),
        history={},
    )
    pd.run(case, tmp_path)
    names, *rows = (line.split(",") for line in (tmp_path / "fragments.csv").read_text().split())
    table = {name: np.array([float(row[k]) for row in rows]) for k, name in enumerate(names)}
    assert len(rows) == 2
    assert table["mass"] == pytest.approx(table["volume"]) and table["mass"].sum() == pytest.approx(4.0)
    assert table["mass"] @ table["vx"] == pytest.approx(2.0, rel=1e-9)
    assert sorted(table["vx"]) == pytest.approx([0.0, 1.0], abs=0.1)
    assert sorted(table["x"]) == pytest.approx([1.0, 3.5], abs=0.1)
    pd.run(dataclasses.replace(case, damage=None), tmp_path)
    assert (tmp_path / "earlier" / "fragments.csv").exists() and not (tmp_path / "fragments.csv").exists()


@pytest.mark.parametrize("dim", [2, 3])
def test_forces_have_no_resultant_and_no_moment(dim, rng):
    """Two blocks at random displacements, pressed together, sheared and turned."""
    low, high, up, contact = (0.0,) * dim, (1.0,) * dim, np.eye(dim)[-1], pd.ParticleContact()
    case = pd.Case(
        particles=pd.Bodies({"one": pd.Lattice(low, high, 0.25), "two": pd.Lattice(low + up, high + up, 0.25)}),
        material=pd.NeoHookean(E=1.0, nu=0.3),
        conditions=[*(pd.Displacement(of, **dict.fromkeys("xyz"[:dim], 0.0)) for of in ("one", "two")), contact],
    )
    problem = pd.prepare(case).problem
    (term,) = (one for one in problem.terms if type(one).__name__ == "ParticleContactForces")
    cloud = problem.body.cloud
    u = 0.02 * rng.uniform(-1.0, 1.0, cloud.x.shape) - np.where(cloud.body[:, None] == 1, 0.1 * up, 0.0)
    turn = np.linalg.qr(np.eye(dim) + 0.5 * rng.standard_normal((dim, dim)))[0]
    y, f = (cloud.x + u) @ turn.T, np.zeros((len(u), 3))
    term.add_force(problem.state(y - cloud.x, 1.0), f[:, :dim])
    size = np.abs(f).sum()
    assert size > 0.1
    np.testing.assert_allclose(f.sum(axis=0), 0.0, atol=1e-13 * size)
    moment = np.cross(np.pad(y, ((0, 0), (0, 3 - dim))), f).sum(axis=0)
    np.testing.assert_allclose(moment, 0.0, atol=1e-13 * size)
