"""What adds forces to a body."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, Mask
from pdpetsc.declared import Declared
from pdpetsc.errors import CaseError
from pdpetsc.gradient.base import GradientOperator, SameGradient
from pdpetsc.gradient.products import Product
from pdpetsc.problem.body import Body
from pdpetsc.problem.state import State
from pdpetsc.renamed import warn


@dataclass(frozen=True)
class KeptArray:
    """An array that a continued run needs.

    Attributes
    ----------
    owner : (n,) int
        The own particle of each row, ascending: a particle may have one row, several (one of each of its gradient
        points) or none.
    values : (n, ...) float64
        Written and, when a run goes on, overwritten in place: the array that the term reads, not a copy.
    low, high : float
        A checkpoint with values below or above is refused.

    Raises
    ------
    CaseError
        There is not one row of float64 for each owner, or the owners do not ascend.
    """

    owner: LocalIndex
    values: Float
    low: float = -np.inf
    high: float = np.inf

    def __post_init__(self) -> None:
        if len(self.owner) != len(self.values) or self.values.dtype != np.float64:
            raise CaseError(
                f"A KeptArray needs a row of float64 for each of its {len(self.owner)} owners, not {self.values.dtype} "
                f"of shape {self.values.shape}."
            )
        if np.any(np.diff(self.owner) < 0):
            raise CaseError("The owners of a KeptArray must ascend.")


class Term(ABC):
    """Something that adds forces to the residual ``sum of internal forces - sum of loads``.

    A term adds what it contributes to the residual: an internal force with its sign, a load with the opposite one.
    Derive from it, give the forces and their tangent, and let a declared ``ExtraTerm`` make it.

    Attributes
    ----------
    linear : bool
        Whether its forces are linear in the unknowns, with a tangent that does not change with the step time; for terms
        of bonds that fail, as long as none does.
    symmetric : bool
        Whether its tangent is symmetric.
    load : bool
        Whether it is a load: the residual is compared with loads and reactions. A foundation is not a load. For path
        following and the event-driven solver loads must be dead and proportional to the step time.
    of_solver : bool
        Whether it only helps a solver to converge; outputs leave it out.
    horizons : int
        Over how many horizons it couples particles: 0 for each with itself alone, 1 for the two ends of a bond, 2 for
        members of one family.
    energy_of : str
        Under which name its energy is summed; that of the material is ``"strain"``, that of a control ``"control"``.
    constrained : bool
        Whether its tangents have a ``Product.constraint``.
    version : int
        Grows whenever its forces or its tangent at the same unknowns and step time change, as when ``commit`` moves
        what it remembers.

    Notes
    -----
    Every method is collective but where it says otherwise. Attributes, ``has_history`` and the names in ``arrays`` are
    the same on all ranks.
    """

    linear: bool = True
    symmetric: bool = True
    load: bool = False
    of_solver: bool = False
    horizons: int = 0
    energy_of: str = "extra"
    constrained: bool = False
    version: int = 0

    def __init_subclass__(cls, **more: object) -> None:
        super().__init_subclass__(**more)
        old = vars(cls).get("linearised")
        if old is not None and "linearise" not in vars(cls):
            warn(f"{cls.__name__}.linearised", "linearise, which returns a list")
            cls.linearise = lambda self, state: [  # type: ignore[method-assign]
                product for product in [old(self, state)] if product is not None
            ]

    @property
    def parts(self) -> list[str]:
        """Return what it is made of, for the record (not collective)."""
        return [type(self).__name__]

    @property
    def grounded(self) -> Mask | None:
        """Return which displacements of the own particles it ties to the ground (n_owned, dim), as supports do.

        None where it ties none (not collective).
        """
        return None

    @property
    def resultants(self) -> list[tuple[str, float, Float]]:
        """Return name, step time and sum of the forces (dim,) of the loads in it, for the record (not collective)."""
        return []

    @property
    def stencils(self) -> tuple[GlobalIndex, LocalIndex] | None:
        """Return what it couples as ``(point_ptr, members)``, None for each particle with itself (not collective)."""
        return None

    @property
    def within_families(self) -> bool:
        """Return whether all members of a stencil are in one family (not collective).

        The sparsity then needs no entries for it where another term couples families whole.
        """
        return True

    @property
    def whole_families(self) -> bool:
        """Return whether it couples all members of a family with each other (not collective).

        The sparsity is then that of whole families.
        """
        return False

    def admissible(self, state: State) -> bool:
        """Return whether its forces are defined on this rank; ghosts are exchanged."""
        return True

    def add_force(self, state: State, f: Float) -> None:  # noqa: B027
        """Add forces on local particles, ghosts among them (n_local, dim) [force] (not collective but for ghosts)."""

    def add_force_together(self, other: Term, state: State, f: Float) -> bool:
        """Add its forces and those of another term in one loop, if that is quicker; return whether it did.

        Arguments as for ``add_force``.
        """
        return False

    def control_of(self, operator: GradientOperator, state: State) -> SameGradient | None:
        """Return what its forces take in the loop over ``operator`` at a state, where it is a control on its gradient.

        None where it is not (not collective).
        """
        return None

    def add_row_force(self, state: State, r: Float) -> None:  # noqa: B027
        """Add forces on the unknowns of this rank (n_rows, dim) [force]: what needs no ghosts (not collective)."""

    @abstractmethod
    def linearise(self, state: State) -> Sequence[Product]:
        """Return its tangent at a state, a list of what it is the sum of; empty if it has none."""

    def energy(self, state: State) -> float:
        """Return its energy on this rank [energy]."""
        return 0.0

    @property
    def piecewise_linear(self) -> bool:
        """Return True if its forces are linear in the unknowns as long as no bond loses force (not collective)."""
        return self.linear

    def bonds_changed(self, rebuild: bool) -> None:  # noqa: B027
        """Follow bonds that have lost or regained force, and if ``rebuild`` bonds that have broken or mended."""

    def before_commit(self, state: State) -> None:  # noqa: B027
        """Read a converged state before any term updates its history."""

    def commit(self, state: State) -> None:  # noqa: B027
        """Commit a converged state: update history variables. Raise ``version`` if forces then change."""

    @property
    def has_history(self) -> bool:
        """Return whether its forces depend on converged steps; the same on all ranks (not collective)."""
        return False

    def numbers(self) -> Mapping[str, Callable[[State], float]]:
        """Return numbers for the history by column name: functions of a state that return the part of this rank.

        The history has their sums over the ranks (not collective).
        """
        return {}

    def fields(self) -> Mapping[str, Callable[[State], Float]]:
        """Return fields for the files by name: functions of a state that return values of the own particles.

        Values are (n_owned, ...); the functions are collective.
        """
        return {}

    def arrays(self) -> Mapping[str, KeptArray]:
        """Return what a continued run needs besides the unknowns, by names of its own (not collective)."""
        return {}

    def restored(self) -> None:
        """Follow its arrays, which have been read from a checkpoint (not collective)."""
        self.version += 1


@dataclass(frozen=True)
class ExtraTerm(Declared, ABC):
    """A term as a case declares it, besides material, control and conditions.

    Attributes
    ----------
    on_surface : bool
        Whether it needs the facets of the surface, ``body.surface``.

    Examples
    --------
    A bed of springs under every particle of a region::

        @dataclass(frozen=True)
        class Foundation(pd.ExtraTerm):
            stiffness: float

            def build(self, body):
                return FoundationTerm(self.stiffness * body.cloud.volume[: body.cloud.n_owned])
    """

    on_surface: ClassVar[bool] = False

    @abstractmethod
    def build(self, body: Body) -> Term:
        """Return the term of a body (collective)."""
