"""Slow modes that a preconditioner learns from solves by MINRES."""

import numpy as np
import pytest
from petsc4py import PETSc

from pdpetsc.petsc.shell import Shell
from pdpetsc.petsc.slow_modes import MOST, SlowModes
from tests.commands import ROOT, results, summary

N = 400
# Six eigenvalues, two of them negative, far below the others.
SLOW = np.array([-3e-2, -1e-4, 2e-4, 1e-3, 1e-2, 5e-2])


class Solver:
    """MINRES for a symmetric matrix in units of the preconditioner, which learns its slow modes."""

    def __init__(self, rng, unit, slow=SLOW):
        self.axes = np.linalg.qr(rng.standard_normal((N, N)))[0]
        self.scale = unit * rng.uniform(0.5, 2.0, N)
        self.modes = SlowModes(PETSc.Mat().createAIJ((N, N), csr=self.csr(np.diag(self.scale)), comm=PETSc.COMM_SELF))
        self.take(slow)
        size = (N, N)
        self.mat = PETSc.Mat().createPython(size, context=Shell(self.product), comm=PETSc.COMM_SELF)
        self.mat.setUp()
        self.ksp = PETSc.KSP().create(PETSc.COMM_SELF)
        self.ksp.setOperators(self.mat)
        self.ksp.setType("minres")
        self.ksp.getPC().setType("python")
        self.ksp.getPC().setPythonContext(Shell(self.precondition))
        self.ksp.setTolerances(rtol=1e-8, max_it=500)
        self.learns = False

    @staticmethod
    def csr(dense):
        return np.arange(N + 1, dtype=PETSc.IntType), np.arange(N, dtype=PETSc.IntType), np.diag(dense).copy()

    def take(self, slow):
        """Set the eigenvalues over the preconditioner: the slow ones, and others between 0.5 and 2."""
        root = np.sqrt(self.scale)
        values = np.concatenate([slow, np.linspace(0.5, 2.0, N - len(slow))])
        self.K = root[:, None] * (self.axes * values) @ self.axes.T * root

    def product(self, x, y):
        y.array = self.K @ x.array_r
        if self.learns:
            self.modes.watch(x.array_r, y.array_r)

    def precondition(self, r, z):
        z.array = r.array_r / self.scale
        self.modes.add(r, z)

    def solve(self, rng):
        """Solve for another load; return iterations and the error."""
        b, x = self.mat.createVecs()
        b.array = rng.standard_normal(N)
        self.learns = True
        self.ksp.solve(b, x)
        self.learns = False
        self.modes.keep()
        exact = np.linalg.solve(self.K, b.array_r)
        return self.ksp.getIterationNumber(), np.linalg.norm(x.array_r - exact) / np.linalg.norm(exact)


@pytest.mark.parametrize("unit", [1.0, 1e-9, 1e12])
def test_the_next_solve_takes_half_the_iterations_of_the_first_one_in_all_units(unit):
    rng = np.random.default_rng(2)
    solver = Solver(rng, unit)
    first, error = solver.solve(rng)
    assert error < 1e-3
    for _ in range(3):
        again, error = solver.solve(rng)
        assert 2 * again < first
        assert error < 1e-3
    assert np.sort(solver.modes.stiffness)[0] < 0.0


def test_modes_follow_the_tangent_and_leave_it_where_they_are_slow_no_more():
    """The harmonic Ritz values of a new tangent are its eigenvalues, since its eigenvectors are those of the last."""
    rng = np.random.default_rng(3)
    solver = Solver(rng, 1.0)
    for _ in range(3):
        solver.solve(rng)
        solver.modes.renew(solver.mat, solver.ksp.getPC())
    assert len(SLOW) <= len(solver.modes.stiffness) <= MOST
    other = np.array([0.7, 3e-2, -2e-2, 8e-2, 0.9, 4e-2])
    solver.take(other)
    solver.modes.renew(solver.mat, solver.ksp.getPC())
    found = np.sort(solver.modes.stiffness)
    assert found[:4] == pytest.approx(np.sort(other)[:4], rel=1e-3)
    assert (np.abs(found) < 0.2).all()
    _, error = solver.solve(rng)
    assert error < 1e-4


def test_the_preconditioner_with_slow_modes_is_positive_definite_where_the_tangent_is_not():
    """Verdicts of conjugate gradients on negative curvature need this."""
    rng = np.random.default_rng(4)
    solver = Solver(rng, 1.0)
    solver.solve(rng)
    x, z = solver.mat.createVecs()
    dense = np.empty((N, N))
    for i, unit in enumerate(np.eye(N)):
        x.array = unit
        solver.precondition(x, z)
        dense[:, i] = z.array_r
    assert np.abs(dense - dense.T).max() < 1e-9 * np.abs(dense).max()
    assert np.linalg.eigvalsh(dense).min() > 0.0
    assert np.linalg.eigvalsh(solver.K).min() < 0.0


def test_no_mode_is_kept_of_a_tangent_without_slow_ones_or_of_a_solve_that_overflowed():
    rng = np.random.default_rng(5)
    solver = Solver(rng, 1.0, slow=np.empty(0))
    solver.solve(rng)
    assert len(solver.modes.stiffness) == 0
    solver.modes.watch(np.ones(N), np.full(N, np.nan))
    solver.modes.keep()
    assert len(solver.modes.stiffness) == 0


@pytest.mark.long
@pytest.mark.processors
def test_a_crack_in_space_is_followed_in_fewer_iterations_alike_on_two_ranks_and_without_slow_modes(tmp_path):
    """Measured: 1304 linear iterations with slow modes, on one rank and on two."""
    path, words = ROOT / "runs/fracture/torsion.py", ("n=6", "end=0.04", "-pd_jacobian", "matfree")
    plain, one, two = (tmp_path / name for name in ("plain", "one", "two"))
    results(path, *words, "-mg_levels_pc_type", "pbjacobi", output=plain)
    results(path, *words, output=one)
    results(path, *words, ranks=2, output=two)
    found = summary(one)["results"]
    for other in (two, plain):
        assert summary(other)["results"] == pytest.approx(found, rel=1e-8)
    with_modes, without = (sum(step["linear_iterations"] for step in summary(run)["steps"]) for run in (one, plain))
    assert with_modes < 0.75 * without
