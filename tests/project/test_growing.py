"""CONTRIBUTING's recipe, walked from outside the package with toys: material with history, scheme, control, damage law.

Each is a class in ``tests/toys.py`` and takes the property tests of its kind as they are; then all are run.
"""

import itertools
import shutil

import numpy as np
import pytest

import pdpetsc as pd
from tests.commands import field, jacobian_ratios, printed, results
from tests.control import test_control
from tests.damage import test_damage
from tests.gradient import test_gradient
from tests.material import test_material
from tests.scenes import DIMS, LAWS, body, dense_tangent, differences, displacement
from tests.toys import BACK, TOP, TURN, NearestCount, NearestHeld, ParabolicSoftening, Wearing, case

TOYS = "tests/toys.py"


class TestMaterial:
    @pytest.fixture(params=DIMS)
    def law(self, request):
        return test_material.Law(Wearing(E=10.0, nu=0.3, wear=1.0), request.param)

    test_energy = staticmethod(test_material.test_stress_is_the_derivative_of_the_energy)
    test_tangent = staticmethod(test_material.test_tangent_is_the_derivative_of_the_stress)
    test_rotation = staticmethod(test_material.test_rotation_rotates_the_stress_and_keeps_the_energy)
    test_history = staticmethod(test_material.test_a_state_that_has_been_taken_is_the_same_state)
    test_linear = staticmethod(test_material.test_small_strains_give_the_linear_law)

    def test_plane(self, monkeypatch, rng):
        monkeypatch.setitem(test_material.MATERIALS, "toy", Wearing(E=10.0, nu=0.3, wear=1.0))
        test_material.test_stress_in_and_across_the_plane_is_that_of_the_solid("toy", rng)


class TestScheme:
    @pytest.fixture(params=DIMS)
    def model(self, request, rng):
        return body(request.param, NearestCount(), rng=rng)

    test_affine = staticmethod(test_gradient.test_affine_displacements_have_their_exact_gradient)
    test_loops = staticmethod(test_gradient.test_loops_agree_with_numpy)
    test_volumes = staticmethod(test_gradient.test_quadrature_volumes_add_up_to_the_particles)

    def test_the_tangent_of_a_body_with_history_agrees_with_differences(self, rng):
        model = body(2, NearestCount(), NearestHeld(), Wearing(E=10.0, nu=0.3, wear=1.0), rng=rng)
        model.commit(displacement(model, rng, 0.1))
        u = displacement(model, rng, 0.1)
        K = dense_tangent(model, u)
        every = np.arange(u.size)
        assert np.abs(K - differences(model, u, every)).max() < 1e-7 * np.abs(K).max()
        assert np.abs(K - K.T).max() < 1e-13 * np.abs(K).max()

    @pytest.mark.parametrize("patch", [("hydrostatic", "loading=consistent"), ("tension", "dim=3", "n=6")])
    def test_its_word_in_the_table_is_all_that_the_patch_tests_need(self, patch, monkeypatch, tmp_path):
        monkeypatch.setitem(pd.SCHEMES, "nearest", NearestCount())
        found = results(f"runs/patch/{patch[0]}.py", *patch[1:], "scheme=nearest", "horizon=2.015", output=tmp_path)
        assert found["results"]["max_F_error"] < 1e-10


class TestControl:
    @pytest.fixture(params=DIMS)
    def model(self, request, rng):
        return body(request.param, control=NearestHeld(), rng=rng)

    test_matrix = staticmethod(test_control.test_matrix_is_the_force_of_unit_displacements)

    def test_affine_displacements_meet_no_force(self, model, rng):
        u = model.cloud.x @ rng.standard_normal((model.dim, model.dim)).T
        f, energy = test_control.control_force(model, u)
        assert np.abs(f).max() < 1e-12
        assert energy < 1e-24
        assert test_control.control_force(model, displacement(model, rng))[1] > 1e-6

    def test_a_checkerboard_is_resisted(self):
        test_control.test_checkerboard_in_a_cube_is_resisted(NearestHeld())


class TestDamageLaw:
    def test_slope_and_energy(self):
        test_damage.test_laws_fall_from_one_and_have_the_right_slope_and_energy(ParabolicSoftening)

    @pytest.mark.parametrize("scheme", ["correspondence", "sub_horizons"])
    def test_tangent(self, scheme, monkeypatch, rng):
        monkeypatch.setitem(LAWS, "toy", ParabolicSoftening)
        test_damage.test_the_tangent_with_softening_bonds_is_exact(2, scheme, "toy", rng)
        test_damage.test_the_tangent_of_softening_bonds_is_exact_and_symmetric("toy", rng)

    def test_a_bar_stretched_evenly_follows_it(self, tmp_path):
        """Every bond at x times its critical stretch: force E s T(x)."""
        critical, x = 0.01, np.array([0.8, 1.6, 2.4])
        ends = pd.region.Slab("x", low=10.0)
        law = ParabolicSoftening(pd.ConstantCritical(critical))
        bar = pd.Case(
            particles=pd.Lattice(0.0, 20.0, 1.0),
            horizon=1.015,
            material=pd.BondBased(10.0, calibration="lattice"),
            damage=law,
            conditions=[pd.Displacement(pd.region.All(), x=lambda X, t: 3.0 * x[0] * critical * t * X[:, 0])],
            steps=pd.Steps(3),
            history={"force": pd.Reaction("x", ends)},
            results=lambda h: {str(step): h["force"][step] for step in (-3, -2, -1)},
        )
        found = pd.run(bar, tmp_path)
        T = np.where(x > 1.0, law.phi(x), 1.0)
        assert [found[str(step)] for step in (-3, -2, -1)] == pytest.approx(10.0 * critical * x * T, rel=1e-9)


def closed_form(material, height=3.0):
    """Return the force of the strip without shear after both strains."""
    green = [strain + 0.5 * strain**2 for strain in (TOP, BACK)]
    return material.E * height * (1.0 + BACK) * green[1] * np.exp(-green[0] / material.wear)


@pytest.mark.parametrize("scheme", ["sub_horizons", "nearest"])
def test_a_strip_of_it_has_the_closed_form(scheme, tmp_path):
    found = results(TOYS, f"scheme={scheme}", output=tmp_path)["results"]
    assert found["force"] == pytest.approx(closed_form(Wearing(E=10.0, nu=0.0)), rel=1e-9)


def test_petsc_finds_its_jacobian_correct_on_two_ranks(tmp_path):
    words = ("scheme=nearest", "shear=0.3", "steps=3")
    ratios = jacobian_ratios(printed(TOYS, *words, "-snes_test_jacobian", ranks=2, output=tmp_path / "two"))
    assert len(ratios) >= 6
    assert max(ratios) < 1e-6
    results(TOYS, *words, output=tmp_path / "one")
    for name in ("displacement", "first_piola_stress"):
        one, two = (field(tmp_path / folder, name) for folder in ("one", "two"))
        assert np.abs(one - two).max() <= 1e-8 * np.abs(one).max(), name


@pytest.mark.long
def test_it_goes_on_from_its_checkpoint_on_other_ranks(tmp_path):
    """Stopped while it is unloaded: what it remembers decides how it goes on."""
    words = {"scheme": "nearest", "shear": 0.3}
    pd.run(case(**words), tmp_path / "whole")
    with pytest.raises(pd.Interrupted):
        pd.run(case(**words, stop=TURN + 0.15), tmp_path / "half")
    shutil.copytree(tmp_path / "half", tmp_path / "other")
    pd.run(case(**words), tmp_path / "half", restart=tmp_path / "half")
    arguments = [f"{name}={value}" for name, value in words.items()]
    results(TOYS, *arguments, "--restart", tmp_path / "other", ranks=2, output=tmp_path / "other")
    for folder, name in itertools.product(("half", "other"), ("displacement", "first_piola_stress")):
        one, two = field(tmp_path / "whole", name), field(tmp_path / folder, name)
        assert np.abs(one - two).max() <= 1e-10 * np.abs(one).max(), (folder, name)


def test_a_material_that_forgets_is_found_out(monkeypatch, tmp_path):
    """The tests above can fail: without its history the strip ends where loading to the end alone leads it."""
    monkeypatch.setattr("tests.toys._commit", lambda *_: None)
    found = pd.run(case(), tmp_path)
    assert found["force"] > 1.1 * closed_form(Wearing(E=10.0, nu=0.0))
