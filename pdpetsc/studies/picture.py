"""A picture of a study: every result along a parameter, and errors against seconds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from pdpetsc.output.files import replacing
from pdpetsc.running.comparison import results_figure
from pdpetsc.studies.run_store import Outcome
from pdpetsc.studies.table import columns


def draw(path: Path, title: str, outcomes: Sequence[Outcome]) -> None:
    """Draw every result along the last parameter that takes several numbers, and error over seconds if there is one.

    Raises
    ------
    OutputError
        The picture cannot be written.
    """
    along = next((name for name in reversed(columns(outcomes)[0]) if _varies(name, outcomes)), None)
    figure = results_figure(outcomes, along, title)
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
