"""Families divided into sectors, each with a gradient point of its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, Mask, starts_of
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.families import Families
from pdpetsc.gradient.base import (
    THIN,
    GradientOperator,
    Parts,
    flat,
    operator,
    refuse_flat,
    shape_tensors,
    with_centres,
)


def sector_operator(
    cloud: Cloud, families: Families, omega: Float, share: Float, distance: Float, name: str, note: str = ""
) -> GradientOperator:
    """Build the operator with one point per sector that has a gradient (collective).

    Parameters
    ----------
    cloud, families, omega
        The bonds and their influence.
    share : (n_bonds, n_sectors) float64
        Share of every bond in every sector; a row sums to 1.
    distance : (n_sectors, n_sectors) float64
        Distance between sectors. If the bonds of a sector are too flat, they are added to the nearest sectors in equal
        parts.
    name : str
        Name of the scheme, for messages.
    note : str
        Note on the sectors for the log.

    Raises
    ------
    CaseError
        Neither a sector of a family nor the whole family has a gradient.
    """
    weight = omega * cloud.volume[families.neighbours]
    empty = np.empty((cloud.n_owned, share.shape[1]), dtype=bool)
    for a in range(share.shape[1]):
        empty[:, a] = flat(shape_tensors(families, weight * share[:, a], cloud.x), THIN)
    lost = empty.all(axis=1)
    singular = lost & flat(shape_tensors(families, weight, cloud.x))
    refuse_flat(cloud, np.flatnonzero(singular), name)
    centres = families.centres
    merging = _merging(empty, distance)
    share = np.einsum("ba,bac->bc", share, merging[centres])
    share[lost[centres], 0] = 1.0
    points = ~empty
    points[lost, 0] = True
    merged, particles = cloud.counted(empty.sum(axis=1)), cloud.counted(empty.any(axis=1))
    if merged:
        few = f"{merged} sectors at {particles} particles are too flat and merged with others"
        note = "; ".join(filter(None, [note, few]))
    owner, sector, number = _numbered(points)
    stencils = with_centres(*_listed(owner, number, centres, families.neighbours, weight, share))
    # If no sector of a particle has a gradient, argmax returns the first, which has the point of the particle.
    served_by = np.take_along_axis(number, merging.argmax(axis=2), axis=1)
    return replace(operator(cloud, stencils, note), parts=Parts(sector, served_by))


def _merging(empty: Mask, distance: Float) -> Float:
    """Return ``M[i, a, c]``: the share of sector ``a`` of particle ``i`` that is added to point ``c``."""
    reach = np.where(empty[:, None, :], np.inf, distance[None])
    nearest = reach == reach.min(axis=2, keepdims=True)
    nearest &= np.isfinite(reach)
    return np.asarray(nearest / np.maximum(nearest.sum(axis=2, keepdims=True), 1))


def _numbered(points: Mask) -> tuple[GlobalIndex, GlobalIndex, GlobalIndex]:
    """Return owner and sector of the points, and the point of each sector of a particle, -1 if it has none."""
    owner, sector = np.nonzero(points)
    number = np.full(points.shape, -1, dtype=np.int64)
    number[owner, sector] = np.arange(len(owner))
    return owner, sector, number


def _listed(
    owner: GlobalIndex, number: GlobalIndex, centres: LocalIndex, neighbours: LocalIndex, weight: Float, share: Float
) -> tuple[LocalIndex, GlobalIndex, LocalIndex, Float]:
    """Return owners, pointers, members and weights of the points, sorted by owner, sector and bond."""
    bond, taken = np.nonzero(share)
    point = number[centres[bond], taken]
    order = np.argsort(point, kind="stable")
    point_ptr = starts_of(np.bincount(point, minlength=len(owner)))
    members = neighbours[bond[order]]
    return owner.astype(np.int32), point_ptr, members, weight[bond[order]] * share[bond[order], taken[order]]
