"""Hyperelastic laws of the literature, as strain energies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from pdpetsc.errors import CaseError
from pdpetsc.material.hyperelastic import VOLUMETRIC, Direction, EnergyMaterial


@dataclass(frozen=True)
class MooneyRivlin(EnergyMaterial):
    """Mooney-Rivlin rubber, ``psi = c10 (I1bar - 3) + c01 (I2bar - 3) + kappa/4 (J^2 - 1 - 2 ln J)``.

    The shear modulus at small strain is ``2 (c10 + c01)``, the bulk modulus kappa.

    Parameters
    ----------
    c10, c01 : float
        [stress].
    kappa : float
        Bulk modulus [stress].
    plane : {"strain", "stress"}
        Plane strain or plane stress of a two-dimensional body.

    References
    ----------
    Holzapfel2000, section 6.5.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> rubber = pd.MooneyRivlin(c10=0.15, c01=0.02, kappa=50.0, plane="stress")
    """

    c10: float
    c01: float
    kappa: float
    plane: Literal["strain", "stress"] = "strain"

    def declared_energy(self) -> tuple[str, Mapping[str, float]]:
        """Return the text and the constants."""
        text = f"c10 * (I1bar - 3) + c01 * (I2bar - 3) + {VOLUMETRIC}"
        return text, {"c10": self.c10, "c01": self.c01, "kappa": self.kappa}


@dataclass(frozen=True)
class Yeoh(EnergyMaterial):
    """Yeoh's rubber, ``psi = c1 (I1bar - 3) + c2 (I1bar - 3)^2 + c3 (I1bar - 3)^3 + kappa/4 (J^2 - 1 - 2 ln J)``.

    The shear modulus at small strain is ``2 c1``, the bulk modulus kappa.

    Parameters
    ----------
    c1, c2, c3 : float
        [stress].
    kappa : float
        Bulk modulus [stress].
    plane : {"strain", "stress"}
        Plane strain or plane stress of a two-dimensional body.

    References
    ----------
    Holzapfel2000, section 6.5.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> rubber = pd.Yeoh(c1=0.2, c2=-0.002, c3=5e-5, kappa=50.0)
    """

    c1: float
    c2: float
    c3: float
    kappa: float
    plane: Literal["strain", "stress"] = "strain"

    def declared_energy(self) -> tuple[str, Mapping[str, float]]:
        """Return the text and the constants."""
        text = f"c1 * (I1bar - 3) + c2 * (I1bar - 3)**2 + c3 * (I1bar - 3)**3 + {VOLUMETRIC}"
        return text, {"c1": self.c1, "c2": self.c2, "c3": self.c3, "kappa": self.kappa}


@dataclass(frozen=True)
class Ogden(EnergyMaterial):
    """Ogden's rubber, ``psi = sum_p mu_p/alpha_p (l1bar^alpha_p + l2bar^alpha_p + l3bar^alpha_p - 3)`` + volume.

    The volumetric part is ``kappa/4 (J^2 - 1 - 2 ln J)``; the shear modulus at small strain is
    ``1/2 sum_p mu_p alpha_p``, the bulk modulus kappa.

    Parameters
    ----------
    mu : sequence of float
        [stress], one per term.
    alpha : sequence of float
        Exponents [-], as many, none of them zero.
    kappa : float
        Bulk modulus [stress].
    plane : {"strain", "stress"}
        Plane strain or plane stress of a two-dimensional body.

    Raises
    ------
    CaseError
        There are no terms, the numbers of exponents and moduli differ, or an exponent is zero.

    References
    ----------
    Ogden1972; Holzapfel2000, section 6.5.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> rubber = pd.Ogden(mu=(0.63, 0.0012, -0.01), alpha=(1.3, 5.0, -2.0), kappa=100.0, plane="stress")
    """

    mu: Sequence[float]
    alpha: Sequence[float]
    kappa: float
    plane: Literal["strain", "stress"] = "strain"

    def declared_energy(self) -> tuple[str, Mapping[str, float]]:
        """Return the text and the constants."""
        if len(self.mu) != len(self.alpha) or not 1 <= len(self.mu) <= 8:
            raise CaseError(f"Ogden takes as many mu as alpha, 1 to 8, not {len(self.mu)} and {len(self.alpha)}.")
        if any(exponent == 0.0 for exponent in self.alpha):
            raise CaseError("Ogden takes exponents alpha that are not zero.")
        values, terms = {"kappa": self.kappa}, []
        for number, (modulus, exponent) in enumerate(zip(self.mu, self.alpha, strict=True), 1):
            values |= {f"mu_{number}": modulus, f"alpha_{number}": exponent}
            powers = " + ".join(f"l{axis}bar**alpha_{number}" for axis in (1, 2, 3))
            terms.append(f"mu_{number}/alpha_{number} * ({powers} - 3)")
        return " + ".join([*terms, VOLUMETRIC]), values


@dataclass(frozen=True)
class HolzapfelGasserOgden(EnergyMaterial):
    """Fibres with dispersed directions in a soft matrix, as in walls of arteries.

    ``psi = c/2 (I1bar - 3) + k1/(2 k2) sum_i (exp(k2 e_i^2) - 1) + kappa/4 (J^2 - 1 - 2 ln J)`` with the strain ``e_i =
    < dispersion (I1bar - 3) + (1 - 3 dispersion) (I4bar_i - 1) >`` of each family of fibres, its positive part: fibres
    carry no compression.

    Parameters
    ----------
    c : float
        Shear modulus of the matrix [stress].
    k1 : float
        Stiffness of the fibres [stress], not negative.
    k2 : float
        Exponent of their stiffening [-], positive.
    kappa : float
        Bulk modulus [stress].
    fibre : sequence of float or callable
        Mean direction of the first family: a unit vector, or a function of positions (n, dim) that returns them.
    second_fibre : sequence of float or callable, optional
        Mean direction of the second family, if there is one.
    dispersion : float
        0 for aligned fibres to 1/3 for an isotropic distribution [-].
    plane : {"strain", "stress"}
        Plane strain or plane stress of a two-dimensional body.

    Raises
    ------
    CaseError
        A constant is out of range.

    References
    ----------
    Gasser2006.

    Examples
    --------
    >>> import numpy as np
    >>> import pdpetsc as pd
    >>> a = np.radians(50.0)
    >>> wall = pd.HolzapfelGasserOgden(
    ...     c=7.64, k1=996.6, k2=524.6, kappa=1e4, dispersion=0.226,
    ...     fibre=(np.cos(a), np.sin(a), 0.0), second_fibre=(np.cos(a), -np.sin(a), 0.0),
    ... )
    """

    c: float
    k1: float
    k2: float
    kappa: float
    fibre: Direction
    second_fibre: Direction | None = None
    dispersion: float = 0.0
    plane: Literal["strain", "stress"] = "strain"

    def declared_energy(self) -> tuple[str, Mapping[str, float]]:
        """Return the text and the constants."""
        if not (self.k1 >= 0.0 and self.k2 > 0.0 and 0.0 <= self.dispersion <= 1.0 / 3.0 + 1e-12):
            raise CaseError(
                f"HolzapfelGasserOgden needs k1 >= 0, k2 > 0 and a dispersion from 0 to 1/3, not {self.k1}, {self.k2} "
                f"and {self.dispersion}."
            )
        text = "c/2 * (I1bar - 3)"
        for name in ("I4bar", "I6bar")[: len(self.directions())]:
            strain = f"pos(dispersion * (I1bar - 3) + (1 - 3 * dispersion) * ({name} - 1))"
            text += f" + k1/(2*k2) * (exp(k2 * {strain}**2) - 1)"
        values = {"c": self.c, "k1": self.k1, "k2": self.k2, "dispersion": self.dispersion, "kappa": self.kappa}
        return f"{text} + {VOLUMETRIC}", values
