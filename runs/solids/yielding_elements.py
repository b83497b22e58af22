"""The bar that necks and Cook's membrane by finite elements: python runs/solids/yielding_elements.py.

Writes ``yielding_elements.json``: of each body the numbers of the finest mesh, and by how much half as many elements
each way differ, relatively. Biquadratic quadrilaterals (``elements.py``). Units as in the cases.
"""

import json
import sys
from pathlib import Path

import numpy as np
from skfem import FacetBasis, MeshQuad

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parent.parent / "convergence")]
import cook_elements as membrane
import elements
import yielding_cook as cook
import yielding_neck as neck

STORE = Path(__file__).with_suffix(".json")


def necking(n, steps=30):
    """Return the numbers of the bar with n elements over its half width."""
    mesh = MeshQuad.init_tensor(np.linspace(0.0, neck.LENGTH, 3 * n + 1), np.linspace(0.0, neck.WIDTH, n + 1))
    body = elements.Body(mesh, neck.E, neck.NU, elements.linear(neck.YIELD, neck.HARDENING), False)
    x, vertical = body.x, body.vertical
    grip = np.isclose(x[0], neck.LENGTH)
    held = grip | (vertical & np.isclose(x[1], 0.0)) | (~vertical & np.isclose(x[0], 0.0))
    values = np.where(grip & ~vertical, neck.PULL, 0.0)[held]
    march = body.march(np.flatnonzero(held), values, 0.0, steps)
    pulls = [float(body.force[grip & ~vertical].sum()) for _ in march]
    corner = vertical & np.isclose(x[0], 0.0) & np.isclose(x[1], neck.WIDTH)
    return {"peak": max(pulls), "end": pulls[-1], "thinning": -float(body.u[corner][0])}


def cooking(n, steps=10):
    """Return the numbers of the membrane with n x n elements."""
    mesh = MeshQuad.init_tensor(membrane.line(n), membrane.line(n))
    mesh = MeshQuad(membrane.places(mesh.p.T).T, mesh.t)
    body = elements.Body(mesh, cook.E, cook.NU, elements.linear(cook.YIELD, cook.HARDENING), False)
    x = body.x
    right = mesh.facets_satisfying(lambda x: np.isclose(x[0], membrane.LENGTH))
    load = elements.shear.assemble(FacetBasis(mesh, body.basis.elem, facets=right), along=cook.SHEAR)
    held = np.flatnonzero(np.isclose(x[0], 0.0))
    for _ in body.march(held, np.zeros(len(held)), load, steps):
        pass
    corner = body.vertical & np.isclose(x[0], membrane.LENGTH) & np.isclose(x[1], 60.0)
    return {"tip": float(body.u[corner][0])}


def main():
    """Write the numbers."""
    found = {}
    for name, solve, sizes in (("neck", necking, (6, 12)), ("cook", cooking, (20, 40))):
        coarse, fine = (solve(n) for n in sizes)
        change = {key: coarse[key] / fine[key] - 1.0 for key in fine}
        found[name] = {key: float(f"{value:.6g}") for key, value in fine.items()} | {
            "elements": sizes[1], "change": {key: float(f"{value:.2g}") for key, value in change.items()}
        }  # fmt: skip
        print(name, found[name], flush=True)
    STORE.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
