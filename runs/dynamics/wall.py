"""Bar that hits a rigid wall and leaves it. Units m, N, kg, s.

A bar of 0.2 by 0.02 by 0.02 (E = 2e11, nu = 0, density 8000) flies at 100 m/s towards a rigid plane 2 mm away. The wave
of the speed ``c = sqrt(E / rho) = 5000`` presses it with ``rho c v = 4.0e9`` for ``2 L / c = 80e-6``, then the bar
leaves at 100 m/s.

``n`` cells over 0.02, ``dim`` 1 or 3. A contact that closes within a time step has an error of energy, which a smaller
``safety`` reduces.

Results: ``wall_stress``, the mean over the middle 80 % of the contact, ``duration`` of the contact, ``leaves`` at the
mean velocity of the bar, ``wall_error``, ``duration_error``, ``speed_error`` and ``energy_error``.
"""

import numpy as np

import pdpetsc as pd

LENGTH, SIDE, E, DENSITY, SPEED, GAP = 0.2, 0.02, 2e11, 8000.0, 100.0, 0.002
WAVE = np.sqrt(E / DENSITY)
STRESS, TIME = DENSITY * WAVE * SPEED, 2.0 * LENGTH / WAVE
END = 120e-6


def case(n=4, dim=1, scheme="sub_horizons", records=400, safety=0.3):
    h = SIDE / n
    known = {"sub_horizons": pd.SubHorizons, "correspondence": pd.Correspondence}
    area = 1.0 if dim == 1 else SIDE ** (dim - 1)
    across = (0.0,) * (dim - 1)
    wall = pd.RigidPlane((-GAP, *across), (1.0, *across))

    def results(history):
        time, force = np.array(history["time"]), np.array(history["wall_x"]) / area
        first = GAP / SPEED
        within = (time > first + 0.1 * TIME) & (time < first + 0.9 * TIME)
        stress = float(force[within].mean())
        pressed = time[force > 0.1 * STRESS]
        duration = float(pressed.max() - pressed.min())
        velocity = np.gradient(np.array(history["middle"]), time)
        leaves = float(velocity[time > first + 1.1 * TIME].mean())
        return {
            "wall_stress": stress,
            "duration": duration,
            "leaves": leaves,
            "wall_error": stress / STRESS - 1.0,
            "duration_error": duration / TIME - 1.0,
            "speed_error": leaves / SPEED - 1.0,
            "energy_error": float(np.abs(history["energy_error"]).max()),
        }

    return pd.Case(
        particles=pd.LatticeNodes((0.0,) * dim, (LENGTH, *[SIDE] * (dim - 1)), h),
        material=pd.LinearElastic(E=E, nu=0.0, density=DENSITY),
        scheme=pd.choose("scheme", scheme, known)(),
        control=None if scheme == "sub_horizons" else pd.Silling(0.5),
        conditions=[
            pd.InitialVelocity(pd.region.All(), x=-SPEED),
            pd.Contact("-x", wall, penetration=0.1, name="wall"),
        ],
        solver=pd.Explicit(end=END, safety=safety, records=records),
        history={"middle": pd.Mean(pd.displacement, "x"), "energy_error": pd.EnergyError()},
        fields=[pd.displacement, pd.velocity, pd.stress],
        checkpoints=0,
        results=results,
    )
