"""Collective operations that the distributed layers share."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeAlias

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from pdpetsc.arrays import GlobalIndex, starts_of
from pdpetsc.errors import CaseError, PdpetscError, RunError, described, notice, rebuilt

Comm: TypeAlias = MPI.Intracomm


def world() -> Comm:
    """Return the communicator of all ranks of this run."""
    return MPI.COMM_WORLD


def mpi_library() -> str:
    """Return name and version of the MPI library of mpi4py."""
    return str(MPI.Get_library_version()).split(",")[0].split("\n")[0].strip()


def communicator(given: Any = None) -> Comm:
    """Return the communicator of the argument, of mpi4py or petsc4py; by default that of all ranks.

    Raises
    ------
    CaseError
        The argument is neither.
    """
    if given is None:
        return world()
    comm = given.tompi4py() if hasattr(given, "tompi4py") else given
    if not isinstance(comm, MPI.Intracomm) or comm == MPI.COMM_NULL:
        raise CaseError(f"comm takes a communicator of mpi4py or petsc4py that this rank is in, not {given!r}.")
    return comm


def alone() -> Comm:
    """Return the communicator of this rank only."""
    return MPI.COMM_SELF


def is_root(comm: Comm) -> bool:
    """Return True if this rank prints and writes small files."""
    return bool(comm.rank == 0)


@contextlib.contextmanager
def agreed(comm: Comm) -> Iterator[None]:
    """Raise on every rank an exception that the ``with`` block raised on any; the error of the lowest rank is used.

    Every exception, ``sys.exit`` included, becomes an error of one sentence (``errors.described``). The rank that
    raised it keeps its own object, with class and traceback; the others get one of the same kind and text. Only
    exceptions of signals are not shared, since they can occur at any place of any rank.

    Notes
    -----
    Collective; the block itself must not communicate.
    """
    error: PdpetscError | None = None
    cause: BaseException | None = None
    try:
        yield
    except (GeneratorExit, KeyboardInterrupt):
        raise
    except BaseException as caught:
        error, cause = described(caught), caught
        if isinstance(error, RunError) and comm.size > 1 and error.rank is None:
            error.rank = comm.rank
    told = comm.allgather(None if error is None else notice(error))
    first = next((rank for rank, other in enumerate(told) if other is not None), None)
    if first is None:
        return
    if first != comm.rank or error is None:
        error = rebuilt(told[first])
        cause = None
    if isinstance(error, RunError) and None not in told:
        error.rank = None
    error.agreed = comm.size
    if error is cause:
        raise error
    raise error from cause


def total(comm: Comm, values: Any) -> NDArray[Any]:
    """Return the sum over ranks of an array (collective)."""
    return _reduced(comm, values, MPI.SUM)


def scalar_product(comm: Comm, one: NDArray[Any], other: NDArray[Any]) -> float:
    """Return the sum over entries and ranks of the products of two arrays (collective)."""
    return float(total(comm, (one * other).sum()))


def norm(comm: Comm, values: NDArray[Any]) -> float:
    """Return the root of the sum over entries and ranks of the squares of an array (collective)."""
    return float(np.sqrt(total(comm, (values**2).sum())))


def anywhere(comm: Comm, marked: Any) -> bool:
    """Return True if an entry of an array, or a flag, is not zero on any rank (collective)."""
    return int(total(comm, int(np.any(marked)))) > 0


def count_nonzero(comm: Comm, values: Any) -> int:
    """Return the number of entries of an array that are not zero, on all ranks (collective)."""
    return int(total(comm, np.count_nonzero(values)))


def counted_once(comm: Comm, value: float) -> float:
    """Return a number that all ranks know on the first of them, and 0 on the others, for sums over the ranks."""
    return value if comm.rank == 0 else 0.0


def largest(comm: Comm, values: Any, initial: float = -np.inf) -> float:
    """Return the maximum over ranks of a number, or of the entries of an array, ``initial`` at least (collective)."""
    return float(_reduced(comm, float(np.max(np.asarray(values, dtype=float), initial=initial)), MPI.MAX))


def all_largest(comm: Comm, values: Any) -> NDArray[Any]:
    """Return the maximum over ranks of each number of an array (collective)."""
    return _reduced(comm, values, MPI.MAX)


def smallest(comm: Comm, values: Any, initial: float = np.inf) -> float:
    """Return the minimum over ranks of a number, or of the entries of an array, ``initial`` at most (collective)."""
    return float(_reduced(comm, float(np.min(np.asarray(values, dtype=float), initial=initial)), MPI.MIN))


def bounds(comm: Comm, x: NDArray[Any]) -> NDArray[Any]:
    """Return the least and the largest value over ranks of each column of ``x`` (2, n_columns) (collective).

    Infinite, with the least above the largest, if no rank has a row.
    """
    ends = np.stack([-x, x]).max(axis=1, initial=-np.inf)
    low, high = all_largest(comm, ends)
    return np.stack([-low, high])


def near_ranks(comm: Comm, own: NDArray[Any], x: NDArray[Any], reach: float) -> list[GlobalIndex]:
    """Return, for each rank, which points ``x`` are within a reach of the box around its ``own`` ones (collective)."""
    ends = own.min(axis=0, initial=np.inf) - reach, own.max(axis=0, initial=-np.inf) + reach
    return [np.flatnonzero(np.all((x >= low) & (x <= high), axis=1)) for low, high in comm.allgather(ends)]


def _reduced(comm: Comm, values: Any, operation: MPI.Op) -> NDArray[Any]:
    mine = np.ascontiguousarray(values).reshape(np.shape(values))
    result = np.empty_like(mine)
    comm.Allreduce(mine, result, op=operation)
    return result


def offset(comm: Comm, count: int) -> int:
    """Return the number of items on lower ranks (collective)."""
    before = comm.exscan(count, op=MPI.SUM)
    return 0 if before is None else int(before)


def exchange(
    comm: Comm, destination: NDArray[Any], arrays: Sequence[NDArray[Any]]
) -> tuple[list[NDArray[Any]], GlobalIndex]:
    """Send row ``r`` of every array to rank ``destination[r]``.

    Parameters
    ----------
    destination : (n,) int
        Rank that receives each row.
    arrays : sequence of (n, ...)
        Arrays with the same first dimension.

    Returns
    -------
    received : list of (m, ...)
        Rows in order of source rank, and within a source in the order of that rank.
    counts : (size,) int64
        Rows received from each rank.

    Notes
    -----
    Collective.
    """
    order = np.argsort(destination, kind="stable")
    send = np.bincount(destination, minlength=comm.size).astype(np.int64)
    counts = np.empty_like(send)
    comm.Alltoall(send, counts)
    received = []
    for array in arrays:
        rows = np.ascontiguousarray(array[order])
        result = np.empty((int(counts.sum()), *array.shape[1:]), dtype=array.dtype)
        width = int(np.prod(array.shape[1:], dtype=np.int64)) * array.dtype.itemsize
        row = MPI.BYTE.Create_contiguous(width).Commit()
        comm.Alltoallv(
            [rows.view(np.uint8), send, starts_of(send)[:-1], row],
            [result.view(np.uint8), counts, starts_of(counts)[:-1], row],
        )
        row.Free()
        received.append(result)
    return received, counts


def owners(comm: Comm, first: int, rows: NDArray[Any]) -> tuple[GlobalIndex, GlobalIndex]:
    """Return the rank that holds each of some rows (n,), and their numbers on it.

    Ranks hold rows one after another; ``first`` is the first row of this rank (collective).
    """
    firsts = np.array(comm.allgather(first), dtype=np.int64)
    rank = np.searchsorted(firsts, rows, side="right") - 1
    return rank, rows - firsts[rank]


def fetch(comm: Comm, holder: NDArray[Any], row: NDArray[Any], part: NDArray[Any]) -> NDArray[Any]:
    """Fetch rows of an array that is distributed over the ranks.

    Parameters
    ----------
    holder, row : (n,) int
        Rank that holds each requested row, and the number of the row on that rank.
    part : (m, ...)
        Rows that this rank holds.

    Notes
    -----
    Collective.
    """
    return ask(comm, holder, row, lambda asked, source: part[asked])


def ask(
    comm: Comm, holder: NDArray[Any], question: NDArray[Any], answers: Callable[[Any, Any], NDArray[Any]]
) -> NDArray[Any]:
    """Return the answers of the ranks ``holder`` (n,) to the rows of ``question`` (collective).

    ``answers`` is called on every rank with the questions that it received and the source rank of each.
    """
    (asked,), counts = exchange(comm, holder, [question])
    source = np.repeat(np.arange(comm.size), counts)
    (answer,), _ = exchange(comm, source, [answers(asked, source)])
    found = np.empty_like(answer)
    found[np.argsort(holder, kind="stable")] = answer
    return found
