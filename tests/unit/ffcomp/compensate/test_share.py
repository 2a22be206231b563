"""How much of a print is compensated."""

from __future__ import annotations

import pytest

from ffcomp.compensate.share import Cause, Part, Shares, of_moves, of_raw_moves
from gcode.reader import read_program

HOME = (0.0, 0.0, 5.0)


def test_moves_that_travel_count_and_retractions_do_not() -> None:
    moves = read_program(b"M83\nG1 X30 E2 F600\nG1 Y40\nG1 E-5\nG1 E5\nG1 X0 E-1\n", start=HOME).moves
    assert of_moves(moves) == Part(100.0, 2.0)


def test_parts_add_up_by_their_cause() -> None:
    text = "M83\nG1 X10 E1 F600\nMACRO_A\nG1 X20 E1\nG1 Y5\nMACRO_B\nG1 X0 Y0 E9\nMACRO_A\nG1 X5 Y5\n"
    events = read_program(text.encode(), start=HOME).events
    first, second = of_raw_moves(events[:3], {}), of_raw_moves(events[3:], {})
    shares = Shares(Part(10.0, 1.0)) + first + second
    causes = {cause: (round(part.path_mm, 6), part.filament_mm) for cause, part in shares.left}
    way = 5.0**2 * 17  # 20, 5 and back to 0, 0
    assert causes[Cause(3, "MACRO_A")] == pytest.approx((15.0 + 50.0**0.5, 1.0))
    assert causes[Cause(6, "MACRO_B")] == pytest.approx((way**0.5, 9.0))
    assert shares.filament == pytest.approx(1 / 11)
    assert shares.path == pytest.approx(10 / (25 + 50**0.5 + way**0.5))


def test_a_low_share_names_the_cause_and_the_remedy() -> None:
    shares = Shares(Part(10.0, 10.0), ((Cause(3, "MY_PHOTO"), Part(30.0, 10.0)), (Cause(1, "G28"), Part(1.0, 0.0))))
    (sentence,) = shares.warnings()
    assert sentence.startswith("Only 24 % of the path and 50 % of the filament are compensated")
    assert "after MY_PHOTO in line 3" in sentence and '[macros] returns = ["MY_PHOTO"]' in sentence
    assert Shares(Part(96.0, 96.0), ((Cause(1, "G28"), Part(4.0, 4.0)),)).warnings() == ()
    assert Shares().path == Shares().filament == 1.0
    (sentence,) = Shares(left=((Cause(0, ""), Part(30.0, 10.0)),)).warnings()
    assert "name X, Y and Z, before it prints" in sentence
