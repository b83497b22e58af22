"""Peridigm's decks: parameter lists in YAML or XML.

The meaning of entries follows the source of Peridigm 1.5, August 2023: ``src/materials``, ``src/core`` and ``src/io``.
"""

from __future__ import annotations

import functools
import itertools
import math
import operator
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pdpetsc.bounds import MOST_STEPS, real_number
from pdpetsc.decks import parts
from pdpetsc.decks.expressions import parse_peridigm
from pdpetsc.decks.free_motions import hold_free_motions
from pdpetsc.decks.quick_grid import families_code, grid_body
from pdpetsc.decks.script import STATIC_STEPS, Body, Deck, Given, Script, Times, Where, quoted, tidy
from pdpetsc.decks.sections import Section
from pdpetsc.errors import CaseError

PROGRAM = "Peridigm"
# Entries of every material without effect on a static solution.
_OF_MOTION = ("Density",)
# Tuning parameters of a quasi-static solver.
_TUNING = (
    "Verbose", "Absolute Tolerance", "Relative Tolerance", "Maximum Solver Iterations", "Max Solver Iterations",
    "Belos Linear Solver",
    "Belos Maximum Iterations", "Belos Relative Tolerance", "Belos Print Status", "Disable Heuristics", "Damped Newton",
    "Damped Newton Diagonal Scale Factor", "Damped Newton Diagonal Shift Factor", "Preconditioner Type",
    "Solver Type", "Maximum Number of Load Step Reductions", "Adaptive Load-Stepping", "Nonlinear Solver",
    "Max Age Of Prec", "Preconditioner Reuse Policy", "Direction", "Line Search", "Printing", "Newton", "Status Tests",
    "Linear Solver", "Aztec Preconditioner", "Output", "Trust Region", "Reset Counters", "Solver Options",
)  # fmt: skip
_EXPANSION = "Thermal Expansion Coefficient"
# Materials with thermal expansion; the others ignore or refuse the coefficient.
_EXPANDING = ("Elastic", "Elastic Partial Volume", "Elastic Correspondence")
_OF_SOLVERS = ("Verbose", "Peridigm Preconditioner", "Initialize Predictor From Previous Solver", "Solver Specific")
_OF_OUTPUT = ("Verbose", "Save Restart")


def translate(deck: Deck) -> Script:
    """Translate a deck; raise CaseError if an entry has no counterpart here."""
    root, notes = deck.root, deck.notes
    notes.leave_out(root, *_OF_OUTPUT)
    solvers = [root.sections[name] for name in root.sections if re.fullmatch(r"Solver\d*", name)]
    times = _times(solvers, deck)
    conditions = root.sections.get("Boundary Conditions", Section("Boundary Conditions", 0))
    body = _body(root.section("Discretization"), conditions, deck)
    script = Script(deck.path, PROGRAM, body, times, notes)
    _blocks(script, root)
    parts.note_ties(script)
    parts.put_cracks(script, root.section("Discretization"))
    if "Contact" in root.sections:
        raise root.sections["Contact"].wrong("is contact, which this program does not have.")
    _conditions(script, conditions, deck)
    if not script.given:
        raise CaseError("The deck prescribes nothing, and a static answer needs supports and loads.")
    parts.histories(script, root, "Force", "Displacement")
    for name in root.sections:
        if re.fullmatch(r"Output\d*", name):
            notes.leave_out_all(root.sections[name])
    parts.refuse_unknown(root)
    hold_free_motions(script)
    return script


# --- particles


def _body(section: Section, conditions: Section, deck: Deck) -> Body:
    beside = deck.path.parent
    kind = section.text("Type")
    if section.flag("Compute Element-Horizon Intersections"):
        raise section.wrong(
            "asks for intersections of elements with horizons: volumes of neighbours that are cut by the horizon have "
            "no counterpart here."
        )
    sets = _number_sets(conditions, beside)
    section.use("Element-Horizon Intersection Recursion Level", "Element-Horizon Intersection Number Of Samples")
    if kind == "PdQuickGrid":
        return grid_body(section, sets)
    path = beside / section.text("Input Mesh File")
    if kind == "Exodus":
        if sets:
            raise CaseError(
                f"The deck gives node set {next(iter(sets))!r} by numbers beside an Exodus mesh; put it into the mesh."
            )
        return parts.exodus_body(path, deck.folder, "nodelist", "block")
    if kind == "Text File":
        return parts.text_body(path, deck.folder, sets, dim=3)
    raise section.entries["Type"].wrong(f"is {kind!r}; known are Exodus, Text File, PdQuickGrid.")


def _number_sets(conditions: Section, beside: Path) -> dict[str, Path | list[int]]:
    """Return the node sets of a deck by numbers or files; they are among its boundary conditions."""
    found: dict[str, Path | list[int]] = {}
    for name in conditions.entries:
        if "NODE_SET" in tidy(name):
            text = conditions.text(name)
            numbers = parts.whole_numbers(text)
            found[name] = beside / text if numbers is None else numbers
    parts.refuse_same_names(found)
    return found


# --- materials


def _blocks(script: Script, root: Section) -> None:
    """Add materials, horizons and related declarations to the script."""
    materials = root.section("Materials")
    models, left = root.sections.get("Damage Models"), np.ones(len(script.body.x), dtype=bool)
    groups = list(root.section("Blocks").sections.values())
    # The default block has the particles of no other block.
    groups.sort(key=lambda group: group.text("Block Names").lower() == "default")
    laws, used, horizons = list[parts.Law](), set[str](), list[float]()
    damages = list[tuple[Where, str, Section]]()
    for group in groups:
        names = parts.words(group.text("Block Names"))
        if [name.lower() for name in names] == ["default"]:
            blocks = [name for name in script.body.sets if _is_block(name) and (script.body.sets[name] & left).any()]
            wheres = [Where(f"pd.region.Named({quoted(name)})", np.asarray(script.body.sets[name])) for name in blocks]
        else:
            wheres = [script.body.block(name, group.place) for name in names]
        if not wheres:
            group.text("Material")
            group.text("Horizon")
            continue
        where = functools.reduce(operator.or_, wheres)
        if not (where.mask <= left).all():
            raise group.wrong("has blocks that another group has too.")
        left &= ~where.mask
        horizon = parts.horizon_of(group)
        horizons.append(horizon)
        radius = _radius(script, horizon)
        script.horizon.append((where, radius))
        name = group.text("Material")
        used.add(name)
        laws.append(_material(materials.section(name), script, radius / horizon))
        script.material.append((where, laws[-1].code))
        damages.append((where, group.text("Damage Model", "None"), materials.section(name)))
    if left.any():
        raise CaseError(f"The deck gives {np.count_nonzero(left)} particles no block, material and horizon.")
    for name, section in materials.sections.items():
        if name not in used:
            script.notes.leave_out_all(section)
    parts.put_gradients(script, laws)
    _influence(script, root, horizons)
    _damage(script, models, damages)


def _is_block(name: str) -> bool:
    return re.fullmatch(r"(?:block|group)_\d+", name) is not None


def _radius(script: Script, horizon: float) -> float:
    """Return the radius of the families of a block, and declare other limits of them."""
    if script.body.families is None:
        return horizon
    radius, box = script.body.families(horizon)
    if box:
        script.body.helpers += ["", "", *families_code(box)]
        script.arguments["cracks"] = "[BeyondBox()]"
    if radius != horizon:
        script.body.helpers += [
            "",
            f"# Families are those of PdQuickGrid at the horizon {horizon!r}. The horizon here is their longest bond;",
            "# micromoduli, which fall with its fourth power, are scaled to it.",
        ]
    return radius


def _influence(script: Script, root: Section, horizons: Sequence[float]) -> None:
    """Add the influence function to the script; ``horizons`` are those of the deck, by block [length]."""
    section = root.section("Discretization")
    text = section.text("Influence Function", "One")
    if text == "One" or not parts.reads_influence(script, section):
        return
    # Only families of a grid, with one block, have a radius different from the horizon.
    widened = script.horizon[0][1] / horizons[0]
    if text == "Parabolic Decay":
        parts.own_influence(script, "np.where(z < 0.5, 1.0, np.maximum(4.0 * z * (1.0 - z), 0.0))", "z", widened)
    elif text == "Gaussian":
        script.arguments["influence"] = f"pd.influence.Gaussian({0.4 / widened!r})"
    else:
        place = section.entries["Influence Function"].place
        horizon = parts.single_horizon(set(horizons), place)
        node = parse_peridigm(text, place, {"zeta", "horizon"})
        body = node.python({"zeta": "zeta", "horizon": repr(horizon), "pi": "np.pi"})
        parts.own_influence(script, body, "zeta", script.horizon[0][1])


def _material(section: Section, script: Script, widened: float) -> parts.Law:
    """Translate a material.

    ``widened`` is the radius of families over the horizon of the deck [-]: micromoduli decrease with its fourth power.
    """
    model = section.text("Material Model")
    script.notes.leave_out(
        section, *_OF_MOTION, "Compute Partial Stress", "Apply Automatic Differentiation Jacobian", "Verbose"
    )
    for name in ("Apply Shear Correction Factor", "Plane Stress", "Plane Strain", "Use Improved Quadrature",
                 "Use Partial Volume", "Use Analytic Weighted Volume", "Enable Flaw"):  # fmt: skip
        if section.flag(name):
            raise section.entries[name].wrong("has no counterpart here.")
    of_gradients = "Correspondence" in model
    control = None
    if of_gradients:
        coefficient = section.number("Hourglass Coefficient")
        if coefficient != 0.0:
            control = f'pd.Littlewood({coefficient * widened**4!r}, micromodulus="ball")'
            script.notes.differs(
                "Hourglass forces act along the reference direction of a bond and derive from an energy; those of "
                "Peridigm act along its present direction on its two ends alone."
            )
    else:
        script.notes.leave_out(section, "Hourglass Coefficient")
    found = _law(model, section, script, widened)
    if found is None:
        raise section.entries["Material Model"].wrong(
            f"is {model!r}, which has no counterpart here; known are Elastic, Elastic Bond Based, Linear LPS Partial "
            f"Volume, Elastic Partial Volume, Elastic Correspondence, Elastic Plastic Correspondence and Isotropic "
            f"Hardening Correspondence."
        )
    if _EXPANSION in section.entries:
        if model not in _EXPANDING:
            raise section.entries[_EXPANSION].wrong(
                f"has no effect in Peridigm, whose {model} does not expand; leave it out with --ignore "
                f"{section.entries[_EXPANSION].path!r}."
            )
        expansion = section.number(_EXPANSION)
        # Temperatures are relative to the initial ones, as in Peridigm.
        found = f"pd.Thermal({found}, expansion={expansion!r}, reference=0.0)"
        script.notes.differs(
            "Thermal strain multiplies the stretch, 1 + alpha dT; Peridigm adds it to the rate of deformation, which "
            "is the same at small strain."
            if of_gradients
            else "A bond expands by the temperature of both of its ends; in Peridigm by that of each."
        )
    return parts.Law(found, "gradients" if of_gradients else "bonds", control)


def _law(model: str, section: Section, script: Script, widened: float) -> str | None:
    if model == "Elastic Bond Based":
        # 18 K / (pi horizon^4), with Poisson's ratio 1/4.
        modulus = "Young's Modulus" in section.entries
        E = section.number("Young's Modulus") if modulus else 1.5 * section.number("Bulk Modulus")
        return f'pd.BondBased(E={E * widened**4!r}, kinematics="finite")'
    if model not in (
        "Elastic", "Linear LPS Partial Volume", "Elastic Partial Volume", "Elastic Correspondence",
        "Elastic Plastic Correspondence", "Isotropic Hardening Correspondence",
    ):  # fmt: skip
        return None
    E, nu = parts.elastic_constants(section)
    if model == "Linear LPS Partial Volume":
        return f"pd.LinearSolid(E={E!r}, nu={nu!r})"
    if model in ("Elastic", "Elastic Partial Volume"):
        return f'pd.LinearSolid(E={E!r}, nu={nu!r}, kinematics="finite")'
    script.notes.differs(
        "Stress follows from the logarithmic strain at the end of a step; Peridigm adds up Cauchy stresses of the rate "
        "of deformation at the end of each step: the two differ by about the strain, relatively."
    )
    if model == "Elastic Correspondence":
        return f"pd.Hencky(E={E!r}, nu={nu!r})"
    yields = section.number("Yield Stress")
    hardening = section.number("Hardening Modulus") if model == "Isotropic Hardening Correspondence" else 0.0
    more = f", hardening={hardening!r}" if hardening else ""
    return f"pd.J2(E={E!r}, nu={nu!r}, yield_stress={yields!r}{more})"


def _refuse_other_expansion(damage: Section, materials: list[Section]) -> None:
    """Raise CaseError unless the critical stretch excludes the thermal strain of all materials."""
    own = damage.number(_EXPANSION, 0.0)
    for material in materials:
        other = material.number(_EXPANSION, 0.0)
        if other != own:
            raise damage.wrong(
                f"has {own:g} for the {_EXPANSION} where bonds break, and {material.place} expands by {other:g}; here "
                f"both are one: make them the same."
            )


def _damage(script: Script, models: Section | None, blocks: Sequence[tuple[Where, str, Section]]) -> None:
    """Add the damage of blocks to the script; each has its particles, the name of its model and its material."""
    names = {name for _, name, _ in blocks}
    for name, section in ({} if models is None else models.sections).items():
        if name not in names:
            script.notes.leave_out_all(section)

    def critical(name: str, section: Section) -> float:
        _refuse_other_expansion(section, [material for _, own, material in blocks if own == name])
        return section.number("Critical Stretch")

    by_name = [(where, "" if name == "None" else name) for where, name, _ in blocks]
    parts.damage_by_block(script, models, by_name, "materials that are not correspondence materials", critical)


# --- conditions


def _conditions(script: Script, section: Section, deck: Deck) -> None:
    script.notes.leave_out(section, "Create Node Set For Rank Deficient Nodes")
    known = {"Prescribed Displacement": "Displacement", "Body Force": "BodyForce",
             "Prescribed Temperature": "Temperature"}  # fmt: skip
    # Displacements are relative to the beginning, changes of temperature to time 0.
    since = {"Displacement": script.times.first, "Temperature": 0.0}
    for one in section.sections.values():
        kind = one.text("Type").replace("_", " ")
        if kind == "Initial Velocity" and deck.static:
            one.use_all()
            script.notes.ignored.append(f"{one.place}: Initial Velocity, of a deck in time that is solved statically")
            continue
        found = known.get(kind)
        if found is None:
            raise one.entries["Type"].wrong(
                f"is {kind!r}, which has no counterpart in a static case; known are {', '.join(known)}."
            )
        axis = "" if found == "Temperature" else one.text("Coordinate").lower()
        if axis and axis not in ("x", "y", "z"):
            raise one.entries["Coordinate"].wrong(f"is {axis!r}, not x, y or z.")
        one.use("Coordinate")
        set_name, text = one.text("Node Set"), one.text("Value")
        value = parse_peridigm(text, one.entries["Value"].place, {"x", "y", "z", "t"})
        where = script.body.node_set(set_name, one.place)
        parts.refuse_empty(one, where)
        if found == "Temperature" and "t" not in value.names:
            raise one.wrong(
                f"is a temperature that does not change: Peridigm counts changes from time 0, so it has no effect; "
                f"leave it out with --ignore {one.path!r}."
            )
        script.given.append(Given(found, axis, where, value, one.place, since.get(found)))


# --- time


def _times(solvers: list[Section], deck: Deck) -> Times:
    if not solvers:
        raise CaseError("The deck has no solver.")
    values: list[float] = []
    for solver in solvers:
        deck.notes.leave_out(solver, *_OF_SOLVERS)
        own = _times_of(solver, deck)
        if values and abs(own[0] - values[-1]) > 1e-12 * max(abs(own[0]), abs(values[-1])):
            raise solver.wrong(f"begins at {own[0]:g}, and the solver before ends at {values[-1]:g}.")
        values += own[1:] if values else own
    if len(values) > MOST_STEPS + 1 or any(b <= a for a, b in itertools.pairwise(values)):
        raise CaseError(f"The times of the deck do not ascend, or there are more than {MOST_STEPS} load steps.")
    return Times(values)


def _times_of(solver: Section, deck: Deck) -> list[float]:
    notes = deck.notes
    kinds = [name for name in solver.sections if name in ("QuasiStatic", "NOXQuasiStatic")]
    in_time = [name for name in solver.sections if name in ("Verlet", "Implicit", "ImplicitDiffusion")]
    if in_time and not kinds:
        return _times_in_time(solver, solver.sections[in_time[0]], deck)
    if len(kinds) != 1 or in_time:
        have = ", ".join(solver.sections) or "none"
        raise solver.wrong(f"needs one solver, QuasiStatic or NOXQuasiStatic; it has {have}.")
    section = solver.sections[kinds[0]]
    adaptive = section.sections.get("Adaptive Load-Stepping")
    if adaptive is not None and "Switch to Verlet" in adaptive:
        raise adaptive.wrong(
            "goes on in time with 'Switch to Verlet' where a step does not converge; here the answer is static: leave "
            "it out with --ignore 'Switch to Verlet'."
        )
    notes.leave_out(section, *_TUNING)
    if "Time Steps" in section.entries:
        words = parts.words(section.text("Time Steps"))
        times = [number for number in map(real_number, words) if number is not None and math.isfinite(number)]
        if len(times) < len(words):
            raise section.entries["Time Steps"].wrong("are not times.")
        notes.leave_out(solver, "Initial Time", "Final Time")
        if len(times) < 2:
            raise section.entries["Time Steps"].wrong("are less than two times.")
        return times
    first, last = solver.number("Initial Time", 0.0), solver.number("Final Time")
    count = section.whole("Number of Load Steps")
    parts.refuse_steps(solver, count, first, last)
    return Times.even(first, last, count).values


def _times_in_time(solver: Section, section: Section, deck: Deck) -> list[float]:
    deck.leave_out_inertia(section)
    first, last = solver.number("Initial Time", 0.0), solver.number("Final Time", 1.0)
    if not last > first:
        raise solver.wrong(f"goes from {first:g} to {last:g}.")
    return Times.even(first, last, STATIC_STEPS).values
