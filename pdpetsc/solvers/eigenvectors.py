"""Eigenvectors of tangents, which rank 0 computes with distributed operators."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import scipy

from pdpetsc.arrays import Float, Mask, irregular
from pdpetsc.discrete.communicator import Comm, is_root, total
from pdpetsc.errors import SolveError
from pdpetsc.problem.problem import Problem
from pdpetsc.solvers.protocol import Flexibility

# Relative accuracy of eigenvalues.
EXACT = 1e-10
# Largest number of restarts of the eigensolver; modes that exist need some ten.
ITERATIONS = 300


def of_inverse(
    problem: Problem, flexible: Flexibility, weight: Float, kinds: Sequence[tuple[str, int]],
    added: Float | None = None,
) -> tuple[Float, list[Float]]:  # fmt: skip
    """Compute eigenvalues and eigenvectors (n_owned, dim) of ``C^T K C phi = 1 / value C^T W C phi``.

    With ``W = R R^T`` they are those of ``R^T C (C^T K C)^-1 C^T R``; C are the constraints, and R is the root of the
    weights of the particles, followed by the columns ``added``. The eigenvectors are orthonormal with W.

    Parameters
    ----------
    flexible : Flexibility
        Inverse of the tangent K.
    weight : (n_owned,) float64
        Weights W of the own particles, such as masses or volumes.
    kinds : sequence of (str, int)
        Which eigenvalues, ``"LA"`` for the largest or ``"SA"`` for the smallest, and their number.
    added : (n_columns, n_rows, dim) float64, optional
        Further columns of R, such as those of masses that move with several particles.

    Raises
    ------
    SolveError
        The tangent cannot be solved, or the iteration does not converge.

    Notes
    -----
    Collective.
    """
    comm, n, root = problem.body.cloud.comm, problem.body.cloud.n_owned, np.sqrt(weight)[:, None]
    columns = np.zeros((0, *problem.supports.fixed.shape)) if added is None else added
    # The first rank has the entries of these columns.
    more = len(columns) if is_root(comm) else 0

    def operator(y: Float) -> Float:
        force = np.einsum("k,kpi->pi", comm.bcast(y[len(y) - more :]), columns)
        force[:n] += root * y[: len(y) - more].reshape(n, -1)
        moved = flexible(force)
        of_columns = total(comm, np.einsum("kpi,pi->k", columns, moved))
        return np.concatenate([(root * moved[:n]).ravel(), of_columns[:more]])

    def solve(apply: Mapping[str, Callable[[Float], Float]], size: int, start: Float) -> tuple[Float, Float]:
        A = scipy.sparse.linalg.LinearOperator((size, size), apply["A"], dtype=float)
        parts = [converged(A, min(most, size - 1), which=which, v0=start) for which, most in kinds]
        return np.concatenate([part[0] for part in parts]), np.concatenate([part[1] for part in parts], axis=1)

    values, vectors = led(problem, {"A": operator}, np.ones((n, problem.dim), dtype=bool), solve, more)
    return values, [y / root for y in vectors]


def converged(A: Any, count: int, **given: Any) -> tuple[Float, Float]:
    """Return the eigenvalues and eigenvectors that converge, at most ``count``; the others have no meaning here."""
    try:
        values, vectors = scipy.sparse.linalg.eigsh(A, count, tol=EXACT, maxiter=ITERATIONS, **given)
    except scipy.sparse.linalg.ArpackNoConvergence as error:
        values, vectors = error.eigenvalues, error.eigenvectors
    return np.asarray(values), np.asarray(vectors)


def led(
    problem: Problem, operators: Mapping[str, Callable[[Float], Float]], taken: Mask,
    solve: Callable[[Mapping[str, Callable[[Float], Float]], int, Float], tuple[Float, Float]], more: int = 0,
) -> tuple[Float, list[Float]]:  # fmt: skip
    """Let rank 0 solve an eigenproblem of distributed operators; return eigenvalues and eigenvectors (n_owned, dim).

    Rank 0 alone decides which operator is applied next, so that rounding cannot part the ranks.

    Parameters
    ----------
    operators : mapping of str to callable
        Operators on the entries ``taken`` of this rank; collective.
    taken : (n_owned, dim) bool
        Unknowns of the eigenproblem.
    solve : callable
        Gets operators on the unknowns of all ranks, their number and a start, and returns eigenvalues and eigenvectors.
    more : int
        Number of unknowns of this rank behind those of its particles.
    """
    comm, cloud = problem.body.cloud.comm, problem.body.cloud
    counts = np.array(comm.allgather(int(taken.sum()) + more))
    size, parts = int(counts.sum()), np.cumsum(counts)[:-1]
    start = comm.gather(np.append(irregular(cloud.gid[: cloud.n_owned], problem.dim)[taken], np.ones(more)))

    def spread(name: str, y: Float) -> Float:
        """Apply an operator, on all ranks together; called on rank 0."""
        comm.bcast(name)
        return _applied(comm, operators[name], np.split(np.ravel(y), parts))

    found: tuple[Float, Float] | None = None
    wrong = ""
    if is_root(comm):
        assert start is not None
        try:
            apply = {name: (lambda y, name=name: spread(name, y)) for name in operators}
            found = solve(apply, size, np.concatenate(start))
        except scipy.sparse.linalg.ArpackError as error:
            wrong = " ".join(str(error).split())
        comm.bcast(None)
    else:
        while (name := comm.bcast(None)) is not None:
            _applied(comm, operators[name], [])
    wrong = comm.bcast(wrong)
    if wrong:
        raise SolveError(f"The modes of the equilibrium were not found: {wrong}.")
    values = comm.bcast(None if found is None else found[0])
    vectors = []
    for number in range(len(values)):
        part = comm.scatter([] if found is None else np.split(found[1][:, number], parts))
        vector = np.zeros((cloud.n_owned, problem.dim))
        vector[taken] = part[: len(part) - more]
        vectors.append(vector)
    return values, vectors


def _applied(comm: Comm, operator: Callable[[Float], Float], parts: list[Float]) -> Float:
    """Apply an operator to the parts that rank 0 holds; return the whole result on rank 0 (collective)."""
    gathered = comm.gather(operator(comm.scatter(parts)))
    return np.zeros(0) if gathered is None else np.concatenate(gathered)
