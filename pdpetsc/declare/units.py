"""Names of the units of a case, as labels of pictures and tables."""

from __future__ import annotations

from dataclasses import dataclass

from pdpetsc.declared import Declared
from pdpetsc.errors import CaseError

# SI prefixes by their powers of ten.
_PREFIXES = {"": 0, "k": 3, "M": 6, "G": 9, "T": 12, "c": -2, "m": -3, "u": -6, "\N{MICRO SIGN}": -6, "n": -9, "p": -12}
_WRITTEN = {0: "", 3: "k", 6: "M", 9: "G", 12: "T", -3: "m", -6: "\N{MICRO SIGN}", -9: "n", -12: "p"}
# Quantities by their powers of force and length [-].
_POWERS: dict[str, tuple[float, float]] = {
    "length": (0, 1), "area": (0, 2), "volume": (0, 3), "force": (1, 0), "stress": (1, -2), "energy": (1, 1),
    "energy per area": (1, -1), "stress intensity": (1, -1.5),
}  # fmt: skip


@dataclass(frozen=True)
class Units(Declared):
    """Names of the units of a case, for pictures, tables and the report. Values are not converted.

    Units of stress and energy follow: MPa and mJ from N and mm, Pa and J from N and m, psi and lbf in from lbf and in.

    Parameters
    ----------
    length : str
        Such as ``"mm"``.
    force : str
        Such as ``"N"``.
    temperature : str
        Such as ``"K"``; by default none.

    Raises
    ------
    CaseError
        A name is empty, or more than one word.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> units = pd.Units(length="mm", force="N")
    >>> units.of("stress"), units.of("energy"), units.of("length")
    ('MPa', 'mJ', 'mm')
    """

    length: str
    force: str
    temperature: str = ""

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, text in (("length", self.length), ("force", self.force), ("temperature", self.temperature)):
            good = text.isprintable() and not set(text) & set("[],;\"'") and len(text.split()) == 1
            if not good and (text or name != "temperature"):
                raise CaseError(f'Units takes a word as {name}, as "mm" or "N", not {text!r}.')

    def of(self, dimension: str) -> str:
        """Return the name of the unit of a dimension; empty for a pure number or an unknown dimension.

        Parameters
        ----------
        dimension : str
            ``"length"``, ``"area"``, ``"volume"``, ``"force"``, ``"stress"``, ``"energy"``, ``"energy per area"``,
            ``"energy per volume"``, ``"stress intensity"`` or ``"temperature"``.
        """
        if dimension == "temperature":
            return self.temperature
        if dimension == "energy per volume":
            return f"{self.of('energy')}/{self.length}^3"
        if dimension not in _POWERS:
            return ""
        of_force, of_length = _POWERS[dimension]
        if dimension in ("stress", "energy"):
            known = self._of_si("Pa" if dimension == "stress" else "J", of_length)
            if known:
                return known
            if (self.force, self.length, dimension) == ("lbf", "in", "stress"):
                return "psi"
        if dimension == "stress intensity":
            return f"{self.of('stress')} {self.length}^0.5"
        force = self.force if of_force else ""
        size = f"{abs(of_length):g}"
        length = "" if not of_length else self.length if size == "1" else f"{self.length}^{size}"
        return f"{force}/{length}" if of_length < 0 else f"{force} {length}".strip()

    def _of_si(self, name: str, of_length: float) -> str:
        """Return this SI unit with the prefix that follows from force and length; empty if there is none."""
        force, length = self.force.removesuffix("N"), self.length.removesuffix("m")
        if not (self.force.endswith("N") and self.length.endswith("m")):
            return ""
        if force not in _PREFIXES or length not in _PREFIXES:
            return ""
        power = round(_PREFIXES[force] + of_length * _PREFIXES[length])
        return f"{_WRITTEN[power]}{name}" if power in _WRITTEN else ""
