"""Dependence of materials on temperature."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.bond_based import BondMaterial
from pdpetsc.declared import Declared, Finite, Positive, called, numbers_from, real_numbers, shown
from pdpetsc.errors import CaseError
from pdpetsc.material.base import Material
from pdpetsc.material.graded import Graded

# A number for all directions, three for the axes, or a function of temperatures (n,) that returns (n,) or (n, 3).
Expansion: TypeAlias = Finite | Sequence[Finite] | Callable[[Float], Float]
# Tolerance of the unit columns of an orientation.
NEARLY = 1e-9


@dataclass(frozen=True)
class Thermal(Declared):
    """A material with thermal expansion, temperature-dependent moduli and heat conduction.

    Its stress-free deformation is ``F_theta = I + alpha (T - T_ref)``. At finite strain the law is evaluated at the
    elastic part ``F_e = F F_theta^-1``, and ``P = J_theta P_e(F_e) F_theta^-T``. Linear materials use the strain minus
    ``alpha (T - T_ref)``. The out-of-plane expansion is held in plane strain, and free in plane stress and in a bar.

    Parameters
    ----------
    material : Material, BondMaterial or Graded
        The law at the stress-free temperature.
    expansion : float, sequence of three float, or callable
        ``alpha``, the mean coefficient of expansion from ``T_ref`` to T [1 / temperature]: one for all directions, one
        per axis of the material, or a function of temperatures (n,) that returns values (n,) or (n, 3). Plane bodies
        and bars require the out-of-plane coefficients too.
    orientation : float or (3, 3) matrix, optional
        Axes of the material in columns, or the angle of the first axis about z [rad]; the axes of the body by default.
    reference : float
        ``T_ref``, the stress-free temperature; also the initial temperature of the body.
    factor : callable or Table, optional
        Factor of all moduli and of the yield stress, as a function of temperatures (n,) that returns positive values
        (n,) [-]; 1 by default.
    law : callable, optional
        Function of one temperature that returns a material of the same kind as ``material``, for yield stress or
        hardening with another temperature dependence than the moduli. The loops are called once per distinct
        temperature.
    conductivity : float or sequence of three float, optional
        ``k`` [power / length / temperature], positive: one for all directions or one per axis of the material; for
        ``HeatConduction``.
    capacity : float, optional
        ``c``, heat per reference volume and temperature, density times specific heat [energy / volume / temperature],
        positive; for transient ``HeatConduction``.

    Raises
    ------
    CaseError
        A number is not finite or not positive, or the axes of the orientation are not orthogonal unit vectors.

    References
    ----------
    Holzapfel2000, chapter 7.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> steel = pd.Thermal(pd.NeoHookean(E=200e3, nu=0.3), expansion=1.2e-5, reference=20.0)
    >>> ply = pd.Orthotropic((40.0, 8.0, 8.0), (0.25, 0.25, 0.25), (4.0, 4.0, 4.0), orientation=0.5)
    >>> turned = pd.Thermal(ply, (6e-6, 3e-5, 3e-5), orientation=0.5)
    >>> softer = pd.Thermal(pd.Hencky(E=70e3, nu=0.3), 2.4e-5, factor=pd.Table([20.0, 300.0], [1.0, 0.7]))
    """

    material: Material | BondMaterial | Graded
    expansion: Expansion = 0.0
    orientation: float | Sequence[Sequence[float]] | None = None
    reference: Finite = 0.0
    factor: Callable[[Float], Float] | None = None
    conductivity: Positive | Sequence[Positive] | None = None
    capacity: Positive | None = None
    law: Callable[[float], Material] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("expansion", "conductivity"):
            value = getattr(self, name)
            if value is not None and not callable(value) and np.shape(value) not in ((), (3,)):
                raise CaseError(f"Thermal takes one number or three as {name}, not {shown(value)}.")
        _ = self.axes
        plain = self.material.material if isinstance(self.material, Graded) else self.material
        rate = getattr(plain, "rate", None)
        fixed = None if rate is None else rate.fixed_temperature
        if fixed is not None and self.law is None:
            raise CaseError(
                f"The rate law {type(rate).__name__} in a Thermal material has a temperature of its own, {fixed:g}, "
                f"and would not follow that of the body; give the material as a function of the temperature: "
                f"Thermal(..., law=lambda T: ...)."
            )

    @property
    def axes(self) -> Float | None:
        """Return the axes of the material in columns (3, 3); None for those of the body."""
        if self.orientation is None:
            return None
        values = real_numbers(self.orientation)
        if values is not None and values.shape == () and np.isfinite(values):
            c, s = np.cos(float(values)), np.sin(float(values))
            return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        if values is not None and values.shape == (3, 3) and np.abs(values.T @ values - np.eye(3)).max() <= NEARLY:
            return values
        raise CaseError(
            f"Thermal takes an angle, or a matrix (3, 3) with orthogonal unit vectors as columns, as orientation, not "
            f"{shown(self.orientation)}."
        )

    def strain(self, T: Float) -> Float:
        """Compute ``alpha (T - T_ref)`` at temperatures (n,) as tensors in the axes of the body (n, 3, 3) [-].

        Raises
        ------
        CaseError
            The function of the expansion fails or does not return one or three finite numbers per temperature.
        """
        alpha = self._coefficients(T)
        strain = np.zeros((len(T), 3, 3))
        for axis in range(3):
            strain[:, axis, axis] = alpha[:, axis] * (T - self.reference)
        R = self.axes
        return strain if R is None else np.asarray(np.einsum("ia,pab,jb->pij", R, strain, R))

    def _coefficients(self, T: Float) -> Float:
        if not callable(self.expansion):
            return np.broadcast_to(np.asarray(self.expansion, dtype=float), (len(T), 3))
        if len(T) == 0:
            return np.zeros((0, 3))
        values = numbers_from("expansion of a Thermal material", self.expansion, T)
        if values.shape == (len(T),):
            values = values[:, None]
        if values.shape not in ((len(T), 1), (len(T), 3)) or not np.isfinite(values).all():
            raise CaseError(
                f"The expansion of a Thermal material must return one or three finite numbers per temperature, not "
                f"shape {values.shape}."
            )
        return np.broadcast_to(values, (len(T), 3))

    @property
    def softens(self) -> bool:
        """Return True if temperature changes moduli."""
        return self.factor is not None or self.law is not None

    def conduction(self) -> Float | None:
        """Return the conductivity as a tensor in the axes of the body (3, 3), None if it is not declared."""
        if self.conductivity is None:
            return None
        k, R = np.diag(np.broadcast_to(np.asarray(self.conductivity, dtype=float), 3)), self.axes
        return k if R is None else np.asarray(R @ k @ R.T)

    def material_at(self, T: float, plain: Material) -> Material:
        """Return the law at a temperature; ``plain`` if it does not depend on temperature.

        Raises
        ------
        CaseError
            The function fails, or returns a material of another kind or duration than ``plain``.
        """
        if self.law is None:
            return plain
        found = called("law of a Thermal material", self.law, T)
        if type(found) is not type(plain) or found.plane != plain.plane:
            raise CaseError(
                f"The law of a Thermal material must return a {type(plain).__name__} in plane {plain.plane} as its "
                f"material is one, not {shown(found)} at temperature {T:g}."
            )
        if found.duration != plain.duration:
            raise CaseError(
                f"The law of a Thermal material must have the duration {plain.duration} of its material, not "
                f"{found.duration} at temperature {T:g}: one time goes by from step time 0 to 1."
            )
        return found

    def factors(self, T: Float) -> Float:
        """Compute the factor of the moduli at temperatures (n,) [-].

        Raises
        ------
        CaseError
            The function fails or does not return one positive number per temperature.
        """
        if self.factor is None or len(T) == 0:
            return np.ones(len(T))
        values = numbers_from("factor of a Thermal material", self.factor, T)
        if values.shape != T.shape:
            raise CaseError(
                f"The factor of a Thermal material must return one number per temperature, not shape {values.shape}."
            )
        bad = np.flatnonzero(~(np.isfinite(values) & (values > 0.0)))
        if len(bad):
            raise CaseError(
                f"The factor of a Thermal material is {values[bad[0]]:g} at temperature {T[bad[0]]:g}; it must be "
                f"positive."
            )
        return values
