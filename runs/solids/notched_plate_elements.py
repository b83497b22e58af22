"""Double-edge notched plate by finite elements in plane stress: python runs/solids/notched_plate_elements.py.

Writes ``notched_plate_elements.json``: the force on the whole width at every step time, on a fine mesh, with its change
from elements twice as large. Units mm, GPa, kN.
"""

import json
import sys
from pathlib import Path

import numpy as np
from skfem import MeshQuad

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parent.parent)]
import study

study.start("solids")

import elements
import notched_plate as plate

STORE = Path(__file__).with_suffix(".json")
STEPS = 20


def forces(n):
    """Return step times and forces with n elements across the quarter, smaller ones at the tip of the notch."""
    s = np.linspace(-1.0, 1.0, n + 1)
    x = plate.LIGAMENT * (1.0 + np.sign(s) * np.abs(s) ** 1.5)
    y = plate.LENGTH * np.linspace(0.0, 1.0, 2 * n + 1) ** 2
    hardening = elements.linear(plate.YIELD, plate.HARDENING)
    body = elements.Body(MeshQuad.init_tensor(x, y), plate.E, plate.NU, hardening, False, law=elements.PlaneStress)
    at, vertical = body.x, body.vertical
    top = vertical & np.isclose(at[1], plate.LENGTH)
    ligament = vertical & np.isclose(at[1], 0.0) & (at[0] < plate.LIGAMENT + 1e-9)
    middle = ~vertical & np.isclose(at[0], 0.0)
    held = np.flatnonzero(top | ligament | middle)
    found = {"t": [0.0], "force": [0.0]}
    for t in body.march(held, np.where(top, plate.PULL, 0.0)[held], 0.0, STEPS):
        found["t"].append(t)
        found["force"].append(float(f"{2.0 * body.force[top].sum():.7g}"))
    return found


def main():
    coarse, fine = forces(10), forces(20)
    fine["change_from_twice_the_mesh_size"] = fine["force"][-1] / coarse["force"][-1] - 1.0
    STORE.write_text(json.dumps(fine) + "\n")
    print(fine["force"], fine["change_from_twice_the_mesh_size"])


if __name__ == "__main__":
    main()
