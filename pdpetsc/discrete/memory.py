"""Predicted memory of a body, compared with the free memory of the machines before allocation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from mpi4py import MPI

from pdpetsc.arrays import Float
from pdpetsc.declare.cell import Cell
from pdpetsc.declare.symmetry import Symmetry
from pdpetsc.discrete.communicator import Comm, agreed, largest, total
from pdpetsc.discrete.places import Places
from pdpetsc.errors import CaseError

# Minimum memory of a particle until it is assigned to a rank, and of a bond until families are found [bytes].
PER_PARTICLE, PER_BOND = 140.0, 24.0
# Minimum memory of an image until ghosts are found [bytes].
PER_IMAGE = 200.0
# Sample size for counting families.
SAMPLE = 32
# Largest number of images of a periodic cell, which are searched one after another.
MOST_IMAGES = 100_000
# Files of Linux with limit and use of memory of the control group of the process, in both versions.
_GROUPS = (
    ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory.current", "/sys/fs/cgroup/memory.stat"),
    (
        "/sys/fs/cgroup/memory/memory.limit_in_bytes",
        "/sys/fs/cgroup/memory/memory.usage_in_bytes",
        "/sys/fs/cgroup/memory/memory.stat",
    ),
)


def free_memory() -> float:
    """Return the free memory of this machine or job [bytes]; infinity if unknown."""
    free = math.inf
    try:
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                free = 1024.0 * float(line.split()[1])
    except (OSError, ValueError):
        pass
    for most, taken, listed in _GROUPS:
        try:
            limit, used = float(Path(most).read_text()), float(Path(taken).read_text())
            caches = [line.split()[1] for line in Path(listed).read_text().splitlines() if "inactive_file" in line]
            free = min(free, limit - used + float(max(caches, key=float, default="0")))
        except (OSError, ValueError):
            continue
    return free


def refuse_beyond_memory(comm: Comm, needed: float, what: str) -> None:
    """Raise on all ranks if the ranks of a machine need more memory than it has free.

    Parameters
    ----------
    needed : float
        Memory that this rank needs [bytes].
    what : str
        Purpose of the memory, for the message.

    Raises
    ------
    CaseError
        A machine has too little memory.

    Notes
    -----
    Collective.
    """
    here = comm.Split_type(MPI.COMM_TYPE_SHARED)
    together, free = here.allreduce(float(needed)), here.allreduce(free_memory(), op=MPI.MIN)
    here.Free()
    with agreed(comm):
        if together > free:
            raise CaseError(
                f"{what} takes at least {together / 2**30:.3g} GiB on a machine that has {free / 2**30:.3g} GiB free; "
                f"take fewer particles, a smaller horizon or more machines."
            )


def predicted_bonds(
    comm: Comm, x: Float, horizon: float | Float, cell: Cell | None = None, planes: Sequence[Symmetry] = ()
) -> float:
    """Estimate the number of bonds of a body from a sample of its particles.

    If the horizon is longer than half a period, the estimate is the content of a ball at the mean density of the cell.

    Parameters
    ----------
    x : (n, dim) float64
        Positions of the particles that this rank holds [length].
    horizon : float, or (n,) float64
        Radius of the families [length]: one value, or one for each of these particles.
    cell : Cell, optional
        The periodic cell.
    planes : sequence of Symmetry
        Mirror planes.

    Raises
    ------
    CaseError
        The families would reach over too many images of the cell.

    Notes
    -----
    Collective.
    """
    n_global = int(total(comm, len(x)))
    reach = np.broadcast_to(np.asarray(horizon, dtype=float), len(x))
    widest = largest(comm, reach, initial=0.0)
    lengths, periods = _periods(x.shape[1], widest, cell)
    images = math.prod(2.0 * math.ceil(min(p, 1e15)) + 1.0 for p in periods)
    with agreed(comm):
        if images > MOST_IMAGES:
            raise CaseError(
                f"The horizon {widest:g} reaches over {images:.3g} images of the periodic cell, more than "
                f"{MOST_IMAGES}; take a smaller one."
            )
    each = -(-SAMPLE // comm.size)
    rows = np.linspace(0, len(x) - 1, min(each, len(x))).astype(np.int64)
    sample = np.concatenate(comm.allgather(x[rows]))
    radius = np.concatenate(comm.allgather(reach[rows]))
    wide = bool((periods > 0.5).any())
    found = np.zeros(len(sample))
    inside = [plane for plane in planes if plane.number < x.shape[1]]
    mirrors = Places.of(x.shape[1], inside, [np.zeros(x.shape[1])])
    for k, centre in enumerate(sample):
        for sign, shift in zip(mirrors.sign, mirrors.shift, strict=True):
            apart = x - (sign * centre + shift)
            if wide:
                apart = apart[:, lengths == 0.0]
            else:
                for axis in np.flatnonzero(lengths > 0.0):
                    apart[:, axis] -= lengths[axis] * np.round(apart[:, axis] / lengths[axis])
            found[k] += np.count_nonzero(np.linalg.norm(apart, axis=1) <= radius[k])
    found = total(comm, found)
    if wide:
        ball = {1: 1.0, 2: math.pi / 4.0, 3: math.pi / 6.0}[x.shape[1]]
        found = (
            found
            * ball
            * math.prod(2.0 * p for p in periods if p > 0.0)
            * (radius / widest) ** np.count_nonzero(periods)
        )
    family = float(found.mean()) if len(sample) else 0.0
    return n_global * max(family - 1.0, 0.0)


def predicted_images(comm: Comm, x: Float, widest: float, cell: Cell | None = None) -> float:
    """Estimate the number of periodic images that all ranks together receive in the search of ghosts.

    A rank of ``size`` that holds an equal part of the cell receives ``n (prod(size^(-1/k) + 2 p) - 1 / size)``. ``p``
    is the horizon over the period along each of ``k`` periodic axes.

    Parameters
    ----------
    x : (n, dim) float64
        Positions of the particles that this rank holds [length].
    widest : float
        Radius of the largest families [length].
    cell : Cell, optional
        The periodic cell.

    Notes
    -----
    Collective.
    """
    _, periods = _periods(x.shape[1], widest, cell)
    along = periods[periods > 0.0]
    if not len(along):
        return 0.0
    share = comm.size ** (-1.0 / len(along))
    return float(total(comm, float(len(x))) * (comm.size * np.prod(share + 2.0 * along) - 1.0))


def _periods(dim: int, widest: float, cell: Cell | None) -> tuple[Float, Float]:
    """Return the periods of a cell (dim,) [length], 0 along other axes, and the ratio of the horizon to each."""
    lengths = np.zeros(dim) if cell is None or cell.dim != dim else cell.lengths
    return lengths, np.where(lengths > 0.0, widest / np.where(lengths > 0.0, lengths, 1.0), 0.0)
