"""``python -m pdpetsc plot DIR``: pictures of a finished or stopped run."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pdpetsc.errors import CaseError, PdpetscError
from pdpetsc.output.picture import draw_field
from pdpetsc.output.reading import StoredFields, read_history, read_summary

USAGE = """usage: python -m pdpetsc plot DIR [field=NAME] [component=xx] [scale=1] [step=N] [x=t] [y=NAME]

  field, component, scale, step   what colours the deformed body, and how much its displacements are enlarged
  x, y                            columns of history.csv against each other; by default all of them against t
Writes deformed.png, history.png and newton.png into DIR."""

COMPONENTS = {"displacement": "x", "stress": "xx", "first_piola_stress": "xx", "deformation_gradient": "xx"}


def plot(folder: Path, given: Mapping[str, str]) -> list[Path]:
    """Draw a run and return the pictures.

    Parameters
    ----------
    folder : Path
        Output folder of the run.
    given : mapping of str to str
        Words ``name=value`` of the command line.

    Raises
    ------
    CaseError
        The folder holds no run, or a word is wrong.
    """
    known = ("field", "component", "scale", "step", "x", "y")
    for name in given:
        if name not in known:
            raise CaseError(f"plot has no parameter {name!r}; it has {', '.join(known)}.")
    try:
        return _drawn(folder, given)
    except PdpetscError:
        raise
    except (OSError, ValueError, TypeError, KeyError, AttributeError, IndexError) as error:
        what = " ".join(str(error).split()) or type(error).__name__
        raise CaseError(
            f"{folder} holds files that are damaged, not of a run, or cannot be written: {what}."
        ) from error


def _drawn(folder: Path, given: Mapping[str, str]) -> list[Path]:
    summary = read_summary(folder)
    drawn = []
    if (folder / "fields.h5").exists():
        field = given.get("field") or ("stress" if "stress" in StoredFields(folder).names() else "displacement")
        component = given.get("component", COMPONENTS.get(field, ""))
        scale, step = _number(given, "scale", 1.0), _number(given, "step", -1.0)
        path = folder / "deformed.png"
        draw_field(folder, path, field, component, scale, folder.name, None if step < 0 else int(step))
        drawn.append(path)
    drawn.append(_history(folder, given.get("x", "t"), given.get("y")))
    drawn.append(_newton(folder, summary))
    return drawn


def _number(given: Mapping[str, str], name: str, default: float) -> float:
    try:
        number = float(given.get(name, default))
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise CaseError(f"{name} takes a number, not {given[name]!r}.")
    return number


def _history(folder: Path, x: str, y: str | None) -> Path:
    columns = read_history(folder)
    chosen = [y] if y else [name for name in columns if name not in ("step", "t", x)]
    for name in (x, *chosen):
        if name not in columns:
            raise CaseError(f"history.csv has no column {name!r}; it has {', '.join(columns)}.")
    figure, axes = _axes(max(len(chosen), 1))
    for axis, name in zip(axes, chosen, strict=False):
        axis.plot(columns[x], columns[name], "o-", markersize=3)
        axis.set(xlabel=x, ylabel=name)
        axis.grid(alpha=0.3)
    path = folder / "history.png"
    figure.savefig(path, dpi=130)
    return path


def _newton(folder: Path, summary: Mapping[str, Any]) -> Path:
    figure, (axis,) = _axes(1)
    steps: Sequence[Mapping[str, Any]] = summary.get("steps", [])
    for step in steps:
        reference = step["reference"] or 1.0
        norms = [max(norm / reference, 1e-18) for norm in step["norms"] if norm is not None]
        axis.semilogy(range(len(norms)), norms, "o-", markersize=3, label=f"step {step['step']}")
    axis.set(xlabel="Newton iteration", ylabel="residual / (force and reactions)")
    axis.grid(alpha=0.3)
    if 0 < len(steps) <= 12:
        axis.legend(fontsize=8)
    path = folder / "newton.png"
    figure.savefig(path, dpi=130)
    return path


def _axes(count: int) -> tuple[Any, list[Any]]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.5, 1.0 + 3.0 * count), layout="constrained")
    return figure, list(figure.subplots(count, 1, squeeze=False)[:, 0])
