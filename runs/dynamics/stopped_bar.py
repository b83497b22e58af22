"""Bar that flies and is stopped suddenly at one end. Units m, N, kg, s.

A bar of length 0.02 (E = 205e9, nu = 0, density 7850) moves at -0.1 m/s and is held at x = 0 from the start on. A wave
of the speed ``c = sqrt(E / rho)`` runs through it: the stress at the wall is ``-rho c v = -4.012e6`` until ``2 L / c =
7.827e-6``, then 0 for as long, and the free end moves at -0.1 and 0.1 m/s by turns of ``2 L / c``.

``dim=1`` is a line, 3 a bar of 1 mm by 1 mm with ``n`` cells over 1 mm, 20 ``n`` over its length. ``explicit=no``
takes generalised-alpha steps of ``dt`` cells over c.

Results: ``wall_stress``, the mean over the middle 80 % of the time in which the wave returns, ``wall_error``,
``end_error``, the root mean square of the error of the displacement of the free end over one period over its largest
value, and ``energy_error``.
"""

import numpy as np

import pdpetsc as pd

LENGTH, SIDE, E, DENSITY, SPEED = 0.02, 1e-3, 205e9, 7850.0, 0.1
WAVE = np.sqrt(E / DENSITY)
STRESS, BACK = -DENSITY * WAVE * SPEED, 2.0 * LENGTH / WAVE
RECORDS = 200


def exact(time):
    """Return the displacement of the free end: it turns back when the wave from the wall arrives."""
    phase = np.mod(time + 0.25 * 2.0 * BACK, 2.0 * BACK) / BACK
    return -0.5 * SPEED * BACK * (2.0 * np.minimum(phase, 2.0 - phase) - 1.0)


def case(n=4, dim=1, explicit=True, dt=0.5, radius=0.9, scheme="sub_horizons"):
    h = SIDE / n
    known = {"sub_horizons": pd.SubHorizons, "correspondence": pd.Correspondence}
    area = 1.0 if dim == 1 else SIDE ** (dim - 1)
    high = (LENGTH, *[SIDE] * (dim - 1))

    def results(history):
        time, wall = np.array(history["time"]), np.array(history["wall"]) / area
        within = (time > 0.1 * BACK) & (time < 0.9 * BACK)
        stress = -float(wall[within].mean())
        end = exact(time)
        return {
            "wall_stress": stress,
            "wall_error": stress / STRESS - 1.0,
            "end_error": float(np.sqrt(((np.array(history["end"]) - end) ** 2).mean()) / np.abs(end).max()),
            "energy_error": float(np.abs(history["energy_error"]).max()),
        }

    end = 2.0 * BACK
    motion = (
        pd.Explicit(end=end, records=RECORDS) if explicit else pd.Implicit(dt=dt * h / WAVE, end=end, radius=radius)
    )
    return pd.Case(
        particles=pd.LatticeNodes((0.0,) * dim, high, h),
        material=pd.LinearElastic(E=E, nu=0.0, density=DENSITY),
        scheme=pd.choose("scheme", scheme, known)(),
        control=None if scheme == "sub_horizons" else pd.Silling(0.5),
        conditions=[pd.Displacement("-x", x=0.0), pd.InitialVelocity(pd.region.All(), x=-SPEED)],
        solver=motion,
        history={
            "wall": pd.Reaction("x", "-x"),
            "end": pd.Mean(pd.displacement, "x", "+x"),
            "kinetic": pd.KineticEnergy(),
            "energy_error": pd.EnergyError(),
        },
        fields=[pd.displacement, pd.velocity, pd.stress],
        checkpoints=0,
        results=results,
        expect={"wall_stress": pd.Expected(STRESS, relative=0.02, source="rho c v")},
    )
