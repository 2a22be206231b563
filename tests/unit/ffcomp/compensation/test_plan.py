"""What a print takes, and what of it is compensated."""

from __future__ import annotations

import re

import pytest

from ffcomp.compensation.statistics import Amount, Place, Shares, of_raw
from ffcomp.numerics.serialise import to_json
from gcode.reader import read_program
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


# ---- statistics ----


HOME = (0.0, 0.0, 5.0)


def test_parts_add_up_by_place_and_command() -> None:
    text = "M83\nG1 X10 E1 F600\nMACRO_A\nG1 X20 E1\nG1 Y5\nMACRO_B\nG1 X0 Y0 E9\nMACRO_A\nG1 X5 Y5\n"
    events = read_program(text.encode(), start=HOME).events
    first, second = of_raw(events[:3], {}).shares, of_raw(events[3:], {}).shares
    shares = Shares(Amount(10.0, 1.0)) + first + second
    lost = {place: (part.path_mm, part.filament_mm) for place, part in shares.left.items()}
    way = 5.0**2 * 17  # 20, 5 and back to 0, 0
    assert lost[Place(3, "MACRO_A")] == pytest.approx((15.0, 1.0))
    assert lost[Place(8, "MACRO_A")] == pytest.approx((50.0**0.5, 0.0))
    assert lost[Place(6, "MACRO_B")] == pytest.approx((way**0.5, 9.0))
    told = {each["command"]: each for each in to_json(shares.by_cause)}
    assert (told["MACRO_A"]["line"], told["MACRO_A"]["places"], told["MACRO_A"]["worst_line"]) == (3, 2, 3)
    assert told["MACRO_A"]["path_mm"] == pytest.approx(15.0 + 50.0**0.5)
    assert shares.filament == pytest.approx(1 / 11)
    assert shares.path == pytest.approx(10 / (25 + 50**0.5 + way**0.5))
