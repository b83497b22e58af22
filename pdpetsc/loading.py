"""Conditions applied to a model: prescribed displacements and external forces at a step time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, Mask
from pdpetsc.declared import called
from pdpetsc.discrete.cloud import Cloud, from_parts
from pdpetsc.discrete.communicator import agreed, largest, smallest, total
from pdpetsc.errors import CaseError, SolveError
from pdpetsc.kernels.pattern import first_moments
from pdpetsc.model import Model
from pdpetsc.scene.conditions import (
    BodyForce,
    Condition,
    Displacement,
    Force,
    MeanStrain,
    MeanStress,
    Traction,
    Value,
    evaluated,
)
from pdpetsc.scene.particles import Particles
from pdpetsc.scene.region import Region, View

# A consistent traction whose forces add up to a share of traction times face outside of these is not that of one face.
WHOLE_FACE = (0.5, 2.0)
# That share is round-off where it differs from 1 by less.
EXACT = 1e-9
# A family is cut in a direction where its first moment is more than this share of what one side alone would have.
ONE_SIDED = 0.9
# Step times at which loads are looked at for the record.
SHOWN = (1.0, 0.75, 0.5, 0.25)
# Step times at which conditions are compared with their proportional values, and how closely.
PROBES = (0.0, 0.3, 0.7)
PROPORTIONAL = 1e-12


@dataclass(frozen=True)
class _Applied:
    """One component of a condition on the particles ``where``, times ``scale`` (len(where),)."""

    condition: Displacement | Force | BodyForce | Traction
    axis: int
    value: Value
    where: GlobalIndex
    scale: Float

    def at(self, x: Float, t: float) -> Float:
        return self.scale * self.condition.value(self.value, x[self.where], t)


@dataclass(frozen=True)
class _Mean:
    """One component of a condition on the mean strain or stress: the virtual unknown and what to multiply with."""

    condition: MeanStrain | MeanStress
    unknown: int
    value: float


class Loading:
    """Prescribed displacements and external forces of a case on this rank.

    Parameters
    ----------
    model : Model
        The body.
    conditions : sequence of Condition
        Declared conditions.
    particles : Particles
        As declared; they tell thickness and faces.

    Attributes
    ----------
    fixed : (n_rows, dim) bool
        Prescribed degrees of freedom.
    cell_volume : float
        What the mean stress of a periodic cell is per: its volume, or that of the particles where some direction is
        not periodic [volume]; 0 without a cell.

    Raises
    ------
    CaseError
        A region selects nothing, a degree of freedom is prescribed twice, a component is wrong, or a traction acts on a
        face whose area is not known.

    Notes
    -----
    Construction and every method are collective.
    """

    def __init__(self, model: Model, conditions: Sequence[Condition], particles: Particles) -> None:
        self._model = model
        self._particles = particles
        self._resultants: list[tuple[str, float, Float]] = []
        self._x = model.cloud.x[: model.cloud.n_owned]
        self.fixed: Mask = np.zeros((model.cloud.n_rows, model.dim), dtype=bool)
        self.cell_volume = _cell_volume(model.cloud, particles.thickness)
        self._means: list[_Mean] = []
        self._virtual()
        self._prescribed: list[_Applied] = []
        self._forces: list[_Applied] = []
        self._consistent: list[tuple[Traction, Float, Float]] = []
        for number, condition in enumerate(conditions):
            name = f"{type(condition).__name__} condition {number + 1}"
            if isinstance(condition, MeanStrain | MeanStress):
                self._mean(condition, name)
                continue
            mask = select(model.cloud, condition.region, name)
            with agreed(model.cloud.comm):
                components = condition.components(model.dim)
                normal = condition.unit_normal(model.dim) if isinstance(condition, Traction) else None
            where = np.flatnonzero(mask)
            if isinstance(condition, Displacement):
                self._prescribe(condition, components, where, name)
                continue
            before = len(self._forces), len(self._consistent)
            if isinstance(condition, Traction):
                assert normal is not None
                face = self._face(condition, normal, where, name)
            if isinstance(condition, Traction) and condition.distribution == "consistent":
                assert normal is not None
                self._consistent.append((condition, normal, self._share(normal, mask, face, name)))
            else:
                scale = face if isinstance(condition, Traction) else _scale(condition, model.cloud, where)
                self._forces += [_Applied(condition, axis, value, where, scale) for axis, value in components]
            self._note(name, self._forces[before[0] :], self._consistent[before[1] :])
        try:
            self.prescribed(1.0)
            self.forces(1.0)
        except SolveError as error:
            raise CaseError(str(error)) from error

    def prescribed(self, t: float) -> Float:
        """Return the prescribed unknowns at step time ``t`` (n_rows, dim) [length], 0 where free (collective)."""
        u = np.zeros(self.fixed.shape)
        with agreed(self._model.cloud.comm):
            for applied in self._prescribed:
                u[applied.where, applied.axis] = applied.at(self._x, t)
        self._add_means(u, MeanStrain, t)
        return u

    def forces(self, t: float) -> Float:
        """Return the external forces at step time ``t`` (n_rows, dim) [force] (collective)."""
        f = self._sum(self._forces, self._consistent, t)
        self._add_means(f, MeanStress, t)
        return f

    @property
    def resultants(self) -> list[tuple[str, float, Float]]:
        """Return name, step time and sum of the forces (dim,) [force] of every load, at a step time when it acts.

        Notes
        -----
        Not collective.
        """
        return self._resultants

    def _sum(self, forces: Sequence[_Applied], consistent: Sequence[tuple[Traction, Float, Float]], t: float) -> Float:
        """Return the sum of loads at step time ``t`` (n_rows, dim) [force]."""
        f = np.zeros(self.fixed.shape)
        with agreed(self._model.cloud.comm):
            for applied in forces:
                f[applied.where, applied.axis] += applied.at(self._x, t)
            stresses = [self._stresses(traction, normal, t) for traction, normal, _ in consistent]
        for P, (_, _, share) in zip(stresses, consistent, strict=True):
            f[: len(self._x)] += self._model.uniform_stress_force(P)[: len(self._x)] * share[:, None]
        return f

    def _note(self, name: str, forces: Sequence[_Applied], consistent: Sequence[tuple[Traction, Float, Float]]) -> None:
        """Note the resultant of a load."""
        try:
            sums = [total(self._model.cloud.comm, self._sum(forces, consistent, t).sum(axis=0)) for t in SHOWN]
        except SolveError as error:
            raise CaseError(str(error)) from error
        acting = next((number for number, force in enumerate(sums) if force.any()), 0)
        self._resultants.append((name, SHOWN[acting], sums[acting]))

    def held_at_cut_families(self) -> int:
        """Return how many particles are held in the direction in which their family is cut, beside ones that are free.

        There the weights do not satisfy the divergence theorem: uniform stress is not in equilibrium, and the stress of
        the outermost layer comes out as 2/3 of the true one at the smallest horizon, whatever the spacing.
        """
        cloud, families = self._model.cloud, self._model.families
        n, dim = cloud.n_owned, cloud.dim
        free = np.ones((cloud.n_local, dim))
        free[:n] = ~self.fixed[:n]
        cloud.halo.forward(free)
        moment, size, beside = np.empty((n, dim)), np.empty((n, dim)), np.empty((n, dim), dtype=bool)
        first_moments(
            families.indptr, families.neighbours, cloud.x, cloud.volume, free > 0.0, moment, size, beside
        )  # fmt: skip
        found = self.fixed[:n] & (np.abs(moment) > ONE_SIDED * size) & beside
        return int(total(cloud.comm, np.count_nonzero(found.any(axis=1))))

    def refuse_what_is_not_proportional(self, who: str) -> None:
        """Raise on all ranks unless every condition is its value at step time 1 times the step time (collective)."""
        whole = [self.prescribed(1.0), self.forces(1.0)]
        comm = self._model.cloud.comm
        for t in PROBES:
            part = [self.prescribed(t), self.forces(t)]
            # Displacements and forces, each by their own size.
            off = [largest(comm, np.abs(p - t * w).max(initial=0.0)) for p, w in zip(part, whole, strict=True)]
            size = [largest(comm, np.abs(w).max(initial=0.0)) for w in whole]
            if any(o > PROPORTIONAL * max(s, 1e-300) for o, s in zip(off, size, strict=True)):
                raise CaseError(
                    f"{who} needs conditions proportional to the step time, such as numbers with the schedule Ramp: "
                    f"the load goes up and down as equilibrium demands, which has no meaning for others."
                )

    def mean_stress(self, forces: Float) -> Float:
        """Return the components of mean stress (n_components,) from the forces on the virtual unknowns (collective)."""
        images = self._model.cloud.images
        assert images is not None
        count = len(images.sizes)
        held = forces[len(self._x) :].ravel()[:count] if images.here else np.zeros(count)
        return np.asarray(total(images.comm, held) / self._per_stress())

    def _per_stress(self) -> Float:
        """Return the force on each virtual unknown per unit mean stress [area]."""
        images = self._model.cloud.images
        assert images is not None
        twice = np.array([1.0 if a == b else 2.0 for a, b in images.cell.components])
        return np.asarray(self.cell_volume * twice / images.sizes)

    def _virtual(self) -> None:
        """Hold the entries of the virtual rows that stand for no component."""
        images = self._model.cloud.images
        if images is not None and images.here:
            self.fixed[len(self._x) :].reshape(-1)[len(images.sizes) :] = True

    def _mean(self, condition: MeanStrain | MeanStress, name: str) -> None:
        images = self._model.cloud.images
        if images is None:
            raise CaseError(f"{name} needs a periodic cell; give the Case a cell.")
        for unknown, value in condition.components(images.cell.components):
            if any(mean.unknown == unknown for mean in self._means):
                a, b = images.cell.components[unknown]
                raise CaseError(
                    f"{name} gives {'xyz'[a]}{'xyz'[b]} of the cell a second time; let it have one condition."
                )
            self._means.append(_Mean(condition, unknown, value))
            if images.here and isinstance(condition, MeanStrain):
                self.fixed[len(self._x) :].reshape(-1)[unknown] = True

    def _add_means(self, values: Float, kind: type[MeanStrain] | type[MeanStress], t: float) -> None:
        images, means = self._model.cloud.images, [mean for mean in self._means if isinstance(mean.condition, kind)]
        if images is None:
            return
        with agreed(self._model.cloud.comm):
            what = f"schedule of a {kind.__name__} condition"
            factors = [float(evaluated(what, mean.condition.schedule, (), t, t)) for mean in means]
        if not images.here:
            return
        per = images.sizes if kind is MeanStrain else self._per_stress()
        virtual = values[len(self._x) :].reshape(-1)
        for mean, factor in zip(means, factors, strict=True):
            virtual[mean.unknown] += per[mean.unknown] * mean.value * factor

    def _prescribe(
        self, condition: Displacement, components: list[tuple[int, Value]], where: GlobalIndex, name: str
    ) -> None:
        cloud = self._model.cloud
        with agreed(cloud.comm):
            for axis, value in components:
                twice = where[self.fixed[where, axis]]
                if len(twice):
                    raise CaseError(
                        f"{name} prescribes {'xyz'[axis]} of {len(twice)} particles a second time "
                        f"(id {cloud.gid[twice[0]]}); let each degree of freedom have one condition."
                    )
                self.fixed[where, axis] = True
                self._prescribed.append(_Applied(condition, axis, value, where, np.ones(len(where))))

    def _stresses(self, traction: Traction, normal: Float, t: float) -> Float:
        """Return the stresses ``t (x) n`` (n_owned, dim, dim) of a consistent traction (not collective)."""
        P = np.zeros((len(self._x), self._model.dim, self._model.dim))
        for axis, value in traction.components(self._model.dim):
            P[:, axis, :] = traction.value(value, self._x, t)[:, None] * normal
        return P

    def _face(self, traction: Traction, normal: Float, where: GlobalIndex, name: str) -> Float:
        """Return the free face of each particle of a traction's region (len(where),) [area]."""
        cloud = self._model.cloud
        if traction.area is not None:
            share = cloud.volume[where] ** ((cloud.dim - 1) / cloud.dim)
            return np.asarray(traction.area * share / float(total(cloud.comm, float(share.sum()))))
        with agreed(cloud.comm):
            try:
                part = self._particles.faces(cloud.comm.rank, cloud.comm.size, normal)
            except CaseError as error:
                raise CaseError(f"{name}: {str(error)[:1].lower()}{str(error)[1:]}") from None
        face = from_parts(cloud, part)[where]
        if not float(total(cloud.comm, float(face.sum()))) > 0.0:
            raise CaseError(
                f"The region of {name} has no free face with normal {np.round(normal, 6).tolist()}; select the outer "
                f"particles of the face, and let the normal point out of the body."
            )
        return np.asarray(face)

    def _share(self, normal: Float, mask: Mask, face: Float, name: str) -> Float:
        """Return what the forces of a uniform stress are multiplied with to be those of a traction (n_owned,) [-].

        Where the weights of the gradient satisfy the divergence theorem that is 1 near the face; else it lets the sum
        be traction times face. A face whose neighbourhood reaches another one is refused: there the forces of the two
        cancel.
        """
        model = self._model
        P = np.tile(np.outer(normal, normal), (len(self._x), 1, 1))
        reached = _reach(model, mask)
        along = model.uniform_stress_force(P)[: len(self._x)] @ normal
        found, wanted = total(model.cloud.comm, [along[reached].sum(), face.sum()])
        if not WHOLE_FACE[0] * wanted <= found <= WHOLE_FACE[1] * wanted:
            raise CaseError(
                f"{name} on a face of {wanted:.4g} adds up to {found:.4g} per unit stress: its region is not the outer "
                f'layer of a face with that normal, or another face is within two horizons; use distribution="layer".'
            )
        factor = float(wanted / found)
        return np.where(reached, 1.0 if abs(factor - 1.0) < EXACT else factor, 0.0)


def select(cloud: Cloud, region: Region, name: str) -> Mask:
    """Return which own particles a region selects; raise on all ranks where it selects none (collective).

    A region may fail on one rank only, and may ask for the smallest of a number over all parts. So it is asked without
    communication first, which records these numbers, and again with the smallest ones where there are any.
    """
    comm, n = cloud.comm, cloud.n_owned
    x, sets = cloud.x[:n], {key: flags[:n] for key, flags in cloud.sets.items()}
    numbers: list[float] = []

    def record(number: float) -> float:
        numbers.append(number)
        return number

    with agreed(comm):
        mask = _mask(region, View(x, sets, record), name)
    counts = comm.allgather(len(numbers))
    if len(set(counts)) > 1:
        raise CaseError(f"The region of {name} asks for the smallest of a number on some ranks only: {region}.")
    if numbers:
        least = iter([smallest(comm, number) for number in numbers])
        with agreed(comm):
            mask = _mask(region, View(x, sets, lambda _: next(least)), name)
    if int(total(cloud.comm, np.count_nonzero(mask))) == 0:
        raise CaseError(f"The region of {name} selects no particle: {region}.")
    return mask


def _mask(region: Region, view: View, name: str) -> Mask:
    """Return the mask of a region, whose own errors are sentences (not collective)."""
    mask = np.asarray(called(f"region of {name}", region.mask, view))
    if mask.shape != (len(view.x),) or mask.dtype != bool:
        raise CaseError(f"The region of {name} must give {(len(view.x),)} bool, not {mask.shape} {mask.dtype}.")
    return mask


def _reach(model: Model, mask: Mask) -> Mask:
    """Return the own particles whose forces depend on a marked own one (collective)."""
    marked = np.zeros(model.cloud.n_local)
    marked[: len(mask)] = mask
    model.cloud.halo.forward(marked)
    return model.reach(marked)


def _cell_volume(cloud: Cloud, thickness: float) -> float:
    if cloud.images is None:
        return 0.0
    cell = cloud.images.cell
    if len(cell.periodic) < cell.dim:
        return float(total(cloud.comm, cloud.volume[: cloud.n_owned].sum()))
    return float(np.prod(cell.lengths)) * (thickness if cell.dim < 3 else 1.0)


def _scale(condition: Force | BodyForce | Traction, cloud: Cloud, where: GlobalIndex) -> Float:
    """Return the factor from declared value to force on each particle (collective)."""
    volume = cloud.volume[where]
    if isinstance(condition, Force):
        return np.asarray(volume / float(total(cloud.comm, volume.sum())))
    return volume
