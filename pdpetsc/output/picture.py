"""A picture of the last step, drawn from ``fields.h5``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.solution import Field, stress

# Particles drawn at most; of a larger cloud every n-th.
MOST = 200_000


@dataclass(frozen=True)
class Picture:
    """The deformed body coloured by a field component, in ``picture.png``; a bar is drawn as a curve.

    Parameters
    ----------
    field : Field
        What colours the particles; it is added to the fields that are written.
    component : str
        ``"x"`` of a vector, ``"xy"`` of a tensor, ``""`` of a scalar.
    scale : float
        Factor on the displacements.
    """

    field: Field = stress
    component: str = "xx"
    scale: float = 1.0


def draw(folder: Path, picture: Picture, dim: int, title: str) -> Path:
    """Draw the last step of ``fields.h5`` in ``folder`` and return the picture's path (one rank only)."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    name = picture.field.__name__
    label = f"{name} {picture.component}".strip()
    with h5py.File(folder / "fields.h5", "r") as file:
        last = file[max(group for group in file if group.startswith("step_"))]
        stride = max(1, -(-len(file["particles/id"]) // MOST))
        x = np.asarray(file["particles/position"][::stride])
        y = x + picture.scale * np.asarray(last["displacement"][::stride])
        volume = np.asarray(file["particles/volume"][::stride])
        values = _component(np.asarray(last[name][::stride]), picture.component)
    figure = Figure(figsize=(9.0, 4.5), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot(projection="3d" if dim == 3 else None)
    if dim == 1:
        order = np.argsort(x[:, 0])
        axes.plot(x[order, 0], values[order], ".-")
        axes.set(xlabel="x", ylabel=label)
    else:
        axes.set_aspect("equal", adjustable="datalim" if dim == 2 else "box")
        limits = np.percentile(values, [0.5, 99.5])
        scatter: Any = axes.scatter
        drawn = scatter(
            *y[:, :dim].T, c=values, s=_marker_area(y, volume, dim, stride), cmap="viridis", marker="o", linewidths=0,
            vmin=float(limits[0]), vmax=float(limits[1]),
        )  # fmt: skip
        figure.colorbar(drawn, label=label, shrink=0.8)
        axes.set(xlabel="x", ylabel="y")
    axes.set_title(title)
    path = folder / "picture.png"
    figure.savefig(path, dpi=130)
    return path


def _component(values: Float, name: str) -> Float:
    index = 0
    for letter in name:
        index = 3 * index + "xyz".index(letter)
    return values if values.ndim == 1 else np.asarray(values[:, index])


def _marker_area(y: Float, volume: Float, dim: int, stride: int) -> float:
    """Return a marker area in points^2 that about fills the space between particles."""
    extent = np.ptp(y, axis=0)[:dim].max()
    points_per_length = 9.0 * 72.0 * 0.7 / max(float(extent), 1e-300)
    area = float(np.prod(np.maximum(np.ptp(y, axis=0)[:2], 1e-3 * extent))) / len(y)
    return float(np.clip(1.2 * area * points_per_length**2, 0.3, 400.0))
