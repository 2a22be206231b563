"""Where the firmware moves by itself: what is compensated all the same, and what is never written."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest

from ffcomp.compensation.job import Job, Options
from gcode.embedded import OURS, original
from models.file import load_machine
from models.machine import Machine
from validation.invariants import violations

SQUARE = "G1 X20 Y0 E1\nG1 X20 Y20 E1\nG1 X0 Y20 E1\nG1 X0 Y0 E1\n"
HEAD = "; gcode_flavor = klipper\nG90\nM83\nG28\nG1 X0 Y0 F6000\nG1 Z5\n"


def compensated(text: str, machine: Machine, **options: object) -> str:
    source = Job(text.encode(), "print.gcode", machine, Options(predict=False, flavor="klipper", **options))
    out = b"".join(source.lines())
    assert violations(text.encode(), out, machine, flavor="klipper") == []
    assert original(out) == text.encode()
    return out.decode()


def shifted(text: str) -> str:
    """The same in the middle of a bed whose origin is a corner."""
    return re.sub(r"([XY])(\d+)", lambda word: f"{word[1]}{int(word[2]) + 100}", text)


@pytest.mark.parametrize("name", ["voron-300", "flsun-qqs"])
def test_a_height_that_is_not_known_is_not_written(name: str) -> None:
    machine = load_machine(name)
    place = shifted if name == "voron-300" else str
    after = "MY_MACRO\n" + place("G1 X10 Y10\n" + SQUARE)
    lines = compensated(place(HEAD + SQUARE) + after + "G1 Z6\n" + place(SQUARE), machine).splitlines()
    begin = lines.index("MY_MACRO")
    end = lines.index(";~G1 Z6") if ";~G1 Z6" in lines else lines.index("G1 Z6")
    segments = [line for line in lines[begin:end] if line.startswith("G1 X")]
    assert len(segments) > 50
    assert not [line for line in segments if "Z" in line]
    assert [line for line in lines[end + 1 :] if line.startswith("G1") and "X" in line]


def test_after_a_macro_that_comes_back_the_place_is_stated_once() -> None:
    machine = replace(load_machine("voron-300"), returns=("MY_PHOTO",))
    lines = compensated(shifted(HEAD + SQUARE + "MY_PHOTO\n" + SQUARE), machine).splitlines()
    stated = [
        k for k, line in enumerate(lines) if re.fullmatch(rf"G1 X[\d.]+ Y[\d.]+ Z[\d.]+ F[\d.]+{OURS.decode()}", line)
    ]
    assert [lines[k].removesuffix(OURS.decode()) for k in stated] == ["G1 X100.0000 Y100.0000 Z5.0000 F6000.000"]
    assert stated[0] > lines.index("MY_PHOTO")
    assert "MY_PHOTO" in lines and not any(line == "G1 X120 Y100 E1" for line in lines)


def test_the_first_travel_after_homing_is_compensated_where_homing_ends_is_known() -> None:
    machine = load_machine("voron-300")
    known = replace(machine, homed_mm=(150.0, 150.0, 10.0))
    text = shifted(HEAD + SQUARE)
    assert "\nG1 X100 Y100 F6000\n" in compensated(text, machine), "it goes out as it was"
    started = compensated(text, known)
    assert "\n;~G1 X100 Y100 F6000\n" in started
    stated = f"\nG1 X150.0000 Y150.0000 Z10.0000 F6000.000{OURS.decode()}\n"
    assert started.index("\nG28\n") < started.index(stated) < started.index("SET_VELOCITY_LIMIT")
    far = replace(machine, homed_mm=(150.0, 150.0, 999.0))
    assert "\nG1 X100 Y100 F6000\n" in compensated(text, far), "out of reach: not planned from there"


def test_waits_are_written_and_counted() -> None:
    machine = load_machine("voron-300")
    text = ";TIME:10\n" + shifted(HEAD + SQUARE + "PAUSE\n" + SQUARE)
    job = Job(text.encode(), "print.gcode", machine, Options(predict=False, flavor="klipper")).lines()
    lines = b"".join(job).decode().splitlines()
    waits = [float(line.split()[1][1:]) / 1e3 for line in lines if re.fullmatch(r"G4 P\d+ ; ffcomp", line)]
    statistics = job.value.statistics
    assert len(waits) == statistics.settlings == 2
    assert sum(waits) == pytest.approx(statistics.settling_s) and 0.1 < waits[0] < 0.5
    assert f"G4 P{1e3 * waits[1]:.0f} ; ffcomp" in lines[lines.index("PAUSE") :]
    (told,) = (float(line.partition(":")[2]) for line in lines if line.startswith(";TIME:"))
    assert told == pytest.approx(statistics.print_time_s, abs=0.5)
    longer_s = statistics.print_time_s - statistics.original_print_time_s
    assert sum(waits) < longer_s < sum(waits) + 0.2
