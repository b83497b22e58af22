"""Equilibrium: PETSc matrices, SNES and load stepping. Only this package and the command line import petsc4py."""
