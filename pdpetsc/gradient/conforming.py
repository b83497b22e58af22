"""Conforming weights: the smallest change of weights that satisfies the divergence theorem for every particle."""

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

# Tolerance of the divergence theorem, as a share of the largest sum of weights of a particle.
TOLERANCE = 1e-10
# Near members are at most this many times as far away as the 2 dim-th nearest member. On lattices this includes the
# diagonals.
NEAR = 1.6
# Largest mean number of members of points with few members, by dimension.
FEW = {1: 10.0, 2: 14.0, 3: 12.0}
# Number of solves of the system, each for the remaining right-hand side.
ROUNDS = 4
# Largest relative change of the weights, in the norm over the body. Of 301 clouds, five had larger changes, 1.2 to 1.9,
# and errors up to thirty times those with a slightly wider horizon. Clouds with smaller changes had no such errors
# (docs/theory/conforming.md).
REFUSED = 1.0
# Relative change above which the log names the point; 286 of the 301 clouds have no such point.
NOTED = 4.0
# Number of iterations above which the log reports them. They grow with the number of particles if families leave little
# freedom.
MANY = 1000
# Largest number of pieces of a body whose linear functions are removed piece by piece.
PIECES = 20
# Tolerance of the null space: the product of the system with a null function, as a share of its largest entry and of
# the function.
LINEAR = 1e-9
# Tolerance of the gradients of linear fields.
EXACT = 1e-8


class ConformingSystem:
    """The symmetric system for the multipliers of the divergence theorem, ``S lambda = s - sum_p W_p g_pk``.

    ``S = C (I - Phi M^-1 Phi^T) C^T`` with ``C_k,pk = W_p``: a particle ``k`` has a number at every point that it is a
    member of, and each point subtracts the best linear fit. The null space contains the linear functions. At mirror
    planes each component has its own system, because the sign of the images depends on the component.

    Parameters
    ----------
    cloud : Cloud
        Particles of this rank.
    operator : GradientOperator
        The gradient whose weights are changed.
    pieces : (n_owned,) int64
        Piece of the body of each own particle.

    Notes
    -----
    Every method is collective unless its docstring says otherwise.
    """

    def __init__(self, cloud: Cloud, operator: GradientOperator, pieces: GlobalIndex) -> None:
        self.cloud = cloud
        self._pieces = pieces
        self._operator = operator
        self._size = cloud.local_horizon[operator.owner]
        self._square = operator.volume**2
        M = np.empty((operator.n_points, cloud.dim + 1, cloud.dim + 1))
        linear_moments_kernel(cloud.dim)(operator.point_ptr, operator.members, cloud.x, self._size, M)
        # The linear fit is exact at a point that has no more members than a linear function has coefficients.
        self._inverse = np.linalg.pinv(M, hermitian=True)
        self._component: int | None = None

    def of_component(self, component: int) -> ConformingSystem:
        """Return the system for one component of the multipliers (not collective)."""
        found = copy(self)
        found._component = component
        return found

    @property
    def null_functions(self) -> list[Float]:
        """Return linear functions on the own particles of each piece of the body whose images are linear too.

        If there are many pieces, return those of the whole body only.
        """
        cloud = self.cloud
        labels = np.unique(np.concatenate(cloud.comm.allgather(np.unique(self._pieces))))
        masks = [self._pieces == label for label in labels] if len(labels) <= PIECES else [np.ones(cloud.n_owned)]
        x = cloud.x[: cloud.n_owned]
        # Even or odd about every mirror plane, and scaled for bodies far from the origin.
        middle = total(cloud.comm, x.sum(axis=0)) / cloud.n_global
        for axis, at in cloud.places.planes.items():
            middle[axis] = at
        found = []
        for mask in masks:
            for function in (np.ones(len(x)), *((x - middle) / cloud.horizon).T):
                v = np.asarray(function * mask)[:, None]
                size = largest(cloud.comm, float(np.abs(v).max(initial=0.0)))
                left = largest(cloud.comm, float(np.abs(self.product(v)).max(initial=0.0)))
                # The product is not zero for a function that is not linear on the images.
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
        """Multiply the ghosts of ``values`` (n_local, columns) by the sign of the component."""
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
        # The first entry of a point is its centre: minus the sum of the others.
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
        """Return the part of this rank of the matrix that preconditions ``S`` (n_local, n_local).

        It is ``S`` itself if points have few members, such as sectors, because no simpler matrix is a good
        approximation. Otherwise it is the matrix of one point per particle with near members only. A row then has about
        25 entries in 2D and 85 in 3D, for any horizon.
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
        """Return ``C (I - Phi M^-1 Phi^T) C^T`` for points with these owners, members and volumes."""
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
        """Multiply a matrix over the local particles by the signs of the component there (not collective)."""
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
    """Compute weights that satisfy the discrete divergence theorem, ``sum_p W_p g_pk = s_k`` for every particle.

    ``s_k = sum_f N_f(x_k) a_f`` over the facets of the surface. Linear fields remain exact, ``sum_k g_pk = 0``,
    ``sum_k x_k (x) g_pk = I``. Of all such weights these are nearest to those of the scheme, ``min sum |dg_pk|^2``. A
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
        No such weights exist for these families, or they differ from those of the scheme by more than 100 %, on every
        rank.

    Notes
    -----
    Collective.

    References
    ----------
    Chiu2012, for finite-difference operators of fluids.
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
        # The next round removes the round-off of many iterations.
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
    """Return the note on changed weights ``g``; raise NoConformingWeights on all ranks if they are bad (collective)."""
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
    # Relative to the middle of the rank, to avoid round-off for bodies far from the origin.
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
    """Return the largest of values (n,) of all ranks, and its position (collective)."""
    here = (float(values.max()), x[int(np.argmax(values))].tolist()) if len(values) else (0.0, [])
    value, where = max(cloud.comm.allgather(here))
    return value, where
