"""Cook's membrane of neo-Hookean material, clamped on the left, sheared on the right, plane strain. Units mm, N.

``n`` x ``n`` particles in the quadrilateral of 48, 44 and 16 mm, against finite elements (``cook_elements.py``). The
tip rises by 8.7 mm. Those of the first column stand on the clamped side, in the middle of the face of their cells, so
that ``clamp=face`` prescribes what is known there; ``clamp=reference`` leaves them at the centroids and prescribes the
displacement of the finite elements. The ends of the clamped side are singular, which limits every order. ``shake``
moves the others by up to that share of the spacing.
"""

import common
import cook_elements as elements
import numpy as np

import pdpetsc as pd

STEPS = 4


def displacement(x, t):
    return elements.at(x, elements.stored())[0]


def stress(x, t):
    return elements.cauchy(elements.at(x, elements.stored())[1])


def cloud(n, clamp, shake, seed):
    """Return the particles and their mean spacing."""
    s = np.linspace(0.0, 1.0, n + 1)
    nodes = elements.places(np.stack(np.meshgrid(s, s, indexing="ij"), axis=-1).reshape(-1, 2))
    cells = common.grid_cells(n, n)
    area, x = common.centres(nodes[cells])
    spacing = float(np.sqrt(area.mean()))
    x[n:] += shake * spacing * np.random.default_rng(seed).uniform(-1.0, 1.0, (len(x) - n, 2))
    if clamp == "face":
        x[:n] = 0.5 * (nodes[:n] + nodes[1 : n + 1])
    return common.of_cells(nodes, cells, x), spacing


def case(
    n=16, clamp="face", shake=0.0, seed=0, scheme="correspondence", weights="conforming", horizon=2.015, G=0.5,
    steps=STEPS,
):  # fmt: skip
    pd.choose("clamp", clamp, {"face": None, "reference": None})
    particles, spacing = cloud(n, clamp, shake, seed)
    region = pd.region
    first = region.Where(lambda x: x[:, 0] < (0.75 / n) * elements.LENGTH)
    if clamp == "face":
        held = pd.Displacement(region.Slab("x", high=1e-6), x=0.0, y=0.0)
    else:
        x, y = (lambda places, t, axis=axis: t * displacement(places, t)[:, axis] for axis in (0, 1))
        held = pd.Displacement(first, x=x, y=y)
    return pd.Case(
        particles=particles,
        material=pd.NeoHookean(E=elements.E, nu=elements.NU),
        conditions=[held, pd.Traction(region.Slab("x", low=elements.LENGTH * (1.0 - 1e-6)), y=elements.SHEAR)],
        steps=pd.Steps(steps),
        **common.common(scheme, weights, horizon, G, spacing),
        **common.errors(displacement, stress, rigid=False),
    )
