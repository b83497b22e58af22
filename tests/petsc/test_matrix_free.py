"""The tangent without a matrix: the matrix of nearest neighbours beside it, and runs with and without assembly."""

import numpy as np
import pytest

import pdpetsc as pd
from pdpetsc.discrete.cloud import distribute
from pdpetsc.discrete.communicator import world
from pdpetsc.petsc.jacobian import choose
from pdpetsc.petsc.two_level import TwoLevel
from pdpetsc.problem.nearest_neighbours import NearAssembler
from tests.commands import results, run, script_on
from tests.scenes import (
    DIMS,
    NOT_AFFINE,
    SCHEMES,
    bodies,
    body,
    bond_bodies,
    bond_body,
    damaged_body,
    dense_tangent,
    displacement,
)

BLOCKS = {1: 5, 2: 13, 3: 25}


def affine(model, rng):
    """Return displacements with a uniform gradient."""
    n = model.cloud.n_owned
    return np.ascontiguousarray(model.cloud.x[:n] @ rng.standard_normal((model.dim, model.dim)))


@pytest.mark.long
def test_nearest_neighbours_have_the_energy_of_the_body_in_every_uniform_deformation(rng):
    """Whatever the scheme, control or bonds, at any displacement: what makes long waves alike."""
    free = [(label, model) for label, model in bond_bodies(rng) if "free" in label]
    for label, model in [*bodies(rng), *free]:
        if any(name.replace("_", " ") in label.replace("_", " ") for name in NOT_AFFINE):
            continue
        u = displacement(model, rng)
        K, near = dense_tangent(model, u), dense_tangent(model, u, NearAssembler(model.problem))
        assert np.abs(near - near.T).max() < 1e-12 * np.abs(near).max(), label
        du = affine(model, rng).ravel()
        assert du @ near @ du == pytest.approx(du @ K @ du, rel=1e-9), label


def test_nearest_neighbours_resist_everything_but_rigid_motion(rng):
    for dim in DIMS:
        for model in (body(dim, rng=rng), bond_body(dim, pd.BondBased(E=10.0), rng=rng)):
            values = np.linalg.eigvalsh(
                dense_tangent(model, np.zeros_like(model.cloud.x), NearAssembler(model.problem))
            )
            rigid = dim * (dim + 1) // 2
            assert np.abs(values[:rigid]).max() < 1e-10 * values[-1]
            assert values[rigid] > 1e-5 * values[-1]


@pytest.mark.parametrize("dim", DIMS)
@pytest.mark.parametrize("horizon", (1.015, 2.015, 3.015))
def test_rows_of_nearest_neighbours_are_as_short_for_any_horizon(dim, horizon):
    model = body(dim, horizon=horizon)
    assert np.diff(NearAssembler(model.problem).pattern.owned.diag_ptr).max() <= BLOCKS[dim]


def test_nearest_neighbours_are_those_of_bonds_that_hold(rng):
    """With a third of the bonds broken the matrix stays definite where particles still have a gradient."""
    law = pd.Brittle(pd.ConstantCritical(1.0))
    for dim in (2, 3):
        model = damaged_body(dim, law, control=pd.Silling(0.5))
        keys = model.failure.of.keys()
        model.failure.phi[(keys[:, 0] * 7 + keys[:, 1] * 13) % 10 < 3] = 0.0
        model.take_failure()
        values = np.linalg.eigvalsh(dense_tangent(model, np.zeros_like(model.cloud.x), NearAssembler(model.problem)))
        rigid = dim * (dim + 1) // 2
        assert np.abs(values[:rigid]).max() < 1e-10 * values[-1]
        assert values[rigid] > 1e-6 * values[-1]


CASES = {
    "beam": ("runs/beams/clamped.py", "ny=3", "horizon=2.015", "scheme=sub_horizons", "steps=2"),
    "silling": ("runs/beams/clamped.py", "ny=3", "horizon=2.015", "G=0.5", "steps=2"),
    "damage": ("runs/fracture/plate_with_hole.py", "steps=4"),
    "plasticity": ("runs/plasticity/beam.py", "ny=6"),
    "cell": ("runs/patch/cell.py",),
}


LONG = ("damage", "plasticity")


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.long if n in LONG else ()) for n in CASES])
def test_results_are_those_of_the_assembled_tangent_on_1_and_2_ranks(name, tmp_path):
    case, *words = CASES[name]
    assembled = results(case, *words, output=tmp_path / "assembled")
    assert "tangent matrix" in assembled["allocated"]
    for ranks in (1, 2):
        free = results(case, *words, "-pd_jacobian", "matfree", ranks=ranks, output=tmp_path / f"free_{ranks}")
        assert "matrix of the background grid" in free["allocated"]
        assert len(free["steps"]) == len(assembled["steps"])
        for key, value in assembled["results"].items():
            assert free["results"][key] == pytest.approx(value, rel=1e-6, abs=1e-7), key


def test_the_choice_follows_size_and_option():
    from pdpetsc.declare.solvers import EventDriven, Newton

    model = body(2, horizon=3.015)
    assert not choose(model.problem, {}, Newton()).matrix_free
    assert choose(model.problem, {"pd_jacobian": "matfree"}, Newton()).matrix_free
    assert choose(model.problem, {"pc_type": "hypre"}, Newton()).matrix_free
    assert not choose(body(2, horizon=1.015).problem, {"pc_type": "hypre"}, Newton()).matrix_free
    assert not choose(model.problem, {"pc_type": "hypre", "pd_jacobian": "assembled"}, Newton()).matrix_free
    with pytest.raises(pd.CaseError, match="assembled, matfree or auto"):
        choose(model.problem, {"pd_jacobian": "dense"}, Newton())
    with pytest.raises(pd.CaseError, match="factors its matrix"):
        choose(model.problem, {"pd_jacobian": "matfree"}, EventDriven())


@pytest.mark.long
def test_any_preconditioner_can_be_made_of_the_nearest_neighbours(tmp_path):
    for options in (
        ["-pc_type", "cholesky"],
        ["-pc_type", "hypre", "-pc_hypre_type", "boomeramg"],
        ["-pc_type", "icc"],
    ):
        case, *words = CASES["silling"]
        found = run(case, *words, "-pd_jacobian", "matfree", *options, output=tmp_path / "out")
        assert found.returncode == 0, (options, found.stderr)
        assert f"pc {options[1]}" in found.stdout


@pytest.mark.parametrize("ranks", [2, pytest.param(3, marks=pytest.mark.long)])
def test_forces_are_the_same_with_the_exchange_behind_the_work(ranks):
    """In parts, with ghosts that arrive in between, or all at once after they have."""
    found = [line.split() for line in script_on(ranks, BEHIND).splitlines() if line.startswith("scheme")]
    assert {name for _, name, _, _ in found} == set(SCHEMES)
    assert all(int(ghosts) > 0 and float(off) < 1e-13 for _, _, ghosts, off in found), found


BEHIND = """
import numpy as np
import pdpetsc as pd
from tests.scenes import SCHEMES, small_points
from pdpetsc.discrete.cloud import distribute
from pdpetsc.discrete.communicator import is_root, largest, total, world
from pdpetsc.discrete.families import find_families
chunk = pd.Lattice((0.0, 0.0), (9.0, 7.0), 1.0).chunk(world().rank, world().size)
cloud = distribute(world(), chunk.x, chunk.volume, chunk.sets, 2.015)
families = find_families(cloud)
n = cloud.n_owned
omega, material_of = np.ones(len(families.neighbours)), np.zeros(n, dtype=np.int32)
material = [pd.Hencky(E=10.0, nu=0.3)]
for name, scheme in SCHEMES.items():
    model = small_points(cloud, families, omega, scheme, material, material_of, pd.Silling(0.5))
    # The same numbers by global id on any rank count.
    du = np.sin(1.0 + 12.9898 * cloud.gid[:n, None] + 78.233 * np.arange(2))
    tangent = model.linearised(np.zeros_like(du))
    behind = np.array(tangent(du))
    local = np.array(model.problem.body.with_ghosts(du))
    f = np.zeros_like(local)
    tangent.forces(local, f, model.families.everyone)
    whole = np.array(model.problem.body.gather(f))
    off = largest(world(), float(np.abs(behind - whole).max())) / largest(world(), float(np.abs(whole).max()))
    ghosts = int(total(world(), cloud.n_ghost))
    if is_root(world()):
        print("scheme", name, ghosts, off)
"""


def test_particles_in_random_order_are_put_near_their_neighbours(rng):
    x = np.stack(np.meshgrid(np.arange(40.0), np.arange(40.0), indexing="ij"), axis=-1).reshape(-1, 2)
    shuffled = x[rng.permutation(len(x))]
    cloud = distribute(world(), shuffled, np.ones(len(x)), {}, 1.5)
    assert np.array_equal(cloud.x, shuffled[cloud.gid])
    assert np.linalg.norm(np.diff(cloud.x, axis=0), axis=1).mean() < 3.0
    assert np.array_equal(distribute(world(), x, np.ones(len(x)), {}, 1.5).gid, np.arange(len(x)))


def test_a_preconditioner_is_rebuilt_when_it_has_cost_as_many_iterations_as_a_rebuild(monkeypatch, tmp_path):
    """The first digits of a load come easily: a stricter tolerance alone is no reason for a rebuild."""
    built, fill = [], TwoLevel.fill
    monkeypatch.setattr(TwoLevel, "fill", lambda self, state: built.append(state.t) or fill(self, state))

    def steps(strain):
        built.clear()
        case = pd.Case(
            particles=pd.LatticeNodes((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), 0.1),
            material=pd.Hencky(E=1000.0, nu=0.3),
            conditions=[pd.Clamp("-z"), pd.Displacement("+z", x=0.0, y=0.0, z=strain)],
            steps=pd.Steps(2),
        )
        run = pd.run(case, tmp_path, options={"pd_jacobian": "matfree"})
        return sum(step["newton_iterations"] for step in run.summary["steps"]), len(built)

    iterations, small = steps(0.01)
    assert iterations >= 4 and small == 1
    assert steps(-0.5)[1] > small
