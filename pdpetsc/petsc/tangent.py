"""What solvers ask of a tangent in PETSc, assembled or not."""

from __future__ import annotations

from abc import ABC, abstractmethod

from petsc4py import PETSc

from pdpetsc.arrays import Float
from pdpetsc.problem.state import State


class PetscTangent(ABC):
    """The tangent of a body with prescribed degrees of freedom, and the matrix that its preconditioner is made from.

    Attributes
    ----------
    mat : Mat
        The tangent.
    preconditioner : Mat
        What the preconditioner is made from; the tangent itself where it is assembled.
    diagonal : (n_rows * dim,) float64
        Its diagonal, or an estimate of it [force / length].

    Notes
    -----
    Construction and every method are collective. Call ``destroy`` before MPI ends.
    """

    mat: PETSc.Mat
    preconditioner: PETSc.Mat
    diagonal: Float

    @abstractmethod
    def update(self, state: State, effort: float | None = None) -> None:
        """Make it K at a state.

        ``effort`` is what the last linear solve with it took [iterations per digit]: the matrix of the preconditioner
        may stay as it is while that does not grow. Without ``effort`` that matrix is made anew.
        """

    @abstractmethod
    def renew(self) -> bool:
        """Follow bonds that have broken or mended; return whether ``preconditioner`` is another one now."""

    def equip(self, ksp: PETSc.KSP) -> None:  # noqa: B027
        """Give a linear solver, whose options are set, what options alone do not: levels of multigrid.

        To be called again where ``renew`` returned True.
        """

    @abstractmethod
    def holds(self) -> bool:
        """Return whether the problem has not changed since ``update``, at whatever displacement (not collective)."""

    @abstractmethod
    def forget(self) -> None:
        """Let the next ``update`` make it anew: its displacement was given up (not collective)."""

    @property
    @abstractmethod
    def bytes(self) -> int:
        """Return the memory of the entries that PETSc allocated, over all ranks [bytes]."""

    @abstractmethod
    def destroy(self) -> None:
        """Free the PETSc objects."""
