"""Drucker and Prager's plasticity of soil, rock and concrete at finite strain."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex
from pdpetsc.declared import NonNegative, Positive
from pdpetsc.errors import CaseError
from pdpetsc.material.hardening import Hardening, law_of
from pdpetsc.material.logarithmic import LogarithmicMaterial, Response
from pdpetsc.material.roots import falling_roots


@dataclass(frozen=True)
class DruckerPrager(LogarithmicMaterial):
    r"""Drucker-Prager plasticity: a cone in principal Kirchhoff stresses, with return to its side or apex.

    With deviator s, mean stress p (tension positive) and the cohesion ``c + R(alpha)``::

        sqrt(s : s / 2) + eta p <= xi (c + R(alpha))
        flow: d_gamma (s / (2 sqrt(s : s / 2)) + eta_psi / 3 I),  d_alpha = xi d_gamma

    ``eta`` and ``xi`` follow from the angle of friction, ``eta_psi`` as eta from that of dilatancy. Strains are
    logarithmic and the return is that of small strain, as in ``J2``. If dilatancy and friction differ, the tangent is
    not symmetric and the stress has no potential; the energy is then elastic energy plus plastic work. If plastic flow
    preserves the volume (``dilatancy=0``), no return leads to the apex, and a step into tension beyond the apex is cut
    back.

    Parameters
    ----------
    E, nu, plane
        Young's modulus [stress], Poisson's ratio [-] and ``"strain"`` or ``"stress"``, as for every ``Material``.
    cohesion : float
        c [stress], positive.
    friction : float
        Angle of internal friction in radians [-], from 0 to below pi / 2.
    dilatancy : float, optional
        Angle of dilatancy, from 0 to that of friction; by default that of friction (associated flow).
    hardening : float or Hardening
        R, one of ``pd.hardening`` or a sum of them; a number is the slope of the cohesion [stress], not negative.
    fit : {"compression", "tension", "plane strain"}
        Stress states with the strength of Mohr and Coulomb: triaxial compression, triaxial tension, or plane strain
        with associated flow.

    Raises
    ------
    CaseError
        A constant is out of range.

    References
    ----------
    Drucker1952; deSouzaNeto2008, section 8.3.

    Examples
    --------
    >>> import math
    >>> import pdpetsc as pd
    >>> clay = pd.DruckerPrager(E=50.0, nu=0.3, cohesion=0.02, friction=math.radians(25.0), dilatancy=math.radians(5.0))
    >>> clay.symmetric
    False
    """

    cohesion: Positive = field(kw_only=True)
    friction: float = field(kw_only=True)
    dilatancy: float | None = None
    hardening: NonNegative | Hardening = 0.0
    fit: Literal["compression", "tension", "plane strain"] = "compression"

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0.0 <= self.friction < 0.5 * math.pi:
            raise CaseError(f"DruckerPrager takes an angle of friction from 0 to below pi / 2, not {self.friction}.")
        if self.dilatancy is not None and not 0.0 <= self.dilatancy <= self.friction:
            raise CaseError(
                f"DruckerPrager takes an angle of dilatancy from 0 to that of friction, {self.friction}, not "
                f"{self.dilatancy}."
            )

    @property
    def symmetric(self) -> bool:
        """Return True if flow is associated."""
        return self.dilatancy is None or self.dilatancy == self.friction

    @property
    def cone(self) -> tuple[float, float, float]:
        """Return ``eta, eta_psi, xi`` [-]."""
        eta, xi = self._slopes(self.friction)
        return eta, eta if self.dilatancy is None else self._slopes(self.dilatancy)[0], xi

    def _slopes(self, angle: float) -> tuple[float, float]:
        sin, cos = math.sin(angle), math.cos(angle)
        if self.fit == "plane strain":
            size = math.sqrt(9.0 * cos * cos + 12.0 * sin * sin)
            return 3.0 * sin / size, 3.0 * cos / size
        size = math.sqrt(3.0) * (3.0 - sin if self.fit == "compression" else 3.0 + sin)
        return 6.0 * sin / size, 6.0 * cos / size

    def initial_state(self) -> Float:
        """Return initial plastic work and alpha."""
        return np.zeros(2)

    def energy(self, elastic: Float, state: Float) -> Float:
        """Return elastic energy plus plastic work."""
        return np.asarray(self._elastic_energy(elastic) + state[:, 0])

    def respond(self, strain: Float, state: Float, dt: Float, moduli: bool) -> Response:
        """Return the trial stress, or the stress on the cone or apex if the trial stress is outside the cone."""
        mu, K = self.shear_and_bulk
        eta, eta_psi, xi = self.cone
        alpha = state[:, -1]
        mean = strain.mean(axis=1)
        deviator = strain - mean[:, None]
        size = np.sqrt(np.einsum("pa,pa->p", deviator, deviator))
        p = 3.0 * K * mean
        shear = math.sqrt(2.0) * mu * size
        theta, after = np.ones(len(p)), state.copy()
        found = None
        if moduli:
            found = np.broadcast_to((K - 2.0 / 3.0 * mu) + 2.0 * mu * np.eye(3), (len(p), 3, 3)).copy()
        flow = np.flatnonzero(shear + eta * p > xi * (self.cohesion + law_of(self.hardening).increase(alpha)))
        if len(flow):
            gamma = self._on_side(shear[flow], p[flow], alpha[flow])
            beyond = mu * gamma > shear[flow]
            side, gamma = flow[~beyond], gamma[~beyond]
            if len(side):
                theta[side] -= mu * gamma / shear[side]
                p[side] -= K * eta_psi * gamma
                after[side, 1] += xi * gamma
                work = (theta[side] * shear[side] + eta_psi * p[side]) * gamma
                after[side, 0] += self._work(alpha[side], after[side, 1], work)
                if found is not None:
                    slope = law_of(self.hardening).slope(after[side, 1])
                    n = deviator[side] / size[side, None]
                    left = math.sqrt(2.0) * mu * n + K * eta_psi
                    right = (math.sqrt(2.0) * mu * n + K * eta) / (mu + K * eta * eta_psi + xi * xi * slope)[:, None]
                    lost = 2.0 * mu * (1.0 - theta[side])[:, None, None]
                    found[side] -= lost * (np.eye(3) - 1.0 / 3.0 - n[:, :, None] * n[:, None, :])
                    found[side] -= left[:, :, None] * right[:, None, :]
            tip = flow[beyond]
            if len(tip):
                growth = self._in_apex(p[tip], alpha[tip])
                theta[tip] = 0.0
                p[tip] -= K * growth
                after[tip, 1] += (xi / eta_psi if eta_psi else math.nan) * growth
                after[tip, 0] += self._work(alpha[tip], after[tip, 1], p[tip] * growth)
                if found is not None:
                    slope = law_of(self.hardening).slope(after[tip, 1])
                    with np.errstate(invalid="ignore"):  # NaN stress, NaN modulus
                        found[tip] = (K * slope / (K * eta * eta_psi / (xi * xi) + slope))[:, None, None]
        scaled = theta[:, None] * deviator
        return Response(p[:, None] + 2.0 * mu * scaled, found, scaled + (p / (3.0 * K))[:, None], after)

    def _work(self, before: Float, after: Float, work: Float) -> Float:
        """Return the plastic work in a step; for associated flow that of the cohesion."""
        if not self.symmetric:
            return work
        law = law_of(self.hardening)
        return np.asarray(self.cohesion * (after - before) + law.integral(after) - law.integral(before))

    def _on_side(self, shear: Float, p: Float, alpha: Float) -> Float:
        """Return the flow ``gamma`` to the side of the cone, continued beyond its apex."""
        mu, K = self.shear_and_bulk
        eta, eta_psi, xi = self.cone
        law, stiff = law_of(self.hardening), mu + K * eta * eta_psi

        def excess(gamma: Float, rows: GlobalIndex) -> tuple[Float, Float]:
            after = alpha[rows] + xi * gamma
            value = shear[rows] + eta * p[rows] - stiff * gamma - xi * (self.cohesion + law.increase(after))
            return value, -stiff - xi * xi * law.slope(after)

        first = excess(np.zeros(len(p)), np.arange(len(p)))
        return falling_roots(excess, -first[0] / first[1], (shear + eta * p) / stiff, shear + eta * np.abs(p))

    def _in_apex(self, p: Float, alpha: Float) -> Float:
        """Return the plastic change of volume to the apex; NaN if plastic flow preserves the volume."""
        _, K = self.shear_and_bulk
        eta, eta_psi, xi = self.cone
        if eta_psi == 0.0:
            return np.full(len(p), math.nan)
        law = law_of(self.hardening)

        def excess(growth: Float, rows: GlobalIndex) -> tuple[Float, Float]:
            after = alpha[rows] + xi / eta_psi * growth
            value = p[rows] - K * growth - xi / eta * (self.cohesion + law.increase(after))
            return value, -K - xi * xi / (eta * eta_psi) * law.slope(after)

        first = excess(np.zeros(len(p)), np.arange(len(p)))
        return falling_roots(excess, -first[0] / first[1], p / K, p)
