"""What a run says while it goes on, on rank 0 only: to Python's logging, or on a terminal."""

from __future__ import annotations

import contextlib
import logging
import os
import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Mapping

from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, Task
from rich.text import Text

from pdpetsc.discrete.communicator import Comm, is_root
from pdpetsc.output.labels import Labels
from pdpetsc.output.pace import Pace
from pdpetsc.solvers.protocol import StepResult

LOG = logging.getLogger("pdpetsc")
# In a log without a terminal, the least time between lines on how the run goes on [s].
EVERY = 120.0


class Report(ABC):
    """Takes what a run has to say, in a ``with`` block around the run; every rank has one.

    Parameters
    ----------
    comm : Comm
        The ranks of the run; only rank 0 says anything.
    """

    def __init__(self, comm: Comm) -> None:
        self._speaks = is_root(comm)
        self.pace = Pace()
        self._said = time.monotonic()

    def __enter__(self) -> Report:
        return self

    def begin(self, t: float, steps: int) -> None:
        """Take that the first step of this run begins, at a step time and after steps of the run that it goes on."""
        self.pace.begin(t, steps)

    def __exit__(self, *_: object) -> None:  # noqa: B027 - most have nothing to end
        """End it."""

    @abstractmethod
    def say(self, text: str) -> None:
        """Take a line."""

    def detail(self, text: str) -> None:  # noqa: B027 - most reports leave details out
        """Take a line for those who want to know how the numbers come about."""

    @abstractmethod
    def warn(self, text: str) -> None:
        """Take a sentence that should be read."""

    def step(self, t: float, line: str | None) -> None:
        """Take the step time that the run has come to, and the line of a converged step where it has one."""
        self.pace.step(t)
        if line is not None:
            self.say(line)
        if time.monotonic() - self._said > EVERY:
            self._said = time.monotonic()
            self.on_the_way(self.pace.words())

    def on_the_way(self, words: str) -> None:
        """Take how a long run goes on, from time to time."""
        self.say(f"  {words}")

    def cut_back(self, t: float, dt: float, result: StepResult) -> None:
        """Take that a step failed and is tried shorter."""
        self.say(f"           t > {t:<8.6g} failed: {result.reason}; trying a step of {dt:.3g}")

    def results(self, results: Mapping[str, float], labels: Labels) -> None:
        """Take the named results; those with the name of a column of the history have its unit."""
        for name, value in results.items():
            self.say(f"  {name} = {value:.8g} {labels.unit_of_column(name)}".rstrip())


class LogReport(Report):
    """Passes lines to the logger ``pdpetsc`` as information, details for debugging, and warnings as warnings."""

    def say(self, text: str) -> None:
        if self._speaks:
            LOG.info("%s", text.strip())

    def detail(self, text: str) -> None:
        if self._speaks:
            LOG.debug("%s", text.strip())

    def warn(self, text: str) -> None:
        if self._speaks:
            LOG.warning("%s", text)


class _Console(Console):
    """A console that goes silent where nobody reads it any more, as behind ``| head``; rich would end the process."""

    def on_broken_pipe(self) -> None:
        self.quiet = True


class _Words(ProgressColumn):
    """How the run goes on, in words."""

    def __init__(self, pace: Pace) -> None:
        super().__init__()
        self._pace = pace

    def render(self, task: Task) -> Text:
        """Return the words of this moment."""
        now = f", {self._pace.since:.0f} s in this one" if self._pace.since > 2.0 else ""
        return Text(f"{self._pace.words()}{now}", no_wrap=True, overflow="ellipsis")


class ConsoleReport(Report):
    """Prints a line per step, and one at the bottom of a terminal that tells how the run goes on.

    Where nobody watches, that line is printed every two minutes instead.

    Parameters
    ----------
    comm : Comm
        The ranks of the run.
    quiet, verbose : bool
        Print nothing but warnings, or also details.
    """

    def __init__(self, comm: Comm, quiet: bool, verbose: bool = False) -> None:
        super().__init__(comm)
        self._verbose = verbose
        self._console = _Console(quiet=quiet or not self._speaks, highlight=False, soft_wrap=True, markup=False)
        self._lives = self._speaks and not quiet and self._console.is_terminal and _watched(comm)
        columns = BarColumn(bar_width=10), _Words(self.pace)
        self._progress = Progress(*columns, console=self._console, transient=True, disable=not self._lives)
        self._task = self._progress.add_task("load", total=1.0, visible=False)

    def __enter__(self) -> ConsoleReport:
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()

    def begin(self, t: float, steps: int) -> None:
        """Show the line from the first step on."""
        super().begin(t, steps)
        self._progress.update(self._task, visible=True)

    def say(self, text: str) -> None:
        self._console.print(text)

    def detail(self, text: str) -> None:
        """Print a line if details are wanted."""
        if self._verbose:
            self.say(text)

    def warn(self, text: str) -> None:
        if self._speaks:
            with contextlib.suppress(OSError):
                print(f"pdpetsc: {text}", file=sys.stderr, flush=True)

    def step(self, t: float, line: str | None) -> None:
        """Move the bar to a step time, and print the line."""
        self._progress.update(self._task, completed=min(t, 1.0))
        super().step(t, line)

    def on_the_way(self, words: str) -> None:
        """Print it where there is no line that says so all the time."""
        if not self._lives:
            super().on_the_way(words)


def _watched(comm: Comm) -> bool:
    """Return True if somebody sees what this rank prints on its terminal.

    mpirun gives every rank a terminal, whatever its own output is; where it is on this machine, that one tells.
    """
    if comm.size == 1 and "OMPI_COMM_WORLD_SIZE" not in os.environ:
        return True
    with contextlib.suppress(OSError):
        return os.readlink(f"/proc/{os.getppid()}/fd/1").startswith(("/dev/pts/", "/dev/tty"))
    return False
