"""Interface of a tangent in PETSc, assembled or matrix-free."""

from __future__ import annotations

from abc import ABC, abstractmethod

from petsc4py import PETSc

from pdpetsc.arrays import Float
from pdpetsc.problem.state import State


class PetscTangent(ABC):
    """Represent the tangent of a body with prescribed degrees of freedom, and its preconditioning matrix.

    Attributes
    ----------
    mat : Mat
        The tangent.
    preconditioner : Mat
        The preconditioning matrix; the tangent itself if assembled.
    diagonal : (n_rows * dim,) float64
        Diagonal of the tangent, or an estimate of it [force / length].

    Notes
    -----
    Construction and every method are collective. Call ``destroy`` before MPI ends.
    """

    mat: PETSc.Mat
    preconditioner: PETSc.Mat
    diagonal: Float

    @abstractmethod
    def update(self, state: State, effort: tuple[int, float] | None = None) -> None:
        """Update to K at a state.

        ``effort`` holds the iterations of the last linear solve with it, and its digits. The preconditioning matrix may
        be kept while solves do not need many more iterations. Without ``effort`` it is rebuilt.
        """

    @abstractmethod
    def renew(self) -> bool:
        """Update after bonds have broken or mended, or terms couple others; return True if a matrix was replaced."""

    def equip(self, ksp: PETSc.KSP) -> None:  # noqa: B027
        """Set properties of a linear solver that options cannot set, such as levels of multigrid.

        Its options must be set before. Call it again if ``renew`` returned True.
        """

    def solve(self, ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """Solve ``K x = b``, to the tolerance of the linear solver; it may learn from it for the next solve."""
        ksp.solve(b, x)

    @abstractmethod
    def holds(self) -> bool:
        """Return True if the problem has not changed since ``update``, at any displacement (not collective)."""

    @abstractmethod
    def forget(self) -> None:
        """Force the next ``update`` to rebuild the tangent, since its displacement was rejected (not collective)."""

    @property
    @abstractmethod
    def bytes(self) -> int:
        """Return the memory of the entries that PETSc allocated, over all ranks [bytes]."""

    @abstractmethod
    def destroy(self) -> None:
        """Free the PETSc objects."""
