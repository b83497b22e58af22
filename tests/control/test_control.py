"""Zero-energy controls: they resist what a uniform gradient does not explain and leave affine fields alone."""

import itertools

import numpy as np
import pytest

import pdpetsc as pd
from pdpetsc.discrete.cloud import distribute
from pdpetsc.discrete.communicator import world
from pdpetsc.discrete.families import find_families
from tests import reference
from tests.scenes import ALL_CONTROLS, DIMS, NOT_AFFINE, body, dense_tangent, displacement, small_points

CONTROLS = {name: control for name, control in ALL_CONTROLS.items() if control is not None}


@pytest.fixture(params=[(dim, name) for dim in DIMS for name in CONTROLS], ids=lambda c: f"{c[0]}D-{c[1]}")
def model(request, rng):
    dim, name = request.param
    return body(dim, control=CONTROLS[name], rng=rng)


def control_force(model, u):
    f = np.zeros_like(u)
    energy = model.control.force(u, f, model.families.everyone)
    return f, energy


def test_affine_displacements_meet_no_force(request, model, rng):
    name = request.node.callspec.params["model"][1]
    u = model.cloud.x @ rng.standard_normal((model.dim, model.dim)).T + rng.standard_normal(model.dim)
    f, energy = control_force(model, u)
    if name in NOT_AFFINE:
        assert energy > 1e-3
    else:
        assert np.abs(f).max() < 1e-12
        assert energy < 1e-24


def test_matrix_is_the_force_of_unit_displacements(model, rng):
    with_control = dense_tangent(model, np.zeros_like(model.cloud.x))
    plain = body(model.dim, rng=np.random.default_rng(20240607))
    assert np.array_equal(plain.cloud.x, model.cloud.x)
    M = with_control - dense_tangent(plain, np.zeros_like(model.cloud.x))
    u = displacement(model, rng)
    f, energy = control_force(model, u)
    assert np.allclose(M @ u.ravel(), f.ravel(), atol=1e-12)
    assert energy == pytest.approx(0.5 * np.vdot(f, u), rel=1e-11)


def test_silling_agrees_with_numpy(rng):
    for dim in DIMS:
        model = body(dim, control=pd.Silling(0.7), rng=rng)
        cloud = model.cloud
        u = displacement(model, rng)
        kappa = model.materials[0].material.bulk_like_modulus(dim)
        expected = reference.silling_energy(
            cloud.x, cloud.volume, reference.families(cloud.x, cloud.horizon), 0.7, kappa, u
        )
        assert control_force(model, u)[1] == pytest.approx(expected, rel=1e-12)


def checkerboard_work(side, horizon, low, high, methods):
    """Return the work per squared displacement of each (scheme, control) on the particles between low and high.

    Every particle of a cube moves by +-0.05 spacings along x, alternating.
    """
    x = np.array(list(itertools.product(range(side), repeat=3)), dtype=float)
    cloud = distribute(world(), x, np.ones(len(x)), {}, horizon)
    families = find_families(cloud)
    omega = np.ones(len(families.neighbours))
    material_of = np.zeros(len(x), dtype=np.int32)
    u = np.where(x.sum(axis=1) % 2 == 0, 0.05, -0.05)[:, None] * np.array([1.0, 0.0, 0.0])
    inner = np.all((x > low) & (x < high), axis=1)
    work = []
    for scheme, control in methods:
        model = small_points(cloud, families, omega, scheme, [pd.LinearElastic(1.0, nu=0.0)], material_of, control)
        work.append(np.vdot(model.internal_force(u)[inner], u[inner]) / np.vdot(u[inner], u[inner]))
    return work


@pytest.mark.parametrize("control", CONTROLS.values(), ids=CONTROLS.keys())
def test_checkerboard_in_a_cube_is_resisted(control):
    """The restoring force in a 12^3 cube at horizon 3.015 must not vanish."""
    methods = [(pd.Correspondence(), None), (pd.Correspondence(), control)]
    plain, controlled = checkerboard_work(12, 3.015, 2.5, 8.5, methods)
    # Only next to the boundary, where families are cut, does the plain scheme resist at all.
    kappa = pd.LinearElastic(1.0, nu=0.0).bulk_like_modulus(3)
    assert abs(plain) < 0.1 * kappa
    assert controlled - plain > 0.1 * kappa


@pytest.mark.parametrize("scheme", [pd.StressPoints(), pd.SubHorizons(), pd.BondAssociated()], ids=lambda s: str(s))
def test_schemes_without_zero_energy_modes_resist_a_checkerboard(scheme):
    plain, resisting = checkerboard_work(9, 2.015, 2.5, 5.5, [(pd.Correspondence(), None), (scheme, None)])
    kappa = pd.LinearElastic(1.0, nu=0.0).bulk_like_modulus(3)
    assert abs(plain) < 1e-10 * kappa
    assert resisting > 0.1 * kappa


def ratios_in_two_units(control_at):
    """Return energy of a control over that of the material for the same body in mm and MPa and in m and Pa.

    ``control_at`` returns the control for a spacing.
    """
    ratios = []
    for length, pressure in ((1.0, 1.0), (1e-3, 1e6)):
        x = length * np.array(list(itertools.product(range(5), repeat=2)), dtype=float)
        cloud = distribute(world(), x, np.full(len(x), length**2), {}, 2.015 * length)
        families = find_families(cloud)
        model = small_points(
            cloud, families, np.ones(len(families.neighbours)), pd.Correspondence(), [pd.Hencky(10.0 * pressure, 0.0)],
            np.zeros(len(x), dtype=np.int32), control_at(length),
        )  # fmt: skip
        u = 0.01 * length * np.sin(7.0 * np.arange(x.size)).reshape(x.shape)
        elastic, control = model.energy(u)
        ratios.append(control / elastic)
    return ratios


@pytest.mark.parametrize(
    "control", [pd.Silling(), pd.Littlewood(), pd.Wan(), pd.RelativeSprings(), pd.RelativeAverage()]
)
def test_controls_are_unit_free(control):
    """The same body in mm and MPa and in m and Pa resists alike."""
    ratios = ratios_in_two_units(lambda length: control)
    assert ratios[0] == pytest.approx(ratios[1], rel=1e-12)


@pytest.mark.parametrize("control", [pd.Silling, lambda G: pd.SillingMicromodulus(G, 1.0)])
def test_a_negative_coefficient_is_refused(control):
    with pytest.raises(pd.CaseError, match="finite number >= 0 as G"):
        control(-0.1)


@pytest.mark.parametrize("dim", [2, 3])
def test_micromodulus_control_agrees_with_its_equations(dim, rng):
    """The sums of Hashim et al., Eq. (38)-(42), pair by pair, in 3D with 18 k / pi horizon^4."""
    G, unit = 0.7, 1.3
    model = body(dim, control=pd.SillingMicromodulus(G, unit), rng=rng)
    cloud, u = model.cloud, displacement(model, rng)
    E, nu = model.materials[0].material.E, model.materials[0].material.nu
    k = E / (2.0 * (1.0 - nu - 2.0 * nu**2)) if dim == 2 else E / (3.0 * (1.0 - 2.0 * nu))
    # In the paper's unit of length every length is over the unit, and a force per area over its square.
    x, horizon, volume = cloud.x / unit, cloud.horizon / unit, cloud.volume / unit**dim
    C = (12.0 if dim == 2 else 18.0) * k / (np.pi * horizon**4)
    expected = np.zeros_like(u)
    for i, family in enumerate(reference.families(x, horizon)):
        xi, eta, V = x[family] - x[i], (u[family] - u[i]) / unit, volume[family]
        F = (eta + xi).T @ (V[:, None] * xi) @ np.linalg.inv(xi.T @ (V[:, None] * xi))
        z = eta + xi - xi @ F.T
        force = (G * C / V.sum() * V * volume[i])[:, None] * z * unit ** (dim - 1)
        np.add.at(expected, family, force)
        expected[i] -= force.sum(axis=0)
    assert np.allclose(control_force(model, u)[0], expected, rtol=1e-11, atol=1e-13 * np.abs(expected).max())


def test_micromodulus_control_is_the_same_in_all_units_and_has_no_meaning_in_1d(rng):
    ratios = ratios_in_two_units(lambda length: pd.SillingMicromodulus(0.5, 3.0 * length))
    assert ratios[0] == pytest.approx(ratios[1], rel=1e-12)
    with pytest.raises(pd.CaseError, match="1D"):
        body(1, control=pd.SillingMicromodulus(0.5, 1.0))


@pytest.mark.parametrize("influence", [pd.influence.Constant(), pd.influence.Cubic()], ids=lambda i: type(i).__name__)
@pytest.mark.parametrize("dim", [2, 3])
def test_micromodulus_control_is_silling_inside_a_lattice(dim, influence):
    """Displace one particle with a whole family in a lattice whose other families are whole too: equal forces."""
    side, spacing = 9 if dim == 2 else 7, 0.25
    horizon = (2.015 if dim == 2 else 1.5) * spacing
    x = spacing * np.array(list(itertools.product(range(side), repeat=dim)), dtype=float)
    cloud = distribute(world(), x, np.full(len(x), spacing**dim), {}, horizon)
    families = find_families(cloud)
    omega = influence(np.linalg.norm(families.bonds(cloud.x), axis=1) / horizon)
    printed = pd.SillingMicromodulus(0.3, 0.4)
    u = np.zeros_like(x)
    u[np.argmin(np.linalg.norm(cloud.x - cloud.x.mean(axis=0), axis=1))] = 0.01
    forces = []
    for control in (printed, pd.Silling(printed.unit_free(spacing, horizon, dim, influence))):
        material_of = np.zeros(len(x), dtype=np.int32)
        model = small_points(
            cloud, families, omega, pd.Correspondence(), [pd.Hencky(E=10.0, nu=0.0)], material_of, control
        )
        forces.append(control_force(model, u)[0])
    assert np.abs(forces[0]).max() > 1e-3
    assert np.allclose(forces[0], forces[1], rtol=1e-12, atol=1e-14)


def test_the_penalty_is_silling_with_one_constant(rng):
    """``Penalty`` with ``C3 = G kappa / sum omega |xi|^2 V`` of one family is Silling's control of that family."""
    model = body(2, control=pd.Silling(0.7))
    cloud, u = model.cloud, displacement(model, rng)
    kappa = model.materials[0].material.bulk_like_modulus(2)
    inner = int(np.argmax(np.diff(model.families.indptr)))
    xi = cloud.x[reference.families(cloud.x, cloud.horizon)[inner]] - cloud.x[inner]
    C3 = 0.7 * kappa / (xi**2).sum()
    only = np.array([inner], dtype=np.int32)
    forces = []
    for control in (pd.Silling(0.7), pd.Penalty(C3)):
        f = np.zeros_like(u)
        body(2, control=control).control.force(u, f, only)
        forces.append(f)
    assert np.abs(forces[0]).max() > 0.0
    assert np.allclose(*forces, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("C", [0.01, 0.3])
def test_relative_springs_add_their_share_to_the_stiffness_of_a_bar(C):
    model = body(1, control=pd.RelativeSprings(C), material=pd.LinearElastic(10.0, nu=0.0))
    elastic, control = model.energy(0.01 * model.cloud.x)
    assert control == pytest.approx(C * elastic, rel=1e-10)


@pytest.mark.parametrize(
    "kind", [pd.Springs, pd.RelativeSprings, pd.AveragedDisplacement, pd.RelativeAverage, pd.Penalty]
)
def test_negative_constants_are_refused(kind):
    with pytest.raises(pd.CaseError, match=">= 0"):
        kind(-0.1)
