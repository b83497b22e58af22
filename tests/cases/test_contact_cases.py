"""Contact against closed forms: Hertz, Lame, Cattaneo and Mindlin, Coulomb, Timoshenko, Hondros, Prandtl, Gc."""

import math
import sys

import pytest

import pdpetsc as pd
from tests.commands import ROOT, results

sys.path.append(str(ROOT / "runs/contact"))
import brazilian


def found(name, *words, output, ranks=1):
    return results(f"runs/contact/{name}.py", *words, output=output, ranks=ranks)["results"]


@pytest.mark.parametrize(("top", "force"), [("clamped", 721.2), ("sliding", 690.3)])
def test_a_half_cylinder_has_the_force_and_the_pressure_of_hertz(top, force, tmp_path):
    """Force over the approach: MOOSE with a clamped side, Johnson's closed form of a disc with a sliding one."""
    line = found("hertz_line", "n=12", f"top={top}", output=tmp_path)
    assert line["force"] == pytest.approx(force, rel=0.01)
    assert line["half_width_over_hertz"] == pytest.approx(1.0, abs=0.02)
    assert line["peak_over_hertz"] == pytest.approx(1.0, abs=0.01)
    assert line["pressure_error"] < 0.05


@pytest.mark.long
def test_the_pressure_below_a_half_cylinder_converges(tmp_path):
    errors = []
    for n in (12, 24, 36):
        line = found("hertz_line", f"n={n}", "top=sliding", output=tmp_path / str(n))
        errors.append(abs(line["force_error"]))
    assert errors[1] < 0.5 * errors[0] and errors[2] < 1e-3
    assert line["half_width_over_hertz"] == pytest.approx(1.0, abs=0.005)
    assert line["peak_over_hertz"] == pytest.approx(1.0, abs=0.005)


@pytest.mark.parametrize("ranks", [1, 2])
def test_a_disc_without_facets_has_the_force_and_the_pressure_of_hertz(ranks, tmp_path):
    """Rings touch on their outer layer: Johnson's force for the approach, Hertz's pressure for the force."""
    disc = found("cloud", "n=60", output=tmp_path, ranks=ranks)
    assert disc["force_over_johnson"] == pytest.approx(1.0, abs=0.015)
    assert disc["half_width_over_hertz"] == pytest.approx(1.0, abs=0.02)
    assert disc["peak_over_hertz"] == pytest.approx(1.0, abs=0.015)
    assert disc["pressure_error"] < 0.03


def test_a_roller_that_turns_freely_rolls_on_rubber(tmp_path):
    """Friction turns it, and nothing drags: the roller has no moment about its axle.

    Where round-off cuts a step, the mean of the drag has other places: 2e-4 instead of 4e-6.
    """
    roller = found("rubber_roller", "n=4", "steps=50", "friction=0.3", "rolls=True", output=tmp_path)
    assert abs(roller["drag_over_normal"]) < 1e-3
    assert roller["turned_over_way"] == pytest.approx(1.0, abs=0.03)


@pytest.mark.long
def test_a_ball_has_the_force_the_radius_and_the_pressure_of_hertz(tmp_path):
    ball = found("sphere", "n=5", output=tmp_path)
    assert ball["force_over_hertz"] == pytest.approx(1.027, abs=0.02)
    assert ball["radius_over_hertz"] == pytest.approx(1.0, abs=0.03)
    assert ball["peak_over_hertz"] == pytest.approx(1.0, abs=0.06)
    assert ball["pressure_error"] < 0.2


@pytest.mark.long
def test_a_cylinder_that_is_pulled_sideways_sticks_in_the_middle(tmp_path):
    """Half width of the zone that sticks; nu is not quite 0.5, which the first value shows most."""
    pulled = found("mindlin", "n=12", output=tmp_path)
    for share in (0.25, 0.5, 0.75):
        assert pulled[f"stick_{round(100 * share)}"] == pytest.approx(math.sqrt(1.0 - share), abs=0.06), share
    assert 0.9 < pulled["sliding_force"] <= 1.0 + 1e-9


@pytest.mark.long
def test_two_cylinders_of_one_material_stick_in_the_middle(tmp_path):
    """Tractions along the contact do not move its surfaces apart, so that the closed form holds for any nu."""
    pulled = found("mindlin", "n=12", "bodies=2", "nu=0.3", "slide=1.6", output=tmp_path)
    for share in (0.25, 0.5, 0.75):
        assert pulled[f"stick_{round(100 * share)}"] == pytest.approx(math.sqrt(1.0 - share), abs=0.06), share
    assert pulled["shear_error"] < 0.3
    assert 0.9 < pulled["sliding_force"] <= 1.0 + 1e-9


@pytest.mark.parametrize(("load", "friction"), [(15.0, 0.3), (25.0, 0.3)])
def test_a_block_sticks_to_a_slope_up_to_the_angle_of_friction(load, friction, tmp_path):
    block = found("slope", "n=5", f"load={load}", f"friction={friction}", output=tmp_path)
    end = math.radians(load)
    assert block["drag_over_normal"] == pytest.approx(min(friction, math.tan(end)), rel=1e-4)
    assert block["carried"] == pytest.approx(max(math.sin(end) - friction * math.cos(end), 0.0), abs=1e-4)
    assert block["slip_angle"] == pytest.approx(min(load, math.degrees(math.atan(friction))), abs=0.9)


def test_a_beam_on_rollers_is_as_stiff_as_timoshenko_says(tmp_path):
    stiffness = {}
    for supports in ("rollers", "points"):
        beam = found("three_point_bending", "n=8", f"supports={supports}", output=tmp_path / supports)
        assert beam["support_over_force"] == pytest.approx(1.0, abs=1e-3)
        stiffness[supports] = beam["stiffness_over_timoshenko"]
    assert stiffness["rollers"] == pytest.approx(1.0, abs=0.04)
    assert stiffness["points"] == pytest.approx(1.0, abs=0.02)


def test_the_centre_of_a_disc_has_the_tension_of_the_closed_form(tmp_path):
    disc = found("brazilian", "n=8", output=tmp_path)
    assert disc["tension_over_closed_form"] == pytest.approx(1.0, abs=0.02)
    assert disc["compression_over_closed_form"] == pytest.approx(1.0, abs=0.02)
    assert disc["force_over_johnson"] == pytest.approx(1.0, abs=0.02)


def test_a_disc_splits_when_its_centre_reaches_the_strength(tmp_path):
    """A softening disc carries more than a brittle one. Loads are sampled at load steps."""
    disc = found("brazilian", "damage=point", "n=12", "steps=24", output=tmp_path)
    assert disc["tension_over_closed_form"] == pytest.approx(1.0, abs=0.05)
    assert disc["peak_over_closed_form"] == pytest.approx(1.0, abs=0.05)
    assert 1.0 < disc["peak_over_elastic"] < 1.06
    assert disc["centre_over_strength"] == pytest.approx(1.0, abs=0.04)
    assert disc["path_off_diameter"] < 1e-6
    assert disc["lowest_over_peak"] < 0.7
    assert disc["balance"] == pytest.approx(1.0, abs=0.005)


@pytest.mark.long
def test_a_disc_splits_along_the_loaded_diameter_across_the_rows_of_its_cloud(tmp_path):
    disc = found("brazilian", "damage=point", "n=12", "angle=22.5", output=tmp_path)
    assert 0.0 < disc["path_off_diameter"] < 0.05
    assert disc["peak_over_closed_form"] == pytest.approx(1.0, abs=0.05)
    assert disc["centre_over_strength"] == pytest.approx(1.0, abs=0.05)
    assert disc["balance"] == pytest.approx(1.0, abs=0.005)


@pytest.mark.long
def test_the_peak_of_a_disc_tends_to_that_of_a_brittle_one(tmp_path):
    """With ``E Gc / (D strength^2)`` of 1.5, 0.45 and 0.2."""
    tough, usual, brittle = (
        found("brazilian", "damage=point", "n=16", *words, output=tmp_path / words[0])["peak_over_elastic"]
        for words in (("Gc=0.15", "opening=0.02"), ("Gc=0.045",), ("Gc=0.02", "steps=120"))
    )
    assert tough > usual + 0.1 and usual > brittle + 0.02
    assert brittle == pytest.approx(1.0, abs=0.03)


def test_a_disc_splits_alike_on_two_ranks_and_in_other_units(tmp_path, monkeypatch):
    """In m and kN instead of mm and N."""
    words = {"damage": "point", "n": 8, "steps": 12}
    one, two = (
        found("brazilian", *(f"{name}={value}" for name, value in words.items()), ranks=n, output=tmp_path / str(n))
        for n in (1, 2)
    )
    length, force = 1e-3, 1e-3
    for name in ("E", "MODULUS", "STRENGTH"):
        monkeypatch.setattr(brazilian, name, getattr(brazilian, name) * force / length**2)
    for name in ("RADIUS", "HEIGHT"):
        monkeypatch.setattr(brazilian, name, getattr(brazilian, name) * length)
    given = brazilian.case(**words, load=0.00465 * length, Gc=0.045 * force / length, opening=0.012 * length)
    other = pd.run(given, output=tmp_path / "other")
    for name, value in one.items():
        assert two[name] == pytest.approx(value, rel=1e-6, abs=1e-9), name
        unit = force / length if name == "peak_load" else 1.0
        assert other[name] == pytest.approx(unit * value, rel=1e-6, abs=1e-9), name


@pytest.mark.parametrize("words", ["lower=4 upper=5 load=0.02", "lower=10 upper=4", "lower=8 upper=10 cloud=cells"])
def test_unlike_blocks_pass_the_patch_test(words, tmp_path):
    found_blocks = found("blocks", *words.split(), output=tmp_path)
    assert found_blocks["pressure_error"] < 1e-7 and found_blocks["interface_error"] < 1e-7


@pytest.mark.long
def test_a_shrink_fit_converges_to_the_pressure_of_lame(tmp_path):
    coarse, fine = (
        found("shrink_fit", f"n={n}", output=tmp_path / str(n))["pressure_over_exact"] - 1.0 for n in (4, 8)
    )
    assert abs(fine) < 0.025 and abs(fine) < 0.4 * abs(coarse)


@pytest.mark.long
def test_an_elastic_cylinder_on_an_elastic_block_has_the_pressure_of_hertz(tmp_path):
    """NAFEMS CGS-1: 6.2146 mm and 3585.4 MPa at 35 kN per mm."""
    pressed = found("roller", output=tmp_path)
    assert pressed["force"] == pytest.approx(35e3, rel=0.01)
    assert pressed["half_width"] == pytest.approx(6.2146, rel=0.025)
    assert pressed["peak_pressure"] == pytest.approx(3585.4, rel=0.03)
    assert pressed["pressure_error"] < 0.08


@pytest.mark.long
@pytest.mark.parametrize("friction", [0.0, 0.2])
def test_a_wedge_splits_a_plate_with_the_energy_of_its_ligament(friction, tmp_path):
    """With ten particles over the ligament."""
    split = found("wedge_splitting", "n=20", "steps=25", f"friction={friction}", output=tmp_path)
    assert split["force_over_coulomb"] == pytest.approx(1.0, abs=1e-6)
    assert split["work_over_closed_form"] == pytest.approx(1.0, abs=0.02)
    assert split["dissipated_over_Gc"] == pytest.approx(1.01, abs=0.02)
    assert split["final_over_peak"] < 0.02
    assert split["peak_splitting"] == pytest.approx(41.0, rel=0.05)


@pytest.mark.long
def test_a_notched_beam_on_rollers_breaks_as_on_point_supports(tmp_path):
    """Of four particles over the ligament. The middles of facets touch: half a spacing less of a lever on rollers."""
    words = ("damage=point", "n=8", "steps=14")
    rollers, points = (
        found("three_point_bending", *words, f"supports={supports}", output=tmp_path / supports)
        for supports in ("rollers", "points")
    )
    assert rollers["peak_load"] == pytest.approx(points["peak_load"], rel=0.06)
    assert rollers["work_over_Gc"] == pytest.approx(points["work_over_Gc"], rel=0.05)
    for beam in (rollers, points):
        assert beam["balance"] == pytest.approx(1.0, abs=0.02)
        assert beam["support_over_force"] == pytest.approx(1.0, abs=1e-3)
        assert beam["dissipated_over_Gc"] == pytest.approx(1.0, abs=0.2)
        assert beam["final_over_peak"] < 0.08


def test_rollers_bend_a_notched_beam_along_a_path(tmp_path):
    """The mouth of the notch opens step by step; load steps have the same peak."""
    path, steps = (
        found("three_point_bending", "damage=point", "n=4", word, output=tmp_path / word)
        for word in ("opening=0.003", "steps=40")
    )
    assert path["peak_load"] == pytest.approx(steps["peak_load"], rel=0.02)
    assert path["balance"] == pytest.approx(1.0, abs=0.01)
    assert path["support_over_force"] == pytest.approx(1.0, abs=1e-3)
    assert path["final_over_peak"] < 0.5


@pytest.mark.long
def test_the_pressure_of_a_flat_punch_tends_to_the_one_of_prandtl(tmp_path):
    coarse, fine = (
        found("indentation", f"n={n}", output=tmp_path / str(n))["pressure_over_prandtl"] - 1.0 for n in (4, 8)
    )
    assert fine == pytest.approx(0.135, abs=0.01)
    assert fine < 0.6 * coarse


def test_a_roller_without_friction_takes_no_energy_from_rubber(tmp_path):
    roller = found("rubber_roller", "n=4", "steps=50", output=tmp_path)
    assert abs(roller["drag_over_normal"]) < 1e-6
    assert abs(roller["energy_error"]) < 5e-3
    assert roller["variation"] < 0.1


def test_a_roller_that_slides_on_rubber_takes_what_coulomb_says(tmp_path):
    """The surface below the roller is inclined and stretched, which adds a few per cent."""
    roller = found("rubber_roller", "n=4", "steps=50", "friction=0.3", output=tmp_path)
    assert roller["drag_over_normal"] == pytest.approx(0.3, rel=0.05)
    assert roller["lost_over_coulomb"] == pytest.approx(1.0, abs=0.05)
    assert roller["lost_over_coulomb"] == pytest.approx(roller["drag_over_normal"] / 0.3, abs=0.005)


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_a_cylinder_that_is_drawn_along_a_block_is_resisted_by_coulombs_friction(friction, tmp_path):
    """Both bodies deform. The reactions balance, and only friction takes energy."""
    ironing = found("ironing", "n=4", "steps=20", f"friction={friction}", output=tmp_path)
    assert ironing["balance"] < 1e-8
    assert ironing["variation"] < 0.02
    assert ironing["drag_over_normal"] == pytest.approx(friction, abs=0.01)
    if friction:
        assert ironing["lost_over_coulomb"] == pytest.approx(1.0, abs=0.03)
    else:
        assert abs(ironing["energy_error"]) < 5e-3
