"""Connected pieces of the body, and the rigid motions that its supports do not resist."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.communicator import anywhere, total
from pdpetsc.discrete.families import Families, with_pairs
from pdpetsc.errors import CaseError

# A rigid motion is free if the supports resist it by less than this share of the most resisted one.
RANK_TOLERANCE = 1e-12
# Components of a free motion below this number are round-off.
FREE = 1e-5


def find_pieces(cloud: Cloud, families: Families, joined: LocalIndex | None = None) -> GlobalIndex:
    """Return the smallest global id in the piece of each own particle, (n_owned,).

    ``joined`` (n, 2) are pairs of local particles that belong together besides those with a bond.

    Notes
    -----
    Collective.
    """
    bonds = families.connecting
    if joined is not None:
        bonds, _ = with_pairs(bonds, np.empty(0, dtype=bool), joined)
    graph = scipy.sparse.coo_matrix(
        (np.ones(bonds.n_bonds, dtype=np.int8), (bonds.centres, bonds.neighbours)), shape=(cloud.n_local,) * 2
    )
    _, group = scipy.sparse.csgraph.connected_components(graph, directed=False)
    return np.asarray(least_labels(cloud, group)[: cloud.n_owned])


def least_labels(cloud: Cloud, group: LocalIndex) -> GlobalIndex:
    """Return the smallest global id of the particles that are connected to each local particle on any rank (n_local,).

    ``group`` (n_local,) are numbers below n_local, equal for particles that are connected on this rank.

    Notes
    -----
    Collective; the number of exchanges is at most the number of rank boundaries that connected particles cross.
    """
    label = cloud.gid.copy()
    while True:
        least = np.full(cloud.n_local, np.iinfo(np.int64).max)
        np.minimum.at(least, group, label)
        new = least[group]
        # If horizons differ, the owner of a ghost may have no information on its bond here.
        each = np.ones(cloud.n_ghost, dtype=np.int64)
        back = cloud.halo.reverse_rows(new[cloud.n_owned :], each, np.ones(len(cloud.halo.send_index), dtype=np.int64))
        np.minimum.at(new, cloud.halo.send_index, back)
        cloud.halo.forward(new)
        changed = np.any(new != label)
        label = new
        if not anywhere(cloud.comm, changed):
            return label


def refuse_rigid_motion(
    cloud: Cloud, families: Families, resisted: Callable[[Float], Float], joined: LocalIndex | None = None
) -> None:
    """Raise on all ranks if a piece of the body can move rigidly.

    Parameters
    ----------
    joined : (n, 2) int32
        As for ``find_pieces``.
    resisted : callable
        Computes what resists displacements (n_owned, dim) at each own particle (n_owned, parts), 0 where nothing does
        (collective). A mirror plane holds the pieces that it crosses: they cannot move along its normal or rotate it.

    Raises
    ------
    CaseError
        A piece has a free rigid motion.

    Notes
    -----
    Collective.
    """
    pieces = find_pieces(cloud, families, joined)
    modes = rigid_modes(cloud)
    labels, index = np.unique(pieces, return_inverse=True)
    n_modes = modes.shape[2]
    held = np.stack([resisted(mode) for mode in np.moveaxis(modes, 2, 0)], axis=2)
    gram = np.zeros((len(labels), n_modes, n_modes))
    np.add.at(gram, index, np.einsum("nia,nib->nab", held, held))
    bonds = families.connecting
    across = np.flatnonzero(cloud.places.behind(cloud.place[bonds.neighbours]))
    across_mirrors = _torn_by_mirrors(cloud, bonds.neighbours[across])
    np.add.at(gram, index[bonds.centres[across]], np.einsum("nia,nib->nab", across_mirrors, across_mirrors))
    sums: dict[int, Float] = {}
    for part in cloud.comm.allgather(dict(zip(labels.tolist(), gram, strict=True))):
        for piece, matrix in part.items():
            sums[piece] = sums.get(piece, 0.0) + matrix
    free = {}
    for piece, matrix in sums.items():
        values, vectors = np.linalg.eigh(matrix)
        rank = int(np.count_nonzero(values > RANK_TOLERANCE * max(float(values[-1]), 1e-300)))
        if rank < n_modes:
            free[piece] = vectors[:, : n_modes - rank]
    if free:
        piece = min(free)
        missing, motions = free[piece].shape[1], _words_of(free[piece], cloud)
        where = "The body" if len(sums) == 1 else f"The piece with particle {piece} ({len(free)} of {len(sums)} pieces)"
        raise CaseError(
            f"{where} is left with {missing} of {n_modes} rigid motions: {motions}. Prescribe more displacement "
            "components; contact does not count as a support."
        )


def _words_of(free: Float, cloud: Cloud) -> str:
    """Return the names of free rigid motions, orthonormal columns (modes, n) in the order of ``rigid_at``."""
    dim = cloud.dim
    axes = ["xyz"[3 - sum(plane)] for plane in _planes(cloud)]
    _, sizes, combined = np.linalg.svd(free[dim:])
    turning = int(np.count_nonzero(sizes > FREE))
    kinds = (
        ("translation in", "xyz", free[:dim] @ combined[turning:].T),
        ("rotation about", axes, free[dim:] @ combined[:turning].T),
    )
    words = []
    for kind, letters, motions in kinds:
        if motions.shape[1]:
            span, _, _ = np.linalg.svd(motions, full_matrices=False)
            shares = np.linalg.norm(span, axis=1)
            along = [axis for axis, share in zip(letters, shares, strict=False) if share > 1.0 - FREE]
            # Otherwise the motions are inclined to the axes, as on a roller that is.
            named = sorted(along) if len(along) == span.shape[1] else ["an inclined axis"]
            words.append(f"{kind} {', '.join(named)}")
    return " and ".join(words)


def _planes(cloud: Cloud) -> list[tuple[int, int]]:
    """Return the pairs of axes in which the body can rotate."""
    periodic = [] if cloud.images is None else cloud.images.cell.periodic
    planes = [(0, 1), (1, 2), (2, 0)][: {1: 0, 2: 1, 3: 3}[cloud.dim]]
    return [plane for plane in planes if not set(plane) & set(periodic)]


def rigid_modes(cloud: Cloud) -> Float:
    """Compute the rigid motions of the own particles about the centre (n_owned, dim, modes), with scaled lengths.

    A rotation that moves a periodic direction is omitted.

    Notes
    -----
    Collective.
    """
    return rigid_at(cloud, cloud.x[: cloud.n_owned])


def _torn_by_mirrors(cloud: Cloud, images: LocalIndex) -> Float:
    """Compute the deviation of images of rigidly moving particles from the same motion (n, dim, modes) (collective)."""
    place = cloud.place[images]
    moved = rigid_at(cloud, cloud.places.at_home(place, cloud.x[images]))
    sign = cloud.places.sign[place + cloud.places.home]
    return np.asarray(sign[:, :, None] * moved - rigid_at(cloud, cloud.x[images]))


def rigid_at(cloud: Cloud, points: Float) -> Float:
    """Compute the rigid motions of all ranks together at points (n, dim) (collective)."""
    x = cloud.x[: cloud.n_owned]
    n, dim = points.shape
    centre = total(cloud.comm, x.sum(axis=0)) / cloud.n_global
    size = float(np.sqrt(total(cloud.comm, ((x - centre) ** 2).sum()) / cloud.n_global)) or 1.0
    r = (points - centre) / size
    planes = _planes(cloud)
    modes = np.zeros((n, dim, dim + len(planes)))
    for d in range(dim):
        modes[:, d, d] = 1.0
    for m, (a, b) in enumerate(planes):
        modes[:, a, dim + m] = -r[:, b]
        modes[:, b, dim + m] = r[:, a]
    return modes
