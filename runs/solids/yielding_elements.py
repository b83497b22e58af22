"""The bar that necks and Cook's membrane by finite elements: python runs/solids/yielding_elements.py.

Writes ``yielding_elements.json``: of each body the numbers of the finest mesh, and by how much half as many elements
each way differ, relatively. Biquadratic quadrilaterals (scikit-fem), the law and its tangent as in
``runs/plasticity/finite_elements.py``, full Newton. Units as in the cases.
"""

import json
import sys
from pathlib import Path

import numpy as np
from scipy.sparse.linalg import splu

sys.path[:0] = [str(Path(__file__).parent.parent / name) for name in ("plasticity", "convergence")]
import cook_elements as membrane
import finite_elements as plastic
import yielding_cook as cook
import yielding_neck as neck
from skfem import Basis, ElementQuad2, ElementVector, MeshQuad

STORE = Path(__file__).with_suffix(".json")
TOLERANCE = 1e-8


def march(basis, constants, held, values, load, steps, watch):
    """Take prescribed values and a dead load to their full size; call ``watch(u, force)`` after every step."""
    cells, points = basis.dx.shape
    law = plastic.Law(*constants, cells * points)
    free = np.setdiff1d(np.arange(basis.N), held)
    u = np.zeros(basis.N)

    def forces(u):
        F = plastic.gradient(basis, u)
        P = np.moveaxis(law.respond(F)[0][:, :2, :2], 0, -1).reshape(2, 2, cells, points)
        return F, plastic.internal.assemble(basis, P=P)

    def stiff(F):
        return plastic.stiffness.assemble(basis, A=law.tangent(F).reshape(2, 2, 2, 2, cells, points)).tocsr()

    F, force = forces(u)
    K = stiff(F)
    for step in range(1, steps + 1):
        t = step / steps
        increment = np.zeros(basis.N)
        increment[held] = values * t - u[held]
        u = u + increment
        u[free] += splu(K[free][:, free].tocsc()).solve((load * t - force - K @ increment)[free])
        F, force = forces(u)
        for _ in range(60):
            residual = force - load * t
            size = np.linalg.norm(residual[free])
            if size < TOLERANCE * np.linalg.norm(residual[held]):
                break
            K = stiff(F)
            change = splu(K[free][:, free].tocsc()).solve(residual[free])
            for length in (1.0, 0.5, 0.25, 0.125, 0.0625):
                moved = u.copy()
                moved[free] -= length * change
                F, force = forces(moved)
                if np.linalg.norm((force - load * t)[free]) < size:
                    break
            u = moved
        else:
            sys.exit(f"Newton did not converge in step {step}.")
        law.keep(F)
        watch(u, force)
    return u


def both(basis):
    """Return which degrees of freedom are those of y."""
    vertical = np.zeros(basis.N, dtype=bool)
    for group in (basis.nodal_dofs, basis.facet_dofs, basis.interior_dofs):
        vertical[group[1]] = True
    return vertical


def necking(n, steps=30):
    """Return the numbers of the bar with n elements over its half width."""
    mesh = MeshQuad.init_tensor(np.linspace(0.0, neck.LENGTH, 3 * n + 1), np.linspace(0.0, neck.WIDTH, n + 1))
    basis = Basis(mesh, ElementVector(ElementQuad2()), intorder=5)
    x, vertical = basis.doflocs, both(basis)
    grip = np.isclose(x[0], neck.LENGTH)
    held = grip | (vertical & np.isclose(x[1], 0.0)) | (~vertical & np.isclose(x[0], 0.0))
    values = np.where(grip & ~vertical, neck.PULL, 0.0)[held]
    pulls = []
    constants = neck.E, neck.NU, neck.YIELD, neck.HARDENING
    watch = lambda u, force: pulls.append(float(force[grip & ~vertical].sum()))  # noqa: E731
    u = march(basis, constants, np.flatnonzero(held), values, np.zeros(basis.N), steps, watch)
    corner = vertical & np.isclose(x[0], 0.0) & np.isclose(x[1], neck.WIDTH)
    return {"peak": max(pulls), "end": pulls[-1], "thinning": -float(u[corner][0])}


def cooking(n, steps=10):
    """Return the numbers of the membrane with n x n elements."""
    mesh = MeshQuad.init_tensor(membrane.line(n), membrane.line(n))
    mesh = MeshQuad(membrane.places(mesh.p.T).T, mesh.t)
    basis = Basis(mesh, ElementVector(ElementQuad2()), intorder=5)
    x, vertical = basis.doflocs, both(basis)
    right = mesh.facets_satisfying(lambda x: np.abs(x[0] - membrane.LENGTH) < 1e-9)
    share = cook.SHEAR * np.abs(np.diff(mesh.p[1, mesh.facets[:, right]], axis=0)[0]) / 6.0
    load = np.bincount(basis.nodal_dofs[1, mesh.facets[:, right]].ravel(), np.tile(share, 2), basis.N)
    load[basis.facet_dofs[1, right]] = 4.0 * share
    held = np.flatnonzero(np.isclose(x[0], 0.0))
    constants = cook.E, cook.NU, cook.YIELD, cook.HARDENING
    u = march(basis, constants, held, np.zeros(len(held)), load, steps, lambda u, force: None)
    corner = vertical & np.isclose(x[0], membrane.LENGTH) & np.isclose(x[1], 60.0)
    return {"tip": float(u[corner][0])}


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
