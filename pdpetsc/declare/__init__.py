"""What a case declares: particles, regions, influence, conditions, schedules, steps and quantities of interest.

Nothing here knows ranks or PETSc. Particles come in parts, so that no rank needs to hold all of a lattice.
"""
