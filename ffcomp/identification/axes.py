"""All axes of a cartesian or CoreXY machine from its measurements: the modes of each, and what x and y exchange."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ffcomp.errors import MeasurementError
from ffcomp.identification.axis_spectra import Datum, Response, Spectrum, closed_form, observed_response, usable
from ffcomp.identification.modal_fit import AxisFit, fit_axis
from ffcomp.identification.uncertainty import Estimate, normal
from ffcomp.inference.fit import FitSettings, fit
from ffcomp.inference.problem import EstimationProblem, Unknown
from ffcomp.measurement.frf import AXES, FrequencyResponse
from ffcomp.numerics.stages import Stage
from models.arrays import ComplexArray, FloatArray

CROSS_TALK = 0.1  # amplitude over the direct response's: more is reported as coupling, as chips sit a few degrees askew
LEAST_EXCHANGE, SHARP = 0.01, 3.0  # δ is written from this size on, and this many standard uncertainties
MOST_TURNED = np.radians(20)  # of a sensor that was meant to be straight


@dataclass(frozen=True, eq=False)
class IdentifiedAxes:
    """All fitted axes, with advice."""

    axes: tuple[AxisFit, ...]
    advice: tuple[str, ...]
    exchange: Exchange | None = None  # of x and y, where it is sure


def identify_axes(
    spectra: Sequence[Spectrum],
    responses: Sequence[FrequencyResponse],
    progress: Callable[[str], None] = lambda _: None,
    exchanging: bool = True,
) -> IdentifiedAxes:
    """Fit the modes of every measured axis, and what x and y exchange.

    exchanging : whether the same belts move x and y, so that they may exchange motion

    Raises MeasurementError if nothing was, or no axis shows a resonance.
    """
    answers, sentences = usable(responses)
    data: list[Datum] = [*spectra, *(answer for answer in answers if answer.direct)]
    if not data:
        raise MeasurementError("data", [*sentences, "None of the files holds the response of an axis to its command."])
    fits, problems = fit_axes(data, progress)
    sentences += problems
    if not fits:
        raise MeasurementError("data", sentences)
    advice = [text for axis in fits for text in axis.advice]
    exchange, crossing = _exchanged(fits, answers, exchanging)
    missing = [
        f"Nothing was measured along {name}: [axes.{name}] stays the starting file's."
        for name in "xy"
        if not any(datum.axis == name for datum in data)
    ]
    return IdentifiedAxes(tuple(fits), (*sentences, *advice, *crossing, *missing), exchange)


def fit_axes(
    data: Sequence[Datum], progress: Callable[[str], None] = lambda _: None
) -> tuple[list[AxisFit], list[str]]:
    """Fit the modes of every measured axis, and say which axes show no resonance."""
    fits: list[AxisFit] = []
    sentences: list[str] = []
    for name in AXES:
        mine = [datum for datum in data if datum.axis == name]
        if mine:
            progress(Stage(2 + len(fits), f"{name}: {len(mine)} {'file' if len(mine) == 1 else 'files'}"))
            try:
                fits.append(fit_axis(name, mine))
            except MeasurementError as error:
                sentences += error.problems
    return fits, sentences


def _exchanged(
    axes: Sequence[AxisFit], answers: Sequence[Response], exchanging: bool
) -> tuple[Exchange | None, list[str]]:
    """Return what x and y exchange if it is sure, and sentences about all motion across the axes."""
    exchange = find_exchange(axes, answers) if exchanging else None
    if exchange is None or exchange.left > CROSS_TALK or max(map(abs, exchange.turned_rad.values())) > MOST_TURNED:
        return None, _crossing(answers, axes)
    sentences = _crossing([a for a in answers if "z" in (a.axis, a.input[-1]) or a.direct], axes)
    sentences += [
        f"{name}: the sensor seems turned about z by {np.degrees(turn):.0f}°, which the exchange of motion leaves out."
        for name, turn in exchange.turned_rad.items()
        if abs(turn) > CROSS_TALK
    ]
    delta = exchange.delta
    if abs(delta.value) < max(LEAST_EXCHANGE, SHARP * delta.sd):
        return None, sentences
    belt = 2 * abs(delta.value) / (1 - abs(delta.value))
    return exchange, [
        f"x and y exchange motion: axes.exchange = {delta.value:.3f} ({delta.low:.3f} to {delta.high:.3f}) is written, "
        f"so that it is compensated. One belt is stiffer than the other by about {100 * belt:.0f} %: make "
        "their tensions equal and measure again.",
        *exchange.doubt,
        *sentences,
    ]


def _crossing(answers: Sequence[Response], axes: Sequence[AxisFit]) -> list[str]:
    """Report how much of an axis' motion the others show, which the model does not explain."""
    power = {(a.input, a.output): float(np.sum(np.maximum(np.abs(a.value) ** 2 - a.variance, 0))) for a in answers}
    moved = [axis.name for axis in axes]
    sentences = []
    for (cmd, output), crossed in power.items():
        direct = power.get((cmd, output[:-1] + cmd[-1]), 0.0)
        if cmd[-1] in moved and output[-1] != cmd[-1] and crossed > CROSS_TALK**2 * direct > 0:
            sentences.append(
                f"{cmd} shows in {output} too ({100 * np.sqrt(crossed / direct):.0f} % of the direct response): the "
                "model does not explain it, so this is not compensated. Are the sensor's axes the "
                "printer's? If so, ffcomp diagnose separates belts of unequal tension (belt_stiffness) from a racking "
                "gantry (gantry_racking) and a swaying frame (frame_mode); with the effect in the file it is."
            )
    return sentences


WEAKEST = 0.03  # of its largest value: where an axis answers less to its command, its response divides by noise


@dataclass(frozen=True, eq=False)
class Exchange:
    """How x and y exchange motion, and the residual that this leaves."""

    delta: Estimate
    turned_rad: dict[str, float]  # of each crossed response, by its name
    left: float  # amplitude of the crossed responses' residual beyond noise, over the direct ones'
    doubt: tuple[str, ...] = ()  # of a fit that has not converged


@dataclass(frozen=True, eq=False)
class _Crossed:
    """One crossed response at the lines that count, and what δ = 1 and κ = 1 would show in it, (k,) each."""

    measured: FrequencyResponse
    exchanged: ComplexArray
    turned: ComplexArray

    def shown(self, delta: float, turn: float) -> ComplexArray:
        """Predict the response (k,): a turned sensor feels less of the axis' own motion, and some of the other's."""
        across = delta * self.exchanged / self.turned
        return self.turned * (turn + across * (1 + turn**2) / (1 - turn * across))


class _Exchanging(EstimationProblem):
    """δ, then κ of each crossed response; the model errs by a share of the motion that crosses."""

    def __init__(self, pairs: Sequence[_Crossed]) -> None:
        names = [f"{pair.measured.input} to {pair.measured.output}" for pair in pairs]
        self.pairs, self.unknowns = pairs, [Unknown("δ"), *map(Unknown, names)]
        self.observations = [
            replace(observed_response(pair.measured), size=np.tile(np.abs(pair.turned) ** 2 / 2, 2)) for pair in pairs
        ]

    def simulate(self, lanes: Sequence[FloatArray]) -> Iterator[FloatArray]:
        for delta, *turns in lanes:
            rows = [pair.shown(delta, turn) for pair, turn in zip(self.pairs, turns, strict=True)]
            yield np.concatenate([part for row in rows for part in (row.real, row.imag)])


def find_exchange(axes: Sequence[AxisFit], answers: Sequence[Response]) -> Exchange | None:
    """Fit δ and a turn of the sensor for each crossed response to all of them together.

    None where there is no crossed response with the direct one of the same file.

    axes : the fitted axes; both x and y must be among them, with responses that show the sensors' signs.
    answers : responses of axes to commands, their own and each other's.
    """
    fitted = {axis.name: axis for axis in axes}
    if not set("xy") <= fitted.keys():
        return None
    pairs = [_crossed(fitted, answers, each) for each in answers if each.axis in "xy" and not each.direct]
    crossed = [pair for pair in pairs if pair is not None]
    if not crossed:
        return None
    problem = _Exchanging(crossed)
    found = fit(problem, np.zeros(len(problem.unknowns)), FitSettings(rounds=5))
    delta = normal(float(found.values[0]), float(np.sqrt(found.covariance[0, 0])))
    left = direct = 0.0
    for pair, error in zip(crossed, np.split(found.residual * found.sd, problem.ends[:-1]), strict=True):
        power = np.sum(error.reshape(2, -1) ** 2, axis=0)
        left += float(np.sum(np.maximum(power - pair.measured.variance, 0)))
        direct += float(np.sum(np.abs(pair.turned) ** 2))
    turns = dict(zip([u.name for u in problem.unknowns[1:]], found.values[1:].tolist(), strict=True))
    return Exchange(delta, turns, float(np.sqrt(left / direct)), tuple(found.doubt("what x and y exchange")))


def _crossed(fitted: dict[str, AxisFit], answers: Sequence[Response], crossed: Response) -> _Crossed | None:
    to, of = crossed.axis, crossed.input[-1]
    direct = next((a for a in answers if a.direct and a.axis == of and a.source == crossed.source), None)
    if {to, of} != {"x", "y"} or direct is None or not np.array_equal(direct.frequency_hz, crossed.frequency_hz):
        return None
    moved, shown = _modes(fitted[of]), _modes(fitted[to])
    f_moved, f_shown = closed_form(moved, direct.frequency_hz), closed_form(shown, direct.frequency_hz)
    lines = np.abs(f_moved) > WEAKEST * np.abs(f_moved).max()
    exchanged = f_shown * (1 - closed_form(_driven(moved), direct.frequency_hz)) / f_moved
    sign = _sign(fitted[to], shown) * _sign(fitted[of], moved)
    size = np.abs(crossed.value / direct.value) ** 2
    variance = crossed.variance + size * direct.variance  # to first order: the direct response is noisy too
    at_lines = {"frequency_hz": crossed.frequency_hz[lines], "value": crossed.value[lines]}
    kept = replace(crossed, **at_lines, variance=variance[lines])
    return _Crossed(kept, (sign * exchanged * direct.value)[lines], direct.value[lines])


def _modes(axis: AxisFit) -> FloatArray:
    """Return (m, 3) frequency, damping ratio, share."""
    return np.array([[m.frequency_hz.value, m.damping_ratio.value, m.share.value] for m in axis.modes])


def _driven(modes: FloatArray) -> FloatArray:
    """Return the same of the point that the belt drives: every mode of it follows the belt."""
    sizes = np.abs(modes[:, 2])
    return np.column_stack([modes[:, :2], sizes / sizes.sum()])


def _sign(axis: AxisFit, modes: FloatArray) -> float:
    """Return −1 where the sensor feels the axis the other way round, as on a moving bed."""
    seen = (float(datum.begin(modes)[0]) for datum in axis.data if isinstance(datum, Response))
    return float(np.sign(next(seen, 1.0)))
