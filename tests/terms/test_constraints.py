"""Displacements in any direction and displacements that depend on others, from outside the package."""

import contextlib
import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pytest

import pdpetsc as pd
from pdpetsc.declare.conditions import Condition
from pdpetsc.discrete.selection import select
from pdpetsc.problem.ties import Combination
from tests.commands import script_on
from tests.mesh.test_meshes import box, written


@dataclass(frozen=True)
class Along(Condition):
    """A prescribed displacement along a direction, ``n . u = value t``."""

    region: pd.region.Region
    normal: Sequence[float]
    value: float = 0.0

    def put(self, onto, name):
        cloud = onto.body.cloud
        own = np.flatnonzero(select(cloud, self.region, name)).astype(np.int32)
        n = np.array(self.normal)
        axis = int(np.argmax(np.abs(n)))
        others = np.array([a for a in range(len(n)) if a != axis])
        ties = Combination(
            own, np.full(len(own), axis), len(others) * np.arange(len(own) + 1),
            np.repeat(cloud.row[own], len(others)), np.tile(others, len(own)), np.tile(-n[others] / n[axis], len(own)),
        )  # fmt: skip
        onto.supports.tie(ties, lambda t: np.full(len(own), self.value * t / n[axis]), name)


@dataclass(frozen=True)
class RigidRegion(Condition):
    """Particles that move as one rigid body at small rotation: ``u = u_a + w x (x - x_a)``.

    Three components of two of its particles, at its ends along y, are its unknowns.
    """

    region: pd.region.Region

    def put(self, onto, name):
        cloud = onto.body.cloud
        own = np.flatnonzero(select(cloud, self.region, name)).astype(np.int32)
        parts = cloud.comm.allgather([(float(cloud.x[p, 1]), int(cloud.row[p]), cloud.x[p].tolist()) for p in own])
        ends = sorted(end for part in parts for end in part)
        (_, a, xa), (_, b, xb) = ends[0], ends[-1]
        xa, xb, rows = np.array(xa), np.array(xb), cloud.row[own]
        # Both components of a and the x component of b: the rotation is (u_ax - u_bx) / (y_b - y_a).
        particle, axis, terms = [], [], []
        for p, row in zip(own, rows, strict=True):
            dx, dy = cloud.x[p] - xa
            of_height, of_width = dy / (xb - xa)[1], dx / (xb - xa)[1]
            if row not in (a, b):
                particle.append(p), axis.append(0)
                terms.append([(a, 0, 1.0 - of_height), (b, 0, of_height)])
            if row != a:
                particle.append(p), axis.append(1)
                terms.append([(a, 1, 1.0), (a, 0, of_width), (b, 0, -of_width)])
        flat = np.array([term for each in terms for term in each]).reshape(-1, 3)
        ptr = np.concatenate([[0], np.cumsum([len(each) for each in terms])]).astype(np.int64)
        ties = Combination(
            np.array(particle, dtype=np.int32), np.array(axis, dtype=np.int32), ptr, flat[:, 0].astype(np.int64),
            flat[:, 1].astype(np.int32), flat[:, 2],
        )  # fmt: skip
        onto.supports.tie(ties, lambda t: np.zeros(len(particle)), name)


def turned(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])


def pulled(angle, material, normals=True, shaken=0.0, **given):
    """Return a plate turned by an angle that rolls along one side and is pulled at the other."""
    axes = [np.arange(8.0) + 0.5, np.arange(5.0) + 0.5]
    x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    x += shaken * np.random.default_rng(1).uniform(-1.0, 1.0, x.shape)
    R = turned(angle)

    def side(test):
        return pd.region.Where(lambda x: test(x @ R))

    corner = side(lambda y: (y[:, 0] < 1.0) & (y[:, 1] < 1.0))
    left, right = side(lambda y: (y[:, 0] < 1.0) & (y[:, 1] > 1.0)), side(lambda y: y[:, 0] > 7.0)
    if normals:
        rolling = [Along(left, R[:, 0]), Along(right, R[:, 0], 0.3)]
    else:
        rolling = [pd.Displacement(left, x=0.0), pd.Displacement(right, x=0.3)]
    declared = {
        "particles": pd.Arrays(x @ R.T, 1.0), "horizon": 2.015, "material": material,
        "scheme": pd.Correspondence(), "control": pd.Silling(0.5),
        "conditions": [pd.Displacement(corner, x=0.0, y=0.0), *rolling], "steps": pd.Steps(2), "fields": [],
    }  # fmt: skip
    return pd.Case(**{**declared, **given})


@pytest.mark.parametrize("material", [pd.LinearElastic(10.0, 0.3), pd.Hencky(10.0, 0.3)], ids=["linear", "hencky"])
@pytest.mark.parametrize("options", [{}, {"pd_jacobian": "matfree", "pc_type": "gamg"}, {"pd_jacobian": "matfree"}])
def test_a_roller_along_any_direction_turns_with_the_body(material, options, tmp_path):
    straight = pd.run(pulled(0.0, material, normals=False), output=tmp_path / "straight")
    inclined = pd.run(pulled(0.7, material), output=tmp_path / "inclined", options=options)
    u, v = straight.solution.u, inclined.solution.u
    assert np.abs(v - u @ turned(0.7).T).max() < 1e-8 * np.abs(u).max()
    force = straight.solution.reaction[:40] @ turned(0.7).T
    assert np.abs(inclined.solution.reaction[:40] - force).max() < 1e-7 * np.abs(force).max()
    assert inclined.solution.work == pytest.approx(straight.solution.work, rel=1e-7)


def bent(**given):
    """Return a cantilever whose end is rigid and loaded at its top."""
    top = pd.region.Slab("x", low=11.0) & pd.region.Slab("y", low=3.0)
    declared = {
        "particles": pd.Lattice((0.0, 0.0), (12.0, 4.0), 1.0), "horizon": 2.015,
        "material": pd.LinearElastic(10.0, 0.3),
        "conditions": [
            pd.Displacement(pd.region.Slab("x", high=1.0), x=0.0, y=0.0),
            RigidRegion(pd.region.Slab("x", low=10.0)),
            pd.Force(top, x=0.02, y=-0.03),
        ],
        "fields": [],
    }  # fmt: skip
    return pd.Case(**{**declared, **given})


def test_a_rigid_region_is_the_least_energy_among_its_motions(tmp_path):
    result = pd.run(bent(), output=tmp_path)
    problem, u = result.solution.problem, result.solution.u
    supports, n = problem.supports, u.size
    K = np.array([problem.linearised(problem.state(0.0 * u))(e.reshape(u.shape)).ravel().copy() for e in np.eye(n)])
    C = np.array([supports.completed(e.reshape(u.shape), 0.0 * u).ravel() for e in np.eye(n)]).T
    C = C[:, ~supports.fixed.ravel()]
    load = problem.external_force(problem.state(u, 1.0)).ravel()
    expected = C @ np.linalg.solve(C.T @ K @ C, C.T @ load)
    assert np.abs(expected - u.ravel()).max() < 1e-9 * np.abs(u).max()
    # Its rows do not strain, and what holds the other end balances the load.
    x = result.solution.x
    end = x[:, 0] > 10.0
    moved = np.stack([np.ones(end.sum()), x[end, 1]], axis=1)
    assert np.abs(np.linalg.lstsq(moved, u[end, 0], rcond=None)[1]).max() < 1e-20
    held = result.solution.reaction[x[:, 0] < 1.0].sum(axis=0)
    assert np.abs(held + np.array([0.02, -0.03])).max() < 1e-9


BENT = """
import sys
import numpy as np
import pdpetsc as pd
from tests.terms.test_constraints import bent, pulled
cases = {
    "bent": bent(), "pulled": pulled(0.7, pd.Hencky(10.0, 0.3)), "relaxed": bent(solver=pd.DynamicRelaxation(1e-10))
}
case = cases[sys.argv[1]]
u = pd.run(case, output=sys.argv[2]).gathered(pd.displacement)
if u is not None:
    np.save(sys.argv[3], u)
"""


@pytest.mark.parametrize("name", ["bent", "pulled", "relaxed"])
def test_two_ranks_find_the_same(name, tmp_path):
    for ranks in (1, 2):
        script_on(ranks, BENT, name, tmp_path / f"run{ranks}", tmp_path / f"u{ranks}.npy")
    one, two = (np.load(tmp_path / f"u{ranks}.npy") for ranks in (1, 2))
    assert np.abs(one - two).max() < 1e-9 * np.abs(one).max()


def test_what_is_tied_twice_or_in_a_chain_is_refused(tmp_path):
    held, rigid, load = bent().conditions
    end = pd.region.Slab("x", low=10.0)
    with pytest.raises(pd.CaseError, match="another condition prescribes or ties"):
        pd.run(bent(conditions=[held, rigid, Along(end, (0.6, 0.8)), load]), output=tmp_path)
    with pytest.raises(pd.CaseError, match="another condition ties"):
        pd.run(bent(conditions=[held, rigid, pd.Displacement(end, y=0.5), load]), output=tmp_path)
    corner = end & pd.region.Slab("x", high=11.0) & pd.region.Slab("y", high=1.0)
    with pytest.raises(pd.CaseError, match="on which other tied ones depend"):
        pd.run(bent(conditions=[held, Along(corner, (0.6, 0.8)), rigid, load]), output=tmp_path)


def test_relaxation_keeps_tied_displacements(tmp_path):
    for name, case in {"bent": bent(), "pulled": pulled(0.7, pd.Hencky(10.0, 0.3))}.items():
        newton = pd.run(case, output=tmp_path / name)
        relaxed = pd.run(
            dataclasses.replace(case, solver=pd.DynamicRelaxation(1e-8)), output=tmp_path / f"{name}_relaxed"
        )
        u, v = newton.solution.u, relaxed.solution.u
        assert np.abs(v - u).max() < 1e-6 * np.abs(u).max()
        force = newton.solution.reaction
        assert np.abs(relaxed.solution.reaction - force).max() < 1e-6 * np.abs(force).max()


def test_a_linear_body_with_a_rigid_region_follows_a_straight_path(tmp_path):
    end = pd.region.Slab("x", low=11.0)
    newton = pd.run(bent(), output=tmp_path / "newton").solution.u
    falls = float(-newton[-1, 1])
    opening = pd.Opening("y", pd.region.Slab("x", high=1.0), against=end, step=0.3 * falls, end=falls)
    found = pd.run(bent(solver=pd.PathFollowing(opening)), output=tmp_path / "path")
    assert len(found.history["t"]) > 3
    load = found.history["t"][-1]
    assert np.abs(found.solution.u - load * newton).max() < 1e-8 * np.abs(newton).max()


@pytest.mark.parametrize(
    ("solver", "after"), [(pd.EventDriven(), 1), (pd.PathFollowing(pd.BondStretch(0.2), most=45), 0)],
    ids=["events", "path"],
)  # fmt: skip
def test_a_turned_body_with_rollers_breaks_as_a_straight_one(solver, after, tmp_path):
    """Its rollers are tied displacements in one case and prescribed components in the other.

    Events agree until two bonds are broken: behind them equal paths lead to either side, of which rounding chooses one.
    The steps of a path agree until a bond breaks: rounding decides on the size of the step that finds it.
    """
    breaking = {
        "scheme": None, "control": None, "solver": solver,
        "damage": pd.LinearSoftening(pd.ConstantCritical(0.02), 3.0),
        "history": {"broken": pd.BrokenBonds()},
    }  # fmt: skip
    cases = {
        "straight": pulled(0.0, pd.BondBased(10.0), normals=False, shaken=0.1, **breaking),
        "turned": pulled(0.7, pd.BondBased(10.0), shaken=0.1, **breaking),
    }
    for name, case in cases.items():
        with contextlib.suppress(pd.SolveError):  # the path has more than 45 steps
            pd.run(case, output=tmp_path / name)
    straight, turned = (pd.open(tmp_path / name) for name in cases)
    first = np.flatnonzero(np.asarray(straight.history["broken"]) >= 1 + after)
    until = slice(int(first[0]) + after)
    assert until.stop > 20 * (1 - after)
    assert np.array_equal(turned.history["broken"][until], straight.history["broken"][until])
    t = np.asarray(straight.history["t"])
    assert np.allclose(turned.history["t"][until], t[until], rtol=0.0, atol=1e-7 * t.max())


def test_every_step_of_a_path_lets_the_measure_grow(tmp_path):
    """Also where Newton fails first: without the forces of the step before, the measure had no weight then."""

    class Driven(pd.Quantity):
        def evaluate(self, solution):
            drives = solution.problem.damage.driving_values(solution.state)
            return solution.largest(float(drives[solution.problem.damage.bonds.intact].max()))

    case = pulled(
        0.0, pd.BondBased(10.0), normals=False, shaken=0.1, scheme=None, control=None,
        solver=pd.PathFollowing(pd.BondStretch(0.2), most=45),
        damage=pd.LinearSoftening(pd.ConstantCritical(0.02), 3.0),
        history={"broken": pd.BrokenBonds(), "driven": Driven()},
    )  # fmt: skip
    with contextlib.suppress(pd.SolveError):  # the path has more than 45 steps
        pd.run(case, output=tmp_path)
    h = pd.open(tmp_path).history
    whole, grown = np.diff(h["broken"]) == 0, np.diff(h["driven"])
    assert len(grown) == 45 and h["broken"][-1] > 2
    assert np.abs(grown[whole]).min() > 1e-4


def test_temperature_and_tied_displacements_are_found_together(tmp_path):
    warm = pd.Thermal(pd.Hencky(10.0, 0.3), lambda T: 0.05 + 0.01 * T, conductivity=1.0, capacity=2.0)
    fields = []
    for coupling in ("staggered", "monolithic"):
        case = pulled(0.7, warm, heat=pd.HeatConduction(duration=1.0, coupling=coupling))
        source = pd.HeatSource(pd.region.All(), 1.0, schedule=pd.Hold())
        case = dataclasses.replace(case, conditions=[*case.conditions, source])
        solution = pd.run(case, output=tmp_path / coupling).solution
        fields.append((solution.u, pd.temperature(solution)))
    for staggered, monolithic in zip(*fields, strict=True):
        assert np.abs(monolithic - staggered).max() < 1e-8 * np.abs(staggered).max()


def of_nodes(angle, path, rollers, load, **given):
    """Return a block of 4 x 2 on mesh nodes, turned by an angle, with rollers and a pressure on two of its sides."""
    points, cells = box("quad", (8, 4), 0.5 * turned(angle))
    written(path, points, [("quad", cells)])
    return pd.Case(
        particles=pd.MeshNodes(path), material=pd.LinearElastic(E=10.0, nu=0.3, plane="stress"),
        conditions=[*rollers, load], fields=[], **given,
    )  # fmt: skip


def test_rollers_on_an_inclined_side_leave_uniform_stress(tmp_path):
    R = turned(0.7)

    def side(test):
        return pd.region.Where(lambda x: test(x @ R))

    left, low = side(lambda y: y[:, 0] < 1e-6), side(lambda y: (y[:, 1] < 1e-6) & (y[:, 0] > 1e-6))
    corner = side(lambda y: (y[:, 0] < 1e-6) & (y[:, 1] < 1e-6))
    above = left & ~corner
    rollers = [
        pd.Displacement(corner, x=0.0, y=0.0),
        pd.Roller(above, normal=lambda x: np.tile(3.0 * R[:, 0], (len(x), 1))),
        pd.Roller(low, normal=R[:, 1]),
    ]
    pulled = pd.Traction(side(lambda y: y[:, 0] > 4.0 - 1e-6), x=0.2 * R[0, 0], y=0.2 * R[1, 0])
    result = pd.run(of_nodes(0.7, tmp_path / "block.vtk", rollers, pulled), output=tmp_path / "run")
    x, u = result.solution.x @ R, result.solution.u @ R
    np.testing.assert_allclose(u, 0.02 * x * [1.0, -0.3], atol=1e-9)
    force = result.solution.reaction[x[:, 0] < 1e-6].sum(axis=0) @ R
    np.testing.assert_allclose(force, [-0.4, 0.0], atol=1e-8)


def test_rollers_on_a_circle_allow_its_rotation_only(tmp_path):
    """A disc in a sleeve, held about its middle: forces along its rim turn it."""
    disc = pd.region.Sphere((0.0, 0.0), 1.0 + 1e-6)
    rim = pd.region.Where(lambda x: np.hypot(*x.T) > 0.8)
    case = pd.Case(
        particles=pd.LatticeNodes((-1.0, -1.0), (1.0, 1.0), 0.1, keep=disc),
        material=pd.LinearElastic(E=10.0, nu=0.3, plane="stress"),
        conditions=[
            pd.Roller(rim, normal=lambda x: x),
            pd.Displacement(pd.region.Sphere((0.0, 0.0), 0.25), x=0.0, y=0.0),
        ],
        fields=[],
    )
    ring = pd.BodyForce(rim, x=lambda x, t: -x[:, 1], y=lambda x, t: x[:, 0])
    result = pd.run(dataclasses.replace(case, conditions=[*case.conditions, ring]), output=tmp_path)
    x, u = result.solution.x, result.solution.u
    outside = np.hypot(*x.T) > 0.8
    assert np.abs((x * u).sum(axis=1)[outside]).max() < 1e-12
    turn = (x[:, 0] * u[:, 1] - x[:, 1] * u[:, 0])[outside] / (x[outside] ** 2).sum(axis=1)
    assert turn.min() > 0.0
    reaction = result.solution.reaction[outside]
    assert np.abs(x[outside, 0] * reaction[:, 1] - x[outside, 1] * reaction[:, 0]).max() < 1e-8 * np.abs(reaction).max()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({}, "either `axis`"),
        ({"axis": "x", "normal": (1.0, 0.0)}, "either `axis`"),
        ({"normal": (0.0, 0.0)}, "not zero"),
        ({"normal": (1.0, 0.0, 0.0)}, "shape"),
        ({"normal": lambda x: x[:, :1]}, "shape"),
    ],
)
def test_normals_of_rollers_are_checked(given, message, tmp_path):
    with pytest.raises(pd.CaseError, match=message):
        held = [pd.Roller(pd.region.Slab("x", high=0.0), **given), pd.Clamp("+y")]
        pd.run(
            pd.Case(
                particles=pd.LatticeNodes((0.0, 0.0), (2.0, 1.0), 0.25),
                material=pd.LinearElastic(E=10.0, nu=0.3, plane="stress"), conditions=held,
            ),
            output=tmp_path,
        )  # fmt: skip


@pytest.mark.parametrize("normal", [(0.0, 1.0), (0.2, 1.0)])
def test_a_roller_meets_another_support_at_a_corner(normal, tmp_path):
    """Along the axes it is a prescribed component; between them it follows the component that the other one holds."""
    low = pd.region.Slab("y", high=0.0)
    case = pd.Case(
        particles=pd.LatticeNodes((0.0, 0.0), (2.0, 1.0), 0.25),
        material=pd.LinearElastic(E=10.0, nu=0.3, plane="stress"),
        conditions=[pd.Roller("-x"), pd.Roller(low, normal=normal), pd.Traction("+x", x=1.0)],
        fields=[],
    )
    run = pd.run(case, tmp_path / "run")
    x, u = run.solution.x, run.solution.u
    assert np.abs(u[x[:, 1] == 0.0] @ normal).max() < 1e-15
    if normal[0] == 0.0:
        plain = dataclasses.replace(case, conditions=[pd.Roller("-x"), pd.Roller("-y"), pd.Traction("+x", x=1.0)])
        assert np.array_equal(u, pd.run(plain, tmp_path / "plain").solution.u)


def test_a_roller_on_a_line_holds_its_end(tmp_path):
    case = pd.Case(
        particles=pd.LatticeNodes(0.0, 1.0, 0.1), material=pd.LinearElastic(E=10.0, nu=0.0),
        conditions=[pd.Roller(pd.region.Slab("x", high=0.0), normal=(2.0,)), pd.Traction("+x", x=1.0)], fields=[],
    )  # fmt: skip
    u, x = pd.run(case, tmp_path).solution.u, np.linspace(0.0, 1.0, 11)
    np.testing.assert_allclose(u[:, 0], 0.1 * x, atol=1e-9)
