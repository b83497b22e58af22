"""The method of inelastic forces: a factored matrix serves a body of which some bonds have changed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from petsc4py import PETSc

from pdpetsc.arrays import Float
from pdpetsc.discrete.communicator import total
from pdpetsc.errors import SolveError
from pdpetsc.loading import Loading
from pdpetsc.model import Assembler, BondModel, Model
from pdpetsc.solve.matrix import TangentMatrix
from pdpetsc.solve.pairs import Pairs


@dataclass
class Member:
    """A bond whose stiffness is no longer that of the factored matrix.

    Attributes
    ----------
    key : tuple of int
        Its name on every rank.
    pair : int
        Its number here, -1 where it is not.
    base : float
        Its stiffness in the factored matrix [force / length].
    """

    key: tuple[int, int, int]
    pair: int
    base: float


class InelasticForces:
    """Solves ``K u = rate f`` for K that differs from the factored ``K0`` by the stiffness of a few bonds.

    Bond ``b`` with direction vector ``b`` (elongation ``e = b . u``) has the inelastic force ``p``, what its tension
    differs by from ``k0 e``: ``K0 u + sum_b p_b b_b = rate f``. With ``w_b = K0^-1 b_b`` and ``S_cb = b_c . w_b``,
    which need one solve per changed bond, all elongations follow from ``p``.

    Parameters
    ----------
    model, loading, assembler
        The linear body and its conditions, proportional to the step time.
    pairs : Pairs or None
        Its bonds where they can fail.
    scale : float
        Diagonal of prescribed rows [force / length].

    References
    ----------
    Jirasek, Bazant (1994), section 4.2.

    Notes
    -----
    Construction and every method are collective. Call ``destroy`` before MPI ends.
    """

    def __init__(self, model: Model, loading: Loading, assembler: Assembler, pairs: Pairs | None, scale: float) -> None:
        self._model = model
        self._pairs = pairs
        self._free = ~loading.fixed
        self._prescribed = loading.prescribed(1.0)
        self._external = loading.forces(1.0)
        self.matrix = TangentMatrix(assembler, loading.fixed, scale)
        self._x = self.matrix.mat.createVecRight()
        self._b = self._x.duplicate()
        self.ksp = PETSc.KSP().create(comm=model.cloud.comm)
        self.ksp.setOperators(self.matrix.mat)
        self.ksp.setFromOptions()
        self.members: list[Member] = []
        self._place: dict[tuple[int, int, int], int] = {}
        self._w = np.empty((0, *loading.fixed.shape))
        self.S = np.empty((0, 0))
        self.E = np.empty(0)
        self.elastic: Float = np.zeros(loading.fixed.shape)

    def factor(self) -> None:
        """Factor the present stiffness; no bond differs from it then."""
        zero = np.zeros(self._free.shape)
        self.matrix.update(zero)
        self.members, self._place = [], {}
        self.S, self.E = np.empty((0, 0)), np.empty(0)
        load = self._external - self._model.tangent_times(zero, self._prescribed)
        self.elastic = self._solve(load) + self._prescribed
        self._elongated = self._elongation(self.elastic)

    def place(self, key: tuple[int, int, int], base: float) -> int:
        """Return the number of a bond among the changed ones, taking it in with one solve where it is new.

        Parameters
        ----------
        key : tuple of int
            The bond.
        base : float
            Its stiffness in the factored matrix [force / length].
        """
        if key in self._place:
            return self._place[key]
        model, pairs = self._model, self._pairs
        assert isinstance(model, BondModel) and pairs is not None
        pair = pairs.local(key)
        tension = np.zeros(len(pairs.of_bond))
        if pair >= 0 and pairs.reported[pair]:
            tension[pairs.bond[pair]] = 1.0
        w = self._solve(model.gather(model.bond_forces(np.zeros_like(model.cloud.x), tension)))
        self.members.append(Member(key, pair, base))
        r = len(self.members)
        self._place[key] = r - 1
        mine = [m for m, member in enumerate(self.members) if member.pair >= 0 and pairs.reported[member.pair]]
        bonds = pairs.bond[[self.members[m].pair for m in mine]]
        values = np.zeros(r + 1)
        values[mine] = self._elongation(w)[bonds]
        if r - 1 in mine:
            values[r] = self._elongated[bonds[-1]]
        values = total(model.cloud.comm, values)
        grown = np.empty((r, r))
        grown[: r - 1, : r - 1] = self.S
        grown[r - 1, :] = grown[:, r - 1] = values[:r]
        self.S = grown
        self.E = np.append(self.E, values[r])
        if len(self._w) < r:
            self._w = np.concatenate([self._w, np.empty((max(r, 16), *w.shape))])
        self._w[r - 1] = w
        return r - 1

    def response(self, rate: float, chosen: list[int], p: Float) -> Float:
        """Return ``u = rate u_elastic - sum_b p_b w_b`` (n_rows, dim) for the changed bonds ``chosen``."""
        u = rate * self.elastic
        if chosen:
            u = u - np.tensordot(p, self._w[chosen], axes=1)
        return u

    def destroy(self) -> None:
        """Free the PETSc objects, in order."""
        self.ksp.destroy()
        self._b.destroy()
        self._x.destroy()
        self.matrix.destroy()

    def _solve(self, load: Float) -> Float:
        self._b.array = np.where(self._free, load, 0.0).ravel()
        self.ksp.solve(self._b, self._x)
        u: Float = np.where(self._free, self._x.array.reshape(self._free.shape), 0.0)
        finite = int(total(self._model.cloud.comm, int(not np.isfinite(u).all()))) == 0
        if self.ksp.getConvergedReason() < 0 or not finite:
            raise SolveError(
                "The linear solver failed: a piece of the body has come free, or choose a direct one with "
                "-pc_type cholesky."
            )
        return u

    def _elongation(self, u: Float) -> Float:
        """Return the elongation of every bond (n_bonds,), none where bonds do not fail."""
        model = self._model
        if self._pairs is None or not isinstance(model, BondModel):
            return np.empty(0)
        return model.elongation(model.with_ghosts(u))[0]
