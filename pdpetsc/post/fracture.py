"""Fracture quantities at a crack tip: J-integral, energy release rate, stress intensity factors."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np

from pdpetsc.arrays import Complex, Float
from pdpetsc.declared import called
from pdpetsc.errors import CaseError
from pdpetsc.material.linear_elastic import LinearElastic
from pdpetsc.post.contour import (
    Domain,
    Frame,
    Integral,
    continuum,
    loads,
    loads_in,
    materials_in,
    refuse,
    trouble,
    weight,
)
from pdpetsc.post.inhomogeneity import (
    MODULI,
    derivative_besides_grading,
    jumping,
    of_place,
    plane_tensors,
    softened,
    turned_by_place,
    uneven,
)
from pdpetsc.post.integrands import integrands_of
from pdpetsc.post.quantities import CrackTip, Quantity
from pdpetsc.post.solution import Field, Solution, velocity

# Largest share by which the stresses of a body may differ from those of linear fracture mechanics [-].
SMALL = 0.02
# A number is doubtful if its values by the inner and the outer part of a domain differ by more than this share.
PATHS = 0.05
# A crack is moved by this share of the width of the domain, in both directions. The error is its square; a smaller
# share loses digits, because energies at finite strain have an absolute error of 1e-16 of the modulus.
MOVED = 1e-3


@dataclass(frozen=True)
class Number:
    """A number of a crack tip, with its accuracy.

    Attributes
    ----------
    value : float
        The number.
    size : float
        Sum of the absolute values of its terms between the radii; if it is far larger, the number is round-off.
    guessed : float
        Difference of two integration rules next to the tip.
    why : str
        Reason why the number is wrong, as the end of a sentence; empty if there is none.
    """

    value: float
    size: float = 0.0
    guessed: float = 0.0
    why: str = ""

    @classmethod
    def of(cls, value: float, size: float, parts: Sequence[Integral], factor: float) -> Number:
        """Return a number that contains integrals times a factor, and the reason if one is too inaccurate."""
        guessed = abs(factor) * sum(abs(part.value - part.plain) for part in parts)
        return cls(value, size, guessed, next(filter(None, (part.trouble(value, factor) for part in parts)), ""))


@dataclass(frozen=True)
class AtTip(Quantity):
    """A quantity of a crack tip in a plane body, integrated over the particles between two radii.

    Tip, ``direction`` and radii are in the undeformed body. With mirror planes the number is that of the tip of the
    whole body.
    """

    tip: Sequence[float]
    direction: Sequence[float]
    inner: float
    outer: float
    follows: CrackTip | None = None

    # If moduli may depend on a non-uniform temperature, and additional advice for a refused number.
    knows_softer_moduli: ClassVar[bool] = True
    advice: ClassVar[str] = ", or give the derivative of the energy density as explicit"
    # Differences are relative to the number, or to this share of the sum of its absolute terms if that is larger.
    nothing: ClassVar[float] = 0.1

    def __post_init__(self) -> None:
        super().__post_init__()
        name = type(self).__name__
        for what, given in (("tip", self.tip), ("direction", self.direction)):
            if len(given) != 2 or not all(math.isfinite(one) for one in given):
                raise CaseError(f"A {name} is of a plane body and takes two finite numbers as {what}, not {given}.")
        if not 0.0 < math.hypot(*self.direction) < math.inf:
            raise CaseError(f"A {name} needs a direction that is not zero, not {self.direction}.")
        if not 0.0 < self.inner < self.outer < math.inf:
            raise CaseError(f"A {name} takes radii 0 < inner < outer, not {self.inner} and {self.outer}.")

    def check(self, dim: int) -> None:
        """Raise CaseError if the body is not plane."""
        if dim != 2:
            raise CaseError(f"A {type(self).__name__} is of a crack in a plane body; this one has {dim} dimensions.")
        if self.follows is not None:
            self.follows.check(dim)

    def evaluate(self, solution: Solution) -> float:
        """Return the number; nan if a moving tip is too near to the boundary or to another crack.

        Raises
        ------
        CaseError
            The domain of a fixed tip is not filled, or does not contain exactly one crack.
        """
        number = self._known(solution)
        if number.why and self.follows is not None:
            return math.nan
        refuse(f"a {type(self).__name__} at {tuple(self.tip)}", number.why)
        return number.value

    def _known(self, solution: Solution) -> Number:
        """Return the cached number of a state, for its value and its doubt (collective)."""
        # The quantity is stored with it, so that its id is not reused.
        return solution.state.kept(("crack tip", id(self)), lambda: (self, self._found(solution)))[1]

    def _found(self, solution: Solution) -> Number:
        """Return the number, or the reason why there is none (collective)."""
        self.check(solution.problem.dim)
        domain = self._domain(solution)
        why = trouble(solution, domain, self.follows is not None) or self._why_not(solution, domain)
        return Number(math.nan, why=why) if why else self.number(solution, domain)

    def doubt(self, solution: Solution) -> str:
        """Return why an accepted number of this state may be wrong (collective).

        In a continuum the number does not depend on the path. Numbers by weights that decrease mostly near the inner
        and near the outer radius are compared, and the difference of integration rules next to the tip is added.
        """
        number = self._known(solution)
        if number.why:
            return ""
        near, far = (self.number(solution, self._domain(solution, tilt)).value for tilt in (1.0, -1.0))
        least = PATHS * max(abs(number.value), self.nothing * number.size)
        if abs(near - far) > least:
            return (
                f"is {near:.4g} by what lies near its inner radius of {self.inner:g} and {far:.4g} by what lies near "
                f"its outer one of {self.outer:g}, which differ by more than {PATHS:g} of it, and should not depend on "
                f"the path; take more particles, radii further apart, or a domain further from loads, sides and the tip"
            )
        if abs(number.guessed) > least:
            return (
                f"is uncertain by {abs(number.guessed):.2g} of {number.value:.4g}, more than {PATHS:g} of it, which is "
                f"what lies next to the tip, where moduli or strains change too fast for these particles; take more "
                f"particles"
            )
        return ""

    @abstractmethod
    def number(self, solution: Solution, domain: Domain) -> Number:
        """Compute the number for a valid domain (collective)."""

    def _domain(self, solution: Solution, tilt: float = 0.0) -> Domain:
        """Return the domain about the current tip (collective)."""
        tip = np.asarray(self.tip, dtype=float)
        if self.follows is not None:
            axis = self.follows.axis
            tip = tip + max(float(self.follows.evaluate(solution) - tip @ axis), 0.0) * axis
        return Domain.of(solution, tip, self.direction, self.inner, self.outer, tilt)

    def _why_not(self, solution: Solution, domain: Domain) -> str:
        """Return why material or state is invalid for the number, in words after "it" (collective)."""
        _, why = loads_in(solution, domain)
        if why:
            return why
        return self._why_uneven(solution, domain)

    def _why_uneven(self, solution: Solution, domain: Domain) -> str:
        """Return why the position dependence of the energy density is invalid for the number (collective)."""
        inside, advice = domain.near(solution.x), self.advice
        if len(materials_in(solution, inside)) > 1:
            return f"holds several materials; take smaller radii{advice}"
        if turned_by_place(solution, inside):
            return f"holds a material whose axes change from place to place; take smaller radii{advice}"
        changing = uneven(solution, inside)
        if not self.knows_softer_moduli and softened(solution, inside):
            return "holds moduli that change with temperature from place to place; take smaller radii, or a JIntegral"
        if integrands_of(solution).remembers and softened(solution, inside):
            return f"holds a material with history whose moduli change with temperature from place to place{advice}"
        tips = [frame.tip for frame in domain.frames]
        what = jumping(solution, inside, tips, domain.outer) if changing else ""
        if what:
            return f"holds {what} that jump{'s' * (what != 'moduli')} between neighbours; take smaller radii{advice}"
        return ""


def _work_of_loads(
    solution: Solution, domain: Domain, frame: Frame, moved: Float, gradient: Float, on_faces: bool
) -> float:
    """Return ``- int q f . v,1`` of loads f on this rank, per thickness.

    ``moved`` (n_owned, 2) is v along the axes of the frame, ``gradient`` its derivative along the crack. For uniform
    tractions on the faces it is ``int q,1 f . v``, because the jump of v vanishes at the tip.
    """
    q, slope = domain.weight(frame, solution.x)
    f = loads(solution) @ frame.turn.T
    work = slope[:, 0] @ (f * moved).sum(axis=1) if on_faces else -(q @ (f * gradient).sum(axis=1))
    return float(work) / solution.problem.body.thickness


def _of_motion(solution: Solution, domain: Domain) -> list[float]:
    """Return ``- int (rho v^2 / 2 q,1 + q rho v . v,1) dA`` of each frame on this rank (collective).

    It is the part of the kinetic energy, zero unless the crack grows.
    """
    body, inertia = solution.problem.body, solution.problem.inertia
    if inertia is None:
        return [0.0] * len(domain.frames)
    v, rows = velocity(solution), np.zeros_like(solution.unknowns)
    rows[: len(v)] = v
    mass, slopes = inertia.mass / body.thickness, integrands_of(solution).slopes(body.with_ghosts(rows))
    found = []
    for frame in domain.frames:
        q, slope = domain.weight(frame, solution.x)
        along = slopes @ frame.turn[0]
        each = 0.5 * (v**2).sum(axis=1) * slope[:, 0] + q * (v * along).sum(axis=1)
        found.append(-float(mass @ each))
    return found


@dataclass(frozen=True)
class _Release(AtTip):
    """Energy released per area of crack growth, with the explicit derivative of the energy density."""

    explicit: Field | None = None

    def _why_uneven(self, solution: Solution, domain: Domain) -> str:
        """Return why the explicit derivative is unknown; empty if it is declared (collective)."""
        return "" if self.explicit is not None else super()._why_uneven(solution, domain)

    def _of_loads(self, solution: Solution, domain: Domain) -> float:
        """Return ``- int q f . H e dA`` of loads and inertia on this rank, in a motion with the kinetic energy."""
        found, fields, (on_faces, _) = 0.0, continuum(solution), loads_in(solution, domain)
        for frame, of_motion in zip(domain.frames, _of_motion(solution, domain), strict=True):
            H, u = frame.tensors(fields.H)[:, :, 0], solution.u @ frame.turn.T
            found += _work_of_loads(solution, domain, frame, u, H, on_faces)
            found += of_motion
        return found

    def _with_place(self, solution: Solution, domain: Domain, rest: float, size: float) -> Number:
        """Return the rest of a number with ``- int q dpsi/dX . e dA`` (collective)."""
        if self.explicit is not None:
            explicit = np.asarray(called("explicit derivative", self.explicit, solution), dtype=float)
            if explicit.shape != solution.x.shape:
                raise CaseError(
                    f"The explicit derivative of the energy density has the shape {solution.x.shape} of positions, "
                    f"not {explicit.shape}."
                )
            parts = [domain.integral(solution, along(domain, explicit))]
        elif uneven(solution, domain.near(solution.x)):
            parts = [domain.of_energy(solution)]
            if solution.problem.body.expansion is not None:
                parts.append(domain.integral(solution, along(domain, derivative_besides_grading(solution))))
        else:
            parts = []
        return Number.of(rest - sum(part.value for part in parts), size, parts, -1.0)


def along(domain: Domain, slopes: Float) -> list[Float]:
    """Return slopes (n, 2) along the axes of the frames of a domain."""
    return [slopes @ frame.turn.T for frame in domain.frames]


@dataclass(frozen=True)
class JIntegral(_Release):
    """J-integral of a crack tip as a domain integral [energy / area].

    ``J = - int (psi I - H^T P)_1m q,m dA - int q (b . H e_1 + dpsi/dX_1) dA - int q t . H e_1 dS`` over the undeformed
    body, with the weight q that decreases from 1 to 0 between two radii, and the displacement gradient ``H = F - I``.
    Body forces b and tractions t on the faces of the crack are those of the loads of the case; tractions are uniform
    along the crack, and dead. ``dpsi/dX`` is the derivative of the energy density by position at constant F, for
    moduli, temperature or eigenstrain that depend on position (``Integrands.explicit_derivative``). J is valid at
    finite strain. In elastic bodies it is the energy released per area of crack. In bodies with history ``psi`` is the
    work of the stress, and J depends on the radii if loading is not proportional. In bodies of bonds the fields are the
    gradient of best fit of each family, and its stress and energy density.

    In a motion the inertia ``- rho a`` is a body force, and ``- int (rho v^2 / 2 q,1 + q rho v . v,1) dA`` is added: it
    is what the kinetic energy takes from a growing crack, and zero for one that rests.

    Parameters
    ----------
    tip : (float, float)
        The crack tip in the undeformed body [length].
    direction : (float, float)
        Direction of crack growth, of any length. The faces behind the tip are straight along it up to the outer radius.
    inner, outer : float
        Radii between which the weight decreases [length]. The inner one is at least the horizon: fields nearer to the
        tip are not those of a continuum.
    follows : CrackTip, optional
        The tip of a growing crack: the domain moves with it along ``direction``, once it is ahead of ``tip``. The
        number is nan if the domain leaves the body or is invalid.
    explicit : Field, optional
        Derivative of the energy density by position at constant F (n_owned, 2) [energy / volume / length], instead of
        the one from graded moduli, temperatures and eigenstrains. Bodies with several materials, axes that rotate with
        position, or strains that jump require it. Zeros are correct for an interface along the crack.

    Raises
    ------
    CaseError
        Radii or vectors are wrong. In a body: the domain leaves it, has too few particles, or contains supports,
        another crack, several materials, or moduli or strains that jump.

    References
    ----------
    Rice1968, Shih1986, Wilson1979; Nakamura1985 (motion).

    Examples
    --------
    >>> import pdpetsc as pd
    >>> tip, ahead = (5.0, 0.0), (1.0, 0.0)
    >>> history = {f"J{n}": pd.JIntegral(tip, ahead, inner, 4.0) for n, inner in enumerate((1.0, 2.0))}
    """

    dimension = "energy per area"

    def number(self, solution: Solution, domain: Domain) -> Number:
        fields, sums = continuum(solution), np.zeros(2)
        for frame in domain.frames:
            _, slope = domain.weight(frame, solution.x)
            flow = domain.area * np.einsum("pm,pm->p", frame.tensors(fields.momentum)[:, 0], slope)
            sums += [-flow.sum(), np.abs(flow).sum()]
        rest, size = solution.sum(sums + np.array([self._of_loads(solution, domain), 0.0]))
        return self._with_place(solution, domain, float(rest), float(size))


@dataclass(frozen=True)
class EnergyReleaseRate(_Release):
    """Energy release rate by a virtual crack extension [energy / area].

    The particles about the tip are moved along the crack by ``+-d q`` in the undeformed body, with their displacements,
    and the strain energy is computed from the new deformation gradients: ``G = -(E(d) - E(-d)) / (2 d)`` per thickness,
    with ``F = I + H (I + d D)^-1`` and volumes ``W det(I + d D)``, where ``D`` is the gradient of ``q e_1`` by the
    weights of the body. By equilibrium, changes of the displacements do not contribute. Loads and position dependence
    are included as for ``JIntegral``.

    It converges to J under refinement. It uses energies only, no stresses, and the gradient of the weight by the scheme
    at every gradient point, which smooths it; J uses the exact gradient at the particles.

    Parameters
    ----------
    tip, direction, inner, outer, follows, explicit
        As for ``JIntegral``.

    Raises
    ------
    CaseError
        As for ``JIntegral``; or the forces of the body act along bonds, which have no gradient points.

    References
    ----------
    Parks1974.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> G = pd.EnergyReleaseRate((5.0, 0.0), (1.0, 0.0), inner=1.0, outer=4.0)
    """

    dimension = "energy per area"

    def number(self, solution: Solution, domain: Domain) -> Number:
        x, step, shifts = solution.cloud.x, MOVED * (self.outer - self.inner), list[Float]()
        for frame in domain.frames:
            q, _ = weight(frame.at(x), domain.inner, domain.outer, domain.tilt)
            shifts.append(q[:, None] * frame.turn[0])
        change = integrands_of(solution).released(shifts, step)
        change /= solution.problem.body.thickness
        rest, size = solution.sum([change.sum() + self._of_loads(solution, domain), np.abs(change).sum()])
        return self._with_place(solution, domain, float(rest), float(size))


@dataclass(frozen=True)
class StressIntensity(AtTip):
    """Stress intensity factor K_I or K_II of a crack tip by the interaction integral [stress length^1/2].

    ``K = E'/2 int (P_im v_i,1 + s_im H_i1 - s_ik (H - eps)_ik delta_1m) q,m dA - E'/2 int q t . v,1 dS + E'/2 int q (s
    : eps,1 + P : (S - S(x)) s,1) dA`` with displacement v and stress s of Westergaard's field for K = 1 of the mode and
    the moduli at the tip, and the eigenstrain eps (in plane strain including Poisson's ratio times the part across the
    plane). Body forces and tractions on the faces are as for ``JIntegral``. ``E' = E`` in plane stress and ``E / (1 -
    nu^2)`` in plane strain, at the tip. The last part is for graded moduli, with the compliance S at the tip and S(x):
    s is in equilibrium, but its strain by the local moduli is no gradient of v; derivatives of moduli are not required.
    K is defined in linear fracture mechanics. It is refused if the material is not isotropic, if moduli depend on a
    non-uniform temperature, or if flow, large strain or rotation change the stresses between the radii by more than
    0.02 of those of small linear strain. In a nonlinear body of bonds the displacement gradient must be at most 0.02.

    Parameters
    ----------
    tip, direction, inner, outer, follows
        As for ``JIntegral``. K_II is positive if the upper face, left of the direction, moves forward.
    mode : {"I", "II"}
        Opening or sliding.

    Raises
    ------
    CaseError
        As for ``JIntegral``, or the state is not one of linear fracture mechanics.

    References
    ----------
    Westergaard1939, Yau1980, Wilson1979, Kim2005.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> K2 = pd.StressIntensity((5.0, 0.0), (1.0, 0.0), inner=1.0, outer=4.0, mode="II")
    """

    dimension = "stress intensity"

    mode: Literal["I", "II"] = "I"

    knows_softer_moduli: ClassVar[bool] = False
    # The accuracy of one mode is relative to both modes.
    nothing: ClassVar[float] = 0.5
    advice: ClassVar[str] = ""

    def number(self, solution: Solution, domain: Domain) -> Number:
        law = self._law(solution, domain)
        assert law is not None
        fields, sums, (on_faces, _) = continuum(solution), np.zeros(2), loads_in(solution, domain)
        (free, changes), place = self._free(solution, law), of_place(solution)
        densities, stiffer = list[Float](), list[Float]()
        softer = 1.0 - domain.at_tip(solution, place.factor) / place.factor[: len(solution.x)]
        for frame in domain.frames:
            _, slope = domain.weight(frame, solution.x)
            at = frame.at(solution.x)
            s, v, w = westergaard(at, self.mode, law)
            H, P, eps = frame.tensors(fields.H), frame.tensors(fields.P), frame.tensors(free)
            flow = np.einsum("pim,pi->pm", P, v) + np.einsum("pim,pi->pm", s, H[:, :, 0])
            flow[:, 0] -= np.einsum("pik,pik->p", s, H - eps)
            flow_in = domain.area * np.einsum("pm,pm->p", flow, slope)
            sums += [flow_in.sum() + _work_of_loads(solution, domain, frame, w, v, on_faces), np.abs(flow_in).sum()]
            by_axes = [frame.tensors(np.einsum("pabm,m->pab", changes, axis)) for axis in frame.turn]
            densities.append(np.stack([np.einsum("pik,pik->p", s, along) for along in by_axes], axis=1))
            less = softer * strain_energy(P, westergaard_slope(at, self.mode), law)
            stiffer.append(np.stack([less, np.zeros(len(less))], axis=1))
        half, (rest, size) = 0.5 * plane_modulus(law), solution.sum(sums)
        parts = [] if place.strain is None else [domain.integral(solution, densities)]
        if MODULI in uneven(solution, domain.near(solution.x)):
            parts.append(domain.integral(solution, stiffer))
        K = half * (rest + sum(part.value for part in parts))
        return Number.of(float(K), float(half * size), parts, half)

    def _why_not(self, solution: Solution, domain: Domain) -> str:
        """Return the reason, including fields that are not those of linear fracture mechanics."""
        why = super()._why_not(solution, domain)
        if why:
            return why
        if self._law(solution, domain) is None:
            return "holds a material that is not isotropic; take a JIntegral"
        departs = self._departs(solution, domain)
        if departs > SMALL:
            return (
                f"has stresses of which a share of {departs:.3g}, beyond {SMALL}, is not of small linear strain: by "
                f"flow, large strain or turning; take larger radii, less load, or a JIntegral"
            )
        return ""

    def _departs(self, solution: Solution, domain: Domain) -> float:
        """Return the relative difference of the stresses from those of small linear strain (collective).

        The stress of bonds is linear up to the error of their sums; for bonds the displacement gradient is used.
        """
        fields, law = continuum(solution), self._law(solution, domain)
        assert law is not None
        if solution.problem.material_term.linear:
            return 0.0
        ring = np.zeros(len(solution.x))
        for frame in domain.frames:
            ring[domain.between(frame.at(solution.x))] = 1.0
        if not solution.problem.material_term.n_points:
            return solution.largest(ring * np.abs(fields.H).max(axis=(1, 2)), 0.0)
        lam, mu = law.lame(2)
        strain = 0.5 * (fields.H + fields.H.transpose(0, 2, 1)) - self._free(solution, law)[0]
        exact = lam * np.einsum("pii->p", strain)[:, None, None] * np.eye(2) + 2.0 * mu * strain
        place = of_place(solution).factor
        exact *= (place[: len(exact)] / domain.at_tip(solution, place))[:, None, None]
        sums = [ring * domain.area @ np.linalg.norm(T, axis=(1, 2)) for T in (fields.P - exact, fields.P)]
        apart, whole = solution.sum(sums)
        return float(apart / whole) if whole > 0.0 else 0.0

    @staticmethod
    def _free(solution: Solution, law: LinearElastic) -> tuple[Float, Float]:
        """Return the in-plane eigenstrain (n_owned, 2, 2), and its slope (n_owned, 2, 2, 2).

        In plane strain it includes Poisson's ratio times the constrained strain across the plane; that of bonds
        contains this already. Collective.
        """
        n, place = len(solution.x), of_place(solution)
        if place.strain is None:
            return np.zeros((n, 2, 2)), np.zeros((n, 2, 2, 2))
        across = law.nu if law.plane == "strain" and solution.problem.material_term.n_points else 0.0
        part = place.strain[:, :3].copy()
        part[:, :2] += across * place.strain[:, 3:]
        slope = integrands_of(solution).slopes(part)
        return plane_tensors(part[:n]), plane_tensors(slope)

    @staticmethod
    def _law(solution: Solution, domain: Domain) -> LinearElastic | None:
        """Return the elastic law in the domain, with its moduli at the tip (collective)."""
        inside = domain.near(solution.x)
        law = integrands_of(solution).elastic_law(materials_in(solution, inside)[0], inside)
        return None if law is None else replace(law, E=law.E * domain.at_tip(solution, of_place(solution).factor))


def plane_modulus(law: LinearElastic) -> float:
    """Return ``E'`` of ``J = K^2 / E'`` [stress]: E in plane stress, ``E / (1 - nu^2)`` in plane strain."""
    return law.E if law.plane == "stress" else law.E / (1.0 - law.nu**2)


def strain_energy(s: Float, t: Float, law: LinearElastic) -> Float:
    """Return the work (n,) of plane stresses s (n, 2, 2) on the elastic strains of stresses t (n, 2, 2)."""
    across = law.nu / (1.0 + law.nu) if law.plane == "stress" else law.nu
    both = np.einsum("pik,pik->p", s, t) - across * np.einsum("pii->p", s) * np.einsum("pii->p", t)
    return np.asarray((1.0 + law.nu) / law.E * both)


def westergaard_slope(x: Float, mode: str) -> Float:
    """Return the derivative along the crack (n, 2, 2) of the stresses of ``westergaard`` [1 / length^3/2]."""
    z = x[:, 0] + 1j * x[:, 1]
    z = np.where(z == 0.0, np.finfo(float).tiny, z)
    Z = -0.5 / (z * np.sqrt(2.0 * np.pi * z))  # derivative of the function of the field
    return _stresses(Z, x[:, 1] * (-1.5 * Z / z), mode)


def _stresses(Z: Complex, turned: Complex, mode: str) -> Float:
    """Return the stresses (n, 2, 2) of Westergaard's function Z (n,) and ``turned = x_2 Z'`` (n,)."""
    s = np.empty((len(Z), 2, 2))
    if mode == "I":
        s[:, 0, 0], s[:, 1, 1] = Z.real - turned.imag, Z.real + turned.imag
        s[:, 0, 1] = s[:, 1, 0] = -turned.real
    else:
        s[:, 0, 0], s[:, 1, 1] = 2.0 * Z.imag + turned.real, -turned.real
        s[:, 0, 1] = s[:, 1, 0] = Z.real - turned.imag
    return s


def westergaard(x: Float, mode: str, law: LinearElastic) -> tuple[Float, Float, Float]:
    """Return the field at a crack tip whose stress intensity factor of one mode is 1.

    Parameters
    ----------
    x : (n, 2) float64
        Positions from the tip, along the crack and across it [length].
    mode : {"I", "II"}
        Opening or sliding.
    law : LinearElastic
        Its constants, in plane strain or plane stress.

    Returns
    -------
    s : (n, 2, 2) float64
        Stress over the factor [1 / length^1/2].
    v : (n, 2) float64
        Derivative of the displacement along the crack over the factor [1 / (stress length^1/2)].
    w : (n, 2) float64
        Displacement over the factor [length^1/2 / stress].

    References
    ----------
    Westergaard1939.
    """
    z = x[:, 0] + 1j * x[:, 1]
    z = np.where(z == 0.0, np.finfo(float).tiny, z)
    Z = 1.0 / np.sqrt(2.0 * np.pi * z)
    whole = 2.0 * z * Z  # the integral of Z
    turned = x[:, 1] * (-0.5 * Z / z)  # x_2 Z'
    mu = 0.5 * law.E / (1.0 + law.nu)
    kappa = (3.0 - law.nu) / (1.0 + law.nu) if law.plane == "stress" else 3.0 - 4.0 * law.nu
    s, v, w = _stresses(Z, turned, mode), np.empty((len(x), 2)), np.empty((len(x), 2))
    if mode == "I":
        v[:, 0] = 0.5 * (kappa - 1.0) * Z.real - turned.imag
        v[:, 1] = 0.5 * (kappa + 1.0) * Z.imag - turned.real
        w[:, 0] = 0.5 * (kappa - 1.0) * whole.real - x[:, 1] * Z.imag
        w[:, 1] = 0.5 * (kappa + 1.0) * whole.imag - x[:, 1] * Z.real
    else:
        v[:, 0] = 0.5 * (kappa + 1.0) * Z.imag + turned.real
        v[:, 1] = -0.5 * (kappa - 1.0) * Z.real - turned.imag
        w[:, 0] = 0.5 * (kappa + 1.0) * whole.imag + x[:, 1] * Z.real
        w[:, 1] = -0.5 * (kappa - 1.0) * whole.real - x[:, 1] * Z.imag
    return s, v / (2.0 * mu), w / (2.0 * mu)
