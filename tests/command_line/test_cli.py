"""The command line: splitting, conversion, help, and wrong input that ends with status 2 and one sentence."""

import re
import textwrap
from pathlib import Path

import pytest

import pdpetsc as pd
from pdpetsc.command_line.cli import arguments_of, split
from tests.commands import called, run

GOOD = """
    import numpy as np
    import pdpetsc as pd

    def case(n=4, pull=0.1, name="x", flag=False, nu=0.3):
        return pd.Case(
            particles=pd.Lattice((0.0, 0.0), (1.0, 1.0), 1.0 / n),
            horizon=2.015 / n,
            material=pd.Hencky(E=1.0, nu=nu),
            conditions=[
                pd.Displacement(pd.region.Slab("x", high=1.0 / n), x=0.0, y=0.0),
                pd.Displacement(pd.region.Slab("x", low=1.0 - 1.0 / n), x=pull),
            ],
            results=lambda h: {"end": h["t"][-1]},
        )
"""


def write(folder, text=GOOD, *changes):
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = folder / "case.py"
    path.write_text(textwrap.dedent(text))
    return path


def test_words_go_where_they_belong():
    line = "a.py n=3 -o out -snes_monitor x=1 -ksp_rtol 1e-8 -pc_type gamg --quiet -snes_rtol -1 --restart c.h5 s=a=b"
    found = split(line.split())
    assert found.path == Path("a.py")
    assert found.parameters == {"n": "3", "x": "1", "s": "a=b"}
    assert found.petsc == ["-snes_monitor", "-ksp_rtol", "1e-8", "-pc_type", "gamg", "-snes_rtol", "-1"]
    assert (found.output, found.value("--restart"), found.flags) == (Path("out"), "c.h5", {"--quiet"})


def test_values_take_the_type_of_their_default():
    def case(n=1, x=1.0, s="a", flag=True, pair=(1, 2), anything=None):
        raise AssertionError

    found = arguments_of(case, {"n": "7", "x": "2", "s": "3", "flag": "no", "pair": "[3, 4]", "anything": "{1: 2}"})
    assert found == {"n": 7, "x": 2.0, "s": "3", "flag": False, "pair": (3, 4), "anything": {1: 2}}
    # "3," is a pair of one; what is no literal at all is refused.
    assert arguments_of(case, {"pair": "3,"})["pair"] == (3,)
    for name, text in {"n": "2.5", "x": "two", "flag": "maybe", "pair": "3;4"}.items():
        with pytest.raises(pd.CaseError, match=f"Parameter {name} takes"):
            arguments_of(case, {name: text})
    with pytest.raises(pd.CaseError, match="no parameter 'm'; it has n, x, s"):
        arguments_of(case, {"m": "1"})


def test_help_and_version(tmp_path):
    finished = called(write(tmp_path), "-h", ranks=2)
    assert finished.returncode == 0
    assert finished.stdout.count("usage:") == 1
    assert "pull=0.1" in finished.stdout and "float" in finished.stdout
    assert called("--version").stdout.strip() == f"pdpetsc {pd.__version__}"


def test_an_option_that_nothing_used_is_reported(tmp_path):
    finished = run(write(tmp_path), "-snes_monitr", "-snes_rtol", "1e-9", output=tmp_path / "out")
    assert finished.returncode == 0
    assert "No solver used the option -snes_monitr. Check the spelling, or remove it." in finished.stderr


def test_the_command_line_wins_over_the_case_and_the_defaults(tmp_path):
    path = write(tmp_path, GOOD, ("results=", 'options={"ksp_type": "cg", "pc_type": "jacobi"}, results='))
    assert "ksp cg, pc jacobi" in called(path, "-o", tmp_path / "out").stdout
    assert "ksp gmres, pc jacobi" in run(path, "-ksp_type", "gmres", output=tmp_path / "out").stdout
    path = write(tmp_path, GOOD, ("results=", 'options={"pc_type": "lu"}, results='))
    assert "ksp preonly, pc lu (mumps)" in called(path, "-o", tmp_path / "out", ranks=2).stdout


LEFT = 'pd.Displacement(pd.region.Slab("x", high=1.0 / n), x=0.0, y=0.0)'
LATTICE = "pd.Lattice((0.0, 0.0), (1.0, 1.0), 1.0 / n)"
WRONG = {
    "unknown parameter": ((), ("m=3",), "The case has no parameter 'm'; it has n, pull"),
    "value of the wrong type": ((), ("n=two",), "Parameter n takes int like 4, not 'two'"),
    "unknown pdpetsc option": ((), ("--fast",), "pdpetsc has no option '--fast'"),
    "PETSc option value": ((), ("-ksp_type", "foo"), "PETSc refused the solver options; .*foo"),
    "syntax error": ((("def case", "def def case"),), (), "syntax error in line 5"),
    "error in the case": ((("nu=nu)", "nu=nu / 0)"),), (), "failed in line 9: ZeroDivisionError"),
    "no case function": ((("def case", "def scene"),), (), r"defines no function case"),
    "not a Case": ((("return pd.Case", "return dict"),), (), "must return a pdpetsc.Case, not dict"),
    "material out of range": ((), ("nu=0.5",), "a number above -1 and below 0.5 as nu, not 0.5"),
    "missing argument": ((("(E=1.0, nu=nu)", "(E=1.0)"),), (), "failed in line 9: Hencky needs nu.$"),
    "missing argument of a region": ((('"x", high=1.0 / n', "high=1.0 / n"),), (), "Slab needs axis.$"),
    "unknown argument": ((("results=", "step=3, results="),), (), r"Case has no argument step; did you mean steps\?$"),
    "unknown argument like none": ((("results=", "zzz=3, results="),), (), "no argument zzz; it has particles, hor"),
    "unknown name": ((("pd.Hencky", "pd.Henky"),), (), r"has no attribute 'Henky'; did you mean Hencky\?$"),
    "no material": (
        (("pd.Hencky(E=1.0, nu=nu)", '[(pd.region.Slab("x", high=0.5), pd.Hencky(E=1.0, nu=nu))]'),), (),
        r"Particle 8 at \(0.625, 0.125\) has no material; let",
    ),
    "missing mesh": (((LATTICE, 'pd.Mesh("nowhere.msh")'),), (), "nowhere.msh: file not found"),
    "missing text file": (((LATTICE, 'pd.TextFile("nowhere.txt")'),), (), "Cannot read nowhere.txt"),
    "NaN position": (((LATTICE, "pd.Arrays([[0.0, 0.0], [np.nan, 1.0]], 1.0)"),), (), "position that is not a number"),
    "coincident": (
        ((LATTICE, "pd.Arrays([[0, 0], [0.2, 0], [0.2, 0], [0.1, 0.1]], 1.0)"),), (), "Particles 1 and 2 coincide",
    ),
    "negative volume": (((LATTICE, "pd.Arrays([[0, 0], [0.2, 0], [0.1, 0.1]], -1.0)"),), (), "no positive volume"),
    "horizon below the spacing": ((("2.015 / n", "0.9 / n"),), (), "below the spacing 0.25: .* at least 0.25375"),
    "flat families": (
        ((LATTICE, "pd.Lattice((0.0, 0.0), (1.0, 0.25), 0.25)"),), (), r"4 particles have a family .*ids 0, 1, 2, 3\)",
    ),
    "empty region": ((('low=1.0 - 1.0 / n), x=pull', "low=3.0), x=pull"),), (), "selects no particle: Slab"),
    "condition given twice": ((("low=1.0 - 1.0 / n)", "low=0.0)"),), (), "prescribes x of 4 particles a second time"),
    "rigid motion": (((LEFT, LEFT.replace(", y=0.0", "")),), (), "rigid motions: translation in y"),
    "unknown set": ((('pd.region.Slab("x", high=1.0 / n)', 'pd.region.Named("left")'),), (), "no set 'left'"),
    "component out of dimension": (((LEFT, LEFT.replace("y=0.0", "z=0.0")),), (), "component z, and the body has 2"),
    "not a whole number of cells": ((("(1.0, 1.0), 1.0 / n", "(1.0, 1.1), 1.0 / n"),), (), "Side y .* not a whole"),
    "steps": ((("results=", "steps=pd.Steps(0), results="),), (), "Steps needs a positive whole number"),
    "checkpoint": ((), ("--restart", "nowhere.h5"), "Cannot read the checkpoint nowhere.h5"),
    "output folder": ((), ("-o", "/dev/null/out"), "Cannot write to the output folder /dev/null/out"),
}  # fmt: skip


# What ends before anything parallel.
AT_ONCE = (
    "unknown pdpetsc option", "syntax error", "no case function", "not a Case", "steps", "missing argument",
    "missing argument of a region", "unknown argument", "unknown argument like none", "unknown name",
)  # fmt: skip
# As processes of their own: one for all, and what PETSc refuses, which promises nothing for the process after that.
ALONE = {("PETSc option value", 1), ("PETSc option value", 2), ("coincident", 2)}


@pytest.mark.parametrize("ranks", [1, 2])
@pytest.mark.parametrize("name", WRONG)
def test_wrong_input_ends_with_one_sentence(name, ranks, tmp_path):
    if ranks == 2 and name in AT_ONCE:
        pytest.skip("found before anything parallel")
    changes, arguments, message = WRONG[name]
    path = write(tmp_path, GOOD, *changes)
    words = arguments if "-o" in arguments else (*arguments, "-o", tmp_path / "out")
    start = run if (name, ranks) in ALONE else called
    finished = start(path, "--quiet", *words, ranks=ranks)
    assert finished.returncode == 2, finished.stderr
    said = [line for line in finished.stderr.splitlines() if line.startswith("pdpetsc:")]
    assert len(said) == 1
    assert re.search(message, said[0]), said[0]
    assert "Traceback" not in finished.stderr
    assert not (tmp_path / "out" / "fields.h5").exists()


def test_a_missing_case_file_is_one_sentence():
    finished = called("nowhere.py")
    assert finished.returncode == 2
    assert finished.stderr.strip() == "pdpetsc: Cannot read the case file nowhere.py: file not found."


def test_more_ranks_than_particles_are_refused(tmp_path):
    path = write(tmp_path, GOOD, (LATTICE, "pd.Arrays([[0.0, 0.0], [0.2, 0.0], [0.1, 0.1]], 1.0)"))
    finished = run(path, ranks=4, output=tmp_path / "out")
    assert finished.returncode == 2
    assert "3 particles for 4 ranks" in finished.stderr


def test_commands_that_write_files_work_in_one_process(tmp_path):
    """Two of them would write the same file at once."""
    refused = called("new", tmp_path / "bar.py", ranks=2)
    assert refused.returncode == 2
    assert "new works in one process; call it without mpirun." in refused.stderr
    assert not (tmp_path / "bar.py").exists()


def test_the_log_says_what_is_held_and_which_reactions_are_of_nothing(tmp_path):
    (tmp_path / "bar.py").write_text(
        "import pdpetsc as pd\n\n\n"
        "def case(dx=1.0):\n"
        "    return pd.Case(\n"
        "        particles=pd.Lattice((0.0, 0.0), (10.0, 4.0), dx), horizon=1.5 * dx,\n"
        "        material=pd.LinearElastic(100.0, 0.3, plane='stress'),\n"
        "        conditions=[\n"
        "            pd.Displacement(pd.region.Slab('x', high=dx), x=0.0, y=0.0),\n"
        "            pd.Displacement(pd.region.Nearest((5.0, 0.0)), y=0.01),\n"
        "        ],\n"
        "        history={'free': pd.Reaction('y', pd.region.Slab('x', low=9.0)), 'held': pd.Reaction('y')},\n"
        "    )\n"
    )
    done = called(tmp_path / "bar.py", "-o", tmp_path / "out", ranks=2)
    assert done.returncode == 0
    assert "Displacement condition 1: 4 particles held in x and y" in done.stdout
    assert "Displacement condition 2: 2 particles held in y" in done.stdout
    assert done.stderr.count("free of the history is 0, because none of its particles is held in y") == 1
    assert "held of the history" not in done.stderr
    wrong = (tmp_path / "bar.py").read_text().replace("plane=", "plan=")
    (tmp_path / "wrong.py").write_text(wrong)
    refused = called(tmp_path / "wrong.py", "-o", tmp_path / "none")
    assert refused.returncode == 2
    assert refused.stderr.endswith("LinearElastic has no argument plan; did you mean plane?\n")
