"""Default options of the solvers for a problem."""

from __future__ import annotations

from collections.abc import Mapping

from pdpetsc.declare.solvers import DeclaredSolver
from pdpetsc.petsc.jacobian import Choice
from pdpetsc.problem.problem import Problem

# Relative tolerance of the first linear solve of a step, and the largest of the others.
LOOSE = 1e-3


# Those of a linear solver, which are of one part where there are several.
OF_A_SOLVER = ("ksp_", "pc_", "mat_", "mg_")


def coupled_options(defaults: Mapping[str, object]) -> dict[str, object]:
    """Return solver options of a displacement as those of the part of it beside a temperature.

    The temperature is found first, by a Cholesky factor, and moves the forces of the displacement: flexible GMRES about
    PCFIELDSPLIT takes one iteration where both parts are factored. The coupled system has no energy: full steps.
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
    """Return pdpetsc's solver options for a problem; those of the case and the command line override each.

    Direct (MUMPS, LDL^T of the symmetric matrix) up to ``DIRECT_UNKNOWNS``, beyond it conjugate gradients: without a
    matrix on two levels (``TwoLevel``), with one on algebraic multigrid with rigid-body near-null space.
    The line search ``cp`` looks for a zero of the residual along the step, which is right for the gradient of an
    energy; in slender bending ``bt`` fails because a good first step raises the residual norm a thousandfold. Its
    secant steps cost residuals only: up to ten of them, against PETSc's one, lower the Newton iterations of the first
    of ten steps of a cantilever under a large tip force from 32 to 10.
    Where points fail a search ends once a tenth of the first derivative of the energy along the step is left: there the
    energy has kinks, and to look further costs as many residuals again.
    Where options ask for GAMG without a matrix it smooths with the tangent itself (``-pc_use_amat``, PETSc's default),
    whose short waves are softer than those of the nearest neighbours that it coarsens: one Chebyshev step on bounds
    estimated with the tangent takes 17 iterations where two on the bounds of the nearest neighbours take 15 and twice
    the time each.
    GAMG keeps its aggregates while Newton goes on.
    Every absolute tolerance is zero: a number with a unit says nothing of how good an answer is. That of ``cp`` would
    end a solve as converged where force and step are small numbers, whatever the residual is.
    Where bonds fail MUMPS looks for pivots that vanish, of particles that lose all their bonds in an iteration.
    Along a path the residual with its constraint is not the gradient of an energy, so full steps are taken. There and
    with damage of bonds linear solves go to 1e-8; else to 1e-3 at first, and further as Newton converges
    (Eisenstat1996).
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
    of_points = problem.damage is not None and problem.damage.forces_have_energy
    if of_points:
        defaults["snes_linesearch_rtol"] = 0.1
    if choice.direct:
        defaults |= {
            "ksp_type": "preonly",
            "pc_type": "cholesky" if problem.symmetric else "lu",
            "pc_factor_mat_solver_type": "mumps",
            "mat_mumps_icntl_14": 50,
        }
        if problem.symmetric and problem.body.cloud.comm.size > 1:
            # The last dense block is factored without ScaLAPACK, which does not count negative pivots.
            defaults["mat_mumps_icntl_13"] = 1
        return defaults if problem.damage is None else defaults | {"mat_mumps_icntl_24": 1}
    defaults |= {"ksp_type": "cg" if problem.symmetric else "gmres", "ksp_rtol": 1e-8, "ksp_max_it": 500}
    if solver.of_energy and not problem.linear and (problem.damage is None or of_points):
        defaults |= {"snes_ksp_ew": None, "snes_ksp_ew_rtol0": LOOSE, "snes_ksp_ew_rtolmax": LOOSE, "ksp_rtol": 1e-5}
    if of_points:
        # Conjugate gradients stop at negative curvature with a direction along which the energy falls, or rises.
        defaults["snes_max_linear_solve_fail"] = defaults["snes_max_it"]
    if choice.levels and problem.constrained:
        # A solve with conditions as unknowns preconditions, and is another one each time.
        defaults |= {"ksp_type": "fgmres", "pc_type": "python"}
        return defaults | {f"soft_{name}": value for name, value in _of_levels(choice.levels).items()}
    if choice.levels:
        return defaults | {"pc_type": "mg"} | _of_levels(choice.levels)
    if choice.pc in ("", "gamg"):
        defaults |= {"pc_type": "gamg", "pc_gamg_agg_nsmooths": 1, "pc_gamg_threshold": 0.01}
        defaults["pc_gamg_reuse_interpolation"] = "true"
        if choice.matrix_free:
            defaults |= {"pc_gamg_use_sa_esteig": "false", "mg_levels_ksp_max_it": 1}
            defaults |= {"mg_levels_esteig_ksp_max_it": 6, "pc_gamg_esteig_ksp_max_it": 5}
    return defaults


def _of_levels(kind: str) -> dict[str, object]:
    """Return the options of the two levels: one application of the tangent an iteration, unless cycles are asked for.

    The sum of what both levels correct takes about twice the iterations of a cycle, each with one application of the
    tangent instead of three, and no bounds that have to be estimated.
    """
    # Where nodes are many: three Chebyshev steps of GAMG, which one cycle takes up to twice the iterations for.
    coarse: dict[str, object] = {"mg_coarse_ksp_max_it": 3, "mg_coarse_ksp_chebyshev_esteig": "0,0.2,0,1.1"}
    coarse |= {"mg_coarse_pc_gamg_agg_nsmooths": 1, "mg_coarse_pc_gamg_threshold": 0.01}
    coarse["mg_coarse_pc_gamg_reuse_interpolation"] = "true"
    levels: dict[str, object] = {"pc_mg_type": kind, "mg_levels_pc_type": "pbjacobi", **coarse}
    if kind == "additive":
        return levels | {"mg_levels_ksp_type": "preonly"}
    return levels | {"mg_levels_ksp_type": "chebyshev", "mg_levels_ksp_max_it": 1, "mg_levels_esteig_ksp_max_it": 8}
