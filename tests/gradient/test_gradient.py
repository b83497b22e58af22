"""Gradient schemes: affine displacements are exact, loops agree with numpy, bad families are refused."""

import numpy as np
import pytest

import pdpetsc as pd
from pdpetsc.discrete.cloud import distribute
from pdpetsc.discrete.communicator import world
from pdpetsc.discrete.families import find_families
from pdpetsc.kernels.gradient import inverses
from tests import reference
from tests.scenes import DIMS, SCHEMES, body, displacement, lattice

CASES = [(dim, name) for dim in DIMS for name in SCHEMES]


@pytest.fixture(params=CASES, ids=lambda case: f"{case[0]}D-{case[1]}")
def model(request, rng):
    dim, name = request.param
    return body(dim, SCHEMES[name], rng=rng)


def test_families_are_all_pairs_within_the_horizon(rng):
    for dim in DIMS:
        x = lattice(dim, rng)
        cloud = distribute(world(), x, np.ones(len(x)), {}, 2.015)
        families = find_families(cloud)
        found = np.split(families.neighbours, families.indptr[1:-1])
        for one, other in zip(found, reference.families(x, 2.015), strict=True):
            assert one.tolist() == other.tolist()


def test_a_bond_as_long_as_the_horizon_belongs_to_the_family():
    x = 0.1 * np.arange(11.0)[:, None]
    families = find_families(distribute(world(), x, np.ones(11), {}, 0.3))
    assert np.diff(families.indptr).tolist() == [3, 4, 5, 6, 6, 6, 6, 6, 5, 4, 3]


def test_affine_displacements_have_their_exact_gradient(model, rng):
    H = rng.standard_normal((model.dim, model.dim))
    u = model.cloud.x @ H.T + rng.standard_normal(model.dim)
    assert np.abs(model.operator.gradient(u) - H).max() < 1e-12


def test_loops_agree_with_numpy(model, rng):
    u = displacement(model, rng)
    G = reference.dense_operator(model.operator, model.cloud.n_local)
    assert np.allclose(model.operator.gradient(u), reference.gradient(G, u), atol=1e-14)
    P = rng.standard_normal((model.operator.n_points, model.dim, model.dim))
    f = np.zeros_like(u)
    model.operator.divergence(P, f)
    assert np.allclose(f, reference.divergence(G, model.operator.volume, P), atol=1e-13)


def test_quadrature_volumes_add_up_to_the_particles(model):
    sums = np.bincount(model.operator.owner, model.operator.volume)
    assert np.allclose(sums, model.cloud.volume, rtol=1e-14)


def test_interior_lattice_particle_has_a_point_per_sector():
    for dim in DIMS:
        operator = body(dim, pd.SubHorizons(), horizon=1.015).operator
        count = np.bincount(operator.owner)
        assert count.max() == 2**dim
        assert count.min() == 1


def test_sub_horizons_share_the_bonds_on_an_axis_in_equal_parts():
    """On a lattice with diagonals, the +x bond counts one half in each of the two quadrants beside it."""
    operator = body(2, pd.SubHorizons(), horizon=1.5).operator
    cloud = body(2, horizon=1.5).cloud
    centre = int(np.flatnonzero((cloud.x == [2.0, 2.0]).all(axis=1))[0])
    points = np.flatnonzero(operator.owner == centre)
    assert len(points) == 4
    for p in points:
        members = operator.members[operator.point_ptr[p] + 1 : operator.point_ptr[p + 1]]
        xi = cloud.x[members] - cloud.x[centre]
        assert len(xi) == 3
        weight = np.where(np.abs(xi).sum(axis=1) > 1.5, 1.0, 0.5)
        K = np.einsum("k,km,kn->mn", weight, xi, xi)
        g = operator.g[operator.point_ptr[p] + 1 : operator.point_ptr[p + 1]]
        assert np.allclose(g, (weight[:, None] * xi) @ np.linalg.inv(K), atol=1e-14)


def test_zero_energy_sawtooth_is_seen_by_sub_horizons_only():
    x = np.arange(20.0)
    sawtooth = ((-1.0) ** x)[:, None]
    inner = slice(5, 15)
    energies = []
    for scheme in (pd.Correspondence(), pd.SubHorizons()):
        cloud = distribute(world(), x[:, None], np.ones(20), {}, 1.015)
        families = find_families(cloud)
        operator = scheme.build(cloud, families, np.ones(len(families.neighbours)))
        energies.append(np.bincount(operator.owner, operator.gradient(sawtooth)[:, 0, 0] ** 2 * operator.volume))
    plain, sub_horizons = energies
    assert np.all(plain[inner] == 0.0)
    # Each half of a family sees the slope 2 of the sawtooth.
    assert np.allclose(sub_horizons[inner], 4.0, rtol=1e-12)


@pytest.mark.parametrize("scheme", SCHEMES.values(), ids=SCHEMES.keys())
def test_a_flat_family_is_refused_with_ids(scheme):
    x = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [3.0, 0.0]])
    cloud = distribute(world(), x, np.ones(4), {}, 1.5)
    families = find_families(cloud)
    with pytest.raises(pd.CaseError, match=r"4 .* too flat .* at horizon 1\.5 \(ids 0, 1, 2, 3\); widen the horizon"):
        scheme.build(cloud, families, np.ones(len(families.neighbours)))


def test_coincident_particles_are_refused_with_ids():
    x = np.array([[0.0], [1.0], [1.0], [2.0]])
    with pytest.raises(pd.CaseError, match="Particles 1 and 2 coincide"):
        find_families(distribute(world(), x, np.ones(4), {}, 1.5))


@pytest.mark.parametrize("dim", DIMS)
def test_a_corrected_gradient_is_exact_for_polynomials_of_its_order(dim, rng):
    """A Taylor term of degree 2 to N around the middle particle has gradient 0 there."""
    side = np.arange(-3.0, 4.0)
    x = np.stack(np.meshgrid(*[side] * dim, indexing="ij"), axis=-1).reshape(-1, dim)
    x += 0.1 * rng.uniform(-1.0, 1.0, x.shape)
    cloud = distribute(world(), x, rng.uniform(0.8, 1.2, len(x)), {}, 3.015)
    families = find_families(cloud)
    middle = int(np.argmin(np.linalg.norm(cloud.x, axis=1)))
    for scheme, order in ((pd.Corrected(3), 3), (pd.HigherOrder(2), 2)):
        operator = scheme.build(cloud, families, np.ones(len(families.neighbours)))
        y = cloud.x - cloud.x[middle]
        for degree in range(1, order + 1):
            direction = rng.standard_normal(dim)
            u = np.zeros_like(y)
            u[:, 0] = (y @ direction) ** degree
            H = operator.gradient(u)[middle]
            exact = np.zeros((dim, dim))
            exact[0] = direction if degree == 1 else 0.0
            assert np.abs(H - exact).max() < 1e-9


@pytest.mark.parametrize("influence", [pd.influence.Constant(), pd.influence.Cubic(), pd.influence.Gaussian()])
@pytest.mark.parametrize(
    "differences", [(8 / 12, -1 / 12), (45 / 60, -9 / 60, 1 / 60), (672 / 840, -168 / 840, 32 / 840, -3 / 840)]
)
def test_higher_order_weights_of_the_highest_order_are_central_differences(differences, influence):
    """On m neighbours on a side order 2 m - 1 leaves no choice: the difference formula, whatever the influence."""
    m = len(differences)
    x = np.arange(-8.0, 9.0)[:, None]
    cloud = distribute(world(), x, np.ones(len(x)), {}, m + 0.015)
    families = find_families(cloud)
    omega = influence(np.abs(families.bonds(cloud.x)[:, 0]) / cloud.horizon)
    operator = pd.HigherOrder(2 * m - 1).build(cloud, families, omega)
    step = np.array([operator.gradient((np.abs(cloud.x - k) < 0.1) * 1.0)[8, 0, 0] for k in range(1, m + 1)])
    assert step == pytest.approx(differences, rel=1e-7)


def test_orders_that_a_family_cannot_carry_are_lowered_and_said():
    x = np.arange(12.0)[:, None]
    cloud = distribute(world(), x, np.ones(12), {}, 1.015)
    families = find_families(cloud)
    operator = pd.Corrected(3).build(cloud, families, np.ones(len(families.neighbours)))
    plain = pd.Correspondence().build(cloud, families, np.ones(len(families.neighbours)))
    assert "lowered" in operator.note
    assert np.allclose(operator.g, plain.g, atol=1e-14)


def test_stress_points_of_nearest_neighbours_are_those_of_the_paper():
    """Two points inside, one at every boundary particle, each over the two bonds on its side; both choices occur."""
    x = np.stack(np.meshgrid(np.arange(9.0), np.arange(9.0), indexing="ij"), axis=-1).reshape(-1, 2)
    cloud = distribute(world(), x, np.ones(len(x)), {}, 1.015)
    families = find_families(cloud)
    operator = pd.StressPoints().build(cloud, families, np.ones(len(families.neighbours)))
    inside = np.all((cloud.x > 0.5) & (cloud.x < 7.5), axis=1)
    count = np.bincount(operator.owner)
    assert (count[inside] == 2).all()
    assert (count[~inside] == 1).all()
    choices = set()
    for p in range(operator.n_points):
        if inside[operator.owner[p]]:
            members = operator.members[operator.point_ptr[p] + 1 : operator.point_ptr[p + 1]]
            sum_of_bonds = (cloud.x[members] - cloud.x[operator.owner[p]]).sum(axis=0)
            assert len(members) == 2
            choices.add((*np.abs(sum_of_bonds), np.prod(sum_of_bonds)))
    assert choices == {(1.0, 1.0, 1.0), (1.0, 1.0, -1.0)}


@pytest.mark.parametrize(
    ("dim", "sectors", "points"), [(1, 2, 2), (1, 4, 4), (2, 3, 3), (2, 8, 8), (3, 4, 4), (3, 8, 8), (3, 12, 12)]
)
def test_any_number_of_sectors(dim, sectors, points):
    side = np.arange(-4.0, 5.0)
    x = np.stack(np.meshgrid(*[side] * dim, indexing="ij"), axis=-1).reshape(-1, dim)
    cloud = distribute(world(), x, np.ones(len(x)), {}, 4.015)
    families = find_families(cloud)
    operator = pd.SubHorizons(sectors).build(cloud, families, np.ones(len(families.neighbours)))
    middle = int(np.argmin(np.linalg.norm(cloud.x, axis=1)))
    assert np.count_nonzero(operator.owner == middle) == points
    with pytest.raises(pd.CaseError, match="sectors"):
        pd.SubHorizons(1).build(cloud, families, np.ones(len(families.neighbours)))


def test_the_family_of_a_bond_is_what_lies_near_both_particles():
    x = np.stack(np.meshgrid(np.arange(9.0), np.arange(9.0), indexing="ij"), axis=-1).reshape(-1, 2)
    cloud = distribute(world(), x, np.ones(len(x)), {}, 2.015)
    families = find_families(cloud)
    operator = pd.BondAssociated().build(cloud, families, np.ones(len(families.neighbours)))
    assert operator.n_points == len(families.neighbours)
    near = reference.families(cloud.x, 2.015)
    for bond in (40, 333, 700):
        i, j = operator.owner[bond], families.neighbours[bond]
        members = operator.members[operator.point_ptr[bond] + 1 : operator.point_ptr[bond + 1]]
        assert set(members) == (set(near[i]) & set(near[j])) | {j}


def averages(x, volume, u, radius):
    """Return the mean of u over the particles within the radius, the particle itself among them."""
    near = np.linalg.norm(x[:, None] - x[None], axis=2) <= radius * (1.0 + 1e-9)
    return (near * volume) @ u / (near @ volume)[:, None]


@pytest.mark.parametrize("dim", DIMS)
def test_the_smoothed_gradient_is_that_of_the_averages_and_exact_for_affine_displacements(dim, rng):
    horizon, radius = 3.3, 0.45
    model = body(dim, pd.SmoothedDisplacement(radius), horizon=horizon, rng=rng)
    x, volume = model.cloud.x, model.cloud.volume
    H = rng.standard_normal((dim, dim))
    assert np.abs(model.operator.gradient(x @ H.T) - H).max() < 1e-12
    u = displacement(model, rng)
    mean_u, mean_x = (averages(x, volume, v, radius * horizon) for v in (u, x))
    for i, found in enumerate(model.operator.gradient(u)):
        xi = x - x[i]
        length = np.linalg.norm(xi, axis=1)
        weight = volume * ((length > 0.0) & (length <= (1.0 - radius) * horizon * (1.0 + 1e-9)))
        left, right = (np.einsum("j,jm,jn->mn", weight, v - v[i], xi) for v in (mean_u, mean_x))
        assert np.allclose(found, left @ np.linalg.inv(right), atol=1e-12)


def test_the_smoothed_gradient_does_not_see_what_averages_do_not_show_and_needs_a_wide_horizon():
    model = body(1, pd.SmoothedDisplacement())
    wave = np.array([1.0, -1.0, 0.0] * 4)[:, None]
    assert np.abs(model.operator.gradient(wave)[3:-3]).max() < 1e-14
    with pytest.raises(pd.CaseError, match="averaged displacement"):
        body(1, pd.SmoothedDisplacement(), horizon=1.015)
    with pytest.raises(pd.CaseError, match="between 0 and 1"):
        pd.SmoothedDisplacement(1.0)


@pytest.mark.parametrize("n", [1, 2, 3, 6])
def test_inverses_are_those_of_numpy(n, rng):
    """Also of a family as flat as one is accepted, whose shape tensor has eigenvalues a million times apart."""
    A = rng.standard_normal((50, n, n + 2))
    K = A @ A.transpose(0, 2, 1)
    K[0] = np.diag(np.logspace(0.0, -6.0, n))
    found = inverses(K)
    assert np.allclose(found @ K, np.eye(n), atol=1e-9)
    assert np.array_equal(found, found.transpose(0, 2, 1))
    K[3] = 0.0
    with pytest.raises(np.linalg.LinAlgError, match="not positive definite"):
        inverses(K)
