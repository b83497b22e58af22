"""Closed part of an energy whose crack faces slide, with Coulomb friction."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, Mask
from pdpetsc.material.base import HistoryKernels, HistoryMaterial
from pdpetsc.material.closed import ClosedPart


class _Smooth(NamedTuple):
    """Store the state of points whose faces slide without friction, at deformation gradients F (n, dim, dim).

    Attributes
    ----------
    n : (n, dim) float64
        Normal of the crack.
    s : (n, dim) float64
        Slip [-].
    F_e, P : (n, dim, dim) float64
        ``F (1 - s (x) n)`` [-], and its stress [stress].
    t : (n, dim) float64
        ``F_e^T P n`` [stress]; parallel to n.
    inverse : (n, dim, dim) float64
        Inverse of ``F^T F`` in the plane of the crack, at small strain of 1; zero along n.
    """

    n: Float
    s: Float
    F_e: Float
    P: Float
    t: Float
    inverse: Float


class _Slip(NamedTuple):
    """Store shear and slip of points with friction.

    Attributes
    ----------
    tau : (n, dim) float64
        Shear traction [stress].
    way : (n, dim) float64
        Direction of the slip without friction since the last converged step.
    most : (n,) float64
        Amount of this slip [-].
    slides : (n,) bool
        Points that slip.
    """

    tau: Float
    way: Float
    most: Float
    slides: Mask


@dataclass(frozen=True)
class SlidingPart(HistoryMaterial):
    r"""The closed part of a crack with normal n, whose faces slip by s against Coulomb friction.

    Without friction the faces slip by ``s_0``, at which n is a principal direction of ``F_e = F (1 - s_0 (x) n)``; at
    small strain ``F_e = F - s_0 (x) n``. The energy is then ``psi_closed(F_e)``, and the faces carry a pressure p
    alone. With friction the energy is ``psi_closed(F_e) + mu / 2 |s_0 - s|^2`` with the shear modulus mu. The shear
    traction ``tau = mu (s_0 - s)`` is at most ``friction p``, beyond which s follows ``s_0``. A slip is the
    displacement of one face along the other over the width of the band that the crack fails. A point without a crack
    has n = 0, and the energy ``psi_closed(F)``.

    Parameters
    ----------
    part : ClosedPart
        The closed part without slip.
    friction : float
        Coefficient of friction [-].

    Notes
    -----
    The history of a point is n and s. The work of friction is not part of the energy.
    """

    part: ClosedPart = field(kw_only=True)
    friction: float = field(kw_only=True)

    @classmethod
    def of(cls, part: ClosedPart, friction: float) -> SlidingPart:
        """Return the law for a closed part."""
        return cls(part.E, part.nu, part.plane, part=part, friction=friction)

    @property
    def small_strain(self) -> bool:
        """Return True if the closed part is a law of the small strain."""
        return self.part.small_strain

    @property
    def symmetric(self) -> bool:
        """Return True without friction."""
        return self.friction == 0.0

    def initial_history(self, dim: int, n: int) -> Float:
        return np.zeros((n, 2 * dim))

    def open_share(self, dim: int) -> float:
        """Return the open share of the energy in uniaxial tension [-]."""
        return self.part.open_share(dim)

    def thickness_stretch(self, F: Float) -> Float:
        """Return 1: the law of the intact material determines the thickness."""
        return self.part.thickness_stretch(F)

    def out_of_plane_stress(self, F: Float, history: Float, dt: float = 0.0) -> Float:
        slid, cracked = F.copy(), _cracked(history, 2)
        slid[cracked] = self._smooth(F[cracked], history[cracked]).F_e
        return self.part.out_of_plane_stress(slid, history)

    def history_kernels(self, dim: int) -> HistoryKernels:
        loops = self.part.kernels(dim)

        def write(quantity: Callable[[Float, Float], Float], plain: Callable[..., None]) -> Callable[..., None]:
            def loop(F: Float, select: GlobalIndex, constants: Float, history: Float, result: Float) -> None:
                cracked = _cracked(history, dim)
                plain(F, select[~cracked], constants, result)
                result[select[cracked]] = quantity(F[select[cracked]], history[cracked])

            return loop

        def commit(F: Float, select: GlobalIndex, constants: Float, history: Float) -> None:
            history[:, dim:] = self._shear(F[select], history)[1]

        return HistoryKernels(
            write(self._stress, loops.stress), write(self._tangent, loops.tangent), write(self._energy, loops.energy),
            commit,
        )  # fmt: skip

    def slipped(self, F: Float, history: Float) -> Float:
        """Return ``tau . s`` (n,) [energy / volume], which drives no damage.

        ``F`` (n, dim, dim) and ``history`` are those of some points.
        """
        tau, s = self._shear(F, history)
        return np.asarray((tau * s).sum(axis=1))

    def rubbed(self, F: Float, history: Float) -> Float:
        """Return the work of friction since the last converged step (n,) [energy / volume], as ``slipped``."""
        tau, s = self._shear(F, history)
        return np.asarray((tau * (s - history[:, F.shape[-1] :])).sum(axis=1))

    def _shear(self, F: Float, history: Float) -> tuple[Float, Float]:
        """Return shear traction [stress] and slip [-] (n, dim), 0 without a crack."""
        dim, cracked = F.shape[-1], _cracked(history, F.shape[-1])
        tau, s = np.zeros((2, len(F), dim))
        smooth = self._smooth(F[cracked], history[cracked])
        tau[cracked] = self._slip(smooth, history[cracked]).tau
        s[cracked] = smooth.s - tau[cracked] / self._mu(dim)
        return tau, s

    def _energy(self, F: Float, history: Float) -> Float:
        """Return the stored energy (n,)."""
        dim, smooth = F.shape[-1], self._smooth(F, history)
        slip = self._slip(smooth, history)
        psi = _filled(self.part.kernels(dim).energy, smooth.F_e, (len(F),))
        return np.asarray(psi + 0.5 * (slip.tau**2).sum(axis=1) / self._mu(dim))

    def _stress(self, F: Float, history: Float) -> Float:
        """Return P (n, dim, dim)."""
        smooth = self._smooth(F, history)
        P = np.einsum("pi,pikn->pkn", self._slip(smooth, history).tau, self._slip_by(F, smooth))
        if self.small_strain:
            return np.asarray(P + smooth.P)
        return np.asarray(P + smooth.P - np.einsum("pij,pj,pm->pim", smooth.P, smooth.n, smooth.s))

    def _tangent(self, F: Float, history: Float) -> Float:
        """Return dP/dF (n, dim, dim, dim, dim)."""
        dim, one = F.shape[-1], np.eye(F.shape[-1])
        smooth, mu = self._smooth(F, history), self._mu(F.shape[-1])
        tau, way, most, slides = self._slip(smooth, history)
        n, s, F_e, P = smooth.n, smooth.s, smooth.F_e, smooth.P
        A = _filled(self.part.kernels(dim).tangent, F_e, (len(F), *(dim,) * 4))
        ds, Pn = self._slip_by(F, smooth), np.einsum("pij,pj->pi", P, n)
        if self.small_strain:
            dF_e = np.einsum("ik,mn->imkn", one, one) - np.einsum("pikn,pm->pimkn", ds, n)
            dP = total = np.einsum("pimab,pabkn->pimkn", A, dF_e)
            pressed = -np.einsum("pi,pimkn,pm->pkn", n, dP, n)
        else:
            Q = one - s[:, :, None] * n[:, None, :]
            dF_e = np.einsum("ik,pnm->pimkn", one, Q) - np.einsum("pia,pakn,pm->pimkn", F, ds, n)
            dP = np.einsum("pimab,pabkn->pimkn", A, dF_e)
            total = np.einsum("piakn,pma->pimkn", dP, Q) - np.einsum("pi,pmkn->pimkn", Pn, ds)
            total = total + self._curved(F, smooth, ds, tau)
            stretched = np.einsum("pij,pj->pi", F_e, n)
            pressed = -np.einsum("pi,pimkn,pm->pkn", stretched, dP, n) - np.einsum("pimkn,pm,pi->pkn", dF_e, n, Pn)
        # The shear traction by F: mu ds where faces stick, that of friction p along ``way`` where they slide.
        turned = ds - np.einsum("pi,pj,pjkn->pikn", way, way, ds)
        turned *= (np.linalg.norm(tau, axis=1) / np.where(most > 0.0, most, 1.0))[:, None, None, None]
        pressed[(smooth.t * n).sum(axis=1) >= 0.0] = 0.0
        slid = turned + self.friction * np.einsum("pi,pkn->pikn", way, pressed)
        dtau = np.where(slides[:, None, None, None], slid, mu * ds)
        return np.asarray(total + np.einsum("paim,pakn->pimkn", ds, dtau))

    def _curved(self, F: Float, smooth: _Smooth, ds: Float, tau: Float) -> Float:
        """Return ``tau . d^2 s_0 / dF^2`` (n, dim, dim, dim, dim)."""
        w = np.einsum("pij,pi->pj", smooth.inverse, tau)
        rest, one = smooth.n - smooth.s, np.eye(F.shape[-1])
        both = w[:, :, None] * rest[:, None, :]
        changed = np.einsum("pmn,ik->pimkn", both + both.transpose(0, 2, 1), one)
        # w . dC ds: dC = dF^T F + F^T dF.
        Fw, Fds = np.einsum("pij,pj->pi", F, w), np.einsum("pij,pjkn->pikn", F, ds)
        turned = np.einsum("pm,pikn->pimkn", w, Fds) + np.einsum("pi,pmkn->pimkn", Fw, ds)
        return np.asarray(changed - turned - turned.transpose(0, 3, 4, 1, 2))

    def _smooth(self, F: Float, history: Float) -> _Smooth:
        """Return the state without friction."""
        dim = F.shape[-1]
        n = history[:, :dim]
        plane = np.eye(dim) - n[:, :, None] * n[:, None, :]
        if self.small_strain:
            inverse, sheared = plane, np.einsum("pij,pj->pi", F + F.transpose(0, 2, 1), n)
        else:
            C = np.einsum("pki,pkj->pij", F, F)
            inverse = np.linalg.inv(plane @ C @ plane + n[:, :, None] * n[:, None, :]) @ plane
            sheared = np.einsum("pij,pj->pi", C, n)
        s = np.einsum("pij,pj->pi", inverse, sheared)
        slip = s[:, :, None] * n[:, None, :]
        F_e = F - (slip if self.small_strain else F @ slip)
        P = _filled(self.part.kernels(dim).stress, F_e, F.shape)
        Pn = np.einsum("pij,pj->pi", P, n)
        t = Pn if self.small_strain else np.einsum("pij,pi->pj", F_e, Pn)
        return _Smooth(n, s, F_e, P, t, inverse)

    def _slip(self, smooth: _Smooth, history: Float) -> _Slip:
        """Return shear and slip with friction for the history of the last converged step."""
        dim = smooth.n.shape[1]
        mu, way = self._mu(dim), smooth.s - history[:, dim:]
        most = np.linalg.norm(way, axis=1)
        way = way / np.where(most > 0.0, most, 1.0)[:, None]
        rubs = self.friction * np.maximum(-(smooth.t * smooth.n).sum(axis=1), 0.0)
        slides = mu * most > rubs
        return _Slip(np.where(slides, rubs, mu * most)[:, None] * way, way, most, slides)

    def _slip_by(self, F: Float, smooth: _Smooth) -> Float:
        """Return the derivative of the slip without friction by F (n, dim, dim, dim)."""
        one, n = np.eye(F.shape[-1]), smooth.n
        # At small strain d(F + F^T) n. Else P C (n - s_0) = 0, P the projection to the plane, dC = dF^T F + F^T dF.
        rest = n if self.small_strain else n - smooth.s
        G = np.broadcast_to(one, F.shape) if self.small_strain else F
        by = np.einsum("pka,in,pa->pikn", G, one, rest) + np.einsum("pki,pn->pikn", G, rest)
        return np.asarray(np.einsum("pij,pjkn->pikn", smooth.inverse, by))

    def _mu(self, dim: int) -> float:
        """Return the shear modulus [stress]."""
        return self.part.lame(dim)[1]


def _cracked(history: Float, dim: int) -> Mask:
    """Return which points have a crack (n,)."""
    return np.asarray(history[:, :dim].any(axis=1))


def _filled(loop: Callable[..., None], F: Float, shape: tuple[int, ...]) -> Float:
    """Return the result of a loop of a closed part at all points of F."""
    result = np.empty(shape)
    loop(F, np.arange(len(F)), np.zeros(0), result)
    return result
