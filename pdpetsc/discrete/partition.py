"""Recursive coordinate bisection of a distributed cloud."""

from __future__ import annotations

import numpy as np

from pdpetsc.arrays import Float, LocalIndex, Mask
from pdpetsc.discrete.communicator import Comm, bounds, total

# Relative weight of the other coordinates in the sort key: it separates the ties of a lattice plane along the next
# axis.
TIE = 1e-6
# Bisections of the position of a cut; double precision resolves no more.
BISECTIONS = 60


def bisect(comm: Comm, x: Float) -> LocalIndex:
    """Assign every particle to one of ``comm.size`` parts of equal size by recursive coordinate bisection.

    Parameters
    ----------
    x : (n, dim) float64
        Positions [length] of the particles that this rank currently holds.

    Returns
    -------
    (n,) int32
        Part of each particle. The parts depend on the cloud only, not on its distribution before.

    Notes
    -----
    Collective; ``log2(size)`` levels, each with one vector reduction per bisection of the cut position.
    """
    part = np.zeros(len(x), dtype=np.int32)
    spans = [(0, comm.size)]
    while any(last - first > 1 for first, last in spans):
        open_spans = [span for span in spans if span[1] - span[0] > 1]
        keys = [_keys(comm, x, part == first) for first, _ in open_spans]
        middles = [(first + last) // 2 for first, last in open_spans]
        counts = total(comm, [len(key) for key in keys])
        wanted = [
            count * (middle - first) / (last - first)
            for count, middle, (first, last) in zip(counts, middles, open_spans, strict=True)
        ]
        cuts = _cuts(comm, keys, np.array(wanted))
        for key, cut, middle, (first, _) in zip(keys, cuts, middles, open_spans, strict=True):
            members = np.flatnonzero(part == first)
            part[members[key > cut]] = middle
        spans = [span for span in spans if span[1] - span[0] <= 1]
        for middle, (first, last) in zip(middles, open_spans, strict=True):
            spans += [(first, middle), (middle, last)]
    return part


def _keys(comm: Comm, x: Float, members: Mask) -> Float:
    """Compute the position in [0, 1] along the longest side of the bounding box; other sides separate ties."""
    chosen = x[members]
    low, high = bounds(comm, chosen)
    side = np.where(high > low, high - low, 1.0)
    scaled = (chosen - low) / side
    axes = np.argsort(-np.round((high - low) / max(float(np.max(high - low)), 1e-300), 6), kind="stable")
    key: Float = sum(scaled[:, axis] * TIE**rank for rank, axis in enumerate(axes))
    return key / (1.0 + 2.0 * TIE)


def _cuts(comm: Comm, keys: list[Float], wanted: Float) -> Float:
    low = np.full(len(keys), -1e-9)
    high = np.ones(len(keys))
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        below = total(comm, [np.count_nonzero(key <= cut) for key, cut in zip(keys, middle, strict=True)])
        enough = below >= wanted
        high = np.where(enough, middle, high)
        low = np.where(enough, low, middle)
    return high
