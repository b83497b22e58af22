"""Contact with rigid tools: patch, Hertz, tangent, friction, ranks, units, restart, and what is refused."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import pdpetsc as pd
from tests.commands import results

E, NU = 1000.0, 0.3
PRESS = pd.RigidPlane((0.0, 1.0), (0.0, -1.0), move=(0.0, -0.05))


def block(tool=PRESS, friction=0.0, unit=1.0, modulus=E, **changes):
    """Return half of a block of 4 x 1, on rollers below, that a tool presses from above."""
    if unit != 1.0:
        tool = dataclasses.replace(tool, point=[unit * x for x in tool.point], move=[unit * x for x in tool.move])
    case = pd.Case(
        particles=pd.LatticeNodes((0.0, 0.0), (2.0 * unit, unit), 0.125 * unit),
        material=pd.LinearElastic(E=modulus, nu=NU, plane="stress"),
        conditions=[pd.Roller("-x"), pd.Roller("-y"), pd.Contact("+y", tool, friction, name="tool")],
        history={"top": pd.Mean(pd.displacement, "y", "+y"), "right": pd.Mean(pd.displacement, "x", "+x")},
        fields=[pd.displacement, pd.stress],
        steps=pd.Steps(2),
    )
    return dataclasses.replace(case, **changes)


@pytest.mark.parametrize("cells", [False, True])
def test_a_plane_presses_uniformly(cells, tmp_path):
    """Uniaxial stress: forces on facets are in equilibrium with it, on nodes to round-off."""
    particles = pd.Lattice((0.0, 0.0), (2.0, 1.0), 0.125) if cells else block().particles
    run = pd.run(block(particles=particles, weights=pd.Conforming(), horizon=0.125 * 2.015), tmp_path)
    stress = run.field("stress")
    # The tool is 1e-3 of its way in the body: the penalty is a hundred times as stiff as a cell.
    strain = run.history["tool_y"][-1] / 2.0 / E
    assert strain == pytest.approx(-0.05, rel=3e-3)
    np.testing.assert_allclose(stress[:, 1, 1], E * strain, rtol=1e-7)
    np.testing.assert_allclose(stress[:, 0, 0], 0.0, atol=1e-7 * E)
    assert run.history["tool_area"][-1] == pytest.approx(2.0)
    assert run.history["right"][-1] == pytest.approx(-NU * 2.0 * strain, rel=0.1 if cells else 1e-7)


def cylinder(**given):
    return pd.RigidSphere((0.0, 3.0), 2.0, **{"move": (0.01, -0.02), **given})


@pytest.mark.parametrize("friction", [0.0, 0.3, 5.0])
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


def test_friction_goes_on_from_a_checkpoint(tmp_path):
    case = block(dataclasses.replace(PRESS, move=(0.05, -0.05)), 0.3, steps=pd.Steps(4))
    whole = pd.run(case, tmp_path / "whole").history

    half = dataclasses.replace(case, steps=pd.Steps(4), history={**case.history, "stop": Stopping()})
    with pytest.raises(Exception, match="stops here"):
        pd.run(half, tmp_path / "half")
    again = pd.run(case, tmp_path / "again", restart=tmp_path / "half")
    assert again.history["tool_x"][-1] == whole["tool_x"][-1]
    assert again.history["tool_y"][-1] == whole["tool_y"][-1]


class Stopping(pd.Quantity):
    """Ends a run at half of the load."""

    def evaluate(self, solution):
        if solution.t > 0.6:
            raise pd.SolveError("It stops here.")
        return 0.0


def test_a_block_is_dragged_with_the_coefficient_of_friction(tmp_path):
    """A plane that presses and then slides: all facets slide, with mu times the normal force."""

    tool = pd.RigidPlane((0.0, 1.0), (0.0, -1.0), move=(0.4, -0.02))
    case = block(tool, 0.2, conditions=[pd.Clamp("-y"), pd.Contact("+y", tool, 0.2, name="tool")], steps=pd.Steps(4))
    history = pd.run(case, tmp_path).history
    np.testing.assert_allclose(history["tool_x"][1:], -0.2 * history["tool_y"][1:], rtol=1e-9)


def test_what_contact_cannot_do_is_refused(tmp_path):
    with pytest.raises(pd.CaseError, match="overlaps the body by"):
        pd.prepare(block(pd.RigidPlane((0.0, 0.9), (0.0, -1.0))))
    with pytest.raises(pd.SolveError, match="spacings deep in the body"):
        soft = [pd.Roller("-x"), pd.Roller("-y"), pd.Contact("+y", PRESS, stiffness=E)]
        pd.run(block(conditions=soft), tmp_path)
    with pytest.raises(pd.CaseError, match="rigid motions"):
        pd.prepare(block(conditions=[pd.Roller("-x"), pd.Contact("+y", PRESS)]))
    with pytest.raises(pd.CaseError, match="friction"):
        pd.Contact("+y", PRESS, friction=-0.1)
    with pytest.raises(pd.CaseError, match="moves by 3 numbers in 2 dimensions"):
        pd.prepare(block(dataclasses.replace(PRESS, move=(0.0, 0.0, 0.0))))
    with pytest.raises(pd.CaseError, match="bodies in space"):
        pd.prepare(block(pd.RigidCylinder((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 1.0)))


def test_a_cylinder_presses_as_hertz_says(tmp_path):
    found = results("runs/contact/roller.py", "n=40", "radius=8.0", output=tmp_path)["results"]
    assert found["half_width_over_hertz"] == pytest.approx(1.0, abs=0.03)
    assert found["peak_over_hertz"] == pytest.approx(1.0, abs=0.06)
    assert found["pressure_error"] < 0.08
