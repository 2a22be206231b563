"""Klipper and Kalico: the look-ahead of `ffcomp.planner.lookahead`, and limits in one command."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from math import isnan

from ffcomp.firmware.base import FileLimits, Firmware, Planner
from ffcomp.planner.limits import planner_limits
from ffcomp.planner.lookahead import plan_moves
from ffcomp.planner.segment_timing import SegmentLimits
from gcode.dialect import KLIPPER
from gcode.dialects import limit_number
from gcode.program import MotionLimits, Program
from models.machine import Machine

HIGHEST_CRUISE_RATIO = 0.999  # the largest with three decimals; Klipper rejects 1
CRUISE_RATIO_ALONE = (2026, 7)  # Kalico since then has no ACCEL_TO_DECEL
RESTORE = "FFCOMP_RESTORE"

MACRO = f"""\
[gcode_macro {RESTORE}]
description: Put back what a recording of ffcomp changes. Call it in CANCEL_PRINT as well.
gcode:
    {{% set own = printer.configfile.settings %}}
    SET_VELOCITY_LIMIT VELOCITY={{own.printer.max_velocity}} ACCEL={{own.printer.max_accel}}
    SET_VELOCITY_LIMIT SQUARE_CORNER_VELOCITY={{own.printer.square_corner_velocity}}
    {{% set decel = own.printer.max_accel_to_decel|default(own.printer.max_accel) %}}
    SET_VELOCITY_LIMIT MINIMUM_CRUISE_RATIO={{own.printer.minimum_cruise_ratio|default(0)}} ACCEL_TO_DECEL={{decel}}
    {{% if own.input_shaper is defined %}}
    SET_INPUT_SHAPER SHAPER_FREQ_X={{own.input_shaper.shaper_freq_x}} SHAPER_FREQ_Y={{own.input_shaper.shaper_freq_y}}
    {{% endif %}}
    {{% if printer.bed_mesh is defined and 'default' in printer.bed_mesh.profiles %}}
    BED_MESH_PROFILE LOAD=default
    {{% endif %}}
"""


class Klipper(Firmware):
    """Plans lines of mm with a look-ahead that sees the whole print; executes segments exactly."""

    flavor = KLIPPER
    quicker_note = ""  # its own rules of corners
    usual_chips = ("adxl345",)
    captures_at = "from the temporary folder of the printer's host"
    corrections_off = ("BED_MESH_CLEAR", "SET_SKEW CLEAR=1")
    restore_call = (RESTORE,)
    restore_macro = ("", *MACRO.splitlines())
    restores = (
        f"The file puts back its limits after every experiment, and calls {RESTORE} at the end. That macro, printed at "
        "the head of the file, belongs into printer.cfg: it puts back limits, shaper and bed mesh as printer.cfg "
        "states them, and does so for a cancelled run too where CANCEL_PRINT calls it. Without it: RESTART."
    )

    def capture(self, chips: Sequence[str], name: str, lasting_s: float) -> tuple[list[str], list[str]]:
        """Return ACCELEROMETER_MEASURE for each chip, which begins and ends a capture."""
        measure = [f"ACCELEROMETER_MEASURE CHIP={chip} NAME={name}" for chip in chips]
        return measure, measure

    def planner(self, program: Program, machine: Machine, within: bool = False) -> Planner:
        """Return the planner; the moves carry the rules in force."""
        return partial(plan_moves, limits=planner_limits(machine))

    def opening(self, machine: Machine, raised: SegmentLimits, file: FileLimits) -> list[bytes]:
        """Return SET_VELOCITY_LIMIT with the raised limits."""
        v, a, corner = raised.velocity_mm_per_s, raised.acceleration_mm_per_s2, raised.square_corner_velocity_mm_per_s
        return _velocity_limit(machine, MotionLimits(v, a, corner, 0.0))

    def closing(self, machine: Machine, raised: SegmentLimits, file: FileLimits) -> list[bytes]:
        """Return SET_VELOCITY_LIMIT with the limits of the last move."""
        after = [command.after for command in file.commands.values()] or [MotionLimits()]
        own, stated = machine.limits, replace(file.at_move, accel_to_decel=after[-1].accel_to_decel)
        v, a, corner = own.velocity_mm_per_s, own.acceleration_mm_per_s2, own.square_corner_velocity_mm_per_s
        return _velocity_limit(machine, _first_known(stated, MotionLimits(v, a, corner, 0.5)))


def _velocity_limit(machine: Machine, limits: MotionLimits) -> list[bytes]:
    """Return the command that sets the nozzle's limits; Z has further ones, which only the configuration sets."""
    ratio = min(limits.minimum_cruise_ratio, HIGHEST_CRUISE_RATIO)
    fields = {
        "VELOCITY": limits.velocity,
        "ACCEL": limits.acceleration,
        "SQUARE_CORNER_VELOCITY": limits.square_corner_velocity,
        "MINIMUM_CRUISE_RATIO": ratio,
    }
    if machine.firmware_version < CRUISE_RATIO_ALONE:  # older ones use this instead of the ratio
        by_ratio = limits.acceleration * (1.0 - ratio)
        fields["ACCEL_TO_DECEL"] = by_ratio if isnan(limits.accel_to_decel) else limits.accel_to_decel
    text = "".join(f" {key}={limit_number(value)}" for key, value in fields.items() if not isnan(value))
    return [f"SET_VELOCITY_LIMIT{text}".encode()] if text else []


def _first_known(file: MotionLimits, machine: MotionLimits) -> MotionLimits:
    """Return the file's limits, and the machine's where the file has set none."""
    pairs = ((getattr(file, name), getattr(machine, name)) for name in MotionLimits.__dataclass_fields__)
    return MotionLimits(*(mine if theirs != theirs else theirs for theirs, mine in pairs))
