"""What is predicted of the segments as they are written, and how a prediction that fails is stated."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from ffcomp.compensation.file import compensate_file
from ffcomp.compensation.prediction import Prediction
from ffcomp.compensation.result import FileSize
from ffcomp.simulation.preview import preview
from models.file import load_machine
from tests.support.compensated import plainly
from tests.support.prints import squares

MACHINE = load_machine("mp-delta-pro")


@pytest.mark.parametrize("layers", [3, 12], ids=["whole", "excerpt"])
def test_it_is_near_what_the_whole_file_does_when_it_is_read_again(layers: int, tmp_path: Path) -> None:
    """Rests are not in it."""
    target = tmp_path / "out.gcode"
    done = compensate_file(squares(layers), "squares.gcode", MACHINE, plainly(flavor="klipper"), target)
    assert done.result.size == FileSize(len(squares(layers)), target.stat().st_size)
    found = done.result.forecast
    again = preview(target.read_bytes(), "out.gcode", MACHINE).forecast(MACHINE)
    assert 3.0 < found.over_s <= again.over_s and found.expected is not None and again.expected is not None
    for name, near in (("uncompensated", 0.1), ("compensated", 0.06)):
        assert found.tracks[name].contour_rms_um == pytest.approx(again.tracks[name].contour_rms_um, rel=near)
    assert found.tracks["compensated"].tracking_rms_no_delay_um < 10.0
    for name in ("uncompensated_um", "compensated_um", "shaper_um"):
        assert getattr(found.expected, name) == pytest.approx(getattr(again.expected, name), rel=0.25)


def test_a_sliced_motion_begins_with_the_ringing_of_the_one_before(tmp_path: Path) -> None:
    """From a rest of 10 ms on; of 1 s nothing is left."""
    machine, target = load_machine("voron-300"), tmp_path / "out.gcode"
    corners, found = ((108, 100), (108, 108), (100, 108), (100, 100)), []
    for rest in (10, 1000):
        square = "".join(f"G1 X{x} Y{y} E.3 F12000\nG4 P{rest}\n" for x, y in corners)
        data = ("G28\nG90\nM83\nG1 X100 Y100 Z5 F6000\n" + 3 * square).encode()
        done = compensate_file(data, "p.gcode", machine, plainly(offset_mm=(0.0, 0.0), flavor="klipper"), target)
        found.append(done.result.forecast.tracks["uncompensated"].contour_rms_um)
        if rest == 10:
            again = preview(target.read_bytes(), "out.gcode", machine).forecast(machine)
            assert found[0] == pytest.approx(again.tracks["uncompensated"].contour_rms_um, rel=0.05)
    assert found[0] > 1.3 * found[1]


@pytest.mark.parametrize("name", ["ender-3", "voron-300"])
def test_a_certain_file_is_expected_to_do_what_is_predicted(name: str, tmp_path: Path) -> None:
    """Of the segments as they are written: Marlin's whole steps are most of what is left of a gentle print."""
    data = b"G28\nG90\nM83\nG1 X100 Y100 Z5 F6000\nG1 X105 Y100 E.3 F1800\nG1 X105 Y103 E.2\n"
    certain = replace(load_machine(name), uncertainty={})
    found = compensate_file(data, "p.gcode", certain, plainly(offset_mm=(0.0, 0.0)), tmp_path / "out.gcode")
    forecast = found.result.forecast
    assert forecast.expected is not None and forecast.expected.printers == 0
    assert forecast.expected.compensated_um == pytest.approx(forecast.tracks["compensated"].contour_rms_um, rel=0.1)


def test_marlin_rounds_the_sliced_line_too_before_its_shaper(tmp_path: Path) -> None:
    """A straight line 5 µm beside whole steps of y: nothing rings across it, and Klipper leaves nothing."""
    data = b"G28\nG90\nM83\nM204 S100\nG1 X100 Y100.005 Z5 F6000\nG1 X150 Y100.005 E2 F1800\n"
    certain = replace(load_machine("ender-3"), uncertainty={})
    for flavor, um in (("marlin", 5.0), ("klipper", 0.0)):
        options = plainly(offset_mm=(0.0, 0.0), flavor=flavor)
        found = compensate_file(data, "p.gcode", certain, options, tmp_path / "out.gcode").result.forecast
        assert found.expected is not None
        assert found.tracks["uncompensated"].contour_rms_um == pytest.approx(um, abs=0.2)
        assert found.expected.uncompensated_um == pytest.approx(um, abs=0.2)
        assert found.expected.shaper_um == pytest.approx(um, abs=0.2)
        assert found.expected.compensated_um <= um + 0.2


def test_a_prediction_that_fails_is_said_and_fails_no_print(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*anything: object) -> None:
        raise ValueError("A reference path needs times that never fall")

    path = tmp_path / "print.gcode"
    path.write_bytes(squares())
    monkeypatch.setattr(Prediction, "_add", fails)
    done = compensate_file(path, "print.gcode", MACHINE, plainly(flavor="klipper"), path)
    assert b"; Processed by ffcomp" in path.read_bytes() and b"; ffcomp forecast=" not in path.read_bytes()
    assert dict(done.result.predicted) == {} and done.to_dict()["verdict"] == ""
    assert "could not be predicted (ValueError: A reference path" in done.result.warnings[0]
    assert done.to_dict()["warnings"] == [*done.result.unknown, *done.result.warnings]
