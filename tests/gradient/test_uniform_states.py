"""Uniform states at finite strain with conforming weights: tractions on the whole surface and nothing held in layers.

The tractions are ``P N`` with the closed form of ``P`` at the wanted gradient ``F``. As many corners as there are
directions have the displacements of ``F``, which takes the rigid motions away, and no force.
"""

import dataclasses
import itertools

import meshio
import numpy as np
import pytest
from scipy.spatial import cKDTree

import pdpetsc as pd
from pdpetsc.declare.cells import Block, volumes_and_moments
from tests.commands import ROOT, results
from tests.discrete.test_symmetry import assert_the_part_is_the_whole
from tests.gradient.test_conforming import square_mesh

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


# Corners of the unit cube in the order of a hexahedron, and what else it falls into.
CUBE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]])
CELLS = {
    "hexahedron": [list(range(8))],
    "wedge": [[0, 1, 2, 4, 5, 6], [0, 2, 3, 4, 6, 7]],
    # To a node in the middle.
    "pyramid": [[0, 1, 2, 3, 8], [4, 7, 6, 5, 8], [0, 4, 5, 1, 8], [1, 5, 6, 2, 8], [2, 6, 7, 3, 8], [3, 7, 4, 0, 8]],
}


def bricks(kind, n, share, surface):
    """Return n^3 cubes, or what they fall into, whose nodes are moved by up to a share of a side, outer ones too."""
    side = np.arange(n + 1)
    points = np.stack(np.meshgrid(side, side, side, indexing="ij"), axis=-1).reshape(-1, 3) / n
    low = np.stack(np.meshgrid(side[:-1], side[:-1], side[:-1], indexing="ij"), axis=-1).reshape(-1, 3)
    corner = (low[:, None] + CUBE) @ np.array([(n + 1) ** 2, n + 1, 1])
    shift = np.random.default_rng(8).uniform(-share / n, share / n, points.shape)
    inner = ((points > 1e-9) & (points < 1.0 - 1e-9)).all(axis=1)
    points = points + np.where(inner[:, None] | surface, shift, 0.0)
    if kind == "pyramid":
        corner = np.concatenate([corner, len(points) + np.arange(len(corner))[:, None]], axis=1)
        points = np.concatenate([points, points[corner[:, :8]].mean(axis=1)])
    return points, np.concatenate([corner[:, cell] for cell in CELLS[kind]])


def test_the_volume_and_the_centroid_of_a_warped_hexahedron():
    """Against the integral of the determinant of the trilinear map with 4 x 4 x 4 points."""
    points, cells = bricks("hexahedron", 2, 0.3, True)
    volume, moment = volumes_and_moments(points, Block("hexahedron", cells))
    g, w = np.polynomial.legendre.leggauss(4)
    for cell, V, S in zip(points[cells], volume, moment, strict=True):
        found, first = 0.0, np.zeros(3)
        for (a, p), (b, q), (c, r) in itertools.product(zip(g, w, strict=True), repeat=3):
            signs = 2.0 * CUBE - 1.0
            one = 1.0 + signs * [a, b, c]
            J = np.stack([0.125 * signs[:, k] * np.delete(one, k, axis=1).prod(axis=1) @ cell for k in range(3)])
            weight = p * q * r * np.linalg.det(J)
            found, first = found + weight, first + weight * (0.125 * one.prod(axis=1) @ cell)
        assert pytest.approx(found, rel=1e-13) == V
        np.testing.assert_allclose(S, first, rtol=1e-12)


@pytest.mark.parametrize("at", [pd.Mesh, pd.MeshNodes])
@pytest.mark.parametrize("kind", CELLS)
def test_cells_with_warped_faces_fill_the_body_and_conform(kind, at, tmp_path):
    """Faces inside warped, and those of the surface too: a pressure all around gives the uniform state."""
    path = tmp_path / "bricks.vtk"
    for surface in (False, True):
        points, cells = bricks(kind, 4, 0.2, surface)
        meshio.Mesh(points, [(kind, cells)]).write(path)
        particles = at(path)
        volume = particles.chunk(0, 1).volume
        x, area, _, _ = particles.surface(0, 1).arrays
        assert volume.min() > 0.0
        if not surface:
            assert volume.sum() == pytest.approx(1.0, rel=1e-13)
        np.testing.assert_allclose(area.sum(axis=0), 0.0, atol=1e-14)
        np.testing.assert_allclose(x.T @ area, volume.sum() * np.eye(3), atol=1e-13)
        whole = case(particles, 2.6 * float(volume.max()) ** (1.0 / 3.0), "sub_horizons", "hydrostatic")
        pressure = pd.Pressure(pd.region.All(), lambda x, t: np.full(len(x), -stress(0.96 * np.eye(3))[0, 0]))
        held = [one for one in whole.conditions if isinstance(one, pd.Displacement)]
        squeezed = dataclasses.replace(whole, conditions=[*held, pressure])
        assert pd.run(squeezed, tmp_path / "out")["error"] < 1e-8


KINDS = ["lattice", "shaken", "mesh", "nodes", "mesh graded", "nodes graded"]


# Every motion with the clouds that have least order, half of them with each of the others.
@LONG
@pytest.mark.parametrize(("kind", "motion"), [
    (kind, motion)
    for n, kind in enumerate(KINDS)
    for m, motion in enumerate(MOTIONS)
    if kind in ("shaken", "nodes graded") or (n + m) % 2
])  # fmt: skip
@pytest.mark.parametrize("scheme", pd.SCHEMES)
def test_every_uniform_state_balances_with_every_scheme_and_horizon(scheme, kind, motion, tmp_path):
    """Or the horizon is refused in a sentence, the small ones alone."""
    for dim in (1, 2, 3) if kind in ("lattice", "shaken") and motion != "shear" else (2, 3):
        # A cube of a mesh has six cells, and a family many of them.
        n = 3 if dim == 3 and kind.startswith("mesh") else {1: 20, 2: 8, 3: 4}[dim]
        for horizon in (1.015, 1.515, 2.015, 2.515, 3.015):
            try:
                found = out_of_balance(tmp_path, kind, dim, scheme, motion, horizon, n)
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
    # Pulled by more the whole needs a shorter step than the quarter, by round-off.
    assert same(tmp_path, 5, 0.011, DAMAGE, 1e-8)["broken"].max() > 100


def test_a_quarter_of_a_mesh_is_the_same_on_two_ranks(tmp_path):
    quarter_of_a_mesh(tmp_path, 4)
    script = tmp_path / "quarter.py"
    script.write_text(
        "import sys\n"
        f"sys.path.insert(0, {str(ROOT)!r})\n"
        "from pathlib import Path\n"
        "from tests.gradient.test_uniform_states import DAMAGE, pulled\n\n\n"
        "def case(path='', pull=0.009):\n"
        "    return pulled(Path(path), pull, DAMAGE)\n"
    )
    one, two = (
        results(script, f"path={tmp_path / name}.xdmf", ranks=ranks, output=tmp_path / name)["results"]
        for name, ranks in (("whole", 1), ("quarter", 2))
    )
    assert 4.0 * two["energy"] == pytest.approx(one["energy"], rel=1e-8)
    assert two["up"] == pytest.approx(one["up"], rel=1e-8)
