"""Clamped strip whose crack has to take the fracture energy that was declared, in any model. Units mm, N.

Length 46, height 20, plane stress, E = 1000 MPa, fracture energy 0.1 N / mm, Poisson's ratio 0.25 (1/3 of bonds), a
crack of length 12 from the left side. Both long sides are held one horizon deep and moved apart, less and less towards
the right, so that the crack grows steadily as they are: at ``x`` by ``1 - x / 60`` of what they are at the left end. By
default bonds have the energy of a plane; of models whose cracks take another one ``share`` is that measured on another
body, under another load: the field of a crack tip in ``surfing.py``.
Results, for the tip between 16 and 26: ``taken_over_Gc``, by how much work less stored energy grows with the length of
the crack; ``taken_over_ends``, the same between the first and the last step at which the tip was ahead of where it had
been; ``J_over_Gc``; ``tip`` at the end.
"""

import numpy as np
from surfing import GC, MODELS, E, laws, parts

import pdpetsc as pd

LENGTH, HEIGHT, CRACK, TAPER = 46.0, 20.0, 12.0, 60.0


def case(n=20, horizon=3.015, steps=90, opening=2.0, law="linear", model="bonds", share=1.0, nu=0.25):
    dx = HEIGHT / n
    delta = horizon * dx
    low, high = pd.region.Slab("y", high=delta), pd.region.Slab("y", low=HEIGHT - delta)
    near = pd.region.Slab("y", low=0.5 * HEIGHT - delta, high=0.5 * HEIGHT + delta)
    far = pd.region.Slab("x", low=LENGTH - delta)
    energy, protected = pd.FractureEnergy(GC, share), ~near | far
    _, material, scheme, control = parts(pd.choose("model", model, {name: name for name in MODELS}), nu, 0.5)
    # Of a strip of this height, clamped and much longer, the energy far ahead of the tip is Gc at this displacement.
    grows = 0.5 * np.sqrt(2.0 * (HEIGHT - 2.0 * delta) * GC / E)
    tip, ahead, room = (CRACK, 0.5 * HEIGHT), (1.0, 0.0), 0.5 * HEIGHT - delta
    follows = pd.CrackTip(ahead, 0.3, near)

    def sides(sign):
        return lambda x, t: sign * opening * grows * t * (1.0 - x[:, 0] / TAPER)

    def results(h):
        at, gone = np.array(h["tip"]), np.array(h["work"]) - np.array(h["stored"])
        runs = (at > 16.0) & (at < 26.0)
        steps_ahead = np.flatnonzero(np.diff(at) > 0.0) + 1
        inner = steps_ahead[runs[steps_ahead]]
        J = np.array(h["J"])[runs]
        return {
            "taken_over_Gc": np.polyfit(at[runs], gone[runs], 1)[0] / GC,
            "taken_over_ends": (gone[inner[-1]] - gone[inner[0]]) / (at[inner[-1]] - at[inner[0]]) / GC,
            "J_over_Gc": J[np.isfinite(J)].mean() / GC,
            "tip": at[-1],
        }

    return pd.Case(
        particles=pd.Lattice((0.0, 0.0), (LENGTH, HEIGHT), dx),
        horizon=delta,
        material=material,
        scheme=scheme,
        control=control,
        weights=None if scheme is None else pd.Standard(),
        cracks=[pd.Segment((-1.0, 0.5 * HEIGHT), tip)],
        damage=pd.choose("law", law, laws(energy, protected)),
        conditions=[pd.Displacement(low, x=0.0, y=sides(-1.0)), pd.Displacement(high, x=0.0, y=sides(1.0))],
        steps=pd.Steps(steps),
        history={
            "J": pd.JIntegral(tip, ahead, 0.6 * room, room, follows),
            "tip": follows,
            "length": pd.CrackLength(),
            "broken": pd.BrokenBonds(),
            "stored": pd.StrainEnergy(),
            "work": pd.ExternalWork(),
        },
        results=results,
        fields=[pd.displacement, pd.local_damage],
        picture=pd.Picture(pd.local_damage, "", 5.0),
    )
