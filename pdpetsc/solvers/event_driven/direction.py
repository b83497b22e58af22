"""Direction of the equilibrium path after bonds fail: dense algebra on the changed bonds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pdpetsc.arrays import Float
from pdpetsc.damage.laws import reached
from pdpetsc.errors import SolveError

# A rate below this share of the largest one counts as zero.
NONE = 1e-11
# Number of tried combinations of failing and unloading bonds, per bond that can be either.
TRIED = 4


class Changed:
    """Store the bonds whose stiffness differs from the factored matrix, identical on every rank.

    Attributes
    ----------
    failing : list of int
        Bonds that are losing force, in the order of their onset.
    S : (n, n) float64
        Elongations under unit tensions of the bonds in the factored body [length / force].
    E : (n,) float64
        Elongations under the whole load in the factored body [length].
    k, base : (n,) float64
        Elastic stiffness, and stiffness in the factored matrix [force / length].
    limit, elongation : (n,) float64
        Elongations of first failure, and current ones [length].
    softness : (n,) float64
        Change of elongation per change of force of failing bonds, at most 0 [length / force].
    phi : (n,) float64
        Ratio of current to elastic force [-].
    """

    def __init__(self) -> None:
        self.failing: list[int] = []
        self.S: Float = np.zeros((0, 0))
        self.E = self.k = self.base = self.limit = self.elongation = self.softness = self.phi = np.zeros(0)

    @property
    def reach(self) -> Float:
        """Return the elongations of further failure (n,) [length]; ``r - 1`` of a law is ``-softness k``."""
        return self.limit * reached(self.phi, 1.0 - self.softness * self.k)

    @property
    def force(self) -> Float:
        """Return the tensions (n,) [force]."""
        return self.phi * self.k * self.elongation

    def append(self, row: Float, E: float, k: float, limit: float, phi: float, softness: float) -> int:
        """Append a bond with the stiffness of the factored matrix; return its number.

        Parameters
        ----------
        row : (n + 1,) float64
            Row of the bond in ``S``.
        """
        n = len(self.E)
        self.S = np.pad(self.S, (0, 1))
        self.S[n], self.S[:, n] = row, row
        new = {"E": E, "k": k, "base": phi * k, "limit": limit, "elongation": 0.0, "softness": softness, "phi": phi}
        for name, value in new.items():
            setattr(self, name, np.append(getattr(self, name), value))
        return n


@dataclass(frozen=True)
class Direction:
    """Store a direction of the path.

    Attributes
    ----------
    rate : float
        Rate of the load parameter along it [-].
    p : (r,) float64
        Inelastic forces of the changed bonds [force].
    force, elongation : (r,) float64
        Rates of tension [force] and elongation [length] of the changed bonds.
    failing : list of int
        Bonds that continue to fail; other bonds at their limit unload.
    """

    rate: float
    p: Float
    force: Float
    elongation: Float
    failing: list[int]


def find_direction(bonds: Changed, waiting: list[int]) -> Direction:
    """Find the direction in which every bond at its limit either loses force or shortens.

    Without failing bonds the load grows. Otherwise the bond that began to fail last loses force at a fixed rate, and
    the load follows. Bonds whose mode, failing or unloading, contradicts the direction switch it. First all switch at
    once, beginning with all failing bonds failing further. Then they switch one by one, beginning with the last bond
    alone and with all of them. If no direction is consistent, another failing bond gets the fixed rate.

    Parameters
    ----------
    bonds : Changed
        The changed bonds.
    waiting : list of int
        Bonds at their limit that are not failing.

    Raises
    ------
    SolveError
        No such direction was found.
    """
    if not bonds.failing:
        return _along(bonds, [])
    for pace in reversed(bonds.failing):
        others = [m for m in [*bonds.failing, *waiting] if m != pace]
        failing_first = set(waiting) - {pace}
        for out, at_once in ((failing_first, True), (set(others), False), (failing_first, False)):
            found = _complementary(bonds, others, out, pace, at_once)
            if found is not None:
                return found
    raise SolveError(
        f"no direction lets the forces of {len(bonds.failing)} failing bonds decrease; perturb the positions, so that "
        f"fewer bonds fail at once"
    )


def _complementary(bonds: Changed, others: list[int], out: set[int], pace: int, at_once: bool) -> Direction | None:
    """Switch bonds between failing and unloading until each is in its mode; None if the search cycles.

    Parameters
    ----------
    others : list of int
        Bonds at their limit besides the bond with the fixed rate.
    out : set of int
        Bonds of these that unload initially.
    at_once : bool
        Whether all bonds in a wrong mode switch at once, or the worst one.
    """
    seen: set[frozenset[int]] = set()
    while frozenset(out) not in seen and len(seen) <= TRIED * (len(others) + 1):
        seen.add(frozenset(out))
        found = _along(bonds, [*(m for m in others if m not in out), pace])
        size = NONE * float(np.abs(bonds.E * found.rate).max(initial=0.0))
        wrong = [m for m in others if (found.elongation[m] > size if m in out else found.force[m] >= 0.0)]
        if not wrong:
            return found
        out = out ^ (set(wrong) if at_once else {_worst(bonds, found, wrong, out)})
    return None


def _worst(bonds: Changed, found: Direction, wrong: list[int], out: set[int]) -> int:
    """Return the bond with the largest elongation or gain of force relative to its limit."""
    excess = [
        found.elongation[m] / bonds.limit[m] if m in out else found.force[m] / (bonds.k[m] * bonds.limit[m])
        for m in wrong
    ]
    return wrong[int(np.argmax(excess))]


def _along(bonds: Changed, failing: list[int]) -> Direction:
    """Compute the direction in which ``failing`` lose force and all others keep their secant stiffness."""
    change = bonds.phi * bonds.k - bonds.base
    change[failing] = 0.0
    elastic = np.flatnonzero(change)
    c = bonds.softness[failing]
    factor = 1.0 - bonds.base[failing] * c
    numbers: NDArray[np.int64] = np.concatenate([elastic, np.array(failing, dtype=np.int64)])
    M = bonds.S[numbers[:, None], numbers]
    M.flat[:: len(M) + 1] += np.concatenate([1.0 / change[elastic], c / factor])
    g = bonds.E[numbers]
    p = np.zeros_like(bonds.E)
    if failing:
        last = -bonds.k[failing[-1]] * bonds.limit[failing[-1]] * factor[-1]
        right = -last * M[:, -1]
        M[:, -1] = -g
        found = _solve(M, right)
        p[numbers] = np.append(found[:-1], last)
        rate = float(found[-1])
    else:
        p[numbers] = _solve(M, g)
        rate = 1.0
    elongation = rate * bonds.E - bonds.S @ p
    force = bonds.phi * bonds.k * elongation
    force[failing] = p[failing] / factor
    return Direction(rate, p, force, elongation, list(failing))


def _solve(M: Float, g: Float) -> Float:
    """Solve a small system; return the least-squares solution if it is singular."""
    try:
        return np.asarray(np.linalg.solve(M, g))
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.lstsq(M, g, rcond=None)[0])
