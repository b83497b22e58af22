"""Tools that move with the load factor of a path: derivatives, load steps, ranks, restart, refusals."""

from __future__ import annotations

import dataclasses
import weakref

import numpy as np
import pytest

import pdpetsc as pd
from pdpetsc.errors import CaseError
from pdpetsc.solvers.balance import EnergyBalance
from tests.commands import results

TEXT = """
import pdpetsc as pd

def case(friction=0.3, end=0.015, step=0.003, load=0.05):
    tip, foot = pd.region.Nearest((2.0, 1.0)), pd.region.Nearest((1.0, 0.0))
    tool = pd.RigidSphere((1.0, 1.5), 0.5, move=(0.0, -load))
    return pd.Case(
        particles=pd.LatticeNodes((0.0, 0.0), (2.0, 1.0), 0.125),
        material=pd.Hencky(E=1e3, nu=0.3, plane="stress"),
        conditions=[pd.Clamp("-x"), pd.Contact("+y", tool, friction, penetration=0.05, name="tool")],
        solver=pd.PathFollowing(pd.Opening("y", foot, against=tip, step=step, end=end), first=0.02, until=0.0),
        history={"tip": pd.Mean(pd.displacement, "y", tip), "work": pd.ExternalWork(), "energy": pd.StrainEnergy()},
        results=lambda h: {name: h[name][-1] for name in ("t", "tool_x", "tool_y", "tip", "work")},
    )
"""


def case(**values):
    names = {}
    exec(TEXT, names)
    return names["case"](**values)


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_a_path_has_the_equilibria_of_load_steps(friction, tmp_path):
    """Newton's method converges quadratically, as it does only with the derivative by the load factor."""
    of_path = case(friction=friction)
    path = pd.run(of_path, tmp_path / "path")
    times = [float(t) for t in path.history["t"][1:]]
    assert len(times) > 5 and times[-1] > 0.3
    assert path.history["tip"][-1] < -0.015
    steps = dataclasses.replace(of_path, solver=pd.Newton(), steps=pd.Steps(times=[*times, 1.0]))
    loaded = pd.run(steps, tmp_path / "steps").history
    for name in ("tool_x", "tool_y", "tip", "work", "energy"):
        of_steps = loaded[name][: len(times) + 1]
        np.testing.assert_allclose(path.history[name], of_steps, rtol=1e-8, atol=1e-10 * abs(of_steps[-1]))
    if not friction:
        assert path.history["work"][-1] == pytest.approx(path.history["energy"][-1], rel=0.1)
    for step in path.summary["steps"][1:]:
        before, last_but_one = np.array(step["norms"][-3:-1]) / step["reference"]
        assert last_but_one < before**1.5
    # Rounding decides which particles stick first, after the step in which the tool just touches.
    iterations = [step["newton_iterations"] for step in path.summary["steps"][1:]]
    assert iterations[0] <= 4
    assert max(iterations[1:]) <= 3


def beside_a_mirror():
    """Return a block whose tool moves towards its mirror plane."""
    tool = pd.RigidSphere((0.0, 1.5), 0.5, move=(-0.1, -0.1))
    return pd.Case(
        particles=pd.Lattice((0.0, 0.0), (2.0, 1.0), 0.125),
        material=pd.LinearElastic(E=1e3, nu=0.3),
        symmetry=[pd.Symmetry("x")],
        conditions=[pd.Clamp("-y"), pd.Contact("+y", tool, penetration=0.5, name="tool")],
    )


def in_a_cell():
    """Return a block in a cell, over which a plane is dragged."""
    tool = pd.RigidPlane((0.0, 1.0, 0.0), (0.0, -1.0, 0.0), move=(0.5, -0.02, 0.1))
    return pd.Case(
        particles=pd.Lattice((0.0, 0.0, 0.0), (4.0, 1.0, 4.0), 0.5),
        material=pd.LinearElastic(E=1e3, nu=0.3),
        cell=pd.Cell((0.0, 0.0, 0.0), (4.0, 1.0, 4.0), "xz"),
        conditions=[
            pd.Clamp("-y"),
            pd.Contact("+y", tool, 0.3, penetration=0.5, name="tool"),
            pd.MeanStrain(xx=0.0, zz=0.0, xz=0.0),
        ],
    )


@pytest.mark.parametrize(
    "make",
    [lambda: case(friction=0.0), lambda: case(friction=0.3), beside_a_mirror, in_a_cell],
    ids=["smooth", "friction", "mirror", "cell"],
)
def test_the_derivative_by_the_load_factor_is_that_of_the_forces(make):
    problem = pd.prepare(make()).problem
    u = np.zeros(problem.supports.fixed.shape)
    h = 1e-6

    def force(t):
        return problem.force_of_tools(problem.state(u, t)).copy()

    exact = problem.force_by_tools(problem.state(u, 0.4))
    difference = (force(0.4 + h) - force(0.4 - h)) / (2.0 * h)
    assert np.abs(exact).max() > 1.0
    np.testing.assert_allclose(difference, exact, atol=1e-6 * np.abs(exact).max())


def test_round_off_of_a_tool_at_rest_does_not_keep_another_from_touching(tmp_path):
    """The beam lies on a table, which it overlaps by round-off, before the moving tool touches it."""
    scene = case(friction=0.0, end=0.006)
    clamp, contact = scene.conditions
    far = dataclasses.replace(contact, tool=pd.RigidSphere((1.0, 1.503), 0.5, move=(0.0, -0.05)))
    table = pd.Contact("-y", pd.RigidBox((-0.2, -0.3), (0.4, 5e-12)), penetration=0.05, name="table")
    run = pd.run(dataclasses.replace(scene, conditions=[clamp, far, table]), tmp_path)
    assert run.history["tool_y"][1] == 0.0
    assert run.history["tool_y"][-1] < -0.5


def test_the_energy_balance_allows_for_tools_whose_force_is_not_linear(tmp_path):
    """One step of unloading: the trapezoidal rule takes too much work from a contact that grows."""
    scene = dataclasses.replace(
        case(friction=0.0),
        particles=pd.Lattice((0.0, 0.0), (2.0, 1.0), 0.25),
        material=pd.LinearElastic(E=1e3, nu=0.3),
        damage=pd.Brittle(pd.ConstantCritical(1.0)),
        solver=pd.Newton(),
        steps=pd.Steps(4),
    )
    solution = pd.run(scene, tmp_path).solution
    problem, u = solution.problem, solution.unknowns
    balance = EnergyBalance(problem, problem.state(u, 1.0), {})
    undeformed = problem.state(0.0 * u)
    balance.pass_by(undeformed)
    assert -balance.work > 1.1 * sum(solution.energies.values())
    assert not balance.broken_by(undeformed)
    # What the state has cached is freed.
    cached = weakref.ref(undeformed)
    del undeformed
    problem.state(u, 1.0)
    assert cached() is None


def test_ranks_matrices_and_restarts_agree(tmp_path):
    file = tmp_path / "pressed.py"
    file.write_text(TEXT)
    one = results(file, ranks=1, output=tmp_path / "one")["results"]
    for name, words, ranks in (("two", [], 2), ("free", ["-pd_jacobian", "matfree"], 1)):
        other = results(file, *words, ranks=ranks, output=tmp_path / name)["results"]
        assert other == pytest.approx(one, rel=1e-6), name
    results(file, "end=0.009", ranks=1, output=tmp_path / "half")
    again = results(file, "--restart", tmp_path / "half", ranks=1, output=tmp_path / "again")["results"]
    assert again == pytest.approx(one, rel=1e-4)
    assert again["tool_y"] == pytest.approx(one["tool_y"], rel=1e-9)


@pytest.mark.parametrize(
    "changes",
    [{"turn": 0.1, "about": (1.0, 1.5)}, {"schedule": pd.Table([0.0, 0.5, 1.0], [0.0, 0.1, 1.0])}],
    ids=["turn", "table"],
)
def test_tools_that_do_not_move_in_proportion_are_refused(changes, tmp_path):
    scene = case()
    clamp, contact = scene.conditions
    tool = dataclasses.replace(contact.tool, **changes)
    scene = dataclasses.replace(scene, conditions=[clamp, dataclasses.replace(contact, tool=tool)])
    with pytest.raises(CaseError, match="tools that move in proportion"):
        pd.run(scene, tmp_path)
