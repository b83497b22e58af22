"""Breaks random lines of pdpetsc, one at a time, and reports which of them no test notices.

    pip install pytest-cov
    python tests/mutate.py 100 [seed] [whole]
    python tests/mutate.py 100 [seed] pdpetsc/damage pdpetsc/discrete/interior.py tests/bonds/test_plane_energy.py

Works on a copy of the checkout. Each broken line is judged by the tests that run it in the same process, found with
coverage; lines of compiled kernels, which coverage does not see, and lines that only other processes run by the tests
of ``WHOLE``. With the word ``whole`` all lines are, which needs no coverage. Folders and files of the package restrict
the lines; files of tests replace the default suite and ``WHOLE``. What survives is printed with what it was changed to,
and written to ``out/survivors_SEED.json``.
"""

import ast
import json
import random
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parent.parent
# Tests of lines that coverage does not see.
WHOLE = [
    "tests/declare/test_input.py",
    "tests/declare/test_scene.py",
    "tests/material/test_material.py",
    "tests/gradient/test_gradient.py",
    "tests/output/test_across.py",
    "tests/terms/test_loads.py",
    "tests/bonds/test_bonds.py",
    "tests/damage/test_damage.py",
    "tests/mesh/test_meshes.py",
    "tests/discrete/test_cracks.py",
    "tests/material/test_plasticity.py",
    "tests/solvers/test_stability.py",
    "tests/run/test_units.py",
    "tests/discrete/test_periodic.py",
    "tests/solvers/test_relaxation.py",
    "tests/terms/test_model.py",
    "tests/petsc/test_matrix_free.py",
    "tests/solvers/test_events.py",
    "tests/solvers/test_following.py",
    "tests/run/test_durable.py",
    "tests/damage/test_fracture.py",
    "tests/run/test_runs.py",
    "tests/command_line/test_cli.py",
    "tests/command_line/test_tools.py",
    "tests/gradient/test_patch.py",
    "tests/run/test_hpc.py",
    "tests/run/test_life.py",
    "tests/cases/test_beams.py",
    "tests/cases/test_methods.py",
    "tests/bonds/test_closed_forms.py",
    "tests/cases/test_bench.py",
]
# A line that is run by more tests than this is judged by so many of them, drawn at random, then by WHOLE.
MOST = 40
SECONDS = 900
SWAPS = [
    (r" < ", " >= "), (r" > ", " <= "), (r" <= ", " > "), (r" >= ", " < "), (r" == ", " != "), (r" != ", " == "),
    (r" \+ ", " - "), (r" - ", " + "), (r" \* ", " / "), (r" / ", " * "), (r" and ", " or "), (r" or ", " and "),
    (r"\bnot ", ""), (r"\bTrue\b", "False"), (r"\bFalse\b", "True"), (r" \+= ", " -= "), (r" \|= ", " &= "),
    (r" & ", " | "), (r" \| ", " & "), (r"\bmax\(", "min("), (r"\bmin\(", "max("), (r"\b0\.5\b", "0.6"),
    (r"\b1\.0\b", "1.1"), (r"\b2\.0\b", "2.1"), (r"\b1\b(?!\.)", "2"), (r"\b0\b(?!\.)", "1"),
]  # fmt: skip


def code_lines(path):
    """Return the numbers of lines that hold code, not documentation, imports, annotations or declarations."""
    tree = ast.parse(path.read_text())
    lines = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Assign | ast.AugAssign | ast.Return | ast.Expr | ast.If | ast.While | ast.For):
            if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
                continue
            end = node.body[0].lineno - 1 if hasattr(node, "body") else node.end_lineno
            lines.update(range(node.lineno, max(end, node.lineno) + 1))
    for node in ast.walk(tree):  # messages of errors are read by people
        if isinstance(node, ast.Raise):
            lines.difference_update(range(node.lineno, node.end_lineno + 1))
    return sorted(lines)


def mutants(rng, folders):
    """Yield (file, line number, new line) of random lines of the files in folders, each line once."""
    every = {path for folder in folders for path in [ROOT / folder, *(ROOT / folder).rglob("*.py")]}
    files = sorted(path for path in every if path.suffix == ".py" and path.name != "__init__.py")
    places = [(path.relative_to(ROOT), number) for path in files for number in code_lines(path)]
    rng.shuffle(places)
    for path, number in places:
        line = (ROOT / path).read_text().splitlines()[number - 1]
        code = line.split("  #")[0]
        swaps = [(pattern, new) for pattern, new in SWAPS if re.search(pattern, code) and '"' not in code]
        if swaps:
            pattern, new = rng.choice(swaps)
            hit = rng.choice(list(re.finditer(pattern, code)))
            yield path, number, code[: hit.start()] + new + code[hit.end() :]


def coverage_of(copy, tests):
    """Return those of the tests, by default of the default suite, that run each (file, line)."""
    words = ["-m", "pytest", "-q", "-p", "no:cacheprovider", "--cov=pdpetsc", "--cov-context=test", "--cov-report="]
    subprocess.run([sys.executable, *words, *tests], cwd=copy, check=False, stdout=subprocess.DEVNULL)
    import coverage

    data = coverage.CoverageData(basename=str(copy / ".coverage"))
    data.read()
    found = {}
    for measured in data.measured_files():
        name = Path(measured).relative_to(copy)
        for line, contexts in data.contexts_by_lineno(measured).items():
            found[name, line] = sorted({c.split("|")[0] for c in contexts if c})
    return found


def survives(copy, tests):
    """Return whether the given tests pass."""
    words = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *tests]
    try:
        finished = subprocess.run(words, cwd=copy, capture_output=True, timeout=SECONDS, check=False)
    except subprocess.TimeoutExpired:
        return False
    return finished.returncode == 0


def main():
    paths = [word for word in sys.argv[1:] if word.startswith(("pdpetsc", "tests"))]
    words = [word for word in sys.argv[1:] if word != "whole" and word not in paths]
    count, seed = int(words[0]), int(words[1]) if len(words) > 1 else 1
    named = [path for path in paths if path.startswith("tests")]
    folders = [path for path in paths if path not in named] or ["pdpetsc"]
    rng = random.Random(seed)
    scratch = Path(tempfile.mkdtemp())
    copy = scratch / "copy"
    shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns(".git", "out", ".venv"))
    known = {} if "whole" in sys.argv else coverage_of(copy, named)
    survivors, done = [], 0
    for path, number, line in mutants(rng, folders):
        if done == count:
            break
        target = copy / path
        before = target.read_text()
        lines = before.splitlines(keepends=True)
        old = lines[number - 1]
        lines[number - 1] = line + "\n"
        target.write_text("".join(lines))
        # A constant of a module is run by the test that imports it, and noticed by others.
        tests = known.get((path, number), []) if line.startswith(" ") else []
        chosen = rng.sample(tests, min(MOST, len(tests)))
        alive = not chosen or survives(copy, chosen)
        # Of named tests only those that run the line can notice.
        if alive and not (named and 0 < len(tests) <= MOST):
            alive = survives(copy, named or WHOLE)
        target.write_text(before)
        done += 1
        print(f"{done:4d} {'SURVIVES' if alive else 'killed  '} {path}:{number}: {old.strip()}  ->  {line.strip()}")
        sys.stdout.flush()
        if alive:
            survivors.append({"file": str(path), "line": number, "old": old.strip(), "new": line.strip()})
            (ROOT / "out").mkdir(exist_ok=True)
            (ROOT / "out" / f"survivors_{seed}.json").write_text(json.dumps(survivors, indent=1))
    print(f"{len(survivors)} of {done} survive")
    shutil.rmtree(scratch)


if __name__ == "__main__":
    main()
