"""What the papers show and what comes out here: python runs/papers/table.py [--run] [--paper NAME].

The rows are in the ``.toml`` files beside this one: what a paper prints, the command that gives the number here, what
it gave, and the verdict. Without words this writes ``docs/papers.md`` from them; ``--run`` runs every command and says
which numbers have changed. ``tests/test_papers.py`` does both.

A row has ``paper``, ``item`` (Table 1, Figure 16), ``what``, ``command`` (one word of it starts with ``out/``, the
folder of the results), ``result`` (a name in ``results`` of ``summary.json``, or in ``numbers.json``), ``scale``
(optional: the number shown is the result times it), ``printed`` (the paper's number, or its words; may be missing),
``ours`` and ``within`` (largest relative difference of a new run), ``verdict`` (one of VERDICTS), ``agrees`` (largest
relative difference of ours from a printed number that counts as reproduced) and ``why``. A number that is round-off has
``below`` instead of ``ours``. A ``misprint`` entry has ``paper``, ``item`` and ``text``.
"""

import argparse
import json
import re
import shlex
import subprocess
import sys
from pathlib import Path

import tomllib

HERE = Path(__file__).parent
ROOT = HERE.parent.parent
PAGE = ROOT / "docs" / "papers.md"
VERDICTS = ("reproduced", "misprint", "differs", "unstated")
# The papers, how many tables and figures each has, and which figures are sketches that show no result.
PAPERS = {
    "Hashim": ("N. A. Hashim, W. M. Coombs, C. E. Augarde, G. Hattori: implicit non-ordinary peridynamics", 4, 34),
    "Luo": ("J. Luo, V. Sundararaghavan (2018): stress points", 1, 14),
    "Chowdhury": ("S. R. Chowdhury, P. Roy, D. Roy, J. N. Reddy: sub-horizons", 0, 11),
    "Yaghoobi": ("A. Yaghoobi, M. G. Chorzepa (2017): higher-order weights; abstract and introduction only", 0, 0),
    "Mikes": ("K. Mikes, M. Jirasek, J. Zeman, O. Rokos, R. Peerlings: localisation in one dimension", 0, 7),
}
SKETCHES = {
    "Hashim": {1, 2, 3, 4, 5, 6, 8, 10, 13, 19, 24, 28},
    "Luo": {1, 2, 3, 4, 5, 6, 8, 11},
    "Chowdhury": {7},
    "Mikes": {1, 2, 3},
}
KINDS = ("Table", "Figure", "Section", "Eq.")


def load():
    """Return (rows, misprints) of all files, by paper and item."""
    rows, misprints = [], []
    for file in sorted(HERE.glob("*.toml")):
        found = tomllib.loads(file.read_text(encoding="utf-8"))
        rows += found.get("row", [])
        misprints += found.get("misprint", [])
    return sorted(rows, key=place), sorted(misprints, key=place)


def place(entry):
    """Return the key that sorts entries by paper, kind and number of the item."""
    item = entry["item"]
    kind = next((i for i, word in enumerate(KINDS) if item.startswith(word)), len(KINDS))
    numbers = [int(digits) for digits in re.findall(r"\d+", item)]
    return list(PAPERS).index(entry["paper"]), kind, numbers, item


def items(paper):
    """Return the tables and figures of a paper that show results."""
    _, tables, figures = PAPERS[paper]
    shown = [n for n in range(1, figures + 1) if n not in SKETCHES.get(paper, ())]
    return [f"Table {n}" for n in range(1, tables + 1)] + [f"Figure {n}" for n in shown]


def covered(rows, paper):
    """Return the tables and figures that the rows of a paper speak of; ``Figure 29, 30`` speaks of both."""
    found = set()
    for row in rows:
        if row["paper"] == paper:
            kind, _, numbers = row["item"].partition(" ")
            found |= {f"{kind} {n}" for n in re.findall(r"\d+", numbers)}
    return found


def folder_of(command):
    """Return the word of a command that names the folder of its results."""
    found = [word for word in shlex.split(command) if word.startswith("out/")]
    if len(found) != 1:
        raise ValueError(f"One word of a command must start with out/: {command}")
    return found[0]


def run(command, folder):
    """Run a command with its results in another folder; return {name: number}."""
    old = folder_of(command)
    words = [str(folder) if word == old else word for word in shlex.split(command)]
    words[0] = sys.executable if words[0] == "python" else words[0]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"{command} ended with status {done.returncode}: {done.stderr.strip()[-2000:]}")
    numbers = Path(folder) / "numbers.json"
    if numbers.exists():
        return json.loads(numbers.read_text())
    return json.loads((Path(folder) / "summary.json").read_text())["results"]


def changed(row, found):
    """Return what a new run of a row's command says otherwise than the row, or None."""
    if row["result"] not in found:
        return f"{row['item']}, {row['what']}: there is no result {row['result']}"
    number = found[row["result"]] * row.get("scale", 1.0)
    if "below" in row:
        return None if abs(number) < row["below"] else f"{row['item']}, {row['what']}: {number:.4g}"
    near = abs(number - row["ours"]) <= row["within"] * abs(row["ours"])
    return None if near else f"{row['item']}, {row['what']}: {number:.6g}, not {row['ours']:.6g}"


def wrong(row):
    """Return what is wrong with a row as it stands, or None."""
    name = f"{row.get('paper')}, {row.get('item')}, {row.get('what')}"
    for key in ("paper", "item", "what", "command", "result", "verdict"):
        if not isinstance(row.get(key), str):
            return f"{name}: {key} is missing"
    if row["paper"] not in PAPERS or row["verdict"] not in VERDICTS:
        return f"{name}: unknown paper or verdict"
    if "below" not in row and not {"ours", "within"} <= row.keys():
        return f"{name}: ours and within, or below, are missing"
    if row["verdict"] != "reproduced":
        return None if row.get("why") else f"{name}: why is missing"
    if isinstance(row.get("printed"), int | float) and "below" not in row:
        if "agrees" not in row:
            return f"{name}: agrees is missing"
        if abs(row["ours"] - row["printed"]) > row["agrees"] * abs(row["printed"]):
            return f"{name}: {row['ours']} is not {row['printed']} within {row['agrees']}"
    return None


def page():
    """Return the text of the page."""
    rows, misprints = load()
    counts = ", ".join(f"{sum(row['verdict'] == v for row in rows)} {v}" for v in VERDICTS)
    lines = [
        "# What the papers show, and what comes out here",
        "",
        f"{len(rows)} numbers: {counts}. *Unstated*: the paper does not say enough to compare. Written by",
        "`python runs/papers/table.py` from the files beside it; `make long` runs every command and compares.",
    ]
    for paper, (title, _, _) in PAPERS.items():
        own = [row for row in rows if row["paper"] == paper]
        lines += ["", f"## {title}", ""]
        if paper in SKETCHES:
            lines += [f"Figures {', '.join(map(str, sorted(SKETCHES[paper])))} are sketches.", ""]
        lines += ["| item | what | paper | here | verdict | command |", "|---|---|---|---|---|---|"]
        before = None
        for row in own:
            said = row.get("printed", "drawn")
            verdict = f"**{row['verdict']}**" + (f": {row['why']}" if row.get("why") else "")
            here = f"< {row['below']:.3g}" if "below" in row else f"{row['ours']:.5g}"
            command = "as above" if row["command"] == before else f"`{row['command']}`"
            before = row["command"]
            printed = said if isinstance(said, str) else f"{said:.5g}"
            cells = row["item"], row["what"], printed, here, verdict, command
            lines.append("| " + " | ".join(cell.replace("|", "\\|").replace("\n", " ") for cell in cells) + " |")
        own = [entry for entry in misprints if entry["paper"] == paper]
        if own:
            lines += ["", "Misprints and ambiguities:", ""]
            lines += [f"- {entry['item']}: {' '.join(entry['text'].split())}" for entry in own]
    return "\n".join(lines) + "\n"


def main():
    parser = argparse.ArgumentParser(description="Write docs/papers.md, or run what it says.")
    parser.add_argument("--run", action="store_true", help="run every command and compare")
    parser.add_argument("--paper", choices=PAPERS, help="only this paper")
    words = parser.parse_args()
    if not words.run:
        PAGE.write_text(page(), encoding="utf-8")
        return
    rows = [row for row in load()[0] if words.paper in (None, row["paper"])]
    differences = []
    for command in dict.fromkeys(row["command"] for row in rows):
        found = run(command, ROOT / folder_of(command))
        for row in rows:
            if row["command"] == command:
                difference = changed(row, found)
                print(difference or f"{row['item']}, {row['what']}: as written", flush=True)
                differences += [difference] if difference else []
    sys.exit(1 if differences else 0)


if __name__ == "__main__":
    main()
