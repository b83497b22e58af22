"""Nothing that was computed is lost, and a restart takes only what belongs to it."""

import dataclasses
import functools
import json
import linecache
import os
import shutil
import signal
import socket
import subprocess
import sys
import xml.etree.ElementTree as ET
import zlib

import h5py
import numpy as np
import pytest

import pdpetsc as pd
from pdpetsc.discrete.communicator import world
from pdpetsc.discrete.families import find_families
from pdpetsc.output import checkpoint, folder
from pdpetsc.output.checkpoint import read_checkpoint
from pdpetsc.output.files import InCreationOrder
from pdpetsc.output.fingerprint import declared_parts, fingerprint
from pdpetsc.output.index import Index, Step, part_of, storable
from pdpetsc.output.records import rows_of, write_summary
from pdpetsc.output.report import write_report
from pdpetsc.running.build import make_cloud, make_problem
from tests.commands import ROOT, Stop, command, field, run, summary

CASE = """
import pdpetsc as pd


def case(pull=0.5, steps=3, E=10.0, dx=1.0):
    left, right = pd.region.Slab("x", high=2.0), pd.region.Slab("x", low=8.0)
    return pd.Case(
        particles=pd.Lattice((0.0, 0.0), (10.0, 4.0), dx),
        horizon=2.015 * dx,
        material=pd.BondBased(E=E),
        damage=pd.LinearSoftening(pd.ConstantCritical(0.02), 3.0),
        conditions=[pd.Displacement(left, x=0.0, y=0.0), pd.Displacement(right, x=lambda x, t: pull * t, y=0.0)],
        steps=pd.Steps(steps),
        history={"force": pd.Reaction("x", right), "work": pd.ExternalWork(), "broken": pd.BrokenBonds()},
        results=lambda h: {"force": h["force"][-1]},
    )
"""


@pytest.fixture
def scene(tmp_path):
    """A case file: a strip of bonds that soften and break."""
    path = tmp_path / "scene.py"
    path.write_text(CASE)
    return path


@functools.cache
def _case_function():
    names = {}
    linecache.cache["scene.py"] = len(CASE), None, CASE.splitlines(keepends=True), "scene.py"
    exec(compile(CASE, "scene.py", "exec"), names)
    return names["case"]


def strip(**parameters):
    return _case_function()(**parameters)


class Counting(Stop):
    """Ends the run once the step time is beyond a number; otherwise the broken bonds."""

    def evaluate(self, solution):
        super().evaluate(solution)
        return pd.BrokenBonds().evaluate(solution)


def stopped(after, **parameters):
    """Return the strip's case, which a run leaves early."""
    case = strip(**parameters)
    return dataclasses.replace(case, history={**case.history, "broken": Counting(after)})


def history(place):
    return (place / "history.csv").read_text()


# What belongs to a restart.


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        ({"material": pd.BondBased(E=11.0)}, "its material differs"),
        ({"conditions": None}, "its conditions differ"),
        ({"influence": pd.influence.Gaussian()}, "its influence differs"),
        ({"cracks": [pd.Segment((4.9, -1.0), (4.9, 1.2))]}, "its cracks differ"),
        ({"material": pd.BondBased(E=11.0), "conditions": None}, "its material and conditions differ"),
        ({"damage": pd.LinearSoftening(pd.ConstantCritical(0.03), 3.0)}, "its damage differs"),
    ],
    ids=["material", "conditions", "influence", "cracks", "two", "damage"],
)
def test_a_restart_of_another_case_is_refused_and_says_what_differs(changes, what, tmp_path):
    with pytest.raises(pd.Interrupted):
        pd.run(stopped(0.5), output=tmp_path / "part")
    if "conditions" in changes:
        changes = {**changes, "conditions": strip(pull=0.6).conditions}
    other = dataclasses.replace(strip(), **changes)
    with pytest.raises(pd.CaseError, match=what):
        pd.run(other, output=tmp_path / "rest", restart=tmp_path / "part")
    assert not (tmp_path / "rest" / "history.csv").exists()
    pd.run(other, output=tmp_path / "rest", restart=tmp_path / "part", restart_anyway=True)


def test_steps_solver_and_records_may_differ(tmp_path):
    pd.run(strip(), output=tmp_path / "whole")
    with pytest.raises(pd.Interrupted):
        pd.run(stopped(0.5), output=tmp_path / "part")
    other = dataclasses.replace(
        strip(),
        steps=pd.Steps(6),
        history={},
        fields=[pd.displacement],
        results=None,
        checkpoints=2,
        options={"snes_rtol": 1e-9},
        picture=pd.Picture(pd.local_damage, ""),
    )
    pd.run(other, output=tmp_path / "rest", restart=tmp_path / "part")
    assert summary(tmp_path / "rest")["status"] == "converged"


@pytest.mark.long
def test_the_command_line_refuses_another_load_and_goes_on_anyway(scene, tmp_path):
    with pytest.raises(pd.Interrupted):
        pd.run(stopped(0.5), output=tmp_path / "part")
    words = ("pull=0.6", "--quiet", "--restart", tmp_path / "part")
    refused = run(scene, *words, output=tmp_path / "rest")
    assert refused.returncode == 2
    assert "its conditions differ; declare the same, or go on with it by --restart-anyway" in refused.stderr
    assert run(scene, *words, "--restart-anyway", output=tmp_path / "rest").returncode == 0


def test_a_fingerprint_is_that_of_the_source_in_any_process(scene):
    """Sets in the code have another order in each process, and another place in the file changes nothing."""
    text = (
        "import sys, petsc4py\npetsc4py.init()\nsys.path.insert(0, sys.argv[1])\nimport json\n"
        "from pdpetsc.command_line.cli import load_case\nfrom pathlib import Path\n"
        "from pdpetsc.output.fingerprint import declared_parts\n"
        "print(json.dumps(declared_parts(load_case(Path(sys.argv[2]))())))\n"
    )
    more = '"a" if len({"p", "q", "r"}) > 9 else "x"'
    scene.write_text(scene.read_text().replace('pd.region.Slab("x", high', f"pd.region.Slab({more}, high"))
    moved = scene.with_name("moved.py")
    moved.write_text("# A comment.\n\n\n" + scene.read_text())
    found = []
    for path, seed in ((scene, "1"), (moved, "2")):
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONHASHSEED": seed}
        words = [sys.executable, "-c", text, str(ROOT), str(path)]
        found.append(json.loads(subprocess.run(words, capture_output=True, env=environment, check=True).stdout))
    assert found[0] == found[1] == declared_parts(strip())


LEVEL = 1.0


class Load:
    """A load that is called."""

    def __init__(self, size):
        self.size = size

    def __call__(self, x, t):
        return self.size * t


def test_a_fingerprint_sees_what_a_function_does():
    def load(size, more=0.0):
        return lambda x, t: LEVEL * size * t + more

    one = fingerprint(load(1.0))
    assert fingerprint(load(1)) == one == fingerprint(load(1.0, -0.0))
    assert len({one, fingerprint(load(2.0)), fingerprint(load(1.0, 1.0)), fingerprint(lambda x, t: t)}) == 4
    signs = [lambda x, t: x + t, lambda x, t: x - t, lambda x, t: -(x + t), lambda x, t: (x, lambda: t)]
    assert len({fingerprint(sign) for sign in signs}) == 4
    assert fingerprint(Load(1.0)) == fingerprint(Load(1.0)) != fingerprint(Load(2.0))
    assert fingerprint(functools.partial(load, 1.0)) != fingerprint(functools.partial(load, 2.0))
    array = np.arange(3.0)
    assert fingerprint(array) == fingerprint(array.copy()) != fingerprint(array + 1e-16 + 1.0)
    assert fingerprint({"a": 1, "b": 2}) == fingerprint({"b": 2, "a": 1})
    global LEVEL
    LEVEL = 2.0
    try:
        assert fingerprint(load(1.0)) != one
    finally:
        LEVEL = 1.0
    circle = []
    circle.append(circle)
    assert fingerprint(circle) == fingerprint(circle)


def test_a_file_of_particles_counts_by_its_content(tmp_path):
    for name, volume in (("a.txt", 1.0), ("b.txt", 1.0), ("c.txt", 2.0)):
        (tmp_path / name).write_text(f"0 0 1 {volume}\n1 0 1 1\n")
    a, b, c = (fingerprint(pd.TextFile(tmp_path / name)) for name in ("a.txt", "b.txt", "c.txt"))
    assert a == b != c


def test_what_means_the_same_has_the_same_fingerprint():
    case = pd.Case(pd.Lattice(0.0, 4.0, 1.0), 2.015, pd.Hencky(E=1.0, nu=0.0), [])
    same = dataclasses.replace(
        case, scheme=pd.SubHorizons(), material=[(pd.region.All(), pd.Hencky(E=1, nu=0.0))], steps=pd.Steps(7)
    )
    assert declared_parts(case) == declared_parts(same)


def test_a_new_run_does_not_leave_the_checkpoint_of_another(tmp_path):
    """Its own first checkpoint comes late; a chain that looks for one must not find that of the run before."""
    pd.run(strip(), output=tmp_path)
    (tmp_path / "notes.txt").write_text("mine")
    kept = (tmp_path / "checkpoint.h5").read_bytes()
    with pytest.raises(pd.Interrupted):
        pd.run(dataclasses.replace(stopped(0.1, E=20.0), checkpoints=0), output=tmp_path)
    assert not (tmp_path / "checkpoint.h5").exists()
    assert (tmp_path / "earlier" / "checkpoint.h5").read_bytes() == kept
    assert field(tmp_path / "earlier", "displacement").shape == (40, 3)
    assert (tmp_path / "notes.txt").read_text() == "mine"
    with pytest.raises(pd.CaseError, match="which it goes on from"):
        pd.run(strip(), output=tmp_path, restart=tmp_path / "earlier")
    assert (tmp_path / "earlier" / "checkpoint.h5").read_bytes() == kept


def test_a_case_that_is_wrong_leaves_the_run_before_where_it_is(tmp_path):
    pd.run(strip(), output=tmp_path)
    before = {path: path.read_bytes() for path in tmp_path.rglob("*.*") if path.is_file()}
    wrong = dataclasses.replace(strip(), conditions=[])
    with pytest.raises(pd.CaseError):
        pd.run(wrong, output=tmp_path)
    assert before == {path: path.read_bytes() for path in tmp_path.rglob("*.*") if path.is_file()}


@pytest.mark.parametrize("name", ["history.csv", "checkpoint.h5", "fields.h5", "fields", "fields/step_00000.h5"])
def test_files_of_another_origin_are_not_touched(name, tmp_path):
    path = tmp_path / name
    path.parent.mkdir(exist_ok=True)
    path.write_text("my measurements\n1,2\n")
    with pytest.raises(pd.CaseError, match="move it away"):
        pd.run(strip(), output=tmp_path)
    assert path.read_text() == "my measurements\n1,2\n"


@pytest.mark.parametrize("name", ["history.csv", "checkpoint.h5.part", ".pdpetsc-lock", "summary.json.part"])
def test_links_are_not_followed(name, tmp_path):
    target = tmp_path / "precious"
    target.write_text("mine")
    place = tmp_path / "out"
    place.mkdir()
    (place / name).symlink_to(target)
    if name in ("history.csv", ".pdpetsc-lock"):
        with pytest.raises(pd.CaseError):
            pd.run(strip(), output=place)
    else:
        pd.run(strip(), output=place)
    assert target.read_text() == "mine"


def test_the_history_of_another_run_is_not_taken_over(tmp_path):
    """A checkpoint that was copied into another folder brings its own history."""
    with pytest.raises(pd.Interrupted):
        pd.run(stopped(0.5), output=tmp_path / "one")
    with pytest.raises(pd.Interrupted):
        pd.run(stopped(0.5, E=20.0), output=tmp_path / "two")
    shutil.copy(tmp_path / "one" / "checkpoint.h5", tmp_path / "two" / "checkpoint.h5")
    pd.run(strip(), output=tmp_path / "rest", restart=tmp_path / "two")
    pd.run(strip(), output=tmp_path / "whole")
    assert [line.split(",")[0] for line in history(tmp_path / "rest").split()] == ["step", "0", "1", "2", "3"]
    assert history(tmp_path / "rest") == history(tmp_path / "whole")


# Two runs in one folder.


def test_a_folder_takes_one_run(scene, tmp_path):
    place = tmp_path / "out"
    with folder.holding(world(), place):
        refused = run(scene, "--quiet", output=place)
        assert refused.returncode == 2
        assert f"Process {os.getpid()} on {socket.gethostname()} runs in {place}" in refused.stderr
        assert len(refused.stderr.splitlines()) == 1
        assert (place / folder.LOCK).exists()
        with pytest.raises(pd.CaseError, match="choose another folder"):
            pd.run(strip(), output=place)
    assert not list(place.iterdir())


@pytest.mark.parametrize(
    ("holder", "message"),
    [
        ({"host": "elsewhere", "pid": 7, "started": "x"}, "Process 7 on elsewhere .* or remove .*lock if that process"),
        ({"host": socket.gethostname(), "pid": 2**22 + 1, "started": "x"}, None),
        ({"host": socket.gethostname(), "pid": 1, "started": "another boot 5"}, None),
        ("", "does not say which run it is of; remove it"),
        ({"pid": 7}, "does not say which run it is of; remove it"),
    ],
    ids=["other host", "gone", "number used again", "empty", "torn"],
)
def test_a_lock_that_was_left_behind(holder, message, tmp_path):
    (tmp_path / folder.LOCK).write_text(json.dumps(holder) if holder else "")
    if message is None:
        with folder.holding(world(), tmp_path):
            assert str(os.getpid()) in (tmp_path / folder.LOCK).read_text()
        assert not list(tmp_path.iterdir())
    else:
        with pytest.raises(pd.CaseError, match=message), folder.holding(world(), tmp_path):
            pass
        assert (tmp_path / folder.LOCK).exists()


RACE = """
import os, socket, sys, time
from pathlib import Path
import petsc4py
petsc4py.init(["race"])
import pdpetsc as pd
from pdpetsc.discrete.communicator import world
from pdpetsc.output import folder
place, held, both, end = Path(sys.argv[1]), 0, 0, time.time() + 5.0
while time.time() < end:
    try:
        with folder.holding(world(), place):
            try:
                os.close(os.open(place / "inside", os.O_CREAT | os.O_EXCL))
            except FileExistsError:
                both += 1
                continue
            held += 1
            time.sleep(0.001)
            os.unlink(place / "inside")
            if held % 5 == 0:  # leaves an old lock, as a run that is killed does
                gone = '{"host": "%s", "pid": 4194399, "started": "then"}' % socket.gethostname()
                (place / folder.LOCK).write_text(gone)
    except pd.CaseError:
        pass
print(held, both)
"""


@pytest.mark.long
def test_no_two_processes_get_a_folder_at_once(tmp_path):
    (tmp_path / "race.py").write_text(RACE)
    words = [sys.executable, tmp_path / "race.py", tmp_path / "out"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    racing = [subprocess.Popen(words, env=environment, stdout=subprocess.PIPE, text=True) for _ in range(4)]
    found = [list(map(int, process.communicate(timeout=60)[0].split())) for process in racing]
    assert min(held for held, _ in found) > 10
    assert sum(both for _, both in found) == 0


def test_a_lock_needs_no_links(tmp_path, monkeypatch):
    def refuse(*_, **__):
        raise PermissionError(1, "no links here")

    monkeypatch.setattr(os, "link", refuse)
    with folder.holding(world(), tmp_path):
        with pytest.raises(pd.CaseError, match="choose another folder"), folder.holding(world(), tmp_path):
            pass
        assert (tmp_path / folder.LOCK).exists()
    assert not list(tmp_path.iterdir())


def test_a_run_that_fails_releases_its_folder(tmp_path):
    with pytest.raises(pd.Interrupted):
        pd.run(stopped(0.0), output=tmp_path)
    assert not (tmp_path / folder.LOCK).exists()


# Writes that fail or end the process.


@pytest.fixture(scope="session")
def failing_writes(tmp_path_factory):
    """A library that lets the n-th change of a file below a folder fail."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler")
    made = tmp_path_factory.mktemp("shim") / "failing_writes.so"
    words = [compiler, "-shared", "-fPIC", "-O1", "-o", str(made), str(ROOT / "tests/failing_writes.c"), "-ldl"]
    subprocess.run(words, check=True)
    return made


def sweep(library, scene, place, how, first, stride):
    """Let every ``stride``-th change of a file fail; return what became of each."""
    place.mkdir()
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "LD_PRELOAD": str(library), "OMP_NUM_THREADS": "1"}
    words = [sys.executable, ROOT / "tests/kill_everywhere.py", scene, place, how, first, stride]
    finished = subprocess.run([*map(str, words)], env=environment, capture_output=True, text=True, timeout=1200)
    assert finished.returncode == 0, finished.stderr
    return [json.loads(line) for line in finished.stdout.splitlines()][1:]


@pytest.mark.parametrize(
    ("how", "stride"),
    [
        ("kill", 97),
        *(pytest.param(how, n, marks=pytest.mark.long) for how, n in (("kill", 29), ("full", 31), ("broken", 37))),
    ],
)
def test_no_write_that_fails_costs_what_is_done(how, stride, failing_writes, scene, tmp_path):
    """The step in progress is all that is lost, and the run that goes on ends with the same files."""
    found = sweep(failing_writes, scene, tmp_path / "out", how, 3, stride)
    assert len(found) > 3
    before = -1
    for one in found:
        rows, steps, saved = one["left"]
        assert one["again"] == 0, one
        assert one["same"], one
        assert one["left again"] == [3, [0, 1, 2, 3], 3], one
        assert steps == list(range(len(steps))), one
        # Whatever the checkpoint goes on from is there, and the history is at most one step behind the fields.
        assert rows >= saved and len(steps) - 1 in (rows, rows + 1), one
        assert rows >= before, one
        before = rows if how == "kill" else before
        lines = one["said"].splitlines()
        if how == "kill":
            assert one["status"] == -signal.SIGKILL
        elif one["status"] != 0:
            assert one["status"] in (1, 2), one
            assert len(lines) == 1 and lines[0].startswith("pdpetsc: "), one
        else:
            # Only what need not be kept may fail without a word: the lock's removal.
            assert rows == 3 and saved == 3 and not lines, one


@pytest.mark.parametrize(
    ("how", "n"),
    [
        pytest.param("kill", 120, marks=pytest.mark.long),
        *(pytest.param(how, n, marks=pytest.mark.long) for how in ("kill", "full", "broken") for n in (9, 169)),
    ],
)
def test_no_write_that_fails_costs_what_is_done_on_two_ranks(how, n, failing_writes, scene, tmp_path):
    whole, place = tmp_path / "whole", tmp_path / "out"
    pd.run(strip(), output=whole)
    environment = {
        **os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "FAILING_UNDER": str(place),
        "FAILING_AT": str(n), "FAILING_HOW": how, "FAILING_RANK": "0",
    }  # fmt: skip
    words = command(scene, "--quiet", ranks=2, output=place)
    words = [*words[:2], "env", f"LD_PRELOAD={failing_writes}", *words[2:]]
    finished = subprocess.run(words, env=environment, capture_output=True, text=True, timeout=100, check=False)
    assert finished.returncode != 0
    if how != "kill":
        said = [line for line in finished.stderr.splitlines() if line.startswith("pdpetsc: ")]
        assert len(said) == 1 and "Traceback" not in finished.stderr, finished.stderr
        assert finished.returncode in (1, 2)
    restart = ("--restart", place) if (place / "checkpoint.h5").exists() else ()
    again = run(scene, "--quiet", *restart, output=place, ranks=2)
    assert again.returncode == 0, again.stderr
    one, other = (np.loadtxt(f / "history.csv", delimiter=",", skiprows=1) for f in (whole, place))
    assert np.allclose(one, other, rtol=1e-6, atol=1e-6)
    assert np.allclose(field(whole, "displacement"), field(place, "displacement"), atol=1e-8)


@pytest.mark.long
def test_a_reader_that_holds_the_fields_open_does_not_disturb_the_run(scene, tmp_path):
    """With HDF5's own locks, as ParaView opens them, from before the first step to after the last."""
    place = tmp_path / "out"
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "HDF5_USE_FILE_LOCKING": "TRUE"}
    held = []

    class Look(pd.Quantity):
        def evaluate(self, solution):
            if not (place / "fields.h5").exists():  # what is asked is tried once before anything is written
                return 0.0
            held.append(h5py.File(place / "fields.h5", "r"))
            held.append(h5py.File(place / "fields" / f"step_{solution.step:05d}.h5", "r"))
            return 0.0

    case = strip(steps=5)
    pd.run(dataclasses.replace(case, history={"look": Look()}, results=None), output=place)
    assert len(held) == 12
    assert [sum(name.startswith("step_") for name in file) for file in held[::2]] == [1, 2, 3, 4, 5, 6]
    for file in held:
        file.close()
    script = f"import h5py, time\nf = h5py.File({str(place / 'fields.h5')!r})\nprint(1, flush=True)\ntime.sleep(60)"
    reader = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, env=environment)
    reader.stdout.readline()
    finished = run(scene, "steps=2", "--quiet", output=place)
    reader.kill()
    assert finished.returncode == 0, finished.stderr


@pytest.mark.parametrize("torn", ["history.csv", pytest.param("broken_bonds.csv", marks=pytest.mark.long)])
def test_a_torn_row_costs_itself_only(torn, tmp_path):
    pd.run(strip(), output=tmp_path / "whole")
    place = tmp_path / "torn"
    with pytest.raises(pd.Interrupted):
        pd.run(stopped(0.9), output=place)
    with (place / torn).open("a") as file:
        file.write("3,0.99")
    pd.run(strip(), output=place, restart=place)
    for name in ("history.csv", "broken_bonds.csv"):
        assert (place / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()


def test_rows_are_taken_up_to_the_first_that_is_not_whole():
    for text, rows in (
        ("step,t\r\n0,0.0\r\n1,0.5\r\n", 2),
        ("step,t\r\n0,0.0\r\n1,0.5", 1),
        ("step,t\r\n0,0.0\r\n1\r\n2,1.0\r\n", 1),
        ("step,t\r\n0,0.0\r\n1,x\r\n", 1),
        ("step,t\r\n0,0.0\r\n\0\0\0\0\r\n", 1),
        ("step,t\r\n", 0),
        ("step,t", None),
        ("step,u\r\n0,0.0\r\n", None),
    ):
        found = rows_of(text, ["step", "t"])
        assert (None if found is None else len(found)) == rows, text
    assert rows_of(b"step,t\r\n0,0.0\r\n\xff\xfe,1\r\n".decode(errors="replace"), ["step", "t"]) == [[0.0, 0.0]]
    assert rows_of("", ["step", "t"]) is None


def test_a_summary_that_cannot_be_written_is_one_error_and_the_one_before_stays(tmp_path, monkeypatch):
    write_summary(world(), tmp_path, {"a": np.int64(3), "b": np.float32(0.5), "c": float("nan"), "d": np.arange(2)})
    before = (tmp_path / "summary.json").read_text()
    assert json.loads(before) == {"a": 3, "b": 0.5, "c": None, "d": [0, 1]}

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(pd.OutputError, match=r"Cannot write .*summary.json: No space left on device\."):
        write_summary(world(), tmp_path, {"a": 4})
    assert (tmp_path / "summary.json").read_text() == before
    assert [path.name for path in tmp_path.iterdir()] == ["summary.json"]


# Checkpoints that hold nonsense.


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """A body, and a checkpoint of it with damaged bonds."""
    place = tmp_path_factory.mktemp("saved")
    case = dataclasses.replace(strip(pull=0.4), material=pd.BondBased(E=10.0, kinematics="finite"))
    pd.run(case, output=place)
    with h5py.File(place / "checkpoint.h5") as file:
        shapes = {name: file[name].shape[1:] for name in ("u", "tangent", "bonds/keys", "bonds/states")}
    assert shapes == {"u": (2,), "tangent": (2,), "bonds/keys": (3,), "bonds/states": (2,)}
    cloud = make_cloud(world(), case)
    problem, order = make_problem(case, cloud, find_families(cloud)), InCreationOrder(cloud)
    return place / "checkpoint.h5", functools.partial(read_checkpoint, problem, order), declared_parts(case)


def changed(source, path, change):
    """Copy a checkpoint with a change made through h5py, with the right checksum."""
    shutil.copy(source, path)
    with h5py.File(path, "r+") as file:
        change(file)
    checkpoint.seal(path)


def attribute(name, value):
    return lambda file: file.attrs.__setitem__(name, value)


def said(**values):
    """Say something else at the head of a checkpoint, and nothing of a name for None."""

    def change(file):
        head = json.loads(file.attrs["head"]) | values
        file.attrs["head"] = json.dumps({name: value for name, value in head.items() if value is not None})

    return change


def entry(name, place, value):
    def change(file):
        values = file[name][:]
        values[place] = value
        file[name][:] = values

    return change


def instead(name, **options):
    """Replace a dataset by one of another kind."""

    def change(file):
        values = file[name][:]
        del file[name]
        file.create_dataset(name, **{"data": values, **options})

    return change


def read_text(file, name):
    return zlib.decompress(file[f"texts/{name}"][:].tobytes()).decode()


def text(file, name, words):
    """Put a text in place of another one."""
    file["texts"].pop(name, None)
    data = np.frombuffer(zlib.compress(words.encode()), np.uint8)
    file.create_dataset(f"texts/{name}", data=data)


def instead_of_text(file, name):
    file.create_dataset(f"texts/{name}", data=np.ones(3))


def linked(file):
    del file["u"]
    file["u"] = h5py.ExternalLink("elsewhere.h5", "/u")


def soft(file):
    file["v"] = file["u"]
    del file["u"]
    file["u"] = h5py.SoftLink("/v")


def virtual(file):
    shape = file["u"].shape
    del file["u"]
    layout = h5py.VirtualLayout(shape, np.float64)
    layout[:] = h5py.VirtualSource("elsewhere.h5", "u", shape)
    file.create_virtual_dataset("u", layout)


def outside(file):
    shape = file["u"].shape
    del file["u"]
    file.create_dataset("u", shape, np.float64, external=[("elsewhere.raw", 0, h5py.h5f.UNLIMITED)])


NONSENSE = {
    "t is no number": said(t=np.nan),
    "t beyond the end": said(t=2.0),
    "t before the start": said(t=-0.5),
    "t is text": said(t="now"),
    "step before the start": said(step=-1),
    "step of no run": said(step=2**62),
    "step that the run has not counted": said(step=2),
    "step is no whole number": said(step=1.5),
    "work is no number": said(work=np.inf),
    "resume a list": said(resume=[0.1]),
    "resume no number": said(resume={"load_step": np.nan}),
    "resume of text": said(resume={"load_step": "0.1"}),
    "resume truth": said(resume={"load_step": True}),
    "resume a matrix": said(resume=[[1.0]]),
    "cell": said(virtual=4 * [1.0]),
    "frozen": said(frozen=7),
    "head is no table": attribute("head", "[]"),
    "head is torn": attribute("head", '{"t": 0.5'),
    "format": attribute("format", 3),
    "format is text": attribute("format", "five"),
    "format is an array": attribute("format", np.array([5, 5])),
    "declared": said(declared="{"),
    "declared a list": said(declared=[]),
    "steps": entry("texts/steps", 0, ord("{")),
    "a step too few": lambda file: text(file, "steps", json.dumps(json.loads(read_text(file, "steps"))[:-1])),
    "steps of numbers": lambda file: text(file, "steps", "[1, 2, 3]"),
    "no steps": lambda file: file["texts"].__delitem__("steps"),
    "no texts": lambda file: file.__delitem__("texts"),
    "a text too many": lambda file: text(file, "more", "more"),
    "texts of numbers": lambda file: (file["texts"].__delitem__("history"), instead_of_text(file, "history")),
    "no t": said(t=None),
    "no head": lambda file: file.attrs.__delitem__("head"),
    "a name too many": said(more=1.0),
    "group too many": lambda file: file.create_group("more"),
    "no u": lambda file: file.__delitem__("u"),
    "no bonds": lambda file: file.__delitem__("bonds"),
    "no states": lambda file: file["bonds"].__delitem__("states"),
    "u is a group": lambda file: (file.__delitem__("u"), file.create_group("u")),
    "bonds is a dataset": lambda file: (file.__delitem__("bonds"), file.create_dataset("bonds", data=1.0)),
    "u no number": entry("u", (3, 1), np.nan),
    "integrity negative": entry("bonds/states", (0, 0), -5.0),
    "integrity above one": entry("bonds/states", (0, 0), 1.5),
    "integrity no number": entry("bonds/states", (0, 0), np.nan),
    "stretch no number": entry("bonds/states", (0, 1), np.inf),
    "end that is no particle": entry("bonds/keys", (0, 1), 40),
    "end before the first": entry("bonds/keys", (0, 0), -1),
    "bond that is none": entry("bonds/keys", (0, 1), 39),
    "bond twice": lambda file: entry("bonds/keys", 1, file["bonds/keys"][0])(file),
    "u of another type": instead("u", dtype=np.float32),
    "u transposed": lambda file: instead("u", data=file["u"][:].T)(file),
    "u too short": lambda file: instead("u", data=file["u"][:-1])(file),
    "keys of another type": instead("bonds/keys", dtype=np.float64),
    "states too short": lambda file: instead("bonds/states", data=file["bonds/states"][:-1])(file),
    "u elsewhere": linked,
    "u another name": soft,
    "tangent no number": entry("tangent", (0, 0), np.inf),
    "tangent too short": lambda file: instead("tangent", data=file["tangent"][:-1])(file),
    "tangent of a cell": said(tangent_virtual=[1.0, 1.0]),
    "u put together": virtual,
    "u in another file": outside,
}


@pytest.mark.parametrize("name", NONSENSE)
def test_nonsense_in_a_checkpoint_is_refused(name, saved, tmp_path):
    source, read, declared = saved
    (tmp_path / "elsewhere.raw").write_bytes(bytes(640))
    changed(source, tmp_path / "c.h5", NONSENSE[name])
    with pytest.raises(pd.CaseError) as caught:
        read(tmp_path / "c.h5", declared)
    assert "\n" not in str(caught.value) and str(caught.value).endswith("."), caught.value


def test_a_change_without_a_checksum_is_refused(saved, tmp_path):
    source, read, declared = saved
    shutil.copy(source, tmp_path / "c.h5")
    with h5py.File(tmp_path / "c.h5", "r+") as file:
        said(t=0.5)(file)
    with pytest.raises(pd.CaseError, match="it is damaged"):
        read(tmp_path / "c.h5", declared)


def ball():
    """Irregular particles that know their surface, so that a run writes it."""
    nodes, cells = [(-1.0, 0.0), (0.0, 0.0), (1.5, 0.0)], [0, 1]
    x, volume = [[-0.5], [0.75]], [1.0, 1.5]
    facets = pd.Facets([[nodes[0][0]], [nodes[-1][0]]], [[-1.0], [1.0]], cells)
    body = pd.Arrays(x, volume, facets=facets)
    return pd.Case(body, 3.0, pd.BondBased(1.0), [pd.Displacement(pd.region.All(), x=0.0)])


SUMMARIES = {
    "results": [1], "doubts": {"a": 3}, "dimension": 7, "thickness": "thin", "horizon": [1.0], "cuts": [3],
    "cracks": {"a": 1}, "steps": [1], "timings": {"solve": "long"}, "peak_memory_bytes": 3, "status": 5,
    "parameters": "n=1", "checks": {"a": 1},
}  # fmt: skip


def test_what_is_no_summary_and_no_surface_is_one_sentence(tmp_path, rng):
    result = pd.run(ball(), output=tmp_path)
    inside = [[0.5]]
    assert np.allclose(pd.open(tmp_path).sample(inside), result.sample(inside))
    summary, surface = tmp_path / "summary.json", tmp_path / "fields" / "surface.h5"
    right, whole = json.loads(summary.read_text()), surface.read_bytes()
    for name, value in SUMMARIES.items():
        summary.write_text(json.dumps(right | {name: value}))
        with pytest.raises(pd.CaseError, match=name) as caught:
            pd.open(tmp_path)
        assert "\n" not in str(caught.value)
    for text in ('{"results": {"a": 1' + 400 * "0" + "}}", 100_000 * "[" + 100_000 * "]"):
        summary.write_text(text)
        with pytest.raises(pd.CaseError):
            pd.open(tmp_path)
    summary.write_text(json.dumps(right | {"cuts": [{"kind": "Segment", "middle": 3}]}))
    with pytest.raises(pd.CaseError, match="a crack that cannot be read"):
        pd.open(tmp_path).sample(inside)
    summary.write_text(json.dumps(right))
    with h5py.File(surface, "r+") as file:
        del file["area"]
        file["area"] = np.ones(3)
    checkpoint.seal(surface)
    with pytest.raises(pd.CaseError, match=r"surface.h5: it holds no facets; run the case again"):
        pd.open(tmp_path).sample(inside)
    for place in [*range(0, 64, 5), *range(200, len(whole), 41)]:
        surface.write_bytes(whole[:place] + bytes([whole[place] ^ 255]) + whole[place + 1 :])
        with pytest.raises(pd.CaseError, match=r"surface.h5: .*; run the case again, or remove the file"):
            pd.open(tmp_path).sample(inside)
    surface.unlink()
    assert np.allclose(pd.open(tmp_path).sample(inside), 0.0)


def test_flipped_bits_are_refused(saved, tmp_path, rng):
    source, read, declared = saved
    whole, path = source.read_bytes(), tmp_path / "c.h5"
    for n in range(200):
        bad = bytearray(whole)
        place = int(rng.integers(len(bad)))
        bad[place] ^= 1 << int(rng.integers(8))
        if n % 10 == 0:
            bad = bad[:place]
        path.write_bytes(bad)
        with pytest.raises(pd.CaseError, match=r"Cannot read the checkpoint|not a checkpoint"):
            read(path, declared)
    assert read(source, declared).start.step == 3


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("/dev/zero", "it is not a file"),
        ("nowhere", "No such file"),
        (".", "holds none"),
        ("text.h5", "it is none of pdpetsc"),
        ("fifo", "it is not a file"),
    ],
)
def test_a_path_that_is_no_checkpoint(words, message, saved, tmp_path):
    _, read, declared = saved
    (tmp_path / "text.h5").write_text("Dear diary")
    os.mkfifo(tmp_path / "fifo")
    with pytest.raises(pd.CaseError, match=message):
        read(words if words.startswith("/") else tmp_path / words, declared)


# What a continued run computes.


@pytest.mark.long
def test_a_restart_before_damage_goes_the_same_way_to_the_last_digit(tmp_path):
    """Bonds that soften in many sweeps magnify whatever differs where they begin, to 1e-5 of the fields."""
    sys.path.append(str(ROOT / "runs/fracture"))
    import plate_with_hole

    fields = [pd.displacement, pd.stress, pd.reaction, pd.local_damage, pd.energy_density]
    plate = plate_with_hole.case(law="linear", steps=15)
    plate = dataclasses.replace(
        plate, material=pd.BondBased(E=210e3, kinematics="finite"), scheme=None, control=None,
        fields=fields, picture=None,
    )  # fmt: skip
    runs = [("whole", 0.3, {})]
    for after in (0.05, 0.15):
        part, rest = f"part_{after}", f"rest_{after}"
        runs += [(part, after, {}), (rest, 0.3, {"restart": tmp_path / part})]
    for name, end, words in runs:
        case = dataclasses.replace(plate, history={**plate.history, "until": Stop(end)})
        with pytest.raises(pd.Interrupted):
            pd.run(case, output=tmp_path / name, **words)
    assert summary(tmp_path / "whole")["steps"][3]["sweeps"] > 30
    for after in (0.05, 0.15):
        with h5py.File(tmp_path / "whole/fields.h5") as one, h5py.File(tmp_path / f"rest_{after}/fields.h5") as other:
            steps = [name for name in other if name.startswith("step_")]
            assert len(steps) > 1 and set(steps) < set(one)
            for step in steps:
                for name in one[step]:
                    a, b = np.asarray(one[step][name]), np.asarray(other[step][name])
                    assert np.abs(a - b).max() <= 1e-12 * np.abs(a).max(), (step, name)


@pytest.mark.long
def test_work_goes_on_with_the_forces_at_the_start(tmp_path):
    """They are those with the bonds as they were, not as they are after the next step."""
    for name, history_ in (("whole", strip().history), ("bare", {"work": pd.ExternalWork()})):
        case = dataclasses.replace(strip(steps=6), history=history_, results=None)
        pd.run(case, output=tmp_path / name)
        part = {**history_, "until": Stop(0.2)}
        with pytest.raises(pd.Interrupted):
            pd.run(dataclasses.replace(case, history=part), output=tmp_path / f"{name} part")
        pd.run(case, output=tmp_path / f"{name} rest", restart=tmp_path / f"{name} part")
        one, other = (
            np.genfromtxt(tmp_path / f"{name}{end}" / "history.csv", delimiter=",", names=True)["work"]
            for end in ("", " rest")
        )
        assert np.allclose(one[-len(other) :][1:], other[1:], rtol=1e-12)


# Fields.


def test_fields_have_the_names_of_a_mapping(tmp_path):
    fields = {"share": lambda solution: solution.volume, "flags": lambda solution: solution.x[:, 0] > 5.0}
    pd.run(dataclasses.replace(strip(), fields=fields), output=tmp_path)
    grid = ET.parse(tmp_path / "fields.xdmf").getroot().find(".//Grid[@GridType='Uniform']")
    items = {a.get("Name"): a.find("DataItem") for a in grid.findall("Attribute")}
    assert set(items) == {"volume", "share", "flags"}
    assert items["flags"].get("NumberType") == "UInt" and items["flags"].get("Precision") == "1"
    with h5py.File(tmp_path / "fields.h5") as file:
        assert file["step_00003/share"].shape == (40,)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ([lambda s: s.u, lambda s: s.x], "no name for files"),
        ([functools.partial(pd.displacement)], "no name for files"),
        ({"a": lambda s: np.zeros(3)}, "numbers for each of 40 particles"),
        ({"a": lambda s: np.zeros((40, 4))}, "must be \\(40,\\)"),
        ({"a": lambda s: np.full(40, "a")}, "must return numbers"),
    ],
)
def test_fields_that_cannot_be_written_are_refused_before_the_first_step(fields, message, tmp_path):
    with pytest.raises(pd.CaseError, match=message):
        # Some are refused when the case is made, some when they are tried on the body.
        pd.run(dataclasses.replace(strip(), fields=fields), output=tmp_path)


def test_tensors_with_an_out_of_plane_component_are_written_as_they_are(rng):
    whole = rng.standard_normal((5, 3, 3))
    assert np.array_equal(storable(whole), whole.reshape(5, 9))
    plane = storable(whole[:, :2, :2]).reshape(5, 3, 3)
    assert np.array_equal(plane[:, :2, :2], whole[:, :2, :2])
    assert np.all(plane[:, 2] == 0.0) and np.all(plane[:, :, 2] == 0.0)


def test_adding_a_step_costs_the_same_late_as_early(tmp_path, monkeypatch):
    """Beside copies of bytes: one step more is described once and linked once, however many there are."""
    parts = [part_of("displacement", (40, 3), np.dtype(float)), part_of("stress", (40, 9), np.dtype(float))]
    index = Index(tmp_path, 40, [Step(n, n / 400, parts) for n in range(200)])
    made = []
    link, grid = h5py.ExternalLink, Index._grid
    monkeypatch.setattr(h5py, "ExternalLink", lambda file, path: made.append(file) or link(file, path))
    monkeypatch.setattr(Index, "_grid", lambda self, step: made.append(step.number) or grid(self, step))
    step = Step(200, 0.5, parts)
    index.add(step)
    assert made == [step.file, 200]
    monkeypatch.undo()
    with h5py.File(tmp_path / "fields.h5") as file:
        assert len(file) == 202
    assert len(ET.parse(tmp_path / "fields.xdmf").getroot().findall(".//Grid[@GridType='Uniform']")) == 201


class Judged(pd.Quantity):
    """The broken bonds; to doubt them fails beyond half of the load, and says how often they were evaluated before."""

    def __init__(self):
        self.evaluated = []

    def evaluate(self, solution):
        self.evaluated.append(solution.step)
        return pd.BrokenBonds().evaluate(solution)

    def doubt(self, solution):
        if solution.t > 0.5:
            raise ValueError("faces between its cells are unknown")
        return ""


@pytest.mark.long
def test_a_diagnostic_that_fails_costs_nothing_that_is_computed(tmp_path):
    pd.run(strip(), output=tmp_path / "whole")
    judged = Judged()
    case = strip()
    with pytest.raises(pd.RunError, match="faces between its cells are unknown"):
        pd.run(dataclasses.replace(case, history={**case.history, "broken": judged}), output=tmp_path / "part")
    assert judged.evaluated == [0, 0, 1, 2]  # tried once, then once a step
    assert history(tmp_path / "part").splitlines() == history(tmp_path / "whole").splitlines()[:4]
    with h5py.File(tmp_path / "part" / "checkpoint.h5") as file:
        assert json.loads(file.attrs["head"])["step"] == 2
    pd.run(case, output=tmp_path / "rest", restart=tmp_path / "part")
    assert history(tmp_path / "rest") == history(tmp_path / "whole")


# What stays in the folder.


@pytest.mark.long
def test_a_restart_with_other_columns_keeps_the_earlier_table(tmp_path):
    with pytest.raises(pd.Interrupted):
        pd.run(stopped(0.5), output=tmp_path)
    before = history(tmp_path)
    pd.run(dataclasses.replace(strip(), history={"E": pd.StrainEnergy()}, results=None), output=tmp_path,
           restart=tmp_path)  # fmt: skip
    assert (tmp_path / "earlier" / "history.csv").read_text() == before


@pytest.mark.parametrize("kind", [np.float32, np.int64, int, bool, np.array])
def test_numbers_of_any_type_are_numbers(kind, tmp_path):
    class Two(pd.Quantity):
        def evaluate(self, solution):
            return kind(1)

    case = dataclasses.replace(strip(), history={"two": Two()}, results=lambda h: {"rows": float(len(h["two"]))})
    whole = pd.run(case, output=tmp_path)
    again = pd.run(case, output=tmp_path, restart=tmp_path)
    assert whole == again
    assert history(tmp_path).splitlines()[1].endswith(",1.0")


def test_files_of_others_under_the_same_names_are_not_moved(tmp_path):
    for name, content in (
        ("picture.png", b"\x89PNG of somebody"),
        ("history.csv", b"step,temperature\n1,2\n"),
        ("summary.json", b'{"status": "mine", "parameters": {}}'),
    ):
        place = tmp_path / name.split(".")[0]
        place.mkdir()
        (place / name).write_bytes(content)
        with pytest.raises(pd.CaseError, match="was not written by pdpetsc"):
            pd.run(strip(), output=place)
        assert (place / name).read_bytes() == content


def said_at_the_end(caplog):
    """Return what a run says of all of its steps: pieces, forces left, unstable equilibria."""
    words = [record.getMessage() for record in caplog.records if not record.getMessage().startswith("step ")]
    return [line for line in words if "last load" in line or "unstable" in line or "piece" in line]


@pytest.mark.parametrize("killed", [False, True], ids=["stopped", "killed"])
def test_what_is_counted_goes_on_from_the_checkpoint(killed, caplog, tmp_path):
    """Steps, forces, work, unstable equilibria: those of the run in one go, after two restarts in the same folder."""
    case = dataclasses.replace(
        strip(steps=8, pull=0.9),
        history={
            "force": pd.Reaction("x", pd.region.Slab("x", high=1.0)),
            "work": pd.ExternalWork(), "lost": pd.DissipatedEnergy(), "broken": pd.BrokenBonds(),
        },
        results=lambda history: {"peak": max(history["force"], key=abs), "lost": history["lost"][-1]},
    )  # fmt: skip
    caplog.set_level("INFO", "pdpetsc")
    whole = pd.run(case, output=tmp_path / "whole")
    expected = said_at_the_end(caplog)
    assert any("the last load is" in line for line in expected)
    out = tmp_path / "parts"
    for at, again in ((0.4, {}), (0.7, {"restart": out})):
        stopping = dataclasses.replace(case, history={**case.history, "broken": Counting(at)})
        with pytest.raises(pd.Interrupted):
            pd.run(stopping, output=out, **again)
        if killed:
            (out / "summary.json").write_text(json.dumps({**summary(out), "status": "running", "steps": []}))
    caplog.clear()
    rest = pd.run(case, output=out, restart=out)
    assert said_at_the_end(caplog) == expected
    assert rest.results == whole.results
    assert (out / "history.csv").read_bytes() == (tmp_path / "whole" / "history.csv").read_bytes()
    assert (out / "broken_bonds.csv").read_bytes() == (tmp_path / "whole" / "broken_bonds.csv").read_bytes()
    one, other = whole.summary, rest.summary
    assert other["pieces"] == one["pieces"] and other.get("detached_particles") == one.get("detached_particles")
    assert other["restart"]["step"] == 6
    assert [dict(step, norms=0) for step in other["steps"]] == [dict(step, norms=0) for step in one["steps"]]
    page = write_report(out).read_text()
    assert "since the restart at step 6." in page
    assert "no record of the steps before" not in page and "<p>8 steps," in page


def test_a_checkpoint_alone_is_enough(caplog, tmp_path):
    """History, broken bonds and the records of all steps are those of the run in one go."""
    family_strain = {"pull": 0.9, "steps": 4}
    whole = pd.run(strip(**family_strain), output=tmp_path / "whole")
    with pytest.raises(pd.Interrupted):
        pd.run(stopped(0.6, **family_strain), output=tmp_path / "part")
    (tmp_path / "alone").mkdir()
    shutil.copy(tmp_path / "part" / "checkpoint.h5", tmp_path / "alone")
    rest = pd.run(strip(**family_strain), output=tmp_path / "rest", restart=tmp_path / "alone")
    warned = [record.getMessage() for record in caplog.records if record.levelname == "WARNING"]
    assert not any("know of nothing before" in line for line in warned)
    for name in ("history.csv", "broken_bonds.csv"):
        assert (tmp_path / "rest" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
    assert [dict(step, norms=0) for step in rest.summary["steps"]] == [
        dict(step, norms=0) for step in whole.summary["steps"]
    ]
    assert rest.results == whole.results


def test_a_history_of_other_columns_warns_that_results_know_nothing_before(caplog, tmp_path):
    """Bonds that broke in a run without their table are listed all the same, at the step of the checkpoint."""
    family_strain = {"pull": 0.9, "steps": 4}
    pd.run(strip(**family_strain), output=tmp_path / "whole")
    with pytest.raises(pd.Interrupted):
        pd.run(stopped(0.6, **family_strain), output=tmp_path / "part")
    changed(tmp_path / "part" / "checkpoint.h5", tmp_path / "c.h5", lambda file: text(file, "broken_bonds", "step\n"))
    other = dataclasses.replace(strip(**family_strain), history={"E": pd.StrainEnergy()}, results=None)
    pd.run(other, output=tmp_path / "rest", restart=tmp_path / "c.h5")
    warned = [record.getMessage() for record in caplog.records if record.levelname == "WARNING"]
    assert any("know of nothing before" in line for line in warned)
    header = ["step", "t", "i", "j", "length", "x", "y"]
    listed = [rows_of((tmp_path / name / "broken_bonds.csv").read_text(), header) for name in ("whole", "rest")]
    assert len(listed[0]) > 10 and min(row[0] for row in listed[1]) == 3
    assert sorted(row[2:] for row in listed[1]) == sorted(row[2:] for row in listed[0])
    at = pd.grid((0.2, 0.2), (9.8, 3.8), (40, 8))
    values = [pd.open(tmp_path / name).sample(at) for name in ("whole", "rest")]
    assert np.allclose(*values, rtol=0.0, atol=1e-12)
