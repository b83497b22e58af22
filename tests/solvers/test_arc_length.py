"""Paths by arc length: an arch that snaps through, ranks, restart."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import pdpetsc as pd
from pdpetsc.command_line.cli import load_case
from tests.commands import ROOT, Stop, results

ARCH = "runs/stability/arch.py"


@pytest.mark.long
def test_an_arch_snaps_through(tmp_path):
    """The load rises to a limit, falls and rises again, as that of a shallow arch; 1 and 2 ranks."""
    one, two = (
        results(ARCH, "n=4", "step=0.04", ranks=ranks, output=tmp_path / str(ranks))["results"] for ranks in (1, 2)
    )
    # At four cells over the height the arch is too stiff in bending.
    assert one["upper"] == pytest.approx(1.0, abs=0.08)
    assert one["lower"] == pytest.approx(0.0, abs=0.25)
    for name, value in one.items():
        assert two[name] == pytest.approx(value, rel=1e-5)


def test_steps_have_the_length_that_they_should(tmp_path):
    case = dataclasses.replace(load_case(ROOT / ARCH)(n=2, step=0.05), expect={}, results=None, picture=None)
    run = pd.run(case, tmp_path)
    t = run.history["t"]
    assert (np.diff(t) > 0.0).any() and (np.diff(t) < 0.0).any()
    last = np.zeros((len(run.x), 3))
    lengths = []
    for step in range(1, len(t)):
        u = run.field("displacement", step)
        lengths.append(np.sqrt(((u - last) ** 2).sum(axis=1).mean()))
        last = u
    # Nodes of half a cell count half, so that the plain mean differs a little.
    assert max(lengths[1:]) < 0.05 * 1.1
    assert sum(lengths) == pytest.approx(case.solver.measure.end, rel=0.05)


def coarse_arch(**options):
    """Return the arch with three cells over the height and solver options."""
    case = load_case(ROOT / ARCH)(n=3, step=0.05)
    return dataclasses.replace(case, expect={}, results=None, picture=None, options=options)


def test_iterative_solvers_pass_the_limit_of_the_load(tmp_path):
    """Beyond the limit, the tangent and its preconditioners are indefinite; the path is that of the direct solver."""
    direct = pd.run(coarse_arch(), tmp_path / "direct").history
    for name, options in {"levels": {"pd_jacobian": "matfree"}, "gamg": {"pc_type": "gamg"}}.items():
        found = pd.run(coarse_arch(**options), tmp_path / name).history
        np.testing.assert_allclose(found["t"], direct["t"], rtol=1e-5)
        np.testing.assert_allclose(found["top"], direct["top"], rtol=1e-5)


def test_a_path_names_the_linear_solver_that_failed(tmp_path):
    """MINRES needs a positive definite preconditioner; a solve that fails without an iteration ends Newton's method."""
    with pytest.raises(pd.SolveError, match="the linear solver failed"):
        pd.run(coarse_arch(pd_jacobian="matfree", ksp_type="minres"), tmp_path)


def test_a_restart_goes_on_along_the_path(tmp_path):
    """Beyond the limit the direction of the last step distinguishes both ways along the path."""
    case = dataclasses.replace(load_case(ROOT / ARCH)(n=2, step=0.1), expect={}, results=None, picture=None)
    whole = pd.run(case, tmp_path / "whole").history
    number = int(np.argmin(np.diff(whole["t"]))) + 1
    assert whole["t"][number] < whole["t"][number - 1]
    stopped = dataclasses.replace(case, history={**case.history, "stop": Stop(number, "step")})
    with pytest.raises(pd.Interrupted):
        pd.run(stopped, tmp_path / "part")
    rest = pd.run(case, tmp_path / "rest", restart=tmp_path / "part").history
    assert 1 < len(rest["t"]) < len(whole["t"])
    for name in ("t", "top"):
        np.testing.assert_allclose(rest[name], whole[name][-len(rest[name]) :], rtol=1e-9)


def test_a_path_by_its_length_does_not_continue_the_value_of_another_measure(tmp_path):
    """The length begins at 0 then, so that it exceeds an end below the opening that was reached."""
    right = pd.region.Nearest((4.0, 0.5))

    def case(measure):
        return pd.Case(
            pd.LatticeNodes((0.0, 0.0), (4.0, 1.0), 0.25), material=pd.J2(1000.0, 0.3, yield_stress=1e9),
            conditions=[pd.Clamp("-x"), pd.Traction("+x", x=200.0)],
            solver=pd.PathFollowing(measure, first=0.2, until=0.0), fields=[],
        )  # fmt: skip

    pd.run(case(pd.Opening("x", right, step=0.1, end=0.5)), tmp_path / "opening")
    rest = pd.run(case(pd.ArcLength(step=0.05, end=0.2)), tmp_path / "length", restart=tmp_path / "opening")
    assert len(rest.history["t"]) > 2
