"""Facets of a surface on which a term acts."""

from __future__ import annotations

import numpy as np

from pdpetsc.arrays import Float, Mask, entries_of, row_of_entries
from pdpetsc.discrete.surface import Surface
from pdpetsc.gradient.base import StencilMembers
from pdpetsc.kernels.sparsity import sum_by


class ChosenFacets:
    """Store facets of a surface, in the order of their owners, with the particles that they are interpolated from.

    Parameters
    ----------
    surface : Surface
        The surface.
    mask : (n_surface,) bool
        The facets.

    Attributes
    ----------
    x, area : (n_facets, dim) float64
        Centroids [length] and outward vector areas [area].
    stencils : StencilMembers
        Their particles.
    N : (n_entries,) float64
        Weights of the particles [-].
    of : (n_entries,) int64
        Facet of each entry.
    entry : (n_entries,) int64
        Entry of the surface of each entry.
    """

    def __init__(self, surface: Surface, mask: Mask) -> None:
        at = np.flatnonzero(mask)
        at = at[np.argsort(surface.owner[at], kind="stable")]
        self.x, self.area = surface.x[at], surface.area[at]
        self.entry, ptr = entries_of(surface.ptr, at)
        self.stencils = StencilMembers(surface.owner[at].astype(np.int32), ptr, surface.members[self.entry])
        self.N, self.of = surface.N[self.entry], row_of_entries(ptr)

    def sums(self, values: Float) -> Float:
        """Return the sums over the entries of each facet (n_facets, ...) of values (n_entries, ...)."""
        return np.asarray(sum_by(self.of, values, len(self.x)))

    def spread(self, force: Float, f: Float) -> None:
        """Subtract forces on the facets (n_facets, dim) from a residual of local particles (n_local, dim)."""
        np.add.at(f, self.stencils.members, -self.N[:, None] * force[self.of])
