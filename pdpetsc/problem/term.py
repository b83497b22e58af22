"""What adds forces to a body."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, Mask
from pdpetsc.declared import Declared
from pdpetsc.discrete.sparsity import Rows, Sparsity
from pdpetsc.errors import CaseError
from pdpetsc.gradient.base import GradientOperator, SameGradient
from pdpetsc.problem.body import Body
from pdpetsc.problem.state import State

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator


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

    Raises
    ------
    CaseError
        There is not one row of float64 for each owner, or the owners do not ascend.
    """

    owner: LocalIndex
    values: Float

    def __post_init__(self) -> None:
        if len(self.owner) != len(self.values) or self.values.dtype != np.float64:
            raise CaseError(
                f"A KeptArray needs a row of float64 for each of its {len(self.owner)} owners, not {self.values.dtype} "
                f"of shape {self.values.shape}."
            )
        if np.any(np.diff(self.owner) < 0):
            raise CaseError("The owners of a KeptArray must ascend.")


@dataclass(frozen=True)
class Entries:
    """Where a linearised term adds its rows of the tangent matrix.

    Attributes
    ----------
    sparsity : Sparsity
        The blocks there are.
    diag, off : float64
        Values of the own rows, own columns and others, in scalar CSR layout.
    ghost : float64
        This rank's share of the rows of its ghosts.
    """

    sparsity: Sparsity
    diag: Float
    off: Float
    ghost: Float

    def row_sets(self) -> Iterator[tuple[Rows, Float]]:
        """Return the rows of own particles and of ghosts with the values of their own columns."""
        yield self.sparsity.owned, self.diag
        yield self.sparsity.ghost, self.ghost


@dataclass(frozen=True)
class Constraints:
    """A part ``sum_c D_c b_c (x) b_c`` of a tangent, so stiff that it is nearly one condition ``b_c . du = 0`` each.

    Attributes
    ----------
    ptr : (n + 1,) int64
        Where the entries of each condition start.
    members : (n_entries,) int32
        Local particles.
    b : (n_entries, dim) float64
        ``b_c`` [1 / length].
    stiffness : (n,) float64
        ``D_c`` [energy].
    soft : (n,) float64
        What the rest of the tangent resists such displacements with, about [energy].
    """

    ptr: GlobalIndex
    members: LocalIndex
    b: Float
    stiffness: Float
    soft: Float


class LinearisedTerm:
    """The tangent of a term at one state.

    A term without ghosts (a foundation, a spring) gives ``blocks`` alone; one that couples families gives
    ``add_product``, ``add_rows`` and ``stiffness``.
    """

    @property
    def blocks(self) -> Float | None:
        """Return what couples each own particle to itself (n_owned, dim, dim) [force / length], or None."""
        return None

    def add_product(self, du: Float, f: Float, particles: LocalIndex) -> None:
        """Add ``K du`` of the families of some own particles, both with ghosts (n_local, dim) (not collective)."""

    def add_rows(self, entries: Entries) -> None:
        """Add the rows of the matrix (collective)."""

    def add_point_blocks(self, blocks: Float) -> bool:
        """Add what couples each local particle to itself in the families (n_local, dim, dim) [force / length].

        These are the blocks on the diagonal of the rows that ``add_rows`` adds, but for bonds that soften: those count
        with their secant. What ``blocks`` gives is not among them. Return False, with nothing added, where they are not
        known; they are then taken from the rows (not collective).
        """
        return False

    def stiffness(self) -> Float | None:
        """Return ``sum_p W_p dP/dF`` of the own particles (n_owned, dim, dim, dim, dim) [energy], or None.

        It is what a matrix of nearest neighbours is made of (not collective).
        """
        return None

    def strength(self) -> Float | None:
        """Return the trace of ``stiffness`` (n_owned,) [energy], or None (not collective)."""
        D = self.stiffness()
        return None if D is None else np.asarray(np.einsum("pikik->p", D))

    def softened(self) -> LinearisedTerm:
        """Return it without what ``constraints`` gives (not collective)."""
        return self

    def constraints(self) -> Constraints | None:
        """Return the part that is nearly conditions on the displacement, None where there is none (not collective)."""
        return None

    def absorb(self, other: LinearisedTerm) -> bool:
        """Compute the product of another term in the same loop, if that is quicker; return whether it does."""
        return False

    def shared_gradient(self, operator: GradientOperator) -> SameGradient | None:
        """Return what its forces take in the loop over ``operator``, where it is a control on that gradient."""
        return None


class PointTangent(LinearisedTerm):
    """The tangent of a term that couples each particle to itself alone.

    Parameters
    ----------
    blocks : (n_owned, dim, dim) float64
        Minus the derivative of the force on each own particle by its displacement [force / length].
    """

    def __init__(self, blocks: Float) -> None:
        self._blocks = blocks

    @property
    def blocks(self) -> Float:
        """Return the blocks."""
        return self._blocks

    def add_point_blocks(self, blocks: Float) -> bool:
        """Add nothing: no family is in it."""
        return True


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
        Whether its tangents have ``constraints``.
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
    def linearised(self, state: State) -> LinearisedTerm | None:
        """Return its tangent at a state; None where it has none."""

    def energy(self, state: State) -> float:
        """Return its energy on this rank [energy]."""
        return 0.0

    def commit(self, state: State) -> None:  # noqa: B027
        """Take a state as converged: what has a history remembers it."""

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

    Examples
    --------
    A bed of springs under every particle of a region::

        @dataclass(frozen=True)
        class Foundation(pd.ExtraTerm):
            stiffness: float

            def build(self, body):
                return FoundationTerm(self.stiffness * body.cloud.volume[: body.cloud.n_owned])
    """

    @abstractmethod
    def build(self, body: Body) -> Term:
        """Return the term of a body (collective)."""
