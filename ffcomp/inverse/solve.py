"""The inverse of one section: the command whose response, by the linear model, is the reference.

A section is solved in stretches. The coefficients begin as what a slow motion needs, γ = τ q̇* + C q̈*; segments are
executed through the plant scheduled along the path, with the firmware's ramps; the error that comes out is swept
backwards and forwards once, with the gains of `gains.py`; and again. The gains are those of the nearest node of the
grid, the plant is the one at the very position: what the first sweep misses for that, the second one finds.

The inverse itself knows no limits. A command that exceeds one is replaced by the nearest that does not, and simulated.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ffcomp.inverse.command_limits import utilisation_from_rest
from ffcomp.inverse.gains import REST_ROWS, TO_THE_END, Gains, PreviewGains, no_gains, sweep_back, sweep_forward
from ffcomp.inverse.model import InverseModel, Iterate, KnotWindow
from ffcomp.inverse.nearest import nearest_within_limits
from ffcomp.inverse.reference import Reference
from models.arrays import BoolArray, FloatArray
from models.compiled import kernel

STRETCH = 512  # knots solved at a time
MOST_PASSES = 5
CONVERGENCE_MM = 5e-3  # after so small a change, the next is a tenth of it
PREVIEW_KNOTS = 32  # knots of preview: later errors affect the command by a hundred-thousandth
MOVED_MM = 1e-6  # farther is changed
AFFECTED = 32  # knots after a change whose errors are its own


@dataclass(frozen=True, slots=True)
class LimitedWindow:
    """A part of a section with an active limit."""

    first: int  # knots of the section
    last: int
    error_mm: float  # how far the nozzle is from the path at the worst, by the design model


@dataclass(frozen=True, slots=True)
class Solution:
    """The command of one section."""

    vertices: FloatArray  # (n + 1, 3) mm: the nozzle command at the knots
    state: FloatArray  # (18,): of the plant at the last knot
    windows: int  # solved
    demand: FloatArray  # (n + 2, 3, 3), `utilisation_from_rest`
    limited: tuple[LimitedWindow, ...] = ()
    response: FloatArray | None = None  # (n·substeps, 3) mm: of a nonlinear printer's nozzle; None: it is linear

    @property
    def utilisation(self) -> float:
        """The peak demand on a carriage over its limit; up to 1 is allowed."""
        return float(self.demand.max())


def solve(
    model: InverseModel,
    reference: Reference,
    state: FloatArray,
    *,
    enforce_limits: bool = True,
) -> Solution:
    """Solve one section.

    Parameters
    ----------
    model : of the machine
    reference : of the section
    state : (18,) of the plant at the section's first knot
    enforce_limits : False leaves a command above a limit unchanged
    """
    iterate, begin, limited = Iterate(model, reference), state, tuple[LimitedWindow, ...]()
    at = windows = 0
    while at < iterate.last:
        stop = at + STRETCH if iterate.last - at > STRETCH + PREVIEW_KNOTS else iterate.last
        state = _solve_stretch(Sweep(iterate, at, stop), state)
        at, windows = stop, windows + 1
    demand = utilisation_from_rest(iterate.vertices, model.limits)
    if enforce_limits and demand.max() > 1.0:
        moved = _limit(iterate)
        error, states = KnotWindow(iterate, 0, iterate.last).error_from(begin)
        farthest = np.sqrt((error**2).sum(axis=1)).reshape(iterate.last, -1).max(axis=1)
        limited, state = tuple(_windows(moved, farthest)), states[-1]
        demand = utilisation_from_rest(iterate.vertices, model.limits)
    return Solution(iterate.vertices, state, windows, demand, limited)


def _limit(iterate: Iterate) -> BoolArray:
    """Take the nearest command within the limits; return which segments (n,) end at knots that it moves."""
    model, free = iterate.model, iterate.command(iterate.gamma)
    path = iterate.reference.at_knots(np.arange(iterate.last + 1))
    iterate.vertices[:] = nearest_within_limits(free, path, model.limits, model.kinematics)
    iterate.take(iterate.vertices)
    moved = np.abs(iterate.vertices - free).max(axis=1) > MOVED_MM
    return np.asarray(moved[:-1] | moved[1:])


def _windows(moved: BoolArray, error: FloatArray) -> Iterator[LimitedWindow]:
    """Yield the parts of moved segments (n,) with the error in them; error : (n,) mm."""
    segments = np.flatnonzero(moved)
    for part in np.split(segments, np.flatnonzero(np.diff(segments) > AFFECTED) + 1):
        if len(part):
            yield LimitedWindow(int(part[0]), int(part[-1]), float(error[part[0] : part[-1] + AFFECTED].max()))


class Sweep:
    """The preview sweep over the knots at+1 … stop of a section, with the knots in sight after them."""

    def __init__(self, iterate: Iterate, at: int, stop: int) -> None:
        self.iterate, self.at, self.stop = iterate, at, stop
        whole = stop == iterate.last
        self.window = KnotWindow(iterate, at, stop + (REST_ROWS if whole else PREVIEW_KNOTS))
        gains = iterate.model.gains
        self._node, self._steady = gains.at(self.window.place)
        self._ending = _to_rest(gains, self._node, len(self._steady.backward)) if whole else no_gains(gains.size)

    def answer(self, residual: FloatArray, gamma: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the change of the command that answers a residual.

        Parameters
        ----------
        residual : (rows, 3) mm, the reference less the nozzle at the rows of the window's segments
        gamma : (n + 1, 3) mm, the section's coefficients that leave it

        Returns
        -------
        the change of γ (knots, 3) mm from the knot at+1 on; the plant's response to it, (18,), at the knot `stop`
        """
        window, kept = self.window, self.stop - self.at
        before = gamma[window.at - 1 : window.at] if window.at else np.zeros((1, 3))
        rows = residual.reshape(window.end - window.at, -1)
        known = np.concatenate([before, gamma[window.at : window.end + 1]])
        psi = sweep_back(self._steady.backward, self._ending.backward, self._node, rows, known)
        change, state = sweep_forward(self._steady.forward, self._ending.forward, self._node, psi, kept)
        return change, state[: self.iterate.model.plant.table.plant.a.shape[1]]


def answer(iterate: Iterate, gamma: FloatArray, residual: FloatArray) -> FloatArray:
    """Return the change (n + 1, 3) mm of a whole section's coefficients (n + 1, 3) mm that answers a residual.

    residual : (rows, 3) mm, of the section and `REST_ROWS` knots after it
    """
    change, out = Sweep(iterate, 0, iterate.last).answer(np.ascontiguousarray(residual), gamma)[0], np.zeros_like(gamma)
    out[1 : len(change) + 1] = change
    return out


def _solve_stretch(sweep: Sweep, state: FloatArray) -> FloatArray:
    """Find the coefficients of a stretch from the plant's state (18,); return the state at its end."""
    iterate, window, kept = sweep.iterate, sweep.window, sweep.stop - sweep.at
    _begin(sweep)
    gamma = iterate.gamma[window.at + 1 : window.end + 1]
    for _ in range(MOST_PASSES):
        error, states = window.error_from(state)
        change, answer = sweep.answer(error, iterate.gamma)
        gamma += change
        if float(np.abs(change[:kept]).max()) < CONVERGENCE_MM:
            break
    iterate.vertices[sweep.at : sweep.stop + 1] = window.vertices()[: kept + 1]
    return states[kept] + answer


def _begin(sweep: Sweep) -> None:
    """Begin with the coefficients of a slow motion, γ = τ q̇* + C q̈*, where none are known yet."""
    iterate, window = sweep.iterate, sweep.window
    last = min(window.end, iterate.last - 1)
    n = last - sweep.at
    if n > 0:
        s = iterate.model.settings
        knots = slice(s.substeps, (n + 1) * s.substeps, s.substeps)
        ahead = window.nozzle[knots] + window.velocity[knots] * iterate.model.delay_s
        edges = iterate.reference.at_knots(np.array([sweep.at - 1, window.end + 1, window.end + 2]))
        q_edges, q_ahead = iterate.model.kinematics.inverse(edges), iterate.model.kinematics.inverse(ahead)
        compliance = iterate.model.compliance_at(window.nozzle[knots, :2])
        gamma = iterate.gamma[sweep.at + 1 : last + 1]
        _slow_motion(q_edges, window.reference_q, q_ahead, compliance, 2 * s.segment_s, gamma)


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
