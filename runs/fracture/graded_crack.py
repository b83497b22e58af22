"""Edge crack in a plate whose moduli grow exponentially along it, across it or between: J, K_I and K_II.

Width 1, height 2, ``E = exp(log(ratio) ((x - a) cos d + y sin d))`` with ``d = direction`` in degrees, so that it is 1
at the tip; nu = 0.3, ``plane``; a crack from the left side to ``x = a`` at mid-height. The ends are drawn apart by a
strain of 0.001 (``load=grip``, free to contract), or pulled by uniform forces of as much (``load=tension``). Moduli
that change across the crack make it slide: K_II.

Results: ``K1_over``, ``K2_over``, over ``0.001 E' sqrt(pi a)`` with E' at the tip; ``J_over``, ``J_far_over``,
``G_over``, over the square of that by E'. Exact are those of finite elements (``graded_crack_elements.py``): ``J_over``
from the energies of two lengths, K from it and from the slide over the opening of the faces near the tip.
"""

import json
from pathlib import Path

import numpy as np
from edge_crack import at_tip

import pdpetsc as pd

NU, STRAIN, HEIGHT = 0.3, 0.001, 1.0
STORE = Path(__file__).parent / "graded_crack_elements.json"


def factor(x, ratio, direction, a):
    """Return Young's modulus at positions x (n, 2)."""
    turn = np.radians(direction)
    return np.exp(np.log(ratio) * ((x[:, 0] - a) * np.cos(turn) + x[:, 1] * np.sin(turn)))


def modulus(plane):
    """Return ``E'`` at the tip."""
    return 1.0 / (1.0 - NU**2) if plane == "strain" else 1.0


def name(ratio, direction, a, load, plane):
    """Return under what the numbers of elements are kept."""
    return f"ratio={ratio:g} direction={direction:g} a={a:g} load={load} plane={plane}"


def expected(n, ratio, direction, a, load, plane):
    """Return what elements give, where they have been asked; the crack is up to half a spacing longer here."""
    found = json.loads(STORE.read_text()).get(name(ratio, direction, a, load, plane), {})
    if not found:
        return {}
    K, J = np.hypot(found["K1_over"], found["K2_over"]), found["J_over"]
    right = {"K1_over": (found["K1_over"], 2.4 / n * K), "K2_over": (found["K2_over"], 1.2 / n * K)}
    right |= {f"{one}_over": (J, 3.6 / n * J) for one in ("J", "J_far", "G")}
    return {key: pd.Expected(value, absolute=off, source="finite elements") for key, (value, off) in right.items()}


def case(
    n=40, horizon=2.015, ratio=10.0, direction=0.0, a=0.4, load="grip", plane="strain", scheme="sub_horizons", G=0.0
):
    """Return the case: ``n`` particles across."""
    pd.choose("load", load, {"grip": None, "tension": None})
    dx = 1.0 / n
    tip, ahead = (a, 0.0), (1.0, 0.0)
    room = min(a, 1.0 - a)
    near, far = (max(0.25 * room, horizon * dx), 0.6 * room), (max(0.5 * room, horizon * dx), 0.9 * room)
    unit = STRAIN * modulus(plane) * np.sqrt(np.pi * a)
    low, high = pd.region.Slab("y", high=dx - HEIGHT), pd.region.Slab("y", low=HEIGHT - dx)
    corner = pd.region.Nearest((1.0 - 0.5 * dx, 0.5 * dx - HEIGHT))
    if load == "grip":
        conditions = [
            pd.Displacement(low | high, y=lambda x, t: t * STRAIN * x[:, 1]),
            pd.Displacement(corner, x=0.0),
        ]
    else:
        force = STRAIN * modulus(plane)
        conditions = [
            pd.Displacement(corner, x=0.0, y=0.0),
            pd.Displacement(pd.region.Nearest((0.5 * dx, 0.5 * dx - HEIGHT)), y=0.0),
            pd.Force(low, y=-force),
            pd.Force(high, y=force),
        ]

    def results(h):
        by = {"K1": unit, "K2": unit, **dict.fromkeys(("J", "J far", "G"), unit**2 / modulus(plane))}
        return {f"{one.replace(' ', '_')}_over": h[one][-1] / size for one, size in by.items()}

    return pd.Case(
        particles=pd.Lattice((0.0, -HEIGHT), (1.0, HEIGHT), dx),
        horizon=horizon * dx,
        material=pd.Graded(pd.LinearElastic(1.0, NU, plane), lambda x: factor(x, ratio, direction, a)),
        scheme=pd.choose("scheme", scheme, pd.SCHEMES),
        control=pd.Silling(G) if G else None,
        cracks=[pd.Segment((-1.0, 0.0), tip)],
        conditions=conditions,
        history=at_tip(tip, ahead, near, far),
        results=results,
        # Correspondence models with their control are longer in settling.
        expect=expected(n, ratio, direction, a, load, plane) if scheme == "sub_horizons" else {},
        fields=[pd.displacement, pd.stress, pd.von_mises],
        picture=pd.Picture(pd.von_mises, "", 200.0),
    )
