"""Patch tests from the command line: prescribed affine boundary displacements and consistent tractions."""

import pytest

import pdpetsc as pd
from tests.commands import ROOT, called, jacobian_ratios, printed, results
from tests.pairs import pairs


@pytest.mark.parametrize(
    ("scheme", "loading", "horizon"), pairs(pd.SCHEMES, ["displacement", "consistent"], [1.015, 2.015, 3.015])
)
def test_hydrostatic_extension_is_exact(scheme, loading, horizon, tmp_path):
    arguments = (f"scheme={scheme}", f"loading={loading}", f"horizon={horizon}", "G=0.5", "n=15", "steps=2")
    found = results("runs/patch/hydrostatic.py", *arguments, output=tmp_path)["results"]
    assert found["max_F_error"] < 1e-10
    assert found["max_P_error"] < 1e-10


def test_hydrostatic_load_on_the_outer_layer_converges_with_the_spacing(tmp_path):
    errors = []
    for n in (9, 17):
        arguments = (f"n={n}", "loading=layer", "horizon=2.015", "G=0.5")
        errors.append(results("runs/patch/hydrostatic.py", *arguments, output=tmp_path)["results"]["error"])
    assert errors[0] > 1.5 * errors[1]


SOLIDS = [(scheme, 3, horizon) for scheme in pd.SCHEMES for horizon in (1.015, 2.015)]


@pytest.mark.parametrize(
    ("scheme", "dim", "horizon"),
    [
        *pairs(pd.SCHEMES, [1, 2], [1.015, 2.015, 3.015]),
        *(pytest.param(*row, marks=pytest.mark.long) for row in SOLIDS),
    ],
)
def test_consistent_traction_gives_a_uniform_gradient(dim, scheme, horizon, tmp_path):
    arguments = (f"dim={dim}", f"scheme={scheme}", f"horizon={horizon}", f"n={8 if dim == 3 else 10}")
    found = results("runs/patch/tension.py", *arguments, output=tmp_path)["results"]
    assert found["max_F_error"] < 1e-10


@pytest.mark.long
def test_consistent_traction_is_exact_on_more_ranks(tmp_path):
    for ranks in (2, 3):
        found = results("runs/patch/tension.py", "horizon=3.015", output=tmp_path, ranks=ranks)["results"]
        assert found["max_F_error"] < 1e-10


def test_a_load_on_the_outer_layer_is_wrong_near_the_face(tmp_path):
    found = results("runs/patch/tension.py", "distribution=layer", output=tmp_path)["results"]
    assert found["max_F_error"] > 0.08 * found["strain"]


def test_consistent_traction_on_a_body_thinner_than_its_reach_is_refused(tmp_path):
    finished = called("runs/patch/tension.py", "n=3", "horizon=3.015", "dim=2", "-o", tmp_path)
    assert finished.returncode == 2
    assert "another face is within two horizons" in finished.stderr


CASES = [path for path in sorted((ROOT / "runs").glob("*/*.py")) if "def case(" in path.read_text()]


@pytest.mark.parametrize("case", CASES, ids=lambda path: path.stem)
def test_every_case_states_its_parameters(case):
    finished = called(case, "-h")
    assert finished.returncode == 0
    assert "parameters:" in finished.stdout


@pytest.mark.parametrize(
    ("dim", "scheme", "ranks"),
    [
        *pairs([1, 2], ["correspondence", "sub_horizons"], [1, 2]),
        *(
            pytest.param(3, s, ranks, marks=pytest.mark.long)
            for s in ("correspondence", "sub_horizons")
            for ranks in (1, 2)
        ),
    ],
)
def test_petsc_finds_the_jacobian_correct(dim, scheme, ranks, tmp_path):
    """-snes_test_jacobian compares with differences of the residual, prescribed rows included."""
    words = (f"dim={dim}", "n=4", "horizon=1.015", f"scheme={scheme}", "-snes_test_jacobian")
    ratios = jacobian_ratios(printed("runs/patch/tension.py", *words, output=tmp_path, ranks=ranks))
    assert len(ratios) >= 2
    assert max(ratios) < 1e-7
