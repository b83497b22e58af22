"""What it takes to pull two rigid halves apart over the fracture energy that the bonds were given, for every model.

A square lattice, periodic across the pull, small strains: the work of the forces over area times ``Gc``. It is 1 for
bond-based materials, whose bonds the fracture energy counts; bonds with a dilatation and gradients take another share,
and ``Gc`` over it is what to declare for a plane that should take ``Gc``. python runs/fracture/separation.py
"""

import itertools

import numpy as np

import pdpetsc as pd
from pdpetsc.bond_based import Neighbourhood, combine
from pdpetsc.discrete.cloud import distribute
from pdpetsc.discrete.communicator import world
from pdpetsc.discrete.families import find_families
from pdpetsc.problem.body import Body
from pdpetsc.problem.damage import make_damage
from pdpetsc.problem.problem import Problem
from pdpetsc.problem.state import State
from pdpetsc.problem.supports import Supports
from pdpetsc.terms.bond_forces import BondForces
from pdpetsc.terms.control import ControlForces, stiffness_of
from pdpetsc.terms.damaged_points import DamagedPoints

E, GC, SIDES = 10.0, 1e-4, (12, 10)
LAWS = {
    "snap": pd.Brittle,
    "linear": pd.LinearSoftening,
    "exponential": pd.ExponentialSoftening,
    "bilinear": pd.BilinearSoftening,
    "smooth": pd.SmoothDegradation,
}
MODELS = {
    "bond-based": (pd.BondBased(E, calibration="lattice"), None, None),
    "linear solid, nu = 0.1": (pd.LinearSolid(E, 0.1), None, None),
    "linear solid, nu = 0.25": (pd.LinearSolid(E, 0.25), None, None),
    "linear solid, nu = 0.4": (pd.LinearSolid(E, 0.4), None, None),
    "correspondence": (pd.LinearElastic(E, 0.25), pd.Correspondence(), None),
    "correspondence, Silling 0.5": (pd.LinearElastic(E, 0.25), pd.Correspondence(), pd.Silling(0.5)),
    "sub-horizons": (pd.LinearElastic(E, 0.25), pd.SubHorizons(), None),
}


def share(model, law, criterion=pd.FractureEnergy, horizon=3.015, steps=301, dx=0.5):
    """Return the work over area and ``Gc`` of a model and a law by name, and what force is left at the end."""
    material, scheme, control = MODELS[model]
    x = dx * (np.array(list(itertools.product(*map(range, SIDES)))) + 0.5)
    cloud = distribute(
        world(), x, np.full(len(x), dx**2), {}, horizon * dx, pd.Cell((0.0, 0.0), dx * np.array(SIDES), axes="y")
    )
    families, one = find_families(cloud), np.zeros(cloud.n_owned, dtype=np.int32)
    length = np.linalg.norm(families.bonds(cloud.x), axis=1)
    bonds = Neighbourhood(cloud, families, np.ones(len(length)), length, pd.influence.Constant(), 1.0)
    body = Body(cloud, families)
    k = combine(bonds, [pd.BondBased(E, calibration="lattice")], one, np.ones(cloud.n_owned)).k
    damage = make_damage(LAWS[law](criterion(Gc=GC)), body, bonds.omega, k, scheme is not None)
    if scheme is None:
        material_term = BondForces(body, bonds, [material], one)
        material_term.take_damage(damage)
        terms = [material_term]
    else:
        terms = [DamagedPoints(body, bonds.omega, scheme, [material], one, None, damage)]
    if control is not None:
        built = control.build(cloud, families, bonds.omega, stiffness_of(body, [material], one, None))
        terms.append(ControlForces(body, type(control).__name__, built, damage))
    problem = Problem(body, terms[0], terms[1:], Supports(body), damage)
    right = cloud.x[: cloud.n_owned, 0] > 0.5 * dx * SIDES[0]
    apart = np.linspace(0.0, 1.5 * horizon * (damage.bonds.laws.final() * damage.limit).max(), steps)
    pull = np.zeros(steps)
    for step, opening in enumerate(apart):
        u = np.zeros((cloud.n_rows, 2))
        u[: cloud.n_owned][right, 0] = opening
        state = State(body, u)
        while problem.break_bonds(state, 10**6):
            state = State(body, u)
        f = np.zeros((cloud.n_local, 2))
        for term in terms:
            term.add_force(state, f)
        pull[step] = body.gather(f)[: cloud.n_owned][right, 0].sum()
        problem.soften(state)
    work = 0.5 * ((pull[1:] + pull[:-1]) * np.diff(apart)).sum()
    return work / (dx * SIDES[1] * GC), abs(pull[-1]) / pull.max()


if __name__ == "__main__":
    for name, criterion in (("FractureEnergy", pd.FractureEnergy), ("BondEnergy", pd.BondEnergy)):
        print(f"| {name} | {' | '.join(LAWS)} |")
        for model in MODELS:
            print(f"| {model} | {' | '.join(f'{share(model, law, criterion)[0]:.2f}' for law in LAWS)} |", flush=True)
