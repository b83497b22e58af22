"""What a body would deform by if nothing held it: thermal strains and others without stress."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence

import numpy as np

from pdpetsc.arrays import Float, LocalIndex, Mask
from pdpetsc.declare.thermal import Eigenstrain, Temperature
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.communicator import agreed, largest
from pdpetsc.discrete.families import Families
from pdpetsc.errors import CaseError
from pdpetsc.material.thermal import Thermal
from pdpetsc.problem.prescribed import Prescribed

# Step of differences by temperature, as a share of the largest distance from that without stress, which counts as at
# least so much of the temperature itself: at that without stress the distance may be round-off.
DIFFERENCE, LEAST_DISTANCE = 1e-5, 1e-3


class TemperatureField(ABC):
    """The temperature of the own particles.

    Attributes
    ----------
    version : int
        Grows whenever the temperature at the same step time changes.
    """

    version: int = 0

    @abstractmethod
    def at(self, t: float) -> Float:
        """Return the temperature of the own particles at step time ``t`` (n_owned,) (collective)."""


class PrescribedTemperature(TemperatureField):
    """A temperature that conditions give, that at the start elsewhere.

    Parameters
    ----------
    cloud : Cloud
        The particles.
    start : (n_owned,) float64
        The temperature at the start.

    Attributes
    ----------
    held : (n_owned,) bool
        Which own particles have a prescribed temperature.
    given : Prescribed
        Which conditions prescribe it.
    """

    def __init__(self, cloud: Cloud, start: Float) -> None:
        self._cloud = cloud
        self.start = start
        self._given: list[tuple[LocalIndex, Temperature]] = []
        self.given = Prescribed(cloud)
        self.held: Mask = np.zeros(cloud.n_owned, dtype=bool)

    def prescribe(self, condition: Temperature, mask: Mask, name: str) -> None:
        """Prescribe the temperature of own particles, which may have several conditions that agree (collective)."""
        own = np.flatnonzero(mask).astype(np.int32)
        self.held |= mask
        self._given.append((own, condition))
        self.given.add(name, "the temperature", own)

    def at(self, t: float) -> Float:
        """Return the temperature at step time ``t`` (collective).

        Raises
        ------
        SolveError
            A function of the case fails, or two conditions prescribe different temperatures of the same particle.
        """
        cloud, found = self._cloud, self.start.copy()
        with agreed(cloud.comm):
            values = [
                condition.values(self.start[own], cloud.x[own], cloud.gid[own], cloud.n_global, t)
                for own, condition in self._given
            ]
        self.given.refuse_different(values, t)
        for (own, _), of_condition in zip(self._given, values, strict=True):
            found[own] = of_condition
        return found


class StressFree:
    """The stress-free deformation of the own particles, and what multiplies their moduli at their temperature.

    Parameters
    ----------
    cloud, families
        The particles and their bonds.
    thermals : sequence of Thermal or None
        What each material does with temperature.
    material_of : (n_owned,) int
        Index into ``thermals`` of each own particle.
    field : TemperatureField, optional
        The temperature; that without stress everywhere where absent.
    eigenstrains : sequence of (particles, Eigenstrain)
        Further strains without stress of own particles.
    across : (n_owned,) float64
        By what share of the strain across the plane a bond gets longer [-]: Poisson's ratio in bodies of bonds in plane
        strain, where what cannot expand across the plane does so within it.
    """

    def __init__(
        self, cloud: Cloud, families: Families, thermals: Sequence[Thermal | None], material_of: LocalIndex,
        field: TemperatureField | None, eigenstrains: Sequence[tuple[LocalIndex, Eigenstrain]], across: Float,
    ) -> None:  # fmt: skip
        self._cloud = cloud
        self._families = families
        self.thermals = thermals
        self._thermals = [
            (np.flatnonzero(material_of == number).astype(np.int32), one)
            for number, one in enumerate(thermals)
            if one is not None
        ]
        self._field = field
        self._eigenstrains = eigenstrains
        self._across = across
        self._kept: dict[str, tuple[tuple[float, int], Float]] = {}

    @property
    def version(self) -> int:
        """Return a number that grows whenever the temperature at the same step time changes (not collective)."""
        return 0 if self._field is None else self._field.version

    @property
    def softens(self) -> bool:
        """Return whether temperature changes moduli (not collective)."""
        return any(one.factor is not None or one.law is not None for _, one in self._thermals)

    def temperature(self, t: float) -> Float | None:
        """Return the temperature of the own particles at step time ``t`` (n_owned,); None without (collective)."""
        field = self._field
        return None if field is None else self._at("temperature", t, lambda: field.at(t))

    def strain(self, t: float) -> Float:
        """Return the strains without stress of the own particles (n_owned, 3, 3) [-] (collective).

        Raises
        ------
        CaseError, SolveError
            A function of the case fails, or the strain leaves no positive volume.
        """

        def make() -> Float:
            temperature, strain = self.temperature(t), self.eigenstrain(t).copy()
            with agreed(self._cloud.comm):
                if temperature is not None:
                    for own, thermal in self._thermals:
                        strain[own] += thermal.strain(temperature[own])
                flat = np.flatnonzero(~(np.linalg.eigvalsh(strain)[:, 0] > -1.0))
                if len(flat):
                    raise CaseError(
                        f"The strain without stress at {self._cloud.x[flat[0]]} leaves no volume at step time {t:g}: "
                        f"a principal one is -1 or less; check expansion, temperatures and eigenstrains."
                    )
            return strain

        return self._at("strain", t, make)

    def eigenstrain(self, t: float) -> Float:
        """Return the part of these strains that no temperature makes (n_owned, 3, 3) [-] (collective)."""

        def make() -> Float:
            strain = np.zeros((self._cloud.n_owned, 3, 3))
            with agreed(self._cloud.comm):
                for where, condition in self._eigenstrains:
                    if len(where):
                        strain[where] += condition.strain(t)
            return strain

        return self._at("eigenstrain", t, make)

    def factor(self, t: float) -> Float | None:
        """Return what multiplies the moduli of the own particles (n_owned,) [-]; None for nothing (collective)."""
        temperature = self.temperature(t)
        if temperature is None or not self.softens:
            return None

        def make() -> Float:
            found = np.ones(self._cloud.n_owned)
            with agreed(self._cloud.comm):
                for own, thermal in self._thermals:
                    found[own] = thermal.factors(temperature[own])
            return found

        return self._at("factor", t, make)

    def by_temperature(self, t: float) -> tuple[Float, Float, float]:
        """Return how strain without stress (n_owned, 3, 3) and the logarithm of the factor (n_owned,) change with T.

        By central differences of what the materials give, with a step that is returned too [temperature] (collective).
        """
        temperature = self.temperature(t)
        assert temperature is not None
        reference = [np.full(len(own), thermal.reference) for own, thermal in self._thermals]
        away = [temperature[own] - zero for (own, _), zero in zip(self._thermals, reference, strict=True)]
        most = max((float(np.abs(one).max(initial=0.0)) for one in away), default=0.0)
        most = max(most, LEAST_DISTANCE * float(np.abs(temperature).max(initial=0.0)))
        step = DIFFERENCE * (largest(self._cloud.comm, most) or 1.0)
        strain, factor = np.zeros((self._cloud.n_owned, 3, 3)), np.zeros(self._cloud.n_owned)
        with agreed(self._cloud.comm):
            for own, thermal in self._thermals:
                up, down = temperature[own] + step, temperature[own] - step
                strain[own] = (thermal.strain(up) - thermal.strain(down)) / (2.0 * step)
                factor[own] = np.log(thermal.factors(up) / thermal.factors(down)) / (2.0 * step)
        return strain, factor, step

    def in_body(self, t: float) -> Float:
        """Return the strain that a body shows, with what that across its plane widens it by (n_owned, dim, dim) [-]."""
        dim, strain = self._cloud.dim, self.strain(t)
        shown = strain[:, :dim, :dim].copy()
        if dim == 2:
            shown += (self._across * strain[:, 2, 2])[:, None, None] * np.eye(2)
        return shown

    def elongation(self, t: float, finite: bool) -> Float:
        """Return by how much bonds are longer without force (n_bonds,) [length] (collective).

        That is the mean of ``|(I + eps) xi| - |xi|`` of both ends, or of ``n . eps xi`` for elongations along the first
        direction of a bond.
        """

        def make() -> Float:
            cloud, families = self._cloud, self._families
            strain = np.empty((cloud.n_local, cloud.dim, cloud.dim))
            strain[: cloud.n_owned] = self.in_body(t)
            cloud.halo.forward(strain)
            if len(cloud.sign):
                strain[cloud.n_owned :] *= cloud.sign[:, :, None] * cloud.sign[:, None, :]
            xi = families.bonds(cloud.x)
            length = np.linalg.norm(xi, axis=1)

            def of(ends: LocalIndex) -> Float:
                stretched = np.einsum("bij,bj->bi", strain[ends], xi)
                if finite:
                    return np.asarray(np.linalg.norm(xi + stretched, axis=1) - length)
                return np.asarray(np.einsum("bi,bi->b", xi, stretched) / length)

            return np.asarray(0.5 * (of(families.centres) + of(families.neighbours)))

        return self._at(f"elongation {finite}", t, make)

    def _at(self, name: str, t: float, make: Callable[[], Float]) -> Float:
        """Return what was made for this step time and temperature, or make it."""
        key = t, self.version
        if name not in self._kept or self._kept[name][0] != key:
            self._kept[name] = key, make()
        return self._kept[name][1]
