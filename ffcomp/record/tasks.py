"""What a file holds of a plan: executions of its experiments, each with what its sensor is expected to feel."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ffcomp.errors import MeasurementError
from ffcomp.measurement.capture import Capture
from ffcomp.measurement.printer_logs import is_index, is_motion_log, read_motion_log
from ffcomp.measurement.vibration import read_captures
from ffcomp.record.clock import Matches, Reference, every_clock, known_clock, thinned
from ffcomp.record.expected import Expectation, expectation
from ffcomp.record.log_runs import executions
from ffcomp.record.motion import Commanded
from ffcomp.record.plan import Experiment, Plan, run_name
from ffcomp.record.split import Execution, split_capture
from models.arrays import FloatArray
from models.machine import Machine

MOST_MISSING = 0.02  # rows in the motion
LONGEST, LONGER_S = 1.5, 3.0  # a capture of one execution: RepRapFirmware's go on for a while


class Expected(dict[str, tuple[Expectation, Reference]]):
    """What each experiment of a plan is expected to feel like, computed when first needed."""

    def __init__(self, plan: Plan, machine: Machine) -> None:
        super().__init__()
        self._plan, self._machine = plan, machine

    def __missing__(self, name: str) -> tuple[Expectation, Reference]:
        self[name] = self._computed(next(each.motion for each in self._plan.experiments if each.name == name))
        return self[name]

    def of(self, each: Execution) -> tuple[Expectation, Reference]:
        """Return it of one execution, whose command may be its own."""
        return self[each.experiment.name] if each.played is None else self._computed(each.played)

    def _computed(self, motion: Commanded) -> tuple[Expectation, Reference]:
        expected = expectation(motion, self._machine, self._plan.rest_before_s)
        return expected, Reference(expected)


@dataclass(frozen=True, eq=False)
class Task:
    """A capture and the execution that it belongs to."""

    capture: Capture
    experiment: Experiment
    repeat: int
    chip: str
    since: FloatArray  # (k,) s, of the thinned record
    record: FloatArray  # (k, 3) m/s², the sensor's axes
    matches: Matches
    motion: Commanded
    ready: Expectation
    reference: Reference

    @property
    def gravity(self) -> FloatArray:
        """Return the mean, (3,) m/s²: a motion from rest to rest has none of its own."""
        return np.asarray(np.nanmean(self.capture.acceleration, axis=0))


def read_tasks(
    path: str | Path, plan: Plan, machine: Machine, expected: Expected, taken: set[str]
) -> tuple[list[Task], list[str]]:
    """Return what a file holds of the plan, and sentences about it.

    Parameters
    ----------
    taken : names of executions that were found by their motion in other files, to which these are added

    Raises
    ------
    MeasurementError
        For a file that cannot be read, or holds none of the plan's experiments.
    """
    executed: list[Execution] = []
    notes: list[str] = []
    if is_motion_log(path):
        if not is_index(path):  # which is read along with its log
            executed, notes = executions(read_motion_log(path), plan, machine)
    else:
        for capture in read_captures(path):
            executed += _executions(capture, plan, expected, taken)
    return [_task(each, plan, expected) for each in executed], notes


def _task(each: Execution, plan: Plan, expected: Expected) -> Task:
    capture = each.capture
    _check_rows(capture)
    ready, reference = expected.of(each)
    since, record = thinned(capture.time_s, capture.acceleration)
    if capture.clock == "firmware":
        matches = known_clock(since, record, reference, (stated(capture, plan, each.experiment)[0], 1.0))
    elif each.start is not None:
        matches = known_clock(since, record, reference, each.start)
    else:
        matches = every_clock(since, record, reference, ready)
    return Task(capture, each.experiment, each.repeat, each.chip, since, record, matches, each.motion, ready, reference)


def _executions(capture: Capture, plan: Plan, expected: Expected, taken: set[str]) -> list[Execution]:
    """Tell by name or motion which of the plan's executions a capture holds, of which chip."""
    named = _belongs(capture, plan)
    if named is not None:
        lasting = plan.rest_before_s + named[0].duration_s + plan.rest_after_s
        if capture.time_s[-1] - capture.time_s[0] < LONGEST * lasting + LONGER_S:
            return [Execution(capture, *named)]
    references = [expected[each.name][1] for each in plan.experiments]
    executed = split_capture(capture, plan, references, taken)
    if not executed:
        first = run_name(plan.experiments[0].name, 1)
        stem = capture.name or Path(capture.source).stem
        raise MeasurementError(
            capture.source,
            [
                f"Its name {stem!r} holds none of the plan's experiments, as {first!r} does, and its motion is none of "
                "those that are still to be found. Give the plan that its G-code was made with, and captures of one "
                "accelerometer and of one run of that file."
            ],
        )
    return executed


def _belongs(capture: Capture, plan: Plan) -> tuple[Experiment, int, str] | None:
    """Find experiment, repeat and chip by the name that the capture's command gave it."""
    stem = capture.name or Path(capture.source).stem
    for experiment in sorted(plan.experiments, key=lambda each: -len(each.name)):
        match = re.search(rf"{re.escape(experiment.name)}-(\d+)(?!\d)", stem)
        if match and 1 <= int(match[1]) <= plan.repeats:
            return experiment, int(match[1]), stem[: match.start()].strip("-_")
    return None


def _check_rows(capture: Capture) -> None:
    if capture.overflows:
        raise MeasurementError(
            capture.source,
            [
                f"The chip lost samples ({capture.overflows} overflows or drops), so its times are wrong. Record it "
                "again, with less load on the printer's host, or at a lower rate of the chip."
            ],
        )
    missing = float(np.isnan(capture.acceleration).any(axis=1).mean())
    if missing > MOST_MISSING:
        raise MeasurementError(
            capture.source,
            [f"{missing:.1%} of its rows are missing; {MOST_MISSING:.0%} may be. Record it again."],
        )


def stated(capture: Capture, plan: Plan, experiment: Experiment) -> tuple[float, float]:
    """Return between which times of the experiment the firmware has the first row, s.

    The first row is the first one at or after the beginning of the rest, the last row the last one at or before the end
    of the rest behind: two intervals of one sample, of which the common part is what is left.
    """
    period = 1.0 / capture.sample_rate_hz
    low, high = -plan.rest_before_s, -plan.rest_before_s + period
    span = float(capture.time_s[-1] - capture.time_s[0])
    end = experiment.duration_s + plan.rest_after_s - span
    both = max(low, end - period), min(high, end)
    return both if both[1] > both[0] else (low, high)
