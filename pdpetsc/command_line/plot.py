"""``python -m pdpetsc plot DIR``: pictures of a finished or stopped run."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pdpetsc.command_line.arguments import split
from pdpetsc.errors import CaseError, PdpetscError
from pdpetsc.output.curves import curve_figure, history_figure, newton_figure
from pdpetsc.output.files import replacing
from pdpetsc.output.labels import Labels
from pdpetsc.output.picture import MARK, draw_field, draw_film
from pdpetsc.output.reading import StoredFields, read_history, read_summary

USAGE = """usage: python -m pdpetsc plot DIR [field=NAME] [component=xx] [scale=1] [step=N] [x=t] [y=NAME] [--animate]

  field, component, scale, step   what colours the deformed body, and how much its displacements are enlarged
  x, y                            columns of history.csv against each other; by default all of them against t
  --animate                       a film of all steps besides: deformed.gif, or deformed.mp4 with format=mp4
Writes deformed.png, history.png and newton.png into DIR, and curve.png where the history has a force and a length."""

COMPONENTS = {"displacement": "x", "stress": "xx", "first_piola_stress": "xx", "deformation_gradient": "xx"}


def plot(folder: Path, given: Mapping[str, str], animate: bool = False) -> list[Path]:
    """Draw a run and return the pictures.

    Parameters
    ----------
    folder : Path
        Output folder of the run.
    given : mapping of str to str
        Words ``name=value`` of the command line.
    animate : bool
        Whether a film of all steps is made too.

    Raises
    ------
    CaseError
        The folder holds no run, or a word is wrong.
    """
    known = ("field", "component", "scale", "step", "x", "y", "format")
    for name in given:
        if name not in known:
            raise CaseError(f"plot has no parameter {name!r}; it has {', '.join(known)}.")
    try:
        return _drawn(folder, given, animate)
    except PdpetscError:
        raise
    except (OSError, ValueError, TypeError, KeyError, AttributeError, IndexError) as error:
        what = " ".join(str(error).split()) or type(error).__name__
        raise CaseError(
            f"{folder} holds files that are damaged, not of a run, or cannot be written: {what}."
        ) from error


def _drawn(folder: Path, given: Mapping[str, str], animate: bool) -> list[Path]:
    summary = read_summary(folder)
    drawn = []
    kind = given.get("format", "gif")
    if kind not in ("gif", "mp4"):
        raise CaseError(f"format takes gif or mp4, not {kind!r}.")
    if (folder / "fields.h5").exists():
        field = given.get("field") or ("stress" if "stress" in StoredFields(folder).names() else "displacement")
        component = given.get("component", COMPONENTS.get(field, ""))
        scale, step = _number(given, "scale", 1.0), _number(given, "step", -1.0)
        if "step" in given and (step < 0.0 or step != int(step)):
            raise CaseError(f"step takes the number of a step, not {given['step']}.")
        path = folder / "deformed.png"
        draw_field(folder, path, field, component, scale, _title(folder), int(step) if "step" in given else None)
        drawn.append(path)
        if animate:
            drawn.append(folder / f"deformed.{kind}")
            draw_film(folder, drawn[-1], field, component, scale, _title(folder))
    elif animate:
        raise CaseError(f"{folder} holds no fields to make a film of.")
    drawn += _history(folder, summary, given.get("x", "t"), given.get("y"))
    drawn.append(_newton(folder, summary))
    return drawn


def _title(folder: Path) -> str:
    return folder.resolve().name


def _number(given: Mapping[str, str], name: str, default: float) -> float:
    try:
        number = float(given.get(name, default))
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise CaseError(f"{name} takes a number, not {given[name]!r}.")
    return number


def _history(folder: Path, summary: Mapping[str, Any], x: str, y: str | None) -> list[Path]:
    columns, labels = read_history(folder), Labels.of(summary)
    for name in (x, *([y] if y else [])):
        if name not in columns:
            raise CaseError(f"history.csv has no column {name!r}; it has {', '.join(columns)}.")
    drawn = [folder / "history.png"]
    with replacing(drawn[0]) as aside:
        history_figure(columns, labels, x, y).savefig(aside, dpi=130, format="png", metadata=MARK)
    figure = curve_figure(columns, labels)
    if figure is not None:
        drawn.append(folder / "curve.png")
        with replacing(drawn[1]) as aside:
            figure.savefig(aside, dpi=130, format="png", metadata=MARK)
    return drawn


def _newton(folder: Path, summary: Mapping[str, Any]) -> Path:
    path = folder / "newton.png"
    with replacing(path) as aside:
        newton_figure(summary).savefig(aside, dpi=130, format="png", metadata=MARK)
    return path


def main(argv: Sequence[str]) -> int:
    """Run the command ``plot``; return its exit status."""
    animate = "--animate" in argv
    arguments = split([word for word in argv if word != "--animate"])
    if "--help" in arguments.flags or not argv:
        print(USAGE)
        return 0 if argv else 2
    if arguments.path is None:
        raise CaseError("No folder is given; python -m pdpetsc plot -h shows the usage.")
    if arguments.petsc or arguments.output or arguments.restart or arguments.solver or "--check" in arguments.flags:
        raise CaseError("plot takes a folder and NAME=VALUE only; python -m pdpetsc plot -h shows the usage.")
    for path in plot(arguments.path, arguments.parameters, animate):
        print(path)
    return 0
