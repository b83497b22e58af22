"""Tables of what the property tests run over, and small bodies. A new model gets one row here."""

import dataclasses
import itertools
import sys
from pathlib import Path

import numpy as np

import pdpetsc as pd
from pdpetsc.bond_based import Neighbourhood, combine
from pdpetsc.damage import DamageableBonds
from pdpetsc.damage.point_damage import AssignedPointDamage
from pdpetsc.discrete.cloud import distribute
from pdpetsc.discrete.communicator import world
from pdpetsc.discrete.families import find_families
from pdpetsc.discrete.selection import select
from pdpetsc.problem.body import Body
from pdpetsc.problem.damage import make_damage
from pdpetsc.problem.problem import Problem
from pdpetsc.problem.supports import Supports
from pdpetsc.terms.bond_forces import BondForces
from pdpetsc.terms.control import ControlForces, stiffness_of
from pdpetsc.terms.damaged_points import DamagedPoints
from pdpetsc.terms.degraded_patches import failing_points
from pdpetsc.terms.mean_dilatation import material_points
from pdpetsc.terms.tangent_scaled import control_forces, degraded_control

sys.path.append(str(Path(__file__).parent.parent / "runs"))
import study

DIMS = (1, 2, 3)
MATERIALS = {
    "hencky": pd.Hencky(E=10.0, nu=0.3),
    "neo_hookean": pd.NeoHookean(E=10.0, nu=0.3),
    "saint_venant_kirchhoff": pd.SaintVenantKirchhoff(E=10.0, nu=0.3),
    "linear_elastic": pd.LinearElastic(E=10.0, nu=0.3),
    "j2": pd.J2(E=10.0, nu=0.3, yield_stress=0.3, hardening=1.0),
    "j2_saturating": pd.J2(
        E=10.0, nu=0.3, yield_stress=0.3, hardening=pd.hardening.Linear(0.5) + pd.hardening.Voce(0.4, 8.0)
    ),
    "kinematic_j2": pd.KinematicJ2(E=10.0, nu=0.3, yield_stress=0.3, kinematic=0.6, hardening=0.4),
    "drucker_prager": pd.DruckerPrager(E=10.0, nu=0.3, cohesion=0.2, friction=0.4, hardening=1.0),
}


def in_plane_stress(material):
    """Return a material in plane stress, None where it is not there for that."""
    try:
        return dataclasses.replace(material, plane="stress")
    except pd.CaseError:
        return None


PLANE_STRESS = {f"{name}_plane_stress": in_plane_stress(m) for name, m in MATERIALS.items() if in_plane_stress(m)}
SCHEMES = {
    "correspondence": pd.Correspondence(),
    "sub_horizons": pd.SubHorizons(),
    "four_sub_horizons": pd.SubHorizons(4),
    "stress_points": pd.StressPoints(),
    "corrected": pd.Corrected(2),
    "higher_order": pd.HigherOrder(2),
    "bond_associated": pd.BondAssociated(),
}
ALL_CONTROLS = {
    "none": None,
    "silling": pd.Silling(0.5),
    "littlewood": pd.Littlewood(0.2),
    "wan": pd.Wan(),
    "springs": pd.Springs(0.3),
    "averaged_displacement": pd.AveragedDisplacement(0.02),
    "relative_springs": pd.RelativeSprings(0.3),
    "relative_average": pd.RelativeAverage(3.0),
    "penalty": pd.Penalty(0.2),
}
# And what needs two dimensions.
PLANE = {"silling_micromodulus": pd.SillingMicromodulus(0.5, 1.0)}
# Controls that resist affine displacements too, by what they are.
NOT_AFFINE = ("springs", "averaged_displacement", "relative_springs", "relative_average")
BONDS = {
    "bond_based": pd.BondBased(E=10.0),
    "bond_based_lattice": pd.BondBased(E=10.0, calibration="lattice"),
    "bond_based_family": pd.BondBased(E=10.0, calibration="family"),
    "linear_solid": pd.LinearSolid(E=10.0, nu=0.1),
}
BONDS |= {f"{name}_finite": dataclasses.replace(m, kinematics="finite") for name, m in BONDS.items()}
PLANE_STRESS_BONDS = {f"{name}_plane_stress": dataclasses.replace(m, plane="stress") for name, m in BONDS.items()}
# Step of central differences.
STEP = 1e-6
SIDES = {1: (12,), 2: (6, 5), 3: (4, 3, 4)}


def material_cases():
    """Return (material, dim) for every material in every dimension, and in plane stress."""
    everywhere = [(m, dim) for m in MATERIALS.values() for dim in DIMS]
    return everywhere + [(m, 2) for m in PLANE_STRESS.values()]


def lattice(dim, rng=None, shake=0.15):
    """Return lattice positions with unit spacing, shaken where a generator is given."""
    axes = [np.arange(float(n)) for n in SIDES[dim]]
    x = np.array(list(itertools.product(*axes)))
    return x if rng is None else x + shake * rng.uniform(-1.0, 1.0, x.shape)


def marking(cloud):
    """Return what marks the particles of a region."""
    return lambda region, what: select(cloud, region, what)


class Small:
    """A small problem on this process, free of conditions, with methods that take displacements."""

    def __init__(self, problem):
        self.problem = problem
        self.cloud, self.families, self.dim = problem.body.cloud, problem.body.families, problem.dim
        self.material_term = problem.material_term

    @property
    def operator(self):
        return self.material_term.operator

    @property
    def materials(self):
        return self.material_term.materials

    @property
    def failure(self):
        return self.problem.damage.bonds

    @property
    def control(self):
        controls = [term.control for term in self.problem.terms if isinstance(term, ControlForces)]
        return controls[0] if controls else None

    def at(self, u):
        return self.problem.state(np.asarray(u, dtype=float))

    def internal_force(self, u):
        return self.problem.internal_force(self.at(u))

    def linearised(self, u):
        return self.problem.linearised(self.at(u))

    def tangent_times(self, u, du):
        return self.linearised(u)(du)

    def energy(self, u):
        return tuple(self.problem.energies(self.at(u)).values())

    def all_admissible(self, u):
        return self.problem.admissible(self.at(u))

    def commit(self, u):
        self.problem.commit(self.at(u))

    def revert(self):
        self.problem.revert()

    def freeze(self, frozen):
        self.problem.freeze(frozen)

    def break_bonds(self, u, most=None):
        return self.problem.break_bonds(self.at(u), most)

    def soften(self, u):
        return self.problem.soften(self.at(u))

    def elongation(self, u):
        return self.problem.body.elongated(
            self.problem.body.with_ghosts(u), getattr(self.material_term, "finite", True)
        )[0]

    def driving_values(self, u):
        return self.problem.damage.driving_values(self.at(u))

    def take_failure(self):
        self.problem.bonds_restored()


def dense_tangent(small, u, assembler=None):
    """Return K(u) of a small problem, or what another assembler makes of it, as a dense matrix."""
    return study.dense_tangent(small.problem, u, assembler)


def small_points(cloud, families, omega, scheme, materials, material_of, control, law=None, expands=False):
    """Return a small problem of deformation gradients, whose bonds fail where there is a law."""
    whole = Body(cloud, families, thermals=[None] * len(materials) if expands else None)
    built = None
    if control is not None:
        stiffness = control.sees(stiffness_of(whole, materials, material_of, None))
        built = control.build(cloud, families, omega, stiffness)
    if law is not None and law.point_laws:
        laws = AssignedPointDamage(law.point_laws, law.assign_particles(cloud, families, marking(cloud)))
        operator = scheme.build(cloud, families, omega)
        failing = failing_points(scheme, whole, operator, materials, material_of, None, laws)
        points, *terms = [failing(None)] if built is None else degraded_control(control, whole, built, failing)
        return Small(Problem(whole, points, terms, Supports(whole), points))
    damage = None
    if law is not None:
        alike = pd.BondBased(materials[0].E, calibration="lattice")
        bonds = Neighbourhood(cloud, families, omega, pd.influence.Constant(), 1.0)
        k = combine(bonds, [alike], material_of, np.ones(cloud.n_owned)).k
        damage = make_damage(law, whole, DamageableBonds.of(cloud, families, omega, k, True), marking(cloud))
    if damage is None:
        material_term = material_points(scheme, whole, scheme.build(cloud, families, omega), materials, material_of)
    else:
        material_term = DamagedPoints(whole, omega, scheme, materials, material_of, None, damage)
    terms = []
    if control is not None:
        terms = [control_forces(control, whole, built, material_term, damage)]
    return Small(Problem(whole, material_term, terms, Supports(whole), damage))


def body(
    dim, scheme=SCHEMES["correspondence"], control=None, material=MATERIALS["hencky"], horizon=2.015, rng=None,
    expands=False,
):  # fmt: skip
    """Return the model of a small body on this process, with a volume per particle that varies where shaken."""
    x = lattice(dim, rng)
    volume = np.ones(len(x)) if rng is None else rng.uniform(0.8, 1.2, len(x))
    cloud = distribute(world(), x, volume, {}, horizon)
    families = find_families(cloud)
    omega = np.ones(len(families.neighbours))
    material_of = np.zeros(cloud.n_owned, dtype=np.int32)
    return small_points(cloud, families, omega, scheme, [material], material_of, control, expands=expands)


LAWS = {
    "brittle": pd.Brittle,
    "linear": pd.LinearSoftening,
    "exponential": pd.ExponentialSoftening,
    "bilinear": pd.BilinearSoftening,
    "smooth": pd.SmoothDegradation,
}


def damaged_body(
    dim, law, scheme=SCHEMES["correspondence"], control=None, material=MATERIALS["hencky"], rng=None, horizon=2.015,
    expands=False,
):  # fmt: skip
    """Return a small body of deformation gradients whose bonds fail by a law, on this process."""
    x = lattice(dim, rng)
    cloud = distribute(world(), x, np.ones(len(x)), {}, horizon)
    families = find_families(cloud)
    omega, material_of = np.ones(len(families.neighbours)), np.zeros(cloud.n_owned, dtype=np.int32)
    return small_points(cloud, families, omega, scheme, [material], material_of, control, law, expands)


def bond_body(dim, material, horizon=2.015, rng=None, cell=False, damage=None):
    """Return the model of a small body of bonds on this process, in a periodic cell on request."""
    x = lattice(dim, rng)
    volume = np.ones(len(x)) if rng is None else rng.uniform(0.8, 1.2, len(x))
    whole = pd.Cell([-0.5] * dim, np.array(SIDES[dim]) - 0.5) if cell else None
    cloud = distribute(world(), x, volume, {}, horizon, whole)
    families = find_families(cloud)
    length = np.linalg.norm(families.bonds(cloud.x), axis=1)
    influence = pd.influence.Gaussian()
    bonds = Neighbourhood(cloud, families, influence(length / horizon), influence, 1.0)
    around = Body(cloud, families)
    material_term = BondForces(around, bonds, [material], np.zeros(cloud.n_owned, dtype=np.int32))
    failing = None
    if damage is not None:
        damageable = DamageableBonds.of(cloud, families, bonds.omega, material_term.k, material_term.finite)
        failing = make_damage(damage, around, damageable, marking(cloud))
        material_term.take_damage(failing)
    return Small(Problem(around, material_term, [], Supports(around), failing))


def bond_bodies(rng):
    """Yield (label, model) for every dimension and material of bonds, free and periodic, on shaken clouds."""
    for dim, cell in itertools.product(DIMS, (False, True)):
        for name, material in (BONDS | (PLANE_STRESS_BONDS if dim == 2 else {})).items():
            yield f"{dim}D {name} {'periodic' if cell else 'free'}", bond_body(dim, material, rng=rng, cell=cell)


def bodies(rng):
    """Yield (label, model) for every dimension, scheme and control, on shaken clouds."""
    for dim, (s, scheme) in itertools.product(DIMS, SCHEMES.items()):
        for c, control in (ALL_CONTROLS | (PLANE if dim > 1 else {})).items():
            yield f"{dim}D {s} {c}", body(dim, scheme, control, rng=rng)
    for dim in DIMS:
        yield f"{dim}D smoothed_displacement none", body(dim, pd.SmoothedDisplacement(), horizon=3.3, rng=rng)


def displacement(model, rng, size=0.05):
    """Return a rough displacement of the own particles, as large as keeps det F > 0 at every gradient point."""
    u = size * rng.uniform(-1.0, 1.0, (model.cloud.n_rows, model.dim))
    while not model.all_admissible(2.0 * u):
        u *= 0.5
    return u


def rotation(dim, rng):
    """Return a random rotation."""
    Q, _ = np.linalg.qr(rng.standard_normal((dim, dim)))
    Q[:, 0] *= np.sign(np.linalg.det(Q))
    return Q


def differences(model, u, columns):
    """Return the given columns of the tangent by central differences of the internal force."""
    found = []
    for column in columns:
        d = np.zeros(u.size)
        d[column] = STEP
        d = d.reshape(u.shape)
        found.append((model.internal_force(u + d) - model.internal_force(u - d)).ravel() / (2.0 * STEP))
    return np.array(found).T
