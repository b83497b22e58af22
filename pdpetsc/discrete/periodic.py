"""Images of particles across the sides of a periodic cell, and the mean strain that displaces them."""

from __future__ import annotations

import itertools

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex
from pdpetsc.declare.cell import Cell
from pdpetsc.discrete.communicator import Comm, agreed, total
from pdpetsc.errors import CaseError

# Tolerance of positions outside the cell, as a share of the period.
OUTSIDE = 1e-9


class Images:
    """Store the virtual unknowns of a periodic cell: one per component of its mean strain.

    Unknown ``q_ab`` is the elongation ``strain_ab sqrt(L_a L_b)`` [length]. The unknowns fill rows of ``dim`` entries
    that follow the particles of the last rank. The last entries are unused if the number of unknowns is not a multiple
    of ``dim``.

    Parameters
    ----------
    comm : Comm
        All ranks.
    cell : Cell
        The cell.

    Attributes
    ----------
    n_rows : int
        Number of virtual rows.
    here : bool
        Whether this rank holds them; only the last rank does.
    sizes : (n_components,) float64
        ``sqrt(L_a L_b)`` of every unknown [length].
    """

    def __init__(self, comm: Comm, cell: Cell) -> None:
        self.comm = comm
        self.cell = cell
        self.here = comm.rank == comm.size - 1
        self._dim = cell.dim
        lengths = cell.lengths
        pairs = cell.components
        self.n_rows = -(-len(pairs) // cell.dim)
        self._a, self._b = np.array(pairs).T
        self.sizes: Float = np.array([np.sqrt(lengths[a] * lengths[b]) for a, b in pairs])

    def strain(self, rows: Float) -> Float:
        """Compute the mean strain (dim, dim) on every rank from the virtual rows (collective).

        Parameters
        ----------
        rows : (n_rows, dim) float64 on the last rank, (0, dim) elsewhere
            Virtual unknowns [length].
        """
        q = np.zeros(self.n_rows * self._dim)
        if self.here:
            q[:] = rows.ravel()
        if self.comm.size > 1:
            self.comm.Bcast(q, root=self.comm.size - 1)
        strain = np.zeros((self._dim, self._dim))
        strain[self._a, self._b] = strain[self._b, self._a] = q[: len(self.sizes)] / self.sizes
        return strain

    def force(self, offset: Float, f: Float) -> Float:
        """Compute the forces on the virtual unknowns from those on images, on the last rank; no rows elsewhere.

        ``Q_ab = sum_k (f_a o_b + f_b o_a) / sqrt(L_a L_b)``, half of it for ``a = b``. ``o`` is the offset of image
        ``k`` from its particle.

        Parameters
        ----------
        offset, f : (n_ghost, dim) float64
            Offset [length] and force [force] of every ghost.

        Notes
        -----
        Collective.
        """
        dim = self._dim
        moment = total(self.comm, f.T @ offset)
        if not self.here:
            return np.empty((0, dim))
        Q = np.zeros(self.n_rows * dim)
        Q[: len(self.sizes)] = self.conjugate(moment)
        return Q.reshape(-1, dim)

    def conjugate(self, moment: Float) -> Float:
        """Compute the forces on the unknowns (n_components,) from ``sum f (x) o`` (dim, dim) [energy]."""
        both = moment[self._a, self._b] + moment[self._b, self._a]
        return np.asarray(np.where(self._a == self._b, 0.5, 1.0) * both / self.sizes)


def shifts(cell: Cell, horizon: float) -> list[GlobalIndex]:
    """Return the numbers of periods (dim,) of images within one horizon of the cell, zero included."""
    lengths = cell.lengths
    reach = [int(np.ceil(horizon / length)) if length > 0.0 else 0 for length in lengths]
    return [np.array(n) for n in itertools.product(*[range(-r, r + 1) for r in reach])]


def refuse_outside(comm: Comm, cell: Cell, x: Float) -> None:
    """Raise on all ranks if a particle lies outside its cell (collective)."""
    with agreed(comm):
        if x.shape[1] != cell.dim:
            raise CaseError(f"The Cell has {cell.dim} coordinates, the particles {x.shape[1]}.")
        for axis in cell.periodic:
            length = cell.lengths[axis]
            place = (x[:, axis] - cell.origin[axis]) / length
            wrong = np.flatnonzero((place < -OUTSIDE) | (place >= 1.0 + OUTSIDE))
            if len(wrong):
                raise CaseError(
                    f"{len(wrong)} particles lie outside the periodic cell in {'xyz'[axis]}, the first at "
                    f"{x[wrong[0]]}; a cell holds each particle once."
                )
