"""A reference for the inverse: each window's least squares without limits, by QR, with the models of every knot."""

from __future__ import annotations

import numpy as np

from ffcomp.inverse.command_limits import peak_utilisation
from ffcomp.inverse.model import InverseModel, Iterate, KnotWindow
from ffcomp.inverse.reference import Reference
from ffcomp.inverse.solve import Solution
from models.arrays import FloatArray
from models.compiled import kernel
from models.vibration.scheduled import interpolate, models_along


class FreeWindow:
    """`unknowns` knots after `at`; errors count up to `end`, results up to `commit_end`.

    A window minimises ‖ e₀ − Φ γ ‖² + ρ ‖ D² γ ‖². Then the actual segments are executed through the plant (ramps,
    chords, J̇ q̇), and the same problem is solved for the remaining error, `corrections` times.
    """

    def __init__(
        self, iterate: Iterate, at: int, state: FloatArray, commit_end: int, unknowns: int, end: int, corrections: int
    ) -> None:
        self.iterate, self.at, self.state, self.corrections = iterate, at, state, corrections
        self.commit_end, self.unknowns = commit_end, unknowns
        self.stretch = KnotWindow(iterate, at, end)

    def solve(self) -> tuple[FloatArray, FloatArray]:
        """Set the iterate's γ for this window; return the committed response (mm) and the state at its end."""
        iterate, s, stretch = self.iterate, self.iterate.model.settings, self.stretch
        response, states = stretch.respond(self.state)
        if self.unknowns > 0:
            weight = np.sqrt(iterate.model.control_weight)
            bends = np.kron(np.diff(np.eye(self.unknowns + 4), 2, axis=0)[:, 2:-2], np.eye(3))
            matrix = np.concatenate([self.phi(), weight * bends])
            for _ in range(1 + self.corrections):
                left = np.concatenate([stretch.error(response).ravel(), -weight * self._bends().ravel()])
                step = np.linalg.lstsq(matrix, left, rcond=None)[0]
                iterate.gamma[self.at + 1 : self.at + 1 + self.unknowns] += step.reshape(-1, 3)
                response, states = stretch.respond(self.state)
        kept = self.commit_end - self.at
        shown = min(stretch.end, iterate.last) - self.at
        iterate.vertices[self.at : self.at + shown + 1] = stretch.vertices()[: shown + 1]
        return response[: kept * s.substeps], states[kept]

    def phi(self) -> FloatArray:
        """Φ (rows, 3 unknowns) with the models at the places of its intervals."""
        model = self.iterate.model
        table, place = model.row_table, self.stretch.place
        a, b0, b1, _ = models_along(table, place)
        j = interpolate(table.jacobian, table.x0_mm, table.pitch_mm, table.nodes, place)
        return basis_response(a, b0, b1, table.plant.carriage, j, self.unknowns, model.settings.rows_per_segment)

    def _bends(self) -> FloatArray:
        """D² γ as it stands, (unknowns + 2, 3)."""
        gamma, first = self.iterate.gamma, self.at + 1
        around = np.zeros((self.unknowns + 4, 3))
        low = max(first - 2, 0)
        known = gamma[low : first + self.unknowns + 2]
        around[low - first + 2 : low - first + 2 + len(known)] = known
        return np.diff(around, 2, axis=0)


@kernel
def basis_response(
    a: FloatArray,
    b0: FloatArray,
    b1: FloatArray,
    carriage: FloatArray,
    jacobian: FloatArray,
    unknowns: int,
    per_knot: int,
) -> FloatArray:
    """Φ: the nozzle's response to each coefficient of the degree-1 spline, through the scheduled plant.

    a (n, s, s), b0 b1 (n, s, 3): models of the n intervals for steps of S/per_knot.   carriage (3, s): actuators of the
    states.   jacobian (n, 3, 3).
    Unknown coefficient u (0-based) is the hat centred on knot u + 1 of the window; knot 0 is given.
    Returns (3 n per_knot, 3 unknowns) mm per mm: rows by step (X Y Z inside), columns by knot (A B C inside).
    """
    n, states = a.shape[0], a.shape[1]
    columns = 3 * unknowns
    x = np.zeros((columns, states))
    phi, of_states = np.zeros((3 * n * per_knot, columns)), np.ascontiguousarray(carriage.T)
    for k in range(n):
        live = 3 * min(k + 1, unknowns)
        at, t0, t1 = np.ascontiguousarray(a[k].T), b0[k], b1[k]
        for s in range(per_knot):
            x[:live] = np.dot(x[:live], at)
            before, after = s / per_knot, (s + 1) / per_knot
            if k < unknowns:  # the rising half of the hat on knot k + 1
                for c in range(3):
                    for r in range(states):
                        x[3 * k + c, r] += before * t0[r, c] + after * t1[r, c]
            if 0 < k <= unknowns:  # the falling half of the hat on knot k
                for c in range(3):
                    for r in range(states):
                        x[3 * k - 3 + c, r] += (1 - before) * t0[r, c] + (1 - after) * t1[r, c]
            row = 3 * (k * per_knot + s)
            q = np.dot(x[:live], of_states)
            for i in range(3):
                for col in range(live):
                    phi[row + i, col] = (
                        jacobian[k, i, 0] * q[col, 0] + jacobian[k, i, 1] * q[col, 1] + jacobian[k, i, 2] * q[col, 2]
                    )
    return phi


def next_window(
    iterate: Iterate, at: int, state: FloatArray, commit: int = 64, preview: int = 24, corrections: int = 1
) -> FreeWindow:
    """The window after the knot `at`: `commit` segments that are kept, and `preview` more."""
    commit_end = min(at + commit, iterate.last)
    if iterate.last - commit_end < preview // 2:
        commit_end = iterate.last  # a short remainder joins this window
    end = min(commit_end + preview, iterate.n)
    return FreeWindow(iterate, at, state, commit_end, min(end, iterate.last - 1) - at, end, corrections)


def solve_exactly(
    model: InverseModel,
    reference: Reference,
    state: FloatArray,
    commit: int = 64,
    preview: int = 24,
    corrections: int = 1,
) -> Solution:
    """Solve a section window by window, from the plant's state (18,) at its first knot."""
    iterate, responses, windows, at = Iterate(model, reference), [np.empty((0, 3))], 0, 0
    while at < iterate.last:
        window = next_window(iterate, at, state, commit, preview, corrections)
        response, state = window.solve()
        responses.append(response)
        windows, at = windows + 1, window.commit_end
    utilisation = peak_utilisation(iterate.vertices, model.limits)
    return Solution(iterate.vertices, state, np.concatenate(responses), windows, utilisation)
