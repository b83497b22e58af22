"""Write a commented case to begin with.

usage: python -m pdpetsc new FILE.py

Writes a case with comments, a bar that is pulled, to be changed into yours. It runs as it is.
"""

from __future__ import annotations

from pathlib import Path

from pdpetsc.command_line.arguments import Arguments
from pdpetsc.errors import CaseError

CASE = '''"""A bar that is pulled, to begin with.

    mpirun -n 2 python -m pdpetsc {name} dx=0.5 -snes_monitor

Lengths in mm, forces in N, stresses in MPa; any consistent units will do.
"""

import pdpetsc as pd

LENGTH, HEIGHT = 20.0, 4.0


def case(dx=1.0, strain=0.01):
    """Return the case; every parameter has a default and may be given as NAME=VALUE on the command line."""
    # Regions choose particles: a slab between two planes, a ball, points with a function of place.
    left = pd.region.Slab("x", high=dx)
    right = pd.region.Slab("x", low=LENGTH - dx)
    return pd.Case(
        # Particles on a lattice; pd.Mesh("part.msh") and pd.MeshNodes take those of a mesh.
        particles=pd.Lattice((0.0, 0.0), (LENGTH, HEIGHT), dx),
        # Every particle has a bond to all others within the horizon. 3.015 spacings are for what fails.
        horizon=1.5 * dx,
        # Finite strain; pd.LinearElastic for small strain, pd.J2 for metals, pd.BondBased for forces along bonds.
        material=pd.Hencky(E=200e3, nu=0.3, plane="stress"),
        # Several gradients a particle, without zero-energy modes; or pd.Correspondence() with control=pd.Silling(0.5).
        scheme=pd.SubHorizons(),
        # It tears with a scheme pd.Correspondence(), control=pd.Silling(2.0), a horizon of 3.015 * dx, and
        # damage=pd.PointDamage(pd.softening.Linear(), Gc=10.0, strength=400.0, protected=left | right).
        # Components that are not given are free.
        conditions=[
            pd.Displacement(left, x=0.0),
            pd.Displacement(pd.region.Nearest((0.0, 0.0)), y=0.0),
            pd.Displacement(right, x=strain * (LENGTH - dx)),
        ],
        # Four load steps from nothing to all of it.
        steps=pd.Steps(4),
        # What goes to the files at every step, for ParaView and pd.open.
        fields=[pd.displacement, pd.stress],
        # One number a step, in history.csv.
        history={{"force": pd.Reaction("x", right)}},
        # What the run prints; expect={{"force": pd.Expected(...)}} and --check compare it with what is known.
        results=lambda history: {{"force": history["force"][-1]}},
        picture=pd.Picture(pd.stress, "xx"),
    )
'''


def new(path: Path) -> Path:
    """Write a case to begin with.

    Raises
    ------
    CaseError
        The file is there already, does not end in .py, or cannot be written.
    """
    if path.suffix != ".py":
        raise CaseError(f"A case file ends in .py, and {path} does not.")
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(CASE.format(name=path.name))
    except FileExistsError:
        raise CaseError(f"{path} is there already; give another name.") from None
    except OSError as error:
        raise CaseError(f"Cannot write {path}: {error.strerror or error}.") from None
    return path


def run(path: Path, arguments: Arguments) -> int:
    """Carry out the command."""
    print(new(path))
    return 0
