"""Values of a field between particles."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from pdpetsc.arrays import Float
from pdpetsc.errors import CaseError

# Nearest particles that a value is fitted to, by the dimension of the body.
FITTED = {1: 4, 2: 10, 3: 24}
# Singular values below this share of the largest belong to directions in which the particles do not differ.
FLAT = 1e-8


def sampled(x: Float, values: Float, points: Float) -> Float:
    """Return a field at points, by a linear fit to the nearest particles, of which nearer ones count for more.

    A linear field is met exactly. Particles on both sides of a crack count alike.

    Parameters
    ----------
    x : (n, 3) float64
        Positions of the particles [length].
    values : (n, ...) float64
        The field there.
    points : (m, d) float64
        Where it is asked for [length], with as many coordinates as the body has directions, or three.

    Returns
    -------
    (m, ...) float64
        nan at points that are farther from every particle than that one is from its nearest neighbour.

    Raises
    ------
    CaseError
        The points have another number of coordinates.
    """
    axes = np.flatnonzero(np.ptp(x, axis=0) > 0.0)
    given = np.atleast_2d(np.asarray(points, dtype=float))
    if given.ndim != 2 or given.shape[1] not in (3, len(axes)):
        shape = "x".join(str(n) for n in given.shape)
        raise CaseError(
            f"Points of a body of {len(axes)} dimensions have {len(axes)} or 3 coordinates each, not {shape}."
        )
    at = given if given.shape[1] == len(axes) else given[:, axes]
    inside, dim = x[:, axes], len(axes)
    tree = cKDTree(inside)
    most = min(FITTED[dim], len(x))
    distance, near = tree.query(at, k=most)
    distance, near = distance.reshape(len(at), -1), near.reshape(len(at), -1)
    spacing = tree.query(inside[near[:, 0]], k=min(2, len(x)))[0].reshape(len(at), -1)[:, -1]
    scale = np.maximum(distance[:, -1], np.finfo(float).tiny)[:, None]
    weight = np.exp(-((2.0 * distance / scale) ** 2))
    basis = np.concatenate([np.ones((*near.shape, 1)), (inside[near] - at[:, None]) / scale[..., None]], axis=2)
    fit = np.linalg.pinv(weight[..., None] * basis, rcond=FLAT)[:, 0] * weight
    found = np.einsum("me,me...->m...", fit, values[near])
    found[distance[:, 0] > spacing * (1.0 + FLAT)] = np.nan
    return np.asarray(found)
