"""Logs as Klipper's data logger writes them, of a known motion: for tests of the reader."""

from __future__ import annotations

import gzip
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ffcomp.planner.trajectory import Trajectory

FloatArray = NDArray[np.float64]

MESSAGE = 400  # rows


def write_log(path: Path, messages: Sequence[Mapping[str, Any]]) -> None:
    """Write NAME.json.gz and NAME.index.gz."""
    path.write_bytes(gzip.compress(b"".join(json.dumps(each).encode() + b"\x03" for each in messages)))
    first = {"status": {}, "subscriptions": {}, "file_position": 0}
    index = path.with_name(path.name.replace(".json.gz", ".index.gz"))
    index.write_bytes(gzip.compress(json.dumps(first).encode() + b"\x03"))


def trapq(trajectory: Trajectory, begin_s: float) -> list[dict[str, Any]]:
    """The nozzle's plan, each phase of each move a segment."""
    rows = []
    for k in range(len(trajectory)):
        t, at = begin_s + float(trajectory.start_t[k]), trajectory.origin[k, :3].copy()
        direction, speed = trajectory.direction[k, :3], float(trajectory.start_v[k])
        acceleration = float(trajectory.acceleration[k])
        phases = ((trajectory.accel_t, acceleration), (trajectory.cruise_t, 0.0), (trajectory.decel_t, -acceleration))
        for lasts, change in phases:
            duration = float(lasts[k])
            if duration > 0:
                rows.append([t, duration, speed, change, at.tolist(), direction.tolist()])
                at = at + direction * (speed * duration + 0.5 * change * duration**2)
                t, speed = t + duration, speed + change * duration
    messages = [rows[max(0, k - 1) : k + MESSAGE] for k in range(0, len(rows), MESSAGE)]  # the last one again
    return [{"q": "trapq:toolhead", "params": {"data": each}} for each in messages]


def accelerometer(
    name: str, time_s: FloatArray, acceleration: FloatArray, overflows: Sequence[int] = ()
) -> list[dict[str, Any]]:
    """Samples (n, 3) m/s² at print times; the overflows counted with each message of 400, 0 if not given."""
    rows = np.column_stack([time_s, 1e3 * acceleration]).tolist()
    counted = dict(enumerate(overflows))
    return [
        {
            "q": f"accelerometer:{name}",
            "params": {"data": rows[k : k + MESSAGE], "overflows": counted.get(k // MESSAGE, 0), "errors": 0},
        }
        for k in range(0, len(rows), MESSAGE)
    ]
