"""Round hole in a pulled plate, plane strain, against the solution of Kirsch.

The ring with radii 1 and 2 around the hole: on its outer circle act the tractions of the infinite plate under
``sigma_xx = 1``. ``mesh``, ``shake`` and ``n`` are those of ``ring.py``. ``error_surface_stress`` is that at the hole,
where the stress is between -1 and 3; ``concentration`` is the largest one there.
"""

import common
import numpy as np
import rings

import pdpetsc as pd

E, NU = 1.0, 0.3
OUTSIDE = pd.region.Where(lambda x: np.hypot(*x.T) > 0.5 * (rings.INNER + rings.OUTER))


def displacement(x, t):
    r, angle = np.hypot(*x.T), np.arctan2(x[:, 1], x[:, 0])
    mu, kappa = 0.5 * E / (1.0 + NU), 3.0 - 4.0 * NU
    c, s = np.cos(2.0 * angle), np.sin(2.0 * angle)
    of_radius = r * (kappa - 1.0 + 2.0 * c) + 2.0 / r * (1.0 + (kappa + 1.0) * c) - 2.0 / r**3 * c
    around = (-2.0 * r + 2.0 / r * (1.0 - kappa) - 2.0 / r**3) * s
    e = x / r[:, None]
    return (of_radius[:, None] * e + around[:, None] * np.stack([-e[:, 1], e[:, 0]], axis=1)) / (8.0 * mu)


def stress(x, t):
    r, angle = np.hypot(*x.T), np.arctan2(x[:, 1], x[:, 0])
    c, s = np.cos(2.0 * angle), np.sin(2.0 * angle)
    rr = 0.5 * (1.0 - r**-2) + 0.5 * (1.0 - 4.0 * r**-2 + 3.0 * r**-4) * c
    tt = 0.5 * (1.0 + r**-2) - 0.5 * (1.0 + 3.0 * r**-4) * c
    rt = -0.5 * (1.0 + 2.0 * r**-2 - 3.0 * r**-4) * s
    e = x / r[:, None]
    d = np.stack([-e[:, 1], e[:, 0]], axis=1)
    both = np.einsum("ni,nj->nij", e, d)
    return rings.radial(x, rr, tt) + rt[:, None, None] * (both + both.transpose(0, 2, 1))


def case(
    n=16, mesh="triangles", shake=0.2, seed=0, scheme="correspondence", weights="conforming", horizon=2.015, G=0.5,
):  # fmt: skip
    particles = rings.cloud(mesh, n, shake, seed)

    def pull(row):
        return lambda x, t: np.einsum("nj,nj->n", stress(x, t)[:, row], x / np.hypot(*x.T)[:, None])

    of_errors = common.errors(displacement, stress, surface=rings.HOLE)
    of_errors["history"]["concentration"] = pd.OnSurface(pd.stress, "xx", rings.HOLE, take="largest")
    return pd.Case(
        particles=particles,
        material=pd.LinearElastic(E=E, nu=NU),
        conditions=[*rings.supports(displacement), pd.Traction(OUTSIDE, x=pull(0), y=pull(1))],
        **common.common(scheme, weights, horizon, G, common.spacing_of(particles)),
        **of_errors,
    )
