"""A solver from outside the package: one class that declares it, one that does it, one line in the table."""

import dataclasses

import numpy as np
import pytest
from scipy.sparse.linalg import LinearOperator, cg

import pdpetsc as pd
from pdpetsc.declare.solvers import DeclaredSolver, Needs
from pdpetsc.solvers.load_steps import LoadStepSolver
from pdpetsc.solvers.protocol import Start, StepResult
from pdpetsc.solvers.table import IMPLEMENTATIONS, implementation
from tests.commands import Stop, field


@dataclasses.dataclass(frozen=True)
class ByScipy(DeclaredSolver):
    tolerance: float = 1e-11

    title = "Newton's method with SciPy"
    needs = Needs(tangent="none")


class ScipySolver(LoadStepSolver):
    """Newton's method on one rank, with conjugate gradients of SciPy."""

    unit = "SciPy"
    advice = "take smaller steps"
    matrix_bytes = 0

    def __init__(self, setting):
        self.problem, self.steps, self.stop = setting.problem, setting.steps, setting.stop
        self._tolerance = setting.declared.tolerance

    @classmethod
    def make(cls, setting):
        return cls(setting)

    def description(self):
        return "Newton, SciPy's cg"

    def destroy(self):
        pass

    def solve(self, u, t):
        self.t = t
        fixed = self.problem.supports.fixed
        u = np.where(fixed, self.problem.supports.prescribed(t), u)
        norms = []
        for _ in range(30):
            state = self.state(u)
            r = self.problem.internal_force(state) - self.problem.external_force(state)
            reference = np.linalg.norm(r[fixed])
            norms.append(float(np.linalg.norm(r[~fixed])))
            if norms[-1] <= self._tolerance * reference:
                return u, StepResult(True, "residual below tolerance", norms, float(reference), len(norms) - 1)
            tangent = self.problem.linearised(state)

            def product(du, tangent=tangent):
                whole = np.zeros(fixed.shape)
                whole[~fixed] = du
                return tangent(whole)[~fixed].copy()

            n = int((~fixed).sum())
            du, _ = cg(LinearOperator((n, n), product), -r[~fixed], rtol=1e-12)
            u = u.copy()
            u[~fixed] += du
        return u, StepResult(False, "too many iterations", norms, float(reference), len(norms) - 1)


def strip(solver, stop=2.0):
    left, right = pd.region.Slab("x", high=0.9), pd.region.Slab("x", low=9.1)
    return pd.Case(
        particles=pd.Lattice((0.0, 0.0), (10.0, 3.0), 1.0),
        horizon=1.515,
        material=pd.NeoHookean(1.0, 0.3),
        conditions=[pd.Displacement(left, x=0.0, y=0.0), pd.Displacement(right, x=0.5)],
        steps=pd.Steps(4),
        solver=solver,
        history={"energy": pd.StrainEnergy(), "stop": Stop(stop)},
        results=lambda h: {"energy": h["energy"][-1]},
        fields=[pd.displacement],
    )


def test_a_solver_from_outside_agrees_and_goes_on(monkeypatch, tmp_path):
    monkeypatch.setitem(IMPLEMENTATIONS, ByScipy, ScipySolver)
    theirs = pd.run(strip(ByScipy()), tmp_path / "theirs")
    ours = pd.run(strip(pd.Newton()), tmp_path / "ours")
    assert theirs["energy"] == pytest.approx(ours["energy"], rel=1e-9)
    one, two = (field(tmp_path / name, "displacement") for name in ("theirs", "ours"))
    assert np.abs(one - two).max() < 1e-8
    with pytest.raises(pd.Interrupted):
        pd.run(strip(ByScipy(), 0.4), tmp_path / "half")
    pd.run(strip(ByScipy()), tmp_path / "half", restart=tmp_path / "half")
    assert np.abs(field(tmp_path / "half", "displacement") - one).max() < 1e-12


def test_a_solver_that_the_table_does_not_know_is_refused(tmp_path):
    with pytest.raises(pd.CaseError, match="No solver is known for ByScipy"):
        pd.run(strip(ByScipy()), tmp_path / "out")
    assert not (tmp_path / "out" / "summary.json").exists()


def test_a_solver_of_a_known_kind_is_done_by_that(monkeypatch):
    class Mine(pd.DynamicRelaxation):
        pass

    assert implementation(Mine()) is IMPLEMENTATIONS[pd.DynamicRelaxation]


@pytest.mark.parametrize("step", [0.0, -0.1, 1e-300])
@pytest.mark.parametrize("solver", [pd.Newton, pd.DynamicRelaxation])
def test_a_load_step_that_leads_nowhere_is_refused(solver, step):
    # Made without a problem: nothing of it is looked at before the numbers are.
    made = object.__new__(IMPLEMENTATIONS[solver])
    with pytest.raises(pd.CaseError, match="leads nowhere"):
        made.resume(Start(np.zeros((1, 1)), 0.5, {"load_step": step}))


@pytest.mark.parametrize("found", [{"measure_step": 0.0}, {"highest_load": -1.0}])
def test_a_place_on_a_path_without_meaning_is_refused(found):
    made = object.__new__(IMPLEMENTATIONS[pd.PathFollowing])
    with pytest.raises(pd.CaseError, match="has no meaning"):
        made.resume(Start(np.zeros((1, 1)), 0.5, found))
