"""Silling's control of the non-uniform part of the deformation of a family."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.families import Families
from pdpetsc.discrete.pattern import Pattern
from pdpetsc.errors import CaseError
from pdpetsc.gradient.base import flat, refuse_flat, whole_families
from pdpetsc.kernels.pattern import transpose
from pdpetsc.kernels.stabilisation import non_uniform_force_kernel, non_uniform_matrix_kernel
from pdpetsc.stabilisation.base import Control, Stabilisation


@dataclass(frozen=True)
class Silling(Stabilisation):
    """Silling's control, ``T_z = G kappa / (sum_j omega |xi|^2 V_j) omega z`` with ``z = eta - (F - I) xi``.

    ``kappa = lambda + 2 mu / dim`` is the modulus of the material, so ``G`` is a pure number: the same case in other
    units has the same answer. It acts on what a uniform gradient of the whole family leaves unexplained and leaves
    every affine displacement alone.

    Parameters
    ----------
    G : float
        Strength [-], not negative; about 0.5 suppresses zero-energy modes and costs little stiffness.

    Raises
    ------
    CaseError
        ``G`` is negative or not finite.

    References
    ----------
    Silling (2017), section 5; Hashim et al., Eq. (37)-(44). There G C / omega_0 with the micromodulus C of a bond-based
    solid stands for the factor above; it has other dimensions, so that paper's values of G depend on the length unit.
    """

    G: float = 0.5

    def __post_init__(self) -> None:
        if not (math.isfinite(self.G) and self.G >= 0.0):
            raise CaseError(f"Silling's control needs G >= 0, not {self.G}.")

    def build(self, cloud: Cloud, families: Families, omega: Float, kappa: Float) -> Control:
        """Return the control (collective); raises CaseError where a family is too small or flat."""
        stencils = whole_families(cloud, families, omega * cloud.volume[families.neighbours])
        K = stencils.shape_tensors(cloud.x)
        refuse_flat(
            cloud.comm, cloud.gid[stencils.owner[flat(K)]], "Silling's control",
            "widen the horizon or add particles there",
        )  # fmt: skip
        factor = self.G * kappa * cloud.volume[: cloud.n_owned] / np.einsum("pii->p", K)
        return _NonUniform(cloud, families, omega, factor, K)


class _NonUniform(Control):
    """The control with bond stiffness ``s_ij = factor_i omega_ij V_j`` [force / length]."""

    def __init__(self, cloud: Cloud, families: Families, omega: Float, factor: Float, K: Float) -> None:
        self._cloud = cloud
        self._families = families
        self._stiffness = factor[families.centres] * omega * cloud.volume[families.neighbours]
        self._K_inverse = np.linalg.inv(K * factor[:, None, None]) if np.all(factor > 0.0) else np.zeros_like(K)
        with_centre = whole_families(cloud, families, self._stiffness)
        self.point_ptr, self.members = with_centre.point_ptr, with_centre.members
        self._with_centre = with_centre.weight

    def force(self, u: Float, f: Float) -> float:
        """Add ``s_ij z_ij`` to ``j`` and its opposite to ``i``; return the energy ``1/2 sum s |z|^2``."""
        kernel = non_uniform_force_kernel(self._cloud.dim)
        family = self._families
        energy = kernel(family.indptr, family.neighbours, self._stiffness, self._K_inverse, self._cloud.x, u, f)
        return float(energy)

    def matrix(self, pattern: Pattern) -> tuple[Float, Float]:
        """Return the scalar matrix of the control in ``pattern`` order (collective)."""
        transposed = transpose(self.point_ptr, self.members, self._cloud.n_local)
        kernel = non_uniform_matrix_kernel(self._cloud.dim)
        values = []
        for rows in (pattern.owned, pattern.ghost):
            diag, off = np.empty(rows.diag_ptr[-1]), np.empty(rows.off_ptr[-1])
            kernel(
                rows.first, rows.diag_ptr, rows.off_ptr, rows.columns, pattern.local_of_column, *transposed,
                self.point_ptr, self.members, self._with_centre, self._K_inverse, self._cloud.x, diag, off,
            )  # fmt: skip
            values.append((diag, off))
        diag, off = values[0]
        pattern.complete(values[1][0], diag, off, 1)
        return diag, off
