"""Every baseline at its best: what the firmware's own calibration finds, and the best that a search can find.

The search judges candidates on the print itself, by the linear plant along the path (thousands of candidates would be
too many for the virtual printer, which has the last word on the winners).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ffcomp import shapers
from ffcomp.compare.evaluation import SETTLE_S
from ffcomp.compare.sampling import Stretch
from ffcomp.metrics import contour_error, rms
from ffcomp.shapers.apply import FrequencyOfPlace
from ffcomp.shapers.calibration import Fixed, best_fixed, calibrated_frequencies
from ffcomp.simulate.linear import KEEP_EVERY, STEP_S, LinearPlayback, whole_steps
from ffcomp.simulate.motion import Motion
from models.arrays import FloatArray
from models.effects.catalogue import effective_machine
from models.machine import Machine

DAMPING_RATIOS = (0.05, 0.1)
FACTORS = np.geomspace(0.9, 2.4, 12)  # of a scheduled shaper's frequency to that of the mode at the place


class LinearPrinter:
    """The plant's linear model along the path: quick, and near enough to choose by."""

    def __init__(self, plant: Machine, stretches: Sequence[Stretch]) -> None:
        self._playback = LinearPlayback(effective_machine(plant))
        self.stretches = [each for each in stretches if each.trajectory.end_t > 2 * SETTLE_S]

    def contour_rms_um(self, motions: Sequence[Motion]) -> float:
        """Of one motion a stretch of `self.stretches`."""
        errors = np.concatenate([self._contour(s, m) for s, m in zip(self.stretches, motions, strict=True)])
        return rms(errors) * 1e3

    def _contour(self, stretch: Stretch, motion: Motion) -> FloatArray:
        steps = whole_steps(motion.end_t - motion.begin_t)
        t = motion.begin_t + STEP_S * np.arange(steps + 1, dtype=np.float64)
        command = np.ascontiguousarray(motion.position(t))
        nozzle, _ = self._playback.respond(command, np.gradient(command, STEP_S, axis=0))
        counted = slice(round(SETTLE_S / STEP_S), None, KEEP_EVERY)
        return contour_error(*stretch.corners, t[1:][counted], nozzle[counted])

    def best_fixed(self, kind: str) -> Fixed:
        """The frequencies and damping ratio of one kind with the least contour rms."""

        def cost(x: shapers.Shaper, y: shapers.Shaper) -> float:
            return self.contour_rms_um([shaped(each.motion, x, y) for each in self.stretches])

        return best_fixed(kind, cost, (25.0, 100.0), DAMPING_RATIOS)

    def best_factor(self, kind: str, of_place: FrequencyOfPlace) -> float:
        """How many times the mode's frequency a scheduled shaper's should be."""

        def cost(factor: float) -> float:
            return self.contour_rms_um(
                [shaped_by_position(each.motion, scaled(of_place, factor), kind) for each in self.stretches]
            )

        return float(min(FACTORS, key=cost))


def shaped(motion: Motion, x: shapers.Shaper, y: shapers.Shaper) -> Motion:
    """Execute a motion as a firmware with input shapers does: each axis convolved, no delay at constant speed."""
    return replace(motion, position=lambda t: shapers.shape(motion.position, t, x, y))


def shaped_by_position(motion: Motion, frequency_of_place: FrequencyOfPlace, kind: str) -> Motion:
    """Shape a motion with the frequency of the position where the plan is at each time."""
    return replace(motion, position=lambda t: shapers.scheduled_shape(motion.position, t, frequency_of_place, kind))


def scaled(of_place: FrequencyOfPlace, factor: float) -> FrequencyOfPlace:
    return lambda xy: factor * of_place(xy)


def calibrated_shapers(plant: Machine, kind: str) -> tuple[FloatArray, shapers.Shaper, shapers.Shaper]:
    """What the firmware's calibration finds in the middle of the bed: (2,) Hz and the x and y shapers."""
    frequency = calibrated_frequencies(plant, np.zeros(2), kind)
    x, y = (shapers.SHAPERS[kind](f, shapers.DAMPING_RATIO) for f in frequency)
    return frequency, x, y
