"""Bar of bond-based material in a periodic cell, pulled until no force is left: how damage localises. Units m, N.

The cell is 1 m long, its horizon h = 0.1 m; bonds snap at a critical stretch that depends on their length: ``constant``
0.01; ``decreasing`` linearly from 0.00865 for a bond without length to 0.0001 at the horizon; ``increasing`` from 0.001
to 0.01. Particles are moved by up to 1e-6 m at random, from ``seed``; with constant critical stretch one of the
shortest bonds is a millionth weaker. With more than one of ``realisations`` the results are means over the seeds that
follow. Results: ``max_force``, the largest force; ``final_displacement``, the elongation of the cell when the last bond
breaks; ``max_damage``, the largest share of broken bonds that cross one section; ``dissipated``; ``events``.
Reference: Mikes, Jirasek, Zeman, Rokos, Peerlings, section 3, Fig. 4-7.
"""

import shutil
import tempfile
from dataclasses import dataclass

import numpy as np

import pdpetsc as pd

LENGTH = 1.0
E = 100.0
PULL = 0.012


@dataclass(frozen=True)
class SectionDamage(pd.Quantity):
    """Largest share of broken ones among the bonds that cross a section between two particles."""

    n: int

    def evaluate(self, solution):
        broken, crossing = section_counts(solution.model, self.n)
        both = solution.sum(np.array([broken, crossing]))
        return float((both[0] / both[1]).max())


def section_counts(model, n):
    """Return how many broken bonds and how many bonds of this rank cross each of the n sections, each bond once."""
    failure, cloud, families = model.failure, model.cloud, model.families
    # Of the two directions of a bond, the one from the end that is named first and at home.
    once = (cloud.gid[families.centres] == failure.keys[:, 0]) & (
        (cloud.gid[families.neighbours] != failure.keys[:, 0]) | (failure.keys[:, 2] > 0)
    )
    span = np.rint(failure.length[once] * n / LENGTH).astype(int)
    start = np.rint((failure.middle[once, 0] - 0.5 * failure.length[once]) * n / LENGTH - 0.5).astype(int)
    counts = np.zeros((2, n))
    for row, chosen in zip(counts, (failure.integrity[once] == 0.0, np.ones(len(span), dtype=bool)), strict=True):
        steps = np.zeros(3 * n + 1)
        np.add.at(steps, start[chosen] + n, 1.0)
        np.add.at(steps, start[chosen] + span[chosen] + n, -1.0)
        row[:] = np.cumsum(steps)[: 3 * n].reshape(3, n).sum(axis=0)
    return counts


def case(n=100, critical="constant", realisations=1, seed=1, perturbation=1e-6, horizon=0.1, updates=0):
    dx = LENGTH / n
    rng = np.random.default_rng(seed)
    weakest = rng.integers(n) * dx
    laws = {
        "constant": pd.CriticalFunction(lambda length, middle: weakened(length, middle, weakest, dx)),
        "decreasing": pd.LinearCritical(0.00865, 0.0001, horizon),
        "increasing": pd.LinearCritical(0.001, 0.01, horizon),
    }
    x = (np.arange(n) + 0.5) * dx + perturbation * rng.uniform(-1.0, 1.0, n)

    def results(h):
        carrying = np.array(h["force"]) > 1e-9 * max(h["force"])
        found = {
            "max_force": max(h["force"]),
            "final_displacement": h["displacement"][int(np.flatnonzero(carrying)[-1]) + 1],
            "max_damage": h["section_damage"][-1],
            "dissipated": h["dissipated"][-1],
            "events": len(h["force"]) - 2,
        }
        others = [case(n, critical, 1, seed + r, perturbation, horizon, updates) for r in range(1, realisations)]
        return mean([found, *(run_aside(other) for other in others)])

    return pd.Case(
        particles=pd.Arrays(x[:, None], dx),
        horizon=horizon + 0.3 * dx,
        material=pd.BondBased(E=E, calibration="lattice"),
        damage=pd.Brittle(pd.choose("critical", critical, laws)),
        cell=pd.Cell(0.0, LENGTH),
        conditions=[pd.Displacement(pd.region.Nearest((0.5 * dx,)), x=0.0), pd.MeanStrain(xx=PULL)],
        solver=pd.EventDriven(updates or None),
        history={
            "displacement": pd.CellStrain("xx"),
            "force": pd.CellStress("xx"),
            "energy": pd.StrainEnergy(),
            "dissipated": pd.DissipatedEnergy(),
            "section_damage": SectionDamage(n),
        },
        results=results,
        fields=[pd.displacement, pd.local_damage],
    )


def weakened(length, middle, place, dx):
    """Return 0.01, a millionth less for the shortest bond at one place: with uniform strain all would fail at once."""
    apart = np.abs((middle[:, 0] - place + 0.5 * LENGTH) % LENGTH - 0.5 * LENGTH)
    return np.where((length < 1.5 * dx) & (apart < 0.25 * dx), 0.01 * (1.0 - 1e-6), 0.01)


def mean(runs):
    return {name: float(np.mean([found[name] for found in runs])) for name in runs[0]}


def run_aside(other):
    """Run a case into a folder that is thrown away (collective)."""
    from pdpetsc.discrete.communicator import is_root, world

    folder = world().bcast(tempfile.mkdtemp() if is_root(world()) else None)
    found = pd.run(other, output=folder, quiet=True)
    if is_root(world()):
        shutil.rmtree(folder)
    return found
