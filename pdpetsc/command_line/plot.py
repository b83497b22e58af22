"""Draw pictures of a finished or stopped run.

usage: python -m pdpetsc plot DIR [field=NAME] [component=xx] [scale=1] [step=N] [x=t] [y=NAME] [--cut x=5] [--animate]

  field, component, scale, step   the field that colours the deformed body, and the factor on its displacements; by
                                  default those of the case's picture=
  x, y                            columns of history.csv against each other; by default all of them against t
  --cut x=5                       draw only x < 5 of a solid body, with the inside on the cut face; x=5,z=2 for several
                                  planes, none for none; by default those of the case's picture=
  --animate                       also a film of all steps: deformed.mp4 if ffmpeg is installed, else deformed.gif;
                                  format=gif or format=mp4 chooses
Writes deformed.png, history.png and newton.png into DIR, and curve.png if the history has a force and a length.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pdpetsc.command_line.arguments import Arguments
from pdpetsc.declared import refuse_unknown
from pdpetsc.errors import CaseError
from pdpetsc.output.curves import curve_figure, history_figure, newton_figure
from pdpetsc.output.files import replacing
from pdpetsc.output.labels import Labels
from pdpetsc.output.picture import MARK, draw_field, draw_film, film_format
from pdpetsc.output.reading import StoredFields, read_history, read_summary, refusing_damage
from pdpetsc.output.scene import Settings

COMPONENTS = {"displacement": "x", "stress": "xx", "first_piola_stress": "xx", "deformation_gradient": "xx"}


def plot(folder: Path, given: Mapping[str, str], animate: bool = False, cut: str | None = None) -> list[Path]:
    """Draw a run and return the pictures.

    Parameters
    ----------
    folder : Path
        Output folder of the run.
    given : mapping of str to str
        Words ``name=value`` of the command line.
    animate : bool
        If True, also draw a film of all steps.
    cut : str, optional
        Planes that cut a solid body: ``"x=5,z=2"``, or ``"none"``; by default those of the picture of the case.

    Raises
    ------
    CaseError
        The folder holds no run, or a word is wrong.
    """
    with refusing_damage(f"{folder} cannot be drawn, because a file is damaged, not of a run, or cannot be written"):
        return _drawn(folder, given, animate, cut)


def _drawn(folder: Path, given: Mapping[str, str], animate: bool, cut: str | None) -> list[Path]:
    summary = read_summary(folder)
    drawn = []
    kind = given.get("format") or film_format()
    if kind not in ("gif", "mp4"):
        raise CaseError(f"format takes gif or mp4, not {kind!r}.")
    if (folder / "fields.h5").exists():
        # Settings of the picture of the case, unless another field is given.
        stored, shown = StoredFields(folder).names(), summary.get("picture") or {}
        default = "stress" if "stress" in stored else "displacement"
        field = given.get("field") or (shown["field"] if shown.get("field") in stored else default)
        own = shown if field == shown.get("field") else {}
        component = given.get("component", str(own.get("component", COMPONENTS.get(field, ""))))
        scale, step = _number(given, "scale", own.get("scale", 1.0)), _number(given, "step", -1.0)
        if "step" in given and (step < 0.0 or step != int(step)):
            raise CaseError(f"step takes the number of a step, not {given['step']}.")
        cuts = own.get("cut", ()) if cut is None else _cuts(cut)
        path = folder / "deformed.png"
        settings = Settings(field, component, scale, cuts)
        draw_field(folder, path, settings, int(step) if "step" in given else None)
        drawn.append(path)
        if animate:
            drawn.append(folder / f"deformed.{kind}")
            draw_film(folder, drawn[-1], settings)
    elif animate:
        raise CaseError(f"{folder} has no fields.h5 for a film. Add fields to the case and repeat the run.")
    drawn += _history(folder, summary, given.get("x", "t"), given.get("y"))
    drawn.append(save(newton_figure(summary), folder / "newton.png"))
    return drawn


def _cuts(text: str) -> list[Any]:
    """Return the planes of ``--cut``: axes with positions."""
    planes = {} if text == "none" else dict(word.partition("=")[::2] for word in text.split(","))
    refuse_unknown(planes, ("x", "y", "z"), "--cut has no axis")
    return [(axis, _number(planes, axis, 0.0)) for axis in planes]


def _number(given: Mapping[str, str], name: str, default: float) -> float:
    try:
        number = float(given.get(name, default))
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise CaseError(f"{name} takes a number, not {given.get(name, default)!r}.")
    return number


def save(figure: Any, path: Path) -> Path:
    """Write a figure as a PNG; only a loss of power can damage the file. Raises OutputError."""
    with replacing(path, wait=False) as aside:
        figure.savefig(aside, dpi=130, format="png", metadata=MARK)
    return path


def _history(folder: Path, summary: Mapping[str, Any], x: str, y: str | None) -> list[Path]:
    columns, labels = read_history(folder), Labels.of(summary)
    refuse_unknown([x, *([y] if y else [])], columns, "history.csv has no column")
    drawn = [save(history_figure(columns, labels, x, y), folder / "history.png")]
    if (figure := curve_figure(columns, labels)) is not None:
        drawn.append(save(figure, folder / "curve.png"))
    return drawn


def run(path: Path, arguments: Arguments) -> int:
    """Execute the command."""
    for picture in plot(path, arguments.parameters, "--animate" in arguments.flags, arguments.value("--cut")):
        print(picture)
    return 0
