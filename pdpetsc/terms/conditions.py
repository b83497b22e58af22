"""Supports and loads of a body from the conditions of a case."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, Mask, starts_of
from pdpetsc.damage.state import FailingBonds
from pdpetsc.declare.bodies import Bodies
from pdpetsc.declare.body_contact import BodyContact, ParticleContact, Tied
from pdpetsc.declare.conditions import (
    BodyForce,
    Centrifugal,
    Condition,
    CrackPressure,
    Displacement,
    DrivenMotion,
    FollowerPressure,
    Force,
    InitialVelocity,
    MeanStrain,
    MeanStress,
    SurfacePressure,
    Traction,
    Value,
    VectorCondition,
    condition_name,
)
from pdpetsc.declare.damping import AbsorbingBoundary, BulkViscosity, RayleighDamping
from pdpetsc.declare.motion import RigidMotion
from pdpetsc.declare.particles import Lattice, Particles
from pdpetsc.declare.region import Face, Region
from pdpetsc.declare.supports import Foundation, PointSupport, RigidRegion
from pdpetsc.declare.thermal import Convection, Eigenstrain, HeatFlux, HeatSource, Temperature
from pdpetsc.declare.tools import Contact, RigidTool
from pdpetsc.discrete.communicator import agreed, anywhere, largest
from pdpetsc.discrete.selection import select
from pdpetsc.errors import CaseError, case_errors
from pdpetsc.problem.body import Body
from pdpetsc.problem.cell import CellRows
from pdpetsc.problem.material_term import MaterialTerm
from pdpetsc.problem.rigid_body import RigidBody
from pdpetsc.problem.scales import mean_spacing
from pdpetsc.problem.supports import Supports
from pdpetsc.problem.term import Term
from pdpetsc.problem.ties import Combination
from pdpetsc.terms.body_contact import BodyContactForces
from pdpetsc.terms.centrifugal import CentrifugalForce
from pdpetsc.terms.chosen_facets import ChosenFacets
from pdpetsc.terms.contact import ContactForces
from pdpetsc.terms.crack_pressure import CrackPressureLoad
from pdpetsc.terms.dead_loads import DeadLoads
from pdpetsc.terms.degraded_points import DegradedPoints
from pdpetsc.terms.facet_contact import STIFFNESS, FixedPoints
from pdpetsc.terms.follower_pressure import PressureOnDeformed
from pdpetsc.terms.loaded_region import LoadedRegion
from pdpetsc.terms.particle_contact import ParticleContactForces
from pdpetsc.terms.point_springs import FoundationForces
from pdpetsc.terms.surface_loads import SurfaceLoads
from pdpetsc.terms.tied import TIED, TiedForces


class Applied:
    """Collect supports and loads of a body from its conditions, each of which calls the method of its kind.

    Parameters
    ----------
    body, matter, particles
        As for ``DeadLoads``.
    times : sequence of float
        Load parameters that the run reaches exactly [-].
    density : (n_owned,) float64, optional
        Density of the own particles, if all materials have one [mass / volume].
    bonds : FailingBonds, optional
        Which bonds are intact, if bonds fail.
    duration : float
        Physical time from load parameter 0 to 1 [time].

    Attributes
    ----------
    supports : Supports
        Prescribed unknowns.
    loads : DeadLoads
        External forces.
    ties : list of (str, TiedForces)
        Ties, with their names.
    """

    def __init__(
        self, body: Body, material_term: MaterialTerm, particles: Particles, times: Sequence[float] = (1.0,),
        density: Float | None = None, bonds: FailingBonds | None = None, duration: float = 1.0,
    ) -> None:  # fmt: skip
        self.body = body
        self.particles = particles
        self.times = times
        self.cell = None if body.cloud.images is None else CellRows(body.cloud, particles.thickness)
        self.supports = Supports(body, self.cell)
        self.loads = DeadLoads(body, material_term, particles, self.cell)
        self.surface_loads = SurfaceLoads(body)
        # Forces that depend on the displacement.
        self.following: list[Term] = []
        self._density, self._bonds, self._duration = density, bonds, duration
        # Name of a condition that prescribes velocities or accelerations, an empty name without one.
        self._driven = ""
        # Initial velocities of the own particles, None for a body at rest.
        self.velocity: Float | None = None
        # Damping of a motion: rate of each own particle, stiffness of the body, and facets that absorb.
        self.damping_rate: Float | None = None
        self.damping_time = 0.0
        self.absorbing: Mask | None = None
        self.viscosity: BulkViscosity | None = None
        self._contacts: set[str] = set()
        self._pairs: list[tuple[str, BodyContact | Tied, Mask, Mask]] = []
        self.ties: list[tuple[str, TiedForces]] = []
        self._loaded_tools: list[RigidTool] = []
        self._material_term = material_term
        self._of_cell: set[int] = set()
        self.temperatures: list[tuple[str, Temperature, Mask]] = []
        self.eigenstrains: list[tuple[str, Eigenstrain, Mask]] = []
        self.heat: list[tuple[str, HeatFlux | HeatSource | Convection, Mask]] = []

    @property
    def terms(self) -> list[Term]:
        """Return the loads."""
        loads = [self.loads, self.surface_loads] if self.body.surface is not None else [self.loads]
        return [*loads, *self.following]

    @property
    def _periodic(self) -> list[int]:
        """Return the periodic axes."""
        return [] if self.body.cloud.images is None else self.body.cloud.images.cell.periodic

    def displacement(self, condition: Displacement, name: str) -> None:
        """Prescribe displacements."""
        mask, components = self._where(condition, name)
        self.supports.prescribe(condition, components, np.flatnonzero(mask), name)

    def rigid_region(self, condition: RigidRegion, region: Region, name: str) -> None:
        """Prescribe the displacements of a rigid region, whose motion may follow from a load."""
        cloud = self.body.cloud
        with agreed(cloud.comm):
            condition.check(cloud.dim)
        self._refuse_across_mirrors(condition, name)
        own = np.flatnonzero(select(cloud, region, name)).astype(np.int32)
        rows = np.zeros(cloud.n_rows, dtype=bool)
        rows[own] = True
        layers = isinstance(self.particles, Lattice) and isinstance(condition.region, Face)
        rigid = RigidBody(condition, cloud.comm, cloud.dim, own, f"The region of {name}", rows, layers)

        def component(axis: int) -> Callable[[Float, float], Float]:
            return lambda x, t: rigid.absolute(x, np.zeros_like(x), t)[:, axis]

        x, y, z = (component(axis) if axis < cloud.dim else None for axis in range(3))
        self.displacement(Displacement(region, x, y, z), name)
        if condition.loaded:
            self.following.append(LoadedRegion(rigid, own))

    def _refuse_across_mirrors(self, declared: RigidMotion, name: str) -> None:
        """Raise CaseError if a rigid body next to a mirror plane may move as its image does not."""
        planes, free = list(self.body.cloud.places.planes), declared.free(self.body.dim)
        across = ["xyz"[axis] for axis in planes if free[axis]]
        if across:
            raise CaseError(
                f"{name} has a force in {across[0]}, across a mirror plane, where its image has the opposite one. Give "
                f"None there, and else the share of the part that is computed."
            )
        if planes and declared.twisted:
            raise CaseError(f"{name} has a moment, and its image in a mirror plane the opposite one. Leave it out.")

    def initial_velocity(self, condition: InitialVelocity, name: str) -> None:
        """Set initial velocities."""
        mask, components = self._where(condition, name)
        cloud, own = self.body.cloud, np.flatnonzero(mask)
        if self.velocity is None:
            self.velocity = np.zeros((cloud.n_owned, cloud.dim))
        with agreed(cloud.comm):
            for axis, value in components:
                found = value if callable(value) else (lambda x, t, value=value: np.full(len(x), value))
                self.velocity[own, axis] = condition.value(found, cloud.x[own], 0.0)

    def driven_motion(self, condition: DrivenMotion, name: str) -> None:
        """Prescribe the displacements that belong to velocities or accelerations."""
        mask, components = self._where(condition, name)
        moved = [(axis, condition.moved(value, self._duration)) for axis, value in components]
        x, y, z = (dict(moved).get(axis) for axis in range(3))
        self.supports.prescribe(Displacement(condition.region, x, y, z), moved, np.flatnonzero(mask), name)
        self._driven = type(condition).__name__

    def rayleigh_damping(self, condition: RayleighDamping, name: str) -> None:
        """Add damping."""
        mask = select(self.body.cloud, condition.region, name)
        rate = np.zeros(len(mask)) if self.damping_rate is None else self.damping_rate
        self.damping_rate = rate + condition.mass * mask
        self.damping_time += condition.stiffness

    def bulk_viscosity(self, condition: BulkViscosity, name: str) -> None:
        """Store the viscosity of shocks."""
        if self.viscosity is not None:
            raise CaseError(f"{name} is a second BulkViscosity. Leave one out.")
        self.viscosity = condition

    def absorbing_boundary(self, condition: AbsorbingBoundary, name: str) -> None:
        """Add dashpots on facets."""
        mask = self._facets(condition.region, name)
        self.absorbing = mask if self.absorbing is None else mask | self.absorbing

    @property
    def moves(self) -> str:
        """Return the name of a condition that sets the body in motion; an empty name if none does (not collective)."""
        if self.velocity is not None:
            return "InitialVelocity"
        return self._driven

    @property
    def damps(self) -> str:
        """Return the name of a condition that damps a motion, an empty name without one (not collective)."""
        if self.damping_rate is not None:
            return "RayleighDamping"
        if self.viscosity is not None:
            return "BulkViscosity"
        return "" if self.absorbing is None else "AbsorbingBoundary"

    def mean_displacement(self, condition: PointSupport, name: str) -> None:
        """Prescribe the mean displacement of a patch: one of its particles is tied to the others."""
        mask, components = self._where(condition, name)
        cloud = self.body.cloud
        own = np.flatnonzero(mask)
        parts = cloud.comm.allgather((cloud.gid[own], cloud.row[own], cloud.x[own], cloud.volume[own]))
        gid, row, x, volume = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
        # In an order that ranks do not change; the tied particle has the largest volume, so that no sum is amplified.
        order = np.argsort(gid)
        gid, row, x, volume = gid[order], row[order], x[order], volume[order]
        tied = int(np.argmax(volume))
        others = np.arange(len(gid)) != tied
        middle = (volume @ x / volume.sum())[None]
        axes = np.array([axis for axis, _ in components] if gid[tied] in cloud.gid[own] else [], dtype=np.int32)
        n, each = len(axes), int(others.sum())
        combination = Combination(
            np.repeat(own[cloud.gid[own] == gid[tied]], n).astype(np.int32), axes,
            each * np.arange(n + 1, dtype=np.int64), np.tile(row[others], n), np.repeat(axes, each),
            np.tile(-volume[others] / volume[tied], n),
        )  # fmt: skip

        def values(t: float) -> Float:
            means = [condition.value(value, middle, t)[0] for _, value in components][:n]
            return np.asarray(np.array(means) * volume.sum() / volume[tied])

        self.supports.tie(combination, values, name)

    def roller(self, region: Region, normals: Callable[[Float], Float], name: str) -> None:
        """Prescribe ``n . u = 0``: components along an axis, and ties for normals between the axes.

        The component along the axis closest to the normal is tied to the others.
        """
        cloud = self.body.cloud
        own = np.flatnonzero(select(cloud, region, name)).astype(np.int32)
        with agreed(cloud.comm):
            n = normals(cloud.x[own])
        axis = np.argmax(np.abs(n), axis=1).astype(np.int32)
        ratio = -n / np.take_along_axis(n, axis[:, None], axis=1)
        ratio[np.arange(len(own)), axis] = 0.0
        inclined = ratio.any(axis=1)
        for along in range(cloud.dim):
            held = np.flatnonzero(~inclined & (axis == along))
            if anywhere(cloud.comm, len(held)):
                x, y, z = (0.0 if a == along else None for a in range(3))
                self.supports.prescribe(Displacement(region, x, y, z), [(along, 0.0)], own[held].astype(np.int64), name)
        if not anywhere(cloud.comm, inclined):
            return
        tied, (row, other) = np.flatnonzero(inclined), np.nonzero(ratio[inclined])
        ptr = starts_of(np.bincount(row, minlength=len(tied)))
        combination = Combination(
            own[tied], axis[tied], ptr, cloud.row[own[tied]][row], other.astype(np.int32), ratio[inclined][row, other]
        )
        self.supports.tie(combination, lambda t: np.zeros(len(tied)), name)

    def force(self, condition: Force, name: str) -> None:
        """Add a total force."""
        mask, components = self._where(condition, name)
        self.loads.add_total(condition, components, np.flatnonzero(mask), name)

    def body_force(self, condition: BodyForce, name: str) -> None:
        """Add a force per volume."""
        mask, components = self._where(condition, name)
        self.loads.add_per_volume(condition, components, np.flatnonzero(mask), name)

    def centrifugal(self, condition: Centrifugal, name: str) -> None:
        """Add a centrifugal force."""
        cloud = self.body.cloud
        if self._density is None:
            raise CaseError(f"{name} needs the density of each material.")
        along = np.flatnonzero(condition.axis).tolist() if cloud.dim == 3 else []
        across = ["xyz"[a] for a in self._periodic if along != [a]]
        if across:
            raise CaseError(
                f"{name} grows with the distance from its axis, and the cell is periodic along {across[0]}. Leave out "
                f"the cell, or make it periodic along the axis of rotation only."
            )
        chosen = select(cloud, condition.region, name)
        mass = np.where(chosen, self._density * cloud.volume[: cloud.n_owned], 0.0)
        self.following.append(CentrifugalForce(self.body, condition, mass, name))

    def traction(self, condition: Traction, name: str) -> None:
        """Add a traction."""
        mask, components = self._where(condition, name)
        with agreed(self.body.cloud.comm):
            normal = condition.unit_normal(self.body.dim)
        self.loads.add_traction(condition, components, mask, normal, name)

    def surface_traction(self, condition: Traction, name: str) -> None:
        """Add a traction on facets."""
        self.surface_loads.add_traction(condition, name)

    def surface_pressure(self, condition: SurfacePressure, name: str) -> None:
        """Add a pressure on facets."""
        self.surface_loads.add_pressure(condition, name)

    def follower_pressure(self, condition: FollowerPressure, name: str) -> None:
        """Add a pressure on the deformed surface."""
        self.following.append(PressureOnDeformed(self.body, condition, name))

    def crack_pressure(self, condition: CrackPressure, name: str) -> None:
        """Add a pressure on the faces of cracks."""
        if not isinstance(self._material_term, DegradedPoints):
            raise CaseError(f"{name} acts on failed gradient points. Declare damage by PointDamage.")
        mask = select(self.body.cloud, condition.region, name)
        self.following.append(CrackPressureLoad(self._material_term, condition, mask, name))

    def contact(self, condition: Contact, name: str) -> None:
        """Add the contact with a tool."""
        cloud = self.body.cloud
        with agreed(cloud.comm):
            condition.tool.check(cloud.dim)
        self._refuse_across_mirrors(condition.tool, name)
        self._refuse_without_images(condition.tool, name)
        if condition.tool.loaded:
            if any(condition.tool is one for one in self._loaded_tools):
                raise CaseError(
                    f"{name} has the loaded tool of another Contact, and would give it a motion of its own. Use one "
                    f'Contact of both regions: pd.region.Face("+x") | pd.region.Face("+y").'
                )
            self._loaded_tools.append(condition.tool)
        mask = self._facets(condition.region, name)
        self._take_name(condition.name)
        stiffness, spacing = self._contact_stiffness(condition, mask)
        self.following.append(ContactForces(self.body, condition, mask, stiffness, spacing, name))

    def _refuse_without_images(self, tool: RigidTool, name: str) -> None:
        """Raise CaseError if a tool is not the same in all periods of a cell: it has no images."""
        turn, title = np.ravel(tool.turn), type(tool).__name__
        for axis in self._periodic:
            letter = "xyz"[axis]
            if not tool.uniform_along(axis):
                raise CaseError(
                    f"The {title} of {name} changes along {letter}, in which the cell is periodic, and has no images. "
                    f"Use a RigidPlane with a normal across {letter}, or leave out the cell."
                )
            if tool.twisted or (np.any(turn) and (len(turn) < 3 or np.any(np.delete(turn, axis)))):
                raise CaseError(
                    f"The {title} of {name} turns, and the cell is periodic along {letter}. Leave out the rotation."
                )

    def body_contact(self, condition: BodyContact, name: str) -> None:
        """Add the contact of two parts of the surface."""
        one, other, stiffness, spacing = self._two_parts(condition, name)
        bodies = list(self.particles.parts) if isinstance(self.particles, Bodies) else []
        self.following.append(BodyContactForces(self.body, condition, one, other, stiffness, spacing, name, bodies))

    def tied(self, condition: Tied, name: str) -> None:
        """Tie two parts of the surface."""
        one, other, stiffness, spacing = self._two_parts(condition, name)
        if condition.stiffness is None:
            stiffness *= TIED
        found = TiedForces(self.body, condition, one, other, stiffness, spacing, name)
        self.ties.append((name, found))
        self.following.append(found)

    def foundation(self, condition: Foundation, name: str) -> None:
        """Add springs on facets."""
        facets = ChosenFacets(self.body.known_surface, self._facets(condition.region, name))
        self._take_name(condition.name)
        points = FixedPoints.on(facets)
        normals = facets.area / points.area[:, None]
        self.following.append(
            FoundationForces(self.body, points, normals, condition.normal, condition.tangential, condition.name)
        )

    def _two_parts(self, condition: BodyContact | Tied, name: str) -> tuple[Mask, Mask, float, float]:
        """Return the facets of two parts of the surface, the stiffness between them and the coarser spacing."""
        if self.cell is not None:
            raise CaseError(f"{name} cannot act in a periodic cell; leave out the cell.")
        one, other = (self._facets(region, name) for region in (condition.region, condition.other))
        self._take_name(condition.name)
        for earlier, kind, first, second in self._pairs:
            same = (one & first, other & second), (one & second, other & first)
            if type(kind) is type(condition) and any(
                anywhere(self.body.cloud.comm, a) and anywhere(self.body.cloud.comm, b) for a, b in same
            ):
                raise CaseError(
                    f"{name} acts between facets between which {earlier} acts already. Leave one out, or give each "
                    f"facets of its own."
                )
        self._pairs.append((name, condition, one, other))
        found = [self._contact_stiffness(condition, mask) for mask in (one, other)]
        return one, other, min(stiffness for stiffness, _ in found), max(spacing for _, spacing in found)

    def particle_contact(self, condition: ParticleContact, name: str) -> None:
        """Add the repulsion of particles without a bond."""
        cloud = self.body.cloud
        if cloud.images is not None or len(cloud.sign):
            raise CaseError(f"{name} does not act on images. Leave out the cell and mirror planes.")
        mask = select(cloud, condition.region, name)
        self._take_name(condition.name)
        spacing, stiffness = mean_spacing(self.body, mask), condition.stiffness
        if stiffness is None:
            stiffness = self._modulus(np.flatnonzero(mask), friction=False) / spacing
        distance = spacing if condition.distance is None else condition.distance
        self.following.append(
            ParticleContactForces(self.body, mask, distance, stiffness, spacing, self._bonds, name, condition.name)
        )

    def _take_name(self, name: str) -> None:
        """Raise CaseError if a contact, tie or foundation has this name already: it is the prefix of columns."""
        if name in self._contacts:
            raise CaseError(f"Two conditions are named {name!r}; give each a name.")
        self._contacts.add(name)

    def _contact_stiffness(self, condition: Contact | BodyContact | Tied, mask: Mask) -> tuple[float, float]:
        """Return the stiffness of a contact of facets [stress / length], and the mean spacing there [length]."""
        owner = self.body.known_surface.owner[mask]
        spacing = mean_spacing(self.body, owner)
        if condition.stiffness is not None:
            return condition.stiffness, spacing
        friction = not isinstance(condition, Tied) and condition.friction > 0.0
        return STIFFNESS * self._modulus(owner, friction) / spacing, spacing

    def _modulus(self, particles: LocalIndex | GlobalIndex, friction: bool) -> float:
        """Return the modulus of the stiffest of some particles; of the body if none has a gradient point [stress]."""
        comm, term = self.body.cloud.comm, self._material_term
        return largest(comm, term.contact_modulus(particles, friction)) or largest(comm, term.kappa)

    def mean_strain(self, condition: MeanStrain, name: str) -> None:
        """Prescribe components of the mean strain of the cell."""
        self.supports.prescribe_strain(condition, self._components(condition, name))

    def mean_stress(self, condition: MeanStress, name: str) -> None:
        """Apply a mean stress to the cell."""
        self.loads.add_stress(condition, self._components(condition, name))

    def temperature(self, condition: Temperature, name: str) -> None:
        """Store a prescribed temperature."""
        self.temperatures.append((name, condition, select(self.body.cloud, condition.region, name)))

    def eigenstrain(self, condition: Eigenstrain, name: str) -> None:
        """Store an eigenstrain."""
        with agreed(self.body.cloud.comm):
            condition.refuse_beyond(self.body.dim, name)
        self.eigenstrains.append((name, condition, select(self.body.cloud, condition.region, name)))

    def heat_source(self, condition: HeatSource, name: str) -> None:
        """Store a heat source in particles."""
        self.heat.append((name, condition, select(self.body.cloud, condition.region, name)))

    def heat_flux(self, condition: HeatFlux | Convection, name: str) -> None:
        """Store a heat flux through facets, given or by convection."""
        self.heat.append((name, condition, self._facets(condition.region, name)))

    def _where(self, condition: VectorCondition, name: str) -> tuple[Mask, list[tuple[int, Value]]]:
        """Return own particles in the region of a condition, and its components, checked on all ranks (collective)."""
        mask = select(self.body.cloud, condition.region, name)
        with agreed(self.body.cloud.comm):
            return mask, condition.components(self.body.dim)

    def _facets(self, region: Region, name: str) -> Mask:
        """Return the facets of the surface in a region (collective)."""
        return self.body.known_surface.select(self.body.cloud, region, name)

    def _components(self, condition: MeanStrain | MeanStress, name: str) -> list[tuple[int, float]]:
        if self.cell is None:
            raise CaseError(f"{name} needs a periodic cell; give the Case a cell.")
        found = condition.components(self.cell.components)
        for unknown, _ in found:
            if unknown in self._of_cell:
                a, b = self.cell.components[unknown]
                raise CaseError(
                    f"{name} gives {'xyz'[a]}{'xyz'[b]} of the cell a second time; let it have one condition."
                )
            self._of_cell.add(unknown)
        return found


def apply(
    body: Body, material_term: MaterialTerm, conditions: Sequence[Condition], particles: Particles,
    times: Sequence[float] = (1.0,), density: Float | None = None, bonds: FailingBonds | None = None,
    duration: float = 1.0,
) -> Applied:  # fmt: skip
    """Build supports, loads and other prescribed quantities from conditions (collective).

    Parameters
    ----------
    body, matter, particles
        As for ``Applied``.
    conditions : sequence of Condition
        Conditions of the case.
    times : sequence of float
        Load parameters at which conditions that hold the same particle must agree [-].
    density, bonds, duration
        As for ``Applied``.

    Raises
    ------
    CaseError
        A region selects nothing, two conditions prescribe different values of the same particle, or a component is
        wrong. Or a traction acts on a face of unknown area.
    """
    onto = Applied(body, material_term, particles, times, density, bonds, duration)
    for number, condition in enumerate(conditions, 1):
        condition.put(onto, condition_name(condition, number))
    onto.supports.refuse_held_across()
    with case_errors():
        for t in times if onto.supports.given.shared else (1.0,):
            onto.supports.prescribed(t)
        onto.loads.forces(1.0)
        if body.surface is not None:
            onto.surface_loads.forces(1.0)
        for name, tie in onto.ties:
            tie.refuse_held_apart(onto.supports, times, name)
    return onto
