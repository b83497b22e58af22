"""A picture of a study: every result along a parameter, and errors against seconds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from pdpetsc.output.files import replacing
from pdpetsc.studies.place import Outcome, named
from pdpetsc.studies.table import columns

# Results that are drawn against the time they take.
ERRORS = ("error", "w_error", "max_F_error")


def draw(path: Path, title: str, outcomes: Sequence[Outcome]) -> None:
    """Draw every result along the last parameter that takes several numbers, and error over seconds if there is one.

    Raises
    ------
    OutputError
        The picture cannot be written.
    """
    from matplotlib.figure import Figure

    parameters, results = columns(outcomes)
    along = next((name for name in reversed(parameters) if _varies(name, outcomes)), None)
    error = next((name for name in ERRORS if name in results), None)
    panels = max(len(results) + (error is not None), 1)
    figure = Figure(figsize=(7.0, 1.0 + 3.2 * panels), layout="constrained")
    axes = list(figure.subplots(panels, 1, squeeze=False)[:, 0])
    groups: dict[str, list[Outcome]] = {}
    for outcome in outcomes:
        rest = {name: value for name, value in outcome.parameters.items() if name != along}
        groups.setdefault(named(rest), []).append(outcome)
    for label, members in groups.items():
        for axis, name in zip(axes, results, strict=False):
            have = [one for one in members if name in one.results]
            if along is not None:
                have.sort(key=lambda one: float(one.parameters[along]))
            x = [float(one.parameters[along]) for one in have] if along is not None else list(range(len(have)))
            axis.plot(x, [one.results[name] for one in have], "o-", markersize=4, label=label)
            axis.set(xlabel=along or "run", ylabel=name)
        if error is not None:
            have = [one for one in members if error in one.results]
            seconds, errors = [one.seconds for one in have], [abs(one.results[error]) for one in have]
            axes[-1].loglog(seconds, errors, "o-", markersize=4, label=label)
            axes[-1].set(xlabel="seconds", ylabel=f"|{error}|")
    for axis in axes:
        axis.grid(alpha=0.3)
    axes[0].set_title(title)
    if len(groups) > 1:
        axes[0].legend(fontsize=7)
    with replacing(path, wait=False) as aside:
        figure.savefig(aside, dpi=130, format="png")


def _varies(name: str, outcomes: Sequence[Outcome]) -> bool:
    values = [outcome.parameters.get(name, "") for outcome in outcomes]
    return len(set(values)) > 1 and all(_is_number(value) for value in values)


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False
