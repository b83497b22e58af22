"""Construction of the distributed problem of a case."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import cast

import numpy as np

from pdpetsc.arrays import Float, LocalIndex, Mask
from pdpetsc.bond_based import BondBased, BondMaterial, Neighbourhood, combine
from pdpetsc.case import AnyMaterial, Case, isothermal, ungraded
from pdpetsc.control.base import Control, Stiffness, ZeroEnergyControl
from pdpetsc.control.lattice_control import LatticeControl, of_irregular, relative_scale
from pdpetsc.control.non_uniform import NonUniform
from pdpetsc.damage import BondDamage, DamageOf, PointDamage
from pdpetsc.damage.criterion import DamageableBonds
from pdpetsc.damage.laws import Marking
from pdpetsc.damage.point_damage import AssignedPointDamage
from pdpetsc.declare.body_contact import TwoParts
from pdpetsc.declare.horizon import LEAST_RATIO, horizons_of
from pdpetsc.declare.influence import evaluate
from pdpetsc.declare.particles import Arrays, Chunk
from pdpetsc.declare.region import All, Region
from pdpetsc.declare.solvers import Explicit, SnapThrough
from pdpetsc.declare.surface import Facets
from pdpetsc.declare.thermal import Eigenstrain
from pdpetsc.declared import called, numbers_from
from pdpetsc.discrete.cloud import HORIZON_TOLERANCE, Cloud, distribute
from pdpetsc.discrete.communicator import (
    Comm,
    agreed,
    alone,
    anywhere,
    bounds,
    count_nonzero,
    is_root,
    largest,
    offset,
    smallest,
    total,
)
from pdpetsc.discrete.crack_images import images_of_case
from pdpetsc.discrete.families import Families, find_families
from pdpetsc.discrete.lattice_stencils import LatticeStencils, positions_on_lattice
from pdpetsc.discrete.memory import (
    PER_BOND,
    PER_IMAGE,
    PER_PARTICLE,
    predicted_bonds,
    predicted_images,
    refuse_beyond_memory,
)
from pdpetsc.discrete.outer_layer import outer_layer
from pdpetsc.discrete.selection import select
from pdpetsc.discrete.surface import Surface, refuse_joined, surface_of
from pdpetsc.errors import CaseError, UnknownSurface
from pdpetsc.gradient.axes import body_axes
from pdpetsc.gradient.base import GradientOperator
from pdpetsc.gradient.lattice_gradient import LatticeGradient
from pdpetsc.gradient.mean_dilatation import boxes
from pdpetsc.gradient.weights import Unsuited
from pdpetsc.kernels.compile import cache_lock
from pdpetsc.material import Material
from pdpetsc.material.energy_momentum import EnergyMomentum
from pdpetsc.material.graded import Graded
from pdpetsc.petsc.conforming import solve_conforming
from pdpetsc.petsc.options import Options
from pdpetsc.problem.assembly import Assembler, Filler
from pdpetsc.problem.body import Body
from pdpetsc.problem.damage import Damage, DamageModel, make_damage
from pdpetsc.problem.extra import build_extra
from pdpetsc.problem.inertia import Inertia
from pdpetsc.problem.loose_springs import LooseSprings
from pdpetsc.problem.material_term import MaterialTerm
from pdpetsc.problem.problem import Problem
from pdpetsc.problem.scales import nearest_distances, scales_of
from pdpetsc.problem.term import Term
from pdpetsc.running.turned_regions import resists_rotation
from pdpetsc.solvers.heat_steps import HeatSteps
from pdpetsc.solvers.table import implementation
from pdpetsc.terms.bond_forces import BondForces
from pdpetsc.terms.bulk_viscosity import ViscousPressure
from pdpetsc.terms.conditions import Applied, apply
from pdpetsc.terms.control import stiffness_of
from pdpetsc.terms.damaged_points import DamagedPoints
from pdpetsc.terms.degraded_patches import failing_points
from pdpetsc.terms.expansion import stress_free
from pdpetsc.terms.heat import Heat, heat_of
from pdpetsc.terms.lattice_bonds import LatticeBonds
from pdpetsc.terms.material_points import MaterialPoints
from pdpetsc.terms.mean_dilatation import material_points
from pdpetsc.terms.tangent_scaled import control_forces, degraded_control

# Bonds are not listed if at least this share of the particles has the same family.
LEAST_REPEATED = 0.3
# Smallest memory of a particle with a shared family: gradient, stress and moduli [bytes].
PER_REPEATED = 800.0
# Sides of a lattice of unit spacing with families that repeat at a horizon of two spacings.
ENOUGH_TO_REPEAT = [30.0, 7.0, 7.0]
# Powers of positions and horizons beyond these overflow.
FAR = 1e60


def make_chunk(comm: Comm, case: Case) -> Chunk:
    """Create the particles of this rank (collective); raise CaseError if they are wrong."""
    refuse_beyond_memory(comm, case.particles.estimate() / comm.size * PER_PARTICLE, "Making the particles")
    with agreed(comm):
        chunk = called("particles", case.particles.chunk, comm.rank, comm.size)
        _refuse_bad_particles(chunk)
    if not anywhere(comm, len(chunk.x)):
        raise CaseError("The case has no particles. Check `cut` and `keep`, or the file of the particles.")
    return chunk


def created_facets(comm: Comm, case: Case, dim: int) -> Facets:
    """Return the facets of the particles that this rank creates, also those at cracks and their images (collective)."""
    with agreed(comm):
        cracks = images_of_case(case.cracks, dim, case.cell, case.symmetry) if case.cracks else ()
        return case.particles.surface(comm.rank, comm.size, cracks)


def make_cloud(comm: Comm, case: Case, chunk: Chunk | None = None, axes: Float | None = None) -> Cloud:
    """Distribute the particles of a case, by default those of ``make_chunk`` (collective); raise CaseError on failure.

    Boxes of ``MeanDilatation`` along ``axes`` (dim, dim), by default those of space, stay on one rank each.
    """
    chunk = make_chunk(comm, case) if chunk is None else chunk
    count = int(total(comm, len(chunk.x)))
    first = offset(comm, len(chunk.x))
    with agreed(comm):
        reach = horizons_of(case.chosen_horizon, chunk, first, count, case.particles.thickness)
    _refuse_large_families(comm, case, chunk.x, reach, count)
    # Bonds belong to both ends, gradients to one end.
    mutual = case.of_bonds
    patches = None if case.of_bonds else case.gradients.patches
    along = chunk.x if axes is None else chunk.x @ axes.T
    together = None if patches is None else boxes(comm, along, patches.edge).astype(float)
    widest = largest(comm, reach, initial=0.0)
    further = [one.beyond(widest) for one in case.conditions if isinstance(one, TwoParts)]
    beyond: float | Float = 0.0
    if further and (comm.size > 1 or case.symmetry):  # around particles with facets, also for their images
        facets = created_facets(comm, case, chunk.x.shape[1])
        outer = np.zeros(len(chunk.x))
        outer[facets.arrays[2]] = 1.0
        beyond = max(further) * outer
    cloud = distribute(
        comm, chunk.x, chunk.volume, chunk.sets, reach, case.cell, case.symmetry, mutual, together, chunk.body, beyond
    )
    if patches is not None and smallest(comm, cloud.n_owned) == 0:
        raise CaseError(
            f"Patches of {patches.edge:g} are too few for {comm.size} ranks. Use fewer ranks, smaller patches, or a "
            "scheme without patches."
        )
    return cloud


def _refuse_large_families(comm: Comm, case: Case, x: Float, reach: float | Float, count: int) -> None:
    """Raise CaseError on all ranks if families do not fit in memory (collective)."""
    bonds = predicted_bonds(comm, x, reach, case.cell, case.symmetry)
    family, dim = bonds / count, x.shape[1]
    each = PER_BOND + (0.0 if case.of_bonds else case.gradients.memory(dim, family))
    widest = largest(comm, reach, initial=0.0)
    what = f"A horizon of {widest:g} gives {count} particles about {family:.4g} neighbours each, which"
    listed = _listed_share(comm, case, x, reach)
    needed = listed * bonds * each + (1.0 - listed) * count * PER_REPEATED
    needed += PER_IMAGE * predicted_images(comm, x, widest, case.cell)
    refuse_beyond_memory(comm, needed / comm.size, what)


def _listed_share(comm: Comm, case: Case, x: Float, reach: float | Float) -> float:
    """Estimate the share of particles without a shared family: 1 if none has one (collective).

    On a lattice these are particles within a horizon of the ends of its longest axis.
    """
    on_lattice = np.ndim(reach) == 0 and positions_on_lattice(x, float(reach)) is not None
    if anywhere(comm, not on_lattice):
        return 1.0
    with agreed(comm):
        least = repeated_share(case)
    if least is None:
        return 1.0
    low, high = bounds(comm, x)
    longest = float((high - low).max())
    listed = min(1.0, 2.0 * float(reach) / longest) if longest > 0.0 else 1.0
    return listed if 1.0 - listed >= least else 1.0


def make_families(case: Case, cloud: Cloud) -> Families:
    """Return the families of a case; bonds are not listed if enough families are equal (collective)."""
    with agreed(cloud.comm):
        repeated = repeated_share(case)
    return find_families(cloud, case.cracks, repeated, _in_order(case))


def with_whole_patches(case: Case, chunk: Chunk, cloud: Cloud, families: Families) -> tuple[Cloud, Families]:
    """Redistribute cloud and families so that every box of ``MeanDilatation`` is on one rank (collective).

    The axes of the boxes follow from the families: particles are distributed a second time unless boxes are along the
    coordinate axes.
    """
    patches, comm = None if case.of_bonds else case.gradients.patches, cloud.comm
    if patches is None or comm.size == 1:
        return cloud, families
    axes, _ = body_axes(cloud, families, families.bonds(cloud.x))
    moved = boxes(comm, chunk.x @ axes.T, patches.edge) != boxes(comm, chunk.x, patches.edge)
    if not anywhere(comm, moved):
        return cloud, families
    cloud = make_cloud(comm, case, chunk, axes)
    return cloud, make_families(case, cloud)


def make_problem(case: Case, cloud: Cloud, families: Families, options: Options | None = None) -> Problem:
    """Build the problem of a case on a distributed cloud, with the PETSc options of its run (collective)."""
    if not anywhere(cloud.comm, families.n_bonds):
        volume = float(total(cloud.comm, cloud.volume[: cloud.n_owned].sum()))
        depth = case.particles.thickness if cloud.dim < 3 else 1.0
        spacing = (volume / depth / cloud.n_global) ** (1.0 / cloud.dim)
        raise CaseError(
            f"No two of the {cloud.n_global} particles share a bond: the horizon is {cloud.horizon:.6g}, the mean "
            f"spacing {spacing:.6g}. Use a horizon of at least {LEAST_RATIO * spacing:.6g}"
            f"{', or shorter cracks' if case.cracks else ''}."
        )
    materials = materials_of(case, cloud)
    with agreed(cloud.comm):
        weights = case.chosen_weights
    surface = None
    if case.needs_surface or weights.conform:
        try:
            surface = _surface(case, cloud, families)
        except CaseError as error:
            if not case.needs_surface:
                weights = Unsuited(str(error))
            elif isinstance(error, UnknownSurface) and case.only_touched:
                surface = outer_layer(cloud, families, case.particles.thickness)
            else:  # declared, not by default
                raise
    chosen = replace(case, weights=weights)
    thermals = case.thermals if case.expands else None
    body = Body(cloud, families, surface, case.particles.thickness, thermals)
    return _problem(chosen, body, materials, options)


def _surface(case: Case, cloud: Cloud, families: Families) -> Surface:
    """Return the surface of the body (collective)."""
    surface = surface_of(cloud, families, created_facets(cloud.comm, case, cloud.dim))
    # Facets on crack faces may have bonds beside the tip.
    if case.chosen_weights.conform and not case.cracks:
        refuse_joined(cloud, surface, case.particles.thickness)
    return surface


def rehearse(comm: Comm, case: Case, dim: int, filling: Callable[[Problem], Filler] = Assembler) -> None:
    """Compile or load the kernels of a case on rank 0, with a lattice of a few particles; other ranks wait.

    The other ranks then load them from the cache, so that many ranks with an empty cache do not compile and write the
    same kernels. ``filling`` creates the assembler of the matrices.

    Notes
    -----
    Collective.
    """
    with agreed(comm):
        if is_root(comm):
            share = repeated_share(case)
            sides = [4.0] * dim if share is None else ENOUGH_TO_REPEAT[:dim]
            axes = [np.arange(side) for side in sides]
            x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, dim)
            materials = [ungraded(material).uniform() for _, material in case.materials]
            with cache_lock():
                cloud = distribute(alone(), x, np.ones(len(x)), {}, 2.1)
                alternating = (np.arange(len(x)) % len(materials)).astype(np.int32)
                # Critical stretches, conditions and terms of the case do not fit the small body.
                damage = None if case.damage is None else case.damage.rehearsed()
                weights = case.chosen_weights
                strained = [Eigenstrain(All(), xx=1e-3)] if case.expands else []
                scheme = None if case.scheme is None else case.scheme.of_unit_spacing()
                bare = replace(
                    case, scheme=scheme, damage=damage, conditions=strained, heat=None, cell=None, symmetry=(),
                    terms=(), weights=weights, material=[(All(), material) for material in materials],
                )  # fmt: skip
                families = find_families(cloud, repeated=None if share is None else 0.0, in_order=_in_order(case))
                surface = surface_of(cloud, families, Arrays(x, 1.0).surface()) if weights.conform else None
                around = Body(cloud, families, surface, thermals=bare.thermals if bare.expands else None)
                problem = _problem(bare, around, OfParticles(materials, alternating, None))
                state = problem.state(np.zeros_like(x))
                filling(problem).rehearse(state)
                problem.internal_force(state)
                problem.linearised(state)(state.u)
                problem.energies(state)
                problem.commit(state)
                problem.material_term.out_of_plane(state)
                nearest_distances(problem.body)
                problem.supports.held_at_cut_families()
                implementation(case.solver).rehearse(problem)


@dataclass(frozen=True)
class OfParticles:
    """The materials of a body, with the material of each owned particle.

    Attributes
    ----------
    materials : sequence of Material or BondMaterial
        Materials of a body are all of one kind.
    index : (n_owned,) int32
        Material number of each owned particle.
    factor : (n_owned,) float64 or None
        Factor of the moduli of each owned particle, if a material is graded [-].
    """

    materials: Sequence[Material | BondMaterial]
    index: LocalIndex
    factor: Float | None

    @property
    def at_points(self) -> Sequence[Material]:
        """Return the materials of a body with deformation gradients."""
        return cast(Sequence[Material], self.materials)

    @property
    def of_bonds(self) -> Sequence[BondMaterial]:
        """Return the materials of a body of bonds."""
        return cast(Sequence[BondMaterial], self.materials)

    @property
    def several(self) -> bool:
        """Return True if moduli differ between particles."""
        return self.factor is not None or any(one != self.materials[0] for one in self.materials)

    @property
    def density(self) -> Float | None:
        """Return the density of each owned particle [mass / volume]; None unless all materials have one."""
        found = [one.density for one in self.materials]
        return None if None in found else np.array(found, dtype=float)[self.index]

    @property
    def factors(self) -> Float:
        """Return the factor of the moduli of each owned particle, 1 if no material is graded (n_owned,) [-]."""
        return np.ones(len(self.index)) if self.factor is None else self.factor

    def bond_stiffness(self, bonds: Neighbourhood, moduli: Sequence[float]) -> Float:
        """Return the stiffness of bonds for one Young's modulus per material (n_bonds,) (collective)."""
        alike = [
            BondBased(E, plane=one.plane, calibration="lattice") for E, one in zip(moduli, self.materials, strict=True)
        ]
        return combine(bonds, alike, self.index, self.factors).k


def _problem(case: Case, body: Body, materials: OfParticles, options: Options | None = None) -> Problem:
    """Return the problem of a body: its material with damage and control, conditions, temperature and motion."""
    if case.solver.conserving:
        materials = _conserving(case, materials)
    material_term, others, damage, bonds = _material(case, body, materials, options)
    state = None if damage is None or damage.of_bonds is None else damage.of_bonds.bonds
    stops = case.steps.stops()
    applied = apply(
        body, material_term, case.conditions, case.particles, stops, materials.density, state, case.duration
    )  # fmt: skip
    heat = _heat(case, body, material_term, materials, applied, bonds, damage)
    extra = [build_extra(declared, number, body) for number, declared in enumerate(case.terms, 1)]
    conduction = [] if heat is None else [heat]
    terms = [*others, *applied.terms, *extra, *conduction]
    problem = Problem(body, material_term, terms, applied.supports, damage, case.duration)
    for one in conduction:
        problem.fields.append(HeatSteps(one, Options({}) if options is None else options))
    _set_motion(case, problem, materials, applied)
    return problem


def _material(
    case: Case, body: Body, materials: OfParticles, options: Options | None
) -> tuple[MaterialTerm, list[Term], DamageModel | None, Neighbourhood | None]:
    """Return the term of the material, that of a control, damage, and the bonds unless families are shared."""
    bonds, lattice = None, body.families.lattice
    material_term: MaterialTerm
    damage: DamageModel | None
    if lattice is not None:
        made = _repeated_bonds if case.of_bonds else _repeated_points
        material_term, others, damage = made(case, body, lattice, materials)
    else:
        bonds = _neighbourhood(case, body.cloud, body.families)
        listed = _bonds if case.of_bonds else partial(_points, options=options)
        material_term, others, damage = listed(case, body, bonds, materials)
    if case.expands and any(law.criterion.reads_strain for law in case.damage_laws):
        raise CaseError(
            "Strain-based criteria use the total strain and cannot be combined with thermal strain or eigenstrain. "
            "Use a stretch, energy or stress criterion."
        )
    return material_term, others, damage, bonds


def _heat(
    case: Case, body: Body, material_term: MaterialTerm, materials: OfParticles, applied: Applied,
    bonds: Neighbourhood | None, damage: DamageModel | None,
) -> Heat | None:  # fmt: skip
    """Return the heat conduction, None without; set the stress-free deformation of a body that expands."""
    if not case.expands:
        return None
    heat = None
    if case.heat is not None:
        assert bonds is not None
        operator = None if case.of_bonds else lambda: cast(MaterialPoints, material_term).operator
        heat = heat_of(case.heat, body, applied, case.thermals, materials.index, operator, bonds.omega, damage)
    field = None if heat is None else heat.field
    body.expansion = stress_free(body, applied, case.thermals, materials.index, materials.materials, field)
    return heat


def _set_motion(case: Case, problem: Problem, materials: OfParticles, applied: Applied) -> None:
    """Give the problem the inertia of its solver, or springs on loose particles; refuse motions without inertia."""
    if case.solver.duration is not None:
        problem.inertia = _inertia(case, problem, materials, applied)
        _refuse_turning(case, problem)
        problem.inertia.carry([rigid for _, rigid in problem.rigid_bodies])
        problem.terms.append(problem.inertia)
        problem.last_step = None  # time steps start from the velocity
        return
    if isinstance(case.solver, SnapThrough):
        problem.snap_inertia = _inertia(case, problem, materials, applied)
    if moves := applied.moves or (applied.damps if problem.snap_inertia is None else ""):
        or_snaps = " or, for damping of snaps, pd.SnapThrough(...)" if applied.damps and not applied.moves else ""
        raise CaseError(f"{moves} needs inertia. Use solver=pd.Explicit(...), pd.Implicit(...){or_snaps}.")
    if problem.bond_damage is not None:  # failed points retain a residual stiffness
        scales = scales_of(problem.body, problem.material_term)
        problem.springs = LooseSprings(problem.body, problem.material_term, scales.stiffness)
        problem.terms.append(problem.springs)


def _conserving(case: Case, materials: OfParticles) -> OfParticles:
    """Return the materials of steps that conserve energy and momentum; those of linear materials do already."""
    wrong = ""
    if case.of_bonds:
        wrong = "needs deformation gradients, which a bond-based body does not have"
    elif case.damage is not None or case.expands or case.gradients.patches is not None:
        wrong = "does not go with damage, temperature and MeanDilatation"
    elif any(law.has_history for law in materials.at_points):
        wrong = "needs elastic materials"
    if wrong:
        raise CaseError(f"energy_momentum of Implicit {wrong}. Leave it out.")
    laws = [law if law.linear else EnergyMomentum(law, density=law.density) for law in materials.at_points]
    return replace(materials, materials=laws)


def _refuse_turning(case: Case, problem: Problem) -> None:
    """Raise CaseError if a rigid region turns freely in a motion, and its material resists rotations."""
    turning = [rigid for _, rigid in problem.rigid_bodies if rigid.rows is not None and rigid.declared.twisted]
    if turning and resists_rotation(case):
        raise CaseError(
            f"{turning[0].title} has a moment in a motion, and materials of small strain, which resist its rotation. "
            f"Use a material for large rotations, such as NeoHookean, or leave the moment out."
        )


def _inertia(case: Case, problem: Problem, materials: OfParticles, applied: Applied) -> Inertia:
    """Return the inertia of a body; raise CaseError on all ranks if it cannot move (collective)."""
    cloud, density, title = problem.body.cloud, materials.density, case.solver.title
    if density is None:
        lacking = next(one for one in materials.materials if one.density is None)
        raise CaseError(f"{title} needs the density of each material, and {type(lacking).__name__} has none. Give it.")
    strained = count_nonzero(cloud.comm, ~problem.supports.fixed[cloud.n_owned :])
    if case.heat is not None or problem.supports.ties is not None or strained:
        raise CaseError(
            f"{title} does not go with heat conduction, PointSupport, an inclined Roller or a cell of unknown strain. "
            f"Use Newton."
        )
    if applied.damping_time and isinstance(case.solver, SnapThrough):
        raise CaseError(
            "SnapThrough damps short waves by its radius, not by RayleighDamping(stiffness=...). Leave it out."
        )
    if applied.damping_time and problem.damage is not None:
        raise CaseError(
            "RayleighDamping(stiffness=...) has the stiffness of the undamaged body, and would hold the faces of "
            "cracks. Leave it out, or use a radius of Implicit or BulkViscosity."
        )
    timed = problem.material_term.timed or (problem.damage is not None and problem.damage.timed)
    if isinstance(case.solver, SnapThrough) and timed:
        raise CaseError("SnapThrough does not go with materials and failure that depend on the rate. Use Implicit.")
    if case.cell is not None and (applied.damping_time or applied.viscosity is not None):
        raise CaseError(
            "BulkViscosity and RayleighDamping(stiffness=...) do not go with a periodic cell. Leave them out."
        )
    n = cloud.n_owned
    mass = density * cloud.volume[:n]
    start = np.zeros((n, cloud.dim)) if applied.velocity is None else applied.velocity
    dashpots = None
    if applied.absorbing is not None:
        dashpots = _dashpots(problem.body, materials, density, applied.absorbing)
    inertia = Inertia(
        problem.body, mass, start, problem.supports.fixed, applied.damping_rate, dashpots, applied.damping_time,
        case.duration,
    )  # fmt: skip
    if applied.viscosity is not None:
        if not isinstance(case.solver, Explicit):
            raise CaseError("BulkViscosity is for Explicit. Implicit steps damp shocks by their radius; leave it out.")
        if case.of_bonds:
            raise CaseError("BulkViscosity needs deformation gradients, which a bond-based body does not have.")
        A = elastic_moduli(materials, cloud.dim)[:, 0, 0, 0, 0]
        inertia.viscosity = ViscousPressure(applied.viscosity, problem, density, materials.factors * A[materials.index])
    return inertia


def elastic_moduli(materials: OfParticles, dim: int) -> Float:
    """Return the moduli of each undeformed material (n_materials, dim, dim, dim, dim) [stress]."""
    laws = [one.elastic(dim) if isinstance(one, BondMaterial) else one for one in materials.materials]
    return np.stack([law.moduli(dim) for law in laws])


def _dashpots(body: Body, materials: OfParticles, density: Float, mask: Mask) -> Float:
    """Return ``sum_f |a_f| sqrt(rho Q(n_f))`` of each own particle (n_owned, dim, dim) [force time / length].

    ``Q_ik = A_imkn n_m n_n`` is the acoustic tensor of the undeformed material (not collective).
    """
    surface, dim = body.known_surface, body.dim
    area, owner = surface.area[mask], surface.owner[mask]
    size = np.linalg.norm(area, axis=1)
    normal = area / size[:, None]
    A = elastic_moduli(materials, dim)[materials.index[owner]]
    Q = (materials.factors * density)[owner, None, None] * np.einsum("fimkn,fm,fn->fik", A, normal, normal)
    squares, axes = np.linalg.eigh(Q)
    dashpots = np.einsum("fij,fj,fkj->fik", axes, np.sqrt(np.maximum(squares, 0.0)), axes)
    found = np.zeros((len(density), dim, dim))
    np.add.at(found, owner, size[:, None, None] * dashpots)
    return found


def _neighbourhood(case: Case, cloud: Cloud, families: Families) -> Neighbourhood:
    """Return the bonds of a body with their influence (collective)."""
    with agreed(cloud.comm):
        if not cloud.varies:
            omega = evaluate(case.influence, families.lengths(cloud.x) / cloud.horizon)
        else:
            s = families.lengths(cloud.x) / cloud.local_horizon[families.centres]
            # Bonds within the local horizon of their second end only have no share in the first.
            reached = s <= 1.0 + 2.0 * HORIZON_TOLERANCE
            omega = np.zeros(len(s))
            omega[reached] = evaluate(case.influence, s[reached])
    return Neighbourhood(cloud, families, omega, case.influence, case.particles.thickness)


def repeated_share(case: Case) -> float | None:
    """Return the smallest share of equal families for which bonds are not listed; None for never.

    Never for data that differ between particles: failing bonds, weights of the whole body, schemes that use more than
    the family, controls that do not scale with kappa, and bonds of several materials.
    """
    if case.heat is not None or (case.damage is not None and not case.damage.point_laws):
        return None
    if case.of_bonds:
        if case.expands:  # every bond has its own force-free length
            return None
        # Bonds of one material with uniform moduli.
        if len(case.materials) > 1 or grading_of(case.materials[0][1]) is not None:
            return None
        return LEAST_REPEATED if cast(BondMaterial, ungraded(case.materials[0][1])).of_family else None
    if case.chosen_weights.conform or not case.gradients.of_family:
        return None
    control = control_of(case)
    return LEAST_REPEATED if control is None or control.of_kappa else None


def control_of(case: Case) -> ZeroEnergyControl | None:
    """Return the control of a case; tangent-scaled only if a material has a history."""
    if case.control is None or any(law.has_history for law in case.laws):
        return case.control
    return case.control.elastic


def _in_order(case: Case) -> bool:
    """Return True if shared families require the same order of members.

    Gradient points of bonds are in the order of the bonds, and histories are stored by the index of a point in its
    particle. A restart on any number of ranks requires the same order.
    """
    if case.of_bonds or not case.gradients.points_of_bonds:
        return False
    return any(law.has_history for law in case.laws)


def _repeated_points(
    case: Case, body: Body, lattice: LatticeStencils, materials: OfParticles
) -> tuple[MaterialTerm, list[Term], DamageModel | None]:
    """Return the terms of a body with deformation gradients and mostly equal families (collective).

    Scheme and control are built for the irregular particles, and for one particle with the shared family.
    """
    irregular = lattice.irregular
    families = Families(irregular.indptr, irregular.neighbours)
    omega = _neighbourhood(case, irregular.cloud, families).omega
    operator = LatticeGradient(case.gradients.build(irregular.cloud, families, omega), lattice)

    def controlled(control: ZeroEnergyControl, stiffness: Stiffness) -> Control:
        built = cast(NonUniform, control.build(irregular.cloud, families, omega, of_irregular(stiffness, lattice)))

        def listed() -> Control:
            everything = _neighbourhood(case, body.cloud, body.families).omega
            return control.build(body.cloud, body.families, everything, stiffness)

        return LatticeControl(lattice, built, relative_scale(stiffness, lattice), listed)

    return _terms_of_points(case, body, operator, controlled, materials)


def _repeated_bonds(
    case: Case, body: Body, lattice: LatticeStencils, materials: OfParticles
) -> tuple[MaterialTerm, list[Term], DamageModel | None]:
    """Return the terms of a body with forces along bonds and mostly equal families (collective)."""
    irregular = lattice.irregular
    families = Families(irregular.indptr, irregular.neighbours)
    bonds, first = _neighbourhood(case, irregular.cloud, families), np.zeros(irregular.cloud.n_owned, dtype=np.int32)
    of_irregular = BondForces(Body(irregular.cloud, families), bonds, materials.of_bonds, first)
    return LatticeBonds(body, lattice, of_irregular), [], None


def _bonds(
    case: Case, body: Body, bonds: Neighbourhood, materials: OfParticles
) -> tuple[MaterialTerm, list[Term], Damage | None]:
    """Return the terms of a body with forces along bonds (collective)."""
    material_term = BondForces(body, bonds, materials.of_bonds, materials.index, materials.factor)
    if case.damage is None:
        return material_term, [], None
    k = material_term.k
    if material_term.a is not None:  # the energy of a bond depends on its family
        k = materials.bond_stiffness(bonds, [one.E for one in materials.of_bonds])
    declared = cast(BondDamage | DamageOf, case.damage)  # other materials are refused
    damage = _failing(declared, body, bonds, k, material_term.finite, materials)
    material_term.take_damage(damage)
    return material_term, [], damage


def _points(
    case: Case, body: Body, bonds: Neighbourhood, materials: OfParticles, options: Options | None
) -> tuple[MaterialTerm, list[Term], DamageModel | None]:
    """Return the terms of a body with deformation gradients (collective)."""
    laws, index, factor = materials.at_points, materials.index, materials.factor

    def weigh(operator: GradientOperator) -> GradientOperator:
        solve = partial(solve_conforming, options=options)
        return case.chosen_weights.of(operator, body.cloud, body.families, body.surface, solve)

    if case.damage is not None and not case.damage.point_laws and case.gradients.patches is not None:
        raise CaseError(
            "MeanDilatation cannot be combined with bonds that fail. Use the scheme inside it, such as "
            "pd.Correspondence(), or PointDamage."
        )

    def controlled(control: ZeroEnergyControl, stiffness: Stiffness) -> Control:
        return control.build(body.cloud, body.families, bonds.omega, stiffness)

    if case.damage is None or case.damage.point_laws:
        operator = weigh(case.gradients.build(body.cloud, body.families, bonds.omega))
        return _terms_of_points(case, body, operator, controlled, materials)
    # Materials with one modulus per direction have no stiffness of bonds, and computing it takes long.
    reads = any(law.criterion.reads_stiffness for law in case.damage_laws)
    k = materials.bond_stiffness(bonds, [one.young_modulus() for one in laws]) if reads else None
    declared = cast(BondDamage | DamageOf, case.damage)
    damage = _failing(declared, body, bonds, k, True, materials)
    material_term = DamagedPoints(body, bonds.omega, case.gradients, laws, index, factor, damage, weigh)
    control = control_of(case)
    if control is None:
        return material_term, [], damage
    built = controlled(control, control.sees(stiffness_of(body, laws, index, factor)))
    return material_term, [control_forces(control, body, built, material_term, damage)], damage


def _terms_of_points(
    case: Case, body: Body, operator: GradientOperator, controlled: Callable[[ZeroEnergyControl, Stiffness], Control],
    materials: OfParticles,
) -> tuple[MaterialTerm, list[Term], DamageModel | None]:  # fmt: skip
    """Return the terms of a body with constant gradient weights, whose points may fail (collective).

    ``controlled`` builds a control for the stiffness of the body.
    """
    laws, index, factor = materials.at_points, materials.index, materials.factor
    control, built = control_of(case), None
    if control is not None:
        built = controlled(control, control.sees(stiffness_of(body, laws, index, factor)))
    if case.damage is None:
        material_term = material_points(case.gradients, body, operator, laws, index, factor)
        if control is None or built is None:
            return material_term, [], None
        return material_term, [control_forces(control, body, built, material_term)], None
    declared = cast(PointDamage | DamageOf, case.damage)
    of_particle = declared.assign_particles(body.cloud, body.families, _marking(body))
    damage_laws = AssignedPointDamage(declared.point_laws, of_particle)
    failing = failing_points(case.gradients, body, operator, laws, index, factor, damage_laws)
    if control is None or built is None:
        term = failing(None)
        return term, [], term
    term, forces = degraded_control(control, body, built, failing)
    return term, [forces], term


def _failing(
    declared: BondDamage | DamageOf, body: Body, bonds: Neighbourhood, k: Float | None, finite: bool,
    materials: OfParticles,
) -> Damage:  # fmt: skip
    """Return the damage of bonds with stiffness ``k`` (n_bonds,); raise CaseError if the law requires one material.

    Collective.
    """
    if materials.several and any(law.criterion.of_one_material for law in declared.all_laws):
        raise CaseError(
            f"The criterion of {type(declared).__name__} requires one uniform material. For several or graded "
            "materials use CriticalFunction or FractureEnergy."
        )
    failing = DamageableBonds.of(body.cloud, body.families, bonds.omega, k, finite, materials.index, materials.factor)
    return make_damage(declared, body, failing, _marking(body))


def _marking(body: Body) -> Marking:
    """Return a function that marks the local particles of a body in a region."""

    def mark(region: Region, what: str) -> Mask:
        return body.cloud.halo.with_ghosts(select(body.cloud, region, what))

    return mark


def materials_of(case: Case, cloud: Cloud) -> OfParticles:
    """Return the materials of a case, with the material of each owned particle (collective)."""
    count = np.zeros(cloud.n_owned, dtype=np.int32)
    index = np.zeros(cloud.n_owned, dtype=np.int32)
    factor = np.ones(cloud.n_owned)
    x = cloud.x[: cloud.n_owned]
    for number, (region, material) in enumerate(case.materials):
        mask = select(cloud, region, f"material {number + 1}")
        count += mask
        index[mask] = number
        with agreed(cloud.comm):
            # Functions of positions may not support empty arrays.
            grading = grading_of(material)
            if grading is not None and mask.any():
                factor[mask] = _factors(grading, x[mask])
    with agreed(cloud.comm):
        wrong = np.flatnonzero(count != 1)
        if len(wrong):
            place = ", ".join(f"{c:.6g}" for c in x[wrong[0]])
            found = f"{count[wrong[0]]} materials" if count[wrong[0]] else "no material"
            raise CaseError(
                f"Particle {cloud.gid[wrong[0]]} at ({place}) has {found}; let the regions cover every particle once."
            )
    graded = any(grading_of(material) is not None for _, material in case.materials)
    return OfParticles([ungraded(material) for _, material in case.materials], index, factor if graded else None)


def grading_of(material: AnyMaterial) -> Graded | None:
    """Return the grading of a declared material; None for a uniform material."""
    found = isothermal(material)
    return found if isinstance(found, Graded) else None


def _factors(material: Graded, x: Float) -> Float:
    values = numbers_from("factor of a graded material", material.factor, x)
    if values.shape != (len(x),):
        raise CaseError(
            f"The factor of a graded material must return one number per particle, not shape {values.shape}."
        )
    bad = np.flatnonzero(~(np.isfinite(values) & (values > 0.0)))
    if len(bad):
        raise CaseError(f"The factor of a graded material is {values[bad[0]]:g} at {x[bad[0]]}; it must be positive.")
    return values


def _refuse_bad_particles(chunk: Chunk) -> None:
    bad = np.flatnonzero(~np.isfinite(chunk.x).all(axis=1))
    if len(bad):
        raise CaseError(f"{len(bad)} particles have a position that is not a number, the first at {chunk.x[bad[0]]}.")
    far = float(np.abs(chunk.x).max(initial=0.0))
    if far > FAR:
        raise CaseError(f"A particle is {far:g} away from the origin, beyond {FAR:g}. Choose a larger unit of length.")
    bad = np.flatnonzero(~(np.isfinite(chunk.volume) & (chunk.volume > 0.0)))
    if len(bad):
        volume, x = chunk.volume[bad[0]], chunk.x[bad[0]]
        raise CaseError(f"{len(bad)} particles have no positive volume, the first has {volume:g} at {x}.")
