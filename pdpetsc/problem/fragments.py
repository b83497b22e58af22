"""Fragments of a body that intact bonds connect."""

from __future__ import annotations

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.discrete.components import find_pieces
from pdpetsc.discrete.families import Families
from pdpetsc.problem.problem import Problem


def _intact(problem: Problem) -> Families:
    """Return the families without broken bonds."""
    families, damage = problem.body.families, problem.bond_damage
    return families if damage is None else families.chosen(damage.bonds.intact)


def fragments_of(problem: Problem, u: Float) -> tuple[list[str], Float]:
    """Return a row for each fragment of two or more particles, the largest first, and the names of the columns.

    The columns are the smallest id of its particles, their number, its volume, the components of its centre at
    displacements ``u`` (n_owned, dim) of the own particles and, of a moving body, its mass and velocity: the momentum
    over the mass. Parts behind mirror planes are not counted.

    Notes
    -----
    Collective.
    """
    body, inertia = problem.body, problem.inertia
    cloud, n = body.cloud, body.cloud.n_owned
    axes = list("xyz"[: body.dim])
    volume = cloud.volume[:n]
    columns = [np.ones(n), volume, *(volume[:, None] * (cloud.x[:n] + u)).T]
    names = ["particle", "particles", "volume", *axes]
    if inertia is not None:
        columns += [inertia.own_mass, *(inertia.own_mass[:, None] * inertia.v).T]
        names += ["mass", *(f"v{axis}" for axis in axes)]
    labels, number = np.unique(find_pieces(cloud, _intact(problem)), return_inverse=True)
    sums = np.stack([np.bincount(number, column, len(labels)) for column in columns], axis=1)
    parts = cloud.comm.allgather((labels, sums))
    found, number = np.unique(np.concatenate([part[0] for part in parts]), return_inverse=True)
    rows = np.zeros((len(found), len(columns)))
    np.add.at(rows, number.reshape(-1), np.concatenate([part[1] for part in parts]))
    rows[:, 2 : 2 + body.dim] /= rows[:, 1:2]
    if inertia is not None:
        rows[:, -body.dim :] /= rows[:, [-body.dim - 1]]
    rows = np.concatenate([found[:, None].astype(float), rows], axis=1)[rows[:, 0] > 1.0]
    return names, rows[np.lexsort((rows[:, 0], -rows[:, 1]))]


def pieces_left(problem: Problem) -> tuple[int, int]:
    """Count the fragments of two or more particles that unbroken bonds connect, and the single particles.

    Counts are of the whole body, including the parts behind mirror planes.

    Notes
    -----
    Collective.
    """
    cloud, families = problem.body.cloud, _intact(problem)
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
