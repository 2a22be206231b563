"""Statistics are values that add up."""

from __future__ import annotations

import pytest

from ffcomp.compensation.faster import Faster
from ffcomp.compensation.placement import Placement
from ffcomp.compensation.result import Result
from ffcomp.compensation.statistics import (
    Amount,
    Place,
    Shares,
    Statistics,
    of_raw,
)
from ffcomp.metrics import Track
from ffcomp.simulation.forecast import Forecast
from gcode.dialects import FlavorChoice
from gcode.reader import read_program
from models.file import load_machine
from models.machine import Machine

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
    told = {each["command"]: each for each in shares.to_dict()["uncompensated"]}
    assert (told["MACRO_A"]["line"], told["MACRO_A"]["places"], told["MACRO_A"]["worst_line"]) == (3, 2, 3)
    assert told["MACRO_A"]["path_mm"] == pytest.approx(15.0 + 50.0**0.5)
    assert shares.filament == pytest.approx(1 / 11)
    assert shares.path == pytest.approx(10 / (25 + 50**0.5 + way**0.5))


def test_a_low_share_names_the_cause_and_the_remedy() -> None:
    photos = {Place(3, "MY_PHOTO"): Amount(10.0, 2.0), Place(9, "MY_PHOTO"): Amount(20.0, 8.0)}
    shares = Shares(Amount(10.0, 10.0), {Place(1, "G28"): Amount(1.0, 0.0), **photos})
    (sentence,) = shares.warnings()
    assert sentence.startswith("Only 24 % of the path and 50 % of the filament are compensated")
    assert (
        "after MY_PHOTO in line 9 the place of the nozzle is unknown (2 places, most after this one), 10 mm" in sentence
    )
    assert '[macros] returns = ["MY_PHOTO"]' in sentence
    assert Shares(Amount(96.0, 96.0), {Place(1, "G28"): Amount(4.0, 4.0)}).warnings() == ()
    assert Shares().path == Shares().filament == 1.0
    (sentence,) = Shares(left={Place(0, ""): Amount(30.0, 0.0)}).warnings()
    assert "no filament, travels only" in sentence and "name X, Y and Z, before it prints" in sentence


@pytest.fixture(scope="module")
def ender() -> Machine:
    return load_machine("ender-3")


def test_a_print_that_is_predicted_to_become_worse_says_so_first(ender: Machine) -> None:
    def result(before: float, after: float, faster: Faster | None = None) -> Result:
        errors = {"uncompensated": before, "compensated": after}
        tracks = {name: Track(0.0, 0.0, rms, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0) for name, rms in errors.items()}
        numbers = Statistics(warnings=("another",), faster=faster)
        chosen, place = FlavorChoice("marlin", ""), Placement((0.0, 0.0), "")
        return Result("", ender, chosen, place, numbers, 1.0, forecast=Forecast(tracks))

    first, *others = result(3.946, 6.052).warning_lines
    assert "contour error 6.05 µm rms, against 3.95 µm without it. Print the original." in first
    assert others == ["another"] and result(3.946, 6.052).warnings == [first, "another"]
    for better in (result(6.052, 3.946), result(3.946, 3.949), result(3.946, 6.052, Faster(bound_um=10.0))):
        assert better.no_gain == []
