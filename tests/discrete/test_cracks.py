"""Pre-cracks: which bonds a segment, polyline, plane, disc or polygon cuts, on any rank count and across cell sides."""

import dataclasses

import numpy as np
import pytest

import pdpetsc as pd
from pdpetsc.declare.cracks import Crack
from pdpetsc.discrete.cloud import distribute
from pdpetsc.discrete.communicator import world
from pdpetsc.discrete.families import find_families
from tests.commands import results


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


def test_bonds_through_the_edge_of_a_crack_are_cut_wherever_the_body_is(rng):
    """The middles of bonds are on the edges of the polygon and of the disc; rounding does not decide."""
    x = grid(5, 5, 4)
    corners = np.array([[1.5, -1.0, -1.0], [1.5, 1.5, -1.0], [1.5, 1.5, 9.0], [1.5, -1.0, 9.0]])
    centre, normal, radius = np.array([1.5, 2.0, 2.0]), np.eye(3)[0], 1.5

    def cut(move, unit):
        moved, points, middle = (unit * (place + move) for place in (x, corners, centre))
        cracks = [pd.PolygonCrack(points.tolist()), pd.Disc(middle.tolist(), normal.tolist(), unit * radius)]
        return [cut_by(moved, 1.5 * unit, [crack]) for crack in cracks]

    polygon, disc = cut(np.zeros(3), 1.0)
    places = [0.5 * (x[i] + x[j]) for i, j in polygon]
    assert max(place[1] for place in places) == 1.5
    assert any(np.linalg.norm(0.5 * (x[i] + x[j]) - centre) == radius for i, j in disc)
    for move in rng.uniform(-99.0, 99.0, (12, 3)):
        assert cut(move, 10.0 ** rng.uniform(-6.0, 6.0)) == [polygon, disc]


@pytest.mark.parametrize("dim", [2, 3])
def test_bonds_along_a_crack_are_cut_however_the_body_is_turned(dim, rng):
    """Particles lie on the crack, and only rounding tells on which side; their bonds cross it in their middle."""
    x = grid(*[6] * dim)

    def cut(turn, move):
        def at(place):
            return (turn @ np.asarray(place, dtype=float) + move).tolist()

        if dim == 2:
            cracks = [pd.Segment(at((0.5, 2.0)), at((3.5, 2.0)))]
        else:
            corners = [(0.5, 0.5, 2.0), (3.5, 0.5, 2.0), (3.5, 3.5, 2.0), (0.5, 3.5, 2.0)]
            disc = pd.Disc(at((2.0, 2.0, 2.0)), turn[:, 2].tolist(), 1.0)
            cracks = [pd.PolygonCrack([at(corner) for corner in corners]), disc]
        return [cut_by(x @ turn.T + move, 1.5, [crack]) for crack in cracks]

    straight = cut(np.eye(dim), np.zeros(dim))
    assert min(map(len, straight)) > 0
    for _ in range(6):
        turn = np.linalg.qr(rng.normal(size=(dim, dim)))[0]
        assert cut(turn, rng.uniform(-9.0, 9.0, dim)) == straight


def test_points_on_the_sides_of_a_polygon_do_not_change_it():
    """The first three points are on one line, and two are equal."""
    x, corners = grid(5, 5, 4), [(-1.0, -1.0, 1.5), (2.5, -1.0, 1.5), (2.5, 3.5, 1.5), (-1.0, 3.5, 1.5)]
    more = [corners[0], corners[0], (1.0, -1.0, 1.5), *corners[1:]]
    plain, longer = pd.PolygonCrack(corners), pd.PolygonCrack(more)
    assert cut_by(x, 1.5, [longer]) == cut_by(x, 1.5, [plain]) != set()
    np.testing.assert_array_equal(longer.normals(x), plain.normals(x))


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


@pytest.mark.parametrize("shift", [-9.0, -2.0, 1.0, 3.0, 4.0, 13.0])
@pytest.mark.parametrize(
    "crack",
    [
        lambda x: pd.Segment((x + 1.8, 1.5), (x + 3.2, 1.5)),
        lambda x: pd.Polyline([(x + 1.8, 1.5), (x + 2.6, 0.7), (x + 3.2, 1.2)]),
        lambda x: pd.PlaneCrack((x + 1.5, 0.0), (2.0, 0.0)),
        lambda x: pd.Segment((x + 0.2, 1.5), (x + 9.9, 1.5)),  # longer than the cell
    ],
)
def test_cracks_that_differ_by_a_way_along_the_cell_cut_the_same_bonds(crack, shift):
    x = grid(6, 3) + 0.5
    cell = pd.Cell((0.0, 0.0), (6.0, 3.0), "x")

    def cut(by):
        """Return the bonds that are cut, on particles moved back by as much as the crack."""
        home = np.ravel_multi_index((((x - [by, 0.0]) % [6.0, 99.0]).astype(int)).T, (6, 3))
        return {tuple(sorted((home[i], home[j]))) for i, j in cut_by(x, 2.015, [crack(by)], cell=cell)}

    assert cut(shift) == cut(0.0) != set()


def test_a_disc_is_repeated_along_both_periods_of_a_cell():
    x = grid(6, 6, 2) + 0.5
    cell = pd.Cell((0.0, 0.0, 0.0), (6.0, 6.0, 2.0), "xy")
    cut = cut_by(x, 1.015, [pd.Disc((6.0, -6.0, 1.0), (0.0, 0.0, 1.0), 1.0)], cell=cell)
    assert {tuple(x[i][:2]) for i, _ in cut} == {(a, b) for a in (0.5, 5.5) for b in (0.5, 5.5)}


class Wall(Crack):
    """A crack of a user, without a box."""

    def cuts(self, a, b):
        return (a[:, 0] < 6.0) != (b[:, 0] < 6.0)


def test_a_crack_without_a_box_has_its_next_images():
    x = grid(6, 3) + 0.5
    assert cut_by(x, 1.015, [Wall()], cell=pd.Cell((0.0, 0.0), (6.0, 3.0), "x")) == {
        (row, 15 + row) for row in range(3)
    }


def test_a_plane_inclined_to_the_period_is_refused():
    cell = pd.Cell((0.0, 0.0), (4.0, 4.0), "x")
    with pytest.raises(pd.CaseError, match="inclined to x, in which the cell is periodic"):
        pairs_left(grid(4, 4), 1.5, [pd.PlaneCrack((1.5, 0.0), (1.0, 0.2))], cell=cell)
    pairs_left(grid(4, 4), 1.5, [pd.PlaneCrack((0.0, 1.5), (0.0, 1.0))], cell=cell)


CELL = """
import pdpetsc as pd

def case(shift=0.0, kind="bonds"):
    crack = pd.Segment((shift - 0.75, 2.0), (shift + 0.75, 2.0))
    law = pd.PointDamage(pd.softening.Linear(), Gc=1.0, strength=0.1, cracks=[crack])
    return pd.Case(
        particles=pd.Lattice((0.0, 0.0), (4.0, 4.0), 0.25),
        material=pd.BondBased(1000.0, 0.25) if kind == "bonds" else pd.LinearElastic(1000.0, 0.3),
        weights=pd.Conforming() if kind == "gradients" else pd.Standard(),
        cell=pd.Cell((0.0, 0.0), (4.0, 4.0), axes="x"),
        conditions=[
            pd.MeanStrain(xx=0.0),
            pd.Displacement(pd.region.Slab("y", high=0.5), x=0.0, y=0.0),
            pd.Displacement(pd.region.Slab("y", low=3.5), y=1e-4),
        ],
        history={"stored": pd.StrainEnergy()},
        results=lambda h: {"stored": h["stored"][-1]},
        **({"damage": law} if kind == "points" else {"cracks": [crack]}),
    )
"""


@pytest.mark.processors
@pytest.mark.parametrize("kind", ["bonds", "gradients", "points"])
def test_the_energy_of_a_crack_does_not_depend_on_its_place_along_the_cell(kind, tmp_path):
    """Gradients with weights that conform to the faces of the crack; points that have failed."""
    path = tmp_path / "cell.py"
    path.write_text(CELL)

    def stored(shift, ranks):
        words = [f"shift={shift}", f"kind={kind}"]
        return results(path, *words, ranks=ranks, output=tmp_path / f"{shift}_{ranks}")["results"]["stored"]

    for shift, ranks in ((0.0, 1), (0.0, 2), (3.25, 2), (-7.0, 1)):
        assert stored(shift, ranks) == pytest.approx(stored(2.0, 1), rel=1e-9)


def test_values_between_particles_are_not_means_across_the_image_of_a_crack(tmp_path):
    """The record of the run has the images."""
    namespace = {}
    exec(CELL, namespace)
    case = namespace["case"]()
    result = pd.run(dataclasses.replace(case, fields=[pd.displacement]), tmp_path)
    for x in (0.125, 3.875):
        at = result.sample([(x, 1.999), (x, 2.001)])[:, 1]
        assert at[1] - at[0] > 2e-5


def test_a_crack_behind_a_mirror_plane_has_faces(tmp_path):
    """Conforming weights follow the faces of the image as those of the crack on this side of the plane."""
    found = []
    for sign in (1.0, -1.0):
        case = pd.Case(
            particles=pd.Lattice((0.0, 0.0), (2.0, 2.0), 0.25),
            material=pd.LinearElastic(1000.0, 0.3),
            weights=pd.Conforming(),
            symmetry=[pd.Symmetry("x")],
            cracks=[pd.Segment((sign * 1.0, 1.0), (sign * 3.0, 1.0))],
            conditions=[
                pd.Displacement(pd.region.Slab("y", high=0.5), x=0.0, y=0.0),
                pd.Displacement(pd.region.Slab("y", low=1.5), y=1e-4),
            ],
            history={"stored": pd.StrainEnergy()},
        )
        found.append(pd.run(case, tmp_path / str(sign)).history["stored"][-1])
    assert found[1] == pytest.approx(found[0], rel=1e-9)


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
