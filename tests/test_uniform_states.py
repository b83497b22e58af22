"""Uniform states at finite strain with conforming weights: tractions on the whole surface and nothing held in layers.

The tractions are ``P N`` with the closed form of ``P`` at the wanted gradient ``F``. As many corners as there are
directions have the displacements of ``F``, which takes the rigid motions away, and no force.
"""

import itertools

import meshio
import numpy as np
import pytest
from scipy.spatial import cKDTree

import pdpetsc as pd
from tests.commands import ROOT, results
from tests.test_conforming import square_mesh
from tests.test_symmetry import assert_the_part_is_the_whole

E, NU = 1000.0, 0.3
LONG = pytest.mark.long
MOTIONS = {
    "tension": np.array([[0.1, 0.0, 0.0], [0.0, -0.03, 0.0], [0.0, 0.0, -0.02]]),
    "shear": np.array([[0.0, 0.06, 0.02], [0.0, 0.0, 0.04], [0.0, 0.0, 0.0]]),
    "hydrostatic": -0.04 * np.eye(3),
    "turned": np.array([[0.02, -0.1, 0.04], [0.12, 0.05, -0.06], [-0.03, 0.07, -0.04]]),
}


def stress(F):
    """Return P (dim, dim) of Hencky's law, ``(lambda tr(h) I + 2 mu h) F^-T`` with ``h = log(F F^T) / 2``."""
    dim = len(F)
    lam, mu = (0.0, 0.5 * E) if dim == 1 else (E * NU / ((1.0 + NU) * (1.0 - 2.0 * NU)), 0.5 * E / (1.0 + NU))
    squares, axes = np.linalg.eigh(F @ F.T)
    h = axes @ np.diag(0.5 * np.log(squares)) @ axes.T
    return (lam * np.trace(h) * np.eye(dim) + 2.0 * mu * h) @ np.linalg.inv(F).T


def tetrahedra(n, move):
    """Return nodes and tetrahedra of n x n x n cubes, six to a cube, whose nodes a function has moved."""
    side = np.arange(n + 1)
    points = np.stack(np.meshgrid(side, side, side, indexing="ij"), axis=-1).reshape(-1, 3) / n
    low = np.stack(np.meshgrid(side[:-1], side[:-1], side[:-1], indexing="ij"), axis=-1).reshape(-1, 3)
    weights = np.array([(n + 1) ** 2, n + 1, 1])
    cells = []
    for order in itertools.permutations(range(3)):
        corners = [low]
        for axis in order:
            corners.append(corners[-1] + np.eye(3, dtype=int)[axis])
        cells.append(np.stack([corner @ weights for corner in corners], axis=1))
    return move(points), np.concatenate(cells)


def graded(points):
    """Return points of the unit cube or of a plate, drawn towards the origin: spacings differ by a factor of three."""
    return points * (0.5 + 0.5 * points / points.max(axis=0))


def moved(points, n, share=0.2):
    """Return points of the unit cube of which the inner ones are moved by up to a share of the spacing."""
    inner = ((points > 1e-9) & (points < 1.0 - 1e-9)).all(axis=1)
    shift = np.random.default_rng(5).uniform(-share / n, share / n, points.shape)
    return points + np.where(inner[:, None], shift, 0.0)


def body(kind, dim, tmp_path, n):
    """Return particles of the unit cube, square or line, 2 x 1 where they are triangles, and their spacing."""
    if kind in ("lattice", "shaken"):
        lattice = pd.Lattice([0.0] * dim, [1.0] * dim, 1.0 / n)
        if kind == "lattice":
            return lattice, 1.0 / n
        x = lattice.chunk(0, 1).x
        shift = np.random.default_rng(3).uniform(-0.3 / n, 0.3 / n, x.shape)
        return pd.Arrays(x + shift, n**-dim, facets=lattice.surface()), 1.0 / n
    at = pd.MeshNodes if kind.startswith("nodes") else pd.Mesh
    is_graded = kind.endswith("graded")
    if dim == 2:
        points, cells, _ = square_mesh(n)
        points, name = graded(points) if is_graded else points, "triangle"
    else:
        points, cells = tetrahedra(n, graded if is_graded else lambda points: moved(points, n))
        name = "tetra"
    path = tmp_path / "body.xdmf"
    meshio.Mesh(points, [(name, cells)]).write(path)
    particles = at(path)
    # That of the largest cells: dual cells of nodes on the boundary are cut.
    return particles, float(particles.chunk(0, 1).volume.max() ** (1.0 / dim))


def case(particles, horizon, scheme, motion, planes=()):
    """Return a body under the tractions of the gradient ``I + t H``, and of nothing else."""
    x = particles.chunk(0, 1).x
    dim = x.shape[1]
    H, facets = MOTIONS[motion][:dim, :dim], particles.surface(0, 1).arrays[0]

    def traction(i, axis, sign):
        return lambda x, t: np.full(len(x), sign * stress(np.eye(dim) + t * H)[i, axis])

    conditions = []
    for axis in range(dim):
        low, high = facets[:, axis].min(), facets[:, axis].max()
        for sign, region in ((-1.0, {"high": low + 1e-9}), (1.0, {"low": high - 1e-9})):
            if sign > 0.0 or "xyz"[axis] not in planes:
                across = {name: traction(i, axis, sign) for i, name in enumerate("xyz"[:dim])}
                conditions.append(pd.Traction(pd.region.Slab("xyz"[axis], **region), **across))

    def along(i):
        return lambda x, t: t * x @ H[i]

    ends = [x.min(axis=0)] + [np.where(np.arange(dim) == axis, x.max(axis=0), x.min(axis=0)) for axis in range(dim - 1)]
    for end in ends:
        place = x[cKDTree(x).query(end)[1]]
        conditions.append(pd.Displacement(pd.region.Nearest(place), **{"xyz"[i]: along(i) for i in range(dim)}))
    plain = scheme in ("correspondence", "corrected", "higher_order")
    return pd.Case(
        particles=particles,
        horizon=horizon,
        material=pd.Hencky(E=E, nu=NU),
        scheme=pd.SCHEMES[scheme],
        weights=pd.Conforming(),
        control=pd.Silling(0.5) if plain else None,
        conditions=conditions,
        symmetry=[pd.Symmetry(axis) for axis in planes],
        history={"error": pd.LargestError(pd.deformation_gradient, lambda x, t: np.eye(dim) + t * H)},
        results=lambda h: {"error": h["error"][-1]},
        options={"snes_rtol": 1e-12},
    )


def error(tmp_path, kind, dim, scheme, motion, horizon, n, planes=()):
    particles, spacing = body(kind, dim, tmp_path, n)
    return pd.run(case(particles, horizon * spacing, scheme, motion, planes), tmp_path / "out")["error"]


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize(("kind", "dim"), [("lattice", 3), ("shaken", 2), ("shaken", 3)])
def test_any_uniform_state_is_exact(kind, dim, motion, tmp_path):
    assert error(tmp_path, kind, dim, "sub_horizons", motion, 2.015, 4 if dim == 3 else 8) < 1e-8


@pytest.mark.parametrize("scheme", ["correspondence", "sub_horizons"])
@pytest.mark.parametrize("kind", ["mesh", "mesh graded", "nodes", "nodes graded"])
@pytest.mark.parametrize("dim", [2, 3])
def test_any_uniform_state_is_exact_on_meshes(kind, dim, scheme, tmp_path):
    assert error(tmp_path, kind, dim, scheme, "turned", 2.2, 3 if dim == 3 else 6) < 1e-8


@pytest.mark.parametrize("motion", ["tension", "hydrostatic"])
@pytest.mark.parametrize(("kind", "dim"), [("shaken", 1), ("mesh", 2), ("mesh", 3)])
def test_any_uniform_state_is_exact_beside_mirror_planes(kind, dim, motion, tmp_path):
    planes = "xyz"[:dim]
    assert error(tmp_path, kind, dim, "sub_horizons", motion, 2.7, 3 if dim == 3 else 6, planes) < 1e-8


def out_of_balance(tmp_path, kind, dim, scheme, motion, horizon, n):
    """Return the largest force that the uniform state leaves on a particle, supported or not, over the tractions'."""
    particles, spacing = body(kind, dim, tmp_path, n)
    prepared = pd.prepare(case(particles, horizon * spacing, scheme, motion))
    problem, x = prepared.problem, prepared.cloud.x[: prepared.cloud.n_owned]
    state = problem.state(x @ MOTIONS[motion][:dim, :dim].T, 1.0)
    applied = problem.external_force(state)
    return np.abs(problem.internal_force(state) - applied).max() / np.abs(applied).max()


@LONG
@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("kind", ["lattice", "shaken", "mesh", "nodes", "mesh graded", "nodes graded"])
@pytest.mark.parametrize("scheme", pd.SCHEMES)
def test_every_uniform_state_balances_with_every_scheme_and_horizon(scheme, kind, motion, tmp_path):
    """Or the horizon is refused in a sentence, the small ones alone."""
    for dim in (1, 2, 3) if kind in ("lattice", "shaken") and motion != "shear" else (2, 3):
        for horizon in (1.015, 1.515, 2.015, 2.515, 3.015):
            try:
                found = out_of_balance(tmp_path, kind, dim, scheme, motion, horizon, {1: 20, 2: 8, 3: 4}[dim])
            except pd.CaseError as refused:
                assert horizon < 2.5, refused
                assert "widen the horizon" in str(refused)
            else:
                assert found < 1e-8, (dim, horizon)


def quarter_of_a_mesh(tmp_path, n=5):
    """Write an irregular mesh of the square from 0 to 1 and of the square from -1 to 1 that its mirror images make."""
    points, cells, _ = square_mesh(n, seed=3)
    points = points * np.array([0.5, 1.0])
    meshio.Mesh(points, [("triangle", cells)]).write(tmp_path / "quarter.xdmf")
    copies = [points * np.array(signs) for signs in itertools.product((1.0, -1.0), (1.0, -1.0))]
    every, number = np.unique(np.round(np.concatenate(copies), 13), axis=0, return_inverse=True)
    nodes = np.concatenate([np.ravel(number)[cells + k * len(points)] for k in range(4)])
    meshio.Mesh(every, [("triangle", nodes)]).write(tmp_path / "whole.xdmf")


def pulled(path, pull, damage):
    """Return a meshed body pulled at both ends by a traction that varies along them, with damage by displacements."""
    whole = path.stem == "whole"
    ends = [pd.region.Slab("y", low=1.0 - 1e-9)] + ([pd.region.Slab("y", high=-1.0 + 1e-9)] if whole else [])
    conditions = []
    for sign, end in zip((1.0, -1.0), ends, strict=False):
        layer = pd.region.Slab("y", low=0.8) if sign > 0.0 else pd.region.Slab("y", high=-0.8)
        if damage is None:
            conditions.append(pd.Traction(end, y=lambda x, t, sign=sign: 30.0 * sign * t * np.cos(x[:, 0])))
        else:
            conditions.append(pd.Displacement(layer, x=0.0, y=sign * pull))
    if damage is None:  # a particle of each quarter, so that what holds it has the symmetry
        x = pd.Mesh(path).chunk(0, 1).x
        near = np.unique(cKDTree(x).query([[a, b] for a in (0.5, -0.5) for b in (0.5, -0.5)])[1] if whole else
                         [cKDTree(x).query([0.5, 0.5])[1]])  # fmt: skip
        conditions += [pd.Displacement(pd.region.Nearest(x[k]), x=0.0, y=0.0) for k in near]
    return pd.Case(
        particles=pd.Mesh(path),
        horizon=0.34,
        material=pd.NeoHookean(E=E, nu=NU),
        weights=pd.Conforming(),
        conditions=conditions,
        damage=damage,
        symmetry=[] if whole else [pd.Symmetry("x"), pd.Symmetry("y")],
        steps=pd.Steps(1 if damage is None else 2),
        history={"energy": pd.StrainEnergy(), "up": pd.Mean(pd.displacement, "y", pd.region.Slab("y", low=0.5))},
        results=lambda h: {name: h[name][-1] for name in ("energy", "up")},
    )


DAMAGE = pd.LinearSoftening(
    pd.ConstantCritical(0.012), 3.0, protected=pd.region.Slab("y", low=0.6) | pd.region.Slab("y", high=-0.6)
)


def same(tmp_path, n, pull, damage, tolerance):
    quarter_of_a_mesh(tmp_path, n)
    part, whole = (pulled(tmp_path / f"{name}.xdmf", pull, damage) for name in ("quarter", "whole"))
    return assert_the_part_is_the_whole(part, whole, tolerance=tolerance)


def test_a_quarter_of_a_mesh_is_the_whole(tmp_path):
    same(tmp_path, 5, 0.0, None, 1e-10)


def test_a_quarter_of_a_mesh_is_damaged_as_the_whole(tmp_path):
    assert same(tmp_path, 4, 0.009, DAMAGE, 1e-8)["local_damage"].max() > 0.01


@LONG
def test_a_quarter_of_a_mesh_breaks_as_the_whole(tmp_path):
    assert same(tmp_path, 5, 0.012, DAMAGE, 1e-8)["broken"].max() > 100


def test_a_quarter_of_a_mesh_is_the_same_on_two_ranks(tmp_path):
    quarter_of_a_mesh(tmp_path, 4)
    script = tmp_path / "quarter.py"
    script.write_text(
        "import sys\n"
        f"sys.path.insert(0, {str(ROOT)!r})\n"
        "from pathlib import Path\n"
        "from tests.test_uniform_states import DAMAGE, pulled\n\n\n"
        "def case(path='', pull=0.009):\n"
        "    return pulled(Path(path), pull, DAMAGE)\n"
    )
    one, two = (
        results(script, f"path={tmp_path / name}.xdmf", ranks=ranks, output=tmp_path / name)["results"]
        for name, ranks in (("whole", 1), ("quarter", 2))
    )
    assert 4.0 * two["energy"] == pytest.approx(one["energy"], rel=1e-8)
    assert two["up"] == pytest.approx(one["up"], rel=1e-8)
