"""Fit of parameters of a case to a measured curve."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from pdpetsc.arrays import Float, Mask
from pdpetsc.declared import refuse_unknown
from pdpetsc.errors import CaseError, SolveError
from pdpetsc.output.files import write_whole
from pdpetsc.output.reading import read_history
from pdpetsc.studies.reference_curve import Curve, read_curve, read_off, scaled_norm
from pdpetsc.studies.run_store import Outcome
from pdpetsc.studies.sets import Range, text_of
from pdpetsc.studies.study import Progress, Runs
from pdpetsc.studies.table import write_columns

# Step of the differences for the Jacobian, over the range of a parameter [-]: far above the error of solvers, far below
# the scale of curvature.
STEP = 1e-3
# A curve with a smaller change over the whole range of a parameter does not depend on it [-].
NOTHING = 1e-6
# Parameters cannot be distinguished if the smallest singular value of the Jacobian with unit columns is below this [-].
SINGULAR = 1e-3
# A parameter this near to the end of its range, over the range, is at the end [-].
AT_END = 1e-3
# Largest remaining step at the end of a search: over the standard errors [-], and over the range [-]. Smaller steps are
# below the accuracy of the measurement, and for a curve with kinks, as at yield, no derivative vanishes at the minimum.
LEFT, NEAR = 0.1, 1e-4
# Number of repeated searches from the end of the previous one, and of curves for the first of them.
ROUNDS, AGAIN = 6, 15
# Smallest explained share of the variance of the measurement, and relative residuals that are accepted at any variance.
GOOD, CLOSE = 0.9, 0.01
# Digits of the parameters of runs: more are below the accuracy of a curve.
DIGITS = 12
FILES = ("fit.json", "fit.csv", "fit.png")


@dataclass(frozen=True)
class Fit:
    """The result of a fit.

    Attributes
    ----------
    values : dict of str to float
        The parameters.
    errors : dict of str to float
        Their standard errors, for independent errors of the measured values with the declared standard deviations, or
        else with that of the residuals.
    correlation : (n, n) float64
        Correlation of the errors of the parameters, in their order.
    fitted : (m,) float64
        The curve of the run at the measured positions.
    curve : Curve
        The measured curve.
    rms : float
        Root mean square of the residuals, in the unit of the values.
    explained : float
        Share of the variance of the measured values that is explained: 1 - residual / total.
    chi2 : float or None
        Sum of squared residuals over standard deviations, per degree of freedom, if deviations are declared. About 1 is
        expected; a much larger value means that the model does not describe the measurement.
    interpolation : float
        Estimated error of interpolation between the steps of the run, in the unit of the values; inf for fewer than
        four steps.
    runs, failed : int
        Number of runs, and of runs that failed or ended too early.
    best : Path
        The folder of the run with these parameters.
    notes : list of str
        Notes for the user.
    """

    values: dict[str, float]
    errors: dict[str, float]
    correlation: Float
    fitted: Float
    curve: Curve
    rms: float
    explained: float
    chi2: float | None
    interpolation: float
    runs: int
    failed: int
    best: Path
    notes: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Point:
    """One evaluated parameter set: the history of its run and values at the measured positions, or the failure."""

    folder: Path
    history: Mapping[str, Any] = field(default_factory=dict)
    failure: str = ""
    values: Float | None = None
    warnings: Sequence[str] = ()

    def read_off(self, curve: Curve) -> Point:
        """Return the point with the values of its history at the positions of a curve."""
        if self.failure:
            return self
        try:
            return dataclasses.replace(self, values=read_off(self.history, curve))
        except CaseError as error:
            return dataclasses.replace(self, failure=str(error))


Evaluate = Callable[[Sequence[Mapping[str, float]]], "list[Point]"]


class _Search:
    """Residuals and their Jacobian from runs, each evaluated once."""

    def __init__(self, evaluate: Evaluate, ranges: Mapping[str, Range], curve: Curve, most: int) -> None:
        self._evaluate, self._most = evaluate, most
        self.ranges, self.curve = dict(ranges), curve
        self.known: dict[tuple[float, ...], Point] = {}

    def values(self, x: Float) -> dict[str, float]:
        """Return the parameters at fractions of their ranges."""
        shares = zip(self.ranges.items(), x.tolist(), strict=True)
        return {name: float(f"{one.at(share):.{DIGITS}g}") for (name, one), share in shares}

    def at(self, places: Sequence[Float]) -> list[Point]:
        """Return the point of each parameter vector; unknown points are run in parallel."""
        sets = [self.values(x) for x in places]
        keys = [tuple(one.values()) for one in sets]
        new = {key: one for key, one in zip(keys, sets, strict=True) if key not in self.known}
        if new and len(self.known) + len(new) > self._most:
            raise SolveError(
                f"The fit has not ended within {self._most} runs; allow more with --runs, which goes on from here."
            )
        for key, point in zip(new, self._evaluate(list(new.values())) if new else [], strict=True):
            self.known[key] = point.read_off(self.curve)
        return [self.known[key] for key in keys]

    def residual(self, x: Float) -> Float:
        """Return the residuals over their scale; not finite if the run has no curve."""
        values = self.at([x])[0].values
        if values is None:
            # SciPy then tries a shorter step.
            return np.full(len(self.curve.x), np.nan)
        return np.asarray((values - self.curve.y) / self.curve.scale)

    def least(self, x: Float) -> Float:
        """Return the shares at the end of least squares; raise SolveError if it does not converge."""
        found = self._minimise(x, self.jacobian, ftol=1e-9, xtol=1e-5, gtol=1e-9, max_nfev=max(self._most, 1))
        if found.status <= 0:
            raise SolveError(f"The fit has not converged: {str(found.message).strip('`').rstrip('.')}.")
        return np.asarray(found.x)

    def refined(self, x: Float) -> Float:
        """Return the shares at the end of least squares with central differences, after a few runs."""
        found = self._minimise(x, self.central_jacobian, ftol=1e-12, xtol=1e-7, gtol=1e-12, max_nfev=AGAIN)
        return np.asarray(found.x)

    def _minimise(self, x: Float, jacobian: Callable[[Float], Float], **given: float) -> Any:
        """Return the result of SciPy from the shares ``x``; further arguments are its tolerances and its limit."""
        from scipy.optimize import least_squares

        return least_squares(self.residual, x, jac=jacobian, bounds=(0.0, 1.0), method="trf", **given)

    def lower(self, x: Float, step: Float) -> Float | None:
        """Return shares along a step with a smaller sum of squares; None if there are none.

        Raises
        ------
        SolveError
            Runs along the step fail.
        """
        here, why = float(np.sum(self.residual(x) ** 2)), ""
        least = 0.5 * LEFT**2 / (len(self.curve.x) - len(x))
        for part in 0.5 ** np.arange(0.0, 8.0):
            place = np.clip(x + part * step, 0.0, 1.0)
            why = why or self.at([place])[0].failure
            # Parameters without a curve have no sum of squares and are not accepted.
            if float(np.sum(self.residual(place) ** 2)) < (1.0 - least) * here:
                return np.asarray(place)
        if why:
            raise SolveError(
                f"The fit ended where runs fail, next to {_words(self.values(x))}; the least square lies beyond: make "
                f"runs succeed there, or fix a parameter: {why}"
            )
        return None

    def failing(self, x: Float) -> list[str]:
        """Return the parameters for which differences fail because neighbours have no curve."""
        sides = [(name, self._moved(x, j, step)) for j, name in enumerate(self.ranges) for step in (STEP, -STEP)]
        inside = [(name, side) for name, side in sides if np.all((side >= 0.0) & (side <= 1.0))]
        found = zip(inside, self.at([side for _, side in inside]), strict=True)
        return list(dict.fromkeys(name for (name, _), point in found if point.failure))

    def jacobian(self, x: Float) -> Float:
        """Return the derivatives of the residuals by the shares (m, n), by one-sided differences."""
        return self._derivatives(x, np.zeros(len(x), dtype=bool))

    def central_jacobian(self, x: Float) -> Float:
        """Return the derivatives of the residuals by the shares (m, n), by central differences within the ranges."""
        return self._derivatives(x, (x >= STEP) & (x + STEP <= 1.0))

    def _derivatives(self, x: Float, central: Mask) -> Float:
        here = self.at([x])[0]
        steps = np.where(x + STEP <= 1.0, STEP, -STEP)
        first = self.at([self._moved(x, j, step) for j, step in enumerate(steps)])
        # The other side of a parameter is run for central differences, or if the first side failed.
        back = [j for j, point in enumerate(first) if point.failure or central[j]]
        other = dict(zip(back, self.at([self._moved(x, j, -steps[j]) for j in back]), strict=True))
        J = np.empty((len(self.curve.x), len(x)))
        for j, name in enumerate(self.ranges):
            sides = [(x[j] + steps[j], first[j])] + ([(x[j] - steps[j], other[j])] if j in other else [])
            ends = [(share, point) for share, point in sides if not point.failure]
            if not ends:
                raise SolveError(
                    f"Runs on both sides of {name} = {self.values(x)[name]:g} give no curve, so it has no derivative "
                    f"there: {first[j].failure}"
                )
            (share, point), (end, last) = [*ends, (x[j], here)][:2]
            J[:, j] = (np.asarray(last.values) - np.asarray(point.values)) / (end - share) / self.curve.scale
        return J

    @staticmethod
    def _moved(x: Float, j: int, step: float) -> Float:
        moved = np.array(x)
        moved[j] += step
        return moved


def fitted(evaluate: Evaluate, ranges: Mapping[str, Range], curve: Curve, most: int = 500) -> Fit:
    """Compute the parameters with the least-squares fit to the measured curve.

    SciPy's trust region reflective method (Branch1999) minimises the sum of squares of ``(f(x_k; p) - y_k) / s`` over
    shares of the ranges, with differences of ``STEP`` for the Jacobian ``J``. If a run fails, or does not reach the
    measured positions, a shorter step is tried. Standard errors are the roots of the diagonal of ``s^2 (J^T J)^-1`` by
    central differences.

    Parameters
    ----------
    evaluate : callable
        Runs parameter sets and returns a ``Point`` for each.
    ranges : mapping of str to Range
        The range of each parameter.
    curve : Curve
        The measured curve.
    most : int
        Largest number of runs.

    Returns
    -------
    Fit

    Raises
    ------
    CaseError
        There are not more measured points than parameters.
    SolveError
        The first run has no curve, the search does not converge, the curve does not distinguish the parameters, one of
        them is at the end of its range or next to failing runs, or a constant fits the measured values better. All runs
        remain.
    """
    n, m = len(ranges), len(curve.x)
    if n == 0:
        raise CaseError("A fit needs a parameter with a range, NAME=LOW:HIGH.")
    if m <= n:
        raise CaseError(f"{m} measured points are too few for {n} parameters: at least {n + 1} are needed.")
    search = _Search(evaluate, ranges, curve, most)
    x = np.array([one.first for one in ranges.values()])
    if why := search.at([x])[0].failure:
        raise SolveError(
            f"The run that the fit starts from, {_words(search.values(x))}, gives no curve: {why.rstrip('.')}; start "
            f"elsewhere with NAME=LOW:START:HIGH."
        )
    x = search.least(x)
    J = _identified(search, x)
    rounds = 0
    while (step := _left(search, x, J)) is not None:
        # One-sided differences shift the minimum; a short step is not significant if the residuals are small.
        further = search.refined(x) if rounds == 0 else search.lower(x, step)
        if further is None:
            break
        if (rounds := rounds + 1) > ROUNDS:
            raise SolveError(f"The fit has not converged at {_words(search.values(x))}: the curve jumps near there.")
        x = further
        J = _identified(search, x)
    point = search.at([x])[0]
    values, r = np.asarray(point.values), search.residual(x)
    square = float(r @ r) / (m - n)
    # If all residuals are zero, so are the errors; correlations are those of any residual.
    inverse = np.linalg.inv(J.T @ J)
    spread = np.sqrt(np.diag(inverse))
    deviation = spread * (1.0 if curve.sigma is not None else math.sqrt(square))
    slopes = np.array([one.slope(float(share)) for one, share in zip(ranges.values(), x, strict=True)])
    total = float(np.sum((curve.y - curve.y.mean()) ** 2))
    rms = scaled_norm(values - curve.y)
    failed = sum(bool(one.failure) for one in search.known.values())
    between = _between_steps(point.history, curve)
    fit = Fit(
        search.values(x), dict(zip(ranges, (deviation * slopes).tolist(), strict=True)),
        inverse / np.outer(spread, spread), values, curve, rms,
        1.0 - float(np.sum((values - curve.y) ** 2)) / total if total > 0.0 else math.nan,
        square if curve.sigma is not None else None, between, len(search.known), failed, point.folder,
    )  # fmt: skip
    _refuse_unexplained(fit)
    if near := search.failing(x):
        fit.notes.append(f"runs fail next to these parameters, in {' and '.join(near)}")
    if step is not None:
        fit.notes.append("the curve has a bend or a jump at these parameters: their standard errors are not reliable")
    fit.notes.extend(_notes(fit, ranges, deviation))
    fit.notes.extend(f"the run with these parameters warns: {warning.rstrip('.')}" for warning in point.warnings)
    return fit


def _identified(search: _Search, x: Float) -> Float:
    """Return the Jacobian by central differences at the end of the search.

    Raises
    ------
    SolveError
        The curve does not distinguish the parameters, or one is at the end of its range.
    """
    J, curve, ranges = search.central_jacobian(x), search.curve, search.ranges
    _refuse_unidentified(J * (curve.scale / np.abs(curve.y).max())[:, None], list(ranges))
    at_end = [name for (name, one), share in zip(ranges.items(), x, strict=True) if min(share, 1 - share) < AT_END]
    if at_end:
        raise SolveError(
            f"{' and '.join(f'{name} = {search.values(x)[name]:g}' for name in at_end)} ended at an end of "
            f"{'its range' if len(at_end) == 1 else 'their ranges'}; the least square lies beyond: widen it, or fix it."
        )
    return J


def _left(search: _Search, x: Float, J: Float) -> Float | None:
    """Return the remaining Gauss-Newton step at the end of the search (n,); None if it is negligible.

    Raises
    ------
    SolveError
        Runs fail along a remaining step: the minimum is among failing runs.
    """
    r = search.residual(x)
    step = np.asarray(np.linalg.lstsq(J, -r, rcond=None)[0])
    m, n = J.shape
    # The step over standard errors, in any unit and for any number of points.
    if np.sum((J @ step) ** 2) * (m - n) <= LEFT**2 * np.sum(r**2) or np.abs(step).max() <= NEAR:
        return None
    if near := search.failing(x):
        raise SolveError(
            f"The fit ended where runs fail, next to {_words(search.values(x))} in {' and '.join(near)}; the least "
            f"square lies beyond: make runs succeed there, or fix a parameter."
        )
    return step


def _refuse_unexplained(fit: Fit) -> None:
    """Raise SolveError if a constant fits the measured values as well as the fitted curve."""
    if fit.explained > 0.0 or fit.rms <= CLOSE * scaled_norm(fit.curve.y):
        return
    share = f" ({fit.explained:.2g} of the variance is explained)" if math.isfinite(fit.explained) else ""
    raise SolveError(
        f"The nearest curve, that of {_words(fit.values)}, explains nothing of the measured one{share}: a constant is "
        f"nearer to it; look at signs, units and the case, with the run in {fit.best}."
    )


def _notes(fit: Fit, ranges: Mapping[str, Range], deviation: Float) -> list[str]:
    found = []
    if not fit.explained >= GOOD and fit.rms > CLOSE * scaled_norm(fit.curve.y):
        found.append(
            f"THE CASE IS NOT THAT OF THE MEASUREMENT: no more than {fit.explained:.2g} of the variance of "
            f"{fit.curve.y_name} is explained, so the parameters and their standard errors mean little"
        )
    for name, share in zip(ranges, deviation, strict=True):
        if share > 0.5:
            found.append(f"{name} is hardly determined: its standard error is {share:.1g} of its range")
    if not math.isfinite(fit.interpolation):
        found.append("the run has too few steps to tell how wrong the lines between them are: take four or more")
    elif fit.interpolation > max(0.3 * fit.rms, 1e-4 * float(np.abs(fit.curve.y).max())):
        found.append(
            f"between the steps of the run {fit.curve.y_name} may be wrong by {fit.interpolation:.2g}, against "
            f"residuals of {fit.rms:.2g}: take more load steps"
        )
    if fit.chi2 is not None and not 0.3 < fit.chi2 < 3.0:
        found.append(
            f"chi squared per degree of freedom is {fit.chi2:.2g}, not about 1: the deviations are not those of the "
            f"measurement, or the case is not"
        )
    return found


def _between_steps(history: Mapping[str, Any], curve: Curve) -> float:
    """Return the error of linear interpolation between steps: a third of the change without every second step."""
    fine = {name: np.asarray(history[name], dtype=float) for name in (curve.x_name, curve.y_name)}
    n = len(fine[curve.x_name])
    if n < 4:
        return math.inf
    coarse = {name: values[[*range(0, n - 1, 2), n - 1]] for name, values in fine.items()}
    return float(np.abs(read_off(fine, curve) - read_off(coarse, curve)).max()) / 3.0


def _refuse_unidentified(J: Float, names: Sequence[str]) -> None:
    """Raise SolveError if the curve does not determine the parameters."""
    length = np.linalg.norm(J, axis=0) / math.sqrt(len(J))
    for name, size in zip(names, length, strict=True):
        if size < NOTHING:
            raise SolveError(f"The curve does not depend on {name}, so it cannot be found from it; fix it.")
    _, values, directions = np.linalg.svd(J / np.linalg.norm(J, axis=0))
    if values[-1] < SINGULAR:
        last = directions[-1]
        together = [name for name, share in zip(names, last, strict=True) if abs(share) > 0.1]
        raise SolveError(
            f"The curve does not tell {' and '.join(together)} apart: they change it in the same way (smallest "
            f"singular value {values[-1]:.1e} of the Jacobian); fix one of them, or measure something else besides."
        )


def _words(values: Mapping[str, float]) -> str:
    return ", ".join(f"{name} = {value:g}" for name, value in values.items())


def fit(
    case: str | Path,
    ranges: Mapping[str, Range | Sequence[float]],
    to: str | Path | tuple[Any, Any],
    columns: tuple[str, str],
    folder: str | Path | None = None,
    *,
    fixed: Mapping[str, Any] | None = None,
    sigma: Any = None,
    within: tuple[float, float] | None = None,
    ranks: int = 1,
    jobs: int = 1,
    options: Sequence[str] = (),
    retry: bool = False,
    launcher: str | None = None,
    most: int = 500,
    progress: Progress | None = None,
) -> Fit:
    """Fit parameters of a case to a measured curve.

    Every parameter set is a run in the folder of a study. Finished runs are not repeated: call a stopped fit again to
    continue. See ``fitted`` for the method.

    Parameters
    ----------
    case : str or Path
        The case file.
    ranges : mapping of str to Range, or to (low, high) or (low, start, high)
        The range of each parameter.
    to : str, Path or (x, y)
        A CSV with a header, or positions and values.
    columns : tuple of str
        The columns of positions and values in the history; ``"u:displacement"`` if the CSV has another name for the
        column. Positions of a run must be monotonic and include the range of the measured ones.
    folder : str or Path, optional
        By default ``out/fit_CASE``; contains ``fit.json``, ``fit.csv`` and a folder for each run.
    fixed : mapping, optional
        Other parameters of the case.
    sigma : str or (m,) array, optional
        Standard deviations of the measured values: a column, or numbers.
    within : (low, high), optional
        Range of positions for the comparison.
    ranks, jobs, options, retry, launcher
        As for ``study``.
    most : int
        Largest number of runs.
    progress : Progress, optional
        Receives the progress of runs.

    Returns
    -------
    Fit

    Raises
    ------
    CaseError
        The case, a parameter, the curve or the folder is wrong.
    SolveError
        As for ``fitted``; all runs remain in the folder.

    Notes
    -----
    Not collective: call it from one process, without mpirun.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> found = pd.fit("bar.py", {"E": (500.0, 2000.0)}, "measured.csv", ("u", "F"), jobs=2)  # doctest: +SKIP
    >>> found.values["E"], found.errors["E"]                                                  # doctest: +SKIP
    """
    path = Path(case)
    place = Path(folder) if folder is not None else Path("out") / f"fit_{path.stem}"
    sought = {name: one if isinstance(one, Range) else _range(name, one) for name, one in ranges.items()}
    others = {name: text_of(value) for name, value in (fixed or {}).items()}
    if both := sought.keys() & others.keys():
        raise CaseError(f"Parameter {min(both)} has a range and a value.")
    curve = _curve(to, columns, sigma)
    curve = curve if within is None else curve.within(*within)
    runs = Runs(path, place, FILES, ranks, jobs, options, retry, launcher)
    refuse_unknown(sought, runs.file.kinds, "The case has no parameter")
    for name in sought:
        if runs.file.kinds[name] != "float":
            raise CaseError(
                f"Parameter {name} is not a number with a decimal point ({runs.file.kinds[name]}): least squares "
                f"cannot vary it."
            )
    runs.file.plan([others | {name: text_of(float(one.at(one.first))) for name, one in sought.items()}])

    def evaluate(sets: Sequence[Mapping[str, float]]) -> list[Point]:
        planned = runs.file.plan([others | {name: text_of(value) for name, value in one.items()} for one in sets])
        with contextlib.closing(runs.outcomes(planned, progress)) as so_far:
            *_, outcomes = so_far
        return [_point(outcome) for outcome in outcomes]

    with runs.in_folder():
        found = fitted(evaluate, sought, curve, most)
        _write(place, found)
    return found


def _point(outcome: Outcome) -> Point:
    if outcome.changed:
        raise SolveError(f"The fit cannot go on: {outcome.said.rstrip('.')}; the same command begins anew with them.")
    if not outcome.finished:
        return Point(outcome.folder, failure=f"exit status {outcome.exit_status}: {outcome.said}")
    return Point(outcome.folder, read_history(outcome.folder), warnings=outcome.warnings)


def _range(name: str, ends: Sequence[float]) -> Range:
    try:
        numbers = [float(value) for value in ends]
    except (TypeError, ValueError):
        numbers = []
    if len(numbers) not in (2, 3):
        raise CaseError(f"The range of {name} is (low, high) or (low, start, high), not {ends!r}.")
    return Range(numbers[0], numbers[-1], numbers[1] if len(numbers) == 3 else None)


def _curve(to: Any, columns: tuple[str, str], sigma: Any) -> Curve:
    if isinstance(to, str | Path):
        if sigma is not None and not isinstance(sigma, str):
            raise CaseError("The standard deviations of a measured file are one of its columns, by name.")
        return read_curve(Path(to), columns, sigma)
    x, y = (np.asarray(values, dtype=float) for values in to)
    deviations = None if sigma is None else np.broadcast_to(np.asarray(sigma, dtype=float), y.shape).copy()
    return Curve(columns[0], columns[1], x, y, deviations)


def _write(folder: Path, found: Fit) -> None:
    names = list(found.values)
    curve = found.curve
    columns = {curve.x_name: curve.x, curve.y_name: curve.y, "fitted": found.fitted, "residual": found.fitted - curve.y}
    write_columns(folder / "fit.csv", {name: column.tolist() for name, column in columns.items()})
    rows = [[_finite(value) for value in row] for row in found.correlation.tolist()]
    correlation = {name: dict(zip(names, row, strict=True)) for name, row in zip(names, rows, strict=True)}
    whole = {
        "parameters": {n: {"value": found.values[n], "standard_error": _finite(found.errors[n])} for n in names},
        "correlation": correlation,
        "rms": found.rms, "explained": _finite(found.explained),
        "chi2": None if found.chi2 is None else _finite(found.chi2),
        "interpolation": _finite(found.interpolation), "points": len(found.curve.x), "runs": found.runs,
        "failed": found.failed, "best": found.best.name, "notes": found.notes,
    }  # fmt: skip
    write_whole(folder / "fit.json", json.dumps(whole, indent=1, allow_nan=False) + "\n")


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
