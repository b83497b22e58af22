"""Handling of the failure of a rank if the state of the other ranks is unknown."""

from __future__ import annotations

import contextlib
import os
import sys
import time
from collections.abc import Iterator
from typing import NoReturn

from mpi4py import MPI

from pdpetsc.discrete.communicator import Comm, world
from pdpetsc.errors import PdpetscError, places

# Tag of messages that a rank has failed.
FAILURE = 911
# Message of the rank that prints the reason for the end and is about to abort the run.
SPEAKS = ("speaks",)
# Time that a failed rank waits for others to fail as well [s]: after a signal, since mpirun follows it with a kill
# within a second; after an exception of a function of the case or a library, likely on one rank; after an error found
# by pdpetsc, likely on all ranks.
SIGNALLED, SURPRISED, FOUND = 0.4, 1.5, 5.0
# Longer than any of these [s].
LONG = 10.0
# Time for passing on the last line on stderr before an abort [s].
SPOKEN = 0.5


# Communicators for these messages only: receives of ghosts accept any tag and would accept these messages. The
# communicator of all ranks exists as long as the process; the last one is that of the current run.
_apart: list[Comm] = []


@contextlib.contextmanager
def messages_apart(comm: Comm) -> Iterator[None]:
    """Use a separate communicator for messages about failures in the ``with`` block on the ranks of ``comm``.

    Notes
    -----
    Collective. The communicator is not freed after an error that the ranks have not agreed on, when their states are
    unknown.
    """
    if not _apart and MPI.Comm.Compare(comm, world()) in (MPI.IDENT, MPI.CONGRUENT):
        _apart.append(MPI.Intracomm(comm.Dup()))
    if _apart and MPI.Comm.Compare(comm, _apart[0]) in (MPI.IDENT, MPI.CONGRUENT):
        own = _apart[0]
        _apart.append(own)
    else:
        own = MPI.Intracomm(comm.Dup())
        _apart.append(own)
    together = True
    try:
        yield
    except BaseException as error:
        together = getattr(error, "agreed", 0) >= comm.size
        raise
    finally:
        _apart.pop()
        if together and own not in _apart:
            own.Free()


def _channel() -> Comm:
    return _apart[-1] if _apart else world()


def all_failed(error: BaseException, failure: PdpetscError) -> bool:
    """Return True if all ranks failed together and may continue to communicate; True on one rank.

    Parameters
    ----------
    error, failure : exception
        The exception, and its description as one sentence.

    Notes
    -----
    Not collective: if a rank fails alone, the others wait for it in a call, so it waits only for a short time. If
    several ranks fail independently, the lowest returns, and the others wait until it aborts them.
    """
    comm = _channel()
    if failure.agreed >= comm.size:
        return True
    stopped = isinstance(error, KeyboardInterrupt)
    patience = SIGNALLED if stopped else FOUND if isinstance(error, PdpetscError) else SURPRISED
    lowest, together = _others(comm, (type(failure).__name__, *places(error)), patience)
    # Ranks stopped by a signal can be at any place, for any line numbers.
    if together and not stopped:
        return True
    if not lowest:
        time.sleep(LONG)
    return False


def give_up(failure: PdpetscError) -> NoReturn:
    """Print on stderr why this rank ends the run, and abort all ranks with exit status 1 (not collective)."""
    comm = _channel()
    # The abort sends signals to the other ranks; they must not print a reason as well.
    sent = [comm.isend(SPEAKS, dest=rank, tag=FAILURE) for rank in range(comm.size) if rank != comm.rank]
    with contextlib.suppress(OSError):
        print(f"pdpetsc: {failure}", file=sys.stderr, flush=True)
    time.sleep(SPOKEN)
    comm.Abort(1)
    del sent
    raise SystemExit(1)


def leave(status: int) -> NoReturn:
    """End all ranks without finalising MPI and PETSc; all ranks must call it."""
    if MPI.COMM_WORLD.size == 1:
        os._exit(status)
    if MPI.COMM_WORLD.rank > 0:
        time.sleep(LONG)
    time.sleep(SPOKEN)
    MPI.COMM_WORLD.Abort(status)
    os._exit(status)


def _others(comm: Comm, mine: tuple[str, ...], patience: float) -> tuple[bool, bool]:
    """Return True if this is the lowest failed rank, and True if all ranks have failed at the same place."""
    heard = {comm.rank: mine}
    sent = [comm.isend(mine, dest=rank, tag=FAILURE) for rank in range(comm.size) if rank != comm.rank]
    end = time.monotonic() + patience
    status = MPI.Status()
    while len(heard) < comm.size and time.monotonic() < end:
        while comm.iprobe(source=MPI.ANY_SOURCE, tag=FAILURE, status=status):
            told = comm.recv(source=status.Get_source(), tag=FAILURE)
            if told == SPEAKS:
                return False, False
            heard[status.Get_source()] = told
        time.sleep(0.005)
    everyone = len(heard) == comm.size
    if everyone:
        MPI.Request.waitall(sent)
    return min(heard) == comm.rank, everyone and len(set(heard.values())) == 1
