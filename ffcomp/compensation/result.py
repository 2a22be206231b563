"""Hold the results of a compensation: of one print, of one file among many, or why there is none."""

from __future__ import annotations

import shlex
import time
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar

from ffcomp.compensation.faster import P99_LEVEL, Faster
from ffcomp.compensation.net import unsafe_sentences
from ffcomp.compensation.own_shaper import OwnShaper
from ffcomp.compensation.placement import Placement
from ffcomp.compensation.statistics import ENOUGH, Statistics, cause_of, grouped, shortened, slowed_lines
from ffcomp.errors import INPUT_ERRORS, FfcompError, explain, interrupts_restored
from ffcomp.faster.bound import limits_in_words
from ffcomp.firmware.table import FIRMWARES
from ffcomp.inverse.robust import PLAIN, RobustChoice
from ffcomp.metrics import Track
from ffcomp.numerics.digits import um
from ffcomp.numerics.serialise import keys
from ffcomp.result import Fact, clock
from ffcomp.result import Result as VerbResult
from ffcomp.simulation.forecast import NO_FORECAST, WAYS, Forecast
from ffcomp.steps.sink import MotorTotal
from gcode.dialects import FlavorChoice
from gcode.embedded import Stamp
from models.file import machine_paths
from models.machine import Machine, assumed_modes
from models.schema.documents import DEFAULT_UNCERTAINTY

DIED = "A process that worked at it has died, perhaps for want of memory."


@dataclass(frozen=True, slots=True)
class QuickerPrint:
    """The print under a bound on the error."""

    json_keys: ClassVar = {
        **{name: f"statistics.{name}" for name in ("print_time_s", "original_print_time_s")},
        **{name: f"statistics.faster.{name}" for name in ("actuator_limit_s", "limited_by", "by_feature")},
        **{name: f"left.{name}" for name in ("contour_p99_um", "contour_max_um")},
    }

    statistics: Statistics
    left: Track | None  # None: without a prediction


@dataclass(frozen=True, slots=True)
class FileSize:
    """Bytes of G-code, not packed."""

    original: int = 0
    written: int = 0  # 0: step timings

    def __add__(self, other: FileSize) -> FileSize:
        return FileSize(self.original + other.original, self.written + other.written)

    def __str__(self) -> str:
        times, megabytes = self.written / max(self.original, 1), (self.original / 1e6, self.written / 1e6)
        return f"{times:.1f} times as large as the original ({megabytes[0]:.2g} → {megabytes[1]:.2g} MB)"


@dataclass(frozen=True)
class Result:
    """What the compensation of a print has given."""

    path: str
    machine: Machine
    flavor: FlavorChoice
    placement: Placement
    statistics: Statistics
    compute_time_s: float
    size: FileSize = FileSize()
    steps: Mapping[str, MotorTotal] | None = None  # by the motor's letter; None: G-code was written
    embedded: bool = True  # whether the G-code holds its original
    robust: RobustChoice = PLAIN
    shaper: OwnShaper | None = None  # None: step timings, which cannot switch it
    forecast: Forecast = NO_FORECAST  # made before any file is replaced

    @property
    def warnings(self) -> list[str]:
        """All warnings, in sentences."""
        return list(self._warnings())

    def _warnings(self) -> Iterator[str]:
        numbers = self.statistics
        yield from unsafe_sentences(numbers.unsafe)
        if self.predicted and numbers.faster is None:
            before, after = (um(self.predicted[name].contour_rms_um) for name in WAYS)
            if float(after) > float(before):
                yield (
                    f"Compensation makes this print worse by its own prediction: contour error {after} µm rms, against "
                    f"{before} µm without it. Print the original."
                )
        if self.forecast.failed:
            yield self.forecast.failed
        yield from (*numbers.shares.warnings(), *numbers.warnings, *self.bound_missed)
        per_s = numbers.segments / max(numbers.print_time_s, 1e-9)
        if per_s >= FIRMWARES[self.flavor.flavor].slow_board_per_s:
            yield (
                f"The file has {per_s:.0f} segments a second. An 8-bit board, or a serial line at 115200 baud "
                "(OctoPrint), falls behind and the print stutters: print it from the card of a 32-bit board."
            )
        yield from slowed_lines(numbers.slowed, self.machine, numbers.original_print_time_s)

    @property
    def unknown(self) -> list[str]:
        """Return in one line the parameters that the machine file does not know."""
        sentences = [assumed_modes(self.machine), *(self.shaper.warnings if self.shaper else [])]
        return [" ".join(filter(None, sentences))] if any(sentences) else []

    @property
    def bound_missed(self) -> list[str]:
        """State the predicted error of the written print, where it is not the bound."""
        faster, written = self.statistics.faster, self.predicted.get("compensated")
        if faster is None or written is None or written.contour_p99_um <= P99_LEVEL * faster.bound_um:
            return []
        return [
            f"The bound of {faster.bound_um:g} µm is not held: for 99 % of the time the predicted error is below "
            f"{written.contour_p99_um:.2g} µm. What keeps the slicer's speed is not made slower, and segments and "
            "rests leave 1 to 2 µm, however slow a print is."
        ]

    @property
    def predicted(self) -> Mapping[str, Track]:
        """Errors of the uncompensated and of the compensated print; empty: not predicted."""
        return self.forecast.tracks

    @property
    def faster(self) -> QuickerPrint | None:
        """What a bound on the error has brought; None: there was none."""
        none = self.statistics.faster is None
        return None if none else QuickerPrint(self.statistics, self.predicted.get("compensated"))

    def __add__(self, other: Result) -> Result:
        """Add another print of the same file."""
        return replace(
            self,
            statistics=self.statistics + other.statistics,
            compute_time_s=self.compute_time_s + other.compute_time_s,
            size=self.size + other.size,
        )

    @property
    def original_embedded(self) -> bool | None:
        """Whether the G-code holds its original; None: step timings."""
        return self.embedded if self.steps is None else None


COUNTED = ("print_time_s", "original_print_time_s", "moves", "segments", "windows")
PRINT_KEYS = keys(
    *("machine", "compute_time_s", "size", "faster", "steps", "original_embedded"),
    flavor="flavor.flavor",
    flavor_reason="flavor.reason",
    offset_mm="placement.offset",
    offset_reason="placement.reason",
    robust="robust.robust",
    robust_reason="robust.reason",
    input_shaper="shaper.state",
    input_shaper_reason="shaper.reason",
    compensated_share="statistics.shares",
    uncompensated="statistics.shares.by_cause",
    predicted="forecast.tracks",
    predicted_over_s="forecast.over_s",
    expected="forecast.expected",
    verdict="forecast.verdict",
    **{name: f"statistics.{name}" for name in (*COUNTED, "limited_windows", "slowed")},
)


@dataclass(frozen=True, slots=True)
class PrintTimes:
    """The times of one print of a file."""

    name: str
    print_time_s: float
    original_print_time_s: float


@dataclass(frozen=True, eq=False, repr=False)
class CompensatedFile(VerbResult):
    """The result of one file."""

    title = "Compensated print"
    schema = "ffcomp-compensate/1"
    json_keys: ClassVar = keys(
        *("already", "output", "warnings"),
        input="path",
        prints="print_times",
        **{key: f"whole.{path}" for key, path in PRINT_KEYS.items()},
    )
    drawn_by: ClassVar = {"show": "ffcomp.report.show:compensation_figure"}

    path: str  # the file, as the user named it
    output: Path | None  # the file that was written; None: nothing was
    # by the print's name, which is empty for the only one; none: the file was compensated already
    prints: Mapping[str, Result] = field(default_factory=dict)
    already: str = ""  # says that it was; empty: it was compensated now
    advice: tuple[str, ...] = ()  # warnings about how the file was made
    seen_at: str | None = None  # where a slicer moves the output; empty: unknown; None: where it is written

    @property
    def result(self) -> Result:
        """All prints together."""
        first, *others = self.prints.values()
        for other in others:
            first += other
        return first

    @property
    def machine(self) -> Machine:
        """The machine that the print was compensated for."""
        return self.result.machine

    @property
    def print_time_s(self) -> float:
        """Print time of the compensated file in s."""
        return self.result.statistics.print_time_s

    @property
    def original_print_time_s(self) -> float:
        """Print time of the original in s."""
        return self.result.statistics.original_print_time_s

    @property
    def segments(self) -> int:
        """Number of segments written."""
        return self.result.statistics.segments

    @property
    def uncompensated(self) -> Track | None:
        """Predicted errors of the original; None: not predicted."""
        return self.result.predicted.get("uncompensated")

    @property
    def compensated(self) -> Track | None:
        """Predicted errors of the compensated print; None: not predicted."""
        return self.result.predicted.get("compensated")

    @property
    def headline(self) -> str:
        """What contour error to expect, or the work done."""
        if self.already:
            return self.already
        expected = self.result.forecast.expected
        if expected is not None:
            return expected.headline
        many = f"{len(self.prints)} prints in one file are" if len(self.prints) > 1 else "The print is"
        return f"{many} compensated; the error that is left was not predicted."

    @property
    def facts(self) -> Sequence[Fact]:
        """Errors, times, and the decisions with their reasons."""
        return [(name, value) for name, value in self._facts() if value] if self.prints else ()

    def _facts(self) -> Iterator[Fact]:
        result, numbers = self.result, self.result.statistics
        if result.predicted:
            was, now = (result.predicted[name] for name in WAYS)
            yield "If the machine file is exact", result.forecast.exact
            late = late_line(sum(each.seconds for each in numbers.slowed))
            yield "Tracking error", f"{um(was.tracking_rms_um)} → {um(now.tracking_rms_um)} µm rms{late}"
            peaks = (each.peak_command_acceleration_mm_per_s2 / 1e3 for each in (was, now))
            yield "Peak acceleration of a motor", "{:.1f} → {:.1f} m/s²".format(*peaks)
        was_s, now_s = numbers.original_print_time_s, numbers.print_time_s
        yield "Print time", f"{clock(now_s)}, was {clock(was_s)} ({100 * (now_s / max(was_s, 1e-9) - 1):+.1f} %)"
        if result.shaper is None or result.shaper.state != "set":
            path, filament = percent(numbers.shares.path), percent(numbers.shares.filament)
            yield "Compensated", f"{path} of the path, {filament} of the filament"
        if numbers.faster is not None:
            yield "Faster", faster_line(numbers.faster, was_s, now_s, self.compensated)
            yield "Time limited by", limits_in_words(numbers.faster.limited_by)
            yield "Uncertainty", uncertainty_line(result.machine)
        reasons = (result.flavor.reason, result.placement.reason, result.robust.reason)
        shaper = result.shaper.reason if result.shaper else ""
        for name, reason in zip(("Firmware", "Place", "Inverse", "Input shaper"), (*reasons, shaper), strict=True):
            said = any(reason in each for each in self.warnings)
            yield name, "" if said else reason.removeprefix(f"{name}: ")
        if result.steps:
            yield "Steps", ", ".join(f"{motor.upper()} {total.steps}" for motor, total in result.steps.items())
        elif result.steps is None and numbers.segments:
            yield "Segments", f"{numbers.segments} for {numbers.moves} moves; the file is {result.size}"
        yield "Took", f"{result.compute_time_s:.1f} s"

    @property
    def warnings(self) -> list[str]:
        """All warnings, in sentences."""
        several = len(self.prints) > 1
        own = [f"{name}: {each}" if several else each for name, r in self.prints.items() for each in r.warnings]
        return [*(self.result.unknown if self.prints else ()), *self.advice, *own]

    @property
    def warning_lines(self) -> list[str]:
        """The same for people, in a few lines: what the machine file does not know comes first."""
        if not self.prints:
            return list(self.advice)
        return shortened([*self.result.unknown, *self.advice, *grouped(self.result.warnings)])

    @property
    def next_steps(self) -> Sequence[str]:
        """Return the commands to use the output with."""
        return list(self._next_steps()) if self.prints else ()

    def _next_steps(self) -> Iterator[str]:
        result, place = self.result, str(self.output or "") if self.seen_at is None else self.seen_at
        if result.steps is None and not result.embedded:
            yield "The original is not in the file (--no-embed): keep the sliced one, for ffcomp restore cannot."
        if result.steps is not None and not result.steps:
            yield f"Play it: FFCOMP_PRINT FILE={Path(place or 'FILE').name} (docs/HOST.md)."
            return
        if result.forecast.expected is not None and result.forecast.expected.next_step:
            yield result.forecast.expected.next_step
        if place:
            verb = "simulate" if result.steps else "show"
            yield f"Look at it: ffcomp {verb} {place}{machine_option(result.machine.path, verb)}"

    @property
    def whole(self) -> Result | None:
        """All prints together; None: the file was compensated already."""
        return self.result if self.prints else None

    @property
    def print_times(self) -> list[PrintTimes]:
        """The times of each print."""
        counted = ((name, each.statistics) for name, each in self.prints.items())
        return [PrintTimes(name, n.print_time_s, n.original_print_time_s) for name, n in counted]


def percent(share: float) -> str:
    """Return a share in per cent, and 100 only if nothing is missing."""
    return "100 %" if share == 1.0 else f"{min(100 * share, 99.9):.1f} %"


def machine_option(path: str, next_verb: str) -> str:
    """Return the option that the next command needs; `show` finds machines that have a name."""
    names = [name for name, known in machine_paths().items() if str(known) == path]
    if names:
        return "" if next_verb == "show" else f" -m {names[0]}"
    return f" -m {shlex.quote(path)}"


def late_line(seconds: float) -> str:
    """Explain the tracking error of slower places; empty: there are none."""
    if not seconds:
        return ""
    late = f"{1e3 * seconds:.0f} ms" if seconds < 1.0 else f"{seconds:.1f} s"
    return (
        f". The tracking error includes the delay of up to {late} where the print was slowed down; the part does not "
        "show it. The contour error is the distance from the path."
    )


def uncertainty_line(machine: Machine) -> str:
    """State the assumed uncertainty of a bound where the machine file states none; empty: it states some."""
    if machine.uncertainty != {"default": DEFAULT_UNCERTAINTY}:
        return ""
    return (
        f"The bound assumes that every parameter of the printer is uncertain by {100 * DEFAULT_UNCERTAINTY:g} % "
        "(standard deviation): the machine file has no [uncertainty] of its own."
    )


NO_GAIN = (
    "That is no gain: with the machine file's [uncertainty], the bound is not kept even at the slicer's speed. Measure "
    "your printer (ffcomp identify), or allow a larger error."
)


def faster_line(faster: Faster, was: float, now: float, left: Track | None) -> str:
    """Say in a line what the bound has brought; was, now : print times, s."""
    limits, error = faster.limited_by, ""
    slower = now >= was and max(limits, key=lambda name: limits[name]) == "error_bound"
    if left is not None:
        error = f", predicted contour error p99 {left.contour_p99_um:.1f} µm, max {left.contour_max_um:.1f} µm"
    least = f"nothing can be quicker than {faster.actuator_limit_s:.1f} s"
    line = f"{was:.1f} → {now:.1f} s ({100 * (now / was - 1):+.0f} %; {least})"
    return f"{line}{error}.{f' {NO_GAIN}' if slower else ''}"


def already_compensated(path: str, stamps: Iterable[Stamp | None], output: Path) -> CompensatedFile:
    """Return the result of a file that is compensated already; `output` is the file itself, or a copy of it."""
    by = " and ".join(dict.fromkeys(f"ffcomp v{stamp.version} for {stamp.machine}" for stamp in stamps if stamp))
    done = "nothing changed" if str(output) == path else "copied unchanged"
    return CompensatedFile(path, output, already=f"{path}: already processed by {by}; {done}.")


@dataclass(frozen=True, slots=True)
class Failure:
    """Why a file was not compensated."""

    json_keys: ClassVar = keys("exit_code", input="file", error="sentence")

    file: Path
    sentence: str
    exit_code: int
    trace: str = ""  # of a fault of our own


@dataclass(frozen=True, slots=True)
class FileResult:
    """The result of one file among many."""

    number: int  # its place among the files
    file: Path
    seconds: float
    outcome: CompensatedFile | Failure

    @property
    def done(self) -> CompensatedFile | None:
        """The result of a file; None: it failed."""
        return self.outcome if isinstance(self.outcome, CompensatedFile) else None

    @property
    def failure(self) -> Failure | None:
        """Why it failed; None: it did not."""
        return self.outcome if isinstance(self.outcome, Failure) else None

    @property
    def in_short(self) -> str:
        """Print time and predicted error before → after, and what it took; or that it failed."""
        if self.done is None:
            return "failed"
        if self.done.already:
            return "already processed"
        result, numbers = self.done.result, self.done.result.statistics
        parts = [f"{numbers.original_print_time_s:.1f} → {numbers.print_time_s:.1f} s"]
        if rms := " → ".join(um(track.contour_rms_um) for track in result.predicted.values()):
            of_part = "" if numbers.shares.path >= ENOUGH else f" of {percent(numbers.shares.path)}"
            parts.append(f"contour error {rms} µm rms{of_part}")
        return f"{', '.join(parts)}; took {self.seconds:.1f} s"


@dataclass(frozen=True, eq=False, repr=False)
class CompensatedFiles(VerbResult):
    """The results of several files, in their order."""

    schema = "ffcomp-compensate-batch/1"
    json_keys: ClassVar = keys("failed", results="outcomes")

    results: Sequence[FileResult]

    @property
    def outcomes(self) -> list[CompensatedFile | Failure]:
        """The result or the failure of each file."""
        return [each.outcome for each in self.results]

    @property
    def failed(self) -> int:
        """How many files were not compensated."""
        return sum(each.failure is not None for each in self.results)

    @property
    def failure(self) -> FfcompError | None:
        """Every failure with its sentence; the exit code is the first one's."""
        failures = [each.failure for each in self.results if each.failure is not None]
        if not failures:
            return None
        error = FfcompError("\nffcomp: ".join(f"{each.sentence}\n{each.trace}".rstrip() for each in failures))
        error.exit_code = failures[0].exit_code
        return error

    @property
    def headline(self) -> str:
        """How many files are done."""
        lost = f", {self.failed} failed" if self.failed else ""
        return f"{len(self.results) - self.failed} of {len(self.results)} files are compensated{lost}."

    @property
    def facts(self) -> Sequence[Fact]:
        """Of each file its print time, its predicted error, and what it took."""
        return [(str(each.file), each.in_short) for each in self.results]

    @property
    def warnings(self) -> list[str]:
        """Each warning once, of those that differ in numbers only the first, with its files; most files first."""
        files: dict[str, list[str]] = {}
        first: dict[str, str] = {}
        for each in self.results:
            for warning in each.done.warning_lines if each.done else ():
                files.setdefault(first.setdefault(cause_of(warning), warning), []).append(str(each.file))
        most_first = sorted(files.items(), key=lambda each: -len(each[1]))
        return [
            f"{names[0]}{f' and {len(names) - 1} more' if len(names) > 1 else ''}: {warning}"
            for warning, names in most_first
        ]

    @property
    def warning_lines(self) -> list[str]:
        """The same, no more than a person reads."""
        return shortened(self.warnings)


def attempt(number: int, file: Path, work: Callable[[Path], CompensatedFile]) -> FileResult:
    """Run `work(file)` and return its result or failure; never raises."""
    started = time.perf_counter()
    try:
        with interrupts_restored():
            done = work(file)
        return FileResult(number, file, time.perf_counter() - started, done)
    except Exception as error:
        return FileResult(number, file, time.perf_counter() - started, failure_of(error, file))


def failure_of(error: Exception, path: Path) -> Failure:
    """Return an error's sentence and its documented exit code."""
    if isinstance(error, INPUT_ERRORS):
        return Failure(path, *explain(error, str(path)))
    if isinstance(error, BrokenExecutor):
        return Failure(path, f"{path}: {DIED}", 1)
    trace = "".join(traceback.format_exception(error))
    return Failure(path, f"{path}: ffcomp itself is at fault ({type(error).__name__}: {error}).", 1, trace)
