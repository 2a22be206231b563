"""What a file holds of a plan: executions of its experiments, each with what its sensor is expected to feel.

A capture's name identifies its execution. One that holds several, or bears no name of the plan (a phone or a logger
that ran all the time, a file that was renamed), is searched for every experiment's motion below 20 Hz, whichever way
the sensor is turned, in the plan's order. In a log of Klipper's data logger the commanded nozzle identifies it,
exactly in time.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from scipy.signal import fftconvolve

from ffcomp.errors import MeasurementError
from ffcomp.measurement.capture import Capture, make_capture
from ffcomp.measurement.faults import fault
from ffcomp.measurement.printer_logs import MotionLog, Samples, is_index, is_motion_log, read_motion_log
from ffcomp.measurement.table import Table
from ffcomp.measurement.vibration import read_captures
from ffcomp.record.clock import Expectation, Matches, every_clock, known_clock, peaks, thinned
from ffcomp.record.plan import Experiment, Motion, Plan, run_name
from models.arrays import FloatArray

MOST_MISSING = 0.02  # rows in the motion
LONGEST, LONGER_S = 1.5, 3.0  # a capture of one execution: RepRapFirmware's go on for a while


Expected = Callable[[Motion], Expectation]  # what an accelerometer feels of a motion


@dataclass(frozen=True, eq=False)
class Execution:
    """A capture of one execution of an experiment."""

    capture: Capture
    experiment: Experiment
    repeat: int
    chip: str
    start: tuple[float, float] | None = None  # offset and ratio of its clock, about; None: not known


@dataclass(frozen=True, eq=False)
class Task(Execution):
    """The same with how well it fits its motion."""

    since: FloatArray = field(kw_only=True)  # (k,) s, of the thinned record
    record: FloatArray = field(kw_only=True)  # (k, 3) m/s², the sensor's axes
    expected: Expectation = field(kw_only=True)
    matches: Matches = field(kw_only=True)


def read_tasks(path: str | Path, plan: Plan, expected: Expected, taken: set[str]) -> list[Task]:
    """Return what a file holds of the plan; MeasurementError if it is nothing.

    taken : names of executions that were found by their motion in other files, to which these are added
    """
    executed: list[Execution] = []
    if is_motion_log(path):
        executed = [] if is_index(path) else executions(read_motion_log(path), plan)
    else:
        for capture in read_captures(path):
            executed += _executions(capture, plan, expected, taken)
    return [_task(each, plan, expected) for each in executed]


def _task(each: Execution, plan: Plan, expected: Expected) -> Task:
    capture = each.capture
    if capture.overflows:
        raise MeasurementError(capture.source, [fault("lost samples", overflows=capture.overflows)])
    missing = float(np.isnan(capture.acceleration).any(axis=1).mean())
    if missing > MOST_MISSING:
        reason = f"{missing:.1%} of its rows are missing; {MOST_MISSING:.0%} may be. Record it again."
        raise MeasurementError(capture.source, [reason])
    felt = expected(each.experiment.motion)
    since, record = thinned(capture.time_s, capture.acceleration)
    start = (stated(capture, plan, each.experiment)[0], 1.0) if capture.clock == "firmware" else each.start
    matches = every_clock(since, record, felt) if start is None else known_clock(since, record, felt, start)
    return Task(**vars(each), since=since, record=record, expected=felt, matches=matches)


def _executions(capture: Capture, plan: Plan, expected: Expected, taken: set[str]) -> list[Execution]:
    """Identify the executions of the plan in a capture, and its chip, by name or motion."""
    stem = capture.name or Path(capture.source).stem
    named = _named(stem, plan)
    if named is not None:
        lasting = plan.capture_s(named[0])
        if capture.time_s[-1] - capture.time_s[0] < LONGEST * lasting + LONGER_S:
            return [Execution(capture, *named)]
    if sum(each.excitation is not None for each in plan.experiments) > 1:
        raise MeasurementError(capture.source, [fault("alike", stem=stem, first=run_name(plan.experiments[0].name, 1))])
    executed = _split(capture, plan, expected, taken)
    if not executed:
        first = run_name(plan.experiments[0].name, 1)
        raise MeasurementError(
            capture.source,
            [
                f"Its name {stem!r} holds none of the plan's experiments, as {first!r} does, and its motion is none of "
                "those that are still to be found. Give the plan that its G-code was made with, and captures of one "
                "accelerometer and of one run of that file."
            ],
        )
    return executed


def _named(stem: str, plan: Plan) -> tuple[Experiment, int, str] | None:
    """Find experiment, repeat and chip by the name that the capture's command gave it."""
    for experiment in sorted(plan.experiments, key=lambda each: -len(each.name)):
        once = "?" if plan.print_file else ""  # a print is made once, and its captures need no number
        match = re.search(rf"{re.escape(experiment.name)}(?:-(\d+)){once}(?!\d)", stem)
        if match and 1 <= int(match[1] or 1) <= plan.repeats:
            return experiment, int(match[1] or 1), stem[: match.start()].strip("-_")
    return None


def stated(capture: Capture, plan: Plan, experiment: Experiment) -> tuple[float, float]:
    """Return between which times of the experiment the firmware has the first row, s.

    The first row is the first one at or after the beginning of the rest, the last row the last one at or before the end
    of the rest after it: the result is the common part of two intervals of one sample.
    """
    period = 1.0 / capture.sample_rate_hz
    low, high = -plan.rest_before_s, -plan.rest_before_s + period
    span = float(capture.time_s[-1] - capture.time_s[0])
    end = experiment.duration_s + plan.rest_after_s - span
    both = max(low, end - period), min(high, end)
    return both if both[1] > both[0] else (low, high)


# Captures without a name of the plan

LEAST_LIKENESS = 0.8  # of a place in the record and an experiment, 0 to 1
RATIOS = 1.0 + 0.03 * np.linspace(-1.0, 1.0, 11)  # of clocks that run free
MARGIN_S = 0.05  # kept from the motions before the rest and after it


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


def _split(capture: Capture, plan: Plan, expected: Expected, taken: set[str]) -> list[Execution]:
    """Cut a capture into those of the plan's executions that are not in other captures."""
    since, record = thinned(capture.time_s, capture.acceleration)
    runs = [run for run in plan.runs() if run_name(run[0].name, run[1]) not in taken]
    tried = []
    for ratio in (1.0,) if capture.clock == "firmware" else RATIOS:
        places = {
            each.name: _places(each, expected(each.motion), since, record, plan.repeats, ratio)
            for each in plan.experiments
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
    experiment: Experiment, expected: Expectation, since: FloatArray, record: FloatArray, repeats: int, ratio: float
) -> list[_Place]:
    """Find where an experiment fits best, a few times more often than the plan repeats it."""
    period = float(since[1] - since[0])
    t = np.arange(0.0, experiment.duration_s, period * ratio)
    if len(t) > len(record):
        return []
    likeness = _likeness(record, expected.at(t)[0])
    begins = peaks(likeness, len(t) // 2, 2 * repeats, LEAST_LIKENESS)
    return [_Place(experiment, begin * period, float(likeness[begin]), ratio) for begin in begins]


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


# Logs of Klipper's data logger

REST_S = 0.3  # between two motions
NEAR_MM = 0.05  # of the plan's nozzle to the log's
PER_SECOND = 200.0  # samples where nozzles are compared


def executions(log: MotionLog, plan: Plan) -> list[Execution]:
    """Return the captures of every execution that the log holds."""
    executed: list[Execution] = []
    repeats: Counter[str] = Counter()
    for begin in _beginnings(log):
        experiment = next((each for each in plan.experiments if _is(log, begin, each)), None)
        if experiment is None or repeats[experiment.name] >= plan.repeats:
            continue
        repeats[experiment.name] += 1
        name = run_name(experiment.name, repeats[experiment.name])
        for chip, samples in log.sensors.items():
            capture = _capture(log, samples, begin, experiment, plan, name)
            start = (float(capture.time_s[0]) - begin, 1.0)
            executed.append(Execution(capture, experiment, repeats[experiment.name], chip, start))
    if not executed:
        raise MeasurementError(
            log.source,
            [
                "None of the plan's experiments is in its commanded motion. Log while the plan's own G-code runs, with "
                "bed mesh and skew correction off as it switches them."
            ],
        )
    return executed


def _beginnings(log: MotionLog) -> list[float]:
    """List the print times when the nozzle begins to move after a rest."""
    nozzle = log.nozzle
    moving = (nozzle.speed != 0) | (nozzle.acceleration != 0)
    begin, end = nozzle.begin_s[moving], (nozzle.begin_s + nozzle.lasts_s)[moving]
    return [float(t) for t in begin[np.concatenate([[True], begin[1:] - end[:-1] >= REST_S])]]


def _is(log: MotionLog, begin: float, experiment: Experiment) -> bool:
    t = np.linspace(0.0, experiment.duration_s, max(2, int(PER_SECOND * experiment.duration_s)))
    return bool(np.abs(log.nozzle.at(begin + t) - experiment.motion.nozzle(t)).max() < NEAR_MM)


def _capture(log: MotionLog, samples: Samples, begin: float, experiment: Experiment, plan: Plan, name: str) -> Capture:
    first, last = begin - plan.rest_before_s, begin + experiment.duration_s + plan.rest_after_s
    within = (samples.time_s >= first) & (samples.time_s <= last)
    rows = np.column_stack([samples.time_s[within], samples.acceleration[within]])
    if len(rows) < 2:
        raise MeasurementError(log.source, [f"It holds no accelerations of {name}: the logger was started too late."])
    table = Table(("time", "x", "y", "z"), rows, np.arange(1, len(rows) + 1), {})
    lost = int(((samples.lost_at_s >= first) & (samples.lost_at_s <= last)).sum())
    return make_capture(log.source, table, rows[:, 0], rows[:, 1:], name=name, clock="log", overflows=lost)
