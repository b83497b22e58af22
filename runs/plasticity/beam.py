"""Elastic-plastic beam bent to five times its yield curvature and back to half of that, plane strain. Units mm, N.

30 x 10 mm; sections at the ends, two horizons deep, turn as those of a circle and are free to change their height. No
part of the beam is homogeneous and every step iterates. Results: ``moment`` at the largest curvature and
``moment_back`` at the end, their errors against the moments of fibres (``moment.py``) over the largest, and the
plastic strain of the outer particles at mid-span.
"""

from dataclasses import dataclass

import moment
import numpy as np

import pdpetsc as pd

HEIGHT = 10.0
LENGTH = 30.0
E, NU, YIELD, HARDENING = 200e3, 0.3, 400.0, 2e3
# The strain of the outer fibre is 1 % at the largest curvature.
LARGEST = 0.02 / HEIGHT
BACK = 0.5 * LARGEST


@dataclass(frozen=True)
class Moment(pd.Quantity):
    """Moment of the support forces along x about the axis of the beam over a region, counted as the curvature is."""

    region: pd.region.Region

    def evaluate(self, solution):
        held = solution.select(self.region)
        force = pd.reaction(solution)[held, 0]
        return float(solution.sum(-(force * solution.x[held, 1]).sum()))


def curvature(t):
    """Return the curvature at a step time: up until t = 1/2, back after it."""
    return LARGEST * 2.0 * t if t <= 0.5 else LARGEST + (BACK - LARGEST) * (2.0 * t - 1.0)


def turned(x, t):
    """Return the displacement along x of a beam that is bent to a circle, its axis keeping its length."""
    kappa = curvature(t)
    return (1.0 / kappa - x[:, 1]) * np.sin(kappa * x[:, 0]) - x[:, 0] if kappa else np.zeros(len(x))


def case(ny=10, horizon=1.015, scheme="sub_horizons", control="none", steps=12):
    if steps % 2:
        raise pd.CaseError(f"steps must be even, so that one ends at the largest curvature, not {steps}.")
    dx = HEIGHT / ny
    half, high = 0.5 * LENGTH, 0.5 * HEIGHT
    layer = 2 * int(horizon) * dx
    right = pd.region.Slab("x", low=half - layer)
    sections = pd.region.Slab("x", high=layer - half) | right

    def results(history):
        exact = moment.moments([LARGEST, BACK], HEIGHT, E, NU, YIELD, HARDENING)
        found = [history["moment"][steps // 2], history["moment"][-1]]
        return {
            "moment": found[0],
            "moment_back": found[1],
            "error": found[0] / exact[0] - 1.0,
            "error_back": (found[1] - exact[1]) / exact[0],
            "plastic_strain": history["plastic"][-1],
        }

    return pd.Case(
        particles=pd.Lattice((-half, -high), (half, high), dx),
        horizon=horizon * dx,
        material=pd.J2(E=E, nu=NU, yield_stress=YIELD, hardening=HARDENING),
        scheme=pd.choose("scheme", scheme, pd.SCHEMES),
        control=pd.choose("control", control, pd.CONTROLS | {"following": pd.TangentScaled(pd.Silling())}),
        conditions=[
            pd.Displacement(sections, x=turned),
            pd.Displacement(pd.region.Nearest((0.3 * dx, 0.3 * dx)), y=0.0),
        ],
        steps=pd.Steps(steps),
        history={"moment": Moment(right), "plastic": pd.At((0.0, high), pd.plastic_strain)},
        results=results,
        fields=[pd.displacement, pd.stress, pd.plastic_strain],
        picture=pd.Picture(pd.plastic_strain, ""),
    )
