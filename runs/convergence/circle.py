"""Neo-Hookean strip bent to a circle, plane strain, against the flexure of the same law: finite strain.

A strip of length 8 and height 1 takes the shape ``r(y) (sin(k x), cos(k x))``; its ends meet at ``angle`` = 2 pi, with
stretches from 0.6 to 1.4. The reference solves ``d P_r / dy = k P_t``, ``P_r = 0`` at both faces, by collocation. The
ends have its displacements, of the nodes on them or of two columns of cells: under dead tractions in their place the
strip turns over soon after a half circle. ``n`` cells over the height, ``cloud`` and ``shake`` as in ``common.square``.
``error_surface_stress`` is that on the outer face, the top.
"""

from functools import lru_cache

import common
import numpy as np
from inflation import MATERIAL, principal, stretch_of
from scipy.integrate import solve_bvp

import pdpetsc as pd

LENGTH = 8.0


@lru_cache(maxsize=64)
def reference(curvature):
    """Return ``r(y) - 1 / k`` and the radial stress as a function of the height y between 0 and 1."""

    def slopes(y, both):
        place, P = both
        around = 1.0 + curvature * place
        of_radius = stretch_of(P, around)
        return np.stack([of_radius, curvature * principal(of_radius, around)[1]])

    y = np.linspace(0.0, 1.0, 41)
    found = solve_bvp(
        slopes, lambda a, b: np.array([a[1], b[1]]), y, np.stack([y - 0.5, np.zeros_like(y)]), tol=1e-10,
        max_nodes=100_000,
    )  # fmt: skip
    assert found.success, found.message
    return found.sol


def of_angle(angle):
    """Return displacements and Cauchy stresses, functions of places and step time."""

    def parts(x, t):
        curvature = angle * t / LENGTH
        place, P = reference(curvature)(np.clip(x[:, 1], 0.0, 1.0))
        around = 1.0 + curvature * place
        of_radius = stretch_of(P, around)
        turn = curvature * (x[:, 0] - 0.5 * LENGTH)
        e_r, e_t = np.stack([np.sin(turn), np.cos(turn)], axis=1), np.stack([np.cos(turn), -np.sin(turn)], axis=1)
        return curvature, place, of_radius, around, e_r, e_t

    def displacement(x, t):
        if angle * t == 0.0:
            return np.zeros_like(x)
        curvature, place, _, _, e_r, _ = parts(x, t)
        return (place + 1.0 / curvature)[:, None] * e_r - x + [0.5 * LENGTH, 0.5 - 1.0 / curvature]

    def stress(x, t):
        if angle * t == 0.0:
            return np.zeros((len(x), 2, 2))
        _, _, of_radius, around, e_r, e_t = parts(x, t)
        rr, tt = (P / s for P, s in zip(principal(of_radius, around), (around, of_radius), strict=True))
        outer = lambda e: np.einsum("ni,nj->nij", e, e)  # noqa: E731
        return rr[:, None, None] * outer(e_r) + tt[:, None, None] * outer(e_t)

    return displacement, stress


def case(
    n=6, shake=0.0, seed=0, cloud="cells", scheme="correspondence", weights="conforming", horizon=2.015, G=0.5,
    angle=2.0 * np.pi, steps=8,
):  # fmt: skip
    particles = common.square(n, shake, seed, cloud, sides=(LENGTH, 1.0))
    region = pd.region
    displacement, stress = of_angle(angle)
    x, y = (lambda places, t, axis=axis: displacement(places, t)[:, axis] for axis in (0, 1))
    # Nodes on the ends; two columns of cells, which are told apart half a cell behind the second, however shaken.
    depth = 2.0 / n if cloud == "cells" else 1e-9
    ends = region.Slab("x", high=depth) | region.Slab("x", low=LENGTH - depth)
    return pd.Case(
        particles=particles,
        material=MATERIAL,
        conditions=[pd.Displacement(ends, x=x, y=y)],
        steps=pd.Steps(steps),
        **common.common(scheme, weights, horizon, G, 1.0 / n),
        **common.errors(displacement, stress, surface=region.Slab("y", low=1.0 - 1e-9), rigid=False),
    )
