"""Benchmarks run, and say the same of iterations and memory on any machine; their times are not tested."""

import json
import os
import subprocess
import sys
import textwrap

import pytest

from tests.commands import ROOT, results


def bench(*words):
    """Run a script of the benchmarks; return what it printed."""
    script, *others = words
    command = [sys.executable, str(ROOT / "runs" / "bench" / script), *map(str, others)]
    # The environment as it was before MPI started in this process, which mpirun would refuse.
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    finished = subprocess.run(
        command, cwd=ROOT, env=environment, capture_output=True, text=True, check=True, timeout=600
    )
    return finished.stdout


def measured(tmp_path, *words):
    """Return what the benchmark of one linear solve measured."""
    bench("linear.py", *words, f"json={tmp_path / 'found.json'}")
    return json.loads((tmp_path / "found.json").read_text())


@pytest.mark.long
@pytest.mark.parametrize("horizon", ["1.015", "2.015", "3.015"])
def test_iterations_do_not_depend_on_horizon_or_size(horizon, tmp_path):
    small = measured(tmp_path, "n=30", f"horizon={horizon}")
    large = measured(tmp_path, "n=90", f"horizon={horizon}")
    assert large["reason"] > 0
    assert large["linear_iterations"] <= 30
    assert large["linear_iterations"] <= 1.5 * small["linear_iterations"]


@pytest.mark.long
def test_iterations_with_a_third_of_the_bonds_broken(tmp_path):
    found = measured(tmp_path, "n=60", "broken=0.3")
    assert found["solver"].startswith("ksp gmres")
    assert found["reason"] > 0
    assert found["linear_iterations"] <= 30


@pytest.mark.long
def test_a_solid_takes_as_many_iterations_at_any_size(tmp_path):
    counts = [measured(tmp_path, "dim=3", f"n={n}", "horizon=3.015")["linear_iterations"] for n in (12, 24)]
    assert max(counts) <= 30
    assert counts[1] <= 1.5 * counts[0]


@pytest.mark.long
def test_counts_of_the_performance_model(tmp_path):
    said = bench("performance_model.py", 16).splitlines()
    rows = [line.split() for line in said if line.split()[:1] in (["2"], ["4"], ["8"]) and len(line.split()) == 10]
    assert len(rows) == 3
    for row in rows:
        assert 0.97 < float(row[3]) < 1.03
        assert row[4] == row[5]
        assert float(row[7]) < 7.0


@pytest.mark.long
def test_the_elements_that_methods_are_held_against_have_their_orders():
    """Linear ones 2 and 1 in displacement and stress, quadratic ones 3 and 2, on a shaken square and a round ring."""
    pytest.importorskip("skfem")
    code = """
        import json, sys
        sys.argv = ["fronts.py"]
        sys.path[:0] = ["runs/bench", "runs"]
        import fronts
        kinds = [(fronts.manufactured, "shaken square"), (fronts.ring, "ring")]
        found = [[[fronts.elements(*kind, degree, n)[1:] for n in (8, 16)] for degree in (1, 2)] for kind in kinds]
        rows = [("p", "m", 1.0, "w", n, *of) for n, of in ((1, (0.1, 1e-1, 1e-1)), (2, (1.0, 1e-3, 1e-3)))]
        worse = ("p", "other", 1.0, "w", 1, 0.5, 0.2, 0.2)
        kept = [row[1] for row in fronts.front([*rows, worse], 6)]
        print(json.dumps([found, kept, fronts.error_after(rows, 6, 10.0**-0.5), fronts.error_after(rows, 6, 2.0)]))
    """
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    said = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)], cwd=ROOT, env=environment, capture_output=True, text=True,
        check=True, timeout=300,
    ).stdout  # fmt: skip
    found, kept, between, beyond = json.loads(said)
    for of_kind in found:
        for degree, ((coarse_u, coarse_stress), (u, stress)) in enumerate(of_kind, 1):
            assert coarse_u / u > 0.85 * 2 ** (degree + 1)
            assert coarse_stress / stress > 0.85 * 2**degree
    assert kept == ["m", "m"]
    assert (between, beyond) == ("1.0e-02", "<1.0e-03")


@pytest.mark.long
def test_the_tensile_bar_from_a_mesh(tmp_path):
    words = f"mesh={tmp_path / 'bar.vtu'}", "steps=1"
    found = results("runs/dog_bone/dog_bone.py", *words, ranks=2, output=tmp_path / "out")
    assert found["particles"] == 12625
    assert found["results"]["over_narrow_bar"] == pytest.approx(1.1655, rel=1e-3)
