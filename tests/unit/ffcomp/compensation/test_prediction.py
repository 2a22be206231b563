"""What is predicted of the segments as they are written, and how a prediction that fails is stated."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from ffcomp.compensation.file import compensate_file
from ffcomp.compensation.job import Options
from ffcomp.compensation.prediction import Prediction
from ffcomp.simulation.preview import preview
from models.file import load_machine
from tests.support.prints import squares

MACHINE = load_machine("mp-delta-pro")


@pytest.mark.parametrize("layers", [3, 12], ids=["whole", "excerpt"])
def test_it_is_near_what_the_whole_file_does_when_it_is_read_again(layers: int, tmp_path: Path) -> None:
    """Rests are not in it, nor what rings across them."""
    target = tmp_path / "out.gcode"
    done = compensate_file(squares(layers), "squares.gcode", MACHINE, Options(flavor="klipper"), target)
    found = done.result.forecast
    again = preview(target.read_bytes(), "out.gcode", MACHINE, flavor="klipper").forecast(MACHINE)
    assert 3.0 < found.over_s <= again.over_s and found.expected is not None and again.expected is not None
    for name, near in (("uncompensated", 0.1), ("compensated", 0.06)):
        assert found.tracks[name].contour_rms_um == pytest.approx(again.tracks[name].contour_rms_um, rel=near)
    assert found.tracks["compensated"].tracking_rms_no_delay_um < 10.0
    for name in ("uncompensated_um", "compensated_um", "shaper_um"):
        assert getattr(found.expected, name) == pytest.approx(getattr(again.expected, name), rel=0.25)


@pytest.mark.parametrize("name", ["ender-3", "voron-300"])
def test_a_certain_file_is_expected_to_do_what_is_predicted(name: str, tmp_path: Path) -> None:
    """Of the segments as they are written: Marlin's whole steps are most of what is left of a gentle print."""
    data = b"G28\nG90\nM83\nG1 X100 Y100 Z5 F6000\nG1 X105 Y100 E.3 F1800\nG1 X105 Y103 E.2\n"
    certain = replace(load_machine(name), uncertainty={})
    found = compensate_file(data, "p.gcode", certain, Options(offset=(0.0, 0.0)), tmp_path / "out.gcode")
    forecast = found.result.forecast
    assert forecast.expected is not None and forecast.expected.printers == 0
    assert forecast.expected.compensated_um == pytest.approx(forecast.tracks["compensated"].contour_rms_um, rel=0.1)


def test_a_prediction_that_fails_is_said_and_fails_no_print(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*anything: object) -> None:
        raise ValueError("A reference path needs times that never fall")

    path = tmp_path / "print.gcode"
    path.write_bytes(squares())
    monkeypatch.setattr(Prediction, "_add", fails)
    done = compensate_file(path, "print.gcode", MACHINE, Options(flavor="klipper"), path)
    assert b"; Processed by ffcomp" in path.read_bytes() and b"; ffcomp forecast=" not in path.read_bytes()
    assert dict(done.result.predicted) == {} and done.to_dict()["verdict"] == ""
    assert "could not be predicted (ValueError: A reference path" in done.result.warnings[0]
    assert done.to_dict()["warnings"] == [*done.result.unknown, *done.result.warnings]
