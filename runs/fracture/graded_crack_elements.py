"""Graded plate with an edge crack by finite elements: python runs/fracture/graded_crack_elements.py.

Biquadratic quadrilaterals (scikit-fem), smaller towards the tip; J from the potential energies of cracks of two
lengths, K_II over K_I as the slide over the opening of the faces towards the tip. Writes
``graded_crack_elements.json``: ``J_over``, ``K1_over``, ``K2_over`` as ``graded_crack.py`` has them.
"""

import json
import sys
from pathlib import Path

import numpy as np
from skfem import Basis, BilinearForm, ElementQuad2, ElementVector, FacetBasis, LinearForm, MeshQuad, condense, solve
from skfem.helpers import ddot, sym_grad, trace

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parent.parent)]
import study

study.start("fracture")

import graded_crack as plate

STEP = 1e-3
ASKED = [
    *(
        (ratio, 0.0, a, load, "strain")
        for load in ("grip", "tension")
        for ratio in (0.1, 10.0)
        for a in (0.2, 0.4, 0.6)
    ),
    *((ratio, 0.0, 0.4, "grip", "strain") for ratio in (0.2, 1.0, 5.0)),
    (10.0, 0.0, 0.4, "grip", "stress"),
    *((10.0, direction, 0.4, load, "strain") for direction in (90.0, 45.0) for load in ("grip", "tension")),
    (20.0, 90.0, 0.4, "grip", "stress"),
]


def steps(length, least, most=0.08, growth=1.4):
    """Return distances from a graded end."""
    found, size = [0.0], least
    while found[-1] < length - size:
        found.append(found[-1] + size)
        size = min(growth * size, most)
    return np.array(found) / found[-1] * length


def solved(ratio, direction, a, load, plane, change, least):
    """Return the potential energy of a crack of length ``a + change``, and its slide over its opening near the tip."""
    left, right = a - steps(a, least)[::-1], a + steps(1.0 - a, least)
    # The same mesh, drawn along: the energies of two lengths have the same errors.
    x = np.concatenate([left * (a + change) / a, (1.0 - (1.0 - right) * (1.0 - a - change) / (1.0 - a))[1:]])
    up = steps(plate.HEIGHT, least)
    tensor = MeshQuad.init_tensor(x, np.concatenate([-up[:0:-1], up]))
    points, cells = tensor.p, tensor.t.copy()
    on_crack = np.flatnonzero((np.abs(points[1]) < 1e-14) & (points[0] < a + change - 1e-12))
    twin = np.arange(points.shape[1])
    twin[on_crack] = points.shape[1] + np.arange(len(on_crack))
    below = points[1][cells].mean(axis=0) < 0.0
    cells[:, below] = twin[cells[:, below]]
    mesh = MeshQuad(np.concatenate([points, points[:, on_crack]], axis=1), cells)
    element = ElementVector(ElementQuad2())
    basis = Basis(mesh, element, intorder=6)
    lam = (
        plate.NU / ((1.0 + plate.NU) * (1.0 - 2.0 * plate.NU)) if plane == "strain" else plate.NU / (1.0 - plate.NU**2)
    )
    mu = 0.5 / (1.0 + plate.NU)

    @BilinearForm
    def stiffness(u, v, w):
        at = plate.factor(w.x.reshape(2, -1).T, ratio, direction, a).reshape(w.x.shape[1:])
        return at * (lam * trace(sym_grad(u)) * trace(sym_grad(v)) + 2.0 * mu * ddot(sym_grad(u), sym_grad(v)))

    K, f, u = stiffness.assemble(basis), np.zeros(basis.N), np.zeros(basis.N)
    corner = [
        basis.nodal_dofs[:, np.argmin(np.linalg.norm(mesh.p.T - at, axis=1))] for at in ((1.0, -1.0), (0.0, -1.0))
    ]
    if load == "grip":
        ends = basis.get_dofs(lambda at: np.abs(at[1]) > plate.HEIGHT - 1e-9).all(["u^2"])
        u[ends] = plate.STRAIN * basis.doflocs[1, ends]
        held = np.append(ends, corner[0][0])
    else:
        force = plate.STRAIN * plate.modulus(plane)
        for sign in (1.0, -1.0):
            facets = mesh.facets_satisfying(lambda at, s=sign: s * at[1] > plate.HEIGHT - 1e-9)
            f += sign * force * LinearForm(lambda v, w: v[1]).assemble(FacetBasis(mesh, element, facets=facets))
        held = np.array([*corner[0], corner[1][1]])
    u = solve(*condense(K, f, x=u, D=held))
    pair = np.array([on_crack, twin[on_crack]])
    jump = u[basis.nodal_dofs[:, pair[0]]] - u[basis.nodal_dofs[:, pair[1]]]
    # The ratio goes on linearly with the distance; the elements at the tip itself do not have its root.
    r = a + change - points[0, on_crack]
    near = (r > 8.0 * least) & (r < 0.06)
    slide = np.polyfit(r[near], jump[0, near] / jump[1, near], 1)[1]
    return 0.5 * u @ (K @ u) - f @ u, slide


def numbers(ratio, direction, a, load, plane, least=5e-4):
    """Return what ``graded_crack.py`` gives."""
    unit = plate.STRAIN * plate.modulus(plane) * np.sqrt(np.pi * a)
    (more, _), (less, _), (_, slide) = (
        solved(ratio, direction, a, load, plane, by * STEP * a, least) for by in (1.0, -1.0, 0.0)
    )
    J = (less - more) / (2.0 * STEP * a)
    # The modulus at the tip, of the position ``a``, is one.
    K = np.sqrt(J * plate.modulus(plane)) / np.hypot(1.0, slide) / unit
    return {"J_over": J * plate.modulus(plane) / unit**2, "K1_over": K, "K2_over": K * slide}


def main():
    found = {}
    for one in ASKED:
        found[plate.name(*one)] = {key: round(float(value), 5) + 0.0 for key, value in numbers(*one).items()}
        print(plate.name(*one), found[plate.name(*one)], numbers(*one, least=1e-3), flush=True)
    plate.STORE.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
