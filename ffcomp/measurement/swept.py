"""The band that a resonance test swept, as its own record shows it.

A firmware's test excites one frequency after another, at a constant rate. In the spectrogram of the capture this is a
straight ridge, its harmonics are steeper ones. Of all straight lines the one is taken whose most prominent stretch
stands out most; where the stretch begins and ends, the sweep did. Beyond that nothing was excited, so that the power
falls there as it does above a resonance, and is none.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ffcomp.errors import MeasurementError
from ffcomp.measurement.capture import Capture
from ffcomp.measurement.estimators import lines_of_dft
from ffcomp.measurement.modal import KAISER_BETA
from models.arrays import FloatArray, IntArray

LOWEST_HZ, HIGHEST_HZ = 10.0, 130.0  # Klipper's sweep ends at 133 Hz; below 10 Hz its spectra are attenuated
_WINDOW_S = 0.5
_MOST_WINDOWS = 240
_FEWEST_WINDOWS = 12  # about three seconds
_LOWEST_HZ, _HIGHEST_HZ = 3.0, 210.0
_COARSE_WINDOWS = 80
_STANDS_OUT = 2.0  # ln of the power over its median, above which a window counts for the ridge
_AT_MOST = 3.0  # beyond it, what one window can count
_OVERHANG = 20  # lines that a ridge may begin below 0 Hz: the printer still rests
_LEAST_SCORE = 1.0  # average over all windows; noise has 0.1, real tests have 2.3 and more
_LEAST_WIDTH_HZ = 10.0
_NEAR_LINES = 3  # from the coarse line to the ridge
_DROP, _DROP_LINES = np.log(5.0), 3  # of the power over f², at the end of a sweep
_BELOW = 0.3  # of the power over f² in the band, behind the end of a sweep
_LOWEST_END_HZ = 20.0
_UNTOUCHED_HZ = 10.0  # spectra of firmware are attenuated below
_HIGHEST_END_HZ = 125.0  # firmware's own tests end at 133 Hz
_EDGE_LINES = 2.0  # next to the ends of a sweep, blurred by the window
_STILL_HIGH = 0.8  # of a peak's power, at the end of a sweep that cuts it off


@dataclass(frozen=True)
class SweptBand:
    """What a test excited."""

    low_hz: float
    high_hz: float

    def usable(self, line_hz: float) -> tuple[float, float]:
        """Return the band without the lines at its ends, which a window of this resolution blurs."""
        return self.low_hz + _EDGE_LINES * line_hz, self.high_hz - _EDGE_LINES * line_hz

    @property
    def remedy(self) -> str:
        """A sentence with the swept band and the band to sweep."""
        return (
            f"The test swept {self.low_hz:.0f} to {self.high_hz:.0f} Hz; sweep to 133 Hz, as firmware does "
            "by default (Klipper: TEST_RESONANCES AXIS=X OUTPUT=raw_data, without FREQ_END)."
        )


def swept_band(capture: Capture) -> SweptBand | None:
    """Find the band of a test's sweep in a capture; None: there is no sweep in it."""
    time_s, frequency, prominence = _spectrogram(capture)
    if len(time_s) < _FEWEST_WINDOWS:
        return None
    line = _refined(time_s, frequency, prominence, _coarse_line(time_s, prominence))
    (begin,), (end,), (score,) = _stretches(_gains(_widened(prominence), line[None]))
    ridge = np.clip(line, 0, len(frequency) - 1) * frequency[1]
    low, high = sorted((float(ridge[begin]), float(ridge[end])))
    if score < _LEAST_SCORE * len(time_s) or high - low < _LEAST_WIDTH_HZ:
        return None
    return SweptBand(low, high)


def _spectrogram(capture: Capture) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return times (w,) s, frequencies (k,) Hz, and ln of the power over its median in each window, (w, k)."""
    rate = capture.sample_rate_hz
    record = np.nan_to_num(capture.acceleration - np.nanmean(capture.acceleration, axis=0))
    length = 2 ** int(np.ceil(np.log2(_WINDOW_S * rate)))
    hop = max(length // 2, (len(record) - length) // _MOST_WINDOWS)
    starts = np.arange(0, len(record) - length + 1, hop)
    frequency = lines_of_dft(length, rate)
    frequency = frequency[frequency <= _HIGHEST_HZ]
    taper = np.kaiser(length, KAISER_BETA)[:, None]
    cuts = (np.fft.rfft(record[start : start + length] * taper, axis=0)[: len(frequency)] for start in starts)
    power = np.array([(np.abs(cut) ** 2).sum(axis=1) for cut in cuts]).reshape(len(starts), len(frequency))
    median = np.median(power[:, frequency >= _LOWEST_HZ], axis=1, keepdims=True)
    return (starts + length / 2) / rate, frequency, np.log(power / np.maximum(median, 1e-300) + 1e-9)


def _coarse_line(time_s: FloatArray, prominence: FloatArray) -> FloatArray:
    """Find the straight line, (w,) in lines of the spectrum, whose best stretch stands out most."""
    step = max(1, len(time_s) // _COARSE_WINDOWS)
    thin = _widened(prominence[::step])
    share = (time_s[::step] - time_s[0]) / (time_s[-1] - time_s[0])
    ends = np.arange(-_OVERHANG, prominence.shape[1] + _OVERHANG)
    score = np.array([_stretches(_gains(thin, begin + (ends[:, None] - begin) * share))[2] for begin in ends])
    alike = np.argwhere(score > 0.99 * score.max())
    first = np.array(np.unravel_index(int(score.argmax()), score.shape))
    begin, end = alike[(np.abs(alike - first) <= _NEAR_LINES).all(axis=1)].mean(axis=0) - _OVERHANG
    return np.asarray(begin + (end - begin) * (time_s - time_s[0]) / (time_s[-1] - time_s[0]))


def _widened(prominence: FloatArray) -> FloatArray:
    """Take the largest of each line and its neighbours: (w, k)."""
    padded = np.pad(prominence, ((0, 0), (1, 1)), mode="edge")
    return np.maximum(prominence, np.maximum(padded[:, 2:], padded[:, :-2]))


def _gains(prominence: FloatArray, lines: FloatArray) -> FloatArray:
    """Return what each window of (w, k) counts for each of many lines (l, w): (l, w)."""
    at = np.rint(lines).astype(int)
    inside = (at >= 2) & (at < prominence.shape[1])
    value = prominence[np.arange(len(prominence)), np.clip(at, 0, prominence.shape[1] - 1)]
    return np.where(inside, np.minimum(value - _STANDS_OUT, _AT_MOST), -_STANDS_OUT)


def _stretches(gain: FloatArray) -> tuple[IntArray, IntArray, FloatArray]:
    """Return first and last window of the stretch of each line (l, w) with the largest sum, and the sum: (l,) each."""
    total = np.cumsum(np.pad(gain, ((0, 0), (1, 0))), axis=1)
    rise = total - np.minimum.accumulate(total, axis=1)
    last = rise.argmax(axis=1)
    before = np.where(np.arange(total.shape[1]) <= last[:, None], total, np.inf).argmin(axis=1)
    return before, np.maximum(last - 1, before), rise.max(axis=1)


def _refined(time_s: FloatArray, frequency: FloatArray, prominence: FloatArray, line: FloatArray) -> FloatArray:
    """Fit a straight line to the highest points near the coarse one."""
    near = np.rint(line).astype(int)[:, None] + np.arange(-_NEAR_LINES, _NEAR_LINES + 1)
    rows = np.arange(len(line))
    value = prominence[rows[:, None], np.clip(near, 0, len(frequency) - 1)]
    value[(near < 1) | (near >= len(frequency))] = -np.inf
    top = near[rows, value.argmax(axis=1)]
    clear = value.max(axis=1) > _STANDS_OUT
    for _ in range(3):
        if clear.sum() < 3:
            return line
        fitted = np.polyval(np.polyfit(time_s[clear], top[clear], 1), time_s)
        clear &= np.abs(top - fitted) < 2.0
    return np.asarray(fitted)


def fitted_band(frequency_hz: FloatArray, swept: SweptBand | None) -> tuple[float, float]:
    """Return between which frequencies a test's spectrum is fitted: where it was excited, without the ends."""
    if swept is None:
        return LOWEST_HZ, HIGHEST_HZ
    low, high = swept.usable(float(frequency_hz[1] - frequency_hz[0]))
    return max(LOWEST_HZ, low), min(HIGHEST_HZ, high)


def segment_powers(capture: Capture, axes: list[int]) -> tuple[FloatArray, FloatArray]:
    """Return frequencies (k,) Hz and the power spectral density of each segment without gaps, (s, k) (m/s²)²/Hz."""
    rate = capture.sample_rate_hz
    length = 2 ** int(np.ceil(np.log2(_WINDOW_S * rate)))
    taper = np.kaiser(length, KAISER_BETA)
    starts = range(0, len(capture.time_s) - length + 1, length // 2)
    cuts = [capture.acceleration[start : start + length, axes] for start in starts]
    whole = [cut for cut in cuts if np.isfinite(cut).all()]
    if not whole:
        rule = f"There is no window of {length / rate:.2g} s without gaps; a spectrum needs at least one."
        raise MeasurementError(capture.source, [rule])
    spectra = [np.fft.rfft((cut - cut.mean(axis=0)) * taper[:, None], axis=0) for cut in whole]
    power = [2 * (np.abs(one) ** 2).sum(axis=1) / (rate * float(taper @ taper)) for one in spectra]
    return lines_of_dft(length, rate), np.array(power)


def swept_band_of_spectrum(frequency_hz: FloatArray, power: FloatArray) -> SweptBand | None:
    """Find the band of a test's sweep in its power along all axes; None: it ends where firmware's own tests do.

    Over f² the power drops at the end within a few lines, to far below what it has in the band, and does not come
    back. Above a resonance it falls too, but a sharp one falls from far above the band's level.
    """
    keep = (frequency_hz > _LOWEST_HZ) & (power > 0)
    f, level = frequency_hz[keep], np.log(power[keep] / frequency_hz[keep] ** 2)
    ends = [k for k in range(_DROP_LINES, len(f) - _DROP_LINES - 1) if _ends_at(f, level, k)]
    if not ends:
        return None
    last = next((k for k, following in pairwise(ends) if following != k + 1), ends[-1])
    return SweptBand(float(f[0]), float(f[last]))


def _ends_at(f: FloatArray, level: FloatArray, k: int) -> bool:
    """Return whether the level (n,), ln of power over f², drops behind line k as it does where a sweep ends."""
    if not _LOWEST_END_HZ <= f[k] <= _HIGHEST_END_HZ:
        return False
    within = float(np.median(level[: k + 1][f[: k + 1] >= _UNTOUCHED_HZ]))
    behind = float(level[k + _DROP_LINES :].max())
    return bool(level[k - 1 : k + 1].min() - behind > _DROP and behind < within + np.log(_BELOW))


def cut_off(frequency_hz: FloatArray, power: FloatArray, peak_hz: float, damping_ratio: float) -> bool:
    """Return whether the band ends before the peak at its upper end was passed: the power still stands there."""
    if peak_hz * (1 + damping_ratio) < frequency_hz[-1]:
        return False
    flank = power[frequency_hz >= min(peak_hz * (1 - damping_ratio), frequency_hz[-3])]
    return bool(power[-2:].max() > _STILL_HIGH * flank.max())
