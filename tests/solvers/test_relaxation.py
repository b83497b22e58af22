"""Adaptive dynamic relaxation: the same equilibrium as Newton, on any rank count, without a matrix."""

import dataclasses

import numpy as np
import pytest

import pdpetsc as pd
from tests.commands import called, field, results

BLOCK = "runs/patch/block.py"


@pytest.mark.parametrize(
    "scheme", ["correspondence", "sub_horizons", pytest.param("stress_points", marks=pytest.mark.long)]
)
def test_relaxation_finds_the_equilibrium_of_newton(scheme, tmp_path):
    arguments = ("n=6", f"scheme={scheme}")
    newton = results(BLOCK, *arguments, output=tmp_path / "newton")
    relaxed = results(BLOCK, *arguments, "--solver", "relaxation", output=tmp_path / "relaxed", ranks=2)
    one, other = (field(tmp_path / name, "displacement") for name in ("newton", "relaxed"))
    assert np.abs(one - other).max() < 1e-5 * np.abs(one).max()
    assert "tangent matrix" in newton["allocated"]
    assert "tangent matrix" not in relaxed["allocated"]
    assert "matrix_bytes" not in relaxed
    assert relaxed["steps"][0]["relaxation_iterations"] > 30


def test_the_singular_bar_relaxes(tmp_path):
    found = results(
        "runs/singular_bar/bar.py", "n=100", "scheme=stress_points", "--solver", "relaxation", output=tmp_path
    )["results"]
    assert found["error"] == pytest.approx(0.06475, rel=1e-3)
    assert found["sawtooth"] < 1e-8


def test_a_case_declares_its_tolerance_and_its_end(tmp_path):
    case = pd.Case(
        particles=pd.Lattice((0.0,), (1.0,), 0.1),
        horizon=0.1015,
        material=pd.LinearElastic(E=2.0, nu=0.0),
        scheme=pd.SubHorizons(),
        conditions=[pd.Displacement(pd.region.Nearest((0.05,)), x=0.0), pd.Force(pd.region.Nearest((0.95,)), x=1e-3)],
        solver=pd.DynamicRelaxation(tolerance=1e-9),
        history={"u": pd.At((0.95,), pd.displacement, "x")},
        results=lambda h: {"u": h["u"][-1]},
    )
    loose = pd.DynamicRelaxation(tolerance=1e-9, most=3)
    exact = pd.run(dataclasses.replace(case, solver=pd.Newton()), output=tmp_path)["u"]
    assert pd.run(case, output=tmp_path)["u"] == pytest.approx(exact, rel=1e-7)
    with pytest.raises(pd.SolveError, match="too many time steps"):
        pd.run(dataclasses.replace(case, solver=loose), output=tmp_path)


@pytest.mark.parametrize("wrong", [{"tolerance": 0.0}, {"tolerance": 2.0}, {"most": 0}])
def test_wrong_options_are_refused(wrong):
    with pytest.raises(pd.CaseError, match="DynamicRelaxation takes"):
        pd.DynamicRelaxation(**wrong)


def test_an_unknown_solver_is_refused(tmp_path):
    finished = called(BLOCK, "--solver", "magic", "-o", tmp_path)
    assert finished.returncode == 2
    assert "--solver is one of newton, relaxation, events, path, not 'magic'" in finished.stderr


def test_a_load_that_fails_does_not_judge_the_next_one():
    """A shorter step after it begins as far from equilibrium as ever."""
    left, right = pd.region.Slab("x", high=1.0), pd.region.Slab("x", low=5.0)
    case = pd.Case(
        particles=pd.Lattice((0.0, 0.0), (6.0, 2.0), 1.0),
        horizon=1.515,
        material=pd.LinearElastic(10.0, 0.3, "stress"),
        conditions=[pd.Displacement(left, x=0.0, y=0.0), pd.Force(right, x=1.0)],
        solver=pd.DynamicRelaxation(tolerance=1e-3, most=5000),
    )
    solver = pd.prepare(case).make_solver()
    nothing = np.zeros((12, 2))
    alone, result = solver.solve(nothing, 1e-3)
    assert result.converged
    solver._options = pd.DynamicRelaxation(tolerance=1e-3, most=3)
    assert not solver.solve(nothing, 1e9)[1].converged
    solver._options = case.solver
    after, result = solver.solve(nothing, 1e-3)
    assert result.converged
    assert np.abs(after - alone).max() <= 1e-9 * np.abs(alone).max()
