"""Contact of bodies: patch tests, tangent, moments, friction, ranks, units, restart, collisions, refusals."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import scipy

import pdpetsc as pd
from pdpetsc.declare.region import View
from pdpetsc.gradient.pair_product import FacetPairs, MovingFacets, PairProduct
from pdpetsc.kernels.overlap import AREA, QUANTITIES, overlap, overlap_by_fields
from pdpetsc.problem.assembly import Assembler
from pdpetsc.terms.facing import Side, _halves
from tests.commands import Stop, called, results

E, NU = 1000.0, 0.3


def block(low, high, spacing, angle=0.0):
    """Return nodes of a plane block, turned about the origin."""
    nodes = pd.LatticeNodes(low, high, spacing)
    if angle == 0.0:
        return nodes
    turn = np.array([(np.cos(angle), -np.sin(angle)), (np.sin(angle), np.cos(angle))])
    chunk, facets = nodes.chunk(0, 1), nodes.surface()
    x, area, particle, tags = facets.arrays
    return pd.Arrays(chunk.x @ turn.T, chunk.volume, facets=pd.Facets(x @ turn.T, area @ turn.T, particle, tags))


def stacked(spacings=(0.25, 0.2), unit=1.0, modulus=E, nu=0.0, top=-0.1, friction=0.0, **changes):
    """Return a block on another one of other spacing, pressed from above: the height changes by 5 percent."""
    lower = pd.LatticeNodes((0.0, 0.0), (2.0 * unit, unit), spacings[0] * unit)
    upper = pd.LatticeNodes((0.0, unit), (2.0 * unit, 2.0 * unit), spacings[1] * unit)
    case = pd.Case(
        particles=pd.Bodies({"lower": lower, "upper": upper}),
        material=pd.LinearElastic(E=modulus, nu=nu, plane="stress"),
        conditions=[
            pd.Roller("lower -y"),
            pd.Roller("-x"),
            pd.Displacement("upper +y", y=top * unit),
            pd.BodyContact("lower +y", "upper -y", friction, penetration=1e-7, name="pair"),
        ],
        history={"interface": pd.Mean(pd.displacement, "y", "lower +y")},
        fields=[pd.displacement, pd.stress],
        steps=pd.Steps(2),
    )
    return dataclasses.replace(case, **changes)


@pytest.mark.parametrize("spacings", [(0.25, 0.2), (0.1, 0.25), (0.25, 0.25)])
def test_unlike_lattices_carry_a_uniform_pressure(spacings, tmp_path):
    run = pd.run(stacked(spacings), tmp_path)
    assert run.history["pair_y"][-1] == pytest.approx(-2.0 * 0.05 * E, rel=1e-6)
    assert run.history["interface"][-1] == pytest.approx(-0.05, rel=1e-6)
    assert run.history["pair_area"][-1] == pytest.approx(2.0)
    stress = run.field("stress")
    np.testing.assert_allclose(stress[:, 1, 1], -0.05 * E, rtol=1e-6)
    np.testing.assert_allclose(stress[:, 0, 1], 0.0, atol=1e-6 * E)


@pytest.mark.parametrize("kind", ["cells", "turned", pytest.param("solid", marks=pytest.mark.long), "solid cells"])
def test_other_surfaces_carry_a_uniform_pressure(kind, tmp_path):
    """Cells that end at the interface, an interface at an angle, and solids: the ends come together by 0.05."""
    solid, angle = kind.startswith("solid"), 0.5 if kind == "turned" else 0.0
    dim = 3 if solid else 2
    particles = pd.Lattice if kind.endswith("cells") else block
    if kind == "solid":
        particles = pd.LatticeNodes
    more = {"angle": angle} if kind == "turned" else {}
    corners = np.eye(dim)[-1]
    lower = particles(np.zeros(dim), np.ones(dim), 0.125 if kind == "cells" else 0.25, **more)
    upper = particles(corners, np.ones(dim) + corners, 0.2 if solid else 0.1, **more)
    n = np.array([-np.sin(angle), np.cos(angle)]) if dim == 2 else corners

    def along(axis):
        """Return the displacement of a bar that shortens by 0.05 in 2."""
        return lambda x, t: -0.025 * t * (x @ n) * n[axis]

    ends = pd.region.Where(lambda x: np.abs(x @ n - 1.0) > 0.45)
    # The facets of cells at the ends also act on particles that are free.
    pressed = [] if kind in ("turned", "solid") else [
        pd.Traction(f"{of} {sign}{'xyz'[dim - 1]}", **{"xyz"[dim - 1]: push * 0.025 * E})
        for of, sign, push in (("lower", "-", 1.0), ("upper", "+", -1.0))
    ]  # fmt: skip
    case = pd.Case(
        particles=pd.Bodies({"lower": lower, "upper": upper}),
        material=pd.LinearElastic(E=E, nu=0.0, **({} if solid else {"plane": "stress"})),
        weights=pd.Conforming(),
        conditions=[
            pd.Displacement(ends, **{axis: along(number) for number, axis in enumerate("xyz"[:dim])}),
            pd.BodyContact("lower", "upper", penetration=1e-7, name="pair"),
            *pressed,
        ],
        fields=[pd.stress, pd.displacement],
    )
    run = pd.run(case, tmp_path)
    force = np.array([run.history[f"pair_{axis}"][-1] for axis in "xyz"[:dim]])
    np.testing.assert_allclose(force, -0.025 * E * n, atol=1e-4)
    stress, free = run.field("stress"), np.abs(run.x[:, :dim] @ n - 1.0) < 0.45
    N = np.zeros(3)
    N[:dim] = n
    expected = -0.025 * E * np.outer(N, N)[: stress.shape[1], : stress.shape[2]]
    np.testing.assert_allclose(stress[free], np.broadcast_to(expected, stress[free].shape), atol=1e-4)


def problem_of(case):
    """Return the problem of a case and its contact."""
    problem = pd.prepare(case).problem
    (term,) = (one for one in problem.terms if type(one).__name__ == "BodyContactForces")
    return problem, term


def two_blocks(dim, friction, **lattice):
    """Return blocks of unlike spacings in touch, both held."""
    up, one = "xyz"[dim - 1], np.eye(dim)[-1]
    lower = pd.LatticeNodes((0.0,) * dim, (1.0,) * dim, 0.25)
    upper = pd.LatticeNodes(tuple(one), tuple(one + 1.0), 0.2)
    conditions = [pd.Clamp(f"lower -{up}"), pd.Clamp(f"upper +{up}")]
    pair = pd.BodyContact(f"lower +{up}", f"upper -{up}", friction, penetration=0.5, name="pair")
    return pd.Case(
        particles=pd.Bodies({"lower": lower, "upper": upper}), material=pd.NeoHookean(E, NU),
        conditions=[*conditions, pair],
    )  # fmt: skip


def bent(x, rng, upper):
    """Return displacements that bend and turn two blocks, press the upper one into the lower one, and shear it."""
    dim = x.shape[1]
    u = 1e-3 * rng.uniform(-1.0, 1.0, x.shape)
    u[:, -1] += 0.05 * (x[:, 0] - 0.4) ** 2 - 0.02 * upper
    u[:, 0] += 0.02 * upper * rng.uniform(0.1, 1.0)
    tilt = 0.3 * rng.standard_normal((dim, dim))
    turn = scipy.linalg.expm(tilt - tilt.T)
    return (x + u) @ turn.T - x


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("friction", [0.0, 0.3, 5.0, np.inf])
def test_forces_have_their_tangent_and_balance(friction, dim, rng):
    """Bent and turned surfaces that slide or stick, in a step that begins with friction."""
    problem, term = problem_of(two_blocks(dim, friction))
    n, x, upper = problem.body.cloud.n_owned, problem.body.cloud.x, problem.body.cloud.sets["upper"]
    v = bent(x, rng, upper)
    term.start_from(problem.state(0.0 * v, 0.0))
    term.commit(problem.state(0.0 * v, 0.0))
    term.start_from(problem.state(v, 0.5))
    term.commit(problem.state(v + 1e-4 * rng.uniform(-1.0, 1.0, v.shape), 0.5))
    term.start_from(problem.state(v, 0.5))
    upwards = np.triu(np.ones((dim, dim)), 1)
    u = (x + v) @ scipy.linalg.expm(0.2 * (upwards - upwards.T)).T - x + 1e-3 * rng.uniform(-1.0, 1.0, v.shape)

    def force(u):
        f = np.zeros((n, dim))
        term.add_force(problem.state(u, 0.9), f)
        return f

    f, y = force(u), np.zeros((n, 3))
    y[:, :dim] = x + u
    assert np.abs(f).max() > 0.1
    along = np.linalg.norm(term._touching(problem.state(u, 0.9)).traction, axis=1)
    assert (along > 0.0).sum() > 3
    np.testing.assert_allclose(f.sum(axis=0), 0.0, atol=1e-14 * np.abs(f).sum())
    moment = np.cross(y, np.pad(f, ((0, 0), (0, 3 - dim)))).sum(axis=0)
    np.testing.assert_allclose(moment, 0.0, atol=1e-14 * np.abs(f).sum())
    one, h = rng.uniform(-1.0, 1.0, (n, dim)), 1e-7
    products = term.linearise(problem.state(u, 0.9))

    def exact(du):
        found = np.zeros((n, dim))
        for product in products:
            product.add_product(du, found, np.arange(n, dtype=np.int32))
        return found

    def difference(du):
        return (force(u + h * du) - force(u - h * du)) / (2.0 * h)

    assert np.abs(difference(one) - exact(one)).max() < 1e-7 * np.abs(exact(one)).max()


@pytest.mark.parametrize("dim", [2, 3])
def test_a_turn_of_both_bodies_is_no_slip(dim, rng):
    """Surfaces in touch that turn together, with a gap between them: there is pressure but no friction."""
    problem, term = problem_of(two_blocks(dim, 0.3))
    x, upper = problem.body.cloud.x, problem.body.cloud.sets["upper"]
    v = bent(x, rng, upper)
    term.start_from(problem.state(0.0 * v, 0.0))
    term.commit(problem.state(0.0 * v, 0.0))
    term.start_from(problem.state(v, 0.5))
    upwards = np.triu(np.ones((dim, dim)), 1)
    turn = scipy.linalg.expm(0.2 * (upwards - upwards.T))
    state = problem.state((x + v) @ turn.T - x, 0.9)
    touching, normal = term._touching(state), term._gap(state)[1]
    p = (touching.traction * normal[touching.rows]).sum(axis=1)
    assert p.max() > 1.0
    np.testing.assert_allclose(touching.traction, p[:, None] * normal[touching.rows], atol=1e-10 * p.max())


@pytest.mark.parametrize("axis", [None, (0.0, 0.0, 1.5), (1.0, 0.5, 0.0)])
def test_blocks_that_turn_together_keep_their_friction(axis, tmp_path):
    """Pressed by t = 0.25, sheared without sliding by t = 0.5, then turned or held, by 1.5 or 1.1 rad."""
    dim = 2 if axis is None else 3
    up, about = np.eye(dim)[-1], np.array([0.5] * (dim - 1) + [1.0])
    spin = np.array([(0.0, -1.5), (1.5, 0.0)]) if axis is None else np.cross(np.eye(3), axis)
    ends = pd.region.Where(lambda x: np.abs(x[:, -1] - 1.0) > 0.99)
    case = two_blocks(dim, 0.3)
    pair = dataclasses.replace(case.conditions[2], penetration=1e-7, reach=10.0)

    def turn(t):
        return scipy.linalg.expm(spin * max(2.0 * t - 1.0, 0.0))

    def end(component, turned):
        def displacement(x, t):
            way = -0.05 * min(4.0 * t, 1.0) * up + 0.02 * min(max(4.0 * t - 1.0, 0.0), 1.0) * np.eye(dim)[0]
            y = x + np.where(x[:, -1:] > 1.0, way, 0.0) - about
            return ((y @ turn(t).T if turned else y) + about - x)[:, component]

        return displacement

    force = []
    for turned in (False, True):
        moved = pd.Displacement(ends, **{name: end(component, turned) for component, name in enumerate("xyz"[:dim])})
        scene = dataclasses.replace(case, conditions=[moved, pair], steps=pd.Steps(times=(0.25, 0.5, 0.65, 0.8, 1.0)))
        history = pd.run(scene, tmp_path / str(turned)).history
        force.append(np.array([history[f"pair_{name}"][-1] for name in "xyz"[:dim]]))
    assert abs(force[0][0]) > 1.0
    np.testing.assert_allclose(force[1] @ turn(1.0), force[0], atol=1e-6)


SHEARED = """
import numpy as np
import pdpetsc as pd

def case(dim=2, friction=0.3, away=0.1):
    up, one = "xyz"[dim - 1], np.eye(dim)[-1]
    pressed, pushed = pd.Table([0.0, 0.5, 1.0], [0.0, 1.0, 1.0]), pd.Table([0.0, 0.5, 1.0], [0.0, 0.0, 1.0])
    lower, upper, origin = f"lower -{up}", f"upper +{up}", (0.0,) * dim
    moments = {"m": {}} if dim == 2 else {f"m{axis}": {"axis": axis} for axis in "xyz"}
    held = [pd.Displacement(upper, y=0.0)] if dim == 3 else []
    sides = {"lower": lower, "upper": upper}
    return pd.Case(
        particles=pd.Bodies({
            "lower": pd.LatticeNodes(origin, (1.0,) * dim, 0.25),
            "upper": pd.LatticeNodes(tuple(one), tuple(one + 1.0), 0.2),
        }),
        material=pd.NeoHookean(E=1000.0, nu=0.3),
        conditions=[
            pd.Clamp(lower),
            pd.Displacement(upper, **{up: -0.1}, schedule=pressed),
            pd.Displacement(upper, x=away, schedule=pushed),
            *held,
            pd.BodyContact(f"lower +{up}", f"upper -{up}", friction, name="pair"),
        ],
        history={
            f"{of} {name}": pd.ReactionMoment(side, origin, **more)
            for of, side in sides.items() for name, more in moments.items()
        },
        results=lambda h: {
            "moment": max(abs(h[f"lower {name}"][-1] + h[f"upper {name}"][-1]) for name in moments),
            "force": abs(h[f"pair_{up}"][-1]), "friction": abs(h["pair_x"][-1]),
        },
        options={"snes_rtol": 1e-12},
        steps=pd.Steps(4),
    )
"""


@pytest.mark.processors
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("words", [["away=0.1"], ["away=0.01"], ["friction=inf"]])
def test_the_supports_of_two_bodies_have_opposite_moments(dim, words, tmp_path):
    """Blocks that slide or stick, on one and on two ranks."""
    path = tmp_path / "sheared.py"
    path.write_text(SHEARED)
    one, two = (
        results(path, f"dim={dim}", *words, ranks=ranks, output=tmp_path / str(ranks))["results"] for ranks in (1, 2)
    )
    for found in (one, two):
        assert found["friction"] > 5e-3 * found["force"] > 0.1
        assert found["moment"] < 1e-9 * found["force"]
    assert two["force"] == pytest.approx(one["force"], rel=1e-8)
    assert two["friction"] == pytest.approx(one["friction"], rel=1e-8)


@pytest.mark.parametrize("join", [pd.BodyContact, pd.Tied])
def test_a_matrix_of_whole_families_has_room_for_pairs(join, rng):
    """With bonds that fail the sparsity is that of families, which pairs of two bodies are not part of."""
    case = stacked(damage=pd.Brittle(pd.ConstantCritical(1.0)), weights=pd.Standard(), scheme=pd.Correspondence())
    pressed = join("lower +y", "upper -y", stiffness=1e4)
    case = dataclasses.replace(case, conditions=[*case.conditions[:3], pressed], horizon=0.55)
    problem = pd.prepare(case).problem
    n, dim, cloud = problem.body.cloud.n_owned, problem.dim, problem.body.cloud
    u = 1e-4 * rng.uniform(-1.0, 1.0, (n, dim)) - 0.001 * cloud.sets["upper"][:n, None] * (0.3, 1.0)
    state = problem.state(u, 0.5)
    assembler = Assembler(problem)
    rows = assembler.pattern.rows
    values = np.empty(dim**2 * int(rows.diag_ptr[-1]))
    assembler.assemble(state, values, np.empty(0))
    K = np.zeros((n * dim, n * dim))
    for row in range(n):
        columns = rows.columns[rows.diag_ptr[row] : rows.diag_ptr[row + 1]]
        block = values[dim**2 * rows.diag_ptr[row] : dim**2 * rows.diag_ptr[row + 1]].reshape(dim, -1)
        K[row * dim : (row + 1) * dim, (columns[:, None] * dim + np.arange(dim)).ravel()] = block
    du = rng.uniform(-1.0, 1.0, (n, dim))
    exact = problem.linearised(problem.state(u, 0.5))(du)
    np.testing.assert_allclose((K @ du.ravel()).reshape(n, dim), exact, atol=1e-10 * np.abs(exact).max())


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_units_change_nothing(friction, tmp_path):
    found = []
    for unit, modulus in ((1.0, E), (1e20, E), (1e-20, 1e20 * E)):
        run = pd.run(stacked(unit=unit, modulus=modulus, nu=0.3, friction=friction), tmp_path / f"{unit:g}")
        found.append(np.array([run.history["pair_y"][-1], run.history["interface"][-1] * modulus]) / (modulus * unit))
    np.testing.assert_allclose(found[1:], [found[0]] * 2, rtol=1e-6)


TEXT = """
import numpy as np
import pdpetsc as pd

def case(friction=0.3, steps=4, solver="newton"):
    lower = pd.LatticeNodes((0.0, 0.0), (2.0, 1.0), 0.125)
    upper = pd.LatticeNodes((0.25, 1.0), (1.25, 1.5), 0.1)
    lowered, pushed = pd.Table([0.0, 0.5, 1.0], [0.0, 1.0, 1.0]), pd.Table([0.0, 0.5, 1.0], [0.0, 0.0, 1.0])
    return pd.Case(
        particles=pd.Bodies({"lower": lower, "upper": upper}),
        material=pd.LinearElastic(E=1000.0, nu=0.3),
        conditions=[
            pd.Clamp("lower -y"),
            pd.Displacement("upper +y", y=-0.01, schedule=lowered),
            pd.Displacement("upper +y", x=0.1, schedule=pushed),
            pd.BodyContact("lower +y", "upper -y", friction, penetration=0.05, name="pair"),
        ],
        history={"top": pd.Mean(pd.displacement, "y", "lower +y")},
        results=lambda h: {"x": h["pair_x"][-1], "y": h["pair_y"][-1], "top": h["top"][-1]},
        steps=pd.Steps(steps),
    )
"""


@pytest.mark.processors
@pytest.mark.parametrize(
    ("words", "ranks"), [(["-pd_jacobian", "matfree"], 2), pytest.param([], 3, marks=pytest.mark.long)]
)
def test_ranks_and_matrix_free_solves_agree_and_sliding_drags(words, ranks, tmp_path):
    path = tmp_path / "sliding.py"
    path.write_text(TEXT)
    one = results(path, ranks=1, output=tmp_path / "one")["results"]
    assert one["x"] == pytest.approx(-0.3 * one["y"], rel=0.02) and one["y"] < -1.0
    other = results(path, *words, ranks=ranks, output=tmp_path / "other")["results"]
    assert other == pytest.approx(one, rel=1e-6)


@pytest.mark.long
def test_a_restart_in_contact_continues(tmp_path):
    """To round-off: which facets were near at the last search determines the order of elimination."""
    namespace = {}
    exec(TEXT, namespace)
    case = namespace["case"]()
    whole = pd.run(case, tmp_path / "whole").history
    half = dataclasses.replace(case, history={**case.history, "stop": Stop(0.6)})
    with pytest.raises(pd.Interrupted):
        pd.run(half, tmp_path / "half")
    again = pd.run(case, tmp_path / "again", restart=tmp_path / "half").history
    for name in ("pair_x", "pair_y", "pair_area", "top"):
        assert again[name][-1] == pytest.approx(whole[name][-1], rel=1e-9), name


@pytest.mark.parametrize(
    ("solver", "steps"), [(pd.Newton(), 6), (pd.Implicit(dt=0.1, end=0.6), 1)], ids=["newton", "implicit"]
)
def test_a_restart_with_friction_repeats_the_rest_of_the_run(solver, steps, tmp_path):
    """From the row of the restart on, to the last digit: friction depends on the start of its last step too."""
    parts = {
        "lower": pd.LatticeNodes((0.0, 0.0), (3.0, 1.0), 0.25),
        "upper": pd.LatticeNodes((1.0, 1.0), (2.0, 1.5), 0.125),
    }
    pressed, pushed = pd.Table([0.0, 0.3, 1.0], [0.0, 1.0, 1.0]), pd.Table([0.0, 0.3, 1.0], [0.0, 0.0, 1.0])
    case = pd.Case(
        particles=pd.Bodies(parts),
        material=pd.NeoHookean(E=10.0, nu=0.3, density=1.0),
        conditions=[
            pd.Clamp("lower -y"),
            pd.Displacement("upper +y", y=-0.02, schedule=pressed),
            pd.Displacement("upper +y", x=0.2, schedule=pushed),
            pd.BodyContact("lower +y", "upper -y", 0.3, stiffness=4000.0, name="pair"),
        ],
        solver=solver,
        steps=pd.Steps(steps),
        fields=[pd.displacement],
        history={"stored": pd.StrainEnergy(), "work": pd.ExternalWork()},
    )
    whole = pd.run(case, tmp_path / "whole")
    with pytest.raises(pd.Interrupted):
        pd.run(dataclasses.replace(case, history={**case.history, "stop": Stop(0.6)}), tmp_path / "half")
    again = pd.run(case, tmp_path / "again", restart=tmp_path / "half")
    for name in ("pair_x", "pair_y", "pair_area", "stored", "work"):
        rows = again.history[name]
        assert len(rows) in (3, 4)
        np.testing.assert_allclose(rows, whole.history[name][-len(rows) :], rtol=1e-11, err_msg=name)
    assert abs(whole.history["pair_x"][-1]) > 0.01
    u = whole.solution.u
    np.testing.assert_allclose(again.solution.u, u, atol=1e-12 * np.abs(u).max())


def bars(solver, gap=0.1, v=0.01):
    """Return two bars of wave speed 1, of which one hits the other at its end."""
    one = pd.LatticeNodes((0.0, 0.0), (10.0, 1.0), 0.25)
    two = pd.LatticeNodes((10.0 + gap, 0.0), (20.0 + gap, 1.0), 0.5)
    return pd.Case(
        particles=pd.Bodies({"one": one, "two": two}),
        material=pd.LinearElastic(E=1.0, nu=0.0, density=1.0, plane="stress"),
        conditions=[
            pd.InitialVelocity("one", x=v),
            pd.BodyContact("one +x", "two -x", penetration=0.1, reach=5.0, name="pair"),
        ],
        solver=solver,
        fields=[pd.displacement],
        history={
            "one": pd.Mean(pd.velocity, "x", "one"),
            "two": pd.Mean(pd.velocity, "x", "two"),
            "error": pd.EnergyError(),
        },
    )


def test_derivatives_are_bounded_where_edges_coincide(rng):
    """Round-off decides on which side of an edge the corners of equal facets are."""
    flat = np.array([(-0.5, -0.5, 0.0), (0.5, -0.5, 0.0), (0.5, 0.5, 0.0), (-0.5, 0.5, 0.0)])
    below, one = flat[[0, 3, 2, 1]], np.zeros(1, dtype=np.int64)
    for _ in range(200):
        turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
        sheared = below + np.array([0.0, rng.choice([0.0, 0.3]), 0.0])
        sides = [np.ascontiguousarray((side @ turn.T)[None]) for side in (sheared, flat)]
        J = np.empty((1, QUANTITIES, 2, 4, 3))
        overlap_by_fields(*sides, *sides, one, one, 0.5, J)
        assert np.abs(J).max() < 10.0


def test_facets_are_beside_each_other_only_if_their_outlines_do_not_overlap(rng):
    """The derivatives are those of outlines that are always clipped."""
    flat = np.array([(-0.5, -0.5, 0.0), (0.5, -0.5, 0.0), (0.5, 0.5, 0.0), (-0.5, 0.5, 0.0)])
    n = 4000
    moved = [flat[None] * rng.uniform(0.2, 2.0, (n, 1, 3)), flat[None, ::-1] + rng.uniform(-1.5, 1.5, (n, 1, 3))]
    turned = np.eye(3) + 0.3 * rng.standard_normal((n, 3, 3))
    y, other_y = moved[0], np.ascontiguousarray(moved[1] @ turned)
    rows, q, J = np.arange(n), np.zeros((n, QUANTITIES)), np.empty((n, QUANTITIES, 2, 4, 3))
    overlap(y, other_y, y, other_y, rows, rows, 0.5, q)
    overlap_by_fields(y, other_y, y, other_y, rows, rows, 0.5, J)
    some = J[:, AREA].any(axis=(1, 2, 3))
    assert 0.1 * n < some.sum() < 0.9 * n
    np.testing.assert_array_equal(q[:, AREA] > 0.0, some)


def test_facets_of_a_flat_side_are_joined_to_one_of_each_particle():
    """A node on a side has one facet there, with the area of its cell, and weights that are linear-exact."""
    n, up = 4, np.eye(3)[-1]
    bodies = {name: pd.LatticeNodes(z * up, 1.0 + z * up, 1.0 / n) for name, z in (("lower", 0.0), ("upper", 1.0))}
    held = [pd.Clamp("lower -z"), pd.Clamp("upper +z"), pd.BodyContact("lower +z", "upper -z", name="pair")]
    case = pd.Case(particles=pd.Bodies(bodies), material=pd.LinearElastic(E=E, nu=NU), conditions=held)
    problem, term = problem_of(case)
    facets, x = term._search.one, problem.body.cloud.x
    assert len(facets.x) == len(np.unique(facets.owner)) == (n + 1) ** 2
    on_edge = ((facets.x[:, :-1] < 0.2) | (facets.x[:, :-1] > 0.8)).sum(axis=1)
    np.testing.assert_allclose(facets.areas, 0.5**on_edge / n**2, rtol=1e-12)
    N, G = facets.moving.weights[:, 0], facets.moving.weights[:, 1:]
    placed = np.add.reduceat(N[:, None] * x[facets.members], facets.ptr[:-1])
    np.testing.assert_allclose(placed, facets.x, atol=1e-12)
    slopes = np.add.reduceat(x[facets.members][:, :, None] * G[:, None, :], facets.ptr[:-1])
    # The members of a side of nodes lie in it, so that the gradients are tangential.
    np.testing.assert_allclose(slopes, np.broadcast_to(np.eye(3) - np.outer(up, up), slopes.shape), atol=1e-10)
    np.testing.assert_allclose(facets.corners.mean(axis=1), facets.x, atol=1e-12)
    # The edges that determine how vectors within the facets move.
    assert np.linalg.matrix_rank(facets.edges).min() == 2


def test_facets_are_joined_only_if_they_are_one_flat_facet_with_four_corners():
    """Two halves are joined; not if they are bent, belong to two particles or to two parts, or leave a step."""
    flat = np.array([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 1.0, 0.0), (0.0, 1.0, 0.0)])
    right = flat + np.array([1.0, 0.0, 0.0])
    bent, longer = right.copy(), right.copy()
    bent[1:3, 2] += 1e-3
    longer[2:, 1] += 0.1

    def side(other, owner=(0, 0), both=(False, False)):
        corners = np.stack([flat, other])
        return Side(
            corners.mean(axis=1), corners, np.arange(2), np.array(both), np.array(owner, dtype=np.int32),
            np.arange(3), np.zeros(2, dtype=np.int32), np.ones(2), np.ones((2, 3)), 1.0,
        )  # fmt: skip

    one, other, corners = _halves(side(right))
    assert (one.tolist(), other.tolist()) == ([0], [1])
    assert {tuple(at) for at in corners[0]} == {(0.0, 0.0, 0.0), (2.0, 0.0, 0.0), (2.0, 1.0, 0.0), (0.0, 1.0, 0.0)}
    # Seen from outside, the corners stay in turn.
    assert np.cross(corners[0, 2] - corners[0, 0], corners[0, 3] - corners[0, 1])[2] == pytest.approx(4.0)
    refused = side(bent), side(longer), side(right, owner=(0, 1)), side(right, both=(True, False)), side(right + 0.1)
    assert not any(len(_halves(of)[0]) for of in refused)


@pytest.mark.parametrize("dim", [2, 3])
def test_near_facets_contain_all_pairs_that_touch(dim, rng):
    """Random motions from a search to the next one: the pairs are those of all facets."""
    if dim == 2:
        case = stacked(spacings=(0.125, 0.1))
    else:
        lower, upper = (pd.LatticeNodes((0.0, 0.0, z), (1.0, 1.0, z + 0.5), h) for z, h in ((0.0, 0.125), (0.5, 0.1)))
        contact = pd.BodyContact("lower +z", "upper -z", name="pair")
        case = pd.Case(
            particles=pd.Bodies({"lower": lower, "upper": upper}), material=pd.LinearElastic(E=E, nu=NU),
            conditions=[pd.Clamp("lower -z"), pd.Clamp("upper +z"), contact],
        )  # fmt: skip
    problem, term = problem_of(case)
    search, n = term._search, problem.body.cloud.n_owned
    upper = problem.body.cloud.body[:n] == 1
    u, counts = np.zeros((n, dim)), []
    for _ in range(60):
        u = u + rng.uniform(-2e-3, 2e-3, u.shape) + upper[:, None] * rng.uniform(-0.02, 0.02, dim)
        u[upper, -1] = np.clip(u[upper, -1], -0.01, 0.04)
        state = problem.state(u)
        version = search.version
        term.follow(state)
        counts.append(search.version - version)
        found, every = search.pairs(u), search.passed(u, 0.3)
        found, every = ({*zip(p.rows[p.gap < 0.04], p.other_rows[p.gap < 0.04], strict=True)} for p in (found, every))
        assert found == every and found
    assert 0 < sum(counts) < 60


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("moves", [False, True])
def test_pairs_have_the_forces_of_their_particles(dim, moves, rng):
    """The product on facets is that of the listed vectors of particles, for all and for some particles."""
    n_local, n, r = 40, 30, 1 if not moves else 3 * dim
    sides = []
    for _ in range(2):
        members = np.concatenate([rng.choice(n_local, 5, replace=False) for _ in range(12)]).astype(np.int32)
        sides.append(MovingFacets(np.arange(0, 61, 5), members, rng.standard_normal((60, 1 + dim))))
    pairs = FacetPairs(tuple(sides), (rng.integers(0, 12, n), rng.integers(0, 12, n)), rng.standard_normal((n, 2, dim)))
    start = np.arange(n + 1) if moves else np.unique(np.append(rng.integers(0, n, 8), [0, n]))
    owner = np.sort(rng.integers(0, 9, len(start) - 1)).astype(np.int32)
    G, h = rng.standard_normal((n, r, 2, 1 + dim, dim)), rng.standard_normal((n, dim if moves else 1, dim))
    force = rng.standard_normal((n, dim)) if moves else None
    product = PairProduct(pairs, owner, start, 10, G, h, force, stiff=not moves)
    assert (product.stiff() is None) == moves
    du = rng.standard_normal((n_local, dim))
    for particles in (np.arange(10), np.arange(4), np.array([9])):
        found, listed = np.zeros((2, n_local, dim))
        product.add_product(du, found, particles.astype(np.int32))
        product.listed.add_product(du, listed, particles.astype(np.int32))
        np.testing.assert_allclose(found, listed, rtol=1e-10, atol=1e-10)
        assert found.any() == (particles[0] < 9)
    # Blocks of facets contain no coupling of both facets of a pair: the members of both sides are others here.
    other = MovingFacets(sides[1].ptr, sides[1].members + n_local, sides[1].weights)
    apart = FacetPairs((sides[0], other), pairs.rows, pairs.at)
    product = PairProduct(apart, owner, start, 10, G, h, force, stiff=not moves)
    found, listed = np.zeros((2, 2 * n_local, dim, dim))
    assert product.add_point_blocks(found) and product.listed.add_point_blocks(listed)
    np.testing.assert_allclose(found, listed, rtol=1e-10, atol=1e-10)
    assert found.any()


def test_pressed_blocks_converge_without_a_matrix(tmp_path):
    case = stacked(nu=0.3, spacings=(0.1, 0.125))
    direct = pd.run(case, tmp_path / "direct").history["pair_y"][-1]
    free = pd.run(case, tmp_path / "free", options={"pd_jacobian": "matfree"}).history["pair_y"][-1]
    assert free == pytest.approx(direct, rel=1e-6)


@pytest.mark.parametrize("kind", ["explicit", pytest.param("implicit", marks=pytest.mark.long)])
def test_bars_that_collide_exchange_their_velocities(kind, tmp_path):
    """Waves run to the ends and back: contact for twice the length over the wave speed."""
    explicit = kind == "explicit"
    solver = pd.Explicit(end=70.0, safety=0.5, records=100) if explicit else pd.Implicit(dt=0.2, end=70.0, every=5)
    run = pd.run(bars(solver), tmp_path)
    one, two = np.array(run.history["one"]) / 0.01, np.array(run.history["two"]) / 0.01
    np.testing.assert_allclose(one + two, 1.0, atol=1e-9)
    assert two[-1] == pytest.approx(1.0, abs=0.03)
    pressed = np.array(run.history["pair_x"]) != 0.0
    assert 70.0 * pressed.mean() == pytest.approx(20.0, rel=0.15 if explicit else 0.4)
    assert np.abs(run.history["error"]).max() < (2e-3 if explicit else 0.04)


@pytest.mark.processors
def test_a_body_touches_itself(tmp_path):
    """The arms of a C are pressed together; the sides of an arm, which face each other through it, do not touch."""
    body = pd.LatticeNodes((0.0, 0.0), (3.0, 1.5), 0.125, cut=pd.region.Box((0.5, 0.5), (3.0, 1.0)))
    end = pd.region.Slab("y", low=1.5 - 1e-9) & pd.region.Slab("x", low=2.5 - 1e-9)
    case = pd.Case(
        particles=body,
        material=pd.NeoHookean(E=1000.0, nu=0.3),
        conditions=[
            pd.Clamp("-y"),
            pd.Displacement(end, y=-0.55),
            pd.BodyContact(pd.region.All(), pd.region.All(), name="arms"),
        ],
        steps=pd.Steps(6),
        history={"push": pd.Reaction("y", end)},
    )
    run = pd.run(case, tmp_path)
    force = np.array(run.history["arms_force"])
    assert "arms_y" not in run.history  # of a pair no arm is the first
    assert (force[:5] == 0.0).all() and force[-1] > 1.0
    assert 0.0 < run.history["arms_area"][-1] < 1.0
    free = dataclasses.replace(case, conditions=case.conditions[:2])
    apart = pd.run(free, tmp_path / "free").history["push"]
    np.testing.assert_allclose(run.history["push"][:5], apart[:5], rtol=1e-9)
    # In the last step more than the arm resists.
    assert abs(run.history["push"][-1]) > 1.01 * abs(apart[-1])


def test_a_step_in_which_bodies_pass_through_each_other_is_halved(tmp_path):
    lower = pd.LatticeNodes((0.0, 0.0), (1.0, 0.5), 0.125)
    upper = pd.LatticeNodes((0.0, 1.0), (1.0, 1.5), 0.125)
    case = pd.Case(
        particles=pd.Bodies({"lower": lower, "upper": upper}),
        material=pd.NeoHookean(E=1000.0, nu=0.3),
        conditions=[
            pd.Clamp("lower -y"),
            pd.Displacement("upper +y", x=0.0, y=-0.7),
            pd.BodyContact("lower", "upper", name="pair"),
        ],
        steps=pd.Steps(1),
    )
    run = pd.run(case, tmp_path)
    assert run.history["pair_y"][-1] < -50.0 and len(run.history["pair_y"]) > 2


def test_a_wall_does_not_touch_itself_through_the_material():
    """A box with walls of one cell: faces look at each other through the wall and, over the hollow, from afar."""
    box = pd.LatticeNodes((0.0, 0.0), (2.0, 2.0), 0.25, cut=pd.region.Box((0.25, 0.25), (1.75, 1.75)))
    case = stacked()
    itself = pd.BodyContact(pd.region.All(), pd.region.All(), name="walls")
    case = dataclasses.replace(case, particles=box, conditions=[pd.Clamp("-y"), itself], history={})
    problem, term = problem_of(case)
    n = problem.body.cloud.n_owned
    x = problem.body.cloud.x[:n]
    # The wall on the right becomes thinner by a third.
    u = np.where(x[:, :1] > 1.9, -0.08, 0.0) * (1.0, 0.0)
    state = problem.state(u, 0.5)
    term.start_from(state)
    assert len(term.of_facets(state)[2]) == 0


def test_a_step_that_failed_leaves_the_near_facets_of_its_start():
    problem, term = problem_of(stacked())
    n, sets = problem.body.cloud.n_owned, problem.body.cloud.sets
    rest = problem.state(np.zeros((n, 2)), 0.0)
    term.commit(rest)
    term.start_from(rest)
    near = len(term._search.near[0])
    far = problem.state(np.where(sets["upper"][:n, None], 3.0, 0.0) * (0.0, 1.0), 0.5)
    term.follow(far)
    assert len(term._search.near[0]) == 0
    problem.revert()
    term.start_from(problem.state(np.zeros((n, 2)), 0.0))
    assert len(term._search.near[0]) == near > 0


def test_bodies_of_two_heights_are_felt_one_by_one(tmp_path):
    """A coarse block before two fine ones, of which one is lower: it does not touch until it is reached."""
    lower = pd.LatticeNodes((0.0, 0.0), (2.0, 1.0), 0.5)
    high, low = pd.LatticeNodes((0.0, 1.0), (1.0, 2.0), 0.125), pd.LatticeNodes((1.0, 1.1), (2.0, 2.0), 0.1)
    case = dataclasses.replace(
        stacked(),
        particles=pd.Bodies({"lower": lower, "high": high, "low": low}),
        conditions=[
            pd.Clamp("lower -y"),
            pd.Displacement("high +y", x=0.0, y=-0.02),
            pd.Displacement("low +y", x=0.0, y=-0.02),
            pd.BodyContact("lower +y", pd.region.Named("high") | pd.region.Named("low"), name="pair"),
        ],
        history={"high": pd.Reaction("y", "high +y"), "low": pd.Reaction("y", "low +y")},
    )
    run = pd.run(case, tmp_path)
    assert abs(run.history["low"][-1]) < 1e-9 * abs(run.history["high"][-1])


def test_the_side_of_a_body_has_its_layers_and_named_sets_come_first():
    lower = pd.Lattice((0.0, 0.0), (1.0, 1.0), 0.25, fictitious={"-y": 0.5})
    bodies = pd.Bodies({"lower": lower, "upper": pd.Lattice((0.0, 1.0), (1.0, 2.0), 0.25)})
    chunk = bodies.chunk(0, 1)
    view = View(chunk.x, chunk.sets, minimum=lambda value: value)
    assert np.count_nonzero(pd.region.Face("-y", "lower").mask(view)) == 8
    assert np.count_nonzero(pd.region.Face("+y", "upper").mask(view)) == 4
    view.sets["upper +y"] = np.arange(len(chunk.x)) == 0
    assert np.count_nonzero(pd.region.Face("+y", "upper").mask(view)) == 1


def blocks(a, b):
    """Return a case of two bodies in contact over their whole surfaces."""
    held = {axis: 0.0 for axis in "xyz"[: len(a.chunk(0, 1).x[0])]}
    conditions = [pd.Displacement("a", **held), pd.Displacement("b", **held), pd.BodyContact("b", "a", name="t")]
    return pd.Case(particles=pd.Bodies({"a": a, "b": b}), material=pd.NeoHookean(1e4, 0.3), conditions=conditions)


@pytest.mark.parametrize("overlap", [0.24, 0.26, 0.5, 0.9, 1.5])
@pytest.mark.parametrize("spacings", [(0.25, 0.25), (0.25, 0.125), (0.125, 0.25)])
def test_bodies_that_overlap_deeply_are_refused(spacings, overlap):
    """Facets that are more than a spacing beyond each other form no pairs; with 1.5 the one body crosses the other."""
    a = pd.LatticeNodes((0.0, 0.0), (3.0, 1.0), spacings[0])
    b = pd.LatticeNodes((1.0, 1.0 - overlap), (2.0, 2.0 - overlap), spacings[1])
    with pytest.raises(pd.CaseError, match=r"bodies 'a' and 'b' of BodyContact condition 3 overlap at the start: both"):
        pd.prepare(blocks(a, b))


@pytest.mark.parametrize("dim", [2, 3])
def test_a_body_inside_another_one_is_refused_and_in_a_hole_it_is_not(dim):
    low, high = np.array([(0.0,) * dim, (3.0,) * dim])
    inner = pd.LatticeNodes(low + 1.0, high - 1.0, 0.25)
    hole = pd.region.Box(low + 1.0, high - 1.0)
    for outer in (pd.LatticeNodes(low, high, 0.5), pd.LatticeNodes(low + 1.0, high - 1.0, 0.25)):
        for pair in ((outer, inner), (inner, outer)):
            with pytest.raises(pd.CaseError, match="overlap at the start"):
                pd.prepare(blocks(*pair))
    pd.prepare(blocks(pd.LatticeNodes(low, high, 0.5, cut=hole), inner))


def test_a_body_of_one_column_at_a_mirror_plane_that_overlaps_is_refused():
    a, b = pd.Lattice((0.0, 0.0), (3.0, 1.0), 0.25), pd.Lattice((0.0, 0.3), (0.125, 1.3), 0.125)
    case = dataclasses.replace(blocks(a, b), symmetry=[pd.Symmetry("x")])
    with pytest.raises(pd.CaseError, match="overlap at the start"):
        pd.prepare(case)


def test_bodies_at_a_mirror_plane_that_overlap_are_refused():
    a, b = pd.Lattice((0.0, 0.0), (3.0, 1.0), 0.25), pd.Lattice((0.0, 0.5), (0.25, 1.5), 0.125)
    case = dataclasses.replace(blocks(a, b), symmetry=[pd.Symmetry("x")])
    with pytest.raises(pd.CaseError, match="overlap at the start"):
        pd.prepare(case)
    above = pd.Lattice((0.0, 1.0), (0.25, 1.5), 0.125)
    pd.prepare(dataclasses.replace(case, particles=pd.Bodies({"a": a, "b": above})))


@pytest.mark.processors
def test_the_refusal_of_bodies_that_overlap_is_the_same_on_two_ranks(tmp_path):
    path = tmp_path / "overlapping.py"
    path.write_text(TEXT.replace("(0.25, 1.0), (1.25, 1.5)", "(0.25, 0.7), (1.25, 1.2)"))
    found = [called(path, "-o", tmp_path / str(ranks), ranks=ranks) for ranks in (1, 2)]
    assert [one.returncode for one in found] == [2, 2]
    messages = [next(line for line in one.stderr.splitlines() if "overlap" in line) for one in found]
    assert messages[0] == messages[1]
    assert "bodies 'lower' and 'upper'" in messages[0]


MIRRORED = """
import pdpetsc as pd

def case(half=True):
    low, share = (0.0, 1.0) if half else (-2.0, 0.5)
    lower = pd.Lattice((low, 0.0), (2.0, 1.0), 0.25)
    upper = pd.Lattice((0.5 * low, 1.0), (1.0, 1.5), 0.125)
    bottom, top = pd.region.Slab("y", high=0.25), pd.region.Slab("y", low=1.375)
    return pd.Case(
        particles=pd.Bodies({"lower": lower, "upper": upper}),
        material=pd.NeoHookean(E=1000.0, nu=0.3),
        symmetry=[pd.Symmetry("x")] if half else [],
        conditions=[
            pd.Displacement(bottom, x=0.0, y=0.0),
            pd.Displacement(top, x=0.0, y=-0.1),
            pd.BodyContact("upper -y", "lower +y", 0.3, penetration=1e-4, name="pair"),
        ],
        history={"stored": pd.StrainEnergy()},
        results=lambda h: {
            "area": share * h["pair_area"][-1], "force": share * h["pair_y"][-1], "stored": share * h["stored"][-1],
        },
        fields=[pd.displacement],
        steps=pd.Steps(3),
    )
"""


@pytest.mark.processors
def test_half_of_two_bodies_has_the_contact_of_the_whole(tmp_path):
    """Facets at the plane turn, and overlap with the image of the other body by some 1e-4 of a facet."""
    path = tmp_path / "mirrored.py"
    path.write_text(MIRRORED)
    found = [
        results(path, f"half={half}", ranks=ranks, output=tmp_path / f"{half}{ranks}")["results"]
        for half, ranks in ((True, 1), (True, 2), (False, 1))
    ]
    assert found[0] == pytest.approx(found[2], rel=1e-9)
    assert found[1] == pytest.approx(found[2], rel=1e-9)
    # Tractions are those of the particles of the half, also of pairs with images.
    half, whole = (pd.open(tmp_path / f"{one}1") for one in (True, False))
    right = whole.x[:, 0] > 0.0
    order = [np.lexsort(x.T) for x in (half.x, whole.x[right])]
    expected, values = whole.field("pair_traction")[right][order[1]], half.field("pair_traction")[order[0]]
    np.testing.assert_allclose(values, expected, atol=1e-8 * np.abs(expected).max())


def test_a_body_in_its_own_image_ends_the_run(tmp_path):
    """The gap of 0.5 between a block and its image closes; a tool on the plane is the image of a symmetric contact."""
    held = pd.region.Slab("y", low=0.75)
    case = pd.Case(
        particles=pd.Lattice((0.0, 0.25), (1.0, 1.0), 0.125),
        material=pd.NeoHookean(E=E, nu=0.3),
        symmetry=[pd.Symmetry("y")],
        conditions=[
            pd.Displacement(held, x=0.0, y=-0.3),
            pd.BodyContact(pd.region.All(), pd.region.All(), name="pair"),
        ],
        steps=pd.Steps(4),
    )
    with pytest.raises(pd.SolveError, match=r"beyond the mirror plane y = 0 at step time 1, in its own image\. Add a"):
        pd.run(case, tmp_path / "free")
    plane = pd.Contact("-y", pd.RigidPlane((0.0, 0.0), (0.0, 1.0)), name="plane")
    run = pd.run(dataclasses.replace(case, conditions=[*case.conditions, plane]), tmp_path / "held")
    assert run.history["plane_y"][-1] > 1.0


def test_a_penetration_names_both_bodies(tmp_path):
    case = bars(pd.Explicit(end=20.0))
    soft = dataclasses.replace(case.conditions[1], penetration=1e-6)
    message = r"Body 'one' of BodyContact condition 2 is .* spacings deep in body 'two' at step time"
    with pytest.raises(pd.SolveError, match=message):
        pd.run(dataclasses.replace(case, conditions=[case.conditions[0], soft]), tmp_path)


def test_what_bodies_cannot_do_is_refused(tmp_path):
    case = stacked()
    lower, upper = case.particles.parts.values()
    low = pd.LatticeNodes((0.0, 0.98), (2.0, 1.98), 0.2)
    with pytest.raises(pd.CaseError, match=r"bodies of BodyContact condition 4 overlap by 0.02"):
        pd.prepare(dataclasses.replace(case, particles=pd.Bodies({"lower": lower, "upper": low})))
    with pytest.raises(pd.CaseError, match="BodyContact condition 4: A body of 2 dimensions has no side '-z'"):
        wrong = [*case.conditions[:3], pd.BodyContact("lower +y", "upper -z")]
        pd.prepare(dataclasses.replace(case, conditions=wrong))
    with pytest.raises(pd.CaseError, match="Two conditions are named 'pair'"):
        pd.prepare(dataclasses.replace(case, conditions=[*case.conditions, pd.ParticleContact(name="pair")]))
    with pytest.raises(pd.CaseError, match="corners with other vector areas"):
        solid = pd.LatticeNodes((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), 0.5).surface()
        pd.Facets(solid.x, solid.area, solid.particle, corners=2.0 * np.asarray(solid.corners))
    with pytest.raises(pd.CaseError, match="one word"):
        pd.Bodies({"two words": lower})
    with pytest.raises(pd.CaseError, match="whose parts would share bonds"):
        pd.Bodies({"both": case.particles, "third": lower})
    thick = dataclasses.replace(upper, thickness=2.0)
    with pytest.raises(pd.CaseError, match="thicknesses"):
        pd.Bodies({"lower": lower, "upper": thick})
    with pytest.raises(pd.SolveError, match=r"further than reach=0.1\. Raise the reach"):
        slid = [*case.conditions[:2], pd.Displacement("upper +y", x=0.2, y=-0.01)]
        conditions = [slid[0], slid[2], dataclasses.replace(case.conditions[3], reach=0.1), pd.Clamp("lower -y")]
        pd.run(dataclasses.replace(case, conditions=conditions[1:]), tmp_path)
    with pytest.raises(pd.CaseError, match="requires the outlines"):
        solid = pd.LatticeNodes((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), 0.5)
        x, area, particle, tags = solid.surface().arrays
        chunk = solid.chunk(0, 1)
        arrays = pd.Arrays(chunk.x, chunk.volume, facets=pd.Facets(x, area, particle, tags))
        pd.prepare(
            pd.Case(
                particles=pd.Bodies({"one": arrays, "other": pd.LatticeNodes((0.0, 0.0, 1.0), (1.0, 1.0, 2.0), 0.5)}),
                material=pd.LinearElastic(E, NU),
                conditions=[
                    pd.Displacement("one -z", x=0.0, y=0.0, z=0.0),
                    pd.Displacement("other +z", x=0.0, y=0.0, z=0.0),
                    pd.BodyContact("one", "other"),
                ],
            )
        )
