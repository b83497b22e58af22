"""A converged run whose numbers are wrong says so."""

from dataclasses import dataclass

import numpy as np
import pytest

import pdpetsc as pd


def warned(case, folder, words):
    return any(words in warning for warning in pd.run(case, folder).summary["warnings"])


@pytest.mark.parametrize("unit", [1.0, 1e-6])
@pytest.mark.parametrize(
    ("law", "strain", "warns"),
    [("LinearElastic", 0.5, True), ("LinearElastic", 0.05, False), ("Hencky", 0.5, False), ("BondBased", 0.5, False)],
)
def test_a_strain_that_is_not_small(law, strain, warns, unit, tmp_path):
    """With a wrong unit of E the bar is half as long again."""
    end = strain * 4.0 * unit
    case = pd.Case(
        particles=pd.Lattice((0.0, 0.0), (4.0 * unit, unit), 0.25 * unit),
        material=pd.BondBased(1.0, kinematics="finite") if law == "BondBased" else getattr(pd, law)(1.0, 0.0),
        conditions=[
            pd.Displacement(pd.region.Slab("x", high=0.25 * unit), x=0.0, y=0.0),
            pd.Displacement(pd.region.Slab("x", low=3.75 * unit), x=end, y=0.0),
        ],
        steps=pd.Steps(2),
    )
    assert warned(case, tmp_path, "in a material of small strain") == warns


def test_a_beam_that_turns_in_a_material_of_small_strain(tmp_path):
    """Strains are small, and rotations are not."""

    def turned(angle):
        R = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]) - np.eye(2)
        moved = {"x": lambda x, t: t * (x @ R.T)[:, 0], "y": lambda x, t: t * (x @ R.T)[:, 1]}
        return pd.Case(
            particles=pd.Lattice((0.0, 0.0), (2.0, 0.5), 0.125),
            material=pd.LinearElastic(1.0, 0.25),
            conditions=[pd.Displacement(pd.region.Slab("x", high=0.25) | pd.region.Slab("x", low=1.75), **moved)],
        )

    assert warned(turned(0.3), tmp_path / "far", "in a material of small strain")
    assert not warned(turned(0.03), tmp_path / "near", "in a material of small strain")


def test_a_crack_that_has_made_its_displacements_large_is_not_counted(tmp_path):
    """The failed layer is stretched without bound, the halves beside it are not strained."""
    half = pd.region.Slab("x", high=2.0)
    case = pd.Case(
        particles=pd.Lattice((0.0, 0.0), (4.0, 1.0), 0.25),
        material=pd.LinearElastic(1.0, 0.0),
        damage=pd.PointDamage(pd.softening.Linear(), Gc=1e-6, onset=1e-3),
        conditions=[pd.Displacement(half, x=0.0, y=0.0), pd.Displacement(~half, x=1.0, y=0.0)],
    )
    assert not warned(case, tmp_path, "in a material of small strain")


@pytest.mark.parametrize(("solver", "warns"), [("steps", True), ("path", False)])
def test_a_jump_of_damage_within_a_step(solver, warns, tmp_path):
    """A plate with a notch snaps back: load steps of its ends lose the energy that it releases, a path does not."""
    low, high = pd.region.Slab("y", high=1.0), pd.region.Slab("y", low=9.0)
    case = pd.Case(
        particles=pd.Lattice((0.0, 0.0), (10.0, 10.0), 0.5),
        horizon=1.0075,
        material=pd.LinearElastic(1000.0, 0.3, plane="stress"),
        scheme=pd.Correspondence(),
        control=pd.Silling(1.0),
        cracks=[pd.Segment((-1.0, 5.0), (4.0, 5.0))],
        damage=pd.PointDamage(pd.softening.Linear(), Gc=0.05, strength=4.0, protected=low | high),
        conditions=[pd.Displacement(low, x=0.0, y=0.0), pd.Displacement(high, x=0.0, y=0.125)],
        solver=pd.PathFollowing(pd.Dissipation(step=0.02)) if solver == "path" else pd.Newton(),
        steps=pd.Steps(10),
        history={"broken": pd.DissipatedEnergy()},
        results=lambda h: {"broken": h["broken"][-1]},
    )
    assert warned(case, tmp_path, "Work and energies differ") == warns
    assert pd.open(tmp_path)["broken"] == pytest.approx(0.05 * 6.0, rel=0.1)


class Bed(pd.Term):
    """Springs that tell no energy."""

    def add_row_force(self, state, r):
        r += 0.5 * state.u

    def linearise(self, state):
        return [pd.PointBlocks(np.broadcast_to(0.5 * np.eye(2), (len(state.own), 2, 2)))]


@dataclass(frozen=True)
class OnBed(pd.ExtraTerm):
    def build(self, body):
        return Bed()


def test_a_term_without_an_energy_is_no_jump(tmp_path):
    case = pd.Case(
        particles=pd.Lattice((0.0, 0.0), (4.0, 1.0), 0.25),
        material=pd.LinearElastic(1.0, 0.0),
        damage=pd.PointDamage(pd.softening.Linear(), Gc=1e-2, onset=0.05),
        conditions=[
            pd.Displacement(pd.region.Slab("x", high=0.25), x=0.0, y=0.0),
            pd.Displacement(pd.region.Slab("x", low=3.75), x=0.02, y=0.0),
        ],
        terms=[OnBed()],
    )
    assert not warned(case, tmp_path, "Work and energies differ")
