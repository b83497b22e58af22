"""Radial return of J2 plasticity with linear hardening in closed form, with its kinematics in one loop.

It is ``material.j2`` for the most common hardening law, three times faster. A history contains G first, then the
out-of-plane elastic strain, and alpha last.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from pdpetsc.kernels.compile import compiled
from pdpetsc.kernels.principal_rows import BLOCK, new_frame, open_frame, unload, write_stress, write_tangent


class Returned(NamedTuple):
    """Result of the return for a block of points, one row per component.

    Attributes
    ----------
    tau, direction : (3, BLOCK) float64
        Principal Kirchhoff stresses [stress] and the unit direction of flow [-].
    theta, theta_bar, growth : (BLOCK,) float64
        Factors of the moduli [-], and growth of alpha [-].
    """

    tau: Any
    direction: Any
    theta: Any
    theta_bar: Any
    growth: Any


@compiled
def _new_returned():
    return Returned(np.zeros((3, BLOCK)), np.zeros((3, BLOCK)), np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK))


@compiled
def _return(F, points, history, constants, frame, back):
    """Compute the frames of points and return to the yield surface; the strains of the frame become elastic."""
    lam, mu, y, H = constants[0], constants[1], constants[2], constants[3]
    dim, n = F.shape[1], points.size
    open_frame(F, points, history, frame)
    one, two, three = frame.strain
    if dim == 2:
        for r in range(n):
            three[r] = history[r, 4]
    # A bar has one strain, with its own modulus for plastic flow.
    stiff, share, scale = (2.0 * mu, 0.0, 1.0) if dim == 1 else (3.0 * mu, 1.0 / 3.0, np.sqrt(1.5))
    last = history.shape[1] - 1
    for r in range(n):
        trace = one[r] + two[r] + three[r]
        mean = share * trace
        a, b, c = one[r] - mean, two[r] - mean, three[r] - mean
        size = np.sqrt(a * a + b * b + c * c)
        q, limit = 2.0 * mu * scale * size, y + H * history[r, last]
        flows = q > limit
        growth = (q - limit) / (stiff + H) if flows else 0.0
        theta = 1.0 - stiff * growth / q if flows else 1.0
        back.growth[r], back.theta[r] = growth, theta
        back.theta_bar[r] = stiff / (stiff + H) - (1.0 - theta) if flows else 0.0
        unit = 1.0 / size if size > 0.0 else 0.0
        back.direction[0, r], back.direction[1, r], back.direction[2, r] = unit * a, unit * b, unit * c
        one[r], two[r], three[r] = mean + theta * a, mean + theta * b, mean + theta * c
        back.tau[0, r] = lam * trace + 2.0 * mu * one[r]
        back.tau[1, r] = lam * trace + 2.0 * mu * two[r]
        back.tau[2, r] = lam * trace + 2.0 * mu * three[r]


@compiled
def linear_out_of_plane(F, constants, history, P):
    """Write the out-of-plane stress of every point of a body in plane strain."""
    select, frame, back = np.arange(len(F)), new_frame(2), _new_returned()
    for first in range(0, len(F), BLOCK):
        points = select[first : first + BLOCK]
        _return(F, points, history[first : first + BLOCK], constants, frame, back)
        P[first : first + BLOCK] = back.tau[2, : points.size]


@compiled
def _stress(F, select, constants, history, P):
    frame, back = new_frame(F.shape[1]), _new_returned()
    for first in range(0, select.size, BLOCK):
        points = select[first : first + BLOCK]
        _return(F, points, history[first : first + BLOCK], constants, frame, back)
        write_stress(back.tau, points, frame, P)


@compiled
def _tangent(F, select, constants, history, A):
    dim, mu, frame, back = F.shape[1], constants[1], new_frame(F.shape[1]), _new_returned()
    moduli, shear = np.empty_like(frame.M), np.empty_like(frame.M)
    third = 0.0 if dim == 1 else 1.0 / 3.0
    bulk = constants[0] + 2.0 * mu * third
    for first in range(0, select.size, BLOCK):
        points = select[first : first + BLOCK]
        _return(F, points, history[first : first + BLOCK], constants, frame, back)
        for a in range(dim):
            for b in range(dim):
                s, t, x, y = moduli[a, b], shear[a, b], back.direction[a], back.direction[b]
                for r in range(points.size):
                    t[r] = 2.0 * mu * back.theta[r]
                    s[r] = bulk - third * t[r] - 2.0 * mu * back.theta_bar[r] * x[r] * y[r]
                if a == b:
                    for r in range(points.size):
                        s[r] += t[r]
        write_tangent(back.tau, moduli, shear, points, frame, A)


@compiled
def _energy(F, select, constants, history, psi):
    lam, mu, y, H = constants[0], constants[1], constants[2], constants[3]
    frame, back, last = new_frame(F.shape[1]), _new_returned(), history.shape[1] - 1
    for first in range(0, select.size, BLOCK):
        points = select[first : first + BLOCK]
        _return(F, points, history[first : first + BLOCK], constants, frame, back)
        one, two, three = frame.strain
        for r in range(points.size):
            alpha = history[first + r, last] + back.growth[r]
            trace, square = one[r] + two[r] + three[r], one[r] ** 2 + two[r] ** 2 + three[r] ** 2
            psi[points[r]] = 0.5 * lam * trace * trace + mu * square + 0.5 * H * alpha * alpha + y * alpha


@compiled
def _commit(F, select, constants, history):
    dim, frame, back, last = F.shape[1], new_frame(F.shape[1]), _new_returned(), history.shape[1] - 1
    for first in range(0, select.size, BLOCK):
        points, block = select[first : first + BLOCK], history[first : first + BLOCK]
        _return(F, points, block, constants, frame, back)
        unload(frame.strain, frame, block)
        for r in range(points.size):
            if dim == 2:
                block[r, 4] = frame.strain[2, r]
            block[r, last] += back.growth[r]


# Stress, tangent, energy and commit, as in ``HistoryKernels``, for any dimension.
LINEAR_RETURN = _stress, _tangent, _energy, _commit
