"""The firmware's own input shaper is off while our segments run, and afterwards as the firmware or the print had it."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest

from ffcomp.compensation.job import Job, Options
from ffcomp.importers.builder import build_draft, machine_text, read_printer_config
from gcode.embedded import OURS, original
from models.file import load_machine
from models.machine import Machine

SQUARE = "G1 X120 Y100 E1 F3000\nG1 X120 Y120 E1\n"
PRINT = f"G28\nG90\nM83\nG1 X100 Y100 Z0.2 F6000\n{SQUARE}M106 S9\nG1 X100 Y120 E1\nG1 X9 Y9 F6000\nM0\n; end\n"
KLIPPER_CFG = (
    "[printer]\nkinematics: corexy\nmax_velocity: 300\nmax_accel: 3000\n"
    "[input_shaper]\nshaper_freq_x: 58.4\nshaper_type_x: mzv\nshaper_freq_y: 43.8\n"
)
MARLIN_ANSWER = "M92 X80 Y80 Z400 E93\nM201 X500 Y500\nM203 X200 Y200\n"
CASES = {
    "klipper": (KLIPPER_CFG, ["SET_INPUT_SHAPER SHAPER_TYPE_X=mzv SHAPER_FREQ_X=58.4 SHAPER_FREQ_Y=43.8"]),
    "marlin": (f"{MARLIN_ANSWER}M593 X F40.00 D0.15\nM593 Y F36.50 D0.20\n", ["M593 X F40", "M593 Y F36.5"]),
    "reprapfirmware": ('M669 K1\nM593 P"ei2" F42.5 S0.1\n', ['M593 P"ei2" F42.5 S0.1']),
}
OFF = {
    "klipper": "SET_INPUT_SHAPER SHAPER_FREQ_X=0 SHAPER_FREQ_Y=0",
    "marlin": "M593 F0",
    "reprapfirmware": 'M593 P"none"',
}


def stated(folder: Path, text: str) -> list[str] | None:
    """What an import says of the shaper; None: it is not known."""
    file = folder / "printer.txt"
    file.write_text(text, encoding="utf-8")
    kind = "corexy" if text.startswith("M92") else None
    draft = build_draft(read_printer_config(file, kind), "mine")
    found = draft.values.get("firmware.input_shaper")
    assert found is None or f"input_shaper = {found.value!r}".replace("'", '"')[:20] in machine_text(draft, file)
    return None if found is None else found.value


def machine_with(*commands: str, flavor: str = "klipper") -> Machine:
    return replace(load_machine("voron-300"), flavor=flavor, input_shaper=commands)


def lines_of(machine: Machine, text: str = PRINT, **options: object) -> tuple[list[str], list[str]]:
    """The file's lines, ours without their mark, and all warnings."""
    job = Job(text.encode(), "print.gcode", machine, Options(predict=False, **options)).lines()
    out = b"".join(job)
    assert original(out) == text.encode()
    return out.decode().replace(OURS.decode(), "").splitlines(), [*job.value.shaper.warnings, *job.value.warnings]


def shaper_lines(lines: list[str]) -> list[str]:
    return [line for line in lines if re.match("SET_INPUT_SHAPER|M593", line)]


@pytest.mark.parametrize("flavor", CASES)
def test_the_imported_shaper_is_off_for_the_print_and_on_again_after_it(flavor: str, tmp_path: Path) -> None:
    text, on = CASES[flavor]
    assert stated(tmp_path, text) == on
    lines, warnings = lines_of(machine_with(*on, flavor=flavor))
    assert shaper_lines(lines) == [OFF[flavor], *on] and not warnings
    first = next(k for k, line in enumerate(lines) if line.startswith(";~"))
    last = max(k for k, line in enumerate(lines) if line.startswith("G1 "))
    assert lines.index(OFF[flavor]) < first and last < lines.index(on[0]) < lines.index("M0")
    kept, _ = lines_of(machine_with(*on, flavor=flavor), keep_shaper=True)
    assert shaper_lines(kept) == []
