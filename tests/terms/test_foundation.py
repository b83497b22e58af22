"""Elastic foundation: sinking, tilting and sliding blocks, tangent, ranks, and what is refused."""

import dataclasses

import numpy as np
import pytest

import pdpetsc as pd
from tests.commands import script_on
from tests.mesh.test_meshes import box, written

E, K = 100.0, 5.0


def block(normal=K, tangential=0.0, dim=2, unit=1.0, cells=False, **changes):
    """Return a block of 2 x 1 (x 1) on a foundation that a traction on its upper side loads."""
    size = np.array([2.0, 1.0, 1.0])[:dim] * unit
    up, side = ("y", "x") if dim == 2 else ("z", "y")
    particles = pd.Lattice if cells else pd.LatticeNodes
    case = pd.Case(
        particles=particles(np.zeros(dim), size, 0.25 * unit),
        material=pd.LinearElastic(E=E, nu=0.0, plane="stress") if dim == 2 else pd.LinearElastic(E=E, nu=0.0),
        conditions=[
            pd.Roller(f"-{side}"),
            *([pd.Roller("-x")] if dim == 3 else []),
            pd.Foundation("-" + up, normal=normal, tangential=tangential, name="ground"),
            pd.Traction("+" + up, **{up: -1.0}),
        ],
        history={"top": pd.Mean(pd.displacement, up, "+" + up)},
    )  # fmt: skip
    return dataclasses.replace(case, **changes)


@pytest.mark.parametrize(("dim", "cells"), [(2, False), (2, True), (3, False)])
@pytest.mark.parametrize("options", [{}, {"pd_jacobian": "matfree"}])
def test_a_block_sinks_uniformly(dim, cells, options, tmp_path):
    run = pd.run(block(dim=dim, cells=cells, weights=pd.Conforming()), tmp_path, options=options)
    up = "y" if dim == 2 else "z"
    assert run.history["top"][-1] == pytest.approx(-1.0 / K - (0.875 if cells else 1.0) / E, rel=1e-7)
    assert run.history[f"ground_{up}"][-1] == pytest.approx(2.0, rel=1e-8)
    assert run.solution.energies["foundation"] == pytest.approx(1.0 / K, rel=1e-7)


def test_a_stiff_foundation_is_a_roller_and_units_do_not_matter(tmp_path):
    """A wavy load; with a millionth of the stiffness left the ends meet the roller's."""

    def case(*held, unit=1.0):
        wave = pd.Traction("+y", y=lambda x, t: t * np.cos(3.0 * x[:, 0] / unit))
        return dataclasses.replace(block(unit=unit), conditions=[pd.Roller("-x"), *held, wave])

    stiff = pd.run(case(pd.Foundation("-y", normal=1e9 * E)), tmp_path / "stiff").solution.u
    held = pd.run(case(pd.Roller("-y")), tmp_path / "held").solution.u
    assert np.abs(stiff - held).max() < 1e-6 * np.abs(held).max()
    soft, small = (
        pd.run(case(pd.Foundation("-y", normal=K / unit), unit=unit), tmp_path / f"{unit:g}").solution.u / unit
        for unit in (1.0, 1e-9)
    )
    assert np.abs(soft - small).max() < 1e-8 * np.abs(soft).max()


def test_friction_is_not_needed_to_hold_a_block_on_springs(tmp_path):
    """Springs across the normal carry a shear force: the mean displacement is the force over stiffness and area."""
    case = block(tangential=2.0)
    pushed = [case.conditions[1], pd.Traction("+y", x=0.1)]
    run = pd.run(
        dataclasses.replace(case, conditions=pushed, history={"x": pd.Mean(pd.displacement, "x", "-y")}), tmp_path
    )
    assert run.history["ground_x"][-1] == pytest.approx(-0.2, rel=1e-8)
    assert run.history["x"][-1] == pytest.approx(0.1 / 2.0, rel=1e-2)
    # The moment tilts the block: a linear pressure on the ground.
    assert run.history["ground_y"][-1] == pytest.approx(0.0, abs=1e-9)


RANKS = """
import sys
import numpy as np
import pdpetsc as pd
from tests.terms.test_foundation import block
u = pd.run(block(tangential=1.0, weights=pd.Conforming()), output=sys.argv[1]).gathered(pd.displacement)
if u is not None:
    np.save(sys.argv[2], u)
"""


def test_ranks_find_the_same(tmp_path):
    for ranks in (1, 3):
        script_on(ranks, RANKS, tmp_path / f"run{ranks}", tmp_path / f"u{ranks}.npy")
    one, three = (np.load(tmp_path / f"u{ranks}.npy") for ranks in (1, 3))
    assert np.abs(one - three).max() < 1e-9 * np.abs(one).max()


def test_what_it_does_not_hold_is_refused(tmp_path):
    free = block()
    with pytest.raises(pd.CaseError, match="rigid motion"):
        pd.run(dataclasses.replace(free, conditions=free.conditions[1:]), tmp_path)
    with pytest.raises(pd.CaseError, match="positive stiffness"):
        pd.Foundation("-y", normal=0.0)
    with pytest.raises(pd.CaseError, match="Two conditions are named"):
        pd.run(dataclasses.replace(free, conditions=[*free.conditions, free.conditions[1]]), tmp_path)


def ring(path, m, *more, off=0.0):
    """Return a ring of radii 1 and 2 of m by 8 m cells on a foundation outside; its hole is off the centre."""
    points, cells = [], []
    for k in range(8 * m):
        angle = 2.0 * np.pi * k / (8 * m)
        points += [[r * np.cos(angle) + off * (2.0 - r), r * np.sin(angle)] for r in np.linspace(1.0, 2.0, m + 1)]
        first, after = k * (m + 1), (k + 1) % (8 * m) * (m + 1)
        cells += [[first + i, first + i + 1, after + i + 1, after + i] for i in range(m)]
    written(path, np.array(points), [("quad", np.array(cells))])
    outside = pd.region.Where(lambda x: np.hypot(*x.T) > 2.0 - 0.2 / m)
    inside = pd.region.Where(lambda x: np.hypot(x[:, 0] - off, x[:, 1]) < 1.0 + 0.2 / m)
    return pd.Case(
        particles=pd.MeshNodes(path), material=pd.LinearElastic(E=E, nu=0.0, plane="stress"),
        conditions=[pd.Pressure(inside, 1.0), *(one(outside) for one in more)], fields=[],
    )  # fmt: skip


def test_normal_springs_on_a_circle_leave_its_rotation_free(tmp_path):
    """The facets would resist it by their angles, four times less after each refinement."""
    for m, off in ((2, 0.0), (4, 0.0), (3, 0.3), (6, 0.3)):
        case = ring(tmp_path / "ring.vtk", m, lambda outside: pd.Foundation(outside, normal=K), off=off)
        with pytest.raises(pd.CaseError, match="left with 1 of 3 rigid motions"):
            pd.run(case, tmp_path / "free")
    held = ring(tmp_path / "ring.vtk", 4, lambda outside: pd.Foundation(outside, normal=K, tangential=0.1 * K))
    run = pd.run(held, tmp_path / "held")
    u, x = run.solution.u, run.solution.x
    r = np.hypot(*x.T)
    # Lame's ring under the inner pressure 1 and the outer pressure K u: 3 E u = 4 - 10 K u.
    outer = (u * x).sum(axis=1)[r > 1.9] / r[r > 1.9]
    assert np.ptp(outer) < 0.02 * outer.mean()
    assert outer.mean() == pytest.approx(4.0 / (3.0 * E + 10.0 * K), rel=0.03)


@pytest.mark.parametrize("rows", [1, 2, 3])
def test_springs_on_opposite_sides_and_at_corners_hold(rows, tmp_path):
    """A particle with facets on two sides is held along both normals."""
    case = pd.Case(
        particles=pd.Lattice((0.0, 0.0), (4.0, 0.5 * rows), 0.5),
        horizon=1.01,
        material=pd.BondBased(E=E, plane="stress"),
        conditions=[pd.Foundation(pd.region.All(), normal=K), pd.Traction("+x", x=1.0)],
        fields=[],
    )
    assert np.isfinite(pd.run(case, tmp_path).solution.u).all()


@pytest.mark.parametrize("angle", [0.6, 0.7, np.pi / 4.0, 0.8, 0.9, 1.3])
@pytest.mark.parametrize("component", ["x", "y"])
def test_an_inclined_foundation_and_one_component_hold_a_block(angle, component, tmp_path):
    R = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    points, cells = box("quad", (4, 2), 0.5 * R)
    written(tmp_path / "block.vtk", points, [("quad", cells)])

    def side(test):
        return pd.region.Where(lambda x: test(x @ R))

    case = pd.Case(
        particles=pd.MeshNodes(tmp_path / "block.vtk"),
        material=pd.LinearElastic(E=E, nu=0.0, plane="stress"),
        conditions=[
            pd.Displacement(side(lambda y: y[:, 0] < 1e-6), **{component: 0.0}),
            pd.Foundation(side(lambda y: y[:, 1] < 0.3), normal=K),
            pd.Traction(side(lambda y: y[:, 1] > 0.8), x=R[0, 1], y=R[1, 1]),
        ],
        fields=[],
    )
    assert np.isfinite(pd.run(case, tmp_path / "run").solution.u).all()
