"""Progress of a run: time per step, expected end, memory."""

from __future__ import annotations

import contextlib
import math
import os
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path

# Number of last steps from which the pace is computed.
RECENT = 8


class Pace:
    """Measure the time per step of a run.

    Parameters
    ----------
    clock : callable
        Returns seconds.

    Attributes
    ----------
    steps : int
        Steps so far.
    t : float
        Current step time [-].
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._marks: deque[tuple[float, float]] = deque([(clock(), 0.0)], maxlen=RECENT + 1)
        self.steps = 0
        self.t = 0.0

    def begin(self, t: float = 0.0, steps: int = 0) -> None:
        """Start the clock for the next step, at step time ``t`` and after ``steps`` earlier steps."""
        self.steps, self.t = steps, t
        self._marks.clear()
        self._marks.append((self._clock(), t))

    def step(self, t: float) -> None:
        """Record the end of a step at step time ``t``."""
        self.steps += 1
        self.t = t
        self._marks.append((self._clock(), t))

    @property
    def per_step(self) -> float:
        """Return the mean time of the last steps [s]; nan before the first step has ended."""
        count = len(self._marks) - 1
        return (self._marks[-1][0] - self._marks[0][0]) / count if count else math.nan

    @property
    def since(self) -> float:
        """Return the time since the last step ended [s]."""
        return self._clock() - self._marks[-1][0]

    @property
    def left(self) -> float:
        """Return the time until step time 1 at the pace of the last steps [s].

        The result is nan before the first step has ended, if the load does not grow, and beyond step time 1.
        """
        (begin, low), (end, high) = self._marks[0], self._marks[-1]
        if not (high > low and end > begin and high <= 1.0):
            return math.nan
        return max(0.0, (1.0 - high) * (end - begin) / (high - low) - self.since)

    def words(self) -> str:
        """Return the progress in words, as far as it is known."""
        said = [f"step {self.steps}", f"t = {self.t:.4g}"]
        if math.isfinite(self.per_step):
            said.append(f"{_seconds(self.per_step)} a step")
        if math.isfinite(self.left) and self.t < 1.0:
            form = "%H:%M" if self.left < 43200.0 else "%d %b %H:%M"
            end = time.strftime(form, time.localtime(time.time() + self.left))
            said.append(f"ends in {_seconds(self.left)} ({end})")
        memory = memory_now()
        if memory:
            said.append(f"{memory / 2**20:.0f} MiB")
        return ", ".join(said)


def memory_now() -> int:
    """Return the memory of this process [bytes]; 0 if the system does not report it."""
    with contextlib.suppress(OSError, ValueError, IndexError):
        return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    return 0


def _seconds(seconds: float) -> str:
    if seconds < 100.0:
        return f"{seconds:.2g} s" if seconds < 10.0 else f"{seconds:.0f} s"
    minutes, seconds = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes:02d} min" if hours else f"{minutes} min {seconds:02d} s"
