"""Error of a nearly incompressible body by unbalanced forces of a uniform stress near supports."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.case import Case
from pdpetsc.control.by_shear import twice_shear
from pdpetsc.discrete.communicator import agreed, count_nonzero, largest, total
from pdpetsc.discrete.surface import Surface, surface_of
from pdpetsc.errors import CaseError
from pdpetsc.output.observer import Observer, StepRecords
from pdpetsc.problem.problem import Problem
from pdpetsc.solvers.protocol import Solver

# A material with a larger ratio of kappa to 2 mu is nearly incompressible: nu above 0.44.
STIFF = 4.0
# Areas below this share of the cell of their particle are zero; conforming weights are exact to 1e-10.
NONE = 1e-6
# Step of the displacement for differences of the stress, in spacings.
STEP = 1e-5
# A run warns above this share of the stress, or of the displacement.
WRONG = 0.05
# A run also warns if the solver cannot compute that share and the number of particles with unbalanced forces exceeds
# this share of held particles: some are always beside the ends of a clamped edge.
MANY = 0.2


@dataclass(frozen=True)
class Unbalanced:
    """Effect of the unbalanced forces of a uniform stress on free particles.

    Attributes
    ----------
    particles, held : int
        Number of free particles with unbalanced forces, and of held particles.
    stress, displacement : float or None
        First-order change of stress and displacement without these forces, relative root mean squares over the volume
        [-]; None if the solver cannot compute it.
    """

    particles: int
    held: int
    stress: float | None
    displacement: float | None

    @property
    def wrong(self) -> bool:
        """Return True if the result is unreliable."""
        if self.stress is None or self.displacement is None:
            return self.particles > MANY * self.held
        return not max(self.stress, self.displacement) <= WRONG


class UnbalancedForces(Observer):
    """Estimates the effect of unbalanced forces on the last state of a nearly incompressible body."""

    def __init__(self, case: Case) -> None:
        self._case = case
        self._found: Unbalanced | None = None

    def judge(self) -> None:
        """Solve for the effect of unbalanced forces."""
        observed = self.observed
        problem, last, origin = observed.problem, observed.last, observed.origin
        if last.step == (0 if origin is None else origin.start.step):
            return
        with agreed(observed.comm):
            asked = nearly_incompressible(self._case, problem.dim)
        if asked:
            areas = unbalanced_areas(self._case, problem)
            self._found = unbalanced(problem, observed.solver, areas, last.unknowns, last.t)

    def summary(self, steps: StepRecords) -> Mapping[str, Any]:
        """Return the estimate, with the warning as its note."""
        if self._found is None:
            return {}
        return {"unbalanced": asdict(self._found) | {"note": "".join(self.warnings(steps))}}

    def warnings(self, steps: StepRecords) -> list[str]:
        """Return the warning if the result is unreliable."""
        return [words(self._found)] if self._found is not None and self._found.wrong else []


def nearly_incompressible(case: Case, dim: int) -> bool:
    """Return True if a case has a nearly incompressible material, or patches for one (not collective).

    False for bodies with failing bonds, with a temperature as unknown, and with materials of bonds.
    """
    if case.of_bonds or case.damage is not None or case.heat is not None or dim == 1:
        return False
    if case.gradients.patches is not None:
        return True
    return any(one.bulk_like_modulus(dim) > STIFF * twice_shear(one.moduli(dim)) for one in case.laws)


def unbalanced_areas(case: Case, problem: Problem) -> Float:
    """Return the forces of a uniform unit pressure on free unknowns of the owned particles (n_owned, dim) [area].

    ``d_k = sum_p W_p g_pk - sum_f N_f(x_k) a_f`` over the facets whose particle is not held along the normal: these are
    loaded, the others held by supports. If it is zero, a uniform stress is in equilibrium. If the facets are unknown,
    only particles with a held one in their family are included.

    Parameters
    ----------
    case : Case
        The case; its particles may have a surface.
    problem : Problem
        The problem of that case.

    Notes
    -----
    Collective.
    """
    body = problem.body
    cloud, dim = body.cloud, body.dim
    n, fixed = cloud.n_owned, problem.supports.fixed[: cloud.n_owned]
    areas = problem.material_term.uniform_stress_force(np.tile(np.eye(dim), (n, 1, 1)))[:n].copy()
    surface = _surface(case, problem)
    if surface is None:
        held = cloud.halo.with_ghosts(fixed)
        for axis in range(dim):
            areas[~body.families.with_any(held[:, axis].copy()), axis] = 0.0
    else:
        loaded = np.zeros((cloud.n_local, dim))
        surface.spread(surface.area * ~fixed[surface.owner], loaded)
        areas -= body.gather(loaded)[:n]
    areas[fixed | (np.abs(areas) <= NONE * (cloud.volume[:n] / cloud.local_horizon[:n])[:, None])] = 0.0
    return areas


def unbalanced(problem: Problem, solver: Solver, areas: Float, u: Float, t: float) -> Unbalanced:
    """Compute the effect of the forces ``P d`` of ``unbalanced_areas`` on an equilibrium ``u`` at ``t``.

    A solve with the tangent yields the change of the displacements without these forces. For a uniformly compressed
    body it is exactly the lost share of the stress.

    Notes
    -----
    Collective.
    """
    body, comm = problem.body, problem.body.cloud.comm
    n = body.cloud.n_owned
    pushed, held = (count_nonzero(comm, one[:n].any(axis=1)) for one in (areas, problem.supports.fixed))
    if pushed == 0:
        return Unbalanced(0, held, 0.0, 0.0)
    state = problem.state(u, t)
    P = problem.material_term.first_piola_stress(state).copy()
    force = np.zeros_like(u)
    force[:n] = np.einsum("kij,kj->ki", P, areas)
    # The tangent of a material that has just flowed is elastic.
    found = None if problem.material_term.has_history else solver.response(u, t, force)
    if found is None:
        return Unbalanced(pushed, held, None, None)
    far = largest(comm, np.abs(found[:n]), initial=0.0)
    if far == 0.0:
        return Unbalanced(pushed, held, 0.0, 0.0)
    spacing = float(total(comm, body.cloud.volume[:n].sum()) / body.cloud.n_global) ** (1.0 / body.dim)
    part = min(1.0, STEP * spacing / far)
    moved = problem.state(u + part * found, t)
    if not problem.admissible(moved):
        return Unbalanced(pushed, held, None, None)
    change = (problem.material_term.first_piola_stress(moved) - P) / part
    V = body.cloud.volume[:n]
    volume, mean = total(comm, V.sum()), total(comm, V @ u[:n])
    parts = [(V[:, None, None] * change**2).sum(), (V[:, None, None] * P**2).sum(), (V[:, None] * found[:n] ** 2).sum()]
    sums = total(comm, np.array([*parts, (V[:, None] * (u[:n] - mean / volume) ** 2).sum()]))
    stress, displacement = (
        float(np.sqrt(a / b)) if b > 0.0 else float("inf") for a, b in ((sums[0], sums[1]), (sums[2], sums[3]))
    )
    return Unbalanced(pushed, held, stress, displacement)


def words(found: Unbalanced) -> str:
    """Return the warning."""
    effect = f"unbalanced surface forces of unknown effect act on {found.particles} free particles"
    if found.stress is not None and found.displacement is not None:
        effect = (
            f"unbalanced surface forces on {found.particles} free particles change stresses by "
            f"{100.0 * found.stress:.0f} % and displacements by {100.0 * found.displacement:.0f} %"
        )
    return (
        f"Do not rely on these stresses: {effect}. Use LatticeNodes or MeshNodes with conforming weights, or hold "
        f"layers two horizons deep."
    )


def _surface(case: Case, problem: Problem) -> Surface | None:
    """Return the surface of the body; None if it is unknown or families are shared (collective)."""
    body = problem.body
    if body.surface is not None or body.families.lattice is not None or case.cracks:
        return body.surface
    try:
        with agreed(body.cloud.comm):
            facets = case.particles.surface(body.cloud.comm.rank, body.cloud.comm.size, case.cracks)
        return surface_of(body.cloud, body.families, facets)
    except CaseError:
        return None
