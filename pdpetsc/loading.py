"""Loads what pdpetsc stands on, or says in one sentence what cannot be loaded, and what to do."""

from __future__ import annotations

import importlib
import os

# One thread per rank, unless the user says otherwise: BLAS reads this when numpy is first imported, in a script of the
# user's perhaps before pdpetsc.
os.environ.setdefault("OMP_NUM_THREADS", "1")
# Compiled parts that may not fit each other, in the order in which they are loaded.
COMPILED = {"numpy": "numpy", "numba": "numba", "mpi4py": "mpi4py.MPI", "h5py": "h5py"}
# What extension modules say that were built for another numpy than the one that is there.
OTHER_NUMPY = ("numpy.dtype size changed", "numpy.core.multiarray failed", "_ARRAY_API not found", "NumPy 1.x")
_ADVICE = {
    "petsc4py": (
        "take python3-petsc4py of Debian, petsc4py of conda-forge, or pip install petsc petsc4py; a virtual "
        "environment sees that of the system with --system-site-packages"
    ),
    "mpi4py": "take it from where petsc4py is from, so that both stand on the same MPI",
}


def load() -> None:
    """Load what everything needs; raises ImportError with one sentence where it cannot be loaded."""
    for name, module in COMPILED.items():
        try:
            importlib.import_module(module)
        except Exception as error:
            raise ImportError(f"{cannot_load(name, error)}.", name=name) from error


def cannot_load(name: str, error: BaseException) -> str:
    """Return why a package cannot be loaded, and after a semicolon what to do."""
    said = " ".join(str(error).split())
    if isinstance(error, ModuleNotFoundError) and (error.name or "").split(".")[0] == name:
        return f"{name} is not installed; {_ADVICE.get(name, f'pip install {name}')}"
    if any(words in said for words in OTHER_NUMPY):
        numpy = str(importlib.import_module("numpy").__version__)
        old = int(numpy.split(".")[0]) > 1
        built, pin = ("an earlier", "numpy<2") if old else ("a later", "numpy>=2")
        return (
            f'{name} cannot be loaded with numpy {numpy}, as it was built for {built} one; pip install "{pin}" in this '
            f"environment, or another {name}"
        )
    return f"{name} cannot be loaded, {type(error).__name__}: {said or 'without a word'}; install it anew"


load()
