"""Vectors of at most three components as numbers, for loops over bonds and members of stencils.

A small array would be written to memory and read again for every bond. ``dim`` is a compile-time constant of the
kernels that call these functions; components beyond it are 0 and not computed.
"""

from __future__ import annotations

from pdpetsc.kernels.compile import compiled


@compiled
def row(values, i, dim):
    """Return the components of row ``i``."""
    second, third = 0.0, 0.0
    if dim > 1:
        second = values[i, 1]
    if dim > 2:
        third = values[i, 2]
    return values[i, 0], second, third


@compiled
def difference(i, j, u, dim):
    """Return the components of ``u_j - u_i``."""
    second, third = 0.0, 0.0
    if dim > 1:
        second = u[j, 1] - u[i, 1]
    if dim > 2:
        third = u[j, 2] - u[i, 2]
    return u[j, 0] - u[i, 0], second, third


@compiled
def applied(A, v_0, v_1, v_2, dim):
    """Return the components of ``A v`` for a tensor A (dim, dim)."""
    first, second, third = A[0, 0] * v_0, 0.0, 0.0
    if dim > 1:
        first += A[0, 1] * v_1
        second = A[1, 0] * v_0 + A[1, 1] * v_1
    if dim > 2:
        first += A[0, 2] * v_2
        second += A[1, 2] * v_2
        third = A[2, 0] * v_0 + A[2, 1] * v_1 + A[2, 2] * v_2
    return first, second, third


@compiled
def add_to(f, i, value_0, value_1, value_2, dim):
    """Add a vector to row ``i`` of ``f``."""
    f[i, 0] += value_0
    if dim > 1:
        f[i, 1] += value_1
    if dim > 2:
        f[i, 2] += value_2
