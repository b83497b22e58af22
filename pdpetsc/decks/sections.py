"""A deck as a tree of sections and entries with their places; it records which entries have been read."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.parsers import expat

from pdpetsc.bounds import DEEPEST, LONGEST_DECK, MOST_ENTRIES, real_number, text_in
from pdpetsc.errors import CaseError

# Words for yes and no.
_FLAGS = {"true": True, "yes": True, "on": True, "1": True, "false": False, "no": False, "off": False, "0": False}


@dataclass
class Part:
    """A part of a deck.

    Attributes
    ----------
    path : str
        Names of the enclosing sections and its own, with slashes between them.
    line : int
        Its first line, from 1 on.
    """

    path: str
    line: int

    @property
    def place(self) -> str:
        """Return its place in the deck, for messages."""
        return f"{self.path or 'the deck'} (line {self.line})"

    def wrong(self, why: str) -> CaseError:
        """Return the error for this part of the deck, as the end of a sentence."""
        return CaseError(f"{self.place} of the deck {why}")


@dataclass
class Entry(Part):
    """One value of a deck as text."""

    text: str
    used: bool = False


@dataclass
class Section(Part):
    """A named list of entries and sections.

    Attributes
    ----------
    entries, sections : dict
        Its contents by name, in the order of the deck.
    """

    entries: dict[str, Entry] = field(default_factory=dict)
    sections: dict[str, Section] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Return its own name."""
        return self.path.rpartition("/")[2]

    def __contains__(self, name: str) -> bool:
        return name in self.entries or name in self.sections

    def section(self, name: str) -> Section:
        """Return a section; raise CaseError if it is missing."""
        if name not in self.sections:
            raise self.wrong(f"has no section {name!r}.")
        return self.sections[name]

    def text(self, name: str, default: str | None = None) -> str:
        """Return an entry as text; raise CaseError if there is neither entry nor default."""
        if name not in self.entries:
            if default is None:
                raise self.wrong(f"has no entry {name!r}.")
            return default
        found = self.entries[name]
        found.used = True
        return found.text

    def peek(self, name: str) -> str:
        """Return an entry as text without marking it as read; empty if it is missing."""
        return self.entries[name].text if name in self.entries else ""

    def number(self, name: str, default: float | None = None) -> float:
        """Return an entry as a finite number, or raise CaseError."""
        if name not in self.entries and default is not None:
            return default
        text = self.text(name)
        value = real_number(text)
        if value is None or not math.isfinite(value):
            raise self.entries[name].wrong(f"is {text!r}, not a number.")
        return value

    def whole(self, name: str, default: int | None = None) -> int:
        """Return an entry as an integer, or raise CaseError."""
        value = self.number(name, None if default is None else float(default))
        if value != round(value):
            raise self.entries[name].wrong(f"is {value:g}, not a whole number.")
        return int(value)

    def flag(self, name: str, default: bool = False) -> bool:
        """Return an entry as yes or no, or raise CaseError."""
        if name not in self.entries:
            return default
        text = self.text(name)
        if text.lower() not in _FLAGS:
            raise self.entries[name].wrong(f"is {text!r}, neither true nor false.")
        return _FLAGS[text.lower()]

    def leaves(self) -> Iterator[Entry]:
        """Yield all entries of the section and its subsections."""
        yield from self.entries.values()
        for section in self.sections.values():
            yield from section.leaves()

    def use(self, *names: str) -> None:
        """Mark existing entries of these names as read."""
        for name in names:
            if name in self.entries:
                self.entries[name].used = True

    def use_all(self) -> None:
        """Mark all entries of the section and its subsections as read."""
        for entry in self.leaves():
            entry.used = True

    def unread(self) -> list[Entry | Section]:
        """Return the unread entries, and a section instead of its entries if all are unread."""
        found: list[Entry | Section] = [entry for entry in self.entries.values() if not entry.used]
        for section in self.sections.values():
            leaves = list(section.leaves())
            whole = leaves and not any(entry.used for entry in leaves)
            found += [section] if whole else section.unread()
        return found

    def without(self, names: Sequence[str]) -> list[str]:
        """Remove the entries and sections with these names or paths, and return them as text."""
        out = []
        for name, entry in list(self.entries.items()):
            if name in names or entry.path in names:
                del self.entries[name]
                out.append(f"{entry.place}: {entry.text}")
        for name, inner in list(self.sections.items()):
            if name in names or inner.path in names:
                del self.sections[name]
                out.append(inner.place)
        for section in self.sections.values():
            out += section.without(names)
        return out


def read(path: Path) -> Section:
    """Read a deck: XML if its name ends so or it begins with ``<``, otherwise YAML.

    Raises
    ------
    CaseError
        The file is missing, is neither, or requires a package that is not installed.
    """
    text = text_in(path, "deck", LONGEST_DECK, "utf-8-sig")
    root = _read_xml(path, text) if text.lstrip().startswith("<") else _read_yaml(path, text)
    if not (root.entries or root.sections):
        raise CaseError(f"The deck {path} is empty.")
    return root


def _read_yaml(path: Path, text: str) -> Section:
    try:
        import yaml
    except ImportError:
        raise CaseError("Reading decks in YAML needs PyYAML; install pdpetsc[decks].") from None
    try:
        # Peridigm's parser reads a backslash and a brace as the brace; YAML does not have this escape.
        text = re.sub(r"\\([{}])", r"\1", text)
        # Compose nodes only: no objects are created from the deck.
        node = yaml.compose(text, Loader=_bounded(path, yaml))
        if not isinstance(node, yaml.MappingNode):
            raise CaseError(f"The deck {path} is no list of names and values.")
        return _of_yaml(path, node, "", yaml)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f" in line {mark.line + 1}" if mark is not None else ""
        why = " ".join(str(getattr(error, "problem", None) or error).split()).rstrip(".")
        raise CaseError(f"Cannot read the deck {path}{where}: {why}.") from None


def _too_deep(path: Path) -> CaseError:
    return CaseError(f"Cannot read the deck {path}: it is nested more than {DEEPEST} deep.")


def _too_many(path: Path) -> CaseError:
    return CaseError(f"Cannot read the deck {path}: it has more than {MOST_ENTRIES} entries.")


def _bounded(path: Path, yaml: Any) -> Any:
    """Return a loader of YAML that raises CaseError if a deck is nested too deeply, has too many entries or an alias.

    Aliases of aliases can expand to any number of entries, and aliases can be recursive.
    """

    class Bounded(yaml.SafeLoader):  # type: ignore[misc]
        depth = count = 0

        def compose_node(self, parent: Any, index: Any) -> Any:
            if self.check_event(yaml.AliasEvent):
                line = self.peek_event().start_mark.line + 1
                raise CaseError(f"The deck {path} has an alias in line {line}; write out what it stands for.")
            self.depth, self.count = self.depth + 1, self.count + 1
            if self.depth > DEEPEST:
                raise _too_deep(path)
            # Names and values are separate nodes.
            if self.count > 2 * MOST_ENTRIES:
                raise _too_many(path)
            node = super().compose_node(parent, index)
            self.depth -= 1
            return node

    return Bounded


def _of_yaml(path: Path, node: Any, at: str, yaml: Any) -> Section:
    section = Section(at, node.start_mark.line + 1)
    for key, value in node.value:
        line = key.start_mark.line + 1
        if not isinstance(key, yaml.ScalarNode):
            raise CaseError(f"Line {line} of the deck {path} has a name that is no word.")
        name = "".join(c if c.isprintable() else " " for c in str(key.value)).strip()
        here = f"{at}/{name}" if at else name
        if name in section:
            raise CaseError(f"The deck {path} has {here} twice, the second time in line {line}.")
        if isinstance(value, yaml.MappingNode):
            section.sections[name] = _of_yaml(path, value, here, yaml)
            section.sections[name].line = line
        elif isinstance(value, yaml.ScalarNode):
            section.entries[name] = Entry(here, line, str(value.value).strip())
        else:
            parts = [part.value for part in value.value if isinstance(part, yaml.ScalarNode)]
            if len(parts) != len(value.value):
                raise CaseError(f"{here} (line {line}) of the deck {path} is a list of more than words and numbers.")
            section.entries[name] = Entry(here, line, " ".join(str(part) for part in parts))
    return section


def _read_xml(path: Path, text: str) -> Section:
    """Return a Teuchos parameter list: ``ParameterList`` elements with ``Parameter name= type= value=``."""
    root: Section | None = None
    stack: list[Section] = []
    count = 0
    parser = expat.ParserCreate()

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal root
        nonlocal count
        line, count = parser.CurrentLineNumber, count + 1
        if len(stack) > DEEPEST:
            raise _too_deep(path)
        if count > MOST_ENTRIES:
            raise _too_many(path)
        name = attributes.get("name", "").strip()
        if tag not in ("ParameterList", "Parameter"):
            raise CaseError(f"Line {line} of the deck {path} has <{tag}>; parameter lists have Parameter alone.")
        if not stack:
            if tag != "ParameterList" or root is not None:
                raise CaseError(f"The deck {path} is no ParameterList.")
            root = Section("", line)
            stack.append(root)
            return
        above = stack[-1]
        here = f"{above.path}/{name}" if above.path else name
        if not name:
            raise CaseError(f"Line {line} of the deck {path} has a {tag} without name.")
        same = name in above.entries and above.entries[name].text == attributes.get("value", "").strip()
        if name in above and not (same and tag == "Parameter"):
            raise CaseError(f"The deck {path} has {here} twice, the second time in line {line}.")
        if tag == "ParameterList":
            above.sections[name] = Section(here, line)
            stack.append(above.sections[name])
            return
        if "value" not in attributes:
            raise CaseError(f"{here} (line {line}) of the deck {path} has no value.")
        above.entries[name] = Entry(here, line, attributes["value"].strip())
        stack.append(above)

    def end(tag: str) -> None:
        stack.pop()

    def refuse(*_: object) -> None:
        raise CaseError(f"The deck {path} declares XML entities, which parameter lists do not have.")

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.EntityDeclHandler = refuse
    try:
        parser.Parse(text, True)
    except expat.ExpatError as error:
        raise CaseError(f"Cannot read the deck {path}: {error}.") from None
    if root is None:
        raise CaseError(f"The deck {path} is no ParameterList.")
    return root
