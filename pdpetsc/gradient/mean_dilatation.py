"""Deformation gradients that share one dilatation in patches of particles."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex
from pdpetsc.declared import NonNegative, Positive
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.communicator import Comm, bounds, largest
from pdpetsc.discrete.families import Families
from pdpetsc.errors import CaseError
from pdpetsc.gradient.base import GradientOperator, Patches, Scheme

# Start of the first patch, in patches before the first particle, so that no particle of a lattice lies on a border.
BEFORE = 0.25


@dataclass(frozen=True)
class MeanDilatation(Scheme):
    """Use one dilatation for all gradient points of a patch, for nearly incompressible bodies.

    An incompressible body preserves its volume at every gradient point. Schemes with many points have more such
    conditions than displacements and lock. Here each patch, a box of a grid with edges ``patch``, has one condition.
    ``<.>`` is the mean over the points of a patch, weighted with the quadrature volumes W. The material is evaluated at
    ``F_bar`` instead of F, in the energy too, so that forces and tangent derive from one energy::

        theta = ln det F,   F_bar = exp((<theta> - theta) / dim) F
        E = sum_p W_p (psi(F_bar_p) + share mu (<theta> - theta_p)^2)
        P = s P_bar + (<r> - r) F^-T,   s = exp((<theta> - theta) / dim)
        r = P_bar : F_bar / dim + 2 share mu (<theta> - theta)

    For linear materials ``theta = tr F - dim`` and ``F_bar = F + (<theta> - theta) / dim I``. The second part of the
    energy resists deviations from the mean dilatation, which otherwise have no stiffness. Uniform states have
    ``F_bar = F``. The pressure is nearly constant in a patch, so its error decreases with the edge. With an edge of two
    spacings there is one condition per eight displacements in 2D, per 24 in 3D.

    Patches do not depend on the number of ranks. Their boxes lie along the axes of ``SubHorizons``, which rotate with
    the body, and end at mirror planes. The particles of a box belong to separate patches if they have different
    materials, or if the moduli of a graded material jump between them by a factor of 1.5 or more. Pieces of a box that
    no bonds inside the box connect, as on both sides of a crack, are separate patches too. Around a crack tip bonds of
    the box still connect both sides, and these share their dilatation.

    Controls are scaled with the bulk modulus by default; use ``ByShear``. A wall carries the pressure only if it holds
    particles on the surface itself, with conforming weights, or layers two horizons deep. Otherwise the stress is far
    too low, and the run warns.

    Parameters
    ----------
    scheme : Scheme
        Scheme of the gradient points and weights.
    patch : float
        Edge of a patch [length], positive; use two spacings.
    share : float
        Stiffness against deviations from the mean dilatation, over twice the shear modulus [-], not negative.

    Raises
    ------
    CaseError
        A number is out of range, or ``scheme`` has patches already. When built: the body is a bar, is in plane stress,
        or has bonds that fail.

    References
    ----------
    deSouzaNeto2005, who average det F over patches of elements; the energy is that of this package.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> dx = 0.5
    >>> scheme = pd.MeanDilatation(pd.SubHorizons(), patch=2.0 * dx)
    """

    scheme: Scheme
    patch: Positive
    share: NonNegative = 0.5

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.scheme.patches is not None:
            raise CaseError(f"{type(self.scheme).__name__} has patches already; give MeanDilatation another scheme.")

    def of_unit_spacing(self) -> Scheme:
        """Return the scheme with patches of two spacings."""
        return replace(self, scheme=self.scheme.of_unit_spacing(), patch=2.0)

    @property
    def patches(self) -> Patches:
        """Return the patches of gradient points that share a dilatation."""
        return Patches(self.patch, self.share)

    def memory(self, dim: int, family: float) -> float:
        """Return the memory of the scheme."""
        return self.scheme.memory(dim, family)

    def build(self, cloud: Cloud, families: Families, omega: Float) -> GradientOperator:
        """Build the operator of the scheme (collective)."""
        return self.scheme.build(cloud, families, omega)


def boxes(comm: Comm, x: Float, edge: float) -> GlobalIndex:
    """Return the box of a grid that contains each particle, as its numbers along the axes (n, dim).

    Parameters
    ----------
    x : (n, dim) float64
        Positions of particles of this rank, along the axes of the grid [length]. The grid begins at the smallest of all
        ranks.
    edge : float
        Edge of a box [length].

    Raises
    ------
    CaseError
        An axis has more boxes than can be numbered, on every rank.

    Notes
    -----
    Collective.
    """
    low, _ = bounds(comm, x)
    at = np.floor((x - low) / edge + BEFORE)
    most = largest(comm, at, initial=0.0)
    if not most < 2.0**31:
        raise CaseError(f"Patches with edges of {edge:g} are {most:.3g} along an axis; take patches of two spacings.")
    found: GlobalIndex = at.astype(np.int64)
    return found
