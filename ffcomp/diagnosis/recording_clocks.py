"""The clocks of recordings: repeats moved onto each other, and delays and drifts as numbers that a fit may move.

The noise floor is half of what repeats differ by, so they are compared and moved first (`ffcomp.measurement.faults`).
A recording that was joined with its command says how sure its clock is (`delay_sd_s`, `drift_sd`); in one that was
joined by hand, repeats that lie apart say how far any file may lie off. They belong to the files, not to the machine.
Signals of several chips are on several clocks: each has a delay and a drift.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ffcomp.diagnosis.problem import Candidate, Observation, Parameter, Repeats
from ffcomp.measurement.clock import fill_gaps
from ffcomp.measurement.faults import compare_repeats
from ffcomp.measurement.recording import Recording
from ffcomp.numerics.delay import moved_columns
from models.arrays import FloatArray

PREFIX = "recording."
OFFSET = "sensor_time_offset"  # of all recordings, as the catalogue calls it


def repeats_of(observations: Sequence[Observation]) -> list[Repeats]:
    """Compare all experiments that were recorded more than once, in files of equal length, each clock by itself."""
    members: dict[tuple[str, int], list[int]] = {}
    for i, o in enumerate(observations):
        members.setdefault((o.repeat_of, len(o.measured)), []).append(i)
    several = [tuple(each) for each in members.values() if len(each) > 1]
    return [_compared(observations, each, names) for each in several for names in _of_clocks(observations, each)]


def _of_clocks(observations: Sequence[Observation], members: Sequence[int]) -> list[tuple[str, ...]]:
    """Return the signals that all have, by the clocks of the first."""
    first = observations[members[0]]
    by_clock = [[first.signals[k] for k in columns] for columns in first.by_clock.values()]
    common = [tuple(s for s in names if all(s in observations[i].signals for i in members)) for names in by_clock]
    return [names for names in common if names]


def _compared(observations: Sequence[Observation], members: tuple[int, ...], names: tuple[str, ...]) -> Repeats:
    first = observations[members[0]]
    columns = []
    for i in members:
        x = observations[i].measured[:, [observations[i].signals.index(name) for name in names]]
        columns.append(np.column_stack([fill_gaps(column) for column in (x - np.nanmean(x, axis=0)).T]))
    between = compare_repeats(
        columns,
        first.speed,
        first.rate_hz,
        known=np.all([np.isfinite(observations[i].measured).all(axis=1) for i in members], axis=0),
        units=[name[:3] for name in names],
    )
    return Repeats(
        **vars(between),
        members=members,
        files=tuple(Path(observations[i].name).name for i in members),
        signals=names,
    )


def aligned(observations: Sequence[Observation], repeats: Sequence[Repeats]) -> list[Observation]:
    """Move repeats that lie apart onto their mean, so that they differ by noise."""
    moved = list(observations)
    for each in repeats:
        if each.apart:
            for i, lag in zip(each.members, each.lag_s, strict=True):
                o = moved[i]
                columns = [k for k, s in enumerate(o.signals) if s in each.signals]
                moved[i] = replace(o, measured=moved_columns(o.measured, columns, -lag, o.rate_hz))
    return moved


def belongs_to_recording(name: str) -> bool:
    """Tell whether a parameter is a recording's, not the machine's."""
    return name.startswith(PREFIX)


def delay_parameters(
    recordings: Sequence[Recording], observations: Sequence[Observation], repeats: Sequence[Repeats]
) -> list[Parameter]:
    """Make a delay for each clock of an experiment that is in doubt, and a drift where the recording states one."""
    by_hand = _spread_s(repeats)
    parameters: dict[str, Parameter] = {}
    for recording, o in zip(recordings, observations, strict=True):
        sd = max(_number(recording, "delay_sd_s"), by_hand)
        drift_sd = _number(recording, "drift_sd")
        drifts = drift_sd * len(o.measured) / o.rate_hz / 2 > 2e-5  # s, at the ends: less is not worth a parameter
        for clock in o.by_clock:
            delay, drift = _names(o, clock)
            if sd > 0:
                parameters.setdefault(delay, Parameter.near(delay, 0.0, sd))
            if drifts:
                parameters.setdefault(drift, Parameter.near(drift, 0.0, drift_sd))
    return list(parameters.values())


def with_stated_clock(candidate: Candidate, recordings: Sequence[Recording]) -> Candidate:
    """Limit an offset of all recordings to the stated uncertainty of their clocks.

    From the signals alone, a late clock looks like a late machine. But captures that the firmware dates are joined by
    its clock, so the machine is late.
    """
    stated = [_number(recording, "delay_sd_s") for recording in recordings]
    if candidate.name != OFFSET or min(stated, default=0.0) == 0.0:
        return candidate
    amplitudes = tuple(replace(n, sd=min(n.sd, max(stated))) for n in candidate.amplitudes)
    return replace(candidate, amplitudes=amplitudes)


def _spread_s(repeats: Sequence[Repeats]) -> float:
    """Return how far files lie off, s, by repeats that lie apart, wider for few lags; 0: all together."""
    if not any(each.apart for each in repeats):
        return 0.0
    squares = sum(lag**2 for each in repeats for lag in each.lag_s)
    return float(1.5 * np.sqrt(squares / sum(len(each.lag_s) - 1 for each in repeats)))


def _number(recording: Recording, key: str) -> float:
    try:
        value = float(recording.comments.get(key, 0.0))
    except ValueError:
        return 0.0
    return value if np.isfinite(value) and value > 0 else 0.0


def as_recorded(values: Mapping[str, float], observation: Observation, simulated: FloatArray) -> FloatArray:
    """Move simulated signals, (n, m), to the clocks of the recording."""
    moved = simulated
    for clock, columns in observation.by_clock.items():
        late_s, drift = (values.get(name, 0.0) for name in _names(observation, clock))
        if late_s or drift:
            moved = moved_columns(moved, columns, late_s, observation.rate_hz, drift)
    return moved


def delay_of(values: Mapping[str, float], observation: Observation, clock: str) -> float:
    """Return how late the signals of one clock are, s."""
    return values.get(_names(observation, clock)[0], 0.0)


def _names(observation: Observation, clock: str) -> tuple[str, str]:
    """Name the delay and the drift of one clock of an experiment's recordings."""
    stem = ".".join(filter(None, (f"{PREFIX}{observation.repeat_of}", clock)))
    return f"{stem}.delay_s", f"{stem}.drift"


def clock_parameters(observations: Sequence[Observation]) -> frozenset[str]:
    """Return the names of the parameters that belong to these observations' recordings."""
    return frozenset(name for o in observations for clock in o.by_clock for name in _names(o, clock))


def seen_parameters(parameters: Sequence[Parameter], observations: Sequence[Observation]) -> tuple[Parameter, ...]:
    """Leave out the delays of recordings that are none of these observations."""
    belonging = clock_parameters(observations)
    return tuple(n for n in parameters if not belongs_to_recording(n.name) or n.name in belonging)
