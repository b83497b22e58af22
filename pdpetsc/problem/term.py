"""Base classes of terms, the sources of forces."""

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
from pdpetsc.problem.rigid_body import RigidBody
from pdpetsc.problem.state import State
from pdpetsc.renamed import warn


@dataclass(frozen=True)
class KeptArray:
    """Store an array that a restart needs.

    Attributes
    ----------
    owner : (n,) int
        Own particle of each row, ascending. A particle may have no row, one row, or several (one per gradient point).
    values : (n, ...) float64
        The array that the term reads, not a copy. A checkpoint stores it; a restart overwrites it in place.
    low, high : float
        Admissible range. A checkpoint with other values is refused.

    Raises
    ------
    CaseError
        The number of rows differs from the number of owners, the type is not float64, or the owners do not ascend.
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
    """Add forces to the residual ``sum of internal forces - sum of loads``.

    A term adds its contribution to the residual: an internal force with its sign, a load with the opposite sign. To
    write a term, derive from this class, implement the forces and their tangent, and declare an ``ExtraTerm`` that
    builds it.

    Attributes
    ----------
    linear : bool
        Whether the forces are linear in the unknowns, with a tangent that does not depend on the load parameter. For
        terms of bonds that fail: as long as no bond fails.
    symmetric : bool
        Whether the tangent is symmetric.
    load : bool
        Whether the term is a load. The residual is compared with loads and reactions. A foundation is not a load. The
        event-driven solver requires dead loads proportional to the load parameter. Path following also supports
        ``proportional`` ones.
    proportional : bool
        Whether a load that depends on the displacement is proportional to the load parameter at every displacement, if
        it is so on the undeformed body.
    of_solver : bool
        Whether the term only helps a solver to converge. Outputs do not contain it.
    horizons : int
        Number of horizons over which the term couples particles: 0 for each particle with itself, 1 for the two ends of
        a bond, 2 for members of one family.
    energy_of : str
        Name under which the energy is summed. The energy of the material is ``"strain"``, that of a control
        ``"control"``.
    works : bool
        Whether the forces do work on the body that is not a change of the energy of the term, as those of moving tools.
    constrained : bool
        Whether the tangents have a ``Product.constraint``.
    stiff : bool
        Whether the tangents may have a ``Product.stiff``.
    pattern : int
        Increases if ``stencils`` change.
    version : int
        Increases if the forces or the tangent at the same unknowns and load parameter change, for example if ``commit``
        updates history variables.
    rigid : RigidBody or None
        Rigid body that the term holds, if its motion follows from a load.
    tool_way : (dim,) float64 or None
        Prescribed displacement of a moving tool at load parameter 1 [length]; None without one.
    joined : (n, 2) int32
        Pairs of local particles that the term holds together in every direction.

    Notes
    -----
    Every method is collective unless stated otherwise. Attributes, ``has_history`` and the names in ``arrays`` are
    the same on all ranks.
    """

    linear: bool = True
    symmetric: bool = True
    load: bool = False
    proportional: bool = False
    of_solver: bool = False
    horizons: int = 0
    energy_of: str = "extra"
    works: bool = False
    constrained: bool = False
    stiff: bool = False
    pattern: int = 0
    version: int = 0
    rigid: RigidBody | None = None
    tool_way: Float | None = None
    joined: LocalIndex = np.empty((0, 2), dtype=np.int32)

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
        """Return the names of the parts of the term, for the run record (not collective)."""
        return [type(self).__name__]

    @property
    def grounded(self) -> Mask | None:
        """Return which displacements of the own particles the term ties to the ground (n_owned, dim), as supports do.

        None if it ties none (not collective).
        """
        return None

    def resisted(self, modes: Float) -> Float | None:
        """Return the parts of displacements (n_owned, dim) that the term resists, as supports do.

        They are (n_owned, parts) [length], by default the components of ``grounded``; None for none (not collective).
        """
        return None if self.grounded is None else np.where(self.grounded, modes, 0.0)

    @property
    def resultants(self) -> list[tuple[str, float, Float]]:
        """Return name, load parameter and total force (dim,) of each load, for the run record (not collective)."""
        return [] if self.rigid is None else self.rigid.resultants

    @property
    def stencils(self) -> tuple[GlobalIndex, LocalIndex] | None:
        """Return the stencils as ``(point_ptr, members)``; None if each particle couples with itself only.

        Not collective.
        """
        return None

    @property
    def within_families(self) -> bool:
        """Return True if all members of each stencil are in one family (not collective).

        The sparsity needs no entries for such a term if another term couples whole families.
        """
        return True

    @property
    def whole_families(self) -> bool:
        """Return True if the term couples all members of a family with each other (not collective).

        The sparsity is then that of whole families.
        """
        return False

    def tool_gap(self, state: State) -> float:
        """Return the smallest distance of a tool from the body [length], by default 0 (collective)."""
        return 0.0

    def start_friction(self, state: State) -> None:  # noqa: B027
        """Measure slip from a state in which a tool comes into touch (collective)."""

    def tool_displacements(self, t: float) -> Float:
        """Return displacements that describe the motion of a tool (n, dim) [length], by default none."""
        return np.empty((0, 0))

    def tool_forces(self, state: State) -> Float:
        """Return the forces of a moving tool on points of the body (n, dim) [force], by default none (collective)."""
        return np.empty((0, 0))

    def tool_work(self, forces: Float, before: State, after: State) -> float:
        """Return the work of a tool from one state to another on this rank [energy].

        ``forces`` (n, dim) is the sum of its forces in both states. By default there are none (collective).
        """
        return 0.0

    def admissible(self, state: State) -> bool:
        """Return True if the forces are defined on this rank; ghosts are exchanged."""
        return True

    def add_force(self, state: State, f: Float) -> None:  # noqa: B027
        """Add forces to local particles, ghosts included (n_local, dim) [force] (not collective except for ghosts)."""

    def add_force_together(self, other: Term, state: State, f: Float) -> bool:
        """Add the forces of this and another term in one loop, if that is faster. Return True if the forces were added.

        Arguments as for ``add_force``.
        """
        return False

    def control_of(self, operator: GradientOperator, state: State) -> SameGradient | None:
        """Return the data of a control on the gradient of ``operator`` at a state, for a loop shared with the material.

        None if the term is no such control (not collective).
        """
        return None

    def add_row_force(self, state: State, r: Float) -> None:  # noqa: B027
        """Add the forces that need no ghosts to the unknowns of this rank (n_rows, dim) [force] (not collective)."""

    @abstractmethod
    def linearise(self, state: State) -> Sequence[Product]:
        """Return the tangent at a state as a list of summands; empty if the tangent is zero."""

    def stiffest(self, state: State) -> Sequence[Product]:
        """Return products that bound the tangent near a state from above, for stable time steps; by default it."""
        return self.linearise(state)

    def energy(self, state: State) -> float:
        """Return the energy on this rank [energy]."""
        return 0.0

    @property
    def piecewise_linear(self) -> bool:
        """Return True if the forces are linear in the unknowns as long as no bond loses force (not collective)."""
        return self.linear

    def bonds_changed(self, rebuild: bool) -> None:  # noqa: B027
        """Update after bonds have lost or regained force; if ``rebuild``, after bonds have broken or mended."""

    def start_from(self, state: State) -> None:  # noqa: B027
        """Prepare for solves or time steps that start from a state."""

    def follow(self, state: State) -> bool:
        """Update what is held during a solve, such as which facets touch, to a state.

        Return True on all ranks if the forces have changed, so that the step has to be solved again.
        """
        return False

    def update_multipliers(self, state: State) -> bool:
        """Update multipliers, which are constant during a solve, at its equilibrium.

        Return True on all ranks if the forces have changed, so that the step has to be solved again.
        """
        return False

    def revert_multipliers(self) -> None:  # noqa: B027
        """Restore the multipliers of the last converged step."""

    def objection(self, state: State) -> str:
        """Return the reason to halve a step that ends in an equilibrium, the same on all ranks; empty for none."""
        return ""

    def before_commit(self, state: State) -> None:  # noqa: B027
        """Read a converged state before any term updates its history."""

    def commit(self, state: State) -> None:  # noqa: B027
        """Commit a converged state: update history variables. Raise ``version`` if forces then change."""

    @property
    def has_history(self) -> bool:
        """Return True if the forces depend on converged steps; the same on all ranks (not collective)."""
        return False

    def numbers(self) -> Mapping[str, Callable[[State], float]]:
        """Return numbers for the history by column name: functions of a state that return the share of this rank.

        The history contains their sums over the ranks (not collective).
        """
        return {}

    def fields(self) -> Mapping[str, Callable[[State], Float]]:
        """Return fields for the files by name: functions of a state that return values of the own particles.

        Values are (n_owned, ...); the functions are collective.
        """
        return {}

    def arrays(self) -> Mapping[str, KeptArray]:
        """Return the arrays that a restart needs besides the unknowns, by name within the term (not collective)."""
        return {}

    def restored(self) -> None:
        """Update after the arrays have been read from a checkpoint."""
        self.version += 1


@dataclass(frozen=True)
class ExtraTerm(Declared, ABC):
    """Declare a term of a case besides material, control and conditions.

    Attributes
    ----------
    on_surface : bool
        Whether the term needs the facets of the surface, ``body.surface``.

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
        """Build the term for a body (collective)."""
