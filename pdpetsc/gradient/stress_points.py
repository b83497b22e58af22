"""Stress points: two gradient points per particle, on opposite sides along a diagonal drawn at random."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.families import Families
from pdpetsc.gradient.axes import body_axes
from pdpetsc.gradient.base import GradientOperator, Scheme
from pdpetsc.gradient.sectors import sector_operator

# A family is cut or irregular if its weighted mean bond is longer than this share of its mean bond length.
UNBALANCED = 0.02
# A bond lies in the dividing plane if the sine of its angle to the plane is smaller.
IN_PLANE = 1e-8


@dataclass(frozen=True)
class StressPoints(Scheme):
    """Stress points: a plane across a diagonal halves the family; each half has a gradient point.

    The diagonal (1, +-1, +-1) is drawn at random for each particle: one choice in 1D, two in 2D, four in 3D. Its axes
    rotate with the body like those of ``SubHorizons``; after a rotation by more than 45 degrees the draw may differ. A
    bond in the dividing plane belongs to both halves in equal parts; nearest neighbours on a lattice have no such
    bonds. A family that a boundary cuts, or with irregular positions, is halved across its mean bond instead. Along a
    flat face the halves are then mirror images of themselves and the face is free of stress. Both rules extend the
    method to wider horizons. If a half is too flat for a gradient, as at every boundary of a lattice of nearest
    neighbours, the particle has one point over all bonds.

    Parameters
    ----------
    seed : int
        Seed of the draw. The draw depends on seed and global id of the particle only, not on the number of ranks.

    References
    ----------
    Luo2018, section 3, Fig. 3-5.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> pd.StressPoints(seed=3)
    StressPoints(seed=3)
    """

    seed: int = 1

    def build(self, cloud: Cloud, families: Families, omega: Float) -> GradientOperator:
        """Build the gradient operator (collective); raise CaseError if a family is too small or flat."""
        draw = _drawn(cloud.gid[: cloud.n_owned], self.seed)
        diagonal = np.ones((cloud.n_owned, cloud.dim))
        for d in range(1, cloud.dim):
            diagonal[:, d] -= 2.0 * ((draw >> np.uint64(d - 1)) & np.uint64(1)).astype(float)
        xi = families.bonds(cloud.x)
        axes, note = body_axes(cloud, families, xi)
        diagonal = diagonal @ axes
        length = np.linalg.norm(xi, axis=1)
        weight = omega * cloud.volume[families.neighbours]
        mean, size = np.zeros_like(diagonal), np.zeros(cloud.n_owned)
        np.add.at(mean, families.centres, weight[:, None] * xi)
        np.add.at(size, families.centres, weight * length)
        unbalanced = np.linalg.norm(mean, axis=1) > UNBALANCED * size
        # On the same side as the drawn diagonal, so that both halves keep their order and history if bonds break.
        mean[np.einsum("id,id->i", mean, diagonal) < 0.0] *= -1.0
        diagonal[unbalanced] = mean[unbalanced]
        diagonal /= np.linalg.norm(diagonal, axis=1, keepdims=True)
        along = np.einsum("bd,bd->b", xi, diagonal[families.centres])
        ahead = np.where(np.abs(along) < IN_PLANE * length, 0.5, (along > 0.0).astype(float))
        share = np.stack([1.0 - ahead, ahead], axis=1)
        distance = np.array([[0.0, 1.0], [1.0, 0.0]])
        return sector_operator(cloud, families, omega, share, distance, "stress points", note)


def _drawn(gid: GlobalIndex, seed: int) -> np.ndarray[tuple[int], np.dtype[np.uint64]]:
    """Return 64 random bits per particle: the SplitMix64 sequence of ``seed`` at place ``gid``."""
    with np.errstate(over="ignore"):
        z = np.uint64(seed % 2**64) + (gid.astype(np.uint64) + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        return np.asarray(z ^ (z >> np.uint64(31)))
