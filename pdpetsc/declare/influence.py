"""Influence functions ``omega(|xi|)`` on ``s = |xi| / horizon``."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.declared import Declared, Positive, numbers_from
from pdpetsc.errors import CaseError


class Influence(Declared, ABC):
    """Influence ``omega`` of a bond as a function of its length over the horizon [-]."""

    @abstractmethod
    def __call__(self, s: Float) -> Float:
        """Return omega [-] for ``s`` (n_bonds,) in (0, 1]."""


@dataclass(frozen=True)
class Constant(Influence):
    """``omega = 1``.

    Examples
    --------
    >>> import numpy as np
    >>> import pdpetsc as pd
    >>> pd.influence.Constant()(np.array([0.5, 1.0]))
    array([1., 1.])
    """

    def __call__(self, s: Float) -> Float:
        """Return ones, stored once."""
        return np.broadcast_to(np.float64(1.0), np.shape(s))


@dataclass(frozen=True)
class Linear(Influence):
    """``omega = 1 - s``; a bond exactly as long as the horizon has no influence.

    Examples
    --------
    >>> import numpy as np
    >>> import pdpetsc as pd
    >>> pd.influence.Linear()(np.array([0.25, 1.0]))
    array([0.75, 0.  ])
    """

    def __call__(self, s: Float) -> Float:
        """Return ``1 - s``."""
        return np.maximum(1.0 - s, 0.0)


@dataclass(frozen=True)
class Cubic(Influence):
    """Cubic B-spline, ``1 - 6 s^2 + 6 s^3`` for ``s < 1/2``, else ``2 (1 - s)^3``.

    Examples
    --------
    >>> import numpy as np
    >>> import pdpetsc as pd
    >>> pd.influence.Cubic()(np.array([0.5, 1.0]))
    array([0.25, 0.  ])
    """

    def __call__(self, s: Float) -> Float:
        """Return the spline."""
        return np.where(s < 0.5, 1.0 - 6.0 * s**2 + 6.0 * s**3, 2.0 * np.maximum(1.0 - s, 0.0) ** 3)


@dataclass(frozen=True)
class Gaussian(Influence):
    """``omega = exp(-(s / width)^2)``.

    Parameters
    ----------
    width : float
        Length over the horizon at which omega is 1 / e [-].

    Examples
    --------
    >>> import pdpetsc as pd
    >>> narrow = pd.influence.Gaussian(width=0.3)
    """

    width: Positive = 0.5

    def __call__(self, s: Float) -> Float:
        """Return the Gaussian."""
        return np.asarray(np.exp(-((s / self.width) ** 2)))


def evaluate(influence: Influence, s: Float) -> Float:
    """Return omega (n_bonds,) [-] at ``s`` (n_bonds,).

    Raises
    ------
    CaseError
        The influence function fails, or does not return one non-negative number per bond.
    """
    if len(s) == 0:
        return np.zeros(0)
    omega = numbers_from("influence", influence, s)
    if omega.shape != s.shape:
        raise CaseError(f"The influence must return one number per bond, {s.shape}, not {omega.shape}.")
    if not (omega.min(initial=0.0) >= 0.0 and omega.max(initial=0.0) < np.inf):
        bad = np.flatnonzero(~(np.isfinite(omega) & (omega >= 0.0)))
        raise CaseError(f"The influence is {omega[bad[0]]:g} at {s[bad[0]]:.6g} horizons; it must not be negative.")
    return omega
