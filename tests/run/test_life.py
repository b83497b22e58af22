"""The life of a run: what ends it ends all of it soon, on any ranks, with one sentence and a status."""

import contextlib
import importlib.util
import json
import os
import pickle
import signal
import subprocess
import sys
import textwrap
import time

import pytest

import pdpetsc as pd
from pdpetsc.command_line.cli import load_case
from pdpetsc.errors import FlatFamilies, described, notice, of_petsc, rebuilt
from pdpetsc.kernels.compile import cache_lock, cache_trouble, compiled
from tests.commands import ROOT, called, command, results, wait_until

# How long a job may take that fails on one rank; what is tested is that it does not wait for ever.
SOON = 60.0

CASE = """
    import os
    import sys
    import time
    import numpy as np
    import pdpetsc as pd
    from mpi4py import MPI

    HERE = MPI.COMM_WORLD.rank


    class Mine(pd.CaseError):
        def __init__(self, one, two):
            super().__init__(one + two)


    def fail(what):
        if what == "divides":
            1 / 0
        if what == "memory":
            raise MemoryError
        if what == "os":
            raise OSError(28, "No space left on device")
        if what == "exits":
            sys.exit(0)
        if what == "case":
            raise Mine("the field ", "is wrong")
        if what == "petsc":
            from petsc4py import PETSc
            PETSc.Vec().createSeq(3, comm=PETSc.COMM_SELF).setType("nothing")
        if what == "waits":
            with open(f"{os.environ['PIDS']}/{HERE}", "w") as file:
                file.write(str(os.getpid()))
            time.sleep(30.0 if HERE == 0 else 0.0)


    def case(where="", what="divides", rank=-1, steps=4, n=4, options="{}"):
        def maybe(place):
            if place == where and (rank < 0 or HERE == rank):
                fail(what)

        class Lattice(pd.Lattice):
            def chunk(self, rank, size):
                maybe("particles")
                return super().chunk(rank, size)

        class Slab(pd.region.Slab):
            def mask(self, view):
                maybe("set-up")
                return super().mask(view)

        class Influence(pd.influence.Influence):
            def __call__(self, r):
                maybe("model")
                return np.ones_like(r)

        def pull(x, t):
            if 0.6 < t < 1.0:
                maybe("solve")
            return np.full(len(x), 0.1 * t)

        def field(solution):
            if solution.t > 0.6:
                maybe("output")
            maybe("declared")
            return solution.volume

        class Number(pd.StrainEnergy):
            def evaluate(self, solution):
                if solution.t > 0.6:
                    maybe("history")
                return super().evaluate(solution)

        def results(history):
            maybe("results")
            return {"text": {"a": "b"}, "nan": {"a": float("nan")}, "list": [1.0]}.get(where, {"t": history["t"][-1]})

        maybe("case")
        dx = 1.0 / n
        return pd.Case(
            particles=Lattice((0.0, 0.0), (2.0, 1.0), dx), horizon=2.015 * dx, influence=Influence(),
            material=pd.Hencky(E=1.0, nu=0.3),
            conditions=[
                pd.Displacement(Slab("x", high=dx), x=0.0, y=0.0),
                pd.Displacement(pd.region.Slab("x", low=2.0 - dx), x=pull),
            ],
            steps=pd.Steps(steps), fields=[field], history={"E": Number()}, results=results,
            picture=pd.Picture(field, "xyz" if where == "component" else ""), options=eval(options),
        )
"""


@pytest.fixture
def case(tmp_path):
    path = tmp_path / "case.py"
    path.write_text(textwrap.dedent(CASE))
    return path


def ended(case, *words, ranks=1, output=None, within=SOON, **variables):
    """Run a case to its end, in time; return exit status, the sentences of stderr, all of stderr and the summary."""
    output = case.parent / "out" if output is None else output
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", **variables}
    before = time.monotonic()
    finished = subprocess.run(
        command(case, "--quiet", *words, ranks=ranks, output=output), cwd=case.parent, env=environment,
        capture_output=True, text=True, timeout=100, check=False,
    )  # fmt: skip
    assert time.monotonic() - before < within
    return finished.returncode, sentences(finished.stderr), finished.stderr, summary(output)


def answered(case, *words, ranks=1):
    """Run a case on ranks that are there already, which is quicker; return as ``ended``."""
    output = case.parent / "out"
    finished = called(case, "--quiet", *words, "-o", output, ranks=ranks, cwd=case.parent)
    return finished.returncode, sentences(finished.stderr), finished.stderr, summary(output)


def sentences(text):
    return [line for line in text.splitlines() if line.startswith("pdpetsc: ")]


def summary(folder):
    path = folder / "summary.json"
    return json.loads(path.read_text()) if path.exists() else {}


def one_sentence(found, status, words):
    code, said, stderr, _ = found
    assert code == status, stderr
    assert len(said) == 1, stderr
    assert words in said[0]
    assert "Traceback" not in stderr and "PETSC ERROR" not in stderr


ALONE = [
    ("particles", "divides"), ("set-up", "case"), ("model", "exits"), ("declared", "divides"), ("solve", "memory"),
    ("output", "os"), ("history", "case"), ("results", "divides"), ("case", "exits"), ("solve", "petsc"),
]  # fmt: skip
# What ranks find together, which ends none of them.
AGREED = ("case", "particles", "set-up")
QUICK = {("set-up", "case", 2), ("output", "os", 2)}


@pytest.mark.parametrize(
    ("where", "what", "ranks"),
    [
        pytest.param(where, what, ranks, marks=[] if (where, what, ranks) in QUICK else pytest.mark.long)
        for where, what in ALONE
        for ranks in (2, 3)
    ],
)
def test_a_rank_that_fails_alone_ends_all(where, what, ranks, case):
    start = answered if where in AGREED else ended
    found = start(case, f"where={where}", f"what={what}", f"rank={ranks - 1}", ranks=ranks)
    # What ranks evaluate without others they agree on, and the case was not run then; else the others wait in MPI.
    status = 2 if where in ("particles", "case", "set-up", "model") else 1
    words = {
        "divides": "division by zero",
        "memory": "MemoryError" if where == "solve" else "out of memory",
        "os": "No space left",
        "exits": "sys.exit",
    }
    one_sentence(found, status, words.get(what, {"case": "the field is wrong", "petsc": "nothing"}.get(what)))
    # What ranks agree on is an error of all of them: the parameters, particles, regions and conditions.
    if where not in (*AGREED, "solve"):
        assert f"Rank {ranks - 1}" in found[1][0]
    if where in ("solve", "output", "history", "results"):
        assert found[3]["status"] == found[1][0].removeprefix("pdpetsc: ")
        assert found[3]["results"] == {}
    if what == "divides":
        assert "case.py:19" in found[1][0]


@pytest.mark.parametrize("where", ["solve", "output", "results"])
def test_what_fails_on_all_ranks_leaves_a_checkpoint_and_a_summary(where, case):
    found = answered(case, f"where={where}", ranks=2 if where == "solve" else 1)
    # What a condition raises is told by the condition, with the step time.
    place = "At step time 0.75: The value of a Displacement condition pull failed at case.py:19"
    place = place if where == "solve" else f"in phase {where} at {case}:19 (fail)"
    one_sentence(found, 1, f"{place}: ZeroDivisionError")
    assert place in found[3]["status"]
    assert (case.parent / "out" / "checkpoint.h5").exists()
    assert len(found[3]["steps"]) == {"solve": 2, "output": 3, "results": 4}[where]


@pytest.mark.parametrize(
    ("where", "what", "words"),
    [("text", "", "'a' is str"), ("nan", "", "'a' is nan"), ("list", "", "not list"), ("results", "exits", "sys.exit")],
)
def test_results_must_be_numbers(where, what, words, case):
    folder = case.parent / "out"
    with pytest.raises(pd.RunError, match=words):
        pd.run(load_case(case)(where=where, what=what, steps=1), output=folder)
    assert "results" in summary(folder)["status"]
    assert len(summary(folder)["steps"]) == 1


@pytest.mark.parametrize(("where", "words"), [("declared", "division by zero"), ("component", "not 'xyz'")])
def test_what_is_declared_wrong_leaves_an_earlier_run_alone(where, words, case):
    folder = case.parent / "out"
    results(case, "steps=1", output=folder)
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    one_sentence(answered(case, f"where={where}", "steps=2"), 2, words)
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before


def test_the_summary_says_running_until_the_end(case):
    folder = case.parent / "out"
    words = command(case, "--quiet", "where=solve", "what=waits", output=folder)
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "PIDS": str(case.parent)}
    process = subprocess.Popen(words, env=environment)
    wait_for(case.parent / "0")
    assert summary(folder)["status"] == "running"
    process.kill()
    process.wait()
    assert summary(folder)["status"] == "running"
    assert summary(folder)["results"] == {}


@pytest.mark.parametrize("name", ["fields.h5", "history.csv", "checkpoint.h5", "summary.json"])
def test_a_folder_in_the_place_of_a_file_is_one_sentence(name, case):
    folder = case.parent / "out"
    (folder / name).mkdir(parents=True)
    code, said, stderr, _ = ended_in(case, folder)
    assert code == 2, stderr
    assert len(said) == 1
    assert f"{name} was not written by pdpetsc" in said[0]
    assert (folder / name).is_dir()


def ended_in(case, folder):
    """Run a case in this process; return as ``ended``, without a summary."""
    try:
        pd.run(load_case(case)(), output=folder)
    except pd.errors.PdpetscError as error:
        return error.exit_status, [str(error)], "", {}
    return 0, [], "", {}


def test_a_picture_that_cannot_be_drawn_is_a_warning(case):
    folder = case.parent / "out"
    # Where the picture is written before it takes its place.
    (folder / "picture.png.part").mkdir(parents=True)
    code, said, _, found = answered(case, "steps=1", ranks=2)
    assert code == 0
    assert len(said) == 1
    assert "its picture could not be drawn" in said[0]
    assert found["status"] == "converged"


@pytest.mark.parametrize("module_level", [True, False])
def test_a_case_file_cannot_end_the_run_as_if_it_were_right(module_level, case):
    if module_level:
        case.write_text("import sys\nsys.exit(0)\n")
        one_sentence(answered(case), 2, "called sys.exit in line 2")
    else:
        one_sentence(answered(case, "where=case", "what=exits"), 2, "called sys.exit in line 25")


def test_a_restart_from_a_folder_without_a_checkpoint_is_refused(case):
    one_sentence(answered(case, "--restart", str(case.parent)), 2, "checkpoint")


def test_errors_of_the_case_go_to_other_ranks_as_words():
    class Mine(pd.CaseError):
        exit_status = 2

        def __init__(self, one, two):
            super().__init__(one + two)

    for error in (
        Mine("a", "b"),
        FlatFamilies("flat", [1, 2]),
        pd.RunError("x", "y", "z", 3, True),
        pd.SolveError("s"),
    ):
        other = rebuilt(pickle.loads(pickle.dumps(notice(error))))
        assert str(other) == str(error)
        assert other.exit_status == error.exit_status
        assert isinstance(error, type(other))


def test_a_defect_of_pdpetsc_leaves_its_traceback_in_the_folder(case, monkeypatch):
    monkeypatch.setattr("pdpetsc.running.prepare.make_families", None)
    folder = case.parent / "out"
    with pytest.raises(pd.RunError, match="defect of pdpetsc") as caught:
        pd.run(load_case(case)(), output=folder)
    assert isinstance(caught.value.__cause__, TypeError)
    assert "TypeError" in (folder / "traceback.txt").read_text()


def test_run_raises_in_python_and_never_ends_the_process(case):
    function = load_case(case)
    for words, kind in (
        ({"where": "solve", "what": "exits"}, pd.RunError),
        ({"where": "results"}, pd.RunError),
        ({"where": "set-up", "what": "case"}, pd.CaseError),
        ({"options": "{'snes_max_it': 0}", "steps": 1}, pd.SolveError),
        ({"options": "{'-snes_max_it': 3}"}, pd.CaseError),
        ({"options": "{'ksp_type': 'nothing'}"}, pd.CaseError),
    ):
        with pytest.raises(kind):
            pd.run(function(**words), output=case.parent / "out")
    assert described(ZeroDivisionError("x")).bug


# Options: whose they are, and what becomes of those that are wrong.


@pytest.mark.long
def test_files_of_options_lying_about_are_not_read(case):
    (case.parent / ".petscrc").write_text("-snes_max_it 1\n-snes_rtol 1e-30\n")
    code, said, _, found = ended(case, HOME=str(case.parent), PETSC_OPTIONS="-snes_atol 1e-30")
    assert (code, said) == (0, [])
    assert found["options"]["snes_max_it"] == {"value": "30", "from": "pdpetsc"}
    assert found["options"]["snes_atol"] == {"value": "1e-30", "from": "environment"}
    script = "import pdpetsc.running.runner\nfrom petsc4py import PETSc\nprint(PETSc.Options().getAll())"
    words = [sys.executable, "-c", script]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    out = subprocess.run(words, cwd=case.parent, env=environment, capture_output=True, text=True, check=True).stdout
    assert "snes_max_it" not in out


def test_the_summary_names_the_options_and_those_that_nothing_used(case):
    options = "{'snes_rtol': 1e-9, 'snes_rtl': 1, 'ksp_type': 'gmres'}"
    code, said, _, found = ended(case, "steps=1", f"options={options}", "-ksp_type", "cg", "-snes_monitr")
    assert code == 0
    assert len(said) == 1
    assert "No solver used the options" in said[0]
    assert sorted(found["unused_options"]) == ["snes_monitr", "snes_rtl"]
    assert found["options"]["snes_rtol"] == {"value": "1e-09", "from": "case"}
    assert found["options"]["ksp_type"] == {"value": "cg", "from": "command line"}


REFUSED = {
    "-snes_rtol abc": "no numeric value",  # which is hexadecimal to Python, not to PETSc
    "-pc_factor_mat_solver_type nothing": "nothing",
    "-pc_type asm -sub_pc_type nothing": "PC type nothing",
    "-pc_type gamg -mg_levels_pc_type nothing": "PC type nothing",
    "-pc_type shell": "Shell PC",
    "-mat_mumps_icntl_14 abc": "no integer value",
    "-options_file /nowhere/x": "Cannot read the options of PETSc in /nowhere/x: no such file",
    "-snes_view :/nowhere/x": "-snes_view writes to /nowhere/x",
    "-log_view :/nowhere/x": "-log_view writes to /nowhere/x",
    "-pc_type python": "Python context",
}


@pytest.mark.long
@pytest.mark.parametrize("options", REFUSED)
def test_what_petsc_refuses_is_one_sentence(options, case):
    one_sentence(ended(case, *options.split()), 2, REFUSED[options])


@pytest.mark.long
@pytest.mark.parametrize("options", ["-log_view :/nowhere/x", "-pc_type shell"])
def test_what_petsc_refuses_is_one_sentence_on_two_ranks(options, case):
    one_sentence(ended(case, *options.split(), ranks=2), 2, REFUSED[options])


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"snes_rtol": float("nan")}, "-snes_rtol is nan; give it a number"),
        ({"snes_rtol": None}, "-snes_rtol has no value"),
        ({"snes_rtol": 0.5}, "-snes_rtol is 0.5: steps end with a residual of that share of the loads"),
        ({"snes_rtol": "10"}, "Use at most 0.01"),
        ({"snes_rtol": "inf"}, "Use at most 0.01"),
        ({"snes_rtol": "0x1p-1"}, "Use at most 0.01"),
        ({"mg_levels_ksp_max_it": ""}, "-mg_levels_ksp_max_it has no value"),
    ],
)
def test_an_option_that_needs_a_number_has_one(options, words):
    with pytest.raises(pd.CaseError, match=words):
        pd.prepare(bar(pd.region.Slab("x", low=7.0), options=options))


def test_a_path_needs_a_bond_that_can_fail():
    damage = pd.Brittle(pd.ConstantCritical(0.1), protected=pd.region.All())
    body = bar(pd.region.Slab("x", low=7.0), damage=damage, solver=pd.PathFollowing())
    with pytest.raises(pd.CaseError, match="all of them are protected"):
        pd.prepare(body).make_solver()


def bar(right, **more):
    ends = (
        pd.Displacement(pd.region.Slab("x", high=1.0), x=0.0),
        pd.Displacement(right, x=lambda x, t: 0.1 * t * x[:, 0]),
    )
    lattice = pd.Lattice((0.0,), (8.0,), 1.0)
    more = {"steps": pd.Steps(1), "fields": [], "history": {"E": pd.StrainEnergy()}, **more}
    return pd.Case(particles=lattice, horizon=2.015, material=pd.BondBased(E=1.0), conditions=ends, **more)


def test_an_iteration_that_is_asked_for_is_done(tmp_path):
    for options, least, most in (({}, 0, 0), ({"snes_force_iteration": None}, 1, 3)):
        pd.run(bar(pd.region.Slab("x", low=7.0)), output=tmp_path, options=options)
        (step,) = summary(tmp_path)["steps"]
        assert least <= step["newton_iterations"] <= most


def test_nothing_is_factored_where_every_displacement_is_prescribed(tmp_path):
    """A preconditioner that cannot be set up shows that none is."""
    rest = pd.region.Slab("x", low=1.0)
    with pytest.raises(pd.CaseError, match="Shell PC"):
        pd.run(bar(pd.region.Slab("x", low=7.0)), output=tmp_path, options={"pc_type": "shell"})
    pd.run(bar(rest), output=tmp_path, options={"pc_type": "shell"})
    (step,) = summary(tmp_path)["steps"]
    assert step["linear_iterations"] == 0
    assert float((tmp_path / "history.csv").read_text().split()[-1].split(",")[2]) > 0.0


# Signals and pipes.


def wait_for(path):
    wait_until(lambda: path.exists() and path.read_text(), path)


def taken(pid):
    """Return whether a process has taken the signals that it was sent; two of one kind that wait are one."""
    try:
        with open(f"/proc/{pid}/status") as file:
            return not any(int(line.split()[1], 16) for line in file if line.startswith(("SigPnd", "ShdPnd")))
    except OSError:  # ended
        return True


def signalled(case, number, where, ranks=1, to=(0,), again=False):
    """Start a job that waits in a phase and send a signal to ranks; return as ``ended``."""
    folder = case.parent / "out"
    words = command(case, "--quiet", f"where={where}", "what=waits", ranks=ranks, output=folder)
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "PIDS": str(case.parent)}
    pipes = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "text": True}
    process = subprocess.Popen(
        words,
        preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_DFL),  # tests may run under nohup
        env=environment,
        **pipes,
    )
    for rank in range(ranks):
        wait_for(case.parent / str(rank))
    time.sleep(0.3)
    before = time.monotonic()
    pids = [int((case.parent / str(rank)).read_text()) for rank in to]
    for _ in range(1 + again):
        for pid in pids:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, number)
            wait_until(lambda pid=pid: taken(pid), "The signal")
        time.sleep(0.6 if again else 0.0)
    _, stderr = process.communicate(timeout=100)
    assert time.monotonic() - before < 60.0
    return process.returncode, sentences(stderr), stderr, summary(folder)


@pytest.mark.parametrize(
    ("number", "where", "ranks", "to"),
    [
        (signal.SIGHUP, "case", 1, (0,)),
        pytest.param(signal.SIGINT, "particles", 1, (0,), marks=pytest.mark.long),
        (signal.SIGTERM, "particles", 2, (1,)),
        pytest.param(signal.SIGTERM, "particles", 2, (0, 1), marks=pytest.mark.long),
        pytest.param(signal.SIGTERM, "case", 3, (1,), marks=pytest.mark.long),
        pytest.param(signal.SIGINT, "particles", 3, (0, 1, 2), marks=pytest.mark.long),
    ],
)
def test_a_signal_in_the_set_up_ends_it_at_once(number, where, ranks, to, case):
    one_sentence(signalled(case, number, where, ranks, to), 1, "Stopped by a signal")


def test_a_second_signal_leaves_the_sentence_about_the_first(case):
    found = signalled(case, signal.SIGINT, "case", ranks=2, to=(0, 1), again=True)
    one_sentence(found, 1, "Stopped by a signal")


def test_a_second_signal_ends_a_solve_at_once(case):
    found = signalled(case, signal.SIGINT, "solve", again=True)
    one_sentence(found, 1, "Stopped by a signal in phase solve")
    assert found[3]["status"].startswith("Stopped by a signal")


def test_no_rank_outlives_mpirun(case):
    # In a field, which is asked of all ranks; a condition is not where a rank has none of its particles.
    words = command(case, "--quiet", "where=output", "what=waits", ranks=2, output=case.parent / "out")
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "PIDS": str(case.parent)}
    process = subprocess.Popen(words, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    for rank in range(2):
        wait_for(case.parent / str(rank))
    process.kill()
    process.wait()
    for rank in range(2):
        pid = int((case.parent / str(rank)).read_text())
        wait_until(lambda pid=pid: not running(pid), f"The end of rank {rank}", 25.0)


def running(pid):
    try:
        with open(f"/proc/{pid}/stat") as file:
            return file.read().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.long
@pytest.mark.parametrize(
    "to",
    [
        pytest.param("/dev/full", marks=pytest.mark.long),
        "| head -n 1",
        pytest.param("2>&1 | true", marks=pytest.mark.long),
    ],
)
def test_a_run_goes_on_when_nobody_reads_what_it_prints(to, case):
    folder = case.parent / "out"
    words = " ".join([*command(case, "-snes_monitor", output=folder), to])
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    shell = f"set -o pipefail; {words.replace('/dev/full', '> /dev/full')}"
    finished = subprocess.run(["bash", "-c", shell], env=environment, capture_output=True, text=True, check=False)
    assert finished.returncode == 0, finished.stderr
    assert "Traceback" not in finished.stderr
    assert summary(folder)["status"] == "converged"
    assert summary(folder)["results"] == {"t": 1.0}


# The cache of kernels.

KERNEL = """
    from pdpetsc.kernels.compile import compiled

    @compiled
    def twice(x):
        return 2.0 * x
"""


def kernel(folder):
    """Return a kernel whose module is read anew."""
    spec = importlib.util.spec_from_file_location("kernel", folder / "kernel.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.twice


@pytest.fixture
def cached(tmp_path, monkeypatch):
    (tmp_path / "kernel.py").write_text(textwrap.dedent(KERNEL))
    monkeypatch.setattr("numba.core.config.CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr("pdpetsc.kernels.compile._trouble", [])
    return tmp_path


@pytest.mark.parametrize("ending", ["nbi", "nbc"])
@pytest.mark.parametrize("content", [b"", b"nonsense", None])
def test_a_damaged_cache_is_compiled_anew_and_mended(ending, content, cached):
    assert kernel(cached)(2.0) == 4.0
    (path,) = (cached / "cache").rglob(f"*.{ending}")
    path.write_bytes(path.read_bytes()[:-100] if content is None else content)
    assert kernel(cached)(2.0) == 4.0
    assert cache_trouble()
    again = kernel(cached)
    assert again(2.0) == 4.0
    assert sum(again.stats.cache_hits.values()) == 1


def test_a_kernel_is_compiled_anew_where_another_one_has_changed(cached, monkeypatch):
    """It may call that one, whose machine code is then in its own."""
    assert kernel(cached)(2.0) == 4.0
    same = kernel(cached)
    assert same(2.0) == 4.0 and sum(same.stats.cache_hits.values()) == 1
    monkeypatch.setattr("pdpetsc.kernels.compile.sources", lambda: (("principal_rows.py", 1, 2),))
    other = kernel(cached)
    assert other(2.0) == 4.0 and sum(other.stats.cache_hits.values()) == 0


def test_a_full_disk_costs_the_cache_only(cached, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("numba.core.caching.IndexDataCacheFile._save_data", full)
    assert kernel(cached)(2.0) == 4.0
    assert "No space left" in cache_trouble()


def test_no_cache_at_all_costs_the_cache_only(cached, monkeypatch):
    monkeypatch.setattr("numba.core.caching.CacheImpl._locator_classes", [])
    assert kernel(cached)(2.0) == 4.0
    assert "no locator" in cache_trouble()


def test_the_log_says_how_long_and_how_often_kernels_are_compiled(cached, monkeypatch, caplog):
    def first_compilation(tell):
        tell()
        return contextlib.nullcontext()

    monkeypatch.setattr("pdpetsc.running.runner.first_compilation", first_compilation)
    monkeypatch.setattr("pdpetsc.running.runner.cache_trouble", lambda: "PermissionError: no")
    caplog.set_level("INFO", "pdpetsc")
    held = pd.Displacement(pd.region.All(), x=0.0, y=0.0)
    case = pd.Case(
        particles=pd.Lattice((0.0, 0.0), (4.0, 4.0), 1.0), material=pd.LinearElastic(E=1.0, nu=0.3), conditions=[held]
    )
    pd.run(case, cached / "out")
    said = [record.message for record in caplog.records]
    assert said[0] == "compiling kernels for this kind of case: 20 s to 2 min now, none in later runs ..."
    assert "cannot be written: PermissionError: no. Set NUMBA_CACHE_DIR to a folder of yours." in said[1]


def test_kernels_work_without_a_compiler(monkeypatch):
    """With NUMBA_DISABLE_JIT=1 numba gives the function itself."""

    def twice(x):
        return 2 * x

    monkeypatch.setattr("numba.config.DISABLE_JIT", True)
    assert compiled(twice) is twice


def test_the_lock_is_no_file_that_somebody_else_put_there(tmp_path, monkeypatch):
    beside, temporary = tmp_path / "cache", tmp_path / "tmp"
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(beside))
    monkeypatch.setattr("tempfile.tempdir", str(temporary))
    name = f"pdpetsc-{os.getuid()}.lock"
    precious = tmp_path / "precious"
    precious.write_text("keep")
    for folder in (beside, temporary):
        folder.mkdir()
        (folder / name).symlink_to(precious)
    with cache_lock():
        assert precious.read_text() == "keep"
    (temporary / name).unlink()
    with cache_lock():
        assert (temporary / name).stat().st_mode & 0o777 == 0o600


def test_a_file_system_without_locks_is_gone_on_without(tmp_path, monkeypatch):
    def refused(*_):
        raise OSError(37, "No locks available")

    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr("fcntl.flock", refused)
    with cache_lock():
        pass


def test_a_lock_that_is_never_given_back_is_waited_for_only_so_long(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr("pdpetsc.kernels.compile.LONGEST_WAIT", 0.2)
    with cache_lock(), cache_lock():
        pass


def test_errors_in_a_ring_are_looked_through_once():
    one, two = pd.OutputError("one"), pd.OutputError("two")
    one.__cause__, two.__cause__ = two, one
    assert not of_petsc(one)
