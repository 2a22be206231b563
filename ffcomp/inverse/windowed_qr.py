"""The exact inverse, window by window: filtered B-splines on the plant scheduled at every knot. The reference.

The basis is what is executed: the firmware executes our G1 segments, so the command is a spline of degree 1 with a
knot at the end of every segment. One section (from rest to rest) is solved in windows; the state is carried from each
to the next.

In error coordinates q_d = q* + N γ (q*: the reference carriage path, N: the hats of the spline), each window minimises

    ‖ e₀ − Φ γ ‖² + ρ ‖ D² γ ‖²                                 Φ = J G N: the basis filtered through the plant

by QR. e₀ is the nozzle's error with γ = 0 from the carried state; D² γ S⁻² is the acceleration asked for beyond the
plan's. Then the very segments are executed through the plant (ramps, chords, J̇ q̇) and the same factors remove what
error is left. γ is zero at both ends of a section: rest stays rest, and hand-over is exact.

Duan, Yoon & Okwudire, A limited-preview filtered B-spline approach to tracking control, Mechatronics 56 (2018) 287-296.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from ffcomp.inverse.model import Iterate, KnotWindow
from ffcomp.inverse.riccati import basis_response
from models.arrays import FloatArray
from models.vibration.scheduled import interpolate, models_along


@dataclass(frozen=True, slots=True)
class ConstrainedWindow:
    """A window in which a limit is active."""

    first: int  # knots of the section
    last: int
    error_mm: float  # how far the nozzle is from the path at the worst, by the design model


def solve(iterate: Iterate, state: FloatArray) -> tuple[FloatArray, FloatArray, int, list[ConstrainedWindow]]:
    """Solve all windows of a section, from the plant's state (18,) at its first knot.

    Returns
    -------
    the nozzle's response (n·substeps, 3) mm, the state (18,) at the end, windows solved, those with a limit
    """
    responses, held, windows, at = [np.empty((0, 3))], [], 0, 0
    while at < iterate.last:
        window = next_window(iterate, at, state)
        response, state = window.solve()
        responses.append(response)
        if window.limited:
            held.append(window.held())
        windows, at = windows + 1, window.commit_end
    return np.concatenate(responses), state, windows, held


def next_window(iterate: Iterate, at: int, state: FloatArray) -> WindowProblem:
    """Return the window after the knot `at`: what is kept of it, and the preview."""
    s = iterate.model.settings
    commit_end = min(at + s.commit, iterate.last)
    if iterate.last - commit_end < s.preview // 2:
        commit_end = iterate.last  # a short remainder joins this window
    end = min(commit_end + s.preview, iterate.n)
    return WindowProblem(iterate, at, state, commit_end, min(end, iterate.last - 1) - at, end)


class WindowProblem:
    """One least-squares problem: `unknowns` knots after `at`, for the error up to `end`, kept up to `commit_end`."""

    def __init__(
        self,
        iterate: Iterate,
        at: int,
        state: FloatArray,
        commit_end: int,
        unknowns: int,
        end: int,
        limited: bool = False,
    ) -> None:
        self.iterate, self.at, self.state = iterate, at, state
        self.limited = limited  # the answer without limits is known to exceed them, or was found to
        self.commit_end, self.unknowns = commit_end, unknowns
        self.stretch = KnotWindow(iterate, at, end)
        self._left_mm = 0.0

    def held(self) -> ConstrainedWindow:
        """Record the part that is kept, as it was solved."""
        return ConstrainedWindow(self.at, self.commit_end, self._left_mm)

    def solve(self) -> tuple[FloatArray, FloatArray]:
        """Set the iterate's γ for this window; return the committed response (mm) and the state at its end."""
        iterate, s, stretch = self.iterate, self.iterate.model.settings, self.stretch
        response, states = stretch.respond(self.state)
        if self.unknowns > 0:
            control_weight = _second_differences(self.unknowns) * np.sqrt(iterate.model.control_weight)
            rows = _Rows(np.concatenate([self.phi(), control_weight]))
            for _ in range(1 + s.corrections):
                self._improve(rows, np.concatenate([stretch.error(response).ravel(), -self._weighted_bends().ravel()]))
                response, states = stretch.respond(self.state)
        kept = self.commit_end - self.at
        shown = min(self.stretch.end, iterate.last) - self.at
        iterate.vertices[self.at : self.at + shown + 1] = stretch.vertices()[: shown + 1]
        self._left_mm = float(np.sqrt((stretch.error(response)[: kept * s.rows_per_segment] ** 2).sum(axis=1)).max())
        return response[: kept * s.substeps], states[kept]

    def phi(self) -> FloatArray:
        """Φ (rows, 3 unknowns) with the models at the places of its intervals."""
        model = self.iterate.model
        table, place = model.row_table, self.stretch.place
        a, b0, b1, _ = models_along(table, place)
        j = interpolate(table.jacobian, table.x0_mm, table.pitch_mm, table.nodes, place)
        return basis_response(a, b0, b1, table.plant.carriage, j, self.unknowns, model.settings.rows_per_segment)

    def _improve(self, rows: _Rows, left: FloatArray) -> None:
        """γ += the least-squares answer to the error that is left, within the limits."""
        model, step = self.iterate.model, np.empty(0)
        command, plan = self.around()
        if not self.limited:
            step = rows.free_answer(left)
            tried = command.copy()
            tried[2:-2] += step.reshape(-1, 3)
            demand = model.limits.demand(model.kinematics.forward(tried[1:-1]))
            self.limited = bool(demand.utilisation(model.limits).max() > 1.0)
        if self.limited:
            from ffcomp.inverse.qp import constrained_step

            step = constrained_step(
                rows.hessian,
                rows.matrix.T @ left,
                command,
                plan,
                model.limits,
                model.kinematics,
            )
        self.iterate.gamma[self.at + 1 : self.at + 1 + self.unknowns] += step.reshape(-1, 3)

    def around(self) -> tuple[FloatArray, FloatArray]:
        """Command and plan at the unknown knots and two on either side, each (unknowns + 4, 3) mm."""
        iterate, knots = self.iterate, np.arange(self.at - 1, self.at + self.unknowns + 3)
        plan = iterate.model.kinematics.inverse(iterate.reference.at_knots(knots))
        return plan + iterate.gamma[np.clip(knots, 0, iterate.n)], plan

    def _weighted_bends(self) -> FloatArray:
        """√ρ D² γ as it stands, (unknowns + 2, 3)."""
        gamma, first = self.iterate.gamma, self.at + 1
        around = np.zeros((self.unknowns + 4, 3))
        low = max(first - 2, 0)
        known = gamma[low : first + self.unknowns + 2]
        around[low - first + 2 : low - first + 2 + len(known)] = known
        return np.asarray(np.sqrt(self.iterate.model.control_weight) * np.diff(around, 2, axis=0))


class _Rows:
    """The rows of a least-squares problem, factorised when that is asked for."""

    def __init__(self, matrix: FloatArray) -> None:
        self.matrix = matrix

    @cached_property
    def _factors(self) -> tuple[FloatArray, FloatArray]:
        q, r = np.linalg.qr(self.matrix)
        return q, r

    @cached_property
    def hessian(self) -> FloatArray:
        return np.asarray(self.matrix.T @ self.matrix)

    def free_answer(self, left: FloatArray) -> FloatArray:
        """Return the x for which the rows come nearest to what is left."""
        from scipy.linalg import solve_triangular  # 0.2 s to import: the fast inverse does without

        q, r = self._factors
        return np.asarray(solve_triangular(r, q.T @ left, check_finite=False))


@lru_cache(maxsize=8)
def _second_differences(unknowns: int) -> FloatArray:
    """D² of `unknowns` knots of three carriages, with given knots on both sides."""
    d = np.diff(np.eye(unknowns + 4), 2, axis=0)[:, 2:-2]
    return np.asarray(np.kron(d, np.eye(3)), dtype=np.float64)
