"""Tables of what the property tests run over, and small bodies. A new model gets one row here."""

import dataclasses
import itertools
import sys
from pathlib import Path

import numpy as np

import pdpetsc as pd
from pdpetsc.bond_based import Neighbourhood
from pdpetsc.discrete.cloud import distribute
from pdpetsc.discrete.communicator import world
from pdpetsc.discrete.families import find_families
from pdpetsc.model import BondModel, CorrespondenceModel, DamagedCorrespondenceModel

sys.path.append(str(Path(__file__).parent.parent / "runs"))
from study import dense_tangent as dense_tangent

DIMS = (1, 2, 3)
MATERIALS = {
    "hencky": pd.Hencky(E=10.0, nu=0.3),
    "neo_hookean": pd.NeoHookean(E=10.0, nu=0.3),
    "saint_venant_kirchhoff": pd.SaintVenantKirchhoff(E=10.0, nu=0.3),
    "linear_elastic": pd.LinearElastic(E=10.0, nu=0.3),
}
PLANE_STRESS = {f"{name}_plane_stress": type(m)(m.E, m.nu, "stress") for name, m in MATERIALS.items()}
SCHEMES = {
    "correspondence": pd.Correspondence(),
    "sub_horizons": pd.SubHorizons(),
    "four_sub_horizons": pd.SubHorizons(4),
    "stress_points": pd.StressPoints(),
    "corrected": pd.Corrected(2),
    "higher_order": pd.HigherOrder(2),
    "bond_associated": pd.BondAssociated(),
}
STABILISATIONS = {
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


def body(
    dim, scheme=SCHEMES["correspondence"], stabilisation=None, material=MATERIALS["hencky"], horizon=2.015, rng=None
):
    """Return the model of a small body on this process, with a volume per particle that varies where shaken."""
    x = lattice(dim, rng)
    volume = np.ones(len(x)) if rng is None else rng.uniform(0.8, 1.2, len(x))
    cloud = distribute(world(), x, volume, {}, horizon)
    families = find_families(cloud)
    omega = np.ones(len(families.neighbours))
    material_of = np.zeros(cloud.n_owned, dtype=np.int32)
    return CorrespondenceModel(cloud, families, omega, scheme, [material], material_of, stabilisation)


LAWS = {
    "brittle": pd.Brittle,
    "linear": pd.LinearSoftening,
    "exponential": pd.ExponentialSoftening,
    "bilinear": pd.BilinearSoftening,
    "smooth": pd.SmoothDegradation,
}


def damaged_body(
    dim, law, scheme=SCHEMES["correspondence"], control=None, material=MATERIALS["hencky"], rng=None, horizon=2.015
):
    """Return a small body of deformation gradients whose bonds fail by a law, on this process."""
    x = lattice(dim, rng)
    cloud = distribute(world(), x, np.ones(len(x)), {}, horizon)
    families = find_families(cloud)
    omega, material_of = np.ones(len(families.neighbours)), np.zeros(cloud.n_owned, dtype=np.int32)
    return DamagedCorrespondenceModel(cloud, families, omega, scheme, [material], material_of, control, None, law, None)


def bond_body(dim, material, horizon=2.015, rng=None, cell=False, damage=None):
    """Return the model of a small body of bonds on this process, in a periodic cell on request."""
    x = lattice(dim, rng)
    volume = np.ones(len(x)) if rng is None else rng.uniform(0.8, 1.2, len(x))
    whole = pd.Cell([-0.5] * dim, np.array(SIDES[dim]) - 0.5) if cell else None
    cloud = distribute(world(), x, volume, {}, horizon, whole)
    families = find_families(cloud)
    length = np.linalg.norm(families.bonds(cloud.x), axis=1)
    influence = pd.influence.Gaussian()
    bonds = Neighbourhood(cloud, families, influence(length / horizon), length, influence, 1.0)
    return BondModel(bonds, [material], np.zeros(cloud.n_owned, dtype=np.int32), damage=damage)


def bond_bodies(rng):
    """Yield (label, model) for every dimension and material of bonds, free and periodic, on shaken clouds."""
    for dim, cell in itertools.product(DIMS, (False, True)):
        for name, material in (BONDS | (PLANE_STRESS_BONDS if dim == 2 else {})).items():
            yield f"{dim}D {name} {'periodic' if cell else 'free'}", bond_body(dim, material, rng=rng, cell=cell)


def bodies(rng):
    """Yield (label, model) for every dimension, scheme and stabilisation, on shaken clouds."""
    for dim, (s, scheme) in itertools.product(DIMS, SCHEMES.items()):
        for c, control in (STABILISATIONS | (PLANE if dim > 1 else {})).items():
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
