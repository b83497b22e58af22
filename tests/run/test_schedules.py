"""Tables of which the steps of a run see a part only."""

import numpy as np
import pytest

import pdpetsc as pd
from pdpetsc.running.schedules import schedule_warnings

PEAK = pd.Table([0.0, 0.5, 1.0], [0.0, 1.0, 0.0])
PULSE = pd.Table([0.0, 0.01, 0.02, 0.03, 1.0], [0.0, 0.0, 1.0, 0.0, 0.0])
LAW = pd.LinearElastic(100.0, 0.0, density=1.0)


def bar(*conditions, **changes):
    return pd.Case(pd.LatticeNodes((0.0, 0.0), (2.0, 1.0), 0.5), material=LAW, conditions=conditions, **changes)


def pulled(schedule, **changes):
    history = {"u": pd.Mean(pd.displacement, "x", pd.region.Face("+x"))}
    return bar(pd.Clamp("-x"), pd.Displacement("+x", x=1.0, schedule=schedule), history=history, **changes)


def test_adaptive_steps_end_at_the_times_of_tables(tmp_path):
    """Times between which the factor goes on rising or falling are none; declared times stay."""
    found = pd.run(pulled(PEAK, steps=pd.AdaptiveSteps()), tmp_path / "peak").history
    assert found["u"].max() == pytest.approx(1.0, rel=1e-6)
    table = pd.Table([0.0, 0.13, 0.27, 0.4, 0.81 + 1e-9, 2.0], [0.0, 0.13, 0.27, 0.5, 0.0, 0.0])
    tool = pd.RigidPlane((0.0, 1.1), (0.0, -1.0), move=(0.0, -0.01), schedule=[pd.Ramp(), PEAK])
    case = pulled(table, steps=pd.AdaptiveSteps(largest=1.0, times=(0.81, 1.0)))
    case = pd.prepare(bar(*case.conditions, pd.Contact("+y", tool), steps=case.steps)).case
    assert case.steps.stops() == [0.4, 0.5, 0.81, 1.0]


def test_time_steps_of_limited_error_end_at_the_times_of_tables(tmp_path):
    """A pulse within the first step moves the body; without a step that ends there nothing would."""
    solver = pd.Implicit(dt=0.1, end=10.0, error=1e-3)
    pulse = pd.Traction("+x", x=1.0, schedule=pd.Table([0.0, 0.004, 0.005, 0.006, 1.0], [0.0, 0.0, 1.0, 0.0, 0.0]))
    found = pd.run(bar(pulse, solver=solver, history={"u": pd.Mean(pd.displacement, "x")}), tmp_path).history
    for time in (0.04, 0.05, 0.06):
        assert np.abs(found["time"] - time).min() == pytest.approx(0.0, abs=1e-9)
    # Impulse over mass: traction 1 for a mean of 0.01 s on a column of two units length and density one.
    assert np.diff(found["u"])[-1] / np.diff(found["time"])[-1] == pytest.approx(0.005, rel=1e-3)


@pytest.mark.parametrize(
    ("schedule", "steps", "told"),
    [
        (PEAK, pd.Steps(1), "the factor 1 at load parameter 0.5, between two steps"),
        (PEAK, pd.Steps(3), "it is at most 0.6667. End a step there"),
        (PEAK, pd.Steps(times=(0.5, 1.0)), ""),
        (PEAK, pd.Steps(8), ""),
        (PEAK, pd.AdaptiveSteps(), ""),
        (pd.Table([0.0, 0.5, 1.0], [0.0, -1.0, 0.5]), pd.Steps(3), "the factor -1 at load parameter 0.5"),
        (pd.Table([0.0, 0.3, 1.0], [1.0, 1.005, 0.0]), pd.Steps(1), ""),
        (pd.Table([0.0, 0.3, 1.0], [0.0, 0.9, 1.0]), pd.Steps(1), ""),
        (pd.Table([0.0, 1.0, 2.0], [0.0, 1.0, 1.0]), pd.Steps(1), ""),
    ],
)
def test_a_peak_between_load_steps_is_told(schedule, steps, told):
    case = pulled(schedule, steps=steps)
    found = schedule_warnings(pd.prepare(case).case)
    assert len(found) == bool(told)
    assert all(f"The schedule of Displacement condition 2 has {told}" in one or told in one for one in found)


def test_a_pulse_between_time_steps_is_told(tmp_path):
    """Velocities are integrated over the steps, and the time steps of Explicit are short."""
    pulse = pd.Traction("+x", x=1.0, schedule=PULSE)
    found = pd.run(bar(pd.Clamp("-x"), pulse, solver=pd.Implicit(dt=0.1, end=1.0)), tmp_path)
    (told,) = [one for one in found.summary["notes"] if "Traction condition 2" in one]
    assert "the factor 1 at load parameter 0.02, between two steps" in told and told.endswith("Take a shorter dt.")
    assert np.abs(found.field("displacement")).max() == 0.0
    for solver in (pd.Implicit(dt=0.01, end=1.0), pd.Implicit(dt=0.1, end=1.0, error=0.1), pd.Explicit(end=1.0)):
        assert schedule_warnings(pd.prepare(bar(pd.Clamp("-x"), pulse, solver=solver)).case) == []
    driven = pd.Velocity("+x", x=1.0, schedule=PULSE)
    assert schedule_warnings(bar(driven, solver=pd.Implicit(dt=0.1, end=1.0))) == []


@pytest.mark.parametrize(
    ("table", "changes", "words"),
    [
        (([0.0, 10.0], [0.0, 1.0]), {}, ["up to 10", "has the factor 0.1.", "by 10."]),
        (([0.0, 2e-3, 4e-3, 3.0], [0.0, 1.0, 0.0, 0.2]), {"solver": pd.Explicit(end=0.5)}, ["up to 3", "by 0.5."]),
        (([0.0, 1.0, 2.0], [0.0, 1.0, 1.0]), {}, []),
        (([0.0, 1.0 + 1e-12], [0.0, 1.0]), {}, []),
    ],
)
def test_a_table_that_ends_after_the_run_is_told(table, changes, words):
    table = pd.Table(*table)
    case = bar(pd.Clamp("-x"), pd.Traction("+x", x=1.0, schedule=table), **changes)
    found = schedule_warnings(case)
    assert len(found) == bool(words)
    assert all("The schedule of Traction condition 2" in one and all(word in one for word in words) for one in found)
    tool = pd.RigidPlane((0.0, 1.1), (0.0, -1.0), move=(0.0, -0.01), schedule=table)
    assert len(schedule_warnings(bar(pd.Contact("+y", tool), **changes))) == bool(words)
    softer = pd.Thermal(LAW, 1e-5, factor=pd.Table([0.0, 100.0], [1.0, 0.8]))
    assert schedule_warnings(pd.Case(case.particles, material=softer, conditions=[pd.Clamp("-x")])) == []
