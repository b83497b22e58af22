"""``python -m pdpetsc doctor``: whether what pdpetsc stands on works here, and what to do where it does not."""

from __future__ import annotations

import importlib
import os
import platform
import shutil
import time
from collections.abc import Callable
from importlib import metadata
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from pdpetsc.discrete.communicator import Comm, is_root, mpi_library, total
from pdpetsc.errors import described

USAGE = """usage: [mpirun -n N] python -m pdpetsc doctor

Looks at versions, MPI, PETSc, its direct solver, BLAS, HDF5, the cache of compiled kernels and the disk, and says what
to do about each. Ends with status 1 where pdpetsc cannot work."""

NEEDED = ("numpy", "scipy", "numba", "mpi4py", "petsc4py", "h5py", "meshio", "matplotlib", "rich", "sympy")
# What each of these gives.
OPTIONAL = {
    "netCDF4": "meshes in Exodus files",
    "pandas": "histories as data frames",
    "pyvista": "fields as PyVista meshes",
}
# What tells that a launcher has started several processes.
LAUNCHED = ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "PMIX_SIZE", "SLURM_STEP_NUM_TASKS")
# A product of matrices below this many operations a second is that of the reference BLAS [1 / s].
SLOW_BLAS = 5e9
SIDE = 600
# Room for results below which a warning is due [bytes].
LITTLE = 2**30


class Finding(NamedTuple):
    """What one check has found.

    Attributes
    ----------
    verdict : {"ok", "look", "broken"}
        Works; works, but not as it could; or pdpetsc cannot work.
    what : str
        What was looked at.
    found : str
        What is there.
    advice : str
        What to do about it; empty where nothing.
    """

    verdict: Literal["ok", "look", "broken"]
    what: str
    found: str
    advice: str = ""


def versions(comm: Comm) -> list[Finding]:
    """Return the versions of what is needed, and of what is useful."""
    found = [Finding("ok", "Python", f"{platform.python_version()} on {platform.machine()}")]
    there, missing = [], []
    for name in NEEDED:
        try:
            there.append(f"{name} {_version(name)}")
        except ImportError:
            missing.append(name)
    found.append(Finding("ok", "packages", ", ".join(there)))
    if missing:
        found.append(Finding("broken", "packages", f"no {', '.join(missing)}", f"pip install {' '.join(missing)}"))
    for name, use in OPTIONAL.items():
        try:
            found.append(Finding("ok", name, _version(name)))
        except ImportError:
            found.append(Finding("look", name, "not there", f"pip install {name} for {use}"))
    return found


def _version(name: str) -> str:
    """Return the version of a package that can be imported; distributions may know it by another name."""
    module = importlib.import_module(name)
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return str(getattr(module, "__version__", "of unknown version"))


def ranks(comm: Comm) -> list[Finding]:
    """Return whether the processes that were started are ranks of one job, and whether PETSc sees them too."""
    from petsc4py import PETSc

    library, size = mpi_library(), int(total(comm, 1))
    started = max((int(os.environ[name]) for name in LAUNCHED if os.environ.get(name, "").isdigit()), default=1)
    if started > size:
        return [
            Finding(
                "broken", "MPI", f"{started} processes, each alone ({library})",
                "build mpi4py and petsc4py with the MPI whose mpirun starts them, or start them with that one's mpirun",
            )
        ]  # fmt: skip
    if PETSc.COMM_WORLD.size != size:
        return [
            Finding(
                "broken", "MPI", f"{size} ranks, of which PETSc sees {PETSc.COMM_WORLD.size}",
                "build mpi4py and petsc4py with the same MPI",
            )
        ]  # fmt: skip
    return [Finding("ok", "MPI", f"{f'{size} ranks that hear each other' if size > 1 else '1 rank'}, {library}")]


def petsc(comm: Comm) -> list[Finding]:
    """Return how PETSc was built, and whether its direct solver factors a matrix."""
    from petsc4py import PETSc

    bits = 8 * np.dtype(PETSc.IntType).itemsize
    found = [Finding("ok", "PETSc", f"{'.'.join(str(n) for n in PETSc.Sys.getVersion())}, {bits}-bit indices")]
    if PETSc.ScalarType is not np.float64:
        kind = np.dtype(PETSc.ScalarType).name
        return [
            Finding("broken", "PETSc", f"numbers are {kind}", "install a PETSc of real numbers in double precision")
        ]
    try:
        apart = _factored(comm)
    except Exception as error:
        advice = "build PETSc with --download-mumps --download-scalapack, or take -pc_type gamg for all solves"
        return [*found, Finding("look", "MUMPS", str(described(error)), advice)]
    verdict: Literal["ok", "broken"] = "ok" if apart < 1e-10 else "broken"
    advice = "" if verdict == "ok" else "install another build of MUMPS and PETSc: its solutions are wrong"
    return [*found, Finding(verdict, "MUMPS", f"solves to {apart:.0e}", advice)]


def _factored(comm: Comm) -> float:
    """Return by how much a solve with MUMPS misses its known solution."""
    from petsc4py import PETSc

    n = 50 * comm.size
    A = PETSc.Mat().createAIJ((n, n), nnz=3, comm=comm)
    for i in range(*A.getOwnershipRange()):
        for j, value in ((i - 1, -1.0), (i, 2.5), (i + 1, -1.0)):
            if 0 <= j < n:
                A.setValue(i, j, value)
    A.assemble()
    ksp = PETSc.KSP().create(comm)
    ksp.setOptionsPrefix("doctor_")
    ksp.setOperators(A)
    ksp.setType("preonly")
    ksp.getPC().setType("lu")
    ksp.getPC().setFactorSolverType("mumps")
    exact, b, x = A.createVecRight(), A.createVecLeft(), A.createVecRight()
    exact.set(1.0)
    A.mult(exact, b)
    ksp.solve(b, x)
    x.axpy(-1.0, exact)
    apart = float(x.norm(PETSc.NormType.NORM_INFINITY))
    for one in (ksp, A, exact, b, x):
        one.destroy()
    return apart


def blas(comm: Comm) -> list[Finding]:
    """Return how fast matrices are multiplied, on how many threads."""
    A = np.ones((SIDE, SIDE))
    spent = []
    for _ in range(4):
        before = time.perf_counter()
        A @ A
        spent.append(time.perf_counter() - before)
    speed, threads = 2.0 * SIDE**3 / min(spent), os.environ.get("OMP_NUM_THREADS", "as many as it likes")
    found = f"{speed / 1e9:.0f} GFlop/s, OMP_NUM_THREADS {threads}"
    if speed < SLOW_BLAS:
        return [
            Finding("look", "BLAS", found, "install OpenBLAS in the place of the reference BLAS: MUMPS lives on it")
        ]
    return [Finding("ok", "BLAS", found)]


def hdf5(comm: Comm) -> list[Finding]:
    """Return whether several ranks write one file together."""
    import h5py

    version = h5py.version.hdf5_version
    if h5py.get_config().mpi:
        return [Finding("ok", "HDF5", f"{version}, parallel")]
    return [Finding("ok", "HDF5", f"{version}, serial here: rank 0 writes for all")]


def kernels(comm: Comm) -> list[Finding]:
    """Return whether compiled kernels are kept for the next run."""
    from pdpetsc.kernels.compile import cache_trouble
    from pdpetsc.kernels.gradient import determinant_kernel

    before = time.perf_counter()
    determinant_kernel(2)(np.eye(2)[None])
    spent, trouble = time.perf_counter() - before, cache_trouble()
    if trouble:
        advice = "set NUMBA_CACHE_DIR to a folder that can be written to; kernels are compiled in every run otherwise"
        return [Finding("look", "compiled kernels", trouble, advice)]
    return [Finding("ok", "compiled kernels", f"kept on disk; the first one came in {spent:.2f} s")]


def disk(comm: Comm) -> list[Finding]:
    """Return the room for results here."""
    free, here = shutil.disk_usage(Path.cwd()).free, Path.cwd()
    if not os.access(here, os.W_OK):
        return [Finding("look", "disk", f"{here} cannot be written to", "give runs a folder with -o")]
    advice = "give runs another folder with -o" if free < LITTLE else ""
    return [Finding("look" if advice else "ok", "disk", f"{free / 2**30:.1f} GiB free here", advice)]


CHECKS: tuple[Callable[[Comm], list[Finding]], ...] = (versions, ranks, petsc, blas, hdf5, kernels, disk)


def examine(comm: Comm) -> list[Finding]:
    """Return what all checks find; one that fails itself is a finding too (collective)."""
    found: list[Finding] = []
    for check in CHECKS:
        try:
            found += check(comm)
        except Exception as error:
            found.append(Finding("broken", check.__name__, str(described(error)), "install it anew"))
    return found


def doctor(comm: Comm) -> int:
    """Print what all checks find on rank 0, and what is broken on others; return 1 where pdpetsc cannot work.

    Notes
    -----
    Collective.
    """
    found = examine(comm)
    broken = comm.allgather([one for one in found if one.verdict == "broken"])
    if is_root(comm):
        told = [*found]
        for rank, others in enumerate(broken[1:], 1):
            told += [one._replace(what=f"{one.what} on rank {rank}") for one in others]
        width = max(len(one.what) for one in told)
        for one in told:
            print(
                f"{one.verdict:6}  {one.what:{width}}  {one.found}"
                + (f"\n        -> {one.advice}" if one.advice else "")
            )
    return 1 if any(broken) else 0
