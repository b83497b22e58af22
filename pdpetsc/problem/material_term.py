"""The term of the material: what outputs and loads ask of it."""

from __future__ import annotations

from abc import abstractmethod

import numpy as np

from pdpetsc.arrays import Float, Mask
from pdpetsc.damage.criterion import Solid
from pdpetsc.discrete.communicator import total
from pdpetsc.problem.body import Body
from pdpetsc.problem.state import State
from pdpetsc.problem.term import Term


class MaterialTerm(Term):
    """Material of a body, at gradient points or in bonds.

    Attributes
    ----------
    note : str
        What a user should know about how it was built; the same on all ranks.
    n_detached : int
        Particles on all ranks that have too few bonds left for a gradient, and therefore no stress.

    Notes
    -----
    Every method is collective but where it says otherwise.
    """

    horizons = 2
    energy_of = "strain"
    note: str = ""
    n_detached: int = 0
    # Whether its forces depend on time, for which step times must stand.
    timed: bool = False

    def __init__(self, body: Body) -> None:
        self.body = body

    @property
    @abstractmethod
    def n_points(self) -> int:
        """Return the gradient points of this rank, 0 for a body without (not collective)."""

    @property
    @abstractmethod
    def kappa(self) -> float:
        """Return a typical modulus, ``lambda + 2 mu / dim`` [stress] (not collective)."""

    @property
    @abstractmethod
    def largest_modulus(self) -> float:
        """Return the largest modulus on this rank [stress] (not collective)."""

    @property
    def driving_points(self) -> Solid | None:
        """Return the gradient points that driving variables of damage may read (not collective)."""
        return None

    def family_strain(self, state: State) -> Float | None:
        """Return the tensile strain by which bonds break besides their own drive (n_bonds,) [-], None for none."""
        return None

    @abstractmethod
    def deformation_gradient(self, state: State) -> Float:
        """Return F of the own particles (n_owned, dim, dim) [-]."""

    @abstractmethod
    def first_piola_stress(self, state: State) -> Float:
        """Return P of the own particles (n_owned, dim, dim) [stress]."""

    @abstractmethod
    def cauchy_stress(self, state: State) -> Float:
        """Return the Cauchy stress of the own particles (n_owned, dim, dim) [stress]; P where the body is linear."""

    @abstractmethod
    def out_of_plane(self, state: State) -> tuple[Float, Float, Float]:
        """Return stretch [-], P and Cauchy stress [stress] across a line or plane body, each (n_owned,).

        All three are those of one direction; a line has two equal ones.
        """

    @abstractmethod
    def energy_density(self, state: State) -> Float:
        """Return the strain energy density of the own particles (n_owned,) [energy / volume]."""

    def plastic_strain(self) -> Float:
        """Return the accumulated plastic strain of the own particles (n_owned,) [-] (not collective)."""
        return np.zeros(self.body.cloud.n_owned)

    def plastic_growth(self, state: State) -> float:
        """Return how much plastic strain grows at most on this rank if the step ends at a state [-]."""
        return 0.0

    def local_damage(self) -> Float:
        """Return the lost share of the stiffness of each own particle's bonds (n_owned,) [-] (not collective)."""
        return np.zeros(self.body.cloud.n_owned)

    def dissipated_energy(self) -> float | None:
        """Return what damage has dissipated [energy]; None where its laws alone do not give it."""
        density, cloud = self.dissipation_density(), self.body.cloud
        return None if density is None else float(total(cloud.comm, float(density @ cloud.volume[: cloud.n_owned])))

    def dissipation_density(self) -> Float | None:
        """Return what damage has dissipated at the own particles (n_owned,) [energy / volume].

        None where its laws alone do not give it (not collective).
        """
        return None if self.has_history else np.zeros(self.body.cloud.n_owned)

    @abstractmethod
    def uniform_stress_force(self, P: Float) -> Float:
        """Return the forces that hold stresses ``P`` (n_owned, dim, dim) of the particles in balance (n_rows, dim).

        Raises
        ------
        CaseError
            The formulation has no such forces.
        """

    @abstractmethod
    def dependents(self, marked: Float) -> Mask:
        """Return the own particles whose forces depend on a marked local particle: (n_local,) -> (n_owned,) bool."""
