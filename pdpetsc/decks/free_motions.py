"""Supports at single particles, without force, for rigid motions that a deck leaves free."""

from __future__ import annotations

import itertools

import numpy as np
import scipy

from pdpetsc.arrays import Float, Mask
from pdpetsc.decks.expressions import parse
from pdpetsc.decks.script import Given, Script, Where, table_of
from pdpetsc.errors import CaseError

# A motion is free if supports resist it by less than this share of the most resisted one, as in a run.
_FREE = 1e-12
# Loads balance if their work on a free motion is this share of the work that they could do.
_BALANCED = 1e-9


def hold_free_motions(script: Script) -> None:
    """Add supports at single particles for the rigid motions that the displacements of a deck leave free.

    Notes
    -----
    There are as many components as free motions, chosen by a pivoted QR factorisation of the motions at the
    particles. If the loads balance, the forces at these supports are zero.

    Raises
    ------
    CaseError
        The body forces of the deck do work on a free motion.
    """
    body = script.body
    modes = _modes(body.x)
    fixed = np.zeros(body.x.shape, dtype=bool)
    for given in script.given:
        if given.kind == "Displacement":
            fixed[given.where.mask, "xyz".index(given.axis)] = True
    held = np.where(fixed[:, :, None], modes, 0.0).reshape(-1, modes.shape[2])
    values, vectors = np.linalg.eigh(held.T @ held)
    free = modes @ vectors[:, values <= _FREE * max(float(values[-1]), 1e-300)]
    count = free.shape[2]
    if not count:
        return
    _refuse_unbalanced(script, free)
    candidates = np.where(fixed[:, :, None], 0.0, free).reshape(-1, count)
    _, _, order = scipy.linalg.qr(candidates.T, mode="economic", pivoting=True)
    for dof in sorted(order[:count].tolist()):
        particle, axis = divmod(int(dof), body.dim)
        mask: Mask = np.arange(len(body.x)) == particle
        where = Where(f"pd.region.Nearest({tuple(body.x[particle].tolist())!r})", mask)
        script.given.append(
            Given(
                "Displacement",
                "xyz"[axis],
                where,
                parse("0.0", "a support", set()),
                "Free in the deck, held without force",
            )
        )
    script.notes.differs(
        f"The deck leaves {count} of {modes.shape[2]} rigid motions free, which equilibrium does not determine; they "
        f"are held at single particles, so that displacements are those of {script.program} up to a rigid motion."
    )


def _modes(x: Float) -> Float:
    """Return translations and rotations about the middle at particles (n, dim, modes), lengths over the extent."""
    n, dim = x.shape
    local = (x - x.mean(axis=0)) / max(float(np.ptp(x, axis=0).max()), 1e-300)
    planes = list(itertools.combinations(range(dim), 2))
    modes = np.zeros((n, dim, dim + len(planes)))
    modes[:, range(dim), range(dim)] = 1.0
    for k, (a, b) in enumerate(planes):
        modes[:, a, dim + k], modes[:, b, dim + k] = -local[:, b], local[:, a]
    return modes


def _refuse_unbalanced(script: Script, free: Float) -> None:
    body = script.body
    for step in range(len(script.times.values)):
        force = np.zeros_like(body.x)
        for given in script.given:
            if given.kind == "BodyForce":
                value = table_of(given, body, script.times.values[step : step + 1])[0]
                force[given.where.mask, "xyz".index(given.axis)] = value
        work = np.einsum("n,na,nam->m", body.volume, force, free)
        most = np.einsum("n,na,nam->m", body.volume, np.abs(force), np.abs(free))
        if (np.abs(work) > _BALANCED * most).any():
            raise CaseError(
                f"The deck leaves {free.shape[2]} rigid motions of the body free, and its body forces do not balance "
                f"on them at time {script.times.values[step]:g}; prescribe more displacement components."
            )
