"""What a scene declares, and how it is run."""

from __future__ import annotations

import math
import platform
import resource
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from pdpetsc.arrays import Float, LocalIndex
from pdpetsc.discrete.cloud import Cloud, distribute
from pdpetsc.discrete.communicator import Comm, agreed, alone, is_root, total, world
from pdpetsc.discrete.families import Families, find_families
from pdpetsc.discrete.pieces import refuse_rigid_motion
from pdpetsc.errors import CaseError, PdpetscError
from pdpetsc.gradient import Correspondence, Scheme
from pdpetsc.kernels.compile import cache_lock
from pdpetsc.loading import Loading, select
from pdpetsc.material import Material
from pdpetsc.model import Assembler, Model
from pdpetsc.output.checkpoint import read_checkpoint, write_checkpoint
from pdpetsc.output.fields import FieldWriter
from pdpetsc.output.files import InCreationOrder, prepare_folder
from pdpetsc.output.picture import Picture, draw
from pdpetsc.output.progress import Reporter
from pdpetsc.output.records import HistoryWriter, write_summary
from pdpetsc.quantities import Quantity
from pdpetsc.scene.conditions import Condition
from pdpetsc.scene.influence import Constant, Influence
from pdpetsc.scene.particles import Chunk, Particles
from pdpetsc.scene.region import Region
from pdpetsc.scene.steps import AdaptiveSteps, Steps
from pdpetsc.signals import stop_on_signals
from pdpetsc.solution import Field, Solution, displacement, stress
from pdpetsc.solve.matrix import predicted_bytes
from pdpetsc.solve.petsc import options as petsc_options
from pdpetsc.solve.static import StaticSolver, StepResult, default_options
from pdpetsc.solve.steps import load_steps
from pdpetsc.stabilisation import Stabilisation

Results = Callable[[Mapping[str, list[float]]], Mapping[str, float]]


@dataclass(frozen=True)
class Case:
    """A scene: a body, what is done to it and what is asked.

    Parameters
    ----------
    particles : Particles
        Where the particles are.
    horizon : float
        Radius of the families [length].
    material : Material or sequence of (Region, Material)
        One material, or one per region; every particle needs exactly one.
    conditions : sequence of Condition
        Displacements and loads.
    scheme : Scheme
        Where deformation gradients are evaluated.
    influence : Influence
        How much a bond counts.
    stabilisation : Stabilisation, optional
        Zero-energy control; none where absent.
    steps : Steps or AdaptiveSteps
        How the load is applied.
    history : mapping of str to Quantity
        Numbers written per step.
    results : callable, optional
        Gets the history as lists per name and returns the named scalar results of the run.
    fields : sequence of Field
        What is written per step; empty for no file of fields.
    picture : Picture, optional
        What is drawn at the end.
    options : mapping of str to value
        PETSc options without dash, which the command line overrides.
    """

    particles: Particles
    horizon: float
    material: Material | Sequence[tuple[Region, Material]]
    conditions: Sequence[Condition]
    scheme: Scheme = field(default_factory=Correspondence)
    influence: Influence = field(default_factory=Constant)
    stabilisation: Stabilisation | None = None
    steps: Steps | AdaptiveSteps = field(default_factory=Steps)
    history: Mapping[str, Quantity] = field(default_factory=dict)
    results: Results | None = None
    fields: Sequence[Field] = (displacement, stress)
    picture: Picture | None = None
    options: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not (math.isfinite(self.horizon) and self.horizon > 0.0):
            raise CaseError(f"The horizon must be positive, not {self.horizon}.")
        spacing = getattr(self.particles, "spacing", 0.0)
        if self.horizon < spacing * (1.0 - 1e-9):
            raise CaseError(f"The horizon {self.horizon:g} is below the spacing {spacing:g}; families would be empty.")
        clash = {"step", "t"} & set(self.history)
        if clash:
            raise CaseError(f"The history cannot have a quantity named {clash.pop()!r}; step and t are always there.")


def run(
    case: Case,
    output: str | Path,
    options: Mapping[str, Any] | None = None,
    restart: str | Path | None = None,
    quiet: bool = False,
    parameters: Mapping[str, Any] | None = None,
) -> dict[str, float]:
    """Run a case and return its named results.

    Parameters
    ----------
    case : Case
        What to run.
    output : str or Path
        Folder for ``summary.json``, ``history.csv``, ``fields.h5``, ``fields.xdmf``, ``checkpoint.h5``.
    options : mapping, optional
        PETSc options without dash; they win over the case's.
    restart : str or Path, optional
        Checkpoint to go on from.
    quiet : bool
        Print nothing.
    parameters : mapping, optional
        Written to the summary: what the case was made with.

    Returns
    -------
    dict of str to float
        The case's results.

    Raises
    ------
    CaseError
        The case is wrong; nothing was run.
    SolveError, OutputError, Interrupted
        The run ended early; the folder holds everything up to the last converged step.

    Notes
    -----
    Collective.
    """
    comm = world()
    folder = Path(output)
    prepare_folder(comm, folder)
    with Reporter(comm, quiet) as report:
        return _Run(case, folder, {**case.options, **(options or {})}, restart, report, dict(parameters or {}))()


class _Run:
    """One run: builds the model, drives the steps, keeps the records."""

    def __init__(
        self,
        case: Case,
        folder: Path,
        options: Mapping[str, Any],
        restart: str | Path | None,
        report: Reporter,
        parameters: dict[str, Any],
    ) -> None:
        self.case = case
        self.folder = folder
        self.options = options
        self.restart = restart
        self.report = report
        self.comm = world()
        self.timings: dict[str, float] = {}
        self.steps: list[dict[str, Any]] = []
        self.history: dict[str, list[float]] = {name: [] for name in ("step", "t", *case.history)}
        self.summary: dict[str, Any] = {"parameters": parameters, "versions": _versions(), "ranks": self.comm.size}

    def __call__(self) -> dict[str, float]:
        case, comm = self.case, self.comm
        with self._timed("kernels"):
            rehearse(comm, case)
        with self._timed("particles"):
            cloud = make_cloud(comm, case)
        with self._timed("families"):
            families = find_families(cloud)
        with self._timed("model"):
            model = make_model(case, cloud, families)
            loading = Loading(model, case.conditions, case.particles.thickness)
            refuse_rigid_motion(cloud, families, loading.fixed)
        self._describe(model)
        with stop_on_signals(comm) as stop, petsc_options(self.options, default_options(model)):
            with self._timed("pattern"):
                assembler = Assembler(model)
                predicted = predicted_bytes(assembler.pattern, model.dim)
                self.report.say(f"tangent matrix: {predicted / 2**20:.1f} MiB predicted")
            with self._timed("allocation"), agreed(comm):
                solver = _make_solver(model, loading, assembler, stop)
            self.summary |= {"matrix_bytes": {"predicted": predicted, "measured": solver.matrix_bytes}}
            self.summary["solver"] = solver.description()
            self.report.say(f"solver: {solver.description()}")
            try:
                return self._march(model, loading, solver, stop)
            finally:
                solver.destroy()

    def _march(
        self, model: Model, loading: Loading, solver: StaticSolver, stop: Callable[[], bool]
    ) -> dict[str, float]:
        case, cloud = self.case, model.cloud
        order = InCreationOrder(cloud)
        u, t, step = np.zeros((cloud.n_owned, model.dim)), 0.0, 0
        if self.restart is not None:
            u, t, step = read_checkpoint(cloud, order, Path(self.restart))
        with self._timed("output"):
            writer = FieldWriter(cloud, order, self.folder, self._fields()) if self._fields() else None
            records = HistoryWriter(self.comm, self.folder, list(case.history))
            self._record(Solution(model, loading, u, t, step), writer, records)
        failed: list[StepResult] = []

        def on_failure(at: float, dt: float, result: StepResult) -> None:
            failed.append(result)
            self.report.cut_back(at, dt, result)

        status = "converged"
        try:
            before = time.perf_counter()
            for converged in load_steps(solver, case.steps, u, t, stop, on_failure):
                self.timings["solve"] = self.timings.get("solve", 0.0) + time.perf_counter() - before
                step += 1
                self.report.step(step, converged.t, converged.result)
                self.steps.append(_step_summary(step, converged.t, converged.result, converged.failures))
                failed.clear()
                with self._timed("output"):
                    self._record(Solution(model, loading, converged.u, converged.t, step), writer, records)
                    write_checkpoint(cloud, order, self.folder / "checkpoint.h5", converged.u, converged.t, step)
                before = time.perf_counter()
        except PdpetscError as error:
            status = str(error)
            raise
        finally:
            self._finish(status, failed)
        return self._end(model.dim)

    def _fields(self) -> list[Field]:
        """Return the fields to write: the declared ones, and what the picture shows."""
        wanted = list(self.case.fields)
        if self.case.picture is not None:
            wanted += [f for f in (displacement, self.case.picture.field) if f not in wanted]
        return wanted

    def _record(self, solution: Solution, writer: FieldWriter | None, records: HistoryWriter) -> None:
        if writer is not None:
            writer.write(solution)
        row = [float(solution.step), solution.t]
        row += [quantity.evaluate(solution) for quantity in self.case.history.values()]
        for name, value in zip(self.history, row, strict=True):
            self.history[name].append(value)
        records.write(row)

    def _finish(self, status: str, failed: list[StepResult]) -> None:
        memory = self.comm.gather(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024)
        results = {}
        if status == "converged" and self.case.results is not None:
            results = {name: float(value) for name, value in self.case.results(self.history).items()}
        self.summary |= {
            "status": status,
            "results": results,
            "steps": self.steps,
            "failed_attempts": [_attempt(result) for result in failed],
            "timings": self.timings,
            "peak_memory_bytes": memory,
        }
        write_summary(self.comm, self.folder, self.summary)

    def _end(self, dim: int) -> dict[str, float]:
        results: dict[str, float] = self.summary["results"]
        self.report.results(results)
        self.report.say(f"results in {self.folder}")
        if self.case.picture is not None and is_root(self.comm):
            with self._timed("picture"):
                path = draw(self.folder, self.case.picture, dim, self.folder.name)
            self.report.say(f"picture in {path}")
        return results

    def _describe(self, model: Model) -> None:
        cloud, comm = model.cloud, self.comm
        bonds, points, ghosts = total(comm, [len(model.families.neighbours), model.operator.n_points, cloud.n_ghost])
        counts = {"particles": cloud.n_global, "bonds": int(bonds), "gradient_points": int(points)}
        self.summary |= {**counts, "ghosts": int(ghosts), "dimension": cloud.dim, "horizon": cloud.horizon}
        self.summary["allocated"] = _allocated(model)
        self.report.say(
            f"{cloud.n_global} particles in {cloud.dim}D, {int(bonds)} bonds, {int(points)} gradient points, "
            f"{comm.size} rank{'s' if comm.size > 1 else ''}"
        )

    @contextmanager
    def _timed(self, phase: str) -> Iterator[None]:
        before = time.perf_counter()
        yield
        self.timings[phase] = self.timings.get(phase, 0.0) + time.perf_counter() - before


def make_cloud(comm: Comm, case: Case) -> Cloud:
    """Create the particles of a case and distribute them (collective); raises CaseError where they are wrong."""
    with agreed(comm):
        chunk = case.particles.chunk(comm.rank, comm.size)
        _refuse_bad_particles(chunk)
    if int(total(comm, len(chunk.x))) == 0:
        raise CaseError("The case has no particles.")
    return distribute(comm, chunk.x, chunk.volume, chunk.sets, case.horizon)


def make_model(case: Case, cloud: Cloud, families: Families) -> Model:
    """Return the model of a case on a distributed cloud (collective)."""
    length = np.linalg.norm(families.bonds(cloud.x), axis=1)
    omega: Float = case.influence(length / case.horizon)
    materials, material_of = _materials(case, cloud)
    return Model(cloud, families, omega, case.scheme, materials, material_of, case.stabilisation)


def rehearse(comm: Comm, case: Case) -> None:
    """Compile or load the kernels of a case on rank 0, on a lattice of a few particles, while the others wait.

    The other ranks then find them in the cache: many ranks that start on an empty cache neither compile the same kernel
    nor write its cache at once.

    Notes
    -----
    Collective.
    """
    if is_root(comm):
        dim = case.particles.dim
        x = np.stack(np.meshgrid(*[np.arange(4.0)] * dim, indexing="ij"), axis=-1).reshape(-1, dim)
        materials = [case.material] if isinstance(case.material, Material) else [m for _, m in case.material]
        with cache_lock():
            cloud = distribute(alone(), x, np.ones(len(x)), {}, 1.5)
            families = find_families(cloud)
            omega = np.ones(len(families.neighbours))
            law_of = (np.arange(len(x)) % len(materials)).astype(np.int32)
            model = Model(cloud, families, omega, case.scheme, materials, law_of, case.stabilisation)
            assembler = Assembler(model)
            u = np.zeros_like(x)
            size = dim * dim * np.array([assembler.pattern.owned.diag_ptr[-1], assembler.pattern.owned.off_ptr[-1]])
            assembler.assemble(u, np.empty(size[0]), np.empty(size[1]))
            model.internal_force(u)
            model.energy(u)
    comm.Barrier()


def _make_solver(model: Model, loading: Loading, assembler: Assembler, stop: Callable[[], bool]) -> StaticSolver:
    from petsc4py import PETSc

    try:
        return StaticSolver(model, loading, assembler, stop)
    except PETSc.Error as error:
        raise CaseError(f"PETSc refused the solver options: {error}.") from error


def _materials(case: Case, cloud: Cloud) -> tuple[list[Material], LocalIndex]:
    """Return the materials and the index of each own particle's (collective)."""
    if isinstance(case.material, Material):
        return [case.material], np.zeros(cloud.n_owned, dtype=np.int32)
    count = np.zeros(cloud.n_owned, dtype=np.int32)
    index = np.zeros(cloud.n_owned, dtype=np.int32)
    for number, (region, _) in enumerate(case.material):
        mask = select(cloud, region, f"material {number + 1}")
        count += mask
        index[mask] = number
    with agreed(cloud.comm):
        wrong = np.flatnonzero(count != 1)
        if len(wrong):
            gid, times = cloud.gid[wrong[0]], int(count[wrong[0]])
            raise CaseError(f"Particle {gid} has {times} materials; let the regions cover every particle once.")
    return [material for _, material in case.material], index


def _refuse_bad_particles(chunk: Chunk) -> None:
    bad = np.flatnonzero(~np.isfinite(chunk.x).all(axis=1))
    if len(bad):
        raise CaseError(f"{len(bad)} particles have a position that is not a number, the first at {chunk.x[bad[0]]}.")
    bad = np.flatnonzero(~(np.isfinite(chunk.volume) & (chunk.volume > 0.0)))
    if len(bad):
        volume, x = chunk.volume[bad[0]], chunk.x[bad[0]]
        raise CaseError(f"{len(bad)} particles have no positive volume, the first has {volume:g} at {x}.")


def _allocated(model: Model) -> list[str]:
    """Return what this scene made the model hold."""
    held = ["families", "gradient operator", "tangent matrix"]
    held += [f"material {type(law.material).__name__}" for law in model.laws]
    return held + ([type(model.control).__name__ + " control"] if model.control is not None else [])


def _step_summary(step: int, t: float, result: StepResult, failures: Sequence[StepResult]) -> dict[str, Any]:
    return {"step": step, "t": t, **_attempt(result), "cut_backs": [_attempt(failure) for failure in failures]}


def _attempt(result: StepResult) -> dict[str, Any]:
    return {
        "reason": result.reason,
        "norms": result.norms,
        "reference": result.reference,
        "newton_iterations": max(len(result.norms) - 1, 0),
        "linear_iterations": result.linear_iterations,
    }


def _versions() -> dict[str, str]:
    from petsc4py import PETSc

    found = {"python": platform.python_version(), "petsc": ".".join(map(str, PETSc.Sys.getVersion()))}
    for package in ("pdpetsc", "numpy", "scipy", "numba"):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed"
    return found
