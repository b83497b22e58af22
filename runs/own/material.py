"""A material of one's own in plain NumPy: a tissue that stiffens exponentially as it is stretched (Fung).

Its strain energy is ``k/2 (exp(2 W / k) - 1)`` with that of Saint Venant, ``W = lambda/2 (tr E)^2 + mu E : E``, so that
``P = exp(2 W / k) F S`` and ``A = exp(2 W / k) (A_S + 2/k F S x F S)``. The class gives these three as loops over
points, nothing else: schemes, controls, Newton's method, ranks and restarts take it as it is. A strip in plane stress
is pulled at its ends with free sides.

Results: ``stress``, the force at the end over the section of the undeformed strip, against the closed form
``exp(Y e^2 / k) l Y e`` with ``e = (l^2 - 1) / 2`` at the stretch l; ``off``, the largest error of the deformation
gradient. Any consistent units.
"""

from dataclasses import dataclass

import numpy as np

import pdpetsc as pd
from pdpetsc.material.base import ElasticMaterial, PointKernels


@dataclass(frozen=True)
class Fung(ElasticMaterial):
    """The law; ``E`` and ``nu`` are those at small strain, ``k`` [stress] says how soon it stiffens."""

    k: float = 1.0

    def constants(self, dim):
        """Return the numbers that the loops get: in plane stress lambda is that of the plane."""
        return np.array([*self.lame(dim), self.k])

    def kernels(self, dim):
        return PointKernels(stress, tangent, energy)

    def volumetric_strain(self, F):
        return 0.5 * (np.einsum("pij,pij->p", F, F) - F.shape[-1])

    def thickness_stretch(self, F):
        """Return the stretch across the plane, where there is no stress, as Saint Venant's law has it."""
        return np.sqrt(1.0 - 2.0 * self.lateral_strain_ratio(F.shape[-1]) * self.volumetric_strain(F))


def of_saint_venant(F, lam, mu):
    """Return strain, stress S (n, d, d) and energy (n,)."""
    one = np.eye(F.shape[-1])
    strain = 0.5 * (F.transpose(0, 2, 1) @ F - one)
    S = lam * np.einsum("pii->p", strain)[:, None, None] * one + 2.0 * mu * strain
    return S, 0.5 * np.einsum("pij,pij->p", S, strain)


def stress(F, select, constants, P):
    lam, mu, k = constants
    S, W = of_saint_venant(F[select], lam, mu)
    P[select] = np.exp(2.0 * W / k)[:, None, None] * (F[select] @ S)


def tangent(F, select, constants, A):
    lam, mu, k = constants
    F = F[select]
    S, W = of_saint_venant(F, lam, mu)
    one = np.eye(F.shape[-1])
    FS = F @ S
    found = np.einsum("ik,pmn->pimkn", one, S) + lam * np.einsum("pim,pkn->pimkn", F, F)
    found += mu * np.einsum("pin,pkm->pimkn", F, F) + mu * np.einsum("mn,pij,pkj->pimkn", one, F, F)
    found += 2.0 / k * np.einsum("pim,pkn->pimkn", FS, FS)
    A[select] = np.exp(2.0 * W / k)[:, None, None, None, None] * found


def energy(F, select, constants, psi):
    lam, mu, k = constants
    _, W = of_saint_venant(F[select], lam, mu)
    psi[select] = 0.5 * k * np.expm1(2.0 * W / k)


def exact(stretch, E, k):
    """Return the nominal stress of a strip with free sides."""
    e = 0.5 * (stretch**2 - 1.0)
    return np.exp(E * e**2 / k) * stretch * E * e


def case(n=10, stretch=1.4, E=1.0, nu=0.3, k=0.5, horizon=1.515, steps=10):
    length, height, dx = 3.0, 1.0, 1.0 / n
    left, right = pd.region.Slab("x", high=2.0 * dx), pd.region.Slab("x", low=length - 2.0 * dx)
    across = np.sqrt(1.0 - nu * (stretch**2 - 1.0))

    def pulled(x, t):
        return (stretch - 1.0) * t * x[:, 0]

    def narrowed(x, t):
        now = 1.0 + (stretch - 1.0) * t
        return (np.sqrt(1.0 - nu * (now**2 - 1.0)) - 1.0) * (x[:, 1] - 0.5 * height)

    return pd.Case(
        particles=pd.Lattice((0.0, 0.0), (length, height), dx),
        horizon=horizon * dx,
        material=Fung(E=E, nu=nu, plane="stress", k=k),
        # Two layers at each end move as the uniform strip does, so that all of it is uniform.
        conditions=[pd.Displacement(left | right, x=pulled, y=narrowed)],
        steps=pd.Steps(steps),
        history={
            "force": pd.Reaction("x", right),
            "off": pd.LargestError(pd.deformation_gradient, lambda x, t: np.diag([stretch, across])),
        },
        results=lambda h: {"stress": h["force"][-1] / height, "off": h["off"][-1]},
        expect={
            "stress": pd.Expected(float(exact(stretch, E, k)), relative=1e-6, source="uniaxial stress, closed form"),
            "off": pd.Expected(0.0, absolute=1e-8, source="the same deformation gradient at every particle"),
        },
        picture=pd.Picture(pd.displacement, "x"),
    )
