"""Runs say where their zero-energy control carries what the material should."""

import dataclasses
import math

import pytest

import pdpetsc as pd
from pdpetsc.running.stabilisation_energy import largest_share
from tests.commands import summary
from tests.material.test_plastic_laws import runaway

PERFECT = pd.KinematicJ2(100.0, 0.3, plane="stress", yield_stress=1.0)


def step(t, strain, control):
    return {"t": t, "energies": {"strain": strain, "control": control}}


def test_the_largest_share_is_that_of_steps_that_store_energy():
    family_strain = [step(0.5, 0.9, 0.1), step(1.0, 1e-30, 5e-30)]
    assert largest_share(family_strain) == {"share": pytest.approx(0.1), "t": 0.5, "note": ""}
    much = largest_share([*family_strain, step(0.7, 0.6, 0.3), {"t": 0.8}, step(0.9, math.nan, 1.0)])
    assert (much["share"], much["t"]) == (pytest.approx(1.0 / 3.0), 0.7)
    assert "stores 33 % of the energy at step time 0.7" in much["note"]
    assert largest_share([]) == {"share": 0.0, "t": 0.0, "note": ""}


@pytest.mark.processors
@pytest.mark.parametrize("size", [1.0, 2.0**-30], ids=["as it is", "in another unit of force"])
def test_a_strip_whose_control_bends_with_it_is_said_to_hang_on_it(size, tmp_path, caplog):
    """An end is moved across a strip three particles high, whose stiff control carries most of the bending."""
    material = dataclasses.replace(PERFECT, E=100.0 * size, yield_stress=size)
    pulled = runaway(material, 0.95 * size)
    across = pd.Displacement(pd.region.Slab("x", low=9.0), y=0.5)
    bent = dataclasses.replace(pulled, control=pd.Silling(20.0), conditions=[*pulled.conditions[:2], across])
    with caplog.at_level("WARNING"):
        found = pd.run(bent, tmp_path / "bent")
    note = found.summary["control"]["note"]
    assert "The zero-energy control stores" in note and note in caplog.text
    assert summary(tmp_path / "bent")["control"]["share"] > 0.4
    below = pd.run(pulled, tmp_path / "below")
    assert below.summary["control"]["note"] == ""
    assert below.summary["control"]["share"] < 0.05


@pytest.mark.processors
def test_a_control_that_follows_the_material_carries_nothing_in_its_place(tmp_path):
    case = dataclasses.replace(runaway(PERFECT, 1.2), control=pd.TangentScaled(pd.Silling(0.5)))
    with pytest.raises(pd.SolveError, match="above the limit load of the body"):
        pd.run(case, tmp_path)


def test_what_has_no_control_records_none(tmp_path):
    case = dataclasses.replace(runaway(PERFECT, 0.5), control=None, scheme=pd.SubHorizons())
    summary = pd.run(case, tmp_path).summary
    assert "control" not in summary
    assert all("energies" not in one for one in summary["steps"])
