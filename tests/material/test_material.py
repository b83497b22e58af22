"""Every material: stress is the energy's derivative, tangent the stress's, both objective, at states with history."""

import math

import numpy as np
import pytest

import pdpetsc as pd
from pdpetsc.material.at_points import MaterialAtPoints
from tests.scenes import MATERIALS, in_plane_stress, material_cases, rotation

STEP = 1e-6
N = 12


def label(case):
    material, dim = case
    return f"{type(material).__name__}-{material.plane}-{dim}D"


def gradients(dim, rng, n=N, size=0.25):
    """Return deformation gradients with det F > 0.2: random ones, the undeformed one and one with equal stretches."""
    F = np.eye(dim) + size * rng.standard_normal((4 * n, dim, dim))
    F = F[np.linalg.det(F) > 0.2][:n]
    return np.concatenate([F, [np.eye(dim), 1.3 * np.eye(dim), np.eye(dim) * (1.0 + 1e-9 * np.arange(1, dim + 1))]])


class Law:
    """A material at as many points as ``gradients`` returns, undeformed ones at first."""

    def __init__(self, material, dim, n=N + 3):
        self.material, self.dim = material, dim
        self._points = MaterialAtPoints(material, np.arange(n), dim, None)
        self._law = self._points.at()

    def _of(self, method, F, shape):
        out = np.empty((len(F), *shape))
        method(np.ascontiguousarray(F), out)
        return out

    def stress(self, F):
        return self._of(self._law.stress, F, (self.dim, self.dim))

    def tangent(self, F):
        return self._of(self._law.tangent, F, (self.dim,) * 4)

    def energy(self, F):
        return self._of(self._law.energy, F, ())

    def commit(self, F):
        self._law.commit(np.ascontiguousarray(F))

    @property
    def history(self):
        return self._points.history.copy()

    def out_of_plane_stress(self, F):
        return self._law.out_of_plane_stress(F)

    def hidden_stretch(self, F):
        return self._law.hidden_stretch(F)

    def plastic_strain(self):
        return self._points.plastic_strain()

    def wander(self, rng, size=0.15):
        """Lead the points on a path and return deformation gradients not far from its end."""
        F = gradients(self.dim, rng)
        if self.material.has_history:
            for _ in range(3):
                self.commit(F)
                F = F @ (np.eye(self.dim) + size * rng.standard_normal(F.shape))
                F[np.linalg.det(F) < 0.2] = 1.1 * np.eye(self.dim)
        return F


@pytest.fixture(params=material_cases(), ids=label)
def law(request):
    return Law(*request.param)


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
    F = law.wander(rng)
    P = law.stress(F)
    assert np.abs(P - derivative(law.energy, F, law.dim)).max() < 1e-7 * max(law.material.E, np.abs(P).max())


def test_tangent_is_the_derivative_of_the_stress(law, rng):
    F = law.wander(rng)
    A = law.tangent(F)
    assert np.abs(A - derivative(law.stress, F, law.dim)).max() < 1e-7 * np.abs(A).max()
    assert np.abs(A - A.transpose(0, 3, 4, 1, 2)).max() < 1e-12 * np.abs(A).max()


def test_rotation_rotates_the_stress_and_keeps_the_energy(law, rng):
    if law.material.linear:
        pytest.skip("a small-strain material is not objective")
    F = law.wander(rng)
    Q = rotation(law.dim, rng)
    P, energy = law.stress(F), law.energy(F)
    assert np.allclose(law.stress(Q @ F), Q @ P, atol=1e-11 * law.material.E)
    assert np.allclose(law.energy(Q @ F), energy, rtol=1e-10)
    # What is remembered of a turned body is what is remembered of the body.
    law.commit(Q @ F)
    assert np.allclose(law.stress(Q @ F), Q @ P, atol=1e-11 * law.material.E)
    assert np.allclose(law.stress(F), P, atol=1e-11 * law.material.E)


def test_a_state_that_has_been_taken_is_the_same_state(law, rng):
    """Stress and energy of a step do not change when the step ends, and nothing but its end changes the history."""
    F = law.wander(rng)
    before = law.history
    P, energy = law.stress(F), law.energy(F)
    law.tangent(F)
    law.stress(1.1 * F)
    assert np.array_equal(law.history, before)
    law.commit(F)
    assert np.array_equal(law.history, before) != law.material.has_history
    assert np.allclose(law.stress(F), P, atol=1e-11 * law.material.E)
    assert np.allclose(law.energy(F), energy, rtol=1e-10, atol=1e-12 * law.material.E)


def test_small_strains_give_the_linear_law(law, rng):
    dim, material = law.dim, law.material
    strain = rng.standard_normal((dim, dim))
    strain = 0.5 * (strain + strain.T)
    lam, mu = material.lame(dim)
    F = np.tile(np.eye(dim) + 1e-7 * strain, (N + 3, 1, 1))
    P = law.stress(F)[0] / 1e-7
    assert np.allclose(P, lam * np.trace(strain) * np.eye(dim) + 2.0 * mu * strain, rtol=1e-5, atol=1e-5 * material.E)


def test_hencky_bar_has_the_closed_form_of_a_uniaxial_test():
    P = Law(pd.Hencky(E=10.0, nu=0.3), 1, 1).stress(np.array([[[1.7]]]))
    assert P[0, 0, 0] == pytest.approx(10.0 * np.log(1.7) / 1.7, rel=1e-14)


def test_plane_stress_and_bar_are_the_solid_with_free_sides(rng):
    """Pull the solid sideways until its lateral stress is zero; the reduced laws must agree with it."""
    from scipy.optimize import brentq

    for material in MATERIALS.values():
        if in_plane_stress(material) is None:
            continue
        solid = Law(material, 3, 1)

        def lateral(F, d, b, solid=solid):
            full = np.eye(3)
            full[:d, :d] = F
            full[range(d, 3), range(d, 3)] = b
            return solid.stress(full[None])[0], full

        for dim, reduced in ((1, material), (2, in_plane_stress(material))):
            F = np.eye(dim) + 0.1 * rng.standard_normal((dim, dim))
            b = brentq(lambda b, F=F, dim=dim: lateral(F, dim, b)[0][2, 2], 0.3, 2.5, xtol=1e-15)
            P = Law(reduced, dim, 1).stress(F[None])[0]
            assert np.allclose(lateral(F, dim, b)[0][:dim, :dim], P, atol=1e-10 * material.E)
            if not material.linear:
                assert Law(reduced, dim, 1).hidden_stretch(F[None])[0] == pytest.approx(b ** (3 - dim), rel=1e-9)


@pytest.mark.parametrize(
    "values",
    [{"E": -1.0}, {"E": np.nan}, {"E": 1e300}, {"E": 1e-300}, {"E": 1.0, "nu": 0.5}, {"E": 1.0, "plane": "strip"}],
)
def test_constants_out_of_range_are_refused(values):
    with pytest.raises(pd.CaseError, match="Hencky"):
        pd.Hencky(**{"nu": 0.0, **values})


@pytest.mark.parametrize(
    ("law", "given", "missing"),
    [
        (pd.Hencky, {}, "nu"),
        (pd.J2, {"nu": 0.3}, "yield_stress"),
        (pd.DruckerPrager, {"nu": 0.3, "cohesion": 1.0}, "friction"),
        (pd.Maxwell, {"nu": 0.3, "shear": [0.5]}, "times"),
    ],
)
def test_constants_of_a_body_have_no_default(law, given, missing):
    with pytest.raises(TypeError, match=missing):
        law(E=1.0, **given)


@pytest.mark.parametrize("name", MATERIALS)
def test_stress_in_and_across_the_plane_is_that_of_the_solid(name, rng):
    plane, solid = Law(MATERIALS[name], 2), Law(MATERIALS[name], 3)
    F = gradients(2, rng)
    for _ in range(4):
        full = np.tile(np.eye(3), (len(F), 1, 1))
        full[:, :2, :2] = F
        P = solid.stress(full)
        assert np.allclose(plane.stress(F), P[:, :2, :2], atol=1e-10)
        assert np.allclose(plane.out_of_plane_stress(F), P[:, 2, 2], atol=1e-10)
        plane.commit(F)
        solid.commit(full)
        assert np.allclose(plane.plastic_strain(), solid.plastic_strain(), atol=1e-12)
        F = F @ (np.eye(2) + 0.05 * rng.standard_normal(F.shape))
    assert np.array_equal(plane.history, Law(MATERIALS[name], 2).history) != plane.material.has_history


@pytest.mark.parametrize("dim", [1, 2])
def test_a_body_without_a_thickness_has_no_stress(dim):
    """Saint Venant and Kirchhoff's lateral strain falls to that of a thickness of zero at a finite stretch."""
    law = pd.SaintVenantKirchhoff(10.0, 0.3, "stress")
    # Uniaxial: 1 - 2 nu E_11 = 0.
    limit = math.sqrt(1.0 + 1.0 / 0.3)
    free = np.empty((1, 0))
    for share in (0.99, 1.01):
        along = 0.5 * ((share * limit) ** 2 - 1.0)
        lateral = math.sqrt(max(1.0 - 2.0 * 0.3 * along, 0.01))
        F = np.diag([share * limit, lateral])[None, :dim, :dim]
        assert law.defined(F, np.zeros(1, dtype=np.int64), free) == (share < 1.0)
        assert np.isfinite(law.hidden_stretch(F, free)[0]) == (share < 1.0)


def test_a_lateral_stretch_that_is_nowhere_is_no_number():
    """With a negative Poisson's ratio: ``mu (b^2 - 1) + lambda ln J`` is positive for all b where F is small."""
    law = Law(pd.NeoHookean(10.0, -0.5, "stress"), 2, 1)
    assert np.isfinite(law.stress(0.8 * np.eye(2)[None])).all()
    assert np.isnan(law.stress(0.3 * np.eye(2)[None])).all()
    assert np.isnan(law.hidden_stretch(0.3 * np.eye(2)[None])).all()
