"""The declaration of a case."""

from __future__ import annotations

import numbers
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias, cast

from pdpetsc.arrays import Float
from pdpetsc.bond_based import BondMaterial
from pdpetsc.control import ZeroEnergyControl
from pdpetsc.damage import BondDamage, DamageOf, PointDamage
from pdpetsc.declare.cell import Cell
from pdpetsc.declare.conditions import Condition, condition_name
from pdpetsc.declare.cracks import Crack
from pdpetsc.declare.expected import Expected
from pdpetsc.declare.horizon import AnyHorizon, Horizon, check_horizon
from pdpetsc.declare.influence import Constant, Influence
from pdpetsc.declare.modes import Modes
from pdpetsc.declare.particles import Particles
from pdpetsc.declare.region import All, Region
from pdpetsc.declare.solvers import AnySolver, Newton, Opening
from pdpetsc.declare.steps import AdaptiveSteps, Steps
from pdpetsc.declare.symmetry import Symmetry
from pdpetsc.declare.thermal import HeatConduction, ThermalCondition
from pdpetsc.declare.tools import Contact
from pdpetsc.declare.units import Units
from pdpetsc.declared import Declared, Natural, name_of, refuse_signature, shown
from pdpetsc.errors import CaseError
from pdpetsc.gradient import Scheme, Standard, SubHorizons, Weights
from pdpetsc.gradient.weights import Conforming, Suited
from pdpetsc.material import Material
from pdpetsc.material.graded import Graded
from pdpetsc.material.thermal import Thermal
from pdpetsc.post.invariants import von_mises
from pdpetsc.post.picture import Picture
from pdpetsc.post.quantities import PathOpening, Quantity, refuse_component
from pdpetsc.post.solution import Field, Solution, displacement, stress
from pdpetsc.problem.term import ExtraTerm

AnyMaterial: TypeAlias = Material | BondMaterial | Graded | Thermal
# Characters that names of the history must not have: separators of columns, and quotes.
_NOT_IN_NAMES = set(",;\"'")
# Default horizons over the spacing: with damage or bond-based materials, and with conforming weights.
OF_CRACKS, OF_CONFORMING = 3.015, 2.015
# Columns and fields that every run has.
_COLUMNS, _ATTRIBUTES = {"step", "t"}, {"volume"}
Results = Callable[[Mapping[str, list[float]]], Mapping[str, float]]


def isothermal(material: AnyMaterial) -> Material | BondMaterial | Graded:
    """Return the material without its thermal properties."""
    return material.material if isinstance(material, Thermal) else material


def ungraded(material: AnyMaterial) -> Material | BondMaterial:
    """Return the material without its grading and thermal properties."""
    found = isothermal(material)
    return found.material if isinstance(found, Graded) else found


def _named(name: str, function: Field) -> Field:
    """Return a field with a given name; the field itself if it has this name."""
    if name_of(function) == name:
        return function

    def field(solution: Solution) -> Float:
        return function(solution)

    field.__name__ = name
    field.__wrapped__ = function  # type: ignore[attr-defined]
    return field


@dataclass(frozen=True)
class Case(Declared):
    """A case: a body, its conditions, the solution and the output.

    Parameters
    ----------
    particles : Particles
        Source of the particles.
    horizon : float, Horizon, callable or (n,) array, optional
        Radius of the families [length]: one for all, ``Horizon(ratio)`` local spacings, a function of positions
        (n, dim) that returns lengths (n,), or one length per particle in the order of creation. By default 3.015
        spacings for bond-based materials and with damage, otherwise 2.015 with conforming weights and 1.5 with standard
        ones; at least 2.015 with ``BondAssociated`` and 3.015 with ``HigherOrder``.
    material : Material, BondMaterial, Graded, Thermal, or sequence of (Region, one of these)
        One material, or one per region; every particle needs exactly one. Bond-based materials do not mix with others.
    conditions : sequence of Condition
        Displacements, loads, temperatures and eigenstrains.
    scheme : Scheme, optional
        Points at which deformation gradients are evaluated. By default sub-horizons, which need no control.
        Without a declared control it is ``Correspondence`` with ``PointDamage``, and ``MeanDilatation`` for nearly
        incompressible bodies (nu > 0.45). Bond-based materials have no scheme.
    influence : Influence
        Influence function, which weights the bonds of a family.
    weights : Weights, optional
        ``Conforming()`` lets the gradients satisfy the divergence theorem up to the surface; ``Standard()`` leaves them
        as the scheme has them. By default weights conform for irregular particles with a known surface, such as those
        of a mesh, because standard weights do not converge there. They also conform on ``LatticeNodes``, because
        supports act on the surface itself.
    control : ZeroEnergyControl, optional
        Zero-energy control. By default none. Without a declared scheme it is ``Silling(2.0)`` with ``PointDamage``, and
        ``ByShear(Silling(0.5))`` for nearly incompressible bodies (nu > 0.45).
    cracks : sequence of Crack
        Initial cracks, which cut bonds; place them between particles.
    damage : BondDamage, DamageOf or PointDamage, optional
        Failure of bonds, for bond-based materials or materials of deformation gradients, also by region and pair of
        regions. By default bonds do not fail.
    cell : Cell, optional
        Periodic cell that the particles fill; hold one particle against translation.
    symmetry : sequence of Symmetry
        Mirror planes, at most one across each axis: the particles are a half, a quarter or an eighth of the body.
    steps : Steps or AdaptiveSteps
        Load steps.
    solver : Newton, DynamicRelaxation, EventDriven or PathFollowing
        Solver of the equilibrium.
    history : mapping of str to Quantity
        Numbers written per step; names have no comma, semicolon or quote. A path by ``Opening`` adds ``opening``.
    results : callable, optional
        Receives the history as lists by name, and returns the named scalar results of the run.
    fields : sequence of Field, or mapping of str to Field
        Fields written per step; by default displacement, stress and von Mises stress, empty for no file of fields.
        Names are those of the functions or of the mapping: different words of letters, digits and underscores.
    checkpoints : int
        Steps between checkpoints; another one is written at the end of the run, also after a signal or a failure. 0 for
        none.
    picture : Picture, optional
        Picture that is drawn at the end.
    options : mapping of str to value
        PETSc options without dash; the command line overrides them.
    terms : sequence of ExtraTerm
        Forces in addition to material, control and conditions.
    heat : HeatConduction, optional
        Temperature from heat conduction; by default ``Temperature`` conditions prescribe it.
    expect : mapping of str to Expected
        Expected results for these parameters; ``--check`` compares them with the named results.
    units : Units, optional
        Names of the units of length and force in pictures, tables and the report; nothing is converted.
    modes : Modes, optional
        Natural frequencies or buckling factors of the last equilibrium.
    """

    particles: Particles
    horizon: AnyHorizon | None = None
    # Required, but after an optional field: the default None fits no annotation and is refused.
    material: AnyMaterial | Sequence[tuple[Region, AnyMaterial]] = None  # type: ignore[assignment]
    conditions: Sequence[Condition] = ()
    scheme: Scheme | None = None
    influence: Influence = field(default_factory=Constant)
    weights: Weights | None = None
    control: ZeroEnergyControl | None = None
    cracks: Sequence[Crack] = ()
    damage: BondDamage | DamageOf | PointDamage | None = None
    cell: Cell | None = None
    symmetry: Sequence[Symmetry] = ()
    steps: Steps | AdaptiveSteps = field(default_factory=Steps)
    solver: AnySolver = field(default_factory=Newton)
    history: Mapping[str, Quantity] = field(default_factory=dict)
    results: Results | None = None
    fields: Sequence[Field] | Mapping[str, Field] = (displacement, stress, von_mises)
    checkpoints: Natural = 1
    picture: Picture | None = None
    options: Mapping[str, Any] = field(default_factory=dict)
    terms: Sequence[ExtraTerm] = ()
    heat: HeatConduction | None = None
    expect: Mapping[str, Expected] = field(default_factory=dict)
    units: Units | None = None
    modes: Modes | None = None

    @property
    def materials(self) -> list[tuple[Region, AnyMaterial]]:
        """Return the materials with their regions."""
        if isinstance(self.material, AnyMaterial):
            return [(All(), self.material)]
        return list(self.material)

    @property
    def of_bonds(self) -> bool:
        """Return True if the material is bond-based."""
        return any(isinstance(ungraded(material), BondMaterial) for _, material in self.materials)

    @property
    def thermals(self) -> list[Thermal | None]:
        """Return the thermal properties of each material, None if it has none."""
        return [material if isinstance(material, Thermal) else None for _, material in self.materials]

    @property
    def laws(self) -> list[Material]:
        """Return the materials of a body with deformation gradients, without gradings and temperatures."""
        return [cast(Material, ungraded(material)) for _, material in self.materials]

    @property
    def expands(self) -> bool:
        """Return True if the body may have thermal strain or eigenstrain."""
        of_conditions = any(isinstance(condition, ThermalCondition) for condition in self.conditions)
        return self.heat is not None or of_conditions or any(thermal is not None for thermal in self.thermals)

    @property
    def needs_surface(self) -> bool:
        """Return True if required weights, loads, quantities or terms need the facets of the surface."""
        required = self.weights is not None and self.weights.required
        return required or bool(self._on_surface)

    @property
    def only_touched(self) -> bool:
        """Return True if nothing but rigid tools needs the surface, for which that of an outer layer is enough."""
        required = self.weights is not None and self.weights.required
        return not required and all(isinstance(one, Contact) for one in self._on_surface)

    @property
    def _on_surface(self) -> list[object]:
        """Return the loads, quantities and terms that need the facets of the surface."""
        asked = [*self.conditions, *self.terms, *self.history.values()]
        return [one for one in asked if getattr(one, "on_surface", False)]

    @property
    def gradients(self) -> Scheme:
        """Return the scheme of a body with deformation gradients."""
        return SubHorizons() if self.scheme is None else self.scheme

    @property
    def chosen_horizon(self) -> AnyHorizon:
        """Return the declared horizon, or the default for the particles, scheme, weights and damage.

        Raises
        ------
        CaseError
            The source of the particles is missing or malformed.
        """
        if self.horizon is not None:
            return self.horizon
        if self.of_bonds or self.damage is not None:
            ratio = OF_CRACKS
        else:
            conform = isinstance(self.chosen_weights, Conforming)
            ratio = max(self.gradients.horizon_ratio, OF_CONFORMING if conform else 0.0)
        # A uniform spacing gives a uniform horizon.
        spacing = getattr(self.particles, "spacing", None)
        return Horizon(ratio) if spacing is None else ratio * spacing

    @property
    def chosen_weights(self) -> Weights:
        """Return the declared weights, or the default for the particles.

        Raises
        ------
        CaseError
            The source of the particles is missing or malformed.
        """
        if self.weights is not None:
            return self.weights
        if self.of_bonds:
            return Standard()
        # Without conforming weights, nodes on the surface are pushed away from their supports.
        return Suited() if self.particles.irregular or self.particles.on_surface else Standard()

    @property
    def quantities(self) -> dict[str, Quantity]:
        """Return the quantities of the history: the opening of path following, and those of the case."""
        measure = getattr(self.solver, "measure", None)
        of_path = {"opening": PathOpening(measure)} if isinstance(measure, Opening) else {}
        return {**of_path, **self.history}

    @property
    def written(self) -> list[Field]:
        """Return the fields with their names as ``__name__``."""
        if isinstance(self.fields, Mapping):
            return [_named(name, function) for name, function in self.fields.items()]
        return list(self.fields)

    @property
    def recorded(self) -> list[Field]:
        """Return the fields that a run writes: the declared fields, and those of the picture."""
        fields = self.written
        for shown_too in [] if self.picture is None else [displacement, self.picture.field]:
            if shown_too not in fields:
                fields.append(shown_too)
        return fields

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.horizon is not None:
            check_horizon(self.horizon, getattr(self.particles, "spacing", 0.0))
        if not self.materials:
            raise CaseError("Case takes at least one material.")
        self._check_symmetry()
        self._check_formulation()
        self._check_durations()
        self._check_temperatures()
        self._check_names()
        self._check_signatures()

    def _check_symmetry(self) -> None:
        axes = [plane.axis for plane in self.symmetry]
        if len(set(axes)) < len(axes):
            raise CaseError(f"A body has one Symmetry across an axis, not planes across {', '.join(axes)}.")
        periodic = [] if self.cell is None else ["xyz"[axis] for axis in self.cell.periodic]
        both = sorted(set(axes) & set(periodic))
        if both:
            raise CaseError(
                f"The Cell is periodic in {both[0]} and the case has a Symmetry across it; take one of both."
            )

    @property
    def duration(self) -> float:
        """Return the physical time from load parameter 0 to 1 [time], 1 if no part of the case declares one."""
        return next((duration for _, duration in self._durations), 1.0)

    @property
    def damage_laws(self) -> list[BondDamage]:
        """Return the damage laws of bonds; empty without damage."""
        return [] if self.damage is None else self.damage.all_laws

    @property
    def _durations(self) -> list[tuple[str, float]]:
        """Return the durations that parts of the case declare, with the names of the parts."""
        laws = [(f"material {number}", ungraded(one)) for number, (_, one) in enumerate(self.materials, 1)]
        named = [(f"{type(law).__name__} of {name}", law.duration) for name, law in laws]
        named.append(("HeatConduction", None if self.heat is None else self.heat.duration))
        named.append((self.solver.title, self.solver.duration))
        named += [("the criterion of damage", time) for law in self.damage_laws for time in law.criterion.times]
        return [(name, duration) for name, duration in named if duration is not None]

    def _check_durations(self) -> None:
        """Raise CaseError if parts of the case declare different durations."""
        given = self._durations
        for name, duration in given[1:]:
            if duration != given[0][1]:
                raise CaseError(
                    f"`duration` differs: {given[0][0]} has {given[0][1]:g}, {name} has {duration:g}. Use one value "
                    "for the case."
                )

    def _check_temperatures(self) -> None:
        """Raise CaseError if damage requires a temperature that a material does not have."""
        if any(law.criterion.reads_temperature for law in self.damage_laws):
            lacking = [number for number, one in enumerate(self.thermals, 1) if one is None]
            if lacking:
                raise CaseError(
                    f"The damage criterion requires a temperature, and material {lacking[0]} has none. Wrap the "
                    "material in Thermal, and add a Temperature or HeatConduction."
                )

    def _check_signatures(self) -> None:
        """Raise CaseError if a function that is called after the first solve requires other arguments."""
        if self.results is not None:
            refuse_signature("function of results", self.results, "history")
        drawn = [] if self.picture is None else [self.picture.field]
        for function in [*self.written, *drawn]:
            refuse_signature("field", function, "solution")
        for name, quantity in self.history.items():
            refuse_signature(f"quantity {name!r} of the history", quantity.evaluate, "solution")

    def _check_names(self) -> None:
        clash = _COLUMNS & set(self.history)
        if clash:
            raise CaseError(f"The history cannot have a quantity named {clash.pop()!r}; step and t are always there.")
        for name in self.history:
            if not name.strip() or name != name.strip() or not name.isprintable() or _NOT_IN_NAMES & set(name):
                raise CaseError(
                    f"A quantity of the history cannot be named {shown(name)}: names are columns of a table, without "
                    f"commas, semicolons, quotes, line ends and outer blanks."
                )
        if self.expect and self.results is None and self.modes is None:
            raise CaseError(
                f"`expect` names the result {next(iter(self.expect))!r}, and the case has no `results`. Add "
                f"results=lambda h: {{...}}."
            )
        for name, value in self.options.items():
            if not name or name.startswith("-") or len(name.split()) != 1:
                raise CaseError(f"An option of PETSc is one word without dash in front, not {name!r}.")
            if not (value is None or isinstance(value, str | numbers.Real)):
                raise CaseError(f"The option {name} takes a string, a number or None, not {shown(value)}.")
        named: dict[str, Field] = {}
        for function in self.recorded:
            name = name_of(function) if hasattr(function, "__name__") else ""
            if not (name.isidentifier() and name.isascii()):
                raise CaseError(
                    f"A field has no name for files ({name or shown(function)}). Define it with def, or give "
                    f"fields={{name: function}}."
                )
            if name in named or name in _ATTRIBUTES:
                raise CaseError(f"Two fields are named {name!r}, or files have it anyway; give one another name.")
            named[name] = function

    def _check_formulation(self) -> None:
        if any(law.closes for law in self.damage_laws) and not self.of_bonds:
            raise CaseError("closes=True requires bond-based materials. Use BondBased, or leave closes out.")
        if any(getattr(law, "strength", None) is not None for law in self.damage_laws) and not self.of_bonds:
            raise CaseError(
                "LinearSoftening has a strength for bond-based materials only; use PointDamage(curve, Gc=, strength=)."
            )
        if self.of_bonds:
            if not all(isinstance(ungraded(material), BondMaterial) for _, material in self.materials):
                raise CaseError(
                    "The case mixes bond-based materials and materials of deformation gradients. Use one kind."
                )
            weights = self.weights if self.weights is not None and self.weights.required else None
            for name, given in (("scheme", self.scheme), ("control", self.control), ("weights", weights)):
                if given is not None:
                    raise CaseError(f"A body of bonds has no {name}; leave {type(given).__name__} out.")
            if self.damage is not None and self.damage.point_laws:
                raise CaseError(
                    "PointDamage requires materials of deformation gradients. For bond-based materials use a law of "
                    "bonds, such as LinearSoftening."
                )
            reversible = [law.effect for law in self.damage_laws if law.effect.reversible]
            if reversible:
                effect = type(reversible[0]).__name__
                raise CaseError(f"{effect} is for deformation gradients; bonds of a body of bonds do not heal.")


def check_declared(case: Case, dim: int) -> None:
    """Raise CaseError if a declaration does not fit a body of ``dim`` dimensions.

    Parameters
    ----------
    case : Case
        The case; components of picture and history, regions, solver and cell are checked.
    dim : int
        Number of coordinates of the particles.

    Notes
    -----
    Not collective: call it on every rank, before anything is written.
    """
    if case.picture is not None:
        refuse_component(case.picture, case.picture.field, case.picture.component, dim)
    for name, quantity in case.history.items():
        _in(f"Quantity {name!r} of the history", quantity.check, dim)
    for number, (region, _) in enumerate(case.materials, 1):
        _in(f"Material {number}", region.check, dim)
    for number, condition in enumerate(case.conditions, 1):
        for place in (getattr(condition, name, None) for name in ("region", "other")):
            if place is not None:
                _in(condition_name(condition, number), place.check, dim)
    for what, region in [] if case.damage is None else case.damage.places:
        _in(what, region.check, dim)
    case.solver.check(dim)
    if case.cell is not None and case.cell.dim != dim:
        raise CaseError(f"The Cell has {case.cell.dim} coordinates, the particles {dim}.")


def _in(what: str, check: Callable[[int], None], dim: int) -> None:
    """Run a check, and name the part of the case in its error."""
    try:
        check(dim)
    except CaseError as error:
        raise CaseError(f"{what}: {error}") from None
