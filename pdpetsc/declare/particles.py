"""Sources of particles: base class, lattices and arrays."""

from __future__ import annotations

import itertools
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pdpetsc.arrays import Float, GlobalIndex, Mask
from pdpetsc.declare.cell import corners
from pdpetsc.declare.cracks import Crack
from pdpetsc.declare.region import SIDES, Region, View
from pdpetsc.declare.surface import Facets
from pdpetsc.declare.tiling import Cells, boxes, lattice, spacings, voronoi
from pdpetsc.declared import Declared, Positive, real_numbers, shown
from pdpetsc.errors import CaseError, UnknownSurface

# Relative tolerance of a side that must be a whole number of cells [-].
WHOLE_CELLS = 1e-6
# Relative tolerance of positions and volumes of a lattice [-].
ALONG = 1e-6
# Projected areas of a facet below this fraction of its area are zero [-].
ACROSS = 1e-12


@dataclass(frozen=True)
class Chunk:
    """A contiguous part of the particles: positions, volumes and named sets.

    ``spacing`` (n,) is the local spacing [length], if it does not follow from the volumes. ``body`` (n,) is the number
    of the body of each particle, if there are several: particles of different bodies have no bonds.
    """

    x: Float
    volume: Float
    sets: Mapping[str, Mask]
    spacing: Float | None = None
    body: GlobalIndex | None = None


def ends_of_part(part: int, parts: int, count: int) -> tuple[int, int]:
    """Return the first row of the ``part``-th of ``parts`` contiguous parts of ``count`` rows, and that after it."""
    return part * count // parts, (part + 1) * count // parts


class Particles(Declared, ABC):
    """A cloud of particles that can be created in parts."""

    thickness: float

    @property
    def irregular(self) -> bool:
        """Return True if the particles are known to be irregular, so that standard weights do not converge.

        Raises
        ------
        CaseError
            The source is missing or malformed.
        """
        return False

    @property
    def fills_boxes(self) -> bool:
        """Return True if particles are known to be centres of equal boxes, so that positions determine the surface."""
        return False

    @property
    def bodies(self) -> tuple[Particles, ...]:
        """Return the particles of each body, in the order of creation."""
        return (self,)

    @property
    def on_surface(self) -> bool:
        """Return True if outer particles are known to be on the surface itself, as nodes are."""
        return False

    def surface(self, part: int, parts: int, cracks: Sequence[Crack] = ()) -> Facets:
        """Return the free facets of the cells of a part, with particles counted from the first one of the part.

        Parameters
        ----------
        part, parts : int
            As for ``chunk``.
        cracks : sequence of Crack
            Faces between two cells are facets of both if a crack separates the centres of the cells.

        Raises
        ------
        CaseError
            The faces of the cells are unknown.
        """
        raise UnknownSurface(
            f"{type(self).__name__} has no known surface, as conforming weights and surface loads need. Use a Lattice "
            "or a Mesh, give facets=pd.Facets(...), or use weights=pd.Standard() and give each Traction a normal and "
            "an area. The outer layer of the particles is a surface for pd.Contact with rigid tools only."
        )

    def stairs(self, part: int, parts: int) -> int:
        """Return the number of facets of a part that are steps of a staircase: one cell high, between two corners.

        0 if the particles do not form a lattice. Surfaces along the planes of the lattice have none.
        """
        return 0

    def triangles(self, part: int, parts: int) -> Float | None:
        """Return the surface of a solid body as triangles (n, 3, 3) [length], outward by the right hand.

        The triangles of all parts form a closed surface. None if the outlines of the facets are unknown.
        """
        return None

    def cells(self) -> Cells:
        """Return the cells of all particles, for pictures; by default those of ``cells_of``.

        Raises
        ------
        CaseError
            The source is missing or malformed.
        """
        whole = self.chunk(0, 1)
        return cells_of(whole.x, whole.volume, self.thickness)

    @abstractmethod
    def chunk(self, part: int, parts: int) -> Chunk:
        """Return the ``part``-th of ``parts`` contiguous parts in the order of creation.

        Raises
        ------
        CaseError
            The source is missing or malformed.
        """

    def estimate(self) -> int:
        """Return an upper bound of the number of particles without creating them; 0 if it is unknown."""
        return 0

    def faces(self, part: int, parts: int, normal: Float) -> Float:
        """Return the area of the free faces of each particle of the part, projected along an outward unit normal.

        The sum over the free facets f of ``max(0, a_f . n)`` with their outward vector areas ``a_f``.

        Parameters
        ----------
        part, parts : int
            As for ``chunk``.
        normal : (dim,) float64
            Outward unit normal.

        Returns
        -------
        (n,) float64
            [area; length times thickness in the plane; the cross-section on a line].

        Raises
        ------
        CaseError
            The free faces of the cells are unknown.
        """
        _, area, particle, _ = self.surface(part, parts).arrays
        along = area @ np.asarray(normal, dtype=float)
        along[along <= ACROSS * np.linalg.norm(area, axis=1)] = 0.0
        return np.bincount(particle, along, len(self.chunk(part, parts).x)).astype(float)


@dataclass(frozen=True)
class Lattice(Particles):
    """A line, rectangle or box filled with equal cells, one particle in the middle of each.

    Parameters
    ----------
    low, high : float or sequence of float
        Corners of the real body [length]; their number of coordinates is the dimension.
    spacing : float
        Cell size [length]; every side must be a whole number of cells.
    thickness : float
        Out-of-plane thickness of a plane body [length], or cross-section of a bar [length^2].
    cut : Region, optional
        Particles to leave out.
    keep : Region, optional
        Particles to keep; all others are left out.
    fictitious : mapping of {"-x", "+x", "-y", "+y", "-z", "+z"} to float
        Depth [length] of a layer of further particles beyond a side, as many as fit. They form the sets
        ``fictitious`` and ``fictitious -x`` (and so on); the others form the set ``real``.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> hole = pd.region.Sphere((50.0, 10.0), radius=4.0)
    >>> plate = pd.Lattice(low=(0.0, 0.0), high=(100.0, 20.0), spacing=2.0, cut=hole)
    >>> plate.estimate()  # the cells of the hole among them
    500
    """

    low: float | Sequence[float]
    high: float | Sequence[float]
    spacing: Positive
    thickness: Positive = 1.0
    cut: Region | None = None
    keep: Region | None = None
    fictitious: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        super().__post_init__()
        low, high = self.box
        for axis, cells in zip("xyz", (high - low) / self.spacing, strict=False):
            if cells < 0.0:
                raise CaseError(f"Corner low of the Lattice is above high along {axis}. Exchange low and high there.")
            if not (math.isfinite(cells) and cells > 0.5 and abs(cells - round(cells)) < WHOLE_CELLS * max(cells, 1.0)):
                raise CaseError(
                    f"Side {axis} of the Lattice is {cells:.6g} cells of {self.spacing:g}, not a whole number. Choose "
                    "a spacing that divides every side."
                )
        sides = list(SIDES[: 2 * len(low)])
        for side, depth in self.fictitious.items():
            if side not in sides:
                raise CaseError(f"A Lattice of {len(low)} dimensions has the sides {sides}, not {side!r}.")
            if not (math.isfinite(depth) and depth >= self.spacing * (1.0 - WHOLE_CELLS)):
                raise CaseError(
                    f"The fictitious layer {side} is {depth:g} deep, less than one spacing of {self.spacing:g}. Use at "
                    "least one spacing."
                )

    @property
    def dim(self) -> int:
        """Return the number of coordinates."""
        return len(self.box[0])

    @property
    def box(self) -> tuple[Float, Float]:
        """Return the corners of the real body (dim,) [length]."""
        return corners("Lattice", self.low, self.high)

    fills_boxes = True

    def estimate(self) -> int:
        """Return the number of cells, including those that are cut out."""
        low, high = self.box
        real = ((high - low) / self.spacing).tolist()
        return math.prod(round(n) + before + after for n, before, after in zip(real, *self._layers, strict=True))

    def chunk(self, part: int, parts: int) -> Chunk:
        """Return the ``part``-th of ``parts`` contiguous parts in lattice order, the last axis fastest."""
        low, high = self.box
        real = np.round((high - low) / self.spacing).astype(np.int64)
        before, after = np.array(self._layers)
        counts = real + before + after
        total = int(np.prod(counts))
        index = np.arange(*ends_of_part(part, parts, total))
        cell = np.stack(np.unravel_index(index, counts), axis=1) - before
        x = low + (cell + 0.5) * self.spacing
        sets = self._sets(x, np.all((cell >= 0) & (cell < real), axis=1))
        filled = self._filled(x, sets)
        volume = np.full(len(x), self.spacing**self.dim * (self.thickness if self.dim < 3 else 1.0))
        spacing = np.full(np.count_nonzero(filled), float(self.spacing))
        return Chunk(x[filled], volume[filled], {name: flags[filled] for name, flags in sets.items()}, spacing)

    def cells(self) -> Cells:
        """Return the cells of the lattice."""
        return lattice(self.chunk(0, 1).x, np.full(self.dim, self.spacing))

    def surface(self, part: int = 0, parts: int = 1, cracks: Sequence[Crack] = ()) -> Facets:
        """Return the faces of the cells of a part without a neighbour, or with a crack in front of it.

        They have the tags ``-x``, ``+x`` and so on by the direction of their outward normal. A curved or inclined
        boundary is a staircase of such faces.
        """
        x = self.chunk(part, parts).x
        return _lattice_facets(x, np.full(self.dim, self.spacing), self.thickness, self._has, cracks)

    def stairs(self, part: int, parts: int) -> int:
        """Return the number of facets of a part that are steps of a staircase."""
        if self.cut is None and self.keep is None:
            return 0
        return _stairs(self.chunk(part, parts).x, np.full(self.dim, self.spacing), self._has)

    def _has(self, x: Float) -> Mask:
        """Return flags of the positions (n, dim) that are centres of cells with a particle."""
        low, high = self.box
        before, after = np.array(self._layers)
        inside = np.all((x > low - before * self.spacing) & (x < high + after * self.spacing), axis=1)
        real = np.all((x > low) & (x < high), axis=1)
        inside[inside] = self._filled(x[inside], self._sets(x[inside], real[inside]))
        return np.asarray(inside)

    def _filled(self, x: Float, sets: Mapping[str, Mask]) -> Mask:
        """Return flags of the cells that have a particle."""
        view = View(x, sets, minimum=_refuse_nearest)
        filled = np.ones(len(x), dtype=bool)
        if self.keep is not None:
            filled &= self.keep.mask(view)
        if self.cut is not None:
            filled &= ~self.cut.mask(view)
        return filled

    def _sets(self, x: Float, real: Mask) -> dict[str, Mask]:
        """Return the named sets of cells at ``x``, from the flags ``real`` of cells in the real body."""
        sets = {"real": real, "fictitious": ~real}
        low, high = self.box
        for side in self.fictitious:
            axis = "xyz".index(side[1])
            sets[f"fictitious {side}"] = x[:, axis] < low[axis] if side[0] == "-" else x[:, axis] > high[axis]
        return sets

    @property
    def _layers(self) -> list[list[int]]:
        """Return the numbers of fictitious layers below the low side of each axis, and above the high side."""
        depths = [[self.fictitious.get(sign + axis, 0.0) for axis in "xyz"[: self.dim]] for sign in "-+"]
        return [[int(depth / self.spacing * (1.0 + WHOLE_CELLS)) for depth in row] for row in depths]


@dataclass(frozen=True)
class LatticeNodes(Particles):
    """A line, rectangle or box with particles at the corners of equal cells; some particles are on the boundary.

    Every cell adds the fraction ``1 / 2^dim`` of its volume to each of its corners: a particle on a side has half a
    cell, one on an edge a quarter. Prescribed displacements then act on the boundary, whereas the outermost particles
    of a ``Lattice`` are half a cell inside. The surface of the cells is divided among the corners in the same way.

    Parameters
    ----------
    low, high, spacing, thickness
        As for ``Lattice``.
    cut : Region, optional
        Cells to leave out, by their centres.
    keep : Region, optional
        Cells to keep; all others are left out.

    Examples
    --------
    A beam that is held at its end, not half a cell inside:

    >>> import pdpetsc as pd
    >>> beam = pd.LatticeNodes((0.0, 0.0), (10.0, 2.0), 0.5)
    >>> beam.estimate()
    105
    >>> clamped = pd.Displacement(pd.region.Slab("x", high=1e-6), x=0.0, y=0.0)
    """

    low: float | Sequence[float]
    high: float | Sequence[float]
    spacing: Positive
    thickness: Positive = 1.0
    cut: Region | None = None
    keep: Region | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        self._cells  # noqa: B018 - refuses what is no lattice

    @property
    def box(self) -> tuple[Float, Float]:
        """Return the corners of the body (dim,) [length]."""
        return self._cells.box

    on_surface = True

    def estimate(self) -> int:
        """Return the number of corners, including those of cells that are cut out."""
        return math.prod(self._counts)

    def chunk(self, part: int, parts: int) -> Chunk:
        """Return the ``part``-th of ``parts`` contiguous parts in lattice order, the last axis fastest."""
        x, _, filled = self._corners(part, parts)
        cells = self._cells
        cell = self.spacing**cells.dim * (self.thickness if cells.dim < 3 else 1.0)
        return Chunk(x, filled.mean(axis=1) * cell, {}, np.full(len(x), float(self.spacing)))

    def cells(self) -> Cells:
        """Return the cells that have particles at their corners."""
        return replace(self._cells.cells(), particle=None)

    def surface(self, part: int = 0, parts: int = 1, cracks: Sequence[Crack] = ()) -> Facets:
        """Return the parts of the free faces of cells that belong to particles of a part; tags are ``-x``, ``+x``, ...

        Raises
        ------
        CaseError
            There are cracks, which cut bonds between corners, but separate no faces of cells.
        """
        if cracks:
            raise CaseError(
                "cracks= needs pd.Lattice: pd.LatticeNodes has no faces of cracks, which loads without a normal and "
                "conforming weights need."
            )
        x, offsets, filled = self._corners(part, parts)
        dim = x.shape[1]
        side = float(_cell_sides(np.full(dim, self.spacing), self.thickness)[0]) / 2.0 ** (dim - 1)
        places, areas, particles, sides = [np.empty((0, dim))], [np.empty((0, dim))], [np.empty(0, np.int64)], []
        for number, offset in enumerate(offsets):
            for axis in range(dim):
                across = np.flatnonzero((offsets == np.where(np.arange(dim) == axis, -offset, offset)).all(axis=1))[0]
                found = np.flatnonzero(filled[:, number] & ~filled[:, across])
                # The centre of the part of the face that belongs to the corner.
                places.append(x[found] + 0.25 * self.spacing * np.where(np.arange(dim) == axis, 0.0, offset))
                areas.append(np.tile(-side * offset[axis] * np.eye(dim)[axis], (len(found), 1)))
                particles.append(found)
                sides += [f"{'-' if offset[axis] > 0.0 else '+'}{'xyz'[axis]}"] * len(found)
        return _joined_facets(places, areas, particles, sides, np.full(dim, 0.5 * self.spacing))

    def stairs(self, part: int, parts: int) -> int:
        """Return the number of facets of the cells of a part that are steps of a staircase."""
        return self._cells.stairs(part, parts)

    def triangles(self, part: int, parts: int) -> Float | None:
        """Return the free faces of the cells, each as two triangles."""
        if self._cells.dim < 3:
            return None
        a, b, c, d = np.moveaxis(np.asarray(self._cells.surface(part, parts).corners), 1, 0)
        return np.asarray(np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)]))

    @property
    def _cells(self) -> Lattice:
        return Lattice(self.low, self.high, self.spacing, self.thickness, cut=self.cut, keep=self.keep)

    @property
    def _counts(self) -> list[int]:
        low, high = self._cells.box
        return [round(n) + 1 for n in ((high - low) / self.spacing).tolist()]

    def _corners(self, part: int, parts: int) -> tuple[Float, Float, Mask]:
        """Return the corners of a part (n, dim), the directions of the cells around a corner (2^dim, dim), and flags.

        The flags (n, 2^dim) mark the cells around each corner that exist.
        """
        cells, counts = self._cells, self._counts
        total = math.prod(counts)
        index = np.arange(*ends_of_part(part, parts, total))
        low, _ = cells.box
        node = np.stack(np.unravel_index(index, counts), axis=1)
        offsets = np.array(list(itertools.product((-1.0, 1.0), repeat=cells.dim)))
        # A cell at the edge of a region has the same centre from each of its corners, so that they agree on it.
        filled = np.stack([cells._has(low + (node + 0.5 * offset) * self.spacing) for offset in offsets], axis=1)
        taken = filled.any(axis=1)
        return (low + node * self.spacing)[taken], offsets, filled[taken]


@dataclass(frozen=True)
class Arrays(Particles):
    """Particles from numpy arrays.

    Parameters
    ----------
    x : (n, dim) array_like
        Positions [length].
    volume : (n,) array_like or float
        Volumes [length^dim times thickness].
    sets : mapping of str to (n,) bool or index arrays
        Named sets.
    thickness : float
        Out-of-plane thickness [length] already contained in the volumes.
    facets : Facets, optional
        The surface of the cells of the particles, if they do not form a lattice.

    Examples
    --------
    >>> import numpy as np
    >>> import pdpetsc as pd
    >>> x = np.array([[0.5], [1.5], [2.5]])
    >>> bar = pd.Arrays(x, volume=1.0, sets={"held": [0]})
    """

    x: ArrayLike
    volume: ArrayLike
    sets: Mapping[str, ArrayLike] = field(default_factory=dict)
    thickness: Positive = 1.0
    facets: Facets | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        x, volume = _numbers("positions", self.x), _numbers("volumes", self.volume)
        if x.ndim != 2 or not 1 <= x.shape[1] <= 3 or len(x) == 0:
            raise CaseError(f"Particle positions must be (n, 1), (n, 2) or (n, 3), not {x.shape}.")
        if volume.shape not in ((), (len(x),)):
            raise CaseError(f"Particle volumes must be one number or ({len(x)},), not {np.shape(self.volume)}.")
        for name, members in self.sets.items():
            _refuse_members(name, members, len(x))
        if self.facets is not None:
            places, _, particle, _ = self.facets.arrays
            if places.shape[1] != x.shape[1] or particle.max(initial=0) >= len(x):
                raise CaseError(
                    f"The facets of Arrays have {places.shape[1]} coordinates and particles up to "
                    f"{particle.max(initial=0)}; there are {len(x)} particles of {x.shape[1]} coordinates."
                )

    @property
    def irregular(self) -> bool:
        """Return True unless the particles fill the cells of a lattice."""
        return self._lattice() is None

    def cells(self) -> Cells:
        """Return cells that end at the declared facets, or those of ``cells_of``."""
        x = np.asarray(self.x, dtype=float)
        if self.facets is not None and x.shape[1] == 2 and self.irregular:
            return voronoi(x, self.facets.arrays[:3])
        return super().cells()

    def surface(self, part: int = 0, parts: int = 1, cracks: Sequence[Crack] = ()) -> Facets:
        """Return the declared facets, or those of the lattice that the particles form.

        Raises
        ------
        CaseError
            No facets are declared and the particles form no lattice, or cracks cut cells whose faces are unknown.
        """
        x = np.asarray(self.x, dtype=float)
        first, last = ends_of_part(part, parts, len(x))
        if self.facets is not None:
            if cracks:
                raise CaseError(
                    "Arrays with facets cannot have cracks, because the faces between its cells are unknown. Use a "
                    "Lattice or a Mesh."
                )
            return self.facets.of_particles(first, last)
        lattice = self._lattice()
        if lattice is None:
            return super().surface(part, parts, cracks)
        sizes, has = lattice
        return _lattice_facets(x[first:last], sizes, self.thickness, has, cracks)

    def stairs(self, part: int, parts: int) -> int:
        """Return the number of facets of a part that are steps of a staircase; 0 for irregular particles."""
        x = np.asarray(self.x, dtype=float)
        lattice = self._lattice()
        return 0 if lattice is None else _stairs(x[slice(*ends_of_part(part, parts, len(x)))], *lattice)

    def _lattice(self) -> tuple[Float, Callable[[Float], Mask]] | None:
        """Return the sizes of the cells (dim,) [length], and a function that flags positions (n, dim) of centres.

        None if the positions or the volumes are not those of equal cells.
        """
        x = np.asarray(self.x, dtype=float)
        found = lattice_cells(x, np.broadcast_to(np.asarray(self.volume, dtype=float), len(x)), self.thickness)
        if found is None:
            return None
        cell, sizes = found
        low, counts = x.min(axis=0), cell.max(axis=0) + 1
        taken = numbers_in(counts, cell)

        def has(places: Float) -> Mask:
            return np.isin(numbers_in(counts, np.round((places - low) / sizes).astype(np.int64)), taken)

        return sizes, has

    def chunk(self, part: int, parts: int) -> Chunk:
        """Return rows ``part`` of ``parts`` of the arrays."""
        x = np.asarray(self.x, dtype=float)
        rows = slice(*ends_of_part(part, parts, len(x)))
        sets = {}
        for name, members in self.sets.items():
            flags = np.zeros(len(x), dtype=bool)
            found = np.asarray(members)
            flags[found if found.dtype == bool else found.astype(np.int64)] = True
            sets[name] = flags[rows]
        volume = np.broadcast_to(np.asarray(self.volume, dtype=float), len(x))
        return Chunk(x[rows], np.array(volume[rows]), sets)


def _numbers(what: str, values: ArrayLike) -> Float:
    """Return declared values as an array of numbers."""
    found = real_numbers(values)
    if found is None:
        raise CaseError(f"The {what} of Arrays are an array of numbers, not {shown(values)}.")
    return found


def _refuse_members(name: str, members: ArrayLike, n: int) -> None:
    """Raise CaseError unless the members of a set are flags of n particles, or their indices."""
    found = np.asarray(members)
    if found.dtype == bool and found.shape == (n,):
        return
    whole = np.issubdtype(found.dtype, np.integer) or found.size == 0
    if found.dtype == bool or found.ndim != 1 or not whole:
        raise CaseError(f"Set {name!r} of Arrays is ({n},) bool or a list of indices, not {shown(members)}.")
    if found.size and not (found.min() >= 0 and found.max() < n):
        raise CaseError(f"Set {name!r} of Arrays has indices from {found.min()} to {found.max()} of {n} particles.")


def _lattice_facets(
    x: Float, sizes: Float, thickness: float, has: Callable[[Float], Mask], cracks: Sequence[Crack]
) -> Facets:
    """Return the free faces of box cells of equal sizes (dim,) with centres ``x``, and those that cracks separate."""
    dim = x.shape[1]
    side = _cell_sides(sizes, thickness)
    places, areas, particles, directions = [np.empty((0, dim))], [np.empty((0, dim))], [np.empty(0, np.int64)], []
    for axis in range(dim):
        for sign in (-1.0, 1.0):
            step = sign * np.eye(dim)[axis]
            beyond = x + sizes * step
            free = ~has(beyond)
            for crack in cracks:
                free |= crack.cuts(x, beyond)
            found = np.flatnonzero(free)
            places.append(x[found] + 0.5 * sizes * step)
            areas.append(np.tile(side[axis] * step, (len(found), 1)))
            particles.append(found)
            directions += [f"{'-' if sign < 0.0 else '+'}{'xyz'[axis]}"] * len(found)
    return _joined_facets(places, areas, particles, directions, sizes)


def _joined_facets(
    places: Sequence[Float], areas: Sequence[Float], particles: Sequence[GlobalIndex], directions: Sequence[str],
    sizes: Float,
) -> Facets:  # fmt: skip
    """Return the faces of boxes of some sizes (dim,), each with its direction, such as ``-x``, as a tag."""
    named = np.array(directions, dtype="U2")
    tags = {f"{sign}{axis}": named == f"{sign}{axis}" for axis in "xyz"[: len(sizes)] for sign in "-+"}
    x, area = np.concatenate(places), np.concatenate(areas)
    return Facets(x, area, np.concatenate(particles), tags, box_corners(x, area, sizes))


def box_corners(x: Float, area: Float, sizes: Float) -> Float | None:
    """Return the corners (n, 4, 3) of faces of boxes of some sizes (3,) at ``x``; None for plane bodies."""
    if x.shape[1] < 3:
        return None
    axis = np.argmax(np.abs(area), axis=1)
    one, other = (0.5 * (sizes * np.eye(3))[(axis + n) % 3] for n in (1, 2))
    other = other * np.sign(area[np.arange(len(x)), axis])[:, None]
    return np.asarray(np.stack([x - one - other, x + one - other, x + one + other, x - one + other], axis=1))


def _stairs(x: Float, sizes: Float, has: Callable[[Float], Mask]) -> int:
    """Return the number of free faces of box cells with centres ``x`` that are steps of a staircase, one cell high.

    Across such a face the surface turns outward on one side and inward on the other: along some axis the next cell on
    one side is missing too, and on the other side there are that cell and the one before it.
    """
    count = 0
    axes = sizes * np.eye(len(sizes))
    directions = np.concatenate([axes, -axes])
    for out in directions:
        faces = x[~has(x + out)]
        for along in directions[directions @ out == 0.0]:
            turned = faces[~has(faces + along)]
            turned = turned[has(turned - along)]
            count += int(np.count_nonzero(has(turned - along + out)))
    return count


def _cell_sides(sizes: Float, thickness: float) -> Float:
    """Return the areas of the sides of a box cell across each axis (dim,) [area]."""
    whole = float(np.prod(sizes)) * (thickness if len(sizes) < 3 else 1.0)
    return np.asarray(whole / sizes)


def lattice_cells(x: Float, volume: Float, thickness: float) -> tuple[NDArray[np.int64], Float] | None:
    """Return the cell of each particle (n, dim) and the sizes of the equal cells (dim,) [length] of a lattice.

    None if the particles are not a lattice.
    """
    n, dim = x.shape
    cell, sizes = np.zeros((n, dim), dtype=np.int64), np.full(dim, np.nan)
    regular = bool(np.all(np.abs(volume - volume[0]) <= ALONG * volume[0]))
    for axis in range(dim):
        offsets = x[:, axis] - x[:, axis].min()
        levels = np.unique(offsets)
        gaps = np.diff(levels)
        apart = gaps[gaps > ALONG * offsets.max(initial=0.0)]
        if len(apart):
            sizes[axis] = apart.min()
            cell[:, axis] = np.round(offsets / sizes[axis])
            regular &= bool(np.all(np.abs(offsets - cell[:, axis] * sizes[axis]) <= ALONG * offsets.max()))
    whole = volume[0] / (thickness if dim < 3 else 1.0)
    flat = np.flatnonzero(np.isnan(sizes))
    if len(flat) == 1:  # one layer of cells, whose depth follows from their volume
        sizes[flat] = whole / np.nanprod(sizes)
    if not regular or len(flat) > 1 or abs(np.prod(sizes) - whole) > ALONG * whole:
        return None
    return cell, sizes


def numbers_in(counts: GlobalIndex, cell: GlobalIndex) -> GlobalIndex:
    """Return the numbers of cells (n, dim) of a lattice of ``counts`` cells (dim,), -1 for cells outside."""
    inside = ((cell >= 0) & (cell < counts)).all(axis=1)
    return np.where(inside, np.ravel_multi_index(tuple(cell.T), tuple(counts), mode="clip"), -1)


def cells_of(x: Float, volume: Float, thickness: float) -> Cells:
    """Return the cells of particles from their positions and volumes.

    These are the cells of a lattice, else Voronoi cells in the plane, else boxes with the volumes of the particles and
    sides of 0.5 to 1.5 spacings.

    Parameters
    ----------
    x : (n, dim) float64
        Positions [length].
    volume : (n,) float64
        Volumes [length^dim times thickness].
    thickness : float
        Thickness of a plane body [length], cross-section of a line body [length^2], 1 for a solid body.
    """
    found = lattice_cells(x, volume, thickness)
    if found is not None:
        return lattice(x, found[1])
    if x.shape[1] == 2 and len(x) > 1:
        return voronoi(x, None)
    side = (volume / (thickness if x.shape[1] < 3 else 1.0)) ** (1.0 / x.shape[1])
    spacing = spacings(x) if len(x) > 1 else side
    return boxes(x, np.clip(side, 0.5 * spacing, 1.5 * spacing))


def _refuse_nearest(_: float) -> float:
    raise CaseError("Nearest cannot choose the particles of a Lattice; use Box, Slab, Sphere or Where in cut and keep.")
