"""Damage laws of several materials and their interfaces."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, Mask, starts_of
from pdpetsc.damage.criterion import (
    DamageableBonds,
    Displaced,
    DrivingVariable,
    EndpointMean,
    Gradient,
    NonlocalPart,
    Solid,
)
from pdpetsc.damage.evolution import DamageEvolution
from pdpetsc.damage.laws import BondDamage, Marking, by_law, spare
from pdpetsc.damage.point_damage import PointDamage
from pdpetsc.declare.region import Region
from pdpetsc.declared import Declared
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.communicator import agreed
from pdpetsc.discrete.families import Families
from pdpetsc.errors import CaseError


@dataclass(frozen=True)
class DamageOf(Declared):
    """Damage by region and by pair of regions: one law per material and one per interface.

    The laws are of bonds, or all are ``PointDamage``.

    Parameters
    ----------
    regions : mapping of str to Region
        Names of parts of the body, such as its materials; every particle is in exactly one region.
    laws : mapping of str or (str, str) to BondDamage, PointDamage or None
        Law of bonds with both ends in one region (name), or with ends in two regions (pair, in any order); None for
        bonds that do not fail. Every name, and every pair of names whose particles share a bond, requires a law. For
        ``PointDamage`` see the notes.
    protected : Region, optional
        Bonds with an end in this region, or points of particles in it, do not fail. A law may protect further regions.

    Raises
    ------
    CaseError
        A name is unknown, laws are missing or have different effects or splits, or laws of bonds and of points are
        mixed. In a case: a particle is in no region or in several, or a bond has no law.

    Notes
    -----
    The law of a region applies to the points of its particles. If the family of a particle has members in another
    region and the pair has a law, the law of the pair applies; of several such pairs, the first in ``laws``. A crack
    along the interface then cuts families with the law of the pair only, and dissipates the Gc of the pair. Without a
    law of the pair both sides have the law of their region.

    A fracture energy is that of a plane through the material, or between two materials: ``FractureEnergy`` and
    ``BondEnergy(Gc=...)`` use the stiffness of the bonds from both ends.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> fibre = pd.region.Sphere((0.0, 0.0), 5.0)
    >>> def brittle(Gc):
    ...     return pd.Brittle(pd.FractureEnergy(Gc))
    >>> damage = pd.DamageOf(
    ...     {"fibre": fibre, "matrix": ~fibre},
    ...     {"fibre": None, "matrix": brittle(0.1), ("fibre", "matrix"): brittle(0.01)},
    ... )
    >>> matrix = pd.PointDamage(pd.softening.Linear(), Gc=0.1, strength=3.0)
    >>> bond = pd.PointDamage(pd.softening.Exponential(), Gc=0.02, strength=1.0)
    >>> damage = pd.DamageOf(
    ...     {"fibre": fibre, "matrix": ~fibre},
    ...     {"fibre": None, "matrix": matrix, ("fibre", "matrix"): bond},
    ... )
    """

    regions: Mapping[str, Region]
    laws: Mapping[str | tuple[str, str], BondDamage | PointDamage | None]
    protected: Region | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        seen: set[frozenset[str]] = set()
        for key in self.laws:
            pair = _pair(key)
            unknown = sorted(pair - set(self.regions))
            if unknown:
                raise CaseError(f"DamageOf has a law of {unknown[0]!r}, which is none of its regions.")
            if pair in seen:
                raise CaseError(f"DamageOf has two laws of {_named(pair)}.")
            seen.add(pair)
        missing = [name for name in self.regions if frozenset([name]) not in seen]
        if missing:
            raise CaseError(f"DamageOf needs a law of {missing[0]!r}, or None where its bonds do not fail.")
        if not self._given:
            raise CaseError("DamageOf needs a law; leave it out where no bond fails.")
        if self.all_laws and self.point_laws:
            raise CaseError("All laws in DamageOf need to be of bonds, or all PointDamage.")
        if any(law.split != self.point_laws[0].split for law in self.point_laws):
            raise CaseError("All laws in DamageOf need the same split.")
        if any(law.effect != self.effect for law in self.all_laws):
            raise CaseError("All laws in DamageOf need the same effect.")

    @property
    def _given(self) -> list[BondDamage | PointDamage]:
        """Return the laws, without those that are None."""
        return [law for law in self.laws.values() if law is not None]

    @property
    def all_laws(self) -> list[BondDamage]:
        """Return the laws of bonds."""
        return [one for law in self._given for one in law.all_laws]

    @property
    def point_laws(self) -> list[PointDamage]:
        """Return the laws of gradient points."""
        return [one for law in self._given for one in law.point_laws]

    def rehearsed(self) -> BondDamage | PointDamage:
        """Return the laws for a small body on which their loops are compiled."""
        return self._given[0].rehearsed()

    @property
    def effect(self) -> DamageEvolution:
        """Return the damage evolution of the laws."""
        return self.all_laws[0].effect

    @property
    def places(self) -> list[tuple[str, Region]]:
        """Return its regions with their descriptions."""
        found = [(f"Region {name!r} of DamageOf", region) for name, region in self.regions.items()]
        found += [] if self.protected is None else [("What damage is protected from", self.protected)]
        return found + [place for law in self._given for place in law.places]

    def assign(self, bonds: DamageableBonds, mark: Marking) -> LocalIndex:
        """Return the number in ``all_laws`` of the law of each bond (n_bonds,), -1 for none (collective)."""
        cloud, families = bonds.cloud, bonds.families
        part, (place, number) = self._parts(cloud, mark), self._table()
        with agreed(cloud.comm):
            first, second = part[families.centres], part[families.neighbours]
            at = place[first, second]
            lacking = np.flatnonzero(at == len(self.laws))
            if len(lacking):
                names = list(self.regions)
                pair = sorted({names[first[lacking[0]]], names[second[lacking[0]]]})
                raise CaseError(
                    f"{_named(frozenset(pair)).capitalize()} share bonds, and DamageOf has no law for these; give one, "
                    f"or None where they do not fail."
                )
        return spare(number[at].astype(np.int32), self.all_laws, self.protected, mark, bonds.with_end)

    def assign_particles(self, cloud: Cloud, families: Families, mark: Marking) -> GlobalIndex:
        """Return the number in ``point_laws`` of the law of each own particle (n_owned,), -1 for none (collective)."""
        part, (place, number) = self._parts(cloud, mark), self._table()
        own = part[: cloud.n_owned]
        at, names = place[own, own], list(self.regions)
        for law, key in reversed(list(enumerate(self.laws))):  # the first one last
            both = [part == names.index(name) for name in _pair(key)]
            for here, there in zip(both, both[::-1], strict=True) if len(both) == 2 else []:
                at[here[: cloud.n_owned] & families.with_any(there)] = law
        return spare(number[at], self.point_laws, self.protected, mark, lambda marked: marked[: cloud.n_owned])

    def _parts(self, cloud: Cloud, mark: Marking) -> GlobalIndex:
        """Return the number of the region of each local particle (n_local,) (collective)."""
        part, count = np.full(cloud.n_local, -1, dtype=np.int64), np.zeros(cloud.n_local, dtype=np.int64)
        for number, (name, region) in enumerate(self.regions.items()):
            marked = mark(region, f"region {name!r} of DamageOf")
            part[marked] = number
            count += marked
        with agreed(cloud.comm):
            wrong = np.flatnonzero(count[: cloud.n_owned] != 1)
            if len(wrong):
                gid, times = cloud.gid[wrong[0]], int(count[wrong[0]])
                raise CaseError(f"Particle {gid} is in {times} regions of DamageOf; let these cover it once.")
        return part

    def _table(self) -> tuple[GlobalIndex, GlobalIndex]:
        """Return the index in ``laws`` for two regions (n_regions, n_regions), ``len(laws)`` if missing.

        Also return the number of each law among those that are not None (n_laws,), -1 for None.
        """
        names = list(self.regions)
        place = np.full((len(names), len(names)), len(self.laws), dtype=np.int64)
        for at, key in enumerate(self.laws):
            pair = sorted(_pair(key))
            one, other = names.index(pair[0]), names.index(pair[-1])
            place[one, other] = place[other, one] = at
        fails = np.array([law is not None for law in self.laws.values()])
        return place, np.where(fails, np.cumsum(fails) - 1, -1)


def _pair(key: str | tuple[str, str]) -> frozenset[str]:
    return frozenset([key] if isinstance(key, str) else key)


def _named(pair: frozenset[str]) -> str:
    return " and ".join(repr(name) for name in sorted(pair))


@dataclass(frozen=True)
class AssignedLaws:
    """Damage laws and the bonds to which they apply.

    Attributes
    ----------
    laws : sequence of BondDamage
        All laws.
    of_bond : (n_bonds,) int32
        The law of each bond, -1 for a bond that does not fail.
    """

    laws: Sequence[BondDamage]
    of_bond: LocalIndex

    def build(self, bonds: DamageableBonds) -> DrivingVariable:
        """Build the driving variable of the bonds (not collective)."""
        drives = [law.criterion.build(bonds) for law in self.laws]
        return drives[0] if len(drives) == 1 else SeveralDrivingVariables(drives, self.of_bond)

    @property
    def softens(self) -> bool:
        """Return True if any bond loses its force gradually."""
        return any(law.final > law.onset for law in self.laws)

    @property
    def snaps(self) -> bool:
        """Return True if any bond loses its force at once."""
        return any(law.final == law.onset for law in self.laws)

    @property
    def closing(self) -> Mask | None:
        """Return a mask of bonds that carry compression if broken (n_bonds,); None if no law has such bonds."""
        closes = [law.closes for law in self.laws]
        return np.array([*closes, False])[self.of_bond] if any(closes) else None

    def onset(self) -> Float:
        """Return the driving variable at onset of each bond (n_bonds,), infinite without a law."""
        return self._of_bonds([law.onset for law in self.laws])

    def final(self) -> Float:
        """Return the driving variable at which each bond breaks (n_bonds,), infinite without a law."""
        return self._of_bonds([law.final for law in self.laws])

    def _of_bonds(self, values: Sequence[float]) -> Float:
        """Return the value of the law of each bond (n_bonds,), infinite without a law; equal values are stored once."""
        if len(set(values)) == 1 and not (self.of_bond < 0).any():
            return np.broadcast_to(values[0], len(self.of_bond))
        return np.array([*values, np.inf])[self.of_bond]

    def phi(self, x: Float, bonds: GlobalIndex) -> Float:
        """Return the degradation factor of selected bonds at driving variables x (n,)."""
        return by_law(self.laws, self.of_bond[bonds], lambda law, at: law.phi(x[at]))

    def slope(self, x: Float, bonds: GlobalIndex) -> Float:
        """Return its derivative by the driving variable (n,)."""
        return by_law(self.laws, self.of_bond[bonds], lambda law, at: law.slope(x[at]))

    def dissipated(self, phi: Float, x: Float, energy: Float, degree: float, bonds: GlobalIndex) -> Float:
        """Return the dissipated energy of selected linear bonds (n,) [energy]."""
        number = self.of_bond[bonds]
        return by_law(self.laws, number, lambda law, at: law.dissipated(phi[at], x[at], energy[at], degree))


class SeveralDrivingVariables(DrivingVariable):
    """Driving variable of each bond by its law.

    Parameters
    ----------
    of_laws : sequence of DrivingVariable
        Driving variable of all bonds, for each law.
    of_bond : (n_bonds,) int32
        The law of each bond, -1 for none.
    """

    def __init__(self, of_laws: Sequence[DrivingVariable], of_bond: LocalIndex) -> None:
        self._of_laws, self._of_bond = of_laws, of_bond
        self.is_nonlocal = any(one.is_nonlocal for one in of_laws)
        self.reads_points = any(one.reads_points for one in of_laws)
        self.reads_flow = any(one.reads_flow for one in of_laws)
        self.timed = any(one.timed for one in of_laws)
        limits = [one.limit for one in of_laws if one.limit is not None]
        if len(limits) == len(of_laws):
            self.limit = self._chosen(limits, np.inf)

    def take(self, solid: Solid) -> None:
        """Set the gradient points of all driving variables."""
        for one in self._of_laws:
            one.take(solid)

    def commit(self, state: Displaced) -> None:
        """Commit a converged state in all driving variables."""
        for one in self._of_laws:
            one.commit(state)

    def arrays(self) -> Mapping[str, Float]:
        """Return the history arrays of all, with the number of the law in the name."""
        return {
            f"{name}_{number}": values
            for number, one in enumerate(self._of_laws)
            for name, values in one.arrays().items()
        }

    def at(self, state: Displaced) -> Float:
        """Return the driving variable of every bond by its law, 0 without a law."""
        return self._chosen([one.at(state) for one in self._of_laws], 0.0)

    def gradient(self, state: Displaced, bonds: GlobalIndex, by: Float) -> Gradient:
        """Return the joint gradient of all laws."""
        return self._merged(bonds, lambda one, at: one.gradient(state, bonds[at], by[at]))

    def mean_gradient(self, state: Displaced, bonds: GlobalIndex, count: float) -> Gradient:
        """Return the joint gradient of all laws."""
        return self._merged(bonds, lambda one, at: one.mean_gradient(state, bonds[at], count))

    def at_strain(self, strain: Float) -> Float | None:
        """Return the driving variable at these strains, 0 if the law of a bond has none, None if no law has one."""
        found = [one.at_strain(strain) for one in self._of_laws]
        if all(one is None for one in found):
            return None
        return self._chosen([np.zeros_like(strain) if one is None else one for one in found], 0.0)

    def elastic_energy(self, bonds: GlobalIndex, k: Float) -> tuple[Float, float] | None:
        """Return the energies at driving variable 1, if all laws define them with the same degree."""
        energy, degrees = np.zeros(len(bonds)), set()
        for number, one in enumerate(self._of_laws):
            at = np.flatnonzero(self._of_bond[bonds] == number)
            known = one.elastic_energy(bonds[at], k[at])
            if known is None:
                return None
            energy[at] = known[0]
            degrees.add(known[1])
        return (energy, degrees.pop()) if len(degrees) == 1 else None

    def _chosen(self, values: Sequence[Float], otherwise: float) -> Float:
        found = np.full(len(self._of_bond), otherwise)
        for number, one in enumerate(values):
            mine = self._of_bond == number
            found[mine] = one[mine]
        return found

    def _merged(self, bonds: GlobalIndex, gradient: Callable[[DrivingVariable, GlobalIndex], Gradient]) -> Gradient:
        along = np.zeros(len(bonds))
        ends: tuple[EndpointMean, ...] = ()
        lengths, rows = np.zeros(len(bonds), dtype=np.int64), []
        for number, of_law in enumerate(self._of_laws):
            at = np.flatnonzero(self._of_bond[bonds] == number)
            part = gradient(of_law, at)
            along[at] = part.along
            if part.nonlocal_part is not None:
                lengths[at] = np.diff(part.nonlocal_part.ptr)
                rows.append((at, part.nonlocal_part))
            for one in part.ends:
                factor = np.zeros(len(bonds))
                factor[at] = one.factor
                ends = (*ends, EndpointMean(factor, one.by))
        return Gradient(bonds, along, _joined(lengths, rows) if rows else None, ends)


def _joined(lengths: GlobalIndex, rows: Sequence[tuple[GlobalIndex, NonlocalPart]]) -> NonlocalPart:
    """Join derivatives of disjoint sets of bonds."""
    ptr = starts_of(lengths)
    dim = rows[0][1].by.shape[1]
    particles: LocalIndex = np.empty(ptr[-1], dtype=np.int32)
    by = np.empty((ptr[-1], dim))
    for at, nonlocal_part in rows:
        size = np.diff(nonlocal_part.ptr)
        to = np.repeat(ptr[at] - nonlocal_part.ptr[:-1], size) + np.arange(size.sum())
        particles[to], by[to] = nonlocal_part.particles, nonlocal_part.by
    return NonlocalPart(ptr, particles, by)
