"""Natural frequencies and buckling loads that a run computes at its end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

from pdpetsc.declared import Count, Declared, NonNegative
from pdpetsc.errors import CaseError


@dataclass(frozen=True)
class FrequencyResponse(Declared):
    """Steady vibration under loads that oscillate about the last equilibrium, from the damped modes of the body.

    The loads of the last equilibrium are the amplitudes f of the oscillating ones, ``f cos(w t)``. A quantity q of the
    history has the complex amplitude

        ``sum_k q_k (phi_k . f) (1 / (w_k^2 - w^2 + 2 i z_k w_k w) - 1 / w_k^2) + q_s``

    with its derivatives ``q_k`` along the modes ``phi_k``, which have unit modal mass, and ``q_s`` along the static
    displacement under f. The sum is over the ``count`` modes; all others respond as if they had no mass. The damping
    ratio is ``z_k = ratio + mass / (2 w_k) + stiffness w_k / 2``. Prescribed displacements, temperatures and tools do
    not oscillate. Quantities change with the displacement only: a reaction is that of the stiffness, without loads on
    held particles, inertia and damping.

    ``response.csv`` lists the amplitude of each quantity and its phase behind the loads [degrees] by frequency. Results
    are the largest amplitude ``response_NAME``, and its frequency ``response_NAME_at``.

    Parameters
    ----------
    frequencies : sequence of float
        Frequencies of the loads [1 / time].
    ratio : float
        Damping ratio of every mode [-].
    mass, stiffness : float
        Factors of ``RayleighDamping`` [1 / time], [time].

    Raises
    ------
    CaseError
        There is no frequency, one is negative, or there is no damping. In a case: a quantity of the history depends on
        the path of the load, such as ``ExternalWork``.

    References
    ----------
    Hughes1987, section 7.2 (damping).

    Examples
    --------
    >>> import pdpetsc as pd
    >>> shaken = pd.FrequencyResponse([0.5 * f for f in range(100)], ratio=0.02)
    >>> modes = pd.Modes(10, response=shaken)
    """

    frequencies: Sequence[NonNegative]
    ratio: NonNegative = field(default=0.0, kw_only=True)
    mass: NonNegative = field(default=0.0, kw_only=True)
    stiffness: NonNegative = field(default=0.0, kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not len(self.frequencies):
            raise CaseError("FrequencyResponse needs at least one frequency.")
        if self.ratio == self.mass == self.stiffness == 0.0:
            raise CaseError("FrequencyResponse needs damping: a ratio, mass or stiffness.")


@dataclass(frozen=True)
class Modes(Declared):
    """The lowest modes of the body in its last equilibrium, or the loads at which it buckles.

    With mirror planes only the symmetric modes are found. Facets that a ``Contact`` presses are held by its
    stiffness; ``BodyContact`` is refused.

    Frequencies solve ``K phi = (2 pi f)^2 M phi`` with the tangent K of the last equilibrium and the masses ``M = rho
    V`` of the particles, from the ``density`` of their materials. A negative frequency -f stands for the growth
    ``exp(2 pi f t)`` of a mode in an unstable equilibrium.

    Buckling factors solve ``K_0 phi = s (K_0 - K_1) phi`` with the tangents of the last two equilibria, at load
    parameters t_0 and t_1; before the first step the body is undeformed. The body buckles at ``c = (t_0 + s (t_1 -
    t_0)) / t_1`` times the load, if the load is proportional to t and the tangent linear in it. A small part of the
    load is enough for a body that only compresses before it buckles. For a body that bends, apply nearly the critical
    load with a short last step.

    The results are ``frequency_1``, ``frequency_2``, ... or ``buckling_1``, ...; the shapes are in ``modes.h5``, see
    ``Result.mode``. The eigenvectors are kept on one rank.

    Parameters
    ----------
    count : int
        Number of modes.
    of : {"frequency", "buckling"}
        What is computed.
    response : FrequencyResponse, optional
        Vibration under oscillating loads to compute from the modes.

    Raises
    ------
    CaseError
        A ``response`` is declared with buckling; or a material has no density or may flow, the solver is not
        ``Newton``, the tangent is not symmetric, or the case has damage, heat conduction or a periodic cell.

    References
    ----------
    Lehoucq1998 (the solver).

    Examples
    --------
    >>> import pdpetsc as pd
    >>> steel = pd.LinearElastic(E=200e9, nu=0.3, plane="stress", density=8000.0)
    >>> modes = pd.Modes(6)
    """

    count: Count
    of: Literal["frequency", "buckling"] = "frequency"
    response: FrequencyResponse | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.response is not None and self.of != "frequency":
            raise CaseError("A response is computed from natural frequencies. Leave out of='buckling'.")

    @property
    def names(self) -> list[str]:
        """Return the names of the results."""
        return [f"{self.of}_{number}" for number in range(1, self.count + 1)]
