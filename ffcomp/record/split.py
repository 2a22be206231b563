"""Find the plan's experiments in a capture that holds several, or that bears no name of the plan.

A phone or a logger that ran all the time, one long capture, a file that was renamed: every experiment is sought by its
own motion below 20 Hz, whichever way the sensor is turned, and in the plan's order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import fftconvolve

from ffcomp.measurement.capture import Capture
from ffcomp.record.clock import Reference, thinned
from ffcomp.record.motion import Commanded
from ffcomp.record.plan import Experiment, Plan, run_name
from models.arrays import FloatArray

LEAST_LIKENESS = 0.8  # of a place in the record and an experiment, 0 to 1
RATIOS = 1.0 + 0.03 * np.linspace(-1.0, 1.0, 11)  # of clocks that nobody has set
MARGIN_S = 0.05  # kept from what comes before the rest and after it


@dataclass(frozen=True, eq=False)
class Execution:
    """A capture of one execution of an experiment."""

    capture: Capture
    experiment: Experiment
    repeat: int
    chip: str
    start: tuple[float, float] | None = None  # offset and ratio of its clock, about; None: not known
    played: Commanded | None = None  # the command, where it is not the experiment's own

    @property
    def motion(self) -> Commanded:
        """What was commanded."""
        return self.played or self.experiment.motion


@dataclass(frozen=True)
class _Place:
    """Where an experiment may begin in a record."""

    experiment: Experiment
    begin_s: float  # from the first row
    likeness: float
    ratio: float  # of the clocks

    @property
    def end_s(self) -> float:
        """Of the motion."""
        return self.begin_s + self.experiment.duration_s


def split_capture(capture: Capture, plan: Plan, references: Sequence[Reference], taken: set[str]) -> list[Execution]:
    """Cut a capture into the plan's executions, each with its experiment and the number of its repeat.

    Parameters
    ----------
    references : of the plan's experiments, in its order
    taken : names of the executions that were found in other captures, to which these are added
    """
    since, record = thinned(capture.time_s, capture.acceleration)
    runs = [run for run in plan.runs() if run_name(run[0].name, run[1]) not in taken]
    tried = []
    for ratio in (1.0,) if capture.clock == "firmware" else RATIOS:
        places = {
            experiment.name: _places(experiment, reference, since, record, plan.repeats, ratio)
            for experiment, reference in zip(plan.experiments, references, strict=True)
        }
        tried.append(_in_order([(repeat, place) for each, repeat in runs for place in places[each.name]], runs))
    chosen = max(tried, key=lambda each: sum(place.likeness for _, place in each))
    taken |= {run_name(place.experiment.name, repeat) for repeat, place in chosen}
    return [_cut(capture, place, repeat, plan) for repeat, place in chosen]


def _in_order(places: Sequence[tuple[int, _Place]], runs: Sequence[tuple[Experiment, int]]) -> list[tuple[int, _Place]]:
    """Choose the executions that follow each other as the plan has them and are likeliest together."""
    order = {(each.name, repeat): k for k, (each, repeat) in enumerate(runs)}
    best: list[tuple[float, int]] = []  # the sum up to each place, and the place before it
    for k, (repeat, place) in enumerate(places):  # in the order of the runs
        total, before = 0.0, -1
        for j, (other, earlier) in enumerate(places[:k]):
            follows = order[earlier.experiment.name, other] < order[place.experiment.name, repeat]
            if follows and earlier.end_s < place.begin_s and best[j][0] > total:
                total, before = best[j][0], j
        best.append((total + place.likeness, before))
    chosen: list[tuple[int, _Place]] = []
    k = max(range(len(best)), key=lambda i: best[i][0], default=-1)
    while k >= 0:
        chosen.append(places[k])
        k = best[k][1]
    return chosen[::-1]


def _places(
    experiment: Experiment, reference: Reference, since: FloatArray, record: FloatArray, repeats: int, ratio: float
) -> list[_Place]:
    """Find where an experiment fits best, a few times more often than the plan repeats it."""
    period = float(since[1] - since[0])
    t = np.arange(0.0, experiment.duration_s, period * ratio)
    if len(t) > len(record):
        return []
    likeness = _likeness(record, reference.at(t)[0])
    places = []
    for _ in range(2 * repeats):
        best = int(likeness.argmax())
        if likeness[best] < LEAST_LIKENESS:
            break
        places.append(_Place(experiment, best * period, float(likeness[best]), ratio))
        likeness[max(0, best - len(t) // 2) : best + len(t) // 2 + 1] = 0.0
    return places


def _likeness(record: FloatArray, expected: FloatArray) -> FloatArray:
    """Return how well (k, 3) fits (n, 3) from each row on under the best turn of the sensor: (n − k + 1,), 0 to 1.

    The correlation under the best rotation or reflection is the sum of the singular values of the axes' correlations.
    """
    size = len(expected)
    tables = np.stack(
        [fftconvolve(record, expected[::-1, [j]], mode="valid", axes=0) for j in range(3)], axis=2
    )  # (lags, sensor axis, printer axis)
    power = np.concatenate([[0.0], np.cumsum((record**2).sum(axis=1))])
    local = np.sqrt(np.maximum(power[size:] - power[:-size], 0.0)) * np.linalg.norm(expected)
    weight = np.maximum(local, 0.05 * local.max())  # at rest anything is alike
    likely = np.sqrt((tables**2).sum(axis=(1, 2))) / weight * np.sqrt(3.0) >= LEAST_LIKENESS  # an upper bound
    likeness = np.zeros(len(tables))
    likeness[likely] = np.linalg.svd(tables[likely], compute_uv=False).sum(axis=1) / weight[likely]
    return likeness


def _cut(capture: Capture, place: _Place, repeat: int, plan: Plan) -> Execution:
    experiment = place.experiment
    since = capture.time_s - capture.time_s[0]
    first = place.begin_s - plan.rest_before_s + MARGIN_S
    last = place.begin_s + experiment.duration_s + plan.rest_after_s - MARGIN_S
    rows = slice(int(np.searchsorted(since, first)), int(np.searchsorted(since, last)))
    name = run_name(experiment.name, repeat)
    part = replace(
        capture, time_s=capture.time_s[rows], acceleration=capture.acceleration[rows], name=name, clock="free"
    )
    start = place.ratio * float(since[rows.start] - place.begin_s)
    return Execution(part, experiment, repeat, "", (start, place.ratio))
