"""Linear systems with one more row and column, for an unknown load factor."""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc

from pdpetsc.arrays import Float
from pdpetsc.petsc.library import set_up_failed, start_anew
from pdpetsc.petsc.tangent import PetscTangent


class Bordered:
    """Solve ``[K b; c d]``, whose last unknown is on the last rank, with two solves of ``K``.

    ``K y1 = r``, ``K y2 = b``; then ``z = (s - c . y1) / (d - c . y2)`` and ``y = y1 - z y2``.

    Parameters
    ----------
    tangent : PetscTangent
        K.

    Attributes
    ----------
    mat : Mat
        The bordered matrix, of type python.
    ksp : KSP
        Solver of the tangent, with the options of the command line.
    iterations : int
        Krylov iterations so far; the caller resets the number.

    Notes
    -----
    Construction and every method are collective. Call ``free`` before MPI ends.
    """

    def __init__(self, tangent: PetscTangent) -> None:
        self._tangent = tangent
        K = tangent.mat
        comm = K.getComm()
        self._last = comm.size - 1
        self._comm = comm.tompi4py()
        self._n = K.getLocalSize()[0]
        local = self._n + (comm.rank == self._last)
        size = (local, K.getSize()[0] + 1)
        self.ksp = PETSc.KSP().create(comm=comm)
        self.ksp.setOperators(K, tangent.preconditioner)
        self.mat = PETSc.Mat().createPython((size, size), context=self, comm=comm)
        self.mat.setUp()
        self._r, self._y1, self._y2, self._b, self._c = (tangent.preconditioner.createVecRight() for _ in range(5))
        self._d = 0.0
        self.iterations = 0

    def renew(self) -> None:
        """Bind the new matrices of the tangent."""
        self.ksp.setOperators(self._tangent.mat, self._tangent.preconditioner)
        self.equip()

    def equip(self) -> None:
        """Set properties of the solver of the tangent that options cannot set; its options must be set before."""
        self._tangent.equip(self.ksp)

    def vector(self) -> PETSc.Vec:
        """Create a vector of the bordered system."""
        return self.mat.createVecRight()

    def put(self, x: PETSc.Vec, values: Float, last: float) -> None:
        """Set a vector of the bordered system (not collective)."""
        x.array[: self._n] = values.ravel()
        if self._comm.rank == self._last:
            x.array[self._n] = last

    def split(self, x: PETSc.Vec) -> tuple[Float, float]:
        """Return the part of this rank without the last unknown, and the last unknown."""
        values = x.array_r
        last = float(values[self._n]) if self._comm.rank == self._last else 0.0
        return values[: self._n], float(self._comm.bcast(last, root=self._last))

    def border(self, b: Float, c: Float, d: float) -> None:
        """Set column, row and corner, after a change of the tangent (not collective)."""
        self._b.array, self._c.array, self._d = b.ravel(), c.ravel(), d

    def solve_in(self, outer: PETSc.KSP) -> None:
        """Register as linear solver of SNES, whose own KSP has the options prefix ``bordered_``."""
        outer.setOptionsPrefix("bordered_")
        outer.setType("preonly")
        pc = outer.getPC()
        pc.setType("python")
        pc.setPythonContext(self)

    def mult(self, mat: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Compute the product; called by PETSc."""
        values, last = self.split(x)
        self._r.array = values
        self._tangent.mat.mult(self._r, self._y1)
        self._y1.axpy(last, self._b)
        self.put(y, self._y1.array_r, self._c.dot(self._r) + self._d * last)

    def apply(self, pc: PETSc.PC, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Solve the system; called by PETSc. The result is not finite if the system has no solution."""
        values, last = self.split(x)
        self._r.array = values
        if set_up_failed(self.ksp):
            start_anew(self.ksp)
            y.set(np.nan)
            return
        self.ksp.solve(self._r, self._y1)
        self.iterations += self.ksp.getIterationNumber()
        self.ksp.solve(self._b, self._y2)
        self.iterations += self.ksp.getIterationNumber()
        corner = self._d - self._c.dot(self._y2)
        z = (last - self._c.dot(self._y1)) / corner if corner != 0.0 else np.nan
        self._y1.axpy(-z, self._y2)
        self.put(y, self._y1.array_r, z)

    def free(self) -> None:
        """Free the PETSc objects except the tangent."""
        for vec in (self._r, self._y1, self._y2, self._b, self._c):
            vec.destroy()
        self.mat.destroy()
        self.ksp.destroy()
