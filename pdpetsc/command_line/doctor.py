"""Check that the requirements of pdpetsc work here, with advice if they do not.

usage: [mpirun -n N] python -m pdpetsc doctor

Checks versions, MPI, PETSc, its direct solver and BLAS, HDF5, the cache of compiled kernels, cores and the disk, and
prints advice for each. The exit status is 1 if pdpetsc cannot work. With mpirun it also checks that ranks communicate.
"""

from __future__ import annotations

import importlib
import os
import platform
import shutil
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple, TypeAlias

import numpy as np

from pdpetsc.command_line.arguments import Arguments
from pdpetsc.command_line.start import handle_signals, processes_started, start_petsc
from pdpetsc.errors import RunError, described
from pdpetsc.machine import cores, threads

if TYPE_CHECKING:  # MPI is checked before other imports
    from pdpetsc.discrete.communicator import Comm

NEEDED = ("numpy", "scipy", "numba", "mpi4py", "petsc4py", "h5py", "meshio", "matplotlib", "rich", "sympy")
# The oldest tested versions.
OLDEST_PETSC = (3, 18)
# Purpose of each optional package.
OPTIONAL = {
    "netCDF4": "meshes in Exodus files",
    "pandas": "histories as data frames",
    "pyvista": "fields as PyVista meshes",
}
# A matrix product with fewer operations per second is by the reference BLAS [1 / s].
SLOW_BLAS = 5e9
SIDE = 600
# The default direct solver of pdpetsc.
DIRECT = "mumps"
# Size of the test message between ranks, above the eager limit [bytes], and its time limit [s].
MESSAGE, PATIENCE = 2**22, 30.0
# Free disk space below which the command warns [bytes].
LITTLE = 2**30


class Finding(NamedTuple):
    """The result of one check.

    Attributes
    ----------
    verdict : {"ok", "look", "broken"}
        Works; works with limitations; or pdpetsc cannot work.
    what : str
        Name of the check.
    found : str
        Result of the check.
    advice : str
        Advice; empty if there is nothing to do.
    """

    verdict: Literal["ok", "look", "broken"]
    what: str
    found: str
    advice: str = ""


def versions(comm: Comm | None) -> Iterator[Finding]:
    """Yield the versions of required and optional packages."""
    yield Finding("ok", "Python", f"{platform.python_version()} on {platform.machine()}")
    there, missing = [], []
    for name in NEEDED:
        try:
            there.append(f"{name} {_version(name)}")
        except Exception:  # a broken installation is reported separately
            missing.append(name)
    yield Finding("ok", "packages", ", ".join(there))
    if missing:
        yield Finding("broken", "packages", f"no {', '.join(missing)}", f"pip install {' '.join(missing)}")
    for name, use in OPTIONAL.items():
        try:
            yield Finding("ok", name, _version(name))
        except ImportError:
            yield Finding("look", name, "not there", f"pip install {name} for {use}")
        except Exception as error:
            yield Finding("look", name, str(described(error)), f"install it anew for {use}")


def _version(name: str) -> str:
    """Return the version of an importable package; its distribution may have another name."""
    module = importlib.import_module(name)
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return str(getattr(module, "__version__", "of unknown version"))


def ranks(comm: Comm) -> Iterator[Finding]:
    """Check that the started processes are ranks of one job that communicate, also in PETSc."""
    from petsc4py import PETSc

    from pdpetsc.discrete.communicator import mpi_library, total

    library, size, started = mpi_library(), int(total(comm, 1)), processes_started()
    if started > size:
        advice = "build mpi4py and petsc4py with the MPI whose mpirun starts them, or start them with that one's mpirun"
        yield Finding("broken", "MPI", f"{started} processes, each alone ({library})", advice)
    elif PETSc.COMM_WORLD.size != size:
        advice = "build mpi4py and petsc4py with the same MPI"
        yield Finding("broken", "MPI", f"{size} ranks, of which PETSc sees {PETSc.COMM_WORLD.size}", advice)
    elif size == 1:
        yield Finding("ok", "MPI", f"1 rank, {library}; mpirun -n 2 python -m pdpetsc doctor looks at more")
    elif (spent := _around(comm)) is None:
        found = f"a message of {MESSAGE // 2**20} MiB has not come in {PATIENCE:.0f} s ({library})"
        advice = (
            "in a container set OMPI_MCA_btl_vader_single_copy_mechanism=none; between nodes ask for the network that "
            "MPI should take"
        )
        yield Finding("broken", "MPI", found, advice)
    else:
        speed = MESSAGE / spent / 2**30
        yield Finding("ok", "MPI", f"{size} ranks that hear each other at {speed:.2g} GiB/s, {library}")


def _around(comm: Comm) -> float | None:
    """Return the time of a message to the next rank [s]; None if it is lost or changed."""
    sent = np.full(MESSAGE // 8, float(comm.rank))
    got = np.empty_like(sent)
    ahead, behind = (comm.rank + 1) % comm.size, (comm.rank - 1) % comm.size
    for _ in range(2):  # the first message also connects
        before = time.perf_counter()
        waiting = [comm.Irecv(got, source=behind), comm.Isend(sent, dest=ahead)]
        while not all(one.Test() for one in waiting):
            if time.perf_counter() - before > PATIENCE:
                return None
        spent = time.perf_counter() - before
    return spent if bool(np.all(got == float(behind))) else None


def petsc(comm: Comm) -> Iterator[Finding]:
    """Check the configuration of PETSc, and that its direct solver factors a matrix."""
    from petsc4py import PETSc

    bits, version = 8 * np.dtype(PETSc.IntType).itemsize, PETSc.Sys.getVersion()
    words = f"{'.'.join(str(n) for n in version)}, {bits}-bit indices"
    if version[:2] < OLDEST_PETSC:
        yield Finding("broken", "PETSc", words, "install PETSc and petsc4py 3.18 or later")
        return
    if PETSc.ScalarType is not np.float64:
        found = f"numbers are {np.dtype(PETSc.ScalarType).name}"
        yield Finding("broken", "PETSc", found, "install a PETSc of real numbers in double precision")
        return
    yield Finding("ok", "PETSc", words)
    try:
        apart = _factored(comm)
    except Exception as error:
        advice = "build PETSc with --download-mumps --download-scalapack, or take -pc_type gamg for all solves"
        yield Finding("look", "MUMPS", str(described(error)), advice)
        return
    if apart < 1e-10:
        yield Finding("ok", "MUMPS", f"solves to {apart:.0e}")
    else:
        advice = "install another build of MUMPS and PETSc: its solutions are wrong"
        yield Finding("broken", "MUMPS", f"solves to {apart:.0e}", advice)


def _factored(comm: Comm) -> float:
    """Return the error of a solve with MUMPS for a known solution."""
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
    ksp.getPC().setFactorSolverType(DIRECT)
    exact, b, x = A.createVecRight(), A.createVecLeft(), A.createVecRight()
    exact.set(1.0)
    A.mult(exact, b)
    ksp.solve(b, x)
    x.axpy(-1.0, exact)
    apart = float(x.norm(PETSc.NormType.NORM_INFINITY))
    for one in (ksp, A, exact, b, x):
        one.destroy()
    return apart


def blas(comm: Comm) -> Iterator[Finding]:
    """Check the speed of matrix products in PETSc, which determines that of its direct solver.

    numpy may have its own BLAS, as from PyPI; its speed is not that of PETSc.
    """
    from petsc4py import PETSc

    A = PETSc.Mat().createDense((SIDE, SIDE), array=np.ones((SIDE, SIDE)), comm=PETSc.COMM_SELF)
    A.assemble()
    C, spent = A.matMult(A), []
    for _ in range(3):
        before = time.perf_counter()
        A.matMult(A, C)
        spent.append(time.perf_counter() - before)
    for one in (A, C):
        one.destroy()
    speed, set_threads = 2.0 * SIDE**3 / min(spent), os.environ.get("OMP_NUM_THREADS", "as many as it likes")
    found = f"PETSc multiplies matrices at {speed / 1e9:.0f} GFlop/s, OMP_NUM_THREADS {set_threads}"
    if speed < SLOW_BLAS:
        advice = (
            "install OpenBLAS in the place of the reference BLAS, on which MUMPS is 4 to 6 times as slow: on Debian "
            "apt-get install libopenblas0-serial; or nothing, where other programs keep the cores busy now"
        )
        yield Finding("look", "BLAS", found, advice)
    else:
        yield Finding("ok", "BLAS", found)


def core_counts(comm: Comm) -> Iterator[Finding]:
    """Check that every rank on this machine has its own core."""
    there, beside = os.cpu_count() or 1, comm.allgather(platform.node()).count(platform.node())
    if comm.size > 1:
        found = f"{there} for {beside} ranks x {threads()} threads"
    else:
        found = f"{there}, {cores()} for this process"
    if beside * threads() > there:
        yield Finding("look", "cores", found, "start fewer ranks, or set OMP_NUM_THREADS=1")
    else:
        yield Finding("ok", "cores", found)


def hdf5(comm: Comm) -> Iterator[Finding]:
    """Check that several ranks can write one file in parallel."""
    import h5py

    version = h5py.version.hdf5_version
    if not h5py.get_config().mpi:
        yield Finding("ok", "HDF5", f"{version}, serial here: rank 0 writes for all")
    elif comm.size == 1:
        yield Finding("ok", "HDF5", f"{version}, parallel")
    elif wrong := _written_together(comm):
        advice = "give runs a folder on a file system that all ranks reach with -o, or install a serial h5py"
        yield Finding("look", "HDF5", f"{version}, parallel, but not in {Path.cwd()}: {wrong}", advice)
    else:
        yield Finding("ok", "HDF5", f"{version}, parallel: {comm.size} ranks wrote one file")


def _written_together(comm: Comm) -> str:
    """Return the error of a file written by all ranks; empty if there is none (collective)."""
    import h5py

    path, wrong = comm.bcast(str(Path.cwd() / f".pdpetsc-doctor-{os.getpid()}.h5")), ""
    try:
        with h5py.File(path, "w", driver="mpio", comm=comm) as file:
            data = file.create_dataset("rank", (comm.size,), dtype="i8")
            data[comm.rank] = comm.rank
        with h5py.File(path, "r", driver="mpio", comm=comm) as file:
            if file["rank"][...].tolist() != list(range(comm.size)):
                wrong = "what ranks wrote together is not what they read"
    except Exception as error:
        wrong = str(described(error))
    wrong = next(filter(None, comm.allgather(wrong)), "")
    if comm.rank == 0:
        Path(path).unlink(missing_ok=True)
    return wrong


def kernels(comm: Comm) -> Iterator[Finding]:
    """Check that compiled kernels are cached for the next run."""
    from pdpetsc.kernels.compile import cache_trouble
    from pdpetsc.kernels.gradient import determinant_kernel

    before = time.perf_counter()
    determinant_kernel(2)(np.eye(2)[None])
    spent = time.perf_counter() - before
    if trouble := cache_trouble():
        advice = "set NUMBA_CACHE_DIR to a folder that can be written to: every run compiles its kernels otherwise"
        yield Finding("look", "compiled kernels", trouble, advice)
    else:
        yield Finding("ok", "compiled kernels", f"kept on disk; the first one came in {spent:.2f} s")


def disk(comm: Comm) -> Iterator[Finding]:
    """Check the free disk space for results."""
    free, here = shutil.disk_usage(Path.cwd()).free, Path.cwd()
    if not os.access(here, os.W_OK):
        yield Finding("look", "disk", f"{here} cannot be written to", "give runs a folder with -o")
    elif free < LITTLE:
        yield Finding("look", "disk", f"{free / 2**30:.1f} GiB free here", "give runs another folder with -o")
    else:
        yield Finding("ok", "disk", f"{free / 2**30:.1f} GiB free here")


Check: TypeAlias = "Callable[[Comm], Iterable[Finding]]"
CHECKS: tuple[Check, ...] = (versions, ranks, petsc, blas, core_counts, hdf5, kernels, disk)


def doctor(comm: Comm) -> int:
    """Print all results on rank 0, and failures of other ranks; return 1 if pdpetsc cannot work.

    Notes
    -----
    Collective.
    """
    from pdpetsc.discrete.communicator import is_root

    found: list[Finding] = []
    for check in CHECKS:
        try:
            found += check(comm)
        except Exception as error:
            found.append(Finding("broken", check.__name__, str(described(error)), "install it anew"))
    broken = comm.allgather([one for one in found if one.verdict == "broken"])
    if is_root(comm):
        for rank, others in enumerate(broken[1:], 1):
            found += [one._replace(what=f"{one.what} on rank {rank}") for one in others]
        tell(found)
    return 1 if any(broken) else 0


def run(path: None, arguments: Arguments) -> int:
    """Execute the command; return 1 if pdpetsc cannot work."""
    try:
        start_petsc()
    except RunError as error:
        # Without MPI or PETSc there are no further checks; report this.
        what, _, advice = error.what.partition("; ")
        tell([*versions(None), Finding("broken", "petsc4py", what, advice)])
        return 1
    handle_signals()
    from pdpetsc.discrete.communicator import world

    return doctor(world())


def tell(found: Sequence[Finding]) -> None:
    """Print findings, one line each, with advice below."""
    width = max(len(one.what) for one in found)
    for one in found:
        print(f"{one.verdict:6}  {one.what:{width}}  {one.found}")
        if one.advice:
            print(f"        -> {one.advice}")
