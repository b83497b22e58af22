"""Zero-energy control by springs along the relative displacement of the bonds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.control.base import Control, Stiffness, ZeroEnergyControl, relative_factor
from pdpetsc.control.non_uniform import NonUniform
from pdpetsc.declared import NonNegative
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.families import Families


@dataclass(frozen=True)
class RelativeSprings(ZeroEnergyControl):
    """Linear springs on all bonds, with a stiffness in proportion to that of the material.

    ``T_a = C kappa / (sum_j omega |xi|^2 V_j) omega eta`` with the factor of ``Silling``: ``C`` is a pure number,
    independent of units and spacing. Springs also resist affine deformation and rotation: a bar is stiffer by the
    factor ``1 + C`` in every uniform state, the patch test fails, and rotations must be small.

    Parameters
    ----------
    C : float
        Strength [-], not negative; about the relative error that the springs add.

    References
    ----------
    Breitenfeld2014; Luo2018, Eq. (7). The factor that makes ``C`` a pure number is of this package.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> pd.RelativeSprings(C=0.001)
    RelativeSprings(C=0.001)
    """

    C: NonNegative = 0.01

    def build(self, cloud: Cloud, families: Families, omega: Float, stiffness: Stiffness) -> Control:
        """Build the control (collective)."""
        return springs(cloud, families, omega, self.C * relative_factor(cloud, families, omega, stiffness))


@dataclass(frozen=True)
class Springs(ZeroEnergyControl):
    """Linear springs with one constant for the whole body, as published, ``T_a = C1 omega eta``.

    ``C1`` has a unit and its best value depends on the spacing and on the softest material. Use it to compare with
    papers; ``RelativeSprings`` is independent of units. The constants of Luo2018, Table 1, are for sums without the
    volume of the neighbours: in a bar of unit cross-section they are ``C1 / dx`` here.

    Parameters
    ----------
    C1 : float
        Spring constant [force / length^7; force / length^3 for a bar], not negative.

    References
    ----------
    Breitenfeld2014; Luo2018, Eq. (7) and Table 1.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> dx = 0.002
    >>> pd.Springs(C1=2.0 / dx)
    Springs(C1=1000.0)
    """

    C1: NonNegative

    def build(self, cloud: Cloud, families: Families, omega: Float, stiffness: Stiffness) -> Control:
        """Build the control (collective)."""
        return springs(cloud, families, omega, np.full(cloud.n_owned, self.C1))


def springs(cloud: Cloud, families: Families, omega: Float, c: Float) -> Control:
    """Return springs with ``c_i`` (n_owned,) [force / length^7] of the centre of each bond (not collective)."""
    s = c[families.centres] * omega * cloud.volume[families.centres] * cloud.volume[families.neighbours]
    return NonUniform(cloud, families, s, np.zeros((cloud.n_owned, cloud.dim, cloud.dim)))
