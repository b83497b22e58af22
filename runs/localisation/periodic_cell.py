"""Bar of bond-based material in a periodic cell, pulled until no force is left: how damage localises. Units m, N.

The cell is 1 m long, its horizon 0.1 m; bonds snap at a critical stretch that depends on their length: ``constant``
0.01; ``decreasing`` linearly from 0.00865 for a bond without length to 0.0001 at the horizon; ``increasing`` from 0.001
to 0.01. Particles are moved by up to 1e-6 m at random. Results: ``max_force``, the largest force; ``final_displacement``,
the elongation of the cell when the last bond breaks; ``max_damage``, the largest share of broken bonds that cross one
section; ``dissipated``; ``events``.
Reference: Mikes, Jirasek, Zeman, Rokos, Peerlings, section 3, Fig. 4-7.
"""

from dataclasses import dataclass

import numpy as np

import pdpetsc as pd

LENGTH = 1.0
HORIZON = 0.1
E = 100.0
PULL = 0.012
CRITICAL = {
    "constant": pd.ConstantCritical(0.01),
    "decreasing": pd.LinearCritical(0.00865, 0.0001, HORIZON),
    "increasing": pd.LinearCritical(0.001, 0.01, HORIZON),
}


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
    failure, cloud = model.failure, model.cloud
    once = cloud.gid[model.families.centres] == failure.keys[:, 0]
    once &= cloud.x[model.families.neighbours, 0] > cloud.x[model.families.centres, 0]
    once |= (cloud.gid[model.families.centres] == failure.keys[:, 0]) & (cloud.x[model.families.neighbours, 0] < 0.0)
    counts = np.zeros((2, n))
    spans = np.rint(failure.length * n / LENGTH).astype(int)
    starts = np.rint((failure.middle[:, 0] - 0.5 * failure.length) * n / LENGTH - 0.5).astype(int)
    for start, span, integrity in zip(starts[once], spans[once], failure.integrity[once], strict=True):
        sections = np.arange(start, start + span) % n
        np.add.at(counts[1], sections, 1.0)
        if integrity == 0.0:
            np.add.at(counts[0], sections, 1.0)
    return counts


def case(n=100, critical="constant", realisations=1, seed=1, perturbation=1e-6, updates=0):
    dx = LENGTH / n
    rng = np.random.default_rng(seed)
    x = (np.arange(n) + 0.5) * dx + perturbation * rng.uniform(-1.0, 1.0, n)
    return pd.Case(
        particles=pd.Arrays(x[:, None], dx),
        horizon=HORIZON + 0.3 * dx,
        material=pd.BondBased(E=E, calibration="lattice"),
        damage=pd.Brittle(pd.choose("critical", critical, CRITICAL)),
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
        results=lambda h: results(h, n),
        fields=[pd.displacement, pd.local_damage],
    )


def results(h, n):
    carrying = np.array(h["force"]) > 1e-9 * max(h["force"])
    last = int(np.flatnonzero(carrying)[-1]) + 1
    return {
        "max_force": max(h["force"]),
        "final_displacement": h["displacement"][last],
        "max_damage": h["section_damage"][-1],
        "dissipated": h["dissipated"][-1],
        "events": len(h["force"]) - 2,
    }
