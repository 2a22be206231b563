"""What a config.g says, command by command."""

from __future__ import annotations

from pathlib import Path

import pytest

from ffcomp.importers.builder import read_printer_config
from ffcomp.importers.values import ConfigValues, PrinterConfigError
from tests.support.configs import imported, written

HEAD = "; Configuration\nG90\nM83\nM569 P0 S1 ; forwards\nM584 X0 Y1 Z2 E3\n"
DELTA = HEAD + "M665 R105.6 L215.0 B85 H250\nM92 X80 Y80 Z80 E420:415\n"
CARTESIAN = HEAD + "M208 X0 Y-10 Z0 S1\nM208 X235 Y225 Z250 S0\nM92 X80 Y80 Z400\nM350 X16 Y16 Z16 E16 I1\n"


def found(folder: Path, text: str) -> ConfigValues:
    return read_printer_config(written(folder, text, "config.g"))


def value(says: ConfigValues, key: str) -> object:
    return says.values[key].value


def test_towers_without_their_own_numbers_are_as_the_first(tmp_path: Path) -> None:
    says = found(tmp_path, DELTA)
    assert value(says, "kinematics.arm_length_mm") == 215.0
    assert value(says, "kinematics.tower_angles_deg") == [210.0, 330.0, 90.0]
    assert value(says, "kinematics.print_radius_mm") == 85.0
    assert value(says, "steps.extruder_steps_per_mm") == 420.0
    two = found(tmp_path, DELTA + "M665 L215:216\n")
    assert value(two, "kinematics.arm_lengths_mm") == [215.0, 216.0, 215.0]
    assert value(two, "kinematics.delta_radius_mm") == 105.6, "a command changes only what it names"


def test_macros_run_where_they_are_called(tmp_path: Path) -> None:
    written(tmp_path, "M201 X900 Y900\n", "sys/speed.g")
    written(tmp_path, "M203 X6000 Y9000\n", "macros/fast.g")
    text = DELTA + 'M201 X1 Y1\nM98 P"speed.g"\nM98 P"0:/macros/fast.g"\nM98 P"/sys/none.g"\n'
    says = read_printer_config(written(tmp_path, text, "sys/config.g"))
    assert value(says, "limits.acceleration_mm_per_s2") == 900.0
    assert value(says, "limits.velocity_mm_per_s") == 100.0
    assert "config.g:11: M98 runs /sys/none.g, which is not here; it was not read." in says.notes
    written(tmp_path, 'M98 P"config.g"\n', "sys/speed.g")
    with pytest.raises(PrinterConfigError, match=r"speed.g:1: M98 runs config.g: it runs itself"):
        read_printer_config(tmp_path / "sys" / "config.g")


def test_microsteps_after_the_steps_change_them(tmp_path: Path) -> None:
    """The firmware starts with 16 microsteps, and keeps mm as they were when they change."""
    after = found(tmp_path, DELTA + "M350 X64 Y64 Z64\n")
    assert value(after, "steps.steps_per_mm") == 320.0
    assert value(after, "steps.full_steps_per_mm") == 5.0
    before = found(tmp_path, DELTA.replace("M92", "M350 X64 Y64 Z64\nM92"))
    assert value(before, "steps.steps_per_mm") == 80.0
    assert value(before, "steps.full_steps_per_mm") == 1.25
    said = found(tmp_path, DELTA.replace("E420:415", "S16").replace("M92", "M350 X64 Y64 Z64\nM92"))
    assert value(said, "steps.steps_per_mm") == 320.0


def test_what_the_firmwares_planner_needs_is_imported_axis_by_axis(tmp_path: Path) -> None:
    """The last number of several extruders' does not count, and a setting that config.g lacks is left out."""
    text = "M203 X18000 Y12000 Z6000 E3600\nM201 X1500 Y1600 Z700 E4000\nM204 T3000\nM566 X600 Y900 Z12 E120:240 P1\n"
    found(tmp_path, DELTA + text)
    s = imported(tmp_path / "config.g").reprapfirmware
    assert s is not None and set(s.stated) == {
        "speed_mm_per_s", "acceleration_mm_per_s2", "jerk_mm_per_s", "travel_acceleration_mm_per_s2", "jerk_policy",
    }  # fmt: skip
    assert (s.speed_mm_per_s, s.acceleration_mm_per_s2) == ((300, 200, 100, 60), (1500, 1600, 700, 4000))
    assert (s.jerk_mm_per_s, s.jerk_policy, s.travel_acceleration_mm_per_s2) == ((10, 15, 0.2, 2), 1, 3000)


def test_conditions_and_formulas_are_said_not_guessed(tmp_path: Path) -> None:
    text = (
        DELTA
        + "if exists(global.x)\n\tM201 X9 Y9\n\tif true\n\t\tM203 X1\nM201 X800 Y800\nM203 X{global.v * 60} Y9000\n"
    )
    says = found(tmp_path, text)
    assert value(says, "limits.acceleration_mm_per_s2") == 800.0
    assert value(says, "limits.velocity_mm_per_s") == 150.0
    assert [note.split(":")[1] for note in says.notes] == ["9", "11", "13"]
    assert "the formula of M203 X was not read" in says.notes[-1]


def test_a_cartesian_printer_with_one_shaper(tmp_path: Path) -> None:
    text = CARTESIAN + 'M203 X18000 Y18000 Z600\nM201 X3000 Y3000 Z100\nM593 P"mzv" F42.5 S0.08\n'
    says = found(tmp_path, text)
    assert says.kinematics == "cartesian"
    assert "firmware's default" in says.kinematics_origin
    assert value(says, "kinematics.y_range_mm") == [-10.0, 225.0]
    assert value(says, "axes.x.frequency_hz") == value(says, "axes.y.frequency_hz") == [42.5]
    assert value(says, "axes.y.damping_ratio") == [0.08]
    assert imported(tmp_path / "config.g").limits.z_velocity_mm_per_s == 10.0
    assert "axes.x.frequency_hz" not in found(tmp_path, text + 'M593 P"none"\n').values
    assert "axes.x.frequency_hz" not in found(tmp_path, text + "M593 F0\n").values


@pytest.mark.parametrize(
    ("command", "sentence"),
    [
        ("M669 K2", "config.g:10: M669 selects CoreXZ kinematics: ffcomp has delta.* couple the motors .* keep the"),
        ("M669 K1 X1:1:0:0 Y1:-1:0:-1", "config.g:10: this M669 gives a movement matrix.* keep the"),
        ("M665 L200:201:202:203 R100 H200 B80", "4 arms: ffcomp has deltas of three towers"),
        ("M667 S2", "config.g:10: M667 selects"),
        ("M92 X8-0", "config.g:10: M92 X = '8-0' must be a plain number"),
    ],
)
def test_mistakes_are_said_with_their_line(command: str, sentence: str, tmp_path: Path) -> None:
    with pytest.raises(PrinterConfigError, match=sentence):
        found(tmp_path, CARTESIAN + command + "\n")
