"""A cube (a square in the plane) of Hencky material in tension, of any size: the body of the benchmarks.

mpirun -n 2 python -m pdpetsc runs/bench/box.py dim=3 n=47 horizon=3.015 -log_view
"""

import pdpetsc as pd


def case(
    dim=3, n=22, horizon=3.015, nu=0.3, scheme="correspondence", G=0.5, strain=0.01, steps=1, breakable=False, crack=0.0
):
    """Return the case: n^dim particles of unit spacing, held at one end and pulled at the other by a strain.

    A crack between the particles halfway between the ends crosses a share ``crack`` of the body.
    """
    side = 1.0 * n
    half, depth = float(n // 2), crack * side
    cut = {
        2: lambda: pd.Segment((half, 0.0), (half, depth)),
        3: lambda: pd.PolygonCrack([(half, 0.0, 0.0), (half, depth, 0.0), (half, depth, side), (half, 0.0, side)]),
    }
    return pd.Case(
        particles=pd.Lattice([0.0] * dim, [side] * dim, 1.0),
        horizon=horizon,
        material=pd.Hencky(E=1.0, nu=nu),
        scheme=pd.choose("scheme", scheme, pd.SCHEMES),
        control=pd.Silling(G) if G else None,
        damage=pd.Brittle(pd.damage.ConstantCritical(1.0)) if breakable else None,
        cracks=[cut[dim]()] if crack else [],
        conditions=[
            pd.Displacement(pd.region.Slab("x", high=1.0), **dict.fromkeys("xyz"[:dim], 0.0)),
            pd.Displacement(pd.region.Slab("x", low=side - 1.0), x=strain * side),
        ],
        steps=pd.Steps(steps),
        fields=[pd.displacement],
        options={"snes_rtol": 1e-8},
    )
