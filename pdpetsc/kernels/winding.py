"""Winding number of a closed surface about points."""

from __future__ import annotations

import numpy as np

from pdpetsc.kernels.compile import compiled


@compiled
def add_angles(x, corners, angles):
    """Add the angles at which points see facets: over all facets of a closed surface, a whole turn from inside, else 0.

    Parameters
    ----------
    x : (n, dim) float64
        Points of the plane or of space [length].
    corners : (n_facets, 4, 3) float64
        Corners of the facets in turn as seen from outside [length]; in the plane the first two are the ends.
    angles : (n,) float64
        Angles over a whole turn or sphere are added here [-]; negative for facets seen from outside.

    References
    ----------
    vanOosterom1983, eq. (8).
    """
    r, size = np.empty((4, 3)), np.empty(4)
    plane = x.shape[1] == 2
    for k in range(x.shape[0]):
        turn = 0.0
        for f in range(corners.shape[0]):
            if plane:
                ax, ay = corners[f, 0, 0] - x[k, 0], corners[f, 0, 1] - x[k, 1]
                bx, by = corners[f, 1, 0] - x[k, 0], corners[f, 1, 1] - x[k, 1]
                turn += np.arctan2(ax * by - ay * bx, ax * bx + ay * by) / (2.0 * np.pi)
                continue
            for c in range(4):
                total = 0.0
                for m in range(3):
                    r[c, m] = corners[f, c, m] - x[k, m]
                    total += r[c, m] ** 2
                size[c] = np.sqrt(total)
            for b in (1, 2):
                c = b + 1
                volume = (
                    r[0, 0] * (r[b, 1] * r[c, 2] - r[b, 2] * r[c, 1])
                    + r[0, 1] * (r[b, 2] * r[c, 0] - r[b, 0] * r[c, 2])
                    + r[0, 2] * (r[b, 0] * r[c, 1] - r[b, 1] * r[c, 0])
                )
                below = size[0] * size[b] * size[c]
                for m in range(3):
                    below += r[0, m] * r[b, m] * size[c] + r[0, m] * r[c, m] * size[b] + r[b, m] * r[c, m] * size[0]
                turn += np.arctan2(volume, below) / (2.0 * np.pi)
        angles[k] += turn
