"""Boundary value problem: body, state, terms of the residual, supports, and assembly of the tangent."""
