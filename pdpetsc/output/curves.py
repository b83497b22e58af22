"""Curves of a run: the columns of its history, load against displacement, and the convergence of its steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.errors import CaseError
from pdpetsc.output.labels import Labels

# Largest number of points for which a curve has markers.
MARKED = 60
# Least number of panels that are arranged in two columns.
TWO_COLUMNS = 4


def history_figure(columns: Mapping[str, Float], labels: Labels, x: str = "t", y: str | None = None) -> Any:
    """Return a figure of the columns of a history against one of them, one panel per column.

    Raises
    ------
    CaseError
        There is no such column.
    """
    chosen = [y] if y else [name for name in columns if name not in ("step", "t", x)]
    for name in (x, *chosen):
        if name not in columns:
            raise CaseError(f"The history has no column {name!r}; it has {', '.join(columns)}.")
    figure, axes = panels(max(len(chosen), 1))
    for axis, name in zip(axes, chosen, strict=False):
        curve(axis, columns[x], columns[name])
        axis.set(xlabel=labels.column(x), ylabel=labels.column(name))
    return figure


def curve_figure(columns: Mapping[str, Float], labels: Labels) -> Any | None:
    """Return a figure of the first force of a history against its first length; None if either is missing."""
    force, length = labels.first_of("force"), labels.first_of("length")
    if force is None or length is None or force not in columns or length not in columns:
        return None
    figure, (axis,) = panels(1)
    curve(axis, columns[length], columns[force])
    axis.set(xlabel=labels.column(length), ylabel=labels.column(force))
    return figure


def newton_figure(summary: Mapping[str, Any]) -> Any:
    """Return a figure of the residuals in the last solve of each step, and of the numbers of iterations per step.

    Residuals are relative to forces and reactions. A step has many solves if damage is found in sweeps, as in path
    following.
    """
    figure, (axis, work) = panels(2)
    steps: Sequence[Mapping[str, Any]] = summary.get("steps", [])
    numbers = [step["step"] for step in steps]
    for name in ("newton_iterations", "linear_iterations", "sweeps"):
        counts = [step.get(name) or 0 for step in steps]
        if any(counts):
            work.plot(
                numbers, counts, "o-" if len(steps) <= MARKED else "-", markersize=3, label=name.replace("_", " ")
            )
    work.set(xlabel="step", ylabel="number in the step")
    work.grid(alpha=0.3)
    if work.get_legend_handles_labels()[0]:
        work.legend(fontsize=8)
    from matplotlib import colormaps

    for number, step in enumerate(steps):
        reference = step["reference"] or 1.0
        norms = [max(norm / reference, 1e-18) for norm in step["norms"] if norm is not None]
        colour = colormaps["viridis"](0.9 * number / max(len(steps) - 1, 1))
        axis.semilogy(range(len(norms)), norms, "o-", markersize=3, color=colour, label=f"step {step['step']}")
    axis.set(xlabel="Newton iteration", ylabel="residual / (force and reactions)")
    axis.xaxis.get_major_locator().set_params(integer=True)
    axis.grid(alpha=0.3)
    if 0 < len(steps) <= 12:
        axis.legend(fontsize=8)
    return figure


def curve(axis: Any, x: Float, y: Float, label: str | None = None) -> None:
    """Draw one column against another."""
    axis.plot(x, y, "o-" if len(x) <= MARKED else "-", markersize=3.5, linewidth=1.3, label=label)
    finite = y[np.isfinite(y)]
    if len(finite) and np.ptp(finite) <= 1e-9 * np.abs(finite).max():
        # Do not magnify round-off.
        axis.set_ylim(np.sort([0.9 * finite[0], 1.1 * finite[0]]) if finite.any() else (-1.0, 1.0))
    axis.grid(alpha=0.3)


def panels(count: int) -> tuple[Any, list[Any]]:
    """Return a figure and its axes, in two columns if there are many."""
    from matplotlib.figure import Figure

    wide = 2 if count >= TWO_COLUMNS else 1
    rows = -(-count // wide)
    figure = Figure(figsize=(6.5 * wide, 0.6 + 3.0 * rows), layout="constrained")
    axes = list(figure.subplots(rows, wide, squeeze=False).ravel())
    for spare in axes[count:]:
        spare.set_axis_off()
    return figure, axes[:count]
