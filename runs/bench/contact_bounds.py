"""Contact by multipliers against PETSc's variational inequality: python runs/bench/contact_bounds.py [n=24].

The half cylinder of ``runs/contact/hertz_line.py`` on a plane that has moved up in one step, without friction: the case
with ``pd.Contact``, and the same tangent with a lower bound on the displacement of every node of the arc, solved by
SNES ``vinewtonrsls`` (Newton's method on the active set, reduced space) with a direct solver. A bound on single
displacements is all that it takes, so that the plane is along an axis and nothing slides with friction.

Prints the force of the whole width, its error over MOOSE's, Newton iterations, and seconds of the solve.
"""

import sys
import time
from pathlib import Path

sys.path.append(str(Path(__file__).parent.parent))
sys.path.append(str(Path(__file__).parent.parent / "contact"))
import study

words = study.start("bench")

import dataclasses

import hertz_line
import numpy as np
from petsc4py import PETSc

import pdpetsc as pd
from pdpetsc.declare.solvers import Newton
from pdpetsc.declare.tools import Contact
from pdpetsc.petsc.defaults import default_options
from pdpetsc.petsc.jacobian import assembler, choose, make_tangent
from pdpetsc.petsc.options import Options
from pdpetsc.problem.scales import stiffness_scale

LOAD = 0.002


def by_bounds(case):
    """Return force, Newton iterations and seconds of the variational inequality."""
    problem = pd.prepare(case).problem
    chosen = {"pd_jacobian": "assembled"}
    choice = choose(problem, chosen, Newton())
    with Options(chosen).suggest(default_options(problem, Newton(), choice)).active():
        # The matrix is in units of this stiffness.
        scale = stiffness_scale(problem.body, problem.material_term)
        tangent = make_tangent(assembler(problem, choice), problem.supports.fixed, scale)
        before = time.perf_counter()
        tangent.update(problem.state(np.zeros(problem.supports.fixed.shape)))
        K = tangent.mat
        x, r = K.createVecs()
        low, high = x.duplicate(), x.duplicate()
        X = problem.body.cloud.x
        bounds = np.full(X.shape, PETSc.NINFINITY)
        arc = np.abs(np.linalg.norm(X - [0.0, hertz_line.RADIUS], axis=1) - hertz_line.RADIUS) < 1e-9
        bounds[arc, 1] = LOAD - X[arc, 1]
        bounds[problem.supports.fixed] = PETSc.NINFINITY
        low.array, high.array = bounds.ravel(), PETSc.INFINITY
        snes = PETSc.SNES().create(comm=K.comm)
        snes.setType("vinewtonrsls")
        snes.setFunction(lambda _, u, f: K.mult(u, f), r)
        snes.setJacobian(lambda *_: None, K, K)
        snes.setVariableBounds(low, high)
        snes.setTolerances(rtol=1e-10, max_it=200)
        ksp = snes.getKSP()
        ksp.setType("preonly")
        ksp.getPC().setType("lu")
        ksp.getPC().setFactorSolverType("mumps")
        x.array = np.maximum(0.0, np.where(np.isfinite(bounds), bounds, 0.0)).ravel()
        snes.solve(None, x)
        spent = time.perf_counter() - before
        K.mult(x, r)
        if snes.getConvergedReason() <= 0:
            raise SystemExit(f"the variational inequality did not converge: {snes.getConvergedReason()}")
        return 2.0 * scale * float(r.array.reshape(X.shape)[arc, 1].sum()), snes.getIterationNumber(), spent


def main():
    """Print both solutions."""
    given = dict(word.split("=", 1) for word in words)
    case = hertz_line.case(n=int(given.get("n", 24)), load=LOAD)
    bare = dataclasses.replace(
        case, conditions=[one for one in case.conditions if not isinstance(one, Contact)], history={}, results=None,
        expect={},
    )  # fmt: skip
    found = {"bounds": by_bounds(bare)}
    run = pd.run(case, "out/bench_contact")
    steps = run.summary["steps"]
    found["multipliers"] = run["force"], sum(one["newton_iterations"] for one in steps), run.summary["timings"]["solve"]
    for name, (force, iterations, seconds) in found.items():
        off = force / hertz_line.MOOSE - 1.0
        print(f"{name:12s} force {force:.3f} ({100.0 * off:+.2f} %), {iterations} Newton iterations, {seconds:.2f} s")


if __name__ == "__main__":
    main()
