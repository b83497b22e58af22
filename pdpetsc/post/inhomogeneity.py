"""How the energy density of a body depends on place at a constant deformation gradient."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, Mask
from pdpetsc.post.bonds_left import pairs_of
from pdpetsc.post.integrands import integrands_of, range_on_ranks
from pdpetsc.post.solution import Solution

# Numbers that differ by less than this share are the same: round-off of sums.
SAME = 1e-12
# Neighbours are next to each other up to this many times the least distance.
NEXT = 1.3
# What a slope leaves unexplained grows with the square of the distance where a field is smooth, and falls with it where
# the field jumps: next neighbours have less than this share of what the farthest ones have, or a jump lies between.
SMOOTH = 0.5
# It does not count below this share of the range of a field; nor does it, where all neighbours are next, below the
# second.
NOTHING, ROUGH = 1e-5, 0.05
# Within so many horizons of a crack tip, at most this share of the outer radius, a temperature may have a singular
# slope: that of the root of the distance, up to this many times.
SINGULAR, SINGULAR_MOST, STEEPER = 2.0, 0.5, 3.0

# It has one where the mean square of its slope within that distance is at least this many times that around.
ROOT = 1.6

# What differs between particles, in words.
STRAIN, MODULI = "strain without stress", "moduli"


@dataclass(frozen=True)
class OfPlace:
    """What the energy density reads besides the deformation gradient.

    Attributes
    ----------
    solution : Solution
        A state.
    strain : (n_local, 4) float64 or None
        Strain without stress, xx, yy, xy and zz [-]; of bodies of bonds what the body shows of it.
    factor : (n_local,) float64
        What multiplies the moduli, of place and of temperature [-].
    temperature : (n_local,) float64 or None
        Where a law depends on it otherwise.
    given : tuple of (str, (n_local,) float64)
        What no temperature makes of these, with what it is: eigenstrains, and moduli graded by place.
    """

    solution: Solution
    strain: Float | None
    factor: Float
    temperature: Float | None
    given: tuple[tuple[str, Float], ...]

    @property
    def graded(self) -> Float:
        """Return what multiplies the moduli by place alone (n_local,) [-]."""
        return self.given[0][1]

    @cached_property
    def columns(self) -> list[tuple[str, Float]]:
        """Return all its numbers (n_local,) with what they are."""
        found = [] if self.strain is None else [(STRAIN, column) for column in self.strain.T]
        found.append((MODULI, self.factor))
        if self.temperature is not None:
            found.append(("a temperature", self.temperature))
        return found


def of_place(solution: Solution) -> OfPlace:
    """Return what the energy density reads besides the deformation gradient (collective)."""
    return solution.state.kept("of place", lambda: _of_place(solution))


def _of_place(solution: Solution) -> OfPlace:
    expansion = solution.state.expansion
    integrands = integrands_of(solution)
    _, graded = integrands.materials()
    factor = _with_ghosts(solution, graded)
    if expansion is None:
        return OfPlace(solution, None, factor, None, ((MODULI, factor),))
    of_temperature = expansion.factor
    whole = factor if of_temperature is None else _with_ghosts(solution, graded * of_temperature)
    own = integrands.strain_of_body(expansion)
    given = ((MODULI, factor), *((STRAIN, one) for one in _shown(solution, expansion.eigenstrain).T))
    by_law = any(one is not None and one.law is not None for one in expansion.of.thermals)
    temperature = expansion.temperature if by_law else None
    kept = None if temperature is None else _with_ghosts(solution, temperature)
    return OfPlace(solution, _shown(solution, own), whole, kept, given)


def _shown(solution: Solution, own: Float) -> Float:
    """Return strains of the own particles (n_owned, 3, 3) as those of the local ones (n_local, 4) (collective)."""
    cloud, strain = solution.cloud, _with_ghosts(solution, own)
    # Behind a mirror plane a shear has the other sign.
    if len(cloud.sign):
        strain[cloud.n_owned :, 0, 1] *= cloud.sign.prod(axis=1)
    return np.stack([strain[:, 0, 0], strain[:, 1, 1], strain[:, 0, 1], strain[:, 2, 2]], axis=1)


def plane_tensors(columns: Float) -> Float:
    """Return the tensors (n, 2, 2) of columns xx, yy, xy (n, 3 or more)."""
    return np.asarray(columns[:, [[0, 2], [2, 1]]])


def explicit_derivative(solution: Solution) -> Float:
    """Return the derivative of the energy density by place at constant F (n_owned, 2) [energy / volume / length].

    ``psi_,m = S : eps_,m + psi / c c_,m + psi_,T T_,m`` with the strain without stress eps, the factor c of the moduli,
    the temperature T where a law depends on it otherwise, and the slopes of all of them by the weights of the body,
    which are exact where they are linear; ``S = psi F_theta^-1 - F_e^T P``, and ``-P`` of linear bodies and bonds
    (``MaterialLaw.energy_by_strain``). Collective.
    """
    place = of_place(solution)
    return integrands_of(solution).explicit_derivative(place.factor, place.strain, place.temperature)


def derivative_besides_grading(solution: Solution) -> Float:
    """Return the explicit derivative without what moduli graded by place do (n_owned, 2) (collective)."""
    place = of_place(solution)
    moduli = place.factor / place.graded
    return integrands_of(solution).explicit_derivative(moduli, place.strain, place.temperature)


def slope_of_grading(solution: Solution) -> tuple[Float, Float]:
    """Return ``g = c,m / c`` of the factor c of moduli graded by place (n_owned, 2) and its slope (n_owned, 2, 2).

    [1 / length] and [1 / length^2], by the weights of the body. Collective.
    """
    return solution.state.kept("slope of grading", lambda: _slope_of_grading(solution))


def _slope_of_grading(solution: Solution) -> tuple[Float, Float]:
    cloud, graded = solution.cloud, of_place(solution).graded
    n, integrands = len(solution.x), integrands_of(solution)
    local = _with_ghosts(solution, integrands.slopes(graded[:, None])[:, 0] / graded[:n, None])
    # Behind a mirror plane the slope across it has the other sign.
    if len(cloud.sign):
        local[n:] *= cloud.sign
    return local[:n], integrands.slopes(local)


def uneven(solution: Solution, inside: Mask) -> list[str]:
    """Return what the energy density reads that differs between some own particles (n_owned,) (collective)."""
    found = []
    for name, column in of_place(solution).columns:
        low, high = range_on_ranks(solution, column[: len(inside)][inside])
        if _differ(low, high) and name not in found:
            found.append(name)
    return found


def softened(solution: Solution, inside: Mask) -> bool:
    """Return whether a temperature makes moduli differ between some own particles (n_owned,) (collective)."""
    place = of_place(solution)
    by_heat = [place.factor / place.graded]
    columns = by_heat if place.temperature is None else [*by_heat, place.temperature]
    return any(_differ(*range_on_ranks(solution, column[: len(inside)][inside])) for column in columns)


def singular(solution: Solution, tips: Sequence[Float], start: float) -> bool:
    """Return whether the slope of a temperature grows towards crack tips as one over a root of the distance.

    That of heat that flows round a crack does: its mean square within a distance ``start`` of a tip [length] is then
    three times that from there to twice the distance, and as large where the temperature is smooth. Collective.
    """
    temperature = solution.state.temperature
    if temperature is None:
        return False
    square = (integrands_of(solution).slopes(_with_ghosts(solution, temperature)[:, None]) ** 2).sum(axis=(1, 2))
    distance, sums = np.min([np.linalg.norm(solution.x - tip, axis=1) for tip in tips], axis=0), []
    for zone in (distance < start, (distance >= start) & (distance < 2.0 * start)):
        sums += [solution.volume[zone] @ square[zone], solution.volume[zone].sum()]
    core, volume, ring, further = solution.sum(sums)
    return bool(core * further > ROOT * ring * volume)


def jumping(solution: Solution, inside: Mask, tips: list[Float], outer: float) -> str:
    """Return what of it jumps between some own particles (n_owned,) and their neighbours; empty where nothing does.

    A jump has no slope: what it does to the energy lies between the particles. Next to a tip the slope of a temperature
    grows as one over the root of the distance, which looks like a jump there; it must not be steeper than that.
    Collective.

    Parameters
    ----------
    tips : list of (2,) float64
        Crack tips, near which slopes of temperatures may be singular [length].
    outer : float
        Within which of a tip the particles are [length].
    """
    place, reach = of_place(solution), solution.cloud.local_horizon[: len(inside)]
    start = min(SINGULAR * solution.largest(float(reach[inside].max(initial=0.0))), SINGULAR_MOST * outer)
    distance = np.min([np.linalg.norm(solution.x - tip, axis=1) for tip in tips], axis=0)
    what = _jumping(solution, inside, inside, place.given)
    if what or solution.problem.body.expansion is None:
        return what
    return _jumping(solution, inside, inside & (distance > start), place.columns) or _steep(
        solution, inside & (distance <= start), inside & (distance > start) & (distance <= 2.0 * start), start
    )


def _jumping(solution: Solution, inside: Mask, zone: Mask, columns: Sequence[tuple[str, Float]]) -> str:
    """Return what of some numbers of the local particles jumps in a zone of those inside (collective)."""
    pairs, xi, length, near, least = _bonds_in(solution, zone)
    far = length > 1.0 / SMOOTH * least[pairs[:, 0]] * (1.0 - 1e-9)
    some_far = solution.largest(float(np.count_nonzero(far))) > 0.0
    for name, column in columns:
        low, high = range_on_ranks(solution, column[: len(inside)][inside])
        if not _differ(low, high):
            continue
        slope = integrands_of(solution).slopes(column[:, None])[pairs[:, 0], 0]
        rest = np.abs(column[pairs[:, 1]] - column[pairs[:, 0]] - np.einsum("bi,bi->b", slope, xi))
        close = solution.largest(float(rest[near].max(initial=0.0)))
        wide = solution.largest(float(rest[far].max(initial=0.0)))
        allowed = max(SMOOTH * wide, NOTHING * (high - low)) if some_far else ROUGH * (high - low)
        if close > allowed:
            return name
    return ""


def _steep(solution: Solution, core: Mask, ring: Mask, start: float) -> str:
    """Return what changes faster between neighbours in the core about a tip than a root of the distance (collective).

    By its changes in the ring round the core, which begins at a distance ``start`` from the tip.
    """
    slopes = []
    shortest = np.inf
    for zone in (core, ring):
        pairs, _, length, near, _ = _bonds_in(solution, zone)
        slopes.append((pairs[near], length[near]))
        shortest = min(shortest, -solution.largest(-float(length.min(initial=np.inf))))
    for name, column in of_place(solution).columns:
        low, high = range_on_ranks(solution, column[: len(core)][core | ring])
        within, around = (
            solution.largest(float((np.abs(column[p[:, 1]] - column[p[:, 0]]) / length).max(initial=0.0)))
            for p, length in slopes
        )
        noise = max(SAME * max(abs(high), abs(low)), NOTHING * (high - low))
        if within > STEEPER * np.sqrt(start / shortest) * around + noise / shortest:
            return name
    return ""


def _bonds_in(solution: Solution, zone: Mask) -> tuple[GlobalIndex, Float, Float, Mask, Float]:
    """Return whole bonds of some own particles, their vectors and lengths, whether to next ones, and least lengths."""
    cloud = solution.cloud
    pairs, left, _ = pairs_of(solution, np.flatnonzero(zone))
    pairs = pairs[left == 1.0]
    xi = cloud.x[pairs[:, 1]] - cloud.x[pairs[:, 0]]
    length = np.linalg.norm(xi, axis=1)
    least = np.full(len(zone), np.inf)
    np.minimum.at(least, pairs[:, 0], length)
    return pairs, xi, length, length < NEXT * least[pairs[:, 0]], least


def _differ(low: float, high: float) -> bool:
    """Return True if the least and the largest of some numbers differ by more than round-off."""
    return high - low > SAME * max(abs(high), abs(low))


def _with_ghosts(solution: Solution, values: Float) -> Float:
    """Return numbers of the own particles (n_owned, ...) with those of their ghosts (n_local, ...) (collective)."""
    cloud = solution.cloud
    local = np.empty((cloud.n_local, *values.shape[1:]))
    local[: cloud.n_owned] = values
    cloud.halo.forward(local)
    return local


def turned_by_place(solution: Solution, inside: Mask) -> bool:
    """Return whether a law reads numbers of the place, as directions of fibres, that differ between own particles.

    The same on all ranks (collective).
    """
    low, high = range_on_ranks(solution, integrands_of(solution).directions()[inside])
    return bool(high > low)
