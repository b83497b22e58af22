"""Pictures of steps, drawn from ``fields.h5``: the deformed body in the plane and in space, curves along a line."""

from __future__ import annotations

import importlib
import importlib.util
import logging
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.errors import CaseError
from pdpetsc.output.files import replacing
from pdpetsc.output.reading import StoredFields
from pdpetsc.output.scene import Scene, Settings, frame_of, scene_of

LOG = logging.getLogger("pdpetsc")
# Resolution of pictures and of the frames of a film [dots per inch].
DPI, DPI_OF_FRAMES = 150, 90
# Largest number of frames of a film, and frames per second.
FRAMES, PER_SECOND = 120, 10
# Steps of a film that one process draws.
PER_PROCESS = 8
# Time limit of PyVista for one picture [s].
LONGEST = 120
# Mark by which a later run recognises pictures that it may move aside.
MARK = {"Software": "pdpetsc"}
_SOLID = Path(__file__).with_name("solid.py")


def draw_field(folder: Path, path: Path, settings: Settings, step: int | None = None) -> None:
    """Draw a field of a step of ``fields.h5``, the last one by default, into ``path`` (one rank only).

    Raises
    ------
    CaseError
        There is no such file, step, field or component, or the cuts are not possible.
    OutputError
        The picture cannot be written.
    """
    scene = scene_of(folder, settings, step)
    with replacing(path) as aside:
        _draw_scenes([scene], [aside], path.suffix.removeprefix(".") or "png")


def picture_of_run(folder: Path, field: str | None = None, component: str = "", scale: float = 1.0) -> bytes | None:
    """Return a picture of a run at the last step as PNG, by default the picture drawn at the end of the run.

    If there is none, the colours show von Mises stress or, without this field, the displacement along x. The result is
    None if no field is chosen and the run has neither a picture nor displacements.

    Raises
    ------
    CaseError
        The folder holds no fields, or no such field or component.
    """
    names = StoredFields(folder).names()
    if field is None:
        stored = _stored_picture(folder) if scale == 1.0 else None
        if stored is not None or "displacement" not in names:
            return stored
        field, component = ("von_mises", "") if "von_mises" in names else ("displacement", "x")
    with tempfile.TemporaryDirectory() as place:
        path = Path(place) / "picture.png"
        draw_field(folder, path, Settings(field, component, scale))
        return path.read_bytes()


def _stored_picture(folder: Path) -> bytes | None:
    try:
        path = folder / "picture.png"
        # The picture is drawn after the last summary; an older picture shows the run before a restart.
        return path.read_bytes() if path.stat().st_mtime >= (folder / "summary.json").stat().st_mtime else None
    except OSError:
        return None


def draw_film(folder: Path, path: Path, settings: Settings) -> int:
    """Draw a field of all steps into a ``.gif`` or ``.mp4`` and return the number of frames (one rank only).

    All frames have the same colour scale and axes. If there are more than 120 steps, every n-th is drawn.

    Raises
    ------
    CaseError
        There is no such field or component, the cuts are not possible, the file name has another suffix, or no
        installed program writes films of this format.
    OutputError
        The film cannot be written.
    """
    kind = path.suffix
    if kind not in (".gif", ".mp4"):
        raise CaseError(f"A film is a .gif or an .mp4, not {path.name}.")
    if kind == ".mp4" and film_format() != "mp4":
        raise CaseError("An .mp4 is written by the program ffmpeg, which is not installed; take format=gif.")
    steps = StoredFields(folder).steps
    chosen = steps[:: max(1, -(-len(steps) // FRAMES))]
    if chosen[-1] != steps[-1]:
        chosen.append(steps[-1])
    limits, box = frame_of(folder, settings, chosen)
    with tempfile.TemporaryDirectory() as place, replacing(path) as aside:
        frames = [Path(place) / f"{number:05d}.png" for number in range(len(chosen))]
        for first in range(0, len(chosen), PER_PROCESS):
            some = slice(first, first + PER_PROCESS)
            scenes = [scene_of(folder, settings, step, limits) for step in chosen[some]]
            _draw_scenes(scenes, frames[some], "png", box, DPI_OF_FRAMES)
        (_gif if kind == ".gif" else _mp4)(frames, aside)
    return len(frames)


def _gif(frames: list[Path], path: Path) -> None:
    from PIL import Image

    opened = [Image.open(frame).convert("P", palette=Image.Palette.ADAPTIVE) for frame in frames]
    # The last frame is shown one second longer.
    times = [1000 // PER_SECOND] * (len(frames) - 1) + [1000 + 1000 // PER_SECOND]
    with path.open("wb") as file:
        opened[0].save(
            file, format="GIF", save_all=True, append_images=opened[1:], duration=times, loop=0, comment=b"pdpetsc"
        )


def film_format() -> str:
    """Return the format of films: mp4 if ffmpeg is installed, else gif."""
    from matplotlib.animation import FFMpegWriter

    return "mp4" if FFMpegWriter.isAvailable() else "gif"


def _mp4(frames: list[Path], path: Path) -> None:
    from matplotlib.animation import FFMpegWriter
    from matplotlib.figure import Figure
    from matplotlib.image import imread

    first = imread(frames[0])
    # Most players require even numbers of pixels.
    height, width = (size // 2 * 2 for size in first.shape[:2])
    figure = Figure(figsize=(width / 100.0, height / 100.0), dpi=100)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_axis_off()
    image = axes.imshow(first[:height, :width])
    writer = FFMpegWriter(fps=PER_SECOND, extra_args=["-f", "mp4", "-pix_fmt", "yuv420p"], metadata=MARK)
    with writer.saving(figure, str(path), 100):
        for frame in frames:
            image.set_data(imread(frame)[:height, :width])
            writer.grab_frame()


def _draw_scenes(
    scenes: Sequence[Scene], paths: Sequence[Path], kind: str, box: tuple[Float, Float] | None = None, dpi: int = DPI
) -> None:
    """Draw steps into files of a format; ``box`` holds the corners common to all frames of a film."""
    if scenes[0].dim == 3 and kind == "png" and _drawn_by_pyvista(scenes, paths, box):
        return
    for scene, path in zip(scenes, paths, strict=True):
        _draw_scene(scene, path, kind, box, dpi)


def _draw_scene(scene: Scene, path: Path, kind: str, box: tuple[Float, Float] | None, dpi: int) -> None:
    """Draw a step with Matplotlib."""
    from matplotlib.figure import Figure

    low, high = _framed(scene, box)
    figure = Figure(figsize=_size(low, high, scene.dim), layout="constrained")
    axes = figure.add_subplot(projection="3d" if scene.dim == 3 else None)
    (_curve, _plane, _space)[scene.dim - 1](figure, axes, scene, low, high)
    if scene.dim == 1 and box is not None:
        edge = 0.05 * (scene.limits[1] - scene.limits[0]) or 1.0
        axes.set_ylim(scene.limits[0] - edge, scene.limits[1] + edge)
    axes.set_title(scene.title, fontsize=11)
    figure.savefig(path, dpi=dpi, format=kind, metadata=MARK if kind == "png" else None)


def _framed(scene: Scene, box: tuple[Float, Float] | None) -> tuple[Float, Float]:
    """Return the corners of the picture: the body, a margin, and space for the circle of the horizon."""
    low, high = (scene.y.min(axis=0), scene.y.max(axis=0)) if box is None else box
    margin = _margin(scene, low, high)
    low, high = low - margin, high + margin
    if scene.dim == 2 and scene.horizon:
        low[1] -= 2.0 * scene.horizon + margin
    return low, high


def _margin(scene: Scene, low: Float, high: Float) -> float:
    return max(1.2 * scene.margin, 0.02 * float((high - low).max()))


def _size(low: Float, high: Float, dim: int) -> tuple[float, float]:
    """Return the size of a figure, for a plane body adapted to its proportions [inch]."""
    if dim != 2:
        return 9.0, 4.5 if dim == 1 else 6.0
    width, height = np.maximum((high - low)[:2], 1e-3 * float((high - low).max()))
    if width > 0.7 * height:
        return 9.0, float(np.clip(7.2 * height / width + 1.3, 2.8, 10.0))
    return float(np.clip(7.5 * width / height + 2.2, 4.5, 9.0)), 9.0


def _curve(figure: Any, axes: Any, scene: Scene, low: Float, high: Float) -> None:
    order = np.argsort(scene.x[:, 0])
    few = len(order) <= 200
    axes.plot(scene.x[order, 0], scene.values[order], ".-" if few else "-", markersize=4, linewidth=1.2)
    axes.set(xlabel=scene.labels.axis("x"), ylabel=scene.label)
    if np.ptp(scene.values) <= 1e-9 * np.abs(scene.values).max():
        # Do not magnify round-off.
        middle = float(np.median(scene.values))
        axes.set_ylim(middle - (0.05 * abs(middle) or 1.0), middle + (0.05 * abs(middle) or 1.0))
    axes.grid(alpha=0.3)
    if scene.horizon:
        at = axes.get_xaxis_transform()
        begin = float(scene.x[:, 0].min())
        axes.plot([begin, begin + scene.horizon], [0.04, 0.04], "|-", color="black", transform=at, linewidth=1.5)
        axes.text(begin + scene.horizon, 0.04, "  horizon", transform=at, va="center", fontsize=9)


def _plane(figure: Any, axes: Any, scene: Scene, low: Float, high: Float) -> None:
    from matplotlib.collections import LineCollection, PolyCollection

    drawn = PolyCollection(
        scene.polygons(), array=scene.values[scene.cells.owner], cmap="viridis", edgecolors="face", linewidths=0.7,
        rasterized=True,
    )  # fmt: skip
    drawn.set_clim(*scene.limits)
    axes.add_collection(drawn, autolim=False)
    if len(scene.cracks):
        axes.add_collection(LineCollection(list(scene.cracks), colors="black", linewidths=1.1, capstyle="round"))
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    axes.set_aspect("equal")
    axes.set(xlabel=scene.labels.axis("x"), ylabel=scene.labels.axis("y"))
    _scale_of_colours(figure, axes, drawn, scene)
    if scene.horizon:
        _horizon(axes, scene, low, high)


def _horizon(axes: Any, scene: Scene, low: Float, high: Float) -> None:
    """Draw a circle of the size of the horizon below the body."""
    from matplotlib.patches import Circle

    radius = float(scene.horizon or 0.0)
    margin = 0.7 * _margin(scene, low, high)
    centre = float(low[0]) + margin + radius, float(low[1]) + 0.5 * margin + radius
    axes.add_patch(Circle(centre, radius, fill=False, color="black", linewidth=1.0))
    axes.plot(*centre, ".", color="black", markersize=2)
    axes.text(centre[0] + 1.2 * radius, centre[1], f" horizon {scene.labels.length(radius)}", va="center", fontsize=9)


def _scale_of_colours(figure: Any, axes: Any, drawn: Any, scene: Scene) -> None:
    """Draw the colour scale beside the body, with arrows if values lie beyond its ends."""
    low, high = scene.limits
    finite = scene.values[np.isfinite(scene.values)]
    beyond = (bool((finite < low).any()), bool((finite > high).any()))
    extend = {(False, False): "neither", (True, False): "min", (False, True): "max", (True, True): "both"}[beyond]
    wide = figure.get_figwidth() > 2.0 * figure.get_figheight()
    figure.colorbar(drawn, ax=axes, label=scene.label, shrink=0.9 if wide else 0.75, extend=extend, pad=0.02)


def _space(figure: Any, axes: Any, scene: Scene, low: Float, high: Float) -> None:
    Poly3DCollection: Any = importlib.import_module("mpl_toolkits.mplot3d.art3d").Poly3DCollection

    extent = np.maximum(high - low, 1e-3 * float((high - low).max()))
    drawn = Poly3DCollection(scene.polygons(), cmap="viridis", linewidths=0.2)
    drawn.set_array(scene.values[scene.cells.owner])
    axes.add_collection3d(drawn)
    drawn.set_edgecolor("face")
    axes.set(**{f"{letter}lim": ends for letter, *ends in zip("xyz", low, high, strict=True)})
    drawn.set_clim(*scene.limits)
    axes.set_box_aspect(extent, zoom=0.9)
    axes.view_init(azim=60.0 if _from_behind(scene) else -60.0)
    axes.set(**{f"{letter}label": scene.labels.axis(letter) for letter in "xyz"})
    for axis, share in zip("xyz", extent / extent.max(), strict=True):
        axes.locator_params(axis=axis, nbins=max(1, round(6 * share)))
    _scale_of_colours(figure, axes, drawn, scene)


def _from_behind(scene: Scene) -> bool:
    """Return True if a cut face is visible from larger y only."""
    return any(axis == "y" for axis, _ in scene.cuts)


def _drawn_by_pyvista(scenes: Sequence[Scene], paths: Sequence[Path], box: tuple[Float, Float] | None) -> bool:
    """Draw solid bodies with PyVista; return False if it is not installed or does not work without a display."""
    if importlib.util.find_spec("pyvista") is None:
        LOG.info("PyVista is not installed: the solid body is drawn by Matplotlib (pip install pyvista)")
        return False
    # With the variables of MPI the other process would start as a rank.
    of_mpi = ("OMPI_", "PMI_", "PMIX_", "MPI_", "HYDRA_", "PRTE_")
    environment = {name: value for name, value in os.environ.items() if not name.startswith(of_mpi)}
    environment["MPLBACKEND"] = "agg"
    why = "no picture came out"
    with tempfile.TemporaryDirectory() as place:
        words, targets = [sys.executable, str(_SOLID)], []
        for number, scene in enumerate(scenes):
            source, target = Path(place) / f"{number}.npz", Path(place) / f"{number}.png"
            _hand_over(scene, source, box)
            words += [str(source), str(target)]
            targets.append(target)
        patience = LONGEST * len(scenes)
        try:
            done = subprocess.run(words, env=environment, capture_output=True, text=True, timeout=patience, check=False)
            if done.returncode != 0:
                why = (done.stderr.strip().splitlines() or [f"exit status {done.returncode}"])[-1]
        except (OSError, subprocess.SubprocessError) as error:
            why = str(error)
        if all(target.exists() and target.stat().st_size > 0 for target in targets):
            for target, path in zip(targets, paths, strict=True):
                _mark(target, path)
            return True
    LOG.warning("PyVista cannot draw here (%s): the solid body is drawn by Matplotlib", why)
    return False


def _hand_over(scene: Scene, path: Path, box: tuple[Float, Float] | None) -> None:
    """Write the arrays that the other process draws."""
    low, high = (scene.y.min(axis=0), scene.y.max(axis=0)) if box is None else box
    cells = scene.cells
    # Polygons in the format of VTK: the number of corners, then the corners.
    polygons = np.insert(cells.corners, cells.offsets[:-1], cells.count)
    np.savez(
        path, points=cells.points, polygons=polygons, values=scene.values[cells.owner], limits=np.array(scene.limits),
        label=scene.label, title=scene.title, box=np.array([low - scene.margin, high + scene.margin]),
        axes=np.array([scene.labels.axis(letter) for letter in "xyz"]),
        viewed_from=np.array([0.9, 1.3 if _from_behind(scene) else -1.3, 0.75]),
    )  # fmt: skip


def _mark(source: Path, path: Path) -> None:
    """Copy a picture and mark it as drawn by pdpetsc, so that a later run may move it aside."""
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

    mark = PngInfo()
    mark.add_text("Software", "pdpetsc")
    with Image.open(source) as image, path.open("wb") as file:
        image.convert("RGB").save(file, format="PNG", pnginfo=mark)
