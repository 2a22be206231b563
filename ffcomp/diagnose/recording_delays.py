"""Delay and drift of each experiment's recording against its command, as numbers that a fit may move.

A recording that was joined with its command says how sure its clock is (`delay_sd_s`, `drift_sd`); in one that was
joined by hand, repeats that lie apart say how far any file may lie off. They belong to the files, not to the machine.
Signals of several chips are on several clocks: each has a delay and a drift.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ffcomp.diagnose.problem import Candidate, Observation, Parameter
from ffcomp.diagnose.repeats import Repeats
from ffcomp.measurement.recording import Recording
from ffcomp.numerics.delay import moved_columns
from models.arrays import FloatArray

PREFIX = "recording."
OFFSET = "sensor_time_offset"  # of all recordings, as the catalogue calls it
FAR = 5.0  # standard deviations within which they are looked for
FEW = 1.5  # a spread known from few lags is taken to be wider
SMALL_DRIFT_S = 2e-5  # at the ends of a recording: less is not worth a parameter


def belongs_to_recording(name: str) -> bool:
    """Tell whether a parameter is a recording's, not the machine's."""
    return name.startswith(PREFIX)


def delay_parameters(
    recordings: Sequence[Recording], observations: Sequence[Observation], repeats: Sequence[Repeats]
) -> list[Parameter]:
    """Make a delay for each clock of an experiment that is in doubt, and a drift where the recording says so."""
    by_hand = _spread_s(repeats)
    found: dict[str, Parameter] = {}
    for recording, o in zip(recordings, observations, strict=True):
        sd = max(_number(recording, "delay_sd_s"), by_hand)
        drift_sd = _number(recording, "drift_sd")
        drifts = drift_sd * len(o.measured) / o.rate_hz / 2 > SMALL_DRIFT_S
        for clock in o.by_clock:
            delay, drift = _names(o, clock)
            if sd > 0:
                found.setdefault(delay, _parameter(delay, sd))
            if drifts:
                found.setdefault(drift, _parameter(drift, drift_sd))
    return list(found.values())


def with_stated_clock(candidate: Candidate, recordings: Sequence[Recording]) -> Candidate:
    """Take an offset of all recordings to be no larger than they say that their clocks may be off.

    A chip that feels everything late cannot tell its own clock from a late machine. But captures that the firmware
    dates are joined by its clock, so it is the machine.
    """
    stated = [_number(recording, "delay_sd_s") for recording in recordings]
    if candidate.name != OFFSET or min(stated, default=0.0) == 0.0:
        return candidate
    amplitudes = tuple(replace(n, sd=min(n.sd, max(stated))) for n in candidate.amplitudes)
    return replace(candidate, amplitudes=amplitudes)


def _parameter(name: str, sd: float) -> Parameter:
    return Parameter(name, 0.0, sd, -FAR * sd, FAR * sd)


def _spread_s(repeats: Sequence[Repeats]) -> float:
    """Return how far files lie off, s, by repeats that lie apart; 0 where all lie together."""
    if not any(each.apart for each in repeats):
        return 0.0
    squares = sum(lag**2 for each in repeats for lag in each.lag_s)
    return float(FEW * np.sqrt(squares / sum(len(each.lag_s) - 1 for each in repeats)))


def _number(recording: Recording, key: str) -> float:
    try:
        value = float(recording.comments.get(key, 0.0))
    except ValueError:
        return 0.0
    return value if np.isfinite(value) and value > 0 else 0.0


def as_recorded(values: Mapping[str, float], observation: Observation, simulated: FloatArray) -> FloatArray:
    """Move what was simulated, (n, m), to the times at which it was recorded."""
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


def own_delays(observations: Sequence[Observation]) -> frozenset[str]:
    """Return the names of the parameters that belong to these observations' recordings."""
    return frozenset(name for o in observations for clock in o.by_clock for name in _names(o, clock))


def seen_parameters(parameters: Sequence[Parameter], observations: Sequence[Observation]) -> tuple[Parameter, ...]:
    """Leave out the delays of recordings that are none of these observations."""
    own = own_delays(observations)
    return tuple(n for n in parameters if not belongs_to_recording(n.name) or n.name in own)
