"""Regions that move as rigid bodies: values, moments, a strip rolled to a circle, refusals."""

from __future__ import annotations

import numpy as np
import pytest

import pdpetsc as pd
from tests.commands import results


def scene(particles, *conditions, **changes):
    dim = len(particles.low)
    given = {
        "particles": particles,
        "horizon": 0.25 * 1.5075,
        "material": pd.NeoHookean(E=100.0, nu=0.3),
        "conditions": conditions,
        "history": {
            "left": pd.ReactionMoment("-x", about=(0.3,) * dim),
            "right": pd.ReactionMoment("+x", about=(0.3,) * dim),
            "force": pd.Reaction("y", "+x"),
        },
        "steps": pd.Steps(4),
    }
    return pd.Case(**{**given, **changes})


@pytest.mark.parametrize("nodes", [True, False])
@pytest.mark.parametrize("dim", [2, 3])
def test_a_body_between_two_regions_that_move_alike_moves_as_they_do(nodes, dim, tmp_path):
    """A rotation by two radians and a displacement: no stress, no moment."""
    kind = pd.LatticeNodes if nodes else pd.Lattice
    particles = kind((0.0,) * dim, (1.5,) + (1.0,) * (dim - 1), 0.25)
    turn = 2.0 if dim == 2 else (0.5, -1.0, 1.5)
    motion = {"turn": turn, "move": (0.3,) * dim, "about": (0.2,) * dim}
    case = scene(particles, pd.RigidRegion("-x", **motion), pd.RigidRegion("+x", **motion), steps=pd.Steps(8))
    run = pd.run(case, tmp_path)
    R, d = pd.RigidRegion("-x", **motion).motion(1.0, dim)
    x = run.x[:, :dim]
    np.testing.assert_allclose(run.field("displacement")[:, :dim], (x - 0.2) @ R.T + 0.2 + d - x, atol=1e-7)
    assert np.abs(run.field("stress")).max() < 1e-5
    assert abs(run.history["right"][-1]) < 1e-5


@pytest.mark.parametrize("nodes", [True, False])
def test_moments_of_both_ends_balance(nodes, tmp_path):
    """A block that one end turns: the moments about any point at rest add up to zero."""
    kind = pd.LatticeNodes if nodes else pd.Lattice
    particles = kind((0.0, 0.0), (2.0, 1.0), 0.25)
    turned = pd.RigidRegion("+x", turn=0.3, move=(0.0, 0.2), about=(2.0, 0.5))
    history = pd.run(scene(particles, pd.Clamp("-x"), turned), tmp_path).history
    assert history["right"][-1] > 0.3
    assert history["left"][-1] == pytest.approx(-history["right"][-1], rel=1e-8)


def test_a_region_inside_a_lattice_turns(tmp_path):
    """Any region of a lattice is held itself."""
    core = pd.region.Sphere((1.0, 1.0), 0.4)
    turned = pd.RigidRegion(core, turn=0.2, about=(1.0, 1.0))
    frame = ~pd.region.Box((0.2, 0.2), (1.8, 1.8))
    case = scene(pd.Lattice((0.0, 0.0), (2.0, 2.0), 0.25), pd.Displacement(frame, x=0.0, y=0.0), turned)
    moments = {"core": pd.ReactionMoment(core, (1.0, 1.0)), "frame": pd.ReactionMoment(frame, (1.0, 1.0))}
    history = pd.run(scene(case.particles, *case.conditions, history=moments), tmp_path).history
    assert history["core"][-1] > 0.1
    assert history["frame"][-1] == pytest.approx(-history["core"][-1], rel=1e-8)


def test_a_strip_is_rolled_to_a_circle(tmp_path):
    results("runs/beams/rolled.py", "n=4", "--check", output=tmp_path)


def test_what_cannot_move_is_refused(tmp_path):
    nodes = pd.LatticeNodes((0.0, 0.0), (1.0, 1.0), 0.25)
    with pytest.raises(pd.CaseError, match="turns about a point of 2 numbers, not 0"):
        pd.prepare(scene(nodes, pd.RigidRegion("-x", turn=0.1)))
    with pytest.raises(pd.CaseError, match="moves by 3 numbers in 2 dimensions"):
        pd.prepare(scene(nodes, pd.RigidRegion("-x", move=(0.0, 0.0, 1.0))))
    with pytest.raises(pd.CaseError, match="takes a point of 2 numbers in 2 dimensions"):
        wrong = {"m": pd.ReactionMoment("-x", about=(0.0, 0.0, 0.0))}
        pd.run(scene(nodes, pd.Clamp("-x"), history=wrong), tmp_path)
