"""The gallery of examples, each of which is run and checked: python docs/gallery.py OUTDIR.

Runs every example below with ``--check``, as many side by side as there are cores, and writes a page for each and an
index in MyST Markdown to OUTDIR, and the film of the front page. An example that has ended well is not run again as
long as its parameters, the files that it imports and pdpetsc are the same. Exit status 1 if a run or its checks fail;
its name is printed.
"""

from __future__ import annotations

import ast
import hashlib
import json
import os
import shutil
import subprocess
import sys
import time
import zipfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

# The tests load this file from another folder.
sys.path.insert(0, str(Path(__file__).resolve().parent))

from thumbnails import thumbnail

ROOT = Path(__file__).resolve().parent.parent
RUNS = ROOT / "runs"
# Runs are kept here, whatever folder the pages are written to.
WORK = ROOT / "out" / "gallery"
LIMIT = 600
# Data that examples read from beside themselves.
DATA = (".json", ".msh", ".toml")


@dataclass(frozen=True)
class Example:
    """One file of ``runs/`` as the gallery shows it.

    ``words`` are its parameters at the size of the gallery and ``curve`` two columns of its history to draw. An example
    that is ``quick`` takes less than three seconds. A ``film`` has no page and no checks: all its steps are drawn.
    """

    title: str
    file: str
    words: str = ""
    curve: tuple[str, str] | None = None
    quick: bool = False
    film: bool = False

    @property
    def name(self) -> str:
        """Return the name of its page and of its folder, which is the title of a film."""
        return self.path.stem if self.film else self.file.removesuffix(".py").replace("/", "_")

    @property
    def path(self) -> Path:
        """Return its file."""
        return RUNS / self.file


SECTIONS = {
    "Beams and bars": [
        Example("Clamped beam under pressure", "beams/clamped.py", "scheme=sub_horizons ny=5"),
        Example("Cantilever bent to a hook", "beams/cantilever.py", "scheme=sub_horizons ny=9", ("u", "w")),
        Example("Square bar in pure bending", "beams/bar.py"),
        Example("Beam on an elastic bed: a force of your own", "own/foundation.py", quick=True),
    ],
    "Plates, rings and patches": [
        Example("Cook's membrane", "convergence/cook.py"),
        Example("Plate with a hole from a Gmsh mesh", "plates/gmsh_hole.py"),
        Example("Ring under internal pressure", "convergence/ring.py", "n=20"),
        Example(
            "Patch test on an irregular cloud",
            "patch/tension.py",
            "shake=0.2 weights=conforming distribution=surface",
            quick=True,
        ),
        Example("Effective modulus of a periodic cell", "patch/laminate.py", quick=True),
    ],
    "Rubber, metal and materials of your own": [
        Example("Rubber block in one line of energy", "solids/rubber_block.py", curve=("stretch", "force")),
        Example("Twisted rubber column", "solids/twisting_column.py", "steps=2"),
        Example("Material of your own", "own/material.py", curve=("t", "force"), quick=True),
        Example("Elastic-plastic plate", "plasticity/plate.py", curve=("t", "force")),
        Example("Necking bar", "solids/yielding_neck.py", "n=6 steps=20", ("t", "pull")),
    ],
    "Heat": [
        Example("Bimetal strip", "thermal/bimetal.py"),
        Example("Slab that cools", "thermal/slab.py", "dim=2", ("t", "middle")),
        Example("Quenched ceramic plate", "thermal/quench.py", "dx=0.1 width=9 time=0.2 steps=24"),
    ],
    "Cracks": [
        Example("Stress intensity of an edge crack", "fracture/edge_crack.py", "n=40"),
        Example("Double cantilever beam", "fracture/double_cantilever.py", "law=none"),
        Example("Plate broken through snap-back", "bonds/snap_back.py", curve=("displacement", "force")),
        Example(
            "Notched concrete beam, to separation",
            "fracture/notched_beam.py",
            "n=16 step=0.05 end=1.2 damage=point",
            ("opening", "t"),
        ),
        Example("Fibre that debonds", "fracture/interface.py", curve=("t", "force")),
    ],
    "Waves and impact": [
        Example(
            "Crack in glass that branches", "dynamics/branching.py", "n=80 end=6e-5 records=60", ("time", "kinetic")
        ),
        Example("Plate hit between two notches", "dynamics/kalthoff.py", "n=100"),
    ],
    "Many particles": [
        Example("Twisted bar without a matrix", "solids/torsion.py", "n=24"),
    ],
}
EXAMPLES = [example for examples in SECTIONS.values() for example in examples]
# The film of the front page.
FILM = Example(
    "Crack from the corner of a concrete panel", "fracture/l_panel.py",
    "damage=point n=20 horizon=2.015 G=2 step=0.02 end=0.6", film=True,
)  # fmt: skip
FILM_FILE = "crack.gif"


def imported(path: Path) -> set[Path]:
    """Return a file of ``runs/`` and those there that it imports, by their names, and so on."""
    found, waiting = set(), [path]
    while waiting:
        one = waiting.pop()
        if one in found:
            continue
        found.add(one)
        for node in ast.walk(ast.parse(one.read_text())):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and node.module:
                names = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
            for name in names:
                waiting += RUNS.rglob(f"{name.split('.')[-1]}.py")
    return found


def relative(path: Path) -> str:
    """Return the path of a file from the root of the project."""
    return str(path.relative_to(ROOT))


def key(example: Example) -> str:
    """Return what a run depends on, as a number: its parameters, its files with the data beside them, the package."""
    sources = imported(example.path)
    data = {path for source in sources for path in source.parent.iterdir() if path.suffix in DATA}
    package = {path for path in (ROOT / "pdpetsc").rglob("*.py") if "__pycache__" not in path.parts}
    digest = hashlib.blake2b(example.words.encode())
    for path in sorted(sources | data | package):
        digest.update(relative(path).encode() + path.read_bytes())
    return digest.hexdigest()


def command(example: Example) -> str:
    """Return the line that runs an example."""
    return " ".join(word for word in ("python -m pdpetsc", f"runs/{example.file}", example.words, "--check") if word)


def perform(example: Example, work: Path = WORK) -> str:
    """Run an example into its folder, unless it is there already; return what is wrong with it, empty for nothing."""
    folder = work / example.name
    kept, now = folder / "key", key(example)
    if kept.is_file() and kept.read_text() == now:
        return ""
    kept.unlink(missing_ok=True)
    before = time.perf_counter()
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    words = [sys.executable, "-m", "pdpetsc"]
    check = [] if example.film else ["--check"]
    runs = [[*words, str(example.path), *example.words.split(), *check, "-o", str(folder)]]
    pictures = ["picture.png"]
    if example.curve is not None:
        runs.append([*words, "plot", str(folder), f"x={example.curve[0]}", f"y={example.curve[1]}"])
        pictures.append("history.png")
    if example.film:
        runs.append([*words, "plot", str(folder), "--animate", "format=gif"])
        pictures.append("deformed.gif")
    for run in runs:
        try:
            done = subprocess.run(
                run, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=LIMIT, check=False
            )
        except subprocess.TimeoutExpired:
            return f"it takes longer than {LIMIT} seconds"
        if done.returncode:
            return (done.stderr.strip().splitlines() or [f"exit status {done.returncode}"])[-1]
    for picture in pictures:
        if not (folder / picture).is_file():
            return f"it has not drawn {picture}"
    kept.write_text(now)
    print(f"{example.file}: {time.perf_counter() - before:.0f} s", flush=True)
    return ""


def first_sentence(text: str) -> str:
    """Return the first paragraph of a docstring in one line."""
    return " ".join(text.split("\n\n")[0].split())


def code(source: str) -> str:
    """Return the source of a file behind its docstring, which its page begins with."""
    first = ast.parse(source).body[0]
    told = isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant)
    return "\n".join(source.split("\n")[first.end_lineno if told else 0 :]).strip()


def pack(example: Example, path: Path) -> None:
    """Write a zip file with an example, the files that it imports and the data beside them, with their paths."""
    sources = imported(example.path)
    data = {one for source in sources for one in source.parent.iterdir() if one.suffix in DATA}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as packed:
        for one in sorted(sources | data):
            packed.write(one, relative(one))


def page(example: Example, work: Path, images: Path) -> str:
    """Return the page of an example that has been run; its pictures and files are written to ``images``."""
    folder = work / example.name
    thumbnail(folder, images / f"{example.name}_thumbnail.png")
    summary = json.loads((folder / "summary.json").read_text())
    source = example.path.read_text()
    told = ast.get_docstring(ast.parse(source)) or ""
    lines = [f"# {example.title}", "", told, "", "```console", f"$ {command(example)}", "```", ""]
    for picture, text in (("picture.png", example.title), ("history.png", "history")):
        if (folder / picture).is_file() and (picture == "picture.png" or example.curve is not None):
            shown = images / f"{example.name}_{picture}"
            shutil.copyfile(folder / picture, shown)
            lines += [f"![{text}]({images.name}/{shown.name})", ""]
    lines += ["| result | expected | got | difference | tolerance | source |", "|---|---|---|---|---|---|"]
    for check in summary["checks"]:
        numbers = (f"{check[name]:.6g}" for name in ("value", "got", "difference", "tolerance"))
        lines.append(f"| `{check['result']}` | {' | '.join(numbers)} | {check['source'].replace('|', '/')} |")
    seconds = sum(summary["timings"].values())
    lines += ["", f"{summary['particles']:,} particles, {seconds:.2g} seconds on one core.", ""]
    pack(example, images / f"{example.name}.zip")
    lines += [
        f"{{download}}`All files of this example <{images.name}/{example.name}.zip>`; `runs/{example.file}` is:",
        "", "```python", code(source), "```", "",
    ]  # fmt: skip
    return "\n".join(lines)


def index(sections: dict[str, list[Example]], images: Path) -> str:
    """Return the page with all examples."""
    lines = [
        "# Examples",
        "",
        "Every example is one file of `runs/`, run as its page says; the numbers on the pages are those of that run, "
        "beside what they should be.",
    ]
    for title, examples in sections.items():
        lines += ["", f"## {title}", "", "````{grid} 1 2 3 3", ":gutter: 3", ""]
        for example in examples:
            picture = f"{example.name}_thumbnail.png"
            told = first_sentence(ast.get_docstring(ast.parse(example.path.read_text())) or "")
            lines += [f"```{{grid-item-card}} {example.title}", f":link: {example.name}", ":link-type: doc"]
            lines += (
                [f":img-top: {images.name}/{picture}", ":class-img-top: thumbnail"]
                if (images / picture).is_file()
                else []
            )
            lines += ["", told, "```", ""]
        lines += ["````"]
    lines += ["", "```{toctree}", ":hidden:", ""]
    lines += [example.name for examples in sections.values() for example in examples]
    return "\n".join([*lines, "```", ""])


def build(
    folder: Path, sections: dict[str, list[Example]], work: Path = WORK, film: Example | None = None
) -> list[str]:  # fmt: skip
    """Run what has changed, write the pages of all that ended well, and return a sentence for each that did not."""
    images = folder / "images"
    images.mkdir(parents=True, exist_ok=True)
    examples = [example for section in sections.values() for example in section]
    if film is not None:
        examples.append(film)
    # Those that take long are begun first.
    order = sorted(examples, key=lambda example: example.quick)
    with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        wrong = dict(zip(order, pool.map(lambda example: perform(example, work), order), strict=True))
    well = {title: [example for example in some if not wrong[example]] for title, some in sections.items()}
    for example in (example for some in well.values() for example in some):
        (folder / f"{example.name}.md").write_text(page(example, work, images))
    if film is not None and not wrong[film]:
        shutil.copyfile(work / film.name / "deformed.gif", images / FILM_FILE)
    (folder / "index.md").write_text(index({title: some for title, some in well.items() if some}, images))
    return [f"{example.file}: {why}" for example, why in wrong.items() if why]


def main(words: Sequence[str]) -> int:
    """Write the gallery to the folder that is named; return the exit status."""
    if len(words) != 1 or words[0].startswith("-"):
        print("usage: python docs/gallery.py OUTDIR", file=sys.stderr)
        return 2
    failed = build(Path(words[0]), SECTIONS, film=FILM)
    for sentence in failed:
        print(f"gallery: {sentence}", file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
