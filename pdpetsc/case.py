"""What a scene declares."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

from pdpetsc.bond_based import BondMaterial
from pdpetsc.damage import BondDamage
from pdpetsc.errors import CaseError
from pdpetsc.gradient import Scheme, SubHorizons
from pdpetsc.material import Graded, Material
from pdpetsc.output.picture import Picture
from pdpetsc.quantities import Quantity
from pdpetsc.scene.cell import Cell
from pdpetsc.scene.conditions import Condition
from pdpetsc.scene.cracks import Crack
from pdpetsc.scene.influence import Constant, Influence
from pdpetsc.scene.particles import Particles
from pdpetsc.scene.region import All, Region
from pdpetsc.scene.solver import AnySolver, Newton
from pdpetsc.scene.steps import AdaptiveSteps, Steps
from pdpetsc.solution import Field, displacement, stress
from pdpetsc.stabilisation import Stabilisation

AnyMaterial: TypeAlias = Material | BondMaterial | Graded
Results = Callable[[Mapping[str, list[float]]], Mapping[str, float]]


def law_of(material: AnyMaterial) -> Material | BondMaterial:
    """Return the material without its grading."""
    return material.material if isinstance(material, Graded) else material


@dataclass(frozen=True)
class Case:
    """A scene: a body, what is done to it and what is asked.

    Parameters
    ----------
    particles : Particles
        Where the particles are.
    horizon : float
        Radius of the families [length].
    material : Material, BondMaterial, Graded, or sequence of (Region, one of these)
        One material, or one per region; every particle needs exactly one. Materials of bonds do not mix with others.
    conditions : sequence of Condition
        Displacements and loads.
    scheme : Scheme, optional
        Where deformation gradients are evaluated; sub-horizons by default, which need no control and no coefficient.
        Materials of bonds have none.
    influence : Influence
        How much a bond counts.
    stabilisation : Stabilisation, optional
        Zero-energy control; none where absent.
    cracks : sequence of Crack
        What cuts bonds from the start; let it run between particles.
    damage : BondDamage, optional
        How bonds fail, of bond-based materials or of deformation gradients; they do not where absent.
    cell : Cell, optional
        Periodic cell that the particles fill; hold one particle against translation.
    steps : Steps or AdaptiveSteps
        How the load is applied.
    solver : Newton, DynamicRelaxation, EventDriven or PathFollowing
        How equilibrium is found.
    history : mapping of str to Quantity
        Numbers written per step.
    results : callable, optional
        Gets the history as lists per name and returns the named scalar results of the run.
    fields : sequence of Field
        What is written per step; empty for no file of fields.
    checkpoints : int
        A checkpoint every so many steps, and where the run ends, also by a signal or a failure; 0 for none.
    picture : Picture, optional
        What is drawn at the end.
    options : mapping of str to value
        PETSc options without dash, which the command line overrides.
    """

    particles: Particles
    horizon: float
    material: AnyMaterial | Sequence[tuple[Region, AnyMaterial]]
    conditions: Sequence[Condition]
    scheme: Scheme | None = None
    influence: Influence = field(default_factory=Constant)
    stabilisation: Stabilisation | None = None
    cracks: Sequence[Crack] = ()
    damage: BondDamage | None = None
    cell: Cell | None = None
    steps: Steps | AdaptiveSteps = field(default_factory=Steps)
    solver: AnySolver = field(default_factory=Newton)
    history: Mapping[str, Quantity] = field(default_factory=dict)
    results: Results | None = None
    fields: Sequence[Field] = (displacement, stress)
    checkpoints: int = 1
    picture: Picture | None = None
    options: Mapping[str, Any] = field(default_factory=dict)

    @property
    def materials(self) -> list[tuple[Region, AnyMaterial]]:
        """Return the materials with the regions they are in."""
        if isinstance(self.material, AnyMaterial):
            return [(All(), self.material)]
        return list(self.material)

    @property
    def of_bonds(self) -> bool:
        """Return whether the forces act along bonds."""
        return any(isinstance(law_of(material), BondMaterial) for _, material in self.materials)

    @property
    def gradients(self) -> Scheme:
        """Return the scheme of a body with deformation gradients."""
        return SubHorizons() if self.scheme is None else self.scheme

    def __post_init__(self) -> None:
        if not (math.isfinite(self.horizon) and self.horizon > 0.0):
            raise CaseError(f"The horizon must be positive, not {self.horizon}.")
        spacing = getattr(self.particles, "spacing", 0.0)
        if self.horizon < spacing * (1.0 - 1e-9):
            raise CaseError(f"The horizon {self.horizon:g} is below the spacing {spacing:g}; families would be empty.")
        if self.checkpoints < 0:
            raise CaseError(f"Case takes checkpoints >= 0, not {self.checkpoints}.")
        self._check_formulation()
        clash = {"step", "t"} & set(self.history)
        if clash:
            raise CaseError(f"The history cannot have a quantity named {clash.pop()!r}; step and t are always there.")

    def _check_formulation(self) -> None:
        if self.of_bonds:
            if not all(isinstance(law_of(material), BondMaterial) for _, material in self.materials):
                raise CaseError("Materials of bonds and of deformation gradients cannot share a body; take one kind.")
            for name, given in (("scheme", self.scheme), ("stabilisation", self.stabilisation)):
                if given is not None:
                    raise CaseError(f"A body of bonds has no {name}; leave {type(given).__name__} out.")
