"""Zero-energy control by averaged displacement states."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdpetsc.arrays import Float, LocalIndex
from pdpetsc.control.base import (
    Control,
    ControlMatrix,
    Stencil,
    Stiffness,
    ZeroEnergyControl,
    isotropic,
    relative_factor,
)
from pdpetsc.declared import NonNegative
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.families import Families
from pdpetsc.discrete.sparsity import Sparsity
from pdpetsc.gradient.base import whole_families
from pdpetsc.kernels.assembly import assemble_kernel
from pdpetsc.kernels.control import average_force_kernel


@dataclass(frozen=True)
class RelativeAverage(ZeroEnergyControl):
    """Averaged displacement states with a stiffness in proportion to that of the material.

    ``T_a = C kappa / (sum_j omega |xi|^2 V_j sum_j omega V_j) omega a_i`` with ``a_i = sum_j omega eta_ij V_j``. ``C``
    is a pure number, independent of units and spacing. On whole families of a lattice ``a`` vanishes for affine
    displacements. In cut families it does not, and the patch test fails at free surfaces.

    Parameters
    ----------
    C : float
        Strength [-], not negative.

    References
    ----------
    Breitenfeld2014; Luo2018, Eq. (8). The factor that makes ``C`` a pure number is of this package.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> pd.RelativeAverage(C=0.2)
    RelativeAverage(C=0.2)
    """

    C: NonNegative = 0.1

    def build(self, cloud: Cloud, families: Families, omega: Float, stiffness: Stiffness) -> Control:
        """Build the control (collective)."""
        weight = omega * cloud.volume[families.neighbours]
        total = np.bincount(families.centres, weight, minlength=cloud.n_owned)
        c = self.C * relative_factor(cloud, families, omega, stiffness)
        np.divide(c, total, out=c, where=total > 0.0)
        return _Averaged(cloud, families, omega, c * cloud.volume[: cloud.n_owned])


@dataclass(frozen=True)
class AveragedDisplacement(ZeroEnergyControl):
    """Averaged displacement states with one constant for the whole body, as published, ``T_a = C2 omega a_i``.

    ``a_i = sum_j omega eta_ij V_j``. The factor omega, which Luo2018 leaves out, makes the force derive from the energy
    ``1/2 C2 sum_i V_i |a_i|^2``; with constant influence it makes no difference. ``C2`` has a unit and its best value
    depends on the spacing. Use it to compare with papers; ``RelativeAverage`` is independent of units. The constants of
    Luo2018, Table 1, are for an average without volumes: in a bar of unit cross-section they are ``C2 / dx`` here.

    Parameters
    ----------
    C2 : float
        Constant [force / length^10; force / length^4 for a bar], not negative.

    References
    ----------
    Breitenfeld2014; Luo2018, Eq. (8) and Table 1.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> pd.AveragedDisplacement(C2=1e3)
    AveragedDisplacement(C2=1000.0)
    """

    C2: NonNegative

    def build(self, cloud: Cloud, families: Families, omega: Float, stiffness: Stiffness) -> Control:
        """Build the control (collective)."""
        return _Averaged(cloud, families, omega, self.C2 * cloud.volume[: cloud.n_owned])


class _Averaged(Control):
    """Energy ``1/2 sum_i c_i |a_i|^2``."""

    def __init__(self, cloud: Cloud, families: Families, omega: Float, c: Float) -> None:
        stencils = whole_families(cloud, families, omega * cloud.volume[families.neighbours])
        self._cloud, self._families, self._omega = cloud, families, omega
        self._c = c
        self._stencils = stencils.point_ptr, stencils.members
        self._b = stencils.weight
        self._b[stencils.point_ptr[:-1]] = -np.add.reduceat(self._b, stencils.point_ptr[:-1])

    @property
    def stencils(self) -> Stencil:
        """Return the families with their centre first."""
        return self._stencils

    def force(self, u: Float, f: Float, particles: LocalIndex) -> float:
        """Add ``c_i a_i b_ik`` to every member ``k`` of ``i``; return the energy."""
        kernel = average_force_kernel(self._cloud.dim)
        return float(kernel(particles, *self._stencils, self._b, self._c, u, f))

    def scaled(self, share: Float) -> _Averaged:
        """Return the control with ``c_i`` times the share of ``i``."""
        return _Averaged(self._cloud, self._families, self._omega, self._c * share)

    def family_forces(self, u: Float) -> Float:
        """Return ``c_i a_i b_ik``."""
        ptr, members = self._stencils
        a = np.add.reduceat(self._b[:, None] * u[members], ptr[:-1], axis=0)
        return np.asarray(np.repeat(self._c[:, None] * a, np.diff(ptr), axis=0) * self._b[:, None])

    def matrix(self, sparsity: Sparsity) -> ControlMatrix:
        """Return the scalar matrix ``sum_i c_i b_ij b_ik`` (collective)."""
        data = self._b[:, None], self._b[:, None], self._c, np.ones((len(self._c), 1, 1, 1, 1))
        return isotropic(sparsity, assemble_kernel(1), self._stencils, *data)

    def add_point_blocks(self, blocks: Float) -> bool:
        """Add ``sum_i c_i b_ik^2`` times the identity to the blocks of local particles (n_local, dim, dim)."""
        ptr, members = self._stencils
        each = np.bincount(members, np.repeat(self._c, np.diff(ptr)) * self._b**2, self._cloud.n_local)
        blocks += each[:, None, None] * np.eye(self._cloud.dim)
        return True

    def damaged(self, phi: Float) -> Control:
        """Return the control whose averages weight every bond with its degradation factor."""
        return _Averaged(self._cloud, self._families, self._omega * phi, self._c)
