"""All axes of a cartesian or CoreXY machine from its measurements: the modes of each, and what x and y exchange."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ffcomp.errors import MeasurementError
from ffcomp.identify.axis_spectra import AXES, Datum, Response, Spectrum, usable
from ffcomp.identify.exchange import Exchange, find_exchange
from ffcomp.identify.modal_fit import AxisFit, fit_axis
from ffcomp.measurement.frf import FrequencyResponse
from ffcomp.numerics.stages import Stage

CROSS_TALK = 0.1  # of the direct response, in amplitude, from which coupling is reported: chips sit a few degrees askew
LEAST_EXCHANGE, SHARP = 0.01, 3.0  # of δ, and in standard uncertainties, from which it is written
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

    Parameters
    ----------
    exchanging : whether the same belts move x and y, so that they may exchange motion

    Raises
    ------
    MeasurementError
        If nothing was, or no axis shows a resonance.
    """
    answers, sentences = usable(responses)
    data: list[Datum] = [*spectra, *(answer for answer in answers if answer.direct)]
    if not data:
        raise MeasurementError("data", [*sentences, "None of the files holds the response of an axis to its command."])
    found: list[AxisFit] = []
    for name in AXES:
        mine = [datum for datum in data if datum.axis == name]
        if mine:
            progress(Stage(2 + len(found), f"{name}: {len(mine)} {'file' if len(mine) == 1 else 'files'}"))
            try:
                found.append(fit_axis(name, mine))
            except MeasurementError as error:
                sentences += error.problems
    if not found:
        raise MeasurementError("data", sentences)
    advice = [text for axis in found for text in axis.advice]
    exchange, crossing = _exchanged(found, answers, exchanging)
    missing = [
        f"Nothing was measured along {name}: [axes.{name}] stays the starting file's."
        for name in "xy"
        if not any(datum.axis == name for datum in data)
    ]
    return IdentifiedAxes(tuple(found), (*sentences, *advice, *crossing, *missing), exchange)


def _exchanged(
    axes: Sequence[AxisFit], answers: Sequence[Response], exchanging: bool
) -> tuple[Exchange | None, list[str]]:
    """Return what x and y exchange if it is sure, and sentences about all motion across the axes."""
    found = find_exchange(axes, answers) if exchanging else None
    if found is None or found.left > CROSS_TALK or max(map(abs, found.turned_rad.values())) > MOST_TURNED:
        return None, _crossing(answers, axes)
    told = _crossing([a for a in answers if "z" in (a.axis, a.measured.input[-1]) or a.direct], axes)
    told += [
        f"{name}: the sensor seems turned about z by {np.degrees(turn):.0f}°, which the exchange of motion leaves out."
        for name, turn in found.turned_rad.items()
        if abs(turn) > CROSS_TALK
    ]
    delta = found.delta
    if abs(delta.value) < max(LEAST_EXCHANGE, SHARP * delta.sd):
        return None, told
    belt = 2 * abs(delta.value) / (1 - abs(delta.value))
    return found, [
        f"x and y exchange motion: axes.exchange = {delta.value:.3f} ({delta.low:.3f} to {delta.high:.3f}) is written, "
        f"so that it is compensated. One belt is stiffer than the other by about {100 * belt:.0f} %: make "
        "their tensions equal and measure again.",
        *told,
    ]


def _crossing(answers: Sequence[Response], axes: Sequence[AxisFit]) -> list[str]:
    """Report how much of an axis' motion the others show, which the model does not explain."""
    power = {
        (a.measured.input, a.measured.output): float(np.sum(np.maximum(np.abs(a.value) ** 2 - a.measured.variance, 0)))
        for a in answers
    }
    moved = [axis.name for axis in axes]
    sentences = []
    for (cmd, output), crossed in power.items():
        direct = power.get((cmd, output[:-1] + cmd[-1]), 0.0)
        if cmd[-1] in moved and output[-1] != cmd[-1] and crossed > CROSS_TALK**2 * direct > 0:
            sentences.append(
                f"{cmd} shows in {output} too ({100 * np.sqrt(crossed / direct):.0f} % of the direct response): the "
                "model does not explain it, so this is not compensated. Are the sensor's axes the "
                "printer's? If so, ffcomp diagnose tells belts of unequal tension (belt_stiffness) from a racking "
                "gantry (gantry_racking) and a swaying frame (frame_mode); with the effect in the file it is."
            )
    return sentences
