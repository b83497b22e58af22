"""A measured curve, and interpolation of the history of a run at its positions."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.bounds import text_in
from pdpetsc.errors import CaseError
from pdpetsc.studies.sets import rows_of

# Tolerance for measured positions beyond the history of a run, over its length [-]: round-off of added steps.
SLACK = 1e-9


@dataclass(frozen=True)
class Curve:
    """A measured curve.

    Attributes
    ----------
    x_name, y_name : str
        The columns of the history of a run to compare with.
    x, y : (m,) float64
        Measured positions and values.
    sigma : (m,) float64 or None
        Standard deviation of each value, if it is known.
    """

    x_name: str
    y_name: str
    x: Float
    y: Float
    sigma: Float | None = None

    def __post_init__(self) -> None:
        given = {"places": self.x, "values": self.y} | ({} if self.sigma is None else {"deviations": self.sigma})
        for name, values in given.items():
            if np.ndim(values) != 1 or len(values) != len(self.x) or not np.all(np.isfinite(values)):
                raise CaseError(f"The measured {name} must be as many finite numbers as there are places.")
        if self.sigma is not None and not np.all(self.sigma > 0.0):
            raise CaseError("Measured standard deviations are positive.")
        if not np.any(self.y):
            raise CaseError("The measured values are all zero: there is nothing to fit to.")

    @property
    def scale(self) -> Float:
        """Return the scale of residuals: the standard deviations, or the largest measured value (m,)."""
        return np.full(len(self.x), np.abs(self.y).max()) if self.sigma is None else self.sigma

    def within(self, low: float, high: float) -> Curve:
        """Return the part between two positions; raise CaseError if it is empty."""
        inside = (self.x >= low) & (self.x <= high)
        if not inside.any():
            raise CaseError(f"No measured place lies between {low:g} and {high:g}.")
        return Curve(
            self.x_name, self.y_name, self.x[inside], self.y[inside],
            None if self.sigma is None else self.sigma[inside],
        )  # fmt: skip


def read_curve(path: Path, columns: tuple[str, str], sigma: str | None = None) -> Curve:
    """Read a measured curve from a CSV with a header.

    Parameters
    ----------
    path : Path
        The file.
    columns : tuple of str
        Names of positions and values in the history of the runs; ``"u:displacement"`` if the file has another name.
    sigma : str, optional
        The column of standard deviations.

    Raises
    ------
    CaseError
        The file or column does not exist, or has other data than numbers.
    """
    text = text_in(path, "measured curve")
    names, there = zip(*((name, other or name) for name, _, other in (c.partition(":") for c in columns)), strict=True)
    header, *rows = rows_of(text) or [[]]
    wanted = [*there, *([sigma] if sigma is not None else [])]
    for name in wanted:
        if header.count(name) != 1:
            have = " ".join(", ".join(header).split())
            raise CaseError(f"{path} must have one column {name!r}; it has {have or 'none'}.")
    at = [header.index(name) for name in wanted]
    found = []
    for number, row in enumerate(rows, 2):
        # For example, a number with a decimal comma is read as two values.
        if any(row[len(header) :]):
            raise CaseError(f"Row {number} of {path} has {len(row)} values, and the header names {len(header)}.")
        try:
            found.append([float(row[k]) for k in at])
        except (ValueError, IndexError):
            raise CaseError(f"Row {number} of {path} must have a number in each of {', '.join(wanted)}.") from None
    if not found:
        raise CaseError(f"{path} holds no measured point.")
    values = np.array(found)
    return Curve(names[0], names[1], values[:, 0], values[:, 1], values[:, 2] if sigma is not None else None)


def read_off(history: Mapping[str, Any], curve: Curve) -> Float:
    """Return the history of a run at the measured positions, interpolated linearly (m,).

    Raises
    ------
    CaseError
        The history does not have the column, is not monotonic in it, or does not include all measured positions.
    """
    for name in (curve.x_name, curve.y_name):
        if name not in history:
            raise CaseError(f"The history of the run has no column {name!r}; it has {', '.join(history)}.")
    x = np.asarray(history[curve.x_name], dtype=float)
    y = np.asarray(history[curve.y_name], dtype=float)
    if len(x) < 2 or not (np.isfinite(x).all() and np.isfinite(y).all()):
        raise CaseError(f"The history of the run has fewer than two finite steps of {curve.x_name} and {curve.y_name}.")
    steps = np.diff(x)
    if not (np.all(steps > 0.0) or np.all(steps < 0.0)):
        back = int(np.argmax(steps * steps[0] <= 0.0)) + 1
        raise CaseError(
            f"{curve.x_name} turns back at step {back} of the run, at {x[back]:g}, so there is no one {curve.y_name} "
            f"at a {curve.x_name}; take another column for the place, such as t."
        )
    low, high = float(x.min()), float(x.max())
    slack = SLACK * (high - low)
    beyond = curve.x[(curve.x < low - slack) | (curve.x > high + slack)]
    if len(beyond):
        raise CaseError(
            f"The run goes from {curve.x_name} = {low:g} to {high:g} and the measured curve to {beyond[0]:g}; "
            f"let the case go on to there, or cut the curve with --range {low:g}:{high:g}."
        )
    order = slice(None) if steps[0] > 0.0 else slice(None, None, -1)
    return np.asarray(np.interp(curve.x, x[order], y[order]))


def scaled_norm(values: Float) -> float:
    """Return the root of the mean square."""
    return math.sqrt(float(np.mean(values**2)))
