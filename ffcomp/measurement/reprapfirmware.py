"""RepRapFirmware's accelerometer files (M956): `Sample,X,Y,Z` in g, and a last line `Rate 1344, overflows 0`.

The file states a rate and no time; the chip's clock is only as good as the chip, and the recording starts whenever the
firmware gets to it.
"""

from __future__ import annotations

import re

from ffcomp.errors import MeasurementError
from ffcomp.measurement.capture import Capture, make_capture
from ffcomp.measurement.sensors import G
from ffcomp.measurement.table import rows_of

HEADER = ("sample", "x", "y", "z")
_TAIL = re.compile(r"^Rate\s+(\d+(?:\.\d+)?)\D+overflows\s+(\d+)\s*$", re.IGNORECASE)
_FAILED = re.compile(r"^(failed .*|.*\bfailed\b.*|.*\btimed? ?out\b.*)$", re.IGNORECASE)


def reprapfirmware_capture(path: str, text: str) -> Capture:
    """Read a capture.

    Raises
    ------
    MeasurementError
        Without the last line, or with the firmware's own complaint in its place.
    """
    lines = [line for line in text.splitlines() if line.strip()]
    failed = next((line.strip() for line in lines[1:] if _FAILED.match(line)), None)
    if failed is not None:
        raise MeasurementError(path, [f"The firmware says in it: {failed!r}. Check M955, and record it again."])
    tail = _TAIL.match(lines[-1].strip())
    if tail is None:
        rule = "The last line must say 'Rate 1344, overflows 0', for the rows hold no time"
        raise MeasurementError(
            path, [f"{rule}, but it is {lines[-1].strip()[:60]!r}: the recording was cut short. Record it again."]
        )
    table = rows_of(path, lines[:-1], 1, HEADER, {})
    time_s = table.column("sample") / float(tail[1])
    return make_capture(path, table, time_s, table.values[:, 1:] * G, overflows=int(tail[2]))
