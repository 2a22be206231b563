"""The modes of a cartesian machine's axes, one or two each, from all measurements along them.

    H(f) = Σ_j σ_j / (1 − (f/f_j)² + 2i ζ_j f/f_j),   σ₁ + σ₂ = 1

is the response of an axis to its command (`models/vibration/modal.py`). A frequency response shows g e^(−iωτ) H: the
sensor's gain g and a delay τ are fitted along with it. A spectrum of a firmware's resonance test shows g f² |H|² + c
through the window's |W|²: the test excites with a power that grows with f², and the share of a second mode follows from
its height against the first one's and from the dip between them.

    minimise  Σ r²/v(ε),   v = (σ² + ε²|H|²)/2 of the real and the imaginary part,   v = ε² (1 + P/S) + σ² of ln S

σ² is the noise, ε the model's own error, chosen for each file such that χ² has its expected value. A second mode is
accepted only where the Bayesian information criterion is better, where its frequency and its share are sharp (their
covariance counts residuals that err alike), and where the two are farther apart than they are wide.

How much of the damping belts hold is not fitted. A share s multiplies each mode by 1 + 2i ζ_j s f/f_j, to first order a
delay, which each response has of its own; the rest is about (2 ζ f/f_j)² s.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np

from ffcomp.errors import MeasurementError
from ffcomp.identification.axis_spectra import COARSE, Datum, Spectrum
from ffcomp.identification.uncertainty import Estimate, Mode, lognormal, normal
from ffcomp.inference.fit import FitResult, FitSettings, best_of, fit
from ffcomp.inference.problem import EstimationProblem, Unknown
from ffcomp.numerics.serialise import keys
from models.arrays import ComplexArray, FloatArray

START_DAMPING = 0.06
DAMPINGS = (0.002, 0.7)
SHARES = (0.01, 0.99)  # searched
SMALLEST_SHARE = 0.02  # accepted
SEARCHED = FitSettings(steps=8, gain=0.05)  # from each start
REFINED = FitSettings(rounds=10, gain=1e-4)
AS_IT_IS = FitSettings(steps=0, rounds=1)  # errors and derivatives where another fit has ended
START_SHARE = 0.8  # of the first of two modes
STARTS = 6  # frequencies tried for each mode, evenly over the band
OUTSIDE = 1.3  # how far beyond the band a mode may be looked for, a factor
BROADEST = 0.4  # damping ratio of a resonance
BETTER_BIC = 2.0  # least gain of a second mode
MANY_MODES = 0.2  # model error: beyond it there are more modes than two
PEAK_BAND = 1.45  # the band around a peak that is fitted by itself, a factor to each side
FEWEST_AT_PEAK = 12  # lines
CLEAR = 0.05  # relative standard uncertainty of a frequency
SHARP = 2.0  # standard uncertainties that a share must be away from zero
POOR_FIT = 0.35  # model error: beyond it the user is warned
APART = 0.05  # relative distance of frequencies: beyond it two files disagree


@dataclass(frozen=True)
class AxisMode(Mode):
    """One mode of an axis."""

    share: Estimate


@dataclass(frozen=True, slots=True)
class ExplainedDatum:
    """How well a measured file is explained."""

    source: str
    lines: int  # frequencies
    model_error: float  # 0: explained to its noise


@dataclass(frozen=True, eq=False)
class AxisFit:
    """The modes of one axis, and the data they are from."""

    json_keys: ClassVar = keys("modes", "verdict", data="explained")

    name: str  # x, y or z
    modes: tuple[AxisMode, ...]  # the larger share first
    data: tuple[Datum, ...]
    fitted: tuple[FloatArray | ComplexArray, ...]  # of each datum, in the units of the measurement
    errors: tuple[float, ...]  # of each datum, the model's own: 0.1 is 10 %
    verdict: str  # a sentence: why so many modes
    advice: tuple[str, ...]

    @property
    def explained(self) -> list[ExplainedDatum]:
        """How well each datum is explained."""
        return [
            ExplainedDatum(Path(datum.source).name, len(datum.frequency_hz), error)
            for datum, error in zip(self.data, self.errors, strict=True)
        ]


# ---- the fit of one axis -------------------------------------------------------------------------


class _Problem(EstimationProblem):
    """θ: ln f and ln ζ of each mode, the first's share if there are two, then two nuisance parameters of each datum."""

    def __init__(self, data: Sequence[Datum], count: int) -> None:
        self.data, self.count = data, count
        self.of_modes = 3 * count - 1
        (bottom, top), dampings = _band(data), np.log(DAMPINGS)
        shapes = [
            Unknown(name, low=float(low), high=float(high))
            for _ in range(count)
            for name, low, high in (
                ("ln f", np.log(bottom / OUTSIDE), np.log(top * OUTSIDE)),
                ("ln damping", dampings[0], dampings[1]),
            )
        ]
        shares = [Unknown("share", low=SHARES[0], high=SHARES[1])] * (count - 1)
        own = [Unknown("nuisance", low=low, high=high) for datum in data for low, high in datum.limits.tolist()]
        self.unknowns = [*shapes, *shares, *own]
        self.observations = [datum.observed for datum in data]

    def modes(self, theta: FloatArray) -> FloatArray:
        """(m, 3) frequency, damping ratio, share."""
        shares = [1.0] if self.count == 1 else [theta[4], 1 - theta[4]]
        return np.column_stack([np.exp(theta[: 2 * self.count].reshape(self.count, 2)), shares])

    def nuisances(self, theta: FloatArray) -> FloatArray:
        """(d, 2) nuisance parameters of each datum."""
        return theta[self.of_modes :].reshape(-1, 2)

    def begin(self, shapes: FloatArray) -> FloatArray:
        """Return (p,) with the nuisance parameters that suit the modes' own numbers, (3 m − 1,)."""
        modes = self.modes(shapes)
        return np.concatenate([shapes, *(datum.begin(modes) for datum in self.data)])

    def simulate(self, lanes: Sequence[FloatArray]) -> Iterator[FloatArray]:
        for theta in lanes:
            modes, nuisances = self.modes(theta), self.nuisances(theta)
            with np.errstate(divide="ignore", over="ignore", invalid="ignore"):  # of a step too far
                yield np.concatenate([d.rows(modes, each) for d, each in zip(self.data, nuisances, strict=True)])


_Fit = FitResult[_Problem]


def _modes(found: _Fit) -> FloatArray:
    return found.problem.modes(found.values)


def fit_axis(name: str, data: Sequence[Datum]) -> AxisFit:
    """Fit one mode or two, by the evidence; MeasurementError if no resonance lies within the measured band."""
    accepted, verdict = _one_or_two(name, data)
    accepted, verdict = _at_the_peak(name, accepted, verdict)
    _within(name, accepted)
    modes, disagreement = _with_scatter(name, _estimated(accepted), accepted)
    own = list(zip(data, accepted.problem.nuisances(accepted.values), strict=True))
    remarks = [text for datum, nuisances in own for text in datum.remarks(nuisances)]
    fitted = tuple(datum.model(_modes(accepted), nuisances) for datum, nuisances in own)
    errors = tuple(accepted.errors.tolist())
    advice = [*accepted.doubt(f"the modes of {name}"), *disagreement]
    if max(errors) > POOR_FIT:
        advice.append(
            f"The modes describe {name} poorly, to {100 * max(errors):.0f} % of the measurement: it has more modes "
            "than a machine file holds, or it rattles. Look at it with --figure."
        )
    return AxisFit(name, modes, tuple(data), fitted, errors, verdict, (*advice, *remarks))


def _one_or_two(name: str, data: Sequence[Datum]) -> tuple[_Fit, str]:
    """Fit one mode and two, and return the accepted fit, and why."""
    low, high = _band(data)
    starts = [np.log([[f, START_DAMPING]]) for f in np.geomspace(1.2 * low, 0.95 * high, STARTS)]
    one = _refined(_searched(data, starts, 1))
    first = np.log(_modes(one)[:, :2])
    two = _refined(_searched(data, [np.vstack([first, second]) for second in starts], 2))
    return _accepted(name, one, two)


def _at_the_peak(name: str, wide: _Fit, verdict: str) -> tuple[_Fit, str]:
    """Fit the highest peak by itself where two modes do not hold what the whole band shows.

    Otherwise the residual of other modes pulls the main one off its peak, by up to a tenth. The errors stay those of
    the whole band.
    """
    data = wide.problem.data
    spectra = [datum for datum in data if isinstance(datum, Spectrum)]
    if len(spectra) < len(data) or wide.errors.max() < MANY_MODES:
        return wide, verdict
    near = [spectrum.around_peak(PEAK_BAND) for spectrum in spectra]
    if min(len(spectrum.frequency_hz) for spectrum in near) < FEWEST_AT_PEAK:
        return wide, verdict
    local, _ = _one_or_two(name, near)
    low, high = _band(near)
    if not low < _main(local)[0] < high:
        return wide, verdict
    problem = _Problem(data, local.problem.count)
    everywhere = fit(problem, problem.begin(local.values[: problem.of_modes]), AS_IT_IS)
    sentence = (
        f"{name} has more modes than two in its band; the highest peak is fitted by itself, {low:.0f} to {high:.0f} Hz."
    )
    return replace(everywhere, status=local.status), sentence


def _main(found: _Fit) -> FloatArray:
    """Return frequency, damping ratio and share of the mode with the largest share, (3,)."""
    modes = _modes(found)
    return modes[np.argmax(modes[:, 2])]


def _band(data: Sequence[Datum]) -> tuple[float, float]:
    return min(float(d.frequency_hz[0]) for d in data), max(float(d.frequency_hz[-1]) for d in data)


def _searched(data: Sequence[Datum], starts: Sequence[FloatArray], count: int) -> _Fit:
    """Fit coarsely from each of the modes (m, 2), all files weighted alike; return the best."""
    problem, equal = _Problem(data, count), np.full(len(data), COARSE)
    begins = (problem.begin(np.append(start.ravel(), [START_SHARE] * (count - 1))) for start in starts)
    return best_of(fit(problem, begin, SEARCHED, errors=equal) for begin in begins)


def _refined(found: _Fit) -> _Fit:
    """Fit and reweight until the files' errors converge."""
    return fit(found.problem, found.values, REFINED, errors=found.errors)


# ---- one mode or two -----------------------------------------------------------------------------


def _within(name: str, found: _Fit) -> None:
    data = found.problem.data
    low, high = _band(data)
    frequency, damping, _ = _main(found).tolist()
    remedies = [datum.beyond(frequency, damping) for datum in data]
    if low < frequency < high and damping < BROADEST and not all(remedies):
        return
    sources = ", ".join(dict.fromkeys(Path(d.source).name for d in data))
    rule = f"No resonance of {name} stands out between {low:.0f} and {high:.0f} Hz, so its numbers are unchanged"
    raise MeasurementError(sources, [f"{rule}. {remedies[0] or 'Try a wider band, or a harder excitation.'}"])


def _accepted(name: str, one: _Fit, two: _Fit) -> tuple[_Fit, str]:
    """Return the accepted fit, and why."""
    gain = one.deviance - two.deviance - 3 * float(np.log(len(two.residual)))
    if gain < BETTER_BIC:
        return one, f"One mode describes {name}: a second one explains no more than chance would."
    problem = _unclear(two)
    if problem:
        return one, f"One mode is kept for {name}; there is more in the data, but {problem}."
    return two, f"Two modes describe {name} (Bayesian information criterion: {gain:.0f} in favour of the second)."


def _unclear(two: _Fit) -> str:
    """Say why a second mode is not clear; '' if it may be accepted."""
    sd = np.sqrt(np.diag(two.covariance))
    share, low, high = float(two.values[4]), *_band(two.problem.data)
    other = int(share > 0.5)
    frequency = float(_modes(two)[other, 0])
    where = f"at {frequency:.0f} Hz"
    if min(share, 1 - share) < max(SMALLEST_SHARE, SHARP * sd[4]):
        return f"the share of the mode {where} is not known better than {min(share, 1 - share):.2f} ± {sd[4]:.2f}"
    if max(sd[0], sd[2]) > CLEAR or not low < frequency < high or _modes(two)[:, 1].max() > BROADEST:
        return f"the one {where} is too uncertain or too broad to be a mode"
    (first, second), dampings = _modes(two)[:, 0], _modes(two)[:, 1]
    if abs(first - second) < dampings @ (first, second) / 2:  # of the mean half-power half-width
        return f"the one {where} lies within the width of the other, so that the two cannot be separated"
    return ""


def _estimated(found: _Fit) -> tuple[AxisMode, ...]:
    sd = np.sqrt(np.diag(found.covariance))
    share_sd = float(sd[4]) if found.problem.count == 2 else 0.0
    modes = [
        AxisMode(
            lognormal(float(frequency), float(sd[2 * i])),
            lognormal(float(damping), float(sd[2 * i + 1])),
            normal(float(share), share_sd),
        )
        for i, (frequency, damping, share) in enumerate(_modes(found))
    ]
    return tuple(sorted(modes, key=lambda mode: -mode.share.value))


def _with_scatter(name: str, modes: tuple[AxisMode, ...], found: _Fit) -> tuple[tuple[AxisMode, ...], list[str]]:
    """Fit each file by itself, and widen the main mode's uncertainty to their scatter."""
    data = found.problem.data
    if len(data) < 2:
        return modes, []
    main, alone = modes[0].frequency_hz, list[float]()
    for datum in data:
        problem = _Problem([datum], found.problem.count)
        begin = problem.begin(found.values[: problem.of_modes])
        alone.append(float(_main(fit(problem, begin, errors=np.array([COARSE])))[0]))
    scatter = float(np.std(np.log(alone), ddof=1)) / np.sqrt(len(data))
    sure = lognormal(main.value, max(main.relative_sd, scatter))
    advice = []
    if max(alone) / min(alone) - 1 > APART:
        listed = ", ".join(f"{f:.1f} Hz in {Path(d.source).name}" for f, d in zip(alone, data, strict=True))
        advice = [f"The files disagree about {name}: {listed}. Was it the same machine, at one position?"]
    return (replace(modes[0], frequency_hz=sure), *modes[1:]), advice
