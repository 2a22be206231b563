"""docs/DIALECTS.md, and files that end, break or repeat in odd ways."""

from __future__ import annotations

import pytest

from gcode.embedded import original
from gcode.errors import GcodeError, UnsupportedGcode
from gcode.reader import read_program
from scripts.pages import dialects
from tests.fuzz.test_random_programs import compensated, inverter
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
