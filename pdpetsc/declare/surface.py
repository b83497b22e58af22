"""The surface of a body as facets, for the divergence theorem and for loads on faces."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from pdpetsc.arrays import Float, GlobalIndex, Mask
from pdpetsc.declared import Declared, real_numbers, shown
from pdpetsc.errors import CaseError

# Vector areas may differ from those of the corners by this share of them: parts of warped facets do.
AREAS = 0.25


@dataclass(frozen=True)
class Facets(Declared):
    """Flat facets of the surface of a body, each a face of the cell of one particle.

    Parameters
    ----------
    x : (n, dim) array_like
        Centroids [length].
    area : (n, dim) array_like
        Outward vector areas [area; length times thickness in the plane, the cross-section on a line].
    particle : (n,) array_like of int
        The particle of each facet, whose cell it bounds, in the order of creation.
    tags : mapping of str to (n,) bool
        Names of parts of the surface, for loads.
    corners : (n, 4, 3) array_like, optional
        Corners of the facets of a solid body in turn [length]; the last one of a triangle twice. Contact between bodies
        requires them.

    Examples
    --------
    A bar of two particles between 0 and 2 with a cross-section of 3:

    >>> import pdpetsc as pd
    >>> ends = pd.Facets(x=[[0.0], [2.0]], area=[[-3.0], [3.0]], particle=[0, 1], tags={"right": [False, True]})
    >>> bar = pd.Arrays([[0.5], [1.5]], 3.0, thickness=3.0, facets=ends)
    """

    x: ArrayLike
    area: ArrayLike
    particle: ArrayLike
    tags: Mapping[str, ArrayLike] = field(default_factory=dict)
    corners: ArrayLike | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        x, area = real_numbers(self.x), real_numbers(self.area)
        if x is None or area is None or x.ndim != 2 or x.shape != area.shape or not 1 <= x.shape[1] <= 3:
            raise CaseError(
                f"Facets take centroids and vector areas of the same shape, (n, 1), (n, 2) or (n, 3), not "
                f"{np.shape(self.x)} and {np.shape(self.area)}."
            )
        if not (np.isfinite(x).all() and np.isfinite(area).all()):
            raise CaseError("Facets have centroids or vector areas that are not finite.")
        particle = np.asarray(self.particle)
        if particle.shape != (len(x),) or not (np.issubdtype(particle.dtype, np.integer) or len(x) == 0):
            raise CaseError(f"Facets take the number of one particle each, ({len(x)},), not {shown(self.particle)}.")
        if particle.size and particle.min() < 0:
            raise CaseError(f"Facets have a particle number {particle.min()}.")
        if self.corners is not None:
            corners = real_numbers(self.corners)
            if corners is None or corners.shape != (len(x), 4, 3):
                raise CaseError(f"The corners of Facets are ({len(x)}, 4, 3), not {np.shape(self.corners)}.")
            turn = 0.5 * np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
            off = np.minimum(np.abs(turn - area).max(axis=1), np.abs(turn + area).max(axis=1))
            if not (off <= AREAS * np.linalg.norm(area, axis=1)).all():
                raise CaseError("Facets have corners with other vector areas than declared; give them in turn.")
        for name, flags in self.tags.items():
            found = np.asarray(flags)
            if found.dtype != bool or found.shape != (len(x),):
                raise CaseError(f"Tag {name!r} of Facets is ({len(x)},) bool, not {shown(flags)}.")

    @property
    def arrays(self) -> tuple[Float, Float, GlobalIndex, dict[str, Mask]]:
        """Return centroids, vector areas, particles and tags as arrays."""
        return (
            np.asarray(self.x, dtype=float),
            np.asarray(self.area, dtype=float),
            np.asarray(self.particle, dtype=np.int64),
            {name: np.asarray(flags, dtype=bool) for name, flags in self.tags.items()},
        )

    def of_particles(self, first: int, last: int) -> Facets:
        """Return the facets of the particles ``first`` to ``last - 1``, with particles counted from ``first``."""
        x, area, particle, tags = self.arrays
        mine = (particle >= first) & (particle < last)
        tags = {name: flags[mine] for name, flags in tags.items()}
        corners = None if self.corners is None else np.asarray(self.corners)[mine]
        return Facets(x[mine], area[mine], particle[mine] - first, tags, corners)
