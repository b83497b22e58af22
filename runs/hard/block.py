"""Block stretched or compressed in one direction, made hard on request. Units mm, N.

``shake`` moves inner particles by up to that share of the spacing, ``grading`` is the ratio of the largest to the
smallest spacing along x. Layers of one horizon at both ends follow the stretch along x; all else is free. Results:
``error`` of the mean P_xx in the middle third against the law in plane strain with free sides, and its ``spread``, the
standard deviation over the mean. Hencky's law softens beyond a stretch of e = 2.718: larger ones need neo-Hookean.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

import pdpetsc as pd

E = 1000.0


@dataclass(frozen=True)
class Spread(pd.Quantity):
    """Standard deviation of P_xx over a region, over its mean [-]."""

    region: pd.region.Region

    def evaluate(self, solution):
        mask = solution.select(self.region)
        P = pd.first_piola_stress(solution)[mask, 0, 0]
        first, second, count = solution.sum([P.sum(), (P**2).sum(), len(P)])
        mean = first / count
        return float(np.sqrt(max(second / count - mean**2, 0.0)) / abs(mean)) if mean else 0.0


def uniaxial_stress(material, stretch):
    """Return P_xx of a body with P_yy = 0 in plane strain."""
    kernels, constants, every = material.kernels(2), material.constants(2), np.zeros(1, dtype=np.int64)

    def stress(lateral):
        P = np.empty((1, 2, 2))
        kernels.stress(np.diag([stretch, lateral])[None].copy(), every, constants, P)
        return P[0]

    return stress(brentq(lambda lateral: stress(lateral)[1, 1], 0.05, 5.0, xtol=1e-14))[0, 0]


def axis(count, grading):
    """Return positions and cell sizes of ``count`` cells whose sizes grow by the same factor, with mean 1."""
    sizes = grading ** (np.arange(count) / max(count - 1, 1))
    sizes *= count / sizes.sum()
    return np.cumsum(sizes) - 0.5 * sizes, sizes


def case(
    nx=30, ny=12, horizon=2.015, stretch=1.2, shake=0.0, grading=1.0, nu=0.3, scheme="sub_horizons", control="none",
    law="hencky", steps=4, seed=1,
):  # fmt: skip
    x1, size1 = axis(nx, grading)
    x2, size2 = axis(ny, 1.0)
    x = np.stack([c.ravel() for c in np.meshgrid(x1, x2, indexing="ij")], axis=1)
    volume = np.outer(size1, size2).ravel()
    inner = np.all((x > 1.0) & (x < np.array([nx, ny]) - 1.0), axis=1)
    x[inner] += shake * np.random.default_rng(seed).uniform(-1.0, 1.0, (int(inner.sum()), 2))
    horizon = horizon * max(size1.max(), 1.0)
    region = pd.region
    ends = region.Slab("x", high=horizon) | region.Slab("x", low=nx - horizon)
    middle = region.Slab("x", nx / 3, 2 * nx / 3)
    material = pd.choose("law", law, {"hencky": pd.Hencky, "neo_hookean": pd.NeoHookean})(E=E, nu=nu)
    exact = uniaxial_stress(material, stretch)
    return pd.Case(
        particles=pd.Arrays(x, volume),
        horizon=horizon,
        material=material,
        scheme=pd.choose("scheme", scheme, pd.SCHEMES),
        control=pd.choose("control", control, pd.CONTROLS),
        conditions=[
            pd.Displacement(ends, x=lambda x, t: t * (stretch - 1.0) * (x[:, 0] - nx / 2)),
            pd.Displacement(region.Nearest((0.0, ny / 2)), y=0.0),
            pd.Displacement(region.Nearest((float(nx), ny / 2)), y=0.0),
        ],
        steps=pd.Steps(steps),
        history={"P": pd.Mean(pd.first_piola_stress, "xx", middle), "spread": Spread(middle)},
        results=lambda h: {"error": h["P"][-1] / exact - 1.0, "spread": h["spread"][-1]},
        picture=pd.Picture(pd.stress, "xx"),
    )
