"""Numpy versions of the compiled loops, written for reading: the definition of correct."""

import numpy as np


def families(x, horizon):
    """Return the neighbours of every particle by comparing all pairs."""
    distance = np.linalg.norm(x[:, None] - x[None], axis=2)
    return [np.flatnonzero((row <= horizon * (1 + 1e-9)) & (np.arange(len(x)) != i)) for i, row in enumerate(distance)]


def dense_operator(operator, n):
    """Return G as (n_points, dim, n): H_pim = sum_k u_ki G_pmk."""
    G = np.zeros((operator.n_points, operator.g.shape[1], n))
    for p in range(operator.n_points):
        for t in range(operator.point_ptr[p], operator.point_ptr[p + 1]):
            G[p, :, operator.members[t]] += operator.g[t]
    return G


def gradient(G, u):
    """Return H = grad u at every point."""
    return np.einsum("pmk,ki->pim", G, u)


def divergence(G, volume, P):
    """Return f = G^T W P."""
    return np.einsum("p,pim,pmk->ki", volume, P, G)


def tangent(G, volume, A):
    """Return K = G^T W A G as (n dim, n dim)."""
    K = np.einsum("p,pma,pimkn,pnb->aibk", volume, G, A, G)
    size = K.shape[0] * K.shape[1]
    return K.reshape(size, size)


def silling_energy(x, volume, neighbours, G, kappa, u):
    """Return 1/2 sum_i V_i sum_j V_j c_i |z_ij|^2, z = eta - H xi, c_i = G kappa / sum_j |xi|^2 V_j, omega = 1."""
    energy = 0.0
    for i, family in enumerate(neighbours):
        xi, eta, V = x[family] - x[i], u[family] - u[i], volume[family]
        K = np.einsum("j,jm,jn->mn", V, xi, xi)
        H = np.einsum("j,jm,jn->mn", V, eta, xi) @ np.linalg.inv(K)
        z = eta - xi @ H.T
        energy += 0.5 * volume[i] * G * kappa / np.trace(K) * (V @ (z**2).sum(axis=1))
    return energy


def bond_forces(model, u):
    """Return the internal forces of a free body of bonds, bond by bond."""
    x, family, term = model.cloud.x, model.families, model.material_term
    f = np.zeros_like(u)
    for i in range(len(u)):
        bonds = range(family.indptr[i], family.indptr[i + 1])
        xi = np.array([x[family.neighbours[b]] - x[i] for b in bonds])
        eta = np.array([u[family.neighbours[b]] - u[i] for b in bonds])
        y = xi + eta if term.finite else xi
        n = y / np.linalg.norm(y, axis=1)[:, None]
        e = np.linalg.norm(y, axis=1) - np.linalg.norm(xi, axis=1) if term.finite else (n * eta).sum(axis=1)
        t = term.k[bonds.start : bonds.stop] * e
        if term.a is not None:
            a = term.a[bonds.start : bonds.stop]
            t += a * term.B[i] * (a @ e)
        for b, force in zip(bonds, t[:, None] * n, strict=True):
            f[family.neighbours[b]] += force
            f[i] -= force
    return f


def lengths_of_broken_bonds(n, m, power=1):
    """Return the lengths, in spacings, of the bonds of a periodic bar of n particles in the order in which they break.

    Their stiffness goes as ``length^-power``.

    After each the whole body is solved anew; the bond with the largest stretch breaks next, until one section is cut.
    Bonds that span the first one are listed; which of two that mirror each other comes first makes no difference.
    """
    whole = {(i, k) for i in range(n) for k in range(1, m + 1)}
    broken = [(n // 2, 1)]
    while len(broken) < m * (m + 1) // 2:
        K, f = np.zeros((n, n)), np.zeros(n)
        for i, k in whole - set(broken):
            j, ahead = (i + k) % n, float(i + k >= n)
            K[[i, j, i, j], [i, j, j, i]] += np.array([1.0, 1.0, -1.0, -1.0]) / k**power
            f[[i, j]] += np.array([1.0, -1.0]) * ahead / k**power
        u = np.append(0.0, np.linalg.solve(K[1:, 1:], f[1:]))
        stretch = {(i, k): (u[(i + k) % n] + float(i + k >= n) - u[i]) / k for i, k in whole - set(broken)}
        # Ties of mirrored bonds are broken towards the left by more than round-off and less than differences.
        broken.append(max(stretch, key=lambda bond: stretch[bond] * (1.0 + 1e-9 * (n - bond[0]))))
    return [k for _, k in broken]
