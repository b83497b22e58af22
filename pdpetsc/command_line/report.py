"""Write a report of a finished or stopped run.

usage: python -m pdpetsc report DIR [field=NAME] [component=xx] [scale=1]

Writes DIR/report.html: case, results, convergence, timing, pictures.
"""

from __future__ import annotations

import math
from pathlib import Path

from pdpetsc.command_line.arguments import Arguments
from pdpetsc.command_line.case_file import convert
from pdpetsc.errors import CaseError
from pdpetsc.output.report import write_report


def run(path: Path, arguments: Arguments) -> int:
    """Execute the command."""
    given = arguments.parameters
    scale = convert("scale", given.get("scale", "1"), 1.0)
    if not math.isfinite(scale):
        raise CaseError(f"scale takes a number, not {given['scale']}.")
    if "component" in given and "field" not in given:
        raise CaseError(f"component={given['component']} requires the field as well: field=NAME component=xx.")
    print(write_report(path, given.get("field"), given.get("component", ""), scale))
    return 0
