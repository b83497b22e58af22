"""Pre-cracks: lines and surfaces that cut the bonds that cross them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from pdpetsc.arrays import Float, Mask
from pdpetsc.declared import Declared
from pdpetsc.errors import CaseError

# A bond that ends this close to a crack, as a share of its length, crosses it.
TOUCHING = 1e-9


class Crack(Declared, ABC):
    """A pre-crack: bonds that cross it are cut before the first step."""

    @property
    def line(self) -> Sequence[Sequence[float]]:
        """Return the points of a crack line in a plane body, for pictures; none for other cracks."""
        return ()

    def box(self, dim: int) -> tuple[Float, Float]:
        """Return the corners (dim,) of a box that holds the crack [length]; infinite by default.

        In a periodic cell a crack has all images that reach it. Along an axis in which the box is infinite, these are
        the next ones on both sides.
        """
        return np.full(dim, -np.inf), np.full(dim, np.inf)

    @abstractmethod
    def cuts(self, a: Float, b: Float) -> Mask:
        """Return True for bonds from ``a`` to ``b`` (n, dim) that cross the crack, (n,) bool.

        Raises
        ------
        CaseError
            The crack has another dimension than the body.
        """

    def normals(self, x: Float) -> Float:
        """Return the unit normals of the crack at the places on it that are nearest to ``x``, both (n, dim).

        Raises
        ------
        CaseError
            Cracks of this class have no normals.
        """
        raise CaseError(f"A crack {type(self).__name__} has no method normals, which closed cracks need.")


@dataclass(frozen=True)
class Segment(Crack):
    """A straight crack in the plane from ``start`` to ``end`` [length], both included.

    Examples
    --------
    >>> import numpy as np
    >>> import pdpetsc as pd
    >>> crack = pd.Segment((0.0, 0.5), (0.5, 0.5))
    >>> crack.cuts(np.array([[0.2, 0.4]]), np.array([[0.2, 0.6]]))
    array([ True])
    """

    start: Sequence[float]
    end: Sequence[float]

    @property
    def line(self) -> Sequence[Sequence[float]]:
        return (self.start, self.end)

    def box(self, dim: int) -> tuple[Float, Float]:
        """Return the box around both ends."""
        return _box([self.start, self.end], dim, "Segment")

    def cuts(self, a: Float, b: Float) -> Mask:
        """Return True for bonds that cross the segment."""
        p, q = _point(self.start, 2, "Segment"), _point(self.end, 2, "Segment")
        _same(a, 2, "Segment")
        along = q - p
        size = float(np.linalg.norm(along))
        if size == 0.0:
            raise CaseError("A crack Segment needs two different ends.")
        side_a, side_b = _cross(along, a - p) / size, _cross(along, b - p) / size
        crossing, close, place = _between_sides(a, b, side_a, side_b)
        where = ((place - p) @ along) / size
        return np.asarray(crossing & (where >= -close) & (where <= size + close))

    def normals(self, x: Float) -> Float:
        """Return the normal of the segment."""
        _same(x, 2, "Segment")
        along = _point(self.end, 2, "Segment") - _point(self.start, 2, "Segment")
        return _repeated([-along[1], along[0]], x)


@dataclass(frozen=True)
class Polyline(Crack):
    """A crack in the plane through several points [length].

    Examples
    --------
    >>> import pdpetsc as pd
    >>> kinked = pd.Polyline([(0.0, 0.5), (0.3, 0.5), (0.5, 0.7)])
    """

    points: Sequence[Sequence[float]]

    @property
    def line(self) -> Sequence[Sequence[float]]:
        return self.points

    def box(self, dim: int) -> tuple[Float, Float]:
        """Return the box around the points."""
        return _box(self.points, dim, "Polyline")

    def cuts(self, a: Float, b: Float) -> Mask:
        """Return True for bonds that cross one of the segments."""
        return np.asarray(np.any([segment.cuts(a, b) for segment in self._segments], axis=0))

    def normals(self, x: Float) -> Float:
        """Return the normals of the nearest segments."""
        _same(x, 2, "Polyline")
        ends = [np.array([segment.start, segment.end], dtype=float) for segment in self._segments]
        nearest = np.argmin([_distance(x, *both) for both in ends], axis=0)
        normals = np.array([segment.normals(x[:1])[0] for segment in self._segments]) if len(x) else np.zeros((1, 2))
        return np.asarray(normals[nearest])

    @property
    def _segments(self) -> list[Segment]:
        if len(self.points) < 2:
            raise CaseError("A crack Polyline needs at least two points.")
        return [Segment(start, end) for start, end in zip(self.points[:-1], self.points[1:], strict=True)]


@dataclass(frozen=True)
class PlaneCrack(Crack):
    """A crack over a whole plane (a line in 2D, a point in 1D) through ``point`` with ``normal``.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> cut = pd.PlaneCrack(point=(0.5, 0.0, 0.0), normal=(1.0, 0.0, 0.0))
    """

    point: Sequence[float]
    normal: Sequence[float]

    def box(self, dim: int) -> tuple[Float, Float]:
        """Return a box without thickness if the normal is along an axis."""
        low, high = super().box(dim)
        axes = np.flatnonzero(_point(self.normal, dim, "crack"))
        if len(axes) == 1:
            low[axes] = high[axes] = _point(self.point, dim, "crack")[axes]
        return low, high

    def cuts(self, a: Float, b: Float) -> Mask:
        """Return True for bonds that cross the plane."""
        return _crossing(a, b, self.point, self.normal)[0]

    def normals(self, x: Float) -> Float:
        """Return the normal of the plane."""
        return _repeated(_point(self.normal, x.shape[1], "crack"), x)


@dataclass(frozen=True)
class Disc(Crack):
    """A penny-shaped crack with ``centre``, ``normal`` and ``radius`` [length], its edge included.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> penny = pd.Disc(centre=(0.0, 0.0, 0.0), normal=(0.0, 0.0, 1.0), radius=0.25)
    """

    centre: Sequence[float]
    normal: Sequence[float]
    radius: float

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.radius > 0.0:
            raise CaseError(f"A crack Disc needs a positive radius, not {self.radius}.")

    def box(self, dim: int) -> tuple[Float, Float]:
        """Return the box around the ball of its radius."""
        low, high = _box([self.centre], dim, "Disc")
        return low - self.radius, high + self.radius

    def cuts(self, a: Float, b: Float) -> Mask:
        """Return True for bonds that cross the disc."""
        _same(a, 3, "Disc")
        crossing, close, where = _crossing(a, b, self.centre, self.normal)
        inside = np.linalg.norm(where - np.asarray(self.centre, dtype=float), axis=1) <= self.radius + close
        return np.asarray(crossing & inside)

    def normals(self, x: Float) -> Float:
        """Return the normal of the disc."""
        _same(x, 3, "Disc")
        return _repeated(self.normal, x)


@dataclass(frozen=True)
class PolygonCrack(Crack):
    """A plane crack inside a closed polygon of at least three points in space [length], its edges included.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> triangle = pd.PolygonCrack([(0.0, 0.0, 0.5), (1.0, 0.0, 0.5), (0.0, 1.0, 0.5)])
    """

    points: Sequence[Sequence[float]]

    def box(self, dim: int) -> tuple[Float, Float]:
        """Return the box around the points."""
        return _box(self.points, dim, "PolygonCrack")

    def cuts(self, a: Float, b: Float) -> Mask:
        """Return True for bonds that cross the polygon."""
        _same(a, 3, "PolygonCrack")
        if len(self.points) < 3:
            raise CaseError("A PolygonCrack needs at least three points.")
        corners, normal = self._plane()
        edges = np.roll(corners, -1, axis=0) - corners
        longest = edges[np.argmax(np.linalg.norm(edges, axis=1))]
        size, length = float(np.linalg.norm(normal)), float(np.linalg.norm(longest))
        flat = np.abs((corners - corners[0]) @ normal)
        if size == 0.0 or flat.max() > 1e-6 * size * length:
            raise CaseError("The points of a PolygonCrack must lie in one plane, and not on one line.")
        crossing, close, where = _crossing(a, b, corners[0], normal)
        basis = np.array([longest / length, np.cross(normal / size, longest / length)])
        flat_corners, flat_where = (corners - corners[0]) @ basis.T, (where - corners[0]) @ basis.T
        return np.asarray(crossing & _inside(flat_corners, flat_where, close))

    def normals(self, x: Float) -> Float:
        """Return the normal of the polygon."""
        _same(x, 3, "PolygonCrack")
        return _repeated(self._plane()[1], x)

    def _plane(self) -> tuple[Float, Float]:
        """Return the corners (n, 3), and the normal of the largest triangle of the first and two successive ones."""
        corners = np.array([_point(point, 3, "PolygonCrack") for point in self.points])
        arms = corners[1:] - corners[0]
        normals = np.cross(arms[:-1], arms[1:])
        return corners, normals[np.argmax(np.linalg.norm(normals, axis=1))]


SHIPPED: dict[str, type[Crack]] = {kind.__name__: kind for kind in (Segment, Polyline, PlaneCrack, Disc, PolygonCrack)}


def recorded(crack: Crack, sign: Float, shift: Float) -> list[dict[str, Any]]:
    """Return records of the images of a crack for ``crack_of``; only the class name for a class of a user.

    The image of a point x is ``sign * x + shift``, with a row (dim,) of both arguments for each image.
    """
    name = type(crack).__name__
    if SHIPPED.get(name) is not type(crack):
        return [{"kind": name}]
    declared: dict[str, Any] = asdict(crack)  # type: ignore[call-overload]
    return [
        {"kind": name, **{key: _moved(key, value, flip, to) for key, value in declared.items()}}
        for flip, to in zip(sign, shift, strict=True)
    ]


def _moved(key: str, value: Any, sign: Float, shift: Float) -> Any:
    """Return a field of a shipped crack in the place of an image."""
    if key == "radius":
        return value
    return (sign * np.asarray(value, dtype=float) + (0.0 if key == "normal" else shift)).tolist()


def crack_of(record: Mapping[str, Any]) -> Crack | None:
    """Return the crack of a record; None for a class of a user."""
    given = {name: value for name, value in record.items() if name != "kind"}
    kind = SHIPPED.get(str(record.get("kind")))
    try:
        return kind(**given) if kind is not None and given else None
    except (TypeError, ValueError) as error:
        raise CaseError(f"A run has left a crack that cannot be read: {error}.") from None


def _crossing(
    a: Float, b: Float, point: Sequence[float] | Float, normal: Sequence[float] | Float
) -> tuple[Mask, Float, Float]:
    """Return which bonds cross a plane, tolerances, and the crossing points."""
    dim = a.shape[1]
    p, n = _point(point, dim, "crack"), _point(normal, dim, "crack")
    size = float(np.linalg.norm(n))
    if size == 0.0:
        raise CaseError("A crack needs a normal that is not zero.")
    side_a, side_b = (a - p) @ n / size, (b - p) @ n / size
    return _between_sides(a, b, side_a, side_b)


def _between_sides(a: Float, b: Float, side_a: Float, side_b: Float) -> tuple[Mask, Float, Float]:
    """Return which bonds cross a surface at distances ``side_a`` and ``side_b``, tolerances, and crossing points.

    Bonds along the surface cross it in their middle: the distances of their ends are rounding.
    """
    close = TOUCHING * np.linalg.norm(b - a, axis=1)
    crossing = ((side_a >= -close) & (side_b <= close)) | ((side_b >= -close) & (side_a <= close))
    through = np.maximum(np.abs(side_a), np.abs(side_b)) > close
    share = np.where(through, side_a / np.where(side_a != side_b, side_a - side_b, 1.0), 0.5)
    return crossing, close, a + np.clip(share, 0.0, 1.0)[:, None] * (b - a)


def _inside(corners: Float, where: Float, close: Float) -> Mask:
    """Return True for points of a plane (n, 2) inside a polygon, or as close to a side as ``close`` (n,).

    A point is inside if the number of sides to its right is odd.
    """
    inside, on_side = np.zeros(len(where), dtype=bool), np.zeros(len(where), dtype=bool)
    for p, q in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        spans = (p[1] > where[:, 1]) != (q[1] > where[:, 1])
        height = q[1] - p[1] if q[1] != p[1] else 1.0
        inside ^= spans & (where[:, 0] < p[0] + (where[:, 1] - p[1]) / height * (q[0] - p[0]))
        on_side |= _distance(where, p, q) <= close
    return np.asarray(inside | on_side)


def _distance(x: Float, p: Float, q: Float) -> Float:
    """Return the distance of points ``x`` (n, dim) from the straight line between two points (n,)."""
    along = q - p
    share = np.clip((x - p) @ along / max(float(along @ along), np.finfo(float).tiny), 0.0, 1.0)
    return np.asarray(np.linalg.norm(x - p - share[:, None] * along, axis=1))


def _repeated(normal: Sequence[float] | Float, x: Float) -> Float:
    """Return a normal of any length as unit vectors (n, dim) for points ``x`` (n, dim)."""
    n = np.asarray(normal, dtype=float)
    return np.tile(n / max(float(np.linalg.norm(n)), np.finfo(float).tiny), (len(x), 1))


def _cross(u: Float, v: Float) -> Float:
    return np.asarray(u[0] * v[:, 1] - u[1] * v[:, 0])


def _point(values: Sequence[float] | Float, dim: int, name: str) -> Float:
    point = np.asarray(values, dtype=float)
    if point.shape != (dim,) or not np.isfinite(point).all():
        raise CaseError(f"A {name} of a {dim}-dimensional body needs points of {dim} numbers, not {values}.")
    return point


def _box(points: Sequence[Sequence[float]], dim: int, name: str) -> tuple[Float, Float]:
    """Return the corners of the box around points."""
    x = np.array([_point(point, dim, name) for point in points]).reshape(-1, dim)
    return x.min(axis=0, initial=np.inf), x.max(axis=0, initial=-np.inf)


def _same(a: Float, dim: int, name: str) -> None:
    if a.shape[1] != dim:
        raise CaseError(
            f"A {name} requires a body in {dim}D, and this body is in {a.shape[1]}D. Use Segment or Polyline in 2D, "
            "PlaneCrack, Disc or PolygonCrack in 3D."
        )
