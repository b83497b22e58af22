"""The outer layer of clouds without facets: which particles, normals, areas, edges, mirror planes, cells, ranks."""

import dataclasses
import itertools
import json

import numpy as np
import pytest

import pdpetsc as pd
from pdpetsc.terms.contact import ContactForces
from tests.commands import script_on


def grid(*counts):
    """Return the centres of cubic cells of size 1 (n, dim)."""
    axes = np.meshgrid(*[np.arange(count) + 0.5 for count in counts], indexing="ij")
    return np.stack(axes, axis=-1).reshape(-1, len(counts))


def shaken(*counts, by=0.2, seed=0):
    x = grid(*counts)
    return x + np.random.default_rng(seed).uniform(-by, by, x.shape)


def turned(x, angle=0.4):
    """Return points turned about the axes z and x."""
    dim, c, s = x.shape[1], np.cos(angle), np.sin(angle)
    R = np.eye(dim)
    R[:2, :2] = [[c, -s], [s, c]]
    if dim == 3:
        R = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]]) @ R
    return x @ R.T, R


def pressed(x, volume=1.0, region=None, horizon=3.015, thickness=1.0, **changes):
    """Return a case of a cloud and a tool far away from it."""
    dim = x.shape[1]
    tool = pd.RigidSphere((1e4,) + (0.0,) * (dim - 1), 1.0)
    held = pd.Displacement(pd.region.All(), **dict.fromkeys("xyz"[:dim], 0.0))
    case = pd.Case(
        particles=pd.Arrays(x, volume, thickness=thickness),
        horizon=horizon,
        material=pd.LinearElastic(E=1.0, nu=0.3),
        weights=pd.Standard(),
        conditions=[held, pd.Contact(pd.region.All() if region is None else region, tool)],
    )
    return dataclasses.replace(case, **changes)


def layer(x, volume=1.0, **changes):
    """Return the surface of a cloud."""
    return pd.prepare(pressed(x, volume, **changes)).problem.body.surface


def sizes(surface):
    return np.linalg.norm(surface.area, axis=1)


def assert_closed(surface, volume):
    """The facets enclose the volume of the particles, so that a uniform stress is in equilibrium with them."""
    dim = surface.x.shape[1]
    np.testing.assert_allclose(surface.area.sum(axis=0), 0.0, atol=1e-12 * sizes(surface).sum())
    np.testing.assert_allclose(surface.x.T @ surface.area, volume * np.eye(dim), atol=1e-10 * volume)


@pytest.mark.parametrize("horizon", [1.515, 2.015, 3.015, 4.015])
@pytest.mark.parametrize("counts", [(12, 6), (7, 6, 5)])
def test_a_turned_block_has_the_faces_of_its_cells(counts, horizon):
    """Areas, normals and centres of all faces are those of the lattice, edges and corners included."""
    x, R = turned(grid(*counts))
    found = layer(x, horizon=horizon)
    facets = pd.Lattice((0.0,) * len(counts), tuple(map(float, counts)), 1.0).surface()
    # The same order of facets: by particle, then along each axis.
    faces = np.concatenate(
        [np.asarray(facets.x), np.asarray(facets.area), np.asarray(facets.particle)[:, None]], axis=1
    )
    back = np.concatenate([found.x @ R, found.area @ R, found.owner[:, None]], axis=1)
    faces, back = (np.round(rows, 6)[np.lexsort(np.round(rows, 6).T)] for rows in (faces, back))
    np.testing.assert_allclose(back, faces, atol=2e-6)
    assert sizes(found).sum() == pytest.approx(np.linalg.norm(facets.area, axis=1).sum(), rel=1e-8)


@pytest.mark.parametrize("thickness", [1.0, 0.25])
def test_units_change_nothing(thickness):
    """Lengths of 1e-3 and a thickness scale areas and offsets."""
    x = shaken(10, 6)
    one, other = layer(x), layer(1e-3 * x, 1e-6 * thickness, thickness=thickness, horizon=3.015e-3)
    np.testing.assert_allclose(other.x, 1e-3 * one.x, rtol=1e-9)
    np.testing.assert_allclose(other.area, 1e-3 * thickness * one.area, atol=1e-12)
    assert other.uneven == pytest.approx(1e-3)


@pytest.mark.parametrize("counts", [(20, 10), (9, 8, 7)])
def test_neither_the_order_of_particles_nor_the_axes_matter(counts):
    """The order changes nothing; turned axes change a few facets on edges, where two planes fit nearly as well."""
    x, order = shaken(*counts, seed=1), np.random.default_rng(0).permutation(np.prod(counts))

    def rows(surface, number):
        found = np.concatenate([number[surface.owner][:, None], surface.x, surface.area], axis=1)
        return found[np.lexsort(np.round(found[:, ::-1], 6).T)]

    one = layer(x)
    np.testing.assert_allclose(rows(layer(x[order]), order), rows(one, np.arange(len(x))), atol=1e-12)
    y, _ = turned(x)
    other = layer(y)
    assert sizes(other).sum() == pytest.approx(sizes(one).sum(), rel=0.01)
    assert np.count_nonzero(np.unique(other.owner) == np.unique(one.owner)) == len(np.unique(one.owner))


@pytest.mark.parametrize(("radius", "dim", "off"), [(5, 2, 0.07), (20, 2, 0.03), (4, 3, 0.03), (9, 3, 0.03)])
def test_balls_have_their_area(radius, dim, off):
    """Balls cut from a lattice: the area of the ball with the same volume."""
    x = grid(*[2 * radius + 2] * dim) - radius - 1.0
    x, _ = turned(x[np.linalg.norm(x, axis=1) < radius])
    found, n = layer(x), len(x)
    exact = 2.0 * np.sqrt(np.pi * n) if dim == 2 else (36.0 * np.pi) ** (1 / 3) * n ** (2 / 3)
    r = np.sqrt(n / np.pi) if dim == 2 else (0.75 * n / np.pi) ** (1 / 3)
    assert sizes(found).sum() == pytest.approx(exact, rel=off)
    assert np.average(np.linalg.norm(found.x, axis=1), weights=sizes(found)) == pytest.approx(r, abs=0.12)
    outward = (found.area * found.x).sum(axis=1) / sizes(found) / np.linalg.norm(found.x, axis=1)
    assert outward.min() > 0.7
    assert_closed(found, n)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("counts", [(20, 10), (9, 8, 7)])
def test_shaken_blocks_have_their_area_and_level(counts, seed):
    """The faces of the cells are within 5 % of the facets, and at their mean level."""
    x = shaken(*counts, by=0.25, seed=seed)
    found = layer(x)
    exact = 2.0 * sum(np.prod(counts) / count for count in counts)
    assert sizes(found).sum() == pytest.approx(exact, rel=0.05)
    top = found.area[:, -1] > 0.8 * sizes(found)
    assert found.area[top, -1].sum() == pytest.approx(np.prod(counts[:-1]), rel=0.08)
    assert np.average(found.x[top, -1], weights=sizes(found)[top]) == pytest.approx(counts[-1], abs=0.1)
    assert_closed(found, len(x))
    # No particle inside.
    inside = np.all((x > 1.3) & (x < np.array(counts) - 1.3), axis=1)
    assert not inside[found.owner].any()


def test_thin_plates_have_two_faces_and_an_edge():
    for layers in (1, 2):
        x, R = turned(grid(12, 9, layers))
        found = layer(x, material=pd.BondBased(E=1.0))
        area = found.area @ R
        assert area[area[:, 2] > 0.5, 2].sum() == pytest.approx(108.0, rel=0.04)
        assert area[area[:, 2] < -0.5, 2].sum() == pytest.approx(-108.0, rel=0.04)
        assert area[area[:, 0] > 0.0, 0].sum() == pytest.approx(9.0 * layers, rel=0.2)
        assert_closed(found, len(x))
    beam, R = turned(grid(12, 1))
    area = layer(beam, material=pd.BondBased(E=1.0)).area @ R
    np.testing.assert_allclose([area[area[:, 1] > 0.5, 1].sum(), area[area[:, 0] > 0.5, 0].sum()], [12.0, 1.0])


def test_a_triangular_lattice_has_its_straight_sides():
    i, j = np.meshgrid(np.arange(20), np.arange(12), indexing="ij")
    x = np.stack([i + 0.5 * (j % 2), j * np.sqrt(0.75)], axis=-1).reshape(-1, 2)
    found = layer(x, np.sqrt(0.75))
    top = found.area[:, 1] > 0.9 * sizes(found)
    np.testing.assert_allclose(found.x[top, 1], x[:, 1].max() + 0.5 * 0.75**0.25)
    assert sizes(found)[top].sum() == pytest.approx(20.0, rel=0.03)


def test_a_crack_has_two_faces():
    """Bonds that a crack cuts leave cones empty: the surface has the faces of a lattice with this crack."""
    x, R = turned(grid(16, 8))
    ends = (np.array([[0.0, 4.0], [8.0, 4.0]]) @ R.T).tolist()
    found = layer(x, cracks=[pd.Segment(ends[0], ends[1])])
    face = np.abs((found.x @ R)[:, 1] - 4.0) < 1e-6
    up = (found.area @ R)[:, 1]
    assert up[face & (up > 0.0)].sum() == pytest.approx(8.0, rel=0.1)
    assert up[face & (up < 0.0)].sum() == pytest.approx(-8.0, rel=0.1)
    assert_closed(found, len(x))


@pytest.mark.parametrize("dim", [2, 3])
def test_the_part_before_mirror_planes_has_the_surface_of_the_whole(dim):
    x = shaken(*(8, 6, 6)[:dim], seed=4)
    signs = np.array(list(itertools.product((1.0, -1.0), repeat=2)))
    whole = np.concatenate([x * np.concatenate([sign, np.ones(dim - 2)]) for sign in signs])
    part = layer(x, symmetry=[pd.Symmetry("x"), pd.Symmetry("y")])
    found = layer(whole)
    of_part = found.owner < len(x)
    np.testing.assert_allclose(found.x[of_part], part.x, atol=1e-9)
    # Planes that begin at another one of two equally wide cones are the same up to their last improvement.
    np.testing.assert_allclose(found.area[of_part], part.area, atol=1e-5)


def test_a_cell_has_no_surface_across_its_periods():
    x = shaken(10, 6, seed=5)
    found = layer(x, cell=pd.Cell((0.0, 0.0), (10.0, 6.0), "x"), conditions=[
        pd.Displacement("-y", x=0.0, y=0.0), pd.Contact("+y", pd.RigidPlane((0.0, 9.0), (0.0, -1.0)))])  # fmt: skip
    assert np.abs(found.area[:, 0]).max() < 0.4
    assert found.area[found.area[:, 1] > 0.0, 1].sum() == pytest.approx(10.0, rel=0.02)
    assert found.area.sum(axis=0) == pytest.approx(0.0, abs=1e-10)


def test_each_body_has_a_closed_surface():
    one, other = shaken(8, 6, seed=1), shaken(6, 6, seed=2) + np.array([8.5, 0.0])
    both = pd.Bodies({"one": pd.Arrays(one, 1.0), "other": pd.Arrays(other, 1.0)})
    found = layer(np.concatenate([one, other]), particles=both)
    for mine, volume in ((found.owner < len(one), 48.0), (found.owner >= len(one), 36.0)):
        assert_closed(dataclasses.replace(found, x=found.x[mine], area=found.area[mine]), volume)


RANKS = """
import json, sys
import numpy as np
import pdpetsc as pd
from tests.discrete.test_outer_layer import pressed, shaken

x, planes = shaken(12, 8, 7, seed=3), []
if "mirror" in sys.argv:
    planes = [pd.Symmetry("x")]
body = pd.prepare(pressed(x, symmetry=planes)).problem.body
cloud, s = body.cloud, body.surface
rows = np.concatenate([cloud.gid[s.owner][:, None], s.x, s.area, s.interpolated(cloud.x[:, 0])[:, None]], axis=1)
print(json.dumps([row for part in cloud.comm.allgather(rows.tolist()) for row in part]))
"""


@pytest.mark.parametrize("mirror", ["", "mirror"])
def test_the_layer_is_the_same_on_any_number_of_ranks(mirror):
    def on(ranks):
        rows = np.array(json.loads(script_on(ranks, RANKS, mirror).strip().splitlines()[0]))
        return rows[np.lexsort(np.round(rows[:, ::-1], 6).T)]

    one = on(1)
    assert len(one) > 300
    # Positions are interpolated linearly, half a particle outside.
    np.testing.assert_allclose(one[:, -1], one[:, 1], atol=1e-9)
    for ranks in (2, 3):
        np.testing.assert_allclose(on(ranks), one, atol=1e-9)


@pytest.mark.parametrize("dim", [2, 3])
def test_sides_of_an_uneven_layer_are_selected(dim):
    """A side has the facets within one particle of the outermost, along the axis to 30 degrees."""
    counts = (12, 8, 8)[:dim]
    prepared = pd.prepare(pressed(shaken(*counts, by=0.15), region="+y"))
    (term,) = (one for one in prepared.problem.terms if isinstance(one, ContactForces))
    found = prepared.problem.body.surface
    assert found.uneven == 1.0
    along = found.area[:, 1] > 0.866 * sizes(found)
    assert len(term.stencils[0]) - 1 == np.count_nonzero(along & (found.x[:, 1] > found.x[:, 1].max() - 1.0))
    assert found.area[along, 1].sum() == pytest.approx(np.prod(counts) / 8, rel=0.08)


def test_what_has_no_outer_layer_is_refused():
    nodes = pd.LatticeNodes((0.0, 0.0), (12.0, 6.0), 1.0).chunk(0, 1)
    x = nodes.x + np.random.default_rng(0).uniform(-1e-3, 1e-3, nodes.x.shape)
    with pytest.raises(pd.CaseError, match="as nodes on a surface do"):
        layer(x, nodes.volume)
    with pytest.raises(pd.CaseError, match=r"encloses 0\.\d+ times their volume; check volumes and thickness"):
        layer(shaken(12, 6), 3.0)
    with pytest.raises(pd.CaseError, match=r"encloses \d\.\d+ times their volume; check volumes and thickness"):
        layer(shaken(12, 6), 1.0, thickness=3.0)
    with pytest.raises(pd.CaseError, match="on a line have no outer layer"):
        layer(np.array([[0.0], [1.0], [2.1], [3.0], [4.0]]), horizon=2.015)
