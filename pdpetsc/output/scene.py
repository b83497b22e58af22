"""What a picture shows of a step: places, values, cracks and words, read from the folder of a run."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import numpy as np
import scipy
from numpy.typing import NDArray

from pdpetsc.arrays import Float, Mask
from pdpetsc.declare.cracks import Polyline
from pdpetsc.errors import CaseError
from pdpetsc.output.labels import Labels
from pdpetsc.output.reading import StoredFields, read_history, read_summary, read_table
from pdpetsc.post.point_location import LARGEST, Held, apart

Near: TypeAlias = tuple[Float, Mask]
# Particles drawn at most; of a larger cloud every n-th.
MOST = 200_000
# Values beyond these shares of the particles do not widen the scale of colours [%].
SHOWN = (0.5, 99.5)
# Fits of the deformation about a particle, and what a neighbour may move otherwise than it says, over the spacing.
FITS, TORN = 4, 0.1
# A face between two cells longer than so many spacings has no end in the body.
LONGEST_FACE = 3.0
# How well the length of a bond is that between two particles [-]; to the image of one it is quite another.
OWN = 1e-6


@dataclass(frozen=True)
class Scene:
    """A step of a run, ready to be drawn.

    Attributes
    ----------
    x, y : (n, 3) float64
        Places in the undeformed body and where they are drawn [length].
    values : (n,) float64
        What colours them.
    dim : int
        Dimension of the body.
    steps : (dim,) float64 or None
        Sides of the cells of a lattice [length]; None for other clouds.
    size : (n,) float64
        How large each particle is drawn: the side of a square or cube of its volume [length].
    F : (n, dim, dim) float64
        How the drawn body is deformed about each particle [-].
    inside : (n,) bool
        Which particles have all neighbours of a lattice, or of another cloud any number, and no broken bond.
    horizon : float or None
        Of the run [length]; None where it is not told.
    cracks : (m, 2, 2) float64
        Both faces of cracks of a plane body, as segments where they are drawn [length].
    label, title : str
        What the values are, and what stands above the picture.
    labels : Labels
        Of the run.
    limits : (float, float)
        Ends of the scale of colours.
    """

    x: Float
    y: Float
    values: Float
    dim: int
    steps: Float | None
    size: Float
    F: Float
    inside: Mask
    horizon: float | None
    cracks: Float
    label: str
    title: str
    labels: Labels
    limits: tuple[float, float]


def scene_of(
    folder: Path, name: str, component: str, scale: float, title: str, step: int | None = None,
    limits: tuple[float, float] | None = None,
) -> Scene:  # fmt: skip
    """Return what a picture of a step shows, the last one by default (one rank only).

    Raises
    ------
    CaseError
        There is no such run, step, field or component.
    """
    stored = StoredFields(folder)
    if "displacement" not in stored.names(step):
        raise CaseError(
            f"{folder} has no displacements to draw a body with; add displacement to the fields of the case."
        )
    summary = read_summary(folder) if (folder / "summary.json").exists() else {}
    labels = Labels.of(summary)
    stride = _stride(stored)
    x = stored.of_particles("position", stride)
    u = stored.field("displacement", step, stride)
    values = component_of(stored.field(name, step, stride), component)
    dim = max(1, int((np.ptp(x, axis=0) > 0.0).sum()))
    shown = stored.steps[-1] if step is None else step
    label = labels.field(name, component)
    enlarged = "" if scale == 1.0 else f", displacements \N{MULTIPLICATION SIGN} {scale:g}"
    words = f"{title}: {label}\nstep {shown}, {_load(folder, shown, stored.time(shown), labels)}{enlarged}"
    horizon = summary.get("horizon")
    whole = stride == 1
    broken = broken_pairs(folder, shown, x) if whole else np.empty((0, 2), dtype=np.int64)
    given = summary.get("cracks") if dim == 2 else None
    lines = [line for line in given if len(line) > 1] if isinstance(given, list) else []
    if not whole:
        words += f", 1 particle in {stride} shown"
        if lines or (dim == 2 and (folder / "broken_bonds.csv").exists()):
            words += ", cracks not drawn"
        lines = []
    axes = np.flatnonzero(np.ptp(x, axis=0) > 0.0) if len(x) > 1 else np.array([0])
    F, inside = about(x[:, axes], scale * u[:, axes], broken, lines)
    cracks = faces_between(x[:, :2], scale * u[:, :2], broken, lines) if dim == 2 else np.empty((0, 2, 2))
    # A body of one layer has more dimensions than its picture.
    of_body = int(summary.get("dimension") or dim)
    depth = float(summary.get("thickness") or 1.0) if of_body < 3 else 1.0
    side = (stored.of_particles("volume", stride) / depth) ** (1.0 / of_body)
    # Where only some particles are drawn, each stands for several.
    side *= stride ** (1.0 / dim)
    return Scene(
        x, x + scale * u, values, dim, lattice_steps(x[:, axes]), sizes(x[:, axes], side), F, inside,
        float(horizon) if isinstance(horizon, int | float) else None,
        cracks, label, words, labels, limits or limits_of(values),
    )  # fmt: skip


def frame_of(
    folder: Path, name: str, component: str, scale: float, steps: Sequence[int]
) -> tuple[tuple[float, float], tuple[Float, Float]]:
    """Return the ends of the scale of colours and the corners of all that steps show, one step after another.

    Raises
    ------
    CaseError
        There is no such step, field or component.
    """
    stored = StoredFields(folder)
    stride = _stride(stored)
    x = stored.of_particles("position", stride)
    dim = int((np.ptp(x, axis=0) > 0.0).sum())
    ends, lows, highs = [], [], []
    for step in steps:
        values = component_of(stored.field(name, step, stride), component)
        # A curve is shown with its peaks.
        ends.append(limits_of(values) if dim > 1 else (float(np.nanmin(values)), float(np.nanmax(values))))
        y = x + scale * stored.field("displacement", step, stride)
        lows.append(y.min(axis=0))
        highs.append(y.max(axis=0))
    limits = float(np.min(ends)), float(np.max(ends))
    return limits, (np.min(lows, axis=0), np.max(highs, axis=0))


def _stride(stored: StoredFields) -> int:
    """Return one in how many particles is drawn."""
    return max(1, -(-stored.n_particles // MOST))


def limits_of(values: Float) -> tuple[float, float]:
    """Return the ends of a scale of colours: all but the outermost values, which may be those of few particles."""
    finite = values[np.isfinite(values)]
    if not len(finite):
        return 0.0, 1.0
    low, high = (float(limit) for limit in np.percentile(finite, SHOWN))
    largest = float(np.abs(finite).max())
    if high - low <= 1e-9 * largest:
        # Round-off is no pattern.
        return low - 0.05 * abs(low), high + 0.05 * abs(high)
    return low, high


def _load(folder: Path, step: int, t: float, labels: Labels) -> str:
    """Return what the load is at a step: its share, and the first force of the history."""
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
    """Return a component of a field as files hold it; raises CaseError where there is none."""
    width = values.ndim - 1
    if len(name) != width or any(letter not in "xyz" for letter in name):
        raise CaseError(f"A component of this field is {('empty', 'x, y or z', 'xx, xy, ...')[width]}, not {name!r}.")
    for letter in reversed(name):
        values = values[..., "xyz".index(letter)]
    return values


def spacings(x: Float) -> Float:
    """Return the mean distance of each particle from those next to it (n,) [length]."""
    if len(x) < 2:
        return np.ones(len(x))
    beside = 2 * max(1, int((np.ptp(x, axis=0) > 0.0).sum()))
    distance = scipy.spatial.cKDTree(x).query(x, k=min(1 + beside, len(x)))[0][:, 1:]
    # At a corner of a lattice some of them are farther.
    near = np.where(distance < 1.3 * distance[:, :1], distance, np.nan)
    return np.asarray(np.nanmean(near, axis=1))


def sizes(x: Float, side: Float) -> Float:
    """Return how large particles at places (n, dim) are drawn (n,) [length]: the sides of cubes of their volumes.

    These are kept between a half and one and a half times the mean distance from what is next to a particle, so that
    volumes that are no share of the body, as with another thickness than the case says, are drawn all the same.
    """
    if len(x) < 2:
        return np.ones(len(x))
    distance = apart(x)
    return np.asarray(np.clip(side, 0.5 * distance, LARGEST * distance))


def lattice_steps(x: Float) -> Float | None:
    """Return the sides of the cells of a lattice along the axes (dim,) [length], from places (n, dim) in it.

    None where the places are of no lattice, or of a line.
    """
    if x.shape[1] < 2:
        return None
    sides = []
    for along in x.T:
        places = np.unique(np.round(along / np.ptp(along), 9))
        gaps = np.diff(places)
        if not len(gaps) or not np.allclose(gaps / gaps.min(), np.round(gaps / gaps.min()), atol=1e-3):
            return None
        sides.append(gaps.min() * np.ptp(along))
    steps = np.array(sides)
    # A cloud in which no two particles share a coordinate is a lattice of holes.
    filled = len(x) / np.prod(np.round(np.ptp(x, axis=0) / steps) + 1.0)
    return steps if filled > 0.2 and steps.max() < 3.0 * steps.min() else None


def about(x: Float, u: Float, broken: NDArray[np.int64], lines: Sequence[Sequence[Sequence[float]]]) -> Near:
    """Return how a body is deformed about each particle, and which particles are inside of it.

    The gradient is that of a linear fit to the nearest particles whose bond is not broken.

    Parameters
    ----------
    x, u : (n, dim) float64
        Places and displacements [length].
    broken : (n, 2) int64
        Pairs of particles whose bonds are broken.
    lines : sequence of polylines
        Cracks of a plane body from the start.
    """
    n, dim = x.shape
    F = np.tile(np.eye(dim), (n, 1, 1))
    most = min(n, {1: 3, 2: 9, 3: 19}[dim])
    if most < 2:
        return F, np.zeros(n, dtype=bool)
    distance, near = scipy.spatial.cKDTree(x).query(x, k=most)
    distance, near = distance[:, 1:], near[:, 1:]
    cracks = [Polyline(line) for line in lines] if dim == 2 else []
    held = Held(x, cracks, broken).together(np.arange(n), near)
    nearest = np.maximum(distance[:, :1], np.finfo(float).tiny)
    weight = np.where(held, np.exp(-((distance / (1.5 * nearest)) ** 2)), 0.0)
    xi, eta = (x[near] - x[:, None]) / nearest[..., None], (u[near] - u[:, None]) / nearest[..., None]
    seen = weight
    for _ in range(FITS):
        moments = np.einsum("nk,nki,nkj->nij", seen, xi, xi)
        good = np.linalg.cond(moments) < 1e4
        slope = np.einsum("nk,nki,nkj->nij", seen, eta, xi)[good] @ np.linalg.inv(moments[good])
        F[good] = np.eye(dim) + slope
        # What does not move as the others do is on the other side of a crack that nobody has told of.
        apart = np.linalg.norm(eta - np.einsum("nij,nkj->nki", F - np.eye(dim), xi), axis=2)
        seen = weight / (1.0 + (apart / TORN) ** 2)
    # A fit may make no sense where pieces fly apart; cells are then drawn as they were.
    F[(np.abs(F) > 5.0).any(axis=(1, 2))] = np.eye(dim)
    inside = ((distance < 1.2 * nearest) & held).sum(axis=1) >= 2 * dim
    return F, inside & (held & (apart < 3.0 * TORN)).all(axis=1)


def broken_pairs(folder: Path, step: int, x: Float) -> NDArray[np.int64]:
    """Return the ids of the ends of the bonds that were broken at a step (n, 2), from ``broken_bonds.csv``.

    Bonds to images of particles, beyond a mirror plane or a period, are left out: the table names the particle that an
    image is of, whose own bond may be whole.

    Parameters
    ----------
    x : (n, dim) float64
        Places of all particles in creation order [length], which tell the one from the other.
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


def faces_between(x: Float, u: Float, broken: NDArray[np.int64], lines: list[list[list[float]]]) -> Float:
    """Return both faces of the cracks of a plane body, moved with the particles on either side.

    A face is that between the cells of neighbouring particles, in the sense of Voronoi, whose bond is broken or runs
    across a line that cuts from the start.

    Parameters
    ----------
    x, u : (n, 2) float64
        Places and displacements of the particles [length].
    broken : (n, 2) int64
        Pairs of particles whose bonds are broken.
    lines : list of polylines
        Cracks from the start, each as points in the plane [length].

    Returns
    -------
    (m, 2, 2) float64
        Segments.
    """
    none = np.empty((0, 2, 2))
    lines = [line for line in lines if len(line) > 1 and all(len(point) == 2 for point in line)]
    broken = broken[(broken < len(x)).all(axis=1)]
    if len(x) < 4 or not (len(broken) or lines):
        return none
    spacing = spacings(x)
    near = np.unique(broken)
    if lines:
        low, high = (bound(np.array([p for line in lines for p in line]), axis=0) for bound in (np.min, np.max))
        beside = 4.0 * spacing[:, None]
        near = np.union1d(near, np.flatnonzero(((x > low - beside) & (x < high + beside)).all(axis=1)))
    if not len(near):
        return none
    # Where the size of particles changes the larger ones reach farther.
    widest = float(spacing[near].max())
    zone = np.flatnonzero(scipy.spatial.cKDTree(x[near]).query(x, distance_upper_bound=4.0 * widest)[0] < math.inf)
    try:
        diagram = scipy.spatial.Voronoi((x[zone] - x[zone].mean(axis=0)) / widest)
    except (scipy.spatial.QhullError, ValueError):
        return none
    pairs = np.sort(zone[diagram.ridge_points], axis=1)
    ends = np.array(diagram.ridge_vertices, dtype=np.int64)
    gone = np.isin(pairs @ [len(x), 1], np.sort(broken, axis=1) @ [len(x), 1])
    for line in lines:
        gone |= Polyline(line).cuts(x[pairs[:, 0]], x[pairs[:, 1]])
    gone &= (ends >= 0).any(axis=1)
    pairs, ends = pairs[gone], ends[gone]
    corners = diagram.vertices[ends] * widest + x[zone].mean(axis=0)
    # Between cells at the surface a face has one end; it is taken to be as long on the other side of its middle.
    middle = x[pairs].mean(axis=1)
    for side in (0, 1):
        open_ended = ends[:, side] < 0
        corners[open_ended, side] = (2.0 * middle - corners[:, 1 - side])[open_ended]
    longest = LONGEST_FACE * spacing[pairs].max(axis=1)
    long = np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1) > longest
    far = np.linalg.norm(x[pairs[:, 1]] - x[pairs[:, 0]], axis=1) > longest
    pairs, corners = pairs[~(long | far)], corners[~(long | far)]
    return np.concatenate([corners + u[pairs[:, side]][:, None] for side in (0, 1)])
