"""Quantities of interest: one number per step."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal, NamedTuple

import numpy as np

from pdpetsc.arrays import Float, Mask
from pdpetsc.declare.region import All, Nearest, Region, accept_region_name
from pdpetsc.declare.solvers import Opening
from pdpetsc.declared import Declared, name_of, numbers_from
from pdpetsc.discrete.communicator import agreed, smallest
from pdpetsc.errors import CaseError
from pdpetsc.post.invariants import damage_dissipation, principal_strains, principal_stresses, triaxiality, von_mises
from pdpetsc.post.solution import (
    Field,
    Solution,
    deformation_gradient,
    displacement,
    energy_density,
    first_piola_stress,
    heat_flux,
    local_damage,
    local_horizon,
    lost_bonds,
    plastic_strain,
    reaction,
    rows_of_field,
    stress,
    temperature,
)
from pdpetsc.problem.inertia import Inertia
from pdpetsc.problem.scales import nearest_distances

EVERYWHERE = All()
# A point is outside of the body if the nearest particle is further away than this share of its horizon, and than this
# multiple of the distance to its nearest neighbour. Corners of cells are nearer.
OUTSIDE, OUTSIDE_SPACINGS = 0.6, 1.5
# Values of two bodies at a point differ if they do by more than the first share of the larger one, and by more than the
# second share of the largest entry of the field anywhere.
APART, ROUND_OFF = 0.01, 1e-6


class _Known(NamedTuple):
    """A field of pdpetsc.

    Attributes
    ----------
    letters : int
        Number of letters of a component.
    dimension : str
        Empty for pure numbers, and for units without a label.
    principal : bool
        True for three values in every dimension of the body, not along axes.
    of_gradients : bool
        False if the field is as accurate next to a surface as inside.
    """

    letters: int
    dimension: str = ""
    principal: bool = False
    of_gradients: bool = True


_KNOWN: dict[Field, _Known] = {
    damage_dissipation: _Known(0, "energy per volume"),
    deformation_gradient: _Known(2),
    displacement: _Known(1, "length", of_gradients=False),
    energy_density: _Known(0, "energy per volume"),
    first_piola_stress: _Known(2, "stress"),
    heat_flux: _Known(1),
    local_damage: _Known(0, of_gradients=False),
    local_horizon: _Known(0, "length"),
    lost_bonds: _Known(0, of_gradients=False),
    plastic_strain: _Known(0),
    principal_strains: _Known(1, principal=True),
    principal_stresses: _Known(1, "stress", principal=True),
    reaction: _Known(1, "force", of_gradients=False),
    stress: _Known(2, "stress"),
    temperature: _Known(0, "temperature", of_gradients=False),
    triaxiality: _Known(0),
    von_mises: _Known(0, "stress"),
}


def _known(field: Field) -> _Known | None:
    """Return the properties of a field of pdpetsc; None for a field of the user, which may not be hashable."""
    return next((known for function, known in _KNOWN.items() if function is field), None)


class Quantity(Declared, ABC):
    """A number of every converged step for the history.

    The ``region`` of a quantity may be the name of a side or of a set, as for conditions.

    Attributes
    ----------
    of_path : bool
        True if the number depends on the steps before, not on the displacement alone.
    """

    of_path: ClassVar[bool] = False
    # What to write for a function in place of a quantity.
    instead_of_function: ClassVar[str] = "wrap the function f as pd.Mean(f), pd.Largest(f) or pd.Smallest(f)"

    def __post_init__(self) -> None:
        accept_region_name(self)
        super().__post_init__()

    @property
    def dimension(self) -> str:
        """Return its dimension for ``Units.of``; empty for pure numbers and unknown dimensions."""
        return ""

    @abstractmethod
    def evaluate(self, solution: Solution) -> float:
        """Return the value (collective)."""

    def check(self, dim: int) -> None:
        """Raise CaseError if the quantity does not fit a body of ``dim`` dimensions; nothing is computed."""

    def note(self, solution: Solution) -> str:
        """Return a note on the value for the user, as the end of a sentence; usually empty (collective)."""
        return ""

    def doubt(self, solution: Solution) -> str:
        """Return why the value of a converged step may be wrong, as the end of a sentence; usually empty (collective).

        Runs warn and store it in their summary under ``doubts``.
        """
        return ""

    def drawn(self, solution: Solution) -> tuple[Sequence[Float], bool] | None:
        """Return lines or surfaces for a file, each as points (n, dim), and True if they are closed.

        Equal on all ranks; None if there is nothing to draw (collective).
        """
        return None


@dataclass(frozen=True)
class _OfField(Quantity):
    """A quantity of a field component over a region."""

    field: Field
    component: str = ""
    region: Region = EVERYWHERE

    @property
    def dimension(self) -> str:
        return dimension_of(self.field)

    def __post_init__(self) -> None:
        super().__post_init__()
        refuse_component(self, self.field, self.component)

    def check(self, dim: int) -> None:
        """Raise CaseError if the component does not exist in a body of ``dim`` dimensions."""
        refuse_component(self, self.field, self.component, dim)
        self.region.check(dim)

    def _chosen(self, solution: Solution) -> Float:
        """Return the component at the own particles of the region (n,)."""
        return np.asarray(_component_of(solution, self.field, self.component)[solution.select(self.region)])


@dataclass(frozen=True)
class Mean(_OfField):
    """Volume-weighted mean of a field component over a region.

    Parameters
    ----------
    field : Field
        ``displacement``, ``stress``, or any function of the solution.
    component : str
        ``"x"`` of a vector, ``"xy"`` of a tensor, ``""`` of a scalar.
    region : Region
        The particles; by default all.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> right = pd.Mean(pd.displacement, "x", pd.region.Slab("x", low=9.0))
    """

    def evaluate(self, solution: Solution) -> float:
        mask = solution.select(self.region)
        values = _component_of(solution, self.field, self.component)[mask]
        weight = solution.volume[mask]
        moment, volume = solution.sum([weight @ values, weight.sum()])
        return float(moment / volume)


@dataclass(frozen=True)
class PathOpening(Quantity):
    """The measure of a path by ``Opening``: mean displacement of its region relative to the other [length]."""

    measure: Opening

    dimension = "length"

    def evaluate(self, solution: Solution) -> float:
        sides = [self.measure.region, *([] if self.measure.against is None else [self.measure.against])]
        moved = [Mean(displacement, self.measure.component, side).evaluate(solution) for side in sides]
        return moved[0] - sum(moved[1:])


@dataclass(frozen=True)
class _AtPoint(Mean):
    """The mean over the particles nearest to a point, which must lie in the body."""

    def evaluate(self, solution: Solution) -> float:
        self._refuse_outside(solution)
        return super().evaluate(solution)

    def doubt(self, solution: Solution) -> str:
        """Return the range of the values if the nearest particles are of several bodies and move or deform apart."""
        body, chosen = solution.cloud.body, solution.select(self.region)
        if body is None:
            return ""
        own = body[: len(chosen)][chosen]
        if solution.smallest(own) == solution.largest(own):
            return ""
        values, of_all = self._chosen(solution), solution.largest(np.abs(_values(solution, self.field)))
        low, high = solution.smallest(values), solution.largest(values)
        if high - low <= max(APART * max(abs(low), abs(high)), ROUND_OFF * of_all):
            return ""
        return (
            f"is the mean of equally near particles of several bodies, with values from {low:.4g} to {high:.4g}; move "
            f"the point into one body, or take Mean over pd.region.Named of the body & pd.region.Nearest"
        )

    def _refuse_outside(self, solution: Solution) -> None:
        """Raise CaseError on all ranks if the point is further from the nearest particle than ``At`` allows."""
        assert isinstance(self.region, Nearest)
        comm, chosen = solution.cloud.comm, solution.select(self.region)
        point = np.atleast_1d(np.asarray(self.region.point, dtype=float))
        distance = smallest(comm, np.linalg.norm(solution.x[chosen] - point, axis=1))
        horizon = smallest(comm, solution.cloud.local_horizon[: len(chosen)][chosen])
        if distance <= OUTSIDE * horizon:
            return
        spacing = smallest(comm, nearest_distances(solution.problem.body)[chosen])
        if distance > OUTSIDE_SPACINGS * spacing:
            raise CaseError(
                f"The point ({', '.join(f'{one:g}' for one in point)}) of At is not in the body: the nearest particle "
                f"is {distance:.4g} away, and its nearest neighbour {spacing:.4g} from it. Correct the point, or take "
                f"Mean over pd.region.Nearest."
            )


def At(point: tuple[float, ...], field: Field, component: str = "") -> Mean:
    """Return the quantity for the value at the particle nearest to ``point`` (the mean of equally near ones).

    A run refuses a point that is further from the nearest particle than half its horizon, and than one and a half times
    the distance from there to its own nearest neighbour.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> tip = pd.At((10.0, 1.0), pd.displacement, "y")
    """
    return _AtPoint(field, component, Nearest(point))


@dataclass(frozen=True)
class Reaction(Quantity):
    """Sum of one component of the support forces in a region [force].

    Prescribed particles have no inertia: in a motion the sum does not contain the force ``m a`` that accelerates them.

    Parameters
    ----------
    component : str
        ``"x"``, ``"y"`` or ``"z"``.
    region : Region
        The particles; by default all.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> force = pd.Reaction("x", pd.region.Slab("x", high=1.0))
    """

    dimension = "force"

    component: str
    region: Region = EVERYWHERE

    def __post_init__(self) -> None:
        super().__post_init__()
        refuse_component(self, reaction, self.component)

    def check(self, dim: int) -> None:
        """Raise CaseError if the component does not exist in a body of ``dim`` dimensions."""
        refuse_component(self, reaction, self.component, dim)
        self.region.check(dim)

    def evaluate(self, solution: Solution) -> float:
        mask = solution.select(self.region)
        return float(solution.sum(component(reaction(solution), self.component)[mask].sum()))

    def note(self, solution: Solution) -> str:
        """Return a note if nothing is held in the region and the reaction is zero."""
        mask = solution.select(self.region)
        fixed = solution.problem.supports.fixed[: len(mask), "xyz".index(self.component)]
        if int(solution.sum(float(np.count_nonzero(mask & fixed)))):
            return ""
        return f"is 0, because none of its particles is held in {self.component}"


@dataclass(frozen=True)
class ReactionMoment(Quantity):
    """Moment of the support forces in a region about a point, ``sum (x + u - about) x f`` [force length].

    Parameters
    ----------
    region : Region
        The particles.
    about : sequence of float
        A point at rest (dim,) [length].
    axis : {"x", "y", "z"}
        The component; z in 2D, anticlockwise.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> moment = pd.ReactionMoment("+x", about=(0.0, 0.0))
    """

    dimension = "force length"

    region: Region
    about: Sequence[float]
    axis: Literal["x", "y", "z"] = "z"

    def check(self, dim: int) -> None:
        """Raise CaseError if the point or the axis does not exist in ``dim`` dimensions."""
        self.region.check(dim)
        if len(self.about) != dim or dim == 1 or (dim == 2 and self.axis != "z"):
            raise CaseError(
                f"ReactionMoment takes a point of {dim} numbers in {dim} dimensions, and the axis z in 2D; it has "
                f"{len(self.about)} numbers and the axis {self.axis}."
            )

    def evaluate(self, solution: Solution) -> float:
        mask = solution.select(self.region)
        arm = (solution.x + solution.u - np.asarray(self.about, dtype=float))[mask]
        force = reaction(solution)[mask]
        a, b = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[self.axis]
        return float(solution.sum(float((arm[:, a] * force[:, b] - arm[:, b] * force[:, a]).sum())))


@dataclass(frozen=True)
class _OfCell(Quantity):
    """A component of a symmetric tensor of the periodic cell."""

    component: str

    def __post_init__(self) -> None:
        super().__post_init__()
        refuse_component(self, stress, self.component)

    def check(self, dim: int) -> None:
        """Raise CaseError if the component does not exist in a cell of ``dim`` dimensions."""
        refuse_component(self, stress, self.component, dim)


@dataclass(frozen=True)
class CellStrain(_OfCell):
    """Component of the mean strain of a periodic cell [-].

    Examples
    --------
    >>> import pdpetsc as pd
    >>> strain = pd.CellStrain("xy")
    """

    def evaluate(self, solution: Solution) -> float:
        a, b = _axes(solution, self.component)
        return float(solution.cell_strain[a, b])


@dataclass(frozen=True)
class CellStress(_OfCell):
    """Component of the mean first Piola-Kirchhoff stress of a periodic cell, its symmetric part [stress].

    Examples
    --------
    >>> import pdpetsc as pd
    >>> stress = pd.CellStress("xx")
    """

    dimension = "stress"

    def evaluate(self, solution: Solution) -> float:
        a, b = _axes(solution, self.component)
        return float(solution.cell_stress[a, b])


@dataclass(frozen=True)
class StrainEnergy(Quantity):
    """Strain energy of the body without the energy of its zero-energy control [energy].

    For a material that flows or relaxes it is the total work of its stress, plastic work included.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> history = {"energy": pd.StrainEnergy()}
    """

    dimension = "energy"

    def evaluate(self, solution: Solution) -> float:
        return solution.energies["strain"]


@dataclass(frozen=True)
class ControlEnergy(Quantity):
    """Energy of the zero-energy control [energy]; small relative to the strain energy if the control has little effect.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> history = {"energy": pd.StrainEnergy(), "of control": pd.ControlEnergy()}
    """

    dimension = "energy"

    def evaluate(self, solution: Solution) -> float:
        return solution.energies["control"]


@dataclass(frozen=True)
class KineticEnergy(Quantity):
    """Kinetic energy of a motion, ``sum m v^2 / 2`` [energy], with that of rigid bodies.

    The sum contains prescribed particles, although they have no inertia: no support does the work that accelerates
    them, and ``ExternalWork`` does not contain it.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> history = {"kinetic": pd.KineticEnergy()}
    """

    dimension = "energy"

    def evaluate(self, solution: Solution) -> float:
        inertia_of(solution, self)
        return solution.energies["kinetic"]


@dataclass(frozen=True)
class EnergyError(Quantity):
    """Error of the energy balance of a motion over the largest energy so far [-]; 0 at its start by definition.

    It is the sum of kinetic energy, stored energy, and dissipation of damage and damping, minus its value at the start
    and the work of loads, supports and tools, or of a rigid body if that is larger: its kinetic energy minus that at
    the start and the work on it, over its largest. It is positive if energy was gained. The numerical damping of
    ``Implicit`` with a radius below 1 makes it negative. It is nan where not all energies are known: if bonds soften in
    a body with deformation gradients or fail with ``Implicit``, in bodies with temperature or eigenstrains, and for
    materials that depend on the rate.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> history = {"energy_error": pd.EnergyError()}
    """

    def evaluate(self, solution: Solution) -> float:
        inertia = inertia_of(solution, self)
        return inertia.error if inertia.judged else math.nan


def inertia_of(solution: Solution, quantity: object) -> Inertia:
    """Return the inertia of the body (not collective); raise CaseError if it has none."""
    inertia = solution.problem.inertia
    if inertia is None:
        raise CaseError(
            f"{type(quantity).__name__} needs a motion with inertia. Use solver=pd.Explicit(...) or pd.Implicit(...)."
        )
    return inertia


@dataclass(frozen=True)
class ExternalWork(Quantity):
    """Work of loads, supports and moving tools since the undeformed state [energy], by the trapezoidal rule over steps.

    That of a rigid body with mass in a motion is the work of its load. Prescribed particles have no inertia: the work
    of their supports does not contain the change of their ``KineticEnergy``. Along a path, the work includes all
    equilibria within a step while bonds break. With contact it differs from the change of the energies by up to the
    force times the ``penetration`` that the contact allows, since raised multipliers do work.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> history = {"work": pd.ExternalWork()}
    """

    dimension = "energy"
    of_path: ClassVar[bool] = True

    def evaluate(self, solution: Solution) -> float:
        return solution.work


@dataclass(frozen=True)
class DissipatedEnergy(Quantity):
    """Energy that the body has dissipated [energy].

    In bond-based bodies it is the energy dissipated by the damage laws, which does not depend on the steps; in elastic
    bodies without damage it is 0. In other bodies, and if a term of the case has a history, it is the external work
    minus the stored energy. This difference also contains the energy released by jumps within a load step and the error
    of the trapezoidal rule. If the material flows and bonds fail, the stored energy contains the plastic work: the
    difference is the dissipation of failing bonds.

    Raises
    ------
    CaseError
        At the start of the run: the material flows or relaxes and no bonds fail, so that the stored energy contains the
        dissipation; or a body with thermal strain or eigenstrain has no laws that define the energy.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> history = {"work": pd.ExternalWork(), "dissipated": pd.DissipatedEnergy()}
    """

    dimension = "energy"
    of_path: ClassVar[bool] = True

    def evaluate(self, solution: Solution) -> float:
        problem = solution.problem
        known = problem.material_term.dissipated_energy()
        whole = problem.damage is not None and problem.bond_damage is None
        others = not whole and any(term.has_history for term in problem.terms if term is not problem.material_term)
        if (known is None or others) and problem.body.expansion is not None:
            raise CaseError(
                "The energy that this body dissipates is not the external work less the stored energy: strains without "
                "stress store energy too; leave DissipatedEnergy out."
            )
        if problem.damage is None and problem.material_term.has_history:
            raise CaseError(
                "The strain energy of a material that flows or relaxes contains what it has lost, so that the external "
                "work less the stored energy is not what this body dissipates; leave DissipatedEnergy out and look at "
                "StrainEnergy."
            )
        return solution.work - sum(solution.energies.values()) if known is None or others else known


@dataclass(frozen=True)
class CrackTip(Quantity):
    """Position of a crack tip: the largest coordinate along a direction among the cracked particles [length].

    Parameters
    ----------
    direction : tuple of float
        Direction of crack growth, of any length.
    damage : float
        Local damage above which a particle is cracked [-]; beside a straight crack it is about a third.
    region : Region
        Region of the crack.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> tip = pd.CrackTip(direction=(1.0, 0.0), region=pd.region.Slab("y", low=4.0, high=6.0))
    """

    dimension = "length"

    direction: tuple[float, ...]
    damage: float = 0.3
    region: Region = EVERYWHERE

    def __post_init__(self) -> None:
        super().__post_init__()
        size = np.linalg.norm(np.asarray(self.direction, dtype=float))
        if not (np.isfinite(size) and size > 0.0):
            raise CaseError(f"A CrackTip needs a direction that is not zero, not {self.direction}.")

    def check(self, dim: int) -> None:
        """Raise CaseError if the direction or the region does not fit a body of ``dim`` dimensions."""
        if len(self.direction) != dim:
            raise CaseError(f"The direction of a CrackTip has {dim} numbers, not {self.direction}.")
        self.region.check(dim)

    def evaluate(self, solution: Solution) -> float:
        """Return the coordinate [length]; the smallest one of the whole body if no particle is cracked."""
        self.check(solution.x.shape[1])
        along, behind = self._along(solution)
        cracked = solution.select(self.region) & (local_damage(solution) > self.damage)
        return max(solution.largest(along[cracked]), behind)

    @property
    def axis(self) -> Float:
        """Return the unit vector of the direction (dim,) [-]."""
        axis = np.asarray(self.direction, dtype=float)
        return np.asarray(axis / np.linalg.norm(axis))

    def _along(self, solution: Solution) -> tuple[Float, float]:
        """Return the coordinates of the own particles (n_owned,) and the smallest one of the body [length]."""
        along = solution.x @ self.axis
        return along, solution.smallest(along)


@dataclass(frozen=True)
class CrackSpeed(CrackTip):
    """Mean speed of a crack tip since the last record of a motion [length / time]; 0 until a crack grows.

    It is the change of ``CrackTip`` over that of the time. The tip moves by whole particles: records should be some ten
    spacings of advance apart. After a restart the first speed is 0.

    Parameters
    ----------
    direction, damage, region
        As for ``CrackTip``.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> speed = pd.CrackSpeed((1.0, 0.0))
    """

    dimension = ""

    def __post_init__(self) -> None:
        super().__post_init__()
        # Place, time and speed at the last record.
        object.__setattr__(self, "_last", [])

    def evaluate(self, solution: Solution) -> float:
        inertia_of(solution, self)
        last: list[float] = vars(self)["_last"]
        place, time = super().evaluate(solution), solution.state.clock.time
        if last and time == last[1]:  # asked again
            return last[2]
        grown = bool(last) and time > last[1] and last[0] > self._along(solution)[1]
        speed = (place - last[0]) / (time - last[1]) if grown else 0.0
        last[:] = [place, time, speed]
        return speed


@dataclass(frozen=True)
class BrokenBonds(Quantity):
    """Number of broken bonds, each pair of particles counted once, without bonds cut by a pre-crack.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> history = {"broken": pd.BrokenBonds()}
    """

    def evaluate(self, solution: Solution) -> float:
        return float(solution.broken_bonds)


@dataclass(frozen=True)
class Largest(_OfField):
    """Largest value of a field component over a region.

    Parameters
    ----------
    field, component, region
        As for ``Mean``.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> peak = pd.Largest(pd.stress, "yy", pd.region.Sphere((5.0, 2.0), radius=1.5))
    """

    def evaluate(self, solution: Solution) -> float:
        return solution.largest(self._chosen(solution))


@dataclass(frozen=True)
class Smallest(_OfField):
    """Smallest value of a field component over a region, such as the largest compression.

    Parameters
    ----------
    field, component, region
        As for ``Mean``.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> compression = pd.Smallest(pd.stress, "yy", "-y")
    """

    def evaluate(self, solution: Solution) -> float:
        return solution.smallest(self._chosen(solution))


@dataclass(frozen=True)
class OnSurface(_OfField):
    """A field component on facets of the surface: their mean by area, or the largest or smallest value.

    Particles are half a cell inside the body, and gradients next to the surface have an error of a share of a spacing
    times the next derivative. Stress and other fields of gradients are therefore extrapolated linearly from particles
    without facets around the particle behind a facet. Linear fields are exact, others converge with first order or
    better. Refine if curvature over two horizons matters, as at small holes. Displacements, reactions, damage and lost
    bonds are interpolated, ``sum_k N_f(x_k) v_k`` with the linear-exact weights of the facets. So are all fields in
    thin bodies, with at most one layer of particles without facets.

    Parameters
    ----------
    field, component
        As for ``Mean``.
    region : Region
        The facets in the region, or their tag.
    take : {"mean", "largest", "smallest"}
        The mean by area, or the largest or smallest value.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> at_the_hole = pd.OnSurface(pd.stress, "yy", pd.region.Sphere((0.0, 0.0), radius=1.01), take="largest")
    """

    take: Literal["mean", "largest", "smallest"] = "mean"

    on_surface: ClassVar[bool] = True

    def on_facets(self, solution: Solution) -> tuple[Float, Float, Float]:
        """Return centroids (n, dim) [length] and vector areas (n, dim) of local facets, and the field there.

        Collective.
        """
        body = solution.problem.body
        cloud, surface = body.cloud, body.known_surface
        values = _component_of(solution, self.field, self.component)
        sign, known = None, _known(self.field)
        if len(cloud.sign) and not (known is not None and known.principal):
            # A component along the normal of a mirror plane changes its sign in the image.
            sign = cloud.sign[:, ["xyz".index(letter) for letter in self.component]].prod(axis=1)
        if known is None or known.of_gradients:
            found = surface.extrapolated(cloud, body.families, values, sign)
        else:
            local = solution.with_ghosts(values)
            if sign is not None:
                local[cloud.n_owned :] *= sign
            found = surface.interpolated(local)
        chosen = surface.select(cloud, self.region, "an OnSurface")
        return surface.x[chosen], surface.area[chosen], found[chosen]

    def evaluate(self, solution: Solution) -> float:
        _, area, found = self.on_facets(solution)
        if self.take == "largest":
            return solution.largest(found)
        if self.take == "smallest":
            return solution.smallest(found)
        size = np.linalg.norm(area, axis=1)
        moment, whole = solution.sum([size @ found, size.sum()])
        return float(moment / whole)


@dataclass(frozen=True)
class _Against(Quantity):
    """A quantity of the difference between a field and a reference function of position over a region."""

    field: Field
    reference: Callable[[Float, float], Float]
    region: Region = EVERYWHERE

    def check(self, dim: int) -> None:
        """Raise CaseError if the region does not fit a body of ``dim`` dimensions."""
        self.region.check(dim)


@dataclass(frozen=True)
class RelativeError(_Against):
    """Volume-weighted mean of ``|a - b| / |b|`` between a field and a reference function of position.

    Parameters
    ----------
    field : Field
        The field to compare.
    reference : callable
        ``reference(x, t)`` with (n, dim) positions returns values in the shape of the field.
    region : Region
        The particles; those with zero reference are excluded. NaN if the reference is zero everywhere.

    References
    ----------
    Hashim, Eq. (56).

    Examples
    --------
    >>> import pdpetsc as pd
    >>> error = pd.RelativeError(pd.displacement, lambda x, t: 0.01 * t * x)
    """

    def evaluate(self, solution: Solution) -> float:
        mask = solution.select(self.region)
        found = _values(solution, self.field)[mask]
        width = math.prod(found.shape[1:])
        exact = _reference(solution, self.reference, mask, found.shape).reshape(len(found), width)
        found = found.reshape(exact.shape)
        size = np.linalg.norm(exact, axis=1)
        weight = np.where(size > 0.0, solution.volume[mask], 0.0)
        error = np.linalg.norm(found - exact, axis=1) / np.where(size > 0.0, size, 1.0)
        moment, volume = solution.sum([weight @ error, weight.sum()])
        # The reference of a body at rest is often zero everywhere.
        return float(moment / volume) if volume > 0.0 else math.nan


@dataclass(frozen=True)
class LargestError(_Against):
    """Largest entry of ``|a - b|`` between a field and a reference function of position, over a region.

    Parameters
    ----------
    field, reference, region
        As for ``RelativeError``; particles with zero reference are included.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> error = pd.LargestError(pd.displacement, lambda x, t: 0.01 * t * x)
    """

    @property
    def dimension(self) -> str:
        return dimension_of(self.field)

    def evaluate(self, solution: Solution) -> float:
        mask = solution.select(self.region)
        found = _values(solution, self.field)[mask]
        difference = np.abs(found - _reference(solution, self.reference, mask, found.shape))
        return solution.largest(difference, 0.0)


def _reference(
    solution: Solution, function: Callable[[Float, float], Float], mask: Mask, shape: tuple[int, ...]
) -> Float:
    """Return the values of a reference function in the shape of the field for particles of a mask (collective)."""
    with agreed(solution.cloud.comm):
        if not mask.any():
            return np.zeros(shape)
        values = numbers_from("reference", function, solution.x[mask], solution.t)
        try:
            return values.reshape(shape) if values.size == math.prod(shape) else np.broadcast_to(values, shape)
        except ValueError:
            raise CaseError(
                f"The reference {name_of(function)} must return values of the shape of the field, {shape}, "
                f"not {values.shape}."
            ) from None


def _values(solution: Solution, field: Field) -> Float:
    """Return a field: one value, vector or tensor per owned particle on every rank (collective)."""
    values = field(solution)
    with agreed(solution.cloud.comm):
        return np.asarray(rows_of_field(field, values, len(solution.x)), dtype=float)


def _component_of(solution: Solution, field: Field, name: str) -> Float:
    """Return a component of a field (collective)."""
    values = _values(solution, field)
    with agreed(solution.cloud.comm):
        return component(values, name)


def dimension_of(field: Field) -> str:
    """Return the dimension of a field for ``Units.of``; empty for pure numbers and unknown dimensions."""
    known = _known(getattr(field, "__wrapped__", field))
    return "" if known is None else known.dimension


def refuse_component(declared: object, field: Field, component: str, dim: int | None = None) -> None:
    """Raise CaseError if the field of a declared object lacks the component in ``dim`` dimensions, None if unknown."""
    known = _known(field)
    # Components of fields of the user are checked at evaluation.
    wanted = min(len(component), 2) if known is None else known.letters
    letters = "xyz" if known is not None and known.principal else "xyz"[:dim]
    if len(component) == wanted and set(component) <= set(letters):
        return
    number = ["no letter", f"one of {', '.join(letters)}", f"two of {', '.join(letters)}"][wanted]
    if known is None:
        number = f"no, one or two of {', '.join(letters)}"
    kind = type(declared).__name__
    who = f"{'An' if kind[0] in 'AEIOU' else 'A'} {kind}"
    where = "" if dim is None else f" in {dim}D"
    raise CaseError(f"{who} of {name_of(field)}{where} requires {number} as component, not {component!r}.")


def _axes(solution: Solution, name: str) -> tuple[int, int]:
    """Return the pair of directions of a component of the cell."""
    images = solution.cloud.images
    if images is None:
        raise CaseError("The mean strain and stress are those of a periodic cell; give the Case a cell.")
    letters = ["xyz"[a] + "xyz"[b] for a, b in images.cell.components]
    if name not in letters:
        raise CaseError(f"The periodic cell has the components {', '.join(letters)}, not {name!r}.")
    return images.cell.components[letters.index(name)]


def component(values: Float, name: str) -> Float:
    """Return one component of a field: ``""`` of a scalar, ``"x"`` of a vector, ``"xy"`` of a tensor."""
    axes = ["xyz".find(letter) for letter in name]
    if len(axes) != values.ndim - 1 or any(not 0 <= a < values.shape[1] for a in axes):
        dim = values.shape[-1] if values.ndim > 1 else 0
        raise CaseError(f"A field of rank {values.ndim - 1} in {dim} dimensions has no component {name!r}.")
    index: tuple[slice | int, ...] = (slice(None), *axes)
    return np.asarray(values[index])
