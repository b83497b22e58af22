"""Concrete prism with an oblique notch under torsion (Brokenshire): a crack that warps in space. Units mm, N.

100 x 100 x 400, notch at 45 degrees to the axis across the middle, 50 deep from above, a plane without width. E = 35
GPa, nu = 0.2, strength 2.3 MPa, fracture energy 0.08 N / mm (Jefferson, Barr, Bennett and Hee 2004); exponential
softening. The ends are in steel frames, here an elastic material of 210 GPa over ``FRAME`` mm of the axis, 200 mm wide
between the corners. Three corners rest, the fourth one is pushed down. Assumed, because no source at hand prints them:
width and length of the frames, their bond to the concrete, and the height of the corners, at half the depth.

``n`` particles over the depth. Gradient points fail (``pd.PointDamage``), with correspondence, ``Silling(G)`` and
standard weights. The path is followed by the opening of the notch along the axis of the prism, at the middle of the
upper face, in steps of ``step`` to ``end`` [mm]. The opening across the plane of the notch, ``cmod``, is larger.
Results: ``peak_load`` [N], ``cmod_at_peak`` [mm], ``last_load`` over the peak, and over the fracture energy of the half
of the plane of the notch that is left: ``work`` and ``dissipated``. A warped crack is larger than that plane.
The tests peak at 1.2 to 1.4 kN.
"""

import numpy as np
import point_damage

import pdpetsc as pd

LENGTH, SIDE, NOTCH, FRAME, ARM = 400.0, 100.0, 50.0, 50.0, 200.0
E, NU, STRENGTH, GC, STEEL = 35e3, 0.2, 2.3, 0.08, 210e3


def case(n=8, horizon=2.015, G=0.5, step=0.01, end=0.4, strength=STRENGTH, Gc=GC, frame=FRAME, arm=ARM):
    dx = SIDE / n
    delta = horizon * dx
    half, over = 0.5 * SIDE, 0.5 * arm
    load = 1000.0
    area = np.sqrt(2.0) * SIDE * (SIDE - NOTCH)
    beam = pd.region.Box((-1.0, -half, -half), (LENGTH + 1.0, half, half))
    grips = pd.region.Slab("x", high=frame) | pd.region.Slab("x", low=LENGTH - frame)
    # The corners of the frames: one particle each, about the middle of their length and depth.
    corners = {
        (end, side): pd.region.Nearest((x + 0.5 * dx, side * (over - 0.5 * dx), 0.5 * dx))
        for end, x in (("left", 0.5 * frame), ("right", LENGTH - 0.5 * frame))
        for side in (-1.0, 1.0)
    }
    loaded = corners["right", 1.0]
    # Between rows of particles, of which one is on the diagonal itself.
    across, along = 0.5 * (LENGTH + dx), np.sqrt(0.5)
    lips = [
        pd.region.Where(
            lambda x, side=side: (
                (np.abs(x[:, 2] - half) < dx)
                & (np.hypot(x[:, 0] - across, x[:, 1]) < 2.5 * dx)
                & (side * (x[:, 0] - across + x[:, 1]) > 0.0)
            )
        )
        for side in (-1.0, 1.0)
    ]

    def results(h):
        force = load * np.array(h["t"])
        peak = int(np.argmax(force))
        opening = along * sum(
            sign * (np.array(h[f"{side}_x"]) + np.array(h[f"{side}_y"]))
            for sign, side in ((1.0, "front"), (-1.0, "back"))
        )
        return {
            "peak_load": force[peak],
            "cmod_at_peak": opening[peak],
            "last_load": force[-1] / force[peak],
            "work": h["work"][-1] / (area * Gc),
            "dissipated": h["dissipated"][-1] / (area * Gc),
        }

    wide, low = 2.0 * SIDE, half - NOTCH
    notch = [(across - y, y, z) for y, z in ((-wide, low), (wide, low), (wide, wide), (-wide, wide))]
    concrete, steel = pd.LinearElastic(E, NU), pd.LinearElastic(STEEL, 0.3)
    damage = pd.PointDamage(pd.softening.Exponential(), Gc=Gc, strength=strength, protected=grips | ~beam)
    return pd.Case(
        particles=pd.Lattice((0.0, -over, -half), (LENGTH, over, half), dx, keep=beam | grips),
        horizon=delta,
        **point_damage.body([(grips, steel), (~grips, concrete)], damage, G),
        cracks=[pd.PolygonCrack(notch)],
        conditions=[
            pd.Displacement(corners["left", 1.0], x=0.0, z=0.0),
            pd.Displacement(corners["left", -1.0], x=0.0, y=0.0, z=0.0),
            pd.Displacement(corners["right", -1.0], z=0.0),
            pd.Force(loaded, z=-load),
        ],
        solver=pd.PathFollowing(pd.Opening("x", lips[1], against=lips[0], step=step, end=end), until=0.05),
        history={
            **{
                f"{name}_{axis}": pd.Mean(pd.displacement, axis, side)
                for name, side in zip(("back", "front"), lips, strict=True)
                for axis in "xy"
            },
            "deflection": pd.Mean(pd.displacement, "z", loaded),
            **point_damage.energies(),
        },
        results=results,
        expect={"peak_load": pd.Expected(1300.0, relative=0.15, source="tests of Brokenshire, 1.2 to 1.4 kN")},
        fields=[pd.displacement, pd.local_damage],
        picture=pd.Picture(pd.local_damage, "", 100.0),
    )
