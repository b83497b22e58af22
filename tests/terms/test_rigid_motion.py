"""Rigid tools and regions that fly, tumble and are loaded in motions."""

import numpy as np
import pytest
import scipy
from scipy.spatial.transform import Rotation

import pdpetsc as pd
from tests.commands import STOPPING, Stop, results, stopped_and_continued

ALL = pd.region.All()
# Principal moments of inertia and initial angular velocity of a body that tumbles.
J, SPIN = np.array([1.0, 2.0, 2.5]), np.array([1.0, 2.0, 0.5])


def solver_of(kind, end, n, **given):
    return pd.Explicit(end=end, records=n) if kind == "explicit" else pd.Implicit(dt=end / n, end=end, **given)


def euler(J, w, t):
    """Return the angular velocity of a free body in its axes (n, 3) by Jacobi's functions (Landau and Lifshitz, 37).

    The second axis is that of the mean moment of inertia, about which the motion is unstable.
    """
    twice, square = (J * w**2).sum(), ((J * w) ** 2).sum()
    order = [0, 1, 2] if square > twice * J[1] else [2, 1, 0]
    a, b, c = J[order]
    rate = np.sqrt((c - b) * (square - twice * a) / (a * b * c))
    m = (b - a) * (twice * c - square) / ((c - b) * (square - twice * a))
    size = np.sqrt(np.array([(twice * c - square) / (a * (c - a)), (twice * c - square) / (b * (c - b)),
                             (square - twice * a) / (c * (c - a))]))  # fmt: skip
    w = w[order]
    way = np.sign(w[2])
    signs = np.array([1.0, way * np.sign(b - a) * (1.0 if order[0] == 0 else -1.0), way])
    # The phase at which it has the initial values.
    cosine, sine, _ = signs * w / size
    phase = scipy.special.ellipkinc(np.arctan2(sine, cosine), m)
    sn, cn, dn, _ = scipy.special.ellipj(phase + rate * t, m)
    found = np.empty((len(t), 3))
    found[:, order] = signs * size * np.stack([cn, sn, dn], axis=1)
    return found


def test_the_reference_solves_the_equations_of_euler():
    t = np.linspace(0.0, 20.0, 201)
    for w in (SPIN, np.array([0.01, 3.0, 0.01]), np.array([0.3, 1.0, 2.0]), np.array([2.0, 0.5, -0.3])):
        steps = scipy.integrate.solve_ivp(
            lambda t, w: np.cross(J * w, w) / J, (0.0, 20.0), w, "DOP853", t, rtol=1e-12, atol=1e-12
        )
        np.testing.assert_allclose(euler(J, w, t), steps.y.T, atol=1e-7)


def history_of(found, name):
    return np.stack([found[f"tool_{name}_{axis}"] for axis in "xyz"], axis=1)


def tumbling(kind, n, inertia=tuple(J), spin=tuple(SPIN), end=4.0, **given):
    """Return a tool that tumbles freely above a block of few particles, which allows long steps."""
    about = (0.5, 0.5, 5.0)
    tool = pd.RigidSphere(
        about, 1.0, force=(0.0, 0.0, 0.0), moment=(0.0, 0.0, 0.0), about=about, mass=3.0, velocity=(0.2, 0.0, 0.1),
        inertia=inertia, spin=spin,
    )  # fmt: skip
    return pd.Case(
        pd.LatticeNodes((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), 0.5),
        material=pd.LinearElastic(1.0, 0.0, density=1e6),
        conditions=[pd.Clamp("-z"), pd.Contact("+z", tool, name="tool")],
        solver=solver_of(kind, end, n, **given),
        history={"kinetic": pd.KineticEnergy(), "error": pd.EnergyError()},
    )


@pytest.mark.parametrize("kind", ["explicit", "implicit"])
def test_a_tool_tumbles_by_the_equations_of_euler(kind, tmp_path):
    """Angular momentum is exact, and energy of the trapezoidal rule; angles and velocities are of second order."""
    off = []
    for n in (30, 60):
        given = {} if kind == "explicit" else {"radius": 1.0}
        found = pd.run(tumbling(kind, n, **given), tmp_path / f"{n}").history
        R = Rotation.from_rotvec(history_of(found, "turn")).as_matrix()
        W = np.einsum("nji,nj->ni", R, history_of(found, "spin"))
        momentum = np.einsum("nij,nj->ni", R, J * W)
        np.testing.assert_allclose(momentum, np.tile(J * SPIN, (n + 1, 1)), atol=1e-9)
        np.testing.assert_allclose(found["tool_move_x"], 0.2 * found["time"], atol=1e-12)
        begun = 0.5 * 3.0 * 0.05 + 0.5 * (J * SPIN**2).sum()
        off.append([np.abs(W - euler(J, SPIN, found["time"])).max(), np.abs(found["kinetic"] / begun - 1.0).max()])
    coarse, fine = off
    assert fine[0] < 0.02
    assert coarse[0] / fine[0] == pytest.approx(4.0, rel=0.1)
    if kind == "implicit":
        assert coarse[1] < 1e-10
    else:
        assert coarse[1] / fine[1] == pytest.approx(4.0, rel=0.1)


@pytest.mark.long
def test_a_spin_about_the_mean_axis_turns_over(tmp_path):
    """Dzhanibekov: the body spins for a while, and then the other way round."""
    spin = (0.01, 3.0, 0.01)
    found = pd.run(tumbling("implicit", 120, spin=spin, end=10.0, radius=1.0), tmp_path).history
    R = Rotation.from_rotvec(history_of(found, "turn")).as_matrix()
    W = np.einsum("nji,nj->ni", R, history_of(found, "spin"))
    assert W[:, 1].min() < -2.9
    expected = euler(J, np.array(spin), found["time"])
    assert W[:, 1] == pytest.approx(expected[:, 1], abs=0.3)


def test_moments_of_inertia_are_those_of_the_axes_in_any_direction(tmp_path):
    """A matrix of moments of inertia: the motion of the principal axes, turned."""
    Q = Rotation.from_rotvec((0.4, -1.0, 0.7)).as_matrix()
    matrix = tuple(tuple(row) for row in Q @ np.diag(J) @ Q.T)
    plain = pd.run(tumbling("implicit", 20, end=1.0), tmp_path / "plain").history
    turned = pd.run(tumbling("implicit", 20, matrix, tuple(Q @ SPIN), end=1.0), tmp_path / "turned").history
    np.testing.assert_allclose(history_of(turned, "spin"), history_of(plain, "spin") @ Q.T, atol=1e-10)


def test_steps_of_variable_length_resolve_a_tumbling_tool(tmp_path):
    found = pd.run(tumbling("implicit", 8, error=1e-4), tmp_path).history
    assert np.diff(found["time"]).max() < 0.2
    R = Rotation.from_rotvec(history_of(found, "turn")).as_matrix()
    W = np.einsum("nji,nj->ni", R, history_of(found, "spin"))
    assert np.abs(W - euler(J, SPIN, found["time"])).max() < 0.05


def flying(kind, n, region, nodes, velocity, end=1.0, given=None, **changes):
    """Return a body, or a part of it, that is a rigid region without load."""
    dim = len(nodes.low)
    loads = {"force": (0.0,) * dim, "moment": 0.0 if dim == 2 else (0.0,) * 3, "about": (0.7, 0.1, 0.2)[:dim]}
    region = pd.RigidRegion(region, **{**loads, **(given or {})})
    case = {
        "material": pd.NeoHookean(E=1000.0, nu=0.3, density=2.0),
        "conditions": [*velocity, region],
        "solver": solver_of(kind, end, n, **({"radius": 1.0} if kind == "implicit" else {})),
    }
    return pd.Case(nodes, **{**case, **changes})


def rotating(v, w, about):
    """Return the initial velocity of a rigid motion."""

    def component(axis):
        def value(x, t):
            arms = x - np.asarray(about)
            turned = np.stack([-arms[:, 1], arms[:, 0]], axis=1) * w if len(v) == 2 else np.cross(w, arms)
            return v[axis] + turned[:, axis]

        return value

    return pd.InitialVelocity(ALL, **{name: component(axis) for axis, name in enumerate("xyz"[: len(v)])})


@pytest.mark.parametrize("kind", ["explicit", "implicit"])
def test_a_region_spins_as_a_symmetric_top(kind, tmp_path):
    """Closed form: the axis turns about the angular momentum, and the body about its axis; point masses."""
    nodes = pd.LatticeNodes((0.0, 0.0, 0.0), (1.0, 1.0, 2.0), 0.5)
    v, w = np.array([0.2, -0.1, 0.3]), np.array([0.5, 0.8, 2.0])
    off = []
    for n in (15, 30):
        case = flying(kind, n, ALL, nodes, [rotating(v, w, (0.5, 0.5, 1.0))], end=2.0)
        cloud = pd.prepare(case).cloud
        arms, mass = cloud.x - (0.5, 0.5, 1.0), 2.0 * cloud.volume
        across, along = ((mass * (arms**2)[:, axes].sum(axis=1)).sum() for axes in ([1, 2], [0, 1]))
        momentum = np.array([across, across, along]) * w
        spin = w[2] - momentum[2] / across
        R = Rotation.from_rotvec(2.0 * momentum / across) * Rotation.from_rotvec((0.0, 0.0, 2.0 * spin))
        run = pd.run(case, tmp_path / f"{n}")
        arms = run.x - (0.5, 0.5, 1.0)
        off.append(np.abs(run.field("displacement") - (R.apply(arms) - arms + 2.0 * v)).max())
    assert off[1] < 0.02
    assert off[0] / off[1] == pytest.approx(4.0, rel=0.15)


class Momentum(pd.Quantity):
    """Momentum or, about the origin, angular momentum of the particles in the plane."""

    def __init__(self, axis):
        self.axis = axis

    def evaluate(self, solution):
        v = solution.problem.inertia.motion(solution.state)[0]
        y = solution.x + solution.u
        parts = [v[:, 0], v[:, 1], y[:, 0] * v[:, 1] - y[:, 1] * v[:, 0]]
        return float(solution.sum(float(solution.problem.inertia.mass @ parts[self.axis])))


@pytest.mark.parametrize("damped", [False, pytest.param(True, marks=pytest.mark.long)])
@pytest.mark.parametrize("kind", ["explicit", "implicit"])
def test_a_body_with_a_rigid_part_conserves_momentum_and_energy(kind, damped, tmp_path):
    """The elastic part shakes. Damping takes energy; its stiffness is that of the body at rest, without rotations."""
    nodes = pd.LatticeNodes((0.0, 0.0), (2.0, 1.0), 0.25)
    region = pd.region.Box((0.9, -1.0), (3.0, 2.0))
    history = {"x": Momentum(0), "y": Momentum(1), "m": Momentum(2), "error": pd.EnergyError(),
               "kinetic": pd.KineticEnergy(), "strain": pd.StrainEnergy()}  # fmt: skip
    shakes = pd.InitialVelocity(pd.region.Box((-1.0, -1.0), (0.6, 0.6)), y=2.0)
    velocity = [shakes, pd.InitialVelocity(region, x=lambda x, t: 0.2 - x[:, 1], y=lambda x, t: 0.1 + x[:, 0])]
    velocity += [pd.RayleighDamping(stiffness=2e-3)] if damped else []
    off, energies = [], []
    for n in (25, 50):
        found = pd.run(flying(kind, n, region, nodes, velocity, history=history), tmp_path / f"{n}").history
        np.testing.assert_allclose(found["x"], found["x"][0], atol=1e-6)
        np.testing.assert_allclose(found["y"], found["y"][0], atol=1e-6)
        off.append(np.abs(found["m"] / found["m"][0] - 1.0).max())
        energies.append(found["kinetic"] + found["strain"])
    assert np.abs(found["error"]).max() < 0.02
    if kind == "explicit" and not damped:
        assert off[1] < 1e-10
    elif not damped:
        assert off[0] / off[1] > 3.0
        assert off[1] < 1e-3
    lost = 1.0 - energies[1] / energies[1][0]
    if damped:
        assert lost[-1] > 0.02
    else:  # near their stable step central differences conserve another sum
        assert np.abs(lost).max() < (0.05 if kind == "explicit" else 0.01)


@pytest.mark.parametrize("kind", ["explicit", "implicit"])
def test_a_bar_with_a_rigid_mass_at_its_end_vibrates(kind, tmp_path):
    """``k L tan(k L) = m / M`` with the mass M at the end and the mass m of the bar."""
    length, density, modulus = 4.0, 2.0, 1000.0
    kL = scipy.optimize.brentq(lambda a: a * np.tan(a) - 1.0, 0.1, 1.5)
    rate = kL / length * np.sqrt(modulus / density)
    end = np.pi / rate
    nodes = pd.LatticeNodes((0.0, 0.0), (length, 0.5), 0.125)
    tip = pd.RigidRegion("+x", force=(0.0, None), mass=density * length * 0.5)
    start = pd.InitialVelocity(ALL, x=lambda x, t: 1e-3 * np.sin(kL * x[:, 0] / length))
    case = pd.Case(
        nodes,
        material=pd.LinearElastic(modulus, 0.0, density=density),
        conditions=[pd.Clamp("-x"), start, tip],
        solver=solver_of(kind, end, 60),
        history={"x": pd.Mean(pd.displacement, "x", "+x"), "error": pd.EnergyError()},
    )
    found = pd.run(case, tmp_path).history
    size = 1e-3 * np.sin(kL) / rate
    np.testing.assert_allclose(found["x"], size * np.sin(rate * found["time"]), atol=0.01 * size)
    assert np.abs(found["error"]).max() < 1e-3


def balanced_error(run, expected):
    """Return the largest error of the displacements (n, 2); kinetic energy and work must agree."""
    found = run.history
    np.testing.assert_allclose(found["kinetic"], found["work"], atol=0.01 * found["kinetic"].max())
    assert np.abs(found["error"]).max() < 0.01
    return np.abs(run.field("displacement")[:, :2] - expected).max()


def swung(ratio, angle, t):
    """Return the angle of ``a'' = -ratio sin a`` from rest at ``angle``."""
    k = np.sin(0.5 * angle)
    quarter = scipy.special.ellipk(k**2)
    _, cn, dn, _ = scipy.special.ellipj(np.sqrt(ratio) * t, k**2)
    assert quarter > 0.0
    return 2.0 * np.arcsin(k * cn / dn)


@pytest.mark.parametrize("kind", ["explicit", "implicit"])
@pytest.mark.parametrize("scene", ["pendulum", "thrust"])
def test_a_region_swings_as_a_pendulum(kind, scene, tmp_path):
    """A body on a hinge under its weight, and a free one with a force beside its centre of mass; large angles."""
    nodes = pd.LatticeNodes((0.0, 0.0), (2.0, 0.5), 0.25)
    hinge = np.array([0.0, 0.25])
    given, weight = {"about": tuple(hinge), "schedule": pd.Hold()}, []
    if scene == "pendulum":
        given |= {"force": ()}
        weight = [pd.BodyForce(ALL, y=-2.0 * 9.81, schedule=pd.Hold())]
    else:
        given |= {"force": (0.0, 3.0)}
    history = {"kinetic": pd.KineticEnergy(), "work": pd.ExternalWork(), "error": pd.EnergyError()}
    off = []
    for n in (25, 50):
        case = flying(kind, n, ALL, nodes, weight, end=1.5, given=given, history=history)
        cloud = pd.prepare(case).cloud
        mass, centre = 2.0 * cloud.volume, np.array([1.0, 0.25])
        fixed = hinge if scene == "pendulum" else centre
        moment = (mass * ((cloud.x - fixed) ** 2).sum(axis=1)).sum()
        ratio = mass.sum() * 9.81 / moment if scene == "pendulum" else 3.0 / moment
        run = pd.run(case, tmp_path / f"{n}")
        # Measured from the stable direction of the arm; it begins at a right angle, clockwise in both scenes.
        turn = swung(ratio, 0.5 * np.pi, 1.5) - 0.5 * np.pi
        R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        arms = run.x[:, :2] - fixed
        expected = arms @ R.T - arms
        if scene == "thrust":
            expected += (0.0, 0.5 * 3.0 / mass.sum() * 1.5**2)
        off.append(balanced_error(run, expected))
    assert off[1] < 0.02
    assert off[0] / off[1] == pytest.approx(4.0, rel=0.25)


@pytest.mark.parametrize("kind", ["explicit", "implicit"])
def test_the_energy_of_a_swing_is_judged_with_the_work_of_the_weight_on_its_way(kind, tmp_path):
    """The work is exact for steps of any length, the energy is not, and steps that are too long end the run."""
    nodes = pd.LatticeNodes((0.0, 0.0), (2.0, 0.5), 0.25)
    weight = pd.BodyForce(ALL, y=-2.0 * 9.81, schedule=pd.Hold())
    given = {"about": (0.0, 0.25), "force": ()}
    history = {"y": pd.Mean(pd.displacement, "y"), "work": pd.ExternalWork(), "error": pd.EnergyError()}
    case = flying(kind, 8, ALL, nodes, [weight], end=1.5, given=given, history=history)
    found = pd.run(case, tmp_path / "8").history
    np.testing.assert_allclose(found["work"], -2.0 * 9.81 * found["y"], rtol=1e-6, atol=1e-9)
    assert np.abs(found["error"]).max() > 1e-3
    with pytest.raises(pd.SolveError, match="the energy does not balance"):
        pd.run(flying(kind, 4, ALL, nodes, [weight], end=1.5, given=given), tmp_path / "4")


@pytest.mark.parametrize("kind", ["explicit", "implicit"])
def test_energy_that_a_contact_gives_a_rigid_region_is_judged(kind, tmp_path):
    """A ball bounces off a block that is one region: velocities of an elastic impact, and what the steps create."""
    ball = pd.RigidSphere((0.5, 1.52), 0.5, force=(None, 0.0), mass=1.0, velocity=(0.0, -1.0))
    conditions = [pd.RigidRegion(ALL, force=(0.0, 0.0)), pd.Contact("+y", ball, name="tool", penetration=0.05)]
    case = pd.Case(
        pd.LatticeNodes((0.0, 0.0), (1.0, 1.0), 0.25),
        material=pd.NeoHookean(1000.0, 0.3, density=2.0),
        conditions=conditions,
        solver=solver_of(kind, 0.2, 100),
        history={"y": Momentum(1), "kinetic": pd.KineticEnergy(), "error": pd.EnergyError()},
    )
    found = pd.run(case, tmp_path).history
    assert found["tool_velocity_y"][-1] == pytest.approx(1.0 / 3.0, rel=0.02)
    assert found["y"][-1] == pytest.approx(-4.0 / 3.0, rel=0.02)
    gained = found["kinetic"][-1] / found["kinetic"][0] - 1.0
    assert gained > 1e-4
    assert found["error"][-1] == pytest.approx(gained, rel=0.01)


@pytest.mark.parametrize(("held", "end"), [(ALL, 0.02), (pd.region.Slab("x", high=0.1), 2.0)])
def test_a_free_tool_does_not_cross_a_wall_in_one_step(held, end, tmp_path):
    """A wall of which nothing gives way, and a step in which the tool moves by 400 times the thickness of the wall."""
    ball = pd.RigidSphere((1.3, 1.5), 0.3, force=(0.0, None), mass=0.2, velocity=(-100.0, 0.0))
    case = pd.Case(
        pd.LatticeNodes((0.0, 0.0), (0.5, 3.0), 0.25),
        material=pd.NeoHookean(1e4, 0.0, density=1.0),
        conditions=[pd.Displacement(held, x=0.0, y=0.0), pd.Contact(ALL, ball, name="tool")],
        solver=pd.Implicit(dt=end, end=end),
    )
    with pytest.raises(pd.SolveError, match=r"passed through the surface|deep in the body"):
        pd.run(case, tmp_path)


@pytest.mark.parametrize("kind", ["explicit", "implicit"])
def test_damping_by_the_mass_slows_a_region(kind, tmp_path):
    nodes = pd.LatticeNodes((0.0, 0.0), (1.0, 1.0), 0.5)
    velocity = [rotating((1.0, 0.0), 0.5, (0.5, 0.5)), pd.RayleighDamping(mass=1.0)]
    case = flying(kind, 100, ALL, nodes, velocity, history={"kinetic": pd.KineticEnergy(), "work": pd.ExternalWork()})
    found = pd.run(case, tmp_path).history
    expected = found["kinetic"][0] * np.exp(-2.0 * found["time"])
    np.testing.assert_allclose(found["kinetic"], expected, rtol=1e-3)
    assert np.abs(found["work"]).max() < 1e-4 * expected[0]


def test_strong_damping_stops_a_region_in_explicit_steps(tmp_path):
    """The stable step of a body without elastic parts is that of the damping."""
    nodes = pd.LatticeNodes((0.0, 0.0), (1.0, 1.0), 0.5)
    velocity = [rotating((1.0, 0.0), 0.5, (0.5, 0.5)), pd.RayleighDamping(mass=100.0)]
    found = pd.run(flying("explicit", 10, ALL, nodes, velocity, history={"kinetic": pd.KineticEnergy()}), tmp_path)
    assert found.history["kinetic"][1] < 1e-3 * found.history["kinetic"][0]
    assert np.all(np.diff(found.history["kinetic"]) <= 0.0)


@pytest.mark.parametrize("kind", ["explicit", "implicit"])
def test_a_region_that_is_turned_and_pushed(kind, tmp_path):
    """A prescribed rotation about another point than the centre of mass, which moves by the force alone."""
    nodes = pd.LatticeNodes((0.0, 0.0), (1.0, 1.0), 0.25)
    region = pd.RigidRegion(
        ALL, force=(3.0, 0.0), turn=2.0, about=(0.0, 0.0), schedule=(pd.Hold(), pd.Hold(), pd.Ramp())
    )
    history = {"x": pd.Mean(pd.displacement, "x"), "y": pd.Mean(pd.displacement, "y"), "kinetic": pd.KineticEnergy()}
    case = flying(kind, 50, ALL, nodes, [], history=history)
    case = pd.Case(nodes, material=case.material, conditions=[region], solver=case.solver, history=history)
    cloud = pd.prepare(case).cloud
    mass = 2.0 * cloud.volume
    moment = (mass * ((cloud.x - 0.5) ** 2).sum(axis=1)).sum()
    found = pd.run(case, tmp_path).history
    t, M = found["time"], mass.sum()
    np.testing.assert_allclose(found["x"], 0.5 * 3.0 / M * t**2, atol=1e-9)
    np.testing.assert_allclose(found["y"], 0.0, atol=1e-9)
    expected = 0.5 * M * (3.0 / M * t) ** 2 + 0.5 * moment * 2.0**2
    np.testing.assert_allclose(found["kinetic"][1:], expected[1:], rtol=1e-5)


MOVING = (
    STOPPING
    + """
def case(solver="explicit", unit=1.0, modulus=1000.0):
    end = 0.3 * unit / modulus**0.5 * 1000.0**0.5
    rate = unit / end * 0.3
    ball = pd.RigidSphere(
        (0.5 * unit, 1.51 * unit, 0.5 * unit), 0.5 * unit, force=(None, 0.0, None), moment=(0.0, 0.0, 0.0),
        about=(0.5 * unit, 1.51 * unit, 0.5 * unit), mass=unit**3, inertia=[one * unit**5 for one in (0.1, 0.2, 0.25)],
        velocity=(0.0, -0.5 * rate, 0.0), spin=[one * rate / unit for one in (1.0, 0.5, 2.0)],
    )
    side = pd.region.Box((1.1 * unit, -unit, -unit), (3.0 * unit,) * 3)
    load = modulus * unit**2 * 1e-3
    part = pd.RigidRegion(
        side, force=(load, 0.0, 0.0), moment=(0.0, load * unit, 0.0), about=(2.0 * unit, 0.2 * unit, 0.0),
        mass=0.1 * unit**3, inertia=0.02 * unit**5,
    )
    turning = pd.InitialVelocity(side, x=lambda x, t: -rate * x[:, 1] / unit, y=lambda x, t: rate * x[:, 0] / unit)
    solvers = {"explicit": pd.Explicit(end=end, records=8), "implicit": pd.Implicit(dt=0.1 * end, end=end)}
    contact = pd.Contact("+y", ball, 0.3, penetration=0.1, name="tool")
    mean = {axis: pd.Mean(pd.displacement, axis, side) for axis in "xyz"}
    return pd.Case(
        particles=pd.LatticeNodes((0.0, 0.0, 0.0), (2.0 * unit, unit, unit), 0.25 * unit),
        material=pd.NeoHookean(modulus, 0.3, density=2.0),
        conditions=[turning, part, contact],
        solver=solvers[solver],
        history={"stop": Stopping(), "kinetic": pd.KineticEnergy(), **mean},
        results=lambda h: {
            "kinetic": h["kinetic"][-1] / (modulus * unit**3),
            **{axis: h[axis][-1] / unit for axis in "xyz"},
            **{name: h[f"tool_{name}"][-1] for name in ("turn_x", "turn_y", "turn_z")},
            "spin": h["tool_spin_x"][-1] * end, "velocity": h["tool_velocity_y"][-1] * end / unit,
        },
    )
"""
)


@pytest.mark.parametrize("kind", ["explicit", "implicit"])
def test_ranks_units_and_restarts_change_nothing(kind, tmp_path):
    """A loaded region that turns, and a tumbling ball that hits the elastic part with friction."""
    path = tmp_path / "case.py"
    path.write_text(MOVING)
    one = results(path, f"solver={kind}", output=tmp_path / "one")["results"]
    assert one["velocity"] > -0.14  # it is braked
    assert abs(one["x"]) > 0.01
    runs = {"two": ([], 2), "small": (["unit=1e-6", "modulus=1e8"], 1)}
    for name, (words, ranks) in runs.items():
        other = results(path, f"solver={kind}", *words, ranks=ranks, output=tmp_path / name)["results"]
        assert other == pytest.approx(one, rel=1e-5, abs=1e-8)
    again = stopped_and_continued(MOVING, kind, output=tmp_path)
    assert {name: again[name] for name in one} == pytest.approx(one, rel=1e-11, abs=1e-13)


def test_motions_that_are_not_determined_are_refused(tmp_path):
    line = pd.region.Box((0.9, -1.0, -0.1), (1.1, 2.0, 0.1))
    nodes = pd.LatticeNodes((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), 0.5)
    with pytest.raises(pd.CaseError, match="has particles on a line, without a moment of inertia"):
        pd.prepare(flying("implicit", 1, line, nodes, []))
    given = {"inertia": 1.0}
    pd.prepare(flying("implicit", 1, line, nodes, [], given=given))
    plane = pd.LatticeNodes((0.0, 0.0), (1.0, 1.0), 0.5)
    with pytest.raises(pd.CaseError, match=r"is not its centre of mass \(0.5, 0.5\), with some directions prescribed"):
        pd.prepare(flying("implicit", 1, ALL, plane, [], given={"force": (0.0, None)}))
    with pytest.raises(pd.CaseError, match="is the layers beyond a side of a Lattice, which have no mass of their own"):
        pd.prepare(flying("implicit", 1, "+x", pd.Lattice((0.0, 0.0), (1.0, 1.0), 0.25), []))
    with pytest.raises(pd.CaseError, match="has a mass and does not move in time"):
        pd.run(flying("implicit", 1, ALL, plane, [], given={"mass": 1.0}, solver=pd.Newton()), tmp_path)


@pytest.mark.parametrize(
    "material",
    [pd.LinearElastic(1000.0, 0.3, density=2.0), pd.BondBased(E=1000.0, nu=1.0 / 3.0, plane="stress", density=2.0)],
)
def test_regions_that_turn_in_a_motion_need_a_material_for_large_rotations(material):
    """The strain of a rotation would brake the region by its own stiffness."""
    nodes = pd.Lattice((0.0, 0.0), (1.0, 1.0), 0.25)
    with pytest.raises(pd.CaseError, match="has a moment in a motion, and materials of small strain"):
        pd.prepare(flying("explicit", 1, ALL, nodes, [], material=material))
    pd.prepare(flying("explicit", 1, ALL, nodes, [], given={"moment": ()}, material=material))


def test_a_body_that_is_one_loaded_region_has_no_equilibrium(tmp_path):
    nodes = pd.LatticeNodes((0.0, 0.0), (1.0, 1.0), 0.5)
    with pytest.raises(pd.SolveError, match="nothing holds the region of RigidRegion condition 1 against its load"):
        case = flying("implicit", 1, ALL, nodes, [], given={"force": (1.0, 0.0)}, solver=pd.Newton())
        pd.run(case, tmp_path)


@pytest.mark.parametrize(
    ("given", "match"),
    [
        ({"inertia": (1.0, 2.0)}, r"has an inertia of shape \(2,\) in 3 dimensions; give three numbers or a matrix"),
        ({"inertia": (1.0, 1.0, 3.0)}, "no body has one that exceeds the sum of the others"),
        ({"inertia": ((1.0, 0.5, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))}, "is not symmetric and positive"),
        ({"inertia": (1.0, 1.0, -1.0)}, "is not symmetric and positive"),
        ({"spin": 1.0}, "has a spin of 1 numbers in 3 dimensions; give 3"),
        ({"moment": (), "spin": (1.0, 0.0, 0.0)}, "has a spin without moment"),
    ],
)
def test_moments_of_inertia_and_spins_that_no_body_has_are_refused(given, match):
    about = (0.0, 0.0, 5.0)
    with pytest.raises(pd.CaseError, match=match):
        pd.RigidSphere(about, 1.0, **{"moment": (0.0, 0.0, 0.0), "about": about, **given}).check(3)


def test_a_turn_that_a_step_does_not_resolve_is_refused(tmp_path):
    """Steps of central differences end; those of Implicit are halved."""
    spin = (1.0, 2.0, 3.0)
    with pytest.raises(pd.SolveError, match=r"The tool of .* turns by .* rad in one time step"):
        pd.run(tumbling("explicit", 4, spin=spin), tmp_path / "explicit")
    found = pd.run(tumbling("implicit", 4, spin=spin), tmp_path / "implicit").history
    assert np.diff(found["time"]).max() * np.linalg.norm(spin) < 2.0


def torn(records, stop=2.0):
    """Return a body that is torn off a rigid part of it, until a step time."""
    nodes = pd.Lattice((0.0, 0.0), (2.0, 1.0), 0.125)
    region = pd.region.Box((1.2, -1.0), (3.0, 2.0))
    torn = pd.InitialVelocity(pd.region.Box((-1.0, -1.0), (1.2, 2.0)), x=-6.0, y=1.0)
    history = {"x": Momentum(0), "y": Momentum(1), "broken": pd.BrokenBonds(), "error": pd.EnergyError(),
               "stop": Stop(stop)}  # fmt: skip
    material = pd.BondBased(E=1000.0, nu=1.0 / 3.0, plane="stress", kinematics="finite", density=2.0)
    law = pd.Brittle(pd.ConstantCritical(0.05))
    return flying("explicit", records, region, nodes, [torn], end=0.1, history=history, material=material, damage=law)


def test_momentum_is_conserved_where_bonds_to_a_rigid_part_break(tmp_path):
    """Of central differences to round-off: both halves of a kick are the same for particles and region."""
    found = pd.run(torn(20), tmp_path).history
    assert found["broken"][-1] > 10
    for name in "xy":
        np.testing.assert_allclose(found[name], found[name][0], atol=1e-12 * abs(found["x"][0]))
    assert np.abs(found["error"]).max() < 0.01


def test_energy_momentum_steps_conserve_the_momentum_of_a_body_with_a_rigid_part(tmp_path):
    nodes = pd.LatticeNodes((0.0, 0.0), (2.0, 1.0), 0.25)
    shakes = pd.InitialVelocity(pd.region.Box((-1.0, -1.0), (0.6, 0.6)), x=1.0, y=2.0)
    history = {"x": Momentum(0), "y": Momentum(1)}
    solver = pd.Implicit(dt=0.02, end=0.5, energy_momentum=True)
    part = pd.region.Box((0.9, -1.0), (3.0, 2.0))
    case = flying("implicit", 1, part, nodes, [shakes], history=history, solver=solver)
    found = pd.run(case, tmp_path).history
    for name in "xy":
        np.testing.assert_allclose(found[name], found[name][0], rtol=1e-6)


def test_a_restart_after_bonds_to_a_rigid_part_broke_changes_nothing(tmp_path):
    whole = pd.run(torn(40), tmp_path / "whole").history
    last = 1 + int(np.argmax(np.diff(whole["broken"])))
    with pytest.raises(pd.Interrupted):
        pd.run(torn(40, stop=(last + 0.5) / 40), tmp_path / "half")
    again = pd.run(torn(40), tmp_path / "again", restart=tmp_path / "half").history
    for name in "xy":
        np.testing.assert_allclose(again[name], whole[name], rtol=1e-12)
    assert again["broken"][-1] == whole["broken"][-1]
