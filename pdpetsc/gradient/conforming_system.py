"""The system for the multipliers of the divergence theorem of conforming weights."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from itertools import combinations
from typing import Any

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.communicator import largest, total
from pdpetsc.gradient.base import GradientOperator
from pdpetsc.kernels.conforming import linear_moments_kernel, remainder_kernel

# Largest number of pieces of a body whose linear functions are removed piece by piece.
PIECES = 20
# Tolerance of the null space: the product of the system with a null function, as a share of its largest entry and of
# the function.
LINEAR = 1e-9


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

    def without_null_functions(self, values: Float) -> Float:
        """Return values of the own particles (n_owned, dim) without their part in the null space."""
        found, comm = values.copy(), self.cloud.comm
        for component, Q in enumerate(self._null_functions):
            found[:, component] -= Q @ total(comm, Q.T @ values[:, component])
        return found

    @cached_property
    def _null_functions(self) -> list[Float]:
        """Return for each component an orthonormal basis (n_owned, k) of functions in the null space.

        They are linear on a piece of the body and on its images. If there are many pieces, they are those of the whole
        body only.
        """
        cloud, comm, dim = self.cloud, self.cloud.comm, self.cloud.dim
        labels = np.unique(np.concatenate(comm.allgather(np.unique(self._pieces))))
        masks = [self._pieces == label for label in labels] if len(labels) <= PIECES else [np.ones(cloud.n_owned)]
        x = cloud.x[: cloud.n_owned]
        # Even or odd about every mirror plane, and scaled for bodies far from the origin.
        middle = self._middle
        for axis, at in cloud.places.planes.items():
            middle[axis] = at
        functions = [
            function * mask for mask in masks for function in (np.ones(len(x)), *((x - middle) / cloud.horizon).T)
        ]
        found: list[list[Float]] = [[] for _ in range(dim)]
        for v in functions:
            size = largest(comm, np.abs(v), initial=0.0)
            off = np.abs(self.product(np.repeat(v[:, None], dim, axis=1))).max(axis=0, initial=0.0)
            for component, left in enumerate(off):
                # The product is not zero for a function that is not linear on the images.
                if largest(comm, float(left)) <= LINEAR * size * self._scale:
                    found[component].append(v)
        if not len(cloud.sign):  # all components are alike
            return [self._orthonormal(found[0])] * dim
        return [self._orthonormal(some) for some in found]

    def _orthonormal(self, functions: list[Float]) -> Float:
        """Return an orthonormal basis (n_owned, k) of functions (n_owned,)."""
        Q = np.stack(functions, axis=1) if functions else np.empty((self.cloud.n_owned, 0))
        for _ in range(2):  # twice: the first basis is orthonormal but for round-off
            squares, axes = np.linalg.eigh(total(self.cloud.comm, Q.T @ Q))
            kept = squares > 1e-14 * squares.max(initial=0.0)
            Q = Q @ (axes[:, kept] / np.sqrt(squares[kept]))
        return np.asarray(Q)

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
        return largest(self.cloud.comm, self.diagonal, initial=0.0)

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
        v, out = self._with_ghosts(values), np.zeros((cloud.n_local, cloud.dim))
        remainder_kernel(cloud.dim, cloud.dim, 1)(*self._geometry, self._square, v, out)
        cloud.mirror(out)
        cloud.halo.reverse(out)
        return out[: cloud.n_owned]

    def change(self, values: Float) -> Float:
        """Return the change of the weights (n_entries, dim) [1 / length] for multipliers (n_owned, dim)."""
        cloud = self.cloud
        v, e = self._with_ghosts(values), np.zeros((len(self.operator.members), cloud.dim))
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
        cloud.mirror(out)
        cloud.halo.reverse(out)
        return out[: cloud.n_owned]

    def _with_ghosts(self, values: Float) -> Float:
        """Return values (n_local, dim) with ghosts from those of the own particles (n_owned, dim)."""
        found = self.cloud.halo.with_ghosts(values)
        self.cloud.mirror(found)
        return found

    @property
    def _geometry(self) -> tuple[Any, ...]:
        operator = self.operator
        return operator.point_ptr, operator.members, self.cloud.x, self._size, self._inverse
