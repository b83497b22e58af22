"""The residual of a load step, its matrix, and when it counts as zero: what the solvers on SNES share."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from petsc4py import PETSc

from pdpetsc.arrays import Float
from pdpetsc.discrete.communicator import total
from pdpetsc.errors import CaseError, petsc_reason
from pdpetsc.petsc.jacobian import make_tangent
from pdpetsc.petsc.stages import RESIDUAL, TANGENT, stage
from pdpetsc.problem.assembly import Filler
from pdpetsc.problem.problem import Problem
from pdpetsc.problem.scales import nearest_distances, scales_of
from pdpetsc.problem.state import State
from pdpetsc.solvers.protocol import StepResult

# The residual cannot fall below about this multiple of the round-off of K u.
FLOOR = 20.0
# Beyond so many spacings of displacement a residual at that floor counts only where it is below so small a share of the
# forces: a body that runs away has round-off as large as these, and is in no equilibrium.
AWAY, SHARE = 1e6, 1e-6
# A residual at the floor that an iteration did not lower by this factor has stagnated.
STAGNATION = 0.5
# Largest number of further solves, each with the springs of loose pieces moved along, until they have no force.
RESTS = 5
# A norm that is computed once more, in another order of the sums, may differ by this factor.
SLACK = 1.0 + 1e-6
# Why a piece on which a load acts is not in equilibrium.
HELD_BY_NOTHING = "nothing holds a piece that has come free against its load"
# Largest number of halvings of a Newton step to keep det F > 0.
HALVINGS = 40
# A step with no more iterations may be followed by a longer one.
EASY_ITERATIONS = 6


class Equilibrium:
    """``r(u) = f_int(u) - f_ext`` where free, ``stiffness (u - prescribed)`` where prescribed, and its tangent.

    Parameters
    ----------
    problem : Problem
        Terms and supports.
    assembler : Filler
        What fills the matrix.

    Attributes
    ----------
    free : (n_rows, dim) bool
        Degrees of freedom that are not prescribed.
    t : float
        Step time of the present solve, set by ``impose`` [-].
    prescribed, external : (n_rows, dim) float64
        The prescribed unknowns [length] there, and the loads where the residual was last computed [force].
    scales : Scales
        Units by which displacements, forces and the tangent are divided for PETSc.
    tangent : PetscTangent
        The tangent at the displacement for which it was last updated.
    norms : list of float
        Residual norms of the present solve [force].
    reference : float
        Larger norm of external forces and of reactions at the last check [force].
    reason : str
        Why the last check ended the solve.

    Notes
    -----
    Construction and every method are collective. Call ``destroy`` before MPI ends.
    """

    def __init__(self, problem: Problem, assembler: Filler) -> None:
        cloud, fixed = problem.body.cloud, problem.supports.fixed
        self.problem = problem
        self.free = ~fixed
        spacing = nearest_distances(problem.body)[:, None]
        whole = np.full((cloud.n_virtual, 1), 0.0 if cloud.images is None else cloud.images.sizes.max())
        self.spacing: Float = np.concatenate([spacing, whole])
        self.scales = scales_of(problem.body, problem.matter)
        self.tangent = make_tangent(assembler, fixed, self.scales.stiffness)
        self.t = 0.0
        self.prescribed = np.zeros(fixed.shape)
        self.external = np.zeros(fixed.shape)
        self.norms: list[float] = []
        self.reference = 0.0
        self.reason = ""
        self._reaction = np.zeros(fixed.shape)
        self._loads: Float | None = None

    def destroy(self) -> None:
        """Free the PETSc objects."""
        self.tangent.destroy()

    def impose(self, t: float, prescribed: Float | None = None, loads: Float | None = None) -> None:
        """Take the conditions of a step time, or prescribed unknowns and loads that are known."""
        self.t = t
        self.prescribed = self.problem.supports.prescribed(t) if prescribed is None else prescribed
        self._loads = loads

    def at_prescribed(self, x: Float) -> Float:
        """Return unknowns with the prescribed ones at their values (n_rows, dim) (not collective)."""
        return np.where(self.free, x.reshape(self.free.shape), self.prescribed)

    def state(self, x: Float) -> State:
        """Return the state at unknowns with the prescribed ones at their values."""
        return self.problem.state(self.at_prescribed(x), self.t)

    def residual(self, x: Float) -> Float | None:
        """Return the residual (n_rows, dim) [force]; None on all ranks where the displacement is inadmissible."""
        values = x.reshape(self.free.shape)
        with stage(RESIDUAL):
            state = self.state(values)
            force = self.problem.internal_force(state)
            if force is None:
                return None
            self.external = self.problem.external_force(state) if self._loads is None else self._loads
        residual = force - self.external
        self._reaction = np.where(self.free, 0.0, residual)
        return np.where(self.free, residual, self.scales.stiffness * (values - self.prescribed))

    def assemble(self, x: Float, effort: float | None = None) -> None:
        """Update the tangent to that at ``x`` after a linear solve of some ``effort`` (``PetscTangent.update``)."""
        with stage(TANGENT):
            self.tangent.update(self.state(x), effort)

    def admissible_part(self, moved: Callable[[float], Float]) -> float:
        """Return the part of a Newton step that keeps det F > 0: 1, halved as often as needed.

        Parameters
        ----------
        moved : callable
            The displacement (n_rows, dim) after a part of the step.
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
        """Return PETSc's reason to end where a residual norm [force] counts as zero or is no number, else None."""
        reason = PETSc.SNES.ConvergedReason
        self.norms.append(residual)
        if not np.isfinite(residual):
            return int(reason.DIVERGED_FNORM_NAN)
        tolerance, floor = self._tolerance(x, rtol)
        if residual <= tolerance:
            self.reason = "residual below tolerance"
            return int(reason.CONVERGED_FNORM_RELATIVE)
        if iteration > 0 and residual <= floor and residual > STAGNATION * self.norms[-2]:
            self.reason = "residual at the round-off floor"
            return int(reason.CONVERGED_FNORM_ABS)
        return None

    def judge(self, x: Float, rtol: float) -> bool:
        """Return whether ``x`` is in equilibrium, whatever the reason for which a solve has ended.

        The residual is computed here: PETSc may have ended on an absolute tolerance, and the norm that it keeps may be
        that of another vector, such as a preconditioned residual.
        """
        residual = self.residual(x)
        if residual is None:
            return False
        norm = float(np.sqrt(total(self.problem.body.cloud.comm, (residual**2).sum())))
        if not self.norms:  # a solver of PETSc that calls no convergence test
            self.norms.append(norm)
        return np.isfinite(norm) and norm <= SLACK * max(self._tolerance(x, rtol))

    def _tolerance(self, x: Float, rtol: float) -> tuple[float, float]:
        """Return below which norm a residual counts as zero, and the norm of its round-off [force]."""
        values = self.at_prescribed(x)
        diagonal = self.tangent.diagonal.reshape(values.shape)
        at_rest = np.where(self.free, diagonal * self.spacing, 0.0)
        round_off = np.where(self.free, diagonal * (np.abs(values) + self.spacing), 0.0)
        unstrained = self.problem.force_without_strain(self.t)
        held = 0.0 if unstrained is None else float((unstrained**2).sum())
        squares = total(
            self.problem.body.cloud.comm,
            [(self.external**2).sum(), (self._reaction**2).sum(), (round_off**2).sum(), held, (at_rest**2).sum()],
        )
        # The undeformed body may be one in which a law has no stress.
        held = float(squares[3]) if np.isfinite(squares[3]) else 0.0
        self.reference = float(np.sqrt(max(squares[0], squares[1], held)))
        floor = FLOOR * float(np.finfo(float).eps) * float(np.sqrt(squares[2]))
        if squares[2] > AWAY**2 * squares[4]:
            floor = min(floor, SHARE * self.reference)
        return rtol * self.reference, floor

    def interrupted(self) -> int:
        """Return PETSc's reason to end for a solve that a signal stops (not collective)."""
        reason = PETSc.SNES.ConvergedReason
        self.reason = "a signal asked the run to stop"
        return int(reason.DIVERGED_USER) if hasattr(reason, "DIVERGED_USER") else int(reason.DIVERGED_INNER)

    def begin(self, u: Float) -> bool:
        """Start to record a solve from ``u``, and hold loose particles there.

        Return whether the preconditioner has a new ``Mat``, as it may after bonds have broken.
        """
        self.norms, self.reason = [], ""
        if self.problem.springs is not None:
            self.problem.springs.hold(u)
        return self.tangent.renew()

    def result(self, converged: bool, reason: int, linear_reason: int, linear_iterations: int) -> StepResult:
        """Return how the solve went, with PETSc's reasons to end of SNES and KSP (not collective).

        ``converged`` is whether the residual counts as zero (``judge``).
        """
        iterations = max(len(self.norms) - 1, 0)
        words = self.reason or _words(reason, linear_reason)
        if reason > 0 and not converged and self.reason != HELD_BY_NOTHING:
            words = f"PETSc ended with {_words(reason, linear_reason)}, but the residual is above the tolerance"
        return StepResult(
            converged=converged,
            reason=words,
            norms=list(self.norms),
            reference=self.reference,
            iterations=iterations,
            easy=iterations <= EASY_ITERATIONS,
            linear_iterations=linear_iterations,
        )

    @property
    def resting(self) -> bool:
        """Return whether no springs hold loose particles (not collective)."""
        return self.problem.springs is None or not self.problem.springs.active

    def move_springs(self, u: Float) -> None:
        """Move the springs of loose particles so that they have no force at ``u`` (not collective)."""
        if self.problem.springs is not None:
            self.problem.springs.move(u)

    def at_rest(self, x: Float, rtol: float) -> bool:
        """Return whether forces balance at ``x`` without the springs of loose particles; where not, ``reason`` says so.

        A load on a piece that has come free is held by nothing else, however far it moves.
        """
        springs = self.problem.springs
        if springs is None or not springs.active:
            return True
        held = np.where(self.free, springs.force(self.at_prescribed(x)), 0.0)
        force = float(np.sqrt(total(self.problem.body.cloud.comm, (held**2).sum())))
        resting = force <= max(self._tolerance(x, rtol))
        if not resting:
            self.reason = HELD_BY_NOTHING
        return resting


def read_options(
    destroy: Callable[[], None], *solvers: PETSc.SNES | PETSc.KSP, equip: Callable[[], None] = lambda: None
) -> None:
    """Give solvers their options, then ``equip`` them (collective).

    Where an option is refused, ``destroy`` and raise CaseError.
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
    """Return PETSc's reason for the end of a solve in words, that of the linear solver where it was to blame."""
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
