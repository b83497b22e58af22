"""Damage of bonds with every scheme, every control and materials with history."""

import dataclasses
import itertools
import re

import numpy as np
import pytest

import pdpetsc as pd
from pdpetsc.command_line.cli import load_case
from tests.commands import ROOT, field, history, results
from tests.damage.test_fracture import broken
from tests.pairs import pairs
from tests.scenes import (
    ALL_CONTROLS,
    DIMS,
    LAWS,
    MATERIALS,
    NOT_AFFINE,
    SCHEMES,
    damaged_body,
    dense_tangent,
    differences,
    displacement,
)
from tests.toys import Wearing

CRITICAL = pd.ConstantCritical(0.02)
WITH_HISTORY = {name: m for name, m in MATERIALS.items() if m.has_history} | {"wearing": Wearing(E=10.0, nu=0.0)}
EVERY_SCHEME = SCHEMES | {"smoothed_displacement": pd.SmoothedDisplacement()}


def pulled(model, rng, strain, rough=0.001):
    x = model.cloud.x[: model.cloud.n_owned]
    return displacement(model, rng, rough) + strain * (x - x.mean(axis=0)) * np.linspace(1.0, 0.2, model.dim)


def exact(model, u, rng):
    """Compare some columns of the tangent with differences; return how many bonds are falling."""
    K = dense_tangent(model, u)
    columns = rng.choice(u.size, min(8, u.size), replace=False)
    assert np.abs(K[:, columns] - differences(model, u, columns)).max() < 1e-6 * np.abs(K).max()
    du = rng.standard_normal(u.shape)
    assert np.allclose(K @ du.ravel(), model.tangent_times(u, du).ravel(), atol=1e-10 * np.abs(K).max())
    return np.count_nonzero(model.failure.following(model.driving_values(u))[2])


def test_gradient_and_control_follow_bonds_that_are_restored(rng):
    """A load step restores bonds without the fields that were solved for; nothing may keep a broken bond."""
    made = pd.LinearElastic(10.0, 0.3)
    model = damaged_body(2, LAWS["linear"](CRITICAL), pd.Correspondence(), pd.Silling(0.5), made, rng, 2.015)
    u = pulled(model, rng, 0.018)
    model.commit(u)
    forces, entries, version = model.internal_force(u), len(model.operator.members), model.problem.version
    assert model.break_bonds(1.7 * pulled(model, rng, 0.03), 8)
    assert len(model.operator.members) < entries or np.abs(model.internal_force(u) - forces).max() > 1e-3
    model.problem.revert_bonds()
    assert model.failure.intact.all() and len(model.operator.members) == entries
    assert np.abs(model.internal_force(u) - forces).max() < 1e-12 * np.abs(forces).max()
    assert model.problem.version > version


def test_only_the_problem_changes_the_bonds_of_its_damage():
    """Terms would not follow bonds that another caller breaks or restores."""
    changes = re.compile(r"damage(_of\(\w+\))?\.(revert|soften|break_bonds|break_families|reset|commit)\(")
    package = ROOT / "pdpetsc"
    callers = {
        str(path.relative_to(package))
        for path in package.rglob("*.py")
        if "__pycache__" not in path.parts and changes.search(path.read_text())
    }
    assert callers == {"problem/problem.py"}


@pytest.mark.parametrize(("dim", "scheme", "material"), pairs(DIMS, EVERY_SCHEME, WITH_HISTORY))
def test_the_tangent_with_history_is_exact_before_and_after_bonds_break(dim, scheme, material, rng):
    horizon = 3.3 if scheme == "smoothed_displacement" else 2.015
    made = WITH_HISTORY[material]
    if hasattr(made, "yield_stress"):
        made = dataclasses.replace(made, yield_stress=0.05)
    model = damaged_body(dim, LAWS["linear"](CRITICAL), EVERY_SCHEME[scheme], pd.Silling(0.5), made, rng, horizon)
    u = pulled(model, rng, 0.018)
    virgin = model.materials[0].history.copy()
    model.commit(u)
    forces = model.internal_force(u)
    assert np.abs(model.materials[0].history - virgin).max() > 1e-4
    u2 = pulled(model, rng, 0.03)
    assert exact(model, u2, rng) > 2
    # Bonds break and mend: the history comes back with the points that it is of.
    before = model.material_term.plastic_strain()
    most = {1: 1, 2: 8, 3: 30}[dim]
    assert model.break_bonds(1.7 * u2, most)
    exact(model, u2, rng)
    model.revert()
    assert np.allclose(model.internal_force(u), forces, atol=1e-13 * np.abs(forces).max())
    assert np.array_equal(model.material_term.plastic_strain(), before)
    # What is committed with broken bonds is what the next state starts from.
    model.break_bonds(1.7 * u2, most)
    model.commit(u2)
    model.break_bonds(1.9 * u2, most)
    exact(model, 1.05 * u2, rng)


@pytest.mark.parametrize("scheme", ["sub_horizons", "stress_points", "four_sub_horizons"])
def test_a_sector_without_bonds_goes_on_with_the_history_of_what_took_them_over(scheme):
    """All particles flow alike; whichever bonds break, every point has that flow until a new state is committed."""
    material = dataclasses.replace(WITH_HISTORY["j2"], yield_stress=0.05)
    model = damaged_body(2, pd.Brittle(CRITICAL), SCHEMES[scheme], material=material)
    u = np.zeros_like(model.cloud.x)
    u[:, 0] = 0.015 * model.cloud.x[:, 0]
    model.commit(u)
    alpha = model.material_term.plastic_strain()
    assert alpha.min() > 1e-3
    n = model.operator.n_points
    # The bonds to the right of the particles in the third column.
    x, centres, neighbours = model.cloud.x, model.families.centres, model.families.neighbours
    cut = (np.minimum(x[centres, 0], x[neighbours, 0]) < 2.5) & (np.maximum(x[centres, 0], x[neighbours, 0]) > 2.5)
    model.failure.phi[cut] = 0.0
    model.take_failure()
    assert model.operator.n_points < n
    assert np.allclose(model.material_term.plastic_strain(), alpha, rtol=1e-12)
    model.commit(2.0 * u)
    more = model.material_term.plastic_strain()
    assert np.all(more > alpha)
    model.failure.phi[cut] = 1.0
    model.take_failure()
    assert model.operator.n_points == n
    assert model.material_term.plastic_strain() == pytest.approx(more, rel=1e-9)


@pytest.mark.parametrize("control", ALL_CONTROLS)
@pytest.mark.parametrize("dim", DIMS)
def test_every_control_fades_with_its_bonds(dim, control, rng):
    """Its tangent stays exact, what is cut off has no force, and affine displacements have none where they had none."""
    declared = ALL_CONTROLS[control]
    model = damaged_body(dim, LAWS["linear"](CRITICAL), control=declared, rng=rng)
    u = pulled(model, rng, 0.025)
    assert exact(model, u, rng) > 2
    model.soften(u)
    exact(model, pulled(model, rng, 0.028), rng)
    if declared is None:
        return
    if control not in NOT_AFFINE:
        f = np.zeros_like(u)
        A = 0.1 * rng.standard_normal((dim, dim))
        model.control.force(model.cloud.x @ A, f, model.families.everyone)
        assert np.abs(f).max() < 1e-12
    x, (i, j) = model.cloud.x[:, 0], (model.families.centres, model.families.neighbours)
    middle = 0.5 * (x.min() + x.max())
    model.failure.phi[(x[i] < middle) != (x[j] < middle)] = 0.0
    model.take_failure()
    f, apart = np.zeros_like(u), np.zeros_like(u)
    apart[x > middle] = 1.0
    energy = model.control.force(apart, f, model.families.everyone)
    assert abs(energy) < 1e-12
    assert np.abs(f).max() < 1e-12


DUCTILE = """
import sys

sys.path.insert(0, {root!r})
from tests.damage.test_criterion import pd, strip


def case(scheme="sub_horizons", law="linear", steps=8, stop=2.0):
    from tests.commands import Stop

    critical = pd.ConstantCritical(0.03)
    left, right = pd.region.Slab("x", high=2.0), pd.region.Slab("x", low=10.0)
    return strip(
        particles=pd.Lattice((0.0, 0.0), (12.0, 3.0), 1.0),
        cracks=[pd.Segment((7.0, -1.0), (7.0, 1.0))],
        scheme=pd.SCHEMES[scheme],
        control=None if scheme == "sub_horizons" else pd.Silling(0.5),
        material=pd.J2(E=100.0, nu=0.3, yield_stress=0.8, hardening=2.0),
        damage=pd.Brittle(critical) if law == "brittle" else pd.LinearSoftening(critical, 2.0),
        steps=pd.Steps(steps),
        history=dict(
            force=pd.Reaction("x", right), broken=pd.BrokenBonds(), flow=pd.Largest(pd.plastic_strain),
            work=pd.ExternalWork(), stored=pd.StrainEnergy(), dissipated=pd.DissipatedEnergy(), stop=Stop(stop),
        ),
        fields=[pd.displacement, pd.plastic_strain, pd.local_damage],
        checkpoints=1,
    )
"""


@pytest.mark.long
@pytest.mark.parametrize(
    ("scheme", "law", "steps"),
    [("sub_horizons", "linear", 8), pytest.param("correspondence", "brittle", 16, marks=pytest.mark.long)],
)
def test_a_body_that_flows_breaks_alike_on_any_ranks_and_after_a_restart(scheme, law, steps, tmp_path):
    path = tmp_path / "ductile.py"
    path.write_text(DUCTILE.format(root=str(ROOT)))
    words = (f"scheme={scheme}", f"law={law}", f"steps={steps}")
    whole = results(path, *words, output=tmp_path / "1")["results"]
    assert whole["broken"] > 5
    assert abs(whole["force"]) < 0.5 * whole["peak"]
    h = history(tmp_path / "1")
    assert h["flow"].max() > 0.01
    results(path, *words, output=tmp_path / "2", ranks=2)
    pairs = {run: [(row[0], row[2], row[3]) for row in broken(tmp_path / run)] for run in ("1", "2")}
    assert pairs["1"] == pairs["2"]
    # Stopped in the middle of damage, continued on the other number of ranks.
    first = h["t"][np.flatnonzero(h["broken"] > 0)[0]]
    case = load_case(path)(scheme=scheme, law=law, steps=steps, stop=float(first) - 1e-9)
    with pytest.raises(pd.Interrupted):
        pd.run(case, output=tmp_path / "part")
    restart = ("--restart", tmp_path / "part" / "checkpoint.h5")
    results(path, *words, *restart, output=tmp_path / "rest", ranks=2)
    assert [row[2:4] for row in broken(tmp_path / "rest")] == [row[2:4] for row in broken(tmp_path / "1")]
    for name in ("displacement", "plastic_strain", "local_damage"):
        one, other = field(tmp_path / "1", name), field(tmp_path / "rest", name)
        assert np.abs(one - other).max() <= 1e-8 * np.abs(one).max()


@pytest.mark.long
@pytest.mark.parametrize("scheme", EVERY_SCHEME)
def test_every_scheme_with_every_control_and_material(scheme, rng):
    """Nothing is refused, and every tangent is exact with softening and broken bonds at a state that is kept."""
    horizon = 3.3 if scheme == "smoothed_displacement" else 2.015
    for control, material in itertools.product(ALL_CONTROLS.values(), [*MATERIALS.values(), Wearing(E=10.0, nu=0.0)]):
        model = damaged_body(2, LAWS["linear"](CRITICAL), EVERY_SCHEME[scheme], control, material, rng, horizon)
        u = pulled(model, rng, 0.022)
        model.commit(u)
        model.break_bonds(2.2 * u, 8)
        u = pulled(model, rng, 0.028)
        K = dense_tangent(model, u)
        columns = rng.choice(u.size, 2, replace=False)
        assert np.abs(K[:, columns] - differences(model, u, columns)).max() < 1e-6 * np.abs(K).max()
        model.commit(u)
        assert np.isfinite(model.internal_force(u)).all()


@pytest.mark.long
def test_a_particle_without_gradient_flows_no_more(tmp_path):
    """What it keeps is not what F = I would make of it: such a particle cuts no step."""

    def critical(lengths, middles):
        return np.where(np.hypot(middles[:, 0] - 3.5, middles[:, 1] - 2.5) < 1.2, 0.08, 10.0)

    case = pd.Case(
        particles=pd.Lattice((0.0, 0.0), (6.0, 5.0), 1.0),
        horizon=2.015,
        material=pd.J2(E=100.0, nu=0.3, yield_stress=0.5, hardening=5.0, plane="stress"),
        conditions=[
            pd.Displacement(pd.region.Slab("x", high=1.0), x=0.0, y=0.0),
            pd.Displacement(pd.region.Slab("x", low=5.0), x=0.6),
        ],
        damage=pd.Brittle(pd.CriticalFunction(critical)),
        control=pd.Silling(0.5),
        steps=pd.Steps(8, plastic_growth=0.02),
        history={"broken": pd.BrokenBonds()},
    )
    run = pd.run(case, tmp_path)
    assert run.history["t"][-1] == 1.0 and run.history["broken"][-1] > 10


SOIL = pd.DruckerPrager(E=100.0, nu=0.3, cohesion=0.3, friction=0.4, plane="strain")
STEEL = pd.J2(E=100.0, nu=0.3, yield_stress=0.5, hardening=5.0, plane="strain")


def heated(material, rise, critical, strain=0.02, **changes):
    """A plate in plane strain that is pulled along x, and gets warm."""
    case = pd.Case(
        particles=pd.Lattice((0.0, 0.0), (6.0, 5.0), 1.0),
        horizon=2.015,
        material=pd.Thermal(material, 1e-3),
        conditions=[
            pd.Displacement(pd.region.Slab("x", high=1.0), x=0.0, y=0.0),
            pd.Displacement(pd.region.Slab("x", low=5.0), x=5.0 * strain),
            pd.Temperature(pd.region.All(), rise),
        ],
        damage=pd.Brittle(pd.ConstantCritical(critical)),
        control=pd.Silling(0.5),
        steps=pd.Steps(4),
        history={"broken": pd.BrokenBonds(), "plastic": pd.Largest(pd.plastic_strain)},
        fields=[pd.displacement, pd.stress, pd.plastic_strain],
    )
    return dataclasses.replace(case, **changes)


@pytest.mark.parametrize("material", [STEEL, SOIL], ids=["j2", "drucker_prager"])
def test_history_in_plane_strain_with_damage_and_heat(material, tmp_path):
    """Bonds that do not fail change nothing, and heat of 0 nothing where they fail."""
    made = pd.run(heated(material, 5.0, 9.0), tmp_path)
    alike = pd.run(heated(material, 5.0, 9.0, damage=None), tmp_path)
    assert made.history["plastic"][-1] > 1e-3
    assert np.allclose(made.gathered(pd.stress), alike.gathered(pd.stress), rtol=1e-7, atol=1e-8)
    assert np.allclose(made.gathered(pd.plastic_strain), alike.gathered(pd.plastic_strain), rtol=1e-7, atol=1e-10)
    critical = 0.022
    warm = pd.run(heated(material, 0.0, critical), tmp_path)
    cold = heated(material, 0.0, critical)
    cold = pd.run(dataclasses.replace(cold, material=material, conditions=cold.conditions[:2]), tmp_path)
    assert np.array_equal(warm.history["broken"], cold.history["broken"]) and cold.history["broken"][-1] > 2
    assert np.allclose(warm.gathered(pd.displacement), cold.gathered(pd.displacement), rtol=1e-6, atol=1e-8)
