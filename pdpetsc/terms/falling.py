"""The part of a tangent that comes from the derivative of the integrity of bonds by the displacement."""

from __future__ import annotations

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex
from pdpetsc.kernels.bonds import outer_rows_kernel
from pdpetsc.kernels.sparsity import transpose
from pdpetsc.kernels.tangent import outer_times_kernel
from pdpetsc.problem.body import Body
from pdpetsc.problem.state import State
from pdpetsc.problem.term import Entries


class FallingBonds:
    """``v (x) m`` of bonds whose integrity falls: force of the intact bond times the gradient of the integrity.

    Parameters
    ----------
    body : Body
        Whose bonds they are.
    bonds : (n,) int64
        Their numbers, ascending.
    v : (n, dim) float64
        Force of the intact bond on its second end [force].
    m : (n, dim) float64
        Derivative of the integrity by the displacement of the second end [1 / length].
    """

    def __init__(self, body: Body, bonds: GlobalIndex, v: Float, m: Float) -> None:
        self._body = body
        self._bonds, self._v, self._m = bonds, np.asarray(v), np.asarray(m)
        self._neighbours = body.families.neighbours[bonds]
        self._ptr = np.searchsorted(bonds, body.families.indptr)

    def add_product(self, du: Float, f: Float, particles: LocalIndex) -> None:
        """Add the forces of the families of some own particles (not collective)."""
        outer_times_kernel(self._body.dim)(particles, self._ptr, self._neighbours, self._v, self._m, du, f)

    def add_rows(self, entries: Entries) -> None:
        """Add the rows of the matrix (not collective)."""
        families, cloud = self._body.families, self._body.cloud
        ends = np.stack([families.centres[self._bonds], self._neighbours], axis=1).ravel()
        by_particle = transpose(2 * np.arange(len(self._bonds) + 1, dtype=np.int64), ends, cloud.n_local)
        kernel, sparsity = outer_rows_kernel(self._body.dim), entries.sparsity
        for rows, own in entries.row_sets():
            kernel(
                rows.first, rows.diag_ptr, rows.off_ptr, rows.columns, *sparsity.locals_of_columns, *by_particle,
                ends, self._v, self._m, own, entries.off,
            )  # fmt: skip


def gradient_of_integrity(state: State, slope: Float, bonds: GlobalIndex) -> Float:
    """Return ``dT/de n`` (n, dim) [1 / length] of some bonds along their current directions n."""
    body, u_local = state.body, state.u_local
    centres, neighbours = body.families.centres[bonds], body.families.neighbours[bonds]
    y = body.cloud.x[neighbours] + u_local[neighbours] - body.cloud.x[centres] - u_local[centres]
    return np.asarray(slope[bonds, None] * y / np.linalg.norm(y, axis=1)[:, None])
