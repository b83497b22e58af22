"""Pre-cracks: which bonds a segment, polyline, plane, disc or polygon cuts, on any rank count and across cell sides."""

import numpy as np
import pytest

import pdpetsc as pd
from pdpetsc.discrete.cloud import distribute
from pdpetsc.discrete.communicator import world
from pdpetsc.discrete.families import find_families


def pairs_left(x, horizon, cracks, cell=None):
    cloud = distribute(world(), x, np.ones(len(x)), {}, horizon, cell)
    families = find_families(cloud, cracks)
    return {
        tuple(sorted((int(cloud.gid[i]), int(cloud.gid[j]))))
        for i, j in zip(families.centres, families.neighbours, strict=True)
    }


def grid(*sides):
    return np.stack(np.meshgrid(*[np.arange(float(n)) for n in sides], indexing="ij"), axis=-1).reshape(-1, len(sides))


def cut_by(x, horizon, cracks, **more):
    return pairs_left(x, horizon, [], **more) - pairs_left(x, horizon, cracks, **more)


def test_a_segment_cuts_what_crosses_it_and_no_more():
    x = grid(6, 4)
    cut = cut_by(x, 1.5, [pd.Segment((-1.0, 1.5), (2.5, 1.5))])
    for i, j in cut:
        low, high = sorted((x[i], x[j]), key=lambda p: p[1])
        assert low[1] == 1.0
        assert high[1] == 2.0
        assert 0.5 * (low[0] + high[0]) <= 2.5
    straight = {(i, j) for i, j in cut if x[i][0] == x[j][0]}
    assert len(straight) == 3
    assert len(cut) == 3 + 6  # and both diagonals of three cells, the last of which cross at the tip


def test_a_polyline_is_its_segments():
    x = grid(7, 7)
    points = [(0.3, -1.0), (2.6, 3.4), (6.6, 3.7)]
    parts = cut_by(x, 2.015, [pd.Segment(*points[:2])]) | cut_by(x, 2.015, [pd.Segment(*points[1:])])
    assert cut_by(x, 2.015, [pd.Polyline(points)]) == parts


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_a_plane_separates_the_body(dim):
    x = grid(*[6, 4, 3][:dim])
    normal = [1.0] + [0.0] * (dim - 1)
    cut = cut_by(x, 1.5, [pd.PlaneCrack([2.5] + [0.0] * (dim - 1), normal)])
    assert cut == {(i, j) for i, j in pairs_left(x, 1.5, []) if (x[i][0] < 2.5) != (x[j][0] < 2.5)}


def test_a_disc_and_the_polygon_around_it():
    x = grid(5, 5, 4) - [2.0, 2.0, 1.5]
    disc = cut_by(x, 1.015, [pd.Disc((0.0, 0.0, 0.0), (0.0, 0.0, 2.0), 1.1)])
    assert disc == {(i, j) for i, j in pairs_left(x, 1.015, []) if x[i][2] * x[j][2] < 0 and np.hypot(*x[i][:2]) <= 1.1}
    diamond = [(1.3, 0.0, 0.0), (0.0, 1.3, 0.0), (-1.3, 0.0, 0.0), (0.0, -1.3, 0.0)]
    assert cut_by(x, 1.015, [pd.PolygonCrack(diamond)]) == disc
    hook = [(-2.5, -2.5, 0), (2.5, -2.5, 0), (2.5, 2.5, 0), (0.5, 2.5, 0), (0.5, -0.5, 0), (-2.5, -0.5, 0)]
    hooked = cut_by(x, 1.015, [pd.PolygonCrack(hook)])
    assert hooked == {
        (i, j) for i, j in pairs_left(x, 1.015, []) if x[i][2] * x[j][2] < 0 and (x[i][0] > 0.5 or x[i][1] < -0.5)
    }


def test_cracks_of_a_periodic_cell_cut_images_from_both_ends():
    x = grid(6, 3) + 0.5
    cell = pd.Cell((0.0, 0.0), (6.0, 3.0), "x")
    cut = cut_by(x, 1.015, [pd.PlaneCrack((6.0, 0.0), (1.0, 0.0))], cell=cell)
    assert cut == {(row, 15 + row) for row in range(3)}


@pytest.mark.parametrize(
    ("crack", "message"),
    [
        (pd.Segment((0.0, 0.0), (0.0, 0.0)), "two different ends"),
        (pd.Segment((0.0, 9.5), (1.0, 9.5)), "cuts no bond"),
        (pd.Polyline([(0.0, 0.0)]), "at least two points"),
        (pd.PlaneCrack((0.5, 0.0), (0.0, 0.0)), "normal that is not zero"),
        (pd.PlaneCrack((0.5,), (1.0,)), "points of 2 numbers"),
        (pd.Disc((0, 0, 0), (0, 0, 1), 1.0), "requires a body in 3D"),
    ],
)
def test_wrong_cracks_are_refused(crack, message):
    with pytest.raises(pd.CaseError, match=message):
        pairs_left(grid(4, 4), 1.5, [crack])
