"""Marlin: a queue of blocks of whole motor steps (`marlin_planner`), and segments that it executes exactly.

They are long enough in steps, timed by its own queue, within limits of ours. Marlin drops what has fewer steps than
MIN_STEPS_PER_SEGMENT and joins it to the next line, so that its time is lost; it cuts a delta's lines that last 10 ms
and more by their F, and each part may be too short: M203, which limits the motors, sets lower speeds; it slows the
first lines after a rest (SLOWDOWN, by `M205 B`); it rounds every end to whole steps (`whole_steps`); and one step of
the filament more or less from segment to segment is a jump of its speed, and E's jerk then slows the path.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import reduce
from math import inf

import numpy as np

from ffcomp.firmware.base import AxisLimits, Filament, FilamentCount, FileLimits, Firmware, Inside, Segments
from ffcomp.firmware.marlin_planner import (
    MarlinPlanner,
    arc_chords,
    cut_moves,
    extruder_steps_per_mm,
    marlin_settings,
    on_delta,
    settings_row,
)
from ffcomp.firmware.marlin_queue import SPEED, STEPS, Singles, Targets, phases_of, plan_blocks
from ffcomp.firmware.settings_in_force import SettingsInForce, assumed_sentence, row_after
from ffcomp.firmware.whole_steps import WholeSteps
from ffcomp.inverse.model import InverseModel
from ffcomp.planner.segment_merging import at_most
from ffcomp.planner.segment_timing import SegmentLimits, SegmentSpeeds
from gcode.dialect import MARLIN
from gcode.dialects import limit_lines
from gcode.program import LimitCommand, ModalState, Program
from gcode.words import commands
from models.arrays import BoolArray, FloatArray, IntArray
from models.compiled import kernel
from models.machine import Machine, MarlinSettings

PART_S = 300.0  # a delta's lines are cut by time: a megabyte of slow text becomes millions of pieces
KNOWN = (2, 1, 2)  # the version whose planner this is
NEWER_JERK = (
    "The print is planned as Marlin 2.1.2 does. Later versions have another classic jerk: short programs took 16 % "
    "less to 9 % more time than planned."
)
WHOLE_S = 0.95  # of the time beyond which a delta's line is cut in two
SWEEPS = 2  # of the speeds that make durations exact
MOST_FASTER = 4.0  # the highest speed that a sweep may request, by length over time
LEAST_E_MM = 1e-5  # that a file can state
FLICKER_STEPS, FLICKER_S = 2.0, 0.004  # filament in a segment; E's jerk must allow this jump of speed
LONGEST_DEVIATION_MM = 0.3  # that M205 J takes
ALWAYS = 3  # the rank of a point that must end a segment; 2: the filament turns back there; 1: fixed; 0: any other


class Marlin(Firmware):
    """Drops short segments, cuts a delta's lines by time, rounds to whole steps and brakes for the end of its queue."""

    flavor = MARLIN
    slow_board_per_s = 100.0  # 8 bits: 10 ms each to parse and plan
    in_comparisons = (
        (
            "Marlin",
            "The ends of ffcomp's segments are on whole motor steps, as Marlin's are. No other row has that rounding, "
            "which a real printer adds to each.",
        ),
    )
    corrections_off = ("M420 S0",)
    corrections_on = ("M420 S1",)
    restores = "The file puts back limits and mesh at the end. When the run is cancelled: M501, or a reset."

    def planner(self, program: Program, machine: Machine, within: bool = False) -> MarlinPlanner:
        """Return the planner with the settings in force at each line of a program."""
        zeros = np.array([frame.base[3] for frame in program.frames])
        in_force = SettingsInForce.of(program, machine, settings_row(machine))
        return MarlinPlanner(machine, in_force, zeros, within)

    def cut(self, program: Program, machine: Machine) -> Program:
        """Cut a delta's lines by time."""
        return cut_moves(program, machine)

    def arc_chords(self, length: float, turn: float) -> int:
        """Return those of `plan_arc`."""
        return arc_chords(length, turn)

    def longest_part_s(self, machine: Machine) -> float:
        """Return PART_S on deltas."""
        return PART_S if on_delta(machine) else inf

    def shapers(self, machine: Machine) -> Collection[str]:
        """Return ZV, but on deltas, where Marlin has none."""
        return () if on_delta(machine) else super().shapers(machine)

    def assumed(self, machine: Machine) -> str:
        """Say which settings that matter are Marlin's defaults."""
        stated = () if machine.marlin is None else machine.marlin.stated
        corner = "junction_deviation_mm" if "junction_deviation_mm" in stated else "jerk_mm_per_s"
        matter = ("acceleration_mm_per_s2", "speed_mm_per_s", "retract_acceleration_mm_per_s2", corner)
        sentence = assumed_sentence("Marlin", stated, matter, "the printer's answer to M503")
        if machine.firmware_version[:3] > KNOWN and "junction_deviation_mm" not in stated:
            sentence = f"{sentence} {NEWER_JERK}".strip()
        return sentence

    def opening(self, machine: Machine, raised: SegmentLimits, file: FileLimits) -> list[bytes]:
        """Return M201 to M205 with the raised limits."""
        return limit_lines(MARLIN, raising(machine, raised, file.commands), file.unit_mm)

    def closing(self, machine: Machine, raised: SegmentLimits, file: FileLimits) -> list[bytes]:
        """Return M201 to M205 of the machine, then the file's own."""
        s = marlin_settings(machine)
        deviation_mm = s.junction_deviation_mm or LONGEST_DEVIATION_MM
        own = _commands(machine, raised.raised_axes, AxisLimits.of(s), {}, deviation_mm, s.shortest_segment_s)
        return limit_lines(MARLIN, [*own, *file.commands.values()], file.unit_mm)

    def segments(self, model: InverseModel) -> Segments:
        """Return segments that are long enough in steps, and timed by the queue."""
        return MarlinSegments.of(self, model)


def raising(machine: Machine, raised: SegmentLimits, commands: Mapping[str, LimitCommand]) -> list[LimitCommand]:
    """Return what raises the limits of the axes that may be raised; commands : the file's own in effect."""
    s, limits = marlin_settings(machine), AxisLimits.even(raised)
    # E's jerk, so that steps that come and go slow nothing: little enough for a retraction
    flicker = round(FLICKER_STEPS / (FLICKER_S * extruder_steps_per_mm(machine)), 2)
    limits = limits._replace(jerk=(*limits.jerk[:3], max(s.jerk_mm_per_s[3], flicker)))
    return _commands(machine, raised.raised_axes, limits, commands, LONGEST_DEVIATION_MM, 0.0)


def _commands(
    machine: Machine,
    axes: str,
    limits: AxisLimits,
    known: Mapping[str, LimitCommand],
    deviation_mm: float,
    shortest_s: float,
) -> list[LimitCommand]:
    """Return the commands that set limits of axes; those of the filament too where they are known, and so restored."""
    settings, delta = marlin_settings(machine), on_delta(machine)
    keys = {"M201": "acceleration_mm_per_s2", "M205": "jerk_mm_per_s"}
    in_file = {code for code in known if "E" in known[code].words}
    filament = {code for code, key in keys.items() if key in settings.stated or code in in_file}
    *others, jerk = limits.commands("M205", axes, axes if delta else axes.replace("Z", ""), filament)
    words = {"J": deviation_mm} if "junction_deviation_mm" in settings.stated else dict(jerk.words)
    if settings.slowdown and not delta:
        words["B"] = 1e6 * shortest_s
    return [*others, LimitCommand("M205", words)]


@dataclass(frozen=True, slots=True)
class MarlinSegments(Segments):
    """How Marlin executes our segments between the limits that the header raises."""

    settings: MarlinSettings
    row: FloatArray  # the machine's own settings (`marlin_queue`)
    steps: WholeSteps

    @classmethod
    def of(cls, firmware: Firmware, model: InverseModel) -> MarlinSegments:
        """Return those of a machine's inverse model."""
        machine, raised = model.machine, model.settings.output
        settings, row = marlin_settings(machine), settings_row(machine)
        free = np.array([axis in raised.raised_axes for axis in "XYZ"])
        steps = WholeSteps.of(model, row[STEPS][:3], free, settings.minimum_steps_per_segment)
        return cls(firmware, machine, raised, model.settings.segment_s, settings, row, steps)

    def count(self) -> FilamentCount:
        """Return a count without the flow factor."""
        return MarlinFilamentCount()

    def ends(
        self, at: FloatArray, points: FloatArray, e: FloatArray, kept: IntArray, pinned: BoolArray, inside: Inside
    ) -> tuple[IntArray, FloatArray, FloatArray, BoolArray]:
        """Choose ends at whole steps, far enough apart; where the filament turns back, a segment ends."""
        flow, pinned = np.diff(e), pinned.copy()
        pinned[1:-1] |= flow[1:] * flow[:-1] < 0.0
        pinned[[0, -1]] = True
        kept, due, placed = self.steps.ends(at, points, kept, pinned)
        within = inside(placed)
        due, placed = np.where(within, due, at[kept]), np.where(within[:, None], placed, points[kept])
        stays = at_most(due, placed, np.arange(len(kept)), pinned[kept], self.most_in_a_second)
        return kept[stays], due[stays], placed[stays], pinned[kept][stays]

    def rounded(self, points: FloatArray) -> FloatArray:
        """Return the ends of the file's own lines at whole steps."""
        return self.steps.nearest(points)

    def executed(self, points: FloatArray, e: FloatArray, fixed: BoolArray, ends: BoolArray) -> IntArray:
        """Leave out the ends of segments that Marlin would drop; where the filament turns back, one stays."""
        flow, rank = np.diff(e), fixed.astype(np.int64)
        rank[1:-1] += flow[1:] * flow[:-1] < 0.0
        rank[ends] = ALWAYS
        return _executed(np.rint(self.steps.motors(points)), rank, self.settings.minimum_steps_per_segment)

    def speeds(
        self, points: FloatArray, e: FloatArray, lasting: FloatArray, file: FileLimits, filament: Filament | None
    ) -> tuple[FloatArray, FloatArray, SegmentSpeeds]:
        """Return speeds that make Marlin's queue execute each segment in its time.

        Where it would cut a delta's line into parts too short, F is higher, and M203 limits the motors instead.
        """
        raised = raising(self.machine, self.raised, file.commands)
        row = reduce(row_after, [*file.commands.values(), *raised], self.row)
        motors = np.column_stack([self.steps.motors(points) / self.row[STEPS][:3], e])
        change = np.diff(np.rint(motors * self.row[STEPS]), axis=0) / self.row[STEPS]
        straight = np.linalg.norm(np.diff(points, axis=0), axis=1)
        by_motors = not (on_delta(self.machine) or self.machine.kinematics.shares_motors)
        steps = np.abs(change * self.row[STEPS])[:, :3].max(axis=1)
        mm = np.linalg.norm(change[:, :3], axis=1) if by_motors else straight
        # where the motors have fewer steps than it executes, Marlin counts the filament's length
        mm = np.where(steps < self.settings.minimum_steps_per_segment, np.abs(change[:, 3]), mm)
        way = np.maximum(np.where(mm > 0.0, mm, straight), 1e-6)
        meant, fastest = way / lasting, np.abs(change[:, :3]).max(axis=1) / way
        too_short = steps < lasting * self.settings.segments_per_second * (self.settings.minimum_steps_per_segment + 1)
        pace, uncut = meant.copy(), np.where(too_short, straight / self.longest_s, 0.0)
        lengths = np.full(len(mm), np.nan) if by_motors else straight
        settings = np.tile(row.astype(np.float32), (len(mm), 1))
        for sweep in range(SWEEPS + 1):
            feed = np.maximum(pace, uncut)
            most = np.where((pace < feed) & (fastest > 0.0), pace * fastest, inf)
            settings[:, SPEED][:, :3] = np.minimum(row[SPEED][:3], most[:, None])
            duration = self._durations(motors, lengths, feed, settings, filament)
            if sweep < SWEEPS:
                pace = np.clip(pace * np.where(duration > 0.0, duration / lasting, 1.0), meant, MOST_FASTER * meant)
        executed = np.where(duration > 0.0, duration, lasting)
        played = straight / executed
        junction = np.concatenate([[0.0], np.minimum(played[1:], played[:-1]), [0.0]])
        acceleration = np.full(len(mm), self.raised.acceleration_mm_per_s2)
        return feed, most, SegmentSpeeds(played, junction, acceleration, executed)

    def paced(self, motors_mm_per_s: float, unit_mm: float) -> list[bytes]:
        """Return M203 of the motors."""
        most = min(motors_mm_per_s, self.raised.velocity_mm_per_s)
        return limit_lines(MARLIN, [LimitCommand("M203", dict.fromkeys("XYZ", most))], unit_mm)

    def _durations(
        self, motors: FloatArray, length: FloatArray, feed: FloatArray, settings: Singles, filament: Filament | None
    ) -> FloatArray:
        segments = len(feed)
        if not segments:
            return np.zeros(0)
        if filament is not None:
            motors = np.vstack([motors, motors[-1] + [0.0, 0.0, 0.0, filament.mm]])
            length, feed = np.append(length, np.nan), np.append(feed, filament.mm_per_s)
            settings = np.vstack([settings, settings[-1:]])
        n = len(feed)
        start = np.full((n, 4), np.nan)
        start[0] = motors[0]
        nothing, rests = np.zeros(n), np.zeros(n, dtype=np.bool_)
        targets = Targets(start, motors[1:], length, feed, nothing, nothing, rests, settings)
        blocks = plan_blocks(targets, self.settings.minimum_steps_per_segment, False)
        return np.bincount(blocks.target, phases_of(blocks).duration, minlength=n)[:segments].astype(np.float64)

    @property
    def longest_s(self) -> float:
        """Return how long F may say that a segment lasts: a delta's lines that last longer Marlin cuts."""
        return WHOLE_S * 2.0 / self.settings.segments_per_second if on_delta(self.machine) else inf


class MarlinFilamentCount(FilamentCount):
    """How E counts within our blocks: Marlin multiplies each block's steps of filament by M221, and rounds again.

    So the factor is in our numbers, and M221 is 100 % as long as a block is open.
    """

    zero_mm = 0.0  # of the filament, where our E is zero

    def begin(self, frame: ModalState, e_mm: float, late_mm: float = 0.0) -> None:
        """Continue from the file's own E."""
        named = e_mm - late_mm
        zero_mm = frame.base[3] if frame.flow == 1.0 else named - _file_e_mm(frame, named)
        self.zero_mm = zero_mm + late_mm

    def frame(self, frame: ModalState) -> ModalState:
        """Return how numbers are written within a block."""
        return frame._replace(base=(*frame.base[:3], self.zero_mm), flow=1.0)

    def opening(self, frame: ModalState) -> list[bytes]:
        """Return the lines that take the file's factor out."""
        return [] if frame.flow == 1.0 else [b"M221 S100"]

    def naming(self, frame: ModalState, e_mm: float) -> list[bytes]:
        """Return the lines that give this position of the filament its name in the file."""
        if frame.flow == 1.0 and abs(self.zero_mm - frame.base[3]) < LEAST_E_MM:
            return []
        return [b"G92 E%.5f" % (_file_e_mm(frame, e_mm) / frame.unit_mm)]

    def closing(self, frame: ModalState, e_mm: float) -> list[bytes]:
        """Return the lines that restore the file's count and factor."""
        factor = [] if frame.flow == 1.0 else [b"M221 S%.6g" % (100.0 * frame.flow)]
        return [*self.naming(frame, e_mm), *factor]

    def set_by(self, line: bytes) -> str:
        """Return the command of a line that changes the count, G92 or M221; empty: another."""
        if b"92" not in line and b"221" not in line:
            return ""
        names = [command.name for command in commands(line, 0)[:1]]
        return names[0] if names and names[0] in ("G92", "M221") else ""


def _file_e_mm(frame: ModalState, e_mm: float) -> float:
    return (e_mm - frame.base[3]) / frame.flow


@kernel
def _executed(steps: FloatArray, rank: IntArray, minimum: int) -> IntArray:
    """Of two points too near each other, keep the one of higher rank, or the first."""
    n = len(steps)
    kept, count = np.zeros(n, dtype=np.int64), 1
    for k in range(1, n):
        away = np.abs(steps[k] - steps[kept[count - 1]]).max()
        while count > 1 and away < minimum and rank[k] > rank[kept[count - 1]]:
            count -= 1
            away = np.abs(steps[k] - steps[kept[count - 1]]).max()
        if rank[k] == ALWAYS or away >= minimum:
            kept[count] = k
            count += 1
    return kept[:count].copy()
