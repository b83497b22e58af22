"""Bar of bond-based material in a periodic cell, pulled until no force is left: how damage localises. Units m, N.

The cell is 1 m long, its horizon h = 0.1 m. Bonds snap at a critical strain that is linear in their length, from
``start`` for a bond without length to ``end`` at the horizon. ``critical`` names both: ``constant`` 0.01;
``decreasing`` from 0.01 to 0.0001; ``increasing`` from 0.0001 to 0.01. The paper states the largest value, 0.01; the
least follows from the force 0.01e-2 E A at which the longest bonds fail in its figure 6, about 0.9 times that value.

With ``ratio`` above 1 bonds soften to that many times their critical strain instead of snapping. ``micromodulus`` is
how the stiffness E A / length of a bond depends on its length besides: ``constant`` as in the paper, ``linear``,
``cubic`` or ``gaussian``, which end 0.3 spacings beyond the horizon; the cell always has the stiffness E A / l.

Particles are moved by up to ``perturbation`` at random, from ``seed``, before lengths, stiffness and critical strains
are computed. Bonds of equal force pull each to both sides, so that uniform strain stays an equilibrium wherever they
are, and with a constant critical strain all bonds would fail at once: one of the shortest is a millionth weaker then.

With more than one of ``realisations`` the results are means over the seeds that follow. Results: ``max_force``, the
largest force; ``final_displacement``, the elongation of the cell when the last bond breaks; ``max_damage``, the largest
share of broken bonds among those that cross one section; ``opened`` and ``closed``, how many gaps between neighbouring
particles have opened or closed in the end; ``dissipated``; ``broken``, how many bonds are broken; ``events``.
Reference: Mikes, Jirasek, Zeman, Rokos, Peerlings, section 3, Fig. 2 and 4-7; softening and micromoduli: section 4.
"""

import shutil
import tempfile
from dataclasses import dataclass

import numpy as np

import pdpetsc as pd

LENGTH = 1.0
E = 100.0
# Mean strain at the end of the load, over the ratio; the largest elongation at which a bond holds is 0.01 of it.
PULL = 0.012
# Critical strain of a bond without length and of one as long as the horizon.
LAWS = {"constant": (0.01, 0.01), "decreasing": (0.01, 0.0001), "increasing": (0.0001, 0.01)}
MICROMODULI = {
    "constant": pd.influence.Constant(),
    "linear": pd.influence.Linear(),
    "cubic": pd.influence.Cubic(),
    "gaussian": pd.influence.Gaussian(),
}


@dataclass(frozen=True)
class SectionDamage(pd.Quantity):
    """Largest share of broken ones among the bonds that cross a section between two particles, Eq. (8)."""

    n: int

    def evaluate(self, solution):
        broken, crossing = section_counts(solution.problem, self.n)
        both = solution.sum(np.array([broken, crossing]))
        return float((both[0] / both[1]).max())


@dataclass(frozen=True)
class Gaps(pd.Quantity):
    """How many gaps between neighbouring particles open (sign 1) or close (-1) by over half the cell's elongation."""

    n: int
    sign: float

    def evaluate(self, solution):
        x, u = solution.cloud.x[: len(solution.u), 0], np.zeros(self.n)
        u[np.rint(x * self.n / LENGTH - 0.5).astype(int)] = solution.u[:, 0]
        u = solution.sum(u)
        elongation = solution.cell_strain[0, 0] * LENGTH
        opening = np.diff(u, append=u[0] + elongation)
        return float(np.count_nonzero(self.sign * opening > 0.5 * elongation)) if elongation > 0.0 else 0.0


@dataclass(frozen=True)
class BrokenLinks(pd.Quantity):
    """How many bonds are broken."""

    def evaluate(self, solution):
        # Each is in the family of both of its ends.
        return float(solution.sum(np.count_nonzero(solution.problem.damage.bonds.phi == 0.0)) // 2)


def section_counts(problem, n):
    """Return how many broken bonds and how many bonds of this rank cross each of the n sections, each bond once."""
    failure, cloud, families = problem.damage.bonds, problem.body.cloud, problem.body.families
    # Of the two directions of a bond, the one from the end that is named first and at home.
    first, _, place = failure.of.keys().T
    once = (cloud.gid[families.centres] == first) & ((cloud.gid[families.neighbours] != first) | (place > 0))
    span = np.rint(failure.length[once] * n / LENGTH).astype(int)
    start = np.rint((failure.of.middle(once)[:, 0] - 0.5 * failure.length[once]) * n / LENGTH - 0.5).astype(int)
    counts = np.zeros((2, n))
    for row, chosen in zip(counts, (failure.phi[once] == 0.0, np.ones(len(span), dtype=bool)), strict=True):
        steps = np.zeros(3 * n + 1)
        np.add.at(steps, start[chosen] + n, 1.0)
        np.add.at(steps, start[chosen] + span[chosen] + n, -1.0)
        row[:] = np.cumsum(steps)[: 3 * n].reshape(3, n).sum(axis=0)
    return counts


def case(
    n=100,
    critical="constant",
    start=None,
    end=None,
    ratio=1.0,
    micromodulus="constant",
    realisations=1,
    seed=1,
    perturbation=1e-6,
    horizon=0.1,
    updates=0,
):
    dx = LENGTH / n
    rng = np.random.default_rng(seed)
    weakest = rng.integers(n) * dx
    ends = pd.choose("critical", critical, LAWS)
    first, last = (given if named is None else named for named, given in zip((start, end), ends, strict=True))
    law = pd.LinearCritical(first, last, horizon)
    if first == last:
        law = pd.CriticalFunction(lambda length, middle: weakened(length, middle, weakest, dx, first))
    x = (np.arange(n) + 0.5) * dx + perturbation * rng.uniform(-1.0, 1.0, n)

    def again(seed):
        return case(n, critical, start, end, ratio, micromodulus, 1, seed, perturbation, horizon, updates)

    def results(h):
        carrying = np.array(h["force"]) > 1e-9 * max(h["force"])
        found = {
            "max_force": max(h["force"]),
            "final_displacement": h["displacement"][int(np.flatnonzero(carrying)[-1]) + 1],
            "max_damage": h["section_damage"][-1],
            "opened": h["opened"][-1],
            "closed": h["closed"][-1],
            "dissipated": h["dissipated"][-1],
            "broken": h["broken"][-1],
            "events": len(h["force"]) - 2,
        }
        return mean([found, *(run_aside(again(seed + r)) for r in range(1, realisations))])

    return pd.Case(
        particles=pd.Arrays(x[:, None], dx),
        horizon=horizon + 0.3 * dx,
        influence=pd.choose("micromodulus", micromodulus, MICROMODULI),
        material=pd.BondBased(E=E, calibration="lattice"),
        damage=pd.Brittle(law) if ratio == 1.0 else pd.LinearSoftening(law, ratio),
        cell=pd.Cell(0.0, LENGTH),
        conditions=[pd.Displacement(pd.region.Nearest((0.5 * dx,)), x=0.0), pd.MeanStrain(xx=PULL * ratio)],
        solver=pd.EventDriven(updates or None),
        history={
            "displacement": pd.CellStrain("xx"),
            "force": pd.CellStress("xx"),
            "energy": pd.StrainEnergy(),
            "dissipated": pd.DissipatedEnergy(),
            "section_damage": SectionDamage(n),
            "opened": Gaps(n, 1.0),
            "closed": Gaps(n, -1.0),
            "broken": BrokenLinks(),
        },
        results=results,
        fields=[pd.displacement, pd.local_damage],
    )


def weakened(length, middle, place, dx, critical):
    """Return the critical strain, a millionth less for the shortest bond at one place."""
    apart = np.abs((middle[:, 0] - place + 0.5 * LENGTH) % LENGTH - 0.5 * LENGTH)
    return np.where((length < 1.5 * dx) & (apart < 0.25 * dx), critical * (1.0 - 1e-6), critical)


def mean(runs):
    return {name: float(np.mean([found[name] for found in runs])) for name in runs[0]}


def run_aside(other):
    """Run a case into a folder that is thrown away (collective)."""
    from pdpetsc.discrete.communicator import is_root, world

    folder = world().bcast(tempfile.mkdtemp() if is_root(world()) else None)
    found = pd.run(other, output=folder)
    if is_root(world()):
        shutil.rmtree(folder)
    return found
