"""Images of cracks in a periodic cell and behind mirror planes."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pdpetsc.arrays import Float, Mask
from pdpetsc.declare.cell import Cell
from pdpetsc.declare.cracks import Crack, PlaneCrack
from pdpetsc.declare.symmetry import Symmetry
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.places import Places
from pdpetsc.errors import CaseError

# Tolerance of distances from the sides of a cell, as a share of the period.
NEAR_SIDE = 1e-6


@dataclass(frozen=True)
class CrackImages(Crack):
    """A crack with its images: the image of a point ``x`` of the crack is ``sign * x + shift``.

    Attributes
    ----------
    crack : Crack
        The declared crack.
    sign, shift : (n_images, dim) float64
        -1 along the axes of the mirror planes that an image is behind, else 1, and translation [length]. The crack
        itself is one of them if it reaches the particles.
    """

    crack: Crack
    sign: Float
    shift: Float

    def cuts(self, a: Float, b: Float) -> Mask:
        """Return True for bonds that cross the crack or one of its images."""
        found = np.zeros(len(a), dtype=bool)
        for sign, shift in zip(self.sign, self.shift, strict=True):
            found |= self.crack.cuts(sign * (a - shift), sign * (b - shift))
        return found


def images_of_cloud(crack: Crack, cloud: Cloud) -> CrackImages:
    """Return a crack with the images that bonds of particles in the cell may cross (not collective)."""
    cell = None if cloud.images is None else cloud.images.cell
    return _images(crack, cloud.dim, cell, cloud.places.mirrors, cloud.horizon)


def images_of_case(
    cracks: Sequence[Crack], dim: int, cell: Cell | None, planes: Sequence[Symmetry]
) -> list[CrackImages]:
    """Return cracks with the images that lines between particles in the cell and their neighbours may cross."""
    mirrors = Places.of(dim, planes, [np.zeros(dim)]).mirrors
    reach = 0.0 if cell is None else float(cell.lengths.max())
    return [_images(crack, dim, cell, mirrors, reach) for crack in cracks]


def _images(crack: Crack, dim: int, cell: Cell | None, mirrors: tuple[Float, Float], reach: float) -> CrackImages:
    """Return a crack with its images within a distance from the cell."""
    periods = [np.zeros(dim)] if cell is None else _periods(crack, cell, reach)
    both = [(sign, to + away) for sign, to in zip(*mirrors, strict=True) for away in periods]
    return CrackImages(
        crack,
        np.array([sign for sign, _ in both]).reshape(-1, dim),
        np.array([shift for _, shift in both]).reshape(-1, dim),
    )


def _periods(crack: Crack, cell: Cell, reach: float) -> list[Float]:
    """Return the translations by whole periods that bring a crack into a cell or within a distance from it."""
    low, high = crack.box(cell.dim)
    numbers = []
    for axis, (start, length) in enumerate(zip(cell.origin, cell.lengths, strict=True)):
        if axis not in cell.periodic:
            numbers.append(range(1))
        elif np.isfinite(low[axis]) and np.isfinite(high[axis]):
            near = reach + NEAR_SIDE * length
            first, last = (start - near - high[axis]) / length, (start + length + near - low[axis]) / length
            numbers.append(range(int(np.ceil(first)), int(np.floor(last)) + 1))
        elif isinstance(crack, PlaneCrack) and crack.normal[axis] != 0.0:
            raise CaseError(
                f"{crack} is inclined to {'xyz'[axis]}, in which the cell is periodic, and would have images without "
                f"end. Use a Segment or PolygonCrack across the body."
            )
        else:
            most = max(1, int(np.ceil(reach / length)))
            numbers.append(range(-most, most + 1))
    return [np.array(n) * cell.lengths for n in itertools.product(*numbers)]
