"""The folder of a run: a lock against other runs, and ``earlier/`` for the results of the run before."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import re
import socket
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from pdpetsc.discrete.communicator import Comm, agreed, is_root
from pdpetsc.errors import CaseError, OutputError
from pdpetsc.output.files import write_whole

LOCK = ".pdpetsc-lock"
# Marks the folder of a study and those of its runs.
STUDY = ".pdpetsc-study"
# Attempts of a process to get access to the lock file, 0.01 s apart.
PATIENCE = 300
# Folder to which a new run moves the results of the run before.
EARLIER = "earlier"
# Folder of the field files.
FIELDS = "fields"
# Surface of the body in that folder, written if positions alone do not determine it.
SURFACE = "surface.h5"
# Cells of the particles in that folder.
CELLS = "cells.h5"
# Files that plot and report write into the folder of a run.
DRAWN = ("deformed.png", "deformed.gif", "deformed.mp4", "history.png", "curve.png", "newton.png", "report.html")
# First bytes of files that may have no mark.
_WITHOUT_MARK = {".csv": (b"step,t,", b"step,t\r", b"step,t\n", b"particle,particles,"), ".png": (b"\x89PNG",)}
_STEP = re.compile(r"step_\d{5,}\.h5")


@dataclass(frozen=True)
class Holder:
    """The process that locks a folder; ``started`` distinguishes processes with the same id."""

    host: str
    pid: int
    started: str

    @property
    def words(self) -> str:
        """Return the text of the lock file."""
        return json.dumps(asdict(self)) + "\n"

    @property
    def gone(self) -> bool:
        """Return True if the process is known to have ended, which is possible for processes of this machine only."""
        # The system may hide the start of another user's process.
        return self.host == socket.gethostname() and _started(self.pid) not in (self.started, "unknown")


@contextlib.contextmanager
def holding(comm: Comm, folder: Path) -> Iterator[None]:
    """Create the output folder, and lock it while the body runs (collective).

    A lock file names host and process; no locks of the file system are required. A killed run leaves the file behind,
    and the next run on the same machine detects that its process has ended.

    Raises
    ------
    CaseError
        Another run locks the folder, or the folder cannot be written to; on all ranks.
    """
    me = Holder(socket.gethostname(), os.getpid(), _started(os.getpid()))
    with agreed(comm):
        if is_root(comm):
            try:
                folder.mkdir(parents=True, exist_ok=True)
                with _one_at_a_time(folder):
                    _lock(folder, me)
            except OSError as error:
                why = getattr(error.__cause__ or error, "strerror", None) or error
                raise CaseError(f"Cannot write to the output folder {folder}: {why}.") from None
    try:
        yield
    finally:
        if is_root(comm):
            with contextlib.suppress(OSError):
                if _read(folder / LOCK) == me.words:
                    (folder / LOCK).unlink()


def holder_of(folder: Path) -> Holder | None:
    """Return the process that locks a folder, also if it has ended; None without a valid lock file."""
    try:
        return _holder(_read(folder / LOCK))
    except OSError:
        return None


@contextlib.contextmanager
def _one_at_a_time(folder: Path) -> Iterator[None]:
    """Let one process of this machine at a time access the lock file of a folder, if the file system has locks.

    Only processes of this machine can detect a stale lock file, and two of them must not replace each other's new file.
    """
    descriptor = os.open(folder, os.O_RDONLY | os.O_CLOEXEC)
    try:
        for _ in range(PATIENCE):
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                time.sleep(0.01)
            except OSError:
                break
        yield
    finally:
        os.close(descriptor)


def _lock(folder: Path, me: Holder) -> None:
    """Write the lock file of this process into a folder; raises CaseError if another process locks it, OSError."""
    lock = folder / LOCK
    _refuse_holder(folder, lock)
    write_whole(lock, me.words, wait=False)
    # Without locks of the file system two processes may find the folder free; the last one gets it.
    if _read(lock) != me.words:
        raise CaseError(f"Another run is starting in {folder}; choose another folder.")


def _read(path: Path) -> str:
    descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        return os.read(descriptor, 4096).decode(errors="replace")
    finally:
        os.close(descriptor)


def _refuse_holder(folder: Path, lock: Path) -> None:
    """Raise CaseError unless the process of a lock file is known to have ended."""
    try:
        holder = _holder(_read(lock))
    except FileNotFoundError:
        return
    except OSError:
        holder = None
    if holder is None:
        raise CaseError(
            f"{lock} does not say which run it is of; remove it if none runs in {folder}, or choose another folder."
        )
    if not holder.gone:
        here = holder.host == socket.gethostname()
        raise CaseError(
            f"Process {holder.pid} on {holder.host} runs in {folder}; choose another folder"
            f"{'.' if here else f', or remove {lock} if that process has ended.'}"
        )


def _holder(text: str) -> Holder | None:
    try:
        found = json.loads(text)
        return Holder(str(found["host"]), int(found["pid"]), str(found["started"]))
    except (ValueError, KeyError, TypeError):
        return None


def _started(pid: int) -> str:
    """Return the start of a process of this machine as a unique text; empty if it has ended, "unknown" if hidden."""
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):
        return ""
    except PermissionError:
        pass
    try:
        # The process name in brackets may be any text; the 20th word after it is the start in clock ticks since boot.
        words = Path(f"/proc/{pid}/stat").read_text(errors="replace").rpartition(")")[2].split()
        return f"{Path('/proc/sys/kernel/random/boot_id').read_text().strip()} {words[19]}" if words[0] != "Z" else ""
    except (OSError, IndexError):
        return "unknown"


def set_aside(comm: Comm, folder: Path, keep: Path | None = None) -> None:
    """Move the results of an earlier run into ``earlier/`` and replace those in it (collective).

    Only files that pdpetsc wrote are touched.

    Parameters
    ----------
    keep : Path, optional
        Checkpoint from which this run continues.

    Raises
    ------
    CaseError
        The folder is that of a study, a file that pdpetsc did not write has the name of an output file, or the
        checkpoint would be removed.
    OutputError
        A file cannot be moved.
    """
    with agreed(comm):
        if not is_root(comm):
            return
        try:
            if any(folder.glob(f"*/{STUDY}")):
                raise CaseError(f"{folder} is the folder of a study, with one for each run. Choose another folder.")
            found = _of_earlier_run(folder)
            if not found:
                return
            place = folder / EARLIER
            if keep is not None and keep.resolve().parent == place.resolve():
                raise CaseError(f"A run in {folder} would replace {place}, which it goes on from; take another folder.")
            if place.is_symlink() or (place.exists() and not place.is_dir()):
                raise CaseError(f"{place} is not a folder, and the earlier results would go there; move it away.")
            for path in _of_earlier_run(place) if place.exists() else []:
                path.unlink()
            (place / FIELDS).mkdir(parents=True, exist_ok=True)
            for path in found:
                os.replace(path, place / path.relative_to(folder))
            with contextlib.suppress(OSError):
                (place / FIELDS).rmdir()
        except OSError as error:
            raise OutputError(
                f"Cannot move the earlier results out of {folder}: {error.strerror or error}; choose another folder."
            ) from error


def set_history_aside(comm: Comm, folder: Path) -> None:
    """Move ``history.csv`` into ``earlier/``, for a restart that cannot continue this file (collective).

    Raises
    ------
    OutputError
        The file cannot be moved.
    """
    _move_aside(comm, folder, ["history.csv"], lambda path: True)


def set_pictures_aside(comm: Comm, folder: Path) -> None:
    """Move pictures and report into ``earlier/``, because a restart in the same folder outdates them (collective).

    Files that pdpetsc did not draw stay.

    Raises
    ------
    OutputError
        A file cannot be moved.
    """
    _move_aside(comm, folder, ["picture.png", *DRAWN], _is_drawn)


def _move_aside(comm: Comm, folder: Path, names: Sequence[str], is_ours: Callable[[Path], bool]) -> None:
    with agreed(comm):
        if not is_root(comm):
            return
        for path in (folder / name for name in names):
            try:
                if not path.is_symlink() and path.is_file() and is_ours(path):
                    (folder / EARLIER).mkdir(exist_ok=True)
                    os.replace(path, folder / EARLIER / path.name)
            except OSError as error:
                raise OutputError(f"Cannot move {path} to {folder / EARLIER}: {error.strerror or error}.") from error


def _of_earlier_run(folder: Path) -> list[Path]:
    """Return the files of a run in a folder, the checkpoint first; raises CaseError if one is not of pdpetsc."""
    names = (
        "checkpoint.h5",
        "history.csv",
        "broken_bonds.csv",
        "fragments.csv",
        "crack.vtk",
        "fields.h5",
        "fields.xdmf",
        "picture.png",
        "summary.json",
    )
    paths = [folder / name for name in names]
    if (folder / FIELDS).is_symlink() or ((folder / FIELDS).exists() and not (folder / FIELDS).is_dir()):
        raise CaseError(f"{folder / FIELDS} is not a folder, and fields would be written there; move it away.")
    if (folder / FIELDS).is_dir():
        inside = sorted((folder / FIELDS).iterdir())
        paths += [
            path for path in inside if _STEP.fullmatch(path.name) or path.name in ("particles.h5", SURFACE, CELLS)
        ]
    found = [path for path in paths if os.path.lexists(path)]
    for path in found:
        if path.is_symlink() or not path.is_file() or not _marked(path):
            raise CaseError(f"{path} was not written by pdpetsc, or is damaged; move it away or choose another folder.")
    # Drawings made on demand. A run does not write these files, so files of another origin are no error.
    drawn = [folder / name for name in DRAWN]
    return found + [path for path in drawn if not path.is_symlink() and path.is_file() and _is_drawn(path)]


def _marked(path: Path) -> bool:
    """Return True if pdpetsc wrote a file: it has a mark, or is a table or old picture beside the summary of a run."""
    if path.suffix == ".json":
        return _is_summary(path)
    with path.open("rb") as file:
        head = file.read(4096)
    if b"pdpetsc" in head or b'<Grid Name="steps"' in head:
        return True
    begins = _WITHOUT_MARK.get(path.suffix)
    return begins is not None and head.startswith(begins) and _is_summary(path.with_name("summary.json"))


def _is_drawn(path: Path) -> bool:
    """Return True if a file has the mark of a drawing by pdpetsc."""
    with path.open("rb") as file:
        return b"pdpetsc" in file.read(4096) or (path.suffix == ".gif" and b"pdpetsc" in path.read_bytes())


def _is_summary(path: Path) -> bool:
    """Return True if a file is the summary of a run."""
    try:
        found = json.loads(path.read_text())
        return "pdpetsc" in found["versions"] and "status" in found
    except (OSError, ValueError, KeyError, TypeError):
        return False
