"""Elastic laws of a time step that conserves energy and angular momentum at finite deformation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex
from pdpetsc.material.base import HistoryKernels, Material

# Below this change of F^T F in a step the stress is that of the middle of the step; the difference is of second order.
SAME = 1e-6
# Below it the change of the energy is that of the stress at both ends and the middle by Simpson's rule, exact to
# round-off for smooth laws. Energies of order 1 have a round-off that ``1 / |dC|`` would carry into the stress.
NEAR = 1e-3


@dataclass(frozen=True)
class EnergyMomentum(Material):
    """An elastic law with the mean stress of a step, ``P_e = 2 F_m S_m - P(F_0)``, as the stress at its end.

    A generalised-alpha step of radius 1 takes the mean of the stresses at both ends, which is then ``F_m S_m`` with the
    mean ``F_m`` of F at both ends and

        ``S_m = S(C_m) + (2 (psi_1 - psi_0) - S(C_m) : dC) / |dC|^2 dC``, ``C_m = (C_0 + C_1) / 2``, ``dC = C_1 - C_0``.

    Its work is the change of the energy, and it is symmetric. Between two steps, and in a preload, the stress is that
    of the law. The history of a point is ``F_0`` of the last converged step, then the data of the law.

    Parameters
    ----------
    of : Material
        The elastic law.

    References
    ----------
    Gonzalez2000.
    """

    of: Material

    has_history: ClassVar[bool] = True

    @property
    def plane(self) -> Literal["strain", "stress"]:  # type: ignore[override]
        """Return the kind of plane body of the law."""
        return self.of.plane

    @property
    def may_fail(self) -> bool:  # type: ignore[override]
        """Return True if the law may have no stress."""
        return self.of.may_fail

    # The mean stress depends on both ends of a step.
    symmetric = False

    def history_kernels(self, dim: int) -> HistoryKernels:
        """Return the loops for dimension ``dim``."""
        law, size = self.of.history_kernels(dim), dim * dim

        def stress(F: Float, select: GlobalIndex, constants: Float, history: Float, P: Float) -> None:
            if constants[-1] == 0.0:
                law.stress(F, select, constants[:-1], history[:, size:], P)
                return
            step = _Step(law, constants[:-1], F[select], history, size)
            P[select] = 2.0 * step.F_m @ step.S_m - step.stress(step.F_0)

        def tangent(F: Float, select: GlobalIndex, constants: Float, history: Float, A: Float) -> None:
            if constants[-1] == 0.0:
                law.tangent(F, select, constants[:-1], history[:, size:], A)
                return
            step = _Step(law, constants[:-1], F[select], history, size)
            by_C = step.S_m_by_C()
            A[select] = np.einsum("ik,pnm->pimkn", np.eye(dim), step.S_m)
            A[select] += 4.0 * np.einsum("pia,pamnb,pkb->pimkn", step.F_m, by_C, step.F_1)

        def energy(F: Float, select: GlobalIndex, constants: Float, history: Float, psi: Float) -> None:
            law.energy(F, select, constants[:-1], history[:, size:], psi)

        def commit(F: Float, select: GlobalIndex, constants: Float, history: Float) -> None:
            history[:, :size] = F[select].reshape(-1, size)

        return HistoryKernels(stress, tangent, energy, commit)

    def constants(self, dim: int) -> Float:
        """Return those of the law, and the duration of the step."""
        return np.append(self.of.constants(dim), 0.0)

    reads_step = True

    def moduli(self, dim: int) -> Float:
        return self.of.moduli(dim)

    def young_modulus(self) -> float:
        return self.of.young_modulus()

    def bulk_like_modulus(self, dim: int) -> float:
        return self.of.bulk_like_modulus(dim)

    def hidden_stretch(self, F: Float, history: Float, dt: float = 0.0) -> Float:
        return self.of.hidden_stretch(F, history[:, F.shape[1] ** 2 :], dt)

    def out_of_plane_stress(self, F: Float, history: Float, dt: float = 0.0) -> Float:
        """Return that of the law at the end of the step."""
        return self.of.out_of_plane_stress(F, history[:, F.shape[1] ** 2 :], dt)

    def history_at(self, dim: int, x: Float) -> Float:
        """Return F = I and the data of the law."""
        rest = np.tile(np.eye(dim).ravel(), (len(x), 1))
        return np.concatenate([rest, self.of.history_at(dim, x)], axis=1)

    def defined(self, F: Float, select: GlobalIndex, history: Float) -> bool:
        """Return True if the law has a stress at the end of the step."""
        return self.of.defined(F, select, history[:, F.shape[1] ** 2 :])

    def uniform(self) -> EnergyMomentum:
        """Return the law without dependence on position."""
        return EnergyMomentum(self.of.uniform(), density=self.density)


class _Step:
    """Stresses of the points of a law in a step, for F (n, d, d) at its end and the history of the points.

    Parameters
    ----------
    law : HistoryKernels
        Loops of the law.
    constants : float64
        Constants of the loops.
    F : (n, d, d) float64
        F at the end of the step [-].
    history : (n, n_history) float64
        F at the start, then the data of the law.
    size : int
        Number of components of F.
    """

    def __init__(self, law: HistoryKernels, constants: Float, F: Float, history: Float, size: int) -> None:
        self._law, self._constants, self._data = law, constants, history[:, size:]
        self.F_0, self.F_1 = np.ascontiguousarray(history[:, :size]).reshape(F.shape), F
        self.F_m = 0.5 * (self.F_0 + self.F_1)
        C_0, C_1 = (np.einsum("pka,pkb->pab", one, one) for one in (self.F_0, self.F_1))
        self._dC = C_1 - C_0
        squares, axes = np.linalg.eigh(0.5 * (C_0 + C_1))
        # The law takes F: that of C_m without rotation is its root.
        self._U = np.einsum("pai,pi,pbi->pab", axes, np.sqrt(squares), axes)
        self._U_inverse = np.einsum("pai,pi,pbi->pab", axes, 1.0 / np.sqrt(squares), axes)
        self._S = self._U_inverse @ self.stress(self._U)
        square = np.einsum("pab,pab->p", self._dC, self._dC)
        self._over = np.where(square > SAME**2, 1.0 / np.maximum(square, SAME**2), 0.0)
        off = 2.0 * (self._energy(self.F_1) - self._energy(self.F_0)) - np.einsum("pab,pab->p", self._S, self._dC)
        S_0, S_1 = (np.linalg.solve(one, self.stress(one)) for one in (self.F_0, self.F_1))
        by_stress = np.einsum("pab,pab->p", S_0 - 2.0 * self._S + S_1, self._dC) / 6.0
        self._beta = np.where(square < NEAR**2, by_stress, off) * self._over
        self.S_m = self._S + self._beta[:, None, None] * self._dC

    def stress(self, F: Float) -> Float:
        """Return P of the law (n, d, d) [stress]."""
        P = np.empty_like(F)
        self._law.stress(F, np.arange(len(F)), self._constants, self._data, P)
        return P

    def _energy(self, F: Float) -> Float:
        psi = np.empty(len(F))
        self._law.energy(F, np.arange(len(F)), self._constants, self._data, psi)
        return psi

    def S_m_by_C(self) -> Float:
        """Return the derivative of the mean stress by ``C_1`` (n, d, d, d, d) [stress]."""
        dim, dC = self._U.shape[1], self._dC
        A = np.empty((len(self._U), *(dim,) * 4))
        self._law.tangent(self._U, np.arange(len(A)), self._constants, self._data, A)
        A -= np.einsum("ik,pmn->pimkn", np.eye(dim), self._S)
        # 2 dS/dC at C_m, which moves half as far as C_1.
        by_middle = 0.25 * np.einsum("pai,pimkn,pbk->pambn", self._U_inverse, A, self._U_inverse)
        by_middle = 0.5 * (by_middle + by_middle.swapaxes(3, 4))
        S_1 = np.linalg.solve(self.F_1, self.stress(self.F_1))
        by_beta = S_1 - self._S - np.einsum("pambn,pam->pbn", by_middle, dC) - 2.0 * self._beta[:, None, None] * dC
        by_beta *= self._over[:, None, None]
        one = np.eye(dim)
        same = 0.5 * (np.einsum("ab,mn->ambn", one, one) + np.einsum("an,mb->ambn", one, one))
        by_middle += self._beta[:, None, None, None, None] * same
        return np.asarray(by_middle + np.einsum("pam,pbn->pambn", dC, by_beta))
