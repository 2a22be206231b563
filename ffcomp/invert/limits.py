"""The same least squares under hard limits: a quadratic programme, solved only where the free answer breaks a limit.

    minimise ½ δᵀ H δ − gᵀ δ   subject to   |D u| <= v S,  |D² u| <= a S²,   u = u₀ + δ at the knots of each carriage

Unknowns are scaled by their curvature and rows by their limit, so everything the solver sees is of order one; that
matters more than the choice of solver.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ffcomp.errors import SolverError

if TYPE_CHECKING:
    from scipy import sparse

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class CommandLimits:
    """Of each carriage's command, per knot."""

    step_mm: float  # v S
    bend_mm: float  # a S²


def excess(command: FloatArray, limits: CommandLimits) -> float:
    """How many times the tighter limit the command (n, 3) mm takes at its worst; up to 1 is allowed."""
    step = np.abs(np.diff(command, axis=0)).max(initial=0.0) / limits.step_mm
    bend = np.abs(np.diff(command, 2, axis=0)).max(initial=0.0) / limits.bend_mm
    return float(max(step, bend))


def limited_step(
    hessian: FloatArray, gradient: FloatArray, command: FloatArray, plan: FloatArray, limits: CommandLimits
) -> FloatArray:
    """The best change of the unknown knots that keeps the limits.

    Where the plan itself breaks a limit, the plan's own demand is the limit there: following it is always possible.

    Parameters
    ----------
    hessian : (3 n, 3 n);  gradient : (3 n,), of the unknown knots, carriages A B C inside
    command : (n + 4, 3) mm, as it stands, with two given knots on either side
    plan : (n + 4, 3) mm, what the path itself asks for

    Returns
    -------
    (3 n,) mm

    Raises
    ------
    SolverError
        When the solver ends without an answer.
    """
    import osqp
    from scipy import sparse

    n = len(command) - 4
    scale = 1.0 / np.sqrt(np.diag(hessian))
    p = sparse.csc_matrix(np.triu(hessian * np.outer(scale, scale)))
    status = ""
    for slack in (1.0, 1.25, 1.6):  # knots already committed may leave no room at a window's edge
        rows, low, high = _rows(command, plan, limits, n, slack)
        solver = osqp.OSQP()
        solver.setup(
            p,
            -gradient * scale,
            sparse.csc_matrix(rows.multiply(scale)),
            low,
            high,
            verbose=False,
            eps_abs=1e-5,
            eps_rel=1e-5,
            max_iter=20_000,
            polishing=False,
        )
        result = solver.solve(raise_error=False)
        status = result.info.status
        if status == "solved":
            return np.asarray(result.x) * scale
    raise SolverError(f"The quadratic programme of {3 * n} unknowns ended as «{status}».")


def _rows(
    command: FloatArray, plan: FloatArray, limits: CommandLimits, n: int, slack: float
) -> tuple[sparse.csr_matrix, FloatArray, FloatArray]:
    """Differences of the unknown knots and what is left of the limits for them, all divided by the limit."""
    from scipy import sparse

    blocks, lows, highs = [], [], []
    for order, limit in ((1, limits.step_mm), (2, limits.bend_mm)):
        d = np.diff(np.eye(n + 4), order, axis=0)
        touched = np.any(d[:, 2:-2] != 0.0, axis=1)
        now, asked = np.diff(command, order, axis=0)[touched], np.diff(plan, order, axis=0)[touched]
        ceiling = slack * np.maximum(limit, np.abs(asked))
        blocks.append(sparse.kron(sparse.csr_matrix(d[touched][:, 2:-2] / limit), sparse.eye(3)))
        lows.append(((-ceiling - now) / limit).ravel())
        highs.append(((ceiling - now) / limit).ravel())
    return sparse.vstack(blocks).tocsr(), np.concatenate(lows), np.concatenate(highs)
