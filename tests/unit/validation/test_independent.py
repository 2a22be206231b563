"""The independent checks find nothing wrong with what ffcomp writes, and find what is broken on purpose."""

from __future__ import annotations

import ast
import tomllib
from pathlib import Path

import numpy as np
import pytest

from models.file import load_machine, machine_paths
from tests.support.compensated import compensated
from validation.independent import checks, clock, reader
from validation.independent.checks import Printer, Report, check, printer_of
from validation.independent.kalico import late_and_stops
from validation.independent.play import contour

PRINT = b"""; a print
M83
G90
M104 S200
SET_VELOCITY_LIMIT ACCEL=3000
G28
G1 X100 Y100 Z0.2 F6000
;LAYER:0
M106 S128
G1 X130 Y100 E1.2 F4800
G1 X130 Y112 E.5
M117 half way
G1 X100 Y112 E1.2
SET_PRESSURE_ADVANCE ADVANCE=0.04
G1 X100 Y100 E.5
G1 E-.8 F2400
M107
G1 X90 Y90 F9000
M104 S0
"""
NAME = "voron-300"
LIMITS = reader.Limits(300.0, 3000.0, 5.0, 0.0)


@pytest.fixture(scope="module")
def machine() -> dict[str, dict[str, object]]:
    return tomllib.loads(machine_paths()[NAME].read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def printer(machine: dict[str, dict[str, object]]) -> Printer:
    return printer_of(machine)


@pytest.fixture(scope="module")
def result() -> bytes:
    return compensated(PRINT, load_machine(NAME), flavor="klipper", predict=False)[0]


def of(printer: Printer, after: bytes) -> Report:
    return check(PRINT, after, printer)


def test_nothing_is_wrong_with_what_ffcomp_writes(result: bytes, printer: Printer) -> None:
    report = of(printer, result)
    assert report.wrong == []
    assert report.numbers["share_path"] == 1.0
    assert report.numbers["segments"] > 50  # type: ignore[operator]
    assert report.numbers["line_filament_mm"] == pytest.approx(0.0, abs=5e-3)


@pytest.mark.parametrize("line", [b";~G1 X130 Y112 E.5\n", b"M106 S128\n", b"; a print\n"])
def test_a_lost_line_is_found(result: bytes, printer: Printer, line: bytes) -> None:
    assert result.count(line) == 1
    assert any("is not there" in wrong for wrong in of(printer, result.replace(line, b"")).wrong)


def test_other_filament_is_found(result: bytes, printer: Printer) -> None:
    lines = result.splitlines(keepends=True)
    k = next(i for i, line in enumerate(lines) if line.startswith(b"G1 X") and b" E." in line)
    lines[k] = lines[k].replace(b" E.", b" E.1", 1)
    wrong = of(printer, b"".join(lines)).wrong
    assert any("in all" in each for each in wrong)
    assert any("another filament" in each for each in wrong)


def test_a_command_that_has_moved_is_found(result: bytes, printer: Printer) -> None:
    lines = result.splitlines(keepends=True)
    k = lines.index(b"M117 half way\n")
    command = lines.pop(k)
    lines.insert(k - 12, command)
    wrong = of(printer, b"".join(lines)).wrong
    assert any("another filament" in each and "M117" in each for each in wrong)


def test_lines_in_another_order_are_found(result: bytes, printer: Printer) -> None:
    swapped = result.replace(b"M104 S200\n", b"").replace(b"M107\n", b"M107\nM104 S200\n")
    assert any("is not there" in wrong for wrong in of(printer, swapped).wrong)


def test_a_line_from_nowhere_is_found(result: bytes, printer: Printer) -> None:
    strange = result.replace(b"M107\n", b"M107\nM106 S255\n")
    assert any("neither the original's" in wrong for wrong in of(printer, strange).wrong)


def test_a_segment_out_of_reach_is_found(result: bytes, printer: Printer) -> None:
    lines = result.splitlines(keepends=True)
    k = next(i for i, line in enumerate(lines) if line.startswith(b"G1 X12"))
    lines.insert(k, b"G1 X399 Y100\n")
    assert any("out of reach" in wrong for wrong in of(printer, b"".join(lines)).wrong)


def test_the_nozzle_comes_closer_to_the_path(
    result: bytes, machine: dict[str, dict[str, object]], printer: Printer
) -> None:
    found = contour(PRINT, result, machine, printer)
    before, after = found["judged_contour_um"], found["judged_contour_compensated_um"]
    assert before is not None and after is not None
    assert after < 0.2 * before


@pytest.mark.parametrize(
    ("text", "end"),
    [
        (b"G91\nG1 X3\nG1 X4 E1\n", (7.0, 0.0, 0.0, 1.0)),
        (b"G92 X10 E5\nG1 X12 E6\n", (2.0, 0.0, 0.0, 1.0)),
        (b"G20\nG1 Y1\n", (0.0, 25.4, 0.0, 0.0)),
        (b"M221 S50\nM83\nG1 X1 E2\n", (1.0, 0.0, 0.0, 1.0)),
        (b"G1 X10\nG2 X20 I5 J0\n", (20.0, 0.0, 0.0, 0.0)),
        (b"SAVE_GCODE_STATE NAME=a\nG91\nRESTORE_GCODE_STATE NAME=a\nG1 X1\nG1 X1.5\n", (1.5, 0.0, 0.0, 0.0)),
    ],
)
def test_what_a_file_means(text: bytes, end: tuple[float, ...]) -> None:
    assert reader.read(text, LIMITS).end[-1] == pytest.approx(end)


def test_a_host_that_is_late_and_stops_is_found(result: bytes, printer: Printer) -> None:
    written = reader.read(result, printer.limits)
    played = clock.times(written, printer.own)
    which = np.flatnonzero(np.linalg.norm(written.step[:, :3], axis=1) > 0)
    host = np.zeros((len(which), 13))
    host[:, 0], host[:, 2] = played.begin_s[which], played.lasts_s[which]
    host[:, 7:10] = written.step[which, :3] / played.length[which, None]
    host[:, 10], host[:, 11] = played.start_v[which], played.cruise_v[which]
    kept = late_and_stops(result, written, printer, which, host)
    host[40:, 0] += 0.01
    host[40, 2] += 0.01
    host[60, 10] = 0.0
    broken = late_and_stops(result, written, printer, which, host)
    assert kept["stops"] == 0
    assert broken["late_s"] > kept["late_s"]  # type: ignore[operator]
    assert broken["stops"] > 0  # type: ignore[operator]


def test_no_code_of_the_compensator_is_used() -> None:
    for path in Path(checks.__file__).parent.glob("*.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        names = [n.module or "" for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)]
        names += [alias.name for n in ast.walk(tree) if isinstance(n, ast.Import) for alias in n.names]
        assert not {name.partition(".")[0] for name in names} & {"ffcomp", "gcode", "models"}, path.name


def test_a_path_that_is_cut_short_is_found(result: bytes, printer: Printer) -> None:
    lines = result.splitlines(keepends=True)
    first, last = lines.index(b";~G1 X130 Y112 E.5\n"), lines.index(b"M117 half way\n")
    kept = [line for line in lines[first - 12 : last + 12] if not line.startswith(b"G1 ")]
    cut = b"".join([*lines[: first - 12], *kept, *lines[last + 12 :]])
    assert any("never comes" in wrong for wrong in of(printer, cut).wrong)
