"""Conditions applied to a model: prescribed displacements and external forces at a step time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, Mask
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.communicator import agreed, smallest, total
from pdpetsc.errors import CaseError
from pdpetsc.model import Model
from pdpetsc.scene.conditions import BodyForce, Condition, Displacement, Force, Traction, Value
from pdpetsc.scene.region import Region, View

# A consistent traction that adds up to less than this share of traction times face is not that of one face.
WHOLE_FACE = 0.5


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


class Loading:
    """Prescribed displacements and external forces of a case on this rank.

    Parameters
    ----------
    model : Model
        The body.
    conditions : sequence of Condition
        Declared conditions.
    thickness : float
        Out-of-plane thickness [length] or cross-section [length^2] contained in the volumes.

    Attributes
    ----------
    fixed : (n_owned, dim) bool
        Prescribed degrees of freedom.

    Raises
    ------
    CaseError
        A region selects nothing, a degree of freedom is prescribed twice, or a component is wrong.

    Notes
    -----
    Construction, ``forces`` and ``select`` are collective; ``prescribed`` is not.
    """

    def __init__(self, model: Model, conditions: Sequence[Condition], thickness: float) -> None:
        self._model = model
        self._x = model.cloud.x[: model.cloud.n_owned]
        self.fixed: Mask = np.zeros((model.cloud.n_owned, model.dim), dtype=bool)
        self._prescribed: list[_Applied] = []
        self._forces: list[_Applied] = []
        self._consistent: list[tuple[Traction, Float, Mask]] = []
        for number, condition in enumerate(conditions):
            name = f"{type(condition).__name__} condition {number + 1}"
            mask = select(model.cloud, condition.region, name)
            with agreed(model.cloud.comm):
                components = condition.components(model.dim)
                normal = condition.unit_normal(model.dim) if isinstance(condition, Traction) else None
            where = np.flatnonzero(mask)
            if isinstance(condition, Displacement):
                self._prescribe(condition, components, where, name)
            elif isinstance(condition, Traction) and condition.distribution == "consistent":
                assert normal is not None
                self._consistent.append((condition, normal, _reach(model, mask)))
                self._check_face(condition, normal, where, thickness, name)
            else:
                scale = _scale(condition, model.cloud, where, thickness)
                self._forces += [_Applied(condition, axis, value, where, scale) for axis, value in components]

    def prescribed(self, t: float) -> Float:
        """Return the prescribed displacements at step time ``t`` (n_owned, dim) [length], 0 where free."""
        u = np.zeros(self.fixed.shape)
        for applied in self._prescribed:
            u[applied.where, applied.axis] = applied.at(self._x, t)
        return u

    def forces(self, t: float) -> Float:
        """Return the external forces at step time ``t`` (n_owned, dim) [force] (collective)."""
        f = np.zeros(self.fixed.shape)
        for applied in self._forces:
            f[applied.where, applied.axis] += applied.at(self._x, t)
        for traction, normal, reached in self._consistent:
            f += self._consistent_forces(traction, normal, t) * reached[:, None]
        return f

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

    def _consistent_forces(self, traction: Traction, normal: Float, t: float) -> Float:
        model = self._model
        owner = model.operator.owner
        P = np.zeros((len(owner), model.dim, model.dim))
        for axis, value in traction.components(model.dim):
            P[:, axis, :] = traction.value(value, self._x[owner], t)[:, None] * normal
        return model.weighted_divergence(P)

    def _check_face(self, traction: Traction, normal: Float, where: GlobalIndex, thickness: float, name: str) -> None:
        """Refuse a face whose neighbourhood reaches another one: there the forces of the two cancel."""
        model = self._model
        P = np.broadcast_to(np.outer(normal, normal), (model.operator.n_points, model.dim, model.dim))
        reached = _reach(model, np.isin(np.arange(len(self._x)), where))
        along = model.weighted_divergence(np.ascontiguousarray(P)) @ normal
        face = _faces(model.cloud, where, thickness)
        found, wanted = total(model.cloud.comm, [along[reached].sum(), face.sum()])
        if found < WHOLE_FACE * wanted:
            raise CaseError(
                f"{name} on a face of {wanted:.4g} adds up to {found:.4g} per unit stress: its region is not the outer "
                f'layer of a face with that normal, or another face is within two horizons; use distribution="layer".'
            )


def select(cloud: Cloud, region: Region, name: str) -> Mask:
    """Return which own particles a region selects; raise on all ranks where it selects none (collective)."""
    n = cloud.n_owned
    view = View(cloud.x[:n], {key: flags[:n] for key, flags in cloud.sets.items()}, lambda v: smallest(cloud.comm, v))
    mask = region.mask(view)
    if int(total(cloud.comm, np.count_nonzero(mask))) == 0:
        raise CaseError(f"The region of {name} selects no particle: {region}.")
    return mask


def _reach(model: Model, mask: Mask) -> Mask:
    """Return the own particles that share a gradient point with a marked one (collective)."""
    marked = model.with_ghosts(np.repeat(mask[:, None], model.dim, axis=1).astype(float))[:, 0].copy()
    operator, n = model.operator, model.cloud.n_local
    point_of = np.repeat(np.arange(operator.n_points), np.diff(operator.point_ptr))
    touched = np.bincount(point_of, marked[operator.members], operator.n_points) > 0.0
    reached = np.bincount(operator.members, touched[point_of].astype(float), n)
    model.cloud.halo.reverse(reached)
    return np.asarray(reached[: model.cloud.n_owned] > 0.0)


def _faces(cloud: Cloud, where: GlobalIndex, thickness: float) -> Float:
    """Return the face of each particle, ``(V / thickness)^((dim - 1) / dim)`` times the thickness [area]."""
    volume, dim = cloud.volume[where], cloud.dim
    if dim == 1:
        return np.full(len(where), thickness)
    depth = thickness if dim == 2 else 1.0
    return np.asarray((volume / depth) ** ((dim - 1) / dim) * depth)


def _scale(condition: Force | BodyForce | Traction, cloud: Cloud, where: GlobalIndex, thickness: float) -> Float:
    """Return the factor from declared value to force on each particle."""
    if isinstance(condition, Traction):
        return _faces(cloud, where, thickness)
    volume = cloud.volume[where]
    if isinstance(condition, Force):
        return np.asarray(volume / float(total(cloud.comm, volume.sum())))
    return volume
