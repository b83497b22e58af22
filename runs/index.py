"""The list of all examples, with a number or a picture each: python runs/index.py writes runs/README.md.

Descriptions are the first sentences of the files, numbers those of ``docs/reference/papers.md``: the first one that
the paper prints and this file gives.
"""

import ast
import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parent))
from papers.table import load

HERE = Path(__file__).parent
PAGE = HERE / "README.md"
FOLDERS = {
    "beams": "Beams: clamped, simply supported, cantilever; convergence, stability, speed",
    "plates": "Plates with openings and a brick, against finite elements",
    "singular_bar": "Bars whose modulus vanishes: zero-energy modes and their cures",
    "plasticity": "Elastic-plastic plate and beam",
    "patch": "Patch tests, eigenvalues, clouds without a lattice",
    "convergence": "Orders of convergence against exact solutions and finite elements",
    "hard": "Large strains and shaken clouds: what every method makes of hard cases",
    "solids": "Solids: rubber, necking, bending and expansion in plastic flow, bodies that keep their volume",
    "thermal": "Temperature: strains without stress, heat conduction, quenching",
    "bonds": "Bond-based and state-based materials against closed forms",
    "fracture": "Cracks, softening, complete separation",
    "localisation": "Where damage localises: periodic cells, event by event",
    "contact": "Contact with rigid tools",
    "stability": "Natural frequencies and buckling loads",
    "dynamics": "Motion with inertia: waves, impact, dynamic fracture",
    "own": "A material and a force of one's own",
    "dog_bone": "A body from a mesh",
    "bench": "Timings, memory, scaling: `python runs/bench/all.py --quick`",
    "papers": "What the papers show and what comes out here",
}
# Pictures that a file draws.
PICTURES = {
    "beams/clamped.py": "clamped.png",
    "fracture/plate_with_hole.py": "plate_with_hole.png",
    "fracture/plate_figures.py": "plate_published.png",
    "localisation/figures.py": "localisation_constant.png",
    "fracture/figures.py": "fracture_path.png",
    "plates/pages.py": "sub_horizons.png",
}


def sentence(path):
    """Return what a file says of itself first, without its command."""
    text = (ast.get_docstring(ast.parse(path.read_text())) or "").split("\n\n")[0].replace("\n", " ")
    return text.split(": python")[0].split(": [mpirun")[0].rstrip(".:") + "."


def numbers():
    """Return the first printed number and ours of every file."""
    found = {}
    for row in load()[0]:
        name = next(word for word in row["command"].split() if word.endswith(".py")).removeprefix("runs/")
        if isinstance(row.get("printed"), float | int) and "ours" in row and name not in found:
            said = f"{row['what']}: {row['ours']:.4g}, printed {row['printed']:g}"
            found[name] = f"{row['paper']}, {row['item']}: {said}"
    return found


def page():
    """Return the text of the page."""
    known = numbers()
    lines = [
        "# Examples",
        "",
        "Files with a `case` run by `python -m pdpetsc FILE name=value`; the others by `python FILE`. The numbers are "
        "rows of [what the papers show](../docs/reference/papers.md). This page is written by `python runs/index.py`.",
    ]
    for folder, title in FOLDERS.items():
        lines += ["", f"## {title}", "", "| | what | number or picture |", "|---|---|---|"]
        for path in sorted((HERE / folder).glob("*.py")):
            name = f"{folder}/{path.name}"
            picture = f"[picture](../docs/pictures/{PICTURES[name]})" if name in PICTURES else ""
            shown = " ".join(part for part in (known.get(name, ""), picture) if part)
            lines.append(f"| [{path.name}]({name}) | {sentence(path)} | {shown.replace('|', '/')} |")
    lines += ["", "Scripts for queues are in [hpc](hpc).", ""]
    return "\n".join(lines)


if __name__ == "__main__":
    PAGE.write_text(page())
