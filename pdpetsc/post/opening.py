"""The opening of a crack: the jump of the displacement across a line."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy

from pdpetsc.arrays import Float
from pdpetsc.discrete.communicator import all_largest
from pdpetsc.errors import CaseError
from pdpetsc.post.contour import Frame, frames
from pdpetsc.post.quantities import Quantity
from pdpetsc.post.solution import Solution

# The displacement at a face is fitted to the particles on its side within so many horizons.
AROUND = 1.25
# Fits with moments nearer to singular than this are refused.
EXTENT = 1e-3


@dataclass(frozen=True)
class CrackOpening(Quantity):
    """Jump of the displacement across a crack line in a plane body [length].

    On each side a linear function is fitted to the displacements of the particles within 1.25 horizons of the point,
    with larger weights for nearer ones, and evaluated at the point. It is exact for linear fields on both sides. Of
    several bodies each side is that of the nearest particle.
    Without a crack the jump is the difference of the fits, which vanishes with the curvature of the field. Images
    behind mirror planes are included.

    Parameters
    ----------
    start, end : (float, float)
        Ends of the line in the undeformed body [length].
    at : float
        Position on the line, 0 at the start and 1 at the end [-].
    component : {"normal", "along"}
        The jump along the normal, which points to the left of the direction from start to end, positive for opening; or
        along the line, positive if the left side moves towards the end.

    Raises
    ------
    CaseError
        The line has no length. In a body: too few particles are on one side of the point.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> mouth = pd.CrackOpening((0.0, 5.0), (4.0, 5.0), at=0.1)
    >>> s, jump = mouth.profile(result.solution, points=20)          # doctest: +SKIP
    """

    dimension = "length"

    start: Sequence[float]
    end: Sequence[float]
    at: float = 0.5
    component: Literal["normal", "along"] = "normal"

    def __post_init__(self) -> None:
        super().__post_init__()
        for given in (self.start, self.end):
            if len(given) != 2 or not all(math.isfinite(one) for one in given):
                raise CaseError(f"A CrackOpening is of a plane body and takes points of two numbers, not {given}.")
        if not 0.0 < math.dist(self.start, self.end) < math.inf:
            raise CaseError("A CrackOpening needs two different ends.")
        if not 0.0 <= self.at <= 1.0:
            raise CaseError(f"A CrackOpening is at a share of its line from 0 to 1, not {self.at}.")

    def check(self, dim: int) -> None:
        """Raise CaseError if the body is not plane."""
        if dim != 2:
            raise CaseError(f"A CrackOpening is of a crack in a plane body; this one has {dim} dimensions.")

    def evaluate(self, solution: Solution) -> float:
        """Return the jump at the point."""
        self.check(solution.problem.dim)
        along, normal = self._jumps(solution, np.array([self.at]))[0]
        return float(normal if self.component == "normal" else along)

    def profile(self, solution: Solution, points: int = 50) -> tuple[Float, Float]:
        """Return the opening along the whole line.

        Parameters
        ----------
        solution : Solution
            A state, such as ``Result.solution``.
        points : int
            Number of points, in the middles of equal parts.

        Returns
        -------
        s : (points,) float64
            Their distances from the start [length].
        jump : (points, 2) float64
            Along the normal and along the line [length].

        Notes
        -----
        Collective; equal on all ranks.
        """
        self.check(solution.problem.dim)
        share = (np.arange(points) + 0.5) / points
        return share * math.dist(self.start, self.end), self._jumps(solution, share)[:, ::-1]

    def _jumps(self, solution: Solution, share: Float) -> Float:
        """Return the jumps along the line and its normal (n, 2) at shares of its length (collective)."""
        start, end = (np.asarray(one, dtype=float) for one in (self.start, self.end))
        cloud = solution.cloud
        bodies = np.zeros(len(solution.x), dtype=np.int64) if cloud.body is None else cloud.body[: len(solution.x)]
        shape = len(share), 1 + int(solution.largest(bodies, 0.0)), 2
        moments, sums, nearest = np.zeros((*shape, 3, 3)), np.zeros((*shape, 3, 2)), np.full(shape, np.inf)
        radius = AROUND * cloud.horizon
        tree = scipy.spatial.cKDTree(solution.x) if len(solution.x) else None
        for number, place in enumerate(start + share[:, None] * (end - start)):
            for frame in frames(cloud, place, (end - start).tolist()):
                if tree is not None:
                    near = np.array(sorted(tree.query_ball_point(frame.tip, radius)), dtype=np.int64)
                    for body in np.unique(bodies[near]):
                        part, to = near[bodies[near] == body], (number, body)
                        _add(frame, solution.x[part], solution.u[part], radius, moments[to], sums[to], nearest[to])
        # Each side is that of the nearest particle, in one body.
        chosen = (-all_largest(cloud.comm, -nearest)).argmin(axis=1)[:, None, :, None, None]
        moments, sums = (np.take_along_axis(solution.sum(each), chosen, axis=1)[:, 0] for each in (moments, sums))
        weight = np.maximum(moments[:, :, :1, :1], np.finfo(float).tiny)
        least = np.linalg.eigvalsh(moments / weight)[:, :, 0]
        if np.any(least < EXTENT):
            first = int(np.flatnonzero(least.min(axis=1) < EXTENT)[0])
            place = start + share[first] * (end - start)
            raise CaseError(
                f"A CrackOpening at {tuple(place.tolist())} has too few particles on one side within {radius:g}; keep "
                f"the line inside the body."
            )
        at_faces = np.linalg.solve(moments, sums)[:, :, 0]
        return np.asarray(at_faces[:, 0] - at_faces[:, 1])


def _add(frame: Frame, x: Float, u: Float, radius: float, moments: Float, sums: Float, nearest: Float) -> None:
    """Add moments, sums and smallest distances of particles to the left (0) and to the right (1) of a point."""
    at, moved = frame.at(x) / radius, u @ frame.turn.T
    w = np.maximum(1.0 - (at**2).sum(axis=1), 0.0) ** 2
    phi = np.concatenate([np.ones((len(at), 1)), at], axis=1)
    for side, here in enumerate((at[:, 1] > 0.0, at[:, 1] < 0.0)):
        weighted = (w * here)[:, None] * phi
        moments[side] += weighted.T @ phi
        sums[side] += weighted.T @ moved
        nearest[side] = np.linalg.norm(at[here], axis=1).min(initial=nearest[side])
