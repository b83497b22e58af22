"""What a zero-energy control declares and what the model asks of it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.families import Families
from pdpetsc.discrete.pattern import Pattern


class Control(ABC):
    """A control built for one cloud: forces linear in u and isotropic, so its matrix has one scalar per block.

    Attributes
    ----------
    point_ptr, members
        Stencils that its matrix couples: the families with their centre first.
    """

    point_ptr: GlobalIndex
    members: LocalIndex

    @abstractmethod
    def force(self, u: Float, f: Float) -> float:
        """Add the internal forces of ``u`` (n_local, dim) to ``f`` and return this rank's energy [energy]."""

    @abstractmethod
    def matrix(self, pattern: Pattern) -> tuple[Float, Float]:
        """Return the scalars of the own columns and of the others in ``pattern`` order (collective)."""


@dataclass(frozen=True)
class Stabilisation(ABC):
    """A zero-energy control as a case declares it."""

    @abstractmethod
    def build(self, cloud: Cloud, families: Families, omega: Float, kappa: Float) -> Control:
        """Return the control for influence ``omega`` (n_bonds,) and modulus ``kappa`` (n_owned,) [stress].

        Notes
        -----
        Collective.
        """
