"""Loops around laws in principal logarithmic strains: from F to trial strains, and from principal values to P and A."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from pdpetsc.kernels.compile import compiled
from pdpetsc.kernels.principal_rows import BLOCK, new_frame, open_frame, unload, write_stress, write_tangent


class Trial(NamedTuple):
    """Trial strains of points, with data for stress and tangent.

    Attributes
    ----------
    strain : (n, 3) float64
        Logarithmic strains of ``F G`` [-], 0 in hidden directions.
    stretch : (n, dim) float64
        Stretches [-].
    n, M : (n, dim, dim) float64
        Principal directions in columns: in the current state, and ``G N`` for those in the unloaded state.
    """

    strain: Any
    stretch: Any
    n: Any
    M: Any


def trial(F: Any, select: Any, history: Any) -> Trial:
    """Return the trial strains at points of F (all points, dim, dim).

    Rows of ``history`` begin with ``G = F_p^-1``; without columns G is the identity.
    """
    n, dim = len(select), F.shape[-1]
    found = Trial(np.zeros((n, 3)), np.empty((n, dim)), np.empty((n, dim, dim)), np.empty((n, dim, dim)))
    _trial(F, select, history, found)
    return found


@compiled
def _trial(F, select, history, found):
    frame, dim = new_frame(F.shape[1]), F.shape[1]
    for first in range(0, select.size, BLOCK):
        points = select[first : first + BLOCK]
        open_frame(F, points, history[first : first + BLOCK], frame)
        for a in range(dim):
            for r in range(points.size):
                found.strain[first + r, a] = frame.strain[a, r]
                found.stretch[first + r, a] = frame.stretch[a, r]
            for i in range(dim):
                for r in range(points.size):
                    found.n[first + r, i, a] = frame.n[i, a, r]
                    found.M[first + r, i, a] = frame.M[i, a, r]


@compiled
def _frame(trial, first, last, frame):
    """Copy the points ``first`` to ``last`` of ``trial``."""
    dim = frame.n.shape[0]
    for a in range(dim):
        for r in range(last - first):
            frame.stretch[a, r] = trial.stretch[first + r, a]
        for i in range(dim):
            for r in range(last - first):
                frame.n[i, a, r] = trial.n[first + r, i, a]
                frame.M[i, a, r] = trial.M[first + r, i, a]


@compiled
def stress(select, tau, trial, P):
    """Write P at points of P (all points, dim, dim) from principal Kirchhoff stresses (n, dim or 3)."""
    frame = new_frame(P.shape[1])
    for first in range(0, select.size, BLOCK):
        points = select[first : first + BLOCK]
        _frame(trial, first, first + points.size, frame)
        _rows(tau, first, points.size, frame.strain)
        write_stress(frame.strain, points, frame, P)


@compiled
def _rows(values, first, n, rows):
    """Write values (all, k) of a block of points as rows."""
    for a in range(values.shape[1]):
        for r in range(n):
            rows[a, r] = values[first + r, a]


@compiled
def tangent(select, tau, moduli, shear, trial, A):
    """Write A at points of A (all points, dim, dim, dim, dim).

    ``moduli`` (n, k, k) is ``d tau_a / d eps_b``, ``shear`` (n, dim, dim) ``(tau_a - tau_b) / (eps_a - eps_b)``.
    """
    dim, frame = A.shape[1], new_frame(A.shape[1])
    slopes, factors = np.empty_like(frame.M), np.empty_like(frame.M)
    for first in range(0, select.size, BLOCK):
        points = select[first : first + BLOCK]
        _frame(trial, first, first + points.size, frame)
        _rows(tau, first, points.size, frame.strain)
        for a in range(dim):
            for b in range(dim):
                for r in range(points.size):
                    slopes[a, b, r] = moduli[first + r, a, b]
                    factors[a, b, r] = shear[first + r, a, b]
        write_tangent(frame.strain, slopes, factors, points, frame, A)


@compiled
def commit(history, elastic, trial):
    """Update G, at the beginning of rows of ``history``, for elastic strains (n, 3)."""
    frame = new_frame(trial.n.shape[1])
    for first in range(0, len(history), BLOCK):
        block = history[first : first + BLOCK]
        _frame(trial, first, first + len(block), frame)
        _rows(elastic, first, len(block), frame.strain)
        unload(frame.strain, frame, block)
