"""Facets of a cloud without cells, on its outer layer of particles."""

from __future__ import annotations

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, Mask, entries_of, row_of_entries, starts_of
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.communicator import largest, total
from pdpetsc.discrete.families import Families
from pdpetsc.discrete.surface import Surface, interpolation
from pdpetsc.errors import CaseError
from pdpetsc.kernels.outer_layer import bare, cut_planes, emptiest, highest
from pdpetsc.kernels.sparsity import sum_by

# A particle is outer if the cosine of all bonds with some direction is below this: a cone of 57 degrees is empty. In a
# triangular lattice there are cones of 60 degrees, in a cubic one of 55.
EMPTY = 0.55
# Directions to begin with in 3D, in 2D; cosine of the cone about them, and steps of their improvement.
DIRECTIONS, NARROW = {2: 32, 3: 200}, 0.72
TURNS = 0.3 * 0.8 ** np.arange(30)
# Plane of the outer particles around one. Distance of these particles; how far they are off the plane; places where
# half of the weight is lost. All in sizes of the particle.
NEAR, OFF, LOOSE = 2.5, 0.5, 0.25
# Smallest second moment of a plane along its axes, in squared sizes.
WIDE = 0.1
# An edge has the planes of the particles within this distance that it is nearer to than that, in its sizes.
BESIDE, ON_PLANE = 2.0, 0.4
# Normals of a particle differ by a cosine below this.
OTHER_SIDE = 0.75
# Most normals of a particle.
MOST = 8
# A cone is bare if the cosine of its axis with all normals is below this.
BARE = 0.5
# Parts of vectors below this share are nothing.
FLAT = 0.1
# Half width of a facet without particles next to it, in sizes.
HALF = 1.0
# Points further than this, in sizes, do not cut a facet.
REACH = 3.0
# Smallest facet, in areas of the side of a cubic particle.
LEAST = 1e-6
# Share of its volume that an outer layer encloses at least; directions in which areas are changed, in squares.
ENCLOSED, SMALL = 0.6, 1e-2
# Number of improvements of a plane; facets that are cut at once.
STEPS, AT_ONCE = 5, 10000


def outer_layer(cloud: Cloud, families: Families, thickness: float) -> Surface:
    """Build the surface of a cloud from the bonds and volumes of its outer particles.

    Notes
    -----
    Collective.
    """
    n, dim = cloud.n_owned, cloud.dim
    size = (cloud.volume / (thickness if dim < 3 else 1.0)) ** (1.0 / dim)
    rows, normal, level = _normals(cloud, families, size)
    x, area = _cut(cloud, families, size, rows, normal, level)
    kept = area > LEAST * size[rows] ** (dim - 1)
    rows, normal, x, area = rows[kept], normal[kept], x[kept], area[kept]
    x += cloud.x[rows]
    vectors = (area * (thickness if dim == 2 else 1.0))[:, None] * normal
    number = np.zeros(len(rows), dtype=np.int64) if cloud.body is None else cloud.body[rows]
    for one in range(1 + int(largest(cloud.comm, number, initial=0))):
        mine = number == one
        own = np.ones(cloud.n_owned, dtype=bool) if cloud.body is None else cloud.body[: cloud.n_owned] == one
        vectors[mine] = _closed(cloud, x[mine], vectors[mine], cloud.volume[: cloud.n_owned] * own)
    return Surface(x, vectors, rows, {}, *interpolation(cloud, families, x, vectors, rows))


def _normals(cloud: Cloud, families: Families, size: Float) -> tuple[GlobalIndex, Float]:
    """Return outer own particles, once for each of their normals, ascending, and the normals (m, dim) (collective)."""
    n, dim = cloud.n_owned, cloud.dim
    cosine, axes = np.full((n, 2), 2.0), np.zeros((n, 2, dim))
    emptiest(families.indptr, families.neighbours, cloud.x, _directions(dim), NARROW, TURNS, cosine, axes)
    outer = cosine <= EMPTY
    rows, side = np.nonzero(outer)
    anyone = cloud.halo.with_ghosts(outer.any(axis=1))
    fitted, levels = np.zeros((n, 2, dim)), np.zeros((n, 2))
    fitted[rows, side], levels[rows, side] = _planes(cloud, families, size, anyone, rows, axes[rows, side])
    fitted, levels = _with_ghosts(cloud, fitted), cloud.halo.with_ghosts(levels)
    # The planes of outer particles beside each outer particle, and its own ones.
    mine = np.flatnonzero(outer.any(axis=1))
    entry, ptr = entries_of(families.indptr, mine)
    of = np.concatenate([mine, mine[row_of_entries(ptr)]])
    other = np.concatenate([mine, families.neighbours[entry]])
    xi = (cloud.x[other] - cloud.x[of]) / size[of][:, None]
    near = np.linalg.norm(xi, axis=1) <= BESIDE
    of, other, xi = (np.repeat(values[near], 2, axis=0) for values in (of, other, xi))
    alternate = np.arange(len(other)) % 2
    normal, level = fitted[other, alternate], levels[other, alternate] + (xi * size[of][:, None] * fitted[other, alternate]).sum(axis=1)
    on_it = normal.any(axis=1) & (np.abs(level) <= ON_PLANE * size[of])
    of, xi, normal, level = of[on_it], xi[on_it], normal[on_it], level[on_it]
    free = _cosines(cloud, families, of, normal) <= EMPTY
    of, xi, normal, level = of[free], xi[free], normal[free], level[free]
    order = np.lexsort((np.round((xi**2).sum(axis=1), 6), of))
    found = _different(of[order], normal[order], level[order])
    # An outer particle without such a plane has the axis of its cone.
    alone = np.isin(rows, found[0], invert=True)
    return _with_sides(cloud, families, *_sorted([found, (rows[alone], axes[rows, side][alone], np.zeros(alone.sum()))]))


def _with_sides(cloud: Cloud, families: Families, of: GlobalIndex, normal: Float, level: Float) -> tuple[GlobalIndex, Float, Float]:
    """Return normals with those of edges too narrow for a plane: away from the family, across the normals so far."""
    rows = np.unique(of)
    every = _of_each(of, normal, rows)
    free = np.zeros(len(rows), dtype=bool)
    bare(families.indptr, families.neighbours, cloud.x, rows, every, _directions(cloud.dim), EMPTY, BARE, free)
    rows, every = rows[free], every[free]
    entry, ptr = entries_of(families.indptr, rows)
    xi = cloud.x[families.neighbours[entry]] - cloud.x[rows[row_of_entries(ptr)]]
    away = -sum_by(row_of_entries(ptr), xi, len(rows)) / np.maximum(np.diff(ptr), 1)[:, None]
    far = np.linalg.norm(away, axis=1)
    # Orthogonal projection on what no normal has a part in.
    left = np.eye(cloud.dim) - np.einsum("pim,pmj->pij", np.linalg.pinv(every, rcond=FLAT), every)
    away = np.einsum("pij,pj->pi", left, away)
    size = np.linalg.norm(away, axis=1)
    some = size > FLAT * far
    rows, away = rows[some], away[some] / size[some, None]
    some = _cosines(cloud, families, rows, away) <= EMPTY
    return _sorted([(of, normal, level), (rows[some], away[some], np.zeros(some.sum()))])


def _sorted(parts: list[tuple[GlobalIndex, Float, Float]]) -> tuple[GlobalIndex, Float, Float]:
    of, normal, level = (np.concatenate(one) for one in zip(*parts, strict=True))
    order = np.argsort(of, kind="stable")
    return of[order], normal[order], level[order]


def _of_each(of: GlobalIndex, normal: Float, rows: GlobalIndex) -> Float:
    """Return the normals of particles ``rows`` (n, MOST, dim), 0 where there is none; ``of`` is ascending."""
    every = np.zeros((len(rows), MOST, normal.shape[1]))
    every[np.searchsorted(rows, of), _numbers(of)] = normal
    return every


def _numbers(of: GlobalIndex) -> GlobalIndex:
    """Return the number of each normal among those of its particle."""
    return np.asarray(np.arange(len(of)) - np.searchsorted(of, of))


def _planes(
    cloud: Cloud, families: Families, size: Float, outer: Mask, rows: GlobalIndex, axes: Float
) -> tuple[Float, Float]:
    """Return the normals (m, dim) of planes through outer particles near those of ``rows``, 0 where there is none."""
    entry, ptr = entries_of(families.indptr, rows)
    of, other = row_of_entries(ptr), families.neighbours[entry]
    kept = outer[other]
    of, other = of[kept], other[kept]
    xi = (cloud.x[other] - cloud.x[rows[of]]) / size[rows[of]][:, None]
    r = np.linalg.norm(xi, axis=1)
    kept = r <= NEAR
    of, xi, r = of[kept], xi[kept], r[kept]
    normal, m = axes.copy(), len(rows)
    for step in range(STEPS):
        off = np.abs((xi * normal[of]).sum(axis=1))
        near = off <= (0.5 * OFF * (1.0 + r) if step == 0 else OFF)
        w = near / ((1.0 + r**2) ** 2 * (1.0 + (off / LOOSE) ** 2))
        whole = 1.0 + np.bincount(of, w, m)
        mean = sum_by(of, w[:, None] * xi, m) / whole[:, None]
        square = sum_by(of, w[:, None, None] * xi[:, :, None] * xi[:, None, :], m) / whole[:, None, None]
        extent, found = np.linalg.eigh(square - mean[:, :, None] * mean[:, None, :])
        turned = np.where((found[:, :, 0] * normal).sum(axis=1) < 0.0, -1.0, 1.0)
        normal = turned[:, None] * found[:, :, 0]
    level = np.clip((mean * normal).sum(axis=1), -ON_PLANE, ON_PLANE) * size[rows]
    return np.where((extent[:, 1] >= WIDE)[:, None], normal, 0.0), level


def _different(of: GlobalIndex, normal: Float, level: Float) -> tuple[GlobalIndex, Float, Float]:
    """Return the first normal of each particle, the first one that differs from it, and so on."""
    taken: list[tuple[GlobalIndex, Float, Float]] = [(of[:0], normal[:0], level[:0])]
    for _ in range(MOST - 1):
        one, first, back = np.unique(of, return_index=True, return_inverse=True)
        taken.append((one, normal[first], level[first]))
        left = (normal * normal[first[back]]).sum(axis=1) < OTHER_SIDE
        of, normal, level = of[left], normal[left], level[left]
    return _sorted(taken)


def _cut(
    cloud: Cloud, families: Families, size: Float, rows: GlobalIndex, normal: Float, level: Float
) -> tuple[Float, Float]:
    """Return the centroids of facets (m, dim), relative to their particles, and their areas (collective)."""
    n, dim = cloud.n_owned, cloud.dim
    number = _numbers(rows)
    offset = 0.5 * size[rows] + level
    every = _with_ghosts(cloud, _of_each(rows, 2.0 * offset[:, None] * normal, np.arange(n)))
    x, area = np.zeros((len(rows), dim)), np.zeros(len(rows))
    for first in range(0, len(rows), AT_ONCE):
        part = slice(first, first + AT_ONCE)
        chosen = rows[part]
        entry, ptr = entries_of(families.indptr, chosen)
        of, other = row_of_entries(ptr), families.neighbours[entry]
        xi = cloud.x[other] - cloud.x[chosen[of]]
        near = np.linalg.norm(xi, axis=1) <= REACH * size[chosen[of]]
        of, other, xi = of[near], other[near], xi[near]
        # Points outside of the other facets of the particles and of its neighbours, as far from these as they are.
        all_of, all_from = np.concatenate([np.arange(len(chosen)), of]), np.concatenate([chosen, other])
        base = np.concatenate([np.zeros((len(chosen), dim)), xi])
        which, kind = np.nonzero(every[all_from].any(axis=2))
        itself = (which < len(chosen)) & (kind == number[part][np.minimum(which, len(chosen) - 1)])
        which, kind = which[~itself], kind[~itself]
        outside = base[which] + every[all_from[which], kind]
        of, points = np.concatenate([of, all_of[which]]), np.concatenate([xi, outside])
        order = np.argsort(of, kind="stable")
        starts = starts_of(np.bincount(of, minlength=len(chosen)))
        # The axes across a normal are the other right singular vectors.
        across = np.linalg.svd(normal[part, None, :])[2][:, 1:]
        cut_planes(
            normal[part], offset[part], HALF * size[chosen], across, starts, points[order], x[part], area[part]
        )
    return x, area


def _closed(cloud: Cloud, x: Float, area: Float, volume: Float) -> Float:
    """Return vector areas (m, dim) of a closed surface around a volume, close to given ones (collective).

    The areas ``A_f`` along the normals ``n_f`` become ``c A_f`` with the same enclosed volume, then ``A_f (1 + n_f . q_f)``
    and at last ``a_f + A_f q_f``, with linear functions ``q(x)``, so that ``sum a_f = 0`` and ``sum x_f (x) a_f = V I``.
    The first linear function changes no normal, and leaves out what only large changes of the areas would balance.
    """
    comm, dim = cloud.comm, cloud.dim
    periodic = [] if cloud.images is None else list(cloud.images.cell.periodic)
    planes = cloud.places.planes
    V = float(total(comm, volume.sum()))
    whole = float(total(comm, np.linalg.norm(area, axis=1).sum()))
    centre = total(comm, np.linalg.norm(area, axis=1) @ x) / whole
    for axis, at in planes.items():
        centre[axis] = at
    unit = V / whole
    place = np.concatenate([np.ones((len(x), 1)), (x - centre) / unit], axis=1)
    # Conditions of components of a (columns) with 1 and the coordinates (rows).
    wanted = np.ones((1 + dim, dim), dtype=bool)
    for axis in planes:
        wanted[np.arange(1 + dim) != 1 + axis, axis] = False
    wanted[[1 + axis for axis in periodic]] = False
    target = np.concatenate([np.zeros((1, dim)), V / unit * np.eye(dim)])
    axes = [axis for axis in range(dim) if axis not in periodic]
    enclosed = total(comm, place.T @ area)[1 + np.array(axes), axes].mean() * unit / V
    if not ENCLOSED < enclosed < 1.0 / ENCLOSED:
        raise CaseError(
            f"The outer layer of the particles, half a particle size outward, encloses {enclosed:.3g} of their volume. "
            f"Check volumes and thickness, or give facets=pd.Facets(...)."
        )
    area = area / enclosed
    size = np.linalg.norm(area, axis=1)
    normal = area / size[:, None]
    phi = (place[:, :, None] * normal[:, None, :])[:, wanted]
    left = (target - total(comm, place.T @ area))[wanted]
    area = area + (size * (phi @ np.linalg.lstsq(total(comm, phi.T @ (size[:, None] * phi)), left, rcond=SMALL)[0]))[
        :, None
    ] * normal
    left = np.where(wanted, target - total(comm, place.T @ area), 0.0)
    gram = total(comm, place.T @ (size[:, None] * place))
    for k in range(dim):
        rows = np.flatnonzero(wanted[:, k])
        area[:, k] += size * (place[:, rows] @ np.linalg.lstsq(gram[np.ix_(rows, rows)], left[rows, k], rcond=1e-12)[0])
    return area


def _cosines(cloud: Cloud, families: Families, rows: GlobalIndex, normal: Float) -> Float:
    """Return the largest cosine of a bond of each own particle with a direction (m,)."""
    found = np.empty(len(rows))
    highest(families.indptr, families.neighbours, cloud.x, rows, normal, found)
    return found


def _with_ghosts(cloud: Cloud, vectors: Float) -> Float:
    """Return several vectors of each own particle (n_owned, k, dim) with those of the ghosts (collective)."""
    found = cloud.halo.with_ghosts(vectors)
    if len(cloud.sign):
        found[cloud.n_owned :] *= cloud.sign[:, None]
    return found


def _directions(dim: int) -> Float:
    """Return unit vectors in all directions (n, dim): on a circle, or on a spiral from pole to pole of a sphere."""
    count = DIRECTIONS[dim]
    if dim == 2:
        angle = 2.0 * np.pi * np.arange(count) / count
        return np.stack([np.cos(angle), np.sin(angle)], axis=1)
    z = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    angle = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(count)
    return np.stack([np.sqrt(1.0 - z**2) * np.cos(angle), np.sqrt(1.0 - z**2) * np.sin(angle), z], axis=1)
