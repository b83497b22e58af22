"""Solvers: Newton's method in load steps, path following, event-driven solver, dynamic relaxation.

``table`` maps declared solvers to classes; ``protocol`` is their common interface.
"""

# Start PETSc before a file of this folder imports it.
import pdpetsc.petsc  # noqa: F401
