"""Beside the local problem: python runs/bench/local.py [dim=2] [n=201] [repeats=3] [-petsc_option ...].

The bar of ``box.py`` without a horizon: bilinear (trilinear) finite elements of scikit-fem with as many nodes as there
are particles, solved by PETSc's CG with GAMG, rigid body motions as its near null space, to a relative residual of
1e-8; set-up and solve count, the assembly of the matrix does not. Of the solve at horizon 3.015 all counts: pattern,
tangent, preconditioner and iterations. Both in turns on one core, medians.
"""

import statistics
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))
import study

words = study.start("bench")

import numpy as np
import skfem
from box import case
from linear import RTOL, solve
from petsc4py import PETSc
from scipy.sparse import diags
from skfem.models.elasticity import lame_parameters, linear_elasticity

STRAIN = 0.01


def elements(dim, n, nu=0.3):
    """Return stiffness, load and places of the nodes: rows of prescribed displacements are those of a unit matrix."""
    axes = [np.arange(float(n))] * dim
    mesh = (skfem.MeshQuad if dim == 2 else skfem.MeshHex).init_tensor(*axes)
    basis = skfem.Basis(mesh, skfem.ElementVector(skfem.ElementQuad1() if dim == 2 else skfem.ElementHex1()))
    order = np.lexsort(mesh.p)  # nodes that are neighbours in space are near in memory
    degrees = basis.nodal_dofs[:, order].T.ravel()
    K = linear_elasticity(*lame_parameters(1.0, nu)).assemble(basis).tocsr()[degrees][:, degrees]
    x = mesh.p[:, order].T
    held, u = np.zeros((n**dim, dim), dtype=bool), np.zeros((n**dim, dim))
    held[x[:, 0] == 0.0], held[x[:, 0] == n - 1.0, 0] = True, True
    u[x[:, 0] == n - 1.0, 0] = STRAIN * n
    free = diags(np.where(held.ravel(), 0.0, 1.0))
    stiffness = (free @ K @ free + diags(np.where(held.ravel(), 1.0, 0.0))).tocsr()
    stiffness.eliminate_zeros()
    return stiffness, free @ (-(K @ u.ravel())), x


def solve_elements(K, b, x):
    """Return seconds of set-up and solve, and iterations, of CG with GAMG."""
    comm, dim = PETSc.COMM_SELF, x.shape[1]
    A = PETSc.Mat().createAIJ(K.shape, bsize=dim, csr=(K.indptr, K.indices, K.data), comm=comm)
    A.setOption(PETSc.Mat.Option.SPD, True)
    places = PETSc.Vec().createWithArray(x.ravel(), bsize=dim, comm=comm)
    A.setNearNullSpace(PETSc.NullSpace().createRigidBody(places))
    ksp = PETSc.KSP().create(comm=comm)
    ksp.setType("cg")
    ksp.getPC().setType("gamg")
    ksp.setOptionsPrefix("local_")
    ksp.setFromOptions()
    ksp.setTolerances(rtol=RTOL)
    ksp.setOperators(A)
    load, u = A.createVecRight(), A.createVecLeft()
    load.array = b
    before = time.perf_counter()
    ksp.setUp()
    between = time.perf_counter()
    ksp.solve(load, u)
    seconds = between - before, time.perf_counter() - between
    if ksp.getConvergedReason() < 0:
        raise SystemExit("The local problem did not converge.")
    return *seconds, ksp.getIterationNumber()


def main():
    given = {"dim": 2, "n": 201, "repeats": 3} | {name: int(value) for name, value in (w.split("=") for w in words)}
    dim, n = given["dim"], given["n"]
    local = elements(dim, n)
    ours, theirs = [], []
    for _ in range(given["repeats"]):
        ours.append(solve(case(dim=dim, n=n, horizon=3.015), "matfree"))
        theirs.append(solve_elements(*local))
    set_up, iterations = (statistics.median(run[k] for run in theirs) for k in (0, 1))
    ratio = statistics.median(one["scratch"] / sum(other[:2]) for one, other in zip(ours, theirs, strict=True))
    scratch = statistics.median(run["scratch"] for run in ours)
    print(f"{n**dim} nodes and particles in {dim}D, one core, to {RTOL:g}:")
    print(f"  elements, GAMG: set-up {set_up:.2f} s, solve {iterations:.2f} s, {theirs[0][2]} iterations")
    print(f"  horizon 3.015: {scratch:.2f} s, {ours[0]['linear_iterations']} iterations")
    print(f"  nonlocal / local {ratio:.2f}")


if __name__ == "__main__":
    main()
