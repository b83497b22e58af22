"""Timoshenko's strip with immovable ends: cylindrical bending with the membrane force that stretching raises.

With S the membrane force, D = E t^3 / 12 (1 - nu^2) and v^2 = S L^2 / 4 D, the deflection under a pressure q is

    clamped:  w = q L^4 / (16 v^3 D tanh v) (cosh(v (1 - 2 x / L)) / cosh v - 1) + q L^2 (L - x) x / (8 v^2 D)
    hinged:   w = q L^4 / (16 v^4 D) (cosh(v (1 - 2 x / L)) / cosh v - 1) + q L^2 (L - x) x / (8 v^2 D)

and S L (1 - nu^2) / E t = 1/2 int w'^2 dx fixes v (Timoshenko and Woinowsky-Krieger, Theory of Plates and Shells,
articles 2 and 3).
"""

import math

import numpy as np
from scipy.optimize import brentq

POINTS = 2001


def deflection(support, pressure, length, thickness, E, nu):
    """Return the midpoint deflection over the thickness; ``support`` is "clamped" or "hinged"."""
    D = E * thickness**3 / (12.0 * (1.0 - nu**2))
    x = np.linspace(0.0, length, POINTS)
    inner = 1.0 - 2.0 * x / length

    def bending(v):
        """Return the factor of ``cosh(v inner) / cosh v - 1`` in w."""
        return pressure * length**4 / (16.0 * v**3 * D) * (1.0 / math.tanh(v) if support == "clamped" else 1.0 / v)

    def excess(v):
        slope = -2.0 * v / length * bending(v) * np.sinh(v * inner) / math.cosh(v)
        slope += pressure * length**2 / (8.0 * v**2 * D) * (length - 2.0 * x)
        force = 4.0 * v**2 * D / length**2
        weights = np.full(POINTS, 2.0)
        weights[1::2], weights[0], weights[-1] = 4.0, 1.0, 1.0
        stretch = 0.5 * (weights @ slope**2) * length / (3.0 * (POINTS - 1))
        return force * length * (1.0 - nu**2) / (E * thickness) - stretch

    v = brentq(excess, 0.05, 30.0, xtol=1e-13)
    middle = bending(v) * (1.0 / math.cosh(v) - 1.0) + pressure * length**4 / (32.0 * v**2 * D)
    return middle / thickness
