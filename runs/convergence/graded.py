"""Plate with a hole on triangles that grow away from it, plane strain, against the solution of Kirsch: python runs/convergence/graded.py [folder].

Radius of the hole 1, outer radius 6 with the exact tractions on it. Triangles have the size ``1 / n`` at the hole; with
``mesh=graded`` they grow in proportion to the distance from the middle, and horizons with them. The command prints the
errors of displacement and stress in the L2 norm and of the hoop stress at the hole, for three sizes, of three draws.
With ``smooth`` horizons follow the distance from the middle instead of the triangles.
"""  # noqa: E501

import itertools
import sys
from pathlib import Path

import numpy as np

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parent.parent)]
import common
import rings

import pdpetsc as pd

E, NU, PULL = 1.0, 0.3, 1e-3
OUTER = 6.0
ERRORS = ("error_u", "error_stress", "error_surface_stress")
# How triangles grow with the distance from the middle.
MESHES = {"uniform": lambda r: np.ones_like(r), "graded": lambda r: r}


def stress(x, t):
    """Return the stresses (n, 2, 2) of a plate pulled along x."""
    r, angle = np.hypot(*x.T), np.arctan2(x[:, 1], x[:, 0])
    a, b = r**-2, r**-4
    rr = 0.5 * PULL * (1.0 - a + (1.0 - 4.0 * a + 3.0 * b) * np.cos(2.0 * angle))
    tt = 0.5 * PULL * (1.0 + a - (1.0 + 3.0 * b) * np.cos(2.0 * angle))
    rt = -0.5 * PULL * (1.0 + 2.0 * a - 3.0 * b) * np.sin(2.0 * angle)
    e = x / r[:, None]
    turned = np.stack([-e[:, 1], e[:, 0]], axis=1)
    shear = np.einsum("ni,nj->nij", e, turned)
    return rings.radial(x, rr, tt) + rt[:, None, None] * (shear + shear.transpose(0, 2, 1))


def displacement(x, t):
    """Return the displacements (n, 2)."""
    r, angle = np.hypot(*x.T), np.arctan2(x[:, 1], x[:, 0])
    k, mu = 3.0 - 4.0 * NU, E / (2.0 * (1.0 + NU))
    c, s, c3, s3 = np.cos(angle), np.sin(angle), np.cos(3.0 * angle), np.sin(3.0 * angle)
    ux = r * (k + 1.0) * c + 2.0 / r * ((1.0 + k) * c + c3) - 2.0 / r**3 * c3
    uy = r * (k - 3.0) * s + 2.0 / r * ((1.0 - k) * s + s3) - 2.0 / r**3 * s3
    return PULL / (8.0 * mu) * np.stack([ux, uy], axis=1)


def radii(size):
    """Return the radii of circles that are ``size(r)`` apart, the first and the last those of the plate."""
    r = np.linspace(1.0, OUTER, 4001)
    passed = np.concatenate([[0.0], np.cumsum(np.diff(r) * 2.0 / (size(r[1:]) + size(r[:-1])))])
    return np.interp(np.linspace(0.0, passed[-1], max(round(passed[-1]), 2) + 1), passed, r)


def triangles(n, mesh, shake, seed):
    """Return irregular triangles of the area of squares ``1 / n`` wide at the hole, as in ``rings``."""
    grows = pd.choose("mesh", mesh, MESHES)

    # Equilateral triangles of area a have the height sqrt(sqrt(3) a).
    def height(r):
        return 3.0**0.25 / n * grows(r)

    return common.of_cells(*rings.between(radii(height), height, shake, seed))


def case(
    n=8, mesh="graded", shake=0.1, seed=0, scheme="correspondence", weights="conforming", horizon=2.015, G=0.5,
    smooth=False,
):  # fmt: skip
    particles = triangles(n, mesh, shake, seed)

    def pulled(axis):
        return lambda x, t: t * np.einsum("nj,nj->n", stress(x, t)[:, axis], x / np.hypot(*x.T)[:, None])

    def by_place(x):
        return horizon / n * MESHES[mesh](np.hypot(*x.T))

    outside = ~pd.region.Sphere((0.0, 0.0), 0.5 * (1.0 + OUTER))
    words = common.common(scheme, weights, horizon, G, 1.0)
    return pd.Case(
        particles=particles,
        material=pd.LinearElastic(E=E, nu=NU),
        conditions=[
            *common.three_supports([(-OUTER, 0.001), (OUTER, 0.001)], displacement),
            pd.Traction(outside, x=pulled(0), y=pulled(1)),
        ],
        **(words | {"horizon": by_place if smooth else pd.Horizon(horizon)}),
        **common.errors(displacement, stress, surface=rings.HOLE),
    )


def main(folder):
    """Print and save errors and times for sizes of both meshes and both weights."""
    import study

    folder = study.folder_for([folder], folder)
    rows = []
    for mesh, weights, n in itertools.product(MESHES, pd.WEIGHTS, (4, 8, 16)):
        found = [study.run(folder, case(n=n, mesh=mesh, seed=seed, weights=weights))[1] for seed in range(3)]
        errors = [np.sqrt(np.mean([one["results"][error] ** 2 for one in found])) for error in ERRORS]
        time = np.median([sum(one["timings"].values()) for one in found])
        rows.append((mesh, weights, n, found[0]["particles"], *errors, time))
        print("{} | {} | n = {} | {} particles | {:.3g} | {:.3g} | {:.3g} | {:.3g} s".format(*rows[-1]), flush=True)
    study.write_table(folder, "graded", ("mesh", "weights", "n", "particles", *ERRORS, "time"), rows)


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "out/graded")
