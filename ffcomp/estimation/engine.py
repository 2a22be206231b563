"""Estimate the time of one file, as written, and of the original in a compensated file."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from typing import ClassVar

from ffcomp.compensation.placement import Offset, Placement, place_print
from ffcomp.errors import NothingToDo
from ffcomp.estimation.statistics import Statistics, Unknown, planned_slices
from ffcomp.firmware.program import firmware_plan, planner_of, raw_durations, read_as_planned
from ffcomp.firmware.table import FIRMWARES
from ffcomp.numerics.serialise import ALL_OF, keys
from ffcomp.planner.reach import Reach
from ffcomp.result import Fact, Result, clock
from gcode.container import Source, blocks_of, ends_of
from gcode.dialects import choose_flavor, sign_by_ends
from gcode.embedded import find_offset, find_stamp, holds_original, original_blocks
from models.machine import Machine

MOST_LINES = 4  # of each command whose time is not known


@dataclass(frozen=True, eq=False, repr=False)
class Estimate(Result):
    """Time and filament of a print on a machine, as written and, for a compensated file, of the original.

    Heating, homing and macros are not in the time: no file says how long they take.
    """

    title = "Print time"
    schema = "ffcomp-estimate/1"
    json_keys: ClassVar = keys("machine", "flavor", "compensated", "original", input="path") | {ALL_OF: "statistics"}

    path: str
    machine: Machine
    flavor: str
    statistics: Statistics  # of the file as written
    original: Statistics | None  # of the print before its compensation; None: the file is no compensated one
    lists_layers: bool = False  # among the facts

    @property
    def time_s(self) -> float:
        """Of the file as written."""
        return self.statistics.total.time_s

    @property
    def compensated(self) -> bool:
        """Whether the file is a compensated one."""
        return self.original is not None

    @property
    def headline(self) -> str:
        """The time, the time before compensation, and the slicer's own estimate."""
        numbers, text = self.statistics, f"{self.path} on {self.machine.name}: {clock(self.time_s)}"
        text += "" if self.original is None else f", before compensation {clock(self.original.total.time_s)}"
        return f"{text}{'' if numbers.slicer_s is None else f'; the slicer says {clock(numbers.slicer_s)}'}."

    @property
    def facts(self) -> list[Fact]:
        """Time by kind of motion and by feature, layers and filament."""
        numbers, whole = self.statistics, self.time_s

        def share(spent: float) -> str:
            return f"{clock(spent)}, {100 * spent / whole:.1f} %"

        kinds = [(kind, share(s)) for kind, s in numbers.total.by_kind.items() if s]
        features = sorted(numbers.features.items(), key=lambda item: -item[1].time_s)
        of_features = [(n, f"{share(each.time_s)}, {max(each.filament_mm, 0.0) / 1e3:.2f} m") for n, each in features]
        filament = ("filament", f"{numbers.filament_mm / 1e3:.2f} m, {numbers.retractions} retractions")
        times = sorted((e.spent.time_s, e.number) for e in numbers.layers_in_order if e.number is not None)
        layers = [("layers", f"{len(times)}")] if times else []
        if len(times) > 1:
            (least, low), (most, high) = times[0], times[-1]
            layers = [("layers", f"{len(times)}, {clock(least)} (layer {low}) to {clock(most)} (layer {high})")]
        return [*kinds, *of_features, *layers, filament, *(self.layers if self.lists_layers else ())]

    @property
    def layers(self) -> list[Fact]:
        """Every layer's height, line in the file, and time."""
        rows = []
        for each in self.statistics.layers_in_order:
            name = "before" if each.number is None else f"layer {each.number}"
            height = "" if each.z_mm is None else f"z {each.z_mm:.2f} mm, "
            rows.append((name, f"{height}line {each.line}: {clock(each.spent.time_s)}"))
        return rows

    @property
    def warnings(self) -> list[str]:
        """Commands of unknown duration, and assumptions."""
        unknown = [f"{each.what} ({each.command}, {_lines(each)})" for each in self.statistics.unknown.values()]
        missing = [f"Not included (duration unknown): {'; '.join(unknown)}."] if unknown else []
        return [*missing, *self.statistics.warnings]


def _lines(unknown: Unknown) -> str:
    """Where, as far as a sentence can hold it."""
    first, more = ", ".join(map(str, unknown.lines[:MOST_LINES])), unknown.count - MOST_LINES
    return f"line{'s' * (unknown.count > 1)} {first}{f' and {more} more' if more > 0 else ''}"


def estimate(
    source: Source, path: str, machine: Machine, *, flavor: str = "", offset: Offset | None = None
) -> Estimate:
    """Plan a file as the firmware does, and add up its times. Memory does not grow with the file.

    source : the file
    path : its name, for errors
    flavor : {"", "klipper", "marlin", "reprapfirmware"}, "" for what the machine file says, or else the file
    offset : (float, float), added to every position of a print that is not compensated yet, mm; None: as `compensate`
        chooses it

    Raises GcodeError if a line cannot be followed, or a position is out of the machine's reach; NothingToDo if nothing
    moves.
    """
    head, tail, _ = ends_of(source)
    stamp = find_stamp(head, tail)
    requested = flavor or (stamp.flavor if stamp else "")
    flavor = choose_flavor(requested, machine.flavor, sign_by_ends(head, tail), path).flavor
    if stamp is None:
        placed = place_print(source, path, machine, flavor) if offset is None else Placement(offset, "")
        statistics = _statistics(blocks_of(source), path, machine, flavor, placed.offset)
        statistics.warnings += [placed.reason] if placed.notable else []
        return Estimate(path, machine, flavor, statistics, None)
    written = _statistics(blocks_of(source), path, machine, flavor, (0.0, 0.0))
    if not holds_original(head):
        return Estimate(path, machine, flavor, written, None)
    before = original_blocks(blocks_of(source))
    return Estimate(path, machine, flavor, written, _statistics(before, path, machine, flavor, find_offset(head)))


def _statistics(blocks: Iterable[bytes], path: str, machine: Machine, flavor: str, offset: Offset) -> Statistics:
    parts = read_as_planned(blocks, path, machine, flavor, offset_mm=offset)
    statistics = Statistics()
    if assumed := FIRMWARES[flavor].assumed(machine):
        statistics.warnings.append(assumed)
    for part in planned_slices(Reach(machine.kinematics).whole(parts), partial(firmware_plan, machine=machine)):
        statistics.add(part, raw_durations(part.events, planner_of(part.program, machine)))
    if not statistics.moves:
        raise NothingToDo(f"{path}: no move has a known start, so there is no time to estimate.")
    return statistics
