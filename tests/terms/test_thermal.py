"""Strains without stress: free bodies have no stress, the tangent is exact, held ones have the stress they should."""

import dataclasses

import numpy as np
import pytest

import pdpetsc as pd
from pdpetsc.command_line.cli import load_case
from pdpetsc.problem.expansion import FreeDeformation, StressFree
from tests import scenes
from tests.commands import ROOT, results
from tests.run.test_durable import Stop

DIMS = scenes.DIMS
FIBRES = {
    1: (1.0,), 2: (0.6, 0.8), 3: (0.6, 0.0, 0.8),
}  # fmt: skip


def turning(x):
    return 0.3 * x[:, 0]


def laws(dim):
    """Yield (name, material) of every kind of law in a dimension, in plane strain and plane stress."""
    everywhere = scenes.MATERIALS | (scenes.PLANE_STRESS if dim == 2 else {})
    yield from everywhere.items()
    constants = (30.0, 10.0, 8.0), (0.2, 0.25, 0.3), (4.0, 5.0, 3.0)
    for plane in ("strain", "stress") if dim == 2 else ("strain",):
        yield f"orthotropic {plane}", pd.Orthotropic(*constants, 0.3, plane=plane)
        yield f"orthotropic by place {plane}", pd.Orthotropic(*constants, turning, plane=plane)
        yield f"mooney {plane}", pd.MooneyRivlin(1.0, 0.3, 8.0, plane=plane)
        energy = "mu/2*(I1 - 3 - 2*log(J)) + lam/2*log(J)**2 + k*(I4 - 1)**2"
        yield f"fibres {plane}", pd.Hyperelastic(energy, fibre=FIBRES[dim], mu=3.0, lam=5.0, k=1.0, plane=plane)


class Given(StressFree):
    """A strain without stress that a test gives."""

    @property
    def softens(self):
        return self.given.factor is not None

    def at(self, t):
        return self.given


def expanded(model, strain, factor=None, across=0.0):
    """Give a small model the same strain without stress everywhere, or one per particle (n, 3, 3)."""
    n = model.cloud.n_owned
    strain = np.broadcast_to(strain, (n, 3, 3))

    of = np.zeros(n, dtype=int)
    given = Given(model.cloud, model.families, [], of, None, [], np.full(n, across))
    given.given = FreeDeformation(given, 0.0, None)
    given.given.strain, given.given.factor = strain, factor
    model.problem.body.expansion = given
    return model


def tensor(rng, dim, size=0.2):
    """Return a random strain that a body can have: none that shears it out of itself."""
    made = size * rng.uniform(-1.0, 1.0, (3, 3))
    made = 0.5 * (made + made.T)
    for a in range(3):
        for b in range(3):
            if a != b and max(a, b) >= dim:
                made[a, b] = 0.0
    return made


@pytest.mark.processors
@pytest.mark.parametrize("dim", DIMS)
@pytest.mark.parametrize("scheme", scenes.SCHEMES)
def test_free_expansion_has_no_stress_on_any_cloud(dim, scheme, rng):
    # Whatever expands freely across is free across: solids, bars and plane stress; any stress-free deformation turned.
    control = pd.Silling(0.5)
    for name, material in laws(dim):
        if dim == 2 and material.plane == "strain":
            continue
        strain = tensor(rng, dim)
        model = expanded(scenes.body(dim, scenes.SCHEMES[scheme], control, material, rng=rng, expands=True), strain)
        G = np.eye(dim) + strain[:dim, :dim]
        if not material.linear:
            G = scenes.rotation(dim, rng) @ G
        u = model.cloud.x[: model.cloud.n_owned] @ (G - np.eye(dim)).T
        # Corrected weights multiply the round-off of u by the sum of their sizes, a few thousand on this cloud.
        size = 1e-11 * 10.0 * np.abs(strain).max()
        assert np.abs(model.internal_force(u)).max() < size * 10.0, name
        assert np.abs(model.material_term.cauchy_stress(model.at(u))).max() < size, name
        assert abs(sum(model.energy(u))) < size, name


def test_free_expansion_of_a_smoothed_displacement_and_beside_every_control(rng):
    for dim in DIMS:
        strain = tensor(rng, dim)
        models = [scenes.body(dim, pd.SmoothedDisplacement(), horizon=3.3, rng=rng, expands=True)]
        for name, control in (scenes.ALL_CONTROLS | (scenes.PLANE if dim > 1 else {})).items():
            if name not in scenes.NOT_AFFINE:
                models.append(
                    scenes.body(dim, pd.Correspondence(), control, pd.LinearElastic(10.0, 0.3), rng=rng, expands=True)
                )
        for model in models:
            if dim == 2:  # plane strain
                strain[2, 2] = 0.0
            G = strain[:dim, :dim]
            expanded(model, strain)
            u = model.cloud.x[: model.cloud.n_owned] @ G.T
            assert np.abs(model.internal_force(u)).max() < 1e-11


def test_a_free_cell_and_half_a_body_expand(tmp_path):
    everywhere = pd.region.All()
    material = pd.Thermal(pd.NeoHookean(10.0, 0.3, plane="stress"), (0.05, 0.02, 0.01), orientation=0.4)
    stretch = np.eye(2) + material.strain(np.array([2.0]))[0, :2, :2]
    cell = pd.Case(
        pd.Lattice((0.0, 0.0), (4.0, 4.0), 1.0), 2.015, material,
        [
            pd.Displacement(pd.region.Nearest((0.5, 0.5)), x=0.0, y=0.0), pd.Temperature(everywhere, 2.0),
            pd.MeanStress(xx=0.0, yy=0.0, xy=0.0),
        ],
        cell=pd.Cell((0.0, 0.0), (4.0, 4.0)),
    )  # fmt: skip
    end = pd.run(cell, output=tmp_path / "cell").solution
    assert np.abs(pd.stress(end)).max() < 1e-9 and np.abs(end.cell_strain + np.eye(2) - stretch).max() < 1e-9

    def plate(width, law, **changes):
        hot = pd.Temperature(everywhere, lambda x, t: t * (x[:, 0] ** 2 + 3.0 * x[:, 1]))
        held = pd.Displacement(pd.region.Nearest((0.5, 0.5)) | pd.region.Nearest((-0.5, 0.5)), y=0.0)
        centred = [pd.Displacement(pd.region.Slab("y", high=1.0), x=0.0)]
        case = pd.Case(
            pd.Lattice((-width, 0.0), (5.0, 4.0), 1.0), 2.015, pd.Thermal(law, (2e-3, 1e-3, 3e-3)),
            [hot, held, *centred], **changes,
        )  # fmt: skip
        return pd.run(case, output=tmp_path / "plate").solution

    for law in (pd.Hencky(10.0, 0.3), pd.BondBased(10.0, kinematics="finite")):
        whole, half = plate(5.0, law), plate(0.0, law, symmetry=[pd.Symmetry("x")])
        right = whole.x[:, 0] > 0.0
        assert np.abs(whole.u[right] - half.u).max() < 1e-9 * np.abs(whole.u).max()
        assert np.abs(pd.stress(whole)[right] - pd.stress(half)).max() < 1e-7


@pytest.mark.parametrize("dim", DIMS)
def test_tangent_against_differences_and_force_against_energy(dim, rng):
    for name, material in laws(dim):
        n = int(np.prod(scenes.SIDES[dim]))
        strain = np.array([tensor(rng, dim, 0.1) for _ in range(n)])
        factor = rng.uniform(0.5, 1.5, n)
        scheme = pd.SubHorizons() if dim < 3 else pd.Correspondence()
        model = expanded(scenes.body(dim, scheme, None, material, rng=rng, expands=True), strain, factor)
        u = scenes.displacement(model, rng)
        if material.has_history:
            model.commit(u)
            u = scenes.displacement(model, rng)
        columns = rng.choice(u.size, size=min(5, u.size), replace=False)
        exact = scenes.dense_tangent(model, u)[:, columns]
        found = scenes.differences(model, u, columns)
        assert np.abs(exact - found).max() < 1e-7 * np.abs(exact).max(), name
        du = rng.standard_normal(u.shape)
        ends = [sum(model.energy(u + s * scenes.STEP * du)) for s in (1.0, -1.0)]
        slope = (ends[0] - ends[1]) / (2.0 * scenes.STEP)
        assert abs((model.internal_force(u) * du).sum() - slope) < 1e-6 * max(abs(slope), 1.0), name


def patched(dim, material, rng, scheme="sub_horizons"):
    """Return a small body that shares the dilatation of its elastic part in patches."""
    return scenes.body(dim, pd.MeanDilatation(scenes.SCHEMES[scheme], 2.0), None, material, rng=rng, expands=True)


PATCHED = {
    "linear": pd.LinearElastic(E=10.0, nu=0.49),
    "neo_hookean": pd.NeoHookean(E=10.0, nu=0.49),
    "j2": pd.J2(E=10.0, nu=0.4, yield_stress=0.3, hardening=1.0),
}


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("name", PATCHED)
def test_patches_expand_freely_and_their_tangent_is_exact(dim, name, rng):
    """Free expansion, turned, has no stress and no energy; forces, tangent and energy belong together elsewhere."""
    material = PATCHED[name]
    strain = tensor(rng, dim)
    strain[2, 2] = strain[2, 2] if dim == 3 else 0.0
    model = expanded(patched(dim, material, rng), strain)
    G = np.eye(dim) + strain[:dim, :dim]
    if not material.linear:
        G = scenes.rotation(dim, rng) @ G
    u = model.cloud.x[: model.cloud.n_owned] @ (G - np.eye(dim)).T
    assert np.abs(model.internal_force(u)).max() < 1e-11
    assert abs(sum(model.energy(u))) < 1e-12

    n = model.cloud.n_owned
    factor = rng.uniform(0.8, 1.2, n)
    uneven = np.array([tensor(rng, dim, 0.1) for _ in range(n)])
    uneven[:, 2, 2] = 0.05 * rng.uniform(-1.0, 1.0, n)
    model = expanded(patched(dim, material, rng), uneven, factor)
    u = scenes.displacement(model, rng)
    if material.has_history:
        model.commit(u)
        u = scenes.displacement(model, rng)
    K, f = scenes.dense_tangent(model, u), model.internal_force(u)
    columns = rng.choice(u.size, size=5, replace=False)
    assert np.abs(K[:, columns] - scenes.differences(model, u, columns)).max() < 1e-7 * np.abs(K).max()
    step = 1e-6 * rng.standard_normal(u.shape)
    work = (sum(model.energy(u + step)) - sum(model.energy(u - step))) / 2.0
    assert work == pytest.approx(np.vdot(f, step), rel=1e-4)


def test_energy_of_patches_by_the_strain_without_stress(rng):
    for material in (PATCHED["linear"], PATCHED["neo_hookean"]):
        model = patched(2, material, rng)
        n = model.cloud.n_owned
        strain = np.array([tensor(rng, 2, 0.05) for _ in range(n)])
        strain[:, 2, 2] = 0.05 * rng.uniform(-1.0, 1.0, n)
        change = np.array([tensor(rng, 2) for _ in range(n)])
        change[:, 2, 2] = rng.uniform(-1.0, 1.0, n)
        u = scenes.displacement(model, rng)
        expanded(model, strain)
        S, operator = model.material_term.energy_by_strain(model.at(u)), model.operator
        slope = operator.volume @ np.einsum("pij,pij->p", S, change[operator.owner])
        # Another body each: a state keeps what it was asked at its temperature.
        ends = []
        for by in (1e-6, -1e-6):
            ends.append(sum(expanded(model, strain + by * change).energy(u)))
        assert (ends[0] - ends[1]) / 2e-6 == pytest.approx(slope, rel=1e-6)


def test_plane_strain_is_a_solid_held_across(rng):
    # One law in the plane and as a solid with the same in-plane deformation and F_zz = 1: the same stress.
    strain = tensor(rng, 2)
    for material in scenes.MATERIALS.values():
        plane = expanded(scenes.body(2, pd.Correspondence(), None, material, expands=True), strain)
        solid = expanded(scenes.body(3, pd.Correspondence(), None, material, expands=True), strain)
        H = 0.1 * rng.uniform(-1.0, 1.0, (2, 2))
        u = plane.cloud.x[: plane.cloud.n_owned] @ H.T
        whole = np.pad(H, ((0, 1), (0, 1)))
        v = solid.cloud.x[: solid.cloud.n_owned] @ whole.T
        for _ in range(2):
            a, b = plane.material_term.cauchy_stress(plane.at(u))[0], solid.material_term.cauchy_stress(solid.at(v))[0]
            across = plane.material_term.out_of_plane(plane.at(u))
            assert np.abs(a - b[:2, :2]).max() < 1e-12
            assert abs(across[2][0] - b[2, 2]) < 1e-12
            assert across[0][0] == 1.0
            plane.commit(u), solid.commit(v)


def test_without_strain_nothing_changes(rng):
    for dim in DIMS:
        for name, material in laws(dim):
            seed = int(rng.integers(2**31))
            bare = scenes.body(dim, pd.SubHorizons(), None, material, rng=np.random.default_rng(seed))
            same = scenes.body(dim, pd.SubHorizons(), None, material, rng=np.random.default_rng(seed), expands=True)
            expanded(same, np.zeros((3, 3)))
            u = scenes.displacement(bare, rng)
            f = bare.internal_force(u)
            assert np.abs(same.internal_force(u) - f).max() < 1e-12 * np.abs(f).max(), name
            for one, other in zip(
                bare.material_term.out_of_plane(bare.at(u)), same.material_term.out_of_plane(same.at(u)), strict=True
            ):
                assert np.abs(one - other).max() < 1e-11, name


HELD = [
    pd.Displacement(pd.region.Nearest((0.5, 0.5)), x=0.0, y=0.0),
    pd.Displacement(pd.region.Nearest((5.5, 0.5)), y=0.0),
]
BLOCK = pd.Lattice((0.0, 0.0), (6.0, 5.0), 1.0)


def block(material, *conditions, **changes):
    given = {"particles": BLOCK, "horizon": 2.015, "material": material, "fields": [pd.stress, pd.temperature]}
    return pd.Case(**{**given, "conditions": [*HELD, *conditions], **changes})


def test_free_and_held_blocks_in_closed_form(tmp_path):
    E, nu, alpha, rise = 10.0, 0.3, 1e-3, 50.0
    everywhere, e = pd.region.All(), alpha * rise
    heated = pd.Temperature(everywhere, 20.0 + rise)
    for material, growth, across in (
        (pd.LinearElastic(E, nu), (1.0 + nu) * e, -E * e),
        (pd.LinearElastic(E, nu, plane="stress"), e, 0.0),
        (pd.BondBased(E), 1.25 * e, -E * e),
        (pd.BondBased(E, plane="stress", kinematics="finite"), e, 0.0),
        (pd.LinearSolid(E, 0.2), 1.2 * e, -E * e),
        (pd.LinearSolid(E, 0.2, plane="stress"), e, 0.0),
    ):
        result = pd.run(block(pd.Thermal(material, alpha, reference=20.0), heated), output=tmp_path / "free")
        end = result.solution
        assert abs(np.ptp(end.u[:, 0]) - 5.0 * growth) < 1e-9, material
        assert np.abs(pd.stress(end)).max() < 1e-9, material
        assert np.abs(end.out_of_plane[1] - across).max() < 1e-9, material
        assert np.all(pd.temperature(end) == 20.0 + rise)
        # Held everywhere: the stress of the whole strain.
        clamped = pd.Displacement(everywhere, x=0.0, y=0.0)
        held = block(pd.Thermal(material, alpha, reference=20.0), heated, conditions=[clamped, heated])
        found = pd.stress(pd.run(held, output=tmp_path / "held").solution)[17]
        ratio = {pd.BondBased: 0.25 if material.plane == "strain" else 1.0 / 3.0, pd.LinearSolid: 0.2}.get(
            type(material), nu
        )
        expected = E * e / (1.0 - 2.0 * ratio) if material.plane == "strain" else E * e / (1.0 - ratio)
        if isinstance(material, pd.LinearElastic):
            assert np.abs(found + expected * np.eye(2)).max() < 1e-12
        else:  # of bonds a family of a few particles is not the whole ball
            assert abs(found[0, 0] + expected) < 0.35 * expected


def test_a_temperature_goes_from_the_stress_free_one_to_its_value(tmp_path):
    steps = pd.Steps(4)
    history = {"T": pd.Mean(pd.temperature), "x": pd.Largest(pd.displacement, "x")}
    material = pd.Thermal(pd.NeoHookean(10.0, 0.3, plane="stress"), 1e-3, reference=300.0)
    number = block(material, pd.Temperature(pd.region.All(), 500.0), steps=steps, history=history)
    array = block(material, pd.Temperature(pd.region.All(), np.full(30, 500.0)), steps=steps, history=history)
    function = block(
        material, pd.Temperature(pd.region.All(), lambda x, t: 300.0 + 200.0 * t + 0.0 * x[:, 0]), steps=steps,
        history=history,
    )  # fmt: skip
    table = block(
        material, pd.Temperature(pd.region.All(), 500.0, pd.Table([0.0, 1.0], [0.0, 1.0])), steps=steps, history=history
    )
    for n, case in enumerate((number, array, function, table)):
        result = pd.run(case, output=tmp_path / str(n))
        assert np.allclose(result.history["T"], [300.0, 350.0, 400.0, 450.0, 500.0], atol=1e-10)
        assert np.allclose(result.history["x"], 5.0 * 1e-3 * np.array([0.0, 50.0, 100.0, 150.0, 200.0]), atol=1e-10)


def test_an_array_follows_the_particles(tmp_path):
    x = np.random.default_rng(3).permutation(30)
    case = block(
        pd.Thermal(pd.LinearElastic(10.0, nu=0.0), 1e-3), pd.Temperature(pd.region.All(), x.astype(float), pd.Hold())
    )
    result = pd.run(case, output=tmp_path / "run")
    assert np.array_equal(result.field("temperature"), x)


def test_eigenstrain_is_what_expansion_is(tmp_path):
    strain = 0.07
    hot = block(
        pd.Thermal(pd.Hencky(10.0, 0.3), (1e-3, 2e-3, 3e-3)), pd.Temperature(pd.region.All(), 10.0), fields=[pd.stress]
    )
    swollen = block(
        pd.Hencky(10.0, 0.3), pd.Eigenstrain(pd.region.All(), xx=0.01, yy=0.02, zz=0.03), fields=[pd.stress]
    )
    a, b = (pd.run(case, output=tmp_path / name).solution for name, case in (("a", hot), ("b", swollen)))
    assert np.abs(a.u - b.u).max() < 1e-12 and np.abs(a.u).max() > 0.05
    assert strain > 0.0


def test_axes_of_the_material_turn_its_expansion():
    for angle in (0.4, np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])):
        one = pd.Thermal(pd.Hencky(1.0, nu=0.0), (1e-3, 2e-3, 3e-3), orientation=angle)
        R = one.axes
        found = one.strain(np.array([100.0]))[0]
        assert np.allclose(R.T @ found @ R, np.diag([0.1, 0.2, 0.3]), atol=1e-15)


def test_what_cannot_be_is_refused(tmp_path):
    everywhere = pd.region.All()
    hot = pd.Temperature(everywhere, 10.0)
    thermal = pd.Thermal(pd.LinearElastic(10.0, 0.3), 1e-3)
    for case, message in (
        (block(thermal), "needs a temperature"),
        (block(pd.LinearElastic(10.0, 0.3), hot), "acts on no material that knows temperature"),
        (block(thermal, hot, pd.Temperature(pd.region.Slab("x", high=1.0), 1.0)), "5 particles a second time"),
        (block(thermal, pd.Temperature(everywhere, np.zeros(7))), "7 numbers for 30 particles"),
        (block(thermal, pd.Temperature(everywhere, lambda x, t: np.inf * x[:, 0])), "is inf for 30"),
        (block(pd.LinearElastic(1.0, nu=0.0), pd.Eigenstrain(everywhere, xz=0.1)), "a 2-dimensional body cannot have"),
        (block(pd.LinearElastic(1.0, nu=0.0), pd.Eigenstrain(everywhere, xx=-1.5)), "leaves no volume"),
        (block(pd.Thermal(pd.BondBased(1.0), 1e-3, factor=lambda T: 1.0 + 0.0 * T), hot), "does not depend on temp"),
        (block(pd.Thermal(pd.LinearElastic(1.0, nu=0.0), 1e-3, factor=lambda T: -T), hot), "must be positive"),
        (block(thermal, hot, solver=pd.PathFollowing(), damage=pd.LinearSoftening(pd.ConstantCritical(1.0))), "Newton"),
    ):
        with pytest.raises(pd.CaseError, match=message):
            pd.run(dataclasses.replace(case, fields=[]), output=tmp_path / "refused")
    with pytest.raises(pd.CaseError, match="says nothing of temperature"):
        pd.run(block(pd.LinearElastic(1.0, nu=0.0)), output=tmp_path / "refused")


def test_bonds_free_to_expand_have_no_force(rng):
    for dim in DIMS:
        for name, material in (scenes.BONDS | (scenes.PLANE_STRESS_BONDS if dim == 2 else {})).items():
            model = scenes.bond_body(dim, material, rng=rng)
            strain = tensor(rng, dim)
            nu = material.elastic(dim).nu if dim == 2 and material.plane == "strain" else 0.0
            expanded(model, strain, across=nu)
            G = strain[:dim, :dim] + nu * strain[2, 2] * np.eye(dim)
            u = model.cloud.x[: model.cloud.n_owned] @ G.T
            assert np.abs(model.internal_force(u)).max() < 1e-12, f"{dim}D {name}"
            assert np.abs(model.internal_force(np.zeros_like(u))).max() > 1e-3


def test_tangent_of_bonds_and_of_damage_beyond_what_they_expand(rng):
    for dim in (1, 2, 3):
        strain = np.array([tensor(rng, dim, 0.05) for _ in range(int(np.prod(scenes.SIDES[dim])))])
        law = pd.LinearSoftening(pd.LinearCritical(0.01, 0.2, 0.3))
        for model in (
            scenes.bond_body(dim, pd.BondBased(10.0, kinematics="finite"), rng=rng),
            scenes.bond_body(dim, pd.BondBased(10.0, kinematics="finite"), rng=rng, damage=law),
            scenes.damaged_body(dim, law, material=pd.Hencky(10.0, 0.3), rng=rng, expands=True),
        ):
            expanded(model, strain)
            u = scenes.displacement(model, rng, 0.02)
            columns = rng.choice(u.size, size=4, replace=False)
            exact = scenes.dense_tangent(model, u)[:, columns]
            found = scenes.differences(model, u, columns)
            assert np.abs(exact - found).max() < 1e-6 * np.abs(exact).max()


def softer(T):
    return pd.J2(E=100.0 - 0.2 * T, nu=0.3, yield_stress=0.5 - 0.004 * T, hardening=5.0)


def test_a_law_may_depend_on_temperature(tmp_path):
    # At one temperature it is the law there, and where it differs from place to place the tangent is exact.
    cold, hot = pd.Thermal(softer(0.0), 1e-3, law=softer), pd.Thermal(softer(50.0), 1e-3)
    history = {"R": pd.Reaction("x", pd.region.Slab("x", high=1.0))}
    pulled = [
        pd.Displacement(pd.region.Slab("x", high=1.0), x=0.0, y=0.0),
        pd.Displacement(pd.region.Slab("x", low=5.0), x=0.05),
        pd.Temperature(pd.region.All(), 50.0, pd.Hold()),
    ]
    case = block(cold, conditions=pulled, steps=pd.Steps(3), history=history, fields=[])
    found, same = (
        pd.run(dataclasses.replace(case, material=one), output=tmp_path / "run") for one in (cold, hot)
    )  # fmt: skip
    assert np.allclose(found.history["R"], same.history["R"], rtol=1e-8)
    assert pd.plastic_strain(found.solution).max() > 1e-3
    uneven = pd.Temperature(pd.region.All(), lambda x, t: 8.0 * t * x[:, 1])
    for law in (softer, lambda T: pd.LinearElastic(10.0 - 0.1 * T, 0.3, plane="stress")):
        thermal = pd.Thermal(law(0.0), 1e-3, law=law, factor=lambda T: 1.0 - 1e-3 * T)
        conditions = [*pulled[:2], uneven]
        prepared = pd.prepare(block(thermal, conditions=conditions, fields=[]))
        rng = np.random.default_rng(1)
        u = 0.01 * rng.uniform(-1.0, 1.0, (30, 2))
        problem = prepared.problem
        problem.commit(problem.state(u, 0.5))
        du = rng.standard_normal(u.shape)
        ends = [problem.internal_force(problem.state(2.0 * u + s * 1e-6 * du, 1.0)).copy() for s in (1.0, -1.0)]
        product = problem.linearised(problem.state(2.0 * u, 1.0))(du)
        assert np.abs((ends[0] - ends[1]) / 2e-6 - product).max() < 1e-7 * np.abs(product).max()
    with pytest.raises(pd.CaseError, match="must return a J2"):
        pd.run(
            dataclasses.replace(case, material=dataclasses.replace(cold, law=lambda T: pd.Hencky(1.0, nu=0.0))),
            output=tmp_path,
        )


def test_heat_alone_breaks_no_bond_and_cold_that_is_held_does(rng):
    law = pd.Brittle(pd.ConstantCritical(0.05))
    hot = expanded(scenes.damaged_body(2, law, material=pd.Hencky(10.0, 0.3), expands=True), 0.2 * np.eye(3))
    u = 0.2 * hot.cloud.x[: hot.cloud.n_owned]
    assert np.abs(hot.driving_values(u)).max() < 1e-12
    cold = expanded(scenes.damaged_body(2, law, material=pd.Hencky(10.0, 0.3), expands=True), -0.06 * np.eye(3))
    assert np.abs(cold.driving_values(np.zeros_like(u)) - 0.06 / 0.05).max() < 1e-12


def test_strip_of_two_metals_bends_as_timoshenko_says(tmp_path):
    found = results("runs/thermal/bimetal.py", "ny=8", "length=20", output=tmp_path / "one")["results"]
    assert abs(found["curvature_over_exact"] - 1.0) < 0.07
    again = results("runs/thermal/bimetal.py", "ny=8", "length=20", ranks=2, output=tmp_path / "two")["results"]
    assert abs(again["curvature"] - found["curvature"]) < 1e-9 * abs(found["curvature"])
    case = load_case(ROOT / "runs/thermal/bimetal.py")(ny=4, length=10.0, law="hencky")
    options = {"pd_jacobian": "matfree", "pc_type": "gamg"}
    without, matrix = (pd.run(case, output=tmp_path / "run", options=given) for given in (options, {}))
    assert abs(without["curvature"] - matrix["curvature"]) < 1e-7 * abs(matrix["curvature"])
    assert abs(matrix["curvature_over_exact"] - 1.0) < 0.2


def test_cylinder_that_is_hot_inside(tmp_path):
    found = results("runs/thermal/cylinder.py", "n=8", output=tmp_path / "run")["results"]
    assert found["error_u"] < 0.02 and found["error_stress"] < 0.13 and found["error_axial"] < 0.035
    found = results("runs/thermal/cylinder.py", "n=8", "field=conducted", output=tmp_path / "conducted")["results"]
    assert found["error_T"] < 0.03 and found["error_u"] < 0.045 and found["error_stress"] < 0.13


def hot_plate(folder, steps, force=1.0, length=1.0, restart=None, **changes):
    """Run a clamped plate that heats unevenly, yields and softens, in some units."""
    stress = force / length**2
    material = pd.Thermal(
        pd.J2(E=100.0 * stress, nu=0.3, yield_stress=0.5 * stress, hardening=5.0 * stress), 1e-3, reference=10.0,
        factor=pd.Table([0.0, 100.0], [1.0, 0.8]),
    )  # fmt: skip
    given = {
        "particles": pd.Lattice((0.0, 0.0), (6.0 * length, 4.0 * length), length, thickness=length),
        "horizon": 2.015 * length,
        "material": material,
        "conditions": [
            pd.Displacement(pd.region.Slab("x", high=length), x=0.0, y=0.0),
            pd.Displacement(pd.region.Slab("x", low=5.0 * length), x=0.0),
            pd.Temperature(pd.region.All(), lambda x, t: 10.0 + t * (5.0 + 4.0 * x[:, 1] / length)),
        ],
        "steps": pd.Steps(steps),
        "fields": [pd.displacement, pd.stress, pd.plastic_strain, pd.temperature],
        "history": {"R": pd.Reaction("x", pd.region.Slab("x", high=length))},
    }
    # Points that yield begin a step on the yield surface. Rounding chooses their first tangent and so the way of
    # Newton, which ends anywhere within its tolerance.
    return pd.run(pd.Case(**{**given, **changes}), output=folder, restart=restart, options={"snes_rtol": 1e-13})


def test_a_hot_plate_in_other_units_and_after_a_restart(tmp_path):
    whole = hot_plate(tmp_path / "whole", 4)
    plastic = pd.plastic_strain(whole.solution)
    assert plastic.max() > 1e-4 and abs(whole.history["R"][-1]) > 0.1
    for force, length in ((2.0**67, 2.0**-67), (1e-5, 1e4)):
        other = hot_plate(tmp_path / "units", 4, force, length)
        assert np.abs(np.array(other.history["R"]) / force - whole.history["R"]).max() < 1e-9
        assert np.abs(pd.plastic_strain(other.solution) - plastic).max() < 1e-9
    with pytest.raises(pd.Interrupted):
        hot_plate(tmp_path / "part", 4, history={"until": Stop(0.5)})
    rest = hot_plate(tmp_path / "rest", 4, restart=tmp_path / "part")
    assert np.array_equal(rest.solution.u, whole.solution.u)
    assert np.array_equal(pd.plastic_strain(rest.solution), plastic)


def test_heat_alone_tears_no_bond_beside_a_broken_one():
    law = pd.Brittle(pd.ConstantCritical(0.05))
    model = scenes.damaged_body(2, law, material=pd.Hencky(10.0, 0.3), expands=True)
    first = np.flatnonzero(model.cloud.x[:, 0] < 0.5)
    u = np.zeros((model.cloud.n_owned, 2))
    u[first, 0] = -0.3
    assert model.break_bonds(u) > 0
    heated = expanded(model, np.diag([0.2, 0.1, 0.0]))
    free = model.cloud.x[: model.cloud.n_owned] * [0.2, 0.1]
    assert np.abs(heated.material_term.family_strain(heated.at(free))).max() < 1e-12
    assert heated.material_term.family_strain(heated.at(2.0 * free)).max() > 0.05
    assert heated.break_bonds(free) == 0
    assert np.abs(heated.internal_force(free)).max() < 1e-11


def test_relaxation_finds_the_same_as_newton(tmp_path):
    uneven = pd.Temperature(pd.region.All(), lambda x, t: t * (10.0 + x[:, 0] * x[:, 1]))
    material = pd.Thermal(pd.Hencky(10.0, 0.3), 1e-3)
    newton = block(material, uneven, fields=[])
    rest = dataclasses.replace(newton, solver=pd.DynamicRelaxation())
    a, b = (pd.run(case, output=tmp_path / "run").solution.u for case in (newton, rest))
    assert np.abs(a - b).max() < 1e-4 * np.abs(a).max()


def test_strain_that_a_body_has_without_stress_drives_no_damage():
    """Criteria of the whole strain are refused."""
    heated = pd.Temperature(pd.region.All(), 20.0)
    material = pd.Thermal(pd.LinearElastic(10.0, nu=0.0), 1e-3)
    strain = pd.LinearSoftening(pd.MazarsStrain(1e-3), ratio=5.0)
    with pytest.raises(pd.CaseError, match="Strain-based criteria use the total strain"):
        pd.prepare(block(material, heated, damage=strain))


VOCE = pd.hardening.Voce(0.3, 20.0)


@pytest.mark.parametrize(
    "law",
    [
        lambda T: pd.J2(E=100.0 - 0.2 * T, nu=0.3, yield_stress=0.5 - 0.004 * T, hardening=VOCE),
        lambda T: pd.J2(E=100.0 - 0.2 * T, nu=0.3, yield_stress=0.5 - 0.004 * T, hardening=1.0, plane="stress"),
        lambda T: pd.Maxwell(E=100.0 - T, nu=0.3, shear=[20.0 - 0.2 * T], times=[1.0], duration=1.0),
        lambda T: pd.KinematicJ2(E=100.0, nu=0.3, yield_stress=0.5 - 0.004 * T, kinematic=5.0),
        lambda T: pd.DruckerPrager(E=100.0, nu=0.3, cohesion=0.5 - 0.004 * T, friction=0.3, dilatancy=0.3),
        lambda T: pd.J2(
            E=100.0, nu=0.3, yield_stress=0.5, rate=pd.rate.Perzyna(duration=1.0, rate_0=1.0, drag=0.1 + 0.01 * T)
        ),
    ],
)
def test_a_law_by_temperature_is_the_law_of_that_temperature(law, tmp_path):
    """Its loops too, not its constants alone; also where one of two regions is hotter."""
    everywhere = pd.region.All()

    def strained(material, *conditions):
        pull = pd.Displacement(everywhere, x=lambda x, t: 0.02 * t * x[:, 0], y=lambda x, t: -0.005 * t * x[:, 1])
        given = {"particles": BLOCK, "horizon": 2.015, "scheme": pd.Correspondence(), "steps": pd.Steps(3)}
        case = pd.Case(material=material, conditions=[pull, *conditions], fields=[pd.stress], **given)
        return pd.stress(pd.run(case, tmp_path).solution)

    right = pd.region.Slab("x", low=3.0)
    both = strained(
        pd.Thermal(law(0.0), 0.0, law=law),
        pd.Temperature(right, 50.0, pd.Hold()),
        pd.Temperature(~right, 0.0, pd.Hold()),
    )
    cold, hot = strained(law(0.0)), strained(law(50.0))
    x = BLOCK.chunk(0, 1).x[:, 0]
    assert np.abs(hot - cold).max() > 1e-3 * np.abs(cold).max()
    assert np.allclose(both[x > 3.0], hot[x > 3.0], rtol=1e-9, atol=1e-12)
    assert np.allclose(both[x < 3.0], cold[x < 3.0], rtol=1e-9, atol=1e-12)


def test_a_law_that_remembers_something_else_is_refused(tmp_path):
    def law(T):
        arms = 1 if T < 1.0 else 2
        return pd.Maxwell(E=100.0, nu=0.3, shear=[10.0] * arms, times=[1.0] * arms, duration=1.0)

    with pytest.raises(pd.CaseError, match="of another kind at temperature 50"):
        pd.run(block(pd.Thermal(law(0.0), 0.0, law=law), pd.Temperature(pd.region.All(), 50.0, pd.Hold())), tmp_path)


@pytest.mark.parametrize("rise", [0.0, 50.0])
def test_a_control_that_follows_takes_no_heat_for_flow(rise, tmp_path):
    """Nothing flows: it is the elastic one, also where the moduli fall with the temperature."""
    held, far = pd.region.Slab("x", high=1.0), pd.region.Slab("x", low=5.0)

    def force(control):
        case = pd.Case(
            particles=BLOCK, horizon=2.015, scheme=pd.Correspondence(), control=control, fields=[], steps=pd.Steps(3),
            material=pd.Thermal(pd.J2(E=100.0, nu=0.3, yield_stress=1e5), 1e-3, factor=lambda T: np.full(len(T), 0.5)),
            conditions=[
                pd.Displacement(held, x=0.0, y=0.0), pd.Displacement(far, y=1.0),
                pd.Temperature(pd.region.All(), rise, pd.Hold()),
            ],
            history={"R": pd.Reaction("y", held)},
        )  # fmt: skip
        return pd.run(case, tmp_path).history["R"][-1]

    assert force(pd.TangentScaled(pd.Silling(0.5))) == pytest.approx(force(pd.Silling(0.5)), rel=1e-6)


@pytest.mark.parametrize("kinematics", ["small", "finite"])
def test_stress_at_points_breaks_bonds_that_are_held_against_cold(kinematics, tmp_path):
    """A free body gets cold without stress; in one held on all sides the stress is that of the closed form."""
    E, shrunk = 10.0, 0.01
    cold, strength = pd.Temperature(pd.region.All(), -10.0), 0.05
    law = pd.BondBased(E, plane="stress", kinematics=kinematics, calibration="lattice")
    for damage in (pd.Brittle(pd.PrincipalStress(strength)), pd.LinearSoftening(pd.PrincipalStress(strength), 5.0)):
        free = block(pd.Thermal(law, 1e-3), cold, damage=damage, fields=[], history={"broken": pd.BrokenBonds()})
        run = pd.run(free, output=tmp_path / "free")
        assert run.history["broken"][-1] == 0
        solution = run.solution
        assert np.abs(solution.problem.damage.driving_variable.at(solution.state)).max() < 1e-9
        assert np.abs(solution.u).max() > 0.03
    # Biaxial stress E alpha dT / (1 - nu), nu = 1/3 in plane stress, of elastic gradient 1 / 0.99 where that is finite.
    if kinematics == "small":
        sigma = E * shrunk / (1.0 - 1.0 / 3.0)
    else:
        stretch = 1.0 / (1.0 - shrunk)
        green = 0.5 * (stretch**2 - 1.0)
        S = E * green / (1.0 - 1.0 / 3.0)
        # Thickness of Saint Venant's law without stress across: the strain there is -nu / (1 - nu) (E_x + E_y).
        sigma = S / np.sqrt(1.0 - 2.0 * 0.5 * 2.0 * green)
    for share, whole in ((1.01, True), (0.99, False)):
        case = block(pd.Thermal(law, 1e-3), cold, damage=pd.Brittle(pd.PrincipalStress(sigma * share)), fields=[])
        held = pd.Displacement(pd.region.All(), x=0.0, y=0.0)
        case = dataclasses.replace(case, conditions=[held, cold], history={"broken": pd.BrokenBonds()})
        run = pd.run(case, output=tmp_path / "held")
        assert bool(run.history["broken"][-1] == 0) == whole
        if whole:
            drive = run.solution.problem.damage.driving_variable.at(run.solution.state)
            assert np.allclose(drive, 1.0 / share, rtol=1e-9)


@pytest.mark.parametrize("material", [pd.LinearElastic(10.0, 0.3, "stress"), pd.Hencky(10.0, 0.3, "stress")])
def test_a_gradient_tears_bonds_by_the_elongation_that_drives_them(material):
    """Beside a broken bond, in a uniform state: the stretch of a bond along the pull beyond that without force."""
    model = scenes.damaged_body(2, pd.Brittle(pd.ConstantCritical(0.05)), material=material, expands=True)
    first = np.flatnonzero(model.cloud.x[:, 0] < 0.5)
    u = np.zeros((model.cloud.n_owned, 2))
    u[first, 0] = -0.3
    assert model.break_bonds(u) > 0
    model = expanded(model, np.diag([0.2, 0.2, 0.0]))
    uniform = model.at(model.cloud.x[: model.cloud.n_owned] * [0.5, 0.2])
    family_strain = model.material_term.family_strain(uniform)
    e, _ = uniform.elongated(True)
    xi = model.families.bonds(model.cloud.x)
    along = (np.abs(xi[:, 1]) < 1e-9) & (family_strain > 0.0)
    assert along.any()
    assert np.allclose(family_strain[along], (e / np.linalg.norm(xi, axis=1))[along], rtol=1e-9)


def test_a_particle_without_a_gradient_is_asked_for_no_stress():
    """A soil that cannot be pulled has none at F = I once it is cold; it is not asked for it where it is lost."""
    soil = pd.DruckerPrager(E=100.0, nu=0.3, cohesion=0.01, friction=0.4, dilatancy=0.0)
    model = scenes.damaged_body(2, pd.Brittle(pd.ConstantCritical(0.5)), material=soil, expands=True)
    n = model.cloud.n_owned
    corner, ends = int(np.argmin(model.cloud.x[:n].sum(axis=1))), model.families
    model.problem.damage.bonds.phi[(ends.centres == corner) | (ends.neighbours == corner)] = 0.0
    model.take_failure()
    material_term = model.material_term
    assert material_term.lost.any()
    lost = np.unique(material_term.operator.owner[material_term.lost])
    strain = np.zeros((n, 3, 3))
    strain[lost] = -0.05 * np.eye(3)
    cold = expanded(model, strain)
    still = cold.at(np.zeros((n, 2)))
    assert not cold.material_term.laws(still).defined(cold.material_term.deformation(still))
    assert cold.material_term.admissible(still)


def test_a_rate_law_with_a_temperature_of_its_own_is_refused_in_a_body_that_has_one():
    """It would not follow that of the body; a law by temperature does."""

    def steel(T):
        rate = pd.rate.JohnsonCook(duration=1.0, C=0.01, rate_0=1.0, temperature=T, melting=1800.0)
        return pd.J2(E=200e3, nu=0.3, yield_stress=250.0, rate=rate)

    for material in (steel(293.0), pd.Graded(steel(293.0), lambda x: 1.0 + x[:, 0])):
        with pytest.raises(pd.CaseError, match="has a temperature of its own, 293"):
            pd.Thermal(material, 1.2e-5)
    pd.Thermal(steel(293.0), 1.2e-5, law=steel)
    pd.Thermal(dataclasses.replace(steel(293.0), rate=pd.rate.Perzyna(1.0, 1.0, 1.0)), 1.2e-5)
