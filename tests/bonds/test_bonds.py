"""Bodies of bonds: tangent, balance, objectivity, calibration, for every material of bonds, free and periodic."""

import dataclasses

import numpy as np
import pytest

import pdpetsc as pd
from tests import reference
from tests.scenes import (
    BONDS,
    DIMS,
    PLANE_STRESS_BONDS,
    STEP,
    bond_bodies,
    bond_body,
    dense_tangent,
    differences,
    displacement,
    lattice,
    rotation,
)


def test_tangent_agrees_with_differences_and_with_the_operator_applied(rng):
    for label, model in bond_bodies(rng):
        u = displacement(model, rng)
        K = dense_tangent(model, u)
        columns = rng.choice(u.size, min(12, u.size), replace=False)
        columns[-1] = u.size - 1  # a virtual unknown where there is a cell
        assert np.abs(K[:, columns] - differences(model, u, columns)).max() < 1e-7 * np.abs(K).max(), label
        assert np.abs(K - K.T).max() < 1e-12 * np.abs(K).max(), label
        du = rng.standard_normal(u.shape)
        assert np.allclose(K @ du.ravel(), model.tangent_times(u, du).ravel(), atol=1e-11 * np.abs(K).max()), label


def test_force_is_the_derivative_of_the_energy(rng):
    for label, model in bond_bodies(rng):
        u = displacement(model, rng)
        du = rng.standard_normal(u.shape)
        work = np.vdot(model.internal_force(u), du)
        change = (sum(model.energy(u + STEP * du)) - sum(model.energy(u - STEP * du))) / (2.0 * STEP)
        assert work == pytest.approx(change, rel=1e-6, abs=1e-7), label


def test_forces_and_moments_balance(rng):
    """Moments about the current positions at finite stretch, about the reference ones where bonds keep direction."""
    for label, model in bond_bodies(rng):
        u = displacement(model, rng)
        f = model.internal_force(u)[: model.cloud.n_owned]
        size = np.abs(f).sum()
        assert np.abs(f.sum(axis=0)).max() < 1e-13 * size, label
        if model.cloud.images is None:
            moment = (model.cloud.x + model.material_term.finite * u).T @ f
            assert np.abs(moment - moment.T).max() < 1e-12 * size * len(u), label


@pytest.mark.parametrize("dim", [2, 3])
def test_rotation_rotates_the_forces_at_finite_stretch(dim, rng):
    for name, material in BONDS.items():
        if material.kinematics == "small":
            continue
        model = bond_body(dim, material, rng=rng)
        u = displacement(model, rng)
        Q = rotation(dim, rng)
        f = model.internal_force(u)
        turned = model.internal_force((model.cloud.x + u) @ Q.T - model.cloud.x)
        assert np.allclose(turned, f @ Q.T, atol=1e-11 * np.abs(f).max()), name


def test_forces_agree_with_numpy(rng):
    """All pairs written out, for every material, in free bodies."""
    for label, model in bond_bodies(rng):
        if model.cloud.images is None:
            u = displacement(model, rng)
            f = reference.bond_forces(model, u)
            assert np.allclose(model.internal_force(u), f, atol=1e-12 * np.abs(f).max()), label


@pytest.mark.parametrize("dim", DIMS)
def test_the_micromodulus_of_a_whole_ball_is_that_of_the_literature(dim):
    """``2 E / d^2``, ``9 E / (pi d^3)`` in plane stress, ``48 E / (5 pi d^3)`` in plane strain, ``12 E / (pi d^4)``."""
    E, d = 7.0, 1.6
    published = {
        (1, "strain"): 2.0 / d**2, (2, "stress"): 9.0 / (np.pi * d**3), (2, "strain"): 48.0 / (5.0 * np.pi * d**3),
        (3, "strain"): 12.0 / (np.pi * d**4),
    }  # fmt: skip
    for plane in ("strain", "stress") if dim == 2 else ("strain",):
        problem = pd.prepare(
            pd.Case(
                particles=pd.Lattice((0.0,) * dim, (2.0,) * dim, 0.5),
                horizon=d,
                material=pd.BondBased(E, plane=plane),
                conditions=[pd.Displacement(pd.region.All(), **dict.fromkeys("xyz"[:dim], 0.0))],
            )
        ).problem
        cloud, families = problem.body.cloud, problem.body.families
        length = np.linalg.norm(families.bonds(cloud.x), axis=1)
        # Of the pair; each end has half of it.
        c = 2.0 * problem.material_term.k * length / 0.5 ** (2 * dim)
        assert np.allclose(c, published[dim, plane] * E, rtol=1e-9)


@pytest.mark.parametrize("dim", DIMS)
def test_uniform_strain_of_a_lattice_has_the_energy_of_its_calibration(dim, rng):
    """Exact in a cell: uniaxial stress of a calibrated lattice, dilation of a linear solid."""
    for plane in ("strain", "stress") if dim == 2 else ("strain",):
        material = pd.BondBased(E=10.0, plane=plane, calibration="lattice")
        model = bond_body(dim, material, cell=True)
        K = dense_tangent(model, np.zeros((model.cloud.n_rows, dim)))
        images, n = model.cloud.images, model.cloud.n_owned * dim
        compliance = np.linalg.pinv(K, rcond=1e-10, hermitian=True)[n:, n:]
        volume = float(np.prod(images.cell.lengths))
        lam, mu = material.elastic(dim).lame(dim)
        C = lam * np.ones((dim, dim)) + 2.0 * mu * np.eye(dim)
        assert volume * compliance[0, 0] / images.sizes[0] ** 2 == pytest.approx(np.linalg.inv(C)[0, 0], rel=1e-12)
    solid = bond_body(dim, pd.LinearSolid(E=10.0, nu=0.1), cell=True)
    u = np.zeros((solid.cloud.n_rows, dim))
    values = np.zeros(u[solid.cloud.n_owned :].size)
    for at, (a, b) in enumerate(solid.cloud.images.cell.components):
        values[at] = 0.01 * solid.cloud.images.sizes[at] if a == b else 0.0
    u[solid.cloud.n_owned :] = values.reshape(-1, dim)
    u[: solid.cloud.n_owned] = 0.01 * solid.cloud.x[: solid.cloud.n_owned]
    kappa = solid.material_term.kappa
    assert np.allclose(solid.material_term.energy_density(solid.at(u)), 0.5 * kappa * (0.01 * dim) ** 2, rtol=1e-12)
    P = solid.material_term.first_piola_stress(solid.at(u))
    assert np.allclose(P, kappa * 0.01 * dim * np.eye(dim), atol=1e-12)


def test_dilation_of_cut_families_has_the_energy_of_whole_ones_with_surface_correction():
    for dim in DIMS:
        corrected, plain = (
            bond_body(dim, pd.BondBased(E=1.0, calibration=name), horizon=1.1) for name in ("family", "lattice")
        )
        psi = corrected.material_term.energy_density(corrected.at(0.01 * corrected.cloud.x))
        assert np.allclose(psi, psi[0], rtol=1e-12)
        uncorrected = plain.material_term.energy_density(plain.at(0.01 * plain.cloud.x))
        assert uncorrected.max() == pytest.approx(psi[0], rel=1e-12)
        assert uncorrected.min() < 0.8 * psi[0]


def test_a_linear_solid_with_the_ratio_of_bonds_is_bond_based(rng):
    """With omega = 1 / |xi| there, nothing is left of the dilatation and the forces are those of bonds."""
    for dim, nu, plane in ((2, 0.25, "strain"), (2, 1.0 / 3.0, "stress"), (3, 0.25, "strain")):
        solid = bond_body(dim, pd.LinearSolid(E=10.0, nu=nu, plane=plane), rng=rng)
        assert (
            np.abs(solid.material_term.B).max() < 1e-12 * np.abs(solid.material_term.kappa * solid.cloud.volume).max()
        )


@pytest.mark.parametrize(
    ("material", "dim", "message"),
    [
        (pd.BondBased(E=1.0, nu=0.3), 2, "ratio 0.25, not 0.3"),
        (pd.BondBased(E=1.0, nu=0.25, plane="stress"), 2, "plane stress has Poisson's ratio 0.3333"),
        (pd.BondBased(E=1.0, nu=0.3), 3, "3D has Poisson's ratio 0.25"),
    ],
)
def test_another_poisson_ratio_is_refused(material, dim, message):
    with pytest.raises(pd.CaseError, match=message):
        bond_body(dim, material)
    fixed = dataclasses.replace(material, nu=1.0 / 3.0 if material.plane == "stress" else 0.25)
    assert bond_body(dim, fixed).material_term.kappa > 0.0


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: pd.BondBased(E=-1.0),
        lambda: pd.BondBased(E=1.0, kinematics="large"),
        lambda: pd.BondBased(E=1.0, calibration="none"),
        lambda: pd.LinearSolid(E=1.0),
        lambda: pd.LinearSolid(E=1.0, nu=0.5),
        lambda: pd.ConstantCritical(0.0),
        lambda: pd.LinearCritical(-1.0, 1.0, 1.0),
        lambda: pd.LinearSoftening(pd.ConstantCritical(1.0), 1.0),
    ],
)
def test_wrong_constants_are_refused(wrong):
    with pytest.raises(pd.CaseError):
        wrong()


def test_inadmissible_deformation_gives_no_force():
    model = bond_body(1, pd.BondBased(E=1.0, kinematics="finite"))
    assert model.internal_force(-model.cloud.x) is None
    assert not model.all_admissible(-model.cloud.x)
    assert bond_body(1, pd.BondBased(E=1.0)).internal_force(-lattice(1)) is not None


def test_every_plane_stress_material_differs_from_plane_strain():
    for name, material in PLANE_STRESS_BONDS.items():
        plane_strain = BONDS[name.removesuffix("_plane_stress")]
        assert bond_body(2, material).material_term.kappa != bond_body(2, plane_strain).material_term.kappa
