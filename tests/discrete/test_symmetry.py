"""Mirror planes: halves, quarters and eighths are the whole body, for every model and solver, on any rank count."""

import dataclasses
import itertools

import numpy as np
import pytest
from scipy.spatial import cKDTree

import pdpetsc as pd
from pdpetsc.gradient import stress_points
from tests.commands import ROOT, Stop, called, field, jacobian_ratios, printed, results, run_several, summary
from tests.damage.test_criterion import FamilyStretch
from tests.pairs import pairs
from tests.scenes import ALL_CONTROLS, BONDS

TOP = {1: (5.0,), 2: (4.0, 5.0), 3: (3.0, 3.0, 4.0)}
ELASTIC = pd.Hencky(E=10.0, nu=0.3)
FIELDS = (pd.displacement, pd.stress, pd.lost_bonds, pd.local_damage)


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
            fields = {f.__name__: f(solution).copy() for f in FIELDS}
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
    for name in (f.__name__ for f in FIELDS):
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


@pytest.mark.processors
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
    assert found["broken"].max() >= least
    assert found["local_damage"].max() > 0.0
    return found


@pytest.mark.processors
@pytest.mark.parametrize(
    ("kinematics", "damage", "planes"),
    pairs(
        ["small", "finite"],
        [BRITTLE, SOFTENING, pd.ExponentialSoftening(pd.ConstantCritical(0.04), ratio=2.0, rate=2.0)],
        ["x", "xy"],
    ),
)
def test_bonds_break_across_and_beside_a_plane_as_in_the_whole(kinematics, damage, planes):
    material = pd.BondBased(E=10.0, kinematics=kinematics)
    both_cracked(planes, material=material, damage=damage, steps=pd.Steps(2), tolerance=1e-8)


@pytest.mark.processors
@pytest.mark.parametrize(
    ("scheme", "effect"),
    [
        ("correspondence", pd.PresentStretch()),
        pytest.param("sub_horizons", pd.LargestStretch(), marks=pytest.mark.long),
        pytest.param("sub_horizons", pd.PresentStretch(), marks=pytest.mark.long),
        pytest.param("correspondence", pd.LargestStretch(), marks=pytest.mark.long),
    ],
)
def test_bonds_of_gradients_break_as_in_the_whole(scheme, effect):
    damage = pd.LinearSoftening(pd.ConstantCritical(0.04), ratio=3.0, effect=effect)
    control = pd.Silling(0.3) if scheme == "correspondence" else None
    both_cracked(
        "xy", scheme=pd.SCHEMES[scheme], control=control, damage=damage, steps=pd.Steps(2), pull=0.2, tolerance=1e-8
    )


@pytest.mark.parametrize("kinematics", ["small", "finite"])
def test_criteria_that_reach_over_families_are_those_of_the_whole(kinematics):
    damage = pd.LinearSoftening(FamilyStretch(0.006), ratio=6.0)
    material = pd.BondBased(E=10.0, kinematics=kinematics)
    both_cracked("xy", material=material, damage=damage, steps=pd.Steps(4), least=0, pull=0.08, tolerance=1e-8)


@pytest.mark.long
def test_without_a_matrix_bonds_break_as_in_the_whole():
    """Gradually, as long as the equilibrium is unique: beyond, the whole need not stay symmetric."""
    options = {"pd_jacobian": "matfree", "ksp_rtol": 1e-12}
    damage = pd.LinearSoftening(pd.ConstantCritical(0.04), ratio=4.0)
    both_cracked(
        "xy", options, material=pd.BondBased(E=10.0), damage=damage, steps=pd.Steps(40), pull=0.23, tolerance=1e-8
    )
    both_cracked("xy", options, control=pd.Silling(0.3), steps=pd.Steps(2), pull=0.3, tolerance=1e-8)


def test_numbers_of_a_part_are_its_share_of_the_whole(tmp_path):
    history = {
        "work": pd.ExternalWork(), "strain": pd.StrainEnergy(), "dissipated": pd.DissipatedEnergy(),
        "reaction": pd.Reaction("y", pd.region.Slab("y", low=4.0)),
    }  # fmt: skip
    found = []
    for whole in (False, True):
        case = cracked(
            "xy", whole, material=pd.BondBased(E=10.0), damage=SOFTENING, steps=pd.Steps(2), history=history,
            results=lambda h: {name: sum(values) for name, values in h.items()},
        )  # fmt: skip
        found.append(pd.run(case, output=tmp_path / str(whole)))
    part, whole = found
    for name, images in (("work", 4), ("strain", 4), ("dissipated", 4), ("reaction", 2)):
        assert whole[name] != 0.0
        assert images * part[name] == pytest.approx(whole[name], rel=1e-7), name


def test_bonds_that_fail_in_a_solid_break_as_in_the_whole():
    """An eighth, with bonds to images of images."""
    damage = pd.Brittle(pd.ConstantCritical(0.08))
    found = both("xyz", dim=3, material=pd.BondBased(E=10.0), damage=damage, tolerance=1e-8)
    assert found["broken"].max() > 0


@pytest.mark.processors
@pytest.mark.parametrize("measure", [pd.BondStretch(step=0.1), None], ids=["bonds", "opening"])
def test_paths_are_those_of_the_whole(measure):
    end = pd.region.Box((-2.4, 4.0), (2.4, 5.0))
    # Along an opening the body comes apart. It does so on the plane: of two cuts, one on either side, only one would
    # open, and round-off would decide which.
    cracks = {} if measure else {"cracks": (pd.Segment((-2.2, 0.0), (2.2, 0.0)),)}
    solver = pd.PathFollowing(measure or pd.Opening("y", end, step=0.02, end=0.2), until=0.8, most=200)
    damage = pd.LinearSoftening(pd.ConstantCritical(0.03), ratio=2.5)
    found = both_cracked(
        "xy", material=pd.BondBased(E=10.0), damage=damage, solver=solver, tolerance=1e-9, pull=0.2, **cracks
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


@pytest.mark.parametrize(("dim", "planes"), [(2, "x"), (2, "xy"), (3, "x")])
def test_a_crack_along_a_plane_has_its_faces_there(dim, planes):
    """Facets on the plane are surface where a crack cuts the bonds through them, and nowhere else."""
    if dim == 2:
        crack = pd.Segment((0.0, -2.5 if planes == "xy" else 1.5), (0.0, 2.5))
    else:
        crack = pd.PolygonCrack([(0.0, 0.5, 0.5), (0.0, 2.5, 0.5), (0.0, 2.5, 2.5), (0.0, 0.5, 2.5)])
    changes = {"weights": pd.Conforming(), "scheme": pd.Correspondence(), "control": pd.Silling(0.3)}
    found = both(planes, dim=dim, cracks=[crack], tolerance=1e-8, **changes)
    uncut = solved(pulled(planes, True, dim=dim, **changes))[1]
    assert found["strain"][-1] != pytest.approx(uncut["strain"][-1], rel=1e-4)


def test_pressure_with_conforming_weights_is_that_of_the_whole():
    changes = {"weights": pd.Conforming(), "material": pd.LinearElastic(E=10.0, nu=0.3)}
    part, whole = (loaded("xy", whole, "pressure", **changes) for whole in (False, True))
    assert_the_part_is_the_whole(part, whole, tolerance=1e-8)


CASE_FILE = """
import sys
sys.path.insert(0, {root!r})
import pdpetsc as pd
from tests.discrete import test_symmetry


def case(name="plane", steps=1, stop=1.0):
    return test_symmetry.named(name, steps, stop)
"""


def named(name, steps, stop):
    """Return the cases that are run on several ranks."""
    on_steps = {"steps": pd.Steps(steps), "fields": (pd.displacement, pd.lost_bonds), "history": {"stop": Stop(stop)}}
    silling = {"scheme": pd.Correspondence(), "control": pd.Silling(0.3)}
    if name in ("line", "plane", "solid"):
        dim = 1 + ("line", "plane", "solid").index(name)
        return pulled("xyz"[:dim], False, dim=dim, **silling, **on_steps)
    if name == "littlewood":
        return pulled("xy", False, scheme=pd.Correspondence(), control=pd.Littlewood(0.2), **on_steps)
    if name == "bonds":
        return pulled("xy", False, material=BONDS["linear_solid_finite"], **on_steps)
    if name == "conforming":
        return pulled("xy", False, weights=pd.Conforming(), **silling, **on_steps)
    if name == "periodic":
        return layered(False, **on_steps)
    damage = pd.LinearSoftening(pd.ConstantCritical(0.04), ratio=2.0)
    if name == "families":
        damage = pd.LinearSoftening(FamilyStretch(0.006), ratio=6.0)
    if name == "events":
        events = pd.EventDriven(fields_every=1)
        return cracked("xy", False, material=pd.BondBased(E=10.0), damage=BRITTLE, solver=events, **on_steps)
    if name == "gradients":
        damage = dataclasses.replace(damage, effect=pd.PresentStretch())
        return cracked("xy", False, damage=damage, pull=0.2, **silling, **on_steps)
    return cracked("xy", False, material=pd.BondBased(E=10.0, kinematics="finite"), damage=damage, **on_steps)


def layered(whole, high=4.0, axes="x", **changes):
    """Return layers that repeat along x, pulled and sheared along z or y, with a mirror plane below them."""
    low = (0.0, -high if whole else 0.0)
    conditions = [
        pd.Displacement(pd.region.Slab("y", low=high - 1.0), x=0.0, y=0.3),
        pd.MeanStrain(xx=0.05),
    ]
    if whole:
        conditions.append(pd.Displacement(pd.region.Slab("y", high=1.0 - high), x=0.0, y=-0.3))
    declared = {
        "particles": pd.Lattice(low, (5.0, high), 1.0),
        "horizon": 2.015,
        "material": pd.Graded(ELASTIC, lambda x: 1.0 + 0.5 * np.sin(2.0 * np.pi * x[:, 0] / 5.0)),
        "conditions": conditions,
        "cell": pd.Cell((0.0, 0.0), (5.0, 1.0), axes),
        "symmetry": () if whole else (pd.Symmetry("y"),),
    }
    return pd.Case(**(declared | changes))


@pytest.fixture(scope="module")
def case_file(tmp_path_factory):
    """Return a case file that makes any of the named cases."""
    path = tmp_path_factory.mktemp("symmetry") / "part.py"
    path.write_text(CASE_FILE.format(root=str(ROOT)))
    return path


@pytest.mark.parametrize(
    ("name", "ranks"),
    [(name, 1) for name in ("line", "plane", "solid", "littlewood", "bonds", "softening", "families")]
    + [("gradients", 1), ("periodic", 1), ("periodic", 2)]
    + [pytest.param(name, 3, marks=pytest.mark.long) for name in ("periodic", "gradients")],
)
def test_the_jacobian_beside_planes_is_correct(name, ranks, case_file, tmp_path):
    said = printed(case_file, f"name={name}", "-snes_test_jacobian", ranks=ranks, output=tmp_path)
    ratios = np.array(jacobian_ratios(said))
    assert len(ratios)
    # Laws of softening have kinks, at which differences are of both sides; and an attempt that fails may end so near to
    # states without forces that differences reach them.
    kinks = name in ("softening", "gradients", "families")
    off = ~(ratios < (1e-5 if kinks else 1e-6))
    assert off.sum() <= (2 if kinks else 0)


@pytest.mark.parametrize("ranks", [2, pytest.param(3, marks=pytest.mark.long)])
def test_any_number_of_ranks_finds_the_same_part(ranks, case_file, tmp_path):
    names = ["softening", "gradients", "periodic", "events"] + ["solid", "conforming"] * (ranks > 2)
    run_several([(case_file, [f"name={name}"], tmp_path / name) for name in names], ranks)
    for name in names:
        results(case_file, f"name={name}", output=tmp_path / "one")
        for of in ("displacement", "lost_bonds"):
            one, other = (field(tmp_path / folder, of) for folder in ("one", name))
            assert np.abs(one - other).max() <= 1e-8 * np.abs(one).max(), of
        if name in ("softening", "gradients", "events"):
            one, other = (
                [line.split(",")[2:4] for line in (tmp_path / folder / "broken_bonds.csv").read_text().splitlines()]
                for folder in ("one", name)
            )
            assert len(one) > 2
            assert one == other


@pytest.mark.processors
@pytest.mark.parametrize("ranks", [pytest.param((1, 2), marks=pytest.mark.long), (2, 1)])
def test_a_restart_on_other_ranks_knows_the_broken_bonds(ranks, case_file, tmp_path):
    before, after = ranks
    results(case_file, "name=softening", "steps=4", ranks=1, output=tmp_path / "whole")
    first, second = tmp_path / "first", tmp_path / "second"
    stopped = called(case_file, "name=softening", "steps=4", "stop=0.8", "-o", first, ranks=before)
    assert stopped.returncode == 1
    assert len((first / "broken_bonds.csv").read_text().splitlines()) > 2
    results(case_file, "name=softening", "steps=4", "--restart", first / "checkpoint.h5", ranks=after, output=second)
    for of in ("displacement", "lost_bonds"):
        one, other = (field(tmp_path / name, of) for name in ("whole", "second"))
        assert np.abs(one - other).max() <= 1e-8 * np.abs(one).max()


@pytest.mark.parametrize("scheme", ["sub_horizons", "bond_associated"])
def test_a_plane_and_a_periodic_axis_go_together(scheme):
    part, whole = (layered(whole, scheme=pd.SCHEMES[scheme]) for whole in (False, True))
    assert_the_part_is_the_whole(part, whole)


def test_a_plane_lies_anywhere_and_the_body_on_either_side():
    def case(at, side):
        ends = sorted((at, at + side * 4.0))
        outer, middle = at + side * 3.5, at + side * 0.5
        conditions = [
            pd.Displacement(pd.region.Nearest((outer, 2.5)), x=0.2 * side, y=0.1),
            pd.Displacement(pd.region.Nearest((middle, 0.5)), y=0.0),
        ]
        return pd.Case(
            particles=pd.Lattice((ends[0], 0.0), (ends[1], 5.0), 1.0), horizon=2.015, material=ELASTIC,
            conditions=conditions, symmetry=[pd.Symmetry("x", at=at)],
        )  # fmt: skip

    x, at_home, _ = solved(case(0.0, 1.0))
    for at, side in ((3.0, 1.0), (-2.5, -1.0)):
        moved, found, _ = solved(case(at, side))
        place = cKDTree(moved).query(x * [side, 1.0] + [at, 0.0])[1]
        difference = found["displacement"][:, place] * [side, 1.0] - at_home["displacement"]
        assert np.abs(difference).max() < 1e-12


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"symmetry": [pd.Symmetry("x", at=0.5)]}, "lie on or beyond the mirror plane x = 0.5"),
        ({"symmetry": [pd.Symmetry("x", at=1.0)]}, "5 of 20 particles lie on or beyond the mirror plane x = 1;"),
        ({"symmetry": [pd.Symmetry("z")]}, "no Symmetry across z of particles with 2 coordinates"),
        ({"symmetry": [pd.Symmetry("x"), pd.Symmetry("x", at=4.0)]}, "one Symmetry across an axis"),
        ({"symmetry": [pd.Symmetry("x")], "cell": pd.Cell((0.0, 0.0), (4.0, 5.0), "x")}, "periodic in x"),
        ({"symmetry": pd.Symmetry("x")}, "put it into a list"),
        ({"symmetry": [pd.Symmetry("y")], "conditions": []}, "1 of 3 rigid motions: translation in x. Prescribe"),
        ({"symmetry": [], "conditions": []}, "3 of 3 rigid motions: translation in x, y and rotation about z. "),
        # Cut from its image a piece moves as it likes, but for the turn that only its own image stops.
        ({"symmetry": [pd.Symmetry("y")], "cracks": [pd.PlaneCrack((0.0, 2.0), (0.0, 1.0))]}, "piece with particle 2"),
    ],
)
def test_wrong_planes_are_refused(changes, message):
    with pytest.raises(pd.CaseError, match=message):
        held = [pd.Displacement(pd.region.Nearest((0.5, 0.5)), x=0.0)]
        pd.prepare(pulled("", False, **({"conditions": held} | changes)))


def test_a_plane_that_is_nowhere_is_refused():
    for wrong in ({"axis": "w"}, {"axis": "x", "at": np.inf}):
        with pytest.raises(pd.CaseError, match="Symmetry"):
            pd.Symmetry(**wrong)


@pytest.mark.parametrize("planes", ["x", "xy"])
def test_planes_alone_hold_what_they_hold_of_the_whole(planes):
    """Two planes hold a plane body; one leaves the translation along it."""
    load = [pd.Pressure(pd.region.All(), 0.1)]
    case = dataclasses.replace(pulled(planes, False), conditions=load)
    if planes == "x":
        with pytest.raises(pd.CaseError, match="1 of 3 rigid motions: translation in y"):
            pd.prepare(case)
    else:
        _, found, _ = solved(case)
        assert np.abs(found["displacement"]).max() > 0.0


def test_pieces_are_those_of_the_whole_body(tmp_path):
    """Cut along the plane the halves are two pieces, though the part that is computed is one."""
    weak = pd.CriticalFunction(lambda length, middle: np.where(np.abs(middle[:, 0]) < 1e-9, 0.03, 0.5))
    case = pulled("x", False, dim=1, horizon=1.015, material=pd.BondBased(E=10.0), damage=pd.Brittle(weak))
    pd.run(case, output=tmp_path)
    assert summary(tmp_path)["pieces"]["pieces"] == 2


def test_a_checkpoint_of_a_part_is_of_no_other_planes(tmp_path):
    pd.run(pulled("xy", False), output=tmp_path / "part")
    checkpoint = tmp_path / "part" / "checkpoint.h5"
    with pytest.raises(pd.CaseError, match="another body"):
        pd.run(dataclasses.replace(pulled("xy", False), symmetry=()), output=tmp_path / "other", restart=checkpoint)
