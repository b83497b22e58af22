"""PeriLab's decks: YAML under ``PeriLab:``.

The meaning of entries follows the source of PeriLab, August 2026: ``src/Models``, ``src/Core/Solver`` and ``src/IO``.
"""

from __future__ import annotations

import functools
import itertools
import operator
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

from pdpetsc.arrays import Mask
from pdpetsc.bounds import MOST_STEPS, whole_number
from pdpetsc.decks import parts
from pdpetsc.decks.expressions import parse, parse_condition
from pdpetsc.decks.free_motions import hold_free_motions
from pdpetsc.decks.script import STATIC_STEPS, Body, Deck, Given, Script, Times, Where, tidy
from pdpetsc.decks.sections import Section
from pdpetsc.declare.text_file import TextFile
from pdpetsc.errors import CaseError

PROGRAM = "PeriLab"
_LINEAR = "Linear Static Matrix Based"
_IN_TIME = ("Verlet", "Newmark", "Verlet Matrix Based")
_TUNING = (
    "Matrix Update", "Update Matrix", "Safety Factor", "Fixed dt", "NLSolve", "Maximum number of iterations",
    "Show solver iteration", "Residual tolerance", "Solution tolerance", "Residual scaling", "Linear Start Value", "m",
)  # fmt: skip
# Models that a deck may activate in its solver; material models are active by default.
_SWITCHES = ("Material Models", "Damage Models", "Thermal Models")
_OTHER_SWITCHES = ("Additive Models", "Degradation Models", "Pre Calculation Models", "Corrosion Models")
# Mesh columns of models that are refused anyway.
_UNUSED_COLUMNS = ("activation_time", "time")
_NO_PART = "has no counterpart here"


def translate(deck: Deck) -> Script:
    """Translate a deck; raise CaseError if an entry has no counterpart here."""
    root, notes = deck.root, deck.notes
    solver = root.section("Solver")
    times = _times(solver, deck)
    body = _body(root.section("Discretization"), deck)
    script = Script(deck.path, PROGRAM, body, times, notes)
    on = {name: solver.flag(name, name == "Material Models") for name in _SWITCHES}
    for name in _OTHER_SWITCHES:
        if solver.flag(name):
            raise solver.entries[name].wrong(f"{_NO_PART}.")
    if not on["Material Models"]:
        raise solver.wrong("has no material models, and there is nothing to solve.")
    for name in ("FEM", "Contact", "Surface Correction", "Multistep Solver", "Physics"):
        if name in root.sections:
            raise root.sections[name].wrong(f"{_NO_PART}.")
    warm = _blocks(script, root, on)
    parts.note_ties(script)
    parts.put_cracks(script, root.section("Discretization"))
    _conditions(script, root.section("Boundary Conditions"))
    for given in script.given:
        warm &= ~given.where.mask if given.kind == "Temperature" else True
    if warm.any():
        raise CaseError(
            f"The deck prescribes no temperature of {np.count_nonzero(warm)} particles whose reference temperature is "
            f"not zero; PeriLab gives them zero, and this program the reference temperature: prescribe it."
        )
    parts.histories(script, root, "Forces", "Displacements")
    notes.leave_out(root, "Outputs")
    parts.refuse_unknown(root)
    hold_free_motions(script)
    return script


# --- particles


def _body(section: Section, deck: Deck) -> Body:
    beside, notes = deck.path.parent, deck.notes
    kind = section.text("Type")
    if kind != "Text File":
        more = (
            "PeriLab takes cells with all of their nodes in a node set, and every variable of the file for a field; "
            if kind == "Exodus"
            else ""
        )
        raise section.entries["Type"].wrong(
            f"is {kind!r}, which {_NO_PART}: {more}make it a Text File of the columns x y z block_id volume, with node "
            f"sets by numbers."
        )
    path = beside / section.text("Input Mesh File")
    section.use("Distribution Type")
    given = section.sections.get("Node Sets", Section("Node Sets", 0))
    for column in TextFile(path).columns or ():
        if column in _UNUSED_COLUMNS:
            notes.differs(f"The column {column} of the mesh is not read: the deck has no model that does.")
        elif column in notes.columns:
            notes.columns[column] = True
            notes.ignored.append(f"the column {column} of the mesh {path.name}")
        elif column not in ("x", "y", "z", "block", "volume"):
            raise CaseError(
                f"The mesh {path} has the column {column!r}, which PeriLab takes for a field of that name, such as a "
                f"modulus in the place of that of the deck; it {_NO_PART}: give --ignore {column!r} if the answer does "
                f"not depend on it."
            )
    files: dict[str, Path | list[int]] = {}
    regions: dict[str, str] = {}
    # A body without z is plane.
    dim: Literal[2, 3] = 3 if TextFile(path).has("z") else 2
    places = TextFile(path, dim=dim).chunk(0, 1).x
    chosen: dict[str, Mask] = {}
    for name in given.entries:
        text = given.text(name)
        if text.endswith(".txt"):
            files[name] = beside / text
        elif (numbers := _numbers(given.entries[name].place, text, len(places))) is not None:
            files[name] = numbers
        elif text == "All":
            regions[name], chosen[name] = "pd.region.All()", np.ones(len(places), dtype=bool)
        else:
            node = parse_condition(text, given.entries[name].place, set("xyz"[:dim]))
            code = node.python({axis: f"x[:, {k}]" for k, axis in enumerate("xyz")} | {"pi": "np.pi"})
            regions[name] = f"pd.region.Where(lambda x: {code})"
            chosen[name] = np.broadcast_to(node.value(dict(zip("xyz", places.T, strict=False))), len(places))
    body = parts.text_body(path, deck.folder, files, dim)
    parts.refuse_same_names([*body.sets, *chosen])
    sets = {**body.sets, **chosen}
    called = {**body.called, **{tidy(name): name for name in chosen}}
    return replace(body, sets=sets, called=called, regions=regions)


def _numbers(place: str, text: str, count: int) -> list[int] | None:
    """Return the particle numbers of a list or a range such as ``1:5``; None if the text has other words."""
    bounds = [whole_number(word.strip()) for word in text.split(":")]
    if len(bounds) == 2 and bounds[0] is not None and bounds[1] is not None:
        if not 1 <= bounds[0] <= bounds[1] <= count:
            raise CaseError(f"{place} of the deck is {text!r}, not numbers of particles from 1 to {count}.")
        return list(range(bounds[0], bounds[1] + 1))
    return parts.whole_numbers(text)


# --- materials


def _blocks(script: Script, root: Section, on: dict[str, bool]) -> Mask:
    """Add materials, horizons and related declarations to the script.

    Return the particles whose stress-free temperature is not zero (n,).
    """
    warm = np.zeros(len(script.body.x), dtype=bool)
    solver = root.section("Solver")
    models = root.section("Models")
    before = models.sections.get("Pre Calculation Global")
    for name, value in ({} if before is None else before.entries).items():
        if name == "Bond Associated Deformation Gradient" and value.text.lower() == "true":
            raise value.wrong(f"{_NO_PART}.")
    script.notes.leave_out(models, "Pre Calculation Global")
    materials = models.section("Material Models")
    thermals, damages = models.sections.get("Thermal Models"), models.sections.get("Damage Models")
    left = np.ones(len(script.body.x), dtype=bool)
    laws, used = list[parts.Law](), set[str]()
    broken = list[tuple[Where, str]]()
    for block in root.section("Blocks").sections.values():
        number = block.whole("Block ID")
        if tidy(f"block_{number}") not in script.body.called:
            # A block without particles in this mesh.
            script.notes.leave_out_all(block)
            continue
        where = script.body.block(f"block_{number}", block.place)
        if not (where.mask <= left).all():
            raise block.entries["Block ID"].wrong(f"is {number}, which another block has too.")
        left &= ~where.mask
        script.horizon.append((where, parts.horizon_of(block)))
        script.notes.leave_out(block, "Density", "Specific Heat Capacity")
        name = block.text("Material Model")
        law = _material(materials.section(name), script, solver)
        code = law.code
        _refuse_off(block, solver, on, script)
        thermal = block.text("Thermal Model", "")
        if thermal and on["Thermal Models"]:
            if thermals is None:
                raise block.wrong(f"names the thermal model {thermal!r}, and it has none.")
            code = _thermal(thermals.section(thermal), law, script)
            if thermals.section(thermal).number("Reference Temperature", 0.0) != 0.0:
                warm |= where.mask
            used.add(thermal)
        script.material.append((where, code))
        laws.append(law)
        used.add(name)
        damage = block.text("Damage Model", "")
        broken.append((where, damage if on["Damage Models"] else ""))
    if left.any():
        raise CaseError(f"The deck gives {np.count_nonzero(left)} particles no block.")
    for held in (materials, thermals, damages):
        for name, section in held.sections.items() if held is not None else ():
            if name not in used and (held is not damages or name not in {model for _, model in broken}):
                script.notes.leave_out_all(section)
    parts.put_gradients(script, laws)
    _influence(script, root.section("Discretization"))
    _damage(script, damages, broken)
    return warm


def _refuse_off(block: Section, solver: Section, on: dict[str, bool], script: Script) -> None:
    """Omit inactive models of a block; raise CaseError if the solver does not declare them active or not."""
    for switch in ("Damage Models", "Thermal Models"):
        name = switch.removesuffix("s")
        if name not in block.entries or on[switch]:
            continue
        if switch not in solver.entries:
            raise block.entries[name].wrong(
                f"names a model, and in PeriLab these are off where the solver does not say: put '{switch}: true' into "
                f"{solver.path}, or leave it out with --ignore '{name}'."
            )
        script.notes.leave_out(block, name)


def _plane(section: Section, script: Script) -> str:
    """Return the constraint of a plane body, as an argument."""
    symmetry = section.text("Symmetry", "isotropic").lower()
    for word in ("anisotropic", "orthotropic", "transverse"):
        if word in symmetry:
            raise section.entries["Symmetry"].wrong(f"is {symmetry!r}, which {_NO_PART}.")
    if script.body.dim == 3:
        return ""
    for word in ("plane strain", "plane stress"):
        if word in symmetry:
            return f', plane="{word.split()[1]}"'
    raise section.wrong("has a plane body, and neither plane stress nor plane strain.")


def _material(section: Section, script: Script, solver: Section) -> parts.Law:
    model = section.text("Material Model")
    plane = _plane(section, script)
    if section.flag("Bond Associated"):
        raise section.entries["Bond Associated"].wrong(f"{_NO_PART}.")
    if model == "Bond-based Elastic":
        script.notes.leave_out(section, "Zero Energy Control")
        E = _bond_based_modulus(section, script)
        return parts.Law(f'pd.BondBased(E={E!r}{plane}, kinematics="finite")', "bonds")
    if model == "PD Solid Elastic":
        script.notes.leave_out(section, "Zero Energy Control")
        E, nu = parts.elastic_constants(section)
        return parts.Law(f'pd.LinearSolid(E={E!r}, nu={nu!r}{plane}, kinematics="finite")', "bonds")
    if model != "Correspondence Elastic":
        raise section.entries["Material Model"].wrong(
            f"is {model!r}, which {_NO_PART}; known are Correspondence Elastic, PD Solid Elastic and Bond-based "
            f"Elastic."
        )
    E, nu = parts.elastic_constants(section)
    control = None
    if "Zero Energy Control" in section.entries:
        if section.text("Zero Energy Control") != "Global":
            raise section.entries["Zero Energy Control"].wrong(f"{_NO_PART}; known is Global.")
        control = 'pd.Wan(contraction="stress")'
    if script.body.dim == 3:
        script.notes.differs(
            "Shear stress is 2 G times the tensor strain; PeriLab of August 2026 takes 4 G in solids of Correspondence "
            "Elastic, whose stiffness of 2 G it multiplies by the engineering strain."
        )
    if _LINEAR in solver.sections or section.flag("Linear Strain"):
        return parts.Law(f"pd.LinearElastic(E={E!r}, nu={nu!r}{plane})", "gradients", control)
    script.notes.differs(
        "Stress is the second Piola-Kirchhoff one of Green's strain; PeriLab takes it for Cauchy's and divides by F, "
        "which is the same at small strain."
    )
    return parts.Law(f"pd.SaintVenantKirchhoff(E={E!r}, nu={nu!r}{plane})", "gradients", control)


def _bond_based_modulus(section: Section, script: Script) -> float:
    """Return Young's modulus with the fixed Poisson's ratio of PeriLab, 1/3 for every plane body."""
    nu = 1.0 / 3.0 if script.body.dim == 2 else 0.25
    given = {n: section.number(n) for n in ("Young's Modulus", "Shear Modulus", "Bulk Modulus") if n in section.entries}
    if "Poisson's Ratio" in section.entries and abs(section.number("Poisson's Ratio") - nu) > 1e-3:
        script.notes.differs(
            f"Poisson's ratio of bond-based materials is fixed; PeriLab takes {nu:.4g} to convert moduli."
        )
    by = {
        "Bulk Modulus": 3.0 * given.get("Bulk Modulus", 0.0) * (1.0 - 2.0 * nu),
        "Shear Modulus": 2.0 * given.get("Shear Modulus", 0.0) * (1.0 + nu),
        "Young's Modulus": given.get("Young's Modulus", 0.0),
    }
    # The first one is used, as in PeriLab.
    for name, E in by.items():
        if name in given:
            if len(given) > 1:
                script.notes.differs(
                    f"{section.place} has {len(given)} moduli; as in PeriLab the {name.lower()} counts."
                )
            if not E > 0.0:
                raise section.entries[name].wrong("is no modulus.")
            return E
    raise section.wrong("has no modulus.")


def _thermal(section: Section, law: parts.Law, script: Script) -> str:
    model = section.text("Thermal Model")
    if model != "Thermal Expansion":
        raise section.entries["Thermal Model"].wrong(f"is {model!r}, which {_NO_PART}; known is Thermal Expansion.")
    expansion = section.number("Thermal Expansion Coefficient")
    reference = section.number("Reference Temperature", 0.0)
    # Entries of other thermal models, not used by this one.
    script.notes.leave_out(
        section, "Environmental Temperature", "Heat Transfer Coefficient", "Thermal Conductivity",
        "Thermal Conductivity Print Bed", "Print Bed Temperature", "Print Bed Y Coordinate",
    )  # fmt: skip
    if law.kind == "bonds":
        script.notes.differs("A bond expands by the temperature of both of its ends; in PeriLab by that of each.")
    return f"pd.Thermal({law.code}, expansion={expansion!r}, reference={reference!r})"


def _influence(script: Script, section: Section) -> None:
    text = section.text("Influence Function", "1")
    if text == "1" or not parts.reads_influence(script, section):
        return
    place = section.entries["Influence Function"].place
    if "control" in script.arguments:
        raise CaseError(f"{place} of the deck: zero-energy control with an influence function {_NO_PART}.")
    node = parse(text, place, {"xi"})
    horizon = parts.single_horizon({length for _, length in script.horizon}, place)
    parts.own_influence(script, node.python({"xi": "xi", "pi": "np.pi"}), "xi", horizon)


def _damage(script: Script, models: Section | None, blocks: Sequence[tuple[Where, str]]) -> None:
    """Add the damage of blocks to the script; each has its particles and the name of its model."""

    def critical(name: str, section: Section) -> float:
        if section.flag("Only Tension", True) is False:
            raise CaseError(f"{section.entries['Only Tension'].place} of the deck: damage by compression {_NO_PART}.")
        if any("pd.LinearSolid(" in code for _, code in script.material):
            script.notes.differs(
                "Broken bonds still count in the weighted volume of PD Solid Elastic; in PeriLab only those that hold "
                "do, so that the forces of particles that have lost some of their bonds are larger there."
            )
        return section.number("Critical Value")

    parts.damage_by_block(script, models, blocks, "PD Solid Elastic and Bond-based Elastic", critical)


# --- conditions


def _conditions(script: Script, section: Section) -> None:
    known = {"Displacements": "Displacement", "Temperature": "Temperature", "Force Densities": "BodyForce"}
    for one in section.sections.values():
        variable, kind = one.text("Variable"), one.text("Type", "Dirichlet")
        found = known.get(variable)
        if found is None or kind != "Dirichlet":
            raise one.wrong(
                f"is {kind!r} of {variable!r}, which {_NO_PART}; known are Dirichlet of Displacements, Temperature and "
                f"Force Densities."
            )
        axis = "" if found == "Temperature" else one.text("Coordinate")
        if axis and axis not in "xyz"[: script.body.dim]:
            raise one.wrong(f"has coordinate {axis!r} of a {script.body.dim}D body.")
        one.use("Coordinate")
        named = [script.body.node_set(name.strip(), one.place) for name in one.text("Node Set").split("+")]
        where = functools.reduce(operator.or_, named)
        parts.refuse_empty(one, where)
        value = parse(one.text("Value"), one.entries["Value"].place, {"x", "y", "z", "t"})
        script.given.append(Given(found, axis, where, value, one.place))
    for first, second in itertools.combinations(script.given, 2):
        same = (first.kind, first.axis) == (second.kind, second.axis) and (first.where.mask & second.where.mask).any()
        if same and first.value != second.value:
            raise CaseError(
                f"{first.place} and {second.place} of the deck prescribe the same component of some particles; PeriLab "
                f"does not say which holds."
            )


# --- time


def _times(solver: Section, deck: Deck) -> Times:
    """Return the times of the load steps."""
    first, last = solver.number("Initial Time", 0.0), solver.number("Final Time")
    kinds = [name for name in solver.sections if name in (_LINEAR, "Static", *_IN_TIME)]
    if len(kinds) != 1:
        have = ", ".join((*solver.sections,)) or "none"
        raise solver.wrong(f"needs one solver, {_LINEAR} or Static; it has {have}.")
    section = solver.sections[kinds[0]]
    count = solver.whole("Number of Steps", 1)
    if kinds[0] in _IN_TIME:
        deck.leave_out_inertia(section)
        count = STATIC_STEPS
    else:
        dt = section.number("Fixed dt", 0.0) if kinds[0] == "Static" else 0.0
        if dt > 0.0:
            # Rounded, half to even: the last step may end before or after the final time.
            count = round(min(max((last - first) / dt, 0.0), 2.0 * MOST_STEPS))
            last = first + count * dt
        deck.notes.leave_out(section, *_TUNING)
    for name in ("Calculation", "Calculate Cauchy", "Calculate von Mises stress", "Calculate Strain"):
        deck.notes.leave_out(solver, name)
    parts.refuse_steps(solver, count, first, last)
    return Times.even(first, last, count)
