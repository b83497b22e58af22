"""Elastic-plastic solids with numbers: the bar that necks, Cook's membrane, the cylinder that is opened."""

import importlib.util
import json
import math
import sys

import numpy as np
import pytest
from scipy.optimize import brentq

import pdpetsc as pd
from tests.commands import ROOT, results

NECKING, COOK, CYLINDER, NOTCHED = (
    f"runs/solids/{name}.py" for name in ("necking", "cook_plastic", "cylinder_expansion", "notched_plate")
)


def module_of(path):
    sys.path.insert(0, str(ROOT / "runs/solids"))
    spec = importlib.util.spec_from_file_location(f"case_{path.split('/')[-1][:-3]}", ROOT / path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.mark.long
def test_a_bar_without_a_waist_is_strained_uniformly(tmp_path):
    """Force and radius over the elongation are those of the law of one point up to the peak, where it may neck."""
    bar = module_of(NECKING)
    found = pd.run(bar.case(n=2, waist=1.0, end=8.0, steps=8), output=tmp_path).history
    for t, quarter, radius in zip(found["t"][1:], found["quarter_force"][1:], found["radius"][1:], strict=True):
        strain = math.log1p(8.0 * t / bar.LENGTH)
        stress = brentq(lambda tau, e=strain: tau - yields(bar, e - tau / bar.E), 0.0, 1e4, xtol=1e-9)
        if 8.0 * t > 7.1:  # beyond the peak a uniform bar is not stable, and a neck carries less
            assert 4.0 * abs(quarter) < (1.0 + 1e-8) * stress * math.exp(-strain) * math.pi * bar.RADIUS**2
            continue
        lateral = -bar.NU * stress / bar.E - 0.5 * (strain - stress / bar.E)
        area = math.pi * bar.RADIUS**2
        assert 4.0 * abs(quarter) == pytest.approx(stress * math.exp(-strain) * area, rel=1e-8)
        assert radius == pytest.approx(bar.RADIUS * math.exp(lateral), rel=1e-8)
    # Considere's point, with elastic strains; without them it is the literature's 79.6 kN at 7.1 mm.
    force = 4.0 * np.abs(found["quarter_force"])
    assert force.max() == pytest.approx(79.46e3, rel=1e-4)
    assert 8.0 * found["t"][int(force.argmax())] == pytest.approx(7.0)


def yields(bar, alpha):
    return bar.YIELD + bar.LINEAR * alpha - bar.SATURATION * math.expm1(-bar.RATE * alpha)


def test_finite_elements_of_the_bar_without_a_waist_are_that_too():
    bar, stored = module_of(NECKING), json.loads((ROOT / "runs/solids/necking_elements.json").read_text())["perfect"]
    for elongation, force in zip(stored["elongation"][1:], stored["force"][1:], strict=True):
        strain = math.log1p(elongation / bar.LENGTH)
        stress = brentq(lambda tau, e=strain: tau - max(yields(bar, max(e - tau / bar.E, 0.0)), 0.0), 0.0, 1e4)
        assert force == pytest.approx(stress * math.exp(-strain) * math.pi * bar.RADIUS**2, rel=1e-6)


def test_the_stress_of_the_rigid_plastic_cylinder_is_that_of_the_literature():
    cylinder = module_of(CYLINDER)
    found = [cylinder.rigid_plastic(a) for a in (20.0, 40.0, 85.0)]
    assert found == pytest.approx([-0.1615, -0.0496, -0.01174], rel=1e-3)


@pytest.mark.long
def test_the_tip_of_the_membrane_converges_to_finite_elements(tmp_path):
    """From above with a soft control, which bends too easily on few particles, and from below with a stiff one."""
    found = {
        (n, G): results(COOK, f"n={n}", f"G={G}", output=tmp_path)["results"]["tip_error"]
        for n, G in ((8, 0.001), (16, 0.001), (8, 0.01), (16, 0.01))
    }
    assert found[8, 0.001] == pytest.approx(0.165, rel=2e-2)
    assert found[16, 0.001] == pytest.approx(0.038, rel=5e-2)
    assert found[8, 0.01] == pytest.approx(-0.0856, rel=2e-2)
    assert found[16, 0.01] == pytest.approx(-0.0297, rel=5e-2)


@pytest.mark.long
def test_the_stress_of_the_cylinder_converges_to_the_rigid_plastic_one(tmp_path):
    coarse, fine = (results(CYLINDER, f"n={n}", output=tmp_path)["results"] for n in (4, 8))
    for a, most in ((20, 1e-3), (40, 0.01), (85, 0.15)):
        assert abs(fine[f"stress_{a}_error"]) < min(most, 0.15 * abs(coarse[f"stress_{a}_error"]))


@pytest.mark.long
def test_the_bar_necks_at_the_force_of_finite_elements(tmp_path):
    found = results(NECKING, "n=3", "end=10", "steps=40", output=tmp_path)["results"]
    assert abs(found["peak_force_error"]) < 2e-3
    assert abs(found["elongation_at_peak_error"]) < 0.05
    # The neck is as wide as a horizon allows, and less deep than that of elements.
    assert 0.0 < found["neck_radius_error"] < 0.1


@pytest.mark.long
def test_a_notched_plate_in_plane_stress_pulls_as_finite_elements_do(tmp_path):
    """Elements half as large change the force by 0.7 %."""
    stored = json.loads((ROOT / "runs/solids/notched_plate_elements.json").read_text())
    assert abs(stored["change_from_twice_the_mesh_size"]) < 0.01
    assert np.all(np.diff(stored["force"]) > 0.0)
    coarse, fine = (results(NOTCHED, f"n={n}", output=tmp_path / str(n))["results"] for n in (10, 20))
    assert 0.0 < fine["force_error"] < min(0.01, 0.6 * coarse["force_error"])
    assert 0.0 < fine["half_error"] < min(0.015, 0.6 * coarse["half_error"])


def test_both_codes_have_the_same_law_in_plane_stress(rng):
    """That of the finite elements and ours, each with its own search for the stretch across the plane."""
    module_of(NOTCHED)  # makes its folder importable
    import elements

    law = pd.J2(E=206.9, nu=0.29, plane="stress", yield_stress=0.45, hardening=2.0)
    other = elements.PlaneStress(206.9, 0.29, lambda alpha: (0.45 + 2.0 * alpha, np.full_like(alpha, 2.0)), 20)
    loops, constants, history = law.history_kernels(2), law.constants(2), law.history_at(2, np.zeros((20, 2)))
    F, every = np.tile(np.eye(2), (20, 1, 1)), np.arange(20)
    for _ in range(2):
        F = F + 0.02 * rng.standard_normal(F.shape)
        P, whole = np.empty_like(F), np.tile(np.eye(3), (20, 1, 1))
        loops.stress(F, every, constants, history, P)
        whole[:, :2, :2] = F
        assert np.abs(other.respond(whole)[0][:, :2, :2] - P).max() < 1e-7 * np.abs(P).max()
        loops.commit(F, every, constants, history)
        other.keep(whole)
        assert other.alpha == pytest.approx(law.plastic_strain(history), abs=1e-9)
    assert other.alpha.min() > 0.0
