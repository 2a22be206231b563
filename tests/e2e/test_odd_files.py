"""docs/DIALECTS.md, and files that end, break or repeat in odd ways."""

from __future__ import annotations

from pathlib import Path

import pytest

from ffcomp.compensation.gcode_writer import STILL_MOVE
from ffcomp.compensation.job import Job
from ffcomp.errors import NothingToDo
from gcode.container import read_bytes
from gcode.embedded import original
from gcode.errors import GcodeError, UnsupportedGcode
from gcode.program import Program
from gcode.reader import read_program
from models.file import load_machine
from scripts.pages import dialects
from tests.fuzz.test_random_programs import compensated, inverter
from tests.support.compensated import plainly
from tests.support.data import ROOT
from validation.invariants import violations

START = dialects.START


def test_a_refusal_names_the_line_and_the_rule() -> None:
    for code, flavor, outcome in dialects.rows(dialects.PAGE.read_text(encoding="utf-8")):
        if outcome == "refused":
            with pytest.raises(GcodeError) as caught:
                read_program((START + code).encode(), "print.gcode", flavor=flavor)
            assert caught.value.line == (START + code).count("\n") + 1
            assert str(caught.value).startswith("print.gcode:") and caught.value.rule.endswith(".")


# -- how lines end --

BODY = START + "G1 X20 Y10 E.4\n;LAYER:1\nG1 X20 Y20 E.4\n"
ENDS = ["M107", "G1 X15 E.1", "G28", ";end", "G1 E-1", "M400\n\n", "M117 a\n\n\n", "G4 P1", "G1 F100", ""]


@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r", "\r\r\n"])
def test_every_way_to_end_a_line_and_a_file(newline: str) -> None:
    for end in ENDS:
        data = (BODY + end).replace("\n", newline).encode()
        out = compensated(data, inverter())
        assert violations(data, out, inverter().machine) == [], end
        assert out.count(b"; Processed by ffcomp") == 2


def test_lines_that_look_like_ours_survive() -> None:
    data = (BODY + ";~G1 X30\n;~~G1 X30\n; note ; ffcomp\nG1 X10 E.1 ; ffcomp\n; Processed by ffcomp v9\n").encode()
    assert original(compensated(data, inverter())) == data


def test_a_file_that_has_lost_its_stamp_is_not_compensated_twice() -> None:
    out = compensated(BODY.encode(), inverter())
    bare = b"".join(line for line in out.splitlines(keepends=True) if not line.startswith(b"; Processed by"))
    with pytest.raises(UnsupportedGcode, match="has lost its stamp"):
        compensated(bare, inverter())


def test_marlin_is_given_its_limits_in_the_units_in_force() -> None:
    out = compensated(b"G20\nG90\nM83\nG1 X0 Y0 Z0.2 F300\nG1 X1 Y0.5 E.01\nG28\n", inverter()).splitlines()
    assert b"M203 X11.811 Y11.811 Z11.811 ; ffcomp" in out  # 300 mm/s


@pytest.mark.parametrize("feed", ["999999.9", "0.0004", "123456.25"])
def test_a_feed_is_put_back_without_an_exponent(feed: str) -> None:
    data = f"{BODY}G1 F{feed}\nG28\n".encode()
    out = compensated(data, inverter())
    assert violations(data, out, inverter().machine) == []


# ---- files ----


OFFSETS = {  # beds with their origin in a corner; the vase's start moves need more room than its bed's centre leaves
    "ender3_ringing_tower.gcode": (-110.0, -110.0),
    "gcodepreview_benchy_arcs.gcode": (-100.0, -100.0),
    "gcodepreview_vase.gcode": (-70.0, -75.0),
    "makreeltje_orca_slicer.gcode": (-150.0, -150.0),
    "makreeltje_cura_slicer.gcode": (-150.0, -150.0),
}

needs_data = pytest.mark.skipif(
    not ROOT.is_dir(), reason=f"no G-code of others at {ROOT}; FFCOMP_DATA names its folder"
)
ODD = sorted((ROOT / "odd").iterdir()) if ROOT.is_dir() else []


def job(data: bytes, path: Path) -> Job:
    options = plainly(offset_mm=OFFSETS.get(path.name, (0.0, 0.0)), predict=False)
    return Job(data, str(path), load_machine("mp-delta-pro"), options)


@needs_data
@pytest.mark.parametrize("path", ODD, ids=lambda p: p.name)
def test_an_odd_file_gives_a_result_or_a_place_and_a_rule(path: Path) -> None:
    out, refused = b"", None
    try:
        out = b"".join(job(read_bytes(path), path).lines())
    except (NothingToDo, GcodeError) as error:
        refused = error
    if refused is None:
        assert passed(read_program(path.read_bytes())) == [a for a in out.splitlines(keepends=True) if a in kept(path)]
    elif isinstance(refused, GcodeError):
        assert refused.path and refused.rule.endswith((".", "?", ")"))
        assert refused.line is not None or path.stat().st_size == 0
    else:
        assert str(path) in str(refused)


def kept(path: Path) -> set[bytes]:
    return set(passed(read_program(path.read_bytes())))


def passed(program: Program) -> list[bytes]:
    """Lines that are no moves, in order."""
    return [program.lines[e.line] for e in program.events if not STILL_MOVE.match(program.lines[e.line])]
