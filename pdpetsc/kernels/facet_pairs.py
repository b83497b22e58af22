"""Loops over pairs of facets that move affinely: displacements ``v`` and gradients ``(dv/dX)`` of each, (1 + dim, dim).

The weights (n_entries, 1 + dim) of the particles of a facet, ``ptr[a]`` to ``ptr[a + 1]``, give both. The other facet
of a pair feels the opposite force, so that its forces are subtracted.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np

from pdpetsc.kernels.compile import compiled


@compiled
def carry(ptr, members, weights, u, a, q):
    """Write displacement and gradient of facet ``a`` to ``q`` (1 + dim, dim)."""
    q[:] = 0.0
    for t in range(ptr[a], ptr[a + 1]):
        k = members[t]
        for c in range(q.shape[0]):
            for m in range(q.shape[1]):
                q[c, m] += weights[t, c] * u[k, m]


@compiled
def carry_all(ptr, members, weights, u, q):
    """Write displacements and gradients of all facets to ``q`` (n, 1 + dim, dim)."""
    for a in range(ptr.size - 1):
        carry(ptr, members, weights, u, a, q[a])


@compiled
def spread(ptr, members, weights, used, q, f):
    """Add the forces on used facets, conjugate to displacements and gradients, to those of particles (n_local, dim)."""
    for a in range(ptr.size - 1):
        if used[a]:
            for t in range(ptr[a], ptr[a + 1]):
                k = members[t]
                for m in range(q.shape[2]):
                    force = 0.0
                    for c in range(q.shape[1]):
                        force += weights[t, c] * q[a, c, m]
                    f[k, m] += force


@compiled
def push(one, other, at, force, used, other_used, q, other_q):
    """Add forces (n, dim) at points ``at`` (n, 2, dim) of both facets of pairs, and mark these facets."""
    for p in range(one.size):
        a, b = one[p], other[p]
        used[a], other_used[b] = True, True
        for m in range(force.shape[1]):
            q[a, 0, m] += force[p, m]
            other_q[b, 0, m] -= force[p, m]
            for j in range(force.shape[1]):
                q[a, 1 + j, m] += at[p, 0, j] * force[p, m]
                other_q[b, 1 + j, m] -= at[p, 1, j] * force[p, m]


@lru_cache
def pair_times_kernel(dim: int) -> Callable[..., Any]:
    """Return ``times``, which adds the forces of groups of pairs: see ``PairProduct``.

    Own particle ``i`` has the groups ``first[i]`` to ``first[i + 1]``, and group ``s`` the pairs ``start[s]`` to
    ``start[s + 1]``; only those of ``particles`` are added.
    """
    size = 1 + dim

    @compiled
    def times(
        particles, first, start, one, other, by, to, at, force, ptr, members, weights, other_ptr, other_members,
        other_weights, u, f,
    ):  # fmt: skip
        some = False
        for n in range(particles.size):
            some = some or first[particles[n]] < first[particles[n] + 1]
        if not some:
            return
        r, n_to = by.shape[1], to.shape[1]
        q, other_q = np.empty((ptr.size - 1, size, dim)), np.empty((other_ptr.size - 1, size, dim))
        g, other_g = np.zeros((ptr.size - 1, size, dim)), np.zeros((other_ptr.size - 1, size, dim))
        used, other_used = np.zeros(ptr.size - 1, np.bool_), np.zeros(other_ptr.size - 1, np.bool_)
        rate = np.empty(r)
        for n in range(particles.size):
            for s in range(first[particles[n]], first[particles[n] + 1]):
                rate[:] = 0.0
                for p in range(start[s], start[s + 1]):
                    a, b = one[p], other[p]
                    if not used[a]:
                        used[a] = True
                        carry(ptr, members, weights, u, a, q[a])
                    if not other_used[b]:
                        other_used[b] = True
                        carry(other_ptr, other_members, other_weights, u, b, other_q[b])
                    for i in range(r):
                        value = 0.0
                        for c in range(size):
                            for m in range(dim):
                                value += by[p, i, 0, c, m] * q[a, c, m]
                        for c in range(size):
                            for m in range(dim):
                                value += by[p, i, 1, c, m] * other_q[b, c, m]
                        rate[i] += value
                for p in range(start[s], start[s + 1]):
                    a, b = one[p], other[p]
                    for m in range(dim):
                        value = 0.0
                        for i in range(n_to):
                            value += to[p, i, m] * rate[i]
                        g[a, 0, m] += value
                        other_g[b, 0, m] -= value
                        for j in range(dim):
                            g[a, 1 + j, m] += at[p, 0, j] * value
                            other_g[b, 1 + j, m] -= at[p, 1, j] * value
                    if r > n_to:
                        for j in range(dim):
                            for m in range(dim):
                                g[a, 1 + j, m] += rate[n_to + j] * force[p, m]
                                other_g[b, 1 + j, m] -= rate[n_to + dim + j] * force[p, m]
        spread(ptr, members, weights, used, g, f)
        spread(other_ptr, other_members, other_weights, other_used, other_g, f)

    return times


@compiled
def facet_blocks(side, of, by, to, at, force, ptr, members, weights, out):
    """Add the diagonal blocks (n_local, dim, dim) of the particles of facets ``of`` (n_pairs,) on one side of pairs."""
    dim, n_to = out.shape[2], to.shape[1]
    whole = np.zeros((ptr.size - 1, 1 + dim, dim, 1 + dim, dim))
    used = np.zeros(ptr.size - 1, np.bool_)
    sign = 1.0 if side == 0 else -1.0
    for p in range(of.size):
        a = of[p]
        used[a] = True
        for m in range(dim):
            for d in range(1 + dim):
                for n in range(dim):
                    value = 0.0
                    for i in range(n_to):
                        value += to[p, i, m] * by[p, i, side, d, n]
                    value *= sign
                    whole[a, 0, m, d, n] += value
                    for j in range(dim):
                        moved = at[p, side, j] * value
                        if by.shape[1] > n_to:
                            moved += sign * force[p, m] * by[p, n_to + side * dim + j, side, d, n]
                        whole[a, 1 + j, m, d, n] += moved
    for a in range(ptr.size - 1):
        if used[a]:
            for t in range(ptr[a], ptr[a + 1]):
                for m in range(dim):
                    for n in range(dim):
                        value = 0.0
                        for c in range(1 + dim):
                            for d in range(1 + dim):
                                value += weights[t, c] * weights[t, d] * whole[a, c, m, d, n]
                        out[members[t], m, n] += value


@compiled
def members_of_groups(start, one, other, ptr, members, other_ptr, other_members, seen, starts, found):
    """Write the start of the particles of each group (n_groups + 1,), and these, each once.

    ``seen`` (n_local,) is memory, -1 at first. ``found`` is large enough for the particles of all pairs.
    """
    count = 0
    for s in range(start.size - 1):
        starts[s] = count
        for p in range(start[s], start[s + 1]):
            for t in range(ptr[one[p]], ptr[one[p] + 1]):
                if seen[members[t]] != s:
                    seen[members[t]] = s
                    found[count] = members[t]
                    count += 1
            for t in range(other_ptr[other[p]], other_ptr[other[p] + 1]):
                if seen[other_members[t]] != s:
                    seen[other_members[t]] = s
                    found[count] = other_members[t]
                    count += 1
    starts[-1] = count


@compiled
def vectors_of_members(
    start, one, other, by, to, at, force, ptr, members, weights, other_ptr, other_members, other_weights, starts, found,
    place, h, g,
):  # fmt: skip
    """Add the vectors ``h, g`` (n_entries, r, dim) of the particles of groups; ``place`` (n_local,) is memory."""
    for s in range(start.size - 1):
        for e in range(starts[s], starts[s + 1]):
            place[found[e]] = e
        for p in range(start[s], start[s + 1]):
            for t in range(ptr[one[p]], ptr[one[p] + 1]):
                e = place[members[t]]
                _add_member(0, 1.0, p, weights[t], by, to, at, force, h[e], g[e])
            for t in range(other_ptr[other[p]], other_ptr[other[p] + 1]):
                e = place[other_members[t]]
                _add_member(1, -1.0, p, other_weights[t], by, to, at, force, h[e], g[e])


@compiled
def _add_member(side, sign, p, w, by, to, at, force, h, g):
    """Add the vectors (r, dim) of a particle with weights ``w`` on one side of pair ``p``."""
    r, dim, n_to = g.shape[0], g.shape[1], to.shape[1]
    weight = w[0]
    for j in range(dim):
        weight += w[1 + j] * at[p, side, j]
    for m in range(dim):
        for i in range(r):
            for c in range(1 + dim):
                g[i, m] += w[c] * by[p, i, side, c, m]
        for i in range(n_to):
            h[i, m] += sign * weight * to[p, i, m]
        if r > n_to:
            for j in range(dim):
                h[n_to + side * dim + j, m] += sign * w[1 + j] * force[p, m]
