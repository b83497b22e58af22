"""Whose weights a gradient has: those of its scheme, or the nearest ones that conform to the surface."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

from pdpetsc.declared import Declared
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.families import Families
from pdpetsc.discrete.surface import Surface
from pdpetsc.errors import NoConformingWeights
from pdpetsc.gradient.base import GradientOperator
from pdpetsc.gradient.conforming import SolveSystem, conforming


class Weights(Declared, ABC):
    """What becomes of the weights of a scheme."""

    @property
    @abstractmethod
    def conform(self) -> bool:
        """Return whether they need the surface of the body."""

    @property
    def required(self) -> bool:
        """Return whether a body that cannot have them is refused."""
        return self.conform

    @abstractmethod
    def of(
        self, operator: GradientOperator, cloud: Cloud, families: Families, surface: Surface | None, solve: SolveSystem
    ) -> GradientOperator:
        """Return the gradient of a scheme with these weights (collective)."""


@dataclass(frozen=True)
class Standard(Weights):
    """The weights of the scheme as published.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> pd.Standard().conform
    False
    """

    @property
    def conform(self) -> bool:
        """Return False."""
        return False

    def of(
        self, operator: GradientOperator, cloud: Cloud, families: Families, surface: Surface | None, solve: SolveSystem
    ) -> GradientOperator:
        """Return the gradient as it is."""
        return operator


@dataclass(frozen=True)
class Conforming(Weights):
    """The nearest weights with which a uniform stress is in equilibrium with its tractions, on any cloud.

    ``sum_p W_p g_pk = s_k`` for every particle, with ``s_k`` from the facets of the surface, and linear fields exact:
    see ``conforming``. Uniform tension is then exact with every scheme, bending converges with second order. It takes
    particles that know their surface: a ``Lattice``, a ``Mesh``, or ``Arrays`` with facets. Where such particles are no
    lattice a case has them by default.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> pd.Conforming().conform
    True
    """

    @property
    def conform(self) -> bool:
        """Return True."""
        return True

    def of(
        self, operator: GradientOperator, cloud: Cloud, families: Families, surface: Surface | None, solve: SolveSystem
    ) -> GradientOperator:
        """Return the conforming gradient."""
        assert surface is not None
        return conforming(cloud, families, operator, surface, solve)


@dataclass(frozen=True)
class Suited(Conforming):
    """Conforming weights where there are any, else those of the scheme: what an irregular cloud has by default."""

    @property
    def required(self) -> bool:
        """Return False."""
        return False

    def of(
        self, operator: GradientOperator, cloud: Cloud, families: Families, surface: Surface | None, solve: SolveSystem
    ) -> GradientOperator:
        """Return the conforming gradient, or the one of the scheme with a note that says why."""
        try:
            return super().of(operator, cloud, families, surface, solve)
        except NoConformingWeights as error:
            return Unsuited(str(error)).of(operator, cloud, families, surface, solve)


# What a gradient is where it should be another one.
NEED_NOT_CONVERGE = "standard weights on an irregular cloud, where they need not converge"


@dataclass(frozen=True)
class Unsuited(Standard):
    """The weights of the scheme on an irregular cloud that cannot have conforming ones."""

    why: str

    def of(
        self, operator: GradientOperator, cloud: Cloud, families: Families, surface: Surface | None, solve: SolveSystem
    ) -> GradientOperator:
        """Return the gradient as it is, with a note."""
        note = f"{NEED_NOT_CONVERGE}. {self.why}"
        return replace(operator, note="; ".join(filter(None, [operator.note, note])))


# The weights by the word that case files use.
WEIGHTS: dict[str, Weights] = {"standard": Standard(), "conforming": Conforming()}
