"""Horizons that differ from particle to particle: families, patch tests, tangents, ranks, bonds, refusals."""

import dataclasses
import json
import sys
import textwrap
from pathlib import Path

import meshio
import numpy as np
import pytest

import pdpetsc as pd
from pdpetsc.bond_based import Neighbourhood
from pdpetsc.damage import DamageableBonds
from pdpetsc.discrete.cloud import distribute
from pdpetsc.discrete.communicator import is_root, world
from pdpetsc.discrete.families import find_families
from pdpetsc.discrete.memory import predicted_bonds
from pdpetsc.problem.body import Body
from pdpetsc.problem.damage import make_damage
from pdpetsc.problem.problem import Problem
from pdpetsc.problem.supports import Supports
from pdpetsc.running.build import make_cloud
from pdpetsc.terms.bond_forces import BondForces
from tests.commands import ROOT, called, results, script_on
from tests.damage.test_criterion import FamilyStretch
from tests.gradient.test_conforming import square_mesh, uniform
from tests.pairs import pairs
from tests.scenes import (  # fmt: skip
    ALL_CONTROLS,
    LAWS,
    MATERIALS,
    SCHEMES,
    Small,
    dense_tangent,
    differences,
    displacement,
    rotation,
    small_points,
)
from tests.units import in_units

sys.path.insert(0, str(ROOT / "runs" / "convergence"))
import graded as kirsch

TENSION = "runs/patch/tension.py"


def graded(dim, rng, n=5, shake=0.15):
    """Return positions, volumes and horizons of a small shaken cloud whose spacing grows by three along x."""
    ticks = np.cumsum(np.linspace(0.5, 1.5, n))
    x = np.stack(np.meshgrid(ticks, *[np.arange(4.0 if dim < 3 else 3.0)] * (dim - 1), indexing="ij"), axis=-1)
    x = x.reshape(-1, dim)
    spacing = np.interp(x[:, 0], ticks, np.gradient(ticks))
    x = x + shake * spacing[:, None] * rng.uniform(-1.0, 1.0, x.shape)
    return x, spacing, 2.1 * np.maximum(spacing, 1.0 if dim > 1 else 0.0) * rng.uniform(0.8, 1.2, len(x))


SOLIDS = [(scheme, 3, 0.0) for scheme in pd.SCHEMES if scheme != "bond_associated"] + [("correspondence", 3, 0.2)]


@pytest.mark.parametrize(
    ("scheme", "dim", "shake"),
    [
        *pairs(pd.SCHEMES, [1, 2], [0.0, 0.2]),
        *(pytest.param(*row, marks=pytest.mark.long) for row in SOLIDS),
    ],
)
def test_tension_is_uniform_across_a_jump_of_the_spacing(scheme, dim, shake, tmp_path):
    """A tenth of strain, Hencky's material, no layer held: ghost forces of standard weights are as large as that."""
    G = 0.5 if scheme in ("correspondence", "corrected", "higher_order") else 0.0
    wide = 2.515 if dim == 3 else 3.015
    words = (f"dim={dim}", f"n={4 if dim == 3 else 6}", f"scheme={scheme}", f"horizon={wide}", f"shake={shake}")
    words = (*words, f"G={G}", "fine=2", "weights=conforming", "distribution=surface")
    found = results(TENSION, *words, output=tmp_path)
    assert found["results"]["max_F_error"] < 1e-8
    assert found["horizon"] == pytest.approx(2.0 * found["least_horizon"])


def test_standard_weights_have_ghost_forces_at_a_jump(tmp_path):
    found = results(TENSION, "fine=2", "horizon=3.015", "distribution=surface", output=tmp_path)["results"]
    assert found["max_F_error"] > 0.5 * found["strain"]


@pytest.mark.parametrize("at", [pd.Mesh, pd.MeshNodes])
@pytest.mark.parametrize("scheme", ["correspondence", "sub_horizons"])
def test_graded_meshes_pass_the_patch_test(at, scheme, tmp_path):
    points, triangles, _ = square_mesh(6)
    points[:, 0] = 2.0 * (0.5 * points[:, 0]) ** 1.7
    meshio.Mesh(points, [("triangle", triangles)]).write(tmp_path / "plate.xdmf")
    mesh = at(tmp_path / "plate.xdmf")
    ends = [pd.region.Slab("x", high=1e-9), pd.region.Slab("x", low=2.0 - 1e-9)]
    case = uniform(mesh, pd.Horizon(3.5), ends, scheme, material=pd.LinearElastic(E=1000.0, nu=0.3))
    result = pd.run(case, tmp_path / "out")
    assert result["F"] < 1e-8 * 1e-3
    assert result.summary["horizon"] > 1.5 * result.summary["least_horizon"]


def test_spacings_of_lattices_meshes_and_their_nodes(tmp_path):
    points = np.array([[0.0, 0.0], [2.0, 0.0], [4.0, 0.0], [0.0, 1.0], [2.0, 1.0], [4.0, 1.0]])
    quads = np.array([[0, 1, 4, 3], [1, 2, 5, 4]])
    meshio.Mesh(points, [("quad", quads)]).write(tmp_path / "two.xdmf")

    def reach(particles):
        case = pd.Case(particles=particles, horizon=pd.Horizon(2.0), material=MATERIALS["hencky"], conditions=[])
        cloud = make_cloud(world(), case)
        return cloud.local_horizon[np.argsort(cloud.gid)]

    path = tmp_path / "two.xdmf"
    np.testing.assert_array_equal(reach(pd.Lattice((0.0, 0.0), (1.0, 1.0), 0.1, thickness=0.3)), 2.0 * 0.1)
    np.testing.assert_allclose(reach(pd.Mesh(path, thickness=0.3)), 2.0 * np.sqrt(2.0), rtol=1e-14)
    corner, middle = 2.0 * (2.0 + 1.0) / 2.0, 2.0 * (2.0 + 2.0 + 1.0) / 3.0
    expected = [corner, middle, corner] * 2
    np.testing.assert_allclose(reach(pd.MeshNodes(path, thickness=0.3)), expected, rtol=1e-14)
    bar = pd.Arrays([[0.5], [2.0]], [1.0 * 0.3, 2.0 * 0.3], thickness=0.3)
    np.testing.assert_allclose(reach(bar), [2.0, 4.0], rtol=1e-14)
    cubes = pd.Arrays([[0.0, 0.0, 0.0], [3.0, 0.0, 0.0]], [8.0, 27.0])
    np.testing.assert_allclose(reach(cubes), [4.0, 6.0], rtol=1e-14)


def test_one_horizon_is_the_same_however_it_is_declared(tmp_path):
    plate = pd.Lattice((0.0, 0.0), (2.0, 1.0), 0.1, thickness=0.3)
    ends = [pd.region.Named("-x"), pd.region.Named("+x")]
    ways = [2.015 * 0.1, pd.Horizon(2.015), lambda x: np.full(len(x), 2.015 * 0.1), np.full(200, 2.015 * 0.1)]
    found = [pd.run(uniform(plate, way, ends), tmp_path).gathered(pd.displacement) for way in ways]
    for other in found[1:]:
        np.testing.assert_array_equal(other, found[0])
    assert np.abs(found[0]).max() > 0.0


@pytest.mark.parametrize("mutual", [False, True])
@pytest.mark.parametrize("dim", [1, 2, 3])
def test_families_are_what_a_particle_reaches(dim, mutual, rng):
    x = rng.uniform(0.0, 1.0, (60, dim))
    reach = 10.0 ** rng.uniform(-1.5, -0.3, len(x))
    cloud = distribute(world(), x, np.ones(len(x)), {}, reach, mutual=mutual)
    families = find_families(cloud)
    order = np.argsort(cloud.gid[: cloud.n_owned])
    apart = np.linalg.norm(x[:, None] - x[None], axis=2)
    joined = apart <= reach[:, None]
    joined |= joined.T if mutual else False
    np.fill_diagonal(joined, False)
    for i in range(len(x)):
        bonds = slice(families.indptr[order[i]], families.indptr[order[i] + 1])
        assert cloud.gid[families.neighbours[bonds]].tolist() == np.flatnonzero(joined[i]).tolist()
    assert predicted_bonds(world(), x, reach) > 0.0


def test_bonds_of_graded_bodies_are_predicted(rng):
    plate = pd.Lattice((0.0, 0.0), (40.0, 20.0), 1.0)
    chunk = plate.chunk(0, 1)
    reach = 2.0 + 0.1 * chunk.x[:, 0]
    cell = pd.Cell((0.0, 0.0), (40.0, 20.0), axes="y")
    for inside in (None, cell):
        cloud = distribute(world(), chunk.x, chunk.volume, {}, reach, inside)
        assert predicted_bonds(world(), chunk.x, reach, inside) == pytest.approx(
            len(find_families(cloud).neighbours), rel=0.15
        )


def graded_body(dim, rng, scheme, control, law=None, wide=1.0):
    x, spacing, reach = graded(dim, rng)
    reach = wide * reach
    cloud = distribute(world(), x, spacing, {}, reach)
    families = find_families(cloud)
    s = np.linalg.norm(families.bonds(cloud.x), axis=1) / cloud.local_horizon[families.centres]
    assert s.max() <= 1.0
    omega, material_of = pd.influence.Gaussian()(s), np.zeros(cloud.n_owned, dtype=np.int32)
    return small_points(cloud, families, omega, scheme, [MATERIALS["hencky"]], material_of, control, law)


def graded_bonds(dim, rng, material, damage=None):
    x, spacing, reach = graded(dim, rng)
    cloud = distribute(world(), x, spacing, {}, reach, mutual=True)
    families = find_families(cloud)
    length = np.linalg.norm(families.bonds(cloud.x), axis=1)
    omega = (length <= cloud.local_horizon[families.centres]).astype(float)
    around = Body(cloud, families)
    bonds = Neighbourhood(cloud, families, omega, pd.influence.Constant(), 1.0)
    material_term = BondForces(around, bonds, [material], np.zeros(cloud.n_owned, dtype=np.int32))
    failing = None
    if damage is not None:
        damageable = DamageableBonds.of(cloud, families, omega, material_term.k, material_term.finite)
        failing = make_damage(damage, around, damageable)
        material_term.take_damage(failing)
    return Small(Problem(around, material_term, [], Supports(around), failing))


CONTROLLED = [("correspondence", control) for control in ALL_CONTROLS]
BODIES = [*CONTROLLED, *((scheme, "none") for scheme in SCHEMES), ("smoothed", "none")]


@pytest.mark.parametrize(("scheme", "control"), BODIES)
def test_tangent_balance_and_energy_of_directed_families(scheme, control, rng):
    dim = 2
    used = pd.SmoothedDisplacement() if scheme == "smoothed" else SCHEMES[scheme]
    model = graded_body(dim, rng, used, ALL_CONTROLS[control], wide=1.6 if scheme == "smoothed" else 1.0)
    check(model, rng)


@pytest.mark.parametrize("dim", [1, 3])
def test_tangent_balance_and_energy_on_lines_and_in_space(dim, rng):
    check(graded_body(dim, rng, SCHEMES["correspondence"], pd.Silling(0.5)), rng)


def check(model, rng, symmetric=True):
    """Compare the tangent with differences; forces with the energy; force and moment with none."""
    u = displacement(model, rng)
    K = dense_tangent(model, u)
    columns = rng.choice(u.size, min(8, u.size), replace=False)
    expected = differences(model, u, columns)
    assert np.abs(K.reshape(u.size, -1)[:, columns] - expected).max() < 1e-7 * np.abs(K).max()
    v = rng.standard_normal(u.shape)
    np.testing.assert_allclose(model.tangent_times(u, v).ravel(), K.reshape(u.size, -1) @ v.ravel(), rtol=1e-9)
    f = model.internal_force(u)
    scale = np.abs(f).max()
    assert np.abs(f.sum(axis=0)).max() < 1e-11 * scale
    if symmetric:
        half = 1e-6 * v
        power = (sum(model.energy(u + half)) - sum(model.energy(u - half))) / 2e-6
        assert (f * v).sum() == pytest.approx(power, rel=1e-6, abs=1e-8 * scale)
    if model.dim > 1 and model.control is None:
        y = model.cloud.x + getattr(model.material_term, "finite", True) * u
        assert abs((y[:, 0] * f[:, 1] - y[:, 1] * f[:, 0]).sum()) < 1e-10 * scale * np.abs(y).max()


@pytest.mark.parametrize("law", LAWS)
def test_tangent_of_directed_bonds_that_soften(law, rng):
    model = graded_body(2, rng, SCHEMES["correspondence"], pd.Silling(0.5), LAWS[law](pd.ConstantCritical(0.02)))
    u = displacement(model, rng)
    K = dense_tangent(model, u).reshape(u.size, -1)
    columns = rng.choice(u.size, 8, replace=False)
    assert np.abs(K[:, columns] - differences(model, u, columns)).max() < 1e-6 * np.abs(K).max()


@pytest.mark.parametrize("dim", [1, 2, 3])
@pytest.mark.parametrize("kinematics", ["small", "finite"])
@pytest.mark.parametrize("calibration", ["continuum", "lattice", "family", "linear_solid"])
def test_bonds_between_different_horizons_have_opposite_forces_and_an_energy(calibration, kinematics, dim, rng):
    if calibration == "linear_solid":
        material = pd.LinearSolid(E=10.0, nu=0.1, kinematics=kinematics)
    else:
        material = pd.BondBased(E=10.0, calibration=calibration, kinematics=kinematics)
    model = graded_bonds(dim, rng, material)
    check(model, rng)
    # Every bond is held from both ends, and has stiffness from those that reach the other.
    families, cloud = model.families, model.cloud
    length = np.linalg.norm(families.bonds(cloud.x), axis=1)
    held = set(zip(families.centres.tolist(), families.neighbours.tolist(), strict=True))
    assert held == {(j, i) for i, j in held}
    assert np.array_equal(model.material_term.k > 0.0, length <= cloud.local_horizon[families.centres])
    assert not (model.material_term.k > 0.0).all()


@pytest.mark.parametrize("calibration", ["continuum", "lattice"])
def test_micromoduli_are_those_of_each_horizon(calibration):
    """On a lattice with another ratio in each half the energy of whole families has the modulus, on either side."""
    plate = pd.Lattice((0.0, 0.0), (40.0, 20.0), 1.0)
    chunk = plate.chunk(0, 1)
    reach = np.where(chunk.x[:, 0] < 20.0, 3.015, 5.015)
    cloud = distribute(world(), chunk.x, chunk.volume, {}, reach, mutual=True)
    families = find_families(cloud)
    length = np.linalg.norm(families.bonds(cloud.x), axis=1)
    omega = (length <= cloud.local_horizon[families.centres]).astype(float)
    bonds = Neighbourhood(cloud, families, omega, pd.influence.Constant(), 1.0)
    material = pd.BondBased(E=10.0, calibration=calibration)
    material_term = BondForces(Body(cloud, families), bonds, [material], np.zeros(cloud.n_owned, dtype=np.int32))
    e = 1e-3 * families.bonds(cloud.x)[:, 0] ** 2 / length
    energy = np.bincount(families.centres, 0.5 * material_term.k * e**2, cloud.n_owned)
    lam, mu = material.elastic(2).lame(2)
    exact = 0.5 * (lam + 2.0 * mu) * 1e-6
    for at in ((10.5, 10.5), (30.5, 10.5)):
        here = int(np.argmin(np.linalg.norm(cloud.x - at, axis=1)))
        assert energy[here] == pytest.approx(exact, rel=0.15)


def test_broken_bonds_of_directed_families_count_once(rng):
    model = graded_body(2, rng, SCHEMES["correspondence"], None, pd.Brittle(pd.ConstantCritical(0.01)))
    failure = model.failure
    both = {tuple(key) for key in failure.of.keys().tolist()}
    assert len(both) > len(failure.length) // 2  # some bonds have one end
    u = 0.02 * model.cloud.x * rng.uniform(0.5, 1.5, (len(model.cloud.x), 1))
    drive = model.driving_values(u)
    expected = {tuple(key) for key in failure.of.keys(drive >= 1.0).tolist()}
    assert 10 < len(expected) < len(both)
    found = failure.break_bonds(drive, 10**6)
    assert found == len(expected) == failure.count_broken()
    keys, states = failure.damaged()
    assert sorted(map(tuple, keys.tolist())) == sorted(expected)
    other = graded_body(2, np.random.default_rng(0), SCHEMES["correspondence"], None, failure.law)
    assert other.failure.restore(keys[:0], states[:0]) == 0
    intact = failure.phi.copy()
    failure.revert()
    assert failure.restore(keys, states) == len(expected)
    np.testing.assert_array_equal(failure.phi, intact)


def test_a_case_in_other_units_has_the_same_answer(tmp_path):
    case = block("gradient")
    one = pd.run(dataclasses.replace(case, fields=[]), tmp_path).gathered(pd.displacement)
    for force, length in ((1e12, 1e-9), (1e-9, 1e9)):
        other = pd.run(in_units(case, force, length), tmp_path).gathered(pd.displacement)
        np.testing.assert_allclose(other, one * length, rtol=1e-7, atol=1e-9 * length * np.abs(one).max())
    x = case.particles.chunk(0, 1).x
    assert np.abs(one).max() > 1e-3 * np.abs(x).max()


KINDS = (
    "gradient", "sub_horizons", "damage", "bonds", "events", "cell", "symmetry", "matfree", "relaxation", "conforming",
)  # fmt: skip


def block(kind):
    """Return a small graded body of each kind of case, asymmetric enough for every end and rank to matter."""
    ticks = np.concatenate([[0.0], np.cumsum(np.linspace(0.5, 1.5, 14))])
    middle, width = 0.5 * (ticks[1:] + ticks[:-1]), np.diff(ticks)
    axis = np.arange(6.0) + 0.5
    x = np.stack(np.meshgrid(middle, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    volume = np.repeat(width, len(axis))
    move = np.random.default_rng(1).uniform(-1.0, 1.0, x.shape)
    x = x + (0.0 if kind == "conforming" else 0.15) * move * np.minimum(volume, 1.0)[:, None]
    end = float(ticks[-1])
    left, right = pd.region.Slab("x", high=1.5), pd.region.Slab("x", low=end - 1.6)
    conditions = [pd.Displacement(left, x=0.0, y=0.0), pd.Displacement(right, x=0.3, y=0.1)]
    more = {"scheme": pd.Correspondence(), "control": pd.Silling(0.5), "material": MATERIALS["hencky"]}
    horizon = pd.Horizon(2.6)
    if kind == "sub_horizons":
        more |= {"scheme": pd.SubHorizons(), "control": None}
    if kind == "damage":
        more |= {"damage": pd.LinearSoftening(pd.ConstantCritical(0.02)), "steps": pd.Steps(1)}
        conditions = [pd.Displacement(left, x=0.0, y=0.0), pd.Displacement(right, x=0.2, y=0.1)]
    if kind in ("bonds", "events"):
        more = {"material": pd.BondBased(E=10.0)}
    if kind == "events":
        more |= {"damage": pd.Brittle(pd.ConstantCritical(0.03)), "solver": pd.EventDriven()}
        conditions = [pd.Displacement(left, x=0.0, y=0.0), pd.Displacement(right, x=0.3)]
    if kind == "cell":
        more |= {"cell": pd.Cell((0.0, 0.0), (end, 6.0), axes="y")}
        conditions.append(pd.MeanStrain(yy=0.0))
    if kind == "symmetry":
        more |= {"symmetry": [pd.Symmetry("y")]}
    if kind == "matfree":
        more |= {"options": {"pd_jacobian": "matfree"}}
    if kind == "relaxation":
        more |= {"solver": pd.DynamicRelaxation()}
    if kind == "conforming":
        more |= {"weights": pd.Conforming()}
    particles = pd.Arrays(x, volume, facets=outline(ticks, 6) if kind == "conforming" else None)
    return pd.Case(particles=particles, horizon=horizon, conditions=conditions, fields=[pd.displacement], **more)


def outline(ticks, n):
    """Return the outer facets of a grid of cells between ticks along x and 0 to n along y."""
    columns = len(ticks) - 1
    place, area, owner = [], [], []
    for c in range(columns):
        middle, width = 0.5 * (ticks[c] + ticks[c + 1]), ticks[c + 1] - ticks[c]
        place += [[middle, 0.0], [middle, float(n)]]
        area += [[0.0, -width], [0.0, width]]
        owner += [c * n, c * n + n - 1]
    for r in range(n):
        place += [[ticks[0], r + 0.5], [ticks[-1], r + 0.5]]
        area += [[-1.0, 0.0], [1.0, 0.0]]
        owner += [r, (columns - 1) * n + r]
    return pd.Facets(np.array(place), np.array(area), np.array(owner))


RANKS = """
import json, sys
import petsc4py
petsc4py.init(sys.argv[:1])
sys.path.insert(0, {root!r})
from tests.discrete.test_horizon import answers
answers({path!r}, {kinds!r})
"""


def answers(path, kinds):
    """Run the bodies of some kinds and write what they gave."""
    for kind in kinds:
        result = pd.run(block(kind), f"{path}_{kind}")
        lost = result.gathered(pd.local_damage) if kind in ("damage", "events") else None
        u = result.gathered(pd.displacement)
        if is_root(world()):
            found = [u.tolist(), result.summary["bonds"], None if lost is None else lost.tolist()]
            Path(f"{path}_{kind}.json").write_text(json.dumps(found))


SLOW = ("relaxation", "events", "damage")


@pytest.mark.long
@pytest.mark.parametrize(
    ("ranks", "kinds"),
    [
        (2, [kind for kind in KINDS if kind not in SLOW]),
        pytest.param(2, ["gradient", *SLOW], marks=pytest.mark.long),
        pytest.param(3, KINDS, marks=pytest.mark.long),
    ],
    ids=["2", "2, slow", "3"],
)
def test_any_number_of_ranks_gives_the_same(ranks, kinds, tmp_path):
    script_on(ranks, RANKS.format(root=str(ROOT), path=str(tmp_path / "several"), kinds=kinds))
    answers(tmp_path / "one", kinds)

    def read(name):
        return {kind: json.loads((tmp_path / f"{name}_{kind}.json").read_text()) for kind in kinds}

    one, several = read("one"), read("several")
    for kind in {"matfree", "relaxation"} & set(kinds):
        np.testing.assert_allclose(one[kind][0], one["gradient"][0], atol=1e-5)
    for kind in kinds:
        (u, bonds, lost), (v, count, gone) = one[kind], several[kind]
        assert np.abs(u).max() > 0.05
        assert count == bonds, kind
        np.testing.assert_allclose(v, u, atol=1e-6 * np.abs(u).max(), err_msg=kind)
        if lost is not None:
            assert max(lost) > 0.05
            np.testing.assert_allclose(gone, lost, atol=1e-6, err_msg=kind)


def across(x):
    """Return horizons of two spacings of a tenth that grow to four along x and y."""
    return 0.2015 + 0.1 * x[:, 0] * x[:, 1]


@pytest.mark.parametrize("beside", ["crack", "mirror", "cell"])
@pytest.mark.parametrize("scheme", ["correspondence", "sub_horizons", "stress_points"])
def test_tension_is_uniform_beside_cracks_mirrors_and_periods(beside, scheme, tmp_path):
    """Tension along a crack, along a mirror plane and in a cell that is free to contract, with growing horizons."""
    plate = pd.Lattice((0.0, 0.0), (2.0, 1.0), 0.1)
    case = uniform(plate, across, [pd.region.Named("-x"), pd.region.Named("+x")], scheme)
    case = dataclasses.replace(case, material=pd.LinearElastic(E=1000.0, nu=0.3))
    if beside == "crack":
        case = dataclasses.replace(case, cracks=[pd.Segment((0.55, 0.5), (1.55, 0.5))])
    if beside == "mirror":
        held, _, *loads = case.conditions
        at = pd.Displacement(held.region, x=held.x)
        case = dataclasses.replace(case, symmetry=[pd.Symmetry("y")], conditions=[at, *loads])
        # With the plane at 0 the exact displacement has none there.
        assert case.symmetry[0].at == 0.0
    if beside == "cell":
        held, _, *loads = case.conditions
        case = dataclasses.replace(
            case, cell=pd.Cell((0.0, 0.0), (2.0, 1.0), axes="y"), conditions=[held, pd.MeanStress(yy=0.0), *loads]
        )
    if (scheme, beside) == ("stress_points", "mirror"):
        pytest.skip("drawn at random")
    result = pd.run(case, tmp_path)
    assert result["F"] < 1e-9
    assert result.summary["horizon"] > 1.5 * result.summary["least_horizon"]
    np.testing.assert_array_equal(result.gathered(pd.local_horizon), across(plate.chunk(0, 1).x))


ONE_WAY = """
import sys
sys.path.insert(0, {root!r})
import numpy as np
from pdpetsc.discrete.cloud import distribute
from pdpetsc.discrete.communicator import world
from pdpetsc.discrete.components import find_pieces
from pdpetsc.discrete.families import find_families
comm = world()
for far, mutual in (((1.1, 1.1, 2.1, 1.1), False), ((1.1, 2.1, 1.1, 1.1), False), ((1.1, 2.1, 1.1, 1.1), True)):
    x = np.array([[0.0], [1.0], [3.0], [4.0]])
    mine = slice(2 * comm.rank, 2 * comm.rank + 2)
    cloud = distribute(comm, x[mine], np.ones(2), {{}}, np.array(far)[mine], mutual=mutual)
    families = find_families(cloud)
    assert find_pieces(cloud, families).tolist() == [0, 0], (far, comm.rank)
    # The rank whose particle reaches over knows the other one, and the other rank nothing of it.
    reaches = mutual or far.index(2.1) in cloud.gid[:2]
    assert cloud.n_ghost == int(reaches), (far, comm.rank)
    assert len(families.neighbours) == 2 + int(reaches)
"""


def test_a_bond_of_one_end_across_ranks_joins_pieces_and_asks_for_one_ghost():
    script_on(2, ONE_WAY.format(root=str(ROOT)))


@pytest.mark.long
def test_a_graded_plate_with_a_hole_takes_few_particles(tmp_path):
    """The stress that the study compares with belongs to the displacement it compares with, and is in equilibrium."""
    lam, mu = pd.LinearElastic(kirsch.E, kirsch.NU).lame(2)
    x, h = np.array([[1.1, 0.4], [-0.3, 1.7], [2.0, -3.0]]), 1e-5
    one = np.eye(2)
    grad = np.stack(
        [(kirsch.displacement(x + h * e, 1.0) - kirsch.displacement(x - h * e, 1.0)) / (2.0 * h) for e in one], axis=2
    )
    strain = 0.5 * (grad + grad.transpose(0, 2, 1))
    expected = lam * np.einsum("nii->n", strain)[:, None, None] * one + 2.0 * mu * strain
    np.testing.assert_allclose(kirsch.stress(x, 1.0), expected, atol=1e-8 * kirsch.PULL)
    slopes = [(kirsch.stress(x + h * e, 1.0) - kirsch.stress(x - h * e, 1.0)) / (2.0 * h) for e in one]
    np.testing.assert_allclose(slopes[0][:, :, 0] + slopes[1][:, :, 1], 0.0, atol=1e-7 * kirsch.PULL)
    found = {
        (mesh, n): results("runs/convergence/graded.py", f"mesh={mesh}", f"n={n}", output=tmp_path)
        for mesh, n in (("uniform", 8), ("graded", 8), ("graded", 16))
    }
    counts = {key: value["particles"] for key, value in found.items()}
    of = {key: value["results"] for key, value in found.items()}
    assert counts["graded", 8] < 0.12 * counts["uniform", 8]
    assert of["graded", 8]["error_surface_stress"] < 1.5 * of["uniform", 8]["error_surface_stress"]
    assert counts["graded", 16] < 0.5 * counts["uniform", 8]
    for error in kirsch.ERRORS:
        assert of["graded", 16][error] < 0.7 * of["uniform", 8][error], error
    standard = results("runs/convergence/graded.py", "n=16", "weights=standard", output=tmp_path)["results"]
    assert standard["error_stress"] > 10.0 * of["graded", 16]["error_stress"]


def test_a_half_is_the_whole():
    """Images behind a mirror plane have the horizons of their particles."""
    half = block("symmetry")
    x, volume = half.particles.x, half.particles.volume
    both = pd.Arrays(np.concatenate([x, x * [1.0, -1.0]]), np.concatenate([volume, volume]))
    conditions = [dataclasses.replace(half.conditions[0]), dataclasses.replace(half.conditions[1], y=None)]
    found = []
    for particles, planes in ((half.particles, half.symmetry), (both, [])):
        case = dataclasses.replace(half, particles=particles, symmetry=planes, conditions=conditions)
        prepared = pd.prepare(case)
        found.append(prepared)
    u = 0.02 * np.sin(x) * [1.0, 0.5]
    whole = np.concatenate([u, u * [1.0, -1.0]])
    forces = []
    for prepared, field in zip(found, (u, whole), strict=True):
        gid = prepared.cloud.gid[: prepared.cloud.n_owned]
        f = np.empty_like(field)
        f[gid] = prepared.problem.internal_force(prepared.problem.state(field[gid]))
        forces.append(f)
    np.testing.assert_allclose(forces[1][: len(x)], forces[0], atol=1e-12 * np.abs(forces[0]).max())


def test_a_run_goes_on_with_its_own_horizons_only(tmp_path):
    case = dataclasses.replace(block("damage"), steps=pd.Steps(2))
    pd.run(case, tmp_path / "one")
    again = pd.run(case, tmp_path / "two", restart=tmp_path / "one")
    assert again.summary["status"] == "converged"
    with pytest.raises(pd.CaseError, match="horizon"):
        pd.run(dataclasses.replace(case, horizon=pd.Horizon(2.7)), tmp_path / "two", restart=tmp_path / "one")
    lengths = 2.6 * np.sqrt(np.asarray(case.particles.volume))
    lengths[[0, 1]] = lengths[[1, 0]] * 1.0001
    with pytest.raises(pd.CaseError, match="horizon"):
        pd.run(dataclasses.replace(case, horizon=lengths), tmp_path / "two", restart=tmp_path / "one")


PLATE = pd.Lattice((0.0, 0.0), (4.0, 2.0), 1.0)


@pytest.mark.parametrize(
    ("horizon", "message"),
    [
        ("2", "takes a number, a Horizon, a function, an array or None as horizon, not '2'"),
        ([2.0, 2.0], "takes a number, a Horizon, a function, an array or None as horizon"),
        (float("nan"), "takes a number, a Horizon"),
        (0.5, "The horizon 0.5 is below the spacing 1: .* at least 1.015, 1.015 spacings, or leave `horizon` out"),
        (pd.Horizon, "the class Horizon"),
        (np.full((8, 1), 2.0), "one length per particle"),
        (np.array(["a"] * 8), "one length per particle"),
        (np.array([2.0] * 7 + [np.nan]), "1 of 8 horizons are not positive, the first is nan of particle 7"),
        (np.array([2.0] * 7 + [0.0]), "not positive"),
        (np.array([2.0] * 7 + [np.inf]), "not positive"),
    ],
)
def test_what_is_no_horizon_is_refused(horizon, message):
    with pytest.raises(pd.CaseError, match=message):
        pd.Case(particles=PLATE, horizon=horizon, material=MATERIALS["hencky"], conditions=[])


@pytest.mark.parametrize("body", ["bonds", "solid", "points"])
def test_what_a_jump_leaves_of_a_uniform_strain(body, tmp_path):
    """The numbers of the pages: bonds keep a tenth, conforming weights nothing, at two spacings."""
    found = [results("runs/patch/jump.py", f"body={body}", f"n={n}", output=tmp_path)["results"] for n in (16, 32)]
    low, high = {"bonds": (0.1, 0.16), "solid": (0.1, 0.16), "points": (0.25, 0.35)}[body]
    assert all(low < one["error"] < high for one in found)
    if body == "points":
        words = ("body=points", "weights=conforming", "n=16")
        assert results("runs/patch/jump.py", *words, output=tmp_path)["results"]["error"] < 1e-9


@pytest.mark.parametrize("ratio", [0.0, -1.0, np.inf, np.nan, "2"])
def test_a_ratio_is_positive(ratio):
    with pytest.raises(pd.CaseError, match="Horizon takes"):
        pd.Horizon(ratio)


def test_a_ratio_below_one_spacing_is_refused():
    with pytest.raises(pd.CaseError, match=r"is 0.9, below one spacing: families would be empty. Use at least 1.015"):
        pd.Case(particles=PLATE, horizon=pd.Horizon(0.9), material=MATERIALS["hencky"], conditions=[])


@pytest.mark.parametrize(
    ("horizon", "message"),
    [
        (np.full(9, 2.0), "8 particles and an array of 9 horizons"),
        (lambda x: 2.0, "one length per particle, not an array of shape"),
        (lambda x: x, "one length per particle, not an array of shape"),
        (lambda x: ["a"] * len(x), "one length per particle"),
        (lambda x: 2.0 - x[:, 0], "it must be positive and finite"),
        (lambda x: x[:, 5], "The horizon .* failed at test_horizon.py"),
    ],
)
def test_horizons_that_do_not_fit_the_particles_are_refused(horizon, message):
    held = [pd.Displacement(pd.region.All(), x=0.0, y=0.0)]
    case = pd.Case(particles=PLATE, horizon=horizon, material=MATERIALS["hencky"], conditions=held)
    with pytest.raises(pd.CaseError, match=message):
        pd.prepare(case)


def test_one_rank_alone_refuses_for_all(tmp_path):
    script = tmp_path / "refused.py"
    script.write_text(
        textwrap.dedent(
            f"""
            import sys
            sys.path.insert(0, {str(ROOT)!r})
            import pdpetsc as pd
            from tests.discrete.test_horizon import MATERIALS, PLATE

            def case():
                return pd.Case(
                    particles=PLATE, horizon=lambda x: 3.4 - x[:, 0], material=MATERIALS["hencky"],
                    conditions=[pd.Displacement(pd.region.All(), x=0.0, y=0.0)],
                )
            """
        )
    )
    done = called(script, "-o", tmp_path / "out", ranks=2)
    assert done.returncode == 2
    assert done.stderr.count("it must be positive and finite") == 1


@pytest.mark.parametrize("law", [pd.Brittle, pd.LinearSoftening])
@pytest.mark.parametrize("calibration", ["continuum", "lattice"])
def test_breaking_all_bonds_across_a_plane_takes_the_fracture_energy_at_any_horizon(calibration, law):
    """Three and five spacings in one body: the pairs across x = 15 and x = 45, and less exactly across the jump."""
    plate = pd.Lattice((0.0, 0.0), (60.0, 24.0), 1.0)
    Gc = 0.02
    case = pd.Case(
        particles=plate, horizon=lambda x: np.where(x[:, 0] < 30.0, 3.015, 5.015), conditions=[],
        material=pd.BondBased(E=10.0, calibration=calibration), damage=law(pd.FractureEnergy(Gc)),
    )  # fmt: skip
    cloud = make_cloud(world(), case)
    body = Body(cloud, find_families(cloud))
    length = np.linalg.norm(body.families.bonds(cloud.x), axis=1)
    omega = (length <= cloud.local_horizon[body.families.centres]).astype(float)
    bonds = Neighbourhood(cloud, body.families, omega, pd.influence.Constant(), 1.0)
    k = case.material.stiffness(bonds).k
    damage = make_damage(case.damage, body, DamageableBonds.of(cloud, body.families, omega, k, False))
    limit = damage.driving_variable.limit
    key = np.lexsort(damage.bonds.of.keys().T)
    np.testing.assert_allclose(limit[key[::2]], limit[key[1::2]], rtol=1e-14)
    share = damage.bonds.law.toughness(2.0)
    a, b = cloud.x[body.families.centres], cloud.x[body.families.neighbours]
    # Bonds have their middles on rows and between them: six of either kind.
    middle = 0.5 * (a + b)[:, 1]
    inside = (middle >= 9.0) & (middle < 15.0)
    for at, rel in ((15.0, 0.06), (45.0, 0.06), (30.0, 0.06)):
        across = inside & ((a[:, 0] - at) * (b[:, 0] - at) < 0.0)
        energy = (0.5 * share * k * limit**2)[across].sum() / 6.0
        assert energy == pytest.approx(Gc, rel=rel), at


def test_directed_bonds_take_a_fracture_energy_too(tmp_path):
    case = dataclasses.replace(block("damage"), damage=pd.LinearSoftening(pd.FractureEnergy(0.004)))
    result = pd.run(case, tmp_path)
    assert 0.01 < result.gathered(pd.local_damage).max() < 1.0


def test_a_drive_of_both_families_is_refused_where_one_may_be_missing():
    case = dataclasses.replace(block("damage"), damage=pd.LinearSoftening(FamilyStretch(0.02)))
    with pytest.raises(pd.CaseError, match="reads the families of both ends"):
        pd.prepare(case)
    pd.prepare(dataclasses.replace(case, horizon=3.0))


def test_rotations_have_no_force(rng):
    model = graded_body(2, rng, SCHEMES["correspondence"], None)
    Q = rotation(2, rng)
    u = model.cloud.x @ (Q - np.eye(2)).T
    f = model.internal_force(u)
    bent = model.internal_force(displacement(model, rng))
    assert np.abs(f).max() < 1e-11 * np.abs(bent).max()
