"""Discrete body: particles, bonds, and the exchange of displacements and forces between ranks."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.families import Families
from pdpetsc.discrete.overlap import Overlap, start_displacements, start_forces
from pdpetsc.discrete.surface import Surface
from pdpetsc.gradient.base import Stencils, whole_families
from pdpetsc.kernels.bonds import elongation_kernel
from pdpetsc.material.thermal import Thermal
from pdpetsc.problem.expansion import StressFree


class Body:
    """Store the particles of this rank and their bonds.

    Unknowns ``u`` (n_rows, dim) are the displacements of the own particles. On the last rank they include the virtual
    rows of a periodic cell. Forces have the same rows. Arrays with ghosts have ``n_local`` rows.

    Parameters
    ----------
    cloud, families
        Particles of this rank and their bonds.
    surface : Surface, optional
        Facets of the surface, if a term needs them.
    thickness : float
        Thickness of a plane body; the volumes contain it [length].
    thermals : sequence of Thermal or None, optional
        Dependence of each material on temperature; None for a body that does not expand.

    Attributes
    ----------
    expansion : StressFree or None
        Stress-free deformation; None if there is none.
    """

    expansion: StressFree | None = None

    def __init__(
        self, cloud: Cloud, families: Families, surface: Surface | None = None, thickness: float = 1.0,
        thermals: Sequence[Thermal | None] | None = None,
    ) -> None:  # fmt: skip
        self.cloud = cloud
        self.families = families
        self.surface = surface
        self.thickness = thickness
        self.thermals = thermals

    @property
    def expands(self) -> bool:
        """Return True if the body may deform without stress."""
        return self.thermals is not None

    @property
    def known_surface(self) -> Surface:
        """Return the surface, for terms that need it."""
        assert self.surface is not None
        return self.surface

    @property
    def dim(self) -> int:
        """Return the dimension."""
        return self.cloud.dim

    @cached_property
    def overlap(self) -> Overlap:
        """Return the operator that hides the exchange of ghosts behind work on families."""
        return Overlap(self.cloud, self.families)

    @cached_property
    def with_centres(self) -> Stencils:
        """Return the families as stencils, centre first."""
        return whole_families(self.cloud, self.families, np.ones(len(self.families.neighbours)))

    def with_ghosts(self, u: Float) -> Float:
        """Return the displacements of all local particles (n_local, dim) (collective)."""
        u_local = np.empty((self.cloud.n_local, self.cloud.dim))
        start_displacements(self.cloud, u, u_local)()
        return u_local

    def gather(self, f: Float) -> Float:
        """Sum forces on local particles (n_local, dim), overwritten, to forces on the unknowns (n_rows, dim).

        Notes
        -----
        Collective.
        """
        return start_forces(self.cloud, f)()

    def elongated(self, u_local: Float, finite: bool) -> tuple[Float, float]:
        """Return the elongation of every bond (n_bonds,) [length] and the smallest current length of a bond [length].

        Parameters
        ----------
        u_local : (n_local, dim) float64
            Displacements with ghosts [length].
        finite : bool
            Whether an elongation is the change of the length of the bond, or the part of ``eta`` along its reference
        direction.
        """
        family, e = self.families, np.empty(len(self.families.neighbours))
        kernel = elongation_kernel(self.dim, int(finite))
        least = kernel(family.indptr, family.neighbours, self.cloud.x, u_local, e)
        return e, float(least)
