"""Elastic-plastic Cook's membrane by finite elements: python runs/solids/cook_plastic_elements.py.

Writes ``cook_plastic_elements.json``: the rise of the tip at every step time, on a fine mesh, with its change from half
as many elements each way. Units mm, GPa.
"""

import json
import sys
from pathlib import Path

import numpy as np
from skfem import FacetBasis, MeshQuad

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parent.parent)]
import study

study.start("solids", "convergence")

import cook_elements as membrane
import cook_plastic as cook
import elements

STORE = Path(__file__).with_suffix(".json")


def hardening(alpha):
    saturating = np.exp(-cook.RATE * alpha)
    rise = cook.SATURATED - cook.YIELD
    return cook.YIELD + cook.LINEAR * alpha + rise * (1.0 - saturating), cook.LINEAR + rise * cook.RATE * saturating


def tip(n, steps):
    """Return step times and rises of the tip with n x n elements, finer towards the sides."""
    mesh = MeshQuad.init_tensor(membrane.line(n), membrane.line(n))
    body = elements.Body(MeshQuad(membrane.places(mesh.p.T).T, mesh.t), cook.E, cook.NU, hardening, False)
    x, vertical = body.x, body.vertical
    held = np.flatnonzero(np.isclose(x[0], 0.0))
    right = FacetBasis(body.mesh, body.basis.elem, facets=body.mesh.facets_satisfying(lambda p: np.isclose(p[0], 48.0)))
    load = elements.shear.assemble(right, along=cook.SHEAR)
    corner = np.flatnonzero(vertical & np.isclose(x[0], 48.0) & np.isclose(x[1], 60.0))[0]
    found = {"t": [0.0], "tip": [0.0]}
    for t in body.march(held, np.zeros(len(held)), load, steps):
        found["t"].append(t)
        found["tip"].append(float(f"{body.u[corner]:.7g}"))
    return found


def main():
    coarse, fine = tip(12, 40), tip(24, 40)
    fine["change_from_twice_the_mesh_size"] = fine["tip"][-1] / coarse["tip"][-1] - 1.0
    STORE.write_text(json.dumps(fine) + "\n")
    print(fine["tip"][-1], fine["change_from_twice_the_mesh_size"])


if __name__ == "__main__":
    main()
