"""Anisotropic linear elasticity: off-axis moduli, isotropic limit, bodies of lower dimension, orientation by place."""

import dataclasses

import numpy as np
import pytest

import pdpetsc as pd
from pdpetsc.material.at_points import MaterialAtPoints
from tests.commands import script_on, summary
from tests.material.test_hyperelastic import BODIES, strip
from tests.material.test_material import Law, derivative
from tests.scenes import rotation

PLY = pd.Orthotropic(E=(14.0, 2.0, 1.5), nu=(0.3, 0.4, 0.25), G=(0.8, 0.5, 0.6))


def strained(dim, rng, n=6, size=0.01):
    return np.eye(dim) + size * rng.standard_normal((n, dim, dim))


@pytest.mark.parametrize(("dim", "plane"), BODIES)
def test_equal_constants_are_the_isotropic_law(dim, plane, rng):
    E, nu = 10.0, 0.3
    G = 0.5 * E / (1.0 + nu)
    isotropic = pd.LinearElastic(E, nu, plane)
    material = pd.Orthotropic((E, E, E), (nu, nu, nu), (G, G, G), orientation=0.7, plane=plane)
    F = strained(dim, rng)
    one, other = Law(isotropic, dim, len(F)), Law(material, dim, len(F))
    for quantity in ("stress", "tangent", "energy", "out_of_plane_stress"):
        assert np.allclose(getattr(one, quantity)(F), getattr(other, quantity)(F), rtol=1e-11, atol=1e-14), quantity
    if dim < 3:
        assert np.allclose(isotropic.thickness_stretch(F), material.hidden_stretch(F, other.history), rtol=1e-14)
    assert np.allclose(material.moduli(dim), isotropic.moduli(dim))
    assert material.bulk_like_modulus(dim) == pytest.approx(isotropic.bulk_like_modulus(dim), rel=1e-12)


@pytest.mark.parametrize(("dim", "plane"), BODIES)
def test_stress_and_tangent_are_derivatives(dim, plane, rng):
    axes = rotation(3, rng)
    law = Law(dataclasses.replace(PLY, orientation=axes.tolist(), plane=plane), dim, 6)
    F = strained(dim, rng)
    P, A = law.stress(F), law.tangent(F)
    assert np.abs(P - derivative(law.energy, F, dim)).max() < 1e-8
    assert np.abs(A - derivative(law.stress, F, dim)).max() < 1e-8 * np.abs(A).max()
    assert np.allclose(A, A.transpose(0, 3, 4, 1, 2)) and np.allclose(P, P.transpose(0, 2, 1))
    assert np.abs(law.stress(np.tile(np.eye(dim), (6, 1, 1)))).max() == 0.0


@pytest.mark.parametrize("angle", [0.0, 0.4, 1.2, -0.8])
def test_a_ply_has_the_modulus_of_its_angle(angle):
    """1 / E_x = c^4 / E_1 + s^4 / E_2 + (1 / G_12 - 2 nu_12 / E_1) c^2 s^2 in plane stress and in a bar."""
    (E1, E2, _), (nu12, _, _), (G12, _, _) = PLY.E, PLY.nu, PLY.G
    c, s = np.cos(angle), np.sin(angle)
    compliance = c**4 / E1 + s**4 / E2 + (1.0 / G12 - 2.0 * nu12 / E1) * c**2 * s**2
    turned = dataclasses.replace(PLY, orientation=angle, plane="stress")
    A = turned.moduli(2)
    plane = np.array([[A[i, j, k, l] for k, l in ((0, 0), (1, 1), (0, 1))] for i, j in ((0, 0), (1, 1), (0, 1))])
    assert np.linalg.inv(plane)[0, 0] == pytest.approx(compliance, rel=1e-12)
    assert 1.0 / turned.moduli(1)[0, 0, 0, 0] == pytest.approx(compliance, rel=1e-12)


def test_a_turned_material_is_the_material_in_a_turned_body(rng):
    Q, F = rotation(3, rng), strained(3, rng)
    turned = Law(dataclasses.replace(PLY, orientation=Q.tolist()), 3, 6)
    assert np.allclose(turned.stress(Q @ F @ Q.T), Q @ Law(PLY, 3, 6).stress(F) @ Q.T, atol=1e-13)
    same = pd.AnisotropicElastic(PLY.in_own_axes().tolist(), orientation=Q.tolist())
    assert np.allclose(Law(same, 3, 6).stress(F), turned.stress(F), atol=1e-13)


def test_plane_bodies_are_the_solid(rng):
    F = strained(2, rng)
    full = np.tile(np.eye(3), (6, 1, 1))
    full[:, :2, :2] = F
    solid = Law(dataclasses.replace(PLY, orientation=0.6), 3, 6)
    strain = Law(dataclasses.replace(PLY, orientation=0.6), 2, 6)
    P = solid.stress(full)
    assert np.allclose(strain.stress(F), P[:, :2, :2], atol=1e-14)
    assert np.allclose(strain.out_of_plane_stress(F), P[:, 2, 2], atol=1e-14)
    free = Law(dataclasses.replace(PLY, orientation=0.6, plane="stress"), 2, 6)
    full[:, 2, 2] = free.material.hidden_stretch(F, free.history)
    P = solid.stress(full)
    assert np.allclose(free.stress(F), P[:, :2, :2], atol=1e-14)
    assert np.abs(P[:, 2]).max() < 1e-14
    assert np.allclose(free.out_of_plane_stress(F), 0.0)


def wavy(x):
    """Return angles, and nothing for places outside of the strip."""
    if x.max() > 8.0 or x.min() < 0.25:
        raise ValueError("outside")
    return 0.2 * x[:, 0]


SEVERAL = """
import dataclasses, sys
import pdpetsc as pd
from tests.material.test_anisotropic import PLY, strip, wavy
pd.run(strip(dataclasses.replace(PLY, orientation=wavy)), output=sys.argv[1])
"""


def test_orientation_may_follow_a_function_of_place(tmp_path):
    def force(orientation, name):
        return pd.run(strip(dataclasses.replace(PLY, orientation=orientation)), output=tmp_path / name)["force"]

    constant = force(0.5, "a")
    assert force(lambda x: np.full(len(x), 0.5), "b") == pytest.approx(constant, rel=1e-9)
    turn = [[np.cos(0.5), -np.sin(0.5), 0.0], [np.sin(0.5), np.cos(0.5), 0.0], [0.0, 0.0, 1.0]]
    assert force(lambda x: np.tile(turn, (len(x), 1, 1)), "c") == pytest.approx(constant, rel=1e-9)
    field = force(wavy, "d")
    assert field != pytest.approx(constant, rel=1e-2)
    script_on(2, SEVERAL, tmp_path / "e")
    found = summary(tmp_path / "e")["results"]["force"]
    assert found == pytest.approx(field, rel=1e-9)


def test_one_tangent_serves_all_points_only_where_their_axes_agree(rng):
    F, x = strained(2, rng), rng.random((6, 2))
    places, turned = np.arange(6), dataclasses.replace(PLY, orientation=lambda x: 0.2 * x[:, 0])
    assert MaterialAtPoints(turned, places, 2, None, x).at().same_tangent(F) is None
    same = MaterialAtPoints(PLY, places, 2, None, x).at()
    A = np.empty((6, 2, 2, 2, 2))
    same.tangent(F, A)
    assert np.allclose(same.same_tangent(F), A, rtol=1e-14)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"E": (1.0, -1.0, 1.0)}, "positive moduli"),
        ({"nu": (0.9, 0.9, 0.9), "E": (1.0, 1.0, 1.0)}, "no positive definite stiffness"),
        ({"orientation": [[1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 1.0]]}, "orthogonal unit vectors"),
        ({"orientation": [[1.0, 0.0]]}, "one angle or one matrix"),
        ({"plane": "strip"}, "plane"),
    ],
)
def test_what_is_no_material_is_refused(changes, message):
    with pytest.raises(pd.CaseError, match=message):
        dataclasses.replace(PLY, **changes)


@pytest.mark.parametrize(
    ("orientation", "message"),
    [
        (lambda x: np.ones((len(x), 2)), "must return one angle or one matrix"),
        (lambda x: np.ones((len(x), 3, 3)), "orthogonal unit vectors"),
        (lambda x: 1 / 0, "failed"),
    ],
)
def test_wrong_orientations_of_a_body_are_refused(orientation, message):
    with pytest.raises(pd.CaseError, match=message):
        pd.prepare(strip(dataclasses.replace(PLY, orientation=orientation)))


def test_a_stiffness_must_be_one():
    C = PLY.in_own_axes()
    for wrong, message in ((C[:5], "6 rows of 6"), (C + np.triu(C), "not symmetric"), (-C, "not positive definite")):
        with pytest.raises(pd.CaseError, match=message):
            pd.AnisotropicElastic(wrong.tolist())
    with pytest.raises(pd.CaseError, match="another Young's modulus"):
        pd.prepare(strip(PLY, damage=pd.Brittle(pd.FractureEnergy(0.5))))
