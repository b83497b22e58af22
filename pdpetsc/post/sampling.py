"""Values of a field between particles."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from pdpetsc.arrays import Float, LocalIndex, Mask
from pdpetsc.errors import CaseError

# Nearest particles that a value is fitted to, by the dimension of the body.
FITTED = {1: 4, 2: 10, 3: 24}
# Singular values below this share of the largest belong to directions in which the particles do not differ.
FLAT = 1e-8
# Particles fix a slope in as many directions as singular values of their fit are above this share of the largest; they
# lie in as many as moments of the directions to them are above the second.
THIN, SPREAD = 1e-3, 0.1
# At most so many nearest particles are looked at for one point, and so many for all points at once.
MOST, AT_ONCE = 4096, 1_000_000
# One beyond a point that is far from its nearest particle is looked for among so many times those of a fit, where
# the cosine to the direction from that one is above the second.
AROUND, OPPOSITE = 8, 0.0
# Over the distance of a particle from its nearest neighbour, how far values of the field reach from it.
FARTHEST = 1.5


def line(start: Sequence[float], end: Sequence[float], n: int = 101) -> Float:
    """Return ``n`` points evenly from start to end, both included (n, d) [length], for ``Result.sample``.

    Raises
    ------
    CaseError
        The ends have different numbers of coordinates or are not finite, or n is less than 2.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> pd.line((0.0, 1.0), (4.0, 1.0), 3)
    array([[0., 1.],
           [2., 1.],
           [4., 1.]])
    """
    a, b = (np.atleast_1d(np.asarray(point, dtype=float)) for point in (start, end))
    if a.shape != b.shape or a.ndim != 1 or not 1 <= len(a) <= 3 or not np.isfinite([a, b]).all():
        raise CaseError(f"A line goes from one point to another one, of as many coordinates, not {start} to {end}.")
    if isinstance(n, bool) or int(n) != n or n < 2:
        raise CaseError(f"A line takes at least two points, not {n}.")
    return np.asarray(np.linspace(a, b, int(n)))


def grid(low: Sequence[float], high: Sequence[float], n: Sequence[int]) -> Float:
    """Return the points of a regular grid (n[0] n[1] ..., d) [length], for ``Result.sample``, the last axis fastest.

    ``values.reshape(*n, ...)`` of what is sampled there has an axis for each direction of the grid.

    Parameters
    ----------
    low, high : (d,) floats
        Opposite corners, both included [length].
    n : (d,) ints
        Points along each axis.

    Raises
    ------
    CaseError
        The corners or numbers do not fit together.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> points = pd.grid((0.0, 0.0), (4.0, 1.0), (5, 3))
    >>> points.shape, points[1]
    ((15, 2), array([0. , 0.5]))
    """
    a, b = (np.atleast_1d(np.asarray(point, dtype=float)) for point in (low, high))
    counts = np.atleast_1d(np.asarray(n))
    whole = counts.dtype.kind in "iu" and counts.ndim == 1 and bool((counts >= 1).all())
    if not (whole and a.shape == b.shape == counts.shape and 1 <= len(a) <= 3 and np.isfinite([a, b]).all()):
        raise CaseError(f"A grid takes two corners and a number of points for each axis, not {low}, {high} and {n}.")
    axes = [np.linspace(*ends) for ends in zip(a, b, counts.tolist(), strict=True)]
    return np.asarray(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(a)))


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
        Where it is asked for [length], with as many coordinates as the body has directions, or three; (m,) is a list of
        places along a line body. May be empty.

    Returns
    -------
    (m, ...) float64
        nan at points that are farther from their nearest particle than 1.5 times the distance of that one from its own
        nearest neighbour, so far holes between the particles of a shaken cloud may reach, unless another one lies as
        near beyond them: nearer than 1.5 times the distance in which one of both has neighbours in all directions, as
        in lattices of long cells and where the size of cells changes. Points of three coordinates
        that lie off a line or plane body by more than that distance have nan too.

    Raises
    ------
    CaseError
        The points have another number of coordinates or are not finite, or one particle alone, which has a value only
        where it is, is asked for one elsewhere.
    """
    axes = np.flatnonzero(np.ptp(x, axis=0) > 0.0)
    given = np.asarray(points, dtype=float)
    if given.size == 0:
        return np.empty((0, *np.shape(values)[1:]))
    if given.ndim < 2:
        # One number after another are places along a line; else they are the coordinates of one point.
        given = given.reshape((-1, 1) if len(axes) == 1 else (1, -1))
    # What number of directions one particle has is not known from where it is.
    allowed = (3, len(axes)) if len(x) > 1 else (1, 2, 3)
    if given.ndim != 2 or given.shape[1] not in allowed:
        shape = "x".join(str(n) for n in given.shape)
        raise CaseError(
            f"Points of a body of {len(axes)} dimensions have {len(axes)} or 3 coordinates each, not {shape}."
        )
    bad = np.flatnonzero(~np.isfinite(given).all(axis=1))
    if len(bad):
        raise CaseError(f"{len(bad)} points are not finite, the first is {given[bad[0]]}; take them out.")
    if len(x) == 1:
        return _of_one(x, values, given)
    at = given if given.shape[1] == len(axes) else given[:, axes]
    inside, dim = x[:, axes], len(axes)
    tree = cKDTree(inside)
    found = np.full((len(at), *np.shape(values)[1:]), np.nan)
    nearest, first = tree.query(at, k=1)
    spacing = tree.query(inside[first], k=2)[0][:, 1]
    outside = nearest > FARTHEST * spacing
    rank = np.linalg.matrix_rank(inside - inside.mean(axis=0), tol=FLAT * float(np.ptp(inside, axis=0).max()))
    todo, most = np.arange(len(at)), min(FITTED[dim], len(x))
    while len(todo):
        kept = list[Float]()
        for part in np.array_split(todo, 1 + len(todo) * most // AT_ONCE):
            distance, near = (one.reshape(len(part), -1) for one in tree.query(at[part], k=most))
            fit, spans = _fits(inside[near] - at[part, None], distance, 1 + int(rank))
            away, there = (at[part] - inside[first[part]])[:, None], inside[near] - at[part, None]
            beyond = (there * away).sum(axis=2) > OPPOSITE * distance * nearest[part, None]
            beyond &= distance > FLAT * distance[:, -1:]
            # Far from the nearest particle a place is still inside where one lies as near on its other side.
            opposite = np.where(beyond, distance, np.inf).min(axis=1)
            between = np.isfinite(opposite) | ~outside[part] | (most >= AROUND * FITTED[dim])
            done = (spans & between) | (most == len(x)) | (2 * most > MOST)
            here = part[done]
            fit[~spans] = np.nan
            found[here] = np.einsum("me,me...->m...", fit[done], values[near[done]])
            far = outside[here]
            if far.any():
                across = near[done, np.where(beyond, distance, np.inf).argmin(axis=1)[done]][far]
                reach = np.maximum(_width(tree, first[here[far]], int(rank)), _width(tree, across, int(rank)))
                wide = np.maximum(nearest[here[far]], opposite[done][far])
                outside[here[far]] = wide > FARTHEST * reach
            kept.append(part[~done])
        todo, most = np.concatenate(kept).astype(np.int64), min(2 * most, len(x))
    if given.shape[1] == 3 and dim < 3:
        across = np.setdiff1d(np.arange(3), axes)
        outside |= np.linalg.norm(given[:, across] - x[0, across], axis=1) > spacing * (1.0 + FLAT)
    found[outside] = np.nan
    return np.asarray(found)


def _fits(xi: Float, distance: Float, rank: int) -> tuple[Float, Mask]:
    """Return the weights (m, k) of a linear fit at the origin of places (m, k, dim), and whether they fix it (m,)."""
    scale = np.maximum(distance[:, -1], np.finfo(float).tiny)[:, None]
    weight = np.exp(-((2.0 * distance / scale) ** 2))
    basis = weight[..., None] * np.concatenate([np.ones((*xi.shape[:2], 1)), xi / scale[..., None]], axis=2)
    size = np.linalg.svd(basis, compute_uv=False)
    return np.linalg.pinv(basis, rcond=FLAT)[:, 0] * weight, (size > THIN * size[:, :1]).sum(axis=1) >= rank


def _width(tree: cKDTree, of: LocalIndex, rank: int) -> Float:
    """Return how far the nearest neighbours of particles (m,) are that lie in all directions from it (m,) [length]."""
    found, todo, most = np.zeros(len(of)), np.arange(len(of)), min(4, tree.n)
    while len(todo):
        kept = list[LocalIndex]()
        for part in np.array_split(todo, 1 + len(todo) * most // AT_ONCE):
            distance, near = tree.query(tree.data[of[part]], k=most)
            xi = tree.data[near[:, 1:]] - tree.data[of[part], None]
            along = xi / np.maximum(distance[:, 1:, None], np.finfo(float).tiny)
            spread = np.linalg.eigvalsh(np.cumsum(along[..., :, None] * along[..., None, :], axis=1))[..., -rank]
            wide = spread > SPREAD
            done = wide[:, -1] | (most == tree.n) | (2 * most > MOST)
            found[part[done]] = np.where(wide[:, -1], distance[np.arange(len(part)), 1 + wide.argmax(axis=1)], 0.0)[
                done
            ]
            kept.append(part[~done])
        todo, most = np.concatenate(kept), min(2 * most, tree.n)
    return found


def _of_one(x: Float, values: Float, given: Float) -> Float:
    """Return the value of one particle at points (m, d), all of which are at it."""
    d = given.shape[1]
    apart = np.linalg.norm(given - x[0, :d], axis=1)
    far = np.flatnonzero(apart > FLAT * np.abs(x[0, :d]).max())
    if len(far):
        raise CaseError(
            f"A body of one particle has values at {x[0]} alone, not at {given[far[0]]}; ask for the field there."
        )
    return np.repeat(np.asarray(values, dtype=float), len(given), axis=0)
