"""Heat conduction: linear temperatures are exact, heat is kept, cracks insulate, and equilibrium follows."""

import dataclasses
import json
import re

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.sparse import csr_matrix

import pdpetsc as pd
from pdpetsc.petsc.conduction import ScalarMatrix
from pdpetsc.petsc.options import Options
from pdpetsc.problem.expansion import PrescribedTemperature
from pdpetsc.terms.heat import ConductedTemperature, Conducting, Heat
from tests import scenes
from tests.commands import ROOT, history, results
from tests.run.test_durable import Stop

EVERYWHERE = pd.region.All()
LAW = pd.LinearElastic(E=1.0, nu=0.3)


def heat_of(model, k, declared=None, bonds=False):
    """Return the conduction of a small model with the conductivity (dim, dim) everywhere."""
    cloud, n = model.cloud, model.cloud.n_owned
    start = np.zeros(n)
    held = PrescribedTemperature(cloud, start)
    conducting = Conducting(np.broadcast_to(k, (n, *k.shape)), np.ones(n))
    omega = np.ones(len(model.families.neighbours))
    operator = None if bonds else (lambda: model.operator)
    body, damage = model.problem.body, model.problem.damage
    declared = pd.HeatConduction() if declared is None else declared
    return Heat(body, declared, conducting, operator, omega, ConductedTemperature(start), held, [], [], damage)


@pytest.mark.parametrize("dim", scenes.DIMS)
def test_linear_temperatures_have_their_flux_on_any_cloud(dim, rng):
    root = rng.standard_normal((dim, dim))
    k = root @ root.T + np.eye(dim)
    for name, scheme in scenes.SCHEMES.items():
        model = scenes.body(dim, scheme, rng=rng)
        for control in (None, 0.0, 3.0):
            heat = heat_of(model, k, pd.HeatConduction(control=control))
            K = heat.matrix().toarray()
            x, V = model.cloud.x, model.cloud.volume.sum()
            assert np.abs(K - K.T).max() < 1e-12 * np.abs(K).max(), name
            assert np.abs(K.sum(axis=1)).max() < 1e-11 * np.abs(K).max(), name
            assert np.abs(x.T @ K @ x / V - k).max() < 1e-11 * np.abs(k).max(), name
            assert np.linalg.eigvalsh(K)[1 if control != 0.0 else 0] > -1e-12
            slope = rng.standard_normal(dim)
            assert np.abs(heat.flux(7.0 + x @ slope) + k @ slope).max() < 1e-10 * np.abs(k).max(), name


def test_the_control_lets_no_temperature_pass_unseen():
    model = scenes.body(2, pd.Correspondence())
    free, held = (heat_of(model, np.eye(2), pd.HeatConduction(control=G)).matrix().toarray() for G in (0.0, 0.5))
    x = model.cloud.x
    board = (-1.0) ** x.sum(axis=1)
    assert board @ free @ board < 0.3 * (board @ held @ board)
    assert np.linalg.eigvalsh(held)[1] > 1e-3


def test_heat_along_bonds(rng):
    for dim in scenes.DIMS:
        model = scenes.bond_body(dim, pd.BondBased(10.0), rng=rng)
        K = heat_of(model, 2.0 * np.eye(dim), bonds=True).matrix().toarray()
        x, V = model.cloud.x, model.cloud.volume.sum()
        assert np.abs(K - K.T).max() < 1e-12 and np.abs(K.sum(axis=1)).max() < 1e-11
        assert abs(np.trace(x.T @ K @ x) / V / dim - 2.0) < 1e-12


def still(dim):
    return pd.Displacement(EVERYWHERE, **dict.fromkeys("xyz"[:dim], 0.0))


def shaken(dim, n=5, size=0.2, seed=0):
    low, high = np.zeros(dim), np.array([float(n)] + [4.0] * (dim - 1))
    lattice = pd.Lattice(low, high, 1.0)
    x = lattice.chunk(0, 1).x
    moved = x + size * np.random.default_rng(seed).uniform(-1.0, 1.0, x.shape)
    return pd.Arrays(moved, 1.0, facets=lattice.surface()), n


@pytest.mark.parametrize("dim", scenes.DIMS)
def test_flux_and_convection_through_the_surface_give_a_linear_temperature(dim, tmp_path):
    # Heat q enters at x = 0 and leaves at x = n to surroundings at T_s: T = T_s + q / h + q (n - x) / k.
    k, h, q, around = 3.0, 2.0, 5.0, 40.0
    particles, n = shaken(dim)
    case = pd.Case(
        particles, 2.6, pd.Thermal(LAW, conductivity=k),
        [
            still(dim),
            pd.HeatFlux(pd.region.Slab("x", high=0.0), q, pd.Hold()),
            pd.Convection(pd.region.Slab("x", low=float(n)), h, around),
        ],
        scheme=pd.Correspondence(), weights=pd.Conforming(), heat=pd.HeatConduction(),
        fields=[pd.temperature, pd.heat_flux],
    )  # fmt: skip
    result = pd.run(case, output=tmp_path)
    x = result.solution.x[:, 0]
    expected = around + q / h + q * (n - x) / k
    # The weights conform to their own tolerance.
    assert np.abs(pd.temperature(result.solution) - expected).max() < 1e-7 * around
    assert np.abs(pd.heat_flux(result.solution) - q * np.eye(dim)[0]).max() < 1e-6 * q
    assert result.field("heat_flux").shape == (len(x), 3)
    opened = pd.open(tmp_path)
    assert np.array_equal(opened.field("temperature"), result.field("temperature"))


def bar(*conditions, **changes):
    given = {
        "particles": pd.Lattice((0.0, 0.0), (12.0, 3.0), 1.0),
        "horizon": 2.015,
        "material": pd.Thermal(LAW, conductivity=2.0, capacity=5.0),
        "scheme": pd.Correspondence(),
        "conditions": [still(2), *conditions],
        "fields": [pd.temperature],
        "history": {"heat": pd.Mean(pd.temperature)},
        "steps": pd.Steps(4),
    }
    return pd.Case(**{**given, **changes})


def test_heat_is_kept_and_sources_heat(tmp_path):
    for rule in ("backward_euler", "crank_nicolson"):
        for law in (LAW, pd.BondBased(1.0)):
            case = bar(
                pd.HeatSource(pd.region.Slab("x", high=4.0), lambda x, t: 6.0 + 0.0 * x[:, 0]),
                pd.HeatFlux(pd.region.Slab("x", low=12.0), -0.5, pd.Hold()),
                material=pd.Thermal(law, conductivity=2.0, capacity=5.0),
                scheme=None if isinstance(law, pd.BondBased) else pd.Correspondence(),
                heat=pd.HeatConduction(duration=3.0, rule=rule, start=lambda x: x[:, 0] ** 2),
            )
            found = np.array(pd.run(case, output=tmp_path / "run").history["heat"])
            # Power 6 in 12 units of volume, 0.5 out of an area of 3, over a capacity of 5 * 36.
            rise = (6.0 * 12.0 - 0.5 * 3.0) * 3.0 / (5.0 * 36.0)
            assert np.allclose(np.diff(found), 0.25 * rise, rtol=1e-9)


def test_order_in_time(tmp_path):
    def middle(rule, steps):
        case = bar(
            pd.Temperature(pd.region.Slab("x", high=1.0) | pd.region.Slab("x", low=11.0), 0.0, pd.Hold()),
            heat=pd.HeatConduction(duration=40.0, rule=rule, start=lambda x: np.sin(np.pi * (x[:, 0] - 0.5) / 11.0)),
            steps=pd.Steps(steps), history={"T": pd.At((5.5, 1.5), pd.temperature)}, checkpoints=0,
        )  # fmt: skip
        return pd.run(case, output=tmp_path / "run").history["T"][-1]

    for rule, order in (("backward_euler", 1.0), ("crank_nicolson", 2.0)):
        a, b, c = (middle(rule, n) for n in (4, 8, 16))
        assert abs(np.log2((a - b) / (b - c)) - order) < 0.15


def test_cracks_and_broken_bonds_insulate(tmp_path):
    hot = pd.Temperature(pd.region.Slab("x", high=2.0), 80.0, pd.Hold())
    crack = pd.Segment((6.0, -1.0), (6.0, 4.0))
    material = pd.Thermal(LAW, conductivity=2.0, capacity=5.0)
    for law in (LAW, pd.BondBased(1.0)):
        case = bar(
            hot, material=dataclasses.replace(material, material=law), cracks=[crack],
            scheme=None if isinstance(law, pd.BondBased) else pd.Correspondence(),
            heat=pd.HeatConduction(duration=1e4, start=20.0),
        )  # fmt: skip
        result = pd.run(case, output=tmp_path / "crack")
        T, x = pd.temperature(result.solution), result.solution.x
        assert np.abs(T[x[:, 0] < 6.0] - 80.0).max() < 1e-3 and np.abs(T[x[:, 0] > 6.0] - 20.0).max() < 1e-7
        steady = dataclasses.replace(case, heat=pd.HeatConduction(start=20.0))
        T = pd.temperature(pd.run(steady, output=tmp_path / "steady").solution)
        assert np.abs(T[x[:, 0] < 6.0] - 80.0).max() < 1e-7 and np.abs(T[x[:, 0] > 6.0] - 20.0).max() < 1e-7


def test_bonds_that_break_insulate_from_the_next_step_on(tmp_path):
    pulled = [
        pd.Displacement(pd.region.Slab("x", high=2.0), x=0.0, y=0.0),
        pd.Displacement(pd.region.Slab("x", low=10.0), x=lambda x, t: min(12.0 * t, 3.0) + 0.0 * x[:, 0], y=0.0),
    ]  # fmt: skip
    hot = pd.Temperature(pd.region.Slab("x", high=2.0), 80.0, pd.Hold())
    law = pd.Brittle(pd.CriticalFunction(lambda length, middle: np.where(np.abs(middle[:, 0] - 6.0) < 0.6, 0.05, 10.0)))
    for material, scheme, control in (
        (pd.BondBased(1.0), None, None), (pd.Hencky(1.0, 0.3), pd.Correspondence(), pd.Silling(0.5)),
    ):  # fmt: skip
        case = bar(
            material=pd.Thermal(material, conductivity=2.0, capacity=5.0), scheme=scheme, control=control,
            heat=pd.HeatConduction(duration=1e4, start=20.0), damage=law, steps=pd.Steps(4),
        )  # fmt: skip
        case = dataclasses.replace(case, conditions=[*pulled, hot])
        result = pd.run(case, output=tmp_path / "run")
        T, x = pd.temperature(result.solution), result.solution.x
        right = T[x[:, 0] > 6.0]
        first = np.array(pd.open(tmp_path / "run").field("temperature", 1))[x[:, 0] > 6.0]
        assert result.solution.broken_bonds > 10
        assert first.min() > 75.0  # the bonds broke at the end of this step, of a long time
        assert np.ptp(right) < 1e-6 and abs(right.mean() - first.mean()) < 1e-6


def test_equilibrium_follows_the_temperature(tmp_path):
    # What conduction finds and what is prescribed alike give the same body.
    hot = pd.Temperature(pd.region.Slab("x", high=2.0), 80.0, pd.Ramp())
    cold = pd.Temperature(pd.region.Slab("x", low=10.0), 0.0)
    held = pd.Displacement(pd.region.Slab("x", high=1.0), x=0.0, y=0.0)
    material = pd.Thermal(pd.Hencky(1.0, 0.3), 1e-3, conductivity=1.0, factor=lambda T: 1.0 - 1e-3 * T)
    both = {"control": pd.Silling(0.5), "material": material, "steps": pd.Steps(2)}
    bare = bar(**both)
    found = pd.run(
        dataclasses.replace(bare, conditions=[held, hot, cold], heat=pd.HeatConduction()), output=tmp_path / "one"
    )
    T = pd.temperature(found.solution)
    given = pd.Temperature(EVERYWHERE, T.copy())
    again = pd.run(dataclasses.replace(bare, conditions=[held, given]), output=tmp_path / "two")
    assert 1.0 < np.ptp(T) <= 80.0 and np.abs(found.solution.u).max() > 0.1
    assert np.abs(found.solution.u - again.solution.u).max() < 1e-9


def quenched(folder, force=1.0, length=1.0, time=1.0, degree=1.0, restart=None, options=None, **changes):
    """Run a plate that is cooled at one side, in some units of force, length, time and temperature."""
    stress, power = force / length**2, force * length / time
    material = pd.Thermal(
        pd.NeoHookean(E=100.0 * stress, nu=0.3), 1e-4 / degree, reference=300.0 * degree,
        conductivity=2.0 * power / length / degree, capacity=5.0 * stress / degree,
    )  # fmt: skip
    given = {
        "particles": pd.Lattice((0.0, 0.0), (6.0 * length, 4.0 * length), length, thickness=length),
        "horizon": 2.015 * length,
        "material": material,
        "scheme": pd.Correspondence(),
        "control": pd.Silling(0.5),
        "conditions": [
            pd.Displacement(pd.region.Slab("x", high=length), x=0.0, y=0.0),
            pd.Convection(pd.region.Slab("y", high=0.0), 3.0 * power / length**2 / degree, 20.0 * degree),
        ],
        "heat": pd.HeatConduction(duration=2.0 * time, rule="crank_nicolson"),
        "steps": pd.Steps(4),
        "fields": [pd.displacement, pd.stress, pd.temperature, pd.heat_flux],
        "history": {"R": pd.Reaction("x", pd.region.Slab("x", high=length)), "T": pd.Mean(pd.temperature)},
    }
    case = pd.Case(**{**given, **changes})
    return pd.run(case, output=folder, restart=restart, options=options)


@pytest.mark.long
def test_quenching_in_other_units_after_a_restart_and_without_a_matrix(tmp_path):
    whole = quenched(tmp_path / "whole")
    assert 100.0 < whole.history["T"][-1] < 290.0
    for units in ((2.0**67, 2.0**-67, 2.0**20, 2.0**9), (1e-5, 1e4, 1e-3, 1e2)):
        other = quenched(tmp_path / "units", *units)
        assert np.abs(np.array(other.history["T"]) / units[3] - whole.history["T"]).max() < 1e-8
        assert np.abs(other.solution.u / units[1] - whole.solution.u).max() < 1e-9
    with pytest.raises(pd.Interrupted):
        quenched(tmp_path / "part", history={"until": Stop(0.5)})
    rest = quenched(tmp_path / "rest", restart=tmp_path / "part")
    assert np.array_equal(rest.solution.u, whole.solution.u)
    assert np.array_equal(pd.temperature(rest.solution), pd.temperature(whole.solution))
    free = quenched(tmp_path / "free", options={"pd_jacobian": "matfree", "pc_type": "gamg"})
    assert np.abs(free.solution.u - whole.solution.u).max() < 1e-7 * np.abs(whole.solution.u).max()
    multigrid = quenched(tmp_path / "gamg", options={"heat_pc_type": "gamg"})
    assert np.abs(pd.temperature(multigrid.solution) - pd.temperature(whole.solution)).max() < 1e-8


def test_half_a_plate_before_a_mirror_is_half_a_plate(tmp_path):
    def plate(width, **changes):
        held = pd.Displacement(EVERYWHERE, x=0.0, y=0.0)
        cooled = pd.Convection(pd.region.Slab("y", high=0.0), 3.0, lambda x, t: 20.0 + x[:, 0] ** 2)
        return quenched(
            tmp_path / "run", particles=pd.Lattice((-width, 0.0), (4.0, 4.0), 1.0), conditions=[held, cooled],
            history={}, **changes,
        )  # fmt: skip

    whole, half = plate(4.0), plate(0.0, symmetry=[pd.Symmetry("x")])
    right = whole.solution.x[:, 0] > 0.0
    for field in (pd.temperature, pd.heat_flux):
        a, b = field(whole.solution)[right], field(half.solution)
        assert np.abs(a - b).max() < 1e-9 * np.abs(a).max()


@pytest.mark.long
def test_slab_against_the_series_and_on_two_ranks(tmp_path):
    words = "runs/thermal/slab.py", "n=20", "steps=40"
    found = results(*words, "dim=2", output=tmp_path / "one")["results"]
    assert found["error"] < 0.016 and abs(found["middle"] - 0.4745) < 0.016
    few = *words[:2], "steps=4", "dim=2"
    found = results(*few, output=tmp_path / "few")["results"]
    again = results(*few, ranks=2, output=tmp_path / "two")["results"]
    assert abs(again["middle"] - found["middle"]) < 1e-9
    assert results(*words, "conduct=bonds", "face=particles", output=tmp_path / "bonds")["results"]["error"] < 0.04


def test_what_cannot_be_is_refused(tmp_path):
    hot = pd.Temperature(pd.region.Slab("x", high=2.0), 80.0)
    flux = pd.HeatFlux(pd.region.Slab("x", high=0.0), 1.0)
    in_time = pd.HeatConduction(duration=1.0)
    for case, message in (
        (bar(hot, heat=in_time), "takes time: say with schedule"),
        (bar(flux, heat=in_time), "HeatFlux condition 2 is a number"),
        (bar(flux, heat=pd.HeatConduction()), "fixes the level"),
        (bar(flux), "needs heat conduction"),
        (bar(hot, heat=pd.HeatConduction(), material=LAW), "needs the conductivity of every material"),
        (bar(heat=in_time, material=pd.Thermal(LAW, conductivity=1.0)), "needs the capacity"),
        (bar(hot, heat=pd.HeatConduction(start=lambda x: x)), "one finite number per particle"),
        (bar(hot, pd.HeatSource(EVERYWHERE, lambda x, t: 1.0 / 0.0), heat=pd.HeatConduction()), "ZeroDivisionError"),
        (bar(hot, heat=pd.HeatConduction(), fields=[], solver=pd.PathFollowing()), "Newton"),
    ):
        with pytest.raises(pd.CaseError, match=message):
            pd.run(case, output=tmp_path / "refused")
    lonely = bar(
        hot, pd.HeatSource(pd.region.Slab("x", low=8.0), 1.0), cracks=[pd.Segment((6.0, -1.0), (6.0, 4.0))],
        heat=pd.HeatConduction(),
    )  # fmt: skip
    with pytest.raises(pd.SolveError, match="gains heat that nothing takes away"):
        pd.run(lonely, output=tmp_path / "lonely")
    with pytest.raises(pd.CaseError, match="has no heat conduction"):
        pd.run(bar(pd.Temperature(EVERYWHERE, 1.0), fields=[pd.heat_flux]), output=tmp_path / "field")


@pytest.mark.long
def test_cracks_of_a_quenched_plate_are_further_apart_where_they_are_deep(tmp_path):
    found = results("runs/thermal/quench.py", output=tmp_path)["results"]
    spacing = [found[f"spacing_{n}"] for n in range(4)]
    assert spacing == sorted(spacing) and spacing[3] >= 1.4 * spacing[0]
    # Arrays of least energy: at the surface their spacing where the plate has most energy, deeper cracks further apart.
    least = json.loads((ROOT / "runs/thermal/quench_elements.json").read_text())
    grown = [row["spacing"] for row in least]
    assert grown == sorted(grown) and [row["depth"] for row in least[:4]] == sorted(row["depth"] for row in least[:4])
    assert spacing[0] == pytest.approx(max(least, key=lambda row: row["without_cracks"])["spacing"], rel=0.2)
    assert found["spacing_0_over_least"] == pytest.approx(spacing[0] / least[2]["spacing"], rel=1e-3)
    assert 1.0 < spacing[3] / np.interp(1.8, [row["depth"] for row in least[:4]], grown[:4]) < 1.7


@pytest.mark.long
def test_a_quenched_plate_breaks_alike_on_two_ranks(tmp_path):
    words = "runs/thermal/quench.py", "dx=0.2", "half=2", "width=5", "steps=5", "time=0.1"
    one, two = (results(*words, ranks=ranks, output=tmp_path / str(ranks)) for ranks in (1, 2))
    broken = [history(tmp_path / str(ranks))["broken"] for ranks in (1, 2)]
    assert broken[0][-1] > 20
    assert np.array_equal(*broken)
    assert abs(one["results"]["cooled_to"] - two["results"]["cooled_to"]) < 1e-7


@pytest.mark.parametrize("of_bonds", [True, False])
def test_softening_does_not_lose_the_time_of_the_heat(of_bonds, tmp_path):
    """A heat source in an insulated body: q t / c in every step, also in those with sweeps of damage."""
    critical = pd.CriticalFunction(lambda length, middle: np.where(np.abs(middle[:, 0] - 3.0) < 0.6, 0.05, 10.0))
    material = pd.BondBased(1.0) if of_bonds else pd.Hencky(1.0, 0.3)
    points = {} if of_bonds else {"scheme": pd.Correspondence(), "control": pd.Silling(0.5)}
    case = pd.Case(
        particles=pd.Lattice((0.0, 0.0), (6.0, 5.0), 1.0),
        horizon=2.015,
        material=pd.Thermal(material, 0.0, conductivity=1.0, capacity=2.0),
        conditions=[
            pd.Displacement(pd.region.Slab("x", high=1.0), x=0.0, y=0.0),
            pd.Displacement(pd.region.Slab("x", low=5.0), x=1.0, y=0.0),
            pd.HeatSource(pd.region.All(), 6.0, pd.Hold()),
        ],
        heat=pd.HeatConduction(duration=10.0),
        damage=pd.LinearSoftening(critical, ratio=2.0),
        steps=pd.Steps(4),
        history={"T": pd.Mean(pd.temperature)},
        **points,
    )
    history = pd.run(case, tmp_path).history
    assert np.allclose(history["T"], 30.0 * history["t"], rtol=1e-9, atol=1e-9)


def test_heat_that_enters_a_particle_that_nothing_joins_to_others_has_nowhere_to_go():
    """In steady conduction: its row is zero, and a solution that left its heat out would be none."""
    model = scenes.bond_body(1, pd.BondBased(1.0))
    n = model.cloud.n_owned
    near = np.diag(np.r_[2.0 * np.ones(n - 1), 0.0])
    near[: n - 1, : n - 1] -= np.diag(np.ones(n - 2), 1) + np.diag(np.ones(n - 2), -1)
    held = np.zeros(n, dtype=bool)
    held[0] = True
    matrix = ScalarMatrix(model.cloud, csr_matrix(near), held, Options({}))
    b, start = np.ones(n), np.full(n, 3.0)
    b[-1] = 0.0
    found, good = matrix.solve(b, start)
    assert good and found[-1] == 3.0
    b[-1] = 1.0
    assert not matrix.solve(b, start)[1]
    matrix.destroy()


TIED = """
import pdpetsc as pd

def case(dim=2, coupling="staggered"):
    low, high = (0.0,) * (dim - 1), (1.0,) * (dim - 1)
    parts = {
        "a": pd.LatticeNodes((0.0, *low), (2.0, *high), 0.25),
        "b": pd.LatticeNodes((2.0, *low), (4.0, *high), 0.2),
    }
    law = pd.LinearElastic(E=100.0, nu=0.3)
    return pd.Case(
        particles=pd.Bodies(parts),
        material=pd.Thermal(law, 1e-3, conductivity=2.0, capacity=1.0),
        heat=pd.HeatConduction(duration=1e6, coupling=coupling),
        conditions=[
            pd.Displacement("a -x", **dict.fromkeys("xyz"[:dim], 0.0)),
            pd.Tied("a +x", "b -x"),
            pd.Temperature("a -x", 0.0, schedule=pd.Hold()),
            pd.HeatFlux("b +x", 5.0, schedule=pd.Hold()),
        ],
        history={
            "apart": pd.LargestError(pd.temperature, lambda x, t: 2.5 * t * x[:, 0]),
            "q": pd.Mean(pd.heat_flux, "x"),
        },
        results=lambda h: {"apart": h["apart"][-1], "q": h["q"][-1]},
    )
"""


def test_heat_passes_a_tie_as_it_passes_the_body(tmp_path):
    """The resistance of the tie is that of a thousandth of a spacing, on any ranks and with either coupling."""
    path = tmp_path / "tied.py"
    path.write_text(TIED)
    for words, ranks in (([], 1), ([], 3), (["coupling=monolithic"], 2), (["dim=3"], 2)):
        found = results(path, *words, ranks=ranks, output=tmp_path / f"{ranks}{len(words)}")["results"]
        assert found["apart"] < 2.5 * 0.25e-3 * (1.0 + 1e-3)
        assert found["q"] == pytest.approx(-5.0, rel=1e-5)


def slab(x, time, biot=1.0):
    """Return the temperature (n,) of a slab, insulated at x = 0, that convects at x = 1 (Carslaw and Jaeger, 3.11)."""
    z = np.array([brentq(lambda z: z * np.sin(z) - biot * np.cos(z), n * np.pi, (n + 0.5) * np.pi) for n in range(20)])
    return 4.0 * np.sin(z) / (2.0 * z + np.sin(2.0 * z)) * np.exp(-(z**2) * time) @ np.cos(np.outer(z, x))


CONVECTING = [
    (pd.Standard(), 3.015, 0.0),
    (pd.Standard(), 2.015, 0.2),
    (pd.Standard(), 1.5, 0.0),
    (pd.Conforming(), 3.015, 0.0),
    (pd.Conforming(), 2.015, 0.2),
    (None, 3.015, 0.0),
]


@pytest.mark.parametrize(("weights", "horizon", "shake"), CONVECTING)
def test_the_error_near_a_surface_that_convects_is_noted(weights, horizon, shake, tmp_path):
    """Without conforming weights, the note bounds it; with them it is 1.2 % where the horizon is 0.15 of the slab."""
    n, time = 20, 0.2
    dx = 1.0 / n
    lattice = pd.Lattice((0.0, 0.0), (1.0, 0.3), dx)
    x = lattice.chunk(0, 1).x
    moved = x + shake * dx * np.random.default_rng(0).uniform(-1.0, 1.0, x.shape)
    case = pd.Case(
        particles=pd.Arrays(moved, dx**2, facets=lattice.surface()) if shake else lattice,
        horizon=horizon * dx,
        material=pd.Thermal(pd.BondBased(1.0) if weights is None else LAW, conductivity=1.0, capacity=1.0),
        conditions=[still(2), pd.Convection(pd.region.Slab("x", low=1.0), 1.0, 0.0)],
        heat=pd.HeatConduction(duration=time, rule="crank_nicolson", start=1.0),
        steps=pd.Steps(40),
        scheme=None if weights is None else pd.Correspondence(),
        weights=weights,
    )
    run = pd.run(case, tmp_path)
    off = np.abs(pd.temperature(run.solution) - slab(run.solution.x[:, 0], time)).max()
    told = [note for note in run.summary["notes"] if "surfaces that convect" in note]
    if isinstance(weights, pd.Conforming):
        assert told == [] and off < 0.013
    elif told:
        assert off > 0.02 and off < 0.01 * float(re.search(r"up to (\S+) %", told[0]).group(1))
    else:
        assert off < 0.01
