"""What the papers show and what comes out here: python runs/papers/table.py [--run] [--paper NAME].

The rows are in the ``.toml`` files beside this one: what a paper prints, the command that gives the number here, what
it gave, and the verdict. Without words this writes ``docs/reference/papers.md`` with the items of each paper, and all
numbers to ``papers.csv`` beside it; ``--run`` runs every command and says which numbers have changed.
``tests/cases/test_papers.py`` does both.

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
import csv
import io
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
NUMBERS = PAGE.with_suffix(".csv")
COLUMNS = ("paper", "item", "what", "paper's value", "here", "verdict", "why", "command")
VERDICTS = ("reproduced", "misprint", "differs", "unstated")
# The papers, how many tables and figures each has, and which figures are sketches or set-ups that show no result.
PAPERS = {
    "Hashim": ("Hashim, Coombs, Augarde, Hattori: implicit non-ordinary peridynamics", 4, 34),
    "Luo": ("Luo, Sundararaghavan (2018): stress points", 1, 14),
    "Chowdhury": ("Chowdhury, Roy, Roy, Reddy: sub-horizons", 0, 11),
    "Yaghoobi": ("Yaghoobi, Chorzepa (2017): higher-order weights; abstract and introduction only", 0, 0),
    "Mikes": ("Mikes, Jirasek, Zeman, Rokos, Peerlings: localisation in one dimension", 0, 7),
}
SKETCHES = {
    "Hashim": {1, 2, 3, 4, 5, 6, 8, 10, 13, 19, 24},
    "Luo": {1, 2, 3, 4, 5, 6},
    "Mikes": {1, 3},
}
# What decides many rows of a paper and is not in its text.
NOTES = {
    "Hashim": (
        "The text gives no unit of length for G. Used here: 15.933 mm, fitted to Table 2 (also for Table 3 and Figures "
        "14, 15, 17, 18, 20 to 23); 1.041 m, fitted to Table 4 (also for Figures 25 to 27); one metre, chosen for the "
        "G = 0.01 of Figure 11 (also for Figures 9 and 12)."
    ),
    "Mikes": (
        "The text does not give the least critical strain. The value 0.0001 is fitted to the level of links 10 "
        "spacings long in Figure 6, which is an input. The other three levels follow from it."
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


def here(row):
    """Return the number of a row that is computed here, as it is shown."""
    return f"< {row['below']:.3g}" if "below" in row else f"{row['ours']:.5g}"


def numbers():
    """Return the text of the file of all numbers, and of the notes on the papers."""
    rows, misprints = load()
    lines = [row | {"paper's value": said(row), "here": here(row)} for row in rows]
    lines += [entry | {"verdict": "note", "why": entry["text"]} for entry in misprints]
    file = io.StringIO()
    written = [[" ".join(line.get(key, "").split()) for key in COLUMNS] for line in lines]
    csv.writer(file, lineterminator="\n").writerows([COLUMNS, *written])
    return file.getvalue()


def parts(text, ends="."):
    """Return the parts of a text that end with one of these characters."""
    return re.split(rf"(?<=[{ends}]) (?!\()", " ".join(text.split()))


def of_items(rows):
    """Return the lines of the table of items; those whose numbers are all reproduced share a row."""
    lines = ["| items | reproduced | largest difference [%] | others |", "|---|---|---|---|"]
    groups = {}
    for row in rows:
        groups.setdefault((program(row), row["item"]), []).append(row)
    whole = {key for key, own in groups.items() if all(row["verdict"] == "reproduced" for row in own)}
    shared = {}
    for key, own in groups.items():
        shared.setdefault("all" if key in whole else key, []).extend(own)
    for own in shared.values():
        good = [row for row in own if row["verdict"] == "reproduced"]
        printed = [row for row in good if not in_words(row) and "ours" in row]
        errors = [100 * abs(row["ours"] - row["printed"]) / (abs(row["printed"]) or 1) for row in printed]
        largest = f"{max(errors):.2g}" if errors else "-"
        verdicts = [row["verdict"] for row in own]
        others = [f"{verdicts.count(name)} {name}" for name in VERDICTS[1:] if name in verdicts]
        lines.append(f"| {together(row['item'] for row in own)} | {len(good)} | {largest} | {', '.join(others)} |")
    return lines


def program(row):
    """Return the file that the command of a row runs."""
    return re.search(r"\S+\.py", row["command"])[0]


def together(items):
    """Return items with the kind of each once: ``Tables 2, 3; Figure 7``."""
    kinds = {}
    for item in dict.fromkeys(items):
        kind, _, rest = item.partition(" ")
        kinds.setdefault(kind, []).append(rest)
    return "; ".join(f"{kind}{'s' * (len(rest) > 1)} {', '.join(rest)}".strip() for kind, rest in kinds.items())


def commands(rows):
    """Return the lines of the commands: one of every program, with its items and the number of further commands."""
    groups = {}
    for row in rows:
        groups.setdefault(program(row), []).append(row)
    lines = []
    for own in groups.values():
        own_commands = list(dict.fromkeys(row["command"] for row in own))
        more = f" and {len(own_commands) - 1} more" if len(own_commands) > 1 else ""
        lines.append(f"- {together(row['item'] for row in own)}: `{own_commands[0]}`{more}")
    return lines


def singly(rows):
    """Return the lines of single numbers; rows of one item with the same verdict and reason share a line."""
    groups = {}
    for row in rows:
        groups.setdefault((row["item"], row["verdict"], parts(row["why"])[0]), []).append(row)
    lines = []
    for (item, verdict, why), own in groups.items():
        numbers = []
        for row in own:
            value = f'"{said(row)}"' if in_words(row) else said(row)
            numbers.append(f"{row['what']}: paper {value}, here {here(row)}")
        lines.append(f"- {item}, {'; '.join(numbers)}. **{verdict.capitalize()}**: {why}")
    return lines


def page():
    """Return the text of the page."""
    rows, misprints = load()
    reproduced = [row for row in rows if row["verdict"] == "reproduced"]
    words = sum(map(in_words, reproduced))
    misprinted = {(row["paper"], row["item"]) for row in rows if row["verdict"] == "misprint"}
    lines = [
        "# Published results, recomputed\n",
        f"{len(rows)} numbers of {len(PAPERS)} papers were computed again. Verdicts:\n",
        f"- *Reproduced*: {len(reproduced) - words} numbers agree with a printed number. {words} satisfy bounds that",
        "  were chosen here for words of the paper or for round-off.",
        "- *Misprint*: the printed number contradicts other numbers or equations of the paper.",
        "- *Differs*: the number computed here contradicts the paper.",
        "- *Unstated*: the paper does not say enough to compare.\n",
        f"{{download}}`One CSV file <{NUMBERS.name}>` has every number with its command, bounds and complete reason,",
        "and what the papers leave open.",
        "The tables show the largest relative difference of a reproduced number from the printed one.",
        "`python runs/papers/table.py` writes page and file. `make long` runs every command and compares.\n",
        *summary(rows),
    ]
    for paper, (title, _, _) in PAPERS.items():
        own = [row for row in rows if row["paper"] == paper]
        notes = [entry for entry in misprints if entry["paper"] == paper and entry["item"].startswith("Eq.")]
        notes = [entry for entry in notes if (paper, entry["item"]) not in misprinted]
        notes = [f"- {entry['item']}: {parts(entry['text'])[0]}" for entry in notes]
        lines += [f"\n## {title}\n"]
        if paper in SKETCHES:
            lines += [f"Sketches and set-ups: figures {', '.join(map(str, sorted(SKETCHES[paper])))}.\n"]
        lines += [f"{NOTES[paper]}\n"] if paper in NOTES else []
        lines += of_items(own)
        single = [row for row in own if row["verdict"] in VERDICTS[1:3] or row.get("agrees", 0) > MOST_AGREES]
        found = {"Commands": commands(own), "Single numbers": singly(single), "Misprints of equations": notes}
        for heading, entries in found.items():
            lines += [f"\n{heading}:\n", *entries] if entries else []
    return "\n".join(lines) + "\n"


def main():
    parser = argparse.ArgumentParser(description="Write docs/reference/papers.md, or run what it says.")
    parser.add_argument("--run", action="store_true", help="run every command and compare")
    parser.add_argument("--paper", choices=PAPERS, help="only this paper")
    words = parser.parse_args()
    if not words.run:
        PAGE.write_text(page(), encoding="utf-8")
        NUMBERS.write_text(numbers(), encoding="utf-8")
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
