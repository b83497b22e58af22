"""Every published cure for zero-energy modes, from the command line, on the problems of the papers."""

import os
import subprocess
import sys

import numpy as np
import pytest

import pdpetsc as pd
from tests.commands import ROOT, field, jacobian_ratios, results, run

BAR = "runs/singular_bar/bar.py"
REMOVED = ["scheme=stress_points", "scheme=sub_horizons", "scheme=bond_associated", "control=silling", "control=wan"]
REDUCED = ["scheme=corrected order=6", "scheme=higher_order order=3", "scheme=higher_order order=5"]
# Names of the command line with the horizon that each needs.
METHODS = [(s, "none") for s in pd.SCHEMES] + [("correspondence", c) for c in pd.CONTROLS if c != "none"]


def sawtooth(tmp_path, *arguments):
    return results(BAR, *arguments, output=tmp_path)["results"]["sawtooth"]


@pytest.mark.parametrize("method", REMOVED)
def test_the_sawtooth_falls_to_round_off(method, tmp_path):
    assert sawtooth(tmp_path, method, "n=1000", "horizon=2.015") < 1e-13


def test_plain_correspondence_oscillates_and_more_so_for_wide_horizons(tmp_path):
    assert sawtooth(tmp_path, "n=500") > 5e-3
    assert sawtooth(tmp_path, "n=4000", "horizon=10.1") > 0.1


@pytest.mark.parametrize("method", REDUCED)
def test_corrections_reduce_the_sawtooth_and_leave_some(method, tmp_path):
    plain = sawtooth(tmp_path, "n=1000", "horizon=5.1")
    assert 1e-6 < sawtooth(tmp_path, "n=1000", "horizon=5.1", *method.split()) < 0.3 * plain


@pytest.mark.parametrize("method", ["spring=2", "average=500"])
def test_springs_and_averages_with_the_constants_of_the_papers_leave_the_sawtooth(method, tmp_path):
    assert sawtooth(tmp_path, "n=500", method) > 5e-3


def test_two_and_four_sub_horizons_agree_as_the_paper_says(tmp_path):
    both = []
    for sectors in (2, 4):
        results(BAR, "n=4000", "horizon=10.1", "scheme=sub_horizons", f"sectors={sectors}", output=tmp_path)
        both.append(field(tmp_path, "displacement")[:, 0])
    assert np.abs(both[0] - both[1]).max() < 0.01 * 0.005


def test_sub_horizons_converge_to_the_local_solution(tmp_path):
    errors = [
        results(BAR, f"n={n}", "scheme=sub_horizons", output=tmp_path)["results"]["error"] for n in (500, 1000, 2000)
    ]
    assert errors[0] > 1.3 * errors[1] > 1.6 * errors[2]


@pytest.mark.parametrize("dim", [2, pytest.param(3, marks=pytest.mark.long)])
@pytest.mark.parametrize(("scheme", "control"), METHODS)
def test_every_method_gives_the_same_fields_on_any_rank_count(scheme, control, dim, tmp_path):
    arguments = (f"dim={dim}", f"scheme={scheme}", f"control={control}")
    results("runs/patch/block.py", *arguments, output=tmp_path / "one")
    results("runs/patch/block.py", *arguments, output=tmp_path / "two", ranks=2)
    one, two = (field(tmp_path / name, "displacement") for name in ("one", "two"))
    assert np.abs(two - one).max() <= 1e-10 * np.abs(one).max()


@pytest.mark.parametrize(("scheme", "control"), METHODS)
def test_petsc_finds_the_jacobian_of_every_method_correct(scheme, control, tmp_path):
    finished = run(
        "runs/patch/block.py", "n=4", f"scheme={scheme}", f"control={control}", "-snes_test_jacobian", output=tmp_path
    )
    assert finished.returncode == 0, finished.stderr
    ratios = jacobian_ratios(finished)
    assert ratios
    assert max(ratios) < 1e-7


def test_the_spectrum_of_the_plain_scheme_falls_to_zero_and_others_do_not(tmp_path):
    words = [sys.executable, "runs/singular_bar/spectrum.py", str(tmp_path)]
    subprocess.run(words, cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)}, check=True, timeout=300)
    rows = [line.rsplit(",", 1) for line in (tmp_path / "least_energy.csv").read_text().splitlines()[1:]]
    least = {name.strip('"'): float(value) for name, value in rows}
    for name in ("2 sub-horizons", "4 sub-horizons", "stress points", "Silling", "Littlewood", "Wan"):
        assert least[name] > 20.0 * least["plain"]


def test_names_of_methods_are_those_the_command_line_takes(tmp_path):
    finished = run(BAR, "scheme=nothing", output=tmp_path)
    assert finished.returncode == 2
    assert all(name in finished.stderr for name in pd.SCHEMES)


PLATE = "runs/plates/square_opening.py"


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


@pytest.mark.parametrize("scheme", ["stress_points", "sub_horizons"])
def test_symmetry_lines_spoil_the_stress_and_not_the_displacement(scheme, tmp_path):
    whole, quarter = (
        results(PLATE, f"scheme={scheme}", f"part={part}", output=tmp_path)["results"] for part in ("whole", "quarter")
    )
    assert quarter["u_amplitude"] < whole["u_amplitude"]
    assert quarter["stress_amplitude_away"] > 3.0 * whole["stress_amplitude_away"]
    assert quarter["stress_oscillation_away"] > 4.0 * whole["stress_oscillation_away"]


def test_half_cells_on_symmetry_lines_make_the_quarter_the_whole_with_sub_horizons(tmp_path):
    quarter, whole = (
        results(PLATE, "scheme=sub_horizons", "cells=clipped", f"part={part}", output=tmp_path)["results"]
        for part in ("quarter", "whole")
    )
    assert quarter == pytest.approx(whole, rel=1e-6)
    assert whole["stress_amplitude_away"] < 0.015


@pytest.mark.parametrize("scheme", ["stress_points", "sub_horizons", "bond_associated"])
def test_the_plate_with_a_diamond_hole_is_smooth_and_near_finite_elements(scheme, tmp_path):
    found = results("runs/plates/diamond_hole.py", f"scheme={scheme}", output=tmp_path)["results"]
    assert found["u_oscillation_away"] < 1e-4
    assert found["u_amplitude"] < 0.006
    assert found["stress_amplitude_away"] < 0.05
    assert found["stress_oscillation_away"] < 0.01


@pytest.mark.long
@pytest.mark.parametrize("sides", ["held", "free"])
def test_the_brick_is_smooth_with_stress_points_and_sub_horizons(sides, tmp_path):
    words = ("runs/plates/brick.py", f"sides={sides}")
    plain = results(*words, output=tmp_path)["results"]
    for scheme in ("stress_points", "sub_horizons"):
        smooth = results(*words, f"scheme={scheme}", output=tmp_path, ranks=2)["results"]
        assert plain["u_oscillation_away"] > 8.0 * smooth["u_oscillation_away"]


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
