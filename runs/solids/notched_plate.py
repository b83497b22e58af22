"""Double-edge notched plate in plane stress, pulled until its ligament flows. Units mm, GPa, kN.

10 mm wide and 30 mm long, with sharp notches of 2.5 mm from both sides halfway, of steel with linear hardening; the
ends are pulled apart by 2 x 0.3 mm and may contract. A quarter between mirror planes, ``n`` particles across its 5 mm;
the notch lies on a plane. ``force`` on the whole width of 1 mm of thickness at the end, ``force_error`` and
``half_error``, at the end and halfway, against finite elements of the same law (``notched_plate_elements.py``).
"""

import json
from functools import lru_cache
from pathlib import Path

import numpy as np

import pdpetsc as pd

WIDTH, LENGTH, LIGAMENT, PULL = 5.0, 15.0, 2.5, 0.3
E, NU, YIELD, HARDENING = 206.9, 0.29, 0.45, 2.0


@lru_cache
def reference():
    """Return pulls and forces of the finite elements."""
    return json.loads(Path(__file__).with_name("notched_plate_elements.json").read_text())


def errors(history):
    """Return the force at the end and its errors at the end and halfway."""
    known, force = reference(), 2.0 * np.asarray(history["force"])
    exact = np.interp(np.asarray(history["t"]), known["t"], known["force"])
    half = len(force) // 2
    return {
        "force": force[-1],
        "force_error": force[-1] / exact[-1] - 1.0,
        "half_error": force[half] / exact[half] - 1.0,
    }


def case(n=10, horizon=2.015, scheme="correspondence", G=0.5, following=True, steps=20):
    """Return the case."""
    dx = WIDTH / n
    control = pd.Silling(G) if G else None
    top = pd.region.Slab("y", low=LENGTH - dx)
    return pd.Case(
        particles=pd.Lattice((0.0, 0.0), (WIDTH, LENGTH), dx),
        symmetry=[pd.Symmetry("x"), pd.Symmetry("y")],
        cracks=[pd.Segment((LIGAMENT, 0.0), (WIDTH + dx, 0.0))],
        horizon=horizon * dx,
        material=pd.J2(E=E, nu=NU, plane="stress", yield_stress=YIELD, hardening=HARDENING),
        scheme=pd.choose("scheme", scheme, pd.SCHEMES),
        control=pd.TangentScaled(control) if control and following else control,
        conditions=[pd.Displacement(top, y=PULL * (1.0 - 0.5 * dx / LENGTH))],
        steps=pd.Steps(steps),
        history={"force": pd.Reaction("y", top)},
        results=errors,
        expect={
            "force_error": pd.Expected(0.0, absolute=0.03, source="finite elements (notched_plate_elements.py)"),
        },
        fields=[pd.displacement, pd.stress, pd.plastic_strain],
        picture=pd.Picture(pd.plastic_strain, "", scale=5.0),
    )
