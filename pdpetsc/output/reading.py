"""Reading the results of a run from its folder: summary, history, fields."""

from __future__ import annotations

import contextlib
import csv
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import h5py
import numpy as np
from numpy.typing import NDArray

from pdpetsc.arrays import Float
from pdpetsc.declared import fits, shown, words_of
from pdpetsc.errors import CaseError, PdpetscError
from pdpetsc.output.files import open_hdf5

_TABLE: TypeAlias = Mapping[str, Any]
_ROWS: TypeAlias = Sequence[Mapping[str, Any]]
# Types of the entries of a summary that are read.
_OF_SUMMARY: dict[str, Any] = {
    "status": str, "results": _TABLE, "doubts": Mapping[str, _TABLE], "dimension": int, "thickness": float,
    "horizon": float, "cuts": _ROWS, "cracks": Sequence[Sequence[Sequence[float]]], "steps": _ROWS, "checks": _ROWS,
    "loads": _ROWS, "timings": Mapping[str, float], "peak_memory_bytes": Sequence[float], "parameters": _TABLE,
    "versions": _TABLE, "options": _TABLE, "scheme": _TABLE, "control": _TABLE, "unbalanced": _TABLE, "pieces": _TABLE,
    "fracture_energy": _TABLE, "case": _TABLE, "restart": _TABLE, "unused_options": Sequence[str],
    "warnings": Sequence[str], "picture": _TABLE,
}  # fmt: skip


@contextlib.contextmanager
def refusing_damage(sentence: str) -> Iterator[None]:
    """Turn errors of the body on damaged files into a CaseError that begins with a sentence."""
    try:
        yield
    except PdpetscError:
        raise
    except (OSError, ValueError, TypeError, KeyError, AttributeError, IndexError) as error:
        what = " ".join(str(error).split()) or type(error).__name__
        raise CaseError(f"{sentence}: {what}.") from error


def read_summary(folder: Path) -> dict[str, Any]:
    """Return the content of ``summary.json``; raises CaseError if it is missing or damaged."""
    try:
        found = json.loads((folder / "summary.json").read_text())
    except (OSError, ValueError, RecursionError) as error:
        raise CaseError(f"{folder} holds no summary.json of a run.") from error
    if not isinstance(found, dict):
        raise CaseError(f"{folder} holds a summary.json that is not of a run.")
    for name, hint in _OF_SUMMARY.items():
        if found.get(name) is not None and not fits(found[name], hint):
            raise CaseError(
                f"{folder} holds a summary.json that is damaged or not of a run: {name} is {shown(found[name])}, not "
                f"{words_of(hint)}."
            )
    if found.get("dimension") not in (None, 1, 2, 3):
        raise CaseError(
            f"{folder} holds a summary.json that is damaged or not of a run: dimension is {found['dimension']}."
        )
    return found


def crack_records(summary: Mapping[str, Any]) -> Sequence[Mapping[str, Any]]:
    """Return the records of the initial cracks of a run; earlier versions recorded only lines of plane bodies."""
    if summary.get("cuts") is not None:
        return summary["cuts"]  # type: ignore[no-any-return]
    return [{"kind": "Polyline", "points": line} for line in summary.get("cracks") or [] if len(line) > 1]


def read_history(folder: Path) -> dict[str, Float]:
    """Return the columns of ``history.csv`` (n_steps,) by name; raises CaseError as ``read_table``."""
    return read_table(folder / "history.csv")


def read_table(path: Path) -> dict[str, Float]:
    """Return the columns of a table of a run by name, without an incomplete last row.

    Raises
    ------
    CaseError
        There is no such table, or it contains something other than numbers.
    """
    try:
        text = path.read_text()
    except (OSError, ValueError) as error:
        raise CaseError(f"{path.parent} holds no {path.name} of a run.") from error
    rows = list(csv.reader(text[: text.rfind("\n") + 1].splitlines()))
    if not rows or rows[0][:2] != ["step", "t"] or any(len(row) != len(rows[0]) for row in rows):
        raise CaseError(f"{path.parent} holds a {path.name} that is not of a run.")
    try:
        values = np.array([[float(word) for word in row] for row in rows[1:]]).reshape(-1, len(rows[0]))
    except ValueError as error:
        raise CaseError(f"{path.parent} holds a {path.name} with something else than numbers: {error}.") from error
    return {name: values[:, column] for column, name in enumerate(rows[0])}


class StoredFields:
    """The fields of a run in its folder, all particles in creation order.

    Parameters
    ----------
    folder : Path
        Folder of the run.
    run : str, optional
        Identifier of the run that must have written the fields.

    Attributes
    ----------
    run : str or None
        Identifier of the run that wrote the fields; None if the file does not record it.
    steps : list of int
        The stored steps.
    n_particles : int
        Number of particles.

    Raises
    ------
    CaseError
        The folder has no readable fields. Every method raises it if a step or field does not exist.
    """

    def __init__(self, folder: Path, run: str | None = None) -> None:
        self._path = folder / "fields.h5"
        with self._open() as file:
            found = file["particles"].attrs.get("run")
            self.run = None if found is None else str(found)
            if run is not None and self.run != run:
                raise CaseError(
                    f"{folder} holds the fields of a later run; those of this one are in earlier/, or gone."
                )
            self.steps = sorted(int(group.removeprefix("step_")) for group in file if group.startswith("step_"))
            self.n_particles = len(file["particles/id"])
        if not self.steps:
            raise CaseError(f"{self._path} has no step yet.")

    def names(self, step: int | None = None) -> list[str]:
        """Return the names of the fields of a step, the last one by default."""
        with self._open() as file:
            return list(file[self._group(step)])

    def is_entry(self, name: str) -> bool:
        """Return True if a field is an entry of another field, as ``stress_xx`` of ``stress``."""
        with self._open() as file:
            return bool(file[self._group(None)][name].is_virtual)

    def field(self, name: str, step: int | None = None, stride: int = 1) -> NDArray[Any]:
        """Return a field of a step, the last one by default: (n,), (n, 3) or (n, 3, 3).

        Parameters
        ----------
        stride : int
            Return every ``stride``-th particle only.
        """
        group = self._group(step)
        with self._open() as file:
            if name not in file[group]:
                raise CaseError(f"{self._path} has no field {name!r}; it has {', '.join(file[group])}.")
            values = np.asarray(file[group][name][::stride])
        return values.reshape(-1, 3, 3) if values.ndim == 2 and values.shape[1] == 9 else values

    def time(self, step: int | None = None) -> float:
        """Return the step time of a step, the last one by default [-]."""
        with self._open() as file:
            return float(file[self._group(step)].attrs["t"])

    def of_particles(self, name: str, stride: int = 1) -> NDArray[Any]:
        """Return ``position`` (n, 3) [length], ``volume`` (n,), ``id`` (n,) or ``body`` (n,) of the particles."""
        with self._open() as file:
            return np.asarray(file[f"particles/{name}"][::stride])

    @property
    def body(self) -> NDArray[np.int64]:
        """Return the number of the body of each particle (n,), 0 for one body."""
        with self._open() as file:
            found = file["particles"].get("body")
            return np.zeros(self.n_particles, dtype=np.int64) if found is None else np.asarray(found, dtype=np.int64)

    def _group(self, step: int | None) -> str:
        number = self.steps[-1] if step is None else step
        if number not in self.steps:
            raise CaseError(f"{self._path} has no fields of step {number}.")
        return f"step_{number:05d}"

    @contextlib.contextmanager
    def _open(self) -> Iterator[h5py.File]:
        try:
            with open_hdf5(self._path) as file:
                yield file
        except (OSError, KeyError, RuntimeError, ValueError) as error:
            if isinstance(error, CaseError):
                raise
            raise CaseError(
                f"Cannot read {self._path}: no such file, not one of pdpetsc, or without fields/."
            ) from error
