"""A material whose stiffness varies with position."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from pdpetsc.arrays import Float
from pdpetsc.material.base import Material


@dataclass(frozen=True)
class Graded:
    """A material with all moduli times a factor that depends on the reference position.

    Parameters
    ----------
    material : Material
        The law; energy, stress and tangent are multiplied.
    factor : callable
        ``factor(x)`` with positions (n, dim) returns positive numbers (n,) [-].
    """

    material: Material
    factor: Callable[[Float], Float]
