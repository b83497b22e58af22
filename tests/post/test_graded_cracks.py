"""J, G and K of cracks in moduli graded by place: against finite elements, in any unit, on mirror planes, of bonds."""

import dataclasses
import json
import sys

import numpy as np
import pytest

import pdpetsc as pd
from pdpetsc.post.fracture import westergaard, westergaard_slope
from tests.commands import ROOT, results
from tests.post.test_fracture_quantities import LAW, at, body, k_field

sys.path.append(str(ROOT / "runs" / "fracture"))
import graded_crack

KINDS = (pd.JIntegral, pd.EnergyReleaseRate, pd.StressIntensity)


@pytest.mark.parametrize(
    "asked",
    [
        (30, 0.1, 0.0, 0.4, "grip", "strain"),
        (40, 10.0, 90.0, 0.4, "tension", "strain"),
        *(
            pytest.param((n, *asked), marks=pytest.mark.long)
            for n, asked in (
                (40, (10.0, 0.0, 0.2, "tension", "strain")),
                (40, (0.1, 0.0, 0.6, "tension", "strain")),
                (40, (10.0, 45.0, 0.4, "tension", "strain")),
                (40, (20.0, 90.0, 0.4, "grip", "stress")),
                (80, (10.0, 90.0, 0.4, "grip", "strain")),
                (80, (0.1, 0.0, 0.4, "tension", "strain")),
            )
        ),
    ],
)
def test_graded_plates_have_the_factors_of_elements(asked, tmp_path):
    """Also sliding ones, where moduli change across the crack; nothing is doubted, and J is of both factors."""
    n, ratio, direction, a, load, plane = asked
    case = graded_crack.case(n=n, ratio=ratio, direction=direction, a=a, load=load, plane=plane)
    result = pd.run(case, tmp_path, check=True)
    assert len(result.check()) == 5
    assert not result.doubts
    assert np.hypot(result["K1_over"], result["K2_over"]) ** 2 == pytest.approx(result["J_over"], rel=1.6 / n)
    assert result["J_over"] == pytest.approx(result["J_far_over"], rel=0.8 / n)


@pytest.mark.long
def test_what_elements_say_is_what_they_say():
    import graded_crack_elements

    asked = (10.0, 90.0, 0.4, "grip", "strain")
    stored = json.loads(graded_crack.STORE.read_text())[graded_crack.name(*asked)]
    assert graded_crack_elements.numbers(*asked, least=1e-3) == pytest.approx(stored, rel=2e-3)


@pytest.mark.long
def test_graded_plates_are_the_same_on_two_ranks(tmp_path):
    words = ("n=30", "direction=45")
    one, two = (
        results("runs/fracture/graded_crack.py", *words, output=tmp_path / str(ranks), ranks=ranks)["results"]
        for ranks in (1, 2)
    )
    assert one == pytest.approx(two, rel=1e-8)


@pytest.mark.parametrize("mode", ["I", "II"])
def test_slopes_of_auxiliary_stresses_are_those_of_the_stresses(mode, rng):
    x, h = rng.uniform(-1.0, 1.0, (50, 2)), np.array([1e-6, 0.0])
    x = x[np.abs(x[:, 1]) > 0.01]
    ahead, behind = (westergaard(x + d, mode, LAW)[0] for d in (h, -h))
    assert np.allclose(westergaard_slope(x, mode), (ahead - behind) / 2e-6, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize(("unit", "stiff", "thickness"), [(1e-3, 1e6, 1.0), (1.0, 1.0, 3.0), (25.4, 1e-9, 0.1)])
def test_units_and_thickness_change_nothing(unit, stiff, thickness):
    """Lengths and moduli in other units, of a field that is no equilibrium of this body."""

    def numbers(unit, stiff, thickness):
        law = dataclasses.replace(LAW, E=LAW.E * stiff)
        graded = pd.Graded(law, lambda x: np.exp(1.5 * x[:, 0] / unit + 0.5 * x[:, 1] / unit))
        solution = at(
            body(n=24, material=graded, unit=unit, thickness=thickness),
            lambda x: unit * k_field(x / unit, 2.0, -0.7, LAW),
        )
        where = ((0.0, 0.0), (1.0, 0.0), unit * 0.3, unit * 0.8)
        J, G, K1, K2 = (
            kind(*where, **more).evaluate(solution)
            for kind, more in (*((kind, {}) for kind in KINDS), (pd.StressIntensity, {"mode": "II"}))
        )
        return [J / (stiff * unit), G / (stiff * unit), K1 / (stiff * unit**0.5), K2 / (stiff * unit**0.5)]

    assert numbers(unit, stiff, thickness) == pytest.approx(numbers(1.0, 1.0, 1.0), rel=1e-9)


def test_half_a_graded_plate_gives_the_tip_of_the_whole():
    """The crack lies on a mirror plane: displacements are those of the whole body, not the mean of the half."""
    dx, low, found = 0.05, pd.region.Slab("y", low=1.0 - 0.05), []
    for half in (True, False):
        case = pd.Case(
            particles=pd.Lattice((-1.0, 0.0 if half else -1.0), (1.0, 1.0), dx),
            horizon=2.015 * dx,
            material=pd.Graded(LAW, lambda x: np.exp(1.5 * x[:, 0])),
            cracks=[pd.Segment((-2.0, 0.0), (0.0, 0.0))],
            symmetry=[pd.Symmetry("y")] if half else [],
            conditions=[pd.Displacement(low, x=0.0, y=0.0)],
        )
        solution = at(pd.prepare(case), lambda x: k_field(x, 1.0, 0.0, LAW))
        found.append([kind((0.0, 0.0), (1.0, 0.0), 0.3, 0.8).evaluate(solution) for kind in KINDS])
    assert found[0] == pytest.approx(found[1], rel=1e-9)


@pytest.mark.parametrize("kinematics", ["small", pytest.param("finite", marks=pytest.mark.long)])
def test_graded_bonds_have_the_factors_of_elements(kinematics, tmp_path):
    """In plane stress, where Poisson's ratio of bonds is a third; J and K within the error of their moduli."""
    asked = (10.0, 0.0, 0.4, "grip", "stress")
    case = graded_crack.case(n=40, horizon=3.015, plane="stress")
    bonds = pd.BondBased(1.0, plane="stress", calibration="family", kinematics=kinematics)
    case = dataclasses.replace(
        case,
        material=dataclasses.replace(case.material, material=bonds),
        scheme=None,
        history={name: one for name, one in case.history.items() if name != "G"},
        results=None,
        expect={},
    )
    result = pd.run(case, tmp_path)
    elements = json.loads(graded_crack.STORE.read_text())[graded_crack.name(*asked)]
    unit = graded_crack.STRAIN * np.sqrt(0.4 * np.pi)
    for name in ("J", "J far"):
        assert result.history[name][-1] == pytest.approx(elements["J_over"] * unit**2, rel=0.06)
    assert result.history["K1"][-1] == pytest.approx(elements["K1_over"] * unit, rel=0.04)
    assert not result.doubts
