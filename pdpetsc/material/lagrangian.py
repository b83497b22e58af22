"""Laws with tensor history, additive in the Lagrangian logarithmic strain."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex
from pdpetsc.kernels.lagrangian import lagrangian_loops
from pdpetsc.material.base import Kind
from pdpetsc.material.stepped import Step, SteppedMaterial, condensed
from pdpetsc.material.symmetric import WEIGHT, stiffness, tensor, vector

ONE = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
DEVIATOR = np.eye(6) - np.outer(ONE, ONE) / 3.0


class TensorResponse(NamedTuple):
    """Response of a law to a strain; symmetric tensors are vectors ``11, 22, 33, sqrt(2) 23, sqrt(2) 13, sqrt(2) 12``.

    Attributes
    ----------
    T : (n, 6) float64
        Stress conjugate to the logarithmic strain [stress]; NaN if the law fails.
    moduli : (n, 6, 6) float64 or None
        ``dT / dE`` [stress], if requested.
    state : (n, n_state) float64
        State if the step ends here.
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

    Every law of small strain becomes in E an objective law of finite strain with the same potential: ``P = F S``,
    ``S = 2 T : dE/dC``, and the tangent follows with the second derivative of E (Miehe, Apel, Lambrecht, 2002).
    Inelastic strains are subtracted from E. The history may contain tensors, such as a back stress, with their own
    directions. If strain and history keep their axes, the law is that of the multiplicative split; in large shear both
    differ. In plane stress and in a bar the hidden stresses are zero.

    A law defines ``respond``, ``energy`` and ``initial_state``.

    Parameters
    ----------
    E, nu, plane
        Young's modulus [stress], Poisson's ratio [-], and ``"strain"`` or ``"stress"``.

    References
    ----------
    Miehe2002.
    """

    @abstractmethod
    def respond(self, strain: Float, state: Float, dt: Float, moduli: bool) -> TensorResponse:
        """Compute the response at the end of a step.

        Parameters
        ----------
        strain : (n, 6) float64
            Logarithmic strain [-], as a vector.
        state : (n, n_state) float64
            State of the last converged step; read only.
        dt : (n,) float64
            Duration of the step [time], 0 for a law without ``duration``.
        moduli : bool
            True if the moduli are requested.
        """

    @abstractmethod
    def energy(self, strain: Float, state: Float) -> Float:
        """Compute the energy (n,) [energy / volume], stored plus dissipated, of a strain (n, 6) and its state."""

    @abstractmethod
    def initial_state(self) -> Float:
        """Return the state of an undeformed point (n_state,)."""

    def initial_history(self, dim: int, n: int) -> Float:
        """Return the state of ``n`` undeformed points."""
        return np.tile(self.initial_state(), (n, 1))

    def _state(self, history: Float, dim: int) -> Float:
        return history

    def _trial(self, F: Float, points: GlobalIndex, history: Float, kind: Kind) -> _Frame:
        dim, n = F.shape[-1], len(points)
        strain, c, N = np.empty((n, 3, 3)), np.empty((n, dim)), np.empty((n, dim, dim))
        lagrangian_loops(dim).strain(np.ascontiguousarray(F), points, strain, c, N)
        return _Frame(vector(strain) * WEIGHT, c, N)

    def _write_stress(self, step: Step, P: Float) -> None:
        dim, frame = P.shape[-1], step.frame
        lagrangian_loops(dim).stress(step.F, step.points, tensor(step.response.T / WEIGHT, dim), frame.c, frame.N, P)

    def _write_tangent(self, step: Step, A: Float) -> None:
        dim, frame, (T, moduli, _) = A.shape[-1], step.frame, step.response
        moduli = stiffness(condensed(moduli, step.kind) / np.outer(WEIGHT, WEIGHT), dim)
        lagrangian_loops(dim).tangent(step.F, step.points, tensor(T / WEIGHT, dim), moduli, frame.c, frame.N, A)

    def _energy(self, step: Step) -> Float:
        return self.energy(step.frame.strain, step.response.state)

    def _remember(self, step: Step) -> None:
        step.history[:] = step.response.state

    def _hidden_strain(self, step: Step) -> Float:
        return np.asarray(step.frame.strain[:, step.dim : 3].sum(axis=1))
