"""Messages of a run, printed on rank 0 only: to the logging of Python or to a terminal."""

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
# Least time between progress lines without a terminal [s].
EVERY = 120.0


class Report(ABC):
    """Print the messages of a run; use it on every rank, in a ``with`` block around the run.

    Parameters
    ----------
    comm : Comm
        The ranks of the run; only rank 0 prints.
    """

    def __init__(self, comm: Comm) -> None:
        self._speaks = is_root(comm)
        self.pace = Pace()
        self._said = time.monotonic()

    def __enter__(self) -> Report:
        return self

    def begin(self, t: float, steps: int) -> None:
        """Start the progress at step time ``t``, after ``steps`` earlier steps."""
        self.pace.begin(t, steps)

    def __exit__(self, *_: object) -> None:  # noqa: B027 - most have nothing to end
        """End the report."""

    @abstractmethod
    def say(self, text: str) -> None:
        """Print a line."""

    def detail(self, text: str) -> None:  # noqa: B027 - most reports leave details out
        """Print a line of details."""

    @abstractmethod
    def warn(self, text: str) -> None:
        """Print a warning."""

    def step(self, t: float, line: str | None) -> None:
        """Record the end of a step at step time ``t``, and print its line, if any."""
        self.pace.step(t)
        if line is not None:
            self.say(line)
        if time.monotonic() - self._said > EVERY:
            self._said = time.monotonic()
            self.on_the_way(self.pace.words())

    def on_the_way(self, words: str) -> None:
        """Print the progress of a long run, from time to time."""
        self.say(f"  {words}")

    def cut_back(self, t: float, dt: float, result: StepResult) -> None:
        """Print that a step failed and is repeated with a shorter step."""
        self.say(f"           t > {t:<8.6g} failed: {result.reason}; trying a step of {dt:.3g}")

    def results(self, results: Mapping[str, float], labels: Labels) -> None:
        """Print the named results; a result with the name of a column of the history has its unit."""
        for name, value in results.items():
            self.say(f"  {name} = {value:.8g} {labels.unit_of_column(name)}".rstrip())


class LogReport(Report):
    """Send lines, details and warnings to the logger ``pdpetsc`` with the levels INFO, DEBUG and WARNING."""

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
    """A console that goes silent if its pipe is closed, as by ``| head``; rich would end the process."""

    def on_broken_pipe(self) -> None:
        self.quiet = True


class _Words(ProgressColumn):
    """The progress of the run in words."""

    def __init__(self, pace: Pace) -> None:
        super().__init__()
        self._pace = pace

    def render(self, task: Task) -> Text:
        """Return the current progress."""
        now = f", {self._pace.since:.0f} s in this one" if self._pace.since > 2.0 else ""
        return Text(f"{self._pace.words()}{now}", no_wrap=True, overflow="ellipsis")


class ConsoleReport(Report):
    """Print a line per step, and a progress line at the bottom of a terminal.

    Without a terminal the progress is printed every two minutes instead.

    Parameters
    ----------
    comm : Comm
        The ranks of the run.
    quiet, verbose : bool
        Print warnings only, or also details.
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
        """Show the progress line from the first step on."""
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
        """Move the progress bar to step time ``t``, and print the line."""
        self._progress.update(self._task, completed=min(t, 1.0))
        super().step(t, line)

    def on_the_way(self, words: str) -> None:
        """Print the progress unless a progress line shows it."""
        if not self._lives:
            super().on_the_way(words)


def _watched(comm: Comm) -> bool:
    """Return True if the output of this rank reaches a terminal.

    mpirun gives every rank a terminal, so the output of mpirun itself is checked, if it runs on this machine.
    """
    if comm.size == 1 and "OMPI_COMM_WORLD_SIZE" not in os.environ:
        return True
    with contextlib.suppress(OSError):
        return os.readlink(f"/proc/{os.getppid()}/fd/1").startswith(("/dev/pts/", "/dev/tty"))
    return False
