"""The inverse of one section: the command whose response, by the linear model, is the reference.

The coefficients begin as what a slow motion needs, γ = τ q̇* + C q̈*; segments are executed through the plant
scheduled along the path, with the firmware's ramps; the error that comes out is swept backwards and forwards once, with
the gains of `gains.py`; and again. The gains are those of the nearest node of the
grid, the plant is the one at the very position: what the first sweep misses for that, the second one finds.

The inverse itself knows no limits. A command that exceeds one is replaced by the nearest that does not, and simulated.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ffcomp.inverse.command_limits import utilisation_from_rest
from ffcomp.inverse.gains import REST_ROWS, sweep_back, sweep_forward
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.nearest import nearest_within_limits
from ffcomp.inverse.reference import Reference
from ffcomp.planner.segment_timing import sample_even_segments
from models.arrays import BoolArray, FloatArray

MOST_PASSES = 5
CONVERGENCE_MM = 5e-3  # after so small a change, the next is a tenth of it
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
    demand: FloatArray  # (n + 2, 3, 3), `utilisation_from_rest`
    limited: tuple[LimitedWindow, ...] = ()
    response: FloatArray | None = None  # (n·substeps, 3) mm: of a nonlinear printer's nozzle; None: it is linear

    @property
    def utilisation(self) -> float:
        """The peak demand on a carriage over its limit; up to 1 is allowed."""
        return float(self.demand.max())


def solve(model: InverseModel, reference: Reference, state: FloatArray) -> Solution:
    """Solve one section, without limits.

    model : of the machine
    reference : of the section
    state : (18,) of the plant at the section's first knot
    """
    sweep = Sweep(model, reference)
    sweep.begin()
    for _ in range(MOST_PASSES):
        error, states = sweep.error_from(state)
        change, ringing = sweep.answer(error)
        sweep.gamma += change
        if float(np.abs(change[: sweep.last + 1]).max()) < CONVERGENCE_MM:
            break
    vertices = sweep.command(sweep.gamma)
    return Solution(vertices, states[sweep.last] + ringing, utilisation_from_rest(vertices, model.limits))


def held(model: InverseModel, reference: Reference, state: FloatArray, solution: Solution) -> Solution:
    """Return the nearest command to a solution within the limits, and where it leaves the path."""
    if solution.limited or not solution.utilisation > 1.0:
        return solution
    sweep = Sweep(model, reference)
    path = sweep.path[: sweep.last + 1]
    vertices = nearest_within_limits(solution.vertices, path, model.limits, model.kinematics)
    moved = np.abs(vertices - solution.vertices).max(axis=1) > MOVED_MM
    sweep.take(vertices)
    error, states = sweep.error_from(state)
    farthest = np.sqrt((error**2).sum(axis=1)).reshape(sweep.n, -1).max(axis=1)
    limited = tuple(_windows(moved[:-1] | moved[1:], farthest[: sweep.last]))
    return Solution(vertices, states[sweep.last], utilisation_from_rest(vertices, model.limits), limited)


def _windows(moved: BoolArray, error: FloatArray) -> Iterator[LimitedWindow]:
    """Yield the parts of moved segments (n,) with the error in them; error : (n,) mm."""
    segments = np.flatnonzero(moved)
    for part in np.split(segments, np.flatnonzero(np.diff(segments) > AFFECTED) + 1):
        if len(part):
            yield LimitedWindow(int(part[0]), int(part[-1]), float(error[part[0] : part[-1] + AFFECTED].max()))


class Sweep:
    """The preview sweep over one section: from what is left of the reference to the command that answers it.

    γ (n + 1, 3) mm are the coefficients at the section's knots and those in sight after its end.
    """

    def __init__(self, model: InverseModel, reference: Reference) -> None:
        s, kinematics = model.settings, model.kinematics
        self.model, self.reference = model, reference
        self.last = reference.knots  # the knot where the command comes to rest
        self.n = self.last + REST_ROWS
        self.gamma = np.zeros((self.n + 1, 3))
        nozzle, velocity = reference.substeps(self.n)
        # at the knots: of long sections the steps between are not kept
        self.path, self._velocity = nozzle[:: s.substeps].copy(), velocity[:: s.substeps].copy()
        self.path_q = kinematics.inverse(self.path)
        self.place = model.places(nozzle)
        self._centripetal = kinematics.rate_term(nozzle, np.ascontiguousarray(velocity))
        self._extrusion = np.concatenate([np.diff(reference.extrusion()), np.zeros(REST_ROWS)])
        self._stride = s.substeps // s.rows_per_segment
        known = reference.robust_offset
        self.robust_offset = model.robust_offsets([reference])[0] if known is None else known  # (rows, 3) mm; or empty
        self._due = nozzle[self._stride :: self._stride].copy()  # at the rows that are weighed
        self._due[: len(self.robust_offset)] += self.robust_offset
        self._node, self._steady, self._ending = model.gains.along(self.place)

    def command(self, gamma: FloatArray) -> FloatArray:
        """Return the nozzle's command (last + 1, 3) mm by some coefficients."""
        return self.model.kinematics.forward(self.path_q[: self.last + 1] + gamma[: self.last + 1])

    def take(self, vertices: FloatArray) -> None:
        """Set the coefficients to those of a command (last + 1, 3) mm."""
        self.gamma[: self.last + 1] = self.model.kinematics.inverse(vertices) - self.path_q[: self.last + 1]

    def error_from(self, state: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the error (rows, 3) mm by the plant, and the states at the knots, from a state (18,) at the first."""
        model, s = self.model, self.model.settings
        vertices = model.kinematics.forward(self.path_q + self.gamma)
        executed = sample_even_segments(vertices, self._extrusion, s.segment_s, s.output, s.substeps)
        command = model.kinematics.inverse(executed)
        q, states = model.plant.play(self.place, self._centripetal, command, state, s.substeps)
        rows = np.ascontiguousarray(q[self._stride - 1 :: self._stride])
        return self._due - model.kinematics.forward(rows), states

    def answer(self, residual: FloatArray, gamma: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
        """Return the change of γ (n + 1, 3) mm that answers a residual, and the plant's state by it at the last knot.

        residual : (rows, 3) mm, the reference less the nozzle at the rows of all segments
        gamma : (n + 1, 3) mm, the coefficients that leave it; None: those of the sweep
        """
        rows = np.ascontiguousarray(residual).reshape(self.n, -1)
        known = np.concatenate([np.zeros((1, 3)), self.gamma if gamma is None else gamma])
        psi = sweep_back(self._steady.backward, self._ending.backward, self._node, rows, known)
        change, state = sweep_forward(self._steady.forward, self._ending.forward, self._node, psi, self.last)
        return np.concatenate([np.zeros((1, 3)), change]), state[: self.model.plant.table.plant.a.shape[1]]

    def begin(self) -> None:
        """Begin with the coefficients of a slow motion, γ = τ q̇* + C q̈*; q̈* is taken over two knots, for less noise."""
        if self.last > 1:
            model, path = self.model, self.path[1 : self.last]
            ahead = model.kinematics.inverse(path + self._velocity[1 : self.last] * model.delay_s)
            now, after, before = self.path_q[1 : self.last], self.path_q[3 : self.last + 2], np.empty_like(ahead)
            before[0], before[1:] = self.path_q[0], self.path_q[: self.last - 2]  # it rests before the first knot
            bend = (after - 2.0 * now + before) / (2.0 * model.settings.segment_s) ** 2
            self.gamma[1 : self.last] = ahead - now + np.einsum("nij,nj->ni", model.compliance_at(path[:, :2]), bend)
