"""Natural frequencies and buckling factors of the last equilibrium of a run."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import h5py
import numpy as np
import scipy

from pdpetsc.arrays import Complex, Float
from pdpetsc.case import Case, ungraded
from pdpetsc.declare.modes import FrequencyResponse, Modes
from pdpetsc.declare.solvers import Newton
from pdpetsc.discrete.communicator import agreed, count_nonzero, is_root, largest, scalar_product, total
from pdpetsc.errors import CaseError, SolveError
from pdpetsc.output.observer import Observed, Observer, StepRecords
from pdpetsc.output.progress import Report
from pdpetsc.output.records import Table
from pdpetsc.post.quantities import Quantity
from pdpetsc.post.solution import Solution
from pdpetsc.problem.problem import Problem
from pdpetsc.problem.rigid_body import RigidBody
from pdpetsc.problem.scales import scales_of
from pdpetsc.running.build import materials_of
from pdpetsc.solvers.eigenvectors import EXACT, converged, led, of_inverse
from pdpetsc.solvers.protocol import Converged, Flexibility, Solver
from pdpetsc.solvers.rigid_bodies import RigidBodies

# Displacement over the mean spacing in derivatives of quantities.
SMALL = 1e-4


class FoundModes(Observer):
    """Computes the modes of the last equilibrium and writes their shapes."""

    def __init__(self, case: Case, declared: Modes) -> None:
        self._case, self._declared = case, declared
        self._values: list[float] = []
        self._response: dict[str, float] = {}
        # Unknowns and load parameter of the last two equilibria; before the start the body is undeformed.
        self._ends: list[tuple[Float, float]] = []
        # True until a step is computed after a restart, whose checkpoint lacks the equilibrium before.
        self._lacks = False

    def begin(self, observed: Observed) -> None:
        """Store the state from which the run starts."""
        super().begin(observed)
        last = observed.last
        self._ends = [(np.zeros_like(last.unknowns), 0.0), (last.unknowns, last.t)]
        self._lacks = last.step > 1

    def step(self, solution: Solution, converged: Converged) -> Mapping[str, Any]:
        """Store the state of a converged step."""
        self._ends, self._lacks = [self._ends[-1], (solution.unknowns, solution.t)], False
        return {}

    def rehearse(self, start: Solution, report: Report) -> None:
        refuse_modes(self._case, self._declared, start.problem)

    def judge(self) -> None:
        """Compute the modes, print them and write ``modes.h5``."""
        observed, declared = self.observed, self._declared
        problem, last = observed.problem, observed.last
        planes = problem.body.cloud.places.planes
        if planes:
            axes = ", ".join("xyz"[axis] for axis in planes)
            observed.report.say(f"modes of the whole body that are symmetric about the mirror planes across {axes}")
        if declared.of == "frequency":
            values, shapes = frequencies(self._case, problem, observed.solver, last.unknowns, last.t, declared.count)
        else:
            values, shapes = buckling(problem, observed.solver, self._ends, declared.count)
        self._values = values
        if len(values) < declared.count:
            observed.report.say(f"{len(values)} of {declared.count} modes were found: the load causes no more")
        parts = [list(observed.order.parts_on_root(shape)) for shape in shapes]
        with agreed(observed.comm):
            if is_root(observed.comm):
                size = problem.body.cloud.n_global
                with h5py.File(observed.folder / "modes.h5", "w") as file:
                    file[declared.of] = values
                    shape = file.create_dataset("shape", (len(values), size, problem.dim))
                    for number, rows in enumerate(parts):
                        for where, part in rows:
                            shape[number, where] = part
        if declared.response is not None:
            found = response(declared.response, self._case.history, last, observed.solver, values, shapes)
            self._write(np.asarray(declared.response.frequencies, dtype=float), found)

    def _write(self, at: Float, found: Mapping[str, Complex]) -> None:
        """Write the complex amplitude of each quantity by frequency (n,); keep the largest ones as results."""
        header, columns = ["frequency"], [at]
        for name, amplitude in found.items():
            size = np.abs(amplitude)
            header += [f"{name}_amplitude", f"{name}_phase"]
            columns += [size, -np.degrees(np.angle(amplitude))]
            most = int(np.argmax(size))
            self._response |= {f"response_{name}": float(size[most]), f"response_{name}_at": float(at[most])}
        Table(self.observed.comm, self.observed.folder / "response.csv", [header, *np.stack(columns, axis=1).tolist()])

    def results(self) -> Mapping[str, float]:
        """Return the frequencies or factors by name."""
        return {**dict(zip(self._declared.names, self._values, strict=False)), **self._response}

    def warnings(self, steps: StepRecords) -> Sequence[str]:
        """Return a warning if factors are not those of the last two steps."""
        if not (self._lacks and self._values and self._declared.of == "buckling"):
            return ()
        return [
            "Buckling factors are those of the undeformed body and the last equilibrium: a checkpoint lacks "
            "the one before. Restart from an earlier step for those of the last two."
        ]

    def summary(self, steps: StepRecords) -> Mapping[str, Any]:
        """Return the kind of modes and their values."""
        return {"modes": {"of": self._declared.of, "values": self._values}}


def refuse_modes(case: Case, declared: Modes, problem: Problem) -> None:
    """Raise CaseError on all ranks if the modes of a case cannot be computed (collective)."""
    wrong = has_no_modes(case, problem)
    if not wrong and declared.of == "buckling" and problem.material_term.linear:
        wrong = "of buckling need a material for large rotations, such as NeoHookean"
    if wrong:
        raise CaseError(f"Modes {wrong}.")
    free = count_nonzero(problem.body.cloud.comm, ~problem.supports.fixed)
    if free <= declared.count + 1:
        raise CaseError(f"A body of {free} unknowns has no {declared.count} modes that could be sought; ask for fewer.")
    on_path = [name for name, quantity in case.history.items() if quantity.of_path]
    if declared.response is not None and on_path:
        raise CaseError(f"{on_path[0]!r} of the history depends on the path of the load, and does not oscillate.")
    if declared.of == "frequency":
        layers = [rigid.title for _, rigid in problem.rigid_bodies if rigid.fictitious]
        if layers:
            raise CaseError(
                f"{layers[0]} is the layers beyond a side of a Lattice, which have no mass of their own. For "
                f"frequencies use LatticeNodes, or name a region of particles."
            )
        without = [type(ungraded(one)).__name__ for _, one in case.materials if ungraded(one).density is None]
        if without:
            raise CaseError(f"Modes need the density of each material, and {without[0]} has none.")


def has_no_modes(case: Case, problem: Problem) -> str:
    """Return the reason if the tangents of a case have no modes that mean anything, else an empty string."""
    if problem.damage is not None or case.heat is not None or problem.body.cloud.n_virtual:
        return "do not go with damage, heat conduction or a periodic cell"
    if problem.material_term.has_history:
        return "need an elastic body: in one that has yielded the tangent depends on the direction of the mode"
    if not problem.symmetric:
        return "need a symmetric tangent: no friction, no contact of bodies and no pressure that follows"
    wrong = next((why for _, rigid in problem.rigid_bodies if (why := has_no_energy(rigid))), "")
    if wrong:
        return wrong
    if not isinstance(case.solver, Newton):
        return "need the tangent of load steps: let the solver be Newton()"
    return ""


def has_no_energy(rigid: RigidBody) -> str:
    """Return the reason if modes do not move a loaded rigid body, else an empty string."""
    if rigid.rows is None:
        return "hold tools where they are, and do not go with one whose motion follows from a load"
    if not rigid.conservative:
        return "need loads with an energy, which a force that follows and a moment in space do not have"
    return ""


def masses(case: Case, problem: Problem) -> Float:
    """Return the masses of the own particles (n_owned,) [mass] (collective)."""
    cloud = problem.body.cloud
    density = materials_of(case, cloud).density
    assert density is not None
    return density * cloud.volume[: cloud.n_owned]


def frequencies(
    case: Case, problem: Problem, solver: Solver, u: Float, t: float, count: int
) -> tuple[list[float], list[Float]]:
    """Compute frequencies [1 / time] and shapes (n_owned, dim) with unit modal mass, lowest first.

    Raises
    ------
    SolveError
        The tangent cannot be solved, or the iteration does not converge.

    Notes
    -----
    Collective.
    """
    flexible = _flexibility(solver, u, t)
    # The factor counts the unstable modes, whose eigenvalues are negative.
    flexible(np.zeros_like(u))
    unstable = flexible.negative_pivots() or 0
    if unstable == 0 and not flexible.stable():
        raise SolveError(
            f"The equilibrium at step time {t:.6g} is unstable, or nothing tells whether it is, and only -pc_type "
            f"cholesky counts its unstable modes. Use it."
        )
    kinds = [("SA", unstable), ("LA", count)] if unstable else [("LA", count)]
    added = _rigid_bodies(problem).mass_roots(problem.state(u, t))
    values, shapes = of_inverse(problem, flexible, masses(case, problem), kinds, added)
    found = np.sign(values) / (2.0 * np.pi * np.sqrt(np.abs(values)))
    lowest = np.argsort(found, kind="stable")[:count]
    return found[lowest].tolist(), [shapes[number] for number in lowest]


def response(
    declared: FrequencyResponse, quantities: Mapping[str, Quantity], last: Solution, solver: Solver,
    frequencies: Sequence[float], shapes: Sequence[Float],
) -> dict[str, Complex]:  # fmt: skip
    """Compute the complex amplitude of each quantity by frequency of the loads (n_frequencies,).

    Raises
    ------
    SolveError
        The equilibrium is unstable, or no load acts.

    Notes
    -----
    Collective.
    """
    problem, n, comm = last.problem, len(last.u), last.cloud.comm
    if min(frequencies, default=0.0) <= 0.0:
        raise SolveError("The last equilibrium is unstable, and does not vibrate about it.")
    loads, on_bodies = problem.external_force(last.state), _rigid_bodies(problem).on_particles(last.state)
    if largest(comm, np.abs(problem.supports.reduced(loads) + on_bodies), initial=0.0) == 0.0:
        raise SolveError("No load acts on free particles in the last equilibrium, so that none can oscillate. Add one.")
    loads += on_bodies
    static = _flexibility(solver, last.unknowns, last.t)(loads)
    reach = SMALL * float(total(comm, float(last.volume.sum())) / problem.body.cloud.n_global) ** (1.0 / problem.dim)

    def along(direction: Float) -> Float:
        """Return the derivatives of the quantities along a displacement (n_rows, dim)."""
        step = reach / largest(comm, np.abs(direction), initial=0.0)
        ends = [Solution(problem, last.unknowns + sign * step * direction, last.t, last.step) for sign in (1.0, -1.0)]
        one, other = (np.array([quantity.evaluate(end) for quantity in quantities.values()]) for end in ends)
        return np.asarray((one - other) / (2.0 * step))

    w = 2.0 * np.pi * np.asarray(declared.frequencies, dtype=float)
    found = np.tile(along(static).astype(complex), (len(w), 1))
    for frequency, shape in zip(frequencies, shapes, strict=True):
        direction = np.zeros_like(last.unknowns)
        direction[:n] = shape
        own = 2.0 * np.pi * frequency
        ratio = declared.ratio + 0.5 * declared.mass / own + 0.5 * declared.stiffness * own
        driven = scalar_product(comm, shape, loads[:n])
        share = driven * (1.0 / (own**2 - w**2 + 2.0j * ratio * own * w) - 1.0 / own**2)
        found += share[:, None] * along(direction)
    return dict(zip(quantities, found.T, strict=True))


def buckling(
    problem: Problem, solver: Solver, ends: Sequence[tuple[Float, float]], count: int
) -> tuple[list[float], list[Float]]:
    """Compute positive buckling factors [-], lowest first, and shapes (n_owned, dim) whose largest component is 1.

    The tangent is extrapolated from the first to the last of the ``ends``, unknowns and load parameters. Errors as for
    ``frequencies``. Collective.
    """
    n = problem.body.cloud.n_owned
    (u0, t0), (u1, t1) = ends[0], ends[-1]
    flexible = _flexibility(solver, u0, t0)
    flexible(np.zeros_like(u0))
    if not flexible.stable():
        raise SolveError(
            f"The equilibrium at step time {t0:.6g}, from which buckling factors extrapolate, is unstable, or nothing "
            f"tells whether it is; apply a smaller load, or use -pc_type cholesky."
        )
    bodies, spring = _rigid_bodies(problem), scales_of(problem.body, problem.material_term).stiffness
    stiff, loaded = (bodies.coupled(problem.state(u, t)) for u, t in ((u0, t0), (u1, t1)))
    free = ~problem.supports.fixed[:n] | stiff.regions[:n, None]

    def unpacked(y: Float) -> Float:
        values = np.zeros_like(u0)
        values[:n][free] = y
        return values

    def softening(y: Float) -> Float:
        return np.asarray((stiff.product(unpacked(y)) - loaded.product(unpacked(y)))[:n][free])

    # Springs resist displacements that would strain a rigid region. Such displacements are not modes.
    def stiffness(y: Float) -> Float:
        force = stiff.product(unpacked(y)) + spring * stiff.off_motions(unpacked(y))
        return np.asarray(force[:n][free])

    def inverse(y: Float) -> Float:
        # The forces are those on independent unknowns already.
        moved = flexible(unpacked(y)) + stiff.off_motions(unpacked(y)) / spring
        return np.asarray(moved[:n][free])

    def solve(apply: Mapping[str, Callable[[Float], Float]], size: int, start: Float) -> tuple[Float, Float]:
        A, M, Minv = (
            scipy.sparse.linalg.LinearOperator((size, size), apply[name], dtype=float) for name in ("A", "M", "Minv")
        )
        return converged(A, count, M=M, Minv=Minv, which="LA", v0=start)

    operators = {"A": softening, "M": stiffness, "Minv": inverse}
    values, vectors = led(problem, operators, free, solve)
    found = []
    for value, y in zip(values, vectors, strict=True):
        if value > EXACT:
            shape = stiff.completed(unpacked(y[free]))[0][:n]
            size = largest(problem.body.cloud.comm, np.abs(shape), initial=0.0)
            found.append(((t0 + (t1 - t0) / float(value)) / t1, shape / size))
    found.sort(key=lambda one: one[0])
    return [factor for factor, _ in found], [shape for _, shape in found]


def _rigid_bodies(problem: Problem) -> RigidBodies:
    """Return the loaded rigid bodies, with angles of the size of displacements."""
    return RigidBodies(problem, scales_of(problem.body, problem.material_term).length)


def _flexibility(solver: Solver, u: Float, t: float) -> Flexibility:
    found = solver.flexibility(u, t, EXACT)
    assert found is not None
    return found
