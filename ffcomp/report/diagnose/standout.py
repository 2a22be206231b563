"""State in one sentence what stands out where the excess is split."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ffcomp.diagnose.summary import Split
from ffcomp.report.diagnose.words import joined, most_of, percent, times, times_noise

NOTHING = 0.1  # excess, of the noise, on the mean: there is nothing to split
HIGH = 1.5  # times the mean excess
A_LOT = 0.25  # of the excess
LITTLE = 0.1  # times the mean excess
NAMED = 4  # labels in one sentence

WHERE = {
    "frequency": "at {}",
    "signal": "in {}",
    "place": "at {}",
    "window of time": "in the window {}",
    "run": "in {}",
    "share of the run's time": "at {} of the runs' time",
    "motion": "while what is measured is {}",
    "size of motion": "among the samples between {} of the signal's range",
    "motor's step cycle": "at {} of the cycle",
}
MOTIONS = {"backward": "moving backward", "forward": "moving forward"}
SPREAD = {
    "frequency": "no band holds more than its part",
    "signal": "all signals have their part",
    "place": "all positions contribute",
    "window of time": "all windows of time have their part",
    "run": "all runs have their part",
    "share of the run's time": "early and late alike",
    "motion": "forward, backward and turning back alike",
    "size of motion": "small and large motion alike",
    "motor's step cycle": "no phase of the cycle holds much more than its part",
}


def stands_out(split: Split) -> str:
    """Return `81 % of the excess lies at 60-80 Hz (10 % of what was compared).`."""
    excess, weight = np.maximum(split.before, 0.0), np.array(split.weight)
    mean = float(excess @ weight)
    if mean < NOTHING:
        return "No excess here: the error is as large as the noise."
    if len(excess) == 1:
        return f"There is only one: {split.labels[0]}, where the error is {times(times_noise(mean))} the noise."
    hot = _hot(excess, mean, bool(split.spans))
    share = float(excess[hot] @ weight[hot]) / mean
    if not hot or share < A_LOT:
        return _spread(split, excess, mean)
    where = WHERE[split.title].format(_named(split, hot))
    most, compared = most_of(share), percent(float(weight[hot].sum()))
    return f"{most[0].upper()}{most[1:]} of the excess lies {where} ({compared} of what was compared)."


def _spread(split: Split, excess: np.ndarray, mean: float) -> str:
    """State that the excess is everywhere, or nearly."""
    spared = [] if split.spans else [int(i) for i in np.argsort(excess) if excess[i] < LITTLE * mean]
    if not spared:
        return f"Nothing stands out: {SPREAD[split.title]}."
    return f"It is everywhere but {WHERE[split.title].format(_named(split, spared))}."


def _hot(excess: np.ndarray, mean: float, in_a_row: bool) -> list[int]:
    """Labels whose excess is high; of labels in a row those around the highest."""
    high = excess > HIGH * mean
    if not in_a_row:
        return [int(i) for i in np.argsort(-excess) if high[i]]
    first = last = int(excess.argmax())
    while first > 0 and high[first - 1]:
        first -= 1
    while last < len(excess) - 1 and high[last + 1]:
        last += 1
    return list(range(first, last + 1)) if high[first] else []


def _named(split: Split, hot: Sequence[int]) -> str:
    if split.spans:
        return f"{split.spans[hot[0]][0]:.0f}-{split.spans[hot[-1]][1]:.0f} {split.unit}"
    names = [MOTIONS.get(split.labels[i], split.labels[i]) for i in hot[:NAMED]]
    more = len(hot) - NAMED
    return joined([*names, f"{more} more"] if more > 0 else names)
