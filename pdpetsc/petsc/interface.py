"""Stiff forces between facets in the two-level preconditioner: ties and contact."""

from __future__ import annotations

import numpy as np
import scipy
from petsc4py import PETSc

from pdpetsc.arrays import Float, GlobalIndex, Mask
from pdpetsc.discrete.communicator import offset, total
from pdpetsc.gradient.near_inverse import Triplets
from pdpetsc.petsc.sparse import assembled
from pdpetsc.problem.background_elements import BackgroundElements
from pdpetsc.problem.problem import Tangent


class Interface:
    """Represent the stiff products of a tangent, ``S = sum_s b_s h_s (x) g_s``, on particles and on nodes.

    Springs between facets are many times stiffer than the body. A diagonal block resists a particle as if the facet on
    the other side stood still, so that both sides would hardly move together. The smoother therefore solves with
    ``D + S`` on the particles of these facets, with the diagonal blocks D of the rest, and the matrix of the nodes
    contains ``I^T S I``.

    Parameters
    ----------
    grid : BackgroundElements
        The coarse space.
    free : (n_rows, dim) bool
        Degrees of freedom that are not prescribed.

    Attributes
    ----------
    on_nodes : Triplets
        ``I^T S I`` over the scale, with the global numbers of the unknowns of nodes.

    Notes
    -----
    Construction and every method are collective. Call ``destroy`` before MPI ends.
    """

    on_nodes: Triplets

    def __init__(self, grid: BackgroundElements, free: Mask) -> None:
        self._body = grid.problem.body
        self._dim, self._symmetric, cloud = self._body.dim, grid.problem.symmetric, self._body.cloud
        # Signs of images, and 0 for prescribed unknowns.
        self._turned = cloud.halo.with_ghosts(free[: cloud.n_owned].astype(float))
        cloud.mirror(self._turned)
        # Nodes that move the local particles, and their weights.
        corners = grid.corners[grid.element]
        upper = grid.cells.corners[None] == 1
        N = np.prod(np.where(upper, grid.at[:, None], 1.0 - grid.at[:, None]), axis=2)
        self._nodes: GlobalIndex = cloud.halo.with_ghosts(grid.numbers[corners])
        self._weights = cloud.halo.with_ghosts(np.where(grid.held[corners], 0.0, N[:, :, None]))
        self._pc: PETSc.PC | None = None

    def take(self, tangent: Tangent, scale: float) -> tuple[Tangent, Tangent]:
        """Compute S and ``on_nodes``, over the scale, from the stiff part of a tangent; return rest and stiff part."""
        cloud, dim, turned = self._body.cloud, self._dim, self._turned
        stiff = [part for part in (product.stiff() for product in tangent.products) if part is not None]
        size = cloud.n_local * dim
        S = scipy.sparse.csr_matrix((size, size))
        marked = np.zeros(cloud.n_local)
        for product in stiff:
            ptr, members, h, g, b = product.one_by_one().data
            at = (members[:, None].astype(np.int64) * dim + np.arange(dim)).ravel()
            H, G = (
                scipy.sparse.csr_matrix(((v * turned[members]).ravel(), at, ptr * dim), shape=(len(b), size))
                for v in (h, g)
            )
            S = S + H.T @ scipy.sparse.diags(b / scale) @ G
            marked[members] = 1.0
        self._S = scipy.sparse.coo_matrix(S)
        cloud.halo.reverse(marked)
        # Own particles on facets, numbered over all ranks.
        self._particles: GlobalIndex = np.flatnonzero(marked[: cloud.n_owned])
        number = np.zeros(cloud.n_local, dtype=np.int64)
        number[self._particles] = offset(cloud.comm, len(self._particles)) + np.arange(len(self._particles))
        cloud.halo.forward(number)
        self._number = number
        self.on_nodes = self._restricted()
        rest = [product for product in tangent.products if product.stiff() is None]
        return Tangent(self._body, rest), Tangent(self._body, stiff)

    def _restricted(self) -> Triplets:
        """Return ``I^T S I`` with the global numbers of the unknowns of nodes."""
        dim, nodes, weights = self._dim, self._nodes, self._weights
        known = np.union1d(self._S.row // dim, self._S.col // dim)
        rows, columns = (np.searchsorted(known, at // dim) * dim + at % dim for at in (self._S.row, self._S.col))
        S = scipy.sparse.csr_matrix((self._S.data, (rows, columns)), shape=(len(known) * dim,) * 2)
        used, place = np.unique(nodes[known], return_inverse=True)
        at = place.reshape(len(known), nodes.shape[1])[:, None, :] * dim + np.arange(dim)[None, :, None]
        values = weights[known].transpose(0, 2, 1)
        ptr = np.arange(len(known) * dim + 1) * nodes.shape[1]
        P = scipy.sparse.csr_matrix((values.ravel(), at.ravel(), ptr), shape=(len(known) * dim, len(used) * dim))
        found = scipy.sparse.coo_matrix(P.T @ S @ P)
        return Triplets(
            used[found.row // dim] * dim + found.row % dim, used[found.col // dim] * dim + found.col % dim, found.data
        )

    def factor(self, blocks: Float) -> None:
        """Factor ``D + S`` of the particles on facets, from the blocks D of all own particles (n_rows, dim, dim)."""
        dim, S, comm = self._dim, self._S, self._body.cloud.comm
        own = self._number[self._particles]
        axis = np.arange(dim)
        rows = np.broadcast_to((own[:, None] * dim + axis)[:, :, None], (len(own), dim, dim))
        entries = Triplets(
            np.concatenate([self._number[S.row // dim] * dim + S.row % dim, rows.ravel()]),
            np.concatenate([self._number[S.col // dim] * dim + S.col % dim, rows.transpose(0, 2, 1).ravel()]),
            np.concatenate([S.data, blocks[self._particles].ravel()]),
        )
        size = len(own) * dim
        count = int(total(comm, size))
        self.destroy()
        self._inverse = np.linalg.inv(blocks)
        if count == 0:
            return
        matrix = assembled(comm, (size, count), entries, 0.0)
        self._pc = PETSc.PC().create(comm=comm)
        self._pc.setOptionsPrefix("interface_")
        self._pc.setOperators(matrix)
        self._pc.setType("cholesky" if self._symmetric else "lu")
        self._pc.setFactorSolverType("mumps")
        self._pc.setFromOptions()
        self._pc.setUp()
        self._b, self._x = matrix.createVecs()
        matrix.destroy()

    def solve(self, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Solve with ``D + S``, without stiff products with D."""
        values = x.array_r.reshape(-1, self._dim)
        found = np.einsum("pij,pj->pi", self._inverse, values)
        if self._pc is not None:
            self._b.setArray(values[self._particles].ravel())
            self._pc.apply(self._b, self._x)
            found[self._particles] = self._x.array_r.reshape(-1, self._dim)
        y.setArray(found.ravel())

    def destroy(self) -> None:
        """Free the PETSc objects."""
        if self._pc is not None:
            for thing in (self._pc, self._b, self._x):
                thing.destroy()
            self._pc = None
