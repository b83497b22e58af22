"""Cantilever by finite elements, for comparison: python runs/beams/finite_elements.py writes finite_elements.json.

Biquadratic quadrilaterals (scikit-fem), the Hencky material of ``pdpetsc``, full Newton. The force acts as a body force
on the cell of the loaded particle and the displacement is its mean over that cell: a force on a point would have no
limit. The clamp has u_x = 0 on the end and u_y = 0 at its middle, as the lattice has. Units m, N.
"""

import json
import sys
from pathlib import Path

import petsc4py

petsc4py.init(["finite_elements"])
sys.path.insert(0, str(Path(__file__).parent))

import cantilever
import numpy as np
from scipy.sparse.linalg import splu
from skfem import Basis, BilinearForm, ElementQuad2, ElementVector, LinearForm, MeshQuad

import pdpetsc as pd

STORE = Path(__file__).with_suffix(".json")
# Load steps, quadratically spaced: the beam is softest at the start.
STEPS = 12


def pointwise(material, H):
    """Return P and A, components first as scikit-fem has them, for grad u (2, 2, cells, points)."""
    kernels, constants = material.kernels(2), material.constants(2)
    F = np.ascontiguousarray(np.moveaxis(H, (0, 1), (-2, -1)).reshape(-1, 2, 2)) + np.eye(2)
    P, A, every = np.empty_like(F), np.empty((*F.shape, 2, 2)), np.arange(len(F))
    kernels.stress(F, every, constants, P)
    kernels.tangent(F, every, constants, A)
    P, A = (values.reshape(*H.shape[2:], *values.shape[1:]) for values in (P, A))
    return np.moveaxis(P, (-2, -1), (0, 1)), np.moveaxis(A, (-4, -3, -2, -1), (0, 1, 2, 3))


@LinearForm
def internal(v, w):
    return np.einsum("imep,imep->ep", w.P, v.grad)


@BilinearForm
def tangent(u, v, w):
    dP = np.einsum("imknep,knep->imep", w.A, u.grad)
    return np.einsum("imep,imep->ep", v.grad, dP)


def solve(ny, plane, per_cell):
    """Return w / L and u / L with ``per_cell`` elements along a side of a particle's cell."""
    dx = cantilever.DEPTH / ny
    length, depth = cantilever.LENGTH, cantilever.DEPTH
    columns, rows = round(length / dx) * per_cell + 1, ny * per_cell + 1
    mesh = MeshQuad.init_tensor(np.linspace(0.0, length, columns), np.linspace(-depth / 2, depth / 2, rows))
    basis = Basis(mesh, ElementVector(ElementQuad2()), intorder=4)
    x = basis.doflocs
    vertical = np.zeros(basis.N, dtype=bool)
    vertical[basis.split_indices()[1]] = True
    clamp = np.isclose(x[0], 0.0)
    fixed = clamp & (~vertical | np.isclose(x[1], 0.0, atol=1e-9 * dx))
    if not (fixed & vertical).any():
        fixed |= clamp & vertical & (np.abs(x[1]) == np.abs(x[1][clamp & vertical]).min())
    free = np.flatnonzero(~fixed)

    def inside(w):
        return (w.x[0] > length - dx) & (np.abs(w.x[1]) < dx / 2)

    load = LinearForm(lambda v, w: v[1] * inside(w)).assemble(basis) / dx**2
    load_x = LinearForm(lambda v, w: v[0] * inside(w)).assemble(basis) / dx**2
    material = pd.Hencky(E=cantilever.E, nu=cantilever.NU, plane=plane)
    u = np.zeros(basis.N)
    for step in range(1, STEPS + 1):
        force = -cantilever.FORCE * (step / STEPS) ** 2 * load
        for _ in range(40):
            P, A = pointwise(material, np.asarray(basis.interpolate(u).grad))
            residual = (internal.assemble(basis, P=P) - force)[free]
            if np.linalg.norm(residual) < 1e-9 * np.linalg.norm(force):
                break
            K = tangent.assemble(basis, A=A).tocsc()[free][:, free]
            u[free] -= splu(K.tocsc()).solve(residual)
        else:
            sys.exit(f"Newton did not converge in step {step}.")
    return {"w_over_L": -float(load @ u) / length, "u_over_L": -float(load_x @ u) / length}


def main():
    found = {}
    for ny in (5, 9, 15):
        for plane in ("stress", "strain"):
            coarse, fine = (solve(ny, plane, per_cell) for per_cell in (1, 2))
            change = max(abs(fine[name] - coarse[name]) for name in fine)
            found[f"ny={ny} plane={plane}"] = fine | {"change_from_twice_the_mesh_size": change}
            print(f"ny={ny} plane={plane}", found[f"ny={ny} plane={plane}"], flush=True)
    STORE.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
