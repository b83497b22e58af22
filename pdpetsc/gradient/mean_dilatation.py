"""Deformation gradients that share one dilatation in patches of particles."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.communicator import Comm, smallest
from pdpetsc.discrete.families import Families
from pdpetsc.errors import CaseError
from pdpetsc.gradient.base import GradientOperator, Patches, Scheme

# Where the first patch begins, in patches before the first particle: particles of a lattice do not lie on borders.
BEFORE = 0.25


@dataclass(frozen=True)
class MeanDilatation(Scheme):
    """A scheme whose gradients share one dilatation in each patch of particles, for nearly incompressible bodies.

    A body that keeps its volume must keep it at every gradient point, and schemes with many points have more such
    conditions than displacements: they lock. Here patches, the boxes of a grid with edges ``patch``, have one condition
    each. With the mean over the points of a patch ``<.>``, quadrature volumes W as weights, a material sees ``F_bar``
    in the place of F, in the energy as well, so that forces and tangent derive from one energy::

        theta = ln det F,   F_bar = exp((<theta> - theta) / dim) F
        E = sum_p W_p (psi(F_bar_p) + share mu (<theta> - theta_p)^2)
        P = s P_bar + (<r> - r) F^-T,   s = exp((<theta> - theta) / dim)
        r = P_bar : F_bar / dim + 2 share mu (<theta> - theta)

    for linear materials ``theta = tr F - dim`` and ``F_bar = F + (<theta> - theta) / dim I``. The second part of the
    energy is that of dilatations that the mean does not see: without it they meet no force. Uniform states have ``F_bar
    = F``. The pressure is nearly constant in a patch, so its error falls with the edge; an edge of two spacings leaves
    one condition to eight displacements in the plane, to 24 in space. Patches do not depend on the number of ranks.
    Their boxes lie along the axes of ``SubHorizons``, which turn with the body, and end at mirror planes. Particles of
    several materials in one box are in several patches, and so are those of a graded one between which moduli jump, by
    a quotient of 1.5 or more, and pieces of a box that no bonds inside it hold together, as on both sides of a crack.
    Around the tip of a crack, which bonds of the box still go around, both sides share their dilatation.

    A control is scaled with the bulk modulus unless it is told not to: take ``ByShear``. Walls hold the pressure where
    they hold particles on the surface itself, with conforming weights, or layers two horizons deep; else the stress is
    far too low, and the run says so.

    Parameters
    ----------
    scheme : Scheme
        Where gradients are evaluated, and with which weights.
    patch : float
        Edge of a patch [length], positive; two spacings.
    share : float
        Stiffness of dilatations that the mean does not see over twice the shear modulus [-], not negative.

    Raises
    ------
    CaseError
        A number is out of range, or ``scheme`` has patches already; when built, of a bar, of a body in plane stress
        or of one whose bonds fail.

    References
    ----------
    deSouzaNeto2005, who average det F over patches of elements; the energy is of this package.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> dx = 0.5
    >>> scheme = pd.MeanDilatation(pd.SubHorizons(), patch=2.0 * dx)
    """

    scheme: Scheme
    patch: float
    share: float = 0.5

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (math.isfinite(self.patch) and self.patch > 0.0):
            raise CaseError(f"MeanDilatation needs a positive edge of its patches, not {self.patch}.")
        if not (math.isfinite(self.share) and self.share >= 0.0):
            raise CaseError(f"MeanDilatation needs a share >= 0, not {self.share}.")
        if self.scheme.patches is not None:
            raise CaseError(f"{type(self.scheme).__name__} has patches already; give MeanDilatation another scheme.")

    def of_unit_spacing(self) -> Scheme:
        """Return it with patches of two spacings."""
        return replace(self, scheme=self.scheme.of_unit_spacing(), patch=2.0)

    @property
    def patches(self) -> Patches:
        """Return which gradient points share a dilatation."""
        return Patches(self.patch, self.share)

    def memory(self, dim: int, family: float) -> float:
        """Return that of the scheme."""
        return self.scheme.memory(dim, family)

    def build(self, cloud: Cloud, families: Families, omega: Float) -> GradientOperator:
        """Return the operator of the scheme (collective)."""
        return self.scheme.build(cloud, families, omega)


def boxes(comm: Comm, x: Float, edge: float) -> GlobalIndex:
    """Return in which box of a grid particles are, by the numbers of the box along the axes (n, dim).

    Parameters
    ----------
    x : (n, dim) float64
        Positions of particles that this rank holds, along the axes of the grid [length]; the grid begins at the least
        of all ranks.
    edge : float
        Edge of a box [length].

    Raises
    ------
    CaseError
        There are more boxes along an axis than can be numbered, on every rank.

    Notes
    -----
    Collective.
    """
    low = np.array([smallest(comm, x[:, axis].min(initial=np.inf)) for axis in range(x.shape[1])])
    at = np.floor((x - low) / edge + BEFORE)
    most = -smallest(comm, -float(at.max(initial=0.0)))
    if not most < 2.0**31:
        raise CaseError(f"Patches with edges of {edge:g} are {most:.3g} along an axis; take patches of two spacings.")
    found: GlobalIndex = at.astype(np.int64)
    return found
