"""Zero-energy control whose stiffness decreases with the tangent of a yielding material."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pdpetsc.arrays import Float, LocalIndex
from pdpetsc.control.base import Control, Stiffness, ZeroEnergyControl
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.families import Families
from pdpetsc.errors import CaseError
from pdpetsc.gradient.base import StencilMembers

# A point is elastic if its share differs from 1 by less.
ROUND = 1e-9


@dataclass(frozen=True)
class TangentScaled(ZeroEnergyControl):
    """A zero-energy control whose stiffness decreases with that of the material at each particle.

    A control with the elastic stiffness is too stiff for a yielding body: its forces grow with the non-uniform
    deformation, those of the material do not. Here the control of a particle yields with the material. Let W be the
    energy of the control of a family. ``e = sqrt(2 W)``, with the elastic energy, measures the deformation that the
    control resists. Its force is ``q = dW/de``, for an elastic control ``q = e``. In a load step ``e_0`` is the largest
    ``e`` of earlier steps, ``c_0`` the ratio ``q / e`` there, and ``c_t`` the ratio of tangent to elastic modulus of
    the material at the last equilibrium::

        q = c_0 e                          e <= e_0
        q = c_0 e_0 + c_t (e - e_0)        e > e_0,       f = (q / e) f_elastic

    ``c_t`` is the smallest ``d : A : d / d : A_0 : d`` over all strains d, averaged over the points of the particle. A
    are the moduli of the Jaumann rate of Kirchhoff stress in the frame of the material, A_0 those at F = I. In J2
    plasticity of a solid it is ``H / (3 mu + H)``. It lies between ``least`` and ``c_0`` and is constant during a load
    step.

    Properties:

    - The force is continuous from step to step and preserves the equilibrium: only the slope for further loading
      changes between steps.
    - It derives from an energy, so its tangent is exact, symmetric and positive. The energy includes the dissipation
      ``(q de - e dq) / 2 >= 0``.
    - The forces rotate with the body as those of the elastic control do.
    - Unloading follows the secant ``c_0`` to e = 0, not the elastic stiffness. In the step in which a point begins to
      flow the control is still elastic.

    A force of the present modulus times the whole ``e`` would jump at the onset of flow and release energy on
    unloading. A sum of increments as vectors would not rotate with the body.

    If bonds have a degradation factor, it multiplies the control too, according to the evolution of the damage law.
    Particles of elastic materials have the elastic control; if all materials are elastic, ``control`` is used.

    Parameters
    ----------
    control : ZeroEnergyControl
        The elastic control.
    least : float
        Smallest ratio of its stiffness to the elastic one [-], positive, at most 1.

    Raises
    ------
    CaseError
        ``least`` is out of range, or ``control`` is tangent-scaled already.

    References
    ----------
    Silling2017, section 5, for controls with one modulus; the scaling with the tangent is that of this package.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> pd.TangentScaled(pd.Silling(0.5))
    TangentScaled(control=Silling(G=0.5), least=0.01)
    """

    control: ZeroEnergyControl
    least: float = 0.01

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (math.isfinite(self.least) and 0.0 < self.least <= 1.0):
            raise CaseError(f"Following keeps a share 0 < least <= 1 of the stiffness, not {self.least}.")
        if self.control.least_share is not None:
            raise CaseError(f"{type(self.control).__name__} follows the material already; give Following another one.")

    @property
    def elastic(self) -> ZeroEnergyControl:
        return self.control

    @property
    def least_share(self) -> float:
        """Return ``least``."""
        return self.least

    def sees(self, stiffness: Stiffness) -> Stiffness:
        """Return the stiffness for the elastic control."""
        return self.control.sees(stiffness)

    def build(self, cloud: Cloud, families: Families, omega: Float, stiffness: Stiffness) -> Control:
        """Build the elastic control (collective)."""
        return self.control.build(cloud, families, omega, stiffness)


@dataclass
class Yielding:
    """History variables of the controls of families.

    Attributes
    ----------
    kept : (n, 4) float64
        For each family ``c_0`` [-], ``e_0`` [energy^(1/2)], the slope ``c_t`` for further loading [-] and the energy
        lost so far [energy]; overwritten in place.
    """

    kept: Float

    @classmethod
    def unloaded(cls, n: int) -> Yielding:
        """Return the history variables of ``n`` families with elastic controls."""
        return cls(np.tile([1.0, 0.0, 1.0, 0.0], (n, 1)))

    def secant(self, e: Float) -> Float:
        """Return ``q / e`` (n,) [-]."""
        c, largest, slope, _ = self.kept.T
        return np.asarray(np.where(e > largest, slope + (c - slope) * self._ratio(e), c))

    def bend(self, e: Float) -> Float:
        """Return ``(dq/de - q / e) / e^2`` (n,) [1 / energy], not positive: the tangent minus the secant part."""
        c, largest, slope, _ = self.kept.T
        grown = e > largest
        return np.divide((slope - c) * self._ratio(e), e**2, out=np.zeros_like(e), where=grown)

    def energy(self, e: Float) -> Float:
        """Return the energy including the dissipated one (n,) [energy]."""
        c, largest, slope, lost = self.kept.T
        more = np.maximum(e - largest, 0.0)
        return np.asarray(lost + 0.5 * c * np.minimum(e, largest) ** 2 + more * (c * largest + 0.5 * slope * more))

    def commit(self, e: Float, share: Float) -> None:
        """Commit ``e``; the slope for further loading is ``share``, tangent over elastic modulus of the material."""
        secant, energy = self.secant(e), self.energy(e)
        self.kept[:, 3] = np.maximum(energy - 0.5 * secant * e**2, self.kept[:, 3])
        self.kept[:, 0] = secant
        self.kept[:, 1] = np.maximum(e, self.kept[:, 1])
        self.kept[:, 2] = np.minimum(share, secant)

    def _ratio(self, e: Float) -> Float:
        largest = self.kept[:, 1]
        return np.divide(largest, e, out=np.zeros_like(e), where=e > largest)


@dataclass(frozen=True)
class YieldingFamilies:
    """Yielding families of an elastic control, for gradient points that fail.

    Attributes
    ----------
    control : Control
        The elastic control.
    yielding : Yielding
        The history variables of the families.
    """

    control: Control
    yielding: Yielding

    def families_at(self, particles: LocalIndex) -> StencilMembers:
        """Return the families of selected own particles, with the centre first."""
        return self.control.families_at(particles)

    def forces_at(self, u: Float, particles: LocalIndex) -> Float:
        """Return ``(q / e) f_elastic`` on the members of the families of selected own particles (n_entries, dim)."""
        forces, size = self.control.forces_at(u, particles), np.diff(self.families_at(particles).point_ptr)
        return np.asarray(forces * np.repeat(self.yielding.secant(self._size(u))[particles], size)[:, None])

    def family_energy(self, u: Float) -> Float:
        """Return the energy of the families including the dissipated one (n_owned,) [energy]."""
        return self.yielding.energy(self._size(u))

    def _size(self, u: Float) -> Float:
        """Return ``e`` (n_owned,) [energy^(1/2)]."""
        return np.asarray(np.sqrt(np.maximum(2.0 * self.control.family_energy(u), 0.0)))


def tangent_share(F: Float, P: Float, A: Float, A_0: Float) -> Float:
    """Return the smallest ``d : D : d / d : A_0 : d`` over all strains d (n,) [-]: tangent over elastic modulus.

    D are the moduli of the Jaumann rate of the Kirchhoff stress in the frame of the material. At a point that does not
    flow they are A_0 for any rotation and stress, up to terms of the elastic strain.

    Parameters
    ----------
    F, P : (n, dim, dim) float64
        Deformation gradients [-] and first Piola-Kirchhoff stresses [stress].
    A : (n, dim, dim, dim, dim) float64
        Tangents ``dP/dF`` [stress].
    A_0 : (dim, dim, dim, dim) or (n, dim, dim, dim, dim) float64
        Tangent at F = I [stress].
    """
    dim, one = F.shape[-1], np.eye(F.shape[-1])
    left, _, right = np.linalg.svd(F)
    R = left @ right
    U = np.einsum("pai,paj->pij", R, F)
    tau = np.einsum("pai,pab,pjb->pij", R, P, U)
    D = np.einsum("pai,pamcn,pck,pjm,pln->pijkl", R, A, R, U, U, optimize=True)
    # From the convected rate to the Jaumann rate, minus the terms of the rotating stress.
    D += 0.5 * (
        -np.einsum("ik,pjl->pijkl", one, tau) + np.einsum("jk,pil->pijkl", one, tau)
        + np.einsum("il,pjk->pijkl", one, tau) + np.einsum("jl,pik->pijkl", one, tau)
    )  # fmt: skip
    pairs = [(i, j) for i in range(dim) for j in range(i, dim)]
    basis = np.zeros((len(pairs), dim, dim))
    for number, (i, j) in enumerate(pairs):
        basis[number, i, j] = basis[number, j, i] = 1.0 if i == j else math.sqrt(0.5)
    found = np.einsum("aij,pijkl,bkl->pab", basis, D, basis, optimize=True)
    rest = np.einsum("aij,pijkl,bkl->pab", basis, A_0.reshape(-1, *(dim,) * 4), basis)
    lower = np.linalg.inv(np.linalg.cholesky(rest))
    found = lower @ (0.5 * (found + np.swapaxes(found, 1, 2))) @ np.swapaxes(lower, 1, 2)
    share: Float = np.linalg.eigvalsh(found)[:, 0]
    return np.where(np.abs(share - 1.0) < ROUND, 1.0, share)
