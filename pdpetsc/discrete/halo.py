"""Exchange of particle data between owners and the ranks that hold ghosts."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from pdpetsc.arrays import GlobalIndex, LocalIndex, starts_of
from pdpetsc.discrete.communicator import Comm, exchange

# Waits for an exchange that has been started (collective).
Finish: TypeAlias = Callable[[], None]


class Halo:
    """Exchange data forward (owner to ghost) and in reverse (ghosts added to owner).

    Local arrays contain ``n_owned`` own rows, then the ghosts grouped by owning rank. With images, a rank can own its
    ghosts: images of its own particles.

    Parameters
    ----------
    comm : Comm
        All ranks of the cloud.
    n_owned : int
        Number of particles that this rank owns.
    ghost_owner : (n_ghost,) int32
        Owning rank of each ghost, ascending.
    ghost_index : (n_ghost,) int32
        Index of each ghost on its owner.

    Notes
    -----
    The constructor and both exchanges are collective among ranks that share ghosts.
    """

    def __init__(self, comm: Comm, n_owned: int, ghost_owner: LocalIndex, ghost_index: LocalIndex) -> None:
        self.comm = comm
        self.n_owned = n_owned
        self.n_ghost = len(ghost_owner)
        (send_index,), asked = exchange(comm, ghost_owner, [ghost_index])
        self.send_index: LocalIndex = send_index
        self.targets = np.flatnonzero(asked)
        self.target_ptr: GlobalIndex = starts_of(asked[self.targets])
        # Images of one particle arrive in ascending runs, one per place; no run contains a particle twice.
        again = np.flatnonzero(np.diff(self.send_index) <= 0) + 1
        self._runs = np.union1d(again, self.target_ptr)
        held = np.bincount(ghost_owner, minlength=comm.size)
        self.sources = np.flatnonzero(held)
        self.source_ptr: GlobalIndex = starts_of(held[self.sources])

    def forward(self, values: NDArray[Any]) -> None:
        """Overwrite the ghost rows of ``values`` (n_owned + n_ghost, ...) with the rows of the owners (collective)."""
        self.start_forward(values)()

    def with_ghosts(self, own: NDArray[Any]) -> NDArray[Any]:
        """Return own rows (n_owned, ...) with those of the ghosts in a new array (n_local, ...) (collective)."""
        values = np.empty((self.n_owned + self.n_ghost, *own.shape[1:]), dtype=own.dtype)
        values[: self.n_owned] = own
        self.forward(values)
        return values

    def reverse(self, values: NDArray[Any]) -> None:
        """Add the ghost rows of ``values`` to the rows of their owners (collective)."""
        self.start_reverse(values)()

    def start_forward(self, values: NDArray[Any]) -> Finish:
        """Start ``forward``. Until the returned function is called, own rows may be read, ghost rows not accessed."""
        ghosts = values[self.n_owned :]
        outgoing = values[self.send_index]
        return self._start(outgoing, self.targets, self.target_ptr, ghosts, self.sources, self.source_ptr)

    def start_reverse(self, values: NDArray[Any]) -> Finish:
        """Start ``reverse``. Before the returned function is called, only own rows may change, by additions."""
        incoming = np.empty((len(self.send_index), *values.shape[1:]), dtype=values.dtype)
        arrived = self._start(
            values[self.n_owned :], self.sources, self.source_ptr, incoming, self.targets, self.target_ptr
        )

        def finish() -> None:
            arrived()
            for begin, end in zip(self._runs[:-1], self._runs[1:], strict=True):
                part = slice(begin, end)
                values[self.send_index[part]] += incoming[part]

        return finish

    def reverse_rows(self, values: NDArray[Any], lengths: GlobalIndex, incoming_lengths: GlobalIndex) -> NDArray[Any]:
        """Send rows of variable length, one per ghost, to the owners of the ghosts.

        Parameters
        ----------
        values : (sum of lengths,)
            The rows one after another.
        lengths : (n_ghost,) int64
            Length of each row.
        incoming_lengths : (n_sent,) int64
            Length of each row to receive, in the order of ``send_index``.

        Returns
        -------
        (sum of incoming_lengths,)
            The rows for this rank's particles ``send_index``, one after another.

        Notes
        -----
        Collective.
        """
        starts = starts_of(lengths)[self.source_ptr]
        incoming_starts = starts_of(incoming_lengths)
        incoming = np.empty(int(incoming_starts[-1]), dtype=values.dtype)
        self._start(values, self.sources, starts, incoming, self.targets, incoming_starts[self.target_ptr])()
        return incoming

    def _start(
        self,
        outgoing: NDArray[Any],
        to: NDArray[Any],
        out_ptr: NDArray[Any],
        incoming: NDArray[Any],
        source: NDArray[Any],
        in_ptr: NDArray[Any],
    ) -> Finish:
        here = self.comm.rank
        # Keep buffers of pending messages.
        sent: list[NDArray[Any]] = []
        requests = [
            self.comm.Irecv(incoming[in_ptr[r] : in_ptr[r + 1]], source=rank)
            for r, rank in enumerate(source.tolist())
            if rank != here
        ]
        for r, rank in enumerate(to.tolist()):
            part = np.ascontiguousarray(outgoing[out_ptr[r] : out_ptr[r + 1]])
            if rank != here:
                requests.append(self.comm.Isend(part, dest=rank))
                sent.append(part)
            else:
                own = int(np.searchsorted(source, here))
                incoming[in_ptr[own] : in_ptr[own + 1]] = part

        def finish() -> None:
            MPI.Request.Waitall(requests)
            sent.clear()

        return finish
