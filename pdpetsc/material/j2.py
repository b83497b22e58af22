"""J2 plasticity at finite strain with linear isotropic hardening."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.errors import CaseError
from pdpetsc.kernels.compile import compiled
from pdpetsc.kernels.eigen import symmetric_eigen
from pdpetsc.kernels.principal import principal_tangent
from pdpetsc.material.base import HistoryKernels, HistoryMaterial


@dataclass(frozen=True)
class J2(HistoryMaterial):
    r"""J2 plasticity in Hencky strain, ``F = F_e F_p``, with a radial return that is exact in one step.

    In the principal frame of ``b_e = F G G^T F^T``, ``G = F_p^-1``, with logarithmic strains eps and deviator s::

        tau = lambda tr(eps) I + 2 mu eps,  q = sqrt(3/2 s : s)
        q > y + H alpha:  d_alpha = (q - y - H alpha) / (3 mu + H),  s := (1 - 3 mu d_alpha / q) s

    and ``P = tau F^-T``, ``A = dP/dF`` with the moduli of the return. In a bar the stress is uniaxial and ``3 mu``
    becomes E. The energy is elastic energy + ``H alpha^2 / 2 + y alpha``; the stress of a step is its derivative.
    History is the factor G, the elastic strain out of plane and alpha; it changes only when a step has converged.

    Parameters
    ----------
    E, nu, plane
        Young's modulus [stress], Poisson's ratio [-] and ``"strain"``, as for every ``Material``.
    yield_stress : float
        y [stress], positive.
    hardening : float
        H, the slope of the yield stress over the plastic strain [stress], not negative.

    Raises
    ------
    CaseError
        A constant is out of range, or plane stress is asked for.

    References
    ----------
    Simo1992; deSouzaNeto2008, section 14.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> steel = pd.J2(E=200e3, nu=0.3, yield_stress=250.0, hardening=1e3)
    """

    yield_stress: float = 1.0
    hardening: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (math.isfinite(self.yield_stress) and self.yield_stress > 0.0):
            raise CaseError(f"J2 needs a positive yield stress, not {self.yield_stress}.")
        if not (math.isfinite(self.hardening) and self.hardening >= 0.0):
            raise CaseError(f"J2 needs hardening >= 0, not {self.hardening}.")
        if self.plane == "stress":
            raise CaseError('J2 has no plane stress; take plane="strain", or model a bar or a solid.')

    def constants(self, dim: int) -> Float:
        """Return ``lambda, mu, y, H``."""
        return np.array([*self.lame(dim), self.yield_stress, self.hardening])

    def initial_history(self, dim: int, n: int) -> Float:
        """Return the history of ``n`` undeformed points, (n, dim^2 + 2): G, elastic strain out of plane, alpha."""
        return np.tile(np.concatenate([np.eye(dim).ravel(), [0.0, 0.0]]), (n, 1))

    def history_kernels(self, dim: int) -> HistoryKernels:
        """Return the compiled loops for dimension ``dim``."""
        return _kernels(dim)

    def out_of_plane_stress(self, F: Float, history: Float) -> Float:
        """Return ``tau_zz`` after the return (n,) [stress]: ``F_zz`` is 1."""
        P = np.empty(len(F))
        _out_of_plane(F, self.constants(2), history, P)
        return P

    def plastic_strain(self, history: Float) -> Float:
        """Return the accumulated plastic strain alpha (n,) [-]."""
        return history[:, -1]

    def thickness_stretch(self, F: Float) -> Float:
        """Return 1 in plane strain and solids; in a bar that of the elastic law, exact for nu = 1/2."""
        if F.shape[-1] > 1:
            return np.ones(len(F))
        return np.asarray(F[:, 0, 0] ** (-2.0 * self.nu))


@compiled
def _trial(F, history, dim, E, C, squares, N, n, strain):  # type: ignore[no-untyped-def]
    """Return the stretches of ``F G`` in ``squares``, their directions n, N and all three trial strains."""
    for i in range(dim):
        for j in range(dim):
            E[i, j] = 0.0
            for k in range(dim):
                E[i, j] += F[i, k] * history[k * dim + j]
    for i in range(dim):
        for j in range(dim):
            C[i, j] = 0.0
            for k in range(dim):
                C[i, j] += E[k, i] * E[k, j]
    symmetric_eigen(C, squares, N)
    for a in range(3):
        strain[a] = 0.0
    for a in range(dim):
        strain[a] = 0.5 * np.log(squares[a])
        squares[a] = np.sqrt(squares[a])
        for i in range(dim):
            n[i, a] = 0.0
            for k in range(dim):
                n[i, a] += E[i, k] * N[k, a] / squares[a]
    if dim == 2:
        strain[2] = history[dim * dim]


@compiled
def _return(strain, alpha, constants, dim, tau, flow):  # type: ignore[no-untyped-def]
    """Return ``(theta, theta_bar, d_alpha)`` and fill stresses and unit flow direction; ``strain`` becomes elastic."""
    lam, mu, y, H = constants[0], constants[1], constants[2], constants[3]
    count = 1 if dim == 1 else 3
    stiff = 2.0 * mu if dim == 1 else 3.0 * mu
    trace = 0.0
    for a in range(count):
        trace += strain[a]
    mean = 0.0 if dim == 1 else trace / 3.0
    square = 0.0
    for a in range(count):
        square += (strain[a] - mean) ** 2
    size = np.sqrt(square)
    q = 2.0 * mu * size * (1.0 if dim == 1 else np.sqrt(1.5))
    d_alpha = 0.0
    theta = 1.0
    theta_bar = 0.0
    if q > y + H * alpha:
        d_alpha = (q - y - H * alpha) / (stiff + H)
        theta = 1.0 - stiff * d_alpha / q
        theta_bar = stiff / (stiff + H) - (1.0 - theta)
    for a in range(count):
        flow[a] = (strain[a] - mean) / size if size > 0.0 else 0.0
        strain[a] = mean + theta * (strain[a] - mean)
        tau[a] = lam * trace + 2.0 * mu * strain[a]
    return theta, theta_bar, d_alpha


@compiled
def _out_of_plane(F, constants, history, P):  # type: ignore[no-untyped-def]
    """Write the stress across the plane of every point of a body in plane strain."""
    E, C, N, n = np.empty((2, 2)), np.empty((2, 2)), np.empty((2, 2)), np.empty((2, 2))
    stretch, strain, tau, flow = np.empty(2), np.empty(3), np.empty(3), np.empty(3)
    for p in range(len(F)):
        _trial(F[p], history[p], 2, E, C, stretch, N, n, strain)
        _return(strain, history[p, 5], constants, 2, tau, flow)
        P[p] = tau[2]


@lru_cache
def _kernels(dim: int) -> HistoryKernels:
    @compiled
    def stress(F, select, constants, history, P):  # type: ignore[no-untyped-def]
        E, C, N, n = np.empty((dim, dim)), np.empty((dim, dim)), np.empty((dim, dim)), np.empty((dim, dim))
        stretch, strain, tau, flow = np.empty(dim), np.empty(3), np.empty(3), np.empty(3)
        for r in range(select.size):
            p = select[r]
            _trial(F[p], history[r], dim, E, C, stretch, N, n, strain)
            _return(strain, history[r, dim * dim + 1], constants, dim, tau, flow)
            for i in range(dim):
                for j in range(dim):
                    C[i, j] = 0.0
                    for a in range(dim):
                        C[i, j] += tau[a] / stretch[a] * n[i, a] * N[j, a]
            for i in range(dim):
                for j in range(dim):
                    P[p, i, j] = 0.0
                    for k in range(dim):
                        P[p, i, j] += C[i, k] * history[r, j * dim + k]

    @compiled
    def tangent(F, select, constants, history, A):  # type: ignore[no-untyped-def]
        mu = constants[1]
        E, C, N, n = np.empty((dim, dim)), np.empty((dim, dim)), np.empty((dim, dim)), np.empty((dim, dim))
        M, moduli = np.empty((dim, dim)), np.empty((dim, dim))
        stretch, strain, tau, flow = np.empty(dim), np.empty(3), np.empty(3), np.empty(3)
        third = 0.0 if dim == 1 else 1.0 / 3.0
        bulk = constants[0] + 2.0 * mu * third
        for r in range(select.size):
            p = select[r]
            _trial(F[p], history[r], dim, E, C, stretch, N, n, strain)
            theta, theta_bar, _ = _return(strain, history[r, dim * dim + 1], constants, dim, tau, flow)
            # M_ma = (G N_a)_m: the return of the second index to the reference configuration.
            for m in range(dim):
                for a in range(dim):
                    M[m, a] = 0.0
                    for k in range(dim):
                        M[m, a] += history[r, m * dim + k] * N[k, a]
            for a in range(dim):
                for b in range(dim):
                    moduli[a, b] = bulk - 2.0 * mu * (theta * third + theta_bar * flow[a] * flow[b])
                moduli[a, a] += 2.0 * mu * theta
            principal_tangent(dim, stretch, tau, moduli, 2.0 * mu * theta, n, M, A[p])

    @compiled
    def energy(F, select, constants, history, psi):  # type: ignore[no-untyped-def]
        lam, mu, y, H = constants[0], constants[1], constants[2], constants[3]
        E, C, N, n = np.empty((dim, dim)), np.empty((dim, dim)), np.empty((dim, dim)), np.empty((dim, dim))
        stretch, strain, tau, flow = np.empty(dim), np.empty(3), np.empty(3), np.empty(3)
        for r in range(select.size):
            p = select[r]
            _trial(F[p], history[r], dim, E, C, stretch, N, n, strain)
            _, _, d_alpha = _return(strain, history[r, dim * dim + 1], constants, dim, tau, flow)
            alpha = history[r, dim * dim + 1] + d_alpha
            trace = strain[0] + strain[1] + strain[2]
            square = strain[0] ** 2 + strain[1] ** 2 + strain[2] ** 2
            psi[p] = 0.5 * lam * trace * trace + mu * square + 0.5 * H * alpha * alpha + y * alpha

    @compiled
    def commit(F, select, constants, history):  # type: ignore[no-untyped-def]
        E, C, N, n = np.empty((dim, dim)), np.empty((dim, dim)), np.empty((dim, dim)), np.empty((dim, dim))
        stretch, strain, tau, flow = np.empty(dim), np.empty(3), np.empty(3), np.empty(3)
        for r in range(select.size):
            _trial(F[select[r]], history[r], dim, E, C, stretch, N, n, strain)
            _, _, d_alpha = _return(strain, history[r, dim * dim + 1], constants, dim, tau, flow)
            # G becomes F^-1 V_e = G (F G)^-1 V_e with the elastic stretch V_e after the return.
            for i in range(dim):
                for j in range(dim):
                    C[i, j] = 0.0
                    for a in range(dim):
                        C[i, j] += np.exp(strain[a]) / stretch[a] * N[i, a] * n[j, a]
            for i in range(dim):
                for j in range(dim):
                    E[i, j] = 0.0
                    for k in range(dim):
                        E[i, j] += history[r, i * dim + k] * C[k, j]
            for i in range(dim):
                for j in range(dim):
                    history[r, i * dim + j] = E[i, j]
            if dim == 2:
                history[r, dim * dim] = strain[2]
            history[r, dim * dim + 1] += d_alpha

    return HistoryKernels(stress, tangent, energy, commit)
