"""Material histories that persist while the gradient points of a particle change with its bonds."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex
from pdpetsc.errors import CaseError
from pdpetsc.gradient.base import GradientOperator
from pdpetsc.material.at_points import MaterialAtPoints
from pdpetsc.problem.term import KeptArray


class KeptHistory:
    """Store material histories in fixed rows, while bonds break and points appear and disappear.

    A particle has a row for each of its points, or for each part of its family (``Parts``). A part without a point
    shares the history of the point that took over its bonds. It continues from there if it gets a point again. The rows
    contain committed values only: mending bonds restores them.

    Parameters
    ----------
    operator : GradientOperator
        Gradient of the intact body.
    materials : sequence of MaterialAtPoints
        Undeformed materials at its points.
    material_of : (n_owned,) int
        Index into ``materials`` of each own particle.
    x : (n_local, dim) float64
        Positions [length].
    """

    def __init__(
        self, operator: GradientOperator, materials: Sequence[MaterialAtPoints], material_of: LocalIndex, x: Float
    ) -> None:
        parts = operator.parts
        self._n_parts = 0 if parts is None else parts.served_by.shape[1]
        whole = operator.owner if parts is None else np.repeat(np.arange(len(parts.served_by)), self._n_parts)
        self._owner: LocalIndex = whole.astype(np.int32)
        # Index of each row among those of its material.
        self._place = np.empty(len(whole), dtype=np.int64)
        self._rows: list[GlobalIndex] = []
        self._values: list[Float] = []
        for number, one in enumerate(materials):
            rows = np.flatnonzero(material_of[whole] == number)
            self._place[rows] = np.arange(len(rows))
            self._rows.append(rows)
            at = x[whole[rows]] if one.has_history else x[:0]
            self._values.append(one.undeformed(at))

    def give(self, operator: GradientOperator, materials: Sequence[MaterialAtPoints]) -> None:
        """Write the histories to the points of an operator.

        Raises
        ------
        CaseError
            The scheme has other points after bonds have broken, and does not define their parts.
        """
        if operator.parts is None:
            if not np.array_equal(operator.owner, self._owner):
                raise CaseError(
                    "The scheme has other gradient points once bonds have broken, and does not say whose history they "
                    "go on with; give its operator parts, or take an elastic material."
                )
            row = np.arange(operator.n_points)
        else:
            row = operator.owner.astype(np.int64) * self._n_parts + operator.parts.of_point
        for one, values in zip(materials, self._values, strict=True):
            if one.has_history:
                one.history[...] = values[self._place[row[one.points]]]

    def take(self, operator: GradientOperator, materials: Sequence[MaterialAtPoints]) -> None:
        """Store the histories of the points of an operator."""
        parts = operator.parts
        point = np.arange(operator.n_points) if parts is None else parts.served_by.ravel()
        place = np.empty(operator.n_points, dtype=np.int64)
        for one, rows, values in zip(materials, self._rows, self._values, strict=True):
            if one.has_history:
                place[one.points] = np.arange(len(one.points))
                values[...] = one.history[place[point[rows]]]

    def arrays(self, materials: Sequence[MaterialAtPoints]) -> dict[str, KeptArray]:
        """Return the rows of the materials with history, by the number of the material."""
        return {
            f"history_{number}": KeptArray(self._owner[rows], values)
            for number, (one, rows, values) in enumerate(zip(materials, self._rows, self._values, strict=True))
            if one.has_history
        }
