"""Distributed particle cloud: owners, ghosts, numbering."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from pdpetsc.arrays import Float, GlobalIndex, Mask
from pdpetsc.declare.cell import Cell
from pdpetsc.declare.symmetry import Symmetry
from pdpetsc.discrete.communicator import Comm, exchange, fetch, largest, offset, owners, smallest, total
from pdpetsc.discrete.halo import Halo
from pdpetsc.discrete.partition import bisect
from pdpetsc.discrete.periodic import Images, refuse_outside, shifts
from pdpetsc.discrete.places import Places, refuse_beyond
from pdpetsc.errors import CaseError

# Bonds of exactly the length of the horizon belong to the family, for any rounding of the positions.
HORIZON_TOLERANCE = 1e-9
# Particles closer than this share of the horizon coincide.
COINCIDENT = 1e-6
# Neighbours are searched together for particles whose horizons differ by less than this factor.
ALIKE = 1.25
# If the mean distance of consecutive particles exceeds this number of horizons, neighbours are far apart in memory.
FAR = 4.0


@dataclass(frozen=True)
class Cloud:
    """Store the particles of this rank: owned ones first, then ghosts with a bond to an owned one.

    In a periodic cell and next to mirror planes, images are also ghosts, including images of own particles.

    Attributes
    ----------
    comm : Comm
        All ranks.
    x : (n_local, dim) float64
        Reference positions [length]; of an image its own position.
    volume : (n_local,) float64
        Volumes [length^dim times thickness].
    gid : (n_local,) int64
        Global ids in the order of creation; results on disk have this order on any number of ranks.
    row : (n_local,) int64
        Global number in the matrix: contiguous per rank.
    sets : mapping of str to (n_local,) bool
        Named sets.
    horizon : float
        Radius of the largest families [length].
    least_horizon : float
        Radius of the smallest families [length].
    local_horizon : (n_local,) float64
        Radius of the family of each particle [length].
    mutual : bool
        Whether a bond exists, from both ends, if either end reaches the other. Otherwise a particle has bonds to all
        particles that it reaches. If horizons differ, these may have no bond to it.
    n_owned, n_global, first : int
        Number of own particles, number of all particles, and row of the first own one.
    halo : Halo
        Exchange between owners and ghosts.
    images : Images or None
        The periodic cell.
    offset : (n_ghost, dim) float64
        Whole periods between each ghost and its particle, or the mirror image of its particle [length]; no rows without
        a cell.
    sign : (n_ghost, dim) float64
        Factors that transform vector components of a particle to those of its ghost: -1 along the normals of the mirror
        planes that the ghost is behind, else 1. No rows without mirror planes.
    place : (n_local,) int64
        Number of the place of each particle: 0 at home, and for all particles without images. It is not a position or a
        rank.
    places : Places
        Meaning of the numbers.
    n_created : int
        Number of particles that this rank created.
    spread : (dim, dim) float64
        Second moment of the volume of the body about its centre, over its volume [length^2], for the particles of all
        ranks and their mirror images. Zero along periodic directions, in which a body has no end.
    body : (n_local,) int64 or None
        Number of the body of each particle; None for one body. Particles of different bodies have no bond.
    stands_for : (n_owned,) float64 or None
        Number of particles that each own particle represents, if it represents others with the same family; None for 1
        each.
    """

    comm: Comm
    x: Float
    volume: Float
    gid: GlobalIndex
    row: GlobalIndex
    sets: Mapping[str, Mask]
    horizon: float
    least_horizon: float
    local_horizon: Float
    mutual: bool
    n_owned: int
    n_global: int
    first: int
    halo: Halo
    images: Images | None
    offset: Float
    sign: Float
    place: GlobalIndex
    places: Places
    n_created: int
    spread: Float
    body: GlobalIndex | None = None
    stands_for: Float | None = None

    def counted(self, numbers: NDArray[Any]) -> int:
        """Sum numbers of the own particles (n_owned,) over all ranks, weighted with the particles that they represent.

        Notes
        -----
        Collective.
        """
        return int(total(self.comm, float(numbers.sum() if self.stands_for is None else numbers @ self.stands_for)))

    def mirror(self, values: Float) -> None:
        """Turn the ghost rows of vectors (n_local, dim) or tensors (n_local, dim, dim) to the axes of their images."""
        if len(self.sign):
            values[self.n_owned :] *= self.sign if values.ndim == 2 else self.sign[:, :, None] * self.sign[:, None, :]

    @property
    def varies(self) -> bool:
        """Return True if the horizon differs between particles of any rank (not collective)."""
        return self.least_horizon < self.horizon

    @property
    def order(self) -> GlobalIndex:
        """Return the sort key of families, equal on any number of ranks: by global id, images by their place."""
        return np.asarray(self.gid * self.places.n + self.place + self.places.home)

    @property
    def n_virtual(self) -> int:
        """Return the number of virtual rows that this rank holds: those of the strain of a periodic cell."""
        return self.images.n_rows if self.images is not None and self.images.here else 0

    @property
    def n_rows(self) -> int:
        """Return the number of rows of unknowns that this rank holds: own particles, then virtual ones."""
        return self.n_owned + self.n_virtual

    @property
    def n_virtual_global(self) -> int:
        """Return the number of virtual rows of the whole problem; they are the last ones."""
        return 0 if self.images is None else self.images.n_rows

    @property
    def dim(self) -> int:
        """Return the number of coordinates."""
        return int(self.x.shape[1])

    @property
    def n_local(self) -> int:
        """Return the number of owned and ghost particles."""
        return len(self.x)

    @property
    def n_ghost(self) -> int:
        """Return the number of ghosts."""
        return self.n_local - self.n_owned


def distribute(
    comm: Comm, x: Float, volume: Float, sets: Mapping[str, Mask], horizon: float | Float, cell: Cell | None = None,
    planes: Sequence[Symmetry] = (), mutual: bool = False, together: Float | None = None,
    body: GlobalIndex | None = None, beyond: float | Float = 0.0,
) -> Cloud:  # fmt: skip
    """Partition particles over the ranks, number them and create the ghosts of every rank.

    Parameters
    ----------
    x, volume, sets
        Particles that this rank created. The parts in rank order form the whole in creation order.
    horizon : float, or (n,) float64
        Radius of the families [length]: one value, or one for each particle that this rank created.
    cell : Cell, optional
        The periodic cell that holds the particles.
    planes : sequence of Symmetry
        Mirror planes, of different axes that are not periodic.
    mutual : bool
        Whether bonds exist if either end reaches the other, as in ``Cloud``.
    together : (n, dim) float64, optional
        Positions for the partition, equal for particles that must be on one rank; by default their own positions.
    body : (n,) int64, optional
        Number of the body of each particle that this rank created.
    beyond : float, or (n,) float64
        Ghosts are also the particles that are further than a horizon from own particles by at most this length: one
        value, or one for each particle that this rank created [length].

    Returns
    -------
    Cloud

    Raises
    ------
    CaseError
        There are fewer particles than ranks, particles outside the cell, or particles on both sides of a mirror plane.

    Notes
    -----
    Collective.
    """
    dim = x.shape[1]
    names = sorted({name for part in comm.allgather(sorted(sets)) for name in part})
    flags = (
        np.array([sets.get(name, np.zeros(len(x), bool)) for name in names], dtype=np.uint8)
        .reshape(len(names), len(x))
        .T
    )
    gid = offset(comm, len(x)) + np.arange(len(x), dtype=np.int64)
    n_created, n_global = len(x), int(total(comm, len(x)))
    if n_global < comm.size:
        raise CaseError(f"The case has {n_global} particles for {comm.size} ranks; run it on at most {n_global} ranks.")

    if cell is not None:
        refuse_outside(comm, cell, x)
    reach = np.array(np.broadcast_to(np.asarray(horizon, dtype=float), len(x)))
    refuse_beyond(comm, planes, x, reach)
    number_of = np.zeros(len(x), dtype=np.int64) if body is None else body
    further = np.array(np.broadcast_to(np.asarray(beyond, dtype=float), len(x)))
    part = bisect(comm, x if together is None else together)
    arrays, _ = exchange(comm, part, [x, gid, reach, volume, np.ascontiguousarray(flags), number_of, further])
    order = _near_in_memory(*arrays[:3])
    x, gid, reach, volume, flags, number_of, further = (array[order] for array in arrays)
    widest, least = largest(comm, reach, initial=0.0), smallest(comm, reach)
    n_owned = len(x)
    first = offset(comm, n_owned)
    row = first + np.arange(n_owned, dtype=np.int64)

    periods = [np.zeros(dim)]
    if cell is not None:
        periods = [n * cell.lengths for n in shifts(cell, widest * (1.0 + HORIZON_TOLERANCE))]
    places = Places.of(dim, planes, periods)
    wide = reach + further
    ghosts, counts = _candidates(comm, x, wide, [volume, gid, row, flags, number_of, reach], places, mutual)
    near = _within(x, wide, ghosts[0], ghosts[1], mutual)
    owner = np.repeat(np.arange(comm.size, dtype=np.int32), counts)[near]
    positions, _, volumes, gids, rows, other_flags, their_body, reaches, number = (array[near] for array in ghosts)
    firsts = np.array(comm.allgather(first), dtype=np.int64)
    halo = Halo(comm, n_owned, owner, (rows - firsts[owner]).astype(np.int32))
    flags = np.concatenate([flags, other_flags]).astype(bool)
    return Cloud(
        comm=comm,
        x=np.concatenate([x, positions]).reshape(-1, dim),
        volume=np.concatenate([volume, volumes]),
        gid=np.concatenate([gid, gids]),
        row=np.concatenate([row, rows]),
        sets={name: np.ascontiguousarray(flags[:, n]) for n, name in enumerate(names)},
        horizon=widest,
        least_horizon=least,
        local_horizon=np.concatenate([reach, reaches]),
        mutual=mutual,
        n_owned=n_owned,
        n_global=n_global,
        first=first,
        halo=halo,
        images=None if cell is None else Images(comm, cell),
        offset=places.period[number] if cell is not None else np.empty((0, dim)),
        sign=places.sign[number] if planes else np.empty((0, dim)),
        place=np.concatenate([np.zeros(n_owned, dtype=np.int64), number - places.home]),
        places=places,
        n_created=n_created,
        spread=_spread(comm, x, volume, cell, planes),
        body=None if body is None else np.concatenate([number_of, their_body]),
    )


def _spread(comm: Comm, x: Float, volume: Float, cell: Cell | None, planes: Sequence[Symmetry]) -> Float:
    """Compute the second moment of the body about its centre from the own particles of all ranks (collective)."""
    sums = total(comm, np.append(volume @ x, volume.sum()))
    centre = sums[:-1] / sums[-1]
    for plane in planes:
        centre[plane.number] = plane.at
    away = x - centre
    moment: Float = total(comm, (volume[:, None] * away).T @ away) / sums[-1]
    for plane in planes:
        flip = np.ones(x.shape[1])
        flip[plane.number] = -1.0
        moment = 0.5 * (moment + flip[:, None] * moment * flip)
    for axis in [] if cell is None else cell.periodic:
        moment[axis] = moment[:, axis] = 0.0
    return moment


def from_parts(cloud: Cloud, part: NDArray[Any]) -> NDArray[Any]:
    """Return the rows of the own particles from the part that this rank created, in its order.

    Parameters
    ----------
    part : (n, ...)
        One row per particle of ``Particles.chunk(rank, size)``.

    Notes
    -----
    Collective.
    """
    creator, row = creators(cloud)
    return fetch(cloud.comm, creator, row, part)


def creators(cloud: Cloud) -> tuple[GlobalIndex, GlobalIndex]:
    """Return the rank that created each own particle (n_owned,), and the number of the particle on that rank.

    Notes
    -----
    Collective.
    """
    return owners(cloud.comm, offset(cloud.comm, cloud.n_created), cloud.gid[: cloud.n_owned])


def _near_in_memory(x: Float, gid: GlobalIndex, reach: Float) -> GlobalIndex:
    """Return the order of own particles: by creation, or by cells if that order jumps through the body.

    Loops over families read their members from memory. With random order they take up to twice the time.
    """
    order = np.argsort(gid)
    horizon = float(np.median(reach)) if len(x) else 1.0
    if len(x) < 2 or np.linalg.norm(np.diff(x[order], axis=0), axis=1).mean() <= FAR * horizon:
        return order
    sides = np.argsort(np.ptp(x, axis=0))
    cells = np.floor((x - x.min(axis=0)) / horizon).astype(np.int64)
    return np.asarray(np.lexsort((gid, *(cells[:, axis] for axis in sides))))


def _candidates(
    comm: Comm, x: Float, reach: Float, arrays: list[NDArray[Any]], places: Places, mutual: bool
) -> tuple[list[NDArray[Any]], GlobalIndex]:
    """Receive particles and images near the bounding box of this rank, within the largest reach of its particles.

    If bonds are mutual, also particles that reach into the box themselves. Return positions, reach, rows of ``arrays``
    and row of the place of each, and the number that each rank sent.
    """
    dim = x.shape[1]
    widest = reach.max(initial=0.0)
    box = np.concatenate([x.min(axis=0, initial=np.inf), x.max(axis=0, initial=-np.inf), [widest]])
    boxes = np.empty((comm.size, 2 * dim + 1))
    comm.Allgather(box, boxes)
    box = box[: 2 * dim]
    wide = 1.0 + HORIZON_TOLERANCE
    index, destination, number = [], [], []
    for n, (sign, shift) in enumerate(zip(places.sign, places.shift, strict=True)):
        one, other = sign * (boxes[:, :dim] - shift), sign * (boxes[:, dim:-1] - shift)
        low, high = np.minimum(one, other), np.maximum(one, other)
        near = wide * np.maximum(boxes[:, -1:], widest if mutual else 0.0)
        for rank in np.flatnonzero(np.all((low - near <= box[dim:]) & (high + near >= box[:dim]), axis=1)):
            if rank == comm.rank and n == places.home:
                continue
            far = wide * np.maximum(boxes[rank, -1], reach[:, None] if mutual else 0.0)
            index.append(np.flatnonzero(np.all((x >= low[rank] - far) & (x <= high[rank] + far), axis=1)))
            destination.append(np.full(len(index[-1]), rank, dtype=np.int32))
            number.append(np.full(len(index[-1]), n, dtype=np.int64))
    chosen = np.concatenate([np.empty(0, dtype=np.int64), *index])
    rank_of = np.concatenate([np.empty(0, dtype=np.int32), *destination])
    number_of = np.concatenate([np.empty(0, dtype=np.int64), *number])
    image = places.sign[number_of] * x[chosen] + places.shift[number_of]
    return exchange(comm, rank_of, [image, reach[chosen], *(array[chosen] for array in arrays), number_of])


def _within(x: Float, reach: Float, candidates: Float, their_reach: Float, mutual: bool) -> Mask:
    """Return which candidates a particle at ``x`` reaches, or with mutual bonds is reached by."""
    near = np.zeros(len(candidates), dtype=bool)
    if len(x) == 0 or len(candidates) == 0:
        return near
    wide = 1.0 + 2.0 * HORIZON_TOLERANCE
    there = scipy.spatial.cKDTree(candidates)
    for members in by_reach(reach):
        here, radius = scipy.spatial.cKDTree(x[members]), wide * float(reach[members].max())
        if reach[members].min() == reach[members].max():
            distance, _ = here.query(candidates, distance_upper_bound=radius)
            near |= np.isfinite(distance)
            continue
        pairs = here.sparse_distance_matrix(there, radius, output_type="ndarray")
        near[pairs["j"][pairs["v"] <= wide * reach[members[pairs["i"]]]]] = True
    if mutual:
        distance, _ = scipy.spatial.cKDTree(x).query(candidates, distance_upper_bound=wide * their_reach.max())
        near |= distance <= wide * their_reach
    return near


def by_reach(reach: Float) -> list[GlobalIndex]:
    """Group particles by similar reach; neighbours of a group are searched together."""
    if len(reach) == 0:
        return []
    group = np.floor(np.log(reach / reach.min()) / np.log(ALIKE)).astype(np.int64)
    return [np.flatnonzero(group == number) for number in np.unique(group)]
