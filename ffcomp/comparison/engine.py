"""The whole comparison, on one page: a print, the machine file that every method uses, and the plant that evaluates.

slices      compare.sampling      the parts of the print that are evaluated
methods     compare.methods       every method, tuned as well as it can be
executed    simulate.playback     each command on the simulated printer
evaluated   compare.evaluation    against the reference path
quality     compare.equal_quality how fast each method may go for the same quality
"""

from __future__ import annotations

import time
from collections.abc import Collection, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from ffcomp.comparison import methods as every
from ffcomp.comparison.equal_quality import QUALITY, equal_qualities
from ffcomp.comparison.evaluation import SAMPLE_S, Execution, Progress, Stages, evaluate, execute, in_parallel
from ffcomp.comparison.methods import COMPENSATED, SHAPER_NAMES, CommandedSlices, LinearPrinter, TunedMethod
from ffcomp.comparison.result import Comparison, Method
from ffcomp.comparison.sampling import SETTLE_S, SHORTEST_S, WHOLE_PRINT, Print, PrintSlice, Sampling
from ffcomp.compensation.file import compensate_file
from ffcomp.compensation.request import CompensateOptions
from ffcomp.errors import NothingToDo, RequestError
from ffcomp.firmware.table import FIRMWARES
from ffcomp.inverse.robust import choose_robust
from ffcomp.inverse.settings import Settings, SlowingSettings, settings_for
from ffcomp.simulation.expectation import EXCERPT_S, Expectation, expectation, pieces_of
from ffcomp.simulation.expectation import Piece as ExpectedPiece
from ffcomp.simulation.forecast import NO_FORECAST, Forecast
from ffcomp.simulation.playback import ROW_S
from ffcomp.version import __version__
from models.machine import Machine

TUNING_S, TUNING_PIECE_S = 30.0, 5.0  # on which shapers are tuned and accelerations tried
WHOLE_S = 120.0  # of print time, at most, of a print that is predicted as `compensate` does
ALL = "all"  # alone: every method that there is
TUNING, PLANNING, PRINTING = "tuning every method", "planning with every method", "printing with every method"


def compare(
    printed: Print,
    plant: Machine | None = None,
    *,
    sampling: Sampling = WHOLE_PRINT,
    quality_um: float = 25.0,
    only: Sequence[str] = (),
    predict: bool = True,
    settings: Settings | None = None,
    progress: Progress = lambda what, done: None,
) -> Comparison:
    """Evaluate every method on one print; NothingToDo if the chosen part is too short.

    printed : the print, on the machine whose file the methods use
    plant : the printer that evaluates, with the same kinematics; None: the machine itself
    quality_um : bound of the contour error's p99, where the methods' speeds are compared; 0: they are not
    only : of `methods.NAMES`; none and the compensated print are always evaluated
    predict : the whole print by the design model, if it is short
    settings : of the inverse
    progress : called with the current step and the share of it that is done
    """
    started, machine = time.perf_counter(), printed.machine
    plant, settings = plant or machine, settings or settings_for(machine)
    slices, sampled = printed.slices(sampling)
    if max(each.trajectory.end_t for each in slices) < SHORTEST_S:
        raise NothingToDo(
            f"{printed.path}: the part to be evaluated lasts less than {SHORTEST_S:g} s: nothing to compare."
        )
    tuning_slices, _ = printed.slices(sampling, TUNING_PIECE_S, TUNING_S)
    if max(each.trajectory.end_t for each in tuning_slices) < SHORTEST_S:
        tuning_slices = slices  # in small pieces of a short print nothing is left but their beginnings
    choice = choose_robust(machine, settings)
    written_method = every.ROBUST if choice.robust else COMPENSATED
    chosen = {*names(only), written_method}
    shares = {TUNING: 0.9, PLANNING: 0.25, PRINTING: 0.72} | ({QUALITY: 0.76} if quality_um else {})
    progress = Stages(progress, shares)
    tune = partial(every.tuned, machine=machine, linear=LinearPrinter(plant, tuning_slices), settings=settings)
    tuned = in_parallel([partial(tune, name) for name in every.NAMES if name in chosen], TUNING, progress)
    labels = {COMPENSATED: every.PLAIN_LABEL, written_method: "ffcomp"}
    tuned = [replace(each, label=labels.get(each.name, each.label)) for each in tuned]
    predicted = _predicted(printed, replace(settings, robust=choice.robust)) if predict else NO_FORECAST
    evaluated = _evaluated(tuned, slices, plant, printed.labels.features, progress)
    if quality_um:
        p99 = {name: method.track.contour_p99_um for name, method in evaluated.items()}
        keep_time = replace(settings, slowing=SlowingSettings(slow=False))  # what a limit would slow is too fast
        at_its_time = [every.inversion(machine, keep_time, m.name) if m.family == "inversion" else m for m in tuned]
        quality = equal_qualities(at_its_time, printed, plant, tuning_slices, quality_um, p99, progress)
        evaluated = {name: replace(method, equal_quality=quality[name]) for name, method in evaluated.items()}
    return Comparison(
        print_name=printed.path,
        print_sha256=printed.sha256,
        print_time_s=printed.print_time_s,
        sampling=sampled,
        machine=machine,
        plant=plant,
        settings=_settings(settings, printed.flavor),
        version=__version__,
        features=printed.labels.features,
        methods=evaluated,
        compensated=written_method,
        quality_bound_um=quality_um,
        seconds=time.perf_counter() - started,
        acceleration_mm_per_s2=printed.acceleration_mm_per_s2,
        predicted=predicted.tracks,
        robust=choice,
        expected=predicted.expected or _expected(next(m for m in tuned if m.name == written_method), slices),
    )


def names(only: Sequence[str]) -> Collection[str]:
    """Return the names of the methods to compare.

    Raises RequestError for a name that no method has, or if there is no best fixed shaper to compare with.
    """
    if tuple(only) == (ALL,):
        return every.NAMES
    if unknown := [name for name in only if name not in every.NAMES]:
        raise RequestError(f"--only: no method is named {unknown[0]!r}; there are {', '.join(every.NAMES)}.")
    if only and not set(only) & {*SHAPER_NAMES}:
        raise RequestError(f"--only: name at least one shaper to compare with: {', '.join(SHAPER_NAMES)}.")
    return {"none", COMPENSATED, *only} if only else every.USUAL_NAMES


# ---- the methods ---------------------------------------------------------------------------------


def _evaluated(
    tuned: Sequence[TunedMethod],
    slices: Sequence[PrintSlice],
    plant: Machine,
    features: Sequence[str],
    progress: Progress,
) -> dict[str, Method]:
    """Command, execute and evaluate every method."""
    commanded = in_parallel([partial(method.commands, slices) for method in tuned], PLANNING, progress)
    executions = execute(plant, [piece for each in commanded for piece in each.pieces], PRINTING, progress)
    evaluated, count = {}, len(slices)
    for k, (method, each) in enumerate(zip(tuned, commanded, strict=True)):
        evaluated[method.name] = _method(method, each, executions[k * count : (k + 1) * count], features)
    return evaluated


def _method(
    method: TunedMethod, commanded: CommandedSlices, executions: Sequence[Execution], features: Sequence[str]
) -> Method:
    s, times_and_peak = evaluate(executions), (commanded.print_time_s, commanded.peaks.acceleration_mm_per_s2)
    return Method(
        name=method.name,
        label=method.label,
        family=method.family,
        tuning=method.tuning,
        track=s.track(np.ones(len(s.due), dtype=np.bool_), *times_and_peak),
        extruding=s.track(s.extruding, *times_and_peak),
        by_layer=s.by(s.layer),
        by_feature={features[k]: error for k, error in s.by(s.feature).items()},
        peaks=commanded.peaks,
        samples=s,
        warnings=commanded.warnings,
    )


def _expected(method: TunedMethod, slices: Sequence[PrintSlice]) -> Expectation | None:
    """Return what to expect of a method on printers that the machine file's `[uncertainty]` allows."""
    pieces = list[ExpectedPiece]()
    for each in slices:
        if sum(piece.seconds for piece in pieces) < EXCERPT_S:
            pieces += pieces_of(each.motion, method.motion(each)[0], each.corners)
    return expectation(slices[0].machine, pieces, slices[0].flavor)


# ---- result ----------------------------------------------------------------------------------


def _settings(settings: Settings, flavor: str) -> dict[str, str]:
    used = {
        "segments per second, at most": f"{1 / settings.segment_s:.0f}",
        "bandwidth of the inversion": f"{settings.bandwidth_hz:.0f} Hz",
        "virtual printer": f"Runge-Kutta, {1 / ROW_S:.0f} steps a second or more, with gravity; static deflection "
        "taken out",
        "judged": f"{1 / SAMPLE_S:.0f} times a second, but for the first {SETTLE_S:g} s of each slice",
        "shapers tuned on": f"{TUNING_S:.0f} s of the print, contour rms, plant known",
    }
    return used | dict(FIRMWARES[flavor].in_comparisons)


def _predicted(printed: Print, settings: Settings) -> Forecast:
    """Predict the whole print as `compensate` does; nothing of a long one."""
    if printed.print_time_s > WHOLE_S:
        return NO_FORECAST
    how = CompensateOptions(force=True, offset_mm=printed.offset, flavor=printed.flavor)
    return compensate_file(printed.data, printed.path, printed.machine, how, None, inverse=settings).result.forecast
