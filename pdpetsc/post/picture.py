"""The declaration of a picture of a run."""

from __future__ import annotations

from dataclasses import dataclass

from pdpetsc.declared import Declared, Finite
from pdpetsc.post.quantities import refuse_component
from pdpetsc.post.solution import Field, stress


@dataclass(frozen=True)
class Picture(Declared):
    """The deformed body coloured by a field component, in ``picture.png``; a bar is drawn as a curve.

    Particles are drawn as their deformed cells, which separate along cracks. A circle of the size of the horizon is
    below plane bodies; the titles of solid bodies name it. PyVista draws solid bodies if it is installed.

    Parameters
    ----------
    field : Field
        Field for the colours; it is added to the written fields.
    component : str
        ``"x"`` of a vector, ``"xy"`` of a tensor, ``""`` of a scalar.
    scale : float
        Factor on the displacements.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> shear = pd.Picture(pd.stress, "xy", scale=10.0)
    """

    field: Field = stress
    component: str = "xx"
    scale: Finite = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        refuse_component(self, self.field, self.component)
