"""Calibrate a shaper as a firmware does, from its own resonance test.

Klipper excites the nozzle with a train of pulses whose frequency rises slowly, measures the acceleration, and takes the
shaper whose score is lowest (its resonance tester and shaper calibration; Kalico has the same):

    score = smoothing (V^1.5 + V/5 + 1/100),   V = Σ max(v S - S_max/20, 0) / Σ max(S - S_max/20, 0)

with S the power spectral density divided by (f + 0.1 Hz), v the vibration that the shaper leaves, the worst of three
damping ratios, and the smoothing the offset from the path at a corner of 90° or 180°, at 5 m/s². It fits no model: no
phase, no damping, nothing of the other positions on the bed.

    x, y = (recommended(fits(resonance_test_psd(machine, xy, axis)).values()) for axis in "xy")

mm, s, Hz.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.signal import welch

from ffcomp.shapers import DAMPING_RATIO, SHAPERS, Shaper, residual_vibration
from models.arrays import FloatArray
from models.effects.catalogue import effective_machine
from models.machine import Machine

Axis = Literal["x", "y", "z"]
_XY: tuple[Axis, Axis] = ("x", "y")
Spectrum = tuple[FloatArray, FloatArray]  # (k,) Hz; (k,) mm²/s⁴/Hz², a density as `normalised` makes it

ACCELERATION_PER_HZ = 60.0  # mm/s² per Hz: Klipper's; Kalico's is 75
SWEPT_HZ = (5.0, 135.0)
HZ_PER_S = 1.0
RATE_HZ = 800  # of the answer: four times the highest frequency looked at

_FINE_RATE_HZ = 3200  # rate of the averaged command
_SETTLE_S = 2.0  # at rest after the test: nothing rings on into its beginning, which follows its end for an FFT
_WINDOW_S = 0.5  # at least; as many samples as the next power of two
_KAISER_BETA = 6.0
_HIGHEST_HZ = 200.0  # of the spectrum
_NORMALISING_HZ = 0.1
_NOISY_HZ = 10.0  # below, the spectrum is faded out

_CANDIDATES = ("zv", "mzv", "ei", "2hump_ei", "3hump_ei")  # in the order of choice
_UP_TO_HZ, _STEP_HZ = 150.0, 0.2
_TEST_DAMPING_RATIOS = (0.075, 0.1, 0.15)
_REDUCTION = 20.0  # power below the peak divided by this does not count
_TEST_ACCELERATION = 5000.0  # mm/s²
TARGET_SMOOTHING_MM = 0.12  # at a corner, at most
_MANY_PULSES, _TABLE = 10, 8000  # of a kernel; lines, so that the table is exact to 1e-5


@dataclass(frozen=True, slots=True)
class Fit:
    """The frequency chosen for one kind of shaper."""

    kind: str
    frequency_hz: float
    vibration: float  # V, remaining part of the measured power
    smoothing_mm: float
    score: float

    @property
    def shaper(self) -> Shaper:
        """The shaper itself."""
        return SHAPERS[self.kind](self.frequency_hz, DAMPING_RATIO)


# ---- the test ------------------------------------------------------------------------------------


def resonance_test_psd(
    machine: Machine, xy: FloatArray, axis: Axis, acceleration_per_hz: float = ACCELERATION_PER_HZ
) -> Spectrum:
    """Return the spectrum that a firmware computes from a `resonance_test`; the axes' powers are added."""
    felt = resonance_test(machine, xy, axis, acceleration_per_hz)
    samples = 1 << int(np.ceil(np.log2(_WINDOW_S * RATE_HZ)))
    frequency, psd = welch(felt, RATE_HZ, np.kaiser(samples, _KAISER_BETA), axis=0)  # as Klipper does
    keep = frequency <= _HIGHEST_HZ
    return normalised(frequency[keep], psd[keep].sum(axis=1))


def resonance_test(
    machine: Machine, xy: FloatArray, axis: Axis, acceleration_per_hz: float = ACCELERATION_PER_HZ
) -> FloatArray:
    """Return the nozzle's acceleration while a firmware's resonance test excites it along one axis, for small motion.

    The command's pulses, ±acceleration_per_hz · f for a quarter period each, pass the nozzle's frequency response,
    which is the same for accelerations as for positions. The slow sweep that newer firmware adds is left out: it keeps
    friction from sticking, and a linear machine has none.

    The test is made at one position (2,) mm; the acceleration is (n, 3) mm/s² at RATE_HZ.
    """
    time, velocity = pulse_train(acceleration_per_hz)
    grid = np.arange(int(np.ceil(time[-1] + _SETTLE_S)) * _FINE_RATE_HZ + 1) / _FINE_RATE_HZ  # whole seconds
    command = np.diff(np.interp(grid, time, velocity)) * _FINE_RATE_HZ  # the mean over each sample
    ratio = _FINE_RATE_HZ // RATE_HZ
    kept = len(command) // (2 * ratio) + 1  # lines up to half the slow rate
    lines = np.linspace(0.0, RATE_HZ / 2, kept)
    response = machine.vibration.frequency_response(xy, lines, "nozzle", "nozzle")[:, :, "xyz".index(axis)]
    answered = response * np.fft.rfft(command)[:kept, None] / ratio
    return np.fft.irfft(answered, len(command) // ratio, axis=0)


def pulse_train(acceleration_per_hz: float) -> tuple[FloatArray, FloatArray]:
    """Return corners of the commanded velocity: times (n,) s and (n,) mm/s.

    ± acceleration_per_hz · f for a quarter period is the same change of speed at every frequency.
    """
    low, high = SWEPT_HZ
    swept = [low]
    while swept[-1] <= high:
        swept.append(swept[-1] + 0.5 / swept[-1] * HZ_PER_S)
    frequency = np.repeat(swept[:-1], 2)  # of each quarter period; two of them, then the next frequency
    time = np.concatenate([[0.0], np.cumsum(0.25 / frequency)])
    velocity = np.resize([0.0, 1.0, 0.0, -1.0], len(time)) * acceleration_per_hz / 4
    return time, velocity


def normalised(frequency_hz: FloatArray, psd: FloatArray) -> Spectrum:
    """Divide a density in mm²/s⁴/Hz by the frequency, because the test's excitation is proportional to it."""
    fade = np.exp(1 - (_NOISY_HZ / (frequency_hz + _NORMALISING_HZ)) ** 2)
    weight = np.where(frequency_hz < _NOISY_HZ, fade, 1.0)
    return frequency_hz, psd / (frequency_hz + _NORMALISING_HZ) * weight


# ---- the choice ----------------------------------------------------------------------------------


def fits(spectrum: Spectrum, square_corner_velocity: float = 5.0) -> dict[str, Fit]:
    """Return the fit of every kind that a firmware recommends, in its order; arguments as of `fit`."""
    return {kind: fit(kind, spectrum, square_corner_velocity) for kind in _CANDIDATES}


def fit(kind: str, spectrum: Spectrum, square_corner_velocity: float = 5.0) -> Fit:
    """Find the frequency of a kind in `SHAPERS` with the lowest score of those that leave hardly more than the best.

    square_corner_velocity : mm/s
    """
    tried = np.arange(SHAPERS[kind].lowest_hz, _UP_TO_HZ, _STEP_HZ)
    vibration = _remaining(SHAPERS[kind](1.0, DAMPING_RATIO), tried, *_checked(*spectrum))
    smooth = np.array([smoothing(SHAPERS[kind](f, DAMPING_RATIO), square_corner_velocity) for f in tried])
    score = smooth * (vibration**1.5 + 0.2 * vibration + 0.01)
    least = vibration.min()
    good = (vibration < 1.1 * least) | (vibration == least)
    best = int(np.argmin(np.where(good, score, np.inf)))
    return Fit(kind, float(tried[best]), float(vibration[best]), float(smooth[best]), float(score[best]))


def recommended(candidates: Iterable[Fit]) -> Fit:
    """Choose among fits: a wider one must win clearly, by 20 %, or by 5 % with 10 % less smoothing."""
    best, *challengers = candidates
    for other in challengers:
        clearly = other.score * 1.2 < best.score
        if clearly or (other.score * 1.05 < best.score and other.smoothing_mm * 1.1 < best.smoothing_mm):
            best = other
    return best


def smoothing(shaper: Shaper, square_corner_velocity: float = 5.0, acceleration: float = _TEST_ACCELERATION) -> float:
    """Return how far (mm) the shaped path is off a corner: the worse of a right angle and of a reversal."""
    a, t = shaper.amplitude, shaper.time
    late = np.maximum(t, 0.0)
    right_angle = np.sqrt(2) * a @ ((square_corner_velocity + acceleration / 2 * late) * late)
    reversal = a @ (acceleration / 2 * t**2)
    return float(max(right_angle, reversal))


def _remaining(of_one_hz: Shaper, tried_hz: FloatArray, frequency_hz: FloatArray, psd: FloatArray) -> FloatArray:
    """Return V for each tried frequency (m,), from the spectrum (k,): only the ratio of two frequencies matters."""
    ratio = frequency_hz / tried_hz[:, None]  # (m, k)
    threshold = psd.max() / _REDUCTION
    total = np.maximum(psd - threshold, 0.0).sum()
    remaining = [
        np.maximum(_left(of_one_hz, ratio, zeta) * psd - threshold, 0.0).sum(axis=1) for zeta in _TEST_DAMPING_RATIOS
    ]
    return np.asarray(np.max(remaining, axis=0) / total)


def _left(of_one_hz: Shaper, ratio: FloatArray, damping_ratio: float) -> FloatArray:
    """Return the residual vibration at ratios of frequencies: from a fine table where there are many pulses."""
    if len(of_one_hz.amplitude) < _MANY_PULSES:
        return residual_vibration(of_one_hz, ratio, damping_ratio)
    table = np.linspace(0.0, float(ratio.max()), _TABLE)
    return np.interp(ratio, table, residual_vibration(of_one_hz, table, damping_ratio))


def _checked(frequency_hz: FloatArray, psd: FloatArray) -> Spectrum:
    if frequency_hz.shape != psd.shape:
        raise ValueError(f"A spectrum needs a power for every frequency, not {psd.shape} for {frequency_hz.shape}.")
    keep = frequency_hz <= _HIGHEST_HZ
    if not (np.isfinite(psd[keep]).all() and psd[keep].any()):
        raise ValueError(f"A spectrum must have some power up to {_HIGHEST_HZ:g} Hz, and no gaps.")
    return frequency_hz[keep], psd[keep]


# ---- advice for those who stay with a shaper -------------------------------------------------------


@dataclass(frozen=True, slots=True)
class ShaperAdvice:
    """The shaper of one axis, by the firmware's own resonance test of the machine in the middle of the bed."""

    axis: str  # x or y
    shaper: str  # zv, mzv, ei, 2hump_ei or 3hump_ei
    frequency_hz: float
    remaining_vibration: float  # share of the measured power that it leaves
    max_accel_mm_per_s2: float  # that rounds a corner by 0.12 mm, Klipper's tolerance


def shaper_advice(machine: Machine) -> tuple[ShaperAdvice, ...]:
    """Return what suits x and y, as a firmware's calibration of the machine in the middle of the bed has it."""
    corner, tested = machine.limits.square_corner_velocity_mm_per_s, effective_machine(machine)
    advice = []
    for axis in _XY:
        best = recommended(fits(resonance_test_psd(tested, np.zeros(2), axis), corner).values())
        most = highest_acceleration(best, corner)
        advice.append(ShaperAdvice(axis, best.kind, best.frequency_hz, best.vibration, most))
    return tuple(advice)


def highest_acceleration(fit: Fit, corner: float) -> float:
    """Return the highest acceleration, mm/s², that keeps the rounding of corners within Klipper's tolerance."""
    a, late, t = fit.shaper.amplitude, np.maximum(fit.shaper.time, 0.0), fit.shaper.time  # as in `smoothing`
    at_corner = (TARGET_SMOOTHING_MM / np.sqrt(2) - corner * a @ late) / (a @ late**2 / 2)
    at_reversal = TARGET_SMOOTHING_MM / (a @ t**2 / 2)
    return 100.0 * max(int(min(at_corner, at_reversal) / 100.0), 0)


def in_words(advice: tuple[ShaperAdvice, ...]) -> str:
    """Say it in a sentence, empty without advice."""
    if not advice:
        return ""
    each = ", ".join(f"{one.axis} {one.shaper.upper()} at {one.frequency_hz:.1f} Hz" for one in advice)
    most = min(one.max_accel_mm_per_s2 for one in advice)
    return f"With an input shaper instead (middle of the bed): {each}, max_accel up to {most:.0f} mm/s²."


def klipper_block(advice: tuple[ShaperAdvice, ...]) -> str:
    """Return the settings as Klipper's configuration has them, to copy; empty without advice."""
    if not advice:
        return ""
    lines = [
        line
        for one in advice
        for line in (f"shaper_type_{one.axis}: {one.shaper}", f"shaper_freq_{one.axis}: {one.frequency_hz:.1f}")
    ]
    most = min(one.max_accel_mm_per_s2 for one in advice)
    return "\n".join(["[input_shaper]", *lines, f"# [printer] max_accel: at most {most:.0f}"])
