"""What the papers show and what comes out here: python runs/papers/table.py [--run] [--paper NAME].

The rows are in the ``.toml`` files beside this one: what a paper prints, the command that gives the number here, what
it gave, and the verdict. Without words this writes ``docs/reference/papers.md`` from them; ``--run`` runs every command
and says which numbers have changed. ``tests/cases/test_papers.py`` does both.

A row has ``paper``, ``item`` (Table 1, Figure 16), ``what``, ``command`` (one word of it starts with ``out/``, the
folder of the results), ``result`` (a name in ``results`` of ``summary.json``, or in ``numbers.json``), ``scale``
(optional: the number shown is the result times it), ``printed`` (the paper's number, or its words; may be missing),
``ours`` and ``within`` (largest relative difference of a new run), ``verdict`` (one of VERDICTS), ``agrees`` (largest
relative difference of ours from a printed number that counts as reproduced) and ``why``. A number that is round-off has
``below`` instead of ``ours``. What words say of a number is in ``least`` and ``most``, bounds in the unit shown: a row
whose words are called reproduced must have one of them, or ``below``; with bounds ``within`` may be missing. A
``misprint`` entry has ``paper``, ``item`` and ``text``.
"""

import argparse
import json
import re
import shlex
import subprocess
import sys
from pathlib import Path

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

HERE = Path(__file__).parent
ROOT = HERE.parent.parent
PAGE = ROOT / "docs" / "reference" / "papers.md"
VERDICTS = ("reproduced", "misprint", "differs", "unstated")
# The papers, how many tables and figures each has, and which figures are sketches or set-ups that show no result.
PAPERS = {
    "Hashim": ("N. A. Hashim, W. M. Coombs, C. E. Augarde, G. Hattori: implicit non-ordinary peridynamics", 4, 34),
    "Luo": ("J. Luo, V. Sundararaghavan (2018): stress points", 1, 14),
    "Chowdhury": ("S. R. Chowdhury, P. Roy, D. Roy, J. N. Reddy: sub-horizons", 0, 11),
    "Yaghoobi": ("A. Yaghoobi, M. G. Chorzepa (2017): higher-order weights; abstract and introduction only", 0, 0),
    "Mikes": ("K. Mikes, M. Jirasek, J. Zeman, O. Rokos, R. Peerlings: localisation in one dimension", 0, 7),
}
SKETCHES = {
    "Hashim": {1, 2, 3, 4, 5, 6, 8, 10, 13, 19, 24},
    "Luo": {1, 2, 3, 4, 5, 6},
    "Mikes": {1, 3},
}
# What decides many rows of a paper and is not in its text.
NOTES = {
    "Hashim": (
        "The unit of length of G is not in the text and is fitted: 15.933 mm to Table 2, for Tables 2 and 3 and "
        "Figures 14, 15, 17, 18 and 20 to 23; 1.041 m to Table 4, for Table 4 and Figures 25 to 27; one metre is "
        "chosen for the G = 0.01 of Figure 11, for Figures 9, 11 and 12. "
        "Each of the three is one number, which all rows that use it share."
    ),
    "Mikes": (
        "The least critical strain, 0.0001, is not in the text: it is fitted to the level of links 10 spacings long in "
        "Figure 6, which is therefore an input. The other three levels follow from it."
    ),
}
MOST_AGREES, MOST_WITHIN = 0.05, 0.2
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


def outside(row, number):
    """Return which bound of a row a number misses, or None."""
    if "below" in row and not abs(number) < row["below"]:
        return f"{number:.6g} is not below {row['below']:.6g}"
    if "least" in row and not number >= row["least"]:
        return f"{number:.6g} is less than {row['least']:.6g}"
    if "most" in row and not number <= row["most"]:
        return f"{number:.6g} is more than {row['most']:.6g}"
    return None


def changed(row, found):
    """Return what a new run of a row's command says otherwise than the row, or None."""
    name = f"{row['item']}, {row['what']}"
    if row["result"] not in found:
        return f"{name}: there is no result {row['result']}"
    number = found[row["result"]] * row.get("scale", 1.0)
    missed = outside(row, number)
    if missed:
        return f"{name}: {missed}"
    if "within" in row and not abs(number - row["ours"]) <= row["within"] * abs(row["ours"]):
        return f"{name}: {number:.6g}, not {row['ours']:.6g}"
    return None


def in_words(row):
    """Return whether the paper says what a row shows in words, or draws it, and prints no number."""
    return not isinstance(row.get("printed"), int | float)


def wrong(row):
    """Return what is wrong with a row as it stands, or None."""
    name = f"{row.get('paper')}, {row.get('item')}, {row.get('what')}"
    for key in ("paper", "item", "what", "command", "result", "verdict"):
        if not isinstance(row.get(key), str):
            return f"{name}: {key} is missing"
    if row["paper"] not in PAPERS or row["verdict"] not in VERDICTS:
        return f"{name}: unknown paper or verdict"
    bounded = bool({"least", "most"} & row.keys())
    if "below" not in row and ("ours" not in row or not (bounded or "within" in row)):
        return f"{name}: ours and within, or bounds, or below, are missing"
    if not bounded and row.get("within", 0.0) > MOST_WITHIN:
        return f"{name}: within is more than {MOST_WITHIN}"
    missed = outside(row, row["ours"]) if "ours" in row else None
    if missed:
        return f"{name}: {missed}"
    if row["verdict"] != "reproduced":
        return None if row.get("why") else f"{name}: why is missing"
    if in_words(row):
        return None if bounded or "below" in row else f"{name}: words without least, most or below"
    if "below" in row:
        return None
    if "agrees" not in row:
        return f"{name}: agrees is missing"
    if row["agrees"] > MOST_AGREES and not row.get("why"):
        return f"{name}: agrees is more than {MOST_AGREES} and why is missing"
    if abs(row["ours"] - row["printed"]) > row["agrees"] * abs(row["printed"]):
        return f"{name}: {row['ours']} is not {row['printed']} within {row['agrees']}"
    return None


def said(row):
    """Return what the paper says of a row's number, and the bounds that is taken for."""
    printed = row.get("printed", "drawn")
    words = printed if isinstance(printed, str) else f"{printed:.5g}"
    bounds = [f"{word} {row[key]:.5g}" for key, word in (("least", "at least"), ("most", "at most")) if key in row]
    return words + (f" [{', '.join(bounds)}]" if bounds and row["verdict"] == "reproduced" else "")


def summary(rows):
    """Return the lines of the table that counts the verdicts of every paper."""
    lines = ["| paper | " + " | ".join(VERDICTS) + " |", "|---|" + "---|" * len(VERDICTS)]
    for paper in (*PAPERS, "all"):
        own = [row["verdict"] for row in rows if paper in ("all", row["paper"])]
        lines.append(f"| {paper} | " + " | ".join(str(own.count(verdict)) for verdict in VERDICTS) + " |")
    return lines


def sketches(paper):
    """Return the sentence that names the sketches of a paper."""
    numbers = sorted(SKETCHES[paper])
    if len(numbers) == 1:
        return f"Figure {numbers[0]} is a sketch or a set-up."
    return f"Figures {', '.join(map(str, numbers))} are sketches or set-ups."


def page():
    """Return the text of the page."""
    rows, misprints = load()
    reproduced = [row for row in rows if row["verdict"] == "reproduced"]
    words = sum(map(in_words, reproduced))
    lines = [
        "# What the papers show, and what comes out here",
        "",
        f"{len(rows)} numbers. Of the {len(reproduced)} reproduced, {len(reproduced) - words} are checked against a",
        f"printed number and {words} against words or round-off, taken for bounds (in brackets, or *<*) that are ours.",
        "*Unstated*: the paper does not say enough to compare. Written by `python runs/papers/table.py` from the files",
        "beside it; `make long` runs every command and compares.",
        "",
        *summary(rows),
    ]
    for paper, (title, _, _) in PAPERS.items():
        own = [row for row in rows if row["paper"] == paper]
        lines += ["", f"## {title}", ""]
        if paper in SKETCHES:
            lines += [sketches(paper), ""]
        if paper in NOTES:
            lines += [NOTES[paper], ""]
        lines += ["| item | what | paper | here | verdict | command |", "|---|---|---|---|---|---|"]
        before = None
        for row in own:
            verdict = f"**{row['verdict']}**" + (f": {row['why']}" if row.get("why") else "")
            here = f"< {row['below']:.3g}" if "below" in row else f"{row['ours']:.5g}"
            command = "as above" if row["command"] == before else f"`{row['command']}`"
            before = row["command"]
            cells = row["item"], row["what"], said(row), here, verdict, command
            lines.append("| " + " | ".join(cell.replace("|", "\\|").replace("\n", " ") for cell in cells) + " |")
        own = [entry for entry in misprints if entry["paper"] == paper]
        if own:
            lines += ["", "Misprints and ambiguities:", ""]
            lines += [f"- {entry['item']}: {' '.join(entry['text'].split())}" for entry in own]
    return "\n".join(lines) + "\n"


def main():
    parser = argparse.ArgumentParser(description="Write docs/reference/papers.md, or run what it says.")
    parser.add_argument("--run", action="store_true", help="run every command and compare")
    parser.add_argument("--paper", choices=PAPERS, help="only this paper")
    words = parser.parse_args()
    if not words.run:
        PAGE.write_text(page(), encoding="utf-8")
        return
    sys.exit(1 if differences([row for row in load()[0] if words.paper in (None, row["paper"])]) else 0)


def differences(rows):
    """Run the commands of rows and say what comes out; return what differs, a command that fails being one."""
    found = []
    for command in dict.fromkeys(row["command"] for row in rows):
        try:
            numbers = run(command, ROOT / folder_of(command))
        except (RuntimeError, OSError, ValueError, KeyError) as error:
            found.append(f"{command}: {error}")
            print(found[-1], flush=True)
            continue
        for row in rows:
            if row["command"] == command:
                difference = changed(row, numbers)
                print(difference or f"{row['item']}, {row['what']}: as written", flush=True)
                found += [difference] if difference else []
    return found


if __name__ == "__main__":
    main()
