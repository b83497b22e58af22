"""Description of a case before the first step, for the log and ``summary.json``."""

from __future__ import annotations

import dataclasses
from typing import Any

from pdpetsc.case import Case, ungraded
from pdpetsc.declare.cracks import recorded as recorded_crack
from pdpetsc.declare.supports import PointSupport
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.communicator import agreed, anywhere, total
from pdpetsc.discrete.crack_images import images_of_cloud
from pdpetsc.machine import OF_NUMBERS, versions
from pdpetsc.output.progress import Report
from pdpetsc.petsc.library import petsc_version
from pdpetsc.post.quantities import dimension_of
from pdpetsc.problem.problem import Problem
from pdpetsc.running.crack_energy import missed_fracture_energy
from pdpetsc.running.held import layer_notes, named, particles_of_point_supports, support_warnings
from pdpetsc.running.notes import notes
from pdpetsc.running.schedules import schedule_warnings
from pdpetsc.running.suited import lame_ratio, locking_note, plastic_note
from pdpetsc.running.suited import words as suited_words
from pdpetsc.running.unbalanced_surface import unbalanced_areas


def versions_in_use() -> dict[str, str]:
    """Return the versions of Python, PETSc and the packages that affect results."""
    packages = ("pdpetsc", *OF_NUMBERS)
    # Missing packages are listed too, such as pdpetsc in a checkout.
    found = {"python": "", "petsc": petsc_version(), **dict.fromkeys(packages, "not installed")}
    return found | versions(packages)


def describe(case: Case, problem: Problem, declared: Case, report: Report) -> dict[str, Any]:
    """Print the description of a built problem, and return its entries of the summary.

    Parameters
    ----------
    case : Case
        The solved case.
    problem : Problem
        The problem of that case.
    declared : Case
        The declared case; its scheme may differ from that of ``case``.
    report : Report
        Receives the lines.

    Notes
    -----
    Collective.
    """
    return {
        **_model(case, problem, report),
        **_labels(case, problem.body.cloud),
        **_scheme(case, problem, declared, report),
        **_notes(case, problem, report),
        **_loads(problem, report),
        **_supports(case, problem, report),
    }


def _model(case: Case, problem: Problem, report: Report) -> dict[str, Any]:
    body, comm = problem.body, problem.body.cloud.comm
    cloud = body.cloud
    bonds, points, ghosts = map(
        int, total(comm, [body.families.n_bonds, problem.material_term.n_points, cloud.n_ghost])
    )
    entries = {
        "particles": cloud.n_global, "bonds": bonds, "gradient_points": points, "ghosts": ghosts,
        "dimension": cloud.dim, "horizon": cloud.horizon, "allocated": list(problem.parts),
    }  # fmt: skip
    if cloud.varies:
        entries["least_horizon"] = cloud.least_horizon
        report.say(f"horizons from {cloud.least_horizon:.6g} to {cloud.horizon:.6g}")
    elif case.horizon is None:
        report.say(f"horizon {cloud.horizon:.6g}, the default of particles and scheme")
    report.say(
        f"{cloud.n_global} particles in {_kind(case, cloud.dim)}, {bonds} bonds, "
        f"{f'{points} gradient points, ' if points else ''}{comm.size} rank{'s' if comm.size > 1 else ''}"
    )
    if case.symmetry:
        planes = ", ".join(f"{plane.axis} = {plane.at:g}" for plane in case.symmetry)
        report.say(f"mirror planes {planes}; all numbers are those of the modelled part")
    return entries


def _kind(case: Case, dim: int) -> str:
    """Return the number of dimensions, with the state of a plane body."""
    states = sorted({getattr(ungraded(material), "plane", "strain") for _, material in case.materials})
    return f"{dim}D ({' and '.join(f'plane {state}' for state in states)})" if dim == 2 else f"{dim}D"


def _labels(case: Case, cloud: Cloud) -> dict[str, Any]:
    """Return units, dimensions of quantities and cracks, for pictures and tables."""
    images = [images_of_cloud(crack, cloud) for crack in case.cracks]
    return {
        "units": {} if case.units is None else dataclasses.asdict(case.units),
        "dimensions": {
            "history": {name: quantity.dimension for name, quantity in case.quantities.items()},
            "fields": {field.__name__: dimension_of(field) for field in case.recorded},
        },
        "cracks": [[[float(x) for x in point] for point in crack.line] for crack in case.cracks if len(crack.line)],
        "cuts": [record for one in images for record in recorded_crack(one.crack, one.sign, one.shift)],
        "thickness": case.particles.thickness,
    }


def _scheme(case: Case, problem: Problem, declared: Case, report: Report) -> dict[str, Any]:
    note = problem.material_term.note
    scheme = {"name": "bonds" if case.of_bonds else type(case.gradients).__name__, "note": note}
    entries: dict[str, Any] = {"scheme": scheme}
    if note:
        report.detail(f"scheme: {note}")
    missed = missed_fracture_energy(case)
    if missed is not None:
        entries["fracture_energy"] = {"note": missed}
        report.warn(missed)
    if case.scheme is not declared.scheme:
        with agreed(problem.body.cloud.comm):
            scheme["chosen"] = suited_words(case, lame_ratio(case, problem.dim))
        report.say(scheme["chosen"])
    with agreed(problem.body.cloud.comm):
        plastic = plastic_note(case, problem.dim)
    if plastic:
        report.detail(f"note: {plastic}")
    return entries


def _notes(case: Case, problem: Problem, report: Report) -> dict[str, Any]:
    """Return the warnings about the reliability of the results."""
    warnings = [
        *filter(None, [locking_note(case, problem)]),
        *support_warnings(case, problem),
        *schedule_warnings(case),
    ]
    for warning in warnings:
        report.warn(warning)
    found = notes(case, problem)
    for note in found:
        report.say(f"note: {note}")
    return {"notes": [*warnings, *found]}


def _loads(problem: Problem, report: Report) -> dict[str, Any]:
    resultants = [resultant for term in problem.terms for resultant in term.resultants]
    for name, t, force in resultants:
        report.say(f"{name}: resultant {' '.join(f'{f:.6g}' for f in force)} at step time {t:g}")
    return {"loads": [{"condition": name, "t": t, "resultant": force.tolist()} for name, t, force in resultants]}


def _supports(case: Case, problem: Problem, report: Report) -> dict[str, Any]:
    held = problem.supports.held_by_condition()
    for name, axes, count in held:
        report.say(f"{name}: {count} particle{'s' if count != 1 else ''} held in {' and '.join(axes)}")
    for name, axes, count in _held_in_the_mean(case, problem):
        report.say(f"{name}: mean of {count} particle{'s' if count != 1 else ''} held in {' and '.join(axes)}")
    for note in layer_notes(case, problem):
        report.say(f"note: {note}")
    cut = problem.supports.held_at_cut_families()
    if cut and problem.body.surface is not None and not case.of_bonds:
        # With conforming weights a uniform stress is in equilibrium with the supports.
        cut *= anywhere(problem.body.cloud.comm, unbalanced_areas(case, problem))
    if cut:
        report.detail(
            f"note: {cut} held particles have families that the surface cuts; stresses within two horizons of them "
            f"are inaccurate"
        )
    supports = [{"condition": name, "components": axes, "particles": count} for name, axes, count in held]
    return {"supports": supports, "held_at_cut_families": cut}


def _held_in_the_mean(case: Case, problem: Problem) -> list[tuple[str, str, int]]:
    """Return the name, the components and the number of particles of each point support."""
    counts = particles_of_point_supports(case, problem)
    return [
        (name, "".join("xyz"[axis] for axis, _ in condition.components(problem.dim)), counts[name])
        for name, condition in named(case, PointSupport)
    ]
