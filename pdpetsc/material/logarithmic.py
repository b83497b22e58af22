"""Isotropic elastoplastic laws in principal logarithmic strains: a law is a function of three strains."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex
from pdpetsc.kernels.logarithmic import LogarithmicLoops, logarithmic_loops
from pdpetsc.material.base import HistoryKernels, Kind
from pdpetsc.material.stepped import SteppedMaterial, blocks

# Numbers of a history between G and the state of the law: hidden elastic strain, hidden whole strain, step time.
KEPT = 3
# Strains nearer to each other than this share of the spread of all three, or of the largest, count as equal where the
# difference quotient of their stresses is asked: the stress of a body that yields early turns within tiny strains.
EQUAL, ROUND_OFF = 1e-5, 1e-9


class Response(NamedTuple):
    """What a law answers to trial strains.

    Attributes
    ----------
    tau : (n, 3) float64
        Principal Kirchhoff stresses [stress]; NaN where the law has found none.
    moduli : (n, 3, 3) float64 or None
        ``d tau_a / d strain_b`` [stress], where asked.
    elastic : (n, 3) float64
        Elastic logarithmic strains after the return [-].
    state : (n, n_state) float64
        What is remembered if the step ends here.
    """

    tau: Float
    moduli: Float | None
    elastic: Float
    state: Float


class _Axes(NamedTuple):
    """Trial strains, all three of them, with stretches and directions of a block of points."""

    strain: Float
    stretch: Float
    N: Float
    n: Float


@dataclass(frozen=True)
class LogarithmicMaterial(SteppedMaterial):
    r"""A law in principal elastic logarithmic strains, ``F = F_e F_p``, of a solid, a plane body or a bar.

    The law sees the three principal values of ``eps = 1/2 ln(F G G^T F^T)``, ``G = F_p^-1`` that of the last converged
    step, and answers with principal Kirchhoff stresses along the same directions, as a small-strain law does (Simo,
    1992). From them ``P = tau F^-T`` and ``A = dP/dF`` follow. In plane stress the strain across the plane is found at
    every point from ``tau_3 = 0``, in a bar the two lateral ones, and the tangent is condensed with them.

    A law gives ``respond``, ``energy`` and, where it remembers more than one number, ``initial_state``.

    Parameters
    ----------
    E, nu, plane
        As for every material with Young's modulus: ``"strain"`` or ``"stress"``.

    References
    ----------
    Simo1992.
    """

    @abstractmethod
    def respond(self, strain: Float, state: Float, dt: Float, moduli: bool) -> Response:
        """Return what a step ends with.

        Parameters
        ----------
        strain : (n, 3) float64
            Principal trial strains [-]: elastic ones if nothing flows in the step.
        state : (n, n_state) float64
            What converged steps left; not to be changed.
        dt : (n,) float64
            Time of the step [time], 0 for a law without ``duration``.
        moduli : bool
            Whether the moduli are asked for.
        """

    @abstractmethod
    def energy(self, elastic: Float, state: Float) -> Float:
        """Return the energy (n,) [energy / volume], stored and lost, of elastic strains (n, 3) and a state.

        Of an associated law it is that whose derivative the stress is.
        """

    def initial_state(self) -> Float:
        """Return the state of an undeformed point (n_state,): an accumulated plastic strain of 0."""
        return np.zeros(1)

    def initial_history(self, dim: int, n: int) -> Float:
        """Return the history of ``n`` undeformed points: G, hidden strains and step time, and the law's own state."""
        return np.tile(np.concatenate([np.eye(dim).ravel(), np.zeros(KEPT), self.initial_state()]), (n, 1))

    def plastic_strain(self, history: Float) -> Float:
        """Return the last number of the state (n,) [-]: the accumulated plastic strain."""
        return history[:, -1]

    def history_kernels(self, dim: int) -> HistoryKernels:
        """Return loops over blocks of points around ``respond``."""
        kind, loops = self.kind(dim), logarithmic_loops(dim)

        def stress(F: Float, select: GlobalIndex, constants: Float, history: Float, P: Float) -> None:
            for points, kept in blocks(select, history):
                axes, found = self._returned(F, points, constants[-1], kept, kind, False)
                loops.stress(points, kept, found.tau, axes.stretch, axes.N, axes.n, P)

        def tangent(F: Float, select: GlobalIndex, constants: Float, history: Float, A: Float) -> None:
            for points, kept in blocks(select, history):
                axes, found = self._returned(F, points, constants[-1], kept, kind, True)
                assert found.moduli is not None
                moduli = np.ascontiguousarray(_condensed(found.moduli, kind))
                shear = _shear(axes.strain, found.tau, found.moduli, dim)
                loops.tangent(points, kept, found.tau, moduli, shear, axes.stretch, axes.N, axes.n, A)

        def energy(F: Float, select: GlobalIndex, constants: Float, history: Float, psi: Float) -> None:
            for points, kept in blocks(select, history):
                _, found = self._returned(F, points, constants[-1], kept, kind, False)
                psi[points] = self.energy(found.elastic, found.state)

        def commit(F: Float, select: GlobalIndex, constants: Float, history: Float) -> None:
            first = dim * dim
            for points, kept in blocks(select, history):
                axes, found = self._returned(F, points, constants[-1], kept, kind, False)
                loops.commit(kept, found.elastic, axes.stretch, axes.N, axes.n)
                if kind in ("stress", "bar"):
                    kept[:, first + 1] += axes.strain[:, 2] - kept[:, first]
                kept[:, first] = found.elastic[:, 2]
                kept[:, first + 2] = constants[-1]
                kept[:, first + KEPT :] = found.state

        return HistoryKernels(stress, tangent, energy, commit)

    def hidden_stretch(self, F: Float, history: Float, t: float | None = None) -> Float:
        """Return the stretch across a plane without stress there, the product of both of a bar, else 1 (n,) [-]."""
        dim, kind = F.shape[-1], self.kind(F.shape[-1])
        across = np.ones(len(F))
        if kind in ("stress", "bar"):
            for points, kept in blocks(np.arange(len(F)), history):
                axes, _ = self._returned(F, points, t, kept, kind, False)
                whole = kept[:, dim * dim + 1] + axes.strain[:, 2] - kept[:, dim * dim]
                across[points] = np.exp(whole * (3 - dim))
        return across

    def out_of_plane_stress(self, F: Float, history: Float, t: float | None = None) -> Float:
        """Return ``tau_3`` after the return (n,) [stress] in plane strain: ``F_zz`` is 1."""
        P = np.empty(len(F))
        for points, kept in blocks(np.arange(len(F)), history):
            P[points] = self._returned(F, points, t, kept, "strain", False)[1].tau[:, 2]
        return P

    def _returned(
        self, F: Float, points: GlobalIndex, t: float | None, kept: Float, kind: Kind, moduli: bool
    ) -> tuple[_Axes, Response]:
        """Return trial strains and the response at points of F, at the step time that was kept where ``t`` is None."""
        dim, n = F.shape[-1], len(points)
        first = dim * dim
        axes = _Axes(np.empty((n, 3)), np.empty((n, dim)), np.empty((n, dim, dim)), np.empty((n, dim, dim)))
        loops: LogarithmicLoops = logarithmic_loops(dim)
        loops.trial(np.ascontiguousarray(F), points, kept, *axes)
        state = kept[:, first + KEPT :]
        dt = self.time_of_step(t, kept[:, first + 2])
        if kind == "strain":
            axes.strain[:, 2] = kept[:, first]
        if kind in ("stress", "bar"):
            return axes, self.free_across(axes.strain, state, dt, kind, moduli)
        return axes, self.respond(axes.strain, state, dt, moduli)


def _condensed(moduli: Float, kind: Kind) -> Float:
    """Return the moduli of a body without stress across it (n, 3, 3), whose hidden strains follow the others."""
    if kind == "stress":
        return np.asarray(moduli - moduli[:, :, 2:] * moduli[:, 2:, :] / moduli[:, 2:, 2:])
    if kind == "bar":
        lateral = (moduli[:, 0, 1] + moduli[:, 0, 2]) * moduli[:, 2, 0] / (moduli[:, 2, 1] + moduli[:, 2, 2])
        return np.asarray((moduli[:, 0, 0] - lateral)[:, None, None] * np.ones((1, 3, 3)))
    return moduli


def _shear(strain: Float, tau: Float, moduli: Float, dim: int) -> Float:
    """Return ``(tau_a - tau_b) / (eps_a - eps_b)`` (n, dim, dim) [stress], its limit where strains are equal."""
    shear = np.zeros((len(strain), dim, dim))
    nearly = np.maximum(EQUAL * np.ptp(strain, axis=1), ROUND_OFF * np.abs(strain).max(axis=1))
    for a in range(dim):
        for b in range(a + 1, dim):
            apart = strain[:, a] - strain[:, b]
            equal = np.abs(apart) <= nearly
            limit = 0.5 * (moduli[:, a, a] + moduli[:, b, b] - moduli[:, a, b] - moduli[:, b, a])
            quotient = (tau[:, a] - tau[:, b]) / np.where(equal, 1.0, apart)
            shear[:, a, b] = shear[:, b, a] = np.where(equal, limit, quotient)
    return shear
