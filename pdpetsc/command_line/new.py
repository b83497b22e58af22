"""Write a commented case as a starting point.

usage: python -m pdpetsc new FILE.py

Writes a case with comments, a bar under tension, for your own changes. It runs as it is.
"""

from __future__ import annotations

from pathlib import Path

from pdpetsc.command_line.arguments import Arguments
from pdpetsc.errors import CaseError

CASE = '''"""A bar that is clamped at one end and pulled at the other, to begin with.

    mpirun -n 2 python -m pdpetsc {name} dx=0.5 -snes_monitor

Lengths in mm, forces in N, stresses in MPa; any consistent units will do.
"""

import pdpetsc as pd

LENGTH, HEIGHT = 20.0, 4.0


def case(dx=1.0, stress=100.0):
    """Return the case; every parameter has a default and may be given as NAME=VALUE on the command line."""
    return pd.Case(
        # Particles on a lattice, up to the surface; pd.MeshNodes and pd.Mesh("part.msh") are those of a mesh.
        particles=pd.LatticeNodes((0.0, 0.0), (LENGTH, HEIGHT), dx),
        # Finite strain; pd.LinearElastic for small strain, pd.J2 for metals, pd.BondBased for forces along bonds.
        material=pd.Hencky(E=200e3, nu=0.3, plane="stress"),
        # Sides of the body are "-x", "+x", "-y" ...; regions such as pd.region.Slab("x", low=15.0) choose particles.
        # pd.Roller("-y") lets a side slide, pd.Displacement("+x", x=0.1) moves it.
        conditions=[pd.Clamp("-x"), pd.Traction("+x", x=stress)],
        # Optional. horizon: 2.015 spacings here by default, for every particle a bond to all others within it.
        # scheme: pd.SubHorizons() by default; pd.Correspondence() takes a control such as pd.Silling(0.5).
        # The bar tears with damage=pd.PointDamage(pd.softening.Linear(), Gc=10.0, strength=400.0).
        # Four load steps from nothing to all of it.
        steps=pd.Steps(4),
        # What is written at every step, for ParaView and pd.open.
        fields=[pd.displacement, pd.stress],
        # Numbers of every step, in history.csv.
        history={{"u_end": pd.Mean(pd.displacement, "x", "+x"), "force": pd.Reaction("x", "-x")}},
        # What the run prints; expect={{"u_end": pd.Expected(...)}} and --check compare it with what is known.
        results=lambda history: {{"u_end": history["u_end"][-1]}},
        picture=pd.Picture(pd.stress, "xx"),
    )
'''


def new(path: Path) -> Path:
    """Write a commented case as a starting point.

    Raises
    ------
    CaseError
        The file exists, does not end in .py, or cannot be written.
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
    """Execute the command."""
    print(new(path))
    return 0
