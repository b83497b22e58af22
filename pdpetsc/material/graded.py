"""A material whose stiffness varies with position."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from pdpetsc.arrays import Float
from pdpetsc.declared import Declared, shown
from pdpetsc.errors import CaseError
from pdpetsc.material.base import Material

if TYPE_CHECKING:
    from pdpetsc.bond_based import BondMaterial


@dataclass(frozen=True)
class Graded(Declared):
    """A material with all moduli times a factor that depends on the reference position.

    Parameters
    ----------
    material : Material or BondMaterial
        The law, whose energy, stress and tangent are multiplied by the factor.
    factor : callable
        ``factor(x)`` with positions (n, dim) returns positive numbers (n,) [-].

    Examples
    --------
    >>> import pdpetsc as pd
    >>> soft = pd.LinearElastic(E=1000.0, nu=0.3)
    >>> material = pd.Graded(soft, factor=lambda x: 1.0 + 0.5 * x[:, 0])
    """

    material: Material | BondMaterial
    factor: Callable[[Float], Float]

    def __post_init__(self) -> None:
        # ``bond_based`` imports this package, so its type cannot be imported above, and the fields are checked here.
        from pdpetsc.bond_based import BondMaterial

        super().__post_init__()
        if not isinstance(self.material, Material | BondMaterial):
            raise CaseError(f"Graded takes a Material or a BondMaterial as material, not {shown(self.material)}.")
        if not callable(self.factor) or isinstance(self.factor, type):
            raise CaseError(f"Graded takes a function as factor, not {shown(self.factor)}.")
