"""The residual of a load step, its matrix, and when it counts as zero: what the solvers on SNES share."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from petsc4py import PETSc

from pdpetsc.arrays import Float
from pdpetsc.discrete.communicator import total
from pdpetsc.errors import CaseError, petsc_reason
from pdpetsc.loading import Loading
from pdpetsc.model import Assembler, Model
from pdpetsc.solve.base import StepResult
from pdpetsc.solve.defaults import stiffness_scale
from pdpetsc.solve.jacobian import make_tangent
from pdpetsc.solve.stages import RESIDUAL, TANGENT, stage

# The residual cannot fall below about this multiple of the round-off of K u.
FLOOR = 20.0
# A residual at the floor that an iteration did not lower by this factor has stagnated.
STAGNATION = 0.5
HALVINGS = 40
# A step with no more iterations may be followed by a longer one.
EASY_ITERATIONS = 6
# Stiffness that holds a particle which has lost bonds, over a typical one.
DAMPING = 1e-8


class Equilibrium:
    """``r(u) = f_int(u) - f_ext`` where free, ``scale (u - prescribed)`` where prescribed, and its tangent.

    Parameters
    ----------
    model, loading, assembler
        The body and its conditions.

    Attributes
    ----------
    free : (n_rows, dim) bool
        Degrees of freedom that are not prescribed.
    prescribed, external : (n_rows, dim) float64
        The present conditions [length], [force]; set by the solver.
    scale : float
        Diagonal of prescribed rows [force / length].
    tangent : Tangent
        At the displacement it was last filled for.
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

    def __init__(self, model: Model, loading: Loading, assembler: Assembler) -> None:
        cloud = model.cloud
        self.model = model
        self.free = ~loading.fixed
        spacing = cloud.volume[: cloud.n_owned, None] ** (1.0 / model.dim)
        whole = np.full((cloud.n_virtual, 1), 0.0 if cloud.images is None else cloud.images.sizes.max())
        self.spacing: Float = np.concatenate([spacing, whole])
        self.scale = stiffness_scale(model)
        self.tangent = make_tangent(assembler, loading.fixed, self.scale)
        self.prescribed = np.zeros(loading.fixed.shape)
        self.external = np.zeros(loading.fixed.shape)
        self.norms: list[float] = []
        self.reference = 0.0
        self.reason = ""
        self.damping: Float | None = None
        self._anchor = np.zeros(loading.fixed.shape)
        self._reaction = np.zeros(loading.fixed.shape)

    def destroy(self) -> None:
        """Free the PETSc objects."""
        self.tangent.destroy()

    def at_prescribed(self, x: Float) -> Float:
        """Return unknowns with the prescribed ones at their values (n_rows, dim) (not collective)."""
        return np.where(self.free, x.reshape(self.free.shape), self.prescribed)

    def residual(self, x: Float) -> Float | None:
        """Return the residual (n_rows, dim) [force]; None on all ranks where the displacement is inadmissible."""
        values = x.reshape(self.free.shape)
        with stage(RESIDUAL):
            force = self.model.internal_force(self.at_prescribed(values))
        if force is None:
            return None
        residual = force - self.external
        if self.damping is not None:
            residual += self.damping[:, None] * (values - self._anchor)
        self._reaction = np.where(self.free, 0.0, residual)
        return np.where(self.free, residual, self.scale * (values - self.prescribed))

    def assemble(self, x: Float, effort: float | None = None) -> None:
        """Make the tangent that at ``x``; ``effort`` is what the last linear solve took (``Tangent.update``)."""
        with stage(TANGENT):
            self.tangent.update(self.at_prescribed(x), self.damping, effort)

    def admissible_part(self, moved: Callable[[float], Float]) -> float:
        """Return the part of a Newton step, halved as often as det F > 0 asks.

        Parameters
        ----------
        moved : callable
            The displacement (n_rows, dim) after a part of the step.
        """
        part = 1.0
        if self.model.linear:
            return part
        for _ in range(HALVINGS):
            if self.model.all_admissible(moved(part)):
                break
            part *= 0.5
        return part

    def verdict(self, x: Float, iteration: int, residual: float, rtol: float) -> int | None:
        """Return PETSc's reason to end where a residual norm counts as zero or is no number, else None."""
        reason = PETSc.SNES.ConvergedReason
        self.norms.append(residual)
        if not np.isfinite(residual):
            return int(reason.DIVERGED_FNORM_NAN)
        values = self.at_prescribed(x)
        diagonal = self.tangent.diagonal.reshape(values.shape)
        round_off = np.where(self.free, diagonal * (np.abs(values) + self.spacing), 0.0)
        squares = total(
            self.model.cloud.comm, [(self.external**2).sum(), (self._reaction**2).sum(), (round_off**2).sum()]
        )
        self.reference = float(np.sqrt(max(squares[0], squares[1])))
        floor = FLOOR * float(np.finfo(float).eps) * float(np.sqrt(squares[2]))
        if residual <= rtol * self.reference or residual == 0.0:
            self.reason = "residual below tolerance"
            return int(reason.CONVERGED_FNORM_RELATIVE)
        if iteration > 0 and residual <= floor and residual > STAGNATION * self.norms[-2]:
            self.reason = "residual at the round-off floor"
            return int(reason.CONVERGED_FNORM_ABS)
        return None

    def interrupted(self) -> int:
        """Return PETSc's reason to end for a solve that a signal stops (not collective)."""
        reason = PETSc.SNES.ConvergedReason
        self.reason = "a signal asked the run to stop"
        return int(reason.DIVERGED_USER) if hasattr(reason, "DIVERGED_USER") else int(reason.DIVERGED_INNER)

    def begin(self, u: Float) -> bool:
        """Start to record a solve from ``u``, and hold loose particles there; return whether there is a new ``Mat``.

        That of the preconditioner is, where bonds have broken.
        """
        self.norms, self.reason = [], ""
        self._hold_loose_particles(u)
        return self.tangent.renew()

    def result(self, reason: int, linear_reason: int, linear_iterations: int) -> StepResult:
        """Return how the solve went, for PETSc's reasons to end of SNES and KSP (not collective)."""
        iterations = max(len(self.norms) - 1, 0)
        return StepResult(
            converged=reason > 0,
            reason=self.reason or _words(reason, linear_reason),
            norms=list(self.norms),
            reference=self.reference,
            iterations=iterations,
            easy=iterations <= EASY_ITERATIONS,
            linear_iterations=linear_iterations,
        )

    def _hold_loose_particles(self, u: Float) -> None:
        """Damp particles that have lost bonds: a piece that has come free stays where it was, whatever it is.

        The force is that of a spring far softer than a bond to the place where the solve starts; it vanishes where
        nothing moves any more.
        """
        lost = self.model.local_damage()
        self._anchor, self.damping = u, None
        if self.model.has_history and float(total(self.model.cloud.comm, np.count_nonzero(lost))):
            self.damping = np.zeros(len(self.free))
            self.damping[: len(lost)] = np.where(lost > 0.0, DAMPING * self.scale, 0.0)

    def move_springs(self, u: Float) -> None:
        """Let the springs of loose particles have no force at ``u`` (not collective)."""
        self._anchor = u


def read_options(destroy: Callable[[], None], *solvers: PETSc.SNES | PETSc.KSP) -> None:
    """Give solvers their options (collective); where PETSc refuses one, ``destroy`` and raise CaseError."""
    try:
        for solver in solvers:
            solver.setFromOptions()
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
        "DIVERGED_FUNCTION_DOMAIN": "det F <= 0 could not be avoided",
        "DIVERGED_FNORM_NAN": "det F <= 0 or a number overflowed",
        "DIVERGED_LINE_SEARCH": "the line search failed",
    }.get(name, name)
