"""Assembly of the tangent of correspondence models whose bonds fail."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex
from pdpetsc.discrete.pattern import build_pattern
from pdpetsc.gradient.base import whole_families
from pdpetsc.kernels.bonds import outer_rows_kernel
from pdpetsc.kernels.pattern import transpose
from pdpetsc.model.correspondence import CorrespondenceAssembler

if TYPE_CHECKING:
    from pdpetsc.model.damaged import DamagedCorrespondenceModel


class DamagedAssembler(CorrespondenceAssembler):
    """Assembly on the pattern of whole families, which no broken bond changes."""

    model: DamagedCorrespondenceModel

    def __init__(self, model: DamagedCorrespondenceModel) -> None:
        self.model = model
        stencils = whole_families(model.cloud, model.families, np.ones(len(model.families.neighbours)))
        self.pattern = build_pattern(model.cloud, stencils.point_ptr, stencils.members)
        self._ghost = np.empty(model.dim**2 * int(self.pattern.ghost.diag_ptr[-1]))
        self._control = None
        self._controlled = model.control

    def assemble_particles(self, u: Float, diag: Float, off: Float) -> None:
        """Write the rows of the own particles."""
        model, pattern, dim = self.model, self.pattern, self.model.dim
        self._transpose()
        u_local = model.with_ghosts(u)
        F = model.deformation(u_local)
        A = model.moduli(F)
        T, slope = model.failure.at(model.elongation(u_local))
        self._h = model.scaled_weights(T)
        self._rows(pattern.owned, A, diag, off)
        self._rows(pattern.ghost, A, self._ghost, off)
        if model.failure.softens:
            self._add_softening(model.softening(u_local, F, slope), diag, off)
        pattern.complete(self._ghost, diag, off, dim)
        control = model.control_at(T)
        if control is not None:
            if self._control is None or self._controlled is not control:
                self._control, self._controlled = control.matrix(pattern), control
            self._control.add(dim, diag, off)

    @property
    def force_weights(self) -> Float:
        """Return the scaled weights."""
        return self._h

    def _add_softening(self, falling: tuple[GlobalIndex, Float, Float], diag: Float, off: Float) -> None:
        model, pattern = self.model, self.pattern
        bonds, v, m = falling
        ends = np.stack([model.families.centres[bonds], model.families.neighbours[bonds]], axis=1).ravel()
        by_particle = transpose(2 * np.arange(len(bonds) + 1, dtype=np.int64), ends, model.cloud.n_local)
        kernel = outer_rows_kernel(model.dim)
        for rows, own in ((pattern.owned, diag), (pattern.ghost, self._ghost)):
            kernel(
                rows.first, rows.diag_ptr, rows.off_ptr, rows.columns, *pattern.locals_of_columns, *by_particle,
                ends, v, m, own, off,
            )  # fmt: skip
