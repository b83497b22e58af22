"""Program that draws solid bodies with PyVista: ``python solid.py SCENE.npz PICTURE.png ...``.

Without a display or off-screen OpenGL, VTK may end its process. The process is therefore separate from the run, and
this file imports nothing of pdpetsc, so that it starts quickly.
"""

from __future__ import annotations

import importlib
import sys
from typing import Any

import numpy as np

# Largest number of faces for which edges are drawn.
EDGES = 12_000


def main(source: str, target: str) -> None:
    """Draw the arrays of a file into a picture."""
    pyvista: Any = importlib.import_module("pyvista")
    scene = np.load(source)
    plotter: Any = pyvista.Plotter(off_screen=True, window_size=[1300, 850])
    plotter.set_background("white")
    low, high = scene["limits"]
    label = str(scene["label"])
    bar = {"title": label, "vertical": True, "title_font_size": 24, "label_font_size": 22, "color": "black",
           "fmt": "%.3g", "height": 0.6, "width": 0.04, "position_x": 0.86, "position_y": 0.15}  # fmt: skip
    look = {
        "scalars": "values",
        "clim": [low, high],
        "cmap": "viridis",
        "scalar_bar_args": bar,
        "ambient": 0.8,
        "diffuse": 0.25,
        "specular": 0.0,
    }
    body = pyvista.PolyData(scene["points"], faces=scene["polygons"])
    body.cell_data["values"] = scene["values"]
    plotter.add_mesh(body, show_edges=body.n_cells < EDGES, edge_color="grey", line_width=0.5, **look)
    box = scene["box"]
    # Round numbers at the ends of the axes.
    tick = 10.0 ** np.floor(np.log10(float((box[1] - box[0]).max()))) / 5.0
    bounds = (tick * np.array([np.floor(box[0] / tick + 1e-6), np.ceil(box[1] / tick - 1e-6)])).T.ravel().tolist()
    plotter.add_text(str(scene["title"]), position="upper_left", font_size=13, color="black")
    # The axes come last, because anything added after them moves them.
    letters = {f"{letter}title": str(text) for letter, text in zip("xyz", scene["axes"], strict=True)}
    plotter.show_bounds(
        bounds=bounds, color="black", location="outer", ticks="outside", font_size=14, n_xlabels=4, n_ylabels=2,
        n_zlabels=2, fmt="%.3g", bold=False, use_3d_text=False, **letters,
    )  # fmt: skip
    middle, reach = box.mean(axis=0), float(np.linalg.norm(box[1] - box[0]))
    plotter.camera_position = [tuple(middle + reach * scene["viewed_from"]), tuple(middle), (0.0, 0.0, 1.0)]
    plotter.camera.parallel_projection = True
    plotter.reset_camera()
    # Move the body to the left of the colour scale.
    right = np.cross(plotter.camera.direction, (0.0, 0.0, 1.0))
    shift = 0.05 * reach * right / np.linalg.norm(right)
    plotter.camera.position = tuple(np.array(plotter.camera.position) + shift)
    plotter.camera.focal_point = tuple(np.array(plotter.camera.focal_point) + shift)
    # The axes of a tall body need space above and below it.
    size = box[1] - box[0]
    plotter.camera.zoom(0.92 if size[2] >= 0.9 * size.max() else 1.02)
    plotter.screenshot(target)
    plotter.close()


if __name__ == "__main__":
    for pair in zip(sys.argv[1::2], sys.argv[2::2], strict=True):
        main(*pair)
