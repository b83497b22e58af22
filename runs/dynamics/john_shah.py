"""Concrete beam under impact: crack from the notch or from midspan (John and Shah). Units m, N, kg, s.

A beam of 0.2286 by 0.0762 on supports 0.2032 apart, with a notch of 0.01905 at ``gamma`` times the half span from
midspan, is hit at midspan at 0.06 m/s, reached in 196e-6 s (E = 31.37e9, nu = 0.2, density 2400, Gc = 31.1, plane
strain). In the experiment the beam fails from the notch up to gamma = 0.77, beyond it from midspan (John 1990).

``n`` particles over the height, ``PointDamage`` with correspondence and Silling's control; its ``strength`` is not part
of the problem and decides how easily midspan fails, which has no notch.

Results: ``from_notch``, the height of the crack that has grown from the notch over that of the beam, up to 0.35,
``from_middle``, that of a crack from the lower edge at midspan, up to 0.6, ``fails_at_notch`` 1 or 0, and
``energy_error``.
"""

from dataclasses import dataclass

import numpy as np

import pdpetsc as pd

LENGTH, HEIGHT, SPAN, NOTCH = 0.2286, 0.0762, 0.2032, 0.01905
SPEED, RISE = 0.06, 196e-6
E, NU, DENSITY, GC = 31.37e9, 0.2, 2400.0, 31.1


@dataclass(frozen=True)
class Grown(pd.Quantity):
    """Height of a crack between two places, from the first failed particle above ``base`` up [length]."""

    low: float
    high: float
    base: float

    def evaluate(self, solution):
        x, y = solution.x.T
        failed = (pd.local_damage(solution) > 0.9) & (x > self.low) & (x < self.high)
        begun = solution.largest(float((failed & (y > self.base) & (y < self.base + 0.1 * HEIGHT)).any()))
        # Next to the striker both cracks meet.
        top = solution.largest(float(y[failed & (y < 0.6 * HEIGHT)].max(initial=0.0)))
        return max(top - self.base, 0.0) if begun else 0.0


def case(n=48, gamma=0.6, strength=9e6, horizon=3.015, end=1.5e-3, records=75):
    h = HEIGHT / n
    notch = 0.5 * SPAN * gamma
    # Between two columns of particles.
    notch = (np.floor(notch / h) + 0.5 * (round(LENGTH / h) % 2)) * h

    def pushed(x, t):
        time = t * end
        moved = 0.5 * time**2 / RISE if time < RISE else time - 0.5 * RISE
        return np.full(len(x), -SPEED * moved)

    supports = [pd.region.Sphere((sign * 0.5 * SPAN, 0.0), 1.5 * h) for sign in (-1.0, 1.0)]
    striker = pd.region.Sphere((0.0, HEIGHT), 3.0 * h)

    def results(history):
        at_notch, at_middle = history["notch"][-1] / HEIGHT, history["middle"][-1] / HEIGHT
        return {
            "from_notch": float(at_notch),
            "from_middle": float(at_middle),
            "fails_at_notch": float(at_notch > at_middle),
            "energy_error": float(np.abs(history["energy_error"]).max()),
        }

    return pd.Case(
        particles=pd.Lattice((-0.5 * LENGTH, 0.0), (0.5 * LENGTH, HEIGHT), h),
        horizon=horizon * h,
        cracks=[pd.Segment((notch, -h), (notch, NOTCH))],
        material=pd.LinearElastic(E=E, nu=NU, density=DENSITY),
        scheme=pd.Correspondence(),
        control=pd.Silling(1.0),
        damage=pd.PointDamage(
            pd.softening.Linear(), Gc=GC, strength=strength, protected=pd.region.Sphere((0.0, HEIGHT), 0.1 * HEIGHT)
        ),
        conditions=[*(pd.Displacement(one, y=0.0) for one in supports), pd.Displacement(striker, y=pushed)],
        solver=pd.Explicit(end=end, records=records),
        history={
            "notch": Grown(notch - 0.3 * HEIGHT, notch + 0.3 * HEIGHT, NOTCH),
            "middle": Grown(-0.3 * HEIGHT, 0.3 * HEIGHT, 0.0),
            "force": pd.Reaction("y", striker),
            "energy_error": pd.EnergyError(),
        },
        fields=[pd.displacement, pd.velocity, pd.local_damage],
        picture=pd.Picture(pd.local_damage, ""),
        checkpoints=0,
        results=results,
    )
