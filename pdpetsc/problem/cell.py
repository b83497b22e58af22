"""The virtual unknowns of a periodic cell: what mean strain and mean stress are in terms of them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdpetsc.arrays import Float
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.communicator import total


class CellRows:
    """Virtual unknowns of a periodic cell on this rank.

    Parameters
    ----------
    cloud : Cloud
        Particles of a body with a cell.
    thickness : float
        Of a plane body, or cross-section of a line [length or area].

    Attributes
    ----------
    volume : float
        What the mean stress is per: the volume of the cell, or that of the particles where some direction is not
        periodic [volume].

    Notes
    -----
    Construction and ``mean_stress`` are collective.
    """

    def __init__(self, cloud: Cloud, thickness: float) -> None:
        assert cloud.images is not None
        self.images = cloud.images
        self._n_owned = cloud.n_owned
        cell = self.images.cell
        if len(cell.periodic) < cell.dim:
            self.volume = float(total(cloud.comm, cloud.volume[: cloud.n_owned].sum()))
        else:
            self.volume = float(np.prod(cell.lengths)) * (thickness if cell.dim < 3 else 1.0)

    @property
    def components(self) -> list[tuple[int, int]]:
        """Return the components that the cell has, as pairs of directions."""
        return list(self.images.cell.components)

    @property
    def here(self) -> bool:
        """Return whether this rank holds the virtual unknowns."""
        return self.images.here

    @property
    def sizes(self) -> Float:
        """Return the virtual unknown per unit mean strain of each component [length]."""
        return self.images.sizes

    @property
    def per_stress(self) -> Float:
        """Return the force on each virtual unknown per unit mean stress [area]."""
        twice = np.array([1.0 if a == b else 2.0 for a, b in self.components])
        return np.asarray(self.volume * twice / self.sizes)

    def rows(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return a view of the virtual entries of an array of unknowns (n_rows, dim), flat."""
        return values[self._n_owned :].reshape(-1)

    def mean_stress(self, forces: Float) -> Float:
        """Return the components of mean stress (n_components,) from the forces on the unknowns (n_rows, dim)."""
        count = len(self.sizes)
        held = self.rows(forces)[:count] if self.here else np.zeros(count)
        return np.asarray(total(self.images.comm, held) / self.per_stress)
