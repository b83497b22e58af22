"""What a run prints, on rank 0 only."""

from __future__ import annotations

from collections.abc import Mapping

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from pdpetsc.discrete.communicator import Comm, is_root
from pdpetsc.solvers.protocol import StepResult


class _Console(Console):
    """A console that goes silent where nobody reads it any more, as behind ``| head``; rich would end the process."""

    def on_broken_pipe(self) -> None:
        """Print nothing from here on."""
        self.quiet = True


class Reporter:
    """Prints a line per step, with a bar where one rank writes to a terminal.

    On more ranks there is no bar: mpirun makes every pipe look like a terminal.

    Parameters
    ----------
    comm : Comm
        Ranks; only rank 0 prints.
    quiet : bool
        Print nothing but errors.
    """

    def __init__(self, comm: Comm, quiet: bool) -> None:
        self._console = _Console(quiet=quiet or not is_root(comm), highlight=False, soft_wrap=True, markup=False)
        columns = TextColumn("load"), BarColumn(), TextColumn("{task.percentage:3.0f} %"), TimeRemainingColumn()
        hidden = quiet or comm.size > 1 or not self._console.is_terminal
        self._progress = Progress(*columns, console=self._console, transient=True, disable=hidden)
        self._task = self._progress.add_task("load", total=1.0)

    def __enter__(self) -> Reporter:
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()

    def say(self, text: str) -> None:
        """Print a line."""
        self._console.print(text)

    def step(self, t: float, line: str | None) -> None:
        """Move the bar to a step time, and print the line of a converged step where it has one."""
        self._progress.update(self._task, completed=t)
        if line is not None:
            self.say(line)

    def cut_back(self, t: float, dt: float, result: StepResult) -> None:
        """Print that a step failed and is tried shorter."""
        self.say(f"           t > {t:<8.6g} failed: {result.reason}; trying a step of {dt:.3g}")

    def results(self, results: Mapping[str, float]) -> None:
        """Print the named results."""
        for name, value in results.items():
            self.say(f"  {name} = {value:.8g}")
