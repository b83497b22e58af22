"""What the plates share: values along a line against finite elements with nodes at the particles."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

import pdpetsc as pd

REFERENCE = Path(__file__).with_name("finite_elements.json")
# Values below this share of the largest have no relative error.
SMALL = 1e-3
# Particles at each end of the line that do not count: corners are singular.
ENDS = 3


@lru_cache
def references():
    """Return what finite_elements.py stored."""
    return json.loads(REFERENCE.read_text())


@dataclass(frozen=True)
class Line:
    """Particles on a line and what finite elements give there.

    Parameters
    ----------
    name : str
        Key of the reference.
    axis : int
        Direction of the line.
    at : mapping of int to float
        Where it is in the other directions [length].
    spacing : float
        Of the particles [length].
    low : float
        Where it starts [length].
    """

    name: str
    axis: int
    at: dict
    spacing: float
    low: float = -np.inf

    def values(self, solution, field):
        """Return coordinates and values of ``field(solution)`` in order along the line, on every rank."""
        x = solution.x
        on_line = x[:, self.axis] > self.low
        for axis, place in self.at.items():
            on_line &= np.abs(x[:, axis] - place) < 0.1 * self.spacing
        parts = solution.model.cloud.comm.allgather((x[on_line, self.axis], field(solution)[on_line]))
        s, v = (np.concatenate(column) for column in zip(*parts, strict=True))
        order = np.argsort(s)
        return s[order], v[order]

    def reference(self, quantity, s):
        """Return the finite element values at coordinates ``s``."""
        stored = references()[self.name]
        return np.interp(s, stored["s"], stored[quantity])


@dataclass(frozen=True)
class AlongLine(pd.Quantity):
    """A number that follows from a field along a line and from what finite elements give there."""

    line: Line
    quantity: str
    field: Callable

    def error(self, solution):
        """Return the error along the line and the size of the reference."""
        s, found = self.line.values(solution, self.field)
        exact = solution.t * self.line.reference(self.quantity, s)
        return found - exact, np.abs(exact)


class Amplitude(AlongLine):
    """Mean of ``|a - b| / |b|`` along a line [-] (Luo, Sundararaghavan, Eq. 21-22)."""

    def evaluate(self, solution):
        error, size = self.error(solution)
        counts = size > SMALL * size.max() if size.max() > 0.0 else size < 0.0
        return float((np.abs(error)[counts] / size[counts]).mean()) if counts.any() else 0.0


class Oscillation(AlongLine):
    """Largest second difference of ``a - b`` along a line, away from its ends, over the largest ``|b|`` [-]."""

    def evaluate(self, solution):
        error, size = self.error(solution)
        second = np.diff(error, 2)[ENDS:-ENDS]
        return float(np.abs(second).max() / size.max()) if size.max() > 0.0 else 0.0


class Profile(pd.Quantity):
    """Keeps the values along a line; its own value is their number."""

    def __init__(self, line, field):
        self.line, self.field = line, field
        self.s = self.v = np.zeros(0)

    def evaluate(self, solution):
        self.s, self.v = self.line.values(solution, self.field)
        return float(len(self.s))


def displacement_x(solution):
    return solution.u[:, 0]


def displacement_z(solution):
    return solution.u[:, 2]


def stress_xx(solution):
    return pd.stress(solution)[:, 0, 0]


def quantities(line, **fields):
    """Return the history of a case: amplitude and oscillation of each field ``name=function`` along the line."""
    found = {}
    for name, field in fields.items():
        found[f"{name}_amplitude"] = Amplitude(line, name, field)
        found[f"{name}_oscillation"] = Oscillation(line, name, field)
    return found


def last(history):
    return {name: values[-1] for name, values in history.items() if name not in ("step", "t")}


def method(scheme, control):
    """Return what a case passes on for the names of a scheme and a control."""
    return {
        "scheme": pd.choose("scheme", scheme, pd.SCHEMES),
        "stabilisation": pd.choose("control", control, pd.CONTROLS),
    }
