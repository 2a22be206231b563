"""Cut the planned motion into runs: the nozzle moves from rest to rest, without an extruder-only move or a stop inside.

A run is what is inverted in one go. Between runs the command rests, exactly on the path, and whatever is not ours
(homing, waits, retractions, macros) happens there.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ffcomp.inverse.settings import Settings
from ffcomp.planner.sections import Section
from ffcomp.planner.trajectory import PlannedMotion
from models.arrays import FloatArray


class Reference:
    """The wanted motion of one run on its own knots, S seconds apart; sampled where it is asked for.

    Knot 0 lies before the run begins, for the plant answers late and the command must start before the path; the last
    knot lies after its end. Outside the run the nozzle rests.
    """

    def __init__(
        self, trajectory: PlannedMotion, run: Section, settings: Settings, through: tuple[float, int] | None = None
    ) -> None:
        """through : a time of the plan's clock that must be a knot, and of which number its own must be a multiple"""
        self.t0 = run.begin_t - settings.lead_s  # s on the plan's clock
        if through is not None:
            t, multiple = through
            self.t0 = t - multiple * int(np.ceil((t - self.t0) / settings.segment_s / multiple)) * settings.segment_s
        length = run.end_t - self.t0 + settings.tail_s
        self.knots = int(np.ceil(length / settings.segment_s - 1e-9))  # segments of the run
        self._trajectory, self._run = trajectory, run
        self._segment_s, self._substep_s = settings.segment_s, settings.segment_s / settings.substeps
        self._substeps = settings.substeps

    def substeps(self, first: int, last: int) -> tuple[FloatArray, FloatArray]:
        """Nozzle (m, 3) mm and velocity (m, 3) mm/s at every substep between two knots, both included."""
        count = (last - first) * self._substeps + 1
        t = self.t0 + first * self._segment_s + np.arange(count, dtype=np.float64) * self._substep_s
        return self.nozzle(t), self._velocity(t)

    def nozzle(self, t: FloatArray) -> FloatArray:
        """(m, 3) mm at times (m,) s of the plan's clock."""
        return np.ascontiguousarray(self._position(t)[:, :3])

    def moving(self, t: FloatArray) -> NDArray[np.bool_]:
        """Whether the run is under way at times (m,) s of the plan's clock."""
        return np.asarray((t > self._run.begin_t) & (t < self._run.end_t))

    def at_knots(self, knots: NDArray[np.int64]) -> FloatArray:
        """The nozzle at these knots, (m, 3) mm; there are knots before the first and after the last, at rest."""
        return self.nozzle(self.t0 + knots.astype(np.float64) * self._segment_s)

    def knot_of(self, t: float) -> float:
        """The place of a time of the plan's clock among the knots."""
        return (t - self.t0) / self._segment_s

    def extrusion(self, first: int = 0, last: int | None = None) -> FloatArray:
        """Filament at the knots first … last (all of them), (n,) mm."""
        knots = np.arange(first, (self.knots if last is None else last) + 1, dtype=np.float64)
        return self._position(self.t0 + knots * self._segment_s)[:, 3].copy()

    def _position(self, t: FloatArray) -> FloatArray:
        # at end_t itself the next run may have begun, somewhere else
        last = math.nextafter(self._run.end_t, -math.inf)
        return self._trajectory.position(np.minimum(np.maximum(t, self._run.begin_t), last))

    def _velocity(self, t: FloatArray) -> FloatArray:
        velocity = self._trajectory.velocity(t)[:, :3].copy()
        begin, end = np.searchsorted(t, [self._run.begin_t, self._run.end_t])
        velocity[:begin], velocity[end:] = 0.0, 0.0
        return velocity
