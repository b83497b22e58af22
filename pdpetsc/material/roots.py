"""Roots of many scalar functions at once, for the local iterations of laws with history."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex

# Largest number of steps. A step is a bisection if the Newton step leaves the interval.
STEPS = 200
# Relative tolerance of a zero, and the larger tolerance of a stalled iteration.
ZERO, STALLED = 4.0 * float(np.finfo(float).eps), 1e-11
# Relative value of a rising function after which one more Newton step suffices.
NEAR = 1e-9

Function = Callable[[Float, GlobalIndex], tuple[Float, Float]]
Scaled = Callable[[Float, GlobalIndex], tuple[Float, Float, Float]]


def falling_roots(function: Function, start: Float, high: Float, scale: Float) -> Float:
    """Compute the roots of falling functions by Newton's method in a shrinking interval.

    Parameters
    ----------
    function : callable
        ``function(x, rows)`` returns values and slopes of the functions ``rows`` (int64) at x, one for each.
    start : (n,) float64
        Initial values, within the interval.
    high : (n,) float64
        Upper end of the interval from 0, where the functions are not positive.
    scale : (n,) float64
        Scales of the values.

    Returns
    -------
    (n,) float64
        The roots; NaN if the iteration fails.
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
    """Compute the roots of rising functions by Newton's method; every iterate bounds the root.

    Parameters
    ----------
    function : callable
        ``function(x, rows)`` returns values, slopes and scales of the functions ``rows`` (int64) at x.
    start : (n,) float64
        Initial values.
    steepest : float
        Approximate largest slope, for a step if the Newton step is useless and a bound is missing.

    Returns
    -------
    (n,) float64
        The roots; NaN if the iteration fails.
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
        # A NaN value makes x NaN.
        rows = rows[left & ~near & np.isfinite(value)]
        if not len(rows):
            return x
    x[rows] = np.nan
    return x
