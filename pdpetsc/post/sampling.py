"""Interpolation of a field between particles."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy

from pdpetsc.arrays import Float, GlobalIndex, Mask
from pdpetsc.errors import CaseError
from pdpetsc.post.point_location import Held, Inside

# Number of nearest particles in a fit, by the dimension of the body.
FITTED = {1: 4, 2: 10, 3: 24}
# Singular values below this share of the largest belong to directions without extent of the cloud.
FLAT = 1e-8
# The rank of a fit is the number of singular values above this share of the largest.
THIN = 1e-3
# Largest number of nearest particles searched for one point, and for all points at once.
MOST, AT_ONCE = 4096, 1_000_000


def line(start: Sequence[float], end: Sequence[float], n: int = 101) -> Float:
    """Return ``n`` equidistant points from start to end, both included (n, d) [length], for ``Result.sample``.

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

    ``values.reshape(*n, ...)`` of sampled values has an axis for each direction of the grid.

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


def rows_of_points(points: Any, x: Float) -> Float:
    """Return points as rows: a list of numbers is positions along a line body ``x`` (n, 3), else one point."""
    given = np.asarray(points, dtype=float)
    return given if given.ndim >= 2 else given.reshape((-1, 1) if len(_axes_of(x)) == 1 else (1, -1))


def _axes_of(x: Float) -> GlobalIndex:
    """Return the axes along which a body has an extent."""
    return np.flatnonzero(np.ptp(x, axis=0) > 0.0)


def sampled(x: Float, values: Float, points: Float, body: Inside, held: Held | None = None) -> Float:
    """Return a field at points by a weighted linear fit to the nearest particles.

    A linear field is exact. The fit uses only particles connected with the particle of the point, not those beyond a
    crack. If they are too few for a slope, the point has the value of its particle.

    Parameters
    ----------
    x : (n, 3) float64
        Positions of the particles in the undeformed body [length].
    values : (n, ...) float64
        The field there.
    points : (m, d) float64
        Positions in the undeformed body [length], with as many coordinates as the body has dimensions, or three; (m,)
        is a list of positions along a line body. May be empty.
    body : Inside
        Point location of the body, in its own dimension.
    held : Held, optional
        Connection of particles; by default all are connected.

    Returns
    -------
    (m, ...) float64
        nan outside of the body, also for points of three coordinates farther from a line or plane body than the size of
        its particles.

    Raises
    ------
    CaseError
        The points have a wrong number of coordinates or are not finite, or the body is a single particle and a point is
        not at it.
    """
    axes, given = _axes_of(x), rows_of_points(points, x)
    if given.size == 0:
        return np.empty((0, *np.shape(values)[1:]))
    columns = np.arange(len(body.sides))
    # The dimension of a single particle is not known from its position.
    allowed = (3, len(columns), len(axes)) if len(x) > 1 else (1, 2, 3)
    if given.ndim != 2 or given.shape[1] not in allowed:
        shape = "x".join(str(n) for n in given.shape)
        words = "3 coordinates" if len(columns) == 3 else f"{len(columns)} or 3 coordinates"
        raise CaseError(f"Points of a body of {len(columns)} dimensions have {words} each, not {shape}.")
    bad = np.flatnonzero(~np.isfinite(given).all(axis=1))
    if len(bad):
        raise CaseError(f"{len(bad)} points are not finite, the first is {given[bad[0]]}; take them out.")
    if len(x) == 1:
        return _of_one(x, values, given)
    if given.shape[1] == 3:
        at = given[:, columns]
    elif given.shape[1] == len(columns):
        at = given
    else:
        # Along the axes of the extent of a single row or layer.
        at = np.repeat(x[:1, columns], len(given), axis=0)
        at[:, np.searchsorted(columns, axes)] = given
    held = Held(x[:, columns]) if held is None else held
    homes = held.on_side(at, body.homes(at), body.sides)
    if given.shape[1] == 3:
        across = np.setdiff1d(np.arange(3), columns)
        off = np.linalg.norm(given[:, across] - x[0, across], axis=1) > body.size(homes) * (1.0 + FLAT)
        homes = np.where(off, -1, homes)
    found = np.full((len(at), *np.shape(values)[1:]), np.nan)
    within = np.flatnonzero(homes >= 0)
    # In units of the cell sides, distances of particles are equal in all directions.
    spread = np.isin(columns, axes)
    sides = body.sides[spread]
    found[within] = _fitted(
        x[:, axes] / sides, np.asarray(values, dtype=float), at[within][:, spread] / sides, homes[within], held
    )
    return found


def _fitted(x: Float, values: Float, at: Float, homes: GlobalIndex, held: Held) -> Float:
    """Return the linear fits (m, ...) at points (m, d) of particles (m,)."""
    found = np.array(values[homes])
    tree = scipy.spatial.cKDTree(x)
    rank = np.linalg.matrix_rank(x - x.mean(axis=0), tol=FLAT * float(np.ptp(x, axis=0).max()))
    todo, most = np.arange(len(at)), min(FITTED[x.shape[1]], len(x))
    while len(todo):
        rest = list[GlobalIndex]()
        for part in np.array_split(todo, 1 + len(todo) * most // AT_ONCE):
            distance, near = (one.reshape(len(part), -1) for one in tree.query(at[part], k=most))
            connected = held.connects(homes[part], near)
            fit, spans = _fits(x[near] - at[part, None], distance, connected, 1 + int(rank))
            found[part[spans]] = np.einsum("me,me...->m...", fit[spans], values[near[spans]])
            rest.append(part[~spans])
        if most == len(x) or 2 * most > MOST:
            break
        todo, most = np.concatenate(rest), min(2 * most, len(x))
    return found


def _fits(xi: Float, distance: Float, counts: Mask, rank: int) -> tuple[Float, Mask]:
    """Return the weights (m, k) of a linear fit at the origin of points (m, k, dim), and True if it is unique (m,)."""
    farthest = np.where(counts, distance, 0.0).max(axis=1)
    scale = np.maximum(farthest, np.finfo(float).tiny)[:, None]
    weight = np.where(counts, np.exp(-((2.0 * np.minimum(distance / scale, 1.0)) ** 2)), 0.0)
    basis = weight[..., None] * np.concatenate([np.ones((*xi.shape[:2], 1)), xi / scale[..., None]], axis=2)
    size = np.linalg.svd(basis, compute_uv=False)
    return np.linalg.pinv(basis, rcond=FLAT)[:, 0] * weight, (size > THIN * size[:, :1]).sum(axis=1) >= rank


def _of_one(x: Float, values: Float, given: Float) -> Float:
    """Return the value of a single particle at points (m, d), all at its position."""
    d = given.shape[1]
    apart = np.linalg.norm(given - x[0, :d], axis=1)
    far = np.flatnonzero(apart > FLAT * np.abs(x[0, :d]).max())
    if len(far):
        raise CaseError(
            f"A body of one particle has values at {x[0]} alone, not at {given[far[0]]}; ask for the field there."
        )
    return np.repeat(np.asarray(values, dtype=float), len(given), axis=0)
