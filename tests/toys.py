"""A material with history, a scheme, a control and a damage law of nobody's, in one file outside the package."""

from dataclasses import dataclass

import numpy as np

import pdpetsc as pd
from pdpetsc.control.non_uniform import NonUniform
from pdpetsc.damage import BondDamage
from pdpetsc.gradient.base import correspondence_weights, from_bond_weights, regular_shape_tensors
from tests.commands import Stop


@dataclass(frozen=True)
class Wearing(pd.HistoryMaterial):
    """Saint Venant's stress times ``exp(-k / wear)``, k the largest ``sqrt(2 psi / E)`` that a point has had."""

    wear: float = 0.2

    def constants(self, dim):
        return np.array([*self.lame(dim), self.E, self.wear])

    def initial_history(self, dim, n):
        return np.zeros((n, 1))

    def history_kernels(self, dim):
        return pd.HistoryKernels(_stress, _tangent, _energy, _commit)

    def thickness_stretch(self, F):
        return np.ones(len(F))

    def out_of_plane_stress(self, F, history):
        strain, _, _, k, _ = _at(F, slice(None), self.constants(2), history)
        return np.exp(-k / self.wear) * self.lame(2)[0] * np.einsum("pii->p", strain)


def _at(F, select, constants, history):
    """Return strain, stress and energy without wear, the largest k with this state, and where it is that of now."""
    lam, mu, E, _ = constants
    F = F[select]
    one = np.eye(F.shape[-1])
    strain = 0.5 * (np.einsum("pji,pjk->pik", F, F) - one)
    S = lam * np.einsum("pii->p", strain)[:, None, None] * one + 2.0 * mu * strain
    psi = 0.5 * np.einsum("pij,pij->p", S, strain)
    k = np.sqrt(2.0 * psi / E)
    return strain, S, psi, np.maximum(k, history[:, 0]), k > history[:, 0]


def _stress(F, select, constants, history, P):
    _, S, _, k, _ = _at(F, select, constants, history)
    P[select] = np.exp(-k / constants[3])[:, None, None] * (F[select] @ S)


def _tangent(F, select, constants, history, A):
    lam, mu, E, wear = constants
    _, S, _, k, grows = _at(F, select, constants, history)
    F = F[select]
    one = np.eye(F.shape[-1])
    FS = F @ S
    C = lam * np.einsum("jm,qn->jmqn", one, one)
    C += mu * (np.einsum("jq,mn->jmqn", one, one) + np.einsum("jn,mq->jmqn", one, one))
    elastic = np.einsum("ik,pmn->pimkn", one, S) + np.einsum("pij,jmqn,pkq->pimkn", F, C, F)
    rate = np.divide(1.0, wear * E * k, out=np.zeros_like(k), where=grows)
    elastic -= rate[:, None, None, None, None] * np.einsum("pim,pkn->pimkn", FS, FS)
    A[select] = np.exp(-k / wear)[:, None, None, None, None] * elastic


def _energy(F, select, constants, history, psi):
    _, _, elastic, k, _ = _at(F, select, constants, history)
    E, wear = constants[2:]
    fall = np.exp(-k / wear)
    # What is stored now, and what was lost on the way to k.
    psi[select] = fall * elastic + E * (wear**2 * (1.0 - (1.0 + k / wear) * fall) - 0.5 * k**2 * fall)


def _commit(F, select, constants, history):
    history[:, 0] = _at(F, select, constants, history)[3]


@dataclass(frozen=True)
class NearestCount(pd.Scheme):
    """The gradient of least squares with weights ``omega V_j / |xi|^power``."""

    power: float = 4.0

    def build(self, cloud, families, omega):
        length = np.linalg.norm(families.bonds(cloud.x), axis=1)
        weight = omega * cloud.volume[families.neighbours] / length**self.power
        K = regular_shape_tensors(cloud, families, weight, "weights that fall with the distance")
        return from_bond_weights(cloud, families, correspondence_weights(families, cloud.x, weight, np.linalg.inv(K)))


@dataclass(frozen=True)
class NearestHeld(pd.ZeroEnergyControl):
    """Springs ``share kappa omega V_i V_j / (|xi|^2 sum_j V_j)`` on what a uniform gradient leaves unexplained."""

    share: float = 0.5

    def build(self, cloud, families, omega, stiffness):
        i, j = families.centres, families.neighbours
        length = np.linalg.norm(families.bonds(cloud.x), axis=1)
        whole = np.bincount(i, cloud.volume[j], minlength=cloud.n_owned)
        s = self.share * omega * (stiffness.kappa / whole)[i] * cloud.volume[i] * cloud.volume[j] / length**2
        K = regular_shape_tensors(cloud, families, s, "these springs")
        return NonUniform(cloud, families, s, np.linalg.inv(K))


@dataclass(frozen=True)
class ParabolicSoftening(BondDamage):
    """The force falls as ``((ratio - x) / (ratio - 1))^2``."""

    ratio: float = 3.0

    @property
    def final(self):
        return self.ratio

    def phi(self, x):
        return ((self.ratio - x) / (self.ratio - 1.0)) ** 2 / x

    def slope(self, x):
        return (1.0 - (self.ratio / x) ** 2) / (self.ratio - 1.0) ** 2


# Strain at the end of loading and of unloading, at step times TURN and 1.
TOP, BACK, TURN = 0.05, 0.01, 0.4


def case(shear=0.0, scheme="sub_horizons", steps=10, stop=2.0):
    """Return a strip of the material that is pulled and let go, and sheared on request."""
    left, right = pd.region.Slab("x", high=2.0), pd.region.Slab("x", low=10.0)
    path = pd.Table((0.0, TURN, 1.0), (0.0, TOP, BACK))
    history = {"force": pd.Reaction("x", right), "stop": Stop(stop)}
    return pd.Case(
        particles=pd.Lattice((0.0, 0.0), (12.0, 3.0), 1.0),
        horizon=1.515,
        material=Wearing(E=10.0, nu=0.0),
        scheme=NearestCount() if scheme == "nearest" else pd.SCHEMES[scheme],
        control=NearestHeld() if scheme == "nearest" else None,
        conditions=[
            pd.Displacement(left | right, x=lambda x, t: x[:, 0], schedule=path),
            pd.Displacement(left if shear else pd.region.Nearest((0.5, 0.5)), y=0.0),
            *([pd.Displacement(right, y=shear, schedule=path)] if shear else []),
        ],
        steps=pd.Steps(steps),
        history=history,
        results=lambda h: {"force": h["force"][-1]},
        fields=[pd.displacement, pd.first_piola_stress],
    )
