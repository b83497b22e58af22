"""Static equilibrium of one load step with SNES."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from petsc4py import PETSc

from pdpetsc.arrays import Float
from pdpetsc.discrete.communicator import total
from pdpetsc.errors import CaseError
from pdpetsc.loading import Loading
from pdpetsc.model import Assembler, Model
from pdpetsc.solve.base import StepResult, StepSolver
from pdpetsc.solve.defaults import stiffness_scale
from pdpetsc.solve.matrix import TangentMatrix
from pdpetsc.solve.petsc import set_domain_error

# The residual cannot fall below about this multiple of the round-off of K u.
FLOOR = 20.0
# A residual at the floor that an iteration did not lower by this factor has stagnated.
STAGNATION = 0.5
HALVINGS = 40
# Stiffness that holds a particle which has lost bonds, over a typical one.
DAMPING = 1e-8
# A step with no more iterations may be followed by a longer one.
EASY_ITERATIONS = 6


class StaticSolver(StepSolver):
    """Newton's method for ``f_int(u) = f_ext(t)`` with prescribed displacements, on PETSc's SNES.

    Parameters
    ----------
    model, loading
        The body and its conditions.
    stop : callable
        Asked after every iteration, collectively; True ends the solve (a signal arrived).

    Notes
    -----
    Construction and every method are collective. Call ``destroy`` before MPI ends.
    """

    unit = "Newton"
    advice = (
        "look for a limit point or zero-energy modes, add or raise the stabilisation, or try "
        "-snes_linesearch_type basic, a smaller smallest step or -snes_rtol 1e-8"
    )

    def __init__(self, model: Model, loading: Loading, assembler: Assembler, stop: Callable[[], bool]) -> None:
        cloud = model.cloud
        self.model = model
        self.loading = loading
        self._stop = stop
        self._free = ~loading.fixed
        spacing = cloud.volume[: cloud.n_owned, None] ** (1.0 / model.dim)
        whole = np.full((cloud.n_virtual, 1), 0.0 if cloud.images is None else cloud.images.sizes.max())
        self._spacing = np.concatenate([spacing, whole])
        self._scale = stiffness_scale(model)
        self._matrix = TangentMatrix(assembler, loading.fixed, self._scale)
        self._x = self._matrix.mat.createVecRight()
        self._r = self._x.duplicate()
        self._prescribed = np.zeros(loading.fixed.shape)
        self._external = np.zeros(loading.fixed.shape)
        self._damping: Float | None = None
        self._anchor = np.zeros(loading.fixed.shape)
        self._norms: list[float] = []
        self._reference = 0.0
        self._floor = 0.0
        self._reason = ""
        self.snes = PETSc.SNES().create(comm=cloud.comm)
        self.snes.setFunction(self._residual, self._r)
        self.snes.setJacobian(self._jacobian, self._matrix.mat)
        self.snes.setConvergenceTest(self._test)
        try:
            self.snes.setFromOptions()
        except PETSc.Error as error:
            self.destroy()
            raise CaseError(
                f"PETSc refused the solver options; check their names and values: {_first_line(error)}."
            ) from error
        self.snes.setLineSearchPreCheck(self._shorten)

    @property
    def matrix_bytes(self) -> int:
        """Return the memory of the entries that PETSc allocated, over all ranks [bytes]."""
        return self._matrix.bytes

    def description(self) -> str:
        """Return the solver in force in a few words."""
        ksp = self.snes.getKSP()
        pc = ksp.getPC()
        package = pc.getFactorSolverType() if pc.getType() in ("lu", "cholesky", "ilu", "icc") else None
        pc_name = f"{pc.getType()} ({package})" if package else str(pc.getType())
        return f"snes {self.snes.getType()}, ksp {ksp.getType()}, pc {pc_name}"

    def solve(self, u: Float, t: float) -> tuple[Float, StepResult]:
        """Find equilibrium at step time ``t`` starting from ``u`` (n_rows, dim).

        Returns
        -------
        u : (n_rows, dim) float64
            The new displacement, or an unusable one where the step failed.
        result : StepResult
        """
        old_prescribed = self._prescribed
        self._prescribed = self.loading.prescribed(t)
        self._external = self.loading.forces(t)
        self._norms, self._reason, linear = [], "", 0
        start = u
        self._hold_loose_particles(u)
        if self._sum(np.count_nonzero(self._prescribed != old_prescribed)):
            start, linear = self._predict(u, self._prescribed - np.where(self.loading.fixed, u, 0.0))
        self._x.array = start.ravel()
        self.snes.solve(None, self._x)
        if self._damping is not None and self.snes.getConvergedReason() > 0:
            # Once more from where it came to rest: the damping has no force there.
            linear += self.snes.getLinearSolveIterations()
            self._anchor = self._at_prescribed(self._x.array).copy()
            self.snes.solve(None, self._x)
        reason = self.snes.getConvergedReason()
        result = StepResult(
            converged=reason > 0,
            reason=self._reason or _words(reason, self.snes.getKSP().getConvergedReason()),
            norms=list(self._norms),
            reference=self._reference,
            iterations=max(len(self._norms) - 1, 0),
            easy=len(self._norms) - 1 <= EASY_ITERATIONS,
            linear_iterations=linear + self.snes.getLinearSolveIterations(),
        )
        if reason <= 0:
            self._prescribed = old_prescribed
        return self._at_prescribed(self._x.array).copy(), result

    def destroy(self) -> None:
        """Free the PETSc objects, in order."""
        self.snes.destroy()
        self._r.destroy()
        self._x.destroy()
        self._matrix.destroy()

    def _at_prescribed(self, x: Float) -> Float:
        return np.where(self._free, x.reshape(self._free.shape), self._prescribed)

    def _predict(self, u: Float, jump: Float) -> tuple[Float, int]:
        """Return the linear response to new prescribed displacements: Newton's first step, from the old state.

        Setting them alone would strain the layer next to a support by the whole increment.
        """
        jump = np.where(self.loading.fixed, jump, 0.0)
        force = self.model.internal_force(u)
        if force is None:
            return u, 0
        self._matrix.update(u, self._damping)
        b = self._external - force - self.model.tangent_times(u, jump)
        self._r.array = np.where(self._free, b, 0.0).ravel()
        ksp = self.snes.getKSP()
        ksp.setOperators(self._matrix.mat, self._matrix.mat)
        ksp.solve(self._r, self._x)
        change = self._x.array.reshape(u.shape) + jump
        return u + (change if np.isfinite(self._sum(change.sum())) else jump), ksp.getIterationNumber()

    def _residual(self, snes: PETSc.SNES, x: PETSc.Vec, r: PETSc.Vec) -> None:
        values = x.array_r.reshape(self._free.shape)
        force = self.model.internal_force(self._at_prescribed(values))
        if force is None:
            set_domain_error(snes)
            r.set(np.inf)
            return
        residual = force - self._external
        if self._damping is not None:
            residual += self._damping[:, None] * (values - self._anchor)
        self._reaction = np.where(self._free, 0.0, residual)
        residual = np.where(self._free, residual, self._scale * (values - self._prescribed))
        r.array = residual.ravel()

    def _jacobian(self, snes: PETSc.SNES, x: PETSc.Vec, J: PETSc.Mat, P: PETSc.Mat) -> None:
        self._matrix.update(self._at_prescribed(x.array_r), self._damping)

    def _shorten(self, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Halve a Newton step until the whole of it keeps det F > 0, whatever the line search."""
        if self.model.linear:
            return
        here, step = x.array_r, y.array_r
        factor = 1.0
        for _ in range(HALVINGS):
            if self.model.all_admissible(self._at_prescribed(here - factor * step)):
                break
            factor *= 0.5
        if factor < 1.0:
            y.scale(factor)

    def _test(self, snes: PETSc.SNES, iteration: int, norms: tuple[float, float, float]) -> int | None:
        reason = PETSc.SNES.ConvergedReason
        residual = norms[2]
        self._norms.append(residual)
        if self._stop():
            self._reason = "a signal asked the run to stop"
            return int(reason.DIVERGED_USER) if hasattr(reason, "DIVERGED_USER") else int(reason.DIVERGED_INNER)
        if not np.isfinite(residual):
            return int(reason.DIVERGED_FNORM_NAN)
        values = self._at_prescribed(snes.getSolution().array_r)
        diagonal = self._matrix.diagonal.reshape(values.shape)
        round_off = np.where(self._free, diagonal * (np.abs(values) + self._spacing), 0.0)
        squares = total(
            self.model.cloud.comm, [(self._external**2).sum(), (self._reaction**2).sum(), (round_off**2).sum()]
        )
        self._reference = float(np.sqrt(max(squares[0], squares[1])))
        self._floor = FLOOR * float(np.finfo(float).eps) * float(np.sqrt(squares[2]))
        rtol = float(snes.getTolerances()[0])
        if residual <= rtol * self._reference or residual == 0.0:
            self._reason = "residual below tolerance"
            return int(reason.CONVERGED_FNORM_RELATIVE)
        if iteration > 0 and residual <= self._floor and residual > STAGNATION * self._norms[-2]:
            self._reason = "residual at the round-off floor"
            return int(reason.CONVERGED_FNORM_ABS)
        return None

    def _hold_loose_particles(self, u: Float) -> None:
        """Damp particles that have lost bonds: a piece that has come free stays where it was, whatever it is.

        The force is that of a spring far softer than a bond to the place where the solve starts; it vanishes where
        nothing moves any more.
        """
        lost = self.model.local_damage()
        self._anchor, self._damping = u, None
        if self.model.has_history and self._sum(np.count_nonzero(lost)):
            self._damping = np.zeros(len(self._free))
            self._damping[: len(lost)] = np.where(lost > 0.0, DAMPING * self._scale, 0.0)

    def _sum(self, value: float) -> float:
        return float(total(self.model.cloud.comm, value))


def _first_line(error: PETSc.Error) -> str:
    """Return what PETSc says is wrong, without its traceback."""
    lines = [line.split("] ", 1)[-1] for line in str(error).splitlines() if line.strip()]
    kept = [line for line in lines if not line.startswith(("error code", "SNES", "KSP", "PC"))]
    return (kept or lines or ["unknown"])[-1].rstrip(".")


def _words(reason: int, linear: int) -> str:
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
