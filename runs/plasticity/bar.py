"""Elastic-plastic bar, strip or block pulled to ten times its yield strain and back by half of that. Units mm, N.

Sub-horizons and linear isotropic hardening. Result: ``force`` at the end, and in 1D ``exact``, the closed form of the
uniaxial law. The elastic-plastic example of Yaghoobi and Chorzepa's abstract, whose numbers are not at hand.
"""

import math

import pdpetsc as pd

E = 200e3
YIELD = 400.0
HARDENING = 2e3
LENGTH = 20.0


def exact_force(stretch_to, back_to):
    """Return P of a bar stretched to the first and then the second strain, in logarithmic strain."""
    top = YIELD + E * HARDENING / (E + HARDENING) * (math.log1p(stretch_to) - YIELD / E)
    return (top - E * (math.log1p(stretch_to) - math.log1p(back_to))) / (1.0 + back_to)


def case(dim=1, n=20, horizon=1.015, steps=8, scheme="sub_horizons", control="none"):
    if dim not in (1, 2, 3):
        raise pd.CaseError(f"dim is 1, 2 or 3, not {dim}.")
    dx = LENGTH / n
    high = [LENGTH] + [4.0 * dx] * (dim - 1)
    top, back = 10.0 * YIELD / E, 9.0 * YIELD / E
    # Layers of two horizons follow the uniform strain: a layer of one is loaded by families that are cut.
    layer = 2 * int(horizon) * dx
    end = pd.region.Slab("x", low=LENGTH - layer)

    def pull(x, t):
        strain = 2.0 * t * top if t <= 0.5 else top + (2.0 * t - 1.0) * (back - top)
        return strain * x[:, 0]

    held = [pd.Displacement(pd.region.Slab("x", high=layer) | end, x=pull)]
    for axis in "yz"[: dim - 1]:
        held.append(pd.Displacement(pd.region.Slab(axis, high=dx), **{axis: 0.0}))
    return pd.Case(
        particles=pd.Lattice([0.0] * dim, high, dx),
        horizon=horizon * dx,
        material=pd.J2(E=E, nu=0.3, yield_stress=YIELD, hardening=HARDENING),
        scheme=pd.choose("scheme", scheme, pd.SCHEMES),
        stabilisation=pd.choose("control", control, pd.CONTROLS),
        conditions=held,
        steps=pd.Steps(steps),
        history={"force": pd.Reaction("x", end), "plastic": pd.Mean(pd.plastic_strain)},
        results=lambda h: {"force": h["force"][-1], "exact": exact_force(top, back)},
        fields=[pd.displacement, pd.stress, pd.plastic_strain],
        picture=pd.Picture(pd.plastic_strain, ""),
    )
