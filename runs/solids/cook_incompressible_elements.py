"""The nearly incompressible membrane by finite elements: python runs/solids/cook_incompressible_elements.py.

Writes ``cook_incompressible_elements.json``: tip and pressure, minus the in-plane mean Cauchy stress, at the corners of
the elements. Taylor-Hood quadrilaterals (scikit-fem): biquadratic displacements, bilinear ``p = lambda ln J``, or
``lambda tr eps``, as an unknown; elements finer towards the sides, and what half as many each way differ.
"""

import json
import sys
from pathlib import Path

import numpy as np
from scipy.sparse import bmat
from scipy.sparse.linalg import splu
from skfem import Basis, BilinearForm, ElementQuad1, ElementQuad2, ElementVector, FacetBasis, LinearForm, MeshQuad

sys.path[:0] = [str(Path(__file__).parent.parent), str(Path(__file__).parent.parent / "convergence")]
import cook_elements as membrane

STORE = Path(__file__).with_suffix(".json")
RATIOS = (0.3, 0.49, 0.499, 0.4999)
ELEMENTS = 24


def gradients(u):
    """Return F, det F and F^-1 at the Gauss points."""
    F = np.asarray(u.grad) + np.eye(2)[:, :, None, None]
    J = F[0, 0] * F[1, 1] - F[0, 1] * F[1, 0]
    return F, J, np.array([[F[1, 1], -F[0, 1]], [-F[1, 0], F[0, 0]]]) / J


def law_of(finite, mu):
    """Return the forms of the residual and of the tangent, each for displacement and pressure."""

    @LinearForm
    def forces(v, w):
        F, _, G = gradients(w["u"])
        one = np.eye(2)[:, :, None, None]
        p = w["p"]
        if finite:
            P = mu * F + (p - mu) * np.swapaxes(G, 0, 1)
        else:
            P = mu * (F + np.swapaxes(F, 0, 1) - 2.0 * one) + p * one
        return np.einsum("ij...,ij...", P, np.asarray(v.grad))

    @LinearForm
    def dilatation(q, w):
        F, J, _ = gradients(w["u"])
        return (np.log(J) if finite else F[0, 0] + F[1, 1] - 2.0) * q

    @BilinearForm
    def stiffness(u, v, w):
        _, _, G = gradients(w["u"])
        du, dv = np.asarray(u.grad), np.asarray(v.grad)
        found = mu * np.einsum("ij...,ij...", du, dv)
        if not finite:
            return found + mu * np.einsum("ij...,ji...", du, dv)
        turned = np.einsum("ki...,lk...,jl...->ij...", G, du, G)
        return found + (mu - w["p"]) * np.einsum("ij...,ij...", turned, dv)

    @BilinearForm
    def coupling(u, q, w):
        _, _, G = gradients(w["u"])
        du = np.asarray(u.grad)
        return (np.einsum("ji...,ij...", G, du) if finite else du[0, 0] + du[1, 1]) * q

    return forces, dilatation, stiffness, coupling


def solved(n, nu, finite, E, shear):
    """Return the tip and minus the in-plane mean Cauchy stress at the corners (n + 1, n + 1)."""
    mesh = MeshQuad.init_tensor(membrane.line(n), membrane.line(n))
    places = mesh.p.copy()
    mesh = MeshQuad(membrane.places(mesh.p.T).T, mesh.t)
    basis = Basis(mesh, ElementVector(ElementQuad2()), intorder=5)
    pressures = basis.with_element(ElementQuad1())
    lam, mu = E * nu / ((1.0 + nu) * (1.0 - 2.0 * nu)), 0.5 * E / (1.0 + nu)
    forces, dilatation, stiffness, coupling = law_of(finite, mu)
    right = mesh.facets_satisfying(lambda x: np.abs(x[0] - membrane.LENGTH) < 1e-9)
    side = FacetBasis(mesh, ElementVector(ElementQuad2()), facets=right, intorder=5)
    load = LinearForm(lambda v, w: shear * v[1]).assemble(side)
    mass = BilinearForm(lambda p, q, w: p * q).assemble(pressures)
    free = np.flatnonzero(~np.isclose(basis.doflocs[0], 0.0))
    unknown = np.concatenate([free, basis.N + np.arange(pressures.N)])
    u, p = np.zeros(basis.N), np.zeros(pressures.N)
    for t in np.linspace(0.1, 1.0, 10) if finite else [1.0]:
        for _ in range(40):
            now = {"u": basis.interpolate(u), "p": pressures.interpolate(p)}
            r = np.concatenate([
                forces.assemble(basis, **now) - t * load, dilatation.assemble(pressures, **now) - mass @ p / lam
            ])  # fmt: skip
            if np.linalg.norm(r[unknown]) <= 1e-10 * np.linalg.norm(load):
                break
            B = coupling.assemble(basis, pressures, **now)
            K = bmat([[stiffness.assemble(basis, **now), B.T], [B, -mass / lam]]).tocsr()
            change = splu(K[unknown][:, unknown].tocsc()).solve(r[unknown])
            u[free] -= change[: len(free)]
            p -= change[len(free) :]
        else:
            sys.exit(f"Newton did not converge for nu = {nu}.")
    corner = np.flatnonzero(np.isclose(basis.doflocs[0], membrane.LENGTH) & np.isclose(basis.doflocs[1], 60.0))
    # The mean stress at the corners of elements by projection.
    F, J, _ = gradients(basis.interpolate(u))
    field = pressures.interpolate(p)
    strain = (np.einsum("ij...,ij...", F, F) - 2.0) * 0.5 * mu if finite else mu * (F[0, 0] + F[1, 1] - 2.0)
    mean = (np.asarray(field) + strain) / (J if finite else 1.0)
    values = splu(mass.tocsc()).solve(LinearForm(lambda q, w: -mean * q).assemble(pressures))
    where = np.lexsort((places[1], places[0]))
    return float(u[corner[1]]), values[where].reshape(n + 1, n + 1)


def main():
    """Write the numbers."""
    found = {"line": membrane.line(ELEMENTS).tolist()}
    laws = {"linear": (False, lambda nu: 1.0, 1.0 / 16.0), "neo_hookean": (True, lambda nu: 160.388 * (1.0 + nu), 6.25)}
    for name, (finite, young, shear) in laws.items():
        found[name] = {}
        for nu in RATIOS:
            tip, pressure = solved(ELEMENTS, nu, finite, young(nu), shear)
            coarse, _ = solved(ELEMENTS // 2, nu, finite, young(nu), shear)
            rounded = [[float(f"{value:.5g}") for value in row] for row in pressure]
            found[name][f"{nu:g}"] = {"tip": float(f"{tip:.7g}"), "change": coarse / tip - 1.0, "pressure": rounded}
            print(name, nu, tip, coarse / tip - 1.0, flush=True)
    STORE.write_text(json.dumps(found) + "\n")


if __name__ == "__main__":
    main()
