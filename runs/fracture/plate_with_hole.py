"""Plate with a hole pulled apart: damage starts at the hole, crosses both ligaments and separates it. Units mm, N.

150 x 50 mm, hole of radius 10, E = 210 GPa, nu = 0.33, plane strain; bonds fade between the stretches ``s_min`` and
``s_cr``. Each end is moved by ``pull``. The published scheme is ``effect=present continuous=False``; ``G`` is that of
Silling's control, or with ``unit`` the printed coefficient with that unit of length [mm]. Without ``grips`` bonds near
the ends may fail. ``weights`` are those of the scheme, or conforming.
Results: ``first_damage_load``, ``peak_load``, ``max_damage``, ``broken_bonds``, ``symmetry_error`` (first moments of
the damage about the axes of the plate over its sum, in widths), ``last_load``.
Reference: Hashim et al., section 4.5; the end displacement in the text is a misprint.

With ``damage=point`` gradient points fail (``pd.PointDamage`` by a softening ``curve``) from the strain ``s_min`` in
uniaxial tension on and take ``Gc`` [N / mm], with correspondence and ``Silling(G)``. Results: also ``work`` over ``Gc``
times both ligaments, and ``over_kirsch``, the peak over the load at which the hole's edge begins to fail by Heywood's
stress concentration, ``2 + (1 - d / W)^3`` over the ligaments, which a body that softens must exceed.
"""

from dataclasses import dataclass

import numpy as np
import point_damage

import pdpetsc as pd

LENGTH, WIDTH, RADIUS = 150.0, 50.0, 10.0
E, NU = 210e3, 0.33


@dataclass(frozen=True)
class Asymmetry(pd.Quantity):
    """First moments of the damage about the axes over its sum and the width."""

    def evaluate(self, solution):
        damage = pd.local_damage(solution)
        x = solution.x - [0.5 * LENGTH, 0.5 * WIDTH]
        moments = solution.sum(np.array([damage @ x[:, 0], damage @ x[:, 1], damage.sum()]))
        return float(np.abs(moments[:2]).max() / (max(moments[2], 1e-12) * WIDTH))


def case(
    nx=30, horizon=3.015, s_cr=0.002, s_min=0.0015, pull=0.3, G=0.5, scheme="correspondence", law="smooth", steps=30,
    unit=0.0, effect="largest", continuous=True, grips=True, weights="standard", damage="bonds",
    curve="linear", Gc=20.0,
):  # fmt: skip
    dx = LENGTH / nx
    layer = horizon * dx
    critical = pd.ConstantCritical(s_cr)
    # Two horizons from the ends no bond fails: the grips raise the stress at their corners.
    held = pd.region.Slab("x", high=2.0 * layer) | pd.region.Slab("x", low=LENGTH - 2.0 * layer)
    hole = pd.region.Sphere((0.5 * LENGTH, 0.5 * WIDTH), RADIUS)
    how = {
        "protected": held if grips else None,
        "effect": pd.choose("effect", effect, {"largest": pd.LargestStretch(), "present": pd.PresentStretch()}),
    }
    laws = {
        "none": None,
        "smooth": pd.SmoothDegradation(critical, s_min / s_cr, continuous=continuous, **how),
        "early": pd.SmoothDegradation(critical, 0.4, **how),
        "brittle": pd.Brittle(critical, **how),
        "linear": pd.LinearSoftening(critical, 1.5, **how),
        "exponential": pd.ExponentialSoftening(critical, 5.0, **how),
        "bilinear": pd.BilinearSoftening(critical, **how),
    }
    control = (pd.SillingMicromodulus(G, unit) if unit else pd.Silling(G)) if G else None
    left, right = pd.region.Named("fictitious -x"), pd.region.Named("fictitious +x")
    points = pd.choose("damage", damage, {"bonds": False, "point": True})
    failing = pd.choose("law", law, laws)
    if points:
        shape = pd.choose("curve", curve, point_damage.CURVES)
        failing = pd.PointDamage(shape, Gc=Gc, onset=s_min, protected=held if grips else None)
    ligaments = WIDTH - 2.0 * RADIUS
    # In plane strain a bar of the strain s_min in uniaxial stress carries E s_min / (1 - nu^2) ** 0.5.
    first = E * s_min / np.sqrt(1.0 - NU**2) * ligaments / (2.0 + (ligaments / WIDTH) ** 3)

    def results(h):
        broken = [force for force, lost in zip(h["force"], h["damage"], strict=True) if lost > 0.0]
        return {
            **({"first_damage_load": broken[0]} if broken else {}),
            "peak_load": max(h["force"]),
            "max_damage": h["damage"][-1],
            **({} if points else {"broken_bonds": h["broken"][-1]}),
            **({"work": h["work"][-1] / (Gc * ligaments), "over_kirsch": max(h["force"]) / first} if points else {}),
            "symmetry_error": h["asymmetry"][-1],
            "last_load": h["force"][-1],
        }

    return pd.Case(
        particles=pd.Lattice((0.0, 0.0), (LENGTH, WIDTH), dx, cut=hole, fictitious={"-x": layer, "+x": layer}),
        horizon=layer,
        material=pd.Hencky(E, NU),
        scheme=pd.choose("scheme", scheme, pd.SCHEMES),
        weights=pd.choose("weights", weights, pd.WEIGHTS),
        control=control,
        damage=failing,
        conditions=[pd.Displacement(left, x=-pull, y=0.0), pd.Displacement(right, x=pull, y=0.0)],
        steps=pd.Steps(steps),
        history={
            "force": pd.Reaction("x", right),
            "displacement": pd.Mean(pd.displacement, "x", right),
            "damage": pd.Largest(pd.local_damage),
            **({} if points else {"broken": pd.BrokenBonds()}),
            "asymmetry": Asymmetry(),
            "stored": pd.StrainEnergy(),
            "control": pd.ControlEnergy(),
            "work": pd.ExternalWork(),
            "dissipated": pd.DissipatedEnergy(),
        },
        results=results,
        fields=[pd.displacement, pd.stress, pd.local_damage, pd.lost_bonds],
        picture=pd.Picture(pd.local_damage, "", 20.0),
    )
