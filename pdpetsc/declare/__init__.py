"""Declarations of a case: particles, regions, influence, conditions, schedules, steps and solvers.

No module here uses MPI or PETSc. Particles are created in parts, so that no rank stores a whole lattice.
"""
