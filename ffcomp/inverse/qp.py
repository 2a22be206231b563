"""The least squares of `limited_window.py` under the hard limits of `command_limits.py`: a quadratic programme.

The inverse is a quadratic programme in the change δ of the carriages' heights u at the knots

    minimise ½ δᵀ H δ − gᵀ δ    subject to    |D u / S + o| ≤ v,   |D² u / S² + c| ≤ a,   low ≤ u ≤ high − m

D u / S is the mean velocity of a segment. What the two ends of a segment have beyond it (o, from both c) and how far
its highest point lies above both ends (m) changes little with δ: both are the present command's. Rows are divided by
their limit.

Before the solver sees it, the problem is brought to order one: every unknown is measured by its own curvature, rows and
objective by their largest coefficient. That matters more than which solver it is; the tests compare with another one.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from ffcomp.errors import SolverError
from ffcomp.inverse.command_limits import TOLERANCE, CommandLimits
from models.arrays import FloatArray
from models.kinematics.base import Compiled

SOLVER_TOLERANCE = 1e-5  # of scaled numbers
SMALLEST_SIZE = 1e-12  # of an empty programme
MARGIN = 2e-3  # distance to the limits, for changes of o, c and m and for the solver's accuracy


def constrained_step(
    hessian: FloatArray,
    gradient: FloatArray,
    command: FloatArray,
    plan: FloatArray,
    limits: CommandLimits,
    kinematics: Compiled,
) -> FloatArray:
    """Find the best change of the unknown knots that keeps the limits.

    Where the plan itself is well beyond a limit, its own demand is the limit there: following it is always possible.

    Parameters
    ----------
    hessian : (3 n, 3 n);  gradient : (3 n,), of the unknown knots, carriages A B C inside
    command : (n + 4, 3) mm, carriage heights as they stand, with two given knots on either side
    plan : (n + 4, 3) mm, the path's own command

    Returns
    -------
    (3 n,) mm

    Raises
    ------
    SolverError
        When the given knots on both sides leave no room for a solution.
    """
    return solve_qp(hessian, -gradient, *_Rows(command, plan, limits, kinematics).bounded())


class _Rows:
    """Rows of the programme that touch an unknown knot, each divided by its limit."""

    def __init__(self, command: FloatArray, plan: FloatArray, limits: CommandLimits, kinematics: Compiled) -> None:
        self._limits, self._command = limits, command
        self._now, self._plan = (limits.demand(kinematics.forward(each)) for each in (command, plan))

    def bounded(self) -> tuple[sparse.csc_matrix, FloatArray, FloatArray]:
        """Return the rows A and their bounds: low ≤ A δ ≤ high."""
        parts = [self._velocity(), self._acceleration()]
        if np.isfinite(self._limits.travel_mm).any():
            parts.append(self._travel())
        blocks, lows, highs = zip(*parts, strict=True)
        return sparse.csc_matrix(sparse.vstack(blocks)), np.concatenate(lows).ravel(), np.concatenate(highs).ravel()

    def _velocity(self) -> tuple[sparse.csr_matrix, FloatArray, FloatArray]:
        # the first and the last segment lie between given knots
        now, plan = self._now.velocity[1:-1], self._plan.velocity[1:-1]
        return self._between(1, now, plan, self._limits.velocity_mm_per_s)

    def _acceleration(self) -> tuple[sparse.csr_matrix, FloatArray, FloatArray]:
        now, plan = (demand.acceleration(self._limits.segment_s) for demand in (self._now, self._plan))
        return self._between(2, now, plan, np.full(3, self._limits.acceleration_mm_per_s2))

    def _between(
        self, order: int, now: FloatArray, plan: FloatArray, limit: FloatArray
    ) -> tuple[sparse.csr_matrix, FloatArray, FloatArray]:
        """now, plan (rows, 3, 2): demand at both ends of a range, allowed within ± the ceiling."""
        planned = np.abs(plan).max(axis=2)
        ceiling = np.maximum((1.0 - MARGIN) * limit, np.where(planned > TOLERANCE * limit, planned, 0.0))
        n = len(self._command) - 4
        stencil = np.diff(np.eye(n + 4), order, axis=0)
        touched = stencil[np.any(stencil[:, 2:-2] != 0.0, axis=1), 2:-2]
        motors = self._limits.motors / limit[:, None]
        scaled = sparse.csr_matrix(sparse.kron(touched / self._limits.segment_s**order, motors))
        return scaled, (-ceiling - now.min(axis=2)) / limit, (ceiling - now.max(axis=2)) / limit

    def _travel(self) -> tuple[sparse.csr_matrix, FloatArray, FloatArray]:
        """Heights in units of a millimetre."""
        low, high = self._limits.travel_mm
        every = self._command @ self._limits.motors.T
        heights, ends = every[2:-2], np.maximum(every[:-1], every[1:])
        above = self._now.height[..., 1] - ends
        beside = np.maximum(above[1:-2], above[2:-1])
        planned = self._plan.height[1:-1]
        floor = np.minimum(low + 1e-3, np.minimum(planned[:-1, :, 0], planned[1:, :, 0]))
        ceiling = np.maximum(high - 1e-3, np.maximum(planned[:-1, :, 1], planned[1:, :, 1]))
        matrix = sparse.csr_matrix(sparse.kron(sparse.eye(len(heights)), self._limits.motors))
        return matrix, floor - heights, ceiling - beside - heights


def solve_qp(p: FloatArray, q: FloatArray, a: sparse.csc_matrix, low: FloatArray, high: FloatArray) -> FloatArray:
    """Minimise ½ xᵀ P x + qᵀ x subject to low ≤ A x ≤ high, for x (n,).

    p (n, n) is positive definite, a (m, n), low ≤ high (m,), infinite where there is none.

    Raises
    ------
    SolverError
        When the solver ends in any other way than with the answer.
    """
    import osqp  # slow to import, and few sections exceed a limit

    unknown = 1.0 / np.sqrt(np.diag(p))
    columns = a.multiply(unknown[None, :]).tocsr()
    row = 1.0 / np.maximum(abs(columns).max(axis=1).toarray().ravel(), np.finfo(float).tiny)
    scaled_q = q * unknown
    low, high = low * row, high * row
    # x = size · unknown · y: how far the free answer lies, or how far x = 0 is from being allowed
    size = float(np.concatenate([np.abs(scaled_q), low, -high, [SMALLEST_SIZE]]).max())
    solver = osqp.OSQP()
    solver.setup(
        sparse.csc_matrix(np.triu(p * np.outer(unknown, unknown))),
        scaled_q / size,
        sparse.csc_matrix(columns.multiply(row[:, None])),
        low / size,
        high / size,
        verbose=False,
        eps_abs=SOLVER_TOLERANCE,
        eps_rel=SOLVER_TOLERANCE,
        max_iter=20_000,
        polishing=False,
    )
    result = solver.solve(raise_error=False)
    if result.info.status != "solved":
        what = f"{len(q)} unknowns and {len(low)} rows"
        raise SolverError(f"The quadratic programme of {what} ended in osqp as «{result.info.status}».")
    return np.asarray(result.x * unknown * size)
