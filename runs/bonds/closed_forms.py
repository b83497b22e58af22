"""Bonds against closed forms: energy of uniform dilation, force of a quadratic displacement, energy of a crack.

    python runs/bonds/closed_forms.py [folder]        # default out/closed_forms

For every dimension (plane strain and plane stress in 2D), several influence functions and m = horizon / spacing, with
the micromodulus of the continuum: relative errors at a particle with a whole family of

- the energy density under uniform dilation, ``1/2 kappa (d eps)^2``;
- the force density under ``u = 1/2 x^2 e_x``, ``lambda + 2 mu``, as in Navier's equations;
- the energy of breaking all bonds across a plane between two layers at the stretch s, per area:
  ``G0 = 1/4 c s^2 int omega |xi| |xi_x| dV``.

The last column has the crack energy with the lattice's own calibration. Then the bar under tension for the three
calibrations (runs/bonds/tension_bar.py).
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))
import study

words = study.start("bonds")

import numpy as np
from tension_bar import INFLUENCES
from tension_bar import case as bar

import pdpetsc as pd
from pdpetsc.discrete.communicator import is_root, world

E = 1.0
BODIES = [(1, "stress"), (2, "strain"), (2, "stress"), (3, "strain")]
MS = {1: (2, 4, 8, 16), 2: (2, 3, 4, 6, 8), 3: (2, 3, 4)}


def patch(dim, plane, m, influence, calibration="continuum"):
    """Return the model of a cube of lattice with one whole family at its middle, m spacings being the horizon."""
    n = 2 * (m + 1) + 1
    return study.build(
        pd.Case(
            particles=pd.Lattice([-0.5 * n / m] * dim, [0.5 * n / m] * dim, 1.0 / m),
            horizon=1.0,
            material=pd.BondBased(E=E, plane=plane, calibration=calibration),
            influence=influence,
            conditions=[],
        )
    )


def errors(dim, plane, m, influence):
    """Return the relative errors of dilation energy, quadratic force and crack energy at the middle."""
    problem = patch(dim, plane, m, influence)
    material_term, cloud = problem.material_term, problem.body.cloud
    middle = int(np.argmin((cloud.x**2).sum(axis=1)))
    lam, mu = pd.BondBased(E=E, plane=plane).elastic(dim).lame(dim)
    energy = material_term.energy_density(problem.state(cloud.x))[middle] / (0.5 * material_term.kappa * dim**2) - 1.0
    u = np.zeros_like(cloud.x)
    u[:, 0] = 0.5 * cloud.x[:, 0] ** 2
    force = -problem.internal_force(problem.state(u))[middle, 0] / cloud.volume[middle] / (lam + 2.0 * mu) - 1.0
    calibrated = patch(dim, plane, m, influence, "lattice")
    exact = crack_energy(dim, plane, influence)
    return energy, force, cut_energy(problem, middle) / exact - 1.0, cut_energy(calibrated, middle) / exact - 1.0


def cut_energy(problem, middle):
    """Return the energy per area, at unit stretch, of the bonds across a plane between two layers of particles.

    A bond that advances by a layers is cut by a planes: every particle's family gives its bonds times their layers.
    """
    families, cloud, dim = problem.body.families, problem.body.cloud, problem.dim
    family = slice(families.indptr[middle], families.indptr[middle + 1])
    xi = families.bonds(cloud.x)[family]
    spacing = cloud.volume[middle] ** (1.0 / dim)
    each = (
        2.0 * 0.5 * problem.material_term.k[family] * (xi**2).sum(axis=1)
    )  # both directions of a bond, elongated by its length
    ahead = xi[:, 0] > 0.25 * spacing
    return float((each * xi[:, 0] / spacing)[ahead].sum() / spacing ** (dim - 1))


def crack_energy(dim, plane, influence):
    """Return ``1/4 c int omega |xi| |xi_x| dV`` of the continuum with unit horizon."""
    s = (np.arange(20000) + 0.5) / 20000
    radial = (influence(s) * s ** (2 + dim - 1)).mean()
    moment = (influence(s) * s**dim).mean()
    sphere, projected = {1: (2.0, 2.0), 2: (2.0 * np.pi, 4.0), 3: (4.0 * np.pi, 2.0 * np.pi)}[dim]
    a = {(1, "stress"): 2.0, (2, "strain"): 6.4, (2, "stress"): 6.0, (3, "strain"): 12.0}[dim, plane]
    return 0.25 * a * E / (sphere * moment) * projected * radial


def bars(folder):
    """Return errors of bars and strips for every calibration."""
    rows = []
    for dim in (1, 2):
        for horizon in (2.015, 3.015):
            for name in ("continuum", "lattice", "family"):
                found = pd.run(bar(dim, 10, horizon, calibration=name), output=folder / "last_run")
                rows.append((dim, horizon, name, *found.values()))
            found = pd.run(bar(dim, 10, horizon, "linear_solid"), output=folder / "last_run")
            rows.append((dim, horizon, "linear solid", *found.values()))
    return rows


def show(header, rows):
    if is_root(world()):
        print(" ".join(f"{name:>13}" for name in header))
        for row in rows:
            print(" ".join(f"{v:13.2e}" if isinstance(v, float) else f"{v!s:>13}" for v in row))


def main():
    folder = study.folder_for(words, "out/closed_forms")
    header = ["dim", "plane", "influence", "m", "dilation", "quadratic", "crack", "crack, lattice"]
    rows = [
        (dim, plane, name, m, *errors(dim, plane, m, influence))
        for dim, plane in BODIES
        for name, influence in INFLUENCES.items()
        for m in MS[dim]
    ]
    study.write_table(folder, "closed_forms", header, rows)
    show(header, rows)
    header = ["dim", "horizon / dx", "calibration", "middle", "whole"]
    rows = bars(folder)
    study.write_table(folder, "bars", header, rows)
    show(header, rows)


if __name__ == "__main__":
    main()
