"""A closed crack in a wide plate under pressure and shear slides against friction, for several cells over its length.

Square of side 10, E = 1, nu = 0, plane strain, with a crack of length 2 ``a`` = 2 in its middle at ``angle`` degrees
(``cracks`` of ``pd.PointDamage``). Pressures across and along the crack are 0.5, its shear 0.5 per load; the plate is
loaded to 1e-3. The closed form for an infinite plate: the faces slide by 4 (tau - friction p) / E' sqrt(a^2 - x^2), and
the work of the load rises by half of the shear stress times the area of this slip.

Printed: that rise of the work over the exact one, from the plate with and without the crack.
python runs/fracture/sliding_crack.py angle=45 friction=0.3
"""

import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

import pdpetsc as pd

SIDE, HALF, LOAD, STRESS = 10.0, 1.0, 1e-3, 0.5


def case(n=60, angle=0.0, friction=0.3, horizon=3.015, G=2.0):
    dx, end = SIDE / n, 0.5 * SIDE
    along = np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle))])
    normal = np.array([-along[1], along[0]])
    stress = -STRESS * LOAD * (np.eye(2) + np.outer(normal, along) + np.outer(along, normal))
    loads = [
        pd.Traction(f"{sign}{'xy'[axis]}", x=factor * stress[0, axis], y=factor * stress[1, axis])
        for axis in range(2)
        for sign, factor in (("-", -1.0), ("+", 1.0))
    ]
    left = pd.region.Box((-end, -0.3 * end), (-0.8 * end, 0.3 * end))
    right = pd.region.Box((0.8 * end, -0.3 * end), (end, 0.3 * end))
    crack = pd.Segment(tuple(-HALF * along), tuple(HALF * along))
    return pd.Case(
        particles=pd.Lattice((-end, -end), (end, end), dx),
        horizon=horizon * dx,
        material=pd.LinearElastic(E=1.0, nu=0.0),
        scheme=pd.Correspondence(),
        control=pd.Silling(G),
        # Nothing fails further.
        damage=pd.PointDamage(
            pd.softening.Linear(), Gc=1.0, strength=0.1, cracks=[crack], split=pd.split.NoTension(friction=friction)
        ),
        conditions=[*loads, pd.PointSupport(left, x=0.0, y=0.0), pd.PointSupport(right, y=0.0)],
        steps=pd.Steps(2),
        history={"work": pd.ExternalWork()},
        fields=[],
    )


def sliding(**words):
    """Return the rise of the work by the crack over that of the closed form."""
    cracked = case(**words)
    with tempfile.TemporaryDirectory() as folder:
        work = [
            pd.run(one, Path(folder) / name).history["work"][-1]
            for name, one in (("cracked", cracked), ("intact", replace(cracked, damage=None)))
        ]
    shear = STRESS * LOAD * (1.0 - words.get("friction", 0.3))
    return (work[0] - work[1]) / (0.5 * STRESS * LOAD * 2.0 * np.pi * shear * HALF**2)


if __name__ == "__main__":
    given = {name: float(value) for name, _, value in (word.partition("=") for word in sys.argv[1:])}
    for n in (60, 120, 240):
        print(f"| {n // 5} cells over the crack | {sliding(**{**given, 'n': n}):.3f} |", flush=True)
