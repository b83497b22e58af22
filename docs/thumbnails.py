"""Thumbnails of the gallery: the field of a run on the deformed body, without axes and text."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from PIL import Image, ImageChops

from pdpetsc.output.reading import read_summary
from pdpetsc.output.scene import Scene, Settings, scene_of

# Sizes of a thumbnail [inch], of solid bodies before the white rim is cut off, and resolution [dots per inch].
SIZE, SIZE_OF_SOLID, DPI = (3.2, 1.6), (4.8, 4.8), 225
COLOURS = "viridis"
MARGIN = 0.02


def thumbnail(folder: Path, path: Path) -> None:
    """Draw the picture of a run as a PNG file for a card of the gallery."""
    shown = read_summary(folder)["picture"]
    scene = scene_of(folder, Settings(shown["field"], shown["component"], shown["scale"]))
    figure = Figure(figsize=SIZE)
    (draw_line, draw_plane, draw_solid)[scene.dim - 1](figure, scene)
    figure.savefig(path, dpi=DPI, format="png")
    if scene.dim == 3:
        cut_rim(path)


def bare_axes(figure: Figure, **options: Any) -> Any:
    """Add axes that fill the figure, without a frame."""
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0), **options)
    axes.set_axis_off()
    return axes


def draw_line(figure: Figure, scene: Scene) -> None:
    """Draw the values of a bar along its length."""
    order = np.argsort(scene.x[:, 0])
    axes = bare_axes(figure)
    axes.margins(0.05, 0.1)
    axes.plot(scene.x[order, 0], scene.values[order], color=colormaps[COLOURS](0.3), linewidth=3.0)


def draw_plane(figure: Figure, scene: Scene) -> None:
    """Draw the deformed cells of a plane body and its cracks."""
    corners = scene.polygons()
    drawn = PolyCollection(
        corners, array=scene.values[scene.cells.owner], cmap=COLOURS, edgecolors="face", linewidths=0.3
    )
    drawn.set_clim(*scene.limits)
    axes = bare_axes(figure)
    axes.add_collection(drawn, autolim=False)
    if len(scene.cracks):
        axes.add_collection(LineCollection(list(scene.cracks), colors="black", linewidths=0.8, capstyle="round"))
    points = np.concatenate(corners)
    low, high = points.min(axis=0), points.max(axis=0)
    edge = MARGIN * (high - low).max()
    axes.set(xlim=(low[0] - edge, high[0] + edge), ylim=(low[1] - edge, high[1] + edge), aspect="equal")


def draw_solid(figure: Figure, scene: Scene) -> None:
    """Draw the deformed surface of a solid body, lit from the side."""
    corners = scene.polygons()
    values = Normalize(*scene.limits, clip=True)(scene.values[scene.cells.owner])
    figure.set_size_inches(SIZE_OF_SOLID)
    axes = bare_axes(figure, projection="3d")
    drawn = Poly3DCollection(corners, facecolors=colormaps[COLOURS](values), shade=True, linewidths=0.0)
    axes.add_collection3d(drawn)
    points = np.concatenate(corners)
    low, high = points.min(axis=0), points.max(axis=0)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(np.maximum(high - low, 1e-3 * (high - low).max()))


def cut_rim(path: Path) -> None:
    """Remove the white rim of a picture."""
    with Image.open(path) as opened:
        image = opened.convert("RGB")
    box = ImageChops.invert(image).getbbox()
    image.crop(box).save(path)
