"""Contact with rigid tools: patch, Hertz, tangent, friction, ranks, units, restart, and what is refused."""

from __future__ import annotations

import dataclasses
import json
import shutil

import meshio
import numpy as np
import pytest

import pdpetsc as pd
from pdpetsc.running.suited import refuse_contact_without_weights
from tests.commands import Stop, results, script_on

E, NU = 1000.0, 0.3
PRESS = pd.RigidPlane((0.0, 1.0), (0.0, -1.0), move=(0.0, -0.05))


def block(tool=PRESS, friction=0.0, unit=1.0, modulus=E, penetration=0.01, **changes):
    """Return half of a block of 4 x 1, on rollers below, that a tool presses from above."""
    if unit != 1.0:
        tool = dataclasses.replace(tool, point=[unit * x for x in tool.point], move=[unit * x for x in tool.move])
    case = pd.Case(
        particles=pd.LatticeNodes((0.0, 0.0), (2.0 * unit, unit), 0.125 * unit),
        material=pd.LinearElastic(E=modulus, nu=NU, plane="stress"),
        conditions=[
            pd.Roller("-x"),
            pd.Roller("-y"),
            pd.Contact("+y", tool, friction, penetration=penetration, name="tool"),
        ],
        history={"top": pd.Mean(pd.displacement, "y", "+y"), "right": pd.Mean(pd.displacement, "x", "+x")},
        fields=[pd.displacement, pd.stress],
        steps=pd.Steps(2),
    )
    return dataclasses.replace(case, **changes)


@pytest.mark.parametrize("cells", [False, True])
def test_a_plane_presses_uniformly(cells, tmp_path):
    """Uniaxial stress: forces on facets are in equilibrium with it, on nodes to round-off."""
    particles = pd.Lattice((0.0, 0.0), (2.0, 1.0), 0.125) if cells else block().particles
    case = block(penetration=1e-7, particles=particles, weights=pd.Conforming(), horizon=0.125 * 2.015)
    run = pd.run(case, tmp_path)
    stress = run.field("stress")
    strain = run.history["tool_y"][-1] / 2.0 / E
    assert strain == pytest.approx(-0.05, rel=1e-6)
    assert 0.0 <= run.history["tool_depth"][-1] <= 1e-7
    np.testing.assert_allclose(stress[:, 1, 1], E * strain, rtol=1e-7)
    np.testing.assert_allclose(stress[:, 0, 0], 0.0, atol=1e-7 * E)
    assert run.history["tool_area"][-1] == pytest.approx(2.0)
    assert run.history["right"][-1] == pytest.approx(-NU * 2.0 * strain, rel=0.1 if cells else 1e-7)


def test_adaptive_steps_grow_where_contacts_are_solved_again(tmp_path):
    """Each solve takes few iterations, all solves of a step together more than an easy step has."""
    ball = pd.RigidSphere((1.0, 4.0), 3.0, move=(0.0, -0.3))
    pd.run(block(ball, material=pd.Hencky(E, NU), steps=pd.AdaptiveSteps(first=0.05, largest=0.5)), tmp_path)
    found = json.loads((tmp_path / "summary.json").read_text())["steps"]
    assert max(step["newton_iterations"] for step in found) > 6
    sizes = np.diff([0.0, *(step["t"] for step in found)])
    np.testing.assert_allclose(sizes[1:-1], 1.5 * sizes[:-2])


def test_a_body_between_tools_is_solved_to_their_forces(tmp_path):
    """The residual is compared with the forces of tools as with the reactions of supports."""
    floor = pd.Contact("-y", pd.RigidPlane((0.0, 0.0), (0.0, 1.0)), penetration=0.01, name="floor")
    sides, bottom, press = block().conditions
    found = {}
    for name, ground in (("supported", [bottom]), ("between", [floor, pd.Foundation("-y", normal=1e-6 * E)])):
        pd.run(block(conditions=[sides, press, *ground]), tmp_path / name)
        found[name] = json.loads((tmp_path / name / "summary.json").read_text())["steps"][-1]
    # Two tools press instead of one tool and the supports.
    assert found["between"]["reference"] == pytest.approx(np.sqrt(2.0) * found["supported"]["reference"], rel=0.05)
    assert found["between"]["reason"] == "residual below tolerance"


def cylinder(**given):
    return pd.RigidSphere((0.0, 3.0), 2.0, **{"move": (0.01, -0.02), **given})


@pytest.mark.parametrize("friction", [0.0, 0.3, 5.0, np.inf])
@pytest.mark.parametrize("tool", ["plane", "outside", "inside", "cylinder"])
def test_forces_have_their_tangent(tool, friction, rng):
    """Differences of the forces about a state with facets that touch, stick and slide."""
    if tool == "cylinder":
        declared = pd.RigidCylinder((0.0, 0.0, 1.5), (0.2, 1.0, 0.0), 1.0, move=(0.1, 0.0, -0.05))
        particles = pd.LatticeNodes((0.0, 0.0, 0.0), (0.5, 0.5, 0.5), 0.125)
        conditions = [pd.Clamp("-z"), pd.Contact("+z", declared, friction)]
        case = pd.Case(particles=particles, material=pd.LinearElastic(E, NU), conditions=conditions)
    else:
        tools = {
            "plane": dataclasses.replace(PRESS, move=(0.05, -0.05)),
            "outside": cylinder(),
            "inside": pd.RigidSphere((0.0, -2.0), 4.0, hollow=True, move=(0.02, -0.95)),
        }
        case = block(tools[tool], friction)
    problem = pd.prepare(case).problem
    (term,) = (one for one in problem.terms if type(one).__name__ == "ContactForces")
    n, dim = problem.body.cloud.n_owned, problem.dim
    u = 1e-3 * rng.uniform(-1.0, 1.0, (n, dim))
    term.commit(problem.state(0.0 * u, 0.0))

    def force(u):
        f = np.zeros((problem.body.cloud.n_local, dim))
        term.add_force(problem.state(u, 0.9), f)
        return f

    assert len(term.of_facets(problem.state(u, 0.9))[2]) > 3
    du = rng.uniform(-1.0, 1.0, (n, dim))
    (product,) = term.linearise(problem.state(u, 0.9))
    exact = np.zeros_like(force(u))
    product.add_product(du, exact, np.arange(n, dtype=np.int32))
    h = 1e-8
    difference = (force(u + h * du) - force(u - h * du)) / (2.0 * h)
    assert np.abs(difference - exact).max() < 1e-6 * np.abs(exact).max()


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_ranks_units_and_matrices_change_nothing(friction, tmp_path):
    found = []
    for unit, modulus in ((1.0, E), (1e20, E), (1e-20, 1e20 * E)):
        tool = dataclasses.replace(PRESS, move=(0.02, -0.05))
        run = pd.run(block(tool, friction, unit, modulus), tmp_path / f"{unit:g}")
        assert run.history["tool_y"][-1] < 0.0
        force = run.history["tool_x"][-1], run.history["tool_y"][-1], run.history["right"][-1] * modulus
        found.append(np.array(force) / (modulus * unit))
    np.testing.assert_allclose(found[1:], [found[0]] * 2, rtol=1e-6, atol=1e-10)


TEXT = """
import pdpetsc as pd

def case(friction=0.3, steps=2):
    tool = pd.RigidSphere((0.0, 3.0), 2.0, move=(0.02, -0.03))
    return pd.Case(
        particles=pd.LatticeNodes((0.0, 0.0), (2.0, 1.0), 0.125),
        material=pd.NeoHookean(E=1000.0, nu=0.3),
        conditions=[pd.Roller("-x"), pd.Roller("-y"), pd.Contact("+y", tool, friction, name="tool")],
        history={"top": pd.Mean(pd.displacement, "y", "+y")},
        results=lambda h: {"x": h["tool_x"][-1], "y": h["tool_y"][-1], "top": h["top"][-1]},
        steps=pd.Steps(steps),
    )
"""


def test_ranks_and_matrix_free_solves_agree(tmp_path):
    path = tmp_path / "pressed.py"
    path.write_text(TEXT)
    one = results(path, ranks=1, output=tmp_path / "one")["results"]
    assert one["y"] < -1.0 and one["x"] > 0.1
    for name, words, ranks in (("two", [], 2), ("three", [], 3), ("free", ["-pd_jacobian", "matfree"], 1)):
        other = results(path, *words, ranks=ranks, output=tmp_path / name)["results"]
        assert other == pytest.approx(one, rel=1e-6), name


def cube(side=2.0, x=1.0, y=1.0, z=1.0):
    """Return vertices and triangles of a cube around a point, all turned outwards."""
    corners = np.array([(a, b, c) for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)], dtype=float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = [part for a, b, c, d in quads for part in ((a, b, c), (a, c, d))]
    return 0.5 * side * corners + (x, y, z), triangles


def tools_with_distances():
    """Return tools that are the same box or ball, written in two ways, and points around them."""
    square = pd.RigidSurface([(0.0, 0.0), (0.0, 2.0), (2.0, 2.0), (2.0, 0.0)])
    angle = np.linspace(0.0, 2.0 * np.pi, 4000, endpoint=False)
    disc = pd.RigidSurface(np.stack([np.cos(angle), np.sin(angle)], axis=1))
    points, triangles = cube()
    soup = np.array(points)[np.array(triangles)].reshape(-1, 3)
    return {
        "square": (square, pd.RigidBox((0.0, 0.0), (2.0, 2.0)), 0.9, 1e-12),
        "disc": (disc, pd.RigidSphere((0.0, 0.0), 1.0), 0.9, 2e-3),
        "cube": (pd.RigidSurface(points, triangles), pd.RigidBox((0.0,) * 3, (2.0,) * 3), 0.9, 1e-12),
        "soup": (
            pd.RigidSurface(soup, np.arange(len(soup)).reshape(-1, 3)),
            pd.RigidBox((0.0,) * 3, (2.0,) * 3),
            0.9,
            1e-12,
        ),
    }


@pytest.mark.parametrize("name", ["square", "disc", "cube", "soup"])
def test_a_surface_has_the_distance_of_its_shape(name, rng):
    surface, exact, inside, off = tools_with_distances()[name]
    dim = 2 if name in ("square", "disc") else 3
    surface.check(dim)
    x = rng.uniform(-0.5, 2.5, (3000, dim)) if name != "disc" else rng.uniform(-1.5, 1.5, (3000, 2))
    u = 0.1 * rng.uniform(-1.0, 1.0, x.shape)
    g, n, _ = surface.gap(x, u)
    h, m, _ = exact.gap(x, u)
    assert (np.sign(g) == np.sign(h)).mean() > 0.999
    within = (h < 0.0) & (h > -inside)
    np.testing.assert_allclose(g[within], h[within], atol=off)
    np.testing.assert_allclose((n * m).sum(axis=1)[within], 1.0, atol=off)
    # Outside the distance is at most that of the shape, and positive.
    assert (g[h > off] > 0.0).all() and (g[h > off] <= h[h > off] + off).all()


def test_a_hollow_in_a_surface_is_found(rng):
    """A polygon with a corner that points inwards: distance and normal by all of its segments."""
    notch = pd.RigidSurface([(-2.0, 0.0), (0.0, -1.0), (2.0, 0.0), (2.0, -3.0), (-2.0, -3.0)])
    g, n, H = notch.gap(np.array([(0.0, -0.5), (0.0, -1.2), (1.0, -0.4)]), np.zeros((3, 2)))
    slope = np.array([1.0, 2.0]) / np.sqrt(5.0)
    assert g[0] == pytest.approx(0.5 * 2.0 / np.sqrt(5.0))
    assert g[1] < 0.0 and n[1] == pytest.approx([0.0, 1.0]) and H[1, 0, 0] != 0.0
    assert g[2] == pytest.approx(0.1 * 2.0 / np.sqrt(5.0)) and n[2] == pytest.approx(slope * (-1.0, 1.0))


@pytest.mark.parametrize("tool", ["box", "turned", "polygon"])
def test_curvature_is_the_change_of_the_normal(tool, rng):
    declared = {
        "box": pd.RigidBox((0.0, 0.0, 0.0), (2.0, 2.0, 1.0), 0.3),
        "turned": pd.RigidCylinder((0.0, 0.0, 0.0), (1.0, 2.0, 0.5), 0.7, hollow=True),
        "polygon": pd.RigidSurface([(-2.0, 0.0), (0.0, 1.0), (2.0, 0.0), (0.0, -5.0)]),
    }[tool]
    dim = 2 if tool == "polygon" else 3
    x = rng.uniform(-1.0, 3.0, (500, dim))
    if tool == "polygon":
        x = rng.uniform((-0.3, 1.0), (0.3, 1.0), (500, 2)) + rng.uniform(-0.05, 0.0, (500, 1)) * (0.0, 1.0)
    h, du = 1e-7, rng.uniform(-1.0, 1.0, (500, dim))
    _, n, H = declared.gap(x, 0.0 * x)
    (ahead, m, _), (behind, k, _) = declared.gap(x, h * du), declared.gap(x, -h * du)
    slope, turned = (ahead - behind) / (2.0 * h), (m - k) / (2.0 * h)
    smooth = np.linalg.norm(turned, axis=1) < 1e3
    assert smooth.mean() > 0.98
    np.testing.assert_allclose(slope[smooth], (n * du).sum(axis=1)[smooth], atol=1e-6)
    np.testing.assert_allclose(turned[smooth], np.einsum("pij,pj->pi", H, du)[smooth], atol=2e-4)


def test_a_turning_tool_drags_the_block(tmp_path):
    """A roller that turns about its middle while it presses: it slides, with mu times the normal force."""
    roller = pd.RigidSphere((1.0, 3.0), 2.0, move=(0.0, -0.02), turn=0.5, about=(1.0, 3.0))
    fixed = [pd.Clamp("-y"), pd.Contact("+y", roller, 0.2, name="tool")]
    history = pd.run(block(roller, 0.2, conditions=fixed, steps=pd.Steps(4)), tmp_path).history
    # It turns anticlockwise: its lowest point moves to the right.
    # Normals differ by up to 0.1 from the vertical.
    assert history["tool_x"][-1] == pytest.approx(-0.2 * history["tool_y"][-1], rel=0.02)
    assert history["tool_y"][-1] < -1.0


@pytest.mark.parametrize("dim", [2, 3])
def test_a_scene_that_turns_with_its_tool_has_the_same_forces(dim, rng):
    """A displacement and a tool that are turned together: forces turn with them, with friction."""
    low, high = (0.0,) * dim, (1.0,) * (dim - 1) + (0.5,)
    side, up = ("-y", "+y") if dim == 2 else ("-z", "+z")
    middle = (0.5,) * (dim - 1) + (1.0,)
    turn = 0.4 if dim == 2 else (0.3, -0.2, 0.5)
    found = []
    for turned in (False, True):
        tool = pd.RigidSphere(middle, 0.5, turn=turn if turned else (), about=(0.2,) * dim)
        material = pd.NeoHookean(E=E, nu=NU)
        conditions = [pd.Clamp(side), pd.Contact(up, tool, 0.3)]
        problem = pd.prepare(
            pd.Case(particles=pd.LatticeNodes(low, high, 0.125), material=material, conditions=conditions)
        ).problem
        (term,) = (one for one in problem.terms if type(one).__name__ == "ContactForces")
        cloud = problem.body.cloud
        x, R = cloud.x[: cloud.n_owned], tool.motion(1.0, dim)[0]
        du = 0.01 * np.random.default_rng(3).uniform(-1.0, 1.0, x.shape)
        du[:, -1] += 0.01
        u = (x + du - tool.about) @ R.T + tool.about - x
        f = np.zeros((cloud.n_local, dim))
        term.add_force(problem.state(u, 1.0), f)
        found.append(f @ R)
    assert np.abs(found[0]).max() > 0.1
    np.testing.assert_allclose(found[1], found[0], atol=1e-9)


def test_friction_goes_on_from_a_checkpoint(tmp_path):
    case = block(dataclasses.replace(PRESS, move=(0.05, -0.05)), 0.3, steps=pd.Steps(4))
    whole = pd.run(case, tmp_path / "whole").history

    half = dataclasses.replace(case, steps=pd.Steps(4), history={**case.history, "stop": Stop(0.6)})
    with pytest.raises(pd.Interrupted):
        pd.run(half, tmp_path / "half")
    again = pd.run(case, tmp_path / "again", restart=tmp_path / "half")
    assert again.history["tool_x"][-1] == whole["tool_x"][-1]
    assert again.history["tool_y"][-1] == whole["tool_y"][-1]


class Copied(pd.Quantity):
    """Copies the checkpoint of the step before the last one."""

    def __init__(self, folder):
        self.folder = folder

    def evaluate(self, solution):
        if solution.t == 1.0:
            shutil.copy(self.folder / "checkpoint.h5", self.folder / "kept.h5")
        return 0.0


@pytest.mark.parametrize("columns", ["same", "other"])
def test_the_row_at_a_restart_is_that_of_the_whole_run(columns, tmp_path):
    """The force there was that of the slip since the start of the run; with other columns it is computed again."""
    case = block(dataclasses.replace(PRESS, move=(0.05, -0.05)), 0.3, steps=pd.Steps(4))
    history = {**case.history, "below": pd.Reaction("x", "-y"), "copied": Copied(tmp_path / "whole")}
    case = dataclasses.replace(
        case, conditions=[pd.Clamp("-y"), *case.conditions[2:]], history=history, fields=[pd.reaction]
    )
    whole = pd.run(case, tmp_path / "whole")
    if columns == "other":
        case = dataclasses.replace(case, history={"below": history["below"]})
    again = pd.run(case, tmp_path / "again", restart=tmp_path / "whole" / "kept.h5")
    for column in ("tool_x", "tool_y", "below"):
        rows = again.history[column]
        assert len(rows) == (5 if columns == "same" else 2)
        np.testing.assert_allclose(rows, whole.history[column][-len(rows) :], rtol=1e-12, err_msg=column)
    expected = whole.field("reaction", step=3)
    np.testing.assert_allclose(again.field("reaction", step=3), expected, atol=1e-12 * np.abs(expected).max())


def test_a_block_is_dragged_with_the_coefficient_of_friction(tmp_path):
    """A plane that presses and then slides: all facets slide, with mu times the normal force."""

    tool = pd.RigidPlane((0.0, 1.0), (0.0, -1.0), move=(0.4, -0.02))
    case = block(tool, 0.2, conditions=[pd.Clamp("-y"), pd.Contact("+y", tool, 0.2, name="tool")], steps=pd.Steps(4))
    history = pd.run(case, tmp_path).history
    np.testing.assert_allclose(history["tool_x"][1:], -0.2 * history["tool_y"][1:], rtol=1e-9)


def test_a_tool_presses_first_and_slides_then(tmp_path):
    """Each component of its way has a schedule of its own: half of the run is that of a tool that only presses."""
    press, slide = pd.Table([0.0, 0.5, 1.0], [0.0, 1.0, 1.0]), pd.Table([0.0, 0.5, 1.0], [0.0, 0.0, 1.0])
    tool = pd.RigidPlane((0.0, 1.0), (0.0, -1.0), move=(0.3, -0.05), schedule=(slide, press))
    found = pd.run(block(tool, 0.3, steps=pd.Steps(16)), tmp_path / "both").history
    alone = pd.run(block(friction=0.3, steps=pd.Steps(8)), tmp_path / "press").history
    for name in ("tool_x", "tool_y", "top"):
        assert found[name][8] == pytest.approx(alone[name][-1], rel=1e-9, abs=1e-12 * E)
    # The whole surface slides at the end.
    assert abs(found["tool_x"][-1] / found["tool_y"][-1]) == pytest.approx(0.3, rel=1e-6)
    with pytest.raises(pd.CaseError, match="has 1 schedules; give one for all, or 2"):
        pd.prepare(block(dataclasses.replace(tool, schedule=(press,))))
    turning = dataclasses.replace(tool, turn=0.1, about=(0.0, 1.0))
    with pytest.raises(pd.CaseError, match="or 3: one for each direction, then one for the rotation"):
        pd.prepare(block(turning))
    assert dataclasses.replace(turning, schedule=(slide, press, press)).angle(0.0, 0.5) == pytest.approx(0.1)
    assert dataclasses.replace(turning, schedule=(slide, press, slide)).angle(0.0, 0.5) == 0.0


@pytest.mark.parametrize("steps", [1, 2])
def test_a_tool_whose_pressure_is_found_by_multipliers_does_the_work_that_is_stored(steps, tmp_path):
    """The first step began with the multipliers of its end: its work was twice that of the body."""
    case = block(penetration=1e-7, steps=pd.Steps(steps))
    history = {"work": pd.ExternalWork(), "stored": pd.StrainEnergy()}
    history |= {"copied": Copied(tmp_path / "whole")} if steps == 2 else {}
    case = dataclasses.replace(case, history=history)
    found = pd.run(case, tmp_path / "whole").history
    np.testing.assert_allclose(found["work"], found["stored"], rtol=1e-6)
    if steps == 2:
        again = pd.run(case, tmp_path / "again", restart=tmp_path / "whole" / "kept.h5").history
        np.testing.assert_allclose(again["work"], found["work"], rtol=1e-12)


@pytest.mark.parametrize(("friction", "steps"), [(0.0, 4), (0.3, 16)])
def test_a_moving_tool_works_on_what_is_stored_and_lost(friction, steps, tmp_path):
    """A plane presses and drags: its work is what the body and the contact store, and what friction takes."""
    tool = pd.RigidPlane((0.0, 1.0), (0.0, -1.0), move=(0.3, -0.05))
    history = {"work": pd.ExternalWork(), "lost": pd.DissipatedEnergy()}
    case = block(tool, friction, penetration=0.5, steps=pd.Steps(steps), history=history)
    run = pd.run(case, tmp_path)
    found, stored = run.history, sum(run.solution.energies.values())
    work, lost = found["work"][-1], found["lost"][-1]
    assert stored > 0.0
    if not friction:
        assert work == pytest.approx(stored, rel=1e-9)
        return
    assert lost == pytest.approx(work - stored, rel=1e-9)
    # Each increment is the friction on the way that the tool slides over the surface, which moves after it.
    force, at = np.array(found["tool_x"]), np.array(found["step"]) / steps
    slides = at >= 0.5
    way = np.diff(0.3 * at[slides])
    spent = np.diff(np.array(found["lost"])[slides])
    mean = 0.5 * (force[slides][1:] + force[slides][:-1])
    assert np.all(spent > 0.0) and np.all(spent < np.abs(mean) * way)
    assert spent.sum() > 0.8 * float(np.abs(mean) @ way)


def in_a_cell(tool, dim=2, axes="x"):
    """Return a block in a cell, held below, with a tool above it."""
    high = np.array([4.0, 1.0, 4.0][:dim])
    return pd.Case(
        particles=pd.Lattice(0.0 * high, high, 0.25 if dim == 2 else 0.5),
        material=pd.LinearElastic(E=E, nu=0.3),
        cell=pd.Cell(0.0 * high, high, axes),
        conditions=[
            pd.Displacement(pd.region.Slab("y", high=0.5), **{axis: 0.0 for axis in "xyz"[:dim]}),
            pd.Contact("+y", tool, name="tool"),
            pd.MeanStrain(**{2 * axis: 0.0 for axis in axes}),
        ],
        history={"below": pd.Reaction("y", pd.region.Slab("y", high=0.5))},
    )


@pytest.mark.parametrize(
    ("tool", "dim", "axes", "message"),
    [
        (pd.RigidSphere((0.0, 2.0), 1.0), 2, "x", "RigidSphere of Contact condition 2 changes along x"),
        (pd.RigidBox((1.0, 1.0), (2.0, 2.0)), 2, "x", "RigidBox of Contact condition 2 changes along x"),
        (pd.RigidPlane((0.0, 1.0), (0.1, -1.0)), 2, "x", "RigidPlane of Contact condition 2 changes along x"),
        (pd.RigidPlane((0.0, 1.0), (0.0, -1.0), turn=0.1, about=(0.0, 1.0)), 2, "x", "turns, and the cell is periodic"),
        (pd.RigidCylinder((0.0, 2.0, 0.0), (0.0, 0.0, 1.0), 1.0), 3, "x", "changes along x"),
        (pd.RigidCylinder((0.0, 2.0, 0.0), (0.0, 0.0, 1.0), 1.0, turn=(0, 0.1, 0), about=(0, 2, 0)), 3, "z", "turns"),
    ],
)
def test_tools_that_a_cell_would_repeat_are_refused(tool, dim, axes, message):
    with pytest.raises(pd.CaseError, match=message):
        pd.prepare(in_a_cell(tool, dim, axes))


def test_tools_that_do_not_change_along_the_periods_act_in_a_cell(tmp_path):
    plane = pd.RigidPlane((0.0, 1.0), (0.0, -1.0), move=(0.5, -0.02))
    run = pd.run(in_a_cell(plane), tmp_path)
    assert run.history["tool_y"][-1] == pytest.approx(-run.history["below"][-1], rel=1e-6)
    assert run.history["tool_area"][-1] == pytest.approx(4.0)
    roller = pd.RigidCylinder((2.0, 2.0, 0.0), (0.0, 0.0, 2.0), 1.0, turn=(0.0, 0.0, 0.1), about=(2.0, 2.0, 0.0))
    pd.prepare(in_a_cell(roller, 3, "z"))


def test_a_nearly_incompressible_block_is_squeezed_with_friction(tmp_path):
    """With a stiffness in proportion to the bulk modulus Newton's method fails here."""
    plate = pd.RigidPlane((0.0, 10.005), (0.0, -1.0), move=(0.0, -0.25))
    case = pd.Case(
        particles=pd.LatticeNodes((0.0, 0.0), (10.0, 10.0), 0.5),
        material=pd.NeoHookean(E=2.998, nu=0.499),
        conditions=[
            pd.Roller("-x"),
            pd.Clamp("-y"),
            pd.Contact(pd.region.Face("+y") | pd.region.Face("+x"), plate, 0.3, name="plate"),
        ],
        steps=pd.Steps(1, smallest=0.2),
    )
    run = pd.run(case, tmp_path)
    # Between a strip that slides, 4 mu, and a bonded one, 4 mu (1 + (a / h)^2) per strain.
    assert 1.0 < -run.history["plate_y"][-1] / (4.0 * 0.0245 * 10.0) < 2.0


def test_what_contact_cannot_do_is_refused(tmp_path):
    with pytest.raises(pd.CaseError, match="overlaps the body by"):
        pd.prepare(block(pd.RigidPlane((0.0, 0.9), (0.0, -1.0))))
    with pytest.raises(pd.SolveError, match="the contact does not settle"):
        soft = [pd.Roller("-x"), pd.Roller("-y"), pd.Contact("+y", PRESS, stiffness=1e-3 * E)]
        pd.run(block(conditions=soft), tmp_path)
    with pytest.raises(pd.CaseError, match=r"rigid motions: .*contact does not count as a support\."):
        pd.prepare(block(conditions=[pd.Roller("-x"), pd.Contact("+y", PRESS)]))
    with pytest.raises(pd.CaseError, match="friction"):
        pd.Contact("+y", PRESS, friction=-0.1)
    with pytest.raises(pd.CaseError, match="moves by 3 numbers in 2 dimensions"):
        pd.prepare(block(dataclasses.replace(PRESS, move=(0.0, 0.0, 0.0))))
    with pytest.raises(pd.CaseError, match="bodies in space"):
        pd.prepare(block(pd.RigidCylinder((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 1.0)))
    with pytest.raises(pd.CaseError, match="turns about a point of 2 numbers, not 0"):
        pd.prepare(block(dataclasses.replace(PRESS, turn=0.1)))
    with pytest.raises(pd.CaseError, match="turns by 3 numbers in 2 dimensions; give an angle"):
        pd.prepare(block(dataclasses.replace(PRESS, turn=(0.0, 0.0, 0.1), about=(0.0, 0.0))))
    points, triangles = cube()
    with pytest.raises(pd.CaseError, match="is open"):
        pd.RigidSurface(points, triangles[1:])
    with pytest.raises(pd.CaseError, match="is open"):
        pd.RigidSurface(points, [triangles[0][::-1], *triangles[1:]])
    with pytest.raises(pd.CaseError, match="sides of"):
        pd.prepare(block(pd.RigidBox((0.0, 1.0), (1.0, 1.1), radius=0.2)))


SUNK = """
import pdpetsc as pd

nodes, cells = (kind((0.0, 0.0), (2.0, 1.0), 0.125) for kind in (pd.LatticeNodes, pd.Lattice))
cases = [
    (nodes, pd.RigidSphere((1.0, 0.5), 0.2), "+y"),
    (cells, pd.RigidSphere((1.0, 0.5), 0.2), pd.region.All()),
    (nodes, pd.RigidSphere((1.0, 0.5), 0.06), "+y"),
    (nodes, pd.RigidSphere((1.0625, 1.0), 0.02), "+y"),
    (cells, pd.RigidSphere((1.0, 1.0), 0.02), "+y"),
]
for particles, tool, region in cases:
    conditions = [pd.Clamp("-x"), pd.Contact(region, tool)]
    try:
        pd.prepare(pd.Case(particles=particles, material=pd.LinearElastic(1000.0, 0.3), conditions=conditions))
        print("accepted")
    except pd.CaseError as error:
        print(error)
"""


def test_a_tool_in_the_body_is_refused():
    """Balls away from the surface, and between two facets, with no centroid in them."""
    one, two = (script_on(ranks, SUNK).splitlines() for ranks in (1, 2))
    assert set(two) == set(one)
    assert all(answer.startswith("The tool of Contact condition 2 overlaps the body by ") for answer in one)
    depth = [float(answer.split(" by ")[1].split()[0]) for answer in one]
    assert depth == pytest.approx([0.2, 0.2 - 0.0625 * 2**0.5, 0.06, 0.02, 0.02], rel=0.01)


@pytest.mark.parametrize(
    ("tool", "region"),
    [
        (pd.RigidSphere((1.0625, 1.02), 0.02), "+y"),
        (pd.RigidBox((0.95, 1.0), (1.5, 1.5)), "+y"),
        (pd.RigidSphere((1.0, 0.5), 1.6, hollow=True), pd.region.All()),
        (pd.RigidSurface([(1.0, 0.7), (1.04, 1.2), (0.96, 1.2)]), "+y"),
        (pd.RigidBox((0.51, 0.63), (0.74, 2.0)), "+y"),
        (pd.RigidSphere((1.4375, 0.4375), 0.1875), pd.region.All()),
    ],
    ids=["in touch", "box in touch", "around", "in a crack", "in a notch", "in a hole"],
)
def test_a_tool_beside_the_body_is_accepted(tool, region):
    """A body with a crack from its upper side, a notch of the width of two spacings and a hole of three."""
    holes = pd.region.Box((1.25, 0.25), (1.625, 0.625)) | pd.region.Box((0.5, 0.625), (0.75, 1.0))
    case = pd.Case(
        particles=pd.Lattice((0.0, 0.0), (2.0, 1.0), 0.125, cut=holes),
        material=pd.LinearElastic(E, NU),
        cracks=[pd.Segment((1.0, 0.5), (1.0, 1.1))],
        conditions=[pd.Clamp("-x"), pd.Contact(region, tool)],
    )
    pd.prepare(case)


# Tools that press less deep than a spacing, or pass a part of the surface in a step.
MOTIONS = {
    "moves": pd.RigidBox((0.4, 1.3), (1.6, 1.5), move=(0.1, -0.38)),
    "turns about a point far away": pd.RigidBox((0.4, 1.3), (1.6, 1.5), turn=0.044, about=(9.0, 1.3)),
    "comes back": pd.RigidSphere(
        (1.0, 1.6), 0.5, move=(0.3, -0.2), schedule=pd.Table([0.0, 0.5, 1.0], [0.0, 1.0, 0.0])
    ),
    "in space": pd.RigidSphere(
        (0.3, 0.3, 1.0), 0.4, move=(0.1, 0.0, -0.17), turn=(0.0, 0.1, 0.1), about=(0.3, 0.3, 1.0)
    ),
}


def twice(motion, friction, penetration, monkeypatch):
    """Return two equal problems with a tool, and their contacts; the second one evaluates all facets."""
    tool = MOTIONS[motion]
    if motion == "in space":
        nodes = pd.LatticeNodes((0.0, 0.0, 0.0), (0.6, 0.6, 0.5), 0.1)
        conditions = [pd.Clamp("-z"), pd.Contact(pd.region.All(), tool, friction, penetration=penetration, name="tool")]
        case = pd.Case(particles=nodes, material=pd.LinearElastic(E=E, nu=NU), conditions=conditions)
    else:
        case = block(tool, friction, penetration=penetration)
    problems = [pd.prepare(case).problem for _ in range(2)]
    terms = [next(one for one in p.terms if type(one).__name__ == "ContactForces") for p in problems]
    monkeypatch.setattr(terms[1], "_within", lambda moved, t, limit: np.arange(len(moved)))
    return problems, terms


@pytest.mark.parametrize("friction", [0.0, 0.3])
@pytest.mark.parametrize("motion", MOTIONS)
def test_facets_that_have_moved_less_than_their_gap_are_not_evaluated(motion, friction, rng, monkeypatch):
    """Random motions of the body along steps of a tool: forces and all that is kept are those of all facets."""
    problems, terms = twice(motion, friction, 0.99, monkeypatch)
    kind = type(MOTIONS[motion])
    evaluated, gap = [], kind.gap
    monkeypatch.setattr(kind, "gap", lambda tool, x, u: evaluated.append(len(x)) or gap(tool, x, u))
    counts, touched = np.zeros(2), 0
    u = np.zeros((problems[0].body.cloud.n_owned, problems[0].dim))
    for t in np.linspace(0.0, 1.0, 40)[1:]:
        for _ in range(3):
            u = u + rng.uniform(-2e-3, 2e-3, u.shape)
            found = []
            for k, (problem, term) in enumerate(zip(problems, terms, strict=True)):
                state, f = problem.state(u, t), np.zeros((problem.body.cloud.n_local, problem.dim))
                evaluated.clear()
                term.add_force(state, f)
                counts[k] += sum(evaluated)
                numbers = [term.energy(state), *(value(state) for value in term.numbers().values())]
                traction = next(iter(term.fields().values()))(state)
                found.append((f, term.tool_forces(state), numbers, traction))
            for one, other in zip(*found, strict=True):
                scale = np.abs(other).max(initial=0.0)
                np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12 * scale)
            touched += bool(found[1][0].any())
        for problem, term in zip(problems, terms, strict=True):
            term.update_multipliers(problem.state(u, t))
            term.commit(problem.state(u, t))
            term.start_from(problem.state(u, t))
        assert terms[0].untouched == terms[1].untouched
        for one, other in zip(*(term.arrays().values() for term in terms), strict=True):
            np.testing.assert_allclose(one.values, other.values, rtol=1e-9, atol=1e-12)
    assert touched > 10 and counts[0] < 0.7 * counts[1]


@pytest.mark.parametrize("motion", MOTIONS)
def test_a_passage_is_found_among_the_facets_that_may_be_in_the_tool(motion, rng, monkeypatch):
    problems, terms = twice(motion, 0.0, 1e-4, monkeypatch)
    answers = []
    for _ in range(40):
        u = rng.uniform(-0.5, 0.5) + rng.uniform(-0.05, 0.05, (problems[0].body.cloud.n_owned, problems[0].dim))
        t = rng.uniform(0.0, 1.0)
        some, whole = (term.objection(p.state(u, t)) for p, term in zip(problems, terms, strict=True))
        assert some == whole
        answers.append(some)
        # Gaps are known from any earlier state.
        problems[0].internal_force(problems[0].state(0.1 * u, rng.uniform(0.0, 1.0)))
    assert len(set(answers)) == 2, set(answers)


def test_rough_plates_hold_the_faces_of_a_block(tmp_path):
    """Between rough plates the faces of a block move as with very large friction, and not along the plates."""
    found = {}
    for friction in (0.0, 1e12, np.inf):
        plates = [
            pd.Contact("+y", PRESS, friction, name="tool"),
            pd.Contact("-y", pd.RigidPlane((0.0, 0.0), (0.0, 1.0)), friction, name="floor"),
        ]
        sides = [pd.Roller("-x"), pd.Foundation("-y", normal=1e-6 * E)]
        found[friction] = pd.run(block(conditions=[*sides, *plates]), tmp_path / f"{friction:g}")
    face = np.abs(found[0.0].x[:, 1] - 0.5) == 0.5
    smooth, large, rough = (run.field("displacement")[:, 0] for run in found.values())
    assert np.abs(rough[face]).max() < 0.1 * np.abs(smooth[face]).max()
    np.testing.assert_allclose(rough, large, atol=1e-6 * np.abs(smooth).max())
    assert found[np.inf].history["tool_y"][-1] == pytest.approx(found[1e12].history["tool_y"][-1], rel=1e-6)


def test_a_rough_tool_has_no_force_on_open_facets():
    """Facets that stuck lose their shear traction as the tool is withdrawn."""
    problem = pd.prepare(block(dataclasses.replace(PRESS, move=(0.05, -0.05)), np.inf)).problem
    (term,) = (one for one in problem.terms if type(one).__name__ == "ContactForces")
    u = np.zeros((problem.body.cloud.n_owned, 2))
    term.commit(problem.state(u, 0.01))
    term.start_from(problem.state(u, 0.01))
    for lift, forces in ((0.0, True), (1e-3, False)):
        f = np.zeros((problem.body.cloud.n_local, 2))
        term.add_force(problem.state(u - (0.0, lift), 0.01), f)
        assert f[:, 0].any() == f[:, 1].any() == forces


def pressed_at_random(rng):
    """Return a block that a disc or an inclined plane presses by up to a spacing, with or without friction."""
    if rng.random() < 0.5:
        radius, x = 10.0 ** rng.uniform(-0.7, 0.7), rng.uniform(0.3, 1.7)
        move = rng.uniform(-0.05, 0.05), -rng.uniform(0.01, 0.1)
        tool = pd.RigidSphere((x, 1.0 + radius), radius, move=move)
    else:
        slope = rng.uniform(-0.1, 0.1)
        # It touches a corner of the block at the start.
        move = rng.uniform(-0.05, 0.05), -rng.uniform(0.01, 0.1) - 0.5 * abs(slope)
        tool = pd.RigidPlane((1.0, 1.0 + abs(slope)), (slope, -1.0), move=move)
    conditions = [pd.Clamp("-y"), pd.Contact("+y", tool, rng.choice([0.0, 0.3]), name="tool")]
    return block(material=rng.choice([pd.LinearElastic(E, NU), pd.NeoHookean(E, NU)]), conditions=conditions)


@pytest.mark.parametrize("count", [40, pytest.param(1000, marks=pytest.mark.long)])
def test_newton_converges_for_random_tools(count, tmp_path):
    """Solves with other multipliers are among the iterations of a step.

    Of the first hundred states none has a halved step. Discs of two spacings with friction may have one: the line
    search stops, and full steps alternate between sliding and sticking.
    """
    iterations, halved = [], 0
    for seed in range(count):
        steps = pd.run(pressed_at_random(np.random.default_rng(seed)), tmp_path).summary["steps"]
        halved += len(steps) > 2
        iterations += [step["newton_iterations"] for step in steps]
    assert halved <= 0.005 * count
    assert np.mean(iterations) < 8.0
    assert max(iterations) < (20 if count == 40 else 60)


@pytest.mark.parametrize("ranks", [1, 2])
def test_a_tool_may_contain_another_part_of_the_body(ranks):
    """The head of a bolt rests on a plane, beyond which its shank hangs."""
    text = """
import pdpetsc as pd

box, slab = pd.region.Box, pd.region.Slab
bolt = pd.Lattice((0.0, 0.0), (3.0, 1.5), 0.125, keep=box((-1.0, 1.0), (4.0, 2.0)) | box((1.0, -1.0), (2.0, 1.5)))
below = slab("y", low=0.9, high=1.01) & (slab("x", high=0.99) | slab("x", low=2.01))
pd.prepare(pd.Case(
    bolt, material=pd.LinearElastic(1000.0, 0.3),
    conditions=[pd.Contact(below, pd.RigidPlane((0.0, 1.0), (0.0, 1.0))), pd.Clamp("-y")],
))
print("accepted")
"""
    assert "accepted" in script_on(ranks, text)


def test_a_thick_tool_that_fits_a_round_body_is_accepted(tmp_path):
    """Half a ring around half of a disc: points between facets, in their plane, are slightly in it."""
    angle = np.linspace(0.0, np.pi, 65)
    inner, outer = (radius * np.stack([np.cos(angle), -np.sin(angle)], axis=1) for radius in (1.0, 2.0))
    ring = pd.RigidSurface(np.concatenate([inner, outer[::-1]])[::-1])
    around = np.linspace(0.0, 2.0 * np.pi, 65)[:-1]
    radius = np.linspace(0.0, 1.0, 11)[1:]
    rings = [[(0.0, 0.0)], *(np.stack([r * np.cos(around), r * np.sin(around)], axis=1) for r in radius)]
    points = np.concatenate(rings)
    triangles = [[0, 1 + k, 1 + (k + 1) % 64] for k in range(64)]
    for layer in range(9):
        for k in range(64):
            a, b = 1 + 64 * layer + k, 1 + 64 * layer + (k + 1) % 64
            triangles += [[a, a + 64, b + 64], [a, b + 64, b]]
    meshio.Mesh(points, [("triangle", np.array(triangles))]).write(tmp_path / "disc.vtk")
    held = pd.Displacement(pd.region.Slab("y", low=0.9), x=0.0, y=0.0)
    conditions = [pd.Contact(pd.region.Slab("y", high=-0.1), ring), held]
    pd.prepare(pd.Case(pd.MeshNodes(tmp_path / "disc.vtk"), material=pd.LinearElastic(E, NU), conditions=conditions))


def test_a_tool_from_a_file_presses_as_the_same_tool(tmp_path):
    """A box as triangles of an STL file, which repeats its vertices, in another unit, against a RigidBox."""
    points, triangles = cube(500.0, 250.0, 250.0, 850.0)
    path = tmp_path / "tool.stl"
    meshio.Mesh(points, [("triangle", np.array(triangles))]).write(path)
    box = pd.RigidBox((0.0, 0.0, 0.6), (0.5, 0.5, 1.1), move=(0.02, 0.0, -0.12))
    stl = pd.RigidSurface.read(path, 1e-3, move=box.move)
    found = []
    for number, tool in enumerate((box, stl)):
        case = pd.Case(
            particles=pd.LatticeNodes((0.0, 0.0, 0.0), (1.0, 1.0, 0.5), 0.25),
            material=pd.LinearElastic(E=E, nu=NU),
            conditions=[pd.Clamp("-z"), pd.Contact("+z", tool, 0.2, name="tool")],
        )
        history = pd.run(case, tmp_path / str(number)).history
        found.append([history[f"tool_{axis}"][-1] for axis in "xyz"])
    assert found[0][2] < -1.0
    np.testing.assert_allclose(found[1], found[0], rtol=1e-4, atol=1e-6)


def test_a_tool_from_a_file_takes_a_load(tmp_path):
    points, triangles = cube()
    path = tmp_path / "tool.stl"
    meshio.Mesh(points, [("triangle", np.array(triangles))]).write(path)
    given = {
        "move": (0.1, 0.0, 0.0), "about": (1.0, 1.0, 1.0), "force": (None, 0.0, -1.0), "moment": (0.0, 0.0, 0.0),
        "mass": 2.0, "inertia": 3.0, "velocity": (0.0, 0.0, -4.0), "spin": (0.0, 5.0, 0.0), "schedule": pd.Hold(),
    }  # fmt: skip
    follows = {**given, "move": (), "force": (1.0, 0.0, -1.0), "follows": True}
    for one in (given, follows):
        read = pd.RigidSurface.read(path, **one)
        read.check(3)
        assert {name: getattr(read, name) for name in one} == one


def test_a_cylinder_presses_as_hertz_says(tmp_path):
    found = results("runs/contact/rigid_cylinder.py", "n=40", "radius=8.0", output=tmp_path)["results"]
    assert found["half_width_over_hertz"] == pytest.approx(1.0, abs=0.03)
    assert found["peak_over_hertz"] == pytest.approx(1.0, abs=0.02)
    assert found["pressure_error"] < 0.03


@pytest.mark.long
def test_a_tool_does_not_pass_through_in_one_step(tmp_path):
    """A thin jaw that would lie below the surface at the end of a step, which is halved until it meets the surface."""
    jaw = pd.RigidBox((0.5, 1.0), (1.5, 1.05), move=(0.0, -0.3))
    history = pd.run(block(jaw, material=pd.NeoHookean(E=E, nu=NU), steps=pd.Steps(1)), tmp_path).history
    assert len(history["t"]) > 3
    assert history["tool_y"][-1] < -50.0
    assert history["tool_area"][-1] > 0.5


def test_a_tool_that_turns_too_far_for_friction_takes_smaller_steps(tmp_path):
    """Friction sees the chord of the path of a step: a whole turn in one step would have none."""
    roller = pd.RigidSphere((1.0, 3.0), 2.0, move=(0.0, -0.01), turn=2.0 * np.pi, about=(1.0, 3.0))
    fixed = [pd.Clamp("-y"), pd.Contact("+y", roller, 0.2, name="tool")]
    history = pd.run(block(roller, 0.2, conditions=fixed, steps=pd.Steps(1)), tmp_path).history
    assert len(history["t"]) > 10
    assert history["tool_x"][-1] == pytest.approx(-0.2 * history["tool_y"][-1], rel=0.02)


def test_multipliers_end_with_the_contact(tmp_path):
    """A sphere pressed and withdrawn to its place at the start presses no more."""
    sphere = pd.RigidSphere((1.0, 3.0), 2.0, move=(0.0, -0.04), schedule=pd.Table([0.0, 0.5, 1.0], [0.0, 1.0, 0.0]))
    case = block(sphere, penetration=1e-3, material=pd.NeoHookean(E=E, nu=NU), steps=pd.Steps(8))
    history = pd.run(case, tmp_path).history
    assert min(history["tool_y"]) < -10.0
    assert abs(history["tool_y"][-1]) < 1e-2 * abs(min(history["tool_y"]))
    assert max(history["tool_depth"]) <= 1e-3


def test_several_shells_are_turned_by_how_they_lie(rng):
    """Two cubes apart, and one within another as a cavity, whatever the sense of their triangles."""
    (one, triangles), (other, _) = cube(2.0, 0.0, 0.0, 0.0), cube(1.0, 4.0, 0.0, 0.0)
    inner, _ = cube(1.0, 0.0, 0.0, 0.0)
    back = [part[::-1] for part in triangles]
    points = rng.uniform(-1.5, 5.0, (2000, 3)) * (1.0, 0.3, 0.3)

    def inside(x, middle, half):
        return (np.abs(x - (middle, 0.0, 0.0)) < half).all(axis=1)

    for turned in (triangles, back):
        apart = pd.RigidSurface(np.concatenate([one, other]), [*triangles, *(np.array(turned) + 8).tolist()])
        g = apart.gap(points, 0.0 * points)[0]
        np.testing.assert_array_equal(g < 0.0, inside(points, 0.0, 1.0) | inside(points, 4.0, 0.5))
        hollow = pd.RigidSurface(np.concatenate([one, inner]), [*triangles, *(np.array(turned) + 8).tolist()])
        g = hollow.gap(points, 0.0 * points)[0]
        np.testing.assert_array_equal(g < 0.0, inside(points, 0.0, 1.0) & ~inside(points, 0.0, 0.5))
    crossing, _ = cube(2.0, 1.0, 0.5, 0.5)
    with pytest.raises(pd.CaseError, match="intersect"):
        pd.RigidSurface(np.concatenate([one, crossing]), [*triangles, *(np.array(triangles) + 8).tolist()])


def test_triangles_without_area_change_no_sign(rng):
    """A sliver along the diagonal of a side, as STL files have it."""
    points, triangles = cube(2.0, 0.0, 0.0, 0.0)
    a, b, c = triangles[0]
    (diagonal,) = (e for e in ((a, b), (b, c), (a, c)) if np.linalg.norm(points[e[0]] - points[e[1]]) > 2.5)
    middle = len(points)
    points = np.concatenate([points, [points[list(diagonal)].mean(axis=0)]])
    found = []
    for part in triangles:
        ends = [n for n in part if n in diagonal]
        if len(ends) == 2 and part == triangles[0]:
            k = part.index(next(n for n in part if n not in diagonal))
            p, q, r = part[k], part[(k + 1) % 3], part[(k + 2) % 3]
            found += [(p, q, r), (r, q, middle), ()]
        else:
            found.append(part)
    sliver = [part for part in found if len(part) == 3]
    # The other triangle at the diagonal is split at the middle, so that the surface stays closed.
    for number, part in enumerate(sliver):
        if number > 1 and set(diagonal) <= set(part):
            k = part.index(next(n for n in part if n not in diagonal))
            p, q, r = part[k], part[(k + 1) % 3], part[(k + 2) % 3]
            sliver[number : number + 1] = [(p, q, middle), (p, middle, r)]
            break
    surface = pd.RigidSurface(points, sliver)
    x = rng.uniform(-0.99, 0.99, (500, 3))
    assert (surface.gap(x, 0.0 * x)[0] < 0.0).all()
    assert np.isfinite(surface.gap(x, 0.0 * x)[1]).all()


def test_names_are_not_used_twice(tmp_path):
    twice = [pd.Roller("-x"), pd.Roller("-y"), pd.Contact("+y", PRESS), pd.Contact("+x", cylinder(move=()))]
    with pytest.raises(pd.CaseError, match="Two conditions are named 'contact'"):
        pd.prepare(block(conditions=twice))
    with pytest.raises(pd.CaseError, match="Two columns of the history are named 'tool_y'"):
        pd.run(block(history={"tool_y": pd.Mean(pd.displacement, "y")}), tmp_path)


def test_a_body_without_conforming_weights_is_not_pressed():
    """The default weights fall back to standard ones where conforming ones do not exist."""
    why = "The reason is this."
    with pytest.raises(pd.CaseError, match=r"which do not exist here\. The reason is this\."):
        refuse_contact_without_weights(block(), why)
    refuse_contact_without_weights(block(), "")
    refuse_contact_without_weights(block(conditions=[pd.Clamp("-y")]), why)


@pytest.mark.parametrize("way, told", [(0.5, True), (2.0, False)])
def test_a_tool_that_never_touches_is_told(way, told, tmp_path):
    """A tool at a distance of 1 that returns to it at the end of the run."""
    schedule = pd.Table((0.0, 0.5, 1.0), (0.0, 1.0, 0.0))
    tool = pd.RigidPlane((0.0, 5.0), (0.0, -1.0), move=(0.0, -way), schedule=schedule)
    case = pd.Case(
        particles=pd.LatticeNodes((0.0, 0.0), (8.0, 4.0), 1.0), material=pd.LinearElastic(E=1000.0, nu=0.3),
        conditions=[pd.Clamp("-x"), pd.Clamp("-y"), pd.Traction("+x", x=1.0), pd.Contact("+y", tool)],
        steps=pd.Steps(4),
    )  # fmt: skip
    warnings = pd.run(case, tmp_path).summary["warnings"]
    assert len(warnings) == told
    if told:
        assert "The tool of Contact condition 4 never touched the body. The smallest gap was 0.5" in warnings[0]


def test_a_tool_that_turns_freely_does_not_pass_through_a_body(tmp_path):
    """A paddle swings against a block far from its axis."""
    paddle = pd.RigidBox((0.0, 2.9), (3.0, 3.1), about=(0.0, 3.0), move=(0.0, 0.0), moment=0.0, inertia=1.0, spin=-1.0)
    case = pd.Case(
        pd.Lattice((1.5, 0.0), (2.5, 1.0), 0.125), material=pd.NeoHookean(1000.0, 0.3, density=1.0),
        conditions=[pd.Clamp("-y"), pd.Contact(pd.region.All(), paddle, name="paddle")],
        solver=pd.Implicit(dt=0.01, end=0.8), fields=[],
    )  # fmt: skip
    with pytest.raises(pd.SolveError, match="spacings deep in the body at step time"):
        pd.run(case, tmp_path)


@pytest.mark.parametrize("friction", [0.3, np.inf])
@pytest.mark.parametrize("cells", [False, True])
@pytest.mark.parametrize("dim", [2, 3])
def test_a_tool_feels_the_opposite_force_and_moment(dim, cells, friction, rng):
    """Forces on the particles have the resultant and the moment of those of the tool, where it touches the facets."""
    low, high, up = (0.0,) * dim, (1.0,) * (dim - 1) + (0.5,), "xyz"[dim - 1]
    turn = 0.2 if dim == 2 else (0.1, -0.1, 0.2)
    move = (0.03, *(0.0,) * (dim - 2), -0.05)
    tool = pd.RigidSphere((0.5,) * (dim - 1) + (1.5,), 1.0, move=move, turn=turn, about=(0.5,) * dim)
    case = pd.Case(
        particles=(pd.Lattice if cells else pd.LatticeNodes)(low, high, 0.125),
        material=pd.NeoHookean(E, NU),
        conditions=[pd.Displacement(pd.region.Slab(up, high=0.1), **dict.fromkeys("xyz"[:dim], 0.0))],
    )
    case = dataclasses.replace(case, conditions=[*case.conditions, pd.Contact(f"+{up}", tool, friction)])
    problem = pd.prepare(case).problem
    (term,) = (one for one in problem.terms if type(one).__name__ == "ContactForces")
    cloud = problem.body.cloud
    term.commit(problem.state(np.zeros_like(cloud.x), 0.0))
    state = problem.state(1e-3 * rng.uniform(-1.0, 1.0, cloud.x.shape), 1.0)
    f = np.zeros_like(cloud.x)
    term.add_force(state, f)
    on_tool = term.tool_forces(state)
    assert np.abs(on_tool[:, 0]).max() > 0.1
    found = []
    for place, force in ((cloud.x + state.u, -f), (term._x + term._moved(state), on_tool)):
        arm, force = (np.pad(one, ((0, 0), (0, 3 - dim))) for one in (place, force))
        found.append(np.concatenate([force, np.cross(arm, force)], axis=1).sum(axis=0))
    np.testing.assert_allclose(found[0], found[1], atol=1e-13 * np.abs(f).sum())


def on_a_slope(dim=2, angle=0.4, particles=None, weights=None, unit=1.0, friction=0.0, shake=0.0):
    """Return a block whose lowest layer is held and that a plane presses and drags, all turned by an angle."""
    counts = (12, 6, 6)[:dim]
    c, s, across = np.cos(angle), np.sin(angle), np.zeros(dim)
    along, up = across.copy(), across.copy()
    along[:2], up[:2] = (c, s), (-s, c)
    if particles is None:
        x = pd.Lattice((0.0,) * dim, tuple(map(float, counts)), 1.0).chunk(0, 1).x
        x = x + np.random.default_rng(0).uniform(-shake, shake, x.shape)
        x[:, :2] = x[:, :2] @ np.array([[c, s], [-s, c]])
        particles = pd.Arrays(unit * x, unit**dim)
    height, gap = unit * counts[1], 2.0 * shake * unit
    plane = pd.RigidPlane(
        (height + gap) * up, -up, move=unit * (-(0.1 + 2.0 * shake) * up + (0.05 * along if friction else 0.0))
    )
    return pd.Case(
        particles=particles,
        horizon=3.015 * unit,
        material=pd.LinearElastic(E=E, nu=NU),
        weights=weights,
        conditions=[
            pd.Displacement(pd.region.Where(lambda x: x @ up < unit), **dict.fromkeys("xyz"[:dim], 0.0)),
            pd.Contact(pd.region.Where(lambda x: x @ up > height - unit), plane, friction, name="tool"),
        ],
        steps=pd.Steps(2),
        results=lambda h: {
            "up": sum(h[f"tool_{axis}"][-1] * n for axis, n in zip("xyz", up, strict=False)),
            "along": sum(h[f"tool_{axis}"][-1] * n for axis, n in zip("xyz", along, strict=False)),
            "area": h["tool_area"][-1],
        },
    )


@pytest.mark.parametrize(("dim", "friction"), [(2, 0.0), (2, 0.2), (3, 0.0)])
def test_a_cloud_without_facets_is_pressed_as_the_lattice_that_it_is(dim, friction, tmp_path):
    """A turned lattice as arrays has no facets that are known: those of its outer layer are the same."""
    lattice = pd.Lattice((0.0,) * dim, tuple(map(float, (12, 6, 6)[:dim])), 1.0)
    exact = pd.run(on_a_slope(dim, 0.0, lattice, pd.Standard(), friction=friction), tmp_path / "lattice")
    found = pd.run(on_a_slope(dim, 0.4, weights=pd.Standard(), friction=friction), tmp_path / "arrays")
    assert exact["up"] < -0.9 * 0.1 / 6.0 * E * exact["area"]
    for name in ("up", "along", "area"):
        assert found[name] == pytest.approx(exact[name], rel=1e-7, abs=1e-7 * abs(exact["up"])), name
    if friction:
        assert 0.1 * abs(found["up"]) < abs(found["along"]) <= 0.2 * abs(found["up"]) * (1.0 + 1e-9)
    # Conforming weights, the default of a cloud that is no lattice along the axes.
    conforming = pd.run(on_a_slope(dim, 0.4, friction=friction), tmp_path / "conforming")
    assert "conforming weights" in conforming.summary["scheme"]["note"]
    assert conforming["up"] == pytest.approx(exact["up"], rel=0.02)


@pytest.mark.parametrize("dim", [2, 3])
def test_the_outer_layer_of_a_cloud_balances_a_uniform_stress(dim, tmp_path):
    """A plane presses an irregular cloud, which spreads freely: the stress in its middle is the force over the area."""
    case = on_a_slope(dim, 0.0, shake=0.1)
    low, (_, contact) = pd.region.Slab("y", high=1.0), case.conditions
    one, other = (pd.region.Nearest((x, 0.5, 3.0)[:dim]) for x in (6.0, 0.0))
    held = [pd.Displacement(low, y=0.0), pd.Displacement(one, **dict.fromkeys("xz"[: dim - 1], 0.0))]
    if dim == 3:
        held += [pd.Displacement(other, z=0.0)]
    found = pd.run(dataclasses.replace(case, horizon=None, conditions=[*held, contact], fields=[pd.stress]), tmp_path)
    height = np.asarray(case.particles.x)[:, 1]
    stress = found.field("stress")[(height > 2.0) & (height < 4.0), 1, 1]
    assert stress.mean() == pytest.approx(found["up"] / 12.0 / 6.0 ** (dim - 2), rel=0.02)
    assert stress.std() < 0.3 * abs(stress.mean())


def test_ranks_and_units_change_nothing_of_an_outer_layer(tmp_path):
    path = tmp_path / "cloud.py"
    path.write_text(
        "from tests.terms.test_contact import on_a_slope\n\n\ndef case():\n    return on_a_slope(3, 0.4, shake=0.1)\n"
    )
    one, two = (results(path, output=tmp_path / str(ranks), ranks=ranks) for ranks in (1, 2))
    small = pd.run(on_a_slope(3, 0.4, shake=0.1, unit=1e-3), tmp_path / "small")
    # Rounding chooses between planes that fit an edge nearly as well: lengths of 1e-3 are not exactly those of 1.
    assert small["up"] == pytest.approx(1e-6 * one["results"]["up"], rel=1e-3)
    for name, value in one["results"].items():
        assert two["results"][name] == pytest.approx(value, rel=1e-7), name
    note = next(note for note in one["notes"] if "outer layer" in note)
    assert note == (
        "272 particles are the outer layer that tools touch, half a particle (0.5) outward; give facets=pd.Facets(...) "
        "if the surface is elsewhere. On an irregular cloud it is rough by about 0.1: where a tool presses less deep, "
        "pressures are wrong"
    )
    assert note in two["notes"]


def test_only_tools_touch_an_outer_layer():
    case = on_a_slope(shake=0.1)
    cloud = case.particles
    both = pd.Bodies({"one": cloud, "other": pd.Arrays(np.asarray(cloud.x) + np.array([40.0, 0.0]), 1.0)})
    others = [
        {"particles": both, "conditions": [*case.conditions, pd.BodyContact("one", "other")]},
        {"conditions": [*case.conditions, pd.FollowerPressure("+y", 1.0)]},
        {"conditions": [*case.conditions, pd.Pressure("+y", 1.0)]},
        {"conditions": [*case.conditions, pd.Foundation("-y", normal=1.0)]},
        {"history": {"p": pd.OnSurface(pd.stress, "yy", "+y")}},
        {"weights": pd.Conforming()},
    ]
    for changes in others:
        with pytest.raises(pd.CaseError, match=r"no known surface.*is a surface for pd\.Contact with rigid tools only"):
            pd.prepare(dataclasses.replace(case, **changes))
    # Facets that are wrong are not replaced by an outer layer.
    x = np.asarray(cloud.x)
    wrong = pd.Facets([[0.0, 0.0], [1.0, 0.0]], [[0.0, -1.0], [0.0, 2.0]], [0, 1])
    with pytest.raises(pd.CaseError, match="is open"):
        pd.prepare(dataclasses.replace(case, particles=pd.Arrays(x, 1.0, facets=wrong)))


@pytest.mark.parametrize("law", [pd.LinearElastic(1.0, 0.25), pd.BondBased(1.0)])
def test_a_stiff_body_that_nothing_touches_does_not_stiffen_the_contact(law, tmp_path):
    """The penetration is the pressure over ten moduli of the body below the tool, in spacings."""
    hard = dataclasses.replace(law, E=1000.0)
    soft = pd.LatticeNodes((0.0, 0.0), (1.0, 1.0), 0.25)
    tool = pd.RigidPlane((0.0, 1.0), (0.0, -1.0), move=(0.0, -0.01))

    def depth(name, particles, material, *more):
        conditions = [pd.Displacement("soft -y", x=0.0, y=0.0), pd.Contact("soft +y", tool), *more]
        case = pd.Case(particles, material=material, conditions=conditions, horizon=0.51)
        return pd.run(case, tmp_path / name).history["contact_depth"][-1]

    alone = depth("alone", pd.Bodies({"soft": soft}), law)
    far = pd.LatticeNodes((0.0, -3.0), (1.0, -2.0), 0.25)
    both = pd.Bodies({"soft": soft, "far": far})
    of = [(pd.region.Slab("y", low=-0.5), law), (pd.region.Slab("y", high=-0.5), hard)]
    held = pd.Displacement("far", x=0.0, y=0.0)
    assert depth("both", both, of, held) == pytest.approx(alone, rel=1e-9)
