"""The command line: argument split, PETSc start, run, exit code."""

from __future__ import annotations

import ast
import contextlib
import dataclasses
import difflib
import errno
import importlib.util
import inspect
import io
import math
import os
import re
import shlex
import signal
import sys
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from pdpetsc.command_line.start import processes_started, start_petsc
from pdpetsc.declared import shown
from pdpetsc.errors import CaseError, Interrupted, PdpetscError, RunError, described, of_petsc
from pdpetsc.machine import stamp_of

if TYPE_CHECKING:
    from pdpetsc.case import Case

USAGE = """usage: python -m pdpetsc CASE.py [NAME=VALUE ...] [-o DIR] [--restart FILE] [--quiet] [-PETSC_OPTION [VALUE]]

  CASE.py         a file that defines case(NAME=DEFAULT, ...) -> pdpetsc.Case
  NAME=VALUE      a parameter of that function
  -o DIR          folder for the results (default: out/CASE)
  --restart FILE  go on from a checkpoint, or from the one in a folder
  --restart-anyway  go on from it also where material, loads or cracks of the case have changed
  --solver NAME   newton, relaxation (dynamic), events (bond by bond) or path (following), not the case's
  --check         compare the results with what the case expects; exit status 1 where one is off
  --report        write report.html at the end: what was asked, what came out, convergence, timing, pictures
  --quiet         print errors only
  --version       print the version
  -h              print this, and the parameters of CASE.py if it is given
Every other -option goes to PETSc: -snes_monitor, -ksp_type gmres, ...

python -m pdpetsc new FILE.py                    writes a commented case to begin with
python -m pdpetsc plot DIR                       draws a run: deformed body, history, Newton's convergence
python -m pdpetsc report DIR                     writes report.html of a run, one page with all of it
python -m pdpetsc compare CASE.py NAME=A,B ...   runs every combination and makes one table and picture
python -m pdpetsc study CASE.py NAME=A,B ...     the same, some side by side, with orders of convergence
python -m pdpetsc fit CASE.py NAME=LOW:HIGH ...  finds parameters whose history is that of a measured curve
python -m pdpetsc import DECK                    writes the case of a deck of Peridigm or PeriLab
python -m pdpetsc doctor                         looks whether MPI, PETSc and the rest work here"""

# How long MPI and PETSc may take to end [s]: where one rank fails in that, the others would wait for it for ever.
LONGEST_END = 120
# What a study gives its runs, which is not for users (pdpetsc.studies.input_files).
_LEAVE = "--leave-files-read"
_ASSIGNMENT = re.compile(r"[A-Za-z_]\w*=")
_OPTION = re.compile(r"-{1,2}[A-Za-z]")


@dataclass
class Arguments:
    """The command line, split."""

    path: Path | None = None
    parameters: dict[str, str] = field(default_factory=dict)
    output: Path | None = None
    restart: Path | None = None
    restart_anyway: bool = False
    check: bool = False
    report: bool = False
    solver: str | None = None
    quiet: bool = False
    version: bool = False
    help: bool = False
    leave_files_read: bool = False
    petsc: list[str] = field(default_factory=list)


def split(argv: Sequence[str]) -> Arguments:
    """Split the command line into case, parameters, pdpetsc's own options and PETSc's.

    A PETSc option takes the next word as its value unless that is an option or ``name=value``.

    Raises
    ------
    CaseError
        A value is missing or a word is not understood.
    """
    found = Arguments()
    words = list(argv)
    while words:
        word = words.pop(0)
        if word in ("-o", "--restart"):
            if not words:
                raise CaseError(f"{word} needs a path after it.")
            path = Path(words.pop(0))
            found.output, found.restart = (path, found.restart) if word == "-o" else (found.output, path)
        elif word == "--solver":
            if not words:
                raise CaseError("--solver needs a name after it.")
            found.solver = words.pop(0)
        elif word in ("--quiet", "--version", "--restart-anyway", "--check", "--report", _LEAVE):
            setattr(found, word[2:].replace("-", "_"), True)
        elif word in ("-h", "--help"):
            found.help = True
        elif word.startswith("--"):
            raise CaseError(
                f"Unknown option {word}; pdpetsc has -o, --restart, --restart-anyway, --solver, --check, --report, "
                f"--quiet, --version, -h."
            )
        elif _OPTION.match(word):
            found.petsc.append(word)
            if words and not _OPTION.match(words[0]) and not _ASSIGNMENT.match(words[0]):
                found.petsc.append(words.pop(0))
        elif _ASSIGNMENT.match(word):
            name, value = word.split("=", 1)
            if name in found.parameters:
                raise CaseError(f"Parameter {name} is given twice.")
            found.parameters[name] = value
        elif found.path is None:
            found.path = Path(word)
        else:
            raise CaseError(f"{word!r} is neither NAME=VALUE nor an option; the case file is {found.path}.")
    return found


def load_case(path: Path) -> Callable[..., Case]:
    """Return the function ``case`` of a case file.

    Raises
    ------
    CaseError
        The file is missing, fails, or defines no such function.
    """
    try:
        there = path.is_file()
    except OSError as error:  # a name that is too long
        raise CaseError(f"Cannot read the case file {path}: {error.strerror or error}.") from None
    if not there:
        command = "" if path.suffix else meant(str(path), COMMANDS, "; did you mean the command {}?")
        raise CaseError(f"Cannot read the case file {path}: file not found{command or '.'}")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None:
        raise CaseError(f"The case file {path} must end in .py.")
    module = importlib.util.module_from_spec(spec)
    sys.path.insert(0, str(path.parent.resolve()))
    _guarded(path, lambda: spec.loader.exec_module(module))  # type: ignore[union-attr]
    function = getattr(module, "case", None)
    if not callable(function):
        raise CaseError(f"The case file {path} defines no function case(...).")
    return function  # type: ignore[no-any-return]


def arguments_of(function: Callable[..., Any], given: Mapping[str, str]) -> dict[str, Any]:
    """Return the keywords of a case function with the given values converted to their defaults' types.

    Raises
    ------
    CaseError
        A name is unknown, a value cannot be converted, or a parameter has no default.
    """
    try:
        parameters = inspect.signature(function).parameters
    except (TypeError, ValueError):
        raise CaseError(
            f"The case {shown(function)} is no function of a case file; define it by def case(...)."
        ) from None
    for name, parameter in parameters.items():
        if parameter.default is inspect.Parameter.empty:
            raise CaseError(f"Parameter {name} of the case function needs a default.")
    for name in given:
        if name not in parameters:
            known = ", ".join(parameters) or "none"
            raise CaseError(
                f"The case has no parameter {name!r}; {meant(name, parameters, 'did you mean {}? ')}it has {known}."
            )
    values = {name: parameter.default for name, parameter in parameters.items()}
    return values | {name: _convert(name, text, values[name]) for name, text in given.items()}


def meant(word: str, known: Iterable[str], sentence: str) -> str:
    """Return a sentence with the known word that is nearest to one that is not known; empty where none is near."""
    near = difflib.get_close_matches(word, list(known), n=1)
    return sentence.format(near[0]) if near else ""


def main(argv: Sequence[str] | None = None) -> NoReturn:
    """Run the command line and leave with its exit status; a rank that fails alone aborts all."""
    _keep_going_without_readers()
    _take_signals()
    failure: BaseException | None = None
    try:
        status = _run(sys.argv[1:] if argv is None else list(argv))
    except BaseException as error:
        # A second signal, as mpirun passes one on, shall not interrupt the sentence about the first.
        _take_signals(signal.SIG_IGN)
        failure, status = error, _failed(error)
    with contextlib.suppress(ValueError):
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_DFL)
    with contextlib.suppress(OSError):
        sys.stdout.flush()
    if of_petsc(failure):  # its own end can crash or hang then
        _leave_petsc(status)
    if "mpi4py.MPI" in sys.modules:
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.alarm(LONGEST_END)
    sys.exit(status)


def _leave_petsc(status: int) -> NoReturn:
    """Leave without PETSc's own end, where it has been started."""
    if "petsc4py.PETSc" not in sys.modules:
        sys.exit(status)
    from pdpetsc.discrete.failure import leave

    sys.stderr.flush()
    leave(status)


def _take_signals(handler: Any = None) -> None:
    """Let signals raise KeyboardInterrupt or do something else, except those that are ignored, as under nohup."""
    with contextlib.suppress(ValueError):  # they are the main thread's
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            if signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, handler or _interrupt)


def _interrupt(number: int, frame: Any) -> None:
    raise KeyboardInterrupt


def _failed(error: BaseException) -> int:
    """Say what ended the command in one sentence and return its exit status; abort where this rank is alone."""
    failure = described(error)
    try:
        from pdpetsc.discrete.communicator import is_root, world
        from pdpetsc.discrete.failure import all_failed, give_up
    except Exception as missing:  # without MPI there are no other ranks to think of
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
    """A stream whose reader may go away, like ``| head``: what is written then is dropped."""

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
    """Let a run go on whose stdout or stderr nobody reads any more; its results are in its folder."""
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
        if argv[0] in ALONE and processes_started() > 1:
            raise CaseError(f"{argv[0]} works in one process; call it without mpirun.")
        return COMMANDS[argv[0]](argv[1:])
    arguments = split(argv)
    start_petsc(arguments.petsc)
    from pdpetsc.discrete.communicator import world
    from pdpetsc.running.signals import watched

    comm = world()
    # PETSc has put its own handlers of signals in place of Python's.
    with watched(comm, _stuck), _leaving_files_read(arguments):
        return _run_case([word for word in argv if word != _LEAVE], arguments)


@contextlib.contextmanager
def _leaving_files_read(arguments: Arguments) -> Iterator[None]:
    """Let a run of a study leave which files it has read, however it ends."""
    if not arguments.leave_files_read or arguments.output is None:
        yield
        return
    from pdpetsc.studies.input_files import Watch

    watch = Watch(arguments.output)
    try:
        yield
    finally:
        watch.leave(arguments.output)


def _stuck() -> None:
    """End a rank that a signal should have ended and that waits for others in MPI."""
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
    if arguments.version or (arguments.help and arguments.path is None) or not argv:
        if is_root(comm):
            print(f"pdpetsc {__version__}" if arguments.version else USAGE)
        return 0 if argv else 2
    with agreed(comm):
        if arguments.path is None:
            raise CaseError("No case file is given; python -m pdpetsc -h shows the usage.")
        function = load_case(arguments.path)
        parameters = arguments_of(function, {} if arguments.help else arguments.parameters)
    if arguments.help:
        if is_root(comm):
            print(_described(arguments.path, function, parameters))
        return 0
    with agreed(comm):
        case = make_case(arguments.path, function, parameters)
        if arguments.solver is not None:
            case = dataclasses.replace(case, solver=choose("--solver", arguments.solver, SOLVERS))
    output = arguments.output or Path("out") / arguments.path.stem
    before = stamp_of(output / "summary.json")
    try:
        run(
            case,
            output,
            restart=arguments.restart,
            parameters=parameters,
            restart_anyway=arguments.restart_anyway,
            report=lambda ranks: ConsoleReport(ranks, arguments.quiet),
            check=arguments.check,
            asked=_asked(arguments.path, argv),
        )
    except BaseException as error:
        # What a run that failed has left is worth a page too, but not what another one left where nothing was run, and
        # not where other ranks may still be at work: they end with the error of this one.
        if arguments.report and (comm.size == 1 or getattr(error, "agreed", 0) == comm.size):
            with agreed(comm):
                _report_on(output, is_root(comm) and stamp_of(output / "summary.json") != before, arguments.quiet)
        raise
    if arguments.report:
        # All wait for the page: the end of MPI takes no longer than the first rank that comes to it allows.
        with agreed(comm):
            _report_on(output, is_root(comm), arguments.quiet)
    return 0


def _asked(path: Path, argv: Sequence[str]) -> dict[str, Any]:
    """Return what the summary keeps of the command: its words and the text of the case file."""
    text = ""
    with contextlib.suppress(OSError):
        text = path.read_text(errors="replace")
    return {"command": shlex.join(["python", "-m", "pdpetsc", *argv]), "case": {"file": path.name, "text": text}}


def _report_on(folder: Path, here: bool, quiet: bool) -> None:
    """Write the report of a run that has ended, on one rank; whatever fails here, results and exit status stand."""
    if not here:
        return
    from pdpetsc.output.report import write_report

    try:
        path = write_report(folder)
        if not quiet:
            print(f"report in {path}", flush=True)
    except Exception as error:
        with contextlib.suppress(OSError):
            print(f"pdpetsc: The report could not be written: {described(error)}", file=sys.stderr, flush=True)


def _described(path: Path, function: Callable[..., Any], parameters: Mapping[str, Any]) -> str:
    """Return what a case is, by the first paragraph of its file and function, and its parameters with their types."""
    written = (getattr(function, "__globals__", {}).get("__doc__"), function.__doc__)
    paragraphs = [inspect.cleandoc(text).split("\n\n")[0] for text in written if text]
    kinds = {name: "value" if value is None else type(value).__name__ for name, value in parameters.items()}
    given = {name: f"{name}={value!r}" for name, value in parameters.items()}
    width = max((len(text) for text in given.values()), default=0)
    lines = [f"  {given[name]:{width}}  {kinds[name]}" for name in parameters]
    listed = ["parameters:", *lines] if lines else ["It has no parameters."]
    return "\n".join([USAGE, "", str(path), "", *paragraphs, "", *listed])


def _new(argv: list[str]) -> int:
    from pdpetsc.command_line import new

    if "-h" in argv or "--help" in argv or not argv:
        print(new.USAGE)
        return 0 if argv else 2
    if len(argv) > 1:
        raise CaseError("new takes one file name; python -m pdpetsc new -h shows the usage.")
    print(new.new(Path(argv[0])))
    return 0


def _import(argv: list[str]) -> int:
    from pdpetsc.command_line import import_deck

    words, options = list(argv), dict[str, Any](ignore=[])
    if "-h" in words or "--help" in words or not words:
        print(import_deck.USAGE)
        return 0 if words else 2
    while words:
        word = words.pop(0)
        if word in ("-o", "--ignore"):
            if not words:
                raise CaseError(f"{word} needs a {'path' if word == '-o' else 'name'} after it.")
            value = words.pop(0)
            if word == "--ignore":
                options["ignore"].append(value)
            else:
                options["output"] = Path(value)
        elif word in ("--static", "--overwrite"):
            options[word[2:]] = True
        elif word.startswith("-") or "deck" in options:
            raise CaseError(f"import does not know {word!r}; python -m pdpetsc import -h shows the usage.")
        else:
            options["deck"] = Path(word)
    if "deck" not in options:
        raise CaseError("No deck is given; python -m pdpetsc import -h shows the usage.")
    print(import_deck.described(*import_deck.import_deck(**options)))
    return 0


def _doctor(argv: list[str]) -> int:
    from pdpetsc.command_line import doctor

    if argv:
        print(doctor.USAGE)
        return 0 if argv in (["-h"], ["--help"]) else 2
    # Without MPI or PETSc there is nothing to start; saying so is what this is for.
    if told := doctor.unloadable():
        doctor.tell(told)
        return 1
    start_petsc()
    _take_signals()
    from pdpetsc.discrete.communicator import world

    return doctor.doctor(world())


def _plot(argv: list[str]) -> int:
    from pdpetsc.command_line import plot

    animate = "--animate" in argv
    arguments = split([word for word in argv if word != "--animate"])
    if arguments.help or not argv:
        print(plot.USAGE)
        return 0 if argv else 2
    if arguments.path is None:
        raise CaseError("No folder is given; python -m pdpetsc plot -h shows the usage.")
    if arguments.petsc or arguments.output or arguments.restart or arguments.solver or arguments.check:
        raise CaseError("plot takes a folder and NAME=VALUE only; python -m pdpetsc plot -h shows the usage.")
    for path in plot.plot(arguments.path, arguments.parameters, animate):
        print(path)
    return 0


def _report(argv: list[str]) -> int:
    usage = "usage: python -m pdpetsc report DIR [field=NAME] [component=xx] [scale=1]"
    arguments = split(argv)
    if arguments.help or not argv:
        print(f"{usage}\n\nWrites DIR/report.html: what was asked, what came out, convergence, timing, pictures.")
        return 0 if argv else 2
    unknown = [name for name in arguments.parameters if name not in ("field", "component", "scale")]
    others = arguments.petsc or arguments.output or arguments.restart or arguments.solver or arguments.check
    if arguments.path is None or unknown or others:
        raise CaseError(f"report takes a folder, field, component and scale; {usage}.")
    from pdpetsc.output.report import write_report

    given = arguments.parameters
    scale = _convert("scale", given.get("scale", "1"), 1.0)
    if not math.isfinite(scale):
        raise CaseError(f"scale takes a number, not {given['scale']}.")
    if "component" in given and "field" not in given:
        raise CaseError("report takes a component of a field; give the field besides.")
    print(write_report(arguments.path, given.get("field"), given.get("component", ""), scale))
    return 0


def _compare(argv: list[str]) -> int:
    from pdpetsc.command_line import compare

    asked = compare.taken(argv)
    return compare.main(asked, split(asked.words))


def _study(argv: list[str]) -> int:
    from pdpetsc.command_line import study

    asked = study.taken(argv)
    return study.main(asked, split(asked.words))


def _fit(argv: list[str]) -> int:
    from pdpetsc.command_line import fit

    asked = fit.taken(argv)
    return fit.main(asked, split(asked.words))


# Those that write the same files from every process that runs them.
ALONE = {"plot", "report", "new", "import"}
# What the command line does besides running a case, by its first word.
COMMANDS: Mapping[str, Callable[[list[str]], int]] = {
    "plot": _plot, "report": _report, "compare": _compare, "study": _study, "fit": _fit, "new": _new,
    "import": _import, "doctor": _doctor,
}  # fmt: skip


def make_case(path: Path, function: Callable[..., Any], parameters: Mapping[str, Any]) -> Case:
    """Return the case that the function of a case file makes; raises CaseError where it makes none."""
    from pdpetsc.case import Case

    case = _guarded(path, lambda: function(**parameters))
    if not isinstance(case, Case):
        raise CaseError(f"case(...) of {path} must return a pdpetsc.Case, not {type(case).__name__}.")
    return case


def _guarded(path: Path, call: Callable[[], Any]) -> Any:
    """Call what the case file defines and turn its errors into one sentence with the line."""
    try:
        return call()
    except PdpetscError:
        raise
    except SystemExit as error:
        raise CaseError(
            f"The case file {path} called sys.exit{_line_of(path, error)}; it must not end the run."
        ) from error
    except SyntaxError as error:
        inside = error.filename is None or Path(error.filename).name == path.name
        where = f"The case file {path}" if inside else f"{error.filename}, which the case file {path} imports,"
        raise CaseError(f"{where} has a syntax error in line {error.lineno}: {error.msg}.") from error
    except Exception as error:
        where = _line_of(path, error) or " somewhere below it"
        words = " ".join(str(error).split()).rstrip(".")
        said = f"{type(error).__name__}: {words}" if words else type(error).__name__
        raise CaseError(f"The case file {path} failed{where}: {said}{_keywords(words)}.") from error


def _keywords(words: str) -> str:
    """Return which words a class or function of pdpetsc takes, where an error says that it was given another one."""
    import pdpetsc

    found = re.match(r"(\w+)(?:\.__init__)?\(\) got an unexpected keyword argument '(\w+)'", words)
    taker = getattr(pdpetsc, found[1], None) if found and found[1] in pdpetsc.__all__ else None
    if found is None or taker is None:
        return ""
    known = [name for name in inspect.signature(taker).parameters if name != "self"]
    return f"; it takes {', '.join(known)}{meant(found[2], known, ' (did you mean {}?)')}"


def _line_of(path: Path, error: BaseException) -> str:
    lines = [f.lineno for f in traceback.extract_tb(error.__traceback__) if Path(f.filename).name == path.name]
    return f" in line {lines[-1]}" if lines else ""


def _convert(name: str, text: str, default: Any) -> Any:
    kind = type(default)
    try:
        if kind is bool:
            return {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}[text.lower()]
        if kind in (int, float, str):
            return kind(text)
        value = ast.literal_eval(text)
        return value if default is None else kind(value)
    except (ValueError, KeyError, SyntaxError, TypeError, OverflowError, RecursionError, MemoryError):
        raise CaseError(f"Parameter {name} takes {kind.__name__} like {default!r}, not {shown(text)}.") from None
