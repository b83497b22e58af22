"""Compilation and caching of kernels."""

from __future__ import annotations

import contextlib
import fcntl
import os
import stat
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any, cast

import numba
from numba.core import event

# No "nnan"/"ninf": inadmissible deformations are detected by comparison with NaN and infinity.
FASTMATH = {"contract", "reassoc", "nsz", "arcp"}
# Longest time that a process waits for another one that compiles, before it compiles itself [s].
LONGEST_WAIT = 300.0

_trouble: list[str] = []


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile ``function`` with numba, and cache the machine code on disk if possible.

    Parameters
    ----------
    function : callable
        Operates on flat arrays and scalars; the integers it closes over become compile-time constants.

    Returns
    -------
    callable
        The compiled function, with the same signature.
    """
    if numba.config.DISABLE_JIT:  # NUMBA_DISABLE_JIT=1
        return function
    jit: Any = numba.njit(nogil=True, error_model="numpy", fastmath=FASTMATH)(function)
    try:
        jit.enable_caching()
    except (RuntimeError, OSError) as error:  # no writable folder
        note(error)
    else:
        # The machine code of a kernel contains that of the kernels that it calls, possibly from other files. Numba
        # checks the file of the kernel only, and would use outdated code after an update.
        index = jit._cache._cache_file
        index._source_stamp = index._source_stamp, sources()
        jit._cache = _Forgiving(jit._cache)
    return cast(Callable[..., Any], jit)


@lru_cache
def sources() -> tuple[tuple[str, int, int], ...]:
    """Return name, modification time and size of the files of kernels."""
    found = sorted(Path(__file__).parent.glob("*.py"))
    return tuple((path.name, path.stat().st_mtime_ns, path.stat().st_size) for path in found)


def cache_trouble() -> str:
    """Return the reason why kernels cannot be cached and are compiled in every run; empty if they can."""
    return _trouble[0] if _trouble else ""


class _First(event.Listener):  # type: ignore[misc]
    """Calls a function at the first compilation."""

    def __init__(self, tell: Callable[[], None]) -> None:
        self._tell: Callable[[], None] | None = tell

    def on_start(self, event: Any) -> None:
        """Call the function once; numba calls this method."""
        if self._tell is not None:
            tell, self._tell = self._tell, None
            tell()

    def on_end(self, event: Any) -> None:
        """Do nothing; numba calls this method."""


def first_compilation(tell: Callable[[], None]) -> contextlib.AbstractContextManager[None]:
    """Return a context that calls ``tell`` before the first compilation of a kernel that is not cached."""
    return cast(contextlib.AbstractContextManager[None], event.install_listener("numba:compile", _First(tell)))


class _Forgiving:
    """Numba's cache of a function; if the cache fails, the function is compiled and the run continues.

    Files may be truncated by a full disk, written by another version, or owned by another user. Reading them can raise
    any exception of pickle.
    """

    def __init__(self, cache: Any) -> None:
        self._cache = cache

    def __getattr__(self, name: str) -> Any:
        return getattr(self._cache, name)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        try:
            return self._cache.load_overload(sig, target_context)
        except Exception as error:
            note(error)
            with contextlib.suppress(Exception):
                self._cache.flush()  # an empty index, so that this function can be cached again
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        try:
            self._cache.save_overload(sig, data)
        except Exception as error:
            note(error)


def note(error: Exception) -> None:
    """Store the reason why kernels cannot be cached."""
    _trouble.append(f"{type(error).__name__}: {error}".splitlines()[0])


@contextlib.contextmanager
def cache_lock() -> Iterator[None]:
    """Hold the lock of the kernel cache while kernels are compiled.

    Numba writes its cache index without a lock: two processes that compile different signatures of one function at the
    same time can leave an index with the wrong file. If no lock file can be created or locked, or another process has
    held it for five minutes, the body runs without lock. The only risk is a second compilation.

    Notes
    -----
    Not collective. One process of a job holds the lock; jobs with the same cache exclude each other.
    """
    handle = _lock_file()
    try:
        if handle is not None:
            _lock(handle)
        yield
    finally:
        if handle is not None:
            os.close(handle)


def _lock_file() -> int | None:
    """Open the lock file beside the cache, else in the temporary folder; never open a file of another user."""
    with contextlib.suppress(OSError):
        folder = Path(os.environ.get("NUMBA_CACHE_DIR") or Path(__file__).parent / "__pycache__")
        folder.mkdir(parents=True, exist_ok=True)
        return _own_file(folder)
    with contextlib.suppress(OSError):
        return _own_file(Path(tempfile.gettempdir()))
    return None


def _own_file(folder: Path) -> int:
    path = folder / f"pdpetsc-{os.getuid()}.lock"
    handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
    found = os.fstat(handle)
    if found.st_uid != os.getuid() or not stat.S_ISREG(found.st_mode):
        os.close(handle)
        raise PermissionError(f"{path} is not a file of this user")
    return handle


def _lock(handle: int) -> None:
    """Wait for the lock for a limited time: its holder may be stopped, or the file system may not support locks."""
    end = time.monotonic() + LONGEST_WAIT
    while time.monotonic() < end:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return
        except BlockingIOError:
            time.sleep(0.05)
        except OSError:  # Lustre without flock, NFS without its lock daemon
            return
