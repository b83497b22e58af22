"""Time steps of particles that a core takes in a second: python runs/bench/explicit.py [n=48] [steps=40].

Dynamic relaxation of a cube of n^3 particles at horizon 3.015, whose time step is that of an explicit code with damping
and two sums: internal forces, update, sums. Printed are particles times steps over the seconds of a run of some steps
less that of half as many, medians of three. Where ``lmp`` of LAMMPS is on the path and has the package PERI, its
prototype microelastic brittle and linear peridynamic solids run beside, on the same lattice with the same neighbours.
"""

import os
import re
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))
import study

words = study.start("bench")

import numpy as np  # noqa: E402
from kernels import BODIES  # noqa: E402

import pdpetsc as pd  # noqa: E402
from pdpetsc.discrete.communicator import world  # noqa: E402
from pdpetsc.running.build import make_cloud, make_families, make_problem  # noqa: E402
from pdpetsc.solvers.relaxation import RelaxationSolver  # noqa: E402

REPEATS = 3
LAMMPS = """
units si
boundary s s s
atom_style peri
atom_modify map array
neighbor 0.3 bin
lattice sc 1.0
region box block 0 {n} 0 {n} 0 {n} units box
create_box 1 box
region bodies block 0 {last} 0 {last} 0 {last} units box
create_atoms 1 region bodies
{style}
set group all density 1.0
set group all volume 1.0
velocity all create 1e-6 1
velocity all scale 1e-20
fix 1 all nve
timestep 1e-3
thermo {steps}
run {steps}
"""
# Micromodulus, or bulk and shear modulus, then horizon, critical stretch that is never reached and its slope.
STYLES = {
    "LAMMPS, peri/pmb (bonds, finite)": "pair_style peri/pmb\npair_coeff * * 0.01 3.015 1000.0 0.0",
    "LAMMPS, peri/lps (state-based)": "pair_style peri/lps\npair_coeff * * 0.8 0.4 3.015 1000.0 0.0",
}


def relaxation(n, steps, body):
    """Return the particle-steps a second of dynamic relaxation."""
    side = float(n)
    case = pd.Case(
        particles=pd.Lattice([0.0] * 3, [side] * 3, 1.0),
        horizon=3.015,
        conditions=[
            pd.Displacement(pd.region.Slab("x", high=1.0), x=0.0, y=0.0, z=0.0),
            pd.Displacement(pd.region.Slab("x", low=side - 1.0), x=0.01 * side),
        ],
        **body,
    )
    cloud = make_cloud(world(), case)
    problem = make_problem(case, cloud, make_families(case, cloud))

    def spent(most):
        declared = pd.DynamicRelaxation(tolerance=1e-14, most=most)
        solver = RelaxationSolver(problem, declared, pd.Steps(1), lambda: False)
        before = time.perf_counter()
        solver.solve(np.zeros((problem.body.cloud.n_rows, 3)), 1.0)
        return time.perf_counter() - before

    spent(2)
    # The estimate of the time step and the first forces are in both.
    return statistics.median(n**3 * (steps - steps // 2) / (spent(steps) - spent(steps // 2)) for _ in range(REPEATS))


def lammps(n, steps, style):
    """Return the particle-steps a second of LAMMPS on one core, or nothing where it is not there."""
    program = shutil.which("lmp")
    if program is None:
        return None
    # It is no part of the MPI job of this process, and may have been built with another MPI.
    alone = {name: value for name, value in os.environ.items() if not name.startswith(("OMPI_", "PMI", "ORTE_"))}
    found = []
    for _ in range(REPEATS):
        with tempfile.TemporaryDirectory() as folder:
            script = Path(folder) / "in.peri"
            script.write_text(LAMMPS.format(n=n, last=n - 0.5, steps=steps, style=style))
            words = [program, "-in", str(script), "-log", "none"]
            done = subprocess.run(words, cwd=folder, env=alone, capture_output=True, text=True, check=False)
        match = re.search(r"Loop time of (\S+) on \d+ procs for (\d+) steps with (\d+) atoms", done.stdout)
        if match is None:
            raise SystemExit(f"LAMMPS failed:\n{done.stdout[-2000:]}{done.stderr[-2000:]}")
        found.append(float(match[3]) * float(match[2]) / float(match[1]))
    return statistics.median(found)


def main():
    given = {"n": 48, "steps": 40} | {name: int(value) for name, value in (word.split("=") for word in words)}
    for name, body in BODIES.items():
        print(f"{name:36} {relaxation(given['n'], given['steps'], body) / 1e6:6.2f} million particle-steps a second")
    for name, style in STYLES.items():
        speed = lammps(given["n"], given["steps"], style)
        print(f"{name:36} {'not installed' if speed is None else f'{speed / 1e6:6.2f}'}")


if __name__ == "__main__":
    main()
