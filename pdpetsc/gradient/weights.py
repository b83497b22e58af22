"""Weights of a gradient: those of its scheme, or the nearest weights that conform to the surface."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

from pdpetsc.declared import Declared
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.families import Families
from pdpetsc.discrete.surface import Surface
from pdpetsc.errors import NoConformingWeights
from pdpetsc.gradient.base import GradientOperator
from pdpetsc.gradient.conforming import SolveSystem, conforming


class Weights(Declared, ABC):
    """Choice of the weights of a gradient."""

    @property
    @abstractmethod
    def conform(self) -> bool:
        """Return True if the weights require the surface of the body."""

    @property
    def required(self) -> bool:
        """Return True if a body without such weights is an error."""
        return self.conform

    @abstractmethod
    def of(
        self, operator: GradientOperator, cloud: Cloud, families: Families, surface: Surface | None, solve: SolveSystem
    ) -> GradientOperator:
        """Return the gradient operator of a scheme with these weights (collective)."""


@dataclass(frozen=True)
class Standard(Weights):
    """The weights of the scheme as published.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> pd.Standard().conform
    False
    """

    conform = False

    def of(
        self, operator: GradientOperator, cloud: Cloud, families: Families, surface: Surface | None, solve: SolveSystem
    ) -> GradientOperator:
        return operator


@dataclass(frozen=True)
class Conforming(Weights):
    """The nearest weights with which a uniform stress is in equilibrium with its tractions, on any cloud.

    ``sum_p W_p g_pk = s_k`` for every particle, with ``s_k`` from the facets of the surface, and linear fields exact:
    see ``conforming``. Uniform tension is then exact with every scheme, and bending converges with second order. The
    particles must have a surface: a ``Lattice``, a ``Mesh``, or ``Arrays`` with facets. A case with an irregular cloud
    of such particles uses these weights by default.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> pd.Conforming().conform
    True
    """

    conform = True

    def of(
        self, operator: GradientOperator, cloud: Cloud, families: Families, surface: Surface | None, solve: SolveSystem
    ) -> GradientOperator:
        """Return the operator with conforming weights."""
        assert surface is not None
        return conforming(cloud, families, operator, surface, solve)


@dataclass(frozen=True)
class Suited(Conforming):
    """Conforming weights if they exist, else those of the scheme: the default of nodes and irregular clouds."""

    required = False

    def of(
        self, operator: GradientOperator, cloud: Cloud, families: Families, surface: Surface | None, solve: SolveSystem
    ) -> GradientOperator:
        """Return the operator with conforming weights, or that of the scheme with a note on the reason."""
        try:
            return super().of(operator, cloud, families, surface, solve)
        except NoConformingWeights as error:
            return Unsuited(str(error)).of(operator, cloud, families, surface, solve)


# What the log says of a body without the conforming weights that are the default of its particles.
MAY_NOT_CONVERGE = "standard weights, which may not converge here"


@dataclass(frozen=True)
class Unsuited(Standard):
    """The weights of the scheme for a body without conforming weights, with the reason ``why``."""

    why: str

    def of(
        self, operator: GradientOperator, cloud: Cloud, families: Families, surface: Surface | None, solve: SolveSystem
    ) -> GradientOperator:
        """Return the operator with the same weights, the note and the reason."""
        note = f"{MAY_NOT_CONVERGE}. {self.why}"
        return operator.changed(note="; ".join(filter(None, [operator.note, note])), unsuited=self.why)


# Weights by their name in case files.
WEIGHTS: dict[str, Weights] = {"standard": Standard(), "conforming": Conforming()}
