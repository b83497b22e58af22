"""Bodies that overlap."""

from __future__ import annotations

import itertools

import numpy as np

from pdpetsc.arrays import Float, Mask
from pdpetsc.discrete.communicator import bounds, largest, total
from pdpetsc.kernels.winding import add_angles
from pdpetsc.problem.body import Body
from pdpetsc.problem.scales import nearest_distances

# Depth of the points behind facets that no other body may contain, in spacings: above the error of curved surfaces, and
# well below the overlap that pairs of facets do not show.
BEHIND = 0.25


def bodies_of(body: Body, facets: Mask) -> list[int]:
    """Return the numbers of the bodies that facets (n_facets,) of the surface belong to (collective)."""
    cloud = body.cloud
    if cloud.body is None:
        return [0]
    count = 1 + int(largest(cloud.comm, cloud.body, initial=0))
    found = total(cloud.comm, np.bincount(cloud.body[body.known_surface.owner[facets]], minlength=count))
    return [int(number) for number in np.flatnonzero(found)]


def shared_point(body: Body, corners: Float, one: list[int], other: list[int]) -> tuple[int, int, Float] | None:
    """Return two bodies, of one list each, that overlap, and a point inside both; None if there are none.

    The points are behind the middles of facets. A body in a hole of another one is not inside it.

    Parameters
    ----------
    corners : (n_facets, 4, 3) float64
        Corners of the facets of the surface, in turn as seen from outside [length].
    one, other : list of int
        Numbers of the bodies.

    Notes
    -----
    Collective.
    """
    cloud, surface = body.cloud, body.known_surface
    if cloud.body is None:
        return None
    number = cloud.body[surface.owner]
    depth = BEHIND * nearest_distances(body)[surface.owner] / np.linalg.norm(surface.area, axis=1)
    behind = surface.x - depth[:, None] * surface.area

    def inside(x: Float, of: int) -> Float:
        """Return the points inside a body, which mirror planes continue; the same on all ranks."""
        facets, angles = np.ascontiguousarray(corners[number == of]), np.zeros(len(x))
        for sign, to in zip(*cloud.places.mirrors, strict=True):
            add_angles(sign * x + to, facets, angles)
        return x[total(cloud.comm, angles) > 0.5]

    for first, second in sorted({(min(pair), max(pair)) for pair in itertools.product(one, other)}):
        if first == second:
            continue
        for this, that in ((first, second), (second, first)):
            low, high = bounds(cloud.comm, surface.x[number == that])
            for axis, at in cloud.places.planes.items():  # the surface ends at a mirror plane, and the body does not
                low[axis], high[axis] = min(low[axis], at), max(high[axis], at)
            x = behind[number == this]
            x = x[np.all((x > low) & (x < high), axis=1)]
            x = np.concatenate(cloud.comm.allgather(x))
            x = inside(inside(x, that), this)
            if len(x):
                return first, second, x[np.lexsort(x.T)[0]]
    return None
