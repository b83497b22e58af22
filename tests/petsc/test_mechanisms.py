"""A body that moves without force has no unique equilibrium, whatever solver meets it."""

import re

import numpy as np
import pytest

import pdpetsc as pd
from tests.commands import called

LAW = pd.LinearElastic(E=1000.0, nu=0.3)


def sheared(horizon=1.015, n=8, dim=2, along="x", **fields):
    """Return a block whose upper layer is moved, along the lower one where nothing else is asked for.

    Bonds of nearest neighbours have no force against that: each layer between slides as it likes.
    """
    low, high = pd.region.Slab("y", high=1.0), pd.region.Slab("y", low=n - 1.0)
    still = dict.fromkeys("xyz"[:dim], 0.0)
    return pd.Case(
        particles=pd.Lattice((0.0,) * dim, (float(n),) * dim, 1.0),
        horizon=horizon,
        conditions=[pd.Displacement(low, **still), pd.Displacement(high, **(still | {along: 0.01}))],
        history={"force": pd.Reaction("x", high)},
        fields=[],
        **({"material": pd.BondBased(E=1000.0)} | fields),
    )


BRITTLE = pd.Brittle(pd.ConstantCritical(1.0))
REFUSED = {
    "factor": {},
    "factor that replaces null pivots": {"damage": BRITTLE},
    "algebraic multigrid": {"options": {"pc_type": "gamg"}},
    "no matrix": {"options": {"pd_jacobian": "matfree"}},
    "unsymmetric iterations": {"options": {"pd_jacobian": "matfree", "ksp_type": "gmres"}},
    "unsymmetric factor": {"damage": BRITTLE, "options": {"pc_type": "lu"}},
    "path": {
        "damage": BRITTLE,
        "solver": pd.PathFollowing(pd.Opening("x", pd.region.Slab("y", low=7.0), step=0.1, end=0.2)),
    },
    "events": {"damage": BRITTLE, "solver": pd.EventDriven()},
    "space": {"dim": 3, "n": 4},
}


@pytest.mark.parametrize("how", REFUSED)
def test_a_mechanism_is_refused_with_a_particle_that_moves(how, tmp_path):
    case = sheared(**REFUSED[how])
    with pytest.raises(pd.SolveError, match="the equilibrium is not unique") as caught:
        pd.run(case, output=tmp_path)
    place = [float(x) for x in re.search(r"particle at \((.*?)\)", str(caught.value))[1].split(", ")]
    n = 4 if how == "space" else 8
    assert 1.0 < place[1] < n - 1.0


def test_all_ranks_refuse_it_with_one_sentence(tmp_path):
    case = tmp_path / "sheared.py"
    case.write_text("from tests.petsc.test_mechanisms import sheared\n\n\ndef case():\n    return sheared()\n")
    done = called(case, "-o", tmp_path / "out", ranks=2)
    assert done.returncode == 1
    assert done.stderr.count("the equilibrium is not unique") == 1


def halves(contrast):
    return [
        (pd.region.Slab("x", high=4.0), LAW),
        (pd.region.Slab("x", low=4.0), pd.LinearElastic(E=1000.0 * contrast, nu=0.3)),
    ]


HELD = {
    "longer bonds": {"horizon": 1.5},
    "no control": {"horizon": 2.015, "material": LAW, "scheme": pd.Correspondence()},
    "no control, nearest neighbours": {"material": LAW, "scheme": pd.Correspondence()},
    "weak control": {"horizon": 2.015, "material": LAW, "scheme": pd.Correspondence(), "control": pd.Silling(1e-6)},
    "nearly incompressible": {
        "horizon": 2.015,
        "material": pd.LinearElastic(E=1.0, nu=0.499999),
        "scheme": pd.SubHorizons(),
    },
    "contrast": {"horizon": 2.015, "material": halves(1e-6), "scheme": pd.SubHorizons()},
}


@pytest.mark.parametrize("options", [{}, {"pd_jacobian": "matfree", "ksp_max_it": 5000}])
@pytest.mark.parametrize("how", HELD)
def test_soft_bodies_are_no_mechanisms(how, options, tmp_path):
    pd.run(sheared(**HELD[how], options=options), output=tmp_path)


@pytest.mark.parametrize("options", [{}, {"pd_jacobian": "matfree"}])
def test_a_long_bar_is_no_mechanism(options, tmp_path):
    """Its smallest eigenvalue over the diagonal is about 7e-9."""
    n = 20_000
    ends = [pd.Displacement(pd.region.Nearest((0.5,)), x=0.0), pd.Force(pd.region.Nearest((n - 0.5,)), x=1.0)]
    case = pd.Case(
        particles=pd.Lattice((0.0,), (float(n),), 1.0), horizon=2.015, material=pd.BondBased(E=1.0), conditions=ends,
        fields=[], options=options,
    )  # fmt: skip
    pd.run(case, output=tmp_path)


def test_bodies_that_have_come_apart_do_not_end_a_run(tmp_path):
    """Bonds break at the first step until no force is left but that of the soft springs on loose particles."""
    law = pd.Brittle(pd.ConstantCritical(1e-4))
    result = pd.run(sheared(horizon=1.5, along="y", damage=law), output=tmp_path)
    assert result.summary["steps"][0]["broken_bonds"] > 20
    assert np.abs(result.history["force"][-1]) < 1e-12
