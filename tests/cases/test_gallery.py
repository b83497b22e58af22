"""The examples of the gallery give what they should, and the gallery notices one that does not."""

import importlib.util
import sys

import pytest

import pdpetsc as pd
from pdpetsc.command_line.cli import arguments_of, load_case
from tests.commands import ROOT, summary

spec = importlib.util.spec_from_file_location("gallery", ROOT / "docs" / "gallery.py")
gallery = importlib.util.module_from_spec(spec)
sys.modules["gallery"] = gallery
spec.loader.exec_module(gallery)

STRIP = '''
"""A strip that is pulled: its force.

Another paragraph.
"""

import pdpetsc as pd


def case(off=1.0):
    left, right = pd.region.Slab("x", high=2.0), pd.region.Slab("x", low=8.0)
    return pd.Case(
        particles=pd.Lattice((0.0, 0.0), (10.0, 4.0), 1.0),
        horizon=1.515,
        material=pd.LinearElastic(E=1e3, nu=0.0, plane="stress"),
        conditions=[
            pd.Displacement(left | right, x=lambda x, t: 0.01 * t * x[:, 0]),
            pd.Displacement(pd.region.Nearest((0.0, 0.0)), y=0.0),
        ],
        history={"force": pd.Reaction("x", right)},
        results=lambda h: {"force": h["force"][-1]},
        expect={"force": pd.Expected(40.0 * off, relative=1e-6, source="E A times the strain")},
        picture=pd.Picture(pd.stress, "xx"),
    )
'''


# The others are checked where ``make docs`` runs them.
@pytest.mark.parametrize("example", [pytest.param(one, id=one.name) for one in gallery.EXAMPLES if one.quick])
def test_an_example_gives_what_it_should(example, tmp_path):
    function = load_case(example.path)
    parameters = arguments_of(function, dict(word.split("=", 1) for word in example.words.split()))
    found = pd.run(function(**parameters), tmp_path, parameters=parameters, check=True)
    assert all(check.ok for check in found.check())
    assert (tmp_path / "picture.png").stat().st_size > 5_000
    assert set(example.curve or ()) <= set(found.history)


def test_every_example_is_in_the_gallery_once_and_says_what_it_is():
    names = [example.name for example in gallery.EXAMPLES]
    assert len(set(names)) == len(names)
    assert 15 <= len(names) <= 25
    for example in gallery.EXAMPLES:
        text = example.path.read_text()
        told = text.split('"""')[1]
        assert len(told.split("\n\n")) > 1, example.file
        assert "nits" in told, f"{example.file} says nothing about units"


def test_what_an_example_depends_on_is_found():
    names = {path.name for path in gallery.imported(ROOT / "runs/beams/clamped.py")}
    assert names >= {"clamped.py", "beam.py", "strip.py"}
    assert "cook.py" not in names
    assert ROOT / "runs/patch/tension.py" in gallery.imported(ROOT / "runs/convergence/ring.py")


@pytest.mark.long
def test_an_example_that_is_off_is_named_and_one_that_has_not_changed_is_not_run_again(tmp_path, monkeypatch):
    (tmp_path / "runs/few").mkdir(parents=True)
    (tmp_path / "runs/few/strip.py").write_text(STRIP)
    monkeypatch.setattr(gallery, "RUNS", tmp_path / "runs")
    monkeypatch.setattr(gallery, "command", lambda example: f"pdpetsc {example.file}")
    monkeypatch.setattr(gallery, "relative", lambda path: path.name)
    good = gallery.Example("Good", "few/strip.py", curve=("t", "force"))
    bad = gallery.Example("Bad", "few/strip.py", "off=2")
    pages, work = tmp_path / "pages", tmp_path / "work"
    (sentence,) = gallery.build(pages, {"Some": [bad]}, work)
    assert "few/strip.py" in sentence and "1 of 1 checks failed: force is 40" in sentence
    assert not (pages / "few_strip.md").exists()
    assert gallery.build(pages, {"Some": [good]}, work) == []
    page, index = (pages / "few_strip.md").read_text(), (pages / "index.md").read_text()
    assert (
        "| `force` | 40 | 40 |" in page
        and "images/few_strip_history.png" in page
        and STRIP.split('"""')[2].strip() in page
    )
    assert ":link: few_strip" in index and "A strip that is pulled: its force." in index
    at = (work / "few_strip" / "summary.json").stat().st_mtime_ns
    assert gallery.build(pages, {"Some": [good]}, work) == []
    assert (work / "few_strip" / "summary.json").stat().st_mtime_ns == at
    # A change of what it expects is a change.
    (tmp_path / "runs/few/strip.py").write_text(STRIP.replace("40.0 * off", "41.0 * off"))
    assert len(gallery.build(pages, {"Some": [good]}, work)) == 1
    assert summary(work / "few_strip")["checks"][0]["ok"] is False
    # What failed is tried again.
    assert len(gallery.build(pages, {"Some": [good]}, work)) == 1


def test_the_gallery_takes_a_folder(capsys):
    assert gallery.main([]) == 2
    assert "usage" in capsys.readouterr().err
