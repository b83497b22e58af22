"""Ranks that stay: runs on several ranks without starting Python and MPI anew for each.

A test process starts ``mpirun`` once for each number of ranks that it needs. Every rank waits at a pipe of its own,
which costs nothing (in MPI it would wait at full speed), does what it is asked together with the others and answers.
The ranks end with the process that asks them, and are started anew where one of them failed.
"""

import atexit
import contextlib
import ctypes
import dataclasses
import json
import os
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from pathlib import Path

ROOT = Path(__file__).parent.parent
# How long a start may take, in which kernels may be compiled besides [s].
START = 300.0
# How many ranks are there from when they are first asked for; of other numbers only the last ones are.
KEPT = (1, 2)

_started = {}


class Ranks:
    """``size`` ranks that wait for what they are asked."""

    def __init__(self, size):
        self.size = size
        self.folder = Path(tempfile.mkdtemp(prefix="ranks-"))
        self.ask, self.answers = ([self._pipe(f"{way}_{rank}") for rank in range(size)] for way in ("ask", "answer"))
        self.rest = [b""] * size
        words = [] if size == 1 else [str(ROOT / ".ci" / "mpirun"), str(size)]
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
        with (self.folder / "said").open("w") as said:
            self.process = subprocess.Popen(
                [*words, sys.executable, "-m", "tests.ranks", str(self.folder)],
                cwd=ROOT, env=environment, stdin=subprocess.DEVNULL, stdout=said, stderr=said, start_new_session=True,
            )  # fmt: skip

    def _pipe(self, name):
        os.mkfifo(self.folder / name)
        return os.open(self.folder / name, os.O_RDWR)

    def asked(self, request, timeout):
        """Return what each rank answers; raises AssertionError where one does not."""
        end = time.monotonic() + timeout + START
        for pipe in self.ask:
            os.write(pipe, json.dumps(request).encode() + b"\n")
        answers = [None] * self.size
        while None in answers:
            ready, _, _ = select.select(self.answers, [], [], 0.5)
            for rank in (self.answers.index(pipe) for pipe in ready):
                self.rest[rank] += os.read(self.answers[rank], 65536)
                if b"\n" in self.rest[rank]:
                    line, self.rest[rank] = self.rest[rank].split(b"\n", 1)
                    answers[rank] = json.loads(line)
                    # The others may wait for this one in MPI.
                    assert "failed" not in answers[rank], f"On rank {rank}: {answers[rank]['failed']}"
            if not ready:
                ended = self.process.poll() is not None
                assert not ended, f"The ranks ended: {(self.folder / 'said').read_text()[-4000:]}"
                assert time.monotonic() < end, f"Not all of {self.size} ranks answer."
        return answers

    def end(self):
        """End the ranks, whatever they do."""
        for pipe in (*self.ask, *self.answers):
            os.close(pipe)
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.process.wait(5.0 if self.size == 1 else 10.0)
        if self.process.poll() is None:
            os.killpg(self.process.pid, signal.SIGKILL)
            self.process.wait()
        shutil.rmtree(self.folder, ignore_errors=True)


def asked(size, request, timeout=300.0):
    """Ask ``size`` ranks; return their answers in the order of ranks."""
    if size not in _started:
        for other in [other for other in _started if other not in KEPT and size not in KEPT]:
            _started.pop(other).end()
        _started[size] = Ranks(size)
    try:
        return _started[size].asked(request, timeout)
    except BaseException:
        ranks = _started.pop(size)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(ranks.process.pid, signal.SIGKILL)
        ranks.end()
        raise


@atexit.register
def _end_all():
    while _started:
        _started.popitem()[1].end()


# What the ranks do.


def run_case(words, output):
    """Run a case in this process as the command line does, with options of PETSc for this run alone."""
    import pdpetsc as pd
    from pdpetsc.command_line.cli import arguments_of, load_case, split
    from pdpetsc.declare.choice import choose
    from pdpetsc.declare.solvers import SOLVERS

    asked = split(words)
    function = load_case(asked.path)
    parameters = arguments_of(function, asked.parameters)
    case = function(**parameters)
    if (solver := asked.value("--solver")) is not None:
        case = dataclasses.replace(case, solver=choose("--solver", solver, SOLVERS))
    options = {}
    for word in asked.petsc:
        if word.startswith("-") and not word[1:2].isdigit():
            name = word[1:]
            options[name] = None
        else:
            options[name] = word
    pd.run(
        case, output, options=options, parameters=parameters, restart=asked.value("--restart"),
        restart_anyway="--restart-anyway" in asked.flags, check="--check" in asked.flags,
    )  # fmt: skip


def _run(words, output):
    said = {}
    with _caught(said), _without_what_it_imports(words[0]):
        run_case(words, output)
    return said


def _command(words, folder):
    """Call the command line as a process of its own would; return its exit status and what it wrote."""
    from pdpetsc.command_line.cli import main

    before, said = os.getcwd(), {"status": None}
    with _caught(said), _without_what_it_imports(Path(folder, words[0])):
        try:
            os.chdir(folder)
            main(words)
        except SystemExit as end:
            said["status"] = end.code
        finally:
            signal.alarm(0)  # which main sets for the end of MPI
            os.chdir(before)
    return said


def _script(text, words):
    """Execute a script; what it raises, and an exit status other than 0, fails."""
    before, said = sys.argv, {}
    with _caught(said):
        try:
            sys.argv = ["script", *words]
            exec(compile(text, "script", "exec"), {"__name__": "__main__"})
        except SystemExit as end:
            assert not end.code, f"exit status {end.code}"
        finally:
            sys.argv = before
    return said


@contextlib.contextmanager
def _caught(said):
    """Put what this process writes meanwhile, PETSc as well, into ``said``."""
    kept = [os.dup(1), os.dup(2)]
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        os.dup2(out.fileno(), 1)
        os.dup2(err.fileno(), 2)
        try:
            yield
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            ctypes.CDLL(None).fflush(None)
            for number, copy in enumerate(kept, 1):
                os.dup2(copy, number)
                os.close(copy)
            for name, file in (("stdout", out), ("stderr", err)):
                file.seek(0)
                said[name] = file.read().decode()


@contextlib.contextmanager
def _without_what_it_imports(case):
    """Forget the modules beside a case file: the next one may have others of the same names."""
    path, modules = list(sys.path), set(sys.modules)
    places = [ROOT / "runs", *([Path(case).parent.resolve()] if str(case).endswith(".py") else [])]
    try:
        yield
    finally:
        sys.path[:] = path
        for name in set(sys.modules) - modules:
            file = getattr(sys.modules[name], "__file__", None)
            if file and any(Path(file).is_relative_to(place) for place in places):
                del sys.modules[name]


def _serve(folder):
    import petsc4py

    petsc4py.init(["pytest"])
    rank = os.environ.get("OMPI_COMM_WORLD_RANK", "0")
    with open(folder / f"ask_{rank}") as asked, open(folder / f"answer_{rank}", "w") as answers:
        for line in asked:
            request = json.loads(line)
            try:
                answer = {"run": _run, "command": _command, "script": _script}[request.pop("what")](**request)
            except Exception:
                answer = {"failed": traceback.format_exc()}
            print(json.dumps(answer), file=answers, flush=True)


if __name__ == "__main__":
    _serve(Path(sys.argv[1]))
