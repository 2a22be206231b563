"""Frequency responses from joined captures of `record plan`: the linear part of what a diagnosis looks at."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ffcomp.errors import MeasurementError
from ffcomp.measurement.frf import FrequencyResponse
from ffcomp.measurement.recording import Recording
from ffcomp.measurement.recording_frfs import frfs_from_recordings
from ffcomp.record.plan import Experiment, MovesPlan
from ffcomp.record.result import NO_ACCELERATIONS
from models.arrays import FloatArray

BAND_HZ = (5.0, 150.0)  # that such motions excite
HALF_WIDTH_HZ = 2.0  # zigzags and loops have a few lines in a hertz only
VARIANCE_FACTOR = 4.0  # polynomials of such wide windows err by twice the noise, measured on simulated captures
MOST_NOISE = 0.15  # of a response's values: beyond it, as across the axes at the centre, it tells nothing
INPUTS = ("cmd_x", "cmd_y")  # z moves too little beside them


def responses_of(
    recordings: Sequence[Recording], plan: MovesPlan, band_hz: tuple[float, float]
) -> list[FrequencyResponse]:
    """Estimate the responses to x and y at each place of a plan, from all its experiments there together.

    Raises
    ------
    MeasurementError
        For a log of a motor.
    """
    for recording in recordings:
        if not recording.acceleration:
            raise MeasurementError(recording.comments["capture"], [NO_ACCELERATIONS])
    experiments = {each.name: each for each in plan.experiments}
    places: dict[int, list[Recording]] = {}
    for recording in recordings:
        places.setdefault(experiments[recording.comments["experiment"]].place, []).append(recording)
    found = []
    for place, members in sorted(places.items()):
        at = _position(experiments[members[0].comments["experiment"]])
        found += _of_place(members, place, at, (max(BAND_HZ[0], band_hz[0]), min(BAND_HZ[1], band_hz[1])))
    return found


def _position(experiment: Experiment) -> tuple[float, float, float]:
    x, y, z = (float(c) for c in experiment.position_mm)
    return x, y, z


def _of_place(
    members: Sequence[Recording], place: int, position: tuple[float, float, float], band_hz: tuple[float, float]
) -> list[FrequencyResponse]:
    """Estimate the responses at one place; a capture's start is known to a fraction of a millisecond: one clock."""
    longest = max(len(recording.time_s) for recording in members)
    alike = [_resting(recording, longest) for recording in members]
    found = frfs_from_recordings(alike, *band_hz, half_width_hz=HALF_WIDTH_HZ, position_mm=position)
    name = f"place {place}, {len(members)} captures"
    told = [r for r in found if r.input in INPUTS and _noise(r) < MOST_NOISE]
    return [replace(r, variance=r.variance * VARIANCE_FACTOR, source=name, clock=f"place-{place}") for r in told]


def _noise(response: FrequencyResponse) -> float:
    """Return the noise as a share of the values."""
    return float(np.sqrt(response.variance.sum() / np.sum(np.abs(response.value) ** 2)))


def _resting(recording: Recording, count: int) -> Recording:
    """Lengthen a recording, which ends at rest, to so many rows."""
    more = count - len(recording.time_s)
    return replace(
        recording,
        time_s=np.arange(count) / recording.sample_rate_hz,
        command=np.concatenate([recording.command, np.repeat(recording.command[-1:], more, axis=0)]),
        acceleration={name: _and_zeros(values, more) for name, values in recording.acceleration.items()},
        position={},
        gaps=np.concatenate([recording.gaps, np.zeros(more, dtype=bool)]),
    )


def _and_zeros(values: FloatArray, more: int) -> FloatArray:
    return np.concatenate([values, np.zeros(more)])
