"""What a run says while it goes on, on rank 0 only: to Python's logging, or on a terminal."""

from __future__ import annotations

import contextlib
import logging
import sys
from abc import ABC, abstractmethod
from collections.abc import Mapping

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from pdpetsc.discrete.communicator import Comm, is_root
from pdpetsc.solvers.protocol import StepResult

LOG = logging.getLogger("pdpetsc")


class Report(ABC):
    """Takes what a run has to say, in a ``with`` block around the run; every rank has one.

    Parameters
    ----------
    comm : Comm
        The ranks of the run; only rank 0 says anything.
    """

    def __init__(self, comm: Comm) -> None:
        self._speaks = is_root(comm)

    def __enter__(self) -> Report:
        return self

    def __exit__(self, *_: object) -> None:  # noqa: B027 - most have nothing to end
        """End it."""

    @abstractmethod
    def say(self, text: str) -> None:
        """Take a line."""

    @abstractmethod
    def warn(self, text: str) -> None:
        """Take a sentence that should be read."""

    def step(self, t: float, line: str | None) -> None:
        """Take the step time that the run has come to, and the line of a converged step where it has one."""
        if line is not None:
            self.say(line)

    def cut_back(self, t: float, dt: float, result: StepResult) -> None:
        """Take that a step failed and is tried shorter."""
        self.say(f"           t > {t:<8.6g} failed: {result.reason}; trying a step of {dt:.3g}")

    def results(self, results: Mapping[str, float]) -> None:
        """Take the named results."""
        for name, value in results.items():
            self.say(f"  {name} = {value:.8g}")


class LogReport(Report):
    """Passes everything on to the logger ``pdpetsc``: lines as information, warnings as warnings."""

    def say(self, text: str) -> None:
        """Log a line."""
        if self._speaks:
            LOG.info("%s", text.strip())

    def warn(self, text: str) -> None:
        """Log a warning."""
        if self._speaks:
            LOG.warning("%s", text)


class _Console(Console):
    """A console that goes silent where nobody reads it any more, as behind ``| head``; rich would end the process."""

    def on_broken_pipe(self) -> None:
        """Print nothing from here on."""
        self.quiet = True


class ConsoleReport(Report):
    """Prints a line per step, with a bar where one rank writes to a terminal.

    On more ranks there is no bar: mpirun makes every pipe look like a terminal.

    Parameters
    ----------
    comm : Comm
        The ranks of the run.
    quiet : bool
        Print nothing but warnings.
    """

    def __init__(self, comm: Comm, quiet: bool) -> None:
        super().__init__(comm)
        self._console = _Console(quiet=quiet or not self._speaks, highlight=False, soft_wrap=True, markup=False)
        columns = TextColumn("load"), BarColumn(), TextColumn("{task.percentage:3.0f} %"), TimeRemainingColumn()
        hidden = quiet or comm.size > 1 or not self._console.is_terminal
        self._progress = Progress(*columns, console=self._console, transient=True, disable=hidden)
        self._task = self._progress.add_task("load", total=1.0)

    def __enter__(self) -> ConsoleReport:
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()

    def say(self, text: str) -> None:
        """Print a line."""
        self._console.print(text)

    def warn(self, text: str) -> None:
        """Print a sentence to stderr."""
        if self._speaks:
            with contextlib.suppress(OSError):
                print(f"pdpetsc: {text}", file=sys.stderr, flush=True)

    def step(self, t: float, line: str | None) -> None:
        """Move the bar to a step time, and print the line."""
        self._progress.update(self._task, completed=t)
        super().step(t, line)
