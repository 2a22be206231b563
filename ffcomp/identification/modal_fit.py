"""The modes of a cartesian machine's axes, one or two each, from all measurements along them.

    H(f) = Σ_j σ_j / (1 − (f/f_j)² + 2i ζ_j f/f_j),   σ₁ + σ₂ = 1

is the response of an axis to its command (`models/vibration/modal.py`). A frequency response shows g e^(−iωτ) H: the
sensor's gain g and a delay τ are fitted along with it. A spectrum of a firmware's resonance test shows g f² |H|² + c
through the window's |W|²: the test excites with a power that grows with f², and the share of a second mode follows from
its height against the first one's and from the dip between them.

    minimise  Σ r²/v(ε),   v = (σ² + ε²|H|²)/2 of the real and the imaginary part,   v = ε² (1 + P/S) + σ² of ln S

σ² is the noise, ε the model's own error, chosen for each file such that χ² has its expected value. A second mode is
accepted only where the Bayesian information criterion asks for it, with correlated residuals counted as fewer, and
where its frequency and its share are sharp.

How much of the damping belts hold is not fitted. A share s multiplies each mode by 1 + 2i ζ_j s f/f_j, to first order a
delay, which each response has of its own; what is left is about (2 ζ f/f_j)² s. `belts_share_error` says how sharp s
could be.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.signal import find_peaks

from ffcomp.errors import MeasurementError
from ffcomp.identification.axis_spectra import COARSE, Datum, Response, Spectrum
from ffcomp.identification.uncertainty import NINETY_PERCENT, Estimate, lognormal, normal
from ffcomp.measurement.modal import SMALLEST_ERROR, independent_share, model_error, single_modes
from ffcomp.numerics.least_squares import minimise
from models.arrays import ComplexArray, FloatArray

START_DAMPING = 0.06
DAMPINGS = (0.002, 0.7)
SHARES = (0.01, 0.99)  # searched
SMALLEST_SHARE = 0.02  # accepted
SEARCHED = 12  # steps of least squares from each start
START_SHARE = 0.8  # of the first of two modes
STARTS, PEAKS = 6, 2  # frequencies tried for each mode: evenly over the band, and where the data stand highest
OUTSIDE = 1.3  # how far beyond the band a mode may be looked for, a factor
BROADEST = 0.4  # damping ratio of a resonance
ROUNDS = 10  # of fitting and reweighting
BETTER_BIC = 2.0  # by which a second mode must win
MANY_MODES = 0.2  # model error from which there are more modes than two
PEAK_BAND = 1.45  # the band around a peak that is fitted by itself, a factor to each side
FEWEST_AT_PEAK = 12  # lines
CLEAR = 0.05  # relative standard uncertainty of a frequency
SHARP = 2.0  # standard uncertainties that a share must be away from zero
WEAK_DAMPING = 0.25  # relative standard uncertainty from which the user is warned
POOR_FIT = 0.35  # model error from which the user is warned
APART = 0.05  # relative distance of frequencies by which two files disagree


@dataclass(frozen=True)
class AxisMode:
    """One mode of an axis."""

    frequency_hz: Estimate  # ESTIMATE: axes: one or two modes of each axis
    damping_ratio: Estimate  # ESTIMATE
    share: Estimate  # ESTIMATE


@dataclass(frozen=True, eq=False)
class AxisFit:
    """The modes of one axis, and the data they are from."""

    name: str  # x, y or z
    modes: tuple[AxisMode, ...]  # the larger share first
    data: tuple[Datum, ...]
    fitted: tuple[FloatArray | ComplexArray, ...]  # of each datum, as it was measured
    errors: tuple[float, ...]  # of each datum, the model's own: 0.1 is 10 %
    verdict: str  # a sentence: why so many modes
    advice: tuple[str, ...]


# ---- the fit of one axis -------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Fit:
    data: Sequence[Datum]
    theta: FloatArray  # ln f, ln ζ of each mode, then the first's share if there are two, then two of each datum
    count: int  # of modes
    errors: FloatArray  # (d,)

    @property
    def modes(self) -> FloatArray:
        return _modes(self.theta, self.count)

    @property
    def nuisances(self) -> FloatArray:
        """(d, 2) nuisance parameters of each datum."""
        return self.theta[_of_modes(self.count) :].reshape(-1, 2)

    @cached_property
    def residuals(self) -> list[FloatArray]:
        """Of each datum, over the standard deviation."""
        return _residuals(self.data, self.theta, self.count, self.errors)

    @cached_property
    def independent(self) -> FloatArray:
        """(d,) the share of each datum's residuals that is independent."""
        return np.array(
            [independent_share(r, len(d.frequency_hz)) for r, d in zip(self.residuals, self.data, strict=True)]
        )

    @cached_property
    def covariance(self) -> FloatArray:
        """(p, p) of theta."""
        rows = np.concatenate([np.full(len(r), n) for r, n in zip(self.residuals, self.independent, strict=True)])
        j = _jacobian(self.data, self.theta, self.count, self.errors)
        return np.linalg.pinv((j * rows[:, None]).T @ j, rcond=1e-13, hermitian=True)

    def deviance(self, shares: FloatArray) -> float:
        """Return −2 ln likelihood, each datum's residuals counted by its share (d,)."""
        variances = [d.variance(e) for d, e in zip(self.data, self.errors, strict=True)]
        each = [float(np.sum(r**2 + np.log(v))) for r, v in zip(self.residuals, variances, strict=True)]
        return float(shares @ np.array(each))


def fit_axis(name: str, data: Sequence[Datum]) -> AxisFit:
    """Fit one mode or two, whichever the data ask for.

    Raises
    ------
    MeasurementError
        If no resonance lies within the measured band.
    """
    accepted, verdict = _one_or_two(name, data)
    accepted, verdict = _at_the_peak(name, accepted, verdict)
    _within(name, accepted)
    modes, disagreement = _with_scatter(name, _estimated(accepted), accepted)
    remarks = [
        text for datum, nuisances in zip(data, accepted.nuisances, strict=True) for text in datum.remarks(nuisances)
    ]
    fitted = tuple(
        datum.model(accepted.modes, nuisances) for datum, nuisances in zip(data, accepted.nuisances, strict=True)
    )
    errors = tuple(float(e) if e > SMALLEST_ERROR else 0.0 for e in accepted.errors)
    advice = (*disagreement, *_weak(name, modes, errors), *remarks, *_about_belts(name, accepted))
    return AxisFit(name, modes, tuple(data), fitted, errors, verdict, advice)


def _one_or_two(name: str, data: Sequence[Datum]) -> tuple[_Fit, str]:
    """Fit one mode and two, and return the accepted fit, and why."""
    peaks = _peaks(data)
    starts = [*peaks, *_even(data)]
    one = _refined(_searched(data, starts, 1))
    firsts = [np.log(one.modes[:, :2]), *peaks]
    two = _refined(_searched(data, [np.vstack([first, second]) for first in firsts for second in starts], 2))
    return _accepted(name, one, two)


def _at_the_peak(name: str, wide: _Fit, verdict: str) -> tuple[_Fit, str]:
    """Fit the highest peak by itself where two modes do not hold what the whole band shows.

    Otherwise what is left of other modes pulls the main one off its peak, by up to a tenth. The errors stay those of
    the whole band.
    """
    spectra = [datum for datum in wide.data if isinstance(datum, Spectrum)]
    if len(spectra) < len(wide.data) or wide.errors.max() < MANY_MODES:
        return wide, verdict
    near = [spectrum.around_peak(PEAK_BAND) for spectrum in spectra]
    if min(len(spectrum.frequency_hz) for spectrum in near) < FEWEST_AT_PEAK:
        return wide, verdict
    local, _ = _one_or_two(name, near)
    low, high = _band(near)
    if not low < local.modes[np.argmax(local.modes[:, 2]), 0] < high:
        return wide, verdict
    theta = np.concatenate([local.theta[: _of_modes(local.count)], *(datum.begin(local.modes) for datum in wide.data)])
    sentence = (
        f"{name} has more modes than two in its band; the highest peak is fitted by itself, {low:.0f} to {high:.0f} Hz."
    )
    return _Fit(wide.data, theta, local.count, _model_errors(wide.data, theta, local.count)), sentence


def _modes(theta: FloatArray, count: int) -> FloatArray:
    """Return (m, 3) frequency, damping ratio, share."""
    shares = [1.0] if count == 1 else [theta[4], 1 - theta[4]]
    return np.column_stack([np.exp(theta[: 2 * count].reshape(count, 2)), shares])


def _of_modes(count: int) -> int:
    """Count the parameters of so many modes."""
    return 3 * count - 1


def _band(data: Sequence[Datum]) -> tuple[float, float]:
    return min(float(d.frequency_hz[0]) for d in data), max(float(d.frequency_hz[-1]) for d in data)


def _even(data: Sequence[Datum]) -> list[FloatArray]:
    """Return starts (1, 2), ln f and ln ζ, evenly over the band."""
    low, high = _band(data)
    return [np.log([[f, START_DAMPING]]) for f in np.geomspace(1.2 * low, 0.95 * high, STARTS)]


def _peaks(data: Sequence[Datum]) -> list[FloatArray]:
    """Return starts (1, 2) where the first datum stands highest; half levelled, for noise rises when levelled."""
    answer = gaussian_filter1d(np.log(np.abs(data[0].value) * np.sqrt(data[0].level) + 1e-300), 1.0)
    tops, _ = find_peaks(answer)
    return [np.log([[data[0].frequency_hz[at], START_DAMPING]]) for at in tops[np.argsort(-answer[tops])][:PEAKS]]


def _searched(data: Sequence[Datum], starts: Sequence[FloatArray], count: int) -> _Fit:
    """Fit coarsely from each of the modes (m, 2), all files weighted alike; return the best."""
    equal = np.full(len(data), COARSE)
    fits = []
    for start in starts:
        begin = np.concatenate([start.ravel(), [START_SHARE] * (count - 1)])
        nuisances = [datum.begin(_modes(begin, count)) for datum in data]
        fits.append(
            _Fit(data, _solved(data, np.concatenate([begin, *nuisances]), count, equal, SEARCHED), count, equal)
        )
    return min(fits, key=lambda fit: sum(float(r @ r) for r in fit.residuals))


def _refined(fit: _Fit) -> _Fit:
    """Fit and reweight until the files' errors converge."""
    data, theta, count, errors = fit.data, fit.theta, fit.count, fit.errors
    for _ in range(ROUNDS):
        theta = _solved(data, theta, count, errors)
        before, errors = errors, _model_errors(data, theta, count)
        if np.abs(errors - before).max() < 0.02 * errors.max():
            break
    return _Fit(data, theta, count, errors)


def _solved(
    data: Sequence[Datum], theta: FloatArray, count: int, errors: FloatArray, evaluations: int = 60
) -> FloatArray:
    limits = np.concatenate([datum.limits for datum in data])
    free = np.full(_of_modes(count), np.inf)
    low, high = np.concatenate([-free, limits[:, 0]]), np.concatenate([free, limits[:, 1]])
    bottom, top = _band(data)
    for mode in range(count):
        low[2 * mode : 2 * mode + 2] = np.log([bottom / OUTSIDE, DAMPINGS[0]])
        high[2 * mode : 2 * mode + 2] = np.log([top * OUTSIDE, DAMPINGS[1]])
    if count == 2:
        low[4], high[4] = SHARES
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):  # of a step too far, which is taken back
        solution = minimise(
            lambda at: np.concatenate(_residuals(data, at, count, errors)),
            np.clip(theta, low + 1e-9, high - 1e-9),
            lambda at: _jacobian(data, at, count, errors),
            evaluations=evaluations,
            bounds=(low, high),
        )
    return solution.x


def _residuals(data: Sequence[Datum], theta: FloatArray, count: int, errors: FloatArray) -> list[FloatArray]:
    modes, nuisances = _modes(theta, count), theta[_of_modes(count) :].reshape(-1, 2)
    return [
        d.residual(modes, each) / np.sqrt(d.variance(e)) for d, each, e in zip(data, nuisances, errors, strict=True)
    ]


def _jacobian(data: Sequence[Datum], theta: FloatArray, count: int, errors: FloatArray) -> FloatArray:
    """Stack the derivatives of all files' residuals, (n, p)."""
    p = _of_modes(count)
    modes, nuisances = _modes(theta, count), theta[p:].reshape(-1, 2)
    blocks = []
    for i, (datum, each, error) in enumerate(zip(data, nuisances, errors, strict=True)):
        slopes = datum.slopes(modes, each) / np.sqrt(datum.variance(error))[:, None]
        block = np.zeros((len(slopes), len(theta)))
        block[:, :p], block[:, p + 2 * i : p + 2 * i + 2] = slopes[:, :p], slopes[:, p:]
        blocks.append(block)
    return np.concatenate(blocks)


def _model_errors(data: Sequence[Datum], theta: FloatArray, count: int) -> FloatArray:
    """Find the ε, (d,), that gives each file's χ² its expected value; the smallest one where noise explains it all."""
    modes, nuisances = _modes(theta, count), theta[_of_modes(count) :].reshape(-1, 2)
    used = _of_modes(count) / len(data) + 2
    return np.array(
        [model_error(d.residual(modes, each), d.variance, used) for d, each in zip(data, nuisances, strict=True)]
    )


# ---- one mode or two -----------------------------------------------------------------------------


def _within(name: str, fit: _Fit) -> None:
    low, high = _band(fit.data)
    frequency, damping = (float(value) for value in fit.modes[np.argmax(fit.modes[:, 2]), :2])
    remedies = [datum.beyond(frequency, damping) for datum in fit.data]
    if low < frequency < high and damping < BROADEST and not all(remedies):
        return
    sources = ", ".join(dict.fromkeys(Path(d.source).name for d in fit.data))
    rule = f"No resonance of {name} stands out between {low:.0f} and {high:.0f} Hz: [axes.{name}] stays as it was"
    raise MeasurementError(sources, [f"{rule}. {remedies[0] or 'Try a wider band, or a harder excitation.'}"])


def _accepted(name: str, one: _Fit, two: _Fit) -> tuple[_Fit, str]:
    """Return the accepted fit, and why."""
    lines = float(two.independent @ [len(r) for r in two.residuals])
    gain = one.deviance(two.independent) - two.deviance(two.independent) - 3 * float(np.log(max(lines, 2.0)))
    if gain < BETTER_BIC:
        return one, f"One mode describes {name}: a second one explains no more than chance would."
    problem = _unclear(two)
    if problem:
        return one, f"One mode is kept for {name}; there is more in the data, but {problem}."
    return two, f"Two modes describe {name} (Bayesian information criterion: {gain:.0f} in favour of the second)."


def _unclear(two: _Fit) -> str:
    """Say what is wrong with a second mode; '' if it may be accepted."""
    sd = np.sqrt(np.diag(two.covariance))
    share, low, high = float(two.theta[4]), *_band(two.data)
    other = int(share > 0.5)
    frequency = float(two.modes[other, 0])
    where = f"at {frequency:.0f} Hz"
    if min(share, 1 - share) < max(SMALLEST_SHARE, SHARP * sd[4]):
        return f"the share of the mode {where} is not known better than {min(share, 1 - share):.2f} ± {sd[4]:.2f}"
    if max(sd[0], sd[2]) > CLEAR or not low < frequency < high or two.modes[:, 1].max() > BROADEST:
        return f"the one {where} is too uncertain or too broad to be a mode"
    return ""


def _estimated(fit: _Fit) -> tuple[AxisMode, ...]:
    sd = np.sqrt(np.diag(fit.covariance))
    share_sd = float(sd[4]) if fit.count == 2 else 0.0
    modes = [
        AxisMode(
            lognormal(float(frequency), float(sd[2 * i])),
            lognormal(float(damping), float(sd[2 * i + 1])),
            normal(float(share), share_sd),
        )
        for i, (frequency, damping, share) in enumerate(fit.modes)
    ]
    return tuple(sorted(modes, key=lambda mode: -mode.share.value))


def _with_scatter(name: str, modes: tuple[AxisMode, ...], fit: _Fit) -> tuple[tuple[AxisMode, ...], list[str]]:
    """Fit each file by itself, and widen the main mode's uncertainty to their scatter."""
    if len(fit.data) < 2:
        return modes, []
    main, files = modes[0].frequency_hz, len(fit.data)
    alone = [_main_frequency([datum], fit) for datum in fit.data]
    scatter = float(np.std(np.log(alone), ddof=1)) / np.sqrt(files)
    sure = lognormal(main.value, max(main.relative_sd, scatter))
    advice = []
    if max(alone) / min(alone) - 1 > APART:
        listed = ", ".join(f"{f:.1f} Hz in {Path(d.source).name}" for f, d in zip(alone, fit.data, strict=True))
        advice = [f"The files disagree about {name}: {listed}. Was it the same machine, at one position?"]
    return (replace(modes[0], frequency_hz=sure), *modes[1:]), advice


def _main_frequency(data: Sequence[Datum], fit: _Fit) -> float:
    """Return the frequency of the mode with the largest share, fitted to one file by itself, Hz."""
    begin = fit.theta[: _of_modes(fit.count)]
    theta = np.concatenate([begin, *(datum.begin(fit.modes) for datum in data)])
    solution = _solved(data, theta, fit.count, np.full(len(data), COARSE))
    modes = _modes(solution, fit.count)
    return float(modes[np.argmax(modes[:, 2]), 0])


def _weak(name: str, modes: Sequence[AxisMode], errors: Sequence[float]) -> list[str]:
    advice = [
        f"The damping of {name} at {mode.frequency_hz.value:.0f} Hz is known to "
        f"{100 * mode.damping_ratio.relative_sd:.0f} % only: measure it again, excited harder or longer."
        for mode in modes
        if mode.damping_ratio.relative_sd > WEAK_DAMPING
    ]
    if max(errors) > POOR_FIT:
        advice.append(
            f"The modes describe {name} poorly, to {100 * max(errors):.0f} % of the measurement: it has more modes "
            "than a machine file holds, or it rattles. Look at it with --figure."
        )
    return advice


def _about_belts(name: str, fit: _Fit) -> list[str]:
    """Say that the belts' share of the damping stays open, where responses could have shown it."""
    if not any(isinstance(datum, Response) for datum in fit.data):
        return []
    half = NINETY_PERCENT * belts_share_error(fit)
    known = (
        "is not determined by these responses: of 0 to 1 they leave all open"
        if half >= 0.5
        else f"is not fitted: these responses would show it to ±{half:.2f} if two modes were all there is"
    )
    return [
        f"How much of the damping of {name} its belts hold (belt_damping_share) {known}, for below the resonance it "
        "looks like a delay. ffcomp diagnose finds it in runs with their commands, as the effect belt_damping."
    ]


def belts_share_error(fit: _Fit) -> float:
    """Return the standard deviation of the belts' share about one half, everything else fitted too (Fisher)."""
    modes, columns, weights = fit.modes, [], []
    for datum, nuisances, error, own in zip(fit.data, fit.nuisances, fit.errors, fit.independent, strict=True):
        slope = np.zeros(len(datum.variance(error)))  # of a spectrum: it has no phase
        if isinstance(datum, Response):
            turned = 2j * modes[:1, 1:2] * datum.frequency_hz / modes[:1, :1]  # as its springs, belts drive all modes
            each = modes[:, 2:] * single_modes(modes[:, 0], modes[:, 1], datum.frequency_hz)
            by_share = (each * turned).sum(axis=0) / (each * (1 + turned / 2)).sum(axis=0)
            column = datum.model(modes, nuisances) * by_share
            slope = np.concatenate([column.real, column.imag])
        columns.append(slope / np.sqrt(datum.variance(error)))
        weights.append(np.full(len(slope), own))
    slope, weight = np.concatenate(columns), np.concatenate(weights)
    j = _jacobian(fit.data, fit.theta, fit.count, fit.errors)
    left = slope - j @ (fit.covariance @ (j.T @ (weight * slope)))
    return float(1 / np.sqrt(max(float(slope @ (weight * left)), 1e-300)))
