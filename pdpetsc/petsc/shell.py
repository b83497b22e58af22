"""Functions as matrices and preconditioners of PETSc."""

from __future__ import annotations

from collections.abc import Callable

from petsc4py import PETSc


class Shell:
    """Let PETSc call a function of two vectors ``(x, y)`` that writes a product or an approximate solution for x to y.

    It has no method ``destroy``, which PETSc would call, so that it may refer to an object that has one.

    Parameters
    ----------
    write : callable
        The function.
    """

    def __init__(self, write: Callable[[PETSc.Vec, PETSc.Vec], None]) -> None:
        self._write = write

    def mult(self, mat: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Compute the product; called by PETSc."""
        self._write(x, y)

    def apply(self, pc: PETSc.PC, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Apply the preconditioner; called by PETSc."""
        self._write(x, y)
