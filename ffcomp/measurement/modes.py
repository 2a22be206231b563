"""Modes, with uncertainty, from power spectra alone: only the shape of the excitation's spectrum is known.

The spectrum is fitted, in logarithms, by the power of single-mode responses with real amplitudes over a floor,

    S(f) = e(f) | Σ_j ±√a_j / (1 − (f/f_j)² + 2i ζ_j f/f_j) + √b |² + c ,   seen through the window's |W|².

The responses are added before the power is taken: where two modes cancel, the spectrum has a notch that no sum of
powers has (38 and 82 Hz side by side: a factor 16 at 48 Hz, and the first mode 1.2 Hz off).

The excitation e and the window W are those of `modal.py`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.signal import find_peaks

from ffcomp.errors import MeasurementError
from ffcomp.measurement.capture import Capture
from ffcomp.measurement.estimators import lines_of_dft
from ffcomp.measurement.klipper import Resonances
from ffcomp.measurement.modal import KAISER_BETA, WindowedPower, single_modes, slopes_of_modes
from ffcomp.measurement.swept import SweptBand, cut_off, swept_band, swept_band_of_spectrum
from ffcomp.numerics.least_squares import minimise
from ffcomp.numerics.serialise import keys
from models.arrays import FloatArray

LOWEST_HZ, HIGHEST_HZ = 10.0, 130.0  # Klipper's sweep ends at 133 Hz; below 10 Hz its spectra are attenuated
_MOST_MODES = 5
_DAMPING = (0.005, 0.5)
_BLOCKS = 4  # interleaved groups of segments of a capture
_WINDOW_S = 0.5
_SHARE = 0.02  # of the largest peak: lower ones are not reported as modes
_BROADEST = 0.3  # damping ratio; broader ones are a slope of the floor
_START_DAMPING = 0.05
_TOPS = 2  # tried for each further mode
_FULL_WEIGHT = 0.03  # of the largest power
_TONE_WIDTH = 0.7  # half-power width in lines
_GOOD_MISFIT = 0.35  # rms of ln S
_CLEAR_FREQUENCY = 0.03  # relative standard uncertainty
_SAME_MODE = 0.05  # relative distance of frequencies
_CANCELLING = 1.5  # times the spectrum's top
_BETTER_BIC = 4.0  # for one more mode
_SPARE_LINES = 12  # beyond the unknowns


@dataclass(frozen=True)
class Mode:
    """One resonance of a spectrum."""

    json_keys: ClassVar = keys("frequency_hz", "frequency_sd_hz", "damping_ratio", "damping_ratio_sd", "power", "clear")

    frequency_hz: float
    frequency_sd_hz: float
    damping_ratio: float
    damping_ratio_sd: float
    power: float  # height of its peak in the spectrum, relative to the largest
    tone: bool = False  # as narrow as the spectrum's own resolution: rather a motor or a fan than a mode

    @property
    def clear(self) -> bool:
        """Whether the frequency is known to 3 % and the mode is no tone."""
        return self.frequency_sd_hz < _CLEAR_FREQUENCY * self.frequency_hz and not self.tone


@dataclass(frozen=True, eq=False)
class ModeFit:
    """The modes of one spectrum, the strongest first, and the quality of the fit."""

    json_keys: ClassVar = keys("signal", "verdict", "misfit", "modes", file="source")

    source: str
    signal: str
    modes: tuple[Mode, ...]
    frequency_hz: FloatArray  # (k,) Hz, of the fitted lines
    power: FloatArray  # (k,)
    fitted: FloatArray  # (k,)
    misfit: float  # rms of ln(power / fitted) where there is power
    verdict: str  # a sentence
    swept: SweptBand | None = None  # None: not known
    axis: str = ""  # excited, if known


def modes_in(test: Capture | Resonances, signal: str | None = None, axis: str | None = None) -> ModeFit:
    """Fit the modes in spectra or in a capture; `signal` x, y, z, xyz or a set's name, `axis` the excited one.

    Without `signal` it is the excited axis, if the file states it, else the sum of all; of several spectra that no
    rule separates none is taken. A capture with a sweep in it was excited with a power that grows with f², within
    the sweep's band; any other counts as excited evenly.

    Raises
    ------
    MeasurementError
        If there is no such spectrum, or which one is not said.
    """
    excited = axis or test.axis or ""
    if isinstance(test, Capture):
        along = excited if _strongest(test.acceleration) == excited else "xyz"
        return replace(_capture_modes(test, signal or along), axis=excited)
    name = test.chosen(signal)
    frequency, power = test.power(name)
    swept = swept_band_of_spectrum(*test.total)
    return replace(fit_modes(frequency, power, swept=swept, source=test.source, signal=name), axis=excited)


def _strongest(acceleration: FloatArray) -> str:
    """Return the sensor's axis that moves most: where it is not the excited one, the sensor is mounted otherwise."""
    return "xyz"[int(np.argmax(np.nanstd(acceleration, axis=0)))]


def fit_modes(
    frequency_hz: FloatArray,
    power: FloatArray,
    *,
    excitation_exponent: float = 2.0,
    swept: SweptBand | None = None,
    source: str = "",
    signal: str = "",
) -> ModeFit:
    """Fit the modes of a power spectrum made with a Kaiser window (β = 6) of one line's width.

    Modes are added one by one where the spectrum stands highest above the fit, as long as the Bayesian information
    criterion gets better. The uncertainties are those of least squares, widened for correlated residuals.

    Parameters
    ----------
    frequency_hz : (k,) evenly spaced; rounding as in Klipper's files is undone.
    power : (k,) power spectral density of the acceleration.
    excitation_exponent : e(f) = f to this power.
    swept : the band that was excited, where it is known; there are no modes outside and at its ends
    """
    lowest_hz, highest_hz = fitted_band(frequency_hz, swept)
    keep = (frequency_hz >= lowest_hz) & (frequency_hz <= highest_hz) & (power > 0)
    if keep.sum() < _SPARE_LINES + 5:
        rule = f"There are {keep.sum()} lines with power between {lowest_hz:g} and {highest_hz:g} Hz"
        raise MeasurementError(source, [f"{rule}; a fit needs at least {_SPARE_LINES + 5}."])
    even = np.linspace(frequency_hz[0], frequency_hz[-1], len(frequency_hz))
    model = _Model(even[keep], float(even[1] - even[0]), excitation_exponent)
    target = np.log(power[keep])
    best = model.fit(target, np.empty((0, 3)), np.empty(0))
    while len(best.peaks) < _MOST_MODES and best.spare > _SPARE_LINES + 3:
        wider = [fit for start in model.with_another(best) if model.plausible(fit := model.fit(target, *start))]
        if not wider or min(fit.bic for fit in wider) >= best.bic - _BETTER_BIC:
            break
        best = min(wider, key=lambda fit: fit.bic)
    modes = _modes(model, best, float(even[1] - even[0]))
    if swept is not None and swept.high_hz < HIGHEST_HZ:
        modes = tuple(m for m in modes if not cut_off(even[keep], power[keep], m.frequency_hz, m.damping_ratio))
    return ModeFit(
        source=source,
        signal=signal,
        modes=modes,
        frequency_hz=frequency_hz[keep],
        power=power[keep],
        fitted=np.exp(target - best.residual),
        misfit=best.misfit,
        verdict=_verdict(modes, best.misfit, swept),
        swept=swept,
    )


def fitted_band(frequency_hz: FloatArray, swept: SweptBand | None) -> tuple[float, float]:
    """Return between which frequencies a test's spectrum is fitted: where it was excited, without the ends."""
    if swept is None:
        return LOWEST_HZ, HIGHEST_HZ
    low, high = swept.usable(float(frequency_hz[1] - frequency_hz[0]))
    return max(LOWEST_HZ, low), min(HIGHEST_HZ, high)


@dataclass(frozen=True, eq=False)
class _Fit:
    peaks: FloatArray  # (p, 3): ln a, ln f, ln ζ
    signs: FloatArray  # (p,) of the amplitudes, ±1
    target: FloatArray  # (k,) ln S
    weight: FloatArray  # (k,) of each line in the fit
    residual: FloatArray  # (k,) of ln S
    jacobian: FloatArray  # (k, 3 p + 2)

    @property
    def unknowns(self) -> int:
        return 3 * len(self.peaks) + 2

    @property
    def spare(self) -> int:
        return len(self.residual) - self.unknowns

    @property
    def independent(self) -> float:
        """Number of independent residuals: neighbours are correlated by window and by model error."""
        r = self.weight * self.residual
        rho = float(np.clip((r[1:] @ r[:-1]) / max(float(r @ r), 1e-300), 0.0, 0.9))
        return len(r) * (1 - rho) / (1 + rho)

    @property
    def bic(self) -> float:
        n = len(self.residual)
        return float(n * np.log(self.misfit**2 + 1e-12) + self.unknowns * np.log(n))

    @property
    def misfit(self) -> float:
        """The rms of the residual where the spectrum is strong."""
        return float(np.sqrt(((self.weight * self.residual) ** 2).sum() / (self.weight**2).sum()))


class _Model:
    """ln S at the lines of a spectrum, of ln a, ln f, ln ζ a peak, then ln b and ln c; the peaks' signs are given."""

    def __init__(self, frequency_hz: FloatArray, line_hz: float, exponent: float) -> None:
        self.frequency_hz = frequency_hz  # (k,)
        self._line_hz = line_hz
        self._lines = WindowedPower(frequency_hz, line_hz, exponent)

    def fit(self, target: FloatArray, peaks: FloatArray, signs: FloatArray) -> _Fit:
        """Fit ln S, (k,), starting from peaks (p, 3)."""
        weight = _weight(target)
        start = np.concatenate([peaks.ravel(), [target.min() - 1, target.min() - 1]])
        low, high = start - 30, start + 30
        low[1:-2:3], high[1:-2:3] = np.log(self.frequency_hz[[0, -1]])
        low[2:-2:3], high[2:-2:3] = np.log(_DAMPING)
        # NOTE: soft_l1, because a spectrum has single lines (fans, steppers) that no mode explains
        solution = minimise(
            lambda p: weight * (target - self.log(p, signs)),
            np.clip(start, low + 1e-9, high - 1e-9),
            lambda p: -weight[:, None] * self.slopes(p, signs),
            evaluations=60,
            bounds=(low, high),
            scaled=False,
            robust=True,
        )
        residual = target - self.log(solution.x, signs)
        return _Fit(solution.x[:-2].reshape(-1, 3), signs, target, weight, residual, self.slopes(solution.x, signs))

    def log(self, parameters: FloatArray, signs: FloatArray) -> FloatArray:
        """Predict ln S, (k,)."""
        frequency, damping, amplitude, root = _peaks(parameters, signs)
        response = np.tensordot(amplitude, single_modes(frequency, damping, self._lines.fine_hz), axes=1) + root
        return np.log(self._lines.power(response) + np.exp(parameters[-1]))

    def slopes(self, parameters: FloatArray, signs: FloatArray) -> FloatArray:
        """Differentiate ln S by the parameters, (k, 3 p + 2), in closed form."""
        frequency, damping, amplitude, root = _peaks(parameters, signs)
        fine = self._lines.fine_hz
        parts = amplitude[:, None, None] * single_modes(frequency, damping, fine)
        response = parts.sum(axis=0) + root
        by_shape = slopes_of_modes(frequency, damping, amplitude, fine).reshape(-1, 2, *fine.shape)
        by_peak = np.concatenate([parts[:, None] / 2, by_shape], axis=1).reshape(-1, *fine.shape)
        derivatives = np.concatenate([by_peak, np.full((1, *fine.shape), root / 2, dtype=np.complex128)])
        floor = np.exp(parameters[-1])
        power = self._lines.power(response) + floor
        return (
            np.column_stack([*self._lines.slopes(response, derivatives), np.full(len(power), floor)]) / power[:, None]
        )

    def height(self, peak: FloatArray) -> float:
        """Return the most that a peak alone, (3,), adds to S in the band."""
        return float(np.exp(self.log(np.concatenate([peak, [-200.0, -200.0]]), np.ones(1)).max()))

    def plausible(self, fit: _Fit) -> bool:
        """Tell whether no two peaks merely cancel: nearer than a line, or one far higher than the spectrum."""
        positions = np.sort(np.exp(fit.peaks[:, 1]))
        highest = max(self.height(peak) for peak in fit.peaks)
        apart = bool((np.diff(positions) > self._line_hz).all())
        return apart and highest < _CANCELLING * float(np.exp(fit.target.max()))

    def with_another(self, fit: _Fit) -> list[tuple[FloatArray, FloatArray]]:
        """Add a peak, (p + 1, 3), where the spectrum stands highest above the fit, with either sign."""
        smooth = gaussian_filter1d(fit.residual, 1.0)
        tops, _ = find_peaks(smooth)
        starts = []
        for at in tops[np.argsort(-smooth[tops])][:_TOPS]:
            height = float(fit.target[at] - np.log(self._lines.excitation[at].mean()))
            new = [height + 2 * np.log(2 * _START_DAMPING), np.log(self.frequency_hz[at]), np.log(_START_DAMPING)]
            starts += [(np.vstack([fit.peaks, new]), np.append(fit.signs, sign)) for sign in (1.0, -1.0)]
        return starts


def _weight(target: FloatArray) -> FloatArray:
    """Weight lines by their power up to a share of the largest: modes matter, not the notches between."""
    power = np.exp(target - target.max())
    return np.asarray(np.sqrt(power / (power + _FULL_WEIGHT)))


def _peaks(parameters: FloatArray, signs: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """Return frequencies, damping ratios and amplitudes (p,), and √b."""
    log_a, log_f, log_zeta = parameters[:-2].reshape(-1, 3).T
    return np.exp(log_f), np.exp(log_zeta), signs * np.exp(log_a / 2), float(np.exp(parameters[-2] / 2))


def _modes(model: _Model, fit: _Fit, line_hz: float) -> tuple[Mode, ...]:
    """Select the peaks that are modes, the strongest first."""
    weighted = fit.weight[:, None] * fit.jacobian
    scatter = float(((fit.weight * fit.residual) ** 2).sum()) / fit.spare * len(fit.residual) / fit.independent
    covariance = scatter * np.linalg.pinv(weighted.T @ weighted, rcond=1e-12, hermitian=True)
    sd = np.sqrt(np.maximum(np.diag(covariance), 0.0))[:-2].reshape(-1, 3)
    heights = np.array([model.height(peak) for peak in fit.peaks])
    modes = []
    for (_, log_f, log_zeta), (_, sd_f, sd_zeta), height in zip(fit.peaks, sd, heights, strict=True):
        frequency, zeta = float(np.exp(log_f)), float(np.exp(log_zeta))
        inside = model.frequency_hz[0] + line_hz < frequency < model.frequency_hz[-1] - line_hz
        if inside and zeta < _BROADEST and height > _SHARE * heights.max():
            tone = 2 * zeta * frequency < _TONE_WIDTH * line_hz
            mode = Mode(
                frequency, float(frequency * sd_f), zeta, float(zeta * sd_zeta), float(height / heights.max()), tone
            )
            modes.append(mode)
    return tuple(sorted(modes, key=lambda mode: -mode.power))


def _verdict(modes: tuple[Mode, ...], misfit: float, swept: SweptBand | None) -> str:
    clear = [mode for mode in modes if mode.clear]
    if not modes and swept is not None and swept.high_hz < HIGHEST_HZ:
        return f"No mode lies within the swept band. {swept.remedy}"
    if not modes:
        return "No mode stands out of the spectrum: its peaks are too broad, too low or at the band's edges."
    listed = ", ".join(f"{mode.frequency_hz:.1f} Hz" for mode in sorted(clear, key=lambda mode: mode.frequency_hz))
    quality = "well" if misfit < _GOOD_MISFIT else f"only to a factor of {np.exp(misfit):.1f}"
    if not clear:
        kind = "a narrow tone (a motor, a fan)" if all(mode.tone for mode in modes) else "too uncertain to be used"
        return f"No clear mode: the largest peak is {kind}. The spectrum is fitted {quality}."
    return f"Clear: {listed}; {len(modes) - len(clear)} more are uncertain or tones. The spectrum is fitted {quality}."


def _capture_modes(capture: Capture, signal: str) -> ModeFit:
    axes = (
        ["xyz".index(letter) for letter in signal if letter in "xyz"] if signal in ("x", "y", "z", "xyz") else [0, 1, 2]
    )
    frequency, segments = segment_powers(capture, axes)
    swept = swept_band(capture)
    exponent = 0.0 if swept is None and "raw_data" not in Path(capture.source).name else 2.0
    whole = fit_modes(
        frequency,
        segments.mean(axis=0),
        excitation_exponent=exponent,
        swept=swept,
        source=capture.source,
        signal=signal,
    )
    if len(segments) < 2 * _BLOCKS:
        return whole
    blocks = [
        fit_modes(frequency, segments[k::_BLOCKS].mean(axis=0), excitation_exponent=exponent, swept=swept)
        for k in range(_BLOCKS)
    ]
    modes = tuple(_with_block_spread(mode, blocks) for mode in whole.modes)
    return replace(whole, modes=modes, verdict=_verdict(modes, whole.misfit, swept))


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


def _with_block_spread(mode: Mode, blocks: list[ModeFit]) -> Mode:
    """Take the larger of the fit's uncertainties and of the scatter of interleaved parts of the record.

    Parts overlap by half a window with their neighbours, which makes them agree a little too well.
    """
    nearest = [
        min(block.modes, key=lambda other: abs(other.frequency_hz - mode.frequency_hz))
        for block in blocks
        if block.modes
    ]
    near = [other for other in nearest if abs(other.frequency_hz / mode.frequency_hz - 1) < _SAME_MODE]
    if len(near) < _BLOCKS - 1:
        return replace(mode, frequency_sd_hz=max(mode.frequency_sd_hz, _SAME_MODE * mode.frequency_hz))
    spread = [
        np.std([getattr(o, key) for o in near], ddof=1) / len(near) ** 0.5 for key in ("frequency_hz", "damping_ratio")
    ]
    return replace(
        mode,
        frequency_sd_hz=max(mode.frequency_sd_hz, float(spread[0])),
        damping_ratio_sd=max(mode.damping_ratio_sd, float(spread[1])),
    )
