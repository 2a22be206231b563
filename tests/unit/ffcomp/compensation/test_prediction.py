"""What is predicted of the segments as they are written, and how a prediction that fails is stated."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from ffcomp.compensation.file import compensate_file
from ffcomp.compensation.job import Options
from ffcomp.compensation.prediction import Prediction
from ffcomp.firmware.program import plan_program
from ffcomp.simulation.command import path_corners_with_rests
from ffcomp.simulation.expectation import PIECE_S, Piece, pieces_of_segments
from ffcomp.simulation.preview import preview
from gcode.reader import read_program
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


def pieces(seconds: float, share: float, lot: float) -> list[Piece]:
    t = np.arange(0.0, seconds + 1e-9, 0.004)
    vertices = np.outer(t, [10.0, 0.0, 0.0])
    return pieces_of_segments(lambda t: np.outer(t, [10.0, 0.0, 0.0]), t, vertices, (t, vertices), share, lot)


@pytest.mark.parametrize("seconds", [0.1, 2.0, 3.1, 20.0])
def test_sections_of_any_length_get_their_share(seconds: float) -> None:
    lots = (np.arange(200) + 0.5) / 200
    covered = [sum(each.seconds for each in pieces(seconds, 0.3, lot)) for lot in lots.tolist()]
    assert np.mean(covered) == pytest.approx(0.3 * seconds, rel=0.1)
    (whole,) = pieces(seconds, 1.0, 0.0)
    assert whole.seconds == pytest.approx(seconds, abs=0.01)


def test_pieces_of_a_section_are_spread_evenly() -> None:
    several = pieces(20.0, 0.36, 0.0)
    assert [each.seconds for each in several] == pytest.approx(3 * [PIECE_S], abs=0.01)
    assert [each.begin_t + PIECE_S / 2 for each in several] == pytest.approx([20 / 6, 10.0, 100 / 6], abs=0.01)


def test_rounding_never_lets_a_path_end_after_the_next_one_begins() -> None:
    rng = np.random.default_rng(1)
    segment_s = 1.0 / 250.0
    collector = Prediction(SimpleNamespace(settings=SimpleNamespace(segment_s=segment_s, substeps=4)), 1.0)  # type: ignore[arg-type]
    for _ in range(200):
        begin, knots = float(rng.uniform(0.0, 300.0)), int(rng.integers(3, 400))
        end = begin + (1.0 + rng.uniform(0.0, 1e-9)) * knots * segment_s
        path = np.array([begin, end]), np.zeros((2, 3))
        reference = SimpleNamespace(knots=knots, t0=begin, path=lambda path=path: path)
        collector._add_path(reference, np.zeros(3))  # type: ignore[arg-type]
        collector.samples.clock += knots * segment_s
    assert (np.diff(np.concatenate(collector.samples.path_t)) >= 0.0).all()


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


def test_corners_of_a_path_never_go_back_in_time() -> None:
    """Where a plan was made slower, a move may by rounding begin just before the last one has ended."""
    plan = plan_program(read_program(squares(), flavor="klipper"), MACHINE).trajectory
    early = replace(plan, start_t=plan.start_t - 1e-12 * np.arange(len(plan.start_t)))
    t, corners = path_corners_with_rests(early)
    assert (np.diff(t) >= 0.0).all() and len(t) == len(corners)
    np.testing.assert_allclose(t[1::2], plan.start_t + plan.duration, atol=1e-9)
