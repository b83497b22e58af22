"""Energy of bonds, strain, stress and flow as what drives damage: closed forms, tangents, fracture energies, ranks."""

import dataclasses
import itertools

import numpy as np
import pytest

import pdpetsc as pd
from pdpetsc.bond_based import Neighbourhood
from pdpetsc.command_line.cli import load_case
from pdpetsc.damage import DamageableBonds
from pdpetsc.discrete.cloud import distribute
from pdpetsc.discrete.communicator import world
from pdpetsc.discrete.families import find_families
from pdpetsc.problem.body import Body
from pdpetsc.problem.damage import make_damage
from pdpetsc.problem.problem import Problem
from pdpetsc.problem.state import State
from pdpetsc.problem.supports import Supports
from pdpetsc.solvers.table import refuse_unmet
from pdpetsc.terms.bond_forces import BondForces
from tests.commands import ROOT, Stop, field, history, jacobian_ratios, results
from tests.damage.test_criterion import K, bar, check_tangent, pulled
from tests.damage.test_fracture import broken, strip
from tests.scenes import DIMS, LAWS, MATERIALS, SCHEMES, bond_body, damaged_body, small_points
from tests.toys import Wearing

J2 = dataclasses.replace(MATERIALS["j2"], yield_stress=0.1)
# By name: a criterion whose damage begins at a strain of about 0.02 of the materials of the tests.
POINTS = {
    "mazars": pd.MazarsStrain(0.02),
    "von_mises": pd.VonMisesStrain(0.008, ratio=5.0, nu=0.3),
    "principal": pd.PrincipalStress(0.25),
    "plastic": pd.PlasticStrain(0.007),
    "johnson_cook": pd.JohnsonCookFailure(0.004, 0.008, -1.5),
}
FLOW = ("plastic", "johnson_cook")


def uneven(model, rng):
    """Return an uneven pull at which the median drive is 1.4."""
    x = model.cloud.x
    u = pulled(model, rng, 0.0) + 0.01 * (x - x.mean(axis=0)) * np.linspace(1.0, 0.3, model.dim)
    low, high = 0.0, 20.0
    for _ in range(30):
        middle = 0.5 * (low + high)
        far = not model.all_admissible(middle * u) or np.median(model.driving_values(middle * u)) > 1.4
        low, high = (low, middle) if far else (middle, high)
    return low * u


@pytest.mark.parametrize("name", POINTS)
@pytest.mark.parametrize(("dim", "material", "plane"), [
    (1, "hencky", "strain"), (2, "hencky", "strain"), (2, "neo_hookean", "stress"), (2, "linear_elastic", "stress"),
    (3, "hencky", "strain"),
])  # fmt: skip
def test_tangents_of_gradients_are_exact(dim, material, plane, name, rng):
    made = J2 if name in FLOW else dataclasses.replace(MATERIALS[material], plane=plane)
    if name == "principal" and dim == 1:
        made = dataclasses.replace(made, nu=0.3)
    for scheme in ("correspondence", "sub_horizons"):
        law = pd.LinearSoftening(POINTS[name], 3.0)
        model = damaged_body(dim, law, SCHEMES[scheme], pd.Silling(0.5), made, rng)
        u = uneven(model, rng)
        check_tangent(model, u, rng, least=2)
        model.commit(u)
        check_tangent(model, 1.1 * u, rng, least=0)
        model.break_bonds(2.5 * u, {1: 1, 2: 8, 3: 30}[dim])
        check_tangent(model, 1.2 * u, rng, least=0)


@pytest.mark.parametrize("kinematics", ["small", "finite"])
@pytest.mark.parametrize("name", ["mazars", "von_mises", "principal"])
@pytest.mark.parametrize("dim", DIMS)
def test_tangents_of_bonds_are_exact(dim, name, kinematics, rng):
    """The stiffness of a bond differs from end to end here: both directions have their own force."""
    material = pd.BondBased(E=10.0, calibration="family", kinematics=kinematics)
    model = bond_body(dim, material, rng=rng, damage=pd.LinearSoftening(POINTS[name], 3.0))
    u = uneven(model, rng)
    check_tangent(model, u, rng, least=2)
    gradient, found = model.problem.damage.most_driven(model.at(u), 0.3)
    near = model.driving_values(u) >= 0.7 * found
    du = rng.standard_normal(u.shape)
    rate = (model.driving_values(u + 1e-6 * du)[near].mean() - model.driving_values(u - 1e-6 * du)[near].mean()) / 2e-6
    assert (gradient * du).sum() == pytest.approx(rate, rel=1e-5)
    model.break_bonds(2.5 * u, {1: 1, 2: 8, 3: 30}[dim])
    check_tangent(model, 1.2 * u, rng, least=0)


def strained(model, F):
    return model.cloud.x @ (np.asarray(F) - np.eye(model.dim)).T


@pytest.mark.parametrize("of_bonds", [True, False])
def test_uniform_strain_drives_as_the_closed_forms_say(of_bonds):
    """Plane strain, small strain: everything is known by hand."""

    def drive(criterion, F):
        law = pd.LinearSoftening(criterion)
        if of_bonds:
            model = bond_body(2, pd.BondBased(E=10.0, calibration="lattice"), damage=law)
        else:
            model = damaged_body(2, law, material=pd.LinearElastic(10.0, 0.25))
        x = model.driving_values(strained(model, F))
        assert np.allclose(x, x[0], rtol=1e-9, atol=1e-14)
        return x[0]

    a, b = 0.01, -0.004
    F = np.diag([1.0 + a, 1.0 + b])
    lam = mu = 4.0
    assert drive(pd.MazarsStrain(0.02), F) == pytest.approx(0.5)
    assert drive(pd.MazarsStrain(0.02), np.diag([1.01, 1.02])) == pytest.approx(np.hypot(0.01, 0.02) / 0.02)
    assert drive(pd.MazarsStrain(0.02), np.diag([0.99, 0.98])) == 0.0
    assert drive(pd.PrincipalStress(0.1), F) == pytest.approx((lam * (a + b) + 2.0 * mu * a) / 0.1)
    assert drive(pd.PrincipalStress(0.1), np.diag([0.99, 0.98])) < 0.0
    k, nu = 4.0, 0.25
    I1, J2_ = a + b, (a**2 + b**2 + (a - b) ** 2) / 6.0
    root = np.sqrt(((k - 1.0) / (1.0 - 2.0 * nu) * I1) ** 2 + 12.0 * k * J2_ / (1.0 + nu) ** 2)
    exact = ((k - 1.0) / (1.0 - 2.0 * nu) * I1 + root) / (2.0 * k)
    assert drive(pd.VonMisesStrain(0.02, k, nu), F) == pytest.approx(exact / 0.02)


def test_the_modified_von_mises_strain_is_that_of_tension_and_a_share_of_it_in_compression():
    criterion = pd.VonMisesStrain(1.0, ratio=8.0, nu=0.2)
    for sign, value in ((1.0, 1.0), (-1.0, 1.0 / 8.0)):
        strain = sign * np.array([[1.0, -0.2, -0.2]])
        assert criterion.equivalent(strain)[0] == pytest.approx(value, rel=1e-12)


def test_a_rotation_drives_nothing(rng):
    turned = np.array([[np.cos(1.0), -np.sin(1.0)], [np.sin(1.0), np.cos(1.0)]])
    for name in ("mazars", "von_mises", "principal"):
        model = damaged_body(2, pd.Brittle(POINTS[name]))
        assert np.abs(model.driving_values(strained(model, turned))).max() < 1e-12
        F = np.array([[1.02, 0.01], [0.0, 0.99]])
        plain, rotated = model.driving_values(strained(model, F)), model.driving_values(strained(model, turned @ F))
        assert np.allclose(plain, rotated, rtol=1e-9)


def test_flow_drives_as_a_bar_flows():
    """alpha of a bar in logarithmic strain: (E log stretch - y) / (E + H), and all of it counts before it is kept."""
    bar = pd.J2(E=10.0, nu=0.3, yield_stress=0.1, hardening=1.0)
    model = damaged_body(1, pd.Brittle(pd.PlasticStrain(0.01)), material=bar)
    for stretch in (1.005, 1.02, 1.03):
        u = (stretch - 1.0) * model.cloud.x
        alpha = max(0.0, 10.0 * np.log(stretch) - 0.1) / 11.0
        assert np.allclose(model.driving_values(u), alpha / 0.01, rtol=1e-9, atol=1e-12)
    # Uniaxial stress has a triaxiality of 1/3; what is used up adds up, also when the bar is let go in between.
    model = damaged_body(1, pd.Brittle(pd.JohnsonCookFailure(0.01, 0.02, -1.5)), material=bar)
    failure = 0.01 + 0.02 * np.exp(-0.5)
    used = 0.0
    for stretch in (1.015, 1.02, 1.015, 1.03):
        u = (stretch - 1.0) * model.cloud.x
        used = max(used, (10.0 * np.log(stretch) - 0.1) / 11.0)
        assert np.allclose(model.driving_values(u), used / failure, rtol=1e-9)
        model.commit(u)
    arrays = model.problem.arrays()
    grown = next(array for name, array in arrays.items() if name.endswith("grown"))
    assert np.allclose(grown.values, used / failure)


def test_what_does_not_flow_is_refused():
    with pytest.raises(pd.CaseError, match="no material of this body flows"):
        damaged_body(2, pd.Brittle(pd.PlasticStrain(0.1)))
    with pytest.raises(pd.CaseError, match="no material of this body flows"):  # it has a history, and does not flow
        damaged_body(2, pd.Brittle(pd.PlasticStrain(0.1)), material=Wearing(E=10.0, nu=0.0))
    with pytest.raises(pd.CaseError, match="bonds do not flow"):
        bond_body(2, pd.BondBased(E=1.0), damage=pd.Brittle(pd.PlasticStrain(0.1)))
    for wrong in (
        lambda: pd.BondEnergy(), lambda: pd.BondEnergy(w=1.0, Gc=1.0), lambda: pd.BondEnergy(Gc=0.0),
        lambda: pd.MazarsStrain(0.0), lambda: pd.VonMisesStrain(0.1, ratio=0.5), lambda: pd.PrincipalStress(-1.0),
        lambda: pd.PlasticStrain(float("nan")), lambda: pd.JohnsonCookFailure(0.0, 0.0, 1.0),
    ):  # fmt: skip
        with pytest.raises(pd.CaseError):
            wrong()


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("criterion", [pd.FractureEnergy, lambda G: pd.BondEnergy(Gc=G)], ids=["stretch", "energy"])
@pytest.mark.parametrize("dim", [1, 2, pytest.param(3, marks=pytest.mark.long)])
def test_pulling_two_rigid_halves_apart_takes_the_fracture_energy(dim, criterion, law):
    """The work over the area that the halves leave each other at, by the forces alone."""
    Gc, dx, horizon = 0.7, 0.5, 3.015
    sides = {1: (12,), 2: (10, 8), 3: (8, 7, 7)}[dim]
    x = dx * (np.array(list(itertools.product(*map(range, sides)))) + 0.5)
    # Periodic across the pull: all families there are whole.
    cell = None if dim == 1 else pd.Cell((0.0,) * dim, dx * np.array(sides), axes="yz"[: dim - 1])
    cloud = distribute(world(), x, np.full(len(x), dx**dim), {}, horizon * dx, cell)
    families = find_families(cloud)
    length = np.linalg.norm(families.bonds(cloud.x), axis=1)
    bonds = Neighbourhood(cloud, families, np.ones(len(length)), pd.influence.Constant(), 1.0)
    around = Body(cloud, families)
    material_term = BondForces(around, bonds, [pd.BondBased(E=10.0)], np.zeros(cloud.n_owned, dtype=np.int32))
    damageable = DamageableBonds.of(cloud, families, bonds.omega, material_term.k, False)
    damage = make_damage(LAWS[law](criterion(Gc)), around, damageable)
    material_term.take_damage(damage)
    problem = Problem(around, material_term, [], Supports(around), damage)
    right = cloud.x[: cloud.n_owned, 0] > 0.5 * dx * sides[0]
    limit = damage.limit
    apart = np.linspace(0.0, 1.5 * horizon * damage.bonds.law.final * limit.max(), 801)
    pull = []
    for w in apart:
        u = np.zeros((cloud.n_rows, dim))
        u[: cloud.n_owned][right, 0] = w
        state = State(around, u)
        while problem.break_bonds(state, 10**6):
            state = State(around, u)
        f = np.zeros((cloud.n_local, dim))
        material_term.add_force(state, f)
        pull.append(around.gather(f)[: cloud.n_owned][right, 0].sum())
        problem.soften(state)
    assert pull[-1] == pytest.approx(0.0, abs=1e-9 * max(pull))
    work = 0.5 * ((np.array(pull)[1:] + np.array(pull)[:-1]) * np.diff(apart)).sum()
    area = dx ** (dim - 1) * np.prod(sides[1:])
    assert work / area == pytest.approx(Gc, rel=0.03)
    assert material_term.dissipated_energy() / area == pytest.approx(Gc, rel=0.03)


CASE = """
import sys

sys.path.insert(0, {root!r})
from tests.damage.test_criterion import pd, strip

CRITERIA = dict(
    mazars=pd.MazarsStrain(0.015), principal=pd.PrincipalStress(1.6), plastic=pd.PlasticStrain(0.015),
    johnson_cook=pd.JohnsonCookFailure(0.01, 0.02, -1.5), energy=pd.BondEnergy(Gc=0.05),
)


def case(criterion="mazars", of_bonds=False, steps=6, stop=2.0):
    from tests.commands import Stop

    flows = criterion in ("plastic", "johnson_cook")
    elastic = pd.BondBased(E=100.0, calibration="family") if of_bonds else pd.Hencky(E=100.0, nu=0.3)
    right = pd.region.Slab("x", low=10.0)
    return strip(
        particles=pd.Lattice((0.0, 0.0), (12.0, 4.0), 1.0),
        cracks=[pd.Segment((7.0, -1.0), (7.0, 1.0))],
        material=pd.J2(E=100.0, nu=0.3, yield_stress=0.8, hardening=2.0) if flows else elastic,
        scheme=None if of_bonds else pd.Correspondence(),
        control=None if of_bonds else pd.Silling(0.5),
        damage=pd.LinearSoftening(CRITERIA[criterion], 2.0),
        steps=pd.Steps(steps),
        history=dict(force=pd.Reaction("x", right), broken=pd.BrokenBonds(), stop=Stop(stop)),
        fields=[pd.displacement, pd.local_damage],
    )
"""


@pytest.mark.long
@pytest.mark.parametrize(
    ("criterion", "of_bonds"),
    [
        ("mazars", True),
        ("mazars", False),
        ("johnson_cook", False),
        ("principal", True),
        ("principal", False),
        ("plastic", False),
        ("energy", True),
    ],
)
def test_a_strip_breaks_alike_on_any_ranks_and_after_a_restart(criterion, of_bonds, tmp_path):
    path = tmp_path / "strip.py"
    path.write_text(CASE.format(root=str(ROOT)))
    words = (f"criterion={criterion}", f"of_bonds={of_bonds}")
    whole = results(path, *words, output=tmp_path / "1")["results"]
    assert whole["broken"] > 5
    assert abs(whole["force"]) < 0.7 * whole["peak"]
    results(path, *words, output=tmp_path / "2", ranks=2)
    pairs = {run: [(row[0], row[2], row[3]) for row in broken(tmp_path / run)] for run in ("1", "2")}
    assert pairs["1"] == pairs["2"]
    h = history(tmp_path / "1")
    first = float(h["t"][np.flatnonzero(h["broken"] > 0)[0]])
    with pytest.raises(pd.Interrupted):
        pd.run(load_case(path)(criterion=criterion, of_bonds=of_bonds, stop=first - 1e-9), output=tmp_path / "part")
    results(path, *words, "--restart", tmp_path / "part" / "checkpoint.h5", output=tmp_path / "rest", ranks=2)
    assert [row[2:4] for row in broken(tmp_path / "rest")] == [row[2:4] for row in broken(tmp_path / "1")]
    one, other = (field(tmp_path / run, "local_damage") for run in ("1", "rest"))
    assert np.abs(one - other).max() <= 1e-7 * np.abs(one).max()


@pytest.mark.parametrize("of_bonds", [True, pytest.param(False, marks=pytest.mark.long)])
def test_petsc_finds_the_jacobian_with_strain_of_both_ends_correct(of_bonds, tmp_path, capfd):
    changes = {"scheme": None, "control": None, "material": pd.BondBased(E=100.0)} if of_bonds else {}
    case = strip(damage=pd.LinearSoftening(pd.MazarsStrain(0.01), 8.0), **changes)
    ends = dataclasses.replace(case.conditions[1], x=0.133)
    case = dataclasses.replace(
        case, conditions=[case.conditions[0], ends], steps=pd.Steps(1), history={"lost": pd.Largest(pd.local_damage)},
        results=None,
    )  # fmt: skip
    pd.run(case, output=tmp_path, options={"snes_test_jacobian": None})
    assert history(tmp_path)["lost"][-1] > 0.01
    assert max(jacobian_ratios(capfd.readouterr().out)[:4]) < 1e-6


@pytest.mark.parametrize("name", [*POINTS, "energy"])
def test_scaled_units_break_the_same_bonds(name, rng):
    """Drives are pure numbers: the same in millimetres and newtons, and in units of 1e6 of either."""
    length, force = 1e3, 1e-6
    stress = force / length**2

    def build(scale, of):
        criterion = {
            "principal": pd.PrincipalStress(0.25 * of), "energy": pd.BondEnergy(Gc=0.05 * of * scale), **{
                key: one for key, one in POINTS.items() if key != "principal"
            },
        }[name]  # fmt: skip
        x = scale * np.array([(i, j) for i in range(6) for j in range(5)], dtype=float)
        cloud = distribute(world(), x, np.full(len(x), scale**2), {}, 2.015 * scale)
        families = find_families(cloud)
        made = J2 if name in FLOW else MATERIALS["hencky"]
        made = dataclasses.replace(
            made, E=10.0 * of, **({"yield_stress": 0.1 * of, "hardening": of} if name in FLOW else {})
        )
        ones, kind = np.ones(families.n_bonds), np.zeros(len(x), dtype=np.int32)
        law = pd.LinearSoftening(criterion)
        return small_points(cloud, families, ones, pd.Correspondence(), [made], kind, None, law)

    one, other = build(1.0, 1.0), build(length, stress)
    u = 0.02 * one.cloud.x * [1.0, 0.2] + 0.002 * rng.standard_normal(one.cloud.x.shape)
    assert np.allclose(one.driving_values(u), other.driving_values(length * u), rtol=1e-7, atol=1e-9)


FIBRES = {
    "orthotropic": pd.Orthotropic((300.0, 100.0, 100.0), (0.2, 0.2, 0.2), (40.0, 40.0, 40.0), 0.3),
    "holzapfel": pd.HolzapfelGasserOgden(40.0, 100.0, 1.0, 300.0, (1.0, 0.0), dispersion=0.1),
}


@pytest.mark.processors
@pytest.mark.parametrize("material", FIBRES)
def test_materials_with_directions_break_by_criteria_that_need_no_modulus(material, tmp_path):
    """Critical stretches, strain and stress are known without a modulus of bonds; fracture energies are not."""
    made = FIBRES[material]
    for criterion in (pd.ConstantCritical(0.02), pd.MazarsStrain(0.02), pd.PrincipalStress(6.0)):
        case = strip(
            particles=pd.Lattice((0.0, 0.0), (12.0, 4.0), 1.0), material=made, damage=pd.Brittle(criterion),
            steps=pd.Steps(4),
        )  # fmt: skip
        found = pd.run(case, output=tmp_path)
        assert found["broken"] > 4
        assert found["peak"] > 1.0  # the strip bears a load step before it breaks
        assert abs(found["force"]) < 0.5 * found["peak"]
    if material != "orthotropic":  # these fibres bear nothing at F = I
        return
    with pytest.raises(pd.CaseError, match="modulus"):
        pd.prepare(strip(material=made, damage=pd.Brittle(pd.FractureEnergy(0.1))))


@pytest.mark.parametrize("of_bonds", [True, pytest.param(False, marks=pytest.mark.long)])
def test_half_of_a_body_with_a_mirror_plane_breaks_as_the_whole(of_bonds, tmp_path, capfd):
    """Bonds across the plane have their other direction behind it; the tangent knows that."""

    def pulled_strip(low, **more):
        far = pd.region.Slab("x", low=10.0)
        bonds = {"scheme": None, "control": None, "material": pd.BondBased(E=100.0, calibration="family")}
        return strip(
            particles=pd.Lattice((0.0, low), (12.0, 2.0), 1.0), **(bonds if of_bonds else {}),
            damage=pd.LinearSoftening(pd.MazarsStrain(0.01), 4.0), steps=pd.Steps(2),
            conditions=[
                pd.Displacement(pd.region.Slab("x", high=2.0), x=0.0, y=0.0), pd.Displacement(far, x=0.18, y=0.0)
            ],
            history={"force": pd.Reaction("x", far), "lost": pd.Largest(pd.local_damage)}, results=None, **more,
        )  # fmt: skip

    crack = {"cracks": [pd.Segment((7.0, 1.0), (7.0, 3.0)), pd.Segment((7.0, -3.0), (7.0, -1.0))]}
    whole = pd.run(pulled_strip(-2.0, **crack), output=tmp_path / "whole")
    capfd.readouterr()
    half = pd.run(
        pulled_strip(0.0, **crack, symmetry=[pd.Symmetry("y")]), output=tmp_path / "half",
        options={"snes_test_jacobian": None},
    )  # fmt: skip
    assert half.history["lost"][-1] > 0.1
    assert np.allclose(half.history["lost"], whole.history["lost"], rtol=1e-7)
    force = np.array(half.history["force"])
    assert np.allclose(force, whole.history["force"], rtol=1e-7) or np.allclose(2.0 * force, whole.history["force"])
    assert max(jacobian_ratios(capfd.readouterr().out)[:4]) < 1e-6


def test_a_bond_and_its_other_direction_know_each_other(rng):
    """In a periodic cell with mirror planes beside it as well, and of vectors with the sign of the plane."""
    x = np.array([(i, j) for i in range(5) for j in range(4)], dtype=float) + 0.5
    for cell, planes in (
        (None, ()),
        (pd.Cell((0.0, 0.0), (5.0, 4.0)), ()),
        (None, (pd.Symmetry("x"), pd.Symmetry("y"))),
    ):
        cloud = distribute(world(), x, np.ones(len(x)), {}, 2.015, cell, planes)
        families = find_families(cloud)
        bonds = DamageableBonds.of(cloud, families, np.ones(families.n_bonds), np.ones(families.n_bonds), False)
        xi = families.bonds(cloud.x)
        # The other direction of a bond is its opposite, and an opposite's opposite is the bond itself.
        assert np.allclose(bonds.opposite.of_vectors(xi), -xi, atol=1e-14)
        numbers = rng.standard_normal(families.n_bonds)
        assert np.array_equal(bonds.opposite.of(bonds.opposite.of(numbers)), numbers)


@pytest.mark.parametrize("solver", [pd.Newton(), pd.EventDriven()], ids=["newton", "events"])
def test_a_bond_fails_with_the_energy_of_both_its_ends(solver, tmp_path):
    """A bond of stiffness K between volumes of 1 stores ``K e^2 / 2``; graded, its ends have different shares."""
    limit = 0.01
    case = bar(pd.Brittle(pd.BondEnergy(w=0.5 * K * limit**2)), solver=solver)
    pd.run(case, output=tmp_path)
    h = history(tmp_path)
    assert h["force"].max() == pytest.approx(K * limit, rel=1e-12 if isinstance(solver, pd.EventDriven) else 0.06)
    assert h["dissipated"][-1] == pytest.approx(0.5 * K * limit**2, rel=1e-12)


def test_compression_fails_bonds_where_it_is_asked_to(tmp_path):
    limit = 0.01
    for compression, lost in ((False, False), (True, True)):
        case = bar(pd.Brittle(pd.BondEnergy(w=0.5 * K * limit**2, compression=compression)))
        pressed = dataclasses.replace(case.conditions[1], x=-0.022)
        pd.run(dataclasses.replace(case, conditions=[case.conditions[0], pressed]), output=tmp_path)
        h = history(tmp_path)
        assert (abs(h["force"][-1]) < 1e-9) == lost
        assert np.abs(h["force"]).max() == pytest.approx(K * limit if lost else 0.022 * K / 1.1, rel=0.06)


@pytest.mark.parametrize("name", ["mazars", "principal"])
def test_tangents_of_the_present_stretch_are_exact_too(name, rng):
    """The control fades with its bonds at once: its forces differ from end to end as well."""
    law = pd.LinearSoftening(POINTS[name], 3.0, effect=pd.PresentStretch())
    model = damaged_body(2, law, control=pd.Silling(0.5), rng=rng)
    u = uneven(model, rng)
    check_tangent(model, u, rng, least=2)
    model.break_bonds(2.5 * u, 8)
    check_tangent(model, u, rng, least=2)


SLOW = pd.J2(E=100.0, nu=0.3, yield_stress=0.5, hardening=5.0, rate=pd.rate.Perzyna(duration=1.0, rate_0=1.0, drag=0.1))


@pytest.mark.parametrize("heated", [False, True])
def test_a_rate_law_flows_in_the_step_that_damage_reads(heated, tmp_path):
    """One step of uniform strain: what is used up follows from stress and flow at its end, with a stress across."""
    D = (0.05, 3.44, -2.12)
    held = pd.Displacement(pd.region.All(), x=lambda x, t: 0.05 * t * x[:, 0], y=0.0)
    case = pd.Case(
        particles=pd.Lattice((0.0, 0.0), (6.0, 5.0), 1.0),
        horizon=2.015,
        material=pd.Thermal(SLOW, 1e-3) if heated else SLOW,
        conditions=[held, pd.Temperature(pd.region.All(), 0.0)] if heated else [held],
        scheme=pd.Correspondence(),
        damage=pd.Brittle(pd.JohnsonCookFailure(*D)),
        fields=[],
    )
    solution = pd.run(case, tmp_path).solution
    P = pd.stress(solution)[0]
    flow = pd.plastic_strain(solution)[0]
    sigma = np.array([P[0, 0], P[1, 1], solution.problem.material_term.out_of_plane(solution.state)[2][0]])
    mean = sigma.mean()
    s = mean / np.sqrt(1.5 * ((sigma - mean) ** 2).sum())
    used = flow / (D[0] + D[1] * np.exp(D[2] * s))
    assert used == pytest.approx(0.540, abs=5e-4)
    assert np.allclose(solution.problem.damage.driving_variable.arrays()["grown"], used, rtol=1e-9)


FAST = {
    "D1": 0.02, "D2": 0.03, "D3": -1.5, "D4": 0.05, "D5": 0.6, "rate_0": 2e-3, "duration": 2.0, "room": 300.0,
    "melting": 1500.0,
}  # fmt: skip


def pulled_bar(criterion, steps=6, **changes):
    """Return a bar that is pulled uniformly at a growing rate, and gets hot meanwhile."""
    bar_law = pd.J2(E=10.0, nu=0.3, yield_stress=0.1, hardening=1.0)
    everywhere = pd.region.All()
    return pd.Case(
        **{
            "particles": pd.Lattice((0.0,), (6.0,), 1.0),
            "horizon": 2.015,
            "material": pd.Thermal(bar_law, 0.0, reference=300.0),
            "scheme": pd.Correspondence(),
            "conditions": [
                pd.Displacement(everywhere, x=lambda x, t: 0.05 * t**2 * x[:, 0]),
                pd.Temperature(everywhere, 900.0),
            ],
            "damage": pd.Brittle(criterion),
            "steps": pd.Steps(steps),
            "fields": [],
        }
        | changes
    )


def used_up(criterion, steps=6, T=lambda t: 300.0 + 600.0 * t):
    """Return what the steps of that bar use up: uniaxial stress has a triaxiality of 1/3."""
    used, before = 0.0, 0.0
    for step in range(1, steps + 1):
        t = step / steps
        alpha = max(0.0, (10.0 * np.log(1.0 + 0.05 * t**2) - 0.1) / 11.0)
        rate = (alpha - before) * steps / criterion.duration
        of_rate = 1.0 + criterion.D4 * np.log(max(rate / criterion.rate_0, 1.0))
        failure = (criterion.D1 + criterion.D2 * np.exp(criterion.D3 / 3.0)) * of_rate
        used += (alpha - before) / (failure * (1.0 + criterion.D5 * (T(t) - 300.0) / 1200.0))
        before = alpha
    return used


def test_what_fast_and_hot_flow_uses_up_follows_the_failure_strain_of_each_step(tmp_path):
    """Below and above the rate of the tests; a run that goes on, on other ranks too, uses up the same."""
    criterion = pd.JohnsonCookFailure(**FAST)
    exact = used_up(criterion)
    assert 0.9 > exact > 0.5
    slow = pd.JohnsonCookFailure(**(FAST | {"D4": 0.0, "D5": 0.0}))
    assert abs(used_up(slow) / exact - 1.0) > 0.3  # both factors count
    solution = pd.run(pulled_bar(criterion), tmp_path / "whole").solution
    kept = solution.problem.damage.driving_variable.arrays()
    assert np.allclose(kept["grown"], exact, rtol=1e-9)
    assert solution.state.clock == (1.0, criterion.duration, 0.0, 1.0)
    hours = pd.JohnsonCookFailure(**(FAST | {"rate_0": 7.2, "duration": 2.0 / 3600.0}))
    solution = pd.run(pulled_bar(hours), tmp_path / "hours").solution
    assert np.allclose(solution.problem.damage.driving_variable.arrays()["grown"], exact, rtol=1e-9)


def test_a_run_that_goes_on_knows_when_its_last_step_ended(tmp_path):
    criterion = pd.JohnsonCookFailure(**FAST)
    with pytest.raises(pd.Interrupted):
        pd.run(pulled_bar(criterion, history={"stop": Stop(0.6)}), tmp_path / "part")
    whole = pulled_bar(criterion, history={"stop": Stop(2.0)})
    solution = pd.run(whole, tmp_path / "rest", restart=tmp_path / "part" / "checkpoint.h5").solution
    assert np.allclose(solution.problem.damage.driving_variable.arrays()["grown"], used_up(criterion), rtol=1e-9)


def test_rate_and_temperature_that_are_not_there_are_refused():
    criterion = pd.JohnsonCookFailure(**FAST)
    for changes, message in (
        ({"duration": None}, "step times are no times"),
        ({"melting": None}, "give melting"),
        ({"melting": 200.0}, "below that of melting"),
        ({"D4": -0.1}, "number >= 0 as D4"),
        ({"D5": -1.0}, "D5 > -1"),
        ({"rate_0": 0.0}, "positive number as rate_0"),
        ({"duration": -1.0}, "positive number or None as duration"),
    ):
        with pytest.raises(pd.CaseError, match=message):
            pd.JohnsonCookFailure(**(FAST | changes))
    cold = pd.J2(E=10.0, nu=0.3, yield_stress=0.1, hardening=1.0)
    with pytest.raises(pd.CaseError, match="requires a temperature, and material 1 has none"):
        pulled_bar(criterion, material=cold, conditions=[])
    other = dataclasses.replace(cold, rate=pd.rate.Perzyna(duration=3.0, rate_0=1.0, drag=0.1))
    with pytest.raises(pd.CaseError, match=r"criterion of damage has 2\. Use one value for the case"):
        pulled_bar(criterion, material=pd.Thermal(other, 0.0))
    regions = {"all": pd.region.All()}
    for damage in (pd.Brittle(criterion), pd.DamageOf(regions, {"all": pd.Brittle(criterion)})):
        prepared = pd.prepare(pulled_bar(criterion, damage=damage))
        with pytest.raises(pd.CaseError, match="fails by it, needs load steps"):
            refuse_unmet(prepared.problem, pd.PathFollowing(until=0.1))


def test_the_tangent_knows_that_faster_flow_fails_later(rng):
    """By differences, within a step whose rate changes with the displacement."""
    fast = pd.JohnsonCookFailure(**(FAST | {"D5": 0.0, "D1": 0.004, "D2": 0.008}))
    flowing = pd.J2(E=100.0, nu=0.3, yield_stress=0.5, hardening=5.0)
    model = damaged_body(2, pd.LinearSoftening(fast, 3.0), material=flowing, rng=rng)
    slow = model.driving_values(u := uneven(model, rng))
    model.problem.duration = FAST["duration"]
    model.problem.restored(-0.5)
    fast = model.driving_values(u * (1.0 + 1e-12))
    assert np.all(fast <= slow)
    assert np.median(fast) < 0.97 * np.median(slow)
    check_tangent(model, uneven(model, rng), rng, least=2)


def test_a_stiffness_that_was_not_asked_for_is_not_there():
    """Zeros in its place would give critical stretches that nobody questions."""
    cloud = distribute(world(), np.arange(4.0)[:, None], np.ones(4), {}, 1.1)
    families = find_families(cloud)
    bonds = DamageableBonds.of(cloud, families, np.ones(families.n_bonds), None, False)
    assert pd.ConstantCritical(0.1).build(bonds).limit == pytest.approx(0.1)
    with pytest.raises(TypeError, match="reads_stiffness = False"):
        pd.BondEnergy(w=1.0).resolve(bonds, lambda degree: 1.0)


@pytest.mark.parametrize("effect", [pd.LargestStretch(), pd.PresentStretch()], ids=["largest", "present"])
def test_the_energy_of_a_body_with_broken_bonds_is_that_of_its_forces(effect, rng):
    """Its derivative by the displacement is the force, also where families have lost bonds."""
    case = pd.Case(
        particles=pd.Lattice((0.0, 0.0), (1.0, 0.5), 0.1),
        horizon=0.2015,
        material=pd.LinearElastic(E=1.0, nu=0.3),
        scheme=pd.Correspondence(),
        weights=pd.Standard(),
        damage=pd.Brittle(pd.ConstantCritical(0.01), effect=effect),
        conditions=[pd.Displacement(pd.region.Slab("x", high=0.11), x=0.0, y=0.0)],
    )
    problem = pd.prepare(case).problem
    n = problem.body.cloud.n_owned
    u = 0.02 * rng.uniform(-1.0, 1.0, (n, 2)) * 0.1
    u[:, 0] += 0.02 * (problem.body.cloud.x[:n, 0] > 0.5)
    assert problem.break_bonds(problem.state(u), 10**6) > 0
    term, du = problem.material_term, 1e-7 * rng.uniform(-1.0, 1.0, (n, 2))
    change = term.energy(problem.state(u + du)) - term.energy(problem.state(u - du))
    assert change == pytest.approx(2.0 * (problem.force_of([term], problem.state(u)) * du).sum(), rel=1e-6)
