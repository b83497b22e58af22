"""Cook's membrane of neo-Hookean material, clamped on the left, sheared on the right, plane strain. Units mm, N.

``n`` x ``n`` particles in the quadrilateral of 48, 44 and 16 mm, moved by up to ``shake`` spacings but for those of the
``held`` columns at the clamped side, against finite elements (``cook_elements.py``). The tip rises by 8.7 mm. With
``clamp=reference`` these columns have the displacement of the finite elements, with ``clamp=zero`` none, which holds
the membrane half a spacing or more inside of its side: that is of first order. Fewer columns than the horizon reaches
leave free particles next to the clamped facets, which have no traction: that is of first order too.
"""

import common
import cook_elements as elements
import numpy as np

import pdpetsc as pd


def displacement(x, t):
    return elements.at(x, elements.stored())[0]


def stress(x, t):
    return elements.cauchy(elements.at(x, elements.stored())[1])


def cloud(n, held, shake, seed):
    """Return the particles and their mean spacing."""
    s = np.linspace(0.0, 1.0, n + 1)
    nodes = elements.places(np.stack(np.meshgrid(s, s, indexing="ij"), axis=-1).reshape(-1, 2))
    cells = common.grid_cells(n, n)
    area, x = common.centres(nodes[cells])
    free = held * n
    # The cells become flat towards the right.
    sizes = np.stack([np.full(n * n - free, elements.LENGTH / n), area[free:] / (elements.LENGTH / n)], axis=1)
    x[free:] += shake * sizes * np.random.default_rng(seed).uniform(-1.0, 1.0, sizes.shape)
    return common.of_cells(nodes, cells, x), float(np.sqrt(area.mean()))


def case(
    n=16, held=3, clamp="reference", shake=0.0, seed=0, scheme="correspondence", weights="conforming", horizon=2.015,
    G=0.5, steps=4,
):  # fmt: skip
    factor = pd.choose("clamp", clamp, {"reference": 1.0, "zero": 0.0})
    particles, spacing = cloud(n, held, shake, seed)
    region = pd.region
    x, y = (lambda places, t, axis=axis: factor * t * displacement(places, t)[:, axis] for axis in (0, 1))
    return pd.Case(
        particles=particles,
        material=pd.NeoHookean(E=elements.E, nu=elements.NU),
        conditions=[
            pd.Displacement(region.Slab("x", high=held * elements.LENGTH / n), x=x, y=y),
            pd.Traction(region.Slab("x", low=elements.LENGTH * (1.0 - 1e-6)), y=elements.SHEAR),
        ],
        steps=pd.Steps(steps),
        **common.common(scheme, weights, horizon, G, spacing),
        **common.errors(displacement, stress, rigid=False),
    )
