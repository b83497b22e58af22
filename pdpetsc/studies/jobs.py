"""Runs in separate processes, several at a time, that end with the starting process."""

from __future__ import annotations

import contextlib
import ctypes
import os
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from pdpetsc.errors import CaseError
from pdpetsc.machine import cores, threads

PACKAGE = Path(__file__).parent.parent
# Default launcher of ranks.
LAUNCHER = "mpirun -n {ranks}"
# Start of the lines of warnings and errors.
OURS = "pdpetsc: "
# Interval of polling runs [s].
LOOK = 0.02
# Time limit for a run to end after a request [s].
ENDING = 10.0
# Linux: the option for a signal to a process when its parent ends.
_PR_SET_PDEATHSIG = 1


class Job:
    """One run in a separate process.

    Parameters
    ----------
    words : sequence of str
        The command.
    log : Path
        File of its output.
    """

    def __init__(self, words: Sequence[str], log: Path) -> None:
        self.log = log
        parent = os.getpid()
        libc = ctypes.CDLL(None) if sys.platform == "linux" else None

        def with_its_parent() -> None:
            if libc is not None:
                libc.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
                if os.getppid() != parent:
                    os._exit(1)

        try:
            with log.open("w") as stream:
                # A separate session: Ctrl-C goes to the study, which ends its runs.
                self._process = subprocess.Popen(
                    list(words), stdin=subprocess.DEVNULL, stdout=stream, stderr=subprocess.STDOUT,
                    env=_unbound(environment()), start_new_session=True, preexec_fn=with_its_parent,
                )  # fmt: skip
        except OSError as error:
            raise CaseError(f"Cannot start {words[0]}: {error.strerror or error}.") from None

    @property
    def ended(self) -> int | None:
        """Return its exit status, negative after a signal; None while it runs."""
        return self._process.poll()

    @property
    def said(self) -> str:
        """Return its last message."""
        return self.messages[-1] if self.messages else _last_message(self._text)

    @property
    def messages(self) -> list[str]:
        """Return its warnings and errors."""
        return [line.removeprefix(OURS) for line in self._text.splitlines() if line.startswith(OURS)]

    @property
    def _text(self) -> str:
        try:
            return self.log.read_text(errors="replace")
        except OSError:
            return ""

    def ask_to_end(self) -> None:
        """Send the signal to end."""
        with contextlib.suppress(OSError):
            self._process.terminate()

    def end(self, within: float) -> None:
        """Wait for its end at most ``within`` [s], then kill it and its child processes."""
        try:
            self._process.wait(timeout=within)
        except subprocess.TimeoutExpired:
            with contextlib.suppress(OSError):
                os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()


def _last_message(text: str) -> str:
    """Return the last line of a log, or the first line of the launcher's banner at its end, between lines of dashes.

    The banner of Open MPI that begins with "Primary job" only reports that a rank failed.
    """
    blocks: list[list[str]] = [[]]
    for line in filter(None, map(str.strip, text.splitlines())):
        if set(line) == {"-"}:
            blocks.append([])
        else:
            blocks[-1].append(line)
    messages = [block[0] if number % 2 else block[-1] for number, block in enumerate(blocks) if block]
    return ([message for message in messages if not message.startswith("Primary job")] or ["no message."])[-1]


def end_all(jobs: Sequence[Job]) -> None:
    """End active runs."""
    for job in jobs:
        job.ask_to_end()
    until = time.monotonic() + ENDING
    for job in jobs:
        job.end(max(0.1, until - time.monotonic()))


def command(case: Path, parameters: Sequence[str], folder: Path, options: Sequence[str]) -> list[str]:
    """Return the command of a run on one rank."""
    return [sys.executable, "-m", "pdpetsc", str(case), *parameters, "-o", str(folder), *options]


def launched(words: Sequence[str], ranks: int, launcher: str | None) -> list[str]:
    """Return a command on some ranks.

    Raises
    ------
    CaseError
        The launcher does not contain the number of ranks.
    """
    if launcher is None and ranks == 1:
        return list(words)
    first = shlex.split(LAUNCHER if launcher is None else launcher)
    if not any("{ranks}" in word for word in first):
        raise CaseError(f'--launcher needs {{ranks}} where their number goes, as in "{LAUNCHER}".')
    return [*(word.replace("{ranks}", str(ranks)) for word in first), *words]


def environment() -> dict[str, str]:
    """Return the environment of a run: the environment of this process, with this pdpetsc and one thread per rank."""
    found = dict(os.environ)
    found.setdefault("OMP_NUM_THREADS", "1")
    if not {"site-packages", "dist-packages"} & set(PACKAGE.parts):
        paths = [str(PACKAGE.parent), *filter(None, [found.get("PYTHONPATH")])]
        found["PYTHONPATH"] = os.pathsep.join(dict.fromkeys(paths))
    return found


def too_many(jobs: int, ranks: int) -> str:
    """Return a warning if parallel runs use more cores than available, else an empty text."""
    wanted, there = jobs * ranks * threads(), cores()
    if wanted <= there:
        return ""
    of_threads = f" x {threads()} threads" if threads() > 1 else ""
    return f"{jobs} jobs x {ranks} ranks{of_threads} want {wanted} cores, and there are {there}: runs slow each other."


def _unbound(found: dict[str, str]) -> dict[str, str]:
    """Disable binding of ranks by Open MPI: otherwise every mpirun would use the first cores."""
    found.setdefault("OMPI_MCA_hwloc_base_binding_policy", "none")
    found.setdefault("PRTE_MCA_hwloc_default_binding_policy", "none")
    return found
