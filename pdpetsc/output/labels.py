"""Labels of axes and columns in pictures and tables: names with the units that the case declares."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from pdpetsc.declare.units import Units
from pdpetsc.errors import CaseError

# Fields of principal values, numbered from the largest; they belong to no axes.
PRINCIPAL = ("principal_strains", "principal_stresses")
# Labels of fields that differ from their names.
_WORDS = {"von_mises": "von Mises stress"}


@dataclass(frozen=True)
class Labels:
    """Labels of a run.

    Parameters
    ----------
    units : Units or None
        Units that the case declares.
    history, fields : mapping of str to str
        Dimension of each column and field, as for ``Units.of``.
    """

    units: Units | None = None
    history: Mapping[str, str] = field(default_factory=dict)
    fields: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of(cls, summary: Mapping[str, Any]) -> Labels:
        """Return the labels for a ``summary.json``; they have no units if it has none."""
        given, kinds = summary.get("units"), summary.get("dimensions")
        try:
            units = Units(**given) if isinstance(given, Mapping) and given else None
        except (TypeError, CaseError):
            units = None
        kinds = kinds if isinstance(kinds, Mapping) else {}
        found = [kinds.get(name) for name in ("history", "fields")]
        return cls(units, *(dict(kind) if isinstance(kind, Mapping) else {} for kind in found))

    def column(self, name: str) -> str:
        """Return the axis label of a column of the history."""
        return self._with(name, self.unit_of_column(name)) if name != "t" else "load t"

    def unit_of_column(self, name: str) -> str:
        """Return the unit of a column of the history; empty if it has none."""
        return self._unit(self.history.get(name, ""))

    def field(self, name: str, component: str = "") -> str:
        """Return the label of the colour scale of a field component."""
        words = _WORDS.get(name, name.replace("_", " "))
        if name in PRINCIPAL:
            component = component.translate(str.maketrans("xyz", "123"))
        return self._with(f"{words} {component}".strip(), self._unit(self._kind(name)))

    def unit_of_field(self, name: str) -> str:
        """Return the unit of a field; empty if it has none."""
        return self._unit(self._kind(name))

    def axis(self, letter: str) -> str:
        """Return the label of a coordinate axis."""
        return self._with(letter, self._unit("length"))

    def length(self, value: float) -> str:
        """Return a length with its unit."""
        return f"{value:.4g} {self._unit('length')}".strip()

    def first_of(self, dimension: str) -> str | None:
        """Return the first column with a dimension, or None."""
        return next((name for name, kind in self.history.items() if kind == dimension), None)

    def _kind(self, name: str) -> str:
        # An entry of a tensor has the dimension of the tensor: stress_xx.
        head, _, tail = name.rpartition("_")
        of_entry = len(tail) == 2 and set(tail) <= set("xyz") and name not in self.fields
        return self.fields.get(head if of_entry else name, "")

    def _unit(self, dimension: str) -> str:
        return "" if self.units is None else self.units.of(dimension)

    @staticmethod
    def _with(text: str, unit: str) -> str:
        return f"{text} [{unit}]" if unit else text
