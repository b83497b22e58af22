"""Necking bar by axisymmetric finite elements, for comparison: python runs/solids/necking_elements.py.

Writes ``necking_elements.json``: the force of the bar and the radius of its neck at every elongation, for the bar as
``necking.py`` has it, with and without its waist, on two meshes. Units mm, N.
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
import necking

STORE = Path(__file__).with_suffix(".json")
# The smallest step over the declared one.
LEAST = 1.0 / 64.0


def hardening(alpha):
    saturating = np.exp(-necking.RATE * alpha)
    y = necking.YIELD + necking.LINEAR * alpha + necking.SATURATION * (1.0 - saturating)
    return y, necking.LINEAR + necking.SATURATION * necking.RATE * saturating


def bar(across, along, waist, steps, end=necking.END, ends="free"):
    """Return elongation, force and radius at the middle, a quarter of the section of the bar being meshed."""
    radius = np.linspace(0.0, 1.0, across + 1)
    # Elements a fifth as long at the neck as at the end.
    grow = np.linspace(0.0, 1.0, along + 1)
    height = 0.5 * necking.LENGTH * (0.2 * grow + 0.8 * grow**2)
    mesh = MeshQuad.init_tensor(radius, height)
    p = mesh.p.copy()
    p[0] *= necking.radius(p[1], waist)
    body = elements.Body(MeshQuad(p, mesh.t), necking.E, necking.NU, hardening, True)
    x, vertical = body.x, body.vertical
    top = np.isclose(x[1], 0.5 * necking.LENGTH)
    fixed = (vertical & np.isclose(x[1], 0.0)) | (~vertical & np.isclose(x[0], 0.0)) | (vertical & top)
    if ends == "clamped":
        fixed |= top
    held = np.flatnonzero(fixed)
    edge = np.flatnonzero(~vertical & np.isclose(x[1], 0.0) & np.isclose(x[0], x[0][np.isclose(x[1], 0.0)].max()))
    found = {"elongation": [0.0], "force": [0.0], "radius": [float(x[0][edge[0]])]}
    t, dt, last = 0.0, 1.0 / steps, 0.0
    while t < 1.0 - 1e-9:
        now = min(t + dt, 1.0)
        values = np.where(vertical & top, 0.5 * end * now, 0.0)[held]
        if not body.step(held, values, ratio=(now - t) / last if last else 0.0):
            dt *= 0.5
            if dt < LEAST / steps:
                sys.exit(f"Newton's method did not converge after an elongation of {end * t:g} mm.")
            continue
        last, t, dt = now - t, now, min(1.0 / steps, 1.5 * dt)
        found["elongation"].append(end * t)
        found["force"].append(float(body.force[vertical & top].sum()))
        found["radius"].append(float(x[0][edge[0]] + body.u[edge[0]]))
    return found


def rounded(found):
    return {name: [float(f"{value:.7g}") for value in values] for name, values in found.items()}


def main():
    stored = {
        "perfect": rounded(bar(2, 4, 1.0, 70)),
        "waist_coarse": rounded(bar(5, 16, necking.WAIST, 100)),
        "waist": rounded(bar(10, 32, necking.WAIST, 100)),
    }
    STORE.write_text(json.dumps(stored) + "\n")
    for name, found in stored.items():
        peak = int(np.argmax(found["force"]))
        print(name, found["force"][peak], found["elongation"][peak], found["force"][-1], found["radius"][-1])


if __name__ == "__main__":
    main()
