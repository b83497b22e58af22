"""Ranks that stay: runs on several ranks without starting Python and MPI anew for each.

A test process starts ``mpirun`` once for each number of ranks that it needs. Every rank waits at a pipe of its own, which
costs nothing (in MPI it would wait at full speed), does what it is asked together with the others and answers. The ranks
end with the process that asks them, and are started anew where one of them failed.
"""

import atexit
import contextlib
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
START = 120.0
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
        return [self._answer(rank, end) for rank in range(self.size)]

    def _answer(self, rank, end):
        while b"\n" not in self.rest[rank]:
            ready, _, _ = select.select([self.answers[rank]], [], [], 0.5)
            if ready:
                self.rest[rank] += os.read(self.answers[rank], 65536)
            else:
                ended = self.process.poll() is not None
                assert not ended, f"The ranks ended: {(self.folder / 'said').read_text()[-4000:]}"
                assert time.monotonic() < end, f"Rank {rank} of {self.size} does not answer."
        line, self.rest[rank] = self.rest[rank].split(b"\n", 1)
        return json.loads(line)

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


def asked(size, request, timeout=120.0):
    """Ask ``size`` ranks; return their answers in the order of ranks."""
    if size not in _started:
        for other in [other for other in _started if other not in KEPT and size not in KEPT]:
            _started.pop(other).end()
        _started[size] = Ranks(size)
    try:
        answers = _started[size].asked(request, timeout)
        assert all("failed" not in answer for answer in answers), "\n".join(a.get("failed", "") for a in answers)
        return answers
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


def _run(case, words, output, restart):
    import pdpetsc as pd
    from pdpetsc.command_line.cli import arguments_of, load_case

    function = load_case(Path(case))
    parameters = arguments_of(function, dict(word.split("=", 1) for word in words))
    pd.run(function(**parameters), output=output, parameters=parameters, restart=restart)
    return {}


def _command(words, folder):
    """Call the command line as a process of its own would; return its exit status and what it wrote."""
    from pdpetsc.command_line.cli import main

    status, kept = None, [os.dup(1), os.dup(2)]
    before = os.getcwd(), list(sys.path)
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        try:
            os.chdir(folder)
            os.dup2(out.fileno(), 1)
            os.dup2(err.fileno(), 2)
            main(words)
        except SystemExit as end:
            status = end.code
        finally:
            signal.alarm(0)  # which main sets for the end of MPI
            sys.stdout.flush()
            sys.stderr.flush()
            for number, copy in enumerate(kept, 1):
                os.dup2(copy, number)
                os.close(copy)
            os.chdir(before[0])
            sys.path[:] = before[1]
        out.seek(0)
        err.seek(0)
        return {"status": status, "stdout": out.read().decode(), "stderr": err.read().decode()}


def _serve(folder):
    import petsc4py

    petsc4py.init(["pytest"])
    rank = os.environ.get("OMPI_COMM_WORLD_RANK", "0")
    with open(folder / f"ask_{rank}") as asked, open(folder / f"answer_{rank}", "w") as answers:
        for line in asked:
            request = json.loads(line)
            try:
                answer = {"run": _run, "command": _command}[request.pop("what")](**request)
            except Exception:
                answer = {"failed": traceback.format_exc()}
            print(json.dumps(answer), file=answers, flush=True)


if __name__ == "__main__":
    _serve(Path(sys.argv[1]))
