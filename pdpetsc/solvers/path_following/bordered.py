"""Linear systems with a few more rows and columns, for the load factor and motions of rigid bodies."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from petsc4py import PETSc

from pdpetsc.arrays import Float
from pdpetsc.petsc.library import set_failed, set_up_failed, start_anew
from pdpetsc.petsc.tangent import PetscTangent

# Largest number of solves for each column, to the accuracy that the last unknowns of the solve before require.
PASSES = 2
# A solution for a column is used if its residual is at most this multiple of the required one: the linear solver has
# another norm.
CLOSE = 5.0
# A residual that would be at most this multiple of ``enough`` is reduced to it, which saves an iteration of Newton's
# method.
NEARLY = 100.0


class Bordered:
    """Solve ``[K B; C D]``, whose ``m`` last unknowns are on the last rank, with ``m + 1`` solves of ``K``.

    ``K y = r``, ``K Y = B``; then ``z = (D - C Y)^-1 (s - C y)`` are the last unknowns and ``y - Y z`` the others. The
    residual is that of the first solve plus those of the others times z. They start from the last ``Y`` and are as
    accurate as z requires.

    Parameters
    ----------
    tangent : PetscTangent
        K.
    snes : SNES
        Newton's method, whose own KSP applies this solver and has the options prefix ``bordered_``.
    n_last : int
        m.

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

    def __init__(self, tangent: PetscTangent, snes: PETSc.SNES, n_last: int) -> None:
        self._tangent, self._snes, self._outer = tangent, snes, snes.getKSP()
        K = tangent.mat
        comm = K.getComm()
        self._last = comm.size - 1
        self._comm = comm.tompi4py()
        self._n = K.getLocalSize()[0]
        size = (self._n + n_last * (comm.rank == self._last), K.getSize()[0] + n_last)
        self.ksp = PETSc.KSP().create(comm=comm)
        self.ksp.setOperators(K, tangent.preconditioner)
        self.mat = PETSc.Mat().createPython((size, size), context=self, comm=comm)
        self.mat.setUp()
        self._r, self._y, self._rest, self._more = (tangent.preconditioner.createVecRight() for _ in range(4))
        self._B, self._Y = ([self._r.duplicate() for _ in range(n_last)] for _ in range(2))
        self._C: Callable[[Float], Float] = lambda values: np.zeros(n_last)
        self._D = np.zeros((n_last, n_last))
        self.iterations, self.enough = 0, 0.0
        # Whether a solve of the tangent has failed without an iteration.
        self._failed = False
        self.forget()
        self._outer.setOptionsPrefix("bordered_")
        self._outer.setType("preonly")
        pc = self._outer.getPC()
        pc.setType("python")
        pc.setPythonContext(self)

    def forget(self) -> None:
        """Discard the last solutions for the columns, which the next solve would start from."""
        for Y in self._Y:
            Y.set(0.0)

    def renew(self) -> None:
        """Bind the new matrices of the tangent."""
        self.ksp.setOperators(self._tangent.mat, self._tangent.preconditioner)
        self.equip()

    def equip(self) -> None:
        """Set properties of the solver of the tangent that options cannot set; its options must be set before."""
        self._tangent.equip(self.ksp)

    def put(self, x: PETSc.Vec, values: Float, last: Float) -> None:
        """Set a vector of the bordered system (not collective)."""
        x.array[: self._n] = values.ravel()
        if self._comm.rank == self._last:
            x.array[self._n :] = last

    def split(self, x: PETSc.Vec) -> tuple[Float, Float]:
        """Return the part of this rank without the last unknowns, and the last unknowns (m,)."""
        values = x.array_r
        return values[: self._n], np.asarray(self._comm.bcast(values[self._n :].copy(), root=self._last))

    def border(self, B: Sequence[Float], C: Callable[[Float], Float], D: Float) -> None:
        """Set columns, rows and corner (m, m), after a change of the tangent (not collective).

        The rows are a function of the entries of this rank that returns ``C y`` (m,), collective.
        """
        for column, values in zip(self._B, B, strict=True):
            column.array = values.ravel()
        self._C, self._D = C, D

    def mult(self, mat: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Compute the product; called by PETSc."""
        values, last = self.split(x)
        self._r.array = values
        self._tangent.mat.mult(self._r, self._y)
        self._y.maxpy(last, self._B)
        self.put(y, self._y.array_r, self._C(values) + self._D @ last)

    def apply(self, pc: PETSc.PC, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Solve the system; called by PETSc. The result is not finite if the system has no solution.

        The preconditioner fails if a solve of the tangent fails without an iteration. Its step would be zero, and SNES
        would repeat it.
        """
        values, last = self.split(x)
        self._r.array = values
        self._failed = False
        if set_up_failed(self.ksp):
            start_anew(self.ksp)
            y.set(np.nan)
            return
        if self._snes.getUseEW():
            self._solve_inexactly(last, x.norm())
        else:
            self._solve(self._r, self._y)
            for column, Y in zip(self._B, self._Y, strict=True):
                self._solve(column, Y)
        set_failed(pc, self._failed)
        z = self._last_unknowns(last)
        self._y.maxpy(-z, self._Y)
        self.put(y, self._y.array_r, z)

    def answer(self, values: Float) -> Float:
        """Solve with the tangent alone; return the entries of this rank."""
        self._r.array = values
        self._solve(self._r, self._y)
        return np.array(self._y.array_r)

    def _solve_inexactly(self, last: Float, size: float) -> None:
        """Compute y and Y so that the residual is within the tolerance of SNES (``-snes_ksp_ew``) times ``size``.

        ``last`` are the last entries of the right-hand side.
        """
        rtol = self._outer.getTolerances()[0]
        goal = rtol * size
        if goal < NEARLY * self.enough:
            goal = self.enough
        self._y.set(0.0)
        if self._r.norm() > goal:
            self._solve(self._r, self._y, goal)
        if not np.isfinite(sum(Y.norm() for Y in self._Y)):
            self.forget()
        for _ in range(PASSES):
            z, exact = np.abs(self._last_unknowns(last)), True
            for column, Y, share in zip(self._B, self._Y, z, strict=True):
                self._tangent.mat.mult(Y, self._rest)
                self._rest.aypx(-1.0, column)
                known = Y.norm() > 0.0 and 0.0 < share < np.inf
                needed = goal / (len(z) * share) if known else rtol * column.norm()
                if self._rest.norm() > CLOSE * needed:
                    self._solve(self._rest, self._more, needed)
                    Y.axpy(1.0, self._more)
                    exact = False
            if exact:
                break

    def _last_unknowns(self, last: Float) -> Float:
        """Return z (m,) from y, Y and the last entries of the right-hand side; not finite if there is no solution."""
        corner = self._D - np.stack([self._C(Y.array_r) for Y in self._Y], axis=1)
        try:
            return np.asarray(np.linalg.solve(corner, last - self._C(self._y.array_r)))
        except np.linalg.LinAlgError:
            return np.full(len(last), np.nan)

    def _solve(self, b: PETSc.Vec, y: PETSc.Vec, goal: float = 0.0) -> None:
        """Solve ``K y = b``, to a norm of the residual if ``goal`` is positive."""
        if goal > 0.0:
            self.ksp.setTolerances(rtol=goal / b.norm())
        self._tangent.solve(self.ksp, b, y)
        iterations = self.ksp.getIterationNumber()
        self.iterations += iterations
        self._failed |= self.ksp.getConvergedReason() < 0 and iterations == 0

    def free(self) -> None:
        """Free the PETSc objects except the tangent."""
        for vec in (self._r, self._y, self._rest, self._more, *self._B, *self._Y):
            vec.destroy()
        self.mat.destroy()
        self.ksp.destroy()
