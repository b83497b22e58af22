"""Conforming weights: the smallest change of weights that satisfies the divergence theorem for every particle."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import replace
from typing import TypeAlias

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.communicator import largest, total
from pdpetsc.discrete.components import find_pieces
from pdpetsc.discrete.families import Families
from pdpetsc.discrete.surface import Surface
from pdpetsc.errors import NoConformingWeights
from pdpetsc.gradient.base import GradientOperator
from pdpetsc.gradient.conforming_system import ConformingSystem
from pdpetsc.gradient.near_inverse import NearInverse, near_inverses

# Tolerance of the divergence theorem, as a share of the largest sum of weights of a particle.
TOLERANCE = 1e-10
# Tolerance at which the solves of the system end. The weights are off by more than the theorem, by the root of the
# condition number of the system. With 1e-10 a quarter of a mesh breaks otherwise than the whole.
AIM = 1e-12
# Largest number of solves of the system, each for the remaining right-hand side, and their relative tolerance. The
# system is singular: closer to round-off, conjugate gradients may diverge.
ROUNDS, SOLVED = 4, 1e-6
# Largest relative change of the weights, in the norm over the body. Of 301 clouds, five had larger changes, 1.2 to 1.9,
# and errors up to thirty times those with a slightly wider horizon. Clouds with smaller changes had no such errors
# (docs/theory/conforming.md).
REFUSED = 1.0
# Relative change above which the log names the point; 286 of the 301 clouds have no such point.
NOTED = 4.0
# Number of iterations above which the log reports them. They grow with the number of particles if families leave little
# freedom.
MANY = 1000
# Tolerance of the gradients of linear fields.
EXACT = 1e-8


# Solves S lambda = r of a system with an approximate inverse: r (n_owned, dim), tolerance -> lambda, iterations.
SolveSystem: TypeAlias = (
    "Callable[[ConformingSystem, NearInverse], AbstractContextManager[Callable[[Float, float], tuple[Float, int]]]]"
)


def conforming(
    cloud: Cloud, families: Families, operator: GradientOperator, surface: Surface, solve: SolveSystem
) -> GradientOperator:
    """Compute weights that satisfy the discrete divergence theorem, ``sum_p W_p g_pk = s_k`` for every particle.

    ``s_k = sum_f N_f(x_k) a_f`` over the facets of the surface. Linear fields remain exact, ``sum_k g_pk = 0``,
    ``sum_k x_k (x) g_pk = I``. Of all such weights these are nearest to those of the scheme, ``min sum |dg_pk|^2``. A
    uniform stress is then in equilibrium with its tractions on any cloud.

    Parameters
    ----------
    operator : GradientOperator
        The gradient of any scheme.
    surface : Surface
        The facets of the own particles.
    solve : callable
        Solves a ``ConformingSystem``.

    Raises
    ------
    NoConformingWeights
        No such weights exist for these families, or they differ from those of the scheme by more than 100 %, on every
        rank.

    Notes
    -----
    Collective.

    References
    ----------
    Chiu2012, for finite-difference operators of fluids.
    """
    s = np.zeros((cloud.n_local, cloud.dim))
    surface.spread(surface.area, s)
    given, operator = operator, operator.listed
    system = ConformingSystem(cloud, operator, find_pieces(cloud, families))
    sums = np.bincount(
        operator.members,
        np.repeat(operator.volume, np.diff(operator.point_ptr)) * np.linalg.norm(operator.g, axis=1),
        cloud.n_local,
    )
    scale = largest(cloud.comm, sums, initial=0.0)
    excess = system.excess(operator.g, s)
    before = largest(cloud.comm, np.abs(excess), initial=0.0)
    if before <= TOLERANCE * scale:
        return given
    g, left, after, iterations = operator.g, excess, before, 0
    for near_inverse in near_inverses(system):
        with solve(system, near_inverse(system, families)) as solved:
            for _ in range(ROUNDS):
                multipliers, more = solved(-left, max(0.1 * AIM * scale / after, SOLVED))
                changed = g + system.change(multipliers)
                rest = system.excess(changed, s)
                found = largest(cloud.comm, np.abs(rest), initial=0.0)
                iterations += more
                if not found < 0.5 * after:
                    break
                g, left, after = changed, rest, found
                if after <= AIM * scale:
                    break
        if after <= TOLERANCE * scale:
            break
    if not after <= TOLERANCE * scale:
        after, worst = _worst(cloud, np.abs(left).max(axis=1, initial=0.0), cloud.x)
        raise NoConformingWeights(
            f"No conforming weights were found: the divergence theorem is off by {after / scale:.1e} of the weights of "
            f"a particle at {worst} after {iterations} iterations; its family is too "
            f"small to be changed, so widen the horizon, or its facets are not those of its cell."
        )
    notes = [operator.note, _judged(cloud, operator, g, iterations)]
    return replace(operator, g=g, note="; ".join(filter(None, notes)))


def _judged(cloud: Cloud, operator: GradientOperator, g: Float, iterations: int) -> str:
    """Return the note on changed weights ``g``; raise NoConformingWeights on all ranks if they are bad (collective)."""
    first = operator.point_ptr[:-1]
    changed, before = (np.add.reduceat((w**2).sum(axis=1), first) for w in (g - operator.g, operator.g))
    sums = total(cloud.comm, np.array([changed.sum(), before.sum()]))
    whole = float(np.sqrt(sums[0] / sums[1]))
    change, worst = _worst(cloud, np.sqrt(changed / before), cloud.x[operator.owner])
    if whole > REFUSED:
        raise NoConformingWeights(
            f"Conforming weights would change by {whole:.2g} times what they are, most of all by {change:.2g} times at "
            f"{worst}: families leave too little to choose; widen the horizon."
        )
    # Relative to the middle of the rank, to avoid round-off for bodies far from the origin.
    linear = replace(operator, g=g).gradient(cloud.x - cloud.x[: cloud.n_owned].mean(axis=0))
    off = np.abs(linear - np.eye(cloud.dim)).max(axis=(1, 2), initial=0.0)
    inexact, where = _worst(cloud, off, cloud.x[operator.owner])
    if not inexact <= EXACT:
        raise NoConformingWeights(
            f"No conforming weights were found: linear fields are off by {inexact:.1e} at {where}, whose family is "
            f"nearly flat; widen the horizon."
        )
    note = f"conforming weights, {iterations} iterations, changed by {whole:.2g}, at a point by at most {change:.2g}"
    if change > NOTED or iterations > MANY:
        note += f", at {worst}: families leave little to choose, which a wider horizon mends"
    return note


def _worst(cloud: Cloud, values: Float, x: Float) -> tuple[float, list[float]]:
    """Return the largest of values (n,) of all ranks, and its position (collective)."""
    here = (float(values.max()), x[int(np.argmax(values))].tolist()) if len(values) else (0.0, [])
    value, where = max(cloud.comm.allgather(here))
    return value, where
