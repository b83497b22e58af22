"""Faces of closed cracks that slide with friction: law, body, ranks, restart and a loop of two halves."""

import dataclasses
import itertools
import runpy

import numpy as np
import pytest

import pdpetsc as pd
from pdpetsc.command_line.cli import load_case
from tests.commands import ROOT, Stop, history, results
from tests.scenes import MATERIALS, SCHEMES, damaged_body, dense_tangent, differences, displacement, rotation

LAWS = ["linear_elastic", "hencky", "saint_venant_kirchhoff"]
CASE = "runs/fracture/closed_crack.py"
SPACE = runpy.run_path(str(ROOT / "runs/fracture/sliding_crack.py"))
sliding, sliding_case = SPACE["sliding"], SPACE["case"]


def closed(name, friction):
    return pd.split.NoTension(friction=friction).closed_part(MATERIALS[name])


def cracked(rng, dim, n=40, slip=0.01):
    """Return a history with random normals and slips."""
    normal, s = rng.standard_normal((2, n, dim))
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    s = slip * (s - normal * (s * normal).sum(axis=1)[:, None])
    return np.concatenate([normal, s], axis=1)


def evaluate(part, quantity, F, past):
    dim = F.shape[-1]
    shape = {"energy": (), "stress": (dim, dim), "tangent": (dim,) * 4}[quantity]
    found = np.empty((len(F), *shape))
    loop = getattr(part.history_kernels(dim), quantity)
    loop(F, np.arange(len(F)), part.constants(dim), past, found)
    return found


def by_difference(part, quantity, F, past, step=1e-6):
    dim = F.shape[-1]
    columns = []
    for i, m in itertools.product(range(dim), repeat=2):
        d = np.zeros((dim, dim))
        d[i, m] = step
        up, down = (evaluate(part, quantity, F + sign * d, past) for sign in (1.0, -1.0))
        columns.append((up - down) / (2.0 * step))
    return np.stack(columns, axis=-1).reshape(*columns[0].shape, dim, dim)


@pytest.mark.processors
@pytest.mark.parametrize("friction", [0.0, 0.3])
@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("dim", [1, 2, 3])
def test_tangents_are_those_of_differences(dim, name, friction, rng):
    part, past = closed(name, friction), cracked(rng, dim)
    past[:5, :dim] = 0.0  # points without a crack
    past[:5, dim:] = 0.0
    F = np.eye(dim) + rng.uniform(-0.08, 0.04, (40, dim, dim))
    A = evaluate(part, "tangent", F, past)
    assert pytest.approx(by_difference(part, "stress", F, past), abs=1e-6 * np.abs(A).max()) == A
    if friction == 0.0:
        P = evaluate(part, "stress", F, past)
        assert pytest.approx(by_difference(part, "energy", F, past), abs=1e-7 * np.abs(P).max()) == P
        assert pytest.approx(A.transpose(0, 3, 4, 1, 2), abs=1e-12 * np.abs(A).max()) == A


@pytest.mark.parametrize("name", LAWS)
def test_shear_is_at_most_friction_times_pressure(name):
    """Pressed by 0.01 and sheared in small steps, there and back: Coulomb's loop, with the work of its forces."""
    part, friction, pressed, most = closed(name, 0.3), 0.3, 0.01, 0.03
    mu, past = MATERIALS[name].lame(2)[1], np.array([[0.0, 1.0, 0.0, 0.0]])
    gammas = most * np.concatenate([np.linspace(0, 1, 401), np.linspace(1, -1, 801), np.linspace(-1, 1, 801)])
    shear, pressure, work, rubbed, before = [], [], 0.0, 0.0, None
    for gamma in gammas:
        F = np.array([[[1.0, gamma], [0.0, 1.0 - pressed]]])
        P = evaluate(part, "stress", F, past)
        if before is not None:
            work += float((0.5 * (P + before[1]) * (F - before[0])).sum())
        before = F, P
        rubbed += float(part.rubbed(F, past)[0])
        part.history_kernels(2).commit(F, np.zeros(1, dtype=np.int64), part.constants(2), past)
        shear.append(P[0, 0, 1])
        pressure.append(-P[0, 1, 1])
    limit = friction * np.mean(pressure)
    # Traction and pressure of a deformed body differ from these by strains.
    assert max(shear) == pytest.approx(limit, rel=0.03)
    assert min(shear) == pytest.approx(-limit, rel=0.03)
    # The stiffness before slip is that of the intact material.
    assert shear[10] == pytest.approx(mu * gammas[10], rel=0.05)
    # A whole loop: twice the limit times the slip there and back.
    slip = 2.0 * (most - limit / mu)
    assert rubbed == pytest.approx(limit * (most - limit / mu + 2.0 * slip), rel=0.03)
    start = evaluate(part, "energy", np.array([[[1.0, 0.0], [0.0, 1.0 - pressed]]]), np.array([[0.0, 1.0, 0, 0]]))
    assert work == pytest.approx(rubbed + float((evaluate(part, "energy", F, past) - start)[0]), rel=0.01)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("name", ["hencky", "saint_venant_kirchhoff"])
def test_a_rotation_turns_the_stress(name, dim, rng):
    part, past = closed(name, 0.3), cracked(rng, dim)
    F, R = np.eye(dim) + rng.uniform(-0.08, 0.04, (40, dim, dim)), rotation(dim, rng)
    P, turned = evaluate(part, "stress", F, past), evaluate(part, "stress", R @ F, past)
    assert turned == pytest.approx(R @ P, abs=1e-9 * np.abs(P).max())
    assert evaluate(part, "energy", R @ F, past) == pytest.approx(evaluate(part, "energy", F, past))


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("name", LAWS)
def test_faces_that_stick_are_intact_and_open_ones_free(name, dim, rng):
    """At small strain, and the stress along an open crack stays."""
    part, law = closed(name, 1e3), MATERIALS[name]
    past = cracked(rng, dim, slip=0.0)
    H = 1e-7 * rng.standard_normal((40, dim, dim))
    H -= 5e-7 * np.eye(dim)
    C = law.moduli(dim)
    P = evaluate(part, "stress", np.eye(dim) + H, past)
    assert pytest.approx(np.einsum("imkn,pkn->pim", C, H), rel=1e-4, abs=1e-5 * np.abs(P).max()) == P
    n = past[:, :dim]
    opened = (
        np.eye(dim)
        + 0.01 * n[:, :, None] * n[:, None, :]
        + 0.02 * rng.standard_normal((40, dim))[:, :, None] * n[:, None, :]
    )
    t = np.einsum("pij,pj->pi", evaluate(part, "stress", opened, past), n)
    gap = np.einsum("pi,pij,pj->p", n, opened, n) > 1.0
    assert gap.sum() > 10
    assert np.abs(t[gap]).max() < 1e-2 * law.E * 0.02


@pytest.mark.parametrize("friction", [0.0, 0.3])
@pytest.mark.parametrize("name", LAWS)
def test_the_tangent_of_a_cracked_body_is_that_of_differences(name, friction, rng):
    law = pd.PointDamage(pd.softening.Linear(), Gc=0.2, onset=0.02, split=pd.split.NoTension(friction=friction))
    model = damaged_body(2, law, SCHEMES["correspondence"], pd.Silling(0.5), MATERIALS[name], rng)
    problem = model.problem
    u = displacement(model, rng, 0.06)
    problem.soften(problem.state(u))
    problem.commit(problem.state(u))
    damage = problem.damage
    normals = damage.points.normal
    assert normals.any(axis=1).sum() > 5
    problem.freeze(True)
    u = -0.5 * u + displacement(model, rng, 0.02)
    K, columns = dense_tangent(model, u), rng.choice(u.size, 12, replace=False)
    assert K[:, columns] == pytest.approx(differences(model, u, columns), abs=2e-6 * np.abs(K).max())
    assert problem.symmetric == (friction == 0.0)


@pytest.mark.parametrize("friction", [0.0, 0.3])
@pytest.mark.parametrize("name", LAWS)
def test_driving_variables_do_not_jump_as_cracks_begin_to_slide(name, friction, rng):
    """The energy changes by Y per degradation factor, without the part that slip released."""
    law = pd.PointDamage(pd.softening.Linear(), Gc=0.2, onset=0.02, split=pd.split.NoTension(friction=friction))
    model = damaged_body(2, law, SCHEMES["correspondence"], pd.Silling(0.5), MATERIALS[name], rng)
    problem, u = model.problem, displacement(model, rng, 0.06)
    damage, points = problem.damage, problem.damage.points
    before = damage.driven(problem.state(u)).x.copy()
    problem.soften(problem.state(u))
    begun, state = points.normal.any(axis=1), problem.state(u)
    assert begun.sum() > 5 and points.released.max() > 1e-3 * points.onset_energy.max()
    driven = damage.driven(state)
    assert driven.x == pytest.approx(before)
    if friction == 0.0:
        partly = begun & (driven.phi > 0.0)
        psi, control = damage.laws(state).energy(damage.deformation(state)), damage._unresolved_energy(state)
        expected = psi - (1.0 - driven.phi) * (driven.x**2 * points.onset_energy - control)
        assert partly.any() and damage.point_energy(state)[partly] == pytest.approx(expected[partly])


def test_damage_that_is_undone_leaves_no_normal(rng):
    law = pd.PointDamage(pd.softening.Linear(), Gc=0.2, onset=0.02, split=pd.split.NoTension(friction=0.3))
    model = damaged_body(2, law, SCHEMES["correspondence"], pd.Silling(0.5), MATERIALS["hencky"], rng)
    problem, u = model.problem, displacement(model, rng, 0.06)
    stored = problem.damage.stored()
    problem.soften(problem.state(u))
    normals = problem.damage.points.normal
    assert normals.any()
    taken = problem.damage.stored()
    problem.damage.reset(stored)
    assert not normals.any()
    problem.damage.reset(taken)
    assert normals.any()
    problem.revert()
    assert not normals.any()


def test_a_point_that_has_not_failed_in_the_end_has_no_crack(rng):
    """Crack and slip of a sweep are gone after the step, so that a later crack does not start with them."""
    law = pd.PointDamage(pd.softening.Linear(), Gc=0.2, onset=0.02, split=pd.split.NoTension(friction=0.3))
    model = damaged_body(2, law, SCHEMES["correspondence"], pd.Silling(0.5), MATERIALS["hencky"], rng)
    problem, u = model.problem, displacement(model, rng, 0.06)
    problem.soften(problem.state(u))
    part, normals = problem.damage._sliding.materials[0], problem.damage.points.normal
    begun = int(normals.any(axis=1).sum())
    problem.commit(problem.state(0.3 * u))
    failed = problem.damage.points.kappa[part.points] > 1.0
    assert failed.sum() < begun
    assert not part.history[~failed].any()


def test_two_halves_slide_against_friction_there_and_back(tmp_path):
    """The surfaces of the lattice are 1 % softer than the body at n = 20, half of that at n = 40."""
    found = results(CASE, "n=16", "steps=5", output=tmp_path)["results"]
    assert found["pressure_over_exact"] == pytest.approx(1.0, abs=0.01)
    assert found["drag_over_normal"] == pytest.approx(0.3, abs=1e-4)
    assert found["slip_over_exact"] == pytest.approx(1.0, abs=0.02)
    assert found["work_over_exact"] == pytest.approx(1.0, abs=0.02)


def test_faces_without_friction_carry_pressure_alone(tmp_path):
    found = results(CASE, "n=16", "steps=5", "friction=0", output=tmp_path)["results"]
    assert found["pressure_over_exact"] == pytest.approx(1.0, abs=0.02)
    assert found["drag_over_normal"] < 1e-5


@pytest.mark.long
@pytest.mark.parametrize("strain", ["small", "logarithmic", "green"])
def test_the_loop_of_two_halves_converges(strain, tmp_path):
    coarse, fine = (results(CASE, f"n={n}", f"strain={strain}", output=tmp_path / str(n))["results"] for n in (20, 40))
    for name in ("slip_over_exact", "work_over_exact"):
        assert abs(fine[name] - 1.0) < 0.009
        assert abs(coarse[name] - 1.0) < 0.016
    assert fine["drag_over_normal"] == pytest.approx(0.3, abs=1e-3)


def test_ranks_and_a_restart_slide_alike(tmp_path):
    words = "n=16", "steps=5"
    results(CASE, *words, output=tmp_path / "1")
    results(CASE, *words, output=tmp_path / "2", ranks=2)
    one, two = (history(tmp_path / name) for name in "12")
    for name in ("force_x", "force_y", "stored"):
        scale = np.abs(one[name]).max()
        assert two[name] == pytest.approx(one[name], abs=1e-7 * scale)


def test_a_slip_that_continues_after_a_restart_is_the_same(tmp_path):
    case = load_case(ROOT / CASE)(n=16, steps=5)
    case = dataclasses.replace(case, checkpoints=1)
    whole = pd.run(case, tmp_path / "whole")
    with pytest.raises(pd.Interrupted):
        pd.run(dataclasses.replace(case, history={**case.history, "stop": Stop(0.7)}), tmp_path / "part")
    again = pd.run(case, tmp_path / "again", restart=tmp_path / "part")
    assert np.array_equal(again.solution.unknowns, whole.solution.unknowns)


@pytest.mark.parametrize("unit", [1e-6, 1e6])
def test_units_change_nothing(unit, rng):
    past, law = cracked(rng, 2), MATERIALS["hencky"]
    same, scaled = (
        pd.split.NoTension(friction=0.3).closed_part(dataclasses.replace(law, E=E)) for E in (law.E, law.E * unit)
    )
    F = np.eye(2) + rng.uniform(-0.08, 0.04, (40, 2, 2))
    assert evaluate(scaled, "stress", F, past) == pytest.approx(unit * evaluate(same, "stress", F, past), rel=1e-9)


def test_a_negative_friction_is_refused():
    with pytest.raises(pd.CaseError, match="friction"):
        pd.split.NoTension(friction=-0.1)


def test_a_crack_at_the_start_opens_as_one_of_cut_bonds(tmp_path):
    """It is 0.4 cells longer at each tip, and has not dissipated."""
    n, load = 40, 1e-3
    closed = sliding_case(n=n, friction=0.3)
    pulled = [pd.Traction("+y", y=load), pd.Traction("-y", y=-load), *closed.conditions[-2:]]
    history = {"work": pd.ExternalWork(), "dissipated": pd.DissipatedEnergy()}
    closed = dataclasses.replace(closed, conditions=pulled, history=history)
    crack = closed.damage.cracks[0]
    intact = dataclasses.replace(closed, damage=None, history={"work": history["work"]})
    cut = dataclasses.replace(intact, cracks=[crack])
    found = [pd.run(case, tmp_path / str(k)).history for k, case in enumerate((intact, cut, closed))]
    of_cut, of_points = (h["work"][-1] - found[0]["work"][-1] for h in found[1:])
    assert found[2]["dissipated"][-1] == 0.0
    # The work grows with the square of the length.
    assert 0.2 < (np.sqrt(of_points / of_cut) - 1.0) * n / 10.0 < 0.6


def test_a_crack_in_a_plate_slides_against_friction(tmp_path):
    """With 8 cells over it the factor over the closed form is 2, with 48 it is 1.2."""
    smooth, rough = (sliding(n=40, angle=30.0, horizon=2.015, friction=friction) for friction in (0.0, 0.3))
    # The slip is proportional to the shear less the friction.
    assert rough == pytest.approx(smooth, rel=0.03)
    assert 1.0 < rough < 2.2


@pytest.mark.long
def test_the_slip_of_a_crack_in_a_plate_converges():
    coarse, fine = (sliding(n=n, horizon=2.015) for n in (60, 120))
    assert 0.0 < fine - 1.0 < 0.6 * (coarse - 1.0)


@pytest.mark.parametrize("crack, normal", [
    (pd.Segment((0.0, 0.0), (3.0, 4.0)), (-0.8, 0.6)),
    (pd.Polyline([(0.0, 0.0), (3.0, 4.0), (30.0, 4.0)]), (-0.8, 0.6)),
    (pd.PlaneCrack((0.0, 0.0), (0.0, 2.0)), (0.0, 1.0)),
    (pd.PlaneCrack((0.0, 0.0, 0.0), (0.0, 2.0, 0.0)), (0.0, 1.0, 0.0)),
    (pd.Disc((0.0, 0.0, 0.0), (3.0, 0.0, 4.0), 1.0), (0.6, 0.0, 0.8)),
    (pd.PolygonCrack([(0.0, 0.0, 1.0), (1.0, 0.0, 1.0), (0.0, 1.0, 1.0)]), (0.0, 0.0, 1.0)),
])  # fmt: skip
def test_cracks_have_normals(crack, normal):
    x = np.full((2, len(normal)), 1.0)
    found = crack.normals(x)
    assert np.abs(found @ np.array(normal)) == pytest.approx([1.0, 1.0])
    assert np.linalg.norm(found, axis=1) == pytest.approx([1.0, 1.0])
    assert crack.normals(x[:0]).shape == (0, len(normal))


def test_a_crack_beside_the_body_is_refused(tmp_path):
    law = pd.PointDamage(pd.softening.Linear(), Gc=1.0, strength=0.1, cracks=[pd.Segment((20.0, 0.0), (21.0, 0.0))])
    case = dataclasses.replace(sliding_case(n=20), damage=law)
    with pytest.raises(pd.CaseError, match="cuts no family"):
        pd.run(case, tmp_path)


def test_cycles_of_slip_neither_fail_nor_spare_a_half_failed_crack(tmp_path):
    """Opened to half of failure, pressed, slid there and back some times, and opened again."""
    found = []
    for cycles in (1, 8):
        case = load_case(ROOT / CASE)(n=16)
        heights = [0.0, 0.02, *[-0.02] * (2 * cycles + 2), 0.06]
        slides = [0.0, 0.0, 0.0, *[0.015, -0.015] * cycles, 0.0, 0.0]
        times = np.linspace(0.0, 1.0, len(heights))

        def along(x, t, values=slides, times=times):
            return np.full(len(x), np.interp(t, times, values))

        def up(x, t, values=heights, times=times):
            return np.full(len(x), np.interp(t, times, values))

        steps = np.unique(np.round([np.linspace(a, b, 9) for a, b in itertools.pairwise(times)], 12))
        case = dataclasses.replace(
            case,
            results=None,
            history={**case.history, "control": pd.ControlEnergy()},
            conditions=[
                pd.Displacement("-y", x=0.0, y=0.0),
                pd.Displacement("+y", x=along, y=up),
                pd.MeanStrain(xx=0.0),
            ],
            steps=pd.Steps(times=tuple(steps[1:])),
        )
        h = pd.run(case, tmp_path / str(cycles)).history
        assert 0.1 < h["dissipated"][8] / h["dissipated"][-1] < 0.9
        before = -9  # the last opening jumps
        balance = h["stored"][before] + h["control"][before] + h["dissipated"][before]
        assert balance == pytest.approx(h["work"][before], rel=0.02)
        found.append((max(h["force_y"][-8:]), h["dissipated"][-1]))
    assert found[1] == pytest.approx(found[0], rel=1e-6)


def with_cracks(*cracks, dim=2, n=10, scheme=None, **words):
    """Return a unit body, clamped and pulled along x, with cracks at the start."""
    given = {
        "particles": pd.Lattice((0.0,) * dim, (1.0,) * dim, 1.0 / n),
        "horizon": 2.015 / n,
        "material": pd.LinearElastic(E=1.0, nu=0.2),
        "damage": pd.PointDamage(pd.softening.Linear(), Gc=1.0, strength=0.1, cracks=cracks),
        "conditions": [pd.Clamp("-x"), pd.Displacement("+x", x=1e-3)],
        "steps": pd.Steps(1),
        "history": {"force": pd.Reaction("x", "+x"), "dissipated": pd.DissipatedEnergy()},
    }
    return pd.Case(**(given | ({} if scheme is None else {"scheme": scheme}) | words))


def test_several_cracks_at_the_start_have_not_dissipated(tmp_path):
    cracks = [pd.Segment((0.2, y), (0.6, y)) for y in (0.2, 0.5, 0.8)]
    crossing = pd.Segment((0.4, 0.3), (0.4, 0.7))
    found = pd.run(with_cracks(*cracks, crossing), tmp_path).history["dissipated"]
    assert found == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("scheme", [pd.Correspondence(), pd.SubHorizons(), pd.SubHorizons(4)])
def test_a_crack_through_the_body_carries_no_tension(scheme, tmp_path):
    """Also if families reach to one side of their particles."""
    found = pd.run(with_cracks(pd.PlaneCrack((0.5, 0.0), (1.0, 0.0)), scheme=scheme), tmp_path)
    assert abs(found.history["force"][-1]) < 1e-5


@pytest.mark.parametrize("scheme", [pd.Correspondence(), pd.SubHorizons(), pd.StressPoints()])
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("along, share", [(0.0, 1e-6), (1.0, 0.05)])
def test_faces_that_are_apart_have_no_force(along, share, dim, scheme, tmp_path):
    """Two rigid halves, also at surfaces, whose families the crack cuts unevenly.

    If the faces also move along each other, these families are shortened along the crack.
    """
    far = pd.region.Slab("x", low=0.5)
    rest = dict.fromkeys("xyz"[:dim], 0.0)
    case = with_cracks(
        pd.PlaneCrack((0.5, *[0.0] * (dim - 1)), (1.0, *[0.0] * (dim - 1))),
        dim=dim, n=8, scheme=scheme,
        conditions=[
            pd.Displacement(~far, **rest),
            pd.Displacement(far, **(rest | {"x": 1e-3, "y": 1e-3 * along})),
        ],
        history={"pull": pd.Reaction("x", far), "shear": pd.Reaction("y", far)},
    )  # fmt: skip
    found = pd.run(case, tmp_path).history
    # Of the force of an intact body with the strain of an opening over a family.
    intact = 1e-3 * 8.0
    assert abs(found["pull"][-1]) < 1e-6 * intact
    assert abs(found["shear"][-1]) < share * intact


def test_the_nearest_of_two_cracks_has_the_normal_of_a_point(tmp_path):
    """In any order: points between both cracks fail with the normal of the nearer one."""
    flat, steep = pd.Segment((0.2, 0.44), (0.8, 0.44)), pd.Segment((0.2, 0.52), (0.8, 0.61))
    found = [pd.run(with_cracks(*pair), tmp_path / str(k)) for k, pair in enumerate([(flat, steep), (steep, flat)])]
    normals = [run.solution.problem.damage.points.normal for run in found]
    assert normals[1] == pytest.approx(normals[0])
    assert len(np.unique(np.round(normals[0][normals[0].any(axis=1)], 6), axis=0)) == 2


def test_a_crack_at_the_edge_of_a_periodic_cell_fails_both_sides(tmp_path):
    found = []
    for k, at in enumerate((0.5, 0.0)):
        case = with_cracks(
            pd.PlaneCrack((at, 0.0), (1.0, 0.0)),
            cell=pd.Cell((0.0, 0.0), (1.0, 1.0), axes="x"),
            conditions=[pd.PointSupport(pd.region.All(), x=0.0, y=0.0), pd.MeanStrain(xx=1e-3)],
            history={"stored": pd.StrainEnergy()},
        )
        result = pd.run(case, tmp_path / str(k))
        found.append(result.history["stored"][-1])
    assert found[1] == pytest.approx(found[0], rel=1e-9)


def test_a_crack_behind_a_mirror_plane_is_that_of_the_whole_body(tmp_path):
    one, image = (pd.Segment((0.5 + sign * 0.03, 0.2), (0.5 + sign * 0.3, 0.8)) for sign in (1.0, -1.0))
    ends = [pd.Displacement("+x", x=1e-3), pd.Displacement("-x", x=-1e-3), pd.PointSupport(pd.region.All(), y=0.0)]
    history = {"stored": pd.StrainEnergy()}
    whole = pd.run(with_cracks(one, image, conditions=ends, history=history), tmp_path / "whole")
    half = with_cracks(
        one, particles=pd.Lattice((0.5, 0.0), (1.0, 1.0), 0.1), symmetry=[pd.Symmetry("x", 0.5)],
        conditions=[ends[0], ends[2]], history=history,
    )  # fmt: skip
    of_half = pd.run(half, tmp_path / "half").history["stored"][-1]
    assert 2.0 * of_half == pytest.approx(whole.history["stored"][-1], rel=1e-6)


@pytest.mark.parametrize("dim, crack", [
    (3, pd.Segment((0.5, 0.0), (0.5, 1.0))),
    (3, pd.Polyline([(0.5, 0.0), (0.5, 0.4), (0.5, 1.0)])),
    (2, pd.Disc((0.5, 0.5, 0.0), (1.0, 0.0, 0.0), 0.4)),
    (2, pd.PolygonCrack([(0.5, 0.0, 0.0), (0.5, 1.0, 0.0), (0.5, 0.0, 1.0)])),
    (2, pd.PlaneCrack((0.5, 0.0, 0.0), (1.0, 0.0, 0.0))),
])  # fmt: skip
def test_a_crack_of_another_dimension_is_refused(dim, crack, tmp_path):
    with pytest.raises(pd.CaseError, match=r"requires a body|needs points of"):
        pd.run(with_cracks(crack, dim=dim, n=5), tmp_path)


class Skewed(pd.Segment):
    """A crack whose normals have another length."""

    def normals(self, x):
        return 2.0 * super().normals(x)


def test_normals_of_another_length_are_refused(tmp_path):
    with pytest.raises(pd.CaseError, match="must be unit vectors"):
        pd.run(with_cracks(Skewed((0.2, 0.5), (0.6, 0.5))), tmp_path)
