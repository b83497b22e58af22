"""Strip with a crack from its edge, pulled at its ends: stress intensity factors, or until it breaks. Units mm, N.

Width 20, length 60, E = 1000 MPa, a crack of length ``a`` from the left edge; the ends are pulled by uniform forces,
which leave them free to turn.

As it stands the strip is linear elastic in plane stress (nu = 1/3, deformation gradients by ``scheme``, sub-horizons by
default) under 1 MPa, and nothing breaks. Results: ``J_over_exact`` and ``J_far_over_exact``, the J-integral on two
contours over ``K^2 / E``, ``G_over_exact`` by virtual crack extension; ``K1``, ``K2`` [MPa mm^1/2], ``K1_exact``.

With a ``law``, the fracture energy is 0.1 N / mm and bonds snap; the event-driven solver follows the crack of a
bond-based strip. With a ``scheme`` besides, and ``solver=path``, the material has deformation gradients, linear elastic
with a Poisson ratio of 1/3, ``weights`` and Silling's control of strength ``G``.
Results: ``peak_stress``; ``griffith``, the stress ``sqrt(E Gc / (pi a)) / F(a / W)``; ``ratio`` of both;
``straightness``, the largest distance of a broken bond from the line of the crack over the horizon.

With ``damage=point`` gradient points fail (``pd.PointDamage`` by a softening ``curve``, with a strain without stress of
``ratio`` times that at the onset), with correspondence, ``Silling(G)``, 2 unless it is given, and a Poisson ratio of
1/3. The path is followed by the opening of the mouth, in steps of ``step`` to ``end`` [mm]. Results: ``peak_stress``,
``griffith``, ``ratio``; ``cohesive``, the same ratio of a cohesive crack (``cohesive.py``), for a ``cohesive_length``,
``E Gc / strength^2`` over a; ``running``, the mean of the stress over Griffith's for a crack that has grown by the
dissipated energy over Gc, by at least two horizons; ``running_by_opening``, the same for the crack that opens as far
at its mouth (Tada, Paris, Irwin); ``length_at_start``, that crack in the first step over a; ``balance``, work over
stored and dissipated energy.

Exact is ``K = s sqrt(pi a) F(a / W)`` with ``F = 1.122 - 0.231 q + 10.550 q^2 - 21.710 q^3 + 30.382 q^4`` (Tada, Paris,
Irwin).
"""

from dataclasses import dataclass

import cohesive
import numpy as np
import point_damage

import pdpetsc as pd

WIDTH, LENGTH = 20.0, 60.0
E, GC = 1000.0, 0.1
# The whole load is this many times Griffith's; the strip breaks long before.
MOST = 3.0


@dataclass(frozen=True)
class Spread(pd.Quantity):
    """Largest distance from a height of particles with local damage above 0.2 [length]."""

    height: float

    def evaluate(self, solution):
        damaged = pd.local_damage(solution) > 0.2
        return solution.largest(float(np.abs(solution.x[damaged, 1] - self.height).max(initial=0.0)))


def factor(a=8.0):
    """Return the stress intensity factor of a crack of length ``a`` under unit stress."""
    q = a / WIDTH
    F = 1.122 - 0.231 * q + 10.550 * q**2 - 21.710 * q**3 + 30.382 * q**4
    return np.sqrt(np.pi * a) * F


def griffith(a=8.0):
    """Return the stress at which a crack of length ``a`` grows."""
    return np.sqrt(E * GC) / factor(a)


def mouth(a, stress):
    """Return the opening of the mouth of a crack of length ``a`` (Tada, Paris, Irwin) [mm]."""
    c = np.cos(0.5 * np.pi * a / WIDTH)
    return 4.0 * stress * a / E * (1.46 + 3.42 * (1.0 - c)) / c**2


def case(
    n=120, horizon=3.015, a=8.0, solver="events", scheme="", weights="standard", G=None, law="none", damage="bonds",
    curve="linear", ratio=2.0, step=0.01, end=0.3,
):  # fmt: skip
    if pd.choose("damage", damage, {"bonds": False, "point": True}):
        return of_points(n, horizon, a, 2.0 if G is None else G, curve, ratio, step, end)
    G = 0.5 if G is None else G
    if law == "none":
        return measured(n, horizon, a, scheme, weights, G)
    pd.choose("law", law, {"brittle": None})
    return broken(n, horizon, a, solver, scheme, weights, G)


def at_tip(tip, ahead, near, far):
    """Return what is looked at of a crack tip."""
    return {
        "J": pd.JIntegral(tip, ahead, *near),
        "J far": pd.JIntegral(tip, ahead, *far),
        "G": pd.EnergyReleaseRate(tip, ahead, *far),
        "K1": pd.StressIntensity(tip, ahead, *far),
        "K2": pd.StressIntensity(tip, ahead, *far, mode="II"),
    }


def measured(n, horizon, a, scheme, weights, G):
    """Return the strip whose crack is looked at."""
    dx = WIDTH / n
    low, high = pd.region.Slab("y", high=dx), pd.region.Slab("y", low=LENGTH - dx)
    tip, ahead = (a, 0.5 * LENGTH), (1.0, 0.0)
    room = min(a, WIDTH - a)
    near, far = (max(0.3 * room, horizon * dx), 0.6 * room), (max(0.5 * room, horizon * dx), 0.9 * room)
    J = factor(a) ** 2 / E
    chosen = scheme or "sub_horizons"

    def results(h):
        return {
            "J_over_exact": h["J"][-1] / J,
            "J_far_over_exact": h["J far"][-1] / J,
            "G_over_exact": h["G"][-1] / J,
            "K1": h["K1"][-1],
            "K2": h["K2"][-1],
            "K1_exact": factor(a),
        }

    return pd.Case(
        particles=pd.Lattice((0.0, 0.0), (WIDTH, LENGTH), dx),
        horizon=horizon * dx,
        material=pd.LinearElastic(E=E, nu=1.0 / 3.0, plane="stress"),
        scheme=pd.choose("scheme", chosen, pd.SCHEMES),
        weights=pd.choose("weights", weights, pd.WEIGHTS),
        control=pd.Silling(G) if G and scheme else None,
        cracks=[pd.Segment((-1.0, 0.5 * LENGTH), tip)],
        conditions=[
            pd.Displacement(pd.region.Nearest((WIDTH - 0.5 * dx, 0.5 * dx)), x=0.0, y=0.0),
            pd.Displacement(pd.region.Nearest((0.5 * dx, 0.5 * dx)), y=0.0),
            pd.Force(low, y=-WIDTH),
            pd.Force(high, y=WIDTH),
        ],
        history=at_tip(tip, ahead, near, far),
        results=results,
        # The fit of the closed form ends there.
        expect={
            "K1": pd.Expected(factor(a), relative=0.05, source="Tada, Paris, Irwin"),
            "K2": pd.Expected(0.0, absolute=0.01 * factor(a), source="a crack that only opens"),
            "J_over_exact": pd.Expected(1.0, relative=0.05, source="K^2 / E"),
            "G_over_exact": pd.Expected(1.0, relative=0.05, source="K^2 / E"),
        }
        if a <= 0.6 * WIDTH
        else {},
        fields=[pd.displacement, pd.stress, pd.von_mises],
        picture=pd.Picture(pd.von_mises, "", 20.0),
    )


def of_points(n, horizon, a, G, curve, ratio, step, end):
    """Return the strip whose gradient points fail."""
    dx = WIDTH / n
    delta, middle, exact = horizon * dx, 0.5 * LENGTH, griffith(a)
    low, high = pd.region.Slab("y", high=dx), pd.region.Slab("y", low=LENGTH - dx)
    ends = pd.region.Slab("y", high=3.0 * delta) | pd.region.Slab("y", low=LENGTH - 3.0 * delta)
    below = pd.region.Box((0.0, middle - dx), (1.01 * dx, middle))
    above = pd.region.Box((0.0, middle), (1.01 * dx, middle + dx))
    material = pd.LinearElastic(E, 1.0 / 3.0, plane="stress")
    damage = point_damage.damage_of_ratio(curve, material, GC, ratio, delta, dx, protected=ends)

    def results(h):
        peak = max(h["t"]) * exact
        stress, length = exact * np.array(h["t"][1:]), a + np.array(h["dissipated"][1:]) / GC
        lengths = np.linspace(0.5 * a, 0.7 * WIDTH, 1000)
        open_as_far = np.interp(np.array(h["opening"][1:]) / stress, mouth(lengths, 1.0), lengths)
        grown = (length > a + 2.0 * delta) & (length < 0.6 * WIDTH)
        cohesive_length, known = E * GC / damage.strength**2 / a, a <= 0.5 * WIDTH
        running = {}
        if grown.any():
            running["running"] = float((stress[grown] / griffith(length[grown])).mean())
            running["running_by_opening"] = float((stress[grown] / griffith(open_as_far[grown])).mean())
        return {
            "peak_stress": peak,
            "griffith": exact,
            "ratio": peak / exact,
            **({"cohesive": cohesive.over_griffith(cohesive.edge(WIDTH), a, a * cohesive_length)} if known else {}),
            **running,
            "length_at_start": open_as_far[0] / a,
            "cohesive_length": cohesive_length,
            "balance": h["work"][-1] / (h["stored"][-1] + h["control"][-1] + h["dissipated"][-1]),
        }

    return pd.Case(
        particles=pd.Lattice((0.0, 0.0), (WIDTH, LENGTH), dx),
        horizon=delta,
        **point_damage.body(material, damage, G),
        cracks=[pd.Segment((-1.0, middle), (a, middle))],
        conditions=[
            pd.Displacement(pd.region.Nearest((WIDTH - 0.5 * dx, 0.5 * dx)), x=0.0, y=0.0),
            pd.Displacement(pd.region.Nearest((0.5 * dx, 0.5 * dx)), y=0.0),
            pd.Force(low, y=-exact * WIDTH),
            pd.Force(high, y=exact * WIDTH),
        ],
        solver=pd.PathFollowing(pd.Opening("y", above, against=below, step=step, end=end)),
        history={"opening": pd.CrackOpening((0.0, middle), (a, middle), at=0.0), **point_damage.energies()},
        results=results,
        fields=[pd.displacement, pd.local_damage],
        picture=pd.Picture(pd.local_damage, "", 5.0),
    )


def broken(n, horizon, a, solver, scheme, weights, G):
    """Return the strip that breaks."""
    dx = WIDTH / n
    low, high = pd.region.Slab("y", high=dx), pd.region.Slab("y", low=LENGTH - dx)
    ends = pd.region.Slab("y", high=3.0 * horizon * dx) | pd.region.Slab("y", low=LENGTH - 3.0 * horizon * dx)
    exact = griffith(a)
    corner = pd.region.Nearest((0.5 * dx, 0.5 * LENGTH - 0.5 * dx))
    far = pd.region.Nearest((WIDTH - 0.5 * dx, 0.5 * LENGTH - 0.5 * dx))

    def results(h):
        peak = max(h["t"]) * MOST * exact
        return {
            "peak_stress": peak,
            "griffith": exact,
            "ratio": peak / exact,
            "broken_bonds": h["broken"][-1],
            "straightness": h["spread"][-1] / (horizon * dx),
        }

    force = MOST * exact * WIDTH
    model, paths = {"material": pd.BondBased(E=E, plane="stress", calibration="family")}, {}
    if scheme:
        model = {
            "material": pd.LinearElastic(E=E, nu=1.0 / 3.0, plane="stress"),
            "scheme": pd.choose("scheme", scheme, pd.SCHEMES),
            "weights": pd.choose("weights", weights, pd.WEIGHTS),
            "control": pd.Silling(G) if G else None,
        }
        # The last bonds hold a piece that turns about them: nothing is left to follow there.
        paths = {"path": pd.PathFollowing(until=0.1)}
    return pd.Case(
        particles=pd.Lattice((0.0, 0.0), (WIDTH, LENGTH), dx),
        horizon=horizon * dx,
        **model,
        cracks=[pd.Segment((-1.0, 0.5 * LENGTH), (a, 0.5 * LENGTH))],
        damage=pd.Brittle(pd.FractureEnergy(GC, share=1.0), protected=ends),
        conditions=[
            pd.Displacement(far, x=0.0, y=0.0),
            pd.Displacement(corner, y=0.0),
            pd.Force(low, y=-force),
            pd.Force(high, y=force),
        ],
        solver=pd.choose("solver", solver, {**pd.SOLVERS, **paths}),
        history={
            "opening": pd.Mean(pd.displacement, "y", high),
            "broken": pd.BrokenBonds(),
            "tip": pd.CrackTip((1.0, 0.0)),
            "spread": Spread(0.5 * LENGTH),
            "work": pd.ExternalWork(),
            "stored": pd.StrainEnergy(),
            "dissipated": pd.DissipatedEnergy(),
        },
        results=results,
        fields=[pd.displacement, pd.local_damage],
        picture=pd.Picture(pd.local_damage, "", 5.0),
    )
