"""What a job does before the first move: firmware and offset."""

from __future__ import annotations

import re

import pytest

from models.file import load_machine
from tests.support.compensated import job


def test_changes_of_filament_take_what_the_slicer_says() -> None:
    """A print of an AMS of 2 h 4 min said 1 h 3 min: its 68 changes took no time."""
    square = "G1 X0 Y0 Z5 F6000\nG1 X20 Y0 E1\nG1 X20 Y20 E1\nG1 X0 Y0 E1\n"
    settings = "; machine_load_filament_time = 25\n; machine_unload_filament_time = 29\n"
    text = f"M73 P0 R9\nM83\nG28\nT0\n{square}T1\n{square}T1\nT255\nM73 P50 R5\nT0\n{square}{settings}"
    lines = job(text.encode(), load_machine("mp-delta-pro"), flavor="marlin", predict=False).lines()
    written = b"".join(lines).decode()
    numbers = lines.value.statistics
    assert 108.0 < numbers.original_print_time_s < 118.0
    assert numbers.print_time_s == pytest.approx(numbers.original_print_time_s, abs=2.0)
    assert re.findall(r"^M73 .*", written, re.MULTILINE) == ["M73 P0 R2", "M73 P50 R1"]
