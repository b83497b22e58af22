"""Forces of families, with the exchange of ghosts hidden behind the work on families without ghosts."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from pdpetsc.arrays import Float, LocalIndex
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.families import Families
from pdpetsc.discrete.halo import Finish

# Adds the forces of the families of some own particles: displacements (n_local, dim), forces (n_local, dim), particles.
Work: TypeAlias = Callable[[Float, Float, LocalIndex], None]


class Overlap:
    """Apply work on families to displacements and gather the forces.

    Half of the families without ghosts are processed while ghosts arrive, the other half while forces on ghosts are
    sent back. Families with ghosts are processed in between.

    Parameters
    ----------
    cloud, families
        Particles of this rank and their bonds.

    Notes
    -----
    Application is collective.
    """

    def __init__(self, cloud: Cloud, families: Families) -> None:
        self._cloud = cloud
        self._with_ghosts = families.with_any(np.arange(cloud.n_local) >= cloud.n_owned)
        if cloud.comm.size == 1:
            # Without communication, one loop is faster.
            self._with_ghosts[:] = True
        self._divide()
        self._u = np.empty((cloud.n_local, cloud.dim))
        self._f = np.empty((cloud.n_local, cloud.dim))

    def _divide(self) -> None:
        inside = np.flatnonzero(~self._with_ghosts).astype(np.int32)
        self._first, self._last = inside[: len(inside) // 2], inside[len(inside) // 2 :]
        self._border = np.flatnonzero(self._with_ghosts).astype(np.int32)

    def couple(self, particles: LocalIndex) -> None:
        """Treat own particles as if they had ghosts in their families: terms couple them with others (not collective).

        Call it before the first application.
        """
        self._with_ghosts[particles] = True
        self._divide()

    def __call__(self, u: Float, work: Work) -> Float:
        """Compute the forces on the unknowns (n_rows, dim) for unknowns ``u``; the next call may overwrite them."""
        v, f = self._u, self._f
        arrived = start_displacements(self._cloud, u, v)
        f[:] = 0.0
        work(v, f, self._first)
        arrived()
        work(v, f, self._border)
        home = start_forces(self._cloud, f)
        work(v, f, self._last)
        return home()


def start_displacements(cloud: Cloud, u: Float, v: Float) -> Finish:
    """Write unknowns (n_rows, dim) to own rows of ``v`` (n_local, dim); return a function that completes the ghosts."""
    n = cloud.n_owned
    v[:n] = u[:n]
    arrived = cloud.halo.start_forward(v)

    def finish() -> None:
        arrived()
        cloud.mirror(v)
        if cloud.images is not None:
            v[n:] += cloud.offset @ cloud.images.strain(u[n:])

    return finish


def start_forces(cloud: Cloud, f: Float) -> Callable[[], Float]:
    """Send forces on ghosts to their owners; return a function that adds them and returns the forces (n_rows, dim).

    ``f`` (n_local, dim) must be complete on ghosts. Own rows may still be added to. It is overwritten.
    """
    n = cloud.n_owned
    virtual = None if cloud.images is None else cloud.images.force(cloud.offset, f[n:])
    cloud.mirror(f)
    home = cloud.halo.start_reverse(f)

    def finish() -> Float:
        home()
        return f[:n] if virtual is None else np.concatenate([f[:n], virtual])

    return finish
