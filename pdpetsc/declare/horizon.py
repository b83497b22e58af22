"""Local horizons: from the spacing, a function of position, or an array."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from pdpetsc.arrays import Float
from pdpetsc.declare.particles import Chunk
from pdpetsc.declared import Declared, Positive, called, real_numbers, shown
from pdpetsc.errors import CaseError


@dataclass(frozen=True)
class Horizon(Declared):
    """A horizon of ``ratio`` local spacings: ``horizon_i = ratio spacing_i``.

    The spacing is the cell size of a ``Lattice``, the mean length of the edges at a node of ``MeshNodes``, and ``(V_i /
    thickness)^(1 / dim)`` for other particles. On a line ``V_i / thickness`` is the length of a particle. The spacing
    does not depend on neighbours or on the number of ranks.

    Parameters
    ----------
    ratio : float
        Horizon over spacing [-], positive.

    Raises
    ------
    CaseError
        The ratio is not positive and finite.

    References
    ----------
    Bobaru2009; Ren2016.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> pd.Horizon(3.015)
    Horizon(ratio=3.015)
    """

    ratio: Positive


# Least horizon over spacing: the nearest particles of a lattice, with a margin for rounding.
LEAST_RATIO = 1.015
# One length for all particles, spacings, a function of positions (n, dim) that returns lengths (n,), or one length
# each.
AnyHorizon: TypeAlias = float | Horizon | Callable[[Float], Float] | NDArray[Any]


def check_horizon(horizon: AnyHorizon, spacing: float) -> None:
    """Raise CaseError if the declaration is no valid horizon for a spacing; 0 for an unknown spacing."""
    if isinstance(horizon, np.ndarray):
        lengths = real_numbers(horizon)
        if lengths is None or lengths.ndim != 1:
            raise CaseError(
                f"An array of horizons is one length per particle, not {horizon.dtype} of shape {horizon.shape}."
            )
        bad = np.flatnonzero(~(np.isfinite(lengths) & (lengths > 0.0)))
        if len(bad):
            raise CaseError(
                f"{len(bad)} of {len(lengths)} horizons are not positive, the first is {lengths[bad[0]]:g} of particle "
                f"{bad[0]}."
            )
    elif isinstance(horizon, Horizon):
        if horizon.ratio < 1.0 - 1e-9:
            raise CaseError(
                f"The ratio of Horizon is {horizon.ratio:g}, below one spacing: families would be empty. Use at least "
                f"{LEAST_RATIO}, or leave `horizon` out."
            )
    elif not callable(horizon):
        if not (math.isfinite(horizon) and horizon > 0.0):
            raise CaseError(f"`horizon` must be positive and finite, not {horizon}.")
        if horizon < spacing * (1.0 - 1e-9):
            raise CaseError(
                f"The horizon {horizon:g} is below the spacing {spacing:g}: families would be empty. Use at least "
                f"{LEAST_RATIO * spacing:g}, {LEAST_RATIO} spacings, or leave `horizon` out."
            )


def horizons_of(horizon: AnyHorizon, chunk: Chunk, first: int, count: int, thickness: float) -> float | Float:
    """Return one horizon for all particles, or the horizons of the particles of a part (n,) [length].

    Parameters
    ----------
    horizon : float, Horizon, callable or array
        As declared.
    chunk : Chunk
        The part.
    first, count : int
        The number of its first particle, and the total number of particles.
    thickness : float
        Thickness of a plane body or cross-section of a bar, contained in the volumes [length^(3 - dim)].

    Raises
    ------
    CaseError
        A function fails or returns lengths that are not positive, or an array has a wrong number of values.
    """
    if isinstance(horizon, np.ndarray):
        if len(horizon) != count:
            raise CaseError(f"The case has {count} particles and an array of {len(horizon)} horizons; give one each.")
        return np.asarray(horizon[first : first + len(chunk.x)], dtype=float)
    if isinstance(horizon, Horizon):
        return horizon.ratio * spacings(chunk, thickness)
    if not callable(horizon):
        return float(horizon)
    # Functions of positions may not support empty arrays.
    if len(chunk.x) == 0:
        return np.zeros(0)
    values = called("horizon", horizon, chunk.x)
    lengths = real_numbers(values)
    if lengths is None or lengths.shape != (len(chunk.x),):
        what = shown(values) if lengths is None else f"an array of shape {lengths.shape} for {len(chunk.x)}"
        raise CaseError(f"The function of the horizon must return one length per particle, not {what}.")
    bad = np.flatnonzero(~(np.isfinite(lengths) & (lengths > 0.0)))
    if len(bad):
        raise CaseError(f"The horizon is {lengths[bad[0]]:g} at {chunk.x[bad[0]]}; it must be positive and finite.")
    return lengths


def spacings(chunk: Chunk, thickness: float) -> Float:
    """Return the spacing of each particle of a part (n,) [length]."""
    if chunk.spacing is not None:
        return chunk.spacing
    dim = chunk.x.shape[1]
    whole = chunk.volume / (thickness if dim < 3 else 1.0)
    return np.asarray(whole ** (1.0 / dim))
