"""Put a capture on its experiment's clock: τ = offset + ratio (t − t₀), t₀ the capture's first row, motion from τ = 0.

Where the firmware dates the samples, the offset is known to a sample and the ratio is one. Otherwise both are fitted to
the motion below 20 Hz, where every printer follows its command: above, what the machine file lacks would be taken for a
delay. Below, too, 3 N of dry friction unaccounted for look like 0.3 to 1 ms. So the responses to friction of several
sizes and to an added mass are simulated as well; their sizes and the gains of the axes are fitted along, and forgotten.

To first order a force F on a carriage with a belt of stiffness k acts as if its motor stood F/k elsewhere: an added
mass like a command of −q̈.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import binary_opening
from scipy.signal import butter, fftconvolve, sosfiltfilt

from ffcomp.inference.covariance import clustered_covariance
from ffcomp.record.plan import Motion
from models.arrays import BoolArray, FloatArray
from models.machine import Machine
from models.printer.parameters import converted_printer
from models.printer.printer import PrinterMotion, played, simulate_printers

RATE_HZ = 1600.0
TAIL_S = 0.4  # simulated after the motion: the printer rings for 0.2 s
FRICTION_N = (1.0, 3.0, 8.0)  # of each guide: more holds the carriage fast for longer
MASS_S2 = 1e-6  # (m/k) of an added mass, small against every motion


@dataclass(frozen=True, eq=False)
class Expectation:
    """The nozzle's acceleration in an experiment whose motion begins at 0. N times."""

    time_s: FloatArray  # (N,) s, uniform
    acceleration: FloatArray  # (N, 3) m/s², columns x y z
    signatures: FloatArray  # (s, N, 3) m/s² of effects of unknown size
    duration_s: float  # of the motion

    @cached_property
    def _splines(self) -> list[CubicSpline]:
        """Both between 2 and 20 Hz."""
        return [CubicSpline(self.time_s, filtered(self.time_s, each)) for each in (self.acceleration, *self.signatures)]

    def at(self, t: FloatArray, derivative: int = 0) -> list[FloatArray]:
        """Return the acceleration and each signature between 2 and 20 Hz at (n,) s, (n, 3) each; at rest outside."""
        begin, end = float(self.time_s[0]), float(self.time_s[-1])
        inside, kept = ((t >= begin) & (t <= end))[:, None], np.clip(t, begin, end)
        return [np.asarray(spline(kept, derivative) * inside) for spline in self._splines]


def expectation(motion: Motion, machine: Machine, lead_s: float) -> Expectation:
    """Simulate an experiment's motion on the machine file's printer, at rest for `lead_s` before it.

    Raises UnreachableError if the machine cannot execute the motion.
    """
    t = np.arange(-lead_s, motion.duration_s + TAIL_S, 1 / RATE_HZ)
    carriages = machine.kinematics.inverse(motion.nozzle(t))
    massive = carriages - MASS_S2 * np.gradient(np.gradient(carriages, 1 / RATE_HZ, axis=0), 1 / RATE_HZ, axis=0)
    friction = machine.effects.get("coulomb_friction", {})
    usual_n = float(np.mean(friction.get("force_n", 0.0)))
    rubbing = [
        replace(machine, effects={**machine.effects, "coulomb_friction": {**friction, "force_n": usual_n + more_n}})
        for more_n in FRICTION_N
    ]
    motions = simulated([machine, machine, *rubbing], [carriages, massive, *[carriages] * len(rubbing)])
    plain, heavy, *rubbed = (each.nozzle_acceleration for each in motions)
    signatures = np.array([heavy - plain, *(each - plain for each in rubbed)])
    return Expectation(t, plain, signatures, motion.duration_s)


def simulated(machines: Sequence[Machine], commands: Sequence[FloatArray]) -> list[PrinterMotion]:
    """Simulate each machine under its command at `RATE_HZ`; UnreachableError if one cannot execute it."""
    return [
        played(motion) for motion in simulate_printers(list(map(converted_printer, machines)), commands, 1 / RATE_HZ)
    ]


BAND_HZ = (2.0, 20.0)
ORDER = 6  # of the filter, twice: the modes, from 30 Hz on, ring loudly
BRIDGED_S = 1e-3  # of missing rows that a cubic spline stands for: a tenth of a period at 100 Hz
THIN_HZ = 200.0  # ten times the band: rows that are fitted
WORST_CLOCK = 0.03  # chips are within 2 %
CYCLES_OF_CLOCK_STEP = 0.1  # of the band's middle, between two ratios that are tried
BLOCKS = 24  # for an uncertainty that holds with coloured residuals
ITERATIONS = 12
STARTS, APART_S = 4, 0.02  # offsets that are tried for each ratio
LOUD = 0.05  # of the loudest axis' power: below it, a motion does not show whether a chip feels an axis
DEAF = 0.3  # of the motion that the command makes along an axis


@dataclass(frozen=True)
class ClockFit:
    """A capture's clock on the experiment's."""

    offset_s: float
    offset_sd_s: float
    ratio: float
    ratio_sd: float
    correlation: float  # below 20 Hz, of the measured and the expected motion, 0 to 1


def filtered(time_s: FloatArray, values: FloatArray) -> FloatArray:
    """Keep 2 to 20 Hz of (n, m), without delay."""
    rate = (len(time_s) - 1) / float(time_s[-1] - time_s[0])
    band = butter(ORDER, BAND_HZ, "bandpass", fs=rate, output="sos")
    return np.asarray(sosfiltfilt(band, values - values[: max(1, len(values) // 50)].mean(axis=0), axis=0))


def thinned(time_s: FloatArray, measured: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return times from the first row on (k,) s and the signal between 2 and 20 Hz (k, 3), at a tenth of the rows."""
    known = without_gaps(time_s, measured)
    every = max(1, int((len(time_s) - 1) / float(time_s[-1] - time_s[0]) / THIN_HZ))
    return (time_s - time_s[0])[::every], filtered(time_s, known)[::every]


def without_gaps(time_s: FloatArray, measured: FloatArray) -> FloatArray:
    """Bridge missing rows (NaN) of (n, m): a few in a row by a cubic spline, more by straight lines."""
    known = np.isfinite(measured).all(axis=1)
    if known.all():
        return measured
    lines = np.column_stack([np.interp(time_s, time_s[known], column[known]) for column in measured.T])
    short = ~known & ~long_gaps(time_s, measured)
    if short.any():
        lines[short] = CubicSpline(time_s[known], measured[known])(time_s[short])
    return lines


def long_gaps(time_s: FloatArray, measured: FloatArray) -> BoolArray:
    """Return which rows of (n, m) are missing (NaN) in gaps too long to bridge."""
    missing = ~np.isfinite(measured).all(axis=1)
    bridged = int(BRIDGED_S * (len(time_s) - 1) / float(time_s[-1] - time_s[0]))
    return np.asarray(binary_opening(missing, np.ones(bridged + 1, dtype=np.bool_)))


def felt_shares(record: FloatArray, expected: Expectation, t: FloatArray) -> tuple[float, ...]:
    """Return how much of the expected motion along x, y, z a record (k, 3) at (k,) s holds; one where there is none."""
    motion = expected.at(t)[0]
    power = np.sum(motion**2, axis=0)
    gains = np.sum(record * motion, axis=0) / np.maximum(power, 1e-300)
    return tuple(np.where(power >= LOUD * power.max(), gains, 1.0).tolist())


def fit_clock(
    since: FloatArray, record: FloatArray, expected: Expectation, start: tuple[float, float], free_ratio: bool
) -> ClockFit:
    """Refine offset and ratio from a start, the gains of the axes and the sizes of the signatures fitted along.

    By Gauss-Newton with the linear sizes eliminated (Golub & Pereyra, Inverse Problems 19, 2003).
    The record (k, 3) m/s² is along the printer's axes, at times (k,) s since the capture's first row, as of `thinned`.
    A signature leaves out axes that the chip does not feel: friction at a chip on the bed is the bed's.
    """
    audible = np.array(felt_shares(record, expected, start[0] + start[1] * since)) >= DEAF

    def columns(t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return columns whose sizes are free, and the derivatives of the first three by time."""
        plain, *signatures = expected.at(t)
        steep = expected.at(t, 1)[0]
        axes = [np.where(np.arange(3) == axis, rows, 0.0).ravel() for rows in (plain, steep) for axis in range(3)]
        free = [*axes[:3], *((each * audible).ravel() for each in signatures)]
        return np.column_stack(free), np.column_stack(axes[3:])

    measured, estimate = record.ravel(), np.array(start)
    centre, unknown = float(since.mean()), 2 if free_ratio else 1
    ages = np.repeat(since - centre, 3)
    for _ in range(ITERATIONS):
        values, slopes = columns(estimate[0] + estimate[1] * since)
        sizes = np.linalg.lstsq(values, measured, rcond=1e-9)[0]
        residual = measured - values @ sizes
        early = slopes @ sizes[:3]
        jacobian = np.column_stack([early, early * ages])[:, :unknown]
        jacobian = jacobian - values @ np.linalg.lstsq(values, jacobian, rcond=1e-9)[0]
        step = np.append(np.linalg.lstsq(jacobian, residual, rcond=1e-12)[0], 0.0)
        estimate = estimate + np.array([step[0] - centre * step[1], step[1]])
        if abs(step[0]) < 1e-9 and abs(step[1]) * since[-1] < 1e-9:
            break
    noise = max(float(np.std(residual)), 1e-300)
    blocks = np.repeat(np.arange(BLOCKS), -(-len(measured) // BLOCKS))[: len(measured)]
    variance = np.diag(clustered_covariance(jacobian / noise, residual / noise, blocks, np.zeros(unknown)))
    ratio_sd = float(np.sqrt(variance[1])) if free_ratio else 0.0
    # at the first row, which is where the offset counts from
    offset_sd = float(np.hypot(np.sqrt(variance[0]), centre * ratio_sd))
    about = measured - measured.mean()
    explained = max(1 - float(residual @ residual) / max(float(about @ about), 1e-300), 0.0)
    return ClockFit(float(estimate[0]), offset_sd, float(estimate[1]), ratio_sd, float(np.sqrt(explained)))


@dataclass(frozen=True, eq=False)
class Matches:
    """How well each axis of a capture fits each axis of the expectation, at one clock of each kind that is possible."""

    starts: list[tuple[float, float]]  # offset and ratio
    correlation: FloatArray  # (starts, 3, 3): sensor axis, printer axis; one in all if everything fits


def known_clock(since: FloatArray, record: FloatArray, expected: Expectation, start: tuple[float, float]) -> Matches:
    """Correlate at the clock that the firmware states."""
    motion = expected.at(start[0] + start[1] * since)[0]
    size = np.linalg.norm(record) * np.linalg.norm(motion)
    return Matches([start], (record.T @ motion)[None] / max(float(size), 1e-300))


def every_clock(since: FloatArray, record: FloatArray, expected: Expectation) -> Matches:
    """Correlate at every offset and every ratio of the clocks, whichever way the sensor is turned."""
    period, length = float(since[1] - since[0]), float(since[-1] - since[0])
    steps = int(np.ceil(WORST_CLOCK * length * float(np.mean(BAND_HZ)) / CYCLES_OF_CLOCK_STEP / 4))
    starts, tables = [], []
    for ratio in 1 + WORST_CLOCK * np.arange(-steps, steps + 1) / max(steps, 1):
        t = np.arange(expected.time_s[0], expected.time_s[-1], period * ratio)
        values = expected.at(t)[0]
        size = max(float(np.linalg.norm(record) * np.linalg.norm(values)), 1e-300)
        # (lags, sensor axis, printer axis)
        curves = np.stack([fftconvolve(values, record[::-1, [i]], axes=0) for i in range(3)], axis=1)
        likeness = np.linalg.svd(curves, compute_uv=False).sum(axis=1)
        # loops fit a quarter of a turn later nearly as well
        for best in peaks(likeness, round(APART_S / (period * ratio)), STARTS):
            starts.append((float(t[0] + (best - len(record) + 1) * period * ratio), float(ratio)))
            tables.append(curves[best] / size)
    return Matches(starts, np.array(tables))


def peaks(likeness: FloatArray, apart: int, most: int | None = None, least: float = 0.0) -> list[int]:
    """Return the best rows of (n,) that lie `apart` rows from each other, at most so many, none below `least`."""
    left, rows = likeness.copy(), list[int]()
    while len(rows) != most and left.max(initial=-1.0) >= least:
        rows.append(int(left.argmax()))
        left[max(0, rows[-1] - apart) : rows[-1] + apart + 1] = -1.0
    return rows
