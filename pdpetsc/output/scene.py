"""Content of the picture of a step: positions, values, cracks and labels, read from the folder of a run."""

from __future__ import annotations

import importlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from pdpetsc.arrays import Float, GlobalIndex, Mask
from pdpetsc.declare.cracks import crack_of
from pdpetsc.declare.particles import cells_of
from pdpetsc.declare.tiling import Cells, boxes
from pdpetsc.errors import CaseError
from pdpetsc.output.labels import Labels
from pdpetsc.output.reading import StoredFields, crack_records, read_history, read_summary, read_table
from pdpetsc.output.surface import read_cells
from pdpetsc.post.picture import Cut, refuse_empty, uncut
from pdpetsc.post.point_location import Held

# Largest number of particles drawn; of a larger cloud every n-th is drawn.
MOST = 200_000
# Percentiles of the values at the ends of the colour scale [%].
SHOWN = (0.5, 99.5)
# Reweighted fits of the deformation, and the deviation of a neighbour that halves its weight, over the spacing.
FITS, TORN = 5, 0.1
# Local damage from which a particle carries no stress [-].
LOOSE = 0.999
# Relative tolerance on the length of a bond between two particles; bonds to images have other lengths [-].
OWN = 1e-6


@dataclass(frozen=True)
class Settings:
    """What a picture shows.

    Attributes
    ----------
    field, component : str
        Stored field and its component that colour the body.
    scale : float
        Factor on the displacements.
    cuts : sequence of (str, float)
        Planes beyond which a solid body is not drawn.
    """

    field: str
    component: str = ""
    scale: float = 1.0
    cuts: Sequence[Cut] = ()


@dataclass(frozen=True)
class Scene:
    """A step of a run, ready to be drawn.

    Attributes
    ----------
    x : (n, 3) float64
        Positions in the undeformed body [length].
    y : (m, 3) float64
        Positions at which the particles are drawn, except those that are cut off [length].
    values : (n,) float64
        Values shown by the colours.
    dim : int
        Dimension of the picture: 1 for a curve, 2 or 3 for cells.
    cells : Cells
        Deformed cells of a plane body, or for a solid body their surface, including the faces of cracks.
    margin : float
        How far the largest cell extends from its particle [length].
    horizon : float or None
        Horizon of the run [length]; None if it is not recorded.
    cracks : (m, 2, 2) float64
        Both faces of cracks of a plane body, as segments at their deformed positions [length].
    label, title : str
        Names of the values and of the picture.
    labels : Labels
        Labels of the run.
    limits : (float, float)
        Ends of the colour scale.
    cuts : sequence of (str, float)
        Planes beyond which a solid body is not drawn.
    """

    x: Float
    y: Float
    values: Float
    dim: int
    cells: Cells
    margin: float
    horizon: float | None
    cracks: Float
    label: str
    title: str
    labels: Labels
    limits: tuple[float, float]
    cuts: Sequence[Cut] = ()

    def polygons(self) -> list[Float]:
        """Return the corners (m, dim) of each drawn cell."""
        return np.split(self.cells.points[self.cells.corners], self.cells.offsets[1:-1])


def scene_of(
    folder: Path, settings: Settings, step: int | None = None, limits: tuple[float, float] | None = None
) -> Scene:
    """Return the scene of a step, the last one by default (one rank only).

    Raises
    ------
    CaseError
        There is no such run, step, field or component, or the cuts are not possible.
    """
    stored = StoredFields(folder)
    if "displacement" not in stored.names(step):
        raise CaseError(
            f"{folder} has no displacements to draw a body with; add displacement to the fields of the case."
        )
    summary = read_summary(folder) if (folder / "summary.json").exists() else {}
    labels = Labels.of(summary)
    stride = _stride(stored)
    scale, cuts = settings.scale, settings.cuts
    x = stored.of_particles("position", stride)
    u = scale * stored.field("displacement", step, stride)
    values = component_of(stored.field(settings.field, step, stride), settings.component)
    body = _body_of(folder, stored, summary, step, scale, stride, cuts)
    dim = body.moved.points.shape[1]
    shown = stored.steps[-1] if step is None else step
    label = labels.field(settings.field, settings.component)
    enlarged = "" if scale == 1.0 else f", displacements \N{MULTIPLICATION SIGN} {scale:g}"
    words = (
        f"{folder.resolve().name}: {label}\nstep {shown}, {_load(folder, shown, stored.time(shown), labels)}{enlarged}"
    )
    horizon = float(summary["horizon"]) if isinstance(summary.get("horizon"), int | float) else None
    if dim == 3 and horizon:
        words += f", horizon {labels.length(horizon)}"
    if stride > 1:
        words += f", 1 particle in {stride} shown"
        if summary.get("cuts") or summary.get("cracks") or (folder / "broken_bonds.csv").exists():
            words += ", cracks not drawn"
    if cuts:
        words += "\n" + ", ".join(f"{axis} > {labels.length(at)}" for axis, at in cuts) + " cut off"
    return Scene(
        x, (x + u)[uncut(x, cuts)], values, 1 if (np.ptp(x, axis=0) > 0.0).sum() < 2 else dim,
        body.moved.surface if dim == 3 else body.moved, body.margin, horizon, body.cracks, label, words, labels,
        limits or limits_of(values), cuts,
    )  # fmt: skip


def grid_of(folder: Path, step: int | None = None) -> Any:
    """Return the cells of a run as a PyVista grid in the undeformed body, with all fields of a step (one rank only).

    Fields are data of cells. ``displacement`` is also data of the corners, so that ``warp_by_vector("displacement")``
    opens cracks.

    Raises
    ------
    CaseError
        There is no such run or step.
    ImportError
        PyVista is not installed.
    """
    pyvista = importlib.import_module("pyvista")
    stored = StoredFields(folder)
    summary = read_summary(folder) if (folder / "summary.json").exists() else {}
    body = _body_of(folder, stored, summary, step, 1.0, 1)
    moved, (m, dim) = body.moved, body.moved.points.shape
    kinds = {1: lambda n: 3, 2: lambda n: 7, 3: {4: 10, 5: 14, 6: 13, 8: 12}.__getitem__}[dim]
    x, u = np.zeros((m, 3)), np.zeros((m, 3))
    x[moved.corners, :dim] = body.cells.points[body.cells.corners]
    u[:, :dim] = moved.points - x[:, :dim]
    grid = pyvista.UnstructuredGrid(
        np.insert(moved.corners, moved.offsets[:-1], moved.count), [kinds(n) for n in moved.count.tolist()], x
    )
    for name in stored.names(step):
        values = stored.field(name, step)[moved.owner]
        grid.cell_data[name] = values.reshape(len(values), -1) if values.ndim > 1 else values
    grid.point_data["displacement"] = u
    return grid


@dataclass(frozen=True)
class _Body:
    """The cells of a body at a step.

    Attributes
    ----------
    cells, moved : Cells
        Undeformed and deformed cells, each of one particle.
    cracks : (m, 2, 2) float64
        As in ``Scene``.
    margin : float
        How far the largest cell extends from its particle [length].
    """

    cells: Cells
    moved: Cells
    cracks: Float
    margin: float


def _body_of(
    folder: Path, stored: StoredFields, summary: Mapping[str, Any], step: int | None, scale: float, stride: int,
    cuts: Sequence[Cut] = (),
) -> _Body:  # fmt: skip
    """Return the cells of the particles of a run at a step, or boxes if only every n-th particle is drawn.

    Runs of earlier versions have no file of cells; the cells are then computed from positions and volumes.
    """
    position, volume = (stored.of_particles(name, stride) for name in ("position", "volume"))
    cells = read_cells(folder, stored.run) if stride == 1 else None
    extent = max(1, int((np.ptp(position, axis=0) > 0.0).sum()))
    dim = int(summary.get("dimension") or extent) if cells is None else cells.points.shape[1]
    x, names = position[:, :dim], stored.names(step)
    u = scale * stored.field("displacement", step, stride)[:, :dim] if "displacement" in names else np.zeros_like(x)
    depth = float(summary.get("thickness") or 1.0) if dim < 3 else 1.0
    if stride > 1:
        cells, held = boxes(x, (stride * volume / depth) ** (1.0 / dim)), Held(x)
    else:
        cells = cells or cells_of(x, volume, depth)
        cracks = [crack for record in crack_records(summary) if (crack := crack_of(record)) is not None]
        held = Held(x, cracks, broken_pairs(folder, stored.steps[-1] if step is None else step, position))
    refuse_empty(cuts, int(uncut(x if extent > 1 else position[:, :1], cuts).sum()))
    for axis, at in cuts:
        cells = cells.below("xyz".index(axis), at)
    cells = cells.own
    damage = stored.field("local_damage", step, stride) if "local_damage" in names else np.zeros(len(x))
    reach = cells.points[cells.corners] - x[np.repeat(cells.owner, cells.count)]
    return _Body(cells, *deformed(cells, x, u, held, damage >= LOOSE), float(np.linalg.norm(reach, axis=1).max()))


def deformed(cells: Cells, x: Float, u: Float, held: Held, loose: Mask) -> tuple[Cells, Float]:
    """Return the cells moved with their particles, and both faces of the cracks between them.

    Cells separate if a crack or broken bond separates their particles, or if both particles are loose.

    Parameters
    ----------
    cells : Cells
        Undeformed cells, each of one particle.
    x, u : (n, dim) float64
        Positions and displacements of the particles [length].
    held : Held
        Cracks and broken bonds.
    loose : (n,) bool
        Particles that carry no stress.

    Returns
    -------
    Cells
        The same cells, with more points along open cracks.
    (m, 2, 2) float64
        The faces as segments [length], of a plane body; none of other bodies.
    """
    F = gradients(x, u, held)

    def carried(particle: GlobalIndex, points: Float) -> Float:
        away = points - x[particle]
        return np.asarray(x[particle] + u[particle] + np.einsum("nij,nj->ni", F[particle], away))

    a, b = cells.faces.shared
    p, q = (cells.owner[cells.faces.cell[side]] for side in (a, b))
    broken = p != q
    broken[broken] = ~held.connects(p[broken], q[broken, None])[:, 0]
    joined = ~broken & ~((p != q) & loose[p] & loose[q])
    moved = cells.moved(carried, (a[joined], b[joined]))
    if x.shape[1] != 2:
        return moved, np.empty((0, 2, 2))
    edges = cells.faces.turn[np.concatenate([a[broken], b[broken]]), :2]
    return moved, np.asarray(moved.points[moved.corners[edges]])


def frame_of(folder: Path, settings: Settings, steps: Sequence[int]) -> tuple[tuple[float, float], tuple[Float, Float]]:
    """Return the ends of the colour scale and the corners common to several steps, reading one step at a time.

    Raises
    ------
    CaseError
        There is no such step, field or component, or the cuts are not possible.
    """
    stored = StoredFields(folder)
    stride = _stride(stored)
    x = stored.of_particles("position", stride)
    dim = int((np.ptp(x, axis=0) > 0.0).sum())
    left = uncut(x, settings.cuts)
    refuse_empty(settings.cuts, int(left.sum()))
    ends, lows, highs = [], [], []
    for step in steps:
        values = component_of(stored.field(settings.field, step, stride), settings.component)
        # The scale of a curve includes its peaks.
        ends.append(limits_of(values) if dim > 1 else (float(np.nanmin(values)), float(np.nanmax(values))))
        y = (x + settings.scale * stored.field("displacement", step, stride))[left]
        lows.append(y.min(axis=0))
        highs.append(y.max(axis=0))
    return _without_round_off(float(np.min(ends)), float(np.max(ends))), (np.min(lows, axis=0), np.max(highs, axis=0))


def _stride(stored: StoredFields) -> int:
    """Return n if every n-th particle is drawn."""
    return max(1, -(-stored.n_particles // MOST))


def limits_of(values: Float) -> tuple[float, float]:
    """Return the ends of the colour scale, without the outermost values, which may be those of few particles."""
    finite = values[np.isfinite(values)]
    if not len(finite):
        return 0.0, 1.0
    low, high = (float(limit) for limit in np.percentile(finite, SHOWN))
    largest = float(np.abs(finite).max())
    if high - low <= 1e-9 * largest:
        # Do not magnify round-off.
        return low - 0.05 * abs(low), high + 0.05 * abs(high)
    return _without_round_off(low, high, largest)


def _without_round_off(low: float, high: float, largest: float = 0.0) -> tuple[float, float]:
    """Return the ends of a scale, with 0 for an end that is round-off relative to the other or the largest value."""
    least = 1e-9 * max(abs(low), abs(high), largest)
    return (0.0 if abs(low) <= least else low), (0.0 if abs(high) <= least else high)


def _load(folder: Path, step: int, t: float, labels: Labels) -> str:
    """Return the load at a step in words: step time, and first force of the history."""
    said = f"load t = {t:.4g}"
    force = labels.first_of("force")
    if force is None:
        return said
    try:
        history = read_history(folder)
    except CaseError:
        return said
    at = np.flatnonzero(history["step"] == step)
    if force not in history or not len(at):
        return said
    unit = labels.unit_of_column(force)
    return f"{said}, {force} = {history[force][at[-1]]:.4g}{f' {unit}' if unit else ''}"


def component_of(values: Float, name: str) -> Float:
    """Return a component of a stored field; raises CaseError if it does not exist."""
    width = values.ndim - 1
    if len(name) != width or any(letter not in "xyz" for letter in name):
        raise CaseError(f"A component of this field is {('empty', 'x, y or z', 'xx, xy, ...')[width]}, not {name!r}.")
    index: tuple[slice | int, ...] = (slice(None), *map("xyz".index, name))
    return np.asarray(values[index])


def gradients(x: Float, u: Float, held: Held) -> Float:
    """Return the deformation gradients (n, dim, dim) of a linear fit to the nearest particles not separated by cracks.

    Parameters
    ----------
    x, u : (n, dim) float64
        Positions and displacements [length].
    """
    n, dim = x.shape
    F = np.tile(np.eye(dim), (n, 1, 1))
    # The fit for a body of one layer is within the layer.
    axes = np.flatnonzero(np.ptp(x, axis=0) > 0.0)
    most = min(n, {0: 1, 1: 3, 2: 9, 3: 19}[len(axes)])
    if most < 2:
        return F
    distance, near = scipy.spatial.cKDTree(x).query(x, k=most)
    distance, near = distance[:, 1:], near[:, 1:]
    connected = held.connects(np.arange(n), near)
    # Particles of two bodies in contact may coincide.
    nearest = np.where(distance > 0.0, distance, np.inf).min(axis=1, keepdims=True)
    weight = np.where(connected, np.exp(-((distance / (1.5 * nearest)) ** 2)), 0.0)
    xi, eta = ((x[near] - x[:, None])[..., axes] / nearest[..., None], (u[near] - u[:, None]) / nearest[..., None])
    slope = np.zeros((n, dim, len(axes)))
    for _ in range(FITS):
        # A neighbour that deviates from the fit is beyond a crack that is not recorded.
        apart = np.linalg.norm(eta - np.einsum("nij,nkj->nki", slope, xi), axis=2)
        seen = weight / (1.0 + (apart / TORN) ** 2)
        moments = np.einsum("nk,nki,nkj->nij", seen, xi, xi)
        good = np.linalg.cond(moments) < 1e4
        slope[good] = np.einsum("nk,nki,nkj->nij", seen, eta, xi)[good] @ np.linalg.inv(moments[good])
    F[:, :, axes] += slope
    # The fit may fail if fragments fly apart; their cells are then drawn undeformed.
    F[(np.abs(F) > 5.0).any(axis=(1, 2))] = np.eye(dim)
    return F


def broken_pairs(folder: Path, step: int, x: Float) -> NDArray[np.int64]:
    """Return the ids of the ends of the bonds that were broken at a step (n, 2), from ``broken_bonds.csv``.

    Bonds to images of particles, across a mirror plane or a period, are left out: the table names the original
    particle, whose own bond may be intact.

    Parameters
    ----------
    x : (n, dim) float64
        Positions of all particles in creation order, to recognise bonds to images [length].
    """
    try:
        table = read_table(folder / "broken_bonds.csv")
        steps, lengths = table["step"], table["length"]
        found = np.stack([table["i"], table["j"]], axis=1).astype(np.int64)
    except (CaseError, KeyError):
        return np.empty((0, 2), dtype=np.int64)
    known = (found < len(x)).all(axis=1) & (steps <= step)
    found, lengths = found[known], lengths[known]
    apart = np.linalg.norm(x[found[:, 0]] - x[found[:, 1]], axis=1)
    return np.asarray(found[np.abs(lengths - apart) <= OWN * lengths])
