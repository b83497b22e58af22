"""The examples in the docstrings of what a user composes are there and run as they stand."""

from __future__ import annotations

import doctest
import importlib
import inspect
import pkgutil
import re
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import Any

import pytest

import pdpetsc as pd

# What a user meets but does not compose: what a run returns or raises, and what a new term is built of. The examples of
# a ``Case`` are the files under ``runs/``.
NOT_COMPOSED = {
    "Case", "CaseError", "CheckError", "Comparison", "GradientOperator", "HistoryKernels", "Interrupted", "KeptArray",
    "OutputError", "PointBlocks", "PointKernels", "Prepared", "Product", "Response", "RunError", "Solution",
    "SolveError", "State", "TensorResponse", "region.View",
}  # fmt: skip


def public() -> Iterator[tuple[str, Any]]:
    """Yield every public name and what it is, the classes of the modules ``influence`` and ``region`` among them."""
    for name in pd.__all__:
        thing = getattr(pd, name)
        if not inspect.ismodule(thing):
            yield name, thing
            continue
        for inner, member in vars(thing).items():
            if inspect.isclass(member) and member.__module__ == thing.__name__ and not inner.startswith("_"):
                yield f"{name}.{inner}", member


PUBLIC = {name: thing for name, thing in public() if inspect.isclass(thing) or inspect.isfunction(thing)}
CLASSES = {name for name, thing in PUBLIC.items() if inspect.isclass(thing) and not inspect.isabstract(thing)}


@pytest.mark.parametrize("name", sorted(CLASSES - NOT_COMPOSED | {"At", "ExtraTerm", "Pressure", "choose"}))
def test_what_a_user_composes_shows_how(name: str) -> None:
    """The docstring has a section of examples."""
    assert "\nExamples\n--------\n" in inspect.cleandoc(PUBLIC[name].__doc__ or "")


def test_examples_give_what_they_say() -> None:
    """The examples run in an empty namespace."""
    runner = doctest.DocTestRunner(verbose=False)
    for name in sorted(PUBLIC):
        for example in doctest.DocTestFinder(recurse=False).find(PUBLIC[name], name, globs={}):
            runner.run(example)
    assert runner.tries > 100
    assert runner.failures == 0


def test_every_public_method_that_overrides_none_has_a_docstring() -> None:
    """That of an overridden method holds for those that override it."""
    bare, seen = [], 0
    for module in pkgutil.walk_packages(pd.__path__, "pdpetsc."):
        if module.name.endswith("__main__"):
            continue
        for one in vars(importlib.import_module(module.name)).values():
            if not inspect.isclass(one) or one.__module__ != module.name or one.__name__.startswith("_"):
                continue
            for name, member in vars(one).items():
                method = inspect.isfunction(member) or isinstance(member, property | classmethod | cached_property)
                if method and not name.startswith("_") and not any(name in vars(base) for base in one.__mro__[1:]):
                    seen += 1
                    bare += [] if member.__doc__ else [f"{one.__qualname__}.{name}"]
    assert seen > 1000
    assert bare == []


def test_every_key_that_is_cited_is_in_the_list_of_references() -> None:
    """Keys are an author and a year, as ``Silling2017``, in docstrings and on the pages of the docs."""
    root = Path(__file__).parent.parent.parent
    known = set(re.findall(r"^- \*\*(\w+)\*\*", (root / "docs/reference/references.md").read_text(), re.MULTILINE))
    pages = [*(root / "pdpetsc").rglob("*.py"), *(root / "docs").rglob("*.md")]
    cited = {key for path in pages for key in re.findall(r"\b[A-Z][a-z]+[A-Za-z]*(?:19|20)\d\d\b", path.read_text())}
    assert len(known) > 20
    assert cited - known == set()
