"""Note on a thin body that bends: few cells over its thickness, or a horizon too wide for it."""

from __future__ import annotations

import math

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.case import Case
from pdpetsc.declare.particles import Lattice, LatticeNodes
from pdpetsc.declare.supports import Foundation
from pdpetsc.discrete.communicator import total
from pdpetsc.errors import PdpetscError
from pdpetsc.gradient import SubHorizons
from pdpetsc.problem.problem import Problem

# Thickness at which the deflection of a cantilever is off by about 5 %, in horizons if the horizon is wide, else in
# cells (docs/reference/measured/defaults.md): a horizon of fewer spacings than NEAREST has nearest neighbours only, and
# nodes with horizons below NARROW have conforming weights of second order. Half of it is off by 25 % or more, twice of
# it by 3 % or less. Other schemes, weights and bond materials err at wide horizons by 10 to 140 %, with either sign.
WIDE, NODES, NEAREST_LATTICE, NEAREST_NODES = 4.0, 3, 3, 8
NEAREST, NARROW = 1.25, 2.25
# The most accurate horizons in spacings.
BEST, BEST_OF_NODES = 1.015, 2.015
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
    if not isinstance(lattice, Lattice | LatticeNodes) or dim == 1 or cloud.varies:
        return ""
    # Elastic beds carry load beside the bending stiffness.
    if case.terms or any(isinstance(condition, Foundation) for condition in case.conditions):
        return ""
    low, high = lattice.box
    size = high - low
    across, along = int(np.argmin(size)), int(np.argmax(size))
    layers = lattice.fictitious if isinstance(lattice, Lattice) else {}
    if lattice.cut is not None or lattice.keep is not None or {f"-{'xyz'[across]}", f"+{'xyz'[across]}"} & set(layers):
        return ""
    bounded = across not in (() if case.cell is None else case.cell.periodic)
    mirrored = "xyz"[across] in [plane.axis for plane in case.symmetry]
    cells, ratio = round(float(size[across]) / lattice.spacing), cloud.horizon / lattice.spacing
    enough, best = _enough(case, ratio)
    if cells >= enough or size[along] < SLENDER * size[across] or not bounded or mirrored:
        return ""
    if not _bends(case, problem, across, along):
        return ""
    off = 25 if 2 * cells < enough else 5
    other = f", or horizon={best * lattice.spacing:.4g}" if best and case.damage is None else ""
    return (
        f"the body bends and is {cells} cell{'s' if cells > 1 else ''} thick along {'xyz'[across]}, "
        f"{cells / ratio:.2g} horizons: deflections are {off} % or more off; use {math.ceil(2 * enough - 0.5)} cells "
        f"over it{other}"
    )


def _enough(case: Case, ratio: float) -> tuple[float, float]:
    """Return the thickness in cells at which the error is 5 %, and a better horizon in spacings or 0.

    ``ratio`` is the horizon of the case in spacings (not collective).
    """
    nodes = isinstance(case.particles, LatticeNodes)
    if case.of_bonds or case.weights is not None or not isinstance(case.gradients, SubHorizons):
        return (WIDE * ratio if ratio > NEAREST else 0.0), 0.0
    if ratio <= NEAREST:
        return (NEAREST_NODES, BEST_OF_NODES) if nodes else (NEAREST_LATTICE, 0.0)
    if nodes and ratio < NARROW:
        return NODES, 0.0
    return WIDE * ratio, BEST_OF_NODES if nodes else BEST


def _bends(case: Case, problem: Problem, across: int, along: int) -> bool:
    """Return True if supports leave the body free to bend, and the first step bends it (collective)."""
    cloud, lattice = problem.body.cloud, case.particles
    assert isinstance(lattice, Lattice | LatticeNodes)
    n, first = cloud.n_owned, min(case.steps.first, case.steps.stops()[0])
    low, high = lattice.box
    nodes = isinstance(lattice, LatticeNodes)
    counts = np.round((high - low) / lattice.spacing).astype(int) + nodes
    layer, section = (
        np.clip(((cloud.x[:n, axis] - low[axis]) / lattice.spacing + 0.5 * nodes).astype(int), 0, counts[axis] - 1)
        for axis in (across, along)
    )

    def summed(index: Float, weight: Float, axis: int) -> Float:
        return np.asarray(total(cloud.comm, np.bincount(index, weight, counts[axis])))

    fixed = problem.supports.fixed[:n, across].astype(float)
    if (summed(layer, fixed, across) > HELD * summed(layer, np.ones(n), across)).any():
        return False
    try:
        moved, force = (values[:n] for values in problem.given(first))
    except PdpetscError:  # reported by the run
        return False
    arm = cloud.x[:n, across] - 0.5 * (low[across] + high[across])
    whole = summed(section, np.abs(force).sum(axis=1), along).sum()
    shear = np.abs(summed(section, force[:, across], along)).max()
    couple = np.abs(summed(section, force[:, along] * arm, along)).max() / (high[across] - low[across])
    lifted = float(summed(section, np.abs(moved[:, across]), along).max())
    return bool(lifted > 0.0 or max(shear, couple) > ACROSS * whole > 0.0)
