"""Free bar, strip or box, twice as long as wide, under uniform traction on its ends. Units m, N.

With ``distribution=consistent`` the deformation gradient is uniform and exact, whatever the horizon: the patch test of
a traction. ``distribution=layer`` loads the outer particles and shows what that costs near the ends.

``shake`` moves particles by up to that share of the spacing, whose cells and facets stay those of the lattice:
``weights=conforming`` with ``distribution=surface`` then gives the same uniform gradient. With ``fine=2`` the right
half has cells half as long, and each particle a horizon of so many of its own spacings. ``max_F_error`` is the largest
error of the deformation gradient. Any consistent units.
"""

import math

import numpy as np
from scipy.optimize import brentq

import pdpetsc as pd

E = 1.0e3
NU = 0.3


def exact_gradient(dim, traction):
    """Return F of a Hencky bar with P_xx = traction and free sides."""
    lam, mu = pd.Hencky(E=E, nu=NU).lame(dim)
    lateral = -lam / (2.0 * mu + (dim - 1) * lam)
    stiffness = lam * (1.0 + (dim - 1) * lateral) + 2.0 * mu
    strain = brentq(lambda e: stiffness * e * math.exp(-e) - traction, -0.9, 0.9, xtol=1e-16)
    return np.diag([math.exp(strain)] + [math.exp(lateral * strain)] * (dim - 1))


def shaken(lattice, shake, seed=0):
    """Return the particles of a lattice moved by up to ``shake`` spacings, with the cells and facets of the lattice."""
    x = lattice.chunk(0, 1).x
    moved = x + shake * lattice.spacing * np.random.default_rng(seed).uniform(-1.0, 1.0, x.shape)
    return pd.Arrays(moved, lattice.spacing**lattice.dim, facets=lattice.surface())


def refined(dim, dx, fine, shake, seed=0):
    """Return a block whose right half has cells ``fine`` times smaller, with its facets, moved as in ``shaken``."""
    ends = [
        ([0.0] * dim, [1.0] * dim, dx, 1.0),
        ([1.0] + [0.0] * (dim - 1), [2.0] + [1.0] * (dim - 1), dx / fine, -1.0),
    ]
    x, volume, places, areas, owners = [], [], [], [], []
    for low, high, spacing, inward in ends:
        half = pd.Lattice(low, high, spacing)
        part = half.chunk(0, 1)
        place, area, owner, _ = half.surface().arrays
        # The halves meet at x = 1, which is no surface.
        free = ~((np.abs(place[:, 0] - 1.0) < 1e-9) & (inward * area[:, 0] > 0.0))
        places.append(place[free])
        areas.append(area[free])
        owners.append(owner[free] + sum(map(len, x)))
        x.append(part.x + shake * spacing * np.random.default_rng(seed).uniform(-1.0, 1.0, part.x.shape))
        volume.append(part.volume)
    facets = pd.Facets(np.concatenate(places), np.concatenate(areas), np.concatenate(owners))
    return pd.Arrays(np.concatenate(x), np.concatenate(volume), facets=facets)


def case(
    dim=2, n=10, horizon=2.015, traction=100.0, G=0.5, scheme="correspondence", distribution="consistent", steps=1,
    shake=0.0, weights="standard", seed=0, fine=1,
):  # fmt: skip
    if dim not in (1, 2, 3):
        raise pd.CaseError(f"dim is 1, 2 or 3, not {dim}.")
    size = np.array([2.0] + [1.0] * (dim - 1))
    dx = 1.0 / n
    normal = [1.0] + [0.0] * (dim - 1)
    region = pd.region
    ends = [(1.0, region.Slab("x", low=2.0 - dx)), (-1.0, region.Slab("x", high=dx))]
    lattice = pd.Lattice([0.0] * dim, size, dx)
    particles = shaken(lattice, shake, seed) if shake else lattice
    corner = np.full(dim, 0.5 * dx)
    far = [corner + np.eye(dim)[d] * (size[d] - dx) for d in range(dim)]
    if fine != 1:
        particles = refined(dim, dx, fine, shake, seed)
        far[0] = np.array([2.0] + [0.0] * (dim - 1)) + 0.5 * dx / fine * np.array([-1.0] + [1.0] * (dim - 1))
    F = exact_gradient(dim, traction)

    def along(axis):
        """Return the exact displacement along an axis, which is none at the corners of the lattice."""
        return lambda x, t: (F[axis, axis] - 1.0) * (x[:, axis] - corner[axis])

    exact = {name: along(axis) for axis, name in enumerate("xyz"[:dim])}
    held = [pd.Displacement(region.Nearest(corner), **exact)]
    if dim > 1:
        held.append(pd.Displacement(region.Nearest(far[0]), **{name: exact[name] for name in "yz"[: dim - 1]}))
    if dim > 2:
        held.append(pd.Displacement(region.Nearest(far[1]), z=exact["z"]))
    return pd.Case(
        particles=particles,
        horizon=horizon * dx if fine == 1 else pd.Horizon(horizon),
        material=pd.Hencky(E=E, nu=NU),
        scheme=pd.choose("scheme", scheme, pd.SCHEMES),
        weights=pd.choose("weights", weights, pd.WEIGHTS),
        control=pd.Silling(G) if G else None,
        conditions=[
            *held,
            *(
                pd.Traction(side, x=sign * traction, normal=[sign * c for c in normal], distribution=distribution)
                for sign, side in ends
            ),
        ],
        steps=pd.Steps(steps),
        history={
            "max_F_error": pd.LargestError(pd.deformation_gradient, lambda x, t: F),
            "force": pd.Reaction("x"),
        },
        results=lambda h: {"max_F_error": h["max_F_error"][-1], "strain": F[0, 0] - 1.0},
        expect={"max_F_error": pd.Expected(0.0, absolute=1e-9, source="one deformation gradient everywhere")},
        picture=pd.Picture(pd.displacement, "x") if dim > 1 else None,
    )
