"""Hertz's contacts, and pressures on the facets that touch."""

import numpy as np
from scipy.optimize import brentq

import pdpetsc as pd


def line(force, radius, modulus):
    """Return half width and largest pressure of a line contact with a force per length."""
    return np.sqrt(4.0 * force * radius / (np.pi * modulus)), np.sqrt(force * modulus / (np.pi * radius))


def disc(load, radius, modulus):
    """Return the force per length of a disc between planes that approach its centre by ``load`` (Johnson, 5.57)."""

    def approach(force):
        a = line(force, radius, modulus)[0]
        return 2.0 * force / (np.pi * modulus) * (np.log(4.0 * radius / a) - 0.5)

    return brentq(lambda force: approach(force) - load, 1e-3 * load * modulus, load * modulus)


def point(force, radius, modulus):
    """Return radius and largest pressure of a point contact."""
    a = (0.75 * force * radius / modulus) ** (1.0 / 3.0)
    return a, 1.5 * force / (np.pi * a**2)


def touching(solution):
    """Return positions, tractions and areas of the facets of all ranks that touch, of the first part of two bodies."""
    (term,) = (one for one in solution.problem.terms if hasattr(one, "of_facets"))
    parts = solution.cloud.comm.allgather(term.of_facets(solution.state))
    return [np.concatenate(arrays) for arrays in zip(*parts, strict=True)]


def pressures(solution):
    """Return distances from the middle, pressures along the last axis and areas of the facets that touch."""
    x, traction, area = touching(solution)
    return np.linalg.norm(x[:, :-1], axis=1), np.abs(traction[:, -1]), area


class Peak(pd.Quantity):
    """Largest pressure, each the mean of the facets of a particle, of the contact with a name."""

    contact = ""

    def __init__(self, contact):
        object.__setattr__(self, "contact", contact)

    def evaluate(self, solution):
        fields = {}
        for term in solution.problem.terms:
            fields |= term.fields()
        along = fields[f"{self.contact}_traction"](solution.state)[:, -1]
        return float(max(solution.cloud.comm.allgather(np.abs(along).max(initial=0.0))))


class HalfWidth(pd.Quantity):
    """Half width or radius of the contact from the mean square distance of its pressure: a^2 / 4 or 2 a^2 / 5.

    The area of the facets that touch would change in steps of their size.
    """

    factor = 4.0

    def __init__(self, factor=4.0):
        object.__setattr__(self, "factor", factor)

    def evaluate(self, solution):
        r, p, area = pressures(solution)
        return float(np.sqrt(self.factor * (p * r**2) @ area / (p @ area))) if p @ area > 0.0 else 0.0


class PressureAt(pd.Quantity):
    """Pressure at a distance from the middle of a line contact."""

    at = 0.0

    def __init__(self, at):
        object.__setattr__(self, "at", at)

    def evaluate(self, solution):
        r, p, _ = pressures(solution)
        order = np.argsort(r)
        return float(np.interp(self.at, r[order], p[order], right=0.0)) if len(r) else 0.0


class LineError(pd.Quantity):
    """Root mean square of the difference from Hertz's pressure over its largest; a part of ``share`` is computed."""

    radius, modulus, share = 1.0, 1.0, 0.5

    def __init__(self, radius, modulus, share=0.5):
        for name, value in (("radius", radius), ("modulus", modulus), ("share", share)):
            object.__setattr__(self, name, value)

    def closed_form(self, force):
        return line(force, self.radius, self.modulus)

    def evaluate(self, solution):
        r, p, area = pressures(solution)
        if not p @ area > 0.0:
            return 0.0
        a, peak = self.closed_form(float(p @ area) / self.share)
        exact = peak * np.sqrt(np.maximum(1.0 - (r / a) ** 2, 0.0))
        return float(np.sqrt(area @ (p - exact) ** 2 / area.sum()) / peak)


class PointError(LineError):
    """The same of a point contact."""

    def closed_form(self, force):
        return point(force, self.radius, self.modulus)
