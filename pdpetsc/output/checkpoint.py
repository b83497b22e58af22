"""``checkpoint.h5``: the state from which a run continues, readable on any number of ranks."""

from __future__ import annotations

import hashlib
import itertools
import json
import stat
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import IO, Any

import h5py
import numpy as np
from numpy.typing import NDArray

from pdpetsc.arrays import Float, GlobalIndex
from pdpetsc.declared import Declared, Finite, Natural
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.communicator import agreed, is_root, largest, total
from pdpetsc.errors import CaseError, OutputError
from pdpetsc.output.broken import BrokenBonds
from pdpetsc.output.files import (
    WRITE_ERRORS,
    InCreationOrder,
    cannot_write,
    open_hdf5,
    rank_by_rank,
    replacing,
    writing_hdf5,
)
from pdpetsc.output.fingerprint import differing
from pdpetsc.output.history import History
from pdpetsc.output.observer import Observed, Observer, Origin
from pdpetsc.output.records import plain
from pdpetsc.post.solution import Solution
from pdpetsc.problem.problem import Problem
from pdpetsc.problem.term import KeptArray
from pdpetsc.solvers.protocol import Converged

FORMAT = 11
_OTHER_VERSION = (
    f"is not a checkpoint of this version (format {FORMAT}); continue with the version of pdpetsc that wrote it, or "
    f"run the case from its beginning."
)
# The file begins with HEAD bytes that hold the checksum of all that follows. The checksum is verified before HDF5
# opens the file, because HDF5 can crash on damaged files.
HEAD = 512
SEAL = "pdpetsc checkpoint, sha256 of what follows the first 512 bytes: "
# Number of damaged bonds that a rank reads at a time.
BLOCK = 100_000
# Names of the stored texts: the records of all steps, and the tables of the run.
STEPS, TABLES = "steps", ("history", "broken_bonds")


@dataclass(frozen=True)
class Head(Declared):
    """Metadata of a checkpoint.

    Attributes
    ----------
    run : str
        Identifier of the run.
    t, step, work
        As for ``Solution``.
    resume : mapping of str to float
        Numbers from which the solver continues.
    identity : sequence of float
        Numbers that identify the body.
    virtual, tangent_virtual : sequence of float
        Virtual rows of the cell: of the unknowns, and of the displacement at which the next step evaluates its first
        tangent.
    damage : str
        Name of the damage law.
    frozen : bool
        True if bonds no longer fail.
    declared : mapping of str to str
        Fingerprints of the parts of the case.
    """

    run: str
    t: Finite
    step: Natural
    work: Finite
    resume: Mapping[str, Finite]
    identity: Sequence[Finite]
    virtual: Sequence[Finite]
    tangent_virtual: Sequence[Finite]
    damage: str
    frozen: bool
    declared: Mapping[str, str]


class Checkpoints(Observer):
    """Write checkpoints at regular steps and at the end of the run.

    The tables that a checkpoint contains are flushed to disk before it.

    Parameters
    ----------
    every : int
        Steps between checkpoints; 0 for none.
    declared : mapping of str to str
        Fingerprints of the parts of the case.
    tables : sequence of observer
        Observers that write the tables of the run.
    """

    def __init__(self, every: int, declared: Mapping[str, str], tables: Sequence[History | BrokenBonds]) -> None:
        self._every = every
        self._declared = declared
        self._tables = tables
        # Records of the steps as text, encoded once because a run does not change them.
        self._records: list[str] = []

    def begin(self, observed: Observed) -> None:
        """Count the initial state as saved."""
        super().begin(observed)
        self._saved = observed.last.step

    def step(self, solution: Solution, converged: Converged) -> Mapping[str, Any]:
        """Write a checkpoint if the step number is a multiple of ``every``."""
        if self._every > 0 and solution.step % self._every == 0:
            self._write(solution)
        return {}

    def end(self) -> None:
        """Write the checkpoint of the last step.

        Nothing is written if it is saved already, if checkpoints are off, or if inertia has advanced beyond this step.
        """
        problem, last = self.observed.problem, self.observed.last
        moves = problem.inertia is not None or problem.snap_inertia is not None
        beyond = moves and problem.converged != last.t
        if self._every > 0 and self._saved != last.step and not beyond:
            self._write(self.observed.last)

    def _write(self, solution: Solution) -> None:
        for observer in self._tables:
            observer.table.flush()
        texts: dict[str, bytes] = {}
        if is_root(self.observed.comm):
            new = self.observed.steps[len(self._records) : solution.step]
            self._records += [json.dumps(plain(record)) for record in new]
            texts[STEPS] = f"[{','.join(self._records)}]".encode()
        with agreed(self.observed.comm):
            if is_root(self.observed.comm):
                texts |= dict(observer.table.read() for observer in self._tables)
        path, run = self.observed.folder / "checkpoint.h5", self.observed.run
        write_checkpoint(solution, self.observed.order, path, run, self._declared, texts)
        self._saved = solution.step


def write_checkpoint(
    solution: Solution, order: InCreationOrder, path: Path, run: str, declared: Mapping[str, str],
    texts: Mapping[str, bytes],
) -> None:  # fmt: skip
    """Write the converged state to a temporary file and rename it to ``path`` (collective).

    The checkpoint holds the unknowns, the arrays of the terms, the damaged bonds, and the displacement at which the
    next step evaluates its first tangent. A continued run therefore starts the next step identically to the last digit.
    One checksum covers the file.

    Parameters
    ----------
    run : str
        Identifier of the run.
    declared : mapping of str to str
        Fingerprints of the parts of the case.
    texts : mapping of str to bytes
        The records of the steps and the tables, on rank 0.

    Raises
    ------
    OutputError
        The file cannot be written, or an array holds a value that is not a number. The previous checkpoint stays.
    """
    problem, u, cloud = solution.problem, solution.unknowns, solution.cloud
    comm, identity = cloud.comm, _identity(cloud)
    at = np.empty((0, cloud.dim)) if solution.tangent_at is None else solution.tangent_at
    virtual = comm.bcast((u[cloud.n_owned :].ravel(), at[cloud.n_owned :].ravel()), root=comm.size - 1)
    arrays = problem.arrays()
    with agreed(comm):
        for name, array in arrays.items():
            if not np.isfinite(array.values).all():
                raise OutputError(f"Cannot write {path}: {name} of a term is not a number; an earlier one stays.")
    tables = {"u": u[: cloud.n_owned]}
    if solution.tangent_at is not None:
        tables["tangent"] = at[: cloud.n_owned]
    for name, array in arrays.items():
        table = _by_particle(array, cloud)
        if table.shape[1]:  # an array that is empty on all ranks is not stored
            tables[f"terms/{name}"] = table
    # Name, array, number of rows and parts of each dataset; root receives the parts in this order.
    streams: list[tuple[str, NDArray[Any], int, Iterator[tuple[slice, NDArray[Any]]]]]
    streams = [(name, table, cloud.n_global, order.parts_on_root(table)) for name, table in tables.items()]
    if problem.bond_damage is not None:
        keys, states = problem.bond_damage.bonds.damaged()
        counts = comm.gather(len(keys)) or []
        for name, rows in (("bonds/keys", keys), ("bonds/states", states)):
            streams.append((name, rows, sum(counts), rank_by_rank(comm, rows, counts)))
    failure: OutputError | None = None
    if is_root(comm):
        texts = {name: zlib.compress(text, 1) for name, text in texts.items()}
        size = sum(n * rows.itemsize * rows.shape[1] for _, rows, n, _ in streams) + sum(map(len, texts.values()))
        try:
            with replacing(path) as aside:
                with writing_hdf5(aside, size + 2**16, libver="latest", userblock_size=HEAD) as file:
                    file.attrs["format"] = FORMAT
                    file.attrs["head"] = json.dumps(asdict(_head(solution, run, declared, identity, virtual)))
                    for name, text in texts.items():
                        file.create_dataset(f"texts/{name}", data=np.frombuffer(text, np.uint8))
                    for name, rows, n, parts in streams:
                        dataset = file.create_dataset(name, (n, *rows.shape[1:]), rows.dtype)
                        for place, part in parts:
                            dataset[place] = part
                seal(aside)
        except WRITE_ERRORS as error:
            failure = cannot_write(path, error)
    # The other ranks send here; root has to receive also after a failure.
    for _ in itertools.chain(*(parts for *_, parts in streams)):
        pass
    with agreed(comm):
        if failure is not None:
            raise failure


def seal(path: Path) -> None:
    """Write the checksum of an HDF5 file into its user block (not collective); raises OSError."""
    with path.open("r+b") as file:
        file.write(f"{SEAL}{_digest(file)}\n".encode())


def _digest(file: IO[bytes]) -> str:
    """Return the checksum of the bytes after the user block, and rewind the file."""
    digest = hashlib.sha256()
    file.seek(HEAD)
    while block := file.read(2**20):
        digest.update(block)
    file.seek(0)
    return digest.hexdigest()


def whole(path: Path) -> bool:
    """Return True if a sealed file is intact (not collective); raises OSError."""
    with path.open("rb") as file:
        return file.read(HEAD).rstrip(b"\0") == f"{SEAL}{_digest(file)}\n".encode()


def _check_seal(path: Path) -> None:
    """Raise CaseError if a file is no checkpoint or has changed since it was written."""
    try:
        with path.open("rb") as file:
            head = file.read(HEAD)
            if head.startswith(b"\x89HDF"):
                raise CaseError(f"{path} {_OTHER_VERSION}")
            if not head.startswith(SEAL.encode()):
                raise CaseError(f"Cannot read the checkpoint {path}: it is none of pdpetsc, or its beginning is lost.")
            if not whole(path):
                raise CaseError(f"Cannot read the checkpoint {path}: it is damaged; restart from another one.")
    except OSError as error:
        raise CaseError(f"Cannot read the checkpoint {path}: {error.strerror or error}.") from None


def _head(solution: Solution, run: str, declared: Mapping[str, str], identity: Float, virtual: Sequence[Float]) -> Head:
    """Return the metadata of the checkpoint of a solution."""
    damage = solution.problem.damage
    frozen = damage is not None and damage.frozen
    return Head(
        run, solution.t, solution.step, solution.work, solution.resume, identity.tolist(), virtual[0].tolist(),
        virtual[1].tolist(), _law(solution.problem), frozen, declared,
    )  # fmt: skip


def find_checkpoint(path: str | Path) -> Path:
    """Return the checkpoint at a path, or in the folder of a run at this path (not collective).

    Raises
    ------
    CaseError
        There is no checkpoint, or it cannot be accessed.
    """
    found = Path(path)
    try:
        if found.is_dir():
            found = found / "checkpoint.h5"
            if not found.exists():
                raise CaseError(
                    f"Cannot read the checkpoint {found}: the folder {path} holds none; a run that has ended before "
                    f"its first step, or that wrote none, begins anew without a restart."
                )
        if not stat.S_ISREG(found.stat().st_mode):
            raise CaseError(f"Cannot read the checkpoint {found}: it is not a file.")
    except CaseError:
        raise
    except (OSError, ValueError) as error:
        raise CaseError(f"Cannot read the checkpoint {found}: {getattr(error, 'strerror', None) or error}.") from None
    # Resolve links, which lead to the folder of the run that wrote the checkpoint.
    return found.resolve()


def read_checkpoint(
    problem: Problem, order: InCreationOrder, path: str | Path, declared: Mapping[str, str] | None = None,
    anyway: bool = False, any_load: bool = False,
) -> Origin:  # fmt: skip
    """Restore bonds and terms of a problem from a checkpoint, and return its state (collective).

    Parameters
    ----------
    path : str or Path
        The checkpoint or its folder.
    declared : mapping of str to str, optional
        Fingerprints of the parts of the case; not compared if omitted.
    anyway : bool
        Accept the checkpoint of another case, if it has the same number of particles and dimensions.
    any_load : bool
        True if the step time may be any number, as for path following; otherwise it must be in [0, 1].

    Raises
    ------
    CaseError
        The file is missing, damaged, of another version, body or case.
    """
    cloud, damage = problem.body.cloud, problem.bond_damage
    comm, rank = cloud.comm, cloud.comm.rank
    identity = _identity(cloud)
    n_virtual = comm.bcast(cloud.n_virtual, root=comm.size - 1)
    found, lacking = 0, 0
    arrays = problem.arrays()
    widths = {name: _width(array, cloud) for name, array in arrays.items()}
    widths = {name: width for name, width in widths.items() if width}
    arrays = {name: arrays[name] for name in widths}
    tables: dict[str, Float] = {}
    texts: dict[str, str] = {}
    with agreed(comm):
        path = find_checkpoint(path)
        if is_root(comm):
            _check_seal(path)
    with agreed(comm):
        try:
            with open_hdf5(path) as file:
                if "format" not in file.attrs or not np.array_equal(file.attrs["format"], FORMAT):
                    raise CaseError(f"{path} {_OTHER_VERSION}")
                head = Head(**json.loads(file.attrs["head"]))
                _refuse_other_body(path, head.identity[:2], identity[:2])
                if not anyway:
                    _refuse_other_body(path, head.identity, identity)
                    _refuse_other_case(path, head, problem, declared)
                _must(any_load or 0.0 <= head.t <= 1.0, f"its step time {head.t:g} is not in 0 to 1")
                _check_datasets(file, cloud, widths, head, n_virtual * cloud.dim, damage is not None)
                steps = _steps(file, head.step)
                if is_root(comm):
                    texts = {name: _text(file, name) for name in file["texts"] if name != STEPS}
                mine = slice(int(order.starts[rank]), int(order.starts[rank + 1]))
                part = np.asarray(file["u"][mine])
                tangent = np.asarray(file["tangent"][mine]) if "tangent" in file else None
                for array in (part, tangent):
                    _must(array is None or bool(np.isfinite(array).all()), "a displacement is not a number")
                tables = {name: np.asarray(file[f"terms/{name}"][mine]) for name in arrays}
                if "bonds" in file and damage is not None:
                    found = len(file["bonds/keys"])
                    for keys, states in _blocks(file, cloud.n_global):
                        lacking += damage.bonds.restore(keys, states)
        except CaseError:
            raise
        except Exception as error:  # any error of HDF5, h5py and numpy on a damaged file
            words = str(error).strip().rstrip(".") or type(error).__name__
            raise CaseError(f"Cannot read the checkpoint {path}: {words}; restart from another one.") from None
    lacking = found - int(total(comm, lacking))
    if lacking and not anyway:
        raise CaseError(
            f"Cannot read the checkpoint {path}: this body has {lacking} of its damaged bonds not or twice."
        )
    problem.freeze(head.frozen)
    if damage is not None:
        problem.bonds_restored()
    for name, stored in arrays.items():
        _put(stored, cloud, order.from_parts(tables[name]), f"{path}: {name}")
    problem.restored(head.t)
    u = _with_virtual(cloud, order.from_parts(part), head.virtual)
    at = None if tangent is None else _with_virtual(cloud, order.from_parts(tangent), head.tangent_virtual)
    if not problem.admissible(problem.state(u, head.t)):
        raise CaseError(f"Cannot read the checkpoint {path}: its displacements turn this body inside out.")
    # What is recorded of the start has the contact of the next step, not that of the undeformed body.
    problem.start_from(problem.state(u, head.t))
    start = Solution(problem, u, head.t, head.step, head.work, head.resume, at)
    return Origin(start, path, head.run, steps, texts)


def _with_virtual(cloud: Cloud, u: Float, virtual: Sequence[float]) -> Float:
    return np.concatenate([u, np.reshape(virtual, (-1, cloud.dim))]) if cloud.n_virtual else u


def _must(condition: bool, what: str) -> None:
    if not condition:
        raise ValueError(what)


def _text(file: h5py.File, name: str) -> str:
    return zlib.decompress(np.asarray(file[f"texts/{name}"]).tobytes()).decode(errors="replace")


def _steps(file: h5py.File, count: int) -> list[dict[str, Any]]:
    """Return the records of the steps; raises an error unless there is one for each step."""
    steps = json.loads(_text(file, STEPS))
    _must([record["step"] for record in steps] == [*range(1, len(steps) + 1)], "its steps are no records")
    _must(all({"t", "reference", "negative_pivots"} <= set(record) for record in steps), "its steps are no records")
    _must(len(steps) == count, f"it lacks records of its {count} steps")
    return list(steps)


def _refuse_other_body(path: Path, found: Sequence[float], identity: Float) -> None:
    if len(found) != len(identity) or not np.allclose(found, identity, rtol=1e-9, atol=0.0):
        raise CaseError(f"{path} is a checkpoint of another body: particles, positions or horizon differ.")


def _refuse_other_case(path: Path, head: Head, problem: Problem, declared: Mapping[str, str] | None) -> None:
    if head.damage != _law(problem):
        raise CaseError(f"{path} is of a case with damage {head.damage}, this has {_law(problem)}.")
    if declared is None:
        return
    other = differing(head.declared, declared)
    if other:
        verb = "differ" if len(other) > 1 or other[0].endswith("s") else "differs"
        raise CaseError(
            f"{path} is of another case: its {_listed(other)} {verb}; declare the same, or go on with it by "
            f"--restart-anyway (restart_anyway=True)."
        )


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _check_datasets(
    file: h5py.File, cloud: Cloud, widths: Mapping[str, int], head: Head, n_virtual: int, of_bonds: bool
) -> None:
    """Raise ValueError if a dataset is missing, unexpected, in another file, or of wrong type or shape."""
    # ``visititems`` does not follow links to other files.
    is_dataset: dict[str, bool] = {}
    file.visititems(lambda name, item: is_dataset.__setitem__(name, isinstance(item, h5py.Dataset)))
    columns: dict[str, tuple[tuple[int, ...], Any]] = {"u": ((cloud.dim,), np.float64)}
    if "tangent" in is_dataset:
        columns["tangent"] = columns["u"]
    columns |= {f"terms/{name}": ((width,), np.float64) for name, width in widths.items()}
    of_particles = list(columns)
    if "bonds" in is_dataset:
        columns |= {"bonds/keys": ((3,), np.int64), "bonds/states": ((2,), np.float64)}
    texts = [f"texts/{name}" for name in (STEPS, *TABLES) if name == STEPS or f"texts/{name}" in is_dataset]
    columns |= dict.fromkeys(texts, ((), np.uint8))
    groups = {name.split("/")[0] for name in columns if "/" in name}
    expected = dict.fromkeys(groups, False) | dict.fromkeys(columns, True)
    lacks, more = (sorted(set(one) - set(other)) for one, other in ((expected, is_dataset), (is_dataset, expected)))
    parts = [f"it {verb} {', '.join(names)}" for verb, names in (("lacks", lacks), ("also holds", more)) if names]
    _must(is_dataset == expected, " and ".join(parts) or f"it holds {', '.join(sorted(is_dataset))}")
    of_cell = (len(head.virtual), len(head.tangent_virtual))
    _must(of_cell == (n_virtual, n_virtual if "tangent" in is_dataset else 0), f"it has {of_cell} numbers of a cell")
    _must(not of_bonds or "bonds" in is_dataset, f"it lacks the bonds of {head.damage}")
    for name, (width, dtype) in columns.items():
        data = file[name]
        _must(data.ndim == 1 + len(width) and data.shape[1:] == width, f"{name} has the wrong shape")
        _must(data.dtype == dtype, f"{name} is of the wrong type")
        _must(name not in of_particles or len(data) == cloud.n_global, f"{name} is of {len(data)} particles")
        _must(not data.external and not data.is_virtual, f"the data of {name} are in another file")
    if "bonds" in is_dataset:
        _must(len(file["bonds/keys"]) == len(file["bonds/states"]), "its bonds are incomplete")


def _blocks(file: h5py.File, n: int) -> Iterator[tuple[GlobalIndex, Float]]:
    """Yield keys and states of damaged bonds in blocks; raises ValueError if they are invalid."""
    for begin in range(0, len(file["bonds/keys"]), BLOCK):
        rows = slice(begin, begin + BLOCK)
        keys, states = np.asarray(file["bonds/keys"][rows]), np.asarray(file["bonds/states"][rows])
        _must(bool(((keys[:, :2] >= 0) & (keys[:, :2] < n)).all()), "a damaged bond has an end that is no particle")
        _must(bool(((states[:, 0] >= 0.0) & (states[:, 0] <= 1.0)).all()), "a degradation factor is not in 0 to 1")
        _must(bool((np.isfinite(states[:, 1]) & (states[:, 1] >= 0.0)).all()), "a stretch of a bond is no number")
        yield keys, states


def _identity(cloud: Cloud) -> Float:
    """Return numbers that identify a body (collective)."""
    n = cloud.n_owned
    x, volume = cloud.x[:n], cloud.volume[:n]
    numbered = (cloud.gid[:n] % 97) @ np.abs(x).sum(axis=1)
    sums = total(cloud.comm, [volume.sum(), (x**2).sum(), numbered])
    periods = np.zeros(cloud.dim) if cloud.images is None else cloud.images.cell.lengths
    planes = [number for plane in cloud.places.planes.items() for number in plane]
    reach = cloud.local_horizon[:n]
    reaches = total(cloud.comm, [reach.sum(), (cloud.gid[:n] % 97) @ reach])[: 2 * cloud.varies]
    return np.array([cloud.n_global, cloud.dim, cloud.horizon, *periods, *sums, *planes, *reaches])


def _law(problem: Problem) -> str:
    return "none" if problem.damage is None else problem.damage.name


def _place(array: KeptArray) -> GlobalIndex:
    """Return the index of each row of an array among the rows of its particle."""
    first = np.searchsorted(array.owner, array.owner, side="left")
    return np.asarray(np.arange(len(array.owner)) - first)


def _width(array: KeptArray, cloud: Cloud) -> int:
    """Return the largest number of values per particle, over all ranks (collective)."""
    most = int(largest(cloud.comm, np.bincount(array.owner, minlength=1), initial=0))
    return most * int(np.prod(array.values.shape[1:]))


def _by_particle(array: KeptArray, cloud: Cloud) -> Float:
    """Return the values of each own particle (n_owned, width), padded with nan (collective)."""
    each = int(np.prod(array.values.shape[1:]))
    table = np.full((cloud.n_owned, _width(array, cloud) // max(each, 1), each), np.nan)
    table[array.owner, _place(array)] = array.values.reshape(len(array.owner), each)
    return table.reshape(cloud.n_owned, -1)


def _put(array: KeptArray, cloud: Cloud, table: Float, what: str) -> None:
    """Overwrite the values of an array from a table with a row for each own particle (collective)."""
    each = int(np.prod(array.values.shape[1:]))
    rows = table.reshape(cloud.n_owned, -1, each)
    counts = np.bincount(array.owner, minlength=cloud.n_owned)
    with agreed(cloud.comm):
        there = np.isfinite(rows).all(axis=2).sum(axis=1)
        if not np.array_equal(there, counts):
            raise CaseError(f"Cannot read the checkpoint {what} is not of this body or not of numbers.")
        if (rows < array.low).any() or (rows > array.high).any():
            limits = f"{array.low:g} to {array.high:g}"
            raise CaseError(f"Cannot read the checkpoint {what} is not in {limits}; restart from another one.")
    array.values[...] = rows[array.owner, _place(array)].reshape(array.values.shape)
