"""Every material: stress is the energy's derivative, tangent the stress's, and both are objective."""

import numpy as np
import pytest

import pdpetsc as pd
from tests.scenes import MATERIALS, material_cases, rotation

STEP = 1e-6


def label(case):
    material, dim = case
    return f"{type(material).__name__}-{material.plane}-{dim}D"


@pytest.fixture(params=material_cases(), ids=label)
def law(request):
    material, dim = request.param
    return material, dim, material.kernels(dim), material.constants(dim)


def gradients(dim, rng, n=12, size=0.25):
    """Return deformation gradients with det F > 0.2: random ones, the undeformed one and one with equal stretches."""
    F = np.eye(dim) + size * rng.standard_normal((4 * n, dim, dim))
    F = F[np.linalg.det(F) > 0.2][:n]
    return np.concatenate([F, [np.eye(dim), 1.3 * np.eye(dim), np.eye(dim) * (1.0 + 1e-9 * np.arange(1, dim + 1))]])


def evaluate(kernel, F, constants, shape):
    out = np.empty((len(F), *shape))
    kernel(F, np.arange(len(F)), constants, out)
    return out


def derivative(function, F, dim):
    """Return the central difference of ``function`` with respect to F, in the last two axes."""
    columns = []
    for i in range(dim):
        for j in range(dim):
            d = np.zeros((dim, dim))
            d[i, j] = STEP
            columns.append((function(F + d) - function(F - d)) / (2.0 * STEP))
    stacked = np.stack(columns, axis=-1)
    return stacked.reshape(*stacked.shape[:-1], dim, dim)


def test_stress_is_the_derivative_of_the_energy(law, rng):
    material, dim, kernels, constants = law
    F = gradients(dim, rng)
    P = evaluate(kernels.stress, F, constants, (dim, dim))
    difference = derivative(lambda F: evaluate(kernels.energy, F, constants, ()), F, dim)
    assert np.abs(P - difference).max() < 1e-7 * max(material.E, np.abs(P).max())


def test_tangent_is_the_derivative_of_the_stress(law, rng):
    _, dim, kernels, constants = law
    F = gradients(dim, rng)
    A = evaluate(kernels.tangent, F, constants, (dim,) * 4)
    difference = derivative(lambda F: evaluate(kernels.stress, F, constants, (dim, dim)), F, dim)
    assert np.abs(A - difference).max() < 1e-7 * np.abs(A).max()
    assert np.abs(A - A.transpose(0, 3, 4, 1, 2)).max() < 1e-12 * np.abs(A).max()


def test_rotation_rotates_the_stress_and_keeps_the_energy(law, rng):
    material, dim, kernels, constants = law
    if material.linear:
        pytest.skip("a small-strain material is not objective")
    F = gradients(dim, rng)
    Q = rotation(dim, rng)
    P = evaluate(kernels.stress, F, constants, (dim, dim))
    assert np.allclose(evaluate(kernels.stress, Q @ F, constants, (dim, dim)), Q @ P, atol=1e-11 * material.E)
    assert np.allclose(
        evaluate(kernels.energy, Q @ F, constants, ()), evaluate(kernels.energy, F, constants, ()), rtol=1e-10
    )


def test_small_strains_give_the_linear_law(law, rng):
    material, dim, kernels, constants = law
    strain = rng.standard_normal((dim, dim))
    strain = 0.5 * (strain + strain.T)
    lam, mu = material.lame(dim)
    P = evaluate(kernels.stress, (np.eye(dim) + 1e-7 * strain)[None], constants, (dim, dim))[0] / 1e-7
    assert np.allclose(P, lam * np.trace(strain) * np.eye(dim) + 2.0 * mu * strain, rtol=1e-5, atol=1e-5 * material.E)


def test_hencky_bar_has_the_closed_form_of_a_uniaxial_test():
    material = pd.Hencky(E=10.0, nu=0.3)
    P = evaluate(material.kernels(1).stress, np.array([[[1.7]]]), material.constants(1), (1, 1))
    assert P[0, 0, 0] == pytest.approx(10.0 * np.log(1.7) / 1.7, rel=1e-14)


def test_plane_stress_and_bar_are_the_solid_with_free_sides(rng):
    """Pull the solid sideways until its lateral stress is zero; the reduced laws must agree with it."""
    from scipy.optimize import brentq

    for material in MATERIALS.values():
        solid, c3 = material.kernels(3), material.constants(3)

        def lateral(F, d, b, solid=solid, c3=c3):
            full = np.eye(3)
            full[:d, :d] = F
            full[range(d, 3), range(d, 3)] = b
            return evaluate(solid.stress, full[None], c3, (3, 3))[0], full

        for dim, reduced in ((1, material), (2, type(material)(material.E, material.nu, "stress"))):
            F = np.eye(dim) + 0.1 * rng.standard_normal((dim, dim))
            b = brentq(lambda b, F=F, dim=dim: lateral(F, dim, b)[0][2, 2], 0.3, 2.5, xtol=1e-15)
            P = evaluate(reduced.kernels(dim).stress, F[None], reduced.constants(dim), (dim, dim))[0]
            assert np.allclose(lateral(F, dim, b)[0][:dim, :dim], P, atol=1e-10 * material.E)
            if not material.linear:
                assert reduced.thickness_stretch(F[None])[0] == pytest.approx(b ** (3 - dim), rel=1e-9)


@pytest.mark.parametrize(
    "values",
    [{"E": -1.0}, {"E": np.nan}, {"E": 1e300}, {"E": 1e-300}, {"E": 1.0, "nu": 0.5}, {"E": 1.0, "plane": "strip"}],
)
def test_constants_out_of_range_are_refused(values):
    with pytest.raises(pd.CaseError, match="Hencky"):
        pd.Hencky(**values)


@pytest.mark.parametrize("name", MATERIALS)
def test_stress_across_the_plane_is_that_of_the_solid(name, rng):
    material = MATERIALS[name]
    F = gradients(2, rng)
    solid = np.tile(np.eye(3), (len(F), 1, 1))
    solid[:, :2, :2] = F
    P = evaluate(material.kernels(3).stress, solid, material.constants(3), (3, 3))
    assert np.allclose(material.out_of_plane_stress(F), P[:, 2, 2], atol=1e-12 * material.E, rtol=1e-12)


def test_plastic_stress_across_the_plane_is_that_of_the_solid(rng):
    material = pd.J2(E=10.0, nu=0.3, yield_stress=0.3, hardening=1.0)
    solid_history = material.initial_history(3, 20)
    history = material.initial_history(2, 20)
    kernels, solid_kernels = material.history_kernels(2), material.history_kernels(3)
    every = np.arange(20)
    for _ in range(4):
        F = np.eye(2) + 0.1 * rng.standard_normal((20, 2, 2))
        solid = np.tile(np.eye(3), (20, 1, 1))
        solid[:, :2, :2] = F
        P = np.empty((20, 3, 3))
        solid_kernels.stress(solid, every, material.constants(3), solid_history, P)
        assert np.allclose(material.out_of_plane_stress(F, history), P[:, 2, 2], atol=1e-10)
        kernels.commit(F, every, material.constants(2), history)
        solid_kernels.commit(solid, every, material.constants(3), solid_history)
    assert material.plastic_strain(history).min() > 0.0
