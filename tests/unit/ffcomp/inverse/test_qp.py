"""The solver against cvxpy, in any units; and the error when there is no answer."""

from __future__ import annotations

import cvxpy as cp
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import sparse

from ffcomp.errors import SolverError
from ffcomp.inverse.qp import solve_qp

FloatArray = NDArray[np.float64]


def problem(seed: int) -> tuple[FloatArray, FloatArray, sparse.csc_matrix, FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    n, m = 20, 35
    factor = rng.normal(size=(40, n))
    rows = np.where(rng.random((m, n)) < 0.3, rng.normal(size=(m, n)), 0.0) + np.eye(m, n)
    middle = rows @ rng.normal(0, 0.1, n)  # something is allowed
    low, high = middle - rng.uniform(0.05, 0.5, m), middle + rng.uniform(0.05, 0.5, m)
    low[:4], high[4:8] = -np.inf, np.inf
    return factor.T @ factor, 30.0 * rng.normal(size=n), sparse.csc_matrix(rows), low, high


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_it_finds_what_cvxpy_finds(seed: int) -> None:
    p, q, a, low, high = problem(seed)
    x = cp.Variable(len(q))
    held = [(a @ x)[4:] >= low[4:], (a @ x)[:4] <= high[:4], (a @ x)[8:] <= high[8:]]
    cp.Problem(cp.Minimize(0.5 * cp.quad_form(x, cp.psd_wrap(p)) + q @ x), held).solve(solver=cp.CLARABEL)
    found = solve_qp(p, q, a, low, high)
    assert np.any(np.abs(np.linalg.solve(p, -q) - found) > 0.1)  # a row binds
    np.testing.assert_allclose(found, x.value, atol=3e-3)


def test_units_do_not_matter() -> None:
    """Unknowns in mm or nm, rows in any unit, an objective of any size: the same answer."""
    p, q, a, low, high = problem(4)
    rng = np.random.default_rng(9)
    unknown, row, size = 10.0 ** rng.uniform(-6, 6, len(q)), 10.0 ** rng.uniform(-4, 4, len(low)), 1e-7
    odd = sparse.csc_matrix(a.multiply(row[:, None]).multiply(unknown[None, :]))
    scaled = size * p * np.outer(unknown, unknown), size * q * unknown
    plain = solve_qp(p, q, a, low, high)
    found = unknown * solve_qp(*scaled, odd, low * row, high * row)
    np.testing.assert_allclose(found, plain, atol=1e-6)


def test_no_answer_is_an_error_with_solver_status_and_size() -> None:
    a = sparse.csc_matrix(np.array([[1.0, 0.0], [1.0, 0.0]]))
    low, high = np.array([1.0, -np.inf]), np.array([np.inf, -1.0])
    with pytest.raises(SolverError, match=r"2 unknowns and 2 rows ended in osqp as «.*infeasible.*»") as caught:
        solve_qp(np.eye(2), np.ones(2), a, low, high)
    assert caught.value.exit_code == 7
