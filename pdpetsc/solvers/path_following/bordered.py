"""Linear systems with one more row and column, for an unknown load factor."""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc

from pdpetsc.arrays import Float
from pdpetsc.petsc.library import set_up_failed, start_anew
from pdpetsc.petsc.tangent import PetscTangent

# Largest number of solves for the column, each to the accuracy that the last unknown of the solve before requires.
PASSES = 2
# A solution for the column is used if its residual is at most this multiple of what is required: the linear solver has
# another norm.
CLOSE = 5.0
# A residual that would be at most this multiple of ``enough`` is reduced to it, which saves an iteration of Newton's
# method.
NEARLY = 100.0


class Bordered:
    """Solve ``[K b; c d]``, whose last unknown is on the last rank, with two solves of ``K``.

    ``K y1 = r``, ``K y2 = b``; then ``z = (s - c . y1) / (d - c . y2)`` and ``y = y1 - z y2``. The residual is that of
    the first solve plus z times that of the second one, which starts from the last ``y2`` and is as accurate as z
    requires.

    Parameters
    ----------
    tangent : PetscTangent
        K.
    snes : SNES
        Newton's method, whose own KSP applies this solver and has the options prefix ``bordered_``.

    Attributes
    ----------
    mat : Mat
        The bordered matrix, of type python.
    ksp : KSP
        Solver of the tangent, with the options of the command line.
    iterations : int
        Krylov iterations so far; the caller resets the number.
    enough : float
        Norm of the residual that solves need not fall below, set by the caller.

    Notes
    -----
    Construction and every method are collective. Call ``free`` before MPI ends.
    """

    def __init__(self, tangent: PetscTangent, snes: PETSc.SNES) -> None:
        self._tangent, self._snes, self._outer = tangent, snes, snes.getKSP()
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
        self._rest, self._more = self._b.duplicate(), self._b.duplicate()
        self._d = 0.0
        self.iterations, self.enough = 0, 0.0
        self.forget()
        self._outer.setOptionsPrefix("bordered_")
        self._outer.setType("preonly")
        pc = self._outer.getPC()
        pc.setType("python")
        pc.setPythonContext(self)

    def forget(self) -> None:
        """Discard the last solution for the column, which the next solve would start from."""
        self._y2.set(0.0)

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
        if self._snes.getUseEW():
            self._solve_inexactly(last, x.norm())
        else:
            self._solve(self._r, self._y1)
            self._solve(self._b, self._y2)
        z = self._last_unknown(last)
        self._y1.axpy(-z, self._y2)
        self.put(y, self._y1.array_r, z)

    def _solve_inexactly(self, last: float, size: float) -> None:
        """Compute y1 and y2 so that the residual is within the tolerance of SNES (``-snes_ksp_ew``) times ``size``.

        ``last`` is the last entry of the right-hand side.
        """
        rtol = self._outer.getTolerances()[0]
        goal = rtol * size
        if goal < NEARLY * self.enough:
            goal = self.enough
        self._y1.set(0.0)
        if self._r.norm() > goal:
            self._solve(self._r, self._y1, goal)
        if not np.isfinite(self._y2.norm()):
            self.forget()
        for _ in range(PASSES):
            self._tangent.mat.mult(self._y2, self._rest)
            self._rest.aypx(-1.0, self._b)
            z = abs(self._last_unknown(last))
            known = self._y2.norm() > 0.0 and 0.0 < z < np.inf
            needed = goal / z if known else rtol * self._b.norm()
            if self._rest.norm() <= CLOSE * needed:
                break
            self._solve(self._rest, self._more, needed)
            self._y2.axpy(1.0, self._more)

    def _last_unknown(self, last: float) -> float:
        """Return z from y1, y2 and the last entry of the right-hand side."""
        corner = self._d - self._c.dot(self._y2)
        return float((last - self._c.dot(self._y1)) / corner) if corner != 0.0 else np.nan

    def _solve(self, b: PETSc.Vec, y: PETSc.Vec, goal: float = 0.0) -> None:
        """Solve ``K y = b``, to a norm of the residual if ``goal`` is positive."""
        if goal > 0.0:
            self.ksp.setTolerances(rtol=goal / b.norm())
        self.ksp.solve(b, y)
        self.iterations += self.ksp.getIterationNumber()

    def free(self) -> None:
        """Free the PETSc objects except the tangent."""
        for vec in (self._r, self._y1, self._y2, self._b, self._c, self._rest, self._more):
            vec.destroy()
        self.mat.destroy()
        self.ksp.destroy()
