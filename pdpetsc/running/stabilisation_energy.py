"""The share of the zero-energy control in the energy of a body."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

from pdpetsc.output.observer import Observer, StepRecords
from pdpetsc.post.solution import Solution
from pdpetsc.solvers.protocol import Converged

# A run warns if the control stores more than the first share of the energy. Steps with less energy than the second
# share of the largest are ignored: the energy of a separated body is round-off.
MUCH, LITTLE = 0.2, 0.01


class StabilisationEnergy(Observer):
    """Records the energies of each step, and warns if the control stores a large share."""

    def step(self, solution: Solution, converged: Converged) -> Mapping[str, Any]:
        return {"energies": solution.energies}

    def summary(self, steps: StepRecords) -> Mapping[str, Any]:
        return {"control": largest_share(steps)}

    def warnings(self, steps: StepRecords) -> list[str]:
        return [note] if (note := largest_share(steps)["note"]) else []


def largest_share(steps: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the largest share of the control in the energy of a run, with its load parameter and a warning.

    Parameters
    ----------
    steps : iterable of mapping
        Step time ``t`` and ``energies`` of each step, with the energy of the material as ``strain`` and that of the
        control as ``control`` [energy]. Steps without energies are ignored.

    Returns
    -------
    dict
        ``share`` [-], ``t`` and ``note``, which is empty if the control stores little.
    """
    stored = []
    for step in steps:
        control, strain = (step.get("energies", {}).get(name, math.nan) for name in ("control", "strain"))
        if math.isfinite(control + strain):
            stored.append((control, control + strain, step["t"]))
    most = max((whole for _, whole, _ in stored), default=0.0)
    shares = [(control / whole, t) for control, whole, t in stored if whole > LITTLE * most]
    share, t = max(shares, default=(0.0, 0.0))
    if share <= MUCH:
        return {"share": share, "t": t, "note": ""}
    note = (
        f"The zero-energy control stores {100.0 * share:.0f} % of the energy at step time {t:.6g}: displacements "
        "depend on its coefficient. Use a smaller one, SubHorizons, or TangentScaled for plasticity."
    )
    return {"share": share, "t": t, "note": note}
