"""Results of a run: named results, history, fields and the last solution."""

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

import h5py
import numpy as np
from numpy.typing import NDArray

from pdpetsc.arrays import Float, GlobalIndex
from pdpetsc.declare.cracks import crack_of
from pdpetsc.declare.expected import Expected
from pdpetsc.declared import ByName, near_or_all
from pdpetsc.errors import CaseError, RunError
from pdpetsc.output.files import InCreationOrder
from pdpetsc.output.labels import PRINCIPAL, Labels
from pdpetsc.output.picture import picture_of_run
from pdpetsc.output.reading import StoredFields, crack_records, read_history, read_summary
from pdpetsc.output.scene import broken_pairs, grid_of
from pdpetsc.output.surface import read_surface
from pdpetsc.output.tables import cell, table_html
from pdpetsc.post.point_location import Held, Inside, inside_of
from pdpetsc.post.sampling import rows_of_points, sampled
from pdpetsc.post.solution import Field, Solution
from pdpetsc.running.checks import Check, compared, expected_of, failure, refuse_unchecked

# Identifier of the run of a folder without fields.
NONE_YET = ""


class Result(Mapping[str, float]):
    """The results of a run: a mapping of its named results, with history, fields and summary.

    ``run`` returns it; ``open`` reads it from the folder of a finished run, without ``solution``.

    Attributes
    ----------
    folder : Path
        Folder of the run.
    history : dict of str to (n_steps,) float64
        The columns of ``history.csv``: ``step``, ``t`` [-], and the quantities of the case.
    summary : dict
        Contents of ``summary.json``: status, steps, timings, options, ...
    solution : Solution or None
        The last converged state, for the particles of this rank.

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
        columns = {name: np.asarray(values, dtype=float) for name, values in history.items()}
        self.history: dict[str, Float] = ByName("history", columns)
        self.summary = dict(summary)
        self.solution = solution
        self._results = dict(results)
        self._run = run
        self._expect = dict(expect or {})

    def __getitem__(self, name: str) -> float:
        if name not in self._results:
            raise KeyError(f"The run has no result {name!r}; {near_or_all(name, self._results)}")
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
            The run wrote no fields, or a later run uses its folder.
        """
        stored = StoredFields(self.folder, self._run or None)
        if self._run == NONE_YET:
            raise CaseError(
                f"{self.folder} had no fields when this run was opened, but has fields now, maybe of a later run. Open "
                "the folder again."
            )
        return stored

    def field(self, name: str, step: int | None = None) -> NDArray[Any]:
        """Return a field of all particles in creation order; by default of the last written step (not collective).

        Vectors are (n, 3) and tensors (n, 3, 3) in every dimension of the body.

        Raises
        ------
        CaseError
            The run did not write the field or step.
        """
        return self.fields.field(name, step)

    @property
    def x(self) -> Float:
        """Return the reference positions of all particles (n, 3) in creation order [length] (not collective)."""
        return np.asarray(self.fields.of_particles("position"))

    def mode(self, number: int) -> Float:
        """Return the shape of a mode of ``Case.modes`` (n, dim), counted from 1, in creation order (not collective).

        Shapes of frequencies have the modal mass 1; the largest component of shapes of buckling is 1.

        Raises
        ------
        CaseError
            The run did not compute it.
        """
        path = self.folder / "modes.h5"
        count = len((self.summary.get("modes") or {}).get("values", ()))
        if not 1 <= number <= count:
            raise CaseError(f"{self.folder} has {count} modes, and no mode {number}.")
        with h5py.File(path, "r") as file:
            return np.asarray(file["shape"][number - 1], dtype=float)

    @property
    def results(self) -> dict[str, float]:
        """Return the named results."""
        return dict(self._results)

    @property
    def doubts(self) -> dict[str, str]:
        """Return the numbers of the history that may be wrong although the run converged, with the reasons."""
        return {name: str(found.get("why")) for name, found in (self.summary.get("doubts") or {}).items()}

    def sample(
        self, points: Any, name: str = "displacement", step: int | None = None, bodies: GlobalIndex | None = None
    ) -> Float:
        """Return a field at points, by linear fits to the nearest particles (not collective).

        Particles of other bodies, beyond a pre-crack or behind broken bonds are excluded from the fit. If too few
        remain for a slope, a point has the value of its particle. A point on two bodies has the value of the first.

        Parameters
        ----------
        points : (m, d) array
            Positions in the undeformed body [length]; d is the dimension of the body, or 3. ``np.linspace(start, end,
            50)`` is a line; positions along a line body may be (m,). A point on a crack belongs to one of its sides.
        name : str
            The field, as for ``field``.
        step : int, optional
            The step; by default the last one.
        bodies : (m,) int64, optional
            The body of each point, counted from 0 in the order of ``pd.Bodies``; outside of it the value is nan.

        Returns
        -------
        (m, ...) float64
            nan outside of the undeformed body. The body is the union of the cells of its particles if these are equal
            boxes; otherwise the interior of its surface, if known; otherwise the union of discs with the volumes of the
            particles, and of the space between near ones.

        Raises
        ------
        CaseError
            The run did not write the field or step; the points have a wrong dimension, are not finite, or are not at
            the position of a single particle; the field has forces of particles, which have no values between them; or
            a crack has a class of the case.
        """
        if Labels.of(self.summary).fields.get(name) == "force":
            raise CaseError(
                f"The field {name} of {self.folder} is a force per particle and has no values between particles. Sum "
                f"field({name!r}) over a region instead."
            )
        values, x = np.asarray(self.field(name, step), dtype=float), self.x
        # One body among others may be a line.
        rows = rows_of_points(points, x)
        found: Float | None = None
        held = self._held(step)
        # A body of one particle among others has no value at other points.
        known = [k for k, (particles, _) in enumerate(self._bodies) if len(particles) > 1] or range(len(self._bodies))
        for number in known:
            particles, inside = self._bodies[number]
            own = held.of_body(particles, len(inside.sides))
            of_body = sampled(x[particles], values[particles], rows, inside, own)
            if bodies is not None:
                of_body[np.asarray(bodies) != number] = np.nan
            found = of_body if found is None else np.where(np.isnan(found), of_body, found)
        assert found is not None
        return found

    @cached_property
    def _bodies(self) -> list[tuple[GlobalIndex, Inside]]:
        """Return the particles of each body and its point location."""
        stored, x = self.fields, self.x
        dim = int(self.summary.get("dimension") or max(1, int((np.ptp(x, axis=0) > 0.0).sum())))
        depth = float(self.summary.get("thickness") or 1.0) if dim < 3 else 1.0
        volume, body = np.asarray(stored.of_particles("volume")), stored.body
        found = []
        for number in range(int(body.max()) + 1):
            particles, surface = np.flatnonzero(body == number), read_surface(self.folder, stored.run, number)
            found.append((particles, inside_of(x[particles, :dim], volume[particles], depth, surface)))
        return found

    def _held(self, step: int | None) -> Held:
        """Return the connection of all particles at a step, by cracks and broken bonds."""
        cracks = [(record, crack_of(record)) for record in crack_records(self.summary)]
        unknown = [str(record.get("kind")) for record, crack in cracks if crack is None]
        if unknown:
            raise CaseError(
                f"{self.folder} has a crack of the unknown class {unknown[0]}, so values between particles may cross "
                "it. Use field(name) of the particles."
            )
        stored, x = self.fields, self.x
        broken = broken_pairs(self.folder, stored.steps[-1] if step is None else step, x)
        known = [crack for _, crack in cracks if crack is not None]
        return Held(x, known, broken, float(self.summary.get("horizon") or np.inf))

    def frame(self) -> Any:
        """Return the history as a pandas data frame, one row per step.

        Raises
        ------
        CaseError
            pandas is not installed.
        """
        pandas = optional_module("pandas", "the history is a dictionary of arrays without it")
        return pandas.DataFrame(self.history)

    def to_pyvista(self, step: int | None = None) -> Any:
        """Return the cells of the particles as a PyVista grid in the undeformed body, with all fields of a step.

        Not collective. Fields are data of cells. Its ``warp_by_vector("displacement")`` is the deformed body, open
        along cracks. Tensors have nine components, row by row.

        Parameters
        ----------
        step : int, optional
            The step; by default the last one.

        Raises
        ------
        CaseError
            PyVista is not installed, or the run wrote no fields.
        """
        optional_module("pyvista", "fields.xdmf opens in ParaView without it")
        _ = self.fields  # refuses the fields of a later run
        return grid_of(self.folder, step)

    def check(self) -> list[Check]:
        """Compare the results with the expected results of the case, and return every check (not collective).

        Raises
        ------
        CheckError
            A result is not as expected, or missing.
        CaseError
            There are no expected results: the case declares none, or the run was opened from its folder and had not
            been checked.
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

        Dimensions are ``step``, ``particle`` and ``component``, with ``along`` for the second index of tensors, and
        ``principal`` (1, 2, 3) instead of ``component`` for principal values. Coordinates are the step, its load
        parameter ``t`` [-], the volumes, and the reference positions ``X`` [length] by particle and component. A field
        of the case with one of these names gets the suffix ``_field``. Fields missing in some steps are omitted. All
        data are read at once.

        Raises
        ------
        CaseError
            xarray is not installed, or the run wrote no fields.
        """
        xarray = optional_module("xarray", "field(name, step) gives NumPy arrays without it")
        fields = self.fields
        shared = [name for name in fields.names() if all(name in fields.names(step) for step in fields.steps)]
        labels = Labels.of(self.summary)
        # xarray appends the units itself.
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
        """Return the picture of the run, or the reason why there is none; empty if there is nothing to draw."""
        try:
            _ = self.fields  # of this run: a later run may use the folder
            data = picture_of_run(self.folder)
        except (CaseError, OSError):
            return ""
        if data is None:
            return ""
        encoded = base64.b64encode(data).decode()
        return f"<img alt='the deformed body' style='max-width:640px' src='data:image/png;base64,{encoded}'>"

    def gathered(self, field: Field) -> NDArray[Any] | None:
        """Return a field of the last solution for all particles in creation order on rank 0; None on other ranks.

        Parameters
        ----------
        field : Field
            Any function of a solution that returns one row per particle, such as ``pd.stress``, written by the run or
            not.

        Raises
        ------
        CaseError
            The run was opened from its folder.

        Notes
        -----
        Collective.
        """
        if self.solution is None:
            raise CaseError(
                "This run was opened from its folder. Use field(name) with the name of a field that it wrote."
            )
        return gathered(self.solution, field)


def named_numbers(results: Any) -> dict[str, float]:
    """Return the results of a case as finite numbers; raise RunError if a result is not a finite number."""
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
    """Import an optional module; raise CaseError if it is not installed."""
    try:
        return importlib.import_module(name)
    except ImportError:
        raise CaseError(f"{name} is not installed: pip install {name}; {otherwise}.") from None


def gathered(solution: Solution, field: Field) -> NDArray[Any] | None:
    """Return a field of a solution for all particles in creation order on rank 0, else None (collective)."""
    parts = [part for _, part in InCreationOrder(solution.cloud).parts_on_root(np.asarray(field(solution)))]
    return np.concatenate(parts) if parts else None


def open_run(folder: str | Path) -> Result:
    """Read the results of a run from its folder, also of a failed or stopped run.

    Parameters
    ----------
    folder : str or Path
        Folder of the run, as given to ``run`` or after ``-o``.

    Raises
    ------
    CaseError
        The folder has no run.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> result = pd.open("out/bar")                      # doctest: +SKIP
    >>> result.summary["status"]                         # doctest: +SKIP
    'converged'
    """
    folder = Path(folder)
    # Read first: if another run begins meanwhile, its numbers have no fields rather than wrong ones.
    run = _run_of(folder)
    summary = read_summary(folder)
    try:
        results = {str(name): float(value) for name, value in dict(summary.get("results") or {}).items()}
    except (TypeError, ValueError, OverflowError) as error:
        raise CaseError(f"{folder} holds a summary.json whose results are not numbers: {error}.") from error
    history = read_history(folder) if (folder / "history.csv").exists() else {}
    return Result(folder, results, history, summary, run=run)


def _run_of(folder: Path) -> str | None:
    """Return the identifier of the run of the fields in a folder, to detect fields of a later run."""
    try:
        return StoredFields(folder).run
    except CaseError:
        return NONE_YET
