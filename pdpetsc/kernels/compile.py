"""How kernels are compiled and cached."""

from __future__ import annotations

import contextlib
import fcntl
import os
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, cast

import numba

# No "nnan"/"ninf": an inadmissible deformation is found by comparing with NaN and infinity.
FASTMATH = {"contract", "reassoc", "nsz", "arcp"}


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile ``function`` with numba, caching the machine code on disk.

    Parameters
    ----------
    function : callable
        Operates on flat arrays and scalars; the integers it closes over become compile-time constants.

    Returns
    -------
    callable
        The compiled function, with the same signature.
    """
    jit = numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH)
    return cast(Callable[..., Any], jit(function))


@contextlib.contextmanager
def cache_lock() -> Iterator[None]:
    """Hold the lock of the kernel cache while kernels are compiled.

    Numba writes its cache index without a lock, so two processes that compile different signatures of one function at
    the same moment can leave an index that names the wrong file. Where no lock file can be made the body runs unlocked,
    which risks a second compilation only.

    Notes
    -----
    Not collective. One process of a job holds it; jobs that share the cache exclude each other.
    """
    beside = Path(os.environ.get("NUMBA_CACHE_DIR") or Path(__file__).parent / "__pycache__")
    handle = None
    for folder in (beside, Path(tempfile.gettempdir())):
        with contextlib.suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
            handle = open(folder / f"pdpetsc-{os.getuid()}.lock", "w")  # noqa: SIM115
            break
    if handle is None:
        yield
        return
    with handle:
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield
