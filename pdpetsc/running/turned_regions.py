"""Rigid regions that turn in a body of small strain."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pdpetsc.bond_based import BondMaterial
from pdpetsc.case import AnyMaterial, Case, ungraded
from pdpetsc.declare.supports import RigidRegion
from pdpetsc.output.observer import Observer, StepRecords
from pdpetsc.post.solution import Solution
from pdpetsc.problem.rigid_inertia import rotation_vector
from pdpetsc.solvers.protocol import Converged

# A run warns if a region has turned by more than this angle [rad]. The moment of a region deeper than a horizon is then
# off by 1 %, at three times the angle by 7 %.
TURNED = 0.01


class TurnedRegions(Observer):
    """Warns of rigid regions that have turned, if a material resists rotations."""

    def __init__(self, case: Case) -> None:
        self._regions = [condition for condition in case.conditions if isinstance(condition, RigidRegion)]
        self._resists = resists_rotation(case)

    def step(self, solution: Solution, converged: Converged) -> Mapping[str, Any]:
        """Return the largest angle of a region [rad]."""
        if not self._regions or not self._resists:
            return {}
        bodies = [rigid for _, rigid in solution.problem.rigid_bodies if rigid.rows is not None]
        angles = [region.angle(0.0, converged.t) for region in self._regions]
        angles += [float(np.linalg.norm(rotation_vector(rigid.motion(converged.t)[0]))) for rigid in bodies]
        return {"turned": max(angles)}

    def warnings(self, steps: StepRecords) -> list[str]:
        """Return a warning if a region has turned too far."""
        angle = max((step.get("turned", 0.0) for step in steps), default=0.0)
        if angle <= TURNED:
            return []
        return [
            f"A rigid region turned by {angle:.2g} rad, and a material of small strain resists rotations: the moment "
            f"of a region deeper than a horizon is wrong. Use a material for large rotations, such as Hencky."
        ]


def resists_rotation(case: Case) -> bool:
    """Return True if a material of the case is one of small strain."""
    return any(is_of_small_strain(material) for _, material in case.materials)


def is_of_small_strain(material: AnyMaterial) -> bool:
    """Return True if the stress of a material is that of small strain."""
    law = ungraded(material)
    return law.kinematics == "small" if isinstance(law, BondMaterial) else law.small_strain
