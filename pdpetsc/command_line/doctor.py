"""Look whether what pdpetsc stands on works here, and say what to do where it does not.

usage: [mpirun -n N] python -m pdpetsc doctor

Looks at versions, MPI, PETSc, its direct solver and BLAS, HDF5, the cache of compiled kernels, cores and the disk, and
says what to do about each. Ends with status 1 where pdpetsc cannot work. With mpirun it looks whether ranks hear each
other.
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
from pdpetsc.command_line.start import processes_started, start_petsc, take_signals
from pdpetsc.errors import RunError, described
from pdpetsc.machine import cores, threads

if TYPE_CHECKING:  # the doctor looks first whether MPI can be loaded
    from pdpetsc.discrete.communicator import Comm

NEEDED = ("numpy", "scipy", "numba", "mpi4py", "petsc4py", "h5py", "meshio", "matplotlib", "rich", "sympy")
# The oldest that the tests have been run with.
OLDEST_PETSC = (3, 18)
# What each of these gives.
OPTIONAL = {
    "netCDF4": "meshes in Exodus files",
    "pandas": "histories as data frames",
    "pyvista": "fields as PyVista meshes",
}
# A product of matrices below this many operations a second is that of the reference BLAS [1 / s].
SLOW_BLAS = 5e9
SIDE = 600
# The direct solver that pdpetsc takes by default.
DIRECT = "mumps"
# What ranks send each other, more than goes without the other's agreement [bytes], and how long it may take [s].
MESSAGE, PATIENCE = 2**22, 30.0
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


def versions(comm: Comm | None) -> Iterator[Finding]:
    """Yield the versions of what is needed, and of what is useful."""
    yield Finding("ok", "Python", f"{platform.python_version()} on {platform.machine()}")
    there, missing = [], []
    for name in NEEDED:
        try:
            there.append(f"{name} {_version(name)}")
        except Exception:  # the cause of one that is there and broken is told of apart
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
    """Return the version of a package that can be imported; distributions may know it by another name."""
    module = importlib.import_module(name)
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return str(getattr(module, "__version__", "of unknown version"))


def ranks(comm: Comm) -> Iterator[Finding]:
    """Yield whether the processes that were started are ranks of one job that hear each other, and PETSc sees them."""
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
    """Return how long a message to the next rank takes [s]; None where it does not come, or not as it was sent."""
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
    """Yield how PETSc was built, and whether its direct solver factors a matrix."""
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
    """Yield how fast PETSc multiplies matrices, which is what its direct solver does all the time.

    numpy may have a BLAS of its own, as the one from PyPI does; it tells nothing of that of PETSc.
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
    """Yield whether every rank on this machine has a core of its own."""
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
    """Yield whether several ranks write one file together."""
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
    """Return what is wrong with a file that all ranks write; empty if nothing is (collective)."""
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
    """Yield whether compiled kernels are kept for the next run."""
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
    """Yield the room for results here."""
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
    """Print what all checks find on rank 0, and what is broken on others; return 1 where pdpetsc cannot work.

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
    """Carry out the command; return 1 if pdpetsc cannot work."""
    try:
        start_petsc()
    except RunError as error:
        # Without MPI or PETSc there is no more to see; saying so is what this is for.
        what, _, advice = error.what.partition("; ")
        tell([*versions(None), Finding("broken", "petsc4py", what, advice)])
        return 1
    take_signals()
    from pdpetsc.discrete.communicator import world

    return doctor(world())


def tell(found: Sequence[Finding]) -> None:
    """Print findings, a line each, with what to do below."""
    width = max(len(one.what) for one in found)
    for one in found:
        print(f"{one.verdict:6}  {one.what:{width}}  {one.found}")
        if one.advice:
            print(f"        -> {one.advice}")
