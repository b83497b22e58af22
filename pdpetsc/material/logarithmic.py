"""Isotropic elastoplastic laws in principal logarithmic strains: a law is a function of three strains."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex
from pdpetsc.kernels.logarithmic import Trial, commit, stress, tangent, trial
from pdpetsc.material.base import Kind
from pdpetsc.material.stepped import Step, SteppedMaterial, condensed

# Numbers of a history between G and the state of the law: hidden elastic strain and hidden total strain.
KEPT = 2
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
        """Return the history of ``n`` undeformed points: G, hidden strains, and the law's own state."""
        return np.tile(np.concatenate([np.eye(dim).ravel(), np.zeros(KEPT), self.initial_state()]), (n, 1))

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

    def _remember(self, step: Step, dim: int) -> None:
        axes, response, history, first = step.frame, step.response, step.history, dim * dim
        commit(history, response.elastic, axes)
        if step.kind in ("stress", "bar"):
            history[:, first + 1] += axes.strain[:, 2] - history[:, first]
        history[:, first] = response.elastic[:, 2]
        history[:, first + KEPT :] = response.state

    def _hidden_strain(self, step: Step, dim: int) -> Float:
        first = dim * dim
        total = step.history[:, first + 1] + step.frame.strain[:, 2] - step.history[:, first]
        return np.asarray(total * (3 - dim))


def shear_factors(strain: Float, tau: Float, moduli: Float, dim: int) -> Float:
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
