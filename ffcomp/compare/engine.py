"""The whole comparison, on one page: a print, a machine file that is believed, a printer that is true.

print       compare.stretch     which part of the print is looked at
ways        compare.ways        every method, tuned as well as it can be
played      compare.play        each command through the virtual printer
judged      compare.judge       against the wanted path
spread      compare.plants      again, on printers drawn around the true one
quality     compare.quality     how fast each method may go for the same quality
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Collection, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TypeVar

import numpy as np

from ffcomp.compare import methods as every
from ffcomp.compare.baselines import LinearPrinter
from ffcomp.compare.equal_quality import equal_quality, within_limits
from ffcomp.compare.evaluation import SAMPLE_S, SETTLE_S, Judgement, Played, by, contour, judge, track
from ffcomp.compare.methods import OURS, Way
from ffcomp.compare.monte_carlo import drawn, dynamic_numbers
from ffcomp.compare.result import BedMap, Comparison, Layer, Method, Party, Peaks, Spread
from ffcomp.compare.sampling import Print, Sampling, Stretch
from ffcomp.compensate.program import Summary
from ffcomp.errors import NothingToDo
from ffcomp.inverse.settings import Settings, settings_for
from ffcomp.metrics import rms
from ffcomp.simulate.compatibility import check_same_kinematics
from ffcomp.simulate.playback import JOBS, ROW_S, simulate_nozzles
from ffcomp.version import __version__
from models.arrays import FloatArray
from models.machine import Machine

SHORTEST_S = 3 * SETTLE_S
SOME_S = 60.0  # of print time that is printed on every drawn plant
FEW_S, FEW_PIECE_S = 30.0, 5.0  # on which shapers are tuned and accelerations tried
BED_PITCH_MM = 10.0

T = TypeVar("T")
Progress = Callable[[str, float], None]  # what is being done, and how much of it (0 to 1)


@dataclass(frozen=True, slots=True)
class Request:
    """What is to be compared."""

    sampling: Sampling = field(default_factory=Sampling)
    mismatch: float = 0.0  # relative standard deviation of the drawn plants' numbers
    seeds: int = 0  # how many plants are drawn
    quality_bound_um: float = 25.0  # 0: equal quality is not asked for
    only: tuple[str, ...] = ()  # of `ways.NAMES`; the uncompensated print and ours are judged in any case


def compare(
    data: bytes,
    path: str,
    machine: Machine,
    plant: Machine | None = None,
    request: Request | None = None,
    *,
    settings: Settings | None = None,
    offset: tuple[float, float] = (0.0, 0.0),
    flavor: str = "",
    progress: Progress = lambda what, done: None,
) -> Comparison:
    """Judge every method on one print.

    Parameters
    ----------
    data, path : the G-code file
    machine : what the methods believe
    plant : the printer that is true; None: the machine itself
    """
    started = time.perf_counter()
    request, plant, settings = request or Request(), plant or machine, settings or settings_for(machine)
    check_same_kinematics(machine, plant)
    printed = Print(data, path, machine, offset, flavor)
    stretches, sampled = printed.stretches(request.sampling)
    if max(each.trajectory.end_t for each in stretches) < SHORTEST_S:
        raise NothingToDo(f"{path}: what is to be judged lasts less than {SHORTEST_S:g} s: nothing to compare.")
    some, _ = printed.stretches(request.sampling, at_most_s=SOME_S)
    few, _ = printed.stretches(request.sampling, FEW_PIECE_S, FEW_S)
    if max(each.trajectory.end_t for each in few) < SHORTEST_S:
        few = stretches  # in small pieces of a short print nothing is left but their beginnings
    ways = _ways(machine, plant, few, settings, names(request), progress)
    answers = _answers(ways, stretches, plant, progress)
    judged = {way.name: _method(way, answers[way.name], printed.labels.features) for way in ways}
    best = min((m for m in judged.values() if m.family == "best fixed"), key=lambda m: m.track.contour_rms_um).name
    if request.seeds:
        plants = drawn(plant, request.mismatch, request.seeds)
        judged = _with_spread(judged, ways, best, some, few, plants, progress)
    if request.quality_bound_um:
        judged = _with_quality(judged, ways, printed, plant, few, request.quality_bound_um, progress)
    return Comparison(
        print_name=path,
        print_sha256=hashlib.sha256(data).hexdigest(),
        print_time_s=printed.print_time_s,
        layers_total=printed.labels.layers,
        sampling=sampled,
        machine=_party(machine),
        plant=_party(plant),
        mismatch=_mismatch(plant, request),
        settings=_settings(settings),
        version=__version__,
        layers=_layers(printed, judged[OURS]),
        features=printed.labels.features,
        methods=judged,
        best_fixed=best,
        ours=OURS,
        sample_s=SAMPLE_S,
        bed=_bed(plant),
        limits={
            "carriage_velocity_mm_per_s": machine.limits.carriage_velocity_mm_per_s,
            "carriage_acceleration_mm_per_s2": machine.limits.carriage_acceleration_mm_per_s2,
        },
        quality_bound_um=request.quality_bound_um,
        seconds=time.perf_counter() - started,
    )


def names(request: Request) -> Collection[str]:
    """Raises ValueError for a name that no method has, or if there is no best fixed shaper to compare with."""
    unknown = [name for name in request.only if name not in every.NAMES]
    if unknown:
        raise ValueError(f"No method is named {unknown[0]!r}; there are {', '.join(every.NAMES)}.")
    if request.only and not set(request.only) & set(every.KINDS):
        raise ValueError(f"Name at least one shaper to compare with: {', '.join(every.KINDS)}.")
    return {"none", OURS, *request.only} if request.only else every.NAMES


# ---- the methods ---------------------------------------------------------------------------------


def _ways(
    machine: Machine,
    plant: Machine,
    few: Sequence[Stretch],
    settings: Settings,
    names: Collection[str],
    progress: Progress,
) -> list[Way]:
    """The methods asked for, tuned; the searches share the processors."""
    linear, of_place = LinearPrinter(plant, few), every.mode_frequencies(plant)

    def way(name: str) -> Way:
        kind = name.removesuffix(every.CALIBRATED).removesuffix(every.SCHEDULED)
        if name == "none":
            return every.none()
        if name in (every.ONE_MODEL, every.ROBUST, OURS):
            return every.inversion(machine, settings, name)
        if name.endswith(every.CALIBRATED):
            return every.calibrated(plant, kind)
        if name.endswith(every.SCHEDULED):
            return every.scheduled(linear, of_place, kind)
        return every.best_fixed(linear, kind)

    return _all([partial(way, name) for name in every.NAMES if name in names], "tuning every method", progress)


@dataclass(frozen=True, eq=False)
class _Answer:
    played: list[Played]
    peaks: Peaks
    print_time_s: float
    warnings: tuple[str, ...]


def _answers(
    ways: Sequence[Way], stretches: Sequence[Stretch], plant: Machine, progress: Progress
) -> dict[str, _Answer]:
    tasks = [partial(_answer, way, stretches, plant) for way in ways]
    return dict(zip([way.name for way in ways], _all(tasks, "printing", progress), strict=True))


def _answer(way: Way, stretches: Sequence[Stretch], plant: Machine) -> _Answer:
    played, asked, summaries = [], [], []
    for stretch in stretches:
        motion, summary = way.motion(stretch)
        t, (nozzle,) = simulate_nozzles([plant], motion, stretch.machine)
        played.append(Played(stretch, motion, t, nozzle))
        asked.append(motion.peaks(stretch.machine))
        summaries.append(summary)
    velocity, acceleration = (float(most) for most in np.max(asked, axis=0))
    within = within_limits(velocity, acceleration, stretches[0].machine)
    longer = sum(s.print_time_s - s.original_print_time_s for s in summaries if s is not None)
    seconds = sum(each.trajectory.end_t for each in stretches) + longer
    return _Answer(played, Peaks(velocity, acceleration, within), seconds, _warnings(summaries))


def _warnings(summaries: Sequence[Summary | None]) -> tuple[str, ...]:
    return tuple(sentence for summary in summaries if summary is not None for sentence in summary.warnings)


def _method(way: Way, answer: _Answer, features: Sequence[str]) -> Method:
    judged: Judgement = judge(answer.played)
    s, peak = judged.samples, answer.peaks.acceleration_mm_per_s2
    everywhere = np.ones(len(s.due), dtype=np.bool_)
    return Method(
        name=way.name,
        label=way.label,
        family=way.family,
        tuning=way.tuning,
        track=track(judged, everywhere, answer.print_time_s, peak),
        extruding=track(judged, s.extruding, answer.print_time_s, peak),
        by_layer=by(s.layer, s.contour),
        by_feature={features[k]: error for k, error in by(s.feature, s.contour).items()},
        residual_rms_um=judged.residual_rms_um,
        peaks=answer.peaks,
        samples=s,
        warnings=answer.warnings,
    )


# ---- other plants, other speeds ------------------------------------------------------------------


def _with_spread(
    methods: dict[str, Method],
    ways: Sequence[Way],
    best: str,
    stretches: Sequence[Stretch],
    few: Sequence[Stretch],
    plants: Sequence[Machine],
    progress: Progress,
) -> dict[str, Method]:
    """Every method again, as it was tuned, on the drawn plants; the best fixed shaper tuned anew on each as well."""
    found = dict(methods)
    for k, way in enumerate(ways):
        progress("printing on drawn plants", k / len(ways))
        found[way.name] = replace(methods[way.name], spread=Spread(tuple(_rms_on(plants, way, stretches))))
    tasks = [partial(_retuned, best, each, few, stretches) for each in plants]
    retuned = tuple(_all(tasks, "tuning shapers on drawn plants", progress))
    found[best] = replace(found[best], retuned=Spread(retuned))
    return found


def _rms_on(plants: Sequence[Machine], way: Way, stretches: Sequence[Stretch]) -> list[float]:
    """Contour rms of one method on every plant, µm."""
    errors: list[list[FloatArray]] = [[] for _ in plants]
    for stretch in stretches:
        motion, _ = way.motion(stretch)
        t, found = simulate_nozzles(plants, motion, stretch.machine)
        for each, nozzle in zip(errors, found, strict=True):
            each.append(contour([Played(stretch, motion, t, nozzle)]))
    return [rms(np.concatenate(each)) * 1e3 for each in errors]


def _retuned(kind: str, plant: Machine, few: Sequence[Stretch], stretches: Sequence[Stretch]) -> float:
    return _rms_on([plant], every.best_fixed(LinearPrinter(plant, few), kind), stretches)[0]


def _with_quality(
    methods: dict[str, Method],
    ways: Sequence[Way],
    printed: Print,
    plant: Machine,
    few: Sequence[Stretch],
    bound_um: float,
    progress: Progress,
) -> dict[str, Method]:
    tasks = [partial(equal_quality, way, printed, plant, few, bound_um) for way in ways]
    found = _all(tasks, "seeking equal quality", progress)
    return {
        way.name: replace(methods[way.name], equal_quality=quality) for way, quality in zip(ways, found, strict=True)
    }


def _all(tasks: Sequence[Callable[[], T]], what: str, progress: Progress) -> list[T]:
    """Do the tasks side by side; an interruption waits only for those under way."""
    progress(what, 0.0)
    pool = ThreadPoolExecutor(JOBS)
    try:
        futures = [pool.submit(task) for task in tasks]
        found = []
        for k, future in enumerate(futures):
            found.append(future.result())
            progress(what, (k + 1) / len(tasks))
        return found
    finally:
        pool.shutdown(cancel_futures=True)


# ---- what is said about it -----------------------------------------------------------------------


def _party(machine: Machine) -> Party:
    return Party(machine.name, machine.sha256, tuple(machine.effects))


def _mismatch(plant: Machine, request: Request) -> str:
    if not request.seeds:
        return ""
    return (
        f"{request.seeds} plants whose {len(dynamic_numbers(plant))} dynamic numbers (masses, stiffnesses, dampings, "
        f"drive) are each off by a normal draw with a standard deviation of {request.mismatch:.0%} (seeds 0 to "
        f"{request.seeds - 1}); every method keeps its tuning; {SOME_S:.0f} s of the print on each."
    )


def _settings(settings: Settings) -> dict[str, str]:
    return {
        "segments per second, at most": f"{1 / settings.segment_s:.0f}",
        "bandwidth of the inversion": f"{settings.bandwidth_hz:.0f} Hz",
        "virtual printer": f"Runge-Kutta, {1 / ROW_S:.0f} steps a second or more, with gravity; sag taken out",
        "judged": f"{1 / SAMPLE_S:.0f} times a second, but for the first {SETTLE_S:g} s of each stretch",
        "shapers tuned on": f"{FEW_S:.0f} s of the print, contour rms, plant known",
    }


def _layers(printed: Print, method: Method) -> tuple[Layer, ...]:
    s, moves = method.samples, printed.program.moves
    begins, ends = (
        printed.planned.trajectory.start_t,
        printed.planned.trajectory.start_t + printed.planned.trajectory.duration,
    )
    found = []
    for number in sorted(method.by_layer):
        own = np.flatnonzero(printed.labels.layer == number)
        z = float(np.median(s.wanted[s.layer == number, 2])) if len(moves) else 0.0
        found.append(Layer(number, z, float(begins[own[0]]), float(ends[own[-1]])))
    return tuple(found)


def _bed(plant: Machine) -> BedMap:
    rim = plant.kinematics.rings(1, 72)
    x, y = (np.linspace(low, high, 2 * int(np.ceil((high - low) / 2 / BED_PITCH_MM)) + 1) for low, high in _spans(rim))
    places = np.stack(np.meshgrid(x, y), axis=-1)
    frequency = every.mode_frequencies(plant)(places.reshape(-1, 2)).reshape(places.shape)
    inside = plant.kinematics.contains(places.reshape(-1, 2), 1e-3 * plant.kinematics.bed_radius_mm)
    frequency[~inside.reshape(frequency.shape)] = np.nan
    return BedMap(x, y, frequency)


def _spans(places: FloatArray) -> list[tuple[float, float]]:
    """From the lowest to the highest, of each column."""
    return [(float(column.min()), float(column.max())) for column in places.T]
