"""Captures of every kind: recognised by content, in m/s², with their clock and what the file says of lost samples."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from ffcomp.errors import MeasurementError
from ffcomp.measurement.sensors import G
from ffcomp.measurement.vibration import read_captures
from tests.support.data import DATA, needed

RATE, COUNT = 3200.0, 3200
RNG = np.random.default_rng(3)
FELT = RNG.standard_normal((COUNT, 3)) * 2 + [0, 0, G]  # m/s²
T = np.arange(COUNT) / RATE
OWNERS = DATA / "vibration" / "owners"


def rows(*columns: np.ndarray, delimiter: str = ",") -> str:
    return "\n".join(delimiter.join(f"{x:.9g}" for x in row) for row in np.column_stack(columns)) + "\n"


def write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("tail", "words"),
    [("", "the recording was cut short"), ("Failed to start accelerometer\n", "Check M955, and record it again")],
)
def test_reprapfirmware_without_its_last_line_is_refused(tmp_path: Path, tail: str, words: str) -> None:
    path = write(tmp_path / "a.csv", "Sample,X,Y,Z\n" + rows(np.arange(COUNT), FELT / G) + tail)
    with pytest.raises(MeasurementError, match=words):
        read_captures(path)


@pytest.mark.parametrize(
    ("header", "time_unit", "unit", "delimiter"),
    [
        ("t,ax,ay,az", 1.0, G, ","),
        ("time_ms;acc_x;acc_y;acc_z", 1e-3, 1e-3, ";"),
        ('"Time (s)";"Acceleration x (m/s^2)";"Acceleration y (m/s^2)";"Acceleration z (m/s^2)"', 1.0, 1.0, ";"),
        ("Time [s]\tx [mg]\ty [mg]\tz [mg]", 1.0, 1e-3 * G, "\t"),
    ],
)
def test_any_table_with_a_time_and_three_accelerations(
    tmp_path: Path, header: str, time_unit: float, unit: float, delimiter: str
) -> None:
    text = header + "\n" + rows(T / time_unit, FELT / unit, delimiter=delimiter)
    (found,) = read_captures(write(tmp_path / "phone.csv", text))
    assert found.sample_rate_hz == pytest.approx(RATE, rel=1e-4) and found.clock == "free"
    np.testing.assert_allclose(found.acceleration, FELT, rtol=1e-4, atol=1e-4)


def stdata(path: Path, names: list[str]) -> Path:
    zstandard = pytest.importorskip("zstandard")
    samples = np.column_stack([180 + T, FELT * 1e3]).tolist()
    lines = "".join(json.dumps({"name": name, "samples": samples}) + "\n" for name in names)
    path.write_bytes(zstandard.ZstdCompressor().compress(lines.encode()))
    return path


def test_shake_and_tune_holds_several_captures_in_one_file(tmp_path: Path) -> None:
    path = stdata(tmp_path / "belts.stdata", ["belt_A_20251203_133943", "belt_B_20251203_134036"])
    found = read_captures(path)
    assert [each.axis for each in found] == ["axis=1.000,-1.000", "axis=1.000,1.000"]
    assert {each.clock for each in found} == {"firmware"}
    np.testing.assert_allclose(found[0].acceleration, FELT, rtol=1e-6)
    assert read_captures(stdata(tmp_path / "one.stdata", ["axis_X_2025"]))[0].axis == "x"


def test_an_archive_that_would_fill_the_memory_is_refused(tmp_path: Path) -> None:
    zstandard = pytest.importorskip("zstandard")
    path = tmp_path / "bomb.stdata"
    path.write_bytes(zstandard.ZstdCompressor().compress(bytes(100 << 20)))
    with pytest.raises(MeasurementError, match="unpacks to more than any recording does"):
        read_captures(path)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "axes", "rate_hz"),
    [
        ("adxl345-20200810_214044.csv", [None], 3272),
        ("inputshaper_20250804_214702_axis_Y.stdata", ["y"], 3208),
        ("sovol_belts.stdata", ["axis=1.000,-1.000", "axis=1.000,1.000"], 3277),
    ],
)
def test_captures_of_owners_are_read(name: str, axes: list[str | None], rate_hz: float) -> None:
    if name.endswith(".stdata"):
        pytest.importorskip("zstandard")
    found = read_captures(needed(OWNERS / name))
    assert [each.axis for each in found] == axes
    for each in found:
        assert each.sample_rate_hz == pytest.approx(rate_hz, rel=1e-3) and each.overflows == 0
        assert np.linalg.norm(np.nanmedian(each.acceleration, axis=0)) == pytest.approx(G, rel=0.06)
