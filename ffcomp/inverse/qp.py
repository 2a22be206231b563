"""Quadratic programmes, by whichever solver is asked for.

    minimise ½ xᵀ P x + qᵀ x    subject to    low ≤ A x ≤ high

Before any solver sees it, the problem is brought to order one: every unknown is measured by its own curvature, rows and
objective by their largest coefficient. That matters more than which solver it is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from types import ModuleType

import numpy as np
from scipy import sparse

from ffcomp.errors import SolverError
from ffcomp.inverse.solver_names import Backend
from models.arrays import FloatArray

ACCURACY = 1e-5  # of scaled numbers, at which osqp stops; the others reach far more in any case
SMALLEST = 1e-12  # size of a programme that asks for nothing


@dataclass(frozen=True, slots=True)
class Problem:
    """A programme of order one."""

    p: FloatArray  # (n, n), its diagonal all ones
    q: FloatArray  # (n,)
    a: sparse.csc_matrix  # (m, n)
    low: FloatArray  # (m,)
    high: FloatArray  # (m,)


Solve = Callable[[Problem], tuple[str, FloatArray]]  # → status, "solved" if it is, and x


def solve_qp(
    p: FloatArray,
    q: FloatArray,
    a: sparse.csc_matrix,
    low: FloatArray,
    high: FloatArray,
    *,
    backend: Backend = "osqp",
) -> FloatArray:
    """Solve the programme for x (n,).

    p (n, n) is positive definite, a (m, n), low ≤ high (m,), infinite where there is none.

    Raises
    ------
    SolverError
        When the solver ends in any other way than with the answer, or is not installed.
    """
    unknown = 1.0 / np.sqrt(np.diag(p))
    columns = a.multiply(unknown[None, :]).tocsr()
    row = 1.0 / np.maximum(abs(columns).max(axis=1).toarray().ravel(), np.finfo(float).tiny)
    scaled_q = q * unknown
    low, high = low * row, high * row
    # x = size · unknown · y: how far the free answer lies, or how far x = 0 is from being allowed
    size = float(np.concatenate([np.abs(scaled_q), low, -high, [SMALLEST]]).max())
    problem = Problem(
        p * np.outer(unknown, unknown),
        scaled_q / size,
        sparse.csc_matrix(columns.multiply(row[:, None])),
        low / size,
        high / size,
    )
    status, y = BACKENDS[backend](problem)
    if status != "solved":
        what = f"{len(q)} unknowns and {len(low)} rows"
        raise SolverError(f"The quadratic programme of {what} ended in {backend} as «{status}».")
    return np.asarray(y * unknown * size)


def _osqp(problem: Problem) -> tuple[str, FloatArray]:
    osqp = _module("osqp")
    solver = osqp.OSQP()
    solver.setup(
        sparse.csc_matrix(np.triu(problem.p)),
        problem.q,
        problem.a,
        problem.low,
        problem.high,
        verbose=False,
        eps_abs=ACCURACY,
        eps_rel=ACCURACY,
        max_iter=20_000,
        polishing=False,
    )
    result = solver.solve(raise_error=False)
    return result.info.status, np.asarray(result.x)


def _piqp(problem: Problem) -> tuple[str, FloatArray]:
    piqp = _module("piqp")
    solver = piqp.DenseSolver()
    rows = np.asfortranarray(problem.a.toarray())
    solver.setup(np.asfortranarray(problem.p), problem.q, None, None, rows, problem.low, problem.high)
    status = solver.solve()
    return str(status).rpartition("PIQP_")[2].lower().replace("_", " "), np.asarray(solver.result.x)


def _clarabel(problem: Problem) -> tuple[str, FloatArray]:
    """Solve in the form A x + s = b with s ≥ 0: every row twice."""
    clarabel = _module("clarabel")
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    p, a = sparse.csc_matrix(np.triu(problem.p)), problem.a
    bound = [np.isfinite(problem.high), np.isfinite(problem.low)]
    rows = sparse.vstack([a[bound[0]], -a[bound[1]]]).tocsc()
    sides = np.concatenate([problem.high[bound[0]], -problem.low[bound[1]]])
    cones = [clarabel.NonnegativeConeT(len(sides))]
    solution = clarabel.DefaultSolver(p, problem.q, rows, sides, cones, settings).solve()
    return str(solution.status).lower(), np.asarray(solution.x)


def _cvxpy(problem: Problem) -> tuple[str, FloatArray]:
    """State the programme as a textbook would: the form to read, and to compare the other solvers with."""
    cp = _module("cvxpy")
    y = cp.Variable(len(problem.q))
    upper, lower = np.isfinite(problem.high), np.isfinite(problem.low)
    cost = 0.5 * cp.quad_form(y, cp.psd_wrap(problem.p)) + problem.q @ y
    within_limits = [
        problem.a[upper] @ y <= problem.high[upper],
        problem.a[lower] @ y >= problem.low[lower],
    ]
    programme = cp.Problem(cp.Minimize(cost), within_limits)
    try:
        programme.solve(solver=cp.CLARABEL)
    except cp.error.SolverError as error:
        return str(error), np.zeros(len(problem.q))
    return ("solved" if programme.status == cp.OPTIMAL else programme.status), np.asarray(y.value)


BACKENDS: dict[Backend, Solve] = {"osqp": _osqp, "piqp": _piqp, "clarabel": _clarabel, "cvxpy": _cvxpy}


def _module(name: str) -> ModuleType:
    try:
        return import_module(name)
    except ImportError:
        raise SolverError(f"The solver {name} is not installed. Install it with: pip install {name}") from None
