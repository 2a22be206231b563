"""The faults of captures that were joined: a shaper left on, another motion, repeats that do not repeat.

What makes a fault, and its sentence, stands in `ffcomp.measurement.faults`.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from ffcomp.measurement.faults import (
    CAPTURES_BAND_HZ,
    REPEATS_REMEDY,
    NormalEquations,
    RepeatComparison,
    ShapersLeftOn,
    compare_repeats,
    fault,
    shaper_of_captures,
)
from ffcomp.record.axes import turn_of
from ffcomp.record.clock import Expectation, without_gaps
from ffcomp.record.plan import run_name
from ffcomp.record.result import Joined, Refused


def shapers_left_on(recorded: Sequence[tuple[Joined, Expectation]]) -> list[ShapersLeftOn]:
    """Return the shaper of each axis that has one."""
    tests = []
    for i, axis in enumerate("xy" if recorded else ""):
        experiments: dict[str, list[NormalEquations]] = {}
        for joined, expected in recorded:
            experiments.setdefault(joined.experiment, []).append(_equations(joined, expected, i))
        tests.append(shaper_of_captures(experiments, axis))
    return [test for test in tests if test is not None]


def _equations(joined: Joined, expected: Expectation, axis: int) -> NormalEquations:
    """Compare a capture's spectrum with those of the expected motion along an axis and of unknown effects."""
    recording = joined.recording
    measured = without_gaps(recording.time_s, recording.acceleration[f"acc_{'xyz'[axis]}"][:, None])[:, 0]
    t = joined.begin_s + recording.time_s
    parts = np.stack([expected.acceleration[:, axis], *expected.signatures[:, :, axis]], axis=1)
    inside = (t >= expected.time_s[0]) & (t <= expected.time_s[-1])
    columns = CubicSpline(expected.time_s, parts)(np.clip(t, expected.time_s[0], expected.time_s[-1]))
    frequency = np.asarray(np.fft.rfftfreq(len(t), 1.0 / recording.sample_rate_hz), dtype=np.float64)
    band = (frequency >= CAPTURES_BAND_HZ[0]) & (frequency <= CAPTURES_BAND_HZ[1])
    spectra = np.fft.rfft(columns * inside[:, None], axis=0)[band]
    return NormalEquations.of(frequency[band], np.fft.rfft(measured)[band], spectra)


def unlike(joined: Joined, least: float) -> str:
    """Say that a capture does not fit its motion, and give possible reasons."""
    rows = np.column_stack([joined.recording.acceleration[f"acc_{axis}"] for axis in "xyz"])
    resting = joined.begin_s + joined.recording.time_s < -0.1
    parts = (rows[resting], rows[~resting])
    rest, motion = (float(np.sqrt(np.nanmean(part**2))) if len(part) else 0.0 for part in parts)
    share, correlation = rest / max(motion, 1e-12), joined.clock.correlation
    kind = "shaken" if rest > max(0.1 * motion, 0.5) else "unlike"
    experiment = joined.experiment
    return fault(kind, experiment=experiment, correlation=correlation, least=least, rest=rest, share=share)


def left_handed(joined: Sequence[Joined]) -> list[str]:
    """Say for each mounting whether no chip can be mounted so."""
    turns = {axes: turn_of(axes) for axes in dict.fromkeys(each.axes_map for each in joined)}
    handed = {axes: 1.0 if turn is None else np.linalg.det(turn) for axes, turn in turns.items()}
    return [fault("mirrored", axes=axes) for axes, hand in handed.items() if hand < 0]


def check_repeats(joined: Sequence[Joined]) -> tuple[list[Joined], list[Refused], list[str]]:
    """Keep what repeats; refuse the others, and say which repeats are late."""
    kept: list[Joined] = []
    refused: list[Refused] = []
    notes: list[str] = []
    for name in dict.fromkeys(each.experiment for each in joined):
        repeats = [each for each in joined if each.experiment == name]
        pairs = [(a, b, _compared(a, b)) for a, b in combinations(repeats, 2)]
        for each in repeats:
            originals = [a for a, b, between in pairs if each in (a, b) and between.copied]
            others = [
                (a if b is each else b, between) for a, b, between in pairs if each in (a, b) and not between.copied
            ]
            if originals and each is not originals[0]:
                reason = fault("copy", other=Path(originals[0].source).name)
                refused.append(Refused(each.source, reason))
            elif not others or any(not between.differ for _, between in others):
                kept.append(each)
            else:
                other, between = min(others, key=lambda pair: pair[1].share)
                reason = (
                    f"Repeat {each.repeat} of {each.experiment} does not repeat: it differs from repeat {other.repeat} "
                    f"by {between.difference}. {REPEATS_REMEDY}; or give one repeat of each experiment, with "
                    "--without-repeats."
                )
                refused.append(Refused(each.source, reason))
        for a, b, between in pairs:
            if between.apart and not between.differ:
                lag_s = between.lag_s[1] - between.lag_s[0]
                notes.append(
                    f"{run_name(b.experiment, b.repeat)} is {1e3 * abs(lag_s):.2f} ms "
                    f"{'behind' if lag_s > 0 else 'ahead of'} {run_name(a.experiment, a.repeat)}; a delay of each "
                    "capture stays free in the diagnosis."
                )
    return kept, refused, notes


def _compared(first: Joined, second: Joined) -> RepeatComparison:
    """Compare two repeats on their common rows."""
    rate = first.recording.sample_rate_hz
    begin = max(first.begin_s, second.begin_s)
    cuts = [round((begin - each.begin_s) * rate) for each in (first, second)]
    n = min(len(each.recording.time_s) - cut for each, cut in zip((first, second), cuts, strict=True))
    signals = []
    for each, cut in zip((first, second), cuts, strict=True):
        rows = np.column_stack([each.recording.acceleration[f"acc_{axis}"] for axis in "xyz"])
        rows = without_gaps(each.recording.time_s, rows)[cut : cut + n]
        signals.append(rows - rows.mean(axis=0))
    speed = rate * np.gradient(first.recording.command[cuts[0] : cuts[0] + n], axis=0)
    return compare_repeats(signals, speed, rate)
