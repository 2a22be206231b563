"""The preview inverse of a section: the gains of `riccati.py`, corrected by the scheduled plant's response.

A section is solved in windows. The coefficients begin as what a slow motion needs, γ = τ q̇* + C q̈*; segments are
executed through the plant scheduled along the path, with the firmware's ramps; the error that comes out is swept
backwards and forwards once; and again. The gains are those of the nearest node of the grid, the plant is the one at the
very position: what the first sweep misses for that, the second one finds.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ffcomp.inverse.model import Iterate, KnotWindow
from ffcomp.inverse.riccati import REST_ROWS, TO_THE_END, Gains, PreviewGains, no_gains, sweep_back, sweep_forward
from models.arrays import FloatArray
from models.compiled import kernel

STRETCH = 512  # knots solved at a time
MOST_PASSES = 5
CONVERGENCE_MM = 5e-3  # after so small a change, the next is a tenth of it
PREVIEW_KNOTS = 32  # knots of preview: later errors affect the command by a hundred-thousandth


def solve(iterate: Iterate, state: FloatArray, keep_response: bool) -> tuple[FloatArray, FloatArray, int]:
    """Find all coefficients of a section, from the plant's state (18,) at its first knot.

    Returns
    -------
    the nozzle's response (n·substeps, 3) mm, empty if not requested; the state (18,) at the end; windows solved
    """
    responses, at, stretches = [np.empty((0, 3))], 0, 0
    while at < iterate.last:
        stop = at + STRETCH if iterate.last - at > STRETCH + PREVIEW_KNOTS else iterate.last
        part = _Part(iterate, at, stop)
        response, state = part.solve(state, keep_response)
        responses.append(response)
        at, stretches = stop, stretches + 1
    return np.concatenate(responses), state, stretches


class _Part:
    """The knots at+1 … stop of a section, with those in sight."""

    def __init__(self, iterate: Iterate, at: int, stop: int, begin: bool = True) -> None:
        self.iterate, self.at, self.stop = iterate, at, stop
        whole = stop == iterate.last
        self.stretch = KnotWindow(iterate, at, stop + (REST_ROWS if whole else PREVIEW_KNOTS))
        gains = iterate.model.gains
        self.node, self.steady = gains.at(self.stretch.place)
        self.ending = _to_rest(gains, self.node, len(self.steady.backward)) if whole else no_gains(gains.size)
        if begin:
            self._begin()

    def _begin(self) -> None:
        """Begin with what a slow motion needs, γ = τ q̇* + C q̈*, where nothing is known yet."""
        iterate, stretch = self.iterate, self.stretch
        last = min(stretch.end, iterate.last - 1)
        n = last - self.at
        if n > 0:
            s = iterate.model.settings
            knots = slice(s.substeps, (n + 1) * s.substeps, s.substeps)
            ahead = stretch.nozzle[knots] + stretch.velocity[knots] * iterate.model.delay_s
            edges = iterate.reference.at_knots(np.array([self.at - 1, stretch.end + 1, stretch.end + 2]))
            q_edges, q_ahead = iterate.model.kinematics.inverse(edges), iterate.model.kinematics.inverse(ahead)
            compliance = iterate.model.compliance_at(stretch.nozzle[knots, :2])
            gamma = iterate.gamma[self.at + 1 : last + 1]
            _slow_motion(q_edges, stretch.reference_q, q_ahead, compliance, 2 * s.segment_s, gamma)

    def solve(self, state: FloatArray, keep_response: bool) -> tuple[FloatArray, FloatArray]:
        iterate, s, kept = self.iterate, self.iterate.model.settings, self.stop - self.at
        for _ in range(MOST_PASSES):
            error, states = self.stretch.error_from(state)
            answer, change = self.improve(error)
            if change < CONVERGENCE_MM:
                break
        iterate.vertices[self.at : self.stop + 1] = self.stretch.vertices()[: kept + 1]
        after = states[kept] + answer  # the same with and without a response: not a digit may depend on a prediction
        if keep_response:
            return self.stretch.respond(state)[0][: kept * s.substeps], after
        return np.empty((0, 3)), after

    def improve(self, error: FloatArray) -> tuple[FloatArray, float]:
        """Add to γ the answer to the error (rows, 3) mm that is left.

        Returns
        -------
        what the plant makes of the change, (18,), at the last knot that is kept; the largest change of what is kept, mm
        """
        stretch, steady, ending, kept = self.stretch, self.steady, self.ending, self.stop - self.at
        gamma = self.iterate.gamma[stretch.at : stretch.end + 1]
        before = self.iterate.gamma[stretch.at - 1 : stretch.at] if stretch.at else np.zeros((1, 3))
        rows = error.reshape(stretch.end - stretch.at, -1)
        psi = sweep_back(steady.backward, ending.backward, self.node, rows, np.concatenate([before, gamma]))
        change, answer = sweep_forward(steady.forward, ending.forward, self.node, psi, kept)
        gamma[1:] += change
        return answer[: self.iterate.model.plant.table.plant.a.shape[1]], float(np.abs(change[:kept]).max())


@kernel
def _slow_motion(
    edges: FloatArray, q: FloatArray, ahead: FloatArray, compliance: FloatArray, two_knots_s: float, gamma: FloatArray
) -> None:
    """Write γ (n, 3) mm of a slow motion, in place; q̈ is taken over two knots, for less noise.

    edges : (3, 3) mm, actuators a knot before q and one and two after its last;  q : (m, 3) mm, of the window
    ahead : (n, 3) mm, actuators one delay later;  compliance : (n, 3, 3) s²
    """
    m = len(q)
    bend = np.empty(3)
    for k in range(len(gamma)):
        for i in range(3):
            before = edges[0, i] if k == 0 else q[k - 1, i]
            after = q[k + 3, i] if k + 3 < m else edges[k + 4 - m, i]
            bend[i] = (after - 2 * q[k + 1, i] + before) / two_knots_s**2
        for i in range(3):
            bent = 0.0
            for j in range(3):
                bent += compliance[k, i, j] * bend[j]
            gamma[k, i] = ahead[k, i] - q[k + 1, i] + bent


def _to_rest(gains: PreviewGains, node: NDArray[np.int64], steady: int) -> Gains:
    """Return the gains before the section's end, to which `node` (n,) then points, counted after the steady ones."""
    affected = TO_THE_END + REST_ROWS
    n = min(affected, len(node))
    ending = gains.end(int(node[-1]))
    node[len(node) - n :] = steady + np.arange(affected - n, affected)
    return ending


def answer(iterate: Iterate, gamma: FloatArray, error: FloatArray) -> FloatArray:
    """Return the change of a command γ (n + 1, 3) mm of a whole section that leaves an error.

    error : (rows, 3) mm, of the section and `REST_ROWS` knots after it
    """
    iterate.gamma[:] = gamma
    _Part(iterate, 0, iterate.last, begin=False).improve(np.ascontiguousarray(error))
    return iterate.gamma - gamma
