"""A picture of the last step, drawn from ``fields.h5``."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from pdpetsc.arrays import Float
from pdpetsc.declared import Declared
from pdpetsc.errors import CaseError
from pdpetsc.output.files import replacing
from pdpetsc.output.reading import StoredFields
from pdpetsc.post.quantities import refuse_component
from pdpetsc.post.solution import Field, stress

# Particles drawn at most; of a larger cloud every n-th.
MOST = 200_000
# Diameter of a disc over the distance of neighbours: a little more than half of what hides all between them.
DISC = 1.1


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

    label = f"{name.replace('_', ' ')} {component}".strip()
    stored = StoredFields(folder)
    stride = max(1, -(-stored.n_particles // MOST))
    x = stored.of_particles("position", stride)
    y = x + scale * stored.field("displacement", step, stride)
    values = _component(stored.field(name, step, stride), component)
    dim = max(1, int((np.ptp(x, axis=0) > 0.0).sum()))
    figure = Figure(figsize=_size(y, dim), layout="constrained")
    axes = figure.add_subplot(projection="3d" if dim == 3 else None)
    if dim == 1:
        order = np.argsort(x[:, 0])
        axes.plot(x[order, 0], values[order], ".-")
        axes.set(xlabel="x", ylabel=label)
    else:
        low, high = (float(limit) for limit in np.percentile(values, [0.5, 99.5]))
        if dim == 2:
            drawn: Any = _discs(axes, y[:, :2], values, DISC * _spacing(x) * math.sqrt(stride))
            axes.set_aspect("equal")
        else:
            scatter: Any = axes.scatter
            area = _marker_area(y, stride)
            drawn = scatter(*y.T, c=values, s=area, cmap="viridis", marker="o", linewidths=0)
            _true_to_scale(axes, y)
        drawn.set_clim(low, high)
        figure.colorbar(drawn, label=label, shrink=0.8)
        axes.set(xlabel="x", ylabel="y")
    shown = stored.steps[-1] if step is None else step
    enlarged = "" if scale == 1.0 else f", displacements times {scale:g}"
    axes.set_title(f"{title}: {label}, step {shown}{enlarged}")
    with replacing(path) as aside:
        figure.savefig(aside, dpi=130, format=path.suffix.removeprefix(".") or "png", metadata={"Software": "pdpetsc"})


def _size(y: Float, dim: int) -> tuple[float, float]:
    """Return the size of a figure that a plane body about fills [inch]."""
    if dim != 2:
        return 9.0, 4.5
    width, height = np.maximum(np.ptp(y[:, :2], axis=0), 1e-3 * np.ptp(y))
    return (9.0, float(np.clip(7.5 * height / width + 1.4, 2.8, 9.0))) if width > 0.6 * height else (6.0, 9.0)


def _spacing(x: Float) -> float:
    """Return the usual distance of a particle from its nearest neighbour [length]."""
    distance = cKDTree(x).query(x, k=min(2, len(x)))[0].reshape(len(x), -1)
    return float(np.median(distance[:, -1]))


def _discs(axes: Any, y: Float, values: Float, diameter: float) -> Any:
    """Draw discs to scale at positions (n, 2), coloured by values (n,)."""
    from matplotlib.collections import EllipseCollection

    width = np.full(len(y), diameter)
    discs = EllipseCollection(
        width, width, np.zeros(len(y)), units="xy", offsets=y, offset_transform=axes.transData, cmap="viridis",
        linewidths=0,
    )  # fmt: skip
    discs.set_array(values)
    axes.add_collection(discs)
    low, high = y.min(axis=0) - diameter, y.max(axis=0) + diameter
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    return discs


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


def _marker_area(y: Float, stride: int) -> float:
    """Return the area of a marker in points^2 that about fills the space between particles of a solid."""
    extent = np.ptp(y, axis=0)
    shown = np.sort(np.maximum(extent, 1e-3 * extent.max()))[1:]
    points_per_length = 9.0 * 72.0 * 0.5 / max(float(extent.max()), 1e-300)
    return float(np.clip(2.0 * np.prod(shown) * points_per_length**2 / len(y) ** (2.0 / 3.0) / 4.0, 0.3, 400.0))
