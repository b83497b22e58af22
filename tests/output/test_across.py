"""Tensors on disk have what a line or plane body does across itself."""

import dataclasses

import h5py
import numpy as np
import pytest

import pdpetsc as pd
from pdpetsc.declare import region

E, NU, STRAIN = 1000.0, 0.3, 0.02


def stretched(dim, material, **others):
    """Return a body in which every displacement is prescribed: uniform strain along x, none along y."""
    sizes = [2.0, 1.0][:dim]
    held = {axis: 0.0 for axis in "xyz"[1:dim]}
    return pd.Case(
        particles=pd.Lattice([0.0] * dim, sizes, 0.25),
        horizon=0.3,
        material=material,
        conditions=[pd.Displacement(region.All(), x=lambda x, t: t * STRAIN * x[:, 0], **held)],
        fields=[pd.displacement, pd.stress, pd.first_piola_stress, pd.deformation_gradient],
        **others,
    )


def tensors(case, folder):
    """Return mean stress, P and F of the last step as they are on disk, (3, 3) each."""
    pd.run(case, output=folder)
    with h5py.File(folder / "fields.h5") as file:
        step = file["step_00001"]
        names = ("stress", "first_piola_stress", "deformation_gradient")
        return [np.asarray(step[name]).mean(axis=0).reshape(3, 3) for name in names]


def test_plane_strain_has_a_stress_across_the_plane(tmp_path):
    sigma, P, F = tensors(stretched(2, pd.LinearElastic(E=E, nu=NU)), tmp_path)
    assert sigma[2, 2] == pytest.approx(NU * (sigma[0, 0] + sigma[1, 1]), rel=1e-10)
    assert P[2, 2] == pytest.approx(sigma[2, 2])
    assert F[2, 2] == pytest.approx(1.0)
    assert sigma[0, 2] == sigma[2, 1] == 0.0


def test_hencky_in_plane_strain(tmp_path):
    material = pd.Hencky(E=E, nu=NU)
    sigma, P, F = tensors(stretched(2, material), tmp_path)
    J = 1.0 + STRAIN
    across = material.lame(3)[0] * np.log(J)
    assert P[2, 2] == pytest.approx(across, rel=1e-10)
    assert sigma[2, 2] == pytest.approx(across / J, rel=1e-10)
    assert F[2, 2] == pytest.approx(1.0)


def test_plane_stress_has_a_stretch_instead(tmp_path):
    sigma, P, F = tensors(stretched(2, pd.Hencky(E=E, nu=NU, plane="stress")), tmp_path)
    assert sigma[2, 2] == P[2, 2] == 0.0
    assert F[2, 2] == pytest.approx((1.0 + STRAIN) ** (-NU / (1.0 - NU)), rel=1e-10)


def test_a_bar_becomes_thinner_both_ways(tmp_path):
    _, _, F = tensors(stretched(1, pd.Hencky(E=E, nu=NU)), tmp_path)
    assert F[1, 1] == F[2, 2] == pytest.approx((1.0 + STRAIN) ** -NU, rel=1e-10)


def test_bonds_in_plane_strain(tmp_path):
    sigma, _, _ = tensors(stretched(2, pd.BondBased(E=E)), tmp_path)
    assert sigma[2, 2] == pytest.approx(0.25 * (sigma[0, 0] + sigma[1, 1]), rel=1e-10)


def test_graded_moduli_scale_it(tmp_path):
    twice = pd.Graded(pd.LinearElastic(E=E, nu=NU), lambda x: np.full(len(x), 2.0))
    plain, graded = (tensors(stretched(2, m), tmp_path / n)[0] for n, m in (("1", twice.material), ("2", twice)))
    assert graded[2, 2] == pytest.approx(2.0 * plain[2, 2], rel=1e-12)


def test_damage_scales_it(tmp_path):
    damage = pd.LinearSoftening(pd.ConstantCritical(0.01), 4.0)
    case = stretched(2, pd.LinearElastic(E=E, nu=NU))
    sigma, _, _ = tensors(dataclasses.replace(case, damage=damage, scheme=pd.Correspondence()), tmp_path)
    assert 0.0 < sigma[2, 2] == pytest.approx(NU * (sigma[0, 0] + sigma[1, 1]), rel=1e-10)


def test_a_field_under_another_name_is_the_same_field(tmp_path):
    case = stretched(2, pd.LinearElastic(E=E, nu=NU))
    plain, _, _ = tensors(case, tmp_path / "plain")
    pd.run(dataclasses.replace(case, fields={"sigma": pd.stress}), output=tmp_path / "named")
    with h5py.File(tmp_path / "named" / "fields.h5") as file:
        named = np.asarray(file["step_00001/sigma"]).mean(axis=0).reshape(3, 3)
    assert np.array_equal(named, plain)


def test_a_field_that_cannot_be_hashed_is_written(tmp_path):
    class Twice:
        __hash__ = None

        def __call__(self, solution):
            return 2.0 * pd.displacement(solution)

    case = dataclasses.replace(stretched(2, pd.LinearElastic(E=E, nu=NU)), fields={"twice": Twice()})
    found = pd.run(case, tmp_path).field("twice")
    assert np.abs(found).max() == pytest.approx(2.0 * STRAIN * 1.875)
