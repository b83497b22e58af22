"""Tables of values by columns, as text, CSV and HTML."""

from __future__ import annotations

import csv
import html
import io
from collections.abc import Iterable, Sequence
from typing import Any


def text_of(value: Any, digits: int = 6) -> str:
    """Return the text of a table cell: floating-point numbers with ``digits`` digits, empty for None."""
    if value is None:
        return ""
    return f"{value:.{digits}g}" if isinstance(value, float) else str(value)


def csv_of(rows: Iterable[Iterable[Any]]) -> str:
    """Return rows of values as CSV, with None as an empty word."""
    text = io.StringIO(newline="")
    csv.writer(text).writerows(rows)
    return text.getvalue()


def aligned(rows: Sequence[Sequence[str]], left: Sequence[int] = ()) -> list[str]:
    """Return a line of text for each row, with columns of constant width, left-aligned for those in ``left``."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = []
    for row in rows:
        cells = [f"{word:{'<' if n in left else '>'}{widths[n]}}" for n, word in enumerate(row)]
        lines.append("  ".join(cells).rstrip())
    return lines


def cell(value: Any, digits: int = 6) -> str:
    """Return the HTML table cell of a value."""
    return f"<td>{html.escape(text_of(value, digits))}</td>"


def table_html(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return an HTML table of cells, with a header unless all heads are empty."""
    head = "".join(f"<th>{html.escape(name)}</th>" for name in heads)
    top = f"<thead><tr>{head}</tr></thead>" if any(heads) else ""
    body = "".join(f"<tr>{''.join(row)}</tr>" for row in rows)
    return f"<table>{top}<tbody>{body}</tbody></table>"
