"""What the command line does besides running a case: the module of each command, imported on first use."""

from __future__ import annotations

from collections.abc import Mapping

COMMANDS: Mapping[str, str] = {
    "plot": "pdpetsc.command_line.plot",
    "report": "pdpetsc.command_line.report",
    "compare": "pdpetsc.command_line.compare",
    "study": "pdpetsc.command_line.study",
    "fit": "pdpetsc.command_line.fit",
    "new": "pdpetsc.command_line.new",
    "import": "pdpetsc.command_line.import_deck",
    "doctor": "pdpetsc.command_line.doctor",
}
# Commands that write the same files from every process that runs them.
ALONE = {"plot", "report", "new", "import"}
