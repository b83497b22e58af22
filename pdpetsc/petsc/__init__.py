"""What PETSc holds: matrices, options, preconditioners, and the calls that petsc4py does not offer."""

import contextlib
import signal

import petsc4py

# Start PETSc, where the command line or a script has not. Its .petscrc files, of the home and of the working folder,
# can load any library and change any tolerance, so they are not read.
petsc4py.init(["pdpetsc", "-skip_petscrc"])

# PETSc ends a process whose reader has gone away, as with `| head`; Python gets an error instead, as it had asked for.
with contextlib.suppress(ValueError):
    signal.signal(signal.SIGPIPE, signal.SIG_IGN)
