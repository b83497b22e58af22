"""A small change of displacements that no symmetry of a body leaves alone, which chooses between equal branches."""

from __future__ import annotations

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.communicator import largest, smallest

# Share by which displacements change at most: far more than round-off, and less than a solve leaves open.
SHARE = 1e-8
# How much each axis counts: no two alike, so that no mirror image or quarter turn has the same sum.
AXES = (1.0, 0.61, 0.37)


class Tilt:
    """Multiplies displacements with ``1 + SHARE sum_a c_a (x_a - m_a) / l_a``, m the middle and l the size of the body.

    Where an equilibrium is unstable, several others may lie equally near, as those in which one or the other of two
    ligaments breaks. Round-off would choose, differently on another processor or rank count. This change is larger and
    grows in its place.

    Parameters
    ----------
    cloud : Cloud
        Particles of this rank.

    Notes
    -----
    Construction is collective, the call is not.
    """

    def __init__(self, cloud: Cloud) -> None:
        x, comm = cloud.x[: cloud.n_owned], cloud.comm
        self._by = np.ones((cloud.n_rows, 1))
        for axis in range(cloud.dim):
            low = smallest(comm, float(x[:, axis].min(initial=np.inf)))
            high = largest(comm, float(x[:, axis].max(initial=-np.inf)))
            if high > low:
                self._by[: len(x), 0] += SHARE * AXES[axis] * (x[:, axis] - 0.5 * (low + high)) / (high - low)

    def __call__(self, u: Float) -> Float:
        """Return displacements (n_rows, dim), changed."""
        return np.asarray(u * self._by)
