"""Path following: snap-back of one bond, peak of a crack against the event-driven solver, ranks, restart, energy."""

import dataclasses
import sys

import numpy as np
import pytest

import pdpetsc as pd
from tests.commands import ROOT, Stop, history, results
from tests.solvers.test_events import one_bond

sys.path.append(str(ROOT / "runs/fracture"))
import centre_crack
import edge_crack
import plate_with_hole


def crack(pull=1.0, **changes):
    """Return the strip with a central crack of softening bonds, 10 particles wide."""
    case = centre_crack.case(n=10, law="linear", pull=pull)
    return dataclasses.replace(case, fields=[], picture=None, **changes)


@pytest.mark.parametrize("ratio", [1.5, *(pytest.param(ratio, marks=pytest.mark.long) for ratio in (1.2, 3.0))])
def test_one_bond_in_series_with_another_is_followed_back(ratio, tmp_path):
    """Two equal springs: u = x l + q / k with the law's force q = k l (r - x) / (r - 1); below r = 2 u turns back."""
    solver = pd.PathFollowing(pd.BondStretch(0.02), until=1e-9)
    pd.run(dataclasses.replace(one_bond(ratio), solver=solver), output=tmp_path)
    h = history(tmp_path)
    k, limit = 100.0, 0.01
    x = h["displacement"] / limit - h["force"] / (k * limit)
    law = k * limit * np.where(x <= 1.0, x, np.maximum((ratio - x) / (ratio - 1.0), 0.0))
    assert np.allclose(h["force"], law, atol=1e-9)
    assert (np.diff(h["displacement"]) < 0.0).any() == (ratio < 2.0)
    assert abs(h["force"][-1]) < 1e-9
    assert h["dissipated"][-1] == pytest.approx(0.5 * k * limit * ratio * limit, rel=1e-9)


@pytest.mark.long
@pytest.mark.parametrize("measure", ["stretch", "opening"])
def test_the_peak_of_a_crack_is_that_of_the_event_driven_solver(measure, tmp_path):
    pd.run(crack(), output=tmp_path / "events")
    middle = pd.region.Box((8.0, 18.0), (12.0, 22.0))
    up, down = pd.region.Slab("y", low=20.0), pd.region.Slab("y", high=20.0)
    measures = {
        "stretch": pd.BondStretch(0.1),
        "opening": pd.Opening("y", middle & up, against=middle & down, step=0.004, end=0.2),
    }
    pd.run(crack(solver=pd.PathFollowing(measures[measure])), output=tmp_path / "path")
    exact, path = history(tmp_path / "events"), history(tmp_path / "path")
    assert path["force"].max() == pytest.approx(exact["force"].max(), rel=0.02)
    # All of the work is dissipated where the body is apart, up to what jumps between the steps have set free.
    assert abs(path["force"][-1]) < 0.02 * path["force"].max()
    assert path["dissipated"][-1] <= path["work"][-1] * (1.0 + 1e-2)
    assert np.all(np.diff(path["dissipated"]) > -1e-12)
    assert path["tip"][-1] > path["tip"][0]


@pytest.mark.long
@pytest.mark.parametrize("ranks", [2, 3])
def test_any_number_of_ranks_follows_the_same_path(ranks, tmp_path):
    case = tmp_path / "short_crack.py"
    case.write_text(
        f"""import dataclasses, sys
sys.path.append({str(ROOT / "runs/fracture")!r})
import centre_crack, pdpetsc as pd
def case():
    path = pd.PathFollowing(pd.BondStretch(0.2), until=0.8)
    return dataclasses.replace(centre_crack.case(n=10, law="linear"), solver=path, picture=None)
"""
    )
    for several in (1, ranks):
        results(case, output=tmp_path / str(several), ranks=several)
    one, other = history(tmp_path / "1"), history(tmp_path / str(ranks))
    assert one["broken"][-1] > 0
    for name in ("force", "displacement", "broken"):
        assert np.allclose(one[name], other[name], rtol=1e-6, atol=1e-6 * np.abs(one[name]).max())


@pytest.mark.long
def test_a_restart_goes_on_along_the_path(tmp_path):
    case = crack(solver=pd.PathFollowing(pd.BondStretch(0.2), until=0.5), checkpoints=4)
    pd.run(case, output=tmp_path / "whole")
    stopped = dataclasses.replace(case, history={**case.history, "stop": Stop(15, "step")})
    with pytest.raises(pd.Interrupted):
        pd.run(stopped, output=tmp_path / "part")
    checkpoint = tmp_path / "part" / "checkpoint.h5"
    pd.run(case, output=tmp_path / "rest", restart=checkpoint)
    whole, rest = history(tmp_path / "whole"), history(tmp_path / "rest")
    # The stopped run keeps the step that it was stopped at, between two checkpoints.
    assert 4 * len(rest["step"]) > len(whole["step"])
    for name in ("force", "work", "dissipated"):
        same = whole[name][-len(rest[name]) :]
        assert np.allclose(rest[name], same, rtol=1e-8, atol=1e-8 * np.abs(whole[name]).max())


def test_a_path_goes_on_from_load_steps(tmp_path):
    stepped = crack(solver=pd.Newton(), steps=pd.Steps(20), history={"stop": pd.BrokenBonds()})
    stepped = dataclasses.replace(stepped, conditions=crack(pull=0.05).conditions, results=None)
    pd.run(stepped, output=tmp_path / "steps")
    path = crack(solver=pd.PathFollowing(pd.BondStretch(0.2), until=0.8), pull=0.05)
    pd.run(path, output=tmp_path / "path", restart=tmp_path / "steps" / "checkpoint.h5")
    h = history(tmp_path / "path")
    assert h["t"][0] == pytest.approx(1.0)
    assert h["force"].max() > h["force"][0]
    assert h["force"][-1] <= 0.8 * h["force"].max()


@pytest.mark.long
def test_the_plate_with_a_hole_turns_back_and_comes_apart(tmp_path):
    """Correspondence with smooth degradation, where load steps jump: the load falls while the plate springs back."""
    solver = pd.PathFollowing(pd.BondStretch(0.1), until=0.02)
    case = dataclasses.replace(plate_with_hole.case(), solver=solver, fields=[], picture=None)
    pd.run(case, output=tmp_path)
    h = history(tmp_path)
    peak = int(np.argmax(h["force"]))
    assert h["displacement"].max() == pytest.approx(h["displacement"][peak], rel=0.25)
    assert h["displacement"][-1] < 0.6 * h["displacement"][peak]
    assert h["force"][-1] <= 0.02 * h["force"][peak]
    assert h["broken"][-1] > 60


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"conditions": [pd.Displacement(pd.region.All(), x=0.0, y=1.0, schedule=pd.Hold())]}, "proportional"),
        ({"damage": None}, "bonds that can fail"),
        (
            {"solver": pd.PathFollowing(pd.Opening("z", pd.region.All(), step=1.0, end=2.0))},
            "no component z",
        ),
    ],
)
def test_what_a_path_cannot_follow_is_refused(changes, message, tmp_path):
    with pytest.raises(pd.CaseError, match=message):
        pd.run(crack(**{"solver": pd.PathFollowing(), **changes}), output=tmp_path)


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: pd.BondStretch(0.0),
        lambda: pd.Opening("a", pd.region.All(), step=1.0, end=2.0),
        lambda: pd.Opening("x", pd.region.All(), step=1.0, end=-2.0),
        lambda: pd.PathFollowing(until=1.0),
        lambda: pd.PathFollowing(0.1),
    ],
)
def test_wrong_paths_are_refused(wrong):
    with pytest.raises(pd.CaseError):
        wrong()


def test_a_schedule_that_ends_with_the_load_steps_is_refused(tmp_path):
    """A table is proportional from 0 to 1 and stays there beyond, where the load factor of a path may go."""
    case = crack(solver=pd.PathFollowing(pd.BondStretch(0.2), until=0.8))
    ending = [dataclasses.replace(c, schedule=pd.Table([0.0, 1.0], [0.0, 1.0])) for c in case.conditions]
    with pytest.raises(pd.CaseError, match="proportional to the step time"):
        pd.run(dataclasses.replace(case, conditions=ending), output=tmp_path)


@pytest.mark.long
def test_a_path_never_gives_back_what_was_dissipated(tmp_path):
    """Edge crack, sub-horizons without control: breaking bonds there can set more stress free than they carried.

    A run either follows the crack or ends with a sentence; it must not write down a body that does work on its loads.
    """
    case = edge_crack.case(n=10, scheme="sub_horizons", G=0.0, solver="path", law="brittle")
    try:
        pd.run(dataclasses.replace(case, fields=[], picture=None), output=tmp_path)
    except pd.SolveError as error:
        assert "the energy does not balance" in str(error) or "the load factor jumped" in str(error)
    h = history(tmp_path)
    assert h["broken"][-1] > 20
    fallen = np.maximum.accumulate(h["dissipated"]) - h["dissipated"]
    assert fallen.max() < 0.1 * h["stored"].max()
    assert h["opening"].min() >= 0.0
    assert h["dissipated"].max() > 5.0 * fallen.max()


class Wrong(pd.Term):
    """A spring on the ground of every particle, which stores ``times`` the energy that it takes to stretch it."""

    energy_of = "wrong"

    def __init__(self, k, times):
        self.k, self.times = k, times

    def add_row_force(self, state, r):
        r[: len(self.k)] += self.k[:, None] * state.own

    def linearise(self, state):
        return [pd.PointBlocks(self.k[:, None, None] * np.eye(state.own.shape[1]))]

    def energy(self, state):
        return self.times * 0.5 * float((self.k[:, None] * state.own**2).sum())


@dataclasses.dataclass(frozen=True)
class Springs(pd.ExtraTerm):
    times: float

    def build(self, body):
        return Wrong(100.0 * body.cloud.volume[: body.cloud.n_owned], self.times)


@pytest.mark.parametrize("times", [1.0, 3.0])
def test_a_step_whose_energy_comes_from_nowhere_does_not_count(times, tmp_path):
    """The energy of a bed that stores three times the work put into it along a path."""
    solver = pd.PathFollowing(pd.Opening("x", pd.region.Nearest((2.5,)), step=0.01, end=0.04))
    case = dataclasses.replace(one_bond(3.0), solver=solver, terms=[Springs(times)], steps=pd.Steps(4, smallest=0.1))
    if times == 1.0:
        # The history has what the path follows, up to the declared end.
        opening = pd.run(case, output=tmp_path).history["opening"]
        assert opening[-1] == pytest.approx(0.04, rel=1e-9)
        assert np.diff(opening).min() > 0.0 and np.diff(opening).max() <= 0.01 * (1.0 + 1e-9)
        return
    with pytest.raises(pd.SolveError, match="energy does not balance"):
        pd.run(case, output=tmp_path)


@pytest.mark.long
def test_dissipation_follows_a_snap_back_of_failing_points(tmp_path):
    """A bar stores more at its peak than its crack takes: its end must go back for the load to fall."""
    n, Gc = 60, 0.1
    left, right = pd.region.Slab("x", high=1.0), pd.region.Slab("x", low=n - 1.0)
    middle = pd.region.Slab("x", low=0.5 * n - 8.0, high=0.5 * n + 8.0)
    case = pd.Case(
        particles=pd.Lattice((0.0,), (1.0 * n,), 1.0),
        horizon=2.015,
        material=pd.LinearElastic(100.0, 0.0),
        scheme=pd.Correspondence(),
        control=pd.Silling(0.5),
        damage=pd.PointDamage(
            pd.softening.Linear(),
            Gc=Gc,
            strength=lambda x: np.where(np.abs(x[:, 0] - 0.5 * n) < 1.0, 0.9, 1.0),
            protected=~middle,
        ),
        conditions=[pd.Displacement(left, x=0.0), pd.Displacement(right, x=1.0)],
        solver=pd.PathFollowing(pd.Dissipation(step=0.005), first=0.2, until=0.01),
        history={
            "load": pd.Reaction("x", right),
            "end": pd.Mean(pd.displacement, "x", right),
            "work": pd.ExternalWork(),
            "stored": pd.StrainEnergy(),
            "control": pd.ControlEnergy(),
            "gone": pd.DissipatedEnergy(),
        },
    )
    h = {name: np.array(values) for name, values in pd.run(case, tmp_path).history.items()}
    peak = int(np.argmax(h["load"]))
    assert 0.9 < h["load"][peak] < 1.0
    assert h["end"][peak:].min() < 0.5 * h["end"][peak]
    assert h["load"][-1] < 0.01 * h["load"][peak]
    assert (np.diff(h["gone"]) >= 0.0).all()
    assert np.diff(h["gone"]).max() < 0.012
    assert h["gone"][-1] == pytest.approx(Gc, rel=0.04)
    assert h["work"] == pytest.approx(h["stored"] + h["control"] + h["gone"], abs=0.01 * Gc)


def test_dissipation_needs_points_that_fail(tmp_path):
    case = pd.Case(
        particles=pd.Lattice((0.0,), (10.0,), 1.0),
        horizon=2.015,
        material=pd.LinearElastic(100.0, 0.0),
        conditions=[
            pd.Displacement(pd.region.Slab("x", high=1.0), x=0.0),
            pd.Displacement(pd.region.Slab("x", low=9.0), x=1.0),
        ],
        solver=pd.PathFollowing(pd.Dissipation(step=0.005)),
    )
    with pytest.raises(pd.CaseError, match="needs PointDamage"):
        pd.run(case, tmp_path)
