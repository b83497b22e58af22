"""``plot`` and ``compare``."""

import contextlib
import csv
import os
import shutil
import signal
import subprocess
import sys
import time

import pytest

import pdpetsc as pd
from pdpetsc.command_line.plot import plot
from tests.commands import ROOT, called, results, wait_until

CLAMPED = "runs/beams/clamped.py"
# What .ci/mpirun sets: compare calls mpirun itself, here perhaps as root, in a container, with more ranks than cores.
AS_ROOT = {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}
IN_A_CONTAINER = {"OMPI_MCA_rmaps_base_oversubscribe": "1", "OMPI_MCA_btl_vader_single_copy_mechanism": "none"}
ENVIRONMENT = {**os.environ, **AS_ROOT, **IN_A_CONTAINER, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}


def tool(*words):
    words = [sys.executable, "-m", "pdpetsc", *map(str, words)]
    return subprocess.run(words, cwd=ROOT, env=ENVIRONMENT, capture_output=True, text=True, timeout=300, check=False)


def table(folder):
    with (folder / "compare.csv").open() as file:
        return list(csv.DictReader(file))


def test_plot_draws_a_run(tmp_path):
    results(CLAMPED, "steps=2", output=tmp_path)
    finished = called("plot", tmp_path, "scale=10", "component=yy", "x=t", "y=w", "--animate")
    assert finished.returncode == 0, finished.stderr
    for name in ("deformed.png", "deformed.gif", "history.png", "newton.png"):
        path = tmp_path / name
        assert str(path) in finished.stdout
        assert path.stat().st_size > 5_000


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("field=nothing",), "no field 'nothing'; it has displacement, stress"),
        (("component=xxx",), "A component of this field is xx, xy, ..."),
        (("step=77",), "no fields of step 77"),
        (("y=nothing",), "no column 'nothing'"),
        (("colour=red",), "plot has no parameter 'colour'"),
        (("scale=big",), "scale takes a number"),
    ],
)
def test_plot_refuses_what_is_not_there(words, message, tmp_path_factory):
    folder = tmp_path_factory.getbasetemp() / "plotted"
    if not folder.exists():
        results(CLAMPED, "steps=1", output=folder)
    finished = called("plot", folder, *words)
    assert finished.returncode == 2
    assert message in finished.stderr


@pytest.mark.parametrize("name", ["summary.json", "history.csv", "fields.h5"])
@pytest.mark.parametrize("content", ["", "[1, 2]", "t,step\na,b\n"])
def test_plot_of_damaged_files_is_refused_or_draws_without_them(name, content, tmp_path_factory):
    source, folder = tmp_path_factory.getbasetemp() / "plotted", tmp_path_factory.mktemp("damaged")
    if not source.exists():
        results(CLAMPED, "steps=1", output=source)
    shutil.copytree(source, folder, dirs_exist_ok=True)
    (folder / name).write_text(content)
    with contextlib.suppress(pd.CaseError):
        plot(folder, {})


def test_plot_of_an_empty_folder_is_refused(tmp_path):
    assert "holds no summary.json" in called("plot", tmp_path).stderr


@pytest.mark.long
def test_compare_runs_every_combination_once(tmp_path):
    words = ("compare", CLAMPED, "scheme=correspondence,sub_horizons", "ny=3", "steps=1", "-o", tmp_path)
    finished = tool(*words)
    assert finished.returncode == 0, finished.stderr
    rows = table(tmp_path)
    assert [(row["scheme"], row["ny"]) for row in rows] == [("correspondence", "3"), ("sub_horizons", "3")]
    assert float(rows[0]["error"]) == pytest.approx(0.0668, abs=1e-3)
    assert all(row["status"] == "finished" and float(row["seconds"]) > 0.0 for row in rows)
    assert (tmp_path / "compare.png").stat().st_size > 10_000
    times = {path: path.stat().st_mtime for path in tmp_path.glob("*/summary.json")}
    assert len(times) == 2
    assert called(*words).returncode == 0
    assert times == {path: path.stat().st_mtime for path in tmp_path.glob("*/summary.json")}


@pytest.mark.long
def test_an_interrupted_comparison_goes_on_where_it_was(tmp_path):
    words = [sys.executable, "-m", "pdpetsc", "compare", CLAMPED, "ny=3,5", "steps=1", "-o", str(tmp_path)]
    pipes = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "text": True}
    process = subprocess.Popen(words, cwd=ROOT, env=ENVIRONMENT, start_new_session=True, **pipes)
    wait_until(lambda: list(tmp_path.glob("ny=3*/outcome.json")), "the first run")
    os.killpg(process.pid, signal.SIGINT)
    _, message = process.communicate(timeout=300)
    assert process.returncode == 1, message
    assert "The same command continues" in message
    assert "Traceback" not in message
    first = next(tmp_path.glob("ny=3*/outcome.json")).stat().st_mtime
    assert called(*words[3:]).returncode == 0
    assert len(table(tmp_path)) == 2
    assert next(tmp_path.glob("ny=3*/outcome.json")).stat().st_mtime == first


INTERRUPTED_IN_A_FORK = """
import os, signal, sys
import pdpetsc as pd

if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)
    os.register_at_fork(after_in_parent=lambda: os.kill(os.getpid(), signal.SIGINT))
    try:
        pd.study(sys.argv[1], {"n": [4, 8]}, sys.argv[2])
    except KeyboardInterrupt:
        sys.exit(7)
"""


def test_a_signal_that_comes_while_a_run_is_started_ends_a_study(tmp_path):
    # What a handler raises inside the calls that Python makes around a fork is dropped by Python.
    (tmp_path / "case.py").write_text(CRASHING)
    (tmp_path / "study.py").write_text(INTERRUPTED_IN_A_FORK)
    words = [sys.executable, tmp_path / "study.py", tmp_path / "case.py", tmp_path / "out"]
    finished = subprocess.run(words, cwd=ROOT, env=ENVIRONMENT, capture_output=True, text=True, timeout=300)
    assert finished.returncode == 7, finished.stderr
    assert not list((tmp_path / "out").glob("*/outcome.json"))


@pytest.mark.long
def test_compare_on_two_ranks_and_with_petsc_options(tmp_path):
    words = ("compare", CLAMPED, "ny=3", "steps=1", "--ranks", "2", "-pc_type", "lu", "-o", tmp_path)
    finished = tool(*words)
    assert finished.returncode == 0, finished.stderr
    assert '"ranks": 2' in next(tmp_path.glob("*/summary.json")).read_text()


@pytest.mark.long
def test_compare_keeps_what_failed_and_says_so(tmp_path):
    finished = tool("compare", CLAMPED, "ny=3", "steps=1,2", "-snes_max_it", "1", "-o", tmp_path)
    assert finished.returncode == 1
    assert "2 of 2 runs failed" in finished.stderr
    assert all(row["status"] == "failed" and row["exit_status"] == "1" for row in table(tmp_path))
    assert all("No convergence" in row["said"] for row in table(tmp_path))


def test_compare_refuses_unknown_parameters_before_running(tmp_path):
    finished = called("compare", CLAMPED, "nz=3,5", "-o", tmp_path / "never")
    assert finished.returncode == 2
    assert "no parameter 'nz'" in finished.stderr
    assert not (tmp_path / "never").exists()


CRASHING = """
import os, signal, sys
import pdpetsc as pd

def case(n=4, end="right"):
    def results(h):
        if end == "killed":
            os.kill(os.getpid(), signal.SIGKILL)
        if end == "left":
            os._exit(0)
        if end == "wrong":
            raise ValueError("no number")
        return {"t": h["t"][-1]}
    if end == "early":
        os.kill(os.getpid(), signal.SIGKILL)
    ends = [pd.region.Slab("x", high=1.0 / n), pd.region.Slab("x", low=1.0 - 1.0 / n)]
    return pd.Case(
        particles=pd.Lattice((0.0,), (1.0,), 1.0 / n), horizon=2.015 / n, material=pd.BondBased(E=1.0), fields=[],
        conditions=[pd.Displacement(ends[0], x=0.0), pd.Displacement(ends[1], x=0.1)], results=results,
    )
"""


@pytest.mark.long
def test_compare_judges_a_run_by_its_exit_status_and_its_own_summary(tmp_path):
    case, folder = tmp_path / "case.py", tmp_path / "out"
    case.write_text(CRASHING)
    words = ("compare", case, "n=8", "end=right,killed,left,wrong", "-o", folder)
    finished = tool(*words)
    assert finished.returncode == 1
    assert "3 of 4 runs failed" in finished.stderr
    found = {row["end"]: row for row in table(folder)}
    assert [found[end]["status"] for end in ("right", "killed", "left", "wrong")] == ["finished", *["failed"] * 3]
    assert found["killed"]["exit_status"] == "-9"
    assert found["left"]["said"].startswith("exit status 0 without a finished run")
    assert "ValueError: no number" in found["wrong"]["said"]
    assert all(found[end]["t"] == "" for end in ("killed", "left", "wrong"))
    # What an earlier run left does not count, not even where a run ends before it writes anything.
    place = folder / "end=early,n=8"
    shutil.copytree(folder / "end=right,n=8", place)
    (place / "outcome.json").write_text("{ cut off")
    (place / "note.txt").write_text("mine")
    finished = tool("compare", case, "n=8", "end=right,early", "-o", folder)
    assert finished.returncode == 1
    right, early = table(folder)
    assert (
        (right["exit_status"], early["exit_status"]) == ("0", "2") and early["status"] == "failed" and early["t"] == ""
    )
    assert (place / "note.txt").read_text() == "mine"


def test_compare_never_touches_a_folder_that_it_did_not_make(tmp_path):
    case = tmp_path / "case.py"
    case.write_text(CRASHING)
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "thesis.tex").write_text("years of work")
    finished = called("compare", case, "-o", tmp_path)
    assert finished.returncode == 2
    assert "run holds files that no study has written" in finished.stderr
    assert (tmp_path / "run" / "thesis.tex").read_text() == "years of work"
    other = tmp_path / "other"
    other.mkdir()
    (other / "run").symlink_to(tmp_path / "run")
    assert "run is not a folder that a study has made" in called("compare", case, "-o", other).stderr
    assert [path.name for path in (tmp_path / "run").iterdir()] == ["thesis.tex"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("compare", CLAMPED, "ny=3", "--restart", "x"), "compare has no option '--restart'"),
        (("plot", "out", "-snes_monitor"), "plot has no option '-snes_monitor'"),
    ],
)
def test_words_that_a_tool_does_not_take_are_refused(words, message):
    finished = called(*words)
    assert finished.returncode == 2
    assert message in finished.stderr


@pytest.mark.long
def test_a_comparison_that_is_ended_ends_its_run(tmp_path):
    case, folder = tmp_path / "case.py", tmp_path / "out"
    case.write_text(
        "import os, time\nfrom pathlib import Path\nimport pdpetsc as pd\n\n"
        "def case(n=1):\n    Path(__file__).with_name('pid').write_text(str(os.getpid()))\n    time.sleep(60)\n"
    )
    words = [sys.executable, "-m", "pdpetsc", "compare", str(case), "n=1", "-o", str(folder)]
    pipes = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "text": True}
    process = subprocess.Popen(words, cwd=ROOT, env=ENVIRONMENT, **pipes)
    wait_until(lambda: (tmp_path / "pid").exists() and (tmp_path / "pid").read_text(), "the run")
    process.send_signal(signal.SIGTERM)
    _, message = process.communicate(timeout=300)
    assert process.returncode == 1
    assert "The same command continues" in message
    pid = int((tmp_path / "pid").read_text())
    with pytest.raises(ProcessLookupError):
        # What was orphaned is there until the first process of the machine has looked at it.
        for _ in range(1200):
            os.kill(pid, 0)
            time.sleep(0.05)
