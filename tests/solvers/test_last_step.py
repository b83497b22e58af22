"""Load steps of materials with history and of contact start from the extrapolated last step."""

import numpy as np
import pytest

import pdpetsc as pd
from tests.commands import Stop

STEEL = pd.J2(E=100.0, nu=0.3, yield_stress=0.3, hardening=2.0)
LEFT, RIGHT = pd.region.Slab("x", high=1.0), pd.region.Slab("x", low=7.0)


def there_and_back(t):
    return 1.0 - abs(2.0 * t - 1.0)


def bar(schedule=None, force=0.0, steps=8, **changes):
    """Return a notched strip that is pulled until it flows."""
    declared = {
        "particles": pd.Lattice((0.0, 0.0), (8.0, 4.0), 1.0),
        "cracks": [pd.Segment((4.0, -1.0), (4.0, 1.0))],
        "horizon": 2.015,
        "material": STEEL,
        "scheme": pd.Correspondence(),
        "control": pd.Silling(0.1),
        "conditions": [
            pd.Displacement(LEFT, x=0.0, y=0.0),
            pd.Force(RIGHT, x=force, schedule=schedule) if force else pd.Displacement(RIGHT, x=0.4, schedule=schedule),
        ],
        "steps": pd.Steps(steps),
        "history": {"plastic": pd.Largest(pd.plastic_strain)},
        "fields": [],
    }
    return pd.Case(**(declared | changes))


def marched(case, moved_on=True):
    """Return displacements of all steps, iterations of each, and in which the step before was taken up."""
    prepared = pd.prepare(case)
    last, asked = prepared.problem.last_step, []
    if moved_on:
        whole = last.moved_on

        def noted(u, t):
            found = whole(u, t)
            asked.append(found is not None)
            return found

        last.moved_on = noted
    else:
        prepared.problem.last_step = None
    solver = prepared.make_solver()
    try:
        found = [(one.u.copy(), one.result.iterations) for one in prepared.march(solver)]
    finally:
        solver.destroy()
    return [u for u, _ in found], [n for _, n in found], asked


@pytest.mark.parametrize("force", [0.0, 1.1])
def test_it_finds_the_same_in_fewer_iterations(force):
    whole, fewer, asked = marched(bar(force=force))
    plain, more, _ = marched(bar(force=force), moved_on=False)
    assert asked == [False] + 7 * [True]
    assert sum(fewer) < 0.9 * sum(more)
    for u, v in zip(whole, plain, strict=True):
        assert np.abs(u - v).max() < 1e-8 * np.abs(v).max()


@pytest.mark.parametrize("force", [0.0, 1.1])
def test_where_the_load_turns_nothing_is_moved_on(force):
    case = bar(schedule=there_and_back, force=force)
    whole, _, asked = marched(case)
    plain, _, _ = marched(case, moved_on=False)
    assert asked == [False, True, True, True, False, True, True, True]
    for u, v in zip(whole, plain, strict=True):
        assert np.abs(u - v).max() < 1e-8 * np.abs(plain[3]).max()


def pressed(schedule=None, friction=0.3, turn=0.0):
    """Return a block that a round tool presses and rolls over."""
    tool = pd.RigidSphere(
        (0.0, 4.0), 2.0, move=(0.0, -0.2), turn=turn, about=(0.0, 4.0), schedule=schedule or pd.Ramp()
    )
    return pd.Case(
        particles=pd.LatticeNodes((-2.0, 0.0), (2.0, 2.0), 0.125),
        material=pd.LinearElastic(E=100.0, nu=0.3, plane="stress"),
        conditions=[pd.Clamp("-y"), pd.Contact("+y", tool, friction, name="tool")],
        steps=pd.Steps(8),
        fields=[],
    )


@pytest.mark.parametrize(("friction", "turn"), [(0.0, 0.0), (0.3, 0.05)])
def test_a_tool_that_moves_on_needs_fewer_iterations(friction, turn):
    case = pressed(friction=friction, turn=turn)
    whole, fewer, asked = marched(case)
    plain, more, _ = marched(case, moved_on=False)
    assert asked == [False] + 7 * [True]
    assert sum(fewer) < 0.95 * sum(more)
    for u, v in zip(whole, plain, strict=True):
        assert np.abs(u - v).max() < 1e-7 * np.abs(v).max()


def test_where_a_tool_turns_back_nothing_is_moved_on():
    asked = marched(pressed(there_and_back))[2]
    assert asked == [False, True, True, True, False, True, True, True]


def test_a_run_that_goes_on_starts_its_step_as_if_it_had_not_stopped(tmp_path):
    """To the last digit: how far the body moved is in the checkpoint."""
    whole = pd.run(bar(history={"stop": Stop(2.0)}), tmp_path / "whole").solution
    with pytest.raises(pd.Interrupted):
        pd.run(bar(history={"stop": Stop(0.5)}), tmp_path / "part")
    rest = pd.run(bar(history={"stop": Stop(2.0)}), tmp_path / "rest", restart=tmp_path / "part")
    assert np.array_equal(rest.solution.u, whole.u)
    asked = [step["newton_iterations"] for step in rest.summary["steps"]]
    assert max(asked) <= 5


def test_what_remembers_nothing_or_changes_otherwise_has_none():
    hot = [*bar().conditions, pd.Temperature(pd.region.All(), 10.0)]
    for changes in (
        {"material": pd.Hencky(100.0, 0.3), "history": {}},
        {"damage": pd.Brittle(pd.ConstantCritical(1.0))},
        {"material": pd.Thermal(STEEL, 1e-5), "conditions": hot},
    ):
        assert pd.prepare(bar(**changes)).problem.last_step is None
