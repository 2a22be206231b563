"""A recording: the command and the measured signals, on one uniform clock.

One CSV file is one recording. Comment lines `# key: value` may come first, then a header, then rows. Columns:
`t_s`; `cmd_A_mm` `cmd_B_mm` `cmd_C_mm` (or `cmd_x_mm` `cmd_y_mm` `cmd_z_mm`); any subset of `acc_*_m_per_s2` and
`pos_*_mm`, * one of A B C x y z. An empty field or NaN is a gap.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.interpolate import CubicSpline

from ffcomp.errors import MeasurementError
from ffcomp.measurement.clock import Clock, Uniform, clock_of
from ffcomp.measurement.sensors import broken_sensor, with_gravity, wrong_scale
from ffcomp.measurement.table import Table, closest, read_table, read_text, repeated_columns
from ffcomp.measurement.vibration import is_stdata
from models.arrays import BoolArray, FloatArray

CommandSpace = Literal["carriage", "nozzle"]
CLOCKS = "clocks"  # the comment that assigns columns to several chips
AXES: dict[CommandSpace, str] = {"carriage": "ABC", "nozzle": "xyz"}

_LONGEST_COMMAND_GAP_S = 0.02  # a cubic through a longer hole would invent motion

_CAPTURES = ("#time,accel_x", "##", "sample,x,y,z")  # Klipper's, the same of 2020, RepRapFirmware's
_NO_COMMAND = (
    "It is an accelerometer's capture without a command; a recording holds both. Give the plan of its moves with "
    "--plan (`ffcomp record plan` writes moves and plan); or put its accelerations (in m/s², without gravity, along "
    "the printer's axes) next to the command at the same times."
)


class Run(Uniform):
    """One experiment, of a printer or of an axis by itself."""

    source: str  # the file, as the user named it
    folder: str  # of the file, where another folder has one of the same name

    @property
    def repeat_of(self) -> str:
        """The file's stem without a trailing -1, -2, …: runs that share it repeat one experiment."""
        return f"{self.folder}/" * bool(self.folder) + re.sub(r"-\d+$", "", Path(self.source.removesuffix(".gz")).stem)


@dataclass(frozen=True, eq=False)
class Recording(Run):
    """One experiment of n samples at a constant rate. Gaps are NaN in the sensors; the command has none."""

    source: str  # the file, as the user named it
    time_s: FloatArray  # (n,) s, uniform
    command: FloatArray  # (n, 3) mm, columns A B C or x y z
    command_space: CommandSpace
    acceleration: dict[str, FloatArray]  # "acc_A", "acc_x", … → (n,) m/s², gravity removed, up positive
    position: dict[str, FloatArray]  # "pos_A", "pos_x", … → (n,) mm
    comments: dict[str, str]  # keys in small letters
    folder: str = ""  # of the file, where another folder has one of the same name

    @property
    def gaps(self) -> BoolArray:
        """(n,) True where any sensor was missing."""
        return np.any([np.isnan(x) for x in (*self.acceleration.values(), *self.position.values())], axis=0)

    @property
    def inputs(self) -> tuple[str, str, str]:
        """The names of the command's columns: cmd_A … or cmd_x …."""
        a, b, c = (f"cmd_{axis}" for axis in AXES[self.command_space])
        return a, b, c

    def clocks_of(self, signals: Sequence[str]) -> tuple[str, ...]:
        """Name the clock of each signal by the first of its group: "" of the first, and of those without a group.

        A run of several chips says in `clocks` which columns are of one chip: `acc_x acc_z, acc_y`.
        """
        groups = [members.split() for members in self.comments.get(CLOCKS, "").split(",")]
        names = {signal: members[0] for members in groups[1:] for signal in members}
        return tuple(names.get(signal, "") for signal in signals)


def read_recording(path: str | Path) -> Recording:
    """Read one recording; a MeasurementError reports every mistake in the file at once.

    Rows that are missing altogether (their times are whole sample periods apart) are gaps too. A clock with jitter
    is resampled to a uniform one by cubic splines.
    """
    if Path(path).is_file() and is_stdata(path):
        raise MeasurementError(str(path), [_NO_COMMAND])
    text = read_text(path)
    if text.lstrip().lower().startswith(_CAPTURES):
        raise MeasurementError(str(path), [_NO_COMMAND])
    table = read_table(path, text)
    problems = [*table.problems, *check_header(table.columns)]
    clock, clock_problems = _clock(table)
    problems += clock_problems
    signals = _signals(table)
    problems += [text for name in signals for text in broken_sensor(name, table.column(name), table.row)]
    if problems or clock is None:
        raise MeasurementError(str(path), problems)
    recording, problems = _assemble(str(path), table, clock)
    felt, rate = recording.acceleration, recording.sample_rate_hz
    problems = problems or wrong_scale(recording.command, recording.inputs, felt, rate) or with_gravity(felt)
    if problems:
        raise MeasurementError(str(path), problems)
    return recording


def _clock(table: Table) -> tuple[Clock | None, list[str]]:
    if "t_s" not in table.columns:
        return None, []
    time_s = table.column("t_s")
    timed = np.isfinite(time_s)
    return clock_of(time_s[timed], table.row[timed])


def _signals(table: Table) -> list[str]:
    """List the columns of signals, without those of axes that are commanded to rest and do so to the last digit."""
    return [
        name for name in dict.fromkeys(table.columns) if signal_of(name) and name != "t_s" and not _at_rest(name, table)
    ]


def _at_rest(name: str, table: Table) -> bool:
    """Return whether a simulated axis rested: nothing was measured of it, and its sensor is not broken for that."""
    kind, _, axis = str(signal_of(name)).partition("_")
    command = f"cmd_{axis}_mm"
    if kind == "cmd" or command not in table.columns or table.columns.count(name) > 1:
        return False
    return all(bool(np.ptp(table.column(each)) == 0.0) for each in (name, command))


def _assemble(path: str, table: Table, clock: Clock) -> tuple[Recording, list[str]]:
    timed = np.isfinite(table.column("t_s"))
    data = {str(signal_of(name)): clock.on_grid(table.column(name)[timed]) for name in _signals(table)}
    space: CommandSpace = "carriage" if "cmd_A" in data else "nozzle"
    names = [f"cmd_{axis}" for axis in AXES[space]]
    filled = [_filled(name, data[name], clock) for name in names]
    recording = Recording(
        path,
        clock.grid_s,
        np.column_stack([values for values, _ in filled]),
        space,
        {name: values for name, values in data.items() if name.startswith("acc_")},
        {name: values for name, values in data.items() if name.startswith("pos_")},
        table.comments,
    )
    return recording, [problem for _, problems in filled for problem in problems]


def _filled(name: str, command: FloatArray, clock: Clock) -> tuple[FloatArray, list[str]]:
    """Close short gaps of the command by a cubic spline."""
    known = np.flatnonzero(np.isfinite(command))
    if len(known) == len(command):
        return command, []
    if len(known) < 4 or known[0] > 0 or known[-1] < len(command) - 1:
        return command, [f"Column {name}_mm must be known in the first and in the last row of the recording."]
    holes = np.diff(known) - 1
    longest = int(holes.argmax())
    if holes[longest] * clock.period_s > _LONGEST_COMMAND_GAP_S:
        first = known[longest] + 1
        return command, [
            f"Column {name}_mm is missing for {holes[longest] * clock.period_s:.3g} s from t = "
            f"{clock.grid_s[first]:.6g} s; a command may be missing for at most {_LONGEST_COMMAND_GAP_S:g} s, for "
            "the command there cannot be known."
        ]
    return CubicSpline(known, command[known])(np.arange(len(command))), []


# ---- the header ----------------------------------------------------------------------------------

_UNITS = {"cmd": "mm", "acc": "m_per_s2", "pos": "mm"}
COLUMNS = ("t_s", *(f"{kind}_{axis}_{unit}" for kind, unit in _UNITS.items() for axis in "ABCxyz"))
_RULE = "columns are t_s, cmd_*_mm, acc_*_m_per_s2 and pos_*_mm, in these units, with * one of A B C x y z."


def signal_of(column: str) -> str | None:
    """Return a column's signal: `acc_A` of `acc_A_m_per_s2`; None if the format has no such column."""
    if column not in COLUMNS:
        return None
    return "t" if column == "t_s" else column[:5]


def check_header(columns: Sequence[str]) -> list[str]:
    """List the problems of a recording's header, in full sentences."""
    if not any(name in COLUMNS for name in columns):
        return [f"The first line, {','.join(columns)[:60]!r}, names no column of a recording; {_RULE}"]
    problems = [_unknown(name) for name in dict.fromkeys(columns) if name not in COLUMNS]
    problems += repeated_columns(columns)
    if "t_s" not in columns:
        problems.append("Column t_s (time, seconds) is missing; every recording needs it.")
    problems += _command(columns)
    if not any(name.startswith(("acc_", "pos_")) and name in COLUMNS for name in columns):
        problems.append("No sensor column is there; a recording needs at least one of acc_*_m_per_s2 or pos_*_mm.")
    return problems


def _command(columns: Sequence[str]) -> list[str]:
    carriages, nozzle = ([f"cmd_{axis}_mm" for axis in axes] for axes in ("ABC", "xyz"))
    commands = [name for name in columns if name in carriages + nozzle]
    if any(name in carriages for name in commands) and any(name in nozzle for name in commands):
        return [f"The command must be of the carriages or of the nozzle, not of both; found are {', '.join(commands)}."]
    needed = nozzle if any(name in nozzle for name in commands) else carriages
    missing = [name for name in needed if name not in commands]
    if not commands:
        return [
            "The command is missing; a recording needs cmd_A_mm, cmd_B_mm, cmd_C_mm, or cmd_x_mm, cmd_y_mm, cmd_z_mm."
        ]
    return [f"Column {name} is missing; a command needs {', '.join(needed)}." for name in missing]


def _unknown(name: str) -> str:
    if not name:
        return "A column has no name; every column of the header needs one."
    near = closest(name, COLUMNS)
    return f"Column {name!r} is unknown; " + (f"did you mean {near!r}?" if near else _RULE)
