"""Cook's membrane of neo-Hookean material, clamped on the left, sheared on the right, plane strain. Units mm, N.

``n`` x ``n`` cells in the quadrilateral of 48, 44 and 16 mm, against finite elements (``cook_elements.py``). The tip
rises by 8.7 mm. With ``cloud=nodes``, or ``simplices``, particles sit at the nodes of quadrilaterals, or triangles, the
inner ones moved by up to ``shake`` spacings, and those on the left side are held where they are: the membrane as it is
printed. With ``cloud=cells`` they sit in the cells, and ``held`` columns at the clamped side have the displacement of
the finite elements (``clamp=reference``) or none (``clamp=zero``), which holds the membrane half a spacing or more
inside of its side: that is of first order. Fewer columns than the horizon reaches leave free particles next to the
clamped facets, which have no traction: that is of first order too. The stress of particles within 5 mm of the clamped
corners, where it is singular, is left out; ``error_surface_stress`` is that of the clamped side 10 mm away from them.
``tip`` is the rise of the upper right corner [mm].
"""

import common
import cook_elements as elements
import numpy as np

import pdpetsc as pd

CORNERS = pd.region.Sphere((0.0, 0.0), 5.0) | pd.region.Sphere((0.0, 44.0), 5.0)
REGULAR = ~CORNERS
CLAMPED = pd.region.Box((-1e-6, 10.0), (1e-6, 34.0))


def displacement(x, t):
    return elements.at(x, elements.stored())[0]


def stress(x, t):
    return elements.cauchy(elements.at(x, elements.stored())[1])


def cells(n, held, shake, seed):
    """Return the particles in the cells; those of the held columns are not moved."""
    points, block = common.grid(n, 0.0, 0, (1.0, 1.0), common.cubes)
    points = elements.places(points)
    area, x = common.centres(points, block)
    free = held * n
    # The cells become flat towards the right.
    sizes = np.stack([np.full(n * n - free, elements.LENGTH / n), area[free:] / (elements.LENGTH / n)], axis=1)
    x[free:] += shake * sizes * np.random.default_rng(seed).uniform(-1.0, 1.0, sizes.shape)
    return common.of_cells(points, block, x)


def nodes(n, shake, seed, kind):
    """Return the particles at the nodes of a grid, moved in the unit square that the membrane is the image of."""
    points, block = common.grid(n, shake, seed, (1.0, 1.0), kind)
    return common.of_nodes(elements.places(points), block)


def case(
    n=16, cloud="nodes", held=3, clamp="reference", shake=0.0, seed=0, scheme="correspondence", weights="conforming",
    horizon=2.015, G=0.5, steps=4,
):  # fmt: skip
    factor = pd.choose("clamp", clamp, {"reference": 1.0, "zero": 0.0})
    known = {
        "cells": lambda: cells(n, held, shake, seed),
        "nodes": lambda: nodes(n, shake, seed, common.cubes),
        "simplices": lambda: nodes(n, shake, seed, common.simplices),
    }
    particles = pd.choose("cloud", cloud, known)()
    spacing = float(np.sqrt(0.5 * elements.LENGTH * (44.0 + 16.0)) / n)
    region = pd.region
    x, y = (lambda places, t, axis=axis: factor * t * displacement(places, t)[:, axis] for axis in (0, 1))
    side, clamped = region.Slab("x", high=held * elements.LENGTH / n), {"x": x, "y": y}
    if cloud != "cells":
        side, clamped = region.Slab("x", high=1e-6 * elements.LENGTH), {"x": 0.0, "y": 0.0}
    of_errors = common.errors(displacement, stress, rigid=False, surface=CLAMPED, regular=REGULAR)
    of_errors["history"]["tip"] = pd.At((elements.LENGTH, 60.0), pd.displacement, "y")
    tip = float(displacement(np.array([[elements.LENGTH, 60.0]]), 1.0)[0, 1])
    return pd.Case(
        particles=particles,
        material=pd.NeoHookean(E=elements.E, nu=elements.NU),
        conditions=[
            pd.Displacement(side, **clamped),
            pd.Traction(region.Slab("x", low=elements.LENGTH * (1.0 - 1e-6)), y=elements.SHEAR),
        ],
        steps=pd.Steps(steps),
        **common.common(scheme, weights, horizon, G, spacing),
        **of_errors,
        expect={"tip": pd.Expected(tip, relative=0.02, source="biquadratic finite elements (cook_elements.py)")},
        picture=pd.Picture(pd.stress, "xx"),
    )
