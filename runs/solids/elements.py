"""Finite elements of elastic-plastic bodies, for comparison: biquadratic quadrilaterals (scikit-fem), full Newton.

The law is written anew here, in terms of ``b_e = F C_p^-1 F^T`` with a return in principal logarithmic strains
(Simo 1992), its tangent by central differences. A body is in plane strain, in plane stress (``PlaneStress``) or a solid
of revolution: then x is the radius, the third direction goes round, and every integral has the factor ``2 pi x``.
"""

import sys

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import splu
from skfem import Basis, ElementQuad2, ElementVector, LinearForm

DIFFERENCE = 1e-7
# Largest residual on the free nodes over the reactions.
TOLERANCE = 1e-8
# Largest number of Newton steps, for a load step and for the flow of a point.
STEPS = 30
# Components of F that move, the hoop stretch the last one.
PARTS = ((0, 0), (0, 1), (1, 0), (1, 1), (2, 2))


def linear(yield_stress, slope):
    """Return the yield stress and its slope as a function of alpha, for linear hardening."""
    return lambda alpha: (yield_stress + slope * alpha, np.full_like(alpha, slope))


class Law:
    """J2 plasticity in Hencky strain at many points; ``hardening(alpha)`` returns the yield stress and its slope."""

    def __init__(self, E, nu, hardening, points):
        self.lam, self.mu = E * nu / ((1.0 + nu) * (1.0 - 2.0 * nu)), E / (2.0 * (1.0 + nu))
        self.hardening = hardening
        self.inverse_plastic = np.tile(np.eye(3), (points, 1, 1))
        self.alpha = np.zeros(points)

    def respond(self, F):
        """Return P, Kirchhoff stress, C_p^-1 and alpha (n, ...) after a step to F (n, 3, 3) from the kept state."""
        b = F @ self.inverse_plastic @ np.swapaxes(F, 1, 2)
        squares, n = np.linalg.eigh(b)
        strain = 0.5 * np.log(squares)
        volume = strain.sum(axis=1, keepdims=True)
        deviator = 2.0 * self.mu * (strain - volume / 3.0)
        q = np.sqrt(1.5 * (deviator**2).sum(axis=1))
        flow = np.zeros(len(q))
        for _ in range(STEPS):
            y, slope = self.hardening(self.alpha + flow)
            change = (q - 3.0 * self.mu * flow - y) / (3.0 * self.mu + slope)
            flow = np.maximum(flow + change, 0.0)
            if np.abs(np.where(flow > 0.0, change, 0.0)).max() < 1e-13:
                break
        deviator *= (1.0 - 3.0 * self.mu * flow / np.maximum(q, 1e-300))[:, None]
        principal = (self.lam + 2.0 * self.mu / 3.0) * volume + deviator
        elastic = volume / 3.0 + deviator / (2.0 * self.mu)
        tau = np.einsum("pia,pa,pja->pij", n, principal, n)
        b = np.einsum("pia,pa,pja->pij", n, np.exp(2.0 * elastic), n)
        inverse = np.linalg.inv(F)
        return tau @ np.swapaxes(inverse, 1, 2), tau, inverse @ b @ np.swapaxes(inverse, 1, 2), self.alpha + flow

    def keep(self, F):
        """Take the state at F as the one that further steps start from."""
        _, _, self.inverse_plastic, self.alpha = self.respond(F)

    def tangent(self, F):
        """Return the derivatives of the moving parts of P by those of F (5, 5, n)."""
        A = np.empty((5, 5, len(F)))
        for column, (k, m) in enumerate(PARTS):
            d = np.zeros((3, 3))
            d[k, m] = DIFFERENCE
            change = (self.respond(F + d)[0] - self.respond(F - d)[0]) / (2.0 * DIFFERENCE)
            A[:, column] = [change[:, i, j] for i, j in PARTS]
        return A


class PlaneStress(Law):
    """The same where the stretch across the plane is free: it is found at every point, by Newton's method."""

    def respond(self, F):
        """Return what ``Law`` does, at the stretch ``F_zz`` that leaves no stress across the plane."""
        F, size = F.copy(), self.lam + 2.0 * self.mu
        F[:, 2, 2] = self.across
        for _ in range(STEPS):
            tau = super().respond(F)[1][:, 2, 2]
            if np.abs(tau).max() < 1e-12 * size:
                break
            moved = F.copy()
            moved[:, 2, 2] += DIFFERENCE
            slope = (super().respond(moved)[1][:, 2, 2] - tau) / DIFFERENCE
            F[:, 2, 2] -= tau / slope
        self.found = F[:, 2, 2]
        return super().respond(F)

    def keep(self, F):
        """Take the state at F as the one that further steps start from."""
        super().keep(F)
        self.across = self.found

    def __init__(self, E, nu, hardening, points):
        super().__init__(E, nu, hardening, points)
        self.across = np.ones(points)


@LinearForm
def shear(v, w):
    return w.along * v[1]


class Body:
    """An elastic-plastic body of a mesh, marched by ``step`` or ``march``.

    Attributes
    ----------
    u : (n,) float64
        Displacements.
    force : (n,) float64
        Internal forces on all degrees of freedom.
    """

    def __init__(self, mesh, E, nu, hardening, round_axis, law=Law):
        self.mesh, self.round = mesh, round_axis
        self.basis = Basis(mesh, ElementVector(ElementQuad2()), intorder=4)
        self.shape = self.basis.dx.shape
        self.law = law(E, nu, hardening, int(np.prod(self.shape)))
        self.u = np.zeros(self.basis.N)
        self.x, self.vertical = self.basis.doflocs, np.zeros(self.basis.N, dtype=bool)
        self.vertical[self.basis.split_indices()[1]] = True
        self.parts, self.weight = self._parts()
        F, self.force = self._forces(self.u)
        self.stiff = self._stiff(F)

    def gradient(self, u):
        """Return F (n, 3, 3) at all Gauss points."""
        field = self.basis.interpolate(u)
        H = np.asarray(field.grad)
        F = np.tile(np.eye(3), (int(np.prod(self.shape)), 1, 1))
        F[:, :2, :2] += np.moveaxis(H, (0, 1), (-2, -1)).reshape(-1, 2, 2)
        if self.round:
            radius = np.asarray(self.basis.global_coordinates())[0]
            F[:, 2, 2] += (np.asarray(field)[0] / radius).ravel()
        return F

    def _parts(self):
        """Return the moving parts of the gradients of the basis, (5, basis functions, elements, points)."""
        radius = np.asarray(self.basis.global_coordinates())[0]
        found = []
        for (field,) in self.basis.basis:
            grad, value = np.asarray(field.grad), np.asarray(field)
            hoop = value[0] / radius if self.round else np.zeros(self.shape)
            # What is constant over the elements is kept once.
            found.append([np.broadcast_to(part, self.shape) for part in (*grad.reshape(4, *grad.shape[2:]), hoop)])
        weight = self.basis.dx * (2.0 * np.pi * radius if self.round else 1.0)
        return np.moveaxis(np.array(found), 0, 1), weight

    def _forces(self, u):
        F = self.gradient(u)
        P = self.law.respond(F)[0]
        parts = np.stack([P[:, i, j].reshape(self.shape) for i, j in PARTS])
        local = np.einsum("aieq,aeq,eq->ie", self.parts, parts, self.weight, optimize=True)
        return F, np.bincount(self.basis.element_dofs.ravel(), local.ravel(), self.basis.N)

    def _stiff(self, F):
        A = self.law.tangent(F).reshape(5, 5, *self.shape) * self.weight
        local = np.einsum("aieq,abeq,bjeq->ije", self.parts, A, self.parts, optimize=True)
        rows, columns = np.broadcast_arrays(self.basis.element_dofs[:, None], self.basis.element_dofs[None])
        size = (self.basis.N, self.basis.N)
        return coo_matrix((local.ravel(), (rows.ravel(), columns.ravel())), size).tocsr()

    def step(self, held, values, load=0.0, ratio=0.0):
        """March to prescribed displacements and a load (n,); return whether Newton's method converged.

        It starts from the last increment times ``ratio``, or from the linear response where that is zero, with the
        tangent of the last iteration: at a state that is kept the tangent is elastic.
        """
        free = np.setdiff1d(np.arange(self.basis.N), held)
        start, u, K = self.u, self.u.copy(), self.stiff
        load = load * np.ones(self.basis.N)
        if ratio > 0.0:
            u += ratio * self.increment
            u[held] = values
        else:
            increment = np.zeros(self.basis.N)
            increment[held] = values - u[held]
            right = (K @ increment + self.force - load)[free]
            u += increment
            u[free] -= splu(K[free][:, free].tocsc()).solve(right)
        F, force = self._forces(u)
        for _ in range(STEPS):
            size = np.linalg.norm((force - load)[free])
            if size < TOLERANCE * np.linalg.norm(force[held]):
                self.u, self.force, self.increment, self.stiff = u, force, u - start, K
                self.law.keep(F)
                return True
            if not np.isfinite(size):
                break
            K = self._stiff(F)
            try:
                change = splu(K[free][:, free].tocsc()).solve((force - load)[free])
            except RuntimeError:  # exactly singular
                break
            for length in (1.0, 0.5, 0.25, 0.125):
                moved = u.copy()
                moved[free] -= length * change
                F, force = self._forces(moved)
                if np.linalg.norm((force - load)[free]) < size:
                    break
            u = moved
        return False

    def march(self, held, values, load, steps):
        """Take equal steps from zero to displacements and a load (n,); yield the step time after each of them."""
        for step in range(1, steps + 1):
            t = step / steps
            if not self.step(held, values * t, load * t):
                sys.exit(f"Newton's method did not converge in step {step} of {steps}.")
            yield t
