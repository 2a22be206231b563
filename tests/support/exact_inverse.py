"""A reference for the inverse: the least squares of windows, by QR, with the plant scheduled at every knot.

In error coordinates q_d = q* + N γ (q*: the reference carriage path, N: hats on the knots of the segments), a window
minimises ‖ e₀ − Φ γ ‖² + ρ ‖ D² γ ‖² with Φ = J G N, and e₀ the error with γ = 0. Then the actual segments are executed
through the plant (ramps, chords, J̇ q̇), and the same problem is solved for the remaining error, twice.

Duan, Yoon & Okwudire, A limited-preview filtered B-spline approach to tracking control, Mechatronics 56 (2018) 287-296.
"""

from __future__ import annotations

import numpy as np

from ffcomp.inverse.command_limits import utilisation_from_rest
from ffcomp.inverse.gains import segment_response
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.reference import Reference
from ffcomp.inverse.solve import Solution, Sweep
from models.arrays import FloatArray

CORRECTIONS = 2


def solve_exactly(
    model: InverseModel, reference: Reference, state: FloatArray, commit: int = 64, preview: int = 24
) -> Solution:
    """Solve a section window by window, from the plant's state (18,) at its first knot."""
    sweep, at = Sweep(model, reference), 0
    while at < sweep.last:
        commit_end = min(at + commit, sweep.last)
        if sweep.last - commit_end < preview // 2:
            commit_end = sweep.last  # a short remainder joins this window
        _window(sweep, at, state, min(commit_end + preview, sweep.n))
        at = commit_end
    vertices, (_, states) = sweep.command(sweep.gamma), sweep.error_from(state)
    return Solution(vertices, states[sweep.last], utilisation_from_rest(vertices, model.limits))


def _window(sweep: Sweep, at: int, state: FloatArray, end: int) -> None:
    """Set γ of the knots after `at` by the errors until `end`."""
    s, weight, unknowns = sweep.model.settings, np.sqrt(sweep.model.control_weight), min(end, sweep.last - 1) - at
    if unknowns > 0:
        bends = np.kron(np.diff(np.eye(unknowns + 4), 2, axis=0)[:, 2:-2], np.eye(3))
        matrix = np.concatenate([_phi(sweep.model, sweep.place[at:end], unknowns), weight * bends])
        for _ in range(1 + CORRECTIONS):
            error = sweep.error_from(state)[0][at * s.rows_per_segment : end * s.rows_per_segment]
            around = np.pad(sweep.gamma, ((2, 2), (0, 0)))[at + 1 : at + unknowns + 5]
            left = [error.ravel(), -weight * np.diff(around, 2, axis=0).ravel()]
            step = np.linalg.lstsq(matrix, np.concatenate(left), rcond=None)[0]
            sweep.gamma[at + 1 : at + 1 + unknowns] += step.reshape(-1, 3)


def _phi(model: InverseModel, places: FloatArray, unknowns: int) -> FloatArray:
    """Φ (rows, 3 unknowns) with the models at the places of its intervals; of γ the window's first knot is given."""
    after, seen = segment_response(*model.plant_at(places), model.settings.rows_per_segment)
    hats = np.zeros((len(after) + 1, 3, 3 * unknowns))
    hats[1 : unknowns + 1] = np.eye(3 * unknowns).reshape(-1, 3, 3 * unknowns)
    state, phi = np.zeros((after.shape[1], 3 * unknowns)), []
    for k in range(len(after)):
        known = np.concatenate([state, hats[k], hats[k + 1]])
        state, nozzle = after[k] @ known, seen[k] @ known
        phi.append(nozzle)
    return np.concatenate(phi)
