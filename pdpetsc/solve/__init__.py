"""Equilibrium: PETSc matrices, SNES and load stepping. Only this package and the command line import petsc4py."""

import petsc4py

# Where PETSc has not been started yet, by the command line or a script: its .petscrc files, of the home folder and of
# wherever one stands, can load any library and change any tolerance, so they are not read.
petsc4py.init(["pdpetsc", "-skip_petscrc"])
