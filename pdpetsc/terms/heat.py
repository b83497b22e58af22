"""Heat conduction with the gradient of the scheme, or along bonds: conduction, capacity and sources."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from pdpetsc.arrays import Float, LocalIndex, Mask, row_of_entries
from pdpetsc.declare.thermal import Convection, HeatConduction, HeatFlux, HeatSource
from pdpetsc.discrete.communicator import agreed, largest
from pdpetsc.errors import CaseError, case_errors
from pdpetsc.gradient.base import GradientOperator, stencil_weights
from pdpetsc.gradient.base import with_centres as with_centres_of
from pdpetsc.gradient.products import Product
from pdpetsc.kernels.sparsity import sum_by
from pdpetsc.material.thermal import Thermal
from pdpetsc.problem.body import Body
from pdpetsc.problem.damage import DamageModel
from pdpetsc.problem.expansion import PrescribedTemperature, TemperatureField
from pdpetsc.problem.state import State
from pdpetsc.problem.term import KeptArray, Term
from pdpetsc.terms.chosen_facets import ChosenFacets
from pdpetsc.terms.conditions import Applied
from pdpetsc.terms.expansion import prescribed_temperature, reference_temperature
from pdpetsc.terms.facet_contact import STIFFNESS, FixedPoints
from pdpetsc.terms.tied import TIED, TiedForces

# A family with less than this share of its largest second moment in a direction has no slope there.
FLAT = 1e-10
# Strength of the control for one gradient point per particle.
CONTROL = 0.5


class ConductedTemperature(TemperatureField):
    """Store a temperature that is solved from one load step to the next.

    Attributes
    ----------
    before, now : (n_owned,) float64
        Temperature at the last converged step, and in the current one.
    """

    def __init__(self, start: Float) -> None:
        self.before = start
        self.now = start.copy()

    def at(self, t: float) -> Float:
        """Return the temperature of the current step, for any load parameter (not collective)."""
        return self.now.copy()

    def take(self, temperature: Float) -> None:
        """Set the temperature of the current step (not collective)."""
        self.now[:] = temperature
        self.version += 1


@dataclass(frozen=True)
class Conducting:
    """Store conductivity and capacity of the own particles.

    Attributes
    ----------
    k : (n_owned, dim, dim) float64
        Conductivity [power / length / temperature].
    c : (n_owned,) float64
        Capacity [energy / volume / temperature]; zeros for steady conduction.
    """

    k: Float
    c: Float

    @staticmethod
    def of(thermals: Sequence[Thermal | None], material_of: LocalIndex, dim: int, in_time: bool) -> Conducting:
        """Evaluate the materials of the own particles.

        Raises
        ------
        CaseError
            A material does not define a required property.
        """
        k, c = np.zeros((len(thermals), dim, dim)), np.zeros(len(thermals))
        for number, thermal in enumerate(thermals):
            tensor = None if thermal is None else thermal.conduction()
            if thermal is None or tensor is None or (in_time and thermal.capacity is None):
                lacks = "capacity" if tensor is not None else "conductivity"
                raise CaseError(
                    f"HeatConduction needs the {lacks} of every material; material {number + 1} says nothing of it: "
                    f"give it as Thermal(..., {lacks}=...)."
                )
            k[number] = tensor[:dim, :dim]
            c[number] = float(thermal.capacity) if in_time and thermal.capacity is not None else 0.0
        return Conducting(k[material_of], c[material_of])


class Heat(Term):
    """Represent heat conduction of a body: a term without forces, which stores the temperature of a run.

    The equation is ``C dT/dt + K T = Q`` with ``K = G^T (W k) G + K_control + K_convection + K_tied`` and ``C = c V``.
    The control resists ``T_j - T_i - grad T . xi`` with the strength ``G tr k / dim``, as Silling's control does for
    displacements. For bond-based materials, ``K`` is the sum over bonds of ``kappa_ij (T_j - T_i)`` with ``kappa_ij =
    dim V_i k omega V_j / sum_j omega V_j |xi|^2``, from both ends.

    Parameters
    ----------
    body : Body
        Particles and bonds.
    declared : HeatConduction
        Declared heat conduction.
    conducting : Conducting
        Conductivity and capacity.
    operator : callable or None
        Returns the current gradient operator; None for a body of bonds.
    omega : (n_bonds,) float64
        Influence of every bond [-].
    field : ConductedTemperature
        The temperature.
    held : PrescribedTemperature
        Prescribed temperatures.
    entering : sequence of (condition, mask)
        Heat through facets of the surface or in own particles.
    ties : sequence of TiedForces
        Parts of the surface that move as one, through which heat passes as through the body.
    damage : DamageModel, optional
        Damage of bonds or points. Broken bonds conduct nothing; the conductivity of points is multiplied with the
        degradation factor.

    Notes
    -----
    Construction is collective.
    """

    energy_of = "extra"

    def __init__(
        self, body: Body, declared: HeatConduction, conducting: Conducting,
        operator: Callable[[], GradientOperator] | None, omega: Float, field: ConductedTemperature,
        held: PrescribedTemperature, entering: Sequence[tuple[HeatFlux | HeatSource | Convection, Mask]],
        ties: Sequence[TiedForces], damage: DamageModel | None = None,
    ) -> None:  # fmt: skip
        self.body = body
        self.declared = declared
        self.conducting = conducting
        self.field = field
        self.prescribed = held
        self._operator = operator
        self._omega = omega
        self._entering = entering
        self._damage = damage
        self._resisting = self._convection() + self._through(ties)

    @property
    def parts(self) -> list[str]:
        """Return the names of its parts."""
        return ["heat conduction"]

    @property
    def has_history(self) -> bool:
        """Return True if the temperature depends on that of the last step."""
        return self.declared.duration is not None

    def linearise(self, state: State) -> list[Product]:
        """Return an empty list: there are no forces."""
        return []

    def commit(self, state: State) -> None:
        """Accept the temperature of the step."""
        self.field.before[:] = self.field.now

    def revert(self) -> None:
        """Restore the temperature of the last converged step (not collective)."""
        self.field.take(self.field.before)

    def arrays(self) -> Mapping[str, KeptArray]:
        """Return the temperature of the last converged step."""
        return {"temperature": KeptArray(np.arange(self.body.cloud.n_owned, dtype=np.int32), self.field.before)}

    def restored(self) -> None:
        """Continue from a temperature that was read."""
        self.revert()

    @property
    def broken(self) -> int:
        """Return a number that increases if damage changes the conductivity (not collective)."""
        return 0 if self._damage is None else self._damage.conduction_version

    @property
    def capacity(self) -> Float:
        """Return ``c V`` of the own particles (n_owned,) [energy / temperature] (not collective)."""
        return self.conducting.c * self.body.cloud.volume[: self.body.cloud.n_owned]

    def matrix(self) -> scipy.sparse.csr_matrix:
        """Compute the contribution of this rank to K (n_local, n_local), with ghosts (not collective)."""
        if self._operator is None:
            return self._along_bonds() + self._resisting
        operator = self._operator()
        K = self._resisting + self._of_gradient(operator)
        G = self.declared.control
        if G is None:
            G = CONTROL if operator.n_points == self.body.cloud.n_owned else 0.0
        # Particles without a gradient conduct by the control only.
        alone = np.zeros(self.body.cloud.n_owned, dtype=bool)
        alone[operator.owner[operator.volume == 0.0]] = True
        strength, left = np.where(alone, max(G, CONTROL), G), self._points_left
        if left is not None:
            strength = strength * operator.mean_over_points(left, len(alone))
        return K + self._control(strength) if strength.any() else K

    def sources(self, t: float) -> Float:
        """Compute Q of the own particles at load parameter ``t`` (n_owned,) [power] (collective)."""
        body = self.body
        n = body.cloud.n_owned
        Q = np.zeros(body.cloud.n_local)
        with agreed(body.cloud.comm):
            for condition, mask in self._entering:
                own = np.flatnonzero(mask)
                if isinstance(condition, HeatSource):
                    Q[own] += condition.values(body.cloud.x[own], t) * body.cloud.volume[own]
                    continue
                surface = body.known_surface
                through = np.zeros((len(surface.x), 1))
                through[own, 0] = condition.values(surface.x[own], t) * np.linalg.norm(surface.area[own], axis=1)
                surface.spread(through, Q[:, None])
        body.cloud.halo.reverse(Q)
        return Q[:n]

    def flux(self, temperature: Float) -> Float:
        """Compute ``q = -k grad T``, the mean over the points of each own particle (n_owned, dim) (collective)."""
        cloud = self.body.cloud
        local = cloud.halo.with_ghosts(temperature)
        if self._operator is None:
            families = self.body.families
            flow = self._kappa() * (local[families.neighbours] - local[families.centres])
            sums = sum_by(families.centres, flow[:, None] * families.bonds(cloud.x), cloud.n_owned)
            return np.asarray(-sums / cloud.volume[: cloud.n_owned, None])
        operator = self._operator()
        of = row_of_entries(operator.point_ptr)
        gradient = sum_by(of, local[operator.members, None] * operator.g, operator.n_points)
        q = -np.einsum("pab,pb->pa", self._conductivity(operator), gradient)
        return operator.mean_over_points(q, cloud.n_owned)

    def _of_gradient(self, operator: GradientOperator) -> scipy.sparse.csr_matrix:
        """Compute ``G^T (W k) G``."""
        n, dim = self.body.cloud.n_local, self.body.dim
        shape = (operator.n_points, n)
        G = [
            scipy.sparse.csr_matrix((operator.g[:, a], operator.members, operator.point_ptr), shape=shape)
            for a in range(dim)
        ]
        k = operator.volume[:, None, None] * self._conductivity(operator)
        parts = [
            G[a].T @ scipy.sparse.diags(k[:, a, b]) @ G[b]
            for a in range(dim)
            for b in range(dim)
            if a == b or np.any(k[:, a, b])
        ]
        return scipy.sparse.csr_matrix(sum(parts[1:], parts[0]))

    def _conductivity(self, operator: GradientOperator) -> Float:
        """Return the conductivity of the points of an operator (n_points, dim, dim), including damage."""
        k, left = self.conducting.k[operator.owner], self._points_left
        return k if left is None else k * left[:, None, None]

    @property
    def _points_left(self) -> Float | None:
        """Return the remaining share of the conductivity of each gradient point (n_points,); None if unchanged."""
        return None if self._damage is None else self._damage.conducting_points

    @property
    def _intact(self) -> Float:
        """Return 1 for unbroken bonds and 0 for others (n_bonds,)."""
        left = None if self._damage is None else self._damage.conducting_bonds
        return np.ones(len(self._omega)) if left is None else left

    def _control(self, strength: Float) -> scipy.sparse.csr_matrix:
        """Compute the matrix of ``sum_ij s_ij (T_j - T_i - grad T . xi_ij)^2`` over unbroken bonds."""
        cloud, families, dim = self.body.cloud, self.body.families, self.body.dim
        weight = self._omega * cloud.volume[families.neighbours] * self._intact
        whole = with_centres_of(np.arange(cloud.n_owned, dtype=np.int32), families.indptr, families.neighbours, weight)
        K = whole.shape_tensors(cloud.x)
        trace = np.einsum("pii->p", K)
        inverse = np.linalg.pinv(K, rcond=FLAT, hermitian=True)
        g = stencil_weights(whole, cloud.x, inverse)
        mean = np.einsum("pii->p", self.conducting.k) / dim
        each = strength * mean * cloud.volume[: cloud.n_owned]
        each = np.divide(each, trace, out=np.zeros_like(each), where=trace > 0.0)
        D = _differences(families.centres, families.neighbours, cloud.n_local)
        xi = families.bonds(cloud.x)
        shape = (cloud.n_owned, cloud.n_local)
        of = scipy.sparse.csr_matrix(
            (np.ones(len(xi)), families.centres, np.arange(len(xi) + 1)), shape=(len(xi), cloud.n_owned)
        )
        for a in range(dim):
            slope = scipy.sparse.csr_matrix((g[:, a], whole.members, whole.point_ptr), shape=shape)
            D = D - scipy.sparse.diags(xi[:, a]) @ (of @ slope)
        return scipy.sparse.csr_matrix(D.T @ scipy.sparse.diags(each[families.centres] * weight) @ D)

    def _kappa(self) -> Float:
        """Compute ``kappa_ij`` of the bonds of the own particles (n_bonds,) [power / temperature]."""
        cloud, families, dim = self.body.cloud, self.body.families, self.body.dim
        xi = families.bonds(cloud.x)
        weight = self._omega * cloud.volume[families.neighbours]
        moment = np.bincount(families.centres, weight * np.einsum("bi,bi->b", xi, xi), cloud.n_owned)
        k = np.einsum("pii->p", self.conducting.k) / dim
        each = dim * k * cloud.volume[: cloud.n_owned]
        each = np.divide(each, moment, out=np.zeros_like(each), where=moment > 0.0)
        return np.asarray(each[families.centres] * weight * self._intact)

    def _along_bonds(self) -> scipy.sparse.csr_matrix:
        """Compute the conduction matrix of bonds."""
        families = self.body.families
        D = _differences(families.centres, families.neighbours, self.body.cloud.n_local)
        return scipy.sparse.csr_matrix(D.T @ scipy.sparse.diags(self._kappa()) @ D)

    def _convection(self) -> scipy.sparse.csr_matrix:
        """Compute ``sum_f h |a_f| N_f (x) N_f``."""
        n = self.body.cloud.n_local
        K = scipy.sparse.csr_matrix((n, n))
        for condition, mask in self._entering:
            if isinstance(condition, Convection):
                facets = FixedPoints.on(ChosenFacets(self.body.known_surface, mask))
                K = K + facets.resistance(condition.coefficient, n)
        return K

    def _through(self, ties: Sequence[TiedForces]) -> scipy.sparse.csr_matrix:
        """Compute the conduction of ties, whose resistance is that of 1/1000 of a spacing of the body (collective)."""
        cloud = self.body.cloud
        k = largest(cloud.comm, np.einsum("pii->p", self.conducting.k) / cloud.dim, 0.0)
        K = scipy.sparse.csr_matrix((cloud.n_local, cloud.n_local))
        for tie in ties:
            K = K + tie.points.resistance(STIFFNESS * TIED * k / tie.spacing, cloud.n_local)
        return K


def _differences(first: LocalIndex, second: LocalIndex, n: int) -> scipy.sparse.csr_matrix:
    """Build the matrix that maps the temperatures of n local particles to ``T_j - T_i`` of bonds."""
    rows, one = np.arange(len(first)), np.ones(len(first))
    shape = (len(first), n)
    return scipy.sparse.csr_matrix((one, (rows, second)), shape=shape) - scipy.sparse.csr_matrix(
        (one, (rows, first)), shape=shape
    )


def heat_of(
    declared: HeatConduction, body: Body, applied: Applied, thermals: Sequence[Thermal | None],
    material_of: LocalIndex, operator: Callable[[], GradientOperator] | None, omega: Float,
    damage: DamageModel | None,
) -> Heat:  # fmt: skip
    """Build the heat conduction that a case declares, in its initial state (collective).

    Raises
    ------
    CaseError
        A material does not define a required property. Nothing determines the level of a steady temperature. In
        transient conduction, a condition does not define its schedule.
    """
    cloud = body.cloud
    _refuse_unfit(declared, applied)
    conducting = Conducting.of(thermals, material_of, cloud.dim, declared.duration is not None)
    with agreed(cloud.comm):
        reference = reference_temperature(thermals, material_of)
        start = declared.at_start(cloud.x[: cloud.n_owned], reference)
    held = prescribed_temperature(body, applied, start.copy())
    with case_errors():
        given = held.at(0.0)
        start[held.held] = given[held.held]
        field = ConductedTemperature(start)
        entering = [(condition, mask) for _, condition, mask in applied.heat]
        ties = [term for term in applied.following if isinstance(term, TiedForces)]
        made = Heat(body, declared, conducting, operator, omega, field, held, entering, ties, damage)
        for t in (0.0, 1.0):
            made.sources(t)
            held.at(t)
    return made


def _refuse_unfit(declared: HeatConduction, applied: Applied) -> None:
    """Raise CaseError on every rank if the conditions do not define a problem of conduction."""
    if declared.duration is None:
        if not applied.temperatures and not any(isinstance(condition, Convection) for _, condition, _ in applied.heat):
            raise CaseError(
                "Nothing fixes the level of the steady temperature; prescribe it somewhere, let the surface convect, "
                "or give HeatConduction a duration."
            )
        return
    timed = [(name, one.timed) for name, one, _ in applied.heat if not isinstance(one, Convection)]
    timed += [(name, one.timed) for name, one, _ in applied.temperatures]
    for name, known in timed:
        if not known:
            raise CaseError(
                f"{name} is a number, and heat conduction takes time: say with schedule=pd.Hold() that it acts from "
                f"the start, or with schedule=pd.Ramp() that it grows over the whole run."
            )
