"""What the concrete cases share: bonds that soften as concrete does, beams in three-point bending, and results."""

import numpy as np
import point_damage

import pdpetsc as pd


def bilinear(E, strength, Gf, horizon, protected=None, share=1.0 / 3.0, kink=0.8 / 3.6, snap=9.0 / (4.0 * np.pi)):
    """Return bonds that begin to soften at the strength under uniaxial stress and take ``Gf`` over a unit area.

    The force falls to a third at 0.8 / 3.6 of the last stretch, as the stress does with the opening of a crack
    (Petersson), or to another share at another kink. With constant influence in plane stress bonds that snap at the
    stretch s take 9 E s^2 horizon / (4 pi), or ``snap`` for 9 / (4 pi).
    """
    critical = strength / E
    energy = Gf / (snap * E * critical**2 * horizon)
    ratio = 1.0 + (energy - 1.0) / (kink + share)
    return pd.BilinearSoftening(
        pd.ConstantCritical(critical), 1.0 + kink * (ratio - 1.0), share, ratio, protected=protected
    )


def at_peak(factors, load):
    """Return results of a run whose conditions hold ``load`` at factor 1, and the step of its peak."""
    peak = int(np.argmax(factors))
    return {"peak_load": factors[peak] * load, "last_load": factors[-1] / factors[peak]}, peak


def of_plane(m):
    """Return what a plane of a square lattice takes that opens across a lattice axis, for a horizon of m spacings.

    The largest traction over E times the critical stretch, where bonds soften so slowly that all of them reach their
    largest force, and the energy over ``E s^2 horizon`` of bonds that snap at the stretch s; 1.5 and 9 / (4 pi) where
    there are many bonds. Plane stress, constant influence.
    """
    C, traction, energy = np.zeros((2, 2, 2, 2)), 0.0, 0.0
    reach = range(-int(m), int(m) + 1)
    for xi in ((a, b) for a in reach for b in reach if 0.0 < np.hypot(a, b) <= m):
        length = np.hypot(*xi)
        n = np.array(xi) / length
        C += 0.5 * length * np.einsum("i,j,k,l->ijkl", n, n, n, n)
        across = max(xi[0], 0)
        traction += across**2 / length
        energy += 0.5 * across * length
    modulus = C[0, 0, 0, 0] - C[0, 0, 1, 1] ** 2 / C[1, 1, 1, 1]
    return traction / modulus, energy / modulus / m


def of_points(E, nu, strength, Gf, G, curve, protected):
    """Return an elastic body in plane stress whose gradient points fail by a curve, with correspondence.

    ``G`` is the coefficient of Silling's control [-].
    """
    damage = pd.PointDamage(curve, Gc=Gf, strength=strength, protected=protected)
    return point_damage.body(pd.LinearElastic(E, nu, plane="stress"), damage, G)


def bent_beam(
    size, span, notch, E, strength, Gf, n, horizon, step, end, offset=0.0, at=(), load=1000.0, smallest=1e-3,
    damage="bonds", nu=0.2, G=2.0,
):  # fmt: skip
    """Return a notched beam in three-point bending, bond-based in plane stress, followed by the opening of its notch.

    Bonds soften bilinearly, to a quarter of their largest force at 0.15 of the last stretch (Wittmann), and a plane
    that opens has the strength as its largest traction and takes ``Gf``, on the lattice that there is. With the damage
    ``"point"`` the gradient points of an elastic body fail by the same curve, strength and energy (``pd.PointDamage``),
    with correspondence, a zero-energy control and standard weights; also those under the load, so that the beam
    separates, but none above the supports.

    Parameters
    ----------
    size : (length, depth, width)
    span : float
        Between the supports, around the middle, over which the load is.
    notch : float
        Its depth. Without one the opening is that of a gauge of half the depth of the beam.
    offset : float
        Of the notch from the middle.
    n : int
        Particles over the depth.
    at : sequence of float
        Openings at which the results name the load, as ``load_at_0.1``.
    damage : {"bonds", "point"}
        What fails.
    nu, G : float
        Poisson's ratio and coefficient of the zero-energy control where gradient points fail [-].

    Results: ``peak_load``, ``opening_at_peak``, the loads that were asked for, ``dissipated``, what the laws have taken
    over the fracture energy of the ligament, ``last_load`` over the peak; with the damage ``"point"`` also ``work``
    over the fracture energy of the ligament.
    """
    points = pd.choose("damage", damage, {"bonds": False, "point": True})
    length, depth, width = size
    dx = depth / n
    delta = horizon * dx
    traction, snap = of_plane(horizon)
    middle, mouth = 0.5 * length, 0.5 * length - offset
    area = Gf * width * (depth - notch)
    low = pd.region.Slab("y", high=dx)
    feet = [middle - 0.5 * span, middle + 0.5 * span]
    # One particle each, so that the ends turn: half a spacing beside a foot between two of them.
    left, right = (pd.region.Nearest((foot + 0.5 * dx, 0.0)) for foot in feet)
    loaded = pd.region.Box((middle - 1.5 * dx, depth - dx), (middle + 1.5 * dx, depth))
    gap = 0.0 if notch else 0.25 * depth
    lips = [
        low & pd.region.Slab("x", mouth - gap - 2.0 * dx, mouth - gap),
        low & pd.region.Slab("x", mouth + gap, mouth + gap + 2.0 * dx),
    ]
    under = pd.region.Box((middle - 2.0 * dx, depth - dx), (middle + 2.0 * dx, depth))
    room = 3.0 if points else 2.0
    rests = [pd.region.Box((foot - room * delta, 0.0), (foot + room * delta, (room - 1.0) * delta)) for foot in feet]

    def results(h):
        found, peak = at_peak(h["t"], load)
        opening = np.array(h["right_lip"]) - np.array(h["left_lip"])
        reached = {
            f"load_at_{one:g}": float(np.interp(one, opening, load * np.array(h["t"])))
            for one in at
            if opening[-1] >= one * (1.0 - 1e-9)
        }
        return {
            **found,
            "opening_at_peak": opening[peak],
            **reached,
            "dissipated": h["dissipated"][-1] / area,
            **({"work": h["work"][-1] / area} if points else {"broken_bonds": h["broken"][-1]}),
        }

    if points:
        curve = pd.softening.Bilinear(kink=0.15, share=0.25)
        model = of_points(E, nu, strength, Gf, G, curve, rests[0] | rests[1])
    else:
        model = {
            "material": pd.BondBased(E=E, plane="stress", calibration="family"),
            "damage": bilinear(E, strength / traction, Gf, delta, under | rests[0] | rests[1], 0.25, 0.75 / 5.0, snap),
        }
    return pd.Case(
        particles=pd.Lattice((0.0, 0.0), (length, depth), dx, thickness=width),
        horizon=delta,
        cracks=[pd.Segment((mouth, -1.0), (mouth, notch))] if notch else [],
        **model,
        conditions=[
            pd.Displacement(left, x=0.0, y=0.0),
            pd.Displacement(right, y=0.0),
            pd.Force(loaded, y=-load),
        ],
        solver=pd.PathFollowing(
            pd.Opening("x", lips[1], against=lips[0], step=step, end=end), until=0.02, smallest=smallest
        ),
        history={
            "deflection": pd.Mean(pd.displacement, "y", loaded),
            "left_lip": pd.Mean(pd.displacement, "x", lips[0]),
            "right_lip": pd.Mean(pd.displacement, "x", lips[1]),
            **({"control": pd.ControlEnergy()} if points else {"broken": pd.BrokenBonds()}),
            "dissipated": pd.DissipatedEnergy(),
            "stored": pd.StrainEnergy(),
            "work": pd.ExternalWork(),
        },
        results=results,
        fields=[pd.displacement, pd.local_damage],
        picture=pd.Picture(pd.local_damage, "", 50.0),
    )
