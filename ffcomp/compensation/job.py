"""Compensate one print: read it, split it into chunks, and stream the output of chunk after chunk."""

from __future__ import annotations

import pickle
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from itertools import chain, islice
from pathlib import Path
from tempfile import TemporaryDirectory

from ffcomp.compensation import chunks
from ffcomp.compensation.chunks import Chunk, Splitting, split_chunks
from ffcomp.compensation.gcode_writer import GcodeRenderer
from ffcomp.compensation.own_shaper import OwnShaper, own_shaper, shaper_set, with_shaper_off, with_shaper_set
from ffcomp.compensation.placement import NOWHERE, Footprint, Offset, Placement, advice, choose_offset, footprint_of
from ffcomp.compensation.plan import Context, plan_chunk
from ffcomp.compensation.prediction import LONGEST_S
from ffcomp.compensation.program import Output, compensated_sections
from ffcomp.compensation.request import CompensateOptions
from ffcomp.compensation.result import FileSize, Result
from ffcomp.compensation.solve import replanner_of
from ffcomp.compensation.statistics import Statistics
from ffcomp.compensation.step_output import StepRenderer
from ffcomp.compensation.text_stream import in_order, stamped, with_times_retold
from ffcomp.errors import NothingToDo, RequestError
from ffcomp.faster.bound import Bound, with_slicer_settings
from ffcomp.firmware.program import firmware_plan, read_as_planned
from ffcomp.firmware.table import FIRMWARES
from ffcomp.integrations.slicer import Bed, bed_in, pair
from ffcomp.inverse.feasible import scale_around_cut
from ffcomp.inverse.model import InverseModel, model_of
from ffcomp.inverse.robust import BOUNDED, RobustChoice, choose_robust
from ffcomp.inverse.settings import Settings, SlowingSettings, WriterSettings, settings_for
from ffcomp.inverse.time_scaling import TimeScaling
from ffcomp.planner.limits import lines_of
from ffcomp.planner.reach import OutOfReach, Reach
from ffcomp.planner.trajectory import PathPosition
from ffcomp.request import shared_with
from ffcomp.simulation.command import Tuned
from ffcomp.simulation.forecast import NO_FORECAST, Forecast, failure
from ffcomp.steps.motion import MotionSink, Sink
from ffcomp.steps.sink import Board, StepSink
from ffcomp.version import __version__
from gcode.container import Source, blocks_of, ends_of
from gcode.dialects import FlavorChoice, choose_flavor, sign_by_ends
from gcode.embedded import (
    WITHOUT_ORIGINAL,
    find_offset,
    joined,
    offset_line,
    original_blocks,
    shaper_line,
    stamp_line,
)
from gcode.metadata import Timed, filament_change_s
from gcode.program import Moves, Program
from gcode.text import whole_lines
from models.machine import Machine

ROW_ERROR_S = 12.5e-6  # of a step of compressed rows, early or late: half of what Klipper allows itself
Progress = Callable[[float], None]  # called with the share that is done, 0 to 1

AS_SLICED = RobustChoice(False, "None: the print is as sliced.")
MERGED_SHARE = 0.1  # of a bound, that joined segments may miss their path by


@dataclass(frozen=True)
class Job:
    """A request: a print, the machine it is for, and how it is compensated."""

    source: Source
    path: str  # as the user named it
    machine: Machine
    request: CompensateOptions = CompensateOptions()  # noqa: RUF009 (frozen)
    bed: Bed | None = None  # the slicer's, if it has said it otherwise than in the file
    restore: bool = False  # the file is a compensated one: take the original that it keeps
    jobs: int = 1  # processes that work at it
    inverse: Settings | None = None  # the settings of the inverse, where a comparison has chosen them

    def lines(self, progress: Progress = lambda share: None, folder: Path | None = None) -> Lines:
        """Return the compensated file, stamped in head and tail.

        progress : called with the share of the file that is done, 0 to 1
        folder : holds a temporary file; None: the system's folder
        """
        return Lines(self, progress, folder)

    def write_steps(self, target: Path | None, progress: Progress = lambda share: None) -> Result:
        """Write step timings into an archive (None: nowhere), which is replaced at the end or not at all."""
        started = time.perf_counter()
        reach = Reach(self.machine.kinematics)
        with ExitStack() as stack:
            target = target or Path(stack.enter_context(TemporaryDirectory()), "steps.npz")
            sink = self._sink(target)
            stack.callback(sink.close)
            lines = Lines(self, progress)
            for _ in lines.of(self.outputs(reach, sink), reach):
                pass  # steps are no text
            predicted = self.forecast(lines.statistics)
            totals = sink.finish()
        return replace(self.result(lines, time.perf_counter() - started, predicted), steps=totals, shaper=None)

    def result(self, lines: Lines, seconds: float, predicted: Forecast) -> Result:
        """Save the model's tables for the next print, and return the result after so many seconds of work."""
        self.model.save_cache()
        result = Result(
            self.path,
            self.machine,
            self._flavor_choice,
            self._placement,
            lines.statistics,
            seconds,
            lines.size,
            embedded=self.settings.writer.embed,
            robust=self._chosen[1],
            shaper=self.shaper,
            forecast=predicted,
        )
        expected = predicted.expected
        if expected is None or not expected.shaper_written:
            return result
        moves, planned_s = lines.statistics.moves, lines.statistics.original_print_time_s
        statistics = replace(self.at_first(), moves=moves, original_print_time_s=planned_s, print_time_s=planned_s)
        shaper = shaper_set(self.shaper, expected.tuned)
        return replace(result, statistics=statistics, embedded=True, robust=AS_SLICED, shaper=shaper)

    def forecast(self, statistics: Statistics) -> Forecast:
        """Evaluate the sections that were sampled for the prediction; an error never stops the print."""
        samples = statistics.predicted
        try:
            return NO_FORECAST if samples is None else samples.forecast(self.machine, self.flavor)
        except Exception as error:
            return Forecast(failed=failure(error))

    @property
    def may_shape(self) -> bool:
        """Whether the print may go out as sliced, through the firmware's own shaper, where that leaves less."""
        asked = self.request.robust != "auto" or self.bound is not None or self.inverse is not None
        has_one = self.shaper.state == "off" and self.shaper.on and FIRMWARES[self.flavor].shapers(self.machine)
        return bool(has_one) and not asked and not any(self.offset)

    def through_shaper(self, tuned: Tuned) -> Iterator[bytes]:
        """Return the print as sliced, through the firmware's own shaper."""
        blocks = blocks_of(self.source)
        return with_shaper_set(whole_lines(original_blocks(blocks) if self.restore else blocks), self.shaper, tuned)

    def _sink(self, target: Path) -> Sink:
        kind = self.request.kind
        if kind == "host":  # whose own settings make the steps
            machine = {"name": self.machine.name, "sha256": self.machine.sha256}
            about = {"ffcomp": __version__, "machine": machine, "source": Path(self.path).name}
            return MotionSink(target, {**about, "compensated": True})
        per_mm = self.request.extruder_steps_per_mm or self.machine.steps.extruder_steps_per_mm
        if per_mm is None:
            raise RequestError(
                f"--kind {kind} needs the extruder's microsteps per mm of filament: --extruder-steps-per-mm N, "
                "or extruder_steps_per_mm in [steps] of the machine file."
            )
        return StepSink(self.machine, Board(per_mm), target, ROW_ERROR_S if kind == "klipper-steps" else None)

    @cached_property
    def bound(self) -> Bound | None:
        """The bound on the error of a quicker print; None: it keeps the slicer's speed."""
        errors_um = self.request.errors_um
        if not errors_um:
            return None
        bounds = {"max_error_um": errors_um.pop(""), "of_features_um": tuple(errors_um.items())}
        return Bound(**shared_with(self.request, Bound, **bounds))

    @property
    def settings(self) -> Settings:
        """The settings of the inverse, by the request and the machine."""
        return self._chosen[0]

    @cached_property
    def _chosen(self) -> tuple[Settings, RobustChoice]:
        """The settings, and why the inverse is robust or not: always under a bound, to be quicker."""
        request, settings, bound = self.request, self.inverse, self.bound
        robust = {"on": True, "off": False}.get(request.robust) if settings is None else settings.robust
        if settings is None:
            settings = replace(
                _settings_for(pickle.dumps((self.machine, request.max_segments_per_second))),
                slowing=SlowingSettings(tolerance_um=request.tolerance_um, strict=request.strict),
                writer=WriterSettings(embed=request.embed),
            )
        if bound is not None:
            joined_um, writer = MERGED_SHARE * min(bound.all_um), settings.writer
            merge_um, along_um = min(writer.merge_um, joined_um), min(writer.merge_along_um, 3.0 * joined_um)
            writer = replace(writer, merge_um=merge_um, merge_along_um=along_um)
            return replace(settings, robust=True, writer=writer), BOUNDED
        choice = choose_robust(self.machine, settings, robust)
        return replace(settings, robust=choice.robust), choice

    @cached_property
    def model(self) -> InverseModel:
        """The machine's inverse, of the thread that asks first."""
        return model_of(self.machine, self.settings)

    @cached_property
    def _ends(self) -> tuple[bytes, bytes, int]:
        return ends_of(self.source)

    @property
    def size(self) -> int:
        """Bytes of the print."""
        return self._ends[2]

    @property
    def flavor(self) -> str:
        """The requested firmware, or that of the file."""
        return self._flavor_choice.flavor

    @cached_property
    def _flavor_choice(self) -> FlavorChoice:
        choice = choose_flavor(self.request.flavor, self.machine.flavor, sign_by_ends(*self._ends[:2]), self.path)
        firmware = FIRMWARES[choice.flavor]
        assumed = firmware.assumed(self.machine)
        sought = "" if self.bound is None else firmware.quicker_note
        return replace(choice, reason=" ".join(each for each in (choice.reason, assumed, sought) if each))

    @property
    def offset(self) -> Offset:
        """The offset that is added to every position, mm."""
        return self._placement.offset

    @cached_property
    def _placement(self) -> Placement:
        if self.request.offset_mm is not None:
            return Placement(self.request.offset_mm, f"Offset {pair(self.request.offset_mm)}, as requested.")
        if self.restore:
            offset = find_offset(self._ends[0])
            return Placement(offset, f"Offset {pair(offset)}, as the file was compensated before.")
        return choose_offset(self.machine.kinematics, self._bed, self._footprint)

    @property
    def shaper(self) -> OwnShaper:
        """Whether the firmware's own shaper is switched off."""
        return own_shaper(self.request.keep_shaper, self.machine, self.flavor)

    @property
    def _bed(self) -> Bed | None:
        return self.bed or bed_in(*self._ends[:2])

    def _footprint(self) -> Footprint | None:
        return footprint_of(self._programs(NOWHERE))

    def outputs(self, reach: Reach, steps: Sink | None = None) -> Iterator[Iterable[Output]]:
        """Return the output of each chunk, part by part."""
        split, context = self._split(reach)
        if steps is not None or self.jobs == 1:
            return (_rendered(chunk, context, steps) for chunk in split)
        from joblib import Parallel, delayed

        pool = Parallel(n_jobs=self.jobs, return_as="generator", batch_size=1, pre_dispatch="2 * n_jobs")
        return ((output,) for output in pool(delayed(_work)(chunk, context) for chunk in split))

    def _split(self, reach: Reach) -> tuple[Iterator[Chunk], Context]:
        """Split the print into chunks."""
        parts = self._parts(reach)
        first = list(islice(parts, 1))
        if not first:
            raise NothingToDo(f"{self.path or 'The file'} holds no line: nothing to compensate.")
        while not len(first[-1].moves) and (more := next(parts, None)) is not None:
            first.append(more)
        share = 0.0  # of the print that is simulated while it is compensated; above 1: all of it
        if self.request.predict:
            moves, size = first[-1].moves, max(first[-1].size, 1)
            quickest_s = float((lines_of(moves).length / moves.speed).sum()) * self.size / size
            share = LONGEST_S / max(quickest_s, 1e-9)
        bound = None if self.bound is None else with_slicer_settings(self.bound, *self._ends[:2])
        context = Context(self.model, self.flavor, self.offset, share, bound)
        s, plan_of = self.settings, partial(firmware_plan, machine=self.machine)

        def eased(around: Program, cut: PathPosition, layers: int) -> tuple[Moves, tuple[TimeScaling, ...]]:
            return scale_around_cut(self.model, around, cut, replanner_of(around, self.machine, layers))

        ease = eased if s.slowing.slow else None
        splitting = Splitting(s.segment_s, s.lead_s, plan_of, chunks.LONGEST_S, ease)
        return split_chunks(chain(first, parts), splitting), context

    def _parts(self, reach: Reach) -> Iterator[Program]:
        """Read the print; moves outside the print volume pass through unchanged, unless they print the part."""
        try:
            yield from reach.whole(self._programs(self.offset))
        except OutOfReach as error:
            hint = advice(self.machine.kinematics, self._bed, self._footprint(), self.offset)
            raise OutOfReach(f"{error.rule} {hint}".strip(), error.line, error.path) from error

    def _programs(self, offset: Offset) -> Iterator[Program]:
        blocks = blocks_of(self.source)
        if self.restore:
            blocks = original_blocks(blocks)
        change_s = filament_change_s(*self._ends[:2])
        return read_as_planned(
            blocks, self.path, self.machine, self.flavor, offset_mm=offset, filament_change_s=change_s
        )

    def at_first(self) -> Statistics:
        """Return the warnings about the file as a whole."""
        names = ", ".join(self.model.not_modelled)
        sentence = f"The machine file lists effects that are not compensated: {names}." if names else ""
        moved = self._placement.reason if self._placement.notable else ""
        return Statistics(warnings=tuple(filter(None, (moved, self._flavor_choice.warning, sentence))))


@lru_cache
def _settings_for(pickled: bytes) -> Settings:
    """Return `settings_for`, which takes 0.1 s, of a machine and its segment rate; once for many files."""
    return settings_for(*pickle.loads(pickled))


class Lines:
    """A compensated file, in pieces of whole lines."""

    value: Result  # once all of them have been read

    def __init__(self, job: Job, progress: Progress, folder: Path | None = None) -> None:
        self._job, self._progress, self._folder = job, progress, folder
        self.statistics, self.size = Statistics(), FileSize()  # so far

    def __iter__(self) -> Iterator[bytes]:
        job, started, embed = self._job, time.perf_counter(), self._job.settings.writer.embed

        def planned_s() -> tuple[float, float]:
            return self.statistics.print_time_s, self.statistics.original_print_time_s

        reach = Reach(job.machine.kinematics)
        pieces = with_times_retold(self.of(job.outputs(reach), reach), planned_s, embed=embed)
        if job.shaper.state != "kept":
            pieces = with_shaper_off(pieces, job.shaper)
        text = in_order(pieces, self._folder)
        text = chain([next(text, b"")], text)  # all of it is made
        predicted = job.forecast(self.statistics)
        expected = predicted.expected
        notes = offset_line(job.offset) + (b"" if embed else WITHOUT_ORIGINAL + b"\n")
        if job.may_shape and expected is not None and expected.shaper_is_better:
            predicted, notes = predicted.as_sliced(job.machine), shaper_line(*expected.tuned)
            text = job.through_shaper(expected.tuned)
        written, stamp = 0, stamp_line(__version__, job.machine.name, job.machine.sha256, job.flavor)
        for piece in stamped(filter(None, text), stamp, notes, predicted.line()):
            written += len(piece)
            yield piece
        self.size = replace(self.size, written=written)
        self.value = job.result(self, time.perf_counter() - started, predicted)

    def of(self, outputs: Iterable[Iterable[Output]], reach: Reach) -> Iterator[bytes]:
        """Yield the text of chunks, part by part, and add up their statistics."""
        job, done = self._job, 0.0
        self.statistics = job.at_first()
        for chunk in outputs:
            of_chunk, begun_s, begun = Statistics(), self.statistics.print_time_s, done
            for output in chunk:
                yield from (
                    Timed.at(line, begun_s + line.at_s) if isinstance(line, Timed) else line for line in output.text
                )
                of_chunk += output.statistics
                done = begun + output.done
                self._progress(min(done / max(job.size, 1), 1.0))
            self.statistics += of_chunk
        faster, said = self.statistics.faster, reach.warnings
        if job.bound is not None and faster is not None:
            said = (*said, *job.bound.unknown_features(faster.original_s))
        self.statistics, self.size = self.statistics + Statistics(warnings=said), FileSize(int(done))


def _rendered(chunk: Chunk, context: Context, steps: Sink | None = None) -> Iterator[Output]:
    planned = plan_chunk(chunk, context)
    renderer = GcodeRenderer(planned, context) if steps is None else StepRenderer(steps, planned, context)
    yield from compensated_sections(planned, context, renderer)


def _work(chunk: Chunk, context: Context) -> Output:
    """Compensate a chunk in another process."""
    outputs = list(_rendered(chunk, context))
    context.model.save_cache()
    text = list(joined(chain.from_iterable(output.text for output in outputs)))
    return Output(text, sum((output.statistics for output in outputs), Statistics()), chunk.program.size)
