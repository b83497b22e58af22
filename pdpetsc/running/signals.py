"""Signals end a run between Newton iterations, never in the middle of a write; a set-up they end at once."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from types import FrameType

from pdpetsc.discrete.communicator import Comm, total

# Ctrl-C, the batch system or `kill`, and the end of the terminal.
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
# A signal that arrives again this soon is the same one, sent to a group and passed on by a parent [s].
ECHO = 0.3
# A rank that waits for another in MPI cannot react; after this long it is ended from outside [s].
PATIENCE = 2.0


class Signals:
    """What signals do at present.

    Attributes
    ----------
    patient : bool
        Whether the first signal is only noted, for ``asked``; else it raises KeyboardInterrupt where the run is.
    deaf : bool
        Whether signals do nothing, as while ranks find out which of them have failed.
    """

    def __init__(self, comm: Comm) -> None:
        self.patient = False
        self.deaf = False
        self._comm = comm
        self._caught = False
        self._at = 0.0

    def asked(self) -> bool:
        """Return True if any rank got a signal (collective)."""
        return int(total(self._comm, int(self._caught))) > 0

    def note(self, number: int, frame: FrameType | None) -> None:
        """Take a signal: the first is noted or raises, a second one always raises."""
        now = time.monotonic()
        if self.deaf or (self._caught and now - self._at < ECHO):
            return
        first, self._caught, self._at = not self._caught, True, now
        if not (first and self.patient):
            raise KeyboardInterrupt

    def waits(self) -> bool:
        """Return True if a signal that should end the run has not reached Python yet."""
        return not (self.patient or self.deaf or self._caught)


@contextlib.contextmanager
def watched(comm: Comm, stuck: Callable[[], None]) -> Iterator[Signals]:
    """Take signals in the body.

    Parameters
    ----------
    stuck : callable
        Called in another thread where a signal should have ended this rank and it still waits for another one.

    Notes
    -----
    Not collective. Outside the main thread signals stay as they are; so do those that are ignored, as under nohup.
    """
    signals = Signals(comm)
    if threading.current_thread() is not threading.main_thread():
        yield signals
        return
    previous = {}
    for number in SIGNALS:
        if number == signal.SIGTERM or signal.getsignal(number) is not signal.SIG_IGN:
            previous[number] = signal.signal(number, signals.note)
    read, write = os.pipe()
    os.set_blocking(write, False)
    outer = signal.set_wakeup_fd(write, warn_on_full_buffer=False)
    over = threading.Event()
    threading.Thread(target=_watch, args=(read, signals, over, stuck), daemon=True).start()
    try:
        yield signals
    finally:
        over.set()
        signal.set_wakeup_fd(outer)
        os.close(write)
        for number, handler in previous.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def held() -> Iterator[None]:
    """Let signals that come in the body do after it what they do outside.

    Notes
    -----
    Python drops what a handler raises inside a fork's own calls, and with it the signal. Not collective. Outside the
    main thread, and where a signal has no handler in Python, nothing changes.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    handlers = {number: handler for number in SIGNALS if callable(handler := signal.getsignal(number))}
    came: list[tuple[int, FrameType | None]] = []
    for number in handlers:
        signal.signal(number, lambda number, frame: came.append((number, frame)))
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        for arrived, frame in came:
            handlers[signal.Signals(arrived)](arrived, frame)


def _watch(read: int, signals: Signals, over: threading.Event, stuck: Callable[[], None]) -> None:
    """Wait for a signal that Python does not get to handle."""
    try:
        while numbers := os.read(read, 16):
            if any(number in SIGNALS for number in numbers) and not over.wait(PATIENCE) and signals.waits():
                stuck()
    finally:
        os.close(read)
