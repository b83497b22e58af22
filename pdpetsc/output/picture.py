"""A picture of the last step, drawn from ``fields.h5``."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.declared import Declared
from pdpetsc.errors import CaseError
from pdpetsc.output.files import replacing
from pdpetsc.output.reading import StoredFields
from pdpetsc.post.quantities import refuse_component
from pdpetsc.post.solution import Field, stress

# Particles drawn at most; of a larger cloud every n-th.
MOST = 200_000


@dataclass(frozen=True)
class Picture(Declared):
    """The deformed body coloured by a field component, in ``picture.png``; a bar is drawn as a curve.

    Parameters
    ----------
    field : Field
        What colours the particles; it is added to the fields that are written.
    component : str
        ``"x"`` of a vector, ``"xy"`` of a tensor, ``""`` of a scalar.
    scale : float
        Factor on the displacements.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> shear = pd.Picture(pd.stress, "xy", scale=10.0)
    """

    field: Field = stress
    component: str = "xx"
    scale: float = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        refuse_component("A Picture", self.field, self.component)
        if not math.isfinite(self.scale):
            raise CaseError(f"A Picture needs a finite scale, not {self.scale}.")


def draw(folder: Path, picture: Picture, title: str) -> Path:
    """Draw the last step of ``fields.h5`` in ``folder`` and return the picture's path (one rank only).

    Raises
    ------
    OutputError
        The picture cannot be written.
    """
    path = folder / "picture.png"
    draw_field(folder, path, picture.field.__name__, picture.component, picture.scale, title)
    return path


def draw_field(
    folder: Path, path: Path, name: str, component: str, scale: float, title: str, step: int | None = None
) -> None:
    """Draw a field of a step of ``fields.h5``, the last one by default, into ``path`` (one rank only).

    Raises
    ------
    CaseError
        There is no such file, step, field or component.
    OutputError
        The picture cannot be written.
    """
    from matplotlib.figure import Figure

    label = f"{name} {component}".strip()
    stored = StoredFields(folder)
    stride = max(1, -(-stored.n_particles // MOST))
    x = stored.of_particles("position", stride)
    y = x + scale * stored.field("displacement", step, stride)
    volume = stored.of_particles("volume", stride)
    values = _component(stored.field(name, step, stride), component)
    dim = max(1, int((np.ptp(x, axis=0) > 0.0).sum()))
    figure = Figure(figsize=(9.0, 4.5), layout="constrained")
    axes = figure.add_subplot(projection="3d" if dim == 3 else None)
    if dim == 1:
        order = np.argsort(x[:, 0])
        axes.plot(x[order, 0], values[order], ".-")
        axes.set(xlabel="x", ylabel=label)
    else:
        limits = np.percentile(values, [0.5, 99.5])
        scatter: Any = axes.scatter
        drawn = scatter(
            *y[:, :dim].T, c=values, s=_marker_area(y, volume, dim, stride), cmap="viridis", marker="o", linewidths=0,
            vmin=float(limits[0]), vmax=float(limits[1]),
        )  # fmt: skip
        figure.colorbar(drawn, label=label, shrink=0.8)
        axes.set(xlabel="x", ylabel="y")
        if dim == 3:
            _true_to_scale(axes, y)
        else:
            axes.set_aspect("equal", adjustable="datalim")
    axes.set_title(title)
    with replacing(path) as aside:
        figure.savefig(aside, dpi=130, format=path.suffix.removeprefix(".") or "png", metadata={"Software": "pdpetsc"})


def _true_to_scale(axes: Any, y: Float) -> None:
    """Give 3D axes the proportions of the body, and thin sides few ticks."""
    extent = np.maximum(np.ptp(y, axis=0), 1e-3 * np.ptp(y))
    axes.set_box_aspect(extent, zoom=1.3)
    axes.set(zlabel="z")
    for axis, share in zip("xyz", extent / extent.max(), strict=True):
        axes.locator_params(axis=axis, nbins=max(1, round(6 * share)))


def _component(values: Float, name: str) -> Float:
    width = values.ndim - 1
    if len(name) != width or any(letter not in "xyz" for letter in name):
        raise CaseError(f"A component of this field is {('empty', 'x, y or z', 'xx, xy, ...')[width]}, not {name!r}.")
    for letter in reversed(name):
        values = values[..., "xyz".index(letter)]
    return values


def _marker_area(y: Float, volume: Float, dim: int, stride: int) -> float:
    """Return a marker area in points^2 that about fills the space between particles."""
    extent = np.ptp(y, axis=0)[:dim].max()
    points_per_length = 9.0 * 72.0 * 0.7 / max(float(extent), 1e-300)
    area = float(np.prod(np.maximum(np.ptp(y, axis=0)[:2], 1e-3 * extent))) / len(y)
    return float(np.clip(1.2 * area * points_per_length**2, 0.3, 400.0))
