"""Mirror planes: halves, quarters and eighths are the whole body, for every model and solver, on any rank count."""

import dataclasses
import itertools

import numpy as np
import pytest
from scipy.spatial import cKDTree

import pdpetsc as pd
from pdpetsc.gradient import stress_points
from tests.commands import ROOT, field, jacobian_ratios, results, run
from tests.scenes import ALL_CONTROLS, BONDS

TOP = {1: (5.0,), 2: (4.0, 5.0), 3: (3.0, 3.0, 4.0)}
ELASTIC = pd.Hencky(E=10.0, nu=0.3)


def pulled(planes, whole, dim=2, pull=0.4, **changes):
    """Return a block, the part before its mirror planes or the whole of it, pulled on the middle of its upper end.

    The pull is along an axis without a plane where there is one; else the whole block is pulled on both ends.
    """
    letters = "xyz"[:dim]
    high = np.array(TOP[dim])
    low = np.array([-top if whole and letter in planes else 0.0 for letter, top in zip(letters, high, strict=True)])
    axis = next((letter for letter in reversed(letters) if letter not in planes), letters[-1])
    along = letters.index(axis)
    middle = {letter: 0.0 for letter in letters if letter != axis}

    def end(first, last):
        corners = np.stack([-0.6 * high, 0.6 * high])
        corners[:, along] = first, last
        return pd.region.Box(*corners)

    conditions = [pd.Displacement(end(high[along] - 1.0, high[along]), **middle, **{axis: pull})]
    if axis not in planes:
        conditions.append(pd.Displacement(end(0.0, 1.0), **middle, **{axis: 0.0}))
    elif whole:
        conditions.append(pd.Displacement(end(low[along], low[along] + 1.0), **middle, **{axis: -pull}))
    declared = {
        "particles": pd.Lattice(low, high, 1.0),
        "horizon": 2.015,
        "material": ELASTIC,
        "conditions": conditions,
        "symmetry": () if whole else tuple(pd.Symmetry(letter) for letter in planes),
    }
    return pd.Case(**(declared | changes))


def solved(case, options=None):
    """Return positions, fields and energies of all states of a case, on this process, and its last step time."""
    prepared = pd.prepare(case, options=options)
    solver = prepared.make_solver()
    try:
        states = []
        for converged in prepared.march(solver):
            solution = prepared.solution(converged.u, converged.t)
            fields = {f.__name__: f(solution).copy() for f in (pd.displacement, pd.stress, pd.lost_bonds)}
            states.append({**fields, **solution.energies, "broken": solution.broken_bonds})
        found = {name: np.array([state[name] for state in states]) for name in states[0]}
        return solution.x.copy(), found, converged.t
    finally:
        solver.destroy()


def assert_the_part_is_the_whole(part, whole, options=None, tolerance=1e-10):
    """Compare all states of both; return what was found of the whole."""
    x, found, t = solved(part, options)
    x_whole, found_whole, t_whole = solved(whole, options)
    apart, place = cKDTree(x_whole).query(x)
    assert apart.max() < 1e-9
    assert t == pytest.approx(t_whole, rel=tolerance)
    for name in ("displacement", "stress", "lost_bonds"):
        values = found_whole[name]
        assert np.abs(found[name] - values[:, place]).max() <= tolerance * np.abs(values).max(), name
    images = len(x_whole) // len(x)
    for name in ("strain", "control"):
        scale = np.abs(found_whole[name]).max()
        assert images * found[name] == pytest.approx(found_whole[name], abs=10.0 * tolerance * scale)
    return found_whole


def both(planes, options=None, tolerance=1e-10, **changes):
    """Compare a part of the block with the whole."""
    part, whole = (pulled(planes, whole, **changes) for whole in (False, True))
    return assert_the_part_is_the_whole(part, whole, options, tolerance)


@pytest.mark.parametrize(("dim", "planes"), [(1, "x"), (2, "x"), (2, "y"), (2, "xy"), (3, "y"), (3, "xz"), (3, "xyz")])
def test_a_part_is_the_whole(dim, planes):
    both(planes, dim=dim)


@pytest.mark.parametrize("scheme", [name for name in pd.SCHEMES if name != "stress_points"])
def test_a_part_is_the_whole_with_every_scheme(scheme):
    both("xy", scheme=pd.SCHEMES[scheme], horizon=3.015 if scheme in ("corrected", "higher_order") else 2.015)


def test_a_part_is_the_whole_with_stress_points_drawn_alike(monkeypatch):
    """The draws of a whole body have no symmetry of their own: they are made symmetric here."""
    drawn = stress_points._drawn
    part, whole = (pulled("xy", whole, scheme=pd.StressPoints()) for whole in (False, True))
    x_part, x_whole = (case.particles.chunk(0, 1).x for case in (part, whole))
    home = cKDTree(x_part).query(np.abs(x_whole))[1]
    turned = ((x_whole[:, 0] < 0.0) ^ (x_whole[:, 1] < 0.0)).astype(np.uint64)

    def symmetric(gid, seed):
        return drawn(home[gid], seed) ^ turned[gid] if len(gid) == len(x_whole) else drawn(gid, seed)

    monkeypatch.setattr(stress_points, "_drawn", symmetric)
    assert_the_part_is_the_whole(part, whole)


@pytest.mark.parametrize("control", [name for name in ALL_CONTROLS if name != "none"])
@pytest.mark.parametrize("material", ["hencky", "linear"])
def test_a_part_is_the_whole_with_every_control(control, material):
    chosen = ELASTIC if material == "hencky" else pd.LinearElastic(E=10.0, nu=0.3)
    found = both("xy", scheme=pd.Correspondence(), control=ALL_CONTROLS[control], material=chosen)
    assert found["control"][-1] > 0.0


@pytest.mark.parametrize("planes", ["x", "xy"])
@pytest.mark.parametrize("bonds", BONDS)
def test_a_part_is_the_whole_with_every_material_of_bonds(bonds, planes):
    both(planes, material=BONDS[bonds])


def test_plasticity_and_grading_are_those_of_the_whole():
    graded = pd.Graded(pd.J2(E=10.0, nu=0.3, yield_stress=0.3, hardening=1.0), lambda x: 1.0 + 0.1 * x[:, 1] ** 2)
    both("xy", material=graded, steps=pd.Steps(2))


@pytest.mark.parametrize("dim", [2, 3])
def test_without_a_matrix_and_by_relaxation_a_part_is_the_whole(dim):
    planes = "xyz"[:dim]
    both(planes, {"pd_jacobian": "matfree", "ksp_rtol": 1e-12}, dim=dim)
    if dim == 2:
        both(planes, {"pc_type": "gamg", "ksp_rtol": 1e-12}, control=pd.Silling(0.1))
        both(planes, tolerance=1e-8, solver=pd.DynamicRelaxation(1e-12))


BRITTLE = pd.Brittle(pd.ConstantCritical(0.06))
SOFTENING = pd.LinearSoftening(pd.ConstantCritical(0.04), ratio=2.0)


def cracked(planes, whole, **changes):
    """Return the block with a crack in the middle, on the plane across y where there is one, and a notch."""
    middle, notch = ((0.0, 0.0), (1.2, 0.0)), ((2.8, 2.0), (4.1, 2.0))
    if "y" not in planes:
        middle = ((0.0, 3.0), (1.2, 3.0))
    lines = [middle, notch]
    if whole:
        flips = itertools.product(*[(1, -1) if letter in planes else (1,) for letter in "xy"])
        lines = [[(a * x, b * y) for x, y in line] for a, b in flips for line in (middle, notch)]
    case = {"cracks": tuple(pd.Segment(*line) for line in lines), "damage": BRITTLE, "pull": 0.25}
    return pulled(planes, whole, **(case | changes))


def both_cracked(planes, options=None, tolerance=1e-10, least=1, **changes):
    """Compare a cracked part with the whole, in which bonds must break."""
    part, whole = (cracked(planes, whole, **changes) for whole in (False, True))
    found = assert_the_part_is_the_whole(part, whole, options, tolerance)
    print("broken", found["broken"])
    assert found["broken"].max() >= least
    return found


@pytest.mark.parametrize("planes", ["x", "xy"])
@pytest.mark.parametrize(
    "damage",
    [BRITTLE, SOFTENING, pd.ExponentialSoftening(pd.ConstantCritical(0.04), ratio=2.0, rate=2.0)],
    ids=["brittle", "linear", "exponential"],
)
@pytest.mark.parametrize("kinematics", ["small", "finite"])
def test_bonds_break_across_and_beside_a_plane_as_in_the_whole(kinematics, damage, planes):
    material = pd.BondBased(E=10.0, kinematics=kinematics)
    both_cracked(planes, material=material, damage=damage, steps=pd.Steps(2), tolerance=1e-8)


@pytest.mark.parametrize("effect", [pd.LargestStretch(), pd.PresentStretch()])
@pytest.mark.parametrize("scheme", ["sub_horizons", "correspondence"])
def test_bonds_of_gradients_break_as_in_the_whole(scheme, effect):
    damage = pd.LinearSoftening(pd.ConstantCritical(0.04), ratio=3.0, effect=effect)
    control = pd.Silling(0.3) if scheme == "correspondence" else None
    both_cracked(
        "xy", scheme=pd.SCHEMES[scheme], control=control, damage=damage, steps=pd.Steps(2), pull=0.2, tolerance=1e-8
    )


def test_bonds_that_fail_in_a_solid_break_as_in_the_whole():
    """An eighth, with bonds to images of images."""
    damage = pd.Brittle(pd.ConstantCritical(0.08))
    found = both("xyz", dim=3, material=pd.BondBased(E=10.0), damage=damage, tolerance=1e-8)
    assert found["broken"].max() > 0


@pytest.mark.parametrize("measure", [pd.BondStretch(step=0.1), None], ids=["bonds", "opening"])
def test_paths_are_those_of_the_whole(measure):
    end = pd.region.Box((-2.4, 4.0), (2.4, 5.0))
    solver = pd.PathFollowing(measure or pd.Opening("y", end, step=0.02, end=0.2), until=0.8, most=200)
    damage = pd.LinearSoftening(pd.ConstantCritical(0.03), ratio=2.5)
    found = both_cracked(
        "xy", material=pd.BondBased(E=10.0), damage=damage, solver=solver, least=0, tolerance=1e-6, pull=0.2
    )
    assert len(found["strain"]) > 5


def test_events_across_a_plane_are_those_of_the_whole():
    """A weak bond to the own image snaps in a bar pulled on both ends."""
    weak = pd.CriticalFunction(lambda length, middle: np.where(np.abs(middle[:, 0]) < 1e-9, 0.03, 0.05))
    found = both(
        "x", dim=1, horizon=1.015, material=pd.BondBased(E=10.0), damage=pd.Brittle(weak), solver=pd.EventDriven(),
        tolerance=1e-9,
    )  # fmt: skip
    assert found["broken"].max() == 1


def loaded(planes, whole, distribution, **changes):
    """Return the block under tractions on all faces that are no mirror planes, with its middle held."""
    case = pulled(planes, whole, **changes)
    low, high = (np.array(corner, dtype=float) for corner in (case.particles.low, case.particles.high))
    conditions = [pd.Displacement(pd.region.Nearest((0.0, 0.0)), x=0.0, y=0.0)]
    depth = 1e-6 if distribution in ("surface", "pressure") else 1.0
    for along, axis in enumerate("xy"):
        for side in (1.0,) if axis in planes and not whole else (1.0, -1.0):
            at = {"low": high[along] - depth} if side > 0.0 else {"high": low[along] + depth}
            face = pd.region.Slab(axis, **at)
            across = {"xy"[1 - along]: lambda x, t, b=1 - along: 0.05 * t * x[:, b]}
            if distribution == "pressure":
                conditions.append(pd.Pressure(face, 0.2))
            elif distribution == "surface":
                conditions.append(pd.Traction(face, **{axis: 0.3 * side}, **across))
            else:
                normal = side * np.eye(2)[along]
                given = {"normal": normal, "distribution": distribution}
                conditions.append(pd.Traction(face, **{axis: 0.3 * side}, **across, **given))
    return dataclasses.replace(case, conditions=conditions)


@pytest.mark.parametrize("planes", ["x", "xy"])
@pytest.mark.parametrize("distribution", ["surface", "pressure", "layer", "consistent"])
def test_tractions_beside_a_plane_are_those_of_the_whole(distribution, planes):
    changes = {"scheme": pd.Correspondence(), "control": pd.Silling(0.3), "material": pd.LinearElastic(E=10.0, nu=0.3)}
    # The stress of a consistent traction reaches two horizons into the body.
    horizon = 1.015 if distribution == "consistent" else 2.015
    part, whole = (loaded(planes, whole, distribution, horizon=horizon, **changes) for whole in (False, True))
    assert_the_part_is_the_whole(part, whole)


def test_a_consistent_traction_near_its_own_image_is_refused():
    with pytest.raises(pd.CaseError, match="own image behind a mirror plane"):
        pd.prepare(loaded("xy", False, "consistent", material=pd.LinearElastic(E=10.0, nu=0.3)))


def test_a_face_on_a_mirror_plane_has_no_traction():
    """A square opening around the origin is loaded, not the plane beside it."""

    def case(whole):
        hole = pd.region.Box((-2.0, -2.0), (2.0, 2.0))
        low = -6.0 if whole else 0.0
        conditions = [pd.Displacement(pd.region.Nearest((5.5, 5.5)), x=0.0, y=0.0)]
        if whole:
            others = [pd.region.Nearest((a * 5.5, b * 5.5)) for a, b in ((-1, 1), (1, -1), (-1, -1))]
            conditions += [pd.Displacement(other, x=0.0, y=0.0) for other in others]
        for axis, normal in (("x", (-1.0, 0.0)), ("y", (0.0, -1.0))):
            for side in (1.0, -1.0) if whole else (1.0,):
                region = pd.region.Slab(axis, low=0.0) if side > 0 else pd.region.Slab(axis, high=0.0)
                # Of the whole body the outer faces look the other way.
                conditions.append(pd.Traction(region, **{axis: side * 0.3}, normal=side * np.array(normal), area=None,
                                              distribution="layer"))  # fmt: skip
        return pd.Case(
            particles=pd.Lattice((low, low), (6.0, 6.0), 1.0, cut=hole), horizon=2.015, material=ELASTIC,
            conditions=conditions, symmetry=() if whole else (pd.Symmetry("x"), pd.Symmetry("y")),
        )  # fmt: skip

    assert_the_part_is_the_whole(case(False), case(True))
    with pytest.raises(pd.CaseError, match="no free face"):
        pd.prepare(loaded_on_the_plane())


def loaded_on_the_plane():
    """Return a quarter with a traction on one of its mirror planes."""
    case = pulled("xy", False)
    traction = pd.Traction(pd.region.Slab("x", high=1.0), x=-1.0, normal=(-1.0, 0.0), distribution="layer")
    return dataclasses.replace(case, conditions=[*case.conditions, traction])


@pytest.mark.parametrize(("dim", "planes"), [(2, "x"), (2, "xy"), (3, "xz")])
def test_conforming_weights_are_those_of_the_whole(dim, planes):
    both(planes, dim=dim, weights=pd.Conforming(), scheme=pd.Correspondence(), control=pd.Silling(0.3), tolerance=1e-8)


def test_pressure_with_conforming_weights_is_that_of_the_whole():
    changes = {"weights": pd.Conforming(), "material": pd.LinearElastic(E=10.0, nu=0.3)}
    part, whole = (loaded("xy", whole, "pressure", **changes) for whole in (False, True))
    assert_the_part_is_the_whole(part, whole, tolerance=1e-8)
