"""A reference for the inverse: each window's least squares without limits, by QR, with the models of every knot."""

from __future__ import annotations

import numpy as np

from ffcomp.inverse.command_limits import peak_utilisation
from ffcomp.inverse.limited_window import WindowProblem
from ffcomp.inverse.model import InverseModel, Iterate
from ffcomp.inverse.reference import Reference
from ffcomp.inverse.solve import Solution
from models.arrays import FloatArray


class FreeWindow(WindowProblem):
    """A window without limits."""

    def step(self, matrix: FloatArray, left: FloatArray) -> FloatArray:
        return np.linalg.lstsq(matrix, left, rcond=None)[0]


def next_window(iterate: Iterate, at: int, state: FloatArray, commit: int = 64, preview: int = 24) -> FreeWindow:
    """The window after the knot `at`: `commit` segments that are kept, and `preview` more."""
    commit_end = min(at + commit, iterate.last)
    if iterate.last - commit_end < preview // 2:
        commit_end = iterate.last  # a short remainder joins this window
    end = min(commit_end + preview, iterate.n)
    return FreeWindow(iterate, at, state, commit_end, min(end, iterate.last - 1) - at, end)


def solve_exactly(
    model: InverseModel, reference: Reference, state: FloatArray, commit: int = 64, preview: int = 24
) -> Solution:
    """Solve a section window by window, from the plant's state (18,) at its first knot."""
    iterate, responses, windows, at = Iterate(model, reference), [np.empty((0, 3))], 0, 0
    while at < iterate.last:
        window = next_window(iterate, at, state, commit, preview)
        response, state = window.solve()
        responses.append(response)
        windows, at = windows + 1, window.commit_end
    utilisation = peak_utilisation(iterate.vertices, model.limits)
    return Solution(iterate.vertices, state, np.concatenate(responses), windows, utilisation)
