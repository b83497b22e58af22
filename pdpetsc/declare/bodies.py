"""Several bodies in one case."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex
from pdpetsc.declare.cracks import Crack
from pdpetsc.declare.horizon import spacings
from pdpetsc.declare.particles import Chunk, Particles, ends_of_part
from pdpetsc.declare.surface import Facets
from pdpetsc.declare.tiling import Cells
from pdpetsc.errors import CaseError


@dataclass(frozen=True)
class Bodies(Particles):
    """Several bodies; particles of different bodies have no bonds at any distance.

    The name of a body is a set of its particles, ``"lower"``, and ``"lower +y"`` is its upper side. Sets and named
    facets of the parts keep their names. Bodies pass through each other unless ``BodyContact`` acts between them.

    Parameters
    ----------
    parts : mapping of str to Particles
        The bodies by name, in the order of creation.

    Raises
    ------
    CaseError
        A name has spaces, a body is itself ``Bodies``, or plane bodies differ in thickness.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> lower, upper = pd.LatticeNodes((0, 0), (2, 1), 0.25), pd.LatticeNodes((0, 1), (2, 2), 0.2)
    >>> blocks = pd.Bodies({"lower": lower, "upper": upper})
    >>> pressed = pd.BodyContact("lower +y", "upper -y")
    """

    parts: Mapping[str, Particles]
    thickness: float = field(default=1.0, init=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.parts:
            raise CaseError("Bodies takes at least one body.")
        for name in self.parts:
            if not name or " " in name:
                raise CaseError(f"The name of a body is one word, not {name!r}.")
        if any(isinstance(one, Bodies) for one in self.parts.values()):
            raise CaseError("A body of Bodies is itself Bodies, whose parts would share bonds; name all in one Bodies.")
        thickness = {one.thickness for one in self.parts.values()}
        if len(thickness) > 1:
            raise CaseError(f"Bodies have the thicknesses {sorted(thickness)}; give all of them the same.")
        object.__setattr__(self, "thickness", thickness.pop())

    @property
    def irregular(self) -> bool:
        """Return True if the particles of a body are not a lattice of equal cells."""
        return any(one.irregular for one in self.parts.values())

    @property
    def bodies(self) -> tuple[Particles, ...]:
        """Return the particles of each body, in the order of creation."""
        return tuple(self.parts.values())

    @property
    def on_surface(self) -> bool:
        """Return True if the outer particles of all bodies lie on their surfaces."""
        return all(one.on_surface for one in self.parts.values())

    def estimate(self) -> int:
        """Return an upper bound of the number of particles."""
        return sum(one.estimate() for one in self.parts.values())

    def chunk(self, part: int, parts: int) -> Chunk:
        """Return rows ``part`` of ``parts`` of all bodies, one body after another."""
        chunks = [one.chunk(0, 1) for one in self.parts.values()]
        dims = {chunk.x.shape[1] for chunk in chunks}
        if len(dims) > 1:
            raise CaseError(f"Bodies have {sorted(dims)} coordinates; give all of them the same number.")
        body = np.repeat(np.arange(len(chunks)), [len(chunk.x) for chunk in chunks])
        spacing = [spacings(chunk, self.thickness) for chunk in chunks]
        names = {name for chunk in chunks for name in chunk.sets}
        sets = {
            name: np.concatenate([chunk.sets.get(name, np.zeros(len(chunk.x), dtype=bool)) for chunk in chunks])
            for name in names
        }
        for number, name in enumerate(self.parts):
            sets[name] = body == number
        rows = slice(*ends_of_part(part, parts, len(body)))
        return Chunk(
            np.concatenate([chunk.x for chunk in chunks])[rows],
            np.concatenate([chunk.volume for chunk in chunks])[rows],
            {name: flags[rows] for name, flags in sets.items()},
            np.concatenate(spacing)[rows],
            body[rows],
        )

    def surface(self, part: int, parts: int, cracks: Sequence[Crack] = ()) -> Facets:
        """Return the facets of the particles of a part."""
        found = [one.surface(0, 1, cracks) for one in self.parts.values()]
        first = self._firsts()
        arrays = [facets.arrays for facets in found]
        names = {name for _, _, _, tags in arrays for name in tags}
        tags = {
            name: np.concatenate([tags.get(name, np.zeros(len(x), dtype=bool)) for x, _, _, tags in arrays])
            for name in names
        }
        known = [np.asarray(facets.corners) for facets in found if facets.corners is not None]
        whole = Facets(
            np.concatenate([x for x, _, _, _ in arrays]),
            np.concatenate([area for _, area, _, _ in arrays]),
            np.concatenate([particle + n for (_, _, particle, _), n in zip(arrays, first, strict=False)]),
            tags,
            np.concatenate(known) if len(known) == len(found) else None,
        )
        return whole.of_particles(*ends_of_part(part, parts, first[-1]))

    def stairs(self, part: int, parts: int) -> int:
        """Return the number of facets that are steps of a staircase."""
        return sum(one.stairs(part, parts) for one in self.parts.values())

    def triangles(self, part: int, parts: int) -> Float | None:
        """Return the surfaces of all bodies as triangles."""
        found = [one.triangles(part, parts) for one in self.parts.values()]
        known = [triangles for triangles in found if triangles is not None]
        return np.concatenate(known) if len(known) == len(found) else None

    def cells(self) -> Cells:
        """Return the cells of all bodies."""
        found, first = [one.cells() for one in self.parts.values()], self._firsts()
        at_corners = all(one.particle is None for one in found)
        found = found if at_corners else [one.own for one in found]
        points = np.cumsum([0, *(len(one.points) for one in found)]).tolist()
        corners = np.cumsum([0, *(len(one.corners) for one in found)]).tolist()

        def joined(of: Callable[[Cells], GlobalIndex], shift: Sequence[int]) -> GlobalIndex:
            return np.concatenate([of(one) + n for one, n in zip(found, shift, strict=False)])

        return Cells(
            np.concatenate([one.points for one in found]),
            joined(lambda one: one.corners, points),
            np.append(joined(lambda one: one.offsets[:-1], corners), corners[-1]),
            None if at_corners else joined(lambda one: one.owner, first),
        )

    def _firsts(self) -> list[int]:
        """Return the index of the first particle of each body, followed by the total number of particles."""
        return [0, *np.cumsum([len(one.chunk(0, 1).x) for one in self.parts.values()]).tolist()]
