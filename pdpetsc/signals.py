"""Ctrl-C and SIGTERM end a run between Newton iterations, never in the middle of a write."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Callable, Iterator
from types import FrameType

from pdpetsc.discrete.communicator import Comm, total


@contextlib.contextmanager
def stop_on_signals(comm: Comm) -> Iterator[Callable[[], bool]]:
    """Catch SIGINT and SIGTERM inside the body; yield a collective question whether any rank got one.

    Outside the main thread signals stay as they are.
    """
    caught = False

    def note(number: int, frame: FrameType | None) -> None:
        nonlocal caught
        caught = True

    previous = {}
    with contextlib.suppress(ValueError):
        for number in (signal.SIGINT, signal.SIGTERM):
            previous[number] = signal.signal(number, note)
    try:
        yield lambda: int(total(comm, int(caught))) > 0
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
