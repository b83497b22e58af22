"""What is prescribed along a path instead of the load."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.discrete.communicator import Comm, total
from pdpetsc.discrete.selection import select
from pdpetsc.errors import CaseError
from pdpetsc.problem.body import Body
from pdpetsc.scene.solver import Opening


@dataclass(frozen=True)
class Constraint:
    """``of . (u - u0) + share (load - load0)`` grows by a given amount.

    Attributes
    ----------
    of : (n_rows, dim) float64
        Weights of the unknowns.
    share : float
        Weight of the load factor.
    u0, load0
        Where the step begins.
    """

    of: Float
    share: float
    u0: Float
    load0: float

    def grown(self, comm: Comm, u: Float, load: float) -> float:
        """Return by how much it has grown (collective)."""
        return float(total(comm, float((self.of * (u - self.u0)).sum()))) + self.share * (load - self.load0)


def opening_weights(body: Body, control: Opening) -> Float:
    """Return the weights (n_rows, dim) of the unknowns in the opening (collective)."""
    cloud = body.cloud
    axis = "xyz".index(control.component)
    if axis >= body.dim:
        raise CaseError(f"The Opening of a {body.dim}-dimensional body has no component {control.component}.")
    weights = np.zeros((cloud.n_rows, body.dim))
    for sign, region in ((1.0, control.region), (-1.0, control.against)):
        if region is not None:
            share = np.where(select(cloud, region, "the Opening"), cloud.volume[: cloud.n_owned], 0.0)
            weights[: cloud.n_owned, axis] += sign * share / float(total(cloud.comm, float(share.sum())))
    return weights
