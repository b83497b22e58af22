"""The domain of an integral about a crack tip: its weight, its particles, and its requirements."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from pdpetsc.arrays import Float, Mask
from pdpetsc.discrete.cloud import HORIZON_TOLERANCE, Cloud
from pdpetsc.errors import CaseError
from pdpetsc.post.bonds_left import pairs_of
from pdpetsc.post.inhomogeneity import of_place, plane_tensors, singular, slope_of_grading
from pdpetsc.post.integrands import Continuum, integrands_of
from pdpetsc.post.solution import Solution, local_horizon

# Tolerances of the sums over cells: of the integrals of the weight and of its slope, and of the integral of its
# gradient, which is zero.
FILLED, CLOSED = 0.03, 0.01
# Smallest number of particles between the two radii.
LEAST = 24
# A crack crosses the domain if at least this share of the bonds across its line there is broken or cut.
CUT = 0.5
# Uniform tractions on faces differ by less than this share between both halves of the radius.
UNIFORM = 0.1
# Densities within so many horizons of a tip, at most this share of the outer radius, are extrapolated from densities up
# to so many times further out, integrated with so many points: from nearby for bounded slopes of moduli and strains,
# and from more particles for singular slopes of a temperature.
CORE, CORE_MOST, FURTHER, FURTHER_BY_HEAT, GAUSS = 2.0, 0.5, 2.0, 4.0, 12
# The extrapolation must differ from the sum of the densities there by less than this share of the whole number, or of
# this share of the sum of absolute values if the number is small relative to it. Otherwise it is not accurate enough.
GUESSED, CANCELS = 0.15, 0.1
# Densities are expanded in these powers of the distance.
POWERS = np.array([0.0, 1.0, 2.0])
# Loads beside the crack are body forces if they are at most this many times as dense as elsewhere.
MIXED = 2.0


@dataclass(frozen=True)
class Frame:
    """A crack tip or its mirror image, in the coordinates of owned particles.

    Attributes
    ----------
    tip : (2,) float64
        [length]
    turn : (2, 2) float64
        Rows are the growth direction and the normal of the crack, both unit vectors.
    """

    tip: Float
    turn: Float

    def at(self, x: Float) -> Float:
        """Return positions (n, 2) from the tip along both axes [length]."""
        return np.asarray((x - self.tip) @ self.turn.T)

    def tensors(self, T: Float) -> Float:
        """Return tensors (n, 2, 2) with components along both axes."""
        return np.asarray(np.einsum("ai,pij,bj->pab", self.turn, T, self.turn))


def frames(cloud: Cloud, tip: Float, direction: Sequence[float]) -> list[Frame]:
    """Return a crack tip and its images: sums over owned particles about all of them are sums over the whole body."""
    along = np.asarray(direction, dtype=float)
    along = along / np.linalg.norm(along)
    turn = np.array([along, [-along[1], along[0]]])
    return [Frame(sign * tip + to, turn * sign) for sign, to in zip(*cloud.places.mirrors, strict=True)]


def weight(x: Float, inner: float, outer: float, tilt: float = 0.0) -> tuple[Float, Float]:
    """Return the weight q (n,) [-] at positions x (n, 2) from the tip, and its gradient (n, 2) [1 / length].

    q is 1 up to the inner radius and 0 beyond the outer one, ``1 - 3 s^2 + 2 s^3`` between them: its gradient is
    continuous, so that sums over particles are more accurate. A tilt t of -1 to 1 subtracts ``3 t s^2 (1 - s)^2``: for
    1 it decreases mostly in the inner half, for -1 in the outer half.
    """
    r = np.linalg.norm(x, axis=1)
    s = np.clip((r - inner) / (outer - inner), 0.0, 1.0)
    slope = -6.0 * s * (1.0 - s) * (1.0 + tilt * (1.0 - 2.0 * s)) / (outer - inner)
    q = 1.0 - s**2 * (3.0 - 2.0 * s) - 3.0 * tilt * (s * (1.0 - s)) ** 2
    return q, slope[:, None] * x / np.where(r > 0.0, r, 1.0)[:, None]


def continuum(solution: Solution) -> Continuum:
    """Return gradient, stress and energy-momentum tensor of the owned particles (collective).

    For gradient points they are volume-weighted means over the points of a particle. For bodies of bonds they are the
    gradient of best fit of each family, and its stress and energy density.
    """
    return solution.state.kept("continuum", integrands_of(solution).continuum)


@dataclass(frozen=True)
class Integral:
    """Two estimates of the integral of a density that is inaccurate next to a crack tip.

    Attributes
    ----------
    value : float
        The estimate used: by extrapolation of the density, or from the work done on the material about the tip.
    plain : float
        The other estimate: the sum of the density over all particles.
    size : float
        Sum of the magnitudes of the slope of which it is a component.
    """

    value: float
    plain: float
    size: float

    @property
    def summed(self) -> Integral:
        """Return the integral with the sum as its value, instead of the extrapolation."""
        return Integral(self.plain, self.value, self.size)

    def trouble(self, whole: float, part: float) -> str:
        """Return why the integral is too inaccurate for a number ``whole`` with ``part`` of it (not collective)."""
        guessed = abs(part * (self.value - self.plain))
        if not guessed > GUESSED * max(abs(whole), CANCELS * abs(part) * self.size):
            return ""
        return (
            f"holds moduli or strains that change too fast near the tip: what they do is {part * self.value:.3g} in "
            f"one way of integrating them and {part * self.plain:.3g} in another, of {whole:.3g}; take more particles"
        )


@dataclass(frozen=True)
class Domain:
    """The particles about a crack tip in the domain of an integral.

    Attributes
    ----------
    frames : list of Frame
        The tip and its images behind mirror planes.
    inner, outer : float
        Radii at which the weight begins to decrease, and is zero [length].
    area : (n_owned,) float64
        Area of the cell of each owned particle [area].
    filled, falls : float
        Sums of the weight and of the magnitude of its gradient over the cells, over their integrals [-].
    closed : (2,) float64
        Sum of its gradient over the cells [length]; the integral is zero.
    ring : float
        Area of the cells between the radii.
    count : int
        Number of particles between the radii.
    tilt : float
        Tilt of the weight, from -1 to 1 (``weight``).
    """

    frames: list[Frame]
    inner: float
    outer: float
    area: Float
    filled: float
    falls: float
    closed: Float
    ring: float
    count: int
    tilt: float = 0.0

    @classmethod
    def of(
        cls, solution: Solution, tip: Float, direction: Sequence[float], inner: float, outer: float, tilt: float = 0.0
    ) -> Domain:
        """Return the domain about a tip, with an optional tilt of the weight (collective)."""
        area = solution.volume / solution.problem.body.thickness
        about, sums = frames(solution.cloud, tip, direction), np.zeros(6)
        for frame in about:
            q, slope = weight(frame.at(solution.x), inner, outer, tilt)
            falling = slope.any(axis=1)
            size = np.linalg.norm(slope, axis=1)
            sums += [area @ q, area @ size, *(area @ slope), area @ falling, np.count_nonzero(falling)]
        filled, falls, *closed, ring, count = solution.sum(sums)
        width = outer - inner
        filled /= np.pi * inner**2 + 2.0 * np.pi * width * ((0.5 - 0.1 * tilt) * inner + (0.15 - 0.05 * tilt) * width)
        falls /= np.pi * (inner + outer - 0.2 * tilt * width)
        return cls(about, inner, outer, area, filled, falls, np.array(closed), float(ring), int(count), tilt)

    def weight(self, frame: Frame, x: Float) -> tuple[Float, Float]:
        """Return the weight q (n,) [-] of owned particles and its gradient (n, 2) in a frame [1 / length].

        The gradient is corrected so that its sum over the cells is zero, as its integral is. A uniform state then
        contributes zero to round-off.
        """
        q, slope = weight(frame.at(x), self.inner, self.outer, self.tilt)
        falling = slope.any(axis=1)
        slope[falling] -= self.closed / self.ring
        return q, slope

    def integral(self, solution: Solution, slopes: Sequence[Float]) -> Integral:
        """Return ``int q rho dA`` of the first columns of densities (n_owned, 2), which grow as 1 / r at most.

        There is one density per frame, with components along and across the crack. If the slopes of the densities are
        resolved, the integral is the sum over the particles: the change of the energy of the body as the crack grows.
        Slopes of a temperature are not resolved next to a tip with heat flow around it. There the part within some
        horizons, a share h / R of the whole, is extrapolated from the densities further out: ``2 pi r`` times the mean
        around a circle is fitted by ``a + b r + c r^2``, the leading powers of products of two square-root fields of
        one symmetry. Collective.
        """
        reach = local_horizon(solution)[self.near(solution.x)]
        start = min(CORE * solution.largest(reach, 0.0), CORE_MOST * self.outer)
        follows = singular(solution, [frame.tip for frame in self.frames], start)
        further = FURTHER_BY_HEAT if follows else FURTHER
        sums, normal, right = np.zeros(3), np.zeros((3, 3)), np.zeros(3)
        for frame, slope in zip(self.frames, slopes, strict=True):
            at, rho = frame.at(solution.x), slope[:, 0]
            r = np.linalg.norm(at, axis=1)
            q, _ = weight(at, self.inner, self.outer, self.tilt)
            share = self.area * q
            sums += [(share * (r >= start)) @ rho, share @ rho, share @ np.linalg.norm(slope, axis=1)]
            chosen = (r >= start) & (r < min(further * start, self.outer))
            powers = (r[chosen, None] / start) ** POWERS
            by = (self.area[chosen] / r[chosen])[:, None] * powers
            normal += by.T @ powers
            right += by.T @ (2.0 * np.pi * r[chosen] * rho[chosen])
        normal, right = solution.sum(normal), solution.sum(right)
        points, shares = scipy.special.roots_legendre(GAUSS)
        radii = 0.5 * start * (1.0 + points)
        q, _ = weight(np.column_stack([radii, np.zeros(GAUSS)]), self.inner, self.outer, self.tilt)
        inside = (0.5 * start * shares * q) @ (radii[:, None] / start) ** POWERS
        outside, plain, size = solution.sum(sums)
        found = Integral(float(outside + inside @ np.linalg.lstsq(normal, right, rcond=None)[0]), plain, size)
        return found if follows else found.summed

    def at_tip(self, solution: Solution, values: Float) -> float:
        """Extrapolate a smooth positive number of the local particles (n_local,) to the tip (collective).

        Its logarithm is fitted by a quadratic over the particles within the inner radius.
        """
        normal, right = np.zeros((6, 6)), np.zeros(6)
        for frame in self.frames:
            x, y = frame.at(solution.x).T / self.inner
            within = x**2 + y**2 < 1.0
            powers = np.stack([x**0, x, y, x**2, x * y, y**2], axis=1)[within]
            by = (self.area[within] / self.inner**2)[:, None] * powers
            normal += by.T @ powers
            right += by.T @ np.log(values[: len(x)][within])
        normal, right = solution.sum(normal), solution.sum(right)
        return float(np.exp(np.linalg.lstsq(normal, right, rcond=1e-12)[0][0]))

    def of_energy(self, solution: Solution) -> Integral:
        """Return ``int q g . e psi dA`` of the energy density psi, with the slopes g of moduli graded by place.

        Next to the tip the energy density is not that of a continuum. With the smoother ``w = q g . e``, equilibrium
        transforms the integral into ``1/2 int (w tr(psi I - H^T P) - w,m P_im (u - u_0)_i + w f . (u - u_0)) dA`` with
        loads f and the mean displacement ``u_0``. The trace is zero in linear bodies without eigenstrain. This is the
        work done on the material about the tip; no density in it is singular. Collective.
        """
        fields, (g, bend) = continuum(solution), slope_of_grading(solution)
        thickness, free = solution.problem.body.thickness, of_place(solution).strain
        rest = integrands_of(solution).trace(fields, None if free is None else plane_tensors(free[: len(g)]))
        moments, sums = np.zeros(3), np.zeros(3)
        for frame in self.frames:
            share = self.area * self.weight(frame, solution.x)[0]
            moments += [*(share @ solution.u @ frame.turn.T), share.sum()]
        *moved, area = solution.sum(moments)
        for frame in self.frames:
            q, slope = self.weight(frame, solution.x)
            along, P = g @ frame.turn[0], frame.tensors(fields.P)
            u, f = solution.u @ frame.turn.T - np.array(moved) / area, loads(solution) @ frame.turn.T
            w, falls = q * along, along[:, None] * slope + q[:, None] * frame.tensors(bend)[:, 0]
            by_parts = 0.5 * self.area * (w * rest - np.einsum("pm,pim,pi->p", falls, P, u))
            by_parts += 0.5 / thickness * w * np.einsum("pi,pi->p", f, u)
            sums += [by_parts.sum(), (self.area * w) @ fields.psi, self.area @ np.abs(w * fields.psi)]
        value, plain, size = solution.sum(sums)
        return Integral(value, plain, size)

    def between(self, at: Float) -> Mask:
        """Return True for positions (n, 2) from a tip between the radii (n,)."""
        r = np.linalg.norm(at, axis=1)
        return np.asarray((r > self.inner) & (r < self.outer))

    def near(self, x: Float) -> Mask:
        """Return True for positions (n, dim) inside the domain of any frame (n,)."""
        found = np.zeros(len(x), dtype=bool)
        for frame in self.frames:
            found |= np.linalg.norm(frame.at(x), axis=1) < self.outer
        return found


def trouble(solution: Solution, domain: Domain, runs: bool = False) -> str:
    """Return why a domain is invalid for one crack tip, in words after "it"; empty if it is valid.

    The crack may be a spacing off its line. A crack that ``runs`` breaks bonds within a horizon of the line. Equal on
    all ranks (collective).
    """
    inner, outer = domain.inner, domain.outer
    inside = domain.near(solution.x)
    reach = solution.largest(local_horizon(solution)[inside], 0.0)
    if inner < reach * (1.0 - HORIZON_TOLERANCE):
        return (
            f"begins {inner:g} from the tip, within the horizon of {reach:g}, where fields are not those of a "
            f"continuum; give a larger inner radius"
        )
    held = int(solution.sum(np.count_nonzero(solution.problem.held.any(axis=1) & inside)))
    if held:
        return f"holds {held} particles with a prescribed displacement; take smaller radii"
    if solution.cloud.body is not None:
        of_body = solution.cloud.body[: len(inside)][inside]
        if solution.smallest(of_body) < solution.largest(of_body):
            return "holds particles of several bodies; take smaller radii"
    if domain.count < LEAST:
        return (
            f"has {domain.count} particles between its radii, less than {LEAST}; take radii further apart or more "
            f"particles"
        )
    open_by = np.linalg.norm(domain.closed) / (np.pi * (inner + outer))
    if abs(domain.filled - 1.0) > FILLED or abs(domain.falls - 1.0) > FILLED or open_by > CLOSED:
        return (
            f"is not filled by the cells of the particles: over them the weight sums to {domain.filled:.4g} and its "
            f"slope to {domain.falls:.4g} of their integrals (within {FILLED:g} of 1), and slopes of opposite sides "
            f"cancel to {open_by:.2g} (at most {CLOSED:g}). If it leaves the body or crosses a hole, take smaller "
            f"radii; otherwise it has too few particles: take more particles or radii further apart"
        )
    return _trouble_with_cracks(solution, domain, runs)


def _trouble_with_cracks(solution: Solution, domain: Domain, runs: bool) -> str:
    """Return why the broken and cut bonds in a domain are not one crack (collective)."""
    stray, crossing, cut, gone, places = 0, 0, 0, 0, list[tuple[float, ...]]()
    for frame in domain.frames:
        reach = local_horizon(solution)
        zone = np.flatnonzero(np.linalg.norm(frame.at(solution.x), axis=1) < domain.outer + reach)
        pairs, left, _ = pairs_of(solution, zone)
        a, b = frame.at(solution.cloud.x[pairs[:, 0]]), frame.at(solution.cloud.x[pairs[:, 1]])
        over = a[:, 1] * b[:, 1] < 0.0
        share = np.where(over, a[:, 1] / np.where(over, a[:, 1] - b[:, 1], 1.0), 0.5)
        through = a + share[:, None] * (b - a)
        between = domain.between(through)
        off = reach[pairs[:, 0]] if runs else np.sqrt(domain.area[pairs[:, 0]])
        beside = (np.minimum(a[:, 1], b[:, 1]) <= off) & (np.maximum(a[:, 1], b[:, 1]) >= -off)
        wrong = np.flatnonzero(between & (left < 1.0) & ~(beside & (through[:, 0] <= off)))
        stray += len(wrong)
        # The message has the one nearest to the tip; its digits are cut, so that both ends of a bond agree.
        size = np.round(np.linalg.norm(through[wrong], axis=1), 9 - int(np.log10(domain.outer)))
        at = np.round(frame.tip + through[wrong] @ frame.turn, 9 - int(np.log10(domain.outer)))
        places += sorted(zip(size.tolist(), *at.T.tolist(), strict=True))[:1]
        on_line = between & over & (through[:, 0] < 0.0)
        crossing += np.count_nonzero(on_line)
        cut += np.count_nonzero(on_line & (left == 0.0))
        gone += np.count_nonzero((np.linalg.norm(through, axis=1) < domain.outer) & (left < 1.0))
    stray, crossing, cut, gone = (int(n) for n in solution.sum([stray, crossing, cut, gone]))
    if stray:
        place = min(one for part in solution.cloud.comm.allgather(places) for one in part)[1:]
        return (
            f"has {stray // 2 or 1} bonds that are cut or damaged away from the line of the crack, near ({place[0]:g}, "
            f"{place[1]:g}): another crack, one that is not straight, or another direction; take smaller radii, or the "
            f"direction in which the crack grows"
        )
    if gone and cut < CUT * max(crossing, 1):
        return (
            f"is not crossed by the crack from the tip backwards: {cut // 2} of {crossing // 2} bonds over that line "
            f"are cut; give the tip of the crack, the direction in which it grows, and radii below its length"
        )
    return ""


def loads_in(solution: Solution, domain: Domain) -> tuple[bool, str]:
    """Return True if all loads in a domain act beside the crack, and the reason if loads cannot be included.

    Tractions on the faces must be uniform along the crack. Their contribution is integrated by parts: it requires only
    the jump of the displacement far from the tip, not its gradient at the tip. Equal on all ranks. Collective.
    """
    force, found = _applied(solution), np.zeros(5)
    waves = np.zeros((2, 2, 2))
    for frame in domain.frames:
        at, f = frame.at(solution.x), force @ frame.turn.T
        inside = np.linalg.norm(at, axis=1) < domain.outer
        # A facet distributes its load over the family of the particle behind it.
        band = 1.5 * local_horizon(solution)
        near = inside & (np.abs(at[:, 1]) <= band)
        size = np.linalg.norm(f, axis=1)
        found += [
            size[near].sum(), size[inside & ~near].sum(), domain.area[near].sum(), domain.area[inside & ~near].sum(),
            size[near & (at[:, 0] > band)].sum(),
        ]  # fmt: skip
        wave = np.sin(2.0 * np.pi * at[:, 0] / domain.outer) ** 2
        for half in (0, 1):
            here = near & (at[:, 0] <= 0.0) & ((at[:, 0] < -0.5 * domain.outer) == bool(half))
            for side, on in enumerate((at[:, 1] > 0.0, at[:, 1] < 0.0)):
                waves[half, side] += (here & on) * wave @ f
    waves = solution.sum(waves)
    near, far, beside, away, ahead = solution.sum(found)
    if far > 0.0 or ahead > 0.0:
        if near * away > MIXED * far * beside:
            return False, "holds tractions on the faces of the crack and body forces as well; take one of both"
        return False, ""
    if solution.problem.inertia is not None:  # a body force
        return False, "holds tractions on the faces of a crack in a motion; take smaller radii" if near > 0.0 else ""
    if np.abs(waves[0] - waves[1]).max() > UNIFORM * np.abs(waves).max():
        return True, "holds tractions on the faces of the crack that change along it; take smaller radii"
    return True, ""


def loads(solution: Solution) -> Float:
    """Return the forces of loads on the owned particles, in a motion less inertia (n_owned, dim) [force] (collective).

    The terms of the kinetic energy T in the integrals of Nakamura1985 are ``- int (q T),1 dA``, which is zero for a
    uniform density, straight faces and a crack that does not grow.
    """
    inertia = solution.problem.inertia
    force = _applied(solution)
    return force if inertia is None else force - inertia.inertial(solution.state)


def _applied(solution: Solution) -> Float:
    """Return the forces of loads without inertia (n_owned, dim) [force] (collective)."""
    state = solution.state
    return state.kept("loads", lambda: solution.problem.external_force(state)[: len(solution.x)])


def materials_in(solution: Solution, inside: Mask) -> list[int]:
    """Return the numbers of the materials of owned particles (n_owned,) selected; equal on all ranks (collective)."""
    numbers, _ = integrands_of(solution).materials()
    count = solution.sum(np.bincount(numbers[inside], minlength=1 + int(solution.largest(numbers))))
    return [int(number) for number in np.flatnonzero(count)]


def refuse(who: str, why: str) -> None:
    """Raise CaseError if there is a reason; it is equal on all ranks."""
    if why:
        raise CaseError(f"The domain of {who} {why}.")
