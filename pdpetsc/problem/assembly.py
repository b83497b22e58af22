"""Assembly of the matrix of the tangent."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex
from pdpetsc.discrete.sparsity import build_sparsity, positions_of_own_blocks
from pdpetsc.gradient.products import Entries
from pdpetsc.problem.problem import Problem, Tangent
from pdpetsc.problem.state import State


class Filler(ABC):
    """Fill the matrices of a solver of a problem.

    Attributes
    ----------
    problem : Problem
        The problem.
    """

    problem: Problem

    @abstractmethod
    def rehearse(self, state: State) -> None:
        """Fill the matrices once, only to compile the kernels."""


class Assembler(Filler):
    """Fill the value arrays of the tangent matrix of a problem, term by term.

    Parameters
    ----------
    problem : Problem
        The problem.
    stencils : (point_ptr, members), optional
        Particles that the matrix couples; by default those that the terms couple.

    Attributes
    ----------
    pattern : Sparsity
        Sparsity of the matrix.

    Notes
    -----
    Construction and ``assemble`` are collective.
    """

    def __init__(self, problem: Problem, stencils: tuple[GlobalIndex, LocalIndex] | None = None) -> None:
        self.problem = problem
        self.pattern = sparsity = build_sparsity(problem.body.cloud, *(stencils or _stencils(problem)))
        dim = problem.dim
        self._ghost = np.empty(dim**2 * int(sparsity.ghost.diag_ptr[-1]))
        self._own_blocks = positions_of_own_blocks(sparsity.owned, sparsity.n_own_columns, dim)

    def rehearse(self, state: State) -> None:
        """Assemble once (collective)."""
        size = self.problem.dim**2 * np.array([self.pattern.owned.diag_ptr[-1], self.pattern.owned.off_ptr[-1]])
        self.assemble(state, np.empty(size[0]), np.empty(size[1]))

    def assemble(self, state: State, diag: Float, off: Float) -> None:
        """Write the values of K for the own rows: own columns to ``diag``, the others to ``off``.

        Parameters
        ----------
        state : State
            State, admissible on all ranks.
        diag, off : float64
            Scalar CSR values in ``sparsity.rows`` order.
        """
        dim, owned = self.problem.dim, self.pattern.owned
        n_diag, n_off = dim**2 * int(owned.diag_ptr[-1]), dim**2 * int(owned.off_ptr[-1])
        diag[:] = 0.0
        off[:] = 0.0
        self._ghost[:] = 0.0
        entries = Entries(self.pattern, diag[:n_diag], off[:n_off], self._ghost)
        # Moduli replace F in memory, and are freed as soon as the matrix contains them.
        tangent = self.problem.linearised(state)
        state.forget()
        assembled = self._fill(tangent, entries)
        del tangent
        if assembled.blocks is not None:
            entries.diag[self._own_blocks] += assembled.blocks
        self.pattern.complete(self._ghost, entries.diag, entries.off, dim)
        if self.pattern.border is not None:
            self._assemble_border(assembled, diag, off)

    def _fill(self, tangent: Tangent, entries: Entries) -> Tangent:
        """Add the rows of families; return the tangent that the matrix represents."""
        for product in tangent.products:
            product.add_rows(entries)
        return tangent

    def _assemble_border(self, tangent: Tangent, diag: Float, off: Float) -> None:
        """Write the columns of the virtual unknowns, from the tangent applied to each of them, and their rows."""
        sparsity, cloud, dim = self.pattern, self.problem.body.cloud, self.problem.dim
        border, n = sparsity.border, cloud.n_owned
        assert border is not None
        rows = sparsity.rows
        numbers = np.concatenate([border.arrived, border.columns])
        order = np.argsort(numbers)
        n_here = dim * int(np.count_nonzero(numbers < sparsity.n_own_columns))
        # Virtual columns are the last columns of the rank that holds them, and the last off-diagonal ones on other
        # ranks.
        values, ptr = (diag, rows.diag_ptr) if cloud.n_virtual else (off, rows.off_ptr)
        n_blocks = np.diff(ptr)[border.particles]
        start = dim * dim * ptr[border.particles] + dim * (n_blocks - cloud.n_virtual_global)
        for v, c, column in tangent.columns_of_virtual():
            for i in range(dim):
                values[start + i * dim * n_blocks + dim * v + c] = column[border.particles, i]
            arrived = border.gather(np.ascontiguousarray(column[border.particles]))
            if cloud.n_virtual:
                row = np.concatenate([arrived, column[n:]])[order].ravel()
                here = dim * dim * rows.diag_ptr[n + v] + c * n_here
                diag[here : here + n_here] = row[:n_here]
                there = dim * dim * rows.off_ptr[n + v] + c * (len(row) - n_here)
                off[there : there + len(row) - n_here] = row[n_here:]


def _stencils(problem: Problem) -> tuple[GlobalIndex, LocalIndex]:
    """Return the stencils of all terms; if a term couples whole families, the families replace stencils within them."""
    terms, found = list(problem.terms), []
    if any(term.whole_families for term in terms):
        whole = problem.body.with_centres
        found = [(whole.point_ptr, whole.members)]
        terms = [term for term in terms if not term.within_families]
    of_terms = [term.stencils for term in terms]
    found += [stencils for stencils in of_terms if stencils is not None]
    if len(found) == 1:
        return found[0]
    if not found:
        own = np.arange(problem.body.cloud.n_owned + 1, dtype=np.int64)
        return own, own[:-1].astype(np.int32)
    starts = [0, *np.cumsum([ptr[-1] for ptr, _ in found])]
    ptr = np.concatenate([[0], *(p[1:] + start for (p, _), start in zip(found, starts, strict=False))])
    return ptr.astype(np.int64), np.concatenate([members for _, members in found])
