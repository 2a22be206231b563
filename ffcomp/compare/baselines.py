"""Every baseline at its best: as the firmware's own calibration sets it, and as a search finds it.

The search evaluates candidates on the print itself with the linear plant along the path; thousands of candidates would
be too many for the nonlinear printer, which evaluates the winners.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ffcomp import shapers
from ffcomp.compare.evaluation import SETTLE_S
from ffcomp.compare.sampling import PrintSlice
from ffcomp.metrics import contour_error, rms
from ffcomp.shapers.apply import FrequencyOfPosition
from ffcomp.shapers.calibration import Spectrum, fit, resonance_test_psd
from ffcomp.shapers.grid import shape_samples, shape_samples_by_frequency
from ffcomp.shapers.search import Fixed, best_fixed
from ffcomp.simulate.linear import KEEP_EVERY, STEP_S, LinearPlayback, whole_steps
from ffcomp.simulate.motion import Motion
from models.arrays import FloatArray
from models.effects.catalogue import effective_machine
from models.machine import Machine

DAMPING_RATIOS = (0.05, 0.1)
MARGIN = 400  # steps, 0.2 s: longer than half of any shaper above 7 Hz
SCANNED = 2  # every so many slices serve for the scans, before the search goes on with all
FACTORS = np.geomspace(0.9, 2.4, 12)  # of a scheduled shaper's frequency to that of the mode at the position


class LinearPrinter:
    """Evaluate shapers on the plant's linear model along the path: quick, and near enough to choose by."""

    def __init__(self, plant: Machine, slices: Sequence[PrintSlice]) -> None:
        self._playback = LinearPlayback(effective_machine(plant))
        self.slices = [each for each in slices if each.trajectory.end_t > 2 * SETTLE_S]
        self.plans = [_sampled(each.motion) for each in self.slices]  # (MARGIN + n + MARGIN, 3) mm, STEP_S apart

    def contour_rms_um(self, motions: Sequence[Motion]) -> float:
        """Return the contour rms of one motion a slice of `self.slices`, µm."""
        return self.contour_rms_of_um([_sampled(each, 0) for each in motions])

    def contour_rms_of_um(self, commands: Sequence[FloatArray]) -> float:
        """Return the contour rms of commands (k, 3) mm, STEP_S apart, one a slice of `self.slices`, µm."""
        errors = np.concatenate([self._contour_of(s, c) for s, c in zip(self.slices, commands, strict=True)])
        return rms(errors) * 1e3

    def _contour_of(self, print_slice: PrintSlice, command: FloatArray) -> FloatArray:
        t = print_slice.motion.begin_t + STEP_S * np.arange(len(command), dtype=np.float64)
        nozzle, _ = self._playback.respond(command, np.gradient(command, STEP_S, axis=0))
        counted = slice(round(SETTLE_S / STEP_S), None, KEEP_EVERY)
        return contour_error(*print_slice.corners, t[1:][counted], nozzle[counted])

    def best_fixed(self, kind: str) -> Fixed:
        """Find the frequencies and damping ratio of one kind with the least contour rms."""

        def command(plan: FloatArray, x: shapers.Shaper, y: shapers.Shaper) -> FloatArray:
            return np.ascontiguousarray(shape_samples(plan, (x, y, None), STEP_S, MARGIN))

        def cost(x: shapers.Shaper, y: shapers.Shaper) -> float:
            return self.contour_rms_of_um([command(plan, x, y) for plan in self.plans])

        def scanned(x: shapers.Shaper, y: shapers.Shaper) -> float:
            some = zip(self.slices[::SCANNED], self.plans[::SCANNED], strict=True)
            return rms(np.concatenate([self._contour_of(each, command(plan, x, y)) for each, plan in some]))

        return best_fixed(kind, cost, (25.0, 100.0), DAMPING_RATIOS, scanned=scanned)

    def best_factor(self, kind: str, of_position: FrequencyOfPosition) -> float:
        """Find the ratio of a scheduled shaper's frequency to the mode's with the least contour rms."""
        frequencies = [of_position(plan[MARGIN:-MARGIN, :2].copy()) for plan in self.plans]

        def cost(factor: float) -> float:
            each = zip(self.plans, frequencies, strict=True)
            return self.contour_rms_of_um(
                [shape_samples_by_frequency(plan, factor * own, kind, STEP_S, MARGIN) for plan, own in each]
            )

        return float(min(FACTORS, key=cost))


def _sampled(motion: Motion, margin: int = MARGIN) -> FloatArray:
    steps = whole_steps(motion.end_t - motion.begin_t)
    t = motion.begin_t + STEP_S * np.arange(-margin, steps + 1 + margin, dtype=np.float64)
    return np.ascontiguousarray(motion.position(t))


def shaped(motion: Motion, x: shapers.Shaper, y: shapers.Shaper) -> Motion:
    """Execute a motion as a firmware with input shapers does: each axis convolved, no delay at constant speed."""
    return replace(motion, position=lambda t: shapers.shape(motion.position, t, x, y))


def shaped_by_position(motion: Motion, frequency_of_position: FrequencyOfPosition, kind: str) -> Motion:
    """Shape a motion with the frequency of the position where the plan is at each time."""
    return replace(motion, position=lambda t: shapers.scheduled_shape(motion.position, t, frequency_of_position, kind))


def scaled(of_position: FrequencyOfPosition, factor: float) -> FrequencyOfPosition:
    """Multiply the frequency of every position."""
    return lambda xy: factor * of_position(xy)


def resonance_tests(plant: Machine) -> list[Spectrum]:
    """Return the firmware's own tests of x and y in the middle of the bed: all kinds of shapers are set by them."""
    return [resonance_test_psd(effective_machine(plant), np.zeros(2), axis) for axis in ("x", "y")]


def calibrated_shapers(tests: Sequence[Spectrum], kind: str) -> tuple[FloatArray, shapers.Shaper, shapers.Shaper]:
    """Return what the firmware's calibration finds by these tests: (2,) Hz and the x and y shapers."""
    frequency = np.array([fit(kind, each).frequency_hz for each in tests])
    x, y = (shapers.SHAPERS[kind](f, shapers.DAMPING_RATIO) for f in frequency)
    return frequency, x, y
