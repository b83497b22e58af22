"""``report.html``: the report of a run on one page without network access, scripts or other files."""

from __future__ import annotations

import base64
import contextlib
import html
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from pdpetsc.errors import CaseError
from pdpetsc.output.curves import curve_figure, history_figure, newton_figure
from pdpetsc.output.files import write_whole
from pdpetsc.output.labels import Labels
from pdpetsc.output.picture import picture_of_run
from pdpetsc.output.reading import read_history, read_summary, refusing_damage
from pdpetsc.output.tables import table_html, text_of

FILE = "report.html"
# Number of first and last steps in the table of a longer run; steps that were cut back are added.
ROWS = 200
_STYLE = """
:root{color-scheme:light dark;--line:#8884;--soft:#8882;--bar:#3b78b0;--good:#1a7f37;--bad:#c62828}
*{box-sizing:border-box}
body{font:15px/1.5 system-ui,sans-serif;max-width:72rem;margin:0 auto;padding:1.5rem}
h1{margin:0 0 .3rem;font-size:1.7rem}h2{margin:2.2rem 0 .6rem;font-size:1.25rem;border-bottom:1px solid var(--line)}
.status{display:inline-block;padding:.1rem .6rem;border-radius:1rem;color:#fff;background:var(--bad)}
.status.good{background:var(--good)}
nav a{margin-right:1rem}
.wide{overflow-x:auto}
table{border-collapse:collapse;margin:.5rem 0}
th,td{padding:.2rem .7rem;border-bottom:1px solid var(--line);text-align:right;vertical-align:top}
th:first-child,td:first-child,td.text,th.text{text-align:left}
thead th{background:var(--soft)}
.ok{color:var(--good);font-weight:600}.wrong{color:var(--bad);font-weight:600}
figure{margin:1rem 0}figure img{max-width:100%;background:#fff;border-radius:4px}
figcaption{font-size:.9rem;opacity:.8}
pre{background:var(--soft);padding:.8rem;overflow-x:auto;font-size:13px;line-height:1.4}
.bar{display:inline-block;height:.8rem;background:var(--bar);border-radius:2px;min-width:1px}
.note{border-left:4px solid var(--bad);padding:.2rem .8rem;background:var(--soft)}
""".strip()


def write_report(folder: Path, field: str | None = None, component: str = "", scale: float = 1.0) -> Path:
    """Write the report of a run, whether it converged, failed or was killed, and return its path (one rank only).

    Parameters
    ----------
    folder : Path
        Folder of the run.
    field, component, scale
        Field and component that colour the deformed body, and magnification of the displacements; by default the
        picture of the run, or von Mises stress.

    Raises
    ------
    CaseError
        The folder holds no run or no such field.
    OutputError
        The report cannot be written.
    """
    summary = read_summary(folder)
    with refusing_damage(f"{folder} holds files that are damaged or not of a run"):
        text = _page(folder, summary, _body_picture(folder, field, component, scale))
    path = folder / FILE
    write_whole(path, text, wait=False)
    return path


def _page(folder: Path, summary: Mapping[str, Any], picture: str) -> str:
    history = read_history(folder) if (folder / "history.csv").exists() else {}
    title = folder.resolve().name
    status = str(summary.get("status"))
    good = status == "converged" and all(check.get("ok") for check in summary.get("checks") or [])
    counted = [("particles", f"particles in {summary.get('dimension')}D"), ("bonds", "bonds")]
    counted += [("gradient_points", "gradient points"), ("ranks", "ranks")]
    counts = [_counted(summary, name, words) for name, words in counted]
    versions = summary.get("versions") or {}
    sections = [
        ("out", "What came out", _came_out(summary, history, picture)),
        ("asked", "What was asked", _asked(summary)),
        ("convergence", "Convergence", _convergence(summary)),
        ("timing", "Time and memory", _timing(summary)),
    ]
    links = "".join(f'<a href="#{key}">{name}</a>' for key, name, _ in sections)
    body = "".join(f'<section id="{key}"><h2>{name}</h2>{content}</section>' for key, name, content in sections)
    made = ", ".join(f"{_safe(name)} {_safe(number)}" for name, number in versions.items())
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><meta name="generator" content="pdpetsc">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{_safe(title)}: report of a run</title><style>{_STYLE}</style></head><body>"
        f'<header><h1>{_safe(title)}</h1><p><span class="status{" good" if good else ""}">{_safe(status)}</span> '
        f"{_safe(', '.join(filter(None, counts)))}</p><nav>{links}</nav></header>"
        f"<main>{body}</main><footer><p>{made}</p></footer></body></html>\n"
    )


def _came_out(summary: Mapping[str, Any], history: Mapping[str, Any], picture: str) -> str:
    parts, labels = [_notes(summary)], Labels.of(summary)
    results = summary.get("results") or {}
    if results:
        parts.append(_table(["result", "value"], [[name, _number(value)] for name, value in results.items()]))
    checks = summary.get("checks") or []
    if checks:
        heads = ["check", "expected", "got", "difference", "tolerance", "", "source"]
        parts.append("<h3>Checks</h3>" + _table(heads, map(_checked, checks)))
    parts.append(picture)
    if len(history) > 2 and len(history["t"]):
        figure = curve_figure(history, labels)
        if figure is not None:
            parts.append(_figure(_png(figure), figure.axes[0].get_ylabel() + " against " + figure.axes[0].get_xlabel()))
        parts.append(_figure(_png(history_figure(history, labels)), "History"))
        last = [[labels.column(name), _number(float(values[-1]))] for name, values in history.items()]
        parts.append("<h3>Last row of the history</h3>" + _table(["column", "value"], last))
    return "".join(parts)


def _checked(check: Mapping[str, Any]) -> list[Any]:
    """Return the table row of a check."""
    numbers = [_number(check.get(name)) for name in ("value", "got", "difference", "tolerance")]
    word = _marked("ok", "ok") if check.get("ok") else _marked("wrong", "FAILED")
    return [check.get("result"), *numbers, word, check.get("source")]


def _body_picture(folder: Path, field: str | None, component: str, scale: float) -> str:
    """Return the picture of the deformed body; empty if the run has written no fields."""
    if not (folder / "fields.h5").exists():
        if field is not None:
            raise CaseError(f"{folder} holds no fields to draw.")
        return ""
    data = picture_of_run(folder, field, component, scale)
    return "" if data is None else _figure(data, "The deformed body at the last step")


def _notes(summary: Mapping[str, Any]) -> str:
    """Return the notes and warnings on the results."""
    notes = []
    status = summary.get("status")
    if status == "running":
        notes.append("This run has not ended, or was killed: what follows is what it has left so far.")
    elif status != "converged":
        notes.append(f"This run did not reach its end: {status}")
    if summary.get("detached_particles"):
        notes.append(f"{summary['detached_particles']} particles have too few bonds left for a gradient.")
    if summary.get("held_at_cut_families"):
        notes.append(
            f"{summary['held_at_cut_families']} particles are held at a face that cuts their families: stresses within "
            f"two horizons of it are those of no continuum."
        )
    notes += [str(note) for note in summary.get("notes") or []]
    if (summary.get("fracture_energy") or {}).get("note"):
        notes.append(str(summary["fracture_energy"]["note"]))
    notes += [str(warning) for warning in summary.get("warnings") or []]
    if summary.get("unused_options"):
        notes.append(f"Nothing used the options {', '.join(map(str, summary['unused_options']))}.")
    pieces = summary.get("pieces") or {}
    if pieces.get("pieces", 1) != 1:
        notes.append(f"The body is in {pieces['pieces']} pieces.")
    return "".join(f'<p class="note">{_safe(note)}</p>' for note in notes)


def _asked(summary: Mapping[str, Any]) -> str:
    parts = []
    if summary.get("command"):
        parts.append(f"<pre>{_safe(summary['command'])}</pre>")
    parameters = summary.get("parameters") or {}
    if parameters:
        rows = [[name, _number(value)] for name, value in parameters.items()]
        parts.append("<h3>Parameters</h3>" + _table(["parameter", "value"], rows))
    loads = summary.get("loads") or []
    if loads:
        rows = [
            [load.get("condition"), _number(load.get("t")), "  ".join(map(_number, load.get("resultant") or []))]
            for load in loads
        ]
        parts.append("<h3>Loads</h3>" + _table(["condition", "step time", "resultant"], rows))
    said = [("horizon", summary.get("horizon")), ("scheme", (summary.get("scheme") or {}).get("name"))]
    said.append(("solver", summary.get("solver")))
    units = summary.get("units") or {}
    if units:
        said.append(("units", ", ".join(str(unit) for unit in units.values() if unit)))
    parts.append(
        "<h3>Method</h3>" + _table(["", ""], [[name, _number(value)] for name, value in said if value is not None])
    )
    options = summary.get("options") or {}
    if options:
        rows = [[f"-{name}", _number(found.get("value")), found.get("from")] for name, found in options.items()]
        listed = _table(["option of PETSc", "value", "from"], rows)
        parts.append(f"<details><summary>{len(rows)} options of PETSc</summary>{listed}</details>")
    case = summary.get("case") or {}
    if case.get("text"):
        parts.append(
            f"<details open><summary>{_safe(case.get('file'))}</summary><pre>{_safe(case['text'])}</pre></details>"
        )
    return "".join(parts)


def _convergence(summary: Mapping[str, Any]) -> str:
    steps: Sequence[Mapping[str, Any]] = summary.get("steps") or []
    if not steps:
        done = summary.get("status") == "converged"
        return f"<p>{'No step was left to do.' if done else 'No step has converged.'}</p>"
    counted = [key for key in steps[0] if key.endswith("_iterations")]
    shown = steps if len(steps) <= ROWS else [
        *steps[: ROWS // 2], *(step for step in steps[ROWS // 2 : -ROWS // 2] if step.get("cut_backs")),
        *steps[-ROWS // 2 :],
    ]  # fmt: skip
    broke = any(step.get("broken_bonds") for step in steps)
    heads = ["step", "t", *(key.removesuffix("_iterations").replace("_", " ") + " its" for key in counted)]
    heads += [
        "residual",
        "reference force",
        *(["broken bonds"] if broke else []),
        "cut back",
        "negative pivots",
        "ended by",
    ]
    rows = []
    for step in shown:
        norms = [norm for norm in step.get("norms") or [] if norm is not None]
        reference = step.get("reference") or 0.0
        relative = norms[-1] / reference if norms and reference else math.nan
        pivots = step.get("negative_pivots")
        rows.append(
            [
                str(step.get("step")), _number(step.get("t")), *(_number(step.get(key)) for key in counted),
                f"{relative:.1e}", _number(reference), *([_number(step.get("broken_bonds") or 0)] if broke else []),
                _number(len(step.get("cut_backs") or [])),
                _marked("wrong", str(pivots)) if pivots else _number(pivots), step.get("reason"),
            ]
        )  # fmt: skip
    left = f"<p>{len(shown)} of {len(steps)} steps.</p>" if len(shown) < len(steps) else ""
    total = sum(int(step.get(key) or 0) for step in steps for key in counted if not key.startswith("linear"))
    linear = sum(int(step.get("linear_iterations") or 0) for step in steps)
    words = f"{len(steps)} steps, {total} iterations, {linear} linear iterations; residuals over forces and reactions."
    figure = _figure(_png(newton_figure(summary)), "Residual by iteration") if len(steps) <= 2 * ROWS else ""
    return f"<p>{words}</p>" + figure + _table(heads, rows) + left


def _timing(summary: Mapping[str, Any]) -> str:
    timings = {name: float(value) for name, value in (summary.get("timings") or {}).items()}
    total = sum(timings.values())
    rows = [
        [name, f"{seconds:.3f}", _bar(seconds / total if total else 0.0)]
        for name, seconds in sorted(timings.items(), key=lambda item: -item[1])
    ]
    parts = [_table(["phase", "seconds", ""], [*rows, ["all", f"{total:.3f}", ""]])] if rows else []
    if rows and isinstance(summary.get("restart"), dict):
        parts.append(f"<p>Seconds are those since the restart at step {_number(summary['restart'].get('step'))}.</p>")
    memory = summary.get("peak_memory_bytes") or []
    if memory:
        largest, whole = max(memory) / 2**20, sum(memory) / 2**20
        parts.append(f"<p>Peak memory: {whole:.0f} MiB on all ranks, {largest:.0f} MiB on the largest one.</p>")
    return "".join(parts) or "<p>Nothing was timed.</p>"


class _Cell(str):
    """A cell of a table as HTML."""


def _marked(style: str, text: str) -> _Cell:
    """Return a word in a table with a CSS class."""
    return _Cell(f'<td class="{style}">{_safe(text)}</td>')


def _bar(fraction: float) -> _Cell:
    """Return a fraction drawn as a bar."""
    return _Cell(f'<td class="text"><span class="bar" style="width:{20.0 * fraction:.2f}rem"></span></td>')


def _table(heads: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    return f'<div class="wide">{table_html(heads, (list(map(_cell, row)) for row in rows))}</div>'


def _cell(value: Any) -> str:
    if isinstance(value, _Cell):
        return value
    text = "" if value is None else str(value)
    return f"<td{'' if _is_number(text) or not text else ' class=text'}>{_safe(text)}</td>"


def _is_number(text: str) -> bool:
    with contextlib.suppress(ValueError):
        float(text)
        return True
    return False


def _number(value: Any) -> str:
    return "none" if value is None else text_of(value, 8)


def _counted(summary: Mapping[str, Any], name: str, words: str) -> str:
    count = summary.get(name)
    return f"{count:,} {words if count != 1 else words.removesuffix('s')}" if isinstance(count, int) and count else ""


def _figure(data: bytes, caption: str) -> str:
    encoded = base64.b64encode(data).decode()
    return (
        f'<figure><img alt="{_safe(caption)}" src="data:image/png;base64,{encoded}">'
        f"<figcaption>{_safe(caption)}</figcaption></figure>"
    )


def _png(figure: Any) -> bytes:
    data = io.BytesIO()
    figure.savefig(data, format="png", dpi=110)
    return data.getvalue()


def _safe(text: Any) -> str:
    return html.escape(str(text))
