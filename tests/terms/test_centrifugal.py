"""Bodies that spin: a bar, a disc, tangent, axes, refusals."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import pdpetsc as pd

E, RHO, LENGTH, SPEED = 1000.0, 2.0, 10.0, 1.5


def bar(unit=1.0, **changes):
    """Return a bar that is held at the axis."""
    given = {
        "particles": pd.LatticeNodes((0.0,), (LENGTH * unit,), 0.1 * unit),
        "horizon": 0.2015 * unit,
        "material": pd.LinearElastic(E=E, nu=0.0, density=RHO / unit**2),
        "conditions": [pd.Clamp("-x"), pd.Centrifugal(pd.region.All(), SPEED, about=(0.0,))],
        "history": {"tip": pd.Mean(pd.displacement, "x", "+x"), "hub": pd.Reaction("x", "-x")},
        "steps": pd.Steps(2),
    }
    return pd.Case(**{**given, **changes})


@pytest.mark.parametrize("unit", [1.0, 1e12])
def test_a_bar_stretches_and_pulls_itself_further(unit, tmp_path):
    """``u'' + k^2 (x + u) = 0`` with ``k^2 = rho w^2 / E``: ``u(l) = tan(k l) / k - l``."""
    k = SPEED * np.sqrt(RHO / E)
    history = pd.run(bar(unit), tmp_path).history
    assert history["tip"][-1] / unit == pytest.approx(np.tan(k * LENGTH) / k - LENGTH, rel=2e-3)
    # Half of the speed after half of the load, and the hub carries the whole force.
    half = 0.5 * k
    assert history["tip"][1] / unit == pytest.approx(np.tan(half * LENGTH) / half - LENGTH, rel=2e-3)
    assert history["hub"][-1] == pytest.approx(-E * (1.0 / np.cos(k * LENGTH) - 1.0), rel=2e-3)


def test_a_disc_has_the_stress_of_its_closed_form(tmp_path):
    """A solid disc in plane stress: ``(3 + nu) / 8 rho w^2 R^2`` in its middle."""
    radius, speed = 1.0, 0.1
    disc = pd.Case(
        particles=pd.LatticeNodes((0.0, 0.0), (1.0, 1.0), 0.04, keep=pd.region.Sphere((0.0, 0.0), 1.0)),
        horizon=0.04 * 2.015,
        material=pd.LinearElastic(E=E, nu=0.3, plane="stress", density=RHO),
        conditions=[pd.Roller("-x"), pd.Roller("-y"), pd.Centrifugal(pd.region.All(), speed, about=(0.0, 0.0))],
        history={"middle": pd.Mean(pd.stress, "xx", pd.region.Sphere((0.0, 0.0), 0.15))},
    )
    exact = 3.3 / 8.0 * RHO * speed**2 * radius**2
    assert pd.run(disc, tmp_path).history["middle"][-1] == pytest.approx(exact, rel=0.03)


def test_forces_have_their_tangent_and_no_part_along_the_axis(rng):
    case = pd.Case(
        particles=pd.LatticeNodes((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), 0.5),
        horizon=0.5 * 2.015,
        material=pd.NeoHookean(E=E, nu=0.3, density=RHO),
        conditions=[pd.Clamp("-z"), pd.Centrifugal(pd.region.All(), SPEED, (0.2, 0.1, 0.0), axis=(1.0, 2.0, 2.0))],
    )
    problem = pd.prepare(case).problem
    (term,) = (one for one in problem.terms if type(one).__name__ == "CentrifugalForce")
    u, du = (rng.uniform(-0.1, 0.1, (27, 3)) for _ in range(2))

    def force(u):
        r = np.zeros_like(u)
        term.add_row_force(problem.state(u, 0.8), r)
        return r

    np.testing.assert_allclose(force(u) @ (1.0, 2.0, 2.0), 0.0, atol=1e-12)
    (product,) = term.linearise(problem.state(u, 0.8))
    exact = np.einsum("kij,kj->ki", product.blocks, du)
    np.testing.assert_allclose(force(u + du) - force(u), exact, atol=1e-12)


def test_what_cannot_spin_is_refused():
    bare = dataclasses.replace(bar(), material=pd.LinearElastic(E=E, nu=0.0))
    with pytest.raises(pd.CaseError, match="needs the density of each material"):
        pd.prepare(bare)
    with pytest.raises(pd.CaseError, match="through a point of 2 numbers; give 1"):
        pd.prepare(bar(conditions=[pd.Clamp("-x"), pd.Centrifugal(pd.region.All(), 1.0, (0.0, 0.0))]))
    spun = [pd.Displacement(pd.region.Slab("x", high=1.0), x=0.0), bar().conditions[1]]
    with pytest.raises(pd.CaseError, match=r"Centrifugal condition 2 grows with the distance .* periodic along x"):
        pd.prepare(bar(particles=pd.Lattice((0.0,), (LENGTH,), 0.1), cell=pd.Cell(0.0, LENGTH), conditions=spun))


@pytest.mark.parametrize(("axis", "refused"), [((0, 0, 1), ""), ((1, 0, 0), "z"), ((0, 1, 1), "z")])
def test_a_cell_may_be_periodic_along_the_axis_of_rotation(axis, refused):
    case = pd.Case(
        particles=pd.Lattice((0.0, 0.0, 0.0), (1.0, 1.0, 2.0), 0.25),
        material=pd.NeoHookean(E=E, nu=0.3, density=RHO),
        cell=pd.Cell((0.0, 0.0, 0.0), (1.0, 1.0, 2.0), "z"),
        conditions=[
            pd.Displacement(pd.region.Slab("x", high=0.25), x=0.0, y=0.0, z=0.0),
            pd.MeanStrain(zz=0.0),
            pd.Centrifugal(pd.region.All(), SPEED, (0.0, 0.0, 0.0), axis=axis),
        ],
    )
    if not refused:
        pd.prepare(case)
        return
    with pytest.raises(pd.CaseError, match=f"the cell is periodic along {refused}"):
        pd.prepare(case)
