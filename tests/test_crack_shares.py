"""What a running crack takes of a fracture energy: which measured share a case gets, and what is said without one."""

import dataclasses
import json

import numpy as np
import pytest

import pdpetsc as pd
from pdpetsc.command_line.cli import arguments_of, load_case
from pdpetsc.output.report import write_report
from pdpetsc.running.crack_shares import LAWS, MEASURED, crack_share
from tests.commands import ROOT, results

GC = 0.05


def strip(material=None, law=None, horizon=3.015, dx=0.5, **changes):
    """Return a strip of bonds by default."""
    material = pd.BondBased(1000.0, plane="stress") if material is None else material
    case = pd.Case(
        particles=pd.Lattice((0.0, 0.0), (12.0 * dx, 8.0 * dx), dx), horizon=horizon * dx, material=material,
        damage=pd.Brittle(pd.FractureEnergy(GC)) if law is None else law,
        conditions=[
            pd.Displacement(pd.region.Slab("x", high=dx), x=0.0, y=0.0),
            pd.Displacement(pd.region.Slab("x", low=11.0 * dx), x=1e-4 * dx),
        ],
        history={"broken": pd.BrokenBonds()},
    )  # fmt: skip
    return dataclasses.replace(case, **changes)


def gradients(nu=0.25, plane="stress", E=1000.0, **changes):
    given = {"scheme": pd.Correspondence(), "control": pd.Silling(0.5)}
    law = pd.LinearSoftening(pd.FractureEnergy(GC), 3.0)
    return strip(pd.LinearElastic(E, nu, plane=plane), law, **(given | changes))


def limits(case):
    found = pd.prepare(case).problem.damage.limit
    return np.sort(found[np.isfinite(found)])


def with_share(case, share):
    criterion = dataclasses.replace(case.damage.criterion, share=share)
    return dataclasses.replace(case, damage=dataclasses.replace(case.damage, criterion=criterion))


@pytest.mark.parametrize("row", MEASURED, ids=lambda row: f"{row.model}-{row.law}-{row.horizon}-{row.nu[0]:.2f}")
def test_the_strip_that_measured_a_share_gets_it(row):
    """The command of a row makes the case that the row is of; with the share left out the case has the same bonds."""
    arguments = dict(one.split("=") for one in row.command.split() if "=" in one)
    path = "runs/fracture/surfing.py"
    assert path in row.command
    function = load_case(ROOT / path)
    given = function(**arguments_of(function, {**arguments, "n": "10"}))
    assumed = function(**arguments_of(function, {**arguments, "n": "10", "share": "0"}))
    assert crack_share(given) is None
    found = crack_share(assumed)
    assert found.share == pytest.approx(row.share, rel=1e-12)
    assert found.within == row.within
    assert not found.grave
    assert f"{row.share:g}" in found.said
    np.testing.assert_allclose(limits(assumed), limits(given), rtol=1e-13)


def test_no_two_rows_are_of_one_case():
    for row in MEASURED:
        alike = [one for one in MEASURED if (one.model, one.law, one.horizon) == (row.model, row.law, row.horizon)]
        assert sum(one.nu[0] <= np.mean(row.nu) <= one.nu[1] for one in alike) == 1
        assert row.law in LAWS
        assert 0.0 < row.within < 0.1


def test_bonds_have_the_energy_over_the_share_and_a_share_that_is_given_wins():
    case = strip()
    found = crack_share(case)
    np.testing.assert_allclose(limits(with_share(case, 1.0)), np.sqrt(found.share) * limits(case), rtol=1e-12)
    given = with_share(case, 0.7)
    assert crack_share(given) is None
    np.testing.assert_allclose(limits(given), np.sqrt(1.0 / 0.7) * limits(with_share(case, 1.0)), rtol=1e-12)
    assert crack_share(strip(law=pd.Brittle(pd.ConstantCritical(0.01)))) is None
    assert crack_share(strip(law=None, damage=None)) is None


def test_the_share_is_the_same_in_other_units():
    case = gradients()
    small = dataclasses.replace(
        gradients(E=1e9), particles=pd.Lattice((0.0, 0.0), (6e-3, 4e-3), 5e-4), horizon=3.015 * 5e-4
    )
    assert crack_share(small).share == crack_share(case).share == 0.365


@pytest.mark.parametrize("made", [lambda E, nu, plane: gradients(nu, plane, E), lambda E, nu, plane: strip(
    pd.LinearSolid(E, nu, plane=plane), pd.LinearSoftening(pd.FractureEnergy(GC), 3.0))])  # fmt: skip
def test_plane_strain_breaks_at_the_stretch_of_the_same_body_in_plane_stress(made):
    """Plane strain is plane stress with E / (1 - nu^2) and nu / (1 - nu): the same crack takes the same energy."""
    nu = 0.2
    strain = made(1000.0, nu, "strain")
    stress = made(1000.0 / (1.0 - nu**2), nu / (1.0 - nu), "stress")
    assert crack_share(strain).share is not None
    np.testing.assert_allclose(limits(strain), limits(stress), rtol=1e-12)


@pytest.mark.parametrize(
    ("case", "why"),
    [
        (gradients(horizon=2.515), "horizon of 2.515 spacings"),
        (gradients(nu=0.275), "Poisson's ratio that is 0.275"),
        (gradients(control=pd.Silling(0.4)), "not measured for this material, scheme"),
        (gradients(control=None), "not measured for this material, scheme"),
        (gradients(scheme=pd.SubHorizons(), control=None), "not measured for this material, scheme"),
        (gradients(influence=pd.influence.Linear()), "not measured for this material, scheme"),
        (gradients(damage=pd.LinearSoftening(pd.FractureEnergy(GC), 2.5)), "LinearSoftening with these numbers"),
        (gradients(damage=pd.LinearSoftening(pd.FractureEnergy(GC), 3.0, effect=pd.PresentStretch())), "these numbers"),
        (gradients(damage=pd.ExponentialSoftening(pd.FractureEnergy(GC))), "correspondence with exponential"),
        (gradients(damage=pd.LinearSoftening(pd.BondEnergy(Gc=GC), 3.0)), "not for BondEnergy"),
        (gradients(damage=pd.DamageOf({"a": pd.region.All()}, {"a": pd.Brittle(pd.FractureEnergy(GC))})), "DamageOf"),
        (gradients(particles=pd.Arrays(np.zeros((1, 2)), np.ones(1))), "square lattices alone"),
    ],
)  # fmt: skip
def test_what_was_not_measured_has_no_share(case, why):
    found = crack_share(case)
    assert found.share is None
    assert found.grave
    assert why in found.said
    assert found.record["known"] is False


def test_a_share_that_nobody_knows_is_said_before_after_and_on_record(tmp_path, caplog):
    """Of gradients by warnings; of bonds, which are never far from one plane, by a line of the log."""

    def warned(case, name):
        caplog.clear()
        caplog.set_level("INFO", logger="pdpetsc")
        pd.run(case, tmp_path / name)
        record = json.loads((tmp_path / name / "summary.json").read_text()).get("fracture_energy")
        of = [one for one in caplog.records if "fracture energy" in one.getMessage()]
        return record, [one for one in of if one.levelname == "WARNING"], of

    record, warnings, _ = warned(gradients(scheme=pd.SubHorizons(), control=None), "unknown")
    assert record["share"] is None
    assert not record["known"]
    assert len(warnings) == 2
    assert warnings[1].getMessage().startswith("What the cracks of this run took is not known.")
    assert "takes another one" in write_report(tmp_path / "unknown").read_text()
    record, warnings, said = warned(gradients(), "known")
    assert record["share"] == 0.365
    assert record["known"]
    assert not warnings
    assert len(said) == 1
    record, warnings, said = warned(strip(horizon=2.515), "bonds")
    assert not record["known"]
    assert not warnings
    assert len(said) == 1
    record, warnings, said = warned(with_share(gradients(), 0.5), "given")
    assert record is None
    assert not said


@pytest.mark.long
@pytest.mark.parametrize("law", ["linear", "brittle"])
def test_a_crack_that_runs_takes_the_fracture_energy_without_a_share(law, tmp_path):
    """By the balance of work and stored energy over whole spacings, as well as the share is known."""
    found = results("runs/fracture/surfing.py", f"law={law}", "share=0", output=tmp_path)["results"]
    within = next(row.within for row in MEASURED if (row.model, row.law, row.horizon) == ("bonds", law, 3.015))
    assert found["taken_over_Gc"] == pytest.approx(1.0, abs=within)
    assert found["steady"] < 0.01
