"""Bodies of unlike spacings that are tied: patch test, tangent, ranks, and what is refused."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import pdpetsc as pd
from pdpetsc.declare.region import region_of_name
from tests.commands import results

E, NU = 1000.0, 0.3


def stacked(dim=2, spacings=(0.25, 0.2), traction=(3.0, 10.0), **changes):
    """Return a block on rollers with another one tied on top of it, which tractions pull and shear."""
    low, high, one = (0.0,) * dim, (1.0,) * dim, np.eye(dim)[-1]
    axis = "xyz"[dim - 1]
    parts = {
        "lower": pd.LatticeNodes(low, high, spacings[0]),
        "upper": pd.LatticeNodes(tuple(low + one), tuple(high + one), spacings[1]),
    }
    shear, pull = traction
    loads = [
        pd.Traction(f"upper +{axis}", **{"x": shear, axis: pull}),
        pd.Traction(f"lower -{axis}", **{"x": -shear, axis: -pull}),
    ]
    for name in parts:
        loads += [
            pd.Traction(f"{name} +x", **{axis: shear, "x": 0.0}),
            pd.Traction(f"{name} -x", **{axis: -shear, "x": 0.0}),
        ]
    held = [pd.Displacement(pd.region.Nearest(low), **dict.fromkeys("xyz"[:dim], 0.0))]
    held.append(pd.Displacement(pd.region.Nearest(np.eye(dim)[0]), **dict.fromkeys("xyz"[1:dim], 0.0)))
    if dim == 3:
        held.append(pd.Displacement(pd.region.Nearest(np.eye(dim)[1]), z=0.0))
    case = pd.Case(
        particles=pd.Bodies(parts),
        material=pd.LinearElastic(E=E, nu=NU, **({"plane": "stress"} if dim == 2 else {})),
        conditions=[*held, *loads, pd.Tied(f"lower +{axis}", f"upper -{axis}")],
        fields=[pd.stress, pd.displacement],
        history={"top": pd.Mean(pd.displacement, axis, f"upper +{axis}")},
    )
    return dataclasses.replace(case, **changes)


@pytest.mark.parametrize(("dim", "spacings"), [(2, (0.25, 0.2)), (2, (0.1, 0.25)), (3, (0.5, 0.25))])
def test_tension_and_shear_pass_uniformly(dim, spacings, tmp_path):
    run = pd.run(stacked(dim, spacings), tmp_path)
    stress, last = run.field("stress"), dim - 1
    np.testing.assert_allclose(stress[:, last, last], 10.0, rtol=1e-6)
    np.testing.assert_allclose(stress[:, 0, last], 3.0, rtol=1e-6)
    np.testing.assert_allclose(stress[:, 0, 0], 0.0, atol=1e-5)
    assert run.history[f"tie_{'xyz'[last]}"][-1] == pytest.approx(10.0, rel=1e-6)
    # The tie lengthens by 1 / 1000 of a spacing times the strain.
    assert run.history["top"][-1] == pytest.approx(2.0 * 10.0 / E, rel=1e-3)


def test_the_stiffness_follows_the_moduli_of_a_graded_material(tmp_path):
    """A modulus that is written as the factor of a graded material is the modulus of the body."""
    law = pd.Graded(pd.LinearElastic(E=1.0, nu=NU, plane="stress"), factor=lambda x: np.full(len(x), E))
    whole, graded = (
        pd.run(stacked(**more), tmp_path / name).history["top"] for name, more in (("E", {}), ("f", {"material": law}))
    )
    np.testing.assert_allclose(graded, whole, rtol=1e-9)


TEXT = """
import pdpetsc as pd

def case():
    left, right = pd.LatticeNodes((0.0, 0.0), (2.0, 1.0), 0.125), pd.LatticeNodes((2.0, 0.0), (5.0, 1.0), 0.2)
    parts = {"left": left, "right": right}
    return pd.Case(
        particles=pd.Bodies(parts),
        material=pd.NeoHookean(E=1000.0, nu=0.3),
        conditions=[pd.Clamp("left -x"), pd.Traction("right +x", y=-1.0), pd.Tied("left +x", "right -x")],
        history={"tip": pd.Mean(pd.displacement, "y", "right +x")},
        results=lambda h: {"tip": h["tip"][-1], "shear": h["tie_y"][-1]},
    )
"""


@pytest.mark.long
def test_a_cantilever_of_two_lattices_bends_as_one(tmp_path):
    """The force on the left part is that at its end; the deflection is that of a bar of one lattice, on any ranks."""
    path = tmp_path / "bent.py"
    path.write_text(TEXT)
    one = results(path, ranks=1, output=tmp_path / "one")["results"]
    assert one["shear"] == pytest.approx(-1.0, rel=1e-3)
    whole = TEXT.replace("right +x", "+x").replace("pd.Bodies(parts)", "pd.LatticeNodes((0.0, 0.0), (5.0, 1.0), 0.125)")
    whole = whole.replace('"left -x"', '"-x"').replace(', pd.Tied("left +x", "right -x")', "")
    whole = whole.replace(', "shear": h["tie_y"][-1]', "")
    path_whole = tmp_path / "whole.py"
    path_whole.write_text(whole)
    assert one["tip"] == pytest.approx(results(path_whole, output=tmp_path / "whole")["results"]["tip"], rel=0.01)
    free = ["-pd_jacobian", "matfree"]
    for name, words, ranks in (("two", [], 2), ("three", [], 3), ("free", free, 1), ("free three", free, 3)):
        other = results(path, *words, ranks=ranks, output=tmp_path / name)["results"]
        assert other == pytest.approx(one, rel=1e-6), name


def pressed(joint, gap=0.0):
    """Return two solid blocks that are joined, or one block, whose top is pressed down."""
    particles, sides, more = pd.LatticeNodes((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), 1.0 / 8), ("-z", "+z"), []
    if joint is not None:
        blocks = {
            "lower": pd.LatticeNodes((0.0, 0.0, 0.0), (1.0, 1.0, 0.5), 1.0 / 8),
            "upper": pd.LatticeNodes((0.0, 0.0, 0.5 + gap), (1.0, 1.0, 1.0 + gap), 1.0 / 10),
        }
        particles, sides, more = pd.Bodies(blocks), ("lower -z", "upper +z"), [joint]
    ends = [pd.Displacement(side, x=0.0, y=0.0, z=z) for side, z in zip(sides, (0.0, -0.01 - gap), strict=True)]
    return pd.Case(particles=particles, material=pd.LinearElastic(1.0, 0.3), conditions=[*ends, *more])


JOINTS = {
    "tied": (pd.Tied("lower +z", "upper -z"), 0.0, 1.2),
    "contact": (pd.BodyContact("lower +z", "upper -z"), 0.0, 1.5),
    "friction": (pd.BodyContact("lower +z", "upper -z", friction=0.3), 0.0, 1.5),
    # The bodies meet during the step, in four Newton iterations.
    "gap": (pd.BodyContact("lower +z", "upper -z"), 0.005, 2.5),
}


@pytest.mark.long
def test_stiff_springs_cost_no_iterations_without_a_matrix(tmp_path):
    """A tie is a thousand times, and contact ten times, as stiff as the body between two particles."""

    def iterations(name, joint, gap):
        result = pd.run(pressed(joint, gap), tmp_path / name, options={"pd_jacobian": "matfree"})
        return sum(step["linear_iterations"] for step in result.summary["steps"])

    whole = iterations("one", None, 0.0)
    for name, (joint, gap, most) in JOINTS.items():
        assert iterations(name, joint, gap) < most * whole, name


def test_what_cannot_be_tied_is_refused():
    apart = stacked()
    parts = apart.particles.parts
    far = pd.LatticeNodes((0.0, 1.5), (1.0, 2.5), 0.2)
    with pytest.raises(pd.CaseError, match=r"No facets of Tied condition 9 overlap within a gap of 0\.1 spacings"):
        pd.prepare(dataclasses.replace(apart, particles=pd.Bodies({**parts, "upper": far})))
    loose = dataclasses.replace(apart, conditions=apart.conditions[:-1])
    with pytest.raises(pd.CaseError, match="rigid motions"):
        pd.prepare(loose)


@pytest.mark.parametrize(
    "again",
    [
        ("lower +y", "upper -y"),
        ("upper -y", "lower"),
        ("lower +y", pd.region.Where(lambda x: (x[:, 0] > 0.5) & (x[:, 1] > 0.9))),
    ],
)
def test_facets_that_are_tied_twice_are_refused(again):
    """Each of two equal ties would report half the force, and together they would be twice as stiff."""
    case = stacked()
    second = pd.Tied(*again, name="again")
    with pytest.raises(pd.CaseError, match="between which Tied condition 9 acts already"):
        pd.prepare(dataclasses.replace(case, conditions=[*case.conditions, second]))


def test_halves_of_a_side_may_be_tied_one_by_one(tmp_path):
    case, top = stacked(), region_of_name("lower +y")
    halves = {
        "left": top & pd.region.Where(lambda x: x[:, 0] < 0.45),
        "right": top & pd.region.Where(lambda x: x[:, 0] > 0.45),
    }
    ties = [pd.Tied(half, "upper -y", name=name) for name, half in halves.items()]
    run = pd.run(dataclasses.replace(case, conditions=[*case.conditions[:-1], *ties]), tmp_path)
    assert run.history["left_y"][-1] + run.history["right_y"][-1] == pytest.approx(10.0, rel=1e-6)


@pytest.mark.parametrize(("pull", "refused"), [(0.01, True), (0.0, False)])
def test_facets_that_conditions_hold_apart_are_refused(pull, refused):
    """The traction between them would be the stiffness of the tie times what they are apart."""
    case = stacked()
    held = [pd.Displacement("lower", x=0.0, y=lambda x, t: 0.1 * t * x[:, 1])]
    held.append(pd.Displacement("upper", y=lambda x, t: 0.1 * t * x[:, 1] + pull * t))
    case = dataclasses.replace(case, conditions=[*held, case.conditions[-1]], steps=pd.Steps(2))
    if refused:
        with pytest.raises(pd.CaseError, match=r"Tied condition 3 ties .* pairs .* hold apart at step time 0\.5"):
            pd.prepare(case)
    else:
        pd.prepare(case)


def test_facets_at_a_mirror_plane_move_together():
    """The images of particles beyond the plane move the other way."""
    parts = {"lower": pd.Lattice((0.0, 0.0), (1.0, 1.0), 0.25), "upper": pd.Lattice((0.0, 1.0), (1.0, 2.0), 0.2)}
    strained = {"x": lambda x, t: 0.1 * t * x[:, 0], "y": lambda x, t: 0.1 * t * x[:, 1]}
    held = [pd.Displacement(part, **strained) for part in parts]
    tie = pd.Tied("lower +y", "upper -y")
    pd.prepare(
        stacked(particles=pd.Bodies(parts), symmetry=[pd.Symmetry("x", 0.0)], conditions=[*held, tie], history={})
    )
