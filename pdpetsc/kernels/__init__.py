"""Numba loops on flat arrays, without classes, MPI or PETSc.

Every loop that depends on the dimension is written once inside a factory ``<name>_kernel(dim)``, where ``dim`` is a
compile-time constant; the factory returns the compiled specialisation.
"""
