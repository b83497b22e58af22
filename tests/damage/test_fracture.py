"""Fracture in load steps: separation in every variant, symmetry, ranks, restart, pieces that come free."""

import csv
import dataclasses
import itertools
import sys

import numpy as np
import pytest

import pdpetsc as pd
from tests.commands import ROOT, Stop, field, history, results, summary
from tests.scenes import DIMS, bond_body, dense_tangent, differences
from tests.solvers.test_events import one_bond

sys.path.append(str(ROOT / "runs/fracture"))
import plate_with_hole

PLATE = "runs/fracture/plate_with_hole.py"


def broken(folder):
    with (folder / "broken_bonds.csv").open() as file:
        return [tuple(row) for row in csv.reader(file)][1:]


@pytest.mark.processors
@pytest.mark.parametrize("ratio", [2.5, 4.0])
def test_newton_follows_the_law_of_one_bond(ratio, tmp_path):
    """Two equal springs in series, one of which softens: force k l (r - x) / (r - 1) at every displacement."""
    case = dataclasses.replace(one_bond(ratio), solver=pd.Newton(), steps=pd.Steps(40))
    pd.run(case, output=tmp_path)
    h = history(tmp_path)
    k, limit, u = 100.0, 0.01, h["displacement"]
    x = (u / limit - ratio / (ratio - 1.0)) / (1.0 - 1.0 / (ratio - 1.0))
    exact = np.where(u <= 2.0 * limit, 0.5 * k * u, np.maximum(k * limit * (ratio - x) / (ratio - 1.0), 0.0))
    assert np.allclose(h["force"], exact, atol=1e-7)
    work = np.concatenate([[0.0], np.cumsum(0.5 * (h["force"][1:] + h["force"][:-1]) * np.diff(u))])
    assert np.allclose(work, h["energy"] + h["dissipated"], atol=1e-6 * work[-1] + 0.005 * work.max())


def test_the_staggered_solve_jumps_what_newton_cannot_follow(tmp_path):
    case = dataclasses.replace(one_bond(1.5), solver=pd.Newton(), steps=pd.Steps(7))
    pd.run(case, output=tmp_path)
    h = history(tmp_path)
    assert h["force"].max() == pytest.approx(100.0 * 0.1 / 7 / 2, rel=1e-6)
    assert np.all(np.abs(h["force"][2:]) < 1e-6)


@pytest.mark.long
@pytest.mark.parametrize(
    ("scheme", "law"),
    [*(("correspondence", law) for law in ("brittle", "linear", "smooth")), ("sub_horizons", "linear")],
)
def test_a_plate_with_a_hole_separates_symmetrically(law, scheme, tmp_path):
    G = 0.5 if scheme == "correspondence" else 0.0
    found = results(PLATE, f"law={law}", f"scheme={scheme}", f"G={G}", "steps=20", output=tmp_path)["results"]
    assert found["broken_bonds"] > 60
    assert abs(found["last_load"]) < 1e-4 * found["peak_load"]
    assert found["symmetry_error"] < 1e-6
    assert 0.0 < found["first_damage_load"] <= found["peak_load"]
    first = [row for row in broken(tmp_path) if row[0] == broken(tmp_path)[0][0]]
    places = np.array([[float(row[5]), float(row[6])] for row in first]) - [75.0, 25.0]
    # Damage starts on the ligament beside the hole.
    assert np.all(np.abs(places[:, 0]) < 15.0)
    assert np.abs(places[:, 1]).min() < 20.0


@pytest.mark.long
@pytest.mark.parametrize(
    ("scheme", "nx", "horizon", "steps"),
    [
        ("sub_horizons", 36, 2.015, 10),
        ("sub_horizons", 42, 3.015, 20),
        ("stress_points", 36, 3.015, 20),
        ("stress_points", 36, 2.015, 60),
        ("correspondence", 36, 3.015, 20),
        ("correspondence", 36, 2.015, 60),
        ("bond_associated", 36, 2.015, 60),
    ],
)
def test_a_crack_of_bonds_that_snap_runs_through(scheme, nx, horizon, steps, tmp_path):
    """No gradient carries the pull through bonds that lie across it and never reach their critical stretch.

    Stress points may leave a slack chain that turns into the pull, with bonds just below their critical stretch.
    """
    random = scheme == "stress_points"
    arguments = (f"scheme={scheme}", f"nx={nx}", f"horizon={horizon}", f"steps={steps}")
    G = 0.5 if scheme == "correspondence" else 0.0
    summary = results(PLATE, "law=brittle", f"G={G}", *arguments, output=tmp_path)
    found = summary["results"]
    assert abs(found["last_load"]) < (0.02 if random else 1e-6) * found["peak_load"]
    assert found["symmetry_error"] < (0.2 if random else 1e-6)
    assert summary["pieces"]["forces_left"] < (0.02 if random else 1e-6)
    assert random or summary["pieces"]["pieces"] >= 2


SNAPPING = ("law=brittle", "scheme=sub_horizons", "G=0", "nx=18", "horizon=2.015", "steps=4")
HEALING = ("effect=present", "steps=8", "pull=0.1")


@pytest.mark.long
@pytest.mark.parametrize(
    ("arguments", "several", "least"),
    [
        (("steps=8",), (2, 3, 4), 60),
        (SNAPPING, (3,), 20),
        (HEALING, (2,), 60),
    ],
)
def test_any_number_of_ranks_breaks_the_same_bonds(arguments, several, least, tmp_path):
    """Bonds past their stretch; in the second some that gradients on another rank tear, in the third some that heal."""
    rows = {}
    for ranks in (1, *several):
        results(PLATE, *arguments, output=tmp_path / str(ranks), ranks=ranks)
        rows[ranks] = [(row[0], row[2], row[3]) for row in broken(tmp_path / str(ranks))]
    assert len(rows[1]) > least
    assert all(rows[ranks] == rows[1] for ranks in several)


@pytest.mark.long
def test_a_restart_goes_on_with_the_same_bonds_and_fields(tmp_path):
    arguments = ("scheme=sub_horizons", "G=0", "steps=30")
    whole = results(PLATE, *arguments, output=tmp_path / "whole")["results"]
    case = plate_with_hole.case(scheme="sub_horizons", G=0.0, steps=30)
    stopped = dataclasses.replace(case, history={**case.history, "stop": Stop(0.22)})
    with pytest.raises(pd.Interrupted):
        pd.run(stopped, output=tmp_path / "part")
    checkpoint = tmp_path / "part" / "checkpoint.h5"
    assert summary(tmp_path / "part")["status"] == "enough"
    assert 0 < len(broken(tmp_path / "part")) < len(broken(tmp_path / "whole"))
    for ranks in (1, 2):
        rest = tmp_path / f"rest{ranks}"
        again = results(PLATE, *arguments, "--restart", checkpoint, output=rest, ranks=ranks)["results"]
        assert [row[:4:2] for row in broken(rest)] == [row[:4:2] for row in broken(tmp_path / "whole")]
        for name in ("displacement", "local_damage"):
            one, other = field(tmp_path / "whole", name), field(rest, name)
            assert np.abs(one - other).max() <= 1e-10 * np.abs(one).max()
        assert again["broken_bonds"] == whole["broken_bonds"]


def test_a_checkpoint_of_another_damage_is_refused(tmp_path):
    case = plate_with_hole.case(law="none", steps=1)
    pd.run(case, output=tmp_path)
    with pytest.raises(pd.CaseError, match="damage none, this has Brittle"):
        pd.run(plate_with_hole.case(law="brittle"), output=tmp_path, restart=tmp_path / "checkpoint.h5")


def strip(**changes):
    """Return a strip with a square piece that cracks cut free but for bonds across one side."""
    declared = {
        "particles": pd.Lattice((0.0, 0.0), (12.0, 6.0), 1.0),
        "horizon": 2.015,
        "material": pd.Hencky(E=100.0, nu=0.3),
        "scheme": pd.Correspondence(),
        "control": pd.Silling(0.5),
        "damage": pd.Brittle(pd.ConstantCritical(0.02)),
        "conditions": [
            pd.Displacement(pd.region.Slab("x", high=2.0), x=0.0, y=0.0),
            pd.Displacement(pd.region.Slab("x", low=10.0), x=0.6, y=0.0),
        ],
        "steps": pd.Steps(20),
        "history": {"force": pd.Reaction("x", pd.region.Slab("x", low=10.0)), "broken": pd.BrokenBonds()},
        "results": lambda h: {"force": h["force"][-1], "broken": h["broken"][-1], "peak": max(h["force"])},
    }
    return pd.Case(**(declared | changes))


def test_compression_breaks_nothing_but_bonds_that_it_lengthens(tmp_path):
    def pressed(by):
        end = pd.Displacement(pd.region.Slab("x", low=10.0), x=-by, y=0.0)
        return pd.run(strip(conditions=[strip().conditions[0], end]), output=tmp_path)

    # Bonds along the pressure shorten by 0.03, more than the critical stretch.
    found = pressed(0.25)
    assert found["force"] < 0.0
    assert found["broken"] == 0.0
    assert pressed(0.8)["broken"] > 0.0
    held = summary(tmp_path)["pieces"]
    assert held == {"pieces": 1, "lone_particles": 0, "forces_left": held["forces_left"]}
    assert held["forces_left"] > 0.1
    # Particles are numbered column by column: a bond to the same or the next column lies across.
    places = np.array([[x, y] for x in range(12) for y in range(6)]) + 0.5
    for row in broken(tmp_path):
        i, j = int(row[2]), int(row[3])
        along, across = np.abs(places[j] - places[i])
        assert np.hypot(along, across) == pytest.approx(float(row[4]))
        assert across >= along, f"the bond of {i} and {j} lies along the pressure"


def test_a_piece_comes_free_and_stays_where_it_is(tmp_path):
    """Two parallel planes of weak bonds: the middle of the strip loses both sides."""
    weak = pd.CriticalFunction(
        lambda length, middle: np.where(np.minimum(abs(middle[:, 0] - 4.5), abs(middle[:, 0] - 7.5)) < 1.2, 0.01, 1.0)
    )
    found = pd.run(strip(damage=pd.Brittle(weak)), output=tmp_path)
    assert abs(found["force"]) < 1e-5 * found["peak"]
    u = field(tmp_path, "displacement")
    assert np.abs(u).max() <= 0.6 * (1.0 + 1e-6)


@pytest.mark.parametrize("law", [pd.Brittle, pd.LinearSoftening])
def test_a_piece_that_comes_free_under_a_load_ends_the_run(law, tmp_path):
    """Springs that keep loose pieces in place carry no load: no equilibrium is left once the strip is apart."""
    right = pd.region.Slab("x", low=10.0)
    case = strip(
        conditions=[strip().conditions[0], pd.Force(right, x=30.0)],
        damage=law(pd.ConstantCritical(0.02)),
        steps=pd.Steps(5, smallest=0.1),
        history={"u": pd.Mean(pd.displacement, "x", right), "broken": pd.BrokenBonds()},
        results=None,
    )
    with pytest.raises(pd.SolveError, match="nothing holds a piece that has come free against its load"):
        pd.run(case, output=tmp_path)
    assert np.abs(history(tmp_path)["u"]).max() < 1.0


@pytest.mark.processors
@pytest.mark.parametrize("control", [pd.Silling(0.5), pytest.param(None, marks=pytest.mark.long)])
def test_what_is_kept_is_equilibrium_with_the_damage_that_is_kept(control, tmp_path):
    """Forces of the final damage and control balance in every step, also after sweeps with damage held."""
    free = ~(pd.region.Slab("x", high=2.0) | pd.region.Slab("x", low=10.0))

    class Unbalanced(pd.Quantity):
        """Norm of the internal forces where nothing is prescribed [force]."""

        def evaluate(self, solution):
            f = solution.internal_force[solution.select(free)]
            return float(np.sqrt(solution.sum((f**2).sum())))

    class Overstretched(pd.Quantity):
        """Largest stretch of a bond that is not broken over the one at which it breaks [-]."""

        def evaluate(self, solution):
            damage = solution.problem.damage
            over = damage.driving_values(solution.state) / damage.bonds.law.final
            return solution.largest(float(over[damage.bonds.intact].max()))

    case = strip(
        damage=pd.ExponentialSoftening(pd.ConstantCritical(0.02)),
        control=control,
        scheme=pd.Correspondence() if control else pd.SubHorizons(),
        steps=pd.Steps(12),
        history={**strip().history, "unbalanced": Unbalanced(), "over": Overstretched()},
    )
    pd.run(case, output=tmp_path)
    steps = summary(tmp_path)["steps"]
    assert any(step.get("sweeps") for step in steps)
    h = history(tmp_path)
    assert h["unbalanced"].max() < 1e-9 * h["force"].max()
    assert h["broken"][-1] > 0.0
    assert 0.5 < h["over"].max() < 1.0


@pytest.mark.long
@pytest.mark.processors
def test_bonds_that_heal_balance_with_their_present_stretch_also_where_newton_failed(tmp_path):
    free = ~(pd.region.Slab("x", high=0.0) | pd.region.Slab("x", low=plate_with_hole.LENGTH))

    class Unbalanced(pd.Quantity):
        """Largest internal force on a particle where nothing is prescribed [force]."""

        def evaluate(self, solution):
            f = solution.internal_force[solution.select(free)]
            return solution.largest(float(np.abs(f).max()))

    class Present(pd.Quantity):
        """Largest difference of an integrity from that of the present stretch, and whether a bond is past its end."""

        def evaluate(self, solution):
            damage = solution.problem.damage
            bonds = damage.bonds
            x = damage.driving_values(solution.state)
            T = bonds.law.phi(np.clip(x, 0.75, 1.0))
            off = np.abs(np.where(x < 0.75, 1.0, T) - bonds.phi)[bonds.intact].max()
            return solution.largest(float(off)) + solution.largest(float(x[bonds.intact].max() > 1.0))

    case = plate_with_hole.case(pull=0.1, steps=8, effect="present")
    history_of = {"force": case.history["force"], "unbalanced": Unbalanced(), "present": Present()}
    pd.run(dataclasses.replace(case, history=history_of, results=None, picture=None), output=tmp_path)
    left, h = summary(tmp_path), history(tmp_path)
    assert any(step.get("sweeps") for step in left["steps"])
    assert left["pieces"]["forces_left"] < 1e-9
    assert h["unbalanced"].max() < 1e-9 * h["force"].max()
    assert h["present"].max() < 1e-10


@pytest.mark.long
def test_two_cracks_meet(tmp_path):
    cracks = [pd.Segment((5.0, -1.0), (5.0, 2.1)), pd.Segment((7.0, 3.9), (7.0, 7.0))]
    far = [strip().conditions[0], dataclasses.replace(strip().conditions[1], x=2.0)]
    found = pd.run(strip(cracks=cracks, conditions=far), output=tmp_path)
    assert abs(found["force"]) < 1e-5 * found["peak"]
    assert found["broken"] > 0


def test_unloading_follows_the_secant_and_reloading_comes_back(tmp_path):
    """Two springs in series, one softened at the top: less stiff by its integrity on the way down and up again."""
    case = one_bond(4.0)
    schedule = pd.Table([0.0, 0.4, 0.6, 1.0], [0.0, 0.03, 0.0, 0.035])
    right = dataclasses.replace(case.conditions[1], x=1.0, schedule=schedule)
    pulled = dataclasses.replace(case, solver=pd.Newton(), steps=pd.Steps(20), conditions=[case.conditions[0], right])
    pd.run(pulled, output=tmp_path)
    h = history(tmp_path)
    u, force, top = h["displacement"], h["force"], 8
    down = slice(top, 13)
    assert np.allclose(force[down], force[top] * u[down] / u[top], atol=1e-8)
    again = (np.arange(len(u)) > 12) & (u <= u[top] * (1.0 - 1e-9))
    assert np.allclose(force[again], force[top] * u[again] / u[top], atol=1e-8)
    assert force[-1] < force[top]
    assert h["dissipated"][12] == pytest.approx(h["dissipated"][top])
    assert h["dissipated"][-1] > h["dissipated"][top]


def test_protected_bonds_do_not_fail(tmp_path):
    everywhere = pd.Brittle(pd.ConstantCritical(0.02), protected=pd.region.All())
    assert pd.run(strip(damage=everywhere), output=tmp_path)["broken"] == 0.0


@pytest.mark.long
@pytest.mark.parametrize("a", [3.0, 5.0])
def test_a_centre_crack_grows_at_the_load_of_griffith(a, tmp_path):
    found = results("runs/fracture/centre_crack.py", "law=brittle", "n=20", f"a={a}", output=tmp_path)["results"]
    assert found["ratio"] == pytest.approx(1.0, abs=0.05)
    # It runs along the ligaments in its own plane.
    places = np.array([[float(row[5]), float(row[6])] for row in broken(tmp_path)])
    assert np.abs(places[:, 1] - 20.0).max() < 5.0


@pytest.mark.parametrize(("n", "within"), [(10, 0.1), pytest.param(20, 0.05, marks=pytest.mark.long)])
def test_an_edge_crack_grows_at_the_load_of_griffith_and_straight(n, within, tmp_path):
    found = results("runs/fracture/edge_crack.py", "law=brittle", f"n={n}", output=tmp_path)["results"]
    assert found["ratio"] == pytest.approx(1.0, abs=within)
    assert found["straightness"] < 0.6


@pytest.mark.long
def test_a_double_cantilever_opens_as_beams_do(tmp_path):
    found = results("runs/fracture/double_cantilever.py", "n=10", output=tmp_path)["results"]
    assert found["stiffness"] == pytest.approx(1.0, abs=0.05)
    assert found["first_load"] == pytest.approx(1.0, abs=0.15)


@pytest.mark.long
def test_energy_balances_while_bonds_soften(tmp_path):
    """One softening bond: what is not stored is dissipated, to 1e-6 of the work with small steps."""
    case = dataclasses.replace(one_bond(4.0), solver=pd.Newton(), steps=pd.Steps(400))
    history_of = {**case.history, "work": pd.ExternalWork()}
    pd.run(dataclasses.replace(case, history=history_of), output=tmp_path)
    h = history(tmp_path)
    # The steps meet the ends of the law, so that force and displacement are linear between them.
    assert np.abs(h["work"] - h["energy"] - h["dissipated"]).max() < 1e-6 * h["work"][-1]
    assert np.all(np.diff(h["dissipated"]) > -1e-15)


@pytest.mark.long
def test_a_wide_step_of_many_bonds_and_a_narrow_one_of_each_end_alike(tmp_path):
    """From one bond at a time to thousands at once."""
    found = {}
    for most in (1, 5000):
        case = dataclasses.replace(
            plate_with_hole.case(law="brittle"), steps=pd.Steps(5, bonds_at_once=most), fields=[]
        )
        found[most] = pd.run(dataclasses.replace(case, picture=None), output=tmp_path)
        assert abs(found[most]["last_load"]) < 1e-3 * found[most]["peak_load"]
        assert found[most]["symmetry_error"] < 1e-6
    assert found[1]["broken_bonds"] < found[5000]["broken_bonds"]


@pytest.mark.long
def test_a_closed_crack_carries_compression(tmp_path):
    """A bar of bonds that snap is pulled apart and pressed: as stiff as it was, but for nothing that is pulled."""
    ends = pd.region.Slab("x", high=2.0), pd.region.Slab("x", low=10.0)
    path = pd.Table((0.0, 0.4, 0.5, 1.0), (0.0, 0.3, 0.0, -0.1))

    def pressed(closes, kinematics, law):
        damage = law(pd.ConstantCritical(0.01), closes=closes, protected=pd.region.Slab("x", high=5.0))
        case = strip(
            particles=pd.Lattice((0.0, 0.0), (12.0, 4.0), 1.0), scheme=None, control=None, damage=damage,
            material=pd.BondBased(E=100.0, kinematics=kinematics), steps=pd.Steps(20),
            conditions=[
                pd.Displacement(ends[0], x=0.0, y=0.0), pd.Displacement(ends[1], x=1.0, y=0.0, schedule=path)
            ],
        )  # fmt: skip
        history_too = {**case.history, "energy": pd.StrainEnergy()}
        pd.run(dataclasses.replace(case, history=history_too, results=None), output=tmp_path)
        return history(tmp_path)

    intact = pressed(False, "small", lambda *args, **more: None)
    for kinematics, law in (("small", pd.Brittle), ("finite", pd.Brittle), ("small", pd.LinearSoftening)):
        h = pressed(True, kinematics, law)
        apart = np.argmin(np.abs(h["t"] - 0.4))
        assert h["broken"][apart] > 4
        assert abs(h["force"][apart]) < 1e-6 * h["force"].max()
        # Bonds across the pressure are pulled by it where the bar is whole; they were broken and are missing.
        assert h["force"][-1] == pytest.approx(intact["force"][-1], rel=0.1)
        assert h["energy"][-1] == pytest.approx(-0.5 * h["force"][-1] * 0.1, rel=0.02)
    open_ = pressed(False, "small", pd.Brittle)
    assert abs(open_["force"][-1]) < 0.01 * abs(intact["force"][-1])


def test_cracks_that_close_have_exact_tangents_and_are_refused_where_they_cannot(rng, tmp_path):
    law = pd.LinearSoftening(pd.ConstantCritical(0.02), 3.0, closes=True)
    for dim, kinematics in itertools.product(DIMS, ("small", "finite")):
        model = bond_body(dim, pd.BondBased(E=10.0, kinematics=kinematics), rng=rng, damage=law)
        pull = 0.035 * (model.cloud.x - model.cloud.x.mean(axis=0)) + 0.002 * rng.standard_normal(model.cloud.x.shape)
        model.soften(pull)
        model.break_bonds(2.0 * pull, {1: 1, 2: 8, 3: 30}[dim])
        # Along one direction longer, along the others shorter than at the start.
        u = pull * ([1.1] + [-0.5] * (dim - 1)) if dim > 1 else -pull
        e = model.elongation(u)
        assert np.any((e < 0.0) & (model.failure.phi < 1.0))
        K = dense_tangent(model, u)
        assert np.abs(K - K.T).max() < 1e-12 * np.abs(K).max()
        columns = rng.choice(u.size, min(8, u.size), replace=False)
        assert np.abs(K[:, columns] - differences(model, u, columns)).max() < 1e-6 * np.abs(K).max()
        assert not model.material_term.linear
    for changes, why in (
        ({}, "requires bond-based materials"),
        ({"material": pd.LinearSolid(E=1.0, nu=0.2), "scheme": None, "control": None}, "requires bond-based materials"),
        (
            {"material": pd.BondBased(E=1.0), "scheme": None, "control": None, "solver": pd.EventDriven()},
            "not linear between failures",
        ),
    ):
        with pytest.raises(pd.CaseError, match=why):
            pd.run(strip(damage=law, **changes), output=tmp_path)


def hinge_peak(E, strength, Gf, width, ligament, span, share=0.25, kink=0.75, last=5.0):
    """Return the peak load of a notched beam whose ligament opens as a hinge of half its depth with a cohesive crack.

    Stresses over the ligament are elastic, ``E phi (y - y0) / s`` with the hinge of length s turned by phi, or those of
    the bilinear law where they exceed the strength; y0 lets them sum to zero.
    """
    s = 0.5 * ligament
    y = (np.arange(400) + 0.5) / 400.0 * ligament
    w = np.linspace(0.0, 0.2, 4001)
    cohesive = np.interp(w * strength / Gf, [0.0, kink, last, 1e9], [strength, share * strength, 0.0, 0.0])
    elongation = cohesive * s / E + w  # of the hinge, ascending where the law is not steeper than the hinge is stiff
    assert np.all(np.diff(elongation) > 0.0)
    peak = 0.0
    for phi in np.linspace(1e-5, 2e-3, 200):
        low, high = 0.0, ligament
        for _ in range(40):
            y0 = 0.5 * (low + high)
            e = phi * (y - y0)
            stress = np.where(E * e / s <= strength, E * e / s, np.interp(e, elongation, cohesive))
            low, high = (y0, high) if stress.sum() > 0.0 else (low, y0)
        peak = max(peak, 4.0 * width * (stress * (y - y0)).mean() * ligament / span)
    return peak


@pytest.mark.long
def test_concrete_beams_peak_where_a_cohesive_hinge_does_and_in_the_tests(tmp_path):
    found = results("runs/fracture/gregoire_beam.py", "n=20", "step=0.008", "end=0.06", output=tmp_path / "three")
    assert found["results"]["peak_load"] == pytest.approx(hinge_peak(37e3, 3.9, 0.1432, 50.0, 25.0, 125.0), rel=0.05)
    found = results("runs/fracture/mixed_mode_beam.py", "n=16", "end=0.04", output=tmp_path / "mixed")
    assert 4894.0 < found["results"]["peak_load"] < 5405.0
