"""Double cantilever beam opened at its end: the crack grows stably, against beam theory. Units mm, N.

Two arms of depth ``h`` = 10 over a length of 90, a crack of length 30 between them, bond-based, plane stress,
E = 1000 MPa, fracture energy 0.1 N / mm, followed event by event. Bonds far from the plane of the crack do not fail.
Bonds are given the energy of one plane of them over ``share``.
Beam theory with the turning of the root as a longer crack, ``a' = a + 0.64 h``: opening ``d = 8 P a'^3 / (E h^3)`` and
growth at ``P = sqrt(E Gc h^3 / 12) / a'`` (Williams).
Results, all over beam theory: ``stiffness``, P / d before growth; ``J``, the J-integral of the first step over
``12 P^2 a'^2 / (E h^3)``; ``first_load``, at which the first bond breaks; ``load``, the mean while the tip of the crack
goes from 35 to 60 and the opening, given, would grow: where the path of events turns back a test under given opening
jumps ahead. ``J_over_Gc`` is the mean of J over the same states, about the tip that grows, over the fracture energy.

With ``law=none`` nothing breaks, and the material has deformation gradients by ``scheme``, with a Poisson ratio of 1/3.
Results: ``stiffness``, ``J``, ``J_far`` and ``G``, by virtual crack extension, over beam theory; ``K1_over_J``,
``K_I^2 / E`` over J; ``turn``, the length in arm depths by which the crack of beam theory were longer for the stiffness
to be exact.

With ``damage=point`` gradient points fail (``pd.PointDamage`` by a softening ``curve``), with correspondence and
``Silling(G)``, standard weights and a Poisson ratio of 1/3, in ``steps`` load steps to 0.35 of the opening. The
strength is chosen so that the strain without stress is ``ratio`` times that at the onset of damage. A crack fails the
points within a horizon of its plane, so that the arms lose that part of their depth, which beam theory does not know.
Results: ``stiffness`` and ``J`` of the first step and ``peak_load``, over beam theory; and, while the tip is between 34
and 67, ``load``, the mean over beam theory, ``taken_over_Gc``, work less stored energy per length of the crack over the
fracture energy, and ``J_over_Gc``, the mean of J over it; ``balance``, work over stored and dissipated energy at the
end.
"""

import numpy as np
from point_damage import damage_of_ratio

import pdpetsc as pd

LENGTH, H, E, GC = 90.0, 10.0, 1000.0, 0.1
CRACK = 30.0
ROOT = 0.64


def case(
    n=20, horizon=3.015, opening=6.0, solver="events", law="brittle", scheme="sub_horizons", share=1.0, damage="bonds",
    curve="linear", ratio=5.0, G=2.0, steps=200,
):  # fmt: skip
    if pd.choose("damage", damage, {"bonds": False, "point": True}):
        return of_points(n, horizon, 0.35 * opening, curve, ratio, G, steps)
    dx = H / n
    intact = pd.choose("law", law, {"brittle": False, "none": True})
    delta = horizon * dx
    near = pd.region.Slab("y", low=H - delta, high=H + delta)
    up = pd.region.Box((0.0, 1.5 * H), (dx, 2.0 * H))
    down = pd.region.Box((0.0, 0.0), (dx, 0.5 * H))
    far = pd.region.Nearest((LENGTH, H))
    tip_at, ahead, inner = (CRACK, H), (1.0, 0.0), max(3.0, delta)
    follows = pd.CrackTip(ahead, 0.25)
    if intact:
        opening = 0.01 * opening

    def measured(h):
        load, gap, J = h["load"][-1], 2.0 * h["deflection"][-1], h["J"][-1]
        theory = 12.0 * (load * (CRACK + ROOT * H)) ** 2 / (E * H**3)
        return {
            "stiffness": load / gap / (E * H**3 / (8.0 * (CRACK + ROOT * H) ** 3)),
            "J": J / theory,
            "J_far": h["J far"][-1] / theory,
            "G": h["G"][-1] / theory,
            "K1_over_J": h["K1"][-1] ** 2 / E / J,
            "turn": (np.cbrt(E * H**3 * gap / (8.0 * load)) - CRACK) / H,
        }

    def results(h):
        load, gap = np.array(h["load"]), 2.0 * np.array(h["deflection"])
        tip = np.array(h["tip"])
        grown = tip + ROOT * H
        exact = np.sqrt(E * GC * H**3 / 12.0) / grown
        first = next(i for i, broken in enumerate(h["broken"]) if broken > 0.0)
        theory = E * H**3 / (8.0 * (CRACK + ROOT * H) ** 3)
        release = 12.0 * (load[first] * (CRACK + ROOT * H)) ** 2 / (E * H**3)
        growing = (tip > 35.0) & (tip < 60.0) & (gap >= np.maximum.accumulate(gap))
        return {
            "stiffness": load[first] / gap[first] / theory,
            "first_load": load[first] / (np.sqrt(E * GC * H**3 / 12.0) / (CRACK + ROOT * H)),
            "J": h["J"][first] / release,
            **({"load": float(np.mean((load / exact)[growing]))} if growing.any() else {}),
            **({"J_over_Gc": float(np.mean(np.array(h["J"])[growing])) / GC} if growing.any() else {}),
            "tip": tip[-1],
            "broken_bonds": h["broken"][-1],
        }

    return pd.Case(
        particles=pd.Lattice((0.0, 0.0), (LENGTH, 2.0 * H), dx),
        horizon=delta,
        material=pd.LinearElastic(E, 1.0 / 3.0, plane="stress")
        if intact
        else pd.BondBased(E=E, plane="stress", calibration="family"),
        scheme=pd.choose("scheme", scheme, pd.SCHEMES) if intact else None,
        cracks=[pd.Segment((-1.0, H), (CRACK, H))],
        damage=None if intact else pd.Brittle(pd.FractureEnergy(GC, share), protected=~near),
        conditions=[
            pd.Displacement(far, x=0.0),
            pd.Displacement(up, y=0.5 * opening),
            pd.Displacement(down, y=-0.5 * opening),
        ],
        solver=pd.Newton() if intact else pd.choose("solver", solver, pd.SOLVERS),
        history={
            "load": pd.Reaction("y", up),
            "deflection": pd.Mean(pd.displacement, "y", up),
            **(
                {
                    "J": pd.JIntegral(tip_at, ahead, inner, 7.0),
                    "J far": pd.JIntegral(tip_at, ahead, 5.0, 9.0),
                    "G": pd.EnergyReleaseRate(tip_at, ahead, 5.0, 9.0),
                    "K1": pd.StressIntensity(tip_at, ahead, inner, 7.0),
                }
                if intact
                else {
                    "J": pd.JIntegral(tip_at, ahead, inner, 8.0, follows),
                    "broken": pd.BrokenBonds(),
                    "tip": follows,
                    "dissipated": pd.DissipatedEnergy(),
                    "work": pd.ExternalWork(),
                }
            ),
        },
        results=measured if intact else results,
        expect={
            "stiffness": pd.Expected(1.0, relative=0.05, source="beam theory with arms that turn at their root"),
            "J": pd.Expected(1.0, relative=0.05, source="12 P^2 a'^2 / E h^3 of the same beams"),
            **({"G": pd.Expected(1.0, relative=0.05, source="the same")} if intact else {}),
        },
        fields=[pd.displacement, pd.local_damage],
        picture=pd.Picture(pd.von_mises, "", 50.0) if intact else pd.Picture(pd.local_damage, "", 1.0),
    )


def of_points(n, horizon, opening, curve, ratio, G, steps):
    """Return the beam whose gradient points fail."""
    dx = H / n
    delta = horizon * dx
    near = pd.region.Slab("y", low=H - delta, high=H + delta)
    up = pd.region.Box((0.0, 1.5 * H), (dx, 2.0 * H))
    down = pd.region.Box((0.0, 0.0), (dx, 0.5 * H))
    ahead = (1.0, 0.0)
    follows = pd.CrackTip(ahead, 0.25)
    material = pd.LinearElastic(E, 1.0 / 3.0, plane="stress")
    # Nothing fails in the first tenth.
    times = (0.05, 0.1, *np.linspace(0.1, 1.0, steps + 1)[1:])

    def results(h):
        load, gap, tip, J = (np.array(h[name]) for name in ("load", "deflection", "tip", "J"))
        gap = 2.0 * gap
        gone = np.array(h["work"]) - np.array(h["stored"]) - np.array(h["control"])
        growing = (tip > 34.0) & (tip < 0.75 * LENGTH)
        per_length = np.polyfit(tip[growing], gone[growing], 1)[0]
        exact = np.sqrt(E * GC * H**3 / 12.0) / (tip + ROOT * H)
        release = 12.0 * (load[1] * (CRACK + ROOT * H)) ** 2 / (E * H**3)
        return {
            "stiffness": load[1] / gap[1] / (E * H**3 / (8.0 * (CRACK + ROOT * H) ** 3)),
            "J": J[1] / release,
            "peak_load": load.max() / (np.sqrt(E * GC * H**3 / 12.0) / (CRACK + ROOT * H)),
            "load": float(np.mean((load / exact)[growing])),
            "taken_over_Gc": per_length / GC,
            "J_over_Gc": float(np.nanmean(J[growing])) / GC,
            "balance": h["work"][-1] / (h["stored"][-1] + h["control"][-1] + h["dissipated"][-1]),
            "tip": tip[-1],
        }

    return pd.Case(
        particles=pd.Lattice((0.0, 0.0), (LENGTH, 2.0 * H), dx),
        horizon=delta,
        material=material,
        scheme=pd.Correspondence(),
        weights=pd.Standard(),
        control=pd.Silling(G),
        cracks=[pd.Segment((-1.0, H), (CRACK, H))],
        damage=damage_of_ratio(curve, material, GC, ratio, delta, dx, protected=~near),
        conditions=[
            pd.Displacement(pd.region.Nearest((LENGTH, H)), x=0.0),
            pd.Displacement(up, y=0.5 * opening),
            pd.Displacement(down, y=-0.5 * opening),
        ],
        steps=pd.Steps(times=times),
        history={
            "load": pd.Reaction("y", up),
            "deflection": pd.Mean(pd.displacement, "y", up),
            "J": pd.JIntegral((CRACK, H), ahead, max(3.0, delta), 8.0, follows),
            "tip": follows,
            "dissipated": pd.DissipatedEnergy(),
            "stored": pd.StrainEnergy(),
            "control": pd.ControlEnergy(),
            "work": pd.ExternalWork(),
        },
        results=results,
        fields=[pd.displacement, pd.local_damage],
        picture=pd.Picture(pd.local_damage, "", 1.0),
    )
