"""Short-range repulsion of particles without a bond."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, Lookup, Mask
from pdpetsc.damage.state import FailingBonds
from pdpetsc.discrete.communicator import (
    agreed,
    anywhere,
    count_nonzero,
    counted_once,
    exchange,
    largest,
    near_ranks,
    total,
)
from pdpetsc.discrete.halo import Halo
from pdpetsc.errors import SolveError
from pdpetsc.gradient.base import StencilMembers
from pdpetsc.gradient.products import PointBlocks, Product
from pdpetsc.problem.body import Body
from pdpetsc.problem.state import State
from pdpetsc.problem.term import Term
from pdpetsc.terms.facet_contact import ContactProduct

# Distance beyond that of contact up to which pairs are listed, in spacings.
SLACK = 0.5
# Particles that come nearer than this share of their distance of contact, and part again, have passed each other.
PASSING = 0.5
# Particles nearer than this share of their distance of contact have no direction from each other.
COINCIDE = 1e-9


@dataclass(frozen=True)
class _Near:
    """Store the pairs that may touch until particles have moved by the slack.

    Attributes
    ----------
    u : (n_owned, dim) float64
        Displacements at the search [length].
    halo : Halo
        Exchange with the particles of other ranks in pairs; their rows follow the own ones.
    local : (n_rows,) int32
        Local particle of each row in the cloud, -1 for none.
    one, other : (n,) int64
        Rows of both particles; the one is an own particle.
    xi : (n, dim) float64
        Their reference bond, from the other to the one [length].
    r0, k : (n,) float64
        Distance of contact [length] and stiffness [force / length].
    bond : (n,) int64
        Bond between them, -1 if they never had one.
    """

    u: Float
    halo: Halo
    local: LocalIndex
    one: GlobalIndex
    other: GlobalIndex
    xi: Float
    r0: Float
    k: Float
    bond: GlobalIndex


class ParticleContactForces(Term):
    """Compute forces ``k (r0 - r)`` between particles without a bond that are nearer than r0.

    Parameters
    ----------
    body : Body
        Particles and bonds.
    mask : (n_owned,) bool
        Own particles that may touch.
    distance : float
        Largest ``r0`` [length].
    stiffness : float
        Force per area and length [stress / length].
    spacing : float
        Mean spacing [length].
    bonds : FailingBonds or None
        Which bonds are intact; None if bonds do not fail.
    title, name : str
        Name of the condition in messages, and prefix of the columns in the history.

    Notes
    -----
    Construction and the methods are collective.
    """

    linear = False
    stiff = True
    energy_of = "contact"
    horizons = 2

    def __init__(
        self, body: Body, mask: Mask, distance: float, stiffness: float, spacing: float, bonds: FailingBonds | None,
        title: str, name: str,
    ) -> None:  # fmt: skip
        self.body, self._title, self._name = body, title, name
        self._rows, self._distance, self._c, self._spacing = np.flatnonzero(mask), distance, stiffness, spacing
        self._bonds = bonds
        cloud, families = body.cloud, body.families
        # Bonds of the own particles by both global ids.
        keys = cloud.gid[families.centres] * cloud.n_global + cloud.gid[families.neighbours]
        self._bond_of = Lookup(keys)
        body.overlap.couple(self._rows.astype(np.int32))
        self._before = np.zeros((cloud.n_owned, body.dim))
        self._near = self._searched(self._before)
        self.pattern = 1

    @property
    def stencils(self) -> tuple[GlobalIndex, LocalIndex]:
        """Return the particles of all pairs that may touch and are known to the rank (not collective)."""
        near = self._near
        members = near.local[np.stack([near.one, near.other], axis=1)]
        members = members[(members >= 0).all(axis=1)]
        return np.arange(0, 2 * len(members) + 1, 2, dtype=np.int64), members.ravel()

    # Pairs are of particles without a common family.
    within_families = False

    def _searched(self, u: Float, further: float = 0.0) -> _Near:
        """Find the pairs that may touch at displacements of the own particles (n_owned, dim), or a little later.

        ``further`` is the distance by which two particles may come nearer [length] (collective).
        """
        cloud, comm, n = self.body.cloud, self.body.cloud.comm, self.body.cloud.n_owned
        reach = self._distance + SLACK * self._spacing + further
        own, y = self._rows, cloud.x[:n] + u
        sent = [own[near] for near in near_ranks(comm, y[own], y[own], reach)]
        sent[comm.rank] = own[:0]
        rows = np.concatenate(sent)
        rank = np.repeat(np.arange(comm.size), [len(one) for one in sent])
        arrays = [rows, cloud.gid[rows], cloud.x[rows], cloud.volume[rows], y[rows]]
        (their_rows, gids, xs, volumes, ys), counts = exchange(comm, rank, arrays)
        owner = np.repeat(np.arange(comm.size), counts)
        halo = Halo(comm, n, owner.astype(np.int32), their_rows.astype(np.int32))
        gid, x = np.concatenate([cloud.gid[:n], gids]), np.concatenate([cloud.x[:n], xs])
        volume, y = np.concatenate([cloud.volume[:n], volumes]), np.concatenate([y, ys])
        rows = np.concatenate([own, n + np.arange(len(gids))])
        pairs = scipy.spatial.cKDTree(y[rows]).query_pairs(reach, output_type="ndarray")
        one, other = rows[pairs[:, 0]], rows[pairs[:, 1]]
        # A pair is computed where its particle of the smaller id is.
        turned = gid[one] > gid[other]
        one, other = np.where(turned, other, one), np.where(turned, one, other)
        kept = one < n
        one, other = one[kept], other[kept]
        order = np.lexsort((gid[other], one))
        one, other = one[order], other[order]
        bond = self._bond_of.of(gid[one] * cloud.n_global + gid[other])
        # Bonds that cannot fail never touch.
        if self._bonds is None:
            one, other, bond = (rows[bond < 0] for rows in (one, other, bond))
        xi = x[one] - x[other]
        r0 = np.minimum(self._distance, np.linalg.norm(xi, axis=1))
        k = self._c * np.sqrt(volume[one] * volume[other]) / self._spacing
        ghosts = Lookup(cloud.gid[n:]).of(gids)
        local = np.concatenate([np.arange(n), np.where(ghosts < 0, -1, n + ghosts)]).astype(np.int32)
        return _Near(u.copy(), halo, local, one, other, xi, r0, k, bond)

    def _renew(self, u: Float) -> bool:
        """Search pairs again if particles have moved too far since the last search; return True then (collective)."""
        moved = largest(self.body.cloud.comm, np.linalg.norm(u - self._near.u, axis=1), initial=0.0)
        if 2.0 * moved <= SLACK * self._spacing:
            return False
        self._near = self._searched(u)
        self.pattern += 1
        self.version += 1
        return True

    def _pressed(self, state: State) -> tuple[GlobalIndex, Float, Float]:
        """Return the pairs that are pressed, their direction (m, dim) and their distance (m,) [length] (collective)."""
        own, near = state.own, self._near

        def make() -> tuple[GlobalIndex, Float, Float]:
            v = near.halo.with_ghosts(own)
            y = near.xi + (v[near.one] - v[near.other])
            r = np.linalg.norm(y, axis=1)
            rows = np.flatnonzero(self._free & (r < near.r0))
            return rows, y[rows] / np.maximum(r[rows], COINCIDE * near.r0[rows])[:, None], r[rows]

        return state.kept((self, "pressed", self.version), make)

    def add_force(self, state: State, f: Float) -> None:
        """Add minus the forces on the particles."""
        rows, e, r = self._pressed(state)
        near = self._near
        force = (near.k[rows] * (near.r0[rows] - r))[:, None] * e
        onto = np.zeros((near.halo.n_owned + near.halo.n_ghost, self.body.dim))
        np.add.at(onto, near.one[rows], -force)
        np.add.at(onto, near.other[rows], force)
        near.halo.reverse(onto)
        f[: near.halo.n_owned] += onto[: near.halo.n_owned]

    def linearise(self, state: State) -> Sequence[Product]:
        """Return ``k (e (x) e - (r0 - r) / r (1 - e (x) e))`` of the pairs that are pressed.

        Raises
        ------
        SolveError
            A pair has a particle of another rank that this one does not know.
        """
        rows, e, r = self._pressed(state)
        near, one = self._near, np.eye(self.body.dim)
        members = near.local[np.stack([near.one[rows], near.other[rows]], axis=1)]
        with agreed(self.body.cloud.comm):
            if (members < 0).any():
                raise SolveError(
                    f"Particles of {self._title} touch that are more than a horizon apart in the undeformed body. Use "
                    "Explicit, or one rank."
                )
        ee = e[:, :, None] * e[:, None, :]
        slack = ((near.r0[rows] - r) / np.maximum(r, COINCIDE * near.r0[rows]))[:, None, None]
        return [self._product(rows, near.k[rows, None, None] * (ee - slack * (one - ee)))]

    def stiffest(self, state: State) -> Sequence[Product]:
        """Return products as if all pairs that are near touched; those with other ranks as if held there."""
        near, dim = self._near, self.body.dim
        free = np.flatnonzero(self._free)
        here = (near.local[near.other[free]] >= 0) & (near.local[near.one[free]] >= 0)
        rows, away = free[here], free[~here]
        blocks = np.zeros((near.halo.n_owned + near.halo.n_ghost, dim, dim))
        for ends in (near.one, near.other):
            np.add.at(blocks, ends[away], 2.0 * near.k[away, None, None] * np.eye(dim))
        near.halo.reverse(blocks)
        return [
            self._product(rows, near.k[rows, None, None] * np.eye(dim)),
            PointBlocks(blocks[: near.halo.n_owned]),
        ]

    def _product(self, rows: GlobalIndex, blocks: Float) -> Product:
        """Return the product of pairs that are known to the rank."""
        near = self._near
        members = near.local[np.stack([near.one[rows], near.other[rows]], axis=1)].ravel()
        ptr = np.arange(0, 2 * len(rows) + 1, 2, dtype=np.int64)
        stencils = StencilMembers(near.one[rows].astype(np.int32), ptr, members)
        return ContactProduct(stencils, self.body.cloud.n_owned, np.tile([1.0, -1.0], len(rows)), blocks)

    @property
    def _free(self) -> Mask:
        """Return which pairs have no bond."""
        return self._without_bond(self._near.bond)

    def _without_bond(self, bond: GlobalIndex) -> Mask:
        free: Mask = bond < 0
        if self._bonds is not None:
            free[~free] = ~self._bonds.intact[bond[~free]]
        return free

    def energy(self, state: State) -> float:
        """Return ``sum k (r0 - r)^2 / 2`` of this rank [energy]."""
        rows, _, r = self._pressed(state)
        return float(0.5 * self._near.k[rows] @ (self._near.r0[rows] - r) ** 2)

    def bonds_changed(self, rebuild: bool) -> None:
        """Note that pairs have lost or regained their bonds."""
        self.version += 1

    def start_from(self, state: State) -> None:
        """Find the pairs near the start of a step."""
        self._before = state.own.copy()
        self._renew(state.own)

    def follow(self, state: State) -> bool:
        """Find the pairs near a state; return False if nothing touches before and after."""
        comm = self.body.cloud.comm
        pressed = len(self._pressed(state)[0])
        if not self._renew(state.own):
            return False
        return anywhere(comm, pressed + len(self._pressed(state)[0]))

    def objection(self, state: State) -> str:
        """Return a reason if particles without a bond have passed each other on their straight ways in the step."""
        comm = self.body.cloud.comm
        change = state.own - self._before
        mean = total(comm, change.sum(axis=0)) / self.body.cloud.n_global
        moved = largest(comm, np.linalg.norm(change - mean, axis=1), initial=0.0)
        if 2.0 * moved <= PASSING * self._distance:
            return ""
        near = self._searched(self._before, 2.0 * moved)
        v = near.halo.with_ghosts(np.concatenate([self._before, change], axis=1))
        start, way = np.split(v[near.one] - v[near.other], 2, axis=1)
        start = near.xi + start
        square = np.maximum((way**2).sum(axis=1), np.finfo(float).tiny)
        at = np.clip(-(start * way).sum(axis=1) / square, 0.0, 1.0)
        least = np.linalg.norm(start + at[:, None] * way, axis=1)
        end = start + way
        gone = (np.linalg.norm(end, axis=1) >= near.r0) | ((start * end).sum(axis=1) < 0.0)
        apart = np.linalg.norm(start, axis=1) >= PASSING * near.r0
        passed = self._without_bond(near.bond) & (least < PASSING * near.r0) & gone & apart
        count = count_nonzero(comm, passed)
        return f"particles of {self._name} passed through each other in one step" if count else ""

    def numbers(self) -> Mapping[str, Callable[[State], float]]:
        """Return the number of pairs that are pressed, and the largest ``r0 - r`` over the spacing."""

        def depth(state: State) -> float:
            rows, _, r = self._pressed(state)
            deepest = largest(self.body.cloud.comm, self._near.r0[rows] - r, initial=0.0)
            return counted_once(self.body.cloud.comm, deepest / self._spacing)

        return {
            f"{self._name}_pairs": lambda state: float(len(self._pressed(state)[0])),
            f"{self._name}_depth": depth,
        }
