"""A capture: what one accelerometer recorded, without the command."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import Any, Literal

import numpy as np

from ffcomp.errors import MeasurementError
from ffcomp.measurement.clock import Uniform, clock_of
from ffcomp.measurement.sensors import broken_sensor
from ffcomp.measurement.table import Table
from models.arrays import FloatArray

ClockKind = Literal["log", "firmware", "free"]
Point = tuple[float, float, float]

LOWEST_RATE_HZ = 400.0  # twice the highest frequency that is compared; a phone's rate
_PLAUSIBLE_RMS = (0.03, 1000.0)  # m/s²: between the noise of the best such chip and the range of the worst


@dataclass(frozen=True, eq=False)
class Capture(Uniform):
    """An accelerometer's record, gravity included; its clock starts anywhere."""

    source: str
    time_s: FloatArray  # (n,) s, uniform
    acceleration: FloatArray  # (n, 3) m/s², columns X Y Z of the chip; NaN where a row is missing
    axis: str | None = None  # excited: x, y, z or axis=1.000,0.500
    position_mm: Point | None = None
    name: str = ""  # of the measurement, where one file holds several
    clock: ClockKind = "free"  # the print time of the motion: exact, or within a sample
    overflows: int = 0  # samples that the chip lost, as far as the file says it


def make_capture(path: str, table: Table, time_s: FloatArray, acceleration: FloatArray, **stated: Any) -> Capture:
    """Check the rows of a file and bring them to a uniform clock.

    table : the file's rows, for their numbers and for the problems found so far
    time_s : (n,) s
    acceleration : (n, 3) m/s², columns X Y Z of the chip
    stated : other fields of the capture, as far as the file states them

    Raises MeasurementError with every mistake in the file.
    """
    problems = list(table.problems)
    timed = np.isfinite(time_s)
    uniform, clock_problems = clock_of(time_s[timed], table.row[timed], LOWEST_RATE_HZ)
    problems += [text.replace("column t_s", f"column {table.columns[0]}") for text in clock_problems]
    for j, axis_name in enumerate("xyz"):
        problems += broken_sensor(f"acc_{axis_name}", acceleration[:, j], table.row)
    problems = problems or _implausible(acceleration)
    if problems or uniform is None:
        raise MeasurementError(path, problems)
    on_grid = np.column_stack([uniform.on_grid(acceleration[timed, j]) for j in range(3)])
    return Capture(path, uniform.grid_s, on_grid, **stated)


def _implausible(acceleration: FloatArray) -> list[str]:
    """Check the size of an acceleration (n, 3) m/s², and that no axis was exported twice."""
    known = acceleration[np.isfinite(acceleration).all(axis=1)]
    rms = float(np.sqrt((known**2).sum(axis=1).mean())) if len(known) else 1.0
    low, high = _PLAUSIBLE_RMS
    problems = [
        f"The columns of {'xyz'[i]} and {'xyz'[j]} are the same in every row: one axis was exported twice. Export all "
        "three."
        for i, j in combinations(range(3), 2)
        if np.array_equal(known[:, i], known[:, j])
    ]
    if not low < rms < high:
        problems.append(
            f"The acceleration is {rms:.3g} m/s² rms; a sensor on Earth measures between {low:g} and {high:g}. Are the "
            "numbers in a unit other than the file format's?"
        )
    return problems
