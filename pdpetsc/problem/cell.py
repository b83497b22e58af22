"""Virtual unknowns of a periodic cell, which represent mean strain and mean stress."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdpetsc.arrays import Float
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.communicator import total


class CellRows:
    """Map the virtual unknowns of a periodic cell on this rank to mean strain and mean stress.

    Parameters
    ----------
    cloud : Cloud
        Particles of a body with a periodic cell.
    thickness : float
        Thickness of a plane body, or cross-section of a line [length or area].

    Attributes
    ----------
    volume : float
        Reference volume of the mean stress: the volume of the cell, or that of the particles if not all directions are
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
        """Return the strain components of the cell, as pairs of directions."""
        return list(self.images.cell.components)

    @property
    def here(self) -> bool:
        """Return True if this rank holds the virtual unknowns."""
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
