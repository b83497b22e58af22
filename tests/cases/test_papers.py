"""The table of what the papers show: complete, consistent, and what its commands give."""

import csv
import importlib.util

import pytest

from tests.commands import ROOT

SPEC = importlib.util.spec_from_file_location("papers_table", ROOT / "runs" / "papers" / "table.py")
table = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(table)
ROWS, MISPRINTS = table.load()


def test_rows_are_whole_and_what_is_called_reproduced_is():
    assert [wrong for wrong in map(table.wrong, ROWS) if wrong] == []
    assert all(entry["text"] and entry["paper"] in table.PAPERS for entry in MISPRINTS)


def test_words_need_bounds_and_numbers_are_held_to_them():
    row = dict(paper="Luo", item="Figure 7", what="sawtooth", command="out/luo", result="a", verdict="reproduced")
    row |= dict(printed="less than before", ours=2.0, within=0.1)
    assert "words without" in table.wrong(row)
    row |= dict(least=1.0, most=2.1)
    assert table.wrong(row) is None
    assert "more than" in table.wrong(row | dict(ours=2.2))
    assert table.changed(row, {"a": 2.05}) is None
    assert "more than" in table.changed(row, {"a": 2.15})
    assert "not 2" in table.changed(row, {"a": 1.5})
    assert "nan" in table.changed(row, {"a": float("nan")})
    del row["within"]
    assert table.changed(row, {"a": 1.5}) is None
    assert "less than" in table.changed(row, {"a": 0.5})


def test_tolerances_are_small_or_explained():
    row = dict(paper="Luo", item="Figure 7", what="sawtooth", command="out/luo", result="a", verdict="reproduced")
    row |= dict(printed=2.0, ours=1.9, within=0.1, agrees=0.06)
    assert "why is missing" in table.wrong(row)
    assert table.wrong(row | dict(why="One digit is printed.")) is None
    assert "within is more" in table.wrong(row | dict(within=0.3))


def test_a_command_that_fails_is_a_difference_and_the_others_are_run(monkeypatch):
    def run(command, folder):
        if command == "out/bad":
            raise RuntimeError("it ended")
        return {"a": 1.0}

    monkeypatch.setattr(table, "run", run)
    row = dict(item="Figure 7", what="sawtooth", result="a", ours=1.0, within=0.1)
    found = table.differences([row | dict(command="out/bad"), row | dict(command="out/good", ours=2.0)])
    assert found == ["out/bad: it ended", "Figure 7, sawtooth: 1, not 2"]


@pytest.mark.parametrize("paper", table.PAPERS)
def test_no_table_and_no_figure_is_missing(paper):
    assert [item for item in table.items(paper) if item not in table.covered(ROWS, paper)] == []
    assert any(row["paper"] == paper for row in ROWS)
    assert not {f"Figure {n}" for n in table.SKETCHES.get(paper, ())} & table.covered(ROWS, paper)


def test_page_and_file_of_numbers_say_what_the_rows_say():
    assert table.PAGE.read_text(encoding="utf-8") == table.page(), "run python runs/papers/table.py"
    assert table.NUMBERS.read_text(encoding="utf-8") == table.numbers(), "run python runs/papers/table.py"
    lines = list(csv.DictReader(table.NUMBERS.read_text(encoding="utf-8").splitlines()))
    assert [line["command"] for line in lines if line["command"]] == [row["command"] for row in ROWS]
    assert len(lines) == len(ROWS) + len(MISPRINTS)


@pytest.mark.long
@pytest.mark.parametrize("command", dict.fromkeys(row["command"] for row in ROWS))
def test_the_numbers_of_the_page_come_out_again(command, tmp_path):
    found = table.run(command, tmp_path / "out")
    rows = [row for row in ROWS if row["command"] == command]
    assert [text for text in (table.changed(row, found) for row in rows) if text] == []


def test_the_index_of_examples_lists_all_of_them():
    spec = importlib.util.spec_from_file_location("runs_index", ROOT / "runs" / "index.py")
    index = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(index)
    folders = {path.parent.name for path in (ROOT / "runs").glob("*/*.py")}
    assert folders == set(index.FOLDERS)
    assert all((ROOT / "docs" / "pictures" / name).exists() for name in index.PICTURES.values())
    assert index.PAGE.read_text() == index.page(), "run python runs/index.py"
