"""Natural frequencies and buckling factors: closed forms, benchmarks, ranks, units, shapes, refusals."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.optimize import brentq

import pdpetsc as pd
from tests.commands import results

LENGTH, E, RHO = 10.0, 1000.0, 2.0


def bar(count=3, unit=1.0, modulus=E, density=RHO, **changes):
    """Return a bar of nodes, held at one end."""
    given = {
        "particles": pd.LatticeNodes((0.0,), (LENGTH * unit,), 0.1 * unit),
        "horizon": 0.2015 * unit,
        "material": pd.LinearElastic(E=modulus, nu=0.0, density=density),
        "conditions": [pd.Clamp("-x")],
        "modes": pd.Modes(count),
    }
    return pd.Case(**{**given, **changes})


def along(k):
    """Return the frequencies of a bar with one free end."""
    return (2 * np.arange(1, k + 1) - 1) / (4.0 * LENGTH) * np.sqrt(E / RHO)


def test_a_bar_vibrates_as_it_should(tmp_path):
    run = pd.run(bar(), tmp_path)
    found = [run[f"frequency_{number}"] for number in (1, 2, 3)]
    np.testing.assert_allclose(found, along(3), rtol=2e-3)
    # Shapes are sines, with unit modal mass.
    x = run.x[:, 0]
    exact = np.sqrt(2.0 / (RHO * LENGTH)) * np.sin(0.5 * np.pi * x / LENGTH)
    np.testing.assert_allclose(np.abs(run.mode(1)[:, 0]), exact, atol=2e-3)
    with pytest.raises(pd.CaseError, match="3 modes, and no mode 4"):
        run.mode(4)


def test_a_bar_of_bonds_and_one_of_two_materials(tmp_path):
    """A heavy half: ``tan(w l / c_1) tan(w l / c_2) = c_2 / c_1`` for halves of length l of the same stiffness."""
    run = pd.run(bar(1, material=pd.BondBased(E, calibration="lattice", density=RHO)), tmp_path / "bonds")
    assert run["frequency_1"] == pytest.approx(along(1)[0], rel=0.03)
    right = pd.region.Slab("x", low=0.5 * LENGTH)
    light, heavy = (pd.LinearElastic(E=E, nu=0.0, density=density) for density in (RHO, 4.0 * RHO))
    run = pd.run(bar(1, material=[(~right, light), (right, heavy)]), tmp_path / "two")
    c1, c2, half = np.sqrt(E / RHO), np.sqrt(E / RHO) / 2.0, 0.5 * LENGTH
    w = brentq(lambda w: np.tan(w * half / c1) * np.tan(w * half / c2) - c2 / c1, 1e-3, 0.99 * 0.5 * np.pi * c2 / half)
    assert run["frequency_1"] == pytest.approx(w / (2.0 * np.pi), rel=0.01)


DRIVEN = {"end": pd.Mean(pd.displacement, "x", "+x"), "held": pd.Reaction("x", "-x")}


def response(tmp_path, count=4, **damping):
    """Return the table of amplitude and phase of a bar with an oscillating force at its end, and its run."""
    at = np.linspace(0.0, 1.2 * along(2)[1], 60)
    modes = pd.Modes(count, response=pd.FrequencyResponse(at.tolist(), **damping))
    conditions = [pd.Clamp("-x"), pd.Traction("+x", x=0.05)]
    run = pd.run(bar(conditions=conditions, modes=modes, history=DRIVEN), tmp_path)
    return np.genfromtxt(tmp_path / "response.csv", delimiter=",", names=True), run


@pytest.mark.parametrize("damping", [{"mass": 2.0}, {"stiffness": 0.004}, {"mass": 1.0, "stiffness": 0.002}])
def test_a_bar_responds_to_an_oscillating_force_as_it_should(damping, tmp_path):
    """``u = f tan(k L) / (E' k)``, ``k^2 = rho w (w - i m) / E'``, ``E' = E (1 + i w s)``, and the support's force."""
    table, run = response(tmp_path, **damping)
    w = 2.0 * np.pi * table["frequency"]
    w[0] = 1e-9
    modulus = E * (1.0 + 1j * w * damping.get("stiffness", 0.0))
    k = np.sqrt(RHO * w * (w - 1j * damping.get("mass", 0.0)) / modulus)
    # The reaction is that of the stiffness alone, without damping.
    exact = {
        "end": 0.05 * np.tan(k * LENGTH) / (modulus * k),
        "held": -0.05 / np.cos(k * LENGTH) * E / modulus,
    }
    for name, amplitude in exact.items():
        found = table[f"{name}_amplitude"] * np.exp(-1j * np.radians(table[f"{name}_phase"]))
        assert np.abs(found - amplitude).max() < 0.03 * np.abs(amplitude).max(), name
    most = int(np.argmax(table["end_amplitude"]))
    assert run["response_end"] == table["end_amplitude"][most] and run["response_end_at"] == table["frequency"][most]


def test_other_modes_respond_as_statics(tmp_path):
    """One mode and the static rest are close to twelve modes around the first frequency, and equal at none."""
    one, _ = response(tmp_path / "one", 1, ratio=0.05)
    many, _ = response(tmp_path / "many", 12, ratio=0.05)
    below = one["frequency"] < 1.5 * along(1)[0]
    size = many["end_amplitude"].max()
    assert np.abs(one["end_amplitude"] - many["end_amplitude"])[below].max() < 0.01 * size
    for table in (one, many):
        assert table["end_amplitude"][0] == pytest.approx(0.05 * LENGTH / E, rel=1e-6)


def test_what_does_not_respond_is_refused(tmp_path):
    shaken = pd.FrequencyResponse([1.0], ratio=0.1)
    with pytest.raises(pd.CaseError, match="needs damping"):
        pd.FrequencyResponse([1.0])
    with pytest.raises(pd.CaseError, match="at least one frequency"):
        pd.FrequencyResponse([], ratio=0.1)
    with pytest.raises(pd.CaseError, match="computed from natural frequencies"):
        pd.Modes(2, of="buckling", response=shaken)
    with pytest.raises(pd.SolveError, match="No load acts on free particles"):
        pd.run(bar(modes=pd.Modes(1, response=shaken), history=DRIVEN), tmp_path / "none")
    held = [pd.Clamp("-x"), pd.Force(pd.region.Nearest((0.0,)), x=1.0)]
    with pytest.raises(pd.SolveError, match="No load acts on free particles"):
        pd.run(bar(modes=pd.Modes(1, response=shaken), history=DRIVEN, conditions=held), tmp_path / "held")
    with pytest.raises(pd.CaseError, match="'work' of the history depends on the path"):
        pd.run(bar(modes=pd.Modes(1, response=shaken), history={"work": pd.ExternalWork()}), tmp_path / "path")


def strip(stretch):
    """Return a thin strip that is held at both ends and stretched."""
    return pd.Case(
        particles=pd.LatticeNodes((0.0, 0.0), (20.0, 0.5), 0.125),
        horizon=0.125 * 2.015,
        material=pd.NeoHookean(E=E, nu=0.0, plane="stress", density=RHO),
        conditions=[pd.Clamp("-x"), pd.Displacement("+x", x=20.0 * stretch, y=0.0)],
        modes=pd.Modes(1),
    )


def test_tension_raises_a_frequency_and_compression_beyond_buckling_makes_it_negative(tmp_path):
    """By Rayleigh ``f^2 = f_0^2 + 12.30 T / (4 pi^2 rho A L^2)`` for the first mode of a clamped beam."""
    none, pulled, pressed = (
        pd.run(strip(stretch), tmp_path / str(stretch))["frequency_1"] for stretch in (0.0, 0.0004, -0.01)
    )
    assert pulled**2 - none**2 == pytest.approx(12.30 * 0.0004 * E / (4.0 * np.pi**2 * RHO * 20.0**2), rel=0.05)
    assert pressed < 0.0


@pytest.mark.parametrize("options", [{"pc_type": "gamg"}, {"pd_jacobian": "matfree", "pc_type": "mg"}])
def test_only_a_factorisation_counts_unstable_modes(options, tmp_path):
    with pytest.raises(pd.SolveError, match="is unstable, or nothing tells"):
        pd.run(strip(-0.05), tmp_path, options=options)


@pytest.mark.parametrize("of", ["frequency", "buckling"])
def test_a_tangent_without_a_matrix_has_the_same_modes(of, tmp_path):
    """Newton's method solves its linear systems to 1e-3 only, the modes of a nonlinear body to round-off."""
    mass = [pd.Clamp("-x"), pd.RigidRegion(pd.region.Slab("x", low=4.0), force=(-0.1, 0.0))]
    case = with_mass(True, 1.0, modes=pd.Modes(2, of=of), conditions=mass)
    one, other = (
        pd.run(case, tmp_path / kind, options={"pd_jacobian": kind, "ksp_type": solver})
        for kind, solver in (("assembled", "preonly"), ("matfree", "cg"))
    )
    names = [f"{of}_1", f"{of}_2"]
    assert [other[name] for name in names] == pytest.approx([one[name] for name in names], rel=1e-7)


def with_mass(rigid, stiff=1e4, **changes):
    """Return a plane strip whose right part is heavy and stiff, or rigid."""
    nodes = pd.LatticeNodes((0.0, 0.0), (5.0, 0.5), 0.125)
    right = pd.region.Slab("x", low=4.0)
    light, heavy = (
        pd.NeoHookean(E=modulus, nu=0.0, plane="stress", density=density)
        for modulus, density in ((E, RHO), (stiff * E, 10.0 * RHO))
    )
    free = [pd.RigidRegion(right, force=(0.0, 0.0), moment=0.0, about=(4.5, 0.25))] if rigid else []
    given = {"material": [(~right, light), (right, heavy)], "conditions": [pd.Clamp("-x"), *free]}
    return pd.Case(nodes, **{**given, "horizon": 0.252, "modes": pd.Modes(3), **changes})


def test_a_strip_with_a_rigid_mass_vibrates_as_with_a_stiff_one(tmp_path):
    stiff, rigid = (pd.run(with_mass(kind), tmp_path / str(kind)) for kind in (False, True))
    names = [f"frequency_{number}" for number in (1, 2, 3)]
    assert [rigid[name] for name in names] == pytest.approx([stiff[name] for name in names], rel=0.02)
    # The mass turns as a rigid body, with the displacements of its middle line.
    shape, x = rigid.mode(1), rigid.x
    right = x[:, 0] > 3.99
    turn = np.polyfit(x[right, 0], shape[right, 1], 1)[0]
    np.testing.assert_allclose(shape[right, 0], -turn * (x[right, 1] - 0.25), atol=1e-3 * np.abs(shape).max())


def test_a_bar_with_a_rigid_mass_vibrates_and_responds_as_it_should(tmp_path):
    """``k l tan(k l) = m / M`` of a bar of length l and mass m; a slow force F moves the mass M by ``F l / (E A)``."""
    right = pd.region.Slab("x", low=7.95)
    mass = pd.RigidRegion(right, force=(0.05,))
    at = [0.0, 0.01, 0.05]
    modes = pd.Modes(2, response=pd.FrequencyResponse(at, ratio=0.01))
    heavy = [(right, pd.LinearElastic(E=E, nu=0.0, density=4.0 * RHO)), (~right, bar().material)]
    history = {"end": pd.Mean(pd.displacement, "x", "+x")}
    case = bar(material=heavy, conditions=[pd.Clamp("-x"), mass], modes=modes, history=history)
    run = pd.run(case, tmp_path)
    length, ratio = 8.0, 7.95 / (4.0 * 2.05)
    k = [brentq(lambda k: k * np.tan(k) - ratio, low + 1e-9, low + 0.5 * np.pi - 1e-6) for low in (0.0, np.pi)]
    exact = np.array(k) / length * np.sqrt(E / RHO) / (2.0 * np.pi)
    np.testing.assert_allclose([run["frequency_1"], run["frequency_2"]], exact, rtol=0.01)
    table = np.genfromtxt(tmp_path / "response.csv", delimiter=",", names=True)
    amplitude = table["end_amplitude"]
    assert amplitude[0] == pytest.approx(run.history["end"][-1], rel=1e-6)
    assert amplitude[0] == pytest.approx(0.05 * length / E, rel=0.01)
    assert amplitude[2] > amplitude[1] > amplitude[0]


TIP = """
import pdpetsc as pd

def case(unit=1.0, modulus=1000.0, mass=30.0, inertia=12.0):
    height, density = unit, 2.0
    about = (8.0 * unit, 0.5 * unit)
    tip = pd.RigidRegion(
        "+x", force=(0.0, 0.0), moment=0.0, about=about, mass=mass * unit**2, inertia=inertia * unit**4
    )
    return pd.Case(
        pd.LatticeNodes((0.0, 0.0), (8.0 * unit, height), 0.125 * unit),
        horizon=0.252 * unit,
        material=pd.NeoHookean(E=modulus, nu=0.0, plane="stress", density=density),
        conditions=[pd.Clamp("-x"), tip],
        modes=pd.Modes(2),
    )
"""


def test_a_beam_with_a_mass_and_a_moment_of_inertia_at_its_end_vibrates_as_it_should(tmp_path):
    """Two frequencies of a massless beam with a rigid body at its end, and its own mass by Rayleigh's third."""
    path = tmp_path / "tip.py"
    path.write_text(TIP)
    found = results(path, "mass=3000.0", "inertia=12000.0", output=tmp_path / "heavy")["results"]
    EI, L, shear = E / 12.0, 8.0, 5.0 / 6.0 * E / 2.0
    flexibility = np.array([[L**3 / 3.0 / EI + L / shear, L**2 / 2.0 / EI], [L**2 / 2.0 / EI, L / EI]])
    exact = 1.0 / (2.0 * np.pi * np.sqrt(np.linalg.eigvals(flexibility @ np.diag([3000.0, 12000.0]))))
    axial = np.sqrt(E / L / 3000.0) / (2.0 * np.pi)
    expected = np.sort(np.append(exact, axial))[:2]
    np.testing.assert_allclose([found["frequency_1"], found["frequency_2"]], expected, rtol=0.01)
    one = results(path, output=tmp_path / "one")["results"]
    for name, words, ranks in (("two", [], 2), ("free", ["-pd_jacobian", "matfree"], 2)):
        other = results(path, *words, ranks=ranks, output=tmp_path / name)["results"]
        assert other == pytest.approx(one, rel=1e-7)
    small = results(path, "unit=1e-6", "modulus=1e9", output=tmp_path / "small")["results"]
    assert {name: value * 1e-9 for name, value in small.items()} == pytest.approx(one, rel=1e-7)


@pytest.mark.parametrize("supports", ["free", "held sideways", "guided"])
def test_columns_under_a_rigid_cap_buckle_under_their_loads(supports, tmp_path):
    """Half waves of 2, 0.699 and 1 lengths: a cap moves and turns, turns, or moves only; Engesser's loads."""
    height, length = 1.0, 30.0
    kinds = {"free": (2.0, 0.0, 0.0), "held sideways": (0.69916, None, 0.0), "guided": (1.0, 0.0, None)}
    half, sideways, moment = kinds[supports]
    euler = np.pi**2 * E / 12.0 / (half * length) ** 2
    load = 1e-3 * euler / (1.0 + euler / (5.0 / 6.0 * E / 2.0))
    turns = {"moment": 0.0, "about": (length, 0.5)} if moment is not None else {}
    case = pd.Case(
        pd.LatticeNodes((0.0, 0.0), (length, height), 0.125),
        horizon=0.252,
        material=pd.NeoHookean(E=E, nu=0.0, plane="stress"),
        conditions=[pd.Clamp("-x"), pd.RigidRegion("+x", force=(-load, sideways), **turns)],
        modes=pd.Modes(1, of="buckling"),
    )
    run = pd.run(case, tmp_path)
    assert run["buckling_1"] == pytest.approx(1000.0, rel=0.01)


def test_modes_refuse_rigid_bodies_that_have_none(tmp_path):
    about = (0.5, 0.5, 1.0)
    block = {"particles": pd.LatticeNodes((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), 0.25), "horizon": 0.504}
    twisted = pd.RigidRegion("+z", force=(0.0, 0.0, 0.0), moment=(0.0, 0.0, 1.0), about=about)
    free = dataclasses.replace(twisted, moment=(0.0, 0.0, 0.0))
    with pytest.raises(pd.CaseError, match="a moment in space do not have"):
        pd.run(bar(**block, conditions=[pd.Clamp("-z"), twisted]), tmp_path / "twisted")
    block["particles"] = pd.Lattice((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), 0.25)
    with pytest.raises(pd.CaseError, match="no mass of their own"):
        pd.run(bar(**block, conditions=[pd.Clamp("-z"), free]), tmp_path / "layers")


@pytest.mark.long
def test_units_and_ranks_change_nothing(tmp_path):
    one = pd.run(bar(2), tmp_path / "one")
    other = pd.run(bar(2, 1e15, 1e-10, 1e-20), tmp_path / "other")
    scale = np.sqrt(1e-10 / E / (1e-20 / RHO)) / 1e15
    assert other["frequency_2"] / scale == pytest.approx(one["frequency_2"], rel=1e-8)
    command = ["runs/stability/columns.py", "n=4", "supports=pinned"]
    found = [results(*command, ranks=n, output=tmp_path / str(n))["results"]["buckling_1"] for n in (1, 2, 3)]
    np.testing.assert_allclose(found[1:], found[0], rtol=1e-6)


@pytest.mark.parametrize("load", [1e-3, 0.5])
@pytest.mark.parametrize("supports", ["free", "pinned", "clamped_pinned", "clamped"])
def test_columns_buckle_at_the_load_of_euler(supports, load, tmp_path):
    """The load at which they buckle does not depend on the part of it that is applied."""
    results("runs/stability/columns.py", "n=4", f"supports={supports}", f"load={load}", "--check", output=tmp_path)


def test_factors_of_a_run_that_continues_at_its_end_are_told_apart(tmp_path):
    """Its checkpoint lacks the equilibrium before the last one: the factors are those from the undeformed body."""
    case = pd.Case(
        particles=pd.LatticeNodes((0.0, 0.0), (8.0, 1.0), 0.25),
        material=pd.NeoHookean(E=100.0, nu=0.3, plane="stress"),
        conditions=[pd.Clamp("-x"), pd.Traction("+x", x=-0.12)],
        steps=pd.Steps(times=(0.5, 1.0)),
        modes=pd.Modes(1, of="buckling"),
    )
    runs = [pd.run(case, tmp_path / "whole"), pd.run(case, tmp_path / "again", restart=tmp_path / "whole")]
    told = [any("undeformed body and the last equilibrium" in one for one in run.summary["warnings"]) for run in runs]
    assert told == [False, True]
    # The first factor of a column that only compresses hardly depends on it.
    assert runs[1]["buckling_1"] == pytest.approx(runs[0]["buckling_1"], rel=0.01)


def test_a_tapered_membrane_has_the_frequencies_of_the_benchmark(tmp_path):
    results("runs/stability/modes.py", "n=12", "--check", output=tmp_path)


def test_a_matrix_free_tangent_has_the_same_modes(tmp_path):
    command = ["runs/stability/modes.py", "n=6"]
    one = results(*command, output=tmp_path / "one")["results"]
    other = results(*command, "-pd_jacobian", "matfree", output=tmp_path / "other")["results"]
    for name, value in one.items():
        assert other[name] == pytest.approx(value, rel=1e-7)


def test_what_has_no_modes_is_refused(tmp_path):
    with pytest.raises(pd.CaseError, match="density of each material, and LinearElastic has none"):
        pd.run(bar(density=None), tmp_path / "a")
    with pytest.raises(pd.CaseError, match="tangent of load steps"):
        pd.run(bar(solver=pd.DynamicRelaxation()), tmp_path / "b")
    with pytest.raises(pd.CaseError, match="fewer"):
        pd.run(bar(200), tmp_path / "c")
    tool = pd.RigidPlane((0.0, 0.51), (0.0, -1.0))
    rubbed = dataclasses.replace(strip(0.0), conditions=[pd.Clamp("-x"), pd.Contact("+y", tool, 0.3)])
    with pytest.raises(pd.CaseError, match="symmetric tangent"):
        pd.run(rubbed, tmp_path / "d")
