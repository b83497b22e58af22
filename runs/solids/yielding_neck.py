"""Bar in plane strain pulled until it necks, with zero-energy controls that yield with it and that do not.

A quarter of a bar of 6 x 2 mm between grips that neither turn nor contract; J2 plasticity whose yield stress and slope
are 1 N/mm2, so that the pull falls beyond a strain of about 13 %. ``method`` is ``elastic``, Silling's control with the
elastic stiffness, ``following``, the same control yielding with the material, ``sub_horizons``, or ``none``, without
control. Against finite elements (``yielding_elements.py``): the largest pull, the pull at the end and how much the bar
has thinned at its middle; errors are relative. Units mm, N.
"""

import json
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

import pdpetsc as pd

LENGTH, WIDTH, PULL = 3.0, 1.0, 0.95
E, NU, YIELD, HARDENING = 200.0, 0.3, 1.0, 1.0
METHODS = {
    "elastic": (pd.Correspondence(), pd.Silling()),
    "following": (pd.Correspondence(), pd.TangentScaled(pd.Silling())),
    "sub_horizons": (pd.SubHorizons(), None),
    "none": (pd.Correspondence(), None),
}
STORE = Path(__file__).with_name("yielding_elements.json")


@lru_cache
def reference(body):
    """Return what the finite elements say of a body."""
    return json.loads(STORE.read_text())[body]


@dataclass(frozen=True)
class Thinning(pd.Quantity):
    """How much the half width at x = 0 has fallen, from the two layers on either side of the edge [length].

    The particles sit half a spacing inside of the edge and of the middle, and a displacement that is even along the bar
    and nearly linear across it is continued by that.
    """

    dx: float

    def evaluate(self, solution):
        x, u = solution.x, pd.displacement(solution)[:, 1]
        column = x[:, 0] < 0.75 * self.dx
        layers = [column & (np.abs(x[:, 1] - WIDTH + (k + 0.5) * self.dx) < 0.25 * self.dx) for k in (0, 1)]
        outer, inner = (float(solution.sum(float(u[layer].sum()))) for layer in layers)
        return -(1.5 * outer - 0.5 * inner)


def case(n=8, method="following", horizon=1.515, steps=30, G=0.5, least=0.01):
    scheme, control = pd.choose("method", method, METHODS)
    if method == "elastic":
        control = pd.Silling(G)
    if method == "following":
        control = pd.TangentScaled(pd.Silling(G), least)
    dx = WIDTH / n
    # Grips as deep as families reach see no free end.
    deep = 2 * int(horizon) * dx
    grip = pd.region.Slab("x", low=LENGTH)
    history = {"pull": pd.Reaction("x", grip), "thinning": Thinning(dx)}

    def results(h):
        elements = reference("neck")
        found = {"peak": max(h["pull"]), "end": h["pull"][-1], "thinning": h["thinning"][-1]}
        return found | {f"error_{name}": value / elements[name] - 1.0 for name, value in found.items()}

    return pd.Case(
        particles=pd.Lattice((0.0, 0.0), (LENGTH + deep, WIDTH), dx),
        horizon=horizon * dx,
        material=pd.J2(E=E, nu=NU, yield_stress=YIELD, hardening=HARDENING),
        scheme=scheme,
        control=control,
        symmetry=[pd.Symmetry("x"), pd.Symmetry("y")],
        conditions=[pd.Displacement(grip, x=PULL, y=0.0)],
        steps=pd.Steps(steps),
        history=history,
        results=results,
        expect={
            "peak": pd.Expected(
                reference("neck")["peak"], relative=0.02, source="finite elements (yielding_elements.py)"
            ),
            "end": pd.Expected(reference("neck")["end"], relative=0.05, source="the same, far beyond the peak"),
        },
        fields=[pd.displacement, pd.stress, pd.plastic_strain],
        picture=pd.Picture(pd.plastic_strain, ""),
    )
