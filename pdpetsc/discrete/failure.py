"""What a rank does that has failed, when it does not know where the others are."""

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
# Message of the rank that prints why the run ends and is about to abort it.
SPEAKS = ("speaks",)
# How long a rank that failed waits for others to fail as well [s]: after a signal, which mpirun lets a kill follow in a
# second; after what a function of the case or a library raised, likely on one rank; after what pdpetsc found, likely on
# all.
SIGNALLED, SURPRISED, FOUND = 0.4, 1.5, 5.0
# Longer than any of them [s].
LONG = 10.0
# Time that the last line on stderr takes to be passed on before an abort [s].
SPOKEN = 0.5


# Communicators for these messages alone: receives of ghosts take any tag, and would take them for ghosts. One of all
# ranks stays for as long as the process lives; the last one is that of the run that goes on.
_apart: list[Comm] = []


@contextlib.contextmanager
def messages_apart(comm: Comm) -> Iterator[None]:
    """Let messages about failures go by a communicator of their own while the body runs on the ranks of ``comm``.

    Notes
    -----
    Collective. It is not freed where ranks may be anywhere, after an error that they have not agreed on.
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
    """Return whether all ranks failed together and may go on to communicate; True on one rank.

    Parameters
    ----------
    error, failure : exception
        What was raised, and the same as one sentence.

    Notes
    -----
    Not collective: a rank that fails alone leaves the others in a call that waits for it, so it waits for a moment
    only. Of several that fail each on their own the lowest returns, and the others wait for it to abort them.
    """
    comm = _channel()
    if failure.agreed >= comm.size:
        return True
    stopped = isinstance(error, KeyboardInterrupt)
    patience = SIGNALLED if stopped else FOUND if isinstance(error, PdpetscError) else SURPRISED
    lowest, together = _others(comm, (type(failure).__name__, *places(error)), patience)
    # Ranks that a signal ends are anywhere, whatever their lines say.
    if together and not stopped:
        return True
    if not lowest:
        time.sleep(LONG)
    return False


def give_up(failure: PdpetscError) -> NoReturn:
    """Say on stderr why this rank ends the run, and abort all ranks with exit status 1 (not collective)."""
    comm = _channel()
    # The abort sends signals to the others, which end them too: they shall not say so.
    sent = [comm.isend(SPEAKS, dest=rank, tag=FAILURE) for rank in range(comm.size) if rank != comm.rank]
    with contextlib.suppress(OSError):
        print(f"pdpetsc: {failure}", file=sys.stderr, flush=True)
    time.sleep(SPOKEN)
    comm.Abort(1)
    del sent
    raise SystemExit(1)


def leave(status: int) -> NoReturn:
    """End all ranks, which all call this, without finalising MPI and PETSc."""
    if MPI.COMM_WORLD.size == 1:
        os._exit(status)
    if MPI.COMM_WORLD.rank > 0:
        time.sleep(LONG)
    time.sleep(SPOKEN)
    MPI.COMM_WORLD.Abort(status)
    os._exit(status)


def _others(comm: Comm, mine: tuple[str, ...], patience: float) -> tuple[bool, bool]:
    """Return whether this is the lowest rank of those that have failed, and whether all have, at the same place."""
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
