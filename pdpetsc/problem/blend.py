"""Constants of generalised-alpha steps."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Blend:
    """The constants of a generalised-alpha step, as weights of the old accelerations and forces [-].

    Attributes
    ----------
    alpha_m, alpha_f : float
        Weights of acceleration and forces at the start of the step.
    beta, gamma : float
        Newmark's constants.

    References
    ----------
    Chung1993, Eq. (17) and (25).
    """

    alpha_m: float
    alpha_f: float
    beta: float
    gamma: float

    @classmethod
    def of(cls, radius: float) -> Blend:
        """Return the blend with a spectral radius at infinite frequency: 1 conserves, 0 damps short waves at once."""
        alpha_m, alpha_f = (2.0 * radius - 1.0) / (radius + 1.0), radius / (radius + 1.0)
        shift = 1.0 - alpha_m + alpha_f
        return cls(alpha_m, alpha_f, 0.25 * shift**2, shift - 0.5)
