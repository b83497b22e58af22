"""Notes on surfaces, interfaces and jumps that a case does not resolve."""

from __future__ import annotations

import itertools
import math

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.case import Case
from pdpetsc.control.by_shear import twice_shear
from pdpetsc.declare.body_contact import ParticleContact, TwoParts
from pdpetsc.declare.solvers import Implicit
from pdpetsc.declare.thermal import Convection
from pdpetsc.discrete.communicator import agreed, anywhere, bounds, count_nonzero, largest, smallest, total
from pdpetsc.errors import SolveError
from pdpetsc.post.quantities import dimension_of
from pdpetsc.problem.problem import Problem
from pdpetsc.problem.scales import mean_spacing
from pdpetsc.running.build import elastic_moduli, materials_of
from pdpetsc.running.held import held_load_note, named, no_load_note
from pdpetsc.running.thin import thin_note

# At this ratio of shear moduli the stress within a horizon of an interface has an error of 25 % at any spacing; 14 % at
# 1.5: docs/reference/measured/defaults.md.
STIFFER = 2.0
# Sizes of particles that differ by less than this share are the same.
SAME = 1e-6
# Distance by which facets of an outer layer scatter on irregular clouds, over the size of the particles, as measured:
# docs/how_to/contact.md.
SCATTER = 0.1
# Number of one-cell steps allowed for a notch along the planes of a lattice.
FEW = 2
# Tolerated share of the stress that is lost if a jump is spread over the first step.
SPREAD = 0.01
# A load jumps if it has this share of its value at the end of the first step after this share of the step.
JUMPED, AFTER = 0.5, 0.01


# Error of the temperature near a surface that convects, without conforming weights, over ``h (T - T_s) horizon / k``,
# by the horizon over the spacing, as measured: docs/theory/temperature.md.
CONVECTED = (1.5, 2.0, 3.0), (0.2, 0.7, 1.3)
# Share of T - T_s from which it is noted.
WARMER = 0.02


def notes(case: Case, problem: Problem) -> list[str]:
    """Return the notes on the results of a run.

    Parameters
    ----------
    case : Case
        The declared case.
    problem : Problem
        The problem of that case.

    Notes
    -----
    Collective.
    """
    checks = (
        outer_layer_note, staircase_note, apart_note, interface_note, jump_note, wave_note, thin_note, held_load_note,
        no_load_note, convection_note,
    )  # fmt: skip
    found = [note_of(case, problem) for note_of in checks]
    return [note for note in found if note]


def _reads_stress(case: Case) -> bool:
    """Return True if the fields, the picture or the history of a case have a stress (not collective)."""
    return "stress" in {*map(dimension_of, case.recorded), *(quantity.dimension for quantity in case.history.values())}


def outer_layer_note(case: Case, problem: Problem) -> str:
    """Return the note on facets that follow from the outer layer of a cloud, if it applies (collective)."""
    body = problem.body
    if body.surface is None or not body.surface.uneven:
        return ""
    cloud, owner = body.cloud, np.unique(body.surface.owner)
    half = 0.5 * (cloud.volume[owner] / (body.thickness if cloud.dim < 3 else 1.0)) ** (1.0 / cloud.dim)
    least, most = smallest(cloud.comm, half, initial=np.inf), largest(cloud.comm, half, initial=0.0)
    offset = f"{most:.4g}" if most - least <= SAME * most else f"{least:.4g} to {most:.4g}"
    return (
        f"{count_nonzero(cloud.comm, owner >= 0)} particles are the outer layer that tools touch, half a particle "
        f"({offset}) outward; give facets=pd.Facets(...) if the surface is elsewhere. On an irregular cloud it is "
        f"rough by about {2.0 * SCATTER * most:.2g}: where a tool presses less deep, pressures are wrong"
    )


def staircase_note(case: Case, problem: Problem) -> str:
    """Return the note on stress near the staircase surface of a lattice, if it applies (collective)."""
    comm = problem.body.cloud.comm
    with agreed(comm):
        stairs = case.particles.stairs(comm.rank, comm.size) if _reads_stress(case) else 0
    stairs = int(total(comm, stairs))
    if stairs <= FEW:
        return ""
    return (
        f"the cut surface is a staircase of {stairs} steps, and its stress does not converge; use a Mesh or MeshNodes, "
        "or read the stress two horizons away"
    )


def apart_note(case: Case, problem: Problem) -> str:
    """Return the note on several bodies without contact or tie, if it applies (not collective)."""
    joined = any(isinstance(condition, (TwoParts, ParticleContact)) for condition in case.conditions)
    if joined or len(case.particles.bodies) == 1:
        return ""
    return "no BodyContact, ParticleContact or Tied acts between the bodies: they pass through each other"


def interface_note(case: Case, problem: Problem) -> str:
    """Return the note on bonds between materials of very different stiffness, if it applies (collective)."""
    if case.of_bonds or len(case.materials) == 1:
        return ""
    cloud, families, dim = problem.body.cloud, problem.body.families, problem.dim
    material_of = materials_of(case, cloud).index
    with agreed(cloud.comm):
        shear = [twice_shear(law.moduli(dim)) for law in case.laws]
    highest, between = STIFFER, (0, 0)
    for soft, stiff in itertools.permutations(range(len(shear)), 2):
        if not shear[stiff] > highest * shear[soft] * (1.0 + 1e-9):
            continue
        beside = families.with_any(cloud.halo.with_ghosts(material_of == stiff))
        if anywhere(cloud.comm, beside & (material_of == soft)):
            highest, between = shear[stiff] / shear[soft], (soft, stiff)
    if highest == STIFFER:
        return ""
    return (
        f"shear moduli of materials {between[0] + 1} and {between[1] + 1} differ by a factor of {highest:.4g}: stress "
        "within a horizon of the interface is wrong by 25 % or more; read it two horizons away"
    )


def jump_note(case: Case, problem: Problem) -> str:
    """Return the note on a load that jumps while the material relaxes in the first step, if it applies.

    Notes
    -----
    Collective.
    """
    comm = problem.body.cloud.comm
    steps = case.steps
    first = min(steps.first, steps.stops()[0])
    with agreed(comm):
        lost = 0.0 if case.of_bonds else max(law.spread(first) for law in case.laws)
    if lost <= SPREAD:
        return ""

    def sizes(t: float) -> Float:
        return np.asarray(np.sqrt(total(comm, np.array([(values**2).sum() for values in problem.given(t)]))))

    try:
        early, late = sizes(AFTER * first), sizes(first)
    except SolveError:  # an error of the case, reported by the run
        return ""
    if not np.any((late > 0.0) & (early > JUMPED * late)):
        return ""
    return (
        f"a load jumps at the start of the first step of {first:.4g}, in which the material relaxes: stress is off by "
        f"{100.0 * lost:.2g} %; use short first steps, steps=pd.Steps(times=({0.01 * first:.3g}, {0.1 * first:.3g}, "
        f"{first:.3g}, ..., 1.0))"
    )


def wave_note(case: Case, problem: Problem) -> str:
    """Return the note on time steps in which a wave crosses the whole body, if it applies (collective)."""
    solver, cloud = case.solver, problem.body.cloud
    if not isinstance(solver, Implicit) or solver.error is not None:
        return ""
    n, materials = cloud.n_owned, materials_of(case, cloud)
    with agreed(cloud.comm):
        stiffness = np.einsum("miiii->mi", elastic_moduli(materials, problem.dim)).max(axis=1)
        density = np.array([law.density for law in materials.materials], dtype=float)
    fastest = largest(cloud.comm, materials.factors * (stiffness / density)[materials.index], initial=0.0)
    low, high = bounds(cloud.comm, cloud.x[:n])
    crossing = float((high - low).max()) / math.sqrt(fastest)
    if solver.dt <= crossing:
        return ""
    return (
        f"a time step of {solver.dt:.4g} is longer than the {crossing:.3g} in which a wave crosses the body: "
        "vibrations are not resolved; take a much shorter dt for them, or a radius below 1, which damps them, for slow "
        "motions"
    )


def convection_note(case: Case, problem: Problem) -> str:
    """Return the note on temperatures near surfaces that convect, without conforming weights (collective)."""
    cooled, conductive = named(case, Convection), [one.conduction() for one in case.thermals if one is not None]
    if not cooled or (case.chosen_weights.conform and not problem.material_term.unsuited):
        return ""
    cloud, dim = problem.body.cloud, problem.dim
    h = max(one.coefficient for _, one in cooled)
    k = min(float(np.diag(tensor)[:dim].min()) for tensor in conductive if tensor is not None)
    ratio = cloud.horizon / mean_spacing(problem.body, slice(0, cloud.n_owned))
    off = min(float(np.interp(ratio, *CONVECTED)) * h * cloud.horizon / k, 1.0)
    if off <= WARMER:
        return ""
    advice = "take a smaller horizon" if case.of_bonds else "declare weights=pd.Conforming()"
    return (
        f"within a horizon of surfaces that convect, temperatures are wrong by up to {100.0 * off:.2g} % of their "
        f"difference to the surroundings, since weights do not conform; {advice}"
    )
