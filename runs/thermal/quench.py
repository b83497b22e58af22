"""Hot ceramic plate that is quenched in water: parallel cracks whose spacing grows with depth. Units mm, N, s, K.

Half of a plate 6 mm thick below its mirror plane; its lower face y = 0 convects to water, the others are insulated.
Alumina of bonds in plane stress, whose strength scatters by ``scatter`` from place to place; heat flows along the bonds
that are left. ``spacing_0`` to ``spacing_3`` are the mean distances of the cracks at four depths after ``time``: a
quarter of a millimetre, and 0.15, 0.4 and 0.6 of the half plate; ``cooled_to`` and ``core`` are the temperatures of the
face and of the middle. ``spacing_0_over_least`` is over the spacing of the array of straight cracks that has the least
energy when a plate without cracks has most, 2.11 mm (``quench_elements.py``).

With ``damage=point`` gradient points fail (``pd.PointDamage``, linear softening) at a ``strength`` [MPa] that scatters
in the same way, with the same fracture energy, nu = 0.3, correspondence and ``Silling(G)``. The temperature is then
that of the plate without cracks, given by its series, and a crack counts where it has failed. ``length_over_least`` is
the dissipated energy over Gc, the length of all cracks, over that of the array of least energy after the same time
(the longest until then, as cracks do not heal).
"""

import json
from pathlib import Path

import numpy as np
from scipy.optimize import brentq

import pdpetsc as pd

E, ALPHA, GC = 370e3, 7.5e-6, 0.0243  # MPa, 1 / K, N / mm
CONDUCTIVITY, CAPACITY = 31.0, 3.5  # N / s / K, N / mm^2 / K
WATER = 20.0


def noise(x):
    """Return a number between -1 and 1 for each place (n,), as good as random and the same on every rank."""
    return 2.0 * np.modf(np.abs(np.sin(x @ np.array([12.9898, 78.233])) * 43758.5453))[0] - 1.0


def cooled(depth, half, coefficient, time, hot, terms=60):
    """Return the temperature of a plate without cracks at depths: the series of a face that convects."""
    biot = coefficient * half / CONDUCTIVITY
    roots = [brentq(lambda a: a * np.sin(a) - biot * np.cos(a), n * np.pi, (n + 0.5) * np.pi) for n in range(terms)]
    a = np.array(roots)
    weight = 4.0 * np.sin(a) / (2.0 * a + np.sin(2.0 * a)) * np.exp(-(a**2) * CONDUCTIVITY / CAPACITY * time / half**2)
    return WATER + (hot - WATER) * np.cos(np.multiply.outer(1.0 - np.asarray(depth) / half, a)) @ weight


def least_rows():
    """Return what is known of the cracks of least energy, by time, of the plate as it stands."""
    return json.loads(Path(__file__).with_name("quench_elements.json").read_text())


def least_energy():
    """Return the spacing of the cracks of least energy [length]."""
    return max(least_rows(), key=lambda row: row["without_cracks"])["spacing"]


def least_length(time):
    """Return the length of the cracks of least energy over the width [-], the largest until a time."""
    rows = least_rows()
    length = np.maximum.accumulate([row["depth"] / row["spacing"] for row in rows])
    return float(np.interp(time, [row["time"] for row in rows], length))


class Cracks(pd.Quantity):
    """Number of cracks that cross a row of particles: runs of particles that have lost a share of their bonds."""

    def __init__(self, depth, dx, columns, lost=pd.lost_bonds, share=0.34):
        self.depth, self.dx, self.columns, self.lost, self.share = depth, dx, columns, lost, share

    def evaluate(self, solution):
        row = np.abs(solution.x[:, 1] - (np.floor(self.depth / self.dx) + 0.5) * self.dx) < 0.25 * self.dx
        hurt = row & (self.lost(solution) > self.share)
        column = np.rint(solution.x[hurt, 0] / self.dx - 0.5).astype(int)
        marked = solution.sum(np.bincount(column, minlength=self.columns).astype(float)) > 0.0
        return float(np.count_nonzero(np.diff(np.concatenate([[False], marked]).astype(int)) == 1))


def case(
    width=12.0, half=3.0, dx=0.075, horizon=3.015, hot=620.0, coefficient=50.0, time=0.5, steps=60, scatter=0.1,
    at_once=30, damage="bonds", strength=180.0, G=0.5,
):  # fmt: skip
    reach = horizon * dx
    critical = np.sqrt(4.0 * np.pi * GC / (9.0 * E * reach))
    depths = [0.25, 0.15 * half, 0.4 * half, 0.6 * half]
    columns = round(width / dx)
    # The plate that cracks of least energy were computed for, from 0.03 s on.
    plate = (half, hot, coefficient) == (3.0, 620.0, 50.0)
    known = plate and time >= 0.12
    # Cracks run along the flow of heat; bonds along the surface, which break as well, hinder it a little.
    core = cooled(half, half, coefficient, time, hot)
    points = pd.choose("damage", damage, {"bonds": False, "point": True})
    counted = (pd.local_damage, 0.9) if points else (pd.lost_bonds, 0.34)
    if points:
        model = {
            "material": pd.Thermal(pd.LinearElastic(E, 0.3, plane="stress"), ALPHA, reference=hot),
            "scheme": pd.Correspondence(),
            "control": pd.Silling(G),
            "weights": pd.Standard(),
            "damage": pd.PointDamage(
                pd.softening.Linear(), Gc=GC, strength=lambda x: strength * (1.0 + scatter * noise(x))
            ),
        }
    else:
        model = {
            "material": pd.Thermal(
                pd.BondBased(E=E, plane="stress"), ALPHA, reference=hot, conductivity=CONDUCTIVITY, capacity=CAPACITY
            ),
            "damage": pd.Brittle(
                pd.CriticalFunction(lambda length, middle: critical * (1.0 + scatter * noise(middle)))
            ),
            "heat": pd.HeatConduction(duration=time),
        }
    # Time runs with the square of the load parameter, as the cold goes deeper with the root of time.
    cooling = (
        pd.Temperature(pd.region.All(), lambda x, t: cooled(x[:, 1], half, coefficient, time * t**2, hot))
        if points
        else pd.Convection(pd.region.Slab("y", high=0.0), coefficient, WATER)
    )
    return pd.Case(
        particles=pd.Lattice((0.0, 0.0), (width, half), dx),
        horizon=reach,
        **model,
        symmetry=[pd.Symmetry("y", half)],
        conditions=[
            pd.Displacement(pd.region.Nearest((0.5 * width + 0.5 * dx, half)), x=0.0),
            cooling,
        ],
        steps=pd.Steps(steps, bonds_at_once=at_once),
        history={
            **({"dissipated": pd.DissipatedEnergy()} if points else {"broken": pd.BrokenBonds()}),
            "surface": pd.At((0.5 * width, 0.0), pd.temperature),
            "core": pd.At((0.5 * width, half), pd.temperature),
            **{f"cracks_{n}": Cracks(depth, dx, columns, *counted) for n, depth in enumerate(depths)},
        },
        results=lambda h: {
            "cooled_to": h["surface"][-1],
            "core": h["core"][-1],
            **{f"spacing_{n}": width / max(h[f"cracks_{n}"][-1], 1.0) for n in range(len(depths))},
            **({"spacing_0_over_least": width / max(h["cracks_0"][-1], 1.0) / least_energy()} if known else {}),
            **(
                {"length_over_least": h["dissipated"][-1] / (GC * width * least_length(time))}
                if points and plate and time >= 0.03
                else {}
            ),
        },
        expect={"core": pd.Expected(core, absolute=0.08 * (hot - WATER), source="series of a plate without cracks")},
        fields=[pd.displacement, pd.temperature, counted[0], *([] if points else [pd.heat_flux])],
        picture=pd.Picture(counted[0], ""),
    )
