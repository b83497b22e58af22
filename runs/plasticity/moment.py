"""Moment of a wide elastic-plastic beam bent to a curvature and back, from the law of a fibre.

In pure bending at small strain every fibre has the strain ``-kappa y`` along the beam, none across the plane, and no
stress through the height, so the moment is the integral of ``-sigma_xx y`` over the height. What J2 plasticity with
linear hardening gives for such a fibre is integrated here in small steps, apart from anything in ``pdpetsc``.
"""

import numpy as np

# Steps of the curvature from zero to its largest size, and fibres in half the height.
STEPS = 200
FIBRES = 60
# An elastic-plastic fibre is solved to this share of its yield stress.
TOLERANCE = 1e-10


class Fibres:
    """Fibres of a beam in plane strain: stress along it for a strain along it, with history."""

    def __init__(self, E, nu, yield_stress, hardening, count):
        self.mu, self.bulk = E / (2.0 * (1.0 + nu)), E / (3.0 * (1.0 - 2.0 * nu))
        self.yield_stress, self.hardening = yield_stress, hardening
        self.plastic, self.alpha = np.zeros((3, count)), np.zeros(count)
        self.along, self.height = np.zeros(count), np.zeros(count)

    def _respond(self, along, height):
        """Return stress (3, n), plastic strain (3, n) and alpha (n,) at strains along the beam and over its height."""
        strain = np.stack([along, height, np.zeros_like(along)])
        pressure = self.bulk * strain.sum(axis=0)
        deviator = 2.0 * self.mu * (strain - strain.mean(axis=0) - self.plastic)
        q = np.sqrt(1.5 * (deviator**2).sum(axis=0))
        flow = np.maximum(q - self.yield_stress - self.hardening * self.alpha, 0.0) / (3.0 * self.mu + self.hardening)
        direction = 1.5 * deviator / np.maximum(q, np.finfo(float).tiny)
        return (
            pressure + deviator - 2.0 * self.mu * flow * direction,
            self.plastic + flow * direction,
            self.alpha + flow,
        )

    def stress(self, along):
        """Move to strains along the beam and return the stress there: the strain of the height leaves no stress."""
        # The height changes by less than the length where stress across it is nothing and volume is kept at most.
        reach = 2.0 * np.abs(along - self.along) + self.yield_stress / self.mu
        low, high = self.height - reach, self.height + reach
        while np.any(high - low > TOLERANCE * self.yield_stress / self.mu):
            middle = 0.5 * (low + high)
            pressed = self._respond(along, middle)[0][1] < 0.0
            low, high = np.where(pressed, middle, low), np.where(pressed, high, middle)
        self.along, self.height = along, 0.5 * (low + high)
        found, self.plastic, self.alpha = self._respond(along, self.height)
        return found[0]


def moments(curvatures, height, E, nu, yield_stress, hardening):
    """Return the moment over the width [force] at each of the curvatures, which are reached one after the other."""
    nodes, weights = np.polynomial.legendre.leggauss(FIBRES)
    y, w = 0.25 * height * (nodes + 1.0), 0.25 * height * weights
    fibres = Fibres(E, nu, yield_stress, hardening, FIBRES)
    step = max(abs(k) for k in curvatures) / STEPS
    found, now = [], 0.0
    for goal in curvatures:
        for kappa in np.linspace(now, goal, max(2, int(np.ceil(abs(goal - now) / step)) + 1))[1:]:
            stress = fibres.stress(kappa * y)
        now = goal
        found.append(2.0 * float(w @ (stress * y)))
    return found
