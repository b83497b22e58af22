"""Viscoelasticity at finite strain: Maxwell elements beside a spring."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.declared import Positive
from pdpetsc.errors import CaseError
from pdpetsc.material.lagrangian import DEVIATOR, ONE, LagrangianMaterial, TensorResponse


@dataclass(frozen=True)
class Maxwell(LagrangianMaterial):
    r"""Generalised Maxwell material in the Lagrangian logarithmic strain E; changes of volume are elastic.

    A Hencky spring in parallel with branches of a spring and a dashpot each, with the deviator e of E::

        T = K tr(E) I + 2 mu e + sum_k q_k,   dq_k/dt + q_k / times_k = 2 shear_k de/dt

    It is integrated exactly for a constant strain rate in a step: at constant strain the stress relaxes as
    ``sum_k exp(-t / times_k)`` for any step size. E and nu are those of slow loading, which also scale zero-energy
    controls. Fast loading has the shear modulus ``mu + sum_k shear_k``.

    Parameters
    ----------
    E, nu, plane
        Young's modulus of slow loading [stress], its Poisson's ratio [-] and ``"strain"`` or ``"stress"``.
    shear : sequence of float
        Shear modulus of each branch [stress], positive.
    times : sequence of float
        Relaxation time of each branch [time], positive.
    duration : float
        Time from load parameter 0 to 1 [time], positive.

    Raises
    ------
    CaseError
        A constant is out of range.

    Notes
    -----
    The energy is elastic energy plus the integral of the branch stresses over a step; the stress is its derivative. In
    steps much shorter than the relaxation times it is stored plus dissipated energy.

    References
    ----------
    Simo1998, chapter 10; Miehe2002.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> gel = pd.Maxwell(E=1.0, nu=0.45, shear=[0.5, 0.2], times=[1.0, 20.0], duration=60.0)
    >>> gel.symmetric
    True
    """

    shear: Sequence[Positive] = field(kw_only=True)
    times: Sequence[Positive] = field(kw_only=True)
    duration: Positive = 1.0

    may_fail: ClassVar[bool] = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.shear or len(self.shear) != len(self.times):
            raise CaseError(
                f"Maxwell takes a shear modulus and a relaxation time for each branch, not {len(self.shear)} and "
                f"{len(self.times)}."
            )
        object.__setattr__(self, "shear", tuple(float(value) for value in self.shear))
        object.__setattr__(self, "times", tuple(float(value) for value in self.times))

    def initial_state(self) -> Float:
        """Return the energy of the branches, the deviator and the stress of each branch."""
        return np.zeros(7 + 6 * len(self.shear))

    def spread(self, step: float) -> float:
        """Return ``sum_k shear_k ((1 - exp(-x_k)) / x_k - exp(-x_k)) / (mu + sum_k shear_k)``, x_k = dt / times_k.

        The first term is the branch stress at the end of a step with constant strain rate, the second that after a jump
        at the start of the step.
        """
        x = step * self.duration / np.array(self.times)
        shear = np.array(self.shear)
        return float(shear @ (-np.expm1(-x) / x - np.exp(-x)) / (self.shear_and_bulk[0] + shear.sum()))

    def respond(self, strain: Float, state: Float, dt: Float, moduli: bool) -> TensorResponse:
        """Return the stress of spring and branches."""
        mu, K = self.shear_and_bulk
        e = strain @ DEVIATOR
        change = e - state[:, 1:7]
        T = K * strain[:, :3].sum(axis=1)[:, None] * ONE + 2.0 * mu * e
        after = state.copy()
        after[:, 1:7] = e
        stiffness = np.full(len(e), 2.0 * mu)
        for branch, (shear, time) in enumerate(zip(self.shear, self.times, strict=True)):
            columns = slice(7 + 6 * branch, 13 + 6 * branch)
            x = dt / time
            left = np.exp(-x)[:, None] * state[:, columns]
            share = 2.0 * shear * np.where(x > 0.0, -np.expm1(-x) / np.where(x > 0.0, x, 1.0), 1.0)
            stiffness += share
            after[:, columns] = left + share[:, None] * change
            after[:, 0] += (left * change).sum(axis=1) + 0.5 * share * (change * change).sum(axis=1)
            T += after[:, columns]
        found = K * np.outer(ONE, ONE) + stiffness[:, None, None] * DEVIATOR if moduli else None
        return TensorResponse(T, found, after)

    def energy(self, strain: Float, state: Float) -> Float:
        """Return the energy of the spring plus that of the branches."""
        mu, K = self.shear_and_bulk
        volume = strain[:, :3].sum(axis=1)
        return np.asarray(0.5 * K * volume * volume + mu * (state[:, 1:7] ** 2).sum(axis=1) + state[:, 0])
