"""Dead loads: external forces that do not depend on the displacement."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, Mask
from pdpetsc.declare.conditions import BodyForce, Force, MeanStress, Traction, Value, evaluated
from pdpetsc.declare.particles import Particles
from pdpetsc.discrete.cloud import from_parts
from pdpetsc.discrete.communicator import agreed, anywhere, total
from pdpetsc.discrete.surface import ON_MIRROR
from pdpetsc.errors import CaseError
from pdpetsc.problem.body import Body
from pdpetsc.problem.cell import CellRows
from pdpetsc.problem.material_term import MaterialTerm
from pdpetsc.terms.prescribed_loads import PrescribedLoads

# Range of the resultant of a consistent traction over traction times area; outside, the region is not one whole face.
WHOLE_FACE = (0.5, 2.0)
# A share within this distance of 1 is 1 up to round-off.
EXACT = 1e-9


@dataclass(frozen=True)
class _Applied:
    """Store one component of a load on the particles ``where``, times ``scale`` (len(where),)."""

    condition: Force | BodyForce | Traction
    axis: int
    value: Value
    where: GlobalIndex
    scale: Float

    def at(self, x: Float, t: float) -> Float:
        return self.scale * self.condition.value(self.value, x[self.where], t)


@dataclass(frozen=True)
class _Consistent:
    """Store a consistent traction, with the factor on its uniform-stress forces for each particle (n_owned,)."""

    traction: Traction
    normal: Float
    share: Float


class DeadLoads(PrescribedLoads):
    """Compute the external forces of a case on this rank.

    Parameters
    ----------
    body : Body
        Particles and bonds.
    matter : Matter
        Term of the material, which computes the forces that balance a uniform stress.
    particles : Particles
        Declared particles, which define the areas of free faces.
    cell : CellRows, optional
        Virtual unknowns of a periodic cell.

    Notes
    -----
    Construction and every method are collective.
    """

    def __init__(
        self, body: Body, material_term: MaterialTerm, particles: Particles, cell: CellRows | None = None
    ) -> None:
        super().__init__(body)
        self._material_term = material_term
        self._particles = particles
        self._cell = cell
        self._x = body.cloud.x[: body.cloud.n_owned]
        self._forces: list[_Applied] = []
        self._consistent: list[_Consistent] = []
        self._stresses: list[tuple[MeanStress, int, float]] = []

    def _evaluated(self, t: float) -> Float:
        f = self._sum(self._forces, self._consistent, t)
        with agreed(self.body.cloud.comm):
            what = "schedule of a MeanStress condition"
            factors = [float(evaluated(what, stress.schedule, (), t, t)) for stress, _, _ in self._stresses]
        if self._cell is not None and self._cell.here:
            for (_, unknown, value), factor in zip(self._stresses, factors, strict=True):
                self._cell.rows(f)[unknown] += self._cell.per_stress[unknown] * value * factor
        return f

    def add_total(
        self, condition: Force, components: Sequence[tuple[int, Value]], where: GlobalIndex, name: str
    ) -> None:
        """Add a total force, distributed over some own particles by volume."""
        volume = self.body.cloud.volume[where]
        share = np.asarray(volume / float(total(self.body.cloud.comm, volume.sum())))
        self._add([_Applied(condition, axis, value, where, share) for axis, value in components], [], name)

    def add_per_volume(
        self, condition: BodyForce, components: Sequence[tuple[int, Value]], where: GlobalIndex, name: str
    ) -> None:
        """Add a force per volume on some own particles."""
        volume = self.body.cloud.volume[where]
        self._add([_Applied(condition, axis, value, where, volume) for axis, value in components], [], name)

    def add_traction(
        self, condition: Traction, components: Sequence[tuple[int, Value]], mask: Mask, normal: Float, name: str
    ) -> None:
        """Add a traction on the face whose outer particles are marked in a mask (n_owned,).

        Raises
        ------
        CaseError
            The area of the face is unknown, or the region is not one face.
        """
        where = np.flatnonzero(mask)
        face = self._face(condition, normal, where, name)
        if condition.distribution == "consistent":
            share = self._share(normal, mask, face, name)
            self._add([], [_Consistent(condition, normal, share)], name)
        else:
            self._add([_Applied(condition, axis, value, where, face) for axis, value in components], [], name)

    def add_stress(self, condition: MeanStress, components: Sequence[tuple[int, float]]) -> None:
        """Add components of the mean stress of the cell."""
        self._stresses += [(condition, unknown, value) for unknown, value in components]
        self._changed()

    def _add(self, forces: Sequence[_Applied], consistent: Sequence[_Consistent], name: str) -> None:
        """Store a load and record its resultant."""
        self._forces += forces
        self._consistent += consistent
        self._note(name, lambda t: self._sum(forces, consistent, t))

    def _sum(self, forces: Sequence[_Applied], consistent: Sequence[_Consistent], t: float) -> Float:
        """Return the sum of loads at load parameter ``t`` (n_rows, dim) [force]."""
        f = np.zeros((self.body.cloud.n_rows, self.body.dim))
        with agreed(self.body.cloud.comm):
            for applied in forces:
                f[applied.where, applied.axis] += applied.at(self._x, t)
            stresses = [self._uniform(part, t) for part in consistent]
        n = len(self._x)
        for P, part in zip(stresses, consistent, strict=True):
            f[:n] += self._material_term.uniform_stress_force(P)[:n] * part.share[:, None]
        return f

    def _uniform(self, part: _Consistent, t: float) -> Float:
        """Compute the stresses ``t (x) n`` (n_owned, dim, dim) of a consistent traction (not collective)."""
        P = np.zeros((len(self._x), self.body.dim, self.body.dim))
        for axis, value in part.traction.components(self.body.dim):
            P[:, axis, :] = part.traction.value(value, self._x, t)[:, None] * part.normal
        return P

    def _face(self, traction: Traction, normal: Float, where: GlobalIndex, name: str) -> Float:
        """Return the free area of each particle in the region of a traction (len(where),) [area]."""
        cloud = self.body.cloud
        if traction.area is not None:
            share = cloud.volume[where] ** ((cloud.dim - 1) / cloud.dim)
            return np.asarray(traction.area * share / float(total(cloud.comm, float(share.sum()))))
        with agreed(cloud.comm):
            try:
                whole = self._particles.faces(cloud.comm.rank, cloud.comm.size, normal)
                part = whole - self._on_mirrors(normal, len(whole))
                part[part <= ON_MIRROR * whole] = 0.0
            except CaseError as error:
                raise CaseError(f"{name}: {str(error)[:1].lower()}{str(error)[1:]}") from None
        face = from_parts(cloud, part)[where]
        if not float(total(cloud.comm, float(face.sum()))) > 0.0:
            raise CaseError(
                f"The region of {name} has no free face with normal {np.round(normal, 6).tolist()}; select the outer "
                f"particles of the face, and let the normal point out of the body."
            )
        return np.asarray(face)

    def _on_mirrors(self, normal: Float, count: int) -> Float:
        """Compute the part of the free faces of created particles that lies on mirror planes (count,) [area]."""
        cloud = self.body.cloud
        found = np.zeros(count)
        if cloud.places.planes:
            x, area, particle, _ = self._particles.surface(cloud.comm.rank, cloud.comm.size).arrays
            on = np.zeros(len(x), dtype=bool)
            for axis, at in cloud.places.planes.items():
                across = np.abs(area[:, axis]) >= (1.0 - ON_MIRROR) * np.linalg.norm(area, axis=1)
                on |= across & (np.abs(x[:, axis] - at) <= ON_MIRROR * cloud.horizon)
            np.add.at(found, particle[on], np.maximum(area[on] @ normal, 0.0))
        return found

    def _share(self, normal: Float, mask: Mask, face: Float, name: str) -> Float:
        """Compute the factor between the forces of a uniform stress and those of a traction (n_owned,) [-].

        If the gradient weights satisfy the divergence theorem, the factor is 1 near the face. Otherwise the factor
        makes the resultant equal to traction times area. A face whose neighbourhood reaches another face is refused:
        the forces of both would cancel.
        """
        P = np.tile(np.outer(normal, normal), (len(self._x), 1, 1))
        reached = self._reach(mask)
        self._refuse_mirrored(normal, reached, name)
        along = self._material_term.uniform_stress_force(P)[: len(self._x)] @ normal
        found, wanted = total(self.body.cloud.comm, [along[reached].sum(), face.sum()])
        if not WHOLE_FACE[0] * wanted <= found <= WHOLE_FACE[1] * wanted:
            raise CaseError(
                f"{name} on a face of {wanted:.4g} adds up to {found:.4g} per unit stress: its region is not the outer "
                f'layer of a face with that normal, or another face is within two horizons; use distribution="layer".'
            )
        factor = float(wanted / found)
        return np.where(reached, 1.0 if abs(factor - 1.0) < EXACT else factor, 0.0)

    def _refuse_mirrored(self, normal: Float, reached: Mask, name: str) -> None:
        """Raise on all ranks if a mirror plane puts another face, with another stress, within reach (collective)."""
        cloud = self.body.cloud
        turned = np.zeros(cloud.n_local)
        if len(cloud.sign):
            turned[cloud.n_owned :] = (np.abs(cloud.sign * normal - normal) > ON_MIRROR).any(axis=1)
        cloud.halo.reverse(turned)
        beside = reached & (turned[: cloud.n_owned] > 0.0)
        if anywhere(cloud.comm, beside):
            raise CaseError(
                f"{name} is consistent, and its face within three horizons of its own image behind a mirror plane; use "
                f'distribution="layer" or "surface", or the whole body.'
            )

    def _reach(self, mask: Mask) -> Mask:
        """Return the own particles whose forces depend on a marked own particle."""
        return self._material_term.dependents(self.body.cloud.halo.with_ghosts(mask.astype(float)))
