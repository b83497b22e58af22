"""Bonds against closed forms of the continuum: the errors fall with the number of bonds, and surfaces are corrected."""

import sys

import numpy as np
import pytest

from tests.commands import ROOT, results

sys.path[:0] = [str(ROOT / "runs"), str(ROOT / "runs/bonds")]
BAR = "runs/bonds/tension_bar.py"


@pytest.fixture(scope="module")
def forms():
    """Return the study without its start of PETSc, which the tests have started."""
    import study

    start, study.start = study.start, lambda *folders: []
    try:
        import closed_forms
    finally:
        study.start = start
    return closed_forms


@pytest.mark.parametrize(("dim", "plane"), [(1, "stress"), (2, "strain"), (2, "stress"), (3, "strain")])
@pytest.mark.parametrize("influence", ["linear", "cubic", "gaussian"])
def test_dilation_quadratic_force_and_crack_energy_converge(dim, plane, influence, forms):
    coarse, fine = (2, 8) if dim < 3 else (2, 4)
    few, many = (np.abs(forms.errors(dim, plane, m, forms.INFLUENCES[influence])) for m in (coarse, fine))
    assert many.max() < (0.03 if dim < 3 else 0.09)
    assert many.sum() < 0.5 * few.sum()


def test_the_closed_form_of_a_crack_is_the_known_one(forms):
    """G0 = pi c s^2 h^5 / 10 in 3D and c s^2 h^4 / 4 in a plane, with c = 12 E / pi h^4 and 9 E / pi h^3."""
    constant = forms.INFLUENCES["constant"]
    assert forms.crack_energy(3, "strain", constant) == pytest.approx(np.pi / 10.0 * 12.0 / np.pi, rel=1e-6)
    assert forms.crack_energy(2, "stress", constant) == pytest.approx(0.25 * 9.0 / np.pi, rel=1e-6)
    assert forms.crack_energy(1, "stress", constant) == pytest.approx(2.0 / 6.0, rel=1e-6)


def test_a_bar_has_its_modulus_once_the_lattice_is_calibrated_and_its_ends_once_corrected(tmp_path):
    found = {
        name: results(BAR, "horizon=3.015", f"calibration={name}", output=tmp_path)["results"]
        for name in ("continuum", "lattice", "family")
    }
    assert found["continuum"]["stiffness_error"] > 0.2
    for name in ("lattice", "family"):
        assert abs(found[name]["stiffness_error"]) < 1e-9
    assert abs(found["family"]["end_error"]) < 0.2 * abs(found["lattice"]["end_error"])


@pytest.mark.parametrize("horizon", [2.015, 3.015])
def test_a_strip_is_too_soft_and_corrected_to_a_few_percent(horizon, tmp_path):
    plain, corrected = (
        results(BAR, "dim=2", f"horizon={horizon}", f"calibration={name}", output=tmp_path)["results"][
            "stiffness_error"
        ]
        for name in ("lattice", "family")
    )
    assert plain < -0.01
    assert abs(corrected) < 0.7 * abs(plain)


@pytest.mark.long
def test_the_bar_is_the_same_on_two_ranks(tmp_path):
    one, two = (
        results(BAR, "dim=2", "n=6", "material=linear_solid", output=tmp_path / str(r), ranks=r)["results"]
        for r in (1, 2)
    )
    assert two == pytest.approx(one, rel=1e-9)
