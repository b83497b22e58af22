"""Bond damage: the laws, the exact tangent, irreversibility, what happens to families that break."""

import itertools

import numpy as np
import pytest
from scipy.integrate import quad

import pdpetsc as pd
from pdpetsc.discrete.cloud import distribute
from pdpetsc.discrete.communicator import world
from pdpetsc.discrete.families import find_families
from tests.scenes import (
    BONDS,
    DIMS,
    LAWS,
    SCHEMES,
    bond_body,
    damaged_body,
    dense_tangent,
    differences,
    displacement,
    small_points,
)

CRITICAL = pd.ConstantCritical(0.02)


@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS.keys())
def test_laws_fall_from_one_and_have_the_right_slope_and_energy(law):
    law = law(CRITICAL)
    x = np.linspace(law.onset, law.final, 101)[1:-1]
    if law.final > law.onset:
        T = law.phi(x)
        assert np.all(np.diff(T) < 0.0)
        assert np.allclose(law.phi(np.array([law.onset])), 1.0)
        assert np.allclose(law.phi(np.array([law.final])), 0.0, atol=1e-15)
        slope = (law.phi(x + 1e-6) - law.phi(x - 1e-6)) / 2e-6
        kinks = np.abs(x - getattr(law, "kink", -1.0)) < 1e-3
        assert np.allclose(law.slope(x)[~kinks], slope[~kinks], rtol=1e-6)
    # Area under the force less what is stored.
    reached = np.linspace(law.onset, law.final, 5)[1:-1] if law.final > law.onset else np.array([])
    for end in reached:
        T = float(law.phi(np.array([end]))[0])
        area = quad(lambda y: float(law.phi(np.array([y]))[0]) * y, law.onset, end, points=law.pieces)[0]
        exact = 0.5 * law.onset**2 + area - 0.5 * T * end**2
        one = np.ones(1)
        assert law.dissipated(T * one, end * one, 0.5 * one)[0] == pytest.approx(exact, rel=1e-9)
    # A broken bond stores nothing: it has dissipated the whole area under its force.
    one = np.ones(1)
    area = 0.0
    for begin, end in itertools.pairwise(law.pieces):
        area += quad(lambda y: float(law.phi(np.array([y]))[0]) * y, begin, end)[0]
    whole = law.dissipated(0.0 * one, law.final * one, 0.5 * one)[0]
    assert 0.5 * law.toughness(2.0) == whole
    assert whole == pytest.approx(0.5 * law.onset**2 + area, rel=1e-9)


def test_the_published_degradation_jumps_and_can_be_made_continuous():
    published = pd.SmoothDegradation(CRITICAL, start=0.75, beta=3.0, continuous=False)
    ends = np.array([0.75, 1.0])
    assert published.phi(ends) == pytest.approx([0.5 * (1 + np.tanh(3.0)), 0.5 * (1 - np.tanh(3.0))])
    for law in (published, pd.Brittle(CRITICAL)):  # what is left at the end is lost there
        for degree in (1.0, 2.0):
            at = law.onset + (law.final - law.onset) * (np.arange(2000.0) + 0.5) / 2000.0
            area = (law.phi(at) * degree * at ** (degree - 1.0)).mean() * (law.final - law.onset)
            assert law.toughness(degree) == pytest.approx(law.onset**degree + area, rel=1e-6)
    s = 0.02 * np.linspace(0.76, 0.99, 9)
    s_min, s_cr = 0.015, 0.02
    exact = 0.5 * (1.0 - np.tanh(3.0 * (s_min + s_cr - 2.0 * s) / (s_min - s_cr)))
    assert np.allclose(published.phi(s / s_cr), exact, rtol=1e-13)


def softened(model, rng):
    """Return a displacement at which many bonds soften and none is beyond its end."""
    middle = 0.018 if isinstance(model.failure.law, pd.SmoothDegradation) else 0.025
    return displacement(model, rng, 0.001) + middle * (model.cloud.x - model.cloud.x.mean(axis=0))


def softening(model, u):
    """Return the bonds whose integrity falls at a displacement, and its derivative by their drive."""
    return model.failure.following(model.driving_values(u))[1:]


@pytest.mark.parametrize("law", ["linear", "exponential", "smooth"])
@pytest.mark.parametrize(("dim", "scheme"), list(itertools.product(DIMS, SCHEMES)))
def test_the_tangent_with_softening_bonds_is_exact(dim, scheme, law, rng):
    for control in (None, pd.Silling(0.5)):
        model = damaged_body(dim, LAWS[law](CRITICAL), SCHEMES[scheme], control, rng=rng)
        u = softened(model, rng)
        assert np.count_nonzero(softening(model, u)[1]) > 4
        K = dense_tangent(model, u)
        columns = rng.choice(u.size, 8, replace=False)
        assert np.abs(K[:, columns] - differences(model, u, columns)).max() < 1e-6 * np.abs(K).max()
        du = rng.standard_normal(u.shape)
        assert np.allclose(K @ du.ravel(), model.tangent_times(u, du).ravel(), atol=1e-10 * np.abs(K).max())
        model.freeze(True)
        K = dense_tangent(model, u)
        assert np.abs(K[:, columns] - differences(model, u, columns)).max() < 1e-6 * np.abs(K).max()
        f = model.internal_force(u)
        assert np.abs(f.sum(axis=0)).max() < 1e-12 * np.abs(f).sum()


@pytest.mark.parametrize("law", ["linear", "exponential", "smooth"])
def test_the_tangent_of_softening_bonds_is_exact_and_symmetric(law, rng):
    for dim, (name, material) in itertools.product(DIMS, BONDS.items()):
        if "linear_solid" in name:
            continue
        model = bond_body(dim, material, rng=rng, damage=LAWS[law](CRITICAL))
        u = softened(model, rng)
        assert np.count_nonzero(softening(model, u)[1]) > 4
        K = dense_tangent(model, u)
        columns = rng.choice(u.size, min(8, u.size), replace=False)
        assert np.abs(K[:, columns] - differences(model, u, columns)).max() < 1e-6 * np.abs(K).max(), name
        assert np.abs(K - K.T).max() < 1e-12 * np.abs(K).max()


def test_damage_does_not_heal_and_reverts_to_what_was_kept(rng):
    model = damaged_body(2, pd.SmoothDegradation(CRITICAL), rng=rng)
    u = softened(model, rng)
    model.commit(u)
    lost = model.failure.phi.copy()
    assert lost.min() < 0.9
    T, less, _ = model.failure.following(model.driving_values(0.5 * u))
    assert np.array_equal(T, lost)
    assert not len(less)
    model.soften(1.2 * u)
    assert model.failure.phi.min() < lost.min()
    model.revert()
    assert np.array_equal(model.failure.phi, lost)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_broken_bonds_leave_the_gradient_and_flat_families_lose_their_stress(scheme, rng):
    model = damaged_body(2, pd.Brittle(CRITICAL), SCHEMES[scheme], pd.Silling(0.5))
    x = model.cloud.x
    centres, neighbours = model.families.centres, model.families.neighbours
    # Pull the upper half off: a crack through the body at once.
    u = np.where(x[:, 1:] > 2.5, [[0.0, 1.0]], 0.0)
    crossing = (x[centres, 1] > 2.5) != (x[neighbours, 1] > 2.5)
    assert model.break_bonds(u, 10**6) == np.count_nonzero(crossing) // 2
    assert np.array_equal(~model.failure.intact, crossing)
    # Both halves move freely, and a uniform strain of one half is exact in it.
    f = model.internal_force(u)
    assert np.abs(f).max() < 1e-12
    strained = u + np.where(x[:, 1:] > 2.5, 0.1 * x * [1.0, 0.0], 0.0)
    F = model.material_term.deformation_gradient(model.at(strained))
    upper = x[:, 1] > 2.5
    assert np.allclose(F[upper], np.diag([1.1, 1.0]), atol=1e-10)
    assert np.allclose(F[~upper], np.eye(2), atol=1e-10)
    # Bonds that are gone take their share of the volume with them.
    left = np.bincount(centres, model.failure.intact) / np.bincount(centres)
    volume = np.bincount(model.operator.owner, model.operator.volume, len(x))
    assert np.allclose(volume, left * model.cloud.volume[: len(x)], rtol=1e-12)
    K = dense_tangent(model, strained)
    columns = rng.choice(u.size, 8, replace=False)
    assert np.abs(K[:, columns] - differences(model, strained, columns)).max() < 1e-6 * np.abs(K).max()
    # A corner that keeps one bond alone has no gradient any more; the control still holds it.
    corner = 0
    own = np.flatnonzero((centres == corner) | (neighbours == corner))
    model.failure.phi[own] = 0.0
    kept = np.flatnonzero(((centres == corner) & (neighbours == 1)) | ((centres == 1) & (neighbours == corner)))
    model.failure.phi[kept] = 1.0
    model.take_failure()
    assert model.material_term.n_detached >= 1
    assert np.isfinite(model.internal_force(strained)).all()


def strained(model, *stretches):
    """Return the displacement of a uniform strain with these principal values along the axes."""
    return model.cloud.x * np.array(stretches)


def across_only(model):
    """Let every particle keep only the bonds that lie steeper than two to one across the x axis."""
    xi = model.families.bonds(model.cloud.x)
    model.failure.phi[np.abs(xi[:, 1]) < 1.9 * np.abs(xi[:, 0])] = 0.0
    model.take_failure()


@pytest.mark.parametrize("scheme", SCHEMES)
def test_bonds_across_a_pull_break_with_the_strain_of_their_gradient(scheme):
    """Pulled along x and contracting, bonds that lie across shorten; what carries the pull must break all the same."""
    horizon = 2.5
    model = damaged_body(2, pd.Brittle(CRITICAL), SCHEMES[scheme], pd.Silling(0.5), horizon=horizon)
    pulled = strained(model, 0.1, -0.05)
    drive = model.problem.damage.driving_variable
    assert not model.failure.tear(drive.at_strain(model.material_term.family_strain(model.at(pulled)))), (
        "families that have lost nothing break by stretch"
    )
    across_only(model)
    e = model.elongation(pulled)
    assert np.all(e[model.failure.intact] < 0.0)
    assert model.operator.volume.any()
    u = pulled[: model.cloud.n_owned]
    # Neither turned, nor pressed, nor below the critical strain.
    turn = np.array([[0.8, -0.6], [0.6, 0.8]]) - np.eye(2)
    assert not model.break_bonds(model.cloud.x @ turn.T)
    assert not model.break_bonds(strained(model, -0.1, -0.05))
    assert not model.break_bonds(strained(model, 0.019, -0.01))
    strain = model.material_term.family_strain(model.at(pulled))
    oblique = model.failure.intact & (np.abs(model.families.bonds(model.cloud.x)[:, 0]) > 0.5)
    carried = np.isin(model.families.centres, model.operator.owner[model.operator.volume > 0.0])
    # A bond at slope two feels the share of the strain along x that lies in its direction.
    assert np.allclose(strain[oblique & carried], 0.1 / np.sqrt(5.0), rtol=1e-10)
    assert np.abs(model.internal_force(u)).max() > 0.01
    while model.break_bonds(u):
        pass
    assert np.abs(model.internal_force(u)).max() < 1e-12
    kept = model.failure.intact
    assert np.all(np.abs(model.families.bonds(model.cloud.x)[kept, 0]) < 0.5)


def test_controls_that_cannot_fade_with_the_present_stretch_are_refused():
    law = pd.LinearSoftening(CRITICAL, effect=pd.PresentStretch())
    model = damaged_body(2, law, control=pd.Wan())
    with pytest.raises(pd.CaseError, match="cannot follow bonds that fade with their present stretch"):
        model.internal_force(0.01 * model.cloud.x)


@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS.keys())
@pytest.mark.parametrize("dim", DIMS)
def test_a_fracture_energy_is_what_breaking_the_bonds_across_a_plane_takes(dim, law):
    Gc = 0.7
    model = bond_body(dim, pd.BondBased(E=10.0, calibration="lattice"), cell=True, damage=law(pd.FractureEnergy(Gc)))
    cloud, families = model.cloud, model.families
    sides = np.ptp(cloud.x[: cloud.n_owned], axis=0) + 1.0
    one = np.ones(len(model.material_term.k))
    energy = 0.5 * model.material_term.k * model.problem.damage.limit**2
    each = model.failure.law.dissipated(0.0 * one, model.failure.law.final * one, energy)
    found = []
    for axis in range(dim):
        # A plane between two layers and its images; bonds across it count from both of their ends.
        planes = 0.5 + sides[axis] * np.arange(-2, 3)
        ends = cloud.x[families.centres, axis], cloud.x[families.neighbours, axis]
        crossing = (np.minimum(*ends)[:, None] < planes) & (np.maximum(*ends)[:, None] > planes)
        found.append((each @ crossing).sum() / np.prod(np.delete(sides, axis)))
    assert np.mean(found) == pytest.approx(Gc, rel=1e-12)


@pytest.mark.long
@pytest.mark.parametrize("energy", [pd.FractureEnergy, lambda Gc, share=None: pd.BondEnergy(Gc=Gc, share=share)])
def test_a_fracture_energy_serves_gradients_too(energy, tmp_path, caplog):
    """They take a share of it, which a case gives or a warning asks for."""
    import dataclasses

    from tests.damage.test_fracture import strip

    def warned(share):
        caplog.clear()
        law = pd.Brittle(energy(0.01, share))
        found = pd.run(dataclasses.replace(strip(), damage=law), output=tmp_path / str(share))
        assert found["broken"] > 0
        return any("through deformation gradients dissipates" in one.message for one in caplog.records)

    assert warned(None)
    assert not warned(0.5)
    limit, half = (pd.prepare(dataclasses.replace(strip(), damage=pd.Brittle(energy(0.01, share)))).problem.damage.limit
                   for share in (None, 0.5))  # fmt: skip
    np.testing.assert_allclose(half, np.sqrt(2.0) * limit)
    for wrong in (lambda: energy(0.0), lambda: energy(1.0, 0.0), lambda: energy(1.0, -1.0)):
        with pytest.raises(pd.CaseError, match="positive"):
            wrong()


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: pd.ExponentialSoftening(CRITICAL, 0.5),
        lambda: pd.ExponentialSoftening(CRITICAL, 2.0, -1.0),
        lambda: pd.BilinearSoftening(CRITICAL, 7.0),
        lambda: pd.SmoothDegradation(CRITICAL, 1.0),
        lambda: pd.Brittle(0.1),
        lambda: pd.LinearSoftening(0.1),
    ],
)
def test_wrong_laws_are_refused(wrong):
    with pytest.raises(pd.CaseError):
        wrong()


def state_of(u, x, V, horizon, E, nu, law, G):
    """Return forces of the published force states, Eq. (49) with its misprints put right, pair by pair in plain numpy.

    ``T = T_s (P B^-1 xi + G C / omega_0 z)`` with the unit of length as the unit of G, plane strain, small deformation
    gradients from bonds that are not broken; those with a critical stretch of zero in ``law`` are.
    """
    n = len(x)
    d = np.linalg.norm(x[None] - x[:, None], axis=2)
    near = (d > 0.0) & (d <= horizon)
    lam, mu = E * nu / (1.0 + nu) / (1.0 - 2.0 * nu), E / 2.0 / (1.0 + nu)
    C = 12.0 / (np.pi * horizon**4) * E / 2.0 / (1.0 - nu - 2.0 * nu**2)
    T = np.zeros((n, n, 2))
    for i in range(n):
        omega_0 = V * np.count_nonzero(near[i])
        intact = [j for j in range(n) if near[i, j] and law(i, j) is not None]
        B, M = np.zeros((2, 2)), np.zeros((2, 2))
        for j in intact:
            xi, Y = x[j] - x[i], x[j] + u[j] - x[i] - u[i]
            B += np.outer(xi, xi) * V
            M += np.outer(Y, xi) * V
        F = M @ np.linalg.inv(B)
        w, n_ = np.linalg.eigh(F @ F.T)
        eps = n_ @ np.diag(0.5 * np.log(w)) @ n_.T
        P = (lam * np.trace(eps) * np.eye(2) + 2.0 * mu * eps) @ np.linalg.inv(F).T
        for j in intact:
            xi, Y = x[j] - x[i], x[j] + u[j] - x[i] - u[i]
            s = np.linalg.norm(Y) / np.linalg.norm(xi) - 1.0
            T[i, j] = law(i, j)(s) * (P @ np.linalg.inv(B) @ xi + G * C / omega_0 * (Y - F @ xi))
    return (T.transpose(1, 0, 2) - T).sum(axis=1) * V * V


def published(s, s_min=0.015, s_cr=0.02, beta=3.0):
    """Return ``T_s`` of Eq. (48), and past the critical stretch what is left there: no bond breaks inside Newton."""
    s = min(s, s_cr)
    return 1.0 if s < s_min else 0.5 * (1.0 - np.tanh(beta * (s_min + s_cr - 2.0 * s) / (s_min - s_cr)))


PUBLISHED = pd.SmoothDegradation(CRITICAL, 0.75, continuous=False, effect=pd.PresentStretch())
MATERIAL = pd.Hencky(E=10.0, nu=0.3)


def with_broken(model, rng, share=0.12):
    """Break a share of the bonds, both ends of each."""
    keys = model.failure.of.keys()
    picked = rng.permutation(np.unique(keys, axis=0))[: int(share * len(keys) / 2)]
    lost = (keys[:, None] == picked[None]).all(axis=2).any(axis=1)
    model.failure.phi[lost] = 0.0
    model.take_failure()
    return lost


@pytest.mark.parametrize("G", [0.0, 0.7])
@pytest.mark.parametrize("breaks", [False, True])
def test_forces_of_the_present_stretch_are_the_published_ones(breaks, G, rng):
    model = damaged_body(2, PUBLISHED, control=pd.SillingMicromodulus(G, 1.0) if G else None, rng=rng)
    lost = with_broken(model, rng) if breaks else np.zeros(len(model.failure.phi), dtype=bool)
    pairs = set(zip(model.families.centres[lost].tolist(), model.families.neighbours[lost].tolist(), strict=True))
    u = softened(model, rng)
    T = model.problem.damage.phi(model.at(u))
    assert np.count_nonzero((T > 0.0) & (T < 1.0)) > 10
    expected = state_of(u, model.cloud.x, 1.0, 2.015, 10.0, 0.3, lambda i, j: None if (i, j) in pairs else published, G)
    found = model.internal_force(u)
    assert np.abs(found - expected).max() < 1e-12 * np.abs(expected).max()
    assert np.abs(found.sum(axis=0)).max() < 1e-13 * np.abs(found).sum()


def fine_differences(model, u, columns, step=2e-6):
    """Return columns of the tangent by differences of fourth order: degradation is too steep for those of second."""
    found = []
    for column in columns:
        d = np.zeros(u.size)
        d[column] = step
        d = d.reshape(u.shape)
        one, two = (model.internal_force(u + n * d) - model.internal_force(u - n * d) for n in (1, 2))
        found.append((8.0 * one - two).ravel() / (12.0 * step))
    return np.array(found).T


@pytest.mark.parametrize("control", [None, pd.Silling(0.5), pd.SillingMicromodulus(3.0, 1.0)])
@pytest.mark.parametrize("scheme", ["correspondence", "sub_horizons"])
@pytest.mark.parametrize("breaks", [False, True])
def test_the_tangent_of_the_present_stretch_is_exact(breaks, scheme, control, rng):
    law = pd.SmoothDegradation(CRITICAL, 0.5, effect=pd.PresentStretch())
    model = damaged_body(2, law, SCHEMES[scheme], control, rng=rng)
    if breaks:
        with_broken(model, rng)
    u = displacement(model, rng, 0.001) + 0.015 * (model.cloud.x - model.cloud.x.mean(axis=0))
    x = model.driving_values(u)
    # No bond is so close to an end of the law that a difference steps across its kink.
    assert np.abs(x - 0.5).min() > 1e-4
    assert np.abs(x - 1.0).min() > 1e-4
    assert np.count_nonzero(softening(model, u)[1]) > 40
    K = dense_tangent(model, u)
    columns = rng.choice(u.size, 10, replace=False)
    assert np.abs(K[:, columns] - fine_differences(model, u, columns)).max() < 1e-7 * np.abs(K).max()
    du = rng.standard_normal(u.shape)
    assert np.allclose(K @ du.ravel(), model.tangent_times(u, du).ravel(), atol=1e-11 * np.abs(K).max())


@pytest.mark.parametrize("control", [None, pd.Silling(0.5)])
def test_one_bond_of_the_present_stretch_follows_the_curve_and_heals(control, rng):
    """Two particles: F is the stretch of their bond, so that its force is T_s 2 V P(1 + s) / length at both ends."""
    x, V, length = np.array([[0.0], [0.7]]), 1.3, 0.7
    cloud = distribute(world(), x, np.full(2, V), {}, 1.0)
    families = find_families(cloud)
    of = np.zeros(2, dtype=np.int32)
    model = small_points(cloud, families, np.ones(2), pd.Correspondence(), [MATERIAL], of, control, PUBLISHED)
    for s in (0.005, 0.0149, 0.0151, 0.016, 0.0175, 0.0199, 0.012, 0.017):
        u = np.array([[0.0], [s * length]])
        force = published(s) * 2.0 * V * 10.0 * np.log1p(s) / (1.0 + s) / length
        assert model.internal_force(u)[1, 0] == pytest.approx(force, rel=1e-12)
        model.commit(u)
        assert not model.break_bonds(u)
    # Past the critical stretch it keeps what is left there until equilibrium breaks it, and then nothing.
    u = np.array([[0.0], [0.021 * length]])
    assert model.internal_force(u)[1, 0] == pytest.approx(
        0.5 * (1.0 - np.tanh(3.0)) * 2.0 * V * 10.0 * np.log1p(0.021) / 1.021 / length, rel=1e-12
    )
    assert model.break_bonds(u) == 1
    assert not model.internal_force(0.5 * u).any()


def test_particles_of_the_present_stretch_keep_their_volume_and_are_not_torn():
    model = damaged_body(2, pd.Brittle(CRITICAL, effect=pd.PresentStretch()), control=pd.Silling(0.5), horizon=2.5)
    across_only(model)
    kept = np.isin(np.arange(model.cloud.n_owned), model.operator.owner[model.operator.volume > 0.0])
    assert kept.any()
    assert np.array_equal(model.operator.volume[kept], np.ones(np.count_nonzero(kept)))
    assert not model.break_bonds(strained(model, 0.1, -0.05))
    lost = np.bincount(model.families.centres, ~model.failure.intact) / np.bincount(model.families.centres)
    assert np.allclose(model.problem.damage.lost_bonds(), lost, rtol=1e-14)


def test_bodies_of_bonds_do_not_heal():
    with pytest.raises(pd.CaseError, match="PresentStretch is for deformation gradients"):
        pd.Case(
            particles=pd.Lattice((0.0, 0.0), (4.0, 4.0), 1.0), horizon=2.015, material=pd.BondBased(E=1.0),
            conditions=[], damage=PUBLISHED,
        )  # fmt: skip
