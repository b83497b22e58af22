"""Dependence of the energy density on position at a constant deformation gradient."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, Mask
from pdpetsc.discrete.communicator import bounds
from pdpetsc.post.bonds_left import pairs_of
from pdpetsc.post.integrands import integrands_of, range_on_ranks
from pdpetsc.post.solution import Solution, local_horizon

# Numbers that differ by less than this share are equal: round-off of sums.
SAME = 1e-12
# Nearest neighbours are within this many times the smallest distance.
NEXT = 1.3
# The residual of a linear fit grows with the square of the distance if a field is smooth, but not across a jump: if
# nearest neighbours have more than this share of the residual of the farthest, there is a jump between them.
SMOOTH = 0.5
# Residuals below this share of the range of a field are ignored, below the second share if all neighbours are nearest
# ones.
NOTHING, ROUGH = 1e-5, 0.05
# Within so many horizons of a crack tip, at most this share of the outer radius, the slope of a temperature may be
# singular, up to this many times that of a square root of the distance.
SINGULAR, SINGULAR_MOST, STEEPER = 2.0, 0.5, 3.0

# The slope is singular if its mean square within that distance is at least this many times that around it.
ROOT = 1.6

# Names of the numbers that differ between particles.
STRAIN, MODULI = "strain without stress", "moduli"


@dataclass(frozen=True)
class OfPlace:
    """The arguments of the energy density besides the deformation gradient.

    Attributes
    ----------
    strain : (n_local, 4) float64 or None
        Eigenstrain, xx, yy, xy and zz [-]; for bodies of bonds its effective value in the plane.
    factor : (n_local,) float64
        Factor on the moduli, of position and of temperature [-].
    temperature : (n_local,) float64 or None
        Temperature, if a law depends on it in another way.
    graded : (n_local,) float64
        Factor on the moduli by position alone [-].
    eigenstrain : (n_local, 4) float64 or None
        Declared eigenstrain, as ``strain`` [-].
    """

    strain: Float | None
    factor: Float
    temperature: Float | None
    graded: Float
    eigenstrain: Float | None

    @property
    def without_temperature(self) -> list[tuple[str, Float]]:
        """Return the numbers (n_local,) that do not depend on temperature, with their names."""
        strains = [] if self.eigenstrain is None else [(STRAIN, column) for column in self.eigenstrain.T]
        return [(MODULI, self.graded), *strains]

    @property
    def columns(self) -> list[tuple[str, Float]]:
        """Return all its numbers (n_local,) with their names."""
        found = [] if self.strain is None else [(STRAIN, column) for column in self.strain.T]
        found.append((MODULI, self.factor))
        if self.temperature is not None:
            found.append(("a temperature", self.temperature))
        return found


def of_place(solution: Solution) -> OfPlace:
    """Return the arguments of the energy density besides the deformation gradient (collective)."""
    return solution.state.kept("of place", lambda: _of_place(solution))


def _of_place(solution: Solution) -> OfPlace:
    expansion = solution.state.expansion
    integrands = integrands_of(solution)
    _, graded = integrands.materials()
    factor = solution.with_ghosts(graded)
    if expansion is None:
        return OfPlace(None, factor, None, factor, None)
    of_temperature = expansion.factor
    whole = factor if of_temperature is None else solution.with_ghosts(graded * of_temperature)
    own = integrands.strain_of_body(expansion)
    eigenstrain = _shown(solution, expansion.eigenstrain)
    by_law = any(one is not None and one.law is not None for one in expansion.of.thermals)
    temperature = expansion.temperature if by_law else None
    local = None if temperature is None else solution.with_ghosts(temperature)
    return OfPlace(_shown(solution, own), whole, local, factor, eigenstrain)


def _shown(solution: Solution, own: Float) -> Float:
    """Return strains of the owned particles (n_owned, 3, 3) as strains of the local ones (n_local, 4) (collective)."""
    cloud, strain = solution.cloud, solution.with_ghosts(own)
    # Behind a mirror plane a shear has the opposite sign.
    if len(cloud.sign):
        strain[cloud.n_owned :, 0, 1] *= cloud.sign.prod(axis=1)
    return np.stack([strain[:, 0, 0], strain[:, 1, 1], strain[:, 0, 1], strain[:, 2, 2]], axis=1)


def plane_tensors(columns: Float) -> Float:
    """Return the tensors (n, 2, 2) of columns xx, yy, xy (n, 3 or more)."""
    return np.asarray(columns[:, [[0, 2], [2, 1]]])


def derivative_besides_grading(solution: Solution) -> Float:
    """Return the explicit derivative without the part of graded moduli (n_owned, 2) (collective)."""
    place = of_place(solution)
    moduli = place.factor / place.graded
    return integrands_of(solution).explicit_derivative(moduli, place.strain, place.temperature)


def slope_of_grading(solution: Solution) -> tuple[Float, Float]:
    """Return ``g = c,m / c`` of the factor c of graded moduli (n_owned, 2) and its slope (n_owned, 2, 2).

    [1 / length] and [1 / length^2], by the weights of the body. Collective.
    """
    return solution.state.kept("slope of grading", lambda: _slope_of_grading(solution))


def _slope_of_grading(solution: Solution) -> tuple[Float, Float]:
    cloud, graded = solution.cloud, of_place(solution).graded
    n, integrands = len(solution.x), integrands_of(solution)
    local = solution.with_ghosts(integrands.slopes(graded[:, None])[:, 0] / graded[:n, None])
    # Behind a mirror plane the slope along its normal has the opposite sign.
    cloud.mirror(local)
    return local[:n], integrands.slopes(local)


def uneven(solution: Solution, inside: Mask) -> list[str]:
    """Return the arguments of the energy density that differ between owned particles (n_owned,) (collective)."""
    found = []
    for name, column in of_place(solution).columns:
        low, high = range_on_ranks(solution, column[: len(inside)][inside])
        if _differ(low, high) and name not in found:
            found.append(name)
    return found


def softened(solution: Solution, inside: Mask) -> bool:
    """Return True if moduli of owned particles (n_owned,) differ by temperature (collective)."""
    place = of_place(solution)
    by_heat = [place.factor / place.graded]
    columns = by_heat if place.temperature is None else [*by_heat, place.temperature]
    return any(_differ(*range_on_ranks(solution, column[: len(inside)][inside])) for column in columns)


def singular(solution: Solution, tips: Sequence[Float], start: float) -> bool:
    """Return True if the slope of a temperature grows as one over the square root of the distance to crack tips.

    Heat flow around a crack causes this. The mean square of the slope within a distance ``start`` of a tip [length] is
    then three times that between this distance and twice the distance; for smooth temperatures both are equal.
    Collective.
    """
    temperature = solution.state.temperature
    if temperature is None:
        return False
    square = (integrands_of(solution).slopes(solution.with_ghosts(temperature)[:, None]) ** 2).sum(axis=(1, 2))
    distance, sums = np.min([np.linalg.norm(solution.x - tip, axis=1) for tip in tips], axis=0), []
    for zone in (distance < start, (distance >= start) & (distance < 2.0 * start)):
        sums += [solution.volume[zone] @ square[zone], solution.volume[zone].sum()]
    core, volume, ring, further = solution.sum(sums)
    return bool(core * further > ROOT * ring * volume)


def jumping(solution: Solution, inside: Mask, tips: list[Float], outer: float) -> str:
    """Return the arguments that jump between owned particles (n_owned,) and their neighbours; empty if none.

    A jump has no slope, and its contribution to the energy is between the particles. Next to a tip the slope of a
    temperature grows as one over the square root of the distance, which resembles a jump; steeper slopes are jumps.
    Collective.

    Parameters
    ----------
    tips : list of (2,) float64
        Crack tips, near which slopes of temperatures may be singular [length].
    outer : float
        Radius around a tip that contains the particles [length].
    """
    place, reach = of_place(solution), local_horizon(solution)[inside]
    start = min(SINGULAR * solution.largest(reach, 0.0), SINGULAR_MOST * outer)
    distance = np.min([np.linalg.norm(solution.x - tip, axis=1) for tip in tips], axis=0)
    what = _jumping(solution, inside, inside, place.without_temperature)
    if what or solution.problem.body.expansion is None:
        return what
    return _jumping(solution, inside, inside & (distance > start), place.columns) or _steep(
        solution, inside & (distance <= start), inside & (distance > start) & (distance <= 2.0 * start), start
    )


def _jumping(solution: Solution, inside: Mask, zone: Mask, columns: Sequence[tuple[str, Float]]) -> str:
    """Return the names of numbers of the local particles that jump in a zone of those inside (collective)."""
    bonds = _bonds_in(solution, zone)
    i, j = bonds.pairs.T
    near, far = bonds.nearest, bonds.length > 1.0 / SMOOTH * bonds.least * (1.0 - 1e-9)
    some_far = solution.largest(np.count_nonzero(far)) > 0.0
    for name, column in columns:
        low, high = range_on_ranks(solution, column[: len(inside)][inside])
        if not _differ(low, high):
            continue
        slope = integrands_of(solution).slopes(column[:, None])[i, 0]
        rest = np.abs(column[j] - column[i] - np.einsum("bi,bi->b", slope, bonds.xi))
        close, wide = solution.largest(rest[near], 0.0), solution.largest(rest[far], 0.0)
        allowed = max(SMOOTH * wide, NOTHING * (high - low)) if some_far else ROUGH * (high - low)
        if close > allowed:
            return name
    return ""


def _steep(solution: Solution, core: Mask, ring: Mask, start: float) -> str:
    """Return the numbers that change faster than a square root of the distance in the core about a tip (collective).

    The reference are changes in the ring around the core, which begins at a distance ``start`` from the tip.
    """
    zones = [_bonds_in(solution, zone) for zone in (core, ring)]
    shortest = min(solution.smallest(bonds.length) for bonds in zones)
    for name, column in of_place(solution).columns:
        low, high = range_on_ranks(solution, column[: len(core)][core | ring])
        within, around = (
            solution.largest((np.abs(np.diff(column[bonds.pairs])[:, 0]) / bonds.length)[bonds.nearest], 0.0)
            for bonds in zones
        )
        noise = max(SAME * max(abs(high), abs(low)), NOTHING * (high - low))
        if within > STEEPER * np.sqrt(start / shortest) * around + noise / shortest:
            return name
    return ""


@dataclass(frozen=True)
class _Bonds:
    """Intact bonds of owned particles.

    Attributes
    ----------
    pairs : (n, 2) int64
        Owned particle and its neighbour.
    xi, length : (n, dim), (n,) float64
        Bond vectors and their lengths [length].
    least : (n,) float64
        Smallest length of a bond of the same particle [length].
    """

    pairs: GlobalIndex
    xi: Float
    length: Float
    least: Float

    @property
    def nearest(self) -> Mask:
        """Return True for bonds to nearest neighbours (n,)."""
        return self.length < NEXT * self.least


def _bonds_in(solution: Solution, zone: Mask) -> _Bonds:
    """Return the intact bonds of the owned particles (n_owned,) of a zone (not collective)."""
    cloud = solution.cloud
    pairs, left, _ = pairs_of(solution, np.flatnonzero(zone))
    pairs = pairs[left == 1.0]
    xi = cloud.x[pairs[:, 1]] - cloud.x[pairs[:, 0]]
    length = np.linalg.norm(xi, axis=1)
    least = np.full(len(zone), np.inf)
    np.minimum.at(least, pairs[:, 0], length)
    return _Bonds(pairs, xi, length, least[pairs[:, 0]])


def _differ(low: float, high: float) -> bool:
    """Return True if the smallest and the largest number differ by more than round-off."""
    return high - low > SAME * max(abs(high), abs(low))


def turned_by_place(solution: Solution, inside: Mask) -> bool:
    """Return True if a law has directions, as of fibres, that differ between owned particles.

    Equal on all ranks (collective).
    """
    low, high = bounds(solution.cloud.comm, integrands_of(solution).directions()[inside])
    return bool(np.any(high > low))
