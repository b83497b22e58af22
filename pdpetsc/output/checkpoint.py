"""``checkpoint.h5``: what a continued run needs, readable on any number of ranks."""

from __future__ import annotations

import itertools
from pathlib import Path

import h5py
import numpy as np

from pdpetsc.arrays import Float, GlobalIndex
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.communicator import agreed, is_root, total
from pdpetsc.errors import CaseError, OutputError
from pdpetsc.loading import Loading
from pdpetsc.model import Model
from pdpetsc.output.files import InCreationOrder, rank_by_rank, replacing, reserve
from pdpetsc.solution import Solution

FORMAT = 4
# Damaged bonds that a rank looks at together.
BLOCK = 100_000


def write_checkpoint(solution: Solution, order: InCreationOrder, path: Path) -> None:
    """Write the converged state aside, then rename it over ``path`` (collective).

    It holds the unknowns and the bonds that are damaged.

    Raises
    ------
    OutputError
        The disk is full; an earlier checkpoint stays as it was.
    """
    model, u = solution.model, solution.unknowns
    cloud = model.cloud
    identity = _identity(cloud)
    keys, states = _damaged_bonds(model)
    counts = cloud.comm.gather(len(keys)) or []
    with agreed(cloud.comm):
        if is_root(cloud.comm):
            size = sum(counts) * (keys.itemsize * 3 + states.itemsize * 2)
            reserve(path.with_suffix(".new"), cloud.n_global * cloud.dim * 8 + size)
    failure: OutputError | None = None
    virtual = cloud.comm.bcast(u[cloud.n_owned :].ravel(), root=cloud.comm.size - 1)
    parts = order.parts_on_root(u[: cloud.n_owned])
    damaged = [rank_by_rank(cloud.comm, keys, counts), rank_by_rank(cloud.comm, states, counts)]
    if is_root(cloud.comm):
        try:
            with replacing(path) as aside, h5py.File(aside, "w") as file:
                file.attrs.update(format=FORMAT, t=solution.t, step=solution.step, work=solution.work)
                file.attrs["pace"] = np.asarray(solution.pace, dtype=float)
                file.attrs.update(identity=identity, virtual=virtual)
                file.attrs["damage"] = _law(model)
                dataset = file.create_dataset("u", (cloud.n_global, cloud.dim), np.float64)
                for rows, part in parts:
                    dataset[rows] = part
                for name, mine, of_ranks in zip(("keys", "states"), (keys, states), damaged, strict=True):
                    if model.failure is not None:
                        dataset = file.create_dataset(f"bonds/{name}", (sum(counts), *mine.shape[1:]), mine.dtype)
                        for rows, part in of_ranks:
                            dataset[rows] = part
        except (OutputError, RuntimeError) as error:
            failure = OutputError(str(error))
    for _ in itertools.chain(parts, *damaged):  # other ranks send here, and after a failure root still has to receive
        pass
    with agreed(cloud.comm):
        if failure is not None:
            raise failure


def read_checkpoint(model: Model, loading: Loading, order: InCreationOrder, path: Path) -> Solution:
    """Return the state of a checkpoint; restore the bonds of the body (collective).

    Raises
    ------
    CaseError
        The file is missing, damaged, of another version or of another body.
    """
    cloud = model.cloud
    identity = _identity(cloud)
    rank = cloud.comm.rank
    with agreed(cloud.comm):
        try:
            with h5py.File(path, "r") as file:
                if file.attrs.get("format") != FORMAT:
                    raise CaseError(f"{path} is not a checkpoint of this version (format {FORMAT}).")
                found = np.asarray(file.attrs["identity"])
                if found.shape != identity.shape or not np.allclose(found, identity, rtol=1e-9, atol=0.0):
                    raise CaseError(f"{path} is a checkpoint of another body: particles, positions or horizon differ.")
                if file.attrs["damage"] != _law(model):
                    raise CaseError(f"{path} is of a case with damage {file.attrs['damage']}, this has {_law(model)}.")
                if model.failure is not None and "bonds" in file:
                    for begin in range(0, len(file["bonds/keys"]), BLOCK):
                        rows = slice(begin, begin + BLOCK)
                        model.failure.restore(
                            np.asarray(file["bonds/keys"][rows]), np.asarray(file["bonds/states"][rows])
                        )
                part = np.asarray(file["u"][int(order.starts[rank]) : int(order.starts[rank + 1])])
                t, step, work = float(file.attrs["t"]), int(file.attrs["step"]), float(file.attrs["work"])
                pace = tuple(float(value) for value in file.attrs["pace"])
                virtual = np.asarray(file.attrs["virtual"]).reshape(-1, cloud.dim)
        except (OSError, KeyError, ValueError) as error:
            if isinstance(error, CaseError):
                raise
            raise CaseError(f"Cannot read the checkpoint {path}: {error}.") from None
    model.take_failure()
    u = order.from_parts(part)
    return Solution(model, loading, np.concatenate([u, virtual]) if cloud.n_virtual else u, t, step, work, pace)


def _identity(cloud: Cloud) -> Float:
    """Return numbers that tell one body from another (collective)."""
    n = cloud.n_owned
    x, volume = cloud.x[:n], cloud.volume[:n]
    numbered = (cloud.gid[:n] % 97) @ np.abs(x).sum(axis=1)
    sums = total(cloud.comm, [volume.sum(), (x**2).sum(), numbered])
    periods = np.zeros(cloud.dim) if cloud.images is None else cloud.images.cell.lengths
    return np.array([cloud.n_global, cloud.dim, cloud.horizon, *periods, *sums])


def _damaged_bonds(model: Model) -> tuple[GlobalIndex, Float]:
    """Return keys and states of the damaged bonds of this rank (not collective)."""
    if model.failure is None:
        return np.empty((0, 3), dtype=np.int64), np.empty((0, 2))
    return model.failure.damaged()


def _law(model: Model) -> str:
    return "none" if model.failure is None else type(model.failure.law).__name__
