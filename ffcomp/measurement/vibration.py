"""Read what an accelerometer on a printer recorded, of whatever firmware or program; the content decides.

| file | what it holds |
|---|---|
| Klipper, Kalico | captures and spectra: `ffcomp.measurement.klipper` |
| Shake&Tune `.stdata` | one or more of Klipper's captures: `ffcomp.measurement.shake_and_tune` |
| RepRapFirmware `Sample,X,Y,Z` | a capture in g with its rate in the last line: `ffcomp.measurement.reprapfirmware` |
| py3dpaxxel | a capture in mg: `ffcomp.measurement.klipper` |
| any other table with a time and three accelerations | a capture: `ffcomp.measurement.plain_capture` |
"""

from __future__ import annotations

from pathlib import Path

from ffcomp.errors import MeasurementError
from ffcomp.measurement.capture import Capture
from ffcomp.measurement.closed_loop import is_closed_loop
from ffcomp.measurement.klipper import Resonances, is_paxxel, is_raw, paxxel_capture, raw_capture, resonances_of_table
from ffcomp.measurement.motan import is_motion_log
from ffcomp.measurement.plain_capture import columns_of, plain_capture
from ffcomp.measurement.reprapfirmware import HEADER, reprapfirmware_capture
from ffcomp.measurement.shake_and_tune import is_stdata, stdata_captures
from ffcomp.measurement.table import read_table, read_text

_RULE = (
    "The first line must be '#time,accel_x,accel_y,accel_z', 'freq,psd_x,…', 'Sample,X,Y,Z', 'seq sample x y z' or "
    "name a time and three accelerations, as 't_s,ax_m_per_s2,ay_m_per_s2,az_m_per_s2'"
)

_LOG = (
    "It is a log of motion and sensors of Klipper's data_logger.py; `ffcomp record join`, `gap` and `diagnose` read "
    "it, with the plan of its moves (--plan)."
)

_MOTOR = (
    "It is RepRapFirmware's log of one motor (M569.5), and holds no accelerations; `ffcomp record join`, `gap` and "
    "`diagnose` read it, with the plan of its moves (--plan)."
)


def read_vibration(path: str | Path) -> Capture | Resonances:
    """Read one capture or the spectra of one test.

    Raises
    ------
    MeasurementError
        With every mistake; for a file that holds several captures.
    """
    first, *others = read_vibrations(path)
    if others:
        names = ", ".join(each.name for each in (first, *others) if isinstance(each, Capture))
        raise MeasurementError(str(path), [f"It holds {1 + len(others)} captures ({names}), and one is needed."])
    return first


def read_vibrations(path: str | Path) -> list[Capture | Resonances]:
    """Read everything that a file holds.

    Raises
    ------
    MeasurementError
        With every mistake in the file.
    """
    if Path(path).is_file() and is_stdata(path):
        return list(stdata_captures(path))
    if Path(path).is_file() and is_motion_log(path):
        raise MeasurementError(str(path), [_LOG])
    if Path(path).is_file() and is_closed_loop(path):
        raise MeasurementError(str(path), [_MOTOR])
    text = read_text(path)
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    first = next((line for line in lines if not line.startswith("##")), lines[0])
    if is_raw(first):
        return [raw_capture(str(path), text)]
    if is_paxxel(first):
        return [paxxel_capture(str(path), text)]
    if first.lower().startswith("freq,"):
        return [resonances_of_table(str(path), read_table(path, text))]
    if tuple(name.strip().lower() for name in first.split(",")) == HEADER:
        return [reprapfirmware_capture(str(path), text)]
    header = next((line for line in lines if not line.startswith("#")), first)
    if columns_of(header) is not None or columns_of(first) is not None:
        return [plain_capture(str(path), text)]
    raise MeasurementError(str(path), [f"{_RULE}, but it is {first[:60]!r}."])


def read_captures(path: str | Path) -> list[Capture]:
    """Read the records of acceleration in time; see `read_vibrations`."""
    found = [each for each in read_vibrations(path) if isinstance(each, Capture)]
    if not found:
        raise MeasurementError(str(path), ["It holds spectra; a record of acceleration in time is needed."])
    return found


def read_capture(path: str | Path) -> Capture:
    """Read one record of acceleration in time; see `read_vibration`."""
    found = read_vibration(path)
    if not isinstance(found, Capture):
        raise MeasurementError(str(path), ["It holds spectra; a record of acceleration in time is needed."])
    return found
