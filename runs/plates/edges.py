"""Particles on the edges of a square plate with a square opening, with the part of their cell that is inside."""

import numpy as np

import pdpetsc as pd


def clipped(size, opening, dx):
    """Return the particles of a plate; ``size`` and ``opening`` are half the sides.

    With whole cells on the edges every section is a spacing too wide, and so is its force.
    """
    n = round(size / dx)
    steps = np.arange(-n, n + 1) * dx
    x = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
    quarters = 0.25 * dx * np.array([(a, b) for a in (-1, 1) for b in (-1, 1)])
    reach = np.abs(x[:, None, :] + quarters).max(axis=2)
    share = ((reach < size) & (reach > opening)).mean(axis=1)
    return pd.Arrays(x[share > 0.0], share[share > 0.0] * dx * dx, thickness=1.0)
