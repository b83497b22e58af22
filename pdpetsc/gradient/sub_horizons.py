"""Sub-horizons: one gradient point per sector of the family."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.families import Families
from pdpetsc.errors import CaseError
from pdpetsc.gradient.axes import body_axes
from pdpetsc.gradient.base import GradientOperator, Scheme
from pdpetsc.gradient.sectors import sector_operator

# A bond this close to a border, as a share of a sector or of the horizon, lies on it.
ON_BORDER = 1e-8
# A family has a few hundred bonds; each sector stores a row of shares of all of them.
MOST_SECTORS = 256


@dataclass(frozen=True)
class SubHorizons(Scheme):
    """Sub-horizons: a gradient point for each sector of the family.

    ``F_ia = I + sum_j chi_a omega V_j eta_ij (x) K_ia^-1 xi_ij`` with ``chi_a`` the share of the bond in sector ``a``.
    Sectors share a bond on their border in equal parts. The open sectors of Chowdhury2018 exclude it, but a lattice of
    nearest neighbours requires it. If the bonds of a sector are too flat for a gradient, they are added to the nearest
    sectors in equal parts. The sector then has no point, and the others share the volume.

    The sectors rotate with the body. Their axes are the edges of its lattice, or the principal axes of an irregular
    cloud; all particles share them. If the body has neither, such as an irregular disc with equal principal moments,
    the coordinate axes are used, and the log reports it. The x axis of the body is the axis nearest to the x axis of
    the coordinates. Multiples of four sectors in 2D and of eight in 3D do not depend on this choice. Other numbers of
    sectors rotate with the body by less than 45 degrees only.

    Parameters
    ----------
    sectors : int, optional
        Number of sectors; halves, quadrants and octants by default. In 1D an even number: shells of equal width on each
        side. In 2D at least 2: equal angles from the x axis of the body. In 3D an even number, at least 4: equal
        longitudes from that axis, above and below.

    References
    ----------
    Chowdhury2018, section 4, Eq. (19)-(34).

    Examples
    --------
    >>> import pdpetsc as pd
    >>> eight = pd.SubHorizons(sectors=8)
    >>> pd.SubHorizons().sectors is None  # halves, quadrants or octants
    True
    """

    of_family: ClassVar[bool] = True

    sectors: int | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.sectors is not None and not 2 <= self.sectors <= MOST_SECTORS:
            raise CaseError(f"Sub-horizons are between 2 and {MOST_SECTORS} sectors, not {self.sectors}.")

    def memory(self, dim: int, family: float) -> float:
        """Return the memory of the shares of a bond in all sectors [bytes]."""
        return 40.0 * (1 + (2**dim if self.sectors is None else self.sectors))

    def build(self, cloud: Cloud, families: Families, omega: Float) -> GradientOperator:
        """Build the operator (collective); raise CaseError if no sector of a family has a gradient."""
        xi = families.bonds(cloud.x)
        axes, note = body_axes(cloud, families, xi)
        xi = xi @ axes.T
        number = self.sectors if self.sectors is not None else 2**cloud.dim
        least, even = {1: (2, True), 2: (2, False), 3: (4, True)}[cloud.dim]
        if number < least or (even and number % 2):
            kind = "an even number of sectors" if even else "sectors"
            raise CaseError(f"Sub-horizons in {cloud.dim}D need {kind} from {least}, not {number}.")
        reach = cloud.local_horizon[families.centres]
        if cloud.dim == 1:
            shells = number // 2
            outward = _between(np.abs(xi[:, 0]) / reach * shells, shells)
            share = _product(_side(xi[:, 0], reach), outward)
            distance = _apart(2, shells, shells)
        elif cloud.dim == 2:
            share, distance = _around(xi, number), _apart(number, 1, 1)
        else:
            above = _side(xi[:, 2], reach)
            share, distance = _product(_around(xi, number // 2), above), _apart(number // 2, 2, 1)
        return sector_operator(cloud, families, omega, share, distance, "sub-horizons", note)


def _side(component: Float, reach: Float) -> Float:
    """Return the shares below and above zero, (n, 2)."""
    above = np.where(np.abs(component) < ON_BORDER * reach, 0.5, (component > 0.0).astype(float))
    return np.stack([1.0 - above, above], axis=1)


def _between(position: Float, count: int, periodic: bool = False) -> Float:
    """Return the shares of ``count`` unit intervals from 0 on, (n, count); half to each side on a border."""
    nearest = np.rint(position)
    on_border = np.abs(position - nearest) < ON_BORDER
    low = np.where(on_border, nearest - 1, np.floor(position)).astype(int)
    high = np.where(on_border, nearest, np.floor(position)).astype(int)
    share = np.zeros((len(position), count))
    for index in (low, high):
        inside = index % count if periodic else np.clip(index, 0, count - 1)
        np.add.at(share, (np.arange(len(position)), inside), 0.5)
    return share


def _around(xi: Float, count: int) -> Float:
    """Return the shares of ``count`` equal angles in the x-y plane, (n, count); equal shares on the z axis."""
    angle = np.arctan2(xi[:, 1], xi[:, 0]) % (2.0 * np.pi)
    share = _between(angle * count / (2.0 * np.pi), count, periodic=True)
    on_axis = np.hypot(xi[:, 0], xi[:, 1]) < ON_BORDER * np.linalg.norm(xi, axis=1)
    share[on_axis] = 1.0 / count
    return share


def _product(one: Float, other: Float) -> Float:
    """Return the shares in all pairs of a sector of one division and a sector of the other."""
    return np.asarray(np.einsum("ba,bc->bac", one, other).reshape(len(one), one.shape[1] * other.shape[1]))


def _apart(ring: int, layers: int, weight: int) -> Float:
    """Return the distances between sectors ``(place on a ring, layer)``; a step on the ring counts ``weight``."""
    place, layer = (index.ravel() for index in np.divmod(np.arange(ring * layers), layers))
    step = np.abs(place[:, None] - place[None])
    return np.asarray(weight * np.minimum(step, ring - step) + np.abs(layer[:, None] - layer[None]), dtype=float)
