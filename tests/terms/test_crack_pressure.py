"""Pressure on the faces of cracks of failing points: tangent, balance, opening, refusal."""

import numpy as np
import pytest

import pdpetsc as pd
from pdpetsc.problem.problem import Problem
from pdpetsc.problem.supports import Supports
from pdpetsc.terms.crack_pressure import CrackPressureLoad
from tests.commands import results
from tests.scenes import MATERIALS, SCHEMES, Small, damaged_body, dense_tangent, displacement

CASE = "runs/fracture/pressurised_crack.py"
STEP = 1e-6


def pressed(dim, name, rng, scheme="correspondence"):
    """Return a small body whose points fail, with a pressure in its cracks."""
    law = pd.PointDamage(pd.softening.Linear(), Gc=0.2, onset=0.02)
    model = damaged_body(dim, law, SCHEMES[scheme], pd.Silling(0.5), MATERIALS[name], rng)
    problem, cloud = model.problem, model.cloud
    declared = pd.CrackPressure(pd.region.All(), lambda x, t: 0.5 + 0.1 * x[:, 0])
    term = CrackPressureLoad(problem.damage, declared, np.ones(cloud.n_owned, dtype=bool), "fluid")
    rest = [one for one in problem.terms if one is not problem.material_term]
    whole = Problem(problem.body, problem.material_term, [*rest, term], Supports(problem.body), problem.damage)
    return Small(whole), term


def force(problem, u, terms=None):
    state = problem.state(u)
    f = np.zeros((problem.body.cloud.n_local, problem.dim))
    for term in problem.terms if terms is None else terms:
        term.add_force(state, f)
    return problem.body.gather(f)


@pytest.mark.parametrize("held", [True, False])
@pytest.mark.parametrize("name", ["linear_elastic", "hencky"])
@pytest.mark.parametrize(
    "dim, scheme", [(1, "correspondence"), (2, "correspondence"), (2, "sub_horizons"), (3, "correspondence")]
)
def test_the_tangent_is_that_of_differences(dim, scheme, name, held, rng):
    model, _ = pressed(dim, name, rng, scheme)
    problem = model.problem
    u = displacement(model, rng, 0.06)
    problem.soften(problem.state(0.8 * u))
    problem.damage.keep(None)
    problem.freeze(held)
    driven = problem.damage.driven(problem.state(u))
    assert driven.fails.any() != held and (driven.phi < 1.0).any()
    K, columns = dense_tangent(model, u), rng.choice(u.size, min(12, u.size), replace=False)
    found = []
    for column in columns:
        d = np.zeros(u.size)
        d[column] = STEP
        d = d.reshape(u.shape)
        found.append((force(problem, u + d) - force(problem, u - d)).ravel() / (2.0 * STEP))
    assert K[:, columns] == pytest.approx(np.array(found).T, abs=2e-6 * np.abs(K).max())


@pytest.mark.parametrize("name", ["linear_elastic", "hencky"])
def test_forces_and_moments_balance(name, rng):
    model, term = pressed(2, name, rng)
    problem, u = model.problem, displacement(model, rng, 0.06)
    problem.soften(problem.state(u))
    f = force(problem, u, [term])
    assert np.abs(f).max() > 1e-3
    assert f.sum(axis=0) == pytest.approx(0.0, abs=1e-12)
    # Of a small strain about the undeformed places.
    x = model.cloud.x[: model.cloud.n_owned] + (u if name == "hencky" else 0.0)
    assert (x[:, 0] * f[:, 1] - x[:, 1] * f[:, 0]).sum() == pytest.approx(0.0, abs=1e-11)


def test_a_crack_opens_as_in_closed_form(tmp_path):
    """With 12 cells over the crack; the volume converges from below."""
    assert results(CASE, "n=60", "half=1", output=tmp_path)["results"]["volume_over_exact"] == pytest.approx(
        1.0, abs=0.03
    )


@pytest.mark.long
def test_the_opening_of_a_crack_converges(tmp_path):
    coarse, fine = (
        results(CASE, f"n={n}", output=tmp_path / str(n))["results"]["volume_over_exact"] for n in (120, 240)
    )
    assert coarse < fine < 1.0
    assert fine == pytest.approx(1.0, abs=0.025)


def test_ranks_alike(tmp_path):
    one, two = (results(CASE, "n=30", output=tmp_path / str(n), ranks=n)["results"] for n in (1, 2))
    assert two["volume_over_exact"] == pytest.approx(one["volume_over_exact"], rel=1e-9)


def test_cracks_of_broken_bonds_have_no_such_pressure(tmp_path):
    case = pd.Case(
        particles=pd.LatticeNodes((0.0, 0.0), (1.0, 1.0), 0.25),
        material=pd.Hencky(E=1.0, nu=0.2),
        conditions=[pd.Clamp("-x"), pd.CrackPressure(pd.region.All(), 1.0)],
    )
    with pytest.raises(pd.CaseError, match="Declare damage by PointDamage"):
        pd.run(case, tmp_path)


@pytest.mark.parametrize("name", ["linear_elastic", "hencky"])
def test_the_mean_stress_of_a_cell_includes_the_fluid(name, tmp_path):
    """Wherever the edge of the cell cuts the crack."""
    found = []
    for k, at in enumerate((0.0, -0.5)):
        case = pd.Case(
            particles=pd.Lattice((-0.5, -0.5), (0.5, 0.5), 0.1),
            cell=pd.Cell((-0.5, -0.5), (0.5, 0.5)),
            horizon=0.2015,
            material=MATERIALS[name],
            damage=pd.PointDamage(pd.softening.Linear(), Gc=1.0, onset=0.1, cracks=[pd.Segment((-0.2, at), (0.2, at))]),
            conditions=[
                pd.CrackPressure(pd.region.All(), 1e-3 * MATERIALS[name].E),
                pd.PointSupport(pd.region.All(), x=0.0, y=0.0),
                pd.MeanStress(xx=0.0, yy=2e-4 * MATERIALS[name].E, xy=0.0),
            ],
            steps=pd.Steps(1),
            history={"stress": pd.CellStress("yy"), "strain": pd.CellStrain("yy")},
        )
        found.append(pd.run(case, tmp_path / str(k)).history)
    for history in found:
        assert history["stress"][-1] == pytest.approx(2e-4 * MATERIALS[name].E, rel=1e-6)
    assert found[1]["strain"][-1] == pytest.approx(found[0]["strain"][-1], rel=1e-6)
