"""Factors that are kept while damage is held."""

import numpy as np
import pytest

import pdpetsc as pd
from pdpetsc.petsc.matrix import TangentMatrix

MATERIALS = {"symmetric": pd.BondBased(E=1000.0), "unsymmetric": pd.LinearElastic(1000.0, 0.3, plane="stress")}


def strip(material, **options):
    """Return a notched strip whose ends are pulled apart until its bonds soften, by load steps."""
    bonds = pd.LinearSoftening(pd.ConstantCritical(0.01), 3.0)
    return pd.Case(
        particles=pd.Lattice((0.0, 0.0), (12.0, 8.0), 1.0),
        horizon=2.015,
        material=MATERIALS[material],
        control=None if material == "symmetric" else pd.Silling(1.0),
        cracks=[pd.Segment((6.0, -1.0), (6.0, 2.5))],
        damage=bonds,
        conditions=[
            pd.Displacement(pd.region.Slab("x", high=2.0), x=0.0, y=0.0),
            pd.Displacement(pd.region.Slab("x", low=10.0), x=0.2, y=0.0),
        ],
        steps=pd.Steps(4),
        options=options,
        history={"force": pd.Reaction("x", pd.region.Slab("x", high=2.0)), "broken": pd.BrokenBonds()},
        fields=[],
    )


@pytest.mark.parametrize("material", MATERIALS)
def test_kept_factors_give_the_results_of_new_ones(material, tmp_path, monkeypatch):
    filled = []
    fill = TangentMatrix.update

    def counted(self, *args):
        filled.append(1)
        fill(self, *args)

    monkeypatch.setattr(TangentMatrix, "update", counted)
    found, counts = [], []
    for name, options in {"kept": {}, "new": {"ksp_type": "preonly"}}.items():
        filled.clear()
        pd.run(strip(material, **options), output=tmp_path / name)
        with open(tmp_path / name / "history.csv") as file:
            found.append(np.genfromtxt(file, delimiter=",", names=True))
        counts.append(len(filled))
    kept, new = found
    assert new["broken"][-1] > 10.0
    assert np.array_equal(kept["broken"], new["broken"])
    assert np.allclose(kept["force"], new["force"], rtol=0.0, atol=1e-8 * np.abs(new["force"]).max())
    assert counts[0] < 0.7 * counts[1]
