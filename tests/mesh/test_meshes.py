"""Particles from meshes and text clouds: formats, sets, faces, damaged files."""

import contextlib
import itertools
import time
from pathlib import Path

import meshio
import netCDF4
import numpy as np
import pytest
import sympy

import pdpetsc as pd
from pdpetsc.declare import abaqus as abaqus_format
from pdpetsc.declare import cells, curved, files, formats
from pdpetsc.declare import exodus as exodus_format
from pdpetsc.declare.cells import SIMPLICES
from tests.declare.test_scene import whole

# The hexahedron in six pyramids around its centre, node 8.
PYRAMIDS = [(0, 3, 2, 1, 8), (4, 5, 6, 7, 8), (0, 1, 5, 4, 8), (1, 2, 6, 5, 8), (2, 3, 7, 6, 8), (3, 0, 4, 7, 8)]
WEDGES = [(0, 1, 2, 4, 5, 6), (0, 2, 3, 4, 6, 7)]
PIECES = {
    "line": [(0, 1)],
    "quad": [(0, 1, 2, 3)],
    "triangle": [(0, 1, 2), (0, 2, 3)],
    "hexahedron": [tuple(range(8))],
    "wedge": WEDGES,
    "tetra": SIMPLICES["hexahedron"],
    "pyramid": PYRAMIDS,
}


def box(kind, counts, map_of=None):
    """Return points and cells of a box of unit cells, each cut into pieces of a kind, in an affine map."""
    dim = len(counts)
    corners = {
        1: [(0,), (1,)],
        2: [(0, 0), (1, 0), (1, 1), (0, 1)],
        3: [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)],
    }[dim]
    shape = [n + 1 for n in counts]
    points = np.array(list(itertools.product(*[range(n) for n in shape])), dtype=float)
    cells = []
    for origin in itertools.product(*[range(n) for n in counts]):
        nodes = [int(np.ravel_multi_index(np.add(origin, c), shape)) for c in corners]
        if kind == "pyramid":
            nodes.append(len(points))
            points = np.vstack([points, np.add(origin, 0.5)])
        cells += [[nodes[k] for k in piece] for piece in PIECES[kind]]
    if map_of is not None:
        points = points @ map_of.T
    return points, cells


def written(path, points, blocks, **more):
    """Write a mesh with meshio, points in three coordinates."""
    full = np.zeros((len(points), 3))
    full[:, : points.shape[1]] = points
    meshio.write(path, meshio.Mesh(full, blocks, **more))
    return path


@pytest.mark.parametrize("kind", list(PIECES))
def test_free_faces_of_a_box_are_its_silhouette(tmp_path, kind, rng):
    counts = {"line": (5,), "quad": (4, 3), "triangle": (4, 3)}.get(kind, (3, 2, 2))
    dim = len(counts)
    A = np.eye(dim) + 0.3 * rng.uniform(-1.0, 1.0, (dim, dim)) if dim > 1 else np.eye(1)
    points, cells = box(kind, counts, A)
    # Some cells are turned round, as files with both orientations have them.
    if kind in ("tetra", "triangle"):
        cells[1] = [cells[1][1], cells[1][0], *cells[1][2:]]
    path = written(tmp_path / "box.vtk", points, [(kind, cells)])
    depth = 0.5 if dim < 3 else 1.0
    mesh = pd.Mesh(path, thickness=0.5)
    edges = A * np.array(counts, dtype=float)
    for _ in range(5):
        n = rng.standard_normal(dim)
        n /= np.linalg.norm(n)
        if dim == 1:
            silhouette = 1.0
        elif dim == 2:
            silhouette = sum(abs(edges[0, k] * n[1] - edges[1, k] * n[0]) for k in range(2))
        else:
            silhouette = sum(abs(np.cross(edges[:, k], edges[:, k - 1]) @ n) for k in range(3))
        parts = np.concatenate([mesh.faces(part, 3, n) for part in range(3)])
        assert len(parts) == len(cells)
        assert parts.sum() == pytest.approx(depth * silhouette, rel=1e-12)
    # The faces are those of the cells at them.
    if dim > 1:
        x, _, _ = whole(pd.Mesh(written(tmp_path / "straight.vtk", *[(b := box(kind, counts))[0], [(kind, b[1])]])))
        along = np.eye(dim)[0]
        face = pd.Mesh(tmp_path / "straight.vtk").faces(0, 1, along)
        assert face.sum() == pytest.approx(np.prod(counts[1:]))
        assert x[face > 0.0, 0].min() > counts[0] - 1.0


def test_faces_of_mixed_and_collapsed_cells(tmp_path):
    # A hexahedron, a pair of wedges beside it, one as a hexahedron with two nodes twice, and a pyramid on top.
    points, (one, two) = box("hexahedron", (2, 1, 1))
    points = np.vstack([points, [0.5, 0.5, 2.0]])
    wedges = [[two[k] for k in piece] for piece in WEDGES]
    a, b, c, d, e, f = wedges[1]
    blocks = [
        ("hexahedron", [one, [a, b, c, c, d, e, f, f]]),
        ("wedge", wedges[:1]),
        ("pyramid", [[*one[4:], len(points) - 1]]),
    ]
    mesh = pd.Mesh(written(tmp_path / "mixed.vtk", points, blocks))
    _, volume, _ = whole(mesh)
    assert volume == pytest.approx([1.0, 0.5, 0.5, 1.0 / 3.0])
    for axis, sign, area in ((0, 1, 1.5), (0, -1, 1.5), (1, 1, 2.5), (1, -1, 2.5), (2, -1, 2.0), (2, 1, 2.0)):
        assert mesh.faces(0, 1, sign * np.eye(3)[axis]).sum() == pytest.approx(area)


def test_particles_without_faces_say_so():
    class Own(pd.Arrays.__base__):
        def chunk(self, part, parts):
            raise NotImplementedError

    with pytest.raises(pd.CaseError, match=r"Own has no known surface.* give each Traction a normal"):
        Own().faces(0, 1, np.ones(2))


# --- sets


def test_gmsh_groups_of_boundary_lines_are_the_cells_that_own_them(tmp_path):
    points, cells = box("quad", (3, 2))
    right = [[n, n + 1] for n in range(9, 11)]
    path = tmp_path / "plate.msh"
    full = np.column_stack([points, np.zeros(len(points))])
    tags = [np.full(6, 1), np.full(2, 5), np.full(1, 9)]
    mesh = meshio.Mesh(
        full,
        [("quad", cells), ("line", right), ("line", [[0, 1]])],
        cell_data={"gmsh:physical": tags, "gmsh:geometrical": tags},
        field_data={"body": np.array([1, 2]), "right": np.array([5, 1])},
    )
    meshio.gmsh.write(path, mesh, fmt_version="2.2")
    x, _, sets = whole(pd.Mesh(path))
    assert sets["body"].all()
    assert np.array_equal(sets["right"], x[:, 0] > 2.0)
    assert np.array_equal(sets["facets_9"], (x == 0.5).all(axis=1))


def test_gmsh_4_groups_of_faces_are_the_cells_that_own_them(tmp_path):
    path = tmp_path / "cube.msh"
    path.write_text(
        "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$PhysicalNames\n2\n2 7 \"foot\"\n3 8 \"body\"\n$EndPhysicalNames\n"
        "$Entities\n0 0 1 1\n1 0 0 0 1 1 0 1 7 0\n1 0 0 0 1 1 1 1 8 1 1\n$EndEntities\n"
        "$Nodes\n1 5 1 5\n3 1 0 5\n1\n2\n3\n4\n5\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n0 0 -1\n$EndNodes\n"
        "$Elements\n2 3 1 3\n2 1 2 1\n1 1 2 4\n3 1 4 2\n2 1 2 3 4\n3 1 3 2 5\n$EndElements\n"
    )  # fmt: skip
    _, volume, sets = whole(pd.Mesh(path))
    assert volume == pytest.approx([1 / 6, 1 / 6])
    assert sets["body"].tolist() == [True, True]
    assert sets["foot"].tolist() == [True, False]


ABAQUS = """*HEADING
two hexahedra of second order and a plate
*NODE, NSET=everything
1, 0, 0, 0
2, 1, 0, 0
3, 1, 1, 0
4, 0, 1, 0
5, 0, 0, 1
6, 1, 0, 1
7, 1, 1, 1
8, 0, 1, 1
9, 2, 0, 0
10, 2, 1, 0
11, 2, 0, 1
12, 2, 1, 1
*ELEMENT, TYPE=C3D8R, ELSET=one
1, 1, 2, 3, 4,
5, 6, 7, 8
*ELEMENT, TYPE=C3D8, ELSET=two
2, 2, 9, 10, 3, 6, 11, 12, 7
*ELEMENT, TYPE=S4, ELSET=skin
11, 9, 10, 12, 11
*NSET, NSET=end, GENERATE
9, 12, 1
*ELSET, ELSET=both
one, two
*SURFACE, NAME=left, TYPE=ELEMENT
one, S6
*SURFACE, NAME=top
1, S2
2, S2
*ELEMENT OUTPUT
S
"""


def test_abaqus_sets_surfaces_and_skins(tmp_path):
    path = tmp_path / "bar.inp"
    path.write_text(ABAQUS)
    x, volume, sets = whole(pd.Mesh(path))
    assert volume == pytest.approx([1.0, 1.0])
    assert x[:, 0] == pytest.approx([0.5, 1.5])
    expected = {
        "one": [True, False], "two": [False, True], "skin": [False, True], "end": [False, True],
        "both": [True, True], "left": [True, False], "top": [True, True], "everything": [True, True],
    }  # fmt: skip
    assert {name: flags.tolist() for name, flags in sets.items()} == expected
    for line, wrong, message in (
        ("C3D8R", "C3D7", "type C3D7"),
        ("5, 6, 7, 8\n", "5, 6, 7\n", "do not have 8 nodes"),
        ("9, 12, 1", "9, 13, 1", "names node 13"),
        ("1, 1, 2, 3, 4,", "1, 1, 2, 3, 99,", "node 99"),
        ("*HEADING", "*SYSTEM\n1, 1, 1\n*HEADING", r"\*SYSTEM"),
        ("2, 2, 9, 10, 3, 6, 11, 12, 7", "2, 2, 2, 3, 3, 6, 6, 7, 7", "1 cells of kind hexahedron in .* no volume"),
    ):
        path.write_text(ABAQUS.replace(line, wrong, 1))
        with pytest.raises(pd.CaseError, match=message):
            whole(pd.Mesh(path))


def test_a_name_of_cells_and_of_facets_means_both_apart(tmp_path):
    path = tmp_path / "bar.inp"
    path.write_text(ABAQUS.replace("NAME=top", "NAME=one").replace("NSET=end", "NSET=left"))
    _, _, sets = whole(pd.Mesh(path))
    assert sets["one"].tolist() == [True, False]
    assert sets["one facets"].tolist() == [True, True]
    assert sets["left"].tolist() == [True, False]
    assert sets["left nodes"].tolist() == [False, True]


def test_abaqus_parts_and_included_files(tmp_path):
    mesh = ABAQUS[ABAQUS.index("*NODE") :]
    (tmp_path / "mesh.inc").write_text(mesh)
    part = "*PART, NAME=P\n*INCLUDE, INPUT=mesh.inc\n*END PART\n*ASSEMBLY, NAME=A\n*INSTANCE, NAME=I, PART=P\n"
    rest = "*END INSTANCE\n*NODE\n1, 9, 9, 9\n*NSET, NSET=far, INSTANCE=I\n2\n*NSET, NSET=ref\n1\n*END ASSEMBLY\n"
    path = tmp_path / "bar.inp"
    path.write_text(part + rest)
    _, volume, sets = whole(pd.Mesh(path))
    assert volume == pytest.approx([1.0, 1.0])
    assert sets["far"].all()
    assert "ref" not in sets
    for text, message in (
        (part + "0.0, 1.0, 0.0\n" + rest, "moves an instance"),
        ("*PART, NAME=Q\n*END PART\n" + part + rest, "several parts"),
        ("*INCLUDE, INPUT=bar.inp\n", "include each other"),
        ("*INCLUDE, INPUT=none.inp\n", "No such file"),
    ):
        path.write_text(text)
        with pytest.raises(pd.CaseError, match=message):
            whole(pd.Mesh(path))


TWO_SQUARES = """*NODE
1, 0, 0
2, 1, 0
3, 2, 0
4, 0, 1
5, 1, 1
6, 2, 1
*ELEMENT, TYPE=CPS4, ELSET=Set-1
1, 1, 2, 5, 4
2, 2, 3, 6, 5
"""


def test_a_set_of_the_assembly_is_not_that_of_the_part_with_its_name(tmp_path):
    """As in decks of Abaqus/CAE, which calls the first set of both ``Set-1``."""
    path = tmp_path / "plate.inp"
    assembly = "*ASSEMBLY, NAME=A\n*INSTANCE, NAME=P-1, PART=P\n*END INSTANCE\n"
    sets = "*ELSET, ELSET=Set-1, INSTANCE=P-1\n2\n*ELSET, ELSET=both, INSTANCE=P-1\nP-1.Set-1\n*END ASSEMBLY\n"
    path.write_text(f"*PART, NAME=P\n{TWO_SQUARES}*END PART\n{assembly}{sets}")
    _, _, found = whole(pd.Mesh(path))
    assert found["Set-1"].tolist() == [False, True]
    assert found["P-1.Set-1"].all()
    assert found["both"].all()


def test_sets_of_abaqus_go_on_in_other_letters_and_have_the_nodes_of_elements(tmp_path):
    path = tmp_path / "plate.inp"
    path.write_text(
        f"{TWO_SQUARES}*ELSET, ELSET=Right\n1\n*ELSET, ELSET=RIGHT\n2\n*ELSET, ELSET=one\n1\n*NSET, NSET=n, ELSET=One\n"
    )
    _, _, found = whole(pd.Mesh(path))
    assert found["Right"].all()
    assert "RIGHT" not in found
    assert found["n"].any()
    path.write_text(TWO_SQUARES + "*ELEMENT, TYPE=CPS4, INPUT=more.txt\n")
    with pytest.raises(pd.CaseError, match=r"\*ELEMENT reads the file 'more.txt'"):
        whole(pd.Mesh(path))


def test_groups_of_quadratic_boundaries_and_of_single_nodes(tmp_path):
    # Two triangles of second order and the three nodes of one of their edges.
    points = np.array([[0, 0], [2, 0], [2, 2], [0, 2], [1, 0], [2, 1], [1, 1], [1, 2], [0, 1]], dtype=float)
    tags = [np.array([1, 1]), np.array([5]), np.array([6])]
    mesh = meshio.Mesh(
        np.column_stack([points, np.zeros(9)]),
        [("triangle6", [[0, 1, 2, 4, 5, 6], [0, 2, 3, 6, 7, 8]]), ("line3", [[2, 3, 7]]), ("vertex", [[1]])],
        cell_data={"gmsh:physical": tags, "gmsh:geometrical": tags},
        field_data={"top": np.array([5, 1]), "corner": np.array([6, 0])},
    )
    meshio.gmsh.write(tmp_path / "plate.msh", mesh, fmt_version="2.2", binary=False)
    _, volume, sets = whole(pd.Mesh(tmp_path / "plate.msh"))
    assert volume.tolist() == [2.0, 2.0]
    assert sets["top"].tolist() == [False, True]
    assert sets["corner"].tolist() == [True, False]


def test_med_groups_of_cells_faces_and_nodes(tmp_path):
    points, cells = box("hexahedron", (2, 1, 1))
    mesh = meshio.Mesh(
        points,
        [("hexahedron", cells), ("quad", [[0, 2, 3, 1]])],
        cell_data={"cell_tags": [np.array([-1, -2]), np.array([-3])]},
        point_data={"point_tags": np.array([0] * 8 + [2] * 4)},
    )
    mesh.cell_tags = {-1: ["left", "all"], -2: ["all"], -3: ["foot"]}
    mesh.point_tags = {2: ["end"]}
    meshio.med.write(tmp_path / "box.med", mesh)
    _, volume, sets = whole(pd.Mesh(tmp_path / "box.med"))
    assert volume == pytest.approx([1.0, 1.0])
    assert {name: flags.tolist() for name, flags in sets.items()} == {
        "left": [True, False], "all": [True, True], "foot": [True, False], "end": [False, True],
    }  # fmt: skip


def exodus(path, names=True):
    """Write an Exodus file of two tetrahedra of second order with two node sets and two side sets."""
    points, _ = box("hexahedron", (1, 1, 1))
    tetra = np.array([[0, 4, 2, 1], [4, 6, 2, 7]])
    middles, nodes = list(points), []
    for cell in tetra:
        edges = [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)]
        nodes.append([*cell, *range(len(middles), len(middles) + 6)])
        middles += [0.5 * (points[cell[a]] + points[cell[b]]) for a, b in edges]
    with netCDF4.Dataset(path, "w", format="NETCDF3_64BIT_OFFSET") as file:
        sizes = {
            "num_nodes": len(middles), "num_dim": 3, "num_el_blk": 2, "num_el_in_blk1": 1, "num_nod_per_el1": 10,
            "num_node_sets": 2, "num_side_sets": 2, "len_string": 33, "one": 1,
        }  # fmt: skip
        for name, size in sizes.items():
            file.createDimension(name, size)
        for axis, column in zip("xyz", np.array(middles).T, strict=True):
            file.createVariable(f"coord{axis}", "f8", ("num_nodes",))[:] = column
        for b in (1, 2):
            connect = file.createVariable(f"connect{b}", "i4", ("num_el_in_blk1", "num_nod_per_el1"))
            connect.elem_type = "TETRA10"
            connect[:] = [np.array(nodes[b - 1]) + 1]
        for short, size, ids in (("eb", "num_el_blk", [10, 20]), ("ns", "num_node_sets", [3, 4]),
                                 ("ss", "num_side_sets", [5, 6])):  # fmt: skip
            file.createVariable(f"{short}_prop1", "i4", (size,))[:] = ids
            text = file.createVariable(f"{short}_names", "S1", (size, "len_string"))
            if names and short != "eb":
                for k, word in enumerate(("left", "right")):
                    text[k, : len(word)] = np.array(list(word), dtype="S1")
        # A corner of the first and a middle node of the second cell.
        for name, values in (("node_ns1", [1]), ("node_ns2", [nodes[1][-1] + 1])):
            file.createVariable(name, "i4", ("one",))[:] = values
        for name, values in (("elem_ss1", [1]), ("side_ss1", [1]), ("elem_ss2", [2]), ("side_ss2", [4])):
            file.createVariable(name, "i4", ("one",))[:] = values
    return path


def test_exodus_sets_keep_apart_without_names(tmp_path):
    _, volume, sets = whole(pd.Mesh(exodus(tmp_path / "unnamed.g", names=False)))
    assert volume == pytest.approx([1 / 6, 1 / 6])
    assert {name: flags.tolist() for name, flags in sets.items()} == {
        "group_10": [True, False], "group_20": [False, True],
        "node_set_3": [True, False], "node_set_4": [False, True],
        "side_set_5": [True, False], "side_set_6": [False, True],
    }  # fmt: skip


def test_exodus_names_of_node_and_side_sets_may_be_the_same(tmp_path):
    path = exodus(tmp_path / "named.bin")
    with pytest.raises(pd.CaseError, match=r"Cannot tell the format .* Use Mesh\(format="):
        whole(pd.Mesh(path))
    _, _, sets = whole(pd.Mesh(path, format="exodus"))
    assert set(sets) == {"group_10", "group_20", "left", "right", "left nodes", "right nodes"}
    assert sets["left"].tolist() == sets["left nodes"].tolist() == [True, False]
    with pytest.raises(pd.CaseError, match="is one of gmsh, abaqus"):
        pd.Mesh(path, format="stl")


@pytest.mark.parametrize(
    ("cells", "message"),
    [
        ([[0, 1, 2, 7]], "name nodes that are not among the 4"),
        ([[0, 1, -2, 3]], "name nodes that are not among the 4"),
        ([[0, 1, 2, 2]], "1 cells of kind tetra in .* have no volume"),
    ],
)
def test_cells_of_no_body_are_refused(tmp_path, cells, message):
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)
    path = tmp_path / "bad.vtu"
    meshio.vtu.write(path, meshio.Mesh(points, [("tetra", [[0, 1, 2, 3], *cells])]), binary=False)
    with pytest.raises(pd.CaseError, match=message):
        whole(pd.Mesh(path))


def test_nastran_property_numbers_are_groups(tmp_path):
    path = tmp_path / "plate.bdf"
    path.write_text(
        "BEGIN BULK\nGRID,1,,0.0,0.0,0.0\nGRID,2,,1.0,0.0,0.0\nGRID,3,,1.0,1.0,0.0\nGRID,4,,0.0,1.0,0.0\n"
        "CTRIA3,1,7,1,2,3\nCTRIA3,2,8,1,3,4\nENDDATA\n"
    )
    _, volume, sets = whole(pd.Mesh(path))
    assert volume.tolist() == [0.5, 0.5]
    assert sets["group_7"].tolist() == [True, False]
    path.write_text(path.read_text().replace("ENDDATA", ""))
    with pytest.raises(pd.CaseError, match="BEGIN BULK and ENDDATA"):
        whole(pd.Mesh(path))
    path.write_text(path.read_text().replace("GRID,4,", "GRID,4,3") + "ENDDATA\n")
    with pytest.raises(pd.CaseError, match="coordinate system"):
        whole(pd.Mesh(path))


# --- text clouds


def test_headers_name_the_columns_of_text_clouds(tmp_path):
    path = tmp_path / "cloud.txt"
    for header in ("header: x y status volume block_id\n", ""):
        path.write_text(header + "0 0 9 0.5 1\n1 0 9 0.25 2\n0 1 9 0.5 2\n")
        if header:
            x, volume, sets = whole(pd.TextFile(path))
            assert x.tolist() == [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]
            assert volume.tolist() == [0.5, 0.25, 0.5]
            assert sets["block_2"].tolist() == [False, True, True]
        else:
            with pytest.raises(pd.CaseError, match=r"block 0\.5 in row 1"):
                whole(pd.TextFile(path))
    path.write_text("# x y volume block\n0 0 0.5 1\n1 1 0.25 2\n")
    assert whole(pd.TextFile(path))[1].tolist() == [0.5, 0.25]
    for text, message in (
        ("0 0 0 1 0.5 7\n", "6 columns, not 1 to 3 coordinates"),
        ("header: x y block_id\n0 0 1\n", "header of .* is x y block_id. It must name"),
        ("header: x y block_id volume\n0 0 0 1 0.5\n", "5 columns, and its header names 4"),
        ("", "no lines of numbers"),
    ):
        path.write_text(text)
        with pytest.raises(pd.CaseError, match=message):
            whole(pd.TextFile(path))
    nodes = tmp_path / "left.txt"
    nodes.write_text("header: global_id\n1\n")
    path.write_text("header: x y block_id volume\n0 0 1 0.5\n1 0 1 0.5\n")
    assert whole(pd.TextFile(path, {"left": nodes}))[2]["left"].tolist() == [True, False]
    nodes.write_text("1.5\n")
    with pytest.raises(pd.CaseError, match="not whole"):
        whole(pd.TextFile(path, {"left": nodes}))


# --- damaged files


def samples(folder):
    """Return a small mesh in every format."""
    points, cells = box("hexahedron", (2, 1, 1))
    groups = {"gmsh:physical": [np.array([1, 2])], "gmsh:geometrical": [np.array([1, 1])]}
    mesh = meshio.Mesh(points, [("hexahedron", cells)])
    grouped = meshio.Mesh(points, [("hexahedron", cells)], cell_data=groups)
    names = {}
    for ending, write in {
        "22.msh": lambda p: meshio.gmsh.write(p, grouped, "2.2", binary=False),
        "22b.msh": lambda p: meshio.gmsh.write(p, grouped, "2.2", binary=True),
        "41.msh": lambda p: meshio.gmsh.write(p, grouped, "4.1", binary=False),
        "41b.msh": lambda p: meshio.gmsh.write(p, grouped, "4.1", binary=True),
        "a.vtk": lambda p: meshio.vtk.write(p, mesh, binary=False),
        "b.vtk": lambda p: meshio.vtk.write(p, mesh, binary=True),
        "a.vtu": lambda p: meshio.vtu.write(p, mesh, binary=False),
        "b.vtu": lambda p: meshio.vtu.write(p, mesh),
        "a.bdf": lambda p: meshio.nastran.write(p, mesh),
        "a.med": lambda p: meshio.med.write(p, mesh),
        "a.xdmf": lambda p: meshio.xdmf.write(p, mesh, data_format="XML"),
        "a.inp": lambda p: p.write_text(ABAQUS),
        "a.g": exodus,
        "a.exo": lambda p: meshio.exodus.write(p, mesh),
    }.items():
        names[ending] = folder / ending
        write(names[ending])
    return names


def test_every_format_gives_the_same_body(tmp_path):
    for name, path in samples(tmp_path).items():
        x, volume, _ = whole(pd.Mesh(path))
        expected = [1 / 6, 1 / 6] if name == "a.g" else [1.0, 1.0]
        assert volume == pytest.approx(expected), name
        if name != "a.g":
            assert x[:, 0] == pytest.approx([0.5, 1.5]), name


def mutated(data, rng):
    """Return bytes with some flipped, cut off, numbers replaced, or lines lost."""
    data = bytearray(data)
    kind = rng.integers(4)
    if kind == 0:
        for at in rng.integers(0, len(data), rng.integers(1, 8)):
            data[at] = rng.integers(256)
    elif kind == 1:
        del data[rng.integers(len(data)) :]
    elif kind == 2:
        digits = [k for k, byte in enumerate(data) if 48 <= byte <= 57]
        for at in rng.choice(digits, size=min(3, len(digits)), replace=False) if digits else ():
            data[at : at + 1] = [b"-1", b"99999999999", b"0", b"nan", b"1e9"][rng.integers(5)]
    else:
        lines = bytes(data).split(b"\n")
        del lines[rng.integers(len(lines))]
        data = bytearray(b"\n".join(lines))
    return bytes(data)


def test_damaged_meshes_end_as_meshes_or_as_sentences(tmp_path, rng, monkeypatch):
    limit = 2.0
    monkeypatch.setattr(formats, "START", limit)
    read = refused = 0
    for name, path in samples(tmp_path).items():
        whole(pd.Mesh(path), 1)
        original = path.read_bytes()
        damaged = tmp_path / f"damaged.{name.split('.')[1]}"
        for _ in range(15):
            damaged.write_bytes(mutated(original, rng))
            before = time.perf_counter()
            try:
                x, volume, _ = whole(pd.Mesh(damaged), 1)
                assert np.isfinite(x).all()
                assert (volume > 0.0).all()
                read += 1
            except pd.CaseError as error:
                assert "\n" not in str(error)
                refused += 1
            assert time.perf_counter() - before < limit + 1.0, name
    assert read > 10
    assert refused > 100


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="the memory of the process is not known here")
def test_a_damaged_number_does_not_take_the_memory(tmp_path):
    for name, place, message in (
        ("22.msh", 0, "need more memory than such a mesh"),
        ("41.msh", 1, "nodes where it says 100000000"),
    ):
        path = samples(tmp_path)[name]
        text = path.read_text(errors="replace")
        head = text.index("$Nodes\n") + len("$Nodes\n")
        count = text[head:].split()[place]
        path.write_text(text[:head] + text[head:].replace(count, "100000000", 1 if place == 0 else 2))
        with pytest.raises(pd.CaseError, match=message):
            whole(pd.Mesh(path))


def test_a_reader_that_does_not_end_is_interrupted(tmp_path, monkeypatch):
    def endless(path):
        while True:
            with contextlib.suppress(Exception):
                time.sleep(0.01)

    monkeypatch.setitem(formats.FORMATS, "gmsh", ((".msh",), endless))
    monkeypatch.setattr(formats, "START", 0.2)
    (tmp_path / "a.msh").write_text("")
    with pytest.raises(pd.CaseError, match="took more than"):
        whole(pd.Mesh(tmp_path / "a.msh"))


def test_damaged_text_clouds_end_as_particles_or_as_sentences(tmp_path, rng):
    original = b"header: x y block_id volume\n0 0 1 0.5\n1.5 0 1 0.5\n0 2 2 0.25\n# end\n1 1 2 0.25\n"
    path, nodes = tmp_path / "cloud.txt", tmp_path / "nodes.txt"
    read = refused = 0
    for _ in range(150):
        path.write_bytes(mutated(original, rng))
        nodes.write_bytes(mutated(b"1\n2\n3\n", rng))
        try:
            x, volume, _ = whole(pd.TextFile(path, {"some": nodes} if rng.integers(2) else {}), 1)
            assert len(x) == len(volume)
            read += 1
        except pd.CaseError as error:
            assert "\n" not in str(error)
            refused += 1
    assert read > 10
    assert refused > 50


@pytest.mark.parametrize("order", ["1, 2, 3\n2, 3, 4, 5", "1, 3, 2\n2, 3, 5, 4"])
def test_curved_beams_have_their_middle_node_anywhere(order, tmp_path):
    """A deck numbers a beam of three nodes end, middle, end; other writers put the middle last."""
    path = tmp_path / "beam.inp"
    nodes = "".join(f"{number}, {float(number - 1)}\n" for number in range(1, 6))
    path.write_text(f"*NODE\n{nodes}*ELEMENT, TYPE=B32\n1, {order}\n")
    chunk = pd.Mesh(path).chunk(0, 1)
    assert chunk.x[:, 0].tolist() == [1.0, 3.0]
    assert chunk.volume.tolist() == [2.0, 2.0]


# Nodes of the sides of elements, from 1 on, as the manuals print them: Exodus II, "Side set node ordering"; Abaqus,
# "Element face identifiers".
SIDES = {
    "exodus": {
        "triangle": ["12", "23", "31"],
        "quad": ["12", "23", "34", "41"],
        "tetra": ["124", "234", "143", "132"],
        "pyramid": ["125", "235", "345", "154", "1432"],
        "wedge": ["1254", "2365", "1463", "132", "456"],
        "hexahedron": ["1265", "2376", "3487", "1584", "1432", "5678"],
    },
    "abaqus": {
        "triangle": ["12", "23", "31"],
        "quad": ["12", "23", "34", "41"],
        "tetra": ["123", "142", "243", "341"],
        "pyramid": ["1234", "152", "253", "354", "451"],
        "wedge": ["123", "465", "1452", "2563", "3641"],
        "hexahedron": ["1234", "5876", "1562", "2673", "3784", "4851"],
    },
}


@pytest.mark.parametrize("kind", SIDES["exodus"])
def test_sides_of_elements_are_those_of_the_manuals(kind):
    def nodes(texts):
        return [{int(letter) - 1 for letter in text} for text in texts]

    facets = [set(corners) for corners in cells.FACETS[kind]]
    assert [facets[place] for place in exodus_format._SIDES[kind]] == nodes(SIDES["exodus"][kind])
    places = [abaqus_format._places(f"S{n + 1}", len(facets))[0] for n in range(len(facets))]
    assert [facets[place] for place in places] == nodes(SIDES["abaqus"][kind])


def plate_with_sides(folder, form, word="", shells=False):
    """Write 3 x 2 quadrilaterals of 1 x 0.5 with the right end, and the nodes of the upper side, by name."""
    x, y = np.meshgrid(np.arange(4.0), 0.5 * np.arange(3), indexing="ij")
    points = np.stack([x.ravel(), y.ravel(), 0.0 * x.ravel()], axis=1)
    quads = np.array([[3 * i + j, 3 * i + j + 3, 3 * i + j + 4, 3 * i + j + 1] for i in range(3) for j in range(2)])
    ends, top = [5, 6], np.flatnonzero(points[:, 1] == 1.0)
    if form == "abaqus":
        lines = ["*NODE", *(f"{n + 1}, {x}, {y}" for n, (x, y, _) in enumerate(points)), "*ELEMENT, TYPE=CPE4"]
        lines += [f"{n + 1}, " + ", ".join(str(node + 1) for node in quad) for n, quad in enumerate(quads)]
        lines += ["*SURFACE, NAME=end", *(f"{n}{word or ', S2'}" for n in ends), "*NSET, NSET=top"]
        lines += [", ".join(str(n + 1) for n in top)]
        (folder / "plate.inp").write_text("\n".join(lines) + "\n")
        return folder / "plate.inp"
    with netCDF4.Dataset(folder / "plate.g", "w", format="NETCDF3_64BIT_OFFSET") as file:
        sizes = {"num_nodes": 12, "num_dim": 3, "num_el_blk": 1, "e": 6, "k": 4, "num_node_sets": 1, "s": 2, "t": 4,
                 "num_side_sets": 1, "len_string": 33}  # fmt: skip
        for name, size in sizes.items():
            file.createDimension(name, size)
        for axis, column in zip("xyz", points.T, strict=True):
            file.createVariable(f"coord{axis}", "f8", ("num_nodes",))[:] = column
        connect = file.createVariable("connect1", "i4", ("e", "k"))
        connect.elem_type = "SHELL4" if shells else "QUAD4"
        connect[:] = quads + 1
        for short, size, label in (("ns", "num_node_sets", "top"), ("ss", "num_side_sets", "end")):
            text = file.createVariable(f"{short}_names", "S1", (size, "len_string"))
            text[0, : len(label)] = np.array(list(label), dtype="S1")
        file.createVariable("node_ns1", "i4", ("t",))[:] = top + 1
        file.createVariable("elem_ss1", "i4", ("s",))[:] = ends
        file.createVariable("side_ss1", "i4", ("s",))[:] = int(word or (4 if shells else 2))
    return folder / "plate.g"


@pytest.mark.parametrize("at", [pd.Mesh, pd.MeshNodes])
@pytest.mark.parametrize(("form", "shells"), [("abaqus", False), ("exodus", False), ("exodus", True)])
def test_loads_act_on_side_sets_and_node_sets(at, form, shells, tmp_path):
    """On these facets alone: not on the other free facets of the cells that they belong to."""
    mesh = at(plate_with_sides(tmp_path, form, shells=shells), thickness=0.25)
    named = pd.region.Named
    case = pd.Case(
        particles=mesh, horizon=2.1, material=pd.LinearElastic(E=10.0, nu=0.3),
        conditions=[
            pd.Displacement(pd.region.Slab("x", high=0.6), x=0.0, y=0.0),
            pd.Traction(named("end"), x=2.0), pd.Pressure(named("end"), 2.0), pd.Pressure(named("top"), 2.0),
        ],
    )  # fmt: skip
    loads = [found for term in pd.prepare(case).problem.terms for found in getattr(term, "resultants", [])]
    np.testing.assert_allclose(
        [force for _, _, force in loads], [[2.0 * 0.25, 0.0], [-2.0 * 0.25, 0.0], [0.0, -2.0 * 3.0 * 0.25]], atol=1e-12
    )
    x, _, sets = whole(mesh)
    assert sets["end"].tolist() == (x[:, 0] > (2.0 if at is pd.Mesh else 2.9)).tolist()


def test_sides_that_are_no_facets_are_refused(tmp_path):
    def prepared(path):
        traction = pd.Traction(pd.region.Named("end"), x=2.0)
        held = pd.Displacement(pd.region.Slab("x", high=0.6), x=0.0, y=0.0)
        case = pd.Case(particles=pd.Mesh(path), horizon=2.1, material=pd.LinearElastic(E=10.0, nu=0.3),
                       conditions=[held, traction])  # fmt: skip
        return pd.prepare(case).problem.terms

    for path in (lambda: plate_with_sides(tmp_path, "abaqus", ", SPOS"), lambda: plate_with_sides(tmp_path, "exodus", 2,
                 shells=True)):  # fmt: skip
        with pytest.raises(pd.CaseError, match="holds no facet of the surface"):
            prepared(path())
    for path, words in (
        (lambda: plate_with_sides(tmp_path, "abaqus", ", S5"), "has the face 'S5' of an element with 4 facets"),
        (lambda: plate_with_sides(tmp_path, "exodus", 5), "has side 5 of a quad"),
    ):
        with pytest.raises(pd.CaseError, match=words):
            prepared(path())
    # Elements without a face: all that is free of them.
    loads = [f for term in prepared(plate_with_sides(tmp_path, "abaqus", ",")) for f in getattr(term, "resultants", [])]
    np.testing.assert_allclose(loads[0][2], [2.0 * (0.5 + 0.5 + 1.0 + 1.0), 0.0], atol=1e-12)


# --- quadratic cells

X, Y, Z = sympy.symbols("x y z")
# Corners of the reference cell of each kind, and the integral of a polynomial over it.
REFERENCE = {
    "triangle": ([(0, 0), (1, 0), (0, 1)], [(X, 0, 1 - Y), (Y, 0, 1)]),
    "quad": ([(0, 0), (1, 0), (1, 1), (0, 1)], [(X, 0, 1), (Y, 0, 1)]),
    "tetra": ([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], [(X, 0, 1 - Y - Z), (Y, 0, 1 - Z), (Z, 0, 1)]),
    "wedge": (
        [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (0, 1, 1)], [(X, 0, 1 - Y), (Y, 0, 1), (Z, 0, 1)],
    ),
    "hexahedron": (
        [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)],
        [(X, 0, 1), (Y, 0, 1), (Z, 0, 1)],
    ),
    "pyramid": (
        [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0.5, 0.5, 1)],
        [(X, Z / 2, 1 - Z / 2), (Y, Z / 2, 1 - Z / 2), (Z, 0, 1)],
    ),
}  # fmt: skip
# Kind with the number of its nodes: how many of the faces with four corners, and the cell, have a node within.
QUADRATIC = [
    "triangle6",
    "quad8",
    "quad9",
    "tetra10",
    "wedge15",
    "wedge18",
    "hexahedron20",
    "hexahedron27",
    "pyramid13",
]


def quadratic(kind, rng):
    """Return the nodes of one cell in the order of VTK in a random quadratic map, its volume and centroid."""
    word = kind.rstrip("0123456789")
    count = int(kind[len(word) :])
    corners, limits = REFERENCE[word]
    x = [np.array(corner, dtype=float) for corner in corners]
    x += [0.5 * (x[a] + x[b]) for a, b in curved.EDGES[word][0]]
    faces = [face for face in cells.FACETS[word] if len(face) == 4]
    if word == "hexahedron":  # VTK: -x, +x, -y, +y, -z, +z
        faces = [(0, 3, 7, 4), (1, 2, 6, 5), (0, 1, 5, 4), (3, 2, 6, 7), (0, 1, 2, 3), (4, 5, 6, 7)]
    within = [np.mean([x[k] for k in face], axis=0) for face in faces] if len(corners[0]) == 3 else []
    if count > len(x):
        x += within
    if count > len(x):
        x.append(np.mean(x[: len(corners)], axis=0))
    assert len(x) == count
    dim = len(corners[0])
    axes = (X, Y, Z)[:dim]
    terms = [a * b for a, b in itertools.combinations_with_replacement(axes, 2)]
    coefficients = [[sympy.Rational(int(c), 1000) for c in row] for row in rng.integers(-150, 151, (dim, len(terms)))]
    bent = [sum(c * t for c, t in zip(row, terms, strict=True)) for row in coefficients]
    image = [axis + part for axis, part in zip(axes, bent, strict=True)]
    jacobian = sympy.Matrix(image).jacobian(axes).det()

    # Gauss points of the reference cell, exact for these polynomials.
    g, w = np.polynomial.legendre.leggauss(8)
    at, weight = {}, np.ones(1)
    for variable, low, high in reversed(limits):
        ends = [np.broadcast_to(sympy.lambdify([*at], end)(*at.values()), weight.shape) for end in (low, high)]
        half = 0.5 * (ends[1] - ends[0])[:, None]
        own = (ends[0][:, None] + half * (g + 1.0)).ravel()
        at = {**{other: np.repeat(values, len(g)) for other, values in at.items()}, variable: own}
        weight = (weight[:, None] * half * w).ravel()

    def integral(integrand):
        return float(weight @ sympy.lambdify(axes, integrand)(*(at[axis] for axis in axes)))

    volume = integral(jacobian)
    centroid = np.array([integral(part * jacobian) for part in image]) / volume
    move = sympy.lambdify(axes, image)
    return np.array([[float(v) for v in move(*node)] for node in x]), volume, centroid


@pytest.mark.parametrize("kind", QUADRATIC)
def test_curved_cells_have_their_volume_centroid_and_surface(kind, tmp_path, rng, monkeypatch):
    x, volume, centroid = quadratic(kind, rng)
    dim = x.shape[1]
    order = np.arange(len(x))
    orders = [order]
    if kind in ("hexahedron20", "hexahedron27", "wedge15", "wedge18"):
        # Exodus has the upright edges before those of the top.
        n, m = (8, 4) if kind.startswith("hexahedron") else (6, 3)
        other = order.copy()
        other[n + m : n + 3 * m] = np.roll(order[n + m : n + 3 * m], m)
        orders.append(other)
    for taken in orders:
        path = tmp_path / "cell.vtk"
        if kind in ("wedge15", "pyramid13"):  # which meshio does not write
            block = formats.block_of(kind, np.arange(len(x))[None])
            data = cells.MeshData(x[taken], [block])
            monkeypatch.setattr(files, "read_mesh", lambda path, form: data)
        else:
            written(path, x[taken], [(kind, [np.arange(len(x))])])
        mesh = pd.Mesh(path)
        found = mesh.chunk(0, 1)
        assert found.volume == pytest.approx([volume], rel=1e-12)
        assert found.x[0] == pytest.approx(centroid, rel=1e-12)
        places, area, particle, _ = mesh.surface().arrays
        # The divergence theorem for 1 and for x.
        assert area.sum(axis=0) == pytest.approx(np.zeros(dim), abs=1e-13)
        assert np.einsum("fi,fj->ij", places, area) == pytest.approx(volume * np.eye(dim), abs=1e-12)
        assert (particle == 0).all()
    # The corners alone are another body, which MeshNodes take.
    word = kind.rstrip("0123456789")
    straight = abs(cells.volumes_and_moments(x, cells.Block(word, np.arange(cells.CORNERS[word])[None]))[0][0])
    assert abs(straight - volume) > 1e-4 * volume
    assert whole(pd.MeshNodes(path))[1].sum() == pytest.approx(straight, rel=1e-12)


def test_a_disc_of_curved_triangles_and_its_traction(tmp_path):
    n = 6
    angles = np.pi * np.arange(2 * n) / n
    rim = np.column_stack([np.cos(angles), np.sin(angles)])
    points = np.vstack([[[0.0, 0.0]], rim, 0.5 * rim[::2]])
    triangles = [
        [0, 1 + 2 * k, 1 + (2 * k + 2) % (2 * n), 1 + 2 * n + k, 2 + 2 * k, 1 + 2 * n + (k + 1) % n] for k in range(n)
    ]
    mesh = pd.Mesh(written(tmp_path / "disc.vtk", points, [("triangle6", triangles)]), thickness=0.5)
    # A parabola over the chord of an arc of angle a is 2/3 of chord times sagitta.
    a = 2.0 * np.pi / n
    area = n * (0.5 * np.sin(a) + 2.0 / 3.0 * 2.0 * np.sin(a / 2.0) * (1.0 - np.cos(a / 2.0)))
    assert whole(mesh)[1].sum() == pytest.approx(0.5 * area, rel=1e-14)
    assert area == pytest.approx(np.pi, rel=3e-3)
    _, along, _, _ = mesh.surface().arrays
    assert np.linalg.norm(along, axis=1).sum() == pytest.approx(0.5 * 2.0 * np.pi, rel=1e-2)


@pytest.mark.parametrize("form", ["e", "inp"])
def test_quadratic_hexahedra_of_exodus_and_abaqus_are_the_same_body(form, tmp_path, rng):
    x, volume, centroid = quadratic("hexahedron20", rng)
    path = tmp_path / f"cell.{form}"
    if form == "inp":
        lines = ["*NODE", *(f"{k + 1}, {a}, {b}, {c}" for k, (a, b, c) in enumerate(x.tolist()))]
        numbers = [str(k + 1) for k in range(20)]
        lines += ["*ELEMENT, TYPE=C3D20R, ELSET=all", "1, " + ", ".join(numbers[:12]) + ",", ", ".join(numbers[12:])]
        path.write_text("\n".join(lines) + "\n")
    else:
        with netCDF4.Dataset(path, "w") as file:
            for name, size in (("num_nodes", 20), ("num_el_blk", 1), ("num_el_in_blk1", 1), ("num_nod_per_el1", 20)):
                file.createDimension(name, size)
            for axis, values in zip("xyz", x.T, strict=True):
                file.createVariable(f"coord{axis}", "f8", ("num_nodes",))[:] = values
            connect = file.createVariable("connect1", "i4", ("num_el_in_blk1", "num_nod_per_el1"))
            connect.elem_type = "HEX20"
            connect[:] = 1 + np.concatenate([np.arange(12), np.arange(16, 20), np.arange(12, 16)])[None]
    found = pd.Mesh(path).chunk(0, 1)
    assert found.volume == pytest.approx([volume], rel=1e-12)
    assert found.x[0] == pytest.approx(centroid, rel=1e-12)


def test_cells_with_nodes_in_a_wrong_order_are_refused(tmp_path, rng):
    x, _, _ = quadratic("hexahedron20", rng)
    wrong = np.concatenate([np.arange(8), np.roll(np.arange(8, 20), 1)])
    path = written(tmp_path / "cell.vtk", x[wrong], [("hexahedron20", [np.arange(20)])])
    with pytest.raises(pd.CaseError, match="far from the middles of their edges"):
        pd.Mesh(path).chunk(0, 1)
    points, (hexahedron,) = box("hexahedron", (1, 1, 1))
    swapped = [*hexahedron[:4], hexahedron[5], hexahedron[4], *hexahedron[6:]]
    with pytest.raises(pd.CaseError, match="inverted at a corner"):
        pd.Mesh(written(tmp_path / "h.vtk", points, [("hexahedron", [swapped])])).chunk(0, 1)
    # The other way round everywhere is the same cell.
    inverted = [*hexahedron[4:], *hexahedron[:4]]
    assert pd.Mesh(written(tmp_path / "h.vtk", points, [("hexahedron", [inverted])])).chunk(0, 1).volume == 1.0
    plane = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [0.5, 1.5]])
    for order, message in (([0, 1, 2, 3], None), ([1, 0, 2, 3], "inverted at a corner|no volume")):
        path = written(tmp_path / "q.vtk", plane, [("quad", [order])])
        if message is None:
            assert pd.Mesh(path).chunk(0, 1).volume == pytest.approx([2.25])
        else:
            with pytest.raises(pd.CaseError, match=message):
                pd.Mesh(path).chunk(0, 1)


def test_plane_meshes_out_of_the_plane_of_x_and_y_are_refused(tmp_path):
    points, quads = box("quad", (2, 1))
    for turned in (np.column_stack([points[:, 0], np.full(len(points), 5.0), points[:, 1]]),
                   np.column_stack([points, 1e-3 * points[:, 0]])):  # fmt: skip
        with pytest.raises(pd.CaseError, match="Turn the mesh"):
            pd.Mesh(written(tmp_path / "p.vtk", turned, [("quad", quads)])).chunk(0, 1)
    above = np.column_stack([points, np.full(len(points), 5.0)])
    assert pd.Mesh(written(tmp_path / "p.vtk", above, [("quad", quads)])).chunk(0, 1).x.shape == (2, 2)


# --- text clouds


@pytest.mark.parametrize("mark", [",", ";", " ", "\t", ", "])
def test_columns_of_text_clouds_have_names_and_separators(mark, tmp_path):
    path = tmp_path / "cloud.csv"
    rows = [["x", "y", "temperature", "volume", "fibre angle"]]
    rows += [[0, 0, 20, 0.5, 0.1], [1, 0, 30, 0.5, 0.2], [0, 1, 40, 1, 0.3]]
    if mark.isspace():
        rows[0][-1] = "fibre_angle"
    path.write_text("\n".join(mark.join(map(str, row)) for row in rows) + "\n")
    cloud = pd.TextFile(path, {"some": [1, 3]})
    x, volume, sets = whole(cloud)
    assert x.tolist() == [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]
    assert volume.tolist() == [0.5, 0.5, 1.0]
    assert sets["some"].tolist() == [True, False, True]
    assert cloud.column("Temperature").tolist() == [20.0, 30.0, 40.0]
    angle = cloud.function(rows[0][-1])
    assert angle(x[::-1]).tolist() == [0.3, 0.2, 0.1]
    assert angle(x[:1], 0.5).tolist() == [0.1]
    with pytest.raises(pd.CaseError, match="no particle is there"):
        angle(np.array([[0.5, 0.0]]))
    with pytest.raises(pd.CaseError, match="no column 'angle'"):
        cloud.column("angle")


def test_decimal_commas_are_refused(tmp_path):
    path = tmp_path / "cloud.txt"
    for text in ("0,5 1 0,25\n1,5 1 0,25\n", "0,5;1;0,25\n", "0.5 1 0.25\n0,5 1 0.25\n"):
        path.write_text(text)
        with pytest.raises(pd.CaseError, match="not a table of numbers"):
            whole(pd.TextFile(path))


def test_particles_in_a_plane_are_a_solid_where_that_is_said(tmp_path):
    path = tmp_path / "cloud.txt"
    path.write_text("0 0 5 1 1\n1 0 5 1 1\n0 1 5 1 1\n")
    assert whole(pd.TextFile(path))[0].shape == (3, 2)
    assert whole(pd.TextFile(path, dim=3))[0].shape == (3, 3)
    with pytest.raises(pd.CaseError, match="outside the first 1 coordinates, and dim=1"):
        whole(pd.TextFile(path, dim=1))
    with pytest.raises(pd.CaseError, match="1 or 2 or 3 or None as dim"):
        pd.TextFile(path, dim=4)


# --- Gmsh 4.1

# A square whose right side is in two groups and whose upper side is in none; node numbers have gaps.
SQUARE = {
    "names": [(1, 5, "left"), (1, 6, "edges"), (2, 1, "plate"), (2, 2, "hot")],
    "points": [(k + 1, x, y) for k, (x, y) in enumerate([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)])],
    "entities": [
        [(1, [6], [1, -2]), (2, [6, 9], [2, -3]), (3, [], [3, -4]), (4, [5, -6], [4, -1])], [(1, [1, 2], [1, 2, 3, 4])],
    ],
    "nodes": [(11, 0.0, 0.0), (12, 1.0, 0.0), (30, 1.0, 1.0), (14, 0.0, 1.0)],
    "elements": [(1, 1, 1, [11, 12]), (1, 2, 1, [12, 30]), (1, 3, 1, [30, 14]), (1, 4, 1, [14, 11]),
                 (2, 1, 3, [11, 12, 30, 14])],
}  # fmt: skip


def gmsh_square(binary, parametric=False, names=True):
    """Return the square as a file of format 4.1."""
    out = [
        b"$MeshFormat\n4.1 1 8\n\x01\x00\x00\x00\n$EndMeshFormat\n"
        if binary
        else b"$MeshFormat\n4.1 0 8\n$EndMeshFormat\n"
    ]
    if names:
        lines = [f'{dim} {tag} "{name}"' for dim, tag, name in SQUARE["names"]]
        out.append("\n".join(["$PhysicalNames", str(len(lines)), *lines, "$EndPhysicalNames", ""]).encode())

    def put(*parts):
        for kind, values in parts:
            if binary:
                out.append(np.array(values, {"i": "<i4", "z": "<u8", "d": "<f8"}[kind]).tobytes())
            else:
                out.append((" ".join(map(repr, values)) + " ").encode())
        out.append(b"" if binary else b"\n")

    out.append(b"$Entities\n")
    put(("z", [4, 4, 1, 0]))
    for tag, x, y in SQUARE["points"]:
        put(("i", [tag]), ("d", [x, y, 0.0]), ("z", [0]))
    for of_dim in SQUARE["entities"]:
        for tag, groups, around in of_dim:
            put(
                ("i", [tag]), ("d", [0.0] * 6), ("z", [len(groups)]), ("i", groups), ("z", [len(around)]), ("i", around)
            )
    out.append(b"\n$EndEntities\n$Comment\n$Nodes and more\n$EndComment\n$Nodes\n")
    put(("z", [1, 4, 11, 30]))
    put(("i", [2, 1, int(parametric)]), ("z", [4]))
    put(("z", [tag for tag, _, _ in SQUARE["nodes"]]))
    for _, x, y in SQUARE["nodes"]:
        put(("d", [x, y, 0.0, *([7.0, 8.0] if parametric else [])]))
    out.append(b"\n$EndNodes\n$Elements\n")
    put(("z", [5, 5, 1, 5]))
    for number, (dim, tag, kind, nodes) in enumerate(SQUARE["elements"], 1):
        put(("i", [dim, tag, kind]), ("z", [1]), ("z", [number, *nodes]))
    out.append(b"\n$EndElements\n")
    return b"".join(out)


@pytest.mark.parametrize("binary", [False, True], ids=["text", "binary"])
@pytest.mark.parametrize("parametric", [False, True])
def test_gmsh_4_1_groups_of_entities_in_none_one_and_several(binary, parametric, tmp_path):
    path = tmp_path / "square.msh"
    path.write_bytes(gmsh_square(binary, parametric))
    mesh = pd.Mesh(path)
    found = mesh.chunk(0, 1)
    assert found.x.tolist() == [[0.5, 0.5]]
    assert found.volume.tolist() == [1.0]
    assert set(found.sets) == {"plate", "hot", "edges", "left", "facets_9"}
    facets = mesh.surface()
    normals = np.asarray(facets.area)
    sides = {name: sorted(map(tuple, normals[flags].tolist())) for name, flags in facets.tags.items()}
    assert sides["left"] == [(-1.0, 0.0)]
    assert sides["facets_9"] == [(1.0, 0.0)]
    assert sides["edges"] == [(-1.0, 0.0), (0.0, -1.0), (1.0, 0.0)]
    path.write_bytes(gmsh_square(binary, parametric, names=False))
    assert set(pd.Mesh(path).chunk(0, 1).sets) == {"group_1", "group_2", "facets_5", "facets_6", "facets_9"}


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        (b"$Entities", b"$PartitionedEntities", "partitioned"),
        (b"1 4 11 30", b"1 5 11 30", "4 nodes where it says 5"),
        (b"5 5 1 5", b"5 6 1 5", "5 elements where it says 6"),
        (b"5 11 12 30 14", b"5 11 12 31 14", "node 31"),
        (b"11 12 30 14 \n0.0", b"11 12 12 14 \n0.0", "a node twice"),
        (b"2 1 3 1", b"2 1 99 1", "type 99"),
        (b"4.1 0 8", b"4.1 0 4", "8 bytes"),
        (b"$EndElements", b"$End", "does not end"),
        (b'1 5 "left"', b"1 5 left", "physical name"),
    ],
)
def test_gmsh_4_1_that_is_damaged_is_refused(before, after, message, tmp_path):
    path = tmp_path / "square.msh"
    text = gmsh_square(False).replace(b" \n", b" \n")
    changed = text.replace(before, after, 1)
    if changed == text:
        before = before.replace(b" ", b"  ")
        changed = text.replace(before, after, 1)
    assert changed != text
    path.write_bytes(changed)
    with pytest.raises(pd.CaseError, match=message):
        pd.Mesh(path).chunk(0, 1)


def test_quadratic_cells_of_gmsh_are_in_its_own_order(tmp_path, rng):
    # The manual's order: edges by their first corner.
    order = {"hexahedron20": [0, 3, 8, 1, 9, 2, 10, 11, 4, 7, 5, 6], "tetra10": [0, 1, 2, 3, 5, 4]}
    for kind, edges in order.items():
        x, volume, _ = quadratic(kind, rng)
        n = 8 if kind.startswith("hexahedron") else 4
        x = x[[*range(n), *(n + k for k in edges)]]
        number = {"hexahedron20": 17, "tetra10": 11}[kind]
        lines = [
            "$MeshFormat",
            "4.1 0 8",
            "$EndMeshFormat",
            "$Entities",
            "0 0 0 1",
            "1 0 0 0 1 1 1 0 0",
            "$EndEntities",
        ]
        lines += ["$Nodes", f"1 {len(x)} 1 {len(x)}", f"3 1 0 {len(x)}", *(str(k + 1) for k in range(len(x)))]
        lines += [
            *(f"{a!r} {b!r} {c!r}" for a, b, c in x.tolist()),
            "$EndNodes",
            "$Elements",
            "1 1 1 1",
            f"3 1 {number} 1",
        ]
        lines += ["1 " + " ".join(str(k + 1) for k in range(len(x))), "$EndElements"]
        (tmp_path / "cell.msh").write_text("\n".join(lines) + "\n")
        assert pd.Mesh(tmp_path / "cell.msh").chunk(0, 1).volume == pytest.approx([volume], rel=1e-12)


# --- spheres of Exodus


def spheres(path, attributes, names=()):
    """Write a file of spheres in two blocks with a node set."""
    with netCDF4.Dataset(path, "w") as file:
        sizes = {"num_nodes": 4, "num_el_blk": 2, "num_el_in_blk1": 3, "num_el_in_blk2": 1, "one": 1}
        sizes |= {"num_node_sets": 1, "num_nod_ns1": 2, "len_name": 33}
        for name, size in sizes.items():
            file.createDimension(name, size)
        for axis, values in zip("xyz", ([0, 1, 2, 3], [0, 1, 0, 1], [5, 5, 5, 5]), strict=True):
            file.createVariable(f"coord{axis}", "f8", ("num_nodes",))[:] = values
        for number, nodes in ((1, [[4], [2], [1]]), (2, [[3]])):
            connect = file.createVariable(f"connect{number}", "i4", (f"num_el_in_blk{number}", "one"))
            connect.elem_type = "SPHERE"
            connect[:] = nodes
            if attributes:
                file.createDimension(f"num_att_in_blk{number}", len(attributes[0]))
                shape = (f"num_el_in_blk{number}", f"num_att_in_blk{number}")
                rows = attributes[:3] if number == 1 else attributes[3:]
                file.createVariable(f"attrib{number}", "f8", shape)[:] = rows
                if names:
                    texts = file.createVariable(f"attrib_name{number}", "S1", (shape[1], "len_name"))
                    texts[:] = np.array([list(name.ljust(33, "\0")) for name in names], dtype="S1")
        file.createVariable("ns_prop1", "i4", ("num_node_sets",))[:] = 7
        file.createVariable("node_ns1", "i4", ("num_nod_ns1",))[:] = [2, 3]


def test_spheres_of_exodus_have_their_own_volumes(tmp_path):
    path = tmp_path / "spheres.g"
    table = [[0.1, 0.5], [0.1, 0.25], [0.1, 0.75], [0.1, 2.0]]
    for attributes, names in ((table, ()), ([row[::-1] for row in table], ("Volume", "Radius"))):
        spheres(path, attributes, names)
        x, volume, sets = whole(pd.Mesh(path))
        # A plane of spheres is a solid, as the file has three coordinates.
        assert x.tolist() == [[3.0, 1.0, 5.0], [1.0, 1.0, 5.0], [0.0, 0.0, 5.0], [2.0, 0.0, 5.0]]
        assert volume.tolist() == [0.5, 0.25, 0.75, 2.0]
        assert sets["group_1"].tolist() == [True, True, True, False]
        assert sets["node_set_7"].tolist() == [False, True, False, True]
    with pytest.raises(pd.CaseError, match="spheres, which have no faces"):
        pd.Mesh(path).surface()
    with pytest.raises(pd.CaseError, match="spheres, which have no faces"):
        pd.MeshNodes(path).chunk(0, 1)
    spheres(path, [[0.1, 0.0]] * 4)
    with pytest.raises(pd.CaseError, match="volume 0"):
        pd.Mesh(path).chunk(0, 1)
    spheres(path, [])
    with pytest.raises(pd.CaseError, match="no cells"):
        pd.Mesh(path).chunk(0, 1)


@pytest.mark.parametrize("kind", [pd.Mesh, pd.MeshNodes])
def test_a_cell_in_the_file_twice_is_refused(kind, tmp_path):
    """Format 2.2 of Gmsh writes a cell once for each of its groups; nodes had the volume of both."""
    x = [(i, j, 0.0) for j in range(4) for i in range(4)]
    cells = [(4 * j + i, 4 * j + i + 1, 4 * j + i + 5, 4 * j + i + 4) for j in range(3) for i in range(3)]
    path = tmp_path / "two_groups.msh"
    groups = [1] * len(cells) + [2]
    lines = ["$MeshFormat", "2.2 0 8", "$EndMeshFormat", "$Nodes", "16"]
    lines += [f"{k} {a} {b} {c}" for k, (a, b, c) in enumerate(x, 1)]
    lines += ["$EndNodes", "$Elements", "10"]
    for k, (group, cell) in enumerate(zip(groups, [*cells, cells[4]], strict=True), 1):
        lines.append(f"{k} 3 2 {group} 1 " + " ".join(str(node + 1) for node in cell))
    path.write_text("\n".join([*lines, "$EndElements", ""]))
    with pytest.raises(pd.CaseError, match="has 1 cells twice"):
        kind(path).chunk(0, 1)
