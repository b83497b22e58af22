"""Sub-horizons: one gradient point per half, quadrant or octant of the family."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, Mask
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.families import Families
from pdpetsc.gradient.base import GradientOperator, Scheme, flat, operator, refuse_flat, whole_families, with_centres

# A bond component below this share of the horizon lies on the border of two sectors.
ON_BORDER = 1e-8
# A sector is merged with its neighbours when the smallest eigenvalue of its shape tensor is below this share of the
# mean one: sectors of a lattice stay above 0.2.
THIN = 1e-2


@dataclass(frozen=True)
class SubHorizons(Scheme):
    """Sub-horizons: ``2^dim`` gradient points per particle, one per half (1D), quadrant (2D) or octant (3D).

    ``F_ia = I + sum_j chi_a omega V_j eta_ij (x) K_ia^-1 xi_ij`` with ``chi_a`` the share of the bond in sector ``a``.
    A bond on the border of sectors is shared by them in equal parts, which the open sectors of the paper leave out and
    which a lattice with nearest neighbours needs. A sector whose own bonds are too flat to give a gradient hands them
    to the sectors it shares most borders with, in equal parts, and has no point; the others share the volume.

    References
    ----------
    Chowdhury, Roy, Roy, Reddy, section 4, Eq. (19)-(34).
    """

    def build(self, cloud: Cloud, families: Families, omega: Float) -> GradientOperator:
        """Return the operator (collective); raises CaseError where no sector of a family gives a gradient."""
        weight = omega * cloud.volume[families.neighbours]
        share = _shares(families.bonds(cloud.x), cloud.horizon)
        sectors = share.shape[1]
        thin = np.empty((cloud.n_owned, sectors), dtype=bool)
        for a in range(sectors):
            K = whole_families(cloud, families, weight * share[:, a]).shape_tensors(cloud.x)
            mean = np.einsum("pii->p", K) / cloud.dim
            thin[:, a] = np.linalg.eigvalsh(K)[:, 0] <= THIN * mean
        whole = whole_families(cloud, families, weight)
        lost = thin.all(axis=1)
        singular = lost & flat(whole.shape_tensors(cloud.x))
        refuse_flat(
            cloud.comm, cloud.gid[: cloud.n_owned][singular], "sub-horizons", "widen the horizon or add particles there"
        )
        centres = families.centres
        share = np.einsum("ba,bac->bc", share, _merging(thin)[centres])
        share[lost[centres], 0] = 1.0
        points = ~thin
        points[lost, 0] = True
        return operator(cloud, with_centres(*_listed(points, centres, families.neighbours, weight, share)))


def _shares(xi: Float, horizon: float) -> Float:
    """Return the share of every bond in every sector, (n_bonds, 2^dim); a row sums to 1."""
    dim = xi.shape[1]
    positive = np.where(np.abs(xi) < ON_BORDER * horizon, 0.5, (xi > 0.0).astype(float))
    share = np.ones((len(xi), 2**dim))
    for a, signs in enumerate(itertools.product((False, True), repeat=dim)):
        for d, up in enumerate(signs):
            share[:, a] *= positive[:, d] if up else 1.0 - positive[:, d]
    return share


def _merging(thin: Mask) -> Float:
    """Return ``M[i, a, c]``: the share of sector ``a`` of particle ``i`` that point ``c`` takes over."""
    sectors = thin.shape[1]
    flips = np.array([[(a ^ c).bit_count() for c in range(sectors)] for a in range(sectors)], dtype=float)
    distance = np.where(thin[:, None, :], np.inf, flips[None])
    nearest = distance == distance.min(axis=2, keepdims=True)
    nearest &= np.isfinite(distance)
    return np.asarray(nearest / np.maximum(nearest.sum(axis=2, keepdims=True), 1))


def _listed(
    points: Mask, centres: LocalIndex, neighbours: LocalIndex, weight: Float, share: Float
) -> tuple[LocalIndex, GlobalIndex, LocalIndex, Float]:
    """Return owners, pointers, members and weights of the points, sorted by owner, sector and bond."""
    owner, sector = np.nonzero(points)
    number = np.full(points.shape, -1, dtype=np.int64)
    number[owner, sector] = np.arange(len(owner))
    bond, taken = np.nonzero(share)
    point = number[centres[bond], taken]
    order = np.argsort(point, kind="stable")
    point_ptr = np.concatenate([[0], np.cumsum(np.bincount(point, minlength=len(owner)))])
    members = neighbours[bond[order]]
    return owner.astype(np.int32), point_ptr, members, weight[bond[order]] * share[bond[order], taken[order]]
