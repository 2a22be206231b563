"""Captures of a recording, put on one clock with their commands: the order of the work on one page.

Read and match with the plan → find each chip's axes → find each capture's clock → subtract gravity → check → recording.
A capture that cannot be joined is refused in sentences; the others are joined all the same.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import resample_poly

from ffcomp.errors import MeasurementError
from ffcomp.measurement.faults import SHAPER_REMEDY, fault
from ffcomp.measurement.recording import CLOCKS, Recording, read_recording
from ffcomp.measurement.sensors import G
from ffcomp.measurement.vibration import kind_of
from ffcomp.record.axes import NEARLY_G, best_score, find_turn, tilt, words
from ffcomp.record.clock import (
    DEAF,
    ClockFit,
    Expectation,
    expectation,
    felt_shares,
    fit_clock,
    long_gaps,
    without_gaps,
)
from ffcomp.record.executions import Task, read_tasks, stated
from ffcomp.record.faults import check_repeats, left_handed, shapers_left_on, unlike
from ffcomp.record.plan import Plan, run_name
from ffcomp.record.prints import plan_of
from ffcomp.record.result import (
    DELAY_SD_S,
    KEPT_REST_S,
    Joined,
    JoinResult,
    Refused,
    joined_comments,
    measured_run,
)
from models.arrays import FloatArray
from models.machine import Machine

LEAST_REST_S = 0.2  # for gravity
NO_GRAVITY = 0.2  # of g: less, and an app has taken it out
LEAST_CORRELATION = 0.9
FARTHEST_S = 2e-3  # a firmware's clock from what the motion says
LATEST_S, ALIKE_S, LEAST_ALIKE = 8e-3, 1e-3, 4  # a machine that follows late does so in all of several captures
WORST_RATIO = 1e-3  # of a firmware's clock: beyond it, speeds were overridden
BIAS_SD_S = 1.5e-4  # of a clock that is fitted, by what the machine file lacks
REPEATS_SD_S, SURE = 3e-5, 2.0  # best resolution of the motion between two repeats; standard deviations
LOWEST_RATE_HZ = 800.0  # of a recording


def join_captures(
    paths: Sequence[str | Path],
    plan: Plan,
    machine: Machine,
    turn: FloatArray | None = None,
    progress: Callable[[str], None] = lambda sentence: None,
) -> JoinResult:
    """Join captures with the commands of their plan.

    turn : (3, 3) from the sensor's axes to the printer's; None: to be estimated from the captures
    """
    refused: list[Refused] = []
    expected, taken = cache(partial(expectation, machine=machine, lead_s=plan.rest_before_s)), set[str]()
    tasks: list[Task] = []
    for path in paths:
        progress(f"reading {Path(path).name}")
        try:
            tasks += read_tasks(path, plan, expected, taken)
        except MeasurementError as error:
            refused += [Refused(str(path), problem) for problem in error.problems]
    joined: list[list[Joined]] = []
    for chip in dict.fromkeys(task.chip for task in tasks):
        of_chip = [task for task in tasks if task.chip == chip]
        progress(f"joining {len(of_chip)} captures of {chip or 'the accelerometer'}")
        good, bad = _join_chip(of_chip, plan, turn)
        joined.append(good)
        refused += bad
    whole, lacking = _without_lacking_runs(_of_all_chips(joined), machine)
    kept, apart, late = check_repeats(sorted(whole, key=lambda each: each.name))
    heard, deaf = _without_deaf_axes(kept, machine)
    return JoinResult(tuple(heard), (*refused, *apart), (*lacking, *late, *deaf, *left_handed(kept)))


def _join_chip(tasks: Sequence[Task], plan: Plan, turn: FloatArray | None) -> tuple[list[Joined], list[Refused]]:
    """Join the captures of one accelerometer."""
    if turn is None:  # gravity is the mean: a motion from rest to rest has none of its own
        turn = find_turn([task.matches for task in tasks], np.nanmean(tasks[0].capture.acceleration, axis=0))
    clocks = [(task, _clock(task, plan, turn)) for task in tasks]
    refused: list[Refused] = []
    if not _all_alike_late([clock for _, clock in clocks]):  # else the machine follows all commands as late
        refused = [_displaced(task, clock) for task, clock in clocks if abs(clock.late_s) > FARTHEST_S]
        clocks = [each for each in clocks if abs(each[1].late_s) <= FARTHEST_S]
    rate = float(np.round(np.median([task.capture.sample_rate_hz for task in tasks])))
    joined: list[tuple[Joined, Expectation]] = []
    for task, clock in _narrowed(clocks):
        try:
            joined.append((_joined(task, clock, turn, rate), task.expected))
        except MeasurementError as error:
            refused += [Refused(task.capture.source, problem) for problem in error.problems]
    if shapers := shapers_left_on(joined):
        why = " ".join([*(each.claim for each in shapers), SHAPER_REMEDY])
        return [], refused + [Refused(each.source, why) for each, _ in joined]
    good = [each for each, _ in joined if each.clock.correlation >= LEAST_CORRELATION]
    refused += [Refused(each.source, unlike(each, LEAST_CORRELATION)) for each, _ in joined if each not in good]
    return good, refused


def load_recordings(
    paths: Sequence[str | Path],
    machine: Machine,
    plan: str | Path | None = None,
    turn: FloatArray | None = None,
    progress: Callable[[str], None] = lambda sentence: None,
) -> list[Recording]:
    """Read measured runs, and join captures with the commands of their plan.

    Raises MeasurementError for a run that cannot be used, for captures without a plan, and if none can be joined.

    plan : the file that `ffcomp record plan` wrote next to its G-code, or a print with the commands of captures; None:
        there are no captures
    turn : as of `join_captures`
    progress : called with a sentence for each file that is read, joined or refused
    """
    if plan is None:
        return [read_recording(path) for path in paths]  # which says what to do with a capture
    captures = [path for path in paths if kind_of(Path(path)) == "vibration"]
    runs = [read_recording(path) for path in paths if path not in captures]
    if not captures:
        return runs
    moves = plan_of(plan, machine)
    joined = join_captures(captures, moves, machine, turn, progress)
    joined.check()
    for each in joined.refused:
        progress(f"left out {each.file}: {each.why}")
    for sentence in joined.notes(moves, machine):
        progress(sentence)
    return [*runs, *joined.recordings]


# The clock


@dataclass(frozen=True)
class _Clock:
    """A clock estimated from the motion, and the firmware's interval of its offset, if known."""

    fit: ClockFit
    stated: tuple[float, float] | None  # s
    late_s: float = 0.0  # start of the motion after the plan's
    ratio: float = 1.0  # of its clock, if that were free and the motion is late


def _clock(task: Task, plan: Plan, axes: FloatArray) -> _Clock:
    record = task.record @ axes.T
    if task.capture.clock == "free":
        fit = fit_clock(task.since, record, task.expected, best_score(task.matches, axes)[1], free_ratio=True)
        return _Clock(replace(fit, offset_sd_s=float(np.hypot(fit.offset_sd_s, BIAS_SD_S))), None)
    logged = task.capture.clock == "log"
    interval = (task.matches.starts[0][0],) * 2 if logged else stated(task.capture, plan, task.experiment)
    middle = float(np.mean(interval))
    fit = fit_clock(task.since, record, task.expected, (middle, 1.0), free_ratio=False)
    if fit.correlation < LEAST_CORRELATION:  # refused later, or a shaper is to blame
        return _Clock(replace(fit, offset_s=middle), None)
    late, ratio = middle - fit.offset_s, 1.0
    if abs(late) > FARTHEST_S:
        ratio = fit_clock(task.since, record, task.expected, (fit.offset_s, 1.0), free_ratio=True).ratio
    if logged:
        return _Clock(replace(fit, offset_s=middle, offset_sd_s=DELAY_SD_S["log"]), None, late, ratio)
    return _Clock(fit, interval, late, ratio)


def _displaced(task: Task, clock: _Clock) -> Refused:
    """Refuse a capture that begins elsewhere than the plan has it."""
    pace = ""  # of the motion or of the clock: the two cannot be separated
    if abs(clock.ratio - 1.0) >= WORST_RATIO:
        pace = f"; by its clock it runs at {clock.ratio:.1%} of the plan's pace"
    return Refused(
        task.capture.source,
        f"The motion in it begins {1e3 * clock.late_s:+.1f} ms from where the plan has it, and may be "
        f"{1e3 * FARTHEST_S:g} ms off{pace}: it is of another motion, or the printer did not run the "
        "plan's G-code unchanged. Run the file again, from its beginning, with a speed factor of 100 %.",
    )


def _all_alike_late(clocks: Sequence[_Clock]) -> bool:
    """Return whether all begin equally late and keep their pace; another motion does neither."""
    late = np.array([clock.late_s for clock in clocks])
    if len(late) < LEAST_ALIKE or not FARTHEST_S < np.median(late) < LATEST_S:
        return False
    paces = np.array([clock.ratio for clock in clocks])
    return bool(np.ptp(late) < ALIKE_S and np.abs(paces - 1.0).max() < WORST_RATIO)


def _narrowed(clocks: Sequence[tuple[Task, _Clock]]) -> list[tuple[Task, ClockFit]]:
    """Choose each offset inside the firmware's interval.

    What the machine file lacks shifts the fitted offsets of all repeats of an experiment alike, and the intervals of
    all repeats bound this shift.
    """
    narrowed = []
    for task, clock in clocks:
        if clock.stated is None:
            narrowed.append((task, clock.fit))
            continue
        fitted = clock.fit.offset_s
        low, high = (edge - fitted for edge in clock.stated)
        for sibling, other in clocks:
            if sibling is not task and sibling.experiment is task.experiment and other.stated is not None:
                slack = SURE * float(np.hypot(other.fit.offset_sd_s, clock.fit.offset_sd_s))
                bound = [edge - other.fit.offset_s for edge in other.stated]
                both = max(low, bound[0] - slack), min(high, bound[1] + slack)
                low, high = both if both[1] > both[0] else (low, high)
        sd = float(np.hypot((high - low) / np.sqrt(12.0), REPEATS_SD_S))
        trusted = BIAS_SD_S**2 / (BIAS_SD_S**2 + sd**2)  # the middle of the bounds, against no shift at all
        offset = float(np.clip(fitted + trusted * 0.5 * (low + high), *clock.stated))
        narrowed.append((task, replace(clock.fit, offset_s=offset, offset_sd_s=sd, ratio=1.0, ratio_sd=0.0)))
    return narrowed


# The recording


def _joined(task: Task, clock: ClockFit, axes: FloatArray, rate_hz: float) -> Joined:
    capture, duration_s = task.capture, task.expected.duration_s
    tau = clock.offset_s + clock.ratio * (capture.time_s - capture.time_s[0])
    if tau[0] > -LEAST_REST_S or tau[-1] < duration_s:
        reason = (
            f"It runs from {tau[0]:.2f} to {tau[-1]:.2f} s of a motion of {duration_s:.2f} s; it must begin "
            f"{LEAST_REST_S:g} s before and end after it. The print was cancelled, the capture ended early, or the "
            "machine file is of another printer, whose limits make the motion longer. Record longer."
        )
        raise MeasurementError(capture.source, [reason])
    rest = tau < -0.5 * LEAST_REST_S
    gravity = np.nanmean(capture.acceleration[rest] @ axes.T, axis=0)
    ratio = float(np.linalg.norm(gravity)) / G
    if abs(ratio - 1.0) > NEARLY_G and not (capture.clock == "free" and ratio < NO_GRAVITY):
        raise MeasurementError(capture.source, [fault("no gravity", size=ratio * G, ratio=ratio)])
    upright = tilt(gravity)
    measured = (capture.acceleration @ axes.T - gravity) @ upright.T
    first, last = max(float(tau[0]), -KEPT_REST_S[0]), min(float(tau[-1]), duration_s + KEPT_REST_S[1])
    # repeats are compared row by row: all have their rows at the same times of the experiment
    factor = max(1, int(np.ceil(LOWEST_RATE_HZ / rate_hz)))
    step = 1.0 / (factor * rate_hz)
    grid = step * np.arange(np.ceil(first / step), np.floor(last / step) + 1)
    name, rows = task.experiment.name, _on_grid(tau, measured, grid, factor)
    comments = joined_comments(clock, capture.source, name, task.repeat, capture.clock, capture.overflows)
    sensors = {f"acc_{axis}": rows[:, i] for i, axis in enumerate("xyz")}
    recording = measured_run(
        run_name(name, task.repeat), task.experiment.motion, grid, sensors, {**comments, "axes_map": words(axes)}
    )
    return Joined(
        recording=recording,
        experiment=name,
        repeat=task.repeat,
        clock=clock,
        overflows=capture.overflows,
        source=capture.source,
        axes_map=words(axes),
        begin_s=float(grid[0]),
        felt=felt_shares(task.record @ axes.T, task.expected, clock.offset_s + clock.ratio * task.since),
    )


def _on_grid(tau: FloatArray, measured: FloatArray, grid: FloatArray, factor: int) -> FloatArray:
    """Interpolate rows (n, 3) at times (n,) to a grid (k,); NaN next to gaps too long to bridge."""
    missing = long_gaps(tau, measured)
    at, rows = tau, without_gaps(tau, measured)
    if factor > 1:  # a slow sensor: more rows of the same spectrum
        rows = np.asarray(resample_poly(rows, factor, 1, axis=0))
        at = tau[0] + (tau[-1] - tau[0]) / (len(tau) - 1) / factor * np.arange(len(rows))
    resampled = np.asarray(CubicSpline(at, rows)(grid))
    near = np.clip(np.searchsorted(tau, grid), 1, len(tau) - 1)
    resampled[missing[near] | missing[near - 1]] = np.nan
    return resampled


# Several chips
#
# The toolhead of a bed slinger does not move along y: its chip feels x, and one on the bed feels y, the other way
# round. Where all that moves carries one chip, there is nothing to choose.

AXES = "xyz"


def _of_all_chips(by_chip: Sequence[Sequence[Joined]]) -> list[Joined]:
    """Return one recording an execution: on the rows of one chip, with the axes that it is deaf to of the others.

    Repeats are compared row by row, so all are on the rows of the chip that fits its commands best, if it has them.
    """
    by_name: dict[str, list[Joined]] = {}
    for members in sorted(by_chip, key=lambda joined: sum(each.clock.correlation for each in joined), reverse=True):
        for each in members:
            by_name.setdefault(each.name, []).append(each)
    return [_together(members) for members in by_name.values()]


def _together(members: Sequence[Joined]) -> Joined:
    """Join the recordings of one execution, the best chip's first."""
    best, chips = members[0], dict.fromkeys(AXES, 0)
    for i, axis in enumerate(AXES):
        chip = int(np.argmax([each.felt[i] for each in members]))
        if members[chip].felt[i] > best.felt[i] and best.felt[i] < DEAF:
            shares = (*best.felt[:i], members[chip].felt[i], *best.felt[i + 1 :])
            best = replace(best, recording=_with_axis(best, members[chip], f"acc_{axis}"), felt=shares)
            chips[axis] = chip
    if len(set(chips.values())) == 1:
        return best
    groups = [  # the columns of one chip, and so on one clock
        " ".join(f"acc_{axis}" for axis, of_axis in chips.items() if of_axis == chip)
        for chip in sorted({*chips.values()})
    ]
    comments = {**best.recording.comments, CLOCKS: ", ".join(groups)}
    return replace(best, recording=replace(best.recording, comments=comments))


def _with_axis(best: Joined, source: Joined, column: str) -> Recording:
    """Put another chip's axis on the rows of the first one's recording; both are on the experiment's clock."""
    recording, other = best.recording, source.recording
    at = np.clip(recording.time_s + best.begin_s - source.begin_s, 0.0, other.time_s[-1])  # both end at rest
    values = other.acceleration[column]
    known = np.isfinite(values)
    resampled = np.asarray(CubicSpline(other.time_s[known], values[known])(at))
    near = np.clip(np.searchsorted(other.time_s, at), 1, len(values) - 1)
    resampled[~(known[near] & known[near - 1])] = np.nan
    return replace(recording, acceleration={**recording.acceleration, column: resampled})


def _without_deaf_axes(joined: Sequence[Joined], machine: Machine) -> tuple[list[Joined], list[str]]:
    """Leave out axes that no chip feels, on a machine whose bed may move, and report it."""
    deaf = [axis for axis, share in _median_shares(joined, machine).items() if share < DEAF]
    heard = list[Joined]()
    for each in joined:
        kept = {name: values for name, values in each.recording.acceleration.items() if name[-1] not in deaf}
        heard.append(replace(each, recording=replace(each.recording, acceleration=kept)))
    return heard, [fault("deaf", axis=axis) for axis in deaf]


def _median_shares(joined: Sequence[Joined], machine: Machine) -> dict[str, float]:
    """Return how much of the motion along each axis its chip feels, where the bed may move: each axis has its motor."""
    if not joined or machine.vibration.moves != "axes" or machine.kinematics.shares_motors:
        return {}
    return dict(zip(AXES, np.median([each.felt for each in joined], axis=0).tolist(), strict=True))


def _without_lacking_runs(joined: Sequence[Joined], machine: Machine) -> tuple[list[Joined], list[str]]:
    """Leave out runs that lack the one chip that feels an axis: the others would show it at rest; report them."""
    audible = [axis for axis, share in _median_shares(joined, machine).items() if share >= DEAF]
    lacking = {
        each.name: axis
        for each in joined
        for axis, share in zip(AXES, each.felt, strict=True)
        if share < DEAF and axis in audible
    }
    notes = [
        f"{name} is left out: the capture of the chip that feels {axis} is missing, or was not joined."
        for name, axis in lacking.items()
    ]
    return [each for each in joined if each.name not in lacking], notes
