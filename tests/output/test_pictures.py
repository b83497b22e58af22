"""Pictures of runs: what is drawn where, to scale, with which words; films; solid bodies with and without PyVista."""

import dataclasses
import logging
import shutil

import numpy as np
import pytest
import scipy
from PIL import Image

import pdpetsc as pd
from pdpetsc.command_line import plot as plot_command
from pdpetsc.command_line.commands import command
from pdpetsc.command_line.plot import plot
from pdpetsc.declare.cells import SIMPLICES
from pdpetsc.output import picture, scene
from pdpetsc.output.crack import polydata
from pdpetsc.output.curves import curve_figure, history_figure
from pdpetsc.output.labels import Labels
from pdpetsc.output.picture import draw_field, draw_film
from pdpetsc.output.reading import read_history, read_summary
from pdpetsc.output.scene import Settings, broken_pairs, deformed, frame_of, gradients, grid_of, limits_of, scene_of
from pdpetsc.output.surface import read_cells
from pdpetsc.post.point_location import Held
from tests.commands import results

GRADIENT = np.array([[0.1, -0.02], [0.03, 0.05]])


def moved(particles, gradient, **given):
    """Return a case whose body is deformed by a constant gradient."""
    dim = len(gradient)
    everywhere = pd.region.All()
    place = {axis: (lambda x, t, row=row: t * (x @ row)) for axis, row in zip("xyz", gradient, strict=False)}
    return pd.Case(
        particles=particles, horizon=1.0075, material=pd.BondBased(E=1000.0),
        conditions=[pd.Displacement(everywhere, **{axis: place[axis] for axis in "xyz"[:dim]})],
        history={"force": pd.Reaction("x", pd.region.Slab("x", high=1.0)),
                 "end": pd.Mean(pd.displacement, "x", pd.region.Slab("x", low=5.0))},
        **given,
    )  # fmt: skip


@pytest.fixture(scope="module")
def plane(tmp_path_factory):
    case = moved(
        pd.Lattice((0.0, 0.0), (6.0, 3.0), 0.5), GRADIENT, steps=pd.Steps(2), units=pd.Units("mm", "N"),
        cracks=[pd.Segment((0.0, 1.5), (2.0, 1.5))],
    )  # fmt: skip
    folder = tmp_path_factory.mktemp("plane") / "bar"
    pd.run(case, folder)
    return folder


@pytest.fixture(scope="module")
def solid(tmp_path_factory):
    folder = tmp_path_factory.mktemp("solid") / "block"
    gradient = np.diag([0.1, -0.05, 0.0])
    pd.run(moved(pd.Lattice((0.0,) * 3, (6.0, 2.0, 2.0), 0.5), gradient, units=pd.Units("m", "MN")), folder)
    return folder


def test_a_scene_has_the_places_the_gradients_and_the_words_of_its_step(plane):
    scene = scene_of(plane, Settings("stress", "xx", 2.0), step=1)
    assert np.allclose(scene.y[:, :2], scene.x[:, :2] + 2.0 * 0.5 * scene.x[:, :2] @ GRADIENT.T, atol=1e-12)
    assert scene.horizon == pytest.approx(1.0075)
    corners = pd.Lattice((0.0, 0.0), (6.0, 3.0), 0.5).cells()
    carried = corners.points[corners.corners] @ (np.eye(2) + GRADIENT).T
    assert np.allclose(scene.cells.points[scene.cells.corners], carried, atol=1e-9)
    force = read_history(plane)["force"][1]
    assert (
        scene.title
        == f"bar: stress xx [MPa]\nstep 1, load t = 0.5, force = {force:.4g} N, displacements \N{MULTIPLICATION SIGN} 2"
    )
    assert scene_of(plane, Settings("von_mises")).label == "von Mises stress [MPa]"
    assert scene_of(plane, Settings("stress_xy")).label == "stress xy [MPa]"


def test_a_crack_is_drawn_as_both_of_its_faces_where_they_have_moved_to(plane):
    cracks = scene_of(plane, Settings("stress", "xx")).cracks
    assert cracks.shape == (8, 2, 2)  # four cells on either side
    back = np.linalg.solve(np.eye(2) + GRADIENT, cracks.reshape(-1, 2).T).T
    assert np.allclose(back[:, 1], 1.5, atol=1e-9) and np.ptp(back[:, 0]) == pytest.approx(2.0)


def area_of(cells):
    """Return the area of plane cells (n,)."""
    x = cells.points[cells.corners]
    after = np.arange(1, len(x) + 1)
    after[cells.offsets[1:] - 1] = cells.offsets[:-1]
    return np.add.reduceat(0.5 * (x[:, 0] * x[after, 1] - x[:, 1] * x[after, 0]), cells.offsets[:-1])


def outline_of(cells):
    """Return the number of closed outlines of plane cells, and their length."""
    free = cells.surface
    ends = free.corners.reshape(-1, 2)
    _, numbers = np.unique(ends, return_inverse=True)
    pairs = numbers.reshape(-1, 2)
    graph = scipy.sparse.coo_matrix((np.ones(len(pairs)), pairs.T), (pairs.max() + 1,) * 2)
    length = np.linalg.norm(free.points[ends[:, 1]] - free.points[ends[:, 0]], axis=1).sum()
    return scipy.sparse.csgraph.connected_components(graph, directed=False)[0], length


def opened(shift=1.0):
    """Return a lattice of 6 by 4 unit cells, its displacement, and the bonds across its middle."""
    lattice = pd.Lattice((0.0, 0.0), (6.0, 4.0), 1.0)
    x = lattice.chunk(0, 1).x
    u = np.where(x[:, 1:] > 2.0, [0.0, shift], 0.0)
    across = np.array([[4 * i + a, 4 * j + b] for i in range(6) for j in range(6) for a in (0, 1) for b in (2, 3)])
    return lattice.cells(), x, u, across


def test_a_crack_leaves_a_gap_between_cells():
    cells, x, u, across = opened()
    none = np.zeros(len(x), dtype=bool)
    moved, faces = deformed(cells, x, u, Held(x, (), across), none)
    assert np.allclose(area_of(moved), 1.0)
    assert outline_of(moved) == (2, pytest.approx(2 * (6 + 2 + 6 + 2)))
    assert len(faces) == 12 and np.allclose(np.unique(faces[..., 1]), [2.0, 3.0])
    # Two particles that carry no stress do not hold together either; other cells stay joined.
    loose, _ = deformed(cells, x, u, Held(x), abs(x[:, 1] - 2.0) < 1.0)
    assert np.ptp(loose.points[:, 1]) == pytest.approx(5.0, abs=0.02) and area_of(loose).sum() == pytest.approx(
        24.0, abs=0.5
    )
    whole, faces = deformed(cells, x, u, Held(x), none)
    assert len(whole.points) == len(cells.points) and len(faces) == 0
    assert area_of(whole).sum() == pytest.approx(30.0, abs=1.0)


def test_a_crack_that_ends_in_the_body_keeps_one_outline():
    cells, x, u, across = opened(0.5)
    left = across[(x[across[:, 0], 0] < 3.0) & (x[across[:, 1], 0] < 3.0)]
    moved, faces = deformed(cells, x, u * (x[:, :1] < 3.0), Held(x, (), left), np.zeros(len(x), dtype=bool))
    assert len(faces) == 6 and outline_of(moved)[0] == 1
    # Bonds between particles that are no neighbours have no face.
    assert len(deformed(cells, x, u, Held(x, (), np.array([[0, 23]])), np.zeros(len(x), dtype=bool))[1]) == 0


def test_neither_side_of_a_crack_is_fitted_through_it():
    _, x, u, across = opened()
    assert np.allclose(gradients(x, u, Held(x, (), across)), np.eye(2))
    # A crack that is not recorded shows by a jump.
    assert np.allclose(gradients(x, u, Held(x)), np.eye(2), atol=0.05)
    turn = np.array([[0.0, -1.0], [1.0, 0.0]])
    assert np.allclose(gradients(x, x @ (turn - np.eye(2)).T, Held(x)), turn)


def test_cells_share_corners_in_large_deformation():
    """A strip that is rolled up: no seams, and an area that is nearly that of the strip."""
    lattice = pd.Lattice((0.0, 0.0), (20.0, 2.0), 0.5)
    x, cells = lattice.chunk(0, 1).x, lattice.cells()
    angle = x[:, 0] / 5.0
    u = np.stack([(5.0 - x[:, 1]) * np.sin(angle), 5.0 - (5.0 - x[:, 1]) * np.cos(angle)], axis=1) - x
    moved, _ = deformed(cells, x, u, Held(x), np.zeros(len(x), dtype=bool))
    assert outline_of(moved)[0] == 1 and len(moved.points) == len(cells.points)
    assert area_of(moved).sum() == pytest.approx(0.5 * (5.0**2 - 3.0**2) * 4.0, rel=0.02)


def mesh_of(folder, kind):
    """Return the path of a mesh of a 6 by 3 rectangle, or box with a depth of 1, and its size."""
    meshio = pytest.importorskip("meshio")
    if kind in ("triangle", "quad"):
        x = np.stack(np.meshgrid(np.arange(7.0), np.arange(4.0), indexing="ij"), axis=-1).reshape(-1, 2)
        inside = (x > 0.0).all(axis=1) & (x < [6.0, 3.0]).all(axis=1)
        x[inside] += np.random.default_rng(1).uniform(-0.2, 0.2, (inside.sum(), 2))
        low = np.array([4 * i + j for i in range(6) for j in range(3)])
        quads = np.stack([low, low + 4, low + 5, low + 1], axis=1)
        cells = quads if kind == "quad" else np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    else:
        x = np.stack(np.meshgrid(*(np.arange(n + 1.0) for n in (6, 3, 1)), indexing="ij"), axis=-1).reshape(-1, 3)
        low = np.array([8 * i + 2 * j for i in range(6) for j in range(3)])
        cells = np.stack([low, low + 8, low + 10, low + 2, low + 1, low + 9, low + 11, low + 3], axis=1)
        if kind == "tetra":
            cells = np.concatenate([cells[:, list(simplex)] for simplex in SIMPLICES["hexahedron"]])
    path = folder / f"{kind}.vtu"
    meshio.Mesh(x, [(kind, cells)]).write(path)
    return path


@pytest.mark.parametrize(
    "kind", ["lattice", "lattice nodes", "triangle", "quad", "triangle nodes", "quad nodes", "facets", "cloud"]
)
def test_plane_cells_fill_the_body(kind, tmp_path, rng):
    """Their areas are the volumes of the particles; without a known outline nearly so."""
    name, _, nodes = kind.partition(" ")
    hole = pd.region.Sphere((3.0, 1.5), 0.8)
    lattice = (pd.LatticeNodes if nodes else pd.Lattice)((0.0, 0.0), (6.0, 3.0), 0.25, cut=hole)
    if name == "lattice":
        particles = lattice
    elif name in ("triangle", "quad"):
        particles = (pd.MeshNodes if nodes else pd.Mesh)(mesh_of(tmp_path, name))
    else:
        box = pd.Lattice((0.0, 0.0), (6.0, 3.0), 0.25)
        x, sides = box.chunk(0, 1).x, box.surface()
        x += rng.uniform(-0.06, 0.06, x.shape)
        particles = pd.Arrays(x, 0.0625, facets=sides if name == "facets" else None)
    cells = particles.cells().own
    area, volume = area_of(cells), particles.chunk(0, 1).volume
    total = np.bincount(cells.owner, np.abs(area), len(volume))
    assert (area > 0.0).all() or (area < 0.0).all()
    assert total.sum() == pytest.approx(volume.sum(), rel=0.03 if name == "cloud" else 1e-9)
    if kind == "quad nodes":
        assert np.allclose(total, volume, rtol=0.1)
    elif name not in ("facets", "cloud"):
        assert np.allclose(total, volume, rtol=1e-9)
    holes, length = outline_of(cells)
    assert holes == (2 if name == "lattice" else 1)
    if name in ("facets", "triangle", "quad"):
        assert length == pytest.approx(18.0, rel=1e-9)


@pytest.mark.parametrize("kind", ["lattice", "lattice nodes", "tetra", "hexahedron", "tetra nodes", "hexahedron nodes"])
def test_the_surface_of_a_solid_body_is_closed(kind, tmp_path):
    name, _, nodes = kind.partition(" ")
    if name == "lattice":
        cells = (pd.LatticeNodes if nodes else pd.Lattice)((0.0,) * 3, (6.0, 3.0, 1.0), 0.5).cells().own
    else:
        cells = (pd.MeshNodes if nodes else pd.Mesh)(mesh_of(tmp_path, name)).cells().own
    assert size_of_closed(cells.surface) == pytest.approx(2.0 * (18.0 + 6.0 + 3.0), rel=1e-9)


def size_of_closed(surface):
    """Return the area of the surface of a solid body, each edge of which belongs to two faces."""
    _, count = np.unique(
        dataclasses.replace(surface, points=surface.points[:, :2]).faces.key, axis=0, return_counts=True
    )
    assert (count == 2).all()
    x = [surface.points[part] for part in np.split(surface.corners, surface.offsets[1:-1])]
    return sum(np.linalg.norm(np.cross(y[2] - y[0], y[-1] - y[1] if len(y) == 4 else y[1] - y[0])) / 2 for y in x)


@pytest.mark.parametrize("at", [2.0, 2.3])
@pytest.mark.parametrize("kind", ["lattice", "lattice nodes", "tetra", "hexahedron", "tetra nodes", "hexahedron nodes"])
def test_a_cut_body_is_closed_by_a_plane_face(kind, at, tmp_path):
    name, _, nodes = kind.partition(" ")
    if name == "lattice":
        particles = (pd.LatticeNodes if nodes else pd.Lattice)((0.0,) * 3, (6.0, 3.0, 1.0), 0.5)
    else:
        particles = (pd.MeshNodes if nodes else pd.Mesh)(mesh_of(tmp_path, name))
    surface = particles.cells().below(0, at).own.surface
    assert size_of_closed(surface) == pytest.approx(2.0 * (3.0 * at + at + 3.0), rel=1e-6)
    drawn = np.minimum.reduceat(surface.points[surface.corners, 0], surface.offsets[:-1]) > at - 1e-6
    x = particles.chunk(0, 1).x[surface.owner[drawn], 0]
    # Half an element of the mesh is 0.5 wide; nodes on the plane are those of the cut face.
    assert np.abs(x - at).max() <= (0.0 if nodes and at == 2.0 else 0.75)


def test_a_cut_shows_values_that_the_surface_does_not_have(tmp_path):
    def bump(x, t):
        return 0.01 * t * x[:, 0] * (6.0 - x[:, 0]) * (1.0 - (x[:, 1] - 1.0) ** 2) * (1.0 - (x[:, 2] - 1.0) ** 2)

    case = dataclasses.replace(
        moved(pd.Lattice((0.0,) * 3, (6.0, 2.0, 2.0), 0.5), np.eye(3), units=pd.Units("mm", "N")),
        conditions=[pd.Displacement(pd.region.All(), x=bump, y=0.0, z=0.0)],
        fields=[pd.displacement], picture=pd.Picture(pd.displacement, "x", 0.0, cut=("x", 3.0)),
    )  # fmt: skip
    result = pd.run(case, tmp_path)
    assert (tmp_path / "picture.png").exists() and result.summary["picture"]["cut"] == [["x", 3.0]]

    def drawn(*cuts):
        found = scene_of(tmp_path, Settings("displacement", "x", 0.0, cuts=cuts))
        return found, found.values[found.cells.owner], len(found.cells.count)

    whole, outside, faces = drawn()
    assert faces == 2 * (12 * 4 + 12 * 4 + 4 * 4) and outside.max() < 0.5 * whole.values.max()
    half, inside, faces = drawn(("x", 3.0))
    assert faces == 2 * (6 * 4 + 6 * 4 + 4 * 4) and half.limits == whole.limits
    # Of the 16 faces of the cut the four in the middle.
    assert inside.max() == pytest.approx(whole.values.max()) and (inside > outside.max()).sum() == 4
    assert half.y[:, 0].max() == pytest.approx(2.75) and "x > 3 mm cut off" in half.title
    assert drawn(("x", 3.0), ("z", 1.0))[2] == 2 * (6 * 4 + 6 * 2 + 4 * 2)
    # A plane through cells cuts them.
    through, _, faces = drawn(("x", 3.2))
    assert faces == 2 * (7 * 4 + 7 * 4 + 4 * 4) and through.cells.points[:, 0].max() == pytest.approx(3.2)
    limits, (low, high) = frame_of(tmp_path, Settings("displacement", "x", 0.0, [("y", 1.0)]), [1])
    assert limits == whole.limits and np.allclose([low, high], [[0.25] * 3, [5.75, 0.75, 1.75]])


def test_a_cut_face_along_y_is_seen(solid, tmp_path, monkeypatch):
    monkeypatch.setattr(picture.importlib.util, "find_spec", lambda name: None)
    for axis in "xyz":
        draw_field(solid, tmp_path / f"{axis}.png", Settings("displacement", "x", cuts=[(axis, 1.0)]))
        assert colours(tmp_path / f"{axis}.png") > 5_000
    assert picture._from_behind(scene_of(solid, Settings("displacement", "x", cuts=[("y", 1.0)])))


@pytest.mark.parametrize("at", [-1.0, 0.25])
def test_a_cut_that_leaves_nothing_is_refused(at, solid, tmp_path):
    cuts = [("z", 5.0), ("x", at)]
    message = f"The cut at z = 5, x = {at:g} leaves nothing of the body; move the plane into the body"
    with pytest.raises(pd.CaseError, match=message):
        draw_field(solid, tmp_path / "p.png", Settings("stress", "xx", cuts=cuts))
    with pytest.raises(pd.CaseError, match=message):
        draw_film(solid, tmp_path / "p.gif", Settings("stress", "xx", cuts=cuts))
    block = pd.Lattice((0.0,) * 3, (6.0, 2.0, 2.0), 0.5)
    with pytest.raises(pd.CaseError, match=message):
        pd.run(moved(block, 0.1 * np.eye(3), picture=pd.Picture(cut=cuts)), tmp_path)


def test_a_cut_is_for_solid_bodies(plane, tmp_path):
    message = "The cut of a picture requires a body in 3D; this body is in 2D. Omit the cut"
    with pytest.raises(pd.CaseError, match=message):
        draw_field(plane, tmp_path / "p.png", Settings("stress", "xx", cuts=[("x", 3.0)]))
    with pytest.raises(pd.CaseError, match=message):
        pd.run(moved(pd.Lattice((0.0, 0.0), (6.0, 3.0), 0.5), GRADIENT, picture=pd.Picture(cut=("z", 3.0))), tmp_path)


@pytest.mark.parametrize("cut", [("w", 1.0), ("x", np.nan), ("x",), "x=5", [("x", 1.0), ("r", 2.0)], {"x": 1.0}])
def test_a_cut_is_an_axis_and_a_position(cut):
    with pytest.raises(pd.CaseError, match=r"Picture takes a pair .'x' or 'y' or 'z', a finite number. or .* as cut"):
        pd.Picture(cut=cut)


def test_plot_cuts_the_body(solid, tmp_path, monkeypatch):
    shutil.copytree(solid, tmp_path / "run")
    asked = []
    monkeypatch.setattr(plot_command, "draw_field", lambda folder, path, settings, step: asked.append(settings.cuts))
    monkeypatch.setattr(plot_command, "draw_film", lambda folder, path, settings: asked.append(settings.cuts))
    for words in (["--cut", "x=3,z=-1.5", "--animate"], ["--cut", "none"], []):
        assert command("plot", [str(tmp_path / "run"), *words]) == 0
    planes = [("x", 3.0), ("z", -1.5)]
    assert [list(cuts) for cuts in asked] == [planes, planes, [], []]
    for words, message in (
        ("w=3", "--cut has no axis 'w'; it has x, y, z"), ("5", "--cut has no axis '5'"), ("x", "x takes a number"),
        ("x=far", "x takes a number, not 'far'"),
    ):  # fmt: skip
        with pytest.raises(pd.CaseError, match=message):
            plot(tmp_path / "run", {}, cut=words)


def test_plot_begins_with_the_cut_of_the_case(tmp_path, monkeypatch):
    block = pd.Lattice((0.0,) * 3, (6.0, 2.0, 2.0), 0.5)
    pd.run(moved(block, 0.1 * np.eye(3), picture=pd.Picture(pd.displacement, "x", cut=[("y", 1.0)])), tmp_path)
    asked = []
    monkeypatch.setattr(plot_command, "draw_field", lambda folder, path, settings, step: asked.append(settings.cuts))
    for cut in (None, "x=1", "none"):
        plot(tmp_path, {}, cut=cut)
    assert [list(map(tuple, cuts)) for cuts in asked] == [[("y", 1.0)], [("x", 1.0)], []]


def test_a_picture_of_a_part_of_the_particles_says_so(plane, solid, monkeypatch):
    monkeypatch.setattr(scene, "MOST", 30)
    drawn = scene_of(plane, Settings("stress", "xx"))
    assert len(drawn.x) == len(drawn.cells.count) == 24 and len(drawn.cracks) == 0
    assert drawn.title.endswith(" N, 1 particle in 3 shown, cracks not drawn")
    assert scene_of(solid, Settings("stress", "xx")).title.endswith(" MN, horizon 1.008 m, 1 particle in 7 shown")


def test_round_off_does_not_fill_the_scale_of_colours():
    low, high = limits_of(100.0 + 1e-9 * np.arange(50.0))
    assert low == pytest.approx(95.0) and high == pytest.approx(105.0)
    assert limits_of(np.array([np.nan, 1.0, 2.0])) == pytest.approx((1.005, 1.995))
    assert limits_of(np.full(3, np.nan)) == (0.0, 1.0)
    assert limits_of(np.array([-5e-15, 0.5, 1.0] * 99)) == (0.0, 1.0)
    assert limits_of(np.array([-3.0, -1.0, 2e-16] * 99)) == (-3.0, 0.0)


def colours(path):
    """Return how many points of a picture are neither white, grey nor black."""
    pixels = np.asarray(Image.open(path).convert("RGB")).astype(int)
    return int((np.ptp(pixels, axis=-1) > 40).sum())


@pytest.mark.parametrize("suffix", [".png", ".svg", ".pdf"])
def test_a_plane_body_is_drawn(plane, tmp_path, suffix):
    path = tmp_path / f"p{suffix}"
    draw_field(plane, path, Settings("stress", "xx"))
    assert path.stat().st_size > 5_000
    if suffix == ".png":
        assert colours(path) > 50_000


def test_the_size_of_the_horizon_is_drawn_to_scale(plane):
    from matplotlib.figure import Figure
    from matplotlib.patches import Circle

    scene = scene_of(plane, Settings("stress", "xx"))
    figure = Figure()
    axes = figure.add_subplot()
    low, high = picture._framed(scene, None)
    picture._plane(figure, axes, scene, low, high)
    (circle,) = [patch for patch in axes.patches if isinstance(patch, Circle)]
    assert circle.radius == pytest.approx(1.0075) and axes.get_aspect() == 1.0
    assert circle.center[1] + circle.radius < scene.y[:, 1].min() and circle.center[1] - circle.radius > low[1]


def test_a_film_has_a_frame_for_each_step_with_the_same_axes(plane, tmp_path):
    path = tmp_path / "film.gif"
    assert draw_film(plane, path, Settings("displacement", "x")) == 3
    film = Image.open(path)
    assert film.n_frames == 3
    frames = []
    for number in range(3):
        film.seek(number)
        frames.append(np.asarray(film.convert("RGB")).astype(int))
    assert not np.array_equal(frames[0], frames[2])
    # Ticks and frame stay where they are.
    below = int(0.9 * frames[0].shape[0])
    assert np.abs(frames[0][below:] - frames[2][below:]).mean() < 1.0
    with pytest.raises(pd.CaseError, match=r"a \.gif or an \.mp4"):
        draw_film(plane, tmp_path / "film.avi", Settings("displacement", "x"))


def test_a_solid_body_is_drawn_by_pyvista_without_a_display(solid, tmp_path, monkeypatch, caplog):
    pytest.importorskip("pyvista")
    monkeypatch.delenv("DISPLAY", raising=False)
    # A crack that has not begun, or of another step, is no reason to draw anything else.
    (solid / "crack.vtk").write_text(polydata([], True, "pdpetsc, step 9"))
    with caplog.at_level(logging.INFO, "pdpetsc"):
        draw_field(solid, tmp_path / "p.png", Settings("von_mises"))
    if "PyVista cannot draw here" in caplog.text:
        pytest.skip(f"no OpenGL here: {caplog.text}")
    image = Image.open(tmp_path / "p.png")
    assert image.size == (1300, 850) and image.info["Software"] == "pdpetsc"
    assert colours(tmp_path / "p.png") > 30_000


@pytest.mark.parametrize(
    ("script", "why"),
    [
        ("import os; os.abort()", "exit status -6"),
        ("raise OSError('no OpenGL')", "OSError: no OpenGL"),
        ("", "no picture"),
    ],
)
def test_a_solid_body_is_drawn_also_where_pyvista_fails(script, why, solid, tmp_path, monkeypatch, caplog):
    pytest.importorskip("pyvista")
    (tmp_path / "solid.py").write_text(script)
    monkeypatch.setattr(picture, "_SOLID", tmp_path / "solid.py")
    draw_field(solid, tmp_path / "p.png", Settings("stress", "xx"))
    assert "PyVista cannot draw here" in caplog.text and why in caplog.text
    assert (tmp_path / "p.png").stat().st_size > 10_000


def test_a_solid_body_is_drawn_also_without_pyvista(solid, tmp_path, monkeypatch, caplog):
    monkeypatch.setattr(picture.importlib.util, "find_spec", lambda name: None)
    with caplog.at_level(logging.INFO, "pdpetsc"):
        draw_field(solid, tmp_path / "p.png", Settings("displacement", "x"))
    assert "pip install pyvista" in caplog.text and colours(tmp_path / "p.png") > 5_000


def test_curves_have_names_and_units_at_their_axes(plane):
    columns, labels = read_history(plane), Labels.of(read_summary(plane))
    (axis,) = curve_figure(columns, labels).axes
    assert (axis.get_xlabel(), axis.get_ylabel()) == ("end [mm]", "force [N]")
    assert np.array_equal(axis.lines[0].get_xydata(), np.column_stack([columns["end"], columns["force"]]))
    first, second = history_figure(columns, labels).axes
    assert (first.get_ylabel(), second.get_ylabel(), second.get_xlabel()) == ("force [N]", "end [mm]", "load t")
    # Runs of earlier versions say nothing of units.
    assert Labels.of({}).column("force") == "force" and Labels.of({"units": {"size": "m"}}).units is None
    assert curve_figure(columns, Labels()) is None


def test_a_later_run_puts_away_what_was_drawn_of_the_one_before(plane, tmp_path):
    folder = tmp_path / "out"
    shutil.copytree(plane, folder)
    drawn = plot(folder, {"component": "yy"}, animate=True)
    names = {path.name for path in drawn}
    assert names == {"deformed.png", "deformed.gif", "history.png", "curve.png", "newton.png"}
    (folder / "curve.png").write_bytes(b"\x89PNG mine")
    pd.run(moved(pd.Lattice((0.0, 0.0), (6.0, 3.0), 0.5), GRADIENT), folder)
    assert {path.name for path in (folder / "earlier").glob("*.*") if path.name in names} == names - {"curve.png"}
    assert (folder / "curve.png").read_bytes() == b"\x89PNG mine"
    assert not (folder / "deformed.gif").exists()


@pytest.mark.parametrize(
    ("length", "force", "stress", "energy", "release"),
    [
        ("mm", "N", "MPa", "mJ", "N/mm"), ("m", "N", "Pa", "J", "N/m"), ("mm", "kN", "GPa", "J", "kN/mm"),
        ("m", "kN", "kPa", "kJ", "kN/m"), ("um", "uN", "MPa", "pJ", "uN/um"), ("nm", "nN", "GPa", "nN nm", "nN/nm"),
        ("in", "lbf", "psi", "lbf in", "lbf/in"), ("cm", "kN", "kN/cm^2", "kN cm", "kN/cm"),
        ("L", "F", "F/L^2", "F L", "F/L"),
    ],
)  # fmt: skip
def test_units_of_stress_and_energy_follow_from_length_and_force(length, force, stress, energy, release):
    units = pd.Units(length, force)
    assert (units.of("stress"), units.of("energy"), units.of("energy per area")) == (stress, energy, release)
    assert units.of("length") == length and units.of("area") == f"{length}^2" and units.of("") == ""
    assert units.of("stress intensity") == f"{stress} {length}^0.5" and units.of("temperature") == ""


@pytest.mark.parametrize("words", [("", "N"), ("mm", ""), ("a b", "N"), ("mm", "N", "K C"), ("[mm]", "N")])
def test_units_are_words(words):
    with pytest.raises(pd.CaseError, match="Units takes a word"):
        pd.Units(*words)


def test_units_do_not_change_a_number_nor_what_a_restart_accepts(plane, tmp_path):
    case = moved(
        pd.Lattice((0.0, 0.0), (6.0, 3.0), 0.5), GRADIENT, steps=pd.Steps(2), units=pd.Units("km", "GN"),
        cracks=[pd.Segment((0.0, 1.5), (2.0, 1.5))],
    )  # fmt: skip
    result = pd.run(case, tmp_path)
    assert np.array_equal(result.history["force"], read_history(plane)["force"])
    assert np.array_equal(result.field("stress"), pd.open(plane).field("stress"))
    pd.run(case, tmp_path, restart=plane)


def test_a_film_of_a_line_keeps_its_axes_and_shows_its_peaks(tmp_path):
    result = pd.run(moved(pd.Lattice((0.0,), (6.0,), 0.5), np.array([[0.1]]), steps=pd.Steps(2)), tmp_path)
    assert draw_film(tmp_path, tmp_path / "film.gif", Settings("displacement", "x")) == 3
    limits, _ = frame_of(tmp_path, Settings("displacement", "x"), [0, 1, 2])
    assert limits == (0.0, result.field("displacement").max())


@pytest.mark.long
def test_a_film_of_a_solid_body_is_drawn_in_one_process(solid, tmp_path, monkeypatch):
    pytest.importorskip("pyvista")
    started = []
    run = picture.subprocess.run
    monkeypatch.setattr(picture.subprocess, "run", lambda *words, **given: started.append(1) or run(*words, **given))
    assert draw_film(solid, tmp_path / "film.gif", Settings("displacement", "x")) == 2
    assert len(started) == 1 and Image.open(tmp_path / "film.gif").n_frames == 2


def torn_along_a_mirror_plane(folder, symmetry):
    """Run a plate that tears along y = 0: its upper half before a mirror plane there, or all of it."""
    dx = 0.05
    low = 0.0 if symmetry else -0.5

    def pull(x, t):
        return 0.02 * t * (1.2 - x[:, 0]) * np.sign(x[:, 1])

    case = pd.Case(
        particles=pd.Lattice((0.0, low), (1.0, 0.5), dx), horizon=2.015 * dx,
        material=pd.BondBased(1000.0, plane="stress"), symmetry=[pd.Symmetry("y")] if symmetry else [],
        damage=pd.Brittle(pd.FractureEnergy(0.001)), cracks=[pd.Segment((-1.0, 0.0), (0.3, 0.0))],
        conditions=[pd.Displacement(pd.region.Slab("y", low=0.4), x=0.0, y=pull),
                    *([] if symmetry else [pd.Displacement(pd.region.Slab("y", high=-0.4), x=0.0, y=pull)])],
        steps=pd.Steps(3), history={"broken": pd.BrokenBonds()},
    )  # fmt: skip
    return pd.run(case, folder)


@pytest.mark.long
def test_a_crack_along_a_mirror_plane_breaks_no_bond_beside_it(tmp_path):
    half = torn_along_a_mirror_plane(tmp_path / "half", True)
    whole = torn_along_a_mirror_plane(tmp_path / "whole", False)
    rows = len((tmp_path / "half" / "broken_bonds.csv").read_text().splitlines()) - 1
    pairs = broken_pairs(half.folder, 3, half.x)
    # Most of what broke went to images, also to those of the particles themselves.
    assert rows == half.history["broken"][-1] > 20 and 0 < len(pairs) < rows
    assert (pairs[:, 0] != pairs[:, 1]).all()
    # Without the plane the same bonds of the upper half are broken, and as many below.
    same = {tuple(np.round(place, 6).ravel()) for place in half.x[pairs][..., :2]}
    upper = [place for place in whole.x[broken_pairs(whole.folder, 3, whole.x)][..., :2] if (place[:, 1] > 0.0).all()]
    assert same == {tuple(np.round(place, 6).ravel()) for place in upper}
    drawn, full = (scene_of(folder, Settings("displacement", "y")) for folder in (half.folder, whole.folder))
    # The crack is the border of the half, and has two faces in the whole; cells are drawn alike.
    assert len(drawn.cracks) == 0 and len(full.cracks) == 40
    above = np.flatnonzero(full.x[:, 1] > 0.0)
    assert np.allclose(full.x[above], drawn.x, atol=1e-12)
    corners, of_half = (part.cells.points[part.cells.corners].reshape(-1, 4, 2) for part in (full, drawn))
    assert np.allclose(corners[above], of_half, atol=1e-3 * 0.05)


def test_bonds_across_a_period_are_no_cracks_inside(tmp_path):
    x = np.array([[0.5, 0.5], [1.5, 0.5], [2.5, 0.5], [3.5, 0.5]])
    rows = ["1,0.5,0,3,1.0,0.0,0.5", "1,0.5,0,1,1.0,1.0,0.5", "2,1.0,1,2,1.0,2.0,0.5", "1,0.5,2,9,1.0,0.0,0.0"]
    (tmp_path / "broken_bonds.csv").write_text("\n".join(["step,t,i,j,length,x,y", *rows]) + "\n")
    assert broken_pairs(tmp_path, 1, x).tolist() == [[0, 1]]
    assert broken_pairs(tmp_path, 2, x).tolist() == [[0, 1], [1, 2]]
    # A table of something else, or none, tells of no crack.
    (tmp_path / "broken_bonds.csv").write_text("step,i,j\n1,0,1\n")
    assert len(broken_pairs(tmp_path, 1, x)) == len(broken_pairs(tmp_path / "none", 1, x)) == 0


def graded(dim, finest=0.25):
    """Return places and volumes of a square or cube with fine particles in a corner and coarse ones elsewhere."""
    rng = np.random.default_rng(3)
    places, volumes = [], []
    for low, high, h in ((0.0, 2.0, finest), (2.0, 4.0, 0.5), (4.0, 8.0, 1.0)):
        axes = [np.arange(0.5 * h, high, h)] * dim
        x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, dim)
        x = x[(x > low).any(axis=1)]
        places.append(x + h * rng.uniform(-0.1, 0.1, x.shape))
        volumes.append(np.full(len(x), h**dim))
    return np.concatenate(places), np.concatenate(volumes)


@pytest.mark.parametrize(("dim", "unit"), [(2, 1.0), (2, 1e-6), (3, 1.0)])
def test_particles_of_very_different_volume_are_drawn_as_large_as_they_are(dim, unit, tmp_path):
    """With a thickness and in another unit too: coarse particles are four times as wide as fine ones."""
    x, volume = graded(dim)
    depth = 3.0 * unit if dim == 2 else 1.0
    case = pd.Case(
        particles=pd.Arrays(unit * x, depth * volume * unit**dim, thickness=depth),
        horizon=2.5 * unit,
        material=pd.LinearElastic(1.0, nu=0.0),
        conditions=[pd.Displacement(pd.region.All(), **dict.fromkeys("xyz"[:dim], 0.0))],
        fields=[pd.displacement],
    )
    pd.run(case, tmp_path)
    cells = scene_of(tmp_path, Settings("displacement", "x")).cells
    if dim == 2:
        assert area_of(cells).sum() == pytest.approx(volume.sum() * unit**2, rel=0.05)
    else:
        box = read_cells(tmp_path, None)
        side = np.ptp(box.points.reshape(-1, 8, 3), axis=1)
        assert np.allclose(side, unit * np.cbrt(volume)[:, None], rtol=0.5)
        assert np.median(np.abs(side[:, 0] / unit / np.cbrt(volume) - 1.0)) < 1e-9
    draw_field(tmp_path, tmp_path / "p.png", Settings("displacement", "x"))
    if dim == 2:
        shown = np.asarray(Image.open(tmp_path / "p.png").convert("RGB")).astype(int)
        drawn = (shown.max(axis=2) - shown.min(axis=2)) > 40
        # The columns of the body, left of the scale of colours, are covered without gaps.
        body = drawn[:, : int(0.8 * drawn.shape[1])]
        rows, columns = np.flatnonzero(body.any(axis=1)), np.flatnonzero(body.any(axis=0))
        inside = body[rows[0] : rows[-1], columns[0] : columns[-1]]
        assert inside.mean() > 0.95


def test_a_crack_among_coarse_particles_of_a_graded_cloud_is_drawn():
    x, volume = graded(2, finest=0.125)
    cells = pd.Arrays(x, volume).cells()
    held = Held(x, [pd.Segment((4.0, 6.0), (8.1, 6.0))])
    _, faces = deformed(cells, x, np.zeros_like(x), held, np.zeros(len(x), dtype=bool))
    assert np.linalg.norm(faces[:, 1] - faces[:, 0], axis=1).sum() / 2.0 == pytest.approx(4.0, rel=0.3)


def test_a_picture_of_the_displacement_needs_no_declared_field(tmp_path):
    particles = pd.Lattice((0.0, 0.0), (6.0, 3.0), 0.5)
    case = moved(particles, GRADIENT, steps=pd.Steps(1), fields=[], picture=pd.Picture(pd.displacement, "x"))
    assert pd.run(case, tmp_path).fields.names() == ["displacement"]
    assert (tmp_path / "picture.png").exists()


def test_runs_of_earlier_versions_are_drawn_without_a_file_of_cells(plane, tmp_path):
    shutil.copytree(plane, tmp_path / "old")
    (tmp_path / "old" / "fields" / "cells.h5").unlink()
    new, old = (scene_of(folder, Settings("stress", "xx")) for folder in (plane, tmp_path / "old"))
    assert np.allclose(new.cells.points[new.cells.corners], old.cells.points[old.cells.corners])
    (tmp_path / "old" / "fields" / "cells.h5").write_bytes(b"\x89HDF nothing")
    with pytest.raises(pd.CaseError, match=r"cells.h5: .*; run the case again, or remove the file"):
        scene_of(tmp_path / "old", Settings("stress", "xx"))


def test_a_grid_for_pyvista_opens_along_cracks(plane, solid, tmp_path):
    pytest.importorskip("pyvista")
    grid = grid_of(plane, step=2)
    assert grid.n_cells == 72 and grid["stress_xx"].shape == (72,)
    assert grid.n_points == 13 * 7 + 4  # the corners of four cells are split, but for the tip
    warped = grid.warp_by_vector("displacement")
    assert np.allclose(warped.points[:, :2], grid.points[:, :2] @ (np.eye(2) + GRADIENT).T, atol=1e-6)
    assert grid_of(solid).warp_by_vector("displacement").volume == pytest.approx(24.0 * 1.1 * 0.95)
    case = moved(pd.Lattice((0.0, 0.0), (6.0, 3.0), 0.5), GRADIENT, steps=pd.Steps(1), fields=[pd.stress])
    pd.run(case, tmp_path)
    assert not np.asarray(grid_of(tmp_path)["displacement"]).any()


def test_plot_begins_with_the_picture_of_the_case(tmp_path, monkeypatch):
    case = moved(
        pd.Lattice((0.0, 0.0), (6.0, 3.0), 0.5), GRADIENT, steps=pd.Steps(1),
        picture=pd.Picture(pd.displacement, "y", scale=3.0),
    )  # fmt: skip
    pd.run(case, tmp_path)
    asked = []
    monkeypatch.setattr(plot_command, "draw_field", lambda folder, path, settings, step: asked.append(settings))
    for words in ({}, {"scale": "1"}, {"component": "x"}, {"field": "stress"}, {"field": "displacement"}):
        plot(tmp_path, words)
    shown = [(settings.field, settings.component, settings.scale) for settings in asked]
    assert shown == [
        ("displacement", "y", 3.0), ("displacement", "y", 1.0), ("displacement", "x", 3.0), ("stress", "xx", 1.0),
        ("displacement", "y", 3.0),
    ]  # fmt: skip


@pytest.mark.parametrize("there", [True, False])
def test_a_film_is_an_mp4_if_ffmpeg_is_installed(there, plane, monkeypatch):
    from matplotlib.animation import FFMpegWriter

    monkeypatch.setattr(FFMpegWriter, "isAvailable", lambda: there)
    made = []
    monkeypatch.setattr(plot_command, "draw_field", lambda *words: None)
    monkeypatch.setattr(plot_command, "draw_film", lambda folder, path, *words: made.append(path.name))
    plot(plane, {}, animate=True)
    plot(plane, {"format": "gif"}, animate=True)
    assert made == ["deformed.mp4" if there else "deformed.gif", "deformed.gif"]
    if not there:
        monkeypatch.undo()
        monkeypatch.setattr(FFMpegWriter, "isAvailable", lambda: False)
        with pytest.raises(pd.CaseError, match="take format=gif"):
            plot(plane, {"format": "mp4"}, animate=True)


@pytest.mark.parametrize("kind", ["Mesh", "MeshNodes", "Lattice"])
def test_cells_do_not_depend_on_the_number_of_ranks(kind, tmp_path):
    particles = "pd.Lattice((0.0, 0.0), (6.0, 3.0), 0.5)" if kind == "Lattice" else f"pd.{kind}(mesh)"
    mesh = mesh_of(tmp_path, "triangle")
    (tmp_path / "case.py").write_text(RANKS.format(mesh=str(mesh), particles=particles))
    for ranks in (1, 2):
        results(tmp_path / "case.py", ranks=ranks, output=tmp_path / str(ranks))
    one, two = (read_cells(tmp_path / name, None) for name in "12")
    for name in ("points", "corners", "offsets", "particle"):
        assert np.array_equal(getattr(one, name), getattr(two, name))
    assert (tmp_path / "1" / "fields.xdmf").read_text() == (tmp_path / "2" / "fields.xdmf").read_text()
    first, second = (scene_of(tmp_path / name, Settings("displacement", "x")).cells for name in "12")
    assert np.allclose(first.points[first.corners], second.points[second.corners], atol=1e-9)


RANKS = """
import pdpetsc as pd

mesh = {mesh!r}


def case():
    return pd.Case(
        particles={particles}, horizon=2.1, material=pd.BondBased(E=1000.0, plane="stress"), steps=pd.Steps(1),
        conditions=[pd.Displacement(pd.region.All(), x=lambda x, t: 0.1 * t * x[:, 0], y=0.0)],
        fields=[pd.displacement],
    )
"""
