"""Cracks that temperature opens or slides: a cold edge in a held strip, and heat that flows round a crack.

``kind=strip``: a strip of width 1 and length 4 between rigid ends which let it contract, in plane strain (E = 1000,
nu = 0.3, alpha = 1e-3), ``T`` from -1 at the edge with the crack to 1 at the other; the crack goes halfway through.
Half of it, above the mirror plane on which the crack lies. Results: ``K1_over`` and ``J_over``, ``K / (E alpha /
(1 - nu) sqrt(pi a))``, the second one from ``sqrt(J E / (1 - nu^2))``, and ``J_far_over`` of a larger disc. Published
are 0.5036 (Wilson and Yu) and 0.4857 (Shih, Moran and Nakamura); finite elements (``thermal_crack_elements.py``) give
0.4967.

``kind=flow``: a crack of length 1.2 that lets no heat through, in an infinite plate in plane ``plane`` with a uniform
heat flow across it; steady heat conduction in a square of side 3 about it, with temperature and displacement of the
infinite plate in the outer layers. Results: ``K2_over_exact``, ``J_over_exact``, ``J_far_over_exact`` of ``K_II = E'
alpha g a sqrt(pi a) / 4`` (Sih 1962; alpha times 1 + nu in plane strain), ``temperature_error`` over ``g a``.

With ``damage=point`` gradient points of the strip fail (``pd.PointDamage``, linear softening, fracture energy
1.117e-3, with a strain without stress of ``ratio`` times that at the onset), with correspondence and ``Silling(G)``,
2.0 where G is 0. The crack has the length ``a``, at least 0.3, and the temperatures rise to ``top`` times those above,
in ``steps`` steps. The crack grows stably, because its tip comes to where the strip is pressed. Results: ``length`` at
the end, ``a`` and the dissipated energy over Gc, ``elements``, the length at which finite elements have ``K_I = sqrt(E
Gc / (1 - nu^2))`` there, ``length_error``, the largest difference of both over the width from amplitude 1.1 on (before,
K hardly depends on the length), and ``tip``, where points have failed.
"""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import point_damage

import pdpetsc as pd

E, NU, ALPHA = 1000.0, 0.3, 1e-3
# A crack of length 0.3 begins to grow at the temperatures of amplitude 1.
GC = 1.117e-3
HALF, SIDE, GRADIENT = 0.6, 1.5, 3.0


def round_crack(x, plane):
    """Return temperature (n,) and displacement (n, 2) at positions (n, 2) in the infinite plate, and ``K_II``.

    ``T = g Im s`` with ``s = sqrt(z^2 - a^2)``: what expands freely, ``-i alpha g int s dz``, goes round the crack with
    a jump, which a crack whose faces slide takes up: ``sigma_yy - i sigma_xy = Phi(z) + Phi(conj z) + ...``, ``Phi = -i
    c / s``.
    """
    z = x[:, 0] + 1j * x[:, 1]
    s = np.sqrt(z - HALF) * np.sqrt(z + HALF)
    strain = plane == "strain"
    modulus, alpha = (E / (1.0 - NU**2), ALPHA * (1.0 + NU)) if strain else (E, ALPHA)
    mu, c = 0.5 * E / (1.0 + NU), 0.125 * modulus * HALF**2 * GRADIENT * alpha
    w = (
        -0.5j * GRADIENT * alpha * z * s
        + 1j * c / mu * np.log(np.abs(z + s))
        - 1j * x[:, 1] / mu * np.conj(-1j * c / s)
    )
    K = 0.25 * modulus * alpha * GRADIENT * HALF * np.sqrt(np.pi * HALF)
    return GRADIENT * s.imag, np.stack([w.real, w.imag], axis=1), K


@dataclass(frozen=True)
class Departs(pd.Quantity):
    """Largest error of the temperature over ``g a`` [-]."""

    plane: str

    def evaluate(self, solution):
        off = pd.temperature(solution) - solution.t * round_crack(solution.x, self.plane)[0]
        return solution.largest(float(np.abs(off).max(initial=0.0))) / (GRADIENT * HALF)


def case(
    kind="strip", n=40, horizon=2.015, plane="strain", scheme="sub_horizons", G=0.0, damage="none", a=0.3, ratio=2.0,
    top=2.0, steps=20,
):  # fmt: skip
    """Return the case: ``n`` particles along the crack, or along half of the width."""
    pd.choose("kind", kind, {"strip": None, "flow": None})
    if pd.choose("damage", damage, {"none": False, "point": True}):
        pd.choose("kind of damage=point", kind, {"strip": None})
        return growing(n, horizon, G or 2.0, a, ratio, top, steps)
    chosen = pd.choose("scheme", scheme, pd.SCHEMES)
    model = {"scheme": chosen, "control": pd.Silling(G) if G else None}
    return strip(n, horizon, model) if kind == "strip" else flow(n, horizon, plane, model)


def strip(n, horizon, model):
    """Return the strip with a cold edge."""
    dx = 0.5 / n
    tip, ahead = (0.5, 0.0), (1.0, 0.0)
    near, far = (0.15, 0.3), (0.25, 0.45)
    unit = E * ALPHA / (1.0 - NU) * np.sqrt(0.5 * np.pi)

    def results(h):
        of_J = np.sqrt(np.array([h["J"][-1], h["J far"][-1]]) * E / (1.0 - NU**2)) / unit
        return {"K1_over": h["K1"][-1] / unit, "J_over": of_J[0], "J_far_over": of_J[1]}

    return pd.Case(
        particles=pd.Lattice((0.0, 0.0), (1.0, 2.0), dx),
        symmetry=[pd.Symmetry("y")],
        horizon=horizon * dx,
        material=pd.Thermal(pd.LinearElastic(E, NU, "strain"), ALPHA),
        **model,
        cracks=[pd.Segment((-1.0, 0.0), tip)],
        conditions=[
            pd.Displacement(pd.region.Slab("y", low=2.0 - dx), y=0.0),
            pd.Displacement(pd.region.Nearest((1.0, 0.5 * dx)), x=0.0),
            pd.Temperature(pd.region.All(), lambda x, t: t * (2.0 * x[:, 0] - 1.0)),
        ],
        history={
            "J": pd.JIntegral(tip, ahead, *near),
            "J far": pd.JIntegral(tip, ahead, *far),
            "K1": pd.StressIntensity(tip, ahead, *far),
        },
        results=results,
        fields=[pd.displacement, pd.stress, pd.temperature],
        picture=pd.Picture(pd.stress, "yy", 200.0),
    )


def length_at(amplitude):
    """Return the length at which finite elements have the critical stress intensity at amplitudes of temperature."""
    rows = json.loads(Path(__file__).with_name("thermal_crack_elements.json").read_text())["K1_by_length"]
    length, K = np.array([[float(length), K] for length, K in rows.items()]).T
    growing = slice(int(np.argmax(K)), None)
    unit = E * ALPHA / (1.0 - NU) * np.sqrt(0.5 * np.pi)
    critical = np.sqrt(E * GC / (1.0 - NU**2)) / unit / np.asarray(amplitude)
    return np.interp(critical, K[growing][::-1], length[growing][::-1])


def growing(n, horizon, G, a, ratio, top, steps):
    """Return the strip with a cold edge whose crack grows."""
    dx = 0.5 / n
    delta = horizon * dx
    law = pd.LinearElastic(E, NU, "strain")
    held = pd.region.Slab("y", low=2.0 - 3.0 * delta)
    damage = point_damage.damage_of_ratio("linear", law, GC, ratio, delta, dx, protected=held)

    def results(h):
        amplitude = top * np.array(h["t"])
        length, begun = a + 2.0 * np.array(h["dissipated"]) / GC, amplitude > 1.1 - 1e-9
        exact = np.maximum(length_at(np.maximum(amplitude, 1.0)), a)
        return {
            "length": length[-1],
            "elements": exact[-1],
            "length_error": float(np.abs(length - exact)[begun].max()),
            "tip": h["tip"][-1],
        }

    return pd.Case(
        particles=pd.Lattice((0.0, 0.0), (1.0, 2.0), dx),
        symmetry=[pd.Symmetry("y")],
        horizon=delta,
        **point_damage.body(pd.Thermal(law, ALPHA), damage, G),
        cracks=[pd.Segment((-1.0, 0.0), (a, 0.0))],
        conditions=[
            pd.Displacement(pd.region.Slab("y", low=2.0 - dx), y=0.0),
            pd.Displacement(pd.region.Nearest((1.0, 0.5 * dx)), x=0.0),
            pd.Temperature(pd.region.All(), lambda x, t: top * t * (2.0 * x[:, 0] - 1.0)),
        ],
        steps=pd.Steps(steps),
        history={"tip": pd.CrackTip((1.0, 0.0), damage=0.9), **point_damage.energies()},
        results=results,
        fields=[pd.displacement, pd.local_damage, pd.temperature],
        picture=pd.Picture(pd.local_damage, "", 100.0),
    )


def flow(n, horizon, plane, model):
    """Return the square with a crack that heat flows round."""
    dx = 2.0 * HALF / n
    count = round(SIDE / dx)
    side, tip, ahead = count * dx, (HALF, 0.0), (1.0, 0.0)
    near, far = (0.2, 0.5), (0.3, 0.7)
    modulus = E / (1.0 - NU**2) if plane == "strain" else E
    inner = side - 2.0 * horizon * dx
    rim = ~pd.region.Box((-inner, -inner), (inner, inner))
    K = round_crack(np.ones((1, 2)), plane)[2]

    def results(h):
        return {
            "K2_over_exact": h["K2"][-1] / K,
            "J_over_exact": h["J"][-1] * modulus / K**2,
            "J_far_over_exact": h["J far"][-1] * modulus / K**2,
            "temperature_error": h["error"][-1],
        }

    def displaced(axis):
        return lambda x, t: t * round_crack(x, plane)[1][:, axis]

    return pd.Case(
        particles=pd.Lattice((-side, -side), (side, side), dx),
        horizon=horizon * dx,
        material=pd.Thermal(pd.LinearElastic(E, NU, plane), ALPHA, conductivity=1.0),
        **model,
        heat=pd.HeatConduction(),
        cracks=[pd.Segment((-HALF, 0.0), tip)],
        conditions=[
            pd.Displacement(rim, x=displaced(0), y=displaced(1)),
            pd.Temperature(rim, lambda x, t: t * round_crack(x, plane)[0]),
        ],
        history={
            "J": pd.JIntegral(tip, ahead, *near),
            "J far": pd.JIntegral(tip, ahead, *far),
            "K2": pd.StressIntensity(tip, ahead, *far, mode="II"),
            "error": Departs(plane),
        },
        results=results,
        fields=[pd.displacement, pd.temperature, pd.heat_flux],
        picture=pd.Picture(pd.temperature, "", 100.0),
    )
