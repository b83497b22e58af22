"""Periodic cracks of least energy in the quenched plate by finite elements: python runs/thermal/quench_elements.py.

What ``quench.py`` computes without any crack given, from the other side (Jenkins 2005): the half plate with the series
of its temperature has straight cracks of one depth a, a spacing s apart, on whose planes it is mirrored; as a whole it
contracts freely. Biquadratic quadrilaterals (scikit-fem) give the strain energy U of a cell, and ``(U + Gc a) / s`` is
least over depths for each spacing and over both. Writes ``quench_elements.json``: by time, the strain energy without
cracks, spacing and depth of the array of least energy, and the depth for other spacings. Units mm, N, s, K.
"""

import json
import sys
from pathlib import Path

import numpy as np
from scipy.integrate import trapezoid
from scipy.optimize import brentq
from scipy.sparse.linalg import splu
from skfem import Basis, ElementQuad2, ElementVector, LinearForm, MeshQuad
from skfem.helpers import sym_grad, trace
from skfem.models.elasticity import linear_elasticity

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parent.parent)]
import study

study.start("thermal")

import quench

STORE = Path(__file__).with_suffix(".json")
HALF, COEFFICIENT, HOT = 3.0, 50.0, 620.0
# That of bonds in plane stress.
NU = 1.0 / 3.0
MU, LAM = 0.5 * quench.E / (1.0 + NU), quench.E * NU / (1.0 - NU**2)
THERMAL = quench.E * quench.ALPHA / (1.0 - NU)
TIMES = (0.03, 0.06, 0.12, 0.25, 0.5)
SPACINGS = (0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 2.0, 2.25, 2.5, 3.0, 3.5, 4.0)
DEPTHS = np.linspace(0.1, 2.6, 26)


def fall(y, time):
    """Return how much colder than at the start the plate without cracks is at a depth, by its series."""
    biot = COEFFICIENT * HALF / quench.CONDUCTIVITY
    roots = [brentq(lambda a: a * np.sin(a) - biot * np.cos(a), n * np.pi, (n + 0.5) * np.pi) for n in range(80)]
    found = np.ones_like(y)
    for a in roots:
        weight = 4.0 * np.sin(a) / (2.0 * a + np.sin(2.0 * a))
        decay = np.exp(-(a**2) * quench.CONDUCTIVITY / quench.CAPACITY * time / HALF**2)
        found = found - weight * decay * np.cos(a * (1.0 - y / HALF))
    return (HOT - quench.WATER) * found


@LinearForm
def cooled(v, w):
    return -THERMAL * w.colder * trace(sym_grad(v))


def energies(spacing, depth, n):
    """Return the strain energies per width at all times of cells with a crack in their left side."""
    b = 0.5 * spacing
    fine = 1.0 - (1.0 - np.linspace(0.0, 1.0, 2 * n + 1)) ** 1.8
    y = np.unique(np.concatenate([depth * fine, depth + (HALF - depth) * np.linspace(0.0, 1.0, 3 * n + 1) ** 1.8]))
    mesh = MeshQuad.init_tensor(b * np.linspace(0.0, 1.0, 2 * n + 1) ** 1.8, y)
    basis = Basis(mesh, ElementVector(ElementQuad2()), intorder=5)
    K, x = linear_elasticity(LAM, MU).assemble(basis), basis.doflocs
    across, along = basis.split_indices()
    left = across[(x[0, across] < 1e-9) & (x[1, across] > depth - 1e-9)]
    right = across[x[0, across] > b - 1e-9]
    middle = along[x[1, along] > HALF - 1e-9]
    free = np.setdiff1d(np.arange(basis.N), np.concatenate([left, right, middle]))
    solve = splu(K[free][:, free].tocsc()).solve
    # The right side moves as a whole, so that the plate has no mean force.
    whole = np.zeros(basis.N)
    whole[right] = 1.0
    whole[free] = solve(-(K @ whole)[free])
    stiff, found = whole @ (K @ whole), []
    at, line = basis.global_coordinates().value[1], np.linspace(0.0, HALF, 4001)
    for time in TIMES:
        f, u = cooled.assemble(basis, colder=fall(at, time)), np.zeros(basis.N)
        u[free] = solve(f[free])
        u = u + (f @ whole - u @ (K @ whole)) / stiff * whole
        alone = THERMAL * quench.ALPHA * trapezoid(fall(line, time) ** 2, line)
        found.append((0.5 * u @ (K @ u) - f @ u) / b + alone)
    return found


def least(x, y):
    """Return where a parabola through the least of values and its neighbours is least, with the value there."""
    i = int(np.clip(np.argmin(y), 1, len(y) - 2))
    a, b, c = np.polyfit(x[i - 1 : i + 2], y[i - 1 : i + 2], 2)
    at = float(np.clip(-0.5 * b / a, x[i - 1], x[i + 1])) if a > 0.0 else float(x[i])
    return at, float(np.polyval((a, b, c), at))


def main(n=5):
    strain = np.array([[energies(s, a, n) for a in DEPTHS] for s in SPACINGS])  # by spacing, depth, time
    bare = energies(1.0, 1e-3, n)
    found = []
    for number, time in enumerate(TIMES):
        best = [least(DEPTHS, strain[k, :, number] + quench.GC * DEPTHS / s) for k, s in enumerate(SPACINGS)]
        spacing, _ = least(np.log(SPACINGS), np.array([energy for _, energy in best]))
        row = {"time": time, "without_cracks": bare[number], "spacing": float(np.exp(spacing))}
        row["depth"] = float(np.interp(row["spacing"], SPACINGS, [depth for depth, _ in best]))
        row["depths"] = {str(s): round(depth, 3) for s, (depth, _) in zip(SPACINGS, best, strict=True)}
        found.append({name: value if isinstance(value, dict) else float(f"{value:.4g}") for name, value in row.items()})
    STORE.write_text(json.dumps(found, indent=1) + "\n")
    for row in found:
        print(row)


if __name__ == "__main__":
    main()
