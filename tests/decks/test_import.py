"""Decks of Peridigm and PeriLab: what they say, what is refused, and forces by the formulas of those programs."""

import itertools
import os
import re
import runpy
import subprocess
import sys

import netCDF4
import numpy as np
import pytest

import pdpetsc as pd
from pdpetsc.command_line.commands import command
from pdpetsc.command_line.import_deck import import_deck
from pdpetsc.control.base import Stiffness
from pdpetsc.decks.expressions import parse, parse_peridigm
from pdpetsc.decks.sections import read
from pdpetsc.declare.region import View
from pdpetsc.discrete.cloud import distribute
from pdpetsc.discrete.communicator import world
from pdpetsc.discrete.families import find_families
from tests.commands import ROOT

# A block of 4 x 3 x 3 particles that is pulled and sheared at finite strain, in millimetres.
PERIDIGM = """\
Peridigm:
  Verbose: false
  Discretization:
    Type: "PdQuickGrid"
    NeighborhoodType: "Spherical"
    TensorProduct3DMeshGenerator:
      Type: "PdQuickGrid"
      X Origin: 0.0
      Y Origin: 0.0
      Z Origin: -1.0
      X Length: 4.0
      Y Length: 3.0
      Z Length: 3.0
      Number Points X: 4
      Number Points Y: 3
      Number Points Z: 3
  Materials:
    Steel:
      Material Model: "Elastic"
      Density: 7800.0
      Bulk Modulus: 130.0e3
      Shear Modulus: 78.0e3
  Blocks:
    All Of It:
      Block Names: "block_1"
      Material: "Steel"
      Horizon: 1.8
  Boundary Conditions:
    Left Node Set: "1 5 9 13 17 21 25 29 33"
    Right Node Set: "4 8 12 16 20 24 28 32 36"
    Hold X:
      Type: "Prescribed Displacement"
      Node Set: "Left Node Set"
      Coordinate: "x"
      Value: "0.0"
    Hold Y:
      Type: "Prescribed Displacement"
      Node Set: "Left Node Set"
      Coordinate: "y"
      Value: "0.0"
    Hold Z:
      Type: "Prescribed Displacement"
      Node Set: "Left Node Set"
      Coordinate: "z"
      Value: "0.0"
    Pull:
      Type: "Prescribed Displacement"
      Node Set: "right  node set"
      Coordinate: "x"
      Value: "value = 0.02*x*t/5.0;"
    Shear:
      Type: "Prescribed Displacement"
      Node Set: "Right Node Set"
      Coordinate: "y"
      Value: "0.01*(y + 1.0)*t/5.0"
    Weight:
      Type: "Body Force"
      Node Set: "Left Node Set"
      Coordinate: "z"
      Value: "-3.0*t"
  Solver:
    Initial Time: 0.0
    Final Time: 5.0
    QuasiStatic:
      Number of Load Steps: 2
      Absolute Tolerance: 1.0
  Compute Class Parameters:
    Pulled:
      Compute Class: "Block_Data"
      Calculation Type: "Sum"
      Block: "block_1"
      Variable: "Force"
      Output Label: "Sum of Forces"
    Gage:
      Compute Class: "Nearest_Point_Data"
      X: 3.4
      Y: 1.5
      Z: 0.5
      Variable: "Displacement"
      Output Label: "Gage"
  Output:
    Output Filename: "block"
    Output Variables:
      Displacement: true
"""

PERILAB = """\
PeriLab:
  Discretization:
    Type: Text File
    Input Mesh File: plate.txt
    Node Sets:
      Left: x < 0.6
      Right: right.txt
      Corner: 1
  Blocks:
    One:
      Block ID: 1
      Density: 1e-9
      Horizon: 2.1
      Material Model: Soft
    Two:
      Block ID: 2
      Density: 1e-9
      Horizon: 2.1
      Material Model: Hard
  Models:
    Pre Calculation Global:
      Shape Tensor: true
    Material Models:
      Soft:
        Material Model: Correspondence Elastic
        Symmetry: isotropic plane stress
        Young's Modulus: 1.0e+3
        Poisson's Ratio: 0.3
        Zero Energy Control: "Global"
      Hard:
        Material Model: Correspondence Elastic
        Symmetry: isotropic plane stress
        Young's Modulus: 3e3
        Poisson's Ratio: 0.2
        Zero Energy Control: "Global"
  Boundary Conditions:
    Held:
      Variable: Displacements
      Node Set: Left
      Coordinate: x
      Value: 0.0
      Type: Dirichlet
    Corner:
      Variable: Displacements
      Node Set: Corner
      Coordinate: y
      Value: 0.0
      Type: Dirichlet
    Bent:
      Variable: Displacements
      Node Set: Right
      Coordinate: x
      Value: -0.001*y^2*t + 0.002
      Type: Dirichlet
  Solver:
    Initial Time: 0.0
    Final Time: 2.0
    Number of Steps: 4
    Linear Static Matrix Based:
      Matrix Update: false
  Outputs:
    Output1:
      Output Filename: plate
      Output Variables:
        Displacements: true
"""


@pytest.fixture
def folder(tmp_path, monkeypatch, rng):
    """Return a folder with the decks and a plate of 6 x 5 particles that are no lattice."""
    monkeypatch.chdir(tmp_path)
    x = np.array(list(itertools.product(np.arange(6) + 0.5, np.arange(5) + 0.5)))
    moved = x + 0.05 * rng.uniform(-1.0, 1.0, x.shape)
    volume = 1.0 + 0.2 * rng.uniform(-1.0, 1.0, len(x))
    rows = [f"{a} {b} {1 + (i > 14)} {v}" for i, ((a, b), v) in enumerate(zip(moved.tolist(), volume, strict=True))]
    (tmp_path / "plate.txt").write_text("# a plate\n\nheader: x y block_id volume\n" + "\n".join(rows) + "\n")
    (tmp_path / "right.txt").write_text("header: global_id\n" + "\n".join(str(i) for i in range(26, 31)) + "\n")
    (tmp_path / "block.yaml").write_text(PERIDIGM)
    (tmp_path / "plate.yaml").write_text(PERILAB)
    return tmp_path


def changed(folder, name, *changes):
    """Write a deck with some of its text changed and return it."""
    path = folder / name
    text = path.read_text()
    for before, after in changes:
        assert before in text
        text = text.replace(before, after)
    other = folder / f"other_{name}"
    other.write_text(text)
    return other


def pdpetsc(*words, cwd):
    """Run a command of pdpetsc in a folder."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    words = [sys.executable, "-m", "pdpetsc", *words]
    return subprocess.run(words, cwd=cwd, env=environment, capture_output=True, text=True, timeout=100, check=False)


def case_of(path, **parameters):
    return runpy.run_path(str(path))["case"](**parameters)


# --- expressions


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("0.001*y*t", 0.001 * 2.0 * 0.5), ("value = 2.0*x;", 3.0), ("-x^2", -2.25), ("2^-1", 0.5), ("2^3^2", 512.0),
        ("1 - 2 - 3", -4.0), ("1 - (2 - 3)", 2.0), ("8/4/2", 1.0), ("8/(4/2)", 4.0), ("x - -y", 3.5),
        ("-(x + y)*z", -10.5),
        ("273.0+1000.0*(t/3600.0)", 273.0 + 1000.0 * 0.5 / 3600.0), ("3.*x", 4.5), ("x.*y", 3.0),
        ("sin.(t)", np.sin(0.5)),
        ("pow(x, 2)*3", 6.75), ("ifelse(t > 0.4, 1.5e-3, 0)", 1.5e-3), ("min(x, y) + max(x, y)", 3.5),
        ("2*pi", 2.0 * np.pi),
        ("sqrt(abs(-y))*exp(0)", np.sqrt(2.0)), ("(x+y)^2*t", 12.25 * 0.5), ("-x*-y", 3.0),
        ("2 - x^2^0.5", 2.0 - 1.5 ** (2.0**0.5)),
    ],
)  # fmt: skip
def test_expressions_have_their_value_before_and_after_translation(text, value):
    node = parse(text, "a value", set("xyzt"))
    at = {"x": 1.5, "y": 2.0, "z": 3.0, "t": 0.5}
    assert node.value(at) == pytest.approx(value, rel=1e-15)
    names = {**{name: f"({number})" for name, number in at.items()}, "pi": "np.pi"}
    assert eval(node.python(names), {"np": np}) == pytest.approx(value, rel=1e-15)


@pytest.mark.parametrize(
    ("text", "peridigm", "perilab"),
    [
        ("-x^2", 2.25, -2.25), ("value = -x^2;", 2.25, -2.25), ("0.01*y*-t^2", 0.02 * 0.25, -0.02 * 0.25),
        ("2^-1", 0.5, 0.5), ("2^-x^2", 2.0**2.25, 2.0**-2.25), ("2^3^2", 512.0, 512.0), ("y - x^2", -0.25, -0.25),
        ("y-(-x^2)", -0.25, 4.25), ("--x^2", 2.25, 2.25), ("-(x)^2*y", 4.5, -4.5), ("-sin(x)^2", np.sin(1.5) ** 2,
                                                                                  -(np.sin(1.5) ** 2)),
        ("-x*y", -3.0, -3.0), ("x/-y^2", 0.375, -0.375), ("-2^2", 4.0, -4.0), ("(y)-x^2", -0.25, -0.25),
    ],
)  # fmt: skip
def test_a_sign_before_a_power_is_that_of_the_program_of_the_deck(text, peridigm, perilab):
    at = {"x": 1.5, "y": 2.0, "z": 3.0, "t": 0.5}
    for first, value in ((True, peridigm), (False, perilab)):
        node = (parse_peridigm if first else parse)(text, "a value", set("xyzt"))
        assert node.value(at) == pytest.approx(value, rel=1e-15)
        assert eval(node.python({name: name for name in at}), {"np": np, **at}) == pytest.approx(value, rel=1e-15)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("if(t <= 0.2){ value = x; } else{ value = -1000*(t-0.2); }", (1.5, -300.0)),
        # As YAML and XML have the braces in decks of Peridigm.
        (r" if(t <= 0.2)\{ value = x*cos(1.5*t); \} else\{ value = 2; \} ", (1.5 * np.cos(0.15), 2.0)),
        ("if(t<=0.2){value=-y*t;} else if(x > 1){value=3;} else{value=4;}", (-0.2, 3.0)),
        ("if (t > 0.2 && y == 2) { value = 1.0 } else { if (t < 0) { value = 5; } else { value = 6; } }", (6.0, 1.0)),
    ],
)
def test_statements_of_peridigm_choose_a_value(text, value):
    node = parse_peridigm(text, "a value", set("xyzt"))
    names = {name: name for name in "xyzt"} | {"pi": "np.pi"}
    for t, expected in zip((0.1, 0.5), value, strict=True):
        at = {"x": 1.5, "y": 2.0, "z": 3.0, "t": t}
        assert node.value(at) == pytest.approx(expected, rel=1e-14)
        assert eval(node.python(names), {"np": np}, at) == pytest.approx(expected, rel=1e-14)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("if(t <= 1){ value = 2; }", "needs an else"),
        ("if(t){ value = 2; } else{ value = 3; }", "must be a comparison"),
        ("if(t <= 1){ value = 2; else{ value = 3; }", "'}' is missing"),
        ("if(t <= 1) value = 2; else value = 3;", "'{' is missing"),
        ("if(t <= 1){ value = 2; value = 3; } else{ value = 3; }", "'}' is missing"),
        ("if(t <= 1){ value = t < 2; } else{ value = 3; }", "a comparison"),
    ],
)
def test_statements_that_choose_no_value_are_refused(text, why):
    with pytest.raises(pd.CaseError, match=why):
        parse_peridigm(text, "Pull/Value (line 3)", set("xyzt"))


@pytest.mark.parametrize("text", ["min(x, y)", "max(x, y)", "ifelse(t > 1, x, y)", "abs(x)", "x**2"])
def test_functions_that_peridigm_does_not_have_are_refused_of_its_decks(text):
    parse(text, "a value", set("xyzt"))
    with pytest.raises(pd.CaseError, match="too deeply"):
        parse_peridigm("^".join("x" * 100), "a value", {"x"})
    with pytest.raises(pd.CaseError, match="cannot be translated") as error:
        parse_peridigm(text, "a value", set("xyzt"))
    assert "ifelse" not in str(error.value).partition("write it")[2]


@pytest.mark.parametrize(
    "text",
    ["", "2x", "x.real", "__import__('os')", "x; y", "(x", "x)", "w*t", "f(x)", "sin(x, y)", "x < 1", "1 < x < 2",
     "x = 2",
     "x[0]", "lambda: 1", "1 + (x > 2)", "x if t else y", "'a'", "x ** ", "*".join(["(" * 60 + "x" + ")" * 60])],
)  # fmt: skip
def test_expressions_of_no_grammar_are_refused_with_their_place(text):
    with pytest.raises(pd.CaseError, match="Pull/Value") as error:
        parse(text, "Pull/Value (line 3)", set("xyzt"))
    assert "\n" not in str(error.value)


# --- forces by the formulas of the other programs


def forces_lps(x, volume, u, horizon, K, G, inside=None, influence=np.ones_like):
    """Return internal forces (n, 3) as ``computeInternalForceLinearElastic`` of Peridigm has them, times volumes."""
    n = len(x)
    y = x + u
    inside = inside or (lambda xi: np.linalg.norm(xi) <= horizon * (1 + 1e-9))
    pairs = [(i, j) for i in range(n) for j in range(n) if i != j and inside(x[j] - x[i])]
    m, theta, force = np.zeros(n), np.zeros(n), np.zeros((n, 3))
    for i, j in pairs:
        zeta = np.linalg.norm(x[j] - x[i])
        m[i] += influence(zeta) * zeta**2 * volume[j]
    for i, j in pairs:
        zeta = np.linalg.norm(x[j] - x[i])
        theta[i] += 3.0 / m[i] * influence(zeta) * zeta * (np.linalg.norm(y[j] - y[i]) - zeta) * volume[j]
    for i, j in pairs:
        zeta, along = np.linalg.norm(x[j] - x[i]), y[j] - y[i]
        alpha = 15.0 * G / m[i]
        t = theta[i] * (3.0 * K / m[i] - alpha / 3.0) * zeta + alpha * (np.linalg.norm(along) - zeta)
        t *= influence(zeta)
        force[i] += t * along / np.linalg.norm(along) * volume[i] * volume[j]
        force[j] -= t * along / np.linalg.norm(along) * volume[i] * volume[j]
    return force


def test_a_deck_of_peridigm_is_solved_by_its_formulas(folder):
    path, said = import_deck(folder / "block.yaml")
    assert path.name == "block.py"
    assert any("support forces" in line for line in said)
    case = case_of(path)
    assert case.steps.count == 2
    result = pd.run(case, folder / "out")
    x, u = result.x, result.gathered(pd.displacement)
    # Particles along x first, as their numbers have it.
    assert x[:5].tolist() == [[0.5, 0.5, -0.5], [1.5, 0.5, -0.5], [2.5, 0.5, -0.5], [3.5, 0.5, -0.5], [0.5, 1.5, -0.5]]
    right, left = x[:, 0] > 3.0, x[:, 0] < 1.0
    assert u[right][:, 0] == pytest.approx(0.02 * x[right][:, 0], rel=1e-14)
    assert u[right][:, 1] == pytest.approx(0.01 * (x[right][:, 1] + 1.0), rel=1e-14)
    assert np.abs(u[left]).max() == 0.0
    force = forces_lps(x, np.ones(len(x)), u, 1.8, 130e3, 78e3)
    scale = np.abs(force).max()
    free = ~(left | right)
    assert np.abs(force[free]).max() < 1e-7 * scale
    assert np.abs(force[right][:, 2]).max() < 1e-7 * scale
    # Support forces: the opposite of internal forces, less the weight of the held particles.
    assert result.history["Sum_of_Forces_x"][-1] == pytest.approx(-force[left | right][:, 0].sum(), abs=1e-6 * scale)
    assert result.history["Sum_of_Forces_z"][-1] == pytest.approx(3.0 * 5.0 * 9.0, rel=1e-6)
    assert result.history["Gage_x"][-1] == pytest.approx(0.02 * 3.5)


def box(*cells):
    """Return what is in a box of cells of size 1."""
    return lambda xi: bool((np.abs(xi) < np.array(cells) + 0.5).all())


SPHERICAL = '    NeighborhoodType: "Spherical"\n'
INFLUENCE = "    Influence Function: "


@pytest.mark.parametrize(
    ("horizon", "kind", "inside", "influence"),
    [
        # The horizon over the size of a cell is rounded: 1.2 is one cell to each side, with all corners of that box.
        (1.2, "", box(1, 1, 1), None),
        (1.2, '    NeighborhoodType: "Cubic"\n', box(1, 1, 1), None),
        # Two cells: some bonds outside the box are shorter than its corners.
        (1.8, "", box(2, 2, 2), None),
        (1.5, "", box(2, 2, 2), None),
        (1.2, INFLUENCE + '"Gaussian"\n', box(1, 1, 1), lambda zeta: np.exp(-((zeta / (0.4 * 1.2)) ** 2))),
        (1.8, INFLUENCE + '"Parabolic Decay"\n', box(2, 2, 2),
         lambda zeta: 1.0 if zeta < 0.9 else max(4.0 * zeta / 1.8 * (1.0 - zeta / 1.8), 0.0)),
        (1.8, INFLUENCE + '"1.0/zeta + horizon"\n', box(2, 2, 2), lambda zeta: 1.0 / zeta + 1.8),
        # A bond as long as the horizon is in no spherical family.
        (2.0, SPHERICAL, lambda xi: np.linalg.norm(xi) < 1.9, None),
    ],
)  # fmt: skip
def test_families_of_a_quick_grid_are_boxes_unless_they_are_spherical(folder, horizon, kind, inside, influence):
    deck = changed(folder, "block.yaml", (SPHERICAL, kind), ("Horizon: 1.8", f"Horizon: {horizon}"))
    result = pd.run(case_of(import_deck(deck)[0]), folder / "out")
    x, u = result.x, result.gathered(pd.displacement)
    force = forces_lps(x, np.ones(len(x)), u, horizon, 130e3, 78e3, inside, influence or np.ones_like)
    free = (x[:, 0] > 1.0) & (x[:, 0] < 3.0)
    assert np.abs(force[free]).max() < 1e-7 * np.abs(force).max()
    assert result.history["Sum_of_Forces_x"][-1] == pytest.approx(-force[~free][:, 0].sum(), abs=1e-4)


@pytest.mark.parametrize(("horizon", "kind"), [(1.2, ""), (1.8, ""), (2.0, SPHERICAL)])
def test_micromoduli_of_a_quick_grid_are_those_at_the_horizon_of_the_deck(folder, horizon, kind):
    changes = (SPHERICAL, kind), ("Horizon: 1.8", f"Horizon: {horizon}")
    one = changed(folder, "block.yaml", *changes, ('"Elastic"', '"Elastic Bond Based"'),
                  ("      Shear Modulus: 78.0e3\n", ""))  # fmt: skip
    bonds = case_of(import_deck(one)[0])
    assert bonds.material.E / bonds.horizon**4 == pytest.approx(1.5 * 130e3 / horizon**4, rel=1e-12)
    two = changed(folder, "block.yaml", *changes,
                  ('"Elastic"', '"Elastic Correspondence"\n      Hourglass Coefficient: 0.03'))  # fmt: skip
    points = case_of(import_deck(two, folder / "two.py")[0])
    assert points.control.C / points.horizon**4 == pytest.approx(0.03 / horizon**4, rel=1e-12)


def test_bond_based_materials_do_not_read_an_influence_function(folder):
    deck = changed(folder, "block.yaml", (SPHERICAL, SPHERICAL + INFLUENCE + '"Gaussian"\n'),
                   ('"Elastic"', '"Elastic Bond Based"'), ("      Shear Modulus: 78.0e3\n", ""))  # fmt: skip
    path, said = import_deck(deck)
    assert case_of(path).influence == pd.influence.Constant()
    assert any("does not read it" in line for line in said)
    deck = changed(folder, "plate.yaml", ("Text File", "Text File\n    Influence Function: 1/xi"),
                   ("Correspondence Elastic", "Bond-based Elastic"))  # fmt: skip
    assert case_of(import_deck(deck)[0]).influence == pd.influence.Constant()


def test_bond_filters_of_a_quick_grid_whose_families_are_cut_by_a_box_are_refused(folder):
    crack = "    Bond Filters:\n      Cut:\n        Type: Disk\n        Center X: 2.0\n        Center Y: 1.5\n"
    crack += "        Center Z: 0.5\n        Normal X: 1.0\n        Normal Y: 0.0\n        Normal Z: 0.0\n"
    deck = changed(folder, "block.yaml", (SPHERICAL, f"{crack}        Radius: 1.1\n"))
    with pytest.raises(pd.CaseError, match="does not take for a PdQuickGrid"):
        import_deck(deck)


def test_a_quick_grid_whose_horizon_reaches_no_cell_is_refused(folder):
    deck = changed(folder, "block.yaml", (SPHERICAL, ""), ("Horizon: 1.8", "Horizon: 0.4"))
    with pytest.raises(pd.CaseError, match="no bonds"):
        import_deck(deck)


def test_xml_says_the_same_as_yaml(folder):
    def lines(section, indent):
        for name, entry in section.entries.items():
            yield f'{indent}<Parameter name="{name}" type="string" value="{entry.text.replace(">", "&gt;")}"/>'
        for name, inner in section.sections.items():
            yield f'{indent}<ParameterList name="{name}">'
            yield from lines(inner, indent + "  ")
            yield f"{indent}</ParameterList>"

    root = read(folder / "block.yaml").sections["Peridigm"]
    text = "\n".join(["<ParameterList>", *lines(root, "  "), "</ParameterList>"])
    (folder / "same.xml").write_text(text)
    one, _ = import_deck(folder / "block.yaml", folder / "one.py")
    other, _ = import_deck(folder / "same.xml", folder / "other.py")

    def code(path):
        return [line for line in path.read_text().split("# Of the deck")[0].splitlines()[1:] if "(line" not in line]

    assert code(one) == code(other)
    (folder / "twice.xml").write_text(text.replace('name="Bulk Modulus"', 'name="Shear Modulus"'))
    with pytest.raises(pd.CaseError, match="Shear Modulus twice"):
        import_deck(folder / "twice.xml")
    (folder / "entity.xml").write_text('<!DOCTYPE a [<!ENTITY b "c">]>\n' + text)
    with pytest.raises(pd.CaseError, match="entities"):
        import_deck(folder / "entity.xml")


def forces_correspondence(x, volume, u, horizon, stiffness):
    """Return internal forces (n, 2) of PeriLab's plane correspondence with its global control, times volumes."""
    n = len(x)
    force = np.zeros((n, 2))
    for i in range(n):
        family = [j for j in range(n) if j != i and np.linalg.norm(x[j] - x[i]) <= horizon]
        xi, eta, V = x[family] - x[i], u[family] - u[i], volume[family]
        inverse = np.linalg.inv(np.einsum("j,ja,jb->ab", V, xi, xi))
        H = np.einsum("j,ja,jb->ab", V, eta, xi) @ inverse
        C = stiffness[i]
        sigma = np.einsum("abcd,cd->ab", C, 0.5 * (H + H.T))
        Z = np.einsum("abcd,cd->ab", C, inverse)
        for row, j in enumerate(family):
            T = sigma @ inverse @ xi[row] - Z @ (H @ xi[row] - eta[row])
            force[i] += T * volume[i] * volume[j]
            force[j] -= T * volume[i] * volume[j]
    return force


def plane_stress(E, nu):
    one = np.eye(2)
    lam, mu = E * nu / (1.0 - nu**2), E / (2.0 * (1.0 + nu))
    both = np.einsum("ac,bd->abcd", one, one) + np.einsum("ad,bc->abcd", one, one)
    return lam * np.einsum("ab,cd->abcd", one, one) + mu * both


def test_a_deck_of_perilab_is_solved_by_its_formulas(folder):
    path, _ = import_deck(folder / "plate.yaml")
    case = case_of(path)
    assert case.steps.count == 4
    result = pd.run(case, folder / "out")
    u = result.gathered(pd.displacement)
    table = np.array([row.split() for row in (folder / "plate.txt").read_text().splitlines()[3:]], dtype=float)
    x, block, volume = table[:, :2], table[:, 2], table[:, 3]
    assert np.array_equal(result.x[:, :2], x)
    right = np.arange(30) >= 25
    # At time 2 of the deck.
    assert u[right, 0] == pytest.approx(-0.002 * x[right, 1] ** 2 + 0.002, rel=1e-13)
    stiffness = [plane_stress(1e3, 0.3) if b == 1 else plane_stress(3e3, 0.2) for b in block]
    force = forces_correspondence(x, volume, u, 2.1, stiffness)
    scale = np.abs(force).max()
    left = x[:, 0] < 0.6
    assert left.any()
    assert np.abs(force[~(left | right)]).max() < 1e-8 * scale
    assert np.abs(force[right | left][1:, 1]).max() < 1e-8 * scale


# --- nothing is ignored silently


def sections(root):
    yield root
    for inner in root.sections.values():
        yield from sections(inner)


@pytest.mark.parametrize("name", ["block.yaml", "plate.yaml"])
def test_an_entry_that_nobody_knows_is_named_wherever_it_stands(folder, name):
    text = (folder / name).read_text().splitlines()
    root = read(folder / name)
    places = [section for section in sections(root) if section.path]
    assert len(places) > 15
    for section in places:
        # The line after its own begins with its own indent and two more.
        at = section.line
        indent = re.match(r" *", text[at])[0]
        (folder / "bogus.yaml").write_text("\n".join([*text[:at], f"{indent}Bogus Thing: 7", *text[at:]]) + "\n")
        try:
            import_deck(folder / "bogus.yaml", folder / "bogus.py", overwrite=True)
        except pd.CaseError as error:
            assert "Bogus Thing" in str(error) and "line" in str(error), section.path
        else:
            # A node set is one of the case, whatever its name.
            known = '"Bogus Thing": [7]' if section.path.endswith("Node Sets") else "Bogus Thing: 7"
            assert known in (folder / "bogus.py").read_text(), section.path


def test_what_is_unknown_may_be_ignored_by_name_and_is_listed(folder):
    deck = changed(folder, "block.yaml", ("  Solver:\n", "  Contact:\n    Radius: 0.1\n  Solver:\n"))
    with pytest.raises(pd.CaseError, match=r"Contact \(line"):
        import_deck(deck)
    path, said = import_deck(deck, ignore=["Contact"])
    assert any("ignored Peridigm/Contact" in line for line in said)
    assert "Peridigm/Contact" in path.read_text()
    with pytest.raises(pd.CaseError, match="nothing called 'Contacts'"):
        import_deck(deck, folder / "b.py", ignore=["Contacts"])


REFUSED = [
    ("block.yaml", ('"Elastic"', '"Pals"'), "'Pals', which has no counterpart"),
    ("block.yaml", ("Shear Modulus: 78.0e3", "Poisson's Ratio: 0.3\n      Shear Modulus: 78.0e3"), "needs two of"),
    ("block.yaml", ("78.0e3", "-78.0e3"), "as no material has"),
    ("block.yaml", ("78.0e3", "stiff"), "not a number"),
    ("block.yaml", ("Horizon: 1.8", "Horizon: 0.0"), "positive"),
    ("block.yaml", ("QuasiStatic:", "Verlet:"), "give --static"),
    ("block.yaml", ('"block_1"\n      M', '"block_2"\n      M'), "names the set 'block_2'"),
    ("block.yaml", ("Type: \"Body Force\"", "Type: \"Thermal Flux\""), "no counterpart in a static case"),
    ("block.yaml", ('Coordinate: "z"', 'Coordinate: "w"'), "not x, y or z"),
    ("block.yaml", ("0.02*x*t/5.0", "0.02*w*t"), "w is not known"),
    ("block.yaml", ("0.02*x*t/5.0", "0.02*x*t/(x - 3.5)"), "not a number at time"),
    ("block.yaml", ("4 8 12", "4 8 120"), "outside 1 to 36"),
    ("block.yaml", ("Number Points X: 4", "Number Points X: 4.5"), "not a whole number"),
    ("block.yaml", ("Number of Load Steps: 2", "Number of Load Steps: 0"), "0 steps"),
    ("block.yaml", ("Density: 7800.0", "Density: 7800.0\n      Density: 7800.0"), "twice"),
    ("block.yaml", ("Density: 7800.0", "Plane Stress: true"), "Plane Stress"),
    ("block.yaml", ("Absolute Tolerance: 1.0", "Adaptive Load-Stepping:\n        Switch to Verlet:\n          Fixed "
                                               "dt: 1"), "--ignore 'Switch to Verlet'"),
    ("block.yaml", ("Gage:\n", "Again:\n      Compute Class: Block_Data\n      Calculation Type: Sum\n"
                    "      Block: block_1\n      Variable: Force\n      Output Label: Sum_of_Forces\n    Gage:\n"),
     "has the label"),
    ("plate.yaml", ("Left: x < 0.6", "Left: x < -0.6"), "a node set without particles"),
    ("plate.yaml", ("Block ID: 2", "Block ID: 1"), "is 1, which another block has too"),
    ("plate.yaml", ("Type: Text File", "Type: Exodus"), "all of their nodes"),
    ("plate.yaml", ("Symmetry: isotropic plane stress", "Symmetry: isotropic"), "neither plane stress nor"),
    ("plate.yaml", ("Symmetry: isotropic plane stress", "Symmetry: orthotropic plane stress"), "no counterpart"),
    ("plate.yaml", ("Coordinate: y", "Coordinate: z"), "of a 2D body"),
    ("plate.yaml", ("Linear Static Matrix Based:", "Verlet:"), "give --static"),
    ("plate.yaml", ("Left: x < 0.6", "Left: x < 0.6 < y"), "two comparisons"),
    ("plate.yaml", ("Right: right.txt", "Right: wrong.txt"), "wrong.txt"),
    ("plate.yaml", ('Zero Energy Control: "Global"\n      H', "Bond Associated: true\n      H"), "Bond Associated"),
    ("plate.yaml", ('        Zero Energy Control: "Global"\n      Hard', "      Hard"), "with and without"),
    ("plate.yaml", ("Displacements\n      Node Set: Right", "Forces\n      Node Set: Right"), "'Forces'"),
    ("plate.yaml", ("Node Set: Corner\n      Coordinate: y", "Node Set: Left\n      Coordinate: x"), "HELD"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "change", "message"), REFUSED, ids=[f"{r[0]}-{r[1][1]}"[:50] for r in REFUSED])
def test_what_has_no_counterpart_is_refused_in_a_sentence(folder, name, change, message):
    if message == "HELD":
        # The same value twice is no contradiction; another one is.
        change, message = (
            ("Value: 0.0\n      Type: Dirichlet\n    Corner", "Value: 0.1\n      Type: Dirichlet\n    Corner"),
            "same",
        )
        deck = changed(
            folder, name, change, ("Node Set: Corner\n      Coordinate: y", "Node Set: Left\n      Coordinate: x")
        )
    else:
        deck = changed(folder, name, change)
    with pytest.raises(pd.CaseError, match=message) as error:
        import_deck(deck)
    assert "\n" not in str(error.value)
    assert not (folder / f"{deck.stem}.py").exists()
    assert [path.name for path in folder.glob(".*.py")] == []


# --- what decks may say besides


def test_a_deck_in_time_is_solved_statically_when_asked(folder):
    deck = changed(folder, "block.yaml", ("QuasiStatic:", "Verlet:"), ("Number of Load Steps: 2", "Fixed dt: 1e-6"))
    path, said = import_deck(deck, static=True)
    assert any("Inertia is left out" in line for line in said)
    assert case_of(path).steps.count == 10


def test_times_that_are_listed_and_solvers_that_follow_each_other(folder):
    deck = changed(folder, "block.yaml", ("Number of Load Steps: 2", 'Time Steps: "0.0 1.0 5.0"'))
    module = runpy.run_path(str(import_deck(deck)[0]))
    assert [module["time"](t) for t in (0.0, 0.5, 0.75, 1.0)] == [0.0, 1.0, 3.0, 5.0]
    deck = changed(
        folder, "block.yaml", ("  Solver:\n", "  Solver1:\n"),
        ("  Compute Class Parameters", "  Solver2:\n    Initial Time: 5.0\n    Final Time: 6.0\n    QuasiStatic:\n"
         "      Number of Load Steps: 1\n  Compute Class Parameters"),
    )  # fmt: skip
    module = runpy.run_path(str(import_deck(deck, folder / "two.py")[0]))
    assert module["case"]().steps.count == 3
    assert [module["time"](t) for t in (0.0, 1.0 / 3.0, 1.0)] == pytest.approx([0.0, 2.5, 6.0])


def test_a_deck_with_braces_behind_backslashes_is_read(folder):
    value = r" if(t <= 2.5)\{ value = 0.01*t; \} else\{ value = 0.025 + 0.02*(t - 2.5); \} "
    deck = changed(folder, "block.yaml", ("value = 0.02*x*t/5.0;", value))
    pull = case_of(import_deck(deck)[0]).conditions[3].x
    x = np.array([[3.5, 0.5, 0.5], [3.5, 1.5, 0.5]])
    assert [float(np.ravel(pull(x, t))[0]) for t in (0.0, 0.5, 1.0)] == pytest.approx([0.0, 0.025, 0.075])


def test_times_begin_at_zero_where_the_deck_does_not_say(folder):
    deck = changed(folder, "block.yaml", ("    Initial Time: 0.0\n", ""))
    assert runpy.run_path(str(import_deck(deck)[0]))["time"](1.0) == 5.0
    deck = changed(
        folder, "block.yaml", ("    Initial Time: 0.0\n    Final Time: 5.0\n", ""), ("QuasiStatic:", "Verlet:")
    )
    assert "time" not in runpy.run_path(str(import_deck(deck, folder / "b.py", static=True)[0]))


@pytest.mark.parametrize("horizons", [(1.8, 2.7), (2.7, 1.8)])
def test_an_influence_function_is_that_of_every_block_at_its_own_horizon(folder, horizons):
    rows = [f"{x + 0.5} {y + 0.5} {z + 0.5} {1 + (x > 2)} 1.0" for z in range(3) for y in range(3) for x in range(6)]
    (folder / "bar.txt").write_text("\n".join(rows))
    text = PERIDIGM[: PERIDIGM.index("    Type:")] + '    Type: "Text File"\n    Input Mesh File: "bar.txt"\n'
    text += '    Influence Function: "Gaussian"\n'
    text += PERIDIGM[PERIDIGM.index("  Materials") : PERIDIGM.index("    All Of It")]
    for number, horizon in enumerate(horizons, 1):
        text += (
            f'    B{number}:\n      Block Names: "block_{number}"\n      Material: "Steel"\n      Horizon: {horizon}\n'
        )
    text += PERIDIGM[PERIDIGM.index("  Boundary") : PERIDIGM.index("  Compute Class")]
    (folder / "two.yaml").write_text(text)
    assert case_of(import_deck(folder / "two.yaml")[0]).influence == pd.influence.Gaussian(0.4)


def test_damage_of_some_blocks_is_theirs_alone(folder):
    rows = [f"{x + 0.5} {y + 0.5} {z + 0.5} {1 + (x > 2)} 1.0" for z in range(3) for y in range(3) for x in range(6)]
    (folder / "bar.txt").write_text(
        "\n".join(rows).replace("3.5 ", "9.5 ").replace("4.5 ", "10.5 ").replace("5.5 ", "11.5 ")
    )
    one, two = (
        f'      Block Names: "block_{number}"\n      Material: "Steel"\n      Horizon: 1.8\n' for number in (1, 2)
    )
    one, two = f'{one}      Damage Model: "Weak"\n', f"    Rest:\n{two}"
    text = PERIDIGM[: PERIDIGM.index("    Type:")] + '    Type: "Text File"\n    Input Mesh File: "bar.txt"\n'
    text += PERIDIGM[PERIDIGM.index("  Materials") : PERIDIGM.index("      Block Names")] + one + two
    text += '  Damage Models:\n    Weak:\n      Damage Model: "Critical Stretch"\n      Critical Stretch: 0.5\n'
    text += PERIDIGM[PERIDIGM.index("  Boundary") : PERIDIGM.index("  Compute Class")]
    (folder / "two.yaml").write_text(text)
    damage = case_of(import_deck(folder / "two.yaml")[0]).damage
    assert damage.laws == {"Weak": pd.Brittle(pd.ConstantCritical(0.5)), "None": None}
    assert damage.regions == {"Weak": pd.region.Named("block_1"), "None": pd.region.Named("block_2")}
    (folder / "bar.txt").write_text("\n".join(rows))
    with pytest.raises(pd.CaseError, match=r"bonds between blocks with the damage model Weak and blocks with None"):
        import_deck(folder / "two.yaml", folder / "b.py")


def test_motions_that_a_deck_leaves_free_are_held_without_force(folder):
    # Held and pulled along x alone: free to move along y and z and to turn about x.
    left, right = "Left Node Set", "Right Node Set"
    free = [
        f'    {name}:\n      Type: "Prescribed Displacement"\n      Node Set: "{nodes}"\n      Coordinate: "{axis}"\n'
        f'      Value: "{value}"\n'
        for name, nodes, axis, value in (
            ("Hold Y", left, "y", "0.0"),
            ("Hold Z", left, "z", "0.0"),
            ("Shear", right, "y", "0.01*(y + 1.0)*t/5.0"),
        )
    ]
    deck = changed(folder, "block.yaml", *((part, "") for part in free), ("-3.0*t", "0.0*t"))
    path, said = import_deck(deck)
    assert any("leaves 3 of 6 rigid motions free" in line for line in said)
    result = pd.run(case_of(path), folder / "out")
    x, u = result.x, result.gathered(pd.displacement)
    force = forces_lps(x, np.ones(len(x)), u, 1.8, 130e3, 78e3)
    scale = np.abs(force).max()
    assert np.abs(force[:, 1:]).max() < 1e-7 * scale
    assert np.abs(force[(x[:, 0] > 1.0) & (x[:, 0] < 3.0)]).max() < 1e-7 * scale
    with pytest.raises(pd.CaseError, match=r"body forces do not balance on them at time 2\.5"):
        import_deck(changed(folder, "block.yaml", *((part, "") for part in free)), folder / "b.py")


def test_bonds_as_long_as_the_horizon_are_said_to_depend_on_rounding(folder):
    rows = [f"{x + 0.5} {y + 0.5} {1 + (x > 2)} 1.0" for x in range(6) for y in range(5)]
    (folder / "plate.txt").write_text("header: x y block_id volume\n" + "\n".join(rows) + "\n")
    _, said = import_deck(folder / "plate.yaml")
    assert not any("within rounding" in line for line in said)
    _, said = import_deck(changed(folder, "plate.yaml", ("Horizon: 2.1", "Horizon: 2.0")))
    # Two cells along x, and two along y, from both ends.
    assert any(line.startswith(f"{2 * (4 * 5 + 6 * 3)} bonds are as long") for line in said)


def test_the_shear_of_perilab_is_said_to_differ_in_solids(folder):
    rows = [f"{x + 0.5} {y + 0.5} {z + 0.5} {1 + (x > 2)} 1.0" for x in range(6) for y in range(5) for z in range(1)]
    text = "header: x y z block_id volume\n" + "\n".join(rows) + "\n"
    (folder / "solid.txt").write_text(text)
    _, said = import_deck(changed(folder, "plate.yaml", ("plate.txt", "solid.txt")))
    assert sum("takes 4 G in solids" in line for line in said) == 1
    _, said = import_deck(folder / "plate.yaml")
    assert not any("takes 4 G" in line for line in said)


def test_blocks_have_their_own_horizons_and_influence(folder):
    deck = changed(
        folder, "plate.yaml", ("Horizon: 2.1\n      Material Model: Hard", "Horizon: 3.2\n      Material Model: Hard")
    )
    case = case_of(import_deck(deck)[0])
    block = np.loadtxt(folder / "plate.txt", skiprows=3)[:, 2]
    assert case.horizon.tolist() == np.where(block == 1, 2.1, 3.2).tolist()
    deck = changed(
        folder,
        "block.yaml",
        ('"PdQuickGrid"\n    N', '"PdQuickGrid"\n    Influence Function: "Parabolic Decay"\n    N'),
    )
    influence = case_of(import_deck(deck, folder / "b.py")[0]).influence
    assert influence(np.array([0.2, 0.5, 0.75, 1.0])) == pytest.approx([1.0, 1.0, 0.75, 0.0])


def test_correspondence_has_the_hourglass_force_of_peridigm(folder, rng):
    deck = changed(
        folder, "block.yaml", ('"Elastic"', '"Elastic Correspondence"'),
        ("Density: 7800.0", "Hourglass Coefficient: 0.03"),
    )  # fmt: skip
    case = case_of(import_deck(deck)[0])
    assert isinstance(case.scheme, pd.Correspondence)
    assert case.control == pd.Littlewood(0.03, micromodulus="ball")
    # C 18 K / (pi horizon^4) (n . z) n / |xi| on the bonds of a family whose gradient is zero.
    x = np.array(list(itertools.product(range(3), repeat=3)), dtype=float)
    cloud = distribute(world(), x, np.ones(len(x)), {}, 1.8)
    families = find_families(cloud)
    n = cloud.n_owned
    stiffness = Stiffness(np.full(n, 7.0), np.zeros((1, 3, 3, 3, 3)), np.zeros(n, np.int32), np.ones(n))
    control = case.control.build(cloud, families, np.full(len(families.neighbours), 0.5), stiffness)
    i = int(np.flatnonzero((cloud.x[:n] == 1.0).all(axis=1))[0])
    u = np.zeros((len(cloud.x), 3))
    u[i] = (0.0, 0.0, 1e-3)
    # All bonds of the middle have eta = -u and, by symmetry, no gradient: energy 1/2 sum s (n . eta)^2.
    xi = cloud.x - cloud.x[i]
    length = np.linalg.norm(xi, axis=1)
    bonds = (length > 0.0) & (length < 1.8)
    s = 0.03 * 18.0 * 7.0 / (np.pi * 1.8**4) / length[bonds]
    expected = 0.5 * (s * (xi[bonds, 2] / length[bonds] * 1e-3) ** 2).sum()
    assert control.force(u, np.zeros_like(u), np.array([i], dtype=np.int32)) == pytest.approx(expected, rel=1e-12)


def test_temperature_counts_from_the_beginning(folder):
    deck = changed(
        folder, "block.yaml", ("Density: 7800.0", "Thermal Expansion Coefficient: 1.0e-5"),
        ("    Weight:\n", f'    All Node Set: "{" ".join(map(str, range(1, 37)))}"\n    Heat:\n      Type: "Prescribed '
         'Temperature"\n      Node Set: "All Node Set"\n      Value: "293.0 + 20.0*t"\n    Weight:\n'),
    )  # fmt: skip
    case = case_of(import_deck(deck)[0])
    heat = next(c for c in case.conditions if isinstance(c, pd.Temperature))
    assert heat.value(np.zeros((2, 3)), 1.0) == pytest.approx([100.0, 100.0])
    assert case.material.reference == 0.0


def test_temperature_counts_from_time_zero_wherever_the_deck_begins(folder):
    deck = changed(
        folder, "block.yaml", ("Density: 7800.0", "Thermal Expansion Coefficient: 1.0e-5"),
        ("    Weight:\n", f'    All Node Set: "{" ".join(map(str, range(1, 37)))}"\n    Heat:\n      Type: "Prescribed '
         'Temperature"\n      Node Set: "All Node Set"\n      Value: "7.0*x + 20.0*t"\n    Weight:\n'),
        ("Initial Time: 0.0", "Initial Time: 2.0"),
    )  # fmt: skip
    heat = next(c for c in case_of(import_deck(deck)[0]).conditions if isinstance(c, pd.Temperature))
    assert heat.value(np.ones((2, 3)), 1.0) == pytest.approx([100.0, 100.0])
    assert heat.value(np.ones((2, 3)), 0.5) == pytest.approx([70.0, 70.0])


def of_peridigm(value, times):
    """Return the displacement at the times as ``BoundaryCondition::evaluateParser`` and the load steps have it."""
    u = [0.0]
    for before, now in itertools.pairwise(times):
        change = value(now) - value(before)
        u.append(u[-1] + (value(now) - u[-1] if change == 0.0 else change))
    return u


@pytest.mark.parametrize(
    ("text", "first", "refused"),
    [
        ("0.1 + 0.05*(t - 2.5 + fabs(t - 2.5))", 0.0, True), ("0.1 + 0.02*t", 0.0, False),
        ("0.05*(t - 2.5 + fabs(t - 2.5))", 0.0, False), ("0.02*t^2", -1.0, False),
        ("0.02*(x - 3.5)*t + 0.1", 0.0, True),
        ("0.02*x*t + 0.1", -1.0, False), ("0.3*(t - 2) - 0.3*fabs(t - 2)", 0.0, True),
        ("0.3*(t - 1) - 0.3*fabs(t - 1)", -1.0, True), ("0.1*(t - fabs(t))", -5.0, True),
    ],
)  # fmt: skip
def test_displacements_are_those_that_peridigm_adds_up(folder, text, first, refused):
    deck = changed(
        folder, "block.yaml", ('"value = 0.02*x*t/5.0;"', f'"{text}"'), ("Initial Time: 0.0", f"Initial Time: {first}")
    )
    if refused:
        with pytest.raises(pd.CaseError, match=r"Pull.* rests from time"):
            import_deck(deck)
        return
    pull = case_of(import_deck(deck)[0]).conditions[3].x
    value = parse_peridigm(text, "a value", set("xyzt"))
    times = [first, 0.5 * (first + 5.0), 5.0]
    expected = of_peridigm(lambda t: value.value({"x": 3.5, "y": 0.5, "z": 0.5, "t": t}), times)
    found = [np.broadcast_to(pull(np.array([[3.5, 0.5, 0.5]]), step), 1)[0] for step in (0.0, 0.5, 1.0)]
    assert found == pytest.approx(expected, abs=1e-14)


def test_cracks_are_those_of_the_bond_filters(folder):
    crack = """\
    Bond Filters:
      Cut:
        Type: Rectangular_Plane
        Normal X: 0.0
        Normal Y: 2.0
        Normal Z: 0.0
        Lower Left Corner X: -1.0
        Lower Left Corner Y: 2.02
        Lower Left Corner Z: -1.0
        Bottom Unit Vector X: 1.0
        Bottom Unit Vector Y: 0.0
        Bottom Unit Vector Z: 0.0
        Bottom Length: 3.0
        Side Length: 2.0
"""
    deck = changed(folder, "plate.yaml", ("  Blocks:\n", f"{crack}  Blocks:\n"))
    assert case_of(import_deck(deck)[0]).cracks == [pd.Segment((-1.0, 2.02), (2.0, 2.02))]
    deck = changed(folder, "block.yaml", ("  Materials:\n", f"{crack}  Materials:\n".replace("2.02", "1.0")))
    (cut,) = case_of(import_deck(deck, folder / "b.py")[0]).cracks
    a = np.array([[1.5, 0.5, -0.5], [1.5, 0.5, -0.5], [2.5, 0.5, -0.5], [1.5, 0.5, -1.5]])
    b = np.array([[1.5, 1.5, -0.5], [2.5, 1.5, -0.5], [2.5, 1.5, -0.5], [1.5, 1.5, -1.5]])
    # The rectangle goes from -1 to 2 along x, and by the side length along bottom x normal, from -1 to 1; a bond
    # through its edge is cut.
    assert cut.cuts(a, b).tolist() == [True, True, False, False]
    on = changed(folder, "block.yaml", ("  Materials:\n", f"{crack}  Materials:\n".replace("2.02", "1.5")))
    with pytest.raises(pd.CaseError, match="12 particles lie on the plane"):
        import_deck(on, folder / "c.py")


def test_sets_that_overlap_take_the_later_value(folder):
    deck = changed(folder, "block.yaml", ('Left Node Set: "1 5', 'Left Node Set: "4 1 5'))
    result = pd.run(case_of(import_deck(deck)[0]), folder / "out")
    u = result.gathered(pd.displacement)
    assert u[3, 0] == pytest.approx(0.02 * 3.5)
    assert u[3, 2] == 0.0


def test_nothing_is_overwritten_unasked(folder):
    path = folder / "block.py"
    path.write_text("mine\n")
    with pytest.raises(pd.CaseError, match="is there already"):
        import_deck(folder / "block.yaml")
    assert path.read_text() == "mine\n"
    import_deck(folder / "block.yaml", overwrite=True)
    assert "pd.Case(" in path.read_text()


def test_the_command_writes_a_case_that_runs(folder, capsys):
    answer = pdpetsc("import", "plate.yaml", "-o", "bent.py", cwd=folder)
    assert (answer.returncode, answer.stderr) == (0, "")
    assert answer.stdout.splitlines()[0] == "bent.py"
    for words, message in (
        (["plate.yaml", "-o", "bent.py"], "is there already"),
        (["plate.yaml", "-o", "bent.txt"], "ends in .py"),
        (["none.yaml"], "Cannot read the deck none.yaml"),
        (["plate.txt"], "Cannot read the deck plate.txt"),
        (["plate.yaml", "--ignore"], "requires a value"),
        (["plate.yaml", "block.yaml"], "'block.yaml' is neither"),
        (["--static"], "No deck"),
    ):
        with pytest.raises(pd.CaseError, match=message) as error:
            command("import", words)
        assert "\n" not in str(error.value)
    assert command("import", ["-h"]) == 0
    assert "--overwrite" in capsys.readouterr().out


def test_columns_that_perilab_would_take_for_fields_are_refused(folder):
    mesh = folder / "plate.txt"
    text = mesh.read_text()
    rows = text.splitlines()
    for name, message in (("Young's_Modulus", "young's_modulus"), ("Angles", "angles")):
        mesh.write_text("\n".join([*rows[:2], f"{rows[2]} {name}", *(f"{row} 1.0" for row in rows[3:])]) + "\n")
        with pytest.raises(pd.CaseError, match=f"--ignore .*{message}"):
            import_deck(folder / "plate.yaml")
        path, said = import_deck(folder / "plate.yaml", ignore=[name], overwrite=True)
        assert f"ignored the column {message} of the mesh plate.txt" in said
        assert message in path.read_text()
        with pytest.raises(pd.CaseError, match="nothing called 'Bulk_Modulus'"):
            import_deck(folder / "plate.yaml", ignore=[name, "Bulk_Modulus"], overwrite=True)
        path.unlink()
    mesh.write_text("\n".join([*rows[:2], f"{rows[2]} Activation_Time", *(f"{row} 1.0" for row in rows[3:])]) + "\n")
    _, said = import_deck(folder / "plate.yaml")
    assert any("activation_time" in line for line in said)


def test_particles_without_temperature_are_at_zero_in_perilab(folder):
    heat = "    Heat:\n      Variable: Temperature\n      Node Set: Left\n      Value: 50*t\n"
    models = "    Thermal Models:\n      Warm:\n        Thermal Model: Thermal Expansion\n"
    models += "        Thermal Expansion Coefficient: 1e-5\n        Reference Temperature: REF\n"
    changes = (
        ("  Boundary Conditions:\n", f"{models}  Boundary Conditions:\n{heat}"),
        ("Material Model: Soft\n", "Material Model: Soft\n      Thermal Model: Warm\n"),
        ("    Number of Steps: 4\n", "    Number of Steps: 4\n    Thermal Models: true\n"),
    )
    path, _ = import_deck(changed(folder, "plate.yaml", *changes, ("REF", "0.0")))
    assert case_of(path).material[0][1].expansion == 1e-5
    deck = changed(folder, "plate.yaml", *changes, ("REF", "20.0"))
    with pytest.raises(pd.CaseError, match=r"prescribes no temperature of 1[0-5] particles"):
        import_deck(deck, overwrite=True)
    everywhere = changed(
        folder, "other_plate.yaml", ("Node Set: Left\n      Value", "Node Set: Everything\n      Value"),
        ("Corner: 1\n", "Corner: 1\n      Everything: All\n"),
    )  # fmt: skip
    path, _ = import_deck(everywhere, folder / "b.py")
    assert case_of(path).material[0][1].reference == 20.0


def test_models_of_perilab_are_off_unless_its_solver_switches_them_on(folder):
    changes = (
        ("  Boundary Conditions:\n", "    Damage Models:\n      Weak:\n        Damage Model: Critical Stretch\n"
         "        Critical Value: 0.01\n    Thermal Models:\n      Warm:\n        Thermal Model: Thermal Expansion\n"
         "        Thermal Expansion Coefficient: 1e-5\n  Boundary Conditions:\n"),
        ("Linear Static Matrix Based:\n      Matrix Update: false", "Static:\n      m: 3"),
        ("Material Model: Correspondence Elastic", "Material Model: PD Solid Elastic"),
    )  # fmt: skip
    for kind, name in (("Damage", "Weak"), ("Thermal", "Warm")):
        named = [(f"      Material Model: {m}\n", f"      Material Model: {m}\n      {kind} Model: {name}\n")
                 for m in ("Soft", "Hard")]  # fmt: skip
        deck = changed(folder, "plate.yaml", *changes, *named)
        with pytest.raises(pd.CaseError, match=f"'{kind} Models: true' into PeriLab/Solver"):
            import_deck(deck)
        without = case_of(import_deck(deck, folder / "a.py", ignore=[f"{kind} Model"], overwrite=True)[0])
        deck = changed(
            folder, "plate.yaml", *changes, *named, ("    Static:", f"    {kind} Models: false\n    Static:")
        )
        path, _ = import_deck(deck, folder / "b.py", overwrite=True)
        assert f"{kind} Model: {name}" in path.read_text()
        off = case_of(path)
        deck = changed(folder, "plate.yaml", *changes, *named, ("    Static:", f"    {kind} Models: true\n    Static:"))
        path, said = import_deck(deck, folder / "c.py", overwrite=True)
        on = case_of(path)
        if kind == "Damage":
            assert (without.damage, off.damage, on.damage) == (None, None, pd.Brittle(pd.ConstantCritical(0.01)))
            assert any("weighted volume of PD Solid Elastic" in line for line in said)
        else:
            assert [hasattr(case.material[0][1], "expansion") for case in (without, off, on)] == [False, False, True]


def test_fixed_steps_of_perilab_are_rounded(folder):
    static = ("Linear Static Matrix Based:\n      Matrix Update: false", "Static:\n      Fixed dt: DT")
    elastic = ("Material Model: Correspondence Elastic", "Material Model: PD Solid Elastic")
    # From 0 to 2, half to even.
    for dt, count in (("0.5", 4), ("0.54", 4), ("0.58", 3), ("0.8", 2), ("1.25", 2), ("1.9", 1)):
        deck = changed(folder, "plate.yaml", static, elastic, ("Fixed dt: DT", f"Fixed dt: {dt}"))
        module = runpy.run_path(str(import_deck(deck, folder / "a.py", overwrite=True)[0]))
        assert module["case"]().steps.count == count
        assert module["time"](1.0) == pytest.approx(count * float(dt))
    deck = changed(folder, "plate.yaml", static, elastic, ("Fixed dt: DT", "Fixed dt: 4.0"))
    with pytest.raises(pd.CaseError, match="0 steps"):
        import_deck(deck)


def loaded(case):
    """Return the particles of every body force (n_forces, n)."""
    whole = case.particles.chunk(0, 1)
    view = View(whole.x, whole.sets, lambda value: value)
    return [condition.region.mask(view) for condition in case.conditions if isinstance(condition, pd.BodyForce)]


def test_body_forces_that_overlap_do_not_add_up(folder):
    other = '    Push:\n      Type: "Body Force"\n      Node Set: "Right Node Set"\n      Coordinate: "z"\n'
    other += '      Value: "5.0"\n'
    deck = changed(folder, "block.yaml", ("  Solver:\n", f"{other}  Solver:\n"), ('Node Set: "1 5', 'Node Set: "4 1 5'))
    case = case_of(import_deck(deck)[0])
    masks = loaded(case)
    assert [mask.sum() for mask in masks] == [9, 9]
    assert not (masks[0] & masks[1]).any()
    assert masks[1][3]
    forces = """\
    One:
      Variable: Force Densities
      Node Set: Left
      Coordinate: y
      Value: 1.0
    Two:
      Variable: Force Densities
      Node Set: Corner
      Coordinate: y
      Value: VALUE
"""
    for value, refused in (("2.0", True), ("1.0", False)):
        deck = changed(folder, "plate.yaml", ("  Boundary Conditions:\n", "  Boundary Conditions:\n" + forces),
                       ("VALUE", value))  # fmt: skip
        if refused:
            with pytest.raises(pd.CaseError, match="same component"):
                import_deck(deck, folder / "p.py")
            continue
        masks = loaded(case_of(import_deck(deck, folder / "p.py")[0]))
        assert np.sum(masks, axis=0).max() == 1


THERMAL = ("Density: 7800.0", "Thermal Expansion Coefficient: 1.0e-5")


def test_only_materials_of_peridigm_that_expand_have_an_expansion(folder):
    for model, more in (("Elastic Bond Based", ("      Shear Modulus: 78.0e3\n", "")),
                        ("Linear LPS Partial Volume", ("78.0e3", "78.0e3"))):  # fmt: skip
        deck = changed(folder, "block.yaml", THERMAL, ('"Elastic"', f'"{model}"'), more)
        with pytest.raises(pd.CaseError, match=f"whose {model} does not expand"):
            import_deck(deck, overwrite=True)
        path, _ = import_deck(deck, overwrite=True, ignore=["Thermal Expansion Coefficient"])
        assert "pd.Thermal" not in path.read_text()


def test_bonds_break_by_the_expansion_of_their_materials(folder):
    blocks, weak = (
        "  Blocks:\n",
        '  Damage Models:\n    Weak:\n      Damage Model: "Critical Stretch"\n      Critical Stretch: 0.5\n',
    )
    named = ("      Horizon: 1.8\n", '      Horizon: 1.8\n      Damage Model: "Weak"\n')
    alpha = "      Thermal Expansion Coefficient: "
    for material, damage, refused in (
        ("", "", 0),
        ("1e-5", "1.0e-5", 0),
        ("1e-5", "", 1),
        ("", "1e-5", 1),
        ("1e-5", "2e-5", 1),
    ):
        deck = changed(
            folder, "block.yaml", named, (blocks, weak + (f"{alpha}{damage}\n" if damage else "") + blocks),
            ("      Density: 7800.0\n", f"{alpha}{material}\n" if material else ""),
        )  # fmt: skip
        if refused:
            with pytest.raises(pd.CaseError, match="make them the same"):
                import_deck(deck, overwrite=True)
        else:
            assert isinstance(case_of(import_deck(deck, overwrite=True)[0]).damage, pd.Brittle)


def test_sets_of_one_name_are_refused(folder):
    deck = changed(folder, "block.yaml", ("    Left Node Set:", '    LEFT  NODE SET: "2"\n    Left Node Set:'))
    with pytest.raises(pd.CaseError, match="same without blanks and capitals"):
        import_deck(deck)
    for more in ("LEFT: 2", "RIGHT: 2", "corner: x < 0.6", "Block_1: 2", "block_1: x < 0.6", "BLOCK_1: All"):
        with pytest.raises(pd.CaseError, match="same without blanks and capitals"):
            import_deck(changed(folder, "plate.yaml", ("      Corner: 1\n", f"      Corner: 1\n      {more}\n")))
    with pytest.raises(pd.CaseError, match="the name of a block"):
        pd.TextFile(folder / "plate.txt", node_sets={"block_1": [1]}).chunk(0, 1)


def test_a_node_set_with_the_name_of_a_block_is_the_node_set(folder):
    x = np.array(list(itertools.product(range(5), range(2), range(2))), dtype=float)
    number = {tuple(a): k + 1 for k, a in enumerate(x.tolist())}
    corners = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
    with netCDF4.Dataset(folder / "bar.g", "w") as file:
        sizes = {
            "num_nodes": 20,
            "num_el_blk": 1,
            "num_el_in_blk1": 4,
            "eight": 8,
            "num_node_sets": 2,
            "n1": 4,
            "n2": 4,
            "l": 33,
        }
        for name, size in sizes.items():
            file.createDimension(name, size)
        for axis, values in zip("xyz", x.T, strict=True):
            file.createVariable(f"coord{axis}", "f8", ("num_nodes",))[:] = values
        connect = file.createVariable("connect1", "i4", ("num_el_in_blk1", "eight"))
        connect.elem_type = "HEX8"
        connect[:] = [[number[tuple(map(float, np.add((k, 0, 0), c)))] for c in corners] for k in range(4)]
        for sort, names in (("eb", ["bar"]), ("ns", ["bar", ""])):
            dimension = {"eb": "num_el_blk", "ns": "num_node_sets"}[sort]
            texts = file.createVariable(f"{sort}_names", "S1", (dimension, "l"))
            texts[:] = np.array([list(name.ljust(33, "\0")) for name in names], dtype="S1")
        file.createVariable("ns_prop1", "i4", ("num_node_sets",))[:] = [1, 4]
        file.createVariable("node_ns1", "i4", ("n1",))[:] = [k + 1 for k in range(20) if x[k, 0] == 0.0]
        file.createVariable("node_ns2", "i4", ("n2",))[:] = [k + 1 for k in range(20) if x[k, 0] == 4.0]
    text = PERIDIGM[: PERIDIGM.index("    Left Node Set")].replace(
        '"PdQuickGrid"\n    NeighborhoodType: "Spherical"\n    T', '"Exodus"\n    T'
    )
    text = re.sub(r"    TensorProduct3D.*?(?=  Materials)", '    Input Mesh File: "bar.g"\n', text, flags=re.DOTALL)
    text = text.replace('"block_1"', '"bar"')
    for name, nodes, axis, value in (("Hold", "bar", "x", "0.0"), ("Pull", "nodelist_4", "x", "0.01*t")):
        text += f'    {name}:\n      Type: "Prescribed Displacement"\n      Node Set: "{nodes}"\n'
        text += f'      Coordinate: "{axis}"\n      Value: "{value}"\n'
    text += PERIDIGM[PERIDIGM.index("  Solver:") : PERIDIGM.index("  Compute Class")]
    (folder / "bar.yaml").write_text(text)
    case = case_of(import_deck(folder / "bar.yaml")[0])
    found = case.particles.chunk(0, 1)
    assert found.volume.tolist() == [1.0] * 4
    sets = [found.sets[condition.region.name].tolist() for condition in case.conditions[:2]]
    assert sets == [[True, False, False, False], [False, False, False, True]]


def test_damaged_decks_end_as_cases_or_as_sentences(folder, rng):
    words = [
        "nan",
        "-1",
        "{}",
        "[1, [2]]",
        "1e400",
        '"',
        "&a",
        "*a",
        "",
        "x*y",
        "[a, b]",
        "0",
        "{a: 1}",
        "!!python/name:os.system",
    ]
    written = refused = 0
    for _ in range(120):
        lines = (PERIDIGM if rng.integers(2) else PERILAB).splitlines()
        at = int(rng.integers(len(lines)))
        kind = rng.integers(4)
        if kind == 0:
            del lines[at]
        elif kind == 1:
            lines.insert(at, lines[rng.integers(len(lines))])
        elif kind == 2:
            lines[at] = f"{lines[at].split(':')[0]}: {words[rng.integers(len(words))]}"
        else:
            place = int(rng.integers(len(lines[at]) + 1))
            lines[at] = lines[at][:place] + "\"'{}[]:#\t&*!%@`x0-"[rng.integers(18)] + lines[at][place:]
        (folder / "damaged.yaml").write_text("\n".join(lines))
        try:
            import_deck(folder / "damaged.yaml", overwrite=True)
            written += 1
        except pd.CaseError as error:
            assert "\n" not in str(error)
            refused += 1
    assert written > 5
    assert refused > 40
