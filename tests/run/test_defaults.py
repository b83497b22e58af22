"""Defaults that suit the body, and notes of a run on what its case does not resolve."""

import dataclasses
import re
import sys

import numpy as np
import pytest
from scipy.integrate import quad

import pdpetsc as pd
from pdpetsc.output.report import _notes
from pdpetsc.running.notes import jump_note
from pdpetsc.running.thin import thin_note
from tests.commands import ROOT, script_on

sys.path.append(str(ROOT / "runs" / "convergence"))
import rings

LEFT, RIGHT = pd.region.Slab("x", high=1.0), pd.region.Slab("x", low=7.0)
SQUARE = pd.Lattice((0.0, 0.0), (8.0, 6.0), 1.0)
RUBBER = pd.LinearElastic(E=1.0, nu=0.499)
BY_SHEAR = pd.ByShear(pd.Silling(0.5))


def pulled(**changes):
    """Return a strip of 8 x 6 particles that is pulled by 1 %."""
    declared = {
        "particles": SQUARE,
        "horizon": 2.015,
        "material": pd.LinearElastic(E=1.0, nu=0.3),
        "conditions": [pd.Displacement(LEFT, x=0.0, y=0.0), pd.Displacement(RIGHT, x=0.08)],
        "checkpoints": 0,
    }
    return pd.Case(**(declared | changes))


def run(case, folder):
    return pd.run(case, folder).summary


STRETCH = 2.0  # of the hole of a tube with radii 1 and 2


def around(r):
    """Return the stretch around a tube at the deformed radius r, where the material keeps its volume."""
    return r / np.sqrt(r**2 - STRETCH**2 + 1.0)


def tube(n, scheme=None, control=None):
    """Return a tube of neo-Hookean rubber, plane strain, inflated by the nominal pressure of the closed form.

    Incompressible: ``p = STRETCH int mu (s^2 - s^-2) / r dr`` with the stretch s around, from the hole outwards.
    """
    mu = 1.0 / (2.0 * 1.49975)
    outer = np.sqrt(rings.OUTER**2 + STRETCH**2 - 1.0)
    pressure = STRETCH * quad(lambda r: mu * (around(r) ** 2 - around(r) ** -2) / r, STRETCH, outer)[0]

    def exact(x, t):
        R = np.linalg.norm(x, axis=1)
        return (np.sqrt(R**2 + (1.0 + t * (STRETCH - 1.0)) ** 2 - 1.0) / R - 1.0)[:, None] * x

    return pd.Case(
        particles=rings.cloud("quads", n, 0.0, 0),
        horizon=pd.Horizon(2.015),
        material=pd.NeoHookean(E=1.0, nu=0.49975),
        scheme=scheme,
        control=control,
        conditions=[*rings.supports(exact), pd.Pressure(rings.HOLE, pressure)],
        steps=pd.Steps(4),
        fields=[pd.displacement],
        checkpoints=0,
    )


def off(result):
    """Return the error of the radius of the innermost particles over how far they move."""
    x, u = result.x[:, :2], result.field("displacement")[:, :2]
    R = np.linalg.norm(x, axis=1)
    inner = np.isclose(R, R.min())
    exact = np.sqrt(R.min() ** 2 + STRETCH**2 - 1.0)
    return (np.linalg.norm(x + u, axis=1)[inner].mean() - R.min()) / (exact - R.min()) - 1.0


@pytest.mark.long
def test_an_inflated_tube_of_rubber_does_not_lock_by_default(tmp_path, caplog):
    caplog.set_level("INFO")
    default = pd.run(tube(4), tmp_path / "default")
    assert abs(off(default)) < 0.05
    assert default.summary["scheme"]["name"] == "MeanDilatation"
    chosen = default.summary["scheme"]["chosen"]
    assert "default at nu = 0.49975" in chosen and "ByShear(control=Silling(G=0.5))" in chosen
    assert chosen in caplog.text
    assert default.summary["notes"] == []
    caplog.clear()
    declared = pd.run(tube(4, scheme=pd.SubHorizons()), tmp_path / "declared")
    assert off(declared) < -0.7
    (note,) = declared.summary["notes"]
    assert "SubHorizons locks" in note
    assert "scheme=pd.MeanDilatation(pd.Correspondence(), patch=2 * spacing), control=pd.ByShear" in note
    assert note in caplog.text
    assert note in _notes(declared.summary).replace("&#x27;", "'")
    assert "chosen" not in declared.summary["scheme"]


@pytest.mark.long
def test_the_default_of_rubber_converges(tmp_path):
    errors = [abs(off(pd.run(tube(n), tmp_path / str(n)))) for n in (4, 8, 16)]
    assert errors[1] < 0.5 * errors[0] and errors[2] < 0.5 * errors[1]
    assert errors[2] < 0.005


@pytest.mark.parametrize("unit", [1e-20, 1.0, 1e20])
def test_the_choice_is_that_of_patches_of_two_spacings(unit, tmp_path):
    left, right = pd.region.Slab("x", high=unit), pd.region.Slab("x", low=7.0 * unit)
    default = pulled(
        particles=pd.Lattice((0.0, 0.0), (8.0 * unit, 6.0 * unit), unit), horizon=2.015 * unit, material=RUBBER,
        conditions=[pd.Displacement(left, x=0.0, y=0.0), pd.Displacement(right, x=0.08 * unit)],
    )  # fmt: skip
    declared = dataclasses.replace(
        default, scheme=pd.MeanDilatation(pd.Correspondence(), patch=2.0 * unit), control=BY_SHEAR
    )
    one, other = (pd.run(case, tmp_path / str(n)).solution.u for n, case in enumerate((default, declared)))
    assert np.abs(one - other).max() < 1e-9 * np.abs(other).max()
    assert pd.prepare(default).case.scheme.patch == pytest.approx(2.0 * unit, rel=1e-8)


@pytest.mark.parametrize(
    ("changes", "scheme"),
    [
        ({"material": pd.LinearElastic(E=1.0, nu=0.45)}, None),
        ({"material": pd.LinearElastic(E=1.0, nu=0.451)}, "MeanDilatation"),
        ({"material": pd.LinearElastic(E=1.0, nu=0.499, plane="stress")}, None),
        ({"material": pd.MooneyRivlin(0.3, 0.1, 100.0)}, "MeanDilatation"),
        ({"material": pd.Graded(RUBBER, lambda x: 1.0 + x[:, 0])}, "MeanDilatation"),
        ({"material": [(LEFT, pd.LinearElastic(E=1.0, nu=0.0)), (~LEFT, RUBBER)]}, "MeanDilatation"),
        ({"material": RUBBER, "damage": pd.Brittle(pd.ConstantCritical(1.0))}, None),
        ({"material": RUBBER, "conditions": [pd.Eigenstrain(pd.region.All(), xx=0.01)]}, None),
        ({"material": pd.BondBased(E=1.0)}, None),
        ({"material": RUBBER, "control": pd.Silling(0.5)}, None),
    ],
)
def test_the_scheme_is_chosen_by_what_gradients_see(changes, scheme):
    case = pulled(**changes)
    held = pd.Displacement(LEFT, x=0.0, y=0.0)
    case = dataclasses.replace(case, conditions=[held, *case.conditions[-1:]])
    found = pd.prepare(case).case.scheme
    assert (None if found is None else type(found).__name__) == scheme


def test_a_material_that_flows_has_a_control_that_follows(tmp_path):
    metal = pd.J2(E=1.0, nu=0.48, yield_stress=1e-4, hardening=0.01)
    assert pd.prepare(pulled(material=metal)).case.control == pd.TangentScaled(BY_SHEAR)


@pytest.mark.parametrize(
    ("changes", "told"),
    [({}, True), ({"scheme": pd.SubHorizons()}, False), ({"material": pd.LinearElastic(E=1.0, nu=0.3)}, False)],
)
def test_a_better_scheme_for_plastic_flow_is_a_detail_of_the_log(changes, told, tmp_path, caplog):
    caplog.set_level("DEBUG", "pdpetsc")
    summary = run(pulled(**({"material": pd.J2(E=1.0, nu=0.3, yield_stress=1.0)} | changes)), tmp_path)
    told_at = [record.levelname for record in caplog.records if "pd.TangentScaled(pd.Silling(0.5))" in record.message]
    assert told_at == (["DEBUG"] if told else []) and summary["notes"] == []


SUGGESTED = "scheme=pd.MeanDilatation(pd.Correspondence(), patch=2 * spacing), control=pd.ByShear(pd.Silling(0.5))."
LESS = "write scheme=pd.Correspondence(), control=pd.ByShear(pd.Silling(0.5))."


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"scheme": pd.BondAssociated()}, ["BondAssociated locks", SUGGESTED]),
        ({"scheme": pd.Correspondence(), "control": pd.Silling(0.5)}, ["and Silling locks", SUGGESTED]),
        ({"scheme": pd.Correspondence(), "control": pd.RelativeSprings()}, ["RelativeSprings locks", SUGGESTED]),
        ({"control": pd.Silling(0.5)}, ["SubHorizons and Silling lock:", SUGGESTED]),
        ({"scheme": pd.MeanDilatation(pd.SubHorizons(), 2.0), "control": pd.Wan()}, ["Wan locks", SUGGESTED]),
        ({"damage": pd.Brittle(pd.ConstantCritical(1.0))}, ["SubHorizons locks", LESS]),
        ({"scheme": pd.Correspondence(), "control": BY_SHEAR}, []),
        ({"scheme": pd.MeanDilatation(pd.SubHorizons(), 2.0)}, []),
        ({"scheme": pd.SubHorizons(), "material": pd.LinearElastic(E=1.0, nu=0.45)}, []),
        ({"scheme": pd.SubHorizons(), "material": dataclasses.replace(RUBBER, plane="stress")}, []),
    ],
)
def test_a_declared_scheme_or_control_that_locks_is_named(changes, words, tmp_path):
    notes = run(pulled(**({"material": RUBBER} | changes)), tmp_path)["notes"]
    assert len(notes) == bool(words)
    for word in words:
        assert word in notes[0]


def test_what_is_suggested_beside_damage_can_be_had(tmp_path):
    brittle = {"material": RUBBER, "damage": pd.Brittle(pd.ConstantCritical(1.0))}
    assert run(pulled(**brittle, scheme=pd.Correspondence(), control=BY_SHEAR), tmp_path)["notes"] == []


TWO_RANKS = """
import pdpetsc as pd
from pdpetsc.running.notes import notes
from tests.run.test_defaults import RUBBER, pulled

low, high = pd.region.Slab("y", high=3.0), pd.region.Slab("y", low=3.0)
hole = pd.Lattice((0.0, 0.0), (8.0, 8.0), 1.0, cut=pd.region.Sphere((4.0, 4.0), 1.8))
found = pd.prepare(pulled(particles=hole, material=[(low, RUBBER), (high, pd.LinearElastic(E=9.0, nu=0.3))]))
print("found", found.case.scheme, found.case.control, *notes(found.case, found.problem))
"""


def test_two_ranks_choose_and_note_the_same():
    one, two = ([line for line in script_on(n, TWO_RANKS).splitlines() if line.startswith("found")] for n in (1, 2))
    assert "patch=2.0" in one[0] and "staircase of 8 steps" in one[0] and "moduli of materials 1 and 2 differ" in one[0]
    assert two == 2 * one


@pytest.mark.parametrize(
    ("particles", "stairs"),
    [
        (pd.Lattice((0.0, 0.0), (10.0, 10.0), 1.0, cut=pd.region.Box((3.0, 3.0), (6.0, 6.0))), 0),
        (pd.Lattice((0.0, 0.0), (10.0, 10.0), 1.0, keep=pd.region.Slab("x", high=4.0)), 0),
        # A notch of one cell: both of its sides.
        (pd.Lattice((0.0, 0.0), (10.0, 4.0), 1.0, cut=pd.region.Box((4.0, 3.0), (6.0, 4.0))), 2),
        # y < x: from cell to cell a face up and a face along.
        (pd.Lattice((0.0, 0.0), (5.0, 5.0), 1.0, keep=pd.region.Where(lambda x: x[:, 1] < x[:, 0] + 0.1)), 8),
        # y < x / 2: four risers of one cell, between treads of two.
        (pd.Lattice((0.0, 0.0), (8.0, 4.0), 1.0, keep=pd.region.Where(lambda x: x[:, 1] < 0.5 * x[:, 0] + 0.1)), 3),
        (pd.Lattice((0.0, 0.0, 0.0), (5.0, 5.0, 3.0), 1.0,
                    keep=pd.region.Where(lambda x: x[:, 1] < x[:, 0] + 0.1)), 24),
    ],
)  # fmt: skip
def test_steps_of_a_staircase_are_counted(particles, stairs):
    assert particles.stairs(0, 1) == stairs
    assert sum(particles.stairs(part, 3) for part in range(3)) == stairs
    chunk = particles.chunk(0, 1)
    assert pd.Arrays(chunk.x, chunk.volume).stairs(0, 1) == stairs
    nodes = pd.LatticeNodes(particles.low, particles.high, 1.0, cut=particles.cut, keep=particles.keep)
    assert nodes.stairs(0, 1) == stairs


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({}, True), ({"fields": [pd.displacement], "history": {"most": pd.Largest(pd.von_mises, "")}}, True),
        ({"fields": [pd.displacement], "picture": pd.Picture(pd.stress, "xx")}, True),
        ({"fields": [pd.displacement], "history": {"u": pd.Mean(pd.displacement, "x")}}, False),
        ({"particles": pd.Lattice((0.0, 0.0), (8.0, 8.0), 1.0, cut=pd.region.Box((3.0, 3.0), (5.0, 5.0)))}, False),
    ],
)  # fmt: skip
def test_a_stress_beside_a_staircase_is_noted(changes, said, tmp_path, caplog):
    caplog.set_level("INFO")
    hole = {"particles": pd.Lattice((0.0, 0.0), (8.0, 8.0), 1.0, cut=pd.region.Sphere((4.0, 4.0), 1.8))}
    notes = run(pulled(**(hole | changes)), tmp_path)["notes"]
    assert len(notes) == said == ("staircase" in caplog.text)
    assert all("staircase of" in note and "use a Mesh or MeshNodes" in note for note in notes)


def two(ratio, apart=0.0):
    """Return a strip of two materials that meet at y = 3, one of ``ratio`` times the stiffness of the other."""
    low, high = pd.region.Slab("y", high=3.0), pd.region.Slab("y", low=3.0)
    particles = pd.Lattice((0.0, 0.0), (8.0, 8.0), 1.0, cut=pd.region.Slab("y", low=3.0, high=3.0 + apart))
    laws = [(low, pd.LinearElastic(E=1.0, nu=0.3)), (high, pd.LinearElastic(E=ratio, nu=0.3))]
    return pulled(particles=particles, material=laws)


@pytest.mark.parametrize(
    ("ratio", "apart", "said"),
    [(1.5, 0.0, ""), (1.0 / 1.9, 0.0, ""), (3.0, 0.0, "3"), (1.0 / 40.0, 0.0, "40"), (3.0, 2.0, "")],
)
def test_materials_of_unequal_stiffness_that_share_bonds_are_noted(ratio, apart, said, tmp_path):
    """The last one has a gap as wide as the horizon between them."""
    notes = run(two(ratio, apart), tmp_path)["notes"]
    assert len(notes) == bool(said)
    assert all(f"differ by a factor of {said}:" in note for note in notes)


def test_the_stress_beside_an_interface_is_off_as_the_note_says(tmp_path):
    """A uniform stress across the interface: 0 for equal materials, a quarter at the quotient that is noted."""
    found = []
    for ratio in (1.0, 2.0):
        law = [pd.LinearElastic(E=E, nu=0.0, plane="stress") for E in (1.0, ratio)]
        left = pd.region.Slab("x", high=0.5)
        case = pulled(
            particles=pd.LatticeNodes((0.0, 0.0), (1.0, 0.5), 0.125), horizon=2.015 * 0.125,
            material=[(left, law[0]), (~left, law[1])],
            conditions=[
                pd.Displacement(pd.region.Slab("x", high=1e-6), x=0.0),
                pd.Displacement(pd.region.Nearest((0.0, 0.25)), y=0.0), pd.Traction(pd.region.Named("+x"), x=1.0),
            ],
        )  # fmt: skip
        stress = pd.run(case, tmp_path / str(ratio)).field("stress")[:, 0, 0]
        found.append(np.abs(stress - 1.0).max())
    assert found[0] < 1e-9
    assert 0.2 < found[1] < 0.3


def sheared(steps, schedule=None):
    """Return a block of a Maxwell material in uniform shear, and its exact stress ``(mu + shear e^-t/time) gamma``."""
    gamma, law = 1e-5, pd.Maxwell(E=2.6, nu=0.3, shear=[1.0], times=[1.0], duration=1.0)
    return gamma, pulled(
        particles=pd.Lattice((0.0, 0.0), (4.0, 4.0), 1.0), material=law, steps=steps,
        conditions=[pd.Displacement(pd.region.All(), x=lambda x, t: gamma * x[:, 1], y=0.0, schedule=schedule)],
        history={"stress": pd.Mean(pd.stress, "xy")},
    )  # fmt: skip


def test_a_jump_that_is_spread_over_the_first_step_is_noted(tmp_path, caplog):
    caplog.set_level("INFO")
    gamma, case = sheared(pd.Steps(8))
    found = pd.run(case, tmp_path / "equal")
    exact = gamma * (1.0 + np.exp(-found.history["t"]))
    error = (found.history["stress"] - exact)[1] / (2.0 * gamma)
    assert error == pytest.approx(0.029, abs=0.002)
    (note,) = found.summary["notes"]
    assert f"stress is off by {100.0 * error:.2g} %" in note and note in caplog.text
    assert "steps=pd.Steps(times=(0.00125, 0.0125, 0.125, ..., 1.0))" in note
    gamma, case = sheared(pd.Steps(times=(1e-3, *np.linspace(0.125, 1.0, 8))))
    found = pd.run(case, tmp_path / "short")
    t, stress = (found.history[name][1:] for name in ("t", "stress"))
    assert t.tolist() == [1e-3, *np.linspace(0.125, 1.0, 8)]
    assert np.abs(stress / (gamma * (1.0 + np.exp(-t))) - 1.0).max() < 1e-3
    assert found.summary["notes"] == []


@pytest.mark.parametrize(
    ("steps", "schedule"),
    [(pd.Steps(8), pd.Ramp()), (pd.Steps(8), pd.Table((0.0, 0.1, 1.0), (0.0, 1.0, 1.0))), (pd.Steps(100), None)],
)
def test_what_grows_evenly_and_short_steps_are_not_noted(steps, schedule):
    _, case = sheared(steps, schedule)
    assert jump_note(case, pd.prepare(case).problem) == ""


def test_steps_end_at_given_times(tmp_path):
    """A load that jumps inside of the run is met before and after the jump, with steps that fail in between too."""
    times = (0.25, 0.5, 0.501, 1.0)
    jump = pd.Table((0.0, 0.5, 0.501, 1.0), (0.0, 0.1, 1.0, 1.0))
    history = {"u": pd.Mean(pd.displacement, "x", RIGHT)}
    case = pulled(
        conditions=[pd.Displacement(LEFT, x=0.0, y=0.0), pd.Displacement(RIGHT, x=0.08, schedule=jump)],
        steps=pd.Steps(times=times), history=history,
    )  # fmt: skip
    found = pd.run(case, tmp_path / "fixed").history
    assert found["t"].tolist() == [0.0, *times]
    assert found["u"][1:] == pytest.approx(0.08 * np.array([jump(t) for t in times]))
    adaptive = pd.AdaptiveSteps(first=0.1, largest=0.25, times=(0.5, 0.501, 1.0))
    found = pd.run(dataclasses.replace(case, steps=adaptive), tmp_path / "adaptive").history["t"]
    assert {0.5, 0.501, 1.0} <= set(found) and np.diff(found).max() < 0.25 + 1e-12
    flows = pd.J2(E=1.0, nu=0.3, yield_stress=1e-3, hardening=0.1)
    cut = dataclasses.replace(case, material=flows, steps=pd.Steps(times=times, plastic_growth=2e-3))
    found = pd.run(cut, tmp_path / "cut")
    assert set(times) <= set(found.history["t"]) and len(found.history["t"]) > len(times) + 1


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"times": (0.5,)}, "ascend from above 0 to 1"), ({"times": (0.5, 0.4, 1.0)}, "ascend"),
        ({"times": (0.0, 1.0)}, "ascend"), ({"times": (0.5, 0.5 + 1e-10, 1.0)}, "1e-08 apart"),
        ({"count": 3, "times": (0.5, 1.0)}, "a number of steps or their times, not 3"),
        ({"times": (0.1, 1.0), "smallest": 0.2}, "the shortest of them, 0.1, not 0.2"),
        ({"count": 4, "smallest": 0.3}, "the shortest of them, 0.25, not 0.3"),
    ],
)  # fmt: skip
def test_times_that_are_none_are_refused(wrong, words):
    with pytest.raises(pd.CaseError, match=words):
        pd.Steps(**wrong)
    if "count" not in wrong and "smallest" not in wrong:
        with pytest.raises(pd.CaseError, match=words):
            pd.AdaptiveSteps(**wrong)


def test_steps_to_times_are_cut_by_the_shortest_of_them():
    steps = pd.Steps(times=np.array([0.01, 0.1, 0.5, 1.0]))
    assert (steps.first, steps.largest, steps.least) == (0.5, 0.5, 0.01 / 64.0)
    assert steps.stops() == [0.01, 0.1, 0.5, 1.0]


@pytest.mark.parametrize(
    "changes, ratio",
    [
        ({}, 1.5),
        ({"particles": pd.LatticeNodes((0.0, 0.0), (8.0, 6.0), 1.0)}, 2.015),
        ({"scheme": pd.BondAssociated()}, 2.015),
        ({"scheme": pd.HigherOrder(3)}, 3.015),
        ({"material": pd.BondBased(E=1.0, plane="stress")}, 3.015),
        ({"damage": pd.PointDamage(pd.softening.Linear(), Gc=1.0, strength=0.01)}, 3.015),
    ],
)
def test_a_case_without_a_horizon_has_one_by_scheme(changes, ratio):
    assert pd.prepare(pulled(horizon=None, **changes)).cloud.horizon == pytest.approx(ratio)


def test_an_irregular_cloud_without_a_horizon_has_two_local_spacings(tmp_path):
    x = np.random.default_rng(1).uniform(-0.2, 0.2, (48, 2)) + SQUARE.chunk(0, 1).x
    cloud = pd.prepare(pulled(horizon=None, particles=pd.Arrays(x, np.full(48, 1.0)))).cloud
    assert cloud.horizon == pytest.approx(pd.Horizon(2.015).ratio)


def beam(n=3, load=None, **changes):
    """Return a cantilever of 8 by 1 with ``n`` particles over its height and a load at its end, here across it."""
    load = pd.Force(pd.region.Slab("x", low=7.5), y=1e-3) if load is None else load
    held = {"conditions": [pd.Clamp("-x"), load], "material": pd.LinearElastic(E=1000.0, nu=0.0, plane="stress")}
    return pd.Case(**{"particles": pd.Lattice((0.0, 0.0), (8.0, 1.0), 1.0 / n)} | held | changes)


PULL = pd.Traction("+y", y=1.0), pd.Traction("-y", y=-1.0)
COUPLE = pd.Traction(pd.region.Named("+x"), x=lambda x, t: t * (x[:, 1] - 0.5))


@pytest.mark.parametrize(
    ("case", "words"),
    [
        (beam(), "thick along y, 2 horizons: .* 5 % or more off; use 12 cells over it, or horizon=0.3383$"),
        (beam(2), "25 % or more off"),
        (beam(load=pd.Displacement("+x", y=1e-3)), "3 cells thick"),
        (beam(load=COUPLE), "3 cells thick"),
        (beam(6, horizon=3.015 / 6, material=pd.BondBased(E=1.0, plane="stress")), "use 24 cells over it$"),
        (beam(5), "use 12 cells"),
        (beam(6), ""),
        (beam(12), ""),
        (beam(2, horizon=1.015 / 2), "5 % or more off; use 6 cells over it$"),
        (beam(4, horizon=1.015 / 4), ""),
        (beam(load=pd.Traction("+x", x=1.0)), ""),
        (beam(conditions=[pd.Displacement("-y", x=0.0, y=0.0), pd.Displacement("+y", y=1e-3)]), ""),
        (beam(conditions=[pd.Displacement("-x", x=0.0, y=0.0), *PULL]), ""),
        (beam(particles=pd.LatticeNodes((0.0, 0.0), (8.0, 1.0), 1.0 / 3)), ""),
        (beam(particles=pd.LatticeNodes((0.0, 0.0), (8.0, 1.0), 1.0)), "1 cell thick .* 25 % or more off; use 6 cells"),
        (beam(particles=pd.LatticeNodes((0.0, 0.0), (8.0, 1.0), 0.5)), "2 cells thick .* 5 % or more off"),
        (
            beam(particles=pd.LatticeNodes((0.0, 0.0), (8.0, 1.0), 0.5), horizon=3.015 / 2),
            "25 % or more off; use 24 cells over it, or horizon=1.008$",
        ),
        (beam(particles=pd.LatticeNodes((0.0, 0.0), (8.0, 1.0), 0.5), load=pd.Traction("+x", x=1.0)), ""),
        (beam(particles=pd.Lattice((0.0, 0.0), (3.0, 1.0), 1.0 / 3), load=pd.Force("+x", y=1e-3)), ""),
    ],
)  # fmt: skip
def test_a_thin_body_that_bends_is_noted(case, words):
    """Not a body in tension, between platens or under the same pull on both sides."""
    prepared = pd.prepare(case)
    note = thin_note(prepared.case, prepared.problem)
    assert re.search(words, note) if words else note == ""


def test_a_lattice_that_is_held_inside_its_surface_is_told(tmp_path, caplog):
    caplog.set_level("INFO")
    notes = {}
    for name, changes in {"slab": {}, "clamp": {"conditions": [pd.Clamp("-x"), pd.Traction("+x", x=0.01)]}}.items():
        caplog.clear()
        pd.run(pulled(**changes), tmp_path / name)
        notes[name] = [
            record.getMessage() for record in caplog.records if "half a spacing inside" in record.getMessage()
        ]
    assert len(notes["slab"]) == 2 and "side -x" in notes["slab"][0] and "side +x" in notes["slab"][1]
    assert notes["clamp"] == []
