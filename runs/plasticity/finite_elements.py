"""Elastic-plastic plate by finite elements, for comparison: python runs/plasticity/finite_elements.py.

Writes ``finite_elements.json``. Biquadratic quadrilaterals with 3 x 3 Gauss points (``runs/solids/elements.py``) on
a quarter of the plate: elements know no difference between symmetry lines and the whole. Units mm, N.
"""

import json
import sys
from pathlib import Path

import numpy as np
from skfem import ElementQuad1, LinearForm, MeshQuad

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent), str(HERE.parent / "solids")]
import study

study.start("plasticity")

import elements
import plate

STORE = Path(__file__).with_suffix(".json")


def nodal(basis, values):
    """Return values at Gauss points (n,) averaged at the corners of the elements."""
    scalar = basis.with_element(ElementQuad1())
    values = values.reshape(basis.dx.shape)
    weight = LinearForm(lambda v, w: v).assemble(scalar)
    return LinearForm(lambda v, w: w.field * v).assemble(scalar, field=values) / weight


def rounded(values):
    return [float(f"{v:.7g}") for v in values]


def pulled_plate(h, steps=40):
    """Return the history of force and mean plastic strain, and stress and plastic strain along the x axis."""
    side = np.linspace(0.0, plate.SIZE, round(plate.SIZE / h) + 1)
    mesh = MeshQuad.init_tensor(side, side)
    middle = mesh.p[:, mesh.t].mean(axis=1)
    mesh = mesh.remove_elements(np.flatnonzero((middle < plate.OPENING).all(axis=0)))
    body = elements.Body(mesh, plate.E, plate.NU, elements.linear(plate.YIELD, plate.HARDENING), False)
    x, vertical, weight = body.x, body.vertical, body.weight.ravel()
    top = vertical & np.isclose(x[1], plate.SIZE)
    held = top | (vertical & np.isclose(x[1], 0.0)) | (~vertical & np.isclose(x[0], 0.0))
    found = {"t": [0.0], "force": [0.0], "mean_plastic": [0.0]}
    for t in body.march(np.flatnonzero(held), np.where(top, plate.PULL, 0.0)[held], 0.0, steps):
        found["t"].append(t)
        # The whole plate has twice the force of its quarter.
        found["force"].append(2.0 * float(body.force[top].sum()))
        found["mean_plastic"].append(float(body.law.alpha @ weight / weight.sum()))
    F = body.gradient(body.u)
    # The state was kept before, so nothing flows anew.
    _, tau, _, alpha = body.law.respond(F)
    nodes = np.flatnonzero(np.isclose(mesh.p[1], 0.0))
    nodes = nodes[np.argsort(mesh.p[0, nodes])]
    found["x"] = mesh.p[0, nodes]
    found["stress"] = nodal(body.basis, tau[:, 1, 1] / np.linalg.det(F))[nodes]
    found["plastic"] = nodal(body.basis, alpha)[nodes]
    return {name: values if name == "t" else rounded(values) for name, values in found.items()}


def main():
    coarse, fine = pulled_plate(4.0), pulled_plate(2.0)
    for name in ("force", "mean_plastic"):
        fine[f"{name}_change_from_twice_the_mesh_size"] = fine[name][-1] / coarse[name][-1] - 1.0
    twice = pulled_plate(4.0, 80)
    fine["force_change_from_half_the_steps"] = twice["force"][-1] / coarse["force"][-1] - 1.0
    STORE.write_text(json.dumps({"plate": fine}) + "\n")
    print({name: value for name, value in fine.items() if name not in ("x", "stress", "plastic")})


if __name__ == "__main__":
    main()
