"""Conforming weights: patch tests on any cloud without a held layer, surfaces, loads on facets, refusals."""

import itertools
import json
import sys
import textwrap

import meshio
import numpy as np
import pytest
from scipy.spatial import Delaunay

import pdpetsc as pd
from pdpetsc.declare.cells import Block, shares_of_nodes
from pdpetsc.discrete.cloud import distribute
from pdpetsc.discrete.communicator import world
from pdpetsc.discrete.families import find_families
from pdpetsc.discrete.surface import surface_of
from pdpetsc.gradient import near_inverse
from pdpetsc.petsc.conforming import solve_conforming
from tests.commands import ROOT, jacobian_ratios, printed, python_on, results
from tests.pairs import pairs

sys.path.append(str(ROOT / "runs/contact"))
import refined

TENSION = "runs/patch/tension.py"


def tension(tmp_path, *words, ranks=1):
    given = ("weights=conforming", "distribution=surface", *words)
    return results(TENSION, *given, output=tmp_path, ranks=ranks)["results"]["max_F_error"]


SOLIDS = [(scheme, 3, shake) for scheme in pd.SCHEMES for shake in (0.0, 0.3)]


@pytest.mark.parametrize(
    ("scheme", "dim", "shake"),
    [
        *pairs(pd.SCHEMES, [1, 2], [0.0, 0.3]),
        *(pytest.param(*row, marks=[] if row == ("sub_horizons", 3, 0.3) else pytest.mark.long) for row in SOLIDS),
    ],
)
def test_a_uniform_traction_gives_a_uniform_gradient_on_any_cloud(scheme, dim, shake, tmp_path):
    G = 0.5 if scheme in ("correspondence", "corrected", "higher_order") else 0.0
    # The least horizons with which families of every scheme leave something to change, on lattices and shaken clouds.
    least = {1: 2.715, 2: 1.715, 3: 2.015}[dim] if shake else {1: 2.015, 2: 1.515, 3: 2.015}[dim]
    for horizon in (least,) if dim == 3 else (least, 3.015):
        words = (f"dim={dim}", f"scheme={scheme}", f"horizon={horizon}", f"shake={shake}", f"G={G}")
        assert tension(tmp_path, *words, f"n={5 if dim == 3 else 10}") < 1e-8


def test_standard_weights_do_not_on_a_shaken_cloud(tmp_path):
    found = results(TENSION, "distribution=surface", "shake=0.3", output=tmp_path)["results"]
    assert found["max_F_error"] > 0.2 * found["strain"]


LONG = pytest.mark.long


@pytest.mark.parametrize("ranks", [2, pytest.param(3, marks=LONG), pytest.param(4, marks=LONG)])
def test_any_number_of_ranks_gives_the_same(ranks, tmp_path):
    words = ("dim=2", "shake=0.3", "horizon=2.015")
    assert tension(tmp_path, *words, ranks=ranks) < 1e-8


def shaken_plate(n=8, shake=0.3, thickness=1.0, unit=1.0, seed=2, **changes):
    """Return a plate 2 x 1 on a shaken cloud, in any unit of length and with any thickness, and its lattice."""
    dx = unit / n
    lattice = pd.Lattice((0.0, 0.0), (2.0 * unit, unit), dx, thickness=thickness)
    x = lattice.chunk(0, 1).x
    x = x + shake * dx * np.random.default_rng(seed).uniform(-1.0, 1.0, x.shape)
    return pd.Arrays(x, dx**2 * thickness, thickness=thickness, facets=lattice.surface(), **changes)


def pieces(particles, horizon, cell=None, cracks=(), symmetry=()):
    """Return cloud, families and surface of particles on this process."""
    part = particles.chunk(0, 1)
    cloud = distribute(world(), part.x, part.volume, part.sets, horizon, cell, symmetry)
    families = find_families(cloud, cracks)
    return cloud, families, surface_of(cloud, families, particles.surface(0, 1, cracks))


def weights_of(particles, horizon, scheme=None, **more):
    """Return cloud, surface and conforming operator of particles."""
    cloud, families, surface = pieces(particles, horizon, **more)
    scheme = pd.Correspondence() if scheme is None else scheme
    plain = scheme.build(cloud, families, np.ones(len(families.neighbours)))
    return cloud, surface, plain, pd.Conforming().of(plain, cloud, families, surface, solve_conforming)


def sums_over_points(cloud, operator):
    """Return sum_p W_p g_pk (n_owned, dim) as a plain loop, images added to their particles."""
    found = np.zeros((cloud.n_local, cloud.dim))
    for p in range(operator.n_points):
        for t in range(operator.point_ptr[p], operator.point_ptr[p + 1]):
            found[operator.members[t]] += operator.volume[p] * operator.g[t]
    np.add.at(found, np.searchsorted(np.sort(cloud.gid[: cloud.n_owned]), cloud.gid[cloud.n_owned :]),
              found[cloud.n_owned :])  # fmt: skip
    return found[: cloud.n_owned]


GRIDS = {
    "plate": (shaken_plate(), 2.515 / 8, {}),
    "mirror planes": (shaken_plate(), 2.515 / 8, {"symmetry": [pd.Symmetry("x", 0.0), pd.Symmetry("y", 0.0)]}),
    "cell": (shaken_plate(shake=0.2), 2.515 / 8, {"cell": pd.Cell((0.0, 0.0), (2.0, 1.0), axes="x")}),
    "crack": (
        pd.Lattice((0.0, 0.0), (2.0, 1.0), 0.1),
        0.3015,
        {"cracks": [pd.Segment((0.55, 0.5), (1.45, 0.5))]},
    ),
    "solid": (pd.Lattice((0.0, 0.0, 0.0), (1.0, 0.6, 0.6), 0.1), 0.2015, {}),
    "solid half": (
        pd.Lattice((0.0, 0.0, 0.0), (1.0, 0.6, 0.6), 0.1),
        0.2015,
        {"symmetry": [pd.Symmetry("z", 0.0)]},
    ),
}


@pytest.mark.parametrize("scene", GRIDS)
def test_a_grid_and_nearest_neighbours_lead_to_the_same_weights(scene, monkeypatch):
    particles, horizon, more = GRIDS[scene]
    found = []
    for enough, most in ((near_inverse.ENOUGH, near_inverse.MOST_ON_GRID), (np.inf, 0), (near_inverse.ENOUGH, 3)):
        # The last one does not end on the grid, and goes on with nearest neighbours.
        monkeypatch.setattr(near_inverse, "ENOUGH", enough)
        monkeypatch.setattr(near_inverse.OnGrid, "most", most)
        found.append(weights_of(particles, horizon, **more)[3])
    scale = np.abs(found[1].g).max()
    for operator in found:
        assert np.abs(operator.g - found[1].g).max() < 1e-8 * scale
    assert int(found[0].note.split(" iterations")[0].split()[-1]) < 60


def test_mirror_planes_cost_no_iterations():
    planes = [pd.Symmetry("x", 0.0), pd.Symmetry("y", 0.0)]
    whole, quarter = (
        weights_of(shaken_plate(n=32), 2.515 / 32, symmetry=some)[3].note.split(" iterations")[0].split()[-1]
        for some in ([], planes)
    )
    assert int(quarter) <= int(whole) + 3


@pytest.mark.parametrize("scheme", [pd.Correspondence(), pd.SubHorizons()])
@pytest.mark.parametrize("thickness", [1.0, 0.25])
def test_linear_fields_are_exact_and_the_divergence_theorem_holds(scheme, thickness):
    cloud, surface, plain, operator = weights_of(shaken_plate(thickness=thickness), 2.015 / 8, scheme)
    of = np.repeat(np.arange(operator.n_points), np.diff(operator.point_ptr))
    zero, one = np.zeros((operator.n_points, 2)), np.zeros((operator.n_points, 2, 2))
    np.add.at(zero, of, operator.g)
    np.add.at(one, of, np.einsum("ki,km->kim", cloud.x[operator.members], operator.g))
    assert np.abs(zero).max() < 1e-10 * np.abs(operator.g).max()
    assert np.abs(one - np.eye(2)).max() < 1e-10
    s = np.zeros_like(cloud.x)
    for f in range(len(surface.x)):
        for t in range(surface.ptr[f], surface.ptr[f + 1]):
            s[surface.members[t]] += surface.N[t] * surface.area[f]
    size = np.abs(sums_over_points(cloud, plain)).max()
    assert np.abs(sums_over_points(cloud, plain) - s).max() > 1e-2 * size
    assert np.abs(sums_over_points(cloud, operator) - s).max() < 1e-9 * size


@pytest.mark.parametrize("core", [1e-2, 1e-3, 1e-4])
def test_linear_fields_are_exact_on_strongly_graded_clouds(core):
    """The multipliers exceed the changes of the weights by many orders: their round-off was an error of 1e-9."""
    points, cells = refined.corner(8, core, 2.0, 2)
    graded = refined.disc(refined.ball(points, 1.0), cells, 1.0)
    cloud, _, _, operator = weights_of(graded.particles, 2.1 * graded.size)
    assert "conforming weights" in operator.note
    relative = cloud.x[operator.members] - cloud.x[np.repeat(operator.owner, np.diff(operator.point_ptr))]
    gradient = np.add.reduceat(relative[:, :, None] * operator.g[:, None, :], operator.point_ptr[:-1])
    assert np.abs(gradient - np.eye(2)).max() < 1e-12


def test_the_change_is_the_least_one():
    """Of all changes with the same sums per point and per particle none is smaller: least squares by NumPy."""
    cloud, _, plain, operator = weights_of(shaken_plate(n=3), 2.015 / 3)
    n, entries = cloud.n_owned, len(plain.members)
    of = np.repeat(np.arange(plain.n_points), np.diff(plain.point_ptr))
    rows = [np.zeros((n, entries)), np.zeros((plain.n_points, entries))]
    rows[0][plain.members, np.arange(entries)] = plain.volume[of]
    rows[1][of, np.arange(entries)] = 1.0
    for axis in range(2):
        moment = np.zeros((plain.n_points, entries))
        moment[of, np.arange(entries)] = cloud.x[plain.members, axis] - cloud.x[plain.owner[of], axis]
        rows.append(moment)
    A = np.concatenate(rows)
    change = operator.g - plain.g
    least = np.linalg.lstsq(A, A @ change, rcond=None)[0]
    assert np.abs(change).max() > 0.01 * np.abs(plain.g).max()
    np.testing.assert_allclose(change, least, atol=1e-7 * np.abs(change).max())


@pytest.mark.parametrize("unit", [1e-9, 1e9])
def test_weights_do_not_depend_on_the_unit_of_length(unit):
    _, _, _, one = weights_of(shaken_plate(), 2.015 / 8)
    _, _, _, other = weights_of(shaken_plate(unit=unit), 2.015 / 8 * unit)
    np.testing.assert_allclose(other.g * unit, one.g, atol=1e-8 * np.abs(one.g).max())


def test_weights_of_a_line_with_the_least_families_are_those_of_the_scheme():
    cloud, _, plain, operator = weights_of(pd.Lattice(0.0, 5.0, 0.5, thickness=2.0), 1.015 * 0.5)
    np.testing.assert_array_equal(operator.g, plain.g)
    assert cloud.n_owned == 10


def uniform(case_particles, horizon, ends, scheme="correspondence", material=None, **more):
    """Return the case of a body under uniform tension along x, in plane strain with free sides, and its exact F."""
    material = pd.Hencky(E=1000.0, nu=0.3) if material is None else material
    nu, pull = 0.3, 1.0
    # Small enough a strain for the linear solution to be compared with, to second order.
    exact = np.diag([(1.0 - nu**2) * pull / 1000.0, -nu * (1.0 + nu) * pull / 1000.0])
    x = case_particles.chunk(0, 1).x
    low, far = x[np.argmin(x.sum(axis=1))], x[np.argmax(x[:, 0] - x[:, 1])]

    def along(axis):
        return lambda x, t: exact[axis, axis] * x[:, axis]

    return pd.Case(
        particles=case_particles,
        horizon=horizon,
        material=material,
        scheme=pd.SCHEMES[scheme],
        weights=pd.Conforming(),
        control=pd.Silling(0.5) if scheme == "correspondence" else None,
        conditions=[
            pd.Displacement(pd.region.Nearest(low), x=along(0), y=along(1)),
            pd.Displacement(pd.region.Nearest(far), y=along(1)),
            pd.Traction(ends[0], x=-pull),
            pd.Traction(ends[1], x=pull),
        ],
        history={"F": pd.LargestError(pd.deformation_gradient, lambda x, t: np.eye(2) + t * exact)},
        results=lambda h: {"F": h["F"][-1]},
        **more,
    )


def test_a_hole_in_the_cloud_has_a_surface_too(tmp_path):
    """A pressure on the whole surface, of the hole too, gives the uniform state of the body without it."""
    plate = pd.Lattice((0.0, 0.0), (2.0, 1.0), 0.1, cut=pd.region.Box((0.8, 0.4), (1.2, 0.6)))
    p, E, nu = 2.0, 1000.0, 0.3
    exact = -(1.0 + nu) * (1.0 - 2.0 * nu) * p / E
    x = plate.chunk(0, 1).x
    case = pd.Case(
        particles=plate, horizon=0.2015, material=pd.LinearElastic(E=E, nu=nu), weights=pd.Conforming(),
        conditions=[
            pd.Displacement(pd.region.Nearest(x[0]), x=exact * x[0, 0], y=exact * x[0, 1]),
            pd.Displacement(pd.region.Nearest((1.95, 0.05)), y=exact * 0.05),
            pd.Pressure(pd.region.All(), p),
        ],
        history={"F": pd.LargestError(pd.deformation_gradient, lambda x, t: (1.0 + t * exact) * np.eye(2))},
        results=lambda h: {"F": h["F"][-1]},
    )  # fmt: skip
    assert pd.run(case, tmp_path)["F"] < 1e-9 * abs(exact) + 1e-12


def square_mesh(n, seed=0, shake=0.25):
    """Return an unstructured triangle mesh of a plate 2 x 1 with the lines of its ends as groups."""
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.linspace(0.0, 2.0, 2 * n + 1), np.linspace(0.0, 1.0, n + 1), indexing="ij")
    points = np.stack([x.ravel(), y.ravel()], axis=1)
    inner = (points > 1e-9).all(axis=1) & (points < np.array([2.0, 1.0]) - 1e-9).all(axis=1)
    points[inner] += shake / n * rng.uniform(-1.0, 1.0, (int(inner.sum()), 2))
    triangles = Delaunay(points).simplices
    sides = points[triangles]
    area = 0.5 * np.abs(np.cross(sides[:, 1] - sides[:, 0], sides[:, 2] - sides[:, 0]))
    triangles = triangles[area > 1e-9]
    ends = []
    for end in (0.0, 2.0):
        nodes = np.flatnonzero(np.abs(points[:, 0] - end) < 1e-12)
        nodes = nodes[np.argsort(points[nodes, 1])]
        ends.append(np.stack([nodes[:-1], nodes[1:]], axis=1))
    return points, triangles, ends


def written(path, n=6, kind="triangle"):
    points, triangles, ends = square_mesh(n)
    lines = np.concatenate(ends)
    sets = {
        "left": [np.empty(0, int), np.arange(len(ends[0]))],
        "right": [np.empty(0, int), len(ends[0]) + np.arange(len(ends[1]))],
        "body": [np.arange(len(triangles)), np.empty(0, int)],
    }
    mesh = meshio.Mesh(points, [(kind, triangles), ("line", lines)], cell_sets=sets)
    mesh.write(path)
    return path


@pytest.mark.parametrize("scheme", ["correspondence", "sub_horizons"])
@pytest.mark.parametrize("at", [pd.Mesh, pd.MeshNodes])
def test_unstructured_meshes_pass_the_patch_test(at, scheme, tmp_path):
    mesh = at(written(tmp_path / "plate.xdmf"))
    ends = [pd.region.Slab("x", high=1e-9), pd.region.Slab("x", low=2.0 - 1e-9)]
    case = uniform(mesh, 2.2 / 6, ends, scheme, material=pd.LinearElastic(E=1000.0, nu=0.3))
    assert pd.run(case, tmp_path / "out")["F"] < 1e-8 * 1e-3


def test_tags_of_a_lattice_and_regions_give_the_same_load(tmp_path):
    lattice = pd.Lattice((0.0, 0.0), (2.0, 1.0), 0.125, thickness=0.5)
    named = [pd.region.Named("-x"), pd.region.Named("+x")]
    placed = [pd.region.Slab("x", high=1e-9), pd.region.Slab("x", low=2.0 - 1e-9)]
    material = pd.LinearElastic(E=1000.0, nu=0.3)
    found = [pd.run(uniform(lattice, 0.252, ends, material=material), tmp_path) for ends in (named, placed)]
    np.testing.assert_array_equal(found[0].gathered(pd.displacement), found[1].gathered(pd.displacement))
    assert found[0]["F"] < 1e-11
    resultants = np.array([load["resultant"] for load in found[0].summary["loads"]])
    np.testing.assert_allclose(resultants, [[-0.5, 0.0], [0.5, 0.0]], rtol=1e-13)


def test_the_resultant_and_the_moment_of_a_pressure_on_a_curved_face_are_exact():
    """Of a quarter of the circle of a polygon: the resultant of a pressure is that on its two straight cuts."""
    angle = np.linspace(0.0, 2.0 * np.pi, 49)[:-1]
    rings = [np.stack([r * np.cos(angle), r * np.sin(angle)], axis=1) for r in (1.0, 1.15, 1.3, 1.5)]
    quads, facets = [], {"x": [], "area": [], "particle": [], "tags": []}
    x, volume = [], []
    for a, (inner, outer) in enumerate(itertools.pairwise(rings)):
        for k in range(48):
            corners = np.array([inner[k], outer[k], outer[(k + 1) % 48], inner[(k + 1) % 48]])
            half = [corners[[0, 1, 2]], corners[[0, 2, 3]]]
            sizes = [0.5 * np.cross(t[1] - t[0], t[2] - t[0]) for t in half]
            volume.append(sum(sizes))
            x.append(sum(size * t.mean(axis=0) for size, t in zip(sizes, half, strict=True)) / sum(sizes))
            sides = [(corners[3], corners[0], a == 0), (corners[1], corners[2], a == 2)]
            for begin, end, free in sides:
                if free:
                    along = end - begin
                    facets["x"].append(0.5 * (begin + end))
                    facets["area"].append([along[1], -along[0]])
                    facets["particle"].append(len(x) - 1)
                    facets["tags"].append(a == 0)
            quads.append(corners)
    inside = np.array(facets.pop("tags"))
    particles = pd.Arrays(np.array(x), np.array(volume), facets=pd.Facets(**facets, tags={"inside": inside}))
    _, _, surface = pieces(particles, 0.4)
    quarter = inside & (surface.x[:, 0] > 0.0) & (surface.x[:, 1] > 0.0)
    loads = np.where(quarter[:, None], -3.0 * surface.area, 0.0)
    f = np.zeros((len(x), 2))
    surface.spread(loads, f)
    np.testing.assert_allclose(f.sum(axis=0), [3.0, 3.0], rtol=1e-12)
    moment = (np.array(x)[:, 0] * f[:, 1] - np.array(x)[:, 1] * f[:, 0]).sum()
    assert abs(moment) < 1e-12


def test_dual_cells_fill_the_body():
    points, triangles, _ = square_mesh(5)
    nodes, volume = shares_of_nodes(points, [Block("triangle", triangles)])
    assert len(nodes) == len(points)
    assert volume.sum() == pytest.approx(2.0, rel=1e-13)
    # A quadrilateral cell shares equally.
    corners = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [0.0, 1.0]])
    np.testing.assert_allclose(shares_of_nodes(corners, [Block("quad", np.array([[0, 1, 2, 3]]))])[1], 0.5)


@pytest.mark.parametrize("ranks", [1, 2])
def test_the_tangent_is_exact_and_symmetric(ranks, tmp_path):
    words = ("n=4", "dim=2", "shake=0.3", "horizon=2.015", "-snes_test_jacobian", "distribution=surface")
    ratios = jacobian_ratios(printed(TENSION, *words, "weights=conforming", ranks=ranks, output=tmp_path))
    assert ratios
    assert max(ratios) < 1e-7


def test_forces_balance_and_the_body_may_turn(tmp_path):
    prepared = pd.prepare(uniform(shaken_plate(), 0.26, [pd.region.Named("-x"), pd.region.Named("+x")]))
    problem, x = prepared.problem, prepared.cloud.x[: prepared.cloud.n_owned]
    u = 0.05 * np.random.default_rng(0).uniform(-1.0, 1.0, x.shape) / 8
    f = problem.internal_force(problem.state(u))
    scale = np.abs(f).max()
    assert np.abs(f.sum(axis=0)).max() < 1e-10 * scale
    y = x + u
    assert abs((y[:, 0] * f[:, 1] - y[:, 1] * f[:, 0]).sum()) < 1e-10 * scale
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    turned = problem.internal_force(problem.state(y @ turn.T - x))
    np.testing.assert_allclose(turned, f @ turn.T, atol=1e-9 * scale)


@pytest.mark.parametrize("axes", ["x", "xy"])
def test_periodic_cells_conform(axes):
    """Images take part, and the sides of the cell are no surface: of a whole periodic cell nothing is left over."""
    particles = shaken_plate(n=6)
    x = particles.chunk(0, 1).x
    x[:, : len(axes)] %= np.array([2.0, 1.0])[: len(axes)]
    lattice = pd.Lattice((0.0, 0.0), (2.0, 1.0), 1.0 / 6)
    particles = pd.Arrays(x, particles.volume, facets=lattice.surface())
    cell = pd.Cell((0.0, 0.0), (2.0, 1.0), axes=axes)
    cloud, surface, _, operator = weights_of(particles, 0.34, cell=cell)
    assert len(surface.x) == (0 if axes == "xy" else 24)
    s = np.zeros_like(cloud.x)
    surface.spread(surface.area, s)
    np.add.at(s, np.searchsorted(np.sort(cloud.gid[: cloud.n_owned]), cloud.gid[cloud.n_owned :]), s[cloud.n_owned :])
    order = np.argsort(cloud.gid[: cloud.n_owned])
    left = sums_over_points(cloud, operator)
    assert (np.diff(order) == 1).all()
    assert np.abs(left - s[: cloud.n_owned]).max() < 1e-8 * np.abs(operator.g).max() * operator.volume.max()


def test_a_crack_from_the_start_is_a_surface_on_both_sides(tmp_path):
    """Pulled along it, a cracked plate is in the uniform state: the crack opens nothing and disturbs nothing."""
    plate = pd.Lattice((0.0, 0.0), (2.0, 1.0), 0.1)
    crack = pd.Segment((0.55, 0.5), (1.45, 0.5))
    cloud, _, surface = pieces(plate, 0.2015, cracks=[crack])
    assert len(surface.x) == 60 + 2 * 10
    ends = [pd.region.Slab("x", high=1e-9), pd.region.Slab("x", low=2.0 - 1e-9)]
    case = uniform(plate, 0.2015, ends, material=pd.LinearElastic(E=1000.0, nu=0.3), cracks=[crack])
    assert pd.run(case, tmp_path)["F"] < 1e-11
    assert cloud.n_owned == 200


def test_a_plate_that_a_crack_cuts_in_two_conforms_in_both_halves():
    plate = shaken_plate(n=6, shake=0.0)
    lattice = pd.Lattice((0.0, 0.0), (2.0, 1.0), 1.0 / 6)
    cloud, surface, _, operator = weights_of(lattice, 0.34, cracks=[pd.PlaneCrack((1.0, 0.5), (1.0, 0.0))])
    s = np.zeros_like(cloud.x)
    surface.spread(surface.area, s)
    np.testing.assert_allclose(sums_over_points(cloud, operator), s, atol=1e-9)
    left = cloud.x[:, 0] < 1.0
    assert np.abs(s[left].sum(axis=0)).max() < 1e-13
    assert len(plate.chunk(0, 1).x) == cloud.n_owned


@pytest.mark.parametrize("scheme", [pd.Correspondence(), pd.SubHorizons()])
def test_pieces_of_a_body_conform_each(scheme):
    """Linear functions of one piece alone are in the null space too: iterations neither stagnate nor grow much."""
    large, small = pd.Lattice((0.0, 0.0), (1.0, 1.0), 0.1), pd.Lattice((3.0, 0.0), (3.5, 0.3), 0.1)
    x, area, particle, _ = [
        np.concatenate(both) for both in zip(*(one.surface().arrays[:3] for one in (large, small)), strict=True)
    ] + [0]
    particle[len(large.surface().arrays[0]) :] += 100
    places = np.concatenate([large.chunk(0, 1).x, small.chunk(0, 1).x])
    places += 0.03 * np.random.default_rng(0).uniform(-1.0, 1.0, places.shape)
    cloud, surface, _, operator = weights_of(pd.Arrays(places, 0.01, facets=pd.Facets(x, area, particle)), 0.22, scheme)
    s = np.zeros_like(cloud.x)
    surface.spread(surface.area, s)
    np.testing.assert_allclose(sums_over_points(cloud, operator), s, atol=1e-9 * np.abs(operator.g).max() * 0.01)
    iterations = int(operator.note.split(" iterations")[0].split()[-1])
    assert iterations < 200


REFUSED = {
    "open": (lambda f: pd.Facets(f.arrays[0][1:], f.arrays[1][1:], f.arrays[2][1:]), "is open"),
    "inverted": (lambda f: pd.Facets(f.arrays[0], -f.arrays[1], f.arrays[2]), "encloses a volume of -2"),
    "too large": (lambda f: pd.Facets(1.1 * f.arrays[0], f.arrays[1], f.arrays[2]), "encloses a volume of 2.2"),
}


@pytest.mark.parametrize("wrong", REFUSED)
def test_a_surface_that_is_not_that_of_the_particles_is_refused(wrong, tmp_path):
    plate = shaken_plate()
    change, words = REFUSED[wrong]
    particles = pd.Arrays(plate.x, plate.volume, facets=change(plate.facets))
    with pytest.raises(pd.CaseError, match=words):
        pd.prepare(uniform(particles, 0.26, [pd.region.All(), pd.region.All()]))


def test_facets_of_other_particles_are_refused():
    """Closed, and around the right volume, but each with the number of another particle."""
    plate = shaken_plate()
    x, area, particle, _ = plate.facets.arrays
    particles = pd.Arrays(plate.x, plate.volume, facets=pd.Facets(x, area, np.roll(particle, 7)))
    with pytest.raises(pd.CaseError, match="more than one horizon away"):
        pd.prepare(uniform(particles, 0.26, [pd.region.All(), pd.region.All()]))


def meeting(points, triangles, other_points, other_triangles):
    """Return one mesh of two without common nodes."""
    nodes = np.concatenate([triangles, other_triangles + len(points)])
    return np.concatenate([points, other_points]), nodes


def test_parts_of_a_mesh_without_common_nodes_are_refused(tmp_path):
    """Bonds join them, and each has a surface where they touch: with equal nodes there, and with others."""
    points, triangles, _ = square_mesh(4)
    for n in (4, 5):
        others, more, _ = square_mesh(n, seed=1)
        both = meeting(points, triangles, others + np.array([2.0, 0.0]), more)
        meshio.Mesh(both[0], [("triangle", both[1])]).write(tmp_path / "two.xdmf")
        ends = [pd.region.Slab("x", high=1e-9), pd.region.Slab("x", low=4.0 - 1e-9)]
        with pytest.raises(pd.CaseError, match="join the nodes of cells that touch there"):
            pd.prepare(uniform(pd.Mesh(tmp_path / "two.xdmf"), 0.55, ends))


@pytest.mark.parametrize("thickness", [1.0, 1e-3])
def test_a_mirror_plane_or_a_cell_a_little_off_is_refused(thickness, tmp_path):
    """Bonds go across, and the facets beside would be a surface that nobody sees."""
    lattice = pd.Lattice((0.0, 0.0), (2.0, 1.0), 0.125, thickness=thickness)
    ends = [pd.region.Named("-x"), pd.region.Named("+x")]
    for at in (-1e-5, -0.02):
        with pytest.raises(pd.CaseError, match="on a mirror plane match it"):
            pd.prepare(uniform(lattice, 0.26, ends, symmetry=[pd.Symmetry("y", at)]))
    for high in (1.0 + 1e-7, 1.02):
        with pytest.raises(pd.CaseError, match="opposite sides of a periodic cell"):
            pd.prepare(uniform(lattice, 0.26, ends, cell=pd.Cell((0.0, 0.0), (2.0, high), axes="y")))


def test_a_crack_along_the_side_of_a_cell_is_a_surface():
    lattice = pd.Lattice((0.0, 0.0), (2.0, 1.0), 0.125)
    cell = pd.Cell((0.0, 0.0), (2.0, 1.0), axes="xy")
    _, _, surface = pieces(lattice, 0.26, cell=cell, cracks=[pd.Segment((0.5, 0.0), (1.0, 0.0))])
    assert len(surface.x) == 2 * 4
    np.testing.assert_allclose(np.abs(surface.area).sum(axis=0), [0.0, 2 * 0.5])


def test_weights_that_would_be_others_are_refused_and_large_changes_said():
    """Sub-horizons of the nearest particles of an irregular cloud have hardly a number that is free."""
    plate = shaken_plate(seed=0)
    with pytest.raises(pd.CaseError, match=r"times what they are, most of all by .* widen the horizon"):
        weights_of(plate, 1.515 / 8, pd.SubHorizons())
    assert "leave little to choose" in weights_of(plate, 1.515 / 8, pd.BondAssociated())[3].note
    assert "leave little to choose" not in weights_of(plate, 1.6 / 8, pd.SubHorizons())[3].note


def test_particles_without_a_surface_are_refused():
    plate = shaken_plate()
    with pytest.raises(pd.CaseError, match="has no known surface"):
        pd.prepare(uniform(pd.Arrays(plate.x, plate.volume), 0.26, [pd.region.All(), pd.region.All()]))


def test_families_that_leave_no_choice_are_refused():
    """Sub-horizons of the nearest neighbours have three members: no number is free to change."""
    with pytest.raises(pd.CaseError, match="No conforming weights were found"):
        weights_of(pd.Lattice((0.0, 0.0), (2.0, 1.0), 0.125), 0.13, pd.SubHorizons())


def test_bodies_of_bonds_have_no_weights():
    with pytest.raises(pd.CaseError, match="A body of bonds has no weights"):
        pd.Case(
            particles=pd.Lattice((0.0, 0.0), (2.0, 1.0), 0.25), horizon=0.51, material=pd.BondBased(E=1.0),
            conditions=[], weights=pd.Conforming(),
        )  # fmt: skip


@pytest.mark.parametrize(
    ("traction", "words"),
    [
        (lambda: pd.Traction(pd.region.Box((0.5, 0.3), (1.5, 0.7)), x=1.0), "holds no facet of the surface"),
        (lambda: pd.Traction(pd.region.Named("hole"), x=1.0), "no set 'hole'"),
        (
            lambda: pd.Traction(pd.region.Named("+x"), x=1.0, normal=(-1.0, 0.0), distribution="surface"),
            "looks along its normal",
        ),
    ],
)
def test_a_load_on_no_surface_is_refused(traction, words):
    case = uniform(shaken_plate(), 0.26, [pd.region.Named("-x"), pd.region.Named("+x")])
    with pytest.raises(pd.CaseError, match=words):
        pd.prepare(pd.Case(**{**vars(case), "conditions": [*case.conditions[:2], traction()]}))


@pytest.mark.parametrize(
    ("words", "given"),
    [
        ("same shape", {"x": [[0.0, 0.0]], "area": [[1.0]], "particle": [0]}),
        ("not finite", {"x": [[np.nan]], "area": [[1.0]], "particle": [0]}),
        ("number of one particle", {"x": [[0.0]], "area": [[1.0]], "particle": [0.5]}),
        ("particle number -1", {"x": [[0.0]], "area": [[1.0]], "particle": [-1]}),
        ("Tag 'end'", {"x": [[0.0]], "area": [[1.0]], "particle": [0], "tags": {"end": [0]}}),
    ],
)
def test_facets_that_are_none_are_refused(words, given):
    with pytest.raises(pd.CaseError, match=words):
        pd.Facets(**given)


DAMAGED = """
    import sys
    import numpy as np
    import pdpetsc as pd

    def case(weights="conforming", pull=0.06, steps=12):
        dx = 0.1
        left, right = pd.region.Slab("x", high=1e-9), pd.region.Slab("x", low=2.0 - 1e-9)
        held = pd.region.Slab("x", high=2 * dx), pd.region.Slab("x", low=2.0 - 2 * dx)
        return pd.Case(
            particles=pd.Lattice((0.0, 0.0), (2.0, 1.0), dx, cut=pd.region.Box((0.9, 0.0), (1.1, 0.1))),
            horizon=2.015 * dx,
            material=pd.NeoHookean(E=1000.0, nu=0.3),
            weights=pd.choose("weights", weights, pd.WEIGHTS),
            control=pd.Silling(0.5),
            scheme=pd.Correspondence(),
            damage=pd.LinearSoftening(pd.ConstantCritical(0.02), 2.0, protected=held[0] | held[1]),
            conditions=[pd.Displacement(held[0], x=0.0, y=0.0), pd.Displacement(held[1], x=pull)],
            steps=pd.Steps(steps),
            history={"force": pd.Reaction("x", held[1]), "broken": pd.BrokenBonds()},
            results=lambda h: {"force": h["force"][-1], "peak": max(h["force"]), "broken": h["broken"][-1]},
        )
"""


@pytest.mark.long
def test_damage_goes_on_from_conforming_weights(tmp_path):
    """The body breaks, the same on two ranks; intact families keep their weights."""
    case = tmp_path / "notch.py"
    case.write_text(textwrap.dedent(DAMAGED))
    one = results(case, output=tmp_path / "one")["results"]
    two = results(case, output=tmp_path / "two", ranks=2)["results"]
    plain = results(case, "weights=standard", output=tmp_path / "plain")["results"]
    assert one["broken"] == two["broken"] > 10
    assert one["force"] == pytest.approx(two["force"], rel=1e-8)
    # The strength changes by the error at the surface of the notch, a spacing deep on so coarse a lattice, not more.
    assert one["peak"] == pytest.approx(plain["peak"], rel=0.3)
    assert one["peak"] != plain["peak"]


SPREAD = """
    import json, sys
    sys.path.insert(0, {root!r})
    import numpy as np
    import pdpetsc as pd
    from tests.gradient.test_conforming import shaken_plate, uniform
    case = uniform(shaken_plate(), 0.26, [pd.region.Named("-x"), pd.region.Named("+x")])
    prepared = pd.prepare(case)
    found = prepared.gathered(lambda s: prepared.problem.external_force(prepared.problem.state(s.unknowns, 1.0)),
                              prepared.solution())
    if found is not None:
        open({path!r}, "w").write(json.dumps(found.tolist()))
"""


@pytest.mark.long
def test_loads_on_facets_are_the_same_on_any_ranks(tmp_path):
    found = []
    for ranks in (1, 3):
        path, script = tmp_path / f"{ranks}.json", tmp_path / f"{ranks}.py"
        script.write_text(textwrap.dedent(SPREAD).format(root=str(ROOT), path=str(path)))
        done = python_on(ranks, script)
        assert done.returncode == 0, done.stderr
        found.append(np.array(json.loads(path.read_text())))
    np.testing.assert_allclose(found[0], found[1], atol=1e-14)
    assert np.abs(found[0]).max() > 0.01


def strip_of_bonds(particles, top, **more):
    left = pd.region.Slab("x", high=2.0)
    return pd.Case(
        particles=particles,
        horizon=2.1,
        material=pd.BondBased(E=10.0),
        conditions=[pd.Displacement(left, x=0.0, y=0.0), top],
        **more,
    )


def test_a_row_of_particles_keeps_the_sum_of_a_load_on_its_side():
    """A single row of cells extends along itself only: its sides are interpolated along it."""
    strip = pd.Lattice((0.0, 0.0), (10.0, 1.0), 1.0)
    _, _, surface = pieces(strip, 2.1)
    sums = np.add.reduceat(surface.N, surface.ptr[:-1])
    np.testing.assert_allclose(sums, 1.0, rtol=1e-12)
    prepared = pd.prepare(strip_of_bonds(strip, pd.Traction(pd.region.Named("+y"), x=1.0)))
    force = prepared.problem.external_force(prepared.problem.state(np.zeros((10, 2)), 1.0))
    np.testing.assert_allclose(force.sum(axis=0), [10.0, 0.0], atol=1e-12)


def test_a_particle_that_cracks_cut_off_carries_its_own_facets():
    plate = pd.Lattice((0.0, 0.0), (10.0, 4.0), 1.0)
    cracks = [pd.Segment((9.0, 4.5), (9.0, 3.0)), pd.Segment((9.0, 3.0), (10.5, 3.0))]
    cloud, _, surface = pieces(plate, 1.2, cracks=cracks)
    lone = int(np.flatnonzero((cloud.x > [9.0, 3.0]).all(axis=1))[0])
    mine = np.flatnonzero(surface.owner == lone)
    assert len(mine) == 4
    for f in mine:
        assert surface.members[surface.ptr[f] : surface.ptr[f + 1]].tolist() == [lone]
        assert surface.N[surface.ptr[f]] == pytest.approx(1.0)


def test_a_cell_that_is_shifted_against_the_lattice_has_no_inner_surface():
    plate = pd.Lattice((0.0, 0.0), (10.0, 6.0), 1.0)
    found = []
    for low in (0.0, -0.25):
        cell = pd.Cell((low, 0.0), (low + 10.0, 6.0), axes="x")
        cloud, surface, _, operator = weights_of(plate, 2.1, cell=cell)
        assert len(surface.x) == 20
        order = np.argsort(cloud.gid[: cloud.n_owned])
        found.append(operator.g[operator.point_ptr[:-1]][order])
    np.testing.assert_allclose(found[0], found[1], atol=1e-9)


def test_resultants_are_those_of_particles_not_of_the_cell():
    top = pd.Traction(pd.region.Named("+y"), x=lambda x, t: t * (0.5 + 0.1 * np.sin(0.2 * np.pi * x[:, 0] + 0.3)))
    held = pd.Displacement(pd.region.Slab("y", high=1.0), x=0.0, y=0.0)
    case = pd.Case(
        particles=pd.Lattice((0.0, 0.0), (10.0, 6.0), 1.0, thickness=2.0), horizon=2.1,
        material=pd.LinearElastic(E=10.0, nu=0.3), conditions=[held, top, pd.MeanStrain(xx=0.0)],
        cell=pd.Cell((0.0, 0.0), (10.0, 6.0), axes="x"),
    )  # fmt: skip
    found = [found for term in pd.prepare(case).problem.terms for found in term.resultants]
    np.testing.assert_allclose(found[0][2], [10.0, 0.0], atol=1e-12)


def test_an_area_of_a_load_on_facets_is_refused():
    with pytest.raises(pd.CaseError, match="has no `area`"):
        pd.Traction(pd.region.All(), x=1.0, area=3.0)
    with pytest.raises(pd.CaseError, match="has no `area`"):
        pd.Pressure(pd.region.All(), 1.0, area=3.0)


def test_what_fails_in_a_pressure_is_named():
    plate = shaken_plate()
    case = uniform(plate, 0.26, [pd.region.Named("-x"), pd.region.Named("+x")])
    bad = pd.Pressure(pd.region.Named("+y"), lambda x, t: x)
    with pytest.raises(pd.CaseError, match="value of a Pressure condition"):
        pd.prepare(pd.Case(**{**vars(case), "conditions": [*case.conditions, bad]}))


def pulled(particles, horizon=0.26, **changes):
    """Return a case that says nothing of its weights, in which tractions need no facets."""
    held = [pd.Displacement(pd.region.Nearest((0.0, 0.0)), x=0.0, y=0.0),
            pd.Displacement(pd.region.Nearest((2.0, 0.0)), y=0.0)]  # fmt: skip
    right = pd.Force(pd.region.Slab("x", low=1.8), x=1.0)
    return pd.Case(**{
        "particles": particles, "horizon": horizon, "material": pd.LinearElastic(E=1000.0, nu=0.3),
        "scheme": pd.Correspondence(), "control": pd.Silling(0.5),
        "conditions": [*held, right, pd.Force(pd.region.Slab("x", high=0.2), x=-1.0)],
        "history": {"u": pd.At((2.0, 0.5), pd.displacement, "x")}, "results": lambda h: {"u": h["u"][-1]},
    } | changes)  # fmt: skip


def of_case(case, tmp_path):
    """Return the displacement of the end and what the summary says of the weights."""
    result = pd.run(case, tmp_path)
    return result["u"], result.summary["scheme"]["note"]


def test_weights_conform_by_default_where_a_cloud_that_knows_its_surface_is_no_lattice(tmp_path):
    lattice, shaken = pd.Lattice((0.0, 0.0), (2.0, 1.0), 0.125), shaken_plate()
    for particles, weights in ((lattice, pd.Standard()), (shaken, pd.Conforming())):
        found, note = of_case(pulled(particles), tmp_path)
        assert (found, note) == of_case(pulled(particles, weights=weights), tmp_path)
        assert ("conforming weights" in note) == weights.conform
    assert of_case(pulled(shaken, weights=pd.Standard()), tmp_path)[0] != pytest.approx(found, rel=1e-3)
    # As arrays a lattice with the facets of a lattice is one.
    chunk = lattice.chunk(0, 1)
    assert not pd.Arrays(chunk.x, chunk.volume, facets=lattice.surface()).irregular
    assert pd.Arrays(chunk.x, np.where(chunk.x[:, 0] < 1.0, 2.0, 0.5) * chunk.volume).irregular


def test_irregular_clouds_that_cannot_have_conforming_weights_keep_their_own_and_say_why(tmp_path):
    shaken = shaken_plate(shake=0.2)
    unknown = pd.Arrays(shaken.x, shaken.volume)
    # Points with as many members as a linear function has numbers; a surface that does not enclose the volume; none.
    scarce = {"scheme": pd.BondAssociated(), "control": None, "horizon": 1.3 * 0.125}
    larger = pd.Arrays(shaken.x, 1.01 * np.asarray(shaken.volume), facets=shaken.facets)
    for particles, changes, why in (
        (shaken, scarce, "widen the horizon"), (larger, {}, "encloses a volume"), (unknown, {}, "no known surface"),
    ):  # fmt: skip
        found, note = of_case(pulled(particles, **changes), tmp_path)
        assert "standard weights, which may not converge here. " in note and why in note
        assert found == of_case(pulled(particles, weights=pd.Standard(), **changes), tmp_path)[0]
        with pytest.raises(pd.CaseError, match=why):
            pd.run(pulled(particles, weights=pd.Conforming(), **changes), tmp_path)
    # Where a load needs the surface as well, a wrong one is refused.
    with pytest.raises(pd.CaseError, match="encloses a volume"):
        pd.run(pulled(larger, conditions=[*pulled(larger).conditions, pd.Pressure(pd.region.All(), 1.0)]), tmp_path)


def test_a_crack_between_nodes_leaves_standard_weights_and_a_warning_that_names_the_way_out(tmp_path, caplog):
    nodes = pd.LatticeNodes((0.0, 0.0), (2.0, 1.0), 0.125)
    _, note = of_case(pulled(nodes, cracks=[pd.Segment((0.6, 0.55), (1.4, 0.55))]), tmp_path)
    why = (
        "standard weights, which may not converge here. cracks= needs pd.Lattice: pd.LatticeNodes has no faces of "
        "cracks, which loads without a normal and conforming weights need."
    )
    assert note.endswith(why)
    assert [record.message for record in caplog.records if record.levelname == "WARNING"] == [
        f"The run used {why} Otherwise compare two spacings."
    ]


def test_bonds_have_no_weights_by_default(tmp_path):
    case = pulled(shaken_plate(), material=pd.BondBased(E=1000.0), scheme=None, control=None)
    assert "weights" not in of_case(case, tmp_path)[1]


def test_a_run_goes_on_with_the_weights_that_it_had_by_default(tmp_path):
    lattice = pd.Lattice((0.0, 0.0), (2.0, 1.0), 0.125)
    pd.run(pulled(lattice, weights=pd.Standard()), tmp_path / "one")
    longer = pulled(lattice, steps=pd.Steps(2))
    assert pd.run(longer, tmp_path / "two", restart=tmp_path / "one")["u"] > 0.0
    with pytest.raises(pd.CaseError, match="weights"):
        pd.run(pulled(lattice, weights=pd.Conforming()), tmp_path / "three", restart=tmp_path / "one")


def test_options_of_a_run_reach_the_solver_of_the_weights(tmp_path):
    case = uniform(shaken_plate(), 0.26, [pd.region.Named("-x"), pd.region.Named("+x")])
    result = pd.run(case, tmp_path, options={"weights_pc_type": "jacobi"})
    assert result.summary["unused_options"] == []
    notes = [result.summary["scheme"]["note"], pd.run(case, tmp_path).summary["scheme"]["note"]]
    iterations = [int(note.split(" iterations")[0].split()[-1]) for note in notes]
    assert iterations[0] > 1.5 * iterations[1]
    with pytest.raises(pd.CaseError, match="PETSc refused the solver options"):
        pd.run(case, tmp_path, options={"weights_pc_type": "nonsense"})


@pytest.mark.parametrize("ranks", [1, 2])
def test_a_field_on_the_surface_is_exact_where_it_is_linear(ranks, tmp_path):
    """Particles of a shaken cloud; the mean by area, the largest and the smallest over one side of 2 x + 3 y."""
    script = tmp_path / "linear.py"
    script.write_text(
        textwrap.dedent(
            f"""
            import sys
            sys.path.insert(0, {str(ROOT)!r})
            import pdpetsc as pd
            from tests.gradient.test_conforming import shaken_plate, uniform

            def linear(solution):
                return 2.0 * solution.x[:, 0] + 3.0 * solution.x[:, 1]

            def case():
                ends = [pd.region.Named("-x"), pd.region.Named("+x")]
                case = uniform(shaken_plate(), 0.26, ends)
                history = {{
                    "mean": pd.OnSurface(linear, "", ends[1]),
                    "largest": pd.OnSurface(linear, "", ends[1], take="largest"),
                    "smallest": pd.OnSurface(linear, "", ends[1], take="smallest"),
                    "inside": pd.Smallest(lambda solution: -linear(solution)),
                }}
                return pd.Case(**{{**vars(case), "history": history, "results": lambda h: {{k: h[k][-1] for k in h}}}})
            """
        )
    )
    found = results(script, output=tmp_path / "out", ranks=ranks)["results"]
    assert found["mean"] == pytest.approx(4.0 + 1.5, rel=1e-12)
    assert found["largest"] == pytest.approx(4.0 + 3.0 * 15 / 16, rel=1e-12)
    assert found["smallest"] == pytest.approx(4.0 + 3.0 / 16, rel=1e-12)
    x = shaken_plate().x
    assert found["inside"] == pytest.approx(-(2.0 * x[:, 0] + 3.0 * x[:, 1]).max(), rel=1e-12)


def bent(half):
    """Return a plate pressed from above towards x = 0, whole or as its right half, with a shear stress at its top."""
    low = 0.0 if half else -2.0
    right = pd.region.Slab("x", low=1.75)
    near = pd.region.Named("+y") & pd.region.Box((0.0, 0.0), (0.25, 1.0))
    return pd.Case(
        particles=pd.Lattice((low, 0.0), (2.0, 1.0), 0.25),
        horizon=0.51,
        material=pd.LinearElastic(E=10.0, nu=0.3),
        control=pd.Silling(0.5),
        scheme=pd.Correspondence(),
        symmetry=[pd.Symmetry("x")] if half else [],
        conditions=[
            pd.Displacement(right if half else right | pd.region.Slab("x", high=-1.75), x=0.0, y=0.0),
            pd.Pressure(pd.region.Named("+y"), lambda x, t: t * np.abs(x[:, 0])),
        ],
        history={name: pd.OnSurface(pd.stress, name, near) for name in ("xx", "xy", "yy")},
        results=lambda h: {name: h[name][-1] for name in ("xx", "xy", "yy")},
    )


def test_fields_at_the_surface_of_a_half_are_those_of_the_whole(tmp_path):
    """Also the shear stress beside the mirror plane, whose sign is another behind it."""
    one, two = (dict(pd.run(bent(half), tmp_path)) for half in (False, True))
    assert abs(one["xy"]) > 1e-3 * abs(one["xx"])
    for name, value in one.items():
        assert two[name] == pytest.approx(value, rel=1e-9), name


HOLE = pd.region.Box((0.75, 0.25), (1.25, 0.75))


@pytest.mark.parametrize(
    ("low", "high", "cut"),
    [(0.0, 2.0, None), ((0.0, -1.0), (2.0, 1.0), HOLE), ((1.0, 0.0, 0.0), (2.0, 1.0, 0.5), None)],
)
def test_corners_of_a_lattice_share_its_cells_and_faces(low, high, cut):
    """As the cells themselves: volume, enclosed volume, area of each side; in one part and in three."""
    given = {"spacing": 0.25, "thickness": 0.5, "cut": cut}
    nodes, cells = pd.LatticeNodes(low, high, **given), pd.Lattice(low, high, **given)
    whole, dim = nodes.chunk(0, 1), cells.dim
    assert whole.volume.sum() == pytest.approx(cells.chunk(0, 1).volume.sum(), rel=1e-14)
    assert len(whole.x) <= nodes.estimate() and whole.x.min(axis=0) == pytest.approx(np.atleast_1d(low))
    x, area, particle, tags = nodes.surface(0, 1).arrays
    np.testing.assert_allclose(x.T @ area, whole.volume.sum() * np.eye(dim), atol=1e-13)
    # The share of a corner in a face lies within half a cell of it, on the face.
    apart = np.abs(x - whole.x[particle])
    assert np.isin(np.round(apart / 0.25, 9), [0.0, 0.25]).all()
    _, other, _, sides = cells.surface(0, 1).arrays
    for name, flags in tags.items():
        np.testing.assert_allclose(area[flags].sum(axis=0), other[sides[name]].sum(axis=0), rtol=1e-13, atol=1e-15)
    parts = [nodes.chunk(part, 3) for part in range(3)]
    np.testing.assert_array_equal(np.concatenate([part.x for part in parts]), whole.x)
    first = np.cumsum([0, *(len(part.x) for part in parts)])
    pieces_of = [nodes.surface(part, 3).arrays for part in range(3)]
    found = np.concatenate([first[k] + of[2] for k, of in enumerate(pieces_of)])
    assert sorted(found) == sorted(particle)
    along = nodes.faces(0, 1, np.eye(dim)[0])
    assert along.sum() == pytest.approx(other[sides["+x"]].sum(axis=0)[0], rel=1e-13)


def test_corners_have_no_cracks():
    with pytest.raises(pd.CaseError, match=r"cracks= needs pd.Lattice: pd.LatticeNodes has no faces of cracks"):
        pieces(pd.LatticeNodes((0.0, 0.0), (2.0, 1.0), 0.25), 0.51, cracks=[pd.Segment((0.6, 0.6), (0.9, 0.6))])


@pytest.mark.parametrize(
    ("kind", "scheme"),
    [(kind, scheme) for kind in ("mesh", "lattice") for scheme in ("correspondence", "sub_horizons")]
    + [("mesh", "stress_points"), ("lattice", "bond_associated")],
)
def test_a_plane_that_nodes_hold_carries_the_exact_stress(kind, scheme, tmp_path):
    """Supports that hold the boundary take all of the reaction: a plate on rollers is in the uniform state up to it."""
    E, nu, pull = 1000.0, 0.3, 1.0
    H = np.diag([(1.0 - nu**2) * pull / E, -nu * (1.0 + nu) * pull / E])
    held = pd.region.Slab("x", high=1e-9)
    if kind == "mesh":
        particles, horizon, end = (
            pd.MeshNodes(written(tmp_path / "plate.xdmf")),
            2.2 / 6,
            pd.region.Slab("x", low=1.999),
        )
    else:
        cut = HOLE & pd.region.Slab("x", low=3.0)
        particles, horizon = pd.LatticeNodes((0.0, 0.0), (2.0, 1.0), 0.125, cut=cut), 2.015 * 0.125
        end = pd.region.Named("+x")
    case = pd.Case(
        particles=particles,
        horizon=horizon,
        material=pd.LinearElastic(E=E, nu=nu),
        scheme=pd.SCHEMES[scheme],
        weights=pd.Conforming(),
        control=pd.Silling(0.5) if scheme == "correspondence" else None,
        conditions=[
            pd.Displacement(held, x=0.0),
            pd.Displacement(pd.region.Nearest((0.0, 0.0)), y=0.0),
            pd.Traction(end, x=pull),
        ],
        history={
            "F": pd.LargestError(pd.deformation_gradient, lambda x, t: np.eye(2) + t * H),
            "force": pd.Reaction("x", held),
        },
        results=lambda h: {"F": h["F"][-1], "force": h["force"][-1]},
    )
    found = pd.run(case, tmp_path / "out")
    assert found["F"] < 1e-11
    assert found["force"] == pytest.approx(-pull, rel=1e-9)


def cantilever(particles, spacing, scheme):
    """Return the error in the L2 norm of a plate 2 x 1 that bends as the closed form has it, held at x = 0 alone.

    Plane stress, shear ``-Q (D^2 / 4 - y^2) / 2 I`` at its end; the displacement of the side x = 0, which warps, is
    given to the outermost particles there, on the side or half a cell inside (Timoshenko and Goodier, article 21;
    Augarde and Deeks 2008, equations 5 and 6).
    """
    E, nu, L, D, Q = 1000.0, 0.3, 2.0, 1.0, 1.0
    inertia = D**3 / 12.0

    def exact(x, t):
        a, b = x.T
        u = b * ((6.0 * L - 3.0 * a) * a + (2.0 + nu) * (b**2 - 0.25 * D**2))
        v = -(3.0 * nu * b**2 * (L - a) + (4.0 + 5.0 * nu) * 0.25 * D**2 * a + (3.0 * L - a) * a**2)
        return t * Q / (6.0 * E * inertia) * np.stack([u, v], axis=1)

    def of_side(axis):
        return lambda x, t: exact(x * [0.0, 1.0], t)[:, axis]

    held = pd.region.Slab("x", high=0.51 * spacing)
    case = pd.Case(
        particles=particles, horizon=2.015 * spacing, material=pd.LinearElastic(E=E, nu=nu, plane="stress"),
        scheme=pd.SCHEMES[scheme], weights=pd.Conforming(),
        control=pd.Silling(0.5) if scheme == "correspondence" else None,
        conditions=[
            pd.Displacement(held, x=of_side(0), y=of_side(1)),
            pd.Traction(pd.region.Named("+x"), y=lambda x, t: -t * Q / (2.0 * inertia) * (0.25 * D**2 - x[:, 1] ** 2)),
        ],
    )  # fmt: skip
    prepared = pd.prepare(case)
    solver = prepared.make_solver()
    try:
        *_, last = prepared.march(solver)
        solution = prepared.solution(last.u, last.t)
        whole = exact(solution.x, 1.0)
        off = pd.displacement(solution) - whole
        return float(np.sqrt(solution.volume @ (off**2).sum(axis=1) / (solution.volume @ (whole**2).sum(axis=1))))
    finally:
        solver.destroy()


@pytest.mark.parametrize("scheme", ["correspondence", "sub_horizons"])
def test_bending_of_a_plate_that_is_held_on_its_boundary(scheme):
    """Far nearer to the closed form than with supports half a cell inside, and faster so."""
    kinds = (pd.LatticeNodes, pd.Lattice)
    nodes, cells = (
        np.array([cantilever(kind((0.0, -0.5), (2.0, 0.5), 1.0 / n), 1.0 / n, scheme) for n in (8, 32)])
        for kind in kinds
    )
    assert np.log2(nodes[0] / nodes[1]) / 2.0 > 1.8
    assert nodes[1] < 0.1 * cells[1]


@LONG
@pytest.mark.parametrize(
    ("words", "first", "peak", "broken"),
    [((), 3578, 5927, 90), (("law=brittle",), 4766, 8252, 86), (("scheme=sub_horizons", "G=0"), 5232, 6305, 126)],
)
def test_the_plate_with_a_hole_breaks_as_its_page_says(words, first, peak, broken, tmp_path):
    """Symmetric and apart; damage begins at a lower load than with the weights of the scheme."""
    found = results("runs/fracture/plate_with_hole.py", *words, "weights=conforming", output=tmp_path)["results"]
    plain = results("runs/fracture/plate_with_hole.py", *words, output=tmp_path)["results"]
    assert found["first_damage_load"] == pytest.approx(first, rel=1e-3)
    assert found["peak_load"] == pytest.approx(peak, rel=1e-3)
    assert found["broken_bonds"] == broken
    assert found["symmetry_error"] < 1e-10
    assert abs(found["last_load"]) < 1e-6 * peak
    assert found["first_damage_load"] < 0.8 * plain["first_damage_load"]


def cracked_cell(at):
    """Return a strip, periodic in y, with a crack along it at a height that its load goes with."""
    return pd.Case(
        particles=pd.Lattice((0.0, 0.0), (2.0, 1.0), 0.125),
        horizon=0.252,
        material=pd.LinearElastic(E=10.0, nu=0.3),
        weights=pd.Conforming(),
        cell=pd.Cell((0.0, 0.0), (2.0, 1.0), axes="y"),
        cracks=[pd.Segment((0.5, at), (1.0, at))],
        conditions=[
            pd.MeanStrain(yy=0.0),
            pd.Displacement(pd.region.Slab("x", high=0.125), x=0.0, y=0.0),
            pd.Traction(
                pd.region.Named("+x"),
                x=lambda x, t: t * (1.0 + np.cos(2.0 * np.pi * (x[:, 1] - at))),
                y=lambda x, t: t * np.cos(2.0 * np.pi * (x[:, 1] - at)),
            ),
        ],
        history={"energy": pd.StrainEnergy()},
        results=lambda h: {"energy": h["energy"][-1]},
    )


def test_a_crack_along_the_side_of_a_cell_is_that_in_its_middle(tmp_path):
    side, middle = (pd.run(cracked_cell(at), tmp_path)["energy"] for at in (0.0, 0.5))
    assert side == pytest.approx(middle, rel=1e-9)


@pytest.mark.parametrize("near", [0.0, 1e-9, 3e-6, 4e-6, 1e-3, 0.03, 0.3])
def test_facets_are_linear_exact_however_near_their_particle_is(near):
    """Between on the facet and half a cell behind it."""
    n = 6
    x = np.stack(np.meshgrid(np.arange(n) + 0.5, np.arange(n) + 0.5, indexing="ij"), axis=-1).reshape(-1, 2)
    sides, area, behind = [], [], []
    for axis, at, sign in ((0, 0.0, -1.0), (0, float(n), 1.0), (1, 0.0, -1.0), (1, float(n), 1.0)):
        for i in np.flatnonzero(np.abs(x[:, axis] - at) < 0.6):
            place = x[i].copy()
            place[axis] = at
            sides.append(place)
            area.append(sign * np.eye(2)[axis])
            behind.append(i)
    moved = x.copy()
    column = x[:, 0] < 1.0
    moved[column, 0] = near
    cloud, _, surface = pieces(pd.Arrays(moved, 1.0, facets=pd.Facets(sides, area, behind)), 3.015)
    of = np.repeat(np.arange(len(surface.ptr) - 1), np.diff(surface.ptr))
    at = np.stack([np.bincount(of, surface.N * cloud.x[surface.members, a]) for a in range(2)], axis=1)
    assert np.abs(np.bincount(of, surface.N) - 1.0).max() < 1e-10
    # A particle within 1e-6 of its horizon sits on the facet.
    assert np.abs(at - surface.x).max() < 1e-9 + (near if near < 1e-5 else 0.0)
