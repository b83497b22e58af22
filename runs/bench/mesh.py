"""Time conforming weights, a solve, and linear elements: [mpirun -n 2] python runs/bench/mesh.py [name=value ...].

A block of E = 1 and nu = 0.25, n cells a side, whose inner nodes are moved by up to ``shake`` of a cell, held at one
end and pulled at the other. One particle sits in each cell, or at each node; correspondence with Silling's control and
conforming weights. Parameters and their defaults: kind=tetrahedra n=15 at=cells horizon=2.015 shake=0.2 repeats=1
json=; kind is tetrahedra, hexahedra or triangles, at is cells or nodes, the horizon is in spacings of a lattice with as
many particles, json is a file for what was measured. Prints, medians of ``repeats``, seconds of

``cloud``     particles and families
``weights``   what conforming weights take more than standard ones, until the body is ready to be solved
``model``     the body with its weights
``solve``     one linear solve to a relative residual of 1e-8: the tangent, its preconditioner, iterations
``elements``  linear elements on the same mesh, one rank: stiffness matrix, GAMG, iterations to the same residual

and ``weights_over_solve``, ``over_elements`` (cloud, model and solve over elements), ``bytes_a_particle``, the memory
that the process takes more once the system is solved. On several ranks elements are left out.
"""

import json
import sys
from contextlib import contextmanager
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))
import study

words = study.start("convergence")

import common
import linear
import numpy as np
from petsc4py import PETSc
from scipy.sparse import csr_matrix

import pdpetsc as pd
from pdpetsc.discrete.communicator import is_root, total, world
from pdpetsc.output.pace import memory_now
from pdpetsc.running.build import make_cloud, make_families, make_problem, rehearse

STRAIN, E, NU = 0.01, 1.0, 0.25
CELLS = {"tetrahedra": (3, common.simplices), "hexahedra": (3, common.cubes), "triangles": (2, common.simplices)}


def mesh(kind, n, shake):
    """Return nodes (k, dim) and cells of the unit block."""
    dim, cells = pd.choose("kind", kind, CELLS)
    return common.grid(n, shake, 0, (1.0,) * dim, cells)


def block_of(kind, n, at, horizon, shake, weights):
    """Return the block; of particles in cells a layer of cells is held, of those at nodes the end."""
    points, block = mesh(kind, n, shake)
    particles = pd.choose("at", at, {"cells": common.of_cells, "nodes": common.of_nodes})(points, block)
    dim, end = points.shape[1], (1.0 if at == "cells" else 0.1) / n
    return pd.Case(
        particles=particles,
        horizon=horizon * common.spacing_of(particles),
        material=pd.LinearElastic(E, NU),
        scheme=pd.Correspondence(),
        control=pd.Silling(0.5),
        weights=pd.choose("weights", weights, pd.WEIGHTS),
        conditions=[
            pd.Displacement(pd.region.Slab("x", high=end), **dict.fromkeys("xyz"[:dim], 0.0)),
            pd.Displacement(pd.region.Slab("x", low=1.0 - end), x=STRAIN),
        ],
    )


def elastic(dim):
    """Return the elastic moduli in Voigt's components, in plane strain in the plane."""
    lame, mu = E * NU / ((1.0 + NU) * (1.0 - 2.0 * NU)), 0.5 * E / (1.0 + NU)
    C = np.diag([2.0 * mu] * dim + [mu] * (dim * (dim - 1) // 2))
    C[:dim, :dim] += lame
    return C


def slopes_of(kind, dim):
    """Return derivatives of the shape functions at each point of integration (n, corners, dim), and its weight."""
    if kind != "hexahedron":
        return np.vstack([-np.ones(dim), np.eye(dim)])[None], 1.0 / (2.0 if dim == 2 else 6.0)
    below = np.array([(-1, -1, -1), (1, -1, -1), (1, 1, -1), (-1, 1, -1)])
    corners = np.concatenate([below, below * [1, 1, -1]])
    found = np.empty((8, 8, 3))
    for number, point in enumerate(corners / np.sqrt(3.0)):
        one = 1.0 + corners * point
        for m in range(3):
            found[number, :, m] = 0.125 * corners[:, m] * np.prod(np.delete(one, m, axis=1), axis=1)
    return found, 1.0


def stiffness(points, block):
    """Return the matrix of linear elements, those of hexahedra with 8 points of integration."""
    nodes, dim = block.nodes, points.shape[1]
    corners, C, K = points[nodes], elastic(dim), 0.0
    slopes, weight = slopes_of(block.kind, dim)
    pairs = [(0, 1)] if dim == 2 else [(1, 2), (0, 2), (0, 1)]
    for slope in slopes:
        J = np.matmul(corners.transpose(0, 2, 1), slope)
        if dim == 3:
            adjugate = np.stack([np.cross(J[:, :, (m + 1) % 3], J[:, :, (m + 2) % 3]) for m in range(3)], axis=1)
        else:
            adjugate = np.stack([J[:, 1, 1], -J[:, 0, 1], -J[:, 1, 0], J[:, 0, 0]], axis=1).reshape(-1, 2, 2)
        det = np.einsum("em,em->e", adjugate[:, 0], J[:, :, 0])
        G = np.matmul(slope, adjugate / det[:, None, None])
        B = np.zeros((len(nodes), len(C), nodes.shape[1], dim))
        for m in range(dim):
            B[:, m, :, m] = G[:, :, m]
        for row, (m, n) in enumerate(pairs, dim):
            B[:, row, :, m], B[:, row, :, n] = G[:, :, n], G[:, :, m]
        B = B.reshape(len(nodes), len(C), -1)
        K = K + np.matmul(B.transpose(0, 2, 1), np.matmul(weight * np.abs(det)[:, None, None] * C, B))
    dofs = (nodes[:, :, None] * dim + np.arange(dim)).reshape(len(nodes), -1)
    width = dofs.shape[1]
    rows, columns = np.repeat(dofs, width, axis=1).ravel(), np.tile(dofs, (1, width)).ravel()
    return csr_matrix((K.reshape(-1), (rows, columns)), shape=(points.size, points.size))


def elements(points, block):
    """Solve the block with linear elements and GAMG on this rank alone; return the iterations."""
    dim = points.shape[1]
    K = stiffness(points, block)
    fixed, u = np.zeros(points.shape, dtype=bool), np.zeros(points.shape)
    fixed[points[:, 0] < 1e-9] = True
    fixed[points[:, 0] > 1.0 - 1e-9, 0], u[points[:, 0] > 1.0 - 1e-9, 0] = True, STRAIN
    fixed, free = fixed.ravel(), (~fixed.ravel()).astype(float)
    b = -(K @ u.ravel()) * free
    scaled = K.multiply(free[:, None]).multiply(free[None]).tocsr() + csr_matrix(
        (K.diagonal() * fixed, (np.arange(K.shape[0]),) * 2), shape=K.shape
    )
    csr = scaled.indptr.astype(PETSc.IntType), scaled.indices.astype(PETSc.IntType), scaled.data
    matrix = PETSc.Mat().createAIJ(scaled.shape, bsize=dim, csr=csr, comm=PETSc.COMM_SELF)
    matrix.setOption(PETSc.Mat.Option.SPD, True)
    at = PETSc.Vec().createWithArray(points.ravel(), bsize=dim, comm=PETSc.COMM_SELF)
    modes = PETSc.NullSpace().createRigidBody(at)
    matrix.setNearNullSpace(modes)
    ksp = PETSc.KSP().create(comm=PETSc.COMM_SELF)
    ksp.setType("cg")
    ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
    ksp.setOperators(matrix)
    ksp.getPC().setType("gamg")
    ksp.setTolerances(rtol=linear.RTOL)
    x, rhs = matrix.createVecs()
    rhs.array = b
    ksp.solve(rhs, x)
    found = ksp.getIterationNumber()
    for thing in (ksp, matrix, modes, at, x, rhs):
        thing.destroy()
    return found


def measure(values):
    """Return what one run of all took."""
    comm, clock, used = world(), linear.Clock(), {}

    @contextmanager
    def watched():
        yield
        used["memory"] = float(total(comm, float(memory_now() - before)))

    standard = block_of(**values, weights="standard")
    cloud = make_cloud(comm, standard)
    rehearse(comm, standard, cloud.dim)
    families = make_families(standard, cloud)
    with clock("standard"):
        make_problem(standard, cloud, families)
    before = memory_now()
    found = linear.solve(block_of(**values, weights="conforming"), "matfree", around=watched)
    seconds = found["seconds"]
    if comm.size == 1:
        points, block = mesh(values["kind"], values["n"], values["shake"])
        with clock("elements"):
            of_elements = elements(points, block)
    return {
        "particles": found["particles"], "bonds": found["bonds"], "cloud": seconds["cloud"] + seconds["search"],
        "model": seconds["model"], "solve": found["scratch"], "weights": seconds["model"] - clock.spent["standard"],
        "iterations": found["linear_iterations"], "converged": found["reason"] > 0,
        **({"elements": clock.spent["elements"], "element_iterations": of_elements} if comm.size == 1 else {}),
        "bytes_a_particle": used["memory"] / found["particles"],
    }  # fmt: skip


def main():
    """Print what was measured."""
    given = dict(word.split("=", 1) for word in words)
    defaults = {"kind": "tetrahedra", "n": 15, "at": "cells", "horizon": 2.015, "shake": 0.2}
    values = {name: type(value)(given.pop(name, value)) for name, value in defaults.items()}
    repeats, out = int(given.pop("repeats", 1)), given.pop("json", "")
    if given:
        raise SystemExit(f"unknown parameters: {', '.join(given)}")
    runs = [measure(values) for _ in range(repeats)]
    found = {
        name: float(np.median([run[name] for run in runs])) if isinstance(value, float) else value
        for name, value in runs[0].items()
    }
    found["weights_over_solve"] = found["weights"] / found["solve"]
    if "elements" in found:
        found["over_elements"] = (found["cloud"] + found["model"] + found["solve"]) / found["elements"]
    if is_root(world()):
        print(json.dumps(found, indent=1))
        if out:
            Path(out).write_text(json.dumps({**values, **found}))


if __name__ == "__main__":
    main()
