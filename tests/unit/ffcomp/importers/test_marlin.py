"""What Marlin answers to M503, as it looks in a terminal."""

from __future__ import annotations

from pathlib import Path

import pytest

from ffcomp.importers.builder import read_printer_config
from ffcomp.importers.values import ConfigValues, PrinterConfigError
from tests.support.configs import imported, written

LIMITS = (
    "echo:; Linear Units:\necho:  G21 ; (mm)\necho:; Steps per unit:\necho: M92 X80.00 Y80.00 Z400.00 E93.00\n"
    "echo:; Max feedrates (units/s):\necho:  M203 X300.00 Y250.00 Z10.00 E75.00\n"
    "echo:  M201 X3000.00 Y2000.00 Z100.00 E5000.00\necho:  M204 P1200.00 R300.00 T9000.00\n"
)
JERK = "echo:  M205 B20000.00 S0.00 T0.00 X9.00 Y8.00 Z0.40 E5.00\n"
SHAPER = "echo:; Input Shaping:\necho:  M593 X F29.14 D0.15\necho:  M593 Y F35.5 D0.12\n"
AREA = (
    "area:{full:{min:{x:-5.00,y:0.00,z:0.00},max:{x:230.00,y:231.00,z:250.00}},"
    "work:{min:{x:0.00,y:0.00,z:0.00},max:{x:220.00,y:220.00,z:250.00}}}\n"
)
TOWERS = "echo:  M665 L280.0000 R141.9439 H354.3339 S200.00 X0.0353 Y0.2565 Z-0.2919 A0.0 B0.5 C-0.25\n"


def found(folder: Path, text: str, kinematics: str | None = None) -> ConfigValues:
    return read_printer_config(written(folder, text, "m503.txt"), kinematics)


def value(says: ConfigValues, key: str) -> object:
    return says.values[key].value


def test_a_delta(tmp_path: Path) -> None:
    says = found(tmp_path, LIMITS + JERK + TOWERS)
    assert value(says, "kinematics.arm_lengths_mm") == [280.0, 280.5, 279.75]
    assert value(says, "kinematics.tower_angles_deg") == pytest.approx([210.0353, 330.2565, 89.7081])
    assert value(says, "kinematics.print_height_mm") == 354.3339
    assert "kinematics.print_radius_mm" not in says.values, "M503 does not tell it"
    assert any("DELTA_RADIUS_TRIM_TOWER" in note for note in says.notes)


def test_a_cartesian_printer(tmp_path: Path) -> None:
    says = found(tmp_path, LIMITS + JERK + SHAPER + AREA, "cartesian")
    assert value(says, "kinematics.x_range_mm") == [-5.0, 230.0]
    assert value(says, "axes.y.frequency_hz") == [35.5]
    assert value(says, "axes.x.damping_ratio") == [0.15]
    assert value(says, "limits.velocity_mm_per_s") == 250.0
    assert value(says, "limits.acceleration_mm_per_s2") == 1200.0
    assert value(says, "limits.square_corner_velocity_mm_per_s") == 8.0
    machine = imported(tmp_path / "m503.txt", kinematics="cartesian")
    assert machine.limits.z_velocity_mm_per_s == 10.0


def test_fixed_time_motion_is_said_and_its_shaper_unknown(tmp_path: Path) -> None:
    says = found(tmp_path, LIMITS + JERK + AREA + "echo:  M493 S1 X1 A37.0\n", "cartesian")
    assert "firmware.input_shaper" not in says.values and "send M493 S0" in says.notes[0]
    off = found(tmp_path, LIMITS + JERK + AREA + "echo:  M493 S0\n", "cartesian")
    assert value(off, "firmware.input_shaper") == [] and not off.notes


def test_a_junction_deviation_is_a_speed_at_a_right_angle(tmp_path: Path) -> None:
    """v² = J a sin(θ/2) / (1 − sin(θ/2)), the rule both planners share, at θ = 90 degrees."""
    says = found(tmp_path, LIMITS + "echo:  M205 B20000.00 S0.00 T0.00 J0.02\n", "cartesian")
    half = 0.5**0.5
    assert value(says, "limits.square_corner_velocity_mm_per_s") == pytest.approx(
        (0.02 * 1200 * half / (1 - half)) ** 0.5, abs=1e-3
    )


def test_inches_and_other_firmwares_are_refused(tmp_path: Path) -> None:
    with pytest.raises(PrinterConfigError, match=r"m503.txt:2: the numbers are in inches; send G21"):
        found(tmp_path, LIMITS.replace("G21 ; (mm)", "G20 ; (in)"), "cartesian")
    with pytest.raises(PrinterConfigError, match="Smoothieware"):
        found(tmp_path, "M92 X80 Y80 Z80\nM203 X500 Y500\nM203.1 X156\nM665 L217.8 R112.6\n")
