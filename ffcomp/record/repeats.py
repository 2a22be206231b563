"""Do repeats repeat? What differs between them is noise only if the rests before the motion show about as much.

A printer that warms up, a loose sensor or a belt that slips moves differently each time. Taken for noise, that would
hide what is to be found, or bear a wrong name.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.signal import butter, sosfiltfilt

from ffcomp.record.clock import without_gaps
from ffcomp.record.plan_files import run_name
from ffcomp.record.result import Joined, Refused
from models.arrays import FloatArray

BAND_HZ = (2.0, 150.0)
MOST_SHARE = 0.2  # of the signal
MOST_TIMES = 10.0  # what the rests show
NOISY_TIMES = 2.0  # the same: below, the sensor's noise is all that differs
SMALL_SHARE = 0.05  # of the signal: below, the microsteps' phase and the belts' teeth may differ
LEAST_NOISE_M_PER_S2 = 0.01  # of chips that round what they say
SAME_SHARE = 1e-9  # of the signal: no two measurements are so alike
SAID_LAG_S = 1e-4
REMEDY = (
    "Let the printer warm up for some minutes, tighten the sensor and what else is loose, and record it again; or give "
    "one repeat of each experiment, with --without-repeats."
)

COPIED = (
    "Its rows are those of {}: one recording under two names shows no noise. Give the capture that was made when the "
    "experiment was repeated, or leave this one out, with --without-repeats."
)


@dataclass(frozen=True)
class Difference:
    """Two repeats of one experiment, compared."""

    first: Joined
    second: Joined
    lag_s: float  # of the second behind the first; taken out of what follows
    share: float  # of the signal, root mean squares
    times: float  # what the rests show

    @property
    def repeats(self) -> bool:
        """Whether the same motion was measured twice."""
        if self.copied:
            return False
        loud = self.share > MOST_SHARE and self.times > NOISY_TIMES
        return not loud and (self.times <= MOST_TIMES or self.share <= SMALL_SHARE)

    @property
    def copied(self) -> bool:
        """Whether it is one measurement under two names."""
        return self.share < SAME_SHARE


def compare(first: Joined, second: Joined) -> Difference:
    """Compare two repeats, row by row between 2 and 150 Hz."""
    a, b, rate = _common(first, second)
    slope = np.gradient(a, 1.0 / rate, axis=0)
    lag = -float(np.sum(slope * (b - a)) / max(np.sum(slope**2), 1e-300))
    late = b - a + lag * slope
    rest = slice(0, max(8, int(-0.8 * max(first.begin_s, second.begin_s) * rate)))
    signal = float(np.sqrt(np.mean(a**2) + np.mean(b**2)) / np.sqrt(2.0))
    noise = float(np.sqrt(np.mean((b - a)[rest] ** 2) / 2.0))
    apart = float(np.sqrt(np.mean(late**2) / 2.0))
    return Difference(first, second, lag, np.sqrt(2.0) * apart / signal, apart / max(noise, LEAST_NOISE_M_PER_S2))


def _common(first: Joined, second: Joined) -> tuple[FloatArray, FloatArray, float]:
    """Return both records (n, 3) between 2 and 150 Hz on their common rows, and the rate, Hz."""
    rate = first.recording.sample_rate_hz
    begin = max(first.begin_s, second.begin_s)
    cut = []
    for each in (first, second):
        rows = np.column_stack([each.recording.acceleration[f"acc_{axis}"] for axis in "xyz"])
        cut.append(without_gaps(each.recording.time_s, rows)[round((begin - each.begin_s) * rate) :])
    n = min(map(len, cut))
    band = butter(4, (BAND_HZ[0], min(BAND_HZ[1], 0.45 * rate)), "bandpass", fs=rate, output="sos")
    a, b = (sosfiltfilt(band, each[:n], axis=0) for each in cut)
    return a, b, rate


def check_repeats(joined: Sequence[Joined]) -> tuple[list[Joined], list[Refused], list[str]]:
    """Keep what repeats; refuse the others, and say which repeats are late."""
    kept: list[Joined] = []
    refused: list[Refused] = []
    notes: list[str] = []
    for name in dict.fromkeys(each.experiment for each in joined):
        own = [each for each in joined if each.experiment == name]
        apart = [compare(a, b) for i, a in enumerate(own) for b in own[i + 1 :]]
        for each in own:
            with_others = [difference for difference in apart if each in (difference.first, difference.second)]
            originals = [difference.first for difference in with_others if difference.copied]
            with_others = [difference for difference in with_others if not difference.copied]
            if originals and each is not originals[0]:
                refused.append(Refused(each.source, COPIED.format(Path(originals[0].source).name)))
            elif not with_others or any(difference.repeats for difference in with_others):
                kept.append(each)
            else:
                refused.append(_refusal(each, min(with_others, key=lambda difference: difference.share)))
        notes += [_late(each) for each in apart if each.repeats and abs(each.lag_s) > SAID_LAG_S]
    return kept, refused, notes


def _refusal(each: Joined, difference: Difference) -> Refused:
    other = difference.first if difference.second is each else difference.second
    return Refused(
        each.source,
        f"Repeat {each.repeat} of {each.experiment} does not repeat: it differs from repeat {other.repeat} by "
        f"{difference.share:.0%} of the signal, {difference.times:.0f} times what the sensor shows at rest "
        f"({MOST_SHARE:.0%} and {MOST_TIMES:.0f} times are allowed). {REMEDY}",
    )


def _late(difference: Difference) -> str:
    a, b = difference.first, difference.second
    return (
        f"{run_name(b.experiment, b.repeat)} is {1e3 * abs(difference.lag_s):.2f} ms "
        f"{'behind' if difference.lag_s > 0 else 'ahead of'} {run_name(a.experiment, a.repeat)}; a delay of each "
        "capture stays free in the diagnosis."
    )
