"""Comparison of runs: a table, their histories in one figure, differences of fields at the same points."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.errors import CaseError
from pdpetsc.output.curves import curve, panels
from pdpetsc.output.labels import Labels
from pdpetsc.output.tables import aligned, cell, table_html, text_of
from pdpetsc.running.result import Result, open_run, optional_module

# Phases in the time of a run: without the start of Python, the compilation of kernels and the output.
PHASES = ("particles", "families", "model", "pattern", "allocation", "solve")
# Results that are drawn against time.
ERRORS = ("error", "w_error", "max_F_error")


class Ran(Protocol):
    """A run in the figure: its parameters, named results and seconds."""

    @property
    def parameters(self) -> Mapping[str, Any]:
        """Return its parameters that differ from other runs."""

    @property
    def results(self) -> Mapping[str, float]:
        """Return its named results."""

    @property
    def seconds(self) -> float:
        """Return the seconds of set-up and solve."""


def working_seconds(summary: Mapping[str, Any]) -> float:
    """Return the seconds of set-up and solve of a run from its ``summary.json``."""
    return sum(float(value) for phase, value in (summary.get("timings") or {}).items() if phase in PHASES)


def mebibytes(summary: Mapping[str, Any]) -> float:
    """Return the peak memory of all ranks of a run from its ``summary.json`` [MiB]."""
    return float(sum(summary.get("peak_memory_bytes") or [])) / 2**20


def names_of_results(done: Sequence[Ran | Result]) -> list[str]:
    """Return the names of the results of all runs, each once."""
    return list(dict.fromkeys(name for outcome in done for name in outcome.results))


def columns_of(
    first: Mapping[str, list[Any]], parameters: Sequence[Mapping[str, Any]], results: Sequence[Mapping[str, float]],
    last: Mapping[str, list[Any]],
) -> dict[str, list[Any]]:  # fmt: skip
    """Return a table of runs by columns: the first, parameters, results (None if missing), the last.

    Parameters named as another column get the suffix `` (parameter)``, results `` (result)``.
    """
    columns = dict(first)
    for kind, each in (("parameter", parameters), ("result", results)):
        for name in dict.fromkeys(name for one in each for name in one):
            columns[_unused(name, kind, [*columns, *last])] = [one.get(name) for one in each]
    return {**columns, **last}


def _unused(name: str, kind: str, taken: Sequence[str]) -> str:
    """Return a unique name for a column."""
    while name in taken:
        name = f"{name} ({kind})"
    return name


def results_figure(done: Sequence[Ran], along: str | None, title: str = "") -> Any:
    """Return a figure of every result against a parameter, and of errors against seconds.

    Parameters
    ----------
    along : str or None
        A numeric parameter; if None, the number of the run.
    """
    names = names_of_results(done)
    error = next((name for name in ERRORS if name in names), None)
    figure, axes = panels(max(len(names) + (error is not None), 1))
    groups: dict[str, list[Ran]] = {}
    for outcome in done:
        rest = {name: value for name, value in outcome.parameters.items() if name != along}
        groups.setdefault(",".join(f"{name}={value}" for name, value in rest.items()), []).append(outcome)
    for label, outcomes in groups.items():
        for axis, name in zip(axes, names, strict=False):
            have = [outcome for outcome in outcomes if name in outcome.results]
            if along:
                have.sort(key=lambda one: float(one.parameters[along]))
            x = [float(one.parameters[along]) for one in have] if along else list(range(len(have)))
            axis.plot(x, [one.results[name] for one in have], "o-", markersize=4, label=label)
            axis.set(xlabel=along or "run", ylabel=name)
        if error is not None:
            have = [outcome for outcome in outcomes if error in outcome.results]
            errors = [abs(one.results[error]) for one in have]
            axes[-1].loglog([one.seconds for one in have], errors, "o-", markersize=4, label=label)
            axes[-1].set(xlabel="seconds", ylabel=f"|{error}|")
    for axis in axes:
        axis.grid(alpha=0.3)
    axes[0].set_title(title)
    if len(groups) > 1:
        axes[0].legend(fontsize=7)
    return figure


class Comparison:
    """A comparison of runs, returned by ``compare``.

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
        _refuse_apart("is in", {name: f"{one.length} and {one.force}" for name, one in units.items()})
        # Runs without temperatures may omit its unit.
        _refuse_apart("has temperatures in", {name: one.temperature for name, one in units.items() if one.temperature})

    @property
    def table(self) -> dict[str, list[Any]]:
        """Return the table by columns: run, parameters that differ, results (None if missing), costs, status.

        Parameters named as another column get the suffix `` (parameter)``, results `` (result)``.
        """
        runs, missing = list(self.runs.values()), object()
        given = [dict(run.summary.get("parameters") or {}) for run in runs]
        differ = {name for one in given for name in one if len({repr(other.get(name, missing)) for other in given}) > 1}
        last: dict[str, list[Any]] = {
            "seconds": [working_seconds(run.summary) for run in runs],
            "MiB": [mebibytes(run.summary) for run in runs],
            "status": [str(run.summary.get("status")) for run in runs],
        }
        parameters = [{name: value for name, value in one.items() if name in differ} for one in given]
        return columns_of({"run": list(self.runs)}, parameters, [run.results for run in runs], last)

    def frame(self) -> Any:
        """Return the table as a pandas data frame, one row per run.

        Raises
        ------
        CaseError
            pandas is not installed.
        """
        pandas = optional_module("pandas", "the table is a dictionary of lists without it")
        return pandas.DataFrame(self.table).set_index("run")

    def __str__(self) -> str:
        table = self.table
        return "\n".join(
            aligned([list(table), *(list(map(text_of, row)) for row in zip(*table.values(), strict=True))])
        )

    def __repr__(self) -> str:
        return f"<Comparison of {', '.join(self.runs)}>\n{self}"

    def _repr_html_(self) -> str:
        table = self.table
        return table_html(list(table), (list(map(cell, row)) for row in zip(*table.values(), strict=True)))

    def difference(self, field: str, t: float | None = None, points: Any = None) -> dict[str, Float]:
        """Return the difference between a field of every run and of the first run, at the same points.

        Parameters
        ----------
        field : str
            The field, as for ``Result.field``.
        t : float, optional
            Load parameter [-]; by default the last one of each run, which must be equal.
        points : (m, d) array, optional
            Points, as for ``Result.sample``; by default the particles of the first run, each in its body if the runs
            have as many bodies.

        Returns
        -------
        dict of str to (m, ...) float64
            Differences of all runs but the first; nan at points outside of one of both bodies.

        Raises
        ------
        CaseError
            A run does not have the field, not at this load parameter, or at several steps with this load factor, as
            along a path; or the field has forces of particles, and the particles of the runs differ or ``points`` are
            given.
        """
        names = list(self.runs)
        steps = {name: self._step(name, t) for name in names}
        times = {name: self.runs[name].fields.time(step) for name, step in steps.items()}
        for name in names[1:]:
            if not math.isclose(times[name], times[names[0]], rel_tol=1e-9, abs_tol=1e-12):
                raise CaseError(
                    f"{names[0]} ends at step time {times[names[0]]:g}, {name} at {times[name]:g}. Give the step time "
                    "t of the comparison."
                )
        first = self.runs[names[0]]
        values = {}
        for name in names:
            run = self.runs[name]
            if points is None and np.array_equal(run.x, first.x):
                values[name] = np.asarray(run.field(field, steps[name]), dtype=float)
            elif points is None:
                # Particles on a surface where bodies touch belong to one of them.
                own, other = first.fields.body, run.fields.body
                bodies = own if own.max() == other.max() else None
                values[name] = run.sample(first.x, field, steps[name], bodies)
            else:
                values[name] = run.sample(points, field, steps[name])
        shapes = {array.shape for array in values.values()}
        if len(shapes) > 1:
            raise CaseError(f"The field {field} has not the same components in all of {', '.join(names)}.")
        return {name: values[name] - values[names[0]] for name in names[1:]}

    def figure(self, y: str | None = None, x: str = "t") -> Any:
        """Return a figure of the columns that all histories share, against one of them, one curve per run.

        Parameters
        ----------
        y : str, optional
            A single column.
        x : str
            Column of the horizontal axis.

        Raises
        ------
        CaseError
            A history does not have the column.
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
        there = [
            step
            for step, time in zip(stored.steps, times, strict=True)
            if math.isclose(time, times[near], rel_tol=1e-9)
        ]
        if len(there) > 1:
            raise CaseError(
                f"{name} has step time {t:g} in steps {', '.join(map(str, there[:12]))}. Compare field(name, step) "
                "instead."
            )
        return stored.steps[near]


def compare(runs: Mapping[str, Result | str | Path] | Sequence[Result | str | Path]) -> Comparison:
    """Compare runs: a table, their histories in one figure, differences of their fields.

    Parameters
    ----------
    runs : sequence or mapping of names to Result, str or Path
        Results, or folders of runs.

    Raises
    ------
    CaseError
        A folder has no run, there are fewer than two runs, or their units differ.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> both = pd.compare(["out/coarse", "out/fine"])       # doctest: +SKIP
    >>> both.frame(), both.figure("force", x="end")         # doctest: +SKIP
    >>> both.difference("displacement")["fine"]             # doctest: +SKIP
    """
    if isinstance(runs, str | Path | Result):
        raise CaseError("compare requires a list of runs, as compare([run, run]).")
    named = runs if isinstance(runs, Mapping) else dict(enumerate(runs))
    opened = {str(name): run if isinstance(run, Result) else open_run(run) for name, run in named.items()}
    if len(opened) < 2:
        raise CaseError(f"compare requires at least two runs, not {len(opened)}.")
    if named is not runs:
        opened = dict(zip(_names(list(opened.values())), opened.values(), strict=True))
    return Comparison(opened)


def _names(runs: Sequence[Result]) -> list[str]:
    """Return the names of the folders, with enough of their paths to be unique."""
    parts = [run.folder.resolve().parts for run in runs]
    for count in range(1, max(map(len, parts)) + 1):
        names = ["/".join(one[-count:]) for one in parts]
        if len(set(names)) == len(names):
            return names
    raise CaseError(f"{runs[0].folder} is given twice. Compare two different runs.")


def _refuse_apart(what: str, units: Mapping[str, str]) -> None:
    """Raise CaseError if the unit of a run differs from that of the first."""
    first = next(iter(units), "")
    for name, unit in units.items():
        if unit != units[first]:
            raise CaseError(
                f"{first} {what} {units[first]}, {name} {what} {unit}. Runs with different units cannot be compared."
            )
