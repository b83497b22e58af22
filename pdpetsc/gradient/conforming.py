"""Conforming weights: the smallest change of weights that satisfies the divergence theorem for every particle."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from itertools import combinations
from typing import Any, TypeAlias

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.communicator import largest, total
from pdpetsc.discrete.components import find_pieces
from pdpetsc.discrete.families import Families
from pdpetsc.discrete.surface import Surface
from pdpetsc.errors import NoConformingWeights
from pdpetsc.gradient.base import GradientOperator
from pdpetsc.gradient.near_inverse import NearInverse, near_inverses
from pdpetsc.kernels.conforming import linear_moments_kernel, remainder_kernel

# Tolerance of the divergence theorem, as a share of the largest sum of weights of a particle.
TOLERANCE = 1e-10
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
    member of, and each point subtracts the best linear fit. The null space contains the linear functions. The system
    is the same for each component of the multipliers, except at mirror planes, where the sign of the images depends on
    the component.

    Parameters
    ----------
    cloud : Cloud
        Particles of this rank.
    operator : GradientOperator
        The gradient whose weights are changed.
    pieces : (n_owned,) int64
        Piece of the body of each own particle.

    Attributes
    ----------
    cloud, operator
        As given.

    Notes
    -----
    Every method and property is collective.
    """

    def __init__(self, cloud: Cloud, operator: GradientOperator, pieces: GlobalIndex) -> None:
        self.cloud, self.operator = cloud, operator
        self._pieces = pieces
        self._size = cloud.local_horizon[operator.owner]
        self._square = operator.volume**2
        M = np.empty((operator.n_points, cloud.dim + 1, cloud.dim + 1))
        linear_moments_kernel(cloud.dim)(operator.point_ptr, operator.members, cloud.x, self._size, M)
        # The linear fit is exact at a point that has no more members than a linear function has coefficients.
        self._inverse = np.linalg.pinv(M, hermitian=True)

    @property
    def null_functions(self) -> list[Float]:
        """Return the functions (n_owned, dim) of one component that are linear on a piece and on its images.

        If there are many pieces, return those of the whole body only.
        """
        cloud = self.cloud
        labels = np.unique(np.concatenate(cloud.comm.allgather(np.unique(self._pieces))))
        masks = [self._pieces == label for label in labels] if len(labels) <= PIECES else [np.ones(cloud.n_owned)]
        x = cloud.x[: cloud.n_owned]
        # Even or odd about every mirror plane, and scaled for bodies far from the origin.
        middle = self._middle
        for axis, at in cloud.places.planes.items():
            middle[axis] = at
        found = []
        for mask in masks:
            for function in (np.ones(len(x)), *((x - middle) / cloud.horizon).T):
                v = np.repeat((function * mask)[:, None], cloud.dim, axis=1)
                size = largest(cloud.comm, float(np.abs(v).max(initial=0.0)))
                for component, left in enumerate(np.abs(self.product(v)).max(axis=0, initial=0.0)):
                    # The product is not zero for a function that is not linear on the images.
                    if largest(cloud.comm, float(left)) <= LINEAR * size * self._scale:
                        found.append(v * (np.arange(cloud.dim) == component))
        return found

    @cached_property
    def diagonal(self) -> Float:
        """Return ``sum_p W_p^2`` over the points of each particle (n_owned,), about the diagonal of the system."""
        points = np.repeat(self._square, np.diff(self.operator.point_ptr))
        diagonal = np.bincount(self.operator.members, points, self.cloud.n_local)
        self.cloud.halo.reverse(diagonal)
        return np.asarray(diagonal[: self.cloud.n_owned])

    @cached_property
    def mean_members(self) -> float:
        """Return the mean number of members of a point."""
        count = total(self.cloud.comm, np.array([float(len(self.operator.members)), float(self.operator.n_points)]))
        return float(count[0] / count[1])

    @property
    def _middle(self) -> Float:
        return np.asarray(total(self.cloud.comm, self.cloud.x[: self.cloud.n_owned].sum(axis=0)) / self.cloud.n_global)

    @cached_property
    def _scale(self) -> float:
        return largest(self.cloud.comm, float(self.diagonal.max(initial=0.0)))

    @property
    def energies(self) -> Float:
        """Return ``v . S v`` of ``v = x_m^2 / 2``, then of ``x_m x_n``, at the points of each own particle.

        Lengths are relative to the horizon; (n_owned, dim (dim + 1) / 2).
        """
        cloud, operator, dim = self.cloud, self.operator, self.cloud.dim
        x = (cloud.x - self._middle) / cloud.horizon
        functions = [*(0.5 * x**2).T, *(x[:, m] * x[:, k] for m, k in combinations(range(dim), 2))]
        found = np.zeros((cloud.n_owned, len(functions)))
        for begin in range(0, len(functions), dim):
            some = functions[begin : begin + dim]
            v, e = np.zeros((cloud.n_local, dim)), np.zeros((len(operator.members), dim))
            v[:, : len(some)] = np.stack(some, axis=1)
            remainder_kernel(dim, dim, 0)(*self._geometry, operator.volume, v, e)
            of_points = np.add.reduceat(e**2, operator.point_ptr[:-1], axis=0)
            for column in range(len(some)):
                found[:, begin + column] = np.bincount(operator.owner, of_points[:, column], cloud.n_owned)
        return found

    def product(self, values: Float) -> Float:
        """Return ``S v`` (n_owned, dim) for ``values`` of the own particles (n_owned, dim)."""
        cloud = self.cloud
        v, out = np.zeros((cloud.n_local, cloud.dim)), np.zeros((cloud.n_local, cloud.dim))
        v[: cloud.n_owned] = values
        cloud.halo.forward(v)
        self._turn(v)
        remainder_kernel(cloud.dim, cloud.dim, 1)(*self._geometry, self._square, v, out)
        self._turn(out)
        cloud.halo.reverse(out)
        return out[: cloud.n_owned]

    def change(self, values: Float) -> Float:
        """Return the change of the weights (n_entries, dim) [1 / length] for multipliers (n_owned, dim)."""
        cloud = self.cloud
        v = np.zeros((cloud.n_local, cloud.dim))
        v[: cloud.n_owned] = values
        cloud.halo.forward(v)
        self._turn(v)
        e = np.zeros((len(self.operator.members), cloud.dim))
        remainder_kernel(cloud.dim, cloud.dim, 0)(*self._geometry, self.operator.volume, v, e)
        # The first entry of a point is its centre: minus the sum of the others.
        first = self.operator.point_ptr[:-1]
        e[first] = 0.0
        e[first] = -np.add.reduceat(e, first, axis=0)
        return e

    def excess(self, g: Float, s: Float) -> Float:
        """Return ``sum_p W_p g_pk - s_k`` (n_owned, dim) [area] for ``g`` (n_entries, dim) and ``s`` (n_local, dim)."""
        cloud = self.cloud
        out = -s
        identity = np.broadcast_to(np.eye(cloud.dim), (self.operator.n_points, cloud.dim, cloud.dim))
        replace(self.operator, g=g).divergence(np.ascontiguousarray(identity), out)
        self._turn(out)
        cloud.halo.reverse(out)
        return out[: cloud.n_owned]

    def _turn(self, values: Float) -> None:
        """Multiply the ghosts of ``values`` (n_local, dim) by the signs of their components (not collective)."""
        if len(self.cloud.sign):
            values[self.cloud.n_owned :] *= self.cloud.sign

    @property
    def _geometry(self) -> tuple[Any, ...]:
        operator = self.operator
        return operator.point_ptr, operator.members, self.cloud.x, self._size, self._inverse


# Solves S lambda = r: system, approximate inverse, r (n_owned, dim), relative tolerance -> lambda, iterations.
SolveSystem: TypeAlias = "Callable[[ConformingSystem, NearInverse, Float, float], tuple[Float, int]]"


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
    for near_inverse in near_inverses(system, families):
        near = near_inverse(system, families)
        for _ in range(ROUNDS):
            # The next round removes the round-off of many iterations.
            multipliers, more = solve(system, near, -left, max(0.1 * TOLERANCE * scale / after, 1e-12))
            changed = g + system.change(multipliers)
            rest = system.excess(changed, s)
            found = largest(cloud.comm, float(np.abs(rest).max(initial=0.0)))
            iterations += more
            if not found < 0.5 * after:
                break
            g, left, after = changed, rest, found
            if after <= TOLERANCE * scale:
                break
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
