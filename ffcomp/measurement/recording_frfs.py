"""From recordings to frequency responses: select the estimator, its inputs, units and repeats.

Recordings with one and the same command are repeats: they are averaged. Recordings with different commands, at one
position, are the experiments that separate the inputs.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from ffcomp.errors import MeasurementError
from ffcomp.measurement.estimators import periodic_frf, sweep_frf
from ffcomp.measurement.frf import FrequencyResponse
from ffcomp.measurement.recording import Recording
from models.arrays import FloatArray

_SAME_COMMAND_MM = 1e-5
_LONGEST_GAP_S = 0.005  # a cubic through a longer hole in a sensor would invent vibration


def frfs_from_recordings(
    recordings: Sequence[Recording],
    lowest_hz: float,
    highest_hz: float,
    *,
    half_width_hz: float = 1.0,
    position_mm: tuple[float, float, float] | None = None,
) -> list[FrequencyResponse]:
    """Estimate all responses of the recordings' sensors to their commands that move, in a band.

    With a comment `# period_s:` in the recordings by `periodic_frf`, else by `sweep_frf`. Responses of accelerations
    are in 1/s², of positions without dimension.
    """
    _belong_together(recordings)
    inputs = [name for name, column in zip(recordings[0].inputs, _commands(recordings), strict=True) if column]
    outputs = [*recordings[0].acceleration, *recordings[0].position]
    moving = [recordings[0].inputs.index(name) for name in inputs]
    experiments = _experiments(recordings)
    u = np.stack([group[0].command[:, moving] * 1e-3 for group in experiments])  # (e, n, i) m
    y = np.stack([np.mean([_sensors(recording, outputs) for recording in group], axis=0) for group in experiments])
    rate = recordings[0].sample_rate_hz
    period_s = _stated_period(recordings[0])
    try:
        if period_s is not None:
            matrix = periodic_frf(u, y, rate, _whole(recordings[0], period_s, rate))
        else:
            matrix = sweep_frf(u, y, rate, lowest_hz, highest_hz, half_width_hz=half_width_hz)
    except MeasurementError as error:  # the estimators know no files
        raise MeasurementError(error.path or recordings[0].source, error.problems) from error
    source = ", ".join(Path(recording.source).name for recording in recordings)
    return matrix.responses(inputs, outputs, (lowest_hz, highest_hz), position_mm=position_mm, source=source)


def _commands(recordings: Sequence[Recording]) -> list[bool]:
    """Return which of the three commands move at all."""
    return [any(np.ptp(recording.command[:, j]) > _SAME_COMMAND_MM for recording in recordings) for j in range(3)]


def _experiments(recordings: Sequence[Recording]) -> list[list[Recording]]:
    """Group recordings with one and the same command."""
    groups: list[list[Recording]] = []
    for recording in recordings:
        for group in groups:
            if np.abs(group[0].command - recording.command).max() <= _SAME_COMMAND_MM:
                group.append(recording)
                break
        else:
            groups.append([recording])
    return groups


def _sensors(recording: Recording, names: Sequence[str]) -> FloatArray:
    """Stack the sensors' signals, (n, o) in m/s² and m."""
    columns = [
        recording.acceleration[name] if name in recording.acceleration else recording.position[name] * 1e-3
        for name in names
    ]
    return np.column_stack([_bridged(recording, name, values) for name, values in zip(names, columns, strict=True)])


def _bridged(recording: Recording, name: str, values: FloatArray) -> FloatArray:
    known = np.flatnonzero(np.isfinite(values))
    if len(known) == len(values):
        return values
    holes = np.diff(np.concatenate([[-1], known, [len(values)]])) - 1
    if holes.max() > _LONGEST_GAP_S * recording.sample_rate_hz:
        since = float(recording.time_s[0 if holes.argmax() == 0 else known[holes.argmax() - 1]])
        rule = f"Sensor {name} is missing for {holes.max() / recording.sample_rate_hz:.3g} s after t = {since:.6g} s"
        raise MeasurementError(
            recording.source, [f"{rule}; a spectrum bears at most {_LONGEST_GAP_S:g} s. Cut the recording there."]
        )
    at = np.clip(np.arange(len(values)), known[0], known[-1])  # at the ends the nearest value: a cubic would run away
    return np.asarray(CubicSpline(known, values[known])(at), dtype=np.float64)


def _belong_together(recordings: Sequence[Recording]) -> None:
    if not recordings:
        raise MeasurementError("", ["No recording is given; at least one is needed for a frequency response."])
    first = recordings[0]
    for recording in recordings[1:]:
        same = recording.command_space == first.command_space and len(recording.time_s) == len(first.time_s)
        same &= abs(recording.sample_rate_hz / first.sample_rate_hz - 1) < 1e-6
        if not same or {*recording.acceleration, *recording.position} != {*first.acceleration, *first.position}:
            rule = f"It does not go with {Path(first.source).name}"
            raise MeasurementError(
                recording.source,
                [f"{rule}: recordings of one response need the same columns, rate and number of samples."],
            )
    if not any(_commands(recordings)):
        raise MeasurementError(first.source, ["Nothing is commanded to move, so there is no response to it."])


def _stated_period(recording: Recording) -> float | None:
    text = recording.comments.get("period_s")
    if text is None:
        return None
    try:
        return float(text)
    except ValueError:
        raise MeasurementError(
            recording.source, [f"Comment 'period_s' is {text[:40]!r}; it must be a number."]
        ) from None


def _whole(recording: Recording, period_s: float, rate_hz: float) -> int:
    samples = period_s * rate_hz
    if samples < 2 or abs(samples - round(samples)) > 0.01:
        rule = f"A period of {period_s:g} s is {samples:.3f} samples at {rate_hz:.6g} Hz"
        raise MeasurementError(recording.source, [f"{rule}; it must be a whole number of them."])
    return round(samples)
