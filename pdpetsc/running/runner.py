"""Running a case: prepare, solve, observe, finish."""

from __future__ import annotations

import time
import uuid
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pdpetsc.case import Case
from pdpetsc.declare.expected import Expected
from pdpetsc.discrete.communicator import Comm, agreed, communicator, is_root
from pdpetsc.discrete.failure import messages_apart
from pdpetsc.errors import CaseError, OutputError, of_petsc
from pdpetsc.gradient.weights import MAY_NOT_CONVERGE
from pdpetsc.kernels.compile import cache_trouble, first_compilation
from pdpetsc.output.checkpoint import read_checkpoint
from pdpetsc.output.files import InCreationOrder
from pdpetsc.output.fingerprint import declared_parts, refuse_differing
from pdpetsc.output.folder import holding, set_aside
from pdpetsc.output.history import History
from pdpetsc.output.labels import Labels
from pdpetsc.output.observer import Observed, Origin
from pdpetsc.output.progress import LogReport, Report
from pdpetsc.petsc.jacobian import matrices, words
from pdpetsc.petsc.options import refuse_files
from pdpetsc.running.checks import Check, compared, failure, lines, recorded, refuse_unchecked
from pdpetsc.running.description import describe, versions_in_use
from pdpetsc.running.ending import ended_by, leave_if_stuck
from pdpetsc.running.observers import observers_of
from pdpetsc.running.prepare import Prepared, prepare
from pdpetsc.running.record import RunRecord
from pdpetsc.running.result import Result, named_numbers
from pdpetsc.running.signals import Signals, watched
from pdpetsc.running.suited import refuse_contact_without_weights
from pdpetsc.solvers.protocol import Solver, Start, StepResult

# A case with the dimension, scheme, materials and damage of an earlier one loads its kernels from numba's cache. An
# elastic plane body compiles for 20 s, a plastic solid for 110 s.
COMPILING = "compiling kernels for this kind of case: 20 s to 2 min now, none in later runs ..."

# Added over free mass from which a run warns.
MUCH_MASS = 0.05


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
    """Run a case and return its results.

    Parameters
    ----------
    case : Case
        The case.
    output : str or Path
        Folder for ``summary.json``, ``history.csv``, ``fields.h5``, ``fields.xdmf``, ``checkpoint.h5``.
    options : mapping, optional
        PETSc options without dash; they override those of the case.
    restart : str or Path, optional
        Checkpoint to continue from, or the folder of a run with a checkpoint.
    parameters : mapping, optional
        Parameters of the case, written to the summary.
    restart_anyway : bool
        Continue from a checkpoint of a different case, with another material, load, crack, ...
    comm : communicator of mpi4py or petsc4py, optional
        The ranks; by default all. Groups of ranks can run cases at the same time, each in its own folder.
    report : callable
        Creates the report of the run from its ranks; by default the logger ``pdpetsc``.
    check : bool
        Compare the results with ``Case.expect``, and print and record the comparison.
    asked : mapping, optional
        The command and the text of the case file, written to the summary for the report.

    Returns
    -------
    Result
        The named results of the case, with history, summary, fields and the last solution.

    Raises
    ------
    CaseError
        The case or an option is wrong; nothing was run, and the folder is unchanged. Exception: if PETSc refuses an
        option only in the first solve, files of an earlier run are in ``earlier/``.
    SolveError, OutputError, Interrupted
        The run ended early; the folder has all records up to the last converged step.
    RunError
        A function of the case, PETSc, the memory or pdpetsc itself failed; records as above. ``__cause__`` is the
        original exception.
    CheckError
        The run has ended and its folder is complete, but a result is not as expected.

    Notes
    -----
    Collective on ``comm``. All of these errors are raised on every rank. A rank that fails alone prints the reason on
    stderr, writes it to ``summary.json``, and aborts all, because the others would wait in MPI for ever. A run on a
    single rank never aborts.

    ``summary.json`` has the status "running" from the first written file on, at the end "converged" or the reason why
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
    entries = {
        **(asked or {}),
        "parameters": dict(parameters or {}),
        "versions": versions_in_use(),
        "ranks": ranks.size,
    }
    with messages_apart(ranks), holding(ranks, folder), report(ranks) as log:
        case_run = _Run(case, RunRecord(ranks, folder, entries), log, case.expect if check else None)
        result = case_run(dict(options or {}), None if restart is None else Restart(restart, restart_anyway))
        if (wrong := failure(case_run.checks)) is not None:
            wrong.agreed = ranks.size
            raise wrong
        return result


# Solvers whose PETSc objects must not be destroyed after an error of PETSc.
_abandoned: list[Solver] = []


@dataclass(frozen=True)
class Restart:
    """The checkpoint to continue from, and True if its case may differ."""

    path: str | Path
    anyway: bool


class _Run:
    """One run: prepares the problem, solves the steps, lets observers record them, and finishes."""

    signals: Signals

    def __init__(self, case: Case, record: RunRecord, report: Report, expect: Mapping[str, Expected] | None) -> None:
        self.case = case
        self.record = record
        self.report = report
        self.expect = expect
        self.checks: list[Check] = []
        self.prepared: Prepared | None = None
        self.solver: Solver | None = None

    def __call__(self, options: Mapping[str, Any], restart: Restart | None) -> Result:
        with watched(self.record.comm, lambda: leave_if_stuck(self.record)) as self.signals:
            try:
                prepared, solver = self._prepare(options)
                try:
                    history = self._march(prepared, solver, restart)
                    result = self._finish(prepared, solver, history)
                finally:
                    self.record.summary["unused_options"] = prepared.options.unused()
            except BaseException as error:
                failure = ended_by(error, self.record, self.signals)
                # After an error of PETSc its objects cannot be destroyed safely, not by Python either.
                if self.solver is not None and of_petsc(error):
                    _abandoned.append(self.solver)
                else:
                    self._free()
                if failure is error:
                    raise
                raise failure from error
            self._free()
        return result

    def _free(self) -> None:
        """Free memory of solver and problem outside Python."""
        if self.solver is not None and self.prepared is not None:
            self.solver.destroy()
            for field in self.prepared.problem.fields:
                field.destroy()

    def _prepare(self, options: Mapping[str, Any]) -> tuple[Prepared, Solver]:
        record, report, declared = self.record, self.report, self.case
        if self.expect is not None:
            with agreed(record.comm):
                refuse_unchecked(self.expect)
        with first_compilation(lambda: report.say(COMPILING)):
            prepared = self.prepared = prepare(declared, record.comm, options, record.phases)
        case = self.case = prepared.case
        if cache_trouble():
            report.say(
                f"Every run compiles its kernels, because their cache cannot be written: {cache_trouble()}. Set "
                f"NUMBA_CACHE_DIR to a folder of yours."
            )
        record.summary |= describe(case, prepared.problem, declared, report)
        refuse_contact_without_weights(case, prepared.problem.material_term.unsuited)
        record.phases.now = "set-up"
        in_force = record.summary["options"] = prepared.options.in_force
        of_environment = [name for name, option in in_force.items() if option["from"] == "environment"]
        refuse_files(record.comm, in_force)
        if of_environment:
            report.say(f"options from PETSC_OPTIONS: {' '.join(f'-{name}' for name in of_environment)}")
        solver = self.solver = self._solver(prepared)
        record.unit = solver.unit
        record.summary["solver"] = solver.description()
        report.say(f"solver: {solver.description()}")
        inertia = prepared.problem.inertia
        if inertia is not None and inertia.added > 0.0:
            record.summary["added_mass"] = inertia.added
            if inertia.added > MUCH_MASS:
                report.warn(
                    f"{100.0 * inertia.added:.3g} % of the mass are added. Compare with a shorter least_step, or check "
                    f"that the kinetic energy stays small."
                )
        return prepared, solver

    def _solver(self, prepared: Prepared) -> Solver:
        def allocates(size: int) -> None:
            predicted.append(size)
            self.report.say(words(prepared.choice, size))
            self.report.detail(f"tangent: {prepared.choice.why}")

        predicted: list[int] = []
        solver = prepared.make_solver(self.signals.asked, allocates)
        if predicted:
            self.record.summary["matrix_bytes"] = {"predicted": predicted[0], "measured": solver.matrix_bytes}
            self.record.summary["allocated"].append(matrices(prepared.choice))
        return solver

    def _march(self, prepared: Prepared, solver: Solver, restart: Restart | None) -> History:
        """Solve and record the steps; return the history."""
        record, phases, report = self.record, self.record.phases, self.report
        order = InCreationOrder(prepared.cloud)
        declared = record.comm.bcast(declared_parts(self.case) if is_root(record.comm) else None)
        start, origin = prepared.solution(), None
        if restart is not None:
            origin = self._origin(prepared, solver, order, restart, declared)
            start = origin.start
        history, record.observers = observers_of(self.case, prepared.problem, declared)
        phases.now = "output"
        for observer in record.observers:
            observer.rehearse(start, report)
        with phases.timed("output"):
            run = self._take_folder(origin)
            record.begin(Observed(record.folder, run, report, solver, order, start, origin, record.steps))

        def on_failure(at: float, dt: float, result: StepResult) -> None:
            record.failed.append(result)
            report.cut_back(at, dt, result)

        phases.now = "solve"
        before = time.perf_counter()
        march_start = Start(start.unknowns, start.t, start.resume, start.tangent_at)
        for converged in prepared.march(solver, march_start, on_failure):
            phases.add("solve", time.perf_counter() - before)
            with phases.timed("output"):
                record.step(converged)
            before, phases.now = time.perf_counter(), "solve"
        with prepared.options.active():
            record.end()
            record.judge()
        return history

    def _origin(
        self, prepared: Prepared, solver: Solver, order: InCreationOrder, restart: Restart, declared: Mapping[str, str]
    ) -> Origin:
        """Read the checkpoint from which the run continues."""
        title, finds_load = self.case.solver.title, self.case.solver.finds_load
        if not self.case.solver.restarts:
            raise CaseError(f"{title} cannot restart, because it starts from the unloaded body. Leave out restart.")
        origin = read_checkpoint(prepared.problem, order, restart.path, declared, restart.anyway, finds_load)
        start = origin.start
        with prepared.options.active():
            solver.resume(Start(start.unknowns, start.t, start.resume, start.tangent_at))
        self.record.steps.extend(dict(step) for step in origin.steps)
        self.record.summary["restart"] = {"step": start.step, "t": start.t}
        self.report.say(f"restart from step {start.step} of {origin.path.parent}, t = {start.t:.6g}")
        return origin

    def _take_folder(self, origin: Origin | None) -> str:
        """Reserve the folder for this run; return the identifier of its files."""
        record = self.record
        own = origin if origin is not None and origin.inside(record.folder) else None
        self.signals.patient = True
        if own is None:
            if is_root(record.comm) and (record.folder / "summary.json").exists():
                self.report.say(f"the results of an earlier run go to {record.folder / 'earlier'}")
            try:
                set_aside(record.comm, record.folder, None if origin is None else origin.path)
            except OutputError:
                record.taken = True
                raise
        record.taken = True
        run: str = record.comm.bcast(uuid.uuid4().hex) if own is None else own.run
        record.summary["run"] = run
        record.write("running")
        return run

    def _finish(self, prepared: Prepared, solver: Solver, history: History) -> Result:
        """Evaluate and check the results, write the summary, and print warnings."""
        case, record, report = self.case, self.record, self.report
        record.phases.now = "results"
        self.signals.patient = False
        with agreed(record.comm):
            results = named_numbers(case.results(history.columns)) if case.results is not None else {}
        for observer in record.observers:
            twice = set(results) & set(observer.results())
            if twice:
                raise CaseError(f"Two results are named {sorted(twice)[0]!r}. Rename that of the case.")
            results |= observer.results()
        if self.expect is not None:
            # An error on one rank applies to all.
            self.checks = record.comm.bcast(compared(self.expect, results) if is_root(record.comm) else None)
            record.summary["checks"] = recorded(self.checks)
        record.summary["unused_options"] = left = prepared.options.unused()
        self.signals.deaf = True  # the run has ended, whatever follows
        summary = record.write("converged", results)
        if left:
            plural = "s" if len(left) > 1 else ""
            report.warn(
                f"No solver used the option{plural} {' '.join(f'-{name}' for name in left)}. Check the spelling, or "
                f"remove {'them' if plural else 'it'}."
            )
        if solver.ended:
            report.say(solver.ended)
        if unsuited := prepared.problem.material_term.unsuited:
            report.warn(f"The run used {MAY_NOT_CONVERGE}. {unsuited} Otherwise compare two spacings.")
        for warning in record.warnings():
            report.warn(warning)
        report.results(results, Labels.of(record.summary))
        for line in lines(self.checks) if self.checks else ():
            report.say(line)
        report.say(f"results in {record.folder}")
        for observer in record.observers:
            observer.finish()
        observed = record.observed
        assert observed is not None
        return Result(record.folder, results, history.columns, summary, observed.last, observed.run, case.expect)
