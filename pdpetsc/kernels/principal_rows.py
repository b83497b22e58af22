"""Principal frames of blocks of points, and stress and tangent of an isotropic law from principal values.

Points are processed in blocks, and every component of a tensor is a row over the points of its block. The innermost
loops run over these rows and are vectorised. C = F^T F is stored as C - 1, which preserves all digits of small strains.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.kernels.compile import compiled

# Points of a block: enough for long loops, few enough for their rows to fit the L1 cache.
BLOCK = 128
# Largest number of sweeps of Jacobi's method; about five are typical.
SWEEPS = 30
# Distance from 1 below which the logarithm is a series, and its number of terms.
NEAR, TERMS = 0.25, 11


class Frame(NamedTuple):
    """Principal frames of a block of points.

    Attributes
    ----------
    H : (dim, dim, BLOCK) float64
        Elastic part of the deformation gradient, minus 1 [-].
    C : (dim, dim, BLOCK) float64
        Work space.
    strain : (3, BLOCK) float64
        Logarithmic strains [-], 0 in hidden directions.
    stretch : (dim, BLOCK) float64
        Stretches [-].
    N, n : (dim, dim, BLOCK) float64
        Principal directions in columns, in the unloaded and in the current state.
    M : (dim, dim, BLOCK) float64
        ``G N``: N in the reference configuration.
    """

    H: Any
    C: Any
    strain: Any
    stretch: Any
    N: Any
    n: Any
    M: Any


@compiled
def new_frame(dim):
    """Return a frame for points of dimension ``dim``."""
    square = (dim, dim, BLOCK)
    return Frame(
        np.empty(square),
        np.empty(square),
        np.zeros((3, BLOCK)),
        np.empty((dim, BLOCK)),
        np.empty(square),
        np.empty(square),
        np.empty(square),
    )


@compiled
def open_frame(F, points, history, frame):
    """Compute the principal frames of ``F G`` at points.

    Rows of ``history`` (n, n_history) begin with ``G = F_p^-1``, row by row; without columns G is the identity.
    """
    dim, n = F.shape[1], points.size
    H, C, strain, stretch, N, now, M = frame
    plastic = history.shape[1] > 0
    for i in range(dim):
        for j in range(dim):
            h, one = H[i, j], 1.0 if i == j else 0.0
            for r in range(n):
                h[r] = F[points[r], i, j] - one
            if plastic:
                g = C[i, j]
                for r in range(n):
                    g[r] = history[r, i * dim + j] - one
    if plastic:  # F G - 1 = H + H (G - 1) + (G - 1)
        for i in range(dim):
            for j in range(dim):
                s, h, g = M[i, j], H[i, j], C[i, j]
                for r in range(n):
                    s[r] = h[r] + g[r]
                for k in range(dim):
                    _add_product(H[i, k], C[k, j], s, n)
        for i in range(dim):
            for j in range(dim):
                H[i, j, :n] = M[i, j, :n]
    for i in range(dim):  # C - 1 = H + H^T + H^T H
        for j in range(i, dim):
            s, a, b = C[i, j], H[i, j], H[j, i]
            for r in range(n):
                s[r] = a[r] + b[r]
            for k in range(dim):
                _add_product(H[k, i], H[k, j], s, n)
    _diagonalise(C, N, n)
    for a in range(dim):
        square, length = C[a, a], stretch[a]
        _half_logarithm(square, strain[a], n)
        for r in range(n):
            length[r] = np.sqrt(1.0 + square[r])
        for i in range(dim):
            s, b = now[i, a], N[i, a]
            for r in range(n):
                s[r] = b[r]
            for k in range(dim):
                _add_product(H[i, k], N[k, a], s, n)
            for r in range(n):
                s[r] /= length[r]
            s, b = M[i, a], N[i, a]
            for r in range(n):
                s[r] = 0.0 if plastic else b[r]
            if plastic:
                for k in range(dim):
                    b = N[k, a]
                    for r in range(n):
                        s[r] += history[r, i * dim + k] * b[r]


@compiled
def _add_product(x, y, out, n):
    for r in range(n):
        out[r] += x[r] * y[r]


def symmetric_axes(S: Float) -> tuple[Float, Float]:
    """Compute unsorted principal values (n, dim) and directions, columns of (n, dim, dim), of symmetric tensors."""
    values, N = np.empty(S.shape[:2]), np.empty_like(S)
    _symmetric_axes(S, values, N)
    return values, N


@compiled
def _symmetric_axes(S, values, N):
    dim = S.shape[1]
    frame = new_frame(dim)
    for first in range(0, len(S), BLOCK):
        n = min(BLOCK, len(S) - first)
        for i in range(dim):
            for j in range(dim):
                for r in range(n):
                    frame.C[i, j, r] = S[first + r, i, j]
        _diagonalise(frame.C, frame.N, n)
        for i in range(dim):
            for r in range(n):
                values[first + r, i] = frame.C[i, i, r]
            for j in range(dim):
                for r in range(n):
                    N[first + r, i, j] = frame.N[i, j, r]


@compiled
def _diagonalise(S, N, n):
    """Diagonalise the upper half of S (dim, dim, BLOCK) by rotations; write the principal directions."""
    dim = S.shape[0]
    cosine, sine = np.empty(BLOCK), np.empty(BLOCK)
    for i in range(dim):
        for j in range(dim):
            N[i, j, :n] = 1.0 if i == j else 0.0
    for _ in range(SWEEPS):
        left = 0.0
        for i in range(dim):
            for j in range(i + 1, dim):
                o, p, q = S[i, j], S[i, i], S[j, j]
                for r in range(n):
                    size = abs(o[r])
                    left += size if size > 1e-17 * (abs(p[r]) + abs(q[r])) else 0.0
        if left == 0.0:
            break
        for i in range(dim):
            for j in range(i + 1, dim):
                _angle(S[i, i], S[j, j], S[i, j], cosine, sine, n)
                for k in range(dim):
                    if k != i and k != j:
                        _rotate(S[min(k, i), max(k, i)], S[min(k, j), max(k, j)], cosine, sine, n)
                    _rotate(N[k, i], N[k, j], cosine, sine, n)


@compiled
def _angle(p, q, o, cosine, sine, n):
    """Write the rotation that makes ``o`` zero for the diagonal entries p and q, and rotate these three."""
    for r in range(n):
        apart, twice = q[r] - p[r], 2.0 * o[r]
        t = twice / (abs(apart) + np.sqrt(apart * apart + twice * twice) + 1e-300)
        t = t if apart >= 0.0 else -t
        p[r] -= t * o[r]
        q[r] += t * o[r]
        o[r] = 0.0
        cosine[r] = 1.0 / np.sqrt(1.0 + t * t)
        sine[r] = t * cosine[r]


@compiled
def _rotate(a, b, cosine, sine, n):
    for r in range(n):
        x, y = a[r], b[r]
        a[r] = cosine[r] * x - sine[r] * y
        b[r] = sine[r] * x + cosine[r] * y


@compiled
def _half_logarithm(x, y, n):
    """Write ``y = 1/2 ln(1 + x) = artanh(x / (2 + x))``."""
    far = 0.0
    for r in range(n):
        far += 0.0 if abs(x[r]) < NEAR else 1.0
    if far > 0.0:
        for r in range(n):
            y[r] = 0.5 * np.log1p(x[r])
        return
    for r in range(n):
        z = x[r] / (2.0 + x[r])
        y[r] = z * _series(z * z)


@compiled
def _series(square):
    """Return ``artanh(z) / z`` for a small square of z."""
    value = 1.0 / (2.0 * TERMS + 1.0)
    for k in range(TERMS - 1, -1, -1):
        value = 1.0 / (2.0 * k + 1.0) + square * value
    return value


@compiled
def _dot(x, y, out, n):
    """Write ``out = sum_a x_a y_a`` of rows x and y (dim, BLOCK), in one loop that stores ``out`` once."""
    x0, y0 = x[0], y[0]
    if len(x) == 3:
        x1, y1, x2, y2 = x[1], y[1], x[2], y[2]
        for r in range(n):
            out[r] = x0[r] * y0[r] + x1[r] * y1[r] + x2[r] * y2[r]
    elif len(x) == 2:
        x1, y1 = x[1], y[1]
        for r in range(n):
            out[r] = x0[r] * y0[r] + x1[r] * y1[r]
    else:
        for r in range(n):
            out[r] = x0[r] * y0[r]


@compiled
def outer_products(factor, left, right, out, n):
    """Write ``out_ij = sum_a factor_a left_ia right_ja`` (dim, dim, BLOCK); ``left`` is changed."""
    dim = len(out)
    for i in range(dim):
        for a in range(dim):
            f, x = factor[a], left[i, a]
            for r in range(n):
                x[r] *= f[r]
        for j in range(dim):
            _dot(left[i], right[j], out[i, j], n)


@compiled
def write_stress(tau, points, frame, P):
    """Write ``P = sum_a tau_a / l_a n_a (x) M_a`` at points of P (all points, dim, dim); changes tau (3, BLOCK)."""
    dim, n, out = P.shape[1], points.size, frame.C
    for a in range(dim):
        f, length = tau[a], frame.stretch[a]
        for r in range(n):
            f[r] /= length[r]
    outer_products(tau, frame.n, frame.M, out, n)
    for i in range(dim):
        for j in range(dim):
            s = out[i, j]
            for r in range(n):
                P[points[r], i, j] = s[r]


@compiled
def unload(elastic, frame, history):
    """Overwrite G with ``F^-1 V_e = G (F G)^-1 V_e``, with the elastic strains (3, BLOCK) of V_e after the return."""
    dim, n, out, factor = frame.N.shape[0], len(history), frame.C, np.empty_like(frame.stretch)
    for a in range(dim):
        f, e, length = factor[a], elastic[a], frame.stretch[a]
        for r in range(n):
            f[r] = np.exp(e[r]) / length[r]
    outer_products(factor, frame.M, frame.n, out, n)
    for i in range(dim):
        for j in range(dim):
            s = out[i, j]
            for r in range(n):
                history[r, i * dim + j] = s[r]


@compiled
def _shear(tau, shear, stretch, a, b, same, swapped, n):
    """Write ``A_abab`` and ``A_abba`` of ``write_tangent``."""
    t, o, f, x, y = tau[a], tau[b], shear[a, b], stretch[a], stretch[b]
    far = 0.0
    for r in range(n):
        far += 0.0 if abs(x[r] - y[r]) < NEAR * y[r] else 1.0
    for r in range(n):
        apart = (x[r] - y[r]) / y[r]
        z = apart / (2.0 + apart)
        same[r] = 2.0 / (2.0 + apart) * _series(z * z)
    if far > 0.0:
        for r in range(n):
            apart = (x[r] - y[r]) / y[r]
            if abs(apart) >= NEAR:
                same[r] = np.log1p(apart) / apart
    for r in range(n):
        difference = (f[r] * same[r] - o[r]) / (x[r] * y[r])
        total = (t[r] / x[r] + o[r] / y[r]) / (x[r] + y[r])
        same[r] = 0.5 * (difference + total)
        swapped[r] = 0.5 * (difference - total)


@compiled
def write_tangent(tau, moduli, shear, points, frame, A):
    """Write ``A = dP/dF`` of ``P = sum_a tau_a / l_a n_a (x) M_a`` at points of A (all points, dim, dim, dim, dim).

    ``moduli`` (dim, dim, BLOCK) is ``d tau_a / d eps_b`` and is overwritten, ``shear`` are the factors in
    ``tau_a - tau_b = shear_ab (eps_a - eps_b)``, with logarithmic strains eps of the stretches l. With
    ``p_a = tau_a / l_a`` and axes n and M the only entries are::

        A_aabb = moduli_ab / (l_a l_b) - delta_ab tau_a / l_a^2
        A_abab = (m + q) / 2,  A_abba = (m - q) / 2,   m = (p_a - p_b) / (l_a - l_b),  q = (p_a + p_b) / (l_a + l_b)

    with m in a form that is accurate for nearly equal stretches. The entries of two indices i and k are ``M Q^T M^T``
    with ``Q_ba = A_aabb n_ia n_kb + A_baab n_ib n_ka`` and, on its diagonal, ``sum_a A_abab n_ia n_ka``.
    """
    dim, n = A.shape[1], points.size
    now, M, stretch = frame.n, frame.M, frame.stretch
    same, swapped, Q, Z = np.empty_like(M), np.empty_like(M), np.empty_like(M), np.empty_like(M)
    row = np.empty(BLOCK)
    for a in range(dim):
        for b in range(dim):
            s, x, y = moduli[a, b], stretch[a], stretch[b]
            for r in range(n):
                s[r] /= x[r] * y[r]
            if a == b:
                t = tau[a]
                for r in range(n):
                    s[r] -= t[r] / (x[r] * x[r])
            else:
                _shear(tau, shear, stretch, a, b, same[a, b], swapped[a, b], n)
    for i in range(dim):
        for k in range(dim):
            for a in range(dim):
                for b in range(dim):
                    s, f, x, y = Q[b, a], moduli[a, b], now[i, a], now[k, b]
                    for r in range(n):
                        s[r] = f[r] * x[r] * y[r]
                    if a != b:
                        f, x, y = swapped[b, a], now[i, b], now[k, a]
                        for r in range(n):
                            s[r] += f[r] * x[r] * y[r]
            for b in range(dim):
                s = Q[b, b]
                for a in range(dim):
                    if a != b:
                        f, x, y = same[a, b], now[i, a], now[k, a]
                        for r in range(n):
                            s[r] += f[r] * x[r] * y[r]
            for m in range(dim):
                for b in range(dim):
                    _dot(M[m], Q[b], Z[m, b], n)
            for m in range(dim):
                for o in range(dim):
                    _dot(Z[m], M[o], row, n)
                    for r in range(n):
                        A[points[r], i, m, k, o] = row[r]
