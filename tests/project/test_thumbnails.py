"""The pictures of the gallery's cards are drawn for their size, and the front page needs no film."""

from __future__ import annotations

import importlib.util
import shutil
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from PIL import Image

import pdpetsc as pd

DOCS = Path(__file__).parent.parent.parent / "docs"


def module(path: Path) -> ModuleType:
    """Import a file of the site."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None and spec.loader is not None
    found = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(found)
    return found


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_a_thumbnail_shows_the_whole_body_and_nothing_else(dim, tmp_path):
    size, held = (4.0, 2.0, 2.0)[:dim], dict.fromkeys("xyz"[:dim], 0.0)
    case = pd.Case(
        particles=pd.LatticeNodes((0.0,) * dim, size, 0.5),
        material=pd.LinearElastic(E=1.0, nu=0.0),
        conditions=[pd.Displacement("-x", **held), pd.Displacement("+x", x=0.1)],
        picture=pd.Picture(pd.displacement, "x"),
    )
    pd.run(case, tmp_path / "run")
    module(DOCS / "thumbnails.py").thumbnail(tmp_path / "run", tmp_path / "small.png")
    with Image.open(tmp_path / "small.png") as image:
        pixels = np.asarray(image.convert("RGB"))
    drawn = (pixels < 250).any(axis=2)
    rows, columns = np.flatnonzero(drawn.any(axis=1)), np.flatnonzero(drawn.any(axis=0))
    # It fills the picture along one direction, and no text is beside it.
    assert max(np.ptp(rows) / drawn.shape[0], np.ptp(columns) / drawn.shape[1]) > 0.85
    assert dim == 1 or drawn[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1].mean() > (0.95 if dim == 2 else 0.5)


def test_the_site_has_film_and_gallery_only_if_they_were_drawn(tmp_path):
    shutil.copyfile(DOCS / "conf.py", tmp_path / "conf.py")
    pytest.importorskip("sphinx", reason="make docs installs what the site is built with")
    conf = module(tmp_path / "conf.py")
    pages = [(DOCS / name).read_text(encoding="utf-8") for name in ("index.md", "start.md", "how_to/checks.md")]

    def read(text: str) -> str:
        source = [text]
        conf.with_gallery(None, "page", source)
        return source[0]

    front, start, checks = map(read, pages)
    assert "pictures/front_panel.png" in front and "examples/" not in front and "% end of" not in front
    assert "/blob/main/runs/README.md)" in start and "../runs" not in start + checks
    (tmp_path / "examples" / "images").mkdir(parents=True)
    (tmp_path / "examples" / "images" / "crack.gif").touch()
    (tmp_path / "examples" / "index.md").touch()
    front, start, checks = map(read, pages)
    assert "(examples/images/crack.gif)" in front and ":link: examples/index" in front
    assert "[Examples](examples/index.md)" in start and "[examples](../examples/index.md)" in checks
