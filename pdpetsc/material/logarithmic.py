"""Isotropic elastoplastic laws as functions of three principal logarithmic strains."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex
from pdpetsc.kernels.logarithmic import Trial, commit, stress, tangent, trial
from pdpetsc.material.base import Kind
from pdpetsc.material.stepped import Step, SteppedMaterial, condensed

# Number of history variables between G and the state of the law: hidden elastic and hidden total strain.
KEPT = 2
# Strains are equal in the difference quotient of their stresses if they differ by less than this share of the spread of
# all three, or of the largest. The tolerance is small because the stress of a body with a small yield stress changes
# within tiny strains.
EQUAL, ROUND_OFF = 1e-5, 1e-9


class Response(NamedTuple):
    """Response of a law to trial strains.

    Attributes
    ----------
    tau : (n, 3) float64
        Principal Kirchhoff stresses [stress]; NaN if the law fails.
    moduli : (n, 3, 3) float64 or None
        ``d tau_a / d strain_b`` [stress], if requested.
    elastic : (n, 3) float64
        Elastic logarithmic strains after the return [-].
    state : (n, n_state) float64
        State if the step ends here.
    """

    tau: Float
    moduli: Float | None
    elastic: Float
    state: Float


@dataclass(frozen=True)
class LogarithmicMaterial(SteppedMaterial):
    r"""A law in principal elastic logarithmic strains, ``F = F_e F_p``, for a solid, a plane body or a bar.

    The arguments of the law are the three principal values of ``eps = 1/2 ln(F G G^T F^T)``, with ``G = F_p^-1`` of the
    last converged step. The law returns principal Kirchhoff stresses along the same directions, as a small-strain law
    does (Simo, 1992). They determine ``P = tau F^-T`` and ``A = dP/dF``. In plane stress the out-of-plane strain at
    every point follows from ``tau_3 = 0``, in a bar both lateral strains, and the tangent is condensed.

    A law defines ``respond``, ``energy`` and, if its state has more than one number, ``initial_state``.

    Parameters
    ----------
    E, nu, plane
        Young's modulus [stress], Poisson's ratio [-], and ``"strain"`` or ``"stress"``.

    References
    ----------
    Simo1992.
    """

    @abstractmethod
    def respond(self, strain: Float, state: Float, dt: Float, moduli: bool) -> Response:
        """Compute the response at the end of a step.

        Parameters
        ----------
        strain : (n, 3) float64
            Principal trial strains [-]: elastic ones if nothing flows in the step.
        state : (n, n_state) float64
            State of the last converged step; read only.
        dt : (n,) float64
            Duration of the step [time], 0 for a law without ``duration``.
        moduli : bool
            True if the moduli are requested.
        """

    @abstractmethod
    def energy(self, elastic: Float, state: Float) -> Float:
        """Compute the energy (n,) [energy / volume], stored plus dissipated, of elastic strains (n, 3) and a state.

        For an associated law the stress is its derivative.
        """

    def initial_state(self) -> Float:
        """Return the state of an undeformed point (n_state,): an accumulated plastic strain of 0."""
        return np.zeros(1)

    def initial_history(self, dim: int, n: int) -> Float:
        """Return the history of ``n`` undeformed points: G, hidden strains, and the law's own state."""
        return np.tile(np.concatenate([np.eye(dim).ravel(), np.zeros(KEPT), self.initial_state()]), (n, 1))

    def _elastic_energy(self, elastic: Float) -> Float:
        """Return the elastic energy (n,) [energy / volume] of principal strains (n, 3)."""
        mu, K = self.shear_and_bulk
        mean = elastic.mean(axis=1)
        return np.asarray(4.5 * K * mean * mean + mu * ((elastic - mean[:, None]) ** 2).sum(axis=1))

    def plastic_strain(self, history: Float) -> Float:
        """Return the last number of the state (n,) [-]: the accumulated plastic strain."""
        return history[:, -1]

    def _state(self, history: Float, dim: int) -> Float:
        return history[:, dim * dim + KEPT :]

    def _trial(self, F: Float, points: GlobalIndex, history: Float, kind: Kind) -> Trial:
        found = trial(np.ascontiguousarray(F), points, history)
        if kind == "strain":
            found.strain[:, 2] = history[:, F.shape[-1] ** 2]
        return found

    def _write_stress(self, step: Step, P: Float) -> None:
        stress(step.points, step.response.tau, step.frame, P)

    def _write_tangent(self, step: Step, A: Float) -> None:
        tau, moduli = step.response.tau, np.ascontiguousarray(condensed(step.response.moduli, step.kind))
        shear = shear_factors(step.frame.strain, tau, moduli, A.shape[-1])
        tangent(step.points, tau, moduli, shear, step.frame, A)

    def _energy(self, step: Step) -> Float:
        return self.energy(step.response.elastic, step.response.state)

    def _remember(self, step: Step) -> None:
        axes, response, history, first = step.frame, step.response, step.history, step.dim**2
        commit(history, response.elastic, axes)
        if step.kind in ("stress", "bar"):
            history[:, first + 1] += axes.strain[:, 2] - history[:, first]
        history[:, first] = response.elastic[:, 2]
        history[:, first + KEPT :] = response.state

    def _hidden_strain(self, step: Step) -> Float:
        first = step.dim**2
        total = step.history[:, first + 1] + step.frame.strain[:, 2] - step.history[:, first]
        return np.asarray(total * (3 - step.dim))


def shear_factors(strain: Float, tau: Float, moduli: Float, dim: int) -> Float:
    """Return ``(tau_a - tau_b) / (eps_a - eps_b)`` (n, dim, dim) [stress], or its limit for equal strains."""
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
