"""Concrete panel in the shape of an L, pushed up at its end: a crack from the corner turns. Units mm, N.

500 x 500, legs 250 wide, 100 thick, held at the foot, E = 25.85 GPa, strength 2.7 MPa, fracture energy 0.065 N / mm
(Winkler 2001; the tests reach some 7 kN at about 0.25 mm). Bond-based, plane stress, bilinear softening, followed by
the displacement of the loaded point. With a ``scheme`` the material has deformation gradients, linear elastic with a
Poisson ratio of 0.18, ``weights`` and Silling's control of strength ``G``.
With ``shake`` the particles inside leave the lattice by up to so many spacings, whose rows else lead the crack.
Results: ``peak_load``, ``peak_displacement``, ``rise``, the angle of the crack with the horizontal [degrees] from the
broken bonds, ``last_load`` over the peak.
With ``damage=point`` the gradient points of that material fail (``pd.PointDamage``) by the same curve, strength and
fracture energy, with correspondence, standard weights and ``Silling(G)``; ``rise`` is that of the failed points.
"""

from dataclasses import dataclass

import concrete
import numpy as np

import pdpetsc as pd

SIDE, LEG, THICKNESS = 500.0, 250.0, 100.0
E, NU, STRENGTH, GF = 25.85e3, 0.18, 2.7, 0.065


@dataclass(frozen=True)
class Rise(pd.Quantity):
    """Angle of the line from the corner to the middle of what has lost a share of its bonds or points [degrees]."""

    share: float

    def evaluate(self, solution):
        x = solution.x - [LEG, LEG]
        damaged = pd.local_damage(solution) > self.share
        sums = solution.sum(np.array([*x[damaged].sum(axis=0), damaged.sum()]))
        return float(np.degrees(np.arctan2(sums[1], -sums[0]))) if sums[2] else float("nan")


def particles(dx, shake, seed):
    """Return a lattice whose particles inside are moved by up to ``shake`` spacings at random."""
    at = dx * (np.arange(round(SIDE / dx)) + 0.5)
    x = np.array([(a, b) for a in at for b in at if a < LEG or b > LEG])
    move = np.random.default_rng(seed).uniform(-shake, shake, x.shape) * dx
    outer = (x.min(axis=1) < dx) | (x.max(axis=1) > SIDE - dx)
    inner = (x[:, 0] > LEG - dx) & (x[:, 1] < LEG + dx)
    x += np.where((outer | inner)[:, None], 0.0, move)
    return pd.Arrays(x, np.full(len(x), dx**2 * THICKNESS), thickness=THICKNESS)


def case(
    n=25, horizon=3.015, step=0.02, end=0.9, shake=0.0, seed=1, scheme="", weights="standard", G=0.5,
    damage="bonds",
):  # fmt: skip
    dx = LEG / n
    delta = horizon * dx
    foot = pd.region.Slab("y", high=delta)
    loaded = pd.region.Box((SIDE - 30.0 - 1.5 * dx, LEG), (SIDE - 30.0 + 1.5 * dx, LEG + 1.5 * dx))
    around = pd.region.Box((SIDE - 30.0 - 2.0 * delta, LEG), (SIDE, LEG + 3.0 * delta))
    load = 10e3
    points = pd.choose("damage", damage, {"bonds": False, "point": True})

    def results(h):
        found, peak = concrete.at_peak(h["t"], load)
        return {
            **found,
            "peak_displacement": h["displacement"][peak],
            **({"rise": h["rise"][-1]} if np.isfinite(h["rise"][-1]) else {}),
            **({} if points else {"broken_bonds": h["broken"][-1]}),
        }

    held = foot | around
    model = {"material": pd.BondBased(E=E, plane="stress", calibration="family")}
    if scheme:
        model = {
            "material": pd.LinearElastic(E=E, nu=NU, plane="stress"),
            "scheme": pd.choose("scheme", scheme, pd.SCHEMES),
            "weights": pd.choose("weights", weights, pd.WEIGHTS),
            "control": pd.Silling(G) if G else None,
        }
    model["damage"] = concrete.bilinear(E, STRENGTH, GF, delta, protected=held)
    if points:
        model = concrete.of_points(E, NU, STRENGTH, GF, G, pd.softening.Bilinear(), held)
    return pd.Case(
        particles=particles(dx, shake, seed),
        horizon=delta,
        **model,
        conditions=[pd.Displacement(foot, x=0.0, y=0.0), pd.Force(loaded, y=load)],
        solver=pd.PathFollowing(pd.Opening("y", loaded, step=step, end=end), until=0.02),
        history={
            "displacement": pd.Mean(pd.displacement, "y", loaded),
            "rise": Rise(0.9 if points else 0.3),
            "dissipated": pd.DissipatedEnergy(),
            "work": pd.ExternalWork(),
            **(
                {"stored": pd.StrainEnergy(), "control": pd.ControlEnergy()} if points else {"broken": pd.BrokenBonds()}
            ),
        },
        results=results,
        fields=[pd.displacement, pd.local_damage],
        picture=pd.Picture(pd.local_damage, "", 100.0),
    )
