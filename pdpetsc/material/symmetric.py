"""Symmetric tensors as vectors ``11, 22, 33, 23, 13, 12``, and stiffnesses as matrices over them."""

from __future__ import annotations

import math

import numpy as np

from pdpetsc.arrays import Float

# Indices of the components, and the component of each pair of indices.
FIRST, SECOND = np.array([0, 1, 2, 1, 0, 0]), np.array([0, 1, 2, 2, 2, 1])
PLACE = np.array([[0, 5, 4], [5, 1, 3], [4, 3, 2]])
# Weights for which scalar products of vectors equal those of tensors.
WEIGHT = np.array([1.0, 1.0, 1.0, *3 * [math.sqrt(2.0)]])
# Strain components of bodies by dimension.
SHOWN = {1: [0], 2: [0, 1, 5], 3: [0, 1, 2, 3, 4, 5]}


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


def stiffness_of_body(solids: Float, dim: int, plane: str) -> Float:
    """Compute stiffness and out-of-plane coefficients of a body of ``dim`` dimensions (n, dim^4 + dim^2).

    The coefficients determine the out-of-plane stress in plane strain, the out-of-plane strain in plane stress, and the
    sum of both lateral strains of a bar. Free hidden strains make all hidden stresses zero.
    """
    C = matrix(solids)
    here = SHOWN[dim]
    across = np.zeros((len(C), len(here)))
    reduced = C[:, here][:, :, here]
    if dim == 2 and plane == "strain":
        across = C[:, 2, here]
    elif dim < 3:
        S = np.linalg.inv(C)
        reduced = np.linalg.inv(S[:, here][:, :, here])
        lateral = S[:, 2, here] if dim == 2 else S[:, 1, here] + S[:, 2, here]
        across = np.einsum("pa,pab->pb", lateral, reduced)
    # Index in the vector of each entry of a symmetric tensor of the body.
    flat = np.searchsorted(here, PLACE[:dim, :dim]).ravel()
    moduli = reduced[:, flat][:, :, flat].reshape(len(C), dim**4)
    return np.concatenate([moduli, across[:, flat]], axis=1)


def moduli_of_body(solid: Float, dim: int, plane: str) -> Float:
    """Return the moduli (dim, dim, dim, dim) of a body of ``dim`` dimensions from those of a solid (3, 3, 3, 3)."""
    return stiffness_of_body(solid[None], dim, plane)[0, : dim**4].reshape((dim,) * 4)
