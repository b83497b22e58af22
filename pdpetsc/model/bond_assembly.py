"""Assembly of the tangent of bodies whose forces act along bonds."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex
from pdpetsc.discrete.pattern import Rows, build_pattern
from pdpetsc.kernels.assembly import assemble_kernel
from pdpetsc.kernels.bonds import bond_rows_kernel
from pdpetsc.kernels.pattern import sum_by, transpose
from pdpetsc.model.assembler import Assembler

if TYPE_CHECKING:
    from pdpetsc.model.bonds import BondModel


class BondAssembler(Assembler):
    """Rows of bonds: a particle couples to its family alone."""

    model: BondModel

    def __init__(self, model: BondModel) -> None:
        self.model = model
        self._start(2 * np.arange(len(model.families.neighbours) + 1, dtype=np.int64), _ends(model))

    def assemble_particles(self, u: Float, diag: Float, off: Float) -> None:
        """Write the rows of the own particles."""
        diag[:] = 0.0
        off[:] = 0.0
        self._ghost[:] = 0.0
        u_local = self.model.with_ghosts(u)
        self._add_bonds(u_local, self.model.elongation(u_local), diag, off)
        self.pattern.complete(self._ghost, diag, off, self.model.dim)

    def _start(self, point_ptr: GlobalIndex, members: LocalIndex) -> None:
        model = self.model
        self.pattern = build_pattern(model.cloud, point_ptr, members)
        self._ends = _ends(model)
        ends_ptr = 2 * np.arange(len(model.families.neighbours) + 1, dtype=np.int64)
        self._by_particle = transpose(ends_ptr, self._ends, model.cloud.n_local)
        self._ghost = np.empty(model.dim**2 * int(self.pattern.ghost.diag_ptr[-1]))

    def _add_bonds(self, u_local: Float, e: Float, diag: Float, off: Float) -> None:
        model, pattern = self.model, self.pattern
        tangent, tension = model.tangent(e), model.tension(e)
        kernel = bond_rows_kernel(model.dim, model.finite)
        for rows, own in ((pattern.owned, diag), (pattern.ghost, self._ghost)):
            kernel(
                rows.first, rows.diag_ptr, rows.off_ptr, rows.columns, *pattern.locals_of_columns, *self._by_particle,
                self._ends, model.cloud.x, u_local, tangent, tension, own, off,
            )  # fmt: skip


class DilatationAssembler(BondAssembler):
    """Rows of bonds and of the dilatation, ``sum_i B_i grad theta_i (x) grad theta_i``, which reaches two horizons."""

    def __init__(self, model: BondModel) -> None:
        self.model = model
        stencils = model.with_centres
        self._start(stencils.point_ptr, stencils.members)
        self._transposed = transpose(stencils.point_ptr, stencils.members, model.cloud.n_local)

    def assemble_particles(self, u: Float, diag: Float, off: Float) -> None:
        """Write the rows of the own particles."""
        model = self.model
        assert model.a is not None and model.B is not None
        u_local = model.with_ghosts(u)
        xi = model.families.bonds(model.cloud.x)
        y = xi + model.finite * (u_local[model.families.neighbours] - u_local[model.families.centres])
        bond = model.a[:, None] * y / np.linalg.norm(y, axis=1)[:, None]
        at = model.families.indptr[:-1]
        g = np.insert(bond, at, -sum_by(model.families.centres, bond, model.cloud.n_owned), axis=0)
        one = np.eye(model.dim)
        A = np.tile(np.einsum("im,kn->imkn", one, one), (model.cloud.n_owned, 1, 1, 1, 1))
        for rows, own in ((self.pattern.owned, diag), (self.pattern.ghost, self._ghost)):
            self._dilatation_rows(rows, g, A, own, off)
        self._add_bonds(u_local, model.elongation(u_local), diag, off)
        self.pattern.complete(self._ghost, diag, off, model.dim)

    def _dilatation_rows(self, rows: Rows, g: Float, A: Float, diag: Float, off: Float) -> None:
        model, stencils = self.model, self.model.with_centres
        assemble_kernel(model.dim)(
            rows.first, rows.diag_ptr, rows.off_ptr, rows.columns, *self.pattern.locals_of_columns, *self._transposed,
            stencils.point_ptr, stencils.members, g, g, model.B, A, diag, off,
        )  # fmt: skip


def _ends(model: BondModel) -> LocalIndex:
    """Return both particles of every bond one after the other, (2 n_bonds,)."""
    return np.stack([model.families.centres, model.families.neighbours], axis=1).ravel()
