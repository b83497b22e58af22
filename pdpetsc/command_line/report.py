"""``python -m pdpetsc report DIR``: the page of a finished or stopped run."""

from __future__ import annotations

import math
from collections.abc import Sequence

from pdpetsc.command_line.arguments import split
from pdpetsc.command_line.case_file import convert
from pdpetsc.errors import CaseError
from pdpetsc.output.report import write_report

_FIRST = "usage: python -m pdpetsc report DIR [field=NAME] [component=xx] [scale=1]"
USAGE = f"{_FIRST}\n\nWrites DIR/report.html: what was asked, what came out, convergence, timing, pictures."


def main(argv: Sequence[str]) -> int:
    """Run the command ``report``; return its exit status."""
    arguments = split(argv)
    if "--help" in arguments.flags or not argv:
        print(USAGE)
        return 0 if argv else 2
    unknown = [name for name in arguments.parameters if name not in ("field", "component", "scale")]
    others = (
        arguments.petsc or arguments.output or arguments.restart or arguments.solver or "--check" in arguments.flags
    )
    if arguments.path is None or unknown or others:
        raise CaseError(f"report takes a folder, field, component and scale; {_FIRST}.")
    given = arguments.parameters
    scale = convert("scale", given.get("scale", "1"), 1.0)
    if not math.isfinite(scale):
        raise CaseError(f"scale takes a number, not {given['scale']}.")
    if "component" in given and "field" not in given:
        raise CaseError("report takes a component of a field; give the field besides.")
    print(write_report(arguments.path, given.get("field"), given.get("component", ""), scale))
    return 0
