"""Pictures of runs: what is drawn where, to scale, with which words; films; solid bodies with and without PyVista."""

import logging
import shutil

import numpy as np
import pytest
from PIL import Image

import pdpetsc as pd
from pdpetsc.command_line.plot import plot
from pdpetsc.output import picture, scene
from pdpetsc.output.crack import polydata
from pdpetsc.output.curves import curve_figure, history_figure
from pdpetsc.output.labels import Labels
from pdpetsc.output.picture import draw_field, draw_film
from pdpetsc.output.reading import read_history, read_summary
from pdpetsc.output.scene import (
    LONGEST_FACE,
    about,
    broken_pairs,
    faces_between,
    frame_of,
    lattice_steps,
    limits_of,
    scene_of,
)

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
    scene = scene_of(plane, "stress", "xx", 2.0, "bar", step=1)
    assert np.allclose(scene.y[:, :2], scene.x[:, :2] + 2.0 * 0.5 * scene.x[:, :2] @ GRADIENT.T, atol=1e-12)
    assert np.allclose(scene.F, np.eye(2) + GRADIENT, atol=1e-9)
    assert np.allclose(scene.steps, 0.5) and scene.horizon == pytest.approx(1.0075)
    force = read_history(plane)["force"][1]
    assert (
        scene.title
        == f"bar: stress xx [MPa]\nstep 1, load t = 0.5, force = {force:.4g} N, displacements \N{MULTIPLICATION SIGN} 2"
    )
    assert scene_of(plane, "von_mises", "", 1.0, "bar").label == "von Mises stress [MPa]"
    assert scene_of(plane, "stress_xy", "", 1.0, "bar").label == "stress xy [MPa]"


def test_a_crack_is_drawn_as_both_of_its_faces_where_they_have_moved_to(plane):
    cracks = scene_of(plane, "stress", "xx", 1.0, "bar").cracks
    assert cracks.shape == (8, 2, 2)  # four cells on either side
    back = np.linalg.solve(np.eye(2) + GRADIENT, cracks.reshape(-1, 2).T).T
    # A face moves with the particle on its side, half a spacing away from it.
    lower, upper = back[:8], back[8:]
    shift = np.linalg.solve(np.eye(2) + GRADIENT, GRADIENT @ [0.0, 0.25])
    assert np.allclose(np.ptp(lower[:, 0]), 2.0, atol=0.2)
    assert np.allclose(sorted([lower[:, 1].mean(), upper[:, 1].mean()]), [1.5 - shift[1], 1.5 + shift[1]], atol=0.01)


def test_bonds_that_broke_are_crack_faces_from_their_step_on():
    x = np.stack(np.meshgrid(np.arange(6.0), np.arange(4.0), indexing="ij"), axis=-1).reshape(-1, 2)
    opening = np.where(x[:, 1:] > 1.5, [0.0, 1.0], 0.0)
    across = np.array([[4 * i + 1, 4 * i + 2] for i in range(6)])
    faces = faces_between(x, opening, across, [])
    assert len(faces) == 12
    assert np.allclose(np.unique(faces[..., 1]), [1.5, 2.5])
    assert faces[..., 0].min() == pytest.approx(-0.5) and faces[..., 0].max() == pytest.approx(5.5)
    # Bonds that are no neighbours have no face, and nothing broken no crack.
    assert len(faces_between(x, opening, np.array([[0, 23]]), [])) == 0
    assert len(faces_between(x, opening, np.empty((0, 2), dtype=np.int64), [])) == 0
    # Neither side of a crack is fitted through it.
    F, inside = about(x, opening, np.concatenate([across, across + np.array([0, 1]), across - np.array([1, 0])]), [])
    assert not inside[np.unique(across)].any() and np.allclose(F[inside], np.eye(2))


def test_lattices_are_told_from_other_clouds(rng):
    x = np.stack(np.meshgrid(np.arange(8.0), 1.5 * np.arange(5.0), indexing="ij"), axis=-1).reshape(-1, 2)
    assert np.allclose(lattice_steps(1e-9 * x), [1e-9, 1.5e-9])
    hole = np.hypot(x[:, 0] - 3.5, x[:, 1] - 3.0) > 1.6
    assert np.allclose(lattice_steps(x[hole]), [1.0, 1.5])
    assert lattice_steps(x + rng.uniform(-0.2, 0.2, x.shape)) is None


def test_a_picture_of_a_part_of_the_particles_says_so(plane, solid, monkeypatch):
    monkeypatch.setattr(scene, "MOST", 30)
    drawn = scene_of(plane, "stress", "xx", 1.0, "bar")
    assert len(drawn.x) == 24 and len(drawn.cracks) == 0
    assert drawn.title.endswith(" N, 1 particle in 3 shown, cracks not drawn")
    assert scene_of(solid, "stress", "xx", 1.0, "bar").title.endswith(" MN, 1 particle in 7 shown")


def test_round_off_does_not_fill_the_scale_of_colours():
    low, high = limits_of(100.0 + 1e-9 * np.arange(50.0))
    assert low == pytest.approx(95.0) and high == pytest.approx(105.0)
    assert limits_of(np.array([np.nan, 1.0, 2.0])) == pytest.approx((1.005, 1.995))
    assert limits_of(np.full(3, np.nan)) == (0.0, 1.0)


def colours(path):
    """Return how many points of a picture are neither white, grey nor black."""
    pixels = np.asarray(Image.open(path).convert("RGB")).astype(int)
    return int((np.ptp(pixels, axis=-1) > 40).sum())


@pytest.mark.parametrize("suffix", [".png", ".svg", ".pdf"])
def test_a_plane_body_is_drawn(plane, tmp_path, suffix):
    path = tmp_path / f"p{suffix}"
    draw_field(plane, path, "stress", "xx", 1.0, "bar")
    assert path.stat().st_size > 5_000
    if suffix == ".png":
        assert colours(path) > 50_000


def test_the_size_of_the_horizon_is_drawn_to_scale(plane):
    from matplotlib.figure import Figure
    from matplotlib.patches import Circle

    scene = scene_of(plane, "stress", "xx", 1.0, "bar")
    figure = Figure()
    axes = figure.add_subplot()
    low, high = picture._framed(scene, None)
    picture._plane(figure, axes, scene, low, high)
    (circle,) = [patch for patch in axes.patches if isinstance(patch, Circle)]
    assert circle.radius == pytest.approx(1.0075) and axes.get_aspect() == 1.0
    assert circle.center[1] + circle.radius < scene.y[:, 1].min() and circle.center[1] - circle.radius > low[1]


def test_a_film_has_a_frame_for_each_step_with_the_same_axes(plane, tmp_path):
    path = tmp_path / "film.gif"
    assert draw_film(plane, path, "displacement", "x", 1.0, "bar") == 3
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
        draw_film(plane, tmp_path / "film.avi", "displacement", "x", 1.0, "bar")


def test_a_solid_body_is_drawn_by_pyvista_without_a_display(solid, tmp_path, monkeypatch, caplog):
    pytest.importorskip("pyvista")
    monkeypatch.delenv("DISPLAY", raising=False)
    # A crack that has not begun, or of another step, is no reason to draw anything else.
    (solid / "crack.vtk").write_text(polydata([], True, "pdpetsc, step 9"))
    with caplog.at_level(logging.INFO, "pdpetsc"):
        draw_field(solid, tmp_path / "p.png", "von_mises", "", 1.0, "block")
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
    draw_field(solid, tmp_path / "p.png", "stress", "xx", 1.0, "block")
    assert "PyVista cannot draw here" in caplog.text and why in caplog.text
    assert (tmp_path / "p.png").stat().st_size > 10_000


def test_a_solid_body_is_drawn_also_without_pyvista(solid, tmp_path, monkeypatch, caplog):
    monkeypatch.setattr(picture.importlib.util, "find_spec", lambda name: None)
    with caplog.at_level(logging.INFO, "pdpetsc"):
        draw_field(solid, tmp_path / "p.png", "displacement", "x", 1.0, "block")
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
    assert draw_film(tmp_path, tmp_path / "film.gif", "displacement", "x", 1.0, "line") == 3
    limits, _ = frame_of(tmp_path, "displacement", "x", 1.0, [0, 1, 2])
    assert limits == (0.0, result.field("displacement").max())


@pytest.mark.long
def test_a_film_of_a_solid_body_is_drawn_in_one_process(solid, tmp_path, monkeypatch):
    pytest.importorskip("pyvista")
    started = []
    run = picture.subprocess.run
    monkeypatch.setattr(picture.subprocess, "run", lambda *words, **given: started.append(1) or run(*words, **given))
    assert draw_film(solid, tmp_path / "film.gif", "displacement", "x", 1.0, "block") == 2
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
    drawn, full = (scene_of(folder, "displacement", "y", 1.0, "plate") for folder in (half.folder, whole.folder))
    # The crack is the border of the half, and has two faces in the whole; cells are drawn alike.
    assert len(drawn.cracks) == 0 and len(full.cracks) == 40
    above = np.flatnonzero(full.x[:, 1] > 0.0)
    assert np.allclose(full.x[above], drawn.x, atol=1e-12)
    assert np.allclose(full.F[above], drawn.F, atol=1e-3) and np.array_equal(full.inside[above], drawn.inside)


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
    scene = scene_of(tmp_path, "displacement", "x", 1.0, "graded")
    # Next to a coarse particle a fine one may be no larger than what is beside it.
    assert np.median(np.abs(scene.size / unit / volume ** (1.0 / dim) - 1.0)) < 1e-9
    assert (scene.size**dim).sum() == pytest.approx(volume.sum() * unit**dim, rel=0.1)
    draw_field(tmp_path, tmp_path / "p.png", "displacement", "x", 1.0, "graded")
    if dim == 2:
        shown = np.asarray(Image.open(tmp_path / "p.png").convert("RGB")).astype(int)
        drawn = (shown.max(axis=2) - shown.min(axis=2)) > 40
        # The columns of the body, left of the scale of colours, are covered; discs leave gaps of a tenth.
        body = drawn[:, : int(0.8 * drawn.shape[1])]
        rows, columns = np.flatnonzero(body.any(axis=1)), np.flatnonzero(body.any(axis=0))
        inside = body[rows[0] : rows[-1], columns[0] : columns[-1]]
        assert inside.mean() > 0.85


def test_a_crack_among_coarse_particles_of_a_graded_cloud_is_drawn():
    """Its faces are longer than any among the fine ones, which are most."""
    x, volume = graded(2, finest=0.125)
    assert LONGEST_FACE * np.median(volume) ** 0.5 < 0.5
    line = [[[4.0, 6.0], [8.1, 6.0]]]
    found = faces_between(x, np.zeros_like(x), np.empty((0, 2), dtype=np.int64), line)
    length = np.linalg.norm(found[:, 1] - found[:, 0], axis=1).sum() / 2.0
    assert length == pytest.approx(4.0, rel=0.3)


def test_a_picture_of_the_displacement_needs_no_declared_field(tmp_path):
    particles = pd.Lattice((0.0, 0.0), (6.0, 3.0), 0.5)
    case = moved(particles, GRADIENT, steps=pd.Steps(1), fields=[], picture=pd.Picture(pd.displacement, "x"))
    assert pd.run(case, tmp_path).fields.names() == ["displacement"]
    assert (tmp_path / "picture.png").exists()
