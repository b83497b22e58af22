"""J2 plasticity at finite strain with isotropic hardening and rate dependence."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.declared import NonNegative, Positive
from pdpetsc.kernels.linear_return import LINEAR_RETURN, linear_out_of_plane
from pdpetsc.material.base import HistoryKernels
from pdpetsc.material.flow import Yields
from pdpetsc.material.hardening import Hardening, Linear, law_of
from pdpetsc.material.logarithmic import LogarithmicMaterial, Response
from pdpetsc.material.rate import RateLaw


@dataclass(frozen=True)
class J2(Yields, LogarithmicMaterial):
    r"""J2 plasticity in Hencky strain, ``F = F_e F_p``, with a radial return.

    In the principal frame of ``b_e = F G G^T F^T``, ``G = F_p^-1``, with logarithmic strains eps and deviator s::

        tau = K tr(eps) I + s,  s = 2 mu dev eps,  q = sqrt(3/2 s : s)
        q > y(alpha): q - 3 mu d_alpha = y(alpha + d_alpha),  s := (1 - 3 mu d_alpha / q) s

    and ``P = tau F^-T``, ``A = dP/dF`` with the moduli of the return. ``y = yield_stress + R(alpha)``; with a rate law
    the flow resistance exceeds y. In a bar and in plane stress the hidden stresses are zero. The energy is elastic
    energy plus the integral of the flow resistance over ``alpha``; the stress of a step is its derivative. The history
    is G, the hidden strains and alpha; it changes at converged steps only.

    Parameters
    ----------
    E, nu, plane
        Young's modulus [stress], Poisson's ratio [-] and ``"strain"`` or ``"stress"``, as for every ``Material``.
    yield_stress : float
        Initial yield stress [stress], positive.
    hardening : float or Hardening
        R, one of ``pd.hardening`` or a sum of them; a number is the slope of the yield stress [stress], not negative.
    rate : RateLaw, optional
        One of ``pd.rate``; rate-independent by default.

    Raises
    ------
    CaseError
        A constant is out of range.

    References
    ----------
    Simo1992; deSouzaNeto2008, section 14.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> steel = pd.J2(E=200e3, nu=0.3, yield_stress=250.0, hardening=1e3)
    >>> law = pd.hardening.Linear(129.24) + pd.hardening.Voce(265.0, 16.93)
    >>> sheet = pd.J2(E=206.9e3, nu=0.29, plane="stress", yield_stress=450.0, hardening=law)
    """

    yield_stress: Positive = field(kw_only=True)
    hardening: NonNegative | Hardening = 0.0
    rate: RateLaw | None = None

    def _linear_loops(self, dim: int) -> bool:
        """Return True if the loops for linear hardening apply."""
        free = dim == 2 and self.plane == "stress"
        return self.rate is None and not free and isinstance(law_of(self.hardening), Linear)

    def constants(self, dim: int) -> Float:
        """Return ``lambda, mu, y, H`` of linear hardening, else the duration of the step."""
        if not self._linear_loops(dim):
            return super().constants(dim)
        return np.array([*self.lame(dim), self.yield_stress, float(law_of(self.hardening).slope(np.zeros(())))])

    def history_kernels(self, dim: int) -> HistoryKernels:
        """Return compiled loops for linear hardening, else those around ``respond``."""
        return HistoryKernels(*LINEAR_RETURN) if self._linear_loops(dim) else super().history_kernels(dim)

    def hidden_stretch(self, F: Float, history: Float, dt: float = 0.0) -> Float:
        """Return the hidden stretch; closed form for a bar with linear hardening and isochoric plastic strain."""
        if F.shape[-1] > 1 or not self._linear_loops(1):
            return super().hidden_stretch(F, history, dt)
        _, _, y, H = self.constants(1)
        whole, elastic = np.log(F[:, 0, 0]), np.log(F[:, 0, 0] * history[:, 0])
        growth = np.maximum(self.E * np.abs(elastic) - y - H * history[:, -1], 0.0) / (self.E + H)
        elastic -= np.sign(elastic) * growth
        return np.asarray(np.exp(-2.0 * self.nu * elastic - (whole - elastic)))

    def out_of_plane_stress(self, F: Float, history: Float, dt: float = 0.0) -> Float:
        """Return ``tau_3`` after the return (n,) [stress] in plane strain: ``F_zz`` is 1."""
        if not self._linear_loops(2):
            return super().out_of_plane_stress(F, history, dt)
        P = np.empty(len(F))
        linear_out_of_plane(np.ascontiguousarray(F), self.constants(2), history, P)
        return P

    def initial_state(self) -> Float:
        """Return initial alpha, after the plastic work if flow depends on its rate."""
        return np.zeros(1 if self.rate is None else 2)

    def respond(self, strain: Float, state: Float, dt: Float, moduli: bool) -> Response:
        """Return the deviator scaled back to the yield stress."""
        mu, K = self.shear_and_bulk
        alpha = state[:, -1]
        mean = (strain[:, 0] + strain[:, 1] + strain[:, 2]) / 3.0
        deviator = strain - mean[:, None]
        square = np.einsum("pa,pa->p", deviator, deviator)
        q = math.sqrt(6.0) * mu * np.sqrt(square)
        after = state.copy()
        theta = np.ones(len(q))
        flow, growth, slope = self.flow.growth(q, alpha, dt, 3.0 * mu)
        theta[flow] -= 3.0 * mu * growth / q[flow]
        after[flow, -1] += growth
        if self.rate is not None and len(flow):
            after[flow, 0] += self.flow.work(alpha[flow], growth, dt[flow])
        pressure = 3.0 * K * mean
        scaled = theta[:, None] * deviator
        tau = pressure[:, None] + 2.0 * mu * scaled
        found = None
        if moduli:
            found = np.empty((len(q), 3, 3))
            found[:] = (K - 2.0 / 3.0 * mu * theta)[:, None, None]
            for a in range(3):
                found[:, a, a] += 2.0 * mu * theta
            if len(flow):
                bar = 3.0 * mu / (3.0 * mu + slope) - (1.0 - theta[flow])
                unit = deviator[flow] * np.sqrt(2.0 * mu * bar / square[flow])[:, None]
                found[flow] -= unit[:, :, None] * unit[:, None, :]
        return Response(tau, found, mean[:, None] + scaled, after)

    def energy(self, elastic: Float, state: Float) -> Float:
        """Return elastic energy plus plastic work."""
        alpha = state[:, -1]
        work = self.flow.work(np.zeros(len(alpha)), alpha, alpha) if self.rate is None else state[:, 0]
        return np.asarray(self._elastic_energy(elastic) + work)
