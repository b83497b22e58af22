"""Studies: parameter sets, tables that resume, orders of convergence, parameters fitted to curves."""

import csv
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import pdpetsc as pd
from pdpetsc.command_line.commands import command
from pdpetsc.command_line.start import files_of_options
from pdpetsc.discrete.communicator import alone
from pdpetsc.output.fingerprint import fingerprint
from pdpetsc.output.folder import set_aside
from pdpetsc.studies.fit import Point, _write, fitted
from pdpetsc.studies.jobs import Job, launched, too_many
from pdpetsc.studies.reference_curve import Curve, read_curve, read_off
from pdpetsc.studies.refinement import converging
from pdpetsc.studies.run_identity import CaseFile, PlannedRun, differing
from pdpetsc.studies.run_store import Outcome, claim_folder, folder_of, read_outcome
from pdpetsc.studies.sets import Range, combined, grid, read_sets, values_in
from pdpetsc.studies.study import Progress, _noise
from tests.command_line.test_tools import ENVIRONMENT, tool
from tests.commands import ROOT, summary, wait_until

# Parameter sets.


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("1,0.5,0.25", ["1", "0.5", "0.25"]),
        ("(1,2),(3,4)", ["(1,2)", "(3,4)"]),
        ("'a,b',c", ["'a,b'", "c"]),
        ("{'a': [1, 2]}", ["{'a': [1, 2]}"]),
    ],
)
def test_commas_inside_brackets_part_nothing(text, values):
    assert values_in(text) == values


def test_a_grid_has_every_combination_and_a_file_comes_with_each():
    sets = grid({"dx": [1.0, 0.5], "scheme": ["a", "b"]})
    assert sets == [{"dx": d, "scheme": s} for d in ("1", "0.5") for s in ("a", "b")]
    assert grid({}) == [{}]
    both = combined(grid({"scheme": ["a", "b"]}), [{"dx": "1"}, {"dx": "2"}])
    assert [one["dx"] + one["scheme"] for one in both] == ["1a", "2a", "1b", "2b"]
    with pytest.raises(pd.CaseError, match="dx is given twice"):
        combined([{"dx": "1"}], [{"dx": "2"}])


TOML = """
[[sets]]
dx = 1.0
fine = true

[[grids]]
dx = [0.5, 0.25]
scheme = ["a", "b"]

[[samples]]
method = "latin_hypercube"
n = 8
seed = 3
[samples.ranges]
E = [1000.0, 5000.0]
G = {low = 0.01, high = 100.0, scale = "log"}
n = {low = 3, high = 6, scale = "integer"}
"""


def test_a_file_of_sets_grids_and_samples(tmp_path):
    path = tmp_path / "sets.toml"
    path.write_text(TOML)
    found = read_sets(path)
    assert found[:3] == [{"dx": "1", "fine": "true"}, {"dx": "0.5", "scheme": "a"}, {"dx": "0.5", "scheme": "b"}]
    samples = found[5:]
    assert len(samples) == 8
    # One sample in each eighth of every range, which is what a Latin hypercube is.
    for name, low, high, log in (("E", 1000.0, 5000.0, False), ("G", 0.01, 100.0, True)):
        values = np.array([float(one[name]) for one in samples])
        shares = np.log(values / low) / np.log(high / low) if log else (values - low) / (high - low)
        assert sorted(np.floor(8 * shares)) == list(range(8))
    assert {one["n"] for one in samples} == {"3", "4", "5", "6"}
    # The same samples whenever they are asked for: a study of them goes on.
    assert read_sets(path) == found
    path.write_text(TOML.replace("latin_hypercube", "sobol"))
    sobol = [float(one["E"]) for one in read_sets(path)[5:]]
    assert sorted(np.floor((np.array(sobol) - 1000.0) / 500.0)) == list(range(8))


def test_sets_from_csv_and_json(tmp_path):
    (tmp_path / "s.csv").write_text("dx, scheme\n1.0,a\n\n0.50,b\n")
    assert read_sets(tmp_path / "s.csv") == [{"dx": "1.0", "scheme": "a"}, {"dx": "0.50", "scheme": "b"}]
    (tmp_path / "s.json").write_text(json.dumps([{"dx": 0.1, "n": 3, "fine": False}]))
    assert read_sets(tmp_path / "s.json") == [{"dx": "0.1", "n": "3", "fine": "false"}]


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("s.csv", "dx,dx\n1,2\n", "names of parameters, each once"),
        ("s.csv", "dx,n\n1\n", "row 2 must have 2 values"),
        ("s.csv", "dx,n\n1,\n", "row 2 must have 2 values"),
        ("s.csv", "", "holds no parameter set"),
        ("s.csv", "dx\n", "holds no parameter set"),
        ("s.json", "{", "is no JSON file"),
        ("s.json", "3", "list of parameter sets"),
        ("s.json", '[{"dx": [1, 2]}]', "takes one value"),
        ("s.toml", "[[sampels]]\nn = 3\n", "did you mean samples"),
        ("s.toml", '[[samples]]\nmethod = "sobol"\nn = 6\nranges = {E = [1, 2]}\n', "power of two"),
        ("s.toml", '[[samples]]\nmethod = "random"\nn = 6\nranges = {E = [1, 2]}\n', "'sobol' as method"),
        ("s.toml", '[[samples]]\nmethod = "sobol"\nn = 4\nranges = {E = [2, 1]}\n', "numbers low < high"),
        ("s.toml", '[[samples]]\nmethod = "sobol"\nn = 4\n', "samples need ranges"),
        ("s.toml", "[[grids]]\ndx = []\n", "has no value"),
        ("s.yaml", "", "must end in .csv, .json or .toml"),
    ],
)
def test_a_file_of_sets_that_is_none_is_refused(name, text, message, tmp_path):
    (tmp_path / name).write_text(text)
    with pytest.raises(pd.CaseError, match=message):
        read_sets(tmp_path / name)


# Orders of convergence.


@pytest.mark.parametrize("order", [0.5, 1.0, 2.0, 3.3])
@pytest.mark.parametrize("sizes", [(0.4, 0.2, 0.1), (0.1, 0.3, 0.17, 0.05), (1e-9, 3e-9, 2e-9)])
def test_a_power_law_gives_its_order_and_its_limit(order, sizes):
    """Whatever the ratios of the sizes, and in any units."""
    scale = max(sizes)
    found = converging("u", sizes, [-7e12 * (1.0 + 0.3 * (h / scale) ** order) for h in sizes])
    assert found.order == pytest.approx(order, rel=1e-6)
    assert found.extrapolated == pytest.approx(-7e12, rel=1e-9)
    assert abs(found.values[-1] - -7e12) < found.error_bar
    against = converging("u", sizes, found.values[::-1] if sizes[0] > sizes[-1] else found.values, None)
    assert against.sizes == tuple(sorted(sizes, reverse=True))


def test_error_bars_are_wider_where_no_fourth_size_confirms_the_order():
    def f(h):
        return 1.0 + h**2

    three, four = ([f(h) for h in sizes] for sizes in ((0.4, 0.2, 0.1), (0.8, 0.4, 0.2, 0.1)))
    alone, confirmed = converging("u", (0.4, 0.2, 0.1), three), converging("u", (0.8, 0.4, 0.2, 0.1), four)
    assert confirmed.error_bar == pytest.approx(1.25 * 0.03 / 3.0)
    assert alone.error_bar == pytest.approx(3.0 * 0.03 / 3.0)
    assert "three sizes do not show whether they are small enough; add a fourth" in alone.note
    assert confirmed.note == ""


def test_an_order_above_two_makes_no_error_bar_small():
    found = converging("u", (0.4, 0.2, 0.1), [1.0 + h**6 for h in (0.4, 0.2, 0.1)])
    assert found.order == pytest.approx(6.0)
    assert found.error_bar == pytest.approx(3.0 * abs(0.1**6 - 0.2**6) / 3.0)


@pytest.mark.parametrize(
    ("sizes", "values", "note"),
    [
        ((0.2, 0.1), (1.1, 1.0), "needs three sizes, not 2"),
        ((0.4, 0.2, 0.1), (1.1, 0.9, 1.05), "not monotone in the size; add smaller sizes"),
        ((0.8, 0.4, 0.2, 0.1), (1.2, 1.3, 1.1, 1.05), "not monotone in the size; add smaller sizes"),
        ((0.4, 0.2, 0.1), (1.0, 1.1, 1.3), "do not approach a limit: .*; add smaller sizes, or refine the horizon"),
        ((0.4, 0.2, 0.1), (1.0, 1.1, 1.2), "do not approach a limit"),
        ((0.4, 0.2, 0.1), (1.0, 1.0 + 1e-10, 1.0 + 1.5e-10), "less than the solver tolerance; use larger"),
        ((0.4, 0.2, 0.1), (1.0, 1.0, 1.0), "less than the solver tolerance"),
        ((0.4, 0.2, 0.1), (0.0, 0.0, 0.0), "less than the solver tolerance"),
        ((0.8, 0.4, 0.2, 0.1), (1.6, 1.2, 1.18, 1.17), "not in the asymptotic range, .*; add smaller"),
    ],
)
def test_where_there_is_no_order_there_is_no_number(sizes, values, note):
    found = converging("u", sizes, values)
    assert re.search(note, found.note)
    assert found.order is None and found.extrapolated is None and found.error_bar is None


@pytest.mark.parametrize(
    ("values", "note"),
    [
        ((1.2, 0.9, 1.01), "changes its sign; add smaller sizes"),
        ((1.2, 1.1, 1.0), "below the solver tolerance; use larger sizes"),
        ((1.1, 1.2, 1.3), "does not fall with the size; check the exact value"),
        ((1.4, 1.39, 1.1), "not in the asymptotic range"),
        ((1.4,), "needs two sizes, not 1"),
    ],
)
def test_against_an_exact_value_too(values, note):
    found = converging("u", (0.4, 0.2, 0.1)[: len(values)], values, exact=1.0)
    assert note in found.note and found.order is None
    good = converging("u", (0.4, 0.2, 0.1), [1.0 - h**1.5 for h in (0.4, 0.2, 0.1)], exact=1.0)
    assert good.order == pytest.approx(1.5)


def test_large_sizes_do_not_make_the_order_against_an_exact_value():
    found = converging("v", (8.0, 4.0, 2.0, 1.0), (129.0, 5.0, 3.0, 2.0), exact=1.0)
    assert found.orders == pytest.approx((5.0, 1.0, 1.0)) and found.order == pytest.approx(1.0)
    assert "the larger sizes have other orders: 5.00, 1.00, 1.00" in found.note


def test_differences_below_what_solvers_leave_have_no_order():
    sizes, values = (0.4, 0.2, 0.1), [1.0 + 1e-5 * h for h in (0.4, 0.2, 0.1)]
    assert converging("u", sizes, values, noise=1e-8).order == pytest.approx(1.0, rel=1e-3)
    assert "less than the solver tolerance" in converging("u", sizes, values, noise=1e-5).note
    newton = {"solver": "snes newtonls, ksp cg", "options": {"snes_rtol": {"value": "1e-5"}}}
    assert [_noise(newton), _noise({"solver": "relaxation"}), _noise({})] == pytest.approx([1e-3, 1e-6, 1e-6])


def test_expected_values_that_differ_between_sizes_are_told():
    runs = [(Outcome({"dx": str(h)}, Path(), "finished", results={"v": 1.0 + h}), h) for h in (0.4, 0.2, 0.1)]
    planned = [PlannedRun(one.parameters, expected={"v": 1.0 + h}) for one, h in runs]
    (found,) = pd.Refinement("dx", expected=True).found([one for one, _ in runs], planned)
    assert found.exact is None and "what the case expects differs between the sizes" in found.note


def test_sizes_that_are_none_are_refused():
    for sizes, message in (((0.2, 0.1, -0.1), "positive"), ((0.2, 0.1, 0.1), "twice")):
        with pytest.raises(pd.CaseError, match=message):
            converging("u", sizes, (1.0, 2.0, 3.0))
    with pytest.raises(pd.CaseError, match="not finite"):
        converging("u", (0.4, 0.2, 0.1), (1.0, float("nan"), 3.0))


# Reading a history off at measured places.


def curve(x, y, **more):
    return Curve("u", "F", np.asarray(x, dtype=float), np.asarray(y, dtype=float), **more)


def test_a_history_is_read_off_on_the_lines_between_its_steps():
    measured = curve([0.5, 1.5, 2.0], [1.0, 1.0, 1.0])
    assert read_off({"u": [0, 1, 2], "F": [0, 10, 30]}, measured) == pytest.approx([5.0, 20.0, 30.0])
    assert read_off({"u": [2, 1, 0], "F": [30, 10, 0]}, measured) == pytest.approx([5.0, 20.0, 30.0])
    # Half a step of round-off at the end is no run that ended early.
    assert read_off({"u": [0, 1, 2 - 1e-12], "F": [0, 10, 30]}, measured)[-1] == pytest.approx(30.0)


@pytest.mark.parametrize(
    ("history", "message"),
    [
        ({"u": [0, 1, 1.9], "F": [0, 1, 2]}, "The run goes from u = 0 to 1.9 and the measured curve to 2"),
        ({"u": [0.6, 1, 2], "F": [0, 1, 2]}, "The run goes from u = 0.6 to 2 and the measured curve to 0.5"),
        ({"u": [0, 1, 0.5, 2], "F": [0, 1, 2, 3]}, "u turns back at step 2 of the run, at 0.5"),
        ({"u": [0, 1, 1, 2], "F": [0, 1, 2, 3]}, "u turns back at step 2"),
        ({"u": [0], "F": [0]}, "fewer than two"),
        ({"v": [0, 1, 2], "F": [0, 1, 2]}, "no column 'u'; it has v, F"),
        ({"u": [0, 1, 2], "F": [0, float("nan"), 2]}, "finite"),
    ],
)
def test_a_run_that_does_not_reach_the_curve_is_no_number(history, message):
    with pytest.raises(pd.CaseError, match=message.replace("(", r"\(")):
        read_off(history, curve([0.5, 1.5, 2.0], [1.0, 1.0, 1.0]))


def test_a_measured_curve_is_cut():
    measured = curve([0.0, 0.5, 1.5, 2.0], [1.0, 2.0, 3.0, 4.0], sigma=np.array([1.0, 2.0, 3.0, 4.0]))
    part = measured.within(0.5, 1.9)
    assert part.x.tolist() == [0.5, 1.5] and part.y.tolist() == [2.0, 3.0] and part.sigma.tolist() == [2.0, 3.0]
    with pytest.raises(pd.CaseError, match="No measured place lies between 3 and 4"):
        measured.within(3.0, 4.0)


def test_a_row_with_more_values_than_the_header_names_is_refused(tmp_path):
    """As those of a decimal comma."""
    path = tmp_path / "measured.csv"
    path.write_text("u,F\n0,0\n0,1,20,5\n")
    with pytest.raises(pd.CaseError, match=r"Row 3 of .* has 4 values, and the header names 2"):
        read_curve(path, ("u", "F"))


def test_measured_curves_are_read_by_the_names_of_their_columns(tmp_path):
    path = tmp_path / "m.csv"
    path.write_text("force,displacement,s\n1.0,0.1,0.5\n\n2.0,0.2,0.5\n")
    found = read_curve(path, ("u:displacement", "F:force"), "s")
    assert found.x.tolist() == [0.1, 0.2] and found.y.tolist() == [1.0, 2.0] and found.sigma.tolist() == [0.5, 0.5]
    for text, message in (
        ("displacement,force\n0.1,one\n", "Row 2"),
        ("displacement\n0.1\n", "one column 'force'"),
        ("displacement,force\n", "no measured point"),
        ("", "it has none"),
    ):
        path.write_text(text)
        with pytest.raises(pd.CaseError, match=message):
            read_curve(path, ("u:displacement", "F:force"))


# Fits, against closed forms and what linear least squares gives.


def evaluated(law, x, fails=lambda p: False):
    """Return what evaluates parameter sets by a closed form."""

    def evaluate(sets):
        return [
            Point(Path(), failure="exit status 1: it broke.") if fails(p) else Point(Path(), {"u": x, "F": law(x, **p)})
            for p in sets
        ]

    return evaluate


def test_a_line_has_the_standard_errors_and_correlation_of_linear_least_squares(rng):
    x = np.linspace(0.0, 2.0, 21)
    y = 3.0 * x + 0.5 + rng.normal(0.0, 0.05, len(x))
    for scale in (1.0, 1e9):
        found = fitted(
            evaluated(lambda u, a, b: scale * (a * u + b), x), {"a": Range(1.0, 9.0), "b": Range(-1.0, 2.0)},
            curve(x, scale * y),
        )  # fmt: skip
        slope, at_zero = np.polyfit(x, y, 1)
        covariance = np.polyfit(x, y, 1, cov=True)[1]
        assert found.values["a"] == pytest.approx(slope, rel=1e-6)
        assert found.values["b"] == pytest.approx(at_zero, rel=1e-6)
        assert list(found.errors.values()) == pytest.approx(np.sqrt(np.diag(covariance)), rel=1e-4)
        expected = covariance[0, 1] / np.sqrt(covariance[0, 0] * covariance[1, 1])
        assert found.correlation[0, 1] == pytest.approx(expected, rel=1e-4)
        assert found.notes == [] and found.failed == 0


def hardening(u, E, yield_stress, H):
    """Return the stress of a bar that yields and hardens linearly."""
    return np.where(E * u < yield_stress, E * u, yield_stress + E * H / (E + H) * (u - yield_stress / E))


RANGES = {"E": Range(500.0, 3000.0), "yield_stress": Range(1.0, 30.0), "H": Range(10.0, 1000.0, scale="log")}


def test_standard_errors_are_those_of_many_measurements(rng):
    """With 60 noisy measurements the parameters scatter as one of them says, and sigma may be given."""
    x, truth = np.linspace(0.0, 0.03, 31), {"E": 1000.0, "yield_stress": 10.0, "H": 100.0}
    off = []
    for _ in range(60):
        y = hardening(x, **truth) + rng.normal(0.0, 0.1, len(x))
        found = fitted(evaluated(hardening, x), RANGES, curve(x, y, sigma=np.full(len(x), 0.1)))
        off.append([(found.values[name] - truth[name]) / found.errors[name] for name in truth])
    assert np.abs(np.mean(off, axis=0)) == pytest.approx(0.0, abs=0.45)
    assert np.std(off, axis=0) == pytest.approx(1.0, abs=0.3)


def test_runs_that_fail_are_counted_and_shorten_the_step():
    x = np.linspace(0.0, 1.0, 11)

    def law(u, k):
        return np.exp(k * u)

    measured = curve(x, law(x, 4.0))
    ranges = {"k": Range(0.0, 9.0, start=3.0)}
    found = fitted(evaluated(law, x, lambda p: p["k"] > 4.2), ranges, measured)
    assert found.values["k"] == pytest.approx(4.0, rel=1e-6)
    assert found.failed > 0
    free = fitted(evaluated(law, x), ranges, measured)
    assert free.failed == 0
    # Where the run ahead fails, that behind gives the derivative.
    edge = fitted(evaluated(law, x, lambda p: p["k"] > 4.0 + 1e-9), ranges, measured)
    assert edge.values["k"] == pytest.approx(4.0, rel=1e-4)


@pytest.mark.parametrize("law", [lambda u, E: E * u, lambda u, E: E * u + 40.0 * np.sin(9.0 * u)])
def test_a_fit_does_not_end_where_runs_fail(law):
    """The least square lies among the runs that fail: what is nearest to it is not it."""
    x = np.linspace(0.0, 1.0, 11)
    measured, ranges = curve(x, 1200.0 * x), {"E": Range(500.0, 1500.0)}
    no_fit("ended where runs fail, next to E = 1(100|099)", law, ranges, measured, x, lambda p: p["E"] >= 1100.0)
    two = {"E": Range(500.0, 1500.0), "b": Range(-50.0, 70.0)}
    no_fit(
        "ended where runs fail|jumps near",
        lambda u, E, b: law(u, E) + b,
        two,
        measured,
        x,
        lambda p: p["E"] + 3.0 * p["b"] >= 1120.0,
    )
    # Next to runs that fail, yet least: it is told.
    found = fitted(evaluated(law, x, lambda p: p["E"] > 1200.5), ranges, curve(x, law(x, 1200.0)))
    assert found.values["E"] == pytest.approx(1200.0, rel=1e-6)
    assert found.notes[0] == "runs fail next to these parameters, in E"


def test_a_fit_that_explains_nothing_is_none(tmp_path):
    x = np.linspace(0.0, 1.0, 11)
    # A local least square, another sign, a constant.
    no_fit(
        "explains nothing of the measured one .-0.57",
        lambda u, w: np.sin(w * u),
        {"w": Range(0.5, 20.0, 3.0)},
        curve(x, np.sin(12.0 * x)),
        x,
    )
    far = curve(x, np.full(11, 5.0))
    no_fit("explains nothing", lambda u, p: p * u, {"p": Range(-20.0, 20.0, 1.0)}, far, x)
    bad = fitted(evaluated(lambda u, p: p * u, x), {"p": Range(-20.0, 20.0, 1.0)}, curve(x, 5.0 - 10.0 * x))
    assert bad.explained == pytest.approx(0.2857, abs=1e-4)
    assert "THE CASE IS NOT THAT OF THE MEASUREMENT: no more than 0.29" in bad.notes[0]
    _write(tmp_path, bad)
    assert "THE CASE" in json.loads((tmp_path / "fit.json").read_text())["notes"][0]
    # What varies by nothing but noise is met though no variance is explained.
    flat = fitted(evaluated(lambda u, p: p + 0.0 * u, x), {"p": Range(0.0, 9.0)}, curve(x, 5.0 + 0.01 * np.cos(9 * x)))
    assert flat.values["p"] == pytest.approx(5.0, rel=1e-3) and not any("THE CASE" in note for note in flat.notes)


def test_a_perfect_fit_is_written(tmp_path):
    x = np.linspace(0.0, 1.0, 11)
    found = fitted(evaluated(lambda u, a, b: a * u + b, x), {"a": Range(0.0, 1.0), "b": Range(0.0, 1.0)},
                   curve(x, 0.5 * x + 0.5))  # fmt: skip
    assert found.rms == 0.0 and found.errors == {"a": 0.0, "b": 0.0}
    _write(tmp_path, found)
    written = json.loads((tmp_path / "fit.json").read_text())
    # That of the line through 11 points: -mean(x) / sqrt(mean(x^2)).
    assert written["correlation"]["a"]["b"] == pytest.approx(-0.5 / np.sqrt(0.35), rel=1e-6)


def no_fit(message, law, ranges, measured, x, fails=lambda p: False, **more):
    with pytest.raises((pd.SolveError, pd.CaseError), match=message):
        fitted(evaluated(law, x, fails), ranges, measured, **more)


def test_what_cannot_be_found_is_refused():
    x = np.linspace(0.0, 1.0, 11)
    measured = curve(x, 6.0 * x + 0.1 * x**2)
    two = {"E": Range(1.0, 9.0), "A": Range(0.5, 4.0)}
    no_fit("does not tell E and A apart", lambda u, E, A: E * A * u, two, measured, x)
    no_fit("does not depend on A", lambda u, E, A: E * u, two, measured, x)
    no_fit("E = 3 ended at an end of its range", lambda u, E: E * u, {"E": Range(1.0, 3.0)}, measured, x)
    no_fit(
        "starts from, E = 5, gives no curve: exit status 1",
        lambda u, E: E * u,
        {"E": Range(1.0, 9.0)},
        measured,
        x,
        lambda p: True,
    )
    no_fit(
        "gives no curve: The run goes from u = 0 to 1",
        lambda u, E: E * u,
        {"E": Range(1.0, 9.0)},
        curve([0.0, 1.5], [0.0, 9.0]),
        x,
    )
    no_fit("2 measured points are too few for 2", lambda u, E, A: E * u + A, two, curve([0.0, 1.0], [0.0, 1.0]), x)
    no_fit("has not ended within 3 runs", lambda u, E: np.sinh(E * u), {"E": Range(1.0, 9.0)}, measured, x, most=3)
    no_fit("both sides of E", lambda u, E: E * u, {"E": Range(1.0, 9.0)}, measured, x, lambda p: p["E"] != 5.0)
    with pytest.raises(pd.CaseError, match="all zero"):
        curve(x, 0.0 * x)


def test_coarse_load_steps_are_told():
    x = np.linspace(0.0, 1.0, 5)
    fine = np.linspace(0.0, 1.0, 41)
    found = fitted(evaluated(lambda u, k: np.exp(k * u), x), {"k": Range(1.0, 4.0)}, curve(fine, np.exp(3.0 * fine)))
    assert any("take more load steps" in note for note in found.notes)


# Processes.

CASE = """
import pdpetsc as pd
import {module}

def case(n=4, E=1.0, end="right"):
    if end == "refused":
        raise pd.CaseError("E is not for this.")
    ends = [pd.region.Slab("x", high=1.0 / n), pd.region.Slab("x", low=1.0 - 1.0 / n)]
    def results(h):
        if end == "wrong":
            raise ValueError("no number")
        return {{"value": 1.0 + {module}.FACTOR * n**-2.0}}
    return pd.Case(
        particles=pd.Lattice((0.0,), (1.0,), 1.0 / n), horizon=2.015 / n, material=pd.BondBased(E=E), fields=[],
        conditions=[pd.Displacement(ends[0], x=0.0), pd.Displacement(ends[1], x=0.1)], results=results,
    )
"""


def scene(folder, module="beside"):
    (folder / f"{module}.py").write_text("FACTOR = 3.0\n")
    (folder / "case.py").write_text(CASE.format(module=module))
    return folder / "case.py"


def table(folder, name="study"):
    with (folder / f"{name}.csv").open() as file:
        return list(csv.DictReader(file))


def when(folder):
    return {path.parent.name: path.stat().st_mtime_ns for path in folder.glob("*/summary.json")}


def test_a_study_runs_what_is_not_there_and_shows_no_number_of_what_failed(tmp_path):
    case, out = scene(tmp_path), tmp_path / "out"
    sets = [{"n": 4, "end": "right"}, {"n": 4, "end": "wrong"}]
    done = pd.study(case, sets, out, jobs=2)
    assert [(one.status, one.exit_status) for one in done.outcomes] == [("finished", 0), ("failed", 1)]
    assert "no number" in done.failed[0].said
    assert [row["value"] for row in table(out)] == [repr(1.0 + 3.0 / 16.0), ""]
    before = when(out)
    # What the case imports has changed: that run is run again, and only that one is asked for.
    (tmp_path / "beside.py").write_text("FACTOR = 5.0\n")
    assert pd.study(case, sets[:1], out).values("value") == {"n=4,end=right": 1.0 + 5.0 / 16.0}
    assert when(out)["end=wrong,n=4"] == before["end=wrong,n=4"]


def test_a_study_shows_the_warnings_of_its_runs(tmp_path, capsys):
    """Also of an option that no solver used."""
    case, out = scene(tmp_path), tmp_path / "out"
    for _ in range(2):  # the second time from the records of the runs
        assert command("study", [str(case), "n=4,8", "-snes_rtoll", "1e-3", "-o", str(out)]) == 0
        assert "n=4 and 1 more: No solver used the option -snes_rtoll." in capsys.readouterr().out
        assert all(int(row["warnings"]) >= 1 for row in table(out))


def test_a_study_removes_the_orders_of_an_earlier_one_in_its_folder(tmp_path):
    case, out = scene(tmp_path), tmp_path / "out"
    pd.study(case, {"n": [4, 6, 8]}, out, refine="1/n")
    assert (out / "study_order.csv").exists()
    pd.study(case, {"n": [4, 6]}, out)
    assert not (out / "study_order.csv").exists()


MESHED = """
import numpy as np
import pdpetsc as pd

def case(n=4, E=1.0, label=None, kill=False):
    if kill:
        import os, signal
        os.kill(os.getpid(), signal.SIGKILL)
    if label == "late":
        import later
    table = np.loadtxt("table.txt")
    return pd.Case(
        particles=pd.TextFile("cloud.txt", dim=1), horizon=2.0, material=pd.BondBased(E=E * table[0]),
        conditions=[pd.Displacement(pd.region.Slab("x", high=1.0), x=0.0)],
    )
"""


@pytest.mark.long
def test_what_a_run_is_of_is_all_that_its_case_declares_and_imports(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("case.py").write_text(MESHED)
    Path("cloud.txt").write_text("0 1\n1 1\n2 1\n")
    Path("table.txt").write_text("1.0 2.0\n")
    Path("later.py").write_text("a = 1\n")

    def identities(file, *sets):
        return [run.identity for run in file.plan(sets)]

    file = CaseFile(Path("case.py"), (), 1)
    first, late, killed, last = file.plan([{"E": "1"}, {"label": "'late'"}, {"kill": "yes"}, {"E": "2"}])
    first, late = first.identity, late.identity
    # A number is the same however it is written; one that is asked for and a default are one parameter.
    assert identities(file, {"E": "1.0", "n": "4"}) == [first]
    assert len(identities(file, {"E": "1"}, {"E": "1e0"})) == 1
    # A set whose case ends the process that asks has no run; the others have one.
    assert "ended the process" in killed.refused and not last.refused
    assert first["files"].keys() == late["files"].keys() == {"case.py", "cloud.txt"}
    Path("cloud.txt").write_text("0 1\n1 1\n2.5 1\n")
    (moved,) = identities(file, {"E": "1"})
    assert {name for name in first["files"] if first["files"][name] != moved["files"][name]} == {"cloud.txt"}
    Path("table.txt").write_text("1.5 2.0\n")
    (softer,) = identities(file, {"E": "1"})
    assert len({one["declared"] for one in (first, moved, softer)}) == 3
    Path("case.py").write_text(MESHED + "# a remark\n")
    monkeypatch.setenv("PETSC_OPTIONS", "-ksp_rtol 1e-3")
    (other,) = identities(CaseFile(Path("case.py"), ["-pc_type", "lu"], 2), {"E": "1"})
    assert {name for name in other if other[name] != softer[name]} == {"files", "PETSC_OPTIONS", "options", "ranks"}


@pytest.mark.long
def test_a_study_goes_on_and_runs_again_what_is_not_the_same(tmp_path):
    case, out = scene(tmp_path), tmp_path / "out"
    sets = [{"n": n, "end": end} for n in (4, 8, 16) for end in ("right",)] + [{"n": 4, "end": "wrong"}]
    done = pd.study(case, sets, out, jobs=2, refine="1/n")
    assert [one.status for one in done.outcomes] == ["finished"] * 3 + ["failed"]
    assert done.outcomes[3].exit_status == 1 and "no number" in done.outcomes[3].said
    rows = table(out)
    assert [row["value"] for row in rows] == [repr(1.0 + 3.0 * n**-2.0) for n in (4, 8, 16)] + [""]
    right = next(one for one in done.convergence if one.group["end"] == "right")
    assert right.order == pytest.approx(2.0) and right.extrapolated == pytest.approx(1.0)
    assert json.loads((out / "study.json").read_text())["convergence"][0]["order"] == pytest.approx(2.0)
    before = when(out)
    assert len(before) == 4
    # Nothing is run again, not even what failed, nor where a number is written otherwise.
    again = pd.study(case, [{"n": "4", "end": "right"}, {"end": "wrong", "n": 4}, sets[1]], out)
    assert when(out) == before
    assert [one.status for one in again.outcomes] == ["finished", "failed", "finished"]
    # What the case imports has changed, and what failed is tried again on request.
    (tmp_path / "beside.py").write_text("FACTOR = 5.0\n")
    changed = pd.study(case, sets[:1], out)
    assert changed.values("value") == {"n=4,end=right": 1.0 + 5.0 / 16.0}
    (tmp_path / "beside.py").write_text("FACTOR = 3.0\n")
    retried = pd.study(case, sets[3:], out, retry=True)
    after = when(out)
    assert [one.status for one in retried.outcomes] == ["failed"]
    assert {name for name in before if after[name] != before[name]} == {"end=right,n=4", "end=wrong,n=4"}
    # A run whose files somebody has changed is none that has finished.
    (out / "end=right,n=8" / "history.csv").write_text("step,t\n0,0\n")
    pd.study(case, sets[1:2], out)
    assert when(out)["end=right,n=8"] != before["end=right,n=8"]
    # What the case refuses has no run, and is not hidden behind those that have one.
    refused = pd.study(case, [sets[2], {"n": 4, "end": "refused"}], out)
    assert [one.exit_status for one in refused.outcomes] == [0, 2]
    with pytest.raises(pd.CaseError, match="E is not for this"):
        pd.study(case, [{"n": 4, "end": "refused"}], out)


@pytest.mark.long
def test_what_is_asked_for_and_is_not_there_is_refused_before_anything_is_written(tmp_path):
    case, out = scene(tmp_path), tmp_path / "out"
    for words, message in (
        (("m=3",), "no parameter 'm'"),
        (("n=3.5",), "takes int"),
        (("n=4,8", "--order", "n"), "the size is then 1/n"),
        (("E=1,2", "--order", "1/n"), "needs a value of n"),
        (("n=4", "--exact", "value=1"), "require --order NAME"),
        (("n=4", "--jobs", "0"), "--jobs takes a positive number"),
        (("n=4", "--launcher", "srun"), "needs {ranks}"),
        (("n=4", "--jobs", "1", "--jobs", "2"), "--jobs is given twice"),
    ):
        with pytest.raises(pd.CaseError, match=message):
            command("study", [str(case), *words, "-o", str(out)])
        assert not out.exists()


def test_a_fit_that_cannot_begin_is_refused(tmp_path):
    case, out = scene(tmp_path), tmp_path / "out"
    (tmp_path / "m.csv").write_text("u,F\n0,0\n1,1\n2,2\n")
    common = ("--to", tmp_path / "m.csv", "--columns", "t,value", "-o", out)
    for words, message in (
        (("n=2:8", *common), "must have one column 't'"),
        (("n=2:8", "--to", tmp_path / "m.csv", "--columns", "t:u,v:F", "-o", out), "Parameter n is not a number with"),
        (("F=2:8", "--to", tmp_path / "m.csv", "--columns", "t:u,v:F", "-o", out), "no parameter 'F'"),
        (("E=2:1", *common), "low < high"),
        (("--to", tmp_path / "m.csv"), "fit needs --columns"),
    ):
        with pytest.raises(pd.CaseError, match=message):
            command("fit", [str(case), *map(str, words)])
        assert not out.exists()


def test_side_by_side_they_use_the_cores_that_there_are(monkeypatch):
    monkeypatch.setattr("pdpetsc.studies.jobs.cores", lambda: 8)
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    assert too_many(4, 2) == ""
    assert "want 10 cores, and there are 8" in too_many(5, 2)
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    assert "want 16 cores" in too_many(4, 2)
    assert launched(["a"], 2, None) == ["mpirun", "-n", "2", "a"]
    assert launched(["a"], 3, "srun --ntasks={ranks}") == ["srun", "--ntasks=3", "a"]
    assert launched(["a"], 1, None) == ["a"]


DASHES = 74 * "-" + "\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "no message."),
        (f"{DASHES}{DASHES}", "no message."),
        ("step 1\npdpetsc: The case has no parameter n.\n" + DASHES + "Primary job terminated\nat 1\n" + DASHES,
         "The case has no parameter n."),
        (f"{DASHES}mpirun has detected an attempt to run as root.\n\nRunning as root is\n{DASHES}",
         "mpirun has detected an attempt to run as root."),
        (f"ImportError: no h5py\n{DASHES}Primary job  terminated\n{DASHES}", "ImportError: no h5py"),
        (f"step 1\n{DASHES}Primary job  terminated\n{DASHES}{DASHES}mpirun noticed that rank 0 exited\n{DASHES}",
         "mpirun noticed that rank 0 exited"),
        (f"{DASHES}A warning of the launcher\nof two lines\n{DASHES}Traceback\nKeyError: 3\n", "KeyError: 3"),
    ],
)  # fmt: skip
def test_a_failed_run_has_the_message_and_not_the_lines_of_the_launcher(text, said, tmp_path):
    job = Job(["true"], tmp_path / "log.txt")
    wait_until(lambda: job.ended is not None, "the end of the run")
    job.log.write_text(text)
    assert job.said == said


def test_a_run_refuses_the_folder_of_a_study(tmp_path):
    claim_folder(tmp_path / "study", ("study.csv",))
    claim_folder(tmp_path / "study" / "n=1")
    refused = "is the folder of a study, with one for each run. Choose another folder."
    with pytest.raises(pd.CaseError, match=refused):
        set_aside(alone(), tmp_path / "study")
    set_aside(alone(), tmp_path / "study" / "n=1")


def test_every_parameter_set_has_a_folder_of_its_own(tmp_path):
    sets = [{"a": "1/2"}, {"a": "1_2"}, {"a": "x" * 300}, {"a": "x" * 299 + "y"}, {}, {"a": "1"}, {"b": "1"}]
    folders = {folder_of(tmp_path, one) for one in sets}
    assert len(folders) == len(sets)
    assert all(len(folder.name) < 120 and folder.parent == tmp_path for folder in folders)


SLOW = """
import os, time
from pathlib import Path
import pdpetsc as pd

def case(n=4):
    ends = [pd.region.Slab("x", high=1.0 / n), pd.region.Slab("x", low=1.0 - 1.0 / n)]
    def results(h):
        here = Path(__file__)
        here.with_name(f"started_{n}").write_text(str(os.getpid()))
        end = time.monotonic() + 100.0
        while n == 8 and not here.with_name("go").exists() and time.monotonic() < end:
            time.sleep(0.05)
        return {"n": float(n)}
    return pd.Case(
        particles=pd.Lattice((0.0,), (1.0,), 1.0 / n), horizon=2.015 / n, material=pd.BondBased(E=1.0), fields=[],
        conditions=[pd.Displacement(ends[0], x=0.0), pd.Displacement(ends[1], x=0.1)], results=results,
    )
"""


@pytest.mark.long
def test_a_study_that_is_killed_goes_on_and_two_are_not_in_one_folder(tmp_path):
    case, out = tmp_path / "case.py", tmp_path / "out"
    case.write_text(SLOW)
    words = [sys.executable, "-m", "pdpetsc", "study", str(case), "n=4,8", "-o", str(out)]
    pipes = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    first = subprocess.Popen(words, cwd=ROOT, env=ENVIRONMENT, start_new_session=True, **pipes)
    try:
        started = tmp_path / "started_8"
        wait_until(lambda: started.exists() and started.read_text(), "The second run")
        second = tool(*words[3:])
        assert second.returncode == 2 and f"Process {first.pid}" in second.stderr
    finally:
        os.kill(first.pid, signal.SIGKILL)
        first.wait()
    # Its run ends with it, so that nothing computes on for nobody.
    pid = int((tmp_path / "started_8").read_text())
    with pytest.raises(ProcessLookupError):
        for _ in range(600):
            os.kill(pid, 0)
            time.sleep(0.05)
    before = when(out)
    (tmp_path / "go").write_text("")
    third = tool(*words[3:])
    assert third.returncode == 0, third.stderr
    # A result may have the name of a parameter.
    rows = [(row["n"], row["n (result)"], row["status"]) for row in table(out)]
    assert rows == [("4", "4.0", "finished"), ("8", "8.0", "finished")]
    assert when(out)["n=4"] == before["n=4"]


BAR = """
import pdpetsc as pd

def case(E=1500.0, yield_stress=8.0, H=60.0, length=10.0, n=12, strain=0.05, steps=50):
    dx = length / n
    ends = pd.region.Slab("x", high=4.2 * dx) | pd.region.Slab("x", low=length - 4.2 * dx)
    return pd.Case(
        particles=pd.Lattice((0.0,), (length,), dx), horizon=2.015 * dx, fields=[], checkpoints=0,
        material=pd.J2(E=E, nu=0.3, yield_stress=yield_stress, hardening=H), scheme=pd.Correspondence(),
        conditions=[pd.Displacement(ends, x=lambda x, t: strain * t * x[:, 0])],
        steps=pd.Steps(steps),
        history={
            "u": pd.Mean(pd.displacement, "x", pd.region.Nearest((length,))),
            "F": pd.Reaction("x", pd.region.Slab("x", low=length - 4.2 * dx)),
        },
    )
"""
# Where the last particle of it lies.
GAUGE = 10.0 - 5.0 / 12.0


def tensile_force(u, E, yield_stress, H):
    """Return the force of a bar that yields and hardens linearly, in logarithmic strain and Kirchhoff stress."""
    stretch = 1.0 + u / GAUGE
    return hardening(np.log(stretch), E, yield_stress, H) / stretch


@pytest.mark.long
def test_parameters_are_found_again_from_a_noisy_closed_form(tmp_path, rng):
    """With the solver in the loop: E, yield stress and hardening within three standard errors, which are small."""
    truth = {"E": 1000.0, "yield_stress": 10.0, "H": 100.0}
    u = np.linspace(0.0, 0.45, 46)
    rows = np.column_stack([u, tensile_force(u, **truth) + rng.normal(0.0, 0.05, len(u))])
    np.savetxt(tmp_path / "measured.csv", rows, delimiter=",", header="u,force", comments="")
    (tmp_path / "bar.py").write_text(BAR)
    words = ("fit", tmp_path / "bar.py", "E=700:1500", "yield_stress=4:20", "H=30:300:log", "--to")
    words = (
        *words,
        tmp_path / "measured.csv",
        "--columns",
        "u,F:force",
        "--jobs",
        "2",
        "--picture",
        "-o",
        tmp_path / "out",
    )
    finished = tool(*words)
    assert finished.returncode == 0, finished.stderr
    found = json.loads((tmp_path / "out/fit.json").read_text())
    for name, value in truth.items():
        one = found["parameters"][name]
        assert abs(one["value"] - value) < 3.0 * one["standard_error"]
        assert one["standard_error"] < 0.02 * value
    assert found["rms"] == pytest.approx(0.05, rel=0.3) and found["failed"] == 0
    # The same command reads what is there.
    before = when(tmp_path / "out")
    assert tool(*words).returncode == 0
    assert when(tmp_path / "out") == before
    assert json.loads((tmp_path / "out/fit.json").read_text()) == found
    # A curve that goes on where the run ends has no residual there.
    longer = np.vstack([rows, [0.6, 11.0]])
    np.savetxt(tmp_path / "longer.csv", longer, delimiter=",", header="u,F", comments="")
    words = ("fit", tmp_path / "bar.py", "E=500:3000", "--to", tmp_path / "longer.csv", "--columns", "u,F")
    finished = tool(*words, "-o", tmp_path / "out")
    assert finished.returncode == 1
    assert "The run goes from u = 0 to 0.479167 and the measured curve to 0.6" in finished.stderr
    # The parameters of the fit before are not those of this one.
    assert not any((tmp_path / "out" / name).exists() for name in ("fit.json", "fit.csv", "fit.png"))


@pytest.mark.long
def test_runs_side_by_side_on_ranks_give_what_they_give_one_after_another(tmp_path):
    (tmp_path / "case.py").write_text(BAR)
    words = ("E=1000,2000", "steps=3", "--ranks", "2", "--jobs", "2", "-pc_type", "lu")
    finished = tool("study", tmp_path / "case.py", *words, "-o", tmp_path / "two")
    assert finished.returncode == 0, finished.stderr
    assert "want 4 cores" in finished.stdout or (os.cpu_count() or 1) >= 4
    sets = {"E": [1000.0, 2000.0], "steps": [3]}
    alone = pd.study(tmp_path / "case.py", sets, tmp_path / "one", options=["-pc_type", "lu"])
    for outcome in alone.outcomes:
        twin = tmp_path / "two" / outcome.folder.name
        assert summary(twin)["ranks"] == 2
        both = [pd.open(folder).history["F"] for folder in (outcome.folder, twin)]
        assert both[1] == pytest.approx(both[0], rel=1e-9, abs=1e-9)


# What a run is made from.

READS = """
import time
from pathlib import Path
import pdpetsc as pd
from beside import FACTOR

HERE = Path(__file__).resolve().parent

def value(h):
    end = time.monotonic() + 100.0
    while (HERE / "wait").exists() and time.monotonic() < end:
        time.sleep(0.02)
    return {"value": FACTOR * h["u"][-1]}

def case(n=4):
    ends = [pd.region.Slab("x", high=1.5), pd.region.Slab("x", low=2.5)]
    return pd.Case(
        particles=pd.TextFile(HERE / "cloud.txt", dim=1), horizon=2.015, material=pd.BondBased(E=1.0), fields=[],
        conditions=[pd.Displacement(ends[0], x=0.0), pd.Displacement(ends[1], x=0.1)], results=value,
        history={"u": pd.Mean(pd.displacement, "x", ends[1])},
    )
"""


CLOUD = "header: x volume\n1 1.0\n2 1.0\n3 1.0\n"


def reading(folder):
    for name, text in (("case.py", READS), ("beside.py", "FACTOR = 2.0\n"), ("cloud.txt", CLOUD)):
        (folder / name).write_text(text)
    return folder / "case.py"


@pytest.mark.parametrize("ranks", [1, pytest.param(2, marks=pytest.mark.long)])
def test_a_run_whose_input_files_have_changed_is_run_again(ranks, tmp_path, monkeypatch):
    for name, value in ENVIRONMENT.items():
        monkeypatch.setenv(name, value)
    case, out = reading(tmp_path), tmp_path / "out"
    first = pd.study(case, [{"n": 4}], out, ranks=ranks).outcomes[0]
    assert first.finished and first.results["value"] == pytest.approx(0.2)

    def question():
        return CaseFile(case, (), ranks).plan([{"n": "4"}])[0].identity

    assert set(question()["files"]) == {"case.py", "beside.py", "cloud.txt"}
    assert read_outcome(first.folder, question())[0] is not None
    for name, other in (("beside.py", "FACTOR = 5.0\n"), ("cloud.txt", CLOUD.replace("1.0", "2.0"))):
        was = (tmp_path / name).read_text()
        (tmp_path / name).write_text(other)
        assert read_outcome(first.folder, question()) == (None, f"{name} changed")
        (tmp_path / name).write_text(was)
    if ranks == 1:
        return
    (tmp_path / "beside.py").write_text("FACTOR = 6.0\n")
    assert pd.study(case, [{"n": 4}], out, ranks=ranks).outcomes[0].results["value"] == pytest.approx(0.6)


@pytest.mark.long
@pytest.mark.parametrize("name", ["case.py", pytest.param("cloud.txt", marks=pytest.mark.long)])
def test_what_is_changed_while_a_study_runs_gives_no_row(name, tmp_path):
    case, out = reading(tmp_path), tmp_path / "out"
    (tmp_path / "wait").touch()

    class Edit(Progress):
        def started(self, run):
            log = out / f"n={run.parameters['n']}" / "history.csv"
            wait_until(lambda: log.exists() and log.read_text().count("\n") > 1, "The last step")
            if (tmp_path / "wait").exists():
                with (tmp_path / name).open("a") as file:
                    file.write("# a remark\n")
                (tmp_path / "wait").unlink()

    done = pd.study(case, [{"n": 4}, {"n": 8}], out, progress=Edit())
    assert [one.status for one in done.outcomes] == ["failed", "failed"]
    assert f"the case or its files changed while the study ran: {name}" in done.failed[0].said
    # It is not kept as failed either.
    assert not (out / "n=4" / "outcome.json").exists()


def test_files_of_options_and_of_meshes_are_part_of_what_a_run_is_of(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("q.txt").write_text("-ksp_rtol 1e-3\n-options_file r.txt # more\n")
    Path("r.txt").write_text("-pc_type lu\n")
    monkeypatch.setenv("PETSC_OPTIONS", "-options_file_yaml s.yaml")
    assert set(files_of_options(["-options_file", "q.txt"])) == {"q.txt", "r.txt", "s.yaml"}
    monkeypatch.delenv("PETSC_OPTIONS")
    Path("plate.inp").write_text("*HEADING\n*INCLUDE, INPUT=nodes.inp\n*ELEMENT, TYPE=CPS4\n1, 1, 2, 3, 4\n")
    Path("nodes.inp").write_text("*NODE\n1, 0, 0\n2, 1, 0\n*INCLUDE,\nINPUT=more.inp\n")
    Path("more.inp").write_text("*NODE\n3, 1, 1\n4, 0, 1\n")
    Path("plate.xdmf").write_text(
        '<Xdmf><Domain><Grid><Geometry><DataItem Format="HDF">plate.h5:/data0</DataItem></Geometry></Grid></Domain>'
        "</Xdmf>"
    )
    Path("plate.h5").write_bytes(b"numbers")
    for mesh, beside, other in (
        ("plate.inp", "nodes.inp", "*NODE\n1, 0, 0\n2, 2, 0\n*INCLUDE, INPUT=more.inp\n"),
        ("plate.inp", "more.inp", "*NODE\n3, 2, 1\n4, 0, 1\n"),
        ("plate.xdmf", "plate.h5", "others"),
    ):
        before = fingerprint(pd.Mesh(mesh))
        Path(beside).write_text(other)
        assert fingerprint(pd.Mesh(mesh)) != before
    Path("case.py").write_text(MESHED.replace('pd.TextFile("cloud.txt", dim=1)', 'pd.Mesh("plate.inp")'))
    Path("table.txt").write_text("1.0 2.0\n")
    file = CaseFile(Path("case.py"), ["-options_file", "q.txt"], 1)
    (one,) = file.plan([{"E": "1"}])
    assert one.files.keys() == {"case.py", "plate.inp", "nodes.inp", "more.inp", "q.txt", "r.txt"}
    assert one.identity["versions"]["numpy"] == np.__version__
    Path("case.py").write_text(Path("case.py").read_text() + "# a remark\n")
    assert differing(one.files, Path()) == ["case.py"]
    Path("r.txt").write_text("-pc_type jacobi\n")
    (other,) = file.plan([{"E": "1"}])
    assert {name for name in other.identity if other.identity[name] != one.identity[name]} == {"files"}
    assert {name for name in other.files if other.files[name] != one.files[name]} == {"case.py", "r.txt"}
