"""Forces and moments on rigid bodies that turn with them."""

import json

import numpy as np
import pytest
import scipy
from scipy.spatial.transform import Rotation

import pdpetsc as pd
from tests.commands import STOPPING, results, stopped_and_continued
from tests.commands import history as columns
from tests.terms.test_rigid_bodies import disc, pressed, strip
from tests.terms.test_rigid_motion import ALL, J, balanced_error, flying, history_of, solver_of

ABOUT = {2: (4.0, 0.5), 3: (3.0, 0.5, 0.5)}
FORCE = {2: (3.0, 8.0), 3: (3.0, 14.0, -8.0)}
MOMENT = {2: 10.0, 3: (40.0, 10.0, -20.0)}
TURN = {2: 1.3, 3: (0.4, -0.9, 0.8)}


def nodes(dim):
    return None if dim == 2 else pd.LatticeNodes((0.0, 0.0, 0.0), (3.0, 1.0, 1.0), 0.5)


def follower(dim, **changes):
    given = {"force": FORCE[dim], "moment": MOMENT[dim], "about": ABOUT[dim], "follows": True}
    return pd.RigidRegion("+x", **{**given, **changes})


def rotation(turn):
    """Return the matrix of a rotation vector, or of an angle."""
    vector = np.ravel(turn)
    whole = Rotation.from_rotvec(vector if len(vector) == 3 else (0.0, 0.0, vector[0])).as_matrix()
    return whole if len(vector) == 3 else whole[:2, :2]


class Motion(pd.Quantity):
    """Notes the displacement and the rotation of the first loaded body."""

    def evaluate(self, solution):
        _, rigid = solution.problem.rigid_bodies[0]
        self.R, self.d = (one.copy() for one in rigid.motion(solution.t))
        return 0.0


@pytest.mark.parametrize("follows", [True, False])
@pytest.mark.parametrize("dim", [2, 3])
def test_the_stiffness_of_a_load_is_its_derivative_by_the_motion(dim, follows):
    """Also about a centre of mass beside the point of the load."""
    case = strip(follower(dim, follows=follows), nodes(dim))
    _, rigid = pd.prepare(case).problem.rigid_bodies[0]
    rigid._arm = np.array([0.3, -0.2, 0.1 * (dim == 3)])
    rigid.start_from(0.0, 1.0)
    n, h = len(rigid.free), 1e-6
    begun = np.concatenate([np.full(dim, 0.2), np.ravel(TURN[dim])])
    columns = []
    for step in h * np.eye(n):
        found = []
        for sign in (1.0, -1.0):
            rigid.place(begun)
            rigid.move(sign * step)
            found.append(rigid.load(1.0))
        columns.append((found[0] - found[1]) / (2.0 * h))
    rigid.place(begun)
    S = rigid.load_stiffness(1.0)
    assert np.abs(S).max() > 1.0
    np.testing.assert_allclose(S, np.stack(columns, axis=1), atol=1e-7 * np.abs(S).max())


@pytest.mark.parametrize("dim", [2, 3])
def test_a_region_moves_where_its_turned_loads_are_its_reactions(dim, tmp_path):
    """With large rotations: the motion that was found, prescribed, needs the load turned by it."""
    motion = Motion()
    pd.run(strip(follower(dim), nodes(dim), history={"motion": motion}), tmp_path / "loaded")
    turn = Rotation.from_matrix(motion.R).as_rotvec() if dim == 3 else np.arctan2(motion.R[1, 0], motion.R[0, 0])
    assert np.linalg.norm(turn) > 0.4
    again = pd.RigidRegion("+x", move=tuple(motion.d), turn=np.ravel(turn).tolist(), about=ABOUT[dim])
    centre = tuple(np.asarray(ABOUT[dim]) + motion.d)
    history = {axis: pd.Reaction(axis, "+x") for axis in "xyz"[:dim]}
    if dim == 2:
        history["m"] = pd.ReactionMoment("+x", centre)
    else:
        history |= {f"m{axis}": pd.ReactionMoment("+x", centre, axis) for axis in "xyz"}
    found = pd.run(strip(again, nodes(dim), history=history), tmp_path / "moved").history
    moment = motion.R @ MOMENT[3] if dim == 3 else [MOMENT[2]]
    expected = [*(motion.R @ FORCE[dim]), *moment]
    assert [found[name][-1] for name in history] == pytest.approx(expected, rel=1e-6, abs=1e-6)


def test_a_tool_that_rolls_presses_in_the_direction_of_its_own_axes(tmp_path):
    tool = disc(force=(0.5, -20.0), moment=3.0, about=(1.0, 3.0), follows=True)
    found = pd.run(pressed(tool, 0.5), tmp_path).history
    turn = found["tool_turn"][-1]
    assert abs(turn) > 1e-3
    expected = rotation(turn) @ tool.force
    assert [found["tool_x"][-1], found["tool_y"][-1]] == pytest.approx(expected, rel=1e-7)


@pytest.mark.parametrize("dim", [2, 3])
def test_a_force_on_a_region_with_a_prescribed_rotation_turns_with_it(dim, tmp_path):
    """It is a dead force with schedules that contain the rotation."""
    turn, size = np.array(TURN[dim]), np.array(FORCE[dim])
    turning = {"turn": TURN[dim], "about": ABOUT[dim]}
    follows = pd.RigidRegion("+x", force=FORCE[dim], follows=True, **turning)
    factors = [lambda t, axis=axis: float(t * (rotation(t * turn) @ size)[axis]) for axis in range(dim)]
    dead = pd.RigidRegion("+x", force=(1.0,) * dim, schedule=(*factors, pd.Ramp()), **turning)
    one, other = (
        pd.run(strip(load, nodes(dim)), tmp_path / name).history
        for name, load in (("follows", follows), ("dead", dead))
    )
    assert abs(one["y"][-1]) > 0.1
    for axis in "xyz"[:dim]:
        assert one[axis] == pytest.approx(other[axis], rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("dim", [2, 3])
def test_a_scene_that_turns_as_a_whole_moves_the_same_in_its_axes(dim, tmp_path):
    """The clamp turns by a prescribed rotation, and with it everything else."""
    motions = Motion(), Motion()
    for motion, turn in zip(motions, (TURN[dim], np.multiply(TURN[dim], 0.0).tolist()), strict=True):
        held = pd.RigidRegion("-x", turn=turn, about=(0.0,) * dim)
        case = strip(None, nodes(dim), conditions=[held, follower(dim)], history={"motion": motion}, steps=8)
        pd.run(case, tmp_path / str(turn == TURN[dim]))
    Q, (turned, still) = rotation(TURN[dim]), motions
    np.testing.assert_allclose(turned.R, Q @ still.R, atol=1e-6)
    np.testing.assert_allclose(np.add(ABOUT[dim], turned.d), Q @ np.add(ABOUT[dim], still.d), atol=1e-6)


@pytest.mark.parametrize("dim", [2, 3])
def test_a_path_meets_the_equilibria_of_load_steps(dim, tmp_path):
    """Newton's method of displacements, load factor and motions converges quadratically."""
    far = pd.region.Slab("x", low=ABOUT[dim][0] - 0.01)
    solver = pd.PathFollowing(pd.Opening("y", far, step=0.2, end=0.8))
    path = pd.run(strip(follower(dim), nodes(dim), solver=solver), tmp_path / "path").history
    steps = json.loads((tmp_path / "path" / "summary.json").read_text())["steps"]
    assert all(step["newton_iterations"] <= 6 for step in steps[1:])
    assert all(step["norms"][-1] < 1e-3 * step["norms"][-2] for step in steps[1:])
    t = path["t"][-1]
    there = follower(dim, force=tuple(np.multiply(FORCE[dim], t)), moment=np.multiply(MOMENT[dim], t).tolist())
    found = pd.run(strip(there, nodes(dim)), tmp_path / "steps").history
    for axis in "xyz"[:dim]:
        assert path[axis][-1] == pytest.approx(found[axis][-1], rel=1e-7)


@pytest.mark.parametrize("n", [8, pytest.param(16, marks=pytest.mark.long)])
def test_a_cantilever_under_a_force_across_its_end_is_the_elastica(n, tmp_path):
    """Rotations up to 171 degrees; with 16 cells the linear solver is iterative."""
    found = results("runs/stability/follower.py", f"n={n}", "--check", output=tmp_path)["results"]
    assert found["turn"] > 2.9
    assert found["error"] < 0.005


@pytest.mark.parametrize("load", [19, 24])
def test_vibrations_of_a_column_grow_beyond_the_load_of_beck(load, tmp_path):
    """The critical load is 20.05 E I / L^2."""
    found = results("runs/stability/beck.py", f"load={load}", "--check", output=tmp_path)["results"]
    assert found["growth"] < 1.1 if load < 20 else found["growth"] > 50.0
    assert np.abs(columns(tmp_path)["error"]).max() < 1e-4


@pytest.mark.parametrize(("follows", "pivots"), [(True, None), (False, 1)])
def test_a_column_under_a_force_along_its_end_does_not_buckle(follows, pivots, tmp_path):
    """Eight times the load of Euler: no neighbouring equilibrium (Beck 1952), so that nothing is reported unstable."""
    mesh = pd.LatticeNodes((0.0, 0.0), (10.0, 1.0), 0.25)
    euler = np.pi**2 * 1000.0 / 12.0 / (4.0 * 10.0**2)
    cap = pd.RigidRegion("+x", force=(-8.0 * euler, 0.0), moment=0.0, about=(10.0, 0.5), follows=follows)
    pd.run(strip(cap, mesh, steps=8, material=pd.Hencky(1000.0, 0.0, plane="stress")), tmp_path)
    steps = json.loads((tmp_path / "summary.json").read_text())["steps"]
    found = [step["negative_pivots"] for step in steps]
    assert found[0] == 0
    assert found[-1] == pivots


@pytest.mark.parametrize("kind", ["explicit", "implicit"])
def test_a_free_body_with_a_thrust_beside_its_centre_spirals(kind, tmp_path):
    """The moment about the centre of mass is constant, and the velocity an integral of Fresnel; energy balances."""
    mesh, at, thrust = pd.LatticeNodes((0.0, 0.0), (2.0, 0.5), 0.25), np.array([0.0, 0.25]), np.array([1.0, 3.0])
    given = {"about": tuple(at), "force": tuple(thrust), "schedule": pd.Hold(), "follows": True}
    history = {"kinetic": pd.KineticEnergy(), "work": pd.ExternalWork(), "error": pd.EnergyError()}
    off, end = [], 2.0
    for n in (25, 50):
        case = flying(kind, n, ALL, mesh, [], end=end, given=given, history=history)
        cloud = pd.prepare(case).cloud
        mass, centre = 2.0 * cloud.volume, np.array([1.0, 0.25])
        arm = at - centre
        rate = (arm[0] * thrust[1] - arm[1] * thrust[0]) / (mass * ((cloud.x - centre) ** 2).sum(axis=1)).sum()

        def slopes(t, y, rate=rate, mass=mass):
            return [*y[2:], *(rotation(0.5 * rate * t**2) @ thrust / mass.sum())]

        run = pd.run(case, tmp_path / f"{n}")
        moved = scipy.integrate.solve_ivp(slopes, (0.0, end), np.zeros(4), "DOP853", rtol=1e-10, atol=1e-10).y[:2, -1]
        assert abs(0.5 * rate * end**2) > 2.0
        arms = run.x[:, :2] - centre
        expected = arms @ rotation(0.5 * rate * end**2).T - arms + moved
        off.append(balanced_error(run, expected))
    assert off[1] < 0.02
    assert off[0] / off[1] == pytest.approx(4.0, rel=0.25)


@pytest.mark.parametrize("kind", ["explicit", "implicit"])
def test_a_tool_with_a_moment_in_its_own_axes_turns_by_the_equations_of_euler(kind, tmp_path):
    """``J W' + W x J W = T`` and ``M v' = R F`` with constant T and F in the axes of the tool."""
    about, torque, thrust, end = (0.5, 0.5, 5.0), np.array([1.0, -0.5, 2.0]), np.array([0.5, 1.0, -0.3]), 2.0
    tool = pd.RigidSphere(
        about, 1.0, force=tuple(thrust), moment=tuple(torque), about=about, mass=3.0, inertia=tuple(J),
        spin=(0.5, 0.2, 0.1), schedule=pd.Hold(), follows=True,
    )  # fmt: skip

    def slopes(t, y):
        R, W, v = y[:9].reshape(3, 3), y[9:12], y[12:15]
        spin = np.array([[0.0, -W[2], W[1]], [W[2], 0.0, -W[0]], [-W[1], W[0], 0.0]])
        return [*(R @ spin).ravel(), *((torque - np.cross(W, J * W)) / J), *(R @ thrust / 3.0), *v]

    start = [*np.eye(3).ravel(), 0.5, 0.2, 0.1, *np.zeros(6)]
    exact = scipy.integrate.solve_ivp(slopes, (0.0, end), start, "DOP853", rtol=1e-11, atol=1e-11).y[:, -1]
    off = []
    for n in (40, 80):
        case = pd.Case(
            pd.LatticeNodes((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), 0.5),
            material=pd.LinearElastic(1.0, 0.0, density=1e6),
            conditions=[pd.Clamp("-z"), pd.Contact("+z", tool, name="tool")],
            solver=solver_of(kind, end, n, **({"radius": 1.0} if kind == "implicit" else {})),
            history={"error": pd.EnergyError()},
        )
        found = pd.run(case, tmp_path / f"{n}").history
        R = Rotation.from_rotvec(history_of(found, "turn")[-1]).as_matrix()
        moved = history_of(found, "move")[-1]
        off.append(max(np.abs(R - exact[:9].reshape(3, 3)).max(), np.abs(moved - exact[15:]).max()))
        assert np.abs(found["error"]).max() < 0.01
    assert off[1] < 0.01
    assert off[0] / off[1] == pytest.approx(4.0, rel=0.25)


CASE = (
    STOPPING
    + """
def case(solver="newton", unit=1.0, modulus=1000.0):
    load, end = modulus * unit**2 * 1e-3, 0.5 * unit / modulus**0.5 * 1000.0**0.5
    inner = pd.region.Box((1.9 * unit, -unit, 0.1 * unit), (2.1 * unit, 2.0 * unit, 2.0 * unit))
    outer = pd.region.Box((-unit, -unit, -unit), (0.01 * unit, 2.0 * unit, 2.0 * unit))
    part = pd.RigidRegion(
        inner, force=(load, 10.0 * load, -5.0 * load), moment=(2.0 * load * unit, 0.0, -3.0 * load * unit),
        about=(2.0 * unit, 0.2 * unit, 0.3 * unit), follows=True,
    )
    solvers = {"newton": pd.Newton(), "implicit": pd.Implicit(dt=0.1 * end, end=end),
               "explicit": pd.Explicit(end=end, records=8),
               "path": pd.PathFollowing(pd.Opening("y", inner, step=0.05 * unit, end=0.25 * unit))}
    mean = {axis: pd.Mean(pd.displacement, axis, inner) for axis in "xyz"}
    return pd.Case(
        particles=pd.LatticeNodes((0.0, 0.0, 0.0), (2.0 * unit, unit, unit), 0.25 * unit),
        material=pd.NeoHookean(modulus, 0.3, density=2.0),
        conditions=[pd.Displacement(outer, x=0.0, y=0.0, z=0.0), part],
        solver=solvers[solver],
        **({"steps": pd.Steps(5)} if solver == "newton" else {}),
        history={"stop": Stopping(), "work": pd.ExternalWork(), **mean},
        results=lambda h: {
            "work": h["work"][-1] / (modulus * unit**3), **{axis: h[axis][-1] / unit for axis in "xyz"},
        },
    )
"""
)


@pytest.mark.parametrize("kind", ["newton", "path", "implicit", "explicit"])
def test_ranks_units_and_restarts_change_nothing(kind, tmp_path):
    path = tmp_path / "case.py"
    path.write_text(CASE)
    one = results(path, f"solver={kind}", output=tmp_path / "one")["results"]
    assert abs(one["y"]) > 0.02
    for name, words, ranks in (("two", [], 2), ("small", ["unit=1e-6", "modulus=1e8"], 1)):
        other = results(path, f"solver={kind}", *words, ranks=ranks, output=tmp_path / name)["results"]
        assert other == pytest.approx(one, rel=1e-5, abs=1e-9)
    again = stopped_and_continued(CASE, kind, output=tmp_path)
    assert {name: again[name] for name in one} == pytest.approx(one, rel=1e-8, abs=1e-11)


def test_the_work_of_a_follower_force_is_the_energy_of_an_elastic_body(tmp_path):
    """The force does work along the path; that of load steps is of second order in their length."""
    history = {"work": pd.ExternalWork(), "energy": pd.StrainEnergy()}
    off = []
    for steps in (8, 16):
        found = pd.run(strip(follower(2), history=history, steps=steps), tmp_path / f"{steps}").history
        off.append(abs(found["work"][-1] / found["energy"][-1] - 1.0))
    assert off[1] < 0.01
    assert off[0] / off[1] == pytest.approx(4.0, rel=0.3)


@pytest.mark.parametrize(
    ("given", "match"),
    [
        ({"move": (1.0, 0.0)}, "follows, and has no load. Give a force or a moment"),
        ({"turn": 0.1, "about": (1.0, 3.0)}, "follows, and has no load"),
        ({"force": (0.0, -1.0)}, "follows, and has no rotation. Give a moment, such as 0, or a turn"),
        (
            {"force": (None, -1.0), "moment": 0.0, "about": (1.0, 3.0)},
            "has a force that follows, in some directions only",
        ),
    ],
)
def test_loads_that_cannot_follow_are_refused(given, match):
    with pytest.raises(pd.CaseError, match=match):
        pd.prepare(pressed(disc(**given, follows=True)))


def test_modes_refuse_a_force_that_follows(tmp_path):
    """Its tangent is not symmetric, and a vibration may grow."""
    heavy = pd.NeoHookean(1000.0, 0.0, plane="stress", density=1.0)
    with pytest.raises(pd.CaseError, match="need loads with an energy, which a force that follows"):
        pd.run(strip(follower(2), material=heavy, modes=pd.Modes(1), steps=1), tmp_path / "modes")
    free = follower(2, force=(0.0, 0.0))
    assert pd.run(strip(free, material=heavy, modes=pd.Modes(1), steps=4), tmp_path / "free")["frequency_1"] > 0.0


def test_a_force_that_follows_is_refused_next_to_a_mirror_plane():
    half = pd.Lattice((0.0, 0.0), (1.0, 1.0), 0.125)
    tool = pd.RigidSphere((0.0, 3.0), 2.0, force=(0.0, -1.0), turn=0.1, about=(0.0, 3.0), follows=True)
    with pytest.raises(pd.CaseError, match="across a mirror plane"):
        pd.prepare(pressed(tool, particles=half, conditions=[pd.Roller("-x"), pd.Clamp("-y"), pd.Contact("+y", tool)]))


def test_a_path_refuses_a_force_whose_rotation_is_prescribed(tmp_path):
    """It is not proportional to the load factor."""
    region = pd.RigidRegion("+x", force=(1.0, 2.0), turn=0.5, about=(4.0, 0.5), follows=True)
    solver = pd.PathFollowing(pd.Opening("y", pd.region.Slab("x", low=3.9), step=0.2, end=0.8))
    with pytest.raises(pd.CaseError, match="proportional to the step time"):
        pd.run(strip(region, solver=solver), tmp_path)


@pytest.mark.parametrize("kind", ["explicit", "implicit"])
def test_a_body_with_a_prescribed_rotation_is_moved_by_a_force_that_turns(kind, tmp_path):
    """At a constant spin the velocity goes round a circle."""
    mesh, turn = pd.LatticeNodes((0.0, 0.0), (1.0, 1.0), 0.25), 2.0
    region = pd.RigidRegion(
        ALL, force=(3.0, 0.0), turn=turn, about=(0.0, 0.0), schedule=(pd.Hold(), pd.Hold(), pd.Ramp()), follows=True
    )
    history = {
        **{axis: pd.Mean(pd.displacement, axis) for axis in "xy"},
        "kinetic": pd.KineticEnergy(), "error": pd.EnergyError(), "work": pd.ExternalWork(),
    }  # fmt: skip
    case = flying(kind, 50, ALL, mesh, [], history=history)
    case = pd.Case(mesh, material=case.material, conditions=[region], solver=case.solver, history=history)
    found, M = pd.run(case, tmp_path).history, 2.0 * pd.prepare(case).cloud.volume.sum()
    t, a = found["time"], 3.0 / M
    np.testing.assert_allclose(found["x"], a * (1.0 - np.cos(turn * t)) / turn**2, atol=2e-4 * a)
    np.testing.assert_allclose(found["y"], a * (turn * t - np.sin(turn * t)) / turn**2, atol=2e-4 * a)
    assert np.abs(found["error"]).max() < 1e-3
    gained = 0.5 * M * 2.0 * (a / turn) ** 2 * (1.0 - np.cos(turn * t))
    np.testing.assert_allclose(found["work"] - found["work"][1], gained - gained[1], atol=2e-3 * gained.max())
