"""One number in `compensate` and `show`: what is predicted is the file as it was written."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import pytest

from ffcomp.compensation.file import compensate_file
from ffcomp.compensation.job import Job, Options
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
    assert result.result.predicted_over_s > 3.0
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
