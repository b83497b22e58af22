"""J2 plasticity whose yield surface moves: kinematic hardening at finite strain."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.declared import NonNegative, Positive
from pdpetsc.material.flow import Yields
from pdpetsc.material.hardening import Hardening
from pdpetsc.material.lagrangian import DEVIATOR, ONE, LagrangianMaterial, TensorResponse
from pdpetsc.material.rate import RateLaw


@dataclass(frozen=True)
class KinematicJ2(Yields, LagrangianMaterial):
    r"""J2 plasticity with a back stress, additive in the Lagrangian logarithmic strain, ``E = E_e + E_p``.

    With the deviator e of ``E - E_p``, T conjugate to E, and the back stress X::

        T = K tr(E) I + 2 mu e,  X = 2/3 kinematic E_p,  q = sqrt(3/2 |2 mu e - X|^2)
        q > y(alpha): q - (3 mu + kinematic) d_alpha = y(alpha + d_alpha)

    In a bar the centre of the yield surface moves by ``kinematic`` times the plastic strain (Prager), so that the bar
    yields earlier after load reversal. Without kinematic hardening the law is ``J2`` if strains keep their axes.

    Parameters
    ----------
    E, nu, plane
        Young's modulus [stress], Poisson's ratio [-] and ``"strain"`` or ``"stress"``, as for every ``Material``.
    yield_stress : float
        Initial yield stress [stress], positive.
    kinematic : float
        Kinematic hardening modulus [stress], not negative.
    hardening : float or Hardening
        Isotropic hardening, as in ``J2``.
    rate : RateLaw, optional
        One of ``pd.rate``.

    Raises
    ------
    CaseError
        A constant is out of range.

    References
    ----------
    Miehe2002; deSouzaNeto2008, section 7.6.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> steel = pd.KinematicJ2(E=200e3, nu=0.3, yield_stress=250.0, kinematic=5e3, hardening=pd.hardening.Voce(80, 9))
    """

    yield_stress: Positive = field(kw_only=True)
    kinematic: NonNegative = 0.0
    hardening: NonNegative | Hardening = 0.0
    rate: RateLaw | None = None

    def initial_state(self) -> Float:
        """Return initial plastic strain, plastic work and alpha."""
        return np.zeros(8)

    def plastic_strain(self, history: Float) -> Float:
        """Return the accumulated plastic strain alpha (n,) [-]."""
        return history[:, -1]

    def respond(self, strain: Float, state: Float, dt: Float, moduli: bool) -> TensorResponse:
        """Return the deviator minus back stress, scaled back to the yield stress."""
        mu, K = self.shear_and_bulk
        plastic, alpha = state[:, :6], state[:, 7]
        e = (strain - plastic) @ DEVIATOR
        xi = 2.0 * mu * e - 2.0 / 3.0 * self.kinematic * plastic
        size = np.sqrt(np.einsum("pa,pa->p", xi, xi))
        q = math.sqrt(1.5) * size
        flow, growth, slope = self.flow.growth(q, alpha, dt, 3.0 * mu + self.kinematic)
        after = state.copy()
        T = K * strain[:, :3].sum(axis=1)[:, None] * ONE + 2.0 * mu * e
        found = None
        if moduli:
            found = np.broadcast_to(K * np.outer(ONE, ONE) + 2.0 * mu * DEVIATOR, (len(q), 6, 6)).copy()
        if len(flow):
            n = xi[flow] / size[flow, None]
            moved = math.sqrt(1.5) * growth[:, None] * n
            T[flow] -= 2.0 * mu * moved
            after[flow, :6] += moved
            after[flow, 6] += self.flow.work(alpha[flow], growth, dt[flow])
            after[flow, 7] += growth
            if found is not None:
                share = (3.0 * mu * growth / q[flow])[:, None, None]
                along = (6.0 * mu * mu / (3.0 * mu + self.kinematic + slope))[:, None, None] - 2.0 * mu * share
                found[flow] -= 2.0 * mu * share * DEVIATOR + along * n[:, :, None] * n[:, None, :]
        return TensorResponse(T, found, after)

    def energy(self, strain: Float, state: Float) -> Float:
        """Return elastic energy, energy of the back stress, and plastic work of the yield stress."""
        mu, K = self.shear_and_bulk
        e = (strain - state[:, :6]) @ DEVIATOR
        volume = strain[:, :3].sum(axis=1)
        back = self.kinematic / 3.0 * (state[:, :6] ** 2).sum(axis=1)
        return np.asarray(0.5 * K * volume * volume + mu * (e * e).sum(axis=1) + back + state[:, 6])
