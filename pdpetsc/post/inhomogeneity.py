"""How the energy density of a body depends on place at a constant deformation gradient."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, Mask
from pdpetsc.kernels.sparsity import sum_by
from pdpetsc.post.bonds_left import pairs_of
from pdpetsc.post.solution import Solution
from pdpetsc.terms.bond_forces import BondForces
from pdpetsc.terms.material_points import MaterialPoints

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
# A temperature is changed by this share of its range for the derivative of the energy of a law by it.
LAW_STEP = 1e-4
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
    _, graded = materials_of(solution)
    factor = _with_ghosts(solution, graded)
    if expansion is None:
        return OfPlace(solution, None, factor, None, ((MODULI, factor),))
    of_temperature = expansion.factor
    whole = factor if of_temperature is None else _with_ghosts(solution, graded * of_temperature)
    own = expansion.strain.copy()
    if isinstance(solution.problem.material_term, BondForces):
        own[:, :2, :2] = expansion.in_body()
    given = ((MODULI, factor), *((STRAIN, one) for one in _shown(solution, expansion.eigenstrain).T))
    by_law = any(one is not None and one.law is not None for one in expansion.of.thermals)
    temperature = expansion.temperature if by_law else None
    kept = None if temperature is None else _with_ghosts(solution, temperature)
    return OfPlace(solution, _shown(solution, own), whole, kept, given)


def _shown(solution: Solution, own: Float) -> Float:
    """Return strains of the own particles (n_owned, 3, 3) as those of the local ones (n_local, 4) (collective)."""
    cloud = solution.cloud
    strain = np.zeros((cloud.n_local, 3, 3))
    strain[: cloud.n_owned] = own
    cloud.halo.forward(strain)
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
    return solution.state.kept("explicit derivative", lambda: _explicit_derivative(solution, of_place(solution).factor))


def derivative_besides_grading(solution: Solution) -> Float:
    """Return the explicit derivative without what moduli graded by place do (n_owned, 2) (collective)."""
    place = of_place(solution)
    return _explicit_derivative(solution, place.factor / place.graded)


def slope_of_grading(solution: Solution) -> tuple[Float, Float]:
    """Return ``g = c,m / c`` of the factor c of moduli graded by place (n_owned, 2) and its slope (n_owned, 2, 2).

    [1 / length] and [1 / length^2], by the weights of the body. Collective.
    """
    return solution.state.kept("slope of grading", lambda: _slope_of_grading(solution))


def _slope_of_grading(solution: Solution) -> tuple[Float, Float]:
    cloud, graded = solution.cloud, of_place(solution).graded
    n = len(solution.x)
    local = np.zeros((cloud.n_local, cloud.dim))
    local[:n] = slopes_of_particles(solution, graded[:, None])[:, 0] / graded[:n, None]
    cloud.halo.forward(local)
    # Behind a mirror plane the slope across it has the other sign.
    if len(cloud.sign):
        local[n:] *= cloud.sign
    return local[:n], slopes_of_particles(solution, local)


def _explicit_derivative(solution: Solution, moduli: Float) -> Float:
    """Return the explicit derivative where moduli are multiplied by numbers of the local particles (collective)."""
    material_term, state, place = solution.problem.material_term, solution.state, of_place(solution)
    factor = moduli[: len(solution.x)]
    if not isinstance(material_term, MaterialPoints):
        assert isinstance(material_term, BondForces)
        found = (material_term.energy_density(state) / factor)[:, None] * _of_families(solution, moduli[:, None])[:, 0]
        if place.strain is not None:
            found += _of_bonds(solution, _of_families(solution, place.strain))
        return np.asarray(found)
    operator, owner = material_term.operator, material_term.operator.owner
    psi = material_term.conjugates(state)[2]
    found = (psi / factor[owner])[:, None] * _of_points(material_term, moduli[:, None])[:, 0]
    if place.strain is not None:
        S, slope = material_term.energy_by_strain(state), _of_points(material_term, place.strain)
        by_strain = np.stack([S[:, 0, 0], S[:, 1, 1], S[:, 0, 1] + S[:, 1, 0], S[:, 2, 2]], axis=1)
        found += np.einsum("pc,pcm->pm", by_strain, slope)
    if place.temperature is not None:
        F = material_term.deformation(state)
        by, slope = np.zeros(len(F)), _of_points(material_term, place.temperature[:, None])[:, 0]
        low, high = _range(solution, place.temperature)
        step = LAW_STEP * (high - low) if high > low else 1.0
        for law in material_term.laws(state).materials:
            at = place.temperature[owner[law.points]]
            by[law.points] = law.energy_by_temperature(F[law.points], at, step)
        found += by[:, None] * slope
    share = operator.volume / solution.volume[owner]
    return operator.sum_over_points(share[:, None] * found)


def _of_points(material_term: MaterialPoints, values: Float) -> Float:
    """Return the slopes (n_points, columns, dim) of numbers of the local particles (n_local, columns)."""
    dim, n = material_term.body.dim, values.shape[1]
    padded = np.zeros((len(values), -(-n // dim) * dim))
    padded[:, :n] = values
    parts = [
        material_term.operator.gradient(np.ascontiguousarray(padded[:, first : first + dim]))
        for first in range(0, padded.shape[1], dim)
    ]
    return np.concatenate(parts, axis=1)[:, :n]


def _of_families(solution: Solution, values: Float) -> Float:
    """Return the slopes (n_owned, columns, dim) that fit families of bonds best, over bonds that are left."""
    cloud, families, material_term = solution.cloud, solution.problem.body.families, solution.problem.material_term
    assert isinstance(material_term, BondForces)
    xi, damage = families.bonds(cloud.x), solution.problem.damage
    weight = material_term.omega * cloud.volume[families.neighbours]
    if damage is not None:
        weight = weight * damage.bonds.intact
    change = values[families.neighbours] - values[families.centres]
    K = sum_by(families.centres, np.einsum("b,bi,bj->bij", weight, xi, xi), cloud.n_owned)
    N = sum_by(families.centres, np.einsum("b,bc,bj->bcj", weight, change, xi), cloud.n_owned)
    return np.asarray(N @ np.linalg.pinv(K, rcond=1e-10, hermitian=True))


def _of_bonds(solution: Solution, slope: Float) -> Float:
    """Return what strain without stress of a slope (n_owned, 4, dim) does to the energy of bonds (n_owned, dim).

    Bonds have the energy of their elongation beyond ``|(I + eps) xi| - |xi|``, or ``n . eps xi`` at small strain.
    """
    cloud, families, material_term = solution.cloud, solution.problem.body.families, solution.problem.material_term
    assert isinstance(material_term, BondForces)
    xi, expansion = families.bonds(cloud.x), solution.state.expansion
    assert expansion is not None
    along = xi
    if material_term.finite:
        along = xi + np.einsum("bij,bj->bi", expansion.in_body()[families.centres], xi)
    n = along / np.linalg.norm(along, axis=1)[:, None]
    moment = sum_by(
        families.centres, np.einsum("b,bi,bj->bij", material_term.tension(solution.state), n, xi), cloud.n_owned
    )
    moment /= cloud.volume[: cloud.n_owned, None, None]
    shear = moment[:, 0, 1] + moment[:, 1, 0]
    by = np.stack([moment[:, 0, 0], moment[:, 1, 1], shear, np.zeros(len(moment))], axis=1)
    return -np.asarray(np.einsum("pc,pcm->pm", by, slope))


def uneven(solution: Solution, inside: Mask) -> list[str]:
    """Return what the energy density reads that differs between some own particles (n_owned,) (collective)."""
    found = []
    for name, column in of_place(solution).columns:
        low, high = _range(solution, column[: len(inside)][inside])
        if high - low > SAME * max(abs(high), abs(low)) and name not in found:
            found.append(name)
    return found


def softened(solution: Solution, inside: Mask) -> bool:
    """Return whether a temperature makes moduli differ between some own particles (n_owned,) (collective)."""
    place = of_place(solution)
    by_heat = [place.factor / place.graded]
    for column in by_heat if place.temperature is None else [*by_heat, place.temperature]:
        low, high = _range(solution, column[: len(inside)][inside])
        if high - low > SAME * max(abs(high), abs(low)):
            return True
    return False


def singular(solution: Solution, tips: Sequence[Float], start: float) -> bool:
    """Return whether the slope of a temperature grows towards crack tips as one over a root of the distance.

    That of heat that flows round a crack does: its mean square within a distance ``start`` of a tip [length] is then
    three times that from there to twice the distance, and as large where the temperature is smooth. Collective.
    """
    temperature = solution.state.temperature
    if temperature is None:
        return False
    square = (slopes_of_particles(solution, _with_ghosts(solution, temperature)[:, None]) ** 2).sum(axis=(1, 2))
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
        low, high = _range(solution, column[: len(inside)][inside])
        if high - low <= SAME * max(abs(high), abs(low)):
            continue
        slope = slopes_of_particles(solution, column[:, None])[pairs[:, 0], 0]
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
        low, high = _range(solution, column[: len(core)][core | ring])
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
    pairs, left = pairs_of(solution, np.flatnonzero(zone))
    pairs = pairs[left == 1.0]
    xi = cloud.x[pairs[:, 1]] - cloud.x[pairs[:, 0]]
    length = np.linalg.norm(xi, axis=1)
    least = np.full(len(zone), np.inf)
    np.minimum.at(least, pairs[:, 0], length)
    return pairs, xi, length, length < NEXT * least[pairs[:, 0]], least


def slopes_of_particles(solution: Solution, values: Float) -> Float:
    """Return the slopes (n_owned, columns, dim) of numbers of the local particles, means over the points of each."""
    material_term = solution.problem.material_term
    if isinstance(material_term, MaterialPoints):
        return material_term.operator.mean_over_points(_of_points(material_term, values), len(solution.x))
    return _of_families(solution, values)


def _range(solution: Solution, values: Float) -> tuple[float, float]:
    """Return the least and the largest of numbers on all ranks (collective)."""
    return (
        -solution.largest(float((-values).max(initial=-np.inf))),
        solution.largest(float(values.max(initial=-np.inf))),
    )


def _with_ghosts(solution: Solution, values: Float) -> Float:
    """Return numbers of the own particles (n_owned,) with those of their ghosts (n_local,) (collective)."""
    cloud = solution.cloud
    local = np.empty(cloud.n_local)
    local[: cloud.n_owned] = values
    cloud.halo.forward(local)
    return local


def materials_of(solution: Solution) -> tuple[GlobalIndex, Float]:
    """Return the number of the material of each own particle, and what multiplies its moduli by place [-]."""
    material_term, n = solution.problem.material_term, len(solution.x)
    numbers, factor = np.zeros(n, dtype=np.int64), np.ones(n)
    if isinstance(material_term, MaterialPoints):
        for number, at_points in enumerate(material_term.materials):
            of = material_term.operator.owner[at_points.points]
            numbers[of] = number
            if at_points.factor is not None:
                factor[of] = at_points.factor
    elif isinstance(material_term, BondForces):
        numbers[:], factor[:] = material_term.material_of, material_term.factor
    return numbers, factor


def remembers(solution: Solution) -> bool:
    """Return whether a material has a history; the same on all ranks (not collective)."""
    material_term = solution.problem.material_term
    return isinstance(material_term, MaterialPoints) and any(one.has_history for one in material_term.materials)


def turned_by_place(solution: Solution, inside: Mask) -> bool:
    """Return whether a law reads numbers of the place, as directions of fibres, that differ between own particles.

    The same on all ranks (collective).
    """
    material_term, number = solution.problem.material_term, np.zeros(len(solution.x))
    if isinstance(material_term, MaterialPoints):
        for one in material_term.materials:
            if not one.has_history and one.history.shape[1]:
                # Any that differ will do.
                number[material_term.operator.owner[one.points]] = one.history @ np.arange(
                    1.0, 1.0 + one.history.shape[1]
                )
    low, high = _range(solution, number[inside])
    return bool(high > low)
