"""Stress-free deformation: thermal strain and other eigenstrains."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from functools import cached_property

import numpy as np

from pdpetsc.arrays import Float, LocalIndex, Mask
from pdpetsc.declare.thermal import Eigenstrain, Temperature
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.communicator import agreed
from pdpetsc.discrete.families import Families
from pdpetsc.errors import CaseError
from pdpetsc.material.thermal import Thermal
from pdpetsc.problem.prescribed import Prescribed


class TemperatureField(ABC):
    """Define the temperature of the own particles.

    Attributes
    ----------
    version : int
        Increases if the temperature at the same load parameter changes.
    """

    version: int = 0

    @abstractmethod
    def at(self, t: float) -> Float:
        """Return the temperature of the own particles at load parameter ``t`` (n_owned,) (collective)."""


class PrescribedTemperature(TemperatureField):
    """Evaluate the temperature that conditions prescribe; other particles keep the initial temperature.

    Parameters
    ----------
    cloud : Cloud
        The particles.
    start : (n_owned,) float64
        Initial temperature.

    Attributes
    ----------
    held : (n_owned,) bool
        Own particles with a prescribed temperature.
    given : Prescribed
        Conditions that prescribe it.
    """

    def __init__(self, cloud: Cloud, start: Float) -> None:
        self._cloud = cloud
        self.start = start
        self._given: list[tuple[LocalIndex, Temperature]] = []
        self.given = Prescribed(cloud)
        self.held: Mask = np.zeros(cloud.n_owned, dtype=bool)

    def prescribe(self, condition: Temperature, mask: Mask, name: str) -> None:
        """Prescribe the temperature of own particles (collective).

        Several agreeing conditions may hold the same particle.
        """
        own = np.flatnonzero(mask).astype(np.int32)
        self.held |= mask
        self._given.append((own, condition))
        self.given.add(name, "the temperature", own)

    def at(self, t: float) -> Float:
        """Return the temperature at load parameter ``t`` (collective).

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
    """Evaluate temperature and eigenstrains of a body as functions of the load parameter.

    Parameters
    ----------
    cloud, families
        The particles and their bonds.
    thermals : sequence of Thermal or None
        Thermal properties of each material.
    material_of : (n_owned,) int
        Index into ``thermals`` of each own particle.
    field : TemperatureField, optional
        Temperature field; without it the temperature is the stress-free one everywhere.
    eigenstrains : sequence of (particles, Eigenstrain)
        Further eigenstrains of own particles.
    across : (n_owned,) float64
        Elongation of a bond per strain normal to the plane [-]. It is Poisson's ratio for bond-based bodies in plane
        strain, which expand in the plane instead of normal to it; else 0.
    """

    def __init__(
        self, cloud: Cloud, families: Families, thermals: Sequence[Thermal | None], material_of: LocalIndex,
        field: TemperatureField | None, eigenstrains: Sequence[tuple[LocalIndex, Eigenstrain]], across: Float,
    ) -> None:  # fmt: skip
        self.cloud = cloud
        self.families = families
        self.thermals = thermals
        self.of_particles = [
            (np.flatnonzero(material_of == number).astype(np.int32), one)
            for number, one in enumerate(thermals)
            if one is not None
        ]
        self.eigenstrains = eigenstrains
        self.across = across
        self._field = field
        self._last: tuple[int, FreeDeformation] | None = None

    @property
    def softens(self) -> bool:
        """Return True if temperature changes moduli (not collective)."""
        return any(thermal.softens for _, thermal in self.of_particles)

    def at(self, t: float) -> FreeDeformation:
        """Return the stress-free deformation at a load parameter, cached while the temperature stays (collective).

        Raises
        ------
        SolveError
            A function of the case fails.
        """
        version = 0 if self._field is None else self._field.version
        if self._last is None or self._last[0] != version or self._last[1].t != t:
            temperature = None if self._field is None else self._field.at(t)
            self._last = version, FreeDeformation(self, t, temperature)
        return self._last[1]


class FreeDeformation:
    """Store the stress-free deformation and the factor on the moduli of the own particles at one temperature.

    Parameters
    ----------
    of : StressFree
        The body.
    t : float
        Load parameter [-].
    temperature : (n_owned,) float64 or None
        Temperature of the own particles; None for a body without temperature.

    Notes
    -----
    Properties are collective on first use. They raise SolveError or CaseError if a function of the case fails or if the
    strain leaves no positive volume.
    """

    def __init__(self, of: StressFree, t: float, temperature: Float | None) -> None:
        self.of = of
        self.t = t
        self.temperature = temperature
        self._elongations: dict[bool, Float] = {}

    @cached_property
    def strain(self) -> Float:
        """Return the total eigenstrain of the own particles, thermal strain included (n_owned, 3, 3) [-]."""
        strain, cloud = self.eigenstrain.copy(), self.of.cloud
        with agreed(cloud.comm):
            if self.temperature is not None:
                for own, thermal in self.of.of_particles:
                    strain[own] += thermal.strain(self.temperature[own])
            flat = np.flatnonzero(~(np.linalg.eigvalsh(strain)[:, 0] > -1.0))
            if len(flat):
                raise CaseError(
                    f"The strain without stress at {cloud.x[flat[0]]} leaves no volume at step time {self.t:g}: "
                    f"a principal one is -1 or less; check expansion, temperatures and eigenstrains."
                )
        return strain

    @cached_property
    def eigenstrain(self) -> Float:
        """Return the eigenstrain without thermal strain (n_owned, 3, 3) [-]."""
        strain = np.zeros((self.of.cloud.n_owned, 3, 3))
        with agreed(self.of.cloud.comm):
            for where, condition in self.of.eigenstrains:
                if len(where):
                    strain[where] += condition.strain(self.t)
        return strain

    @cached_property
    def factor(self) -> Float | None:
        """Return the factor on the moduli of the own particles (n_owned,) [-]; None for 1."""
        if self.temperature is None or not self.of.softens:
            return None
        factor = np.ones(self.of.cloud.n_owned)
        with agreed(self.of.cloud.comm):
            for own, thermal in self.of.of_particles:
                factor[own] = thermal.factors(self.temperature[own])
        return factor

    def in_body(self) -> Float:
        """Return the in-plane stress-free strain, widened by the strain normal to the plane (n_owned, dim, dim) [-]."""
        dim = self.of.cloud.dim
        shown = self.strain[:, :dim, :dim].copy()
        if dim == 2:
            shown += (self.of.across * self.strain[:, 2, 2])[:, None, None] * np.eye(2)
        return shown

    def elongation(self, finite: bool) -> Float:
        """Compute the force-free elongation of each bond (n_bonds,) [length] (collective on first use).

        It is the mean of ``|(I + eps) xi| - |xi|`` of both ends, or of ``n . eps xi`` for elongations along the
        reference direction of a bond.
        """
        if finite not in self._elongations:
            self._elongations[finite] = self._elongation(finite)
        return self._elongations[finite]

    def _elongation(self, finite: bool) -> Float:
        cloud, families = self.of.cloud, self.of.families
        strain = cloud.halo.with_ghosts(self.in_body())
        cloud.mirror(strain)
        xi = families.bonds(cloud.x)
        length = np.linalg.norm(xi, axis=1)

        def of(ends: LocalIndex) -> Float:
            stretched = np.einsum("bij,bj->bi", strain[ends], xi)
            if finite:
                return np.asarray(np.linalg.norm(xi + stretched, axis=1) - length)
            return np.asarray(np.einsum("bi,bi->b", xi, stretched) / length)

        return np.asarray(0.5 * (of(families.centres) + of(families.neighbours)))
