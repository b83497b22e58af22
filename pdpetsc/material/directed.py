"""Materials whose stiffness may depend on the direction, and the isotropic mean of a stiffness."""

from __future__ import annotations

from abc import abstractmethod

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.errors import CaseError
from pdpetsc.material.base import Material, isotropic_moduli
from pdpetsc.material.symmetric import moduli_of_body


class DirectedMaterial(Material):
    """A material whose stiffness may depend on the direction; its scales are those of the isotropic mean."""

    @abstractmethod
    def _solid(self) -> Float:
        """Return the moduli of the solid at F = I in the axes of the material (3, 3, 3, 3) [stress]."""

    def _mean(self, dim: int) -> Float:
        """Return the isotropic mean of the moduli at F = I (dim, dim, dim, dim) [stress]."""
        solid = isotropic_moduli(*isotropic_mean(self._solid()), 3)
        return moduli_of_body(solid, dim, self.plane)

    def bulk_like_modulus(self, dim: int) -> float:
        """Return the value of the isotropic mean [stress], which does not depend on directions."""
        return float(np.einsum("iikk", self._mean(dim))) / dim**2

    def young_modulus(self) -> float:
        """Raise CaseError: Young's modulus depends on the direction."""
        raise CaseError(
            f"{type(self).__name__} has another Young's modulus in every direction; damage takes materials that are "
            f"isotropic at small strain."
        )


def isotropic_mean(moduli: Float) -> tuple[float, float]:
    """Return ``lambda, mu`` of the isotropic stiffness nearest to moduli (3, 3, 3, 3)."""
    bulk = float(np.einsum("iikk", moduli))
    full = float(np.einsum("ikik", moduli) + np.einsum("ikki", moduli)) / 2.0
    mu = (full - bulk / 3.0) / 10.0
    return (bulk - 6.0 * mu) / 9.0, mu
