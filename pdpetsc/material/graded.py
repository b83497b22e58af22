"""A material whose stiffness varies with position."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from pdpetsc.arrays import Float
from pdpetsc.bond_based import BondMaterial
from pdpetsc.declared import Declared
from pdpetsc.material.base import Material


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
