"""Free vibration of a clamped square bar, against Timoshenko's beam. Any consistent units.

A bar of length 10 and square cross-section of side 1, E = 1000, nu = 0.3, rho = 1, is clamped at one end and starts
with velocities in the shape of the first bending mode of Euler's beam. ``n`` cells are across, on nodes. With ``dim=2``
it is a plate of thickness 1 in plane stress. ``solver=implicit`` takes ``steps`` steps a period, ``explicit`` those
that are stable.

Timoshenko: ``M = E I phi'``, ``Q = k G A (u' - phi)``, ``Q' = -rho A w^2 u``, ``M' + Q = -rho I w^2 phi`` with the
shear coefficient ``k = 10 (1 + nu) / (12 + 11 nu)`` of a rectangle (Cowper 1966).

Results: ``period`` of the deflection of the end, the mean over the run, ``frequency_over_timoshenko``, and the largest
``energy_error``.
"""

import numpy as np
from scipy.linalg import expm
from scipy.optimize import brentq

import pdpetsc as pd

E, NU, RHO, LENGTH = 1000.0, 0.3, 1.0, 10.0
SLENDERNESS = 1.875104068711961


def euler():
    """Return the first circular frequency of Euler's beam."""
    return (SLENDERNESS / LENGTH) ** 2 * np.sqrt(E / 12.0 / RHO)


def timoshenko():
    """Return the first circular frequency of Timoshenko's beam: the end has neither moment nor shear force."""
    shear = 10.0 * (1.0 + NU) / (12.0 + 11.0 * NU) * E / (2.0 + 2.0 * NU)

    def free(w):
        # Deflection, rotation, moment and shear force.
        rates = np.array(
            [
                [0.0, 1.0, 0.0, 1.0 / shear],
                [0.0, 0.0, 12.0 / E, 0.0],
                [0.0, -RHO / 12.0 * w**2, 0.0, -1.0],
                [-RHO * w**2, 0.0, 0.0, 0.0],
            ]
        )
        return np.linalg.det(expm(LENGTH * rates)[2:, 2:])

    return brentq(free, 0.5 * euler(), 1.05 * euler())


def mode(x):
    """Return the first mode of Euler's beam at distances from the clamped end, 1 at the free one."""
    s, b = SLENDERNESS * x / LENGTH, SLENDERNESS
    share = (np.cos(b) + np.cosh(b)) / (np.sin(b) + np.sinh(b))
    return 0.5 * (np.cosh(s) - np.cos(s) - share * (np.sinh(s) - np.sin(s)))


def crossings(times, values):
    """Return the times at which values cross zero upwards."""
    t, y = np.asarray(times), np.asarray(values)
    at = np.flatnonzero((y[:-1] < 0.0) & (y[1:] >= 0.0))
    return t[at] - y[at] * (t[at + 1] - t[at]) / (y[at + 1] - y[at])


def case(n=4, dim=3, periods=4.25, steps=100, solver="implicit"):
    period = 2.0 * np.pi / timoshenko()
    known = {
        "implicit": lambda: pd.Implicit(dt=period / steps, end=periods * period),
        "explicit": lambda: pd.Explicit(end=periods * period, records=int(periods * 100)),
    }

    def results(h):
        found = crossings(h["time"], h["end"])
        mean = float(np.mean(np.diff(found)))
        return {
            "period": mean,
            "frequency_over_timoshenko": period / mean,
            "energy_error": float(np.abs(h["error"]).max()),
        }

    material = pd.LinearElastic(E=E, nu=NU, density=RHO, **({"plane": "stress"} if dim == 2 else {}))
    return pd.Case(
        particles=pd.LatticeNodes((0.0,) * dim, (LENGTH, *(1.0,) * (dim - 1)), 1.0 / n),
        material=material,
        conditions=[
            pd.Clamp("-x"),
            pd.InitialVelocity(pd.region.All(), y=lambda x, t: 1e-3 * mode(x[:, 0])),
        ],
        solver=pd.choose("solver", solver, known)(),
        history={"end": pd.Mean(pd.displacement, "y", "+x"), "error": pd.EnergyError()},
        fields=[],
        results=results,
        expect={"frequency_over_timoshenko": pd.Expected(1.0, relative=0.02, source="Timoshenko")},
    )
