"""Damage by material and by pair of materials: where it breaks, what that takes, and what is refused."""

import dataclasses
import itertools

import numpy as np
import pytest

import pdpetsc as pd
from tests.commands import ROOT, history, results
from tests.damage.test_fracture import broken
from tests.scenes import MATERIALS, bond_body, damaged_body, dense_tangent, differences

LEFT = pd.region.Slab("x", high=6.0)
CRITICAL = pd.ConstantCritical


def bar(damage, materials=None, **changes):
    """Return a bar of two materials that meet at x = 6, pulled at its ends."""
    if materials is None:
        materials = [(LEFT, pd.BondBased(E=100.0)), (~LEFT, pd.BondBased(E=300.0))]
    right = pd.region.Slab("x", low=10.0)
    declared = {
        "particles": pd.Lattice((0.0, 0.0), (12.0, 4.0), 1.0),
        "horizon": 2.015,
        "material": materials,
        "damage": damage,
        "conditions": [
            pd.Displacement(pd.region.Slab("x", high=2.0), x=0.0, y=0.0),
            pd.Displacement(right, x=0.6, y=0.0),
        ],
        "steps": pd.Steps(12),
        "history": {
            "force": pd.Reaction("x", right), "broken": pd.BrokenBonds(), "work": pd.ExternalWork(),
            "stored": pd.StrainEnergy(), "dissipated": pd.DissipatedEnergy(),
        },
        "results": lambda h: {"force": h["force"][-1], "broken": h["broken"][-1], "peak": max(h["force"])},
    }  # fmt: skip
    return pd.Case(**(declared | changes))


def of(left, right, between, law=pd.Brittle):
    made = [None if one is None else law(one) for one in (left, right, between)]
    return pd.DamageOf({"left": LEFT, "right": ~LEFT}, {"left": made[0], "right": made[1], ("right", "left"): made[2]})


def sides(folder):
    """Return for each broken bond in how many halves its ends are, 1 or 2, and its middle."""
    at = [float(row[5]) for row in broken(folder)]
    places = np.array([(x, y) for x in range(12) for y in range(4)]) + 0.5
    ends = [(places[int(row[2])][0] < 6.0, places[int(row[3])][0] < 6.0) for row in broken(folder)]
    return [1 + (one != other) for one, other in ends], at


@pytest.mark.parametrize(
    ("gradients", "law"),
    [
        (True, pd.Brittle),
        (False, pd.LinearSoftening),
        *(pytest.param(*two, marks=pytest.mark.long) for two in ((True, pd.LinearSoftening), (False, pd.Brittle))),
    ],
)
def test_a_bar_of_two_materials_breaks_where_the_interface_is_weaker(gradients, law, tmp_path):
    changes = {}
    if gradients:
        both = [(LEFT, pd.Hencky(E=100.0, nu=0.3)), (~LEFT, pd.Hencky(E=300.0, nu=0.3))]
        changes = {"materials": both, "scheme": pd.Correspondence(), "control": pd.Silling(0.5)}
    strong = CRITICAL(0.5)
    found = pd.run(bar(of(strong, strong, CRITICAL(0.01), law), **changes), output=tmp_path)
    assert set(sides(tmp_path)[0]) == {2}
    assert found["broken"] == 4 + 6 + 4 + 4  # bonds of (1, 0), (1, +-1) and (2, 0) across the plane
    assert abs(found["force"]) < 1e-6 * found["peak"]
    # As strong as the rest, it is the softer half that breaks; where the interface does not fail, never there.
    pd.run(bar(of(CRITICAL(0.02), strong, None, law), **changes), output=tmp_path)
    assert set(sides(tmp_path)[0]) == {1}
    assert max(sides(tmp_path)[1]) < 6.0


@pytest.mark.parametrize("kind", [pd.FractureEnergy, lambda G: pd.BondEnergy(Gc=G)], ids=["stretch", "energy"])
def test_an_interface_takes_its_fracture_energy(kind, tmp_path):
    """Rigid halves of different stiffness leave each other: what their bonds dissipate is Gc of the interface."""
    tall = {
        "particles": pd.Lattice((0.0, 0.0), (12.0, 30.0), 1.0),
        "cell": pd.Cell((0.0, 0.0), (12.0, 30.0), axes="y"),
        "conditions": [
            pd.MeanStrain(yy=0.0),
            pd.Displacement(LEFT, x=0.0, y=0.0),
            pd.Displacement(~LEFT, x=2.0, y=0.0),
        ],
        "steps": pd.Steps(2),
    }
    for left, right, between in ((0.5, 0.7, 0.05), (0.05, 0.05, 0.3)):
        for law in (pd.Brittle, pd.LinearSoftening, pd.ExponentialSoftening):
            pd.run(bar(of(kind(left), kind(right), kind(between), law), **tall), output=tmp_path)
            assert history(tmp_path)["dissipated"][-1] == pytest.approx(30.0 * between, rel=0.03)
    # One fracture energy for both materials: that of each and of the plane between them, where no crack runs.
    alone = pd.FractureEnergy(0.2, share=1.0) if kind is pd.FractureEnergy else kind(0.2)
    pd.run(bar(pd.Brittle(alone), **tall), output=tmp_path)
    assert history(tmp_path)["dissipated"][-1] == pytest.approx(30.0 * 0.2, rel=0.03)


def test_a_fracture_energy_of_several_materials_and_of_a_graded_one_is_that_of_each():
    """The critical stretch goes with the root of one over the modulus; between two with that of their mean."""
    Gc = 0.2
    alone = {
        E: pd.prepare(bar(pd.Brittle(pd.FractureEnergy(Gc)), pd.BondBased(E=E))).problem.damage for E in (100.0, 300.0)
    }
    stretch = {E: (one.limit / one.bonds.length).max() for E, one in alone.items()}
    assert stretch[100.0] / stretch[300.0] == pytest.approx(np.sqrt(3.0), rel=1e-9)
    graded = pd.Graded(pd.BondBased(E=100.0), lambda x: np.where(x[:, 0] < 6.0, 1.0, 3.0))
    for material in (None, graded):
        damage = pd.prepare(bar(pd.Brittle(pd.FractureEnergy(Gc)), material)).problem.damage
        families, x = damage.body.families, damage.body.cloud.x
        halves = (x[families.centres, 0] < 6.0).astype(int) + (x[families.neighbours, 0] < 6.0)
        s = damage.limit / damage.bonds.length
        assert np.allclose(s[halves == 2], stretch[100.0], rtol=1e-9)
        assert np.allclose(s[halves == 0], stretch[300.0], rtol=1e-9)
        assert np.allclose(s[halves == 1], stretch[100.0] / np.sqrt(2.0), rtol=1e-9)


def test_tangents_with_several_laws_and_criteria_are_exact(rng):
    """One half fails by its strain, the other by the stretch of its bonds, between them by stress."""
    from tests import scenes

    low = pd.region.Slab("x", high=2.5)
    law = pd.DamageOf(
        {"low": low, "high": ~low},
        {
            "low": pd.ExponentialSoftening(pd.MazarsStrain(0.015)),
            "high": pd.LinearSoftening(CRITICAL(0.02), 4.0),
            ("low", "high"): pd.BilinearSoftening(pd.PrincipalStress(0.2)),
        },
    )
    for gradients in (True, False):
        if gradients:
            model = damaged_body(2, law, control=pd.Silling(0.5), material=MATERIALS["hencky"], rng=rng)
        else:
            model = scenes.bond_body(2, pd.BondBased(E=10.0, calibration="family"), rng=rng, damage=law)
        u = 0.03 * model.cloud.x * [1.0, 0.3] + 0.001 * rng.standard_normal(model.cloud.x.shape)
        softening = model.failure.following(model.driving_values(u))[1]
        assert set(model.failure.laws.of_bond[softening]) == {0, 1, 2}
        for _ in range(2):
            K = dense_tangent(model, u)
            columns = rng.choice(u.size, 10, replace=False)
            assert np.abs(K[:, columns] - differences(model, u, columns)).max() < 1e-6 * np.abs(K).max()
            du = rng.standard_normal(u.shape)
            assert np.allclose(K @ du.ravel(), model.tangent_times(u, du).ravel(), atol=1e-10 * np.abs(K).max())
            model.soften(u)
            u = 1.2 * u


def test_the_worst_of_different_laws_is_the_furthest_past_its_own_end():
    low = pd.region.Slab("x", high=2.5)
    law = pd.DamageOf({"low": low, "high": ~low}, {
        "low": pd.Brittle(CRITICAL(0.01)), "high": pd.LinearSoftening(CRITICAL(0.01), 4.0), ("low", "high"): None,
    })  # fmt: skip
    model = damaged_body(2, law)
    assert model.break_bonds(0.015 * model.cloud.x)
    assert set(model.failure.laws.of_bond[~model.failure.intact]) == {0}
    while model.break_bonds(0.015 * model.cloud.x):
        pass
    of_bond, intact = model.failure.laws.of_bond, model.failure.intact
    assert not intact[of_bond == 0].any()
    assert intact[of_bond != 0].all()
    while model.break_bonds(0.05 * model.cloud.x):
        pass
    assert not model.failure.intact[of_bond == 1].any()
    assert model.failure.intact[of_bond == -1].all()


CASE = """
import sys

sys.path.insert(0, {root!r})
from tests.damage.test_interfaces import CRITICAL, bar, of, pd


def case():
    return bar(of(CRITICAL(0.5), CRITICAL(0.5), CRITICAL(0.01), pd.LinearSoftening), steps=pd.Steps(4))
"""


@pytest.mark.long
def test_any_number_of_ranks_breaks_the_same_bonds_of_an_interface(tmp_path):
    path = tmp_path / "bar.py"
    path.write_text(CASE.format(root=str(ROOT)))
    rows = {}
    for ranks in (1, 2):
        results(path, output=tmp_path / str(ranks), ranks=ranks)
        rows[ranks] = [(row[0], row[2], row[3]) for row in broken(tmp_path / str(ranks))]
    assert len(rows[1]) > 4
    assert rows[1] == rows[2]


ALL = pd.region.All()
SNAP = pd.Brittle(CRITICAL(0.01))
TWO = {"left": LEFT, "right": ~LEFT}
EACH = {"left": SNAP, "right": SNAP}


@pytest.mark.parametrize(("regions", "laws", "why"), [
    (TWO, {**EACH, ("left", "middle"): SNAP}, "'middle', which is none of its regions"),
    (TWO, {"left": SNAP}, "needs a law of 'right'"),
    (TWO, {**EACH, ("left", "right"): SNAP, ("right", "left"): None}, "two laws of 'left' and 'right'"),
    (TWO, {"left": None, "right": None}, "needs a law"),
    (TWO, {**EACH, ("left", "right"): dataclasses.replace(SNAP, effect=pd.PresentStretch())}, "same effect"),
    (TWO, {"left": 1.0, "right": SNAP}, "laws"),
])  # fmt: skip
def test_wrong_declarations_are_refused(regions, laws, why):
    with pytest.raises(pd.CaseError, match=why):
        pd.DamageOf(regions, laws)


def test_wrong_regions_are_refused():
    for regions, laws, why in (
        ({"left": LEFT, "all": ALL}, {"left": SNAP, "all": SNAP, ("left", "all"): SNAP}, "is in 2 regions"),
        ({"left": LEFT}, {"left": SNAP}, "is in 0 regions"),
        (TWO, EACH, "share bonds, and DamageOf has no law"),
        ({"left": pd.region.Slab("z", high=1.0)}, {"left": SNAP}, "Region 'left' of DamageOf"),
    ):
        with pytest.raises(pd.CaseError, match=why):
            pd.prepare(bar(pd.DamageOf(regions, laws)))


def two_springs(law_of_left, law_of_right, solver, folder):
    """Return the largest force of three particles in a row whose two bonds have laws of their own, and all of it."""
    left, right = pd.region.Slab("x", high=1.0), pd.region.Slab("x", low=2.0)
    middle = ~left & ~right
    laws = {
        "left": None,
        "middle": None,
        "right": None,
        ("left", "middle"): law_of_left,
        ("middle", "right"): law_of_right,
    }
    case = pd.Case(
        particles=pd.Lattice((0.0,), (3.0,), 1.0), horizon=1.015, material=pd.BondBased(E=1.0),
        damage=pd.DamageOf({"left": left, "middle": middle, "right": right}, laws),
        conditions=[pd.Displacement(left, x=0.0), pd.Displacement(right, x=0.2)],
        steps=pd.Steps(40), solver=solver, history={"force": pd.Reaction("x", right)},
    )  # fmt: skip
    return pd.run(case, output=folder).history


def test_events_follow_each_bond_by_its_own_law(tmp_path):
    """Two bonds in a row: the one with the lower limit softens alone, along its law, and the other unloads."""
    weak, strong = pd.LinearSoftening(CRITICAL(0.01), ratio=8.0), pd.Brittle(CRITICAL(0.02))
    h = two_springs(weak, strong, pd.EventDriven(), tmp_path / "events")
    # Stretches at the events, of the total elongation: both reach .01; the weak one fails at .08 with the other at 0.
    assert np.asarray(h["t"])[1:3] == pytest.approx([0.1, 0.4], rel=1e-9)
    assert np.asarray(h["force"])[1:3] / h["force"][1] == pytest.approx([1.0, 0.0], abs=1e-9)
    mirrored = two_springs(strong, weak, pd.EventDriven(), tmp_path / "mirrored")
    assert mirrored["force"] == pytest.approx(h["force"], rel=1e-9, abs=1e-12 * np.abs(h["force"]).max())
    newton = two_springs(weak, strong, pd.Newton(), tmp_path / "newton")
    along = np.interp(newton["t"], h["t"], h["force"])
    assert newton["force"] == pytest.approx(along, abs=1e-9 * np.abs(h["force"]).max())


def test_events_refuse_laws_that_are_not_piecewise_linear(tmp_path):
    bent = pd.DamageOf(TWO, {**EACH, ("left", "right"): pd.ExponentialSoftening(CRITICAL(0.1))})
    with pytest.raises(pd.CaseError, match="piecewise linear: ExponentialSoftening is not"):
        pd.run(bar(bent, solver=pd.EventDriven()), output=tmp_path)


def test_protected_bonds_of_laws_by_region_do_not_fail(tmp_path):
    damage = dataclasses.replace(
        of(CRITICAL(0.01), CRITICAL(0.01), CRITICAL(0.01)), protected=pd.region.Slab("x", 4.0, 8.0)
    )
    pd.run(bar(damage), output=tmp_path)
    places = np.array(list(itertools.product(np.arange(12) + 0.5, np.arange(4) + 0.5)))
    rows = broken(tmp_path)
    assert rows
    for row in rows:
        for end in (int(row[2]), int(row[3])):
            assert not 4.0 <= places[end][0] <= 8.0


def test_a_law_protects_its_own_bonds_alone(tmp_path):
    """Three laws with a region each are the body with the region; one of them spares the bonds of its part."""
    middle, laws = pd.region.Slab("x", 4.0, 8.0), of(CRITICAL(0.01), CRITICAL(0.01), CRITICAL(0.01)).laws
    spared = {name: dataclasses.replace(law, protected=middle) for name, law in laws.items()}
    declared = {
        "body": pd.DamageOf(TWO, laws, protected=middle),
        "laws": pd.DamageOf(TWO, spared),
        "left": pd.DamageOf(TWO, of(CRITICAL(0.01), CRITICAL(0.01), CRITICAL(0.002)).laws | {"left": spared["left"]}),
    }
    for name, damage in declared.items():
        pd.run(bar(damage), output=tmp_path / name)
    assert broken(tmp_path / "laws") == broken(tmp_path / "body")
    rows = broken(tmp_path / "left")
    places = np.array(list(itertools.product(np.arange(12) + 0.5, np.arange(4) + 0.5)))[:, 0]
    ends = np.array([[places[int(row[2])], places[int(row[3])]] for row in rows])
    touching = ((ends >= 4.0) & (ends <= 8.0)).any(axis=1)
    assert touching.any()  # of the other two laws
    assert not (touching & (ends < 6.0).all(axis=1)).any()


@pytest.mark.parametrize("kinematics", ["small", "finite"])
def test_cracks_of_one_law_close_and_those_of_another_stay_open(kinematics, rng):
    """Bonds have the secant of a body whose cracks all close, or of one whose cracks all stay open, by their law."""
    half = pd.region.Slab("x", high=1.5)
    open_ = pd.LinearSoftening(CRITICAL(0.02), 3.0)
    closing = dataclasses.replace(open_, closes=True)
    by_law = pd.DamageOf({"left": half, "right": ~half}, {"left": closing, "right": open_, ("left", "right"): closing})
    pull, models, seed = None, {}, rng.integers(1 << 30)
    for name, law in {"both": by_law, "open": open_, "closing": closing}.items():
        shaken = np.random.default_rng(seed)
        model = bond_body(2, pd.BondBased(E=10.0, kinematics=kinematics), rng=shaken, damage=law)
        if pull is None:
            pull = 0.035 * (model.cloud.x - model.cloud.x.mean(axis=0))
            pull += 0.002 * rng.standard_normal(model.cloud.x.shape)
        model.soften(pull)
        model.break_bonds(2.0 * pull, 8)
        models[name] = model
    u, x = pull * [1.1, -0.5], models["both"].cloud.x
    model = models["both"]
    stiff = {name: one.material_term.secant(one.problem.state(u)) for name, one in models.items()}
    families = model.families
    right = (x[families.centres, 0] > 1.5) & (x[families.neighbours, 0] > 1.5)
    assert np.array_equal(stiff["both"], np.where(right, stiff["open"], stiff["closing"]))
    assert (stiff["both"] != stiff["open"]).any()
    assert (stiff["both"] != stiff["closing"]).any()
    K = dense_tangent(model, u)
    assert np.abs(K - K.T).max() < 1e-12 * np.abs(K).max()
    columns = rng.choice(u.size, 8, replace=False)
    assert np.abs(K[:, columns] - differences(model, u, columns)).max() < 1e-6 * np.abs(K).max()


@pytest.mark.long
@pytest.mark.parametrize("model", ["bonds", pytest.param("gradients", marks=pytest.mark.long)])
def test_a_fibre_debonds_from_its_poles(model, tmp_path):
    """Where the pull opens the interface most; it stops where the matrix presses on the fibre, some 70 degrees on."""
    found = results("runs/fracture/interface.py", f"model={model}", output=tmp_path)["results"]
    assert found["first_angle"] < 30.0
    assert 55.0 < found["debonded"] < 90.0
    assert found["at_interface"] == 1.0
    h = history(tmp_path)
    # Debonded all the same, the body carries more and more.
    assert h["force"][-1] > 20.0 * found["debonding_stress"] * 0.5


@pytest.mark.parametrize("changes", [{"closes": True}, {"protected": pd.region.All()}])
def test_a_law_of_one_region_closes_and_protects_its_own_bonds_alone(changes, tmp_path):
    """Two separate bars, torn and then pressed, each as if it were alone."""
    laws = {"low": pd.Brittle(CRITICAL(0.01)), "high": pd.Brittle(CRITICAL(0.01), **changes)}
    parts = {"low": pd.region.Slab("y", high=5.0), "high": pd.region.Slab("y", low=5.0)}
    path = pd.Table((0.0, 0.4, 0.5, 1.0), (0.0, 0.3, 0.0, -0.1))

    def forces(damage, names, folder):
        right = pd.region.Slab("x", low=10.0)
        gap = pd.region.Slab("y", low=3.0, high=7.0)
        whole = parts[names[0]] if len(names) == 1 else pd.region.All()
        case = bar(
            damage,
            pd.BondBased(E=100.0),
            particles=pd.Lattice((0.0, 0.0), (12.0, 10.0), 1.0, keep=whole & ~gap),
            conditions=[
                pd.Displacement(pd.region.Slab("x", high=2.0), x=0.0, y=0.0),
                pd.Displacement(right, x=1.0, y=0.0, schedule=path),
            ],
            steps=pd.Steps(20),
            history={name: pd.Reaction("x", right & parts[name]) for name in names},
            results=None,
        )
        pd.run(case, output=tmp_path / folder)
        return history(tmp_path / folder)

    both = forces(pd.DamageOf(parts, laws), ["low", "high"], "both")
    for name in parts:
        alone = forces(laws[name], [name], name)[name]
        assert np.allclose(both[name], alone, atol=1e-6 * np.abs(alone).max())
    assert not np.allclose(both["low"], both["high"], atol=1e-2 * np.abs(both["high"]).max())
