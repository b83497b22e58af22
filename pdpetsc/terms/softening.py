"""Part of a tangent from the derivative of the degradation factors of bonds by the displacement.

Each product is ``v (x) dphi/du``: force of the intact bond, on both its ends, times the gradient of its degradation
factor.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, Lookup, row_of_entries
from pdpetsc.damage.criterion import EndpointMean, Gradient, NonlocalPart
from pdpetsc.gradient.base import StencilMembers
from pdpetsc.gradient.products import Product, SofteningProduct
from pdpetsc.kernels.sparsity import sum_by
from pdpetsc.problem.body import Body
from pdpetsc.problem.state import State


def softening_products(state: State, gradient: Gradient, v: Float, opposite: Callable[[Float], Float]) -> list[Product]:
    """Build the derivative of ``phi`` in the tangent, for elongations of the current length (collective).

    Parameters
    ----------
    state : State
        The state.
    gradient : Gradient
        Gradient of the degradation factors.
    v : (n_bonds, dim) float64
        Force of every intact bond on its second end [force].
    opposite : callable
        Returns such forces of the opposite direction of every bond (``OppositeBonds.of_vectors``).
    """
    body, bonds, u_local = state.body, gradient.bonds, state.u_local
    centres, neighbours = body.families.centres[bonds], body.families.neighbours[bonds]
    y = body.cloud.x + u_local
    m = y[neighbours] - y[centres]
    m *= (gradient.along / np.linalg.norm(m, axis=1))[:, None]
    ends = StencilMembers(centres, 2 * np.arange(len(bonds) + 1), np.stack([centres, neighbours], axis=1).ravel())
    along = SofteningProduct(ends, body.cloud.n_owned, _of_ends(v[bonds]), _of_ends(m), np.ones(len(bonds)))
    return [along, *softening_nonlocal(body, gradient, v, opposite)]


def softening_nonlocal(body: Body, gradient: Gradient, v: Float, opposite: Callable[[Float], Float]) -> list[Product]:
    """Build the nonlocal part of the derivative only, without the own elongation; empty for most criteria.

    Arguments as for ``softening_products`` (collective).
    """
    bonds = gradient.bonds
    found: list[Product] = []
    if gradient.nonlocal_part is not None:
        found.append(_of_particles(body, bonds, v[bonds], gradient.nonlocal_part))
    if gradient.ends:
        both = 0.5 * (v - opposite(v))[bonds]
        found += [_of_endpoint_mean(body, bonds, both, ends) for ends in gradient.ends]
    return found


def softening_dilatation(body: Body, gradient: Gradient, q: Float, n: Float, s: Float) -> Product:
    """Build the derivative of the dilatation of a family by the degradation factors of its softening bonds.

    Parameters
    ----------
    body : Body
        The body.
    gradient : Gradient
        Gradient of the degradation factors of softening bonds.
    q : (n_bonds, dim) float64
        Force of every bond on its second end for a dilatation of 1 [force].
    n : (n_bonds, dim) float64
        Directions of the bonds [-].
    s : (n,) float64
        Contribution of each softening bond to the dilatation if it were intact [-].
    """
    families, whole, bonds = body.families, body.with_centres, gradient.bonds
    centres, n_owned = families.centres, body.cloud.n_owned
    # Entries of the families with their centres: the entry of bond b is shifted by one for each family before it.
    of_bond = np.arange(len(centres)) + centres + 1
    g = np.zeros((len(whole.members), body.dim))
    own = (s * gradient.along)[:, None] * n[bonds]
    g[of_bond[bonds]] += own
    np.subtract.at(g, whole.point_ptr[:-1][centres[bonds]], own)
    if gradient.nonlocal_part is not None:
        count = np.diff(gradient.nonlocal_part.ptr)
        key = row_of_entries(whole.point_ptr) * body.cloud.n_local + whole.members
        centre = np.repeat(centres[bonds].astype(np.int64), count)
        at = Lookup(key).of(centre * body.cloud.n_local + gradient.nonlocal_part.particles)
        np.add.at(g, at, np.repeat(s, count)[:, None] * gradient.nonlocal_part.by)
    for ends in gradient.ends:
        # The other ends of the bonds depend on particles outside the family; the own end replaces them.
        sums = np.bincount(centres[bonds], s * ends.factor, n_owned)
        g += np.repeat(sums, np.diff(whole.point_ptr))[:, None] * ends.by
    return _of_families(body, bonds, q, g)


def _of_ends(v: Float) -> Float:
    """Return vectors of the second ends of bonds (n, dim), with opposite vectors on the first ends (2 n, dim)."""
    both = np.empty((len(v), 2, v.shape[1]))
    np.negative(v, out=both[:, 0])
    both[:, 1] = v
    return both.reshape(-1, v.shape[1])


def _of_particles(body: Body, bonds: GlobalIndex, v: Float, part: NonlocalPart) -> Product:
    """Build the product of bonds whose degradation factor depends on particles of a family.

    Stencils begin with both ends, which receive the forces, followed by the particles that have the derivatives.
    """
    centres = body.families.centres[bonds]
    ends = np.stack([centres, body.families.neighbours[bonds]], axis=1).ravel()
    at = np.repeat(part.ptr[:-1], 2)
    members = np.insert(part.particles, at, ends).astype(ends.dtype)
    ptr = part.ptr + 2 * np.arange(len(bonds) + 1)
    h = np.zeros((len(members), body.dim))
    h[ptr[:-1]], h[ptr[:-1] + 1] = -v, v
    stencils = StencilMembers(centres, ptr, members)
    return SofteningProduct(stencils, body.cloud.n_owned, h, np.insert(part.by, at, 0.0, axis=0), np.ones(len(bonds)))


def _of_endpoint_mean(body: Body, bonds: GlobalIndex, v: Float, ends: EndpointMean) -> Product:
    """Build the product of bonds whose degradation factor depends on the mean of a value of both ends.

    ``v`` (n, dim) is half the difference of the forces of both intact directions on the second end [force].
    """
    q = np.zeros((len(body.families.neighbours), body.dim))
    q[bonds] = ends.factor[:, None] * v
    return _of_families(body, bonds, q, ends.by)


def _of_families(body: Body, bonds: GlobalIndex, q: Float, g: Float) -> Product:
    """Build the product of forces q (n_bonds, dim) of bonds with one value of each family of the bonds.

    ``g`` (n_entries, dim) is its derivative by the displacement of the members of the family, its centre first.
    """
    families, n = body.families, body.cloud.n_owned
    h = np.insert(q, families.indptr[:-1], -sum_by(families.centres, q, n), axis=0)
    counts = np.bincount(families.centres[bonds], minlength=n) > 0
    return SofteningProduct(body.with_centres, n, h, g, counts.astype(float))
