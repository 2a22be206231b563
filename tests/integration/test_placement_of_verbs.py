"""Every verb that plans a print puts it where `compensate` does."""

from __future__ import annotations

from pathlib import Path

import pytest

import ffcomp

MACHINE = "mp-delta-pro"
MIDDLE = "G28\nG90\nM83\nG1 X0 Y0 Z0.2 F6000\nG1 X20 Y0 E1 F3000\nG1 X20 Y20 E1\nG1 X0 Y20 E1\nG1 X0 Y0 E1\n"
CORNER = MIDDLE.replace("X0", "X110").replace("X20", "X130").replace("Y0", "Y110").replace("Y20", "Y130")


@pytest.fixture
def prints(tmp_path: Path) -> tuple[Path, Path]:
    """The same print for a bed whose origin is a corner, and for one whose origin is the middle, at (-10, -10)."""
    corner, middle = tmp_path / "corner.gcode", tmp_path / "middle.gcode"
    corner.write_text(CORNER, encoding="utf-8")
    middle.write_text(MIDDLE, encoding="utf-8")
    return corner, middle


def test_a_print_for_another_bed_is_moved_by_every_verb(prints: tuple[Path, Path]) -> None:
    corner, middle = prints
    offset = ffcomp.compensate(corner, MACHINE, predict=False).to_dict()["offset_mm"]
    assert offset == pytest.approx((-120.0, -120.0))
    there = {"offset_mm": (-10.0, -10.0)}
    moved, same = ffcomp.estimate(corner, MACHINE), ffcomp.estimate(middle, MACHINE, **there)
    assert moved.time_s == pytest.approx(same.time_s, rel=1e-9)
    assert any("Offset -120,-120" in sentence for sentence in moved.to_dict()["warnings"])
    moved, same = (ffcomp.simulate(file, MACHINE, **more) for file, more in ((corner, {}), (middle, there)))
    assert moved.nozzle_mm == pytest.approx(same.nozzle_mm, abs=1e-9)
    errors = [
        ffcomp.compare(file, MACHINE, only=("zv",), **more).tracks["zv"].contour_rms_um
        for file, more in ((corner, {}), (middle, there))
    ]
    assert errors[0] == pytest.approx(errors[1], rel=1e-9)
