"""Cracks that the lattice is not aligned with: K, J and G on two contours, in any unit, at finite strain."""

import numpy as np
import pytest

import pdpetsc as pd
from tests.commands import results


def numbers(folder, law, pull, unit=1.0, thickness=1.0, n=40):
    """Return J near, J far, G, K_I, K_II of a crack at 30 degrees across a square plate pulled by a uniform stress."""
    turn, side = np.radians(30.0), 2.0 * unit
    dx, along = side / n, np.array([np.cos(turn), np.sin(turn)])
    middle = 0.5 * side + 0.25 * dx * np.array([1.0, -1.0])
    tip, ahead = tuple(middle + 0.4 * unit * along), tuple(along)
    low, high = pd.region.Slab("y", high=dx), pd.region.Slab("y", low=side - dx)
    contours = ((0.16 * unit, 0.3 * unit), (0.22 * unit, 0.38 * unit))
    case = pd.Case(
        particles=pd.Lattice((0.0, 0.0), (side, side), dx, thickness=thickness),
        horizon=3.015 * dx,
        material=law,
        cracks=[pd.Segment(tuple(middle - 0.4 * unit * along), tip)],
        conditions=[
            pd.Displacement(pd.region.Nearest((0.5 * dx, 0.5 * dx)), x=0.0, y=0.0),
            pd.Displacement(pd.region.Nearest((side - 0.5 * dx, 0.5 * dx)), y=0.0),
            pd.Force(low, y=-pull * side * thickness),
            pd.Force(high, y=pull * side * thickness),
        ],
        history={
            **{f"J{k}": pd.JIntegral(tip, ahead, *radii) for k, radii in enumerate(contours)},
            "G": pd.EnergyReleaseRate(tip, ahead, *contours[1]),
            **(
                {}
                if isinstance(law, pd.NeoHookean)
                else {mode: pd.StressIntensity(tip, ahead, *contours[1], mode=mode) for mode in ("I", "II")}
            ),
        },
        fields=[],
    )
    result = pd.run(case, folder)
    assert not result.doubts
    return np.array([result.history[name][-1] for name in case.history])


@pytest.mark.parametrize(
    "words",
    [
        ("n=60",),
        pytest.param(("n=60", "plane=strain"), marks=pytest.mark.long),
        pytest.param(("n=80",), marks=pytest.mark.long),
    ],
)
def test_a_crack_at_30_degrees_has_its_factors(words, tmp_path):
    """Within 2 % on both contours, though broken bonds make a staircase; J is of both factors."""
    found = results("runs/fracture/centre_crack.py", "angle=30", *words, output=tmp_path)["results"]
    for name in ("J_over_exact", "J_far_over_exact", "G_over_exact"):
        assert found[name] == pytest.approx(1.0, abs=0.02)
    assert found["K_error"] < 0.012
    of_both = np.hypot(found["K1"], found["K2"]) / np.hypot(found["K1_exact"], found["K2_exact"])
    assert of_both**2 == pytest.approx(found["J_far_over_exact"], rel=0.025)


def test_a_slanted_crack_is_the_same_in_any_unit_and_thickness(tmp_path):
    """Newton and millimetres, or metres and three of them thick."""
    in_mm = numbers(tmp_path / "mm", pd.LinearElastic(1000.0, 0.3, "stress"), 1.0)
    in_m = numbers(tmp_path / "m", pd.LinearElastic(1000.0e6, 0.3, "stress"), 1.0e6, unit=1e-3, thickness=3e-3)
    per = np.array([1e3, 1e3, 1e3, 1e6 * 1e-3**0.5, 1e6 * 1e-3**0.5])
    assert in_m / per == pytest.approx(in_mm, rel=1e-8)
    J, G, K1, K2 = in_mm[1:]
    assert in_mm[0] == pytest.approx(J, rel=0.01)
    assert pytest.approx(J, rel=0.01) == G
    assert pytest.approx(J, rel=0.04) == (K1**2 + K2**2) / 1000.0  # eight spacings along half of it
    assert pytest.approx(np.tan(np.radians(30.0)), rel=0.1) == K2 / K1  # of an infinite plate


@pytest.mark.long
def test_plane_strain_has_the_same_factors_and_less_energy(tmp_path):
    """Of a plate under forces alone: stresses do not depend on Poisson's ratio."""
    stress, strain = (
        numbers(tmp_path / plane, pd.LinearElastic(1000.0, 0.3, plane), 1.0) for plane in ("stress", "strain")
    )
    assert strain[3:] == pytest.approx(stress[3:], rel=0.01)
    assert strain[:3] == pytest.approx(stress[:3] * (1.0 - 0.3**2), rel=0.01)


def test_a_slanted_crack_at_finite_strain_gives_one_number(tmp_path):
    """J on both contours and G, where strains are large all over the plate; small loads give that of small strain."""
    law = pd.NeoHookean(1000.0, 0.3, "stress")
    J, far, G = numbers(tmp_path / "large", law, 100.0)
    assert pytest.approx(far, rel=0.02) == J
    assert pytest.approx(far, rel=0.02) == G
    small = numbers(tmp_path / "small", law, 1e-2)
    linear = numbers(tmp_path / "linear", pd.LinearElastic(1000.0, 0.3, "stress"), 1e-2)
    assert small == pytest.approx(linear[:3], rel=1e-3)
    assert abs(far / 100.0**2 / (small[1] / 1e-4) - 1.0) > 0.05


@pytest.mark.long
def test_a_slanted_crack_is_the_same_on_two_ranks(tmp_path):
    one, two = (
        results("runs/fracture/centre_crack.py", "n=60", "angle=30", output=tmp_path / str(ranks), ranks=ranks)[
            "results"
        ]
        for ranks in (1, 2)
    )
    assert one == pytest.approx(two, rel=1e-8)


def test_a_crack_in_space_has_no_j_yet():
    """One sentence says that it is of a plane body, where the case is declared."""
    tip, ahead = (1.0, 1.0), (1.0, 0.0)
    for kind in (pd.JIntegral, pd.EnergyReleaseRate, pd.StressIntensity):
        case = pd.Case(
            particles=pd.Lattice((0.0, 0.0, 0.0), (2.0, 2.0, 1.0), 0.25),
            horizon=0.5,
            material=pd.LinearElastic(1000.0, 0.3),
            conditions=[pd.Displacement(pd.region.Slab("y", high=0.25), x=0.0, y=0.0, z=0.0)],
            history={"J": kind(tip, ahead, 0.6, 0.9)},
        )
        with pytest.raises(pd.CaseError, match=f"A {kind.__name__} is of a crack in a plane body; this one has 3 dim"):
            pd.prepare(case)
