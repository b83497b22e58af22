"""Unstable equilibria are reported, shortened or refused."""

import dataclasses
import json
import logging

import numpy as np
import pytest

import pdpetsc as pd
from pdpetsc.declare import region
from tests.commands import results

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


def steps_of(folder):
    return json.loads((folder / "summary.json").read_text())["steps"]


def test_a_column_past_its_critical_force_is_called_unstable(tmp_path, caplog):
    with caplog.at_level(logging.INFO, logger="pdpetsc"):
        pd.run(column(), output=tmp_path)
    steps = steps_of(tmp_path)
    unstable = [step["t"] * 3.0 for step in steps if step["negative_pivots"]]
    stable = [step["t"] * 3.0 for step in steps if step["negative_pivots"] == 0]
    assert len(stable) + len(unstable) == 24
    assert max(stable) < min(unstable)
    assert min(unstable) == pytest.approx(CRITICAL, abs=0.125 + 0.05 * CRITICAL)
    said = [record.message for record in caplog.records]
    assert any("UNSTABLE (negative pivots: 1)" in line for line in said)
    warned = [record.message for record in caplog.records if record.levelno == logging.WARNING]
    first = f"{len(unstable)} of 24 equilibria are unstable, the first at step time {min(unstable) / 3.0:.6g}"
    assert any(line.startswith(first) for line in warned)


def test_steps_are_shortened_towards_the_critical_force(tmp_path):
    with pytest.raises(pd.SolveError, match="unstable, with 1 negative pivot"):
        pd.run(column(unstable="shorten"), output=tmp_path)
    steps = steps_of(tmp_path)
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
    assert len(steps_of(tmp_path)) == 8


def test_an_iterative_solver_does_not_tell(tmp_path):
    pd.run(column(load=1.0, steps=2), output=tmp_path, options={"pc_type": "gamg"})
    assert [step["negative_pivots"] for step in steps_of(tmp_path)] == [None, None]


@pytest.mark.processors
def test_ranks_count_the_same_pivots(tmp_path):
    case = tmp_path / "column.py"
    case.write_text("from tests.solvers.test_stability import column\n\n\ndef case():\n    return column(steps=6)\n")
    results(case, ranks=2, output=tmp_path / "two")
    pd.run(column(steps=6), output=tmp_path / "one")
    one, two = ([step["negative_pivots"] for step in steps_of(tmp_path / name)] for name in ("one", "two"))
    assert one == two
    assert 1 in one
