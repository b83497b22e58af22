"""Solvers of motion with inertia."""
