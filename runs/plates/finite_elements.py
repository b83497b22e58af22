"""Finite elements with nodes at the particles: python runs/plates/finite_elements.py writes finite_elements.json.

Bilinear quadrilaterals and trilinear hexahedra (scikit-fem) between the particles of each case, quadratic triangles
around the diamond hole, whose edges run along the diagonals of the lattice; the same supports, small strain; stresses
are averaged at the nodes. Values are stored along the line of each case. Of the plate with the square opening a
quarter is meshed: elements know no difference between symmetry lines and the whole plate.
"""

import json
import sys
from pathlib import Path

import numpy as np
from scipy.sparse.linalg import cg
from skfem import (
    Basis,
    ElementHex1,
    ElementQuad1,
    ElementTriP1,
    ElementTriP2,
    ElementVector,
    LinearForm,
    MeshHex,
    MeshQuad,
    MeshTri,
    asm,
    condense,
    solve,
)
from skfem.models.elasticity import lame_parameters, linear_elasticity

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parent.parent)]
import study

study.start("plates")

import brick
import diamond_hole
import square_opening

STORE = Path(__file__).with_suffix(".json")
# Of displacements and of the stress that is averaged.
ELEMENTS = {
    MeshQuad: (ElementQuad1, ElementQuad1),
    MeshHex: (ElementHex1, ElementHex1),
    MeshTri: (ElementTriP2, ElementTriP1),
}


def jacobi_cg(A, b):
    d = 1.0 / np.sqrt(A.diagonal())
    scaled = A.multiply(d[:, None]).multiply(d[None, :]).tocsr()
    x, info = cg(scaled, d * b, rtol=1e-11, maxiter=20000)
    assert info == 0
    return d * x


def analyse(mesh, lam, mu, fixed):
    """Return node coordinates, displacement (dim, n) and sigma_xx (n,); ``fixed`` lists (axis, nodes, value)."""
    dim = mesh.p.shape[0]
    kind, averaged = next(pair for known, pair in ELEMENTS.items() if isinstance(mesh, known))
    basis = Basis(mesh, ElementVector(kind()))
    K = asm(linear_elasticity(lam, mu), basis)
    u = np.zeros(basis.N)
    held = np.zeros(basis.N, dtype=bool)
    for axis, nodes, value in fixed:
        dofs = basis.nodal_dofs[axis, nodes]
        if len(basis.facet_dofs):
            # The middle of a side moves with its two ends.
            dofs = np.append(dofs, basis.facet_dofs[axis, np.isin(mesh.facets, nodes).all(axis=0)])
        u[dofs], held[dofs] = value, True
    inner = condense(K, np.zeros(basis.N), x=u, D=np.flatnonzero(held))
    u = solve(*inner) if dim == 2 else solve(*inner, solver=jacobi_cg)
    grad = np.asarray(basis.interpolate(u).grad)
    strain = 0.5 * (grad + np.swapaxes(grad, 0, 1))
    sigma = lam * np.einsum("kk...->...", strain) + 2.0 * mu * strain[0, 0]
    scalar = basis.with_element(averaged())
    weight = asm(LinearForm(lambda v, w: v), scalar)
    stress = asm(LinearForm(lambda v, w: w.sigma * v), scalar, sigma=sigma) / weight
    return mesh.p, u[basis.nodal_dofs], stress


def on_line(p, axis, at, dx, **quantities):
    """Return coordinates and values of the nodes on a line, in order."""
    nodes = np.flatnonzero(np.all([np.abs(p[a] - place) < 0.1 * dx for a, place in at.items()], axis=0))
    nodes = nodes[np.argsort(p[axis, nodes])]
    found = {name: [float(f"{v:.9g}") for v in values[nodes]] for name, values in quantities.items()}
    return {"s": [float(f"{v:.9g}") for v in p[axis, nodes]], **found}


def nodes_where(p, axis, value, dx):
    return np.flatnonzero(np.abs(p[axis] - value) < 0.1 * dx)


def without(mesh, inside):
    """Return the mesh without the elements whose middle lies in the hole."""
    middle = mesh.p[:, mesh.t].mean(axis=1)
    return mesh.remove_elements(np.flatnonzero(inside(middle)))


def square(dx=2.0):
    c = square_opening
    side = np.linspace(0.0, c.SIZE, round(c.SIZE / dx) + 1)
    mesh = without(MeshQuad.init_tensor(side, side), lambda m: (m[0] < c.OPENING) & (m[1] < c.OPENING))
    lam, mu = lame_parameters(c.E, c.NU)
    lam = 2.0 * lam * mu / (lam + 2.0 * mu)
    fixed = [(a, nodes_where(mesh.p, a, 0.0, dx), 0.0) for a in (0, 1)]
    fixed += [(a, nodes_where(mesh.p, a, c.SIZE, dx), c.STRETCH) for a in (0, 1)]
    p, u, stress = analyse(mesh, lam, mu, fixed)
    return on_line(p, 0, {1: 0.0}, dx, u=u[0], stress=stress)


def diamond(nx=160):
    c = diamond_hole
    dx = c.LENGTH / nx
    x = np.linspace(-c.LENGTH / 2, c.LENGTH / 2, nx + 1)
    y = np.linspace(-c.WIDTH / 2, c.WIDTH / 2, nx // 2 + 1)
    corners = MeshQuad.init_tensor(x, y)
    a, b, c_, d = corners.t
    # The diagonal of each cell that runs along the edge of the hole in its quadrant.
    falling = np.prod(corners.p[:, corners.t].mean(axis=1), axis=0) > 0.0
    third, fourth = np.where(falling, d, c_), np.where(falling, b, a)
    triangles = np.hstack([[a, b, third], [c_, d, fourth]])
    triangles = triangles[:, ~c.in_hole(corners.p[:, triangles].mean(axis=1).T)]
    used, triangles = np.unique(triangles, return_inverse=True)
    mesh = MeshTri(corners.p[:, used], triangles.reshape(3, -1))
    ends = [(0, nodes_where(mesh.p, 0, sign * c.LENGTH / 2, dx), sign * c.PULL) for sign in (-1.0, 1.0)]
    middle = np.flatnonzero((np.abs(mesh.p[1]) < 0.1 * dx) & (np.abs(mesh.p[0] - c.LENGTH / 2) < 0.1 * dx))
    p, u, stress = analyse(mesh, *lame_parameters(c.E, c.NU), [*ends, (1, middle, 0.0)])
    line = on_line(p, 0, {1: 0.0}, dx, u=u[0], stress=stress)
    right = [i for i, s in enumerate(line["s"]) if s > 0.0]
    return {name: [values[i] for i in right] for name, values in line.items()}


def block(sides, dx=2.5):
    c = brick
    side = np.linspace(0.0, c.SIDE, round(c.SIDE / dx) + 1)
    mesh = MeshHex.init_tensor(side, side, np.linspace(0.0, c.HEIGHT, round(c.HEIGHT / dx) + 1))
    fixed = [(a, nodes_where(mesh.p, a, at, dx), u) for a in (0, 1) for at, u in ((0.0, -c.PULL), (c.SIDE, c.PULL))]
    if sides == "held":
        upright = np.flatnonzero(np.abs(mesh.p[:2] - 0.5 * c.SIDE).max(axis=0) > 0.5 * c.SIDE - 0.1 * dx)
    else:
        middle = 0.5 * np.array([c.SIDE, c.SIDE, c.HEIGHT])
        upright = np.flatnonzero(np.abs(mesh.p - middle[:, None]).max(axis=0) < 0.1 * dx)
    p, u, stress = analyse(mesh, *lame_parameters(c.E, c.NU), [*fixed, (2, upright, 0.0)])
    return on_line(p, 1, {0: 0.5 * c.SIDE, 2: 0.0}, dx, u=u[2], stress=stress)


if __name__ == "__main__":
    found = {"square_opening": square(), "square_opening_fine": square(dx=0.5), "diamond_hole": diamond()}
    found |= {f"brick_{sides}": block(sides) for sides in ("held", "free")}
    STORE.write_text(json.dumps(found) + "\n")
