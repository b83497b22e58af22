"""PETSc objects: matrices, options, preconditioners, and functions that petsc4py does not wrap."""

import contextlib
import signal

import petsc4py

# Start PETSc unless the command line or a script has. The .petscrc files of the home and working directory are not
# read: they can load any library and change any tolerance.
petsc4py.init(["pdpetsc", "-skip_petscrc"])

# PETSc ends a process whose output pipe closes, as with `| head`. Restore Python's behaviour, an exception.
with contextlib.suppress(ValueError):
    signal.signal(signal.SIGPIPE, signal.SIG_IGN)
