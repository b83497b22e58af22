"""Cures for zero-energy modes side by side, from the command line, on the problems of the papers."""

import os
import subprocess
import sys

import numpy as np
import pytest
import tomllib

import pdpetsc as pd
from pdpetsc.command_line.cli import load_case
from tests.commands import ROOT, called, field, jacobian_ratios, results, run_several

BAR = "runs/singular_bar/bar.py"
PULLED = "runs/singular_bar/pulled.py"
BLOCK = "runs/patch/block.py"
REMOVED = [
    "scheme=stress_points",
    "scheme=sub_horizons",
    "scheme=bond_associated",
    "control=silling",
    "control=wan",
    "control=averaged_displacement",
]
REDUCED = ["scheme=corrected order=6", "scheme=higher_order order=3", "scheme=higher_order order=5"]
# Names of the command line with the horizon that each needs.
METHODS = [(s, "none") for s in pd.SCHEMES] + [("correspondence", c) for c in pd.CONTROLS if c != "none"]


def sawtooth(tmp_path, *arguments):
    return results(BAR, *arguments, output=tmp_path)["results"]["sawtooth"]


@pytest.mark.parametrize("method", REMOVED)
@pytest.mark.parametrize(
    "words",
    [(BAR, "n=1000", "horizon=2.015"), pytest.param((PULLED, "n=4000", "horizon=5.1"), marks=pytest.mark.long)],
)
def test_the_sawtooth_falls_to_round_off_between_single_supports(words, method, tmp_path):
    assert results(*words, method, output=tmp_path)["results"]["sawtooth"] < 1e-13


def test_plain_correspondence_oscillates_and_more_so_for_wide_horizons(tmp_path):
    assert sawtooth(tmp_path, "n=500") == pytest.approx(0.0084, rel=0.01)
    assert results(PULLED, "n=4000", "horizon=5.1", output=tmp_path)["results"]["sawtooth"] > 1000.0


@pytest.mark.parametrize("method", REDUCED)
def test_corrections_reduce_the_sawtooth_and_leave_some(method, tmp_path):
    found = [
        results(PULLED, "n=4000", "horizon=5.1", *words, output=tmp_path)["results"]["sawtooth"]
        for words in ((), method.split())
    ]
    assert 1e-6 < found[1] < 0.3 * found[0]


@pytest.mark.parametrize("method", ["spring=2", "average=500"])
def test_constants_of_the_papers_act_in_the_soft_half_and_fail_in_the_stiff_one(method, tmp_path):
    """Luo and Sundararaghavan, Table 1 for n = 500: 0.050 falls to 0.011 on the right, 0.0084 stays on the left."""
    found = results(BAR, "n=500", method, output=tmp_path)["results"]
    assert found["sawtooth_right"] == pytest.approx(0.0112, rel=0.01)
    assert found["sawtooth"] == pytest.approx(0.00975, rel=0.01)


def test_the_bar_takes_one_control(tmp_path):
    finished = called(BAR, "control=silling", "spring=2", "-o", tmp_path)
    assert finished.returncode == 2
    assert "one of control, spring, average and penalty" in finished.stderr


@pytest.mark.parametrize(
    ("dim", "methods"),
    [(2, METHODS[::5]), *(pytest.param(dim, METHODS[:: dim - 1], marks=pytest.mark.long) for dim in (2, 3))],
)
def test_every_method_gives_the_same_fields_on_any_rank_count(dim, methods, tmp_path):
    n = {2: 8, 3: 6}[dim]
    runs = [
        (BLOCK, (f"dim={dim}", f"n={n}", f"scheme={scheme}", f"control={control}"), f"{scheme}_{control}")
        for scheme, control in methods
    ]
    run_several([(case, words, tmp_path / "two" / name) for case, words, name in runs], ranks=2, timeout=600)
    for case, words, name in runs:
        results(case, *words, output=tmp_path / "one" / name)
        one, two = (field(tmp_path / ranks / name, "displacement") for ranks in ("one", "two"))
        assert np.abs(two - one).max() <= 1e-10 * np.abs(one).max(), name


@pytest.mark.parametrize(("scheme", "control"), METHODS)
def test_petsc_finds_the_jacobian_of_every_method_correct(scheme, control, tmp_path, capfd):
    case = load_case(ROOT / BLOCK)(n=4, scheme=scheme, control=control)
    pd.run(case, output=tmp_path, options={"snes_test_jacobian": None})
    ratios = jacobian_ratios(capfd.readouterr().out)
    assert ratios
    assert max(ratios) < 1e-7


@pytest.mark.long
def test_the_spectrum_of_the_plain_scheme_falls_to_zero_and_others_do_not(tmp_path):
    words = [sys.executable, "runs/singular_bar/spectrum.py", str(tmp_path)]
    subprocess.run(words, cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)}, check=True, timeout=300)
    rows = [line.rsplit(",", 1) for line in (tmp_path / "least_energy.csv").read_text().splitlines()[1:]]
    least = {name.strip('"'): float(value) for name, value in rows}
    for name in ("2 sub-horizons", "4 sub-horizons", "stress points", "Silling", "Littlewood", "Wan"):
        assert least[name] > 20.0 * least["plain"]


def test_names_of_methods_are_those_the_command_line_takes(tmp_path):
    finished = called(BAR, "scheme=nothing", "-o", tmp_path)
    assert finished.returncode == 2
    assert all(name in finished.stderr for name in pd.SCHEMES)


PLATE = "runs/plates/square_opening.py"


@pytest.mark.long
def test_the_plate_with_an_opening_oscillates_only_without_control(tmp_path):
    cures = ("scheme=stress_points", "scheme=sub_horizons", "control=silling")
    plain, *cured = (results(PLATE, *words, output=tmp_path)["results"] for words in ((), *((w,) for w in cures)))
    for found in cured:
        assert plain["u_oscillation_away"] > 100.0 * found["u_oscillation_away"]
        assert plain["stress_oscillation_away"] > 2.0 * found["stress_oscillation_away"]
    assert plain["stress_oscillation_away"] > 50.0 * cured[1]["stress_oscillation_away"]
    for found in (plain, *cured):
        assert found["u_amplitude"] < 0.015
        assert found["stress_amplitude_away"] < 0.042


def test_displacement_and_stress_of_the_plate_come_nearer_to_finite_elements_with_the_spacing(tmp_path):
    coarse, fine = (results(PLATE, "scheme=sub_horizons", f"dx={dx}", output=tmp_path)["results"] for dx in ("4", "2"))
    for name in ("u_amplitude_away", "stress_amplitude_away"):
        assert coarse[name] > 2.0 * fine[name]


@pytest.mark.long
@pytest.mark.parametrize("scheme", ["stress_points", "sub_horizons"])
def test_symmetry_lines_spoil_the_stress_and_not_the_displacement(scheme, tmp_path):
    whole, quarter = (
        results(PLATE, f"scheme={scheme}", f"part={part}", output=tmp_path)["results"]
        for part in ("whole", "quarter_cut")
    )
    assert quarter["u_amplitude"] < whole["u_amplitude"]
    assert quarter["stress_amplitude_away"] > 3.0 * whole["stress_amplitude_away"]
    assert quarter["stress_oscillation_away"] > 4.0 * whole["stress_oscillation_away"]


@pytest.mark.parametrize("scheme", [pytest.param("correspondence", marks=pytest.mark.long), "sub_horizons"])
def test_a_quarter_before_mirror_planes_is_the_whole_plate(scheme, tmp_path):
    whole, quarter = (
        results(PLATE, f"scheme={scheme}", *words, output=tmp_path)["results"]
        for words in (("cells=inside",), ("part=quarter",))
    )
    assert quarter == pytest.approx(whole, rel=1e-6)
    assert quarter["stress_amplitude_away"] < 0.04


@pytest.mark.long
def test_half_cells_on_symmetry_lines_make_the_quarter_the_whole_with_sub_horizons(tmp_path):
    quarter, whole = (
        results(PLATE, "scheme=sub_horizons", "cells=clipped", f"part={part}", output=tmp_path)["results"]
        for part in ("quarter_cut", "whole")
    )
    assert quarter == pytest.approx(whole, rel=1e-6)
    assert whole["stress_amplitude_away"] < 0.015


@pytest.mark.long
@pytest.mark.parametrize("scheme", ["stress_points", "sub_horizons", "bond_associated"])
def test_the_plate_with_a_diamond_hole_is_smooth_and_near_finite_elements(scheme, tmp_path):
    found = results("runs/plates/diamond_hole.py", f"scheme={scheme}", output=tmp_path)["results"]
    assert found["u_oscillation_away"] < 1e-4
    assert found["u_amplitude"] < 0.006
    assert found["stress_amplitude_away"] < 0.05
    assert found["stress_oscillation_away"] < 0.01


def oscillation_of_the_table(sides, key):
    """Return the oscillation of the brick that the table of the papers has, which its own test computes again."""
    rows = tomllib.loads((ROOT / "runs/papers/luo_plates.toml").read_text())["row"]
    (row,) = (row for row in rows if row["result"] == f"luo_13_{sides}_u_oscillation_away_{key}")
    return row["ours"] / row["scale"]


@pytest.mark.parametrize("sides", ["held", "free"])
def test_the_brick_is_smooth_with_stress_points(sides):
    assert oscillation_of_the_table(sides, "plain") > 8.0 * oscillation_of_the_table(sides, "points")


@pytest.mark.long
@pytest.mark.parametrize("sides", ["held", "free"])
def test_the_brick_is_smooth_with_sub_horizons(sides, tmp_path):
    words = ("runs/plates/brick.py", f"sides={sides}", "scheme=sub_horizons")
    smooth = results(*words, output=tmp_path, ranks=2)["results"]
    assert oscillation_of_the_table(sides, "plain") > 8.0 * smooth["u_oscillation_away"]


def test_what_repeats_from_particle_to_particle_is_found_and_what_is_smooth_is_not():
    sys.path.insert(0, str(ROOT / "runs/plates"))
    try:
        from plate import sawtooth
    finally:
        sys.path.pop(0)
    x = 0.1 * np.stack(np.meshgrid(np.arange(8), np.arange(6), indexing="ij"), axis=-1).reshape(-1, 2)
    smooth, wave = x[:, 0] ** 3 - x[:, 0] * x[:, 1] ** 2, 0.3 * (-1.0) ** np.rint(10.0 * x[:, 1])
    found = sawtooth(x, smooth + wave, 0.1)
    inner = np.isfinite(found)
    assert inner.sum(axis=0).tolist() == [4 * 6, 8 * 2]
    assert np.abs(found[inner[:, 0], 0]).max() < 1e-14
    assert np.abs(found[inner[:, 1], 1]) == pytest.approx(0.3)
