"""Held strip with a crack in its cold edge by finite elements: python runs/fracture/thermal_crack_elements.py.

Biquadratic quadrilaterals (scikit-fem), smaller towards the tip; ``G`` from the strain energy of cracks of two lengths
between held ends, ``K = sqrt(G E / (1 - nu^2))``. Writes ``thermal_crack_elements.json``: ``K1_over`` as
``thermal_crack.py`` has it, on two meshes, and ``K1_by_length``, K in the same unit for cracks of other lengths.
"""

import json
import sys
from pathlib import Path

import numpy as np
from skfem import Basis, ElementQuad2, ElementVector, LinearForm, MeshQuad, condense, solve
from skfem.helpers import sym_grad, trace
from skfem.models.elasticity import linear_elasticity

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parent.parent)]
import study

study.start("fracture")

import thermal_crack as strip

STORE = Path(__file__).with_suffix(".json")
STEP = 0.002
LAM = strip.E * strip.NU / ((1.0 + strip.NU) * (1.0 - 2.0 * strip.NU))
MU = 0.5 * strip.E / (1.0 + strip.NU)
THERMAL = (3.0 * LAM + 2.0 * MU) * strip.ALPHA


def temperature(x):
    return 2.0 * x[0] - 1.0


@LinearForm
def heated(v, w):
    return THERMAL * temperature(w.x) * trace(sym_grad(v))


def energy(a, n):
    """Return the strain energy of half the strip with a crack of length ``a``, n elements on both sides of the tip."""
    s = np.linspace(-1.0, 1.0, 2 * n + 1)
    graded = np.sign(s) * np.abs(s) ** 3
    x = np.where(graded < 0.0, a * (1.0 + graded), a + (1.0 - a) * graded)
    y = 2.0 * np.linspace(0.0, 1.0, 2 * n + 1) ** 3
    basis = Basis(MeshQuad.init_tensor(x, y), ElementVector(ElementQuad2()), intorder=6)
    K, f = linear_elasticity(LAM, MU).assemble(basis), heated.assemble(basis)
    vertical = basis.split_indices()[1]
    at = basis.doflocs[:, vertical]
    held = vertical[(at[1] > 2.0 - 1e-9) | ((at[1] < 1e-9) & (at[0] > a - 1e-9))]
    corner = basis.nodal_dofs[0, np.argmin(np.linalg.norm(basis.mesh.p - np.array([[1.0], [2.0]]), axis=0))]
    u = solve(*condense(K, f, D=np.append(held, corner)))
    # The part of the temperature alone does not depend on the crack.
    return 0.5 * u @ (K @ u) - f @ u


def factor(n, a=0.5):
    """Return the stress intensity factor over ``E alpha / (1 - nu) sqrt(pi a)``."""
    G = -2.0 * (energy(a + STEP, n) - energy(a - STEP, n)) / (2.0 * STEP)
    return float(
        np.sqrt(G * strip.E / (1.0 - strip.NU**2)) / (strip.E * strip.ALPHA / (1.0 - strip.NU) * np.sqrt(np.pi * a))
    )


def main():
    found = {name: float(f"{value:.5g}") for name, value in (("K1_over", factor(24)), ("K1_over_coarse", factor(12)))}
    found["K1_by_length"] = {
        str(a): float(f"{factor(12, a) * np.sqrt(a / 0.5):.5g}") for a in np.linspace(0.2, 0.75, 12).round(2)
    }
    STORE.write_text(json.dumps(found) + "\n")
    print(found)


if __name__ == "__main__":
    main()
