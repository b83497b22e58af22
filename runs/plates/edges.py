"""Particles on the edges of a square plate with a square opening, with the part of their cell that is inside."""

import numpy as np

import pdpetsc as pd


def refuse_other_sizes(size, opening, dx):
    """Raise CaseError where particles do not lie on the edges of the plate and of its opening."""
    for length in (size, opening):
        if abs(length / dx - round(length / dx)) > 1e-9:
            raise pd.CaseError(f"dx = {dx:g} does not divide {length:g}, half a side of the plate or its opening.")


def clipped(size, opening, dx, part="whole"):
    """Return the particles of a plate, or of its quarter; ``size`` and ``opening`` are half the sides [length].

    With whole cells on the edges every section is a spacing too wide, and its force is too large. On a symmetry line
    half cells make a family of nearest neighbours with sub-horizons the half of a whole one.
    """
    n = round(size / dx)
    steps = np.arange(-n if part == "whole" else 0, n + 1) * dx
    x = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
    quarters = x[:, None, :] + 0.25 * dx * np.array([(a, b) for a in (-1, 1) for b in (-1, 1)])
    reach = np.abs(quarters).max(axis=2)
    inside = (reach < size) & (reach > opening)
    if part != "whole":
        inside &= quarters.min(axis=2) > 0.0
    share = inside.mean(axis=1)
    return pd.Arrays(x[share > 0.0], share[share > 0.0] * dx * dx, thickness=1.0)
