"""Steps without equilibrium that go on as a motion: where a body rests, ranks, units, restart and refusals."""

import dataclasses

import numpy as np
import pytest

import pdpetsc as pd
from tests.commands import Stop, results, script_on

SPAN, RISE, HEIGHT = 20.0, 0.6, 0.5
LOAD = 2e-5


def arch(solver=None, unit=1.0, load=LOAD, **changes):
    """Return a shallow arch of three rows of particles with pinned ends, whose weight grows beyond what it carries."""
    across, along = np.meshgrid(np.array([-1.0, 0.0, 1.0]) * HEIGHT / 3.0, (np.arange(120) + 0.5) * SPAN / 120.0)
    x = np.stack([along.ravel(), (across + RISE * np.sin(np.pi * along / SPAN)).ravel()], axis=1)
    middle = pd.region.Slab("y", -0.1 * unit, 0.1 * unit)
    ends = pd.region.Slab("x", high=SPAN / 120.0 * unit) | pd.region.Slab("x", low=(SPAN - SPAN / 120.0) * unit)
    declared = {
        "particles": pd.Arrays(unit * x, unit**2 * SPAN / 120.0 * HEIGHT / 3.0),
        "horizon": 2.015 * SPAN / 120.0 * unit,
        "material": pd.Hencky(E=1.0, nu=0.0, plane="stress", density=1.0),
        "conditions": [
            pd.Displacement(ends & middle, x=0.0, y=0.0),
            pd.BodyForce(pd.region.All(), y=-load / unit),
        ],
        "solver": solver or pd.SnapThrough(dt=60.0 * unit, end=2e5 * unit),
        "steps": pd.Steps(10, smallest=0.005),
        "history": {"middle": pd.Mean(pd.displacement, "y", pd.region.Sphere((0.5 * SPAN * unit, RISE * unit), unit))},
        "fields": [],
    }
    return pd.Case(**(declared | changes))


@pytest.fixture(scope="module")
def snapped(tmp_path_factory):
    return pd.run(arch(), tmp_path_factory.mktemp("snap") / "run")


def test_an_arch_rests_on_the_branch_of_its_path(snapped, tmp_path):
    """Its equilibria are those of the arc length, before the limit of the load and beyond the snap."""
    steps = snapped.summary["steps"]
    moved = [step for step in steps if step.get("moved")]
    assert len(moved) == 1
    w, t = snapped.history["middle"], snapped.history["t"]
    k = int(np.argmin(np.diff(w))) + 1
    assert w[k] < -1.5 * RISE < -RISE < w[k - 1]
    path = arch(pd.PathFollowing(pd.ArcLength(step=0.02, end=2.0), first=0.05, until=0.0), steps=pd.Steps())
    found = pd.run(path, tmp_path).history
    load, along = found["t"], found["middle"]
    top = int(np.flatnonzero(np.diff(load) < 0.0)[0])
    assert t[k - 1] <= load[top] * 1.001 and t[k] >= load[top] * 0.97
    before = np.interp(t[1:k], load[: top + 1], along[: top + 1])
    np.testing.assert_allclose(w[1:k], before, atol=0.02 * RISE)
    far = along < -1.5 * RISE
    after = np.interp(t[k:], load[far], along[far])
    np.testing.assert_allclose(w[k:], after, rtol=5e-3)


@pytest.mark.long
def test_an_arch_rests_at_the_rise_of_its_closed_form(tmp_path):
    found = results("runs/stability/arch.py", "solver=snap", output=tmp_path)["results"]
    assert found["limit"] == pytest.approx(1.0, abs=0.08)
    assert found["landing"] == pytest.approx(1.0, abs=0.04)


def test_without_a_limit_nothing_moves(tmp_path):
    """The run is that of Newton's method, to the last digit."""
    few = {"load": 0.5 * LOAD}
    still = pd.run(arch(**few), tmp_path / "still")
    plain = pd.run(arch(pd.Newton(), **few), tmp_path / "plain")
    assert np.array_equal(still.solution.u, plain.solution.u)
    assert not any(step.get("moved") for step in still.summary["steps"])


@pytest.mark.long
def test_units_do_not_matter(snapped, tmp_path):
    small = pd.run(arch(unit=1e-6), tmp_path)
    one, other = snapped.history["middle"], small.history["middle"]
    assert len(one) == len(other)
    np.testing.assert_allclose(1e6 * np.asarray(other), one, rtol=1e-6)


def test_a_restart_after_the_snap_goes_on(snapped, tmp_path):
    at = snapped.history["t"][int(np.argmin(np.diff(snapped.history["middle"]))) + 1]
    stopping = arch()
    stopping = dataclasses.replace(stopping, history={**stopping.history, "stop": Stop(at + 1e-6)})
    with pytest.raises(pd.Interrupted):
        pd.run(stopping, tmp_path / "part")
    rest = pd.run(arch(), tmp_path / "rest", restart=tmp_path / "part", restart_anyway=True)
    assert np.array_equal(rest.solution.u, snapped.solution.u)


RANKS = """
import sys
import numpy as np
import pdpetsc as pd
from tests.solvers.test_snap import arch
u = pd.run(arch(), output=sys.argv[1]).gathered(pd.displacement)
if u is not None:
    np.save(sys.argv[2], u)
"""


@pytest.mark.processors
def test_two_ranks_rest_where_one_does(snapped, tmp_path):
    script_on(2, RANKS, tmp_path / "run", tmp_path / "u.npy")
    u = snapped.gathered(pd.displacement)
    assert np.abs(np.load(tmp_path / "u.npy") - u).max() < 1e-7 * np.abs(u).max()


@pytest.mark.long
def test_damping_and_radius_lead_to_the_same_rest(snapped, tmp_path):
    damped = arch(pd.SnapThrough(dt=60.0, end=2e5, radius=0.8))
    damped = dataclasses.replace(damped, conditions=[*damped.conditions, pd.RayleighDamping(mass=1e-3)])
    u = pd.run(damped, tmp_path).solution.u
    assert np.abs(u - snapped.solution.u).max() < 1e-6 * np.abs(u).max()


def test_a_body_that_does_not_come_to_rest_is_an_error(tmp_path):
    with pytest.raises(pd.SolveError, match="not at rest after moving for 600"):
        pd.run(arch(pd.SnapThrough(dt=60.0, end=600.0, radius=1.0)), tmp_path)
    steps = np.loadtxt(tmp_path / "history.csv", delimiter=",", skiprows=1)
    assert len(steps) > 5  # the equilibria before are there


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"material": pd.Hencky(E=1.0, nu=0.0, plane="stress")}, "needs the density"),
        (
            {
                "material": pd.J2(E=1.0, nu=0.0, yield_stress=0.01, hardening=0.1, plane="stress", density=1.0),
                "damage": pd.Brittle(pd.JohnsonCookFailure(1.0, 1.0, -1.0, D4=0.1, duration=1.0)),
            },
            "depend on the rate",
        ),
        ({"conditions": [pd.PointSupport(pd.region.All(), x=0.0, y=0.0)]}, "does not go with"),
        ({"conditions": [*arch().conditions, pd.InitialVelocity(pd.region.All(), y=1.0)]}, "needs inertia"),
        ({"conditions": [*arch().conditions, pd.RayleighDamping(stiffness=1.0)]}, "by its radius"),
    ],
)
def test_what_cannot_move_is_refused(changes, message, tmp_path):
    with pytest.raises(pd.CaseError, match=message):
        pd.run(arch(**changes), tmp_path)


def test_declared_numbers_are_checked():
    with pytest.raises(pd.CaseError, match="radius from 0 to 1"):
        pd.SnapThrough(dt=1.0, end=2.0, radius=1.5)
    with pytest.raises(pd.CaseError, match="smaller dt"):
        pd.SnapThrough(dt=3.0, end=2.0)
