"""Pressure that widens shocks in explicit motions to a few spacings."""

from __future__ import annotations

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.declare.damping import BulkViscosity
from pdpetsc.discrete.communicator import largest
from pdpetsc.problem.problem import Problem
from pdpetsc.problem.state import State
from pdpetsc.terms.material_points import MaterialPoints


class ViscousPressure:
    """Compute the forces of ``sigma = rho h (c_1 c_d - c_2^2 h min(tr D, 0)) tr(D) 1`` at gradient points.

    ``D`` is the rate of deformation, ``P = J sigma F^-T``; points that fail have the share phi of it.

    Parameters
    ----------
    declared : BulkViscosity
        ``c_1``, ``c_2``.
    problem : Problem
        The problem, with gradient points.
    density : (n_owned,) float64
        Densities of the own particles [mass / volume].
    stiffness : (n_owned,) float64
        ``rho c_d^2``, the modulus of waves of compression [stress].

    Attributes
    ----------
    ratio : float
        Largest damping ratio of waves as short as the spacing, at the last evaluation [-].

    Notes
    -----
    Construction and ``force`` are collective.
    """

    def __init__(self, declared: BulkViscosity, problem: Problem, density: Float, stiffness: Float) -> None:
        assert isinstance(problem.material_term, MaterialPoints)
        self._declared, self._problem, self._term = declared, problem, problem.material_term
        cloud, dim = problem.body.cloud, problem.dim
        self._size = (cloud.volume[: cloud.n_owned] / problem.body.thickness) ** (1.0 / dim)
        self._density, self._speed = density, np.sqrt(stiffness / density)
        self.ratio = declared.linear

    def force(self, state: State, velocity: Float) -> Float:
        """Return the resisting forces (n_rows, dim) [force] at a state, for velocities (n_rows, dim)."""
        body, operator, dim = self._problem.body, self._term.operator, self._problem.dim
        rate = operator.gradient(State(body, velocity).u_local)
        phi = None if self._problem.damage is None else self._problem.damage.conducting_points
        # Points that have failed carry nothing, and their gradients may be singular.
        kept = np.arange(len(rate)) if phi is None else np.flatnonzero(phi > 0.0)
        if self._term.linear:
            J, inverse = np.ones(len(kept)), np.broadcast_to(np.eye(dim), (len(kept), dim, dim))
        else:
            F = self._term.deformation(state)[kept]
            J, inverse = np.linalg.det(F), np.linalg.inv(F)
        change, at = np.einsum("pij,pji->p", rate[kept], inverse), operator.owner[kept]
        steep = self._declared.quadratic**2 * self._size[at] * np.maximum(-change, 0.0)
        resistance = self._declared.linear * self._speed[at] + steep
        stress = self._density[at] * self._size[at] * resistance * change * (1.0 if phi is None else phi[kept])
        self.ratio = largest(body.cloud.comm, resistance / self._speed[at], initial=0.0)
        P = np.zeros_like(rate)
        P[kept] = (J * stress)[:, None, None] * inverse.transpose(0, 2, 1)
        f = np.zeros((body.cloud.n_local, dim))
        operator.divergence(P, f)
        return body.gather(f)
