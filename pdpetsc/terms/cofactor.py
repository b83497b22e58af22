"""Cofactors of deformation gradients, which turn areas."""

from __future__ import annotations

import numpy as np

from pdpetsc.arrays import Float

# Permutation symbols.
_TURN = np.array([[0.0, 1.0], [-1.0, 0.0]])
_TURNS = np.zeros((3, 3, 3))
_TURNS[[0, 1, 2], [1, 2, 0], [2, 0, 1]], _TURNS[[0, 2, 1], [2, 1, 0], [1, 0, 2]] = 1.0, -1.0


def cofactor(F: Float) -> Float:
    """Return ``cof F = det(F) F^-T`` (n, dim, dim) of F (n, dim, dim): an area A becomes ``cof(F) A``."""
    if F.shape[-1] == 1:
        return np.ones_like(F)
    if F.shape[-1] == 2:
        return np.asarray(np.einsum("ik,JL,nkL->niJ", _TURN, _TURN, F))
    return np.asarray(0.5 * np.einsum("iab,JMN,naM,nbN->niJ", _TURNS, _TURNS, F, F, optimize=True))


def cofactor_by_F(F: Float) -> Float:
    """Return the derivative of ``cof F`` by F (n, dim, dim, dim, dim)."""
    if F.shape[-1] == 3:
        return np.asarray(np.einsum("ikb,JLN,nbN->niJkL", _TURNS, _TURNS, F, optimize=True))
    same = np.einsum("ik,JL->iJkL", _TURN, _TURN) if F.shape[-1] == 2 else np.zeros((1, 1, 1, 1))
    return np.broadcast_to(same, (len(F), *same.shape))
