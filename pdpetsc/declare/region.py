"""Regions: sets of particles for conditions, materials and quantities. Combine with ``|``, ``&`` and ``~``."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

import numpy as np

from pdpetsc.arrays import Float, Mask
from pdpetsc.declared import Declared, called
from pdpetsc.errors import CaseError

# The sides of a box; a body of d dimensions has the first 2 d.
Side: TypeAlias = Literal["-x", "+x", "-y", "+y", "-z", "+z"]
SIDES: tuple[Side, ...] = get_args(Side)

# Particles whose distance exceeds the smallest one by less than this share of it are equally near.
EQUALLY_NEAR = 1e-6
# Particles this near to the outermost side are on it, as a share of the extent of the body.
ON_FACE = 1e-9
# Cosine of the largest angle between the normals of an uneven side and its axis.
NEARLY = 0.866


@dataclass(frozen=True)
class View:
    """The particles from which a region selects.

    Attributes
    ----------
    x : (n, dim) float64
        Reference positions [length].
    sets : mapping of str to (n,) bool
        Named sets.
    minimum : callable
        Smallest value of a number over all parts of the cloud.
    normal : (n, dim) float64 or None
        Outward normals of any length, if a region selects facets.
    uneven : float
        Depth of one side of an uneven surface [length]; its normals are then within 30 degrees of the axis.
    """

    x: Float
    sets: Mapping[str, Mask]
    minimum: Callable[[float], float]
    normal: Float | None = None
    uneven: float = 0.0


class Region(Declared, ABC):
    """A set of particles chosen by position or name."""

    @abstractmethod
    def mask(self, view: View) -> Mask:
        """Return True for particles in the region, (n,) bool (collective for ``Nearest``)."""

    def check(self, dim: int) -> None:
        """Raise CaseError if the region does not fit a body of ``dim`` dimensions."""

    def __or__(self, other: Region) -> Region:
        return _Union(self, other)

    def __and__(self, other: Region) -> Region:
        return _Intersection(self, other)

    def __invert__(self) -> Region:
        return _Complement(self)


@dataclass(frozen=True)
class _Pair(Region, ABC):
    one: Region
    other: Region

    def check(self, dim: int) -> None:
        self.one.check(dim)
        self.other.check(dim)


@dataclass(frozen=True)
class _Union(_Pair):
    def mask(self, view: View) -> Mask:
        return self.one.mask(view) | self.other.mask(view)


@dataclass(frozen=True)
class _Intersection(_Pair):
    def mask(self, view: View) -> Mask:
        return self.one.mask(view) & self.other.mask(view)


@dataclass(frozen=True)
class _Complement(Region):
    of: Region

    def mask(self, view: View) -> Mask:
        return ~self.of.mask(view)

    def check(self, dim: int) -> None:
        self.of.check(dim)


@dataclass(frozen=True)
class All(Region):
    """Every particle.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> everything = pd.region.All()
    """

    def mask(self, view: View) -> Mask:
        return np.ones(len(view.x), dtype=bool)


@dataclass(frozen=True)
class Box(Region):
    """Particles with ``low <= x <= high`` in every coordinate [length].

    Examples
    --------
    >>> import pdpetsc as pd
    >>> plate = pd.region.Box((0.0, 0.0), (10.0, 4.0))
    """

    low: float | Sequence[float]
    high: float | Sequence[float]

    def mask(self, view: View) -> Mask:
        """Return True for particles in the box."""
        low, high = self._corners(view.x.shape[1])
        return np.asarray(np.all((view.x >= low) & (view.x <= high), axis=1))

    def check(self, dim: int) -> None:
        """Raise CaseError if the corners do not have ``dim`` coordinates."""
        self._corners(dim)

    def _corners(self, dim: int) -> tuple[Float, Float]:
        return _vector(self.low, dim, "low corner of Box"), _vector(self.high, dim, "high corner of Box")


@dataclass(frozen=True)
class Slab(Region):
    """Particles with ``low <= x <= high`` along one axis [length].

    Examples
    --------
    >>> import pdpetsc as pd
    >>> left, low = pd.region.Slab("x", high=1.0), pd.region.Slab("y", high=1.0)
    >>> corner, neither = left & low, ~(left | low)
    """

    axis: Literal["x", "y", "z"]
    low: float = -np.inf
    high: float = np.inf

    def mask(self, view: View) -> Mask:
        """Return True for particles in the slab."""
        self.check(view.x.shape[1])
        s = view.x[:, "xyz".index(self.axis)]
        return np.asarray((s >= self.low) & (s <= self.high))

    def check(self, dim: int) -> None:
        """Raise CaseError if the body has no such axis."""
        if self.axis not in "xyz"[:dim]:
            raise CaseError(f"Slab axis {self.axis!r} is not one of {list('xyz'[:dim])}.")


@dataclass(frozen=True)
class Sphere(Region):
    """Particles within ``radius`` of ``centre`` [length]; a disc in two dimensions.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> hole = pd.region.Sphere((5.0, 2.0), radius=1.0)
    """

    centre: float | Sequence[float]
    radius: float

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.radius < 0.0:
            raise CaseError(f"A Sphere needs a radius that is not negative, not {self.radius}.")

    def mask(self, view: View) -> Mask:
        """Return True for particles in the sphere."""
        distance = np.linalg.norm(view.x - _vector(self.centre, view.x.shape[1], "centre of Sphere"), axis=1)
        return np.asarray(distance <= self.radius)

    def check(self, dim: int) -> None:
        """Raise CaseError if the centre does not have ``dim`` coordinates."""
        _vector(self.centre, dim, "centre of Sphere")


@dataclass(frozen=True)
class Nearest(Region):
    """The particle nearest to ``point`` [length], or all that are equally near.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> tip = pd.region.Nearest((10.0, 2.0))
    """

    point: float | Sequence[float]

    def mask(self, view: View) -> Mask:
        """Return True for the nearest particles (collective)."""
        distance = np.linalg.norm(view.x - _vector(self.point, view.x.shape[1], "point of Nearest"), axis=1)
        least = view.minimum(float(distance.min(initial=np.inf)))
        return np.asarray(distance <= least * (1.0 + EQUALLY_NEAR) + 1e-300)

    def check(self, dim: int) -> None:
        """Raise CaseError if the point does not have ``dim`` coordinates."""
        _vector(self.point, dim, "point of Nearest")


@dataclass(frozen=True)
class Where(Region):
    """Particles for which ``predicate(x)`` is true; ``x`` are positions (n, dim), the result is (n,) bool.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> above = pd.region.Where(lambda x: x[:, 1] > 0.5 * x[:, 0])
    """

    predicate: Callable[[Float], Mask]

    def mask(self, view: View) -> Mask:
        """Return the values of the predicate."""
        if len(view.x) == 0:
            return np.zeros(0, dtype=bool)
        answer = np.asarray(called("predicate of Where", self.predicate, view.x))
        if answer.shape != (len(view.x),) or answer.dtype != bool:
            raise CaseError(
                f"The predicate of Where must return {(len(view.x),)} bool, not {answer.shape} {answer.dtype}."
            )
        return answer


@dataclass(frozen=True)
class Face(Region):
    """The outermost side of a body along an axis: its particles, or the facets of its surface.

    Conditions and quantities accept the name of the side instead. The outermost particles of a ``Lattice`` are half a
    cell behind the side; those of ``LatticeNodes`` are on it. A side of a ``Lattice`` with layers of fictitious
    particles, such as those that ``Clamp`` adds, consists of these.

    Parameters
    ----------
    side : {"-x", "+x", "-y", "+y", "-z", "+z"}
        The side.
    of : str
        Name of the body in ``Bodies``, or of the set, whose side it is; by default the side of all particles. The name
        ``"lower +y"`` is that of the side ``"+y"`` of ``lower``.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> pulled = pd.Traction("+x", x=5.0)
    >>> pulled.region
    Face(side='+x', of='')
    """

    side: Side
    of: str = ""

    @property
    def axis(self) -> int:
        """Return the number of its axis."""
        return "xyz".index(self.side[1])

    def mask(self, view: View) -> Mask:
        """Return True for the outermost particles, or the outermost facets normal to the axis (collective)."""
        whole = f"{self.of} {self.side}"
        if self.of and whole in view.sets:  # a set may have such a name
            return view.sets[whole]
        among = Named(self.of).mask(view) if self.of else np.ones(len(view.x), dtype=bool)
        sign = 1.0 if self.side[0] == "+" else -1.0
        along = sign * view.x[:, self.axis]
        furthest = -view.minimum(float((-along[among]).min(initial=np.inf)))
        nearest = view.minimum(float(along[among].min(initial=np.inf)))
        layers = view.sets.get(f"fictitious {self.side}")
        # Every rank takes the same minima, also one that owns no particle of the layers.
        if layers is not None and view.normal is None and view.minimum(-float((layers & among).any())) < 0.0:
            return np.asarray(layers & among)
        found = np.asarray(among & (along >= furthest - max(view.uneven, ON_FACE * (furthest - nearest))))
        if view.normal is not None:
            least = NEARLY if view.uneven else 1.0 - ON_FACE
            found &= sign * view.normal[:, self.axis] >= least * np.linalg.norm(view.normal, axis=1)
        return found

    def check(self, dim: int) -> None:
        """Raise CaseError if the body has no such axis."""
        if self.axis >= dim:
            raise CaseError(f"A body of {dim} dimensions has no side {self.side!r}.")


def accept_region_name(declared: object) -> None:
    """Replace the name of a side or set in the field ``region`` of a declaration by the region."""
    name = getattr(declared, "region", None)
    if isinstance(name, str):
        object.__setattr__(declared, "region", region_of_name(name))


def region_of_name(name: str) -> Region:
    """Return the side of this name, the side of a body, or the set."""
    of, _, side = name.rpartition(" ")
    # The layers of a lattice are sets, "fictitious -x".
    if side not in SIDES or of == "fictitious":
        return Named(name)
    return Face(side, of)


@dataclass(frozen=True)
class Named(Region):
    """A named set: a mesh group, a node set file, ``real`` or ``fictitious`` of a lattice.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> real = pd.region.Named("real")
    """

    name: str

    def mask(self, view: View) -> Mask:
        if self.name not in view.sets:
            side = region_of_name(self.name)
            if isinstance(side, Face) and (not side.of or side.of in view.sets):
                of = f", {side.of!r}" if side.of else ""
                raise CaseError(
                    f"There is no set {self.name!r}, which is the name of a side. Write {self.name!r} or "
                    f"pd.region.Face({side.side!r}{of}) instead of pd.region.Named({self.name!r})."
                )
            sides = ", ".join(repr(side) for side in SIDES[: 2 * view.x.shape[1]])
            raise CaseError(
                f"There is no set {self.name!r}; the particles have {sorted(view.sets) or 'no sets'}, and the sides "
                f"{sides}."
            )
        return view.sets[self.name]


def _vector(values: float | Sequence[float], dim: int, what: str) -> Float:
    vector = np.atleast_1d(np.asarray(values, dtype=float))
    if vector.shape != (dim,):
        raise CaseError(f"The {what} needs {dim} coordinates, not {list(np.ravel(vector))}.")
    return np.asarray(vector)
