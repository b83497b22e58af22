"""A turned scene has the turned answer: sectors, stress points and patches lie along axes that turn with the body."""

import dataclasses
import itertools

import numpy as np
import pytest
from scipy.spatial import cKDTree

import pdpetsc as pd
from pdpetsc.discrete.cloud import distribute
from pdpetsc.discrete.communicator import world
from pdpetsc.discrete.families import find_families
from pdpetsc.gradient.axes import body_axes
from tests.commands import script_on
from tests.mesh.test_meshes import box, written
from tests.scenes import SCHEMES, rotation, small_points

ELASTIC = pd.Hencky(E=10.0, nu=0.3)
BODY = [[0.5, 0.5, 0.5]]
FACES = [[0.5, 0.5, 0.0], [0.5, 0.0, 0.5], [0.0, 0.5, 0.5]]


def grid(*counts):
    """Return a lattice of unit spacing."""
    return np.array(list(itertools.product(*[np.arange(float(n)) for n in counts])))


def shaken(x, by, seed=1):
    return x + by * np.random.default_rng(seed).uniform(-1.0, 1.0, x.shape)


def with_centres(x, centres):
    """Return a lattice with particles at more places of each cell."""
    return np.concatenate([x, *[x + place for place in centres]])


def wedge(x):
    """Return what is below a slanting face."""
    return x[x @ np.array([1.0, 0.7, 0.4])[: x.shape[1]] < 0.6 * x.sum(axis=1).max()]


def triangles(nx, ny):
    """Return a lattice of equilateral triangles."""
    x = grid(nx, ny)
    return np.stack([x[:, 0] + 0.5 * (x[:, 1] % 2), np.sqrt(0.75) * x[:, 1]], axis=1)


def plane(degrees):
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, -s], [s, c]])


LATTICES = {
    "square": grid(9, 6),
    "rectangular": grid(9, 6) * [1.0, 1.4],
    "slanting face": wedge(grid(14, 9)),
    "cubic": grid(5, 4, 3),
    "orthorhombic": grid(5, 4, 4) * [1.0, 1.2, 1.5],
    "solid with a slanting face": wedge(grid(7, 6, 5)),
    "layered": wedge(grid(6, 6, 6) * [1.0, 1.0, 0.4]),
    "body-centred": wedge(with_centres(grid(5, 4, 4), BODY)),
    "face-centred": with_centres(grid(4, 3, 3), FACES) * 1.4,
}
CLOUDS = LATTICES | {
    "shaken": shaken(grid(9, 6), 0.2),
    "triangles": triangles(10, 6),
    "irregular": shaken(grid(10, 7), 0.5),
    "shaken solid": shaken(grid(5, 4, 3), 0.2),
    "irregular solid": shaken(grid(6, 5, 4), 0.45),
}


def families_of(x, horizon=2.015):
    cloud = distribute(world(), x, np.ones(len(x)), {}, horizon)
    return cloud, find_families(cloud)


def axes_of(x, horizon=2.015):
    cloud, families = families_of(x, horizon)
    return body_axes(cloud, families, families.bonds(cloud.x))


def off(axes, expected):
    """Return how far axes are from others, whatever their order and signs."""
    cosines = np.abs(axes @ expected.T)
    return np.abs(cosines - np.rint(cosines)).max()


def force(x, u, scheme, horizon):
    """Return the internal force on particles at ``x`` for a displacement."""
    cloud, families = families_of(x, horizon)
    omega, material_of = np.ones(families.n_bonds), np.zeros(cloud.n_owned, dtype=np.int32)
    model = small_points(cloud, families, omega, scheme, [ELASTIC], material_of, None)
    f = np.empty_like(u)
    f[cloud.gid] = model.internal_force(u[cloud.gid])
    return f


def turns(dim):
    """Return rotations of all sizes."""
    rng = np.random.default_rng(5)
    return [rotation(3, rng), rotation(3, rng)] if dim == 3 else [plane(angle) for angle in (37.0, 45.0, 90.0, 133.0)]


@pytest.mark.parametrize("name", CLOUDS)
def test_forces_turn_with_the_cloud(name):
    x = CLOUDS[name]
    u = 0.03 * np.random.default_rng(2).uniform(-1.0, 1.0, x.shape)
    f = force(x, u, pd.SubHorizons(), 2.015)
    for Q in turns(x.shape[1]):
        assert np.abs(force(x @ Q.T, u @ Q.T, pd.SubHorizons(), 2.015) - f @ Q.T).max() < 1e-9 * np.abs(f).max()


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("scheme", [*SCHEMES.values(), pd.SubHorizons(8), pd.MeanDilatation(pd.SubHorizons(), 2.0)])
def test_forces_of_every_scheme_turn_with_the_cloud(scheme, dim):
    # Draws, boxes and some numbers of sectors depend on which axis is x, and turn by less than 45 degrees.
    Q = plane(37.0) if dim == 2 else about(0.3)
    for name in ("square", "shaken") if dim == 2 else ("cubic", "shaken solid"):
        x = CLOUDS[name]
        u = 0.03 * np.random.default_rng(2).uniform(-1.0, 1.0, x.shape)
        f = force(x, u, scheme, 2.015)
        assert np.abs(force(x @ Q.T, u @ Q.T, scheme, 2.015) - f @ Q.T).max() < 1e-9 * np.abs(f).max(), name


def about(angle):
    """Return a rotation in space by a moderate angle about an axis that is none of the lattice."""
    K = np.cross(np.eye(3), np.array([2.0, -1.0, 3.0]) / np.sqrt(14.0))
    return np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K


@pytest.mark.parametrize("name", LATTICES)
def test_axes_of_a_lattice_are_its_edges_whatever_its_faces(name):
    """A slanting face cuts more bonds across one diagonal than across the other."""
    x = LATTICES[name]
    dim = x.shape[1]
    for Q in [np.eye(dim), *turns(dim)]:
        axes, note = axes_of(x @ Q.T)
        assert off(axes, Q.T) < 1e-12
        assert note == ""
    assert np.allclose(axes_of(x)[0], np.eye(dim), atol=1e-12)


@pytest.mark.parametrize("dim", [2, 3])
def test_sectors_of_a_lattice_along_the_axes_of_space_lie_along_them(dim):
    """The shares of bonds in quadrants and octants, with those on borders in equal parts."""
    x = LATTICES["slanting face" if dim == 2 else "solid with a slanting face"]
    cloud, families = families_of(x)
    operator = pd.SubHorizons().build(cloud, families, np.ones(families.n_bonds))
    owner = int(np.argmin(np.linalg.norm(cloud.x - [3.0, 2.0, 2.0][:dim], axis=1)))
    points = np.flatnonzero(operator.owner == owner)
    assert len(points) == 2**dim
    for p, side in zip(points, itertools.product((-1.0, 1.0), repeat=dim), strict=True):
        entries = slice(operator.point_ptr[p] + 1, operator.point_ptr[p + 1])
        xi = cloud.x[operator.members[entries]] - cloud.x[owner]
        side = np.sign(xi.sum(axis=0))
        share = np.prod(np.where(xi == 0.0, 0.5, (xi * side > 0.0).astype(float)), axis=1)
        K = np.einsum("k,km,kn->mn", share, xi, xi)
        assert np.allclose(operator.g[entries], share[:, None] * xi @ np.linalg.inv(K), atol=1e-12), side


def test_a_cloud_without_order_has_the_principal_axes_of_the_body():
    x = CLOUDS["triangles"]
    away = x - x.mean(axis=0)
    expected = np.linalg.eigh(away.T @ away)[1].T
    for Q in turns(2):
        assert off(axes_of(x @ Q.T + 1e3)[0], expected @ Q.T) < 1e-9


@pytest.mark.parametrize("dim", [2, 3])
def test_the_second_moment_is_that_of_the_body_with_its_images(dim):
    x = shaken(grid(*(5, 4, 3)[:dim]) @ rotation(dim, np.random.default_rng(3)), 0.2) + 8.0
    volume = 1.0 + np.random.default_rng(2).uniform(size=len(x))
    for flips, planes in (([1.0], ()), ([1.0, -1.0], (pd.Symmetry("x", at=2.0),))):
        from_plane = x - 2.0 * np.eye(dim)[0]
        whole = np.concatenate([from_plane * np.where(np.arange(dim) == 0, flip, 1.0) for flip in flips])
        away, share = whole - np.average(whole, axis=0, weights=np.tile(volume, len(flips))), volume / volume.sum()
        expected = np.einsum("n,ni,nj->ij", np.tile(share, len(flips)) / len(flips), away, away)
        found = distribute(world(), x, volume, {}, 2.015, planes=planes).spread
        assert np.allclose(found, expected, rtol=1e-12, atol=1e-12)
    cell = pd.Cell((0.0,) * dim, (20.0,) * dim, axes="y")
    found, rest = distribute(world(), x % 20.0, volume, {}, 2.015, cell).spread, np.arange(dim) != 1
    away = (x % 20.0 - np.average(x % 20.0, axis=0, weights=volume)) * rest
    assert np.allclose(found, np.einsum("n,ni,nj->ij", share, away, away), rtol=1e-12, atol=1e-12)


def test_a_body_without_axes_has_those_of_space_and_the_log_says_so():
    angle = np.arange(40) * np.pi / 20.0
    ring = np.concatenate([r * np.stack([np.cos(angle), np.sin(angle)], axis=1) for r in (4.0, 5.0, 6.0)])
    for Q in (np.eye(2), plane(37.0)):
        axes, note = axes_of(ring @ Q.T)
        assert np.array_equal(axes, np.eye(2))
        assert "axes of space" in note


def test_two_grains_share_the_mean_of_their_axes():
    """The fourth harmonics of two lattices that are turned alike against each other add up along the mean."""
    x = grid(24, 24) - 11.5
    grains = [x @ plane(angle).T for angle in (10.0, -10.0)]
    both = np.concatenate([grain[(side * grain[:, 0] > 0.3) & np.all(np.abs(grain) < 8.0, axis=1)]
                           for side, grain in zip((1.0, -1.0), grains, strict=True)])  # fmt: skip
    both[:, 1] += 3.0
    axes, _ = axes_of(both)
    assert np.degrees(np.arcsin(np.abs(axes[0, 1]))) < 2.0
    assert off(axes_of(both @ plane(37.0).T)[0] @ plane(37.0), axes) < 1e-9


@pytest.mark.parametrize("name", ["shaken", "irregular", "shaken solid", "irregular solid"])
def test_axes_depend_neither_on_round_off_nor_on_the_order_of_particles(name):
    x = CLOUDS[name]
    axes, _ = axes_of(x)
    order = np.random.default_rng(4).permutation(len(x))
    assert off(axes_of(x[order])[0], axes) < 1e-12
    assert off(axes_of(shaken(x, 1e-13, seed=8))[0], axes) < 1e-10
    assert off(axes_of(1e-20 * x, 2.015e-20)[0], axes) < 1e-10


RANKS = """
import sys
import numpy as np
from pdpetsc.discrete.cloud import distribute
from pdpetsc.discrete.communicator import world
from pdpetsc.discrete.families import find_families
from pdpetsc.gradient.axes import body_axes

comm = world()
for name in sys.argv[1:]:
    x = np.load(name)[comm.rank :: comm.size]
    cloud = distribute(comm, x, np.ones(len(x)), {}, 2.015)
    families = find_families(cloud)
    axes, _ = body_axes(cloud, families, families.bonds(cloud.x))
    if comm.rank == 0:
        print(*axes.ravel().tolist())
"""


def test_axes_are_the_same_on_two_ranks(tmp_path):
    names = ["shaken", "irregular", "triangles", "irregular solid"]
    for name in names:
        np.save(tmp_path / f"{name}.npy", CLOUDS[name])
    lines = script_on(2, RANKS, *[tmp_path / f"{name}.npy" for name in names]).split("\n")
    for name, line in zip(names, lines, strict=False):
        found = np.array(line.split(), dtype=float)
        assert np.allclose(found, axes_of(CLOUDS[name])[0].ravel(), atol=1e-12), name


PATCHES = """
import numpy as np
import pdpetsc as pd
from pdpetsc.discrete.communicator import total, world

x = np.stack(np.meshgrid(np.arange(20.0), np.arange(8.0), indexing="ij"), axis=-1).reshape(-1, 2)
c, s = np.cos(0.44), np.sin(0.44)
case = pd.Case(
    particles=pd.Arrays(x @ np.array([[c, s], [-s, c]]), 1.0), horizon=2.015, material=pd.LinearElastic(1.0, 0.49),
    scheme=pd.MeanDilatation(pd.Correspondence(), 2.0), control=pd.ByShear(pd.Silling()),
    conditions=[pd.Displacement(pd.region.Slab("x", high=5.0), x=0.0, y=0.0)],
)
patch_of_point = pd.prepare(case).problem.material_term.patch_of_point
count = int(total(world(), len(np.unique(patch_of_point))))
if world().rank == 0:
    print(count)
"""


@pytest.mark.parametrize("ranks", [1, 2])
def test_ranks_cut_no_patch_of_a_turned_lattice(ranks):
    """The boxes have two times two particles each."""
    assert int(script_on(ranks, PATCHES)) == 40


def pulled(particles, Q, material, pull, horizon=2.015, **changes):
    """Return the case of a body whose ends are held and pulled, turned by Q."""
    names = "xyz"[: len(Q)]
    ends = {"held": np.zeros(len(Q)), "moved": Q @ np.array(pull)}
    return pd.Case(
        particles=particles, horizon=horizon, material=material, fields=[],
        conditions=[
            pd.Displacement(region_at(Q, end), **dict(zip(names, map(float, u), strict=True)))
            for end, u in ends.items()
        ],
        history={axis: pd.Reaction(axis, region_at(Q, "moved")) for axis in names},
        results=lambda h: {axis: float(h[axis][-1]) for axis in names},
        **changes,
    )  # fmt: skip


def region_at(Q, end):
    """Return the first or the last two layers of a turned body."""
    return pd.region.Where(lambda x: x @ Q[:, 0] < 1.5 if end == "held" else x @ Q[:, 0] > 5.5)


def reaction(case, Q, folder):
    done = pd.run(case, output=folder)
    return Q.T @ np.array([done.results[axis] for axis in "xyz"[: len(Q)]])


LAYERED = pd.Orthotropic(E=(10.0, 4.0, 3.0), nu=(0.2, 0.1, 0.3), G=(2.0, 2.0, 1.0))
LAWS = {
    "hencky": lambda Q: ELASTIC,
    "drucker-prager": lambda Q: pd.DruckerPrager(E=10.0, nu=0.3, cohesion=0.05, friction=0.3, hardening=0.5),
    "orthotropic": lambda Q: dataclasses.replace(LAYERED, orientation=oriented(Q)),
}


def oriented(Q):
    """Return the axes of a turned material: an angle in the plane."""
    return Q.tolist() if len(Q) == 3 else float(np.arctan2(Q[1, 0], Q[0, 0]))


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("by", [0.0, 0.2])
def test_a_turned_plate_has_the_turned_reaction(law, by, tmp_path):
    """Sectors along the axes of space changed it by 1 %, and by 6 % across the pull."""
    x, found = shaken(grid(8, 5), by), []
    for Q in (np.eye(2), plane(37.0), plane(90.0)):
        particles = pd.Arrays(x @ Q.T, 1.0)
        case = pulled(particles, Q, LAWS[law](Q), (0.2, 0.1), steps=pd.Steps(2))
        found.append(reaction(case, Q, tmp_path / str(len(found))))
    assert np.abs(found[0]).min() > 0.0
    assert np.abs(np.array(found[1:]) - found[0]).max() < 1e-9 * np.abs(found[0]).max()


@pytest.mark.parametrize("law", ["hencky", "orthotropic"])
def test_a_turned_solid_has_the_turned_reaction(law, tmp_path):
    x, found = grid(8, 3, 3), []
    for Q in (np.eye(3), *turns(3)[:1]):
        case = pulled(pd.Arrays(x @ Q.T, 1.0), Q, LAWS[law](Q), (0.2, 0.1, 0.05), horizon=1.5)
        found.append(reaction(case, Q, tmp_path / str(len(found))))
    assert np.abs(found[1] - found[0]).max() < 1e-9 * np.abs(found[0]).max()


@pytest.mark.parametrize("kind", ["quad", "triangle"])
def test_a_turned_mesh_has_the_turned_reaction(kind, tmp_path):
    points, cells = box(kind, (8, 4))
    inner = np.all((points > 0.5) & (points < [7.5, 3.5]), axis=1)
    points[inner] = shaken(points[inner], 0.2)
    found = []
    for Q in (np.eye(2), plane(37.0), plane(90.0)):
        mesh = pd.Mesh(written(tmp_path / f"{len(found)}.vtk", points @ Q.T, [(kind, cells)]))
        found.append(reaction(pulled(mesh, Q, ELASTIC, (0.2, 0.1)), Q, tmp_path / str(len(found))))
    assert np.abs(np.array(found[1:]) - found[0]).max() < 1e-9 * np.abs(found[0]).max()


@pytest.mark.parametrize("x", [shaken(grid(6, 5), 0.2), shaken(grid(7, 5), 0.45)], ids=["shaken", "irregular"])
def test_axes_beside_mirror_planes_are_those_of_the_whole_body(x):
    quarter = x + 0.5
    flips = np.array(list(itertools.product((1.0, -1.0), repeat=2)))
    whole = np.concatenate([quarter * flip for flip in flips])
    planes = (pd.Symmetry("x"), pd.Symmetry("y"))
    clouds = [distribute(world(), quarter, np.ones(len(x)), {}, 2.015, planes=planes), families_of(whole)[0]]
    operators = []
    for cloud in clouds:
        families = find_families(cloud)
        operators.append(pd.SubHorizons().build(cloud, families, np.ones(families.n_bonds)))
    smooth = [np.stack([np.sin(c.x[:, 0]), c.x[:, 1] ** 3], axis=1) for c in clouds]
    squares = [
        operator.sum_over_points((operator.gradient(u) ** 2).sum(axis=(1, 2)) * operator.volume)
        for operator, u in zip(operators, smooth, strict=True)
    ]
    place = cKDTree(clouds[1].x[: clouds[1].n_owned]).query(clouds[0].x[: clouds[0].n_owned])[1]
    assert np.allclose(squares[0], squares[1][place], rtol=1e-10)
