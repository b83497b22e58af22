"""Values between particles: what is inside of a body, and on which side of a crack."""

import dataclasses
import itertools

import meshio
import numpy as np
import pytest

import pdpetsc as pd
from pdpetsc.declare.cracks import Crack
from pdpetsc.post.point_location import Boxes, Discs, Enclosed, Facets, inside_of
from pdpetsc.post.sampling import sampled
from tests.commands import run as in_shell

SLOPE = np.array([1.0, -2.0, 3.0])


def in_space(x):
    return np.concatenate([x, np.zeros((len(x), 3 - x.shape[1]))], axis=1)


@pytest.mark.parametrize(
    "sides", [(4.0, 1.0), (1.0, 4.0), (1e-6, 1e-6), (4.0, 1.0, 2.0), (1.0, 1.0, 4.0), (2.5,)], ids=str
)
def test_boxes_with_holes_are_where_their_cells_are(sides):
    dim = len(sides)
    rng = np.random.default_rng(1)
    counts = (9, 8, 7)[:dim]
    filled = rng.random(counts) < 0.7
    filled[(0,) * dim] = filled[(-1,) * dim] = True
    cells = np.argwhere(filled)
    x = (cells + 0.5) * sides
    depth = 3.0 if dim < 3 else 1.0
    body = inside_of(x, np.full(len(x), depth * np.prod(sides)), depth)
    assert isinstance(body, Boxes)
    at = rng.uniform(-0.1, 1.1, (2000, dim)) * np.multiply(counts, sides)
    cell = np.floor(at / sides).astype(int)
    there = ((cell >= 0) & (cell < counts)).all(axis=1)
    there[there] = filled[tuple(cell[there].T)]
    found = sampled(in_space(x), x @ SLOPE[:dim], at, body)
    assert np.array_equal(np.isfinite(found), there) and 200 < there.sum() < 1800
    assert np.allclose(found[there], at[there] @ SLOPE[:dim], rtol=0.0, atol=1e-9 * np.max(counts * np.array(sides)))
    # The faces of the body belong to it, on every side.
    corners = np.array([[0.0] * dim, np.multiply(counts, sides)])
    assert np.isfinite(sampled(in_space(x), x[:, 0], corners, body)).all()


def pulled_apart(sides, cracks=(), particles=None, **given):
    """A body of which the part above half its height moves up by 1, the rest not."""
    half = 0.5 * sides[-1] * 8
    return pd.Case(
        particles=particles,
        horizon=2.015 * max(sides),
        material=pd.LinearElastic(1.0, nu=0.0),
        cracks=list(cracks),
        conditions=[
            pd.Displacement(
                pd.region.All(),
                **dict.fromkeys("xyz"[: len(sides) - 1], 0.0),
                **{"xyz"[len(sides) - 1]: lambda x, t: t * (x[:, -1] > half)},
            )
        ],
        fields=[pd.displacement],
        **given,
    )


def bricks(sides):
    counts = (8, 8, 8)[: len(sides)]
    x = (np.argwhere(np.ones(counts)) + 0.5) * sides
    return pd.Arrays(x, float(np.prod(sides)))


@pytest.mark.parametrize(
    ("sides", "crack"),
    [
        ((1.0, 1.0), pd.Segment((-1.0, 4.0), (9.0, 4.0))),
        ((4.0, 1.0), pd.PlaneCrack((0.0, 4.0), (0.0, 1.0))),
        ((1.0, 4.0), pd.Polyline([(-1.0, 16.2), (4.0, 15.8), (9.0, 16.2)])),
        ((1.0, 1.0, 1.0), pd.Disc((4.0, 4.0, 4.0), (0.0, 0.0, 1.0), 20.0)),
        ((1.0, 2.0, 1.0), pd.PolygonCrack([(-1, -1, 4), (20, -1, 4), (20, 20, 4), (-1, 20, 4)])),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, Crack) else str(value),
)
def test_no_value_is_a_mean_across_a_crack_from_the_start(sides, crack, tmp_path):
    result = pd.run(pulled_apart(sides, [crack], bricks(sides)), tmp_path)
    at = np.random.default_rng(2).uniform(0.02, 0.98, (1500, len(sides))) * np.multiply(8.0, sides)
    at[:750, -1] = np.random.default_rng(3).uniform(3.5, 4.5, 750) * sides[-1]
    far = np.zeros_like(at)
    far[:, :] = at
    far[:, -1] = 0.0
    above = ~crack.cuts(at, np.where(np.arange(len(sides)) == len(sides) - 1, 100.0, at))
    u = pd.open(tmp_path).sample(at)[:, len(sides) - 1]
    assert np.allclose(u, above, rtol=0.0, atol=1e-12) and 500 < above.sum() < 1000
    assert np.allclose(result.sample(at)[:, len(sides) - 1], u)


class Wall(Crack):
    """A crack of a user."""

    def cuts(self, a, b):
        return (a[:, 1] < 4.0) != (b[:, 1] < 4.0)


def test_a_crack_that_the_folder_does_not_know_is_said(tmp_path):
    result = pd.run(pulled_apart((1.0, 1.0), [Wall()], bricks((1.0, 1.0))), tmp_path)
    with pytest.raises(pd.CaseError, match="class Wall"):
        result.sample([(1.0, 1.0)])


def test_no_value_is_a_mean_across_bonds_that_broke(tmp_path):
    """Before they break the field runs through; afterwards each half has its own."""
    case = dataclasses.replace(
        pulled_apart((1.0, 1.0), particles=bricks((1.0, 1.0))),
        conditions=[
            pd.Displacement(pd.region.All(), x=0.0, y=lambda x, t: np.where(x[:, 1] > 4.0, 2.0 * t, 0.1 * t * x[:, 0]))
        ],
        material=pd.BondBased(1.0),
        damage=pd.Brittle(pd.ConstantCritical(0.4)),
        steps=pd.Steps(4),
    )
    result = pd.run(case, tmp_path)
    at = np.random.default_rng(2).uniform(0.1, 7.9, (500, 2))
    at[:, 1] = np.random.default_rng(3).uniform(3.4, 4.6, 500)
    u = result.sample(at)[:, 1]
    assert np.allclose(u, np.where(at[:, 1] > 4.0, 2.0, 0.1 * at[:, 0]), rtol=0.0, atol=1e-9)
    # Before the first step nothing is broken.
    assert np.allclose(result.sample(at, step=0), 0.0)


def holed(kind, tmp_path, n=10):
    """A square, or a box, of simplices without some of its boxes; return its file and what tells where it is."""
    dim = len(kind)
    corners = np.argwhere(np.ones((n + 1,) * dim))
    number = {tuple(corner): k for k, corner in enumerate(corners)}
    boxes = np.argwhere(np.ones((n,) * dim))
    gone = (np.abs(boxes + 0.5 - 0.5 * n) < 2.0).all(axis=1) | (boxes[:, 0] + boxes[:, 1] < 3)
    cells = []
    for box in boxes[~gone]:
        for order in itertools.permutations(range(dim)):
            at = np.array(box)
            cell = [number[tuple(at)]]
            for axis in order:
                at[axis] += 1
                cell.append(number[tuple(at)])
            cells.append(cell)
    points = corners * kind
    path = tmp_path / f"{dim}.msh"
    mesh = meshio.Mesh(in_space(points), [("triangle" if dim == 2 else "tetra", np.array(cells))])
    meshio.write(path, mesh, file_format="gmsh22", binary=False)
    filled = np.zeros((n,) * dim, dtype=bool)
    filled[tuple(boxes[~gone].T)] = True

    def holds(at):
        cell = np.floor(at / kind).astype(int)
        there = ((cell >= 0) & (cell < n)).all(axis=1)
        there[there] = filled[tuple(cell[there].T)]
        return there

    return path, holds


@pytest.mark.parametrize("source", [pd.Mesh, pd.MeshNodes])
@pytest.mark.parametrize("kind", [(1.0, 1.0), (4.0, 1.0), (1.0, 1.0, 1.0)], ids=str)
def test_meshes_are_where_their_surface_says(source, kind, tmp_path):
    dim, n = len(kind), 10 if len(kind) == 2 else 6
    path, holds = holed(kind, tmp_path, n)
    particles = source(path, thickness=2.0) if dim == 2 else source(path)
    case = pd.Case(
        particles=particles,
        horizon=1.6 * max(kind),
        material=pd.LinearElastic(1.0, nu=0.0),
        conditions=[
            pd.Displacement(
                pd.region.All(), **{"xyz"[k]: (lambda x, t, k=k: t * x @ np.roll(SLOPE, k)[:dim]) for k in range(dim)}
            )
        ],
        fields=[pd.displacement],
    )
    result = pd.run(case, tmp_path / "out")
    at = np.random.default_rng(1).uniform(-0.1 * n, 1.1 * n, (3000, dim)) * kind
    there = holds(at)
    u = result.sample(at)
    assert np.array_equal(np.isfinite(u[:, 0]), there) and 300 < there.sum() < len(there) - 300
    assert np.allclose(u[there, 0], at[there] @ SLOPE[:dim], rtol=0.0, atol=1e-9 * n)


def test_a_surface_that_is_open_decides_nothing():
    x = np.argwhere(np.ones((5, 5))) + 0.5 + 0.1 * np.random.default_rng(4).normal(size=(25, 2))
    side = Facets(np.array([[0.0, 2.5]]), np.array([[-5.0, 0.0]]))
    assert type(inside_of(x, np.ones(25), 1.0, side)) is Discs
    ends = np.array([[0.0, 2.5], [5.0, 2.5], [2.5, 0.0], [2.5, 5.0]])
    closed = Facets(ends, 5.0 * np.array([[-1.0, 0.0], [1.0, 0.0], [0.0, -1.0], [0.0, 1.0]]))
    body = inside_of(x, np.ones(25), 1.0, closed)
    assert isinstance(body, Enclosed)
    at = np.random.default_rng(5).uniform(-1.0, 6.0, (2000, 2))
    assert np.array_equal(body.homes(at) >= 0, ((at > 0.0) & (at < 5.0)).all(axis=1))


@pytest.mark.parametrize(("dim", "h"), [(2, 1.0), (2, 1e-9), (3, 1.0)])
def test_bare_clouds_end_where_their_discs_do(dim, h):
    rng = np.random.default_rng(6)
    x = np.argwhere(np.ones((12,) * dim)) + 0.5
    x = (x[np.linalg.norm(x - 6.0, axis=1) > 3.0] + rng.uniform(-0.1, 0.1, (1, dim))) * h
    x += rng.uniform(-0.1, 0.1, x.shape) * h
    body = inside_of(x, np.full(len(x), h**dim), 1.0)
    assert type(body) is Discs
    at = rng.uniform(-0.1, 1.1, (4000, dim)) * 12.0 * h
    found = sampled(in_space(x), x @ SLOPE[:dim], at, body)
    radius = np.linalg.norm(at / h - 6.0, axis=1)
    outwards = np.abs(at / h - 6.0).max(axis=1)
    assert np.isfinite(found[(radius > 4.3) & (outwards < 5.2)]).all()
    assert np.isnan(found[(radius < 1.9) | (outwards > 6.4)]).all()
    there = np.isfinite(found)
    assert np.allclose(found[there], at[there] @ SLOPE[:dim], rtol=0.0, atol=1e-9 * 12.0 * h)


@pytest.mark.long
def test_surfaces_are_the_same_on_any_rank_count(tmp_path):
    path, holds = holed((1.0, 1.0), tmp_path)
    case = tmp_path / "case.py"
    case.write_text(
        "import pdpetsc as pd\n\n\ndef case():\n    return pd.Case(\n"
        f"        particles=pd.Mesh({str(path)!r}), horizon=2.0, material=pd.LinearElastic(1.0, 0.0),\n"
        "        conditions=[pd.Displacement(pd.region.All(), x=lambda x, t: t * x[:, 0], y=0.0)],\n"
        "        fields=[pd.displacement],\n    )\n"
    )
    at = np.random.default_rng(1).uniform(-1.0, 11.0, (500, 2))
    found = []
    for ranks in (1, 3):
        done = in_shell(str(case), "-o", str(tmp_path / str(ranks)), ranks=ranks)
        assert done.returncode == 0, done.stderr
        found.append(pd.open(tmp_path / str(ranks)).sample(at)[:, 0])
    assert np.array_equal(np.isfinite(found[0]), holds(at))
    assert np.allclose(found[0], found[1], rtol=0.0, atol=1e-12, equal_nan=True)


def test_facets_of_a_solid_whose_outline_nobody_knows_hold_nothing_that_is_outside(tmp_path):
    """Next to edges they may not tell; there is then no value, but never one outside."""
    path, holds = holed((1.0, 1.0, 1.0), tmp_path, 6)
    mesh = pd.Mesh(path)
    whole, (x, area, _, _) = mesh.chunk(0, 1), mesh.surface(0, 1).arrays
    at = np.random.default_rng(1).uniform(-0.6, 6.6, (4000, 3))
    found = inside_of(whole.x, whole.volume, 1.0, Facets(x, area)).homes(at) >= 0
    there = holds(at)
    assert not (found & ~there).any()
    assert (found & there).sum() > 0.8 * there.sum()


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_particles_at_corners_of_cells_fill_all_of_these(dim):
    cut = pd.region.Box((2.0,) * dim, (4.0,) * dim)
    particles = pd.LatticeNodes((0.0,) * dim, (6.0,) * dim, 1.0, 2.0 if dim < 3 else 1.0, cut=cut)
    whole, surface = particles.chunk(0, 1), particles.surface(0, 1).arrays
    triangles = [particles.triangles(part, 3) for part in range(3)]
    facets = Facets(*surface[:2], *([np.concatenate(triangles)] if dim == 3 else []))
    at = np.random.default_rng(1).uniform(-1.0, 7.0, (2000, dim))
    found = inside_of(whole.x, whole.volume, particles.thickness, facets).homes(at) >= 0
    there = ((at > 0.0) & (at < 6.0)).all(axis=1) & ~((at > 2.0) & (at < 4.0)).all(axis=1)
    assert np.array_equal(found, there)


@pytest.mark.parametrize("kind", [pd.Lattice, pd.LatticeNodes])
@pytest.mark.parametrize("other", [pd.Lattice, pd.LatticeNodes])
@pytest.mark.parametrize("dim", [2, 3])
def test_points_have_the_value_of_their_own_body(kind, other, dim, tmp_path):
    """A block on another one of finer spacing slides and turns: both have their own linear field up to the surface."""
    low, high, up = np.zeros(dim), np.ones(dim), np.eye(dim)[1]
    parts = {"lower": kind(low, high, 0.25), "upper": other(low + up, high + up, 0.2)}
    slide = pd.Displacement("upper", **{"x": lambda x, t: 0.5 - 0.1 * x[:, 1]}, **dict.fromkeys("yz"[: dim - 1], 0.0))
    case = pd.Case(
        particles=pd.Bodies(parts),
        material=pd.LinearElastic(E=1.0, nu=0.3),
        conditions=[pd.Displacement("lower", **dict.fromkeys("xyz"[:dim], 0.0)), slide],
        fields=[pd.displacement],
    )
    run = pd.run(case, tmp_path)
    at = np.full((60, dim), 0.47)
    at[:, 0], at[:, 1] = np.tile(np.linspace(0.03, 0.97, 10), 6), np.repeat([0.7, 0.93, 0.999, 1.001, 1.04, 1.3], 10)
    exact = np.where(at[:, 1] < 1.0, 0.0, 0.5 - 0.1 * at[:, 1])
    np.testing.assert_allclose(run.sample(at)[:, 0], exact, atol=1e-9)


def test_particles_on_two_bodies_are_compared_in_their_own_body(tmp_path):
    """Runs with other spacings have equal fields, also at nodes on the surface where two bodies touch."""
    runs = {}
    for n in (4, 5):
        lower = pd.LatticeNodes((0.0, 0.0), (1.0, 1.0), 1.0 / n)
        upper = pd.LatticeNodes((0.0, 1.0), (1.0, 2.0), 1.0 / n)
        case = pd.Case(
            particles=pd.Bodies({"lower": lower, "upper": upper}),
            material=pd.LinearElastic(E=1.0, nu=0.3),
            conditions=[
                pd.Displacement("lower", x=0.0, y=0.0),
                pd.Displacement("upper", x=lambda x, t: 0.5 - 0.1 * x[:, 1], y=0.0),
            ],
            fields=[pd.displacement],
        )
        runs[str(n)] = pd.run(case, tmp_path / str(n))
    np.testing.assert_allclose(pd.compare(runs).difference("displacement")["5"], 0.0, atol=1e-9)


@pytest.mark.parametrize("first", ["block", "row"])
def test_a_list_of_numbers_is_one_point_if_only_one_of_several_bodies_is_a_line(first, tmp_path):
    parts = {"block": pd.Lattice((0.0, 0.0), (1.0, 1.0), 0.25), "row": pd.Lattice((0.0, 1.0), (1.0, 1.25), 0.25)}
    case = pd.Case(
        particles=pd.Bodies(dict(sorted(parts.items(), key=lambda part: part[0] != first))),
        material=pd.BondBased(E=1.0),
        conditions=[pd.Displacement("block", x=0.0, y=0.0), pd.Displacement("row", x=1.0, y=0.0)],
        horizon=0.76,
        fields=[pd.displacement],
    )
    run = pd.run(case, tmp_path)
    assert run.sample([0.4, 0.5])[:, 0].tolist() == [0.0]
    assert run.sample([0.4, 1.1])[:, 0] == pytest.approx([1.0], rel=1e-9)
