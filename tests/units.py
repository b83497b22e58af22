"""A case in other units of force and length."""

import dataclasses

import numpy as np

import pdpetsc as pd
from pdpetsc.declare.cracks import Crack
from pdpetsc.declare.particles import Particles
from pdpetsc.declare.region import Region


def in_units(case, force, length):
    """Return the same body under the same conditions, its numbers multiplied as those units ask.

    What is only looked at, history, fields and pictures, is left out.
    """
    units = _Units(force, length)
    materials = [(_Region(region, length), units.material(material)) for region, material in case.materials]
    corners = {name: np.multiply(getattr(case.cell, name), length) for name in ("low", "high")} if case.cell else {}
    cell = case.cell and dataclasses.replace(case.cell, **corners)
    return dataclasses.replace(
        case,
        particles=_Particles(case.particles, length),
        horizon=case.horizon if isinstance(case.horizon, pd.Horizon) else case.horizon * length,
        material=materials,
        conditions=[units.condition(condition) for condition in case.conditions],
        cracks=[_Crack(crack, length) for crack in case.cracks],
        control=units.control(case.control),
        damage=case.damage and units.damage(case.damage),
        cell=cell,
        solver=units.solver(case.solver),
        history={},
        results=None,
        expect={},
        fields=[],
        picture=None,
    )


class _Particles(Particles):
    def __init__(self, particles, length):
        self._particles, self._length = particles, length
        dim = particles.chunk(0, 1).x.shape[1]
        self.thickness = particles.thickness * length ** (3 - dim)

    def chunk(self, part, parts):
        chunk = self._particles.chunk(part, parts)
        spacing = chunk.spacing if chunk.spacing is None else chunk.spacing * self._length
        volume = chunk.volume * self._length**3
        return dataclasses.replace(chunk, x=chunk.x * self._length, volume=volume, spacing=spacing)

    def faces(self, part, parts, normal):
        return self._particles.faces(part, parts, normal) * self._length**2


@dataclasses.dataclass(frozen=True)
class _Region(Region):
    region: Region
    length: float

    def mask(self, view):
        return self.region.mask(dataclasses.replace(view, x=view.x / self.length))


class _Crack(Crack):
    def __init__(self, crack, length):
        self._crack, self._length = crack, length

    def cuts(self, a, b):
        return self._crack.cuts(a / self._length, b / self._length)


@dataclasses.dataclass(frozen=True)
class _Units:
    force: float
    length: float

    @property
    def stress(self):
        return self.force / self.length**2

    def material(self, material):
        if isinstance(material, pd.Graded):
            factor = material.factor
            return pd.Graded(self.material(material.material), lambda x: factor(x / self.length))
        names = {"E", "yield_stress", "hardening"} & {f.name for f in dataclasses.fields(material)}
        return dataclasses.replace(material, **{name: getattr(material, name) * self.stress for name in names})

    def control(self, control):
        if not isinstance(control, pd.SillingMicromodulus):
            return control
        return dataclasses.replace(control, unit_length=control.unit_length * self.length)

    def condition(self, condition):
        if isinstance(condition, pd.MeanStrain | pd.MeanStress):
            unit = self.stress if isinstance(condition, pd.MeanStress) else 1.0
            names = [name for name in ("xx", "yy", "zz", "xy", "yz", "xz") if getattr(condition, name) is not None]
            return dataclasses.replace(condition, **{name: unit * getattr(condition, name) for name in names})
        unit = {
            pd.Displacement: self.length,
            pd.Force: self.force,
            pd.BodyForce: self.force / self.length**3,
            pd.Traction: self.stress,
        }[type(condition)]
        values = {name: self.value(getattr(condition, name), unit) for name in "xyz"}
        return dataclasses.replace(condition, region=_Region(condition.region, self.length), **values)

    def value(self, value, unit):
        if value is None:
            return None
        return (lambda x, t: unit * value(x / self.length, t)) if callable(value) else unit * value

    def damage(self, damage):
        criterion = damage.criterion
        if isinstance(criterion, pd.FractureEnergy):
            criterion = dataclasses.replace(criterion, Gc=criterion.Gc * self.force / self.length)
        elif isinstance(criterion, pd.LinearCritical):
            criterion = dataclasses.replace(criterion, length=criterion.length * self.length)
        elif isinstance(criterion, pd.CriticalFunction):
            function = criterion.function
            in_these = dataclasses.replace(
                criterion, function=lambda length, middle: function(length / self.length, middle / self.length)
            )
            criterion = in_these
        elif not isinstance(criterion, pd.ConstantCritical):
            raise NotImplementedError(type(criterion))
        protected = damage.protected and _Region(damage.protected, self.length)
        return dataclasses.replace(damage, criterion=criterion, protected=protected)

    def solver(self, solver):
        if not isinstance(solver, pd.PathFollowing) or not isinstance(solver.measure, pd.Opening):
            return solver
        opening = solver.measure
        against = opening.against and _Region(opening.against, self.length)
        measure = dataclasses.replace(
            opening,
            region=_Region(opening.region, self.length),
            against=against,
            step=opening.step * self.length,
            end=opening.end * self.length,
        )
        return dataclasses.replace(solver, measure=measure)
