"""Laws whose history has directions of its own, additive in the Lagrangian logarithmic strain."""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex
from pdpetsc.kernels.lagrangian import lagrangian_loops
from pdpetsc.material.base import HistoryKernels, Kind
from pdpetsc.material.stepped import SteppedMaterial, blocks

# Components of a symmetric tensor as a vector, in which scalar products are those of tensors.
PAIRS = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))
ROOT = math.sqrt(2.0)
WEIGHT = np.array([1.0, 1.0, 1.0, ROOT, ROOT, ROOT])
ONE = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
DEVIATOR = np.eye(6) - np.outer(ONE, ONE) / 3.0
# Numbers of a history before the state of the law: the step time.
KEPT = 1


class TensorResponse(NamedTuple):
    """What a law answers to a strain, symmetric tensors as vectors ``11, 22, 33, sqrt(2) 23, sqrt(2) 13, sqrt(2) 12``.

    Attributes
    ----------
    T : (n, 6) float64
        Stress conjugate to the logarithmic strain [stress]; NaN where the law has found none.
    moduli : (n, 6, 6) float64 or None
        ``dT / dE`` [stress], where asked.
    state : (n, n_state) float64
        What is remembered if the step ends here.
    """

    T: Float
    moduli: Float | None
    state: Float


class _Frame(NamedTuple):
    """Strain of a block of points, and principal values and directions of C."""

    strain: Float
    c: Float
    N: Float


@dataclass(frozen=True)
class LagrangianMaterial(SteppedMaterial):
    r"""A small-strain law ``T(E)`` in the Lagrangian logarithmic strain ``E = 1/2 ln(F^T F)``.

    Whatever law of small strain is written in E is a law of finite strain that is objective and keeps its potential:
    ``P = F S``, ``S = 2 T : dE/dC``, and the tangent follows with the second derivative of E (Miehe, Apel, Lambrecht,
    2002). Inelastic strains are subtracted from E, so that history has directions of its own, as those of a back
    stress, which principal values do not show. Where strain and history keep their axes it is the law of the
    multiplicative split; in large shear the two differ. In plane stress and in a bar the strains that F does not show
    leave no stress.

    A law gives ``respond``, ``energy`` and ``initial_state``.

    Parameters
    ----------
    E, nu, plane
        As for every material with Young's modulus: ``"strain"`` or ``"stress"``.

    References
    ----------
    Miehe2002.
    """

    @abstractmethod
    def respond(self, strain: Float, state: Float, dt: Float, moduli: bool) -> TensorResponse:
        """Return what a step ends with.

        Parameters
        ----------
        strain : (n, 6) float64
            Logarithmic strain [-], as a vector.
        state : (n, n_state) float64
            What converged steps left; not to be changed.
        dt : (n,) float64
            Time of the step [time], 0 for a law without ``duration``.
        moduli : bool
            Whether the moduli are asked for.
        """

    @abstractmethod
    def energy(self, strain: Float, state: Float) -> Float:
        """Return the energy (n,) [energy / volume], stored and lost, of a strain (n, 6) and the state after it."""

    @abstractmethod
    def initial_state(self) -> Float:
        """Return the state of an undeformed point (n_state,)."""

    def initial_history(self, dim: int, n: int) -> Float:
        """Return the history of ``n`` undeformed points: the step time and the law's own state."""
        return np.tile(np.concatenate([np.zeros(KEPT), self.initial_state()]), (n, 1))

    def history_kernels(self, dim: int) -> HistoryKernels:
        """Return loops over blocks of points around ``respond``."""
        kind, loops = self.kind(dim), lagrangian_loops(dim)

        def stress(F: Float, select: GlobalIndex, constants: Float, history: Float, P: Float) -> None:
            for points, kept in blocks(select, history):
                frame, found = self._returned(F, points, constants[-1], kept, kind, False)
                loops.stress(F, points, _tensor(found.T, dim), frame.c, frame.N, P)

        def tangent(F: Float, select: GlobalIndex, constants: Float, history: Float, A: Float) -> None:
            for points, kept in blocks(select, history):
                frame, found = self._returned(F, points, constants[-1], kept, kind, True)
                assert found.moduli is not None
                moduli = _tensors(_condensed(found.moduli, kind), dim)
                loops.tangent(F, points, _tensor(found.T, dim), moduli, frame.c, frame.N, A)

        def energy(F: Float, select: GlobalIndex, constants: Float, history: Float, psi: Float) -> None:
            for points, kept in blocks(select, history):
                frame, found = self._returned(F, points, constants[-1], kept, kind, False)
                psi[points] = self.energy(frame.strain, found.state)

        def commit(F: Float, select: GlobalIndex, constants: Float, history: Float) -> None:
            for points, kept in blocks(select, history):
                _, found = self._returned(F, points, constants[-1], kept, kind, False)
                kept[:, 0] = constants[-1]
                kept[:, KEPT:] = found.state

        return HistoryKernels(stress, tangent, energy, commit)

    def hidden_stretch(self, F: Float, history: Float, t: float | None = None) -> Float:
        """Return the stretch across a plane without stress there, the product of both of a bar, else 1 (n,) [-]."""
        dim, kind = F.shape[-1], self.kind(F.shape[-1])
        across = np.ones(len(F))
        if kind in ("stress", "bar"):
            for points, kept in blocks(np.arange(len(F)), history):
                frame, _ = self._returned(F, points, t, kept, kind, False)
                across[points] = np.exp(frame.strain[:, dim:3].sum(axis=1))
        return across

    def out_of_plane_stress(self, F: Float, history: Float, t: float | None = None) -> Float:
        """Return ``T_33`` (n,) [stress] in plane strain: ``F_zz`` is 1."""
        P = np.empty(len(F))
        for points, kept in blocks(np.arange(len(F)), history):
            P[points] = self._returned(F, points, t, kept, "strain", False)[1].T[:, 2]
        return P

    def _returned(
        self, F: Float, points: GlobalIndex, t: float | None, kept: Float, kind: Kind, moduli: bool
    ) -> tuple[_Frame, TensorResponse]:
        """Return strain and response at points of F, at the step time that was kept where ``t`` is None."""
        dim, n = F.shape[-1], len(points)
        tensor, c, N = np.empty((n, 3, 3)), np.empty((n, dim)), np.empty((n, dim, dim))
        lagrangian_loops(dim).strain(np.ascontiguousarray(F), points, tensor, c, N)
        strain = np.stack([tensor[:, i, j] for i, j in PAIRS], axis=1) * WEIGHT
        state = kept[:, KEPT:]
        dt = self.time_of_step(t, kept[:, 0])
        if kind in ("stress", "bar"):
            return _Frame(strain, c, N), self.free_across(strain, state, dt, kind, moduli)
        return _Frame(strain, c, N), self.respond(strain, state, dt, moduli)


def _condensed(moduli: Float, kind: Kind) -> Float:
    """Return the moduli of a body without stress across it (n, 6, 6), whose hidden strains follow the others."""
    if kind == "stress":
        return np.asarray(moduli - moduli[:, :, 2:3] * moduli[:, 2:3, :] / moduli[:, 2:3, 2:3])
    if kind == "bar":
        both = moduli[:, :, 1:2] + moduli[:, :, 2:3]
        return np.asarray(moduli - both * moduli[:, 2:3, :] / both[:, 2:3, :])
    return moduli


def _tensor(vector: Float, dim: int) -> Float:
    """Return vectors (n, 6) as tensors (n, dim, dim)."""
    found = np.empty((len(vector), 3, 3))
    for (i, j), column in zip(PAIRS, (vector / WEIGHT).T, strict=True):
        found[:, i, j] = found[:, j, i] = column
    return np.ascontiguousarray(found[:, :dim, :dim])


def _tensors(matrix: Float, dim: int) -> Float:
    """Return matrices (n, 6, 6) as tensors (n, dim, dim, dim, dim)."""
    found = np.empty((len(matrix), dim, dim, dim, dim))
    for a, (i, j) in enumerate(PAIRS):
        for b, (k, o) in enumerate(PAIRS):
            if max(i, j, k, o) < dim:
                value = matrix[:, a, b] / (WEIGHT[a] * WEIGHT[b])
                found[:, i, j, k, o] = found[:, j, i, k, o] = found[:, i, j, o, k] = found[:, j, i, o, k] = value
    return found
