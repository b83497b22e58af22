"""What fills the tangent matrix of a model."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.discrete.pattern import Pattern

if TYPE_CHECKING:
    from pdpetsc.model.base import Model
    from pdpetsc.model.linearised import Linearised


class Assembler(ABC):
    """Fills the value arrays of the tangent matrix of a model.

    Attributes
    ----------
    model : Model
        The body.
    pattern : Pattern
        Where the values go.

    Notes
    -----
    Construction and ``assemble`` are collective.
    """

    model: Model
    pattern: Pattern

    def assemble(self, u: Float, diag: Float, off: Float) -> None:
        """Write the values of K(u) for the own rows: own columns into ``diag``, the others into ``off``.

        Parameters
        ----------
        u : (n_rows, dim) float64
            Unknowns [length], admissible on all ranks.
        diag, off : float64
            Scalar CSR values in ``pattern.rows`` order.
        """
        size = self.model.dim**2
        particles = self.pattern.owned
        n_diag, n_off = size * int(particles.diag_ptr[-1]), size * int(particles.off_ptr[-1])
        self.assemble_particles(u, diag[:n_diag], off[:n_off])
        if self.pattern.border is not None:
            self._assemble_border(self.linearised(u), diag, off)

    def linearised(self, u: Float) -> Linearised:
        """Return what the matrix assembles, for the columns of virtual unknowns."""
        return self.model.linearised(u)

    @abstractmethod
    def assemble_particles(self, u: Float, diag: Float, off: Float) -> None:
        """Write the rows of the own particles, with virtual unknowns held; zero in virtual columns."""

    def _assemble_border(self, tangent: Linearised, diag: Float, off: Float) -> None:
        """Write the columns of the virtual unknowns, from the tangent applied to each of them, and their rows."""
        pattern, cloud, dim = self.pattern, self.model.cloud, self.model.dim
        border, n = pattern.border, cloud.n_owned
        assert border is not None
        rows = pattern.rows
        numbers = np.concatenate([border.arrived, border.columns])
        order = np.argsort(numbers)
        n_here = dim * int(np.count_nonzero(numbers < pattern.n_own_columns))
        # Virtual columns are the last of the columns of the rank that holds them, and of the others elsewhere.
        values, ptr = (diag, rows.diag_ptr) if cloud.n_virtual else (off, rows.off_ptr)
        n_blocks = np.diff(ptr)[border.particles]
        start = dim * dim * ptr[border.particles] + dim * (n_blocks - cloud.n_virtual_global)
        for v in range(cloud.n_virtual_global):
            for c in range(dim):
                unit = np.zeros((cloud.n_rows, dim))
                if cloud.n_virtual:
                    unit[n + v, c] = 1.0
                column = tangent(unit)
                for i in range(dim):
                    values[start + i * dim * n_blocks + dim * v + c] = column[border.particles, i]
                arrived = border.gather(np.ascontiguousarray(column[border.particles]))
                if cloud.n_virtual:
                    row = np.concatenate([arrived, column[n:]])[order].ravel()
                    here = dim * dim * rows.diag_ptr[n + v] + c * n_here
                    diag[here : here + n_here] = row[:n_here]
                    there = dim * dim * rows.off_ptr[n + v] + c * (len(row) - n_here)
                    off[there : there + len(row) - n_here] = row[n_here:]
