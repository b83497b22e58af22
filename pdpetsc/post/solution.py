"""The state after a converged step, for output and quantities of interest."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from pdpetsc.arrays import Float
from pdpetsc.declare.region import Region
from pdpetsc.declared import name_of, shown
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.communicator import largest, smallest, total
from pdpetsc.discrete.selection import select
from pdpetsc.errors import CaseError
from pdpetsc.problem.problem import Problem
from pdpetsc.problem.state import State
from pdpetsc.terms.following_load import FollowingLoad
from pdpetsc.terms.heat import Heat


class Solution:
    """Displacements of the owned particles, with fields and forces computed from them.

    Parameters
    ----------
    problem : Problem
        Terms and supports.
    unknowns : (n_rows, dim) float64
        Converged displacements [length], then the virtual rows of a periodic cell.
    t : float
        Load parameter [-].
    step : int
        Number of the step, 0 for the undeformed state.
    work : float
        Work of loads and supports since the undeformed state [energy].
    resume : mapping of str to float
        Numbers of the solver for an exact restart from here, by its own names.
    tangent_at : (n_rows, dim) float64, optional
        Displacements of the first tangent of the next step [length], if different from ``unknowns``.

    Notes
    -----
    Computed properties, reductions over ranks, ``with_ghosts`` and ``select`` are collective.
    """

    def __init__(
        self, problem: Problem, unknowns: Float, t: float, step: int, work: float = 0.0,
        resume: Mapping[str, float] | None = None, tangent_at: Float | None = None,
    ) -> None:  # fmt: skip
        self.problem = problem
        self.unknowns = unknowns
        self.t = t
        self.step = step
        self.work = work
        self.resume = {name: float(value) for name, value in (resume or {}).items()}
        self.tangent_at = tangent_at

    @property
    def cloud(self) -> Cloud:
        """Return the particles of this rank with their ghosts."""
        return self.problem.body.cloud

    @cached_property
    def state(self) -> State:
        """Return the state of the problem (collective)."""
        return self.problem.state(self.unknowns, self.t)

    def forget(self) -> None:
        """Free cached fields of the output, which can be computed again."""
        self.state.forget()

    @property
    def x(self) -> Float:
        """Return the reference positions of the owned particles (n_owned, dim) [length]."""
        return self.cloud.x[: self.cloud.n_owned]

    @property
    def volume(self) -> Float:
        """Return the volumes of the owned particles (n_owned,)."""
        return self.cloud.volume[: self.cloud.n_owned]

    @property
    def u(self) -> Float:
        """Return the displacements of the owned particles (n_owned, dim) [length]."""
        return self.unknowns[: self.cloud.n_owned]

    @cached_property
    def internal_force(self) -> Float:
        """Return the internal forces (n_rows, dim) [force]."""
        force = self.problem.internal_force(self.state, of_solver=False)
        if force is None:
            raise FloatingPointError("a converged state has det F <= 0")
        return force

    @cached_property
    def reaction(self) -> Float:
        """Return the forces of supports, ``f_int - f_ext`` for prescribed unknowns, else 0 (n_rows, dim) [force]."""
        return np.where(self.problem.supports.reacting, self.internal_force - self._loads, 0.0)

    def follow(self, before: Solution, work: float | None = None) -> None:
        """Add the work since the previous step: mean force times displacement, ``1/2 (f + f0) (u - u0)``.

        It is that of loads, supports and moving tools. Without inertia it equals the work of the internal forces. It
        has the error of the trapezoidal rule unless forces are linear between the steps. A solver with equilibria
        between the steps passes the ``work`` itself.
        """
        if work is not None:
            self.work = before.work + work
            return
        forces = self._acting + before._acting
        moved = 0.5 * float((forces * (self.unknowns - before.unknowns)).sum())
        moved += self.problem.tool_work(before.state, self.state, before._tool_forces, self._tool_forces)
        self.work = before.work + float(self.sum(moved))

    def hold_forces(self) -> None:
        """Compute the forces with which the work of the next step begins, before that step changes the terms."""
        _ = self._acting, self._tool_forces

    @cached_property
    def _loads(self) -> Float:
        """Return the external forces (n_rows, dim) [force]."""
        return self.problem.external_force(self.state)

    @cached_property
    def _acting(self) -> Float:
        """Return the forces of loads and supports (n_rows, dim) [force]."""
        return np.where(self.problem.supports.reacting, self.internal_force, self._loads)

    @cached_property
    def _tool_forces(self) -> list[Float]:
        """Return the forces of tools by term, which depend on the step that ends here with friction."""
        return self.problem.tool_forces(self.state)

    @cached_property
    def energies(self) -> dict[str, float]:
        """Return the energies by name: ``strain``, ``control``, ... [energy]."""
        return self.problem.energies(self.state)

    @property
    def broken_bonds(self) -> int:
        """Return the number of pairs of particles with a broken bond (collective)."""
        damage = self.problem.bond_damage
        return 0 if damage is None else damage.bonds.count_broken()

    @cached_property
    def cell_strain(self) -> Float:
        """Return the mean strain of the periodic cell (dim, dim) [-]."""
        cloud = self.cloud
        assert cloud.images is not None
        return cloud.images.strain(self.unknowns[cloud.n_owned :])

    @cached_property
    def cell_stress(self) -> Float:
        """Return the mean stress of the periodic cell (dim, dim) [stress]."""
        cell = self.problem.supports.cell
        assert cell is not None
        stress = np.zeros((self.problem.dim, self.problem.dim))
        # A fluid in cracks and holes across the edge of the cell carries its part.
        fluids = [term for term in self.problem.terms if isinstance(term, FollowingLoad)]
        forces = self.internal_force + self.problem.force_of(fluids, self.state)
        for (a, b), value in zip(cell.components, cell.mean_stress(forces), strict=True):
            stress[a, b] = stress[b, a] = value
        return stress

    @cached_property
    def out_of_plane(self) -> tuple[Float, Float, Float]:
        """Return stretch [-], P and Cauchy stress [stress] across a line or plane body, each (n_owned,)."""
        return self.problem.material_term.out_of_plane(self.state)

    def select(self, region: Region) -> Any:
        """Return True for owned particles in a region (n_owned,) bool."""
        return select(self.cloud, region, "a quantity of interest")

    def sum(self, values: Any) -> Any:
        """Return the sum over all ranks of numbers summed on each."""
        return total(self.cloud.comm, values)

    def largest(self, values: Any, initial: float = -np.inf) -> float:
        """Return the maximum of numbers of all ranks, ``initial`` if there are none."""
        return largest(self.cloud.comm, values, initial)

    def smallest(self, values: Any, initial: float = np.inf) -> float:
        """Return the minimum of numbers of all ranks, ``initial`` if there are none."""
        return smallest(self.cloud.comm, values, initial)

    def with_ghosts(self, values: Float) -> Float:
        """Return numbers of the owned particles (n_owned, ...) with those of their ghosts (n_local, ...)."""
        return self.cloud.halo.with_ghosts(np.asarray(values, dtype=float))


# A field of the owned particles, (n_owned,), (n_owned, dim) or (n_owned, dim, dim); named as its function.
Field: TypeAlias = Callable[[Solution], Float]


def rows_of_field(field: Field, values: Any, n: int) -> NDArray[Any]:
    """Return the values of a field as an array; raise CaseError unless there is a number for each particle."""
    try:
        found = np.asarray(values)
    except ValueError:  # rows of different lengths
        found = np.empty(0, dtype=object)
    if found.shape[:1] != (n,) or found.dtype.kind not in "biuf":
        raise CaseError(
            f"The field {name_of(field)} must return numbers for each of {n} particles, not {shown(values)}."
        )
    return found


def displacement(solution: Solution) -> Float:
    """Return u (n_owned, dim) [length]."""
    return solution.u


def velocity(solution: Solution) -> Float:
    """Return the velocity of a motion (n_owned, dim) [length / time]; zero for equilibria."""
    inertia = solution.problem.inertia
    return np.zeros_like(solution.u) if inertia is None else inertia.motion(solution.state)[0]


def deformation_gradient(solution: Solution) -> Float:
    """Return F, the mean over the points of each particle (n_owned, dim, dim) [-]."""
    return solution.problem.material_term.deformation_gradient(solution.state)


def stress(solution: Solution) -> Float:
    """Return the Cauchy stress, the mean over the points of each particle (n_owned, dim, dim) [stress]."""
    return solution.problem.material_term.cauchy_stress(solution.state)


def first_piola_stress(solution: Solution) -> Float:
    """Return P, the mean over the points of each particle (n_owned, dim, dim) [stress]."""
    return solution.problem.material_term.first_piola_stress(solution.state)


def in_space(field: Field) -> Field:
    """Return a field for files: tensors of a line or plane body with their entries across it (n, 3, 3).

    Other fields are returned unchanged.
    """
    inner = getattr(field, "__wrapped__", field)
    # A field of the user may not be hashable.
    across = next((number for known, number in _ACROSS.items() if known is inner), None)
    if across is None:
        return field

    def whole(solution: Solution) -> Float:
        inside = field(solution)
        dim = solution.problem.dim
        if dim == 3:
            return inside
        tensor = np.zeros((len(inside), 3, 3))
        tensor[:, :dim, :dim] = inside
        for axis in range(dim, 3):
            tensor[:, axis, axis] = solution.out_of_plane[across]
        return tensor

    return whole


def energy_density(solution: Solution) -> Float:
    """Return the strain energy density, the mean over the points of each particle (n_owned,) [energy / volume]."""
    return solution.problem.material_term.energy_density(solution.state)


def reaction(solution: Solution) -> Float:
    """Return the support forces (n_owned, dim) [force]."""
    return solution.reaction[: len(solution.u)]


def plastic_strain(solution: Solution) -> Float:
    """Return the accumulated plastic strain, the mean over the points of each particle (n_owned,) [-]."""
    return solution.problem.material_term.plastic_strain()


def temperature(solution: Solution) -> Float:
    """Return the temperature of each particle (n_owned,).

    Raises
    ------
    CaseError
        The case has no temperature.
    """
    found = solution.state.temperature
    if found is None:
        raise CaseError("The case says nothing of temperature; leave the field temperature out.")
    return found


def heat_flux(solution: Solution) -> Float:
    """Return ``q = -k grad T``, the mean over the points of each particle (n_owned, dim) [power / area].

    Raises
    ------
    CaseError
        The case has no heat conduction.
    """
    found = [term for term in solution.problem.terms if isinstance(term, Heat)]
    if not found:
        raise CaseError("The case has no heat conduction; leave the field heat_flux out.")
    return found[0].flux(temperature(solution))


def local_damage(solution: Solution) -> Float:
    """Return the lost share of the stiffness of the bonds of each particle (n_owned,) [-]; 0 without damage.

    References
    ----------
    Silling2005, Eq. (29), with the bonds weighted by their stiffness.
    """
    return solution.problem.material_term.local_damage()


def lost_bonds(solution: Solution) -> Float:
    """Return the share of the family volume of each particle with broken bonds (n_owned,) [-].

    Bonds that have lost part of their force are not counted; 0 without damage.

    References
    ----------
    Hashim, Eq. (46).
    """
    damage = solution.problem.bond_damage
    return np.zeros(len(solution.u)) if damage is None else damage.lost_bonds()


def local_horizon(solution: Solution) -> Float:
    """Return the horizon of each particle (n_owned,) [length]."""
    return np.asarray(solution.cloud.local_horizon[: solution.cloud.n_owned])


# The entry of ``Solution.out_of_plane`` that completes each tensor.
_ACROSS: dict[Field, int] = {deformation_gradient: 0, first_piola_stress: 1, stress: 2}
