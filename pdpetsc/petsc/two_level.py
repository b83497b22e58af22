"""Two-level preconditioner of a matrix-free tangent: its diagonal blocks, and a background grid."""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc

from pdpetsc.arrays import Float, Mask, row_of_entries
from pdpetsc.discrete.communicator import total
from pdpetsc.errors import CaseError
from pdpetsc.gradient.near_inverse import Triplets
from pdpetsc.kernels.point_blocks import definite
from pdpetsc.petsc.interface import Interface
from pdpetsc.petsc.matrix_free import Preconditioning
from pdpetsc.petsc.shell import Shell
from pdpetsc.petsc.slow_modes import SlowModes
from pdpetsc.petsc.sparse import (
    PER_ENTRY,
    allocated_bytes,
    assembled,
    block_matrix,
    set_rigid_modes,
    set_symmetry,
    size_of,
)
from pdpetsc.problem.background_elements import BackgroundElements
from pdpetsc.problem.problem import Tangent
from pdpetsc.problem.state import State

# Largest number of coarse unknowns that are solved directly, by dimension.
DIRECT_COARSE = {1: 10**6, 2: 20_000, 3: 12_000}
# Smallest eigenvalue of a diagonal block over a typical one.
LEAST = 1e-12
# Smoothers that use estimated bounds.
BOUNDED = ("chebyshev",)


class TwoLevel(Preconditioning):
    """Provide PETSc's multigrid with two levels: diagonal blocks of the tangent, and a background grid.

    A nonlocal operator resists all waves shorter than about two horizons alike, so that diagonal blocks are as good as
    any smoother for them. A grid of linear elements resolves the longer waves; see ``BackgroundElements``.

    Parameters
    ----------
    grid : BackgroundElements
        The coarse space.
    fixed : (n_rows, dim) bool
        Prescribed degrees of freedom.
    scale : float
        Unit of stiffness in the matrices [force / length].

    Attributes
    ----------
    coarse : Mat
        Matrix of the nodes.
    """

    def __init__(self, grid: BackgroundElements, fixed: Mask, scale: float) -> None:
        self._grid, self._fixed, self._scale = grid, fixed, scale
        self._problem = problem = grid.problem
        dim, comm = problem.dim, problem.body.cloud.comm
        self.diagonal = np.zeros(fixed.size)
        fine, size = size_of(problem.body.cloud), (grid.n_own * dim, grid.n_global * dim)
        self.mat, self.coarse = block_matrix(comm, fine, dim), block_matrix(comm, size, dim)
        self.mat.setPreallocationNNZ((dim, 0))
        row_ptr, columns = grid.rows
        self._rows = row_ptr.astype(PETSc.IntType), columns.astype(PETSc.IntType)
        self.coarse.setPreallocationCSR(self._rows)
        for mat in (self.mat, self.coarse):
            set_symmetry(mat, problem)
        set_rigid_modes(self.coarse, grid.rigid_modes())
        self._interpolation = PETSc.Mat().createPython(
            (fine, size), context=_Interpolation(grid, self.coarse), comm=comm
        )
        self._interpolation.setUp()
        self._interface = Interface(grid, ~fixed) if problem.stiff else None
        self._nodes: PETSc.KSP | None = None
        self._blocks = PETSc.PC().create(comm)
        self._blocks.setType("pbjacobi")
        self._blocks.setOperators(self.mat)

    def fill(self, state: State) -> Tangent:
        """Fill the diagonal blocks and the matrix of the nodes, without constraints; return the tangent."""
        cloud, dim = self._problem.body.cloud, self._problem.dim
        whole = self._problem.linearised(state)
        state.forget()
        tangent = whole.softened()
        of_virtual = _blocks_of_virtual(tangent)
        if self._interface is None:
            blocks = np.concatenate([tangent.point_blocks(), of_virtual])
        else:
            rest, springs = self._interface.take(tangent, self._scale)
            without = np.concatenate([rest.point_blocks(), of_virtual])
            blocks = without.copy()
            blocks[: cloud.n_owned] += springs.point_blocks()
        diagonal = np.einsum("pii->pi", blocks).copy()
        self.diagonal = diagonal.ravel()
        values = self._grid.fill(tangent.stiffness(), tangent.blocks, diagonal, self._scale)
        if self._interface is None:
            self.coarse.setValuesCSR(*self._rows, values)
            self.coarse.assemble()
            self.coarse.stateIncrease()
        else:
            self._take_nodes(values)
            self._interface.factor(self._definite(without))
        del values
        blocks = self._definite(blocks)
        first = self.mat.getOwnershipRange()[0] // dim
        ptr = np.arange(len(blocks) + 1, dtype=PETSc.IntType)
        self.mat.setValuesBlockedCSR(ptr, ptr[:-1] + first, blocks)
        self.mat.assemble()
        self.mat.stateIncrease()
        return whole

    def _definite(self, blocks: Float) -> Float:
        """Return diagonal blocks over the scale, positive definite, with 1 for prescribed unknowns (collective)."""
        comm, dim = self._problem.body.cloud.comm, self._problem.dim
        size = float(total(comm, float(np.abs(np.einsum("pii->pi", blocks)).sum())))
        blocks = blocks / self._scale
        free = ~self._fixed
        blocks *= free[:, :, None] & free[:, None, :]
        i = np.arange(dim)
        blocks[:, i, i] += self._fixed
        definite(blocks, LEAST * size / (self.mat.getSize()[0] * self._scale))
        return blocks

    def _take_nodes(self, values: Float) -> None:
        """Build the matrix of the nodes from the values of the grid and the springs between facets (collective)."""
        assert self._interface is not None
        sizes = self.coarse.getSizes()[0]
        ptr, columns = self._rows
        rows = self._grid.first * self._problem.dim + row_of_entries(ptr)
        parts = zip(Triplets(rows, columns.astype(np.int64), values), self._interface.on_nodes, strict=True)
        coarse = assembled(self.coarse.comm.tompi4py(), sizes, Triplets(*(np.concatenate(part) for part in parts)), 0.0)
        coarse.setBlockSize(self._problem.dim)
        self.coarse.destroy()
        self.coarse = coarse
        set_symmetry(coarse, self._problem)
        set_rigid_modes(coarse, self._grid.rigid_modes())
        if self._nodes is not None:
            self._nodes.setOperators(coarse, coarse)

    def renewed(self) -> Preconditioning:
        """Build a new preconditioner for the current fragments."""
        self.destroy()
        return TwoLevel(BackgroundElements(self._problem), self._fixed, self._scale)

    def equip(self, tangent: PETSc.Mat, ksp: PETSc.KSP) -> None:
        """Set up the two levels of multigrid. Raise CaseError if options request another number of levels."""
        pc = ksp.getPC()
        if pc.getType() != "mg":
            return
        pc.reset()
        ksp.setOperators(tangent, self.mat)
        pc.setMGLevels(2)
        pc.setMGInterpolation(1, self._interpolation)
        nodes = pc.getMGCoarseSolve()
        nodes.setOperators(self.coarse, self.coarse)
        nodes.setNormType(PETSc.KSP.NormType.NONE)
        if self.coarse.getSize()[0] <= DIRECT_COARSE[self._problem.dim]:
            nodes.setType("preonly")
            nodes.getPC().setType("cholesky" if self._problem.symmetric else "lu")
            nodes.getPC().setFactorSolverType("mumps")
        else:
            nodes.setType("chebyshev")
            nodes.getPC().setType("gamg")
        smoother = pc.getMGSmoother(1)
        smoother.setOperators(tangent, self.mat)
        pc.setFromOptions()
        if pc.getMGLevels() != 2:
            raise CaseError(
                f"The preconditioner of a tangent without a matrix has 2 levels, not the {pc.getMGLevels()} of "
                f"-pc_mg_levels; more of them are GAMG's on the coarse one, -mg_coarse_pc_type gamg."
            )
        nodes.setFromOptions()
        smoother.setFromOptions()
        self._nodes = nodes
        if smoother.getPC().getType() == "python":
            learns = ksp.getType() == "minres" and smoother.getType() == "preonly"
            self.slow = SlowModes(self.mat) if learns else None
            smoother.getPC().setPythonContext(Shell(self._smooth))
        self.bounded = smoother.getType() in BOUNDED

    def _smooth(self, r: PETSc.Vec, z: PETSc.Vec) -> None:
        """Solve the diagonal blocks with the springs between facets, and add the slow modes."""
        if self._interface is None:
            self._blocks.apply(r, z)
        else:
            self._interface.solve(r, z)
        if self.slow is not None:
            self.slow.add(r, z)

    @property
    def bytes(self) -> int:
        """Return the memory of the entries of both matrices, over all ranks [bytes]."""
        return allocated_bytes(self.mat, self.coarse)

    def destroy(self) -> None:
        self._interpolation.destroy()
        self._blocks.destroy()
        self._nodes = None
        if self._interface is not None:
            self._interface.destroy()
        self.coarse.destroy()
        self.mat.destroy()


def predicted_bytes_of(grid: BackgroundElements) -> int:
    """Estimate the memory of the matrix entries of a grid over all ranks [bytes] (collective)."""
    cloud, dim = grid.problem.body.cloud, grid.problem.dim
    entries = grid.n_entries + cloud.n_rows * dim**2
    return int(total(cloud.comm, entries)) * PER_ENTRY


class _Interpolation:
    """Provide interpolation from nodes to unknowns, and its transpose, as a PETSc shell matrix."""

    def __init__(self, grid: BackgroundElements, coarse: PETSc.Mat) -> None:
        self._grid, self._dim = grid, grid.problem.dim
        dim, numbers = self._dim, grid.numbers.astype(PETSc.IntType)
        self._nodal = PETSc.Vec().createSeq(len(numbers) * dim, bsize=dim)
        whole = coarse.createVecRight()
        rows = PETSc.IS().createBlock(dim, numbers, comm=PETSc.COMM_SELF)
        self._scatter = PETSc.Scatter().create(whole, rows, self._nodal, None)
        whole.destroy()
        rows.destroy()

    def mult(self, mat: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Interpolate displacements of the nodes to the unknowns."""
        self._scatter.scatter(x, self._nodal, False, PETSc.ScatterMode.FORWARD)
        y.setArray(self._grid.interpolate(self._nodal.array_r.reshape(-1, self._dim)).ravel())

    def multTranspose(self, mat: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Restrict forces on the unknowns to the nodes."""
        f = x.array_r.reshape(-1, self._dim)
        self._nodal.setArray(self._grid.restrict(f).ravel())
        y.set(0.0)
        self._scatter.scatter(self._nodal, y, True, PETSc.ScatterMode.REVERSE)

    def destroy(self, mat: PETSc.Mat) -> None:
        """Free the PETSc objects; called by PETSc with the last use of the matrix."""
        self._scatter.destroy()
        self._nodal.destroy()


def _blocks_of_virtual(tangent: Tangent) -> Float:
    """Return the diagonal block of each row of virtual unknowns (n_virtual, dim, dim) (collective)."""
    cloud, dim = tangent.body.cloud, tangent.body.dim
    blocks = np.zeros((cloud.n_virtual, dim, dim))
    for v, c, column in tangent.columns_of_virtual():
        if cloud.n_virtual:
            blocks[v, :, c] = column[cloud.n_owned + v]
    return blocks
