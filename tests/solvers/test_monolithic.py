"""Temperature and displacement in one Newton's method: against the staggered solve, differences, ranks, restarts."""

import dataclasses

import numpy as np
import pytest

import pdpetsc as pd
from pdpetsc.solvers.monolithic import MonolithicSolver
from tests.commands import ROOT, Stop, field, results

LAWS = {
    "linear": lambda plane: pd.LinearElastic(100.0, 0.3, plane),
    "neo": lambda plane: pd.NeoHookean(100.0, 0.3, plane),
    "hencky": lambda plane: pd.Hencky(100.0, 0.3, plane),
    "metal": lambda plane: pd.J2(E=100.0, nu=0.3, yield_stress=0.5, hardening=5.0, plane=plane),
    "viscous": lambda plane: pd.J2(
        E=100.0, nu=0.3, yield_stress=0.5, hardening=5.0, plane=plane, rate=pd.rate.Perzyna(1.0, rate_0=0.5, drag=0.3)
    ),
}


def case(coupling="monolithic", law="neo", plane="strain", duration=1.0, rule="backward_euler", n=8, dim=2, **changes):
    """Return a body that is pulled while it gets hot, swells and gets softer."""
    dx = 1.0 / n
    depends = {"factor": lambda T: 1.0 / (1.0 + 0.3 * T)}
    if law in ("metal", "viscous"):
        base = LAWS[law](plane)
        depends = {"law": lambda T: dataclasses.replace(base, yield_stress=0.5 / (1.0 + 0.2 * T))}
    hot = {"conductivity": (1.0, 2.0, 1.5), "orientation": 0.3, "capacity": 2.0, **depends}
    low, high = pd.region.Slab("x", high=dx), pd.region.Slab("x", low=1.0 - dx)
    declared = {
        "particles": pd.Lattice((0.0,) * dim, (1.0,) + (0.5,) * (dim - 1), dx),
        "horizon": 2.015 * dx,
        "material": pd.Thermal(LAWS[law](plane), lambda T: 0.05 + 0.01 * T, **hot),
        "scheme": pd.Correspondence(),
        "control": pd.Silling(0.5),
        "heat": pd.HeatConduction(duration=duration, rule=rule, coupling=coupling),
        "conditions": [
            pd.Displacement(low, **dict.fromkeys("xyz"[:dim], 0.0)),
            pd.Displacement(high, x=0.08),
            pd.Temperature(low, 1.0, schedule=pd.Hold()),
            pd.HeatSource(high, 1.0, schedule=pd.Hold()),
        ],
        "steps": pd.Steps(3),
        "history": {"pull": pd.Reaction("x", high)},
        "fields": [pd.displacement, pd.temperature],
    }
    return pd.Case(**(declared | changes))


@pytest.mark.parametrize(
    ("law", "changes"),
    [
        ("linear", {}),
        ("neo", {"rule": "crank_nicolson"}),
        ("hencky", {"plane": "stress"}),
        ("metal", {}),
        ("neo", {"duration": None}),
        pytest.param("neo", {"dim": 3, "n": 6}, marks=pytest.mark.long),
    ],
)
def test_both_ways_find_the_same(law, changes, tmp_path):
    """To the tolerance of Newton's method; one linear iteration each, as the tangent is exact and the split too."""
    found = [pd.run(case(coupling, law, **changes), tmp_path / coupling) for coupling in ("staggered", "monolithic")]
    T, other = (run.gathered(pd.temperature) for run in found)
    assert np.allclose(T, other, rtol=1e-9, atol=1e-10)
    assert np.ptp(T) > 0.05
    u, other = (run.gathered(pd.displacement) for run in found)
    assert np.abs(u - other).max() < 1e-8 * np.abs(u).max()
    assert found[0].history["pull"][-1] == pytest.approx(found[1].history["pull"][-1], rel=1e-8)


@pytest.mark.parametrize("plane", ["strain", "stress"])
@pytest.mark.parametrize("law", ["neo", "hencky"])
def test_newton_converges_quadratically_in_one_linear_iteration_each(law, plane, tmp_path):
    run = pd.run(case(law=law, plane=plane, steps=pd.Steps(1)), tmp_path)
    (step,) = run.summary["steps"]
    norms = step["norms"]
    assert norms[-2] < 1e-3 * norms[0]
    assert norms[-1] < 1e-3 * norms[-2]
    assert step["linear_iterations"] == step["newton_iterations"] + 1  # and the one that the step begins with


def test_stability_is_still_judged():
    """By the pivots of the displacement, whose tangent is factored in the split."""
    prepared = pd.prepare(case(steps=pd.Steps(1, unstable="refuse")))
    solver = prepared.make_solver()
    assert isinstance(solver, MonolithicSolver)
    try:
        for converged in prepared.march(solver):
            assert converged.result.negative_pivots == 0
    finally:
        solver.destroy()


CASE = """
import sys

sys.path.insert(0, {root!r})
from tests.commands import Stop
from tests.solvers.test_monolithic import case as scene
import pdpetsc as pd


def case(stop=2.0):
    high = pd.region.Slab("x", low=0.875)
    return scene(history=dict(pull=pd.Reaction("x", high), stop=Stop(stop)), results=lambda h: dict(pull=h["pull"][-1]))
"""


@pytest.mark.long
def test_ranks_restarts_and_solvers_of_the_parts_give_the_same(tmp_path):
    path = tmp_path / "hot.py"
    path.write_text(CASE.format(root=str(ROOT)))
    whole = results(path, output=tmp_path / "1")["results"]["pull"]
    assert results(path, ranks=2, output=tmp_path / "2")["results"]["pull"] == pytest.approx(whole, rel=1e-9)
    assert np.allclose(field(tmp_path / "1", "temperature"), field(tmp_path / "2", "temperature"), rtol=1e-9)
    high = pd.region.Slab("x", low=0.875)
    with pytest.raises(pd.Interrupted):
        pd.run(case(history={"pull": pd.Reaction("x", high), "stop": Stop(0.5)}), tmp_path / "part")
    again = ("--restart", tmp_path / "part" / "checkpoint.h5")
    found = results(path, *again, ranks=2, output=tmp_path / "rest")["results"]["pull"]
    assert found == pytest.approx(whole, rel=1e-9)
    options = (
        "-fieldsplit_displacement_ksp_type", "cg", "-fieldsplit_displacement_pc_type", "gamg",
        "-fieldsplit_displacement_ksp_rtol", "1e-6", "-fieldsplit_temperature_pc_type", "jacobi",
        "-fieldsplit_temperature_ksp_type", "cg",
    )  # fmt: skip
    found = results(path, *options, output=tmp_path / "parts")
    assert found["results"]["pull"] == pytest.approx(whole, rel=1e-8)
    assert not found.get("unused_options")


def test_a_temperature_that_is_nowhere_ends_the_run(tmp_path):
    """A steady source that nothing takes away: the same words as the staggered solve has."""
    loose = case(duration=None)
    island = pd.Segment((0.5, -1.0), (0.5, 2.0))
    for coupling in ("staggered", "monolithic"):
        heat = dataclasses.replace(loose.heat, coupling=coupling)
        held = [*loose.conditions, pd.Displacement(pd.region.Slab("x", low=0.875), y=0.0)]
        family_strain = dataclasses.replace(loose, heat=heat, cracks=[island], conditions=held)
        with pytest.raises(pd.SolveError, match="a piece of the body gains heat that nothing takes away"):
            pd.run(family_strain, tmp_path / coupling)


FAILING = {
    "brittle": {"damage": pd.Brittle(pd.ConstantCritical(0.04))},
    "softening": {"damage": pd.LinearSoftening(pd.ConstantCritical(0.04), 3.0)},
    "bonds": {
        "material": pd.Thermal(pd.BondBased(100.0), 0.1, conductivity=1.0, capacity=1.0), "scheme": None,
        "control": None, "damage": pd.Brittle(pd.ConstantCritical(0.01)),
    },
    "intact_bonds": {
        "material": pd.Thermal(pd.BondBased(100.0), 0.1, conductivity=1.0, capacity=1.0), "scheme": None,
        "control": None,
    },
    "dilatation": {
        "material": pd.Thermal(pd.LinearElastic(100.0, 0.49), 0.1, conductivity=1.0, capacity=1.0),
        "scheme": pd.MeanDilatation(pd.Correspondence(), 0.25), "control": pd.ByShear(pd.Silling(0.5)),
    },
}  # fmt: skip


@pytest.mark.parametrize("name", FAILING)
def test_bonds_that_fail_bodies_of_bonds_and_shared_dilatation_are_as_in_the_staggered_solve(name, tmp_path):
    changes = FAILING[name]
    if "damage" in changes:
        changes = changes | {"history": {"broken": pd.BrokenBonds()}}
    found = [pd.run(case(coupling, **changes), tmp_path / coupling) for coupling in ("monolithic", "staggered")]
    for quantity in (pd.temperature, pd.displacement):
        one, other = (run.gathered(quantity) for run in found)
        assert np.abs(one - other).max() < 1e-7 * np.abs(other).max()
    if "damage" in changes:
        monolithic, staggered = (run.history["broken"] for run in found)
        assert np.array_equal(monolithic, staggered)
        assert staggered[-1] > 0


def test_what_cannot_be_solved_together_is_refused(tmp_path):
    with pytest.raises(pd.CaseError, match='take coupling="staggered"'):
        pd.run(case(solver=pd.DynamicRelaxation()), tmp_path)
    with pytest.raises(pd.CaseError, match="need a matrix"):
        pd.run(case(), tmp_path, options={"pd_jacobian": "matfree"})
