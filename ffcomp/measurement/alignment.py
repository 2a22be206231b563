"""Align an accelerometer's record with the expected motion: the start of the record, and the rate of its clock.

The record m(t) is matched by g e(τ), with τ = offset + ratio (t − t₀): e the expected acceleration, g a gain for each
axis. A first search correlates the loudest seconds of the record with all of e, for every possible clock ratio;
Gauss-Newton then refines offset and ratio on a window that doubles until it is the whole record. It stays apart from
`ffcomp.numerics.least_squares`: two unknowns, the gains eliminated, no damping needed so near the optimum.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import butter, fftconvolve, sosfiltfilt

from ffcomp.errors import MeasurementError
from models.arrays import FloatArray

_LOWEST_HZ = 4.0  # below: gravity, tilt and drift
_FIRST_WINDOW_S = 4.0
_WORST_CLOCK = 0.03  # MEMS oscillators are within 2 %
_CYCLES_OF_CLOCK_STEP = 0.25  # what two neighbouring clock ratios of the search differ by over the window
_NEARLY_ALL = 0.999  # of the expectation's power
_SEARCH_SAMPLES = 8  # to a cycle of the highest frequency: a sample off is an eighth of a cycle
_BLOCKS = 24  # for an uncertainty that holds with coloured residuals
_CLEAR_CORRELATION = 0.4
_CLEAR_LOG_ODDS = 10.0  # against the second best offset
_ITERATIONS = 12


@dataclass(frozen=True)
class Alignment:
    """expected time = offset_s + clock_ratio · (measured time − its first sample)."""

    offset_s: float
    offset_sd_s: float
    clock_ratio: float
    clock_ratio_sd: float
    correlation: float  # of record and expectation, 0 to 1

    def expected_time(self, time_s: FloatArray) -> FloatArray:
        """Convert the record's own times (n,) s, from its first on, to the expectation's clock."""
        return np.asarray(self.offset_s + self.clock_ratio * (time_s - time_s[0]), dtype=np.float64)


def align(
    time_s: FloatArray,
    measured: FloatArray,
    expected_time_s: FloatArray,
    expected: FloatArray,
    source: str = "",
    repeats_s: float = np.inf,
) -> Alignment:
    """Estimate offset and clock ratio of a record, with standard uncertainties.

    The uncertainties are those of least squares with residuals of any colour (sums of scores over 24 blocks:
    Huber's sandwich), so they hold when the expectation is only roughly right.

    Parameters
    ----------
    time_s : (n,) uniform, any start.
    measured : (n, m) m/s², one column an axis; gravity may be in it.
    expected_time_s : (N,) uniform.
    expected : (N, m) m/s², the same axes.
    source : the file, for the error's sentence.
    repeats_s : the motion's own period, if it has one. Offsets a whole number of periods apart fit alike in a few
        seconds; beginning and end of the whole record then decide between them.

    Raises
    ------
    MeasurementError
        Without a clear match.
    """
    _check(time_s, measured, expected, source)
    highest = _highest_frequency(expected, expected_time_s)
    reference = _Expectation(expected_time_s, _in_band(expected, expected_time_s, highest))
    since = time_s - time_s[0]
    record = _in_band(measured, time_s, highest)
    window = _loudest(record, since, _FIRST_WINDOW_S)
    estimate = _search(since[window], record[window], reference, source, repeats_s)
    while True:
        estimate, covariance, correlation = _refine(since[window], record[window], reference, estimate)
        if window.stop - window.start == len(since):
            moved = _right_period(since, record, reference, estimate, repeats_s)
            if moved[0] == estimate[0]:
                break
            estimate = moved
        window = _twice(window, len(since))
    if correlation < _CLEAR_CORRELATION:
        raise MeasurementError(source, [_no_match(correlation)])
    sd = np.sqrt(np.diag(covariance))
    return Alignment(float(estimate[0]), float(sd[0]), float(estimate[1]), float(sd[1]), correlation)


@dataclass(frozen=True, eq=False)
class _Expectation:
    """The expected motion as a smooth function of time, at rest outside its record."""

    time_s: FloatArray  # (N,)
    value: FloatArray  # (N, m)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_spline", CubicSpline(self.time_s, self.value))

    def at(self, t: FloatArray, derivative: int = 0) -> FloatArray:
        """Interpolate at (n,) s: (n, m)."""
        inside = (t >= self.time_s[0]) & (t <= self.time_s[-1])
        spline: CubicSpline = self._spline  # type: ignore[attr-defined]
        return np.asarray(spline(np.where(inside, t, self.time_s[0]), derivative) * inside[:, None])


def _right_period(
    since: FloatArray, record: FloatArray, reference: _Expectation, estimate: FloatArray, repeats_s: float
) -> FloatArray:
    """Move offset and ratio (2,) by the whole periods that fit the whole record best."""
    if not np.isfinite(repeats_s):
        return estimate
    length = float(reference.time_s[-1] - reference.time_s[0])
    moves = repeats_s * np.arange(-int(length / repeats_s), int(length / repeats_s) + 1)
    t = estimate[0] + estimate[1] * since
    inside = [reference.at(np.clip(t + move, reference.time_s[0], reference.time_s[-1])) for move in moves]
    scores = [float(np.sum(e * record)) / np.sqrt(float(np.sum(e**2)) + 1e-300) for e in inside]
    return np.array([estimate[0] + moves[int(np.argmax(scores))], estimate[1]])


def _search(
    since: FloatArray, record: FloatArray, reference: _Expectation, source: str, repeats_s: float
) -> FloatArray:
    """Search a grid of clock ratios and all offsets for the best (offset, ratio), (2,)."""
    frequency, bandwidth, highest = _content(reference.value, float(reference.time_s[1] - reference.time_s[0]))
    thin = max(1, int(1 / (_SEARCH_SAMPLES * highest * (since[1] - since[0]))))
    since, record = since[::thin], record[::thin]
    period = float(since[1] - since[0])
    length = float(since[-1] - since[0])
    steps = int(np.ceil(_WORST_CLOCK * length * frequency / _CYCLES_OF_CLOCK_STEP))
    ratios = 1 + _WORST_CLOCK * np.arange(-steps, steps + 1) / max(steps, 1)
    curves = [_correlations(record, reference, period * ratio) for ratio in ratios]
    best = int(np.argmax([curve.max() for _, curve in curves]))
    offsets, curve = curves[best]
    top = int(curve.argmax())
    if curve[top] < _CLEAR_CORRELATION / 2:
        raise MeasurementError(source, [_no_match(float(curve[top]))])
    away = np.abs(offsets - offsets[top])
    if np.isfinite(repeats_s):
        away = np.abs(away - repeats_s * np.round(away / repeats_s))
    apart = away > 0.5 / frequency
    if apart.any():
        second = int(np.flatnonzero(apart)[curve[apart].argmax()])
        independent = 2 * bandwidth * length * record.shape[1]
        odds = 0.5 * independent * np.log((1 - curve[second] ** 2) / max(1 - curve[top] ** 2, 1e-12))
        if curve[second] > 0 and odds < _CLEAR_LOG_ODDS:
            rule = (
                f"The record matches the expected motion nearly as well {offsets[second] - offsets[top]:+.4g} s away "
                f"(correlation {curve[second]:.3f} against {curve[top]:.3f}); a motion that does not repeat is needed."
            )
            raise MeasurementError(source, [rule])
    return np.array([offsets[top] - ratios[best] * since[0], ratios[best]])


def _correlations(record: FloatArray, reference: _Expectation, period: float) -> tuple[FloatArray, FloatArray]:
    """Return offsets of the record's first sample (k,) s, and the correlation at each (k,)."""
    n = len(record)
    count = int((reference.time_s[-1] - reference.time_s[0]) / period) + 1
    grid = np.pad(reference.at(reference.time_s[0] + period * np.arange(count)), ((n, n), (0, 0)))
    product = fftconvolve(grid, record[::-1], mode="valid", axes=0).sum(axis=1)
    energy = np.concatenate([[0.0], np.cumsum((grid**2).sum(axis=1))])
    power = (energy[n:] - energy[:-n]) * float((record**2).sum())
    # a sliver of the expectation that happens to fit is no match: count at least a tenth of the loudest window
    curve = product / np.sqrt(np.maximum(power, 0.01 * power.max()) + 1e-300)
    return reference.time_s[0] + period * (np.arange(len(curve)) - n), np.asarray(curve)


def _refine(
    since: FloatArray, record: FloatArray, reference: _Expectation, estimate: FloatArray
) -> tuple[FloatArray, FloatArray, float]:
    """Refine (offset, ratio) (2,) by Gauss-Newton; return it, its covariance (2, 2) and the correlation."""
    centre = float(since.mean())  # offset and ratio are nearly independent seen from the middle
    for _ in range(_ITERATIONS):
        t = estimate[0] + estimate[1] * since
        curve, slope = reference.at(t), reference.at(t, 1)
        gain = (curve * record).sum(axis=0) / np.maximum((curve**2).sum(axis=0), 1e-300)
        residual = record - gain * curve
        early = gain * slope
        jacobian = np.stack([early, early * (since - centre)[:, None]], axis=-1)  # (n, m, 2)
        normal = np.einsum("nma,nmb->ab", jacobian, jacobian)
        step = np.linalg.solve(
            normal + 1e-12 * np.eye(2) * np.trace(normal), np.einsum("nma,nm->a", jacobian, residual)
        )
        estimate = estimate + np.array([step[0] - centre * step[1], step[1]])
        if abs(step[0]) < 1e-10 and abs(step[1]) * since[-1] < 1e-10:
            break
    score = np.einsum("nma,nm->na", jacobian, residual)
    blocks = np.array([part.sum(axis=0) for part in np.array_split(score, _BLOCKS)])
    inverse = np.linalg.inv(normal)
    sandwich = inverse @ (blocks.T @ blocks) @ inverse * _BLOCKS / (_BLOCKS - 2)
    back = np.array([[1.0, -centre], [0.0, 1.0]])
    explained = 1 - float((residual**2).sum()) / float((record**2).sum())
    return estimate, back @ sandwich @ back.T, float(np.sqrt(max(explained, 0.0)))


def _loudest(record: FloatArray, since: FloatArray, length_s: float) -> slice:
    """Find the window of this length with the most energy."""
    n = len(since)
    count = min(n, int(length_s / (since[1] - since[0])))
    energy = np.concatenate([[0.0], np.cumsum((record**2).sum(axis=1))])
    first = int((energy[count:] - energy[: n - count + 1]).argmax())
    return slice(first, first + count)


def _twice(window: slice, n: int) -> slice:
    half = (window.stop - window.start + 1) // 2
    return slice(max(0, window.start - half), min(n, window.stop + half))


def _content(values: FloatArray, period: float) -> tuple[float, float, float]:
    """Return mean frequency, bandwidth, and the frequency below which nearly all the power lies, Hz."""
    power = (np.abs(np.fft.rfft(values - values.mean(axis=0), axis=0)) ** 2).sum(axis=1)
    frequency = np.arange(len(power)) / (len(values) * period)
    mean = float((power * frequency).sum() / power.sum())
    top = int(np.searchsorted(np.cumsum(power), _NEARLY_ALL * power.sum()))
    return mean, float(power.sum() ** 2 / (power**2).sum() * frequency[1]), float(frequency[top])


def _highest_frequency(expected: FloatArray, time_s: FloatArray) -> float:
    return max(_content(expected, float(time_s[1] - time_s[0]))[2], 3 * _LOWEST_HZ)


def _in_band(values: FloatArray, time_s: FloatArray, highest_hz: float) -> FloatArray:
    """Filter out gravity and frequencies beyond the expected ones, (n, m)."""
    rate = (len(time_s) - 1) / float(time_s[-1] - time_s[0])
    high = min(1.3 * highest_hz, 0.45 * rate)
    band = butter(2, [_LOWEST_HZ, high], "bandpass", fs=rate, output="sos")
    return np.asarray(sosfiltfilt(band, values - values.mean(axis=0), axis=0))


def _check(time_s: FloatArray, measured: FloatArray, expected: FloatArray, source: str) -> None:
    problems = []
    if measured.shape[1] != expected.shape[1]:
        problems.append(f"{measured.shape[1]} axes were measured, but {expected.shape[1]} are expected.")
    if not np.isfinite(measured).all():
        problems.append("The record has gaps; align a part without.")
    if len(time_s) < 2 or time_s[-1] - time_s[0] < 0.5:
        problems.append("The record is shorter than 0.5 s, too short to be found in a motion.")
    if not problems and (not expected.any() or not np.ptp(measured, axis=0).any()):
        problems.append("Nothing moves, so nothing can be aligned.")
    if problems:
        raise MeasurementError(source, problems)


def _no_match(correlation: float) -> str:
    return (
        f"The record does not match the expected motion (correlation {correlation:.2f}; at least "
        f"{_CLEAR_CORRELATION:g} is a match): is it of another motion, are its axes turned, or is its rate wrong?"
    )
