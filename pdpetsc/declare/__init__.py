"""What a case declares: particles, regions, influence, conditions, schedules, steps and solvers.

Nothing here uses MPI or PETSc. Particles come in parts, so that no rank needs to hold all of a lattice.
"""
