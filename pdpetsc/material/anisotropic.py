"""Anisotropic linear elasticity at small strain."""

from __future__ import annotations

import dataclasses
from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, TypeAlias

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.declared import numbers_from, real_numbers, shown
from pdpetsc.errors import CaseError
from pdpetsc.material.base import LARGEST_MODULUS, LEAST_MODULUS, HistoryKernels, Material
from pdpetsc.material.directed import DirectedMaterial
from pdpetsc.material.linear_elastic import linear_loops
from pdpetsc.material.symmetric import moduli_of_body, stiffness, stiffness_of_body

# An angle about the third axis [rad], a matrix whose columns are the axes of the material, or a function of positions
# (n, dim) that returns n angles or matrices.
Orientation: TypeAlias = float | Sequence[Sequence[float]] | Callable[[Float], Float]
# Tolerance of orthogonal unit axes, and of a symmetric and positive semidefinite stiffness, relative to its size.
NEARLY = 1e-6
SINGULAR = 1e-12


class AnisotropicLinear(DirectedMaterial):
    """A law ``P = C : eps, eps = sym(F - I)`` with anisotropic stiffness."""

    linear: ClassVar[bool] = True
    orientation: Orientation | None

    @abstractmethod
    def in_own_axes(self) -> Float:
        """Return the stiffness in the axes of the material (6, 6) [stress], of ``11, 22, 33, 23, 13, 12``.

        Shear strains are twice those of the tensor.
        """

    def __post_init__(self) -> None:
        super().__post_init__()
        name = type(self).__name__
        C = self.in_own_axes()
        size = float(np.abs(C).max()) if np.isfinite(C).all() else 0.0
        if not LEAST_MODULUS <= size <= LARGEST_MODULUS:
            raise CaseError(f"The stiffness of {name} must have moduli from {LEAST_MODULUS:g} to {LARGEST_MODULUS:g}.")
        if np.abs(C - C.T).max() > NEARLY * size:
            raise CaseError(f"The stiffness of {name} is not symmetric.")
        least = np.linalg.eigvalsh(C).min()
        if not least > SINGULAR * size:
            raise CaseError(
                f"The stiffness of {name} is not positive definite: its least eigenvalue is {least:.6g}; Poisson's "
                f"ratios are too large for these moduli."
            )
        if self.orientation is not None and not callable(self.orientation):
            turned = self._rotations(real_numbers(self.orientation), 1, self.orientation)
            # Not an array, so that materials can be compared.
            angle = np.ndim(self.orientation) == 0
            object.__setattr__(
                self, "orientation", self.orientation if angle else tuple(map(tuple, turned[0].tolist()))
            )

    def _rotations(self, values: Float | None, n: int, given: object) -> Float:
        """Return axes in columns (n, 3, 3) from one or ``n`` angles or matrices."""
        name = type(self).__name__
        if values is not None and not np.isfinite(values).all():
            raise CaseError(f"The orientation of {name} must be finite numbers.")
        if values is not None and values.shape in ((), (n,)):
            c, s = np.cos(values), np.sin(values)
            R = np.zeros((n, 3, 3))
            R[:, 0, 0], R[:, 0, 1], R[:, 1, 0], R[:, 1, 1], R[:, 2, 2] = c, -s, s, c, 1.0
        elif values is not None and values.shape in ((3, 3), (n, 3, 3)):
            R = np.broadcast_to(values, (n, 3, 3))
        else:
            raise CaseError(
                f"{name} takes one angle or one matrix (3, 3) per particle as orientation, not {shown(given)}."
            )
        off = np.abs(np.einsum("pji,pjk->pik", R, R) - np.eye(3)).max() if n else 0.0
        if not off <= NEARLY:
            raise CaseError(f"The orientation of {name} must have orthogonal unit vectors as columns, or be an angle.")
        return R

    def _solid(self) -> Float:
        C = self.in_own_axes()
        return stiffness(0.5 * (C + C.T))

    def _solids(self, x: Float) -> Float:
        """Compute the stiffness of the solid at positions (n, dim), in the axes of the body (n, 3, 3, 3, 3)."""
        C, n = self._solid(), len(x)
        if self.orientation is None or n == 0:
            return np.broadcast_to(C, (n, 3, 3, 3, 3))
        if callable(self.orientation):
            values = numbers_from(f"orientation of {type(self).__name__}", self.orientation, x)
            if values.shape not in ((n,), (n, 3, 3)):
                raise CaseError(
                    f"The orientation of {type(self).__name__} must return one angle or one matrix per particle, "
                    f"not shape {values.shape}."
                )
        else:
            values = np.asarray(self.orientation, dtype=float)
        R = self._rotations(values, n, self.orientation)
        # A constant orientation has one stiffness.
        few = R if callable(self.orientation) else R[:1]
        turned = np.einsum("pia,pjb,pkc,pld,abcd->pijkl", few, few, few, few, C, optimize=True)
        return np.broadcast_to(turned, (n, 3, 3, 3, 3))

    def history_kernels(self, dim: int) -> HistoryKernels:
        """Return the compiled loops for dimension ``dim``."""
        return linear_loops(dim)

    def constants(self, dim: int) -> Float:
        """Return the stiffness in the dimensions of the body, for points without own stiffness."""
        return self._reduced(dim, np.zeros((1, dim)))[0] if not callable(self.orientation) else np.empty(0)

    def history_at(self, dim: int, x: Float) -> Float:
        """Return stiffness in the dimensions of the body and out-of-plane coefficients, per point if they differ."""
        if not callable(self.orientation):
            return np.empty((len(x), 0))
        return self._reduced(dim, x)

    def history_in_space(self, x: Float) -> Float:
        """Return the stiffness of the solid for an orientation that is a function of positions in the plane."""
        if not callable(self.orientation):
            return np.empty((len(x), 0))
        return stiffness_of_body(self._solids(x), 3, self.plane)

    def _reduced(self, dim: int, x: Float) -> Float:
        """Return ``C`` (dim^4) and the coefficients of out-of-plane stress or strain (dim^2), one row per position."""
        return stiffness_of_body(self._solids(x), dim, self.plane)

    def _across(self, F: Float, history: Float) -> Float:
        dim = F.shape[-1]
        rows = history if history.shape[1] else self.constants(dim)[None]
        return np.asarray(np.einsum("pij,pij->p", rows[:, dim**4 :].reshape(-1, dim, dim) + 0.0 * F, F - np.eye(dim)))

    def hidden_stretch(self, F: Float, history: Float, dt: float = 0.0) -> Float:
        """Return 1 plus the strains outside the dimensions of the body, to first order (n,) [-]."""
        if F.shape[-1] == 3 or (F.shape[-1] == 2 and self.plane == "strain"):
            return np.ones(len(F))
        return 1.0 + self._across(F, history)

    def out_of_plane_stress(self, F: Float, history: Float, dt: float = 0.0) -> Float:
        """Return ``P_zz = C_zzij eps_ij`` (n,) [stress] in plane strain."""
        return self._across(F, history)

    def uniform(self) -> Material:
        """Return the material with a constant orientation, angle 0, if it is a function of position."""
        declared: Any = self
        replaced: Material = (
            dataclasses.replace(declared, orientation=_not_turned) if callable(self.orientation) else self
        )
        return replaced

    def moduli(self, dim: int) -> Float:
        """Return the stiffness; its isotropic mean if the orientation is a function of position."""
        if callable(self.orientation):
            return self._mean(dim)
        return moduli_of_body(self._solids(np.zeros((1, dim)))[0], dim, self.plane)


def _not_turned(x: Float) -> Float:
    return np.zeros(len(x))


@dataclass(frozen=True)
class Orthotropic(AnisotropicLinear):
    """Orthotropic linear elasticity at small strain, ``eps_11 = s_11/E1 - nu12 s_22/E1 - nu13 s_33/E1, ...``.

    Parameters
    ----------
    E : (E1, E2, E3)
        Young's moduli along the axes of the material [stress].
    nu : (nu12, nu23, nu13)
        Poisson's ratios [-]: in tension along the first index, the strain along the second is ``-nu`` times that along
        the first.
    G : (G12, G23, G13)
        Shear moduli [stress].
    orientation : float, matrix or callable, optional
        Axes of the material: an angle about the third axis [rad], a matrix (3, 3) with the axes in columns, or a
        function of positions (n, dim) that returns angles (n,) or matrices (n, 3, 3). The axes of the body by default.
    plane : {"strain", "stress"}
        Plane strain or plane stress of a two-dimensional body.

    Raises
    ------
    CaseError
        The stiffness is not positive definite, or the orientation is invalid.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> ply = pd.Orthotropic(
    ...     E=(140e3, 10e3, 10e3), nu=(0.3, 0.4, 0.3), G=(5e3, 3.5e3, 5e3), orientation=0.5, plane="stress"
    ... )
    """

    E: tuple[float, float, float]
    nu: tuple[float, float, float]
    G: tuple[float, float, float]
    orientation: Orientation | None = None
    plane: Literal["strain", "stress"] = "strain"

    def in_own_axes(self) -> Float:
        """Return the inverse of the compliance."""
        if not min(*self.E, *self.G) > 0.0 or not max(*self.E, *self.G) <= LARGEST_MODULUS:
            raise CaseError(f"Orthotropic needs positive moduli E and G, not {shown(self.E)} and {shown(self.G)}.")
        if not max(map(abs, self.nu)) <= LARGEST_MODULUS:
            raise CaseError(f"Orthotropic needs Poisson's ratios that are numbers, not {shown(self.nu)}.")
        (E1, E2, E3), (nu12, nu23, nu13), (G12, G23, G13) = self.E, self.nu, self.G
        S = np.diag([1.0 / E1, 1.0 / E2, 1.0 / E3, 1.0 / G23, 1.0 / G13, 1.0 / G12])
        S[0, 1] = S[1, 0] = -nu12 / E1
        S[1, 2] = S[2, 1] = -nu23 / E2
        S[0, 2] = S[2, 0] = -nu13 / E1
        if not np.linalg.eigvalsh(S * max(self.E)).min() > 0.0:
            raise CaseError(
                f"Orthotropic has no positive definite stiffness with nu = {shown(self.nu)} and these moduli."
            )
        return np.linalg.inv(S)


@dataclass(frozen=True)
class AnisotropicElastic(AnisotropicLinear):
    """Linear elasticity at small strain with a stiffness matrix.

    Parameters
    ----------
    stiffness : (6, 6) sequence of sequences of float
        Stresses ``11, 22, 33, 23, 13, 12`` for strains in the same order, shear strains twice those of the tensor
        [stress]; symmetric and positive definite.
    orientation, plane
        As for ``Orthotropic``.

    Raises
    ------
    CaseError
        The stiffness is not symmetric and positive definite, or the orientation is invalid.

    Examples
    --------
    >>> import numpy as np
    >>> import pdpetsc as pd
    >>> C = np.diag([170.0, 170.0, 170.0, 75.0, 75.0, 75.0])
    >>> C[:3, :3] += 120.0 * (1.0 - np.eye(3))
    >>> cubic = pd.AnisotropicElastic(C.tolist(), orientation=0.3)
    """

    stiffness: Sequence[Sequence[float]]
    orientation: Orientation | None = None
    plane: Literal["strain", "stress"] = "strain"

    def in_own_axes(self) -> Float:
        C = real_numbers(self.stiffness)
        if C is None or C.shape != (6, 6):
            raise CaseError(
                f"AnisotropicElastic takes a stiffness of 6 rows of 6 numbers, not {shown(self.stiffness)}."
            )
        return C
