"""Running a case: steps, records, results."""

from __future__ import annotations

import platform
import resource
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from pdpetsc.build import make_cloud, make_model, rehearse
from pdpetsc.case import Case
from pdpetsc.discrete.communicator import is_root, total, world
from pdpetsc.discrete.families import find_families
from pdpetsc.discrete.pieces import refuse_rigid_motion
from pdpetsc.errors import CaseError, OutputError, PdpetscError
from pdpetsc.loading import Loading
from pdpetsc.model import Model
from pdpetsc.model.apart import pieces_left
from pdpetsc.output.checkpoint import read_checkpoint
from pdpetsc.output.files import InCreationOrder, prepare_folder
from pdpetsc.output.keeper import Keeper
from pdpetsc.output.picture import draw
from pdpetsc.output.progress import Reporter
from pdpetsc.output.records import write_summary
from pdpetsc.scene.solver import DynamicRelaxation, EventDriven, PathFollowing
from pdpetsc.signals import stop_on_signals
from pdpetsc.solution import Field, Solution, displacement
from pdpetsc.solve.base import StepResult, StepSolver
from pdpetsc.solve.defaults import default_options, stiffness_scale
from pdpetsc.solve.events import EventSolver
from pdpetsc.solve.following import PathSolver
from pdpetsc.solve.jacobian import Choice, assembler, choose, words
from pdpetsc.solve.matrix import predicted_bytes
from pdpetsc.solve.petsc import options as petsc_options
from pdpetsc.solve.petsc import petsc_version
from pdpetsc.solve.relaxation import RelaxationSolver
from pdpetsc.solve.stages import OUTPUT, SEARCH, SET_UP, stage
from pdpetsc.solve.static import StaticSolver
from pdpetsc.solve.steps import Converged, load_steps


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


# Stages of PETSc's log that phases belong to.
STAGES = {
    **dict.fromkeys(("particles", "families"), SEARCH),
    **dict.fromkeys(("kernels", "model", "pattern", "allocation"), SET_UP),
    **dict.fromkeys(("output", "picture"), OUTPUT),
}

Running: TypeAlias = StepSolver | EventSolver


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
        self.history: dict[str, list[float]] = {}
        self.summary: dict[str, Any] = {"parameters": parameters, "versions": _versions(), "ranks": self.comm.size}

    def __call__(self) -> dict[str, float]:
        case, comm = self.case, self.comm
        with self._timed("particles"):
            cloud = make_cloud(comm, case)
        with self._timed("kernels"):
            rehearse(comm, case, cloud.dim)
        with self._timed("families"):
            families = find_families(cloud, case.cracks)
        with self._timed("model"):
            model = make_model(case, cloud, families)
            loading = Loading(model, case.conditions, case.particles.thickness)
            refuse_rigid_motion(cloud, families, loading.fixed[: cloud.n_owned])
        self._describe(model)
        choice = choose(model, self.options, case.solver)
        defaults = default_options(model, case.solver, choice)
        with stop_on_signals(comm) as stop, petsc_options(self.options, defaults):
            solver = self._solver(model, loading, choice, stop)
            self.summary["solver"] = solver.description()
            self.report.say(f"solver: {solver.description()}")
            try:
                return self._march(model, loading, solver, stop)
            finally:
                solver.destroy()

    def _solver(self, model: Model, loading: Loading, choice: Choice, stop: Callable[[], bool]) -> Running:
        chosen = self.case.solver
        if isinstance(chosen, DynamicRelaxation):
            return RelaxationSolver(model, loading, chosen, stop)
        if choice.matrix_free:
            with self._timed("kernels"):
                rehearse(self.comm, self.case, model.dim, near=True)
        with self._timed("pattern"):
            filled = assembler(model, choice)
            predicted = predicted_bytes(filled.pattern, model.dim)
            self.report.say(words(choice, predicted))
        with self._timed("allocation"):
            solver: StaticSolver | EventSolver | PathSolver
            if isinstance(chosen, EventDriven):
                solver = EventSolver(model, loading, filled, chosen, stiffness_scale(model), stop)
            elif isinstance(chosen, PathFollowing):
                solver = PathSolver(model, loading, filled, chosen, stop)
            else:
                solver = StaticSolver(model, loading, filled, stop)
        self.summary |= {"matrix_bytes": {"predicted": predicted, "measured": solver.matrix_bytes}}
        self.summary["allocated"].append("matrix of nearest neighbours" if choice.matrix_free else "tangent matrix")
        return solver

    def _march(self, model: Model, loading: Loading, solver: Running, stop: Callable[[], bool]) -> dict[str, float]:
        case, cloud = self.case, model.cloud
        order = InCreationOrder(cloud)
        start = Solution(model, loading, np.zeros((cloud.n_rows, model.dim)), 0.0, 0)
        if self.restart is not None:
            if isinstance(solver, EventSolver):
                raise CaseError("The event-driven solver starts from the unloaded body; it takes no restart.")
            if not model.restartable:
                raise CaseError(
                    "A case with a history of materials or bonds cannot be restarted: a checkpoint lacks it."
                )
            start = read_checkpoint(model, loading, order, Path(self.restart))
        step = start.step
        with self._timed("output"):
            checkpoints = case.checkpoints if model.restartable and not isinstance(solver, EventSolver) else 0
            restart = None if self.restart is None else Path(self.restart)
            keeper = Keeper(self.folder, case.history, self._fields(), checkpoints, start, order, restart)
            self.history = keeper.history
            if not keeper.took_over:
                self.report.say(f"no history of this case beside the checkpoint: it starts at step {step}")
        failed: list[StepResult] = []

        def on_failure(at: float, dt: float, result: StepResult) -> None:
            failed.append(result)
            self.report.cut_back(at, dt, result)

        status = "converged"
        try:
            before = time.perf_counter()
            if isinstance(solver, EventSolver):
                march = solver.march()
            elif isinstance(solver, PathSolver):
                march = solver.march(start.unknowns, start.t, start.pace, on_failure)
            else:
                march = load_steps(solver, case.steps, start.unknowns, start.t, stop, on_failure, start.pace)
            for converged in march:
                self.timings["solve"] = self.timings.get("solve", 0.0) + time.perf_counter() - before
                step += 1
                self.report.step(step, converged.t, converged.result, solver.unit, converged.broken, converged.sweeps)
                self._say_detached(model)
                self.steps.append(_step_summary(step, converged, solver.unit))
                failed.clear()
                with self._timed("output"):
                    state = Solution(model, loading, converged.u, converged.t, step, pace=converged.pace)
                    keeper.write(state, converged.write_fields)
                before = time.perf_counter()
        except PdpetscError as error:
            status = str(error)
            if not isinstance(error, OutputError):
                keeper.save()
                self._say_what_holds(model)
            raise
        else:
            keeper.save()
            self._say_what_holds(model)
        finally:
            self._finish(status, failed, solver.unit)
        return self._end()

    def _fields(self) -> list[Field]:
        """Return the fields to write: the declared ones, and what the picture shows."""
        wanted = list(self.case.fields)
        if self.case.picture is not None:
            wanted += [f for f in (displacement, self.case.picture.field) if f not in wanted]
        return wanted

    def _say_detached(self, model: Model) -> None:
        if model.n_detached > self.summary.get("detached_particles", 0):
            self.report.say(
                f"           {model.n_detached} particles have too few bonds left for a gradient; their stress is gone"
            )
        if model.n_detached:
            self.summary["detached_particles"] = model.n_detached

    def _say_what_holds(self, model: Model) -> None:
        """Say whether bonds that broke have left the body in one piece, and what of its load it still carries."""
        if not model.broken_bonds():
            return
        pieces, lone = pieces_left(model)
        self.summary["pieces"] = {"pieces": pieces, "lone_particles": lone}
        forces = [step["reference"] for step in self.steps]
        left = forces[-1] / max(forces) if forces and max(forces) > 0.0 else float("nan")
        self.summary["pieces"]["forces_left"] = left
        whole = "bonds still hold the body in one piece" if pieces == 1 else f"the body is in {pieces} pieces"
        beside = f", beside {lone} lone particles" if lone else ""
        carried = f"; supports and loads carry {left:.2g} of their largest forces in this run" if left == left else ""
        self.report.say(f"{whole}{beside}{carried}")

    def _finish(self, status: str, failed: list[StepResult], unit: str) -> None:
        memory = self.comm.gather(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024)
        results = {}
        if status == "converged" and self.case.results is not None:
            results = {name: float(value) for name, value in self.case.results(self.history).items()}
        self.summary |= {
            "status": status,
            "results": results,
            "steps": self.steps,
            "failed_attempts": [_attempt(result, unit) for result in failed],
            "timings": self.timings,
            "peak_memory_bytes": memory,
        }
        write_summary(self.comm, self.folder, self.summary)

    def _end(self) -> dict[str, float]:
        results: dict[str, float] = self.summary["results"]
        self.report.results(results)
        self.report.say(f"results in {self.folder}")
        if self.case.picture is not None and is_root(self.comm):
            with self._timed("picture"):
                path = draw(self.folder, self.case.picture, self.folder.name)
            self.report.say(f"picture in {path}")
        return results

    def _describe(self, model: Model) -> None:
        cloud, comm = model.cloud, self.comm
        bonds, points, ghosts = total(comm, [len(model.families.neighbours), model.n_points, cloud.n_ghost])
        counts = {"particles": cloud.n_global, "bonds": int(bonds), "gradient_points": int(points)}
        self.summary |= {**counts, "ghosts": int(ghosts), "dimension": cloud.dim, "horizon": cloud.horizon}
        self.summary["allocated"] = list(model.parts)
        self.report.say(
            f"{cloud.n_global} particles in {cloud.dim}D, {int(bonds)} bonds, "
            f"{f'{int(points)} gradient points, ' if points else ''}{comm.size} rank{'s' if comm.size > 1 else ''}"
        )
        scheme = "bonds" if self.case.of_bonds else type(self.case.gradients).__name__
        self.summary["scheme"] = {"name": scheme, "note": model.note}
        if model.note:
            self.report.say(f"scheme: {model.note}")

    @contextmanager
    def _timed(self, phase: str) -> Iterator[None]:
        before = time.perf_counter()
        with stage(STAGES[phase]):
            yield
        self.timings[phase] = self.timings.get(phase, 0.0) + time.perf_counter() - before


def _step_summary(step: int, converged: Converged, unit: str) -> dict[str, Any]:
    cut_backs = [_attempt(failure, unit) for failure in converged.failures]
    damage = (
        {"broken_bonds": converged.broken, "sweeps": converged.sweeps} if converged.broken or converged.sweeps else {}
    )
    return {"step": step, "t": converged.t, **_attempt(converged.result, unit), **damage, "cut_backs": cut_backs}


def _attempt(result: StepResult, unit: str) -> dict[str, Any]:
    return {
        "reason": result.reason,
        "norms": result.norms,
        "reference": result.reference,
        f"{unit.lower()}_iterations": result.iterations,
        "linear_iterations": result.linear_iterations,
    }


def _versions() -> dict[str, str]:
    found = {"python": platform.python_version(), "petsc": petsc_version()}
    for package in ("pdpetsc", "numpy", "scipy", "numba"):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed"
    return found
