"""Selection of particles by regions."""

from __future__ import annotations

import numpy as np

from pdpetsc.arrays import Mask
from pdpetsc.declare.region import Region, View
from pdpetsc.declared import called
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.communicator import agreed, anywhere, smallest
from pdpetsc.errors import CaseError


def select(cloud: Cloud, region: Region, name: str) -> Mask:
    """Return which own particles a region selects; raise on all ranks if it selects none (collective).

    A region may fail on one rank only, and may request the minimum of a number over all parts. It is therefore
    evaluated first without communication, which records these numbers, and if there are any again with their minima.
    """
    comm, n = cloud.comm, cloud.n_owned
    x, sets = cloud.x[:n], {key: flags[:n] for key, flags in cloud.sets.items()}
    numbers: list[float] = []

    def record(number: float) -> float:
        numbers.append(number)
        return number

    with agreed(comm):
        mask = _mask(region, View(x, sets, record), name)
    counts = comm.allgather(len(numbers))
    if len(set(counts)) > 1:
        raise CaseError(f"The region of {name} asks for the smallest of a number on some ranks only: {region}.")
    if numbers:
        least = iter([smallest(comm, number) for number in numbers])
        with agreed(comm):
            mask = _mask(region, View(x, sets, lambda _: next(least)), name)
    if not anywhere(cloud.comm, mask):
        raise CaseError(f"The region of {name} selects no particle: {region}.")
    return mask


def _mask(region: Region, view: View, name: str) -> Mask:
    """Return the mask of a region, whose own errors become one sentence (not collective)."""
    mask = np.asarray(called(f"region of {name}", region.mask, view))
    if mask.shape != (len(view.x),) or mask.dtype != bool:
        raise CaseError(f"The region of {name} must give {(len(view.x),)} bool, not {mask.shape} {mask.dtype}.")
    return mask
