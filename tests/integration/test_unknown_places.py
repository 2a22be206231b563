"""Where the firmware moves by itself: what is compensated all the same, and what is never written."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ffcomp.compensation.job import Job
from ffcomp.firmware.program import known_to_the_firmware
from ffcomp.importers.builder import build_draft, machine_text, read_printer_config
from ffcomp.metrics import contour_error
from ffcomp.simulation.preview import preview
from gcode.embedded import OURS, original
from gcode.reader import read_program
from models.file import load_machine
from models.machine import Machine
from tests.support.cli import ffcomp
from tests.support.compensated import plainly
from validation.invariants import told_apart, violations

SQUARE = "G1 X20 Y0 E1\nG1 X20 Y20 E1\nG1 X0 Y20 E1\nG1 X0 Y0 E1\n"
HEAD = "; gcode_flavor = klipper\nG90\nM83\nG28\nG1 X0 Y0 F6000\nG1 Z5\n"


def compensated(text: str, machine: Machine, **options: object) -> str:
    source = Job(text.encode(), "print.gcode", machine, plainly(predict=False, flavor="klipper", **options))
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


@pytest.mark.parametrize("homing", [None, "[gcode_macro G28]\nrename_existing: G28.1\ngcode:\n  G28.1\n  G1 Z10\n", ""])
def test_no_line_of_ours_states_a_place_after_homing(tmp_path: Path, homing: str | None) -> None:
    """Whether or not a configuration could be read whole: its endstops are not where its macros leave the nozzle."""
    ends = "".join(
        f"[stepper_{axis}]\nrotation_distance: 40\nmicrosteps: 16\nposition_endstop: 0\nposition_max: 220\n"
        for axis in "xyz"
    )
    shaper = "[input_shaper]\nshaper_freq_x: 55\nshaper_freq_y: 40\n"
    printer = "[printer]\nkinematics: cartesian\nmax_velocity: 300\nmax_accel: 3000\n"
    config, path = tmp_path / "printer.cfg", tmp_path / "mine.toml"
    config.write_text("[include homing.cfg]\n" + printer + ends + shaper, encoding="utf-8")
    if homing is not None:
        (tmp_path / "homing.cfg").write_text(homing, encoding="utf-8")
    path.write_text(machine_text(build_draft(read_printer_config(config), "mine"), config), encoding="utf-8")
    text = "; gcode_flavor = klipper\nG28\nG90\nM83\nG1 X100 Y100 Z0.2 F6000\nG1 X120 Y100 E1 F3000\nG1 X120 Y120 E1\n"
    lines = compensated(text, load_machine(str(path))).splitlines()
    travel = lines.index("G1 X100 Y100 Z0.2 F6000")
    assert not [line for line in lines[:travel] if line.startswith("G1")], "the firmware drives there by itself"
    assert "Z" not in "".join(line for line in lines[travel + 1 :] if line.startswith("G1"))


ELSEWHERE = """G28
G90
M83
G1 X0 Y0 Z0.2 F6000
G1 X10 Y0 E1 F3000
G1 E-.8 F1800
{unknown}
G1 X50 Y50 F9000
G1 E.8 F1800
G1 X70 Y50 E1 F3000
G1 X70 Y70 E1
"""
ONE_MORE = "G1 E-.8 F1800\nG1 X60 Y70 F9000\n"


@pytest.mark.parametrize(("unknown", "more"), [("T1", ""), ("G28", ONE_MORE), ("MY_MACRO", 2 * ELSEWHERE)])
@pytest.mark.parametrize(
    ("name", "flavor"), [("voron-300", "klipper"), ("ender-3", "marlin"), ("kossel", "reprapfirmware")]
)
def test_what_follows_an_unknown_place_begins_where_the_nozzle_is(
    name: str, flavor: str, unknown: str, more: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Wherever a chunk ends: the plant of the chunk after it must not ring from the place before."""
    machine = load_machine(name)
    place = str if name == "kossel" else shifted
    data = place((ELSEWHERE + more).format(unknown=unknown)).encode()
    for longest_s in (300.0, 0.3):
        monkeypatch.setattr("ffcomp.compensation.chunks.LONGEST_S", longest_s)
        stream = Job(data, "print.gcode", machine, plainly(predict=False, flavor=flavor)).lines()
        out = b"".join(stream)
        assert violations(data, out, machine, flavor=flavor) == []
        assert farthest_mm(data, out, machine, flavor) < 0.035
        numbers = stream.value.statistics
        longer_s = numbers.print_time_s - numbers.original_print_time_s
        assert not numbers.slowed and longer_s < 0.06
        seen = preview(out, "print.gcode", machine)
        assert seen.after.track.contour_rms_um < 0.5 * seen.before.track.contour_rms_um < 50.0


def farthest_mm(data: bytes, out: bytes, machine: Machine, flavor: str) -> float:
    """How far the segments' ends are from the sliced path at most."""
    known = known_to_the_firmware(machine)
    sliced, written = (read_program(text, flavor=flavor, **known).moves for text in (data, out))
    own = np.isin(written.line, told_apart(out.splitlines(keepends=True)).segments)
    corners = np.stack([sliced.start[:, :3], sliced.end[:, :3]], axis=1).reshape(-1, 3)
    connected = np.full(len(corners) - 1, True)
    connected[1::2] = (sliced.start[1:, :3] == sliced.end[:-1, :3]).all(axis=1)
    t = np.concatenate([[0.0], np.cumsum(np.where(connected, 0.0, 1.0))])  # a jump is never within the window
    ends = written.end[own, :3]
    parts = [contour_error(t, corners, np.full(len(ends), at), ends, 0.1) for at in np.unique(t)]
    return float(np.min(parts, axis=0).max())


# ---- own shaper ----


SQUARE_OWN_SHAPER = "G1 X120 Y100 E1 F3000\nG1 X120 Y120 E1\n"
PRINT = (
    f"G28\nG90\nM83\nG1 X100 Y100 Z0.2 F6000\n{SQUARE_OWN_SHAPER}M106 S9\nG1 X100 Y120 E1\nG1 X9 Y9 F6000\nM0\n; end\n"
)
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
    job = Job(text.encode(), "print.gcode", machine, plainly(predict=False, **options)).lines()
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


NO_HOME = HEAD.replace("G28\n", "G1 X20 E1 F6000\n") + SQUARE


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (HEAD + SQUARE + "MY_MACRO\n" + SQUARE, '[macros] returns = ["MY_MACRO"]'),
        (HEAD + SQUARE + "G29\nG1 Y20 E1\n" + SQUARE, "after G29 in line 11 the place of the nozzle is unknown"),
        (NO_HOME, "the file does not say where the nozzle begins"),
        (HEAD + SQUARE + "G0 X0 Y-190\nG0 X0 Y0\n" + SQUARE, "moves lie outside the print volume"),
    ],
)
def test_the_print_says_why_a_part_is_not_compensated(text: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "a.gcode").write_text(text)
    words = "compensate a.gcode -m flsun-qqs --no-predict --flavor klipper --offset-mm 0,0"
    answer = ffcomp(*words.split(), cwd=tmp_path)
    assert answer.exit_code == 0 and said in " ".join(answer.stdout.split()), answer.output
