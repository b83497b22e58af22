"""Slow modes of a preconditioned tangent, found by the Lanczos process of one solve for the solves after it."""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc

from pdpetsc.arrays import Float
from pdpetsc.discrete.communicator import total

# A mode is slow if the tangent resists it by less than this share of the preconditioner, and stays so up to twice it.
SLOW = 0.1
# Largest number of modes that are kept, and of vectors that are stored while they are sought.
MOST, STORED = 10, 30
# Ratio of squares below which modes are linearly dependent, and share of M below which K is singular, to rounding.
ROUND_OFF = 1e-10
# D exceeds M, so that ``w . D w`` is at least 1 for a vector of norm 1. It is below this if rounding has made the basis
# linearly dependent.
GHOST = 0.5


class SlowModes:
    """Keep displacements W that the tangent K resists far less than its preconditioner M, and solve with them.

    ``M^-1 + W |W^T K W|^-1 W^T`` is a preconditioner that knows them, and is positive definite like M. Some ten
    openings of a crack, which neither diagonal blocks nor a background grid know, cost MINRES two thirds of its
    iterations.

    MINRES multiplies K with vectors that are orthonormal in the scalar product of M. Those of a solve are the basis of
    a Rayleigh-Ritz method. A full basis is replaced by its slowest vectors (thick restart of Wu2000). A new tangent
    rotates the modes and discards those that are slow no more.

    Parameters
    ----------
    blocks : Mat
        D, the diagonal blocks of the tangent.

    Attributes
    ----------
    stiffness : (k,) float64
        ``w . K w`` of the modes.

    Notes
    -----
    Every method is collective.
    """

    def __init__(self, blocks: PETSc.Mat) -> None:
        self._blocks, self._comm, self._n = blocks, blocks.comm.tompi4py(), blocks.getLocalSize()[0]
        self._modes, self.stiffness = np.empty((0, self._n)), np.empty(0)
        self._basis, self._used = np.empty((0, self._n)), 0
        self._products = np.zeros((STORED, STORED))

    def watch(self, x: Float, Kx: Float) -> None:
        """Take a vector of the Lanczos process and its product with the tangent (n,)."""
        if not len(self._basis):
            self._basis = np.empty((STORED, self._n))
        if self._used == STORED:
            self._reduce()
        i = self._used
        self._basis[i] = x
        self._used = i + 1
        self._products[i, : i + 1] = self._products[: i + 1, i] = self._sums(self._basis[: i + 1] @ Kx)

    def keep(self) -> None:
        """End a solve: add its slow vectors to the modes."""
        self._reduce()
        stiffness = np.diag(self._products)[: self._used]
        slow = np.abs(stiffness) < SLOW
        slow[slow] = self._in_blocks(self._basis[: self._used][slow]) > GHOST
        found = np.concatenate([self._modes, self._basis[: self._used][slow]])
        self._take(found, np.concatenate([self.stiffness, stiffness[slow]]))
        self._basis, self._used = np.empty((0, self._n)), 0

    def renew(self, tangent: PETSc.Mat, preconditioner: PETSc.PC) -> None:
        """Update the modes to a new tangent and its preconditioner, by harmonic Ritz values (Morgan1991)."""
        modes, self._modes = self._modes, self._modes[:0]
        if not len(modes):
            return
        x, y = tangent.createVecs()
        K, A = np.empty((2, len(modes), self._n))
        for mode, product, solved in zip(modes, K, A, strict=True):
            x.array = mode
            tangent.mult(x, y)
            preconditioner.apply(y, x)
            product[:], solved[:] = y.array_r, x.array_r
        x.destroy()
        y.destroy()
        WK, KMK = self._sums(np.array([modes @ K.T, K @ A.T]))
        sizes, vectors = self._eigenvectors(KMK)
        kept = sizes > ROUND_OFF * np.max(sizes, initial=0.0)
        vectors = vectors[:, kept] / np.sqrt(sizes[kept])
        softness, rotated = self._eigenvectors(vectors.T @ WK @ vectors)
        slow = np.abs(softness) > 0.5 / SLOW
        softness = softness[slow]
        self._take((vectors @ rotated[:, slow] / softness).T @ modes, 1.0 / softness)

    def add(self, r: PETSc.Vec, z: PETSc.Vec) -> None:
        """Add ``W |W^T K W|^-1 W^T r`` to z."""
        if len(self._modes):
            z.array += (self._sums(self._modes @ r.array_r) / np.abs(self.stiffness)) @ self._modes

    def _take(self, modes: Float, stiffness: Float) -> None:
        """Keep the slowest of some modes (k, n), with a stiffness (k,) over that of M [-]."""
        order = np.argsort(np.abs(stiffness))
        order = order[np.abs(stiffness[order]) > ROUND_OFF][:MOST]
        self._modes, self.stiffness = modes[order], stiffness[order]

    def _reduce(self) -> None:
        """Replace the basis by its slowest vectors."""
        n = self._used
        stiffness, vectors = self._eigenvectors(self._products[:n, :n])
        order = np.argsort(np.abs(stiffness))[:MOST]
        self._used = len(order)
        self._basis[: self._used] = vectors[:, order].T @ self._basis[:n]
        self._products[: self._used, : self._used] = np.diag(stiffness[order])

    def _eigenvectors(self, products: Float) -> tuple[Float, Float]:
        """Return eigenvalues and eigenvectors of a matrix, the same on all ranks; nothing if it is not finite."""
        finite = np.isfinite(products).all()
        return np.linalg.eigh(products) if finite else (np.empty(0), np.empty((len(products), 0)))

    def _in_blocks(self, modes: Float) -> Float:
        """Return ``w . D w`` of modes (k, n)."""
        x, y = self._blocks.createVecs()
        found = np.empty(len(modes))
        for i, mode in enumerate(modes):
            x.array = mode
            self._blocks.mult(x, y)
            found[i] = x.dot(y)
        x.destroy()
        y.destroy()
        return found

    def _sums(self, values: Float) -> Float:
        return total(self._comm, values)
