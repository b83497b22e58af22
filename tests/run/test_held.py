"""Warnings and notes on supports, and on loads that do not load the body."""

import pytest

import pdpetsc as pd
from pdpetsc.running.held import held_load_note, layer_notes, no_load_note, support_warnings
from pdpetsc.running.notes import notes
from tests.commands import results

region = pd.region
STEEL = pd.LinearElastic(E=1000.0, nu=0.3, plane="stress")
LEFT, RIGHT, TOP = (region.Sphere(at, 2.0) for at in ((5.0, 0.0), (35.0, 0.0), (20.0, 8.0)))


def beam(*conditions, particles=None, **changes):
    """Return a plane beam of 40 by 8."""
    lattice = pd.LatticeNodes((0.0, 0.0), (40.0, 8.0), 1.0) if particles is None else particles
    return pd.Case(particles=lattice, material=STEEL, conditions=conditions, **changes)


def said(of, case):
    prepared = pd.prepare(case)
    return of(prepared.case, prepared.problem)


LATTICE = pd.Lattice((0.0, 0.0), (40.0, 8.0), 1.0)
HELD = pd.Displacement(LEFT, x=0.0, y=0.0)
PAD = pd.Force(TOP, y=-1.0)
BOXES = pd.Bodies(
    {
        "lower": pd.LatticeNodes((0.0, 0.0), (40.0, 20.0), 1.0),
        "upper": pd.LatticeNodes((18.0, 24.0), (22.0, 40.0), 1.0),
    }
)


@pytest.mark.parametrize(
    "conditions, told",
    [
        ([HELD, pd.Displacement(RIGHT, y=0.0), PAD], ["Displacement condition 1", "Displacement condition 2"]),
        ([pd.PointSupport(LEFT, x=0.0, y=0.0), pd.Roller(RIGHT, axis="y"), PAD], ["Roller condition 2"]),
        ([HELD, pd.PointSupport(TOP, y=-1.0)], ["Displacement condition 1"]),
        ([pd.PointSupport(LEFT, x=0.0, y=0.0), pd.PointSupport(RIGHT, y=0.0), PAD], []),
        ([pd.Displacement(region.Nearest((5.5, 0.0)), x=0.0, y=0.0), pd.Roller("-x")], ["Displacement condition 1"]),
        ([pd.Displacement(region.Nearest((5.0, 0.0)), x=0.0, y=0.0), pd.Displacement(RIGHT, x=0.0), PAD], [
            "Displacement condition 2"
        ]),
        # Two particles in line with the held direction.
        ([pd.Displacement(region.Nearest((5.5, 0.0)), x=0.0), pd.Clamp("-x"), PAD], []),
        # The only support of the body.
        ([HELD, PAD], []),
        ([pd.Clamp("-x"), PAD], []),
        ([pd.Displacement(region.Slab("x", high=2.0), x=0.0, y=0.0), pd.Roller("+x"), PAD], []),
        ([pd.Clamp("-x"), pd.RigidRegion(RIGHT, move=(0.0, 0.1))], []),
    ],
)  # fmt: skip
def test_a_patch_that_resists_rotation_is_told(conditions, told):
    found = said(support_warnings, beam(*conditions))
    assert [warning.split(" holds ")[0] for warning in found] == told


@pytest.mark.parametrize("contact", [[], [pd.BodyContact("lower +y", "upper -y")], [pd.ParticleContact()]])
def test_bodies_that_pass_through_each_other_are_noted(contact):
    supports = [pd.Clamp("-y"), pd.Displacement("upper +y", y=-6.0, x=0.0)]
    found = [note for note in said(notes, beam(*supports, *contact, particles=BOXES)) if "pass through" in note]
    assert len(found) == 1 - len(contact)


def test_the_place_of_a_patch_and_the_number_of_its_particles_are_told():
    first, _ = said(support_warnings, beam(HELD, pd.Displacement(RIGHT, y=0.0), PAD))
    assert "Displacement condition 1 holds 9 particles near (5, 0.556) and resists rotation." in first


def test_a_whole_side_of_a_small_body_is_no_bearing():
    """A block of 4 by 16 above one of 40 by 20, held at its top."""
    ends = region.Named("upper") & region.Slab("y", low=39.5)
    supports = [pd.Displacement(ends, x=0.0, y=0.0), pd.Clamp("-y")]
    assert said(support_warnings, beam(*supports, particles=BOXES)) == []
    middle = pd.Displacement(region.Box((18.5, 30.5), (20.5, 32.5)), x=0.0, y=0.0)
    top = pd.Displacement(ends, x=0.0)
    (found,) = said(support_warnings, beam(middle, top, pd.Clamp("-y"), particles=BOXES))
    assert found.startswith("Displacement condition 1")


def test_a_patch_at_a_mirror_plane_does_not_rotate():
    half = pd.Displacement(region.Sphere((0.0, 8.0), 2.0), y=-0.1)
    support = pd.PointSupport(RIGHT, y=0.0)
    point = pd.Displacement(region.Nearest((0.5, 0.5)), x=0.0)
    assert said(support_warnings, beam(half, support, particles=LATTICE, symmetry=[pd.Symmetry("x")])) == []
    assert len(said(support_warnings, beam(half, support, point, particles=LATTICE))) == 1


def test_a_bearing_across_a_solid_is_told():
    """A strip over the width of a plate in bending, two spacings wide; a line does not resist rotation."""
    solid = pd.LatticeNodes((0.0, 0.0, 0.0), (12.0, 4.0, 6.0), 1.0)

    def held(width):
        box = region.Box((1.0, -0.1, -0.1), (1.0 + width, 0.1, 6.1))
        supports = [pd.Displacement(box, y=0.0), pd.Clamp("+x"), pd.Traction("-x", y=1e-3)]
        return pd.Case(particles=solid, material=pd.LinearElastic(1000.0, 0.3), conditions=supports)

    assert len(said(support_warnings, held(1.1))) == 1
    assert said(support_warnings, held(0.1)) == []


@pytest.mark.parametrize("radius, told", [(0.5, True), (2.0, False)])
def test_a_point_support_of_one_particle_is_told(radius, told):
    supports = [pd.PointSupport(region.Sphere((5.0, 0.0), radius), x=0.0, y=0.0), pd.PointSupport(RIGHT, y=0.0), PAD]
    found = said(support_warnings, beam(*supports))
    assert [("holds the mean of one particle" in warning) for warning in found] == [True] * told


@pytest.mark.parametrize("ranks", [1, 2])
def test_warnings_of_supports_are_in_the_summary(ranks, tmp_path):
    path = tmp_path / "patch.py"
    path.write_text("""
import pdpetsc as pd

def case():
    left, right, top = (pd.region.Sphere(at, 2.0) for at in ((5.0, 0.0), (35.0, 0.0), (20.0, 8.0)))
    return pd.Case(
        particles=pd.LatticeNodes((0.0, 0.0), (40.0, 8.0), 1.0),
        material=pd.LinearElastic(E=1000.0, nu=0.3, plane="stress"),
        conditions=[
            pd.Displacement(left, x=0.0, y=0.0), pd.Displacement(right, y=0.0), pd.Force(top, y=-1.0),
            pd.Force(left, y=-1.0),
        ],
    )
""")
    one, other, load = results(path, ranks=ranks, output=tmp_path / "run")["notes"]
    assert "condition 1 holds 9 particles near (5, 0.556)" in one and "condition 2 holds 9 particles" in other
    assert load.startswith("Force condition 4: 100 % of its force")


SLAB = region.Slab("x", high=2.0)


@pytest.mark.parametrize(
    "support, particles, words",
    [
        (pd.Displacement(SLAB, x=0.0, y=0.0), LATTICE, ["holds a layer 1.5 deep at side -x"]),
        (pd.Displacement(SLAB, x=0.0, y=0.0), None, ["holds a layer 2 deep at side -x"]),
        (pd.Clamp(SLAB), None, ["holds a layer 2 deep at side -x"]),
        (pd.Displacement("-x", x=0.0, y=0.0), LATTICE, ["holds side -x half a spacing inside"]),
        (pd.Displacement("-x", x=0.0, y=0.0), None, []),
        (pd.Clamp("-x"), LATTICE, []),
        (pd.Clamp("-x"), None, []),
        (pd.Displacement(SLAB, x=lambda x, t: 0.1 * t * x[:, 0], y=0.0), None, []),
        (pd.Displacement(SLAB, y=0.0), None, []),
    ],
)
def test_a_layer_that_is_held_inside_a_side_is_told(support, particles, words):
    held = [support, pd.Roller("+x")] if support.__class__ is pd.Displacement and support.x is None else [support]
    found = said(layer_notes, beam(*held, PAD, particles=particles))
    assert len(found) == len(words) and all(word in note for word, note in zip(words, found, strict=True))


@pytest.mark.parametrize(
    "conditions, words",
    [
        ([pd.Displacement("+x", x=0.0), pd.Traction("+x", x=1.0)], "Traction condition 3: 100 % of its force"),
        ([pd.Displacement("+x", x=0.0), pd.Traction("+x", y=1.0)], ""),
        ([pd.BodyForce(region.All(), y=-1.0)], ""),
        ([pd.PointSupport(RIGHT, y=0.0), pd.Force(RIGHT, y=1.0)], ""),
        ([pd.Force("-x", y=1.0), pd.Traction("+y", y=1.0)], "Force condition 2: 100 %"),
        ([pd.RigidRegion("+x", force=(0.0, None)), pd.Force("+x", y=1.0)], ""),
    ],
)
def test_a_load_on_held_particles_is_told(conditions, words):
    note = said(held_load_note, beam(pd.Clamp("-x"), *conditions))
    assert note.startswith(words) if words else note == ""


# Zero at every fourth of the load.
PULSE = pd.Table((0.0, 0.6, 0.7, 0.74, 1.0), (0.0, 0.0, 1.0, 0.0, 0.0))


@pytest.mark.parametrize(
    "conditions, changes, told",
    [
        ([], {}, True),
        ([pd.Traction("+x", x=0.0), pd.Displacement("+y", y=0.0)], {}, True),
        ([pd.Contact("+y", pd.RigidPlane((0.0, 9.0), (0.0, -1.0)))], {}, False),
        ([pd.Traction("+x", x=1.0)], {}, False),
        ([pd.Displacement("+x", x=0.1, schedule=PULSE)], {"steps": pd.Steps(10)}, False),
        ([pd.Contact("+y", pd.RigidPlane((0.0, 9.0), (0.0, -1.0), move=(0.0, -0.2)))], {}, False),
        ([pd.Eigenstrain(region.All(), xx=1e-3)], {}, False),
        ([pd.RigidRegion("+x", force=(1.0, None))], {}, False),
        ([], {"modes": pd.Modes(2)}, False),
    ],
)  # fmt: skip
def test_a_case_without_load_is_told(conditions, changes, told):
    note = said(no_load_note, beam(pd.Clamp("-x"), *conditions, **changes))
    assert note == ("the case has no load: all loads and prescribed displacements are zero" if told else "")
