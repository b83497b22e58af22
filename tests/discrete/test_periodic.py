"""Periodic cells: exact patch test for every method and any periodic directions, on any rank count."""

import itertools

import numpy as np
import pytest

import pdpetsc as pd
from tests.commands import field, jacobian_ratios, printed, results, summary
from tests.pairs import pairs
from tests.scenes import SCHEMES

CELL = "runs/patch/cell.py"
AXES = {1: ["x"], 2: ["x", "xy"], 3: ["x", "xz", "xyz"]}


@pytest.mark.parametrize(
    ("where", "scheme", "prescribed"),
    pairs([(dim, axes) for dim in AXES for axes in AXES[dim]], pd.SCHEMES, ["stress", "strain"]),
)
def test_mean_stress_and_strain_give_the_exact_uniform_gradient(where, scheme, prescribed, tmp_path):
    dim, axes = where
    for horizon in (2.015,) if dim == 3 else (1.015, 3.015):
        arguments = (f"dim={dim}", f"axes={axes}", f"scheme={scheme}", f"prescribed={prescribed}", f"horizon={horizon}")
        found = results(CELL, *arguments, "G=0.5", output=tmp_path)["results"]
        assert found["max_F_error"] < 1e-10
        assert found["strain_error"] < 1e-10
        assert found["stress_error"] < 1e-9


@pytest.mark.parametrize(
    ("dim", "axes", "ranks"),
    [
        *((1, "x", 1), (2, "x", 1), (2, "xy", 2), (3, "xy", 1)),
        *(pytest.param(1, "x", ranks, marks=pytest.mark.long) for ranks in (2, 3)),
        *(pytest.param(2, "x", ranks, marks=pytest.mark.long) for ranks in (2, 3)),
        *(pytest.param(2, "xy", ranks, marks=pytest.mark.long) for ranks in (1, 3)),
        *(pytest.param(3, "xy", ranks, marks=pytest.mark.long) for ranks in (2, 3)),
    ],
)
def test_the_jacobian_with_virtual_unknowns_is_correct(dim, axes, ranks, tmp_path):
    arguments = (f"dim={dim}", f"axes={axes}", "n=3", "horizon=1.015", "-snes_test_jacobian")
    assert max(jacobian_ratios(printed(CELL, *arguments, ranks=ranks, output=tmp_path))) < 1e-7


def wavy(dim=2, mean=None, n=6, scheme=None, **changes):
    """Return a cell with a stiffness that varies, so that the displacement is not affine."""
    low, high = [0.0] * dim, [1.0] * dim
    declared = {
        "particles": pd.Lattice(low, high, 1.0 / n),
        "horizon": 2.015 / n,
        "material": pd.Graded(pd.Hencky(E=10.0, nu=0.3), lambda x: 1.0 + 0.5 * np.sin(2.0 * np.pi * x.sum(axis=1))),
        "scheme": scheme or SCHEMES["sub_horizons"],
        "control": pd.Silling(0.2),
        "cell": pd.Cell(low, high),
        "conditions": [
            pd.Displacement(pd.region.Nearest([0.5 / n] * dim), **dict.fromkeys("xyz"[:dim], 0.0)),
            *(mean or [pd.MeanStrain(xx=0.1), pd.MeanStress(xy=0.5)]),
        ],
        "history": {"strain": pd.CellStrain("xy"), "stress": pd.CellStress("xx"), "energy": pd.StrainEnergy()},
        "results": lambda h: {name: h[name][-1] for name in ("strain", "stress", "energy")},
    }
    return pd.Case(**(declared | changes))


CASE_FILE = """
import sys
sys.path.insert(0, {root!r})
from tests.discrete.test_periodic import wavy
def case(dim=2):
    return wavy(dim)
"""


@pytest.mark.parametrize(
    ("dim", "ranks"), [(2, 2), *(pytest.param(*row, marks=pytest.mark.long) for row in ((2, 3), (3, 2), (3, 3)))]
)
def test_any_number_of_ranks_finds_the_same_cell(dim, ranks, tmp_path):
    from tests.commands import ROOT

    path = tmp_path / "wavy.py"
    path.write_text(CASE_FILE.format(root=str(ROOT)))
    alone, several = (results(path, f"dim={dim}", ranks=r, output=tmp_path / str(r))["results"] for r in (1, ranks))
    one, other = (field(tmp_path / str(r), "displacement") for r in (1, ranks))
    assert np.abs(one - other).max() < 1e-10 * np.abs(one).max()
    assert several == pytest.approx(alone, rel=1e-9)


def test_stress_is_the_derivative_of_the_energy_by_the_mean_strain(tmp_path):
    def at(strain):
        case = wavy(mean=[pd.MeanStrain(xx=strain, yy=0.02, xy=0.05)], control=None)
        return pd.run(case, output=tmp_path)

    low, middle, high = (at(strain) for strain in (0.0999, 0.1, 0.1001))
    assert middle["stress"] == pytest.approx((high["energy"] - low["energy"]) / 2e-4, rel=1e-6)


@pytest.mark.parametrize("scheme", ["correspondence", "sub_horizons", "bond_associated"])
def test_a_cell_of_two_periods_repeats_the_cell_of_one(scheme, tmp_path):
    """The same pattern twice in one cell is the same medium."""
    chosen = pd.SCHEMES[scheme]
    one = pd.run(wavy(scheme=chosen), output=tmp_path)
    double = wavy(
        scheme=chosen, particles=pd.Lattice((0.0, 0.0), (2.0, 1.0), 1.0 / 6), cell=pd.Cell((0.0, 0.0), (2.0, 1.0))
    )
    two = pd.run(double, output=tmp_path)
    assert two["strain"] == pytest.approx(one["strain"], rel=1e-9)
    assert two["stress"] == pytest.approx(one["stress"], rel=1e-9)
    assert two["energy"] == pytest.approx(2.0 * one["energy"], rel=1e-9)


def test_a_cell_smaller_than_the_horizon_meets_its_own_images(tmp_path):
    """Two particles along x, three periods of images: the answer is that of a cell of four."""
    energies = []
    for n in (2, 4):
        case = wavy(
            particles=pd.Lattice((0.0, 0.0), (n / 6, 1.0), 1.0 / 6), cell=pd.Cell((0.0, 0.0), (n / 6, 1.0)),
            material=pd.Graded(pd.Hencky(E=10.0, nu=0.3), lambda x: 1.0 + 0.5 * np.sin(2.0 * np.pi * x[:, 1])),
            horizon=3.015 / 6,
        )  # fmt: skip
        energies.append(pd.run(case, output=tmp_path)["energy"] / n)
    assert energies[0] == pytest.approx(energies[1], rel=1e-9)


def test_relaxation_and_multigrid_find_the_same_cell(tmp_path):
    direct = pd.run(wavy(), output=tmp_path)
    iterative = pd.run(wavy(), output=tmp_path, options={"pc_type": "gamg", "ksp_rtol": 1e-10})
    relaxed = pd.run(wavy(solver=pd.DynamicRelaxation(1e-9)), output=tmp_path)
    assert iterative == pytest.approx(direct, rel=1e-8)
    assert relaxed == pytest.approx(direct, rel=1e-5)


def test_multigrid_takes_few_iterations_with_virtual_unknowns(tmp_path):
    for n in (20, 40):
        case = wavy(n=n, control=None, mean=[pd.MeanStress(xx=0.5, xy=0.1)])
        pd.run(case, output=tmp_path, options={"pc_type": "gamg"})
        step = summary(tmp_path)["steps"][-1]
        assert step["linear_iterations"] < 50 * (step["newton_iterations"] + 1)


def test_a_restart_keeps_the_mean_strain(tmp_path):
    whole = pd.run(wavy(steps=pd.Steps(2)), output=tmp_path / "whole")
    again = pd.run(wavy(), output=tmp_path / "again", restart=tmp_path / "whole" / "checkpoint.h5")
    assert again == pytest.approx(whole, rel=1e-12)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"mean": [pd.MeanStrain(zz=0.1)]}, "the periodic cell has xx, xy, yy"),
        ({"mean": [pd.MeanStrain(xx=0.1), pd.MeanStress(xx=0.1)]}, "second time"),
        ({"mean": [pd.MeanStress()]}, "needs at least one"),
        ({"cell": None}, "needs a periodic cell"),
        ({"cell": pd.Cell((0.0, 0.0), (0.5, 1.0))}, "outside the periodic cell in x"),
        ({"cell": pd.Cell((0.0,), (1.0,))}, "The Cell has 1 coordinates, the particles 2"),
        ({"conditions": [pd.MeanStrain(xx=0.1)]}, "2 of 2 rigid motions"),
    ],
    ids=itertools.count(),
)
def test_wrong_cells_are_refused(changes, message, tmp_path):
    mean = changes.pop("mean", None)
    with pytest.raises(pd.CaseError, match=message):
        pd.run(wavy(mean=mean, **changes), output=tmp_path)


@pytest.mark.parametrize(
    "wrong", [((0.0, 0.0), (1.0,)), ((0.0, 0.0), (1.0, 1.0), "z"), ((0.0,), (0.0,)), ((0.0,), (1.0,), "xx")]
)
def test_wrong_corners_are_refused(wrong):
    with pytest.raises(pd.CaseError, match="Cell"):
        pd.Cell(*wrong)


def bonded(start, *conditions):
    """Return a layer of two materials on a rigid base, periodic along x, whose period begins at a place."""
    hard = pd.region.Where(lambda x: (x[:, 0] - start - 0.4) % 2.0 < 0.8)
    law = pd.LinearElastic(E=1.0, nu=0.3)
    return pd.Case(
        particles=pd.Lattice((0.0, 0.0), (2.0, 0.8), 0.1),
        horizon=0.2015,
        cell=pd.Cell((0.0, 0.0), (2.0, 0.8), "x"),
        material=[(hard, pd.LinearElastic(E=3.0, nu=0.3)), (~hard, law)],
        conditions=[
            pd.Displacement(pd.region.Slab("y", high=0.2), x=0.0, y=0.0),
            pd.Displacement(pd.region.Slab("y", low=0.6), y=0.01),
            *conditions,
        ],
        history={"stored": pd.StrainEnergy()},
    )


def test_particles_that_are_held_across_a_period_need_its_strain(tmp_path):
    """Without it the energy depended on where the period begins, by a few per cent."""
    with pytest.raises(pd.CaseError, match=r"Displacements x are prescribed on both sides .* MeanStrain\(xx=0\.0\)"):
        pd.prepare(bonded(0.0))
    found = [pd.run(bonded(at, pd.MeanStrain(xx=0.0)), tmp_path / str(at)).history["stored"][-1] for at in (0.0, 1.0)]
    assert found[1] == pytest.approx(found[0], rel=1e-9)
