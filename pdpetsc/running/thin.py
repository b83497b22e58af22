"""Note on a thin body that bends: the horizon is too wide for its thickness."""

from __future__ import annotations

import math

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.case import Case
from pdpetsc.declare.particles import Lattice
from pdpetsc.discrete.communicator import total
from pdpetsc.errors import PdpetscError
from pdpetsc.problem.problem import Problem

# Thickness in horizons below which the deflection of a cantilever is 10 % or more too large: 73 % at 2, 34 % at 2.7 and
# 13 % at 4 for horizons of 1.5 spacings, 31 % at 2 and 9 % at 4 for 3.015. Half of the families or more are then cut.
THIN = 4.0
# Thickness in horizons at which the error is 3 %.
ACCURATE = 8.0
# Horizons in spacings below which the error is not of this kind: a cantilever is 6 % too stiff with three particles.
NEAREST, LEAST_RATIO = 1.25, 1.015
# Least ratio of length to thickness for which bending dominates.
SLENDER = 4.0
# Largest share of a layer that supports may hold across the body if it still bends.
HELD = 0.5
# Least share of the forces in a cross-section, or of their couple, that makes it bend.
ACROSS = 1e-2


def thin_note(case: Case, problem: Problem) -> str:
    """Return the note on a slender lattice that bends across a thickness of few horizons, if it applies.

    The load or a prescribed displacement of the first step must act across the thickness, or as a couple about it.

    Notes
    -----
    Collective.
    """
    lattice, cloud, dim = case.particles, problem.body.cloud, problem.dim
    if not isinstance(lattice, Lattice) or dim == 1 or cloud.varies:
        return ""
    size = lattice.box[1] - lattice.box[0]
    across, along = int(np.argmin(size)), int(np.argmax(size))
    thicker = {f"-{'xyz'[across]}", f"+{'xyz'[across]}"} & set(lattice.fictitious)
    if lattice.cut is not None or lattice.keep is not None or thicker:
        return ""
    bounded = across not in (() if case.cell is None else case.cell.periodic)
    mirrored = "xyz"[across] in [plane.axis for plane in case.symmetry]
    thickness, spacing, horizon = float(size[across]), float(lattice.spacing), cloud.horizon
    thin = NEAREST * spacing < horizon and thickness < THIN * horizon and size[along] >= SLENDER * thickness
    if not thin or not bounded or mirrored or not _bends(case, problem, across, along):
        return ""
    nearest = "" if case.of_bonds or case.damage is not None else f", or horizon={LEAST_RATIO * spacing:.4g}"
    return (
        f"the body bends and is {thickness / horizon:.2g} horizons thick along {'xyz'[across]}: deflections are 10 % "
        f"or more too large; use {math.ceil(ACCURATE * horizon / spacing - 0.5)} cells over it{nearest}"
    )


def _bends(case: Case, problem: Problem, across: int, along: int) -> bool:
    """Return True if supports leave the body free to bend, and the first step bends it (collective)."""
    cloud, spacing = problem.body.cloud, case.particles.spacing  # type: ignore[attr-defined]
    n, first = cloud.n_owned, min(case.steps.first, case.steps.stops()[0])
    low, high = case.particles.box  # type: ignore[attr-defined]
    counts = np.round((high - low) / spacing).astype(int)
    layer, section = (
        np.clip(((cloud.x[:n, axis] - low[axis]) / spacing).astype(int), 0, counts[axis] - 1)
        for axis in (across, along)
    )

    def summed(index: Float, weight: Float, axis: int) -> Float:
        return np.asarray(total(cloud.comm, np.bincount(index, weight, counts[axis])))

    fixed = problem.supports.fixed[:n, across].astype(float)
    if (summed(layer, fixed, across) > HELD * summed(layer, np.ones(n), across)).any():
        return False
    zero = np.zeros(problem.supports.fixed.shape)
    try:
        moved = problem.supports.prescribed(first)[:n]
        force = problem.external_force(problem.state(zero, first))[:n]
    except PdpetscError:  # reported by the run
        return False
    arm = cloud.x[:n, across] - 0.5 * (low[across] + high[across])
    whole = summed(section, np.abs(force).sum(axis=1), along).sum()
    shear = np.abs(summed(section, force[:, across], along)).max()
    couple = np.abs(summed(section, force[:, along] * arm, along)).max() / (high[across] - low[across])
    lifted = float(summed(section, np.abs(moved[:, across]), along).max())
    return bool(lifted > 0.0 or max(shear, couple) > ACROSS * whole > 0.0)
