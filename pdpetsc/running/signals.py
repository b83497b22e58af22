"""Signals: end a run between Newton iterations, never during a write; end a set-up at once."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from types import FrameType

from pdpetsc.discrete.communicator import Comm, anywhere

# Ctrl-C, the batch system or `kill`, and the end of the terminal.
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
# A signal repeated within this time is the same one, sent to a group and forwarded by a parent [s].
ECHO = 0.3
# A rank that waits in MPI cannot react; it is ended from outside after this time [s].
PATIENCE = 2.0


class Signals:
    """The current handling of signals.

    Attributes
    ----------
    patient : bool
        If True, the first signal is only recorded for ``asked``; otherwise it raises KeyboardInterrupt at once.
    deaf : bool
        If True, signals are ignored, for example while ranks determine which of them failed.
    """

    def __init__(self, comm: Comm) -> None:
        self.patient = False
        self.deaf = False
        self._comm = comm
        self._caught = False
        self._at = 0.0

    def asked(self) -> bool:
        """Return True if any rank got a signal (collective)."""
        return anywhere(self._comm, self._caught)

    def note(self, number: int, frame: FrameType | None) -> None:
        """Handle a signal: record the first or raise, always raise for a second."""
        now = time.monotonic()
        if self.deaf or (self._caught and now - self._at < ECHO):
            return
        first, self._caught, self._at = not self._caught, True, now
        if not (first and self.patient):
            raise KeyboardInterrupt

    def waits(self) -> bool:
        """Return True if a signal has arrived that Python has not handled yet."""
        return not (self.patient or self.deaf or self._caught)


@contextlib.contextmanager
def watched(comm: Comm, stuck: Callable[[], None]) -> Iterator[Signals]:
    """Handle signals in the body.

    Parameters
    ----------
    stuck : callable
        Called in another thread if this rank still waits for another one after a signal.

    Notes
    -----
    Not collective. Outside the main thread, and for ignored signals as under nohup, handlers are not changed.
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
    """Defer signals that arrive in the body until its end.

    Notes
    -----
    Python drops exceptions of handlers inside the calls of a fork, and thus the signal. Not collective. No effect
    outside the main thread, and for signals without a handler in Python.
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
    """Wait for a signal that Python cannot handle in time."""
    try:
        while numbers := os.read(read, 16):
            if any(number in SIGNALS for number in numbers) and not over.wait(PATIENCE) and signals.waits():
                stuck()
    finally:
        os.close(read)
