"""The end of a run by an error: one message on all ranks, exit status, records up to the last step."""

from __future__ import annotations

import contextlib
import sys
import time
import traceback
from typing import NoReturn

from pdpetsc.discrete.communicator import is_root
from pdpetsc.discrete.failure import all_failed, give_up
from pdpetsc.errors import CaseError, Interrupted, OutputError, PdpetscError, RunError, described, users_line
from pdpetsc.running.record import RunRecord
from pdpetsc.running.signals import Signals


def ended_by(error: BaseException, record: RunRecord, signals: Signals) -> PdpetscError:
    """Finish the record after an error and return the error with its message; abort if this rank fails alone."""
    comm, phase = record.comm, record.phases.now
    failure, stopped = described(error), isinstance(error, KeyboardInterrupt)
    failure.phase = failure.phase or phase
    if failure.rank is None and comm.size > 1 and failure.agreed < comm.size:
        failure.rank = comm.rank
    if stopped:
        kept = "results are complete up to the step before" if record.taken else "nothing was run"
        failure = Interrupted(f"Stopped by a signal in phase {phase}; {kept}.")
    signals.deaf = True
    together = all_failed(error, failure)
    signals.deaf = not together
    if together and failure.agreed < comm.size:
        failure.rank = None
    failure = _of_right_status(failure, record, together)
    if failure.bug and (is_root(comm) or not together):
        _write_traceback(error, record)
    if not together:
        leave(failure, record)
    failure.agreed = comm.size
    if not record.taken:
        return failure
    status = str(failure)
    # A signal may interrupt a write; files on disk remain.
    if not (stopped or isinstance(failure, OutputError)):
        try:
            record.end()
        except KeyboardInterrupt:
            status += " A second signal came before its last checkpoint was written."
        except Exception as other:
            status += f" {described(other)}"
    record.summary["error"] = type(failure).__name__
    # The reason is recorded, whatever signals arrive.
    signals.deaf = True
    with contextlib.suppress(Exception):
        record.write(status)
    return failure


def leave(failure: PdpetscError, record: RunRecord) -> NoReturn:
    """Abort all ranks; print the reason, and write it to the summary from this rank alone."""
    failure = failure.of_one_rank(record.phases.now, record.comm.rank)
    if record.taken:
        record.summary["error"] = type(failure).__name__
        with contextlib.suppress(Exception):
            record.write_alone(str(failure))
    give_up(failure)


def leave_if_stuck(record: RunRecord) -> None:
    """End a rank that got a signal but waits for others in MPI; not needed on a single rank."""
    if record.comm.size > 1:
        leave(Interrupted(f"Stopped by a signal in phase {record.phases.now}; nothing was run."), record)


def _of_right_status(failure: PdpetscError, record: RunRecord, together: bool) -> PdpetscError:
    """Return the error with its exit status: 2 before the first solve, then 1."""
    phase = record.phases.now
    if record.solved:
        if not isinstance(failure, CaseError):
            return failure
        return RunError(str(failure), users_line(failure), phase, None if together else record.comm.rank)
    if failure.of_option and phase in ("kernels", "model", "set-up", "solve"):
        return CaseError(f"PETSc refused the solver options; check their names and values: {failure.what}.")
    if failure.of_user and not record.taken and failure.exit_status == 1:
        failure.exit_status = CaseError.exit_status
    return failure


def _write_traceback(error: BaseException, record: RunRecord) -> None:
    text = f"{time.ctime()}, phase {record.phases.now}\n{''.join(traceback.format_exception(error))}"
    try:
        (record.folder / "traceback.txt").write_text(text)
    except OSError:
        with contextlib.suppress(OSError):
            print(text, file=sys.stderr, flush=True)
