"""Run a case, or execute a command.

usage: python -m pdpetsc CASE.py [NAME=VALUE ...] [-o DIR] [--restart FILE] [--quiet | -v] [-PETSC_OPTION [VALUE]]

  CASE.py         a file that defines case(NAME=DEFAULT, ...) -> pdpetsc.Case
  NAME=VALUE      a parameter of that function
  -o DIR          folder for the results (default: out/CASE)
  --restart FILE  continue from a checkpoint, or from the checkpoint in a folder
  --restart-anyway  continue from it even if material, loads or cracks of the case have changed
  --solver NAME   newton, relaxation (dynamic), events (bond by bond) or path (following), instead of the case's
  --check         compare the results with the expected results of the case; exit status 1 if one differs
  --report        write report.html at the end: case, results, convergence, timing, pictures
  --quiet         print only errors
  -v, --verbose   print details too: how weights and tangent were chosen
  --version       print the version
  -h              print this, and the parameters of CASE.py if it is given
Every other -option goes to PETSc: -snes_monitor, -ksp_type gmres, ...

python -m pdpetsc new FILE.py                    writes a commented case as a starting point
python -m pdpetsc plot DIR                       draws a run: deformed body, history, Newton's convergence
python -m pdpetsc report DIR                     writes report.html of a run, one page with all of it
python -m pdpetsc compare CASE.py NAME=A,B ...   runs every combination, with one table and picture
python -m pdpetsc study CASE.py NAME=A,B ...     the same, several at a time, with orders of convergence
python -m pdpetsc fit CASE.py NAME=LOW:HIGH ...  fits parameters to a measured curve
python -m pdpetsc import DECK                    writes the case of a deck of Peridigm or PeriLab
python -m pdpetsc doctor                         checks MPI, PETSc and the other requirements
"""

from __future__ import annotations

import contextlib
import dataclasses
import errno
import inspect
import io
import os
import shlex
import signal
import sys
import traceback
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, NoReturn

from pdpetsc.command_line.arguments import Arguments, split
from pdpetsc.command_line.case_file import arguments_of, load_case, make_case
from pdpetsc.command_line.commands import COMMANDS, command, refuse_command, usage_of
from pdpetsc.command_line.start import handle_signals, start_petsc
from pdpetsc.errors import CaseError, Interrupted, RunError, described, of_petsc
from pdpetsc.machine import stamp_of

# Time limit for the end of MPI and PETSc [s]: if one rank fails there, the others would wait for ever.
LONGEST_END = 120


def main(argv: Sequence[str] | None = None) -> NoReturn:
    """Run the command line and exit with its status; a rank that fails alone aborts all."""
    _keep_going_without_readers()
    handle_signals()
    failure: BaseException | None = None
    try:
        status = _run(sys.argv[1:] if argv is None else list(argv))
    except BaseException as error:
        # A second signal, forwarded by mpirun, must not interrupt the message about the first.
        handle_signals(signal.SIG_IGN)
        failure, status = error, _failed(error)
    with contextlib.suppress(ValueError):
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_DFL)
    with contextlib.suppress(OSError):
        sys.stdout.flush()
    if of_petsc(failure):  # its finalisation may crash or hang then
        _leave_petsc(status)
    if "mpi4py.MPI" in sys.modules:
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.alarm(LONGEST_END)
    sys.exit(status)


def _leave_petsc(status: int) -> NoReturn:
    """Exit without finalising PETSc, if it has been started."""
    if "petsc4py.PETSc" not in sys.modules:
        sys.exit(status)
    from pdpetsc.discrete.failure import leave

    sys.stderr.flush()
    leave(status)


def _failed(error: BaseException) -> int:
    """Print the error of the command and return its exit status; abort if this rank fails alone."""
    failure = described(error)
    try:
        from pdpetsc.discrete.communicator import is_root, world
        from pdpetsc.discrete.failure import all_failed, give_up
    except Exception as missing:  # without MPI there are no other ranks
        print(f"pdpetsc: {described(missing)}", file=sys.stderr, flush=True)
        return 1
    if isinstance(error, KeyboardInterrupt):
        failure = Interrupted("Stopped by a signal.")
    elif isinstance(failure, RunError) and failure is not error:
        if failure.bug:
            traceback.print_exception(error)
        if getattr(error, "ierr", None) is not None:
            failure = CaseError(f"PETSc refused its options; check their names and values: {failure.what}.")
    if not all_failed(error, failure):
        give_up(failure)
    if is_root(world()):
        with contextlib.suppress(OSError):
            print(f"pdpetsc: {failure}", file=sys.stderr, flush=True)
    return failure.exit_status


class _WithoutReader(io.FileIO):
    """A stream whose reader may end early, like ``| head``; later output is dropped."""

    def write(self, data: Any) -> int:
        try:
            return super().write(data)
        except OSError as error:
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, self.fileno())  # PETSc writes there too
            os.close(null)
            if error.errno not in (errno.EPIPE, errno.EIO) and self.fileno() == 1:
                with contextlib.suppress(OSError):
                    print(f"pdpetsc: Cannot write to stdout: {error.strerror}.", file=sys.stderr, flush=True)
            return memoryview(data).nbytes


def _keep_going_without_readers() -> None:
    """Continue a run after the reader of stdout or stderr has ended; results are in its folder."""
    for name, number in (("stdout", 1), ("stderr", 2)):
        stream = getattr(sys, name)
        with contextlib.suppress(OSError, ValueError, AttributeError):
            if stream.fileno() == number and not isinstance(getattr(stream.buffer, "raw", None), _WithoutReader):
                stream.flush()
                setattr(sys, name, _reopened(stream, number))


def _reopened(stream: Any, number: int) -> io.TextIOWrapper:
    buffer = io.BufferedWriter(_WithoutReader(number, "w", closefd=False))
    # An unbuffered stream, as with PYTHONUNBUFFERED, has no buffer below the text.
    by_line = stream.line_buffering or number == 2 or isinstance(stream.buffer, io.FileIO)
    return io.TextIOWrapper(buffer, stream.encoding, stream.errors, line_buffering=by_line)


def _run(argv: list[str]) -> int:
    if argv and argv[0] in COMMANDS:
        return command(argv[0], argv[1:])
    refuse_command(argv)
    arguments = split(argv)
    start_petsc(arguments.petsc)
    from pdpetsc.discrete.communicator import world
    from pdpetsc.running.signals import watched

    comm = world()
    # PETSc has replaced Python's signal handlers.
    with watched(comm, _stuck):
        return _run_case(argv, arguments)


def _stuck() -> None:
    """End a rank that got a signal but waits for others in MPI."""
    from pdpetsc.discrete.communicator import world
    from pdpetsc.discrete.failure import give_up

    if world().size > 1:
        give_up(Interrupted("Stopped by a signal."))


def _run_case(argv: list[str], arguments: Arguments) -> int:
    from pdpetsc import __version__
    from pdpetsc.declare.choice import choose
    from pdpetsc.declare.solvers import SOLVERS
    from pdpetsc.discrete.communicator import agreed, is_root, world
    from pdpetsc.output.progress import ConsoleReport
    from pdpetsc.running.runner import run

    comm = world()
    if "--version" in arguments.flags or ("--help" in arguments.flags and arguments.path is None) or not argv:
        if is_root(comm):
            print(f"pdpetsc {__version__}" if "--version" in arguments.flags else usage_of("cli"))
        return 0 if argv else 2
    with agreed(comm):
        if arguments.path is None:
            raise CaseError("No case file is given; python -m pdpetsc -h shows the usage.")
        function = load_case(arguments.path)
        parameters = arguments_of(function, {} if "--help" in arguments.flags else arguments.parameters)
    if "--help" in arguments.flags:
        if is_root(comm):
            print(_described(arguments.path, function, parameters))
        return 0
    with agreed(comm):
        case = make_case(arguments.path, function, parameters)
        if (solver := arguments.value("--solver")) is not None:
            case = dataclasses.replace(case, solver=choose("--solver", solver, SOLVERS))
    output = arguments.output or Path("out") / arguments.path.stem
    before = stamp_of(output / "summary.json")
    try:
        run(
            case,
            output,
            restart=arguments.value("--restart"),
            parameters=parameters,
            restart_anyway="--restart-anyway" in arguments.flags,
            report=lambda ranks: ConsoleReport(ranks, "--quiet" in arguments.flags, "--verbose" in arguments.flags),
            check="--check" in arguments.flags,
            asked=_asked(arguments.path, argv),
        )
    except BaseException as error:
        # Write a report also for a failed run, but not if nothing was run, and not if other ranks may still be active:
        # they end with the error of this rank.
        if "--report" in arguments.flags and (comm.size == 1 or getattr(error, "agreed", 0) == comm.size):
            with agreed(comm):
                if is_root(comm) and stamp_of(output / "summary.json") != before:
                    _report_on(output, arguments)
        raise
    if "--report" in arguments.flags:
        # All ranks wait for the report, because the first rank in the finalisation of MPI starts its time limit.
        with agreed(comm):
            if is_root(comm):
                _report_on(output, arguments)
    return 0


def _asked(path: Path, argv: Sequence[str]) -> dict[str, Any]:
    """Return the entries of the summary on the command: its words and the text of the case file."""
    text = ""
    with contextlib.suppress(OSError):
        text = path.read_text(errors="replace")
    return {"command": shlex.join(["python", "-m", "pdpetsc", *argv]), "case": {"file": path.name, "text": text}}


def _report_on(folder: Path, arguments: Arguments) -> None:
    """Write the report of a finished run (one rank only); results and exit status do not depend on it."""
    try:
        path = import_module("pdpetsc.output.report").write_report(folder)
        if "--quiet" not in arguments.flags:
            print(f"report in {path}", flush=True)
    except Exception as error:
        with contextlib.suppress(OSError):
            print(f"pdpetsc: The report could not be written: {described(error)}", file=sys.stderr, flush=True)


def _described(path: Path, function: Callable[..., Any], parameters: Mapping[str, Any]) -> str:
    """Return the description of a case: the first paragraph of its file and function, and typed parameters."""
    written = (getattr(function, "__globals__", {}).get("__doc__"), function.__doc__)
    paragraphs = [inspect.cleandoc(text).split("\n\n")[0] for text in written if text]
    kinds = {name: "value" if value is None else type(value).__name__ for name, value in parameters.items()}
    given = {name: f"{name}={value!r}" for name, value in parameters.items()}
    width = max((len(text) for text in given.values()), default=0)
    lines = [f"  {given[name]:{width}}  {kinds[name]}" for name in parameters]
    listed = ["parameters:", *lines] if lines else ["It has no parameters."]
    return "\n".join([usage_of("cli"), "", str(path), "", *paragraphs, "", *listed])
