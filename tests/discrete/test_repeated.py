"""Families that repeat on a lattice: the same forces, tangents, energies and fields as with all bonds listed."""

import itertools
from dataclasses import replace
from inspect import signature

import numpy as np
import pytest

import pdpetsc as pd
from pdpetsc.discrete import lattice_stencils, memory
from pdpetsc.discrete.components import find_pieces
from pdpetsc.kernels import lattice_stencils as lattice_kernels
from pdpetsc.running import build
from tests.commands import script_on
from tests.pairs import pairs
from tests.scenes import study, world

ALIKE = 1e-12
SCHEMES = {
    "correspondence": pd.Correspondence(),
    "sub_horizons": pd.SubHorizons(),
    "higher_order": pd.HigherOrder(),
    "corrected": pd.Corrected(),
    "bond_associated": pd.BondAssociated(),
}
CONTROLS = {"silling": pd.Silling(0.3), "none": None}
LENGTHS = {1: [60.0], 2: [26.0, 21.0], 3: [16.0, 12.0, 13.0]}


def block(dim, **changes):
    """Return a block of unit spacing with a notch at its corner, pulled at one end."""
    lengths = LENGTHS[dim]
    notch = pd.region.Box([lengths[0] - 3.0] * dim, [lengths[0] + 1.0] * dim)
    case = pd.Case(
        particles=pd.Lattice([0.0] * dim, lengths, 1.0, cut=notch if dim > 1 else None),
        horizon=2.015,
        material=pd.Hencky(10.0, 0.3),
        scheme=pd.Correspondence(),
        control=pd.Silling(0.3),
        conditions=[
            pd.Displacement(pd.region.Slab("x", high=1.0), **dict.fromkeys("xyz"[:dim], 0.0)),
            pd.Displacement(pd.region.Slab("x", low=lengths[0] - 1.0), x=0.1),
        ],
    )
    return replace(case, **changes)


@pytest.fixture
def few(monkeypatch):
    """Let families of small bodies repeat."""
    share_small_families(monkeypatch.setattr)


def share_small_families(put):
    """Lower the numbers from which families repeat."""
    put(lattice_stencils, "FEWEST", 8)
    put(build, "LEAST_REPEATED", 0.05)


def both(case):
    """Return the problems of a case with families that repeat and with all bonds listed (collective)."""
    shared = pd.prepare(case, comm=world()).problem
    keep = build.repeated_share
    build.repeated_share = lambda case: None
    try:
        return shared, pd.prepare(case, comm=world()).problem
    finally:
        build.repeated_share = keep


def rough(cloud, size=0.01):
    """Return a rough displacement of the unknowns of this rank that depends on the particles alone."""
    whole = np.random.default_rng(3).uniform(-size, size, (cloud.n_global, cloud.dim))
    u = np.zeros((cloud.n_rows, cloud.dim))
    u[: cloud.n_owned] = whole[cloud.gid[: cloud.n_owned]]
    return u


def furthest(case):
    """Return the largest relative difference of what both problems of a case compute, and the shared share."""
    shared, listed = both(case)
    lattice = shared.body.families.lattice
    assert lattice is not None
    assert listed.body.families.lattice is None
    assert np.array_equal(shared.body.families.indptr, listed.body.families.indptr)
    assert np.array_equal(shared.body.families.neighbours, listed.body.families.neighbours)
    assert shared.material_term.note == listed.material_term.note
    assert shared.body.families.n_bonds == len(listed.body.families.neighbours)
    found = []
    assert shared.material_term.linear == listed.material_term.linear
    assert shared.parts == listed.parts
    for problem in (shared, listed):
        u = rough(problem.body.cloud)
        if problem.damage is not None:
            assert problem.soften(problem.state(0.7 * u)) > 0.0
        state = problem.state(u)
        energies = problem.energies(state)
        force = problem.internal_force(state)
        one_by_one = sum(problem.force_of([term], state) for term in problem.terms if not term.load)
        field = np.concatenate(
            [
                problem.material_term.cauchy_stress(state).ravel(),
                problem.material_term.deformation_gradient(state).ravel(),
            ]
        )
        tangent = problem.linearised(problem.state(u))
        product = tangent(u * u + u).copy()
        every = [energies["strain"], energies["control"]]
        blocks = tangent.point_blocks()
        rest = problem.linearised(problem.state(np.zeros_like(u)))
        at_rest = np.concatenate(
            [rest(u).ravel(), rest.stiffness().ravel(), rest.strength(), rest.point_blocks().ravel()]
        )
        found.append((np.array(every), force, one_by_one, field, product, tangent.stiffness(), blocks, at_rest))
    furthest = [np.abs(a - b).max() / np.abs(b).max() for a, b in zip(*found, strict=True)]
    assert problem.admissible(problem.state(u))
    return max(furthest), lattice


@pytest.mark.parametrize(("dim", "scheme", "control"), pairs([1, 2, 3], SCHEMES, CONTROLS))
@pytest.mark.usefixtures("few")
def test_what_is_computed_is_the_same_as_with_all_bonds_listed(dim, scheme, control):
    found, lattice = furthest(block(dim, scheme=SCHEMES[scheme], control=CONTROLS[control]))
    assert found < ALIKE
    assert lattice.shared.mean() > 0.4
    assert lattice.n_patterns > dim - 1


@pytest.mark.parametrize(
    ("dim", "scheme", "control"),
    [(2, "sub_horizons", "silling"), (3, "correspondence", "silling"), (3, "corrected", "none")],
)
@pytest.mark.usefixtures("few")
def test_points_that_fail_keep_families_that_repeat(dim, scheme, control):
    damage = pd.PointDamage(pd.softening.Linear(), Gc=0.05, onset=0.004, protected=pd.region.Slab("x", high=2.0))
    cracks = [pd.Segment((9.3, 0.0), (9.3, 12.2))] if dim == 2 else []
    found, lattice = furthest(
        block(dim, scheme=SCHEMES[scheme], control=CONTROLS[control], damage=damage, cracks=cracks)
    )
    assert found < ALIKE
    assert lattice.shared.mean() > 0.4


@pytest.mark.parametrize("dim", [1, 2, 3])
@pytest.mark.parametrize("kinematics", ["small", "finite"])
@pytest.mark.usefixtures("few")
def test_bonds_repeat_too(dim, kinematics):
    for calibration in ("continuum", "lattice", "family"):
        material = pd.BondBased(10.0, kinematics=kinematics, calibration=calibration)
        found, _ = furthest(block(dim, scheme=None, control=None, material=material))
        assert found < ALIKE, calibration


@pytest.mark.parametrize("dim", [1, 2, 3])
@pytest.mark.usefixtures("few")
def test_displacements_that_are_no_numbers_are_not_admissible(dim):
    bonds = block(dim, scheme=None, control=None, material=pd.BondBased(10.0, kinematics="finite"))
    for case in (bonds, block(dim)):
        for problem in both(case):
            u = rough(problem.body.cloud)
            assert problem.admissible(problem.state(u))
            u[len(u) // 2, -1] = np.nan
            assert not problem.admissible(problem.state(u))


@pytest.mark.usefixtures("few")
def test_two_materials_grading_mirrors_cells_cracks_and_other_units_do_not_change_that():
    two = [(pd.region.Slab("x", high=6.0), pd.Hencky(10.0, 0.3)), (pd.region.Slab("x", low=6.0), pd.Hencky(30.0, 0.2))]
    graded = pd.Graded(pd.Hencky(10.0, 0.3), lambda x: 1.0 + 0.1 * x[:, 0])
    x = block(2).particles.chunk(0, 1).x
    flat = pd.Arrays(x * [1.0, 0.5], 0.15, thickness=0.3)
    mean = [pd.MeanStrain(xx=0.01, yy=0.0, xy=0.0), pd.Displacement(pd.region.Sphere((0.5, 0.5), 0.1), x=0.0, y=0.0)]
    whole = pd.Lattice([0.0, 0.0], LENGTHS[2], 1.0)
    changes = [
        {"material": two},
        {"material": graded},
        {"control": pd.SillingMicromodulus(0.3, 2.0)},
        {"particles": flat, "horizon": 2.4},
        {"symmetry": (pd.Symmetry("y", at=0.0),)},
        {"particles": whole, "cell": pd.Cell([0.0, 0.0], LENGTHS[2]), "conditions": mean},
        {"cracks": [pd.Segment((9.3, 0.0), (9.3, 12.2))]},
        {
            "material": pd.Thermal(pd.Hencky(10.0, 0.3), 1e-3, factor=lambda T: 1.0 + 1e-3 * T),
            "conditions": [*block(2).conditions, pd.Temperature(pd.region.All(), lambda x, t: x[:, 0] + x[:, 1] ** 2)],
        },
    ]
    for change in changes:
        found, _ = furthest(block(2, **change))
        assert found < ALIKE, change


@pytest.mark.usefixtures("few")
def test_beside_a_crack_families_repeat_and_no_bond_crosses_it():
    held = [pd.Displacement(pd.region.All(), x=0.0, y=0.0)]
    shared, _ = both(block(2, cracks=[pd.Segment((-1.0, 9.3), (27.0, 9.3))], conditions=held))
    lattice, x = shared.body.families.lattice, shared.body.cloud.x
    beside = (np.abs(x[:, 1] - 9.3) < 1.0) & (np.abs(x[:, 0] - 13.0) < 8.0)
    assert lattice.shared[beside].all()
    bonds = shared.body.families.connecting
    assert not ((x[bonds.centres, 1] - 9.3) * (x[bonds.neighbours, 1] - 9.3) < 0.0).any()


@pytest.mark.usefixtures("few")
def test_pieces_are_the_same_through_the_bonds_that_connect_them():
    for cracks in ([], [pd.Segment((9.3, 0.0), (9.3, 22.0))]):
        held = [pd.Displacement(pd.region.All(), x=0.0, y=0.0)]
        shared, listed = both(block(2, cracks=cracks, conditions=held))
        labels = [build_pieces(problem) for problem in (shared, listed)]
        assert np.array_equal(*labels)
        assert len(np.unique(labels[0])) == 1 + len(cracks)


def build_pieces(problem):
    """Return the piece of each particle of a problem."""
    return find_pieces(problem.body.cloud, problem.body.families)


@pytest.mark.usefixtures("few")
def test_listed_weights_are_those_of_the_scheme():
    for dim, scheme in itertools.product((2, 3), (pd.Correspondence(), pd.SubHorizons())):
        shared, listed = both(block(dim, scheme=scheme))
        one, other = shared.material_term.operator, listed.material_term.operator
        assert np.array_equal(one.point_ptr, other.point_ptr)
        assert np.allclose(one.volume, other.volume, rtol=1e-13)
        for p in np.linspace(0, one.n_points - 1, 40).astype(int):
            entries = slice(one.point_ptr[p], one.point_ptr[p + 1])
            order, other_order = np.argsort(one.members[entries]), np.argsort(other.members[entries])
            assert np.array_equal(one.members[entries][order], other.members[entries][other_order])
            assert np.allclose(one.g[entries][order], other.g[entries][other_order], atol=1e-12)


@pytest.mark.usefixtures("few")
def test_the_assembled_matrix_is_the_same():
    shared, listed = both(block(2, scheme=pd.SubHorizons()))
    u = rough(shared.body.cloud)
    one, other = (study.dense_tangent(problem, u) for problem in (shared, listed))
    assert np.abs(one - other).max() < ALIKE * np.abs(other).max()


@pytest.mark.usefixtures("few")
def test_irregular_bodies_and_those_with_bonds_of_their_own_list_all_bonds(rng):
    base = block(2)
    chunk = base.particles.chunk(0, 1)
    shaken = pd.Arrays(chunk.x + rng.uniform(-0.1, 0.1, chunk.x.shape), 1.0)
    uneven = pd.Arrays(chunk.x, rng.uniform(0.9, 1.1, len(chunk.x)))
    others = [
        replace(base, particles=shaken),
        replace(base, particles=uneven),
        replace(base, control=pd.Springs(0.5)),
        replace(base, scheme=pd.StressPoints()),
        replace(base, damage=pd.Brittle(pd.damage.ConstantCritical(1.0))),
        replace(base, weights=pd.Conforming()),
        replace(base, scheme=None, control=None, material=pd.LinearSolid(1.0, 0.3)),
    ]
    for case in others:
        assert pd.prepare(case).problem.body.families.lattice is None


@pytest.mark.usefixtures("few")
def test_particles_in_any_order_repeat(rng):
    chunk = block(2).particles.chunk(0, 1)
    order = rng.permutation(len(chunk.x))
    one = pd.prepare(block(2)).problem
    other = pd.prepare(block(2, particles=pd.Arrays(chunk.x[order], chunk.volume[order]))).problem
    assert other.body.families.lattice.shared.mean() == pytest.approx(one.body.families.lattice.shared.mean(), abs=0.1)
    u = rng.uniform(-0.01, 0.01, chunk.x.shape)
    forces = []
    for problem, where in ((one, np.arange(len(order))), (other, order)):
        gid = problem.body.cloud.gid[: problem.body.cloud.n_owned]
        force = np.empty_like(u)
        force[where[gid]] = problem.internal_force(problem.state(u[where][gid]))
        forces.append(force)
    assert np.abs(forces[0] - forces[1]).max() < ALIKE * np.abs(forces[0]).max()


@pytest.mark.usefixtures("few")
def test_points_of_bonds_keep_their_history_in_the_order_of_the_bonds(rng):
    plastic = {"scheme": pd.BondAssociated(), "material": pd.J2(10.0, 0.3, yield_stress=0.01, hardening=0.1)}
    whole, x = pd.Lattice([0.0, 0.0], LENGTHS[2], 1.0), block(2).particles.chunk(0, 1).x
    mean = [pd.MeanStrain(xx=0.01, yy=0.0, xy=0.0), pd.Displacement(pd.region.Sphere((0.5, 0.5), 0.1), x=0.0, y=0.0)]
    cell = block(2, particles=whole, cell=pd.Cell([0.0, 0.0], LENGTHS[2]), conditions=mean, **plastic)
    shuffled = block(2, particles=pd.Arrays(x[rng.permutation(len(x))], 1.0), **plastic)
    for case in (block(2, **plastic), cell, shuffled):
        problems = both(case)
        # Particles of any order list the members of their families in as many orders.
        assert (problems[0].body.families.lattice is None) == (case is shuffled)
        histories = []
        for problem in problems:
            problem.commit(problem.state(rough(problem.body.cloud)))
            (array,) = problem.material_term.arrays().values()
            histories.append(array.values)
        assert np.abs(histories[0] - histories[1]).max() < ALIKE


@pytest.mark.usefixtures("few")
def test_a_bond_through_the_rim_of_a_crack_is_cut_from_both_of_its_ends():
    x = 0.1 * (block(3, particles=pd.Lattice([0.0] * 3, [12.0] * 3, 1.0)).particles.chunk(0, 1).x)
    square = pd.PolygonCrack([(0.3, 0.3, 0.6), (0.9, 0.3, 0.6), (0.9, 0.9, 0.6), (0.3, 0.9, 0.6)])
    held = [pd.Displacement(pd.region.All(), x=0.0, y=0.0, z=0.0)]
    case = block(3, particles=pd.Arrays(x, 1e-3), horizon=0.2015, cracks=[square], conditions=held)
    problems = both(case)
    assert problems[0].body.families.lattice is not None
    for problem in problems:
        families = problem.body.families
        there = set(zip(families.centres.tolist(), families.neighbours.tolist(), strict=True))
        assert there == {(j, i) for i, j in there}


def test_rounding_of_positions_does_not_add_up_along_a_lattice():
    x = 5.0 + 0.01 * (np.stack(np.meshgrid(np.arange(2000.0), np.arange(3.0), indexing="ij"), axis=-1).reshape(-1, 2))
    spacing, index = lattice_stencils.positions_on_lattice(x, 0.03)
    assert spacing == pytest.approx([0.01, 0.01], rel=1e-12)
    assert np.array_equal(index.max(axis=0), [1999, 2])
    assert lattice_stencils.positions_on_lattice(x + 1e-7 * np.sin(7.0 * x), 0.03) is None


@pytest.mark.usefixtures("few")
def test_flat_families_are_all_counted():
    layer = block(3, particles=pd.Lattice([0.0] * 3, [20.0, 15.0, 1.0], 1.0))
    with pytest.raises(pd.CaseError, match=r"^300 particles"):
        pd.prepare(layer, comm=world())


def test_memory_is_predicted_without_the_bonds_that_are_not_listed(monkeypatch):
    monkeypatch.setattr(memory, "free_memory", lambda: 200.0 * 2**20)
    cube = block(3, particles=pd.Lattice([0.0] * 3, [40.0] * 3, 1.0), horizon=3.015)
    build.make_cloud(world(), cube)
    for change in ({"control": pd.Springs(0.5)}, {"horizon": 20.0}):
        with pytest.raises(pd.CaseError, match="takes at least"):
            build.make_cloud(world(), replace(cube, **change))


def test_no_loop_over_rows_closes_over_another():
    """Numba's cache does not find such loops again: every run would compile them, and leave another file."""
    makers = [make for name, make in vars(lattice_kernels).items() if name.startswith("rows_")]
    assert len(makers) > 5
    for make in makers:
        constants = [2 if name == "dim" else 1 for name in signature(make).parameters]
        for cell in make(*constants).py_func.__closure__ or ():
            assert not callable(cell.cell_contents), make


@pytest.mark.parametrize("ranks", [2, pytest.param(3, marks=pytest.mark.long)])
def test_ranks_share_families_too(ranks):
    found = script_on(
        ranks, "import tests.discrete.test_repeated\n\ntests.discrete.test_repeated.compare_on_all_ranks()"
    )
    assert found.count("alike") == 3 * ranks


def compare_on_all_ranks():
    """Print for some blocks that sharing changes nothing (collective)."""
    for parallel in (block(2), block(3, scheme=pd.SubHorizons(), control=None), block(2, symmetry=(pd.Symmetry("y"),))):
        with pytest.MonkeyPatch.context() as patch:
            share_small_families(patch.setattr)
            difference, lattice = furthest(parallel)
        assert difference < ALIKE, parallel
        assert lattice.n_patterns > 0
        print("alike")
