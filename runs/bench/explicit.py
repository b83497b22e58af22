"""Time steps of particles that a core takes in a second: python runs/bench/explicit.py [n=48] [steps=40].

A free cube of n^3 particles at horizon 3.015 moves by central differences, with its energy balance. Printed are
particles times steps over the seconds between two records, medians of three, and the time step over that of the formula
for bonds, ``sqrt(2 rho / sum_j V_j c / |xi_j|)``. Where ``lmp`` of LAMMPS is on the path and has the package PERI, its
prototype microelastic brittle and linear peridynamic solids run beside, on the same lattice with the same neighbours.
"""

import dataclasses
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

import numpy as np
from kernels import BODIES

import pdpetsc as pd
from pdpetsc.solvers.dynamics.stable_step import largest_frequency

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


def motion(n, steps, body):
    """Return the particle-steps a second of central differences, and the stable time step over that of the formula."""
    side = float(n)
    law = dataclasses.replace(body["material"], density=1.0)

    def moving(end):
        return pd.Case(
            particles=pd.Lattice([0.0] * 3, [side] * 3, 1.0),
            horizon=3.015,
            conditions=[pd.InitialVelocity(pd.region.All(), x=lambda x, t: 1e-6 * x[:, 0])],
            solver=pd.Explicit(end=end, records=2),
            **{**body, "material": law},
        )

    prepared = pd.prepare(moving(1.0))
    w = largest_frequency(prepared.problem, prepared.problem.state(np.zeros((n**3, 3))), prepared.problem.inertia.mass)
    found = []
    prepared = pd.prepare(moving(2.0 * steps * 0.9 * 2.0 / w))
    for _ in range(REPEATS):
        solver = prepared.make_solver()
        march = prepared.march(solver)
        next(march)
        before = time.perf_counter()
        found.append(n**3 * next(march).result.iterations / (time.perf_counter() - before))
        solver.destroy()
    xi = np.stack(np.meshgrid(*[np.arange(-3, 4)] * 3), axis=-1).reshape(-1, 3)
    length = np.linalg.norm(xi, axis=1)
    length = length[(length > 0.0) & (length <= 3.015)]
    # c of a solid of E = 1 and nu = 1/4: 18 K / (pi horizon^4).
    formula = np.sqrt(2.0 / (18.0 * (2.0 / 3.0) / (np.pi * 3.015**4) / length).sum())
    return statistics.median(found), 2.0 / w / formula


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
        speed, step = motion(given["n"], given["steps"], body)
        print(f"{name:36} {speed / 1e6:6.2f} million particle-steps a second, time step {step:.2f} of the formula")
    for name, style in STYLES.items():
        speed = lammps(given["n"], given["steps"], style)
        print(f"{name:36} {'not installed' if speed is None else f'{speed / 1e6:6.2f}'}")


if __name__ == "__main__":
    main()
