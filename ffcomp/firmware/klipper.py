"""Klipper and Kalico: the look-ahead of `ffcomp.planner.lookahead`, and limits in one command."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from ffcomp.firmware.base import FileLimits, Firmware, Planner, machine_limits
from ffcomp.planner.limits import planner_limits
from ffcomp.planner.lookahead import plan_moves
from ffcomp.planner.segment_timing import SegmentLimits
from gcode.dialect import KLIPPER
from gcode.dialects import close_limits, open_limits
from gcode.program import MotionLimits, Program
from models.machine import Machine


class Klipper(Firmware):
    """Plans lines of mm with a look-ahead that sees the whole print; executes segments exactly."""

    flavor = KLIPPER
    quicker_note = ""  # its own rules of corners

    def planner(self, program: Program, machine: Machine, within: bool = False) -> Planner:
        """Return the planner; the moves carry the rules in force."""
        return partial(plan_moves, limits=planner_limits(machine))

    def opening(self, machine: Machine, raised: SegmentLimits, file: FileLimits) -> list[bytes]:
        """Return SET_VELOCITY_LIMIT with the raised limits."""
        velocity, acceleration = raised.velocity_mm_per_s, raised.acceleration_mm_per_s2
        return open_limits(KLIPPER, velocity, acceleration, raised.square_corner_velocity_mm_per_s)

    def closing(self, machine: Machine, raised: SegmentLimits, file: FileLimits) -> list[bytes]:
        """Return SET_VELOCITY_LIMIT with the limits of the last move."""
        after = [command.after for command in file.commands.values()] or [MotionLimits()]
        stated = replace(file.at_move, accel_to_decel=after[-1].accel_to_decel)
        return close_limits(KLIPPER, _first_known(stated, machine_limits(machine)))


def _first_known(file: MotionLimits, machine: MotionLimits) -> MotionLimits:
    """Return the file's limits, and the machine's where the file has set none."""
    pairs = ((getattr(file, name), getattr(machine, name)) for name in MotionLimits.__dataclass_fields__)
    return MotionLimits(*(mine if theirs != theirs else theirs for theirs, mine in pairs))
