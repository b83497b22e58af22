"""Symmetric tensors as vectors ``11, 22, 33, 23, 13, 12``, and stiffnesses as matrices over them."""

from __future__ import annotations

import math

import numpy as np

from pdpetsc.arrays import Float

# Indices of the components, and the component of each pair of indices.
FIRST, SECOND = np.array([0, 1, 2, 1, 0, 0]), np.array([0, 1, 2, 2, 2, 1])
PLACE = np.array([[0, 5, 4], [5, 1, 3], [4, 3, 2]])
# With these weights scalar products of vectors are those of tensors.
WEIGHT = np.array([1.0, 1.0, 1.0, *3 * [math.sqrt(2.0)]])


def vector(tensor: Float) -> Float:
    """Return symmetric tensors (n, 3, 3) as vectors (n, 6)."""
    return np.asarray(np.take(tensor.reshape(len(tensor), 9), 3 * FIRST + SECOND, axis=1))


def tensor(vector: Float, dim: int = 3) -> Float:
    """Return vectors (n, 6) as symmetric tensors (n, dim, dim)."""
    return np.asarray(np.take(vector, PLACE[:dim, :dim], axis=1))


def matrix(stiffness: Float) -> Float:
    """Return stiffnesses (..., 3, 3, 3, 3) as matrices (..., 6, 6)."""
    return np.asarray(stiffness[..., FIRST[:, None], SECOND[:, None], FIRST, SECOND])


def stiffness(matrix: Float, dim: int = 3) -> Float:
    """Return matrices (..., 6, 6) as stiffnesses (..., dim, dim, dim, dim)."""
    place = PLACE[:dim, :dim]
    return np.asarray(np.take(matrix.reshape(*matrix.shape[:-2], 36), 6 * place[:, :, None, None] + place, axis=-1))
