"""How long a print takes at equal error: with every shaper, with ffcomp, and what nothing can be quicker than.

slices     compare.sampling         that stand for the print
rules      compare.quickest_plans   feeds, acceleration, flow, layer times: the same for all
shapers    compare.quickest_plans   the quickest setting of each that keeps the bound
ffcomp     faster                   the quickest plan whose error stays under the bound
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from ffcomp.comparison import methods as every
from ffcomp.comparison.baselines import LinearPrinter
from ffcomp.comparison.evaluation import Execution, Progress, contour, in_parallel, weights
from ffcomp.comparison.methods import COMPENSATED, TunedMethod, compensated, segments, segments_motion
from ffcomp.comparison.monte_carlo import draw_plants
from ffcomp.comparison.quickest_plans import (
    FEEDS,
    SLICE_S,
    BoundedSlice,
    SettingSearch,
    WholePrint,
    bound_of,
    seconds_of,
)
from ffcomp.comparison.result import FASTER, Family, Party, Piece, Quickest, TimedMethod
from ffcomp.comparison.sampling import Print, PrintSlice, Sampling, check_long_enough
from ffcomp.faster.bound import Bound
from ffcomp.faster.program import AS_SLICED, COOLING
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.settings import Settings, settings_for
from ffcomp.metrics import contour_statistics
from ffcomp.planner.limits import FILAMENT_MM
from ffcomp.shapers.smooth import USUAL
from ffcomp.simulation.playback import simulate_nozzles
from ffcomp.version import __version__
from models.arrays import FloatArray, IntArray
from models.machine import Machine

EVALUATED_S = 48.0  # of all slices unless more is requested
TUNED_S = 30.0  # on which shapers are tuned
KEPT_FEEDS = (1.0, 0.7, 0.5, 0.35)


@dataclass(frozen=True, slots=True)
class QuickestRequest:
    """Options of a comparison at equal error."""

    bound: Bound = field(default_factory=lambda: Bound(25.0))
    sampling: Sampling = field(default_factory=Sampling)
    shapers: tuple[str, ...] = USUAL
    mismatch: float = 0.0  # relative standard deviation of the Monte-Carlo plants' parameters
    seeds: int = 0  # number of Monte-Carlo plants


@dataclass(frozen=True, eq=False)
class _Job:
    """What every method needs."""

    machine: Machine
    plant: Machine
    settings: Settings
    bound: Bound
    whole: WholePrint
    bounded_slices: list[BoundedSlice]
    plants: list[Machine]  # printers that are off, on which the commands are evaluated too


def quickest(
    printed: Print,
    plant: Machine | None = None,
    request: QuickestRequest | None = None,
    *,
    settings: Settings | None = None,
    progress: Progress = lambda what, done: None,
) -> Quickest:
    """Find how long the print takes with every method at the error that all may have; arguments as of `compare`."""
    started, machine = time.perf_counter(), printed.machine
    request, plant, settings = request or QuickestRequest(), plant or machine, settings or settings_for(machine)
    bound = bound_of(printed, request.bound)
    at_most_s = EVALUATED_S if request.sampling.share is None else np.inf
    slices, sampled = printed.slices(request.sampling, SLICE_S, at_most_s)
    check_long_enough(slices, printed.path)
    bounded_slices = [BoundedSlice.of(each, printed.labels.features, bound) for each in slices]
    plants = draw_plants(plant, request.mismatch, request.seeds)
    job = _Job(machine, plant, settings, bound, WholePrint(printed, bound), bounded_slices, plants)
    linear = LinearPrinter(plant, _some(slices))
    keep_time = replace(settings, time_scaling=False)
    feeds_kept = replace(every.inversion(machine, keep_time, COMPENSATED), label="ffcomp, feeds kept")
    tasks = [
        partial(_set, job, every.none, FEEDS),
        *(partial(_set, job, partial(every.best_fixed, linear, kind), FEEDS) for kind in request.shapers),
        partial(_set, job, lambda: feeds_kept, KEPT_FEEDS),
        partial(_faster, job),
    ]
    methods = in_parallel(tasks, "seeking the quickest print", progress)
    return Quickest(
        print_name=printed.path,
        print_sha256=printed.sha256,
        machine=Party.of(machine),
        plant=Party.of(plant),
        version=__version__,
        bound_um=bound.max_error_um,
        max_flow_mm3_per_s=_flow(job),
        min_layer_time_s=job.whole.shortest_s,
        sampling=sampled,
        whole=len(slices) == 1 and len(slices[0].layer) == len(printed.program.moves),
        sliced=_sliced(job),
        methods={each.name: each for each in methods},
        actuator_limit_s=job.whole.actuator_limit_s(),
        seconds=time.perf_counter() - started,
        mismatch=(
            f"What was found is also played on {request.seeds} printers whose dynamic parameters are each off by a "
            f"normal draw with a standard deviation of {request.mismatch:.0%}."
            if request.seeds
            else ""
        ),
    )


def _some(slices: Sequence[PrintSlice]) -> list[PrintSlice]:
    chosen, seconds = list[PrintSlice](), 0.0
    for each in sorted(slices, key=lambda each: abs(each.begin_t - slices[len(slices) // 2].begin_t)):
        if not chosen or seconds + each.trajectory.end_t <= TUNED_S:
            chosen.append(each)
            seconds += each.trajectory.end_t
    return chosen


def _flow(job: _Job) -> float | None:
    """Return the nozzle's flow that no method exceeds, mm³/s."""
    if job.bound.max_flow_mm3_per_s is not None:
        return job.bound.max_flow_mm3_per_s
    print_slice = job.whole.bounded.print_slice
    moves, extrudes = print_slice.planned.program.moves, print_slice.extrudes
    filament = print_slice.trajectory.direction[:, 3][extrudes]
    if not filament.size:
        return None
    return float((moves.speed[extrudes] * filament).max() * 0.25 * np.pi * FILAMENT_MM**2)


# ---- the methods ---------------------------------------------------------------------------------


def _sliced(job: _Job) -> TimedMethod:
    executions = [_execution(job.plant, each.print_slice, every.none()) for each in job.bounded_slices]
    about = "The slicer's speeds, without compensation."
    return _timed_method(job, ("sliced", "as sliced", "none", about), executions, job.whole.bounded.seconds)


def _set(job: _Job, tune: Callable[[], TunedMethod], feeds: Sequence[float]) -> TimedMethod:
    """Seek the quickest feeds, of these, and acceleration of a method that keep the bound."""
    method = tune()
    setting = SettingSearch(method, job.bounded_slices, job.plant, job.bound.max_error_um).setting(feeds)
    feed, acceleration = setting.feed, setting.acceleration_mm_per_s2
    executions = [_execution(job.plant, each.at(feed, acceleration), method) for each in job.bounded_slices]
    about = (method.name, method.label, method.family, method.tuning)
    timed = _timed_method(job, about, executions, job.whole.at(feed, acceleration))
    return replace(timed, feed=feed, acceleration_mm_per_s2=acceleration)


def _execution(plant: Machine, print_slice: PrintSlice, method: TunedMethod) -> Execution:
    motion, _ = method.motion(print_slice)
    t, (nozzle,) = simulate_nozzles([plant], motion, print_slice.machine)
    return Execution(print_slice, motion, t, nozzle)


def _faster(job: _Job) -> TimedMethod:
    """Make every slice as quick as the bound allows for printers as uncertain as the machine file says."""
    robust = replace(job.settings, robust=True)  # as `compensate` does under a bound
    model = InverseModel(job.machine, robust)
    quick = [_FasterSlice.of(each, model, job) for each in job.bounded_slices]
    estimated = job.whole.from_slices(job.bounded_slices, [each.seconds for each in quick])
    seconds = job.whole.cooled(estimated)
    whose = f"{100 * (1 - job.bound.safety):.0f} % of printers as uncertain as the machine file says"
    tuning = f"Every move as fast as error, flow and the machine's limits allow; the bound holds for {whose}."
    timed = _timed_method(
        job, (FASTER, "ffcomp, faster", "inversion", tuning), [each.execution for each in quick], seconds
    )
    limited = _limited(job, quick, estimated, float(seconds.sum() - estimated.sum()))
    warnings = dict.fromkeys(warning for each in quick for warning in each.warnings)
    return replace(timed, limited_by=limited, warnings=tuple(warnings))


@dataclass(frozen=True, eq=False)
class _FasterSlice:
    """A slice, as quick as the bound allows."""

    execution: Execution
    seconds: FloatArray  # (n,) s of each move
    limited_by: dict[str, float]
    warnings: tuple[str, ...]

    @classmethod
    def of(cls, bounded: BoundedSlice, model: InverseModel, job: _Job) -> _FasterSlice:
        part, machine = bounded.print_slice, job.machine
        faster, planned = bounded.faster(model, job.bound)
        quick = replace(part, planned=planned)
        file = compensated(quick.planned, machine, model, part.flavor, part.offset)
        motion = segments_motion(segments(file, machine, part.before, part.start))
        t, (nozzle,) = simulate_nozzles([job.plant], motion, machine)
        longer = file.statistics.print_time_s / max(file.statistics.original_print_time_s, 1e-9)
        seconds = seconds_of(quick.trajectory) * longer
        execution = Execution(quick, motion, t, nozzle)
        return cls(execution, seconds, faster.limited_by, file.statistics.warnings)


def _limited(job: _Job, quick: Sequence[_FasterSlice], estimated: FloatArray, cooling_s: float) -> dict[str, float]:
    """Return what limits the quicker print, s of the whole, from the shares in its slices."""
    names = dict.fromkeys(name for each in quick for name in each.limited_by)
    sums = {name: sum(each.limited_by.get(name, 0.0) for each in quick) for name in names if name != AS_SLICED}
    free = job.whole.bounded.free
    scale = float(estimated[free].sum()) / max(sum(sums.values()), 1e-9)
    return {
        **{name: scale * s for name, s in sums.items()},
        AS_SLICED: float(estimated[~free].sum()),
        COOLING: cooling_s,
    }


# ---- what is said of each ------------------------------------------------------------------------


def _timed_method(
    job: _Job, about: tuple[str, str, Family, str], executions: Sequence[Execution], seconds: FloatArray
) -> TimedMethod:
    name, label, family, tuning = about
    counted = [each for each in executions if each.counted.any()]
    error = contour_statistics(contour(counted), weights(counted))
    return TimedMethod(
        name=name,
        label=label,
        family=family,
        tuning=tuning,
        print_time_s=float(seconds.sum()),
        by_feature_s=job.whole.by_feature(seconds),
        contour_rms_um=error.rms_um,
        contour_p99_um=error.p99_um,
        contour_max_um=error.max_um,
        by_feature_p99_um=_by_feature_p99_um(job, counted),
        reached=error.p99_um <= job.bound.max_error_um,
        pieces=tuple(_piece(each) for each in counted),
        off_p99_um=_off_p99_um(job, counted),
    )


def _by_feature_p99_um(job: _Job, executions: Sequence[Execution]) -> dict[str, float]:
    """Return the 99th percentile of what extrudes, by its feature, µm."""
    features, error = list[IntArray](), contour(executions)
    for each in executions:
        part = each.print_slice
        move = part.trajectory.move_at(each.motion.clock.plan_time(each.t[each.counted]))
        features.append(np.where(part.extrudes[move], part.feature[move], -1))
    of, names = np.concatenate(features), job.whole.bounded.features
    return {names[k]: contour_statistics(error[of == k]).p99_um for k in np.unique(of) if k >= 0}


def _off_p99_um(job: _Job, executions: Sequence[Execution]) -> tuple[float, ...]:
    """Play the same commands on printers that are off; return the 99th percentile on each, µm."""
    if not job.plants:
        return ()
    on_each: list[list[Execution]] = [[] for _ in job.plants]
    for each in executions:
        t, nozzles = simulate_nozzles(job.plants, each.motion, each.print_slice.machine)
        for executions, nozzle in zip(on_each, nozzles, strict=True):
            executions.append(Execution(each.print_slice, each.motion, t, nozzle))
    return tuple(contour_statistics(contour(executions), weights(executions)).p99_um for executions in on_each)


def _piece(execution: Execution) -> Piece:
    t = execution.t[execution.counted]
    path = execution.reference(t)
    step = np.linalg.norm(np.diff(path, axis=0, prepend=path[:1]), axis=1)
    error = contour([execution])
    return Piece(
        begin_s=execution.print_slice.begin_t,
        seconds=float(t[-1] - t[0]),
        p99_um=contour_statistics(error).p99_um,
        distance_mm=np.cumsum(step),
        speed_mm_per_s=step / np.gradient(t) if len(t) > 1 else step,
        error_um=1e3 * error,
    )
