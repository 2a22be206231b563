"""Tell what kind of measurement a file holds: its content decides, not its name."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from ffcomp.errors import MeasurementError
from ffcomp.measurement.klipper import is_stdata
from ffcomp.measurement.printer_logs import is_closed_loop, is_motion_log
from ffcomp.measurement.table import read_text
from ffcomp.measurement.uff import is_universal
from ffcomp.measurement.vibration import columns_of

Kind = Literal["frf", "recording", "vibration"]


def kind_of(path: Path) -> Kind:
    """Tell the kind of a file by its first line that is no comment of ours.

    Raises
    ------
    MeasurementError
        If it cannot be read, or is of no known kind.
    """
    if not path.is_file():
        raise MeasurementError(str(path), ["There is no such file."])
    if is_stdata(path) or is_motion_log(path) or is_closed_loop(path):
        return "vibration"
    if is_universal(path):
        return "frf"
    lines = [line.strip().lower() for line in read_text(path).splitlines() if line.strip()]
    if not lines:
        raise MeasurementError(str(path), ["The file is empty."])
    header = next((line for line in lines if not line.startswith("# ") and ":" not in line.split(",")[0]), lines[0])
    if header.startswith("frequency_hz"):
        return "frf"
    if columns_of(header) is not None and "cmd_" not in header:
        return "vibration"
    if "t_s" in [name.strip() for name in header.split(",")] or "cmd_" in header:
        return "recording"
    return "vibration"
