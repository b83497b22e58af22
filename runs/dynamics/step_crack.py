"""Crack that a wave hits: dynamic stress intensity factor. Units m, N, kg, s.

A plate of 10 by 4 with a crack of 5 at half of its height (E = 210e9, nu = 0.3, density 8000, plane strain). Its upper
edge is pulled by 500e6 from the start on. The wave reaches the crack at ``t_c = H / c_d = 336.4e-6`` (H = 2), and until
waves come back from the edges, at 3 t_c, the crack is half infinite: ``K = 2 s / (1 - nu) sqrt(c_d (t - t_c) (1 - 2 nu)
/ pi)``, K / (s sqrt(H)) = 0.7209, 1.0195, 1.2486, 1.4418 at 1.5, 2, 2.5, 3 t_c (Freund 1990; Belytschko 2003).

``n`` particles over the height. K is the interaction integral with inertia, between ``inner`` horizons and ``outer``
from the tip.

Results: ``K_15``, ``K_20``, ``K_25``, ``K_30`` over ``s sqrt(H)``, ``K_over_exact``, the mean ratio at the four times,
``largest_error`` of them, and ``energy_error``.
"""

import numpy as np

import pdpetsc as pd

LENGTH, HEIGHT, CRACK, LOAD = 10.0, 4.0, 5.0, 500e6
E, NU, DENSITY = 210e9, 0.3, 8000.0
WAVE = np.sqrt(E * (1.0 - NU) / ((1.0 + NU) * (1.0 - 2.0 * NU) * DENSITY))
H = 0.5 * HEIGHT
ARRIVES = H / WAVE
TIMES = (1.5, 2.0, 2.5, 3.0)
RECORDS = 60


def exact(time):
    """Return K / (s sqrt(H)) at times over that of the arrival of the wave."""
    return 2.0 / (1.0 - NU) * np.sqrt((np.asarray(time) - 1.0) * (1.0 - 2.0 * NU) / np.pi)


def case(n=80, horizon=2.015, inner=1.5, outer=0.5, scheme="correspondence"):
    h = HEIGHT / n
    known = {"sub_horizons": pd.SubHorizons, "correspondence": pd.Correspondence}
    tip, ahead = (CRACK, 0.0), (1.0, 0.0)

    def results(history):
        time, K = np.array(history["time"]) / ARRIVES, np.array(history["K"]) / (LOAD * np.sqrt(H))
        found = np.interp(TIMES, time, K)
        ratio = found / exact(TIMES)
        return {f"K_{round(10 * at)}": float(one) for at, one in zip(TIMES, found, strict=True)} | {
            "K_over_exact": float(ratio.mean()),
            "largest_error": float(np.abs(ratio - 1.0).max()),
            "energy_error": float(np.abs(history["energy_error"]).max()),
        }

    return pd.Case(
        particles=pd.Lattice((0.0, -H), (LENGTH, H), h),
        horizon=horizon * h,
        cracks=[pd.Segment((-h, 0.0), tip)],
        material=pd.LinearElastic(E=E, nu=NU, density=DENSITY),
        scheme=pd.choose("scheme", scheme, known)(),
        control=None if scheme == "sub_horizons" else pd.Silling(1.0),
        conditions=[pd.Traction("+y", y=LOAD, normal=(0.0, 1.0), schedule=pd.Hold())],
        solver=pd.Explicit(end=3.0 * ARRIVES, records=RECORDS),
        history={
            "K": pd.StressIntensity(tip, ahead, inner * horizon * h, outer),
            "J": pd.JIntegral(tip, ahead, inner * horizon * h, outer),
            "energy_error": pd.EnergyError(),
        },
        fields=[pd.displacement, pd.velocity, pd.stress],
        picture=pd.Picture(pd.stress, "yy"),
        checkpoints=0,
        results=results,
    )
