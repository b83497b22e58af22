"""Base class of the term of the material, with the quantities that outputs and loads use."""

from __future__ import annotations

from abc import abstractmethod

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, Mask
from pdpetsc.damage.criterion import Solid
from pdpetsc.discrete.communicator import total
from pdpetsc.problem.body import Body
from pdpetsc.problem.state import State
from pdpetsc.problem.term import Term


class MaterialTerm(Term):
    """Represent the material of a body, at gradient points or in bonds.

    Attributes
    ----------
    note : str
        Note for the user on how the term was built; the same on all ranks.
    unsuited : str
        As of ``GradientOperator``; empty for a body without gradients.
    n_detached : int
        Number of particles on all ranks with too few bonds for a gradient. They have no stress.

    Notes
    -----
    Every method is collective unless stated otherwise.
    """

    horizons = 2
    energy_of = "strain"
    note: str = ""
    unsuited: str = ""
    n_detached: int = 0
    # Whether the forces depend on time, which requires load steps.
    timed: bool = False

    def __init__(self, body: Body) -> None:
        self.body = body

    @property
    @abstractmethod
    def n_points(self) -> int:
        """Return the number of gradient points of this rank, 0 for a body without (not collective)."""

    @property
    def kappa(self) -> float:
        """Return the largest ``lambda + 2 mu / dim`` times factor on this rank [stress] (not collective)."""
        return self.contact_modulus(np.arange(self.body.cloud.n_owned), friction=False)

    @abstractmethod
    def contact_modulus(self, particles: LocalIndex | GlobalIndex, friction: bool) -> float:
        """Return the modulus for the stiffness of contact of own particles with a tool or body [stress].

        It is the largest ``lambda + 2 mu / dim`` times factor among them, 0 without particles (not collective).
        """

    @property
    @abstractmethod
    def largest_modulus(self) -> float:
        """Return the largest modulus on this rank [stress] (not collective)."""

    @property
    def driving_points(self) -> Solid | None:
        """Return the gradient points that driving variables of damage may read (not collective)."""
        return None

    def family_strain(self, state: State) -> Float | None:
        """Return the tensile family strain that also breaks bonds (n_bonds,) [-]; None if unused."""
        return None

    @abstractmethod
    def deformation_gradient(self, state: State) -> Float:
        """Return F of the own particles (n_owned, dim, dim) [-]."""

    @abstractmethod
    def first_piola_stress(self, state: State) -> Float:
        """Return P of the own particles (n_owned, dim, dim) [stress]."""

    @abstractmethod
    def cauchy_stress(self, state: State) -> Float:
        """Return the Cauchy stress of the own particles (n_owned, dim, dim) [stress]; P at small strain."""

    @abstractmethod
    def out_of_plane(self, state: State) -> tuple[Float, Float, Float]:
        """Return stretch [-], P and Cauchy stress [stress] normal to a plane or line body, each (n_owned,).

        The values are those of one direction. A line has two equal ones.
        """

    @abstractmethod
    def energy_density(self, state: State) -> Float:
        """Return the strain energy density of the own particles (n_owned,) [energy / volume]."""

    def plastic_strain(self) -> Float:
        """Return the accumulated plastic strain of the own particles (n_owned,) [-] (not collective)."""
        return np.zeros(self.body.cloud.n_owned)

    def plastic_growth(self, state: State) -> float:
        """Return the largest increase of the plastic strain on this rank if the step ends at a state [-]."""
        return 0.0

    def local_damage(self) -> Float:
        """Return the lost share of the stiffness of the bonds of each own particle (n_owned,) [-] (not collective)."""
        return np.zeros(self.body.cloud.n_owned)

    def dissipated_energy(self) -> float | None:
        """Return the energy dissipated by damage [energy]; None if the damage laws do not determine it."""
        density, cloud = self.dissipation_density(), self.body.cloud
        return None if density is None else float(total(cloud.comm, float(density @ cloud.volume[: cloud.n_owned])))

    def dissipation_density(self) -> Float | None:
        """Return the energy density dissipated by damage at the own particles (n_owned,) [energy / volume].

        None if the damage laws do not determine it (not collective).
        """
        return None if self.has_history else np.zeros(self.body.cloud.n_owned)

    @abstractmethod
    def uniform_stress_force(self, P: Float) -> Float:
        """Return the forces that balance stresses ``P`` (n_owned, dim, dim) of the particles (n_rows, dim) [force].

        Raises
        ------
        CaseError
            The formulation does not define such forces.
        """

    @abstractmethod
    def dependents(self, marked: Float) -> Mask:
        """Return the own particles whose forces depend on a marked local particle: (n_local,) -> (n_owned,) bool."""
