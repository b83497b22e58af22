"""The table of what the papers show: complete, consistent, and what its commands give."""

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


@pytest.mark.parametrize("paper", table.PAPERS)
def test_no_table_and_no_figure_is_missing(paper):
    assert [item for item in table.items(paper) if item not in table.covered(ROWS, paper)] == []
    assert any(row["paper"] == paper for row in ROWS)


def test_the_page_says_what_the_rows_say():
    assert table.PAGE.read_text() == table.page(), "run python runs/papers/table.py"


@pytest.mark.long
@pytest.mark.parametrize("command", dict.fromkeys(row["command"] for row in ROWS))
def test_the_numbers_of_the_page_come_out_again(command, tmp_path):
    found = table.run(command, tmp_path / "out")
    rows = [row for row in ROWS if row["command"] == command]
    assert [text for text in (table.changed(row, found) for row in rows) if text] == []
