"""Rigid motions that supports leave free are named."""

import pytest

import pdpetsc as pd

CORNER, OPPOSITE = (0.5, 0.5, 0.5), (2.5, 2.5, 2.5)


def held(point, *letters):
    return pd.PointSupport(pd.region.Nearest(point), **dict.fromkeys(letters, 0.0))


@pytest.mark.parametrize(
    ("dim", "conditions", "motions"),
    [
        (1, [], "1 of 1 rigid motions: translation in x."),
        (3, [], "6 of 6 rigid motions: translation in x, y, z and rotation about x, y, z."),
        (3, [held(CORNER, "x", "y", "z")], "3 of 6 rigid motions: rotation about x, y, z."),
        (3, [held(CORNER, "x", "y", "z"), held((0.5, 0.5, 2.5), "x", "y")], "1 of 6 rigid motions: rotation about z."),
        (
            3, [held(CORNER, "x", "y", "z"), held(OPPOSITE, "x", "y", "z")],
            "1 of 6 rigid motions: rotation about an inclined axis.",
        ),
        (3, [pd.Displacement("-x", x=0.0, y=0.0)],
         "1 of 6 rigid motions: translation in z."),
    ],
)  # fmt: skip
def test_free_rigid_motions_are_named(dim, conditions, motions):
    case = pd.Case(
        particles=pd.Lattice((0.0,) * dim, (3.0,) * dim, 1.0),
        material=pd.LinearElastic(E=1.0, nu=0.0),
        conditions=conditions,
    )
    with pytest.raises(pd.CaseError) as refused:
        pd.prepare(case)
    assert motions in str(refused.value)
