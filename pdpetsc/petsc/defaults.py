"""Default options of the solvers for a problem."""

from __future__ import annotations

from collections.abc import Mapping

from pdpetsc.declare.solvers import DeclaredSolver
from pdpetsc.petsc.jacobian import Choice
from pdpetsc.petsc.library import DIRECTIONS
from pdpetsc.problem.problem import Problem

# Relative tolerance of the first linear solve of a step, and the largest of the others.
LOOSE = 1e-3
# Growth of the residual at which a linear solver gives up. The preconditioner does not know point supports: in its norm
# the residual grows by 1e5 before it falls. PETSc would give up at 1e4.
GROWN = 1e12

# Options of a linear solver; with several blocks, each block has its own.
OF_A_SOLVER = ("ksp_", "pc_", "mat_", "mg_")


def coupled_options(defaults: Mapping[str, object]) -> dict[str, object]:
    """Convert solver options of a displacement to those of the displacement block beside a temperature.

    The temperature is solved first, with a Cholesky factor, and changes the forces of the displacement. Flexible GMRES
    with PCFIELDSPLIT needs one iteration if both blocks are factored. The coupled system has no energy, so full steps
    are used.
    """
    found: dict[str, object] = {}
    for name, value in defaults.items():
        if name.startswith(OF_A_SOLVER):
            found[f"fieldsplit_displacement_{name}"] = value
        elif not name.startswith("snes_ksp_ew"):
            found[name] = value
    of_heat = {"ksp_type": "preonly", "pc_type": "cholesky", "pc_factor_mat_solver_type": "mumps"}
    return found | {f"fieldsplit_temperature_{name}": value for name, value in of_heat.items()} | {
        "ksp_type": "fgmres", "ksp_rtol": 1e-8, "ksp_atol": 0.0, "pc_type": "fieldsplit",
        "pc_fieldsplit_type": "multiplicative", "snes_linesearch_type": "basic",
    }  # fmt: skip


def default_options(problem: Problem, solver: DeclaredSolver, choice: Choice) -> dict[str, object]:
    """Return the default solver options of a problem; options of the case and the command line override them.

    The solver is direct (MUMPS, LDL^T of the symmetric matrix) up to ``DIRECT_UNKNOWNS``. Beyond, it is conjugate
    gradients: with two levels (``TwoLevel``) if matrix-free, with algebraic multigrid and rigid-body near-null space if
    assembled.

    The line search ``cp`` searches a zero of the residual along the step, which is right for the gradient of an energy.
    In slender bending ``bt`` fails because a good first step raises the residual norm a thousandfold. Secant steps of
    ``cp`` cost only residuals. Up to ten of them, against PETSc's one, reduce the Newton iterations of a cantilever
    under a large tip force from 32 to 10 (first of ten steps).

    If points fail or bodies touch, a search ends when a tenth of the first derivative of the energy along the step is
    left. The energy then has kinks, and a longer search costs as many residuals again. With the stiff forces of contact
    it would not end before ten steps, since the derivative is round-off.

    If options request GAMG without a matrix, it smooths with the tangent itself (``-pc_use_amat``, PETSc's default).
    Short waves of the tangent are softer than those of the nearest neighbours that GAMG coarsens. One Chebyshev step
    with bounds estimated from the tangent needs 17 iterations. Two steps with the bounds of the nearest neighbours need
    15, at twice the time each.

    GAMG keeps its aggregates during Newton iterations.

    Every absolute tolerance is zero: a number with a unit does not measure the quality of a solution. The absolute
    tolerance of ``cp`` would accept any residual if force and step are small numbers.

    GMRES is preconditioned from the right, so that its tolerance is that of the forces. From the left it would accept
    steps that leave the stiff forces of contact unbalanced.

    If bonds fail, MUMPS detects null pivots, of particles that lose all their bonds in an iteration.

    Along a path the residual with its constraint is not the gradient of an energy, so full steps are used. Beyond a
    limit of the load the tangent is indefinite. If points fail, the preconditioner of two levels does not know the
    softening and stays positive definite, as MINRES needs it, which stores few vectors. Otherwise the preconditioner is
    indefinite too, since the background grid and GAMG solve long waves with their own tangents, and GMRES solves the
    system. Its restart is long because systems close to the limit need many directions. With contact a restart after 30
    iterations doubles their number.

    With damage of bonds without an energy, the tolerance of linear solves is 1e-8. Otherwise it starts at 1e-3 and
    decreases as Newton converges (Eisenstat1996).
    """
    defaults: dict[str, object] = {
        "snes_type": "newtonls",
        "snes_linesearch_type": "cp" if solver.of_energy and not problem.linear else "basic",
        "snes_linesearch_max_it": 10,
        "snes_linesearch_atol": 0.0,
        "snes_atol": 0.0,
        "ksp_atol": 0.0,
        "snes_rtol": 1e-10,
        "snes_max_it": 30,
    }
    with_energy = problem.damage is not None and problem.damage.forces_have_energy
    if with_energy or problem.stiff:
        defaults["snes_linesearch_rtol"] = 0.1
    if choice.direct:
        defaults |= {
            "ksp_type": "preonly",
            "pc_type": "cholesky" if problem.symmetric else "lu",
            "pc_factor_mat_solver_type": "mumps",
            "mat_mumps_icntl_14": 50,
        }
        if problem.symmetric and problem.body.cloud.comm.size > 1:
            # Factor the last dense block without ScaLAPACK, which does not count negative pivots.
            defaults["mat_mumps_icntl_13"] = 1
        return defaults if problem.damage is None else defaults | {"mat_mumps_icntl_24": 1}
    kind = "gmres"
    if problem.symmetric and solver.of_energy:
        kind = "cg"
    elif problem.symmetric and choice.levels and with_energy and problem.bond_damage is None:
        kind = "minres"
    defaults |= {"ksp_type": kind, "ksp_rtol": 1e-8, "ksp_max_it": 500, "ksp_divtol": GROWN}
    if (choice.ksp or defaults["ksp_type"]) == "gmres":
        defaults |= {"ksp_pc_side": "right", "ksp_gmres_restart": DIRECTIONS}
    if not problem.linear and (problem.damage is None or with_energy):
        defaults |= {"snes_ksp_ew": None, "snes_ksp_ew_rtol0": LOOSE, "snes_ksp_ew_rtolmax": LOOSE, "ksp_rtol": 1e-5}
    if with_energy:
        # Conjugate gradients stop at negative curvature. The energy may fall or rise along the direction that they
        # return.
        defaults["snes_max_linear_solve_fail"] = defaults["snes_max_it"]
    if choice.levels and problem.constrained:
        # The preconditioner is an iterative saddle-point solve, which varies between applications.
        defaults |= {"ksp_type": "fgmres", "pc_type": "python"}
        return defaults | {f"soft_{name}": value for name, value in _of_levels(choice.levels, problem).items()}
    if choice.levels:
        return defaults | {"pc_type": "mg"} | _of_levels(choice.levels, problem, kind == "minres")
    if choice.pc in ("", "gamg"):
        defaults |= {"pc_type": "gamg", "pc_gamg_agg_nsmooths": 1, "pc_gamg_threshold": 0.01}
        defaults["pc_gamg_reuse_interpolation"] = "true"
        if choice.matrix_free:
            defaults |= {"pc_gamg_use_sa_esteig": "false", "mg_levels_ksp_max_it": 1}
            defaults |= {"mg_levels_esteig_ksp_max_it": 6, "pc_gamg_esteig_ksp_max_it": 5}
    return defaults


def _of_levels(kind: str, problem: Problem, learns: bool = False) -> dict[str, object]:
    """Return the options of the two levels: by default, one application of the tangent per iteration.

    The sum of the corrections of both levels needs about twice the iterations of a cycle. An iteration applies the
    tangent once instead of three times, and needs no estimated bounds. With ``learns`` the smoother is a Python object
    that can add slow modes (``SlowModes``).
    """
    # For many nodes: two Chebyshev steps of GAMG. One cycle would need up to twice the iterations.
    coarse: dict[str, object] = {"mg_coarse_ksp_max_it": 2, "mg_coarse_ksp_chebyshev_esteig": "0,0.2,0,1.1"}
    coarse |= {"mg_coarse_pc_gamg_agg_nsmooths": 1, "mg_coarse_pc_gamg_threshold": 0.01}
    coarse["mg_coarse_pc_gamg_reuse_interpolation"] = "true"
    levels: dict[str, object] = {
        "pc_mg_type": kind,
        "mg_levels_pc_type": "python" if problem.stiff or learns else "pbjacobi",
        **coarse,
    }
    if kind == "additive":
        return levels | {"mg_levels_ksp_type": "preonly"}
    return levels | {"mg_levels_ksp_type": "chebyshev", "mg_levels_ksp_max_it": 1, "mg_levels_esteig_ksp_max_it": 8}
