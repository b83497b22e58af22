"""The event-driven solver: exact paths, energy balance, the paper's localisation, agreement with Newton."""

import csv
import dataclasses
import sys

import h5py
import numpy as np
import pytest

import pdpetsc as pd
from pdpetsc.solvers.event_driven.direction import Changed, find_direction
from tests import reference
from tests.commands import ROOT, called, history, results

sys.path.append(str(ROOT / "runs/localisation"))
import cell_2d
import notched_bar
import periodic_cell

CELL = "runs/localisation/periodic_cell.py"


def broken(folder):
    with (folder / "broken_bonds.csv").open() as file:
        return list(csv.DictReader(file))


def imbalance(work, displacement, force, h):
    """Return the largest error of the energy balance of an event, over all work done."""
    done = np.concatenate([[0.0], np.cumsum(0.5 * (force[1:] + force[:-1]) * np.diff(displacement))]) * work
    error = done - h["energy"] - h["dissipated"]
    return np.abs(np.diff(error)).max() / done.max(), np.abs(error).max() / done.max()


def one_bond(ratio=1.0, k_factor=1.0):
    """Return two particles and a spring in series: a bar of three particles, of which one bond can fail."""
    law = pd.CriticalFunction(lambda length, middle: np.where(middle[:, 0] > 1.0, 0.01, 1e9))
    return pd.Case(
        particles=pd.Arrays([[0.5], [1.5], [2.5]], 1.0),
        horizon=1.1,
        material=pd.BondBased(E=100.0, calibration="lattice"),
        damage=pd.Brittle(law) if ratio == 1.0 else pd.LinearSoftening(law, ratio),
        conditions=[
            pd.Displacement(pd.region.Nearest((0.5,)), x=0.0),
            pd.Displacement(pd.region.Nearest((2.5,)), x=0.1),
        ],
        solver=pd.EventDriven(),
        history={
            "displacement": pd.At((2.5,), pd.displacement, "x"),
            "force": pd.Reaction("x", pd.region.Nearest((2.5,))),
            "energy": pd.StrainEnergy(),
            "dissipated": pd.DissipatedEnergy(),
        },
    )


@pytest.mark.parametrize("ratio", [1.0, 1.5, 2.0, 4.0])
def test_one_bond_in_series_with_another_follows_its_law(ratio, tmp_path):
    """Two equal springs: the softening one stretches to r l while the other unloads; below r = 2 that snaps back."""
    pd.run(one_bond(ratio), output=tmp_path)
    h = history(tmp_path)
    k, limit = 100.0, 0.01
    assert h["displacement"][:3] == pytest.approx([0.0, 2.0 * limit, ratio * limit], abs=1e-15)
    assert h["force"][:3] == pytest.approx([0.0, k * limit, 0.0], abs=1e-12)
    assert h["dissipated"][-1] == pytest.approx(0.5 * k * limit * ratio * limit, rel=1e-12)
    assert h["displacement"][-1] == pytest.approx(0.1)
    assert max(imbalance(1.0, h["displacement"], h["force"], h)) < 1e-14


@pytest.mark.parametrize("critical", ["constant", "decreasing", "increasing"])
@pytest.mark.parametrize("n", [10, 20, *(pytest.param(n, marks=pytest.mark.long) for n in (50, 100))])
def test_energy_balances_at_every_event(n, critical, tmp_path):
    found = results(CELL, f"n={n}", f"critical={critical}", output=tmp_path)["results"]
    h = history(tmp_path)
    each, whole = imbalance(1.0, h["displacement"], h["force"], h)
    # Ten nodes with a decreasing law pass a state that is nearly free, which enlarges round-off.
    assert max(each, whole) < (1e-9 if (n, critical) == (10, "decreasing") else 1e-11)
    assert found["events"] == len(h["force"]) - 2
    assert np.all(np.diff(h["dissipated"]) > -1e-16)
    # Elastic stiffness E A / l, and no force left at the end.
    assert h["force"][1] / h["displacement"][1] == pytest.approx(periodic_cell.E, rel=1e-5)
    assert abs(h["force"][-1]) < 1e-9 * found["max_force"]


@pytest.mark.parametrize("n", [10, 20, *(pytest.param(n, marks=pytest.mark.long) for n in (50, 100, 200))])
def test_constant_critical_stretch_breaks_a_triangle(n, tmp_path):
    """Fig. 4 and 5: the same maximum force and final displacement for all n, one section cut, every bond across it."""
    found = results(CELL, f"n={n}", output=tmp_path)["results"]
    assert found["max_force"] == pytest.approx(periodic_cell.E * 0.01, rel=1e-5)
    assert found["final_displacement"] == pytest.approx(0.001, rel=1e-4)
    assert found["max_damage"] == 1.0
    m = n // 10
    assert found["events"] == m * (m + 1)
    length = np.array([round(float(row["length"]) * n) for row in broken(tmp_path)])
    middle = np.array([float(row["x"]) for row in broken(tmp_path)])
    assert [np.count_nonzero(length == k) for k in range(1, m + 1)] == list(range(1, m + 1))
    # Every one spans the section of the first, which is one of the shortest.
    apart = np.abs((middle - middle[0] + 0.5) % 1.0 - 0.5) * n
    assert np.all(apart <= 0.5 * (length - 1) + 0.01)
    if n <= 100:
        assert length.tolist() == reference.lengths_of_broken_bonds(n, m)
    # The energy of the triangle: k bonds of length k spacings, each 1/2 E A eps^2 l.
    area = 2.0 / (m * (m + 1))
    energy = 0.5 * periodic_cell.E * area * 0.01**2 * sum(k * k / n for k in range(1, m + 1))
    assert found["dissipated"] == pytest.approx(energy, rel=1e-4)


def test_the_order_of_the_text_is_that_of_links_of_equal_stiffness():
    """Section 3.2.1: runs 1 to m, 2 to m, 3 to m. Bonds of equal modulus and area, k ~ 1 / length, break otherwise."""
    m = 6
    assert reference.lengths_of_broken_bonds(40, m, 0) == [k for first in range(1, m + 1) for k in range(first, m + 1)]
    assert reference.lengths_of_broken_bonds(40, m, 1)[: m + 1] == [1, 2, 3, 4, 2, 3, 3]


def test_decreasing_critical_stretch_breaks_layers_before_it_localises(tmp_path):
    """Fig. 6: plateaus of force while the longest layers break one after the other, then a triangle.

    S_k = k (k + 1) / 2 bonds no longer than k spacings cross a section, each with the area 1 / 55. Layer k begins to
    fail at E eps_k S_k / 55. While it breaks bond by bond the part of the cell without it grows at a constant mean
    force F: the work of F beyond what is stored, 1/2 F^2 (55 / S_(k-1) - 55 / S_k) / E a length, is the energy of one
    bond a spacing, 1/2 E eps_k^2 k / 55. So F = E eps_k sqrt(S_k S_(k-1)) / 55.
    """
    found = results(CELL, "n=100", "critical=decreasing", output=tmp_path)["results"]
    h = history(tmp_path)
    rows = broken(tmp_path)
    length = np.array([round(100 * float(row["length"])) for row in rows])
    step = np.array([int(row["step"]) for row in rows])
    horizontal = []
    for k in (10, 9, 8, 7):
        first = np.flatnonzero(length == k)
        assert np.array_equal(first, np.arange(first[0], first[0] + 100))
        full, less = k * (k + 1) / 2, k * (k - 1) / 2
        eps = 0.01 - 0.00099 * k
        # A bond is at its limit one event before it is broken.
        assert h["force"][step[first[0]] - 1] == pytest.approx(periodic_cell.E * eps * full / 55, rel=3e-3)
        middle = step[first[25:75]]
        mean = 0.5 * (np.median(h["force"][middle - 1]) + np.median(h["force"][middle]))
        assert mean == pytest.approx(periodic_cell.E * eps * np.sqrt(full * less) / 55, rel=1e-3)
        horizontal.append(mean / periodic_cell.E * 100)
    # As the text reads them off the figure, in 1e-2.
    assert horizontal == pytest.approx([0.01, 0.08, 0.12, 0.135], rel=0.005, abs=0.001)
    # The rest is a triangle across one section, 21 bonds with lengths below 7, and a few beside it.
    place = np.array([float(row["x"]) for row in rows])[length < 7]
    assert 21 <= len(place) < 30
    assert np.ptp((place - place[0] + 0.5) % 1.0) < 0.15
    assert (found["max_damage"], found["opened"], found["closed"]) == (1.0, 1.0, 0.0)
    # The gap opens until the strongest of the six lengths across it is broken.
    assert found["final_displacement"] == pytest.approx(max(0.01 * k * (0.01 - 0.00099 * k) for k in range(1, 7)))


@pytest.mark.long
def test_increasing_critical_stretch_leaves_no_section_cut(tmp_path):
    """Fig. 7: the force vanishes though no section has lost all of its bonds; parts of the cell overlap and slide."""
    segments, peaks = [], []
    for seed in (1, 2, 3):
        found = results(CELL, "n=100", "critical=increasing", f"seed={seed}", output=tmp_path)["results"]
        h = history(tmp_path)
        assert abs(h["force"][-1]) < 1e-9 * found["max_force"]
        assert found["max_damage"] < 0.9
        length = np.array([round(100 * float(row["length"])) for row in broken(tmp_path)])
        # Most broken bonds are in the weakest layers, of which only the last one has lost all; all layers lose some.
        count = np.bincount(length, minlength=11)[1:]
        assert count[:5].sum() > 0.8 * count.sum()
        assert count[0] == 100
        assert count[1:].max() < 100
        assert count.min() > 0
        with h5py.File(tmp_path / "fields.h5") as file:
            u = file[max(name for name in file if name.startswith("step"))]["displacement"][:, 0]
        elongation = h["displacement"][-1]
        gaps = np.diff(u, append=u[0] + elongation) / elongation
        moved = np.abs(gaps) > 1e-6
        # Every gap that moves opens or closes by the whole elongation, and they do so in turn.
        signs = np.sign(gaps[moved])
        assert gaps[moved] == pytest.approx(signs, abs=1e-6)
        assert (found["opened"], found["closed"]) == (np.count_nonzero(signs > 0.0), np.count_nonzero(signs < 0.0))
        assert found["opened"] == found["closed"] + 1.0
        assert np.count_nonzero(signs[1:] == signs[:-1]) <= 1
        segments.append(len(signs))
        peaks.append(found["max_force"])
    # The representative realisation has three segments; another has another path and mechanism.
    assert segments[0] == 3
    assert max(segments) > 3
    assert np.ptp(peaks) > 1e-3 * peaks[0]


def test_the_place_is_random_and_the_response_is_not_where_the_critical_stretch_is_constant(tmp_path):
    runs = []
    for seed in (1, 2, 3):
        pd.run(periodic_cell.case(n=50, seed=seed), output=tmp_path)
        runs.append((history(tmp_path)["force"], float(broken(tmp_path)[0]["x"])))
    for force, place in runs[1:]:
        assert np.allclose(force, runs[0][0], rtol=0.0, atol=1e-3 * force.max())
        assert abs(place - runs[0][1]) > 0.01


@pytest.mark.parametrize("micromodulus", list(periodic_cell.MICROMODULI))
@pytest.mark.parametrize("ratio", [1.0, 2.0, 3.0])
def test_links_that_soften_and_other_micromoduli_have_the_energy_of_a_triangle(micromodulus, ratio, tmp_path):
    """Whatever the path, the last bond across the gap breaks at ratio eps_0 h, and all across it lose their energy."""
    n, m = 50, 5
    found = pd.run(periodic_cell.case(n, ratio=ratio, micromodulus=micromodulus), output=tmp_path)
    h = history(tmp_path)
    layer = np.arange(1, m + 1)
    weight = periodic_cell.MICROMODULI[micromodulus](layer / (m + 0.3))
    area = weight / (layer @ weight)
    assert h["force"][1] / h["displacement"][1] == pytest.approx(periodic_cell.E, rel=1e-4)
    assert found["max_force"] == pytest.approx(periodic_cell.E * 0.01, rel=1e-3)
    assert found["final_displacement"] == pytest.approx(ratio * 0.01 * 0.1, rel=2e-4)
    energy = 0.5 * periodic_cell.E * 0.01**2 * ratio * (layer * area) @ (layer / n)
    assert found["dissipated"] == pytest.approx(energy, rel=3e-4)
    assert found["broken"] == m * (m + 1) / 2
    assert max(imbalance(1.0, h["displacement"], h["force"], h)) < 1e-10
    # Bonds that snap let the force recover again and again; those that soften let it fall.
    after = h["force"][h["force"].argmax() :]
    recovers = (after - np.minimum.accumulate(after)).max() / found["max_force"]
    assert recovers < 1e-9 if ratio > 1.0 else recovers > 0.1


@pytest.mark.parametrize("ratio", [4.0, 25.0])
def test_one_softening_link_and_nine_elastic_ones_follow_a_line(ratio, tmp_path):
    """Ten particles have bonds to their neighbours only: F = E (r h eps_0 - u) / ((r - 1) h - (l - h))."""
    pd.run(periodic_cell.case(n=10, ratio=ratio), output=tmp_path)
    h = history(tmp_path)
    assert h["force"][:3] == pytest.approx([0.0, 1.0, 0.0], rel=1e-5, abs=1e-9)
    # The peak at eps_0 l, then (r h eps_0, 0): forwards above r = 10, backwards below.
    assert h["displacement"][:3] == pytest.approx([0.0, 0.01, ratio * 0.001], rel=1e-5)


def test_realisations_are_averaged(tmp_path):
    one = [results(CELL, "n=20", "critical=increasing", f"seed={s}", output=tmp_path)["results"] for s in (3, 4)]
    both = results(CELL, "n=20", "critical=increasing", "seed=3", "realisations=2", output=tmp_path)["results"]
    for name, value in both.items():
        assert value == pytest.approx(0.5 * (one[0][name] + one[1][name]), rel=1e-12)


@pytest.mark.long
@pytest.mark.parametrize("case", [(CELL, "n=50", "critical=increasing"), ("runs/localisation/cell_2d.py", "n=8")])
def test_the_order_of_events_is_the_same_on_any_number_of_ranks_and_again(case, tmp_path):
    order = {}
    for name, ranks in (("first", 1), ("again", 1), ("two", 2), ("four", 4)):
        results(*case, output=tmp_path / name, ranks=ranks)
        order[name] = [(row["step"], row["i"], row["j"]) for row in broken(tmp_path / name)]
    assert len(order["first"]) > 10
    assert order["first"] == order["again"] == order["two"] == order["four"]
    one, four = history(tmp_path / "first"), history(tmp_path / "four")
    for name in one:
        assert np.allclose(one[name], four[name], rtol=1e-9, atol=1e-12 * np.abs(one[name]).max())


@pytest.mark.parametrize(
    ("critical", "ratio"),
    [
        pytest.param(critical, ratio, marks=[] if n == m else pytest.mark.long)
        for n, critical in enumerate(["constant", "decreasing", "increasing"])
        for m, ratio in enumerate([1.0, 1.5, 3.0])
    ],
)
def test_a_plane_cell_falls_apart_with_its_energy_in_balance(critical, ratio, tmp_path):
    case = cell_2d.case(n=8, critical=critical, ratio=ratio)
    found = pd.run(case, output=tmp_path)
    h = history(tmp_path)
    each, whole = imbalance(1.0, h["strain"], h["stress"], h)
    assert each < 1e-10
    assert whole < 1e-10
    # What is left are bonds that hold two pieces almost across their direction.
    assert abs(h["stress"][-1]) < 1e-3 * found["max_stress"]
    assert h["t"][-1] == pytest.approx(1.0)


@pytest.mark.parametrize("updates", [3, *(pytest.param(n, marks=pytest.mark.long) for n in (1, 1000))])
def test_the_path_does_not_depend_on_when_the_matrix_is_factored(updates, tmp_path):
    pd.run(cell_2d.case(n=8, critical="increasing"), output=tmp_path / "default")
    pd.run(cell_2d.case(n=8, critical="increasing", updates=updates), output=tmp_path / "other")
    one, other = history(tmp_path / "default"), history(tmp_path / "other")
    assert np.allclose(one["stress"], other["stress"], atol=1e-10 * one["stress"].max())


def test_newton_finds_the_same_curve_at_the_events(tmp_path):
    """Steps just below the displacements at which a bond fails with the displacement higher than ever before."""
    case = notched_bar.case()
    pd.run(case, output=tmp_path / "events")
    h = history(tmp_path / "events")
    peaks = [s for s in range(1, len(h["t"]) - 1) if h["t"][s] > h["t"][:s].max() and h["force"][s] > 0.0]
    assert len(peaks) > 3
    below = 1.0 - 1e-6  # a bond within 1e-7 of its limit is at it
    factors = [0.0, *(h["t"][peaks] * below)]
    table = pd.Table(np.linspace(0.0, 1.0, len(factors)), factors)
    stepped = dataclasses.replace(
        case,
        solver=pd.Newton(),
        steps=pd.Steps(len(peaks)),
        conditions=[case.conditions[0], dataclasses.replace(case.conditions[1], schedule=table)],
    )
    pd.run(stepped, output=tmp_path / "newton")
    static = history(tmp_path / "newton")
    assert static["force"][1:] == pytest.approx(h["force"][peaks] * below, rel=1e-8)
    assert static["displacement"][1:] == pytest.approx(h["displacement"][peaks] * below, rel=1e-8)


def test_newton_and_events_break_the_same_bonds(tmp_path):
    case = notched_bar.case()
    pd.run(case, output=tmp_path / "events")
    pd.run(dataclasses.replace(case, solver=pd.Newton()), output=tmp_path / "newton")
    names = [{(row["i"], row["j"]) for row in broken(tmp_path / name)} for name in ("events", "newton")]
    assert names[0] == names[1]
    assert len(names[0]) > 20


def test_a_load_that_is_a_force_falls_with_the_strength(tmp_path):
    """A free end pulled by a force: the load factor follows the body down to nothing, and the run ends there."""
    case = one_bond()
    pulled = dataclasses.replace(case, conditions=[case.conditions[0], pd.Force(pd.region.Nearest((2.5,)), x=2.0)])
    pd.run(pulled, output=tmp_path)
    h = history(tmp_path)
    assert h["t"] == pytest.approx([0.0, 0.5, 0.0], abs=1e-12)
    assert h["displacement"] == pytest.approx([0.0, 0.02, 0.01], abs=1e-12)


def test_a_body_without_failing_bonds_is_one_step(tmp_path):
    for material in (pd.LinearElastic(E=10.0, nu=0.3), pd.BondBased(E=10.0), pd.LinearSolid(E=10.0, nu=0.2)):
        case = pd.Case(
            particles=pd.Lattice((0.0, 0.0), (6.0, 4.0), 1.0),
            horizon=2.015,
            material=material,
            conditions=[
                pd.Displacement(pd.region.Slab("x", high=1.0), x=0.0, y=0.0),
                pd.Displacement(pd.region.Slab("x", low=5.0), x=0.1, y=0.0),
            ],
            history={"force": pd.Reaction("x", pd.region.Slab("x", low=5.0))},
            results=lambda h: {"force": h["force"][-1]},
        )
        newton = pd.run(case, output=tmp_path)
        events = pd.run(dataclasses.replace(case, solver=pd.EventDriven()), output=tmp_path)
        assert events == pytest.approx(newton, rel=1e-10)


def refused(**changes):
    return dataclasses.replace(one_bond(), **changes)


@pytest.mark.parametrize(
    ("case", "message"),
    [
        (refused(material=pd.BondBased(E=1.0, kinematics="finite")), "piecewise linear"),
        (refused(material=pd.Hencky(E=1.0, nu=0.0), damage=None), "piecewise linear"),
        (
            refused(
                conditions=[
                    one_bond().conditions[0],
                    pd.Displacement(pd.region.Nearest((2.5,)), x=0.1, schedule=pd.Hold()),
                ]
            ),
            "proportional to the step time",
        ),
        (refused(material=pd.LinearSolid(E=1.0, nu=0.2)), "bonds without dilatation"),
        (refused(damage=pd.Brittle(pd.CriticalFunction(lambda length, middle: 0.0 * length))), "not positive"),
        (refused(damage=pd.Brittle(pd.CriticalFunction(lambda length, middle: 1.0))), "one number per bond"),
        (refused(material=pd.LinearElastic(E=1.0, nu=0.0)), "those of deformation gradients fail in load steps"),
        (refused(damage=pd.SmoothDegradation(pd.ConstantCritical(1e-3))), "SmoothDegradation is not"),
    ],
)
def test_what_it_cannot_do_it_refuses_with_the_reason(case, message, tmp_path):
    with pytest.raises(pd.CaseError, match=message):
        pd.run(case, output=tmp_path)


def test_too_many_events_end_with_what_is_computed(tmp_path):
    with pytest.raises(pd.SolveError, match="More than 5 events"):
        pd.run(dataclasses.replace(periodic_cell.case(n=20), solver=pd.EventDriven(most=5)), output=tmp_path)
    assert len(history(tmp_path)["force"]) == 6


def test_the_command_line_names_it(tmp_path):
    finished = called("runs/patch/cell.py", "--solver", "events", "-o", tmp_path)
    assert finished.returncode == 2
    assert "piecewise linear" in finished.stderr


@pytest.mark.parametrize("wrong", [{"updates": 0}, {"most": 0}, {"fields_every": -1}])
def test_wrong_options_are_refused(wrong):
    with pytest.raises(pd.CaseError, match=r"[Ee]vent"):
        pd.EventDriven(**wrong)


def test_directions_are_consistent(rng):
    """Random bodies with failing bonds: forces of those that fail decrease, those left out shorten, laws hold."""
    for _ in range(200):
        r = int(rng.integers(1, 8))
        B = rng.standard_normal((r, r + 3))
        bonds = Changed()
        k = rng.uniform(0.5, 1.5, r)
        S = B @ B.T
        S /= 1.5 * np.linalg.eigvalsh(np.sqrt(k)[:, None] * S * np.sqrt(k)).max()
        E = rng.uniform(0.5, 1.0, r)
        for m in range(r):
            bonds.append(S[m, : m + 1], E[m], k[m], 1.0, 1.0, -rng.uniform(0.0, 0.2) if m % 2 else 0.0)
        bonds.elongation[:] = 1.0
        bonds.failing = list(range(r))
        found = find_direction(bonds, [])
        out = [m for m in range(r) if m not in found.failing]
        assert np.all(found.force[found.failing] < 0.0)
        assert np.all(found.elongation[out] <= 1e-9)
        assert np.allclose(found.elongation, found.rate * E - S @ found.p, atol=1e-10)
        soft = bonds.softness[found.failing]
        assert np.allclose(found.elongation[found.failing], soft * found.force[found.failing], atol=1e-9)
        assert np.allclose(found.force, found.p + bonds.base * found.elongation, atol=1e-9)
