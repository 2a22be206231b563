"""Several accelerometers of one printer: each axis from the one that feels it.

The toolhead of a bed slinger does not move along y: its chip feels x, and one on the bed feels y, the other way round.
Where all that moves carries one chip, there is nothing to choose.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline

from ffcomp.measurement.recording import CLOCKS, Recording
from ffcomp.record.clock import DEAF
from ffcomp.record.result import Joined
from models.machine import Machine

AXES = "xyz"


def of_all_chips(by_chip: Sequence[Sequence[Joined]]) -> list[Joined]:
    """Return one recording an execution: on the rows of one chip, with the axes that it is deaf to of the others.

    Repeats are compared row by row, so all are on the rows of the chip that fits its commands best, if it has them.
    """
    by_name: dict[str, list[Joined]] = {}
    for members in sorted(by_chip, key=_fitting, reverse=True):
        for each in members:
            by_name.setdefault(each.name, []).append(each)
    return [_together(members) for members in by_name.values()]


def _fitting(joined: Sequence[Joined]) -> float:
    """Return how many captures of a chip there are, and how well they fit."""
    return sum(each.clock.correlation for each in joined)


def _together(members: Sequence[Joined]) -> Joined:
    """Join the recordings of one execution, the best chip's first."""
    best, chips = members[0], dict.fromkeys(AXES, 0)
    for i, axis in enumerate(AXES):
        chip = int(np.argmax([each.felt[i] for each in members]))
        if members[chip].felt[i] > best.felt[i] and best.felt[i] < DEAF:
            shares = (*best.felt[:i], members[chip].felt[i], *best.felt[i + 1 :])
            best = replace(best, recording=_with_axis(best, members[chip], f"acc_{axis}"), felt=shares)
            chips[axis] = chip
    return best if len(set(chips.values())) == 1 else _of_clocks(best, chips)


def _of_clocks(best: Joined, chips: Mapping[str, int]) -> Joined:
    """Say which columns are of one chip, and so on one clock."""
    groups = [
        " ".join(f"acc_{axis}" for axis, of_axis in chips.items() if of_axis == chip)
        for chip in sorted({*chips.values()})
    ]
    recording = best.recording
    return replace(best, recording=replace(recording, comments={**recording.comments, CLOCKS: ", ".join(groups)}))


def _with_axis(best: Joined, source: Joined, column: str) -> Recording:
    """Put another chip's axis on the rows of the first one's recording; both are on the experiment's clock."""
    recording, other = best.recording, source.recording
    at = np.clip(recording.time_s + best.begin_s - source.begin_s, 0.0, other.time_s[-1])  # both end at rest
    values = other.acceleration[column]
    known = np.isfinite(values)
    resampled = np.asarray(CubicSpline(other.time_s[known], values[known])(at))
    near = np.clip(np.searchsorted(other.time_s, at), 1, len(values) - 1)
    resampled[~(known[near] & known[near - 1])] = np.nan
    return replace(
        recording, acceleration={**recording.acceleration, column: resampled}, gaps=recording.gaps | np.isnan(resampled)
    )


def without_deaf_axes(joined: Sequence[Joined], machine: Machine) -> tuple[list[Joined], list[str]]:
    """Leave out axes that no chip feels, on a machine whose bed may be what moves; and say so."""
    with_chips = [each for each in joined if each.recording.acceleration]
    if not (machine.kinematics.bed_may_move and with_chips):
        return list(joined), []
    heard = np.median([each.felt for each in with_chips], axis=0)
    deaf = [f"acc_{axis}" for axis, share in zip(AXES, heard.tolist(), strict=True) if share < DEAF]
    notes = [
        f"No chip feels the motion along {column[-1]}, so nothing is said of it. A bed slinger's bed needs a chip of "
        "its own: give `ffcomp record plan` both (--chip adxl345 --chip bed), and here the captures of both."
        for column in deaf
    ]
    return [_without(each, deaf) for each in joined], notes


def without_lacking_runs(joined: Sequence[Joined], machine: Machine) -> tuple[list[Joined], list[str]]:
    """Leave out runs that lack the one chip that feels an axis: the others would say that it rests; and say so."""
    with_chips = [each for each in joined if each.recording.acceleration]
    if not (machine.kinematics.bed_may_move and with_chips):
        return list(joined), []
    heard = np.median([each.felt for each in with_chips], axis=0)
    audible = [axis for axis, share in zip(AXES, heard.tolist(), strict=True) if share >= DEAF]
    lacking = {each.name: axis for each in with_chips for axis in _lacking(each) if axis in audible}
    notes = [
        f"{name} is left out: the capture of the chip that feels {axis} is missing, or was not joined."
        for name, axis in lacking.items()
    ]
    return [each for each in joined if each.name not in lacking], notes


def _lacking(each: Joined) -> list[str]:
    """List the axes along which a run moves and its chips do not."""
    return [axis for axis, share in zip(AXES, each.felt, strict=True) if share < DEAF]


def _without(each: Joined, columns: Sequence[str]) -> Joined:
    kept = {name: values for name, values in each.recording.acceleration.items() if name not in columns}
    return replace(each, recording=replace(each.recording, acceleration=kept))
