"""Cases, options, files and signals drawn at random: every run ends soon, in one sentence, with the status it deserves.

Exit status 0 means a summary that says "converged", finite results, a complete history and a checkpoint.
"""

import contextlib
import json
import math
import os
import random
import shutil
import signal
import subprocess
import time

import pytest

import pdpetsc as pd
from pdpetsc.command_line.cli import arguments_of, load_case
from tests.commands import ROOT, command, history, summary

# How many draws are run in this process and in processes: the same ones on any machine, whatever else it does.
INSIDE, OUTSIDE = 20, 4
MANY_INSIDE, MANY_OUTSIDE = 30, 6
# One run of a few particles, on a busy machine [s].
SOON = 45.0

CASE = r"""
import math
import os
import numpy as np
import pdpetsc as pd

DEFECTS = {
    "zero": lambda: 1 / 0, "memory": lambda: bytearray(2**62), "exit": lambda: sys.exit(0), "key": lambda: {}["none"],
    "case": lambda: (_ for _ in ()).throw(pd.CaseError("wrong, says the case")), "os": lambda: open("/nowhere/x"),
    "recursion": lambda: recurse(), "assert": lambda: (_ for _ in ()).throw(AssertionError),
    "unicode": lambda: (_ for _ in ()).throw(ValueError("g\\u00fc\\nltig\\n\\u2603")), "none": lambda: None,
}


def recurse():
    return recurse()


def case(dim=2, n=3, horizon=2.015, material="hencky", nu=0.3, E=1.0, steps=2, pull=0.1, defect="none", where="none",
         rank=-1, value="nan", solver="newton", picture="xx", checkpoints=1, dx=1.0, options="{}"):
    from mpi4py import MPI

    here = rank < 0 or MPI.COMM_WORLD.rank == rank

    def at(place):
        if place == where and here:
            DEFECTS[defect]()

    def odd(place, right):
        if place != where or defect != "none" or not here:
            return right
        return {
            "nan": np.nan * np.ones(np.shape(right)), "text": "text", "none": None, "short": np.ones(1),
    "ragged": [1, [2]],
            "complex": 1j * np.ones(np.shape(right)), "inf": np.inf * np.ones(np.shape(right)), "object": object(),
        }[value]

    def displacement(x, t):
        if t > 0.0:
            at("condition")
        return odd("condition", pull * t * np.ones(len(x)))

    def field(solution):
        if solution.t > 0.0:
            at("later field")
        at("field")
        return odd("field", solution.volume)

    class Number(pd.Quantity):
        def evaluate(self, solution):
            if solution.t > 0.0:
                at("later history")
            at("history")
            return odd("history", float(solution.t))

    def results(history):
        at("results")
        return odd("results", {"t": odd("result", history["t"][-1])})

    class Ours(pd.influence.Influence):
        def __call__(self, r):
            at("influence")
            return odd("influence", np.ones_like(r))

    at("case")
    law = {
        "hencky": lambda: pd.Hencky(E=E, nu=nu), "linear": lambda: pd.LinearElastic(E=E, nu=nu),
        "neo": lambda: pd.NeoHookean(E=E, nu=nu), "bonds": lambda: pd.BondBased(E=E),
    }[material]()
    rest = {axis: 0.0 for axis in "xyz"[:dim]}
    size = (n + 1.0,) + (float(n),) * (dim - 1)
    return pd.Case(
        particles=pd.Lattice((0.0,) * dim, tuple(dx * side for side in size), dx), horizon=horizon * dx, material=law,
        influence=Ours(),
        conditions=[
            pd.Displacement(pd.region.Slab("x", high=1.01 * dx), **rest),
            pd.Displacement(pd.region.Slab("x", low=(n - 0.01) * dx), x=displacement),
        ],
        steps=pd.Steps(steps), solver=pd.choose("solver", solver, pd.SOLVERS) if solver != "newton" else pd.Newton(),
        history={"a": Number(), "E": pd.StrainEnergy()}, fields=[field, pd.stress], results=results,
        picture=pd.Picture(pd.stress, picture) if picture != "no" else None, checkpoints=checkpoints,
        options=eval(options),
    )
"""
PLACES = (
    "case", "condition", "field", "later field", "history", "later history", "results", "result", "influence",
)  # fmt: skip
DEFECTS = ("zero", "memory", "exit", "key", "case", "os", "recursion", "assert", "unicode")
VALUES = ("nan", "text", "none", "short", "ragged", "complex", "inf", "object")
OPTIONS = {
    "snes_rtol": ("1e-9", "abc", "-1", "nan", "0"), "snes_max_it": ("0", "5", "x"),
    "ksp_type": ("cg", "gmres", "none"),
    "pc_type": ("lu", "jacobi", "none", "gamg", "shell", "nothing", "asm", "ilu"),
    "snes_type": ("ksponly", "newtontr", "q"),
    "snes_linesearch_type": ("basic", "bt", "x"), "pd_jacobian": ("matfree", "assembled", "other"),
    "ksp_rtol": ("2", "q"),
    "snes_force_iteration": (None,), "snes_nothing": ("1",), "ksp_max_it": ("0", "1"), "snes_view": (":/nowhere/x",),
    "mat_mumps_icntl_14": ("1", "x"), "snes_stol": ("1e3",), "snes_atol": ("1e3",),
    "snes_divergence_tolerance": ("1e-9",),
    "pc_factor_mat_solver_type": ("petsc", "nothing"), "snes_lag_jacobian": ("0", "5"), "-dashed": ("1",),
}  # fmt: skip


def drawn(rng, ranks=1):
    """Return parameters of the case, mostly right ones and one or two that are not."""
    words = {"dim": rng.choice((1, 2, 2, 3)), "material": rng.choice(("hencky", "linear", "neo", "bonds"))}
    words["n"] = rng.choice((2, 3, 4))
    kind = rng.choice(("number", "defect", "defect", "value", "options", "options", "none"))
    if kind == "number":
        name, values = rng.choice(
            [
                ("horizon", (0.5, 1.0, 0.0, -1.0, 50.0, math.inf, math.nan)),
    ("nu", (0.5, -1.0, 0.499999, math.nan, 2.0)),
                ("E", (0.0, -1.0, 1e300, 1e-300, math.inf, math.nan)), ("steps", (0, -1, 7)), ("n", (0, 1, -3)),
                ("pull", (0.0, -50.0, 1e300, math.nan, math.inf, 1e-300)), ("picture", ("xyz", "q", "no", "")),
                ("checkpoints", (0, -1, 3)), ("dx", (0.0, -1.0, 1e-200, 1e200, math.nan)), ("dim", (0, 4)),
                ("solver", ("relaxation", "events", "path", "other")),
            ]
        )  # fmt: skip
        words[name] = rng.choice(values)
    elif kind == "defect":
        words |= {"where": rng.choice(PLACES), "defect": rng.choice(DEFECTS)}
    elif kind == "value":
        words |= {"where": rng.choice(PLACES[1:]), "value": rng.choice(VALUES)}
    elif kind == "options":
        names = rng.sample(sorted(OPTIONS), rng.choice((1, 1, 2)))
        words["options"] = repr({name: rng.choice(OPTIONS[name]) for name in names})
    if ranks > 1:
        words["rank"] = rng.choice((-1, 0, ranks - 1))
    return words


def right(folder):
    """Fail unless a run whose exit status is 0 has left what a finished run leaves."""
    left, t = summary(folder), history(folder)["t"]
    assert left["status"] == "converged"
    assert all(value is not None and math.isfinite(value) for value in left["results"].values())
    assert t[-1] == pytest.approx(1.0)
    assert len(t) == len(left["steps"]) + 1
    assert not (folder / "traceback.txt").exists()


def check_failure(folder, earlier):
    """Fail where a run that failed looks as if it were finished, unless that is an earlier run, which is whole."""
    path = folder / "summary.json"
    if path.is_file():
        text = path.read_text()
        assert text == earlier or json.loads(text)["status"] not in ("converged", "running")


def draws_inside(folder, seeds):
    """Run draws with ``pdpetsc.run``, which must return or raise what it says."""
    path = folder / "case.py"
    path.write_text(CASE)
    function = load_case(path)
    done = 0
    for seed in seeds:
        words = drawn(random.Random(seed))
        if "options" in words:
            continue  # PETSc promises nothing for the process in which it has refused something
        output = folder / str(seed % 3)  # now and then over an earlier run
        earlier = (output / "summary.json").read_text() if (output / "summary.json").exists() else ""
        (output / "traceback.txt").unlink(missing_ok=True)
        before = time.monotonic()
        try:
            scene = function(**arguments_of(function, {name: str(value) for name, value in words.items()}))
        except (Exception, SystemExit):
            continue  # the command line names the line
        try:
            results = pd.run(scene, output)
        except pd.errors.PdpetscError as error:
            said = str(error)
            assert "\n" not in said, (seed, words, said)
            assert not getattr(error, "bug", False), (seed, words, said)
            check_failure(output, earlier)
        else:
            assert all(math.isfinite(value) for value in results.values()), (seed, words)
            right(output)
        assert time.monotonic() - before < SOON, (seed, words)
        done += 1
    return done


def draws_outside(folder, seeds):
    """Run draws as a user does, some on two ranks, some signalled, some with files in the way."""
    path = folder / "case.py"
    path.write_text(CASE)
    done = 0
    for seed in seeds:
        rng = random.Random(seed)
        ranks = rng.choice((1, 1, 2))
        words = drawn(rng, ranks)
        output = folder / "out"
        output.unlink() if output.is_file() else shutil.rmtree(output, ignore_errors=True)
        more = in_the_way(rng, folder, output)
        line = [*(f"{name}={value}" for name, value in words.items()), *more]
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
        pipes = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "text": True}
        process = subprocess.Popen(command(path, *line, ranks=ranks, output=output), env=environment, **pipes)
        sent = rng.random() < 0.2
        if sent:
            # Not before main has taken signals: until then Python and the loader do with them what they do.
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(rng.uniform(1.0, 4.0))
            process.send_signal(rng.choice((signal.SIGINT, signal.SIGTERM)))
        try:
            _, stderr = process.communicate(timeout=SOON)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
            raise AssertionError(f"seed {seed} hangs: {ranks} ranks, {line}") from None
        what = (seed, ranks, line, process.returncode, stderr)
        said = [text for text in stderr.splitlines() if text.startswith("pdpetsc: ")]
        assert "Traceback" not in stderr or sent, what
        if process.returncode == 0:
            right(output)
            assert len(said) <= 1, what
        elif not sent:
            assert process.returncode in (1, 2), what
            assert len(said) == 1, what
            assert "defect of pdpetsc" not in stderr, what
            check_failure(output, "")
        done += 1
    return done


def in_the_way(rng, folder, output):
    """Put something in the way of the output, or nothing; return more words for the command line."""
    kind = rng.choice(("nothing", "nothing", "file", "folder", "checkpoint", "petscrc", "word", "summary"))
    if kind == "file":
        output.write_text("a file") if not output.exists() else None
        return ["-o", str(output)]
    if kind == "folder":
        (output / rng.choice(("history.csv", "fields.h5", "picture.png", "checkpoint.h5"))).mkdir(parents=True)
    if kind == "summary":
        (output / "summary.json").mkdir(parents=True)
    if kind == "checkpoint":
        (folder / "c.h5").write_bytes(rng.randbytes(rng.choice((0, 8, 4096))))
        return ["--restart", str(folder / "c.h5")]
    if kind == "word":
        return [rng.choice(("steps=two", "--fast", "stray", "m=1", "-snes_rtol", "n=", "--restart", "--solver=x"))]
    return []


def test_draws_in_this_process_end_as_they_say(tmp_path):
    assert draws_inside(tmp_path, range(INSIDE)) > INSIDE // 4


@pytest.mark.long
def test_draws_on_the_command_line_end_as_they_say(tmp_path):
    assert draws_outside(tmp_path, range(OUTSIDE)) == OUTSIDE


@pytest.mark.long
def test_many_draws_end_as_they_say(tmp_path):
    first = 1000
    assert draws_inside(tmp_path, range(first, first + MANY_INSIDE)) > MANY_INSIDE // 4
    assert draws_outside(tmp_path, range(first, first + MANY_OUTSIDE)) == MANY_OUTSIDE
