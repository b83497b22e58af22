"""Axes that rotate with the body, for schemes that divide families by direction."""

from __future__ import annotations

import itertools

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.communicator import total
from pdpetsc.discrete.families import Families

# A bond has the weight (1 / s - 1 / LONGEST)^4, with s its length over that of the shortest bond of its family.
LONGEST = 3.0
# Bonds with a larger cosine of their angle to an axis lie along it. Other bonds of a lattice have angles of 19 degrees
# and more.
ALONG = np.cos(np.radians(10.0))
# Smallest order of the bonds of a lattice. It is 0.8 to 1 for square and cubic lattices, 0.6 to 0.7 if their positions
# are perturbed by 0.2 spacings, 0.17 to 0.25 for body- and face-centred lattices, and less than 0.05 for irregular
# triangle meshes.
ORDERED = 0.1
# Relative tolerance: axes are unique if no other axes have the same order, or if the principal values differ.
DISTINCT = 1e-6
# Starts and sweeps of the search for axes in 3D, and the angle [rad] at which it ends.
STARTS, SWEEPS, CONVERGED = 24, 100, 1e-13


def body_axes(cloud: Cloud, families: Families, xi: Float) -> tuple[Float, str]:
    """Compute axes that rotate with the body, and a note for the log if the body has none (collective).

    The axes of a lattice are those along which its shortest bonds lie: ``e_a`` with the largest ``|order|``,

        order = ((dim + 2) <sum_a (n . e_a)^4> - 3) / (dim - 1),

    the weighted mean over unit bonds ``n``. The order is 1 if all bonds lie along the axes, and 0 if bonds have all
    directions. Each axis is then replaced by the mean of the bonds within 10 degrees of it. On a lattice these bonds
    lie along the axes, and other bonds, for example at an inclined face, have no influence. If the order is below
    ``ORDERED``, the cloud is irregular and has the principal axes of the body. If two principal values are equal, as
    for a disc, or the body is in a periodic cell, the function returns the coordinate axes.

    Parameters
    ----------
    cloud : Cloud
        Particles of this rank.
    families : Families
        Their bonds.
    xi : (n_bonds, dim) float64
        The bonds [length].

    Returns
    -------
    axes : (dim, dim) float64
        One axis per row, in the order and with the signs nearest to the coordinate axes.
    note : str
        Not empty if the coordinate axes replace missing ones; the same on all ranks.
    """
    dim = cloud.dim
    if dim == 1:
        return np.eye(1), ""
    axes = _lattice_axes(cloud, families, xi)
    if axes is None:
        axes = _principal_axes(cloud.spread)
    if axes is None:
        return np.eye(dim), "directions along the axes of space: neither the bonds nor the shape of the body has axes"
    return _nearest_to_space(axes), ""


def _lattice_axes(cloud: Cloud, families: Families, xi: Float) -> Float | None:
    """Compute the axes along which the shortest bonds lie; None if there are none (collective)."""
    dim, centres = cloud.dim, families.centres
    length = np.sqrt(np.einsum("bd,bd->b", xi, xi))
    shortest = np.full(cloud.n_owned, np.inf)
    np.minimum.at(shortest, centres, length)
    near = np.flatnonzero(length < LONGEST * shortest[centres])
    length, centres = length[near], centres[near]
    n, weight = xi[near] / length[:, None], (shortest[centres] / length - 1.0 / LONGEST) ** 4
    if cloud.stands_for is not None:
        weight *= cloud.stands_for[centres]
    squares = np.einsum("bi,bj->bij", n, n).reshape(len(n), dim * dim)
    T = _with_images(cloud, ((weight[:, None] * squares).T @ squares).reshape((dim,) * 4))
    all_weights = float(np.einsum("iijj", T)) or 1.0
    # Computed on one rank: rounding on different processors may select different axes if they are nearly unique.
    e: Float | None = cloud.comm.bcast(_axes_of_moments(T / all_weights) if cloud.comm.rank == 0 else None)
    if e is None:
        return None
    cosines = n @ e.T
    along = weight[:, None] * np.sign(cosines) * np.maximum(np.abs(cosines) - ALONG, 0.0) / (1.0 - ALONG)
    mean = e @ _with_images(cloud, e.T @ (along.T @ n)) / all_weights
    few = np.linalg.norm(mean, axis=1) < DISTINCT
    mean[few] = e[few]
    left, _, right = np.linalg.svd(mean / np.linalg.norm(mean, axis=1, keepdims=True))
    return np.asarray(left @ right)


def _with_images(cloud: Cloud, tensor: Float) -> Float:
    """Sum tensors over the ranks and average them over the body and its mirror images (collective)."""
    tensor = total(cloud.comm, tensor)
    for plane in cloud.places.planes:
        flipped = tensor.copy()
        for axis in range(tensor.ndim):
            np.moveaxis(flipped, axis, 0)[plane] *= -1.0
        tensor = 0.5 * (tensor + flipped)
    return tensor


def _principal_axes(moment: Float) -> Float | None:
    """Compute the principal axes of a second moment (dim, dim); None if two principal values are equal."""
    values, vectors = np.linalg.eigh(moment)
    return np.asarray(vectors.T) if np.diff(values).min() > DISTINCT * values[-1] else None


def _axes_of_moments(T: Float) -> Float | None:
    """Compute the axes of a lattice with moments (dim, dim, dim, dim); None if they do not exist or are not unique."""
    dim = len(T)
    # In the plane the axes of the smallest sum are those of the largest sum, rotated by 45 degrees.
    e = np.concatenate([_local_maxima(sign * T) for sign in ((1.0,) if dim == 2 else (1.0, -1.0))])
    order = np.abs(np.einsum("ijkl,sai,saj,sak,sal->s", T, e, e, e, e) * (dim + 2) - 3.0) / (dim - 1)
    best = int(np.argmax(order))
    cosines = np.abs(e[order > order[best] - DISTINCT] @ e[best].T).max(axis=2)
    return e[best] if order[best] > ORDERED and cosines.min() > 1.0 - DISTINCT else None


def _local_maxima(T: Float) -> Float:
    """Compute axes (n, dim, dim) at local maxima of ``sum_a T e_a e_a e_a e_a``, one for each of ``STARTS``.

    Each rotation in the plane of two axes leads to the maximum there, in closed form (Jacobi's method).
    """
    dim = len(T)
    e = np.linalg.qr(np.random.default_rng(1).standard_normal((STARTS, dim, dim)))[0]
    for _ in range(SWEEPS):
        largest = 0.0
        for p, q in itertools.combinations(range(dim), 2):
            a, b = e[:, p].copy(), e[:, q].copy()
            aa, bb = (np.einsum("ijkl,sk,sl->sij", T, one, one) for one in (a, b))
            aaaa, aaab, aabb = (np.einsum("sij,si,sj->s", aa, one, two) for one, two in ((a, a), (a, b), (b, b)))
            abbb, bbbb = (np.einsum("sij,si,sj->s", bb, one, b) for one in (a, b))
            angle = 0.25 * np.arctan2(4.0 * (aaab - abbb), aaaa + bbbb - 6.0 * aabb)
            c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
            e[:, p], e[:, q] = c * a + s * b, c * b - s * a
            largest = max(largest, float(np.abs(angle).max()))
        if largest < CONVERGED:
            break
    return np.asarray(e)


def _nearest_to_space(e: Float) -> Float:
    """Sort and sign the axes (dim, dim) so that they are nearest to the coordinate axes."""
    dim = len(e)
    # Perturbed coordinate axes: a lattice rotated by 45 degrees has two axes equally near to a coordinate axis.
    near = np.eye(dim) + 1e-3 * np.arange(dim * dim).reshape(dim, dim)
    cosines = e @ near.T
    best = max(itertools.permutations(range(dim)), key=lambda order: np.abs(cosines[order, range(dim)]).sum())
    return np.asarray(e[list(best)] * np.sign(cosines[best, range(dim)])[:, None])
