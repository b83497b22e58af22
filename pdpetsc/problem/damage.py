"""Damage of the bonds of a body: what happens to them, and who follows."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.damage.state import FailingBonds
from pdpetsc.discrete.communicator import total
from pdpetsc.kernels.bonds import bond_force_kernel
from pdpetsc.problem.body import Body
from pdpetsc.problem.state import State


class Damage:
    """The bonds of a body that can fail.

    Parameters
    ----------
    body : Body
        Whose bonds they are.
    bonds : FailingBonds
        Their state.
    finite : bool
        Whether elongations are those of the current length, or along the first direction of a bond.

    Attributes
    ----------
    version, breaks : int
        Grow whenever the integrity of a bond changes; and whenever bonds break or mend.
    followers : list of callable
        Called with whether bonds have broken or mended, whenever the integrity has changed (collective).
    torn : callable or None
        Gives the tensile strain on every bond (n_bonds,) [-] at a state, by which bonds break besides their stretch.

    Notes
    -----
    Every method is collective but where it says otherwise.
    """

    def __init__(self, body: Body, bonds: FailingBonds, finite: bool) -> None:
        self.body = body
        self.bonds = bonds
        self.finite = finite
        self.version = 0
        self.breaks = 0
        self.followers: list[Callable[[bool], None]] = []
        self.torn: Callable[[State], Float] | None = None

    @property
    def softens(self) -> bool:
        """Return whether bonds lose their force gradually (not collective)."""
        return self.bonds.law.final > self.bonds.law.onset

    @property
    def heals(self) -> bool:
        """Return whether bonds that have not broken may regain force (not collective)."""
        return self.bonds.law.effect.heals

    def elongation(self, state: State) -> Float:
        """Return the elongation of every bond (n_bonds,) [length]."""
        return state.elongated(self.finite)[0]

    def at(self, state: State) -> tuple[Float, Float]:
        """Return integrity (n_bonds,) [-] and its derivative by the elongation [1 / length]."""
        e = self.elongation(state)
        return state.kept(("integrity", self.version, self.bonds.frozen), lambda: self.bonds.at(e))

    def freeze(self, frozen: bool) -> None:
        """Let damage stay, or follow the displacement (not collective)."""
        if self.bonds.frozen != frozen:
            self.bonds.frozen = frozen
            self.version += 1

    def commit(self, state: State) -> None:
        """Take the damage at a converged state for good."""
        self.soften(state)
        self.bonds.commit()

    def revert(self) -> None:
        """Take back what failed since the last ``commit``."""
        intact = self.bonds.intact
        self.bonds.revert()
        mended = int(np.any(intact != self.bonds.intact))
        self.changed(rebuild=int(total(self.body.cloud.comm, mended)) > 0)

    def break_bonds(self, state: State, most: int | None = None) -> int:
        """Break bonds past their final stretch, about ``most`` at once, the worst first; return how many pairs.

        Where none is, bonds on which the strain of a gradient is past it break, if the material says so (``torn``).
        """
        broken = self.bonds.break_bonds(self.elongation(state), most)
        if not broken and self.torn is not None and self.bonds.law.effect.tears:
            broken = self.bonds.tear(self.torn(state), most)
        if broken:
            self.changed(rebuild=True)
        return broken

    def fading(self, state: State) -> float:
        """Return by how much the integrity of a bond would change at most [-]."""
        return self.bonds.fading(self.elongation(state))

    def soften(self, state: State) -> float:
        """Take the damage at a state for good; return the largest change of an integrity [-]."""
        change = self.bonds.soften(self.elongation(state))
        if change > 0.0:
            self.changed(rebuild=False)
        return change

    def kept(self) -> tuple[Float, Float]:
        """Return a copy of the state of the bonds, integrity and largest stretch, for ``take`` (not collective)."""
        return self.bonds.integrity.copy(), self.bonds.worst.copy()

    def take(self, kept: tuple[Float, Float]) -> None:
        """Go back to a state of the bonds in which the same ones are broken."""
        self.bonds.integrity[:], self.bonds.worst[:] = kept
        self.changed(rebuild=False)

    def restored(self) -> None:
        """Follow the state of the bonds, set from outside, and keep it."""
        self.bonds.commit()
        self.changed(rebuild=True)

    def changed(self, rebuild: bool) -> None:
        """Let everybody follow a change of the integrity of bonds, and of which are broken where ``rebuild``."""
        for follow in self.followers:
            follow(rebuild)
        self.version += 1
        self.breaks += rebuild

    def most_stretched(self, state: State, band: float) -> tuple[Float, float]:
        """Return how the largest stretch over the critical one grows with the unknowns, and that stretch.

        Returns
        -------
        gradient : (n_rows, dim) float64
            Of the mean over the bonds that have not failed and are within ``band`` of the largest, relatively
            [1 / length]; zero where none is stretched.
        largest : float
            [-]
        """
        body, family, u_local = self.body, self.body.families, state.u_local
        f = np.zeros_like(u_local)
        weights, found = self.bonds.most_stretched(self.elongation(state), band)
        kernel = bond_force_kernel(body.dim, int(self.finite))
        kernel(family.indptr, family.neighbours, body.cloud.x, u_local, weights, f)
        return body.gather(f), found

    def lost_bonds(self) -> Float:
        """Return ``1 - sum_j mu V_j / sum_j V_j`` (n_owned,) [-], mu 0 for broken bonds, else 1 (not collective)."""
        return self._lost(np.where(self.bonds.intact, 1.0, 0.0))

    def lost_volume(self) -> Float:
        """Return ``1 - sum_j T V_j / sum_j V_j`` (n_owned,) [-] with the integrity T of the bonds (not collective)."""
        return self._lost(self.bonds.integrity)

    def _lost(self, left: Float) -> Float:
        cloud, families = self.body.cloud, self.body.families
        centres, volume = families.centres, cloud.volume[families.neighbours]
        whole = np.bincount(centres, volume, cloud.n_owned)
        kept = np.bincount(centres, left * volume, cloud.n_owned)
        return np.asarray(1.0 - kept / np.where(whole > 0.0, whole, 1.0))
