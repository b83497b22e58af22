"""Strip with a crack in its middle, pulled at its ends: stress intensity factors, or until it breaks. Units mm, N.

Width 20, length 40, E = 1000 MPa, a crack of length 2 ``a`` across the middle.

As it stands the strip is linear elastic (nu = 0.3, ``plane`` stress or strain, deformation gradients by ``scheme``),
pulled by a uniform stress of 1 MPa, and nothing breaks. Exact is ``K_I = sqrt(pi a) (1 - 0.025 q^2 + 0.06 q^4)
sqrt(sec(pi q / 2))`` with ``q = 2 a / W`` (Tada, Paris, Irwin), and the opening of the middle ``4 a V / E'``. With an
``angle`` the crack is turned by so many degrees out of the plane across the pull, in an infinite plate: a square of
side 4 a, on whose rim the displacements of Westergaard's solution are prescribed. ``K_I = sqrt(pi a) cos^2`` and
``K_II = sqrt(pi a) sin cos`` there. Results: ``J_over_exact`` and ``J_far_over_exact``, the J-integral on two contours
over ``(K_I^2 + K_II^2) / E'``; ``G_over_exact`` by virtual crack extension; ``K1``, ``K2`` [MPa mm^1/2], ``K1_exact``,
``K2_exact``; ``K_error``, the larger difference over the length of both exact ones; ``opening_over_exact``.

With a ``law``, brittle or linear, the strip is bond-based in plane stress, fracture energy 0.1 N / mm; the
event-driven solver finds the peak exactly, ``solver=path`` follows the crack with Newton's method. Bonds snap, or with
``law=linear`` soften to three times their critical stretch. Results: ``peak_stress``; ``griffith``, the stress
``sqrt(E Gc / (pi a sec(pi a / W)))`` at which the crack grows in a strip (Feddersen); ``ratio`` of both;
``broken_bonds``.

With ``damage=point`` the gradient points of the strip fail (``pd.PointDamage`` by a softening ``curve``), with
correspondence and ``Silling(G)``, standard weights, Poisson's ratio 0.3, the same fracture energy, and a strength for
which the strain without stress is ``ratio`` times that at the onset of damage. The path is followed by the opening of
the middle of the crack, in steps of ``step`` to ``end`` [mm]; with ``solver=newton`` the strip is pulled in 20 steps,
and the crack jumps. Results: ``peak_stress``, ``griffith`` and ``ratio`` as above; ``cohesive``, that ratio of a
cohesive crack in an infinite plate (``cohesive.py``); ``running``, the mean of the stress over Griffith's for a crack
that has grown by the dissipated energy over Gc, by at least two horizons at each tip; ``strength`` [MPa];
``cohesive_length``, ``E Gc / strength^2`` over a, for which ``ratio`` tends to 1 as it gets small; ``balance``, work
over what is stored and dissipated at the end. With an ``angle`` the crack is turned by so many degrees; ``griffith`` is
then that of the largest hoop stress, ``K_I cos^3(t / 2) - 3 K_II cos^2(t / 2) sin(t / 2) = sqrt(E Gc)`` with the exact
factors above, without those of the strip, ``turn`` the angle between the crack and the points that have failed beyond
its tip [degrees], and ``turn_exact`` that t (Erdogan and Sih); ``turn_cohesive`` and ``cohesive`` include the stress
along the crack at the distance ``(K_c / strength)^2 / (2 pi)`` of the tip (Smith2001), and the strip by Feddersen's
factor for the projected length.
"""

from dataclasses import dataclass

import cohesive
import numpy as np
import point_damage

import pdpetsc as pd

WIDTH, LENGTH = 20.0, 40.0
E, NU, GC = 1000.0, 0.3, 0.1


def case(
    n=120, horizon=3.015, a=5.0, pull=1.0, calibration="family", law="none", solver="events", scheme="sub_horizons",
    plane="stress", angle=0.0, damage="bonds", curve="linear", ratio=5.0, G=2.0, step=0.003, end=0.08,
):  # fmt: skip
    if pd.choose("damage", damage, {"bonds": False, "point": True}):
        path = pd.choose("solver", solver, {"events": True, "path": True, "newton": False})
        return of_points(n, horizon, a, pull, plane, curve, ratio, G, step, end, np.radians(angle), path)
    if law == "none":
        return measured(n, horizon, a, scheme, plane, angle)
    return broken(n, horizon, a, pull, calibration, law, solver)


def in_infinite_plate(x, a, turn, plane):
    """Return the displacements (n, 2) at ``x`` (n, 2) from the middle of a crack turned by ``turn`` under unit stress.

    In the frame of the crack they are those of ``Z = s z / sqrt(z^2 - a^2)``, opening and sliding, and of the uniform
    stress along the crack that is left (Westergaard).
    """
    mu, nu = 0.5 * E / (1.0 + NU), NU if plane == "stress" else NU / (1.0 - NU)
    modulus, kappa = plane_modulus(plane), (3.0 - nu) / (1.0 + nu)
    frame = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    at = x @ frame.T
    z = at[:, 0] + 1j * at[:, 1]
    root = np.sqrt(z - a) * np.sqrt(z + a)
    u = np.zeros_like(at)
    pulled, sheared = np.cos(turn) ** 2, np.sin(turn) * np.cos(turn)
    Z, whole = pulled * z / root, pulled * root
    u[:, 0] = 0.5 * (kappa - 1.0) * whole.real - at[:, 1] * Z.imag
    u[:, 1] = 0.5 * (kappa + 1.0) * whole.imag - at[:, 1] * Z.real
    Z, whole = sheared * z / root, sheared * root
    u[:, 0] += 0.5 * (kappa + 1.0) * whole.imag + at[:, 1] * Z.real
    u[:, 1] += -0.5 * (kappa - 1.0) * whole.real - at[:, 1] * Z.imag
    along = (np.sin(turn) ** 2 - pulled) / modulus * np.array([1.0, -nu])
    return (u / (2.0 * mu) + along * at) @ frame


def plane_modulus(plane):
    """Return E' [MPa]."""
    return E if plane == "stress" else E / (1.0 - NU**2)


def measured(n, horizon, a, scheme, plane, angle):
    """Return the strip, or the square about a crack that is turned, whose crack is looked at."""
    turn = np.radians(angle)
    width, length = (WIDTH, LENGTH) if angle == 0.0 else (4.0 * a, 4.0 * a)
    dx = width / n
    # Off the middle a line at 45 degrees runs between the particles, not through them.
    off = 0.25 * dx * (angle != 0.0) * np.array([1.0, -1.0])
    middle, along = 0.5 * np.array([width, length]) + off, np.array([np.cos(turn), np.sin(turn)])
    tip = tuple(middle + a * along)
    layer = 2.0 * horizon * dx * (angle != 0.0)
    room = min(a, 0.5 * width - a * along[0] - layer - dx)
    near, far = (max(0.35 * room, horizon * dx), 0.7 * room), (max(0.6 * room, horizon * dx), 0.95 * room)
    q, modulus = 2.0 * a / WIDTH, plane_modulus(plane)
    K = np.sqrt(np.pi * a) * np.array([np.cos(turn) ** 2, np.sin(turn) * np.cos(turn)])
    opening = 4.0 * a / modulus * np.cos(turn) ** 2
    if angle == 0.0:
        K = K * (1.0 - 0.025 * q**2 + 0.06 * q**4) / np.sqrt(np.cos(0.5 * np.pi * q))
        opening *= -0.071 - 0.535 * q + 0.169 * q**2 + 0.02 * q**3 - 1.071 / q * np.log(1.0 - q)
        low, high = pd.region.Slab("y", high=dx), pd.region.Slab("y", low=length - dx)
        conditions = [
            pd.Displacement(pd.region.Nearest((0.5 * dx, 0.5 * dx)), x=0.0, y=0.0),
            pd.Displacement(pd.region.Nearest((width - 0.5 * dx, 0.5 * dx)), y=0.0),
            pd.Force(low, y=-width),
            pd.Force(high, y=width),
        ]
    else:
        rim = ~pd.region.Box((layer, layer), (width - layer, length - layer))

        def exact(component):
            return lambda x, t: t * in_infinite_plate(x - middle, a, turn, plane)[:, component]

        conditions = [pd.Displacement(rim, x=exact(0), y=exact(1))]
    J = K @ K / modulus

    def results(h):
        found = np.array([h["K1"][-1], h["K2"][-1]])
        return {
            "J_over_exact": h["J"][-1] / J,
            "J_far_over_exact": h["J far"][-1] / J,
            "G_over_exact": h["G"][-1] / J,
            "K1": found[0],
            "K2": found[1],
            "K1_exact": K[0],
            "K2_exact": K[1],
            "K_error": float(np.abs(found - K).max() / np.linalg.norm(K)),
            "opening_over_exact": h["opening"][-1] / opening,
        }

    return pd.Case(
        particles=pd.Lattice((0.0, 0.0), (width, length), dx),
        horizon=horizon * dx,
        material=pd.LinearElastic(E, NU, plane=pd.choose("plane", plane, {"stress": "stress", "strain": "strain"})),
        scheme=pd.choose("scheme", scheme, pd.SCHEMES),
        control=pd.Silling(0.5) if scheme == "correspondence" else None,
        cracks=[pd.Segment(tuple(middle - a * along), tip)],
        conditions=conditions,
        history={
            "J": pd.JIntegral(tip, tuple(along), *near),
            "J far": pd.JIntegral(tip, tuple(along), *far),
            "G": pd.EnergyReleaseRate(tip, tuple(along), *far),
            "K1": pd.StressIntensity(tip, tuple(along), *far),
            "K2": pd.StressIntensity(tip, tuple(along), *far, mode="II"),
            "opening": pd.CrackOpening(tuple(middle - a * along), tip, at=0.5),
        },
        results=results,
        fields=[pd.displacement, pd.stress, pd.von_mises],
        picture=pd.Picture(pd.von_mises, "", 50.0),
    )


def griffith_stress(a, modulus):
    """Return the stress at which the crack grows in a strip [MPa]."""
    return np.sqrt(modulus * GC / (np.pi * a / np.cos(np.pi * a / WIDTH)))


def kink(turn):
    """Return the angle by which a crack turned by ``turn`` runs on, and its ``K / sqrt(pi a)`` under unit stress there.

    It runs where the hoop stress about its tip is largest.
    """
    opening, sliding = np.cos(turn) ** 2, np.sin(turn) * np.cos(turn)
    t = (
        0.0
        if sliding == 0.0
        else 2.0 * np.arctan((opening - np.hypot(opening, np.sqrt(8.0) * sliding)) / (4.0 * sliding))
    )
    return t, np.cos(0.5 * t) ** 2 * (opening * np.cos(0.5 * t) - 3.0 * sliding * np.sin(0.5 * t))


def kink_of_zone(turn, length):
    """Return the angle of ``kink``, and the factor on its stress, of a crack with a cohesive length over a.

    The hoop stress is that at the distance ``(K_c / strength)^2 / (2 pi)`` of the tip, where the stress along the
    crack, ``sin^2 - cos^2`` of the pull, adds to that of K (Smith2001).
    """
    t = np.linspace(-0.6 * np.pi, 0.6 * np.pi, 40001)
    opening, sliding = np.cos(turn) ** 2, np.sin(turn) * np.cos(turn)
    hoop = np.cos(0.5 * t) * (opening * np.cos(0.5 * t) ** 2 - 1.5 * sliding * np.sin(t))
    hoop += np.sqrt(length / np.pi) * (np.sin(turn) ** 2 - opening) * np.sin(t) ** 2
    return t[hoop.argmax()], kink(turn)[1] / hoop.max()


@dataclass(frozen=True)
class Turn(pd.Quantity):
    """Angle between a direction and the middle of the failed points one to five horizons beyond a tip [degrees]."""

    tip: tuple[float, float]
    ahead: tuple[float, float]
    horizon: float

    def evaluate(self, solution):
        at = solution.x - self.tip
        along, across = at @ self.ahead, at @ (-self.ahead[1], self.ahead[0])
        far = np.hypot(*at.T) / self.horizon
        failed = (pd.local_damage(solution) > 0.9) & (along > 0.0) & (far > 1.0) & (far < 5.0)
        sums = solution.sum(np.array([along[failed].sum(), across[failed].sum()]))
        return float(np.degrees(np.arctan2(sums[1], sums[0]))) if sums.any() else float("nan")


def of_points(n, horizon, a, pull, plane, curve, ratio, G, step, end, turn, path):
    """Return the strip whose gradient points fail."""
    dx = WIDTH / n
    delta = horizon * dx
    layer = 1.5 * dx
    low, high = pd.region.Slab("y", high=layer), pd.region.Slab("y", low=LENGTH - layer)
    ends = pd.region.Slab("y", high=2.0 * delta) | pd.region.Slab("y", low=LENGTH - 2.0 * delta)
    middle = 0.5 * WIDTH, 0.5 * LENGTH
    above, below = (
        pd.region.Box(
            (middle[0] - 1.01 * dx, middle[1] + min(side, 0.0)), (middle[0] + 1.01 * dx, middle[1] + max(side, 0.0))
        )
        for side in (dx, -dx)
    )
    modulus, ahead = plane_modulus(plane), (float(np.cos(turn)), float(np.sin(turn)))
    kinked, factor = kink(turn)
    griffith = griffith_stress(a, modulus) if turn == 0.0 else np.sqrt(modulus * GC / (np.pi * a)) / factor
    # Off the middle a line at 45 degrees runs between the particles, not through them.
    off = 0.25 * dx * (turn != 0.0)
    tips = [(middle[0] + off + side * a * ahead[0], middle[1] - off + side * a * ahead[1]) for side in (-1.0, 1.0)]
    material = pd.LinearElastic(E, NU, plane=pd.choose("plane", plane, {"stress": "stress", "strain": "strain"}))
    damage = point_damage.damage_of_ratio(curve, material, GC, ratio, delta, dx, protected=ends)

    def results(h):
        peak, length = max(h["force"]) / WIDTH, modulus * GC / damage.strength**2
        stress, half = np.array(h["force"]) / WIDTH, a + 0.5 * np.array(h["dissipated"]) / GC
        grown = (half > a + 2.0 * delta) & (half < 0.4 * WIDTH)
        along = stress[grown] / griffith_stress(half[grown], modulus) if turn == 0.0 else np.empty(0)
        running = {"running": float(along.mean())} if len(along) else {}
        zone_kink, lowered = kink_of_zone(turn, length / a)
        raised = np.sqrt(1.0 / np.cos(np.pi * a * ahead[0] / WIDTH)) if turn != 0.0 else 1.0
        turns = {"turn": h["turn"][-1], "turn_exact": float(np.degrees(kinked))} if turn != 0.0 else {}
        turns |= {"turn_cohesive": float(np.degrees(zone_kink))} if turn != 0.0 else {}
        return {
            "peak_stress": peak,
            "griffith": griffith,
            "ratio": peak / griffith,
            "cohesive": cohesive.over_griffith(cohesive.centre, a, length) * lowered / raised,
            **running,
            "strength": damage.strength,
            "cohesive_length": E * GC / damage.strength**2 / a,
            "balance": h["work"][-1] / (h["stored"][-1] + h["control"][-1] + h["dissipated"][-1]),
            **{name: value for name, value in turns.items() if np.isfinite(value)},
        }

    return pd.Case(
        particles=pd.Lattice((0.0, 0.0), (WIDTH, LENGTH), dx),
        horizon=delta,
        **point_damage.body(material, damage, G),
        cracks=[pd.Segment(*tips)],
        conditions=[pd.Displacement(low, x=0.0, y=0.0), pd.Displacement(high, x=0.0, y=pull)],
        **(
            {"solver": pd.PathFollowing(pd.Opening("y", above, against=below, step=step, end=end))}
            if path
            else {"steps": pd.Steps(20)}
        ),
        history={
            "force": pd.Reaction("y", high),
            "displacement": pd.Mean(pd.displacement, "y", high),
            "tip": pd.CrackTip(ahead),
            **({} if turn == 0.0 else {"turn": Turn(tips[1], ahead, delta)}),
            **point_damage.energies(),
        },
        results=results,
        fields=[pd.displacement, pd.local_damage],
        picture=pd.Picture(pd.local_damage, "", 5.0),
    )


def broken(n, horizon, a, pull, calibration, law, solver):
    """Return the strip that breaks."""
    dx = WIDTH / n
    layer = 1.5 * dx
    low, high = pd.region.Slab("y", high=layer), pd.region.Slab("y", low=LENGTH - layer)
    ends = pd.region.Slab("y", high=2.0 * horizon * dx) | pd.region.Slab("y", low=LENGTH - 2.0 * horizon * dx)
    griffith = griffith_stress(a, E)
    crack = pd.Segment((0.5 * WIDTH - a, 0.5 * LENGTH), (0.5 * WIDTH + a, 0.5 * LENGTH))

    # Of one plane of bonds, so that the load over that of Griffith tells what a crack takes.
    energy = pd.FractureEnergy(GC, share=1.0)
    laws = {"brittle": pd.Brittle(energy, protected=ends), "linear": pd.LinearSoftening(energy, 3.0, protected=ends)}

    def results(h):
        peak = max(h["force"]) / WIDTH
        return {"peak_stress": peak, "griffith": griffith, "ratio": peak / griffith, "broken_bonds": h["broken"][-1]}

    return pd.Case(
        particles=pd.Lattice((0.0, 0.0), (WIDTH, LENGTH), dx),
        horizon=horizon * dx,
        material=pd.BondBased(E=E, plane="stress", calibration=calibration),
        cracks=[crack],
        damage=pd.choose("law", law, laws),
        conditions=[pd.Displacement(low, x=0.0, y=0.0), pd.Displacement(high, x=0.0, y=pull)],
        solver=pd.choose("solver", solver, pd.SOLVERS),
        history={
            "force": pd.Reaction("y", high),
            "displacement": pd.Mean(pd.displacement, "y", high),
            "broken": pd.BrokenBonds(),
            "dissipated": pd.DissipatedEnergy(),
            "stored": pd.StrainEnergy(),
            "work": pd.ExternalWork(),
            "tip": pd.CrackTip((1.0, 0.0)),
        },
        results=results,
        fields=[pd.displacement, pd.local_damage],
        picture=pd.Picture(pd.local_damage, "", 5.0),
    )
