"""A window of a section, solved within limits: filtered B-splines on the plant scheduled at every knot.

The basis is what is executed: the firmware executes our G1 segments, so the command is a spline of degree 1 with a
knot at the end of every segment. In error coordinates q_d = q* + N γ (q*: the reference carriage path, N: the hats of
the spline), a window minimises

    ‖ e₀ − Φ γ ‖² + ρ ‖ D² γ ‖²                                 Φ = J G N: the basis filtered through the plant

under the limits of `command_limits.py`. e₀ is the nozzle's error with γ = 0 from the state at the window's first knot;
D² γ S⁻² is the acceleration beyond the plan's. Then the actual segments are executed through the plant (ramps,
chords, J̇ q̇), and the same problem is solved for the remaining error. γ is zero at both ends of a section.

Duan, Yoon & Okwudire, A limited-preview filtered B-spline approach to tracking control, Mechatronics 56 (2018) 287-296.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ffcomp.inverse.gains import segment_response
from ffcomp.inverse.model import Iterate, KnotWindow
from models.arrays import FloatArray


@dataclass(frozen=True, slots=True)
class ConstrainedWindow:
    """A window with an active limit."""

    first: int  # knots of the section
    last: int
    error_mm: float  # how far the nozzle is from the path at the worst, by the design model


class WindowProblem:
    """A least-squares problem: `unknowns` knots after `at`; errors count up to `end`, results up to `commit_end`."""

    def __init__(
        self,
        iterate: Iterate,
        at: int,
        state: FloatArray,
        commit_end: int,
        unknowns: int,
        end: int,
    ) -> None:
        self.iterate, self.at, self.state = iterate, at, state
        self.commit_end, self.unknowns = commit_end, unknowns
        self.stretch = KnotWindow(iterate, at, end)
        self._left_mm = 0.0

    def held(self) -> ConstrainedWindow:
        """Return the committed part."""
        return ConstrainedWindow(self.at, self.commit_end, self._left_mm)

    def solve(self) -> tuple[FloatArray, FloatArray]:
        """Set the iterate's γ for this window; return the committed response (mm) and the state at its end."""
        iterate, s, stretch = self.iterate, self.iterate.model.settings, self.stretch
        response, states = stretch.respond(self.state)
        if self.unknowns > 0:
            control_weight = _second_differences(self.unknowns) * np.sqrt(iterate.model.control_weight)
            matrix = np.concatenate([self.phi(), control_weight])
            for _ in range(1 + s.corrections):
                left = np.concatenate([stretch.error(response).ravel(), -self._weighted_bends().ravel()])
                step = self.step(matrix, left)
                iterate.gamma[self.at + 1 : self.at + 1 + self.unknowns] += step.reshape(-1, 3)
                response, states = stretch.respond(self.state)
        kept = self.commit_end - self.at
        shown = min(self.stretch.end, iterate.last) - self.at
        iterate.vertices[self.at : self.at + shown + 1] = stretch.vertices()[: shown + 1]
        self._left_mm = float(np.sqrt((stretch.error(response)[: kept * s.rows_per_segment] ** 2).sum(axis=1)).max())
        return response[: kept * s.substeps], states[kept]

    def phi(self) -> FloatArray:
        """Φ (rows, 3 unknowns) with the models at the places of its intervals; of γ the knot `at` is given."""
        columns, end = 3 * self.unknowns, self.stretch.end - self.at
        after, seen = segment_response(
            *self.iterate.model.plant_at(self.stretch.place), self.iterate.model.settings.rows_per_segment
        )
        hats = np.zeros((end + 1, 3, columns))
        hats[1 : self.unknowns + 1] = np.eye(columns).reshape(-1, 3, columns)
        state, phi = np.zeros((after.shape[1], columns)), []
        for k in range(end):
            known = np.concatenate([state, hats[k], hats[k + 1]])
            state, nozzle = after[k] @ known, seen[k] @ known
            phi.append(nozzle)
        return np.concatenate(phi)

    def step(self, matrix: FloatArray, left: FloatArray) -> FloatArray:
        """Return the change of γ, (3 unknowns,), that minimises ‖ left − matrix · change ‖ within the limits."""
        from ffcomp.inverse.qp import constrained_step  # its solver is imported where a limit is exceeded only

        model, (command, plan) = self.iterate.model, self.around()
        return constrained_step(matrix.T @ matrix, matrix.T @ left, command, plan, model.limits, model.kinematics)

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


@lru_cache(maxsize=8)
def _second_differences(unknowns: int) -> FloatArray:
    """D² of `unknowns` knots of three carriages, with given knots on both sides."""
    d = np.diff(np.eye(unknowns + 4), 2, axis=0)[:, 2:-2]
    return np.asarray(np.kron(d, np.eye(3)), dtype=np.float64)
