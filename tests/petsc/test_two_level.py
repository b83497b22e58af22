"""The two-level preconditioner: diagonal blocks, coarse space, and the iterations and answers of whole solves."""

import dataclasses
import json
import os
import subprocess
import sys

import numpy as np
import pytest

import pdpetsc as pd
from pdpetsc.declare.solvers import Newton
from pdpetsc.discrete import background_grid
from pdpetsc.petsc import jacobian
from pdpetsc.problem import background_elements
from pdpetsc.problem.background_elements import BackgroundElements
from tests.commands import ROOT, run
from tests.scenes import (
    DIMS,
    NOT_AFFINE,
    bodies,
    body,
    bond_bodies,
    bond_body,
    damaged_body,
    dense_tangent,
    displacement,
)

FREE = {"pd_jacobian": "matfree"}
DIRECT = {"pd_jacobian": "assembled", "pc_type": "lu"}
# Every linear solve to the same tolerance, so that iterations can be compared.
EXACT = {"snes_rtol": 1e-9, "snes_ksp_ew": "false", "ksp_rtol": 1e-8}
HENCKY = pd.Hencky(E=1.0, nu=0.3)


def nodes_of(grid):
    """Return a dense matrix (n_rows * dim, n_nodes * dim) that interpolates, and that of the nodes."""
    dim, size = grid.problem.dim, len(grid.numbers) * grid.problem.dim
    P = np.array([grid.interpolate(unit.reshape(-1, dim)).ravel() for unit in np.eye(size)]).T
    return P


def coarse_matrix(grid, u):
    """Return the matrix of the nodes at a displacement, dense."""
    tangent = grid.problem.linearised(grid.problem.state(u))
    blocks = tangent.point_blocks()
    row_ptr, columns = grid.rows
    virtual = np.zeros((grid.problem.body.cloud.n_virtual, grid.problem.dim))
    diagonal = np.concatenate([np.einsum("pii->pi", blocks), virtual])
    values = grid.fill(tangent.stiffness(), tangent.blocks, diagonal, 1.0)
    K = np.zeros((len(row_ptr) - 1, grid.n_global * grid.problem.dim))
    K[np.repeat(np.arange(len(K)), np.diff(row_ptr)), columns] = values
    return K


def test_point_blocks_are_those_of_the_tangent(rng):
    """For every scheme, control and material of bonds; blocks of what has no kernel for them come from its rows."""
    for label, model in [*bodies(rng), *[(label, m) for label, m in bond_bodies(rng) if "free" in label]]:
        u = displacement(model, rng)
        K, n, dim = dense_tangent(model, u), model.cloud.n_owned, model.dim
        exact = np.array([K[dim * i : dim * (i + 1), dim * i : dim * (i + 1)] for i in range(n)])
        tangent = model.linearised(u)
        assert np.abs(tangent.point_blocks() - exact).max() < 1e-12 * np.abs(exact).max(), label
        if "corrected" in label:
            for product in tangent.products:
                product.add_point_blocks = lambda blocks: False
            assert np.abs(tangent.point_blocks() - exact).max() < 1e-12 * np.abs(exact).max(), label


def test_restriction_is_the_transpose_of_interpolation(rng):
    cells = [bond_body(dim, pd.BondBased(E=1.0), rng=rng, cell=True) for dim in DIMS]
    for model in [body(dim, rng=rng) for dim in DIMS] + cells:
        grid = BackgroundElements(model.problem)
        P = nodes_of(grid)
        f = rng.standard_normal((model.cloud.n_rows, model.dim))
        assert np.allclose(grid.restrict(f).ravel(), P.T @ f.ravel(), rtol=0.0, atol=1e-13)


def test_nodes_have_the_energy_of_the_body_in_every_uniform_deformation(rng, monkeypatch):
    """Of free bodies, at any displacement; and of periodic cells, whose virtual unknowns are among the nodes."""
    monkeypatch.setattr(background_elements, "WEAK", 0.0)
    for label, model in [*bodies(rng), *bond_bodies(rng)]:
        if any(name.replace("_", " ") in label.replace("_", " ") for name in NOT_AFFINE):
            continue
        n, dim, cloud = model.cloud.n_owned, model.dim, model.cloud
        u = displacement(model, rng)
        grid = BackgroundElements(model.problem)
        H = rng.standard_normal((dim, dim))
        H = H + H.T if cloud.images is not None else H
        where = np.zeros((len(grid.numbers), dim))
        where[: len(grid.own_positions)] = grid.own_positions
        nodal, fine = where @ H.T, np.zeros((cloud.n_rows, dim))
        fine[:n] = cloud.x[:n] @ H.T
        if cloud.images is not None:
            q = np.zeros(cloud.n_virtual * dim)
            for v, ((a, b), size) in enumerate(zip(cloud.images.cell.components, cloud.images.sizes, strict=True)):
                q[v] = H[a, b] * size
            fine[n:], nodal[-cloud.n_virtual :] = q.reshape(-1, dim), q.reshape(-1, dim)
        assert np.allclose(grid.interpolate(nodal), fine, atol=1e-12), label
        K = coarse_matrix(grid, u)
        energy = fine.ravel() @ model.tangent_times(u, fine).ravel()
        assert nodal.ravel() @ K @ nodal.ravel() == pytest.approx(energy, rel=1e-6), label
        assert np.abs(K - K.T).max() < 1e-12 * np.abs(K).max(), label


def test_a_crack_parts_the_nodes(rng):
    """Where broken bonds have cut a body in two, each piece has nodes and rigid motions of its own."""
    model = damaged_body(2, pd.Brittle(pd.ConstantCritical(1.0)), control=pd.Silling(0.5))
    cloud, families = model.cloud, model.families
    whole = BackgroundElements(model.problem)
    left = cloud.x[:, 0] < 2.5
    model.failure.phi[left[families.centres] != left[families.neighbours]] = 0.0
    model.take_failure()
    cut = BackgroundElements(model.problem)
    assert cut.n_global > whole.n_global
    for grid, pieces in ((whole, 1), (cut, 2)):
        values = np.linalg.eigvalsh(coarse_matrix(grid, np.zeros((cloud.n_owned, 2))))
        assert np.abs(values[: 3 * pieces]).max() < 1e-8 * values[-1]
        assert values[3 * pieces] > 1e-3 * values[-1]
    u = np.where(left[: cloud.n_owned, None], [1.0, 0.0], [0.0, -2.0])
    P = nodes_of(cut)
    assert np.abs(P @ np.linalg.lstsq(P, u.ravel(), rcond=None)[0] - u.ravel()).max() < 1e-12


def box(dim, n, m=3.015, material=HENCKY, strain=0.01, unit=1.0, **more):
    """Return a box of particles held at one end and pulled at the other."""
    side = np.array([n] * dim if np.isscalar(n) else n) * unit
    if isinstance(material, pd.Hencky):
        more = {"scheme": pd.Correspondence(), "control": pd.Silling(0.5), **more}
    held = pd.Displacement(pd.region.Slab("x", high=unit), **dict.fromkeys("xyz"[:dim], 0.0))
    pulled = pd.Displacement(pd.region.Slab("x", low=side[0] - unit), x=strain * side[0])
    values = {"particles": pd.Lattice([0.0] * dim, side, unit), "conditions": [held, pulled], **more}
    return pd.Case(horizon=m * unit, material=material, fields=[pd.displacement], options=EXACT, **values)


def solved(case, folder, options):
    """Return the displacements, and linear iterations per linear solve."""
    result = pd.run(case, folder, options=options)
    steps = result.summary["steps"]
    solves = sum(len(step["norms"]) for step in steps)
    return result.field("displacement"), sum(step["linear_iterations"] for step in steps) / solves, result


def both(case, folder, options=()):
    """Return the iterations per solve with the preconditioner, after comparing the answer with the direct solver's."""
    u, iterations, result = solved(case, folder / "free", FREE | dict(options))
    exact, _, _ = solved(case, folder / "direct", DIRECT)
    assert result.summary["allocated"][-1] == "matrix of the background grid"
    assert np.abs(u - exact).max() < 1e-9 * np.abs(exact).max()
    return iterations


SHAKEN = np.stack(np.meshgrid(np.arange(30.0), np.arange(30.0), indexing="ij"), axis=-1).reshape(-1, 2) + 0.5
SHAKEN += np.random.default_rng(3).uniform(-0.2, 0.2, SHAKEN.shape)
QUARTER = {
    "symmetry": [pd.Symmetry("x", at=0.0), pd.Symmetry("y", at=0.0)],
    "conditions": [pd.Displacement(pd.region.Slab("x", low=29.0), x=0.3)],
}
KINDS = {
    "plane": (box(2, 40), 20),
    "solid": (box(3, 8), 22),
    "horizon of two": (box(2, 40, m=2.015), 20),
    "horizon of five": (box(2, 40, m=5.015), 20),
    "sub-horizons": (box(2, 40, scheme=pd.SubHorizons(), control=None), 32),
    "bonds": (box(2, 40, material=pd.BondBased(E=1.0, kinematics="finite")), 22),
    "state-based": (box(2, 40, material=pd.LinearSolid(E=1.0, nu=0.3)), 22),
    "slender": (box(2, (100, 4)), 24),
    "large strain": (box(2, 24, strain=0.3), 24),
    "shaken": (box(2, 30, particles=pd.Arrays(SHAKEN, 1.0)), 24),
    "crack": (box(2, 50, cracks=[pd.Segment((25.0, 0.0), (25.0, 30.0))]), 24),
    "mirrored": (box(2, 40, symmetry=[pd.Symmetry("y", at=0.0)]), 20),
    "quarter": (box(2, 30, **QUARTER), 24),
    "nearly incompressible": (box(2, 30, material=pd.Hencky(E=1.0, nu=0.499)), 90),
    "one line": (box(1, 60), 24),
}


SECOND = ("horizon of two", "horizon of five", "state-based", "slender", "large strain", "mirrored")


@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=[pytest.mark.long] if kind in SECOND else []) for kind in KINDS]
)
def test_iterations_are_few_and_the_answer_that_of_the_direct_solver(kind, tmp_path):
    case, most = KINDS[kind]
    assert both(case, tmp_path) <= most


def test_a_line_of_bonds_in_the_plane_is_solved(tmp_path):
    """Nothing but the supports resists motion across it."""
    everything = pd.region.Slab("x", low=-1.0)
    held = pd.Displacement(pd.region.Slab("x", high=1.0), x=0.0)
    pulled = pd.Displacement(pd.region.Slab("x", low=59.0), x=0.1)
    conditions = [held, pulled, pd.Displacement(everything, y=0.0)]
    assert both(box(2, (60, 1), material=pd.BondBased(E=1.0), conditions=conditions), tmp_path) <= 24


def test_bodies_apart_are_solved_together(tmp_path):
    """Two in neighbouring cells of the grid, too far apart for bonds, pulled in opposite directions."""
    one = np.stack(np.meshgrid(np.arange(20.0), np.arange(20.0), indexing="ij"), axis=-1).reshape(-1, 2)
    x = np.concatenate([one, one + np.array([0.0, 23.5])])
    below, above = pd.region.Slab("y", high=20.0), pd.region.Slab("y", low=20.0)
    left, right = pd.region.Slab("x", high=0.5), pd.region.Slab("x", low=18.5)
    conditions = [
        pd.Displacement(left, x=0.0, y=0.0),
        pd.Displacement(right & below, x=0.2),
        pd.Displacement(right & above, x=-0.2, y=0.1),
    ]
    assert both(box(2, 20, particles=pd.Arrays(x, 1.0), conditions=conditions), tmp_path) <= 22


def test_a_periodic_cell_under_mean_stress_is_solved(tmp_path):
    corner = pd.region.Nearest((0.5, 0.5))
    conditions = [pd.Displacement(corner, x=0.0, y=0.0), pd.MeanStress(xx=0.02, xy=0.01)]
    stiff = pd.region.Box((2.0, 2.0), (6.0, 6.0))
    materials = [(stiff, pd.Hencky(E=10.0, nu=0.3)), (~stiff, HENCKY)]
    case = box(2, 16, cell=pd.Cell((0.0, 0.0), (16.0, 16.0)), conditions=conditions)
    case = dataclasses.replace(case, material=materials)
    assert both(case, tmp_path) <= 26


def test_iterations_do_not_depend_on_units(tmp_path):
    counts = {unit: solved(box(2, 24, unit=unit), tmp_path / str(unit), FREE)[1] for unit in (1e-9, 1.0, 1e9)}
    assert len(set(counts.values())) == 1


@pytest.mark.long
def test_iterations_hardly_grow_with_the_body(tmp_path):
    small, large = (solved(box(2, n), tmp_path / str(n), FREE)[1] for n in (20, 80))
    assert large <= 1.2 * small


def softening(ratio):
    """Return what a box needs whose bonds soften up to ``ratio`` times their critical elongation."""
    return {"material": pd.BondBased(E=1.0), "damage": pd.LinearSoftening(pd.ConstantCritical(0.01), ratio)}


def failing(Gc):
    """Return what a box needs whose gradient points fail with a fracture energy."""
    damage = pd.PointDamage(pd.softening.Linear(), Gc=Gc, onset=0.01)
    elastic = pd.LinearElastic(E=1.0, nu=0.25)
    return {"material": elastic, "scheme": pd.Correspondence(), "control": pd.Silling(0.5), "damage": damage}


def torn(folder, options, **more):
    """Return the forces of a notched strip that softens and tears, in five long steps."""
    crack = pd.Segment((5.0, 0.0), (5.0, 2.0))
    case = box(2, (10, 6), m=2.015, strain=0.05 * 5.0 / 6.0, cracks=[crack], steps=pd.Steps(5), **more)
    case = dataclasses.replace(case, history={"force": pd.Reaction("x", pd.region.Slab("x", low=9.0))})
    return pd.run(case, folder, options=options).history["force"]


@pytest.mark.long
@pytest.mark.parametrize(
    ("declared", "carries", "other"),
    [
        (softening(3.0), 1.0 / 50.0, DIRECT),
        (softening(3.0), 1.0 / 50.0, {}),
        (softening(8.0), 1.0 / 8.0, {}),
        (failing(0.0008), 1e-4, {}),
        (failing(0.002), 1.0 / 8.0, {}),
    ],
)
def test_damage_while_running_gives_the_results_of_the_assembled_tangent(declared, carries, other, tmp_path):
    """Long steps jump over unstable states: Newton's method alone finds minima beyond them, other ones by solver.

    With LU, nothing tells that states are unstable.
    """
    free, assembled = (torn(tmp_path / name, options, **declared) for name, options in (("a", FREE), ("b", other)))
    assert np.abs(free[-1]) < carries * np.abs(free).max()
    assert free == pytest.approx(assembled, abs=1e-6 * np.abs(assembled).max())


def test_a_plate_on_point_supports_is_solved_without_a_matrix(tmp_path):
    """The preconditioner does not know these supports, and the residual in its norm grows 1e5 times before it falls."""
    n, end, (s_xx, s_xy, s_yy) = 240, 5.0, (-6.7e-5, -2.5e-4, -9.33e-4)
    left = pd.region.Box((-end, -1.5), (-4.0, 1.5))
    right = pd.region.Box((4.0, -1.5), (end, 1.5))
    case = pd.Case(
        particles=pd.Lattice((-end, -end), (end, end), 2.0 * end / n),
        horizon=2.015 * 2.0 * end / n,
        material=pd.LinearElastic(E=1.0, nu=0.0),
        scheme=pd.Correspondence(),
        control=pd.Silling(2.0),
        conditions=[
            *(pd.Traction(f"{sign}x", x=factor * s_xx, y=factor * s_xy) for sign, factor in (("-", -1), ("+", 1))),
            *(pd.Traction(f"{sign}y", x=factor * s_xy, y=factor * s_yy) for sign, factor in (("-", -1), ("+", 1))),
            pd.PointSupport(left, x=0.0, y=0.0),
            pd.PointSupport(right, y=0.0),
        ],
        steps=pd.Steps(2),
        history={"work": pd.ExternalWork()},
        fields=[],
    )
    work = pd.run(case, tmp_path, options=FREE).history["work"][-1]
    uniform = 0.5 * (2.0 * end) ** 2 * (s_xx**2 + s_yy**2 + 2.0 * s_xy**2)
    assert work == pytest.approx(uniform, rel=0.01)


OPTIONS = (
    {"pc_mg_type": "multiplicative"},
    {"pc_mg_type": "multiplicative", "mg_levels_ksp_max_it": 4},
    {"mg_coarse_pc_type": "gamg", "mg_coarse_ksp_type": "chebyshev"},
    {"mg_coarse_pc_type": "svd"},
    {"mg_levels_pc_type": "jacobi"},
)


@pytest.mark.parametrize("options", OPTIONS, ids=lambda o: " ".join(map(str, o.values())))
def test_both_levels_follow_options(options, tmp_path):
    assert both(box(2, 24), tmp_path, options) <= 24


@pytest.mark.long
def test_cycles_of_several_steps_take_under_sixty_iterations_where_nearly_incompressible(tmp_path):
    cycles = {
        "pc_mg_type": "multiplicative",
        "mg_levels_ksp_max_it": 4,
        "mg_levels_ksp_chebyshev_esteig": "0,0.05,0,1.1",
    }
    for n, dim in ((40, 2), (9, 3)):
        case = box(dim, n, material=pd.Hencky(E=1.0, nu=0.499))
        assert solved(case, tmp_path / str(dim), FREE | cycles)[1] <= 60


@pytest.mark.long
def test_the_command_line_tunes_both_levels_and_refuses_what_is_wrong(tmp_path):
    words = "dim=2", "n=16", "-pd_jacobian", "matfree"
    tuned = run(
        "runs/bench/box.py", *words, "-mg_coarse_pc_type", "lu", "-mg_coarse_pc_factor_mat_solver_type", "petsc",
        "-ksp_view", output=tmp_path / "a",
    )  # fmt: skip
    assert tuned.returncode == 0, tuned.stderr
    assert "type is ADDITIVE" in tuned.stdout and "No solver used the option -mg" not in tuned.stdout + tuned.stderr
    wrong = run("runs/bench/box.py", *words, "-mg_coarse_pc_type", "nonsense", output=tmp_path / "b", ranks=2)
    assert wrong.returncode == 2 and "PETSc refused the solver options" in wrong.stderr


def test_what_is_chosen_follows_size_damage_and_control_and_is_said(monkeypatch):
    monkeypatch.setattr(jacobian, "DIRECT_UNKNOWNS", {2: 10})
    law = pd.Brittle(pd.ConstantCritical(1.0))
    held, loose = (body(2, control=control, horizon=3.015).problem for control in (pd.Silling(0.5), None))
    chosen = jacobian.choose(held, {}, Newton())
    assert chosen.matrix_free and chosen.levels == "additive" and "60 unknowns are more than 10" in chosen.why
    assert "background grid" in jacobian.words(chosen, 0) and "more than" in chosen.why
    assert not jacobian.choose(held, {}, Newton(), pivots=True).direct
    monkeypatch.setattr(jacobian, "HARD_UNKNOWNS", {2: 10})
    softens = damaged_body(2, law, control=pd.Silling(0.5)).problem
    assert jacobian.choose(softens, {}, Newton(), pivots=True).direct
    assert not jacobian.choose(softens, {}, Newton()).direct
    monkeypatch.setattr(jacobian, "HARD_UNKNOWNS", {2: 1000})
    assert jacobian.choose(loose, {}, Newton()).direct
    assert jacobian.choose(damaged_body(2, law, control=pd.Silling(0.5)).problem, {}, Newton()).direct
    near = jacobian.choose(held, {"pc_type": "gamg"}, Newton())
    assert near.matrix_free and not near.levels and "nearest neighbours" in jacobian.words(near, 0)


def test_another_number_of_levels_is_refused(tmp_path):
    with pytest.raises(pd.CaseError, match="has 2 levels, not the 3 of"):
        pd.run(box(2, 10), tmp_path, options=FREE | {"pc_mg_levels": 3})


def test_bodies_far_apart_have_a_grid(monkeypatch):
    """So far that there would be more nodes between them than integers, of which there are few here."""
    monkeypatch.setattr(background_grid, "MOST", 1e6)
    one = np.stack(np.meshgrid(*[np.arange(4.0)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    x = np.concatenate([one, one + 1e4])
    ends = pd.region.Slab("x", high=0.5) | pd.region.Slab("x", low=1e4 - 0.5, high=1e4 + 0.5)
    held = [pd.Displacement(ends, x=0.0, y=0.0, z=0.0)]
    case = box(3, 4, m=2.015, particles=pd.Arrays(x, 1.0), material=pd.BondBased(E=1.0), conditions=held)
    problem = pd.prepare(case).problem
    grid = BackgroundElements(problem)
    assert np.prod(grid.cells.count + 1.0) <= background_grid.MOST
    moved = grid.interpolate(np.ones((len(grid.numbers), 3)))
    assert np.allclose(moved, ~problem.supports.fixed)


RANKS = """
import json, sys
import numpy as np
import pdpetsc as pd
from mpi4py import MPI
from tests.petsc.test_two_level import FREE, box, solved
from pathlib import Path
folder = Path(sys.argv[1])
cases = {
    "crack": box(2, 20, cracks=[pd.Segment((10.0, 0.0), (10.0, 12.0))]),
    "cell": box(2, 12, cell=pd.Cell((0.0, 0.0), (12.0, 12.0)), conditions=[
        pd.Displacement(pd.region.Nearest((0.5, 0.5)), x=0.0, y=0.0), pd.MeanStress(xx=0.02)]),
    "mirrored": box(2, 14, symmetry=[pd.Symmetry("y", at=0.0)]),
    "solid": box(3, 6),
}
for name, case in cases.items():
    u, iterations, _ = solved(case, folder / f"{name}_{MPI.COMM_WORLD.size}", FREE)
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps([name, iterations, u.tolist()]), flush=True)
"""


@pytest.mark.long
def test_any_number_of_ranks_gives_the_same(tmp_path):
    """Cells, pieces and nodes that ranks share are the same as on one."""
    script = tmp_path / "ranks.py"
    script.write_text(RANKS)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    found = {}
    for ranks in (1, 3):
        words = [str(ROOT / ".ci" / "mpirun"), str(ranks), sys.executable, str(script), str(tmp_path)]
        done = subprocess.run(
            words, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=300, check=False
        )
        assert done.returncode == 0, done.stderr
        lines = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("[")]
        assert len(lines) == 4
        for name, iterations, u in lines:
            found.setdefault(name, []).append((iterations, np.array(u)))
    for name, results in found.items():
        one = results[0]
        for iterations, u in results[1:]:
            assert abs(iterations - one[0]) <= 1.0, name
            assert np.abs(u - one[1]).max() < 1e-9 * np.abs(one[1]).max(), name
