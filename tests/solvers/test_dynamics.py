"""Motion with inertia: order in time, conservation, ranks, restart and refusals."""

import dataclasses

import h5py
import numpy as np
import pytest
import scipy

import pdpetsc as pd
from pdpetsc.declare import region
from pdpetsc.problem.fragments import fragments_of
from pdpetsc.running.notes import wave_note
from pdpetsc.solvers.dynamics import stable_step
from tests.commands import Stop, results, script_on

E, RHO, LENGTH = 200.0, 2.0, 1.0
SPEED = np.sqrt(E / RHO)


def bar(solver, n=8, start=None, law=None, **options):
    """Return a bar that is held at its end and starts with a velocity."""
    given = {
        "particles": pd.LatticeNodes(0.0, LENGTH, LENGTH / n),
        "material": law or pd.LinearElastic(E=E, nu=0.0, density=RHO),
        "conditions": [
            pd.Displacement("-x", x=0.0),
            pd.InitialVelocity(region.All(), x=start or (lambda x, t: 0.1 * x[:, 0])),
        ],
        "solver": solver,
        "history": {
            "tip": pd.Mean(pd.displacement, "x", "+x"),
            "kinetic": pd.KineticEnergy(),
            "error": pd.EnergyError(),
        },
        "fields": [],
    }
    return pd.Case(**{**given, **options})


def exact(case, times, damping=0.0):
    """Return the displacement of the last particle in the modes of mass and stiffness of the particles.

    ``damping`` is the factor of the stiffness in the damping [time].
    """
    prepared = pd.prepare(case)
    problem, n = prepared.problem, prepared.cloud.n_owned
    tangent = problem.linearised(problem.state(np.zeros((n, 1))))
    K = np.stack([tangent(np.eye(n)[:, k : k + 1]).flatten() for k in range(n)], axis=1)
    free = ~problem.supports.fixed[:, 0]
    m, v = problem.inertia.mass[free], problem.inertia.v[free, 0]
    K = K[np.ix_(free, free)]
    squares, modes = scipy.linalg.eigh(K, np.diag(m))
    w = np.sqrt(np.maximum(squares, 0.0))
    amounts = modes.T @ (m * v)
    last = np.argmax(prepared.cloud.x[:n][free, 0])
    times, ratio = times[:, None], 0.5 * damping * w
    assert ratio.max() < 1.0
    turning = w * np.sqrt(1.0 - ratio**2)
    return times * np.sinc(times * turning / np.pi) * np.exp(-ratio * w * times) @ (amounts * modes[last])


def errors(solvers, tmp_path):
    found = []
    for number, solver in enumerate(solvers):
        case = bar(solver)
        history = pd.run(case, tmp_path / str(number)).history
        reference = exact(case, np.array(history["time"]))
        found.append(np.abs(np.array(history["tip"]) - reference).max() / np.abs(reference).max())
    return found


PERIOD = 4.0 * LENGTH / SPEED


@pytest.mark.parametrize("dim", [1, 2])
@pytest.mark.parametrize("law", ["points", "bonds", "graded"])
def test_a_step_in_which_a_wave_crosses_the_body_is_told(law, dim):
    """Stiffness 4 times that of the law beyond the middle: the wave is twice as fast."""
    E, density = 3.0, 0.5
    material = pd.LinearElastic(E, 0.0, "stress", density=density)
    if law == "bonds":
        material = pd.BondBased(E, plane="stress", density=density)
    if law == "graded":
        material = pd.Graded(material, lambda x: np.where(x[:, 0] > 1.0, 4.0, 1.0))
    lattice = pd.LatticeNodes((0.0, 0.0)[:dim], (2.0, 1.0)[:dim], 0.25)
    # With nu = 1/3 a plate of bonds has the modulus E / (1 - nu^2).
    stiffness = {"points": E, "bonds": E / (1.0 - 1.0 / 9.0) if dim == 2 else E, "graded": 4.0 * E}[law]
    crossing = 2.0 / np.sqrt(stiffness / density)

    def note(dt, **given):
        return wave_note(case := pd.Case(lattice, material=material, solver=pd.Implicit(dt, 100.0, **given)),
                         pd.prepare(case).problem)  # fmt: skip

    assert note(0.99 * crossing) == "" == note(1.01 * crossing, error=1e-3)
    assert note(1.01 * crossing).startswith("a time step of")


@pytest.mark.parametrize(
    "radius", [1.0, pytest.param(0.8, marks=pytest.mark.long), pytest.param(0.0, marks=pytest.mark.long)]
)
def test_implicit_steps_are_of_second_order(radius, tmp_path):
    coarse, fine = errors([pd.Implicit(dt=PERIOD / n, end=PERIOD, radius=radius) for n in (200, 400)], tmp_path)
    assert fine < 0.01
    assert coarse / fine == pytest.approx(4.0, rel=0.15)


def test_the_local_error_decides_on_the_time_step(tmp_path):
    """A free vibration has about the error that fixed steps of the same number have, and follows the declared one."""
    off, counts = [], []
    for number, error in enumerate((1e-3, 1e-4, 1e-5)):
        case = bar(
            pd.Implicit(dt=PERIOD / 5, end=PERIOD, error=error), start=lambda x, t: 0.1 * np.sin(0.5 * np.pi * x[:, 0])
        )
        history = pd.run(case, tmp_path / str(number)).history
        reference = exact(case, np.array(history["time"]))
        off.append(np.abs(np.array(history["tip"]) - reference).max() / np.abs(reference).max())
        counts.append(len(history["time"]) - 1)
    # Of second order: an error a tenth as large takes a cube root of ten times the steps.
    np.testing.assert_allclose(np.array(counts[1:]) / counts[:-1], 10.0 ** (1.0 / 3.0), rtol=0.35)
    assert off[0] < 0.1 and off[2] < 0.01 and counts[0] > 5


def test_a_body_at_rest_begins_to_move_with_steps_of_limited_error(tmp_path):
    """Under a force that grows from zero the way of the first step is as small as its error."""
    solver = pd.Implicit(dt=PERIOD / 5, end=PERIOD, error=1e-3)
    conditions = [pd.Displacement("-x", x=0.0), pd.Traction("+x", x=1.0)]
    free = pd.run(bar(solver, conditions=conditions), tmp_path / "free").history
    fixed = pd.run(bar(pd.Implicit(dt=PERIOD / 800, end=PERIOD), conditions=conditions), tmp_path / "fixed").history
    assert free["tip"][-1] == pytest.approx(fixed["tip"][-1], rel=0.02)
    assert 10 < len(free["tip"]) < 200


@pytest.mark.parametrize("kind", ["explicit", "implicit"])
def test_prescribed_velocities_are_integrated(kind, tmp_path):
    """A bar that is driven at its end: a constant velocity after a ramp, and one that depends on place and time."""
    solver = pd.Explicit(end=2.0, records=8) if kind == "explicit" else pd.Implicit(dt=0.25, end=2.0)
    ramp = pd.Table([0.0, 0.25, 1.0], [0.0, 1.0, 1.0])
    case = bar(solver, conditions=[pd.Velocity("-x", x=3.0, schedule=ramp)])
    history = pd.run(dataclasses.replace(case, history={"end": pd.Mean(pd.displacement, "x", "-x")}), tmp_path).history
    t = np.array(history["time"])
    np.testing.assert_allclose(history["end"], np.where(t < 0.5, 3.0 * t**2, 3.0 * (t - 0.25)), atol=1e-12)
    moved = pd.Velocity(region.All(), x=lambda x, t: x[:, 0] * t**2).moved(lambda x, t: x[:, 0] * t**2, 2.0)
    np.testing.assert_allclose(moved(np.array([[1.0], [3.0]]), 0.5), [2.0 / 24.0, 6.0 / 24.0], rtol=1e-13)
    with pytest.raises(pd.CaseError, match="Velocity needs inertia"):
        pd.prepare(dataclasses.replace(case, solver=pd.Newton()))


@pytest.mark.parametrize("kind", ["explicit", "implicit"])
def test_prescribed_accelerations_are_integrated_twice(kind, tmp_path):
    """A bar that is shaken at its end from rest: an acceleration that ends, and one that depends on place and time."""
    solver = pd.Explicit(end=2.0, records=8) if kind == "explicit" else pd.Implicit(dt=0.25, end=2.0)
    pulse = pd.Table([0.0, 0.25, 0.5, 1.0], [0.0, 1.0, 0.0, 0.0])
    case = bar(solver, conditions=[pd.Acceleration("-x", x=3.0, schedule=pulse)])
    history = pd.run(dataclasses.replace(case, history={"end": pd.Mean(pd.displacement, "x", "-x")}), tmp_path).history
    t = np.array(history["time"])
    slowing = 0.125 + 0.75 * (t - 0.5) + 1.5 * (t - 0.5) ** 2 - (t - 0.5) ** 3
    exact_end = np.select([t < 0.5, t < 1.0], [t**3, slowing], 0.75 + 1.5 * (t - 1.0))
    np.testing.assert_allclose(history["end"], exact_end, atol=1e-12)
    moved = pd.Acceleration(region.All(), x=1.0).moved(lambda x, t: x[:, 0] * t**2, 2.0)
    np.testing.assert_allclose(moved(np.array([[1.0], [3.0]]), 0.5), [4.0 / 192.0, 12.0 / 192.0], rtol=1e-13)
    with pytest.raises(pd.CaseError, match="Acceleration needs inertia"):
        pd.prepare(dataclasses.replace(case, solver=pd.Newton()))


def test_explicit_steps_are_of_second_order(tmp_path):
    coarse, fine = errors([pd.Explicit(end=PERIOD, safety=s, records=4) for s in (0.1, 0.05)], tmp_path)
    assert fine < 0.01
    assert coarse / fine == pytest.approx(4.0, rel=0.15)


def test_implicit_steps_reach_the_closed_form(tmp_path):
    (error,) = errors([pd.Implicit(dt=PERIOD / 40000, end=PERIOD / 20, every=100)], tmp_path)
    assert error < 1e-6


@pytest.mark.long
def test_a_free_vibration_keeps_its_energy_for_a_thousand_periods(tmp_path):
    case = bar(pd.Implicit(dt=PERIOD / 20, end=1000 * PERIOD, every=100), n=4)
    assert np.abs(pd.run(case, tmp_path).history["error"]).max() < 1e-8


def test_energy_is_constant_or_is_damped_as_declared(tmp_path):
    kept = pd.run(bar(pd.Implicit(dt=PERIOD / 20, end=30 * PERIOD, every=20)), tmp_path / "kept").history
    assert np.abs(kept["error"]).max() < 1e-9
    verlet = pd.run(bar(pd.Explicit(end=30 * PERIOD)), tmp_path / "verlet").history
    assert np.abs(verlet["error"]).max() < 1e-10
    short = pd.run(bar(pd.Implicit(dt=PERIOD / 20, end=3 * PERIOD, radius=0.5)), tmp_path / "short").history
    assert -0.05 < short["error"][-1] < -1e-4
    for number, solver in enumerate(
        (pd.Implicit(dt=PERIOD / 100, end=PERIOD), pd.Explicit(end=PERIOD), pd.Explicit(end=PERIOD))
    ):
        damping = pd.RayleighDamping(stiffness=0.02) if number == 2 else pd.RayleighDamping(mass=2.0)
        case = bar(solver)
        case = dataclasses.replace(case, conditions=[*case.conditions, damping])
        damped = pd.run(case, tmp_path / f"damped{number}").history
        assert np.abs(damped["error"]).max() < 1e-3
        assert damped["kinetic"][-1] < 0.6 * damped["kinetic"][0]


@pytest.mark.parametrize("jacobian", ["matfree", "assembled"])
def test_implicit_damping_by_the_stiffness_is_that_of_its_modes(jacobian, tmp_path):
    """Of second order to the damped modes of mass and stiffness, with the balance of energy, in one iteration."""
    damping, off = 0.02 * PERIOD, []
    for number, n in enumerate((100, 200)):
        case = bar(pd.Implicit(dt=PERIOD / n, end=PERIOD), start=lambda x, t: 0.1 * np.sin(0.5 * np.pi * x[:, 0]))
        declared = [*case.conditions, pd.RayleighDamping(stiffness=damping)]
        options = {"pd_jacobian": jacobian, "ksp_rtol": 1e-12}
        run = pd.run(dataclasses.replace(case, conditions=declared, options=options), tmp_path / str(number))
        reference = exact(case, np.array(run.history["time"]), damping)
        off.append(np.abs(np.array(run.history["tip"]) - reference).max() / np.abs(reference).max())
        assert np.abs(run.history["error"]).max() < 1e-3
        assert run.history["kinetic"][-1] < 0.8 * run.history["kinetic"][0]
        assert max(step["newton_iterations"] for step in run.summary["steps"]) == 1
    assert off[1] < 1e-3 and off[0] / off[1] == pytest.approx(4.0, rel=0.1)


def spinning(solver, n=5, dim=2):
    """Return a free square that spins and flies."""

    def turn(axis):
        return lambda x, t: 3.0 + (-1.0) ** (axis + 1) * 4.0 * (x[:, 1 - axis] - 0.5)

    return pd.Case(
        particles=pd.Lattice((0.0,) * dim, (1.0,) * dim, 1.0 / n),
        material=pd.NeoHookean(E=E, nu=0.3, density=RHO),
        control=pd.Silling(1.0),
        scheme=pd.Correspondence(),
        horizon=2.015 / n,
        conditions=[pd.InitialVelocity(region.All(), x=turn(0), y=turn(1))],
        solver=solver,
        history={"kinetic": pd.KineticEnergy(), "error": pd.EnergyError()},
        fields=[pd.displacement, pd.velocity],
    )


def momenta(result):
    solution = result.solution
    m, x, v = solution.problem.inertia.mass, solution.x + solution.u, pd.velocity(solution)
    return m @ v, m @ (x[:, 0] * v[:, 1] - x[:, 1] * v[:, 0])


@pytest.mark.parametrize("solver", [pd.Explicit(end=1.0), pd.Implicit(dt=0.01, end=1.0)], ids=["explicit", "implicit"])
def test_a_free_body_keeps_its_momenta_and_energy(solver, tmp_path):
    result = pd.run(spinning(solver), tmp_path)
    linear, angular = momenta(result)
    assert linear == pytest.approx([3.0 * RHO, 3.0 * RHO], rel=1e-9)
    # sum m r^2 of the cells is (1 - 1 / n^2) / 6 of a square.
    spin = RHO * 4.0 * (1.0 - 1.0 / 25.0) / 6.0
    exactly = isinstance(solver, pd.Explicit)
    assert angular == pytest.approx(spin, rel=1e-9 if exactly else 1e-3)
    assert np.abs(result.history["error"]).max() < 1e-3


SPINNING = """
import pdpetsc as pd
from tests.solvers.test_dynamics import spinning


def case(explicit=True, dim=2):
    return spinning(pd.Explicit(end=0.2, records=4) if explicit else pd.Implicit(dt=0.02, end=0.2), dim=dim)
"""


@pytest.mark.parametrize("explicit", ["yes", pytest.param("no", marks=pytest.mark.long)])
def test_ranks_and_matrix_free_steps_move_alike(explicit, tmp_path):
    path = tmp_path / "case.py"
    path.write_text(SPINNING)

    def displacement(name, *words, ranks=1):
        results(path, f"explicit={explicit}", "dim=3", *words, ranks=ranks, output=tmp_path / name)
        with h5py.File(tmp_path / name / "fields.h5") as file:
            last = max(name for name in file if name.startswith("step_"))
            return np.array(file[last]["displacement"])

    one = displacement("one")
    assert displacement("two", ranks=2) == pytest.approx(one, abs=1e-9)
    assert displacement("three", ranks=3) == pytest.approx(one, abs=1e-9)
    if explicit == "no":
        free = displacement("free", "-pd_jacobian", "matfree", "-ksp_rtol", "1e-10")
        assert free == pytest.approx(one, abs=1e-8)


@pytest.mark.parametrize("explicit", [True, False])
def test_a_restart_moves_as_if_the_run_had_not_stopped(explicit, tmp_path):
    solver = pd.Explicit(end=0.2, records=10) if explicit else pd.Implicit(dt=0.02, end=0.2)
    case = dataclasses.replace(spinning(solver), checkpoints=1)
    whole = pd.run(case, tmp_path / "whole")
    half = dataclasses.replace(case, history={**case.history, "stop": Stop(4, "step")})
    with pytest.raises(pd.Interrupted):
        pd.run(half, tmp_path / "half")
    again = pd.run(case, tmp_path / "again", restart=tmp_path / "half")
    assert np.array_equal(again.solution.unknowns, whole.solution.unknowns)
    assert np.array_equal(again.solution.problem.inertia.v, whole.solution.problem.inertia.v)
    # From the record that the run goes on from.
    assert np.array_equal(again.history["error"], whole.history["error"][5:])


def test_long_steps_conserve_energy_and_angular_momentum(tmp_path):
    """A soft square turns by half a radian a step; the plain step of radius 1 gains energy and loses spin."""
    off, spin = {}, RHO * 4.0 * (1.0 - 1.0 / 25.0) / 6.0
    for conserving in (True, False):
        solver = pd.Implicit(dt=0.1, end=1.0, energy_momentum=conserving)
        case = dataclasses.replace(spinning(solver), options={"snes_rtol": 1e-11})
        run = pd.run(case, tmp_path / str(conserving))
        off[conserving] = np.abs(run.history["error"]).max(), abs(momenta(run)[1] / spin - 1.0)
    assert max(off[True]) < 1e-10 and min(off[False]) > 1e-3


def stretched(conserving, *conditions, **changes):
    """Return a soft square that is held at a side, with conserving or plain steps."""
    solver = pd.Implicit(dt=0.2, end=2.0, energy_momentum=conserving, **changes)
    held = pd.Displacement("-x", x=0.0, y=0.0)
    history = {"tip": pd.Mean(pd.displacement, "x", "+x"), "error": pd.EnergyError()}
    case = dataclasses.replace(spinning(solver), conditions=[held, *conditions], history=history)
    return dataclasses.replace(case, options={"snes_rtol": 1e-11})


def test_conserving_steps_begin_at_the_stress_of_the_law(tmp_path):
    """A preload has the equilibrium of the law, and a support may jump at the start."""
    force = pd.Force("+x", x=0.1 * E, schedule=pd.Hold())
    plain, conserving = (
        pd.run(stretched(one, force, preload=True), tmp_path / str(one)).history["tip"] for one in (False, True)
    )
    np.testing.assert_allclose(conserving, plain, rtol=1e-9)
    assert conserving[-1] > 0.05
    pulled = pd.Displacement("+x", x=0.1, schedule=pd.Hold())
    assert np.abs(pd.run(stretched(True, pulled), tmp_path / "jump").history["error"]).max() < 1e-10


def test_damping_by_the_stiffness_is_of_second_order_beside_moving_supports(tmp_path):
    """Velocities of held particles are those of the end of a step, not its mean."""
    tips = []
    for n in (32, 64, 128):
        shaken = [pd.Acceleration("-x", x=3.0), pd.RayleighDamping(stiffness=0.05)]
        case = bar(pd.Implicit(dt=0.4 / n, end=0.4), conditions=shaken)
        tips.append(pd.run(case, tmp_path / str(n)).history["tip"][-1])
    assert (tips[0] - tips[1]) / (tips[1] - tips[2]) == pytest.approx(4.0, rel=0.2)


def dragged(**changes):
    """Return a block on which a tool presses and slides with friction."""
    tool = pd.RigidPlane((0.0, 1.0), (0.0, -1.0), move=(0.3, -0.05))
    case = pd.Case(
        particles=pd.LatticeNodes((0.0, 0.0), (2.0, 1.0), 0.25),
        material=pd.LinearElastic(E=1000.0, nu=0.3, plane="stress", density=1.0),
        conditions=[pd.Clamp("-y"), pd.Contact("+y", tool, 0.3, penetration=0.5)],
        history={"work": pd.ExternalWork(), "lost": pd.DissipatedEnergy()},
        fields=[],
    )
    if "solver" in changes:
        case = dataclasses.replace(case, conditions=[*case.conditions, pd.RayleighDamping(mass=2.0)])
    return dataclasses.replace(case, **changes)


@pytest.mark.parametrize(
    "solver", [pd.Implicit(dt=0.5, end=20.0, radius=0.5), pd.Explicit(end=20.0, records=5, safety=0.5)]
)
def test_a_slow_tool_works_as_in_statics(solver, tmp_path):
    """With friction: work of the tool on its own way, and what friction takes."""
    statics = pd.run(dragged(steps=pd.Steps(20)), tmp_path / "statics").history
    motion = pd.run(dragged(solver=solver), tmp_path / "motion").history
    for name in ("work", "lost"):
        assert motion[name][-1] == pytest.approx(statics[name][-1], rel=5e-3)


def test_friction_that_gives_energy_is_refused(tmp_path):
    """Sticking springs near the stable step: the forces balance their work, which no tool has done."""
    with pytest.raises(pd.SolveError, match=r"does not balance .* take a smaller safety"):
        pd.run(dragged(solver=pd.Explicit(end=20.0, records=5)), tmp_path)


def test_a_restart_of_conserving_steps_is_exact(tmp_path):
    case = spinning(pd.Implicit(dt=0.1, end=0.8, energy_momentum=True), dim=3, n=3)
    case = dataclasses.replace(case, checkpoints=1)
    whole = pd.run(case, tmp_path / "whole")
    with pytest.raises(pd.Interrupted):
        pd.run(dataclasses.replace(case, history={**case.history, "stop": Stop(4, "step")}), tmp_path / "half")
    again = pd.run(case, tmp_path / "again", restart=tmp_path / "half")
    assert np.array_equal(again.solution.unknowns, whole.solution.unknowns)
    assert np.abs(whole.history["error"]).max() < 1e-9


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"material": pd.J2(E=E, nu=0.3, yield_stress=1.0, density=RHO)}, "needs elastic materials"),
        ({"damage": pd.Brittle(pd.ConstantCritical(0.1))}, "does not go with damage"),
        (
            {"material": pd.BondBased(E=E, density=RHO), "scheme": None, "control": None},
            "needs deformation gradients",
        ),
    ],
)
def test_what_does_not_conserve_is_refused(changes, said, tmp_path):
    case = spinning(pd.Implicit(dt=0.1, end=1.0, energy_momentum=True))
    with pytest.raises(pd.CaseError, match=said):
        pd.prepare(dataclasses.replace(case, **changes))
    with pytest.raises(pd.CaseError, match="needs a radius of 1"):
        pd.Implicit(dt=0.1, end=1.0, radius=0.9, energy_momentum=True)


@pytest.mark.parametrize("explicit", [True, False])
@pytest.mark.parametrize(("length", "time", "force"), [(1e-6, 1e-9, 1e-20), (1e3, 1e6, 1e20)])
def test_units_change_nothing(explicit, length, time, force, tmp_path):
    stress = force / length**2
    density = force * time**2 / length**4

    def moved(l=1.0, t=1.0, E=E, rho=RHO):
        solver = pd.Explicit(end=0.4 * t) if explicit else pd.Implicit(dt=0.01 * t, end=0.4 * t)
        case = bar(
            solver,
            particles=pd.LatticeNodes(0.0, LENGTH * l, LENGTH * l / 8),
            material=pd.NeoHookean(E=E, nu=0.0, density=rho),
            conditions=[
                pd.Displacement("-x", x=0.0),
                pd.InitialVelocity(region.All(), x=lambda x, s: 0.5 * x[:, 0] / t),
            ],
        )
        return np.array(pd.run(case, tmp_path / f"{l:g}").history["tip"]) / l

    assert moved(length, time, E * stress, RHO * density) == pytest.approx(moved(), abs=1e-9)


def test_a_moving_support_does_the_work(tmp_path):
    pulled = [pd.Displacement("-x", x=0.0), pd.Displacement("+x", x=lambda x, t: np.full(len(x), 0.02 * t**2))]
    for number, solver in enumerate((pd.Explicit(end=1.0), pd.Implicit(dt=2e-3, end=1.0))):
        found = pd.run(
            bar(solver, conditions=pulled, history={"error": pd.EnergyError(), "work": pd.ExternalWork()}),
            tmp_path / str(number),
        ).history
        assert np.abs(found["error"]).max() < 1e-6
        assert found["work"][-1] == pytest.approx(0.5 * E * 0.02**2, rel=0.2)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (lambda: bar(pd.Explicit(end=1.0), law=pd.LinearElastic(E=E, nu=0.0)), "needs the density of each material"),
        (lambda: bar(pd.Newton(), history={}), "InitialVelocity needs inertia"),
        (
            lambda: bar(pd.Newton(), conditions=[pd.Displacement("-x", x=0.0)]),
            "KineticEnergy needs a motion with inertia",
        ),
        (lambda: pd.Implicit(dt=0.1, end=1.0, radius=1.2), "radius from 0 to 1"),
        (lambda: pd.Implicit(dt=2.0, end=1.0), "at least 1 and at most"),
        (lambda: pd.RayleighDamping(mass=-1.0), "takes a finite number >= 0 as mass"),
        (lambda: pd.RayleighDamping(), "takes a positive mass or stiffness"),
        (
            lambda: bar(
                pd.Implicit(dt=0.1, end=1.0),
                conditions=[pd.RayleighDamping(stiffness=1.0)],
                damage=pd.Brittle(pd.ConstantCritical(0.1)),
            ),
            "would hold the faces of cracks",
        ),
        (
            lambda: bar(pd.Newton(), history={}, conditions=[pd.AbsorbingBoundary("-x")]),
            "AbsorbingBoundary needs inertia",
        ),
        (lambda: pd.Explicit(end=1.0, safety=1.5), "takes a number between 0 and 1 as safety"),
        (lambda: pd.InitialVelocity("-x", x=1.0, schedule=pd.Hold()), "has no schedule"),
    ],
)
def test_what_cannot_move_is_refused(wrong, said, tmp_path):
    with pytest.raises(pd.CaseError, match=said):
        pd.run(wrong(), tmp_path)
    assert not (tmp_path / "summary.json").exists()


def test_a_step_beyond_the_stable_one_is_found_out(tmp_path, monkeypatch):
    monkeypatch.setattr(
        "pdpetsc.solvers.dynamics.explicit.largest_frequency",
        lambda *given, honest=stable_step.largest_frequency: honest(*given) / 1.5,
    )
    with pytest.raises(pd.SolveError, match="the motion is unstable"):
        pd.run(bar(pd.Explicit(end=30 * PERIOD)), tmp_path)


def pressed(end=5.0, stopped=None, **changes):
    """Return a bar at rest that is pressed to half its length within a fifth of the motion, after half of it."""
    conditions = [
        pd.Displacement("-x", x=0.0),
        pd.Displacement("+x", x=lambda x, t: -0.5 * LENGTH * np.clip((t - 0.5) / 0.2, 0.0, 1.0)),
        pd.RayleighDamping(mass=2.0 / end),
    ]
    law = pd.Hencky(E=E, nu=0.0, density=RHO)
    case = bar(pd.Explicit(end=end, records=20), n=40, law=law, conditions=conditions, **changes)
    return (
        case if stopped is None else dataclasses.replace(case, history={**case.history, "stop": Stop(stopped, "step")})
    )


def test_the_time_step_follows_a_body_that_is_pressed_after_a_long_rest(tmp_path):
    """With the logarithmic strain the frequency at half the length is 2.6 times that of the straight bar."""
    records = pd.run(pressed(), tmp_path).summary["steps"]
    assert records[-1]["time step_iterations"] > 2.5 * records[0]["time step_iterations"]


def test_what_the_time_step_follows_goes_on_after_a_restart(tmp_path):
    case = pressed(checkpoints=1)
    whole = pd.run(case, tmp_path / "whole")
    with pytest.raises(pd.Interrupted):
        pd.run(pressed(checkpoints=1, stopped=13), tmp_path / "half")
    again = pd.run(case, tmp_path / "again", restart=tmp_path / "half")
    assert np.array_equal(again.solution.unknowns, whole.solution.unknowns)


def test_rotation_is_no_deformation():
    lattice, law = pd.Lattice((0.0, 0.0), (1.0, 0.5), 0.125), pd.LinearElastic(E=E, nu=0.2, density=RHO)
    prepared = pd.prepare(bar(pd.Explicit(end=1.0), particles=lattice, law=law))
    body, n = prepared.problem.body, prepared.cloud.n_owned
    measure = stable_step.Deformation(body, both=True)

    def since(G, begin=False):
        return measure.since(prepared.problem.state(prepared.cloud.x[:n] @ (np.asarray(G) - np.eye(2)).T, 0.0), begin)

    since(np.eye(2), begin=True)
    assert since([[0.6, 0.8], [-0.8, 0.6]]) < 1e-12
    assert since([[1.0, 0.0], [0.0, 0.8]], begin=True) == pytest.approx(0.25)
    assert since([[1.0, 0.0], [0.0, 1.0]]) == pytest.approx(0.25)


def test_shear_is_a_deformation_without_an_edge():
    """Pure shear by 0.2 changes distances along the axes by 0.02, and presses a diagonal to 0.8 of its length."""
    case = bar(
        pd.Explicit(end=1.0), particles=pd.Lattice((0.0, 0.0), (1.0, 1.0), 0.125), horizon=0.3,
        cell=pd.Cell((0.0, 0.0), (1.0, 1.0)), law=pd.LinearElastic(E=E, nu=0.2, density=RHO),
        conditions=[pd.MeanStrain(xx=0.0, yy=0.0, xy=0.2)],
    )  # fmt: skip
    prepared = pd.prepare(case)
    problem, cloud = prepared.problem, prepared.cloud
    measure, u = stable_step.Deformation(problem.body, both=True), problem.supports.prescribed(1.0).copy()
    u[: cloud.n_owned] = 0.2 * cloud.x[: cloud.n_owned, ::-1]
    measure.since(problem.state(np.zeros_like(u), 0.0), begin=True)
    assert measure.since(problem.state(u, 1.0), begin=False) == pytest.approx(0.25)


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_the_largest_frequency_is_an_upper_bound_close_to_the_exact_one(dim):
    n = {1: 20, 2: 6, 3: 4}[dim]
    case = pd.Case(
        particles=pd.Lattice((0.0,) * dim, (1.0,) * dim, 1.0 / n),
        material=pd.LinearElastic(E=E, nu=0.2, density=RHO),
        solver=pd.Explicit(end=1.0),
    )
    prepared = pd.prepare(case)
    problem, size = prepared.problem, prepared.cloud.n_owned * dim
    state = problem.state(np.zeros((size // dim, dim)))
    tangent = problem.linearised(state)
    K = np.stack([tangent(row.reshape(-1, dim)).flatten() for row in np.eye(size)])
    w = np.sqrt(scipy.linalg.eigh(K, np.diag(np.repeat(problem.inertia.mass, dim)), eigvals_only=True)[-1])
    found = stable_step.largest_frequency(problem, problem.state(np.zeros((size // dim, dim))), problem.inertia.mass)
    assert w * (1.0 - 1e-9) <= found <= w * (1.0 + 3e-3)


@pytest.mark.parametrize("explicit", [True, pytest.param(False, marks=pytest.mark.long)])
@pytest.mark.parametrize("dim", [pytest.param(1, marks=pytest.mark.long), 2])
def test_a_wave_leaves_through_an_absorbing_boundary(explicit, dim, tmp_path):
    """A smooth pulse runs to the right; of its energy less than one in a thousand comes back."""
    n, high = 80, (1.0, 0.1)[:dim]
    solid = pd.LinearElastic(E=E, nu=0.3, density=RHO)
    speed = np.sqrt(solid.moduli(dim)[(0,) * 4] / RHO)

    def pulse(x, t):
        return speed * np.where(np.abs(x[:, 0] - 0.5) < 0.2, 1e-3 * np.sin(np.pi * (x[:, 0] - 0.3) / 0.2) ** 2, 0.0)

    end = 1.5 / speed
    case = pd.Case(
        particles=pd.LatticeNodes((0.0,) * dim, high, 1.0 / n),
        material=solid,
        conditions=[
            pd.InitialVelocity(region.All(), x=pulse),
            pd.AbsorbingBoundary("+x"),
            pd.AbsorbingBoundary("-x"),
            *([pd.Displacement(region.All(), y=0.0)] if dim == 2 else []),
        ],
        solver=pd.Explicit(end=end) if explicit else pd.Implicit(dt=end / 400, end=end),
        history={"kinetic": pd.KineticEnergy(), "strain": pd.StrainEnergy(), "error": pd.EnergyError()},
        fields=[],
    )
    history = pd.run(case, tmp_path).history
    left = (history["kinetic"][-1] + history["strain"][-1]) / history["kinetic"][0]
    assert left < 1e-3
    assert np.abs(history["error"]).max() < 1e-3


@pytest.mark.parametrize(
    "solver", [pd.Explicit(end=PERIOD, preload=True), pd.Implicit(dt=PERIOD / 400, end=PERIOD, preload=True)]
)
def test_a_stretched_bar_is_released(solver, tmp_path):
    """Its end goes back at constant speed and returns after one period of 4 L / c."""
    force = 0.01 * E
    pulled = [pd.Displacement("-x", x=0.0), pd.Traction("+x", x=force, schedule=lambda t: float(t == 0.0))]
    case = bar(solver, n=40, conditions=pulled)
    history = pd.run(case, tmp_path).history
    time, tip = np.array(history["time"])[1:], np.array(history["tip"])[1:]
    exact = 0.01 * LENGTH * (1.0 - 2.0 * np.minimum(time, PERIOD - time) * 2.0 / PERIOD)
    # Short waves follow the front of the long ones.
    assert np.sqrt(((tip - exact) ** 2).mean()) < 0.04 * 0.01 * LENGTH
    assert np.abs(history["error"]).max() < 2e-3


def test_a_body_without_supports_has_no_equilibrium_to_start_from(tmp_path):
    flying = [pd.Traction("+x", x=1.0, schedule=pd.Hold())]
    with pytest.raises(pd.SolveError):
        pd.run(bar(pd.Implicit(dt=0.1, end=1.0, preload=True), conditions=flying), tmp_path)


@pytest.mark.parametrize("solver", [pd.Explicit(end=1.2, safety=0.3), pd.Implicit(dt=0.003, end=1.2)])
@pytest.mark.parametrize("penetration", [0.02, pytest.param(0.1, marks=pytest.mark.long)])
def test_a_tool_at_rest_gives_no_energy(solver, penetration, tmp_path):
    """A block that hits a plane without friction leaves it no faster than it came, or the run says why not."""
    case = pd.Case(
        particles=pd.LatticeNodes((0.0, 0.0), (1.0, 0.5), 0.125),
        material=pd.NeoHookean(E=E, nu=0.3, density=RHO),
        conditions=[
            pd.InitialVelocity(region.All(), x=-1.0),
            pd.Contact("-x", pd.RigidPlane((-0.05, 0.0), (1.0, 0.0)), penetration=penetration, name="wall"),
        ],
        solver=solver,
        history={"kinetic": pd.KineticEnergy(), "error": pd.EnergyError()},
        fields=[],
    )
    try:
        history = pd.run(case, tmp_path).history
    except pd.SolveError as error:
        assert penetration < 0.1 and "raise its stiffness" in str(error)
        return
    assert max(np.abs(history["error"])) < 0.05
    assert history["kinetic"][-1] <= 1.05 * history["kinetic"][0]


def breaking(solver, law):
    """Return a bar of bonds that is held at its left end; its right end is thrown off."""
    return pd.Case(
        particles=pd.Lattice((0.0, 0.0), (2.0, 0.5), 0.1),
        horizon=0.3015,
        material=pd.BondBased(E=E, plane="strain", density=RHO),
        damage=law,
        conditions=[
            pd.Displacement(region.Slab("x", high=1.0), x=0.0, y=0.0),
            pd.InitialVelocity(region.Slab("x", low=1.7), x=1.0),
        ],
        solver=solver,
        history={"broken": pd.BrokenBonds(), "kinetic": pd.KineticEnergy(), "error": pd.EnergyError()},
        results=lambda h: {
            "broken": h["broken"][-1],
            "kinetic": h["kinetic"][-1],
            # With Implicit nothing tells the energy of bonds that snap.
            "off": max((abs(error) for error in h["error"] if np.isfinite(error)), default=0.0),
        },
        fields=[],
    )


BREAKING = """
import pdpetsc as pd
from tests.solvers.test_dynamics import breaking


def case(explicit=True):
    solver = pd.Explicit(end=0.3) if explicit else pd.Implicit(dt=2e-3, end=0.3)
    return breaking(solver, pd.Brittle(pd.ConstantCritical(0.02)))
"""


@pytest.mark.parametrize("explicit", ["yes", pytest.param("no", marks=pytest.mark.long)])
def test_supports_and_failing_bonds_on_other_ranks(explicit, tmp_path):
    """Supports are on the first rank alone, bonds break on the last."""
    path = tmp_path / "case.py"
    path.write_text(BREAKING)
    words = [path, f"explicit={explicit}"]
    one, two, three = (results(*words, ranks=n, output=tmp_path / str(n))["results"] for n in (1, 2, 3))
    assert one["broken"] > 0
    assert two == pytest.approx(one, rel=1e-6, abs=1e-9)
    assert three == pytest.approx(one, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("model", ["brittle", "softening", "correspondence"])
def test_the_energy_of_failing_bonds_is_counted(model, tmp_path):
    law = pd.Brittle(pd.ConstantCritical(0.02))
    if model == "softening":
        law = pd.LinearSoftening(pd.ConstantCritical(0.01), 4.0)
    case = breaking(pd.Explicit(end=0.3), law)
    if model == "correspondence":
        solid = {"material": pd.LinearElastic(E=E, nu=0.25, density=RHO), "scheme": pd.Correspondence()}
        case = dataclasses.replace(case, **solid, control=pd.Silling(1.0), weights=pd.Standard())
    history = pd.run(case, tmp_path).history
    assert history["broken"][-1] > 0
    assert np.abs(history["error"]).max() < 1e-9


def test_a_motion_that_fails_between_records_goes_on_from_its_last_checkpoint(tmp_path):
    """What fails between two records leaves an earlier checkpoint as it is."""

    def thrown(fails):
        def held(x, t):
            return np.full(len(x), np.nan if fails and 0.55 < t < 0.9 else 0.0)

        return dataclasses.replace(
            breaking(pd.Explicit(end=0.3, records=10), pd.Brittle(pd.ConstantCritical(0.02))),
            checkpoints=3,
            conditions=[
                pd.Displacement(region.Slab("x", high=1.0), x=held, y=0.0),
                pd.InitialVelocity(region.Slab("x", low=1.7), x=1.0),
            ],
        )

    whole = pd.run(thrown(False), tmp_path / "whole")
    with pytest.raises(pd.SolveError):
        pd.run(thrown(True), tmp_path / "stopped")
    again = pd.run(thrown(False), tmp_path / "again", restart=tmp_path / "stopped", restart_anyway=True)
    assert np.array_equal(again.solution.unknowns, whole.solution.unknowns)


@pytest.mark.parametrize("explicit", [True, False])
def test_a_restart_takes_other_records_but_no_other_end(explicit, tmp_path):
    def solver(end=0.2, every=1):
        if explicit:
            return pd.Explicit(end=end, records=10 // every)
        return pd.Implicit(dt=0.02, end=end, every=every)

    case = dataclasses.replace(spinning(solver()), checkpoints=1)
    half = dataclasses.replace(case, history={**case.history, "stop": Stop(4, "step")})
    with pytest.raises(pd.Interrupted):
        pd.run(half, tmp_path / "half")
    whole = pd.run(case, tmp_path / "whole")
    other = dataclasses.replace(case, solver=solver(every=3))
    again = pd.run(other, tmp_path / "other", restart=tmp_path / "half", restart_anyway=True)
    assert again.solution.u == pytest.approx(whole.solution.u, abs=1e-3)
    with pytest.raises(pd.CaseError, match="Use the same end"):
        longer = dataclasses.replace(case, solver=solver(end=0.4))
        pd.run(longer, tmp_path / "longer", restart=tmp_path / "half", restart_anyway=True)


def test_steps_of_the_case_are_refused(tmp_path):
    with pytest.raises(pd.CaseError, match="has time steps of its own"):
        pd.run(bar(pd.Explicit(end=1.0), steps=pd.Steps(4)), tmp_path)


def test_a_body_that_heats_up_moves(tmp_path):
    steel = pd.Thermal(pd.LinearElastic(E=E, nu=0.3, density=RHO), expansion=1e-3, reference=0.0)
    heated = [pd.Displacement("-x", x=0.0), pd.Temperature(region.All(), 10.0)]
    history = pd.run(bar(pd.Explicit(end=10 * PERIOD), law=steel, conditions=heated), tmp_path).history
    assert history["tip"][-1] == pytest.approx(0.01, rel=0.05)
    assert np.isnan(history["error"]).all()


def graded(least_step=None, unit=1.0, end=4.0, **changes):
    """Return a bar whose right half has half the spacing, pulled slowly at its end, with mass-proportional damping."""
    coarse, fine = np.arange(20) + 0.5, 20.0 + 0.5 * np.arange(40) + 0.25
    x = unit * np.concatenate([coarse, fine])[:, None]
    sizes = unit * np.concatenate([np.ones(20), np.full(40, 0.5)])
    case = pd.Case(
        particles=pd.Arrays(x, sizes),
        horizon=pd.Horizon(2.015),
        material=pd.LinearElastic(E=1.0, nu=0.0, density=1.0),
        conditions=[
            pd.Displacement(pd.region.Slab("x", high=2.0 * unit), x=0.0),
            pd.Displacement(
                pd.region.Slab("x", low=39.0 * unit), x=lambda x, t: 0.1 * unit * t**2 * (3.0 - 2.0 * t) + 0.0 * x[:, 0]
            ),
            pd.RayleighDamping(mass=0.05 / unit),
        ],
        solver=pd.Explicit(end=end * 100.0 * unit, records=4, least_step=least_step),
        fields=[],
    )
    return dataclasses.replace(case, **changes)


def first_step(case):
    """Return time step, masses and description of the solver of a case."""
    prepared = pd.prepare(case)
    solver = prepared.make_solver()
    problem = prepared.problem
    state = problem.state(np.zeros(problem.supports.fixed.shape))
    frequency = stable_step.largest_frequency(problem, state, problem.inertia.mass)
    return 2.0 * case.solver.safety / frequency, problem.inertia.mass.copy(), solver.description()


def test_mass_is_added_where_the_time_step_is_too_short():
    dt, mass, said = first_step(graded())
    assert "added" not in said
    # Less than the stable step: nothing is added. The bound with one factor for the body is not far above the step.
    same, as_it_is, said = first_step(graded(least_step=0.7 * dt))
    assert same == dt and np.array_equal(as_it_is, mass) and "0 % of the mass added" in said
    longer, more, said = first_step(graded(least_step=1.5 * dt))
    assert 1.5 * dt * (1.0 - 1e-2) <= longer <= 1.8 * dt
    assert np.array_equal(more[:18], mass[:18])
    assert np.all(more[24:58] > 1.2 * mass[24:58])
    assert f"{100.0 * (more[2:-2].sum() / mass[2:-2].sum() - 1.0):.3g} % of the mass added" in said
    for unit in (1e-6, 1e6):
        other, scaled, _ = first_step(graded(least_step=1.5 * dt * unit, unit=unit))
        assert other == pytest.approx(unit * longer, rel=1e-6)
        np.testing.assert_allclose(scaled, unit * more, rtol=1e-6)


def test_a_slow_process_is_the_same_with_added_mass_in_fewer_steps(tmp_path):
    dt, _, _ = first_step(graded())
    static = graded(solver=pd.Newton(), conditions=graded().conditions[:2])
    exact = pd.run(static, tmp_path / "static").solution.u
    counts = []
    for name, least in (("as it is", None), ("added", 1.5 * dt)):
        run = pd.run(graded(least_step=least, end=20.0), tmp_path / name)
        assert np.abs(run.solution.u - exact).max() < 1e-3 * np.abs(exact).max(), name
        counts.append(sum(step["time step_iterations"] for step in run.summary["steps"]))
    assert counts[1] < 0.7 * counts[0]


def test_added_mass_is_the_same_after_a_restart(tmp_path):
    case = graded(least_step=1.0)
    whole = pd.run(case, tmp_path / "whole").solution.u
    with pytest.raises(pd.Interrupted):
        pd.run(dataclasses.replace(case, history={"stop": Stop(0.5)}), tmp_path / "half")
    again = pd.run(case, tmp_path / "again", restart=tmp_path / "half", restart_anyway=True).solution.u
    assert np.array_equal(whole, again)
    for other in (graded(), graded(least_step=1.2)):
        with pytest.raises(pd.CaseError, match="of the mass added, not"):
            pd.run(other, tmp_path / "other", restart=tmp_path / "half", restart_anyway=True)


def test_added_mass_keeps_the_rate_of_damping_and_the_mass_of_fragments(tmp_path, caplog):
    run = pd.run(graded(least_step=1.0), tmp_path)
    inertia = run.solution.problem.inertia
    np.testing.assert_allclose(inertia.damper[:, 0, 0] / inertia.mass, 0.05, rtol=1e-12)
    free = inertia.mass[2:-2].sum() / inertia.own_mass[2:-2].sum() - 1.0
    assert run.summary["added_mass"] == pytest.approx(free, rel=1e-9) and free > 0.05
    assert "of the mass are added" in caplog.text
    names, rows = fragments_of(run.solution.problem, run.solution.u)
    assert rows[0, names.index("mass")] == pytest.approx(inertia.own_mass.sum())
    open_end = graded(least_step=1.0)
    open_end = dataclasses.replace(
        open_end,
        particles=pd.LatticeNodes(0.0, 40.0, 1.0), horizon=2.015,
        conditions=[pd.Displacement("-x", x=0.0), pd.AbsorbingBoundary("+x")],
    )  # fmt: skip
    with pytest.raises(pd.CaseError, match="does not go with AbsorbingBoundary"):
        pd.run(open_end, tmp_path / "open")


def struck(law=None, viscosity=None, dim=1, unit=1.0, **changes):
    """Return a bar whose end is pushed at a tenth of the speed of its waves."""
    n = 40
    given = {
        "particles": pd.LatticeNodes((0.0,) * dim, (unit, *[0.1 * unit] * (dim - 1)), unit / n),
        "material": law or pd.LinearElastic(E=1.0, nu=0.0, density=1.0),
        "conditions": [pd.Velocity("-x", x=0.1), *([] if viscosity is None else [viscosity])],
        "solver": pd.Explicit(end=0.5 * unit, safety=0.5, records=5),
        "history": {"error": pd.EnergyError(), "kinetic": pd.KineticEnergy(), "stored": pd.StrainEnergy()},
        "fields": [],
    }
    return pd.Case(**(given | changes))


def behind_the_front(run):
    """Return the strains of a bar between a tenth and 0.4 of its length, where a wave has passed."""
    x, u = run.solution.x[:, 0], run.solution.u[:, 0]
    order = np.argsort(x)
    strain = np.diff(u[order]) / np.diff(x[order])
    middle = 0.5 * (x[order][1:] + x[order][:-1]) / x.max()
    return strain[(middle > 0.1) & (middle < 0.4)]


@pytest.mark.parametrize("law", [None, pd.Hencky(E=1.0, nu=0.0, density=1.0)], ids=["linear", "hencky"])
def test_bulk_viscosity_damps_what_follows_a_shock(law, tmp_path):
    """The strain behind the front is about -v / c; oscillations about it are halved, and the energy balances."""
    plain = behind_the_front(pd.run(struck(law), tmp_path / "plain"))
    run = pd.run(struck(law, pd.BulkViscosity()), tmp_path / "viscous")
    damped = behind_the_front(run)
    assert np.std(damped) < 0.6 * np.std(plain)
    assert damped.mean() == pytest.approx(-0.1, rel=0.05 if law is None else 0.12)
    assert np.abs(run.history["error"]).max() < 2e-3


@pytest.mark.parametrize(
    "damping", [pd.BulkViscosity(), pd.RayleighDamping(stiffness=0.01)], ids=["shock", "stiffness"]
)
def test_the_energy_balances_with_viscous_forces_after_a_restart(damping, tmp_path):
    """The first step took half of the work of its viscous forces."""
    case = struck(None, damping)
    whole = pd.run(case, tmp_path / "whole").history["error"]
    half = dataclasses.replace(case, history={**case.history, "stop": Stop(2, "step")})
    with pytest.raises(pd.Interrupted):
        pd.run(half, tmp_path / "half")
    again = pd.run(case, tmp_path / "again", restart=tmp_path / "half").history["error"]
    np.testing.assert_allclose(again, whole[3:], atol=1e-12)


def test_bulk_viscosity_does_not_resist_rotation_and_takes_the_units_of_the_case(tmp_path):
    still = spinning(pd.Explicit(end=0.05, records=1), dim=2)
    more = dataclasses.replace(still, conditions=[*still.conditions, pd.BulkViscosity()])
    viscosity = pd.prepare(more).problem.inertia.viscosity
    problem = viscosity._problem
    x = problem.body.cloud.x
    spin = np.stack([-x[:, 1], x[:, 0]], axis=1)
    force = viscosity.force(problem.state(np.zeros_like(x)), spin)
    swell = viscosity.force(problem.state(np.zeros_like(x)), x.copy())
    assert np.abs(force).max() < 1e-12 * np.abs(swell).max()
    one, small = (
        pd.run(struck(None, pd.BulkViscosity(), unit=u), tmp_path / f"{u:g}").solution.u / u for u in (1.0, 1e-6)
    )
    np.testing.assert_allclose(small, one, atol=1e-9)


def test_bulk_viscosity_acts_alike_on_two_ranks_and_is_refused_elsewhere(tmp_path):
    text = (
        "import sys\nimport numpy as np\nimport pdpetsc as pd\nfrom tests.solvers.test_dynamics import struck\n"
        "u = pd.run(struck(pd.Hencky(E=1.0, nu=0.2, density=1.0), pd.BulkViscosity(), dim=2), output=sys.argv[1])"
        ".gathered(pd.displacement)\nif u is not None:\n    np.save(sys.argv[2], u)\n"
    )
    for ranks in (1, 2):
        script_on(ranks, text, tmp_path / f"run{ranks}", tmp_path / f"u{ranks}.npy")
    one, two = (np.load(tmp_path / f"u{ranks}.npy") for ranks in (1, 2))
    np.testing.assert_allclose(two, one, atol=1e-12)
    with pytest.raises(pd.CaseError, match="is for Explicit"):
        pd.run(struck(None, pd.BulkViscosity(), solver=pd.Implicit(dt=0.1, end=0.5)), tmp_path / "implicit")
    with pytest.raises(pd.CaseError, match="needs deformation gradients"):
        pd.run(struck(pd.BondBased(E=1.0, density=1.0), pd.BulkViscosity()), tmp_path / "bonds")
    with pytest.raises(pd.CaseError, match="second BulkViscosity"):
        twice = struck(None, pd.BulkViscosity())
        pd.run(dataclasses.replace(twice, conditions=[*twice.conditions, pd.BulkViscosity()]), tmp_path / "twice")
    with pytest.raises(pd.CaseError, match="BulkViscosity needs inertia"):
        still = struck(None, pd.BulkViscosity(), solver=pd.Newton())
        pd.run(dataclasses.replace(still, conditions=[pd.Clamp("-x"), pd.BulkViscosity()]), tmp_path / "still")


def test_a_restart_with_bulk_viscosity_is_bitwise(tmp_path):
    law = pd.Hencky(E=1.0, nu=0.0, density=1.0)
    case = struck(law, pd.BulkViscosity(), solver=pd.Explicit(end=0.3, records=4))
    case = dataclasses.replace(case, particles=pd.LatticeNodes(0.0, 1.0, 0.005))
    case = dataclasses.replace(case, conditions=[pd.Velocity("-x", x=0.2), pd.BulkViscosity()])
    whole = pd.run(case, tmp_path / "whole").solution.u
    with pytest.raises(pd.Interrupted):
        pd.run(dataclasses.replace(case, history={"stop": Stop(0.5)}), tmp_path / "half")
    again = pd.run(case, tmp_path / "again", restart=tmp_path / "half", restart_anyway=True).solution.u
    assert np.array_equal(whole, again)


@pytest.mark.parametrize("damping", [pd.BulkViscosity(), pd.RayleighDamping(stiffness=0.02)])
def test_damping_by_gradients_is_refused_in_a_cell(damping, tmp_path):
    """Images would have the velocity of their particle without that of the cell."""
    case = pd.Case(
        particles=pd.Lattice((0.0, 0.0), (4.0, 1.0), 0.25), cell=pd.Cell((0.0, 0.0), (4.0, 1.0), axes="x"),
        material=pd.LinearElastic(E=1.0, nu=0.0, density=1.0),
        conditions=[pd.MeanStrain(xx=-0.1), damping], solver=pd.Explicit(end=1.0),
    )  # fmt: skip
    with pytest.raises(pd.CaseError, match="do not go with a periodic cell"):
        pd.run(case, tmp_path)


def test_prescribed_particles_have_kinetic_energy_without_work(tmp_path):
    """Seven eighths of a mass of 2 are driven to the velocity 10: work and reaction are those of the last eighth."""
    case = pd.Case(
        pd.Lattice((0.0, 0.0), (2.0, 1.0), 0.25),
        material=pd.LinearElastic(1e4, 0.0, density=1.0),
        conditions=[pd.Acceleration(region.Slab("x", high=1.8), x=10.0, y=0.0)],
        solver=pd.Implicit(dt=0.01, end=1.0),
        history={"kinetic": pd.KineticEnergy(), "work": pd.ExternalWork(), "force": pd.Reaction("x")},
    )
    found = pd.run(case, tmp_path).history
    assert found["kinetic"][-1] == pytest.approx(100.0, rel=0.01)
    assert found["work"][-1] == pytest.approx(12.5, rel=0.01)
    assert found["force"].mean() == pytest.approx(2.5, rel=0.02)
