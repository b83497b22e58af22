"""Elastic-plastic plate by finite elements, for comparison: python runs/plasticity/finite_elements.py.

Writes ``finite_elements.json``. Biquadratic quadrilaterals (scikit-fem) with 3 x 3 Gauss points, full Newton, a
quarter of the plate: elements know no difference between symmetry lines and the whole. The law is that of
the elements in ``runs/solids``, written anew in terms of b_e = F C_p^-1 F^T, its tangent by central differences. Units
mm, N.
"""

import json
import sys
from pathlib import Path

import numpy as np
from scipy.sparse.linalg import splu
from skfem import Basis, BilinearForm, ElementQuad1, ElementQuad2, ElementVector, LinearForm, MeshQuad

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent), str(HERE.parent / "solids")]
import study

study.start("plasticity")

import elements
import plate

STORE = Path(__file__).with_suffix(".json")
# Largest residual on the free nodes over the reactions.
TOLERANCE = 1e-8


class Law(elements.Law):
    """J2 plasticity with linear hardening in Hencky strain at many points, plane strain."""

    def __init__(self, E, nu, yield_stress, hardening, points):
        super().__init__(E, nu, lambda alpha: (yield_stress + hardening * alpha, hardening), points)

    def tangent(self, F):
        """Return dP/dF in the plane (2, 2, 2, 2, n)."""
        A = np.empty((2, 2, 2, 2, len(F)))
        for k in range(2):
            for m in range(2):
                d = np.zeros((3, 3))
                d[k, m] = elements.DIFFERENCE
                change = self.respond(F + d)[0] - self.respond(F - d)[0]
                A[:, :, k, m] = np.moveaxis(change[:, :2, :2] / (2.0 * elements.DIFFERENCE), 0, -1)
        return A


@LinearForm
def internal(v, w):
    return np.einsum("imep,imep->ep", w.P, v.grad)


@BilinearForm
def stiffness(u, v, w):
    dP = np.einsum("imknep,knep->imep", w.A, u.grad)
    return np.einsum("imep,imep->ep", v.grad, dP)


def gradient(basis, u):
    """Return F (n, 3, 3) at all Gauss points."""
    H = np.asarray(basis.interpolate(u).grad)
    F = np.tile(np.eye(3), (H.shape[2] * H.shape[3], 1, 1))
    F[:, :2, :2] += np.moveaxis(H, (0, 1), (-2, -1)).reshape(-1, 2, 2)
    return F


def solve(mesh, constants, fixed, steps, watch):
    """March to the end; ``fixed(basis)`` gives held degrees of freedom and their values at the end.

    Calls ``watch(basis, law, F, force)`` at the start and after every step, ``force`` on all degrees of freedom.
    """
    basis = Basis(mesh, ElementVector(ElementQuad2()), intorder=5)
    cells, points = basis.dx.shape
    law = Law(*constants, cells * points)
    held, values = fixed(basis)
    free = np.setdiff1d(np.arange(basis.N), held)
    u = np.zeros(basis.N)
    watch(basis, law, gradient(basis, u), np.zeros(basis.N))
    shape = (cells, points)

    def forces(u):
        F = gradient(basis, u)
        P = np.moveaxis(law.respond(F)[0][:, :2, :2], 0, -1).reshape(2, 2, *shape)
        return F, internal.assemble(basis, P=P)

    def stiff(F):
        return stiffness.assemble(basis, A=law.tangent(F).reshape(2, 2, 2, 2, *shape)).tocsr()

    F, force = forces(u)
    K = stiff(F)
    for step in range(1, steps + 1):
        # The supports move with the linear response of the last state, so that no layer takes the whole increment.
        increment = np.zeros(basis.N)
        increment[held] = values * step / steps - u[held]
        u += increment
        u[free] -= splu(K[free][:, free].tocsc()).solve((K @ increment)[free])
        F, force = forces(u)
        for _ in range(40):
            size = np.linalg.norm(force[free])
            if size < TOLERANCE * np.linalg.norm(force[held]):
                break
            K = stiff(F)
            change = splu(K[free][:, free].tocsc()).solve(force[free])
            for length in (1.0, 0.5, 0.25, 0.125):
                moved = u.copy()
                moved[free] -= length * change
                F, force = forces(moved)
                if np.linalg.norm(force[free]) < size:
                    break
            u = moved
        else:
            sys.exit(f"Newton did not converge in step {step}.")
        law.keep(F)
        watch(basis, law, F, force)
    return u


def nodal(basis, values):
    """Return values at Gauss points (n,) averaged at the corners of the elements."""
    scalar = basis.with_element(ElementQuad1())
    values = values.reshape(basis.dx.shape)
    weight = LinearForm(lambda v, w: v).assemble(scalar)
    return LinearForm(lambda v, w: w.field * v).assemble(scalar, field=values) / weight


def rounded(values):
    return [float(f"{v:.7g}") for v in values]


def pulled_plate(h, steps=40):
    """Return the history of force and mean plastic strain, and stress and plastic strain along the x axis."""
    side = np.linspace(0.0, plate.SIZE, round(plate.SIZE / h) + 1)
    mesh = MeshQuad.init_tensor(side, side)
    middle = mesh.p[:, mesh.t].mean(axis=1)
    mesh = mesh.remove_elements(np.flatnonzero((middle < plate.OPENING).all(axis=0)))

    def fixed(basis):
        x = basis.doflocs
        vertical = np.zeros(basis.N, dtype=bool)
        for group in (basis.nodal_dofs, basis.facet_dofs, basis.interior_dofs):
            vertical[group[1]] = True
        top = vertical & np.isclose(x[1], plate.SIZE)
        held = top | (vertical & np.isclose(x[1], 0.0)) | (~vertical & np.isclose(x[0], 0.0))
        return np.flatnonzero(held), np.where(top, plate.PULL, 0.0)[held]

    found = {"t": [], "force": [], "mean_plastic": []}

    def watch(basis, law, F, force):
        found["t"].append(len(found["t"]) / steps)
        x = basis.doflocs
        top = np.isclose(x[1], plate.SIZE)
        vertical = np.zeros(basis.N, dtype=bool)
        for group in (basis.nodal_dofs, basis.facet_dofs, basis.interior_dofs):
            vertical[group[1]] = True
        # The whole plate has twice the force of its quarter.
        found["force"].append(2.0 * float(force[top & vertical].sum()))
        weight = basis.dx.ravel()
        found["mean_plastic"].append(float(law.alpha @ weight / weight.sum()))
        if len(found["t"]) == steps + 1:
            _, tau, _, alpha = law.respond(F)
            # The state was kept before, so nothing flows anew.
            sigma = tau[:, 1, 1] / np.linalg.det(F)
            nodes = np.flatnonzero(np.isclose(mesh.p[1], 0.0))
            nodes = nodes[np.argsort(mesh.p[0, nodes])]
            found["x"] = rounded(mesh.p[0, nodes])
            found["stress"] = rounded(nodal(basis, sigma)[nodes])
            found["plastic"] = rounded(nodal(basis, alpha)[nodes])

    solve(mesh, (plate.E, plate.NU, plate.YIELD, plate.HARDENING), fixed, steps, watch)
    for name in ("force", "mean_plastic"):
        found[name] = rounded(found[name])
    return found


def main():
    coarse, fine = pulled_plate(4.0), pulled_plate(2.0)
    for name in ("force", "mean_plastic"):
        fine[f"{name}_change_from_twice_the_mesh_size"] = fine[name][-1] / coarse[name][-1] - 1.0
    twice = pulled_plate(4.0, 80)
    fine["force_change_from_half_the_steps"] = twice["force"][-1] / coarse["force"][-1] - 1.0
    STORE.write_text(json.dumps({"plate": fine}) + "\n")
    print({name: value for name, value in fine.items() if name not in ("x", "stress", "plastic")})


if __name__ == "__main__":
    main()
