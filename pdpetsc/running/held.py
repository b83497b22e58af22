"""Warnings and notes on supports that hold more than a point, a side or an unloaded body."""

from __future__ import annotations

import itertools
from typing import TypeVar

import numpy as np

from pdpetsc.arrays import Mask
from pdpetsc.case import Case
from pdpetsc.declare.conditions import Condition, Displacement, condition_name
from pdpetsc.declare.particles import Lattice, LatticeNodes
from pdpetsc.declare.region import SIDES
from pdpetsc.declare.supports import Clamp, PointSupport, RigidRegion
from pdpetsc.declare.tools import Contact
from pdpetsc.discrete.communicator import anywhere, bounds, count_nonzero, largest, total
from pdpetsc.discrete.components import find_pieces
from pdpetsc.discrete.selection import select
from pdpetsc.errors import SolveError
from pdpetsc.problem.problem import Problem
from pdpetsc.terms.prescribed_loads import SHOWN, PrescribedLoads

Kind = TypeVar("Kind", bound=Condition)

# A held patch is a bearing, not a clamp, up to this share of the smaller side of its body.
SMALL = 0.5
# A note tells of loads of which more than this share acts on held components.
MOST = 0.5
# Lengths below this share of the body, and shares of a spacing, are round-off.
ROUND_OFF = 1e-6


def named(case: Case, kind: type[Kind]) -> list[tuple[str, Kind]]:
    """Return the conditions of a kind with their names in messages."""
    numbered = enumerate(case.conditions, 1)
    return [(condition_name(one, number), one) for number, one in numbered if isinstance(one, kind)]


def support_warnings(case: Case, problem: Problem) -> list[str]:
    """Return the warnings about bearings that resist rotation, or hold a single particle (collective)."""
    cloud, dim = problem.body.cloud, problem.dim
    n = cloud.n_owned
    held: dict[str, Mask] = {}
    for name, axis, where in problem.supports.held_components():
        held.setdefault(name, np.zeros((n, dim), dtype=bool))[where, axis] = True
    for name, _ in named(case, RigidRegion):
        held.pop(name, None)
    found = []
    # Quasi-static cases only: PointSupport is not available in motions.
    for name, components in held.items() if problem.inertia is None else ():
        if _resists_rotation(case, problem, components):
            chosen = components.any(axis=1)
            count, *middle = total(cloud.comm, [np.count_nonzero(chosen), *cloud.x[:n][chosen].sum(axis=0)]).tolist()
            # Zero without sign and round-off.
            near = ", ".join(f"{x / count:.3g}" if abs(x) > ROUND_OFF * cloud.horizon else "0" for x in middle)
            found.append(
                f"{name} holds {count:.0f} particles near ({near}) and resists rotation. For a bearing use "
                f"pd.PointSupport on a patch."
            )
    for name, count in particles_of_point_supports(case, problem).items():
        if count == 1:
            found.append(
                f"{name} holds the mean of one particle, and the displacement there depends on the spacing. Use a "
                f"patch two to four spacings wide."
            )
    return found


def particles_of_point_supports(case: Case, problem: Problem) -> dict[str, int]:
    """Return the number of particles of each point support by name (collective)."""
    cloud = problem.body.cloud
    return {
        name: count_nonzero(cloud.comm, select(cloud, condition.region, name))
        for name, condition in named(case, PointSupport)
    }


def _resists_rotation(case: Case, problem: Problem, held: Mask) -> bool:
    """Return True if held components (n_owned, dim) of a small patch resist a rotation that others leave free.

    In the plane of a held direction ``a`` and another direction ``b`` the patch is small, and has more than one
    position along ``b``. Exceptions are a patch without another support or a mirror plane, which is a clamp, a patch
    that holds a whole side of the body, and a patch at a mirror plane.

    Notes
    -----
    Collective.
    """
    cloud, dim = problem.body.cloud, problem.dim
    n, comm = cloud.n_owned, cloud.comm
    x, chosen, fixed = cloud.x[:n], held.any(axis=1), problem.supports.fixed[:n]
    ends = bounds(comm, x[chosen])
    size = ends[1] - ends[0]
    mirrored = np.zeros(dim, dtype=bool)
    for plane in case.symmetry:
        axis = "xyz".index(plane.axis)
        mirrored[axis] = True
        if np.abs(ends[:, axis] - plane.at).min() < cloud.horizon:
            return False
    holds = total(comm, np.count_nonzero(held, axis=0)) > 0
    # A periodic body does not rotate.
    periodic = () if case.cell is None else case.cell.periodic
    others = (total(comm, np.count_nonzero(fixed[~chosen], axis=0)) > 0) | mirrored

    def resists(piece: Mask) -> bool:
        low, high = bounds(comm, x[piece])
        body = high - low
        whole = np.zeros(dim, dtype=bool)
        for side in (x - low, high - x):
            outer = (side <= ROUND_OFF * body) & piece[:, None]
            whole |= total(comm, np.count_nonzero(outer & ~chosen[:, None], axis=0)) == 0
        return any(
            holds[a] and (others[a] or others[b])
            and not (whole[a] or whole[b] or {a, b} & {*periodic})
            and max(size[a], size[b]) <= (SMALL + ROUND_OFF) * min(body[a], body[b])
            and size[b] > ROUND_OFF * body[b]
            for a, b in itertools.permutations(range(dim), 2)
        )  # fmt: skip

    if not resists(np.ones(n, dtype=bool)):
        return False
    # Its own body may be smaller.
    pieces = find_pieces(cloud, problem.body.families, problem.joined)
    return resists(np.isin(pieces, np.concatenate(comm.allgather(np.unique(pieces[chosen])))))


def layer_notes(case: Case, problem: Problem) -> list[str]:
    """Return the notes on supports that hold a layer inside a side of a lattice instead of the side (collective)."""
    lattice, cloud = case.particles, problem.body.cloud
    if not isinstance(lattice, Lattice | LatticeNodes):
        return []
    found: list[str] = []
    x = cloud.x[: cloud.n_owned]
    low, high = lattice.box
    # Depth of the outermost particles.
    outermost = 0.5 * lattice.spacing if isinstance(lattice, Lattice) else 0.0
    layers = lattice.fictitious if isinstance(lattice, Lattice) else {}
    supports: list[tuple[str, Displacement | Clamp]] = [*named(case, Displacement), *named(case, Clamp)]
    for name, condition in supports:
        held = select(cloud, condition.region, name)
        for side in SIDES[: 2 * cloud.dim]:
            axis = "xyz".index(side[1])
            value = getattr(condition, side[1]) if isinstance(condition, Displacement) else 0.0
            if value is None or side in layers:
                continue
            depth = x[:, axis] - low[axis] if side[0] == "-" else high[axis] - x[:, axis]
            deepest = largest(cloud.comm, depth[held])
            first, last = (depth <= end + ROUND_OFF * lattice.spacing for end in (outermost, deepest))
            counts = [first, first & held, last, held]
            in_first, held_first, in_last, all_held = (
                int(count) for count in total(cloud.comm, [np.count_nonzero(one) for one in counts])
            )
            deep = deepest > outermost + ROUND_OFF * lattice.spacing and not callable(value)
            if deep and in_last == all_held < cloud.n_global:
                found.append(
                    f"{name} holds a layer {deepest:.4g} deep at side {side}: the body is shorter by it; "
                    f"pd.Clamp({side!r}) or pd.Roller({side!r}) holds the side itself"
                )
            elif outermost > 0.0 and 0 < in_first == held_first:
                found.append(
                    f"{name} holds side {side} half a spacing inside the surface; pd.Clamp({side!r}) or "
                    f"pd.Roller({side!r}) holds the side itself"
                )
    return found


def held_load_note(case: Case, problem: Problem) -> str:
    """Return the note on loads that act on held particles, if it applies (collective)."""
    supports, n = problem.supports, problem.body.cloud.n_owned
    held = supports.fixed.copy()
    if supports.ties is not None:
        held &= ~supports.ties.tied
    for _, rigid in problem.rigid_bodies:
        if rigid.rows is not None:
            held[rigid.rows] = False
    loads = [term for term in problem.terms if isinstance(term, PrescribedLoads)]
    found = [
        f"{name}: {100.0 * share:.0f} % of its force acts on particles that are held, and does not load the body"
        for term in loads
        for name, share in term.shares_on(held[:n])
        if share > MOST
    ]
    return "; ".join(found)


def no_load_note(case: Case, problem: Problem) -> str:
    """Return the note on a case without load, if it applies (collective).

    The undeformed body is then in equilibrium at all load parameters. Motions, vibration modes, solved fields, tools
    and loaded rigid bodies are excluded.
    """
    moving = problem.inertia is not None or problem.rigid_bodies or named(case, Contact)
    if moving or case.modes is not None or problem.fields:
        return ""
    comm, zero = problem.body.cloud.comm, np.zeros(problem.supports.fixed.shape)
    try:
        for t in (*SHOWN, *case.steps.stops()):
            if anywhere(comm, problem.given(t)):
                return ""
        for t in SHOWN:
            internal = problem.internal_force(problem.state(zero, t))
            if internal is None or anywhere(comm, internal):
                return ""
    except SolveError:  # an error of the case, reported by the run
        return ""
    return "the case has no load: all loads and prescribed displacements are zero"
