"""Running a case: steps, records, results."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import resource
import sys
import time
import traceback
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from pdpetsc.case import Case
from pdpetsc.declare.cracks import recorded as recorded_crack
from pdpetsc.discrete.communicator import Comm, agreed, alone, communicator, is_root, total
from pdpetsc.discrete.failure import all_failed, give_up, messages_apart
from pdpetsc.errors import CaseError, Interrupted, OutputError, PdpetscError, RunError, described, of_petsc, users_line
from pdpetsc.gradient.weights import NEED_NOT_CONVERGE
from pdpetsc.kernels.compile import cache_trouble
from pdpetsc.machine import OF_NUMBERS, versions
from pdpetsc.output.checkpoint import read_checkpoint
from pdpetsc.output.files import InCreationOrder
from pdpetsc.output.fingerprint import declared_parts, refuse_differing
from pdpetsc.output.folder import holding, set_aside
from pdpetsc.output.picture import draw
from pdpetsc.output.progress import LogReport, Report
from pdpetsc.output.records import plain, write_summary
from pdpetsc.output.run_writer import RunWriter
from pdpetsc.output.surface import write_surface
from pdpetsc.petsc.jacobian import matrices, words
from pdpetsc.petsc.library import petsc_version
from pdpetsc.petsc.options import refuse_files
from pdpetsc.post.quantities import dimension_of
from pdpetsc.post.solution import Field, Solution, displacement
from pdpetsc.problem.fragments import pieces_left
from pdpetsc.problem.problem import Problem
from pdpetsc.running.checks import Check, compared, failure, lines, recorded, refuse_unchecked
from pdpetsc.running.crack_energy import missed_fracture_energy
from pdpetsc.running.notes import notes
from pdpetsc.running.phases import Phases
from pdpetsc.running.prepare import Prepared, prepare
from pdpetsc.running.result import Result
from pdpetsc.running.run_totals import RunTotals, steps_before
from pdpetsc.running.signals import Signals, watched
from pdpetsc.running.stabilisation_energy import largest_share
from pdpetsc.running.suited import lame_ratio, locking_note
from pdpetsc.running.suited import words as suited_words
from pdpetsc.running.unbalanced_surface import Unbalanced, nearly_incompressible, unbalanced, unbalanced_areas
from pdpetsc.running.unbalanced_surface import words as confined_words
from pdpetsc.solvers.protocol import Converged, Solver, Start, StepResult


def run(
    case: Case,
    output: str | Path,
    options: Mapping[str, Any] | None = None,
    restart: str | Path | None = None,
    parameters: Mapping[str, Any] | None = None,
    restart_anyway: bool = False,
    comm: Any = None,
    report: Callable[[Comm], Report] = LogReport,
    check: bool = False,
    asked: Mapping[str, Any] | None = None,
) -> Result:
    """Run a case and return what came out.

    Parameters
    ----------
    case : Case
        What to run.
    output : str or Path
        Folder for ``summary.json``, ``history.csv``, ``fields.h5``, ``fields.xdmf``, ``checkpoint.h5``.
    options : mapping, optional
        PETSc options without dash; they win over the case's.
    restart : str or Path, optional
        Checkpoint to go on from, or the folder of a run that holds one.
    parameters : mapping, optional
        Written to the summary: what the case was made with.
    restart_anyway : bool
        Go on from a checkpoint of a case that declares something else: another material, load, crack, ...
    comm : communicator of mpi4py or petsc4py, optional
        The ranks that run it; all by default. Groups of ranks can run cases side by side, each in its own folder.
    report : callable
        Makes what takes the words of the run from its ranks: the logger ``pdpetsc`` by default.
    check : bool
        Compare the results with ``Case.expect``, and say and record how they compare.
    asked : mapping, optional
        Written to the summary too, for the report: the command and the text of the case file.

    Returns
    -------
    Result
        The case's results by name, with history, summary, fields and the last solution.

    Raises
    ------
    CaseError
        The case or an option is wrong; nothing was run, and the folder is as it was, but where PETSc refuses an option
        in the first solve only: then what an earlier run left is in ``earlier/``.
    SolveError, OutputError, Interrupted
        The run ended early; the folder holds everything up to the last converged step.
    RunError
        A function of the case, PETSc or the memory failed, or pdpetsc itself; likewise. Its cause is what was raised.
    CheckError
        The run has ended and its folder is complete, but a result is not what the case expects.

    Notes
    -----
    Collective on ``comm``. All of these are raised on every rank. Where one rank fails alone, the others wait for it in
    MPI for ever: it then says so on stderr and in ``summary.json``, and aborts all. On one rank nothing is aborted.

    ``summary.json`` has the status "running" from the first file that is written to the end, then "converged" or why
    the run ended.

    Examples
    --------
    >>> import logging
    >>> import pdpetsc as pd
    >>> logging.basicConfig(level=logging.INFO)              # what the command line shows
    >>> result = pd.run(case, "out/bar")                     # doctest: +SKIP
    >>> result["elongation"], result.history["force"][-1]    # doctest: +SKIP
    """
    ranks = communicator(comm)
    folder = Path(output)
    refuse_differing(ranks, {"output": folder, "restart": restart, "restart_anyway": restart_anyway, "check": check})
    with messages_apart(ranks), holding(ranks, folder), report(ranks) as said:
        given = dict(options or {}), restart, restart_anyway, said, dict(parameters or {})
        one = _Run(case, ranks, folder, *given, check)
        one.summary = {**(asked or {}), **one.summary}
        result = one()
        if (wrong := failure(one.checks)) is not None:
            wrong.agreed = ranks.size
            raise wrong
        return result


_abandoned: list[Solver] = []


class _Run:
    """One run: builds the model, drives the steps, keeps the records."""

    def __init__(
        self,
        case: Case,
        comm: Comm,
        folder: Path,
        options: Mapping[str, Any],
        restart: str | Path | None,
        restart_anyway: bool,
        report: Report,
        parameters: dict[str, Any],
        check: bool,
    ) -> None:
        self.case = case
        self.check = check
        self.checks: list[Check] = []
        self.folder = folder
        self.options = options
        self.restart = restart
        self.restart_anyway = restart_anyway
        self.report = report
        self.comm = comm
        self.phases = Phases()
        self.steps: list[dict[str, Any]] = []
        # What a restart goes on from: the steps of the run before it, and what came up in them.
        self.earlier: list[Any] = []
        self.so_far = RunTotals()
        self.history: dict[str, list[float]] = {}
        self.failed: list[StepResult] = []
        self.unit = "Newton"
        self.prepared: Prepared | None = None
        self.solver: Solver | None = None
        self.keeper: RunWriter | None = None
        self.taken = False  # whether the folder holds files of this run
        self.signals: Signals
        self.summary: dict[str, Any] = {"parameters": parameters, "versions": _versions(), "ranks": self.comm.size}

    def __call__(self) -> Result:
        with watched(self.comm, self._stuck) as self.signals:
            try:
                result = self._go()
            except BaseException as error:
                failure = self._end(error)
                if self.solver is not None:
                    # After an error of PETSc its objects are in no order to be destroyed in, not by Python either.
                    _abandoned.append(self.solver) if of_petsc(error) else self._free(self.solver)
                if failure is error:
                    raise
                raise failure from error
            if self.solver is not None:
                self._free(self.solver)
        return result

    def _free(self, solver: Solver) -> None:
        """Free what solver and problem hold outside Python."""
        solver.destroy()
        for one in self.prepared.problem.fields if self.prepared is not None else ():
            one.destroy()

    @property
    def phase(self) -> str:
        """Return what the run is doing."""
        return self.phases.now

    def _go(self) -> Result:
        if self.check:
            with agreed(self.comm):
                refuse_unchecked(self.case.expect)
        declared = self.case
        prepared = self.prepared = prepare(declared, self.comm, self.options, self.phases)
        self.case = prepared.case
        if cache_trouble():
            self.report.say(f"kernels are compiled anew in every run: no cache of them can be kept ({cache_trouble()})")
        self._describe(prepared.problem)
        if self.case.scheme is not declared.scheme:
            with agreed(self.comm):
                chosen = suited_words(self.case, lame_ratio(self.case, prepared.problem.dim))
            self.summary["scheme"]["chosen"] = chosen
            self.report.say(chosen)
        self._note(prepared.problem)
        self._report_loads(prepared.problem)
        self.phases.now = "set-up"
        options = prepared.options
        self.summary["options"] = options.in_force
        of_environment = [name for name, found in options.in_force.items() if found["from"] == "environment"]
        refuse_files(self.comm, options.in_force)
        if of_environment:
            self.report.say(f"options of PETSC_OPTIONS: {' '.join(f'-{name}' for name in of_environment)}")
        try:
            self.solver = self._solver(prepared)
            self.summary["solver"] = self.solver.description()
            self.report.say(f"solver: {self.solver.description()}")
            return self._march(prepared, self.solver)
        finally:
            self.summary["unused_options"] = options.unused()

    def _end(self, error: BaseException) -> PdpetscError:
        """Leave everything in order after an error and return it as one sentence; abort where this rank is alone."""
        failure = described(error)
        if isinstance(failure, RunError):
            failure.phase = failure.phase or self.phase
            if failure.rank is None and self.comm.size > 1 and failure.agreed < self.comm.size:
                failure.rank = self.comm.rank
        if isinstance(error, KeyboardInterrupt):
            kept = "results are complete up to the step before" if self.taken else "nothing was run"
            failure = Interrupted(f"Stopped by a signal in phase {self.phase}; {kept}.")
        self.signals.deaf = True
        together = all_failed(error, failure)
        self.signals.deaf = not together
        if isinstance(failure, RunError) and together and failure.agreed < self.comm.size:
            failure.rank = None
        failure = self._of_right_status(failure, together)
        if isinstance(failure, RunError) and failure.bug and ((together and is_root(self.comm)) or not together):
            self._write_traceback(error)
        if not together:
            self._leave(failure)
        failure.agreed = self.comm.size
        if not self.taken:
            return failure
        said = str(failure)
        # A signal may have come in the middle of a write; what is on disk stays.
        if (
            self.keeper is not None
            and not isinstance(failure, OutputError)
            and not isinstance(error, KeyboardInterrupt)
        ):
            try:
                self.keeper.save()
                if "pieces" not in self.summary:
                    self._say_what_holds(self.keeper.problem)
            except KeyboardInterrupt:
                said += " A second signal came before its last checkpoint was written."
            except Exception as other:
                said += f" {described(other)}"
        self.summary["error"] = type(failure).__name__
        # What ended the run is on record, whatever signals come.
        self.signals.deaf = True
        with contextlib.suppress(Exception):
            self._write_summary(said)
        return failure

    def _of_right_status(self, failure: PdpetscError, together: bool) -> PdpetscError:
        """Return an error with the exit status that fits: 2 as long as nothing has been solved, and 1 then."""
        if isinstance(failure, RunError) and not self.steps:
            if failure.of_option and self.phase in ("kernels", "model", "set-up", "solve"):
                return CaseError(f"PETSc refused the solver options; check their names and values: {failure.what}.")
            if failure.of_user and not self.taken and failure.exit_status == 1:
                failure.exit_status = CaseError.exit_status
        elif isinstance(failure, CaseError) and self.steps:
            rank = None if together else self.comm.rank
            return RunError(str(failure), users_line(failure), self.phase, rank)
        return failure

    def _leave(self, failure: PdpetscError) -> NoReturn:
        """End all ranks; say why, and leave it in the summary, which this rank writes alone."""
        if not isinstance(failure, RunError | Interrupted):
            failure = RunError(str(failure), place=users_line(failure), phase=self.phase, rank=self.comm.rank)
        if self.taken:
            self.summary["error"] = type(failure).__name__
            with contextlib.suppress(Exception):
                memory = [resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024]
                write_summary(alone(), self.folder, self._ended(str(failure), {}, memory))
        give_up(failure)

    def _stuck(self) -> None:
        """End a rank that a signal should have ended and that waits for others in MPI; on one rank MPI never waits."""
        if self.comm.size > 1:
            self._leave(Interrupted(f"Stopped by a signal in phase {self.phase}; nothing was run."))

    def _write_traceback(self, error: BaseException) -> None:
        text = f"{time.ctime()}, phase {self.phase}\n{''.join(traceback.format_exception(error))}"
        try:
            (self.folder / "traceback.txt").write_text(text)
        except OSError:
            with contextlib.suppress(OSError):
                print(text, file=sys.stderr, flush=True)

    def _solver(self, prepared: Prepared) -> Solver:
        def allocates(size: int) -> None:
            predicted.append(size)
            self.report.say(words(prepared.choice, size))

        predicted: list[int] = []
        solver = prepared.make_solver(self.signals.asked, allocates)
        if predicted:
            self.summary["matrix_bytes"] = {"predicted": predicted[0], "measured": solver.matrix_bytes}
            self.summary["allocated"].append(matrices(prepared.choice))
        return solver

    def _march(self, prepared: Prepared, solver: Solver) -> Result:
        case, cloud, problem = self.case, prepared.cloud, prepared.problem
        order = InCreationOrder(cloud)
        start, origin = prepared.solution(), None
        declared = self.comm.bcast(declared_parts(case) if is_root(self.comm) else None)
        if self.restart is not None:
            if not case.solver.restarts:
                raise CaseError(f"{case.solver.title} starts from the unloaded body; it takes no restart.")
            at_any_load = case.solver.finds_load
            origin = read_checkpoint(problem, order, self.restart, declared, self.restart_anyway, at_any_load)
            start = origin.start
            with prepared.options.active():
                solver.resume(_start(start))
            self.so_far = RunTotals.of(origin)
            self.earlier = self.comm.bcast(steps_before(origin) if is_root(self.comm) else None)
            self.summary["restart"] = {"step": start.step, "t": start.t}
            if problem.material_term.n_detached:
                self.summary["detached_particles"] = problem.material_term.n_detached
        step = start.step
        self.phases.now = "output"
        self._try_records(start)
        with self.phases.timed("output"):
            checkpoints = case.checkpoints if case.solver.restarts else 0
            if origin is not None and origin.inside(self.folder):
                # So that the next restart knows whose steps these are, if this run is killed before its end.
                self.summary["run"] = origin.record.run
            # From here on the folder is this run's.
            self.signals.patient = True
            if origin is None or not origin.inside(self.folder):
                try:
                    set_aside(self.comm, self.folder, None if origin is None else origin.path)
                except OutputError:
                    self.taken = True
                    raise
            self.taken = True
            write_summary(self.comm, self.folder, self._ended("running", {}, []))
            keeper = RunWriter(self.folder, case.history, self._fields(), checkpoints, start, order, origin, declared)
            self.keeper, self.history = keeper, keeper.history
            keeper.so_far = self.so_far.numbers
            self.summary["run"] = keeper.run
            if self._fields():
                write_surface(self.comm, self.folder, keeper.run, case.particles)
            if not keeper.took_over:
                self.report.warn(
                    f"No history of this case is beside the checkpoint: it starts at step {step}, and results that "
                    f"are made of it, as its largest force, know of nothing before."
                )

        def on_failure(at: float, dt: float, result: StepResult) -> None:
            self.failed.append(result)
            self.report.cut_back(at, dt, result)

        self.unit = solver.unit
        self.report.begin(start.t, step)
        self.phases.now = "solve"
        before = time.perf_counter()
        for converged in prepared.march(solver, _start(start), on_failure):
            self.phases.add("solve", time.perf_counter() - before)
            step += 1
            self.report.step(converged.t, solver.line(step, converged))
            self._say_detached(problem)
            self.steps.append(_step_summary(step, converged, solver.unit))
            self.so_far.add(converged)
            keeper.so_far = self.so_far.numbers
            self.failed.clear()
            with self.phases.timed("output"):
                state = Solution(problem, converged.u, converged.t, step, resume=converged.resume)
                state.tangent_at = solver.tangent_at
                keeper.write(state, converged.write_fields, converged.work)
                self._doubt(state)
                if case.control is not None:
                    self.steps[-1]["energies"] = state.energies
            before, self.phases.now = time.perf_counter(), "solve"
        keeper.save()
        self._say_what_holds(problem)
        confined = self._confined(prepared, solver, keeper.last)
        self.phases.now = "results"
        self.signals.patient = False
        with agreed(self.comm):
            results = _numbers(self.case.results(self.history)) if self.case.results is not None else {}
        if self.check:
            # What one rank finds holds for all.
            self.checks = self.comm.bcast(compared(case.expect, results) if is_root(self.comm) else None)
            self.summary["checks"] = recorded(self.checks)
        self.summary["unused_options"] = left = prepared.options.unused()
        self.signals.deaf = True  # the run has ended; nothing takes that back
        summary = self._write_summary("converged", results)
        if left:
            self.report.warn(
                f"nothing used the option{'s' if len(left) > 1 else ''} {' '.join(f'-{name}' for name in left)}."
            )
        if self.solver is not None and self.solver.ended:
            self.report.say(self.solver.ended)
        if NEED_NOT_CONVERGE in str((self.summary.get("scheme") or {}).get("note")):
            self.report.warn(
                f"The weights are {NEED_NOT_CONVERGE}: look whether the answer settles as the cloud gets finer."
            )
        for name, doubt in summary["doubts"].items():
            times = f"step time {doubt['t']:.6g}" + (f", the first of {doubt['steps']}," if doubt["steps"] > 1 else "")
            self.report.warn(f"{name} of the history at {times} {doubt['why']}.")
        if (summary.get("control") or {}).get("note"):
            self.report.warn(summary["control"]["note"])
        if confined is not None and confined.wrong:
            self.report.warn(confined_words(confined))
        found = self.so_far
        # Where the load is sought, equilibria past its limit are meant to be found.
        if found.unstable and not case.solver.finds_load:
            self.report.warn(
                f"{found.unstable} of {found.steps} equilibria are unstable, the first at step time "
                f"{found.first_unstable:.6g}; perturb the body, or let "
                f'Steps(unstable="shorten") end the run before.'
            )
        if found.branching:
            self.report.warn(
                f"At {found.branching} of {found.steps} steps damage jumped to where other branches lead away, the "
                f"first at step time {found.first_branching:.6g}: round-off may decide what follows, and with it the "
                f"units and the order of particles; take smaller steps, or perturb the body."
            )
        self._show(results)
        return Result(self.folder, results, self.history, summary, keeper.last, keeper.run, case.expect)

    def _try_records(self, start: Solution) -> None:
        """Evaluate once what the case asks for, before files of an earlier run are replaced (collective).

        Raises
        ------
        CaseError
            A field has no row for each particle, or not the component of the picture.
        """
        for name, quantity in self.case.history.items():
            value = quantity.evaluate(start)
            note = quantity.note(start)
            if note:
                self.report.warn(f"{name} of the history {note}.")
            with agreed(self.comm):
                if isinstance(value, Sequence) or np.ndim(value) or np.asarray(value).dtype.kind not in "fiub":
                    raise CaseError(
                        f"{type(quantity).__name__} of the history must return a number, not {type(value).__name__}."
                    )
        picture = self.case.picture
        for field in self._fields():
            found = field(start)
            with agreed(self.comm):
                try:
                    values = np.asarray(found)
                except ValueError:  # rows of different lengths
                    values = np.empty(0, dtype=object)
                name = getattr(field, "__name__", repr(field))
                if values.shape[:1] != start.u.shape[:1] or values.dtype.kind not in "fiub" or values.ndim > 3:
                    raise CaseError(
                        f"The field {name} must return numbers, a row for each of the {len(start.u)} particles of this "
                        f"rank, not an array of {values.dtype} of shape {values.shape}."
                    )
                if picture is not None and field is picture.field:
                    _refuse_component(values.ndim, picture.component)

    def _doubt(self, state: Solution) -> None:
        """Note which numbers of the history of a step may be wrong, for the summary (collective)."""
        found = {name: quantity.doubt(state) for name, quantity in self.case.history.items()}
        if any(found.values()):
            self.steps[-1]["doubts"] = {name: why for name, why in found.items() if why}

    def _fields(self) -> list[Field]:
        """Return the fields to write: the declared ones, and what the picture shows."""
        wanted = self.case.written
        if self.case.picture is not None:
            wanted += [f for f in (displacement, self.case.picture.field) if f not in wanted]
        return wanted

    def _say_detached(self, problem: Problem) -> None:
        lost = problem.material_term.n_detached
        if lost > self.summary.get("detached_particles", 0):
            self.report.say(f"           {lost} particles have too few bonds left for a gradient; their stress is gone")
        if lost:
            self.summary["detached_particles"] = lost

    def _say_what_holds(self, problem: Problem) -> None:
        """Say whether bonds that broke have left the body in one piece, and what of its load it still carries."""
        if problem.damage is None or not problem.damage.bonds.count_broken():
            return
        pieces, lone = pieces_left(problem)
        self.summary["pieces"] = {"pieces": pieces, "lone_particles": lone}
        found = self.so_far
        left = found.last_force / found.largest_force if found.largest_force > 0.0 else float("nan")
        self.summary["pieces"]["forces_left"] = left
        whole = "bonds still hold the body in one piece" if pieces == 1 else f"the body is in {pieces} pieces"
        beside = f", beside {lone} lone particles" if lone else ""
        carried = f"; supports and loads carry {left:.2g} of their largest forces in this run" if left == left else ""
        # A checkpoint of an earlier version does not tell what the forces before it were.
        carried += " since its restart" if carried and not found.whole else ""
        self.report.say(f"{whole}{beside}{carried}")

    def _confined(self, prepared: Prepared, solver: Solver, last: Solution) -> Unbalanced | None:
        """Find what unbalanced forces make of the last state of a nearly incompressible body (collective)."""
        problem = prepared.problem
        with agreed(self.comm):
            asked = nearly_incompressible(self.case, problem.dim)
        if not asked or not self.steps:
            return None
        with prepared.options.active():
            found = unbalanced(problem, solver, unbalanced_areas(self.case, problem), last.unknowns, last.t)
        note = confined_words(found) if found.wrong else ""
        self.summary["unbalanced"] = dataclasses.asdict(found) | {"note": note}
        return found

    def _write_summary(self, status: str, results: Mapping[str, float] | None = None) -> dict[str, Any]:
        """Write the summary of a run that has ended, and return it as the file has it (collective)."""
        memory = self.comm.allgather(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024)
        summary = self._ended(status, results or {}, memory)
        write_summary(self.comm, self.folder, summary)
        return dict(plain(summary))

    def _ended(self, status: str, results: Mapping[str, float], memory: list[int]) -> dict[str, Any]:
        return self.summary | {
            "status": status,
            "results": dict(results),
            "steps": (steps := [*self.earlier, *self.steps]),
            "doubts": _doubts(steps),
            **({} if self.case.control is None else {"control": largest_share(steps)}),
            "failed_attempts": [_attempt(result, self.unit) for result in self.failed],
            "timings": self.phases.timings,
            "peak_memory_bytes": memory,
        }

    def _show(self, results: dict[str, float]) -> None:
        """Print the results and draw the picture of a run that has ended; whatever fails here, its results stand."""
        self.report.results(results)
        for line in lines(self.checks) if self.checks else ():
            self.report.say(line)
        self.report.say(f"results in {self.folder}")
        if self.case.picture is not None and is_root(self.comm):
            with self.phases.timed("picture"):
                try:
                    path = draw(self.folder, self.case.picture, self.folder.name)
                    self.report.say(f"picture in {path}")
                except Exception as error:
                    self.report.warn(f"The run is finished, but its picture could not be drawn: {described(error)}")

    def _describe(self, problem: Problem) -> None:
        body, material_term, comm = problem.body, problem.material_term, self.comm
        cloud = body.cloud
        bonds, points, ghosts = total(comm, [body.families.n_bonds, material_term.n_points, cloud.n_ghost])
        counts = {"particles": cloud.n_global, "bonds": int(bonds), "gradient_points": int(points)}
        self.summary |= {**counts, "ghosts": int(ghosts), "dimension": cloud.dim, "horizon": cloud.horizon}
        if cloud.varies:
            self.summary["least_horizon"] = cloud.least_horizon
            self.report.say(f"horizons from {cloud.least_horizon:.6g} to {cloud.horizon:.6g}")
        self.summary |= _labels(self.case, self._fields())
        self.summary["allocated"] = list(problem.parts)
        self.report.say(
            f"{cloud.n_global} particles in {cloud.dim}D, {int(bonds)} bonds, "
            f"{f'{int(points)} gradient points, ' if points else ''}{comm.size} rank{'s' if comm.size > 1 else ''}"
        )
        if self.case.symmetry:
            planes = ", ".join(f"{plane.axis} = {plane.at:g}" for plane in self.case.symmetry)
            self.report.say(f"mirror planes {planes}; all numbers are those of the part before them")
        scheme = "bonds" if self.case.of_bonds else type(self.case.gradients).__name__
        self.summary["scheme"] = {"name": scheme, "note": material_term.note}
        if material_term.note:
            self.report.say(f"scheme: {material_term.note}")
        missed = missed_fracture_energy(self.case)
        if missed is not None:
            self.summary["fracture_energy"] = {"note": missed}
            self.report.warn(missed)

    def _note(self, problem: Problem) -> None:
        """Say what a user should know before relying on the numbers (collective)."""
        locking = locking_note(self.case, problem)
        if locking:
            self.report.warn(locking)
        found = notes(self.case, problem)
        for note in found:
            self.report.say(f"note: {note}")
        self.summary["notes"] = [*filter(None, [locking]), *found]

    def _report_loads(self, problem: Problem) -> None:
        resultants = [found for term in problem.terms for found in term.resultants]
        self.summary["loads"] = [
            {"condition": name, "t": t, "resultant": force.tolist()} for name, t, force in resultants
        ]
        for name, t, force in resultants:
            self.report.say(f"{name}: resultant {' '.join(f'{f:.6g}' for f in force)} at step time {t:g}")
        held = problem.supports.held_by_condition()
        self.summary["supports"] = [
            {"condition": name, "components": axes, "particles": count} for name, axes, count in held
        ]
        for name, axes, count in held:
            self.report.say(f"{name}: {count} particle{'s' if count != 1 else ''} held in {' and '.join(axes)}")
        cut = problem.supports.held_at_cut_families()
        if cut and problem.body.surface is not None and not self.case.of_bonds:
            # With weights that conform to the surface uniform stress is in equilibrium with what holds it.
            cut *= int(any(self.comm.allgather(bool(unbalanced_areas(self.case, problem).any()))))
        self.summary["held_at_cut_families"] = cut
        if cut:
            self.report.say(
                f"note: {cut} particles are held at a face that cuts their families; stresses within two horizons of "
                f"it are those of no continuum, hold a layer two horizons deep where they matter"
            )


def _labels(case: Case, fields: Sequence[Field]) -> dict[str, Any]:
    """Return what pictures and tables need to say of numbers: units, kinds of number, cracks of a plane body."""
    return {
        "units": {} if case.units is None else dataclasses.asdict(case.units),
        "dimensions": {
            "history": {name: quantity.dimension for name, quantity in case.history.items()},
            "fields": {field.__name__: dimension_of(field) for field in fields},
        },
        "cracks": [[[float(x) for x in point] for point in crack.line] for crack in case.cracks if len(crack.line)],
        "cuts": [recorded_crack(crack) for crack in case.cracks],
        "thickness": case.particles.thickness,
    }


def _start(solution: Solution) -> Start:
    return Start(solution.unknowns, solution.t, solution.resume, solution.tangent_at)


def _numbers(results: Any) -> dict[str, float]:
    """Return what the case's results function gave as numbers; raise where one is none."""
    if not isinstance(results, Mapping):
        raise RunError(f"results must return a mapping of names to numbers, not {type(results).__name__}", of_user=True)
    found = {}
    for name, value in results.items():
        if getattr(value, "ndim", 0):
            raise RunError(f"results must return numbers; {name!r} is an array of shape {value.shape}", of_user=True)
        try:
            found[str(name)] = float(value)
        except (TypeError, ValueError):
            raise RunError(f"results must return numbers; {name!r} is {type(value).__name__}", of_user=True) from None
        if not math.isfinite(found[str(name)]):
            raise RunError(f"results must return finite numbers; {name!r} is {found[str(name)]}", of_user=True)
    return found


def _refuse_component(rank: int, component: str) -> None:
    """Raise CaseError where a field of scalars, vectors or tensors has no such component."""
    if len(component) != rank - 1 or any(letter not in "xyz" for letter in component):
        known = ("empty", "x, y or z", "xx, xy, ...")[rank - 1]
        raise CaseError(f"A component of the picture's field is {known}, not {component!r}.")


def _step_summary(step: int, converged: Converged, unit: str) -> dict[str, Any]:
    cut_backs = [_attempt(failure, unit) for failure in converged.failures]
    damage = (
        {"broken_bonds": converged.broken, "sweeps": converged.sweeps} if converged.broken or converged.sweeps else {}
    )
    return {"step": step, "t": converged.t, **_attempt(converged.result, unit), **damage, "cut_backs": cut_backs}


def _doubts(steps: Iterable[Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """Return of each number of the history that may be wrong when and why first, and at how many steps."""
    found: dict[str, dict[str, Any]] = {}
    for step in steps:
        for name, why in step.get("doubts", {}).items():
            found.setdefault(name, {"t": step["t"], "why": why, "steps": 0})["steps"] += 1
    return found


def _attempt(result: StepResult, unit: str) -> dict[str, Any]:
    return {
        "reason": result.reason,
        "norms": result.norms,
        "reference": result.reference,
        "negative_pivots": result.negative_pivots,
        **({"growth": result.growth} if result.growth else {}),
        f"{unit.lower()}_iterations": result.iterations,
        "linear_iterations": result.linear_iterations,
    }


def _versions() -> dict[str, str]:
    packages = ("pdpetsc", *OF_NUMBERS)
    # Those that are missing are named too: pdpetsc is, where it runs from a checkout.
    found = {"python": "", "petsc": petsc_version(), **dict.fromkeys(packages, "not installed")}
    return found | versions(packages)
