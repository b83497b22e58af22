"""The stress of a step that conserves energy: work, symmetry, tangent, objectivity, and the law in small steps."""

import numpy as np
import pytest

import pdpetsc as pd
from pdpetsc.material.energy_momentum import EnergyMomentum

LAWS = {
    "neo_hookean": pd.NeoHookean(E=10.0, nu=0.3),
    "hencky": pd.Hencky(E=10.0, nu=0.3),
    "plane_stress": pd.NeoHookean(E=10.0, nu=0.3, plane="stress"),
    "fibres": pd.HolzapfelGasserOgden(3.0, 1.0, 1.0, 20.0, (0.6, 0.8), plane="stress"),
}


class Step:
    """Points that go from one deformation to another."""

    def __init__(self, law, F_0, F_1):
        self.law, self.F_0, self.F_1, self.rows = law, F_0, F_1, np.arange(len(F_0))
        dim = F_0.shape[1]
        conserving = EnergyMomentum(law)
        self.constants, self.kernels = conserving.constants(dim), conserving.history_kernels(dim)
        self.constants[-1] = 0.1  # the duration of the step
        self.history = conserving.history_at(dim, np.zeros((len(F_0), dim)))
        self.kernels.commit(F_0, self.rows, self.constants, self.history)
        self.plain, self.data = law.history_kernels(dim), law.history_at(dim, np.zeros((len(F_0), dim)))

    def stress(self, F):
        P = np.empty_like(F)
        self.kernels.stress(F, self.rows, self.constants, self.history, P)
        return P

    def of_law(self, F):
        P, psi = np.empty_like(F), np.empty(len(F))
        self.plain.stress(F, self.rows, self.constants[:-1], self.data, P)
        self.plain.energy(F, self.rows, self.constants[:-1], self.data, psi)
        return P, psi

    @property
    def mean(self):
        """Return the stress with which an implicit step of radius 1 moves."""
        return 0.5 * (self.stress(self.F_1) + self.of_law(self.F_0)[0])


def deformations(dim, size=0.2, n=6):
    rng = np.random.default_rng(5)
    F_0 = np.eye(dim) + size * rng.uniform(-1.0, 1.0, (n, dim, dim))
    return F_0, F_0 + size * rng.uniform(-1.0, 1.0, (n, dim, dim))


def steps(**given):
    return [
        Step(law, *deformations(dim, **given))
        for name, law in LAWS.items()
        for dim in ((2,) if name in ("plane_stress", "fibres") else (1, 2, 3))
    ]


def test_work_is_the_change_of_energy_and_there_is_no_moment():
    for step in steps():
        psi_0, psi_1 = (step.of_law(F)[1] for F in (step.F_0, step.F_1))
        work = np.einsum("pij,pij->p", step.mean, step.F_1 - step.F_0)
        assert np.abs(work - (psi_1 - psi_0)).max() < 1e-13 * np.abs(psi_1).max()
        turning = step.mean @ np.swapaxes(0.5 * (step.F_0 + step.F_1), 1, 2)
        assert np.abs(turning - np.swapaxes(turning, 1, 2)).max() < 1e-13 * np.abs(turning).max()


def test_the_tangent_is_the_derivative():
    for step in steps():
        dim, h = step.F_1.shape[1], 1e-6
        A = np.empty((len(step.F_1), *(dim,) * 4))
        step.kernels.tangent(step.F_1, step.rows, step.constants, step.history, A)
        for i in range(dim):
            for k in range(dim):
                up, down = step.F_1.copy(), step.F_1.copy()
                up[:, i, k] += h
                down[:, i, k] -= h
                difference = (step.stress(up) - step.stress(down)) / (2.0 * h)
                assert np.abs(A[:, :, :, i, k] - difference).max() < 1e-7 * np.abs(A).max()


def test_small_steps_have_the_stress_of_the_law():
    """With an error of second order in the size of the step; without a step it is that stress itself."""
    for law in LAWS.values():
        F_0, F_1 = deformations(2)
        off = []
        for part in (0.2, 0.1):
            step = Step(law, F_0, F_0 + part * (F_1 - F_0))
            ends = [step.of_law(F)[0] for F in (step.F_0, step.F_1)]
            off.append(np.abs(step.mean - 0.5 * (ends[0] + ends[1])).max())
        assert off[0] / off[1] == pytest.approx(4.0, rel=0.25)
        rest = Step(law, F_0, F_0)
        assert np.abs(rest.stress(F_0) - rest.of_law(F_0)[0]).max() < 1e-13 * np.abs(rest.of_law(F_0)[0]).max()
        between = Step(law, F_0, F_1)
        between.constants[-1] = 0.0
        assert np.array_equal(between.stress(F_1), between.of_law(F_1)[0])


def test_the_stress_of_a_small_step_has_the_round_off_of_the_law():
    """Third differences of the mean stress along a line of ends are round-off, not that of energies over ``|dC|``."""
    for law in LAWS.values():
        F_0, F_1 = deformations(2)
        ends = [F_0 + 1e-5 * (1.0 + 1e-3 * k) * (F_1 - F_0) for k in range(4)]
        means = [Step(law, F_0, end).mean for end in ends]
        assert np.abs(np.diff(means, 3, axis=0)).max() < 1e-12


def test_a_body_at_rest_is_loaded_slowly_without_shorter_steps(tmp_path):
    case = pd.Case(
        pd.LatticeNodes((0.0, 0.0), (4.0, 1.0), 0.25),
        horizon=0.505,
        material=pd.NeoHookean(E=1000.0, nu=0.3, density=1.0),
        conditions=[pd.Clamp("-x"), pd.Traction("+x", y=0.5)],
        solver=pd.Implicit(dt=0.01, end=0.1, energy_momentum=True),
    )
    steps = pd.run(case, tmp_path).summary["steps"]
    assert len(steps) == 10 and max(step["newton_iterations"] for step in steps) <= 4


def test_a_turned_step_has_the_turned_stress():
    for law in LAWS.values():
        F_0, F_1 = deformations(2)
        c, s = np.cos(0.7), np.sin(0.7)
        R = np.array([[c, -s], [s, c]])
        plain, turned = Step(law, F_0, F_1), Step(law, R @ F_0, R @ F_1)
        assert np.abs(turned.mean - R @ plain.mean).max() < 1e-12 * np.abs(plain.mean).max()
