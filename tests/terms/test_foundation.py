"""Elastic foundation: sinking, tilting and sliding blocks, tangent, ranks, and what is refused."""

import dataclasses

import numpy as np
import pytest

import pdpetsc as pd
from tests.commands import script_on

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
    with pytest.raises(pd.CaseError, match="Two"):
        pd.run(dataclasses.replace(free, conditions=[*free.conditions, free.conditions[1]]), tmp_path)
