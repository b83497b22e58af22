"""Laws of logarithmic strain against a matrix logarithm of fifty digits, and points of one block beside each other."""

import mpmath
import numpy as np
import pytest

import pdpetsc as pd
from pdpetsc.kernels.principal_rows import symmetric_axes

SIZES = [1e-9, 1e-4, 0.05, 0.3, 0.9]


def kirchhoff(F, lam, mu):
    """Return ``P = tau F^-T`` of Hencky's law in fifty digits."""
    with mpmath.workdps(50):
        F = mpmath.matrix(F.tolist())
        strain = mpmath.logm(F * F.T) / 2
        tau = 2 * mu * strain + lam * sum(strain[i, i] for i in range(F.rows)) * mpmath.eye(F.rows)
        P = tau * (F**-1).T
        return np.array([[float(mpmath.re(P[i, j])) for j in range(F.rows)] for i in range(F.rows)])


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("dim", [1, 2, 3])
def test_stress_of_hencky_has_all_digits_at_any_strain(dim, size, rng):
    law = pd.Hencky(E=1.0, nu=0.3)
    F = np.eye(dim) + rng.uniform(-size, size, (4, dim, dim)) / dim
    P = np.empty_like(F)
    law.kernels(dim).stress(F, np.arange(4), law.constants(dim), P)
    lam, mu = law.lame(dim)
    exact = np.array([kirchhoff(one, lam, mu) for one in F])
    assert np.abs(P - exact).max() < 1e-12 * np.abs(exact).max()


@pytest.mark.parametrize("name", ["hencky", "linear hardening", "any hardening"])
@pytest.mark.parametrize("dim", [1, 2, 3])
def test_a_point_does_not_see_the_others_of_its_block(dim, name, rng):
    """Points of every size of strain, more than a block of them, undeformed ones and equal stretches among them."""
    law = {
        "hencky": pd.Hencky(E=1.0, nu=0.3),
        "linear hardening": pd.J2(E=1.0, nu=0.3, yield_stress=1e-3, hardening=0.01),
        "any hardening": pd.J2(E=1.0, nu=0.3, yield_stress=1e-3, hardening=pd.hardening.Voce(0.01, 16.0)),
    }[name]
    n = 300
    F = np.eye(dim) + rng.choice([0.0, *SIZES], n)[:, None, None] * rng.uniform(-0.4, 0.4, (n, dim, dim))
    F[::7] = 1.3 * np.eye(dim)
    select, kernels, constants = rng.permutation(n), law.history_kernels(dim), law.constants(dim)
    history = law.history_at(dim, np.zeros((n, dim)))
    kernels.commit(F[rng.permutation(n)], select, constants, history)
    together, alone = [], []
    for found, parts in ((together, [np.arange(n)]), (alone, np.arange(n)[:, None])):
        P, A, psi, after = np.zeros_like(F), np.zeros((n, *(dim,) * 4)), np.zeros(n), history.copy()
        for rows in parts:
            given = F, np.ascontiguousarray(select[rows]), constants
            kernels.stress(*given, after[rows], P)
            kernels.tangent(*given, after[rows], A)
            kernels.energy(*given, after[rows], psi)
            kept = after[rows]
            kernels.commit(*given, kept)
            after[rows] = kept
        found += [P, A, psi, after]
    for one, other in zip(together, alone, strict=True):
        assert np.allclose(one, other, rtol=1e-12, atol=1e-12 * np.abs(one).max(initial=0.0))


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_axes_of_symmetric_tensors_put_them_together_again(dim, rng):
    """Of any size, with equal values, one entry alone, and zero."""
    S = rng.standard_normal((300, dim, dim)) * 10.0 ** rng.integers(-12, 12, 300)[:, None, None]
    S[::5] = np.eye(dim)
    S[1::5] *= np.eye(dim)
    S[2::50] = 0.0
    S += S.transpose(0, 2, 1)
    values, N = symmetric_axes(S)
    size = 1e-14 * np.abs(S).max(axis=(1, 2), keepdims=True)
    assert (np.abs(np.einsum("pia,pa,pja->pij", N, values, N) - S) <= 4.0 * size).all()
    assert np.abs(np.einsum("pia,pib->pab", N, N) - np.eye(dim)).max() < 1e-14
    assert (np.abs(np.sort(values) - np.linalg.eigvalsh(S)) <= 4.0 * size[:, 0]).all()
