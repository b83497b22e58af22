"""Steps that switch from an unstable equilibrium to a stable branch: elastica, ranks, units, restart, refusals."""

import dataclasses

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import ellipk

import pdpetsc as pd
from tests.commands import Stop, results
from tests.solvers.test_snap import arch
from tests.solvers.test_stability import CRITICAL, LENGTH, column
from tests.units import in_units

END = pd.region.Slab("x", low=LENGTH - 0.2)


def switching(steps=6, load=3.0, **changes):
    """Return a perfect column under a growing force, without any imperfection."""
    case = column(load=load, steps=steps, unstable="switch")
    history = {axis: pd.Mean(pd.displacement, axis, END) for axis in "xy"}
    return dataclasses.replace(case, history=history, **changes)


def square(steps=2):
    """Return a column with a square section, which bends to all sides alike."""
    load = 1.3 * np.pi**2 * 1000.0 / 12.0 / (4.0 * 8.0**2)
    return pd.Case(
        particles=pd.LatticeNodes((0.0, 0.0, 0.0), (8.0, 1.0, 1.0), 0.5),
        horizon=1.0075,
        material=pd.NeoHookean(E=1000.0, nu=0.0),
        conditions=[pd.Clamp("-x"), pd.Traction("+x", x=-2.0 * load)],
        steps=pd.Steps(steps, unstable="switch"),
        history={axis: pd.Mean(pd.displacement, axis, "+x") for axis in "xyz"},
        fields=[],
    )


def elastica(ratio):
    """Return the deflection of the end over the length, at a load over Euler's (Timoshenko and Gere, section 2.7)."""
    k = brentq(lambda k: (2.0 / np.pi * ellipk(k * k)) ** 2 - ratio, 1e-9, 1.0 - 1e-9)
    return 2.0 * k / ellipk(k * k)


@pytest.fixture(scope="module")
def switched(tmp_path_factory):
    return pd.run(switching(), tmp_path_factory.mktemp("switched") / "run")


@pytest.mark.processors
def test_a_perfect_column_switches_to_the_elastica(tmp_path, caplog):
    with caplog.at_level("INFO", logger="pdpetsc"):
        run = pd.run(switching(24), tmp_path)
    steps = run.summary["steps"]
    assert all(step["negative_pivots"] == 0 for step in steps)
    (number,) = (number for number, step in enumerate(steps) if "switched" in step)
    assert run.summary["switched_steps"] == 1
    # The critical load is between those of the last straight and the first bent column.
    assert 3.0 * steps[number - 1]["t"] < 1.05 * CRITICAL
    assert 3.0 * steps[number]["t"] > 0.95 * CRITICAL
    y = run.history["y"]
    np.testing.assert_allclose(y[: number + 1], 0.0, atol=1e-9)
    assert y[-1] == pytest.approx(LENGTH * elastica(3.0 / CRITICAL), rel=0.02)
    assert any("switched to the stable branch" in record.message for record in caplog.records)


def test_a_coarse_step_lands_on_the_same_branch(switched, tmp_path):
    fine = pd.run(switching(12), tmp_path)
    assert fine.history["y"][-1] == pytest.approx(switched.history["y"][-1], rel=1e-6)


def test_a_step_far_beyond_the_critical_load_is_halved(tmp_path):
    run = pd.run(switching(1, load=20.0), tmp_path)
    steps = run.summary["steps"]
    assert run.summary["switched_steps"] == 1
    assert "no stable one was found" in steps[0]["cut_backs"][0]["reason"]
    assert not any(step["negative_pivots"] for step in steps)


@pytest.mark.processors
@pytest.mark.parametrize("make", ["switching", "square"])
def test_ranks_switch_to_the_same_side(make, tmp_path):
    """The eigenvectors of a square column are any combination of two. Along their sum it is unstable once more."""
    case = tmp_path / "column.py"
    case.write_text(f"from tests.solvers.test_branches import {make}\n\n\ndef case():\n    return {make}()\n")
    one, two = (tmp_path / str(ranks) for ranks in (1, 2))
    results(case, ranks=1, output=one)
    results(case, ranks=2, output=two)
    a, b = pd.open(one), pd.open(two)
    assert a.summary["switched_steps"] == b.summary["switched_steps"] == 1
    for axis in a.history:
        np.testing.assert_allclose(a.history[axis], b.history[axis], rtol=1e-6, atol=1e-6)
    assert max(abs(a.history[axis][-1]) for axis in a.history if axis != "x") > 1.0


@pytest.mark.parametrize(("force", "length"), [(1e6, 1e-6), (1e-6, 1e6), (1.0, 1e6)])
def test_units_do_not_matter(force, length, switched, tmp_path):
    case = dataclasses.replace(in_units(switching(), force, length), history={})
    run = pd.run(case, tmp_path)
    assert [step.get("switched", 0.0) / length for step in run.summary["steps"]] == pytest.approx(
        [step.get("switched", 0.0) for step in switched.summary["steps"]], rel=1e-6
    )


@pytest.mark.parametrize("after", [0.6, 0.8])
def test_a_restart_goes_on_along_the_branch(after, switched, tmp_path):
    """The run stops in the step before the switch, or in the switched one, and continues from the step before it."""
    case = switching()
    with pytest.raises(pd.Interrupted):
        pd.run(dataclasses.replace(case, history={**case.history, "stop": Stop(after)}), tmp_path / "part")
    rest = pd.run(case, tmp_path / "rest", restart=tmp_path / "part", restart_anyway=True)
    assert rest.summary["switched_steps"] == 1
    assert np.array_equal(rest.solution.u, switched.solution.u)


def test_a_limit_of_the_load_has_no_branch(tmp_path):
    """A shallow arch jumps to a stable equilibrium, as without branch switching."""
    runs = [
        pd.run(arch(pd.Newton(), steps=pd.Steps(10, unstable=unstable)), tmp_path / unstable)
        for unstable in ("warn", "switch")
    ]
    assert runs[1].summary["switched_steps"] == 0
    np.testing.assert_array_equal(*(run.history["middle"] for run in runs))


@pytest.mark.long
def test_a_perfect_column_of_nodes_is_the_elastica(tmp_path):
    found = results("runs/stability/elastica.py", "n=4", "imperfection=0", output=tmp_path)
    assert found["switched_steps"] == 1
    assert found["results"]["error"] < 0.01


def test_a_deep_beam_buckles_sideways(tmp_path):
    """One cell over the width is more than twice too stiff: modes and pivots agree, and the beam leaves its plane."""
    lateral = "runs/stability/lateral.py"
    found = results(lateral, "n=1", "load=2.25", output=tmp_path / "modes")
    critical = 2.25 * found["results"]["buckling_1"]
    bent = results(lateral, "n=1", f"load={1.1 * critical}", "unstable=switch", "steps=20", output=tmp_path / "bent")
    (number,) = (number for number, step in enumerate(bent["steps"]) if "switched" in step)
    before, after = (1.1 * bent["steps"][k]["t"] for k in (number - 1, number))
    assert before < 1.03 and after > 0.99
    sideways = pd.open(tmp_path / "bent").history["sideways"]
    assert sideways[number - 1] == pytest.approx(0.0, abs=1e-6)
    assert sideways[-1] > 5.0


def refused(what):
    """Return a column that cannot switch."""
    case = switching()
    if what == "symmetric tangent":
        pressure = pd.FollowerPressure("+y", 1e-3)
        return dataclasses.replace(case, conditions=[*case.conditions, pressure])
    if what == "damage":
        return dataclasses.replace(case, damage=pd.LinearSoftening(pd.ConstantCritical(0.5), 3.0))
    if what == "elastic body":
        return dataclasses.replace(case, material=pd.J2(E=1000.0, nu=0.3, plane="strain", yield_stress=1.0))
    return dataclasses.replace(
        case, solver=pd.SnapThrough(dt=1.0, end=10.0), material=pd.Hencky(E=1000.0, nu=0.3, density=1.0, plane="stress")
    )


@pytest.mark.parametrize("what", ["symmetric tangent", "damage", "elastic body", "Newton()"])
def test_what_has_no_eigenvectors_is_refused(what, tmp_path):
    with pytest.raises(pd.CaseError) as error:
        pd.run(refused(what), tmp_path)
    assert str(error.value).startswith('Steps(unstable="switch")')
    assert what in str(error.value)
    assert not (tmp_path / "summary.json").exists()


@pytest.mark.parametrize("options", [{"pc_type": "gamg"}, {"pd_jacobian": "matfree", "pc_type": "mg"}])
def test_an_iterative_solver_switches_to_the_same_branch(options, switched, tmp_path):
    """GMRES solves the indefinite systems at which conjugate gradients stop."""
    run = pd.run(switching(), tmp_path, options=options)
    assert run.summary["switched_steps"] == 1
    assert all(step["negative_pivots"] == 0 for step in run.summary["steps"])
    np.testing.assert_allclose(run.history["y"], switched.history["y"], rtol=1e-6, atol=1e-6)
