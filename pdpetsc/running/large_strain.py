"""Large displacement gradients in materials of small strain."""

from __future__ import annotations

import numpy as np

from pdpetsc.case import Case
from pdpetsc.discrete.communicator import total
from pdpetsc.output.observer import Observer, StepRecords
from pdpetsc.post.solution import deformation_gradient, local_damage
from pdpetsc.running.build import materials_of
from pdpetsc.running.turned_regions import is_of_small_strain

# A run warns if the root mean square of the displacement gradient is larger [-]. Strains of this size are off by 5 %,
# rotations of this size strain a material of small strain by 0.5 %.
LARGE = 0.1


class LargeStrain(Observer):
    """Warns of displacement gradients ``F - I`` for which a material of small strain is not meant."""

    def __init__(self, case: Case) -> None:
        self._case = case
        self._gradient = 0.0

    def judge(self) -> None:
        """Compute the root mean square of ``|F - I|`` over the undamaged particles of small strain, by volume."""
        last, case = self.observed.last, self._case
        small = np.array([is_of_small_strain(material) for _, material in case.materials])
        if not small.any():
            return
        G = deformation_gradient(last) - np.eye(last.cloud.dim)
        counted = small[materials_of(case, last.cloud).index]
        if last.problem.damage is not None:
            counted &= local_damage(last) == 0.0
        volume = np.where(counted, last.volume, 0.0)
        square, whole = total(last.cloud.comm, [float(volume @ (G**2).sum(axis=(1, 2))), float(volume.sum())])
        self._gradient = float(np.sqrt(square / whole)) if whole > 0.0 else 0.0

    def warnings(self, steps: StepRecords) -> list[str]:
        """Return a warning if the displacement gradient is large."""
        if not self._gradient > LARGE:
            return []
        return [
            f"The displacement gradient is {self._gradient:.2g} in the mean, in a material of small strain, which is "
            f"then wrong. Check the units, or use a material of finite strain, such as Hencky."
        ]
