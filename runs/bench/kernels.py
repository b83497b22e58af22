"""Particles that a core evaluates in a second: python runs/bench/kernels.py [n=48] [dim=3] [horizon=3.015] [json=].

Internal forces and products of the tangent with a displacement on a lattice of n^dim particles, on one core, fastest of
seven. The bodies are those that people time explicit codes with, bonds and linear correspondence, and the others beside
them. Another checkout, also one from before there were terms: PYTHONPATH=OTHER python runs/bench/kernels.py
"""

import dataclasses
import importlib
import json
import sys
import time
from pathlib import Path

import numpy as np
import petsc4py

petsc4py.init(["bench"])

import pdpetsc as pd
from pdpetsc.discrete.communicator import world

REPEATS = 7
CONTROL = "control" if "control" in {field.name for field in dataclasses.fields(pd.Case)} else "stabilisation"
SUB_HORIZONS = pd.choose("scheme", "sub_horizons", pd.SCHEMES)
PLAIN = {"scheme": pd.choose("scheme", "correspondence", pd.SCHEMES), CONTROL: pd.Silling(0.5)}
BODIES = {
    "bonds, small": {"material": pd.BondBased(1.0)},
    "bonds, finite": {"material": pd.BondBased(1.0, kinematics="finite")},
    "correspondence, linear": {"material": pd.LinearElastic(1.0, 0.3), **PLAIN},
    "correspondence, Hencky": {"material": pd.Hencky(1.0, 0.3), **PLAIN},
    "sub-horizons, linear": {"material": pd.LinearElastic(1.0, 0.3), "scheme": SUB_HORIZONS},
    "sub-horizons, Hencky": {"material": pd.Hencky(1.0, 0.3), "scheme": SUB_HORIZONS},
}


def calls(case):
    """Return what computes internal forces at a displacement, and the product of the tangent at rest with one."""
    try:
        from pdpetsc.running.build import make_cloud, make_families, make_problem

        cloud = make_cloud(world(), case)
        problem = make_problem(case, cloud, make_families(case, cloud))
    except ImportError:
        from pdpetsc.discrete.families import find_families

        # A module that only a checkout from before there were terms has.
        older = importlib.import_module("pdpetsc.build")
        cloud = older.make_cloud(world(), case)
        model = older.make_model(case, cloud, find_families(cloud))
        return model.internal_force, model.linearised(np.zeros((cloud.n_owned, cloud.dim)))
    rest = problem.state(np.zeros((cloud.n_rows, cloud.dim)))
    problem.internal_force(rest)
    tangent = problem.linearised(rest)
    return lambda u: problem.internal_force(problem.state(u)), tangent


def fastest(call, displacements):
    """Return the least time of a call, each with another displacement than the one before."""
    spent = []
    for number in range(REPEATS + 1):
        u = displacements[number % 2]
        before = time.perf_counter()
        call(u)
        spent.append(time.perf_counter() - before)
    return min(spent[1:])


def main(n=48, dim=3, horizon=3.015):
    rng, found = np.random.default_rng(0), {}
    displacements = [rng.uniform(-1e-3, 1e-3, (n**dim, dim)) for _ in range(2)]
    for name, body in BODIES.items():
        case = pd.Case(particles=pd.Lattice([0.0] * dim, [float(n)] * dim, 1.0), horizon=horizon, conditions=[], **body)
        force, product = calls(case)
        found[name] = [n**dim / fastest(call, displacements) / 1e6 for call in (force, product)]
        print(f"{name:24} forces {found[name][0]:6.2f}, tangent {found[name][1]:6.2f} million particles a second")
    return found


if __name__ == "__main__":
    given = dict(word.split("=", 1) for word in sys.argv[1:])
    out = given.pop("json", "")
    numbers = main(**{name: float(value) if name == "horizon" else int(value) for name, value in given.items()})
    if out:
        Path(out).write_text(json.dumps(numbers))
