"""Runs: what is read, and every mistake said with its column, its row and the rule."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ffcomp.errors import MeasurementError
from ffcomp.measurement.axis_run import read_axis_run
from ffcomp.measurement.recording import read_recording
from ffcomp.measurement.sensors import wrong_scale
from tests.unit.ffcomp.measurement.conftest import RATE, Written

Columns = dict[str, np.ndarray]


def complaint(path: Path) -> str:
    with pytest.raises(MeasurementError) as caught:
        read_recording(path)
    assert str(path) in str(caught.value)
    assert all(problem.endswith((".", "?")) for problem in caught.value.problems)
    return str(caught.value)


def test_empty_fields_and_missing_rows_are_gaps(columns: Columns, written: Written) -> None:
    columns["acc_A_m_per_s2"][100:103] = np.nan
    whole = columns["cmd_A_mm"].copy()
    thinned = {name: np.delete(values, [500, 501, 502, 700]) for name, values in columns.items()}
    recording = read_recording(written(thinned))
    assert len(recording.time_s) == 1600
    assert list(np.flatnonzero(recording.gaps)) == [100, 101, 102, 500, 501, 502, 700]
    assert np.isnan(recording.acceleration["acc_A"][[100, 500]]).all() and np.isfinite(
        recording.acceleration["acc_B"][100]
    )
    np.testing.assert_allclose(recording.command[:, 0], whole, atol=1e-5)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("t_s", "t_ms", "'t_ms' is unknown; did you mean 't_s'?"),
        ("acc_A_m_per_s2", "acc_A_g", "'acc_A_g' is unknown; columns are t_s, cmd_*_mm, acc_*_m_per_s2 and pos_*_mm"),
        ("cmd_B_mm", "comand_B_mm", "did you mean 'cmd_B_mm'?"),
        ("cmd_B_mm", "cmd_A_mm", "'cmd_A_mm' is there 2 times"),
        ("cmd_B_mm", "cmd_y_mm", "of the carriages or of the nozzle, not of both"),
    ],
)
def test_wrong_names(columns: Columns, written: Written, old: str, new: str, words: str) -> None:
    path = written(columns)
    head, body = path.read_text(encoding="utf-8").split("\n", 1)
    names = [new if name == old else name for name in head.split(",")]
    path.write_text(",".join(names) + "\n" + body, encoding="utf-8")
    assert words in complaint(path)


def spoil_time(columns: Columns) -> None:
    columns["t_s"][800] = columns["t_s"][799]


def uneven(columns: Columns) -> None:
    columns["t_s"][600:] += 0.5 / RATE


def constant(columns: Columns) -> None:
    columns["acc_B_m_per_s2"][:] = 0.0383


def gappy(columns: Columns) -> None:
    columns["acc_B_m_per_s2"][300:1200] = np.nan


def unknown_command(columns: Columns) -> None:
    columns["cmd_C_mm"][300:400] = np.nan


def clipped(columns: Columns) -> None:
    np.clip(columns["acc_B_m_per_s2"], -1.1, None, out=columns["acc_B_m_per_s2"])


def in_g(columns: Columns) -> None:
    columns["acc_B_m_per_s2"] /= 9.80665


def in_mm(columns: Columns) -> None:
    columns["acc_B_m_per_s2"] *= 1000


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (
            spoil_time,
            "time must rise from row to row, but column t_s goes from 0.499375 s to 0.499375 s at row 802",
        ),
        (uneven, "column t_s steps by 1.5 periods at row 602, t = 0.3753125 s (1 such rows)"),
        (constant, "Column acc_B_m_per_s2 is 0.0383 in all 1600 rows"),
        (gappy, "Column acc_B_m_per_s2 is missing in 56% of the rows"),
        (unknown_command, "Column cmd_C_mm is missing for 0.0625 s from t = 0.1875 s"),
        (clipped, "Column acc_B_m_per_s2 stands at its lowest value -1.1 in "),
        (in_g, "Column acc_B_m_per_s2 looks 9.81 times too small, as if it were in g, not in m/s²"),
        (in_mm, "Column acc_B_m_per_s2 looks 1000 times too large, as if it were in mm/s², not in m/s²"),
    ],
)
def test_data_that_cannot_be_used(columns: Columns, written: Written, spoil: object, words: str) -> None:
    spoil(columns)  # type: ignore[operator]
    assert words in complaint(written(columns))


def test_every_mistake_is_said_at_once(columns: Columns, written: Written) -> None:
    spoil_time(columns)
    constant(columns)
    columns["acc_x_g"] = columns["acc_A_m_per_s2"]
    columns["acc_z_m_per_s2"] = np.full(1600, np.nan)
    said = complaint(written(columns))
    assert said.count("\n") == 3
    for words in ("must rise", "acc_B_m_per_s2 is 0.0383", "'acc_x_g' is unknown", "acc_z_m_per_s2 holds no number"):
        assert words in said


# ---- axis run ----


def written(folder: Path, lag_s: float, gain: float = 1.0) -> Path:
    """Write 4 s of a motion whose speed passes a low-pass of first order; encoder and tachometer have their noise."""
    t, rng = np.arange(4000) * 1e-3, np.random.default_rng(3)
    omega, size = 2 * np.pi * np.array([0.7, 1.9, 4.3, 7.7]), np.array([1.0, 0.6, 0.3, 0.1])
    place = np.round(1e4 * (np.sin(np.outer(t, omega)) @ size)) / 1e4
    passed = omega * size / (1 + 1j * omega * lag_s)
    speed = gain * np.real(np.exp(1j * np.outer(t, omega)) @ passed) + 0.01 * rng.standard_normal(len(t))
    path = folder / "run.csv"
    columns = np.column_stack([t, speed, place + 3 * t, speed + 3])
    np.savetxt(path, columns, "%.9g", ",", header="t_s,voltage_v,pos_q_rad,vel_q_rad_per_s", comments="")
    return path


def test_a_speed_that_comes_through_a_filter_is_left_out_with_its_lag(tmp_path: Path) -> None:
    run = read_axis_run(written(tmp_path, 8e-3))
    assert "vel_q" not in run.signals
    late_ms = float(run.remarks[0].split("comes ")[1].split(" ms")[0])
    assert late_ms == pytest.approx(8.0, rel=0.03)
    assert "ignored, because the position has the same motion" in run.remarks[0]


def test_one_clipped_axis_of_a_chip_is_not_taken_for_another_unit() -> None:
    t = np.arange(8000) / 1600
    command = np.sin(2 * np.pi * np.outer(t, [3.0, 5.0, 7.0]))  # mm
    felt = -1e-3 * (2 * np.pi * np.array([3.0, 5.0, 7.0])) ** 2 * command
    sensed = {"acc_x": felt[:, 0], "acc_y": felt[:, 1], "acc_z": 0.14 * felt[:, 2]}
    inputs = ("cmd_x", "cmd_y", "cmd_z")
    (said,) = wrong_scale(command, inputs, sensed, 1600.0)
    assert said.startswith("Column acc_z_m_per_s2 does not follow its command") and "it may clip" in said
    in_g = wrong_scale(command, inputs, {name: values / 9.80665 for name, values in sensed.items()}, 1600.0)
    assert "in g, not in m/s²" in in_g[0]
