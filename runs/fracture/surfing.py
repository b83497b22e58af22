"""Strip along which the field of a crack tip moves, so that its crack runs: J against the energy it takes. Units mm, N.

Length 36, height 20, plane stress, E = 1000 MPa, fracture energy 0.1 N / mm, a crack of length 10 from the left side;
bond-based, or with ``model=`` bonds with a dilatation or deformation gradients, Poisson's ratio 0.25, whose bonds are
given a ``share``: with the one for which ``J_over_Gc`` is 1 a running crack takes the fracture energy. On the rim, one
horizon deep, the displacements of the field with ``K = surplus sqrt(E Gc)`` are prescribed about a tip that moves from
10 to 22, after a tenth of the load in which the field rises. Bonds soften linearly to ``final`` times their critical
stretch; with ``law=brittle`` they snap. J is taken on two contours that follow the tip. Means are over the steps in
which the tip goes from 13 to 20.
Results: ``J_over_Gc``, ``J_far_over_Gc``; ``spread``, the standard deviation of J over its mean;
``dissipated_over_Gc``, what the laws of the bonds dissipate per length of crack; ``J_over_dissipated``; ``length``, of
the crack that has grown; ``lead``, by which the tip of the crack is ahead of that of the field.
"""

import numpy as np

import pdpetsc as pd

LENGTH, HEIGHT = 36.0, 20.0
E, GC = 1000.0, 0.1
# Poisson's ratio, material, scheme and control; bonds in plane stress have one of 1/3.
MODELS = {
    "bonds": (1.0 / 3.0, pd.BondBased(E, plane="stress", calibration="family"), None, None),
    "linear_solid": (0.25, pd.LinearSolid(E, 0.25, plane="stress"), None, None),
    "correspondence": (0.25, pd.LinearElastic(E, 0.25, plane="stress"), pd.Correspondence(), pd.Silling(0.5)),
    "sub_horizons": (0.25, pd.LinearElastic(E, 0.25, plane="stress"), pd.SubHorizons(), None),
    "stress_points": (0.25, pd.LinearElastic(E, 0.25, plane="stress"), pd.StressPoints(), None),
    "bond_associated": (0.25, pd.LinearElastic(E, 0.25, plane="stress"), pd.BondAssociated(), None),
}
START, END, RISE = 10.0, 22.0, 0.1


def field_tip(t):
    """Return where the tip of the field is [mm]."""
    return START + (END - START) * np.maximum(t - RISE, 0.0) / (1.0 - RISE)


def displacement(x, t, surplus, nu):
    """Return the displacements (n, 2) of the field at step time t [mm]."""
    K = surplus * np.sqrt(E * GC) * min(t / RISE, 1.0)
    at = x - np.array([field_tip(t), 0.5 * HEIGHT])
    r, angle = np.hypot(*at.T), np.arctan2(at[:, 1], at[:, 0])
    kappa, mu = (3.0 - nu) / (1.0 + nu), 0.5 * E / (1.0 + nu)
    of_angle = (kappa - np.cos(angle)) * np.array([np.cos(0.5 * angle), np.sin(0.5 * angle)])
    return (0.5 * K / mu * np.sqrt(r / (2.0 * np.pi)) * of_angle).T


def case(n=20, horizon=3.015, steps=40, surplus=1.1, law="linear", final=3.0, model="bonds", share=1.0):
    dx = HEIGHT / n
    delta = horizon * dx
    rim = ~pd.region.Box((delta, delta), (LENGTH - delta, HEIGHT - delta))
    near = pd.region.Slab("y", low=0.5 * HEIGHT - delta, high=0.5 * HEIGHT + delta)
    energy, protected = pd.FractureEnergy(GC, share), rim | ~near
    nu, material, scheme, control = pd.choose("model", model, MODELS)
    laws = {
        "brittle": pd.Brittle(energy, protected=protected),
        "linear": pd.LinearSoftening(energy, final, protected=protected),
    }
    tip, ahead = (START, 0.5 * HEIGHT), (1.0, 0.0)
    follows = pd.CrackTip(ahead, 0.3, near)
    room = 0.5 * HEIGHT - delta

    def prescribed(component):
        return lambda x, t: displacement(x, t, surplus, nu)[:, component]

    def results(h):
        found = {name: np.array(values) for name, values in h.items()}
        runs = (found["tip"] > 13.0) & (found["tip"] < 20.0)
        J, far = found["J"][runs], found["J far"][runs]
        # The length grows by whole spacings: the slope of the line that fits best is not of two of its steps.
        per_length = np.polyfit(found["length"][runs], found["dissipated"][runs], 1)[0]
        return {
            "J_over_Gc": J.mean() / GC,
            "J_far_over_Gc": far.mean() / GC,
            "spread": J.std() / J.mean(),
            "dissipated_over_Gc": per_length / GC,
            "J_over_dissipated": J.mean() / per_length,
            "length": found["length"][-1],
            "lead": float(np.mean((found["tip"] - field_tip(found["t"]))[runs])),
            "broken_bonds": found["broken"][-1],
        }

    return pd.Case(
        particles=pd.Lattice((0.0, 0.0), (LENGTH, HEIGHT), dx),
        horizon=delta,
        material=material,
        scheme=scheme,
        control=control,
        weights=None if scheme is None else pd.Standard(),
        cracks=[pd.Segment((-1.0, 0.5 * HEIGHT), tip)],
        damage=pd.choose("law", law, laws),
        conditions=[pd.Displacement(rim, x=prescribed(0), y=prescribed(1))],
        steps=pd.Steps(steps),
        history={
            "J": pd.JIntegral(tip, ahead, 0.5 * room, 0.9 * room, follows),
            "J far": pd.JIntegral(tip, ahead, 0.7 * room, room, follows),
            "tip": follows,
            "length": pd.CrackLength(),
            "broken": pd.BrokenBonds(),
            "dissipated": pd.DissipatedEnergy(),
            "stored": pd.StrainEnergy(),
            "work": pd.ExternalWork(),
        },
        results=results,
        fields=[pd.displacement, pd.local_damage, pd.von_mises],
        picture=pd.Picture(pd.local_damage, "", 5.0),
    )
