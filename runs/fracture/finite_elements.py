"""The plate with a hole before damage against finite elements with nodes at the particles.

    python runs/fracture/finite_elements.py [nx ...]     # defaults: 30 60 120; needs scikit-fem

Bilinear quadrilaterals between the particles, small strain, plane strain, the same supports, a pull of 1e-4 of the
length. Prints, for every number of particles and two schemes, the largest difference of the displacements over the
largest displacement, and the reaction over that of the elements.
"""

import dataclasses
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))
import study

WORDS = study.start("fracture", "plates")

import h5py  # noqa: E402
import numpy as np  # noqa: E402
import plate_with_hole  # noqa: E402
from skfem import Basis, ElementQuad1, ElementVector, MeshQuad, asm, condense, solve  # noqa: E402
from skfem.models.elasticity import lame_parameters, linear_elasticity  # noqa: E402

import pdpetsc as pd  # noqa: E402

PULL = 0.5e-4 * plate_with_hole.LENGTH


def mesh_of(x, dx):
    """Return quadrilaterals between particles (n, 2) that are all there, with these as nodes."""
    cell = np.rint((x - x.min(axis=0)) / dx).astype(int)
    number = {tuple(place): i for i, place in enumerate(cell)}
    around = [[(a, b), (a + 1, b), (a + 1, b + 1), (a, b + 1)] for a, b in cell.tolist()]
    return MeshQuad(x.T, np.array([[number[p] for p in four] for four in around if all(p in number for p in four)]).T)


def elements(x, dx, held, E=210e3, nu=0.33):
    """Return displacements (n, 2) and the force on the right end per thickness."""
    basis = Basis(mesh_of(x, dx), ElementVector(ElementQuad1()))
    K = asm(linear_elasticity(*lame_parameters(E, nu)), basis)
    u = np.zeros(basis.N)
    fixed = np.zeros(basis.N, dtype=bool)
    for axis, nodes, value in held:
        dofs = basis.nodal_dofs[axis, nodes]
        u[dofs], fixed[dofs] = value, True
    u = solve(*condense(K, np.zeros(basis.N), x=u, D=np.flatnonzero(fixed)))
    right = basis.nodal_dofs[0, held[-2][1]]
    return u[basis.nodal_dofs].T, float((K @ u)[right].sum())


def main():
    folder = study.folder_for([], "out/fracture_elements")
    for nx in [int(word) for word in WORDS] or [30, 60, 120]:
        for scheme, G in (("correspondence", 0.5), ("sub_horizons", 0.0)):
            case = plate_with_hole.case(nx=nx, law="none", pull=PULL, scheme=scheme, G=G, steps=1)
            case = dataclasses.replace(case, picture=None, history={"force": case.history["force"]})
            found = pd.run(dataclasses.replace(case, results=lambda h: {"force": h["force"][-1]}), folder, quiet=True)
            with h5py.File(folder / "fields.h5") as file:
                last = sorted(name for name in file if name.startswith("step_"))[-1]
                x, moved = file["particles/position"][:, :2], file[last]["displacement"][:, :2]
            dx = plate_with_hole.LENGTH / nx
            left, right = x[:, 0] < 0.0, x[:, 0] > plate_with_hole.LENGTH
            ends = [(0, left, -PULL), (1, left, 0.0), (0, right, PULL), (1, right, 0.0)]
            u, force = elements(x, dx, [(axis, np.flatnonzero(which), value) for axis, which, value in ends])
            worst = np.abs(moved - u).max() / np.abs(u).max()
            print(f"{nx:4d} {scheme:15s} displacement {worst:8.2%}  reaction {found['force'] / force:7.3f}")


if __name__ == "__main__":
    main()
