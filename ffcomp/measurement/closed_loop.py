"""Read RepRapFirmware's logs of a motor with an encoder: `M569.5 P… S… R… D7 A1` writes one file of one motor.

The header is `Sample,Timestamp,Raw Encoder Reading,Measured Motor Steps,Target Motor Steps`, as far as `D` asks for the
columns, and others behind. The time is in ms. Behind the rows the firmware says in words what went wrong.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ffcomp.errors import MeasurementError
from ffcomp.measurement.clock import clock_of
from ffcomp.measurement.table import read_text, rows_of
from models.arrays import FloatArray

_BEGINNING = b"sample,timestamp"
_TIME, _MEASURED, _TARGET = "timestamp", "measured motor steps", "target motor steps"


@dataclass(frozen=True, eq=False)
class MotorLog:
    """What one motor was told and what it did, on one clock."""

    source: str
    time_s: FloatArray  # (n,) rising
    target: FloatArray  # (n,) steps
    measured: FloatArray  # (n,) steps

    @property
    def sample_rate_hz(self) -> float:
        """Mean sample rate."""
        return float((len(self.time_s) - 1) / (self.time_s[-1] - self.time_s[0]))


def is_closed_loop(path: str | Path) -> bool:
    """Tell a log of a motor by its first bytes."""
    if not Path(path).is_file():
        return False
    with Path(path).open("rb") as file:
        return file.read(len(_BEGINNING)).lower() == _BEGINNING


def read_closed_loop(path: str | Path) -> MotorLog:
    """Read a log.

    Raises
    ------
    MeasurementError
        Without target or measured steps, with the firmware's own complaint, or with a clock that is none.
    """
    text = read_text(path)
    lines = text.splitlines()
    columns = tuple(name.strip().lower() for name in lines[0].split(","))
    if missing := [name for name in (_TIME, _MEASURED, _TARGET) if name not in columns]:
        rule = f"It holds no column {', '.join(missing)!r}. Record it with D7, which asks for all that is needed."
        raise MeasurementError(str(path), [rule])
    if lines[1:] and not text.endswith(("\n", "\r")) and lines[-1].count(",") + 1 < len(columns):
        del lines[-1]  # of a copy that was cut off
    said = next((line.strip() for line in lines[1:] if line.strip() and not line.strip()[0].isdigit()), None)
    if said is not None:
        rule = f"The firmware says in it: {said[:60]!r}. Record it again, with fewer samples a second (R)."
        raise MeasurementError(str(path), [rule])
    table = rows_of(path, lines, 1, columns, {})
    time_s = 1e-3 * table.column(_TIME)
    missing_rows = np.isnan(table.values).any()
    problems = [*table.problems, *(["Fields of it are empty. Copy the file again."] if missing_rows else [])]
    problems = problems or clock_of(time_s, table.row)[1]
    if problems:
        raise MeasurementError(str(path), problems)
    return MotorLog(str(path), time_s, table.column(_TARGET), table.column(_MEASURED))
