"""Particles, regions, influence, schedules, conditions and their distribution."""

import meshio
import numpy as np
import pytest

import pdpetsc as pd
from pdpetsc.declare.region import View
from pdpetsc.discrete.cloud import distribute
from pdpetsc.discrete.communicator import world
from pdpetsc.discrete.families import find_families
from pdpetsc.post.solution import Solution
from pdpetsc.problem.body import Body
from pdpetsc.problem.problem import Problem
from pdpetsc.terms.conditions import apply
from pdpetsc.terms.material_points import MaterialPoints
from tests.commands import script_on

region = pd.region


def view(x, **sets):
    return View(np.asarray(x, dtype=float), sets, minimum=float)


def whole(particles, parts=3):
    """Return all particles, created in parts."""
    chunks = [particles.chunk(k, parts) for k in range(parts)]
    sets = {name: np.concatenate([c.sets[name] for c in chunks]) for name in chunks[0].sets}
    return np.concatenate([c.x for c in chunks]), np.concatenate([c.volume for c in chunks]), sets


def loaded(conditions, n=6, spacing=0.5, thickness=2.0, horizon=2.015, material=None):
    """Return supports and loads of a square of n x n particles and its problem."""
    lattice = pd.Lattice((0.0, 0.0), (n * spacing, n * spacing), spacing, thickness=thickness)
    chunk = lattice.chunk(0, 1)
    cloud = distribute(world(), chunk.x, chunk.volume, chunk.sets, horizon * spacing)
    families = find_families(cloud)
    square = Body(cloud, families)
    materials, material_of = [material or pd.Hencky(10.0, 0.3)], np.zeros(cloud.n_owned, dtype=np.int32)
    operator = pd.Correspondence().build(cloud, families, np.ones(len(families.neighbours)))
    material_term = MaterialPoints(square, operator, materials, material_of)
    applied = apply(square, material_term, conditions, lattice)
    supports, (loads,) = applied.supports, applied.terms
    return supports, loads, Problem(square, material_term, [loads], supports)


# --- particles


def test_lattice_is_the_same_in_any_number_of_parts():
    lattice = pd.Lattice((0.0, 0.0, 0.0), (1.0, 0.5, 0.75), 0.25, cut=region.Sphere((0.5, 0.25, 0.4), 0.2))
    x, volume, _ = whole(lattice, 1)
    for parts in (2, 5, 100):
        again, volumes, _ = whole(lattice, parts)
        assert np.array_equal(x, again)
        assert np.array_equal(volume, volumes)


def test_lattice_volumes_and_positions():
    x, volume, _ = whole(pd.Lattice((0.0, 1.0), (1.0, 1.5), 0.25, thickness=3.0))
    assert len(x) == 8
    assert volume.sum() == pytest.approx(1.5)
    assert x.min(axis=0).tolist() == [0.125, 1.125]
    line, length, _ = whole(pd.Lattice(0.0, 2.0, 0.5, thickness=0.1))
    assert line.shape == (4, 1)
    assert length.sum() == pytest.approx(0.2)


def test_fictitious_layers_are_named():
    x, _, sets = whole(pd.Lattice((0.0, 0.0), (1.0, 1.0), 0.25, fictitious={"-x": 0.6, "+y": 0.25}))
    assert len(x) == (4 + 2) * (4 + 1)
    assert np.array_equal(sets["fictitious -x"], x[:, 0] < 0.0)
    assert np.array_equal(sets["fictitious +y"], x[:, 1] > 1.0)
    assert np.array_equal(sets["fictitious"], ~sets["real"])


def test_cut_and_keep_choose_pieces():
    hole = region.Sphere((0.5, 0.5), 0.2)
    x, _, _ = whole(pd.Lattice((0.0, 0.0), (1.0, 1.0), 0.1, cut=hole, keep=region.Slab("x", high=0.5)))
    assert x[:, 0].max() < 0.5
    assert np.linalg.norm(x - 0.5, axis=1).min() > 0.2


def test_text_files_with_node_sets(tmp_path):
    cloud = tmp_path / "cloud.txt"
    cloud.write_text("# x y z block volume\n0 0 0 1 0.5\n1 0 0 1 0.5\n0 1 0 2 0.25\n1 1 0 2 0.25\n")
    nodes = tmp_path / "left.txt"
    nodes.write_text("1\n3\n")
    x, volume, sets = whole(pd.TextFile(cloud, {"left": nodes}))
    assert x.shape == (4, 2)
    assert volume.tolist() == [0.5, 0.5, 0.25, 0.25]
    assert sets["block_2"].tolist() == [False, False, True, True]
    assert sets["left"].tolist() == [True, False, True, False]
    nodes.write_text("5\n")
    with pytest.raises(pd.CaseError, match="outside 1 to 4"):
        whole(pd.TextFile(cloud, {"left": nodes}))
    cloud.write_text("one two three\n")
    with pytest.raises(pd.CaseError, match="not a table of numbers"):
        whole(pd.TextFile(cloud))


def box_mesh():
    """Return a unit cube of a hexahedron, a wedge pair and tetrahedra stacked in x, with their volumes."""
    points = np.array([[x, y, z] for x in (0.0, 1.0, 2.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
    hexahedron = [[0, 4, 6, 2, 1, 5, 7, 3]]
    wedges = [[4, 8, 10, 5, 9, 11], [4, 10, 6, 5, 11, 7]]
    return points, hexahedron, wedges


def test_mesh_cells_become_particles_with_exact_volumes_and_centroids(tmp_path):
    points, hexahedron, wedges = box_mesh()
    meshio.write(tmp_path / "box.vtk", meshio.Mesh(points, [("hexahedron", hexahedron), ("wedge", wedges)]))
    x, volume, _ = whole(pd.Mesh(tmp_path / "box.vtk"))
    assert np.allclose(volume, [1.0, 0.5, 0.5], atol=1e-14)
    assert np.allclose(x[0], 0.5, atol=1e-14)
    assert np.allclose(x[1:], [[5 / 3, 1 / 3, 0.5], [4 / 3, 2 / 3, 0.5]], atol=1e-14)


def test_plane_meshes_are_plane_bodies(tmp_path):
    points = np.array([[0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0], [3, 0, 0]], dtype=float)
    mesh = meshio.Mesh(points, [("quad", [[0, 1, 2, 3]]), ("triangle", [[1, 4, 2]]), ("line", [[0, 1]])])
    meshio.write(tmp_path / "plate.vtk", mesh)
    x, volume, _ = whole(pd.Mesh(tmp_path / "plate.vtk", thickness=0.5))
    assert x.tolist() == [[1.0, 0.5], [pytest.approx(7 / 3), pytest.approx(1 / 3)]]
    assert volume.tolist() == [1.0, 0.25]


def test_gmsh_physical_groups_become_sets(tmp_path):
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float)
    mesh = meshio.Mesh(
        points,
        [("triangle", [[0, 1, 2]]), ("triangle", [[0, 2, 3]])],
        cell_data={"gmsh:physical": [np.array([7]), np.array([8])], "gmsh:geometrical": [np.array([1]), np.array([2])]},
        field_data={"steel": np.array([7, 2])},
    )
    meshio.gmsh.write(tmp_path / "plate.msh", mesh, fmt_version="2.2")
    _, volume, sets = whole(pd.Mesh(tmp_path / "plate.msh"))
    assert volume.tolist() == [0.5, 0.5]
    assert sets["steel"].tolist() == [True, False]
    assert sets["group_8"].tolist() == [False, True]


def test_abaqus_element_and_node_sets_become_sets(tmp_path):
    path = tmp_path / "plate.inp"
    path.write_text(
        "*NODE\n1, 0, 0, 0\n2, 1, 0, 0\n3, 1, 1, 0\n4, 0, 1, 0\n5, 2, 0, 0\n6, 2, 1, 0\n"
        "*ELEMENT, TYPE=CPS4, ELSET=left\n1, 1, 2, 3, 4\n*ELEMENT, TYPE=CPS4, ELSET=right\n2, 2, 5, 6, 3\n"
        "*NSET, NSET=held\n1, 4\n"
    )
    x, _, sets = whole(pd.Mesh(path))
    assert x.tolist() == [[0.5, 0.5], [1.5, 0.5]]
    assert sets["left"].tolist() == [True, False]
    assert sets["right"].tolist() == [False, True]
    assert sets["held"].tolist() == [True, False]


def test_exodus_meshes_are_read(tmp_path):
    points, hexahedron, _ = box_mesh()
    mesh = meshio.Mesh(points, [("hexahedron", [*hexahedron, [4, 8, 10, 6, 5, 9, 11, 7]])])
    meshio.write(tmp_path / "box.e", mesh)
    x, volume, sets = whole(pd.Mesh(tmp_path / "box.e"))
    assert np.allclose(volume, 1.0)
    assert np.allclose(x, [[0.5, 0.5, 0.5], [1.5, 0.5, 0.5]], atol=1e-14)
    assert sets["group_1"].all()


def test_a_mesh_that_cannot_be_read_is_one_sentence(tmp_path):
    (tmp_path / "bad.msh").write_text("not a mesh\n")
    with pytest.raises(pd.CaseError, match="Cannot read the mesh"):
        whole(pd.Mesh(tmp_path / "bad.msh"))


# --- regions, influence, schedules


def test_regions_combine():
    x = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]
    left, low = region.Slab("x", high=0.5), region.Box((-1.0, -1.0), (2.0, 0.5))
    assert (left | low).mask(view(x)).tolist() == [True, True, True, False]
    assert (left & low).mask(view(x)).tolist() == [True, False, False, False]
    assert (~left).mask(view(x)).tolist() == [False, True, False, True]
    assert region.Nearest((0.9, 0.8)).mask(view(x)).tolist() == [False, False, False, True]
    assert region.Nearest((0.5, 0.0)).mask(view(x)).tolist() == [True, True, False, False]
    assert region.Where(lambda x: x[:, 0] + x[:, 1] > 1.5).mask(view(x)).tolist() == [False, False, False, True]
    assert region.Named("a").mask(view(x, a=np.array([True, False, False, True]))).tolist() == [
        True,
        False,
        False,
        True,
    ]
    with pytest.raises(pd.CaseError, match=r"no set 'b'; the particles have \['a'\]"):
        region.Named("b").mask(view(x, a=np.zeros(4, bool)))


@pytest.mark.parametrize(("name", "face"), [("a +y", "'+y', 'a'"), ("-x", "'-x'")])
def test_a_side_is_no_set(name, face):
    x = np.zeros((2, 2))
    with pytest.raises(pd.CaseError, match="the name of a side") as refused:
        region.Named(name).mask(view(x, a=np.ones(2, dtype=bool)))
    assert f"pd.region.Face({face}) instead" in str(refused.value)
    with pytest.raises(pd.CaseError, match=r"no set 'b \+y'; the particles have \['a'\]"):
        region.Named("b +y").mask(view(x, a=np.ones(2, dtype=bool)))


@pytest.mark.parametrize("name", ["Constant", "Linear", "Cubic", "Gaussian"])
def test_influence_starts_at_one_and_does_not_grow(name):
    s = np.linspace(0.0, 1.0, 101)
    omega = getattr(pd.influence, name)()(s)
    assert omega[0] == pytest.approx(1.0)
    assert np.all(np.diff(omega) <= 1e-15)
    assert omega[-1] >= 0.0


def test_schedules():
    table = pd.Table([0.0, 0.5, 1.0], [0.0, 1.0, -1.0])
    assert [table(t) for t in (0.25, 0.5, 0.75)] == [0.5, 1.0, 0.0]
    assert (pd.Ramp()(0.3), pd.Hold()(0.3)) == (0.3, 1.0)
    with pytest.raises(pd.CaseError, match="ascending"):
        pd.Table([0.0, 0.0], [1.0, 2.0])


# --- conditions


def test_loads_add_up_to_what_was_declared():
    right = region.Slab("x", low=2.5)
    totals = {
        "force": (pd.Force(right, y=-12.0), [0.0, -12.0]),
        "body force": (pd.BodyForce(region.All(), x=3.0), [3.0 * 9.0 * 2.0, 0.0]),
        "layer": (pd.Traction(right, x=5.0, normal=(1.0, 0.0)), [5.0 * 3.0 * 2.0, 0.0]),
        "consistent": (
            pd.Traction(right, x=5.0, y=1.0, normal=(1.0, 0.0), distribution="consistent"), [30.0, 6.0],
        ),
        "pressure": (pd.Pressure(right, 5.0, normal=(2.0, 0.0)), [-30.0, 0.0]),
    }  # fmt: skip
    for name, (condition, total) in totals.items():
        _, loads, _ = loaded([condition], horizon=1.015)
        assert np.allclose(loads.forces(1.0).sum(axis=0), total, atol=1e-12), name
        assert np.allclose(loads.forces(0.25).sum(axis=0), np.array(total) / 4.0, atol=1e-12), name


def test_displacements_follow_numbers_schedules_and_functions():
    left, right = region.Slab("x", high=0.5), region.Slab("x", low=2.5)
    supports, _, problem = loaded(
        [
            pd.Displacement(left, x=2.0, schedule=pd.Table([0.0, 1.0], [1.0, 3.0])),
            pd.Displacement(left, y=1.0),
            pd.Displacement(right, x=lambda x, t: t * x[:, 1]),
        ]
    )
    u = supports.prescribed(0.5)
    x = problem.body.cloud.x
    assert np.allclose(u[x[:, 0] < 0.5], [4.0, 0.5])
    assert np.allclose(u[x[:, 0] > 2.5, 0], 0.5 * x[x[:, 0] > 2.5, 1])
    assert supports.fixed.sum() == 6 * 3


@pytest.mark.parametrize(
    ("point", "inside"),
    [((4.0, 1.0), True), ((2.7, 0.5), True), ((2.0, 0.5), False), ((5.0, 1.0), False), ((4.0, 4000.0), False)],
)
def test_a_point_outside_of_the_body_is_refused(point, inside, tmp_path):
    """Corners and the rim of a hole are in the body, its middle is not."""
    lattice = pd.Lattice((0.0, 0.0), (4.0, 1.0), 0.125, cut=region.Sphere((2.0, 0.5), 0.3))
    case = pd.Case(
        lattice, material=pd.LinearElastic(1.0, 0.0), conditions=[pd.Clamp("-x"), pd.Traction("+x", x=0.1)],
        history={"u": pd.At(point, pd.displacement, "x")},
    )  # fmt: skip
    if inside:
        assert pd.run(case, tmp_path).history["u"][-1] > 0.0
        return
    with pytest.raises(pd.CaseError, match="of At is not in the body: the nearest particle is"):
        pd.run(case, tmp_path)
    assert not any(tmp_path.iterdir())


def test_a_point_on_two_bodies_that_differ_is_doubtful(tmp_path):
    """One body has slid on the other; ``At`` of their common corner is a mean of both."""
    parts = {"a": pd.LatticeNodes((0.0, 0.0), (2.0, 1.0), 0.25), "b": pd.LatticeNodes((0.0, 1.0), (2.0, 2.0), 0.2)}
    on_both = {name: region.Named(name) & region.Nearest((1.0, 1.0)) for name in parts}
    run = pd.run(
        pd.Case(
            pd.Bodies(parts), material=pd.LinearElastic(1.0, 0.3),
            conditions=[pd.Displacement("a", x=0.0, y=0.0), pd.Displacement("b", x=0.5, y=0.0)],
            history={
                "both": pd.At((1.0, 1.0), pd.displacement, "x"), "still": pd.At((1.0, 1.0), pd.displacement, "y"),
                **{name: pd.Mean(pd.displacement, "x", place) for name, place in on_both.items()},
            },
        ),
        tmp_path,
    )  # fmt: skip
    assert (run.history["a"][-1], run.history["b"][-1]) == (0.0, 0.5)
    assert set(run.doubts) == {"both"}
    assert "particles of several bodies, with values from 0 to 0.5" in run.doubts["both"]


def test_round_off_at_a_point_on_two_bodies_is_not_doubtful(tmp_path):
    """Tied blocks under tension have no shear stress; what is left of it differs between both at their surface."""
    parts = {"a": pd.LatticeNodes((0.0, 0.0), (2.0, 1.0), 0.25), "b": pd.LatticeNodes((0.0, 1.0), (2.0, 2.0), 0.25)}
    run = pd.run(
        pd.Case(
            pd.Bodies(parts), material=pd.LinearElastic(1.0, 0.3),
            conditions=[
                pd.Displacement("a -y", y=0.0), pd.Displacement("a -x", x=0.0), pd.Displacement("b -x", x=0.0),
                pd.Tied("a +y", "b -y"), pd.Traction("b +y", y=0.01),
            ],
            history={
                "shear": pd.At((1.0, 1.0), pd.stress, "xy"), "across": pd.At((1.0, 1.0), pd.stress, "xx"),
            },
        ),
        tmp_path,
    )  # fmt: skip
    assert not run.doubts


RANKS = """
import sys
import pdpetsc as pd
for x in (4.0, 5.0):
    case = pd.Case(
        pd.Lattice((0.0, 0.0), (4.0, 1.0), 0.125), material=pd.LinearElastic(1.0, 0.0),
        conditions=[pd.Clamp("-x"), pd.Traction("+x", x=0.1)], history={"u": pd.At((x, 1.0), pd.displacement, "x")},
    )
    try:
        print(f"found {pd.run(case, sys.argv[1]).history['u'][-1]:.6f}")
    except pd.CaseError as error:
        print(f"found {error}")
"""


def test_ranks_that_own_no_particle_of_a_layer_or_near_a_point(tmp_path):
    """A clamped side and a corner, each on one of two ranks."""
    lines = script_on(2, RANKS, tmp_path).splitlines()
    first, second = [line for line in lines if line.startswith("found")][:2]
    assert 0.38 < float(first.split()[1]) < 0.42
    assert "of At is not in the body" in second


def test_quantities_of_interest():
    *_, problem = loaded(
        [pd.Displacement(region.Slab("x", high=0.5), x=0.0, y=0.0)], material=pd.LinearElastic(E=10.0, nu=0.0)
    )
    x = problem.body.cloud.x
    u = 0.01 * x * [1.0, 0.0]
    solution = Solution(problem, u, 1.0, 1)
    assert pd.Mean(pd.displacement, "x").evaluate(solution) == pytest.approx(0.015)
    assert pd.At((2.75, 0.25), pd.displacement, "x").evaluate(solution) == pytest.approx(0.0275)
    assert pd.Mean(pd.stress, "xx").evaluate(solution) == pytest.approx(0.1)
    assert pd.StrainEnergy().evaluate(solution) == pytest.approx(0.5 * 0.1 * 0.01 * 9.0 * 2.0)
    assert pd.RelativeError(pd.displacement, lambda x, t: 0.02 * x * [1.0, 0.0]).evaluate(solution) == pytest.approx(
        0.5
    )
    assert pd.LargestError(pd.displacement, lambda x, t: 0.0 * x).evaluate(solution) == pytest.approx(0.0275)
    f = problem.internal_force(problem.state(u))
    assert pd.Reaction("x").evaluate(solution) == pytest.approx(f[x[:, 0] < 0.5, 0].sum())
    with pytest.raises(pd.CaseError, match="no component 'z'"):
        pd.Mean(pd.displacement, "z").evaluate(solution)
