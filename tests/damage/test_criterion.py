"""What drives damage, from outside the package: bond energy, compression, the stretch of whole families."""

import dataclasses
import itertools
from dataclasses import dataclass

import numpy as np
import pytest

import pdpetsc as pd
from pdpetsc.damage import (
    Criterion,
    DrivingVariable,
    Gradient,
    LinearDrivingVariable,
    LocalDrivingVariable,
    NonlocalPart,
)
from pdpetsc.discrete.cloud import distribute
from pdpetsc.discrete.communicator import world
from pdpetsc.discrete.families import find_families
from tests.commands import history, jacobian_ratios, results
from tests.damage.test_fracture import broken, strip
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


class _EnergyDrive(LocalDrivingVariable):
    """``x = 1/2 k <e>^2 / W``."""

    def __init__(self, bonds, W):
        super().__init__(bonds)
        self._each = bonds.k / W
        self._W = W

    def of(self, e):
        return 0.5 * self._each * np.maximum(e, 0.0) ** 2

    def along(self, e, bonds, by):
        return by * self._each[bonds] * np.maximum(e[bonds], 0.0)

    def elastic_energy(self, bonds, k):
        return np.full(len(bonds), self._W), 1.0


@dataclass(frozen=True)
class BondEnergy(Criterion):
    """A bond fails where half of it stores the energy ``W`` in tension."""

    W: float

    def build(self, bonds):
        return _EnergyDrive(bonds, self.W)


class _BothWaysDrive(LocalDrivingVariable):
    """``x = max(e, -e / 2) / limit``."""

    def __init__(self, bonds, limit):
        super().__init__(bonds)
        self._limit = limit

    def of(self, e):
        return np.maximum(e, -0.5 * e) / self._limit

    def along(self, e, bonds, by):
        return by * np.where(e[bonds] > 0.0, 1.0, -0.5) / self._limit


@dataclass(frozen=True)
class BothWays(Criterion):
    """A bond fails at an elongation, and where it shortens by twice that."""

    limit: float

    def build(self, bonds):
        return _BothWaysDrive(bonds, self.limit)


@dataclass(frozen=True)
class Elongation(Criterion):
    """A bond fails at an elongation, whatever its length."""

    limit: float

    def build(self, bonds):
        return LinearDrivingVariable(bonds, np.full(len(bonds.length), self.limit))


class _FamilyDrive(DrivingVariable):
    """``x_ij = (theta_i + theta_j) / 2``, or ``theta_i``, with the mean stretch of families over the critical one."""

    is_nonlocal = True

    def __init__(self, bonds, s, mean):
        self._bonds, self._mean = bonds, mean
        families = bonds.families
        self._weight = 1.0 / (s * bonds.length * np.diff(families.indptr)[families.centres])

    def at(self, state):
        families, cloud = self._bonds.families, self._bonds.cloud
        e = state.elongated(self._bonds.finite)[0]
        theta = np.zeros(cloud.n_local)
        theta[: cloud.n_owned] = np.bincount(families.centres, self._weight * e, cloud.n_owned)
        cloud.halo.forward(theta)
        x = theta[families.centres]
        return 0.5 * (x + theta[families.neighbours]) if self._mean else x

    def gradient(self, state, bonds, by):
        families, x = self._bonds.families, self._bonds.cloud.x
        y = families.bonds(x) + self._bonds.finite * families.bonds(state.u_local)
        n = self._weight[:, None] * y / np.linalg.norm(y, axis=1)[:, None]
        ptr, particles, each = [0], [], []
        for b, factor in zip(bonds, by, strict=True):
            i = families.centres[b]
            span = slice(families.indptr[i], families.indptr[i + 1])
            particles.append(np.append(families.neighbours[span], i))
            each.append(factor * np.vstack([n[span], -n[span].sum(axis=0)]))
            ptr.append(ptr[-1] + len(particles[-1]))
        members = np.concatenate([np.empty(0, np.int32), *particles]).astype(np.int32)
        values = np.concatenate([np.empty((0, x.shape[1])), *each])
        return Gradient(bonds, np.zeros(len(bonds)), NonlocalPart(np.array(ptr, dtype=np.int64), members, values))


@dataclass(frozen=True)
class FamilyStretch(Criterion):
    """A bond fails with the mean stretch of the families of both of its ends, or of its first one alone."""

    s: float
    mean: bool = True

    def build(self, bonds):
        return _FamilyDrive(bonds, self.s, self.mean)


def pulled(model, rng, strain):
    return displacement(model, rng, 0.002) + strain * (model.cloud.x - model.cloud.x.mean(axis=0))


def check_tangent(model, u, rng, least=4):
    """Compare the tangent with differences, as a matrix and without one."""
    assert np.count_nonzero(model.failure.following(model.driving_values(u))[2]) > least
    K = dense_tangent(model, u)
    columns = rng.choice(u.size, min(8, u.size), replace=False)
    assert np.abs(K[:, columns] - differences(model, u, columns)).max() < 1e-6 * np.abs(K).max()
    du = rng.standard_normal(u.shape)
    assert np.allclose(K @ du.ravel(), model.tangent_times(u, du).ravel(), atol=1e-10 * np.abs(K).max())
    return K


FOREIGN = {"both_ways": (BothWays(0.02), (0.025, -0.05)), "elongation": (Elongation(0.02), (0.025,))}


@pytest.mark.parametrize("law", ["linear", "exponential"])
@pytest.mark.parametrize("name", [*FOREIGN, "energy"])
@pytest.mark.parametrize("dim", DIMS)
def test_tangents_with_a_drive_from_outside_are_exact(dim, name, law, rng):
    for finite, of_bonds in ((False, True), (True, True), (True, False)):
        seed = int(rng.integers(2**31))

        def body(criterion, finite=finite, of_bonds=of_bonds, seed=seed):
            damage, shaken = LAWS[law](criterion), np.random.default_rng(seed)
            if of_bonds:
                material = BONDS["bond_based_lattice_finite" if finite else "bond_based_lattice"]
                return bond_body(dim, material, rng=shaken, damage=damage)
            return damaged_body(dim, damage, control=pd.Silling(0.5), rng=shaken)

        if name in FOREIGN:
            criterion, strains = FOREIGN[name]
        else:
            whole = body(BondEnergy(1.0))
            driven = whole.driving_values(0.025 * whole.cloud.x)
            criterion, strains = BondEnergy(float(np.median(driven)) / 1.3), (0.025,)
        model = body(criterion)
        for strain in strains:
            K = check_tangent(model, pulled(model, rng, strain), rng)
            if of_bonds:
                assert np.abs(K - K.T).max() < 1e-12 * np.abs(K).max()


@pytest.mark.parametrize("effect", [pd.LargestStretch(), pd.PresentStretch()])
@pytest.mark.parametrize("scheme", ["correspondence", "sub_horizons"])
def test_tangents_of_gradients_with_a_drive_of_whole_families_are_exact(scheme, effect, rng):
    law = pd.LinearSoftening(FamilyStretch(0.02, mean=False), effect=effect)
    model = damaged_body(2, law, SCHEMES[scheme], pd.Silling(0.5), rng=rng)
    check_tangent(model, pulled(model, rng, 0.025), rng)


@pytest.mark.parametrize("kinematics", ["small", "finite"])
@pytest.mark.parametrize("dim", DIMS)
def test_tangents_of_bonds_with_a_drive_of_whole_families_are_exact(dim, kinematics, rng):
    """Bonds of one stiffness from both ends: what either direction leaves out the other has."""
    material = pd.BondBased(E=10.0, calibration="lattice", kinematics=kinematics)
    model = bond_body(dim, material, rng=rng, damage=pd.LinearSoftening(FamilyStretch(0.02)))
    assert not model.problem.symmetric
    u = pulled(model, rng, 0.025)
    check_tangent(model, u, rng)
    # The gradient of the mean of what is driven most, against differences.
    gradient, found = model.problem.damage.most_driven(model.at(u), 0.3)
    near = model.driving_values(u) >= 0.7 * found
    du = rng.standard_normal(u.shape)
    rate = (model.driving_values(u + 1e-6 * du)[near].mean() - model.driving_values(u - 1e-6 * du)[near].mean()) / 2e-6
    assert (gradient * du).sum() == pytest.approx(rate, rel=1e-6)


E, K, STIFFER = 100.0, 100.0, 10.0


def bar(damage, **changes):
    """Return three particles: a bond of stiffness K that fails, and one ten times as stiff that is protected."""
    far = pd.region.Nearest((2.5,))
    declared = {
        "particles": pd.Arrays([[0.5], [1.5], [2.5]], 1.0),
        "horizon": 1.1,
        "material": pd.Graded(
            pd.BondBased(E=E, calibration="lattice"), lambda x: np.where(x[:, 0] > 2.0, 2.0 * STIFFER - 1.0, 1.0)
        ),
        "damage": dataclasses.replace(damage, protected=far),
        "conditions": [pd.Displacement(pd.region.Nearest((0.5,)), x=0.0), pd.Displacement(far, x=0.022)],
        "steps": pd.Steps(40),
        "history": {
            "displacement": pd.At((2.5,), pd.displacement, "x"),
            "force": pd.Reaction("x", far),
            "energy": pd.StrainEnergy(),
            "dissipated": pd.DissipatedEnergy(),
            "work": pd.ExternalWork(),
        },
    }
    return pd.Case(**(declared | changes))


def on_the_curve(h, limit, ratio):
    """Check force over elongation of the failing bond, ``K e T((e / limit)^2)``, and the load at failure."""
    e = h["displacement"] - h["force"] / (STIFFER * K)
    x = (e / limit) ** 2
    T = np.where(x > 1.0, np.maximum(ratio - x, 0.0) / (ratio - 1.0) / np.maximum(x, 1.0), 1.0)
    assert np.allclose(h["force"], K * e * T, atol=1e-7)


@pytest.mark.parametrize("ratio", [3.0, 5.0])
def test_newton_follows_a_bond_that_fails_with_its_energy(ratio, tmp_path):
    limit = 0.01
    law = pd.LinearSoftening(BondEnergy(0.25 * K * limit**2), ratio)
    # A step meets the load at failure, K limit, exactly.
    end = 0.02 * (1.0 + 1.0 / STIFFER) * np.ceil(np.sqrt(ratio)) / 2.0
    case = bar(law)
    case = dataclasses.replace(
        case, conditions=[case.conditions[0], dataclasses.replace(case.conditions[1], x=end)], steps=pd.Steps(60)
    )
    pd.run(case, output=tmp_path)
    h = history(tmp_path)
    on_the_curve(h, limit, ratio)
    assert h["force"].max() == pytest.approx(K * limit, rel=1e-9)
    assert h["force"][-1] == pytest.approx(0.0, abs=1e-9)
    # Both halves of the bond: -int W x dT(x) = W r ln r / (r - 1).
    assert h["dissipated"][-1] == pytest.approx(0.5 * K * limit**2 * ratio * np.log(ratio) / (ratio - 1.0), rel=1e-12)
    assert law.toughness(1.0) == pytest.approx(ratio * np.log(ratio) / (ratio - 1.0), rel=1e-12)


@pytest.mark.long
def test_a_path_follows_what_is_driven_most(tmp_path):
    limit, ratio = 0.01, 3.0
    law = pd.LinearSoftening(BondEnergy(0.25 * K * limit**2), ratio)
    case = bar(law, solver=pd.PathFollowing(pd.BondStretch(0.1)), steps=pd.Steps(1))
    pd.run(case, output=tmp_path)
    h = history(tmp_path)
    on_the_curve(h, limit, ratio)
    assert 0.9 * K * limit < h["force"].max() <= K * limit * (1.0 + 1e-9)
    assert h["force"][-1] < 0.1 * K * limit


@pytest.mark.long
def test_a_bond_that_fails_in_compression_as_well(tmp_path):
    """It snaps at the closed-form load either way; no law alone knows its energy, so that work less energy does."""
    limit = 0.01
    for sign, hard in ((1.0, 1.0), (-1.0, 2.0)):
        case = bar(pd.Brittle(BothWays(limit)))
        moved = dataclasses.replace(case.conditions[1], x=sign * 0.033)
        case = dataclasses.replace(case, conditions=[case.conditions[0], moved], steps=pd.Steps(75))
        pd.run(case, output=tmp_path)
        h = history(tmp_path)
        largest = np.abs(h["force"]).max()
        assert K * limit * hard * (1.0 - 0.05) < largest <= K * limit * hard * (1.0 + 1e-9)
        assert h["force"][-1] == pytest.approx(0.0, abs=1e-9)
        assert np.allclose(h["dissipated"], h["work"] - h["energy"], atol=1e-12)


@pytest.mark.parametrize("law", ["linear", "brittle"])
@pytest.mark.parametrize("name", ["energy", "both_ways"])
def test_a_gradient_fails_at_the_load_of_its_criterion(name, law):
    """Two particles: F is the stretch of their bond, so that its force is T 2 V P(1 + s) / length at both ends."""
    V, length, at = 1.3, 0.7, 0.02
    cloud = distribute(world(), np.array([[0.0], [length]]), np.full(2, V), {}, 1.0)
    families, of = find_families(cloud), np.zeros(2, dtype=np.int32)

    def model(criterion):
        material = [pd.Hencky(E=10.0, nu=0.3)]
        damage = LAWS[law](criterion)
        return small_points(cloud, families, np.ones(2), pd.Correspondence(), material, of, None, damage)

    # The bond-based material with the same E stores 1/2 E s^2 per volume in uniform strain.
    two = model(BondEnergy(0.5 * 10.0 * V * (at / length) ** 2) if name == "energy" else BothWays(at))
    whole = at * (1.0 - 1e-6)
    force = 2.0 * V * 10.0 * np.log1p(whole / length) / (1.0 + whole / length) / length
    u = np.array([[0.0], [whole]])
    assert two.internal_force(u)[1, 0] == pytest.approx(force, rel=1e-12)
    assert two.driving_values(u) == pytest.approx((1.0 - 1e-6) ** (2 if name == "energy" else 1), rel=1e-9)
    assert not two.break_bonds(u)
    # Drives that differ by less than 1e-7 are the same.
    reached = np.array([[0.0], [at * (1.0 - 1e-9)]])
    assert two.break_bonds(reached) == (law == "brittle")
    if law == "linear":
        e = 1.2 * at
        x = 1.2**2 if name == "energy" else 1.2
        elastic = 2.0 * V * 10.0 * np.log1p(e / length) / (1.0 + e / length) / length
        assert two.internal_force(np.array([[0.0], [e]]))[1, 0] == pytest.approx(elastic * (2.0 - x) / x, rel=1e-12)
        assert two.break_bonds(np.array([[0.0], [2.001 * at]])) == 1


@pytest.mark.parametrize("of_bonds", [True, pytest.param(False, marks=pytest.mark.long)])
def test_petsc_finds_the_jacobian_of_newton_correct(of_bonds, tmp_path, capfd):
    """A strip that softens with the energy of its bonds, and then comes apart."""
    changes = {"scheme": None, "control": None, "material": pd.BondBased(E=100.0)} if of_bonds else {}
    case = strip(damage=pd.LinearSoftening(BondEnergy(0.003), 3.0), **changes)
    weak = dataclasses.replace(case.conditions[1], x=0.133)
    lost = {"lost": pd.Largest(pd.local_damage)}
    softened = dataclasses.replace(
        case, conditions=[case.conditions[0], weak], steps=pd.Steps(1), history=lost, results=None
    )
    pd.run(softened, output=tmp_path, options={"snes_test_jacobian": None})
    assert history(tmp_path)["lost"][-1] > 0.01
    ratios = jacobian_ratios(capfd.readouterr().out)
    # Once damage is taken for good it is at a kink: further for more, unchanged for less.
    assert len(ratios) > 6
    assert max(ratios[:6]) < 1e-6
    found = pd.run(case, output=tmp_path)
    assert found["broken"] > 0.0
    assert abs(found["force"]) < 1e-5 * found["peak"]


FAMILY_CASE = """
import sys

sys.path.insert(0, {root!r})
from tests.damage.test_criterion import FamilyStretch, pd, strip


def case(of_bonds=False):
    changes = dict(scheme=None, control=None, material=pd.BondBased(E=100.0)) if of_bonds else {{}}
    return strip(damage=pd.LinearSoftening(FamilyStretch(0.02)), steps=pd.Steps(8), **changes)
"""


@pytest.mark.long
@pytest.mark.parametrize("of_bonds", [True, False])
def test_any_number_of_ranks_breaks_the_same_bonds_of_whole_families(of_bonds, tmp_path):
    from tests.commands import ROOT

    path = tmp_path / "family.py"
    path.write_text(FAMILY_CASE.format(root=str(ROOT)))
    rows = {}
    for ranks in (1, 2):
        results(path, f"of_bonds={of_bonds}", output=tmp_path / str(ranks), ranks=ranks)
        rows[ranks] = [(row[0], row[2], row[3]) for row in broken(tmp_path / str(ranks))]
    assert len(rows[1]) > 4
    assert rows[1] == rows[2]


def test_events_follow_a_drive_that_is_linear_in_the_elongation_and_refuse_others(tmp_path):
    limit = 0.01
    case = bar(pd.Brittle(Elongation(limit)), solver=pd.EventDriven())
    pd.run(case, output=tmp_path)
    h = history(tmp_path)
    assert h["force"].max() == pytest.approx(K * limit, rel=1e-12)
    assert h["dissipated"][-1] == pytest.approx(0.5 * K * limit**2, rel=1e-12)
    for wrong in (BondEnergy(1.0), BothWays(limit)):
        with pytest.raises(pd.CaseError, match=f"linear in the elongation of the bond itself: {type(wrong).__name__}"):
            pd.run(bar(pd.Brittle(wrong), solver=pd.EventDriven()), output=tmp_path)


def test_a_criterion_is_resolved_once_with_the_bonds_and_refused_where_it_is_none(rng):
    @dataclass(frozen=True)
    class Given(Criterion):
        """Bonds fail with a share of the energy that they would store at a stretch of 1, and take ``G`` to break."""

        G: float

        def build(self, bonds):
            raise pd.CaseError("Given is resolved first.")

        def resolve(self, bonds, toughness):
            return BondEnergy(self.G / toughness(1.0) / len(bonds.k))

    model = bond_body(2, BONDS["bond_based_lattice"], damage=pd.LinearSoftening(Given(0.3), 3.0))
    damage = model.problem.damage
    u = model.cloud.x
    assert isinstance(damage.bonds.law.criterion, BondEnergy)
    while model.break_bonds(u):
        pass
    assert damage.dissipated(model.material_term.k).sum() == pytest.approx(0.3, rel=1e-12)
    with pytest.raises(pd.CaseError, match="needs a criterion"):
        pd.Brittle(pd.Newton())


def test_the_strain_of_a_gradient_tears_by_what_it_would_drive(rng):
    for law, dim in itertools.product(("brittle", "linear"), (2, 3)):
        model = damaged_body(dim, LAWS[law](BothWays(0.02)))
        drive, length = model.problem.damage.driving_variable, model.failure.length
        assert np.allclose(drive.at_strain(np.full(len(length), 0.01)), 0.01 * length / 0.02, rtol=1e-14)
        assert (
            damaged_body(dim, LAWS[law](FamilyStretch(0.02))).problem.damage.driving_variable.at_strain(length) is None
        )


def test_a_criterion_for_one_material_is_refused_for_several():
    @dataclass(frozen=True)
    class Alone(Elongation):
        """A bond fails at an elongation, in bodies of one material."""

        of_one_material = True

    soft, right = pd.BondBased(E=10.0), pd.region.Slab("x", low=8.0)
    for several in (pd.Graded(soft, lambda x: 1.0 + x[:, 0]), [(~right, soft), (right, pd.BondBased(E=40.0))]):
        case = pd.Case(
            particles=pd.Lattice((0.0, 0.0), (16.0, 8.0), 1.0), horizon=3.015, material=several,
            conditions=[pd.Displacement(pd.region.Slab("x", high=1.0), x=0.0, y=0.0)], damage=pd.Brittle(Alone(0.05)),
        )  # fmt: skip
        with pytest.raises(pd.CaseError, match="requires one uniform material"):
            pd.prepare(case)


@pytest.mark.parametrize("kinematics", ["small", "finite"])
@pytest.mark.parametrize("dim", DIMS)
@pytest.mark.parametrize("nu", [0.1, 0.4])
def test_ordinary_state_based_bonds_fail_with_exact_tangents_and_energies(dim, kinematics, nu, rng):
    """The dilatation counts bonds with their integrity; forces at a given one are the derivative of the energy."""
    material = pd.LinearSolid(E=10.0, nu=nu, kinematics=kinematics)
    for criterion in (Elongation(0.02), FamilyStretch(0.02, mean=False)):
        model = bond_body(dim, material, rng=rng, damage=pd.LinearSoftening(criterion, 3.0))
        u = pulled(model, rng, 0.025)
        K = check_tangent(model, u, rng)
        assert not model.problem.symmetric
        assert np.abs(K - K.T).max() > 1e-6 * np.abs(K).max()
        model.break_bonds(4.0 * u, {1: 2, 2: 20, 3: 60}[dim])
        assert 0 < model.failure.count_broken() < np.count_nonzero(model.failure.phi)
        check_tangent(model, u, rng, least=0)
        model.soften(u)
        model.freeze(True)
        K = dense_tangent(model, u)
        assert np.abs(K - K.T).max() < 1e-12 * np.abs(K).max()
        du = rng.standard_normal(u.shape)
        rate = (sum(model.energy(u + 1e-6 * du)) - sum(model.energy(u - 1e-6 * du))) / 2e-6
        assert (model.internal_force(u) * du).sum() == pytest.approx(rate, rel=1e-6)


def test_a_family_that_has_lost_its_bonds_has_no_dilatation(rng):
    model = bond_body(2, pd.LinearSolid(E=10.0, nu=0.4), damage=pd.Brittle(Elongation(0.02)))
    u = 0.1 * model.cloud.x
    while model.break_bonds(u):
        pass
    assert np.abs(model.material_term.dilatation(model.at(u))).max() == 0.0
    assert np.abs(model.internal_force(u)).max() == 0.0
    assert model.material_term.dissipated_energy() is None


@pytest.mark.long
def test_a_body_of_state_based_bonds_comes_apart_and_its_energies_balance(tmp_path):
    """What the supports have done is stored or dissipated; the pieces carry nothing and store nothing."""
    changes = {"scheme": None, "control": None, "material": pd.LinearSolid(E=100.0, nu=0.2)}
    case = strip(damage=pd.LinearSoftening(pd.FractureEnergy(0.05), 3.0), **changes)
    more = {
        "work": pd.ExternalWork(), "stored": pd.StrainEnergy(), "dissipated": pd.DissipatedEnergy(), **case.history,
    }  # fmt: skip
    found = pd.run(dataclasses.replace(case, history=more), output=tmp_path)
    h = history(tmp_path)
    assert found["broken"] > 10
    assert abs(found["force"]) < 1e-6 * found["peak"]
    assert h["stored"][-1] < 1e-6 * h["work"][-1]
    assert np.allclose(h["dissipated"], h["work"] - h["stored"], atol=1e-12)


def test_events_refuse_bonds_with_a_dilatation(tmp_path):
    case = strip(
        scheme=None, control=None, material=pd.LinearSolid(E=100.0, nu=0.2), damage=pd.Brittle(Elongation(0.02)),
        conditions=strip().conditions, solver=pd.EventDriven(),
    )  # fmt: skip
    with pytest.raises(pd.CaseError, match="bonds without dilatation"):
        pd.run(case, output=tmp_path)
