"""Facets of a cloud without cells, from the planes of its outer layer of particles."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, Mask, entries_of, row_of_entries, starts_of
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.communicator import anywhere, largest, total
from pdpetsc.discrete.families import Families
from pdpetsc.discrete.surface import Surface, interpolation
from pdpetsc.errors import CaseError
from pdpetsc.kernels.outer_layer import bare, cut_planes, emptiest, empty_cones
from pdpetsc.kernels.sparsity import nearest_neighbours, sum_by

# A particle is outer if a cone is empty, with the cosine of half its angle, 57 degrees. In a triangular lattice there
# are cones of 60 degrees behind the surface, in a cubic one of 55.
EMPTY = 0.55
# Half of the number of parts of the sides of a cube or a square, at which the search for cones begins; the cosine of
# the cones that must be empty there; and the steps in which the directions are improved.
PARTS, NARROW = {2: 8, 3: 6}, 0.66
TURNS = 0.3 * 0.8 ** np.arange(30)
# The plane of outer particles around one, in sizes of the particle: their distances along the plane and off it, the
# latter a share of both at first; the distance off the plane at which they have half of the weight; and the smallest
# second moment along its axes. Number of improvements.
NEAR, OFF, AT_FIRST, LOOSE, WIDE, STEPS = 2.5, 0.5, 0.25, 0.25, 0.1, 5
# An edge has the planes of the outer particles within this distance, unless it is further than that off the plane.
BESIDE, ON_PLANE = 2.0, 0.4
# Planes of a particle differ if the cosine of the angle between their normals is below this; the most that it has.
DIFFERENT, MOST = 0.75, 8
# An empty cone belongs to no plane if the cosines of its axis with all normals are below this.
BARE = 0.5
# Share of a vector below which a part of it is rounding or scatter.
FLAT = 0.1
# Half width of a facet without particles beside it, and distance of those that may bound it, in sizes of the particle.
HALF, REACH = 1.0, 3.0
# Smallest facet, in sides of a cubic particle; number of facets that are cut at once.
LEAST, AT_ONCE = 1e-6, 10000
# Outer particles lie on the surface if their sizes, and these over their spacing, are smaller by this factor than those
# of others: it is 0.7 to 0.8 then.
NODES = 0.88
# Least volume within a layer over that of its particles. Areas are not changed by small errors of the moments that need
# large changes of areas: the share of an eigenvalue of their squares.
ENCLOSED, SMALL = 0.6, 1e-2


class _Planes(NamedTuple):
    """Store planes at own particles, ascending.

    Attributes
    ----------
    of : (m,) int64
        The particles.
    normal : (m, dim) float64
        Outward unit normals [-].
    level : (m,) float64
        Distances of the planes from the particles, outward [length].
    """

    of: GlobalIndex
    normal: Float
    level: Float

    def chosen(self, rows: Mask | GlobalIndex) -> _Planes:
        return _Planes(self.of[rows], self.normal[rows], self.level[rows])

    def of_each(self, vectors: Float, rows: GlobalIndex) -> Float:
        """Return vectors of the planes (m, dim) for their particles ``rows`` (n, MOST, dim), 0 for no plane."""
        every = np.zeros((len(rows), MOST, vectors.shape[1]))
        every[np.searchsorted(rows, self.of), self.number] = vectors
        return every

    @property
    def number(self) -> GlobalIndex:
        """Return the number of each plane among those of its particle (m,)."""
        return np.asarray(np.arange(len(self.of)) - np.searchsorted(self.of, self.of))

    @staticmethod
    def joined(parts: Sequence[_Planes]) -> _Planes:
        of, normal, level = (np.concatenate(values) for values in zip(*parts, strict=True))
        order = np.argsort(of, kind="stable")
        return _Planes(of[order], normal[order], level[order])


def outer_layer(cloud: Cloud, families: Families, thickness: float) -> Surface:
    """Build the surface of a cloud whose cells are unknown, from the bonds and volumes of its particles.

    - A particle is outer if a cone with a half angle of 57 degrees is empty of its family. A layer as thin as one
      particle has two cones.
    - A plane is fitted to the outer particles near an outer particle, around that cone. Edges and corners, where these
      are in no plane, have the planes of particles beside them. An edge of two or fewer particles has a plane across
      its other planes, away from its family.
    - Each plane, moved outward by half the size ``(V / thickness)^(1 / dim)`` of the particle, is a facet where it is
      nearer to this particle than to others, and than to their images behind their own facets.
    - The areas of a body are multiplied by one factor, so that they enclose the volume of its particles. Then they are
      changed so that the surface is closed.

    The areas of blocks of a cubic lattice are exact, along the axes or turned.

    Parameters
    ----------
    cloud : Cloud
        Particles of this rank.
    families : Families
        Their bonds. Images behind mirror planes and in periodic cells are members of families, and prevent a surface.
    thickness : float
        Thickness of a plane body [length]; the volumes contain it.

    Raises
    ------
    CaseError
        The body is a line, its outer particles lie on the surface as nodes do, or the layer does not enclose the volume
        of the particles; raised on every rank.

    Notes
    -----
    Collective.
    """
    dim = cloud.dim
    if dim == 1:
        raise CaseError("Particles on a line have no outer layer; use Lattice or Mesh, or give facets=pd.Facets(...).")
    depth = thickness if dim == 2 else 1.0
    size = (cloud.volume / depth) ** (1.0 / dim)
    planes = _planes(cloud, families, size)
    x, area = _cut(cloud, families, size, planes)
    kept = area > LEAST * size[planes.of] ** (dim - 1)
    planes, x, area = planes.chosen(kept), x[kept] + cloud.x[planes.of[kept]], area[kept]
    if not anywhere(cloud.comm, len(area)):
        raise CaseError("No particle of the body is outer; give facets=pd.Facets(...).")
    _refuse_nodes(cloud, families, size, planes.of)
    vectors = (depth * area)[:, None] * planes.normal
    bodies = np.zeros(cloud.n_owned, dtype=np.int64) if cloud.body is None else cloud.body[: cloud.n_owned]
    for number in range(1 + int(largest(cloud.comm, bodies, initial=0))):
        mine, volume = bodies[planes.of] == number, cloud.volume[: cloud.n_owned][bodies == number].sum()
        vectors[mine] = _closed(cloud, x[mine], vectors[mine], float(total(cloud.comm, volume)))
    uneven = largest(cloud.comm, size[planes.of], initial=0.0)
    members = interpolation(cloud, families, x, vectors, planes.of)
    return Surface(x, vectors, planes.of, {}, *members, uneven=uneven)


def _refuse_nodes(cloud: Cloud, families: Families, size: Float, outer: GlobalIndex) -> None:
    """Raise CaseError if outer particles are smaller than those of their families at the same spacing (collective)."""
    nearest = cloud.local_horizon[: cloud.n_owned].copy()
    nearest_neighbours(families.indptr, families.neighbours, cloud.x, nearest)
    inner = np.ones(cloud.n_owned, dtype=bool)
    inner[outer] = False
    behind = cloud.halo.with_ghosts(inner)
    rows = np.flatnonzero(~inner)
    of, other = _families_of(families, rows)
    of, other = of[behind[other]], other[behind[other]]
    count = np.bincount(of, minlength=len(rows))
    rows, mean = rows[count > 0], (np.bincount(of, size[other], len(count)) / np.maximum(count, 1))[count > 0]
    sums = [size[rows].sum(), mean.sum(), nearest[rows].sum(), size[: cloud.n_owned][inner].sum(), nearest[inner].sum()]
    own, others, spacing, all_others, their_spacing = total(cloud.comm, sums)
    if own < NODES * others and own / spacing < NODES * all_others / their_spacing:
        raise CaseError(
            "The outer particles have smaller volumes than others at the same spacing, as nodes on a surface do; give "
            "facets=pd.Facets(...), or use LatticeNodes or MeshNodes."
        )


def _planes(cloud: Cloud, families: Families, size: Float) -> _Planes:
    """Return the planes of the outer particles (collective)."""
    n, dim = cloud.n_owned, cloud.dim
    cosine, axes = np.full((n, 2), 2.0), np.zeros((n, 2, dim))
    emptiest(families.indptr, families.neighbours, cloud.x, _directions(dim), NARROW, TURNS, cosine, axes)
    outer = cosine <= EMPTY
    rows, side = np.nonzero(outer)
    cones = _Planes(rows, axes[rows, side], np.zeros(len(rows)))
    fitted, levels = np.zeros((n, 2, dim)), np.zeros((n, 2))
    everyone = cloud.halo.with_ghosts(outer.any(axis=1))
    fitted[rows, side], levels[rows, side] = _fitted(cloud, families, size, everyone, cones)
    fitted, levels = _with_ghosts(cloud, fitted), cloud.halo.with_ghosts(levels)
    # Planes of the particle itself and of those beside it.
    mine = np.unique(rows)
    of, other = _families_of(families, mine)
    of, other = np.concatenate([mine, mine[of]]), np.concatenate([mine, other])
    far = np.linalg.norm(cloud.x[other] - cloud.x[of], axis=1) / size[of]
    near = np.flatnonzero(far <= BESIDE)
    near = np.repeat(near[np.lexsort((np.round(far[near], 6), of[near]))], 2)
    of, other, side = of[near], other[near], np.arange(len(near)) % 2
    normal = fitted[other, side]
    level = levels[other, side] + ((cloud.x[other] - cloud.x[of]) * normal).sum(axis=1)
    found = _Planes(of, normal, level).chosen(normal.any(axis=1) & (np.abs(level) <= ON_PLANE * size[of]))
    found = _different(found.chosen(_free(cloud, families, found)))
    # An outer particle without a plane has that across the axis of its cone.
    found = _Planes.joined([found, cones.chosen(np.isin(rows, found.of, invert=True))])
    return _Planes.joined([found, _narrow(cloud, families, found)])


def _fitted(cloud: Cloud, families: Families, size: Float, outer: Mask, cones: _Planes) -> tuple[Float, Float]:
    """Return normals (m, dim) and levels (m,) of planes around the axes of cones; 0 if particles are in no plane.

    ``outer`` (n_local,) marks the particles of the fit, whose weights decrease with their distances from the particle
    and off the plane.
    """
    m, unit = len(cones.of), size[cones.of]
    of, other = _families_of(families, cones.of)
    xi = (cloud.x[other] - cloud.x[cones.of[of]]) / unit[of, None]
    r = np.linalg.norm(xi, axis=1)
    kept = outer[other] & (r <= NEAR)
    of, xi, r = of[kept], xi[kept], r[kept]
    normal = cones.normal
    for step in range(STEPS):
        off = np.abs((xi * normal[of]).sum(axis=1))
        near = off <= (AT_FIRST * (1.0 + r) if step == 0 else OFF)
        w = near / ((1.0 + r**2) ** 2 * (1.0 + (off / LOOSE) ** 2))
        whole = 1.0 + np.bincount(of, w, m)
        mean = sum_by(of, w[:, None] * xi, m) / whole[:, None]
        square = sum_by(of, w[:, None, None] * xi[:, :, None] * xi[:, None, :], m) / whole[:, None, None]
        extent, found = np.linalg.eigh(square - mean[:, :, None] * mean[:, None, :])
        across = found[:, :, 0]
        normal = np.where(((across * normal).sum(axis=1) < 0.0)[:, None], -across, across)
    level = np.clip((mean * normal).sum(axis=1), -ON_PLANE, ON_PLANE) * unit
    return np.where((extent[:, 1] >= WIDE)[:, None], normal, 0.0), level


def _different(planes: _Planes) -> _Planes:
    """Return the first plane of each particle, the first one that differs from it, the next one, and so on."""
    taken = [planes.chosen(np.zeros(0, dtype=np.int64))]
    for _ in range(MOST - 1):
        _, first, back = np.unique(planes.of, return_index=True, return_inverse=True)
        taken.append(planes.chosen(first))
        planes = planes.chosen((planes.normal * planes.normal[first[back]]).sum(axis=1) < DIFFERENT)
    return _Planes.joined(taken)


def _narrow(cloud: Cloud, families: Families, planes: _Planes) -> _Planes:
    """Return planes of the particles with an empty cone far from all of their planes: of edges and ends.

    They are away from the family, across the planes so far (not collective).
    """
    rows = np.unique(planes.of)
    every, marked = planes.of_each(planes.normal, rows), np.zeros(len(rows), dtype=bool)
    bare(families.indptr, families.neighbours, cloud.x, rows, every, _directions(cloud.dim), EMPTY, BARE, marked)
    rows, every = rows[marked], every[marked]
    of, other = _families_of(families, rows)
    away = -sum_by(of, cloud.x[other] - cloud.x[rows[of]], len(rows))
    across = np.eye(cloud.dim) - np.einsum("pim,pmj->pij", np.linalg.pinv(every, rcond=FLAT), every)
    left = np.einsum("pij,pj->pi", across, away)
    length = np.linalg.norm(left, axis=1)
    some = length > FLAT * np.linalg.norm(away, axis=1)
    found = _Planes(rows[some], left[some] / length[some, None], np.zeros(np.count_nonzero(some)))
    return found.chosen(_free(cloud, families, found))


def _cut(cloud: Cloud, families: Families, size: Float, planes: _Planes) -> tuple[Float, Float]:
    """Return centroids of facets (m, dim), relative to their particles, and areas per thickness (m,) (collective)."""
    offset = 0.5 * size[planes.of] + planes.level
    images = planes.of_each(2.0 * offset[:, None] * planes.normal, np.arange(cloud.n_owned))
    images = _with_ghosts(cloud, images)
    x, area = np.zeros(planes.normal.shape), np.zeros(len(planes.of))
    for first in range(0, len(planes.of), AT_ONCE):
        part = slice(first, first + AT_ONCE)
        rows, own = planes.of[part], planes.number[part]
        of, other = _families_of(families, rows)
        xi = cloud.x[other] - cloud.x[rows[of]]
        near = np.linalg.norm(xi, axis=1) <= REACH * size[rows[of]]
        of, other, xi = of[near], other[near], xi[near]
        # Images of the particle itself and of the others behind their facets.
        origin = np.concatenate([np.zeros((len(rows), xi.shape[1])), xi])
        behind, number = np.concatenate([rows, other]), np.concatenate([np.arange(len(rows)), of])
        which, kind = np.nonzero(images[behind].any(axis=2))
        others = (which >= len(rows)) | (kind != own[number[which]])
        which, kind = which[others], kind[others]
        points = np.concatenate([xi, origin[which] + images[behind[which], kind]])
        of = np.concatenate([of, number[which]])
        order, ptr = np.argsort(of, kind="stable"), starts_of(np.bincount(of, minlength=len(rows)))
        across = np.linalg.svd(planes.normal[part, None, :])[2][:, 1:]
        half = HALF * size[rows]
        cut_planes(planes.normal[part], offset[part], half, across, ptr, points[order], x[part], area[part])
    return x, area


def _closed(cloud: Cloud, x: Float, area: Float, V: float) -> Float:
    """Return vector areas (m, dim) near given ones that are closed and enclose a volume (collective).

    The areas ``A_f`` along ``n_f`` become ``c A_f`` with the enclosed volume ``V``, then ``A_f (1 + n_f . q(x_f))``,
    and last ``a_f + A_f q(x_f)``, with linear functions ``q``: ``sum a_f = 0`` and ``sum x_f (x) a_f = V I``. The
    second change keeps the normals. It leaves to the third one, which is small, what would change areas much.
    """
    comm, dim = cloud.comm, cloud.dim
    periodic = [] if cloud.images is None else list(cloud.images.cell.periodic)
    size = np.linalg.norm(area, axis=1)
    whole = float(total(comm, size.sum()))
    centre = total(comm, size @ x) / whole
    for axis, at in cloud.places.planes.items():
        centre[axis] = at
    unit = V / whole
    place = np.concatenate([np.ones((len(x), 1)), (x - centre) / unit], axis=1)
    # Conditions on the sums of 1 and the coordinates (rows) with the components of the areas (columns). Those that are
    # odd across a mirror plane hold by symmetry.
    wanted = np.ones((1 + dim, dim), dtype=bool)
    for axis in cloud.places.planes:
        coordinate, component = np.arange(1 + dim)[:, None] == 1 + axis, np.arange(dim) == axis
        wanted &= coordinate == component
    wanted[[1 + axis for axis in periodic]] = False
    target = np.concatenate([np.zeros((1, dim)), V / unit * np.eye(dim)])
    ends = [axis for axis in range(dim) if axis not in periodic]
    enclosed = float(np.diagonal(total(comm, place[:, 1:].T @ area))[ends].mean()) * unit / V
    if not ENCLOSED < enclosed < 1.0 / ENCLOSED:
        raise CaseError(
            f"The outer layer of the particles, half a particle outward, encloses {enclosed:.3g} times their volume; "
            f"check volumes and thickness, or give facets=pd.Facets(...)."
        )
    area, size = area / enclosed, size / enclosed
    normal = area / size[:, None]
    phi = (place[:, :, None] * normal[:, None, :])[:, wanted]
    left = (target - total(comm, place.T @ area))[wanted]
    factors = np.linalg.lstsq(total(comm, phi.T @ (size[:, None] * phi)), left, rcond=SMALL)[0]
    area = area * (1.0 + phi @ factors)[:, None]
    left, squares = target - total(comm, place.T @ area), total(comm, place.T @ (size[:, None] * place))
    for k in range(dim):
        rows = np.flatnonzero(wanted[:, k])
        factors = np.linalg.lstsq(squares[np.ix_(rows, rows)], left[rows, k], rcond=None)[0]
        area[:, k] += size * (place[:, rows] @ factors)
    return area


def _families_of(families: Families, rows: GlobalIndex) -> tuple[GlobalIndex, LocalIndex]:
    """Return the place in ``rows`` and the neighbour of each bond of own particles ``rows``."""
    entry, ptr = entries_of(families.indptr, rows)
    return row_of_entries(ptr), families.neighbours[entry]


def _free(cloud: Cloud, families: Families, planes: _Planes) -> Mask:
    """Return which normals are axes of empty cones (m,)."""
    found = np.empty(len(planes.of), dtype=bool)
    empty_cones(families.indptr, families.neighbours, cloud.x, planes.of, planes.normal, EMPTY, found)
    return found


def _with_ghosts(cloud: Cloud, vectors: Float) -> Float:
    """Return several vectors of each own particle (n_owned, k, dim) with those of the ghosts (collective)."""
    found = cloud.halo.with_ghosts(vectors)
    if len(cloud.sign):
        found[cloud.n_owned :] *= cloud.sign[:, None]
    return found


def _directions(dim: int) -> Float:
    """Return unit vectors (n, dim) in directions that are nearly equally apart, and symmetric to all axes.

    They point at the places of a grid on the sides of a square or a cube.
    """
    count = PARTS[dim]
    places = np.stack(np.meshgrid(*[np.arange(-count, count + 1)] * dim, indexing="ij"), axis=-1).reshape(-1, dim)
    points = np.tan(0.25 * np.pi / count * places[np.abs(places).max(axis=1) == count])
    return np.asarray(points / np.linalg.norm(points, axis=1)[:, None])
