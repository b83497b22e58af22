"""Write the case file of a deck of Peridigm or PeriLab.

usage: python -m pdpetsc import DECK [-o CASE.py] [--ignore NAME ...] [--static] [--overwrite]

  DECK           a deck of Peridigm (YAML, or XML of parameter lists) or PeriLab (YAML)
  -o CASE.py     the case file to write (default: the name of the deck, in this folder)
  --ignore NAME  ignore the entry or section of this name or path, such as Contact or Solver/Verlet, or a column of
                 the mesh of PeriLab; may be repeated
  --static       solve a dynamic deck (Verlet, Implicit, Newmark) statically
  --overwrite    replace an existing file

Every entry of the deck is translated, listed as a comment if it only selects output or tunes a solver, or refused by
name. Meshes stay in their place. The head of the written file lists the differences.
"""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

from pdpetsc.command_line.arguments import Arguments
from pdpetsc.command_line.case_file import load_case
from pdpetsc.decks import peridigm, perilab
from pdpetsc.decks.script import Deck, Notes, Script, plain
from pdpetsc.decks.sections import Section, read
from pdpetsc.errors import CaseError

Translate = Callable[[Deck], Script]


def import_deck(
    deck: Path, output: Path | None = None, ignore: Sequence[str] = (), static: bool = False, overwrite: bool = False
) -> tuple[Path, list[str]]:
    """Write the case of a deck.

    Parameters
    ----------
    deck : Path
        A deck of Peridigm or PeriLab.
    output : Path, optional
        The case file; by default the name of the deck, in the working folder.
    ignore : sequence of str
        Names or paths of entries and sections to ignore.
    static : bool
        If True, dynamic decks are solved statically.
    overwrite : bool
        If True, an existing file is replaced.

    Returns
    -------
    path, said : Path, list of str
        The file, and differences from the program of the deck.

    Raises
    ------
    CaseError
        The deck cannot be read or has entries without counterpart, or the file exists or cannot be written.
    """
    path = Path(f"{deck.stem}.py") if output is None else output
    if path.suffix != ".py":
        raise CaseError(f"A case file ends in .py, and {path} does not.")
    if path.exists() and not overwrite:
        raise CaseError(f"{path} is there already; give another name with -o, or --overwrite.")
    root = read(deck)
    notes = Notes(ignored=root.without(ignore))
    translate, root = _program(deck, root)
    left = [name for name in ignore if not any(entry.partition(" (line")[0].endswith(name) for entry in notes.ignored)]
    if left and translate is not perilab.translate:
        raise _nothing_called(deck, left[0])
    # Such names may be columns of the mesh, which is read later.
    notes.columns = {name.lower(): False for name in left}
    script = translate(Deck(deck, root, notes, path.parent, static))
    for name in left:
        if not notes.columns[name.lower()]:
            raise _nothing_called(deck, name)
    _write(path, script.text(), overwrite)
    return path, [*notes.differences, *(f"ignored {entry}" for entry in notes.ignored)]


def _nothing_called(deck: Path, name: str) -> CaseError:
    return CaseError(f"The deck {deck} has nothing called {name!r} to ignore.")


def _program(deck: Path, root: Section) -> tuple[Translate, Section]:
    """Return the translator of the deck, and its first section."""
    for name, translate in (("Peridigm", peridigm.translate), ("PeriLab", perilab.translate)):
        if name in root.sections:
            if len(root.sections) + len(root.entries) > 1:
                raise CaseError(f"The deck {deck} has other sections beside {name}. Put all of them below {name}.")
            return translate, root.sections[name]
    if "Materials" in root.sections and "Blocks" in root.sections:
        return peridigm.translate, root
    raise CaseError(f"{deck} is not a deck of Peridigm or PeriLab: it begins with {', '.join([*root.sections][:3])}.")


def _write(path: Path, text: str, overwrite: bool) -> None:
    """Write the case to a temporary file, check that it is a case, and rename it."""
    compile(text, str(path), "exec")
    trial = None
    try:
        with tempfile.NamedTemporaryFile(
            "w", suffix=".py", prefix=f".{path.stem}_", dir=path.parent, delete=False, encoding="utf-8"
        ) as file:
            trial = Path(file.name)
            file.write(text)
        load_case(trial)()
        if overwrite:
            os.replace(trial, path)
        else:
            os.link(trial, path)
    except FileExistsError:
        raise CaseError(f"{path} is there already; give another name with -o, or --overwrite.") from None
    except OSError as error:
        raise CaseError(f"Cannot write {path}: {error.strerror or error}.") from None
    finally:
        if trial is not None:
            with contextlib.suppress(OSError):
                trial.unlink()


def described(path: Path, said: Sequence[str]) -> str:
    """Return the output of the command."""
    return "\n".join([str(path), *(f"  {plain(line)}" for line in said)])


def run(path: Path, arguments: Arguments) -> int:
    """Execute the command."""
    written, said = import_deck(
        path, arguments.output, arguments.values.get("--ignore", ()), "--static" in arguments.flags,
        "--overwrite" in arguments.flags,
    )  # fmt: skip
    print(described(written, said))
    return 0
