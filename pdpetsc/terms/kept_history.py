"""What materials remember where the gradient points of a particle change with the bonds that are left."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex
from pdpetsc.errors import CaseError
from pdpetsc.gradient.base import GradientOperator
from pdpetsc.material.at_points import MaterialAtPoints
from pdpetsc.problem.term import KeptArray


class KeptHistory:
    """Histories of materials in rows that stay where they are while bonds break and points come and go.

    A particle has a row for each of its points, or for each part of its family (``Parts``). A part that has lost its
    point has from then on the history of the point that took its bonds over, and goes on from there should it get one
    again. What is not committed is not in the rows: to mend bonds is to go back.

    Parameters
    ----------
    operator : GradientOperator
        The gradient of the whole body.
    materials : sequence of MaterialAtPoints
        At the points of that, undeformed.
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
        # Place of each row among those of its material.
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
        """Put the histories at the points of an operator.

        Raises
        ------
        CaseError
            The scheme gives particles other points once bonds have broken, and does not say of which part.
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
        """Remember the histories at the points of an operator."""
        parts = operator.parts
        point = np.arange(operator.n_points) if parts is None else parts.served_by.ravel()
        place = np.empty(operator.n_points, dtype=np.int64)
        for one, rows, values in zip(materials, self._rows, self._values, strict=True):
            if one.has_history:
                place[one.points] = np.arange(len(one.points))
                values[...] = one.history[place[point[rows]]]

    def arrays(self, materials: Sequence[MaterialAtPoints]) -> dict[str, KeptArray]:
        """Return the rows of the materials that have a history, by the number of the material."""
        return {
            f"history_{number}": KeptArray(self._owner[rows], values)
            for number, (one, rows, values) in enumerate(zip(materials, self._rows, self._values, strict=True))
            if one.has_history
        }
