"""Orders of convergence: conforming weights are of second order on any cloud, standard ones are not."""

import json
import sys

import meshio
import numpy as np
import pytest

import pdpetsc as pd
from tests.commands import ROOT, results

FOLDER = ROOT / "runs" / "convergence"
sys.path.insert(0, str(FOLDER))
import bending
import circle
import common
import cook_elements
import hole
import inflation
import manufactured
import ring
import rings

SILLING = ("scheme=correspondence", "horizon=2.015", "G=0.5")
SUB_HORIZONS = ("scheme=sub_horizons", "horizon=1.5", "G=0")
BOTH = pytest.mark.parametrize("method", [SILLING, SUB_HORIZONS], ids=["silling", "sub_horizons"])
SQUARES = pytest.mark.parametrize("name", ["bending", "manufactured"])
# One shaken cloud scatters; the root of the mean square over these does less.
SEEDS = (0, 1, 2)


def errors(tmp_path, name, sizes, *words, seeds=(0,), error="error_u"):
    """Return the root of the mean square of an error over the seeds, for every size."""
    found = [
        [
            results(FOLDER / f"{name}.py", f"n={n}", f"seed={seed}", *words, output=tmp_path)["results"][error]
            for seed in seeds
        ]
        for n in sizes
    ]
    return np.sqrt(np.mean(np.square(found), axis=1))


def order(sizes, values):
    return -np.polyfit(np.log(sizes), np.log(values), 1)[0]


@pytest.mark.long
@SQUARES
@BOTH
def test_conforming_weights_are_of_second_order_on_shaken_clouds_and_standard_ones_are_not(name, method, tmp_path):
    sizes = (8, 16, 32)
    conforming, standard = (
        errors(tmp_path, name, sizes, "shake=0.2", f"weights={weights}", *method, seeds=SEEDS)
        for weights in ("conforming", "standard")
    )
    assert order(sizes, conforming) > 1.8
    # What is left is of the weights: from the second size on it hardly falls.
    assert order(sizes[1:], standard[1:]) < 1.0
    assert standard[-1] > 5.0 * conforming[-1]


@SQUARES
@BOTH
def test_conforming_weights_are_of_second_order_on_lattices(name, method, tmp_path):
    sizes = (12, 24)
    assert order(sizes, errors(tmp_path, name, sizes, *method)) > 1.9


@pytest.mark.long
@SQUARES
def test_the_stress_of_shaken_clouds_is_of_first_order(name, tmp_path):
    sizes = (8, 16, 32)
    found = errors(tmp_path, name, sizes, "shake=0.2", *SILLING, seeds=SEEDS, error="error_stress")
    assert order(sizes, found) > 1.0


def test_standard_weights_lose_the_order_on_lattices_with_silling_s_control(tmp_path):
    sizes = (12, 24)
    assert order(sizes, errors(tmp_path, "manufactured", sizes, "weights=standard", *SILLING)) < 1.6


@BOTH
def test_a_side_held_as_wide_as_the_horizon_keeps_the_order(method, tmp_path):
    sizes = (12, 24)
    assert order(sizes, errors(tmp_path, "manufactured", sizes, "held=2", *method)) > 1.8


@pytest.mark.long
def test_a_ring_of_irregular_triangles_converges_with_conforming_weights_only(tmp_path):
    sizes = (8, 16)
    conforming, standard = (
        errors(tmp_path, "ring", sizes, "mesh=triangles", f"weights={weights}", *SILLING)
        for weights in ("conforming", "standard")
    )
    assert order(sizes, conforming) > 1.8
    assert order(sizes, standard) < 0.5


def test_a_ring_from_a_mesh_file_is_the_ring_of_arrays(tmp_path):
    points, cells = rings.polar(6)
    path = tmp_path / "ring.vtu"
    meshio.write(path, meshio.Mesh(np.pad(points, ((0, 0), (0, 1))), [("quad", cells.nodes)]))
    one, other = (particles.surface(0, 1) for particles in (pd.Mesh(path), rings.cloud("quads", 6, 0.0, 0)))
    key, same = np.lexsort(np.round(np.asarray(one.x), 9).T), np.lexsort(np.round(np.asarray(other.x), 9).T)
    assert np.asarray(one.x)[key] == pytest.approx(np.asarray(other.x)[same], abs=1e-14)
    assert np.asarray(one.area)[key] == pytest.approx(np.asarray(other.area)[same], abs=1e-14)
    volumes = (particles.chunk(0, 1).volume for particles in (pd.Mesh(path), rings.cloud("quads", 6, 0.0, 0)))
    assert np.array_equal(*map(np.sort, (np.round(v, 14) for v in volumes)))


def test_errors_do_not_see_what_is_rigid():
    x, volume = np.random.default_rng(3).uniform(size=(40, 2)), np.random.default_rng(4).uniform(size=40)

    class Solution:
        t = 1.0

        def sum(self, values):
            return np.asarray(values)

        def select(self, region):
            return np.ones(40, dtype=bool)

    solution = Solution()
    solution.x, solution.volume = x, volume
    turned = 0.2 * np.stack([-x[:, 1], x[:, 0]], axis=1) + [0.3, -0.4]
    exact = lambda x, t: np.sin(x)  # noqa: E731
    assert common.ErrorL2(lambda s: np.sin(s.x) + turned, exact, rigid=True).evaluate(solution) < 1e-14
    assert common.ErrorL2(lambda s: np.sin(s.x) + turned, exact).evaluate(solution) > 0.1
    assert common.ErrorL2(lambda s: 1.01 * np.sin(s.x), exact).evaluate(solution) == pytest.approx(0.01)


def divergence(stress, x, h=1e-5):
    """Return ``d sigma_ij / d x_j`` by differences."""
    steps = h * np.eye(2)
    return sum((stress(x + e, 1.0) - stress(x - e, 1.0))[:, :, j] for j, e in enumerate(steps)) / (2.0 * h)


def test_references_are_in_equilibrium(rng):
    x = rng.uniform(0.05, 0.95, (50, 2))
    assert divergence(manufactured.stress, x) == pytest.approx(-manufactured.body_force(x, 1.0), abs=1e-8)
    angle, radius = rng.uniform(0.0, 6.0, 50), rng.uniform(1.05, 1.95, 50)
    around = radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    assert divergence(ring.stress, around) == pytest.approx(np.zeros((50, 2)), abs=1e-8)
    assert divergence(hole.stress, around) == pytest.approx(np.zeros((50, 2)), abs=1e-8)
    assert hole.stress(np.array([[0.0, 1.0], [1.0, 0.0]]), 1.0) == pytest.approx(
        np.array([[[3.0, 0.0], [0.0, 0.0]], [[0.0, 0.0], [0.0, -1.0]]]), abs=1e-14
    )
    for case, places in ((hole, around), (ring, around), (bending, x), (bending, rng.uniform(size=(50, 3)))):
        H = gradient(case.displacement, places)
        strain, dim = 0.5 * (H + H.transpose(0, 2, 1)), places.shape[1]
        lam, mu = pd.LinearElastic(E=case.E, nu=case.NU).lame(dim)
        law = lam * np.trace(strain, axis1=1, axis2=2)[:, None, None] * np.eye(dim) + 2.0 * mu * strain
        assert case.stress(places, 1.0) == pytest.approx(law, abs=1e-7)
    inside = np.array([[rings.INNER, 0.0]])
    assert ring.stress(inside, 1.0)[0, 0, 0] == pytest.approx(-ring.PRESSURE)


def gradient(displacement, x, h=1e-6):
    steps = h * np.eye(x.shape[1])
    return np.stack([(displacement(x + e, 1.0) - displacement(x - e, 1.0)) / (2.0 * h) for e in steps], axis=2)


def of_package_first(material, F):
    """Return the first Piola-Kirchhoff stresses that the package gives."""
    kernels, P = material.kernels(2), np.empty_like(F)
    kernels.stress(np.ascontiguousarray(F), np.arange(len(F)), material.constants(2), P)
    return P


def of_package(material, F):
    """Return the Cauchy stresses that the package gives."""
    return of_package_first(material, F) @ F.transpose(0, 2, 1) / np.linalg.det(F)[:, None, None]


def test_references_at_finite_strain_obey_the_law_of_the_package(rng):
    F = np.eye(2) + 0.2 * rng.uniform(-1.0, 1.0, (20, 2, 2))
    assert cook_elements.cauchy(F) == pytest.approx(
        of_package(pd.NeoHookean(E=cook_elements.E, nu=cook_elements.NU), F), abs=1e-14
    )
    displacement, stress = inflation.exact(inflation.PRESSURE)
    x = np.array([[1.1, 0.3], [-0.7, 1.2], [1.3, -1.3]])
    F = np.eye(2) + gradient(displacement, x)
    assert stress(x, 1.0) == pytest.approx(of_package(inflation.MATERIAL, F), abs=1e-8)
    # The hole grows, and the pressure is dead: the Cauchy stress is that of a wider circle.
    wider = 1.0 + displacement(np.array([[1.0, 0.0]]), 1.0)[0, 0]
    assert wider > 1.4
    assert stress(np.array([[1.0, 0.0]]), 1.0)[0, 0, 0] == pytest.approx(-inflation.PRESSURE / wider, rel=1e-8)
    bent, stress, x = *circle.of_angle(2.0 * np.pi), np.array([[1.0, 0.2], [4.5, 0.9], [7.2, 0.5]])
    F = np.eye(2) + gradient(bent, x)
    assert stress(x, 1.0) == pytest.approx(of_package(circle.MATERIAL, F), abs=1e-8)
    ends = np.array([[0.0, 0.3], [circle.LENGTH, 0.3]])
    assert np.diff(ends + bent(ends, 1.0), axis=0) == pytest.approx(0.0, abs=1e-12)
    # Div P = 0, and no traction on both faces.
    first_piola = lambda x: of_package_first(circle.MATERIAL, np.eye(2) + gradient(bent, x))  # noqa: E731
    steps = 1e-4 * np.eye(2)
    div = sum((first_piola(x + e) - first_piola(x - e))[:, :, j] for j, e in enumerate(steps)) / 2e-4
    assert div == pytest.approx(np.zeros((3, 2)), abs=1e-4)
    faces = np.array([[3.0, 1e-6], [3.0, 1.0 - 1e-6]])
    assert first_piola(faces)[:, :, 1] == pytest.approx(np.zeros((2, 2)), abs=1e-5)


def test_a_side_whose_nodes_are_clamped_keeps_the_order(tmp_path):
    sizes, words = (12, 24), ("held=1", "cloud=simplices", "shake=0.2", *SILLING)
    assert order(sizes, errors(tmp_path, "manufactured", sizes, *words)) > 1.8


@pytest.mark.parametrize("cloud", ["cells", "simplices"])
def test_bending_in_space_is_of_second_order(cloud, tmp_path):
    sizes = (5, 10)
    words = ("dim=3", f"cloud={cloud}", *(() if cloud == "cells" else ("shake=0.2",)), *SILLING)
    assert order(sizes, errors(tmp_path, "bending", sizes, *words)) > 1.8


@pytest.mark.long
def test_the_stress_at_surfaces_is_of_first_order(tmp_path):
    """At the top of a bent beam, inside a ring, at a hole and on a clamped side; on the finest by one in a hundred."""
    for name, sizes, *words in (
        ("bending", (20, 40)),
        ("ring", (24, 48), "mesh=quads"),
        ("hole", (24, 48), "mesh=quads"),
        ("manufactured", (24, 48), "held=1", "cloud=nodes"),
    ):
        found = errors(tmp_path, name, sizes, *words, *SILLING, error="error_surface_stress")
        assert order(sizes, found) > 1.0, name
        assert found[-1] < 0.013, name


@pytest.mark.long
def test_a_strip_bent_to_a_circle_is_of_second_order(tmp_path):
    sizes = (4, 8)
    assert order(sizes, errors(tmp_path, "circle", sizes, "cloud=nodes", *SILLING)) > 1.6


def test_stored_elements_are_ten_times_as_good_as_particles(tmp_path):
    stored = json.loads(cook_elements.STORE.read_text())
    found = results(FOLDER / "cook.py", "n=32", "cloud=cells", *SILLING, output=tmp_path)["results"]
    # A fourth of the change is left where elements are half as large, in the stress a half.
    assert 0.25 * stored["change of u"] < 0.1 * found["error_u"]
    assert 0.5 * stored["change of the stress"] < 0.2 * found["error_stress"]


@pytest.mark.long
@pytest.mark.parametrize("words", [("cloud=nodes",), ("cloud=simplices", "shake=0.2"), ("cloud=cells",)])
def test_cook_s_membrane_is_of_second_order(words, tmp_path):
    # Among nodes that end at the singular corner a horizon of two spacings has order 1.5 at these sizes.
    of_cells = words == ("cloud=cells",)
    sizes = (8, 16, 32, 64) if of_cells else (16, 32, 64)
    method = SILLING if of_cells else ("scheme=correspondence", "horizon=2.5", "G=0.5")
    conforming, standard = (
        errors(tmp_path, "cook", sizes, f"weights={weights}", *words, *method) for weights in ("conforming", "standard")
    )
    assert order(sizes, conforming) > 1.6
    assert order(sizes, standard) < 1.5


@pytest.mark.long
@pytest.mark.parametrize("method", [SILLING, ("scheme=sub_horizons", "horizon=2.015", "G=0")])
def test_an_inflated_ring_of_triangles_is_of_second_order(method, tmp_path):
    sizes = (12, 24, 48)
    conforming, standard = (
        errors(tmp_path, "inflation", sizes, "mesh=triangles", f"weights={weights}", *method)
        for weights in ("conforming", "standard")
    )
    assert order(sizes, conforming) > 1.8
    assert order(sizes, standard) < 0.5


@pytest.mark.long
def test_a_ring_of_polar_cells_tends_to_second_order(tmp_path):
    sizes = (32, 64)
    assert order(sizes, errors(tmp_path, "ring", sizes, "mesh=quads", *SILLING)) > 1.8


@pytest.mark.long
def test_the_stored_elements_come_out_again():
    pytest.importorskip("skfem")
    grid = cook_elements.solved(cook_elements.ELEMENTS)
    assert grid == pytest.approx(cook_elements.stored(), abs=1e-6)


@pytest.mark.parametrize("warp", [1e-3, 1e-4])
def test_facets_that_are_warped_a_little_keep_their_linear_functions(warp):
    """A node in the plane of its own warped facet, and its neighbours not: it alone would not do for the facet."""
    points, block = common.grid(4, 0.0, 0, (1.0, 1.0, 1.0), common.cubes)
    points = points.copy()
    points[:, 2] *= 1.0 + warp * points[:, 0] * points[:, 1] * (1.0 + 0.3 * points[:, 0])
    held = pd.Displacement(pd.region.All(), x=0.0, y=0.0, z=0.0)
    case = pd.Case(
        particles=common.of_nodes(points, block), horizon=2.1 / 4.0, material=pd.LinearElastic(E=1.0, nu=0.3),
        conditions=[held], weights=pd.Conforming(),
    )  # fmt: skip
    body = pd.prepare(case).problem.body
    surface, x = body.surface, body.cloud.x
    for axis in range(3):
        np.testing.assert_allclose(surface.interpolated(x[:, axis]), surface.x[:, axis], atol=1e-12)
