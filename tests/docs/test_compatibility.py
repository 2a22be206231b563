"""docs/COMPATIBILITY.md row by row: a small print for each, compensated, and what was seen of it."""

from __future__ import annotations

import re
from collections.abc import Callable
from itertools import pairwise
from math import dist
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ffcomp
from ffcomp.compensation.job import Job
from gcode.embedded import joined, original
from models.file import load_machine
from tests.support.compensated import plainly
from tests.support.docs_runner import ROOT

PAGE = ROOT / "docs" / "COMPATIBILITY.md"
MACHINE = ROOT / "docs" / "examples" / "corexy.toml"
START = "G28\nG90\nM83\nSET_VELOCITY_LIMIT ACCEL=3000\nG1 X50 Y50 Z.3 F9000\n"
STARTS = {
    "klipper": START,
    "marlin": START.replace("SET_VELOCITY_LIMIT ACCEL=3000", "M204 P3000 T3000"),
    "reprapfirmware": START.replace("SET_VELOCITY_LIMIT ACCEL=3000", "M204 P3000 T3000"),
}
SQUARE = "G1 X70 Y50 E.6 F6000\nG1 X70 Y70 E.6\nG1 X50 Y70 E.6\n"
OPENED = re.compile(rb"SET_VELOCITY_LIMIT .*ACCEL=100000|M204 .*100000")
CLOSED = re.compile(rb"SET_VELOCITY_LIMIT .*ACCEL=3000|M204 .*3000")
MOVE = re.compile(rb"G1 [XYE]")
WORD = re.compile(rb"([XYZEF])(-?[\d.]+)")
BACK = "G1 X50 Y50 Z.3 F9000\n"
TABLE_ROW = re.compile(r"^\| ([^|]+?) \| \*\*(works|with care|not)\*\* \|", re.MULTILINE)
CASES: dict[str, tuple[str, Callable[[], None]]] = {}


def row(feature: str, verdict: str) -> Callable[[Callable[[], None]], Callable[[], None]]:
    """Keep the check of a feature, and what the page says of it."""

    def keep(check: Callable[[], None]) -> Callable[[], None]:
        CASES[feature] = verdict, check
        return check

    return keep


class Done:
    """A print that has been compensated: the start, the lines given, and the way back."""

    def __init__(self, text: str, flavor: str = "klipper", **options: Any) -> None:
        data = (STARTS[flavor] + text).encode()
        job = Job(data, "print.gcode", load_machine(MACHINE), plainly(predict=False, flavor=flavor, **options))
        stream = job.lines()
        self.data = b"".join(joined(stream))
        self.lines = self.data.splitlines()
        self.share = stream.value.statistics.shares.path
        assert original(self.data) == data  # every line of it is still there

    def raised_at(self, index: int) -> bool:
        """Return whether the firmware's limits are raised when a line is reached."""
        raised = False
        for line in self.lines[:index]:
            raised = bool(OPENED.match(line)) or (raised and not CLOSED.match(line))
        return raised

    def rests_at(self, line: str) -> bool:
        """Return whether a line goes out once, at rest, within the file's own limits."""
        return self.lines.count(line.encode()) == 1 and not self.raised_at(self.lines.index(line.encode()))

    def returns_after(self, line: str) -> bool:
        """Return whether the first move after a line states where the nozzle belongs, before limits are raised."""
        begin = self.lines.index(line.encode()) + 1
        first = next(k for k in range(begin, len(self.lines)) if MOVE.match(self.lines[k]))
        return bool(re.match(rb"G1 X\S+ Y\S+ .*; ffcomp", self.lines[first])) and not self.raised_at(first)

    def segments(self) -> list[tuple[float, float]]:
        """Seconds and filament in mm of each segment that moves in X and Y."""
        words = {b"X": 0.0, b"Y": 0.0, b"F": 0.0}
        found, at = [], (0.0, 0.0)
        for line in self.lines:
            if MOVE.match(line):
                told = {k: float(v) for k, v in WORD.findall(line.partition(b";")[0])}
                words |= told
                to = words[b"X"], words[b"Y"]
                found.append((dist(at, to) / words[b"F"] * 60, told.get(b"E", 0.0)))
                at = to
        return [(seconds, filament) for seconds, filament in found if seconds > 0]


@row("pressure advance", "works")
def check_pressure_advance() -> None:
    lines = (
        ("SET_PRESSURE_ADVANCE ADVANCE=0.05", "klipper"),
        ("M900 K0.05", "marlin"),
        ("M572 D0 S0.05", "reprapfirmware"),
    )
    for line, flavor in lines:
        done = Done(f"{line}\n{SQUARE}", flavor)
        assert done.share == 1.0 and done.lines.count(line.encode()) == 1
        each = [(s, e / s, e) for s, e in done.segments() if e > 0]
        steep = [abs(b - a) / (0.5 * (s + t)) for (s, a, e), (t, b, f) in pairwise(each) if min(e, f) > 0.002]
        assert max(steep) < 1.15 * 3000 * 0.6 / 20  # the plan's: 3000 mm/s², 0.6 mm of filament on 20 mm


@row("bed mesh", "works")
def check_bed_mesh() -> None:
    for line, flavor in (("BED_MESH_PROFILE LOAD=default", "klipper"), ("G29", "marlin"), ("M420 S1", "marlin")):
        done = Done(f"{line}\n{BACK}{SQUARE}", flavor)
        assert done.share == 1.0 and done.rests_at(line)
        after = done.lines[done.lines.index(line.encode()) :]
        assert not any(b" Z" in each for each in after if MOVE.match(each) and not each.startswith(b"G1 X50 Y50"))


@row("skew correction", "works")
def check_skew() -> None:
    lines = (
        ("SKEW_PROFILE LOAD=mine", "klipper"),
        ("SET_SKEW XY=141.5,141.3,100", "klipper"),
        ("M852 I.001", "marlin"),
    )
    for line, flavor in lines:
        done = Done(f"{SQUARE}{line}\nG1 X50 Y50 E.6\n", flavor)
        assert done.share == 1.0 and done.rests_at(line)


@row("arcs (G2, G3)", "works")
def check_arcs() -> None:
    for flavor in STARTS:
        done = Done("G2 X70 Y50 I10 J0 E1 F6000\nG3 X50 Y50 R10 E1\n", flavor)
        assert done.share == 1.0 and not any(line.startswith((b"G2 ", b"G3 ")) for line in done.lines)


@row("exclude object", "works")
def check_exclude_object() -> None:
    for begin, end, flavor in (
        ("EXCLUDE_OBJECT_START NAME=a", "EXCLUDE_OBJECT_END NAME=a", "klipper"),
        ("M486 S0", "M486 S-1", "marlin"),
        ("M486 S0", "M486 S-1", "reprapfirmware"),
    ):
        done = Done(f"{begin}\n{SQUARE}{end}\nG1 X150 Y150 F9000\nG1 X160 Y150 E1 F6000\n", flavor)
        assert done.share == 1.0
        assert all(done.rests_at(line) and done.returns_after(line) for line in (begin, end))


@row("adaptive mesh", "works")
def check_adaptive_mesh() -> None:
    define = "EXCLUDE_OBJECT_DEFINE NAME=a CENTER=60,60 POLYGON=[[50,50],[70,50],[70,70],[50,70]]"
    done = Done(f"{define}\nBED_MESH_CALIBRATE ADAPTIVE=1\n{BACK}{SQUARE}")
    assert done.share == 1.0 and done.rests_at("BED_MESH_CALIBRATE ADAPTIVE=1") and define.encode() in done.lines


@row("timelapse", "works")
def check_timelapse() -> None:
    done = Done(f"{SQUARE}TIMELAPSE_TAKE_FRAME\n{SQUARE}")
    assert done.share == 1.0 and done.rests_at("TIMELAPSE_TAKE_FRAME") and done.returns_after("TIMELAPSE_TAKE_FRAME")


@row("filament change, pause in the file", "works")
def check_filament_change() -> None:
    for line, flavor in (("M600", "klipper"), ("PAUSE", "klipper"), ("M600", "marlin"), ("M600", "reprapfirmware")):
        done = Done(f"{SQUARE}{line}\n{SQUARE}", flavor)
        assert done.share == 1.0 and done.rests_at(line) and done.returns_after(line)


@row("pause, resume, cancel at the screen", "with care")
def check_pause_at_the_screen() -> None:
    done = Done(SQUARE)
    inside = [k for k, line in enumerate(done.lines) if MOVE.match(line) and b" E" in line]
    assert all(done.raised_at(k) for k in inside)  # that is what the macro must set back


@row("several tools or materials", "with care")
def check_tools() -> None:
    for flavor in STARTS:
        done = Done(f"{SQUARE}T1\nG1 E2 F1800\n{BACK}{SQUARE}", flavor)
        assert done.rests_at("T1") and 0.8 < done.share < 0.9  # the travel from an unknown place goes out as it was


@row("firmware retraction (G10, G11)", "works")
def check_firmware_retraction() -> None:
    for flavor in STARTS:
        done = Done(f"{SQUARE}G10\nG1 X100 Y100 F9000\nG11\n{SQUARE}", flavor)
        assert done.share == 1.0 and done.rests_at("G10") and done.rests_at("G11")


@row("firmware's input shaper", "not")
def check_input_shaper() -> None:
    assert b"SET_INPUT_SHAPER SHAPER_FREQ_X=0" in Done(SQUARE, keep_shaper=False).data
    assert b"M593" in Done(SQUARE, "marlin", keep_shaper=False).data
    assert b"SHAPER" not in Done(SQUARE).data  # what cannot be switched on again is not switched off unasked


@row("speed factor at the screen", "not")
def check_speed_factor(folder: Path = Path()) -> None:
    error = []
    for factor in (1.0, 1.2):
        file = folder / "sped.gcode"
        file.write_bytes(sped(Done(SQUARE).data, factor))
        error.append(off_the_square_um(ffcomp.simulate(file, MACHINE).nozzle_mm))
    assert error[1] > 3 * error[0]


def sped(data: bytes, factor: float) -> bytes:
    return re.sub(rb"(G1 [XYE].*F)([\d.]+)", lambda word: word[1] + b"%.3f" % (factor * float(word[2])), data)


def off_the_square_um(nozzle_mm: Any) -> float:
    """Return the largest distance from the square's three sides, µm."""
    x, y = nozzle_mm[:, 0], nozzle_mm[:, 1]
    first = np.hypot(x - np.clip(x, 50, 70), y - 50)
    second = np.hypot(x - 70, y - np.clip(y, 50, 70))
    third = np.hypot(x - np.clip(x, 50, 70), y - 70)
    return 1e3 * float(np.minimum(np.minimum(first, second), third).max())


@row("power-loss recovery", "not")
def check_power_loss_recovery() -> None:
    done = Done(f"M413 S1\n{SQUARE}", "marlin")
    middle = len(done.lines) // 2
    assert done.raised_at(middle) and not any(OPENED.match(line) for line in done.lines[middle:])


def test_the_page_has_these_rows() -> None:
    found = dict(TABLE_ROW.findall(PAGE.read_text(encoding="utf-8")))
    assert found == {feature: verdict for feature, (verdict, _) in CASES.items()}


@pytest.mark.parametrize("feature", CASES)
def test_row(feature: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    CASES[feature][1]()
