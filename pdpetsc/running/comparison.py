"""Runs beside each other: a table, their histories in one figure, their fields at the same points."""

from __future__ import annotations

import html
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.errors import CaseError
from pdpetsc.output.curves import curve, panels
from pdpetsc.output.labels import Labels
from pdpetsc.output.reading import working_seconds
from pdpetsc.post.sampling import sampled
from pdpetsc.running.result import Result, open_run, optional_module


class Comparison:
    """Runs beside each other, as ``compare`` returns it.

    Attributes
    ----------
    runs : dict of str to Result
        The runs by name.

    Notes
    -----
    Not collective: it reads folders.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> both = pd.compare(["out/coarse", "out/fine"])       # doctest: +SKIP
    >>> print(both)                                         # doctest: +SKIP
    """

    def __init__(self, runs: Mapping[str, Result]) -> None:
        self.runs = dict(runs)
        self._labels = {name: Labels.of(run.summary) for name, run in self.runs.items()}
        units = {name: labels.units for name, labels in self._labels.items() if labels.units is not None}
        for name, one in units.items():
            first = next(iter(units))
            if one != units[first]:
                raise CaseError(
                    f"{first} is in {units[first].length} and {units[first].force}, {name} in {one.length} and "
                    f"{one.force}; their numbers cannot be compared."
                )

    @property
    def table(self) -> dict[str, list[Any]]:
        """Return the table by columns: run, parameters that differ, results, seconds, MiB, status.

        A result that a run lacks is None, and so is a parameter.
        """
        runs = list(self.runs.values())
        given = [dict(run.summary.get("parameters") or {}) for run in runs]
        missing = object()
        known = dict.fromkeys(name for parameters in given for name in parameters)
        differ = [name for name in known if len({repr(one.get(name, missing)) for one in given}) > 1]
        columns: dict[str, list[Any]] = {"run": list(self.runs)}
        columns |= {name: [one.get(name) for one in given] for name in differ}
        for name in dict.fromkeys(name for run in runs for name in run):
            # A result that is named as a parameter does not take its column.
            columns[f"{name} (result)" if name in columns else name] = [run.results.get(name) for run in runs]
        return columns | {
            "seconds": [working_seconds(run.summary) for run in runs],
            "MiB": [sum(run.summary.get("peak_memory_bytes") or []) / 2**20 for run in runs],
            "status": [str(run.summary.get("status")) for run in runs],
        }

    def frame(self) -> Any:
        """Return the table as a pandas data frame, a row a run.

        Raises
        ------
        CaseError
            pandas is not installed.
        """
        pandas = optional_module("pandas", "the table is a dictionary of lists without it")
        return pandas.DataFrame(self.table).set_index("run")

    def __str__(self) -> str:
        texts = {name: [_text(value) for value in column] for name, column in self.table.items()}
        widths = {name: max(map(len, [name, *column])) for name, column in texts.items()}
        rows = [list(texts), *map(list, zip(*texts.values(), strict=True))]
        return "\n".join(
            "  ".join(f"{word:>{widths[name]}}" for name, word in zip(texts, row, strict=True)) for row in rows
        )

    def __repr__(self) -> str:
        return f"<Comparison of {', '.join(self.runs)}>\n{self}"

    def _repr_html_(self) -> str:
        return table_html(self.table)

    def difference(self, field: str, t: float | None = None, points: Any = None) -> dict[str, Float]:
        """Return a field of every run less that of the first one, at the same points.

        Parameters
        ----------
        field : str
            The field, as for ``Result.field``.
        t : float, optional
            Step time [-]; the last one of each run by default, which has to be the same.
        points : (m, d) array, optional
            Where, as for ``Result.sample``; the particles of the first run by default.

        Returns
        -------
        dict of str to (m, ...) float64
            Of all runs but the first; nan at points outside of their bodies, or of that of the first.

        Raises
        ------
        CaseError
            A run has no such field, or not at this step time.
        """
        names = list(self.runs)
        steps = {name: self._step(name, t) for name in names}
        times = {name: self.runs[name].fields.time(step) for name, step in steps.items()}
        for name in names[1:]:
            if not math.isclose(times[name], times[names[0]], rel_tol=1e-9, abs_tol=1e-12):
                raise CaseError(
                    f"{names[0]} ends at step time {times[names[0]]:g} and {name} at {times[name]:g}; say at which t "
                    f"their fields are compared."
                )
        first = self.runs[names[0]]
        at = first.x if points is None else points
        values = {}
        for name in names:
            run = self.runs[name]
            found = np.asarray(run.field(field, steps[name]), dtype=float)
            own = points is None and np.array_equal(run.x, first.x)
            values[name] = found if own else sampled(run.x, found, at)
        shapes = {array.shape for array in values.values()}
        if len(shapes) > 1:
            raise CaseError(f"The field {field} has not the same components in all of {', '.join(names)}.")
        return {name: values[name] - values[names[0]] for name in names[1:]}

    def figure(self, y: str | None = None, x: str = "t") -> Any:
        """Return a figure of the columns that all histories share, against one of them, a curve a run.

        Parameters
        ----------
        y : str, optional
            One column only.
        x : str
            What they are drawn against.

        Raises
        ------
        CaseError
            A history has no such column.
        """
        histories = [run.history for run in self.runs.values()]
        shared = [name for name in histories[0] if all(name in history for history in histories)]
        for name in (x, *([y] if y else [])):
            if name not in shared:
                raise CaseError(f"The histories do not all have a column {name!r}; they share {', '.join(shared)}.")
        chosen = [y] if y else [name for name in shared if name not in ("step", "t", x)]
        labels = next(iter(self._labels.values()))
        figure, axes = panels(max(len(chosen), 1))
        for axis, name in zip(axes, chosen, strict=False):
            for run, result in self.runs.items():
                curve(axis, result.history[x], result.history[name], run)
            axis.set(xlabel=labels.column(x), ylabel=labels.column(name))
            axis.autoscale()
        axes[0].legend(fontsize=8)
        return figure

    def draw(self, path: str | Path, y: str | None = None, x: str = "t") -> Path:
        """Draw the figure into a file and return its path."""
        path = Path(path)
        self.figure(y, x).savefig(path, dpi=150)
        return path

    def _step(self, name: str, t: float | None) -> int:
        stored = self.runs[name].fields
        if t is None:
            return stored.steps[-1]
        times = [stored.time(step) for step in stored.steps]
        near = int(np.argmin(np.abs(np.array(times) - t)))
        if not math.isclose(times[near], t, rel_tol=1e-9, abs_tol=1e-12):
            known = ", ".join(f"{time:g}" for time in times[:12])
            raise CaseError(f"{name} has no fields at step time {t:g}; it has some at {known}.")
        return stored.steps[near]


def compare(runs: Mapping[str, Result | str | Path] | Sequence[Result | str | Path]) -> Comparison:
    """Return runs beside each other: a table, their histories in one figure, differences of their fields.

    Parameters
    ----------
    runs : sequence or mapping of names to Result, str or Path
        Results, or folders of runs.

    Raises
    ------
    CaseError
        A folder holds no run, there are fewer than two, or they are in different units.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> both = pd.compare(["out/coarse", "out/fine"])       # doctest: +SKIP
    >>> both.frame(), both.figure("force", x="end")         # doctest: +SKIP
    >>> both.difference("displacement")["fine"]             # doctest: +SKIP
    """
    if isinstance(runs, str | Path | Result):
        raise CaseError("compare takes several runs; put them into a list.")
    listed = list(runs.values()) if isinstance(runs, Mapping) else list(runs)
    opened = [run if isinstance(run, Result) else open_run(run) for run in listed]
    if len(opened) < 2:
        raise CaseError(f"compare takes two runs or more, not {len(opened)}.")
    names = list(map(str, runs)) if isinstance(runs, Mapping) else _names(opened)
    return Comparison(dict(zip(names, opened, strict=True)))


def _names(runs: Sequence[Result]) -> list[str]:
    """Return the names of the folders, with as much of their paths as tells them apart."""
    parts = [run.folder.resolve().parts for run in runs]
    for count in range(1, max(map(len, parts)) + 1):
        names = ["/".join(one[-count:]) for one in parts]
        if len(set(names)) == len(names):
            return names
    raise CaseError(f"{runs[0].folder} is given twice; a run cannot be compared with itself.")


def table_html(columns: Mapping[str, Sequence[Any]]) -> str:
    """Return a table by columns as HTML."""
    head = "".join(f"<th>{html.escape(name)}</th>" for name in columns)
    rows = zip(*columns.values(), strict=True)
    body = "".join(f"<tr>{''.join(f'<td>{html.escape(_text(value))}</td>' for value in row)}</tr>" for row in rows)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _text(value: Any) -> str:
    if value is None:
        return ""
    return f"{value:.6g}" if isinstance(value, float) else str(value)
