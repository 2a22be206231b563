"""One number in `compensate` and `show`: what is predicted is the file as it was written."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from ffcomp.compensation import file as files
from ffcomp.compensation.file import compensate_file
from ffcomp.compensation.job import Job, Options
from ffcomp.compensation.prediction import Forecast, Prediction
from ffcomp.report.show import numbers
from ffcomp.simulation.preview import Preview, preview
from models.file import load_machine
from tests.support.prints import squares

MACHINE = load_machine("mp-delta-pro")


@pytest.fixture(scope="module")
def target(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("predicted") / "out.gcode"


@pytest.fixture(scope="module")
def predicted(target: Path) -> dict[str, dict[str, float]]:
    result = compensate_file(squares(), "squares.gcode", MACHINE, Options(flavor="klipper"), target)
    assert result.result.forecast.over_s > 3.0
    return dict(result.to_dict()["predicted"])


@pytest.fixture(scope="module")
def seen(target: Path, predicted: object) -> Preview:
    return preview(target.read_bytes(), "out.gcode", MACHINE, flavor="klipper")


def test_show_states_the_number_of_compensate(predicted: dict[str, dict[str, float]], seen: Preview) -> None:
    for name, curve in (("uncompensated", seen.before), ("compensated", seen.after)):
        shown, track = numbers(curve), predicted[name]
        assert [shown.rms, shown.p99, shown.worst] == [track[f"contour_{key}_um"] for key in ("rms", "p99", "max")]
        assert asdict(curve.track) == track
    assert predicted["compensated"]["tracking_rms_no_delay_um"] < 10.0  # its clock is the file's, section by section


def test_a_prediction_on_the_way_is_of_the_lines_as_they_state_their_places(
    predicted: dict[str, dict[str, float]],
) -> None:
    """Numbers are written in few digits, which costs a seventh more error; what is predicted has it too."""
    tracks = Job(squares(), "squares.gcode", MACHINE, Options(flavor="klipper")).write(None).to_dict()["predicted"]
    ways = [each["compensated"]["contour_rms_um"] for each in (tracks, predicted)]
    assert ways[0] == pytest.approx(ways[1], rel=0.06)  # rests are not in it


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


def test_the_file_is_replaced_after_its_prediction(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, before = tmp_path / "print.gcode", list[bytes]()
    path.write_bytes(squares())

    def predict(written: bytes, *others: object) -> Forecast:
        before.append(path.read_bytes())
        assert written != squares() and b"; Processed by ffcomp" in written
        return Forecast()

    monkeypatch.setattr(files, "read_again", predict)
    compensate_file(path, "print.gcode", MACHINE, Options(flavor="klipper"), path)
    assert before == [squares()] != [path.read_bytes()]


@pytest.mark.parametrize("share", ["read again", "on the way"])
def test_a_prediction_that_fails_is_said_and_fails_no_print(
    share: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*anything: object) -> Forecast:
        raise ValueError("A reference path needs times that never fall")

    path = tmp_path / "print.gcode"
    path.write_bytes(squares())
    if share == "read again":
        monkeypatch.setattr(files, "read_again", fails)
    else:
        monkeypatch.setattr(Prediction, "_add", fails)
        monkeypatch.setattr("ffcomp.compensation.job.READ_AGAIN_S", 0.0)
    done = compensate_file(path, "print.gcode", MACHINE, Options(flavor="klipper"), path)
    assert b"; Processed by ffcomp" in path.read_bytes() and dict(done.result.predicted) == {}
    assert "could not be predicted (ValueError: A reference path" in done.result.warnings[0]
    assert done.to_dict()["warnings"] == done.result.warnings
