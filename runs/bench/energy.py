"""Laws from a strain energy in one line against the same laws by hand: python runs/bench/energy.py [points].

Prints, for stress, tangent and energy at as many points (40,000), the time of the law from a text over that of the law
by hand, medians of nine pairs measured in turn. Plane stress and bars of Saint Venant-Kirchhoff and Hencky have closed
forms by hand, in whose place the text iterates.
"""

import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent))
import study

words = study.start()

import pdpetsc as pd
from pdpetsc.material.at_points import MaterialAtPoints

E, NU, REPEATS = 10.0, 0.3, 9
LAM, MU = pd.LinearElastic(E, NU).lame(3)
LAWS = {
    "neo-Hookean": (pd.NeoHookean, "mu/2 * (I1 - 3 - 2*log(J)) + lam/2 * log(J)**2"),
    "Saint Venant-Kirchhoff": (pd.SaintVenantKirchhoff, "lam/8*(I1 - 3)**2 + mu/4*(I1**2 - 2*I2 - 2*I1 + 3)"),
    "Hencky": (pd.Hencky, "lam/2*log(J)**2 + mu*(log(l1)**2 + log(l2)**2 + log(l3)**2)"),
}
BODIES = {"bar": (1, "stress"), "plane strain": (2, "strain"), "plane stress": (2, "stress"), "solid": (3, "strain")}


def ratio(hand, text, method, F, shape):
    """Return the time of ``text`` over that of ``hand``."""
    result = np.empty((len(F), *shape))
    seconds = []
    for _ in range(REPEATS + 1):  # the first compiles
        pair = []
        for law in (hand, text):
            before = time.perf_counter()
            getattr(law, method)(F, result)
            pair.append(time.perf_counter() - before)
        seconds.append(pair)
    a, b = np.median(seconds[1:], axis=0)
    return b / a


def main(n=40000):
    """Print the table."""
    print("| law | body | stress | tangent | energy |\n|---|---|---|---|---|")
    for name, (by_hand, text) in LAWS.items():
        for body, (dim, plane) in BODIES.items():
            F = np.eye(dim) + 0.1 * np.random.default_rng(1).standard_normal((n, dim, dim)).clip(-2.0, 2.0)
            pair = by_hand(E, NU, plane), pd.Hyperelastic(text, plane, mu=MU, lam=LAM)
            hand, own = (MaterialAtPoints(material, np.arange(n), dim, None).at() for material in pair)
            shapes = {"stress": (dim,) * 2, "tangent": (dim,) * 4, "energy": ()}
            found = [ratio(hand, own, method, F, shape) for method, shape in shapes.items()]
            print(f"| {name} | {body} | " + " | ".join(f"{value:.2f}" for value in found) + " |")


if __name__ == "__main__":
    main(*map(int, words))
