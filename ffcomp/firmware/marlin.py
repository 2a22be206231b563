"""Marlin: a queue of blocks of whole motor steps (`marlin_planner`), and segments chosen for it (`marlin_segments`)."""

from __future__ import annotations

from collections.abc import Collection
from math import inf

from ffcomp.firmware.base import FileLimits, Firmware, Segments
from ffcomp.firmware.marlin_planner import MarlinPlanner, cut_moves, on_delta, planner_of
from ffcomp.firmware.marlin_segments import MarlinSegments, raising, restoring
from ffcomp.firmware.settings_in_force import assumed_sentence
from ffcomp.inverse.model import InverseModel
from ffcomp.planner.segment_timing import SegmentLimits
from gcode.dialect import MARLIN
from gcode.dialects import limit_lines
from gcode.program import Program
from models.machine import Machine

PART_S = 300.0  # a delta's lines are cut by time: a megabyte of slow text becomes millions of pieces
KNOWN = (2, 1, 2)  # the version whose planner this is
NEWER_JERK = (
    "The print is planned as Marlin 2.1.2 does. Later versions have another classic jerk: short programs took 16 % "
    "less to 9 % more time than planned."
)


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
        return planner_of(program, machine, within)

    def cut(self, program: Program, machine: Machine) -> Program:
        """Cut a delta's lines by time, and arcs by length and turn."""
        return cut_moves(program, machine)

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
        return limit_lines(MARLIN, restoring(machine, raised, file.commands), file.unit_mm)

    def segments(self, model: InverseModel) -> Segments:
        """Return segments that are long enough in steps, and timed by the queue."""
        return MarlinSegments.of(self, model)
