"""Solvers: Newton's method in load steps, path following, from event to event, dynamic relaxation.

``table`` says which class solves what a case declares; ``protocol`` is what all of them offer.
"""

# PETSc is started there, before any file of this room imports it.
import pdpetsc.petsc  # noqa: F401
