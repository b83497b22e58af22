"""Whether bonds still hold a body together."""

from __future__ import annotations

import numpy as np

from pdpetsc.discrete.components import find_pieces
from pdpetsc.discrete.families import Families
from pdpetsc.problem.problem import Problem


def pieces_left(problem: Problem) -> tuple[int, int]:
    """Return how many pieces of two particles or more the bonds that are not broken hold together, and lone particles.

    Notes
    -----
    Collective.
    """
    cloud, families = problem.body.cloud, problem.body.families
    if problem.damage is not None:
        intact = problem.damage.bonds.intact
        before = np.concatenate([[0], np.cumsum(intact)])
        families = Families(before[families.indptr], families.neighbours[intact])
    labels, size = np.unique(find_pieces(cloud, families), return_counts=True)
    parts = cloud.comm.allgather((labels, size))
    _, number = np.unique(np.concatenate([part[0] for part in parts]), return_inverse=True)
    sizes = np.bincount(number.reshape(-1), np.concatenate([part[1] for part in parts]))
    return int(np.count_nonzero(sizes > 1)), int(np.count_nonzero(sizes == 1))
