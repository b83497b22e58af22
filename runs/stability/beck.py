"""Beck's column: flutter under a force that stays along its end. Any consistent units.

A strip of length 10 and height 0.5, plane stress, Hencky's law with E = 1000, nu = 0, density 1, clamped at its left
side. A force of ``load`` times ``E I / L^2``, after a ramp over the first period, presses the rigid right side along
the axis of the end. No load has another equilibrium than the straight one, but vibrations grow beyond 20.05 (Beck
1952). ``n`` cells over the height, ``periods`` of 40 time steps each.

Beam theory: ``w = exp(i W t)`` with the unit of time ``sqrt(rho A L^4 / E I)`` is a root of
``P^2 + 2 W^2 (1 + cos a cosh b) + P W sin a sinh b``, ``a^2, b^2 = sqrt(P^2 / 4 + W^2) +- P / 2``. The strip has shear
and rotary inertia beside it.

Results: ``growth``, the largest deflection in the second half of the time over that in the first; ``rate`` and
``frequency`` of the deflection that grows, from a fit to the second half, in the unit of time.
"""

import numpy as np
from scipy.optimize import fsolve

import pdpetsc as pd

E, LENGTH, HEIGHT = 1000.0, 10.0, 0.5
STIFFNESS = E * HEIGHT**3 / 12.0
UNIT = np.sqrt(HEIGHT * LENGTH**4 / STIFFNESS)
CRITICAL = 20.05
PERIOD = 2.0 * np.pi / 11.0


def exact(load):
    """Return rate and frequency of the vibration that grows, in the unit of time (2,)."""

    def equation(parts):
        w = complex(*parts)
        root = np.sqrt(0.25 * load**2 + w**2)
        a, b = np.sqrt(root + 0.5 * load), np.sqrt(root - 0.5 * load)
        value = load**2 + 2.0 * w**2 * (1.0 + np.cos(a) * np.cosh(b)) + load * w * np.sin(a) * np.sinh(b)
        return value.real, value.imag

    frequency, rate = fsolve(equation, (11.0, 1.0), xtol=1e-12)
    return np.array([rate, frequency])


def fitted(y, dt):
    """Return rate and frequency of a vibration ``exp(rate t) cos(frequency t + phase)`` (2,)."""
    factors = np.linalg.lstsq(np.stack([y[1:-1], y[:-2]], axis=1), y[2:], rcond=None)[0]
    root = np.log(complex(np.roots([1.0, *-factors])[0])) / dt
    return np.array([root.real, abs(root.imag)])


def case(n=4, load=24.0, periods=4):
    dt = PERIOD / 40

    def results(h):
        y = np.array(h["y"])
        later = y[len(y) // 2 :]
        rate, frequency = fitted(later, dt)
        growth = np.abs(later).max() / np.abs(y[: len(y) // 2]).max()
        return {"growth": float(growth), **({"rate": rate, "frequency": frequency} if load > CRITICAL else {})}

    expect = {"growth": pd.Expected(1.0, absolute=0.5, source="Beck 1952, no growth")}
    if load > CRITICAL:
        rate, frequency = exact(load).tolist()
        expect = {
            "rate": pd.Expected(rate, relative=0.1, source="Beck 1952"),
            "frequency": pd.Expected(frequency, relative=0.03, source="Beck 1952"),
        }
    force = (-load * STIFFNESS / LENGTH**2, 0.0)
    ramp = pd.Table((0.0, 1.0 / periods, 1.0), (0.0, 1.0, 1.0))
    return pd.Case(
        particles=pd.LatticeNodes((0.0, -0.5 * HEIGHT), (LENGTH, 0.5 * HEIGHT), HEIGHT / n),
        material=pd.Hencky(E=E, nu=0.0, plane="stress", density=1.0),
        conditions=[
            pd.Clamp("-x"),
            pd.RigidRegion("+x", force=force, moment=0.0, about=(LENGTH, 0.0), schedule=ramp, follows=True),
            pd.InitialVelocity(pd.region.All(), y=lambda x, t: 1e-4 * (x[:, 0] / LENGTH) ** 2 * LENGTH / UNIT),
        ],
        solver=pd.Implicit(dt=dt * UNIT, end=periods * PERIOD * UNIT),
        history={"y": pd.Mean(pd.displacement, "y", "+x"), "error": pd.EnergyError()},
        results=results,
        expect=expect,
    )
