"""A tensile bar with wide ends from a mesh of hexahedra, pulled to a strain in four steps.

    mpirun -n 2 python -m pdpetsc runs/dog_bone/dog_bone.py -o out/dog_bone

101 x 25 x 5 cells, one particle each, some 67 neighbours: of the size of the tensile bar that other codes show implicit
steps on. The mesh is written to ``mesh`` on the first run and read from there; any other mesh of a bar along x will do.
The result is the force over that of a bar of the narrow section alone, which the wide ends make somewhat stiffer.
"""

import os
import tempfile
from pathlib import Path

import meshio
import numpy as np

import pdpetsc as pd

LENGTH, WIDE, NARROW, THICKNESS = 101.0, 25.0, 17.0, 5.0
GAUGE, FILLET = 45.0, 12.0
CELLS = (101, 25, 5)
E, NU = 200e3, 0.3


def width(x):
    """Return the width of the bar at x, with smooth transitions from the gauge to the ends."""
    beyond = np.clip((np.abs(x - 0.5 * LENGTH) - 0.5 * GAUGE) / FILLET, 0.0, 1.0)
    return NARROW + (WIDE - NARROW) * beyond**2 * (3.0 - 2.0 * beyond)


def write_mesh(path):
    """Write the hexahedra of the bar, whole or not at all: several ranks may do so at once."""
    axes = [np.linspace(0.0, 1.0, n + 1) for n in CELLS]
    s = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    x = LENGTH * s[:, 0]
    points = np.stack([x, (s[:, 1] - 0.5) * width(x), THICKNESS * s[:, 2]], axis=1)
    number = np.arange(len(points)).reshape([n + 1 for n in CELLS])
    corners = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
    i, j, k = np.indices(CELLS).reshape(3, -1)
    cells = np.stack([number[i + a, j + b, k + c] for a, b, c in corners], axis=1)
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(suffix=path.suffix, dir=path.parent)
    os.close(handle)
    meshio.write(name, meshio.Mesh(points, [("hexahedron", cells)]))
    os.replace(name, path)


def case(
    mesh="out/dog_bone.vtu", horizon=2.45, strain=0.01, steps=4, scheme="correspondence", G=0.5,
    weights="standard",
):  # fmt: skip
    """Return the case; the strain is the pull over the length of the bar."""
    path = Path(mesh)
    if not path.exists():
        write_mesh(path)
    left, right = pd.region.Slab("x", high=2.0), pd.region.Slab("x", low=LENGTH - 2.0)
    return pd.Case(
        particles=pd.Mesh(path),
        horizon=horizon,
        material=pd.Hencky(E=E, nu=NU),
        scheme=pd.choose("scheme", scheme, pd.SCHEMES),
        weights=pd.choose("weights", weights, pd.WEIGHTS),
        control=pd.Silling(G) if G else None,
        conditions=[
            pd.Displacement(left, x=0.0, y=0.0, z=0.0),
            pd.Displacement(right, x=strain * LENGTH, y=0.0, z=0.0),
        ],
        steps=pd.Steps(steps),
        history={"force": pd.Reaction("x", right)},
        fields=[pd.displacement, pd.stress],
        results=lambda history: {
            "force": history["force"][-1],
            "over_narrow_bar": history["force"][-1] / (E * np.log1p(strain) * NARROW * THICKNESS),
        },
        picture=pd.Picture(pd.stress, component="xx"),
    )
