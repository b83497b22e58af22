"""Radial return of J2 plasticity with linear hardening, exact in one step, with what surrounds it in one loop.

It is what ``material.j2`` does for any hardening law, for the commonest one in about two thirds of the time in a plane.
A history has G first, then the elastic strain out of plane, and alpha last.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from pdpetsc.kernels.compile import compiled
from pdpetsc.kernels.principal import principal_axes, principal_tangent, reference_axes, unload


@compiled
def _trial(F, history, dim, E, C, stretch, N, n, strain):  # type: ignore[no-untyped-def]
    """Write the stretches of ``F G``, their directions n, N and all three trial strains."""
    for i in range(dim):
        for j in range(dim):
            E[i, j] = 0.0
            for k in range(dim):
                E[i, j] += F[i, k] * history[k * dim + j]
    principal_axes(E, dim, C, stretch, N, n)
    for a in range(3):
        strain[a] = np.log(stretch[a]) if a < dim else 0.0
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
def linear_out_of_plane(F, constants, history, P):  # type: ignore[no-untyped-def]
    """Write the stress across the plane of every point of a body in plane strain."""
    E, C, N, n = np.empty((2, 2)), np.empty((2, 2)), np.empty((2, 2)), np.empty((2, 2))
    stretch, strain, tau, flow = np.empty(2), np.empty(3), np.empty(3), np.empty(3)
    for p in range(len(F)):
        _trial(F[p], history[p], 2, E, C, stretch, N, n, strain)
        _return(strain, history[p, -1], constants, 2, tau, flow)
        P[p] = tau[2]


@lru_cache
def linear_return_loops(dim: int) -> tuple[Any, Any, Any, Any]:
    """Return loops for stress, tangent, energy and commit, as ``HistoryKernels`` has them."""

    @compiled
    def stress(F, select, constants, history, P):  # type: ignore[no-untyped-def]
        E, C, N, n = np.empty((dim, dim)), np.empty((dim, dim)), np.empty((dim, dim)), np.empty((dim, dim))
        stretch, strain, tau, flow = np.empty(dim), np.empty(3), np.empty(3), np.empty(3)
        for r in range(select.size):
            p = select[r]
            _trial(F[p], history[r], dim, E, C, stretch, N, n, strain)
            _return(strain, history[r, -1], constants, dim, tau, flow)
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
        M, moduli, shear = np.empty((dim, dim)), np.empty((dim, dim)), np.empty((dim, dim))
        stretch, strain, tau, flow = np.empty(dim), np.empty(3), np.empty(3), np.empty(3)
        third = 0.0 if dim == 1 else 1.0 / 3.0
        bulk = constants[0] + 2.0 * mu * third
        for r in range(select.size):
            p = select[r]
            _trial(F[p], history[r], dim, E, C, stretch, N, n, strain)
            theta, theta_bar, _ = _return(strain, history[r, -1], constants, dim, tau, flow)
            reference_axes(history[r], N, dim, M)
            for a in range(dim):
                for b in range(dim):
                    moduli[a, b] = bulk - 2.0 * mu * (theta * third + theta_bar * flow[a] * flow[b])
                moduli[a, a] += 2.0 * mu * theta
            shear[:] = 2.0 * mu * theta
            principal_tangent(dim, stretch, tau, moduli, shear, n, M, A[p])

    @compiled
    def energy(F, select, constants, history, psi):  # type: ignore[no-untyped-def]
        lam, mu, y, H = constants[0], constants[1], constants[2], constants[3]
        E, C, N, n = np.empty((dim, dim)), np.empty((dim, dim)), np.empty((dim, dim)), np.empty((dim, dim))
        stretch, strain, tau, flow = np.empty(dim), np.empty(3), np.empty(3), np.empty(3)
        for r in range(select.size):
            p = select[r]
            _trial(F[p], history[r], dim, E, C, stretch, N, n, strain)
            _, _, d_alpha = _return(strain, history[r, -1], constants, dim, tau, flow)
            alpha = history[r, -1] + d_alpha
            trace = strain[0] + strain[1] + strain[2]
            square = strain[0] ** 2 + strain[1] ** 2 + strain[2] ** 2
            psi[p] = 0.5 * lam * trace * trace + mu * square + 0.5 * H * alpha * alpha + y * alpha

    @compiled
    def commit(F, select, constants, history):  # type: ignore[no-untyped-def]
        E, C, N, n = np.empty((dim, dim)), np.empty((dim, dim)), np.empty((dim, dim)), np.empty((dim, dim))
        stretch, strain, tau, flow = np.empty(dim), np.empty(3), np.empty(3), np.empty(3)
        for r in range(select.size):
            _trial(F[select[r]], history[r], dim, E, C, stretch, N, n, strain)
            _, _, d_alpha = _return(strain, history[r, -1], constants, dim, tau, flow)
            unload(strain, stretch, N, n, dim, E, C, history[r])
            if dim == 2:
                history[r, dim * dim] = strain[2]
            history[r, -1] += d_alpha

    return stress, tangent, energy, commit
