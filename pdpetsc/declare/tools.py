"""Rigid tools by their signed distance, moved and turned by schedules, and their contact with a body."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.declare.conditions import Condition
from pdpetsc.declare.motion import ROTATIONS, RigidMotion
from pdpetsc.declare.region import Region
from pdpetsc.declared import Finite, Fraction, NonNegative, NonNegativeOrInfinite, Positive
from pdpetsc.errors import CaseError

# Components of a direction below this share of its length are rounding.
ACROSS = 1e-12


@dataclass(frozen=True)
class RigidTool(RigidMotion, ABC):
    """A rigid surface with a signed distance; derive from it for another shape.

    Parameters
    ----------
    move, turn, about, force, moment, follows, schedule
        Its motion, as for ``RigidMotion``.
    mass, inertia
        Its mass and moments of inertia in a motion, as for ``RigidMotion``; ``about`` is its centre of mass.
    velocity : sequence of float, optional
        Initial velocity of the directions with a force (dim,) [length / time]; 0 by default.
    spin : float or sequence of float, optional
        Initial angular velocity of a tool with a moment, as ``turn`` [rad / time]; 0 by default.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> dropped = pd.RigidSphere((0.0, 5.0), 1.0, force=(0.0, -9.81), mass=1.0, velocity=(0.0, -3.0))
    >>> isinstance(pd.RigidPlane((0.0, 0.0), (0.0, 1.0)), pd.RigidTool)
    True
    """

    velocity: Sequence[float] = field(default=(), kw_only=True)
    spin: Finite | Sequence[float] = field(default=(), kw_only=True)

    def check(self, dim: int) -> None:
        """Raise CaseError if vectors have another number of components than ``dim``, or a rate lacks its load."""
        super().check(dim)
        title, spin = type(self).__name__, np.ravel(self.spin)
        if len(self.velocity) not in (0, dim):
            raise CaseError(f"{title} has a velocity of {len(self.velocity)} numbers; give {dim}.")
        if any(v != 0.0 and not free for v, free in zip(self.velocity, self.free(dim)[:dim], strict=False)):
            raise CaseError(
                f"{title} has a velocity in a direction without force. Give a force there, such as 0, or prescribe the "
                f"motion with move."
            )
        if len(spin) not in (0, ROTATIONS[dim]):
            raise CaseError(f"{title} has a spin of {len(spin)} numbers in {dim} dimensions; give {ROTATIONS[dim]}.")
        if len(spin) and not self.twisted:
            raise CaseError(f"{title} has a spin without moment. Give a moment, such as 0.")

    def velocities(self, dim: int) -> Float:
        """Return the initial velocity by component (dim + rotations,) [length / time], [1 / time]."""
        found = super().velocities(dim)
        if len(self.velocity):
            found[:dim] = self.velocity
        if len(np.ravel(self.spin)):
            found[dim:] = self.spin
        return found

    def uniform_along(self, axis: int) -> bool:
        """Return True if no translation along a coordinate axis changes the surface, as periodic cells require."""
        return False

    @abstractmethod
    def gap(self, x: Float, u: Float) -> tuple[Float, Float, Float]:
        """Compute distance, normal and curvature at points ``x + u``.

        Write the distance as that of ``x`` plus a change by ``u`` where that is possible: the difference of two long
        coordinates rounds, and the stiffness of the contact times that rounding is a force.

        Parameters
        ----------
        x, u : (n, dim) float64
            Reference positions, and displacements [length], both as seen from the tool.

        Returns
        -------
        g : (n,) float64
            Signed distance, negative inside the tool [length]. Outside it may be shorter, but not longer: facets that
            have moved by less than their distance do not touch and are not evaluated again.
        n : (n, dim) float64
            Its gradient, the outward normal of the tool [-].
        H : (n, dim, dim) float64
            Its second gradient [1 / length].
        """


def _vector(tool: RigidTool, name: str, dim: int) -> Float:
    values = np.asarray(getattr(tool, name), dtype=float)
    if values.shape != (dim,):
        raise CaseError(f"{type(tool).__name__} has a {name} of {values.size} numbers in {dim} dimensions; give {dim}.")
    return values


@dataclass(frozen=True)
class RigidPlane(RigidTool):
    """A rigid half space below a plane (a line in 2D).

    Parameters
    ----------
    point : sequence of float
        A point of the plane (dim,) [length].
    normal : sequence of float
        Normal that points out of the tool, towards the body (dim,); its length does not matter.
    move, turn, about, force, moment, follows, schedule
        As for ``RigidMotion``.
    mass, inertia, velocity, spin
        As for ``RigidTool``.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> press = pd.RigidPlane((0.0, 10.0), (0.0, -1.0), move=(0.0, -0.5))
    """

    point: Sequence[float]
    normal: Sequence[float]

    def check(self, dim: int) -> None:
        """Raise CaseError if vectors of the tool have another number of components than ``dim``."""
        super().check(dim)
        _vector(self, "point", dim)
        if not np.linalg.norm(_vector(self, "normal", dim)) > 0.0:
            raise CaseError("The normal of a RigidPlane is zero; let it point towards the body.")

    def uniform_along(self, axis: int) -> bool:
        """Return True for axes in the plane."""
        return abs(self.normal[axis]) <= ACROSS * math.hypot(*self.normal)

    def gap(self, x: Float, u: Float) -> tuple[Float, Float, Float]:
        """Compute ``n . (x - point) + n . u``."""
        dim = x.shape[1]
        n = np.asarray(self.normal, dtype=float)
        n = n / np.linalg.norm(n)
        g = (x - np.asarray(self.point, dtype=float)) @ n + u @ n
        return g, np.broadcast_to(n, x.shape), np.zeros((len(x), dim, dim))


@dataclass(frozen=True)
class RigidBox(RigidTool):
    """A rigid box, or a rectangle in 2D, with rounded edges.

    Parameters
    ----------
    low, high : sequence of float
        Its opposite corners (dim,) [length].
    radius : float
        Radius of its edges and corners [length]; 0 by default.
    move, turn, about, force, moment, follows, schedule
        As for ``RigidMotion``.
    mass, inertia, velocity, spin
        As for ``RigidTool``.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> jaw = pd.RigidBox((-1.0, 10.0), (1.0, 12.0), radius=0.2, move=(0.0, -0.5))
    """

    low: Sequence[float]
    high: Sequence[float]
    radius: NonNegative = 0.0

    def check(self, dim: int) -> None:
        """Raise CaseError if vectors of the tool have another number of components than ``dim``, or it has no size."""
        super().check(dim)
        sides = _vector(self, "high", dim) - _vector(self, "low", dim)
        if not sides.min() > 0.0 or 2.0 * self.radius > sides.min():
            raise CaseError(
                f"A RigidBox has sides of {sides.tolist()} and edges of radius {self.radius:g}; let high exceed low, "
                f"by twice the radius at least."
            )

    def gap(self, x: Float, u: Float) -> tuple[Float, Float, Float]:
        """Compute ``|<q>| + min(max_i q_i, 0) - radius`` with ``q_i = |x_i + u_i - c_i| - (half side - radius)``."""
        low, high = np.asarray(self.low, dtype=float), np.asarray(self.high, dtype=float)
        from_middle = x - 0.5 * (low + high) + u
        q = np.abs(from_middle) - (0.5 * (high - low) - self.radius)
        outside, sign = np.maximum(q, 0.0), np.where(from_middle < 0.0, -1.0, 1.0)
        r = np.linalg.norm(outside, axis=1)
        within = r == 0.0
        nearest = np.eye(x.shape[1])[np.argmax(q, axis=1)]
        far = np.where(within, 1.0, r)
        e = np.where(within[:, None], nearest, outside / far[:, None])
        # Only directions in which the point is beyond the sides are curved.
        curved = np.where(within[:, None, None], 0.0, np.eye(x.shape[1]) * (q > 0.0)[:, :, None])
        H = (curved - np.where(within[:, None, None], 0.0, e[:, :, None] * e[:, None, :])) / far[:, None, None]
        g = np.where(within, q.max(axis=1), r) - self.radius
        return g, sign * e, sign[:, :, None] * H * sign[:, None, :]


@dataclass(frozen=True)
class RigidSphere(RigidTool):
    """A rigid ball; in 2D a disc, which is a cylinder across the plane.

    Parameters
    ----------
    center : sequence of float
        Its middle (dim,) [length].
    radius : float
        [length], positive.
    hollow : bool
        If True, the body is inside of the ball.
    move, turn, about, force, moment, follows, schedule
        As for ``RigidMotion``.
    mass, inertia, velocity, spin
        As for ``RigidTool``.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> punch = pd.RigidSphere((0.0, 13.0), 3.0, move=(0.0, -0.1))
    """

    center: Sequence[float]
    radius: Positive
    hollow: bool = False

    def check(self, dim: int) -> None:
        """Raise CaseError if vectors of the tool have another number of components than ``dim``."""
        super().check(dim)
        _vector(self, "center", dim)

    def gap(self, x: Float, u: Float) -> tuple[Float, Float, Float]:
        """Compute ``|x + u - center| - radius``, or its negative if the body is inside."""
        return _round(x - np.asarray(self.center, dtype=float), u, self.radius, self.hollow)


@dataclass(frozen=True)
class RigidCylinder(RigidTool):
    """A rigid cylinder without ends, in space.

    Parameters
    ----------
    center : sequence of float
        A point of its axis (3,) [length].
    axis : sequence of float
        Direction of its axis (3,); its length does not matter.
    radius : float
        [length], positive.
    hollow : bool
        If True, the body is inside of the cylinder.
    move, turn, about, force, moment, follows, schedule
        As for ``RigidMotion``.
    mass, inertia, velocity, spin
        As for ``RigidTool``.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> roller = pd.RigidCylinder((0.0, 0.0, -2.0), (0.0, 1.0, 0.0), 2.0)
    """

    center: Sequence[float]
    axis: Sequence[float]
    radius: Positive
    hollow: bool = False

    def check(self, dim: int) -> None:
        """Raise CaseError if the body is not in space, or the axis has no direction."""
        super().check(dim)
        if dim != 3:
            raise CaseError("A RigidCylinder is for bodies in space; take RigidSphere, which is a cylinder in 2D.")
        _vector(self, "center", dim)
        if not np.linalg.norm(_vector(self, "axis", dim)) > 0.0:
            raise CaseError("The axis of a RigidCylinder has no direction.")

    def uniform_along(self, axis: int) -> bool:
        """Return True for the axis of the cylinder."""
        across = np.delete(np.asarray(self.axis, dtype=float), axis)
        return float(np.linalg.norm(across)) <= ACROSS * math.hypot(*self.axis)

    def gap(self, x: Float, u: Float) -> tuple[Float, Float, Float]:
        """Compute the distance from the axis less the radius, or its negative if the body is inside."""
        e = np.asarray(self.axis, dtype=float)
        across = np.eye(3) - np.outer(e, e) / (e @ e)
        start = (x - np.asarray(self.center, dtype=float)) @ across
        g, n, H = _round(start, u @ across, self.radius, self.hollow)
        # The second gradient of the distance from a point has no part along the axis.
        return g, n, across @ H @ across


@dataclass(frozen=True)
class Contact(Condition):
    """Contact of a side of the body with a rigid tool, with Coulomb friction.

    The facets of the surface touch, half a spacing outside of the particles of a ``Lattice``; their displacement is
    interpolated linearly from the particles near them. Facets of a cloud without a known surface are those of its outer
    particles, half a particle outward, and the log states the offset. Only centroids touch: a tool that is narrower
    than two facets may enter between them. A step in which a tool passes through a facet, or turns by more than half a
    radian with friction, is halved. With the gap ``g`` of a facet the tool presses with
    ``p = <p0 - stiffness g>``. The multiplier ``p0`` is 0; only where an equilibrium penetrates by more than
    ``penetration``, it becomes the pressure of that equilibrium, which is solved again, until none does. A facet sticks
    with a tenth of the stiffness until the shear traction is ``friction p``.

    Parameters
    ----------
    region : Region or str
        Facets that may touch: a side, ``"-x"`` to ``"+z"``, a set or a region.
    tool : RigidTool
        ``RigidPlane``, ``RigidBox``, ``RigidSphere``, ``RigidCylinder`` or ``RigidSurface``.
    friction : float
        Coefficient of friction [-]; 0 by default. With ``math.inf`` the tool is rough: facets that it presses do not
        slide.
    stiffness : float, optional
        Pressure over penetration [stress / length]; by default 10 times the largest modulus ``lambda + 2 mu / dim``
        of the materials at the facets, with friction at most 50 ``mu``, over the mean spacing there.
    penetration : float
        Largest penetration over that spacing in an equilibrium [-]; 0.01 by default.
    name : str
        Prefix of the columns ``NAME_x``, ``NAME_y`` (force of the tool on the body), ``NAME_area`` (area in contact)
        and ``NAME_depth`` (largest penetration, or distance of a facet that is still pressed, over the spacing) in the
        history.

    Raises
    ------
    CaseError
        In a case: the tool overlaps the body at the start, or the outer layer of the particles does not enclose their
        volume.
    SolveError
        Equilibria penetrate by more than ``penetration``, whatever the multipliers.

    References
    ----------
    Wriggers2006, sections 5.1 and 5.2 (penalty), 5.4 (augmented Lagrange), 10.5 (return mapping).

    Examples
    --------
    >>> import pdpetsc as pd
    >>> roller = pd.RigidSphere((5.0, 3.0), 1.0, move=(0.0, -0.2))
    >>> pressed = pd.Contact("+y", roller, friction=0.3, name="roller")
    """

    region: Region
    tool: RigidTool
    friction: NonNegativeOrInfinite = 0.0
    stiffness: Positive | None = None
    penetration: Fraction = 0.01
    name: str = "contact"

    on_surface: ClassVar[bool] = True

    def put(self, onto: Any, name: str) -> None:
        onto.contact(self, name)


def _round(d: Float, u: Float, radius: float, hollow: bool) -> tuple[Float, Float, Float]:
    """Compute distance, normal and curvature of a sphere at ``d + u`` (n, dim) from its middle."""
    r = np.maximum(np.linalg.norm(d + u, axis=1), np.finfo(float).tiny)
    # r^2 - radius^2 without the difference of two large numbers that move.
    square = ((d * d).sum(axis=1) - radius**2) + ((2.0 * d + u) * u).sum(axis=1)
    g = square / (r + radius)
    n = (d + u) / r[:, None]
    H = (np.eye(d.shape[1]) - n[:, :, None] * n[:, None, :]) / r[:, None, None]
    return (-g, -n, -H) if hollow else (g, n, H)
