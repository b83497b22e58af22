"""What a run gives: named results, history, fields and the last solution."""

from __future__ import annotations

import base64
import html
import importlib
import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdpetsc.arrays import Float
from pdpetsc.declare.cracks import crack_of
from pdpetsc.declare.expected import Expected
from pdpetsc.errors import CaseError, RunError
from pdpetsc.output.files import InCreationOrder
from pdpetsc.output.labels import PRINCIPAL, Labels
from pdpetsc.output.picture import picture_of_run
from pdpetsc.output.reading import StoredFields, read_history, read_summary
from pdpetsc.output.scene import broken_pairs
from pdpetsc.output.surface import read_surface
from pdpetsc.output.tables import cell, table_html
from pdpetsc.post.point_location import Held, Inside, inside_of
from pdpetsc.post.sampling import sampled
from pdpetsc.post.solution import Field, Solution
from pdpetsc.running.checks import Check, compared, expected_of, failure, refuse_unchecked

# What stands for the run of a folder that was opened without fields.
NONE_YET = ""


class Result(Mapping[str, float]):
    """What a run gives: a mapping of its named results, with history, fields and summary beside them.

    ``run`` returns it, ``open`` makes it from the folder of a run that has ended; the second has no ``solution``.

    Attributes
    ----------
    folder : Path
        Folder of the run.
    history : dict of str to (n_steps,) float64
        The columns of ``history.csv``: ``step``, ``t`` [-], and the quantities of the case.
    summary : dict
        What ``summary.json`` holds: status, steps, timings, options, ...
    solution : Solution or None
        The last converged state, of the particles of this rank.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> result = pd.run(case, "out/bar")                 # doctest: +SKIP
    >>> result["elongation"], result.history["force"]    # doctest: +SKIP
    >>> pd.open("out/bar").field("stress")[:, 0, 0]      # doctest: +SKIP
    """

    def __init__(
        self, folder: Path, results: Mapping[str, float], history: Mapping[str, Any], summary: Mapping[str, Any],
        solution: Solution | None = None, run: str | None = None, expect: Mapping[str, Expected] | None = None,
    ) -> None:  # fmt: skip
        self.folder = folder
        self.history: dict[str, Float] = {name: np.asarray(values, dtype=float) for name, values in history.items()}
        self.summary = dict(summary)
        self.solution = solution
        self._results = dict(results)
        self._run = run
        self._expect = dict(expect or {})

    def __getitem__(self, name: str) -> float:
        if name not in self._results:
            raise KeyError(f"There is no result {name!r}; there are {', '.join(self._results) or 'none'}.")
        return self._results[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._results)

    def __len__(self) -> int:
        return len(self._results)

    def __repr__(self) -> str:
        named = ", ".join(f"{name}={value:.6g}" for name, value in self._results.items())
        return f"<Result of {self.folder}: {self.summary.get('status')}{f', {named}' if named else ''}>"

    @property
    def fields(self) -> StoredFields:
        """Return the fields in the folder, of all steps (not collective).

        Raises
        ------
        CaseError
            The run wrote none, or a later one has taken its folder.
        """
        stored = StoredFields(self.folder, self._run or None)
        if self._run == NONE_YET:
            raise CaseError(
                f"{self.folder} had no fields to read when its run was opened, and has some now, which may be those of "
                f"a later run; open it again."
            )
        return stored

    def field(self, name: str, step: int | None = None) -> NDArray[Any]:
        """Return a field of all particles in creation order, of the last step that has any by default (not collective).

        Vectors are (n, 3) and tensors (n, 3, 3), whatever the dimension of the body.

        Raises
        ------
        CaseError
            The run wrote no such field or step.
        """
        return self.fields.field(name, step)

    @property
    def x(self) -> Float:
        """Return the reference positions of all particles (n, 3) in creation order [length] (not collective)."""
        return np.asarray(self.fields.of_particles("position"))

    @property
    def results(self) -> dict[str, float]:
        """Return the named results."""
        return dict(self._results)

    @property
    def doubts(self) -> dict[str, str]:
        """Return which numbers of the history may be wrong though the run has ended well, and why; mostly none."""
        return {name: str(found.get("why")) for name, found in (self.summary.get("doubts") or {}).items()}

    def sample(self, points: Any, name: str = "displacement", step: int | None = None) -> Float:
        """Return a field at points, by linear fits to the nearest particles (not collective).

        Particles beyond a crack do not count: neither where the case has a crack from the start nor where the bonds
        to them are broken at the step. Where too few are left for a slope, a point has the value of its particle.

        Parameters
        ----------
        points : (m, d) array
            Where in the undeformed body [length], whatever has moved; d is the dimension of the body, or 3:
            ``np.linspace(start, end, 50)`` is a line; places along a line body may be (m,). A point on a crack
            belongs to one of its sides.
        name : str
            The field, as for ``field``.
        step : int, optional
            The step, the last one by default.

        Returns
        -------
        (m, ...) float64
            nan outside of the undeformed body. It is where the cells of its particles are, if these are equal boxes,
            also of unequal sides; else behind its surface, where the particles know it; else, of particles of which
            only the volumes are known, where discs of these volumes are and what lies between two near ones.

        Raises
        ------
        CaseError
            The run wrote no such field or step, or the points have another dimension or are not finite, or the body
            is one particle that is elsewhere; or the field is one of forces on particles, which are as large as the
            particles and have no values between them; or a crack is of a class of the case.
        """
        if Labels.of(self.summary).fields.get(name) == "force":
            raise CaseError(
                f"The field {name} of {self.folder} is a force on each particle, which depends on its volume and has "
                f"no values between particles; add those of field({name!r}) up over the particles of a region."
            )
        values = np.asarray(self.field(name, step), dtype=float)
        x, inside = self._body
        return sampled(x, values, points, inside, self._held(x[:, : len(inside.sides)], step))

    @cached_property
    def _body(self) -> tuple[Float, Inside]:
        """Return where the particles are (n, 3), and what tells which places are inside of the body."""
        stored, x = self.fields, self.x
        dim = int(self.summary.get("dimension") or max(1, int((np.ptp(x, axis=0) > 0.0).sum())))
        depth = float(self.summary.get("thickness") or 1.0) if dim < 3 else 1.0
        surface = read_surface(self.folder, stored.run)
        return x, inside_of(x[:, :dim], np.asarray(stored.of_particles("volume")), depth, surface)

    def _held(self, x: Float, step: int | None) -> Held:
        """Return which of the particles (n, dim) hold together at a step."""
        records = self.summary.get("cuts")
        if records is None:
            # Of earlier versions only the lines of a plane body are known.
            lines = self.summary.get("cracks") or []
            records = [{"kind": "Polyline", "points": line} for line in lines if len(line) > 1]
        cracks = [(record, crack_of(record)) for record in records]
        unknown = [str(record.get("kind")) for record, crack in cracks if crack is None]
        if unknown:
            raise CaseError(
                f"{self.folder} has a crack of the class {unknown[0]} of the case, which its folder does not know, so "
                f"that a value between particles may be one across the crack; take field(name) of particles."
            )
        stored = self.fields
        broken = broken_pairs(self.folder, stored.steps[-1] if step is None else step, x)
        horizon = self.summary.get("horizon")
        known = [crack for _, crack in cracks if crack is not None]
        return Held(x, known, broken, float(horizon) if horizon else np.inf)

    def frame(self) -> Any:
        """Return the history as a pandas data frame, a row a step.

        Raises
        ------
        CaseError
            pandas is not installed.
        """
        pandas = optional_module("pandas", "the history is a dictionary of arrays without it")
        return pandas.DataFrame(self.history)

    def to_pyvista(self, step: int | None = None) -> Any:
        """Return the particles as a PyVista point cloud in the undeformed body, with all fields of a step.

        Not collective. ``warp_by_vector("displacement")`` of it is the deformed body. Tensors have nine components,
        row by row.

        Parameters
        ----------
        step : int, optional
            The step, the last one by default.

        Raises
        ------
        CaseError
            PyVista is not installed, or the run wrote no fields.
        """
        pyvista = optional_module("pyvista", "fields.xdmf opens in ParaView without it")
        cloud = pyvista.PolyData(np.array(self.x))
        for name in self.fields.names(step):
            values = np.asarray(self.field(name, step))
            cloud.point_data[name] = values.reshape(len(values), -1) if values.ndim > 1 else values
        return cloud

    def check(self) -> list[Check]:
        """Compare the results with what the case expects, and return every check (not collective).

        Raises
        ------
        CheckError
            A result is not what was expected, or missing.
        CaseError
            There is nothing to compare with: the case expects nothing, or the run was opened from its folder and had
            not been checked.
        """
        expect = self._expect or expected_of(self.summary)
        refuse_unchecked(expect)
        checks = compared(expect, self._results)
        wrong = failure(checks)
        if wrong is not None:
            raise wrong
        return checks

    def to_xarray(self) -> Any:
        """Return all fields of all steps as an xarray data set (not collective).

        Dimensions are ``step``, ``particle`` and ``component``, with ``along`` for the second one of tensors, and
        ``principal`` (1, 2, 3) in place of ``component`` for principal values; coordinates are the step, its time
        ``t`` [-], the volumes, and the reference positions ``X`` [length] by particle and component. A field of the
        case that is named as one of these has ``_field`` after its name. Fields that some steps lack are left out, and
        everything is read at once.

        Raises
        ------
        CaseError
            xarray is not installed, or the run wrote no fields.
        """
        xarray = optional_module("xarray", "field(name, step) gives NumPy arrays without it")
        fields = self.fields
        shared = [name for name in fields.names() if all(name in fields.names(step) for step in fields.steps)]
        labels = Labels.of(self.summary)
        # xarray puts the units behind the words itself.
        words = replace(labels, units=None)
        axes = list("xyz")
        coordinates = {
            "step": fields.steps, "t": ("step", [fields.time(step) for step in fields.steps]),
            "X": (("particle", "component"), self.x), "volume": ("particle", fields.of_particles("volume")),
            "component": axes, "along": axes, "principal": [1, 2, 3],
        }  # fmt: skip
        taken = {*coordinates, "particle"}
        found: dict[str, Any] = {}
        for name in shared:
            if fields.is_entry(name):
                continue
            values = np.stack([fields.field(name, step) for step in fields.steps])
            first = "principal" if name in PRINCIPAL else "component"
            dims = ("step", "particle", first, "along")[: values.ndim]
            own = name
            while own in taken or (own != name and own in shared):
                own += "_field"
            taken.add(own)
            found[own] = (dims, values, {"long_name": words.field(name), "units": labels.unit_of_field(name)})
        return xarray.Dataset(found, coordinates, {"status": str(self.summary.get("status"))})

    def _repr_html_(self) -> str:
        """Return a small table and the picture, for notebooks."""
        shown = {"status": self.summary.get("status"), **self._results}
        table = table_html(["", ""], ((cell(name), cell(value, 8)) for name, value in shown.items()))
        return f"<div><b>{html.escape(str(self.folder))}</b>{table}{self._picture_html()}</div>"

    def _picture_html(self) -> str:
        """Return the picture of the run, or a sentence why there is none; empty where it has nothing to draw."""
        try:
            _ = self.fields  # of this run: a later one may have taken the folder
            data = picture_of_run(self.folder)
        except (CaseError, OSError):
            return ""
        if data is None:
            return ""
        encoded = base64.b64encode(data).decode()
        return f"<img alt='the deformed body' style='max-width:640px' src='data:image/png;base64,{encoded}'>"

    def gathered(self, field: Field) -> NDArray[Any] | None:
        """Return a field of the last solution, all particles in creation order, on rank 0; None on the others.

        Parameters
        ----------
        field : Field
            Any function of a solution that returns a row per particle, written by the run or not: ``pd.stress``.

        Raises
        ------
        CaseError
            The run was opened from its folder.

        Notes
        -----
        Collective.
        """
        if self.solution is None:
            raise CaseError("A run opened from its folder has the fields that it wrote, by name: use field(name).")
        return gathered(self.solution, field)


def named_numbers(results: Any) -> dict[str, float]:
    """Return the results that a function of a case gave as finite numbers; raises RunError if one is none."""
    try:
        named = dict(results)
    except (TypeError, ValueError):
        kind = type(results).__name__
        raise RunError(f"results must return a mapping of names to numbers, not {kind}", of_user=True) from None
    numbers = {}
    for name, value in named.items():
        if getattr(value, "ndim", 0):
            raise RunError(f"results must return numbers; {name!r} is an array of shape {value.shape}", of_user=True)
        try:
            numbers[str(name)] = number = float(value)
        except (TypeError, ValueError):
            raise RunError(f"results must return numbers; {name!r} is {type(value).__name__}", of_user=True) from None
        if not math.isfinite(number):
            raise RunError(f"results must return finite numbers; {name!r} is {number}", of_user=True)
    return numbers


def optional_module(name: str, otherwise: str) -> Any:
    """Return a module that pdpetsc does not need, where it is installed."""
    try:
        return importlib.import_module(name)
    except ImportError:
        raise CaseError(f"{name} is not installed: pip install {name}; {otherwise}.") from None


def gathered(solution: Solution, field: Field) -> NDArray[Any] | None:
    """Return a field of a solution, all particles in creation order, on rank 0; None on the others (collective)."""
    parts = [part for _, part in InCreationOrder(solution.cloud).parts_on_root(np.asarray(field(solution)))]
    return np.concatenate(parts) if parts else None


def open_run(folder: str | Path) -> Result:
    """Return what a run left in its folder, whether it converged, failed or was stopped.

    Parameters
    ----------
    folder : str or Path
        Folder of the run, as given to ``run`` or after ``-o``.

    Raises
    ------
    CaseError
        It holds no run.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> result = pd.open("out/bar")                      # doctest: +SKIP
    >>> result.summary["status"]                         # doctest: +SKIP
    'converged'
    """
    folder = Path(folder)
    # Before the rest: where another run begins meanwhile, its numbers go with no fields rather than with others.
    run = _run_of(folder)
    summary = read_summary(folder)
    try:
        results = {str(name): float(value) for name, value in dict(summary.get("results") or {}).items()}
    except (TypeError, ValueError, OverflowError) as error:
        raise CaseError(f"{folder} holds a summary.json whose results are not numbers: {error}.") from error
    history = read_history(folder) if (folder / "history.csv").exists() else {}
    return Result(folder, results, history, summary, run=run)


def _run_of(folder: Path) -> str | None:
    """Return which run the fields in a folder are of, so that those of a later one are not taken for them."""
    try:
        return StoredFields(folder).run
    except CaseError:
        return NONE_YET
