"""A zero-energy control that follows a material that yields."""

import dataclasses

import numpy as np
import pytest

import pdpetsc as pd
from pdpetsc.control.tangent_scaled import Yielding, tangent_share
from pdpetsc.running.build import control_of, repeated_share
from pdpetsc.terms.control import ControlForces
from pdpetsc.terms.tangent_scaled import TangentScaledForces
from tests.commands import Stop, results
from tests.scenes import (
    ALL_CONTROLS,
    DIMS,
    SCHEMES,
    body,
    damaged_body,
    dense_tangent,
    differences,
    displacement,
    rotation,
)

STEEL = pd.J2(E=100.0, nu=0.3, yield_stress=1.0, hardening=5.0)
FOLLOWED = {name: control for name, control in ALL_CONTROLS.items() if control is not None}


def term_of(model):
    return next(term for term in model.problem.terms if isinstance(term, TangentScaledForces))


def flowing(dim, control, rng, steps=2, scheme=SCHEMES["correspondence"]):
    """Return a body that has flowed in a few steps, and the last displacement."""
    model = body(dim, scheme, pd.TangentScaled(control), STEEL, rng=rng)
    # The shape stays and grows, so that every family goes on yielding.
    shape = displacement(model, rng)
    for step in range(1, steps + 1):
        u = shape * step / (steps + 1.0)
        model.commit(u)
    assert model.material_term.plastic_strain().max() > 0.002
    return model, shape


@pytest.mark.parametrize("name", FOLLOWED)
@pytest.mark.parametrize("dim", DIMS)
def test_forces_and_tangent_derive_from_the_energy(dim, name, rng):
    model, shape = flowing(dim, FOLLOWED[name], rng)
    term = term_of(model)
    grown = term.families(model.at(shape)).e > term._yielding.kept[:, 1]
    assert np.count_nonzero(grown) > 0
    assert term._yielding.kept[grown, 2].min() < 0.5
    for u in (shape, 0.8 * shape + 0.1 * displacement(model, rng)):
        K = dense_tangent(model, u)
        assert np.abs(K - K.T).max() < 1e-12 * np.abs(K).max()
        du = rng.standard_normal(u.shape)
        assert np.allclose(model.tangent_times(u, du).ravel(), K @ du.ravel(), atol=1e-11 * np.abs(K).max())
        columns = range(0, u.size, 7)
        difference = differences(model, u, columns)
        assert np.abs(K[:, list(columns)] - difference).max() < 1e-6 * np.abs(K).max()
        step = 1e-6 * du
        work = (sum(model.energy(u + step)) - sum(model.energy(u - step))) / 2.0
        assert work == pytest.approx(np.vdot(model.internal_force(u), step), rel=1e-6)
        blocks = model.linearised(u).point_blocks()
        of_matrix = K.reshape(-1, dim, len(u), dim)[np.arange(len(u)), :, np.arange(len(u))]
        assert np.allclose(blocks, of_matrix, atol=1e-12 * np.abs(K).max())


@pytest.mark.parametrize("name", FOLLOWED)
@pytest.mark.parametrize("dim", DIMS)
def test_forces_of_families_are_those_of_the_control(dim, name, rng):
    model = body(dim, control=FOLLOWED[name], rng=rng)
    u, n = displacement(model, rng), model.cloud.n_owned
    control, share = model.control, rng.uniform(0.1, 1.0, n)
    each, (ptr, members) = control.family_forces(u), control.stencils
    for i in range(0, n, 5):
        f = np.zeros_like(u)
        energy = control.force(u, f, np.array([i], dtype=np.int32))
        here = slice(ptr[i], ptr[i + 1])
        found = np.zeros_like(u)
        np.add.at(found, members[here], each[here])
        assert np.allclose(found, f, atol=1e-13 * np.abs(each).max())
        assert np.vdot(found, u) == pytest.approx(2.0 * energy, rel=1e-9, abs=1e-14)
    f, expected = np.zeros_like(u), np.zeros_like(u)
    control.scaled(share).force(u, f, model.families.everyone)
    np.add.at(expected, members, np.repeat(share, np.diff(ptr))[:, None] * each)
    assert np.allclose(f, expected, atol=1e-12 * np.abs(f).max())


def test_families_lose_what_the_law_says_and_never_give_it_back(rng):
    """Any path of sizes and slopes: force and energy continuous, what is lost only grows, the energy is the work."""
    yielding, e = Yielding.unloaded(1), np.zeros(1)
    work, lost = 0.0, 0.0
    for _ in range(60):
        target = np.abs(rng.uniform(0.0, 2.0, 1))
        path = np.linspace(e, target, 1001)
        q = np.array([yielding.secant(one) * one for one in path])
        work += float(np.sum(0.5 * (q[1:] + q[:-1]) * np.diff(path, axis=0)))
        slope = np.gradient(q[:, 0], path[:, 0])[500]
        bend = yielding.bend(path[500]) * path[500] ** 2 + yielding.secant(path[500])
        if (path[499] > yielding.kept[0, 1]) == (path[501] > yielding.kept[0, 1]):
            assert bend[0] == pytest.approx(slope, rel=1e-6)
        before = yielding.secant(target) * target, yielding.energy(target)
        yielding.commit(target, rng.uniform(0.01, 1.0, 1))
        assert yielding.secant(target) * target == pytest.approx(before[0], rel=1e-12)
        assert yielding.energy(target) == pytest.approx(before[1], rel=1e-12)
        assert yielding.energy(target)[0] == pytest.approx(work, rel=1e-3, abs=1e-9)
        assert yielding.kept[0, 3] >= lost
        assert yielding.kept[0, 2] <= yielding.kept[0, 0]
        lost, e = yielding.kept[0, 3], target
    assert lost > 0.05


@pytest.mark.parametrize("dim", DIMS)
def test_the_share_is_that_of_the_hardening_in_every_frame(dim, rng):
    """H / (3 mu + H) of a solid that flows, E_t / E of a bar, 1 of a point that does not; turned or not."""
    kernels, constants = STEEL.history_kernels(dim), STEEL.constants(dim)

    def share(F, history):
        P, A = np.empty((1, dim, dim)), np.empty((1, *(dim,) * 4))
        one = np.zeros(1, dtype=np.int64)
        kernels.stress(F[None].copy(), one, constants, history, P)
        kernels.tangent(F[None].copy(), one, constants, history, A)
        return tangent_share(F[None], P, A, STEEL.moduli(dim))[0]

    history = STEEL.initial_history(dim, 1)
    little = np.eye(dim) + 1e-3 * rng.uniform(-1.0, 1.0, (dim, dim))
    Q = rotation(dim, rng)
    assert share(little, history) == 1.0
    assert share(Q @ little, history) == 1.0
    large = np.diag([1.4, 0.8, 0.9][:dim]) + 0.02 * rng.uniform(-1.0, 1.0, (dim, dim))
    expected = {1: 5.0 / 105.0, 3: 5.0 / (1.5 * 100.0 / 1.3 + 5.0)}
    for F in (large, Q @ large):
        found = share(F, history)
        assert found < 0.2 if dim == 2 else found == pytest.approx(expected[dim], rel=0.02)
        assert found == pytest.approx(share(large, history), rel=1e-10)


@pytest.mark.parametrize("dim", [2, 3])
def test_forces_turn_with_the_body_and_balance(dim, rng):
    model, u = flowing(dim, pd.Silling(0.5), rng)
    f, x, Q = model.internal_force(u), model.cloud.x, rotation(dim, rng)
    assert np.abs(f.sum(axis=0)).max() < 1e-12 * np.abs(f).max()
    y = x + u
    moment = np.einsum("ki,kj->ij", y, f)
    assert np.abs(moment - moment.T).max() < 1e-11 * np.abs(y).max() * np.abs(f).max()
    turned = y @ Q.T - x
    assert np.allclose(model.internal_force(turned), f @ Q.T, atol=1e-10 * np.abs(f).max())
    assert model.energy(turned) == pytest.approx(model.energy(u), rel=1e-10)
    term = term_of(model)
    before = term.families(model.at(u)).e
    assert np.allclose(term.families(model.at(turned)).e, before, rtol=1e-8, atol=1e-12)


def test_a_state_that_has_been_taken_is_the_same_state(rng):
    model, u = flowing(2, pd.Silling(0.5), rng)
    for _ in range(3):
        force, energy = model.internal_force(u), model.energy(u)
        model.commit(u)
        assert np.allclose(model.internal_force(u), force, atol=1e-12 * np.abs(force).max())
        assert model.energy(u) == pytest.approx(energy, rel=1e-12)
        u = u + 0.1 * displacement(model, rng)


def test_a_body_that_does_not_yield_has_the_elastic_control(rng):
    strong = dataclasses.replace(STEEL, yield_stress=1e9)
    one, other = (
        body(2, control=c, material=strong, rng=np.random.default_rng(3))
        for c in (pd.Silling(), pd.TangentScaled(pd.Silling()))
    )
    u = displacement(one, rng)
    for step in (0.3, 0.7, 0.2, 1.0):
        assert np.allclose(other.internal_force(step * u), one.internal_force(step * u), rtol=1e-12, atol=1e-15)
        one.commit(step * u)
        other.commit(step * u)
    kept = term_of(other)._yielding.kept
    assert np.all(kept[:, [0, 2]] == 1.0)
    assert np.abs(kept[:, 3]).max() < 1e-14


@pytest.mark.parametrize("effect", [None, pd.PresentStretch()], ids=["last", "present"])
@pytest.mark.parametrize("dim", [2, 3])
def test_the_integrity_of_bonds_counts_besides(dim, effect, rng):
    """With bonds that soften: forces are those of the damaged control times the secant, and the tangent is exact."""
    law = pd.LinearSoftening(pd.ConstantCritical(0.02), **({} if effect is None else {"effect": effect}))
    followed, elastic = (
        damaged_body(dim, law, control=control, rng=np.random.default_rng(11))
        for control in (pd.TangentScaled(pd.Silling()), pd.Silling())
    )
    u = displacement(followed, rng, 0.001) + 0.025 * (followed.cloud.x - followed.cloud.x.mean(axis=0))
    for model in (followed, elastic):
        model.soften(0.9 * u)
    term = term_of(followed)
    e = term.families(followed.at(u)).e
    half = rng.uniform(size=len(e)) < 0.5
    # Some families beyond what they have had, some not.
    term._yielding.kept[:, 0], term._yielding.kept[:, 1] = 0.4, np.where(half, 0.6, 1.5) * e
    term._yielding.kept[:, 2] = 0.1
    term.restored()
    secant = np.where(half, 0.1 + 0.3 * 0.6, 0.4)
    assert np.allclose(term._yielding.secant(e), secant, rtol=1e-12)
    control = next(one for one in elastic.problem.terms if isinstance(one, ControlForces)).at(elastic.at(u))
    f, expected = np.zeros_like(u), np.zeros_like(u)
    term.add_force(followed.at(u), f)
    control.scaled(secant).force(u, expected, followed.families.everyone)
    assert np.allclose(f, expected, atol=1e-11 * np.abs(f).max())
    assert np.count_nonzero(followed.problem.damage.phi(followed.at(u)) < 1.0) > 4
    K = dense_tangent(followed, u)
    columns = list(range(0, u.size, 7))
    assert np.abs(K[:, columns] - differences(followed, u, columns)).max() < 2e-6 * np.abs(K).max()
    du = rng.standard_normal(u.shape)
    assert np.allclose(K @ du.ravel(), followed.tangent_times(u, du).ravel(), atol=1e-10 * np.abs(K).max())


def strip(control=None, n=12, unit=1.0, force=1.0, steps=6):
    """Return a notched strip, pulled until it flows all over and let go a little; lengths and forces in units."""
    length, stress = n * unit, force / unit**2
    left, right = pd.region.Slab("x", high=1.01 * unit), pd.region.Slab("x", low=length - 1.01 * unit)
    notch = pd.region.Box((5.2 * unit, 3.9 * unit), (6.8 * unit, 7.0 * unit))
    history = {
        "force": pd.Reaction("x", right), "work": pd.ExternalWork(), "strain": pd.StrainEnergy(),
        "control": pd.ControlEnergy(), "plastic": pd.Mean(pd.plastic_strain),
    }  # fmt: skip
    return pd.Case(
        particles=pd.Lattice((0.0, 0.0), (length, 0.5 * length), unit, cut=notch),
        horizon=2.015 * unit,
        material=pd.J2(E=100.0 * stress, nu=0.3, yield_stress=stress, hardening=2.0 * stress),
        scheme=pd.Correspondence(),
        control=pd.TangentScaled(pd.Silling()) if control is None else control,
        conditions=[
            pd.Displacement(left, x=0.0, y=0.0),
            pd.Displacement(right, x=lambda x, t: 0.6 * unit * (t if t <= 0.8 else 1.6 - t), y=0.0),
        ],
        steps=pd.Steps(steps),
        history=history,
        results=lambda h: {name: h[name][-1] for name in history},
    )


def test_the_work_is_what_is_stored_and_lost(tmp_path):
    errors = []
    for steps in (12, 24):
        h = pd.run(strip(steps=steps), tmp_path / f"{steps}").history
        held = h["strain"] + h["control"]
        errors.append(np.abs(h["work"] - held).max() / np.abs(h["work"]).max())
        assert h["control"].min() >= 0.0
        assert h["plastic"][-1] > 0.01
    assert errors[1] < 0.6 * errors[0]
    assert errors[1] < 0.02


def test_it_is_the_same_in_all_units_and_gives_way(tmp_path):
    units = {1.0: 1.0, 1e-3: 1e7}
    found = {
        unit: pd.run(strip(unit=unit, force=force), tmp_path / f"{unit}").summary["results"]
        for unit, force in units.items()
    }
    small = found[1e-3]
    assert small["force"] / 1e10 == pytest.approx(found[1.0]["force"], rel=1e-8)
    assert small["control"] / 1e7 == pytest.approx(found[1.0]["control"], rel=1e-8)
    assert small["plastic"] == pytest.approx(found[1.0]["plastic"], rel=1e-8)
    elastic = pd.run(strip(pd.Silling()), tmp_path / "elastic").history["force"].max()
    assert 0.5 * elastic < pd.run(strip(), tmp_path / "following").history["force"].max() < 0.95 * elastic


def test_a_run_goes_on_where_it_stopped(tmp_path):
    case = strip()
    whole = pd.run(case, tmp_path / "whole")
    with pytest.raises(pd.Interrupted):
        pd.run(dataclasses.replace(case, history={**case.history, "until": Stop(0.6)}), tmp_path / "part")
    rest = pd.run(case, tmp_path / "rest", restart=tmp_path / "part", restart_anyway=True)
    for name, value in whole.summary["results"].items():
        assert rest.summary["results"][name] == pytest.approx(value, rel=1e-9)


def test_without_a_matrix_it_is_the_same(tmp_path):
    kinds = ("assembled", "matfree")
    found = [pd.run(strip(), tmp_path / kind, options={"pd_jacobian": kind}).summary["results"] for kind in kinds]
    for name, value in found[0].items():
        assert found[1][name] == pytest.approx(value, rel=1e-9)


def test_elastic_bodies_have_the_control_that_is_followed():
    for material in (
        pd.Hencky(E=1.0, nu=0.0),
        pd.Graded(pd.LinearElastic(E=1.0, nu=0.0), factor=lambda x: 1.0 + x[:, 0]),
    ):
        case = dataclasses.replace(strip(), material=material)
        assert control_of(case) == pd.Silling()
        assert repeated_share(case) is not None
    assert repeated_share(strip()) is None
    yielding = pd.prepare(strip()).problem.terms
    assert any(isinstance(term, TangentScaledForces) for term in yielding)
    elastic = pd.prepare(dataclasses.replace(strip(), material=pd.Hencky(E=1.0, nu=0.0))).problem.terms
    assert [type(term) for term in elastic if isinstance(term, ControlForces)] == [ControlForces]


@pytest.mark.parametrize("least", [0.0, -1.0, 1.1])
def test_a_share_out_of_range_is_refused(least):
    with pytest.raises(pd.CaseError, match="0 < least <= 1"):
        pd.TangentScaled(pd.Silling(), least)


def test_a_control_that_follows_is_not_followed_again():
    with pytest.raises(pd.CaseError, match="follows the material already"):
        pd.TangentScaled(pd.TangentScaled(pd.Silling()))


def test_a_control_without_families_is_refused_in_one_sentence(rng):
    @dataclasses.dataclass(frozen=True)
    class Plain(pd.ZeroEnergyControl):
        def build(self, cloud, families, omega, stiffness):
            inner = pd.Silling().build(cloud, families, omega, stiffness)

            class Bare(pd.Control):
                stencils = property(lambda self: inner.stencils)
                force = staticmethod(inner.force)
                matrix = staticmethod(inner.matrix)

            return Bare()

    model = body(2, control=pd.TangentScaled(Plain()), material=STEEL)
    with pytest.raises(pd.CaseError, match="family_forces"):
        model.internal_force(displacement(model, rng))


NECK, COOK = "runs/solids/yielding_neck.py", "runs/solids/yielding_cook.py"


def test_two_ranks_find_what_one_does(tmp_path):
    words = "n=6", "steps=4"
    one = results(COOK, *words, output=tmp_path / "one")["results"]
    elastic = results(COOK, *words, "method=elastic", output=tmp_path / "elastic")["results"]
    two = results(COOK, *words, ranks=2, output=tmp_path / "two")["results"]
    assert one["tip"] > 1.1 * elastic["tip"]
    assert two["tip"] == pytest.approx(one["tip"], rel=1e-8)


@pytest.mark.long
def test_a_bar_necks_as_finite_elements_say(tmp_path):
    """Elastic control holds it: the pull only grows; with one that yields the errors fall with the spacing."""
    found = {}
    for n, method in ((4, "elastic"), (4, "following"), (8, "following")):
        found[n, method] = results(NECK, f"n={n}", f"method={method}", output=tmp_path / f"{method}_{n}")["results"]
    assert found[4, "elastic"]["end"] == found[4, "elastic"]["peak"] > 1.1 * found[4, "following"]["peak"]
    for name, most in (("peak", 0.01), ("end", 0.04), ("thinning", 0.12)):
        assert abs(found[4, "following"][f"error_{name}"]) < most
        assert abs(found[8, "following"][f"error_{name}"]) < 0.6 * abs(found[4, "following"][f"error_{name}"])
