"""Choice between an assembled and a matrix-free tangent."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from petsc4py import PETSc

from pdpetsc.arrays import Mask
from pdpetsc.declare.solvers import DeclaredSolver
from pdpetsc.discrete.communicator import total
from pdpetsc.errors import CaseError
from pdpetsc.petsc.constrained import Constrained
from pdpetsc.petsc.matrix import TangentMatrix, predicted_bytes
from pdpetsc.petsc.matrix_free import MatrixFreeTangent, NearMatrix, Preconditioning
from pdpetsc.petsc.sparse import PER_ENTRY
from pdpetsc.petsc.tangent import PetscTangent
from pdpetsc.petsc.two_level import TwoLevel, predicted_bytes_of
from pdpetsc.problem.assembly import Assembler, Filler
from pdpetsc.problem.background_elements import BackgroundElements
from pdpetsc.problem.nearest_neighbours import NearAssembler
from pdpetsc.problem.problem import Problem

# Largest number of unknowns for which the direct solver is the default, by dimension. A factorisation then takes at
# most a second and counts negative pivots. Two levels are faster from a thousand particles on at horizon 2.
DIRECT_UNKNOWNS = {1: 10**7, 2: 20_000, 3: 3_000}
# The same for problems on which iterative solvers may fail: with damage, whose tangents are not definite, and without
# control of zero-energy modes.
HARD_UNKNOWNS = {1: 10**7, 2: 120_000, 3: 12_000}
# Blocks of a matrix row of nearest neighbours on a lattice, by dimension. A tangent with at most WIDE times as many
# blocks in a row is assembled. In 3D multigrid on it takes twice as long even at horizon 1.
NEAR_BLOCKS, WIDE = {1: 5, 2: 13, 3: 25}, {1: 1.5, 2: 1.5, 3: 0.0}
# Sample size on each rank for counting neighbours within two horizons.
SAMPLE = 300


@dataclass(frozen=True)
class Choice:
    """Store how the tangent is represented.

    Attributes
    ----------
    pc : str
        Preconditioner named by options, empty if none.
    direct : bool
        Whether the solver is a factorisation.
    matrix_free : bool
        Whether the tangent is applied without a matrix.
    levels : str
        PETSc's type of multigrid with diagonal blocks and a background grid; empty for another preconditioner.
    estimate : int
        Estimated memory of the assembled tangent over all ranks [bytes]; 0 if it was not estimated.
    why : str
        Reason for the choice, for the log.
    ksp : str
        Linear solver named by options, empty if none.
    """

    pc: str
    direct: bool
    matrix_free: bool
    levels: str
    estimate: int
    why: str
    ksp: str = ""


def choose(problem: Problem, chosen: Mapping[str, Any], solver: DeclaredSolver, pivots: bool = False) -> Choice:
    """Choose by ``-pd_jacobian``, else by size: direct for small problems, assembled for narrow rows.

    Parameters
    ----------
    chosen : mapping
        PETSc options of the case; options of the command line take precedence.
    pivots : bool
        Whether the case requests the stability of equilibria.

    Raises
    ------
    CaseError
        The word is unknown, or the solver needs a matrix.

    Notes
    -----
    Collective.
    """
    database = PETSc.Options()
    word = database.getString("pd_jacobian", str(chosen.get("pd_jacobian", "auto")))
    # With a temperature, it is the solver of the displacement block.
    name = "fieldsplit_displacement_pc_type" if problem.coupled else "pc_type"
    pc = database.getString(name, str(chosen.get(name, "")))
    ksp = database.getString("ksp_type", str(chosen.get("ksp_type", "")))
    if word == "matfree" and problem.coupled:
        raise CaseError(
            "Temperature and displacement together need a matrix; leave -pd_jacobian at assembled or auto, or take "
            'coupling="staggered".'
        )
    if word not in ("assembled", "matfree", "auto"):
        raise CaseError(f"-pd_jacobian takes assembled, matfree or auto, not {word!r}.")
    if word == "matfree" and solver.needs.tangent == "assembled":
        raise CaseError(f"{solver.title} factors its matrix; leave -pd_jacobian at assembled or auto.")
    cloud, dim = problem.body.cloud, problem.dim
    unknowns = cloud.n_global * dim
    most, kind = _largest_factored(problem)
    # Iterative solvers find negative curvature of symmetric tangents that do not soften.
    pivots = pivots and (problem.damage is not None or not problem.symmetric)
    small = unknowns <= most or pivots
    direct = pc in ("lu", "cholesky") or (not pc and small)
    why = f"{unknowns:,} unknowns are {'at most' if unknowns <= most else 'more than'} {most:,}{kind}"
    if pc:
        why = f"-pc_type {pc}"
    elif pivots and unknowns > most:
        why = "the case asks whether equilibria are stable"
    if word == "assembled" or problem.coupled or solver.needs.tangent != "any" or (word == "auto" and direct):
        if word == "assembled":
            why += ", -pd_jacobian assembled"
        return Choice(pc, direct, False, "", 0, why, ksp)
    blocks = _blocks(problem)
    narrow = blocks <= WIDE[dim] * NEAR_BLOCKS[dim] * cloud.n_global
    matrix_free = word == "matfree" or not narrow
    if word == "matfree":
        why = "-pd_jacobian matfree"
    elif narrow:
        why += ", rows are hardly longer than those of nearest neighbours"
    size = dim**2 * PER_ENTRY
    levels = database.getString("pc_mg_type", str(chosen.get("pc_mg_type", "additive")))
    if not matrix_free or pc not in ("", "mg"):
        levels = ""
    return Choice(pc, direct and not matrix_free, matrix_free, levels, int(blocks * size), why, ksp)


def _largest_factored(problem: Problem) -> tuple[int, str]:
    """Return the largest number of unknowns for the direct solver, and the kind of problem (collective)."""
    dim, cloud = problem.dim, problem.body.cloud
    if problem.damage is not None:
        return HARD_UNKNOWNS[dim], " with damage"
    points = int(total(cloud.comm, problem.material_term.n_points))
    controlled = any(term.energy_of == "control" for term in problem.terms)
    if points == cloud.n_global and not controlled:
        return HARD_UNKNOWNS[dim], " with one gradient point a particle and no control"
    return DIRECT_UNKNOWNS[dim], ""


def assembler(problem: Problem, choice: Choice) -> Filler:
    """Build the object that fills the matrices of the choice (collective)."""
    if not choice.matrix_free:
        return Assembler(problem)
    return BackgroundElements(problem) if choice.levels else NearAssembler(problem)


def make_tangent(filler: Filler, fixed: Mask, scale: float) -> PetscTangent:
    """Build the tangent over ``scale`` [force / length] from the object that fills its matrices (collective)."""
    problem = filler.problem
    preconditioning: Preconditioning
    if isinstance(filler, BackgroundElements):
        preconditioning = levels = TwoLevel(filler, fixed, scale)
        if problem.constrained:
            preconditioning = Constrained(levels, problem, fixed, scale)
    elif isinstance(filler, NearAssembler):
        preconditioning = NearMatrix(filler, fixed, scale)
    else:
        assert isinstance(filler, Assembler)
        return TangentMatrix(filler, fixed, scale)
    return MatrixFreeTangent(problem, preconditioning, fixed, scale)


def predicted(filler: Filler) -> int:
    """Estimate the memory of the matrix entries over all ranks [bytes] (collective)."""
    if isinstance(filler, BackgroundElements):
        return predicted_bytes_of(filler)
    assert isinstance(filler, Assembler)
    return predicted_bytes(filler.pattern, filler.problem.dim)


def words(choice: Choice, predicted: int) -> str:
    """Return the log line for the representation of the tangent with ``predicted`` bytes (not collective)."""
    if choice.matrix_free:
        by = "a background grid" if choice.levels else "the matrix of nearest neighbours"
        return (
            f"tangent: matrix-free; preconditioner: {by}, {predicted / 2**20:.1f} MiB (the assembled tangent would "
            f"need about {choice.estimate / 2**20:.0f} MiB)"
        )
    return (
        f"tangent: assembled matrix of {predicted / 2**20:.1f} MiB, {'direct' if choice.direct else 'iterative'} solver"
    )


def matrices(choice: Choice) -> str:
    """Return the name of the matrices of the tangent, for the run record (not collective)."""
    if not choice.matrix_free:
        return "tangent matrix"
    return "matrix of the background grid" if choice.levels else "matrix of nearest neighbours"


def _blocks(problem: Problem) -> float:
    """Estimate the number of blocks of the assembled tangent from a sample of particles (collective)."""
    cloud = problem.body.cloud
    sample = np.linspace(0, cloud.n_owned - 1, min(SAMPLE, cloud.n_owned)).astype(np.int64)
    reach = cloud.local_horizon[sample] * problem.horizons * (1.0 + 1e-9)
    found = scipy.spatial.cKDTree(cloud.x).query_ball_point(cloud.x[sample], reach, return_length=True)
    return float(total(cloud.comm, float(np.mean(found)) * cloud.n_owned))
