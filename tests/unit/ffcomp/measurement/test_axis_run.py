"""Runs of one axis as they are read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ffcomp.measurement.axis_run import read_axis_run


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
