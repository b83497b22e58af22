"""PdQuickGrid of Peridigm: particles in the middles of the cells of a box, with special families.

The meaning of entries follows Peridigm's ``QuickGrid.cxx`` and ``PdQuickGridDiscretization.cpp``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial, reduce
from pathlib import Path

import numpy as np

from pdpetsc.arrays import Mask
from pdpetsc.decks.script import Body, quoted, tidy
from pdpetsc.decks.sections import Section
from pdpetsc.declared import shown
from pdpetsc.errors import CaseError

# Lengths that differ by less than this share are equal within the rounding of coordinates.
_SAME = 1e-9
_MOST = 1e7
_GRID = [
    "def grid(origin, length, count):",
    '    """Return the middles of the cells of a box, those along x first."""',
    "    axes = [o + (np.arange(n) + 0.5) * size / n for o, size, n in zip(origin, length, count, strict=True)]",
    '    z, y, x = np.meshgrid(*axes[::-1], indexing="ij")',
    "    return np.column_stack([x.ravel(), y.ravel(), z.ravel()])",
]


def grid_body(section: Section, sets: dict[str, Path | list[int]]) -> Body:
    """Return the particles of a PdQuickGrid with node sets by numbers.

    Raises
    ------
    CaseError
        The grid is not a box of cells, or a node set is in a file or names missing particles.
    """
    given = section.section("TensorProduct3DMeshGenerator")
    given.text("Type", "PdQuickGrid")
    origin = [given.number(f"{axis} Origin") for axis in "XYZ"]
    length = [given.number(f"{axis} Length") for axis in "XYZ"]
    count = [given.whole(f"Number Points {axis}") for axis in "XYZ"]
    if min(length) <= 0.0 or min(count) < 1 or np.prod(np.array(count, dtype=float)) > _MOST:
        raise given.wrong("has no cells, or more than ten million.")
    axes = [o + (np.arange(n) + 0.5) * size / n for o, size, n in zip(origin, length, count, strict=True)]
    z, y, x = np.meshgrid(*axes[::-1], indexing="ij")
    places = np.column_stack([x.ravel(), y.ravel(), z.ravel()])
    flags: dict[str, Mask] = {"block_1": np.ones(len(places), dtype=bool)}
    code = [
        f"x = grid({tuple(origin)!r}, {tuple(length)!r}, {tuple(count)!r})",
        f"volume = {float(np.prod(np.array(length) / count))!r}",
    ]
    entries = ['"block_1": np.ones(len(x), dtype=bool)']
    for name, numbers in sets.items():
        if isinstance(numbers, Path):
            raise CaseError(
                f"The node set {name!r} of the deck is {shown(numbers.name)}, not numbers of particles, which a "
                f"PdQuickGrid takes here."
            )
        if not numbers or min(numbers) < 1 or max(numbers) > len(places):
            raise CaseError(f"The node set {name!r} of the deck names particles outside 1 to {len(places)}.")
        flags[name] = np.isin(np.arange(1, len(places) + 1), numbers)
        entries.append(f"{quoted(name)}: np.array({numbers!r}) - 1")
    if len(entries) == 1:
        code.append(f"particles = pd.Arrays(x, volume, {{{entries[0]}}})")
    else:
        code += ["sets = {", *(f"    {entry}," for entry in entries), "}", "particles = pd.Arrays(x, volume, sets)"]
    # All other words result in boxes in Peridigm.
    spherical = section.text("NeighborhoodType", "") == "Spherical"
    spacing = [size / n for size, n in zip(length, count, strict=True)]
    families = partial(families_of_grid, spacing, count, spherical)
    volumes = np.full(len(places), float(np.prod(spacing)))
    return Body(
        code, list(_GRID), places, flags, {tidy(name): name for name in flags}, families=families, volume=volumes
    )


def families_of_grid(
    spacing: Sequence[float], count: Sequence[int], spherical: bool, horizon: float
) -> tuple[float, tuple[float, ...]]:
    """Return the radius of the families of a PdQuickGrid, and their box if they are not balls.

    The family of a particle is the box of cells ``|k_a| <= n_a``, with ``n_a`` the horizon over the spacing along axis
    ``a``, rounded to the nearest whole number; a spherical family has only the cells nearer than the horizon.

    Parameters
    ----------
    spacing : sequence of float
        Sizes of a cell [length].
    count : sequence of int
        Cells along each axis.
    spherical : bool
        True for spherical neighbourhoods.
    horizon : float
        Horizon of the deck [length].

    Returns
    -------
    radius : float
        The horizon if the ball contains only the family, otherwise the longest bond of the family [length].
    box : tuple of float
        Half sizes of a box [length] that contains the family; empty if the ball is sufficient.

    Raises
    ------
    CaseError
        No particle has a neighbour.
    """
    cells = [math.floor(min(horizon / h, float(n)) + 0.5) for h, n in zip(spacing, count, strict=True)]
    # Bonds outside the family may be as short as bonds in it.
    far = horizon if spherical else math.hypot(*(n * h for n, h in zip(cells, spacing, strict=True)))
    steps = [np.arange(min(n - 1, int(min(far / h, float(n))) + 1) + 1) for h, n in zip(spacing, count, strict=True)]
    squares = [(k * h) ** 2 for k, h in zip(steps, spacing, strict=True)]
    length = np.sqrt(reduce(np.add.outer, squares))
    inside = reduce(np.logical_and.outer, [k <= n for k, n in zip(steps, cells, strict=True)])
    if spherical:
        inside &= length < horizon * (1.0 - _SAME)
    inside[0, 0, 0] = False
    if not inside.any():
        raise CaseError(
            f"The grid of the deck has no bonds: its cells are {tuple(spacing)}, and the horizon is {horizon:g}."
        )
    length[0, 0, 0] = np.inf
    longest, shortest = float(length[inside].max()), float(length[~inside].min()) * (1.0 - _SAME)
    if longest < shortest:
        return (horizon if longest <= horizon < shortest else longest), ()
    return longest, tuple((n + 0.5) * h for n, h in zip(cells, spacing, strict=True))


def families_code(box: Sequence[float]) -> list[str]:
    """Return a class of the case file that excludes bonds beyond a box."""
    return [
        "class BeyondBox(Crack):",
        '    """Bonds that leave the families of Peridigm\'s PdQuickGrid, boxes of whole cells."""',
        "",
        "    def cuts(self, a, b):",
        '        """Return which bonds from a to b end beyond the box."""',
        f"        return (np.abs(b - a) > np.array({tuple(box)!r})).any(axis=1)",
    ]
