"""What the plates share: values along a line against finite elements with nodes at the particles."""

import json
import math
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
    low, high : float
        Between which coordinates it counts [length]; particles at these are left out.
    """

    name: str
    axis: int
    at: dict
    spacing: float
    low: float = -np.inf
    high: float = np.inf

    def values(self, solution, field):
        """Return coordinates and values of ``field(solution)`` in order along the line, on every rank (collective)."""
        x = solution.x
        on_line = (x[:, self.axis] > self.low) & (x[:, self.axis] < self.high)
        for axis, place in self.at.items():
            on_line &= np.abs(x[:, axis] - place) < 0.1 * self.spacing
        parts = solution.cloud.comm.allgather((x[on_line, self.axis], field(solution)[on_line]))
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
    """Mean of ``|a - b| / |b|`` along a line [-] (Luo, Sundararaghavan, Eq. 22); 0 where the line has no particle."""

    def evaluate(self, solution):
        error, size = self.error(solution)
        counts = size > SMALL * size.max(initial=0.0)
        return float((np.abs(error)[counts] / size[counts]).mean()) if counts.any() else 0.0


class Oscillation(AlongLine):
    """Largest second difference of ``a - b`` along a line, away from its ends, over the largest ``|b|`` [-].

    NaN where the line has too few particles.
    """

    def evaluate(self, solution):
        error, size = self.error(solution)
        second = np.abs(np.diff(error, 2)[ENDS:-ENDS])
        if not len(second):
            return math.nan
        return float(second.max() / size.max()) if size.max() > 0.0 else 0.0


class Profile(pd.Quantity):
    """Keeps the values along a line; its own value is their number."""

    def __init__(self, line, field):
        self.line, self.field = line, field
        self.s = self.v = np.zeros(0)

    def evaluate(self, solution):
        self.s, self.v = self.line.values(solution, self.field)
        return float(len(self.s))


class Whole(pd.Quantity):
    """Keeps positions and a field of all particles; its own value is their number."""

    def __init__(self, field):
        self.field = field
        self.x, self.v = np.zeros((0, 1)), np.zeros(0)

    def evaluate(self, solution):
        parts = solution.cloud.comm.allgather((solution.x, self.field(solution)))
        self.x, self.v = (np.concatenate(column) for column in zip(*parts, strict=True))
        return float(len(self.x))


def sawtooth(x, v, spacing):
    """Return the amplitude of what alternates from particle to particle along each direction of a lattice, (n, dim).

    A sixteenth of the fourth difference: of ``(-1)^k a`` it is a, of a smooth field it falls with the fourth power of
    the spacing. NaN where a neighbour is missing.
    """
    dim = x.shape[1]
    cell = np.rint((x - x.min(axis=0)) / spacing).astype(int) + 2
    grid = np.full(cell.max(axis=0) + 3, np.nan)
    grid[tuple(cell.T)] = v
    weights = {-2: 1.0, -1: -4.0, 0: 6.0, 1: -4.0, 2: 1.0}
    return np.column_stack(
        [
            sum(weight / 16.0 * grid[tuple((cell + k * step).T)] for k, weight in weights.items())
            for step in np.eye(dim, dtype=int)
        ]
    )


def displacement_x(solution):
    return solution.u[:, 0]


def displacement_z(solution):
    return solution.u[:, 2]


def stress_xx(solution):
    return pd.stress(solution)[:, 0, 0]


def quantities(line, away, **fields):
    """Return the history of a case: amplitude and oscillation of each field ``name=function`` along the line.

    ``away`` is the part of the line away from corners and supports; its numbers have names that end in ``_away``.
    """
    found = {}
    for name, field in fields.items():
        for part, suffix in ((line, ""), (away, "_away")):
            found[f"{name}_amplitude{suffix}"] = Amplitude(part, name, field)
            found[f"{name}_oscillation{suffix}"] = Oscillation(part, name, field)
    return found


def last(history):
    """Return the last values, without those that a line with too few particles does not have."""
    ends = {name: values[-1] for name, values in history.items() if name not in ("step", "t")}
    return {name: value for name, value in ends.items() if math.isfinite(value)}


def method(scheme, control):
    """Return what a case passes on for the names of a scheme and a control."""
    return {
        "scheme": pd.choose("scheme", scheme, pd.SCHEMES),
        "control": pd.choose("control", control, pd.CONTROLS),
    }
