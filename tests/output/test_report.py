"""The report of a run: one page with all of it, that needs nothing beside it."""

import base64
import io
import json
import re
import shutil
import subprocess
from html.parser import HTMLParser

import numpy as np
import pytest
from PIL import Image

import pdpetsc as pd
from pdpetsc.output.report import write_report
from tests.commands import called, python_on, run, summary

CASE = '''
"""A bar <pulled> & held."""
import pdpetsc as pd

def case(dx=0.5, fails=False, strain=0.05):
    left, right = pd.region.Slab("x", high=1.0), pd.region.Slab("x", low=5.0)
    return pd.Case(
        particles=pd.Lattice((0.0, 0.0), (6.0, 3.0), dx), horizon=2.015 * dx,
        material=pd.Hencky(E=1000.0, nu=0.3, plane="stress"), scheme=pd.SubHorizons(),
        conditions=[pd.Displacement(left, x=0.0, y=0.0), pd.Displacement(right, x=6.0 * strain)],
        steps=pd.Steps(2), history={"force": pd.Reaction("x", right), "end": pd.Mean(pd.displacement, "x", right)},
        results=lambda h: {"force": h["force"][-1]}, units=pd.Units("mm", "N"),
        expect={"force": pd.Expected(1.0 if fails else 150.0, relative=0.5, source="a <guess>")},
    )
'''

VOID = {"meta", "img", "br", "link", "input", "hr"}


class Page(HTMLParser):
    """Reads a page, and refuses what is not closed or comes from elsewhere."""

    def __init__(self, text):
        super().__init__()
        self.open, self.ids, self.links, self.images, self.text = [], set(), [], [], []
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attributes):
        given = dict(attributes)
        assert tag not in ("script", "link", "iframe")
        if "id" in given:
            assert given["id"] not in self.ids
            self.ids.add(given["id"])
        if tag == "a":
            self.links.append(given["href"])
        if tag == "img":
            assert given["alt"]
            self.images.append(given["src"])
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


def read(folder):
    text = (folder / "report.html").read_text()
    page = Page(text)
    assert not re.search(r"https?://|url\(|@import", re.sub(r"data:image/png;base64,[A-Za-z0-9+/=]+", "", text))
    assert all(link.startswith("#") and link[1:] in page.ids for link in page.links)
    assert all(image.startswith("data:image/png;base64,") for image in page.images)
    return page, " ".join(" ".join(page.text).split())


@pytest.fixture(scope="module")
def reported(tmp_path_factory):
    place = tmp_path_factory.mktemp("report")
    (place / "bar.py").write_text(CASE)
    finished = called(place / "bar.py", "dx=0.5", "--check", "--report", "-o", place / "out")
    assert finished.returncode == 0, finished.stderr
    assert finished.stdout.splitlines()[-1] == f"report in {place / 'out' / 'report.html'}"
    return place / "out"


def test_a_report_says_what_was_asked_and_what_came_out(reported):
    page, text = read(reported)
    left = summary(reported)
    for expected in (
        "converged", "72 particles in 2D", "A bar <pulled> & held.", "--check --report", "dx 0.5", "a <guess>",
        f"force {left['results']['force']:.8g}", "units mm, N", "-snes_rtol", "2 steps, ",
        f"{left['timings']['solve']:.3f}", "Peak memory", "end [mm]", "scheme SubHorizons",
    ):  # fmt: skip
        assert expected in text, expected
    check = left["checks"][0]
    assert f"force 150 {check['got']:.8g} {check['difference']:.8g} 75 ok" in text
    for step in left["steps"]:
        assert f"{step['step']} {step['t']:.8g} {step['newton_iterations']} {step['linear_iterations']}" in text
    assert len(page.images) == 4  # the body, load and displacement, history, Newton
    for image in page.images:
        pixels = np.asarray(Image.open(io.BytesIO(base64.b64decode(image.partition(",")[2]))).convert("RGB"))
        assert np.ptp(pixels) > 200
    assert (reported / "report.html").stat().st_size < 1_000_000


@pytest.mark.skipif(shutil.which("chromium") is None, reason="no chromium on this machine")
def test_a_browser_shows_the_report_without_a_network(reported, tmp_path):
    picture = tmp_path / "page.png"
    words = [
        shutil.which("chromium"), "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
        "--disable-background-networking", "--disable-component-update", "--disable-sync",
        "--host-resolver-rules=MAP * ~NOTFOUND", f"--user-data-dir={tmp_path / 'user'}", "--window-size=1100,1600",
        f"--screenshot={picture}", (reported / "report.html").as_uri(),
    ]  # fmt: skip
    done = subprocess.run(words, capture_output=True, text=True, timeout=300, check=False)
    assert picture.exists(), done.stderr[-500:]
    pixels = np.asarray(Image.open(picture).convert("RGB")).astype(int)
    assert pixels.shape == (1600, 1100, 3)
    # The status is green, and the body has the colours of its scale.
    green = (np.abs(pixels[:120] - [0x1A, 0x7F, 0x37]).max(axis=-1) < 12).sum()
    assert green > 500 and (np.ptp(pixels, axis=-1) > 60).sum() > 30_000


@pytest.mark.long
def test_a_run_that_fails_or_is_off_has_a_report_too(reported, tmp_path):
    case = reported.parent / "bar.py"
    finished = run(case, "strain=1.0", "-snes_max_it", "1", "--report", output=tmp_path / "failed")
    assert finished.returncode == 1
    _, text = read(tmp_path / "failed")
    assert "This run did not reach its end: " in text and "too many Newton iterations" in text
    finished = called(case, "fails=yes", "--check", "--report", "-o", tmp_path / "off")
    assert finished.returncode == 1
    _, text = read(tmp_path / "off")
    assert "FAILED" in text and 'class="status"' in (tmp_path / "off" / "report.html").read_text()
    # Nothing was run: no page, also not on what an earlier run has left in the folder.
    (tmp_path / "off" / "report.html").unlink()
    refused = run(case, "-pc_type", "nothing", "--report", output=tmp_path / "off")
    assert refused.returncode == 2 and "report in" not in refused.stdout
    assert not (tmp_path / "off" / "report.html").exists()


def test_a_report_of_what_a_killed_run_left(reported, tmp_path):
    shutil.copytree(reported, tmp_path / "killed")
    left = summary(tmp_path / "killed")
    left |= {"status": "running", "steps": [], "results": {}, "timings": {}, "peak_memory_bytes": []}
    (tmp_path / "killed" / "summary.json").write_text(json.dumps(left))
    write_report(tmp_path / "killed")
    _, text = read(tmp_path / "killed")
    assert "has not ended, or was killed" in text and "No step has converged" in text and "Nothing was timed" in text


def test_report_draws_what_it_is_asked_to(reported, tmp_path):
    shutil.copytree(reported, tmp_path / "out")
    done = called("report", tmp_path / "out", "field=stress", "component=xx", "scale=3")
    assert done.returncode == 0 and done.stdout.strip() == str(tmp_path / "out" / "report.html")
    read(tmp_path / "out")
    # The picture that the run has drawn is of another scale.
    one, other = (write_report(tmp_path / "out", scale=scale).read_text() for scale in (1.0, 5.0))
    assert one != other
    with pytest.raises(pd.CaseError, match="no field 'nothing'"):
        write_report(tmp_path / "out", "nothing")
    with pytest.raises(pd.CaseError, match=r"holds no summary\.json"):
        write_report(tmp_path)
    (tmp_path / "out" / "summary.json").write_text('{"steps": [3], "status": "converged"}')
    with pytest.raises(pd.CaseError, match="damaged or not of a run"):
        write_report(tmp_path / "out")
    for wrong in ("colour=red", "component=x", "scale=nan"):
        assert called("report", tmp_path / "out", wrong).returncode == 2
    assert called("plot", tmp_path / "out", "step=1.7").returncode == 2


def test_pictures_and_report_of_before_a_restart_are_put_away(reported, tmp_path):
    folder = tmp_path / "out"
    shutil.copytree(reported, folder)
    (folder / "newton.png").write_bytes(b"mine")
    case = reported.parent / "bar.py"
    assert called(case, "--restart", folder, "-o", folder).returncode == 0
    assert not (folder / "report.html").exists() and (folder / "earlier" / "report.html").exists()
    assert (folder / "newton.png").read_bytes() == b"mine"


QUIET = """
import sys
import petsc4py
petsc4py.init(["x"])
import pdpetsc as pd
heavy = ("matplotlib", "PIL", "pandas", "pyvista", "vtkmodules", "sympy", "xarray", "meshio", "netCDF4")
assert not [name for name in heavy if name in sys.modules], "import"
sys.path.insert(0, sys.argv[1])
import bar
result = pd.run(bar.case(), sys.argv[2])
result.field("stress"), result.sample(pd.line((1.0, 1.0), (2.0, 1.0), 3)), repr(result)
pd.open(sys.argv[2])
print([name for name in heavy if name in sys.modules])
"""


def test_a_run_without_a_picture_loads_no_library_for_one(reported, tmp_path):
    (tmp_path / "quiet.py").write_text(QUIET)
    done = python_on(1, tmp_path / "quiet.py", reported.parent, tmp_path / "out")
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "[]"
