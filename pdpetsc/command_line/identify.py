"""``python -m pdpetsc.command_line.identify CASE.py``: the identities of the runs of a study.

Standard input is a list of parameter sets in JSON. The first line of the output describes the parameters of the case;
each further line, also in JSON, answers one set. A set that ends the process has no line.
"""

from __future__ import annotations

import dataclasses
import json
import math
import os
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from pdpetsc.command_line.case_file import arguments_of, load_case, make_case
from pdpetsc.command_line.start import start_petsc
from pdpetsc.declared import input_files
from pdpetsc.errors import CaseError, PdpetscError, described
from pdpetsc.machine import versions


def main(path: Path) -> None:
    """Write the identities of all sets of standard input."""
    # Output of a case must not be mixed with the answers.
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)

    def say(answer: Mapping[str, Any]) -> None:
        print(json.dumps(answer), file=answers, flush=True)

    try:
        start_petsc()
        function = load_case(path)
        defaults = arguments_of(function, {})
        version, sources = _version(), _sources(path)
    except BaseException as error:
        say({"refused": str(described(error))})
        return
    say({"kinds": {name: type(value).__name__ for name, value in defaults.items()}})
    for given in json.load(sys.stdin):
        say(_answer(path, function, given, sources, version))


def _version() -> dict[str, Any]:
    from pdpetsc import __version__
    from pdpetsc.petsc.library import petsc_version
    from pdpetsc.studies.run_identity import own_sources

    return {"pdpetsc": __version__, "sources": own_sources(), "petsc": petsc_version(), "versions": versions()}


def _sources(path: Path) -> list[Path]:
    """Return the case file and the modules of the user that it has imported."""
    from pdpetsc.output.fingerprint import of_library

    files = [getattr(module, "__file__", None) for module in list(sys.modules.values())]
    return [path, *(Path(file) for file in files if isinstance(file, str) and not of_library(file))]


def _answer(
    path: Path,
    function: Callable[..., Any],
    given: Mapping[str, str],
    sources: list[Path],
    version: Mapping[str, Any],
) -> dict[str, Any]:
    from pdpetsc.output.fingerprint import fingerprint
    from pdpetsc.studies.run_identity import contents

    try:
        values = arguments_of(function, given)
    except CaseError as error:
        return {"wrong": str(error)}
    answer: dict[str, Any] = {"given": {name: _short(values[name], text) for name, text in given.items()}}
    try:
        case = make_case(path, function, values)
    except PdpetscError as error:
        return {**answer, "refused": str(error)}
    declared = {field.name: fingerprint(getattr(case, field.name)) for field in dataclasses.fields(case)}
    answer["identity"] = {
        "parameters": {name: repr(value) for name, value in values.items()}, "declared": fingerprint(declared),
        "files": contents([*sources, *input_files(case)], path.parent), **version,
    }  # fmt: skip
    answer["expected"] = {name: one.value for name, one in case.expect.items() if math.isfinite(one.value)}
    return answer


def _short(value: Any, text: str) -> str:
    """Return the canonical text of a number: equal for 1, 1.0 and 1e0."""
    from pdpetsc.studies.sets import text_of

    return text_of(value) if isinstance(value, bool | int | float) else text


if __name__ == "__main__":
    main(Path(sys.argv[1]))
