"""The command line goes before the machine file, and that before the print; a contradiction is said."""

from __future__ import annotations

from gcode.dialects import FlavorSign, choose_flavor

CURA = FlavorSign("marlin", ";FLAVOR:Marlin")


def test_a_contradiction_is_a_warning() -> None:
    choice = choose_flavor("", "klipper", CURA)
    assert choice.flavor == "klipper"
    assert choice.warning.startswith("The print is made for marlin (;FLAVOR:Marlin), but compensated for klipper, as")
    assert choice.warning.endswith("If the printer runs marlin, many segments will be late: use --flavor marlin.")
