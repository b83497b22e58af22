"""Square periodic cell of bond-based material in plane stress, pulled along x with the other mean stresses zero.

As the periodic cell of a bar, in two dimensions: ``critical`` is constant, decreasing or increasing with the length of
the bond, particles are moved by up to ``perturbation`` spacings at random. Units mm, N, MPa. ``ratio`` above 1 lets
bonds soften to that many times their critical stretch instead of snapping. Results: ``max_stress``;
``fracture_energy``, what has been dissipated per section of the cell [N / mm]; ``broken_bonds``, the share of all;
``events``.
"""

import numpy as np

import pdpetsc as pd

E = 1000.0
STRETCH = 0.01
PULL = 0.05


class BrokenShare(pd.Quantity):
    """Share of the bonds that are broken."""

    def evaluate(self, solution):
        phi = solution.problem.damage.bonds.phi
        broken, every = solution.sum([float((phi == 0.0).sum()), float(len(phi))])
        return broken / every


def case(n=12, size=1.0, horizon=2.015, critical="constant", ratio=1.0, perturbation=1e-3, seed=1, updates=0):
    dx = size / n
    laws = {
        "constant": pd.ConstantCritical(STRETCH),
        "decreasing": pd.LinearCritical(STRETCH, 0.1 * STRETCH, horizon * dx),
        "increasing": pd.LinearCritical(0.1 * STRETCH, STRETCH, horizon * dx),
    }
    chosen = pd.choose("critical", critical, laws)
    rng = np.random.default_rng(seed)
    grid = np.stack(np.meshgrid(*[(np.arange(n) + 0.5) * dx] * 2, indexing="ij"), axis=-1).reshape(-1, 2)
    return pd.Case(
        particles=pd.Arrays(grid + perturbation * dx * rng.uniform(-1.0, 1.0, grid.shape), dx**2),
        horizon=(horizon + 2.0 * perturbation) * dx,
        material=pd.BondBased(E=E, plane="stress", calibration="lattice"),
        damage=pd.Brittle(chosen) if ratio == 1.0 else pd.LinearSoftening(chosen, ratio),
        cell=pd.Cell((0.0, 0.0), (size, size)),
        conditions=[pd.Displacement(pd.region.Nearest((0.5 * dx, 0.5 * dx)), x=0.0, y=0.0), pd.MeanStrain(xx=PULL)],
        solver=pd.EventDriven(updates or None),
        history={
            "strain": pd.CellStrain("xx"),
            "stress": pd.CellStress("xx"),
            "energy": pd.StrainEnergy(),
            "dissipated": pd.DissipatedEnergy(),
            "broken": BrokenShare(),
        },
        results=lambda h: {
            "max_stress": max(h["stress"]),
            "fracture_energy": h["dissipated"][-1] / size,
            "broken_bonds": h["broken"][-1],
            "events": len(h["stress"]) - 2,
        },
        fields=[pd.displacement, pd.local_damage],
        picture=pd.Picture(pd.local_damage, ""),
    )
