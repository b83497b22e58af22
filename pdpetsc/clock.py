"""The clock of a state."""

from __future__ import annotations

from typing import NamedTuple


class Clock(NamedTuple):
    """Load parameter and physical time of a state.

    Attributes
    ----------
    load : float
        Load parameter, from 0 to 1 over the whole load [-].
    time : float
        Physical time [time]; the load parameter if no part of the case declares a duration.
    dt : float
        Physical time since the last converged step [time].
    before : float
        Load parameter of the last converged step [-].
    """

    load: float = 0.0
    time: float = 0.0
    dt: float = 0.0
    before: float = 0.0


START = Clock()
