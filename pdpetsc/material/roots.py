"""Roots of many functions of one number at once: the local iterations of laws with history."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex

# Largest number of steps; each at least halves what is left of the interval where Newton's leaves it.
STEPS = 200
# A function is zero below this share of its scale; one that has stalled counts below the second.
ZERO, STALLED = 4.0 * float(np.finfo(float).eps), 1e-11
# A rising function whose value is below this share of its scale vanishes after one more step of Newton's method.
NEAR = 1e-9

Function = Callable[[Float, GlobalIndex], tuple[Float, Float]]
Scaled = Callable[[Float, GlobalIndex], tuple[Float, Float, Float]]


def falling_roots(function: Function, start: Float, high: Float, scale: Float) -> Float:
    """Return where falling functions vanish, by Newton's method inside of an interval that shrinks.

    Parameters
    ----------
    function : callable
        ``function(x, rows)`` returns values and slopes of the functions ``rows`` (int64) at x, one for each.
    start : (n,) float64
        Where to begin, within the interval.
    high : (n,) float64
        Upper end of the interval from 0, where the functions are not positive.
    scale : (n,) float64
        What a value is compared with.

    Returns
    -------
    (n,) float64
        The roots; NaN where none was found.
    """
    x, low, high = np.array(start, dtype=float), np.zeros(len(start)), np.array(high, dtype=float)
    rows = np.arange(len(x))
    value = np.zeros(0)
    for _ in range(STEPS):
        value, slope = function(x[rows], rows)
        left = ~(np.abs(value) <= ZERO * scale[rows]) & (high[rows] - low[rows] > ZERO * high[rows])
        rows, value, slope = rows[left], value[left], slope[left]
        if not len(rows):
            return x
        above = value > 0.0
        low[rows[above]] = x[rows[above]]
        high[rows[~above]] = x[rows[~above]]
        with np.errstate(all="ignore"):
            moved = x[rows] - value / slope
        middle = 0.5 * (low[rows] + high[rows])
        inside = (moved > low[rows]) & (moved < high[rows])
        x[rows] = np.where(inside, moved, middle)
    value, _ = function(x[rows], rows)
    x[rows[~(np.abs(value) <= STALLED * scale[rows])]] = np.nan
    return x


def rising_roots(function: Scaled, start: Float, steepest: float) -> Float:
    """Return where rising functions vanish, by Newton's method; every value tried bounds the root.

    Parameters
    ----------
    function : callable
        ``function(x, rows)`` returns values, slopes and scales of the functions ``rows`` (int64) at x.
    start : (n,) float64
        Where to begin.
    steepest : float
        About the largest slope, for the step where Newton's is of no use and one bound is missing.

    Returns
    -------
    (n,) float64
        The roots; NaN where none was found.
    """
    x, low, high = np.array(start, dtype=float), np.full(len(start), -np.inf), np.full(len(start), np.inf)
    rows = np.arange(len(x))
    for _ in range(STEPS):
        value, slope, scale = function(x[rows], rows)
        low[rows] = np.where(value < 0.0, np.maximum(low[rows], x[rows]), low[rows])
        high[rows] = np.where(value > 0.0, np.minimum(high[rows], x[rows]), high[rows])
        with np.errstate(all="ignore"):
            moved = x[rows] - value / slope
            near = np.abs(value) <= NEAR * scale
            inside = ((moved > low[rows]) & (moved < high[rows])) | (near & np.isfinite(moved))
            middle = 0.5 * (low[rows] + high[rows])
            shortest = x[rows] - value / steepest
        left = value != 0.0
        moved = np.where(inside, moved, np.where(np.isfinite(middle), middle, shortest))
        x[rows[left]] = moved[left]
        # A value that is no number leaves none in x.
        rows = rows[left & ~near & np.isfinite(value)]
        if not len(rows):
            return x
    x[rows] = np.nan
    return x
