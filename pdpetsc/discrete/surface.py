"""Surface of a distributed cloud, and the interpolation between facets and particles near them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, Mask, row_of_entries, starts_of
from pdpetsc.declare.region import Region, View
from pdpetsc.declare.surface import Facets
from pdpetsc.discrete.cloud import Cloud, creators
from pdpetsc.discrete.communicator import agreed, anywhere, fetch, smallest, total
from pdpetsc.discrete.families import Families
from pdpetsc.errors import CaseError
from pdpetsc.kernels.sparsity import sum_by

# Tolerance of a closed surface, as a share of its area, and of its enclosed volume, as a share of the volume.
CLOSED = 1e-8
# Two facets are opposite if their distance is a whole period up to this share of the period.
ON_SIDE = 1e-9
# A particle closer to its facet than this share of the horizon lies on it, as nodes of a mesh do.
NEAR_FACET = 1e-6
# The distance of a particle to its facet is no unit of length if it is below this share of its horizon: others would
# have no weight.
SHORT = 0.05
# A family has no extent along a principal axis if its second moment is below this share of the largest.
FLAT = 1e-8
# A bond goes straight through a facet if the cosine of its angle with the normal is above this.
ACROSS = 0.8
# A linear function is fitted if the smallest eigenvalue of the moments of the particles is above this, in horizons.
EXTENT = 1e-3
# Quadratic functions are fitted if the smallest eigenvalue of their moments, with 1 on the diagonal, is above this.
DETERMINED = 1e-4
# Distance of a facet on a mirror plane, as a share of the horizon.
ON_MIRROR = 1e-6


@dataclass(frozen=True)
class Surface:
    """Store the facets of the own particles of a rank, with an interpolation from their families.

    ``N_f(x_k)`` is linear-exact: ``sum_k N_f(x_k) = 1`` and ``sum_k N_f(x_k) x_k = x_f``. It is a moving least squares
    fit over the particle whose cell the facet bounds, and its family. No crack lies between these.

    Attributes
    ----------
    x, area : (n_facets, dim) float64
        Centroids [length] and outward vector areas [area].
    owner : (n_facets,) int64
        Own particle whose cell each facet bounds.
    tags : mapping of str to (n_facets,) bool
        Named parts.
    ptr : (n_facets + 1,) int64
        Start of the particles of each facet.
    members : (n_entries,) int32
        Local particles.
    N : (n_entries,) float64
        ``N_f(x_k)`` [-].
    corners : (n_facets, 4, 3) float64 or None
        Corners in turn [length], if they are known: of solid bodies.
    uneven : float
        Depth within which facets are those of one side [length]: 0, or the size of the particles of an outer layer.
    """

    x: Float
    area: Float
    owner: GlobalIndex
    tags: Mapping[str, Mask]
    ptr: GlobalIndex
    members: LocalIndex
    N: Float
    corners: Float | None = None
    uneven: float = 0.0

    def spread(self, values: Float, onto: Float) -> None:
        """Add ``sum_f N_f(x_k) v_f`` to ``onto`` (n_local, dim) for ``values`` (n_facets, dim) (not collective)."""
        onto += sum_by(self.members, self.N[:, None] * values[self._facet_of], len(onto))

    def interpolated(self, values: Float) -> Float:
        """Compute ``sum_k N_f(x_k) v_k`` (n_facets,) for ``values`` (n_local,) with ghosts (not collective)."""
        return np.asarray(np.bincount(self._facet_of, self.N * values[self.members], len(self.x)))

    def extrapolated(self, cloud: Cloud, families: Families, values: Float, sign: Float | None = None) -> Float:
        """Extrapolate a field of the own particles (n_owned,) to the facets (n_facets,), without the outermost layer.

        The surface cuts the families of the particles that own a facet most. Their gradients have an error of a share
        of a spacing times the next derivative; those of the others are almost exact. A linear function is fitted to the
        others in every family. A facet gets the mean of the fits around its particle, weighted by the smallest
        eigenvalue of the moments of each fit. The result is linear-exact. In a body so thin that there are no others it
        is ``interpolated``.

        Parameters
        ----------
        cloud : Cloud
            Particles of this rank.
        families : Families
            Their bonds.
        values : (n_owned,) float64
            The field.
        sign : (n_ghosts,) float64, optional
            Factor of the field in images behind mirror planes [-].

        Notes
        -----
        Collective.
        """
        n, dim = cloud.n_owned, cloud.dim
        inside = np.ones(n)
        inside[self.owner] = 0.0
        field = cloud.halo.with_ghosts(np.stack([values, inside], axis=1))
        if sign is not None:
            field[n:, 0] *= sign
        value, inner = field.T
        of = np.concatenate([np.arange(n), families.centres])
        members = np.concatenate([np.arange(n), families.neighbours])
        phi = np.concatenate([np.ones((len(of), 1)), (cloud.x[members] - cloud.x[of]) / cloud.horizon], axis=1)
        taken = inner[members]
        moments, sums = _moments(phi, taken, of, n), sum_by(of, taken[:, None] * phi * value[members, None], n)
        least = np.linalg.eigvalsh(moments / np.maximum(moments[:, :1, :1], 1.0))[:, 0]
        good = (least > EXTENT) & (inner[:n] > 0.0)
        fitted = np.zeros((n, dim + 2))
        fitted[good, :-1] = np.linalg.solve(moments[good], sums[good, :, None])[:, :, 0]
        fitted[:, -1] = np.where(good, least, 0.0)
        fitted = cloud.halo.with_ghosts(fitted)
        if sign is not None:
            fitted[n:, :-1] *= sign[:, None]
            fitted[n:, 1:-1] *= cloud.sign
        apart = (self.x[self._facet_of] - cloud.x[self.members]) / cloud.horizon
        there = fitted[self.members, 0] + np.einsum("em,em->e", fitted[self.members, 1:-1], apart)
        weight = fitted[self.members, -1]
        above, below = (np.bincount(self._facet_of, w, len(self.x)) for w in (weight * there, weight))
        return np.where(below > 0.0, above / np.where(below > 0.0, below, 1.0), self.interpolated(value))

    def gradient(self, cloud: Cloud) -> Float:
        """Compute ``G_f(x_k)`` (n_entries, dim) [1 / length] of the gradient ``sum_k u_k (x) G_f(x_k)`` at facets.

        It is that of a fit of quadratic functions, of linear ones where the particles do not determine these. Where all
        particles of a facet lie in its plane it is tangential (not collective).
        """
        of, dim = self._facet_of, cloud.dim
        fit = _fit(cloud, self.x, self.area, self.owner, self.ptr, self.members)
        linear = np.linalg.inv(fit.moments)
        squares = [fit.phi[:, 1 + a] * fit.phi[:, 1 + b] for a in range(dim) for b in range(a, dim)]
        phi = np.concatenate([fit.phi, np.stack(squares, axis=1)], axis=1)
        moments = _moments(phi, fit.weight, of, len(self.x))
        # Functions that vanish on all particles: axes without extent.
        size = np.einsum("faa->fa", moments)
        absent = size <= FLAT * size[:, :1]
        moments[absent[:, :, None] | absent[:, None, :]] = 0.0
        moments += np.einsum("fa,ab->fab", absent * 1.0, np.eye(phi.shape[1]))
        scale = 1.0 / np.sqrt(np.einsum("faa->fa", moments))
        spectrum = np.linalg.eigvalsh(moments * scale[:, :, None] * scale[:, None, :])
        quadratic = spectrum[:, 0] > DETERMINED
        moments[~quadratic] = np.eye(phi.shape[1])
        inverse = np.where(absent[:, :, None] | absent[:, None, :], 0.0, np.linalg.inv(moments))
        inverse[~quadratic] = 0.0
        inverse[~quadratic, : dim + 1, : dim + 1] = linear[~quadratic]
        G = np.zeros((len(of), dim))
        for b in range(dim):
            slope = fit.weight * (phi * inverse[:, :, 1 + b][of]).sum(axis=1)
            G += slope[:, None] * fit.axes[:, :, b][of]
        return G / fit.unit

    @cached_property
    def _facet_of(self) -> GlobalIndex:
        """Return the facet of every entry (n_entries,)."""
        return row_of_entries(self.ptr)

    def select(self, cloud: Cloud, region: Region, what: str) -> Mask:
        """Return which facets have their centroid in a region; names are tags of facets, or sets of their particles.

        Raises
        ------
        CaseError
            The region selects no facet of any rank.

        Notes
        -----
        Collective.
        """
        sets = {name: flags[self.owner] for name, flags in cloud.sets.items()} | dict(self.tags)
        view = View(self.x, sets, lambda value: smallest(cloud.comm, value), self.area, self.uneven)
        with agreed(cloud.comm):
            mask = np.asarray(region.mask(view))
        if not anywhere(cloud.comm, mask):
            raise CaseError(
                f"The region of {what} holds no facet of the surface: let it hold the face itself, not only the "
                f"centres of the particles behind it."
            )
        return mask


def surface_of(cloud: Cloud, families: Families, created: Facets) -> Surface:
    """Build the surface of the own particles from the facets that this rank created.

    Parameters
    ----------
    created : Facets
        Facets of the particles that this rank created, numbered from its first particle.

    Raises
    ------
    CaseError
        The surface is not closed, or does not enclose the volume of the particles; raised on every rank.

    Notes
    -----
    Collective.
    """
    comm, dim = cloud.comm, cloud.dim
    x, area, particle, tags = created.arrays
    names = sorted({name for part in comm.allgather(sorted(tags)) for name in part})
    order = np.argsort(particle, kind="stable")
    empty = np.zeros(len(x), dtype=bool)
    flags = np.array([tags.get(name, empty) for name in names], dtype=float).reshape(len(names), len(x)).T
    parts = [x, area, flags]
    cornered = created.corners is not None or len(x) == 0
    if not anywhere(comm, not cornered) and dim == 3:
        parts.append(np.asarray(created.corners, dtype=float).reshape(len(x), 12) if len(x) else np.empty((0, 12)))
    packed = np.concatenate(parts, axis=1)[order]
    counts = np.bincount(particle, minlength=cloud.n_created).astype(np.int64)
    creator, row = creators(cloud)
    count, start = fetch(comm, creator, row, np.stack([counts, np.cumsum(counts) - counts], axis=1)).T
    owner = np.repeat(np.arange(cloud.n_owned), count)
    first = np.cumsum(count) - count
    rows = np.arange(len(owner)) - np.repeat(first, count) + np.repeat(start, count)
    packed = fetch(comm, np.repeat(creator, count), rows, packed)
    x, area = packed[:, :dim], packed[:, dim : 2 * dim]
    kept = ~_before_images(cloud, families, x, area, owner)
    x, area, owner = np.ascontiguousarray(x[kept]), np.ascontiguousarray(area[kept]), owner[kept]
    tagged = {name: packed[kept, 2 * dim + n] > 0.5 for n, name in enumerate(names)}
    _refuse_open(cloud, x, area)
    _refuse_far(cloud, x, owner)
    corners = packed[kept, 2 * dim + len(names) :].reshape(-1, 4, 3) if len(parts) > 3 else None
    return Surface(x, area, owner, tagged, *interpolation(cloud, families, x, area, owner), corners)


def _refuse_far(cloud: Cloud, x: Float, owner: GlobalIndex) -> None:
    """Raise on all ranks if a facet is further than a horizon from the particle whose cell it bounds."""
    apart = np.linalg.norm(x - cloud.x[owner], axis=1)
    with agreed(cloud.comm):
        far = np.flatnonzero(apart > cloud.horizon * (1.0 + ON_MIRROR))
        if len(far):
            raise CaseError(
                f"A facet at {x[far[0]]} is given to the particle at {cloud.x[owner[far[0]]]}, more than one horizon "
                f"away; give each facet the number of the particle whose cell it bounds, in the order of creation."
            )


def _before_images(cloud: Cloud, families: Families, x: Float, area: Float, owner: GlobalIndex) -> Mask:
    """Return which facets have images behind them: on a mirror plane, or opposite to another facet a period away.

    A crack along the plane or the side of the cell cuts the bond through the facet, which is then part of the surface.

    Notes
    -----
    Collective.
    """
    found = np.zeros(len(x), dtype=bool)
    size = np.linalg.norm(area, axis=1)
    for axis, at in cloud.places.planes.items():
        across = np.abs(area[:, axis]) >= (1.0 - ON_MIRROR) * size
        on = np.flatnonzero(across & (np.abs(x[:, axis] - at) <= ON_MIRROR * cloud.horizon))
        image = cloud.x[owner[on]]
        image[:, axis] = 2.0 * at - image[:, axis]
        found[on[_bonded(cloud, families, owner[on], image)]] = True
    if cloud.images is None:
        return found
    comm, cell = cloud.comm, cloud.images.cell
    for axis in cell.periodic:
        across = np.flatnonzero(np.abs(area[:, axis]) >= (1.0 - ON_SIDE) * size)
        rank = np.full(len(across), comm.rank)
        here = x[across], area[across], cloud.x[owner[across]], rank
        every, areas, owners, ranks = (np.concatenate(comm.allgather(values)) for values in here)
        # One period apart along this axis, and whole periods along others.
        boxes = np.where(np.isin(np.arange(cloud.dim), cell.periodic), cell.lengths, 0.0)
        places = every - np.asarray(cell.origin)
        for other in cell.periodic:
            places[:, other] %= boxes[other]
            places[boxes[other] - places[:, other] <= ON_SIDE * boxes[other], other] = 0.0
        reach = ON_SIDE * float(boxes.max())
        pairs = scipy.spatial.cKDTree(places).query_pairs(2.0 * reach, output_type="ndarray")
        largest = float(np.abs(areas).max(initial=0.0))
        opposite = np.abs(areas[pairs[:, 0]] + areas[pairs[:, 1]]).max(axis=1, initial=0.0) <= 2.0 * ON_SIDE * largest
        apart = np.abs(every[pairs[:, 0], axis] - every[pairs[:, 1], axis]) > 0.5 * boxes[axis]
        one, other = pairs[opposite & apart].T
        one, other = np.concatenate([one, other]), np.concatenate([other, one])
        mine = ranks[one] == comm.rank
        one, other = one[mine], other[mine]
        facet = across[one - np.searchsorted(ranks, comm.rank)]
        # Position of the particle behind the other facet, as seen from this facet.
        image = owners[other] + every[one] - every[other]
        found[facet[_bonded(cloud, families, owner[facet], image)]] = True
    return found


def _bonded(cloud: Cloud, families: Families, owner: GlobalIndex, places: Float) -> Mask:
    """Return which own particles have a bond to the particle at a position (n, dim), or are too far away for one."""
    count = np.diff(families.indptr)[owner]
    of = np.repeat(np.arange(len(owner)), count)
    bond = np.arange(len(of)) - np.repeat(np.cumsum(count) - count, count) + families.indptr[owner][of]
    apart = np.linalg.norm(cloud.x[families.neighbours[bond]] - places[of], axis=1)
    found = np.linalg.norm(cloud.x[owner] - places, axis=1) > cloud.horizon
    found[of[apart <= ON_MIRROR * cloud.horizon]] = True
    return np.asarray(found)


def refuse_joined(cloud: Cloud, surface: Surface, thickness: float) -> None:
    """Raise on all ranks if a bond goes through the middle of a facet to a particle directly behind it.

    Such a facet is not part of the surface: cells of two parts of a mesh touch without common nodes, or the sides of a
    periodic cell do not match. Weights would conform to a surface that the bonds do not have.

    Parameters
    ----------
    thickness : float
        Thickness of a plane body [length].

    Notes
    -----
    Collective.
    """
    dim, of = cloud.dim, surface._facet_of
    size = np.linalg.norm(surface.area, axis=1)
    normal = surface.area / size[:, None]
    # Half the length of a facet; a facet of a line is a point.
    half = 0.5 * {1: np.full(len(size), np.inf), 2: size / thickness, 3: np.sqrt(size)}[dim]
    depth = np.einsum("fi,fi->f", surface.x - cloud.x[surface.owner], normal)
    behind = np.einsum("ei,ei->e", cloud.x[surface.members] - surface.x[of], normal[of])
    bond = cloud.x[surface.members] - cloud.x[surface.owner[of]]
    straight = np.einsum("ei,ei->e", bond, normal[of]) > ACROSS * np.linalg.norm(bond, axis=1)
    # Beyond twice the depth of the cell there may be the other side of a narrow gap. At a rough surface, other
    # particles lie a little behind the facet.
    near = np.flatnonzero(straight & (behind > 0.3 * depth[of]) & (behind <= 2.0 * depth[of]))
    f, k = of[near], surface.members[near]
    share = (depth[f] / (depth[f] + behind[near]))[:, None]
    through = (1.0 - share) * cloud.x[surface.owner[f]] + share * cloud.x[k]
    found = np.unique(f[np.linalg.norm(through - surface.x[f], axis=1) < 0.5 * half[f]])
    count = int(total(cloud.comm, len(found)))
    where = [place for part in cloud.comm.allgather(surface.x[found[:1]].tolist()) for place in part]
    if count:
        raise CaseError(
            f"{count} facets of the surface have a bonded particle right behind them, the first at {where[0]}: join "
            f"the nodes of cells that touch there, let the facets on opposite sides of a periodic cell and those on a "
            f"mirror plane match it, or declare a crack."
        )


def _refuse_open(cloud: Cloud, x: Float, area: Float) -> None:
    """Raise on all ranks unless ``sum a_f = 0`` and ``sum x_f (x) a_f = V I`` (collective)."""
    comm, dim = cloud.comm, cloud.dim
    volume = float(total(comm, float(cloud.volume[: cloud.n_owned].sum())))
    size = float(total(comm, float(np.linalg.norm(area, axis=1).sum())))
    sums = total(comm, area.sum(axis=0))
    centre = total(comm, (cloud.x[: cloud.n_owned]).sum(axis=0)) / cloud.n_global
    # The omitted facets on a mirror plane have areas along its normal only, and no moment about a point on it.
    for axis, at in cloud.places.planes.items():
        sums[axis], centre[axis] = 0.0, at
    moment = total(comm, (x - centre).T @ area)
    for axis in cloud.places.planes:
        beside = np.arange(dim) != axis
        moment[beside, axis] = 0.0
    periodic = [] if cloud.images is None else list(cloud.images.cell.periodic)
    if np.abs(sums).max(initial=0.0) > CLOSED * size:
        raise CaseError(
            f"The surface of the particles is open: the vector areas of its facets add up to {sums}, not zero; give "
            f"all facets, with areas that point out of the body."
        )
    wrong = np.abs(moment - volume * np.eye(dim))
    wrong[periodic] = 0.0
    if wrong.max() > CLOSED * max(volume, float(np.abs(moment).max())):
        enclosed = np.diagonal(moment)
        raise CaseError(
            f"The surface of the particles encloses a volume of {enclosed[enclosed != 0.0].mean():.8g}, seen along the "
            f"axes {enclosed}, and the particles have {volume:.8g}; give volumes and facets of the same cells, with "
            f"areas that point out of the body."
        )


def interpolation(
    cloud: Cloud, families: Families, x: Float, area: Float, owner: GlobalIndex
) -> tuple[GlobalIndex, LocalIndex, Float]:
    """Compute ``ptr``, ``members`` and ``N`` of facets at ``x`` of the own particles ``owner``."""
    size = np.diff(families.indptr)[owner]
    ptr = starts_of(size + 1)
    of = np.repeat(np.arange(len(x)), size + 1)
    place = np.arange(ptr[-1]) - ptr[of]
    bond = np.minimum(families.indptr[owner][of] + place - 1, max(len(families.neighbours) - 1, 0))
    members = np.where(place == 0, owner[of], families.neighbours[bond] if len(families.neighbours) else 0)
    members = members.astype(np.int32)
    fit = _fit(cloud, x, area, owner, ptr, members)
    first = np.linalg.inv(fit.moments)[:, :, 0]
    return ptr, members, fit.weight * (fit.phi * first[of]).sum(axis=1)


class _Fit(NamedTuple):
    """Store weighted fits of linear functions around facets.

    The functions are 1 and the coordinates along principal axes (n_facets, dim, dim), in columns, over the unit of
    length of each entry (n_entries, 1), or 0 along axes without extent. ``phi`` holds their values (n_entries, dim +
    1), ``weight`` the weights (n_entries,), and ``moments`` (n_facets, dim + 1, dim + 1) are regular.
    """

    phi: Float
    weight: Float
    moments: Float
    axes: Float
    unit: Float


def _fit(cloud: Cloud, x: Float, area: Float, owner: GlobalIndex, ptr: GlobalIndex, members: LocalIndex) -> _Fit:
    dim, of = cloud.dim, row_of_entries(ptr)
    apart = cloud.x[members] - x[of]
    # The unit of distance is that of the particle behind the facet, half a spacing.
    unit = np.linalg.norm(apart[ptr[:-1]], axis=1)[of, None]
    reach = cloud.local_horizon[owner][of, None]
    unit = np.where(unit > SHORT * reach, unit, 0.25 * reach)
    apart = apart / unit
    # Without extent of the family in a direction (a line or a plane of particles) there is no slope. Facets beside it
    # are interpolated as if they lay in it, which keeps the sum of a load but not its moment.
    on_face = _on_face(cloud, area, members, of, ptr, apart * unit)
    axes, spread = _extent(cloud, members, of, ptr, unit, on_face)
    # A warped facet may have its own particle in its plane, and no others.
    alone = spread.sum(axis=1) < dim - 1
    if alone.any():
        on_face[alone[of]] = 1.0
        axes, spread = _extent(cloud, members, of, ptr, unit, on_face)
    along = np.einsum("ei,eij->ej", apart, axes[of]) * spread[of]
    phi = np.concatenate([np.ones((len(of), 1)), along], axis=1)
    weight = (1.0 + 0.25 * (apart**2).sum(axis=1)) ** -4 * on_face
    moments = _moments(phi, weight, of, len(x))
    moments[:, 1:, 1:] += np.einsum("fi,ij->fij", 1.0 - spread, np.eye(dim))
    return _Fit(phi, weight, moments, axes, unit)


def _moments(phi: Float, weight: Float, of: GlobalIndex, count: int) -> Float:
    """Return ``sum_e weight_e phi_e (x) phi_e`` over the entries of each of ``count`` facets or families."""
    size = phi.shape[1]
    moments = np.empty((count, size, size))
    for a in range(size):
        for b in range(size):
            moments[:, a, b] = np.bincount(of, weight * phi[:, a] * phi[:, b], count)
    return moments


def _on_face(cloud: Cloud, area: Float, members: LocalIndex, of: GlobalIndex, ptr: GlobalIndex, apart: Float) -> Float:
    """Return 1 for the particles from which a facet is interpolated, 0 for others (n_entries,).

    If the particle behind the facet lies on it, as nodes of a mesh do, these are the particles in its plane. A force on
    the facet then acts on the boundary only, and entirely on supports if these hold the boundary.
    """
    normal = area / np.maximum(np.linalg.norm(area, axis=1), np.finfo(float).tiny)[:, None]
    behind = members[ptr[:-1]]
    off = np.abs(np.einsum("ei,ei->e", apart, normal[of])) > NEAR_FACET * cloud.local_horizon[behind][of]
    return np.where(off & ~off[ptr[:-1]][of], 0.0, 1.0)


def _extent(
    cloud: Cloud, members: LocalIndex, of: GlobalIndex, ptr: GlobalIndex, unit: Float, taken: Float
) -> tuple[Float, Float]:
    """Return principal axes (n, dim, dim) of the particles of each facet, in columns, and 1 for axes with extent.

    The second array is (n, dim), 0 for axes without extent.
    """
    n = len(ptr) - 1
    around = (cloud.x[members] - cloud.x[members[ptr[:-1]][of]]) / unit
    size, axes = np.linalg.eigh(_moments(around, taken, of, n))
    return axes, np.where(size > FLAT * np.maximum(size[:, -1:], np.finfo(float).tiny), 1.0, 0.0)
