"""What Klipper's configuration files say: their syntax, their defaults, their arithmetic."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from ffcomp.firmware.klipper import MACRO
from ffcomp.importers.builder import read_printer_config
from ffcomp.importers.values import ConfigValues, PrinterConfigError
from tests.support.configs import COREXY, SAVED, SHAPER, imported, written

PLAIN = """
[printer]
kinematics: delta
delta_radius: 130
max_velocity: 250
max_accel: 2500
[stepper_a]
arm_length: 280
position_endstop: 310
microsteps: 16
rotation_distance: 32
[stepper_b]
microsteps: 16
rotation_distance: 32
[stepper_c]
microsteps: 16
rotation_distance: 32
"""


def found(folder: Path, text: str | bytes) -> ConfigValues:
    return read_printer_config(written(folder, text, "printer.cfg"))


def value(says: ConfigValues, key: str) -> object:
    return says.values[key].value


def test_what_is_not_given_is_the_firmwares_default(tmp_path: Path) -> None:
    says = found(tmp_path, PLAIN)
    assert value(says, "kinematics.arm_length_mm") == 280.0
    assert value(says, "kinematics.tower_angles_deg") == [210.0, 330.0, 90.0]
    assert value(says, "kinematics.print_height_mm") == 310.0
    assert value(says, "limits.square_corner_velocity_mm_per_s") == 5.0
    assert value(says, "steps.steps_per_mm") == 100.0
    assert value(says, "steps.full_steps_per_mm") == 6.25
    assert says.values["kinematics.tower_angles_deg"].how == "default"
    assert says.values["kinematics.delta_radius_mm"].origin == "printer.cfg:4 [printer] delta_radius"
    assert "limits.z_velocity_mm_per_s" not in says.values


def test_the_print_radius_stays_where_arms_are_no_steeper_than_twelve(tmp_path: Path) -> None:
    """A carriage moves 12 times as fast as the nozzle where the arm leans out by 12 / √145 of its length."""
    assert value(found(tmp_path, PLAIN), "kinematics.print_radius_mm") == 130.0
    long_radius = found(tmp_path, PLAIN.replace("delta_radius: 130", "delta_radius: 150"))
    reach = value(long_radius, "kinematics.print_radius_mm")
    lean = 150.0 + reach
    assert lean / math.sqrt(280.0**2 - lean**2) == pytest.approx(12.0, rel=1e-3)


def test_syntax_that_people_write(tmp_path: Path) -> None:
    """Comments of both kinds, '=' and ':', capital letters, Windows line ends, Latin-1, macros, values below."""
    text = (
        "# Drucker für große Teile\n[printer]   # the printer\nKinematics = delta ; yes\nmax_velocity : 250\n"
        "max_accel:2500\ndelta_radius:\n  130\n[gcode_macro START]\ngcode:\n  {% if printer.x == 1 %}\n# no indent\n"
        "    M117 [printer] {params.X|default(1)}\n\n  {% endif %}\n[stepper_a]\narm_length=280\n"
        "position_endstop: 310\narm_length: 281\n"
    )
    says = found(tmp_path, text.replace("\n", "\r\n").encode("latin-1"))
    assert value(says, "kinematics.delta_radius_mm") == 130.0
    assert value(says, "kinematics.arm_length_mm") == 281.0, "what stands last counts"
    assert says.values["limits.velocity_mm_per_s"].origin.startswith("printer.cfg:4 ")


def test_includes_are_relative_globbed_and_in_order(tmp_path: Path) -> None:
    written(tmp_path, "[include sub/*.cfg]\n" + PLAIN + "[include late.cfg]\n", "printer.cfg")
    written(tmp_path, "[printer]\nmax_accel: 1\n[include deeper/x.cfg]\n", "sub/a.cfg")
    written(tmp_path, "[stepper_b]\nangle: 331\n", "sub/deeper/x.cfg")
    written(tmp_path, "[stepper_c]\narm_length: 279\n", "late.cfg")
    says = read_printer_config(tmp_path / "printer.cfg")
    assert value(says, "limits.acceleration_mm_per_s2") == 2500.0, "the file itself comes after its first line"
    assert value(says, "kinematics.tower_angles_deg") == [210.0, 331.0, 90.0]
    assert value(says, "kinematics.arm_lengths_mm") == [280.0, 280.0, 279.0]
    assert "x.cfg:2 [stepper_b] angle" in says.values["kinematics.tower_angles_deg"].origin


def test_a_circle_of_includes_is_refused_and_a_diamond_is_not(tmp_path: Path) -> None:
    written(tmp_path, "[include b.cfg]\n", "a.cfg")
    written(tmp_path, "[include a.cfg]\n", "b.cfg")
    with pytest.raises(PrinterConfigError, match=r"b.cfg:1: \[include a.cfg\]: a.cfg: includes itself"):
        found(tmp_path, "[include a.cfg]\n" + PLAIN)
    written(tmp_path, "", "b.cfg")
    assert value(found(tmp_path, "[include a.cfg]\n[include b.cfg]\n" + PLAIN), "kinematics.arm_length_mm") == 280.0


def test_saved_values_fill_in_what_the_rest_leaves_out(tmp_path: Path) -> None:
    saved = (
        "#*# [printer]\n#*# delta_radius = 131.5\n#*#\n#*# [stepper_a]\n#*# angle = 209.5  # tuned\n"
        "#*# arm_length = 9\n"
    )
    without = PLAIN.replace("delta_radius: 130\n", "")
    says = found(tmp_path, without + SAVED + saved)
    assert value(says, "kinematics.delta_radius_mm") == 131.5
    assert value(says, "kinematics.tower_angles_deg") == [209.5, 330.0, 90.0]
    assert value(says, "kinematics.arm_length_mm") == 280.0, "the firmware drops what is also given outside"
    place = (without + SAVED + saved).split("\n").index("#*# arm_length = 9") + 1
    assert any(f"printer.cfg:{place}: the saved arm_length = '9'" in note for note in says.notes)


def test_a_damaged_saved_block_is_refused(tmp_path: Path) -> None:
    with pytest.raises(PrinterConfigError, match=r"printer.cfg:24: 'max_accel: 1' stands within the SAVE_CONFIG block"):
        found(tmp_path, PLAIN + SAVED + "#*# [printer]\n#*# delta_radius = 131.5\nmax_accel: 1\n")
    with pytest.raises(
        PrinterConfigError, match=r"printer.cfg:19: .* is a saved value, but the head of the SAVE_CONFIG"
    ):
        found(tmp_path, PLAIN + SAVED.replace("DO NOT EDIT", "EDIT") + "#*# [printer]\n#*# delta_radius = 131.5\n")


def test_kalicos_references(tmp_path: Path) -> None:
    text = "[constants]\nrun_current: 1\narm: 290\n" + PLAIN.replace("arm_length: 280", "arm_length: ${constants.arm}")
    assert value(found(tmp_path, text), "kinematics.arm_length_mm") == 290.0
    with pytest.raises(PrinterConfigError, match=r"\[constants\] leg, which is not given"):
        found(tmp_path, text.replace("constants.arm", "constants.leg"))
    with pytest.raises(PrinterConfigError, match="refers to itself"):
        found(tmp_path, text.replace("constants.arm", "stepper_a.arm_length"))


def test_gears_full_steps_and_old_step_distances(tmp_path: Path) -> None:
    geared = found(tmp_path, PLAIN + "[extruder]\nmicrosteps: 16\nrotation_distance: 22.5\ngear_ratio: 50:10, 3:2\n")
    assert value(geared, "steps.extruder_steps_per_mm") == pytest.approx(200 * 7.5 * 16 / 22.5)
    old = PLAIN.replace("rotation_distance: 32", "step_distance: .01")
    assert value(found(tmp_path, old), "steps.steps_per_mm") == 100.0
    assert value(found(tmp_path, old), "steps.full_steps_per_mm") == 6.25
    without_microsteps = found(tmp_path, old.replace("microsteps: 16\n", ""))
    assert value(without_microsteps, "steps.steps_per_mm") == 100.0
    assert "steps.full_steps_per_mm" not in without_microsteps.values


def test_a_corexy_printer(tmp_path: Path) -> None:
    says = found(tmp_path, COREXY + SHAPER)
    assert says.kinematics == "corexy"
    assert value(says, "kinematics.x_range_mm") == [-5.0, 300.0]
    assert value(says, "kinematics.y_range_mm") == [0.0, 302.5]
    assert value(says, "steps.steps_per_mm") == [320.0, 320.0, 400.0]
    assert value(says, "steps.full_steps_per_mm") == [10.0, 10.0, 25.0]
    assert value(says, "axes.x.frequency_hz") == [61.2]
    assert value(says, "axes.y.damping_ratio") == [0.07]
    assert value(says, "limits.z_velocity_mm_per_s") == 15.0
    assert says.values["axes.x.damping_ratio"].how == "default"
    assert "as a start" in says.values["axes.x.frequency_hz"].origin
    machine = imported(tmp_path / "printer.cfg")
    assert machine.limits.z_acceleration_mm_per_s2 == 350.0
    assert list(machine.kinematics.centre_mm) == [147.5, 151.25]


def test_a_macro_that_sets_the_shaper_is_said(tmp_path: Path) -> None:
    macro = "[gcode_macro PRINT_START]\ngcode:\n    G28\n    set_input_shaper SHAPER_FREQ_X=50\n"
    says = found(tmp_path, COREXY + "[input_shaper]\n" + macro)
    assert "firmware.input_shaper" not in says.values, "it is not known what is in force"
    assert any("[gcode_macro PRINT_START] sets the input shaper" in note for note in says.notes)
    ours = found(tmp_path, COREXY + SHAPER + MACRO)
    assert value(ours, "firmware.input_shaper")[0].startswith("SET_INPUT_SHAPER ")
    assert not any("sets the input shaper" in note for note in ours.notes)


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("rotation_distance: 32", "rotation_distance: 32mm", r"cfg:11: \[stepper_a\] rotation_distance = '32mm' must"),
        ("rotation_distance: 32", "rotation_distance: 0", "'0' must be above 0"),
        ("microsteps: 16", "microsteps: 16\ngear_ratio: 3", "gear_ratio = '3' must be pairs like 80:16"),
        ("microsteps: 16", "microsteps 16", "'microsteps 16' is no section and no option"),
        ("\n[printer]", "max_z: 3\n[printer]", "printer.cfg:1: 'max_z: 3' must stand in a section"),
    ],
)
def test_mistakes_are_said_with_their_line(old: str, new: str, sentence: str, tmp_path: Path) -> None:
    with pytest.raises(PrinterConfigError, match=sentence):
        found(tmp_path, PLAIN.replace(old, new, 1))


@pytest.mark.parametrize(
    ("line", "note"),
    [
        ("minimum_cruise_ratio: 0.2", "SET_VELOCITY_LIMIT MINIMUM_CRUISE_RATIO=0.2 in the start G-code"),
        ("max_accel_to_decel: 500", "a cruise ratio of 0.8 in Klippers before 2024"),
        ("max_accel_to_decel: 1250", ""),  # as ffcomp plans
    ],
)
def test_what_a_machine_file_cannot_hold_is_noted(line: str, note: str, tmp_path: Path) -> None:
    notes = found(tmp_path, PLAIN.replace("max_accel: 2500", f"max_accel: 2500\n{line}")).notes
    assert any(note in each for each in notes) if note else not any("cruise" in each for each in notes)
