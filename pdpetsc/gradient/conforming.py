"""Conforming weights: the least change of a gradient that lets it satisfy the divergence theorem for every particle."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import replace
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
import scipy

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.communicator import largest, total
from pdpetsc.discrete.components import find_pieces
from pdpetsc.discrete.families import Families
from pdpetsc.discrete.surface import Surface
from pdpetsc.errors import NoConformingWeights
from pdpetsc.gradient.base import GradientOperator
from pdpetsc.kernels.conforming import linear_moments_kernel, remainder_kernel
from pdpetsc.kernels.near import reach_kernel

# The divergence theorem holds up to this share of the largest sum of weights of a particle.
TOLERANCE = 1e-10
# Near members are up to this many times as far as the 2 dim-th nearest one; on lattices those along the diagonals are.
NEAR = 1.6
# Points have few members where these are, in the mean, at most as many, by dimension.
FEW = {1: 10.0, 2: 14.0, 3: 12.0}
# Times that the system is solved, for what is left of the right-hand side.
ROUNDS = 4
# Weights that change by this many times what they were, in the norm over the body, are no longer those of the scheme:
# of 301 clouds the five above, 1.2 to 1.9, had errors up to thirty times those of a slightly wider horizon, and none of
# those below stood out (docs/theory/conforming.md).
REFUSED = 1.0
# A point whose weights change by more times what they were is named; 286 of the 301 clouds have none.
NOTED = 4.0
# As are more iterations than this: where families leave little to choose they grow with the number of particles.
MANY = 1000
# Pieces of a body at most whose linear functions are taken out one by one.
PIECES = 20
# What the system makes of a function in its null space is below this share of its largest entry and of the function.
LINEAR = 1e-9
# Linear fields stay exact up to this.
EXACT = 1e-8


class ConformingSystem:
    """The symmetric system for the multipliers of the divergence theorem, ``S lambda = s - sum_p W_p g_pk``.

    ``S = C (I - Phi M^-1 Phi^T) C^T`` with ``C_k,pk = W_p``: to the numbers that a particle ``k`` has in every point it
    is a member of, of which each point takes the best linear function out. Linear functions are its null space. Beside
    mirror planes each component has a system of its own, because images have its numbers with another sign.

    Parameters
    ----------
    cloud : Cloud
        Particles of this rank.
    operator : GradientOperator
        The gradient whose weights are changed.
    pieces : (n_owned,) int64
        The piece of the body that each own particle belongs to.

    Notes
    -----
    Every method but where it says otherwise is collective.
    """

    def __init__(self, cloud: Cloud, operator: GradientOperator, pieces: GlobalIndex) -> None:
        self.cloud = cloud
        self._pieces = pieces
        self._operator = operator
        self._size = cloud.local_horizon[operator.owner]
        self._square = operator.volume**2
        M = np.empty((operator.n_points, cloud.dim + 1, cloud.dim + 1))
        linear_moments_kernel(cloud.dim)(operator.point_ptr, operator.members, cloud.x, self._size, M)
        # A point with as few members as a linear function has numbers explains all of them.
        self._inverse = np.linalg.pinv(M, hermitian=True)
        self._component: int | None = None

    def of_component(self, component: int) -> ConformingSystem:
        """Return the system for one component of the multipliers (not collective)."""
        found = copy(self)
        found._component = component
        return found

    @property
    def null_functions(self) -> list[Float]:
        """Return linear functions on the own particles whose images are linear too, of each piece of the body.

        Where there are many pieces those of the whole body alone.
        """
        cloud = self.cloud
        labels = np.unique(np.concatenate(cloud.comm.allgather(np.unique(self._pieces))))
        masks = [self._pieces == label for label in labels] if len(labels) <= PIECES else [np.ones(cloud.n_owned)]
        x = cloud.x[: cloud.n_owned]
        # Even or odd about every mirror plane; small numbers far from the origin.
        middle = total(cloud.comm, x.sum(axis=0)) / cloud.n_global
        for axis, at in cloud.places.planes.items():
            middle[axis] = at
        found = []
        for mask in masks:
            for function in (np.ones(len(x)), *((x - middle) / cloud.horizon).T):
                v = np.asarray(function * mask)[:, None]
                size = largest(cloud.comm, float(np.abs(v).max(initial=0.0)))
                left = largest(cloud.comm, float(np.abs(self.product(v)).max(initial=0.0)))
                # Of a function that is not linear on the images the system leaves a part.
                if left <= LINEAR * size * self._scale:
                    found.append(v[:, 0])
        return found

    @cached_property
    def _scale(self) -> float:
        """Return the largest diagonal entry of the system, ``sum_p W_p^2`` over the points of a particle."""
        points = np.repeat(self._square, np.diff(self._operator.point_ptr))
        diagonal = np.bincount(self._operator.members, points, self.cloud.n_local)
        return largest(self.cloud.comm, float(diagonal.max(initial=0.0)))

    def _turn(self, values: Float) -> None:
        """Give the ghosts of ``values`` (n_local, columns) the sign of the component."""
        if self._component is not None and len(self.cloud.sign):
            values[self.cloud.n_owned :] *= self.cloud.sign[:, self._component, None]

    def product(self, values: Float) -> Float:
        """Return ``S v`` (n_owned, columns) for ``values`` of the own particles (n_owned, columns)."""
        cloud, columns = self.cloud, values.shape[1]
        v, out = np.zeros((cloud.n_local, columns)), np.zeros((cloud.n_local, columns))
        v[: cloud.n_owned] = values
        cloud.halo.forward(v)
        self._turn(v)
        kernel = remainder_kernel(cloud.dim, columns, 1)
        kernel(*self._geometry, self._square, v, out)
        self._turn(out)
        cloud.halo.reverse(out)
        return out[: cloud.n_owned]

    def change(self, values: Float) -> Float:
        """Return the change of the weights (n_entries, dim) [1 / length] for multipliers (n_owned, dim)."""
        cloud = self.cloud
        v = np.zeros((cloud.n_local, cloud.dim))
        v[: cloud.n_owned] = values
        cloud.halo.forward(v)
        if len(cloud.sign):
            v[cloud.n_owned :] *= cloud.sign
        e = np.zeros((len(self._operator.members), cloud.dim))
        remainder_kernel(cloud.dim, cloud.dim, 0)(*self._geometry, self._operator.volume, v, e)
        # The first entry of a point is its centre, which takes what the others give.
        first = self._operator.point_ptr[:-1]
        e[first] = 0.0
        e[first] = -np.add.reduceat(e, first, axis=0)
        return e

    def excess(self, g: Float, s: Float) -> Float:
        """Return ``sum_p W_p g_pk - s_k`` (n_owned, dim) [area] for ``g`` (n_entries, dim) and ``s`` (n_local, dim)."""
        cloud = self.cloud
        out = -s
        identity = np.broadcast_to(np.eye(cloud.dim), (self._operator.n_points, cloud.dim, cloud.dim))
        replace(self._operator, g=g).divergence(np.ascontiguousarray(identity), out)
        if len(cloud.sign):
            out[cloud.n_owned :] *= cloud.sign
        cloud.halo.reverse(out)
        return out[: cloud.n_owned]

    def near_matrix(self, families: Families) -> scipy.sparse.csr_matrix:
        """Return the matrix that preconditions ``S`` (n_local, n_local), what this rank adds to it.

        It is ``S`` itself where its points have few members, as sectors have: what is left there of the numbers of a
        point is little, and no other matrix is near. Else it is that of one point per particle with near members only,
        which has about 25 entries in a row in the plane and 85 in space for any horizon.
        """
        cloud, operator = self.cloud, self._operator
        if total(cloud.comm, len(operator.members)) <= FEW[cloud.dim] * total(cloud.comm, operator.n_points):
            return self._matrix(operator.owner, operator.point_ptr, operator.members, operator.volume)
        dim, n = cloud.dim, cloud.n_owned
        reach, every = np.zeros(n), np.ones(len(families.neighbours), dtype=bool)
        reach_kernel(dim, 2 * dim)(families.indptr, families.neighbours, every, cloud.x, reach)
        near = np.linalg.norm(families.bonds(cloud.x), axis=1) <= NEAR * reach[families.centres]
        counts = np.bincount(families.centres[near], minlength=n)
        ptr = np.concatenate([[0], np.cumsum(counts + 1)]).astype(np.int64)
        members = np.insert(families.neighbours[near], ptr[:-1] - np.arange(n), np.arange(n))
        return self._matrix(np.arange(n), ptr, members, cloud.volume[:n])

    def _matrix(
        self, owner: LocalIndex | GlobalIndex, ptr: GlobalIndex, members: LocalIndex, W: Float
    ) -> scipy.sparse.csr_matrix:
        """Return ``C (I - Phi M^-1 Phi^T) C^T`` of points with the given owners, members and volumes."""
        cloud, dim, points = self.cloud, self.cloud.dim, len(owner)
        M = np.empty((points, dim + 1, dim + 1))
        linear_moments_kernel(dim)(ptr, members, cloud.x, cloud.local_horizon[owner], M)
        low, axes = np.linalg.eigh(M)
        keep = low > 1e-12 * low[:, -1:]
        root = axes * np.where(keep, 1.0 / np.sqrt(np.where(keep, low, 1.0)), 0.0)[:, None, :]
        of = np.repeat(np.arange(points), np.diff(ptr))
        xi = (cloud.x[members] - cloud.x[owner[of]]) / cloud.local_horizon[owner[of], None]
        phi = np.concatenate([np.ones((len(of), 1)), xi], axis=1)
        D = W[of, None] * np.einsum("ea,eab->eb", phi, root[of])
        width, n = dim + 1, cloud.n_local
        columns = (of[:, None] * width + np.arange(width)).ravel()
        shared = scipy.sparse.csr_matrix((D.ravel(), (np.repeat(members, width), columns)), shape=(n, width * points))
        diagonal = np.bincount(members, W[of] ** 2, n)
        found = scipy.sparse.csr_matrix((diagonal, (np.arange(n), np.arange(n))), shape=(n, n)) - shared @ shared.T
        return scipy.sparse.csr_matrix(found)

    def turned(self, matrix: scipy.sparse.csr_matrix) -> scipy.sparse.csr_matrix:
        """Return a matrix over the local particles with the signs that the component has on them (not collective)."""
        sign = np.ones((self.cloud.n_local, 1))
        self._turn(sign)
        return scipy.sparse.csr_matrix(matrix.multiply(sign).multiply(sign.T))

    @property
    def _geometry(self) -> tuple[Any, ...]:
        operator = self._operator
        return operator.point_ptr, operator.members, self.cloud.x, self._size, self._inverse


# Solves S lambda = r: system, near matrix, right-hand sides (n_owned, dim), relative tolerance -> lambda, iterations.
SolveSystem: TypeAlias = "Callable[[ConformingSystem, scipy.sparse.csr_matrix, Float, float], tuple[Float, int]]"


def conforming(
    cloud: Cloud, families: Families, operator: GradientOperator, surface: Surface, solve: SolveSystem
) -> GradientOperator:
    """Return a gradient with the divergence theorem in discrete form, ``sum_p W_p g_pk = s_k`` for every particle.

    ``s_k = sum_f N_f(x_k) a_f`` over the facets of the surface. Of all weights that do, and keep linear fields exact,
    ``sum_k g_pk = 0``, ``sum_k x_k (x) g_pk = I``, these differ least from the given ones, ``min sum |dg_pk|^2``. A
    uniform stress is then in equilibrium with its tractions on any cloud.

    Parameters
    ----------
    operator : GradientOperator
        The gradient of any scheme.
    surface : Surface
        The facets of the own particles.
    solve : callable
        Solves a ``ConformingSystem``.

    Raises
    ------
    NoConformingWeights
        None exist for these families, or they are further from those of the scheme than zero, on every rank.

    Notes
    -----
    Collective.

    References
    ----------
    Chiu2012 has such weights for finite-difference operators of fluids.
    """
    s = np.zeros((cloud.n_local, cloud.dim))
    surface.spread(surface.area, s)
    system = ConformingSystem(cloud, operator, find_pieces(cloud, families))
    sums = np.bincount(
        operator.members,
        np.repeat(operator.volume, np.diff(operator.point_ptr)) * np.linalg.norm(operator.g, axis=1),
        cloud.n_local,
    )
    scale = largest(cloud.comm, float(sums.max(initial=0.0)))
    excess = system.excess(operator.g, s)
    before = largest(cloud.comm, float(np.abs(excess).max(initial=0.0)))
    if before <= TOLERANCE * scale:
        return operator
    g, left, after, iterations = operator.g, excess, before, 0
    systems = [system]
    if cloud.places.planes:
        systems = [system.of_component(component) for component in range(cloud.dim)]
    close = system.near_matrix(families)
    near = [one.turned(close) for one in systems]
    for _ in range(ROUNDS):
        # What round-off of many iterations leaves the next round takes.
        tolerance = max(0.1 * TOLERANCE * scale / after, 1e-12)
        parts = np.split(-left, len(systems), axis=1)
        solved = [solve(one, of_it, part, tolerance) for one, of_it, part in zip(systems, near, parts, strict=True)]
        multipliers, more = np.concatenate([part for part, _ in solved], axis=1), sum(count for _, count in solved)
        changed = g + system.change(multipliers)
        rest = system.excess(changed, s)
        found = largest(cloud.comm, float(np.abs(rest).max(initial=0.0)))
        iterations += more
        if not found < 0.5 * after:
            break
        g, left, after = changed, rest, found
        if after <= TOLERANCE * scale:
            break
    if not after <= TOLERANCE * scale:
        after, worst = _worst(cloud, np.abs(left).max(axis=1, initial=0.0), cloud.x)
        raise NoConformingWeights(
            f"No conforming weights were found: the divergence theorem is off by {after / scale:.1e} of the weights of "
            f"a particle at {worst} after {iterations} iterations; its family is too "
            f"small to be changed, so widen the horizon, or its facets are not those of its cell."
        )
    note = _judged(cloud, operator, g, iterations)
    return replace(operator, g=g, note="; ".join(filter(None, [operator.note, note])))


def _judged(cloud: Cloud, operator: GradientOperator, g: Float, iterations: int) -> str:
    """Return what is said of changed weights ``g``; raise on all ranks where they are no good (collective)."""
    first = operator.point_ptr[:-1]
    changed, before = (np.add.reduceat((w**2).sum(axis=1), first) for w in (g - operator.g, operator.g))
    sums = total(cloud.comm, np.array([changed.sum(), before.sum()]))
    whole = float(np.sqrt(sums[0] / sums[1]))
    change, worst = _worst(cloud, np.sqrt(changed / before), cloud.x[operator.owner])
    if whole > REFUSED:
        raise NoConformingWeights(
            f"Conforming weights would change by {whole:.2g} times what they are, most of all by {change:.2g} times at "
            f"{worst}: families leave too little to choose; widen the horizon."
        )
    # Seen from the middle of the rank, so that bodies far from the origin have no more round-off.
    linear = replace(operator, g=g).gradient(cloud.x - cloud.x[: cloud.n_owned].mean(axis=0))
    off = np.abs(linear - np.eye(cloud.dim)).max(axis=(1, 2), initial=0.0)
    inexact, where = _worst(cloud, off, cloud.x[operator.owner])
    if not inexact <= EXACT:
        raise NoConformingWeights(
            f"No conforming weights were found: linear fields are off by {inexact:.1e} at {where}, whose family is "
            f"nearly flat; widen the horizon."
        )
    note = f"conforming weights, {iterations} iterations, changed by {whole:.2g}, at a point by at most {change:.2g}"
    if change > NOTED or iterations > MANY:
        note += f", at {worst}: families leave little to choose, which a wider horizon mends"
    return note


def _worst(cloud: Cloud, values: Float, x: Float) -> tuple[float, list[float]]:
    """Return the largest of values (n,) of all ranks, and where it is (collective)."""
    here = (float(values.max()), x[int(np.argmax(values))].tolist()) if len(values) else (0.0, [])
    value, where = max(cloud.comm.allgather(here))
    return value, where
