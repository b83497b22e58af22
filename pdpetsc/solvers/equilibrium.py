"""Residual of a load step, its matrix, and its convergence criterion: common parts of the solvers on SNES."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from petsc4py import PETSc

from pdpetsc.arrays import Float
from pdpetsc.discrete.communicator import anywhere, bounds, norm, smallest, total
from pdpetsc.errors import CaseError, petsc_reason
from pdpetsc.petsc.curvature import has_negative_eigenvalue
from pdpetsc.petsc.jacobian import make_tangent
from pdpetsc.petsc.library import negative_pivots, negative_pivots_of_symmetric_part, refactors, start_anew
from pdpetsc.petsc.stages import RESIDUAL, TANGENT, stage
from pdpetsc.problem.assembly import Filler
from pdpetsc.problem.problem import Problem
from pdpetsc.problem.scales import nearest_distances, scales_of
from pdpetsc.problem.state import State
from pdpetsc.solvers.protocol import AT_FLOOR, StepResult

# The residual cannot decrease below about this multiple of the round-off of K u.
FLOOR = 20.0
# A residual at the floor has stagnated if an iteration did not reduce it by this factor.
STAGNATION = 0.5
# Largest number of additional solves, each with moved springs of loose particles, until the springs have no force.
RESTS = 5
# Largest number of additional solves, each with new multipliers of contacts.
SETTLINGS = 20
# Tolerance on a norm that is computed again with another order of summation.
SLACK = 1.0 + 1e-6
# Reason for no equilibrium of a loaded loose piece.
HELD_BY_NOTHING = "nothing holds a piece that has come free against its load"
# Reason for no equilibrium with contact.
UNSETTLED = "the contact does not settle; raise its stiffness, or take smaller steps"
# Reason for no equilibrium with loaded rigid bodies.
UNBALANCED = "rigid bodies and their loads do not balance; take smaller steps"
# A failed solve under loads has run away if it moved this multiple of its first linear response.
RUNAWAY = 100.0
# Interpretation of a run-away solve.
BEYOND_LIMIT = "the displacement grew without bound, so that the load is likely above the limit load of the body"
# Reason for rejecting a state in which forces balance.
TOO_FAR = "the load would move the body by more than its own size in one step"
# Largest number of halvings of a Newton step to keep det F > 0.
HALVINGS = 40
# A step is easy if none of its solves takes more iterations.
EASY_ITERATIONS = 6


class Equilibrium:
    """Compute ``r(u) = f_int(u) - f_ext`` if free, ``stiffness (u - prescribed)`` if prescribed, and its tangent.

    Parameters
    ----------
    problem : Problem
        Terms and supports.
    assembler : Filler
        Object that fills the matrix.

    Attributes
    ----------
    free : (n_rows, dim) bool
        Degrees of freedom that are neither prescribed nor tied.
    supported : (n_rows, dim) bool
        Degrees of freedom that are prescribed.
    size, smallest_spacing : float
        Diagonal of the box around the body, and smallest distance of two particles [length].
    t : float
        Load parameter of the current solve, set by ``impose`` [-].
    prescribed, external : (n_rows, dim) float64
        Prescribed unknowns at that load parameter [length], and loads at the last evaluation of the residual [force].
    scales : Scales
        Units of displacements, forces and tangent in PETSc.
    tangent : PetscTangent
        Tangent at the displacement of its last update.
    norms : list of float
        Residual norms of the current solve [force].
    unbalanced : (n_rows, dim) float64 or None
        Internal minus external forces at the start of the current solve [force]; None if they are undefined there.
    resisted : (n_rows, dim) float64
        Forces of the tangent at the start against the change of the prescribed unknowns, with all others held [force].
    reference : float
        Largest norm of external forces, reactions and forces of rigid tools at the last check, at most the sum of the
        forces in the step [force].
    tolerance : float
        Tolerance of the residual norm at the last check [force].
    filled_at : (n_rows, dim) float64 or None
        Displacement of the last update of the tangent [length].
    accepted, objection : str
        Reason of the last check for accepting the residual, and of another one for refusing the equilibrium; empty for
        none.

    Notes
    -----
    Construction and every method are collective. Call ``destroy`` before MPI ends.
    """

    def __init__(self, problem: Problem, assembler: Filler) -> None:
        cloud, fixed = problem.body.cloud, problem.supports.fixed
        self.problem = problem
        self.free = ~fixed
        ties = problem.supports.ties
        self.supported = fixed if ties is None else fixed & ~ties.tied
        spacing = nearest_distances(problem.body)[:, None]
        whole = np.full((cloud.n_virtual, 1), 0.0 if cloud.images is None else cloud.images.sizes.max())
        self.spacing: Float = np.concatenate([spacing, whole])
        self._comm = cloud.comm
        low, high = bounds(cloud.comm, cloud.x[: cloud.n_owned])
        self.smallest_spacing = least = smallest(cloud.comm, spacing)
        self.size = float(np.linalg.norm(high - low)) + least
        # Size of the body over the smallest distance of particles [-].
        self._slender = self.size / least
        self.scales = scales_of(problem.body, problem.material_term)
        self.tangent = make_tangent(assembler, fixed, self.scales.stiffness)
        self.t = 0.0
        # Each is replaced, not changed.
        self.prescribed = self.external = self.resisted = np.zeros(fixed.shape)
        self._reaction = self._start = self._loads_at_start = self._by_tools = self._by_tools_at_start = self.prescribed
        self.norms: list[float] = []
        self.unbalanced: Float | None = None
        self.reference = self.tolerance = 0.0
        self.accepted = self.objection = ""
        self._loads: Float | None = None
        # Whether they follow the deformation from these at the start of the solve.
        self._follow = False
        # Root mean square of the displacement of iterates in the current solve: the first and the largest value.
        self._moved = 0.0, 0.0
        # Most iterations of SNES, which starts again with other contacts and moved rigid bodies.
        self._longest = 0
        self._lost = self._loaded = False
        # Largest displacement of a loaded rigid body [length], and the loads on all that are unknowns of the solve
        # [force].
        self._way = self._on_bodies = 0.0
        # Whether damage was held, and the number of rebuilds, at the last update of the tangent.
        self._factored_with = True, 0
        self.filled_at: Float | None = None

    def destroy(self) -> None:
        """Free the PETSc objects."""
        self.tangent.destroy()

    def impose(
        self, t: float, prescribed: Float | None = None, loads: Float | None = None, follow: bool = False
    ) -> None:
        """Set the conditions of a load parameter, or known prescribed unknowns and loads.

        If loads ``follow`` the deformation, ``loads`` are those at the start of the solve. The residual then computes
        them at its displacement and the load parameter.
        """
        self.t = t
        self.prescribed = self.problem.supports.prescribed(t) if prescribed is None else prescribed
        self._loads, self._follow = loads, follow

    def at_prescribed(self, x: Float) -> Float:
        """Compute unknowns that satisfy the constraints (n_rows, dim) from the independent ones."""
        return self.problem.supports.completed(x.reshape(self.free.shape), self.prescribed)

    def state(self, x: Float) -> State:
        """Return the state at unknowns with the prescribed values inserted."""
        return self.problem.state(self.at_prescribed(x), self.t)

    def residual(self, x: Float) -> Float | None:
        """Compute the residual (n_rows, dim) [force]; None on all ranks if the displacement is inadmissible."""
        values = x.reshape(self.free.shape)
        with stage(RESIDUAL):
            state = self.state(values)
            force = self.problem.internal_force(state)
            if force is None:
                return None
            known = None if self._follow else self._loads
            self.external = self.problem.external_force(state) if known is None else known
        residual = force - self.external
        self._reaction, self._by_tools = np.where(self.free, 0.0, residual), self.problem.force_of_tools(state)
        # Tied components follow the independent ones, so their residual is zero.
        off = np.where(self.supported, self.scales.stiffness * (values - self.prescribed), 0.0)
        return np.where(self.free, self.problem.supports.reduced(residual), off)

    def held_in_place(self, step: Float, x: Float, solve: Callable[[Float], Float], rtol: float) -> Float:
        """Remove from a Newton step the motion that only the springs of loose particles resist.

        With the stiffness S of the springs the tangent is K + S. ``z = (K + S)^-1 S step`` is the part of the step in
        the null space of K: rigid motions of free pieces, and mechanisms of the remaining bonds. Forces ``S z`` cause
        it. If they are within the tolerance they are round-off, which S is far too soft to resist, and z is removed.
        Otherwise a load acts on a loose piece, and the step is unchanged.

        Parameters
        ----------
        step : (n,) float64
            Displacements [length], followed by the other unknowns of ``solve``.
        x : (n_rows, dim) float64
            Unknowns to which the step is added [length].
        solve : callable
            Solves the tangent for forces (n_rows, dim) [force], and returns the step.
        """
        springs = self.problem.springs
        if springs is None or not springs.active:
            return step
        shape, size, supports = self.free.shape, self.free.size, self.problem.supports

        def resistance(of: Float) -> Float:
            return supports.reduced(springs.resistance(supports.completed(of[:size].reshape(shape))))

        loose = solve(resistance(step))
        force = norm(self._comm, resistance(loose))
        return step - loose[: len(step)] if force <= max(self._tolerance(x, rtol)) else step

    def update(self, state: State, effort: tuple[int, float] | None = None) -> None:
        """Update the tangent to a state; ``effort`` is that of the last linear solve (``PetscTangent.update``)."""
        damage = self.problem.damage
        held = damage is not None and damage.softens and damage.frozen
        self._factored_with = held, self.problem.rebuilds
        self.filled_at = state.u
        with stage(TANGENT):
            self.tangent.update(state, effort)

    def factor(self, state: State, ksp: PETSc.KSP) -> None:
        """Update the tangent to a state, and set up its linear solver."""
        self.update(state)
        ksp.setOperators(self.tangent.mat, self.tangent.preconditioner)
        nothing, found = self.tangent.mat.createVecs()
        ksp.solve(nothing, found)
        if ksp.getConvergedReason() < 0:
            start_anew(ksp)
        nothing.destroy()
        found.destroy()

    def forget(self) -> None:
        """Force the next ``update`` to rebuild the tangent, and discard the pivots of the factor (not collective)."""
        self._factored_with = True, 0
        self.tangent.forget()

    def admissible_part(self, moved: Callable[[float], Float]) -> float:
        """Return the fraction of a Newton step that keeps det F > 0: 1, halved as often as needed.

        Parameters
        ----------
        moved : callable
            Returns the displacement (n_rows, dim) after a fraction of the step.
        """
        part = 1.0
        if self.problem.linear:
            return part
        for _ in range(HALVINGS):
            if self.problem.admissible(self.problem.state(moved(part), self.t)):
                break
            part *= 0.5
        return part

    def verdict(self, x: Float, iteration: int, residual: float, rtol: float) -> int | None:
        """Return PETSc's reason if a residual norm [force] is within the tolerance or not finite, else None."""
        reason = PETSc.SNES.ConvergedReason
        self.norms.append(residual)
        self._longest = max(self._longest, iteration)
        if not np.isfinite(residual):
            return int(reason.DIVERGED_FNORM_NAN)
        self.tolerance, floor = self._tolerance(x, rtol)
        if self._lost:
            return None
        if residual <= self.tolerance:
            self.accepted = "residual below tolerance"
            return int(reason.CONVERGED_FNORM_RELATIVE)
        if iteration > 0 and residual <= floor and residual > STAGNATION * self.norms[-2]:
            self.accepted = AT_FLOOR
            return int(reason.CONVERGED_FNORM_ABS)
        return None

    def judge(self, x: Float, rtol: float) -> bool:
        """Return True if ``x`` is in equilibrium, for any reason for which a solve has ended.

        The residual is computed here. PETSc may have ended on an absolute tolerance, and its norm may be that of
        another vector, such as a preconditioned residual.
        """
        residual = self.residual(x)
        if residual is None:
            return False
        size = norm(self._comm, residual)
        if not self.norms:  # a solver of PETSc that calls no convergence test
            self.norms.append(size)
        return np.isfinite(size) and size <= SLACK * max(self._tolerance(x, rtol)) and not self._lost

    def _tolerance(self, x: Float, rtol: float) -> tuple[float, float]:
        """Return the tolerance of the residual norm, and the norm of its round-off [force].

        The residual is compared with the loads, reactions, forces of rigid tools and forces of inertia at ``x``. In a
        diverging iterate they can have any size. In a nonlinear body the reference is therefore at most the sum of the
        forces in the step. These are loads, unbalanced forces, reactions and forces of tools at its start, and the
        resistance against the change of the prescribed unknowns. The sum is taken over particles, since a few supports
        may carry a distributed load.
        Round-off grows with the displacement, which ``_note_move`` bounds.
        """
        values = self.at_prescribed(x)
        change = values - self._start
        diagonal = np.where(self.free, self.tangent.diagonal.reshape(values.shape), 0.0)
        round_off = diagonal * (np.abs(values) + self.spacing + self._way)
        unstrained = self.problem.force_without_strain(self.t)
        held = np.zeros(1) if unstrained is None else unstrained
        loads = self._loads_at_start if self._loads is None else self._loads
        begin = np.zeros(1) if self.unbalanced is None else self.unbalanced
        resisted = np.where(self.free, 0.0, self.resisted)
        jump = np.where(self.supported, change, 0.0)
        inertia = self.problem.inertia
        moving = np.zeros(1) if inertia is None else inertia.inertial(self.problem.state(values, self.t))
        squares = [self.external, self._reaction, self._by_tools, held, moving, round_off, change, jump]
        sizes = [float(np.abs(force).sum()) for force in (loads, begin, self._by_tools_at_start, resisted, held)]
        sums = total(self._comm, [float((one**2).sum()) for one in squares] + sizes)
        # A law may have no stress in the undeformed body.
        sums = np.where(np.isfinite(sums), sums, 0.0)
        *forces, of_round_off, of_change, of_jump = np.sqrt(sums[: len(squares)]).tolist()
        of_step = sums[len(squares) :]
        self._loaded = bool(of_step[0] + self._on_bodies > 0.0)
        bounded = self.unbalanced is not None and not self.problem.linear
        self.reference = min(max(forces), float(of_step.sum()) + self._on_bodies if bounded else np.inf)
        self._note_move(of_change / np.sqrt(self.problem.body.cloud.n_global), of_jump)
        return rtol * self.reference, FLOOR * float(np.finfo(float).eps) * of_round_off

    def _note_move(self, moved: float, jump: float) -> None:
        """Store the distance of an iterate from the start of its solve, and whether it is too large for an equilibrium.

        A nonlinear body has run away if loads move it by more than its own size in one step. Prescribed displacements
        may rotate it with a lever arm of its size over the distance of two supports. If springs hold loose particles,
        ``at_rest`` decides.
        """
        first, most = self._moved
        self._moved = first or moved, max(most, moved)
        self._lost = moved > self.size + self._slender * jump and self.resting and not self.problem.linear

    def negative_pivots(self, snes: PETSc.SNES, ksp: PETSc.KSP) -> int | None:
        """Return the negative pivots of the last tangent that was solved with; None if they are unknown.

        With damage held, the factor is that of the secant, which does not determine stability. A tangent from before
        bonds broke does not either.
        """
        known = self.problem.symmetric and self._factored_with == (False, self.problem.rebuilds)
        if not known or not refactors(snes):
            return None
        return negative_pivots(ksp, self.tangent.mat)

    def negative_curvature(self, state: State, ksp: PETSc.KSP, anew: bool) -> int | None:
        """Return 1 if the symmetric tangent has negative eigenvalues, 0 if it has none; None if that is unknown.

        The tangent is updated to the state if ``anew``. That of held damage does not determine stability.
        """
        if anew or not self.tangent.holds():
            self.update(state)
        if self._factored_with != (False, self.problem.rebuilds):
            return None
        ksp.setOperators(self.tangent.mat, self.tangent.preconditioner)
        free = self.tangent.mat.createVecRight()
        free.array = self.free.ravel()
        found = has_negative_eigenvalue(ksp, free)
        free.destroy()
        return None if found is None else int(found)

    def pivots_of_unsymmetric(self, state: State, ksp: PETSc.KSP) -> int | None:
        """Return 0 if the symmetric part of the tangent at a state has no negative pivots; None if that is unknown.

        The tangent then does positive work in every displacement, so that no other equilibrium is near; vibrations may
        grow. Negative pivots of that part tell nothing: sliding with friction has them in stable equilibria.
        """
        if ksp.getPC().getType() != "lu" or self.problem.softens or self.problem.constrained:
            return None
        self.update(state)
        return 0 if negative_pivots_of_symmetric_part(self.tangent.mat) == 0 else None

    def interrupted(self) -> int:
        """Return PETSc's reason for a solve that a signal stops (not collective)."""
        reason = PETSc.SNES.ConvergedReason
        self.objection = "a signal asked the run to stop"
        return int(reason.DIVERGED_USER) if hasattr(reason, "DIVERGED_USER") else int(reason.DIVERGED_INNER)

    def begin(self, u: Float) -> bool:
        """Start to record a solve from ``u``, compute its initial forces, and hold loose particles there.

        Return True if the preconditioner has a new ``Mat``, as it may after bonds have broken.
        """
        self.accepted = self.objection = ""
        self.norms, self._start, self._moved, self._longest = [], u, (0.0, 0.0), 0
        if self.problem.springs is not None:
            self.problem.springs.hold(u)
        self.problem.start_from(self.problem.state(u, self.t))
        renewed = self.tangent.renew()
        state = self.problem.state(u, self.t)
        force = self.problem.internal_force(state)
        self._loads_at_start = self.problem.external_force(state) if self._loads is None else self._loads
        self.unbalanced = None if force is None else force - self._loads_at_start
        # Until the residual is computed, use the forces at the start of this solve, not those of the solve before.
        self.external = self._loads_at_start
        self._reaction = np.where(self.free, 0.0, 0.0 if self.unbalanced is None else self.unbalanced)
        self._by_tools = np.zeros(1) if force is None else self.problem.force_of_tools(state)
        self._by_tools_at_start = self._by_tools
        return renewed

    def start_over(self) -> None:
        """Forget a failed attempt from another start of the same solve."""
        self.accepted, self._longest = "", 0
        self.norms.clear()
        self.forget()

    def rebalance(self, u: Float, way: float) -> None:
        """Compute the unbalanced forces at unknowns ``u``, after rigid bodies have moved within the solve.

        ``way`` is the largest displacement of one since the start of the run [length]: distances from it round.
        """
        self._way = way
        state = self.problem.state(u, self.t)
        force = self.problem.internal_force(state)
        if force is not None:
            self.unbalanced = force - self._loads_at_start

    def carry(self, loads: float, way: float) -> None:
        """Set the loads on rigid bodies that are unknowns of the solve [force], and their ``way`` (not collective)."""
        self._on_bodies, self._way = loads, way

    def resist(self, change: Float) -> None:
        """Compute the forces against a change of the prescribed unknowns (n_rows, dim) [length] at the start."""
        self.resisted = np.zeros_like(change)
        if self.unbalanced is not None and anywhere(self._comm, change):
            self.resisted += self.problem.linearised(self.problem.state(self._start, self.t))(change)

    def result(self, converged: bool, reason: int, linear_reason: int, linear_iterations: int) -> StepResult:
        """Return the outcome of the solve, from the reasons of SNES and KSP (not collective).

        ``converged`` states whether the residual is within the tolerance (``judge``).
        """
        iterations = max(len(self.norms) - 1, 0)
        words = self.objection or self.accepted or _words(reason, linear_reason)
        if reason > 0 and not (converged or self.objection):
            words = f"PETSc ended with {_words(reason, linear_reason)}, but the residual is above the tolerance"
        first, most = self._moved
        if not (converged or self.objection or self.accepted):
            if self._loaded and most > RUNAWAY * first:
                words = f"{words}, and {BEYOND_LIMIT}"
            elif self._lost:
                words = TOO_FAR
        return StepResult(
            converged=converged,
            reason=words,
            norms=list(self.norms),
            reference=self.reference,
            iterations=iterations,
            easy=self._longest <= EASY_ITERATIONS,
            linear_iterations=linear_iterations,
        )

    @property
    def resting(self) -> bool:
        """Return True if no springs hold loose particles (not collective)."""
        return self.problem.springs is None or not self.problem.springs.active

    def move_springs(self, u: Float) -> None:
        """Move the springs of loose particles so that they have no force at ``u`` (not collective)."""
        if self.problem.springs is not None:
            self.problem.springs.move(u)

    def at_rest(self, x: Float, rtol: float) -> bool:
        """Return True if forces balance at ``x`` without the springs of loose particles; else set ``objection``.

        A load on a loose piece is balanced by nothing else, however far the piece moves.
        """
        springs = self.problem.springs
        if springs is None or not springs.active:
            return True
        held = self.problem.supports.reduced(springs.force(self.at_prescribed(x)))
        force = norm(self._comm, held)
        resting = force <= max(self._tolerance(x, rtol))
        if not resting:
            self.objection = HELD_BY_NOTHING
        return resting


def read_options(
    destroy: Callable[[], None], *solvers: PETSc.SNES | PETSc.KSP, equip: Callable[[], None] = lambda: None
) -> None:
    """Set the options of solvers, then call ``equip`` (collective).

    If an option is refused, call ``destroy`` and raise CaseError.
    """
    try:
        for solver in solvers:
            solver.setFromOptions()
        equip()
    except CaseError:
        destroy()
        raise
    except PETSc.Error as error:
        destroy()
        raise CaseError(
            f"PETSc refused the solver options; check their names and values: {petsc_reason(error)}."
        ) from error


def _words(reason: int, linear: int) -> str:
    """Return PETSc's reason for the end of a solve in words; that of the linear solver if it failed."""
    names = {value: name for name, value in vars(PETSc.SNES.ConvergedReason).items() if isinstance(value, int)}
    name: str = names.get(reason, str(reason))
    if name == "DIVERGED_LINEAR_SOLVE":
        kinds = {value: kind for kind, value in vars(PETSc.KSP.ConvergedReason).items() if isinstance(value, int)}
        return f"the linear solver failed ({kinds.get(linear, linear)})"
    return {
        "DIVERGED_MAX_IT": "too many Newton iterations",
        "DIVERGED_FUNCTION_DOMAIN": "det F <= 0, or a strain for which a material has no stress, could not be avoided",
        "DIVERGED_FNORM_NAN": "det F <= 0 or a number overflowed",
        "DIVERGED_LINE_SEARCH": "the line search failed",
    }.get(name, name)
