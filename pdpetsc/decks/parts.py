"""Translation shared by the programs: bodies, cracks, materials, influence, damage, history and refusals."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import scipy

from pdpetsc.arrays import Float
from pdpetsc.bounds import MOST_STEPS, whole_number
from pdpetsc.decks.script import TIE, Body, Script, Where, quoted, relative, tidy
from pdpetsc.decks.sections import Section
from pdpetsc.declare.files import Mesh
from pdpetsc.declare.text_file import TextFile
from pdpetsc.errors import CaseError

# Width of the edge of a crack, as a share of its size.
_EDGE = 1e-9


def exodus_body(path: Path, folder: Path, nodes: str, blocks: str) -> Body:
    """Return the particles of an Exodus mesh; unnamed sets are ``nodes_n`` and ``blocks_n`` in decks."""
    mesh = Mesh(path, format="exodus")
    whole = mesh.chunk(0, 1)
    refuse_same_names(whole.sets)
    called = {tidy(name): name for name in whole.sets}
    for ours, theirs in (("node_set", nodes), ("group", blocks)):
        for name in whole.sets:
            found = re.fullmatch(rf"{ours}_(\d+)", name)
            if found:
                called.setdefault(tidy(f"{theirs}_{found[1]}"), name)
    code = [f'particles = pd.Mesh({relative(path, folder)}, format="exodus")']
    of_nodes = {tidy(name.removesuffix(" nodes")): name for name in whole.sets if name.endswith(" nodes")}
    return Body(code, [], whole.x, dict(whole.sets), called, of_nodes=of_nodes, volume=whole.volume)


def text_body(path: Path, folder: Path, sets: dict[str, Path | list[int]], dim: Literal[2, 3]) -> Body:
    """Return the particles of a text file with sets of the deck by file or numbers."""
    whole = TextFile(path, sets, dim=dim).chunk(0, 1)
    codes = {name: relative(given, folder) if isinstance(given, Path) else repr(given) for name, given in sets.items()}
    lines = [f"    {quoted(name)}: {code}," for name, code in codes.items()]
    given = f"{relative(path, folder)}, {'node_sets=NODE_SETS, ' if sets else ''}dim={dim}"
    helpers = ["NODE_SETS = {", *lines, "}"] if sets else []
    refuse_same_names(whole.sets)
    called = {tidy(name): name for name in whole.sets}
    return Body([f"particles = pd.TextFile({given})"], helpers, whole.x, dict(whole.sets), called, volume=whole.volume)


def put_cracks(script: Script, discretization: Section) -> None:
    """Add the bond filters of a deck to the script as cracks.

    Raises
    ------
    CaseError
        The families of the deck are boxes, which do not support filters.
    """
    if "Bond Filters" not in discretization.sections:
        return
    found = cracks(discretization.section("Bond Filters"), script.body.x)
    if "cracks" in script.arguments:
        raise CaseError(f"The deck has bond filters, which {script.program} does not take for a PdQuickGrid.")
    script.arguments["cracks"] = f"[{', '.join(found)}]"


def cracks(section: Section, x: Float) -> list[str]:
    """Return the cracks of bond filters as code; names may have blanks or underscores.

    Bonds through the edge of a rectangle are cut, bonds through the rim of a disc are not, as in Peridigm.

    Parameters
    ----------
    section : Section
        The filters.
    x : (n, dim) float64
        Positions of the particles [length].

    Raises
    ------
    CaseError
        A filter is neither rectangle nor disc, or not flat, or particles are on its plane.
    """
    found, dim = [], x.shape[1]
    for one in section.sections.values():
        kind = one.text("Type").replace(" ", "_")
        if one.flag("Allow Contact"):
            raise one.entries["Allow Contact"].wrong("has no counterpart here.")
        if kind == "Rectangular_Plane":
            names = ("Normal", "Lower Left Corner", "Bottom Unit Vector")
            normal, corner, bottom = (_vector(one, name, dim) for name in names)
            along, side = (one.number(_spelled(one, name)) for name in ("Bottom Length", "Side Length"))
            sizes = float(np.linalg.norm(bottom)), float(np.linalg.norm(normal))
            if min(*sizes, along, side) <= 0.0 or abs(bottom @ normal) > 1e-9 * sizes[0] * sizes[1]:
                raise one.wrong("is no rectangle.")
            bottom, normal = bottom / sizes[0], normal / sizes[1]
            _refuse_on_plane(one, x, corner, normal)
            if dim == 2:
                found.append(f"pd.Segment({_point(corner)}, {_point(corner + along * bottom)})")
            else:
                up = side * np.cross(bottom, normal)
                corner, along, up = (
                    corner - _EDGE * (along * bottom + up),
                    along * (1 + 2 * _EDGE),
                    up * (1 + 2 * _EDGE),
                )
                corners = [corner, corner + along * bottom, corner + along * bottom + up, corner + up]
                found.append(f"pd.PolygonCrack([{', '.join(_point(point) for point in corners)}])")
        elif kind == "Disk" and dim == 3:
            centre, normal, radius = _vector(one, "Center", dim), _vector(one, "Normal", dim), one.number("Radius")
            if not (np.linalg.norm(normal) > 0.0 and radius > 0.0):
                raise one.wrong("is no disc.")
            _refuse_on_plane(one, x, centre, normal / np.linalg.norm(normal))
            found.append(f"pd.Disc({_point(centre)}, {_point(normal)}, {radius * (1.0 - _EDGE)!r})")
        else:
            raise one.entries["Type"].wrong(f"is {kind!r}, which has no counterpart in {dim}D.")
    return found


def _spelled(section: Section, name: str) -> str:
    """Return the name of an entry as the section has it, with blanks or underscores."""
    return name if name in section.entries else name.replace(" ", "_")


def _vector(section: Section, name: str, dim: int) -> Float:
    """Return a vector (dim,) from its entries; a plane body may lack the last one."""
    values = [
        section.number(_spelled(section, f"{name} {axis}"), 0.0 if k >= dim else None) for k, axis in enumerate("XYZ")
    ]
    return np.array(values[:dim])


def _refuse_on_plane(one: Section, x: Float, point: Float, normal: Float) -> None:
    """Raise CaseError if particles are on the plane of a crack: the cut bonds are then undefined."""
    extent = max(float(np.ptp(x, axis=0).max()), 1e-300)
    on = np.flatnonzero(np.abs((x - point) @ normal) <= _EDGE * extent)
    if len(on):
        raise CaseError(
            f"{len(on)} particles lie on the plane of {one.place} of the deck, such as {x[on[0]].tolist()}; move it "
            f"between particles."
        )


def _point(point: Float) -> str:
    return f"({', '.join(repr(float(value)) for value in point)})"


def note_ties(script: Script) -> None:
    """Note bonds that are as long as the horizon within rounding; families of a grid of the deck exclude them."""
    if script.body.families is not None:
        return
    every, count = scipy.spatial.cKDTree(script.body.x), 0
    for where, length in script.horizon:
        own = scipy.spatial.cKDTree(script.body.x[where.mask])
        shorter, longer = own.count_neighbors(every, np.array([1.0 - TIE, 1.0 + TIE]) * length)
        count += int(longer - shorter)
    if count:
        script.notes.differs(
            f"{count} bonds are as long as the horizon within rounding, from one end or both: all of them count here, "
            f"and in {script.program} rounding decides."
        )


def reads_influence(script: Script, section: Section) -> bool:
    """Return True if the materials use the influence function of the deck; otherwise note it as omitted.

    Raises
    ------
    CaseError
        Some of the materials use it and others do not.
    """
    without = {"pd.BondBased(" in code for _, code in script.material}
    place = section.entries["Influence Function"].place
    if len(without) > 1:
        raise CaseError(
            f"{place} of the deck is read by some materials and not by the bond-based ones of {script.program}; make a "
            f"deck of each."
        )
    if without == {True}:
        script.notes.leave_out(section, "Influence Function")
        section.use("Influence Function")
        script.notes.differs(f"{place} has no effect: the bond-based material of {script.program} does not read it.")
    return without == {False}


def single_horizon(horizons: set[float], place: str) -> float:
    """Return the horizon of a deck; raises CaseError if it has several."""
    if len(horizons) > 1:
        raise CaseError(f"{place} of the deck: an influence of the length of bonds needs one horizon here.")
    return next(iter(horizons))


def own_influence(script: Script, body: str, length: str, scale: float) -> None:
    """Add an influence function to the script: Python of a length, equal to ``scale`` times bond over horizon."""
    script.arguments["influence"] = "OwnInfluence()"
    script.body.helpers += [
        *([""] * 2 if script.body.helpers else []),
        "class OwnInfluence(pd.influence.Influence):", '    """That of the deck, of the length of a bond."""', "",
        "    def __call__(self, s):", '        """Return the influence of bonds of length s horizons."""',
        f"        {length} = {scale!r} * s",
        f"        return {body} + 0.0 * {length}",
    ]  # fmt: skip


def damage_by_block(
    script: Script,
    models: Section | None,
    blocks: Sequence[tuple[Where, str]],
    materials: str,
    critical: Callable[[str, Section], float],
) -> None:
    """Add the damage of blocks to the script.

    Parameters
    ----------
    script : Script
        The script, with the horizons of the blocks.
    models : Section, optional
        The damage models of the deck.
    blocks : sequence of (Where, str)
        The particles of each block and the name of its damage model; empty for a block without one.
    materials : str
        Names of the materials with breaking bonds, for messages.
    critical : callable
        Returns the critical stretch of a model from its name and section.

    Raises
    ------
    CaseError
        A model is unknown, or blocks of different models share bonds, which the program of the deck breaks from one end
        only.
    """

    def law(name: str) -> str:
        if models is None:
            raise CaseError(f"The deck names the damage model {name!r} and has none.")
        section = models.section(name)
        model = section.text("Damage Model")
        if model != "Critical Stretch" or "scheme" in script.arguments:
            raise section.entries["Damage Model"].wrong(f"is {model!r}; known is Critical Stretch, of {materials}.")
        code = f"pd.Brittle(pd.ConstantCritical({critical(name, section)!r}))"
        script.notes.differs(
            f"Bonds break one after another with equilibrium between them; {script.program} breaks once in a step all "
            f"that are too long."
        )
        return code

    parts: dict[str, Where] = {}
    for where, name in blocks:
        parts[name] = parts[name] | where if name in parts else where
    laws = {name: law(name) if name else "None" for name in parts}
    if len(parts) == 1:
        if "" not in parts:
            script.arguments["damage"] = laws.popitem()[1]
        return
    reach = max(length for _, length in script.horizon) * (1.0 + TIE)
    for (one, here), (other, there) in itertools.combinations(parts.items(), 2):
        shared = scipy.spatial.cKDTree(script.body.x[here.mask]).count_neighbors(
            scipy.spatial.cKDTree(script.body.x[there.mask]), reach
        )
        if shared:
            raise CaseError(
                f"The deck has bonds between blocks with the damage model {one or 'None'} and blocks with "
                f"{other or 'None'}; {script.program} breaks them from one end alone, which has no counterpart here: "
                f"give these blocks one model."
            )
    regions = [f"    {quoted(name or 'None')}: {where.code}," for name, where in parts.items()]
    codes = [f"    {quoted(name or 'None')}: {code}," for name, code in laws.items()]
    script.arguments["damage"] = "\n".join(
        ["pd.DamageOf(", "    {", *(f"    {line}" for line in regions), "    },", "    {",
         *(f"    {line}" for line in codes), "    },", ")"]
    )  # fmt: skip


def elastic_constants(section: Section) -> tuple[float, float]:
    """Return Young's modulus and Poisson's ratio from two of the constants of a material.

    Raises
    ------
    CaseError
        There are not two constants, or they do not define a material.
    """
    names = ("Bulk Modulus", "Shear Modulus", "Young's Modulus", "Poisson's Ratio")
    given = {name: section.number(name) for name in names if name in section.entries}
    if len(given) != 2:
        raise section.wrong(f"needs two of {', '.join(names)}, and has {', '.join(given) or 'none'}.")
    K, G, E, nu = (given.get(name) for name in names)
    try:
        if K is not None and G is not None:
            found = 9.0 * K * G / (3.0 * K + G), (3.0 * K - 2.0 * G) / (6.0 * K + 2.0 * G)
        elif K is not None and E is not None:
            found = E, (3.0 * K - E) / (6.0 * K)
        elif K is not None and nu is not None:
            found = 3.0 * K * (1.0 - 2.0 * nu), nu
        elif G is not None and E is not None:
            found = E, E / (2.0 * G) - 1.0
        elif G is not None and nu is not None:
            found = 2.0 * G * (1.0 + nu), nu
        else:
            assert E is not None
            assert nu is not None
            found = E, nu
    except ZeroDivisionError:
        found = math.nan, math.nan
    if not (found[0] > 0.0 and -1.0 < found[1] < 0.5):
        raise section.wrong(f"has E = {found[0]:g} and nu = {found[1]:g}, as no material has.")
    return found


def refuse_steps(solver: Section, count: int, first: float, last: float) -> None:
    """Raise CaseError unless a solver has load steps, not too many, between ascending times."""
    if not 1 <= count <= MOST_STEPS or not last > first:
        raise solver.wrong(
            f"has {count} steps from {first:g} to {last:g}; it needs 1 to {MOST_STEPS} of them, and times that ascend."
        )


def refuse_empty(condition: Section, where: Where) -> None:
    """Raise CaseError if the node set of a condition has no particles."""
    if not where.mask.any():
        raise condition.wrong(
            f"has a node set without particles; correct the set, or leave the condition out with --ignore "
            f"{condition.path!r}."
        )


def refuse_unknown(root: Section) -> None:
    """Raise CaseError if an entry of the deck has neither been read nor noted."""
    left = root.unread()
    if left:
        more = ", ".join(one.path for one in left[1:6]) + (", ..." if len(left) > 6 else "")
        raise CaseError(
            f"The deck has {left[0].place}{f' and {more}' if more else ''}, which {'have' if more else 'has'} no "
            f"counterpart here; give --ignore '{left[0].path}' and so on if the answer does not depend on it."
        )


def refuse_same_names(names: Iterable[str]) -> None:
    """Raise CaseError if names of two sets of a deck are equal without blanks and case."""
    found: dict[str, str] = {}
    for name in names:
        if tidy(name) in found:
            raise CaseError(
                f"The deck or its mesh has the sets {found[tidy(name)]!r} and {name!r}, whose names are the same "
                f"without blanks and capitals; give one another name."
            )
        found[tidy(name)] = name


def words(text: str) -> Sequence[str]:
    """Return the words of a text, without commas."""
    return text.replace(",", " ").split()


def whole_numbers(text: str) -> list[int] | None:
    """Return the whole numbers of a text; None if it has other words."""
    numbers = [whole_number(word) for word in words(text)]
    return None if None in numbers else [number for number in numbers if number is not None]


@dataclass(frozen=True)
class Law:
    """A material of the deck as code, with the kind of its forces and its zero-energy control."""

    code: str
    kind: Literal["gradients", "bonds"]
    control: str | None = None


def put_gradients(script: Script, laws: Sequence[Law]) -> None:
    """Add the scheme and the control of the materials to the script.

    Raises
    ------
    CaseError
        The materials of the blocks cannot be in one body.
    """
    kinds, controls = {law.kind for law in laws}, {law.control for law in laws}
    if len(kinds) > 1:
        raise CaseError(
            "The deck mixes correspondence materials with state-based or bond-based ones, which share no body."
        )
    if len(controls) > 1:
        raise CaseError(
            "The deck has blocks with and without zero-energy control, or with different ones; a body has one here."
        )
    if kinds == {"gradients"}:
        script.arguments["scheme"] = "pd.Correspondence()"
        script.arguments["weights"] = "pd.Standard()"
        control = controls.pop()
        if control is not None:
            script.arguments["control"] = control
        script.fields += ["pd.deformation_gradient", "pd.stress"]


def horizon_of(block: Section) -> float:
    """Return the horizon of a block [length]; raises CaseError unless it is positive."""
    value = block.number("Horizon")
    if not value > 0.0:
        raise block.entries["Horizon"].wrong(f"is {value:g}; a horizon is positive.")
    return value


def histories(script: Script, root: Section, force: str, displacement: str) -> None:
    """Add forces of blocks and displacements of points to the history; note other compute classes.

    ``force`` and ``displacement`` are the variables of the program of the deck.
    """
    if "Compute Class Parameters" in root.sections:
        section = root.section("Compute Class Parameters")
        for one in section.sections.values():
            _history(script, one, force, displacement)
        script.notes.leave_out_all(section)


def _history(script: Script, one: Section, force: str, displacement: str) -> None:
    kind, variable = one.peek("Compute Class"), one.peek("Variable")
    label = "".join(c if c.isalnum() or c == "_" else "_" for c in one.peek("Output Label") or one.name)
    axes = "xyz"[: script.body.dim]
    if any(f"{label}_{axis}" in script.history for axis in axes):
        raise one.wrong(f"has the label {label!r}, as another one of them has; give one another label.")
    if kind == "Block_Data" and variable == force and one.peek("Calculation Type") == "Sum":
        where = script.body.block(one.text("Block"), one.place)
        for axis in axes:
            # Support forces, the negative of the internal forces that the deck sums and of body forces.
            script.history[f"{label}_{axis}"] = f'pd.Reaction("{axis}", {where.code})'
        script.notes.differs(
            "Forces of blocks in the history are support forces: the opposite of the sum of internal and body forces."
        )
        one.use("Compute Class", "Variable", "Calculation Type", "Output Label")
    elif kind == "Nearest_Point_Data" and variable == displacement:
        point = tuple(one.number(axis) for axis in "XYZ"[: script.body.dim])
        for axis in axes:
            region = f"pd.region.Nearest({point!r})"
            script.history[f"{label}_{axis}"] = f'pd.Mean(pd.displacement, "{axis}", {region})'
        one.use("Compute Class", "Variable", "Output Label")
