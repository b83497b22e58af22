"""Rigid tools and regions in equilibrium with forces and moments."""

import dataclasses
import json

import numpy as np
import pytest
import scipy

import pdpetsc as pd
from pdpetsc.problem.assembly import Assembler
from pdpetsc.solvers.path_following.solver import PathSolver
from pdpetsc.solvers.rigid_bodies import RigidBodies
from tests.commands import STOPPING, results, stopped_and_continued

E = 1000.0
DISC = (1.0, 3.0)


def pressed(tool, friction=0.0, unit=1.0, modulus=E, steps=3, **changes):
    """Return a block of 2 x 1 that is held below and pressed by a tool from above."""
    given = {
        "particles": pd.LatticeNodes((0.0, 0.0), (2.0 * unit, unit), 0.125 * unit),
        "material": pd.Hencky(modulus, 0.3),
        "conditions": [pd.Clamp("-y"), pd.Contact("+y", tool, friction, name="tool")],
        "steps": steps if isinstance(steps, pd.Steps) else pd.Steps(steps),
        "history": {"x": pd.Reaction("x", "-y"), "y": pd.Reaction("y", "-y"), "m": pd.ReactionMoment("-y", (0.0, 0.0))},
    }
    return pd.Case(**{**given, **changes})


def disc(unit=1.0, gap=0.0, **given):
    return pd.RigidSphere((unit, (3.0 + gap) * unit), 2.0 * unit, **given)


@pytest.mark.parametrize("gap", [0.0, 0.3])
def test_a_tool_finds_the_place_at_which_it_has_its_force(gap, tmp_path):
    """Where a prescribed tool has this force; also a tool that begins at a distance."""
    loaded = pd.run(pressed(disc(gap=gap, force=(None, -20.0))), tmp_path / "loaded").history
    assert loaded["tool_y"] == pytest.approx([0.0, -20.0 / 3.0, -40.0 / 3.0, -20.0], rel=1e-7)
    assert loaded["y"][-1] == pytest.approx(20.0, rel=1e-7)
    assert loaded["tool_move_y"][-1] < -gap - 0.01
    moved = disc(gap=gap, move=(0.0, loaded["tool_move_y"][-1]))
    assert pd.run(pressed(moved), tmp_path / "moved").history["tool_y"][-1] == pytest.approx(-20.0, rel=1e-4)


@pytest.mark.parametrize("friction", [0.0, 0.5])
def test_forces_and_moments_on_tools_arrive_at_the_support(friction, tmp_path):
    """Balance of the whole body in the deformed state: the support has the opposite force and moment."""
    plate = pd.RigidPlane((1.0, 1.0), (0.0, -1.0), force=(None, -20.0), moment=2.0, about=(1.0, 1.0))
    stuck = disc(force=(None, -20.0), moment=3.0, about=DISC)
    for name, tool in (("plate", plate), ("disc", stuck)):
        if name == "disc" and not friction:
            continue
        found = pd.run(pressed(tool, friction), tmp_path / name).history
        d = np.array([found["tool_move_x"][-1], found["tool_move_y"][-1]])
        about = np.asarray(tool.about) + d
        force = np.array([found["tool_x"][-1], found["tool_y"][-1]])
        moment = about[0] * force[1] - about[1] * force[0] + tool.moment
        assert found["y"][-1] == pytest.approx(20.0, rel=1e-7)
        assert found["m"][-1] == pytest.approx(-moment, rel=1e-6)
        assert abs(found["tool_turn"][-1]) > 1e-4


def test_a_tool_pressed_by_its_force_slides_as_prescribed(tmp_path):
    """One direction has a force, the other one a motion: at the end the block slides with the coefficient."""
    ways = pd.Table((0.0, 0.5, 1.0), (0.0, 0.0, 1.0)), pd.Table((0.0, 0.5, 1.0), (0.0, 1.0, 1.0))
    tool = disc(force=(None, -20.0), move=(0.1, 0.0), schedule=ways)
    found = pd.run(pressed(tool, 0.2, steps=8), tmp_path).history
    assert found["tool_y"][4:] == pytest.approx([-20.0] * 5, rel=1e-7)
    assert found["tool_x"][-1] == pytest.approx(0.2 * 20.0, rel=0.05)


@pytest.mark.parametrize("gap", [0.1, 1.0, 10.0])
def test_a_small_tool_does_not_pass_through_the_body(gap, tmp_path):
    """The way to the first touch is searched in steps of the distance; friction begins at the touch."""
    ball = pd.RigidSphere((1.0, 1.2 + gap), 0.2, force=(None, -2.0), moment=0.02, about=(1.0, 1.2 + gap))
    found = pd.run(pressed(ball, 0.5, steps=1), tmp_path).history
    assert found["tool_y"][-1] == pytest.approx(-2.0, rel=1e-7)
    assert found["tool_move_y"][-1] == pytest.approx(-gap, abs=0.03)


def test_a_tool_and_a_region_are_unloaded(tmp_path):
    """Where the load ends, forces are round-off, and so is what is left of the load."""
    up_and_down = pd.Table((0.0, 0.5, 1.0), (0.0, 1.0, 0.0))
    region = pd.RigidRegion("+x", force=(0.0, 2.0), moment=0.0, about=(4.0, 0.5), schedule=up_and_down)
    case = strip(region, material=pd.LinearElastic(E, 0.0))
    found = pd.run(case, tmp_path / "region").history
    assert found["y"][2] > 0.1
    assert abs(found["y"][-1]) < 1e-10
    tool = disc(force=(None, -20.0), schedule=up_and_down)
    found = pd.run(pressed(tool, 0.3, steps=4), tmp_path / "tool").history
    assert found["tool_y"] == pytest.approx([0.0, -10.0, -20.0, -10.0, 0.0], abs=1e-6)


@pytest.mark.parametrize(
    ("given", "match"),
    [
        ({"force": (0.0, -5.0)}, "has a force in x, across a mirror plane"),
        ({"force": (None, -5.0), "moment": 0.0, "about": (0.0, 3.0)}, "has a moment, and its image"),
    ],
)
def test_what_the_image_in_a_mirror_does_not_do_is_refused(given, match):
    half = pd.Lattice((0.0, 0.0), (1.0, 1.0), 0.125)
    tool = pd.RigidSphere((0.0, 3.0), 2.0, **given)
    conditions = [pd.Roller("-x"), pd.Clamp("-y"), pd.Contact("+y", tool)]
    with pytest.raises(pd.CaseError, match=match):
        pd.prepare(pressed(tool, particles=half, conditions=conditions, history={}))


def strip(region, nodes=None, steps=4, **changes):
    """Return a strip of 4 x 1 that is clamped at its left side."""
    nodes = pd.LatticeNodes((0.0, 0.0), (4.0, 1.0), 0.25) if nodes is None else nodes
    history = {name: pd.Mean(pd.displacement, name, "+x") for name in "xyz"[: len(nodes.low)]}
    given = {"material": pd.Hencky(E, 0.0), "conditions": [pd.Clamp("-x"), region], "steps": pd.Steps(steps)}
    return pd.Case(nodes, **{**given, "history": history, **changes})


def test_a_moment_bends_a_strip_to_an_arc(tmp_path):
    """Pure bending of a beam of Hencky material without axial force, with stretches e + k y."""
    y, w = np.polynomial.legendre.leggauss(20)
    y, w = 0.5 * y, 0.5 * w

    def resultants(e, k):
        P = E * np.log(e + k * y) / (e + k * y)
        return w @ P, w @ (P * y)

    moment = 0.2 * E / 12.0
    e, k = scipy.optimize.fsolve(lambda ek: np.subtract(resultants(*ek), (0.0, moment)), (1.0, 0.2))
    end = e * np.array([np.sin(4.0 * k), 1.0 - np.cos(4.0 * k)]) / k - (4.0, 0.0)
    region = pd.RigidRegion("+x", force=(0.0, 0.0), moment=moment, about=(4.0, 0.5))
    off = []
    for spacing in (0.25, 0.125):
        nodes = pd.LatticeNodes((0.0, 0.0), (4.0, 1.0), spacing)
        run = pd.run(strip(region, nodes, material=pd.Hencky(E, 0.0, plane="stress")), tmp_path / f"{spacing}")
        off.append(np.abs([run.history[axis][-1] for axis in "xy"] / end - 1.0).max())
    assert off[1] < 0.02
    assert off[1] < 0.35 * off[0]


@pytest.mark.parametrize("kind", ["plane", "space"])
def test_a_region_moves_where_its_loads_are_its_reactions(kind, tmp_path):
    """With large rotations: the motion that was found, prescribed, has the loads as reactions."""
    if kind == "plane":
        nodes, about, force, moment = None, (4.0, 0.5), (3.0, 2.0), 10.0
        names = ["turn"]
    else:
        nodes, about = pd.LatticeNodes((0.0, 0.0, 0.0), (3.0, 1.0, 1.0), 0.5), (3.0, 0.5, 0.5)
        force, moment, names = (3.0, 4.0, -2.0), (40.0, 10.0, -20.0), ["turn_x", "turn_y", "turn_z"]
    region = pd.RigidRegion("+x", force=force, moment=moment, about=about)
    problem = pd.prepare(strip(region, nodes))
    rigid = next(term.rigid for term in problem.problem.terms if term.rigid is not None)
    assert [name.split("_")[0] for name in rigid.numbers()] == ["move"] * len(force) + ["turn"] * len(names)
    found = {}

    class Motion(pd.Quantity):
        def evaluate(self, solution):
            term = next(one for one in solution.problem.terms if one.rigid is not None)
            found.update({name: value(solution.state) for name, value in term.rigid.numbers().items()})
            return 0.0

    pd.run(strip(region, nodes, history={"motion": Motion()}), tmp_path / "loaded")
    turn = [found[name] for name in names]
    assert np.linalg.norm(turn) > 0.3
    again = pd.RigidRegion(
        "+x", move=[found[f"move_{axis}"] for axis in "xyz"[: len(force)]],
        turn=turn[0] if kind == "plane" else turn, about=about,
    )  # fmt: skip
    centre = np.asarray(about) + again.move
    history = {axis: pd.Reaction(axis, "+x") for axis in "xyz"[: len(force)]}
    if kind == "plane":
        history["m"] = pd.ReactionMoment("+x", tuple(centre))
    else:
        history |= {f"m{axis}": pd.ReactionMoment("+x", tuple(centre), axis) for axis in "xyz"}
    reactions = pd.run(strip(again, nodes, history=history), tmp_path / "moved").history
    expected = [*force, *np.ravel(moment)]
    assert [reactions[name][-1] for name in history] == pytest.approx(expected, rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("friction", [0.0, 0.4])
def test_the_stiffness_of_motions_is_the_derivative_of_the_resultants(friction, rng):
    """Of a region and a tool together; the particles respond by their tangent."""
    nodes = pd.LatticeNodes((0.0, 0.0), (2.0, 1.0), 0.25)
    tool = disc(force=(2.0, -20.0), moment=1.0, about=DISC)
    right = pd.RigidRegion("+x", force=(1.0, 2.0), moment=0.5, about=(2.0, 0.5))
    conditions = [pd.Clamp("-x"), right, pd.Contact(pd.region.Box((0.1, 0.9), (1.9, 1.1)), tool, friction)]
    prepared = pd.prepare(pressed(tool, particles=nodes, conditions=conditions, history={}))
    problem, t = prepared.problem, 1.0
    bodies = RigidBodies(problem, 2.0)
    terms = [term for term in problem.terms if term.rigid is not None]
    u = 0.002 * rng.standard_normal((prepared.cloud.n_rows, 2))
    region, contact = (next(one for one in terms if (one.rigid.rows is None) is tool) for tool in (False, True))
    region.rigid.move(np.array([0.01, -0.02, 0.1]))
    contact.rigid.move(np.array([0.003, -0.03, 0.002]))
    contact.version += 1
    free = ~problem.supports.fixed
    ways = 0.1 * rng.standard_normal((6, *u.shape)) * free

    def resultants(step, u):
        order = [term.rigid for term in terms]
        for rigid, by in zip(order, np.split(step, 2), strict=True):
            rigid.move(by)
        contact.version += 1
        state = problem.state(problem.supports.completed(u, problem.supports.prescribed(t)), t)
        sides = [bodies._side(term, term.rigid, state) for term in terms]
        return np.concatenate([side.resultants(side.force) for side in sides])

    state = problem.state(problem.supports.completed(u, problem.supports.prescribed(t)), t)
    answers = iter(ways)
    S, found = bodies._stiffness(
        [bodies._side(term, term.rigid, state) for term in terms], state, lambda force: next(answers)
    )
    kept = [(term.rigid._d.copy(), term.rigid._R.copy()) for term in terms]
    h = 1e-6
    for k in range(6):
        values = []
        for sign in (1.0, -1.0):
            for term, (d, R) in zip(terms, kept, strict=True):
                term.rigid._d[:], term.rigid._R[:] = d, R
            values.append(resultants(sign * h * np.eye(6)[k], u + sign * h * ways[k]))
        column = (values[0] - values[1]) / (2.0 * h)
        np.testing.assert_allclose(S[:, k], column, rtol=1e-6, atol=1e-6 * np.abs(S).max())
        assert np.all(found[k][free] == ways[k][free])


CASE = """
import pdpetsc as pd

def case(unit=1.0, modulus=1000.0):
    force = modulus * unit * 1e-3
    tool = pd.RigidSphere(
        (unit, 3.0 * unit), 2.0 * unit, force=(None, -20.0 * force), moment=3.0 * force * unit, about=(unit, 3.0 * unit)
    )
    side = pd.RigidRegion("+x", force=(force, 0.0), moment=0.2 * force * unit, about=(2.0 * unit, 0.5 * unit))
    names = ("tool_move_x", "tool_move_y")
    return pd.Case(
        particles=pd.LatticeNodes((0.0, 0.0), (2.0 * unit, unit), 0.125 * unit),
        material=pd.Hencky(modulus, 0.3),
        conditions=[pd.Clamp("-y"), pd.Contact("+y", tool, 0.5, name="tool"), side],
        steps=pd.Steps(2),
        history={"right": pd.Mean(pd.displacement, "x", "+x"), "up": pd.Mean(pd.displacement, "y", "+x")},
        results=lambda h: {
            "turn": h["tool_turn"][-1],
            **{name: h[name][-1] / unit for name in ("tool_move_x", "tool_move_y", "right", "up")},
        },
    )
"""


def test_ranks_and_units_change_nothing(tmp_path):
    path = tmp_path / "case.py"
    path.write_text(CASE.replace('pd.Clamp("-y")', "pd.Displacement(pd.region.Slab('y', high=0.01 * unit), x=0, y=0)"))
    text = path.read_text().replace(
        '"+x", force', "pd.region.Box((2.0 * unit, 0.1 * unit), (2.1 * unit, 2 * unit)), force"
    )
    path.write_text(text)
    one = results(path, output=tmp_path / "one")["results"]
    assert abs(one["turn"]) > 1e-4
    runs = {
        "two": ([], 2),
        "three": ([], 3),
        "free": (["-pd_jacobian", "matfree"], 1),
        "small": (["unit=1e-9", "modulus=1e6"], 1),
        "large": (["unit=1e6", "modulus=1e-9"], 1),
    }
    for name, (words, ranks) in runs.items():
        other = results(path, *words, ranks=ranks, output=tmp_path / name)["results"]
        assert other == pytest.approx(one, rel=2e-6, abs=1e-10)


def test_a_run_with_loaded_bodies_is_resumed(tmp_path):
    tool = disc(force=(None, -20.0), moment=3.0, about=DISC)
    side = pd.RigidRegion(pd.region.Box((1.99, 0.1), (2.1, 2.0)), force=(1.0, 0.0), moment=0.2, about=(2.0, 0.5))
    conditions = [
        pd.Displacement(pd.region.Slab("y", high=0.01), x=0.0, y=0.0),
        side,
        pd.Contact("+y", tool, 0.5, name="tool"),
    ]
    whole = pd.run(pressed(tool, conditions=conditions, steps=4), tmp_path / "whole").history

    class Stopping(pd.Quantity):
        def evaluate(self, solution):
            if solution.t > 0.6:
                raise pd.SolveError("It stops here.")
            return 0.0

    case = pressed(tool, conditions=conditions, steps=4)
    with pytest.raises(pd.SolveError):
        pd.run(
            pressed(tool, conditions=conditions, steps=4, history={**case.history, "stop": Stopping()}),
            tmp_path / "half",
        )
    again = pd.run(case, tmp_path / "again", restart=tmp_path / "half").history
    for name in ("tool_move_x", "tool_move_y", "tool_turn", "x", "y"):
        assert again[name][-1] == pytest.approx(whole[name][-1], rel=1e-12)


@pytest.mark.parametrize("share", [0.9, 1.1])
def test_a_column_under_a_free_end_is_unstable_above_its_load(share, tmp_path):
    """A rigid cap that may move sideways and turn: Euler's load of a column with a free end."""
    nodes = pd.LatticeNodes((0.0, 0.0), (10.0, 1.0), 0.25)
    euler = np.pi**2 * E / 12.0 / (4.0 * 10.0**2)
    cap = pd.RigidRegion("+x", force=(-share * euler, 0.0), moment=0.0, about=(10.0, 0.5))
    case = strip(cap, nodes, steps=1, material=pd.Hencky(E, 0.0, plane="stress"))
    pd.run(case, tmp_path)
    (step,) = json.loads((tmp_path / "summary.json").read_text())["steps"]
    assert step["negative_pivots"] == (share > 1.0)


def test_a_thin_strip_that_a_moment_rolls_up_is_stable(tmp_path):
    """Its angle grows in proportion to the moment. The last tangent of a step is from before the region moved."""
    length, height = 20.0, 0.25
    moment = 2.0 * np.pi / length * E * height**3 / 12.0
    nodes = pd.LatticeNodes((0.0, -0.5 * height), (length, 0.5 * height), height / 3)
    end = pd.RigidRegion("+x", force=(0.0, 0.0), moment=moment, about=(length, 0.0))
    pd.run(strip(end, nodes, steps=10, material=pd.Hencky(E, 0.0, plane="stress")), tmp_path)
    steps = json.loads((tmp_path / "summary.json").read_text())["steps"]
    assert [step["negative_pivots"] for step in steps] == [0] * 10


def test_what_has_no_equilibrium_is_refused(tmp_path):
    with pytest.raises(pd.SolveError, match="touches nothing that carries its load"):
        pd.run(pressed(disc(force=(None, 20.0)), steps=1), tmp_path / "away")
    with pytest.raises(pd.SolveError, match=r"nothing holds the tool|touches nothing"):
        pd.run(pressed(disc(force=(1.0, -20.0)), steps=1), tmp_path / "off")


@pytest.mark.parametrize(
    ("given", "match"),
    [
        ({"force": (0.0, -1.0), "move": (0.0, -1.0)}, "has a motion and a force in y"),
        ({"moment": 1.0, "turn": 1.0, "about": DISC}, "has a turn and a moment"),
        ({"moment": 1.0}, "turns about a point of 2 numbers, not 0"),
        ({"moment": (1.0, 0.0, 0.0), "about": DISC}, "is turned by 3 numbers in 2 dimensions; give a moment"),
        ({"force": (0.0, 0.0), "inertia": 1.0}, "has inertia without moment"),
        ({"moment": 0.0, "about": DISC, "mass": 1.0}, "has mass without force"),
        ({"force": (1.0,)}, "is pushed by 1 numbers in 2 dimensions"),
        ({"force": (1.0, 0.0), "schedule": (pd.Ramp(),)}, "has 1 schedules; give one for all, or 2"),
    ],
)
def test_loads_that_conflict_are_refused(given, match):
    with pytest.raises(pd.CaseError, match=match):
        pd.prepare(pressed(disc(**given)))


def test_a_body_that_fails_is_bent_by_a_moment(tmp_path):
    """Points fail while the moment rises: the angle that was found, prescribed, needs the same moment."""
    nodes = pd.LatticeNodes((0.0, 0.0), (4.0, 1.0), 0.125)
    law = pd.PointDamage(pd.softening.Linear(), Gc=2.0, strength=20.0)
    given = {"material": pd.LinearElastic(E, 0.0, plane="stress"), "damage": law, "steps": 8}
    found = {}

    class Turn(pd.Quantity):
        def evaluate(self, solution):
            term = next(one for one in solution.problem.terms if one.rigid is not None)
            found[solution.t] = term.rigid.numbers()["turn"](solution.state)
            return found[solution.t]

    about = (4.0, 0.5)
    region = pd.RigidRegion("+x", force=(0.0, None), moment=4.5, about=about)
    history = {"turn": Turn(), "lost": pd.DissipatedEnergy()}
    loaded = pd.run(strip(region, nodes, history=history, **given), tmp_path / "loaded").history
    assert loaded["lost"][-1] > 1e-4
    table = pd.Table(list(found), [angle / found[1.0] for angle in found.values()])
    history = {"m": pd.ReactionMoment("+x", about), "lost": pd.DissipatedEnergy()}
    prescribed = pd.RigidRegion("+x", turn=found[1.0], about=about, schedule=table)
    moved = pd.run(strip(prescribed, nodes, history=history, **given), tmp_path / "moved").history
    assert moved["m"][-1] == pytest.approx(4.5, rel=0.02)


@pytest.mark.parametrize("kind", ["plane", "space", "pushed in one direction"])
def test_a_path_meets_the_equilibria_of_load_steps(kind, tmp_path):
    """With large rotations; Newton's method of displacements, load factor and motions converges quadratically."""
    nodes, about, loads = None, (4.0, 0.5), {"force": (3.0, 2.0), "moment": 10.0}
    if kind == "space":
        nodes, about = pd.LatticeNodes((0.0, 0.0, 0.0), (3.0, 1.0, 1.0), 0.5), (3.0, 0.5, 0.5)
        loads = {"force": (3.0, 4.0, -2.0), "moment": (40.0, 10.0, -20.0)}
    elif kind != "plane":
        loads = {"force": (None, 2.0), "move": (0.1, 0.0), "moment": 10.0}
    region = pd.RigidRegion("+x", **loads, about=about)
    far = pd.region.Slab("x", low=about[0] - 0.01)
    solver = pd.PathFollowing(pd.Opening("y", far, step=0.1, end=0.4))
    path = pd.run(strip(region, nodes, solver=solver), tmp_path / "path")
    summary = json.loads((tmp_path / "path" / "summary.json").read_text())
    assert all(step["newton_iterations"] <= 5 for step in summary["steps"])
    assert all(step["norms"][-1] < 1e-3 * step["norms"][-2] for step in summary["steps"][1:])
    load = path.history["t"][-1]
    there = {name: np.multiply([one or 0.0 for one in np.ravel(given)], load) for name, given in loads.items()}
    there["force"] = [None if one is None else value for one, value in zip(loads["force"], there["force"], strict=True)]
    steps = pd.run(strip(pd.RigidRegion("+x", **there, about=about), nodes), tmp_path / "steps")
    for axis in "xyz"[: len(about)]:
        assert path.history[axis][-1] == pytest.approx(steps.history[axis][-1], rel=1e-7)


@pytest.mark.parametrize(("friction", "follows"), [(0.0, False), (0.4, False), (0.4, True)])
def test_the_bordered_tangent_is_the_derivative_of_the_residual(friction, follows, rng):
    """Of displacements, load factor and the motions of a region in space that has turned far in its step."""
    nodes = pd.LatticeNodes((0.0, 0.0, 0.0), (2.0, 1.0, 1.0), 0.5)
    force = (3.0, 1.0, -2.0) if follows else (3.0, None, -2.0)
    region = pd.RigidRegion("+x", force=force, moment=(4.0, 1.0, -2.0), about=(2.0, 0.5, 0.5), follows=follows)
    block = pd.RigidPlane((0.0, 0.0, 1.0), (0.0, 0.0, -1.0))
    weight = pd.BodyForce(pd.region.All(), x=0.3, z=-0.4)
    conditions = [pd.Clamp("-x"), region, pd.Contact("+z", block, friction), weight]
    solver = pd.PathFollowing(pd.Opening("y", pd.region.Slab("x", low=1.4), step=0.1, end=0.4))
    case = strip(region, nodes, conditions=conditions, solver=solver, history={})
    prepared = pd.prepare(case)
    path = PathSolver(prepared.problem, Assembler(prepared.problem), solver, lambda: False)
    u = 0.02 * rng.standard_normal((prepared.cloud.n_rows, 3))
    path._aim(np.zeros_like(u), 1.0)
    path._impose(0.0)
    path._equilibrium.begin(np.zeros_like(u))
    path._force = 1.0
    x = np.concatenate(
        [u.ravel() / path._scales.length, [0.3], [0.1, *([0.2] if follows else []), -0.1, 0.7, 0.4, -0.9]]
    )
    lengths = slice(len(x) - 5 - follows, None)
    x[lengths] /= path._scales.length

    def residual(values):
        path._x.array = values
        r = path._r.duplicate()
        path._residual(path.snes, path._x, r)
        return r.array_r.copy()

    path._x.array = x
    path._jacobian(path.snes, path._x, path._bordered.mat, path._bordered.mat)
    for _ in range(3):
        along = rng.standard_normal(len(x))
        along[lengths] /= path._scales.length
        step, product = path._x.duplicate(), path._x.duplicate()
        step.array = along
        path._bordered.mat.mult(step, product)
        h = 1e-6
        differences = (residual(x + h * along) - residual(x - h * along)) / (2.0 * h)
        np.testing.assert_allclose(product.array_r, differences, rtol=1e-6, atol=1e-6 * np.abs(differences).max())
    path.destroy()


def failing(region, **changes):
    """Return a strip whose points fail, except near the clamped end."""
    nodes = pd.LatticeNodes((0.0, 0.0), (4.0, 1.0), 0.125)
    law = pd.PointDamage(pd.softening.Linear(), Gc=0.3, strength=10.0, protected=pd.region.Slab("x", high=1.0))
    given = {"material": pd.LinearElastic(E, 0.0, plane="stress"), "damage": law}
    return strip(region, nodes, **{**given, **changes})


def test_a_path_bends_a_body_by_a_moment_until_it_is_apart(tmp_path):
    """The moment falls, which load steps do not follow. The angles that were found, prescribed, need the moments."""
    about = (4.0, 0.5)

    class Turn(pd.Quantity):
        def evaluate(self, solution):
            term = next(one for one in solution.problem.terms if one.rigid is not None)
            return term.rigid.numbers()["turn"](solution.state)

    upper, lower = (pd.region.Box((3.9, y - 0.1), (4.1, y + 0.1)) for y in (0.0, 1.0))
    solver = pd.PathFollowing(pd.Opening("x", upper, against=lower, step=0.02, end=0.2))
    region = pd.RigidRegion("+x", force=(0.0, 0.0), moment=3.0, about=about)
    history = {"turn": Turn(), "m": pd.ReactionMoment("+x", about), "lost": pd.DissipatedEnergy()}
    path = pd.run(failing(region, solver=solver, history=history), tmp_path / "path").history
    moment = np.array(path["t"]) * 3.0
    np.testing.assert_allclose(path["m"], moment, rtol=1e-8, atol=1e-8)
    peak = int(np.argmax(moment))
    assert moment[-1] < moment[peak]
    assert path["lost"][-1] > 2.0 * path["lost"][peak]
    summary = json.loads((tmp_path / "path" / "summary.json").read_text())
    pivots = [step["negative_pivots"] for step in summary["steps"]]
    assert not any(pivots[: peak - 1])
    assert pivots[peak + 1] == 1


def on_path(*conditions, measure=None, **changes):
    """Return a strip with a region at its end and these conditions, along a path."""
    measure = pd.Opening("y", pd.region.Slab("x", low=3.99), step=0.05, end=0.2) if measure is None else measure
    return strip(None, conditions=list(conditions), solver=pd.PathFollowing(measure), **changes)


@pytest.mark.parametrize("load", ["both", "particles"])
def test_a_path_counts_loads_on_the_particles_of_a_region(load, tmp_path):
    """Newton's method converges quadratically, also if the region has no other load."""
    far = pd.region.Slab("x", low=2.9)
    region = pd.RigidRegion(far, force=(0.0, 1.0 if load == "both" else 0.0), moment=0.0, about=(3.5, 0.5))
    weight = pd.BodyForce(pd.region.All() if load == "both" else far, y=0.5)
    path = pd.run(on_path(pd.Clamp("-x"), region, weight), tmp_path / "path")
    steps = json.loads((tmp_path / "path" / "summary.json").read_text())["steps"]
    assert all(step["newton_iterations"] <= 5 for step in steps)
    t = path.history["t"][-1]
    alone = dataclasses.replace(region, force=(0.0, t * region.force[1]))
    pushed = dataclasses.replace(weight, y=0.5 * t)
    other = pd.run(strip(None, conditions=[pd.Clamp("-x"), alone, pushed]), tmp_path / "steps")
    assert path.history["y"][-1] == pytest.approx(other.history["y"][-1], rel=1e-7)


def test_motions_since_the_start_of_a_step_are_zero_when_it_has_ended():
    """Sweeps return to them before the next step has begun."""
    region = pd.RigidRegion("+x", force=(0.0, 1.0), moment=0.0, about=(4.0, 0.5))
    rigid = pd.prepare(strip(region)).problem.rigid_bodies[0][1]
    way = np.array([0.1, -0.2, 0.3])
    rigid.start_from(0.0, 0.5)
    rigid.place(way)
    np.testing.assert_allclose(rigid.placed, way, rtol=1e-12)
    rigid.commit()
    assert not rigid.placed.any()
    rigid.start_from(0.5, 1.0)
    assert not rigid.placed.any()
    rigid.place(way)
    np.testing.assert_allclose(rigid.motion(1.0)[1], 2.0 * way[:2], rtol=1e-12)


def test_a_region_that_nothing_holds_is_refused_along_paths_and_by_modes(tmp_path):
    sliding = [pd.Displacement(pd.region.Slab("x", high=0.01), x=0.0)]
    region = pd.RigidRegion("+x", force=(0.0, 1.0), moment=0.0, about=(4.0, 0.5))
    with pytest.raises(pd.SolveError, match="No force resists a motion of a rigid region"):
        pd.run(on_path(*sliding, region), tmp_path / "path")
    free = dataclasses.replace(region, force=(0.0, 0.0))
    heavy = pd.NeoHookean(E, 0.0, plane="stress", density=1.0)
    case = strip(None, conditions=[*sliding, free], material=heavy, modes=pd.Modes(2), steps=1)
    with pytest.raises(pd.SolveError, match="No force resists a motion of a rigid region"):
        pd.run(case, tmp_path / "modes")
    corner = pd.RigidRegion(pd.region.Nearest((4.0, 0.0)), force=(0.0, 1.0), moment=1.0, about=(4.0, 0.0))
    with pytest.raises(pd.SolveError, match="path is lost"):
        pd.run(on_path(pd.Clamp("-x"), corner), tmp_path / "corner")


def test_a_region_of_one_particle_has_the_path_of_a_force(tmp_path):
    """Nothing resists its rotation, which moves no particle."""
    one = pd.region.Nearest((4.0, 0.0))
    corner = pd.RigidRegion(one, force=(0.0, 1.0), moment=0.0, about=(4.0, 0.0))
    found = [
        pd.run(on_path(pd.Clamp("-x"), load), tmp_path / name).history
        for name, load in (("region", corner), ("force", pd.Force(one, y=1.0)))
    ]
    for name in ("t", "x", "y"):
        assert found[0][name][-1] == pytest.approx(found[1][name][-1], rel=1e-7)


def test_a_loaded_tool_has_one_contact():
    tool = disc(force=(None, -20.0))
    contacts = [pd.Contact(side, tool, name=side) for side in ("+y", "+x")]
    with pytest.raises(pd.CaseError, match="has the loaded tool of another Contact"):
        pd.prepare(pressed(tool, conditions=[pd.Clamp("-y"), *contacts]))


def test_solvers_that_do_not_move_tools_refuse_loads(tmp_path):
    tool = disc(force=(None, -20.0))
    heavy = disc(force=(None, -20.0), mass=1.0)
    material = pd.Hencky(E, 0.3, density=1.0)
    solvers = {
        "moves": [pd.Explicit(end=1.0), pd.Implicit(dt=0.1, end=1.0)],
        "finds": [pd.DynamicRelaxation(), pd.SnapThrough(dt=0.1, end=1.0)],
    }
    for kind, some in solvers.items():
        for solver in some:
            steps = pd.Steps() if kind == "moves" else pd.Steps(2)
            match = "has a load and no mass" if kind == "moves" else r"has a load, and .* does not find its motion"
            with pytest.raises(pd.CaseError, match=match):
                pd.run(pressed(tool, material=material, solver=solver, steps=steps), tmp_path)
    with pytest.raises(pd.CaseError, match="has a load, and preload holds it"):
        pd.run(pressed(heavy, material=material, solver=pd.Explicit(end=1.0, preload=True), steps=pd.Steps()), tmp_path)
    with pytest.raises(pd.CaseError, match="has a mass and does not move in time"):
        pd.run(pressed(heavy), tmp_path)
    with pytest.raises(pd.CaseError, match="has a velocity in a direction without force"):
        pd.prepare(pressed(disc(force=(None, 0.0), velocity=(1.0, 0.0), mass=1.0)))
    with pytest.raises(pd.CaseError, match="hold tools where they are"):
        pd.run(pressed(tool, modes=pd.Modes(2)), tmp_path)


SOLVERS = {"explicit": pd.Explicit(end=0.5, records=10), "implicit": pd.Implicit(dt=0.01, end=0.5, radius=1.0)}


@pytest.mark.parametrize("solver", ["explicit", "implicit"])
def test_a_tool_that_touches_nothing_flies(solver, tmp_path):
    """Both integrators are exact for a constant force and moment."""
    loads = {"force": (1.0, -4.0), "moment": 3.0, "about": DISC, "schedule": pd.Hold()}
    tool = disc(gap=5.0, **loads, mass=2.0, inertia=0.5, velocity=(0.3, 1.0))
    material = pd.LinearElastic(E, 0.0, density=1.0)
    case = pressed(tool, material=material, solver=SOLVERS[solver], steps=pd.Steps(), history={})
    found = pd.run(case, tmp_path).history
    t = found["time"]
    assert len(t) > 5
    assert found["tool_move_x"] == pytest.approx(0.3 * t + 0.25 * t**2, abs=1e-12)
    assert found["tool_move_y"] == pytest.approx(t - t**2, abs=1e-12)
    assert found["tool_turn"] == pytest.approx(3.0 * t**2, abs=1e-12)
    assert found["tool_spin"] == pytest.approx(6.0 * t, abs=1e-11)
    assert found["tool_velocity_y"] == pytest.approx(1.0 - 2.0 * t, abs=1e-12)


@pytest.mark.parametrize("solver", ["explicit", "implicit"])
def test_a_mass_that_hits_a_bar_is_stopped_by_its_wave(solver, tmp_path):
    """Saint-Venant: the wave takes the impulse rho c v of the end, and the velocity decays as exp(-rho c A t / m)."""
    density, mass, v, length = 4.0, 20.0, 0.02, 5.0
    wave = np.sqrt(E / density)
    end = 0.9 * 2.0 * length / wave
    hammer = pd.RigidPlane((length, 0.5), (-1.0, 0.0), force=(0.0, None), mass=mass, velocity=(-v, 0.0))
    solvers = {"explicit": pd.Explicit(end=end, records=40, safety=0.3), "implicit": pd.Implicit(dt=end / 160, end=end)}
    case = pd.Case(
        pd.LatticeNodes((0.0, 0.0), (length, 1.0), 0.125),
        material=pd.LinearElastic(E, 0.0, density=density),
        conditions=[pd.Clamp("-x"), pd.Contact("+x", hammer, name="tool")],
        solver=solvers[solver],
        history={
            "kinetic": pd.KineticEnergy(), "strain": pd.StrainEnergy(), "work": pd.ExternalWork(),
            "error": pd.EnergyError(),
        },
    )  # fmt: skip
    found = pd.run(case, tmp_path).history
    expected = -v * np.exp(-density * wave * found["time"] / mass)
    assert expected[-1] > -0.6 * v
    np.testing.assert_allclose(found["tool_velocity_x"][2:], expected[2:], atol=0.03 * v)
    # What the tool loses, the body has.
    begun = 0.5 * mass * v**2
    lost = begun - 0.5 * mass * found["tool_velocity_x"][-1] ** 2
    assert found["kinetic"][0] == pytest.approx(begun, rel=1e-12)
    assert found["kinetic"][-1] + found["strain"][-1] == pytest.approx(begun, abs=0.01 * lost)
    assert np.abs(found["work"]).max() < 1e-12 * begun
    assert np.abs(found["error"]).max() < 0.01


MOVING = (
    STOPPING
    + """
def case(solver="explicit"):
    disc = pd.RigidSphere(
        (1.0, 3.02), 2.0, force=(0.5, -1.0), moment=2.0, about=(1.0, 3.02), mass=3.0, inertia=4.0, velocity=(0.2, -0.8)
    )
    solvers = {"explicit": pd.Explicit(end=0.2, records=8), "implicit": pd.Implicit(dt=0.01, end=0.2)}
    return pd.Case(
        particles=pd.LatticeNodes((0.0, 0.0), (2.0, 1.0), 0.125),
        material=pd.Hencky(1000.0, 0.3, density=2.0),
        conditions=[pd.Clamp("-y"), pd.Contact("+y", disc, 0.3, penetration=0.1, name="tool")],
        solver=solvers[solver],
        history={"stop": Stopping()},
        results=lambda h: {name: h[f"tool_{name}"][-1] for name in ("velocity_x", "velocity_y", "spin", "turn")},
    )
"""
)


@pytest.mark.parametrize("solver", ["explicit", "implicit"])
def test_a_striker_is_the_same_on_ranks_and_after_a_restart(solver, tmp_path):
    path = tmp_path / "case.py"
    path.write_text(MOVING)
    one = results(path, f"solver={solver}", output=tmp_path / "one")["results"]
    assert one["velocity_y"] > 0.1  # it has bounced
    assert abs(one["spin"]) > 0.01
    two = results(path, f"solver={solver}", ranks=2, output=tmp_path / "two")["results"]
    assert two == pytest.approx(one, rel=1e-6)
    again = stopped_and_continued(MOVING, solver, output=tmp_path)
    assert {name: again[name] for name in one} == pytest.approx(one, rel=1e-12)


@pytest.mark.parametrize(
    ("law", "turn", "warns"),
    [(pd.LinearElastic, 0.03, True), (pd.LinearElastic, 0.005, False), (pd.Hencky, 0.03, False)],
)
def test_a_region_that_turns_in_a_body_of_small_strain_gives_a_warning(law, turn, warns, tmp_path):
    """The moment of the region is 7 % too large at 0.03 rad."""
    half = pd.region.Slab("x", low=1.0 - 1e-9)
    case = pd.Case(
        particles=pd.LatticeNodes((0.0, 0.0), (2.0, 0.5), 0.125),
        material=law(E=100.0, nu=0.0),
        conditions=[pd.Clamp("-x"), pd.RigidRegion(half, turn=turn, about=(1.0, 0.25))],
    )
    said = pd.run(case, tmp_path).summary["warnings"]
    assert any("resists rotations" in warning for warning in said) == warns
