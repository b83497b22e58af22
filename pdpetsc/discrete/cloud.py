"""The distributed particle cloud: owners, ghosts, numbering."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from pdpetsc.arrays import Float, GlobalIndex, Mask
from pdpetsc.discrete.communicator import Comm, exchange, offset, total
from pdpetsc.discrete.halo import Halo
from pdpetsc.discrete.partition import bisect
from pdpetsc.errors import CaseError

# Bonds exactly as long as the horizon belong to the family whatever the rounding of the positions.
HORIZON_TOLERANCE = 1e-9
COINCIDENT = 1e-6


@dataclass(frozen=True)
class Cloud:
    """Particles of this rank, owned ones first, then the ghosts within one horizon of an owned one.

    Attributes
    ----------
    comm : Comm
        All ranks.
    x : (n_local, dim) float64
        Reference positions [length].
    volume : (n_local,) float64
        Volumes [length^dim times thickness].
    gid : (n_local,) int64
        Global ids in the order of creation; results on disk are in this order on any rank count.
    row : (n_local,) int64
        Global number in the matrix: contiguous per rank.
    sets : mapping of str to (n_local,) bool
        Named sets.
    horizon : float
        [length].
    n_owned, n_global, first : int
        Own particles, all particles, and the row of the first own one.
    halo : Halo
        Exchange between owners and ghosts.
    """

    comm: Comm
    x: Float
    volume: Float
    gid: GlobalIndex
    row: GlobalIndex
    sets: Mapping[str, Mask]
    horizon: float
    n_owned: int
    n_global: int
    first: int
    halo: Halo

    @property
    def dim(self) -> int:
        """Return the number of coordinates."""
        return int(self.x.shape[1])

    @property
    def n_local(self) -> int:
        """Return owned and ghost particles together."""
        return len(self.x)

    @property
    def n_ghost(self) -> int:
        """Return the number of ghosts."""
        return self.n_local - self.n_owned


def distribute(comm: Comm, x: Float, volume: Float, sets: Mapping[str, Mask], horizon: float) -> Cloud:
    """Partition particles over the ranks, number them and give every rank its ghosts.

    Parameters
    ----------
    x, volume, sets
        The part of the particles that this rank created; parts in rank order make the whole in creation order.
    horizon : float
        [length].

    Returns
    -------
    Cloud

    Raises
    ------
    CaseError
        Fewer particles than ranks.

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
    n_global = int(total(comm, len(x)))
    if n_global < comm.size:
        raise CaseError(f"The case has {n_global} particles for {comm.size} ranks; run it on at most {n_global} ranks.")

    (x, volume, gid, flags), _ = exchange(comm, bisect(comm, x), [x, volume, gid, np.ascontiguousarray(flags)])
    order = np.argsort(gid)
    x, volume, gid, flags = x[order], volume[order], gid[order], flags[order]
    n_owned = len(x)
    first = offset(comm, n_owned)
    row = first + np.arange(n_owned, dtype=np.int64)

    ghosts, counts = _candidates(comm, x, [x, volume, gid, row, flags], horizon)
    near = _within(x, ghosts[0], horizon)
    owner = np.repeat(np.arange(comm.size, dtype=np.int32), counts)[near]
    ghosts = [array[near] for array in ghosts]
    firsts = np.array(comm.allgather(first), dtype=np.int64)
    halo = Halo(comm, n_owned, owner, (ghosts[3] - firsts[owner]).astype(np.int32))
    flags = np.concatenate([flags, ghosts[4]]).astype(bool)
    return Cloud(
        comm=comm,
        x=np.concatenate([x, ghosts[0]]).reshape(-1, dim),
        volume=np.concatenate([volume, ghosts[1]]),
        gid=np.concatenate([gid, ghosts[2]]),
        row=np.concatenate([row, ghosts[3]]),
        sets={name: np.ascontiguousarray(flags[:, n]) for n, name in enumerate(names)},
        horizon=horizon,
        n_owned=n_owned,
        n_global=n_global,
        first=first,
        halo=halo,
    )


def _candidates(
    comm: Comm, x: Float, arrays: list[NDArray[Any]], horizon: float
) -> tuple[list[NDArray[Any]], GlobalIndex]:
    """Receive the particles of other ranks that lie in this rank's bounding box widened by one horizon."""
    dim = x.shape[1]
    box = np.concatenate([x.min(axis=0, initial=np.inf), x.max(axis=0, initial=-np.inf)])
    boxes = np.empty((comm.size, 2 * dim))
    comm.Allgather(box, boxes)
    reach = horizon * (1.0 + HORIZON_TOLERANCE)
    destination = []
    chosen = []
    overlap = np.all((boxes[:, :dim] - reach <= box[dim:]) & (boxes[:, dim:] + reach >= box[:dim]), axis=1)
    for rank in np.flatnonzero(overlap):
        if rank == comm.rank:
            continue
        inside = np.all((x >= boxes[rank, :dim] - reach) & (x <= boxes[rank, dim:] + reach), axis=1)
        chosen.append(np.flatnonzero(inside))
        destination.append(np.full(len(chosen[-1]), rank, dtype=np.int32))
    index = np.concatenate(chosen) if chosen else np.empty(0, dtype=np.int64)
    rank_of = np.concatenate(destination) if destination else np.empty(0, dtype=np.int32)
    return exchange(comm, rank_of, [array[index] for array in arrays])


def _within(x: Float, candidates: Float, horizon: float) -> Mask:
    if len(x) == 0 or len(candidates) == 0:
        return np.zeros(len(candidates), dtype=bool)
    distance, _ = cKDTree(x).query(candidates, distance_upper_bound=horizon * (1.0 + 2.0 * HORIZON_TOLERANCE))
    return np.asarray(np.isfinite(distance))
