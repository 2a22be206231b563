"""Every solver against cvxpy, in any units; and what is said when there is no answer."""

from __future__ import annotations

import cvxpy as cp
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import sparse

from ffcomp.errors import SolverError
from ffcomp.inverse import qp as solvers
from ffcomp.inverse.qp import BACKENDS, solve_qp
from ffcomp.inverse.solver_names import SOLVERS, Backend

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


def test_the_names_that_the_command_line_lists_are_the_solvers() -> None:
    assert tuple(BACKENDS) == SOLVERS


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_every_solver_finds_what_cvxpy_finds(backend: Backend, seed: int) -> None:
    pytest.importorskip(backend)
    p, q, a, low, high = problem(seed)
    x = cp.Variable(len(q))
    held = [(a @ x)[4:] >= low[4:], (a @ x)[:4] <= high[:4], (a @ x)[8:] <= high[8:]]
    cp.Problem(cp.Minimize(0.5 * cp.quad_form(x, cp.psd_wrap(p)) + q @ x), held).solve(solver=cp.CLARABEL)
    found = solve_qp(p, q, a, low, high, backend=backend)
    assert np.any(np.abs(np.linalg.solve(p, -q) - found) > 0.1)  # a row binds
    np.testing.assert_allclose(found, x.value, atol=3e-3 if backend == "osqp" else 1e-5)


@pytest.mark.parametrize("backend", BACKENDS)
def test_units_do_not_matter(backend: Backend) -> None:
    """Unknowns in mm or nm, rows in any unit, an objective of any size: the same answer."""
    pytest.importorskip(backend)
    p, q, a, low, high = problem(4)
    rng = np.random.default_rng(9)
    unknown, row, size = 10.0 ** rng.uniform(-6, 6, len(q)), 10.0 ** rng.uniform(-4, 4, len(low)), 1e-7
    odd = sparse.csc_matrix(a.multiply(row[:, None]).multiply(unknown[None, :]))
    scaled = size * p * np.outer(unknown, unknown), size * q * unknown
    plain = solve_qp(p, q, a, low, high, backend=backend)
    found = unknown * solve_qp(*scaled, odd, low * row, high * row, backend=backend)
    np.testing.assert_allclose(found, plain, atol=1e-6)


@pytest.mark.parametrize("backend", BACKENDS)
def test_no_answer_is_an_error_with_solver_status_and_size(backend: Backend) -> None:
    pytest.importorskip(backend)
    a = sparse.csc_matrix(np.array([[1.0, 0.0], [1.0, 0.0]]))
    low, high = np.array([1.0, -np.inf]), np.array([np.inf, -1.0])
    with pytest.raises(SolverError, match=rf"2 unknowns and 2 rows ended in {backend} as «.*infeasible.*»") as caught:
        solve_qp(np.eye(2), np.ones(2), a, low, high, backend=backend)
    assert caught.value.exit_code == 7


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_solver_that_is_not_there_says_how_to_get_it(backend: Backend, monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> None:
        raise ModuleNotFoundError(f"No module named {name!r}", name=name)

    monkeypatch.setattr(solvers, "import_module", missing)
    p, q, a, low, high = problem(1)
    with pytest.raises(SolverError, match=f"pip install {backend}"):
        solve_qp(p, q, a, low, high, backend=backend)


@pytest.mark.parametrize("backend", BACKENDS)
def test_without_rows_that_bind_it_is_the_linear_system(backend: Backend) -> None:
    pytest.importorskip(backend)
    p, q, a, _, _ = problem(5)
    wide = np.full(a.shape[0], 1e3)
    found = solve_qp(p, q, a, -wide, wide, backend=backend)
    np.testing.assert_allclose(found, np.linalg.solve(p, -q), atol=2e-4 if backend == "osqp" else 1e-7)
