"""Time one linear solve from scratch: [mpirun -n 2] python runs/bench/linear.py [name=value ...] [-petsc_option ...].

A box of n^dim particles (n x n in the plane) of Hencky material, held at one end and pulled at the other, with the
tangent at rest: pattern, assembly, preconditioner and iterations to a relative residual of 1e-8. Parameters and their
defaults: dim=2 n=201 horizon=3.015 nu=0.3 scheme=correspondence G=0.5 crack=0 broken=0 jacobian=matfree repeats=1
json=; crack is the share of the width that a crack crosses, broken that of bonds that have failed, json a file for what
was measured.
"""

import json
import resource
import sys
import time
from contextlib import contextmanager, nullcontext
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))
import study

words = study.start("bench")

import numpy as np
from box import case
from petsc4py import PETSc

from pdpetsc.declare.solvers import Newton
from pdpetsc.discrete.communicator import is_root, largest, total, world
from pdpetsc.petsc.defaults import default_options
from pdpetsc.petsc.jacobian import assembler, choose, make_tangent
from pdpetsc.petsc.library import linear_solver
from pdpetsc.petsc.options import Options
from pdpetsc.problem.scales import stiffness_scale
from pdpetsc.running.build import make_cloud, make_families, make_problem, rehearse

RTOL = 1e-8
APPLIED = 5
# Bonds whose keys are in memory at once.
BONDS = 1_000_000
SCRATCH = ("pattern", "allocation", "assembly", "preconditioner", "iterations")


class Clock:
    """Seconds of phases, the longest of all ranks."""

    def __init__(self):
        self.spent = {}

    @contextmanager
    def __call__(self, name):
        world().Barrier()
        before = time.perf_counter()
        yield
        self.spent[name] = largest(world(), time.perf_counter() - before)


def failed_bonds(problem, share):
    """Break a share of the bonds, the same from both ends and on any ranks."""
    bonds = problem.damage.bonds
    for start in range(0, len(bonds.phi), BONDS):
        part = slice(start, start + BONDS)
        keys = bonds.of.keys(part)
        number = (keys[:, 0] * 2654435761 + keys[:, 1] * 40503 + keys[:, 2] * 97) % 1000003
        bonds.phi[part][number % 1000 < 1000 * share] = 0.0
    problem.bonds_restored()


def solve(scene, jacobian, broken=0.0, around=nullcontext):
    """Return what one solve took and gave; the iterations run inside the context ``around``."""
    comm, clock = world(), Clock()
    with clock("cloud"):
        cloud = make_cloud(comm, scene)
    rehearse(comm, scene, cloud.dim)
    with clock("search"):
        families = make_families(scene, cloud)
    with clock("model"):
        problem = make_problem(scene, cloud, families)
        if broken:
            failed_bonds(problem, broken)
    supports = problem.supports
    chosen = {"pd_jacobian": jacobian}
    choice = choose(problem, chosen, Newton())
    with Options(chosen).suggest(default_options(problem, Newton(), choice)).active():
        with clock("pattern"):
            filled = assembler(problem, choice)
        with clock("allocation"):
            tangent = make_tangent(filled, supports.fixed, stiffness_scale(problem.body, problem.material_term))
        state = problem.state(np.zeros((cloud.n_rows, cloud.dim)))
        with clock("assembly"):
            tangent.update(state)
        ksp = PETSc.KSP().create(comm=comm)
        ksp.setOperators(tangent.mat, tangent.preconditioner)
        ksp.setFromOptions()
        tangent.equip(ksp)
        ksp.setTolerances(rtol=RTOL)
        b, x = tangent.preconditioner.createVecRight(), tangent.preconditioner.createVecLeft()
        b.array = np.where(supports.fixed, 0.0, -problem.linearised(state)(supports.prescribed(1.0))).ravel()
        with clock("preconditioner"):
            ksp.setUp()
        with clock("iterations"), around():
            ksp.solve(b, x)
        with clock("operator"):
            for _ in range(APPLIED):
                tangent.mat.mult(x, b)
        clock.spent["operator"] /= APPLIED
        with clock("cycle"):
            for _ in range(APPLIED):
                ksp.getPC().apply(b, x)
        clock.spent["cycle"] /= APPLIED
        memory = float(total(comm, float(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)))
        found = {
            "particles": cloud.n_global,
            "bonds": int(total(comm, families.n_bonds)),
            "ranks": comm.size,
            "solver": linear_solver(ksp),
            "linear_iterations": ksp.getIterationNumber(),
            "reason": ksp.getConvergedReason(),
            "seconds": clock.spent,
            "scratch": sum(clock.spent[name] for name in SCRATCH),
            "matrix_MiB": tangent.bytes / 2**20,
            "peak_MiB": memory / 2**10,
        }
        ksp.destroy()
        tangent.destroy()
    return found


def main():
    given = dict(word.split("=", 1) for word in words)
    defaults = {
        "dim": 2,
        "n": 201,
        "horizon": 3.015,
        "nu": 0.3,
        "scheme": "correspondence",
        "G": 0.5,
        "crack": 0.0,
        "broken": 0.0,
    }
    values = {name: type(value)(given.pop(name, value)) for name, value in defaults.items()}
    jacobian, repeats, out = given.pop("jacobian", "matfree"), int(given.pop("repeats", 1)), given.pop("json", "")
    if given:
        raise SystemExit(f"unknown parameters: {', '.join(given)}")
    share = values.pop("broken")
    runs = [solve(case(**values, breakable=share > 0.0), jacobian, share) for _ in range(repeats)]
    run = sorted(runs, key=lambda r: r["scratch"])[len(runs) // 2]
    if is_root(world()):
        if out:
            Path(out).write_text(json.dumps({**values, "broken": share, "jacobian": jacobian, **run}))
        print(f"{run['particles']} particles, {run['bonds']} bonds, {run['ranks']} ranks, {jacobian}, {run['solver']}")
        print("  " + ", ".join(f"{name} {1e3 * s:.0f} ms" for name, s in run["seconds"].items()))
        print(
            f"  one solve from scratch {run['scratch']:.2f} s, {run['linear_iterations']} iterations"
            f"{'' if run['reason'] > 0 else ' (not converged)'}, matrix {run['matrix_MiB']:.0f} MiB, "
            f"peak memory {run['peak_MiB']:.0f} MiB"
        )


if __name__ == "__main__":
    main()
