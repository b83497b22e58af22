"""Warnings of schedules of which a run sees a part only."""

from __future__ import annotations

from pdpetsc.case import Case
from pdpetsc.declare.conditions import DrivenMotion, condition_name
from pdpetsc.declare.schedule import Table, tables_of
from pdpetsc.declare.solvers import Explicit, Implicit
from pdpetsc.declare.steps import Steps

# A peak is missed if its height over the factors at the ends of the steps exceeds this share of the largest factor.
MISSED = 0.01
# Relative difference of load parameters and factors that are equal.
SAME = 1e-9


def schedule_warnings(case: Case) -> list[str]:
    """Return the warnings about tables with peaks between the steps, or with times beyond the end of the run.

    Solvers that find the load do not follow schedules. The time steps of ``Explicit`` are not known before the run.

    Notes
    -----
    Not collective; the same on every rank.
    """
    if case.solver.finds_load:
        return []
    implicit = isinstance(case.solver, Implicit)
    steps = case.steps
    if isinstance(case.solver, Implicit) and case.solver.error is None:
        steps = Steps(case.solver.count)
    found: list[str] = []
    for number, condition in enumerate(case.conditions, 1):
        name = condition_name(condition, number)
        for table in tables_of(condition):
            warnings = [_beyond(name, table, case.duration)]
            # A prescribed velocity or acceleration is integrated over the whole step.
            if not isinstance(case.solver, Explicit) and not isinstance(condition, DrivenMotion):
                warnings.append(_missed(name, table, steps.stops(), implicit))
            found += [warning for warning in warnings if warning and warning not in found]
    return found


def _beyond(name: str, table: Table, duration: float) -> str:
    """Return the warning about factors after load parameter 1 that differ from the factor there, if there are any."""
    end, last, rounded = table(1.0), float(table.times[-1]), SAME * max(map(abs, table.factors))
    if all(t <= 1.0 or abs(f - end) <= rounded for t, f in zip(table.times, table.factors, strict=True)):
        return ""
    return (
        f"The schedule of {name} has times up to {last:.6g}, but schedules run from 0 to 1, where this table has the "
        f"factor {end:.4g}. If its times are in seconds, divide them by {last if duration == 1.0 else duration:.6g}."
    )


def _missed(name: str, table: Table, stops: list[float], implicit: bool) -> str:
    """Return the warning about a peak of a table that the ends of the steps do not show, if there is one."""
    seen = [table(t) for t in (0.0, *stops)]
    peaks = [(table(t), float(t)) for t in table.times if 0.0 <= t <= 1.0]
    if not peaks:
        return ""
    size = max(abs(value) for value, _ in peaks)
    (high, at_high), (low, at_low) = max(peaks), min(peaks)
    above, below = high - max(seen), min(seen) - low
    if max(above, below) <= MISSED * size:
        return ""
    value, at, bound = (high, at_high, f"at most {max(seen):.4g}")
    if below > above:
        value, at, bound = (low, at_low, f"at least {min(seen):.4g}")
    advice = "Take a shorter dt."
    if not implicit:
        advice = "End a step there with pd.Steps(times=...), or use pd.AdaptiveSteps, which does so."
    return (
        f"The schedule of {name} has the factor {value:.4g} at load parameter {at:.4g}, between two steps. At the "
        f"ends of all steps it is {bound}. {advice}"
    )
