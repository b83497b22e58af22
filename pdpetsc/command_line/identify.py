"""``python -m pdpetsc.command_line.identify CASE.py``: what the runs of a study are of, asked line by line.

It says in one line of JSON which parameters the case has, and then answers each line of standard input, a parameter
set, with one: what a run with it would be of.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import math
import os
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from pdpetsc.command_line.cli import arguments_of, load_case, make_case
from pdpetsc.command_line.start import start_petsc
from pdpetsc.errors import CaseError, PdpetscError, described
from pdpetsc.machine import versions

if TYPE_CHECKING:
    from pdpetsc.studies.input_files import Watch


def main(path: Path) -> None:
    """Answer until standard input ends."""
    # What a case prints must not stand between the answers.
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    try:
        start_petsc()
        from pdpetsc.petsc.library import petsc_version
        from pdpetsc.studies.input_files import Watch

        watch = Watch()
        function = load_case(path)
        # A call is of the case as it is now, whatever its files become.
        before = _Before(watch, watch.contents(), _texts(path))
        defaults = arguments_of(function, {})
        kinds = {name: type(value).__name__ for name, value in defaults.items()}
        # The version of pdpetsc, and what its sources are, the study knows itself.
        first: dict[str, Any] = {"kinds": kinds, "petsc": petsc_version(), "versions": versions()}
    except BaseException as error:
        _say(answers, {"refused": str(described(error))})
        return
    _say(answers, first)
    for line in sys.stdin:
        given = json.loads(line)
        try:
            values = arguments_of(function, given)
        except CaseError as error:
            _say(answers, {"wrong": str(error)})
            continue
        asked = {name: _short(values[name], text) for name, text in given.items()}
        _say(answers, {"given": asked, **_in_a_fork(path, function, values, before)})


def _short(value: Any, text: str) -> str:
    """Return the one text for a number, however it is written: 1, 1.0 and 1e0."""
    from pdpetsc.studies.sets import text_of

    return text_of(value) if isinstance(value, bool | int | float) else text


def _say(answers: TextIO, answer: Mapping[str, Any]) -> None:
    with contextlib.suppress(BrokenPipeError):
        answers.write(json.dumps(answer) + "\n")
        answers.flush()


@dataclasses.dataclass(frozen=True)
class _Before:
    """What has been read before any call: files of Python, and fingerprints of the case and what it imports."""

    watch: Watch
    files: Mapping[str, str]
    texts: Mapping[str, str]


def _in_a_fork(path: Path, function: Callable[..., Any], values: Mapping[str, Any], before: _Before) -> dict[str, Any]:
    """Return the answer that a fork of this process finds; nothing where the case ends it."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        with contextlib.suppress(BaseException):
            os.close(reading)
            text = json.dumps(_answer(path, function, values, before))
            with os.fdopen(writing, "w") as stream:
                stream.write(text)
        os._exit(0)
    os.close(writing)
    with os.fdopen(reading) as stream:
        text = stream.read()
    os.waitpid(child, 0)
    try:
        return dict(json.loads(text))
    except ValueError:
        return {}


def _answer(path: Path, function: Callable[..., Any], values: Mapping[str, Any], before: _Before) -> dict[str, Any]:
    from pdpetsc.output.fingerprint import fingerprint

    try:
        case = make_case(path, function, values)
    except PdpetscError as error:
        return {"refused": str(error)} if error.exit_status == 2 else {}
    declared = {f.name: fingerprint(getattr(case, f.name)) for f in dataclasses.fields(case)}
    found: dict[str, Any] = {
        "declared": fingerprint(declared), "text": {**_texts(path), **before.texts},
        "parameters": {k: repr(v) for k, v in values.items()}
    }  # fmt: skip
    expected = {name: one.value for name, one in getattr(case, "expect", {}).items()}
    return {
        "identity": found, "expected": {name: v for name, v in expected.items() if math.isfinite(v)},
        "files": {**before.watch.contents(), **before.files},
    }  # fmt: skip


def _texts(path: Path) -> dict[str, str]:
    """Return the fingerprints of the case file and of what it has imported that is of no library."""
    from pdpetsc.output.fingerprint import of_library

    folder = path.resolve().parent
    files = {path.resolve()}
    for module in list(sys.modules.values()):
        file = getattr(module, "__file__", None)
        if isinstance(file, str) and not of_library(file):
            files.add(Path(file).resolve())
    found = {}
    for file in sorted(files):
        with contextlib.suppress(OSError):
            found[os.path.relpath(file, folder)] = hashlib.sha256(file.read_bytes()).hexdigest()[:24]
    return found


if __name__ == "__main__":
    main(Path(sys.argv[1]))
