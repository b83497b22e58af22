"""A crack that closes again: its faces carry pressure, and slide against friction. Units mm, N.

A strip of height 10 (E = 1000, nu = 0, plane strain), periodic along x, is pulled apart across its middle (Gc = 0.01),
closed and pressed by a strain of ``pressed``. Then the top moves along x by ``slide``, back by twice that, and forward
again. Gradient points fail by ``pd.PointDamage``, whose faces slide with ``friction`` (``pd.split.NoTension``), or not
if that is negative.

Results: ``pressure_over_exact``, the force of the closed strip over that of an intact one; ``drag_over_normal``, the
largest force along x over that along y while the faces slide, against ``friction``; ``slip_over_exact``, the width of
the loop of the force over the displacement at zero force over the exact one, and ``work_over_exact``, its area: those
of two halves that slide on each other, ``2 (slide - friction p H / G)`` and ``4 friction p`` times half the first,
with the pressure p and the shear modulus G.
"""

import numpy as np
import scipy
from point_damage import CURVES

import pdpetsc as pd

E, GC, HEIGHT, RATIO = 1000.0, 0.01, 10.0, 5.0
OPEN, CLOSED, PRESSED = 0.25, 0.4, 0.5
# Load parameters at which the top has moved by slide, -slide and slide.
TURNS = (0.6, 0.8, 1.0)
LAWS = {"small": pd.LinearElastic, "logarithmic": pd.Hencky, "green": pd.SaintVenantKirchhoff}


def case(n=20, friction=0.3, pressed=2e-3, slide=0.03, horizon=3.015, strain="small", steps=10):
    dx = HEIGHT / n
    width = 2.0 * int(horizon) * dx
    strength = np.sqrt(2.0 * E * GC / (width * RATIO))
    # Damage develops slowly, and no stress is left at the end.
    failing, opened = RATIO * strength / E * width, 20.0 * RATIO * strength / E * width
    law = pd.choose("strain", strain, LAWS)(E=E, nu=0.0)

    def up(x, t):
        return np.full(
            len(x),
            np.interp(t, [0.0, 0.6 * OPEN, OPEN, CLOSED, PRESSED], [0.0, failing, opened, 0.0, -pressed * HEIGHT]),
        )

    def along(x, t):
        return np.full(len(x), np.interp(t, [0.0, PRESSED, *TURNS], [0.0, 0.0, slide, -slide, slide]))

    def results(h):
        t, fx, fy, ux = (np.array(h[name]) for name in ("t", "force_x", "force_y", "along"))
        p = -fy[np.argmin(np.abs(t - PRESSED))] / HEIGHT
        exact = 2.0 * (slide - max(friction, 0.0) * E * pressed * HEIGHT / (0.5 * E))
        # From one turn of the top to the next and back.
        loop = t >= TURNS[0] - 1e-9
        x, f = ux[loop], fx[loop]
        way = np.argmin(np.abs(t[loop] - TURNS[1]))
        back, forth = np.interp(0.0, -f[: way + 1], x[: way + 1]), np.interp(0.0, f[way:], x[way:])
        work = scipy.integrate.trapezoid(f, x)
        sliding = t > PRESSED + 1e-9
        return {
            "pressure_over_exact": p / (E * pressed),
            "drag_over_normal": float(np.max(np.abs(fx[sliding] / fy[sliding]))),
            "slip_over_exact": abs(back - forth) / exact,
            "work_over_exact": work / (2.0 * max(friction, 1e-12) * E * pressed * HEIGHT * exact),
        }

    return pd.Case(
        particles=pd.Lattice((0.0, -0.5 * dx), (HEIGHT, HEIGHT + 0.5 * dx), dx),
        cell=pd.Cell((0.0, 0.0), (HEIGHT, HEIGHT), axes="x"),
        horizon=horizon * dx,
        material=law,
        scheme=pd.Correspondence(),
        control=pd.Silling(2.0),
        damage=pd.PointDamage(
            CURVES["linear"],
            Gc=GC,
            strength=lambda x: strength * np.where(np.abs(x[:, 1] - 0.5 * HEIGHT) < 0.6 * dx, 0.9, 1.0),
            split=pd.split.NoTension(friction=None if friction < 0.0 else friction),
        ),
        conditions=[
            pd.Displacement("-y", x=0.0, y=0.0),
            pd.Displacement("+y", x=along, y=up),
            pd.MeanStrain(xx=0.0),
        ],
        steps=pd.Steps(
            times=tuple(
                np.unique(
                    np.round(
                        np.concatenate(
                            [np.linspace(0.0, PRESSED, 2 * steps + 1), np.linspace(PRESSED, 1.0, 3 * steps + 1)]
                        )[1:],
                        12,
                    )
                )
            )
        ),
        history={
            "force_x": pd.Reaction("x", "+y"),
            "force_y": pd.Reaction("y", "+y"),
            "along": pd.Mean(pd.displacement, "x", "+y"),
            "work": pd.ExternalWork(),
            "stored": pd.StrainEnergy(),
            "dissipated": pd.DissipatedEnergy(),
        },
        results=results,
    )
