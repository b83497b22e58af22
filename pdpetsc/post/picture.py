"""The declaration of a picture of a run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias, cast

import numpy as np

from pdpetsc.arrays import Float, Mask
from pdpetsc.declare.tiling import ON_PLANE
from pdpetsc.declared import Declared, Finite
from pdpetsc.errors import CaseError
from pdpetsc.post.quantities import refuse_component
from pdpetsc.post.solution import Field, stress

# A plane across an axis, at a position [length].
Cut: TypeAlias = tuple[Literal["x", "y", "z"], Finite]


@dataclass(frozen=True)
class Picture(Declared):
    """The deformed body coloured by a field component, in ``picture.png``; a bar is drawn as a curve.

    Particles are drawn as their deformed cells, which separate along cracks. A circle of the size of the horizon is
    below plane bodies; the titles of solid bodies name it. PyVista draws solid bodies if it is installed.

    Solid bodies are drawn by their surface. ``cut`` removes the part beyond a plane of the undeformed body. The cut
    face shows the particles whose cells the plane crosses; of particles at nodes, those on the plane or next beyond it.

    Parameters
    ----------
    field : Field
        Field for the colours; it is added to the written fields.
    component : str
        ``"x"`` of a vector, ``"xy"`` of a tensor, ``""`` of a scalar.
    scale : float
        Factor on the displacements.
    cut : (str, float) or sequence of them
        Planes that cut a solid body, each an axis and a position [length]: ``("x", 5.0)`` removes x > 5.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> shear = pd.Picture(pd.stress, "xy", scale=10.0)
    >>> inside = pd.Picture(pd.von_mises, "", cut=("x", 0.5))
    >>> quarter = pd.Picture(pd.von_mises, "", cut=[("x", 0.5), ("y", 0.5)])
    """

    field: Field = stress
    component: str = "xx"
    scale: Finite = 1.0
    cut: Cut | Sequence[Cut] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        refuse_component(self, self.field, self.component)

    @property
    def cuts(self) -> Sequence[Cut]:
        """Return the planes as a sequence."""
        single = len(self.cut) > 0 and isinstance(self.cut[0], str)
        return cast(Sequence[Cut], [self.cut] if single else self.cut)


def uncut(x: Float, cuts: Sequence[Cut]) -> Mask:
    """Return True for the particles (n,) that cuts leave in a picture.

    Parameters
    ----------
    x : (n, dim) float64
        Undeformed positions [length].

    Raises
    ------
    CaseError
        There are cuts, and the body is not solid.
    """
    if cuts and x.shape[1] < 3:
        raise CaseError(f"The cut of a picture requires a body in 3D; this body is in {x.shape[1]}D. Omit the cut.")
    left = np.ones(len(x), dtype=bool)
    for axis, at in cuts:
        along = x[:, "xyz".index(axis)]
        # A rank may own no particles.
        left &= along < at - ON_PLANE * (np.ptp(along) if len(x) else 0.0)
    return left


def refuse_empty(cuts: Sequence[Cut], n: int) -> None:
    """Raise CaseError if cuts leave ``n`` = 0 particles."""
    if n == 0:
        planes = ", ".join(f"{axis} = {at:g}" for axis, at in cuts)
        raise CaseError(f"The cut at {planes} leaves nothing of the body; move the plane into the body.")
