"""What it takes to pull two rigid halves apart over the fracture energy that the bonds were given, for every model.

A square lattice, periodic across the pull, small strains: the work of the forces over area times ``Gc``. It is 1 for
bond-based materials, whose bonds the fracture energy counts; bonds with a dilatation and gradients take another share,
and ``Gc`` over it is what to declare for a plane that should take ``Gc``. python runs/fracture/separation.py

With ``damage=point`` gradient points fail by ``pd.PointDamage`` instead of bonds, with every softening curve: plane
strain, correspondence with ``Silling(2.0)``, standard weights. The strength is chosen so that the strain without stress
is 5 times that at the onset of damage, ``ratio``. python runs/fracture/separation.py damage=point
"""

import itertools
import sys

import numpy as np
from point_damage import CURVES, damage_of_ratio

import pdpetsc as pd
from pdpetsc.bond_based import Neighbourhood, combine
from pdpetsc.damage.criterion import DamageableBonds
from pdpetsc.damage.point_damage import AssignedPointDamage
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
from pdpetsc.terms.degraded_points import DegradedControl, DegradedPoints

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
    body, bonds, one = halves(horizon, dx)
    cloud, families = body.cloud, body.families
    k = combine(bonds, [pd.BondBased(E, calibration="lattice")], one, np.ones(cloud.n_owned)).k
    damageable = DamageableBonds.of(cloud, families, bonds.omega, k, scheme is not None)
    damage = make_damage(LAWS[law](criterion(Gc=GC)), body, damageable)
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
    openings = np.linspace(0.0, 1.5 * horizon * (damage.bonds.laws.final() * damage.limit).max(), steps)
    return work_and_rest(problem, opened(body), openings, dx)


def share_of_points(curve, ratio=5.0, horizon=3.015, steps=301, dx=0.5, G=2.0):
    """Return the work over area and ``Gc`` of points that fail by a curve, and what force is left at the end."""
    # Wide enough that the families that the plane cuts reach no side of the body.
    body, bonds, one = halves(horizon, dx, (4 * int(horizon), SIDES[1]))
    materials, control = [pd.LinearElastic(E, 0.25)], pd.Silling(G)
    built = control.build(body.cloud, body.families, bonds.omega, stiffness_of(body, materials, one, None))
    operator = pd.Correspondence().build(body.cloud, body.families, bonds.omega)
    law = damage_of_ratio(curve, materials[0], GC, ratio, horizon * dx, dx)
    laws = AssignedPointDamage([law], np.zeros(body.cloud.n_owned, dtype=np.int64))
    term = DegradedPoints(body, operator, materials, one, None, laws, built)
    problem = Problem(body, term, [DegradedControl(body, type(control).__name__, built, term)], Supports(body), term)
    # Drives are proportional to the opening: from the first onset to the last point that fails.
    apart = opened(body)
    x = term.driven(State(body, apart)).x
    cut = x > 1e-9 * x.max()
    openings = np.geomspace(1.0 / x.max(), 1.01 * (term.points.final[cut] / x[cut]).max(), steps)
    return work_and_rest(problem, apart, np.concatenate([[0.0], openings]), dx)


def halves(horizon, dx, sides=SIDES):
    """Return a square lattice that is periodic across the pull, its bonds, and the material of each particle."""
    x = dx * (np.array(list(itertools.product(*map(range, sides)))) + 0.5)
    cell = pd.Cell((0.0, 0.0), dx * np.array(sides), axes="y")
    cloud = distribute(world(), x, np.full(len(x), dx**2), {}, horizon * dx, cell)
    families, one = find_families(cloud), np.zeros(cloud.n_owned, dtype=np.int32)
    length = np.linalg.norm(families.bonds(cloud.x), axis=1)
    bonds = Neighbourhood(cloud, families, np.ones(len(length)), pd.influence.Constant(), 1.0)
    return Body(cloud, families), bonds, one


def opened(body):
    """Return displacements (n_rows, 2) of the right half away from the left one by a unit [length]."""
    u, x = np.zeros((body.cloud.n_rows, 2)), body.cloud.x[: body.cloud.n_owned, 0]
    u[: body.cloud.n_owned][x > x.mean(), 0] = 1.0
    return u


def work_and_rest(problem, apart, openings, dx):
    """Return the work over area and ``Gc`` at openings (n,) [length] of unit displacements, and what pull is left."""
    body, pull = problem.body, np.zeros(len(openings))
    right = apart[: body.cloud.n_owned, 0] > 0.0
    for step, opening in enumerate(openings):
        state = State(body, opening * apart)
        while problem.break_bonds(state, 10**6):
            state = State(body, opening * apart)
        f = np.zeros((body.cloud.n_local, 2))
        for term in problem.terms:
            term.add_force(state, f)
        pull[step] = body.gather(f)[: body.cloud.n_owned][right, 0].sum()
        problem.soften(state)
    work = 0.5 * ((pull[1:] + pull[:-1]) * np.diff(openings)).sum()
    return work / (dx * SIDES[1] * GC), abs(pull[-1]) / pull.max()


if __name__ == "__main__":
    if "damage=point" in sys.argv[1:]:
        print(f"| horizon / dx | {' | '.join(CURVES)} |")
        for horizon in (2.015, 3.015, 4.015):
            found = [share_of_points(curve, horizon=horizon)[0] for curve in CURVES]
            print(f"| {horizon} | {' | '.join(f'{work:.3f}' for work in found)} |")
        sys.exit()
    for name, criterion in (("FractureEnergy", pd.FractureEnergy), ("BondEnergy", pd.BondEnergy)):
        print(f"| {name} | {' | '.join(LAWS)} |")
        for model in MODELS:
            print(f"| {model} | {' | '.join(f'{share(model, law, criterion)[0]:.2f}' for law in LAWS)} |", flush=True)
