"""Stiff fibre in a matrix pulled across it: the weak interface debonds from the poles. Units mm, N.

Square of side 20 with a fibre of radius 5 in its middle, plane strain, E = 4 and 40 GPa; fracture energies of matrix
and fibre 0.5 N / mm, of the interface ``Gc``. With ``model="bonds"`` bond-based, with ``"gradients"`` deformation
gradients with Silling's control.
Results: ``stiffness``, force over pull in the first step; ``debonding_stress`` over the section, after which the force
falls for the first time; ``first_angle``, the largest one with the pull of the bonds that break first; ``debonded``,
that of all of the interface [degrees]; ``at_interface``, their share in all that break.

With ``damage=point`` gradient points of the second model fail by linear softening (``pd.PointDamage``): those within a
horizon of the interface take ``Gc``, all others 0.5 N / mm, both with the strain without stress three times that at the
onset. Results: ``stiffness`` and ``debonding_stress`` as above, ``debonded``, the largest angle of a point of the
interface that has lost nine tenths, and ``at_interface``, the share of the dissipated energy there.
"""

from dataclasses import dataclass

import numpy as np

import pdpetsc as pd

SIDE, RADIUS = 20.0, 5.0
E_MATRIX, E_FIBRE, TOUGH = 4000.0, 40000.0, 0.5
FIBRE = pd.region.Sphere((0.0, 0.0), RADIUS)


@dataclass(frozen=True)
class Debonded(pd.Quantity):
    """Of pairs that have lost their bond their number, that of fibre and matrix, or the largest angle of the latter."""

    what: str

    def evaluate(self, solution):
        damage = solution.problem.damage
        i, j = damage.body.families.centres, damage.body.families.neighbours
        x = damage.body.cloud.x
        inside = np.hypot(*x.T) <= RADIUS
        lost = ~damage.bonds.intact
        across = lost & (inside[i] != inside[j])
        if self.what == "angle":
            middle = damage.bonds.of.middle(across)
            angle = np.degrees(np.arctan2(np.abs(middle[:, 1]), np.abs(middle[:, 0])))
            return solution.largest(float(angle.max(initial=0.0)))
        return float(solution.sum(np.count_nonzero(across if self.what == "interface" else lost))) / 2.0


@dataclass(frozen=True)
class OfPoints(pd.Quantity):
    """Largest angle of a point within ``near`` of the interface that has lost nine tenths, or the energy there."""

    what: str
    near: float

    def evaluate(self, solution):
        here = np.abs(np.hypot(*solution.x.T) - RADIUS) < self.near
        if self.what == "energy":
            return solution.sum(float((pd.damage_dissipation(solution) * solution.volume)[here].sum()))
        lost = here & (pd.local_damage(solution) > 0.9)
        angle = np.degrees(np.arctan2(np.abs(solution.x[lost, 1]), np.abs(solution.x[lost, 0])))
        return solution.largest(float(angle.max(initial=0.0)))


def of_points(delta, Gc, width, protected):
    """Return damage of gradient points that take ``Gc`` within a horizon of the interface, in families of a width."""

    def energy(x, normal=None):
        return np.where(np.abs(np.hypot(*x.T) - RADIUS) < delta, Gc, TOUGH)

    def strength(x):
        E = np.where(np.hypot(*x.T) <= RADIUS, E_FIBRE, E_MATRIX)
        return np.sqrt(2.0 * E * energy(x) / (3.0 * width))

    return pd.PointDamage(pd.softening.Linear(), Gc=energy, strength=strength, protected=protected)


def case(n=20, horizon=2.015, Gc=0.02, model="bonds", pull=0.06, steps=12, damage="bonds"):
    points = pd.choose("damage", damage, {"bonds": False, "point": True})
    dx = SIDE / n
    half = 0.5 * SIDE
    left, right = pd.region.Slab("x", high=-half + 2.0 * dx), pd.region.Slab("x", low=half - 2.0 * dx)

    def law(energy):
        return pd.LinearSoftening(pd.FractureEnergy(energy), 3.0)

    made = {
        "bonds": lambda E: pd.BondBased(E=E, calibration="lattice"),
        "gradients": lambda E: pd.Hencky(E=E, nu=0.25),
    }["gradients" if points else pd.choose("model", model, {"bonds": "bonds", "gradients": "gradients"})]
    gradients = {"scheme": pd.Correspondence(), "control": pd.Silling(0.5)} if points or model == "gradients" else {}
    grips, delta = left | right, horizon * dx

    def results(h):
        falls = np.flatnonzero(np.diff(h["force"]) < 0.0)
        common = {
            "stiffness": h["force"][1] / (pull * h["t"][1]),
            "debonding_stress": h["force"][falls[0] if len(falls) else -1] / SIDE,
            "debonded": h["angle"][-1],
        }
        if points:
            return {**common, "at_interface": h["interface"][-1] / max(h["dissipated"][-1], 1e-300)}
        begun = next((angle for angle, count in zip(h["angle"], h["broken"], strict=True) if count > 0.0), float("nan"))
        return {
            **common,
            "first_angle": begun,
            "at_interface": h["interface"][-1] / max(h["broken"][-1], 1.0),
        }

    return pd.Case(
        particles=pd.Lattice((-half, -half), (half, half), dx),
        horizon=delta,
        material=[(FIBRE, made(E_FIBRE)), (~FIBRE, made(E_MATRIX))],
        **gradients,
        damage=of_points(delta, Gc, 2.0 * int(horizon) * dx, grips)
        if points
        else pd.DamageOf(
            {"fibre": FIBRE, "matrix": ~FIBRE},
            {"fibre": law(TOUGH), "matrix": law(TOUGH), ("fibre", "matrix"): law(Gc)},
            protected=grips,
        ),
        conditions=[
            pd.Displacement(left, x=-0.5 * pull, y=0.0),
            pd.Displacement(right, x=0.5 * pull, y=0.0),
        ],
        steps=pd.Steps(steps),
        history={
            "force": pd.Reaction("x", right),
            **(
                {"interface": OfPoints("energy", delta), "angle": OfPoints("angle", delta)}
                if points
                else {
                    "broken": Debonded("all"),
                    "interface": Debonded("interface"),
                    "angle": Debonded("angle"),
                }
            ),
            "dissipated": pd.DissipatedEnergy(),
            "work": pd.ExternalWork(),
        },
        results=results,
        # The grips are as deep as two spacings, and finite elements know those of one.
        expect={
            "stiffness": pd.Expected(7612.0, relative=0.08, source="finite elements (interface_elements.py)"),
            "at_interface": pd.Expected(
                1.0, absolute=0.05 if points else 0.0, source="the interface is 25 times as weak as what it joins"
            ),
        }
        if n == 20 and Gc <= TOUGH / 25.0
        else {},
        fields=[pd.displacement, pd.local_damage],
        picture=pd.Picture(pd.local_damage, "", 20.0),
    )
