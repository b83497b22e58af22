"""A material whose stiffness varies with position."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from pdpetsc.arrays import Float
from pdpetsc.material.base import Material

if TYPE_CHECKING:
    from pdpetsc.bond_based import BondMaterial


@dataclass(frozen=True)
class Graded:
    """A material with all moduli times a factor that depends on the reference position.

    Parameters
    ----------
    material : Material or BondMaterial
        The law; energy, stress and tangent are multiplied.
    factor : callable
        ``factor(x)`` with positions (n, dim) returns positive numbers (n,) [-].
    """

    material: Material | BondMaterial
    factor: Callable[[Float], Float]
