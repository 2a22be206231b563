"""A run of one axis by itself: what drove it and what was measured, on one uniform clock.

Columns: `t_s`; `cmd_q_mm` or `force_n`; any of `pos_q_mm`, `pos_motor_mm`, `acc_q_m_per_s2`. An empty field or NaN is
a gap of a sensor; what drives the axis has none.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ffcomp.errors import MeasurementError
from ffcomp.measurement.clock import Clock, clock_of
from ffcomp.measurement.recording import closest, experiment_of, repeated_columns
from ffcomp.measurement.table import Table, read_table, read_text
from models.arrays import FloatArray

INPUTS = ("cmd_q_mm", "force_n")
SENSORS = {"pos_q_mm": "pos_q", "pos_motor_mm": "pos_motor", "acc_q_m_per_s2": "acc_q"}
LOWEST_RATE_HZ = 20.0


@dataclass(frozen=True, eq=False)
class AxisRun:
    """One experiment of n samples at a constant rate."""

    source: str  # the file, as the user named it
    time_s: FloatArray  # (n,) s, uniform
    drive: FloatArray  # (n,) mm of the commanded position, or N
    by_force: bool
    acceleration: dict[str, FloatArray]  # "acc_q" -> (n,) m/s²
    position: dict[str, FloatArray]  # "pos_q", "pos_motor" -> (n,) mm
    comments: dict[str, str]
    folder: str = ""  # of the file, where another folder has one of the same name

    @property
    def sample_rate_hz(self) -> float:
        """Mean sample rate."""
        return float((len(self.time_s) - 1) / (self.time_s[-1] - self.time_s[0]))

    @property
    def repeat_of(self) -> str:
        """The file's stem without a trailing -1, -2, …: runs that share it repeat one experiment."""
        return experiment_of(self.source, self.folder)

    @property
    def signals(self) -> dict[str, FloatArray]:
        """All that was measured."""
        return {**self.acceleration, **self.position}

    @property
    def command_space(self) -> str:
        """Tell what the axis was given."""
        return "force" if self.by_force else "position"

    @property
    def command(self) -> FloatArray:
        """What the axis was given, (n, 1) mm; of a force, 10 for the largest: repeats must agree to a thousandth."""
        scale = 10.0 / max(float(np.abs(self.drive).max()), 1e-300) if self.by_force else 1.0
        return scale * self.drive[:, None]


def read_axis_run(path: str | Path) -> AxisRun:
    """Read one run; a MeasurementError reports every mistake in the file at once."""
    table = read_table(path, read_text(path))
    problems = [*table.problems, *_header(table.columns)]
    if problems:
        raise MeasurementError(str(path), problems)
    timed = np.isfinite(table.column("t_s"))
    clock, problems = clock_of(table.column("t_s")[timed], table.row[timed], LOWEST_RATE_HZ)
    if clock is None or problems:
        raise MeasurementError(str(path), problems)
    columns = {name: clock.on_grid(table.column(name)[timed]) for name in table.columns if name != "t_s"}
    name = next(name for name in INPUTS if name in columns)
    problems = _silent(columns, table, clock, name)
    if problems:
        raise MeasurementError(str(path), problems)
    felt = {SENSORS[key]: x for key, x in columns.items() if key in SENSORS}
    acceleration = {key: x for key, x in felt.items() if key.startswith("acc")}
    position = {key: x for key, x in felt.items() if key.startswith("pos")}
    by_force = name == "force_n"
    return AxisRun(str(path), clock.grid_s, columns[name], by_force, acceleration, position, table.comments)


def _header(columns: tuple[str, ...]) -> list[str]:
    """List the problems of a run's header, in full sentences."""
    known = ("t_s", *INPUTS, *SENSORS)
    problems = repeated_columns(columns)
    for name in dict.fromkeys(columns):
        if name not in known:
            near = closest(name, known)
            hint = f"; did you mean {near!r}?" if near else f"; it knows {', '.join(known)}."
            problems.append(f"Column {name!r} is none of a run of one axis{hint}")
    if "t_s" not in columns:
        problems.append("Column t_s (time, seconds) is missing; every run needs it.")
    if sum(name in columns for name in INPUTS) != 1:
        problems.append("A run of one axis needs what drove it: cmd_q_mm (a position) or force_n, one of the two.")
    if not any(name in columns for name in SENSORS):
        problems.append(f"No sensor column is there; a run needs at least one of {', '.join(SENSORS)}.")
    return problems


def _silent(columns: dict[str, FloatArray], table: Table, clock: Clock, drive: str) -> list[str]:
    """Report an input with gaps, and sensors without a number or without motion."""
    problems = []
    if not np.isfinite(columns[drive]).all():
        at = clock.grid_s[int(np.argmin(np.isfinite(columns[drive])))]
        problems.append(f"Column {drive} is missing at t = {at:.6g} s; what drives the axis must be known throughout.")
    for name, x in columns.items():
        known = x[np.isfinite(x)]
        if name in SENSORS and (len(known) < len(x) / 2 or not np.ptp(known) > 0):
            problems.append(f"Column {name} is missing in most rows, or never changes; leave it out.")
    return problems
