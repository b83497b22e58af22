"""Mirror planes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from pdpetsc.declared import Declared, Finite


@dataclass(frozen=True)
class Symmetry(Declared):
    """A mirror plane across an axis: the particles are one side of a body, whose other side is their mirror image.

    Families reach across the plane, where the images of the particles move as these do, with the opposite displacement
    along the axis, and have the same bonds, which break with those of the particles. A part with planes is the whole
    body to round-off wherever its material and its scheme have the symmetry too; nothing has to be held on the plane.
    Particles lie on one side, none on the plane itself: half a cell away from it, where cells fill the body up to it.
    Forces, volumes, energies, reactions and loads are those of the part, half of the body's for each plane.

    Parameters
    ----------
    axis : {"x", "y", "z"}
        The normal of the plane.
    at : float
        Where the plane crosses that axis [length].

    Raises
    ------
    CaseError
        The plane is nowhere.

    Examples
    --------
    The quarter of a plate, with its centre at the origin:

    >>> import pdpetsc as pd
    >>> planes = [pd.Symmetry("x"), pd.Symmetry("y")]
    >>> planes[0].number
    0
    """

    axis: Literal["x", "y", "z"]
    at: Finite = 0.0

    @property
    def number(self) -> int:
        """Return the number of the axis."""
        return "xyz".index(self.axis)
