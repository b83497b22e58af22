"""Energy balance of a motion, step by step."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.discrete.communicator import total
from pdpetsc.problem.inertia import Inertia
from pdpetsc.problem.problem import Problem
from pdpetsc.problem.state import State

# Error of the balance over the largest energy so far from which a run ends.
MOST = 0.05
# Names in a checkpoint: energy at the start, lost by damping, the largest so far, the work, the energy that failing
# bonds have released, the largest energy that the body was given, and the energy that contact has given less the energy
# that it stores [energy].
START, DAMPED, LARGEST, WORK, LOST, GIVEN, CREATED = (
    "energy_at_start", "energy_damped", "largest_energy", "work_of_motion", "energy_of_failed_bonds", "energy_given",
    "energy_of_contact",
)  # fmt: skip
# Names in a checkpoint of rigid bodies: kinetic energy at the start, the largest energy so far, and the work [energy].
RIGID_START, RIGID_LARGEST, RIGID_WORK = "rigid_energy_at_start", "largest_rigid_energy", "work_on_rigid_bodies"
# Smallest energy of the body that is judged, over that of rigid bodies: below it is round-off. Smallest energy of rigid
# bodies over that of the body.
ROUND_OFF, LIGHT = 1e-6, 1e-3


def knows_energies(problem: Problem, tells: bool) -> bool:
    """Return True if all energies of a motion are known; ``tells`` is that of ``MotionBalance`` (collective).

    They are not if bonds fail unreported or soften in a body with deformation gradients, in a body with strains without
    stress, and for materials that depend on the rate.
    """
    if problem.bond_damage is not None:
        # Softening bonds of gradients have forces without potential.
        dissipated = tells and not (problem.softens and problem.material_term.n_points)
    else:
        dissipated = problem.damage is None or problem.material_term.dissipated_energy() is not None
    return bool(dissipated) and problem.body.expansion is None and not problem.material_term.timed


class MotionBalance:
    """Compare kinetic, stored and dissipated energy of a motion with the work on the body.

    The work is that of the trapezoidal rule over the time steps, of loads, supports, tools with friction or in motion,
    and of terms of the case that define no energy. Held components have the energy that their supports give them, which
    is left out.

    Parameters
    ----------
    problem : Problem
        A problem with inertia.
    inertia : Inertia
        Its inertia.
    resume : mapping of str to float
        Numbers of a checkpoint; empty at the start of a run.
    tells : bool
        Whether the solver reports the energy that failing bonds release (``fail``).

    Attributes
    ----------
    known : bool
        Whether all energies are known (``knows_energies``).
    step_work : float
        Work of loads, supports and moving tools since the last record [energy]; that of a tool is on its own way, and
        that of a rigid body in motion the work of its load.
    amplified : float
        Energy of the body at the last record over the largest that it was given [-].

    Notes
    -----
    Every method is collective.
    """

    def __init__(self, problem: Problem, inertia: Inertia, resume: Mapping[str, float], tells: bool) -> None:
        self._problem, self._inertia = problem, inertia
        # Energy released by failing bonds; None if the laws of damage tell it.
        self._lost = resume.get(LOST, 0.0) if tells and problem.bond_damage is not None else None
        others = [term for term in problem.terms if not (term.load or term.of_solver)]
        self._outside = problem.outside
        # Tools share a name of their energy.
        names = {term.energy_of for term in self._outside if term.works}
        self._outside += [term for term in others if term.energy_of in names and term not in self._outside]
        self._left_out = {*names, inertia.energy_of}
        # Friction takes energy, and gives none: that of contact is known if no other term works from outside.
        self._judges_contact = bool(names) and all(term.energy_of in names for term in self._outside)
        self._created = resume.get(CREATED, 0.0)
        self.known = knows_energies(problem, tells)
        self._rigid_at_start, self._rigid_work = resume.get(RIGID_START, 0.0), resume.get(RIGID_WORK, 0.0)
        self._rigid_largest = resume.get(RIGID_LARGEST, 0.0)
        self._begun = START in resume
        self._at_start, self._damped = resume.get(START, 0.0), resume.get(DAMPED, 0.0)
        self._largest, self._work = resume.get(LARGEST, 0.0), resume.get(WORK, 0.0)
        self.step_work, self.amplified, self._given = 0.0, 0.0, resume.get(GIVEN, 0.0)
        self._u = self._force = self._resisted = self._given_by = self._on_particles = np.zeros(0)
        self._tools: list[Float] = []
        self._state: State | None = None

    @property
    def resume(self) -> dict[str, float]:
        """Return the numbers for a checkpoint (not collective)."""
        numbers = {START: self._at_start, DAMPED: self._damped, LARGEST: self._largest, WORK: self._work}
        numbers |= {GIVEN: self._given, CREATED: self._created}
        if self._inertia.bodies:
            of_rigid = self._rigid_at_start, self._rigid_largest, self._rigid_work
            numbers |= dict(zip((RIGID_START, RIGID_LARGEST, RIGID_WORK), of_rigid, strict=True))
        return numbers if self._lost is None else {**numbers, LOST: self._lost}

    def begin(
        self, state: State, internal: Float, external: Float, dt: float = 0.0, viscous: Float | None = None
    ) -> None:
        """Start from a state with its forces (n_rows, dim) [force]; others as for ``record`` and ``move``."""
        self._u, (self._given_by, self._force) = state.u, self._acting(state, internal, external)
        self._tools = self._problem.tool_forces(state)
        self._state = state if self._tools else None
        self._resisted = self._damping(viscous)
        self._on_particles = (external - internal)[: len(self._resisted)]
        if not self._begun:
            stored, moving, touching = self._held(state, dt)
            self._rigid_at_start = self._rigid_largest = self._rigid_kinetic(dt)
            # Failing points have dissipated energy in a preload.
            self._at_start, self._largest = stored + moving + self._dissipated(), max(abs(stored), moving)
            self._created = -touching
        self._begun = True

    def move(self, state: State, internal: Float, external: Float, viscous: Float | None = None) -> None:
        """Add the work of the step to a state, with the forces of viscous damping (n_owned, dim), if any."""
        given_by, force = self._acting(state, internal, external)
        resisted = self._damping(viscous)
        moved = state.u - self._u
        work = 0.5 * float(((force + self._force) * moved).sum())
        tools = self._problem.tool_forces(state)
        outer = 0.5 * float(((given_by + self._given_by) * moved).sum())
        if self._state is not None:
            outer += self._problem.tool_work(self._state, state, self._tools, tools)
        damped = 0.5 * ((resisted + self._resisted) * moved[: len(resisted)])
        free = ~self._problem.supports.fixed[: len(resisted)]
        lost, of_regions = float(damped[free].sum()), float(damped[~free].sum())
        on_particles = (external - internal)[: len(resisted)]
        mean = 0.5 * (on_particles + self._on_particles - resisted - self._resisted)
        on_rigid = sum(rigid.work(mean, moved[: len(mean)]) for rigid in self._inertia.bodies)
        sums = [work, lost, outer, of_regions, on_rigid]
        work, lost, outer, of_regions, on_rigid = total(self._problem.body.cloud.comm, sums).tolist()
        self._rigid_work += on_rigid
        self.step_work += on_rigid + of_regions
        self._work += work
        self.step_work += outer
        self._created += work - outer
        self._given_by, self._tools, self._on_particles = given_by, tools, on_particles
        self._state = state if tools else None
        self._damped += lost
        self._u, self._force, self._resisted = state.u, force, resisted

    def stored(self, state: State) -> float:
        """Return the stored energy of the body [energy]."""
        return self._held(state)[0]

    def fail(self, released: float, state: State, internal: Float, external: Float, pushed: float) -> None:
        """Add energy that failing bonds have released at a displacement [energy], and continue with forces after it.

        ``pushed`` is the change of the kinetic energy of rigid bodies by it [energy].
        """
        assert self._lost is not None
        self._lost += released
        self._rigid_work += pushed
        self._given_by, self._force = self._acting(state, internal, external)
        self._on_particles = (external - internal)[: len(self._on_particles)]

    def record(self, state: State, dt: float = 0.0) -> float:
        """Return the error of the balance over the largest energy so far [-], positive if energy was gained.

        It is that of the body or of its rigid bodies, whichever is larger. ``dt`` is the time step of central
        differences.
        """
        self.step_work = 0.0
        stored, moving, touching = self._held(state, dt)
        lost = self._dissipated()
        self._largest = max(self._largest, abs(stored), moving, abs(self._work))
        self._given = max(self._given, abs(self._at_start + self._work))
        rigid = self._rigid_kinetic(dt)
        largest = self._rigid_largest = max(self._rigid_largest, abs(rigid), abs(self._rigid_work))
        least = ROUND_OFF * largest
        self.amplified = (abs(stored) + abs(moving)) / self._given if self._given > least else 0.0
        off = stored + moving + lost + self._damped - self._at_start - self._work
        gained, size = rigid - self._rigid_at_start - self._rigid_work, max(self._largest, least)
        if self._judges_contact:  # regions that tools touch may have all the energy
            regions = any(one.rows is not None for one in self._inertia.bodies)
            of_contact = max(self._created + touching, 0.0)
            off += of_contact * (size / max(size, largest) if regions and largest > 0.0 else 1.0)
        heavy = max(largest, LIGHT * self._largest)
        of_rigid, of_body = gained / heavy if heavy > 0.0 else 0.0, off / size if size > 0.0 else 0.0
        return max(of_rigid, of_body if self.known else 0.0, key=abs)

    def _damping(self, viscous: Float | None) -> Float:
        """Return the forces of all damping (n_owned, dim) [force]."""
        damped = self._inertia.damped(self._inertia.v)
        return damped if viscous is None else damped + viscous

    def _rigid_kinetic(self, dt: float) -> float:
        """Return the kinetic energy of rigid bodies [energy] (not collective)."""
        return sum(rigid.kinetic(dt) for rigid in self._inertia.bodies)

    def _dissipated(self) -> float:
        """Return the energy that failing bonds have released in the motion, or points have dissipated [energy]."""
        return self._lost if self._lost is not None else self._problem.material_term.dissipated_energy() or 0.0

    def _acting(self, state: State, internal: Float, external: Float) -> tuple[Float, Float]:
        """Compute the forces of supports and loads, and all that work on the body, each (n_rows, dim) [force]."""
        given_by = np.where(self._problem.supports.fixed, internal, external)
        return given_by, given_by - self._problem.force_of(self._outside, state) if self._outside else given_by

    def _held(self, state: State, dt: float = 0.0) -> tuple[float, float, float]:
        """Return stored and kinetic energy of the body, and that of contact that works from outside [energy]."""
        energies = self._problem.energies(state)
        stored = sum(value for name, value in energies.items() if name not in self._left_out)
        touching = sum(energies[name] for name in self._left_out if name != self._inertia.energy_of)
        kinetic = float(total(self._problem.body.cloud.comm, self._inertia.energy_of_free(dt)))
        return stored, kinetic, touching
