"""The microelastic, bond-based material."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.bond_based.base import BondMaterial, BondStiffness, Neighbourhood
from pdpetsc.discrete.communicator import total
from pdpetsc.errors import CaseError
from pdpetsc.kernels.sparsity import sum_by
from pdpetsc.material.linear_elastic import LinearElastic

# Smallest share of the energy of a whole family along each axis that the surface correction uses, to bound the factor.
LEAST = 1e-2
# The stiffness of the mean family along an axis is zero if it is below this share of its largest stiffness.
NO_STIFFNESS = 1e-9
# Bonds whose directions are in memory at once.
BLOCK = 2**18
# Tolerance of the declared Poisson's ratio [-].
SAME_RATIO = 1e-3


@dataclass(frozen=True)
class BondBased(BondMaterial):
    """Bond-based material, ``f = c omega s n``: the force of a bond depends on its own stretch ``s`` only.

    Its Poisson's ratio is fixed: 1/4, 1/3 in plane stress. The micromodulus ``c`` is ``a E / I`` with
    ``I = int omega |xi| dV`` over the family and a = 2 (1D), 6.4 (plane strain), 6 (plane stress) and 12 (3D).

    Parameters
    ----------
    E, plane, kinematics
        Young's modulus [stress], ``"strain"`` or ``"stress"`` for plane strain or plane stress, and ``"small"`` or
        ``"finite"`` displacements, as for every ``BondMaterial``.
    nu : float, optional
        Poisson's ratio [-]; if declared, it must be the fixed one.
    calibration : {"continuum", "lattice", "family"}
        Definition of ``I``. ``continuum``: the integral over a full ball. ``lattice``: one number for the body. With it
        the particles further than a horizon from the surface have the mean modulus E in uniform tension along x with
        free sides. In a thin body without such particles the largest families are used. ``family``: as ``lattice``,
        with a larger stiffness in cut families, which corrects most of the soft surface. With the energy ``W_a`` of a
        family stretched along each axis, its mean inside and ``g_a = W_mean / W_a``, a bond has the factor
        ``1 / |(n_x / g_x, n_y / g_y, n_z / g_z)|``, the mean of both ends.

    References
    ----------
    Silling2000; Silling2005, section 3; Mikes2021, Eq. (2)-(6). Correction of the surface: Madenci2014, section 4.2.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> pd.BondBased(E=30e3, calibration="lattice").elastic(dim=3).nu
    0.25
    """

    of_family: ClassVar[bool] = True

    calibration: Literal["continuum", "lattice", "family"] = "continuum"

    def elastic(self, dim: int) -> LinearElastic:
        """Return the linear elastic material with the fixed Poisson's ratio."""
        fixed = 1.0 / 3.0 if dim == 2 and self.plane == "stress" else 0.25
        if dim > 1 and self.nu is not None and abs(self.nu - fixed) > SAME_RATIO:
            where = f"plane {self.plane}" if dim == 2 else "3D"
            raise CaseError(
                f"A bond-based material in {where} has Poisson's ratio {fixed:.4g}, not {self.nu:g}; leave nu out, or "
                f"take LinearSolid or a correspondence material."
            )
        return LinearElastic(self.E, fixed if dim > 1 else 0.0, self.plane)

    def stiffness(self, bonds: Neighbourhood) -> BondStiffness:
        """Return ``k_ij = 1/2 c_i omega V_i V_j / |xi|`` (collective)."""
        calibrated = {"continuum": _continuum, "lattice": _lattice, "family": _family}[self.calibration]
        c = calibrated(bonds, self.elastic(bonds.cloud.dim))
        volume = bonds.cloud.volume
        pair = volume[bonds.families.centres] * volume[bonds.families.neighbours]
        return BondStiffness(0.5 * c * bonds.omega * pair / bonds.length)


def _continuum(bonds: Neighbourhood, elastic: LinearElastic) -> Float:
    """Return the micromodulus of every bond from the integral over a full ball."""
    dim = bonds.cloud.dim
    # Both Lame constants of 1/2 c int omega |xi| n n n n dV are c I / (2 dim (dim + 2)); lambda + 2 mu = E on a line.
    mu = elastic.E / 3.0 if dim == 1 else elastic.lame(dim)[1]
    return np.asarray(2.0 * dim * (dim + 2) * mu / bonds.continuous_moment(1)[bonds.families.centres])


def _family(bonds: Neighbourhood, elastic: LinearElastic) -> Float:
    """Return the micromodulus of inner families, increased if the family of the first end of a bond is cut."""
    cloud, families = bonds.cloud, bonds.families
    n = families.bonds(cloud.x) / bonds.length[:, None]
    weight = bonds.omega * bonds.length * cloud.volume[families.neighbours]
    # Energy of the particle if stretched along each axis, and mean inner energy over it.
    W = sum_by(families.centres, weight[:, None] * n**4, cloud.n_owned) / bonds.relative_size(1)[:, None]
    share = bonds.share_inside
    whole = total(cloud.comm, share @ W)
    bounded = np.maximum(W, LEAST * whole)
    g = np.divide(whole, bounded, out=np.ones_like(bounded), where=bounded > 0.0)  # one row: no transverse energy
    factor = 1.0 / np.sqrt(((n / g[families.centres]) ** 2).sum(axis=1))
    return np.asarray(_lattice(bonds, elastic) * factor)


def _lattice(bonds: Neighbourhood, elastic: LinearElastic) -> Float:
    """Return the micromodulus for which the mean inner family has the modulus E along x.

    If horizons differ, families are compared relative to the size of a full ball.
    """
    cloud, families = bonds.cloud, bonds.families
    size = bonds.relative_size(1)
    weight = 0.5 * bonds.omega * bonds.length * (bonds.share_inside / size)[families.centres]
    fourth = np.zeros((cloud.dim**2, cloud.dim**2))
    for begin in range(0, len(weight), BLOCK):
        part = slice(begin, begin + BLOCK)
        xi = cloud.x[families.neighbours[part]] - cloud.x[families.centres[part]]
        n = xi / np.linalg.norm(xi, axis=1)[:, None]
        square = (n[:, :, None] * n[:, None, :]).reshape(len(n), -1)
        fourth += (square * (weight[part] * cloud.volume[families.neighbours[part]])[:, None]).T @ square
    C = total(cloud.comm, fourth.reshape((cloud.dim,) * 4))
    stiff = np.einsum("aaaa->a", C)
    # A single row of particles has a stiffness along the row only.
    axis = int(np.argmax(stiff > NO_STIFFNESS * stiff.max()))
    unit = _modulus_along(axis, C)
    lam, mu = elastic.lame(cloud.dim)
    one = np.eye(cloud.dim)
    both = np.einsum("ik,jl->ijkl", one, one) + np.einsum("il,jk->ijkl", one, one)
    c = _modulus_along(axis, lam * np.einsum("ij,kl->ijkl", one, one) + mu * both) / unit
    return np.asarray(c / size[families.centres])


def _modulus_along(axis: int, C: Float) -> float:
    """Return the modulus along an axis, stress over strain with free sides, for stiffness ``C_ijkl``."""
    dim = len(C)
    pairs = [(a, a) for a in range(dim)] + [(a, b) for a in range(dim) for b in range(a + 1, dim)]
    matrix = np.array([[C[a, b, c, d] * (1.0 if c == d else 2.0) for c, d in pairs] for a, b in pairs])
    return float(1.0 / np.linalg.pinv(matrix)[axis, axis])
