"""Unstable equilibria are reported, shortened or refused."""

import contextlib
import dataclasses
import logging

import numpy as np
import pytest
from petsc4py import PETSc

import pdpetsc as pd
from pdpetsc.declare import region
from pdpetsc.petsc.curvature import has_negative_eigenvalue
from tests.commands import results, summary

LENGTH, E = 10.0, 1000.0
# Euler's force of a column that is clamped at one end, of unit depth and thickness.
CRITICAL = np.pi**2 * E / 12.0 / (4.0 * LENGTH**2)


def column(load=3.0, steps=24, **options):
    """Return a perfect column under a dead force along its axis: it stays straight on the unstable branch."""
    ny = 5
    dx = 1.0 / ny
    return pd.Case(
        particles=pd.Lattice((0.0, -0.5), (LENGTH, 0.5), dx, fictitious={"-x": dx}),
        horizon=1.015 * dx,
        material=pd.Hencky(E=E, nu=0.3, plane="stress"),
        scheme=pd.SubHorizons(),
        conditions=[
            pd.Displacement(region.Named("fictitious -x"), x=0.0, y=0.0),
            pd.Force(region.Slab("x", low=LENGTH - dx), x=-load),
        ],
        steps=pd.Steps(steps, **options),
        fields=[],
    )


def test_a_column_past_its_critical_force_is_called_unstable(tmp_path, caplog):
    with caplog.at_level(logging.INFO, logger="pdpetsc"):
        pd.run(column(), output=tmp_path)
    steps = summary(tmp_path)["steps"]
    unstable = [step["t"] * 3.0 for step in steps if step["negative_pivots"]]
    stable = [step["t"] * 3.0 for step in steps if step["negative_pivots"] == 0]
    assert len(stable) + len(unstable) == 24
    assert max(stable) < min(unstable)
    assert min(unstable) == pytest.approx(CRITICAL, abs=0.125 + 0.05 * CRITICAL)
    said = [record.message for record in caplog.records]
    assert any("unstable equilibrium (1 negative pivot), as after buckling or a peak load" in line for line in said)
    warned = [record.message for record in caplog.records if record.levelno == logging.WARNING]
    first = f"{len(unstable)} of 24 equilibria are unstable, first at step time {min(unstable) / 3.0:.6g}"
    assert any(line.startswith(first) for line in warned)


@pytest.mark.parametrize("unstable", ["warn", "refuse"])
def test_an_equilibrium_found_in_one_iteration_has_its_own_pivots(unstable, tmp_path):
    """They were those of the step before, whose tangent the iteration solves."""
    case = dataclasses.replace(column(load=1.3 * CRITICAL, steps=2, unstable=unstable), options={"snes_rtol": 1e-2})
    with pytest.raises(pd.SolveError, match="unstable") if unstable == "refuse" else contextlib.nullcontext():
        pd.run(case, output=tmp_path)
    found = [(step["newton_iterations"], step["negative_pivots"]) for step in summary(tmp_path)["steps"]]
    assert found == ([(1, 0)] if unstable == "refuse" else [(1, 0), (1, 1)])


def test_steps_are_shortened_towards_the_critical_force(tmp_path):
    with pytest.raises(pd.SolveError, match="unstable, with 1 negative pivot"):
        pd.run(column(unstable="shorten"), output=tmp_path)
    steps = summary(tmp_path)["steps"]
    assert not any(step["negative_pivots"] for step in steps)
    assert steps[-1]["t"] * 3.0 == pytest.approx(CRITICAL, rel=0.05)


@pytest.mark.processors
def test_an_unstable_equilibrium_is_refused(tmp_path):
    with pytest.raises(pd.SolveError, match=r"At step time 0\.[67]\d* the equilibrium is unstable"):
        pd.run(column(unstable="refuse"), output=tmp_path)


def test_a_crooked_column_finds_the_stable_branch(tmp_path):
    case = column(steps=8, unstable="refuse")
    side = pd.Force(region.Slab("x", low=LENGTH - 0.2), y=1e-3 * 3.0)
    pd.run(dataclasses.replace(case, conditions=[*case.conditions, side]), output=tmp_path)
    assert len(summary(tmp_path)["steps"]) == 8


ITERATIVE = {
    "none": {},
    "multigrid on the tangent": {"pc_type": "gamg"},
    "two levels": {"pd_jacobian": "matfree", "pc_type": "mg"},
    "a cycle of two levels": {"pd_jacobian": "matfree", "pc_type": "mg", "pc_mg_type": "multiplicative"},
    "nearest neighbours": {"pd_jacobian": "matfree", "pc_type": "cholesky"},
    "a factor": {"ksp_type": "cg", "pc_type": "lu"},
}


@pytest.mark.parametrize("how", ITERATIVE)
@pytest.mark.parametrize("ranks", [1, 2])
def test_an_iterative_solver_finds_negative_curvature(ranks, how, tmp_path):
    """Critical is 1.034 of Euler's force here. The column stays straight, so that residuals have no bending."""
    text = "from tests.solvers.test_stability import *\n\n\ndef case(load=1.0):\n"
    text += "    given = column(load=load * CRITICAL, steps=2, unstable='refuse')\n"
    text += f"    return dataclasses.replace(given, options={ITERATIVE[how]!r})\n"
    (tmp_path / "column.py").write_text(text)
    below = results(tmp_path / "column.py", "load=1.03", ranks=ranks, output=tmp_path / "below")
    assert [step["negative_pivots"] for step in below["steps"]] == [0, 0]
    with pytest.raises((pd.SolveError, AssertionError), match="the equilibrium is unstable, with 1 negative pivot"):
        results(tmp_path / "column.py", "load=1.04", ranks=ranks, output=tmp_path / "beyond")
    assert [step["negative_pivots"] for step in summary(tmp_path / "beyond")["steps"]] == [0]


@pytest.mark.parametrize("how", ["multigrid on the tangent", "two levels"])
def test_an_unstable_equilibrium_found_by_an_iterative_solver_is_reported(how, tmp_path):
    pd.run(column(load=2.0 * CRITICAL, steps=2), output=tmp_path, options=ITERATIVE[how])
    assert summary(tmp_path)["steps"][-1]["negative_pivots"] == 1


def test_two_levels_report_the_stability_at_the_end_of_the_load(tmp_path):
    pd.run(column(load=1.0, steps=2), output=tmp_path, options=ITERATIVE["two levels"])
    assert [step["negative_pivots"] for step in summary(tmp_path)["steps"]] == [None, 0]


UNKNOWN = {
    "the factor is that of nearest neighbours": {"pd_jacobian": "matfree", "pc_type": "cholesky"},
    "the factor is no symmetric one": {"pc_type": "lu"},
    "the factor is that of the first iteration": {"snes_lag_preconditioner": -2, "snes_max_it": 200},
    "the tangent is that of the first iteration": {"snes_lag_jacobian": -2, "snes_max_it": 200},
    "pivots are shifted": {"pc_factor_mat_solver_type": "petsc", "pc_factor_shift_type": "positive_definite"},
    "steps are not those of Newton's method": {"snes_type": "qn", "snes_max_it": 5000},
}


@pytest.mark.parametrize("why", UNKNOWN)
def test_where_the_tangent_is_not_what_was_factored_its_pivots_are_unknown(why, tmp_path):
    pd.run(column(load=0.5, steps=2), output=tmp_path, options=UNKNOWN[why])
    assert [step["negative_pivots"] for step in summary(tmp_path)["steps"]] == [None, None]


def test_the_factor_of_petsc_counts_as_well(tmp_path):
    pd.run(column(steps=6), output=tmp_path / "one")
    pd.run(column(steps=6), output=tmp_path / "other", options={"pc_factor_mat_solver_type": "petsc"})
    one, other = ([step["negative_pivots"] for step in summary(tmp_path / name)["steps"]] for name in ("one", "other"))
    assert one == other
    assert one[0] == 0
    assert one[-1] > 0


def test_an_unsymmetric_tangent_has_no_pivots_that_count(tmp_path):
    """A Cholesky factor would be that of its upper triangle."""
    low, high = pd.region.Slab("x", high=1.0), pd.region.Slab("x", low=7.0)
    law = pd.LinearSoftening(pd.ConstantCritical(0.5), 3.0)
    case = pd.Case(
        pd.Lattice((0.0, 0.0), (8.0, 4.0), 1.0), horizon=2.015, material=pd.LinearElastic(10.0, 0.3),
        scheme=pd.Correspondence(), control=pd.Silling(0.5), damage=law, fields=[],
        conditions=[pd.Displacement(low, x=0.0, y=0.0), pd.Displacement(high, x=0.01)],
    )  # fmt: skip
    pd.run(case, output=tmp_path / "lu")
    pd.run(case, output=tmp_path / "cholesky", options={"pc_type": "cholesky"})
    for name in ("lu", "cholesky"):
        assert [step["negative_pivots"] for step in summary(tmp_path / name)["steps"]] == [None]


def stretched(step):
    """Return the steps of a path along which a softening bond opens, in series with an elastic one."""
    law = pd.CriticalFunction(lambda length, middle: np.where(middle[:, 0] > 1.0, 0.01, 1e9))
    left, middle, right = (pd.region.Nearest((x,)) for x in (0.5, 1.5, 2.5))
    case = pd.Case(
        pd.Arrays([[0.5], [1.5], [2.5]], 1.0), horizon=1.1, material=pd.BondBased(E=100.0, calibration="lattice"),
        damage=pd.LinearSoftening(law, 1.5), fields=[],
        solver=pd.PathFollowing(pd.Opening("x", right, against=middle, step=step, end=0.014)),
        conditions=[pd.Displacement(left, x=0.0), pd.Displacement(right, x=0.1)],
    )  # fmt: skip
    prepared = pd.prepare(case)
    solver = prepared.make_solver()
    found = list(prepared.march(solver))
    solver.destroy()
    return found


def test_with_damage_held_a_path_does_not_call_the_secant_stable():
    """The tangent has a negative pivot; the secant, with which large steps settle the damage, has none."""
    small, large = stretched(0.0005), stretched(0.004)
    softening = [step for step in small if not step.result.sweeps and step.u[2] - step.u[1] > 0.0101]
    assert softening
    assert all(step.result.negative_pivots == 1 for step in softening)
    assert small[0].result.negative_pivots == 0
    assert large[-1].result.sweeps
    assert large[-1].result.negative_pivots is None


@pytest.mark.parametrize("unstable", ["shorten", "refuse"])
def test_a_run_ends_where_nothing_tells(tmp_path, unstable):
    """Without a matrix an unsymmetric tangent has no symmetric part to factor."""
    given = column(load=1.0, steps=2, unstable=unstable)
    far = pd.Contact("-y", pd.RigidPlane((0.0, -5.0), (0.0, 1.0)), friction=0.3)
    case = dataclasses.replace(given, conditions=[*given.conditions, far])
    with pytest.raises(pd.SolveError, match="nothing tells whether the equilibrium is stable"):
        pd.run(case, output=tmp_path, options={"pd_jacobian": "matfree"})
    assert summary(tmp_path)["steps"] == []


@pytest.mark.processors
def test_ranks_count_the_same_pivots(tmp_path):
    case = tmp_path / "column.py"
    case.write_text("from tests.solvers.test_stability import column\n\n\ndef case():\n    return column(steps=6)\n")
    results(case, ranks=2, output=tmp_path / "two")
    pd.run(column(steps=6), output=tmp_path / "one")
    one, two = ([step["negative_pivots"] for step in summary(tmp_path / name)["steps"]] for name in ("one", "two"))
    assert one == two
    assert 1 in one


@pytest.mark.long
def test_a_column_beyond_its_critical_load_is_the_elastica(tmp_path):
    """Loads over Euler's at 20, 40 and 60 degrees: 1.015, 1.063, 1.152."""
    bent = results("runs/stability/elastica.py", "n=4", output=tmp_path)["results"]
    for degrees, load in ((20, 1.015), (40, 1.063), (60, 1.152)):
        assert bent[f"load_{degrees}"] == pytest.approx(load, rel=0.01), degrees


@pytest.mark.parametrize("ranks", [1, 2])
def test_unsymmetric_tangents_are_judged_by_their_symmetric_part(ranks, tmp_path):
    """A tool with friction that touches nothing makes the tangent of the column unsymmetric, and does not change it."""
    text = "from tests.solvers.test_stability import *\n\n\ndef case(load=1.0):\n"
    text += "    given = column(load=load * CRITICAL, steps=2, unstable='refuse')\n"
    text += "    far = pd.Contact('-y', pd.RigidPlane((0.0, -5.0), (0.0, 1.0)), friction=0.3)\n"
    text += "    return dataclasses.replace(given, conditions=[*given.conditions, far])\n"
    (tmp_path / "column.py").write_text(text)
    below = results(tmp_path / "column.py", "load=0.9", ranks=ranks, output=tmp_path / "below")
    assert [step["negative_pivots"] for step in below["steps"]] == [0, 0]
    with pytest.raises((pd.SolveError, AssertionError), match="nothing tells whether the equilibrium is stable"):
        results(tmp_path / "column.py", "load=1.3", ranks=ranks, output=tmp_path / "beyond")
    assert [step["negative_pivots"] for step in summary(tmp_path / "beyond")["steps"]] == [0]


def test_sliding_with_friction_is_not_called_unstable(tmp_path):
    """The tangent has eigenvalues with positive real parts, its symmetric part has a negative one."""
    tool = pd.RigidPlane((0.0, 1.0), (0.0, -1.0), move=(0.3, -0.02))
    case = pd.Case(
        pd.LatticeNodes((0.0, 0.0), (2.0, 1.0), 0.125), material=pd.LinearElastic(1000.0, 0.3),
        conditions=[pd.Clamp("-y"), pd.Contact("+y", tool, friction=0.3, penetration=0.1)],
    )  # fmt: skip
    run = pd.run(dataclasses.replace(case, steps=pd.Steps(4)), tmp_path / "warn")
    assert run.history["contact_x"][-1] == pytest.approx(0.3 * abs(run.history["contact_y"][-1]), rel=1e-3)
    with pytest.raises(pd.SolveError, match="nothing tells whether the equilibrium is stable"):
        pd.run(dataclasses.replace(case, steps=pd.Steps(4, unstable="refuse")), tmp_path / "refuse")


def test_negative_definite_matrices_have_negative_eigenvalues():
    """PETSc's conjugate gradients report changes of sign of the curvature only."""
    for diagonal, negative in (([-1.0, -2.0, -3.0], True), ([1.0, 2.0, 3.0], False), ([1.0, -2.0, 3.0], True)):
        entries = np.arange(4, dtype=PETSc.IntType), np.arange(3, dtype=PETSc.IntType), np.array(diagonal)
        mat = PETSc.Mat().createAIJ((3, 3), csr=entries, comm=PETSc.COMM_SELF)
        ksp, free = PETSc.KSP().create(comm=PETSc.COMM_SELF), mat.createVecRight()
        ksp.setOperators(mat)
        free.set(1.0)
        assert has_negative_eigenvalue(ksp, free) is negative


def test_a_column_whose_response_to_its_rigid_end_is_unknown_is_not_called_stable(tmp_path):
    """Five hundred iterations solve for the response or not; the column is unstable from 2/3 of the load on."""
    euler = np.pi**2 * E / 12.0 / (4.0 * 40.0**2)
    end = pd.RigidRegion("+x", force=(-1.5 * euler, 0.0), moment=0.0, about=(40.0, 0.5))
    case = pd.Case(
        pd.LatticeNodes((0.0, 0.0), (40.0, 1.0), 0.25), horizon=2.015 * 0.25, conditions=[pd.Clamp("-x"), end],
        material=pd.NeoHookean(E=E, nu=0.3, plane="stress"), steps=pd.Steps(3, unstable="refuse"), fields=[],
    )  # fmt: skip
    with pytest.raises(
        pd.SolveError, match=r"(nothing tells whether the equilibrium is stable|the equilibrium is unstable)"
    ):
        pd.run(case, tmp_path, options={"pc_type": "jacobi", "ksp_type": "cg"})
    assert all(step["t"] < 0.66 for step in summary(tmp_path)["steps"])
