"""Scheme and control of bodies for which the general default is unsuitable, if a case declares neither."""

from __future__ import annotations

from dataclasses import replace

from pdpetsc.case import Case
from pdpetsc.control import CONTROLS, ByShear, Silling, TangentScaled, ZeroEnergyControl
from pdpetsc.control.by_shear import twice_shear
from pdpetsc.declare.body_contact import TwoParts
from pdpetsc.declare.horizon import spacings
from pdpetsc.declare.particles import Chunk
from pdpetsc.declare.tools import Contact
from pdpetsc.discrete.communicator import Comm, agreed, total
from pdpetsc.errors import CaseError
from pdpetsc.gradient import Correspondence, MeanDilatation, SubHorizons
from pdpetsc.material.j2 import J2
from pdpetsc.material.kinematic import KinematicJ2
from pdpetsc.problem.problem import Problem

# Gradients lock above this lambda / mu at F = I: nu = 0.45 in space and in plane strain.
LOCKING = 9.0
# Edge of a patch in spacings.
PATCH = 2.0
# Control of points that fail. With a weaker control, and with sub-horizons without control, a crack dissipates less
# than Gc.
OF_FAILING_POINTS = Silling(2.0)
# Controls in proportion to the stiffness of the material, which ``ByShear`` scales with the shear modulus.
BY_BULK = tuple(type(control) for control in CONTROLS.values() if control is not None)


def lame_ratio(case: Case, dim: int) -> float:
    """Return the largest ``lambda / mu`` at F = I of the materials of a body [-] (not collective).

    ``kappa = lambda + 2 mu / dim``; in plane stress lambda is that of the plane, which never locks. 0 for a bar and for
    materials of bonds.
    """
    if case.of_bonds or dim == 1:
        return 0.0
    return max(2.0 * (law.bulk_like_modulus(dim) / twice_shear(law.moduli(dim)) - 1.0 / dim) for law in case.laws)


def poisson_ratio(lame: float) -> float:
    """Return Poisson's ratio of an isotropic solid from ``lambda / mu`` [-]."""
    return 0.5 * lame / (1.0 + lame)


def takes_patches(case: Case, dim: int) -> bool:
    """Return True if ``MeanDilatation`` is the default for a body that locks (not collective)."""
    if case.of_bonds or case.expands or case.damage is not None or dim == 1:
        return False
    return dim == 3 or all(law.plane != "stress" for law in case.laws)


def with_suited_scheme(comm: Comm, case: Case, chunk: Chunk) -> Case:
    """Return the case, with a suitable scheme and control if it declares neither.

    A body with ``PointDamage`` gets ``Correspondence`` and ``Silling(2.0)``, with which a crack dissipates the declared
    energy. A body that would lock gets ``MeanDilatation`` and ``ByShear``, with patches of two mean spacings. Bodies
    whose bonds fail, that expand, or with a part in plane stress are unchanged: ``locking_note`` has the advice.

    Parameters
    ----------
    comm : Comm
        The ranks.
    case : Case
        The declared case.
    chunk : Chunk
        The particles created by this rank.

    Notes
    -----
    Collective.
    """
    if case.scheme is not None or case.control is not None:
        return case
    dim = chunk.x.shape[1]
    if case.damage is not None and case.damage.point_laws:
        with agreed(comm):
            stiff = locks(lame_ratio(case, dim))
        return replace(
            case, scheme=Correspondence(), control=ByShear(OF_FAILING_POINTS) if stiff else OF_FAILING_POINTS
        )
    with agreed(comm):
        suits = takes_patches(case, dim) and locks(lame_ratio(case, dim))
        weighted = chunk.volume @ spacings(chunk, case.particles.thickness) if suits else 0.0
    if not suits:
        return case
    # Sums over ranks differ in their last digits; patches must not.
    spacing = float(total(comm, weighted) / total(comm, chunk.volume.sum()))
    patch = float(f"{PATCH * spacing:.9g}")
    control: ZeroEnergyControl = ByShear(Silling(0.5))
    if any(law.has_history for law in case.laws):
        control = TangentScaled(control)
    return replace(case, scheme=MeanDilatation(Correspondence(), patch), control=control)


def locks(lame: float) -> bool:
    """Return True if schemes with several points per particle lock at this ``lambda / mu``; nu = 0.45 does not lock."""
    return lame > LOCKING * (1.0 + 1e-9)


def words(case: Case, lame: float) -> str:
    """Return the line of the log on the chosen scheme and control, with the reason."""
    if case.damage is not None:
        return f"default with PointDamage: scheme={case.scheme}, control={case.control}"
    return f"default at nu = {poisson_ratio(lame):.5g}: scheme={case.scheme}, control={case.control}"


def plastic_note(case: Case, dim: int) -> str:
    """Return the advice for plastic flow with the default scheme, for the log with details; empty if none applies.

    Errors of forces, stresses and moments are a fourth to a fifth: docs/reference/methods.md, plastic flow. It is no
    warning, because sub-horizons converge too, and a body that yields in a small zone needs no other scheme.
    """
    flows = not case.of_bonds and any(isinstance(law, J2 | KinematicJ2) for law in case.laws)
    if not flows or dim == 1 or case.scheme is not None or not isinstance(case.gradients, SubHorizons):
        return ""
    return (
        "plastic flow preserves volume, which sub-horizons over-constrain; scheme=pd.Correspondence() with "
        "control=pd.TangentScaled(pd.Silling(0.5)) has about a fourth of their error"
    )


def locking_note(case: Case, problem: Problem) -> str:
    """Return the advice for a nearly incompressible body whose scheme or control locks; empty if none locks.

    A scheme locks if it has several gradient points per particle and no patches, a control if its strength grows with
    the bulk modulus.

    Notes
    -----
    Collective.
    """
    dim, comm = problem.dim, problem.body.cloud.comm
    with agreed(comm):
        lame = lame_ratio(case, dim)
        patches = locks(lame) and takes_patches(case, dim)
    if not locks(lame):
        return ""
    locking = []
    points = int(total(comm, problem.material_term.n_points))
    if case.gradients.patches is None and points > problem.body.cloud.n_global:
        locking.append(type(case.gradients).__name__)
    if case.control is not None and type(case.control.elastic) in BY_BULK:
        locking.append(type(case.control.elastic).__name__)
    if not locking:
        return ""
    which = f"{' and '.join(locking)} {'lock' if len(locking) > 1 else 'locks'}"
    scheme = "pd.MeanDilatation(pd.Correspondence(), patch=2 * spacing)" if patches else "pd.Correspondence()"
    return (
        f"nu = {poisson_ratio(lame):.5g} at F = I, and {which}: displacements are too small and the pressure "
        f"oscillates; write scheme={scheme}, control=pd.ByShear(pd.Silling(0.5))."
    )


def refuse_contact_without_weights(case: Case, unsuited: str) -> None:
    """Raise CaseError if a tool presses a body whose default, conforming weights do not exist (not collective).

    Parameters
    ----------
    case : Case
        The case.
    unsuited : str
        Why they do not exist; empty if they do.
    """
    if unsuited and any(isinstance(condition, Contact | TwoParts) for condition in case.conditions):
        raise CaseError(
            f"Contact needs conforming weights, which do not exist here. {unsuited} With standard ones the pressure "
            f"would be wrong by half."
        )
