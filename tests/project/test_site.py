"""The pages of the site: blocks run as they stand, links lead somewhere, and every public name is in the reference."""

from __future__ import annotations

import contextlib
import html.parser
import inspect
import os
import re
import shlex
import shutil
import subprocess
import sys
import types
import urllib.parse
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

import pdpetsc as pd
from pdpetsc.command_line.commands import COMMANDS
from tests.project.test_docstrings import public

ROOT = Path(__file__).parent.parent.parent
DOCS = ROOT / "docs"
BUILT = ("api/generated/", "examples/")
PAGES = sorted(path for path in DOCS.rglob("*.md") if not str(path.relative_to(DOCS)).startswith(BUILT))
TEXTS = [*PAGES, ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "runs" / "README.md"]
FENCE = re.compile(r"^( *)(```+|~~~+)(\w*)\s*$")
# A block that begins with its name is a file, which commands and other blocks of the page can use.
FILE = re.compile(r'(?:# |""")([\w/]+\.py)\b')
RUN = re.compile(r"^(?:mpirun -n (\d+) )?python -m pdpetsc ")
# Commands on files that stand for the reader's own.
PLACEHOLDERS = ("case.py", "CASE.py", "FILE.py")
# Files that a reader brings along: a command on one that the page does not make is not run.
DATA = (".yaml", ".yml", ".xml", ".csv", ".msh", ".inp", ".g", ".e", ".exo", ".toml", ".txt")
# What one command of a page may take [s].
LONGEST = 100


class Block(NamedTuple):
    """A fenced block of a page: its language, the line of its fence, and its text."""

    language: str
    line: int
    text: str


def blocks(path: Path) -> list[Block]:
    """Return the fenced blocks of a page in their order."""
    found, lines, open_fence = [], path.read_text(encoding="utf-8").split("\n"), None
    for number, line in enumerate(lines, 1):
        match = FENCE.match(line)
        if open_fence is None:
            if match and match[3]:
                open_fence, language, start = (match[1], match[2]), match[3], number
        elif match and not match[3] and match[2] == open_fence[1]:
            indent = len(open_fence[0])
            text = "\n".join(part[indent:] for part in lines[start : number - 1]) + "\n"
            found.append(Block(language, start, text))
            open_fence = None
    return found


def pages_with(language: str) -> list[object]:
    """Return the pages that have blocks of a language, the slow ones (a line ``% long``) marked."""
    found = []
    for path in [*PAGES, ROOT / "README.md"]:
        if any(block.language == language for block in blocks(path)):
            slow = re.search(r"^% long$", path.read_text(encoding="utf-8"), re.MULTILINE)
            marks = [pytest.mark.long] if slow or language == "console" else []
            found.append(pytest.param(path, id=str(path.relative_to(ROOT)), marks=marks))
    return found


def write_files(page: Path, folder: Path) -> None:
    """Write the blocks of a page that are files."""
    for block in blocks(page):
        name = FILE.match(block.text)
        if block.language == "python" and name:
            (folder / name[1]).parent.mkdir(parents=True, exist_ok=True)
            (folder / name[1]).write_text(block.text, encoding="utf-8")


@contextlib.contextmanager
def importing(folder: Path) -> Iterator[None]:
    """Let blocks import files of their page, and forget them afterwards."""
    before = set(sys.modules)
    sys.path.insert(0, str(folder))
    try:
        yield
    finally:
        sys.path.remove(str(folder))
        for name in set(sys.modules) - before:
            if str(folder) in str(getattr(sys.modules[name], "__file__", "")):
                del sys.modules[name]


@pytest.mark.parametrize("page", pages_with("python"))
def test_python_blocks_run_in_their_order(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_files(page, tmp_path)
    module = types.ModuleType("page_of_the_site")
    monkeypatch.setitem(sys.modules, module.__name__, module)
    with importing(tmp_path):
        for block in blocks(page):
            if block.language == "python":
                exec(compile("\n" * block.line + block.text, str(page), "exec"), vars(module))


@pytest.mark.parametrize("page", pages_with("console"))
def test_commands_on_the_files_of_a_page_run(page, tmp_path):
    write_files(page, tmp_path)
    (tmp_path / "runs").symlink_to(ROOT / "runs")
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    absent = set(PLACEHOLDERS)
    for line in commands(page):
        match = RUN.match(line)
        words = shlex.split(line, comments=True)
        files = [word for word in words if word.endswith(".py")]
        given = [word for word in words if word.endswith(DATA) and "/" not in word]
        if (files and files[0] in absent) or not all((tmp_path / name).exists() for name in given):
            absent |= set(files)
            continue
        if files and files[0].startswith("runs/"):
            assert (ROOT / files[0]).is_file(), f"{page}: {files[0]} is not there"
            continue
        launcher = [str(ROOT / ".ci" / "mpirun"), match[1]] if match[1] else []
        start = words.index("-m")
        done = subprocess.run(
            [*launcher, sys.executable, *words[start:]], cwd=tmp_path, env=environment, capture_output=True, text=True,
            timeout=LONGEST, check=False,
        )  # fmt: skip
        assert done.returncode == 0, f"{page}: {line}\n{done.stdout}\n{done.stderr}"


def commands(page: Path) -> Iterator[str]:
    """Yield the lines of the console blocks of a page that run pdpetsc."""
    for block in blocks(page):
        if block.language == "console":
            for line in block.text.replace("\\\n", " ").split("\n"):
                line = line.strip().removeprefix("$ ")
                if RUN.match(line):
                    yield line


def slug(heading: str) -> str:
    """Return the anchor of a heading."""
    text = re.sub(r"[`*]|\[([^\]]*)\]\([^)]*\)", r"\1", heading)
    return re.sub(r"[^\w\- ]", "", text.strip().lower()).replace(" ", "-")


def anchors(path: Path) -> set[str]:
    """Return the anchors of a page: of its headings, and labels."""
    text = re.sub(r"^```.*?^```", "", path.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    found = {slug(heading) for heading in re.findall(r"^#+ (.*)$", text, re.MULTILINE)}
    return found | set(re.findall(r"^\(([\w-]+)\)=$", text, re.MULTILINE))


@pytest.mark.parametrize("page", TEXTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_links_between_pages_lead_somewhere(page):
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    # Only cards, which a clone does not show, may link to pages that are generated.
    linked = re.findall(r"\]\(([^)\s]+)\)", re.sub(r"`[^`\n]*`", "", text))
    linked += re.findall(r"^:img-top: (\S+)$", text, re.MULTILINE)
    cards = [f"{name}.md" for name in re.findall(r"^:link: (\S+)$", text, re.MULTILINE)]
    wrong = []
    for target in [*linked, *(card for card in cards if not card.startswith(BUILT))]:
        name, _, anchor = urllib.parse.unquote(target).partition("#")
        if re.match(r"[a-z]+:", name):
            continue
        path = page.parent / name if name else page
        if not path.exists() or (anchor and path.suffix == ".md" and anchor not in anchors(path)):
            wrong.append(target)
    assert wrong == []


def listed() -> set[str]:
    """Return the names in the tables of the API reference."""
    found: set[str] = set()
    for path in (DOCS / "api").glob("*.md"):
        for block in re.findall(r"```\{eval-rst\}\n(.*?)```", path.read_text(encoding="utf-8"), re.DOTALL):
            found |= set(re.findall(r"^   ([A-Za-z][\w.]*)$", block, re.MULTILINE))
            found |= set(re.findall(r"^\.\. py:module:: pdpetsc\.(\w+)$", block, re.MULTILINE))
    return found


def test_every_public_name_is_in_the_api_reference():
    names = listed()
    things = [thing for name, thing in public() if name in names]
    missing = {name for name, thing in public() if name not in names and not any(thing is known for known in things)}
    missing |= {name for name in pd.__all__ if inspect.ismodule(getattr(pd, name))} - names
    assert missing == set(), "list it in one of the tables of docs/api"


def test_every_name_of_the_api_reference_is_public():
    for name in listed():
        first, _, inner = name.partition(".")
        assert first in pd.__all__
        assert not inner or hasattr(getattr(pd, first), inner)


def test_every_command_is_on_the_page_of_the_command_line():
    page = (DOCS / "reference" / "command_line.md").read_text(encoding="utf-8")
    shown = set(re.findall(r"^### `(\w+)`", page, re.MULTILINE))
    assert shown == set(COMMANDS)


def test_the_readme_stays_short():
    assert len((ROOT / "README.md").read_text(encoding="utf-8").split("\n")) <= 95


class Links(html.parser.HTMLParser):
    """What a page of the built site links to, loads from elsewhere, and can be linked at."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.targets: list[str] = []
        self.loaded: list[str] = []
        self.ids: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        values = dict(attributes)
        self.ids |= {values[key] for key in ("id", "name") if values.get(key)}
        if tag == "a" and values.get("href"):
            self.targets.append(values["href"])
        if tag in ("script", "img", "iframe") and values.get("src"):
            self.loaded.append(values["src"])
        if tag == "link" and values.get("href") and values.get("rel") != "canonical":
            self.loaded.append(values["href"])


@pytest.mark.long
def test_the_site_builds_without_a_warning_and_reads_from_a_disk(tmp_path):
    pytest.importorskip("sphinx", reason="make docs installs what the site is built with")
    shutil.copytree(DOCS, tmp_path / "docs", ignore=shutil.ignore_patterns("generated"))
    site = tmp_path / "site"
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", str(tmp_path / "docs"), str(site)],
        env=environment, capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    pages = {
        path: Links(path.read_text(encoding="utf-8")) for path in site.rglob("*.html") if "_static" not in path.parts
    }
    assert (site / "index.html") in pages and len(pages) > 200
    assert (site / "searchindex.js").stat().st_size > 1e5
    wrong = []
    for path, links in pages.items():
        for target in links.targets + links.loaded:
            name, _, anchor = urllib.parse.unquote(target).partition("#")
            name = name.partition("?")[0]
            if re.match(r"(https?|mailto):", name):
                if target in links.loaded:
                    wrong.append(f"{path.name} loads {target}")
                continue
            other = Path(os.path.normpath(path.parent / name)) if name else path
            missing = anchor and other in pages and anchor not in pages[other].ids
            if not other.exists() or missing:
                wrong.append(f"{path.relative_to(site)}: {target}")
    assert wrong == []
    mathematics = (site / "theory" / "peridynamics.html").read_text(encoding="utf-8")
    assert "tex-svg.js" in mathematics and (site / "_static" / "tex-svg.js").exists()
