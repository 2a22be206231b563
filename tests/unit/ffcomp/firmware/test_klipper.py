"""The limits that Klipper and Kalico obey, by their version."""

from __future__ import annotations

from dataclasses import replace

import pytest

from ffcomp.firmware.base import FileLimits
from ffcomp.firmware.klipper import Klipper
from ffcomp.planner.segment_timing import SegmentLimits
from gcode.program import LimitCommand, MotionLimits
from models.file import load_machine


@pytest.mark.parametrize(("version", "known"), [((), True), ((0, 13, 0), True), ((2026, 6), True), ((2026, 7), False)])
def test_accel_to_decel_is_written_where_the_firmware_knows_it(version: tuple[int, ...], known: bool) -> None:
    machine = replace(load_machine("voron-300"), firmware_version=version)
    own = MotionLimits(accel_to_decel=700.0)
    file = FileLimits(MotionLimits(acceleration=1400.0), {"SET_VELOCITY_LIMIT": LimitCommand("", {}, own)})
    (opened,), (closed,) = (lines(machine, SegmentLimits(), file) for lines in (Klipper().opening, Klipper().closing))
    assert (b" ACCEL_TO_DECEL=100000" in opened) == (b" ACCEL_TO_DECEL=700" in closed) == known
    assert b"MINIMUM_CRUISE_RATIO=0" in opened and b" ACCEL=1400 " in closed and closed.endswith(b"\n")
