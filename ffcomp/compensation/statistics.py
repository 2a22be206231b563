"""Statistics of a compensation, which add up over sections, chunks and files, and its warnings."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, ClassVar

import numpy as np

from ffcomp.compensation.faster import Faster
from ffcomp.compensation.net import Unsafe
from ffcomp.compensation.prediction import Samples
from ffcomp.firmware.program import PlannedProgram
from ffcomp.inverse.feasible import SolvedSection
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.reference import Extent
from ffcomp.inverse.time_scaling import TimeScaling
from ffcomp.numerics.serialise import keys
from ffcomp.planner.limits import lines_of
from ffcomp.planner.reach import BESIDE
from ffcomp.planner.trajectory import Section
from gcode.program import Event, Moves, Program
from gcode.slicing import some
from models.machine import Machine

ENOUGH = 0.95  # of the path or the filament: below it there is a warning
_MACRO = re.compile(r"@?_?[A-Z][A-Z0-9]*_\w*|[A-Z]{4,}\w*")


@dataclass(frozen=True, slots=True)
class Amount:
    """Length of the path, and of the filament pushed out along it."""

    path_mm: float = 0.0
    filament_mm: float = 0.0
    seconds: float = 0.0  # only of uncompensated moves

    def __add__(self, other: Amount) -> Amount:
        return Amount(self.path_mm + other.path_mm, self.filament_mm + other.filament_mm, self.seconds + other.seconds)


@dataclass(frozen=True, slots=True)
class Place:
    """A command that leaves the nozzle at an unknown place, so that the moves after it were not compensated."""

    line: int  # in the file, from 1; 0: its beginning
    command: str


@dataclass(frozen=True, slots=True)
class Shares:
    """The compensated and the uncompensated part of the file's own moves."""

    json_keys: ClassVar = keys("path", "filament")

    compensated: Amount = field(default_factory=Amount)
    left: Mapping[Place, Amount] = field(default_factory=dict)

    def __add__(self, later: Shares) -> Shares:
        left = dict(self.left)
        for place, part in later.left.items():
            left[place] = left.get(place, Amount()) + part
        return Shares(self.compensated + later.compensated, left)

    @property
    def uncompensated(self) -> Amount:
        """The sum of all uncompensated moves."""
        return sum(self.left.values(), Amount())

    @property
    def path(self) -> float:
        """The compensated share of the path, 0 to 1."""
        return _share(self.compensated.path_mm, self.uncompensated.path_mm)

    @property
    def filament(self) -> float:
        """The compensated share of the filament, 0 to 1."""
        return _share(self.compensated.filament_mm, self.uncompensated.filament_mm)

    def warnings(self) -> tuple[str, ...]:
        """Warn where too little is compensated, with the reason and the remedy."""
        if min(self.path, self.filament) >= ENOUGH:
            return ()
        shares = (
            f"Only {100 * self.path:.0f} % of the path and {100 * self.filament:.0f} % of the filament are compensated"
        )
        most = max(self.by_cause, key=lambda each: (each.path_mm, each.filament_mm))
        return (f"{shares}, and errors are stated for these alone: {_because(most)}",)

    @property
    def by_cause(self) -> list[Uncompensated]:
        """The uncompensated moves after each command, in the file's order."""
        grouped: dict[str, dict[Place, Amount]] = {}
        for place, part in self.left.items():
            grouped.setdefault(place.command, {})[place] = part
        return [Uncompensated.of(places) for places in grouped.values()]


@dataclass(frozen=True, slots=True)
class Uncompensated:
    """Moves that went out uncompensated after one command."""

    line: int
    command: str
    places: int
    worst_line: int
    path_mm: float
    filament_mm: float
    seconds: float

    @classmethod
    def of(cls, places: Mapping[Place, Amount]) -> Uncompensated:
        """Sum the places after one command."""
        first, whole = next(iter(places)), sum(places.values(), Amount())
        worst = max(places, key=lambda place: (places[place].path_mm, places[place].filament_mm)).line
        return cls(first.line, first.command, len(places), worst, whole.path_mm, whole.filament_mm, whole.seconds)


def of_moves(moves: Moves) -> Amount:
    """Count moves that are compensated."""
    lines = lines_of(moves)
    pushed = np.maximum(moves.end[:, 3] - moves.start[:, 3], 0.0)
    return Amount(float(lines.length[lines.travels].sum()), float(pushed[lines.travels].sum()))


def _share(part: float, rest: float) -> float:
    return 1.0 if rest <= 0.0 else part / (part + rest)


def _because(left: Uncompensated) -> str:
    """Say why the moves after one command were not compensated; the line is the one that loses most."""
    line, command = left.worst_line, left.command
    others = "" if left.places == 1 else f" ({left.places} places, most after this one)"
    lost = f"{left.filament_mm:.0f} mm of filament" if left.filament_mm >= 0.5 else "no filament, travels only"
    if command == BESIDE:
        return f"from line {line} on, moves lie outside the print volume{others}, {lost}."
    if command == UNSAFE:
        return f"from line {line} on, commands failed their check{others}, {lost}."
    if not line:
        return f"the file does not say where the nozzle begins ({lost}); home, or name X, Y and Z, before it prints."
    where = f"after {command} in line {line} the place of the nozzle is unknown{others}, {lost}"
    if _MACRO.fullmatch(command):
        return (
            f"{where}. If it returns to where it began, declare it in the machine file: "
            f'[macros] returns = ["{command}"]; otherwise name X and Y after it in the slicer.'
        )
    return f"{where}; name X and Y after it."


UNSAFE = "command that failed its check"  # in place of a command
UTILISATION_TOLERANCE = 1.001  # times a limit, above which there is a warning


@dataclass(frozen=True, slots=True)
class Statistics:
    """Counts and times of a compensation."""

    moves: int = 0
    segments: int = 0
    windows: int = 0
    limited_windows: int = 0
    original_print_time_s: float = 0.0
    print_time_s: float = 0.0
    warnings: tuple[str, ...] = ()
    slowed: tuple[TimeScaling, ...] = ()
    predicted: Samples | None = None
    shares: Shares = field(default_factory=Shares)
    faster: Faster | None = None  # None: without a bound
    unsafe: tuple[Unsafe, ...] = ()  # uncompensated because their command failed its check

    def __add__(self, later: Statistics) -> Statistics:
        """Add the statistics of a later part; a warning is kept once."""
        sums = {each.name: _sum(getattr(self, each.name), getattr(later, each.name)) for each in fields(self)}
        return Statistics(**sums | {"warnings": tuple(dict.fromkeys(sums["warnings"]))})


def _sum(one: Any, later: Any) -> Any:
    return later if one is None else one if later is None else one + later


def of_plan(planned: PlannedProgram, extent: Extent) -> Statistics:
    """Count the moves of a program, or of its written part, and their planned duration."""
    moves, plan = planned.program.moves, planned.trajectory
    begin = 0.0 if extent.begin is None else extent.begin.time_in(plan)
    first, last = int(np.searchsorted(plan.start_t, begin)), len(moves)
    original_s, print_s = planned.firmware_s - begin, float(plan.end_t) - begin
    if extent.end is not None:
        end = extent.end.time_in(plan)
        last, original_s, print_s = int(np.searchsorted(plan.start_t, end)), end - begin, 0.0
    shares, count = Shares(of_moves(some(moves, slice(first, last)))), _lines(moves, first, last)
    return Statistics(moves=count, original_print_time_s=original_s, print_time_s=print_s, shares=shares)


def _lines(moves: Moves, first: int, last: int) -> int:
    """Count the lines that moves first..last-1 are of: neither chords of arcs nor the pieces that firmware cuts."""
    return int(np.count_nonzero(np.diff(moves.line[max(first - 1, 0) : last]))) + int(first == 0 < last)


def of_raw(events: Iterable[Event], seconds: Mapping[int, float]) -> Statistics:
    """Count moves that pass through, whose duration is unchanged; `seconds` by the line's index."""
    left: dict[Place, Amount] = {}
    for event in events:
        if event.raw is not None:
            pushed = max(event.raw.filament_mm, 0.0) if event.raw.path_mm > 0.0 else 0.0
            part = Amount(event.raw.path_mm, pushed, seconds.get(event.line, 0.0))
            place = Place(*event.raw.cause)
            left[place] = left.get(place, Amount()) + part
    shares = Shares(left=left)
    lasting_s = shares.uncompensated.seconds
    return Statistics(original_print_time_s=lasting_s, print_time_s=lasting_s, shares=shares)


def of_section(section: Section, solved: SolvedSection, planned: PlannedProgram, model: InverseModel) -> Statistics:
    """Count a solved section, which lasts longer than it was planned."""
    (begin, end), (cut, until) = solved.reference.written, solved.reference.extent
    longer_s = (end - begin) * model.settings.segment_s
    if until is None:  # less what its plan has counted
        longer_s -= section.end_t - (section.begin_t if cut is None else cut.time_in(planned.trajectory))
    result = solved.solution
    warnings = tuple(_excesses(solved, planned.program, model)) if result.utilisation > UTILISATION_TOLERANCE else ()
    return Statistics(
        windows=1,
        limited_windows=len(result.limited),
        print_time_s=longer_s,
        warnings=warnings,
        slowed=tuple(each for each in solved.slowed if each.seconds > 0.0),
    )


def of_unsafe(section: Section, planned: PlannedProgram, why: str) -> Statistics:
    """Count a section that keeps its original lines: its plan has been counted as compensated."""
    program = planned.program
    part = of_moves(some(program.moves, slice(section.first, section.last)))
    first, last = program.line_of(section.first), program.line_of(section.last - 1)
    left = replace(part, seconds=section.end_t - section.begin_t)
    shares = Shares(Amount(-part.path_mm, -part.filament_mm), {Place(first, UNSAFE): left})
    return Statistics(shares=shares, unsafe=(Unsafe(first, last, why),))


def _excesses(solved: SolvedSection, program: Program, model: InverseModel) -> Iterator[str]:
    """Warn if more than a limit is demanded where the section is written."""
    begin, end = solved.reference.written
    demand = solved.solution.demand[begin : end + 2].max(axis=(1, 2))
    worst = int(demand.argmax())
    if demand[worst] > UTILISATION_TOLERANCE:
        t = solved.reference.t0 + (begin + worst) * model.settings.segment_s
        move = min(max(int(solved.trajectory.move_at(t)), solved.section.first), solved.section.last - 1)
        yield f"line {program.line_of(move)}: the command needs {demand[worst]:.2f} times a carriage's limit here."


MOST_LINES = 5

_NUMBER = re.compile(r"\d[\d.]*")
_MORE = "see --json, or the log (ffcomp --log-path)"


def shortened(lines: Sequence[str], most: int = MOST_LINES) -> list[str]:
    """Return no more lines than a person reads."""
    if len(lines) <= most:
        return list(lines)
    kept = most - 1
    return [*lines[:kept], f"{len(lines) - kept} more kinds of warnings: {_MORE}."]


def grouped(warnings: Iterable[str]) -> list[str]:
    """Return the first of all warnings that differ in numbers only, and how many more there are."""
    first: dict[str, str] = {}
    count: Counter[str] = Counter()
    for warning in warnings:
        cause = cause_of(warning)
        first.setdefault(cause, warning)
        count[cause] += 1
    return [
        warning if count[cause] == 1 else f"{warning} {count[cause] - 1} more like this: {_MORE}."
        for cause, warning in first.items()
    ]


def cause_of(warning: str) -> str:
    """Return the warning without its numbers."""
    return _NUMBER.sub("#", warning)


def slowed_lines(slowed: Sequence[TimeScaling], machine: Machine, original_s: float) -> Iterator[str]:
    """Yield a sentence for each limit that made places slower; original_s : time of the original print, s."""
    limits = {each.limit for each in slowed}
    groups = [[each for each in slowed if each.limit == limit] for limit in limits]
    for group in sorted(groups, key=lambda group: -sum(each.seconds for each in group)):
        lost_s = sum(each.seconds for each in group)
        places = "1 place" if len(group) == 1 else f"{len(group)} places"
        share = f" ({100 * lost_s / original_s:+.2g} %)" if original_s > 0 else ""
        longer = f"{lost_s:.0f} s" if lost_s >= 10 else f"{lost_s:.2g} s"
        yield f"Slowed at {places}, {longer} longer in all{share}: {_reason(group, machine)}"


def _reason(group: Sequence[TimeScaling], machine: Machine) -> str:
    limit = group[0].limit
    if not limit:
        return (
            "the firmware's own acceleration, where the nozzle lifts or filament is pulled back above all, leaves too "
            "little for the segments. Fewer z-hops and wipes avoid it, or more acceleration in firmware and machine "
            "file."
        )
    names = machine.kinematics.actuator_names
    count = Counter(names["ABC".index(each.carriage)] for each in group)
    who = ", ".join(f"{name} ({number}×)" if len(count) > 1 else name for name, number in count.most_common())
    peak = max(each.asked for each in group)
    return f"the {limit} limit of {who} was exceeded up to {peak:.2f} times. {_remedy(limit, machine)}"


def _remedy(limit: str, machine: Machine) -> str:
    limits = machine.limits
    if limit == "travel":
        travel = limits.carriage_travel_mm
        return f"carriage_travel_mm = {list(travel or ())} in [limits] of the machine file is what the carriages have."
    key, value = {
        "velocity": ("carriage_velocity_mm_per_s", limits.carriage_velocity_mm_per_s),
        "acceleration": ("carriage_acceleration_mm_per_s2", limits.carriage_acceleration_mm_per_s2),
    }[limit]
    rate = f", or step_rate_hz = {limits.step_rate_hz:g}," if limit == "velocity" and limits.step_rate_hz else ""
    slower = "speed" if limit == "velocity" else "acceleration"
    return (
        f"A lower {slower} in the slicer avoids it; or more than {key} = {value:g}{rate} in [limits] of the machine "
        "file, if the motors can do it."
    )
