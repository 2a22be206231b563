"""The command line goes before the machine file, and that before the print; a contradiction is said."""

from __future__ import annotations

import pytest

from gcode.dialects import FlavorSign, choose_flavor
from gcode.errors import UnsupportedGcode

CURA = FlavorSign("marlin", ";FLAVOR:Marlin")


def test_a_contradiction_is_a_warning() -> None:
    choice = choose_flavor("", "klipper", CURA)
    assert choice.flavor == "klipper"
    assert choice.warning.startswith("The print is made for marlin (;FLAVOR:Marlin), but compensated for klipper, as")
    assert choice.warning.endswith("If the printer runs marlin, many segments will be late: use --flavor marlin.")


def test_a_flavor_that_is_none_is_refused_with_the_file() -> None:
    with pytest.raises(UnsupportedGcode, match=r"a\.gcode: Unknown flavor 'smoothie': use klipper, marlin"):
        choose_flavor("smoothie", "klipper", CURA, "a.gcode")
