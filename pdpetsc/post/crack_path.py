"""Cracks as lines and surfaces: the faces between neighbouring particles whose bonds are broken."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from weakref import WeakKeyDictionary

import numpy as np
import scipy

from pdpetsc.arrays import Float, GlobalIndex, Mask
from pdpetsc.declare.region import Region
from pdpetsc.discrete.communicator import agreed
from pdpetsc.errors import CaseError
from pdpetsc.post.bonds_left import pairs_of
from pdpetsc.post.quantities import EVERYWHERE, Quantity
from pdpetsc.post.solution import Solution
from pdpetsc.problem.body import Body

# Faces smaller than this share of volume over distance are corners of four or more cells of a lattice. Cells with faces
# larger than the second multiple are unbounded, as at the surface.
LEAST_FACE, LARGEST_FACE = 1e-3, 2.0
# Ends of faces this near to each other, as a share of the distance of the particles, coincide.
SAME_POINT = 0.05


@dataclass(frozen=True)
class CrackFaces:
    """Faces between the cells of neighbouring particles with a broken bond, of all ranks, each once.

    Attributes
    ----------
    middle : (n, dim) float64
        Middles of the bonds [length].
    normal : (n, dim) float64
        Their directions from the particle created first to the other, unit vectors.
    area : (n,) float64
        Length of a face in the plane, area in space [length^(dim - 1)].
    corners : list of (n_corners, dim) float64
        Ends of a face in the plane, corners in order in space [length].
    share : (n,) float64
        1, or 1/2 of faces on a mirror plane, which belong to both sides [-].
    """

    middle: Float
    normal: Float
    area: Float
    corners: list[Float]
    share: Float

    def __len__(self) -> int:
        return len(self.area)

    @cached_property
    def nodes(self) -> GlobalIndex:
        """Return a number for every corner, face by face; equal for corners that coincide."""
        if not len(self):
            return np.empty(0, dtype=np.int64)
        points = np.concatenate(self.corners)
        size = float(np.median(self.area)) ** (1.0 / (self.middle.shape[1] - 1))
        same = scipy.spatial.cKDTree(points).query_pairs(SAME_POINT * size, output_type="ndarray")
        one = scipy.sparse.coo_matrix((np.ones(len(same)), tuple(same.T)), shape=(len(points), len(points)))
        return np.asarray(scipy.sparse.csgraph.connected_components(one, directed=False)[1], dtype=np.int64)

    @cached_property
    def piece(self) -> GlobalIndex:
        """Return a number for every face; equal for faces connected by corners."""
        of = np.repeat(np.arange(len(self)), [len(corners) for corners in self.corners])
        size = len(self) + 1 + int(self.nodes.max(initial=-1))
        links = scipy.sparse.coo_matrix((np.ones(len(of)), (of, len(self) + self.nodes)), shape=(size, size))
        return np.asarray(
            scipy.sparse.csgraph.connected_components(links, directed=False)[1][: len(self)], dtype=np.int64
        )

    def smooth_area(self, radius: float) -> Float:
        """Return the areas projected along the normal of the crack (n,).

        An inclined crack follows the steps of a lattice, and the sum of the faces does not converge to its area. The
        normal of the crack is that of the plane or line of best fit to the middles of the connected faces within a
        radius.
        """
        if not len(self):
            return np.empty(0)
        near = scipy.spatial.cKDTree(self.middle).query_ball_point(self.middle, radius)
        seen = self.area.copy()
        for face, around in enumerate(near):
            members = np.sort(np.array(around)[self.piece[around] == self.piece[face]])
            apart = self.middle[members] - self.middle[members].mean(axis=0)
            moments = (self.area[members, None] * apart).T @ apart
            size, axes = np.linalg.eigh(moments)
            # A single face, or a line of faces in space, has its own plane.
            if size[1] > 1e-6 * radius**2 * self.area[face]:
                seen[face] *= abs(float(axes[:, 0] @ self.normal[face]))
        return seen


def crack_faces(solution: Solution, region: Region = EVERYWHERE, precracks: bool = False) -> CrackFaces:
    """Return the faces of cracks: between Voronoi neighbours with a broken bond.

    Parameters
    ----------
    solution : Solution
        A state.
    region : Region
        Region of the faces; one of the two particles must be in it.
    precracks : bool
        If True, include faces cut by pre-cracks of the case.

    Raises
    ------
    CaseError
        The body is a line, or its particles are on a line.

    Notes
    -----
    Collective; equal on all ranks.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> faces = pd.crack_faces(result.solution)          # doctest: +SKIP
    >>> lines = pd.crack_lines(faces)                    # doctest: +SKIP
    """
    cloud = solution.cloud
    if cloud.dim < 2:
        raise CaseError("Cracks are lines in a plane body and surfaces in space; a line has none.")
    chosen = solution.with_ghosts(solution.select(region))
    with agreed(cloud.comm):
        rows, corners = _own_faces(solution, chosen > 0.0, precracks)
    parts = cloud.comm.allgather((rows, corners))
    rows = np.concatenate([part[0] for part in parts])
    corners = [one for part in parts for one in part[1]]
    dim = cloud.dim
    # Most pairs are listed from both ends.
    keys, first = np.unique(rows[:, :3], axis=0, return_index=True)
    mirrored = (keys[:, 0] == keys[:, 1]) & (cloud.places.behind(keys[:, 2].astype(np.int64)) > 0)
    found = rows[first, 3:]
    return CrackFaces(
        found[:, :dim],
        found[:, dim : 2 * dim],
        found[:, -1],
        [corners[place] for place in first],
        np.where(mirrored, 0.5, 1.0),
    )


_cut: WeakKeyDictionary[Body, GlobalIndex] = WeakKeyDictionary()


def _cut_from_the_start(solution: Solution) -> GlobalIndex:
    """Return the owned particles that a pre-crack of the case has cut from another (n,)."""
    body = solution.problem.body
    if body not in _cut:
        pairs, _, bonded = pairs_of(solution, np.arange(len(solution.x)))
        _cut[body] = np.unique(pairs[~bonded, 0])
    return _cut[body]


def _own_faces(solution: Solution, chosen: Mask, precracks: bool) -> tuple[Float, list[Float]]:
    """Return rows (n, 3 + 2 dim + 1) of the faces of owned particles: key, middle, normal, area; and their corners."""
    cloud, damage, families = solution.cloud, solution.problem.bond_damage, solution.problem.body.families
    if damage is None and solution.problem.damage is not None:
        raise CaseError(
            "Faces of a crack lie between particles whose bond is broken, and points of PointDamage fail without "
            "breaking bonds; take CrackTip, or DissipatedEnergy over Gc."
        )
    dim = cloud.dim
    none = np.empty((0, 4 + 2 * dim)), list[Float]()
    zone = np.empty(0, dtype=np.int64)
    if damage is not None:
        zone = np.unique(families.centres[damage.bonds.phi == 0.0]).astype(np.int64)
    if precracks:
        zone = np.union1d(zone, _cut_from_the_start(solution))
    if not len(zone):
        return none
    pairs, left, bonded = pairs_of(solution, zone)
    gone = (left == 0.0) & (bonded | precracks)
    pairs = pairs[gone & (chosen[pairs[:, 0]] | chosen[pairs[:, 1]])]
    if not len(pairs):
        return none
    around = cloud.x[np.unique(pairs)]
    reach = float(cloud.local_horizon[zone].max())
    near = np.flatnonzero(scipy.spatial.cKDTree(around).query(cloud.x, distance_upper_bound=2.0 * reach)[0] < np.inf)
    place = np.full(cloud.n_local, -1)
    place[near] = np.arange(len(near))
    scale = reach
    try:
        diagram = scipy.spatial.Voronoi((cloud.x[near] - cloud.x[near].mean(axis=0)) / scale)
    except scipy.spatial.QhullError as error:
        raise CaseError(
            f"The particles about the broken bond at {cloud.x[pairs[0, 0]]} lie on one line or plane and have no faces "
            f"between them; leave the CrackLength out."
        ) from error
    ridges = {(min(p), max(p)): n for n, p in enumerate(diagram.ridge_points.tolist())}
    thickness = solution.problem.body.thickness if dim == 2 else 1.0
    rows, corners = [], []
    for i, j in pairs.tolist():
        a, b = int(place[i]), int(place[j])
        ridge = ridges.get((min(a, b), max(a, b)))
        if ridge is None:
            continue
        xi = cloud.x[j] - cloud.x[i]
        length, middle = float(np.linalg.norm(xi)), 0.5 * (cloud.x[i] + cloud.x[j])
        usual = 0.5 * (cloud.volume[i] + cloud.volume[j]) / thickness / length
        vertices = diagram.ridge_vertices[ridge]
        points = diagram.vertices[[v for v in vertices if v >= 0]] * scale + cloud.x[near].mean(axis=0)
        area = _area(points)
        if -1 in vertices or area > LARGEST_FACE * usual:
            points, area = _patch(middle, xi / length, usual, points), usual
        if area < LEAST_FACE * usual:
            continue
        key, forward = _key(solution, i, j)
        rows.append([*key, *middle, *((xi if forward else -xi) / length), area])
        corners.append(points)
    return (np.array(rows), corners) if rows else none


def _key(solution: Solution, i: int, j: int) -> tuple[tuple[int, int, int], bool]:
    """Return ids of both ends, the lower first, the image place of the second from the first, and if i is first."""
    cloud = solution.cloud
    place = int(cloud.place[j])
    back = int(cloud.places.opposite(np.array([place]))[0])
    one, other = int(cloud.gid[i]), int(cloud.gid[j])
    low = one < other or (one == other and back <= place)
    return ((one, other, place) if low else (other, one, back)), low


def _area(points: Float) -> float:
    """Return the length between two points of a plane, or the area of a polygon in space."""
    if len(points) < 2:
        return 0.0
    if points.shape[1] == 2:
        return float(np.linalg.norm(points[1] - points[0]))
    sides = points - points[0]
    return float(0.5 * np.linalg.norm(np.cross(sides[1:-1], sides[2:]).sum(axis=0)))


def _patch(middle: Float, normal: Float, area: float, points: Float) -> Float:
    """Return a face of an area about a middle, for unbounded cells at the surface."""
    dim = len(middle)
    if dim == 2:
        along = np.array([-normal[1], normal[0]]) * 0.5 * area
        ends = np.array([middle - along, middle + along])
        for point in points:  # the bounded end, shared with the adjacent face
            nearer = int(np.argmin(np.linalg.norm(ends - point, axis=1)))
            if np.linalg.norm(ends[nearer] - point) < 0.5 * area:
                ends[nearer] = point
        return ends
    one = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    one *= 0.5 * np.sqrt(area) / np.linalg.norm(one)
    other = np.cross(normal, one)
    return np.array([middle - one - other, middle + one - other, middle + one + other, middle - one + other])


def crack_lines(faces: CrackFaces) -> list[Float]:
    """Return the faces of a crack in the plane as polylines (n_points, 2) [length] (not collective).

    A line ends where a crack ends or forks. It connects the middles of the faces, from the end of the first to the end
    of the last: the steps of a lattice along an inclined crack are smoothed.

    Parameters
    ----------
    faces : CrackFaces
        Faces returned by ``crack_faces``.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> lines = pd.crack_lines(pd.crack_faces(result.solution))      # doctest: +SKIP
    """
    n = len(faces)
    if not n:
        return []
    of = faces.nodes.reshape(n, 2)
    at: dict[int, list[int]] = {}
    for face in range(n):
        for one in of[face].tolist():
            at.setdefault(one, []).append(face)
    used, lines = np.zeros(n, dtype=bool), []
    starts = sorted(one for one, members in at.items() if len(members) != 2)
    for start in [*starts, *sorted(at)]:
        for face in at[start]:
            if not used[face]:
                lines.append(_line(faces, of, at, used, start, face))
    return lines


def _line(faces: CrackFaces, of: GlobalIndex, at: dict[int, list[int]], used: Mask, start: int, face: int) -> Float:
    """Return the line from a node along a face to its end or fork."""
    points, here = [faces.corners[face][int(of[face, 0] != start)]], start
    while True:
        used[face] = True
        points.append(faces.middle[face])
        there = int(of[face, 0] == here)
        here, end = int(of[face, there]), faces.corners[face][there]
        beyond = [other for other in at[here] if not used[other]]
        if len(at[here]) != 2 or not beyond:
            return np.array([*points, end])
        face = beyond[0]


@dataclass(frozen=True)
class CrackLength(Quantity):
    """Length of the cracks of a plane body, or area in a solid body [length^(dim - 1)], from broken bonds.

    A crack consists of the faces between Voronoi neighbours with a broken bond. Each face is projected on the line or
    plane of best fit to the connected faces within a horizon, so that the steps of a lattice do not increase the
    length. If a particle loses the bonds on both sides, both faces are included. With mirror planes it is the length in
    the part: half of a crack on a plane.

    A run with this quantity in its history writes the crack of its last step to ``crack.vtk``, as lines or surfaces.

    Parameters
    ----------
    region : Region
        Region of the faces, by default everywhere; one of the two particles must be in it.
    precracks : bool
        If True, include faces cut by pre-cracks of the case.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> history = {"grown": pd.CrackLength(), "length": pd.CrackLength(precracks=True)}
    """

    region: Region = EVERYWHERE
    precracks: bool = False

    def check(self, dim: int) -> None:
        """Raise CaseError if the body is a line, or the region does not fit."""
        if dim < 2:
            raise CaseError("A CrackLength is of a plane body or a solid one; this one is a line.")
        self.region.check(dim)

    def evaluate(self, solution: Solution) -> float:
        faces = crack_faces(solution, self.region, self.precracks)
        return float(faces.share @ faces.smooth_area(solution.cloud.horizon))

    def drawn(self, solution: Solution) -> tuple[Sequence[Float], bool]:
        """Return polylines or polygons, and True if they are closed."""
        faces = crack_faces(solution, self.region, self.precracks)
        return (crack_lines(faces), False) if solution.cloud.dim == 2 else (faces.corners, True)
