"""The translated deck: body, conditions, notes on entries without counterpart, and the text of a case file."""

from __future__ import annotations

import itertools
import json
import math
import os
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from pdpetsc.arrays import Float, Mask
from pdpetsc.decks.expressions import Expression
from pdpetsc.decks.sections import Entry, Section
from pdpetsc.errors import CaseError

# Largest line length of a written file.
_WIDTH = 116
# Load steps of a dynamic deck that is solved statically.
STATIC_STEPS = 10
# Lengths that differ by less than this share are equal within rounding.
TIE = 1e-9
_COORDINATES = {"x": "x[:, 0]", "y": "x[:, 1]", "z": "x[:, 2]", "pi": "np.pi"}


@dataclass(frozen=True)
class Where:
    """A selection of particles: its code in a case, and its mask (n,)."""

    code: str
    mask: Mask

    def without(self, other: Where) -> Where:
        """Return the particles that are not in another selection."""
        return Where(f"{_bracketed(self.code)} & ~{_bracketed(other.code)}", self.mask & ~other.mask)

    def __or__(self, other: Where) -> Where:
        return Where(f"{self.code} | {other.code}", self.mask | other.mask)


def _bracketed(code: str) -> str:
    return f"({code})" if "|" in code or "&" in code else code


@dataclass(frozen=True)
class Given:
    """A prescribed value of the deck.

    Attributes
    ----------
    kind : str
        The class of the condition, such as ``Displacement``.
    axis : str
        Its component, or nothing.
    where : Where
        The particles.
    value : Expression
        Value as a function of x, y, z and the time t of the deck.
    place : str
        Its place in the deck.
    since : float, optional
        The time of the deck whose value is subtracted.
    """

    kind: str
    axis: str
    where: Where
    value: Expression
    place: str
    since: float | None = None


@dataclass
class Body:
    """The particles of a deck.

    Attributes
    ----------
    code : list of str
        Lines that define ``particles``.
    helpers : list of str
        Functions of the file that these lines call.
    x : (n, dim) float64
        Positions [length].
    sets : mapping of str to (n,) bool
        Sets by their names in the case.
    called : mapping of str to str
        Names in the case by names in the deck.
    regions : mapping of str to str
        Code of sets that are not sets of the particles.
    of_nodes : mapping of str to str
        As ``called``, for node sets with the name of a block.
    families : callable, optional
        Returns the radius of families and the half sizes of their box for a horizon of the deck [length]; only if
        families are not all particles within the horizon.
    volume : (n,) float64
        Volumes of the particles [length^3].
    """

    code: list[str]
    helpers: list[str]
    x: Float
    sets: Mapping[str, Mask]
    called: Mapping[str, str]
    regions: Mapping[str, str] = field(default_factory=dict)
    of_nodes: Mapping[str, str] = field(default_factory=dict)
    families: Callable[[float], tuple[float, tuple[float, ...]]] | None = None
    volume: Float = field(default_factory=lambda: np.zeros(0))

    @property
    def dim(self) -> int:
        """Return the number of coordinates."""
        return int(self.x.shape[1])

    def block(self, name: str, place: str) -> Where:
        """Return the particles of a block of the deck; raises CaseError if there is none."""
        return self._named(self.called, name, place)

    def node_set(self, name: str, place: str) -> Where:
        """Return the particles of a node set of the deck; raises CaseError if there is none."""
        return self._named({**self.called, **self.of_nodes}, name, place)

    def _named(self, called: Mapping[str, str], name: str, place: str) -> Where:
        own = called.get(tidy(name))
        if own is None or own not in self.sets:
            have = ", ".join(sorted(self.called)) or "none"
            raise CaseError(f"{place} of the deck names the set {name!r}; mesh and deck have {have}.")
        code = self.regions.get(own, f"pd.region.Named({quoted(own)})")
        return Where(code, np.asarray(self.sets[own], dtype=bool))


def quoted(text: str) -> str:
    """Return a text as a Python string in double quotes."""
    return json.dumps(text, ensure_ascii=False)


def tidy(name: str) -> str:
    """Return a name as compared by Peridigm: stripped, with underscores, in capitals."""
    return "_".join(name.split()).upper()


@dataclass
class Notes:
    """Notes on a deck in the case file.

    Attributes
    ----------
    differences : list of str
        Differences between this program and the program of the deck.
    left_out : list of Entry
        Entries that only select output or tune a solver.
    ignored : list of str
        Entries ignored on request.
    columns : dict of str to bool
        Ignored names without an entry, in lower case: they may be columns of the mesh; true if they are.
    """

    differences: list[str] = field(default_factory=list)
    left_out: list[Entry] = field(default_factory=list)
    ignored: list[str] = field(default_factory=list)
    columns: dict[str, bool] = field(default_factory=dict)

    def differs(self, sentence: str) -> None:
        """Note a difference, once."""
        if sentence not in self.differences:
            self.differences.append(sentence)

    def leave_out(self, section: Section, *names: str) -> None:
        """Note existing entries and sections of these names as output or tuning."""
        for name in names:
            if name in section.entries:
                self._note(section.entries[name])
            if name in section.sections:
                self.leave_out_all(section.sections[name])

    def leave_out_all(self, section: Section) -> None:
        """Note all unread entries of a section."""
        for entry in section.leaves():
            self._note(entry)

    def _note(self, entry: Entry) -> None:
        if not entry.used:
            entry.used = True
            self.left_out.append(entry)


@dataclass(frozen=True)
class Deck:
    """A deck to be translated.

    Attributes
    ----------
    path : Path
        The file.
    root : Section
        Its contents, without ignored entries.
    notes : Notes
        Notes on differences and omitted entries.
    folder : Path
        Folder of the case file.
    static : bool
        If True, a dynamic deck is solved statically.
    """

    path: Path
    root: Section
    notes: Notes
    folder: Path
    static: bool

    def leave_out_inertia(self, solver: Section) -> None:
        """Note that a dynamic solver becomes a static one.

        Raises
        ------
        CaseError
            A static solution was not requested.
        """
        if not self.static:
            raise solver.wrong(
                "is a solver in time, and this program finds static equilibrium; give --static to solve the deck "
                "statically up to its final time."
            )
        solver.use_all()
        self.notes.differs(
            f"Inertia is left out: the deck is solved in time with {solver.name}, here in {STATIC_STEPS} load steps."
        )


@dataclass
class Times:
    """The times of the deck at the load steps, ascending, the first one at the beginning."""

    values: list[float]

    @classmethod
    def even(cls, first: float, last: float, count: int) -> Times:
        """Return the times of steps of equal size."""
        return cls([first + (last - first) * n / count for n in range(count)] + [last])

    @property
    def first(self) -> float:
        """Return the time at the beginning."""
        return self.values[0]

    @property
    def last(self) -> float:
        """Return the time at the end."""
        return self.values[-1]

    @property
    def count(self) -> int:
        """Return the number of steps."""
        return len(self.values) - 1

    @property
    def _even(self) -> bool:
        steps = np.diff(self.values)
        return bool(np.all(np.abs(steps - steps.mean()) <= 1e-9 * (self.last - self.first)))

    @property
    def code(self) -> str:
        """Return the name of the time of the deck in the file."""
        return "t" if self._even and (self.first, self.last) == (0.0, 1.0) else "time(t)"

    def lines(self) -> list[str]:
        """Return the function of the file that computes the time of the deck from the load parameter."""
        if self.code == "t":
            return []
        if self._even:
            share = f"{self.last - self.first!r} * t"
            body = share if self.first == 0.0 else f"{self.first!r} + {share}"
        else:
            body = "np.interp(t, np.linspace(0.0, 1.0, len(TIMES)), TIMES)"
        head = [] if self._even else [f"TIMES = {self.values!r}", "", ""]
        return [*head, "def time(t):", '    """Return the time of the deck at step time t."""', f"    return {body}"]


@dataclass
class Script:
    """The contents of a deck for a case."""

    deck: Path
    program: str
    body: Body
    times: Times
    notes: Notes
    horizon: list[tuple[Where, float]] = field(default_factory=list)
    material: list[tuple[Where, str]] = field(default_factory=list)
    given: list[Given] = field(default_factory=list)
    arguments: dict[str, str] = field(default_factory=dict)
    history: dict[str, str] = field(default_factory=dict)
    fields: list[str] = field(default_factory=lambda: ["pd.displacement"])

    @property
    def has_temperatures(self) -> bool:
        """Return True if the deck prescribes a temperature."""
        return any(given.kind == "Temperature" for given in self.given)

    def text(self) -> str:
        """Return the case file."""
        self._part_overlaps()
        conditions = list(itertools.chain.from_iterable(self._condition(given) for given in self.given))
        arguments = {
            "particles": "particles",
            "horizon": self._horizon(),
            "material": self._material(),
            "conditions": _listed(conditions),
            **self.arguments,
            "steps": "pd.Steps(steps)",
            "fields": _listed([*self.fields, *(["pd.temperature"] if self.has_temperatures else [])]),
        }
        if self.history:
            entries = [f"{quoted(name)}: {code}," for name, code in self.history.items()]
            arguments["history"] = "\n".join(["{", *(f"    {entry}" for entry in entries), "}"])
        helpers = [line for part in (self.body.helpers, self._by_block(), self.times.lines()) if part
                   for line in ("", "", *part)]  # fmt: skip
        body = [
            *(f"    {line}" for line in self.body.code),
            "    return pd.Case(",
            *(f"        {line}" for name, code in arguments.items() for line in _argument(name, code)),
            "    )",
        ]
        head = ["", "", f"def case(steps={self.times.count}):", '    """Return the case."""']
        code = "\n".join([*helpers, *head, *body])
        imports = ["from pathlib import Path", ""] if "FOLDER" in code else []
        imports += ["import numpy as np", ""] if "np." in code else []
        folder = ["", "FOLDER = Path(__file__).resolve().parent"] if "FOLDER" in code else []
        crack = ["from pdpetsc.declare.cracks import Crack"] if "(Crack)" in code else []
        top = "\n".join([self._head(), "", *imports, "import pdpetsc as pd", *crack, *folder])
        return f"{top}\n{code}\n{self._tail()}"

    def _head(self) -> str:
        text = [f"{plain(self.deck.stem)}, imported from the {self.program} deck {plain(self.deck.name)}."]
        if self.notes.differences:
            text += ["", f"What this computes differs from {self.program}:", ""]
            text += [line for note in self.notes.differences for line in _wrapped("- ", note, "  ")]
        return '"""' + "\n".join(text) + ('\n"""' if len(text) > 1 else '"""')

    def _tail(self) -> str:
        lines = []
        for title, entries in (
            ("Ignored, as asked for", self.notes.ignored),
            ("Of the deck, but only for its output, its motion in time or to tune its solver", self._left_out()),
        ):
            if entries:
                lines += ["", f"# {title}:"]
                lines += [line for entry in entries for line in _wrapped("#   ", entry, "#     ")]
        return "\n".join(lines) + ("\n" if lines else "")

    def _left_out(self) -> list[str]:
        """Return the omitted entries, one line per section of the deck."""
        found: dict[str, list[str]] = {}
        for entry in self.notes.left_out:
            section, _, name = entry.path.rpartition("/")
            found.setdefault(section or "the deck", []).append(f"{name}: {entry.text}")
        return [f"{section}: {'; '.join(entries)}" for section, entries in found.items()]

    def _part_overlaps(self) -> None:
        """Keep the last of two values of one component of a particle, as in the deck; body forces are not added."""
        for later in range(len(self.given)):
            for earlier in range(later):
                one, other = self.given[earlier], self.given[later]
                same = (one.kind, one.axis) == (other.kind, other.axis)
                if same and (one.where.mask & other.where.mask).any():
                    self.given[earlier] = replace(one, where=one.where.without(other.where))
        self.given = [given for given in self.given if given.where.mask.any()]

    def _condition(self, given: Given) -> list[str]:
        """Return the condition, with its place in the deck."""
        names = given.value.names - {"pi"}
        comment = f"# {plain(given.place)}"
        component = f"{given.axis}=" if given.axis else ""
        if not names:
            value = float(given.value.value({}))
            if not math.isfinite(value):
                raise CaseError(f"{given.place} of the deck is not a number.")
            # The deck jumps to a constant value; a number in a case would grow with the load parameter.
            hold = "" if value == 0.0 and given.kind != "Temperature" else ", schedule=pd.Hold()"
            return [comment, f"pd.{given.kind}({given.where.code}, {component}{value!r}{hold}),"]
        values = table_of(given, self.body, self.times.values)
        code = given.value.python({**_COORDINATES, "t": self.times.code})
        if given.since is not None and "t" in names and table_of(given, self.body, [given.since]).any():
            if given.kind == "Displacement":
                _refuse_rests(given, values, self.times)
            # In brackets, because a negative number before a power would lose its sign.
            at = repr(given.since) if given.since >= 0.0 else f"({given.since!r})"
            code = f"{code} - ({given.value.python({**_COORDINATES, 't': at})})"
            self.notes.differs(f"{given.place} counts from its value at time {given.since:g}, as {self.program} does.")
        if not (names & set("xyz")):
            code = f"{code} + 0.0 * x[:, 0]" if given.kind == "Temperature" else code
        return [comment, f"pd.{given.kind}({given.where.code}, {component}lambda x, t: {code}),"]

    def _horizon(self) -> str:
        lengths = {length for _, length in self.horizon}
        return repr(lengths.pop()) if len(lengths) == 1 else "by_block(particles, HORIZONS)"

    def _by_block(self) -> list[str]:
        """Return the function for the horizon of the block of every particle, if horizons differ."""
        if len({length for _, length in self.horizon}) == 1:
            return []
        named = {part.strip().removeprefix("pd.region.Named(").removesuffix(")").strip('"'): length
                 for where, length in self.horizon for part in where.code.split("|")}  # fmt: skip
        return [
            f"HORIZONS = {named!r}", "", "", "def by_block(particles, lengths):",
            '    """Return the length that the block of every particle has."""',
            "    sets = particles.chunk(0, 1).sets",
            "    return sum(np.where(sets[name], length, 0.0) for name, length in lengths.items())",
        ]  # fmt: skip

    def _material(self) -> str:
        codes = {code for _, code in self.material}
        bonds = [code for code in codes if "pd.LinearSolid(" in code or "pd.BondBased(" in code]
        if len({'kinematics="finite"' in code for code in bonds}) > 1:
            raise CaseError(
                "The deck has blocks of linearised and of finite state-based materials, which share no body here; make "
                "a deck of each."
            )
        if len(codes) == 1:
            return codes.pop()
        return _listed([f"({where.code}, {code})," for where, code in self.material])


def table_of(given: Given, body: Body, times: Sequence[float]) -> Float:
    """Return the values of a condition at times of the deck for each of its particles (n_times, n).

    Raises
    ------
    CaseError
        A value is not a number, or the expression has a coordinate that the body does not have.
    """
    beyond = sorted((given.value.names & set("xyz")) - set("xyz"[: body.dim]))
    if beyond:
        raise CaseError(f"{given.place} of the deck has {beyond[0]} of a body of {body.dim} dimensions.")
    at: dict[str, Any] = {axis: body.x[given.where.mask, k] for k, axis in enumerate("xyz"[: body.dim])}
    count = np.count_nonzero(given.where.mask)
    found = np.array([np.broadcast_to(given.value.value({**at, "t": t}), count) for t in times])
    for t, values in zip(times, found, strict=True):
        if not np.isfinite(values).all():
            raise CaseError(f"{given.place} of the deck is not a number at time {t:g}.")
    return found


def _refuse_rests(given: Given, values: Float, times: Times) -> None:
    """Raise CaseError if Peridigm does not treat a displacement as relative to its initial value throughout.

    Peridigm adds the changes of the values (n_times, n), but sets the value itself if it does not change.
    """
    u = np.zeros_like(values[0])
    for step in range(1, len(values)):
        change = values[step] - values[step - 1]
        u = np.where(change == 0.0, values[step], u + change)
        wrong = np.abs(u - (values[step] - values[0])) > 1e-9 * np.abs(values).max()
        if wrong.any():
            raise CaseError(
                f"{given.place} of the deck rests from time {times.values[step - 1]:g} to {times.values[step]:g}: "
                f"Peridigm counts a displacement from its value at the beginning, which is not zero, until it rests "
                f"and jumps to the value itself; take the value at the beginning off in the deck."
            )


def _listed(items: Iterable[str]) -> str:
    """Return a list, one item per line if it has several."""
    lines = [item if item.startswith("#") or item.endswith(",") else f"{item}," for item in items]
    if not lines:
        return "[]"
    if len(lines) <= 3 and not any(line.startswith("#") for line in lines):
        short = f"[{' '.join(lines).rstrip(',')}]"
        if len(short) < 70:
            return short
    return "\n".join(["[", *(f"    {line}" for line in lines), "]"])


def _argument(name: str, code: str) -> list[str]:
    lines = code.split("\n")
    return [f"{name}={lines[0]}", *lines[1:-1], f"{lines[-1]},"] if len(lines) > 1 else [f"{name}={code},"]


def _wrapped(first: str, text: str, later: str) -> list[str]:
    """Return a text of the deck in lines of the case file that begin with ``first`` and ``later``."""
    return textwrap.wrap(
        plain(text), _WIDTH, initial_indent=first, subsequent_indent=later, break_long_words=False,
        break_on_hyphens=False,
    )  # fmt: skip


def plain(text: str) -> str:
    """Return a text of the deck without characters that would end a comment or a docstring."""
    return "".join(c if c.isprintable() else " " for c in text).replace("\\", "/").replace('"""', "'''")


def relative(path: Path, folder: Path) -> str:
    """Return code for a path of the deck, from the folder of the case file."""
    found = os.path.relpath(path.resolve(), folder.resolve())
    return f"FOLDER / {quoted(Path(found).as_posix())}"
