"""Answers do not depend on the units of force and length."""

import contextlib
import dataclasses

import numpy as np
import pytest

import pdpetsc as pd
from pdpetsc.command_line.cli import arguments_of, load_case
from tests.commands import ROOT, summary
from tests.units import in_units

# Cases that iterate, small: what solvers do to them must be the same in all units.
CASES = {
    "clamped": ("beams/clamped.py", "steps=3"),
    "supported": ("beams/simply_supported.py", "steps=3"),
    "supported, coefficient as printed": ("beams/simply_supported.py", "steps=3", "horizon=2.015", "G_printed=0.02"),
    "cantilever": ("beams/cantilever.py", "ny=3", "steps=4"),
    "cantilever, no matrix": ("beams/cantilever.py", "ny=3", "steps=4", "-pd_jacobian=matfree", "-pc_type=gamg"),
    "cantilever, own Cholesky": ("beams/cantilever.py", "ny=3", "steps=4", "-pc_factor_mat_solver_type=petsc"),
    "cantilever, multigrid": ("beams/cantilever.py", "ny=3", "steps=4", "horizon=2.015", "G=0.5", "-pc_type=gamg"),
    "hydrostatic": ("patch/hydrostatic.py", "n=7", "steps=2"),
    "tension": ("patch/tension.py", "n=4", "dim=3", "traction=300"),
    "tension of a bar": ("patch/tension.py", "n=10", "dim=1", "traction=300"),
    "periodic cell": ("patch/cell.py", "n=4"),
    "block": ("hard/block.py", "nx=12", "ny=6", "shake=0.2", "steps=2"),
    "graded block, neo-Hookean": ("hard/block.py", "nx=12", "ny=6", "grading=4", "law=neo_hookean", "steps=2"),
    "plastic plate": ("plasticity/plate.py", "dx=10", "steps=4"),
    "plastic beam": ("plasticity/beam.py", "ny=4", "steps=4"),
    "plate with hole": ("fracture/plate_with_hole.py", "nx=18", "horizon=2.015", "pull=0.16", "steps=4"),
    "plate with hole, present stretch": (
        "fracture/plate_with_hole.py",
        "nx=18",
        "horizon=2.015",
        "pull=0.16",
        "steps=4",
        "effect=present",
    ),
    "notched bar": ("localisation/notched_bar.py", "steps=4"),
    "notched beam along its path": ("fracture/notched_beam.py", "n=8", "horizon=2.015", "end=0.06"),
    "bond by bond": ("localisation/cell_2d.py", "n=6"),
    "bond by bond in one dimension": ("localisation/periodic_cell.py", "n=20"),
    "centre crack": ("fracture/centre_crack.py", "n=10", "law=linear", "solver=path"),
    "edge crack": ("fracture/edge_crack.py", "n=8", "law=brittle", "solver=path"),
    "L-shaped panel": ("fracture/l_panel.py", "n=10", "end=0.06"),
    "box that can break": ("bench/box.py", "n=5", "breakable=true", "strain=0.02"),
    "bonds in finite stretch": ("bonds/tension_bar.py", "dim=2", "n=6"),
}
# Above 1e20 and below 1e-20. Powers of two change no digit, so that not even round-off may differ.
LARGE, SMALL = 2.0**67, 2.0**-67
UNITS = {
    "force small": (SMALL, 1.0),
    "force large": (LARGE, 1.0),
    "length small": (1.0, SMALL),
    "length large": (1.0, LARGE),
    "force small, length large": (SMALL, LARGE),
    "force large, length small": (LARGE, SMALL),
}


def declared(name):
    """Return the case of a name in ``CASES``, with its PETSc options."""
    path, *words = CASES[name]
    options = dict(word[1:].split("=") for word in words if word.startswith("-"))
    function = load_case(ROOT / "runs" / path)
    case = function(**arguments_of(function, dict(word.split("=", 1) for word in words if not word.startswith("-"))))
    return case, {**case.options, **options}


def steps_of(case, options, folder):
    """Return the steps of a run as ``summary.json`` has them."""
    # A run that ends early must end early at the same place in all units.
    with contextlib.suppress(pd.SolveError):
        pd.run(case, output=folder, options=options)
    return summary(folder)["steps"]


def refuse_other_history(found, expected):
    """Assert that two lists of steps show the same iterations: numbers of them, and norms above their round-off."""
    assert [step["t"] for step in found] == pytest.approx([step["t"] for step in expected], rel=1e-6)
    for one, other in zip(found, expected, strict=True):
        counts = [key for key in other if key.endswith("iterations") and key != "linear_iterations"]
        assert {key: one[key] for key in counts} == {key: other[key] for key in counts}
        assert one.get("broken_bonds") == other.get("broken_bonds")
        relative = [np.array(step["norms"]) / (step["reference"] or 1.0) for step in (one, other)]
        np.testing.assert_allclose(*relative, rtol=1e-3, atol=1e-9)


LONG = ("centre crack", "edge crack", "notched beam along its path")
# Of the default suite every case has two opposite units, those of the next case others.
LABELS = list(UNITS)
DEFAULT = {name: LABELS[2 * (n % 3) : 2 * (n % 3) + 2] for n, name in enumerate(CASES) if name not in LONG}
REST = {name: [label for label in LABELS if label not in DEFAULT.get(name, ())] for name in CASES}
REST["centre crack"] = ["force small", "length large"]  # each takes a minute


@pytest.mark.parametrize(
    ("name", "labels"),
    [*DEFAULT.items(), *(pytest.param(name, labels, marks=pytest.mark.long) for name, labels in REST.items())],
)
def test_newton_history_does_not_depend_on_units(name, labels, tmp_path):
    case, options = declared(name)
    expected = steps_of(in_units(case, 1.0, 1.0), options, tmp_path / "plain")
    assert expected
    for label in labels:
        found = steps_of(in_units(case, *UNITS[label]), options, tmp_path / label)
        refuse_other_history(found, expected)


@pytest.mark.parametrize("force, length", [(1e-20, 1.0), (1e-8, 1e-9), (1e20, 1e-20)])
def test_cantilever_bends_as_far_in_any_units(force, length, tmp_path):
    case, options = declared("cantilever")
    tip = pd.region.Nearest((10.0 * length, 0.0))
    scaled = dataclasses.replace(in_units(case, force, length), history={"w": pd.Mean(pd.displacement, "y", tip)})
    scaled = dataclasses.replace(scaled, results=lambda history: {"w": history["w"][-1]})
    expected = pd.run(case, output=tmp_path / "plain", options=options)["w_over_L"]
    found = pd.run(scaled, output=tmp_path / "scaled", options=options)["w"]
    assert -found / (10.0 * length) == pytest.approx(expected, rel=1e-8)


def test_an_end_that_petsc_calls_converged_is_not_believed(tmp_path):
    case, options = declared("cantilever")
    # The secant line search of PETSc ends a solve as converged below this, whatever the residual is.
    early = {**options, "snes_linesearch_atol": 1e30, "snes_max_it": 3}
    with pytest.raises(pd.SolveError, match=r"residual is above the tolerance|too many Newton iterations"):
        pd.run(case, output=tmp_path, options=early)


def test_a_path_by_dissipated_energy_is_the_same_in_any_units(tmp_path):
    def steps(folder, force, length):
        stress = force / length**2
        case = pd.Case(
            particles=pd.LatticeNodes((0.0, 0.0), (4 * length, length), 0.25 * length, thickness=length),
            material=pd.LinearElastic(1000.0 * stress, 0.2, plane="stress"),
            damage=pd.PointDamage(
                pd.softening.Linear(),
                Gc=0.05 * stress * length,
                strength=lambda x: stress * np.where(np.abs(x[:, 0] / length - 2.0) < 0.3, 4.0, 5.0),
            ),
            conditions=[pd.Clamp("-x"), pd.Displacement("+x", x=0.05 * length)],
            solver=pd.PathFollowing(pd.Dissipation(0.005 * force * length), first=0.05, most=14),
            fields=[],
        )
        return steps_of(case, {}, folder)

    expected = steps(tmp_path / "plain", 1.0, 1.0)
    growth = np.diff([step["t"] for step in expected])
    assert len(expected) == 14 and growth[0] == pytest.approx(0.05) and growth.min() < 0.01
    for name, scale in {"large": (1e6, 1.0), "small": (1e-9, 1e-6), "long": (1e-20, 1e9)}.items():
        refuse_other_history(steps(tmp_path / name, *scale), expected)
