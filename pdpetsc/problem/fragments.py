"""Fragments of a body that intact bonds connect."""

from __future__ import annotations

import numpy as np

from pdpetsc.discrete.components import find_pieces
from pdpetsc.discrete.families import Families
from pdpetsc.problem.problem import Problem


def pieces_left(problem: Problem) -> tuple[int, int]:
    """Count the fragments of two or more particles that unbroken bonds connect, and the single particles.

    Counts are of the whole body, including the parts behind mirror planes.

    Notes
    -----
    Collective.
    """
    cloud, families = problem.body.cloud, problem.body.families
    if problem.bond_damage is not None:
        intact = problem.bond_damage.bonds.intact
        before = np.concatenate([[0], np.cumsum(intact)])
        families = Families(before[families.indptr], families.neighbours[intact])
    pieces = find_pieces(cloud, families)
    labels, size = np.unique(pieces, return_counts=True)
    behind = cloud.places.behind(cloud.place[families.neighbours])
    across = np.flatnonzero(behind)
    tied = np.unique(np.stack([pieces[families.centres[across]], behind[across]], axis=1), axis=0)
    parts = cloud.comm.allgather((labels, size, tied))
    found, number = np.unique(np.concatenate([part[0] for part in parts]), return_inverse=True)
    sizes = np.bincount(number.reshape(-1), np.concatenate([part[1] for part in parts]))
    # A fragment with bonds to its images forms one piece with them, and with their images in turn.
    n_mirrors = len(cloud.places.mirrors[0])
    together = {int(piece): {0} for piece in found}
    for piece, mirror in np.concatenate([part[2] for part in parts]).tolist():
        together[piece] |= {mirror ^ other for other in together[piece]}
    whole = np.array([len(together[int(piece)]) for piece in found], dtype=np.int64)
    several = sizes * whole > 1
    return int((n_mirrors // whole[several]).sum()), n_mirrors * int(np.count_nonzero(~several))
